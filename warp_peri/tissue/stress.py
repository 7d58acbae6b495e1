"""Stress of a hyperelastic solid at the nodes, from the forces that bonds carry."""

from __future__ import annotations

import numpy as np

from warp_peri.tissue.bond_slopes import bond_slopes
from warp_peri.tissue.operator import HyperelasticOperator


def piola_stress(op: HyperelasticOperator, u: np.ndarray, c: np.ndarray) -> np.ndarray:
    """First Piola stress P = ½ Σ [t/|ξ|² + w·(G_i + G_j)] (ξ + η)⊗ξ, (H16), shape [N, 2, 2].

    Args:
        op: the operator.
        u: one displacement, shape [N, 2].
        c: coefficients.

    It is ∂W/∂F in uniform strain, on nodes whose neighbours all have whole families; nearer to the
    edge it misses what bonds to outside would carry. Of a sheet that is not even it is the pull per
    length of a section, over thickness one.
    """
    u = np.asarray(u, float)
    E, G, _ = op.states(u, c)
    i, j, k = op.bonds.pairs
    xi = op.bonds.xi[k]
    Y = xi + u[j] - u[i]
    square = (xi**2).sum(axis=1)
    s = ((Y**2).sum(axis=1) / square - 1) / 2
    tension = bond_slopes(op.dictionary, s, c, k)[0]
    first, last = op.dictionary.first_deviation, op.dictionary.first_term
    whole = (op.bonds.whole[i] >= 2) & (op.bonds.whole[j] >= 2)
    near = np.flatnonzero(whole & (op.deviation[k] >= 0))
    mean = 1 + ((E[i[near], 3:] + E[j[near], 3:]) * op.unit[k[near]]).sum(axis=1)
    d = 0.5 * np.log((1 + 2 * s[near]) / mean)
    tension[near] += c[first:last][op.deviation[k[near]]] * d / (1 + 2 * s[near]) / mean
    if op.thickness is not None:
        tension *= (op.thickness[i] + op.thickness[j]) / 2
    along = tension / square + ((G[i] + G[j]) * op.weight[k]).sum(axis=1)
    carried = 0.5 * along[:, None, None] * Y[:, :, None] * xi[:, None, :]
    P = op.corner_stress(u, c)
    np.add.at(P, i, carried)
    np.add.at(P, j, carried)
    return P
