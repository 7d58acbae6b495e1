"""Where a learned law has data: states too far from them and faster flows are outside."""

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
FASTER = 0.1
"""A gradient is outside beyond the fastest of the data by this part of it."""


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
        if not asked(how):
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
        tell(message, how)


@dataclass(frozen=True)
class Gradients:
    """The fastest flows that a law was taught, per relaxation time.

    Args:
        strain: largest rate of stretching along an axis of the flow: γ/2 in a shear γ, ε in an
            elongation ε.
        beyond_spin: largest excess of it over the spin: 0 in shear, ε in elongation.
    """

    strain: float
    beyond_spin: float

    @classmethod
    def of(cls, protocols: list[np.ndarray]) -> Gradients:
        """Of gradients K, shapes [..., 4]."""
        rates = np.concatenate([np.reshape(stretching(K), (-1, 2)) for K in protocols])
        strain, beyond_spin = rates.max(axis=0, initial=0.0)
        return cls(float(strain), float(beyond_spin))

    def check(self, K: np.ndarray, how: str) -> None:
        """Warn or refuse when a gradient of K [..., 4] is faster by more than a tenth.

        Raises InputError for "refuse".
        """
        if not asked(how):
            return
        most = np.reshape(stretching(K), (-1, 2)).max(axis=0)
        known = np.array([self.strain, self.beyond_spin])
        over = most > known + FASTER * self.strain
        if over.any():
            n = int(np.argmax(over))
            kind = ("rate of strain", "rate of strain beyond the spin")[n]
            tell(
                f"velocity gradient: {kind} up to {most[n]:.3g} per relaxation time, the training "
                f"data go to {known[n]:.3g}",
                how,
            )


def stretching(K: np.ndarray) -> np.ndarray:
    """(rate of strain, what of it is beyond the spin) of gradients [..., 4], shape [..., 2]."""
    xx, xy, yx, yy = np.moveaxis(np.asarray(K, dtype=float), -1, 0)
    strain = np.hypot(xx - yy, xy + yx) / 2
    return np.stack([strain, np.maximum(strain - np.abs(xy - yx) / 2, 0)], axis=-1)


def asked(how: str) -> bool:
    """Whether what is outside is to be said. Raises InputError for an unknown word."""
    if how not in OUTSIDE:
        raise InputError(f"outside: expected warn, refuse or allow, got {how!r}")
    return how != "allow"


def tell(message: str, how: str) -> None:
    """Refuse by an InputError, or warn."""
    if how == "refuse":
        raise InputError(message)
    warnings.warn(message, OutsideWarning, stacklevel=4)
