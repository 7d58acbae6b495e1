"""Forces of a dressed sheet at finite strain by kernels, element by element (theory.md, D16)."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warp_peri.kernels.dressed.finite import gather, pull, spread
from warp_peri.launch import floats, ints, launch_slices

Filter = tuple[float, float, np.ndarray, np.ndarray]
"""What a convolution takes from neighbours along and across, and C and T of its energy."""
PAIRS = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])


class ByElements:
    """Σ over filters of Gᵗ f(G u) with the pulls f of square elements.

    Args:
        near: neighbours of each node along the axes and across, −1 where none is, [N, 8].
        corner: nodes of each element, [E, 4].
        slope: ∂₁ and ∂₂ of its shape functions at each Gauss point, [8, 4].
        weight: of a Gauss point.
        filters: convolutions and energies.
    """

    def __init__(
        self,
        near: np.ndarray,
        corner: np.ndarray,
        slope: np.ndarray,
        weight: float,
        filters: tuple[Filter, ...],
    ) -> None:
        self.count, self.elements, self.weight = len(near), len(corner), weight
        around = np.full((len(near), 4), -1)
        for k in range(4):  # the element of which a node is the k-th corner
            around[corner[:, k], k] = 4 * np.arange(len(corner)) + k
        self.near, self.corner, self.around = ints(near), ints(corner), ints(around)
        self.slope = _table(slope)
        self.filters = [
            (along, across, _table(C), _table(T[:, PAIRS[0], PAIRS[1]]))
            for along, across, C, T in filters
        ]

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """The force of fields [S, N, 2], right where all neighbours are there."""
        samples, total = len(u), np.zeros_like(u)
        given = floats(np.ascontiguousarray(u), wp.vec2d)
        nodes, force, back = (np.empty((samples, self.count, 2)) for _ in range(3))
        pulls = np.empty((samples, 4 * self.elements, 2))
        for along, across, C, T in self.filters:
            moved = floats(nodes, wp.vec2d)
            self._launch(spread, self.count, (self.near, along, across, given), moved, samples)
            each = floats(pulls, wp.vec2d)
            inputs = (self.corner, self.slope, C, T, self.weight, moved)
            self._launch(pull, self.elements, inputs, each, samples)
            summed = floats(force, wp.vec2d)
            self._launch(gather, self.count, (self.around, each), summed, samples)
            out = floats(back, wp.vec2d)
            self._launch(spread, self.count, (self.near, along, across, summed), out, samples)
            total += back
        return total

    def _launch(self, kernel: Any, count: int, inputs: Any, out: Any, samples: int) -> None:
        launch_slices(kernel, count, inputs, (out,), samples=samples, weight=4)


def _table(values: np.ndarray) -> Any:
    return floats(np.ascontiguousarray(values, dtype=float))
