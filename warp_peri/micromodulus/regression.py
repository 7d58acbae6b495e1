"""What fields say of a law, and least squares under equalities and cuts (theory, T7–T10)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from warp_peri.core.grid import Grid, grid_of
from warp_peri.core.stencil import Basis, bend, laplacian, ratios, zone_sample
from warp_peri.errors import InputError
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import Samples
from warp_peri.regression.search import compressed, least_squares_above, particular

ROUNDS, NEW_CUTS = 60, 40
MET = 1e-6
"""Relative, of the floor: what is above (1 − MET) of it is met."""
NOTHING = 1e-10
"""Of equalities of size one, that are rounding."""


@dataclass
class Learned:
    """Numbers of a law and how they came out.

    Attributes:
        p: of the invariant tensors, shape [P].
        loss: ‖R p − y‖ / ‖y‖.
        free: the same without cuts.
        cuts: active or not, that were needed.
        smallest: smallest Λmin D(k)/s(k) on the grid, in the units of p times h².
    """

    p: np.ndarray
    loss: float
    free: float
    cuts: int
    smallest: float
    history: list[float] = field(default_factory=list)


def learn(
    R: np.ndarray,
    y: np.ndarray,
    bonds: Basis,
    group: np.ndarray,
    *,
    equal: tuple[np.ndarray, np.ndarray],
    floor: float,
) -> Learned:
    """min ‖R p − y‖ with A p = a and vᵗ D(k) v ≥ floor s(k) h² wherever a wave was found below it.

    Args:
        R, y: rows of the fit, shape [n, P] and [n].
        bonds: the family and its basis.
        group: of the nodes, which says how much of the zone is looked at.
        equal: A and a, shape [E, P] and [E], the largest entries of A around 1; rows that depend on
            others or vanish are allowed.
        floor: ζ in the units of p.

    Raises InputError for equalities that contradict one another, more numbers than the rows can
    tell, or a floor that no law of this family meets.
    """
    R, y = compressed(R, y)
    A, a = equal
    said = np.linalg.norm(A, axis=1) > NOTHING
    A, a = A[said], a[said]
    p0, free = particular(A, a)
    if np.abs(A @ p0 - a).max(initial=0.0) > MET * max(np.abs(a).max(initial=0.0), 1e-300):
        raise InputError(
            "moduli: no model of this horizon and symmetry has them; a larger horizon or a "
            "smaller symmetry may"
        )
    reduced = R @ free
    rest = y - R @ p0
    scale = float(np.linalg.norm(y)) or 1.0
    sizes = np.linalg.svd(reduced, compute_uv=False)
    if np.count_nonzero(sizes > 1e-12 * sizes.max(initial=0.0)) < free.shape[1]:
        raise InputError(
            f"data: expected enough to tell {free.shape[1]} numbers of {len(bonds.steps) * 2} "
            "bonds apart; give more loads, shorter waves, a smaller horizon or a larger symmetry"
        )
    phase = zone_sample(group, bonds.dimension)
    s, wave = laplacian(phase), bend(phase, bonds.steps)
    G, g = np.zeros((0, free.shape[1])), np.zeros(0)
    x = least_squares_above(reduced, rest, G, g)
    unbound = float(np.linalg.norm(reduced @ x - rest)) / scale
    for _ in range(ROUNDS):
        tensors = np.tensordot(p0 + free @ x, bonds.basis, 1)
        value, vector = ratios(bonds.steps, tensors, phase)
        below = np.argsort(value)[:NEW_CUTS]
        below = below[value[below] < floor * (1 - MET)]
        if not len(below):
            break
        v = vector[below]
        work = np.einsum("axij,ki,kj->kax", bonds.basis, v, v, optimize=True)
        rows = np.einsum("kax,kx->ka", work, wave[below]) / s[below, None]
        G, g = np.concatenate([G, rows @ free]), np.append(g, floor - rows @ p0)
        try:
            x = least_squares_above(reduced, rest, G, g)
        except InputError:
            raise InputError(
                "stability: no model of this horizon and symmetry meets the floor"
            ) from None
    else:
        raise InputError(f"stability: the cuts did not settle in {ROUNDS} rounds")
    loss = float(np.linalg.norm(reduced @ x - rest)) / scale
    return Learned(p0 + free @ x, loss, unbound, len(g), float(value.min()))


CHUNK = 2**24
"""Numbers of a block of rows before it is compressed."""
MODES, LEAST_HALF_WAVE = 1, 3
"""Half waves along an axis of the longest test fields, and spacings that one has at least."""


def rows(samples: Samples, bonds: Basis, *, normalise: bool = False) -> tuple[np.ndarray, ...]:
    """R and y so that ‖R p − y‖² is the sum of squares of L u − b, as few rows as that takes.

    Args:
        samples: fields on lattice nodes, along whose axes the basis is.
        bonds: the family.
        normalise: divide each sample by ‖b‖.

    Raises InputError as grid_of does, and for samples without loads.
    """
    nodes = grid_of(samples.points, bonds.steps)
    b = samples.loads[:, samples.interior] @ nodes.axes
    count = bonds.basis.shape[0]
    weight = np.ones(len(b))
    if normalise:
        size = np.linalg.norm(b.reshape(len(b), -1), axis=1)
        weight = np.where(size > 0, 1 / np.where(size > 0, size, 1), 0.0)
    step = max(1, CHUNK // (count * b[0].size))
    R, y = np.zeros((0, count)), np.zeros(0)
    for first in range(0, len(b), step):
        some = slice(first, first + step)
        features = _features(samples.u[some], nodes, bonds) * weight[some, None, None, None]
        right = b[some] * weight[some, None, None]
        R, y = compressed(
            np.concatenate([R, features.reshape(-1, count)]), np.append(y, right.ravel())
        )
    return R, y


def _features(u: np.ndarray, nodes: Grid, bonds: Basis) -> np.ndarray:
    """L u of every basis tensor at the interior nodes, shape [S, I, d, P]."""
    planes = nodes.scatter(u)
    asked = nodes.unknown
    order = np.argsort(np.argsort(nodes.interior))
    middle = planes[(slice(None), slice(None), *nodes.core)][:, :, asked]
    r = nodes.reach
    F = np.zeros((len(u), middle.shape[2], nodes.dimension, bonds.basis.shape[0]))
    for step, tensors in zip(bonds.steps, bonds.basis.transpose(1, 0, 2, 3)):
        pulled = 2 * middle
        for sign in (1, -1):
            part = tuple(slice(r + sign * s, n - r + sign * s) for s, n in zip(step, nodes.wide))
            pulled = pulled - planes[(slice(None), slice(None), *part)][:, :, asked]
        some = np.flatnonzero(tensors.any(axis=(1, 2)))
        F[..., some] += np.einsum("sji,ajk->sika", pulled, tensors[some], optimize=True)
    return F[:, order]


def long_wave_moduli(samples: Samples, allowed: np.ndarray) -> tuple[np.ndarray, float]:
    """The elastic tensor that the longest waves of fields have (theory, T10).

    Smooth test fields v that end before the nodes do see of a solid only its moduli:
    Σ b·v = −Σ u·div(C : grad v), linear in C. Long waves dominate both sides, whatever else the
    fields hold.

    Args:
        samples: fields and loads on a lattice, periodic or with a collar.
        allowed: elastic tensors along the nodes' axes that may be mixed, [m, d, d, d, d].

    Returns:
        the tensor [d, d, d, d], and the relative residual of the equations.

    Raises InputError for loads that do not tell the tensors apart.
    """
    c, misfit = moduli_of(*long_wave_equations(samples, allowed))
    return np.tensordot(c, allowed, 1), misfit


def long_wave_equations(samples: Samples, allowed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R and y of what `long_wave_moduli` solves, shape [n, m] and [n]."""
    values, kept, R = long_wave_rows(samples, allowed, MODES)
    axes = lattice_steps(samples.points)[1]
    y = np.einsum("vn,snk->svk", values, (samples.loads @ axes)[:, kept], optimize=True)
    return R.reshape(-1, R.shape[-1]), y.ravel()


def long_wave_rows(samples: Samples, allowed: np.ndarray, modes: int) -> tuple[np.ndarray, ...]:
    """Test fields with up to so many half waves each way, and what they see of elastic tensors.

    Returns v, shape [V, n], the numbers of the nodes it is on, and −Σ u·div(C : grad v) of each
    tensor, [S, V, d, m].
    """
    axes = lattice_steps(samples.points)[1]
    lines, kept = lines_of_waves(samples, modes)
    one = np.eye(len(axes), dtype=int)
    slopes = np.array([[derived(lines, j + k) for k in one] for j in one])
    u = (samples.u @ axes)[:, kept]
    moments = np.einsum("jlvn,sni->svijl", slopes, u, optimize=True)
    values = derived(lines, 0 * one[0])
    return values, kept, -np.einsum("svijl,aijkl->svka", moments, allowed, optimize=True)


def moduli_of(R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """Least squares of rows [..., m], and its relative residual; InputError where rows tell less
    than m constants apart."""
    R, y = R.reshape(-1, R.shape[-1]), y.ravel()
    size = np.linalg.norm(R, axis=0)
    R = R / np.where(size > 0, size, 1)
    if np.linalg.matrix_rank(R, tol=1e-6 * np.linalg.norm(R, 2)) < R.shape[1]:
        raise InputError(
            f"moduli: the long waves of these loads do not tell {R.shape[1]} constants apart; "
            "give them, or more loads of long waves"
        )
    c = np.linalg.lstsq(R, y, rcond=None)[0]
    return c / size, float(np.linalg.norm(R @ c - y) / np.linalg.norm(y))


def lines_of_waves(samples: Samples, modes: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Long waves v by axis, with derivatives 0 to 4, [M, 5, n], and the numbers of their nodes.

    Plane waves of a period; else sin⁴(π t) cos(m π t) on a box of interior nodes.
    """
    points, grid = samples.points, lattice_steps(samples.points)[0]
    h, d = points.spacing, grid.shape[1]
    if points.box is not None:
        periods = np.asarray(points.box)
        return [_waves(grid[:, a] * h, periods[a]) for a in range(d)], np.arange(len(grid))
    kept = _largest_box(grid, samples.interior)
    low, high = grid[kept].min(axis=0) - 1, grid[kept].max(axis=0) + 1
    if (high - low).min() < 8:
        raise InputError(
            f"moduli: expected an interior of at least 7 nodes each way to find them in, got "
            f"{(high - low).min() - 1}; give them"
        )
    t = (grid[kept] - low) / (high - low)
    modes = min(modes, int((high - low).min()) // LEAST_HALF_WAVE)
    return [_bumps(t[:, a], h * (high - low)[a], modes) for a in range(d)], kept


def derived(lines: list[np.ndarray], orders: np.ndarray) -> np.ndarray:
    """Products of one wave of each axis, derived so often along each, shape [V, n]."""
    fields = np.ones((1, lines[0].shape[-1]))
    for line, order in zip(lines, orders):
        fields = (fields[:, None] * line[:, order]).reshape(-1, fields.shape[1])
    return fields


def _bumps(t: np.ndarray, length: float, modes: int) -> np.ndarray:
    """sin⁴(π t) cos(m π t) on 0 < t < 1, with derivatives to length t."""
    found = []
    for m in range(modes + 1):
        # sin⁴ = (3 − 4 cos 2πt + cos 4πt)/8, a sum of cosines of whole numbers of half waves
        parts = [(3 / 8, m), (-1 / 4, m + 2), (-1 / 4, m - 2), (1 / 16, m + 4), (1 / 16, m - 4)]
        waves = sum(
            c * _derivatives(np.pi * q, np.cos(np.pi * q * t), np.sin(np.pi * q * t))
            for c, q in parts
        )
        found.append(waves / length ** np.arange(5.0)[:, None])
    return np.array(found)


def _waves(x: np.ndarray, length: float) -> np.ndarray:
    """1, cos and sin of the first wave of a period, with their derivatives."""
    k = 2 * np.pi / length
    cos, sin, one = np.cos(k * x), np.sin(k * x), np.ones(len(x))
    pairs = (one, 0 * one), (cos, sin), (sin, -cos)
    return np.array([_derivatives(q, *pair) for q, pair in zip((0.0, k, k), pairs)])


def _derivatives(k: float, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Of cos k x, from itself and sin k x, shape [5, n]."""
    return np.array([cos, -k * sin, -(k**2) * cos, k**3 * sin, k**4 * cos])


def _largest_box(grid: np.ndarray, interior: np.ndarray) -> np.ndarray:
    """Numbers of the interior nodes in the largest box about their middle that they fill."""
    inside = np.flatnonzero(interior)
    low, high = grid[inside].min(axis=0), grid[inside].max(axis=0)
    while (high >= low).all():
        within: np.ndarray = inside[((grid[inside] >= low) & (grid[inside] <= high)).all(axis=1)]
        if len(within) == np.prod(high - low + 1):
            return within
        low, high = low + 1, high - 1
    return np.empty(0, int)
