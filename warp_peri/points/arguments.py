"""Arguments of public functions and classes, checked against their annotations."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from types import NoneType, SimpleNamespace, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arrays import GRADIENT, LARGEST, MOST, check_flag, is_number, is_piece
from warp_peri.points.unit_names import Units

Call = TypeVar("Call", bound=Callable[..., Any])
KINDS = (bool, int, float, str, os.PathLike, Mapping, dict, Sequence, tuple, list, NoneType)


def typed(call: Call) -> Call:
    """Let a function, or the constructor of a class, raise InputError for arguments that are not
    of the kind that they are annotated with, naming the first.

    Arguments are looked at as by check_arguments.
    """
    if isinstance(call, type):
        call.__init__ = typed(call.__init__)  # type: ignore[misc]
        return call
    signature = inspect.signature(call)

    @wraps(call)
    def checked(*args: Any, **options: Any) -> Any:
        try:
            given = signature.bind(*args, **options).arguments
        except TypeError:
            return call(*args, **options)  # which names the function
        check_arguments(call, given)
        return call(*args, **options)

    return checked  # type: ignore[return-value]


def check_arguments(call: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Raise InputError for an argument that is not of the kind that it is annotated with.

    Kinds are bool, int, float, str, paths, mappings, sequences, and classes of this
    package, each alone or with others. A float is finite, or the default. What is annotated with
    anything else, as an array, is not looked at, nor is a default.
    """
    for name, (kinds, default) in kinds_of(call).items():
        value = given.get(name, default)
        if value is default or (value is None and NoneType in kinds):
            continue
        first, *more = [kind for kind in kinds if kind is not NoneType]
        if any(isinstance(value, kind) for kind in more):
            continue
        if getattr(value, "requires_grad", False) and first in KINDS:
            raise InputError(f"{name}: {GRADIENT}")
        if first is bool:
            check_flag(name, value)
        elif first is int or first is float:
            finite = is_number(value) and (abs(value) <= LARGEST or value == default)
            if not finite or (first is int and (value % 1 or abs(value) > MOST)):
                kind = "whole" if first is int else "finite"
                raise InputError(f"{name}: expected a {kind} number, got {value!r:.60}")
        elif first in (Mapping, dict):
            if not isinstance(value, Mapping):
                raise InputError(f"{name}: expected values by name, got {value!r:.60}")
        elif first in (Sequence, tuple, list):
            if isinstance(value, str) or not isinstance(value, (Sequence, np.ndarray)):
                raise InputError(f"{name}: expected a sequence, got {value!r:.60}")
        elif not (isinstance(value, first) or is_piece(value)):
            word = "a text" if first is str else " or ".join(kind.__name__ for kind in kinds)
            word = "a path" if os.PathLike in more else word.replace("NoneType", "None")
            raise InputError(f"{name}: expected {word}, got {type(value).__name__}")


@cache
def kinds_of(call: Callable[..., Any]) -> dict[str, tuple[tuple[Any, ...], Any]]:
    """The kinds of each argument that is looked at, and its default."""
    names, found = inspect.unwrap(call).__globals__, {}
    for name, parameter in inspect.signature(call).parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        annotated = SimpleNamespace(__annotations__={name: parameter.annotation})
        try:
            hint = get_type_hints(annotated, names)[name]
        except (NameError, AttributeError, TypeError):  # of types that type checkers alone import
            continue
        union = get_origin(hint) in (Union, UnionType)
        kinds = tuple(get_origin(kind) or kind for kind in (get_args(hint) if union else (hint,)))
        if hint != Units and all(kind in KINDS or _is_own(kind) for kind in kinds):
            found[name] = kinds, parameter.default
    return found


def _is_own(kind: Any) -> bool:
    """Whether it is a class of this package, not a protocol."""
    own = isinstance(kind, type) and kind.__module__.startswith("warp_peri.")
    return own and not getattr(kind, "_is_protocol", False)
