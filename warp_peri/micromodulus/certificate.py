"""A proof that D(k) ≥ c s(k) for all wave vectors, cell by cell (theory.md, T11–T13).

With it every problem on nodes of the lattice with displacement given around them has one answer.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from warp_peri.launch import in_blocks
from warp_peri.micromodulus.family import bend
from warp_peri.micromodulus.groups import canonical
from warp_peri.micromodulus.regression import laplacian, ratios, zone_sample

SAMPLE = {2: 60, 3: 20}
"""Intervals of the grid that the minimum is sampled on."""
SHARES = (0.92, 0.75, 0.5, 0.25, 0.05)
"""Of the sampled minimum, tried one after another."""
FIRST = 8
"""Cells along an axis of the zone, or of a face of directions."""
MOST_CELLS = {2: 400_000, 3: 3_000_000}
STIFFEST = {2: 120, 3: 36}
"""Intervals of the grid that the stiffest wave is looked for on."""
AT_ONCE = 100
"""Waves or cells of a block, of which ranks share many."""
DEEPEST = 24
LONG_WAVE_SHARE = 0.995
"""Of the smallest sampled Λmin Q(e)/|e|² that is proven for long waves."""
ROUNDING = 1e-13
"""Of Σ |C| that may be lost to rounding in a matrix."""


@dataclass(frozen=True)
class Certificate:
    """What was proven of a symbol, in the stress unit of its law.

    Attributes:
        proven: c with D(k) ≥ c s(k) for every k; 0 where none was found.
        sampled: the smallest Λmin D/s found on a grid.
        long_waves: q with Q(e) ≥ q |e|² for all directions e, proven; 0 where not.
        cells: looked at.
        seconds: that took.
    """

    proven: float
    sampled: float
    long_waves: float
    cells: int
    seconds: float

    @property
    def holds(self) -> bool:
        """Whether every problem with displacement given around the unknowns has one answer."""
        return self.proven > 0

    @property
    def statement(self) -> str:
        """What is proven, in one sentence."""
        if not self.holds:
            return "Nothing is proven."
        return (
            "Every static problem on any finite set of nodes of the law's lattice, with "
            "displacement given on all nodes that their bonds reach, has exactly one solution: "
            f"D(k) ≥ {self.proven:.6g} s(k) for every wave, in the law's unit of stress, "
            f"{self.proven / self.sampled:.0%} of the smallest ratio that was sampled."
        )

    def content(self) -> dict[str, Any]:
        """Plain values for a file."""
        return asdict(self)


def certify(steps: np.ndarray, tensors: np.ndarray, group: np.ndarray) -> Certificate:
    """Prove the largest share of the sampled minimum that the cells allow.

    Args:
        steps: ξ/h of one half of the bonds, shape [H, d].
        tensors: C(ξ) h² in units of stress, shape [H, d, d].
        group: integer matrices under which the law is invariant, [g, d, d]; the identity and the
            inversion alone give the proof of the whole zone.
    """
    start = time.perf_counter()
    d = steps.shape[1]
    found = in_blocks(
        lambda k: ratios(steps, tensors, k)[0], zone_sample(group, d, SAMPLE[d]), AT_ONCE
    )
    sampled = float(found.min())
    proven = long = 0.0
    cells = 0
    if sampled > 0:
        long, cells = _long_waves(steps, tensors, group)
        for share in SHARES:
            c = share * sampled
            if c < long:
                ok, more = _whole_zone(steps, tensors, group, c, long)
                cells += more
                if ok:
                    proven = c
                    break
    return Certificate(proven, sampled, long, cells, time.perf_counter() - start)


def parts(tensors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The positive and the negative part of symmetric matrices, C = C⁺ − C⁻."""
    value, vector = np.linalg.eigh(tensors)
    above, below = (
        (vector * np.maximum(sign * value, 0)[:, None]) @ vector.swapaxes(-1, -2)
        for sign in (1, -1)
    )
    return above, below


def _corners(d: int) -> np.ndarray:
    return np.array(list(itertools.product((-1.0, 1.0), repeat=d)))


def _slack(tensors: np.ndarray) -> float:
    return ROUNDING * 4 * float(np.abs(np.linalg.eigvalsh(tensors)).max(axis=1).sum())


def _long_waves(steps: np.ndarray, tensors: np.ndarray, group: np.ndarray) -> tuple[float, int]:
    """q > 0 with Q(e) ≥ q |e|² for all e, and the cells that took; 0 where none is proven (T13).

    Cells of the faces e_a = 1 of a cube. On one Q(e) − q|e|² is its value and slope at the middle
    and a quadratic rest that is at least −Σ C⁻ (t·ξ)² − q |t|².
    """
    d = steps.shape[1]
    x = steps.astype(float)
    brackets = np.einsum("nij,nk,nl->ijkl", tensors, x, x, optimize=True)
    dense = canonical_faces(np.linspace(-1, 1, {2: 2001, 3: 121}[d]), d, group, 0.0)
    Q = np.einsum("ijkl,nk,nl->nij", brackets, dense, dense, optimize=True)
    q = LONG_WAVE_SHARE * float((np.linalg.eigvalsh(Q)[:, 0] / (dense**2).sum(axis=1)).min())
    if not q > 0:
        return 0.0, 0
    half = 1 / FIRST
    line = np.arange(-1 + half, 1, 2 * half)
    cells = canonical_faces(line, d, group, half)
    negative = parts(tensors)[1]
    slack, seen, one = _slack(tensors) * d, 0, np.eye(d)
    for _ in range(DEEPEST):
        seen += len(cells)
        if not len(cells) or seen > MOST_CELLS[d]:
            break
        Q = np.einsum("ijkl,nk,nl->nij", brackets, cells, cells, optimize=True)
        base = Q - q * (cells**2).sum(axis=1)[:, None, None] * one
        face = np.argmax(cells == 1.0, axis=1)  # which entry stays 1
        low = np.full(len(cells), np.inf)
        for corner in _corners(d):
            t = np.where(np.arange(d) == face[:, None], 0.0, half * corner)
            cross = np.einsum("ijkl,nk,nl->nij", brackets, cells, t, optimize=True)
            slope = cross + np.einsum("ijkl,nl,nk->nij", brackets, cells, t, optimize=True)
            slope = (slope + slope.swapaxes(1, 2)) / 2
            slope -= 2 * q * (cells * t).sum(axis=1)[:, None, None] * one
            low = np.minimum(low, np.linalg.eigvalsh(base + slope)[:, 0])
        rest = max(_largest(negative, x @ corner) for corner in _corners(d)) + q * (d - 1)
        open_ = cells[low - rest * half**2 - slack <= 0]
        half /= 2
        fixed = np.argmax(open_ == 1.0, axis=1)
        free = np.arange(d) != fixed[:, None]
        children = [open_ + half * corner * free for corner in _corners(d)]
        cells = np.unique(np.concatenate(children), axis=0)  # corners that differ on the fixed axis
        cells = cells[canonical(cells, group, half)]
    return (0.0 if len(cells) else q), seen


def canonical_faces(line: np.ndarray, d: int, group: np.ndarray, half: float) -> np.ndarray:
    """Middles of cells on the faces e_a = 1 of a cube that may hold a direction of the cone."""
    grid = np.array(list(itertools.product(line, repeat=d - 1)))
    faces = np.concatenate([np.insert(grid, a, 1.0, axis=1) for a in range(d)])
    return np.asarray(faces[canonical(faces, group, half)])


def _largest(tensors: np.ndarray, lengths: np.ndarray) -> float:
    """Λmax Σ C lengths²."""
    return float(np.linalg.eigvalsh(np.tensordot(lengths**2, tensors, 1))[-1])


def _whole_zone(
    steps: np.ndarray, tensors: np.ndarray, group: np.ndarray, c: float, long: float
) -> tuple[bool, int]:
    """Whether D(k) ≥ c s(k) is proven for all k, and the cells that took.

    Near k = 0 since 1 − cos x ≥ x²/2 − x⁴/24 and s ≤ |k|²; elsewhere on cells, where D − c s is at
    least its value and slope at the middle less Σ |C| (η·ξ)² + c |η|².
    """
    d = steps.shape[1]
    x = steps.astype(float)
    positive, negative = parts(tensors)
    quartic = np.tensordot((x**2).sum(axis=1) ** 2, positive, 1) / 12
    radius = 0.999 * np.sqrt((long - c) / np.linalg.eigvalsh(quartic)[-1])
    corners = _corners(d)
    curved = max(_largest(positive + negative, x @ corner) for corner in corners) + c * d
    slack = _slack(tensors)
    half = np.pi / FIRST
    line = np.arange(-np.pi + half, np.pi, 2 * half)
    cells = np.array(list(itertools.product(line, repeat=d)))
    seen = 0
    for _ in range(DEEPEST):
        cells = cells[canonical(cells, group, half)]
        cells = cells[((np.abs(cells) + half) ** 2).sum(axis=1) > radius**2]
        seen += len(cells)
        if not len(cells):
            return True, seen
        if seen > MOST_CELLS[d]:
            return False, seen
        margin = curved * half**2 + slack
        left = in_blocks(partial(_failed, steps, tensors, c, half, margin), cells, AT_ONCE)
        if len(left) and float(ratios(steps, tensors, left)[0].min()) < c:
            return False, seen  # the middle of a cell shows that it is not so
        half /= 2
        cells = (left[:, None, :] + half * corners).reshape(-1, d)
    return False, seen


def _failed(
    steps: np.ndarray, tensors: np.ndarray, c: float, half: float, margin: float, cells: np.ndarray
) -> np.ndarray:
    """Those cells whose affine part less a margin is not positive definite at every corner."""
    d = steps.shape[1]
    one, flat = np.eye(d), tensors.reshape(len(tensors), -1)
    base = (bend(cells, steps) @ flat).reshape(-1, d, d)
    base -= (c * laplacian(cells) + margin)[:, None, None] * one
    sine = 2 * np.sin(cells @ steps.T)
    slopes = [
        (sine @ (steps[:, a, None] * flat)).reshape(-1, d, d)
        - (2 * c * np.sin(cells[:, a]))[:, None, None] * one
        for a in range(d)
    ]
    open_ = np.arange(len(cells))
    failed = np.zeros(len(cells), bool)
    for corner in _corners(d):
        at = base[open_] + half * sum(s * slope[open_] for s, slope in zip(corner, slopes))
        bad = np.linalg.eigvalsh(at)[:, 0] <= 0
        failed[open_[bad]] = True
        open_ = open_[~bad]
    return cells[failed]


def stiffest(steps: np.ndarray, tensors: np.ndarray) -> float:
    """No less than Λmax D(k) of any k, and a percent or two more than the largest (T21).

    Args:
        steps: one of ξ and −ξ in spacings, shape [H, d].
        tensors: C(ξ), shape [H, d, d].
    """
    d = steps.shape[1]
    intervals = STIFFEST[d]
    line = 2 * np.pi / intervals * np.arange(intervals)
    half = line[: intervals // 2 + 1]  # D(−k) = D(k)
    phase = np.stack(np.meshgrid(half, *[line] * (d - 1), indexing="ij"), axis=-1).reshape(-1, d)
    size = np.linalg.norm(tensors, 2, axis=(1, 2))
    bent = np.linalg.eigvalsh(2 * np.einsum("n,ni,nj->ij", size, steps, steps))[-1]
    values = in_blocks(
        lambda k: np.linalg.eigvalsh(np.tensordot(bend(k, steps), tensors, 1))[:, -1],
        phase,
        AT_ONCE,
    )
    return float(values.max() + bent / 2 * d * (np.pi / intervals) ** 2)
