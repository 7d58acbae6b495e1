"""Learned laws of the rate of stress: in any flow, and in shear."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline

from examples.polymer.closure import Pairs, start_pairs
from examples.polymer.dumbbells import Ensembles, listed
from examples.polymer.gaussian_process import GaussianProcess, bar, fit_process
from examples.polymer.kernels.rate_tables import heun_steps
from examples.polymer.laws import IDENTITY, carried
from examples.polymer.learned import FORMAT, LearnedLaw
from warp_peri.errors import InputError
from warp_peri.launch import DEVICE, floats, zeros
from warp_peri.points.arrays import check_whole

KNOTS = 400
"""Of a table of one input."""
MARGIN = 0.25
"""How far a table goes beyond the data, in their range; further out it is constant."""


class Rates(LearnedLaw):
    """Processes of some components of the rate, beside what is known of all."""

    PLACES: ClassVar[tuple[int, ...]]
    """The components of s that are learned."""
    if TYPE_CHECKING:
        kinematics: bool

    @staticmethod
    def inputs(K: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Those of the processes, of the stress s = C − I: shape [n, d]."""
        raise NotImplementedError

    def known(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """What of dC/dt is not learned, shape [n, 4]."""
        raise NotImplementedError

    def features(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """Inputs in states [n, 4]."""
        return self.inputs(K, C - IDENTITY)

    def learned(self, X: np.ndarray) -> list[np.ndarray]:
        """What the processes give at inputs [n, d]."""
        return [process(X) for process in self.learned_from]

    def rate(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """dC/dt of states [n, 4]."""
        rate = self.known(K, C)
        for place, value in zip(self.PLACES, self.learned(self.features(K, C))):
            rate[..., place] += value
        return rate


@dataclass(frozen=True)
class RateLaw(Rates, format=FORMAT, kind="rate"):
    """Three processes of (K, s_xx, s_xy, s_yy), and what is known beside them.

    Args:
        processes: of the rates of s_xx, s_xy, s_yy; s_zz relaxes by itself, −s_zz.
        kinematics: whether K s + s Kᵗ + K + Kᵗ is added to what they give.
        outside, provenance: as of others.
    """

    processes: tuple[GaussianProcess, GaussianProcess, GaussianProcess]
    kinematics: bool
    PROCESSES, PLACES, TITLE = (), (0, 1, 2), "rate, {kernel} kernel"

    @staticmethod
    def inputs(K: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The seven components, shape [n, 7]."""
        return np.concatenate([K, s[..., :3]], axis=-1)

    def known(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """What the flow does to any stress, and the relaxation of s_zz."""
        rate: np.ndarray = carried(K, C) if self.kinematics else np.zeros_like(C)
        rate[..., 3] -= C[..., 3] - 1
        return rate

    def tabulated(self) -> TabulatedRateLaw:
        """The same law by tables, of the additive kernel. Raises InputError for another."""
        law: TabulatedRateLaw = self.as_law(TabulatedRateLaw)
        return law


@dataclass(frozen=True)
class TabulatedRateLaw(RateLaw):
    """Seven cubic splines in place of each process; beyond their ends they are constant."""

    def __post_init__(self) -> None:
        if any(process.kernel != "additive" for process in self.processes):
            raise InputError("tables: expected processes with the additive kernel")

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[CubicSpline]]:
        """Ends of the inputs, three values at their middle, and what each input adds to these."""
        X = self.processes[0].X
        low, high = X.min(axis=0), X.max(axis=0)
        more, splines = MARGIN * (high - low) + 1e-9, []
        low, high = low - more, high + more
        middle = self._values((low + high)[None] / 2)
        for i, (a, b) in enumerate(zip(low, high)):
            X = np.tile((low + high) / 2, (KNOTS, 1))
            X[:, i] = np.linspace(a, b, KNOTS)
            splines.append(CubicSpline(X[:, i], (self._values(X) - middle).T))
        return low, high, middle, splines

    def _values(self, X: np.ndarray) -> np.ndarray:
        return np.array(super().learned(X))

    def learned(self, X: np.ndarray) -> list[np.ndarray]:
        """What the tables give at inputs [n, 7]."""
        low, high, middle, splines = self._tables
        columns = np.clip(X, low, high).T
        return list(np.sum([table(x) for table, x in zip(splines, columns)], axis=0).T + middle)

    def march(self, n: int) -> Callable[[np.ndarray, np.ndarray, float, int], np.ndarray]:
        """Heun steps of n states in one launch, by tables that stay on the device.

        What comes back is a function of K [n, 4] held, C [n, 4], a step [relaxation times] and how
        many of them, to C after these.
        """
        low, _, middle, splines = self._tables
        widths = np.array([spline.x[1] - spline.x[0] for spline in splines])
        powers = widths[:, None] ** np.arange(3, -1, -1)
        table = np.array([np.moveaxis(spline.c, 1, 0) for spline in splines])
        held, state = zeros(n, dtype=wp.vec4d), zeros(n, dtype=wp.vec4d)
        coefficients = np.ascontiguousarray(table * powers[:, None, :, None])
        fixed: list[Any] = [held, floats(coefficients, wp.vec3d), floats(low), floats(1 / widths)]
        fixed += [wp.vec3d(*middle[:, 0]), float(self.kinematics)]
        heun_steps.module.load(DEVICE)
        launch = wp.launch(
            heun_steps, dim=n, inputs=[*fixed, 0.0, 0], outputs=[state], device=DEVICE,
            record_cmd=True,
        )  # fmt: skip

        def steps(K: np.ndarray, C: np.ndarray, h: float, parts: int) -> np.ndarray:
            held.numpy()[:], state.numpy()[:] = K, C
            launch.set_param_at_index(len(fixed), h)
            launch.set_param_at_index(len(fixed) + 1, parts)
            launch.launch()
            return np.array(state.numpy())

        return steps


@dataclass(frozen=True)
class ShearLaw(Rates, format=FORMAT, kind="shear"):
    """A process of (s_xy, K_xy); other components are not known and stay as they are.

    Args:
        process: of the rate, or of what is left of it.
        kinematics: whether K_xy is added: what shear does to a fluid whose s_yy is zero.
        outside, provenance: as of others.
    """

    process: GaussianProcess
    kinematics: bool
    PLACES, TITLE = (1,), "shear rate"

    @staticmethod
    def inputs(K: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(s_xy, K_xy), shape [n, 2]."""
        return np.stack([s[..., 1], K[..., 1]], axis=-1)

    def known(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """K_xy in the xy component."""
        rate = np.zeros_like(C)
        rate[..., 1] = K[..., 1] if self.kinematics else 0
        return rate


LAW = TypeVar("LAW", bound=Rates)


def _by_rounds(
    pairs: Pairs, fitted: Callable[[np.ndarray], LAW], rounds: int, progress: bool | None
) -> LAW:
    """A law of pairs, fitted by the stresses [n, 4] that their rates belong to.

    From the second round on, increments over a window belong to its middle, where the law found
    before puts it: the noise of the data does not enter there.
    """
    check_whole("rounds", rounds, 1)
    s = pairs.s
    for _ in bar(rounds if pairs.window > 0 else 1, progress):
        law = fitted(s)
        s = pairs.s + pairs.window / 2 * law.rate(pairs.K, pairs.s + IDENTITY)
    return law


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
        rounds: fits, of which those after the first know the middle of a window.
        progress: a bar of the fits; None shows one on a terminal.

    Raises InputError for no records, and as start_pairs and fit_process do.
    """
    if isinstance(records, Pairs):
        pairs = records
    else:
        every = [start_pairs(record, window) for record in listed(records)]
        pairs = reduce(Pairs.joined, every).evenly(most)
    exact = not np.nan_to_num(pairs.noise, nan=1.0).any()
    known = None if exact or np.isnan(pairs.noise).any() else pairs.noise

    def fitted(s: np.ndarray) -> RateLaw:
        target = pairs.rate - (carried(pairs.K, s + IDENTITY) if kinematics else 0)
        X, noises = RateLaw.inputs(pairs.K, s), [None] * 3 if known is None else known.T
        processes = (
            fit_process(X, target[:, place], kernel=kernel, mean=0.0, noise=noises[place])
            for place in RateLaw.PLACES
        )
        return RateLaw(tuple(processes), kinematics, outside=outside)  # type: ignore[arg-type]

    return _by_rounds(pairs, fitted, rounds, progress)


def learn_shear(
    records: Ensembles | Sequence[Ensembles],
    *,
    window: int = 5,
    kinematics: bool = True,
    outside: str = "warn",
    most: int = 900,
    rounds: int = 2,
    progress: bool | None = None,
) -> ShearLaw:
    """Learn from dumbbells in simple shear at several rates.

    Increments belong to the start of their window and have the known noise of (F16). With
    kinematics the part of the increment that the flow makes, K_xy ⟨q_y q_y⟩, is measured on the
    dumbbells and taken off: its fluctuation, √(2/N) of the whole for a relaxation time, is the
    largest noise there is (theory, F21). Without, it is known as a covariance.

    Args:
        records: of simple shear; one.
        window: intervals of one increment.
        kinematics, outside, rounds, progress: as of learn_rate.
        most: windows used at most, evenly chosen.

    Raises InputError for other than one record, and as start_pairs and fit_process do.
    """
    several = listed(records)
    if len(several) > 1:
        raise InputError(f"records: expected one of simple shear, got {len(several)}")
    (record,), pairs = several, start_pairs(several[0], window)
    keep, target = pairs.spread(most), pairs.rate[:, 1]
    if kinematics:
        T = len(record.K) - window + 1
        yy = np.mean([record.C[n : n + T : window, :, 2] for n in range(window + 1)], axis=0)
        target = target - (record.K[:T:window, :, 1] * yy).reshape(-1)
    few, target = pairs.some(keep), target[keep]
    noise = few.noise[:, 1]
    if not kinematics:
        noise = np.diag(noise) + _stretch_noise(record, keep, few.K[:, 1], pairs.window)

    def fitted(s: np.ndarray) -> ShearLaw:
        X = ShearLaw.inputs(few.K, s)
        process = fit_process(X, target, noise=noise, mean=0.0, iterations=40)
        return ShearLaw(process, kinematics, outside=outside)

    return _by_rounds(few, fitted, rounds, progress)


def _stretch_noise(record: Ensembles, keep: np.ndarray, k: np.ndarray, window: float) -> np.ndarray:
    """Covariance of K_xy (⟨q_y q_y⟩ − 1), which forgets itself in a relaxation time (F21)."""
    ensembles = record.K.shape[1]
    t, which = keep // ensembles * window, keep % ensembles
    same = which[:, None] == which
    variance = 2 / record.count if record.count else 0.0
    return np.asarray(variance * np.outer(k, k) * np.exp(-np.abs(t[:, None] - t)) * same)
