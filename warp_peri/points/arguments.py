"""Arguments of public functions and classes, checked against their annotations."""

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
from warp_peri.points.arrays import (
    GRADIENT,
    LARGEST,
    MOST,
    are_numbers,
    check_flag,
    is_number,
    is_piece,
)
from warp_peri.points.unit_names import Units

Call = TypeVar("Call", bound=Callable[..., Any])
Kind = TypeVar("Kind", bound=type)
ARRAY = get_args(ArrayLike)
KINDS = (bool, int, float, str, os.PathLike, Mapping, dict, Sequence, tuple, list, NoneType,
         np.ndarray)  # fmt: skip


_signature = cache(inspect.signature)
"""Of a function, worked out at its first call: most are never called."""


class Bound(NamedTuple):
    """Which values of a kind are taken, in words and as a test."""

    words: str
    holds: Callable[[Any], bool]


ABOVE = Bound("a number > 0", lambda value: 0 < value <= LARGEST)
Positive = Annotated[float, ABOVE]
NotNegative = Annotated[float, Bound("a number ≥ 0", lambda value: 0 <= value <= LARGEST)]
Share = Annotated[float, Bound("a number between 0 and 1", lambda value: 0 < value < 1)]
Count = Annotated[int, Bound("a whole number ≥ 1", lambda value: value >= 1)]
Natural = Annotated[int, Bound("a whole number ≥ 0", lambda value: value >= 0)]


def typed(call: Call) -> Call:
    """Let a function, or a class when it is made and in its public methods, raise InputError for
    arguments that are not of the kind that they are annotated with, naming the first.

    Arguments are looked at as by check_arguments.
    """
    if isinstance(call, type):
        call.__init__ = typed(call.__init__)  # type: ignore[misc]
        return typed_methods(call)

    @wraps(call)
    def checked(*args: Any, **options: Any) -> Any:
        if not kinds_of(call):
            return call(*args, **options)
        try:
            given = _signature(call).bind(*args, **options)
        except TypeError:
            return call(*args, **options)  # which names the function
        given.arguments.update(check_arguments(call, given.arguments))
        return call(*given.args, **given.kwargs)

    return checked  # type: ignore[return-value]


def typed_methods(kind: Kind) -> Kind:
    """A class whose own public methods look at their arguments as `typed` functions do."""
    for name, method in [*vars(kind).items()]:
        plain = getattr(method, "__func__", method)
        if (name[0] != "_" or name == "__call__") and not hasattr(plain, "__wrapped__"):
            if isinstance(method, (classmethod, staticmethod)):
                setattr(kind, name, type(method)(typed(plain)))
            elif isinstance(method, FunctionType):
                setattr(kind, name, typed(method))
    return kind


def check_arguments(call: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments, whole numbers of other types as int; InputError for one that is not of the
    kind that it is annotated with.

    Kinds are bool, int, float, str, paths, mappings, sequences, classes of this package, literals
    and arrays, each alone or with others. A number is finite and within its Bound, or the default.
    What is annotated with anything else is not looked at, nor is a default.
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
            words = "a sequence"
        else:
            fine = isinstance(value, first) or is_piece(value)
            words = "a text" if first is str else " or ".join(kind.__name__ for kind in kinds)
            words = "a path" if os.PathLike in more else words.replace("NoneType", "None")
        if not fine or (bound and value != default and not bound.holds(value)):
            expected, plain = bound.words if bound else words, first in KINDS and first is not str
            got = f"{value!r:.60}" if plain or bound else type(value).__name__
            got = str(getattr(value, "dtype", got)) if first is np.ndarray else got
            raise InputError(f"{name}: expected {expected}, got {got}")
        if first is int or (first is float and isinstance(value, np.ndarray)):
            found[name] = first(value)
    return found


@cache
def kinds_of(call: Callable[..., Any]) -> dict[str, tuple[tuple[Any, ...], Any, Bound | None]]:
    """The kinds of each argument that is looked at, its default, and which values it takes."""
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
        if hint != Units and all(kind in KINDS or _is_own(kind) for kind in kinds):
            found[name] = kinds, parameter.default, next(filter(None, map(_bound, hints)), None)
    return found


def _kind(hint: Any) -> Any:
    """The class of values, of one part of an annotation."""
    if get_origin(hint) is Literal:
        return type(get_args(hint)[0])
    hint = getattr(hint, "__origin__", hint) if get_origin(hint) is Annotated else hint
    return get_origin(hint) or hint


def _bound(hint: Any) -> Bound | None:
    """Which values it takes, where it says that."""
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
    """Whether it is a class of this package, not a protocol."""
    own = isinstance(kind, type) and kind.__module__.startswith("warp_peri.")
    return own and not getattr(kind, "_is_protocol", False)
