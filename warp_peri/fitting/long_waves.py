"""Long waves of fields: moduli (theory, T10, 28a), and the symmetry of a crystal (T8).

Smooth test fields v that end before the nodes do see of a solid only its moduli: Σ b·v = −Σ u·div(C
: grad v), linear in C. Long waves dominate both sides, whatever else the fields hold.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import lstsq, matrix_rank, norm, pinv

from warp_peri.core.elastic import (
    CANDIDATES,
    LEAST,
    Symmetry,
    allowed_tensors,
    central_weights,
    point_group,
    shared_with_nodes,
)
from warp_peri.core.stencil import invariant_basis
from warp_peri.core.torch_bridge import own_torch
from warp_peri.errors import InputError, Several, warn
from warp_peri.fitting.regression import over_loads, relative, rows
from warp_peri.points.arguments import Pair
from warp_peri.points.families import neighbour_table
from warp_peri.points.points import Samples

MODES, LEAST_HALF_WAVE = 1, 3
"""Half waves along an axis of the longest test fields, and spacings that one has at least."""
ENOUGH = 8
"""Samples whose halves tell how far moduli are unsure."""
REACH, HALF_WAVES = 2, 4
"""Spacings that gradients of long waves reach over, and half waves of the fields that see them."""
NOTHING = 1e-13
"""Of equations of size one, that is rounding."""


def long_wave_moduli(samples: Samples, allowed: ndarray) -> tuple[ndarray, float]:
    """Fit the elastic tensor of the longest waves as a mixture of `allowed` ones along nodes' axes,
    [m, d, d, d, d] (theory, T10); also the relative residual. InputError for too few loads."""
    c, misfit = moduli_of(*long_wave_equations(samples, allowed))
    return np.tensordot(c, allowed, 1), misfit


def long_wave_equations(samples: Samples, allowed: ndarray) -> Pair:
    """Equations R and y that `long_wave_moduli` solves, shapes [n, m] and [n]."""
    values, kept, R = long_wave_rows(samples, allowed, MODES)
    axes = samples.lattice.axes
    y = np.einsum("vn,snk->svk", values, (samples.loads @ axes)[:, kept], optimize=True)
    return R.reshape(-1, R.shape[-1]), y.ravel()


def long_wave_rows(samples: Samples, allowed: ndarray, modes: int) -> Several:
    """Test fields v [V, n] with up to `modes` half waves each way, the numbers of their nodes, and
    −Σ u·div(C : grad v) of each allowed tensor, [S, V, d, m]."""
    axes = samples.lattice.axes
    lines, kept = lines_of_waves(samples, modes)
    one = np.eye(len(axes), dtype=int)
    slopes = np.array([[derived(lines, j + k) for k in one] for j in one])
    moments = np.einsum("jlvn,sni->svijl", slopes, (samples.u @ axes)[:, kept], optimize=True)
    values = derived(lines, 0 * one[0])
    return values, kept, -np.einsum("svijl,aijkl->svka", moments, allowed, optimize=True)


TOLD = 1e-7
"""Of columns of size one: numbers that add less are not told by fields of single precision."""


def told_apart(R: ndarray, least: float = TOLD) -> bool:
    """Whether rows [n, m] tell the numbers of all columns apart, in single precision or double."""
    size = norm(R, axis=0)
    full = R / np.where(size > 0, size, 1)
    return not R.shape[1] or bool(matrix_rank(full, rtol=least) == R.shape[1])


def moduli_of(R: ndarray, y: ndarray) -> tuple[ndarray, float]:
    """Least-squares constants of rows [..., m], relative residual; InputError for too few rows."""
    R, y = R.reshape(-1, R.shape[-1]), y.ravel()
    size = norm(R, axis=0)
    if not told_apart(R, 10 * TOLD):
        raise InputError(
            f"moduli: the long waves of these loads do not tell {R.shape[1]} constants apart; "
            "give them, or more loads of long waves"
        )
    c = lstsq(R / size, y)[0] / size
    return c, relative(R @ c - y, y)


def lines_of_waves(samples: Samples, modes: int) -> tuple[list[ndarray], ndarray]:
    """Long waves v by axis, with derivatives 0 to 4, [M, 5, n], and the numbers of their nodes:
    plane waves of a period, else sin⁴(π t) cos(m π t) on a box of interior nodes."""
    points, grid = samples.points, samples.lattice.steps
    h, d = points.spacing, grid.shape[1]
    if points.box is not None:
        return [_waves(grid[:, a] * h, points.box[a]) for a in range(d)], np.arange(len(grid))
    kept = _largest_box(grid, samples.interior)
    low, high = grid[kept].min(axis=0) - 1, grid[kept].max(axis=0) + 1
    if (high - low).min() < 8:
        raise InputError(
            f"moduli: expected an interior of at least 7 nodes each way to find them in, got "
            f"{(high - low).min() - 1}; give them"
        )
    t = (grid[kept] - low) / (high - low)
    modes = min(modes, (high - low).min() // LEAST_HALF_WAVE)
    return [_bumps(t[:, a], h * (high - low)[a], modes) for a in range(d)], kept


def derived(lines: list[ndarray], orders: ndarray) -> ndarray:
    """Products of one wave of each axis, with derivatives of given orders, shape [V, n]."""
    fields = np.ones((1, lines[0].shape[-1]))
    for line, order in zip(lines, orders):
        fields = (fields[:, None] * line[:, order]).reshape(-1, fields.shape[1])
    return fields


def _bumps(t: ndarray, length: float, modes: int) -> ndarray:
    """sin⁴(π t) cos(m π t) on 0 < t < 1, with derivatives to length t."""
    found = []
    for m in range(modes + 1):
        # sin⁴ = (3 − 4 cos 2πt + cos 4πt)/8, a sum of cosines of whole numbers of half waves
        parts = [(3 / 8, m), (-1 / 4, m + 2), (-1 / 4, m - 2), (1 / 16, m + 4), (1 / 16, m - 4)]
        waves = sum(c * _derivatives(np.pi * q, np.exp(1j * np.pi * q * t)) for c, q in parts)
        found.append(waves / length ** np.arange(5.0)[:, None])
    return np.array(found)


def _waves(x: ndarray, length: float) -> ndarray:
    """1, cos and sin of the first wave of a period, with their derivatives."""
    k = 2 * np.pi / length
    wave = np.exp(1j * k * x)
    return np.array([_derivatives(0 * k, wave**0), *(_derivatives(k, f * wave) for f in (1, -1j))])


def _derivatives(k: float, wave: ndarray) -> ndarray:
    """Derivatives of the real part of a wave e^{ikx}, shape [5, n]."""
    return np.array([((1j * k) ** n * wave).real for n in range(5)])


def _largest_box(grid: ndarray, interior: ndarray) -> ndarray:
    """Numbers of the interior nodes in the largest filled box about their middle."""
    inside = np.flatnonzero(interior)
    low, high = grid[inside].min(axis=0), grid[inside].max(axis=0)
    while (high >= low).all():
        within: ndarray = inside[((grid[inside] >= low) & (grid[inside] <= high)).all(axis=1)]
        if len(within) == np.prod(high - low + 1):
            return within
        low, high = low + 1, high - 1
    return np.empty(0, int)


@dataclass(frozen=True)
class LongWaves:
    """Moduli λ and μ of the long waves of fields, with standard errors (theory, 28a).

    Attributes:
        lam, mu: [stress].
        errors: standard errors of both, each sample or test field left out in turn.
        misfit: what is left of the loads on long waves, relative.
        terms: that are taken beside λ and μ, each because it foretells what was left out.
    """

    lam: float
    mu: float
    errors: ndarray
    misfit: float
    terms: tuple[str, ...]


def lame_of_long_waves(sets: Sequence[Samples]) -> LongWaves:
    """Fit λ and μ to the long waves of lattices in the plane, with other terms that predict.

    Of all choices of dispersion, third order and constants of fourth order the smallest is taken
    that predicts as well as the best, to one standard error. An axis that is not stated is learned.
    Raises InputError for samples that see no long waves, or do not tell λ and μ.
    """
    turns = 1 if all(each.points.axis is not None for each in sets) else 2
    tables, loads = zip(*(_long_wave_table(each, turns) for each in sets))
    R, y = np.concatenate(tables), np.concatenate(loads)
    size = np.sqrt((R**2).sum(axis=(0, 1, 2)))
    R, groups = R / np.where(size > 0, size, 1), _groups(turns)
    terms = R[..., groups[LAME[1]].start :]
    c = lstsq(terms.reshape(y.size, -1), y.ravel(), rcond=NOTHING)[0]
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
        """Loss of these terms over the best choice's, in standard errors."""
        more = tried[names][0] - best
        return float(more.sum() / max(np.sqrt(len(more)) * more.std(), NOTHING * best.sum()))

    taken = min(
        (names for names in tried if lost(names) <= 1),
        key=lambda names: (len(names), tried[names][0].sum()),
    )
    found, misfit = moduli_of(_mixed(R, columns[taken]), y)
    unit, drawn = size[columns[taken][0]], tried[taken][1]
    (lam, mu), errors = found[:2] / unit, np.sqrt((len(drawn) - 1) * drawn.var(axis=0)) / unit
    return LongWaves(float(lam), float(mu), errors, misfit, taken)


LAME, DISPERSION, THIRD = ("linear", "geometric"), "dispersion", "third order"
"""Names of columns: λ and μ at small strain, and with what finite strain adds; others."""


def _groups(turns: int) -> dict[str, slice]:
    """Columns of each group of terms, `turns` for a term with six periods a turn."""
    sizes = {"linear": 2, "geometric": 2, DISPERSION: 2 + turns, THIRD: 2 + turns}
    sizes |= {"θ⁴": 1, "θ²q": 1, "q²": 1, "θ z³": turns}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(*pair) for name, pair in zip(sizes, itertools.pairwise(ends))}


def _mixed(R: ndarray, columns: Sequence[slice]) -> ndarray:
    return np.concatenate([R[..., some] for some in columns], axis=-1)


def _foretold(R: ndarray, y: ndarray) -> Pair:
    """Squared prediction errors of each part by the others [P], and their λ and μ, [P, 2]."""
    square, side = np.einsum("pra,prb->pab", R, R), np.einsum("pra,pr->pa", R, y)
    others = square.sum(axis=0) - square, side.sum(axis=0) - side
    c = (pinv(others[0], rcond=NOTHING, hermitian=True) @ others[1][..., None])[..., 0]
    return ((np.einsum("pra,pa->pr", R, c) - y) ** 2).sum(axis=1), c[:, :2]


def _long_wave_table(samples: Samples, count: int) -> Pair:
    """Moments of every term with test fields, [S, V, 2, m], and of the loads, [S, V, 2]; terms with
    six periods a turn are `count`, 1 along the axis of the points or 2."""
    axes = samples.lattice.axes
    lines, kept = lines_of_waves(samples, HALF_WAVES)
    u, b = (samples.u @ axes)[:, kept], (samples.loads @ axes)[:, kept]
    axis = np.deg2rad(samples.points.axis or 0.0) - np.arctan2(axes[1, 0], axes[0, 0])
    turn = np.exp(-1j * axis)

    def seen(*orders: tuple[int, int]) -> ndarray:
        """Moments Σ u times the sum of derivatives of v, [S, V, 2]."""
        field = sum(derived(lines, np.array(one)) for one in orders)
        return np.asarray(np.einsum("vn,snk->svk", field, u, optimize=True))

    def elastic(*more: tuple[int, int]) -> list[ndarray]:
        """Moments −Σ u·div(C : grad v) of λ and of μ, for the sum of derivatives of v."""
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
    slope = np.stack([derived(lines, one) for one in np.eye(2, dtype=int)], axis=-1)
    P = _stresses(gradients(samples, kept), turn, count)
    felt = [np.einsum("snkl,vnl->svk", one, slope, optimize=True) for one in P]
    geometric = [one + more for one, more in zip(linear, felt)]
    table = np.stack([*linear, *geometric, *elastic((2, 0), (0, 2)), *six, *felt[2:]], axis=-1)
    values = derived(lines, np.zeros(2, int))
    weight = over_loads(samples)[:, None, None]
    return table * weight[..., None], weight * np.einsum("vn,snk->svk", values, b, optimize=True)


def gradients(samples: Samples, kept: ndarray, reach: int = REACH) -> ndarray:
    """Displacement gradients ∂u/∂x along the nodes' axes by differences, [S, n, 2, 2]."""
    points, h = samples.points, samples.spacing
    grid, axes = points.lattice
    period = None if points.box is None else np.rint(np.divide(points.box, h)).astype(int)
    ways = itertools.product(np.eye(2, dtype=int), range(1, reach + 1), (1, -1))
    near = neighbour_table(grid, np.array([sign * m * one for one, m, sign in ways]), period)[kept]
    if (near < 0).any():
        raise InputError("moduli: expected nodes two spacings around the interior")
    ahead, behind = np.moveaxis(samples.u[:, near.reshape(len(kept), 2, reach, 2)], 4, 0)
    return np.asarray(
        np.einsum("m,snlmk,ka->snal", central_weights(reach) / h, ahead - behind, axes)
    )


@own_torch()
def _stresses(H: ndarray, turn: complex, count: int) -> list[ndarray]:
    """First Piola-Kirchhoff stress of each unit constant at H, those of λ and μ without H itself.
    The energies are powers of θ = tr E, q = dev E : dev E and z, half the deviator as a complex
    number along the axis: λ, μ, θ³, θq, Re z³ and Im z³, θ⁴, θ²q, q², θ Re z³ and θ Im z³."""
    at = torch.tensor(H, requires_grad=True)
    small = (at + at.mT) / 2
    E = small + at.mT @ at / 2
    theta, traced = (e.diagonal(dim1=-2, dim2=-1).sum(dim=-1) for e in (E, small))
    q = (E**2).sum(dim=(-2, -1)) - theta**2 / 2
    z = torch.complex((E[..., 0, 0] - E[..., 1, 1]) / 2, E[..., 0, 1]) * turn**2
    cubes = [(z**3).real, (z**3).imag][:count]
    energies = [(theta**2 - traced**2) / 2, (E**2 - small**2).sum(dim=(-2, -1))]
    energies += [theta**3, theta * q, *cubes, theta**4, theta**2 * q, q**2]
    energies += [theta * cube for cube in cubes]
    slopes = (torch.autograd.grad(W.sum(), at, retain_graph=True)[0] for W in energies)
    return [slope.numpy() for slope in slopes]


AS_GOOD = 1.02
"""A group is taken while the loss with it is at most so many times that of the best group,"""
SMALL = 0.003
"""and this much of the loads."""
MUCH, MUCH_OF_ALL = 1.5, 0.01
"""The same of one that is told: data contradict it beyond that."""


def judged(
    samples: Samples, reach: float, turn: ndarray, normalise: bool, told: Symmetry
) -> tuple[Symmetry, float | None]:
    """The given symmetry, or for "auto" the largest group without loss; and its loss over the best.

    It is to cost nothing in L u = b, nor in the moduli of long waves. Each half of the samples is
    judged by the fit of the other, for hundreds of numbers fit few samples too well. The figure is
    the larger of both losses over the best group's, None where the data do not determine the group.
    Warns where data contradict the given symmetry.
    """
    d, auto = len(turn), str(told) == "auto"
    if len(samples) < 2 and not auto:
        return told, None
    least = invariant_basis(reach, point_group(LEAST[d], d).astype(int))
    any_tensor = allowed_tensors(LEAST[d], turn)
    halves = [samples[n::2] for n in range(min(2, len(samples)))]
    weights = [over_loads(half) if normalise else None for half in halves]
    equations = [rows(half, least, weight=each) for half, each in zip(halves, weights)]
    R = np.concatenate([rows for rows, _ in equations])
    if auto and not told_apart(R):
        raise InputError(
            f"data: expected enough to tell {R.shape[1]} numbers without any symmetry apart; name "
            "one, or give more loads"
        )
    try:
        long = [long_wave_equations(half, any_tensor) for half in halves]
    except InputError:  # too few nodes to see long waves on
        long = []

    def losses(name: Symmetry) -> ndarray:
        bonds = invariant_basis(reach, shared_with_nodes(point_group(name, d), turn))
        allowed = allowed_tensors(name, turn)
        of_long = _crossed(long, np.einsum("aijkl,bijkl->ba", allowed, any_tensor)) if long else 0.0
        own = _crossed(equations, np.einsum("anij,bnij->ba", bonds.basis, least.basis))
        return np.array([own, of_long])

    found = {name: losses(name) for name in CANDIDATES[d]}
    own = None if auto else found[told] if isinstance(told, str) and told in found else losses(told)
    best = np.min([*found.values(), *([] if own is None else [own])], axis=0)
    if own is None:
        costs_nothing = (name for name in found if (found[name] <= AS_GOOD * best + SMALL).all())
        told = next(costs_nothing, LEAST[d])
        own = found[told]
    elif np.isfinite(own).all() and (own > MUCH * best + MUCH_OF_ALL).any():
        worst = np.argmax(own - best)
        what = ("L u = b", "the moduli of long waves")[worst]
        warn(
            f"symmetry: the data contradict what is told: in {what} it leaves {own[worst]:.1%} of "
            f"the loads, another group {best[worst]:.1%}; symmetry='auto' looks for it"
        )
    if not np.isfinite(own).all():
        return told, None
    return told, float((own / np.maximum(best, SMALL)).max())


def _crossed(equations: Sequence[Several], mix: ndarray) -> float:
    """‖R M p − y‖ / ‖y‖ of each part with the other's p (one part: its own); or infinity."""
    parts = [(R @ mix, y) for R, y in equations]
    if not all(told_apart(R) for R, _ in parts):
        return np.inf
    fits = [lstsq(R, y)[0] for R, y in parts]
    left = np.concatenate([R @ p - y for (R, y), p in zip(parts, fits[::-1])])
    return relative(left, np.concatenate([y for _, y in parts]))
