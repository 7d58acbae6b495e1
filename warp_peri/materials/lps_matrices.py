"""The operator as sparse matrices: L = μ Γ − (λ−μ) Ψ Φ (theory, 11–13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.materials.lps_force import Bonds, bonds_of
from warp_peri.points.arguments import checked
from warp_peri.points.points import PointsLike, nodes_of

if TYPE_CHECKING:
    from warp_peri.materials.lps import LPSMaterial


@dataclass(frozen=True)
class Matrices:
    """Matrices on a point set of N nodes, I of them interior; component a of node i is d i + a.

    Attributes:
        gamma: Γ, forces on the interior nodes from displacements [Å⁻²], shape [d I, d N]; of a
            field μ μ Γ, the mean of both ends in each bond.
        phi: Φ, dilatations at all nodes from displacements [Å⁻¹], shape [N, d N]; zero rows where
            no force needs them.
        psi: Ψ, Σ_j (d/m) K ξ (θ_i + θ_j) W on the interior nodes [Å⁻¹], shape [d I, N].
    """

    gamma: sp.csr_array
    phi: sp.csr_array
    psi: sp.csr_array

    def operator(self, lam: Any, mu: Any) -> sp.csr_array:
        """L [TPa/Å²], shape [d I, d N]."""
        if np.ndim(lam - mu):
            return sp.csr_array(self.gamma - self.psi @ (sp.diags_array(lam - mu) @ self.phi))
        return sp.csr_array(mu * self.gamma - (lam - mu) * (self.psi @ self.phi))


def matrices(model: LPSMaterial, points: PointsLike) -> Matrices:
    """Γ, Φ and Ψ of a model on a point set; InputError where that does not carry the horizon."""
    bonds = bonds_of(model, points)
    return assemble(bonds, *bonds.table(model.alpha, model.D), model.mu)


def assemble(bonds: Bonds, kw: np.ndarray, m: Any, mu: Any = 1.0) -> Matrices:
    """Γ, Φ and Ψ of tables: K W by class, weighted volumes, of nodes or of all, and a field μ."""
    families, nodes, d = bonds.families, bonds.nodes, bonds.dimension
    owner, end, xi, kind = bonds.listing
    own = kw[kind] / np.broadcast_to(m, nodes)[owner]
    needed = np.isin(owner, np.concatenate([families.whole, families.cut]))
    some = np.flatnonzero((end >= 0) & needed)
    push, bent = d * own[some, None] * xi[some], bonds.bent(kw, own)[some]
    owner, end, xi, one = owner[some], end[some], xi[some], np.ones((len(some), 1))
    shear = 2 * (d + 2) / (xi**2).sum(axis=1)
    shear = shear * (mu[owner] + mu[end]) / 2 if np.ndim(mu) else shear

    def at(where: np.ndarray, values: np.ndarray) -> sp.csr_array:
        """From fields of c components to values · field at a node of each bond, [E, c N]."""
        c = values.shape[1]
        columns, starts = c * where[:, None] + np.arange(c), c * np.arange(len(some) + 1)
        entries = values.ravel(), columns.ravel(), starts
        return sp.csr_array(entries, shape=(len(some), c * nodes))

    interior = (d * families.rows[:, None] + np.arange(d)).ravel()
    force, along = sp.csr_array(at(owner, push).T)[interior], at(end, xi) - at(owner, xi)
    return Matrices(
        sp.csr_array(force @ (sp.diags_array(-shear) @ along)),
        sp.csr_array(at(owner, one).T @ (at(end, bent) - at(owner, bent))),
        sp.csr_array(force @ (at(owner, one) + at(end, one))),
    )


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


def node_fields(model: LPSMaterial, points: PointsLike, u: ArrayLike) -> NodeFields:
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
    if (given := nodes_of(points)).outside is not None:
        raise InputError("outside: expected none, for stress needs complete families")
    bonds = bonds_of(model, points)
    kw, m = bonds.table(model.alpha, model.D)
    nodes, d, inside = bonds.nodes, bonds.dimension, np.flatnonzero(given.interior)
    u = checked("u", u, float, (..., nodes, d)).reshape(-1, nodes, d)
    mine = given.interior[bonds.listing[0]]
    owner, far, xi, kind = (one[mine] for one in bonds.listing)
    lam, mu, m = (np.broadcast_to(one, nodes)[inside] for one in (model.lam, model.mu, m))
    place = np.searchsorted(inside, owner)
    entries = np.ones(len(place)), (place, np.arange(len(place)))
    sums = sp.csr_array(entries, shape=(len(inside), len(place)))

    def total(values: np.ndarray) -> np.ndarray:
        """Sum over each family: [E, …] → [I, …]."""
        flat = sums @ values.reshape(len(place), -1)
        return np.asarray(flat.reshape(len(inside), *values.shape[1:]))

    K, outer, c2 = kw[kind], xi[:, :, None] * xi[:, None, :], d * (d + 2)
    sheared = K / (xi**2).sum(axis=1)
    shape, inverse = total(K[:, None, None] * outer), np.linalg.inv(total(outer))
    parts = []
    for field in u:
        eta = field[far] - field[owner]
        along = (xi * eta).sum(axis=1)
        theta = d / m * total(K * along)
        stress = ((lam - mu) * d / m * theta)[:, None, None] * shape
        stress += (c2 * mu / m)[:, None, None] * total((sheared * along)[:, None, None] * outer)
        gradient = total(eta[:, :, None] * xi[:, None, :]) @ inverse
        energy = ((lam - mu) * theta**2 + c2 * mu / m * total(sheared * along**2)) / 2
        parts.append((stress, (gradient + gradient.transpose(0, 2, 1)) / 2, theta, energy))
    return NodeFields(*(np.stack(part) for part in zip(*parts)))
