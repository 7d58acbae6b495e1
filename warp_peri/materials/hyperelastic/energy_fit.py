"""Energies fitted to forces, stable on what is sampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from warp_peri.core.stencil import laplacian
from warp_peri.errors import InputError
from warp_peri.fitting.regression import least_squares_above
from warp_peri.fitting.rows import compressed, load_sizes
from warp_peri.materials.hyperelastic.energies import Hyperelastic, HyperelasticMaterial
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import largest_stretch
from warp_peri.points.arguments import typed, typed_methods
from warp_peri.points.arrays import checked
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples

WAVES = 8
"""Wave numbers along each half axis of the zone."""
STRAINS = 60
"""Uniform strains in which a fit may be asked to be stable."""
ROUNDS, WORST = 60, 3
"""Of cuts, and waves of a strain that join in one."""
ROUNDING = 1e-7
"""Of the largest scaled coefficient: what is nearer to a bound is put on it."""
SLACK = 0.02
"""Part of the margin that may be missing at the end."""
RIDGE = 1e-9
"""Of the squared length of the scaled coefficients, relative to the data."""
NONE = np.zeros((0, 1))


def zone(count: int) -> np.ndarray:
    """Wave vectors of half a Brillouin zone, without zero, times the spacing, shape [Q, 2]."""
    steps = np.argwhere(np.ones((2 * count + 1, 2 * count + 1))) - count  # ξ, 0, −ξ in order
    return np.asarray(steps[len(steps) // 2 + 1 :] * np.pi / count)


def wave_ratios(dictionary: Hyperelastic, spacing: float, strains: np.ndarray) -> np.ndarray:
    """Symbols of every energy's tangent in uniform strains, over the Laplacian's (H20).

    Args:
        dictionary: of the energies.
        spacing: of the lattice [length].
        strains: deformation gradients, shape [F, 2, 2].

    Returns:
        Of the waves of `zone`, with coefficient one, shape [F, Q, 2, 2, K].

    Raises InputError for arrays of another shape or without strains, gradients that are not finite
    or of no positive determinant, and strains in which an energy is no number.
    """
    strains = checked("strains", strains, float, ("F > 0", 2, 2))
    if not (len(strains) and (np.linalg.det(strains) > 0).all()):
        raise InputError("strains: expected F > 0 of them, with determinants > 0")
    reach = int(dictionary.reach)
    inner = max(2 * reach, 5)  # two bonds, or three short ones of which one may be of two steps
    outer = inner + 2 * reach
    steps = np.argwhere(np.ones((2 * outer + 1, 2 * outer + 1))) - outer
    inside = np.abs(steps).max(axis=1) <= inner
    op = HyperelasticOperator(dictionary, Points(spacing * steps, inside, spacing))
    u = np.repeat(op.points.x @ (strains - np.eye(2)).swapaxes(1, 2), 2, axis=0)
    v = np.zeros_like(u)
    v.reshape(-1, 2, *steps.shape)[:, :, len(steps) // 2] = np.eye(2)
    pulls = [op.jvp(u, c, v)[:, inside] for c in np.eye(len(dictionary))]
    stencils = np.stack(pulls, axis=-1).reshape(len(strains), 2, inside.sum(), 2, -1)
    if not np.isfinite(stencils).all():
        F = strains[np.argwhere(~np.isfinite(stencils))[0, 0]]
        raise InputError(f"strains: expected energies that are numbers at F = {F.tolist()}")
    k = zone(WAVES)
    waves = np.cos(k @ steps[inside].T) * (spacing**2 / laplacian(k))[:, None]
    symbols = np.einsum("qr,fbrak->fqabk", waves, stencils, optimize=True)
    return np.asarray((symbols + symbols.swapaxes(2, 3)) / 2)


@typed
def stability_margin(solid: HyperelasticMaterial, strains: np.ndarray) -> np.ndarray:
    """Least ratio [stress] over the grid of waves in each strain, shape [F].

    Negative where one of these waves grows; those between are not looked at.

    Args:
        solid: of the lattice it was learned on.
        strains: deformation gradients, shape [F, 2, 2].

    Raises InputError as wave_ratios.
    """
    ratios = wave_ratios(solid.dictionary, solid.spacing, strains) @ solid.coefficients
    return np.asarray(np.linalg.eigvalsh(ratios)[..., 0].min(axis=1))


def strains_of(op: HyperelasticOperator, samples: Samples, count: int) -> np.ndarray:
    """Strains that the samples hold, as far apart as `count` can be, and rest.

    Logarithmic strains of all nodes with a whole family; each is the one furthest from those
    before it, beginning at rest.

    Returns:
        Stretch tensors U, F = R U, shape [count + 1, 2, 2]; fewer where fewer nodes have a strain.
    """
    x, y, shear = op.strain(samples.u)[:, op.patch().pair[0]].reshape(-1, 3).T
    C = np.stack([1 + 2 * x, shear, shear, 1 + 2 * y], axis=1).reshape(-1, 2, 2)
    squares, axes = np.linalg.eigh(C)
    squares, axes = squares[squares[:, 0] > 0], axes[squares[:, 0] > 0]
    logs = np.einsum("nij,nj,nkj->nik", axes, 0.5 * np.log(squares), axes)
    far, chosen = (logs**2).sum(axis=(1, 2)), list[int]()
    for _ in range(min(count, len(far))):
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, ((logs - logs[chosen[-1]]) ** 2).sum(axis=(1, 2)))
    U = np.einsum("nij,nj,nkj->nik", axes[chosen], np.sqrt(squares[chosen]), axes[chosen])
    return np.concatenate([np.eye(2)[None], U])


def stable_coefficients(
    R: np.ndarray,
    y: np.ndarray,
    ratios: np.ndarray,
    margin: float,
    *,
    lower: np.ndarray,
    ridge: float = RIDGE,
) -> tuple[np.ndarray, float]:
    """The c of least |R c − y| that is stable on the sampled strains and waves, with c ≥ lower.

    Args:
        R: shape [M, K].
        y: shape [M].
        ratios: of strains and waves, shape [F, Q, 2, 2, K].
        margin: least eigenvalue of a wave's ratio, > 0 [stress].
        lower: bounds, −∞ where there is none, shape [K].
        ridge: as of fit_energy.

    Returns:
        The coefficients, and the least eigenvalue that they leave, at least 1 − SLACK of the
        margin.

    Raises InputError for a margin that is not positive and finite, or that no coefficients reach.
    """
    if not 0 < margin < np.inf:
        raise InputError(f"stable: expected a finite margin > 0, got {margin}")
    scale, K = lengths(R), R.shape[1]
    A = np.concatenate([R / scale, np.sqrt(ridge) * np.eye(K)])
    bounded = np.isfinite(lower)
    G, h = np.eye(K)[bounded], (lower * scale)[bounded]
    for _ in range(ROUNDS):
        try:
            c = least_squares_above(A, np.append(y, np.zeros(K)), G, h) / scale
        except InputError:
            why = f"no coefficients reach the margin {margin:g}, or the equations lack full rank"
            raise InputError(f"stable: {why}") from None
        near = (c - lower) * scale < ROUNDING * np.abs(c * scale).max()
        c = np.where(near, lower, c)
        values, vectors = np.linalg.eigh(ratios @ c)
        if (least := values[..., 0]).min() >= (1 - SLACK) * margin:
            return c, float(least.min())
        worst = np.argsort(least, axis=1)[:, :WORST].ravel()
        strain = np.repeat(np.arange(len(least)), min(WORST, least.shape[1]))
        low = least[strain, worst] < (1 - SLACK / 2) * margin
        at = strain[low], worst[low]
        a = vectors[..., 0][at]
        cuts = np.einsum("nabk,na,nb->nk", ratios[at], a, a) / scale
        G, h = np.concatenate([G, cuts]), np.append(h, np.full(len(cuts), margin))
    raise InputError(f"stable: no coefficients of margin {margin:g} after {ROUNDS} rounds of cuts")


def columns(
    op: HyperelasticOperator, u: np.ndarray, moving: Sequence[int] = (), c: Any = None
) -> np.ndarray:
    """Slopes of the interior's force at a field, shape [2 I, K + 2 M].

    By all coefficients, and by angles and then exponents of the fibres at M places, where the
    coefficients are c.
    """
    found = [op.features(u).reshape(-1, len(op.dictionary))]
    for by in ("angle", "exponent") if len(moving) else ():
        found.append(op.features(u, by=by).reshape(found[0].shape)[:, moving] * c[moving])
    return np.concatenate(found, axis=1)


def equations(
    op: HyperelasticOperator, samples: Samples, moving: Sequence[int] = (), c: Any = None
) -> tuple[np.ndarray, np.ndarray]:
    """R and y of the `columns` and loads, each sample over its load, in few rows (H11).

    ‖R c − y‖ is the root of the mean squared relative residual. Raises InputError where there are
    no samples, or one without load.
    """
    if not (len(samples) and load_sizes(samples).all()):
        raise InputError(
            "samples: expected some, and a load on the interior of each, got one without; "
            "without loads learn from displacement alone"
        )
    sizes = load_sizes(samples) * np.sqrt(len(samples))
    R, y = np.zeros((0, len(op.dictionary) + 2 * len(moving))), np.zeros(0)
    for u, b, size in zip(samples.u, samples.loads[:, op.interior], sizes):
        R = np.concatenate([R, columns(op, u, moving, c) / size])
        R, y = compressed(R, np.append(y, b / size))
    return R, y


def lengths(R: np.ndarray) -> np.ndarray:
    """Length of each column; one where it is zero."""
    length = np.linalg.norm(R, axis=0)
    return np.where(length > 0, length, 1.0)


def between(
    J: np.ndarray, y: np.ndarray, now: np.ndarray, bounds: Any, damping: float, held: Any = NONE
) -> np.ndarray:
    """The x between two bounds of least |J x − y|², shape [K].

    Steps from `now` are damped as Levenberg does, but for the products of x with the rows `held`,
    which stay about what they are.
    """
    length = lengths(J)
    A = np.concatenate([J / length, np.sqrt(damping) * np.eye(len(now)), held / length])
    y = np.concatenate([y, np.sqrt(damping) * length * now, (held * now).sum(axis=1)])
    within, most = [bound * length for bound in bounds], 10 * len(now)
    x = lsq_linear(A, y, within, method="bvls", max_iter=most).x / length
    return np.asarray(np.clip(x, *bounds))


def coefficients(
    R: np.ndarray, y: np.ndarray, lower: np.ndarray, ridge: float = RIDGE
) -> np.ndarray:
    """The c ≥ lower (−∞ where there is no bound) of least ‖R c − y‖, shape [K]."""
    start, most = np.where(np.isfinite(lower), lower, 0.0), np.full(len(lower), np.inf)
    return between(R, y, start, (lower, most), ridge)


@typed_methods
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

    material: HyperelasticMaterial
    residual: float
    guaranteed: bool
    margin: float | None = None


def fit_energy(
    samples: Samples,
    dictionary: Hyperelastic,
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
    (R, y), margin = equations(op, samples), None
    lower = lower_bounds(dictionary, stiffness, 0.0 if positive else -np.inf)
    if stable is None:
        c = coefficients(R, y, lower, ridge)
    else:
        ratios = wave_ratios(dictionary, samples.spacing, strains_of(op, samples, STRAINS))
        c, margin = stable_coefficients(R, y, ratios, stable, lower=lower, ridge=ridge)
    stretch, units = largest_stretch(op, samples.u), samples.points.units
    solid = HyperelasticMaterial(dictionary, c, samples.spacing, stretch, units=units)
    return EnergyFit(solid, float(np.linalg.norm(R @ c - y)), positive, margin)


def lower_bounds(dictionary: Hyperelastic, stiffness: float, others: float = 0.0) -> np.ndarray:
    """Least coefficients: `stiffness` for what keeps hourglasses away, `others` for the rest.

    Shape [K] [stress]. Raises InputError for a stiffness that is negative or not finite.
    """
    if not 0 <= stiffness < np.inf:
        raise InputError(f"stiffness: expected a finite number ≥ 0, got {stiffness}")
    lower = np.full(len(dictionary), others)
    first, last, bonds = dictionary.first_deviation, dictionary.first_term, len(dictionary.bonds)
    lower[first:last] = stiffness or others
    if last == first and bonds and others == 0:
        lower[: 4 * bonds : bonds] = stiffness
    return lower
