"""The rate of the stress learned as it is printed: Gaussian processes of seven raw components.

ds/dt = f(K_xx, K_xy, K_yx, K_yy, s_xx, s_xy, s_yy), one process for each of s_xx, s_xy, s_yy, in
relaxation times and n k T, so that one law serves every De. With `kinematics` what the flow does
to any stress, K s + s Kᵗ + K + Kᵗ, is taken as known and the rest is learned (theory, F20).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from warp_peri.errors import InputError
from warp_peri.flow.cloud import Cloud
from warp_peri.flow.gaussian_process import GaussianProcess, bar, fit_process
from warp_peri.flow.learned import FORMAT, LearnedLaw
from warp_peri.flow.pairs import Pairs, start_pairs
from warp_peri.flow.planar import IDENTITY, carried
from warp_peri.flow.protocols import Ensembles, listed
from warp_peri.flow.rate_march import RateMarch
from warp_peri.points.arrays import check_whole

PLACES = (0, 1, 2)
"""The components of s that are learned; s_zz relaxes by itself, −s_zz."""
KNOTS = 400
"""Of a table of one input."""
MARGIN = 0.25
"""How far a table goes beyond the data, in their range; further out it is constant."""


def inputs(K: Any, s: Any) -> np.ndarray:
    """The seven components, shape [n, 7]."""
    return np.concatenate([K, s[..., :3]], axis=-1)


@dataclass(frozen=True)
class RateLaw(LearnedLaw, format=FORMAT, kind="rate"):
    """Three processes, and what is known beside them.

    Args:
        processes: of the rates of s_xx, s_xy, s_yy.
        kinematics: whether K s + s Kᵗ + K + Kᵗ is added to what they give.
        outside: "warn", "refuse" or "allow" states far from the data.
        provenance: what it was learned from; plain values, for its file.
    """

    processes: tuple[GaussianProcess, GaussianProcess, GaussianProcess]
    kinematics: bool
    outside: str = "warn"
    provenance: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def learned_from(self) -> tuple[GaussianProcess, ...]:
        """Its processes."""
        return self.processes

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """As it is: processes are a field of their own."""
        return content

    @property
    def name(self) -> str:
        """The law's name in tables and figures."""
        known = ", kinematics known" if self.kinematics else ""
        return f"learned rate, {self.processes[0].kernel} kernel{known}"

    @property
    def rest(self) -> np.ndarray:
        """I: the state is C = I + s."""
        return IDENTITY

    def stress(self, C: np.ndarray) -> np.ndarray:
        """The stress C − I, shape [n, 4]."""
        return np.asarray(C - IDENTITY)

    def learned(self, X: np.ndarray) -> list[np.ndarray]:
        """What the processes give at inputs [n, 7]."""
        return [process(X) for process in self.processes]

    def rate(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """dC/dt of states [n, 4]."""
        s = C - IDENTITY
        known = carried(K, C) if self.kinematics else np.zeros_like(C)
        for place, value in zip(PLACES, self.learned(inputs(K, s))):
            known[..., place] += value
        known[..., 3] -= s[..., 3]
        return np.asarray(known)

    @cached_property
    def cloud(self) -> Cloud:
        """Where the training data are."""
        process = self.processes[0]
        return Cloud(process.X, process.scale)

    def distance(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """How far states [n, 4] are from the data, in gaps, shape [n]."""
        return self.cloud.distance(inputs(K, C - IDENTITY))

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Warn or refuse outside the data; InputError for stresses that are not finite."""
        if not np.isfinite(C).all():
            raise InputError("stress: not finite under the learned law")
        self.cloud.check(inputs(K, C - IDENTITY), self.outside)

    def tabulated(self) -> TabulatedRateLaw:
        """The same law by tables, of the additive kernel. Raises InputError for another."""
        return TabulatedRateLaw(self.processes, self.kinematics, self.outside, self.provenance)


@dataclass(frozen=True)
class TabulatedRateLaw(RateLaw):
    """Seven cubic splines in place of each process; beyond their ends they are constant."""

    def __post_init__(self) -> None:
        if any(process.kernel != "additive" for process in self.processes):
            raise InputError("tables: expected processes with the additive kernel")

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        X = self.processes[0].X
        low, high = X.min(axis=0), X.max(axis=0)
        more = MARGIN * (high - low) + 1e-9
        return low - more, high + more

    @cached_property
    def _splines(self) -> list[CubicSpline]:
        """For each input a spline with three values: what it adds to those at the middle."""
        low, high = self._ends
        splines = []
        for i, (a, b) in enumerate(zip(low, high)):
            X = np.tile((low + high) / 2, (KNOTS, 1))
            X[:, i] = np.linspace(a, b, KNOTS)
            values = np.array([process(X) for process in self.processes]) - self._middle[:, None]
            splines.append(CubicSpline(X[:, i], values.T))
        return splines

    @cached_property
    def _middle(self) -> np.ndarray:
        low, high = self._ends
        return np.array([process((low + high)[None] / 2)[0] for process in self.processes])

    def learned(self, X: np.ndarray) -> list[np.ndarray]:
        """What the tables give at inputs [n, 7]."""
        X = np.clip(X, *self._ends)
        total = np.sum([table(x) for table, x in zip(self._splines, X.T)], axis=0)
        return list(total.T + self._middle[:, None])

    def march(self, n: int) -> RateMarch:
        """Heun steps of n states in one launch."""
        return RateMarch(n, self._splines, self._middle, self.kinematics)


def learn_rate(
    records: Ensembles | Sequence[Ensembles] | Pairs,
    *,
    window: int = 2,
    kernel: str = "additive",
    kinematics: bool = True,
    outside: str = "warn",
    most: int = 1000,
    rounds: int = 3,
    progress: bool | None = None,
) -> RateLaw:
    """Learn the rate of the stress, from histories of gradient and stress alone.

    Args:
        records: whose K and S are looked at, as of `read_trajectory`; or pairs made of them. Noise
            that is known is used; that of `window_pairs` is learned.
        window: intervals of one increment, each from a start of its own; pairs have theirs.
        kernel: of the processes; products of K and s need "second" or "product", or kinematics.
        kinematics: whether what the flow does to any stress is taken as known.
        outside: what happens far from the data, "warn", "refuse" or "allow".
        most: increments of records used at most, evenly chosen; pairs are all used.
        rounds: fits; from the second on, increments over a window belong to its middle, where the
            law found before puts it: the noise of the data does not enter there.
        progress: a bar of the fits; None shows one on a terminal.

    Raises InputError for no records, and as start_pairs and fit_process do.
    """
    if isinstance(records, Pairs):
        pairs = records
    else:
        every = [start_pairs(record, window) for record in listed(records)]
        pairs = reduce(Pairs.joined, every).evenly(most)
    law: RateLaw
    s = pairs.s
    exact = not np.nan_to_num(pairs.noise, nan=1.0).any()
    known = None if exact or np.isnan(pairs.noise).any() else pairs.noise
    check_whole("rounds", rounds, 1)
    for _ in bar(rounds if pairs.window > 0 else 1, progress):
        target = pairs.rate - (carried(pairs.K, s + IDENTITY) if kinematics else 0)
        X = inputs(pairs.K, s)
        processes = tuple(
            fit_process(
                X, target[:, place], kernel=kernel, mean=0.0,
                noise=None if known is None else known[:, place],
            )
            for place in PLACES
        )  # fmt: skip
        law = RateLaw(processes, kinematics, outside)  # type: ignore[arg-type]
        s = pairs.s + pairs.window / 2 * law.rate(pairs.K, pairs.s + IDENTITY)
    return law
