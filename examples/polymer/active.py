"""Learning while it flows: where a flow leaves the data, dumbbells go along and data are added.

The fluid is a law in every cell, as in Closure. At times the states are compared with the law's
data. When some are outside, the gradients that the farthest cell felt since the start are given to
dumbbells, the law is learned again from all records, and the flow goes on with it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from examples.polymer import (
    Closure,
    Dumbbells,
    Ensembles,
    PlaneFlow,
    Profiles,
    homogeneous,
    shear,
    simulate,
)
from examples.polymer.laws import FlowLaw
from examples.polymer.plane import run_plane
from warp_peri import InputError


@dataclass
class Corrected:
    """A closure and a stress that is added to it, known in all cells at equal times.

    `closure`: the law in the cells; `missing`: σ [T, n, 4] to be added, at multiples of the
    interval; `interval`: t0.
    """

    closure: Closure
    missing: np.ndarray
    interval: float
    t: float = 0.0

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4] held."""
        self.t += dt
        place = min(self.t / self.interval, len(self.missing) - 1.0)
        n = min(int(place), len(self.missing) - 2)
        weight = place - n
        extra = (1 - weight) * self.missing[n] + weight * self.missing[n + 1]
        return np.asarray(self.closure.advance(kappa, dt) + extra)

    def state(self) -> np.ndarray:
        """The conformation C and the time it has reached."""
        return np.append(self.closure.state().ravel(), self.t)

    def restore(self, state: np.ndarray) -> None:
        """Go on from a conformation and a time that were kept."""
        self.closure.restore(state[:-1].reshape(self.closure.C.shape))
        self.t = float(state[-1])


def missing_stress(
    flow: PlaneFlow,
    profiles: Profiles,
    law: Any,
    replay: Callable[[np.ndarray, float], np.ndarray],
    cells: int,
) -> np.ndarray:
    """σ [T, all cells, 4] that a law lacks under the gradients of a run.

    Args:
        flow: the flow that was run.
        profiles: what it gave, recorded at equal times from 0 on.
        law: its law.
        replay: stress s [T + 1, m, 4] under gradients K [T, m, 4], each held for an interval of
            relaxation times: dumbbells, through `simulate`.
        cells: how many are replayed, evenly from wall to wall; between them it is interpolated.

    Raises InputError for fewer than 2 cells, or records that are not equally spaced.
    """
    gaps = np.diff(profiles.t)
    if cells < 2 or not np.allclose(gaps, gaps[0]):
        raise InputError("replay: expected 2 cells or more and equally spaced records")
    places = np.unique(np.linspace(0, flow.cells - 1, cells).round().astype(int))
    rate = np.diff(profiles.u, axis=1) * flow.cells
    K = flow.De * shear((rate[:-1] + rate[1:])[:, places] / 2)
    interval = float(gaps[0]) / flow.De
    C = homogeneous(law, K, interval)
    known = np.asarray(law.stress(C.reshape(-1, C.shape[-1]))).reshape(*C.shape[:2], 4)
    lacking = (replay(K, interval) - known) / flow.De
    middle = (np.arange(flow.cells) + 0.5) / flow.cells
    spread = [[np.interp(middle, middle[places], now[:, i]) for i in range(4)] for now in lacking]
    return np.moveaxis(np.array(spread), 1, 2)


def corrected_run(
    flow: PlaneFlow, law: Any, missing: np.ndarray, until: float, dt: float, every: int
) -> Profiles:
    """The flow again, with what the law lacks added."""
    closure = Closure(law, flow.De, flow.cells)
    fluid = Corrected(closure, missing, until / (len(missing) - 1))
    return run_plane(flow, fluid, until=until, dt=dt, every=every)


EARLIER = 1.5
"""Gaps of the data beyond which dumbbells are asked; warnings come at twice as many."""
STRAIN = 0.2
"""|K| Δt of a step of replayed FENE dumbbells."""


class LearnedLaw(FlowLaw, Protocol):
    """A law that knows how far a state is from its data."""

    def distance(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """In gaps of the data, shape [n]."""


class LearningClosure(Closure):
    """A law in n cells that asks for dumbbells where it has no data.

    Args:
        records: what there is at the start.
        learn: makes a law of records; the law should allow states outside its data.
        replay: a record under gradients K [T, 1, 4], each held for an interval of relaxation times,
            from rest on; `replayed` makes one.
        De: relaxation time over t0.
        n: cells.
        check_every: steps between two looks at the states; the gradient between is averaged.
        most: replays at most.
        ahead: relaxation times that the last gradient is held beyond the present, so that the flow
            does not leave the new data at once.
        beyond: gaps of the data beyond which a state is outside.

    After a run `law` is the last law, `records` all data, `asked` a row (t/De, cell, distance
    before) a replay. Laws whose state is C can be exchanged while the fluid flows: SpringLaw,
    TwistedSpringLaw and RateLaw. Raises InputError as Closure does.
    """

    law: LearnedLaw

    def __init__(
        self,
        records: list[Ensembles],
        learn: Callable[[list[Ensembles]], Any],
        replay: Callable[[np.ndarray, float], Ensembles],
        De: float,
        n: int,
        *,
        check_every: int = 25,
        most: int = 8,
        ahead: float = 4.0,
        beyond: float = EARLIER,
    ) -> None:
        self.records, self.learn, self.replay = list(records), learn, replay
        super().__init__(learn(self.records), De, n, check_every=check_every)
        self.most, self.ahead, self.beyond = most, ahead, beyond
        self.asked: list[tuple[float, int, float]] = []
        self._histories: list[np.ndarray] = []
        self._sum, self._span = np.zeros((n, 4)), 0.0

    def advance(self, kappa: np.ndarray, dt: float) -> np.ndarray:
        """σ [n, 4] after dt under κ [n, 4] held."""
        self._sum += self.De * kappa * (dt / self.De)
        self._span += dt / self.De
        sigma = super().advance(kappa, dt)
        if self.steps % self.check_every == 0:
            self._histories.append(self._sum / self._span)
            if len(self.asked) < self.most and self._ask(self._histories[-1], self._span):
                sigma = np.asarray(self.law.stress(self.C)) / self.De
            self._sum, self._span = np.zeros_like(self._sum), 0.0
        return sigma

    def state(self) -> np.ndarray:
        """Not kept: a run that learns goes through at once."""
        raise InputError("a closure that learns has no checkpoint; run it again with its law")

    def _ask(self, K: np.ndarray, interval: float) -> bool:
        distance = self.law.distance(K, self.C)
        cell = int(np.argmax(distance))
        if not distance[cell] > self.beyond:
            return False
        felt = np.array([row[cell] for row in self._histories])
        more = np.repeat(felt[-1:], math.ceil(self.ahead / interval), axis=0)
        self.records.append(self.replay(np.concatenate([felt, more])[:, None], interval))
        self.law = self.learn(self.records)
        self._march = None  # tables are those of the law before
        self.asked.append((len(felt) * interval, cell, float(distance[cell])))
        return True


def replayed(count: int, b: float | None, seed: int) -> Callable[[np.ndarray, float], Ensembles]:
    """A replay in dumbbells, each with random numbers of its own.

    `count`: of dumbbells; `b`: of FENE dumbbells, None for Hookean ones; `seed`: of the first
    replay; the next ones count on.
    """
    seeds = iter(range(seed, seed + 10**6))

    def replay(K: np.ndarray, interval: float) -> Ensembles:
        steps = max(5, math.ceil(float(np.abs(K).max()) * interval / STRAIN))
        return simulate(
            Dumbbells(K.shape[1], count, b=b, seed=next(seeds)), K, interval, steps=steps
        )

    return replay
