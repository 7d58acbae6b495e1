"""Losses other than the residual, as rows of the same basis: any law is learned by them."""

from __future__ import annotations

import numpy as np

KNOWN = 0.1
"""Directions of which a larger part of the data's squares than 1 − KNOWN is noise are left out."""


def without_noise(R: np.ndarray, y: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """‖R p − y‖² less ‖N p‖², what noise in u adds to it, as a square again (theory, 36–37).

    Loads carry no noise, so that the difference is a quadratic form of p that has the minimum of
    ‖√(1−ν) Vᵗ R p − (1−ν)^(−½) Uᵗ y‖² and a constant. Directions of which less than KNOWN is not
    noise count nothing; they hang on those that are looked at, so that p are to be the numbers of
    the law. No squares are subtracted, so that digits are kept.
    """
    left, size, right = np.linalg.svd(R, full_matrices=False)
    kept = size > np.finfo(float).eps * R.shape[1] * size[0]
    left, size, right = left[:, kept], size[kept], right[kept]
    root, axes = np.linalg.svd((noise @ right.T) / size)[1:]
    share = np.pad(root**2, (0, len(axes) - len(root)))
    along = axes @ (left.T @ y)
    known = 1 - share > KNOWN
    gain = np.sqrt(1 - share[known])
    form = gain[:, None] * (axes[known] * size) @ right
    along = along[known] / gain
    rest = np.sqrt(max(0.0, float(y @ y - along @ along)))  # a constant: no weight in the minimum
    return np.vstack([form, np.zeros(R.shape[1])]), np.append(along, rest)
