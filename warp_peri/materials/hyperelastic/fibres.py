"""Families of fibres and the thickness of a sheet, whose numbers a fit may learn."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
import torch
from numpy import ndarray

from warp_peri.errors import InputError, hold
from warp_peri.materials.hyperelastic.energies import KINDS, LEAST, EnergyTerm, Hyperelastic, Strain
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.points.arguments import Bound, NotNegative, Pair, checked, typed

Part = Annotated[float, Bound("a number from 0 to 1", lambda part: 0 <= part <= 1)]
Directions = Annotated[int, Bound("1 to 10 000 directions", lambda count: 1 <= count <= 10_000)]
LARGEST_EXPONENT = 60.0


@typed
@dataclass(frozen=True, eq=False)
class ThicknessField:
    """A polynomial thickness of a sheet, positive everywhere and one at the centre.

    Attributes:
        degree: of the polynomial, 1 to 6.
        centre, half: where −1 and 1 of its coordinates are: centre ± half [length], shape [2].
        numbers: its coefficients in the order of `names`, shape [P]; zeros where none are given.

    The overall thickness is no number here: displacement alone does not tell it. Raises InputError
    for another degree, or numbers of another count.
    """

    degree: Annotated[int, Bound("a whole number from 1 to 6", range(1, 7).__contains__)]
    centre: ndarray
    half: ndarray
    numbers: ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not checked("numbers", self.numbers).size:
            hold(self, numbers=np.zeros(len(self.names)))
        for name, count in (("centre", 2), ("half", 2), ("numbers", len(self.names))):
            hold(self, **{name: checked(name, getattr(self, name), shape=(count,))})
        if not (self.half > 0).all():
            raise InputError(f"half: expected lengths > 0, got {self.half}")

    @classmethod
    def over(cls, x: ndarray, degree: int) -> ThicknessField:
        """A uniform thickness whose coordinates go from −1 to 1 over the nodes x, shape [N, 2]."""
        if not len(x := checked("x", x, float, ("N", 2))):
            raise InputError("x: expected nodes of a sheet, got none")
        low, high = x.min(axis=0), x.max(axis=0)
        return cls(degree, (low + high) / 2, (high - low) / 2)

    @property
    def _powers(self) -> list[tuple[int, int]]:
        return [(total - b, b) for total in range(1, self.degree + 1) for b in range(total + 1)]

    @property
    def names(self) -> list[str]:
        """Names of the polynomial's coefficients: x, y, x^2, x y, …"""
        each = ([*zip("xy", powers)] for powers in self._powers)
        return [" ".join(v if n == 1 else f"{v}^{n}" for v, n in one if n) for one in each]

    def _terms(self, x: ndarray) -> ndarray:
        x, y = ((checked("x", x, shape=("N", 2)) - self.centre) / self.half).T
        return np.stack([x**a * y**b for a, b in self._powers], axis=1)

    def at(self, x: ndarray) -> ndarray:
        """Thickness at positions [length], [N, 2], relative to that at the centre, [N]."""
        return np.asarray(np.exp(self._terms(x) @ self.numbers))

    def slopes(self, x: ndarray) -> ndarray:
        """Derivative of the thickness with respect to its coefficients, shape [N, P]."""
        return np.asarray(self.at(x)[:, None] * self._terms(x))


@typed
def fibre_fan(count: Directions, powers: Sequence[float] = (2.0, 3.0, 4.0)) -> list[EnergyTerm]:
    """Fibre energies ⟨I4 − 1⟩^p/p in evenly spread directions."""
    return [EnergyTerm("fibre_power", np.pi * n / count, p) for n in range(count) for p in powers]


def _energy(term: EnergyTerm, x: float) -> float:
    """Φ of a fibre with I4 − 1 = x > 0 and coefficient one."""
    along = Strain(torch.from_numpy(np.array([x / 2])))
    return float(KINDS[term.kind](along, 0.0, term.exponent))


@typed
def fibre_families(
    solid: HyperelasticMaterial, *, share: Part = 0.02, within: NotNegative = 0.0
) -> tuple[Hyperelastic, ndarray]:
    """Reduce a fit on fixed fibre directions to one exponential family per direction, (H15).

    Directions with less than a `share` of all fibre energy are dropped, those `within` an angle
    [rad] become one; other energies stay. Returns a dictionary whose angles and exponents are to be
    moved, and coefficients to start from.
    """
    dictionary, energy = solid.dictionary, defaultdict[float, float](float)
    strain = max((solid.stretch or 1.2) ** 2 - 1, 0.05)  # I4 − 1 at the largest stretch of the data
    for n in fibres_of(dictionary):
        term = dictionary.terms[n - dictionary.first_term]
        energy[float(np.mod(term.angle, np.pi))] += solid.coefficients[n] * _energy(term, strain)
    least = share * sum(energy.values())
    groups = grouped({angle: value for angle, value in energy.items() if value > least}, within)
    known = [term.exponent for term in dictionary.terms if term.kind == "fibre_exponential"]
    exponent = float(np.median(known)) if known else 1.0 / strain
    fibres = [EnergyTerm("fibre_exponential", angle, exponent) for angle, _ in groups]
    others = [term for term in dictionary.terms if not term.is_fibre]
    start = [value / _energy(term, strain) for (_, value), term in zip(groups, fibres)]
    left = np.delete(solid.coefficients, fibres_of(dictionary))
    return dictionary.with_terms([*others, *fibres]), np.concatenate([left, start])


@typed
def with_corners(dictionary: Hyperelastic) -> Hyperelastic:
    """The dictionary with energies of uniform strain acting on cell corners as well."""
    corners = (replace(term, corner=True) for term in dictionary.terms if not term.step)
    return dictionary.with_terms([*dict.fromkeys((*dictionary.terms, *corners))])


def grouped(energy: dict[float, float], within: float) -> list[tuple[float, float]]:
    """Directions and energies, those within an angle of each other merged at their middle."""
    if not energy:
        return []
    angles = np.array(sorted(energy))
    first = np.diff(angles, append=angles[0] + np.pi).argmax() + 1  # behind the widest gap
    values = np.roll([energy[angle] for angle in angles], -first)
    angles = np.append(angles[first:], angles[:first] + np.pi)
    parts = np.split(np.arange(len(angles)), np.flatnonzero(np.diff(angles) > within) + 1)
    middles = [float(angles[part] @ values[part] / values[part].sum() % np.pi) for part in parts]
    return sorted(zip(middles, (float(values[part].sum()) for part in parts)))


def fibres_of(dictionary: Hyperelastic) -> list[int]:
    """Indices of the fibre families among the coefficients."""
    return [dictionary.first_term + n for n, term in enumerate(dictionary.terms) if term.is_fibre]


def fibre_numbers(dictionary: Hyperelastic, moving: Sequence[int]) -> tuple[ndarray, Pair]:
    """Angles, then exponents of the fibres at M indices, shape [2 M], and their bounds."""
    terms, M = [dictionary.terms[n - dictionary.first_term] for n in moving], len(moving)
    numbers = np.array([*(t.angle for t in terms), *(t.exponent for t in terms)])
    least = [*M * [-np.inf], *(LEAST[term.kind] for term in terms)]
    return numbers, (np.array(least), np.repeat([np.inf, LARGEST_EXPONENT], M))


def with_numbers(
    solid: HyperelasticMaterial, moving: Sequence[int], x: ndarray
) -> HyperelasticMaterial:
    """The material with other coefficients, angles and exponents of M fibres, x [K + 2 M]."""
    K, terms = len(solid.coefficients), list(solid.dictionary.terms)
    for n, angle, exponent in zip(moving, *np.reshape(x[K:], (2, -1))):
        term = terms[place := n - solid.dictionary.first_term]
        exponent = max(float(exponent), LEAST[term.kind])
        terms[place] = replace(term, angle=float(np.mod(angle, np.pi)), exponent=exponent)
    return replace(solid, dictionary=solid.dictionary.with_terms(terms), coefficients=x[:K])
