"""The parts that sums over nodes are made of, whatever the number of threads."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from warp_peri.points.families import Families

BLOCKS = 8
"""How many there are."""


@dataclass(frozen=True)
class Blocks:
    """Parts of the nodes with complete families, one after another.

    Attributes:
        ends: first node of each block, and the end of the last, shape [BLOCKS + 1].
        bonds: first bond of each and the end, on scattered points.
        spans: what the kernel reads of each: the bond that its sums begin with, and its nodes.
    """

    ends: list[int]
    bonds: list[tuple[int, int]]
    spans: wp.array[Any]


def blocks_of(families: Families, full: np.ndarray, device: str) -> Blocks:
    """Those of the nodes `full`; the sums of a lattice lie in one array, block after block."""
    ends = [len(full) * n // BLOCKS for n in range(BLOCKS + 1)]
    if families.lattice is not None:
        bounds = [-len(families.pattern) * n for n in range(BLOCKS + 1)]
    else:
        bounds = [int(families.row[full[min(end, len(full) - 1)]]) for end in ends]
        bounds[-1] = int(families.row[-1])
    table = np.stack([bounds[:-1], ends[:-1], ends[1:]], axis=1).astype(np.int32)
    spans: Any = wp.array(table, dtype=wp.vec3i, device=device)
    return Blocks(ends, list(pairwise(bounds)), spans)
