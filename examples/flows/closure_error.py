"""What the form of a law leaves out, carried to the velocity: more data does not show it (F32).

The gradients that some cells of a flow felt are replayed in dumbbells. What their stress differs
from the law's is added to the law's, and the flow is run again: the change of velocity estimates
the error of the first run, and the second run is the better one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri import InputError
from warp_peri.flow import Closure, PlaneFlow, Profiles, homogeneous, shear
from warp_peri.flow.plane import run_plane


@dataclass
class Corrected:
    """A closure and a stress that is added to it, known in all cells at equal times.

    Args:
        closure: the law in the cells.
        missing: σ [T, n, 4] to be added, at multiples of the interval.
        interval: t0.
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
