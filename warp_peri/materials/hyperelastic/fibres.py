"""Fibre directions and exponents as unknowns: from a rose of many to the families there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from warp_peri.materials.hyperelastic.energies import KINDS, EnergyTerm, Hyperelastic, Strain
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.points.arguments import Count, typed

LEAST, LARGEST_EXPONENT = {"fibre_power": 2.0, "fibre_exponential": 0.0}, 60.0


@typed
def fibre_fan(count: Count, powers: Sequence[float] = (2.0, 3.0, 4.0)) -> list[EnergyTerm]:
    """Fibre energies ⟨I4 − 1⟩^p/p in so many directions."""
    return [EnergyTerm("fibre_power", np.pi * n / count, p) for n in range(count) for p in powers]


def _strain(solid: HyperelasticMaterial) -> float:
    """I4 − 1 of the largest stretch of the data."""
    return max((solid.stretch or 1.2) ** 2 - 1, 0.05)


def _energy(term: EnergyTerm, x: float) -> float:
    """Φ of a fibre with I4 − 1 = x > 0 and coefficient one."""
    equal = Strain(torch.tensor([x / 2, x / 2, 0.0], dtype=torch.float64))
    return float(KINDS[term.kind](equal, term.angle, term.exponent))


@typed
def fibre_energy_by_angle(solid: HyperelasticMaterial) -> dict[float, float]:
    """Energy of the fibres in every direction [rad] at the largest stretch of the data."""
    values, energies = solid.coefficients[solid.dictionary.first_term :], dict[float, float]()
    for term, value in zip(solid.dictionary.terms, values):
        if term.is_fibre:
            angle = float(np.mod(term.angle, np.pi))
            energies[angle] = energies.get(angle, 0.0) + value * _energy(term, _strain(solid))
    return energies


@typed
def fibre_families(
    solid: HyperelasticMaterial, *, share: float = 0.02, within: float = 0.0
) -> tuple[Hyperelastic, np.ndarray]:
    """One exponential family for each direction of a fit on fixed directions, (H15).

    Args:
        solid: fitted with many directions.
        share: directions with less than this share of all fibre energy are dropped.
        within: directions closer than this angle [rad] become one.

    Returns:
        A dictionary whose angles and exponents are worth moving, and coefficients to start from.
        Energies other than fibres stay.
    """
    dictionary, strain, energy = solid.dictionary, _strain(solid), fibre_energy_by_angle(solid)
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
    """A dictionary whose energies of a uniform strain act on corners of cells as well."""
    corners = (replace(term, corner=True) for term in dictionary.terms)
    return dictionary.with_terms([*dict.fromkeys((*dictionary.terms, *corners))])


def grouped(energy: dict[float, float], within: float) -> list[tuple[float, float]]:
    """Directions and energies, those within an angle of each other as one in their middle."""
    if not energy:
        return []
    angles = np.array(sorted(energy))
    first = int(np.diff(angles, append=angles[0] + np.pi).argmax()) + 1  # behind the widest gap
    values = np.roll([energy[angle] for angle in angles], -first)
    angles = np.append(angles[first:], angles[:first] + np.pi)
    parts = np.split(np.arange(len(angles)), np.flatnonzero(np.diff(angles) > within) + 1)
    middles = [float(angles[part] @ values[part] / values[part].sum() % np.pi) for part in parts]
    return sorted(zip(middles, (float(values[part].sum()) for part in parts)))


def fibres_of(dictionary: Hyperelastic) -> list[int]:
    """Places of families of fibres among the coefficients."""
    first = dictionary.first_term
    return [first + n for n, term in enumerate(dictionary.terms) if term.is_fibre]


def fibre_numbers(
    dictionary: Hyperelastic, moving: Sequence[int]
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Angles, then exponents of the fibres at M places, shape [2 M], and their bounds."""
    terms, M = [dictionary.terms[n - dictionary.first_term] for n in moving], len(moving)
    numbers = np.array([*(t.angle for t in terms), *(t.exponent for t in terms)])
    least = [*M * [-np.inf], *(LEAST[term.kind] for term in terms)]
    return numbers, (np.array(least), np.repeat([np.inf, LARGEST_EXPONENT], M))


def with_numbers(
    solid: HyperelasticMaterial, moving: Sequence[int], x: np.ndarray
) -> HyperelasticMaterial:
    """The solid with other coefficients, and angles and exponents of the fibres at M places, of
    x [K + 2 M]."""
    K, terms = len(solid.coefficients), list(solid.dictionary.terms)
    for n, angle, exponent in zip(moving, *np.reshape(x[K:], (2, -1))):
        term = terms[place := n - solid.dictionary.first_term]
        exponent = max(float(exponent), LEAST[term.kind])
        terms[place] = replace(term, angle=float(np.mod(angle, np.pi)), exponent=exponent)
    return replace(solid, dictionary=solid.dictionary.with_terms(terms), coefficients=x[:K])
