"""A third-order crystal learned by one least squares (theory, N28–N29)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import root

from warp_peri.core.elastic import allowed_tensors, from_voigt, turned
from warp_peri.core.grid import grid_of
from warp_peri.core.groups import Symmetry, checked_orientation, point_group, shared_with_nodes
from warp_peri.core.pointwise import Pointwise
from warp_peri.core.stencil import Basis, Stencil, central_weights, invariant_basis
from warp_peri.errors import InputError
from warp_peri.micromodulus import regression
from warp_peri.micromodulus.learning import ENOUGH
from warp_peri.micromodulus.regression import Learned
from warp_peri.micromodulus.waves import law_of, solved
from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.samples import Samples, axis_of
from warp_peri.regression.search import compressed
from warp_peri.third_order.material import ThirdOrderCrystal
from warp_peri.third_order.operator import energy_density, gradient_stencil
from warp_peri.third_order.smoothing import Smoothing, gradient_weights

SETTLED = 1e-9
"""Relative, of moduli that are found."""
CONSTANTS = 3
"""Columns of t3, tq2 and q3, the first ones."""
REACH, MODES = 2, 4
"""Spacings that gradients of long waves reach over, and half waves of the fields that see them."""
NOTHING = 1e-13
"""Of equations of size one, that is rounding."""


def nonlinear_features(
    points: Samples, horizon: float, weights: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """The force of t3, tq2, q3, λ and μ of Ψ, each at 1, shape [S, I, 5, 2].

    Args:
        points: the samples, whose points state the axis of the crystal.
        horizon: δ [Å].
        weights: p_in and p_out by class, each of shape [C].
    """
    (steps, into), (_, out) = (gradient_stencil(points, horizon, p) for p in weights)
    energy, none = partial(energy_density, axis=axis_of(points)), np.zeros((2, 2, 2))
    numbers, columns = dict.fromkeys(("t3", "tq2", "q3", "lam", "mu"), 0.0), []
    operator = Pointwise(
        points, horizon, energy, steps, into, back=out, numbers=numbers,
        stencil=Stencil(points.spacing, np.eye(2, dtype=int), none),
    )  # fmt: skip
    for name in numbers:
        operator.take(numbers | {name: 1.0})
        columns.append(operator.force(points.u))
    return np.stack(columns, axis=2)


@dataclass(frozen=True)
class LongWaves:
    """λ and μ that the long waves of fields have, and how sure they are (theory, 28a).

    Attributes:
        lam, mu: [stress].
        errors: standard errors of both, each sample or test field left out in turn.
        misfit: what is left of the loads on long waves, relative.
        terms: that are taken beside λ and μ, each because it foretells what was left out.
    """

    lam: float
    mu: float
    errors: np.ndarray
    misfit: float
    terms: tuple[str, ...]


def long_wave_moduli(sets: Sequence[Samples]) -> LongWaves:
    """λ and μ of the long waves of lattices in the plane, beside no more terms than foretell.

    Samples count by their loads, test fields by what all terms leave on them. Of all choices of
    dispersion, third order and constants of fourth order the smallest is taken that foretells as
    well as the best, to the standard error of that. An axis that is not stated is learned.

    Raises InputError for samples that see no long waves, or do not tell λ and μ.
    """
    turns = 1 if all(each.points.axis is not None for each in sets) else 2
    tables, loads = zip(*(_long_wave_table(each, turns) for each in sets))
    R, y = np.concatenate(tables), np.concatenate(loads)
    size = np.sqrt((R**2).sum(axis=(0, 1, 2)))
    R, groups = R / np.where(size > 0, size, 1), _groups(turns)
    terms = R[..., groups[LAME[1]].start :]
    c = np.linalg.lstsq(terms.reshape(y.size, -1), y.ravel(), rcond=NOTHING)[0]
    weight = 1 / np.sqrt(((y - terms @ c) ** 2).mean(axis=0) + NOTHING * (y**2).mean())
    R, y = R * weight[..., None], y * weight
    if len(R) < ENOUGH:  # too few samples to leave out: test fields are
        R, y = R.swapaxes(0, 1), y.swapaxes(0, 1)
    R, y = R.reshape(len(R), -1, len(size)), y.reshape(len(y), -1)
    columns = {
        names: [groups[name] for name in (LAME[THIRD in names], *names)]
        for n in range(len(groups) - 1)
        for names in itertools.combinations(tuple(groups)[2:], n)
        if THIRD in names or set(names) <= {DISPERSION}
    }
    tried = {names: _foretold(_mixed(R, some), y) for names, some in columns.items()}
    best = min((left for left, _ in tried.values()), key=np.sum)

    def lost(names: tuple[str, ...]) -> float:
        """What these leave more than the best, in standard errors of that."""
        more = tried[names][0] - best
        return float(more.sum() / max(np.sqrt(len(more)) * more.std(), NOTHING * best.sum()))

    taken = min(
        (names for names in tried if lost(names) <= 1),
        key=lambda names: (len(names), float(tried[names][0].sum())),
    )
    found, misfit = regression.moduli_of(_mixed(R, columns[taken]), y)
    unit, drawn = size[columns[taken][0]], tried[taken][1]
    (lam, mu), errors = found[:2] / unit, np.sqrt((len(drawn) - 1) * drawn.var(axis=0)) / unit
    return LongWaves(float(lam), float(mu), errors, misfit, taken)


LAME, DISPERSION, THIRD = ("linear", "geometric"), "dispersion", "third order"
"""Names of columns: λ and μ at small strain, and with what finite strain adds; others."""


def _groups(turns: int) -> dict[str, slice]:
    """Columns of each group, of a term with six periods a turn so many."""
    sizes = {"linear": 2, "geometric": 2, DISPERSION: 2 + turns, THIRD: 2 + turns}
    sizes |= {"θ⁴": 1, "θ²q": 1, "q²": 1, "θ z³": turns}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(*pair) for name, pair in zip(sizes, itertools.pairwise(ends))}


def _mixed(R: np.ndarray, columns: Sequence[slice]) -> np.ndarray:
    return np.concatenate([R[..., some] for some in columns], axis=-1)


def _foretold(R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares that the other parts leave of each part [P], and their first two numbers, [P, 2]."""
    square, side = np.einsum("pra,prb->pab", R, R), np.einsum("pra,pr->pa", R, y)
    others = square.sum(axis=0) - square, side.sum(axis=0) - side
    c = (np.linalg.pinv(others[0], rcond=NOTHING, hermitian=True) @ others[1][..., None])[..., 0]
    return ((np.einsum("pra,pa->pr", R, c) - y) ** 2).sum(axis=1), c[:, :2]


def _long_wave_table(samples: Samples, count: int) -> tuple[np.ndarray, np.ndarray]:
    """What test fields see of every term, [S, V, 2, m], and of the loads, [S, V, 2].

    Terms that have six periods a turn are `count`, 1 along the axis of the points or 2.
    """
    axes = lattice_steps(samples.points)[1]
    lines, kept = regression.lines_of_waves(samples, MODES)
    u, b = (samples.u @ axes)[:, kept], (samples.loads @ axes)[:, kept]
    axis = np.deg2rad(samples.points.axis or 0.0) - np.arctan2(axes[1, 0], axes[0, 0])
    turn = np.exp(-1j * axis)

    def seen(*orders: tuple[int, int]) -> np.ndarray:
        """Σ u times the sum of derivatives of v, [S, V, 2]."""
        field = sum(regression.derived(lines, np.array(one)) for one in orders)
        return np.asarray(np.einsum("vn,snk->svk", field, u, optimize=True))

    def elastic(*more: tuple[int, int]) -> list[np.ndarray]:
        """−Σ u·div(C : grad v) of λ and of μ, of the sum of derivatives of v."""
        xx, xy, yy = (
            seen(*(tuple(np.add(one, two)) for one in more)) for two in ((2, 0), (1, 1), (0, 2))
        )
        mixed = np.stack([xx[..., 0] + xy[..., 1], xy[..., 0] + yy[..., 1]], axis=-1)
        return [-mixed, -(xx + yy + mixed)]

    linear = elastic((0, 0))
    d = {n: seen((4 - n, n)) for n in range(5)}
    sixfold = (d[0] - 6 * d[2] + d[4] + 4j * (d[1] - d[3])) * turn**6
    whole = sixfold[..., 0] + 1j * sixfold[..., 1]  # (∂x + i∂y)⁴ with (1, i)(1, i) of u
    six = [-np.stack([z.real, -z.imag], axis=-1) for z in (whole, -1j * whole)][:count]
    slope = np.stack([regression.derived(lines, one) for one in np.eye(2, dtype=int)], axis=-1)
    P = _stresses(_gradients(samples, kept), turn, count)
    felt = [np.einsum("snkl,vnl->svk", one, slope, optimize=True) for one in P]
    bent = elastic((2, 0), (0, 2))
    geometric = [one + more for one, more in zip(linear, felt)]
    table = np.stack([*linear, *geometric, *bent, *six, *felt[2:]], axis=-1)
    values = regression.derived(lines, np.zeros(2, dtype=int))
    size = np.linalg.norm(samples.loads[:, samples.interior].reshape(len(b), -1), axis=1)
    weight = np.divide(1, size, out=np.zeros_like(size), where=size > 0)[:, None, None]
    return table * weight[..., None], weight * np.einsum("vn,snk->svk", values, b, optimize=True)


def _gradients(samples: Samples, kept: np.ndarray) -> np.ndarray:
    """∂u/∂x along the nodes' axes by differences over REACH spacings, [S, n, 2, 2]."""
    points, h = samples.points, samples.spacing
    grid, axes = lattice_steps(points)
    period = None if points.box is None else np.rint(np.asarray(points.box) / h).astype(int)
    ways = itertools.product(np.eye(2, dtype=int), range(1, REACH + 1), (1, -1))
    near = neighbour_table(grid, np.array([sign * m * one for one, m, sign in ways]), period)[kept]
    if (near < 0).any():
        raise InputError("moduli: expected nodes two spacings around the interior")
    ahead, behind = np.moveaxis(samples.u[:, near.reshape(len(kept), 2, REACH, 2)], 4, 0)
    return np.asarray(
        np.einsum("m,snlmk,ka->snal", central_weights(REACH) / h, ahead - behind, axes)
    )


def _stresses(H: np.ndarray, turn: complex, count: int) -> list[np.ndarray]:
    """First Piola-Kirchhoff stress of each unit constant at H, those of λ and μ without H itself.

    The energies are powers of θ = tr E, q = dev E : dev E and z, half the deviator as a complex
    number along the axis: λ, μ, θ³, θq, Re z³ and Im z³, θ⁴, θ²q, q², θ Re z³ and θ Im z³.
    """
    one = np.eye(2)
    F, transposed = one + H, H.swapaxes(-1, -2)
    small = (H + transposed) / 2
    E = small + transposed @ H / 2
    theta, traced = (np.trace(e, axis1=-2, axis2=-1)[..., None, None] for e in (E, small))
    dev = E - theta * one / 2
    q = (dev**2).sum(axis=(-1, -2))[..., None, None]
    z = (dev[..., 0, 0] + 1j * dev[..., 0, 1])[..., None, None] * turn**2
    along = np.array([[1, 1j], [1j, -1]]) / 2 * turn**2  # dz/dE
    cubes = [(z**3 * phase, 3 * z**2 * along * phase) for phase in (1, -1j)][:count]
    found = [F @ (theta * one) - traced * one, F @ (2 * E) - 2 * small]
    third = [3 * theta**2 * one, q * one + 2 * theta * dev, *(slope.real for _, slope in cubes)]
    fourth = [
        4 * theta**3 * one,
        2 * theta * q * one + 2 * theta**2 * dev,
        4 * q * dev,
        *(cube.real * one + theta * slope.real for cube, slope in cubes),
    ]
    return found + [F @ S for S in third + fourth]


@dataclass(frozen=True)
class ThirdOrderFit:
    """A learned third-order crystal and how it was learned.

    Attributes:
        material: the law, with its certificate and its guarantee.
        E_res_train: mean relative residual on the training samples.
        largest_gradient: largest |H| of the training samples within reach of the interior.
        seconds: it took.
    """

    material: ThirdOrderCrystal
    E_res_train: float
    largest_gradient: float
    seconds: float


def fit_third_order(
    samples: Samples,
    horizon: float,
    smoothing: Smoothing,
    *,
    form: str = "filtered",
    symmetry: Symmetry = "isotropic",
    orientation: object = None,
    moduli: object = "long waves",
) -> ThirdOrderFit:
    """The tensors and the constants t3, tq2, q3 that fit L u = b on the interior nodes best.

    The residual is linear in all of them; each sample is weighed by 1/‖b‖.

    Args:
        samples: displacements and loads on lattice nodes, whose points state the crystal's axis.
        horizon: length of the longest bond of tensors and gradient.
        smoothing: of the data.
        form: "filtered" or "energy".
        symmetry, orientation: of the tensors, as for learning.fit; long waves must be isotropic.
        moduli: "long waves" holds those with which no long wave is left of the loads (N29), a Voigt
            matrix holds its own.

    Raises InputError for samples that do not carry twice the horizon, do not determine the law, or
    have no load.
    """
    begin = time.perf_counter()
    if samples.points.dimension != 2:
        raise InputError("samples: expected a sheet; in space LPS and Micromodulus are learned")
    axes = grid_of(
        samples.points, invariant_basis(horizon / samples.spacing, np.eye(2)[None]).steps
    ).axes
    turn = np.eye(2) if orientation is None else axes.T @ checked_orientation(orientation, 2)
    group = point_group(symmetry, 2)
    shared = shared_with_nodes(group, turn)
    bonds = invariant_basis(horizon / samples.spacing, shared)
    weights = gradient_weights(smoothing, form, bond_classes(samples.spacing, horizon))
    extra = nonlinear_features(samples, horizon, weights)
    extra = np.einsum("sima,ak->sikm", extra, axes)
    misfit = None
    if isinstance(moduli, str):
        allowed = allowed_tensors(symmetry, group, turn)
        rows = _rows(samples, bonds, extra, *regression.long_wave_rows(samples, allowed, 0)[:2])
        tensor, misfit = _found_moduli(samples, bonds, shared, rows, allowed)
    else:
        rows = _rows(samples, bonds, extra, np.zeros((0, 0)), np.zeros(0, int))
        tensor = turned(from_voigt(np.asarray(moduli, float)), turn)
    learned, numbers = _at(rows, bonds, shared, tensor, samples.spacing)
    t3, tq2, q3 = numbers[:CONSTANTS]
    record = {
        "from": "fields",
        "loss": learned.loss,
        "long_wave_misfit": misfit,
        "cuts": learned.cuts,
        "numbers": len(bonds.basis) + CONSTANTS,
    }
    linear = law_of(learned, bonds, samples.spacing, samples.points.units, symmetry, turn, {})
    law = ThirdOrderCrystal(
        linear, t3, tq2, q3, smoothing, form, float(horizon), provenance={"fit": record}
    )
    law = law.certified()
    operator = law.on(samples.points, allow_uncertified=True)
    b = samples.loads[:, samples.interior]
    wrong = np.linalg.norm((operator(samples.u) - b).reshape(len(b), -1), axis=1)
    error = float((wrong / np.linalg.norm(b.reshape(len(b), -1), axis=1)).mean())
    largest = float(operator.largest_gradient(samples.u).max())
    return ThirdOrderFit(law, error, largest, time.perf_counter() - begin)


@dataclass(frozen=True)
class _Rows:
    """Columns of the constants, of the basis tensors, of λ and of μ in Ψ, and their right side.

    Attributes:
        R, y: triangular, so that below the constants' own rows stands the loss at their best (N28).
        long, load: the same against the longest test field, [S, V, d, …] (N29).
        weight: 1/‖b‖ of each sample, [S, 1, 1, 1].
    """

    R: np.ndarray
    y: np.ndarray
    long: np.ndarray
    load: np.ndarray
    weight: np.ndarray


def _lame(tensor: np.ndarray) -> np.ndarray:
    return np.array([tensor[0, 0, 1, 1], tensor[0, 1, 0, 1]])


def _at(
    rows: _Rows, bonds: Basis, shared: np.ndarray, tensor: np.ndarray, spacing: float
) -> tuple[Learned, np.ndarray]:
    """The fit with some moduli, and the numbers that belong to all columns."""
    known = _lame(tensor)  # those of the geometric terms are those of the tensors
    y = rows.y - rows.R[:, -2:] @ known
    below = slice(CONSTANTS, -2)
    learned = solved(rows.R[CONSTANTS:, below], y[CONSTANTS:], bonds, shared, tensor, spacing)
    p = learned.p / spacing**2
    top = rows.R[:CONSTANTS]
    best = np.linalg.solve(top[:, :CONSTANTS], y[:CONSTANTS] - top[:, below] @ p)
    return learned, np.concatenate([best, p, known])


def _found_moduli(
    samples: Samples, bonds: Basis, shared: np.ndarray, rows: _Rows, allowed: np.ndarray
) -> tuple[np.ndarray, float]:
    """The moduli with which what the law leaves of the loads has no long waves (N29)."""
    moments = regression.long_wave_rows(samples, allowed, 0)[2] * rows.weight
    own = rows.long[..., -2:] @ np.array([_lame(C) for C in allowed]).T
    R = np.concatenate([moments + own, rows.long[..., :CONSTANTS]], axis=-1)

    def left(c: np.ndarray) -> np.ndarray:
        tensor = np.tensordot(c, allowed, 1)
        numbers = _at(rows, bonds, shared, tensor, samples.spacing)[1]
        return np.asarray(rows.load - rows.long @ numbers)

    def change(c: np.ndarray) -> np.ndarray:
        return regression.moduli_of(R, left(c))[0][: len(c)]

    guess = regression.long_wave_moduli(samples, allowed)[0]
    start = np.linalg.lstsq(allowed.reshape(len(allowed), -1).T, guess.ravel())[0]
    c = root(change, start, tol=SETTLED).x
    misfit = np.linalg.norm(left(c)) / np.linalg.norm(rows.load)
    return np.tensordot(c, allowed, 1), float(misfit)


def _rows(
    samples: Samples, bonds: Basis, extra: np.ndarray, values: np.ndarray, kept: np.ndarray
) -> _Rows:
    """Each sample over its load; test fields, shape [V, n], on nodes by number."""
    nodes = grid_of(samples.points, bonds.steps)
    b = samples.loads[:, samples.interior] @ nodes.axes
    size = np.linalg.norm(b.reshape(len(b), -1), axis=1)
    if not (size > 0).all():
        raise InputError(f"b: expected loads, got none on sample {int(np.argmin(size))}")
    count = bonds.basis.shape[0] + extra.shape[-1]
    step = max(1, regression.CHUNK // (count * b[0].size))
    place = (np.cumsum(samples.interior) - 1)[kept]
    R, y, long, load = np.zeros((0, count)), np.zeros(0), [], []
    for first in range(0, len(b), step):
        some = slice(first, first + step)
        tensors = regression._features(samples.u[some], nodes, bonds)
        parts = [extra[some, ..., :CONSTANTS], tensors, extra[some, ..., CONSTANTS:]]
        columns = np.concatenate(parts, axis=-1) / size[some, None, None, None]
        right = b[some] / size[some, None, None]
        long.append(np.einsum("vn,snka->svka", values, columns[:, place], optimize=True))
        load.append(np.einsum("vn,snk->svk", values, right[:, place], optimize=True))
        R, y = compressed(
            np.concatenate([R, columns.reshape(-1, count)]), np.append(y, right.ravel())
        )
    if len(R) < count:
        raise InputError(f"data: expected enough to tell {count} numbers apart; give more loads")
    weight = (1 / size)[:, None, None, None]
    return _Rows(R, y, np.concatenate(long), np.concatenate(load), weight)
