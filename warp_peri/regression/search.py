"""min ‖r(θ)‖² with e(θ) = 0 and m(θ) ≥ 0 by Gauss–Newton steps (theory, 26–28).

Each step is a least squares under equalities, which are solved for, and inequalities, by the dual,
a problem of non-negative ones (Lawson and Hanson 1974, chapter 23).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.optimize import nnls

from warp_peri.errors import InputError

STEPS = 500
SETTLED = 1e-13
"""Change of the merit, relative, that counts as none."""
NO_LOSS = 1e-20
"""Of data that are in equilibrium to the last digit: nothing is gained below it."""
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-14, 1e8
"""Of the first step, of later ones, and of the last that is tried: of a column of size one."""
FELT = 1e-6
"""Of the largest column: others have this size at least."""
SAID = 1e-9
"""Of an inequality: what the equalities leave of it below this is rounding."""
ELASTIC = 1e3
"""Weight of what a step misses conditions by that none meets, beside the residual."""
DEPENDENT = 1e-10
"""Relative size of an equality that others say already."""


@dataclass(frozen=True)
class Linearised:
    """Residual r, equalities e and inequalities m at some θ [T], each with its slopes [·, T].

    Their sizes should be about one where they matter.
    """

    residual: np.ndarray
    J: np.ndarray
    equal: np.ndarray
    A: np.ndarray
    margins: np.ndarray
    M: np.ndarray

    @property
    def loss(self) -> float:
        """‖r‖²."""
        return float(self.residual @ self.residual)

    @property
    def violated(self) -> float:
        """Sum of what the conditions miss."""
        return float(np.abs(self.equal).sum() + np.maximum(-self.margins, 0).sum())


def settle(
    state: Callable[[np.ndarray], Linearised], theta: np.ndarray
) -> tuple[np.ndarray, Linearised]:
    """The optimum that is reached from θ, and its state; `violated` says how far it keeps to the
    conditions."""
    now, damping, penalty = state(theta), DAMPING, 0.0

    def merit(of: Linearised) -> float:
        return of.loss + penalty * of.violated

    for _ in range(STEPS):
        move = _step(now, damping)
        ahead = now.residual + now.J @ move
        if now.violated > 0:  # what a step costs that meets the conditions (Han, 1977)
            costs = (float(ahead @ ahead) - now.loss) / now.violated
            penalty = max(penalty, 2 * costs, now.loss)
        there = state(theta + move)
        if not merit(now) >= merit(there):  # what bends among the conditions is taken off once
            bent = replace(
                now, equal=there.equal - now.A @ move, margins=there.margins - now.M @ move
            )
            move = _step(bent, damping)
            there = state(theta + move)
        gain = merit(now) - merit(there)
        small = abs(gain) <= SETTLED * merit(now) + NO_LOSS
        if not gain >= 0:  # also of what is no number
            damping *= 10
            if small or damping > MOST_DAMPING:
                break
            continue
        theta, now = theta + move, there
        if small and damping <= LEAST_DAMPING:
            break
        damping = max(damping / 10, LEAST_DAMPING)
    return theta, now


def _step(now: Linearised, damping: float) -> np.ndarray:
    """min ‖r + J d‖² + damping ‖d / size‖² with e + A d = 0 and m + M d ≥ 0, or near to them."""
    size = 1 / felt(np.linalg.norm(now.J, axis=0))
    J, A, M = now.J * size, now.A * size, now.M * size
    J = np.vstack([J, np.sqrt(damping) * np.eye(J.shape[1])])
    right = np.append(-now.residual, np.zeros(J.shape[1]))
    start, free = particular(A, -now.equal)
    free_M, least = M @ free, -now.margins - M @ start
    turns = np.linalg.norm(free_M, axis=1) > SAID * np.linalg.norm(M, axis=1)
    J, right, M, least = J @ free, right - J @ start, free_M[turns], least[turns]
    try:
        x = least_squares_above(J, right, M, least)
    except InputError:  # no step meets all: one number more, by how much they are missed
        J = np.pad(J, [(0, 1), (0, 1)])
        J[-1, -1] = ELASTIC * max(1.0, float(np.linalg.norm(right)))
        M = np.column_stack([M, np.ones(len(M))])
        x = least_squares_above(J, np.append(right, 0.0), M, least)[:-1]
    return np.asarray((start + free @ x) * size)


def felt(sizes: np.ndarray) -> np.ndarray:
    """Sizes of columns or curvatures, the small ones taken for FELT of the largest."""
    return np.asarray(np.maximum(sizes, FELT * float(sizes.max(initial=1e-300))))


def compressed(R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As few rows with the same least squares."""
    if len(R) <= R.shape[1] + 1:
        return R, y
    factor = scipy.linalg.qr(np.column_stack([R, y]), mode="r", overwrite_a=True)[0]
    factor = factor[: R.shape[1] + 1]
    return factor[:, :-1], factor[:, -1]


def particular(A: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least x with A x = a where one is, and a basis of those of A x = 0, as columns."""
    if not len(A):
        return np.zeros(A.shape[1]), np.eye(A.shape[1])
    U, size, V = np.linalg.svd(A)
    rank = int((size > DEPENDENT * max(size.max(initial=0.0), 1e-300)).sum())
    x: np.ndarray = V[:rank].T @ ((U[:, :rank].T @ a) / size[:rank])
    return x, V[rank:].T


def least_squares_above(A: np.ndarray, y: np.ndarray, G: np.ndarray, h: np.ndarray) -> np.ndarray:
    """The x of least ‖A x − y‖ with G x ≥ h, shape [K].

    Args:
        A: of full column rank, shape [M, K].
        y: shape [M].
        G: shape [C, K].
        h: shape [C].

    Raises InputError where no x obeys, or the rank of A is not full.
    """
    Q, R = np.linalg.qr(A)
    if not R.diagonal().all():
        raise InputError("A: expected full column rank")
    b = Q.T @ y
    if len(h):
        rows = scipy.linalg.solve_triangular(R, G.T, trans="T").T
        size = np.linalg.norm(rows, axis=1)
        size[size == 0] = 1.0
        rows, gap = rows / size[:, None], (h - rows @ b) / size
        unit = np.abs(gap).max()
        if gap.max() > 0:
            dual = np.concatenate([rows.T, gap[None] / unit])
            wanted = np.zeros(len(dual))
            wanted[-1] = 1.0
            left = dual @ nnls(dual, wanted, maxiter=100 * len(h))[0] - wanted
            if not np.abs(left[-1]) > 1e-14:
                raise InputError("G: no x has G x ≥ h")
            b = b - unit * left[:-1] / left[-1]
    return np.asarray(scipy.linalg.solve_triangular(R, b))
