"""Checks of the arguments of public functions and classes against their annotations."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from types import FunctionType, NoneType, SimpleNamespace, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.points.unit_names import Units

LARGEST = 1e100
"""Values above it are no data, and their squares soon no numbers."""
MOST = 2**53
"""Counts above it are none, nor whole numbers told apart in float64."""
GRADIENT = "expected values without a gradient, which is not had here, got tensors with one"


def as_array(name: str, value: Any) -> np.ma.MaskedArray[Any, Any]:
    """Make an array of a user's value, masked where its parts are; InputError where none can be."""
    try:
        return np.ma.array(np.ma.asanyarray(value), copy=False)
    except (RuntimeError, TypeError, ValueError) as error:
        if getattr(value, "requires_grad", False):
            raise InputError(f"{name}: {GRADIENT}") from None
        raise InputError(f"{name}: expected an array ({error})") from None


def plain(name: str, value: Any) -> np.ndarray:
    """Make a float64 array whose values may be anything; InputError for a tensor whose gradient
    would be lost, masked entries, complex numbers, text and objects."""
    found = as_array(name, value)  # that of a list of masked arrays too
    if found.dtype.kind not in "fiu" or np.ma.is_masked(found):
        got = "masked entries" if np.ma.is_masked(found) else found.dtype
        raise InputError(f"{name}: expected float values, got {got}")
    return np.asarray(found.data, dtype=float)


def checked(
    name: str,
    value: Any,
    kind: type = float,
    shape: tuple[Any, ...] | None = None,
    read: np.ndarray | bool = True,
) -> np.ndarray:
    """Check a user's value; returns an array of float64, bool, or whole numbers, nothing missing.

    Args:
        name: of it in messages.
        value: what a user gave.
        kind: float, bool or int.
        shape: that it must have; names stand for any length, a first … for any axes before.
        read: which entries count, of a shape that broadcasts; what others hold is not looked at.

    Raises InputError for complex numbers, text and objects, for masked entries, for numbers that
    are not finite or beyond LARGEST, and for another shape.
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
    value = np.asarray(masked.filled(0)) if np.any(masked.mask) else value
    value = np.require(value, np.float64 if kind is float else value.dtype, ["C", "W"])
    if kind is float and not (np.abs(value) <= LARGEST).all():
        bad = ~(np.abs(value) <= LARGEST) & read
        if bad.any():
            index = np.argwhere(bad)[0].tolist()
            raise InputError(
                f"{name}: expected finite values, got {value[tuple(index)]:g} at index {index}; "
                f"at most {LARGEST:g}"
            )
    return np.asarray(value)


def check_shape(name: str, given: Any, shape: tuple[int, ...]) -> None:
    """Raise InputError for an array, or a tensor, of another shape."""
    if tuple(given.shape) != tuple(shape):
        raise InputError(f"{name}: expected shape {list(shape)}, got {list(given.shape)}")


def checked_fields(
    points: Any, b: Any, u: Any, one: tuple[int, ...] | None = None
) -> tuple[np.ndarray, np.ndarray]:
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


def is_piece(points: Any) -> bool:
    """Whether points are a rank's piece of a body's nodes."""
    return hasattr(points, "comm")


def is_number(value: Any) -> bool:
    """Whether a value is one real number; InputError for a tensor whose gradient would be lost."""
    if getattr(value, "requires_grad", False):
        raise InputError(f"number: {GRADIENT}")
    strange = isinstance(value, (list, tuple)) or getattr(value, "is_meta", False)  # for NumPy
    return not strange and np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"


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


def check_flag(name: str, value: Any) -> None:
    """Raise InputError for what is neither True nor False: a text "no" would count as true."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name}: expected True or False, got {value!r:.60}")


def check_mapping(name: str, value: Any) -> None:
    """Raise InputError for a value that is no mapping of names."""
    if not (isinstance(value, Mapping) and all(isinstance(key, str) for key in value)):
        raise InputError(f"{name}: expected values by name, as {{'name': …}}, got {value!r:.60}")


def listed(nodes: np.ndarray) -> str:
    """Text of the first few node numbers."""
    return ", ".join(str(i) for i in nodes[:8]) + (" …" if len(nodes) > 8 else "")


def is_name(name: Any) -> bool:
    """Whether HDF5 takes a value as the name of one thing."""
    return isinstance(name, str) and name not in ("", ".") and not {"/", "\0"} & {*name}


SAMPLES = 32
"""Places along a bond at which a field is read."""


def mean_inverse(values: Callable[[float], np.ndarray]) -> np.ndarray:
    """Mean along bonds of 1/field, from its `values` at a share of each bond's length."""
    places = (np.arange(SAMPLES) + 0.5) / SAMPLES
    return np.asarray(sum(1 / values(float(place)) for place in places) / SAMPLES)


Call = TypeVar("Call", bound=Callable[..., Any])
Kind = TypeVar("Kind", bound=type)
ARRAY = get_args(ArrayLike)
KINDS = (bool, int, float, str, os.PathLike, Mapping, dict, Sequence, tuple, list, NoneType,
         np.ndarray)  # fmt: skip
_signature = cache(inspect.signature)
"""Of a function, worked out at its first call: most are never called."""


class Bound(NamedTuple):
    """Range of accepted values of a kind, in words and as a test."""

    words: str
    holds: Callable[[Any], bool]


ABOVE = Bound("a number > 0", lambda value: 0 < value <= LARGEST)
Positive = Annotated[float, ABOVE]
NotNegative = Annotated[float, Bound("a number ≥ 0", lambda value: 0 <= value <= LARGEST)]
Share = Annotated[float, Bound("a number between 0 and 1", lambda value: 0 < value < 1)]
Count = Annotated[int, Bound("a whole number ≥ 1", lambda value: value >= 1)]
Natural = Annotated[int, Bound("a whole number ≥ 0", lambda value: value >= 0)]


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


def check_arguments(call: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Check arguments against annotations and return them, whole numbers of other types as int;
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
        first, *more = [kind for kind in kinds if kind is not NoneType]
        if os.PathLike in kinds and isinstance(value, str) and (not value or "\0" in value):
            raise InputError(f"{name}: expected a path, got {value!r:.60}")
        text = isinstance(value, str)
        if any(isinstance(value, kind) and not (text and kind is Sequence) for kind in more):
            continue
        if getattr(value, "requires_grad", False) and first in KINDS:
            raise InputError(f"{name}: {GRADIENT}")
        if first is bool:
            check_flag(name, value)
            continue
        if first is int or first is float:
            fine = is_number(value) and (abs(value) <= LARGEST or value == default)
            fine = fine and (first is float or (value % 1 == 0 and abs(value) <= MOST))
            words = "a whole number" if first is int else "a finite number"
        elif first is np.ndarray:
            fine, words = are_numbers(value), "float values"
        elif first in (Mapping, dict):
            fine, words = isinstance(value, Mapping), "values by name"
        elif first in (Sequence, tuple, list):
            fine = not isinstance(value, str) and isinstance(value, (Sequence, np.ndarray))
            fine = fine and getattr(value, "ndim", 1) > 0
            words = "a sequence"
        else:
            fine = isinstance(value, first) or is_piece(value)
            words = "a text" if first is str else " or ".join(kind.__name__ for kind in kinds)
            words = "a path" if os.PathLike in more else words.replace("NoneType", "None")
        if not fine or (bound and value != default and not bound.holds(value)):
            expected, short = bound.words if bound else words, first in KINDS and first is not str
            got = f"{value!r:.60}" if short or bound else type(value).__name__
            got = str(getattr(value, "dtype", got)) if first is np.ndarray else got
            raise InputError(f"{name}: expected {expected}, got {got}")
        if first is int or (first is float and not isinstance(value, (int, float))):
            found[name] = first(value)
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
            hint = get_type_hints(annotated, names, include_extras=True)[name]
        except (NameError, AttributeError, TypeError):  # of types that type checkers alone import
            continue
        hints = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        if {*ARRAY} <= {*hints}:
            hints = np.ndarray, *(one for one in hints if one not in ARRAY)
        kinds = tuple(map(_kind, hints))
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
    if get_args(hint) == (str, float):
        return Bound("numbers by name", lambda value: all(map(is_number, value.values())))
    said = getattr(hint, "__metadata__", (None,))[0]
    if getattr(said, "positive", False):  # of a field of a Record
        return ABOVE
    return said if isinstance(said, Bound) else None


def _is_own(kind: Any) -> bool:
    """Whether a kind is a class of this package, not a protocol."""
    own = isinstance(kind, type) and kind.__module__.startswith("warp_peri.")
    return own and not getattr(kind, "_is_protocol", False)
