"""How thick a sheet is from place to place: the exponential of a polynomial, (H18)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from warp_peri.errors import InputError

LARGEST_DEGREE = 6
LARGEST = 20.0
"""Of the polynomial: beyond ± this the thickness stays at e^± this, so that it is a number."""


@dataclass(frozen=True, eq=False)
class Thickness:
    """A thickness that is positive everywhere and one at the centre.

    Attributes:
        degree: of the polynomial, 1 to 6.
        centre, half: where −1 and 1 of its coordinates are: centre ± half [length], shape [2].
        numbers: its coefficients in the order of `names`, shape [P]; zeros where none are given.

    The thickness of the whole sheet is no number here: from displacement alone it cannot be told.
    Raises InputError for another degree, halves that are not positive, or numbers of another count.
    """

    degree: int
    centre: np.ndarray
    half: np.ndarray
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        whole = isinstance(self.degree, (int, np.integer)) and not isinstance(self.degree, bool)
        if not (whole and 1 <= self.degree <= LARGEST_DEGREE):
            raise InputError(f"degree: expected 1 to {LARGEST_DEGREE}, got {self.degree!r}")
        centre, half = (np.array(value, float) for value in (self.centre, self.half))
        if centre.shape != (2,) or half.shape != (2,) or not np.isfinite(centre).all():
            raise InputError("centre, half: expected two finite lengths each")
        if not (np.isfinite(half).all() and half.min() > 0):
            raise InputError(f"half: expected two lengths > 0, got {half.tolist()}")
        numbers = np.array(self.numbers, float)
        if not numbers.size:
            numbers = np.zeros(len(self.names))
        if numbers.shape != (len(self.names),) or not np.isfinite(numbers).all():
            raise InputError(
                f"numbers: expected {len(self.names)} finite numbers, got shape {numbers.shape}"
            )
        for name, value in (("centre", centre), ("half", half), ("numbers", numbers)):
            object.__setattr__(self, name, value)

    @classmethod
    def over(cls, x: np.ndarray, degree: int) -> Thickness:
        """An even thickness whose coordinates go from −1 to 1 over the nodes x, shape [N, 2]."""
        low, high = np.min(x, axis=0), np.max(x, axis=0)
        return cls(degree, (low + high) / 2, (high - low) / 2)

    @property
    def _powers(self) -> list[tuple[int, int]]:
        return [(total - b, b) for total in range(1, self.degree + 1) for b in range(total + 1)]

    @property
    def names(self) -> list[str]:
        """Names of the numbers: x, y, x^2, x y, …"""
        words = []
        for powers in self._powers:
            parts = [f"{s}^{p}" if p > 1 else s for s, p in zip("xy", powers) if p]
            words.append(" ".join(parts))
        return words

    def _terms(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        if x.ndim != 2 or x.shape[1] != 2:
            raise InputError(f"x: expected positions of shape [N, 2], got {list(x.shape)}")
        place = (x - self.centre) / self.half
        return np.stack([place[:, 0] ** a * place[:, 1] ** b for a, b in self._powers], axis=1)

    def at(self, x: np.ndarray) -> np.ndarray:
        """Thickness at positions [length] of shape [N, 2], over that at the centre, shape [N]."""
        values: np.ndarray = np.exp(np.clip(self._terms(x) @ self.numbers, -LARGEST, LARGEST))
        return values

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Its derivative by the numbers, shape [N, P]."""
        terms = self._terms(x)
        inside = np.abs(terms @ self.numbers) <= LARGEST
        values: np.ndarray = (inside * self.at(x))[:, None] * terms
        return values
