"""Fits of hyperelastic energies to forces, and of fibre families and sheet thickness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from scipy.optimize import least_squares, lsq_linear

from warp_peri.errors import InputError
from warp_peri.fitting.rows import compressed, load_sizes
from warp_peri.materials.hyperelastic.energies import KINDS, EnergyTerm, Hyperelastic, Strain
from warp_peri.materials.hyperelastic.operator import (
    HyperelasticMaterial,
    HyperelasticSheetOperator,
)
from warp_peri.points.arguments import Count, NotNegative, checked, typed, typed_methods
from warp_peri.points.points import PointsLike, Samples, nodes_of

RIDGE = 1e-9
"""Of the squared length of the scaled coefficients, relative to the data."""
NONE = np.zeros((0, 1))
ENOUGH = 40
"""Samples that the directions are sought on; all are used for the coefficients at the end."""
SETTLED = 1e-5
"""Relative gain of a step that is the last."""
LEAST, LARGEST_EXPONENT = {"fibre_power": 2.0, "fibre_exponential": 0.0}, 60.0
LARGEST_DEGREE = 6


@typed_methods
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
        if not (self.half > 0).all():
            raise InputError(f"half: expected lengths > 0, got {self.half}")

    @classmethod
    def over(cls, x: np.ndarray, degree: int) -> ThicknessField:
        """A uniform thickness whose coordinates go from −1 to 1 over the nodes x, shape [N, 2]."""
        low, high = np.min(x, axis=0), np.max(x, axis=0)
        return cls(degree, (low + high) / 2, (high - low) / 2)

    @property
    def _powers(self) -> list[tuple[int, int]]:
        return [(total - b, b) for total in range(1, self.degree + 1) for b in range(total + 1)]

    @property
    def names(self) -> list[str]:
        """Names of the polynomial's coefficients: x, y, x^2, x y, …"""
        each = ([*zip("xy", powers)] for powers in self._powers)
        return [" ".join(v if n == 1 else f"{v}^{n}" for v, n in one if n) for one in each]

    def _terms(self, x: np.ndarray) -> np.ndarray:
        x, y = ((checked("x", x, shape=("N", 2)) - self.centre) / self.half).T
        return np.stack([x**a * y**b for a, b in self._powers], axis=1)

    def at(self, x: np.ndarray) -> np.ndarray:
        """Thickness at positions [length], [N, 2], relative to that at the centre, [N]."""
        return np.asarray(np.exp(self._terms(x) @ self.numbers))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivative of the thickness with respect to its coefficients, shape [N, P]."""
        return np.asarray(self.at(x)[:, None] * self._terms(x))


@typed
def fibre_fan(count: Count, powers: Sequence[float] = (2.0, 3.0, 4.0)) -> list[EnergyTerm]:
    """Fibre energies ⟨I4 − 1⟩^p/p in evenly spread directions."""
    return [EnergyTerm("fibre_power", np.pi * n / count, p) for n in range(count) for p in powers]


def _strain(solid: HyperelasticMaterial) -> float:
    """I4 − 1 at the largest stretch of the data."""
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
    """Reduce a fit on fixed fibre directions to one exponential family per direction, (H15).

    Directions with less than a `share` of all fibre energy are dropped, those `within` an angle
    [rad] become one; other energies stay. Returns a dictionary whose angles and exponents are to be
    moved, and coefficients to start from.
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
    """The dictionary with energies of uniform strain acting on cell corners as well."""
    corners = (replace(term, corner=True) for term in dictionary.terms)
    return dictionary.with_terms([*dict.fromkeys((*dictionary.terms, *corners))])


def grouped(energy: dict[float, float], within: float) -> list[tuple[float, float]]:
    """Directions and energies, those within an angle of each other merged at their middle."""
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
    """Indices of the fibre families among the coefficients."""
    first = dictionary.first_term
    return [first + n for n, term in enumerate(dictionary.terms) if term.is_fibre]


def fibre_numbers(
    dictionary: Hyperelastic, moving: Sequence[int]
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Angles, then exponents of the fibres at M indices, shape [2 M], and their bounds."""
    terms, M = [dictionary.terms[n - dictionary.first_term] for n in moving], len(moving)
    numbers = np.array([*(t.angle for t in terms), *(t.exponent for t in terms)])
    least = [*M * [-np.inf], *(LEAST[term.kind] for term in terms)]
    return numbers, (np.array(least), np.repeat([np.inf, LARGEST_EXPONENT], M))


def with_numbers(
    solid: HyperelasticMaterial, moving: Sequence[int], x: np.ndarray
) -> HyperelasticMaterial:
    """The material with other coefficients, angles and exponents of M fibres, x [K + 2 M]."""
    K, terms = len(solid.coefficients), list(solid.dictionary.terms)
    for n, angle, exponent in zip(moving, *np.reshape(x[K:], (2, -1))):
        term = terms[place := n - solid.dictionary.first_term]
        exponent = max(float(exponent), LEAST[term.kind])
        terms[place] = replace(term, angle=float(np.mod(angle, np.pi)), exponent=exponent)
    return replace(solid, dictionary=solid.dictionary.with_terms(terms), coefficients=x[:K])


def sheet_on(dictionary: Hyperelastic, points: PointsLike) -> HyperelasticSheetOperator:
    """Build the sheet operator of all energies with coefficient one."""
    nodes = nodes_of(points)
    one = np.ones(len(dictionary))
    return HyperelasticMaterial(dictionary, one, nodes.spacing, units=nodes.units).on(nodes)


def columns(op: HyperelasticSheetOperator, u: np.ndarray, moving: Sequence[int] = ()) -> np.ndarray:
    """Derivatives of the interior's force at a field by all coefficients, then by angles and
    exponents of the fibres at M indices, shape [2 I, K + 2 M]."""
    found = [op.features(u)]
    for by in ("angle", "exponent") if len(moving) else ():
        found.append(op.features(u, by=by)[..., moving])
    return np.concatenate(found, axis=-1).reshape(2 * len(op.interior), -1)


def equations(
    op: HyperelasticSheetOperator,
    fields: np.ndarray,
    loads: np.ndarray,
    weights: np.ndarray,
    moving: Sequence[int] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Compressed rows R and y of `columns` and loads, (H11); residuals weigh by [S, 1 or 2 I]."""
    R, y = np.zeros((0, len(op.model.coefficients) + 2 * len(moving))), np.zeros(0)
    for u, b, weight in zip(fields, loads, weights):
        R = np.concatenate([R, columns(op, u, moving) * weight[:, None]])
        R, y = compressed(R, np.append(y, b.ravel() * weight))
    return R, y


def of_samples(
    op: HyperelasticSheetOperator, samples: Samples, moving: Sequence[int] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Rows R and y, (H11), with ‖R c − y‖ the root mean squared relative residual of samples;
    InputError where there are none, or one without load."""
    if not (len(samples) and (sizes := load_sizes(samples)).all()):
        raise InputError(
            "samples: expected some, and a load on the interior of each, got one without; "
            "without loads learn from displacement alone"
        )
    weights = 1 / (sizes[:, None] * np.sqrt(len(samples)))
    return equations(op, samples.u, samples.loads[:, op.interior], weights, moving)


def between(
    J: np.ndarray, y: np.ndarray, now: np.ndarray, bounds: Any, damping: float, held: Any = NONE
) -> np.ndarray:
    """Minimise |J x − y|² between two bounds, with Levenberg's damping of the step from `now`;
    products of x with the rows `held` nearly stay."""
    length = np.linalg.norm(J, axis=0)
    length[length == 0] = 1.0
    A = np.concatenate([J / length, np.sqrt(damping) * np.eye(len(now)), held / length])
    y = np.concatenate([y, np.sqrt(damping) * length * now, (held * now).sum(axis=1)])
    within, most = [bound * length for bound in bounds], 10 * len(now)
    x = lsq_linear(A, y, within, method="bvls", max_iter=most).x / length
    return np.asarray(np.clip(x, *bounds))


def lower_bounds(dictionary: Hyperelastic, stiffness: float, others: float = 0.0) -> np.ndarray:
    """Lower bounds [stress] of coefficients: `stiffness` against hourglasses, `others` else."""
    lower = np.full(len(dictionary), others)
    first, last, bonds = dictionary.first_deviation, dictionary.first_term, len(dictionary.bonds)
    lower[first:last] = stiffness or others
    if last == first and bonds and others == 0:
        lower[: 4 * bonds : bonds] = stiffness
    return lower


@typed_methods
@dataclass(frozen=True, eq=False)
class EnergyFit:
    """A fitted material, its root mean squared relative residual on the training samples, and
    whether all coefficients keep their bounds, so that (H9) holds."""

    material: HyperelasticMaterial
    residual: float
    guaranteed: bool


def _fitted(
    op: HyperelasticSheetOperator, samples: Samples, lower: np.ndarray, ridge: float = RIDGE
) -> tuple[HyperelasticMaterial, float]:
    """Least squares over coefficients ≥ `lower`, and the residual."""
    R, y = of_samples(op, samples)
    start, most = np.where(np.isfinite(lower), lower, 0.0), np.full(len(lower), np.inf)
    c = between(R, y, start, (lower, most), ridge)
    solid = replace(op.model, coefficients=c, stretch=op.largest_stretch(samples.u))
    return solid, float(np.linalg.norm(R @ c - y))


@typed
def fit_energy(
    samples: Samples,
    dictionary: Hyperelastic,
    *,
    positive: bool = False,
    stiffness: NotNegative = 0.0,
    ridge: NotNegative = RIDGE,
) -> EnergyFit:
    """Fit the coefficients of a dictionary of energies to displacements and loads on a lattice.

    Args:
        samples: displacements and loads.
        dictionary: of energies.
        positive: coefficients ≥ 0; asks for a dictionary whose energies are safe with them.
        stiffness: least coefficient of the deviations (or, without deviations, of the bonds within
            two spacings), against hourglasses [stress]. Without positive it bounds the deviations
            only, and the other coefficients have any sign.
        ridge: relative weight of the coefficients' squared length.

    Raises InputError for positive with a dictionary that guarantees nothing, for no samples, and
    for one without load.
    """
    if positive and not dictionary.guaranteed:
        raise InputError("positive: expected energies that are convex and stress-free at rest only")
    lower = lower_bounds(dictionary, stiffness, 0.0 if positive else -np.inf)
    return EnergyFit(*_fitted(sheet_on(dictionary, samples), samples, lower, ridge), positive)


@typed
def fit_fibre_families(
    samples: Samples,
    *,
    matrix: Sequence[str] = ("neo_hookean", "volumetric"),
    deviations: tuple[tuple[int, int], ...] = ((0, 1), (1, 0), (1, 1), (1, -1)),
    stiffness: NotNegative = 0.0,
    directions: Count = 16,
    most_steps: Count = 12,
) -> HyperelasticMaterial:
    """Fit a material of few parameters: matrix moduli, and fibre families with direction, k1 and
    k2.

    A fit on many directions says where the families are; then angles and exponents are unknowns of
    a Gauss–Newton method, and families that meet become one.

    Args:
        samples: with loads.
        matrix: kinds of the energies beside the fibres.
        deviations, stiffness: as of Hyperelastic, and their least coefficient.
        directions, most_steps: of the first fit, and of Gauss and Newton.
    """

    def fitted(samples: Samples, model: HyperelasticMaterial) -> HyperelasticMaterial:
        dictionary, sheet = model.dictionary, op.changed(model, None)
        return _fitted(sheet, samples, lower_bounds(dictionary, stiffness))[0]

    few = Samples(samples.points, samples.u[:ENOUGH], samples.loads[:ENOUGH])
    terms = (*map(EnergyTerm, matrix), *fibre_fan(directions))
    op = sheet_on(Hyperelastic(3.0, (), deviations, terms), samples)
    solid = fitted(few, op.model)
    for within, share in ((1.6 * np.pi / directions, 0.02), (0.1, 0.01)):
        dictionary, c = fibre_families(solid, within=within, share=share)
        lower = lower_bounds(dictionary, stiffness)
        solid = replace(solid, dictionary=dictionary, coefficients=np.maximum(c, lower))
        solid = fitted(few, _moved(op.changed(solid, None), few, lower, most_steps))
    return fitted(samples, solid).sparse


def _moved(
    op: HyperelasticSheetOperator, samples: Samples, lower: np.ndarray, most_steps: int
) -> HyperelasticMaterial:
    """Gauss–Newton over coefficients, angles and exponents, from where they are."""
    moving, K = fibres_of(op.model.dictionary), len(lower)
    if not moving:
        return op.model

    @lru_cache(1)  # the loss and its slopes are asked for one after the other
    def state(x: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        here = op.changed(with_numbers(op.model, moving, np.array(x)), None)
        R, y = of_samples(here, samples, moving)
        return R[:, :K] @ x[:K] - y, R

    numbers, (least, most) = fibre_numbers(op.model.dictionary, moving)
    bounds = np.append(lower, least), np.append(np.full(K, np.inf), most)
    start = np.clip(np.append(op.model.coefficients, numbers), *bounds)
    found = least_squares(
        lambda x: state(tuple(x))[0], start, lambda x: state(tuple(x))[1],
        bounds, ftol=SETTLED, x_scale="jac", max_nfev=most_steps,
    )  # fmt: skip
    return with_numbers(op.model, moving, found.x)
