"""The operator as sparse matrices: L = μ Γ − (λ−μ) Ψ Φ (theory, 11–13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.kernels.lps.matrix import entries
from warp_peri.launch import floats, launch, zeros
from warp_peri.lps.bonds import Bonds, check_volumes, influence, surface_shape
from warp_peri.lps.model import Model, on_nominal_lattice
from warp_peri.points.arrays import plain
from warp_peri.points.families import families_of
from warp_peri.points.points import Points
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
    model: Model, points: PointsLike, *, quadrature_degree: int = DEGREE, bonds: Bonds | None = None
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
    return assemble(bonds, *influence(bonds, floats(np.array([model.alpha])), floats(model.D)))


def assemble(bonds: Bonds, kw: wp.array[Any], m: wp.array[Any]) -> Matrices:
    """Assemble from given tables: K W by class and the weighted volumes."""
    edges, d = len(bonds.families.neighbour), bonds.dimension
    kernels = entries(d)
    gamma, psi = zeros(edges, dtype=kernels.mat), zeros(edges, dtype=kernels.vec)
    kernel_inputs = (bonds.full, bonds.arrays, kw, m)
    launch(kernels.bond_entries, len(bonds.full), kernel_inputs, (gamma, psi))
    phi = zeros(edges, dtype=kernels.vec)
    wp.copy(phi, psi)
    if len(bonds.cut):
        surface = (bonds.cut, bonds.arrays, kw, surface_shape(bonds, kw))
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


@dataclass(frozen=True)
class NodeFields:
    """What a displacement does at the interior nodes.

    Attributes:
        stress: σ [TPa], shape [S, I, d, d], symmetric.
        strain: ε, symmetric part of the least-squares gradient over the family, same shape.
        dilatation: θ, shape [S, I].
        energy: density [TPa], shape [S, I].
    """

    stress: np.ndarray
    strain: np.ndarray
    dilatation: np.ndarray
    energy: np.ndarray


def node_fields(model: Model, points: PointsLike, u: ArrayLike) -> NodeFields:
    """Collapsed stress of S. A. Silling and R. B. Lehoucq (2008), with strain and energy.

    The stress is that of a family deformed as the node's own force state is; on a lattice it is
    exact on affine fields and approaches the stress of the local solid as fields become smooth. On
    scattered points only as far as the weights of each family are symmetric; the strain is exact.

    Args:
        model: the model; no certificate is asked for.
        points: a lattice or scattered points; its u is not looked at.
        u: displacement [Å] on all nodes, shape [N, d] or [S, N, d].

    Raises InputError for a u of another shape, a point set that does not carry the horizon, or
    nodes outside the body: the stress is that of complete families.
    """
    u = plain("u", u)
    points = on_nominal_lattice(model, points)
    nodes, d = points.x.shape
    c2 = 2 * d * (d + 2)
    shaped = u.ndim in (2, 3) and u.size > 0 and u.shape[-2:] == (nodes, d)
    if not (shaped and np.isfinite(u).all()):
        raise InputError(
            f"u: expected finite values of shape [S, {nodes}, {d}], got {list(u.shape)}"
        )
    if points.outside is not None:
        raise InputError("outside: expected none, for stress needs complete families")
    owner, far, xi, r, W = _interior_bonds(points, model.horizon)
    place = np.cumsum(points.interior)[owner] - 1
    size = int(points.interior.sum())

    def total(values: np.ndarray) -> np.ndarray:
        """Sum over each family: [E, …] → [I, …]."""
        flat = values.reshape(len(values), -1)
        sums = [np.bincount(place, column, size) for column in flat.T]
        return np.stack(sums, axis=1).reshape(size, *values.shape[1:])

    K = model.influence(r) * W
    m = total(K * r**2)
    outer = xi[:, :, None] * xi[:, None, :]
    shape = total(K[:, None, None] * outer)
    moments = total(outer)
    parts = []
    for field in u.reshape(-1, nodes, d):
        eta = field[far] - field[owner]
        along = (xi * eta).sum(axis=1)
        theta = d / m * total(K * along)
        dilatational = ((model.lam - model.mu) * d / m * theta)[:, None, None] * shape
        deviatoric = total((K * along / r**2)[:, None, None] * outer)
        deviatoric *= (c2 / 2 * model.mu / m)[:, None, None]
        gradient = total(eta[:, :, None] * xi[:, None, :]) @ np.linalg.inv(moments)
        strain = (gradient + gradient.transpose(0, 2, 1)) / 2
        energy = (model.lam - model.mu) * theta**2 / 2
        energy += c2 / 4 * model.mu / m * total(K * along**2 / r**2)
        parts.append((dilatational + deviatoric, strain, theta, energy))
    return NodeFields(*(np.stack(part) for part in zip(*parts)))


def _interior_bonds(points: Points, horizon: float) -> tuple[np.ndarray, ...]:
    """Node and neighbour of the bonds of interior nodes, their vectors ξ, lengths and weights."""
    families = families_of(points, horizon)
    owner = np.repeat(np.arange(len(points.x)), np.diff(families.row))
    kept = points.interior[owner]
    owner, far = owner[kept], families.neighbour[kept]
    if families.lattice is not None:
        number = (np.arange(len(kept)) - families.row[:-1].repeat(np.diff(families.row)))[kept]
        kind = families.lattice.bond_class[number]
        return owner, far, families.pattern[number], families.r[kind], families.weight[kind]
    xi = points.x[far] - points.x[owner]
    if points.box is not None:  # the nearest images
        xi -= points.box * np.rint(xi / points.box)
    return owner, far, xi, families.r[kept], families.weight[kept]
