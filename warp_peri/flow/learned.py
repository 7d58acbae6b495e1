"""Laws learned from dumbbells: what they share, and where their data lie."""

from __future__ import annotations

import warnings
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import numpy as np
from scipy.spatial import cKDTree

from warp_peri.core.record import Record
from warp_peri.errors import InputError
from warp_peri.flow.gaussian_process import GaussianProcess

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


FORMAT = "warp_peri.flow_law"
UNITS = {"time": "relaxation time", "stress": "n k T", "conformation": "<q q> of a Hookean at rest"}
FASTEST = ("strain", "beyond_spin")


class LearnedLaw(Record):
    """What learned laws of flow have in common; tables are made again when one is read.

    Their file has the processes of all in one list, and `kinematics` and `b` of none as null.
    """

    ORDER: ClassVar[tuple[str, ...]] = (
        "units",
        "outside",
        "kinematics",
        "b",
        "provenance",
        "processes",
    )
    PROCESSES: ClassVar[tuple[str, ...]]
    """Fields that the processes of a file are."""
    if TYPE_CHECKING:

        @property
        def outside(self) -> str: ...
        @property
        def name(self) -> str: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.outside not in OUTSIDE:
            raise InputError(f"outside: expected one of {', '.join(OUTSIDE)}, got {self.outside!r}")

    @property
    def learned_from(self) -> tuple[GaussianProcess, ...]:
        """Its processes, in the order of a file."""
        return tuple(getattr(self, name) for name in self.PROCESSES)

    def derived(self) -> dict[str, Any]:
        """What a file has beside provenance and the way outside the data."""
        numbers = {name: getattr(self, name, None) for name in ("kinematics", "b")}
        processes = [vars(each) for each in self.learned_from]
        names = GaussianProcess.__dataclass_fields__
        return {"units": UNITS, **numbers, "outside": self.outside} | {
            "processes": [{name: each[name] for name in names} for each in processes]
        }

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """With the fields that the processes are."""
        found = content.get("processes")
        if not isinstance(found, list) or len(found) != len(cls.PROCESSES):
            raise InputError(f"processes: expected {len(cls.PROCESSES)} of them")
        return content | dict(zip(cls.PROCESSES, found))

    def rows(self) -> list[tuple[str, str]]:
        """Its name, and from how many points it was learned."""
        return [("law", self.name), ("points", f"{len(self.learned_from[0].y)}")]

    def in_units(self, units: Any) -> NoReturn:
        """InputError: a law of flow is in reduced units, which no factor leads from."""
        raise InputError("units: expected none, a law of flow is in reduced units")


def fastest(gradients: Gradients | None) -> list[float] | None:
    """The fastest flows of the data as a file has them."""
    return None if gradients is None else list(astuple(gradients))


def fastest_of(content: dict[str, Any]) -> Any:
    """The same as a field; files of before have none, which is entered."""
    found = content.setdefault("gradients", None)
    if found is not None and not (isinstance(found, list) and len(found) == len(FASTEST)):
        raise InputError(f"gradients: expected {len(FASTEST)} numbers, got {found!r:.50}")
    return found and dict(zip(FASTEST, found))
