"""Materials as values: field types state units, from which follow file, units and summary table.

    @dataclass(frozen=True, eq=False, repr=False)
    class CrystalMaterial(Record, format="warp_peri.micromodulus"):
        spacing: Length
        tensors: Annotated[np.ndarray, FieldUnits(length=-2, stress=1)]
        certificate: StencilCertificate | None = None

is checked when made, and has `save`, `content`, `in_units`; `load` reads its file, and proves again
what that says to be proven.
"""

from __future__ import annotations

import hashlib
import json
import typing
from collections.abc import Callable
from copy import deepcopy
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeAlias, get_args, get_origin

import numpy as np
from numpy import ndarray

from warp_peri.errors import Held, InputError, Rows, Shown, StrPath, Values, hold, sharing, warn
from warp_peri.files import atomic
from warp_peri.files.atomic import parsed, plain, write_json
from warp_peri.files.checkpoint import fingerprint
from warp_peri.points.arguments import (
    ABOVE,
    LARGEST,
    USUAL,
    Units,
    check_same,
    check_units,
    checked,
    factors,
    is_number,
    shown_moduli,
    symbols,
    typed,
    typed_methods,
    within,
)
from warp_peri.points.points import Points, PointsLike, nodes_of

UNITS = ("length_unit", "stress_unit")
HEAD = ("format", "version", "sha256")
FORMATS: dict[str, type[Record]] = {}
"""Kinds of materials by the format that their files name."""
PROVEN: set[tuple[str, str]] = set()
"""Hashes of files' contents, and of what is in none, whose proofs this process has gone through."""
MADE: Values = {}
"""What `made_once` made in this process."""
HOMES = {
    "warp_peri.model": "materials.lps",
    "warp_peri.third_order_crystal": "materials.third_order",
    "warp_peri.density": "materials.density",
    "warp_peri.brittle_solid": "fracture.materials",
    "warp_peri.soft_solid": "fracture.materials",
    "warp_peri.micromodulus": "materials.crystal",
    "warp_peri.hyperelastic": "materials.hyperelastic.operator",
    "warp_peri.neural": "neural.material",
    "warp_peri.conductor": "diffusion",
    "warp_peri.coupled_solid": "diffusion",
    "warp_peri.family": "prediction.ensemble",
}
"""Modules below warp_peri that a format's kind is in; those of others are loaded already."""


@dataclass(frozen=True)
class FieldUnits:
    """Units and file entry of a field, as ``Annotated[float, FieldUnits(stress=1)]``.

    Attributes:
        length, stress: powers of the units that it is in.
        positive: whether a number is to be above zero.
        key: in the file, where that is not the field's name.
        omit: whether a file leaves it out where it has its default.
        flat: whether the fields of its value stand in the file in its place.
        kept: whether it is in the file at all.
        spread: whether a number may be one of each node instead, an array.
    """

    length: int = 0
    stress: int = 0
    positive: bool = False
    key: str = ""
    omit: bool = False
    flat: bool = False
    kept: bool = True
    spread: bool = False


PLAIN = FieldUnits()
"""Of a field that says nothing."""
Length: TypeAlias = Annotated[float, FieldUnits(length=1, positive=True)]
Stress: TypeAlias = Annotated[float, FieldUnits(stress=1)]


@dataclass(frozen=True)
class Field:
    """Facts of a field: its name, file key, type, units and default."""

    name: str
    key: str
    hint: Any
    says: FieldUnits
    default: Any


def fields_of(value: Any) -> tuple[Field, ...]:
    """Fields of a dataclass or its value, except `units`, which a file names at its head."""
    return _fields_of(value if isinstance(value, type) else type(value))


@cache
def _fields_of(kind: Any) -> tuple[Field, ...]:
    hints, found = typing.get_type_hints(kind, include_extras=True), []
    for each in fields(kind):
        hint, says = hints[each.name], PLAIN
        if get_origin(hint) is Annotated:
            hint, said = get_args(hint)[:2]
            says = said if isinstance(said, FieldUnits) else FieldUnits(positive=said is ABOVE)
        default = each.default if each.default_factory is MISSING else each.default_factory
        found.append(Field(each.name, says.key or each.name, hint, says, default))
    return tuple(each for each in found if each.name != "units")


class Record(Shown, Held):
    """Base of materials as values: checks, file, units, table; subclasses add checks and physics. A
    class names its `format`, and its `version` where that is not the first. In `__post_init__` it
    calls that of here first, which turns what is given into the types of the fields."""

    FORMAT: ClassVar[str]
    VERSION: ClassVar[int]
    if TYPE_CHECKING:

        @property
        def units(self) -> Units: ...
        @property
        def dimension(self) -> int: ...

    def __init_subclass__(cls, format: str = "", version: int = 1) -> None:
        if "__repr__" not in vars(cls):  # else a dataclass would write one with all of its arrays
            cls.__repr__ = Record.__repr__  # type: ignore[method-assign]
        typed_methods(cls)
        if format:  # not of what several formats share, or one with tables that no file has
            cls.FORMAT, cls.VERSION = format, version
            FORMATS[format] = cls

    def __post_init__(self) -> None:
        for each in fields_of(self):
            value = taken(each.name, each.hint, getattr(self, each.name), each.says)
            hold(self, **{each.name: value})
        if _has_units(self):
            hold(self, units=check_units(self.units))

    def derived(self) -> Values:
        """Entries of a file that are no fields; a reader must find the same there."""
        return {}

    def content(self) -> Values:
        """Plain values of the material's file, the last a hash of the others."""
        found: Values = {"format": self.FORMAT, "version": self.VERSION}
        found |= dict(zip(UNITS, self.units)) if _has_units(self) else {}
        found |= _entries(self) | self.derived()
        return found | {"sha256": content_hash(found)}

    @property
    def unfiled(self) -> Values:
        """Fields that are in no file, by name."""
        hidden = (each.name for each in fields_of(self) if not each.says.kept)
        return {name: getattr(self, name) for name in hidden}

    @classmethod
    def from_dict(cls, content: Any, where: str = "") -> Self:
        """Make the material from a file's contents; `where` begins warnings. InputError for another
        format or version, missing or unknown keys, wrong or changed values, failing proofs."""
        if not isinstance(content, dict):
            raise InputError(f"expected a JSON object, got {type(content).__name__}")
        for key, expected in (("format", cls.FORMAT), ("version", cls.VERSION)):
            if content.get(key) != expected:
                raise InputError(f"{key}: expected {expected!r}, got {content.get(key)!r:.60}")
        own, units = {k: v for k, v in content.items() if k not in HEAD}, {}
        if _has_units(cls):
            named: Any = [own.pop(key, None) for key in UNITS]
            if not {*UNITS} & {*content}:
                warn(f"{where}it names no units: taken as Å and TPa")
                named = USUAL
            units = {"units": check_units(named)}
        made = cls(**units, **_values(cls, own))
        for key, value in made.derived().items():
            if (said := own.pop(key, None)) != plain(value):
                raise InputError(f"{key}: expected {plain(value)!r:.60}, got {said!r:.60}")
        _refuse_unknown(own)
        hashed = content_hash(content)
        if content.get("sha256", hashed) != hashed:
            raise InputError(
                "sha256: the contents are not what was written; remove this key to accept them"
            )
        made.prove_again()
        return made

    def prove_again(self) -> None:
        """Prove again what the material says is proven of it, once in a process; InputError for
        what is not proven of its numbers, as after `dataclasses.replace` of some."""
        key = self.content()["sha256"], fingerprint(type(self), self.unfiled)
        if key not in PROVEN or sharing():  # or ranks wait for this one
            self.verify_certificates()
            PROVEN.add(key)

    @property
    def stands(self) -> bool:
        """Whether what the material says is proven of it is so."""
        try:
            self.prove_again()
        except InputError:
            return False
        return True

    def verify_certificates(self) -> None:
        """Raise InputError unless the file's StencilCertificate of `stencil` is proven again."""
        for each in fields_of(self):
            proof = getattr(self, each.name)
            if hasattr(proof, "check_of"):
                proof.check_of(self.stencil, self.group)  # type: ignore[attr-defined]

    def _read_from(self, path: Path | None) -> Self:
        """The material with what lies beside its file."""
        return self

    @classmethod
    @typed
    def load(cls, path: StrPath) -> Self:
        """Read a material's file; InputError for one of another kind, and as `from_dict`."""
        found = load(path)
        if not isinstance(found, cls):
            what = f"expected a {cls.__name__}, got a {type(found).__name__}"
            raise InputError(f"{path}: {what}")
        return found

    @typed
    def save(self, path: StrPath) -> None:
        """Write a JSON file, whole or not at all; InputError for values that JSON lacks."""
        try:
            write_json(path, self.content())
        except InputError:
            raise
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}: expected plain, finite values ({error})") from None

    def in_units(self, units: Any) -> Self:
        """The material in other units, records of its origin excepted; InputError for units that
        are not known, or that no factor leads to."""
        by = factors(self.units, units)
        if self.units == (units := check_units(units)):
            return self
        moved = self._moved(self, by, units) | ({"units": units} if _has_units(self) else {})
        return replace(self, **moved | self.elsewhere(*by))  # type: ignore[type-var]

    def own_nodes(self, points: PointsLike) -> Points:
        """Nodes of points, samples or a rank's piece; InputError for other units or dimensions."""
        nodes = nodes_of(points)
        check_same(self.units, nodes.units)
        if nodes.dimension != self.dimension:
            got = f"{self.dimension} dimensions, the model's, got shape {list(nodes.x.shape)}"
            raise InputError(f"points: expected {got}")
        return nodes

    def elsewhere(self, length: float, stress: float) -> Values:
        """Fields in other units that their types do not tell, for the factors."""
        return {}

    def _moved(self, part: Any, by: tuple[float, float], units: Units) -> Values:
        """Fields of a part, in other units."""
        fields = [(each.name, each.says) for each in fields_of(part)]
        return {name: self._scaled(getattr(part, name), says, by, units) for name, says in fields}

    def _scaled(self, value: Any, says: FieldUnits, by: tuple[float, float], units: Units) -> Any:
        """A field's value in other units."""
        if isinstance(value, Record):
            return value.in_units(units)
        if hasattr(value, "__dataclass_fields__"):
            return replace(value, **self._moved(value, by, units))
        if isinstance(value, tuple):
            return tuple(self._scaled(one, says, by, units) for one in value)
        if says is PLAIN or not isinstance(value, (float, ndarray)):
            return value
        size, stress = by[0] ** abs(says.length), by[1] ** says.stress
        return value * (stress * size if says.length >= 0 else stress / size)

    def rows(self) -> Rows:
        """Name and value of each line of the material's summary table."""
        found = []
        for each in fields_of(self):
            value, power = getattr(self, each.name), (each.says.length, each.says.stress)
            if isinstance(value, Record):
                found += value.rows()
            elif isinstance(value, float) and power == (0, 1):
                found.append((each.name, shown_moduli(self.units, (value,))))
            elif isinstance(value, (float, str, bool)):
                unit = f" {symbols(self.units)[0]}" if power == (1, 0) else ""
                shown = f"{value:.4g}" if isinstance(value, float) else str(value)
                found.append((each.name, shown + unit))
        return found


def made_once(make: Callable[..., Any], material: Any, *asked: Any) -> Any:
    """What a function makes of a material, slowly, once of the same: of its class, with the code,
    of its fields and of its file. Each gets a copy, so that nobody changes another's."""
    of = type(material), vars(material), material.content()["sha256"]
    if (key := fingerprint(make.__qualname__, of, asked)) not in MADE or sharing():
        MADE[key] = make(material, *asked)
    return deepcopy(MADE[key])


class OnLinear(Record):
    """A material with the units, dimension and horizon of its linear solid."""

    if TYPE_CHECKING:

        @property
        def linear(self) -> Any: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        if getattr(self.linear, "nodes", None) is not None:
            raise InputError("lambda, mu: expected numbers, got fields, which go with no other law")

    @property
    def units(self) -> Units:
        """Names of the units of length and stress."""
        return self.linear.units  # type: ignore[no-any-return]

    @property
    def dimension(self) -> int:
        """Dimension of space: 2 or 3."""
        return int(self.linear.dimension)

    @property
    def horizon(self) -> float:
        """Horizon δ [length] of the linear solid."""
        return float(self.linear.horizon)


def _has_units(kind: Any) -> bool:
    return "units" in kind.__dataclass_fields__


def _entries(value: Any) -> Values:
    """File entries for the fields of a record, or of a part of one."""
    found: Values = {}
    for each in fields_of(value):
        one = getattr(value, each.name)
        same = one is each.default or (isinstance(one, (int, float, str)) and one == each.default)
        if each.says.flat:
            found |= _entries(one)
        elif each.says.kept and not (each.says.omit and same):
            found[each.key] = _plain(one)
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if hasattr(value, "FORMAT"):
        return value.content()
    if is_dataclass(value):
        return _entries(value)
    return None if isinstance(value, float) and np.isinf(value) else plain(value)


def _values(kind: Any, entries: Values) -> Values:
    """Field values of a dataclass, taken out of the entries of a file."""
    found: Values = {}
    missing = []
    for each in fields_of(kind):
        if each.says.flat:
            found[each.name] = each.hint(**_values(each.hint, entries))
        elif each.says.kept and each.key in entries:
            value = entries.pop(each.key)
            endless = value is None and isinstance(each.default, float) and np.isinf(each.default)
            found[each.name] = (
                np.inf if endless else taken(each.key, each.hint, value, each.says, read=True)
            )
        elif each.says.kept and not each.says.omit:
            missing.append(each.key)
    if missing:
        raise InputError(f"missing keys: {', '.join(sorted(missing))}")
    return found


def _refuse_unknown(left: Values) -> None:
    if left:
        raise InputError(f"unknown keys: {', '.join(sorted(left))}")


def _part(kind: Any, entries: Values) -> Any:
    """Dataclass from its entries in a file."""
    made = kind(**_values(kind, entries))
    _refuse_unknown(entries)
    return made


def taken(key: str, hint: Any, value: Any, says: FieldUnits = PLAIN, *, read: bool = False) -> Any:
    """Convert a value, of JSON if `read`, to a field's type; InputError naming the key."""
    parts = get_args(hint)
    if get_origin(hint) in (typing.Union, UnionType):
        if (value is None and NoneType in parts) or (isinstance(value, str) and str in parts):
            return value
        hint = next(each for each in parts if each not in (NoneType, str))
        return taken(key, hint, value, says, read=read)
    hint = get_origin(hint) or hint
    if hint is tuple:
        if not (isinstance(value, (list, tuple)) or getattr(value, "ndim", False)):
            raise InputError(f"{key}: expected a list, got {value!r:.50}")
        kinds = parts if parts[-1] is not Ellipsis else parts[:1] * len(value)
        if len(kinds) != len(value):
            raise InputError(f"{key}: expected {len(kinds)} of them, got {len(value)}")
        return tuple(taken(key, kind, one, says, read=read) for kind, one in zip(kinds, value))
    if says.spread and (isinstance(value, (list, tuple)) or np.ndim(value)):
        hint = ndarray
    if hint is float:
        return _number(key, value, says.positive)
    if hint is ndarray:
        if not isinstance(value, (list, tuple)) and np.ndim(value) == 0:
            raise InputError(f"{key}: expected a list, got {value!r:.50}")
        if _holds_bool(value):
            raise InputError(f"{key}: expected finite numbers, got true or false")
        return checked(key, value, float)
    if hint is Any and read and isinstance(value, dict) and "format" in value:
        return within(key, read_content, value)
    if read and "__dataclass_fields__" in vars(hint):
        if issubclass(hint, Record):
            return within(key, hint.from_dict, value)
        return within(key, _part, hint, dict(taken(key, dict, value)))
    value = int(value) if hint is int and isinstance(value, np.integer) else value
    if hint is Any or (isinstance(value, hint) and not (hint is int and isinstance(value, bool))):
        return value
    words = WORDS.get(hint, f"{hint.__name__}(…)")
    raise InputError(f"{key}: expected {words}, got {value!r:.50}")


WORDS: dict[Any, str] = {
    bool: "true or false", int: "a whole number", str: "a name", dict: "an object",
}  # fmt: skip


def _number(key: str, value: Any, positive: bool) -> float:
    found = float(value) if is_number(value) else np.nan
    if not (0 < found <= LARGEST if positive else abs(found) <= LARGEST):
        what = "a number > 0" if positive else "a finite number"
        what += f" up to {LARGEST:g}" if np.isfinite(found) and found > LARGEST else ""
        raise InputError(f"{key}: expected {what}, got {value!r:.50}")
    return found


def _holds_bool(value: Any) -> bool:
    return any(map(_holds_bool, value)) if isinstance(value, list) else isinstance(value, bool)


def content_hash(content: Values) -> str:
    """SHA-256 of the contents of a file except the hash itself."""
    kept = {key: value for key, value in content.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(plain(kept), sort_keys=True).encode()).hexdigest()


def read_content(content: Any, path: Path | None = None) -> Any:
    """Make a material of any format from the contents of a file."""
    name = content.get("format") if isinstance(content, dict) else content
    if isinstance(name, str) and name in HOMES:
        import_module(f"warp_peri.{HOMES[name]}")
    if not isinstance(name, str) or name not in FORMATS:
        raise InputError(
            f"format: expected one of {', '.join(sorted({*HOMES, *FORMATS}))}, got {name!r:.50}"
        )
    where = f"{path}: " if path else ""
    return FORMATS[name].from_dict(content, where)._read_from(path)


def read_json(path: StrPath) -> Any:
    """Read a file of JSON; InputError naming the file and the fault."""
    raw = atomic.content(path)
    try:
        return parsed(raw)
    except ValueError as error:
        raise InputError(f"{path}: not a readable JSON file ({error})") from None


def load(path: StrPath) -> Any:
    """Read the file of a material; InputError naming the file and the fault."""
    return within(f"{path}", read_content, read_json(path), Path(path))
