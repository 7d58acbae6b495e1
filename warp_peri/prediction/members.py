"""A material as a family: several laws of one data set, whose differences say how wrong it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from warp_peri.errors import InputError
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.third_order import ThirdOrderCrystal
from warp_peri.models.lps import content_hash, model_from, read_content
from warp_peri.models.nonlinear import nonlinear_from
from warp_peri.points.arrays import is_number
from warp_peri.points.unit_names import Units, factors
from warp_peri.prediction.placed import PlacedMembers
from warp_peri.prediction.spectrum import Record
from warp_peri.shown import as_table, in_rows

if TYPE_CHECKING:
    from warp_peri.points.samples import PointsLike

FORMAT, VERSION = "warp_peri.family", 2
READERS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "warp_peri.third_order_crystal": ThirdOrderCrystal.of_content,
    "warp_peri.micromodulus": Crystal.of_content,
    "warp_peri.dressed": lambda of: import_module("warp_peri.dressed").DressedSolid.of_content(of),
    "warp_peri.model": lambda of: nonlinear_from(of) if "kind" in of else model_from(of),
}


@dataclass(frozen=True)
class Factors:
    """Calibration: by how much what can be computed is multiplied, so that it is an error (Q4).

    Attributes:
        left: of the correction that is left.
        floor: of what waves, data and strain may miss.
        screen: of the mean gradient, for what the linear answer misses.
        short: of what every second node does not see of a residual (Q15).
    """

    left: float = 1.2
    floor: float = 1.48
    screen: float = 1.42
    short: float = 1.3

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (is_number(value) and value >= 0):
                raise InputError(f"{name}: expected a factor ≥ 0, got {value!r:.40}")


@dataclass(frozen=True, eq=False, repr=False)
class Members:
    """What `fit(samples, prediction.learning.Family(…))` learns: a material with its doubts.

    It solves, moves and is placed on points as its rich member. `predict` uses all.

    Attributes:
        rich: the best law of the data, linear or of third order.
        second: a poorer one; how they differ is what short waves may miss.
        halves: the rich law from two halves of the samples; how they differ is what data may miss.
        record: error of the rich member by wavelength; None of scattered samples.
        factors: calibration.
        strain: largest strain between neighbouring nodes in the samples.
        temperature: [K] of the samples, where they state it.
        coarse: the rich member on nodes twice as far apart, where it can be transferred there.
        provenance: of the fit.
    """

    rich: Any
    second: Any
    halves: tuple[Any, Any]
    record: Record | None = None
    factors: Factors = Factors()
    strain: float = 0.0
    temperature: float | None = None
    coarse: Any = None
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def dimension(self) -> int:
        """d of the space it fills."""
        return int(self.rich.dimension)

    @property
    def units(self) -> Units:
        """Names of the units of length and stress."""
        return self.rich.units  # type: ignore[no-any-return]

    @property
    def horizon(self) -> float:
        """δ [length] of the rich member."""
        return float(self.rich.horizon)

    @property
    def linear(self) -> Any:
        """The linear part of the rich member."""
        return getattr(self.rich, "linear", self.rich)

    def on(self, points: PointsLike, **options: Any) -> Any:
        """The rich member on points."""
        return self.rich.on(points, **options)

    def with_doubts(self, points: PointsLike, **options: Any) -> PlacedMembers:
        """All members on points, with what they do not know there; options of `on`."""
        return PlacedMembers(self, points, **options)

    def in_units(self, units: Units) -> Members:
        """The same in other units."""
        length, _ = factors(self.units, units)
        record = self.record and self.record.longer(length)
        coarse = self.coarse and self.coarse.in_units(units)
        rich, second, *halves = (
            one.in_units(units) for one in (self.rich, self.second, *self.halves)
        )
        pair = (halves[0], halves[1])
        return replace(self, rich=rich, second=second, halves=pair, coarse=coarse, record=record)

    def content(self) -> dict[str, Any]:
        """What the file holds: its members whole, each with its own records."""
        content: dict[str, Any] = {"format": FORMAT, "version": VERSION}
        content |= {name: getattr(self, name).content() for name in ("rich", "second")}
        content["halves"] = [one.content() for one in self.halves]
        content["record"] = self.record and self.record.content()
        content["coarse"] = self.coarse and self.coarse.content()
        content["factors"] = asdict(self.factors)
        content |= {n: getattr(self, n) for n in ("strain", "temperature", "provenance")}
        content["sha256"] = content_hash(content)
        return content

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        names = [type(one).__name__ for one in (self.rich, self.second)]
        rows = [("rich, second", ", ".join(names)), ("strain seen", f"{self.strain:.2%}")]
        rows.append(("factors", f"{self.factors.left:.2f} left, {self.factors.floor:.2f} floor"))
        return rows + list(self.rich.rows() if hasattr(self.rich, "rows") else [])

    def __repr__(self) -> str:
        return in_rows("Members", self.rows())

    def _repr_html_(self) -> str:
        return as_table(self.rows())


def load_members(path: Any) -> Members:
    """Read the file of a family; InputError naming what is wrong with it."""
    content = read_content(path)
    try:
        if content.get("version") != VERSION:
            raise InputError(f"version: expected {VERSION}, got {content.get('version')!r:.40}")
        if "sha256" in content and content["sha256"] != content_hash(content):
            raise InputError(
                "sha256: the contents are not what was written; remove this key to accept them"
            )
        record = content["record"] and Record.of_content(content["record"])
        coarse = _member(content["coarse"]) if content.get("coarse") else None
        rich, second, *halves = (
            _member(one) for one in (content["rich"], content["second"], *content["halves"])
        )
        own = {name: content[name] for name in ("strain", "temperature", "provenance")}
        factors = Factors(**content["factors"])
        pair = (halves[0], halves[1])
        return Members(rich, second, pair, record, factors, coarse=coarse, **own)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not a readable family ({error!r:.80})") from None


def _member(content: dict[str, Any]) -> Any:
    """A material of its content."""
    kind = content["format"]
    if kind not in READERS:
        raise InputError(f"member: expected one of {', '.join(READERS)}, got {kind!r:.40}")
    return READERS[kind](content)
