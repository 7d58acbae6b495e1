"""Learned laws of the rate of stress: in any flow, and in shear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any

import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline

from warp_peri.errors import InputError
from warp_peri.flow.closure import Pairs, start_pairs
from warp_peri.flow.dumbbells import Ensembles, listed
from warp_peri.flow.gaussian_process import GaussianProcess, bar, fit_process
from warp_peri.flow.laws import IDENTITY, carried
from warp_peri.flow.learned import FORMAT, Cloud, LearnedLaw
from warp_peri.kernels.flow.rate_tables import heun_steps
from warp_peri.launch import DEVICE, floats, zeros
from warp_peri.points.arrays import check_whole


class RateMarch:
    """Heun steps of n states by tables that stay on the device.

    Args:
        n: states.
        splines: one of three values for each of the seven inputs, on equal knots.
        middle: what is added to their sum, shape [3].
        kinematics: whether the flow's own part is added.
    """

    def __init__(
        self, n: int, splines: list[CubicSpline], middle: np.ndarray, kinematics: bool
    ) -> None:
        widths = np.array([spline.x[1] - spline.x[0] for spline in splines])
        powers = widths[:, None] ** np.arange(3, -1, -1)
        table = np.array([np.moveaxis(spline.c, 1, 0) for spline in splines])
        low = np.array([spline.x[0] for spline in splines])
        self._K, self._C = zeros(n, dtype=wp.vec4d), zeros(n, dtype=wp.vec4d)
        self._table = floats(np.ascontiguousarray(table * powers[:, None, :, None]), wp.vec3d)
        self._low, self._scale = floats(low), floats(1 / widths)
        heun_steps.module.load(DEVICE)
        fixed: list[Any] = [self._table, self._low, self._scale, wp.vec3d(*middle)]
        self._first = 2 + len(fixed)
        self._launch = wp.launch(
            heun_steps, dim=n, inputs=[self._K, *fixed, float(kinematics), 0.0, 0],
            outputs=[self._C], device=DEVICE, record_cmd=True,
        )  # fmt: skip

    def __call__(self, K: np.ndarray, C: np.ndarray, h: float, parts: int) -> np.ndarray:
        """C [n, 4] after `parts` steps of h relaxation times under K [n, 4] held."""
        self._K.numpy()[:] = K
        self._C.numpy()[:] = C
        self._launch.set_param_at_index(self._first, h)
        self._launch.set_param_at_index(self._first + 1, parts)
        self._launch.launch()
        return np.array(self._C.numpy())


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


@dataclass(frozen=True)
class ShearLaw(LearnedLaw, format=FORMAT, kind="shear"):
    """A process of (s_xy, K_xy); other components are not known and stay as they are.

    Args:
        process: of the rate, or of what is left of it.
        kinematics: whether K_xy is added: what shear does to a fluid whose s_yy is zero.
        outside: "warn", "refuse" or "allow" states far from the data.
        provenance: what it was learned from; plain values, for its file.
    """

    process: GaussianProcess
    kinematics: bool
    outside: str = "warn"
    provenance: dict[str, Any] = field(default_factory=dict, repr=False)
    PROCESSES = ("process",)

    @property
    def name(self) -> str:
        """The law's name in tables and figures."""
        return "learned shear rate" + (", kinematics known" if self.kinematics else "")

    @property
    def rest(self) -> np.ndarray:
        """The conformation at rest, I."""
        return IDENTITY

    def stress(self, C: np.ndarray) -> np.ndarray:
        """The stress C − I, shape [n, 4]."""
        return np.asarray(C - IDENTITY)

    def rate(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """dC/dt, of which only the xy component differs from zero."""
        rate = np.zeros_like(C)
        rate[..., 1] = self.process(np.stack([C[..., 1], K[..., 1]], axis=-1))
        rate[..., 1] += K[..., 1] if self.kinematics else 0
        return rate

    @cached_property
    def cloud(self) -> Cloud:
        """Where the training data are."""
        return Cloud(self.process.X, self.process.scale)

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Warn or refuse outside the data."""
        self.cloud.check(np.stack([C[..., 1], K[..., 1]], axis=-1), self.outside)


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
        kinematics: as above.
        outside: what happens far from the data, "warn", "refuse" or "allow".
        most: windows used at most, evenly chosen.
        rounds: fits; from the second on, increments belong to the middle of their windows.
        progress: a bar of the fits; None shows one on a terminal.

    Raises InputError for other than one record, and as start_pairs and fit_process do.
    """
    several = listed(records)
    if len(several) > 1:
        raise InputError(f"records: expected one of simple shear, got {len(several)}")
    (record,) = several
    pairs = start_pairs(record, window)
    target = pairs.rate[:, 1]
    if kinematics:
        T = len(record.K) - window + 1
        yy = np.mean([record.C[n : n + T : window, :, 2] for n in range(window + 1)], axis=0)
        target = target - (record.K[:T:window, :, 1] * yy).reshape(-1)
    keep = np.unique(np.linspace(0, len(pairs) - 1, min(most, len(pairs))).astype(int))
    k, s, noise = pairs.K[keep, 1], pairs.s[keep, 1], pairs.noise[keep, 1]
    if not kinematics:
        noise = np.diag(noise) + _stretch_noise(record, keep, k, pairs.window)
    check_whole("rounds", rounds, 1)
    law: ShearLaw
    middle = s
    for _ in bar(rounds, progress):
        X = np.stack([middle, k], axis=-1)
        process = fit_process(X, target[keep], noise=noise, mean=0.0, iterations=40)
        law = ShearLaw(process, kinematics, outside)
        slope = process(np.stack([s, k], axis=-1)) + (k if kinematics else 0)
        middle = s + pairs.window / 2 * slope
    return law


def _stretch_noise(record: Ensembles, keep: np.ndarray, k: np.ndarray, window: float) -> np.ndarray:
    """Covariance of K_xy (⟨q_y q_y⟩ − 1), which forgets itself in a relaxation time (F21)."""
    ensembles = record.K.shape[1]
    t, which = keep // ensembles * window, keep % ensembles
    same = which[:, None] == which
    variance = 2 / record.count if record.count else 0.0
    return np.asarray(variance * np.outer(k, k) * np.exp(-np.abs(t[:, None] - t)) * same)
