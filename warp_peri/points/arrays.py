"""Fields and numbers as they come in: checked, told apart, written as series."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from warp_peri.errors import InputError

LARGEST = 1e100
"""Values above it are no data, and their squares soon no numbers."""


MOST = 2**53
"""Counts above it are none, nor whole numbers told apart in float64."""


GRADIENT = "expected values without a gradient, which is not had here, got tensors with one"


def as_array(name: str, value: Any) -> np.ma.MaskedArray[Any, Any]:
    """An array of what a user gave, masked where its parts are; InputError for what makes none."""
    try:
        return np.ma.array(np.ma.asanyarray(value), copy=False)
    except (RuntimeError, TypeError, ValueError) as error:
        if getattr(value, "requires_grad", False):
            raise InputError(f"{name}: {GRADIENT}") from None
        raise InputError(f"{name}: expected an array ({error})") from None


def plain(name: str, value: Any) -> np.ndarray:
    """An array of float64, whose values may be anything; InputError for a tensor whose gradient
    would be lost, for masked entries, complex numbers, text and objects."""
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
    """An array of float64, of bool, or of whole numbers, whose entries are all there.

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


def checked_fields(
    points: Any, b: Any, u: Any, one: tuple[int, ...] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Load and displacement of a problem on nodes, for every material; the second a copy.

    Args:
        points: nodes; b is looked at on the interior, u on the others.
        b: None for no load.
        u: shape [N, d] or [S, N, d]; b has the same.
        one: shape of one field where it is not [N, d].

    Raises InputError as `checked`, and for other shapes.
    """
    one = points.x.shape if one is None else one
    inside = points.interior.reshape(-1, *[1] * (len(one) - 1))
    field = checked("u", u, float, (..., *one), ~inside).copy()
    if field.ndim > len(one) + 1:
        shown = ", ".join(map(str, one))
        raise InputError(f"u: expected shape [{shown}] or [S, {shown}], got {list(field.shape)}")
    load = np.zeros(field.shape) if b is None else checked("b", b, float, field.shape, inside)
    return load, field


def is_piece(points: Any) -> bool:
    """Whether nodes are a rank's piece of those that many processes have."""
    return hasattr(points, "comm")


def is_number(value: Any) -> bool:
    """Whether it is one real number; InputError for a tensor whose gradient would be lost."""
    if getattr(value, "requires_grad", False):
        raise InputError(f"number: {GRADIENT}")
    strange = isinstance(value, (list, tuple)) or getattr(value, "is_meta", False)  # for NumPy
    return not strange and np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"


def are_numbers(value: Any) -> bool:
    """Whether an array can be made of it, no text and no objects; tensors are looked at later."""
    try:
        found = value if hasattr(value, "dtype") else np.ma.asanyarray(value)
    except RuntimeError:  # of tensors with a gradient
        return True
    except (TypeError, ValueError):
        return False
    return getattr(found.dtype, "kind", "f") in "biufc"


def is_positive(value: Any) -> bool:
    """Whether it is one real number above zero, and finite."""
    return is_number(value) and 0 < value < np.inf


def check_whole(name: str, value: Any, least: int) -> int:
    """The whole number that it is; InputError for what is none from `least` on, or no count."""
    if not (is_number(value) and least <= value <= MOST and value % 1 == 0):
        raise InputError(f"{name}: expected a whole number ≥ {least}, got {value!r:.60}")
    return int(value)


def check_flag(name: str, value: Any) -> None:
    """Raise InputError for what is neither True nor False: a text "no" would count as true."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name}: expected True or False, got {value!r:.60}")


def check_mapping(name: str, value: Any) -> None:
    """Raise InputError for what is no mapping of names."""
    if not (isinstance(value, Mapping) and all(isinstance(key, str) for key in value)):
        raise InputError(f"{name}: expected values by name, as {{'name': …}}, got {value!r:.60}")


def listed(nodes: np.ndarray) -> str:
    """The first few node numbers."""
    return ", ".join(str(i) for i in nodes[:8]) + (" …" if len(nodes) > 8 else "")


def is_name(name: Any) -> bool:
    """Whether HDF5 takes it as the name of one thing."""
    return isinstance(name, str) and name not in ("", ".") and not {"/", "\0"} & {*name}


SAMPLES = 32
"""Places along a bond at which a field is read."""


def mean_inverse(values: Callable[[float], np.ndarray]) -> np.ndarray:
    """Mean along bonds of 1/field, whose values at a share of each bond's length are given."""
    places = (np.arange(SAMPLES) + 0.5) / SAMPLES
    return np.asarray(sum(1 / values(float(place)) for place in places) / SAMPLES)
