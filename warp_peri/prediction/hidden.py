"""What every second node does not see: short waves, and bends at an edge (Q17, Q18)."""

from __future__ import annotations

import numpy as np
import scipy.fft
import scipy.sparse as sp
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import distance_transform_edt

from warp_peri.points.every_second import APART
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points

PASSED = np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0]) / 64
"""Third power of the second difference: 1 of the shortest wave, an eighth of that of four nodes."""
EVEN = 1.2
"""By how much a mean square is larger at an edge by chance."""


def lines_of(number: np.ndarray) -> np.ndarray:
    """Numbers of nodes in lines of seven along both axes, shape [L, 7]; -1 is no node."""
    rows = [sliding_window_view(number, len(PASSED), axis=a) for a in (0, 1)]
    return np.concatenate([one[(one >= 0).all(axis=-1)] for one in rows])


def passed_by(lines: np.ndarray, count: int) -> sp.csr_array:
    """The sixth difference on lines [L, 7] of `count` nodes, as a matrix."""
    ends, weights = np.arange(0, lines.size + 1, len(PASSED)), np.tile(PASSED, len(lines))
    return sp.csr_array((weights, lines.ravel(), ends), (len(lines), count))


class Bends:
    """Where a displacement bends at the edge of what is given: clamped ones do, data's do not.

    Nodes twice as far apart are held a little elsewhere, and the bend moves all that is inside.

    Args:
        points: every second node of a lattice.
    """

    def __init__(self, points: Points) -> None:
        self.inside, grid = points.interior, lattice_steps(points)[0]
        grid = grid - grid.min(axis=0)
        number = np.full(grid.max(axis=0) + 1, -1)
        number[tuple(grid.T)] = np.arange(len(grid))
        lines = lines_of(number)
        inner = self.inside[lines].sum(axis=1)
        across = (inner > 0) & (inner < len(PASSED))
        others = lines[~across]
        some = others[:: max(len(others) // max(int(across.sum()), 1), 1)]
        self.across, self.others = (passed_by(one, len(grid)) for one in (lines[across], some))

    def of(self, u: np.ndarray) -> float:
        """The sixth difference of u [C, 2] at edges beyond that elsewhere, over u inside."""
        if not self.across.shape[0]:
            return np.inf
        there, even = (
            ((one @ u) ** 2).sum() / max(one.shape[0], 1) for one in (self.across, self.others)
        )
        bent = u.shape[1] * max(there - EVEN * even, 0.0)  # each bend is along one axis
        size = np.sqrt((u[self.inside] ** 2).sum(axis=1).mean()) or 1.0
        return float(np.sqrt(bent) / size)


class Hidden:
    """What coarse nodes do not tell from long waves, of a load and of a collar.

    Args:
        points: a plain lattice in the plane.
        modulus: μ [stress].
    """

    def __init__(self, points: Points, modulus: float) -> None:
        self.inside, grid = points.interior, lattice_steps(points)[0]
        grid = grid - grid.min(axis=0)
        number = np.full(grid.max(axis=0) + 1, -1)
        number[tuple(grid.T)] = np.where(self.inside, -1, np.arange(len(grid)))
        self.passed = passed_by(lines_of(number), len(grid))
        own = grid[self.inside] - grid[self.inside].min(axis=0) + 1
        sides = own.max(axis=0) + 1
        self.shape = tuple(scipy.fft.next_fast_len(int(n), real=True) for n in sides)
        self.own = np.ravel_multi_index(tuple(own.T), self.shape)
        there = np.zeros(self.shape, bool)
        there.flat[self.own] = True
        depth = distance_transform_edt(there).flat[self.own]
        window = np.sin(np.pi / 2 * depth / depth.max()) ** 2
        self.window = (window / np.sqrt((window**2).mean()))[:, None]
        phase = [2 * np.pi * np.fft.fftfreq(self.shape[0])]
        phase.append(2 * np.pi * np.fft.rfftfreq(self.shape[1]))
        period = 2 * np.pi / APART
        posed = [k - period * np.round(k / period) for k in phase]
        short = np.logical_or.outer(*(np.abs(a - k) > 1e-9 for a, k in zip(posed, phase)))
        square = np.maximum(np.add.outer(*(k**2 for k in posed)), ((np.pi / sides) ** 2).sum())
        twice = np.full(len(phase[1]), 2.0)  # of ±k one is not computed
        twice[[0] if self.shape[1] % 2 else [0, -1]] = 1.0
        moved = points.spacing**2 / (modulus * square)
        self.weight = np.where(short, twice * moved**2, 0.0) / there.size

    def of(self, load: np.ndarray, given: np.ndarray) -> float:
        """‖e_hidden‖ of (Q17), of a load [I, 2] and of what is given on the collar, [N, 2]."""
        return float(np.hypot(self.of_load(load), self.of_collar(given)))

    def of_load(self, load: np.ndarray) -> float:
        """How far a load [I, 2] may be answered wrongly: a norm over the unknown nodes [length]."""
        field, largest = np.zeros((2, int(np.prod(self.shape))), np.float32), np.abs(load).max()
        field[:, self.own] = (load / max(float(largest), 1e-300) * self.window).T
        wave = scipy.fft.rfft2(field.reshape(2, *self.shape))
        return float(largest * np.sqrt(((wave.real**2 + wave.imag**2) * self.weight).sum()))

    def of_collar(self, given: np.ndarray) -> float:
        """The same of what is given on the collar, [N, 2]: its short waves count as deep ones."""
        if not self.passed.shape[0]:
            return 0.0
        short = self.passed @ given
        axes = given.shape[1]  # whose lines are means of one square each
        return float(np.sqrt(axes * (short**2).sum() / len(short) * np.count_nonzero(self.inside)))
