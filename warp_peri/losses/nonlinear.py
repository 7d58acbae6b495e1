"""The reduced regression of the nonlinear solid: a few more columns, projected out (N11–N12).

The residual is affine in t3, tq2 and q3 too, and in the λ and μ of the geometric terms. With the
columns of the constants first in the QR factorisation, the rows below theirs are the loss of the
linear solid at the best constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.launch import floats
from warp_peri.losses.reduced import Features, ReducedLoss, with_rows
from warp_peri.operator.gradient_sweeps import GradientSweeps
from warp_peri.points.axis import axis_of
from warp_peri.points.families import BondClasses
from warp_peri.points.samples import Samples

_BLOCK_BYTES = 2**27
CONSTANTS = 3
"""Columns of t3, tq2 and q3, the first ones."""


@dataclass(frozen=True)
class GradientLoss:
    """The loss of a nonlinear solid with given p_in and p_out on one lattice.

    Attributes:
        classes: bond classes of the lattice.
        R: triangular factor of the columns t3, tq2, q3, the F linear ones, λ and μ of the
            geometric terms, and −b: shape [F + 6, F + 6].
        pairs: class numbers of each quadratic feature, shape [2, C (C + 1) / 2].
    """

    classes: BondClasses
    R: np.ndarray
    pairs: np.ndarray

    def reduced(self, lam: float, mu: float) -> ReducedLoss:
        """The loss of the linear part, geometric terms at λ, μ [TPa], constants at their best."""
        rows = self.R[CONSTANTS:, CONSTANTS:]
        right = rows[:, -3:] @ (lam, mu, 1.0)
        folded = np.column_stack([rows[:, :-3], right])
        return ReducedLoss(self.classes, np.asarray(np.linalg.qr(folded, mode="r")), self.pairs)

    def constants(self, products: np.ndarray, lam: float, mu: float) -> np.ndarray:
        """The best t3, tq2 and q3 [TPa] beside c of (17), shape [F + 1]; back-substitution."""
        others = np.concatenate([products[:-1], (lam, mu, 1.0)])
        top = self.R[:CONSTANTS]
        best: np.ndarray = np.linalg.solve(top[:, :CONSTANTS], -top[:, CONSTANTS:] @ others)
        return best

    def loss(self, constants: np.ndarray, products: np.ndarray, lam: float, mu: float) -> float:
        """Σ_s weight_s ‖L u − b‖² of any constants."""
        e = self.R @ np.concatenate([constants, products[:-1], (lam, mu, 1.0)])
        return float(e @ e)


class NonlinearFeatures:
    """What t3, tq2, q3, λ and μ of Ψ do to L u, each at 1, on one lattice.

    Args:
        points: the lattice, which states the axis of the crystal.
        horizon: δ [Å].
        weights: p_in and p_out by class, each of shape [C].
    """

    def __init__(
        self,
        points: Samples,
        horizon: float,
        weights: tuple[np.ndarray, np.ndarray],
    ) -> None:
        self.sweeps = GradientSweeps(points, horizon)
        none = np.zeros_like(weights[0])
        self.bonds = self.sweeps.bonds(2 * np.stack([none, none, *weights]))
        turned = np.exp(-6j * axis_of(points))
        self.numbers = np.zeros((5, 6))
        self.numbers[[0, 1, 3, 4], [2, 3, 0, 1]] = 1.0
        self.numbers[2, 4:] = turned.real, turned.imag

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Columns of u [Å], shape [S, N, 2], in the order above: shape [S, I, 5, 2]."""
        sweeps = self.sweeps
        field = floats(np.ascontiguousarray(u), sweeps.kernels.vec)
        columns = []
        for numbers in self.numbers:
            columns.append(sweeps.force(field, self.bonds, 0.0, numbers, 0.0).numpy())
        return np.stack(columns, axis=2)


def reduce_nonlinear(
    sets: Sequence[Samples],
    horizon: float,
    sample_weights: Sequence[np.ndarray],
    weights: tuple[np.ndarray, np.ndarray],
) -> GradientLoss:
    """Sweep data once and factorise their features.

    Args:
        sets: samples on lattices of one spacing, each with an axis of the crystal.
        horizon: δ [Å].
        sample_weights: of each sample of each set in the loss, shape [S].
        weights: p_in and p_out by class, each of shape [C].

    Raises InputError for sets of several spacings or without the collar.
    """
    spacings = sorted({points.spacing for points in sets})
    if len(spacings) != 1:
        raise InputError(f"points: expected lattices of one spacing, got {spacings}")
    R = np.zeros((0, 0))
    for points, weight in zip(sets, sample_weights):
        features = Features(points, horizon)
        nonlinear = NonlinearFeatures(points, horizon, weights)
        columns = features.width + 6
        R = R if R.size else np.zeros((0, columns))
        block = max(1, _BLOCK_BYTES // (16 * columns * np.count_nonzero(points.interior)))
        for first in range(0, len(points), block):
            some = slice(first, first + block)
            more = nonlinear(points.u[some])
            parts = [more[:, :, :3], features(points.u[some]), more[:, :, 3:]]
            parts.append(-points.loads[some][:, points.interior, None, :])
            rows = np.concatenate(parts, axis=2) * np.sqrt(weight[some, None, None, None])
            R = with_rows(R, rows.transpose(0, 1, 3, 2).reshape(-1, columns))
    return GradientLoss(features.classes, R, features.pairs)
