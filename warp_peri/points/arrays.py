"""Arrays as they enter: of the kind and shape asked for, contiguous, finite, nothing masked."""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_peri.errors import InputError

LARGEST = 1e100
"""Values above it are no data, and their squares soon no numbers."""


def checked(
    name: str, value: Any, kind: type = float, shape: tuple[int | str, ...] | None = None
) -> np.ndarray:
    """An array of float64, of bool, or of whole numbers, whose entries are all there.

    Args:
        name: of it in messages.
        value: what a user gave.
        kind: float, bool or int.
        shape: that it must have; names stand for any length.

    Raises InputError for complex numbers, text and objects, for masked entries, for numbers that
    are not finite or beyond LARGEST, and for another shape.
    """
    try:
        masked = np.ma.array(value, copy=False)  # that of a list of masked arrays too
    except ValueError as error:
        raise InputError(f"{name}: expected an array ({error})") from None
    value = np.asarray(masked.data)
    if value.dtype.kind not in {bool: "b", int: "iu"}.get(kind, "fiu"):
        raise InputError(f"{name}: expected {kind.__name__} values, got {value.dtype}")
    if np.any(masked.mask):
        first = np.argwhere(np.ma.getmaskarray(masked))[0].tolist()
        raise InputError(
            f"{name}: expected values everywhere, got {np.count_nonzero(masked.mask)} of "
            f"{value.size} masked, the first at index {first}"
        )
    value = np.require(value, np.float64 if kind is float else value.dtype, ["C", "W"])
    if kind is float and not np.isfinite(value).all():
        bad = np.argwhere(~np.isfinite(value))[0].tolist()
        raise InputError(f"{name}: expected finite values, got {value[tuple(bad)]} at index {bad}")
    if kind is float and value.size and np.abs(value).max() > LARGEST:
        bad = np.unravel_index(np.abs(value).argmax(), value.shape)
        index = [int(index) for index in bad]
        raise InputError(
            f"{name}: expected values below {LARGEST:g}, got {value[bad]:g} at index {index}"
        )
    if shape is not None and (
        value.ndim != len(shape)
        or any(wanted not in (n, str(wanted)) for n, wanted in zip(value.shape, shape))
    ):
        raise InputError(
            f"{name}: expected shape [{', '.join(map(str, shape))}], got {list(value.shape)}"
        )
    return np.asarray(value)


def is_number(value: Any) -> bool:
    """Whether it is one real number."""
    ragged = isinstance(value, (list, tuple))  # which NumPy may refuse to look at
    return not ragged and np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"


def is_positive(value: Any) -> bool:
    """Whether it is one real number above zero, and finite."""
    return is_number(value) and 0 < value < np.inf


def is_name(name: Any) -> bool:
    """Whether HDF5 takes it as the name of one thing."""
    return isinstance(name, str) and name not in ("", ".") and "/" not in name
