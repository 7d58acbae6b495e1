"""A linear solid on one lattice as a stencil: L u(x) = Σ C(ξ) (u(x) − u(x + ξ)) (theory, T1–T2).

C(−ξ) = C(ξ) is symmetric. Every homogeneous linear material on a lattice is a stencil, and what is
proven, transferred or solved on lattices is written for stencils alone.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_peri.core.elastic import directions, orbit_grid
from warp_peri.errors import InputError
from warp_peri.points.families import HORIZON_TOLERANCE

DIRECTIONS = {2: 60, 3: 200}
"""Of long waves."""
LONG = 1e-3
"""Their |k| h."""
MOST_BONDS = 4000
"""Of a half family; a horizon beyond it is a slip of units."""


@dataclass(frozen=True, eq=False)
class Stencil:
    """A linear solid, or a conductor of one component, on one lattice.

    Attributes:
        spacing: h [length].
        steps: ξ/h of one half of the bonds, shape [H, d] of whole numbers.
        tensors: C(ξ) [stress/length²], shape [H, c, c], c components of the field.
    """

    spacing: float
    steps: np.ndarray
    tensors: np.ndarray

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.steps.shape[1])

    @property
    def reach(self) -> int:
        """Largest step along an axis."""
        return int(np.abs(self.steps).max())

    def symbol(self, phase: np.ndarray) -> np.ndarray:
        """D(k) = 2 Σ C(ξ) (1 − cos k·ξ) at k h = `phase`, shape [K, d]; shape [K, c, c]."""
        return np.asarray(np.tensordot(bend(phase, self.steps), self.tensors, 1))

    @cached_property
    def brackets(self) -> np.ndarray:
        """[ij, kl] = Σ C_ij ξ_k ξ_l over the half [stress], shape [c, c, d, d] (T3)."""
        xi = self.spacing * self.steps
        return np.asarray(np.einsum("nij,nk,nl->ijkl", self.tensors, xi, xi, optimize=True))

    def asymmetry(self, group: np.ndarray) -> float:
        """How far C(Rξ) = R C(ξ) Rᵗ is from holding for R [g, d, d], over the largest entry."""
        number = {tuple(s): i for i, s in enumerate(self.steps.tolist())}
        number |= {tuple(-s for s in key): i for key, i in list(number.items())}
        worst = 0.0
        for g in group:
            images = [number.get(tuple(s), -1) for s in (self.steps @ g.T).tolist()]
            if -1 in images:
                return np.inf
            turned = g @ self.tensors @ g.T
            worst = max(worst, float(np.abs(self.tensors[images] - turned).max()))
        return worst / max(float(np.abs(self.tensors).max()), 1e-300)

    def minus(self, other: Stencil, factor: float = 1.0) -> Stencil:
        """The stencil of D − factor · (symbol of another on the same lattice)."""
        steps = np.concatenate([self.steps, other.steps])
        first = steps @ (2 * int(np.abs(steps).max()) + 1) ** np.arange(steps.shape[1]) > 0
        steps = np.where(first[:, None], steps, -steps)  # ξ and −ξ are one bond
        tensors = np.concatenate([self.tensors, -factor * other.tensors])
        kept, place = np.unique(steps, axis=0, return_inverse=True)
        joined = np.zeros((len(kept), *tensors.shape[1:]))
        np.add.at(joined, place.ravel(), tensors)
        return Stencil(self.spacing, kept, joined)


def laplacian_stencil(spacing: float, dimension: int, components: int) -> Stencil:
    """The 2 d + 1-point Laplacian times the identity [1/length²]; its symbol is s(k)."""
    steps = np.eye(dimension, dtype=np.int64)
    return Stencil(spacing, steps, np.tile(np.eye(components), (dimension, 1, 1)) / spacing**2)


def squared(spacing: float, steps: np.ndarray, field: np.ndarray) -> Stencil:
    """f ∗ f of a field f(ξ) = −f(−ξ) on whole families ξ/h, each [B, d], whose symbol is
    |Σ f(ξ) sin k·ξ|² times the identity."""
    d, far = steps.shape[1], 2 * int(np.abs(steps).max())
    box = np.zeros((2 * far + 1,) * d)
    for step, f in zip(steps, field):
        np.add.at(box, tuple((step + steps + far).T), field @ f)
    at = np.indices(box.shape).reshape(d, -1).T - far
    half = (np.arange(len(at)) > len(at) // 2) & (box.ravel() != 0)
    return Stencil(spacing, at[half], box.ravel()[half, None, None] * np.eye(d))


def bend(phase: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """2 (1 − cos k·ξ) without cancellation at small k, shape [K, H]."""
    return np.asarray(4 * np.sin(phase @ steps.T / 2) ** 2)


def half_ball(reach: float, dimension: int) -> np.ndarray:
    """ξ/h of one half of the bonds with |ξ| ≤ reach h, shape [H, d].

    Raises InputError for a ball without bonds, or with more than MOST_BONDS of a half.
    """
    most = min(reach, 4.0 * MOST_BONDS) ** 2 * (1 + HORIZON_TOLERANCE) ** 2
    side = int(np.sqrt(most))
    if (2 * side + 1) ** dimension > 4 * MOST_BONDS:
        raise InputError(f"horizon: expected a few spacings, got {reach:g} of them")
    line = range(-side, side + 1)
    grid = np.array(list(itertools.product(line, repeat=dimension)), dtype=np.int64)
    square = (grid**2).sum(axis=1)
    first = grid @ (2 * side + 1) ** np.arange(dimension)[::-1] > 0  # of ξ and −ξ just one
    half: np.ndarray = grid[(square <= most) & first]
    if not len(half):
        raise InputError(f"horizon: expected at least one spacing, got {reach:g} of them")
    return half[np.argsort((half**2).sum(axis=1), kind="stable")]


def laplacian(phase: np.ndarray) -> np.ndarray:
    """s(k) h² = 4 Σ sin²(k_a h/2) at k h = `phase`, shape [K]."""
    return np.asarray(4 * (np.sin(phase / 2) ** 2).sum(axis=1))


def zone_sample(group: np.ndarray, dimension: int, intervals: int) -> np.ndarray:
    """k h of one of each orbit of a grid on the zone, and of very long waves, shape [K, d]."""
    grid = orbit_grid(intervals, group, dimension)
    axes = np.array([v for v in np.ndindex((3,) * dimension) if v != (1,) * dimension]) - 1.0
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    return np.concatenate([grid, LONG * axes, LONG * directions(DIRECTIONS[dimension], dimension)])


def ratios(
    steps: np.ndarray, tensors: np.ndarray, phase: np.ndarray, wave: np.ndarray | None = None
) -> tuple[np.ndarray, ...]:
    """Λmin D/s h^−2 at k h = `phase`, [K], and the eigenvectors it is taken at, [K, d]; `wave` is
    bend(phase, steps), where that is known."""
    symbol = np.tensordot(bend(phase, steps) if wave is None else wave, tensors, 1)
    value, vector = np.linalg.eigh(symbol)
    return value[:, 0] / laplacian(phase), vector[:, :, 0]


def q1_tensors(elastic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps [H, d] of one half and C(ξ) h² [stress], [H, d, d], of Q1 elements of C_ijkl of side h
    with two Gauss points an axis; symmetric since an element is its own image in its middle."""
    d = elastic.shape[0]
    corner = np.array(list(itertools.product((0, 1), repeat=d)))
    side = 2 * corner - 1
    stiffness = np.zeros((len(corner), d, len(corner), d))
    for point in itertools.product((-(3**-0.5), 3**-0.5), repeat=d):
        factor = (1 + side * point) / 2
        slope = np.stack(
            [side[:, a] * np.prod(np.delete(factor, a, axis=1), axis=1) for a in range(d)], axis=1
        )  # per side length, at one of 2^d points of weight 2^−d
        stiffness += np.einsum("pj,qn,ijmn->piqm", slope, slope, elastic, optimize=True) / 2**d
    found: dict[tuple[int, ...], np.ndarray] = {}
    for a, b in itertools.product(range(len(corner)), repeat=2):
        step = tuple((corner[b] - corner[a]).tolist())
        if step > (0,) * d:
            found[step] = found.get(step, np.zeros((d, d))) - stiffness[a, :, b, :]
    steps = np.array(list(found))
    tensors = np.array(list(found.values()))
    return steps, (tensors + tensors.transpose(0, 2, 1)) / 2


def central_weights(reach: int) -> np.ndarray:
    """w with u′ ≈ Σ w_m (u(m) − u(−m)) of m = 1 … reach spacings of one, of order 2 reach."""
    m = np.arange(1, reach + 1)
    ways = np.cumprod((reach + 1 - m) / (reach + m))  # r!²/((r − m)! (r + m)!)
    return np.asarray(-((-1.0) ** m) * ways / m)


def difference_tensors(elastic: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """As q1_tensors, of central differences of order 2 reach: waves err by (k h) to that power."""
    d, m, first = elastic.shape[0], np.arange(1, reach + 1), central_weights(reach)
    found = [
        (step * np.eye(d, dtype=int)[a], 2 * weight / step * elastic[:, a, :, a])
        for a in range(d)
        for step, weight in zip(m, first)
    ]
    for a, b in itertools.combinations(range(d), 2):
        mixed = elastic[:, a, :, b] + elastic[:, b, :, a]
        for (i, one), (j, two), sign in itertools.product(zip(m, first), zip(m, first), (1, -1)):
            step = i * np.eye(d, dtype=int)[a] + sign * j * np.eye(d, dtype=int)[b]
            found.append((step, sign * one * two * mixed))
    steps, tensors = (np.array(values) for values in zip(*found))
    return steps, (tensors + tensors.transpose(0, 2, 1)) / 2


@dataclass(frozen=True, eq=False)
class Basis:
    """Half of a family, ξ and −ξ being one bond, and the tensors that a group allows on it.

    Attributes:
        steps: ξ/h, shape [H, d] int64; the other half is −steps.
        basis: invariant tensors: C(ξ) = Σ_a p_a basis[a, ξ], shape [P, H, d, d].
    """

    steps: np.ndarray
    basis: np.ndarray

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.steps.shape[1])

    def symbol(self, phase: np.ndarray) -> np.ndarray:
        """2 (1 − cos k·ξ) basis at k h = `phase`, shape [K, d], summed over bonds: [K, P, d, d]."""
        count, size = self.basis.shape[:2]
        flat = self.basis.transpose(1, 0, 2, 3).reshape(size, -1)
        d = self.dimension
        return np.asarray((bend(phase, self.steps) @ flat).reshape(-1, count, d, d))

    def moments(self) -> np.ndarray:
        """[ij, kl] of each basis tensor in units of h² (T3), shape [P, d, d, d, d]."""
        x = self.steps.astype(float)
        return np.asarray(np.einsum("anij,nk,nl->aijkl", self.basis, x, x, optimize=True))


def invariant_basis(reach: float, group: np.ndarray) -> Basis:
    """The half ball and its invariant tensors under C(Rξ) = R C(ξ) Rᵗ, R of integer matrices with
    the inversion, [g, d, d]."""
    d = group.shape[1]
    steps = half_ball(reach, d)
    number = {tuple(step): i for i, step in enumerate(steps)}
    number |= {tuple(-step): i for i, step in enumerate(steps)}
    (i, j), n = np.triu_indices(d), np.arange(d * (d + 1) // 2)
    plain = np.zeros((len(n), d, d))  # an orthonormal basis of symmetric matrices
    plain[n, i, j] = plain[n, j, i] = np.where(i == j, 1.0, np.sqrt(0.5))
    seen, basis = np.zeros(len(steps), bool), []
    for first, step in enumerate(steps):
        if seen[first]:
            continue
        image = np.array([number[tuple(g @ step)] for g in group])
        seen[image] = True
        fixing = group[image == first]  # ξ and −ξ carry the same tensor
        mean = np.mean([np.kron(g, g) for g in fixing], axis=0)
        vectors, size, _ = np.linalg.svd(mean @ plain.reshape(-1, d * d).T)
        for tensor in vectors[:, : len(size)].T[size > 0.5]:
            on_bonds = np.zeros((len(steps), d, d))
            on_bonds[image] = group @ tensor.reshape(d, d) @ group.transpose(0, 2, 1)
            basis.append((on_bonds + on_bonds.transpose(0, 2, 1)) / 2)
    return Basis(steps, np.array(basis))
