"""Checks of the arguments of public functions and classes, and of units, which go by name."""

from __future__ import annotations

import inspect
import math
import os
import sys
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, wraps
from types import FunctionType, NoneType, SimpleNamespace, UnionType
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike

from warp_peri.errors import InputError, Shape, Values

LARGEST = 1e100
"""Values above it are no data, and their squares soon no numbers."""
MOST = 2**53
"""Counts above it are none, nor whole numbers told apart in float64."""
MOST_NODES = 2**27
"""Nodes whose positions alone are gigabytes."""
GRADIENT = "expected values without a gradient, which is not had here, got some with one"


def as_array(name: str, value: Any) -> np.ma.MaskedArray[Any, Any]:
    """Make an array of a user's value, masked where its parts are; InputError where none can be,
    and for arrays of torch and Warp whose gradient would be lost."""
    if getattr(value, "requires_grad", False):
        raise InputError(f"{name}: {GRADIENT}")
    try:
        found = np.ma.array(np.ma.asanyarray(value), copy=False)
    except (RuntimeError, TypeError, ValueError) as error:
        raise InputError(f"{name}: expected an array ({error})") from None
    if found.dtype.kind in "fiuc" and holds_flags(value):  # which NumPy takes for numbers
        raise InputError(f"{name}: expected numbers alone, or True and False alone, got both")
    return found


def holds_flags(value: Any) -> bool:
    """Whether a value is a flag, or a list that has some, or a list of such ones."""
    if isinstance(value, (list, tuple)):
        return any(map(holds_flags, value))
    return isinstance(value, (bool, np.bool_))


def plain(name: str, value: Any, kind: Any = float, kinds: str = "fiu") -> ndarray:
    """Make a float64 array, or one of `kind`, whose values may be anything; InputError for a tensor
    whose gradient would be lost, masked entries, and what is not of `kinds` of numbers."""
    found = as_array(name, value)  # that of a list of masked arrays too
    if found.dtype.kind not in kinds or np.ma.is_masked(found):
        got = "masked entries" if found.dtype.kind in kinds else found.dtype
        raise InputError(f"{name}: expected float values, got {got}")
    return np.asarray(found.data, kind)


def checked(
    name: str,
    value: Any,
    kind: type = float,
    shape: tuple[Any, ...] | None = None,
    read: ndarray | bool = True,
) -> ndarray:
    """Check a user's value; returns an array of float64, bool, or whole numbers, nothing missing.

    Names in `shape` stand for any length, a first … for any axes before. What entries hold that are
    not to be `read`, a mask that broadcasts, is not looked at. Raises InputError for complex
    numbers, text and objects, for masked entries, for numbers that are not finite or beyond
    LARGEST, and for another shape.
    """
    masked = as_array(name, value)  # that of a list of masked arrays too
    value = np.asarray(masked.data)
    if value.dtype.kind not in {bool: "b", int: "iu"}.get(kind, "fiu"):
        raise InputError(f"{name}: expected {kind.__name__} values, got {value.dtype}")
    if shape is not None:
        last = shape[1:] if shape[:1] == (...,) else shape
        there = value.shape[value.ndim - len(last) :] if last is not shape else value.shape
        if len(there) != len(last) or any(w not in (n, str(w)) for n, w in zip(there, last)):
            wanted = ", ".join("…" if w is ... else str(w) for w in shape)
            raise InputError(f"{name}: expected shape [{wanted}], got {list(value.shape)}")
    if np.any(masked.mask & read):
        first = np.argwhere(np.ma.getmaskarray(masked) & read)[0].tolist()
        raise InputError(
            f"{name}: expected values everywhere, got {np.count_nonzero(masked.mask)} of "
            f"{value.size} masked, the first at index {first}"
        )
    value = np.asarray(masked.filled(0))
    size, most = np.abs(np.asarray(value, float)), MOST if kind is int else LARGEST
    if (bad := ~(size <= most) & read).any():
        index = np.argwhere(bad)[0].tolist()
        raise InputError(
            f"{name}: expected finite values, got {value[tuple(index)]:g} at index {index}; "
            f"at most {most:g}"
        )
    return np.require(value, np.int64 if kind is int else kind, ["C", "W"])


def within(where: str, make: Callable[..., Any], *of: Any) -> Any:
    """What `make` gives, or its InputError with `where` before the message."""
    try:
        return make(*of)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def check_shape(name: str, given: Any, shape: Shape) -> None:
    """Raise InputError for an array, or a tensor, of another shape."""
    if tuple(given.shape) != tuple(shape):
        raise InputError(f"{name}: expected shape {list(shape)}, got {list(given.shape)}")


def checked_fields(points: Any, b: Any, u: Any, one: Shape | None = None) -> Pair:
    """Check load and displacement of a problem, [N, d] or [S, N, d]; the second is a copy. b, or
    None for no load, is read on the interior, u on the others; `one` is the shape of one field
    where it is not [N, d]. Raises InputError as `checked`, and for other shapes."""
    one = points.x.shape if one is None else one
    inside = points.interior.reshape(-1, *[1] * (len(one) - 1))
    field = checked("u", u, float, (..., *one), ~inside).copy()
    if field.ndim > len(one) + 1:
        shown = ", ".join(map(str, one))
        raise InputError(f"u: expected shape [{shown}] or [S, {shown}], got {list(field.shape)}")
    load = np.zeros(field.shape) if b is None else checked("b", b, float, field.shape, inside)
    return load, field


def check_function(name: str, value: Any, *of: str) -> None:
    """Raise InputError unless a value is a function of such as positions, not a class."""
    try:
        fine = not isinstance(value, type) and bool(inspect.signature(value).bind(*of))
    except (TypeError, ValueError) as error:
        fine = isinstance(error, ValueError)  # in C, nobody knows of what
    if not fine:
        raise InputError(f"{name}: expected a function of {' and '.join(of)}, got {value!r:.60}")


def is_piece(points: Any) -> bool:
    """Whether points are a rank's piece of a body's nodes."""
    return hasattr(points, "comm")


def is_number(value: Any) -> bool:
    """Whether a value is one real number, no tensor whose gradient would be lost."""
    lost = getattr(value, "requires_grad", False) or getattr(value, "is_meta", False)
    if lost or isinstance(value, (list, tuple)):  # strange to NumPy
        return False
    found = as_array("number", value)
    return found.ndim == 0 and found.dtype.kind in "fiu"


def are_numbers(value: Any) -> bool:
    """Whether a value makes an array without text and objects; tensors are looked at later."""
    try:
        found = value if hasattr(value, "dtype") else np.ma.asanyarray(value)
    except RuntimeError:  # of tensors with a gradient
        return True
    except (TypeError, ValueError):
        return False
    return getattr(found.dtype, "kind", "f") in "biufc"


def is_positive(value: Any) -> bool:
    """Whether a value is one real number above zero, and finite."""
    return is_number(value) and 0 < value < np.inf


def check_whole(name: str, value: Any, least: int) -> int:
    """Check and return a whole number; InputError for what is none from `least` on, or no count."""
    if not (is_number(value) and least <= value <= MOST and value % 1 == 0):
        raise InputError(f"{name}: expected a whole number ≥ {least}, got {value!r:.60}")
    return int(value)


def check_nodes(name: str, sides: Any, of: str = "nodes") -> None:
    """Raise InputError for a lattice of more nodes than fit into memory, along its sides."""
    if not (count := math.prod(map(float, sides))) <= MOST_NODES:
        raise InputError(f"{name}: expected at most {MOST_NODES} {of}, got {count:.3g}")


def check_flag(name: str, value: Any) -> bool:
    """Check and return a flag, NumPy's too; InputError for others: a text "no" would be true."""
    if not (isinstance(value, bool) or (getattr(value, "dtype", 0) == np.bool_ and not value.ndim)):
        raise InputError(f"{name}: expected True or False, got {value!r:.60}")
    return bool(value)


def check_mapping(name: str, value: Any) -> None:
    """Raise InputError for a value that is no mapping of names."""
    if not (isinstance(value, Mapping) and all(isinstance(key, str) for key in value)):
        raise InputError(f"{name}: expected values by name, as {{'name': …}}, got {value!r:.60}")


def check_parameters(function: Callable[..., Any], values: Numbers) -> None:
    """Raise InputError unless a function takes one argument and values by name."""
    try:
        with suppress(ValueError):  # of what does not tell its arguments
            inspect.signature(function).bind(None, **values)
    except TypeError as error:
        raise InputError(f"parameters: expected those of the function ({error})") from None


def listed(nodes: ndarray) -> str:
    """Text of the first few node numbers."""
    return ", ".join(str(i) for i in nodes[:8]) + (" …" if len(nodes) > 8 else "")


def is_name(name: Any) -> bool:
    """Whether HDF5 takes a value as the name of one thing."""
    return isinstance(name, str) and name not in ("", ".") and not {"/", "\0"} & {*name}


SAMPLES = 32
"""Places along a bond at which a field is read."""


def mean_inverse(values: Callable[[float], ndarray]) -> ndarray:
    """Mean along bonds of 1/field, from its `values` at a share of each bond's length."""
    places = (np.arange(SAMPLES) + 0.5) / SAMPLES
    return np.asarray(sum(1 / values(float(place)) for place in places) / SAMPLES)


Call = TypeVar("Call", bound=Callable[..., Any])
Kind = TypeVar("Kind", bound=type)
Numbers: TypeAlias = Mapping[str, Any]
"""Learnable numbers by name."""
ARRAY = get_args(ArrayLike)
LISTS = {Sequence, tuple, list}
KINDS = (bool, int, float, str, os.PathLike, Mapping, dict, Sequence, tuple, list, NoneType,
         ndarray, Callable)  # fmt: skip
NAMES = {str: "a text", Callable: "a function"}
_signature = cache(inspect.signature)
"""Of a function, worked out at its first call: most are never called."""


class Bound(typing.NamedTuple):
    """Range of accepted values of a kind, in words and as a test."""

    words: str
    holds: Callable[[Any], bool]


ABOVE = Bound("a number > 0", lambda value: 0 < value <= LARGEST)
Positive = Annotated[float, ABOVE]
NotNegative = Annotated[float, Bound("a number ≥ 0", lambda value: 0 <= value <= LARGEST)]
Share = Annotated[float, Bound("a number between 0 and 1", lambda value: 0 < value < 1)]
Count = Annotated[int, Bound("a whole number ≥ 1", lambda value: value >= 1)]
Natural = Annotated[int, Bound("a whole number ≥ 0", lambda value: value >= 0)]
Seed = Annotated[int, Bound("a whole number from 0 to 2³² − 1", lambda s: 0 <= s < 2**32)]
"""Of random numbers; torch takes larger ones for smaller ones."""


def typed(call: Call) -> Call:
    """Decorate a function, or a class and its public methods, with check_arguments."""
    if isinstance(call, type):
        call.__init__ = typed(call.__init__)  # type: ignore[misc]
        return typed_methods(call)

    @wraps(call)
    def with_kinds(*args: Any, **options: Any) -> Any:
        if not kinds_of(call):
            return call(*args, **options)
        try:
            given = _signature(call).bind(*args, **options)
        except TypeError:
            return call(*args, **options)  # which names the function
        given.arguments.update(check_arguments(call, given.arguments))
        return call(*given.args, **given.kwargs)

    return with_kinds  # type: ignore[return-value]


def typed_methods(kind: Kind) -> Kind:
    """Decorate a class so that its own public methods check arguments as `typed` functions do."""
    for name, method in [*vars(kind).items()]:
        own = getattr(method, "__func__", method)
        if (name[0] != "_" or name == "__call__") and not hasattr(own, "__wrapped__"):
            if isinstance(method, (classmethod, staticmethod)):
                setattr(kind, name, type(method)(typed(own)))
            elif isinstance(method, FunctionType):
                setattr(kind, name, typed(method))
    return kind


def check_arguments(call: Callable[..., Any], given: Options) -> Options:
    """Check arguments against annotations and return them, numbers of other types as int or float;
    InputError naming the first of another kind.

    Kinds are bool, int, float, str, paths, mappings, sequences, classes of this package, literals
    and arrays, each alone or with others. A number is finite and within its Bound, or the default.
    Other annotations and defaults are not looked at.
    """
    found = dict(given)
    for name, (kinds, default, bound) in kinds_of(call).items():
        value = given.get(name, default)
        if value is default or (value is None and NoneType in kinds):
            continue
        if isinstance(value, np.matrix):  # whose rows are matrices
            value = found[name] = np.asarray(value)
        elif hasattr(value, "__array__") and LISTS & {*kinds} and not isinstance(value, ndarray):
            value = found[name] = as_array(name, value).tolist()  # of a table's column, a tensor
        first, *more = [kind for kind in kinds if kind is not NoneType]
        if os.PathLike in kinds and isinstance(value, str) and (not value or "\0" in value):
            raise InputError(f"{name}: expected a path, got {value!r:.60}")
        no = Sequence if isinstance(value, str) else Callable if isinstance(value, type) else None
        if any(isinstance(value, kind) and kind is not no for kind in more):
            continue
        if getattr(value, "requires_grad", False) is True and first in KINDS:
            raise InputError(f"{name}: {GRADIENT}")
        if first is bool:
            found[name] = check_flag(name, value)
            continue
        if first is int or first is float:
            fine = is_number(value) and (abs(float(value)) <= LARGEST or value == default)
            fine = fine and (first is float or (value % 1 == 0 and abs(value) <= MOST))
            words = "a whole number" if first is int else "a finite number"
            words += " or a text" * (str in more)
        elif first is ndarray:
            fine, words = no is not Callable and are_numbers(value), "float values"
        elif first in (Mapping, dict):
            fine, words = isinstance(value, Mapping), "values by name"
        elif first in LISTS:
            fine = not isinstance(value, str) and isinstance(value, (Sequence, ndarray))
            fine = fine and getattr(value, "ndim", 1) > 0
            words = "a sequence"
        else:
            words = " or ".join(NAMES.get(kind, kind.__name__) for kind in kinds)
            on_points = "Points" in [kind.__name__ for kind in kinds]
            fine = isinstance(value, first) or (on_points and is_piece(value))
            words = "a path" if os.PathLike in more else words.replace("NoneType", "None")
        if fine and (first is int or (first is float and not isinstance(value, float))):
            value = found[name] = first(value)
        same = first in (int, float) and value == default  # arrays have no one answer
        if not fine or (bound and not same and not bound.holds(value)):
            expected, short = bound.words if bound else words, first in KINDS and first not in NAMES
            got = f"{value!r:.60}" if short or bound else type(value).__name__
            got = str(getattr(value, "dtype", got)) if first is ndarray else got
            raise InputError(f"{name}: expected {expected}, got {got}")
    return found


@cache
def kinds_of(call: Callable[..., Any]) -> dict[str, tuple[tuple[Any, ...], Any, Bound | None]]:
    """Kinds of each checked argument of a function, its default, and its Bound."""
    names, found = inspect.unwrap(call).__globals__, {}
    for name, parameter in _signature(call).parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        annotated = SimpleNamespace(__annotations__={name: parameter.annotation})
        try:
            hint = typing.get_type_hints(annotated, names, include_extras=True)[name]
        except (NameError, AttributeError, TypeError):  # of types that type checkers alone import
            continue
        hints = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        if {*ARRAY} <= {*hints}:
            hints = ndarray, *(one for one in hints if one not in ARRAY)
        kinds = tuple(sorted(map(_kind, hints), key=lambda one: one is str and float in hints))
        if Units not in hints and all(kind in KINDS or _is_own(kind) for kind in kinds):
            found[name] = kinds, parameter.default, next(filter(None, map(_bound, hints)), None)
    return found


def _kind(hint: Any) -> Any:
    """Class of values for one part of an annotation."""
    if get_origin(hint) is Literal:
        return type(get_args(hint)[0])
    hint = getattr(hint, "__origin__", hint) if get_origin(hint) is Annotated else hint
    return get_origin(hint) or hint


def _bound(hint: Any) -> Bound | None:
    """Bound in an annotation, if there is one."""
    if get_origin(hint) is Literal:
        values = get_args(hint)
        return Bound(f"one of {', '.join(map(str, values))}", values.__contains__)
    if (of := get_args(hint)) == (str, float):
        return Bound("numbers by name", lambda value: all(map(is_number, value.values())))
    kinds = get_args(of[0]) or of[:1] if of and _kind(hint) in LISTS else ()
    if kinds and all(map(_is_own, kinds)):
        words = " or ".join(kind.__name__ for kind in kinds)
        return Bound(f"each a {words}", lambda value: all(isinstance(one, of[0]) for one in value))
    said = getattr(hint, "__metadata__", (None,))[0]
    if getattr(said, "positive", False):  # of a field of a Record
        return ABOVE
    return said if isinstance(said, Bound) else None


def _is_own(kind: Any) -> bool:
    """Whether a kind is a class of this package, not a protocol."""
    own = isinstance(kind, type) and kind.__module__.startswith("warp_peri.")
    return own and not getattr(kind, "_is_protocol", False)


def is_tensor(value: Any) -> bool:
    """Whether a value is a torch tensor; torch is not loaded for the question."""
    return "torch" in sys.modules and isinstance(value, sys.modules["torch"].Tensor)


LINEAR = "a linear solid, or a material with a linear part"
"""What most proofs and fits are of, for errors."""


def offered(given: Any, name: str, verb: str, kinds: str) -> Any:
    """Method `name` of a given object; InputError that says what `verb` is for otherwise."""
    method = getattr(given, name, None)
    if method is None or isinstance(given, type):
        what = given.__name__ if isinstance(given, type) else type(given).__name__
        raise InputError(f"{verb}: expected {kinds}, got {what}")
    return method


def taken(
    options: Options, verb: str, *takers: Callable[..., Any], given: tuple[str, ...] = ()
) -> tuple[Options, ...]:
    """Sort options by taker, by keyword-only arguments that are not `given` elsewhere. InputError
    for an option that none takes, a missing one, and one of another kind than annotated."""
    kinds = [
        {n: p for n, p in inspect.signature(taker).parameters.items() if p.kind is p.KEYWORD_ONLY}
        for taker in takers
    ]
    known = {n: p for kind in kinds for n, p in kind.items() if n not in given}
    names = ", ".join(known) or "none"
    if unknown := sorted(options.keys() - known.keys()):
        raise InputError(f"{verb}: expected options among {names}, got {', '.join(unknown)}")
    if missing := [n for n, p in known.items() if p.default is p.empty and n not in options]:
        raise InputError(f"{verb}: expected {', '.join(missing)} too, of the options {names}")
    found = tuple({n: options[n] for n in kind if n in known and n in options} for kind in kinds)
    return tuple(check_arguments(taker, its) for taker, its in zip(takers, found))


def picked(options: Options, *names: str) -> Options:
    """Those of the options that have these names, taken out of them."""
    return {name: options.pop(name) for name in names if name in options}


Options: TypeAlias = Values
"""Options of a call, by name."""
Pair: TypeAlias = tuple[ndarray, ndarray]
"""Two arrays, which a docstring tells apart."""
ArrayMap: TypeAlias = Callable[[ndarray], ndarray]
"""Arrays made of arrays."""
LENGTHS = {"angstrom": 1.0, "nm": 10.0, "um": 1e4, "mm": 1e7, "m": 1e10}
"""Units of length [Å]."""
EV_IN_TPA = 0.1602176634
STRESSES = {"TPa": 1.0, "GPa": 1e-3, "MPa": 1e-6, "bar": 1e-7, "Pa": 1e-12}
STRESSES |= {"eV/angstrom^3": EV_IN_TPA}
"""Units of stress [TPa]."""
REDUCED = ("sigma", "epsilon/sigma^3")
"""Of Lennard-Jones and other model potentials: no factor leads from them to metres and pascals."""
SYMBOLS = {"angstrom": "Å", "um": "µm", "eV/angstrom^3": "eV/Å³"}
"""How units are printed, where that is not by name."""
SYMBOLS |= {"sigma": "σ", "epsilon/sigma^3": "ε/σ³"}
ATOMIC = ("TPa", "eV/angstrom^3", "bar")
"""Units of stress in which codes of atoms compute; their moduli are printed in GPa."""
SYSTEMS: dict[str, Units] = {
    "ase": ("angstrom", "eV/angstrom^3"),
    "metal": ("angstrom", "bar"),
    "si": ("m", "Pa"),
    "reduced": REDUCED,
}
"""Units of length and stress that go by one name: of ASE, of LAMMPS metal, of the SI, none."""
Units: TypeAlias = tuple[str, str]
"""Names of a unit of length and of one of stress."""
USUAL: Units = ("angstrom", "TPa")
"""What everything is in unless something else is said."""


def check_units(units: Any) -> Units:
    """Units as a pair of known names, from a pair or a key of SYSTEMS; else InputError."""
    if isinstance(units, str) and units in SYSTEMS:
        return SYSTEMS[units]
    try:
        length, stress = map(str, [units] if isinstance(units, str) else units)
    except (TypeError, ValueError):
        raise InputError(
            f"units: expected (length, stress), or {', '.join(SYSTEMS)}, got {units!r:.60}"
        ) from None
    if (length, stress) == REDUCED:
        return REDUCED
    for key, name, known in (("length_unit", length, LENGTHS), ("stress_unit", stress, STRESSES)):
        if name not in known:
            raise InputError(
                f"{key}: expected one of {', '.join(known)}, or {' and '.join(REDUCED)} together, "
                f"got {name!r:.60}"
            )
    return length, stress


def symbols(units: Units) -> tuple[str, str]:
    """Printed symbols of length and stress: "Å", "TPa"."""
    length, stress = units
    return SYMBOLS.get(length, length), SYMBOLS.get(stress, stress)


def shown_moduli(units: Units, values: Iterable[float]) -> str:
    """Text of moduli: in GPa from atomic units, else in their own unit (GPa, MPa, Pa, reduced)."""
    unit = units[1]
    factor, shown = (STRESSES[unit] * 1e3, "GPa") if unit in ATOMIC else (1.0, symbols(units)[1])
    return ", ".join(f"{factor * value:.4g}" for value in values) + f" {shown}"


def usual_lengths(name: str, usual: Any, units: Units) -> ndarray:
    """Usual lengths [Å] in other units; InputError for a unit that is nobody's."""
    if units[0] not in LENGTHS:
        raise InputError(f"{name}: expected one in {units[0]}, the data's unit; got none")
    return np.asarray(usual) / LENGTHS[units[0]]


def factors(have: Units, want: Units) -> tuple[float, float]:
    """Factors from the units `have` to the units `want` for lengths and stresses; InputError for
    unknown units, and from reduced units to others."""
    have, want = check_units(have), check_units(want)
    if have == want:
        return 1.0, 1.0
    if REDUCED in (have, want):
        raise InputError(
            f"units: no factor leads from {' and '.join(have)} to {' and '.join(want)}; reduced "
            "units need σ and ε: scale the numbers with them first"
        )
    return LENGTHS[have[0]] / LENGTHS[want[0]], STRESSES[have[1]] / STRESSES[want[1]]


def check_same(model: Units, points: Units) -> None:
    """Raise InputError where a model and points are in different units."""
    if model != points:
        theirs = f"{points[0]!r}, {points[1]!r}"
        raise InputError(
            f"units: the model is in {' and '.join(model)}, the points are in "
            f"{' and '.join(points)}; model.in_units(({theirs})) converts"
        )
