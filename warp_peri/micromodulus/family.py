"""Bonds of a family, and the tensors on them that a point group allows (theory.md, T5)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.families import HORIZON_TOLERANCE

MOST_BONDS = 4000
"""Of a half family; a horizon beyond it is a slip of units."""


@dataclass(frozen=True, eq=False)
class Family:
    """Half of a family, ξ and −ξ being one bond, and the tensors that a group allows on it.

    Attributes:
        steps: ξ/h, shape [H, d] int64; the other half is −steps.
        basis: invariant tensors: C(ξ) = Σ_a p_a basis[a, ξ], shape [P, H, d, d].
        orbit: number of the orbit that each bond is in, shape [H].
    """

    steps: np.ndarray
    basis: np.ndarray
    orbit: np.ndarray

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


def bend(phase: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """2 (1 − cos k·ξ) without cancellation at small k, shape [K, H]."""
    wave: np.ndarray = 4 * np.sin(phase @ steps.T / 2) ** 2
    return wave


def half_ball(reach: float, dimension: int) -> np.ndarray:
    """ξ/h of one half of the bonds with |ξ| ≤ reach h, shape [H, d].

    Raises InputError for a ball without bonds, or with more than MOST_BONDS of a half.
    """
    most = reach**2 * (1 + HORIZON_TOLERANCE) ** 2
    side = int(np.sqrt(most))
    if (2 * side + 1) ** dimension > 4 * MOST_BONDS:
        raise InputError(f"horizon: expected a few spacings, got {reach:g} of them")
    line = range(-side, side + 1)
    grid = np.array(list(itertools.product(line, repeat=dimension)), dtype=np.int64)
    square = (grid**2).sum(axis=1)
    mirror = (2 * side + 1) ** np.arange(dimension)[::-1]  # ξ before −ξ in this order
    half: np.ndarray = grid[(square <= most) & (grid @ mirror > 0)]
    if not len(half):
        raise InputError(f"horizon: expected at least one spacing, got {reach:g} of them")
    return half[np.argsort((half**2).sum(axis=1), kind="stable")]


def symmetric_matrices(dimension: int) -> np.ndarray:
    """An orthonormal basis of symmetric matrices, shape [d (d + 1)/2, d, d]."""
    found = []
    for i in range(dimension):
        for j in range(i, dimension):
            one = np.zeros((dimension, dimension))
            one[i, j] = one[j, i] = 1.0 if i == j else np.sqrt(0.5)
            found.append(one)
    return np.array(found)


def family(reach: float, group: np.ndarray) -> Family:
    """The half ball and its invariant tensors under C(Rξ) = R C(ξ) Rᵗ.

    Args:
        reach: horizon over spacing.
        group: integer matrices with the inversion, shape [g, d, d].
    """
    d = group.shape[1]
    steps = half_ball(reach, d)
    number = {tuple(step): i for i, step in enumerate(steps)}
    number |= {tuple(-step): i for i, step in enumerate(steps)}
    plain = symmetric_matrices(d).reshape(-1, d * d)
    orbit = np.full(len(steps), -1)
    basis = []
    for first, step in enumerate(steps):
        if orbit[first] >= 0:
            continue
        image = np.array([number[tuple(g @ step)] for g in group])
        orbit[image] = orbit.max() + 1
        fixing = group[image == first]  # ξ and −ξ carry the same tensor
        mean = np.mean([np.kron(g, g) for g in fixing], axis=0)
        vectors, size, _ = np.linalg.svd(mean @ plain.T)
        for tensor in vectors[:, : len(size)].T[size > 0.5]:
            on_bonds = np.zeros((len(steps), d, d))
            on_bonds[image] = group @ tensor.reshape(d, d) @ group.transpose(0, 2, 1)
            basis.append((on_bonds + on_bonds.transpose(0, 2, 1)) / 2)
    return Family(steps, np.array(basis), orbit)
