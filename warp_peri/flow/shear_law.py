"""One component of the rate in simple shear, learned from two inputs: ds_xy/dt = f(s_xy, K_xy)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.flow.cloud import Cloud
from warp_peri.flow.gaussian_process import GaussianProcess, bar, fit_process
from warp_peri.flow.learned import FORMAT, LearnedLaw
from warp_peri.flow.pairs import start_pairs
from warp_peri.flow.planar import IDENTITY
from warp_peri.flow.protocols import Ensembles, listed
from warp_peri.points.arrays import check_whole


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
