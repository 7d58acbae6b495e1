"""Pairs of nodes between which a dressed body is broken (theory.md, D9, D12)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.damage.lattice_body import LatticeBody, cracked, lattice_body
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.points.arrays import checked
from warp_peri.points.points import Points


def torn(points: Points, cracks: Sequence[ArrayLike]) -> np.ndarray:
    """Pairs of neighbouring nodes of a plane lattice that cracks part, [n, 2], for `broken`.

    Args:
        points: without a box.
        cracks: polylines [length], shape [P, 2] each.
    """
    body = lattice_body(points.x, points.spacing, 2 * points.spacing)
    return _parted(body, cracked(body, cracks))


def grown(points: Points, growth: Motion) -> np.ndarray:
    """Pairs of neighbouring nodes whose bond was cut or broke when cracks grew in the base, [n, 2].

    Args:
        points: of the body.
        growth: of its `plain` solid, move(law.plain, Cracked(points, …), events=…) (D12, C7).

    Raises InputError for another motion.
    """
    body = lattice_body(points.x, points.spacing, 2 * points.spacing)
    if np.shape(growth.details) != body.neighbour.shape:
        raise InputError("growth: expected slow growth, move(…, events=…), on these points")
    return _parted(body, np.asarray(growth.details))


def _parted(body: LatticeBody, neighbour: np.ndarray) -> np.ndarray:
    cut = (neighbour < 0) & (body.neighbour >= 0)
    node, bond = np.nonzero(cut & (body.r < 1.5 * body.spacing))
    other = body.neighbour[node, bond]
    return np.stack([node, other], axis=1)[node < other]


def pairs(broken: ArrayLike | None, count: int) -> np.ndarray:
    """Pairs of nodes as one number each, whichever stands first."""
    if broken is None:
        return np.zeros(0, int)
    given = checked("broken", broken, float)
    whole = given.astype(int)
    if given.ndim != 2 or given.shape[1] != 2 or (whole != given).any():
        raise InputError(f"broken: expected pairs of nodes [n, 2], got {list(given.shape)}")
    if len(given) and not (whole.min() >= 0 and whole.max() < count):
        raise InputError(f"broken: expected numbers of nodes below {count}")
    return np.unique(key(whole[:, 0], whole[:, 1], count))


def key(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """One number a pair, the same for both orders."""
    return np.asarray(np.minimum(first, second) * count + np.maximum(first, second))
