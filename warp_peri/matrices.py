"""The operator as sparse matrices: L = μ Γ − (λ−μ) Ψ Φ (theory.md, 11–13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import warp as wp

from warp_peri.dataset import PointSet
from warp_peri.kernels.matrix import bond_entries
from warp_peri.model import Model
from warp_peri.operator import DEVICE, Sweeps, as_float


@dataclass(frozen=True)
class Matrices:
    """Matrices on a point set of N nodes, I of them interior; component a of node i is 2 i + a.

    Attributes:
        gamma: Γ, forces on the interior nodes from displacements [Å⁻²], shape [2 I, 2 N].
        phi: Φ, dilatations at all nodes from displacements [Å⁻¹], shape [N, 2 N]; zero rows where
            no force needs them.
        psi: Ψ, Σ_j (2/m) K ξ (θ_i + θ_j) W on the interior nodes [Å⁻¹], shape [2 I, N].
    """

    gamma: sp.csr_array
    phi: sp.csr_array
    psi: sp.csr_array

    def operator(self, lam: float, mu: float) -> sp.csr_array:
        """L [TPa/Å²], shape [2 I, 2 N]."""
        return sp.csr_array(mu * self.gamma - (lam - mu) * (self.psi @ self.phi))


def matrices(model: Model, points: PointSet) -> Matrices:
    """Assemble Γ, Φ and Ψ of a model on a lattice point set.

    Raises InputError for a point set that does not carry the horizon.
    """
    sweeps = Sweeps(points, model.horizon)
    alpha = as_float(np.array([model.alpha]))
    tables = [
        table
        for D in (model.D, model.dilatation)
        for table in sweeps.influence(alpha, as_float(D), gradient=False)
    ]
    return assemble(sweeps, points, tables)


def assemble(sweeps: Sweeps, points: PointSet, tables: Sequence[wp.array]) -> Matrices:
    """Assemble from given tables: K W by class and m by node, deviatoric, then dilatational."""
    edges = len(sweeps.families.neighbour)
    gamma = sweeps.zeros(edges, dtype=wp.mat22d)
    phi = sweeps.zeros(edges, dtype=wp.vec2d)
    row, _, bond, bond_class, xi = sweeps.links
    wp.launch(
        bond_entries,
        dim=len(sweeps.full),
        inputs=[sweeps.full, row, bond, bond_class, xi, *tables],
        outputs=[gamma, phi],
        device=DEVICE,
    )
    nodes = len(points.x)
    at = np.repeat(np.arange(nodes), np.diff(sweeps.families.row))
    to = sweeps.families.neighbour
    a = np.arange(2)

    def blocks(values: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]):
        return sp.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()

    value = gamma.numpy()
    out_row = np.broadcast_to((2 * at[:, None] + a)[:, :, None], value.shape)
    far = np.broadcast_to((2 * to[:, None] + a)[:, None, :], value.shape)
    near = np.broadcast_to((2 * at[:, None] + a)[:, None, :], value.shape)
    size = (2 * nodes, 2 * nodes)
    G = blocks(value, out_row, near, size) - blocks(value, out_row, far, size)

    value = phi.numpy()
    vector = 2 * at[:, None] + a
    one = np.broadcast_to(at[:, None], value.shape)
    size = (nodes, 2 * nodes)
    P = blocks(value, one, 2 * to[:, None] + a, size) - blocks(value, one, vector, size)
    other = np.broadcast_to(to[:, None], value.shape)
    size = (2 * nodes, nodes)
    Q = blocks(value, vector, other, size) + blocks(value, vector, one, size)

    interior = np.repeat(points.interior, 2)
    return Matrices(G[interior], P, Q[interior])
