"""Named samples of one material."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from warp_peri.errors import InputError
from warp_peri.points.arrays import check_positive, is_name
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import Units, symbols
from warp_peri.shown import Shown


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Shown):
    """Named sets of samples of one material.

    Attributes:
        sets: samples by name, e.g. train, val, test.
        thickness: of the sheet, in the sets' unit of length.
        density: mass per volume [kg/m³].
        provenance: how the data came to be; plain JSON values.

    Raises InputError for a data set without point sets, or a thickness or density not > 0.
    """

    sets: dict[str, Samples]
    thickness: float
    density: float
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("thickness", "density"):
            check_positive(name, getattr(self, name))
        if not self.sets:
            raise InputError("expected at least one point set, got none")
        for name in self.sets:
            if not is_name(name):
                raise InputError(f"sets: {name!r} cannot be the name of a set")
        if len({samples.points.units for samples in self.sets.values()}) > 1:
            named = ", ".join(
                f"{name} in {' and '.join(samples.points.units)}"
                for name, samples in self.sets.items()
            )
            raise InputError(f"units: expected the same for all sets, got {named}")

    @property
    def units(self) -> Units:
        """Names of the units of length and stress that all sets are in."""
        return next(iter(self.sets.values())).points.units

    def __getitem__(self, name: str) -> Samples:
        """The point set called `name`; InputError lists what there is when it is missing."""
        if name not in self.sets:
            raise InputError(f"no set '{name}' in the data; it has {', '.join(self.sets)}")
        return self.sets[name]

    def obvious(self, name: str | None = None) -> Samples:
        """The set that is meant where none was named: that of the usual name, or the only one.

        Raises InputError that lists the sets where neither is there.
        """
        if name in self.sets:
            return self.sets[str(name)]
        if len(self.sets) == 1:
            return next(iter(self.sets.values()))
        first = next(iter(self.sets))
        raise InputError(
            f"expected one set of samples, got a data set with {', '.join(self.sets)}; name one, "
            f"as data[{first!r}]"
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self.sets)

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, the sets one after the other."""
        length = symbols(self.units)[0]
        rows = [
            ("thickness", f"{self.thickness:g} {length}"),
            ("density", f"{self.density:g} kg/m³"),
        ]
        for name, samples in self.sets.items():
            (_, count), (_, nodes), *_ = samples.rows()
            rows.append((name, f"{count} samples on nodes: {nodes}"))
        return rows
