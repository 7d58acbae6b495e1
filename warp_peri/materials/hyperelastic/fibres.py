"""Fibre directions and exponents as unknowns: from a rose of many to the families there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warp_peri.materials.hyperelastic.energies import Dictionary, HyperelasticSolid, Term
from warp_peri.materials.hyperelastic.energy_fit import (
    between,
    equations,
    lower_bounds,
    non_negative,
    residual,
)
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import largest_stretch
from warp_peri.points.samples import Samples

LEAST, LARGEST_EXPONENT = {"fibre_power": 2.0, "fibre_exponential": 0.0}, 60.0
TURN, GROWTH = 0.2, 1.0
"""Largest change of an angle [rad] and an exponent in one step."""
ENOUGH = 40
"""Samples that the directions are sought on; all are used for the coefficients at the end."""


def rose(count: int, powers: Sequence[float] = (2.0, 3.0, 4.0)) -> list[Term]:
    """Fibre energies ⟨I4 − 1⟩^p/p in so many directions."""
    return [Term("fibre_power", np.pi * n / count, p) for n in range(count) for p in powers]


def fibre_energy(term: Term, x: float) -> float:
    """Φ of a fibre with I4 − 1 = x > 0 and coefficient one."""
    if term.kind == "fibre_power":
        return float(x**term.exponent / term.exponent)
    if term.exponent < 1e-8:
        return 0.5 * x**2
    return float(np.expm1(term.exponent * x**2) / (2 * term.exponent))


def rose_of(solid: HyperelasticSolid) -> dict[float, float]:
    """Energy of the fibres in every direction [rad] at the largest stretch of the data."""
    strain = max((solid.stretch or 1.2) ** 2 - 1, 0.05)
    values = solid.coefficients[solid.dictionary.first_term :]
    energies: dict[float, float] = {}
    for term, value in zip(solid.dictionary.terms, values):
        if term.is_fibre:
            angle = float(np.mod(term.angle, np.pi))
            energies[angle] = energies.get(angle, 0.0) + value * fibre_energy(term, strain)
    return energies


def families(
    solid: HyperelasticSolid, *, share: float = 0.02, within: float = 0.0
) -> tuple[Dictionary, np.ndarray]:
    """One exponential family for each direction of a fit on fixed directions, (H15).

    Args:
        solid: fitted with many directions.
        share: directions with less than this share of all fibre energy are dropped.
        within: directions closer than this angle [rad] become one.

    Returns:
        A dictionary whose angles and exponents are worth moving, and coefficients to start from.
        Energies other than fibres stay.
    """
    dictionary, c = solid.dictionary, solid.coefficients
    strain = max((solid.stretch or 1.2) ** 2 - 1, 0.05)
    energy = rose_of(solid)
    total = sum(energy.values())
    kept = {angle: value for angle, value in energy.items() if value > share * total}
    groups = grouped(kept, within)
    own = [term for term in dictionary.terms if term.is_fibre and term.kind == "fibre_exponential"]
    exponent = float(np.median([term.exponent for term in own])) if own else 1.0 / strain
    first = dictionary.first_term
    others = [n for n, term in enumerate(dictionary.terms) if not term.is_fibre]
    terms = [dictionary.terms[n] for n in others]
    fibres = [Term("fibre_exponential", angle, exponent) for angle, _ in groups]
    start = [value / fibre_energy(term, strain) for (_, value), term in zip(groups, fibres)]
    return (
        dictionary.with_terms([*terms, *fibres]),
        np.concatenate([c[:first], c[first:][others], start]),
    )


def with_directions(
    dictionary: Dictionary, solid: HyperelasticSolid, *, within: float = 0.02
) -> Dictionary:
    """A dictionary with the directions of another solid's fibres beside its own.

    Args:
        dictionary: whose fibres stand in fixed directions.
        solid: in whose fibres the directions were unknowns, as read_material gives.
        within: no direction is added that differs from one there is by less [rad].
    """
    known = [term.angle for term in dictionary.terms if term.is_fibre]
    added: list[Term] = []
    for term in solid.dictionary.terms:
        gaps = [abs((term.angle - angle + np.pi / 2) % np.pi - np.pi / 2) for angle in known]
        if term.is_fibre and min(gaps, default=np.pi) > within:
            added += [Term("fibre_power", term.angle, p) for p in (2.0, 3.0, 4.0)] + [term]
            known.append(term.angle)
    return dictionary.with_terms((*dictionary.terms, *added))


def with_families(dictionary: Dictionary, solid: HyperelasticSolid) -> Dictionary:
    """A dictionary with another solid's families of fibres, at the nodes and on corners of cells.

    Args:
        dictionary: of any energies.
        solid: whose fibres have exponents that were unknowns, as read_material gives.
    """
    read = [term for term in solid.dictionary.terms if term.is_fibre]
    return _joined(dictionary, [*read, *(replace(term, corner=True) for term in read)])


def with_corners(dictionary: Dictionary) -> Dictionary:
    """A dictionary whose energies of a uniform strain act on corners of cells as well."""
    return _joined(dictionary, [replace(term, corner=True) for term in dictionary.terms])


def _joined(dictionary: Dictionary, terms: Sequence[Term]) -> Dictionary:
    """The energies of a dictionary with others that it lacks, each once."""
    new = [term for term in dict.fromkeys(terms) if term not in dictionary.terms]
    return dictionary.with_terms((*dictionary.terms, *new))


def grouped(energy: dict[float, float], within: float) -> list[tuple[float, float]]:
    """Directions and energies, those within an angle of each other as one in their middle."""
    groups: list[list[tuple[float, float]]] = []
    for angle, value in sorted(energy.items()):
        if groups and angle - groups[-1][-1][0] <= within:
            groups[-1].append((angle, value))
        else:
            groups.append([(angle, value)])
    if len(groups) > 1 and groups[0][0][0] + np.pi - groups[-1][-1][0] <= within:
        groups[0] = [(angle - np.pi, value) for angle, value in groups.pop()] + groups[0]
    middles = []
    for group in groups:
        angles, values = np.array(group).T
        middles.append((float(np.mod(angles @ values / values.sum(), np.pi)), float(values.sum())))
    return middles


def read_material(
    samples: Samples,
    *,
    matrix: Sequence[str] = ("neo_hookean", "volumetric"),
    deviations: tuple[tuple[int, int], ...] = ((0, 1), (1, 0), (1, 1), (1, -1)),
    stiffness: float = 0.0,
    directions: int = 16,
    most_steps: int = 12,
) -> HyperelasticSolid:
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
    terms = (*map(Term, matrix), *rose(directions))
    dictionary = Dictionary(3.0, (), deviations, terms)
    op = HyperelasticOperator(dictionary, few)
    c = non_negative(equations(op, few), lower=lower_bounds(dictionary, stiffness))
    stretch = largest_stretch(op, few.u)
    solid = HyperelasticSolid(dictionary, c, samples.spacing, stretch, units=samples.points.units)
    for within, share in ((1.6 * np.pi / directions, 0.02), (0.1, 0.01)):
        dictionary, c = families(solid, within=within, share=share)
        solid = move(
            few,
            replace(solid, dictionary=dictionary, coefficients=c),
            stiffness=stiffness,
            most_steps=most_steps,
        )
    op = HyperelasticOperator(solid.dictionary, samples)
    c = non_negative(equations(op, samples), lower=lower_bounds(solid.dictionary, stiffness))
    return replace(solid, coefficients=c, stretch=largest_stretch(op, samples.u)).sparse


def fibres_of(dictionary: Dictionary) -> list[int]:
    """Places of families of fibres among the coefficients."""
    first = dictionary.first_term
    return [first + n for n, term in enumerate(dictionary.terms) if term.is_fibre]


def fibre_numbers(
    dictionary: Dictionary, moving: Sequence[int]
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Angles, then exponents of the fibres at M places, shape [2 M], and bounds after a step."""
    terms, M = [dictionary.terms[n - dictionary.first_term] for n in moving], len(moving)
    numbers = np.array([*(t.angle for t in terms), *(t.exponent for t in terms)])
    reach = np.repeat([TURN, GROWTH], M)
    lower, upper = numbers - reach, np.minimum(numbers + reach, LARGEST_EXPONENT)
    lower[M:] = np.maximum(lower[M:], [LEAST[term.kind] for term in terms])
    return numbers, (lower, np.maximum(upper, lower + 1e-9))


def with_numbers(dictionary: Dictionary, moving: Sequence[int], numbers: np.ndarray) -> list[Term]:
    """The energies with other angles and exponents of the fibres at these places."""
    terms = list(dictionary.terms)
    for n, angle, exponent in zip(moving, *np.reshape(numbers, (2, -1))):
        term = terms[place := n - dictionary.first_term]
        exponent = max(float(exponent), LEAST[term.kind])
        terms[place] = replace(term, angle=float(np.mod(angle, np.pi)), exponent=exponent)
    return terms


def move(
    samples: Samples, solid: HyperelasticSolid, *, stiffness: float = 0.0, most_steps: int = 12
) -> HyperelasticSolid:
    """Least squares over coefficients ≥ 0, angles and exponents, from where they are."""
    op = HyperelasticOperator(solid.dictionary, samples)
    moving, lower = fibres_of(solid.dictionary), lower_bounds(solid.dictionary, stiffness)
    system = equations(op, samples)
    c = non_negative(system, lower=lower)
    best, damping, K = residual(system, c), 1e-6, len(c)
    for _ in range(most_steps if moving else 0):
        wide = equations(op, samples, moving, c)
        numbers, (least, most) = fibre_numbers(op.dictionary, moving)
        bounds = (np.append(lower, least), np.append(np.full(K, np.inf), most))
        y = wide.y + wide.R[:, K:] @ numbers
        for _ in range(6):
            moved = between(wide.R, y, np.append(c, numbers), bounds, damping)
            tried = op.with_terms(with_numbers(op.dictionary, moving, moved[K:]))
            system = equations(tried, samples)
            new = non_negative(system, lower=lower)
            size = residual(system, new)
            if size < best:
                break
            damping = max(10 * damping, 1e-4)
        else:
            break
        gain, best, op, c, damping = 1 - size / best, size, tried, new, damping / 10
        if gain < 1e-5:
            break
    return replace(solid, dictionary=op.dictionary, coefficients=c)
