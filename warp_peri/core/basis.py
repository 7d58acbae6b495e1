"""Bonds of a family, and the tensors on them that a point group allows (theory.md, T5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_peri.core.stencil import bend, half_ball


@dataclass(frozen=True, eq=False)
class Basis:
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


def symmetric_matrices(dimension: int) -> np.ndarray:
    """An orthonormal basis of symmetric matrices, shape [d (d + 1)/2, d, d]."""
    found = []
    for i in range(dimension):
        for j in range(i, dimension):
            one = np.zeros((dimension, dimension))
            one[i, j] = one[j, i] = 1.0 if i == j else np.sqrt(0.5)
            found.append(one)
    return np.array(found)


def invariant_basis(reach: float, group: np.ndarray) -> Basis:
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
    return Basis(steps, np.array(basis), orbit)
