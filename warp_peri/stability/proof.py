"""Proven bounds of the symbol over the whole Brillouin zone (theory.md, 32–35 and 50).

Of Λmin D(k)/s(k) from below, and of Λmax D(k) from above.

Near k = 0 by a Taylor remainder, elsewhere cell by cell: D(k) − c s(k) is at least its affine part
at the middle of the cell minus half the largest second derivative times the distance squared, and
the smallest eigenvalue of an affine matrix function is concave, hence smallest at a corner; the
largest is convex, hence largest at a corner.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from warp_peri.launch import in_blocks
from warp_peri.operator.symbol import long_wave_moduli, symbol
from warp_peri.points.families import BondClasses

FRACTIONS = (0.99, 0.95, 0.9, 0.75, 0.5, 0.25, 0.1, 0.01)
"""Fractions of the sampled minimum that are tried, largest first."""

FIRST_CELLS = 16
CORNERS = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
AT_ONCE = 100
"""Cells of a block, of which ranks share many."""
MOST_CELLS = 400_000
"""Work after which a bound is given up; halved cells cost four times as much."""
UPPER_TOLERANCE = 1e-3
"""How far the proven upper bound of D may be above a value that D takes, relative."""
ROUNDING = 1e-11
"""Set aside for rounding, relative to the largest Γ."""


def proven_bound(
    classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float, sampled: float
) -> float:
    """Largest tried c with a proof that D(k) ≥ c s(k) for every k; 0 when none was found.

    Args:
        classes: bond classes of the lattice.
        v, z, kappa: stiffnesses [TPa/Å²] and κ [1/TPa] of the symbol.
        sampled: smallest ratio found by sampling [TPa]; nothing above it is tried.
    """
    if not sampled > 0:
        return 0.0
    for fraction in FRACTIONS:
        if _holds(classes, v, z, kappa, fraction * sampled):
            return fraction * sampled
    return 0.0


def taylor_radius(
    classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float, c: float
) -> float:
    """Radius |k| [1/Å] inside which the long-wave moduli prove D ≥ c s; 0 if they do not (33)."""
    least = slowest(*long_wave_moduli(classes, v, kappa))
    mu = classes.count @ (v * classes.r**2)
    fourth_v, fourth_z = (classes.count @ (np.abs(x) * classes.r**4) for x in (v, z))
    # least − c − a k² − b k⁴ ≥ 0
    a = 2 / 3 * (fourth_v + abs(kappa * mu) * fourth_z)
    b = abs(kappa) * fourth_z**2 / 9
    if least <= c:
        return 0.0
    square = (-a + np.sqrt(a**2 + 4 * b * (least - c))) / (2 * b) if b > 0 else (least - c) / a
    return float(np.sqrt(square))


def slowest(C11: float, C12: float, C44: float) -> float:
    """Smallest eigenvalue of the acoustic tensor over all directions.

    Its trace does not depend on the direction and its determinant is linear in n₁²n₂², so that
    the smallest value is along an axis or a diagonal.
    """
    trace = C11 + C44
    along_axis = C11 * C44
    on_diagonal = along_axis + ((C11 - C44) ** 2 - (C12 + C44) ** 2) / 4
    determinant = min(along_axis, on_diagonal)
    return trace / 2 - math.sqrt(max(trace**2 / 4 - determinant, 0.0))


def second_derivative(classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float) -> float:
    """Bound of |d²/dt² eᵗD(k + t n)e| over unit e, n and all k [TPa] (34)."""
    second_v = classes.count @ (np.abs(v) * classes.r**2)
    first, second, third = (classes.count @ (np.abs(z) * classes.r**power) for power in (1, 2, 3))
    # eᵗφ, its first and its second derivative; the second moments of an orbit are isotropic.
    value, slope, bend = 2 * first, second, 2 * third
    return float(8 * second_v + 2 * abs(kappa) * (value * bend + slope**2))


def _holds(classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float, c: float) -> bool:
    """Whether D(k) ≥ c s(k) is proven for all k, by cells that are halved where they fail."""
    edge = np.pi / classes.spacing
    ball = taylor_radius(classes, v, z, kappa, c)
    if ball == 0:
        return False
    curvature = second_derivative(classes, v, z, kappa) + 2 * c  # |s″| ≤ 2
    slack = ROUNDING * 32 * (classes.count @ np.abs(v))
    half = edge / FIRST_CELLS / 2
    middle = np.stack(np.tril_indices(FIRST_CELLS), axis=1) * 2 * half + half
    work = 0

    def cells(half: float, k: np.ndarray) -> np.ndarray:
        return lowest(*affine_part(classes, v, z, kappa, c, k), half)

    while len(middle):
        outside = np.hypot(*(middle + half).T) > ball
        middle = middle[outside]
        work += len(middle)
        if work > MOST_CELLS:
            return False
        bound = in_blocks(partial(cells, half), middle, AT_ONCE)
        failed = bound - curvature * half**2 - slack <= 0  # ½ · curvature · (√2 half)²
        if not failed.any():
            return True
        half /= 2
        middle = (middle[failed][:, None, :] + half * CORNERS).reshape(-1, 2)
        middle = middle[middle[:, 0] + 2 * half >= middle[:, 1]]  # the wedge k₂ ≤ k₁
    return True


def lowest(d: np.ndarray, slopes: np.ndarray, half: float) -> np.ndarray:
    """The smallest eigenvalue of affine matrices over square cells, at their corners, shape [K].

    Args:
        d, slopes: as `affine_part` gives them at the middles.
        half: half the side of a cell [1/length].
    """
    bound = np.full(d.shape[1], np.inf)
    for corner in half * CORNERS:
        e11, e22, e12 = d + np.einsum("a,aek->ek", corner, slopes)
        bound = np.minimum(bound, (e11 + e22) / 2 - np.hypot((e11 - e22) / 2, e12))
    return bound


def affine_part(
    classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float, c: float, k: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Entries 11, 22, 12 of D − c s, shape [3, K], and their derivatives to k, [2, 3, K]."""
    table = symbol(classes, k)
    d = np.array(table.entries(v, z, kappa))
    d[:2] -= c * table.laplacian
    phi = (table.phi @ z).T
    xi, stiff, soft = classes.xi, v[classes.bond_class], z[classes.bond_class]
    phase = k @ xi.T
    sin, cos = np.sin(phase), np.cos(phase)
    products = np.stack([xi[:, 0] ** 2, xi[:, 1] ** 2, xi[:, 0] * xi[:, 1]]) / (xi**2).sum(1)
    slopes = np.empty((2, 3, len(k)))
    for a in (0, 1):
        slopes[a] = 16 * (products * stiff * xi[:, a]) @ sin.T
        dphi = 2 * (xi * (soft * xi[:, a])[:, None]).T @ cos.T
        slopes[a, 0] += 2 * kappa * phi[0] * dphi[0]
        slopes[a, 1] += 2 * kappa * phi[1] * dphi[1]
        slopes[a, 2] += kappa * (phi[0] * dphi[1] + phi[1] * dphi[0])
        slopes[a, :2] -= c * 2 / classes.spacing * np.sin(k[:, a] * classes.spacing)
    return d, slopes


def largest_bound(
    classes: BondClasses,
    v: np.ndarray,
    z: np.ndarray,
    kappa: float,
    *,
    tolerance: float = UPPER_TOLERANCE,
) -> float:
    """An upper bound of Λmax D(k) over all k [TPa/Å²], proven cell by cell (theory.md, 50).

    Within `tolerance`, relative, of a value that D takes, unless that needs more than MOST_CELLS;
    then it is what was proven so far. In space it is (V6), which is not sharp.
    """
    if classes.steps.shape[1] == 3:
        long = classes.count * np.abs(z)
        bulk = 3 * max(kappa, 0.0) * long.sum() * (long @ classes.r**2)
        return float(20 * (classes.count @ np.maximum(v, 0.0)) + bulk)
    half = np.pi / classes.spacing / FIRST_CELLS / 2
    middle = np.stack(np.tril_indices(FIRST_CELLS), axis=1) * 2 * half + half
    taken, work = 0.0, 0
    while True:
        values, bound = _cells_above(classes, v, z, kappa, middle, half)
        taken = max(taken, float(values.max()))
        still = bound > (1 + tolerance) * taken
        work += len(middle)
        if not still.any():
            return (1 + tolerance) * taken
        if work > MOST_CELLS:
            return float(bound.max())
        half /= 2
        middle = (middle[still][:, None, :] + half * CORNERS).reshape(-1, 2)
        middle = middle[middle[:, 0] + 2 * half >= middle[:, 1]]  # the wedge k₂ ≤ k₁


def _cells_above(
    classes: BondClasses,
    v: np.ndarray,
    z: np.ndarray,
    kappa: float,
    middle: np.ndarray,
    half: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Λmax D at the middle of square cells, and its bound over each cell (50); shape [K] each."""
    d, slopes = affine_part(classes, v, z, kappa, 0.0, middle)
    values = []
    for shift in half * np.vstack([[0, 0], CORNERS]):
        e11, e22, e12 = d + np.einsum("a,aek->ek", shift, slopes)
        values.append((e11 + e22) / 2 + np.hypot((e11 - e22) / 2, e12))
    curvature = second_derivative(classes, v, z, kappa)
    slack = ROUNDING * 32 * (classes.count @ np.abs(v))
    # ½ · curvature · (√2 half)²
    return values[0], np.max(values, axis=0) + curvature * half**2 + slack
