"""A material as a family: several laws of one data set, whose differences say how wrong it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

from warp_peri.core.record import Entry, OnLinear
from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number
from warp_peri.prediction.placed import PlacedMembers
from warp_peri.prediction.spectrum import ErrorSpectrum

if TYPE_CHECKING:
    from warp_peri.points.samples import PointsLike


@dataclass(frozen=True)
class Factors:
    """Calibration: by how much what can be computed is multiplied, so that it is an error (Q4).

    Attributes:
        left: of the correction that is left.
        floor: of what waves, data and strain may miss.
        screen: of the mean gradient, for what the linear answer misses.
        short: of what every second node does not see of a residual (Q15).
        stretch: of the largest strain, for what a linear rich member misses.
    """

    left: float = 1.2
    floor: float = 1.48
    screen: float = 1.42
    short: float = 1.3
    stretch: Annotated[float, Entry(omit=True)] = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (is_number(value) and value >= 0):
                raise InputError(f"{name}: expected a factor ≥ 0, got {value!r:.40}")


@dataclass(frozen=True, eq=False, repr=False)
class Members(OnLinear, format="warp_peri.family", version=2):
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
        axis_off: degrees by which the samples' own crystal is turned from the axis they state.
        coarse: the rich member on nodes twice as far apart, where it can be transferred there.
        provenance: of the fit.
    """

    rich: Any
    second: Any
    halves: tuple[Any, Any]
    record: ErrorSpectrum | None = None
    factors: Factors = Factors()
    strain: float = 0.0
    temperature: float | None = None
    axis_off: Annotated[float, Entry(omit=True)] = 0.0
    coarse: Annotated[Any, Entry(later=True)] = None
    provenance: dict[str, Any] = field(default_factory=dict)
    ORDER = ("rich", "second", "halves", "record", "coarse", "factors", "strain", "temperature",
             "axis_off", "provenance")  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        optional = [] if self.coarse is None else [self.coarse]
        for one in (self.rich, self.second, *self.halves, *optional):
            if not hasattr(one, "on"):
                raise InputError(f"member: expected a material, got {one!r:.40}")

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

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        names = [type(one).__name__ for one in (self.rich, self.second)]
        rows = [("rich, second", ", ".join(names)), ("strain seen", f"{self.strain:.2%}")]
        rows.append(("factors", f"{self.factors.left:.2f} left, {self.factors.floor:.2f} floor"))
        return rows + list(self.rich.rows() if hasattr(self.rich, "rows") else [])
