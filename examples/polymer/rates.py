"""Learned laws of the rate of stress: in any flow, and in shear."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, ClassVar

import h5py
import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from examples.polymer.closure import Pairs, start_pairs
from examples.polymer.dumbbells import Ensembles
from examples.polymer.gaussian_process import GaussianProcess, fit_process
from examples.polymer.kernels.rate_tables import heun_steps
from examples.polymer.laws import IDENTITY, carried
from warp_peri import InputError
from warp_peri.files.atomic import whole_hdf5
from warp_peri.runtime import DEVICE, floats, zeros

KNOTS = 400
"""Of a table of one input."""
MARGIN = 0.25
"""How far a table goes beyond the data, in their range; further out it is constant."""
WIDER = 3.0
"""A state is outside beyond so many times the widest gap between neighbours of the data."""


@dataclass(frozen=True)
class Rates:
    """Processes of some components of the rate, beside what is known of all.

    Args:
        processes: one a component.
        kinematics: whether what the flow does to any stress is added to what they give.
        outside: "warn", "refuse" or "allow" states far from the data.
    """

    processes: tuple[GaussianProcess, ...]
    kinematics: bool
    outside: str = "warn"
    PLACES: ClassVar[tuple[int, ...]] = ()
    """The components of s that are learned."""

    @staticmethod
    def inputs(K: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Those of the processes, of the stress s = C − I: shape [n, d]."""
        raise NotImplementedError

    def known(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """What of dC/dt is not learned, shape [n, 4]."""
        raise NotImplementedError

    def learned(self, X: np.ndarray) -> list[np.ndarray]:
        """What the processes give at inputs [n, d]."""
        return [process(X) for process in self.processes]

    def rate(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """dC/dt of states [n, 4]."""
        rate = self.known(K, C)
        for place, value in zip(self.PLACES, self.learned(self.inputs(K, C - IDENTITY))):
            rate[..., place] += value
        return rate

    @cached_property
    def _cloud(self) -> tuple[cKDTree, float]:
        """Inputs of the data, scaled, and the widest gap between neighbours of them."""
        first = self.processes[0]
        tree = cKDTree(first.X / first.scale)
        gap = np.quantile(tree.query(tree.data, k=2)[0][:, 1], 0.99)
        return tree, float(max(gap, 1e-3))

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Warn or refuse outside the data; InputError for a state that is none."""
        if not np.isfinite(C).all():
            raise InputError("stress: not finite under the learned law")
        if self.outside == "allow":
            return
        tree, gap = self._cloud
        far = tree.query(self.inputs(K, C - IDENTITY) / self.processes[0].scale)[0] / gap
        if (far > WIDER).any():
            said = (
                f"{(far > WIDER).sum()} of {len(C)} states are outside the training data, the "
                f"farthest {far.max():.3g} times their spacing"
            )
            if self.outside == "refuse":
                raise InputError(said)
            warnings.warn(said, UserWarning, stacklevel=3)

    def save(self, path: str | os.PathLike[str]) -> None:
        """An HDF5 file of the processes' arrays and numbers, for `read_law`."""
        with whole_hdf5(path) as file:
            file.attrs.update(law=type(self).__name__, kinematics=self.kinematics)
            file.attrs["outside"] = self.outside
            for n, process in enumerate(self.processes):
                for name, value in asdict(process).items():
                    file[f"{n}/{name}"] = value


def read_law(path: str | os.PathLike[str]) -> Rates:
    """A law that was saved."""
    with h5py.File(path) as file:
        processes = []
        for n in range(len(file)):
            numbers = {name: value[()] for name, value in file[str(n)].items()}
            processes.append(GaussianProcess(**numbers | {"kernel": numbers["kernel"].decode()}))
        kinds = {kind.__name__: kind for kind in (RateLaw, TabulatedRateLaw, ShearLaw)}
        kinematics, outside = bool(file.attrs["kinematics"]), file.attrs["outside"]
        return kinds[file.attrs["law"]](tuple(processes), kinematics, outside)


class RateLaw(Rates):
    """Three processes of (K, s_xx, s_xy, s_yy), and what is known beside them."""

    PLACES = (0, 1, 2)

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
        if any(process.kernel != "additive" for process in self.processes):
            raise InputError("tables: expected processes with the additive kernel")
        return TabulatedRateLaw(self.processes, self.kinematics, self.outside)


class TabulatedRateLaw(RateLaw):
    """Seven cubic splines in place of each process; beyond their ends they are constant."""

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


class ShearLaw(Rates):
    """A process of (s_xy, K_xy); other components are not known and stay as they are.

    With kinematics K_xy is added: what shear does to a fluid whose s_yy is zero.
    """

    PLACES = (1,)

    @staticmethod
    def inputs(K: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(s_xy, K_xy), shape [n, 2]."""
        return np.stack([s[..., 1], K[..., 1]], axis=-1)

    def known(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """K_xy in the xy component."""
        rate = np.zeros_like(C)
        rate[..., 1] = K[..., 1] if self.kinematics else 0
        return rate


def _by_rounds(pairs: Pairs, fitted: Callable[[np.ndarray], Any], rounds: int) -> Any:
    """A law of pairs, fitted by the stresses [n, 4] that their rates belong to.

    From the second round on, increments over a window belong to its middle, where the law found
    before puts it: the noise of the data does not enter there.
    """
    s = pairs.s
    for _ in range(rounds if pairs.window > 0 else 1):
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
) -> RateLaw:
    """Learn the rate of the stress (theory, F20), from histories of gradient and stress alone.

    Args:
        records: whose K and stress are looked at, as of `read_trajectory`; or pairs made of them.
            Noise that is known is used; that of `window_pairs` is learned.
        window: intervals of one increment, each from a start of its own; pairs have theirs.
        kernel: of the processes; products of K and s need "product", or kinematics.
        kinematics: whether what the flow does to any stress is taken as known.
        outside: what happens far from the data, "warn", "refuse" or "allow".
        most: increments of records used at most, evenly chosen; pairs are all used.
        rounds: fits, of which those after the first know the middle of a window.
    """
    if isinstance(records, Pairs):
        pairs = records
    else:
        several = [records] if isinstance(records, Ensembles) else list(records)
        every = [start_pairs(record, window) for record in several]
        if len({one.window for one in every}) != 1:
            raise InputError("records: expected one or more of the same interval")
        names = ("K", "s", "rate", "noise")
        parts = {n: np.concatenate([getattr(one, n) for one in every]) for n in names}
        pairs = Pairs(window=every[0].window, **parts)
        pairs = pairs.some(pairs.spread(most))
    exact = not np.nan_to_num(pairs.noise, nan=1.0).any()
    known = None if exact or np.isnan(pairs.noise).any() else pairs.noise

    def fitted(s: np.ndarray) -> RateLaw:
        target = pairs.rate - (carried(pairs.K, s + IDENTITY) if kinematics else 0)
        X, noises = RateLaw.inputs(pairs.K, s), [None] * 3 if known is None else known.T
        processes = (
            fit_process(X, target[:, place], kernel=kernel, mean=0.0, noise=noises[place])
            for place in RateLaw.PLACES
        )
        return RateLaw(tuple(processes), kinematics, outside)

    law: RateLaw = _by_rounds(pairs, fitted, rounds)
    return law


def learn_shear(
    record: Ensembles,
    *,
    window: int = 5,
    kinematics: bool = True,
    outside: str = "warn",
    most: int = 900,
    rounds: int = 2,
) -> ShearLaw:
    """Learn from dumbbells in simple shear at several rates.

    Increments belong to the start of their window and have a known noise (theory, F16). With
    kinematics the part of the increment that the flow makes, K_xy ⟨q_y q_y⟩, is measured on the
    dumbbells and taken off: its fluctuation, √(2/N) of the whole for a relaxation time, is the
    largest noise there is (theory, F21). Without, it is known as a covariance.

    Args:
        record: of simple shear.
        window: intervals of one increment.
        kinematics, outside, rounds: as of learn_rate.
        most: windows used at most, evenly chosen.
    """
    pairs = start_pairs(record, window)
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
        return ShearLaw((process,), kinematics, outside)

    law: ShearLaw = _by_rounds(few, fitted, rounds)
    return law


def _stretch_noise(record: Ensembles, keep: np.ndarray, k: np.ndarray, window: float) -> np.ndarray:
    """Covariance of K_xy (⟨q_y q_y⟩ − 1), which forgets itself in a relaxation time (F21)."""
    ensembles = record.K.shape[1]
    t, which = keep // ensembles * window, keep % ensembles
    same = which[:, None] == which
    variance = 2 / record.count if record.count else 0.0
    return np.asarray(variance * np.outer(k, k) * np.exp(-np.abs(t[:, None] - t)) * same)
