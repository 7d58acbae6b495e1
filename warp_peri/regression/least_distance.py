"""Least squares under linear inequalities, by the dual, a problem of non-negative ones."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from warp_peri.errors import InputError


def least_squares_above(A: np.ndarray, y: np.ndarray, G: np.ndarray, h: np.ndarray) -> np.ndarray:
    """The x of least |A x − y| with G x ≥ h (Lawson and Hanson 1974, chapter 23), shape [K].

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
    if not len(h):
        x: np.ndarray = np.linalg.solve(R, b)
        return x
    rows = np.linalg.solve(R.T, G.T).T
    size = np.linalg.norm(rows, axis=1)
    size[size == 0] = 1.0
    rows, gap = rows / size[:, None], (h - rows @ b) / size
    scale = np.abs(gap).max()
    if gap.max() <= 0 or scale == 0:
        return np.asarray(np.linalg.solve(R, b))
    dual = np.concatenate([rows.T, gap[None] / scale])
    wanted = np.zeros(len(dual))
    wanted[-1] = 1.0
    left = dual @ nnls(dual, wanted, maxiter=100 * len(h))[0] - wanted
    if not np.abs(left[-1]) > 1e-14:
        raise InputError("G: no x has G x ≥ h")
    return np.asarray(np.linalg.solve(R, b - scale * left[:-1] / left[-1]))
