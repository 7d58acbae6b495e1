"""Laws learned from dumbbells: what they share, and where their data lie."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeAlias

import numpy as np
from scipy.spatial import cKDTree

from examples.polymer.gaussian_process import GaussianProcess
from examples.polymer.laws import IDENTITY
from examples.polymer.paths import Band, band
from warp_peri.core.record import Record
from warp_peri.errors import InputError

OUTSIDE = ("warn", "refuse", "allow")
WIDER = 3.0
"""A state is outside beyond so many times the widest gap between neighbours of the data."""
FASTER = 0.1
"""A gradient is outside beyond the fastest of the data by this part of it."""
FORMAT = "warp_peri.flow_law"
UNITS = {"time": "relaxation time", "stress": "n k T", "conformation": "<q q> of a Hookean at rest"}
Fastest: TypeAlias = tuple[float, float]
"""Of the flows that a law was taught, per relaxation time, as of `stretching`: the largest rate of
stretching along an axis (γ/2 in a shear γ, ε in an elongation ε), and the largest excess of it over
the spin (0 in shear, ε in elongation)."""


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
        if how == "allow" or not (beyond := int(((far := self.distance(X)) > WIDER).sum())):
            return
        worst = ", ".join(f"{value:.3g}" for value in X[np.argmax(far)])
        tell(
            f"{beyond} of {len(X)} states are outside the training data, the farthest "
            f"{far.max():.3g} times their spacing, at {worst}",
            how,
        )


def fastest(protocols: list[np.ndarray]) -> Fastest:
    """Of gradients K, shapes [..., 4]."""
    rates = np.concatenate([np.reshape(stretching(K), (-1, 2)) for K in protocols])
    strain, beyond_spin = rates.max(axis=0, initial=0.0).tolist()
    return strain, beyond_spin


def check_gradients(known: Fastest, K: np.ndarray, how: str) -> None:
    """Warn or refuse when a gradient of K [..., 4] is faster by more than a tenth.

    Raises InputError for "refuse".
    """
    most = np.reshape(stretching(K), (-1, 2)).max(axis=0)
    over = most > np.array(known) + FASTER * known[0]
    if how != "allow" and over.any():
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


class Checked:
    """The checks of a law in one run: what is outside the data is said once, not once a step."""

    def __init__(self) -> None:
        self.told = False

    def __call__(self, law: Any, K: np.ndarray, C: np.ndarray) -> None:
        """As the `check` of the law."""
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            law.check(K, C)
        for one in found:
            if not (self.told and issubclass(one.category, OutsideWarning)):
                warnings.warn(one.message, one.category, stacklevel=3)
            self.told |= issubclass(one.category, OutsideWarning)


def tell(message: str, how: str) -> None:
    """Refuse by an InputError, or warn."""
    if how == "refuse":
        raise InputError(message)
    warnings.warn(message, OutsideWarning, stacklevel=4)


@dataclass(frozen=True, kw_only=True)
class LearnedLaw(Record):
    """Processes of the features of a state, and what is known beside them.

    Its file has all processes in one list, and `kinematics` and `b` of laws without them as null;
    tables are made again when one is read. A law of a class of its own says its `features` and its
    `rate`; its state is the conformation C, its stress C − I where it says no other.

    Attributes:
        outside: "warn", "refuse" or "allow" states far from the data.
        provenance: what it was learned from; plain values, for its file.
    """

    outside: str = "warn"
    provenance: dict[str, Any] = field(default_factory=dict, repr=False)

    ORDER: ClassVar[tuple[str, ...]] = (
        "units", "outside", "kinematics", "b", "provenance", "processes",
    )  # fmt: skip
    PROCESSES: ClassVar[tuple[str, ...]] = ("process",)
    """Fields that the processes of a file are; none where they are one field, `processes`."""
    TITLE: ClassVar[str]
    if TYPE_CHECKING:

        @property
        def processes(self) -> tuple[GaussianProcess, ...]: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.outside not in OUTSIDE:
            raise InputError(f"outside: expected one of {', '.join(OUTSIDE)}, got {self.outside!r}")

    @property
    def name(self) -> str:
        """The law's name in tables and figures."""
        known = ", kinematics known" if getattr(self, "kinematics", False) else ""
        return "learned " + self.TITLE.format(kernel=self.learned_from[0].kernel) + known

    @property
    def learned_from(self) -> tuple[GaussianProcess, ...]:
        """Its processes, in the order of a file."""
        return tuple(getattr(self, name) for name in self.PROCESSES) or self.processes

    def as_law(self, kind: Any, **more: Any) -> Any:
        """A law of another class, of more fields beside those of this one."""
        own = {
            each.name: getattr(self, each.name) for each in fields(kind) if each.name not in more
        }
        return kind(**own | more)

    def derived(self) -> dict[str, Any]:
        """What a file has in another form than the fields."""
        numbers = {name: getattr(self, name, None) for name in ("kinematics", "b")}
        each = [asdict(process) for process in self.learned_from]
        return {"units": UNITS, "processes": each} | numbers

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """With the fields that the processes are."""
        found, count = content.get("processes"), len(cls.PROCESSES)
        if count and not (isinstance(found, list) and len(found) == count):
            raise InputError(f"processes: expected {count} of them")
        return content | dict(zip(cls.PROCESSES, found or []))

    def rows(self) -> list[tuple[str, str]]:
        """Its name, and from how many points it was learned."""
        return [("law", self.name), ("points", f"{len(self.learned_from[0].y)}")]

    def in_units(self, units: Any) -> NoReturn:
        """InputError: a law of flow is in reduced units, which no factor leads from."""
        raise InputError("units: expected none, a law of flow is in reduced units")

    def features(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """Inputs [n m, d] of the first process in states [n, 4], m of each."""
        raise NotImplementedError

    @cached_property
    def rest(self) -> np.ndarray:
        """The state at rest."""
        return IDENTITY

    def stress(self, C: np.ndarray) -> np.ndarray:
        """The stress of states, shape [n, 4]."""
        return np.asarray(C - IDENTITY)

    @cached_property
    def cloud(self) -> Cloud:
        """Where the training data are."""
        return Cloud(self.learned_from[0].X, self.learned_from[0].scale)

    def distance(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """How far states [n, 4] are from the data, in gaps, shape [n]; the farthest input."""
        return np.asarray(self.cloud.distance(self.features(K, C)).reshape(len(C), -1).max(axis=1))

    def band(self, run: Callable[[Any], np.ndarray], *, count: int = 8, seed: int = 0) -> Band:
        """How sure a field is that `run` makes of a law: this one, and `count` drawn from it (F30).

        It knows the noise and the gaps of the data, not what the form of the law leaves out.
        """
        return band(self, run, count, seed)

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Warn or refuse outside the data; InputError for a state that is none."""
        if not np.isfinite(C).all():
            raise InputError("stress: not finite under the learned law")
        self.cloud.check(self.features(K, C), self.outside)
