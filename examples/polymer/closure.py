"""What closes a flow: a law's stress, dumbbells carried along, pairs that start one.

Both take macroscopic numbers, the gradient κ in 1/t0 and Δt in t0, and give σ in η/t0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from examples.polymer.dumbbells import Dumbbells, Ensembles, random_planar
from examples.polymer.laws import IDENTITY, FlowLaw
from warp_peri import InputError

LARGEST_STRAIN = 0.25
"""|K| Δt of one step of a law; longer steps are divided."""


def check_time_step(dt: float, longest: float) -> None:
    """Raise InputError for a step of a flow that is none, or beyond its longest stable one [t0]."""
    if not 0 < dt <= longest * (1 + 1e-9):
        raise InputError(f"time step: expected up to {longest:.4g} t0, got {dt:g}")


class Stress(Protocol):
    """What a flow solver asks of the fluid in its cells."""

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4]."""


class Closure:
    """A law in n cells, in equilibrium at first, advanced by Heun's rule.

    Args:
        law: the law.
        De: relaxation time over t0.
        n: cells.
        check_every: steps between two checks of the state.

    `advance` raises InputError for gradients that are not finite, and what the law's check raises.
    """

    def __init__(self, law: FlowLaw, De: float, n: int, *, check_every: int = 10) -> None:
        self.law, self.De, self.check_every = law, De, check_every
        self.C, self.steps = np.tile(IDENTITY, (n, 1)), 0
        self._march = law.march(n) if hasattr(law, "march") else None

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4] held."""
        K, t = self.De * kappa, dt / self.De
        strain = float(np.abs(K).max()) * t
        if not math.isfinite(strain):
            raise InputError("velocity gradient: not finite; the flow is beyond a stable time step")
        parts = max(1, math.ceil(strain / LARGEST_STRAIN), math.ceil(t / LARGEST_STRAIN))
        if self._march is not None:
            self.C = self._march(K, self.C, t / parts, parts)
        else:
            for _ in range(parts):
                self.C = heun(self.law, K, self.C, t / parts)
        self.steps += 1
        if self.steps % self.check_every == 0:
            self.law.check(K, self.C)
        return np.asarray((self.C - IDENTITY) / self.De)


class CoupledDumbbells:
    """Dumbbells in every cell: the reference, and what a law replaces.

    With common noise all cells see the same random numbers, and differences between them are what
    the flow made; with noise of their own few dumbbells blow the flow up.
    """

    def __init__(self, dumbbells: Dumbbells, De: float) -> None:
        self.dumbbells, self.De = dumbbells, De

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4] held."""
        return (self.dumbbells.advance(self.De * kappa, dt / self.De) - IDENTITY) / self.De


def in_cells(fluid: Any, De: float, n: int) -> Stress:
    """What a flow of n cells asks for: a law, as many ensembles of dumbbells, or a `Stress`."""
    if isinstance(fluid, Dumbbells):
        if fluid.ensembles != n:
            raise InputError(f"dumbbells: expected {n} ensembles, got {fluid.ensembles}")
        return CoupledDumbbells(fluid, De)
    stress: Stress = fluid if hasattr(fluid, "advance") else Closure(fluid, De, n)
    return stress


def heun(law: FlowLaw, K: Any, C: Any, h: Any) -> Any:
    """One step of Heun's rule, h relaxation times (a number, or one for each state [n, 1])."""
    a = law.rate(K, C)
    return C + h / 2 * (a + law.rate(K, C + h * a))


def homogeneous(law: FlowLaw, K: np.ndarray, interval: float, *, parts: int = 10) -> np.ndarray:
    """C of a fluid under one gradient after another, each held for an interval.

    Args:
        law: the law.
        K: gradients, shape [T, m, 4].
        interval: relaxation times.
        parts: least steps an interval.

    Returns C at the ends of the intervals after the start itself, shape [T + 1, m, 4]. Raises
    InputError when the law's check does.
    """
    C = np.tile(IDENTITY, (K.shape[1], 1))
    states = [C]
    for now in K:
        count = max(parts, math.ceil(float(np.abs(now).max()) * interval / LARGEST_STRAIN))
        for _ in range(count):
            C = heun(law, now, C, interval / count)
        law.check(now, C)
        states.append(C)
    return np.array(states)


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
        return self.some(random.choice(len(self), n, replace=False))

    def spread(self, most: int) -> np.ndarray:
        """Numbers of at most so many, evenly from the first to the last."""
        return np.unique(np.linspace(0, len(self) - 1, min(most, len(self))).astype(int))

    def some(self, keep: np.ndarray) -> Pairs:
        """Those of these numbers."""
        return Pairs(self.K[keep], self.s[keep], self.rate[keep], self.noise[keep], self.window)


def start_pairs(record: Ensembles, window: int) -> Pairs:
    """Increments over `window` intervals, one after another, each with the stress at its start.

    Args:
        record: of dumbbells; only windows under one gradient count.
        window: intervals.

    The noise is known (theory, F16). Raises InputError for a window longer than the record.
    """
    first, K, s, rate = _windows(record, window)
    A = np.maximum(s[first] + IDENTITY, 1e-3)
    time = window * record.interval
    xx, yy, zz = A[..., 0], A[..., 2], A[..., 3]
    count = record.count if record.count else np.inf
    noise = np.stack([4 * xx, xx + yy, 4 * yy, 4 * zz], axis=-1) / (count * time)
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
    C = np.tile(IDENTITY, (n, 1))
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
