"""Energies fitted to forces, stable on what is sampled."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear, nnls

from warp_peri.errors import InputError
from warp_peri.fitting.regression import least_squares_above
from warp_peri.materials.hyperelastic.energies import Dictionary, HyperelasticSolid
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import largest_stretch
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples

WAVES = 8
"""Wave numbers along each half axis of the zone."""
STEP = 1e-6
"""Of the differences that make the stencil [spacing]."""
AT_REST = 1 - 1e-5
"""Stretch that stands for rest: fibres are just slack there, which is the softer side."""


@dataclass(frozen=True, eq=False)
class UniformTangents:
    """Stencils of every energy in some uniform strains.

    Attributes:
        stencils: force on every offset, by direction, when the centre moves along another, for
            every energy with coefficient one [1/length²], shape [F, R, 2, 2, K].
        waves: cosines of every wave at every offset over the Laplacian's symbol, shape [Q, R].
    """

    stencils: np.ndarray
    waves: np.ndarray

    @classmethod
    def of(cls, dictionary: Dictionary, spacing: float, strains: np.ndarray) -> UniformTangents:
        """Stencils in strains, given as deformation gradients of shape [F, 2, 2].

        Raises InputError for arrays of another shape or without strains, gradients that are not
        finite or of no positive determinant, and strains in which an energy is no number.
        """
        if np.ndim(strains) != 3 or np.shape(strains)[1:] != (2, 2) or not len(strains):
            raise InputError(
                f"strains: expected shape [F, 2, 2] with F > 0, got {list(np.shape(strains))}"
            )
        if not np.isfinite(strains).all():
            raise InputError("strains: expected finite numbers")
        if not (np.linalg.det(strains) > 0).all():
            raise InputError("strains: expected determinants > 0")
        reach = int(dictionary.reach)
        inner = max(2 * reach, 5)  # two bonds, or three short ones of which one may be of two steps
        side = np.arange(-inner - 2 * reach, inner + 2 * reach + 1)
        steps = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        inside: np.ndarray = np.abs(steps).max(axis=1) <= inner
        op = HyperelasticOperator(dictionary, Points(spacing * steps, inside, spacing))
        centre = np.flatnonzero((steps == 0).all(axis=1))[0]
        size = STEP * spacing
        u = op.points.x @ (np.asarray(strains) - np.eye(2)).swapaxes(1, 2)
        u = np.tile(u[:, None, None], (1, 2, 2, 1, 1))  # along an axis, ahead and back
        for axis, end in np.ndindex(2, 2):
            u[:, axis, end, centre, axis] += (1 - 2 * end) * size
        forces = op.features(u.reshape(-1, *op.points.x.shape))
        forces = forces.reshape(len(strains), 2, 2, *forces.shape[1:])
        stencils = ((forces[:, :, 0] - forces[:, :, 1]) / (2 * size)).transpose(0, 2, 3, 1, 4)
        for F, stencil in zip(strains, stencils):
            if not np.isfinite(stencil).all():
                raise InputError(f"strains: expected energies that are numbers at F = {F.tolist()}")
        k = zone(WAVES)
        laplace = (4 * np.sin(k / 2) ** 2).sum(axis=1) / spacing**2
        return cls(stencils, np.cos(k @ steps[inside].T) / laplace[:, None])

    def lowest(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smaller eigenvalue of the symbol over the Laplacian's, and its direction.

        Returns:
            Ratios [stress], shape [F, Q], and unit vectors, shape [F, Q, 2].
        """
        tangent = np.einsum("frabk,k->frab", self.stencils, c)
        symbol = np.einsum("qr,frab->fqab", self.waves, tangent, optimize=True)
        values, vectors = np.linalg.eigh((symbol + symbol.swapaxes(2, 3)) / 2)
        least: np.ndarray = values[..., 0]
        return least, vectors[..., 0]

    def row(self, strain: int, wave: int, direction: np.ndarray) -> np.ndarray:
        """The ratio of one wave for every energy with coefficient one, shape [K]."""
        whole: np.ndarray = np.einsum(
            "r,rabk,a,b->k", self.waves[wave], self.stencils[strain], direction, direction
        )
        return whole


def zone(count: int) -> np.ndarray:
    """Wave vectors of half a Brillouin zone, without zero, times the spacing, shape [Q, 2]."""
    line = np.linspace(-np.pi, np.pi, 2 * count + 1)
    k = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    half: np.ndarray = (k[:, 0] > 1e-9) | ((np.abs(k[:, 0]) <= 1e-9) & (k[:, 1] > 1e-9))
    vectors: np.ndarray = k[half]
    return vectors


def strains_of(op: HyperelasticOperator, samples: Samples, count: int) -> np.ndarray:
    """Strains that the samples hold, as far apart as `count` can be, and rest.

    Logarithmic strains of all nodes with a whole family; each is the one furthest from those
    before it, beginning at rest. For rest stands a stretch of AT_REST: at the kink of a fibre's
    energy a tangent by differences is half as stiff as a taut fibre's, and a slack one has none.

    Returns:
        Stretch tensors U, F = R U, shape [count + 1, 2, 2]; fewer where fewer nodes have a strain.
    """
    E = op.strain(samples.u)[:, op.sites().pair[0]].reshape(-1, 3)
    C = np.stack([1 + 2 * E[:, 0], E[:, 2], E[:, 2], 1 + 2 * E[:, 1]], axis=1).reshape(-1, 2, 2)
    squares, axes = np.linalg.eigh(C)
    kept = squares[:, 0] > 0
    squares, axes = squares[kept], axes[kept]
    logs = np.einsum("nij,nj,nkj->nik", axes, 0.5 * np.log(squares), axes).reshape(-1, 4)
    far = (logs**2).sum(axis=1)
    chosen = []
    for _ in range(min(count, len(far))):
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, ((logs - logs[chosen[-1]]) ** 2).sum(axis=1))
    U = np.einsum("nij,nj,nkj->nik", axes[chosen], np.sqrt(squares[chosen]), axes[chosen])
    return np.concatenate([AT_REST * np.eye(2)[None], U])


def shortest_margin(solid: HyperelasticSolid, strains: np.ndarray) -> np.ndarray:
    """Least ratio [stress] over the grid of waves in each strain, shape [F].

    Negative where one of these waves grows; those between are not looked at.

    Args:
        solid: of the lattice it was learned on.
        strains: deformation gradients, shape [F, 2, 2].

    Raises InputError as UniformTangents.of.
    """
    tangents = UniformTangents.of(solid.dictionary, solid.spacing, strains)
    least: np.ndarray = tangents.lowest(solid.coefficients)[0].min(axis=1)
    return least


ROUNDS = 60
"""Of cuts."""
WORST = 3
"""Waves of a strain that join in one round."""
ROUNDING = 1e-7
"""Of the largest scaled coefficient: what is nearer to a bound is put on it."""
SLACK = 0.02
"""Part of the margin that may be missing at the end."""


def stable_coefficients(
    A: np.ndarray,
    y: np.ndarray,
    tangents: UniformTangents,
    margin: float,
    *,
    scale: np.ndarray,
    lower: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """The c of least |A c − y| that is stable on the sampled strains and waves, with c ≥ lower.

    Args:
        A: of full column rank, in coefficients times `scale`, shape [M, K].
        y: shape [M].
        tangents: of the strains.
        margin: least eigenvalue of the symbol of a wave over the Laplacian's, > 0 [stress].
        scale: of the coefficients, shape [K].
        lower: bounds, −∞ where there is none, shape [K].

    Returns:
        The coefficients, and the least ratio that they leave, at least 1 − SLACK of the margin.

    Raises InputError for a margin that is not positive and finite, or that no coefficients reach.
    """
    if not 0 < margin < np.inf:
        raise InputError(f"stable: expected a finite margin > 0, got {margin}")
    K = A.shape[1]
    if not np.diag(np.asarray(np.linalg.qr(A, mode="r"))).all():
        raise InputError("stable: expected equations of full rank, or a ridge > 0")
    least = np.full(K, -np.inf) if lower is None else lower
    bounded = np.flatnonzero(np.isfinite(least))
    G, h = np.eye(K)[bounded], (least * scale)[bounded]
    for _ in range(ROUNDS):
        try:
            c = least_squares_above(A, y, G, h) / scale
        except InputError:
            raise InputError(f"stable: no coefficients reach the margin {margin:g}") from None
        near = (c - least) * scale < ROUNDING * np.abs(c * scale).max()
        c = np.where(near, least, c)
        ratios, directions = tangents.lowest(c)
        if ratios.min() >= (1 - SLACK) * margin:
            return c, float(ratios.min())
        cuts = [
            tangents.row(n, q, directions[n, q])
            for n, of_waves in enumerate(ratios)
            for q in np.argsort(of_waves)[:WORST]
            if of_waves[q] < (1 - SLACK / 2) * margin
        ]
        G = np.concatenate([G, np.array(cuts) / scale])
        h = np.concatenate([h, np.full(len(cuts), margin)])
    raise InputError(f"stable: no coefficients of margin {margin:g} after {ROUNDS} rounds of cuts")


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


def triangle(blocks: Iterable[np.ndarray]) -> np.ndarray:
    """Triangular factor of rows that come in blocks, shape [at most K, K]."""
    stack: Any = None
    for rows in blocks:
        stack = rows if stack is None else np.concatenate([stack, rows])
        if len(stack) > ROWS:
            stack = np.linalg.qr(stack, mode="r")
    return np.asarray(np.linalg.qr(stack, mode="r"))


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
) -> Equations:
    """Forces by the `columns` and loads of all samples, factored as they come.

    Raises InputError where there are no samples, or one without load.
    """
    if len(samples) == 0:
        raise InputError("samples: expected at least one, got none")
    K = len(op.dictionary) + 2 * len(moving)
    loads = samples.loads[:, op.interior].reshape(len(samples), -1, 1)
    sizes = np.linalg.norm(loads, axis=1)[:, 0]
    if not sizes.all():
        raise InputError(
            "samples: expected a load on the interior of each, got one without; "
            "without loads learn from displacement alone"
        )
    factor = triangle(
        np.concatenate([columns(op, u, moving, c), b], axis=1) / size
        for u, b, size in zip(samples.u, loads, sizes)
    ) / np.sqrt(len(samples))
    wide = np.zeros((K + 1, K + 1))
    wide[: len(factor)] = factor
    return Equations(wide[:K, :K], wide[:K, K], float(wide[K, K] ** 2))


def weighed(system: Equations, ridge: float) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right side in coefficients times the scale, with the ridge below."""
    K = len(system.y)
    A = np.concatenate([system.R / system.scale, np.sqrt(ridge) * np.eye(K)])
    return A, np.concatenate([system.y, np.zeros(K)])


NONE = np.zeros((0, 1))


def between(
    J: np.ndarray, y: np.ndarray, now: np.ndarray, bounds: Any, damping: float, held: Any = NONE
) -> np.ndarray:
    """The x between two bounds of least |J x − y|², shape [K].

    Steps from `now` are damped as Levenberg does, but for the products of x with the rows `held`,
    which stay about what they are.
    """
    length = np.linalg.norm(J, axis=0)
    length[length == 0] = 1.0
    A = np.concatenate([J / length, np.sqrt(damping) * np.eye(len(now)), held / length])
    y = np.concatenate([y, np.sqrt(damping) * length * now, (held * now).sum(axis=1)])
    x = lsq_linear(A, y, [bound * length for bound in bounds], method="bvls").x / length
    return np.asarray(x)


def least_squares(
    system: Equations, *, lower: np.ndarray | None = None, ridge: float = RIDGE
) -> np.ndarray:
    """Coefficients of any sign, or not below `lower` (−∞ where there is no bound), shape [K]."""
    if lower is not None:
        return between(system.R, system.y, 0 * lower, (lower, np.full(len(lower), np.inf)), ridge)
    A, y = weighed(system, ridge)
    return np.asarray(np.linalg.lstsq(A, y, rcond=None)[0] / system.scale)


def non_negative(
    system: Equations, *, lower: np.ndarray | None = None, ridge: float = RIDGE
) -> np.ndarray:
    """Coefficients not below `lower`, zero where none is given, shape [K] (Lawson and Hanson)."""
    least = np.zeros(len(system.y)) if lower is None else lower
    A, y = weighed(replace(system, y=system.y - system.R @ least), ridge)
    return np.asarray(least + nnls(A, y, maxiter=50 * len(least))[0] / system.scale)


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
    lower, margin = (lower_bounds if positive else deviations_only)(dictionary, stiffness), None
    if stable is not None:
        tangents = UniformTangents.of(dictionary, samples.spacing, strains_of(op, samples, STRAINS))
        c, margin = stable_coefficients(
            *weighed(system, ridge), tangents, stable, scale=system.scale, lower=lower
        )
    else:
        solver = non_negative if positive else least_squares
        c = solver(system, lower=lower, ridge=ridge)
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
