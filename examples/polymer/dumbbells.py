"""Hookean dumbbells: their motion, and ensembles of them under histories of velocity gradients.

Time in relaxation times, length in units in which a dumbbell in equilibrium has ⟨q q⟩ = I, stress
in n k T (theory, F1–F3).
"""

import os
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from examples.polymer.kernels.dumbbells import advance_hookean
from examples.polymer.laws import IDENTITY
from warp_peri import InputError
from warp_peri.runtime import DEVICE, at_once, floats, get_num_threads, launch, zeros

BLOCK = 2000
"""Dumbbells a thread sums up in single precision."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


class Dumbbells:
    """Ensembles of independent dumbbells, each ensemble under a velocity gradient of its own.

    Args:
        ensembles: how many.
        count: dumbbells in each.
        seed: of start and noise; the same seed gives the same bits on any number of threads.
        common: whether all ensembles start alike and feel the same noise.

    Raises InputError for fewer than one ensemble or two dumbbells.
    """

    def __init__(self, ensembles: int, count: int, *, seed: int = 0, common: bool = False) -> None:
        if ensembles < 1 or count < 2:
            raise InputError(f"dumbbells: expected 1 × 2 or more, got {ensembles} × {count}")
        self.count, self.ensembles, self.common, self.steps = count, ensembles, common, 0
        q = np.random.default_rng(seed).standard_normal((1 if common else ensembles, count, 3))
        q = np.broadcast_to(q, (ensembles, count, 3)).astype(np.float32)
        self.q: wp.array[Any] = wp.array(np.ascontiguousarray(q), dtype=wp.vec3f, device=DEVICE)
        self._stream = int(np.random.SeedSequence([seed, 1]).generate_state(1)[0] >> 2)
        self._blocks = -(-count // BLOCK)
        self._sums = zeros(ensembles * self._blocks, 4)

    def advance(self, K: np.ndarray, dt: float) -> np.ndarray:
        """⟨q q⟩ [ensembles, 4] after dt relaxation times under K [ensembles, 4]; exact in time."""
        K = np.broadcast_to(np.asarray(K, dtype=float), (self.ensembles, 4))
        P, L = (floats(part.astype(np.float32), wp.float32) for part in propagator(K, dt))
        seed, total = (self._stream + self.steps) % 2**30, self.ensembles * self._blocks
        moves = int(dt > 0)
        self.steps += moves
        slices = min(get_num_threads(), total) if wp.get_device(DEVICE).is_cpu else 1
        ends = [total * n // slices for n in range(slices + 1)]
        advance_hookean.module.load(self.q.device)  # not from two threads at once

        def job(first: int, last: int) -> Any:
            numbers = [first, P, L, seed, moves, int(self.common), self._blocks]
            return lambda: launch(advance_hookean, last - first, [*numbers, self.q, self._sums])

        at_once([job(first, last) for first, last in pairwise(ends)])
        sums = self._sums.numpy().reshape(self.ensembles, self._blocks, -1).sum(axis=1)
        return np.asarray(sums / self.count)


def exponential(K: np.ndarray, t: float) -> np.ndarray:
    """exp(K t) of planar gradients, shape [..., 4], in closed form."""
    half = (K[..., 0] + K[..., 3]) / 2
    d = (K[..., 0] - K[..., 3]) / 2
    root = np.emath.sqrt(d * d + K[..., 1] * K[..., 2]) * t
    small = np.abs(root) < 1e-6
    ratio = np.where(small, 1 + root**2 / 6, np.sinh(root) / np.where(small, 1, root)).real * t
    grown, cosine = np.exp(half * t), np.cosh(root).real
    parts = [cosine + ratio * d, ratio * K[..., 1], ratio * K[..., 2], cosine - ratio * d]
    return np.asarray(grown[..., None] * np.stack(parts, axis=-1))


def propagator(K: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """(P, L) of the exact step (F3): q → P q + L ξ, with P [m, 5] and lower L [m, 4].

    P is (xx, xy, yx, yy, zz). The covariance L Lᵗ = ∫ e^(−t) e^(K t) e^(Kᵗt) dt by Gauss's rule
    with six nodes, which is exact to rounding where |K| Δt is below one.
    """
    damped = np.full(K.shape[:-1], np.exp(-dt / 2))
    Q = np.zeros((*K.shape[:-1], 3))
    for node, weight in zip(NODES, WEIGHTS):
        t = (node + 1) * dt / 2
        xx, xy, yx, yy = np.moveaxis(exponential(K, t), -1, 0)
        product = np.stack([xx**2 + xy**2, xx * yx + xy * yy, yx**2 + yy**2], axis=-1)
        Q += weight * dt / 2 * np.exp(-t) * product
    lxx = np.sqrt(Q[..., 0])
    lyx = Q[..., 1] / np.where(lxx > 0, lxx, 1)
    lyy = np.sqrt(np.maximum(Q[..., 2] - lyx**2, 0))
    lzz = np.full_like(lxx, np.sqrt(-np.expm1(-dt)))
    P = np.concatenate([damped[..., None] * exponential(K, dt), damped[..., None]], axis=-1)
    return P, np.stack([lxx, lyx, lyy, lzz], axis=-1)


@dataclass(frozen=True)
class Ensembles:
    """Conformations of ensembles at the ends of intervals.

    Args:
        interval: relaxation times between two rows.
        K: what was felt, shape [T, m, 4].
        C: ⟨q q⟩, shape [T + 1, m, 4]; the stress is C − I.
        count: dumbbells in an ensemble, 0 for exact moments.
    """

    interval: float
    K: np.ndarray
    C: np.ndarray
    count: int

    @property
    def stress(self) -> np.ndarray:
        """s = C − I [n k T], shape [T + 1, m, 4]."""
        return np.asarray(self.C - IDENTITY)


def held(K: np.ndarray, intervals: int) -> np.ndarray:
    """Every ensemble under one K of its own [m, 4] throughout."""
    return np.tile(np.asarray(K, dtype=float), (intervals, 1, 1))


def random_planar(n: int, largest: float, random: np.random.Generator) -> np.ndarray:
    """Gradients without trace, each component within ± largest/√2; shape [n, 4]."""
    a, b, c = random.uniform(-1, 1, (3, n)) * largest / np.sqrt(2)
    return np.stack([a, b, c, -a], axis=-1)


def mixed(m: int, intervals: int, largest: float, *, hold: int = 10, seed: int = 0) -> np.ndarray:
    """Random planar gradients, a new one every `hold` intervals: what visits mixed states."""
    random = np.random.default_rng(seed)
    pieces = -(-intervals // hold)
    drawn = random_planar(pieces * m, largest, random).reshape(pieces, m, 4)
    return np.repeat(drawn, hold, axis=0)[:intervals]


def simulate(dumbbells: Dumbbells, K: np.ndarray, interval: float) -> Ensembles:
    """Run dumbbells through gradients K [T, m, 4], each held for an interval.

    Raises InputError for K of another shape, or an interval that is not positive.
    """
    if K.ndim != 3 or K.shape[1:] != (dumbbells.ensembles, 4) or not interval > 0:
        raise InputError(f"K: expected shape [T, {dumbbells.ensembles}, 4], got {list(K.shape)}")
    rows = [dumbbells.advance(np.zeros(4), 0.0)]
    rows += [dumbbells.advance(now, interval) for now in K]
    return Ensembles(interval, K, np.array(rows), dumbbells.count)


def read_trajectory(
    path: str | os.PathLike[str], relaxation_time: float, modulus: float, count: int
) -> Ensembles:
    """A stress trajectory of any simulator, as a record of one ensemble.

    Args:
        path: text with commas; columns t, K_xx, K_xy, K_yx, K_yy (in 1/time) and the stress of the
            polymer s_xx, s_xy, s_yy, s_zz, at equal times; lines that begin with # are skipped.
        relaxation_time: in the file's unit of time.
        modulus: n k T in the file's unit of stress.
        count: molecules, which set the noise.

    Raises InputError for other columns, and times that are not equally spaced.
    """
    table = np.loadtxt(path, delimiter=",", ndmin=2)
    if table.shape[1] != 9 or len(table) < 3:
        raise InputError(f"{path}: expected 9 columns and 3 lines or more, got {table.shape}")
    gaps = np.diff(table[:, 0]) / relaxation_time
    if not (gaps[0] > 0 and np.allclose(gaps, gaps[0], rtol=1e-4)):
        raise InputError(f"{path}: expected equally spaced times")
    C = table[:, None, 5:] / modulus + IDENTITY
    return Ensembles(float(gaps[0]), table[:-1, None, 1:5] * relaxation_time, C, count)
