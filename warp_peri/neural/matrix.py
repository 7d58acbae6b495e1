"""The tangent of a neural operator as a sparse matrix, from the slopes of its bonds."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from warp_peri.neural.placed import Tangent


def matrix(tangent: Tangent) -> sp.csr_array:
    """J = ∂force/∂u, rows of the interior and columns of all nodes, shape [2 I, 2 N], (NO9)."""
    bonds = tangent.bonds
    u = tangent.u[0].double().numpy()
    nodes, listed, acting = len(u), len(bonds.near), bonds.acting
    Y = bonds.xi[bonds.place] + u[bonds.far] - u[bonds.near]
    length = np.linalg.norm(Y, axis=1)
    M = Y / length[:, None]
    stretching = _between(bonds.near, bonds.far, M, nodes)
    k, p = np.indices((len(bonds.whole), len(bonds.xi))).reshape(2, -1)
    share = tangent.share.double().numpy()[p]
    number = bonds.number[bonds.whole].ravel()
    average = sp.csr_array((share, (k, number)), shape=(len(bonds.whole), listed)) @ stretching
    first = stretching[:acting]
    rows = (2 * bonds.rows[:, None] + [0, 1]).ravel()
    pull = first.T[rows]
    J = pull @ (sp.diags_array(tangent.to_e.double().numpy().ravel()) @ first)
    slopes = np.concatenate([tangent.to_own.double().numpy(), tangent.to_other.double().numpy()])
    ends = np.tile(np.arange(acting), 2), np.concatenate([bonds.own.numpy(), bonds.other.numpy()])
    by_theta = sp.csr_array((slopes, ends), shape=(acting, len(bonds.whole)))
    J = J + (pull @ by_theta) @ average
    t = tangent.tension.double().numpy().ravel() / length[:acting]
    across = np.stack([-M[:acting, 1], M[:acting, 0]], axis=1)
    turned = _between(bonds.near[:acting], bonds.far[:acting], across, nodes)
    J = J + turned.T[rows] @ (sp.diags_array(t) @ turned)
    return sp.csr_array(bonds.area * J)


def _between(near: np.ndarray, far: np.ndarray, M: np.ndarray, nodes: int) -> sp.csr_array:
    """Rows M·(v_far − v_near), shape [n, 2 nodes]."""
    n = np.arange(len(near))
    columns = np.stack([2 * near, 2 * near + 1, 2 * far, 2 * far + 1], axis=1)
    values = np.concatenate([-M, M], axis=1)
    given = (values.ravel(), (np.repeat(n, 4), columns.ravel()))
    return sp.csr_array(given, shape=(len(n), 2 * nodes))
