"""A learned law of flow as a value with a file: `warp_peri.flow_law`, in reduced units."""

from __future__ import annotations

from dataclasses import astuple
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

from warp_peri.core.record import Record
from warp_peri.errors import InputError
from warp_peri.flow.cloud import OUTSIDE, Gradients
from warp_peri.flow.gaussian_process import GaussianProcess

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
