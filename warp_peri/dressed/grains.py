"""Which law each node of a dressed body belongs to (theory.md, D24)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.points.arrays import checked

if TYPE_CHECKING:
    from warp_peri.dressed.law import DressedSolid

Grains = tuple[Sequence["DressedSolid"], ArrayLike]
"""Laws, and the number of that which each node belongs to, [N]."""
SAME = 1e-6
"""Relative, of spacings that are one."""


def grains_of(
    solid: DressedSolid, grains: Grains | None, count: int
) -> tuple[list[DressedSolid], np.ndarray]:
    """Laws and the number of each node's own, checked."""
    if grains is None:
        return [solid], np.zeros(count, int)
    if not (isinstance(grains, tuple) and len(grains) == 2):
        raise InputError("grains: expected a pair (laws, numbers of the nodes' own)")
    laws, given = list(grains[0]), checked("grains", grains[1], float)
    number = given.astype(int)
    if given.shape != (count,) or (number != given).any():
        raise InputError(f"grains: expected {count} whole numbers, got shape {list(given.shape)}")
    if not (len(laws) and number.min() >= 0 and number.max() < len(laws)):
        raise InputError(
            f"grains: expected numbers of {len(laws)} laws, got {number.min()} to {number.max()}"
        )
    for law in laws:
        same = law.base == solid.base and abs(law.spacing / solid.spacing - 1) < SAME
        if not (
            same
            and law.units == solid.units
            and np.array_equal(law.steps, solid.steps)
            and law.tensors.shape == solid.tensors.shape
            and len(law.parts.moduli) == len(solid.parts.moduli)
        ):
            raise InputError(
                "grains: expected laws of one base, spacing, units and neighbours, with as many "
                "parts each, as from_phonons or transferred make them for other orientations"
            )
    return laws, number
