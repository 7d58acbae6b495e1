"""Stress, strain and energy density at the nodes (theory.md, 56–58)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.points.families import families_of
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike


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
    u = np.asarray(u, dtype=float)
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

    K, Kd = model.influence(r) * W, model.influence_dilatation(r) * W
    m, md = total(K * r**2), total(Kd * r**2)
    outer = xi[:, :, None] * xi[:, None, :]
    shape = total(Kd[:, None, None] * outer)
    moments = total(outer)
    parts = []
    for field in u.reshape(-1, nodes, d):
        eta = field[far] - field[owner]
        along = (xi * eta).sum(axis=1)
        theta = d / md * total(Kd * along)
        dilatational = ((model.lam - model.mu) * d / md * theta)[:, None, None] * shape
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
