"""What closes a flow: a law's stress, dumbbells carried along, pairs that start one.

Both take macroscopic numbers, the gradient κ in 1/t0 and Δt in t0, and give σ in η/t0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from examples.polymer.dumbbells import Dumbbells, Ensembles, random_planar
from examples.polymer.laws import IDENTITY, FlowLaw
from examples.polymer.learned import Checked
from warp_peri.contract import offered
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import fingerprint
from warp_peri.points.arrays import check_positive, check_whole

March = Callable[[np.ndarray, np.ndarray, float, int], np.ndarray]
"""C after some steps of Heun's rule: of K [n, 4], C [n, 4], relaxation times a step, steps."""


LARGEST_STRAIN = 0.25
"""|K| Δt of one step of a law; longer steps are divided."""


def check_time_step(dt: float, longest: float) -> None:
    """Raise InputError for a step of a flow that is none, or beyond its longest stable one [t0]."""
    if not 0 < dt <= longest * (1 + 1e-9):
        raise InputError(f"time step: expected up to {longest:.4g} t0, got {dt:g}")


class Stress(Protocol):
    """What a flow solver asks of the fluid in its cells.

    A `key`, where it has one, says in a checkpoint which fluid it is.
    """

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4]."""

    def state(self) -> np.ndarray:
        """What a checkpoint keeps of it, an array."""

    def restore(self, state: np.ndarray) -> None:
        """Go on from a state that was kept."""


@runtime_checkable
class Marching(Protocol):
    """A law that advances many cells at once by itself."""

    def march(self, n: int) -> March:
        """Prepare the memory of n cells."""


class Closure:
    """A law in n cells, advanced by Heun's rule.

    Args:
        law: the law.
        De: relaxation time over t0.
        n: cells.
        check_every: steps between two checks of the state.

    Raises InputError for a De that is not positive or a check_every below 1; `advance` raises what
    the law's check raises, and for gradients of another number of cells.
    """

    def __init__(self, law: FlowLaw, De: float, n: int, *, check_every: int = 10) -> None:
        check_positive("De", De)
        check_whole("check_every", check_every, 1)
        self.law, self.De, self.check_every = law, De, check_every
        self.C = np.tile(law.rest, (n, 1))
        self.steps, self._check = 0, Checked()
        self._march = law.march(n) if isinstance(law, Marching) else None

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4] held."""
        if kappa.shape != (len(self.C), 4):
            raise InputError(
                f"velocity gradient: expected shape [{len(self.C)}, 4], got {list(kappa.shape)}"
            )
        K, t = self.De * kappa, dt / self.De
        strain = float(np.abs(K).max()) * t
        if not math.isfinite(strain):
            raise InputError("velocity gradient: not finite; the flow is beyond a stable time step")
        parts = max(1, math.ceil(strain / LARGEST_STRAIN), math.ceil(t / LARGEST_STRAIN))
        h = t / parts
        if self._march is not None:
            self.C = self._march(K, self.C, h, parts)
        else:
            for _ in range(parts):
                self.C = heun(self.law, K, self.C, h)
        self.steps += 1
        if self.steps % self.check_every == 0:
            self._check(self.law, K, self.C)
        return np.asarray(self.law.stress(self.C)) / self.De

    @property
    def key(self) -> str:
        """What the run depends on: De and the law's numbers."""
        return f"De {self.De}, law {fingerprint(self.law)[:16]}"

    def state(self) -> np.ndarray:
        """The conformation C of the cells, shape [n, 4]."""
        return self.C.copy()

    def restore(self, state: np.ndarray) -> None:
        """Go on from a conformation that was kept."""
        self.C = state.copy()


class CoupledDumbbells:
    """Dumbbells in every cell: the reference, and what a law replaces.

    With common noise all cells see the same random numbers, and differences between them are what
    the flow made (theory, F4); with noise of their own few dumbbells blow the flow up.
    """

    def __init__(self, dumbbells: Dumbbells, De: float) -> None:
        self.dumbbells, self.De = dumbbells, De

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4] held."""
        moments = self.dumbbells.advance(self.De * kappa, dt / self.De)
        return np.asarray((moments.S - IDENTITY) / self.De)

    @property
    def key(self) -> str:
        """What the run depends on."""
        return f"De {self.De}, {self.dumbbells.key}"

    def state(self) -> np.ndarray:
        """The dumbbells and the number of their steps, in one row."""
        return np.concatenate([np.ravel(part) for part in self.dumbbells.state().values()])

    def restore(self, state: np.ndarray) -> None:
        """Go on from kept dumbbells with the random numbers that come next."""
        parts, first = {}, 0
        for name, part in self.dumbbells.state().items():
            parts[name] = state[first : first + part.size].astype(part.dtype).reshape(part.shape)
            first += part.size
        self.dumbbells.restore(parts)


def in_cells(material: Any, De: float, n: int) -> Stress:
    """What a flow of n cells asks for: a law or as many ensembles of dumbbells in them.

    What is in the cells of a flow already, as a Closure, is given back as it is. Raises InputError
    for what is none of them.
    """
    if hasattr(material, "rate"):
        return Closure(material, De, n)
    if hasattr(material, "moments"):
        if material.ensembles != n:
            raise InputError(f"dumbbells: expected {n} ensembles, got {material.ensembles}")
        return CoupledDumbbells(material, De)
    offered(material, "advance", "move", "a law, Dumbbells or a Closure for a flow")
    return material


def key_of(stress: Stress) -> str:
    """What a checkpoint says of a fluid: its `key`, and the shape of its state."""
    return f"fluid {getattr(stress, 'key', '')} {list(stress.state().shape)}"


def heun(law: FlowLaw, K: Any, C: Any, h: Any) -> Any:
    """One step of Heun's rule, h relaxation times (a number, or one for each state [n, 1])."""
    a = law.rate(K, C)
    return C + h / 2 * (a + law.rate(K, C + h * a))


def homogeneous(
    law: FlowLaw,
    K: np.ndarray,
    interval: float,
    *,
    start: np.ndarray | None = None,
    parts: int = 10,
) -> np.ndarray:
    """C of a fluid under one gradient after another, each held for an interval.

    Args:
        law: the law.
        K: gradients, shape [T, m, 4].
        interval: relaxation times.
        start: C [m, 4]; rest if not given.
        parts: least steps an interval.

    Returns C at the ends of the intervals after the start itself, shape [T + 1, m, 4]. Raises
    InputError when the law's check does.
    """
    C = np.tile(law.rest, (K.shape[1], 1)) if start is None else np.array(start, dtype=float)
    states, check = [C], Checked()
    for now in K:
        count = max(parts, math.ceil(float(np.abs(now).max()) * interval / LARGEST_STRAIN))
        for _ in range(count):
            C = heun(law, now, C, interval / count)
        check(law, now, C)
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

    def evenly(self, most: int) -> Pairs:
        """At most so many, evenly from the first to the last."""
        return self.some(self.spread(most))

    def some(self, keep: np.ndarray) -> Pairs:
        """Those of these numbers."""
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
