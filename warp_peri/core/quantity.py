"""What the fields of a material say of themselves beside their types: units, names in a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias


@dataclass(frozen=True)
class Quantity:
    """Of a field, as ``Annotated[float, Quantity(stress=1)]``.

    Attributes:
        length, stress: powers of the units that it is in.
        volume: power of length^d, beside that of the length.
        positive: whether a number is to be above zero.
        key: in the file, where that is not the field's name.
        omit: whether a file leaves it out where it has its default.
        later: whether files of before may lack it.
        flat: whether the fields of its value stand in the file in its place.
        kept: whether it is in the file at all.
    """

    length: int = 0
    stress: int = 0
    volume: int = 0
    positive: bool = False
    key: str = ""
    omit: bool = False
    later: bool = False
    flat: bool = False
    kept: bool = True


Positive: TypeAlias = Annotated[float, Quantity(positive=True)]
Length: TypeAlias = Annotated[float, Quantity(length=1, positive=True)]
Stress: TypeAlias = Annotated[float, Quantity(stress=1)]
