"""Arrays as they enter: of the kind asked for, contiguous, finite."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError

LARGEST = 1e100
"""Values above it are no data, and their squares soon no numbers."""


def checked(name: str, value: ArrayLike, kind: type) -> np.ndarray:
    """An array of float64 or bool; InputError naming it and the first value that is not finite."""
    try:
        value = np.asarray(value)
    except ValueError as error:
        raise InputError(f"{name}: expected an array ({error})") from None
    wanted = "b" if kind is bool else "fiu"
    if value.dtype.kind not in wanted:
        raise InputError(f"{name}: expected {kind.__name__} values, got {value.dtype}")
    value = np.require(value, np.float64 if kind is float else bool, ["C", "W"])
    if kind is float and not np.isfinite(value).all():
        bad = np.argwhere(~np.isfinite(value))[0].tolist()
        raise InputError(f"{name}: expected finite values, got {value[tuple(bad)]} at index {bad}")
    if kind is float and value.size and np.abs(value).max() > LARGEST:
        bad = np.unravel_index(np.abs(value).argmax(), value.shape)
        index = [int(index) for index in bad]
        raise InputError(
            f"{name}: expected values below {LARGEST:g}, got {value[bad]:g} at index {index}"
        )
    return value


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
