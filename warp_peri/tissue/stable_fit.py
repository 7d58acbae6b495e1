"""Least squares among sheets whose waves are stable in the strains of the data, by cutting planes.

That no wave in a uniform strain lowers the energy is a set of linear inequalities on the
coefficients, one for every strain, wave and direction, (H21). Strains and waves are samples. Of
their inequalities, those that a fit breaks worst join it until none is broken by much.
"""

from __future__ import annotations

import numpy as np

from warp_peri.errors import InputError
from warp_peri.regression.search import least_squares_above
from warp_peri.tissue.uniform_strain import UniformTangents

ROUNDS = 60
"""Of cuts."""
WORST = 3
"""Waves of a strain that join in one round."""
ROUNDING = 1e-7
"""Of the largest scaled coefficient: what is nearer to a bound is put on it."""
SLACK = 0.02
"""Part of the margin that may be missing at the end."""


def stable_coefficients(
    A: np.ndarray,
    y: np.ndarray,
    tangents: UniformTangents,
    margin: float,
    *,
    scale: np.ndarray,
    lower: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """The c of least |A c − y| that is stable on the sampled strains and waves, with c ≥ lower.

    Args:
        A: of full column rank, in coefficients times `scale`, shape [M, K].
        y: shape [M].
        tangents: of the strains.
        margin: least eigenvalue of the symbol of a wave over the Laplacian's, > 0 [stress].
        scale: of the coefficients, shape [K].
        lower: bounds, −∞ where there is none, shape [K].

    Returns:
        The coefficients, and the least ratio that they leave, at least 1 − SLACK of the margin.

    Raises InputError for a margin that is not positive and finite, or that no coefficients reach.
    """
    if not 0 < margin < np.inf:
        raise InputError(f"stable: expected a finite margin > 0, got {margin}")
    K = A.shape[1]
    if not np.diag(np.asarray(np.linalg.qr(A, mode="r"))).all():
        raise InputError("stable: expected equations of full rank, or a ridge > 0")
    least = np.full(K, -np.inf) if lower is None else lower
    bounded = np.flatnonzero(np.isfinite(least))
    G, h = np.eye(K)[bounded], (least * scale)[bounded]
    for _ in range(ROUNDS):
        try:
            c = least_squares_above(A, y, G, h) / scale
        except InputError:
            raise InputError(f"stable: no coefficients reach the margin {margin:g}") from None
        near = (c - least) * scale < ROUNDING * np.abs(c * scale).max()
        c = np.where(near, least, c)
        ratios, directions = tangents.lowest(c)
        if ratios.min() >= (1 - SLACK) * margin:
            return c, float(ratios.min())
        cuts = [
            tangents.row(n, q, directions[n, q])
            for n, of_waves in enumerate(ratios)
            for q in np.argsort(of_waves)[:WORST]
            if of_waves[q] < (1 - SLACK / 2) * margin
        ]
        G = np.concatenate([G, np.array(cuts) / scale])
        h = np.concatenate([h, np.full(len(cuts), margin)])
    raise InputError(f"stable: no coefficients of margin {margin:g} after {ROUNDS} rounds of cuts")
