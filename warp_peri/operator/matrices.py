"""The operator as sparse matrices: L = μ Γ − (λ−μ) Ψ Φ (theory.md, 11–13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp

from warp_peri.kernels.lps.matrix import entries
from warp_peri.launch import floats, launch, zeros
from warp_peri.models.lps import Model
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import check_volumes, influence, surface_shape
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike


@dataclass(frozen=True)
class Matrices:
    """Matrices on a point set of N nodes, I of them interior; component a of node i is d i + a.

    Attributes:
        gamma: Γ, forces on the interior nodes from displacements [Å⁻²], shape [d I, d N].
        phi: Φ, dilatations at all nodes from displacements [Å⁻¹], shape [N, d N]; zero rows where
            no force needs them.
        psi: Ψ, Σ_j (d/m) K ξ (θ_i + θ_j) W on the interior nodes [Å⁻¹], shape [d I, N].
    """

    gamma: sp.csr_array
    phi: sp.csr_array
    psi: sp.csr_array

    def operator(self, lam: float, mu: float) -> sp.csr_array:
        """L [TPa/Å²], shape [d I, d N]."""
        return sp.csr_array(mu * self.gamma - (lam - mu) * (self.psi @ self.phi))


def matrices(
    model: Model,
    points: PointsLike,
    *,
    quadrature_degree: int = DEGREE,
    bonds: Bonds | None = None,
) -> Matrices:
    """Assemble Γ, Φ and Ψ of a model on a point set; the options are those of LPSOperator.

    `bonds` are those of the points with this model's horizon, where they are made already.

    Raises InputError for a point set that does not carry the horizon.
    """
    if bonds is None:
        bonds = Bonds(
            on_nominal_lattice(model, points),
            model.horizon,
            bond_based=model.bond_based,
            quadrature_degree=quadrature_degree,
        )
        check_volumes(bonds, model)
    alpha = floats(np.array([model.alpha]))
    tables = [
        table for D in (model.D, model.dilatation) for table in influence(bonds, alpha, floats(D))
    ]
    return assemble(bonds, tables)


def assemble(bonds: Bonds, tables: Sequence[wp.array[Any]]) -> Matrices:
    """Assemble from given tables: K W by class and m, deviatoric, then dilatational."""
    edges, d = len(bonds.families.neighbour), bonds.dimension
    kernels = entries(d)
    gamma, psi = zeros(edges, dtype=kernels.mat), zeros(edges, dtype=kernels.vec)
    kernel_inputs = (bonds.full, bonds.arrays, *tables)
    launch(kernels.bond_entries, len(bonds.full), kernel_inputs, (gamma, psi))
    phi = zeros(edges, dtype=kernels.vec)
    wp.copy(phi, psi)
    if len(bonds.cut):
        shape = surface_shape(bonds, tables[2])
        surface = (bonds.cut, bonds.arrays, tables[2], shape)
        launch(kernels.surface_entries, len(bonds.cut), surface, (phi,))
    nodes = bonds.nodes
    intact = np.flatnonzero(bonds.families.neighbour >= 0)
    owner = np.repeat(np.arange(nodes), np.diff(bonds.families.row))[intact]
    far_end = bonds.families.neighbour[intact]
    a = np.arange(d)

    def blocks(
        values: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]
    ) -> sp.csr_array:
        return sp.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()

    value = gamma.numpy()[intact]
    out_row = np.broadcast_to((d * owner[:, None] + a)[:, :, None], value.shape)
    far = np.broadcast_to((d * far_end[:, None] + a)[:, None, :], value.shape)
    near = np.broadcast_to((d * owner[:, None] + a)[:, None, :], value.shape)
    size = (d * nodes, d * nodes)
    G = blocks(value, out_row, near, size) - blocks(value, out_row, far, size)

    value = phi.numpy()[intact]
    vector = d * owner[:, None] + a
    node = np.broadcast_to(owner[:, None], value.shape)
    size = (nodes, d * nodes)
    P = blocks(value, node, d * far_end[:, None] + a, size) - blocks(value, node, vector, size)
    value = psi.numpy()[intact]
    other = np.broadcast_to(far_end[:, None], value.shape)
    size = (d * nodes, nodes)
    Q = blocks(value, vector, other, size) + blocks(value, vector, node, size)

    interior = (d * bonds.families.rows[:, None] + a).ravel()
    return Matrices(G[interior], P, Q[interior])
