"""Least squares under equalities, and cuts that keep a symbol above a floor (theory.md, T7–T9)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from scipy.optimize import nnls

from warp_peri.errors import InputError
from warp_peri.micromodulus.family import Family, bend
from warp_peri.micromodulus.groups import orbit_grid

CUT_INTERVALS = {2: 40, 3: 12}
"""Of the grid on the zone that cuts are looked for on."""
DIRECTIONS = {2: 60, 3: 200}
"""Of long waves."""
LONG = 1e-3
"""Their |k| h."""
ROUNDS, NEW_CUTS = 60, 40
MET = 1e-6
"""Relative, of the floor: what is above (1 − MET) of it is met."""
DEPENDENT = 1e-10


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


def directions(count: int, dimension: int) -> np.ndarray:
    """Unit vectors spread evenly over half the circle, or over the sphere, shape [count, d]."""
    number = np.arange(count) + 0.5
    if dimension == 2:
        angle = np.pi * number / count
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    z = 1 - 2 * number / count
    angle = np.pi * (1 + np.sqrt(5)) * number
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def laplacian(phase: np.ndarray) -> np.ndarray:
    """s(k) h² = 4 Σ sin²(k_a h/2) at k h = `phase`, shape [K]."""
    wave: np.ndarray = 4 * (np.sin(phase / 2) ** 2).sum(axis=1)
    return wave


def zone_sample(group: np.ndarray, dimension: int, intervals: int | None = None) -> np.ndarray:
    """k h of one of each orbit of a grid on the zone, and of very long waves, shape [K, d]."""
    grid = orbit_grid(intervals or CUT_INTERVALS[dimension], group, dimension)
    axes = np.array([v for v in np.ndindex((3,) * dimension) if v != (1,) * dimension]) - 1.0
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    return np.concatenate([grid, LONG * axes, LONG * directions(DIRECTIONS[dimension], dimension)])


def ratios(steps: np.ndarray, tensors: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, ...]:
    """Λmin D/s h^−2 at k h = `phase`, shape [K], and the eigenvectors it is taken at, [K, d]."""
    symbol = np.tensordot(bend(phase, steps), tensors, 1)
    value, vector = np.linalg.eigh(symbol)
    return value[:, 0] / laplacian(phase), vector[:, :, 0]


def learn(
    R: np.ndarray,
    y: np.ndarray,
    bonds: Family,
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
    p0, free = particular(*equal)
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
    x = _inequality_least_squares(reduced, rest, G, g)
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
        x = _inequality_least_squares(reduced, rest, G, g)
    else:
        raise InputError(f"stability: the cuts did not settle in {ROUNDS} rounds")
    loss = float(np.linalg.norm(reduced @ x - rest)) / scale
    return Learned(p0 + free @ x, loss, unbound, len(g), float(value.min()))


def compressed(R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As few rows with the same least squares."""
    if len(R) <= R.shape[1] + 1:
        return R, y
    factor = scipy.linalg.qr(np.column_stack([R, y]), mode="r", overwrite_a=True)[0]
    factor = factor[: R.shape[1] + 1]
    return factor[:, :-1], factor[:, -1]


def particular(A: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One solution of A p = a and a basis of those of A p = 0, as columns."""
    if not len(A):
        return np.zeros(A.shape[1]), np.eye(A.shape[1])
    U, size, V = np.linalg.svd(A)
    rank = int((size > DEPENDENT).sum())
    p0 = V[:rank].T @ ((U[:, :rank].T @ a) / size[:rank])
    if np.abs(A @ p0 - a).max() > 1e-6 * max(np.abs(a).max(), 1e-300):
        raise InputError(
            "moduli: no law of this horizon and symmetry has them; a larger horizon or a "
            "smaller symmetry may"
        )
    return p0, V[rank:].T


def _inequality_least_squares(
    R: np.ndarray, y: np.ndarray, G: np.ndarray, g: np.ndarray
) -> np.ndarray:
    """min ‖R x − y‖ with G x ≥ g, by non-negative least squares (Lawson and Hanson, ch. 23)."""
    Q, T = np.linalg.qr(R)
    z = Q.T @ y
    if len(g):
        moved = scipy.linalg.solve_triangular(T, G.T, trans="T").T
        right = g - moved @ z
        size = np.linalg.norm(moved, axis=1)
        moved, right = moved / size[:, None], right / size
        unit = max(float(np.abs(right).max()), 1e-300)
        stacked = np.vstack([moved.T, right / unit])
        last = np.zeros(len(stacked))
        last[-1] = 1.0
        weight, _ = nnls(stacked, last, maxiter=50 * stacked.shape[1])
        left = stacked @ weight - last
        if abs(left[-1]) < 1e-14:
            raise InputError("stability: no law of this horizon and symmetry meets the floor")
        z = z - left[:-1] / left[-1] * unit
    return np.asarray(scipy.linalg.solve_triangular(T, z))
