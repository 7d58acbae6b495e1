"""Fibre directions and exponents as unknowns: from a rose of many to the families there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from scipy.optimize import least_squares

from warp_peri.materials.hyperelastic.energies import (
    KINDS,
    EnergyTerm,
    Hyperelastic,
    HyperelasticMaterial,
    Strain,
)
from warp_peri.materials.hyperelastic.energy_fit import coefficients, equations, lower_bounds
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import largest_stretch
from warp_peri.points.arguments import Count, typed
from warp_peri.points.samples import Samples

LEAST, LARGEST_EXPONENT = {"fibre_power": 2.0, "fibre_exponential": 0.0}, 60.0
TURN, GROWTH = 0.2, 1.0
"""Largest change of an angle [rad] and an exponent in one step of a search through equilibria."""
ENOUGH = 40
"""Samples that the directions are sought on; all are used for the coefficients at the end."""
SETTLED = 1e-5
"""Relative gain of a step that is the last."""


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


@typed
def fit_fibre_families(
    samples: Samples,
    *,
    matrix: Sequence[str] = ("neo_hookean", "volumetric"),
    deviations: tuple[tuple[int, int], ...] = ((0, 1), (1, 0), (1, 1), (1, -1)),
    stiffness: float = 0.0,
    directions: int = 16,
    most_steps: Count = 12,
) -> HyperelasticMaterial:
    """The material in few numbers: matrix moduli, and families with direction, k1 and k2.

    A fit on many directions says where the families are; then angles and exponents are unknowns of
    a Gauss–Newton method, and families that meet become one.

    Args:
        samples: with loads.
        matrix: kinds of the energies beside the fibres.
        deviations: as for Dictionary.
        stiffness: least coefficient of the deviations.
        directions: of the first fit.
        most_steps: of Gauss and Newton.
    """
    few = Samples(samples.points, samples.u[:ENOUGH], samples.loads[:ENOUGH])
    terms = (*map(EnergyTerm, matrix), *fibre_fan(directions))
    dictionary = Hyperelastic(3.0, (), deviations, terms)
    solid = _fitted(few, dictionary, stiffness)
    for within, share in ((1.6 * np.pi / directions, 0.02), (0.1, 0.01)):
        dictionary, c = fibre_families(solid, within=within, share=share)
        moved = _moved(few, dictionary, c, lower_bounds(dictionary, stiffness), most_steps)
        solid = _fitted(few, moved, stiffness)
    return _fitted(samples, solid.dictionary, stiffness).sparse


def _fitted(samples: Samples, dictionary: Hyperelastic, stiffness: float) -> HyperelasticMaterial:
    """Least squares over coefficients ≥ 0."""
    op = HyperelasticOperator(dictionary, samples)
    c = coefficients(*equations(op, samples), lower_bounds(dictionary, stiffness))
    stretch, units = largest_stretch(op, samples.u), samples.points.units
    return HyperelasticMaterial(dictionary, c, samples.spacing, stretch, units=units)


def fibres_of(dictionary: Hyperelastic) -> list[int]:
    """Places of families of fibres among the coefficients."""
    first = dictionary.first_term
    return [first + n for n, term in enumerate(dictionary.terms) if term.is_fibre]


def fibre_numbers(
    dictionary: Hyperelastic, moving: Sequence[int]
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Angles, then exponents of the fibres at M places, shape [2 M], and bounds after a step."""
    terms, M = [dictionary.terms[n - dictionary.first_term] for n in moving], len(moving)
    numbers = np.array([*(t.angle for t in terms), *(t.exponent for t in terms)])
    reach = np.repeat([TURN, GROWTH], M)
    lower, upper = numbers - reach, np.minimum(numbers + reach, LARGEST_EXPONENT)
    lower[M:] = np.maximum(lower[M:], [LEAST[term.kind] for term in terms])
    return numbers, (lower, np.maximum(upper, lower + 1e-9))


def with_numbers(
    dictionary: Hyperelastic, moving: Sequence[int], numbers: np.ndarray
) -> list[EnergyTerm]:
    """The energies with other angles and exponents of the fibres at these places."""
    terms = list(dictionary.terms)
    for n, angle, exponent in zip(moving, *np.reshape(numbers, (2, -1))):
        term = terms[place := n - dictionary.first_term]
        exponent = max(float(exponent), LEAST[term.kind])
        terms[place] = replace(term, angle=float(np.mod(angle, np.pi)), exponent=exponent)
    return terms


def _moved(
    samples: Samples, dictionary: Hyperelastic, c: np.ndarray, lower: np.ndarray, most_steps: int
) -> Hyperelastic:
    """Least squares over coefficients, angles and exponents, from where they are."""
    moving, K = fibres_of(dictionary), len(dictionary)
    if not moving:
        return dictionary
    op, M = HyperelasticOperator(dictionary, samples), len(moving)

    @lru_cache(1)  # the loss and its slopes are asked for one after the other
    def state(x: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        own, numbers = np.split(np.array(x), [K])
        here = op.with_terms(with_numbers(dictionary, moving, numbers))
        R, y = equations(here, samples, moving, own)
        return R[:, :K] @ own - y, R

    numbers, _ = fibre_numbers(dictionary, moving)
    start = np.append(np.maximum(c, lower), numbers)
    least = [LEAST[dictionary.terms[n - dictionary.first_term].kind] for n in moving]
    bounds = (
        np.concatenate([lower, np.full(M, -np.inf), least]),
        np.append(np.full(K + M, np.inf), np.full(M, LARGEST_EXPONENT)),
    )
    found = least_squares(
        lambda x: state(tuple(x))[0], np.clip(start, *bounds), lambda x: state(tuple(x))[1],
        bounds, ftol=SETTLED, x_scale="jac", max_nfev=most_steps,
    )  # fmt: skip
    return dictionary.with_terms(with_numbers(dictionary, moving, found.x[K:]))
