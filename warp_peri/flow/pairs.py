"""Records into what a rate is learned from: gradient, stress, rate, and the rate's noise.

An increment over a window belongs to the state at its start: given that state its noise has mean
zero and a known variance. Paired with the mean over the window, as printed, the noise of the two
is the same and the rate is biased (theory, F16).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.flow.closure import heun
from warp_peri.flow.laws import FlowLaw
from warp_peri.flow.planar import IDENTITY
from warp_peri.flow.protocols import Ensembles, random_planar


@dataclass(frozen=True)
class Pairs:
    """Samples of a rate, in relaxation times and n k T, all of shape [n, 4].

    Args:
        K: gradients.
        s: stresses.
        rate: of the stress.
        noise: variance of the rate, 0 where it is exact, NaN where it is not known.
        window: over which the rate was taken, from s on; 0 where s is in its middle.
    """

    K: np.ndarray
    s: np.ndarray
    rate: np.ndarray
    noise: np.ndarray
    window: float

    def __len__(self) -> int:
        return len(self.K)

    def choose(self, n: int, random: np.random.Generator) -> Pairs:
        """n of them at random. Raises InputError when there are fewer."""
        if n > len(self):
            raise InputError(f"pairs: expected at most {len(self)}, got {n}")
        return self._some(random.choice(len(self), n, replace=False))

    def evenly(self, most: int) -> Pairs:
        """At most so many, evenly from the first to the last."""
        return self._some(
            np.unique(np.linspace(0, len(self) - 1, min(most, len(self))).astype(int))
        )

    def _some(self, keep: np.ndarray) -> Pairs:
        return Pairs(self.K[keep], self.s[keep], self.rate[keep], self.noise[keep], self.window)

    def joined(self, other: Pairs) -> Pairs:
        """These and the others. Raises InputError for pairs of another window."""
        if other.window != self.window:
            raise InputError("pairs: expected the same window")
        return Pairs(
            np.concatenate([self.K, other.K]), np.concatenate([self.s, other.s]),
            np.concatenate([self.rate, other.rate]), np.concatenate([self.noise, other.noise]),
            self.window,
        )  # fmt: skip


def start_pairs(record: Ensembles, window: int, *, largest: float | None = None) -> Pairs:
    """Increments over `window` intervals, one after another, each with the stress at its start.

    Args:
        record: of dumbbells; only windows under one gradient count.
        window: intervals.
        largest: standard deviation of the rate of s_xy that is asked for, in the mean over pairs.

    Raises InputError for a window longer than the record, or too few dumbbells for the noise asked,
    with the number that would do.
    """
    first, K, s, rate = _windows(record, window)
    A = np.maximum(s[first] + IDENTITY, 1e-3)
    time = window * record.interval
    xx, yy, zz = A[..., 0], A[..., 2], A[..., 3]
    count = record.count if record.count else np.inf
    noise = np.stack([4 * xx, xx + yy, 4 * yy, 4 * zz], axis=-1) / (count * time)
    deviation = float(np.sqrt(noise[..., 1].mean()))
    if largest is not None and deviation > largest:
        wanted = int(np.ceil(record.count * (deviation / largest) ** 2))
        raise InputError(
            f"noise: expected a deviation of at most {largest:.3g}, got {deviation:.3g} with "
            f"{record.count} dumbbells and windows of {time:g}; {wanted} dumbbells would do"
        )
    parts = [part.reshape(-1, 4) for part in (K, s[first], rate, noise)]
    return Pairs(parts[0], parts[1], parts[2], parts[3], time)


def window_pairs(record: Ensembles, window: int) -> Pairs:
    """The printed pairing: mean stress over a window, end differences, noise not known."""
    first, K, s, rate = _windows(record, window)
    mean = np.mean([s[first + n] for n in range(window + 1)], axis=0)
    parts = [part.reshape(-1, 4) for part in (K, mean, rate, np.full_like(rate, np.nan))]
    return Pairs(parts[0], parts[1], parts[2], parts[3], 0.0)


def exact_pairs(law: FlowLaw, K: np.ndarray, C: np.ndarray) -> Pairs:
    """The rate of a law whose stress is C − I, at states [n, 4]."""
    return Pairs(K, C - IDENTITY, law.rate(K, C), np.zeros_like(C), 0.0)


def reached(law: FlowLaw, n: int, largest: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(K, C) of mixed flows: C after two random planar gradients, K the second; shapes [n, 4]."""
    random = np.random.default_rng(seed)
    C = np.tile(law.rest, (n, 1))
    for _ in range(2):
        K = random_planar(n, largest, random)
        time = random.uniform(0, 3, (n, 1))
        for _ in range(200):
            C = heun(law, K, C, time / 200)
    return K, C


def _windows(
    record: Ensembles, window: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    T = len(record.K)
    if not 1 <= window <= T:
        raise InputError(f"window: expected 1 to {T} intervals, got {window}")
    first = np.arange(0, T - window + 1, window)
    same = [n for n in first if (record.K[n : n + window] == record.K[n]).all()]
    first = np.array(same, dtype=int)
    s = record.stress
    return first, record.K[first], s, (s[first + window] - s[first]) / (window * record.interval)
