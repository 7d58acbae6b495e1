"""The thickness of a sheet that is not even."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arguments import checked, typed_methods

LARGEST_DEGREE = 6


@typed_methods
@dataclass(frozen=True, eq=False)
class ThicknessField:
    """A thickness that is positive everywhere and one at the centre.

    Attributes:
        degree: of the polynomial, 1 to 6.
        centre, half: where −1 and 1 of its coordinates are: centre ± half [length], shape [2].
        numbers: its coefficients in the order of `names`, shape [P]; zeros where none are given.

    The thickness of the whole sheet is no number here: from displacement alone it cannot be told.
    Raises InputError for another degree, or numbers of another count.
    """

    degree: int
    centre: np.ndarray
    half: np.ndarray
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.degree not in range(1, LARGEST_DEGREE + 1) or self.degree is True:
            raise InputError(f"degree: expected 1 to {LARGEST_DEGREE}, got {self.degree!r}")
        if not np.size(self.numbers):
            object.__setattr__(self, "numbers", np.zeros(len(self.names)))
        for name, count in (("centre", 2), ("half", 2), ("numbers", len(self.names))):
            object.__setattr__(self, name, checked(name, getattr(self, name), shape=(count,)))

    @classmethod
    def over(cls, x: np.ndarray, degree: int) -> ThicknessField:
        """An even thickness whose coordinates go from −1 to 1 over the nodes x, shape [N, 2]."""
        low, high = np.min(x, axis=0), np.max(x, axis=0)
        return cls(degree, (low + high) / 2, (high - low) / 2)

    @property
    def _powers(self) -> list[tuple[int, int]]:
        return [(total - b, b) for total in range(1, self.degree + 1) for b in range(total + 1)]

    @property
    def names(self) -> list[str]:
        """Names of the numbers: x, y, x^2, x y, …"""
        each = ([*zip("xy", powers)] for powers in self._powers)
        return [" ".join(v if n == 1 else f"{v}^{n}" for v, n in one if n) for one in each]

    def _terms(self, x: np.ndarray) -> np.ndarray:
        x, y = ((checked("x", x, shape=("N", 2)) - self.centre) / self.half).T
        return np.stack([x**a * y**b for a, b in self._powers], axis=1)

    def at(self, x: np.ndarray) -> np.ndarray:
        """Thickness at positions [length] of shape [N, 2], over that at the centre, shape [N]."""
        return np.asarray(np.exp(self._terms(x) @ self.numbers))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Its derivative by the numbers, shape [N, P]."""
        return np.asarray(self.at(x)[:, None] * self._terms(x))
