"""Where a learned law has data: states too far from all of them are outside."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from warp_peri.errors import InputError

OUTSIDE = ("warn", "refuse", "allow")
WIDER = 3.0
"""A state is outside beyond so many times the widest gap between neighbours of the data."""


class OutsideWarning(UserWarning):
    """A learned law was asked beyond its data."""


@dataclass(frozen=True)
class Cloud:
    """The inputs a law was trained on, shape [n, d], with the scale of each."""

    X: np.ndarray
    scale: np.ndarray

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.X / self.scale)

    @cached_property
    def gap(self) -> float:
        """The 99th percentile of the distance from a point of the data to its nearest, scaled."""
        distance = self._tree.query(self.X / self.scale, k=2)[0][:, 1]
        return float(max(np.quantile(distance, 0.99), 1e-3))

    def distance(self, X: np.ndarray) -> np.ndarray:
        """From inputs [m, d] to the nearest of the data, in gaps."""
        return np.asarray(self._tree.query(X / self.scale)[0] / self.gap)

    def check(self, X: np.ndarray, how: str) -> None:
        """Warn or refuse when inputs are more than three gaps away; how: "warn", "refuse", "allow".

        Raises InputError for "refuse", with the number of states and the farthest.
        """
        if how not in OUTSIDE:
            raise InputError(f"outside: expected warn, refuse or allow, got {how!r}")
        if how == "allow":
            return
        distance = self.distance(X)
        beyond = int((distance > WIDER).sum())
        if not beyond:
            return
        worst = X[np.argmax(distance)]
        message = (
            f"{beyond} of {len(X)} states are outside the training data, the farthest "
            f"{distance.max():.3g} times their spacing, at "
            + ", ".join(f"{value:.3g}" for value in worst)
        )
        if how == "refuse":
            raise InputError(message)
        warnings.warn(message, OutsideWarning, stacklevel=3)
