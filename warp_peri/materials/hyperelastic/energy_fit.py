"""Energies fitted to forces, with signs and bounds; their fibres by direction and exponent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from warp_peri.errors import InputError
from warp_peri.fitting.rows import compressed, load_sizes
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.fibres import (
    fibre_families,
    fibre_fan,
    fibre_numbers,
    fibres_of,
    with_numbers,
)
from warp_peri.materials.hyperelastic.operator import (
    HyperelasticMaterial,
    HyperelasticSheetOperator,
)
from warp_peri.points.arguments import Count, NotNegative, typed, typed_methods
from warp_peri.points.points import PointsLike, Samples, nodes_of

RIDGE = 1e-9
"""Of the squared length of the scaled coefficients, relative to the data."""
NONE = np.zeros((0, 1))
ENOUGH = 40
"""Samples that the directions are sought on; all are used for the coefficients at the end."""
SETTLED = 1e-5
"""Relative gain of a step that is the last."""


def sheet_on(dictionary: Hyperelastic, points: PointsLike) -> HyperelasticSheetOperator:
    """A sheet of all energies with coefficient one."""
    nodes = nodes_of(points)
    one = np.ones(len(dictionary))
    return HyperelasticMaterial(dictionary, one, nodes.spacing, units=nodes.units).on(nodes)


def columns(op: HyperelasticSheetOperator, u: np.ndarray, moving: Sequence[int] = ()) -> np.ndarray:
    """Slopes of the interior's force at a field, shape [2 I, K + 2 M].

    By all coefficients, and by angles and then exponents of the fibres at M places.
    """
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
    """R and y of the `columns` and loads inside of fields, in few rows, (H11).

    ‖R c − y‖ is the norm of what forces leave of the loads, times weights of shape [S, 1 or 2 I].
    """
    R, y = np.zeros((0, len(op.model.coefficients) + 2 * len(moving))), np.zeros(0)
    for u, b, weight in zip(fields, loads, weights):
        R = np.concatenate([R, columns(op, u, moving) * weight[:, None]])
        R, y = compressed(R, np.append(y, b.ravel() * weight))
    return R, y


def of_samples(
    op: HyperelasticSheetOperator, samples: Samples, moving: Sequence[int] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """The same of samples, whose ‖R c − y‖ is the root of the mean squared relative residual.

    Raises InputError where there are no samples, or one without load.
    """
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
    """The x between two bounds of least |J x − y|², its steps from `now` damped as Levenberg does.

    Products of x with the rows `held` stay about what they are.
    """
    length = np.linalg.norm(J, axis=0)
    length[length == 0] = 1.0
    A = np.concatenate([J / length, np.sqrt(damping) * np.eye(len(now)), held / length])
    y = np.concatenate([y, np.sqrt(damping) * length * now, (held * now).sum(axis=1)])
    within, most = [bound * length for bound in bounds], 10 * len(now)
    x = lsq_linear(A, y, within, method="bvls", max_iter=most).x / length
    return np.asarray(np.clip(x, *bounds))


def lower_bounds(dictionary: Hyperelastic, stiffness: float, others: float = 0.0) -> np.ndarray:
    """Least coefficients: `stiffness` for what keeps hourglasses away, `others` for the rest.

    Shape [K] [stress].
    """
    lower = np.full(len(dictionary), others)
    first, last, bonds = dictionary.first_deviation, dictionary.first_term, len(dictionary.bonds)
    lower[first:last] = stiffness or others
    if last == first and bonds and others == 0:
        lower[: 4 * bonds : bonds] = stiffness
    return lower


@typed_methods
@dataclass(frozen=True, eq=False)
class EnergyFit:
    """A fitted solid.

    Attributes:
        material: dictionary and coefficients.
        residual: root mean squared relative residual on the training samples.
        guaranteed: whether no coefficient is below its bound, so that (H9) holds.
    """

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
    """Fit the coefficients of a dictionary.

    Args:
        samples: displacements and loads on a lattice.
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
    """The material in few numbers: matrix moduli, and families with direction, k1 and k2.

    A fit on many directions says where the families are; then angles and exponents are unknowns of
    a Gauss–Newton method, and families that meet become one.

    Args:
        samples: with loads.
        matrix: kinds of the energies beside the fibres.
        deviations: as of Hyperelastic; `stiffness` is their least coefficient.
        directions: of the first fit.
        most_steps: of Gauss and Newton.
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
    """Least squares over coefficients, angles and exponents, from where they are."""
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
