"""The symmetry that data tell of a crystal (theory, T8)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_peri.core.elastic import (
    CANDIDATES,
    LEAST,
    Symmetry,
    allowed_tensors,
    point_group,
    shared_with_nodes,
)
from warp_peri.core.stencil import invariant_basis
from warp_peri.errors import InputError, warn
from warp_peri.fitting.long_waves import long_wave_equations
from warp_peri.fitting.rows import over_loads, rows
from warp_peri.points.points import Samples

AS_GOOD = 1.02
"""A group is taken while the loss with it is at most so many times that of the best group,"""
SMALL = 0.003
"""and this much of the loads."""
MUCH, MUCH_OF_ALL = 1.5, 0.01
"""The same of one that is told: data contradict it beyond that."""


def judged(
    samples: Samples, reach: float, turn: np.ndarray, normalise: bool, told: Symmetry
) -> tuple[Symmetry, float | None]:
    """The symmetry that is told, or the largest group that costs nothing; and what it costs.

    It is to cost nothing in L u = b, nor in the moduli of long waves. Each half of the samples is
    judged by the fit of the other, and the best of all groups is what others are held against:
    hundreds of numbers without symmetry fit few samples too well. The figure is the larger of both
    losses over the best, None where the data do not determine the group. A UserWarning says
    where data contradict the symmetry that is told.
    """
    d, auto = len(turn), isinstance(told, str) and told == "auto"
    if len(samples) < 2 and not auto:
        return told, None
    none = point_group(LEAST[d], d)
    least = invariant_basis(reach, none.astype(int))
    any_tensor = allowed_tensors(LEAST[d], none, turn)
    halves = [samples[n::2] for n in range(min(2, len(samples)))]
    weights = [over_loads(half) if normalise else None for half in halves]
    equations = [rows(half, least, weight=each) for half, each in zip(halves, weights)]
    R = np.concatenate([rows for rows, _ in equations])
    if auto and np.linalg.matrix_rank(R) < R.shape[1]:
        raise InputError(
            f"data: expected enough to tell {R.shape[1]} numbers without any symmetry apart; name "
            "one, or give more loads"
        )
    try:
        long = [long_wave_equations(half, any_tensor) for half in halves]
    except InputError:  # too few nodes to see long waves on
        long = []

    def losses(name: Symmetry) -> np.ndarray:
        group = point_group(name, d)
        bonds = invariant_basis(reach, shared_with_nodes(group, turn))
        allowed = allowed_tensors(name, group, turn)
        of_long = _crossed(long, np.einsum("aijkl,bijkl->ba", allowed, any_tensor)) if long else 0.0
        own = _crossed(equations, np.einsum("anij,bnij->ba", bonds.basis, least.basis))
        return np.array([own, of_long])

    found = {name: losses(name) for name in CANDIDATES[d]}
    own = None if auto else found[told] if isinstance(told, str) and told in found else losses(told)
    best = np.min([*found.values(), *([] if own is None else [own])], axis=0)
    if own is None:
        costs_nothing = (name for name in found if (found[name] <= AS_GOOD * best + SMALL).all())
        told = next(costs_nothing, LEAST[d])
        own = found[told]
    elif np.isfinite(own).all() and (own > MUCH * best + MUCH_OF_ALL).any():
        worst = int(np.argmax(own - best))
        what = ("L u = b", "the moduli of long waves")[worst]
        warn(
            f"symmetry: the data contradict what is told: in {what} it leaves {own[worst]:.1%} of "
            f"the loads, another group {best[worst]:.1%}; symmetry='auto' looks for it"
        )
    if not np.isfinite(own).all():
        return told, None
    return told, float((own / np.maximum(best, SMALL)).max())


def _crossed(equations: Sequence[tuple[np.ndarray, ...]], mix: np.ndarray) -> float:
    """‖R M p − y‖ / ‖y‖, of each part with the p of the other; of one part with its own.

    Infinite where a part does not determine p.
    """
    parts = [(R @ mix, y) for R, y in equations]
    if any(np.linalg.matrix_rank(R) < R.shape[1] for R, _ in parts):
        return np.inf
    fits = [np.linalg.lstsq(R, y)[0] for R, y in parts]
    left = np.concatenate([R @ p - y for (R, y), p in zip(parts, fits[::-1])])
    return float(np.linalg.norm(left) / np.linalg.norm(np.concatenate([y for _, y in parts])))
