"""Coefficients of an energy dictionary from displacement and load: least squares, or with signs.

The force is linear in the coefficients, so both fits have one optimum, found in one factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear, nnls

from warp_peri.errors import InputError
from warp_peri.points.samples import Samples
from warp_peri.tissue.operator import HyperelasticOperator
from warp_peri.tissue.solid import Dictionary, HyperelasticSolid
from warp_peri.tissue.stable_fit import stable_coefficients
from warp_peri.tissue.stretch_range import largest_stretch
from warp_peri.tissue.uniform_strain import UniformTangents, strains_of

ROWS = 4096
"""Equations that are factored at once."""
STRAINS = 60
"""Uniform strains in which a fit may be asked to be stable."""
RIDGE = 1e-9
"""Of the squared length of the scaled coefficients, relative to the data."""


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of all samples, each divided by its load, reduced to one triangle (H11).

    Attributes:
        R: triangular factor of the forces of single energies, shape [K, K].
        y: the loads on its rows, shape [K].
        rest: what no coefficients can explain: squared, per sample.
    """

    R: np.ndarray
    y: np.ndarray
    rest: float

    @property
    def scale(self) -> np.ndarray:
        """Length of each column; one where it is zero."""
        length = np.linalg.norm(self.R, axis=0)
        return np.where(length > 0, length, 1.0)


def equations(op: HyperelasticOperator, samples: Samples) -> Equations:
    """Forces of single energies and loads of all samples, factored as they come.

    Raises InputError where there are no samples, or one without load.
    """
    if len(samples) == 0:
        raise InputError("samples: expected at least one, got none")
    K = len(op.dictionary)
    stack = np.zeros((0, K + 1))
    for u, b in zip(samples.u, samples.loads[:, op.interior]):
        size = np.linalg.norm(b)
        if size == 0:
            raise InputError(
                "samples: expected a load on the interior of each, got one without; "
                "without loads learn from displacement alone"
            )
        rows = np.concatenate([op.features(u).reshape(-1, K), b.reshape(-1, 1)], axis=1) / size
        stack = np.concatenate([stack, rows])
        if len(stack) > ROWS:
            stack = np.asarray(np.linalg.qr(stack, mode="r"))
    factor = np.linalg.qr(stack, mode="r") / np.sqrt(len(samples))
    wide = np.zeros((K + 1, K + 1))
    wide[: len(factor)] = factor
    return Equations(wide[:K, :K], wide[:K, K], float(wide[K, K] ** 2))


def weighed(system: Equations, ridge: float) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right side in coefficients times the scale, with the ridge below."""
    K = len(system.y)
    A = np.concatenate([system.R / system.scale, np.sqrt(ridge) * np.eye(K)])
    return A, np.concatenate([system.y, np.zeros(K)])


def least_squares(
    system: Equations, *, lower: np.ndarray | None = None, ridge: float = RIDGE
) -> np.ndarray:
    """Coefficients of any sign, or not below `lower` (−∞ where there is no bound), shape [K]."""
    scale = system.scale
    A, y = weighed(system, ridge)
    if lower is None:
        c: np.ndarray = np.linalg.lstsq(A, y, rcond=None)[0] / scale
    else:
        c = lsq_linear(A, y, (lower * scale, np.inf), method="bvls").x / scale
    return c


def non_negative(
    system: Equations, *, lower: np.ndarray | None = None, ridge: float = RIDGE
) -> np.ndarray:
    """Coefficients not below `lower`, zero where none is given, shape [K] (Lawson and Hanson)."""
    scale = system.scale
    K = len(scale)
    least = np.zeros(K) if lower is None else lower
    A = np.concatenate([system.R / scale, np.sqrt(ridge) * np.eye(K)])
    y = np.concatenate([system.y - system.R @ least, np.zeros(K)])
    c: np.ndarray = least + nnls(A, y, maxiter=50 * K)[0] / scale
    return c


def residual(system: Equations, c: np.ndarray) -> float:
    """Root of the mean squared relative residual over the samples."""
    return float(np.sqrt(((system.R @ c - system.y) ** 2).sum() + system.rest))


@dataclass(frozen=True, eq=False)
class EnergyFit:
    """A fitted solid.

    Attributes:
        material: dictionary and coefficients.
        residual: root mean squared relative residual on the training samples.
        guaranteed: whether no coefficient is below its bound, so that (H9) holds.
        margin: least ratio (H20) of the sampled waves in the sampled strains [stress]; none where
            stability was not asked for. It is measured, no bound for other waves and strains.
    """

    material: HyperelasticSolid
    residual: float
    guaranteed: bool
    margin: float | None = None


def fit_energy(
    samples: Samples,
    dictionary: Dictionary,
    *,
    positive: bool = False,
    stiffness: float = 0.0,
    ridge: float = RIDGE,
    stable: float | None = None,
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
        stable: least eigenvalue of the tangent over the Laplacian's in uniform strains, (H21)
            [stress]. It is asked for on samples: rest and STRAINS strains spread over those of the
            data, and a grid of waves. No proof for others. Up to 2 % of it may be missing.

    Raises InputError for a margin out of reach, a ridge or stiffness that is none, positive with a
    dictionary that guarantees nothing, or samples as for equations().
    """
    if not 0 <= ridge < np.inf:
        raise InputError(f"ridge: expected a finite number ≥ 0, got {ridge}")
    if positive and not dictionary.guaranteed:
        raise InputError("positive: expected energies that are convex and stress-free at rest only")
    op = HyperelasticOperator(dictionary, samples)
    system = equations(op, samples)
    margin = None
    if stable is not None:
        if positive:
            lower: np.ndarray | None = lower_bounds(dictionary, stiffness)
        else:
            lower = deviations_only(dictionary, stiffness)
        tangents = UniformTangents.of(dictionary, samples.spacing, strains_of(op, samples, STRAINS))
        c, margin = stable_coefficients(
            *weighed(system, ridge), tangents, stable, scale=system.scale, lower=lower
        )
    elif positive:
        c = non_negative(system, lower=lower_bounds(dictionary, stiffness), ridge=ridge)
    else:
        c = least_squares(system, lower=deviations_only(dictionary, stiffness), ridge=ridge)
    solid = HyperelasticSolid(
        dictionary, c, samples.spacing, largest_stretch(op, samples.u), units=samples.points.units
    )
    return EnergyFit(solid, residual(system, c), positive, margin)


def lower_bounds(dictionary: Dictionary, stiffness: float) -> np.ndarray:
    """Least coefficients: `stiffness` for what keeps hourglasses away, zero for the rest.

    Shape [K] [stress]. Raises InputError for a stiffness that is negative or not finite.
    """
    if not 0 <= stiffness < np.inf:
        raise InputError(f"stiffness: expected a finite number ≥ 0, got {stiffness}")
    lower = np.zeros(len(dictionary))
    first, last = dictionary.first_deviation, dictionary.first_term
    if last > first:
        lower[first:last] = stiffness
    else:
        lower[: 4 * len(dictionary.bonds) : max(1, len(dictionary.bonds))] = stiffness
    return lower


def deviations_only(dictionary: Dictionary, stiffness: float) -> np.ndarray | None:
    """Lower bounds for the deviations alone, shape [K]; None where there is none."""
    least = lower_bounds(dictionary, stiffness)
    places = np.arange(len(dictionary))
    held = (places >= dictionary.first_deviation) & (places < dictionary.first_term) & (least > 0)
    return np.where(held, least, -np.inf) if held.any() else None
