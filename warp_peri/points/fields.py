"""Fields on nodes: loads of many waves, wave numbers, strains."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.points.arguments import Count, Natural, Positive, checked, typed
from warp_peri.points.families import neighbour_table
from warp_peri.points.points import WAVE_VECTOR, PointsLike, Samples, nodes_of


@typed
def mixed_waves(
    x: np.ndarray, box: tuple[float, ...] | np.ndarray, shortest: Positive, *, seed: Natural = 0
) -> np.ndarray:
    """Σ |k| e cos(k·x + φ) over the waves of a period with |k| ≤ 2π/shortest (theory, Q11).

    Args:
        x: positions [length], shape [N, 2].
        box: periods along the axes [length].
        shortest: the shortest wave [length].
        seed: of the phases φ and the directions e.

    Returns:
        A field [N, 2] without mean, to be scaled to what the atoms bear.

    Raises InputError for a wave that is longer than the periods.
    """
    random, box = np.random.default_rng(seed), np.asarray(box, dtype=float)
    if not shortest <= box.max():
        raise InputError(f"shortest wave: expected one in a box of {box}, got {shortest!r:.40}")
    most = int(box.max() / shortest) + 1
    field = np.zeros(np.shape(x))
    for number in np.ndindex(most + 1, 2 * most + 1):
        n = np.array(number) - (0, most)
        k = 2 * np.pi * n / box
        size = float(np.linalg.norm(k))
        if (n[0] == 0 and n[1] <= 0) or size > 2 * np.pi / shortest:  # −k is the same wave
            continue
        angle, phase = random.uniform(0, 2 * np.pi, 2)
        along = np.array([np.cos(angle), np.sin(angle)])
        field += size * np.cos(x @ k + phase)[:, None] * along
    return np.asarray(field - field.mean(axis=0))


@typed
def design_loads(points: PointsLike, shortest_wave: Positive, *, number: Count = 2) -> np.ndarray:
    """Loads that a material is learned from in place of many single waves.

    One does for a fit whose moduli are held, two for one that finds them. Give each to the atoms
    and its reverse: what their answers have of even order then cancels, which few loads do not
    average.

    Args:
        points: of a periodic body, as Points.sheet or Points(…, box=…); atoms or nodes.
        shortest_wave: [length]; twice the horizon or less, and no shorter than four nodes apart.
        number: of loads.

    Returns:
        Loads without mean, shape [number, N, 2], largest vector 1: scale them to what is bearable.

    Raises InputError for points without a box, and a wave longer than it.
    """
    if points.box is None:
        raise InputError("points: expected a periodic body, with its box, for designed loads")
    fields = [mixed_waves(points.x, points.box, shortest_wave, seed=s) for s in range(number)]
    return np.stack([f / np.linalg.norm(f, axis=1).max() for f in fields])


def largest_wave_number(points: Samples) -> float | None:
    """Largest |k| [1/Å] of the samples' loads; None on scattered points or without loads.

    Of loads at wave vectors their own; of others the root mean square of |k| over the spectrum of
    b, from differences of neighbouring nodes (theory, M1).
    """
    if WAVE_VECTOR in points.arrays:
        k = checked(WAVE_VECTOR, points.arrays[WAVE_VECTOR])
        return float(np.linalg.norm(k, axis=-1).max(initial=0.0)) or None
    h = points.spacing
    if h == 0 or points.b is None:
        return None
    r, near = cKDTree(points.x).query(points.x, k=min(5, len(points.x)))
    whole = points.interior & (r <= 1.1 * h).all(axis=1) & (near.shape[1] == 5)
    near = near[whole, 1:]
    largest = 0.0
    for b in points.b:
        size = (b[whole] ** 2).sum()
        if size > 0:
            s = ((b[near] - b[whole, None]) ** 2).sum() / (2 * h**2 * size)
            # of all directions on average s = |k|² − |k|⁴ h²/16
            largest = max(largest, (1 - np.sqrt(max(1 - s * h**2 / 4, 0.0))) * 8 / h**2)
    return float(np.sqrt(largest)) or None


def largest_strain(points: PointsLike, u: ArrayLike) -> float:
    """Largest |ξ·(u_j − u_i)|/r² between nodes and their nearest neighbours.

    On a lattice those across the diagonals of a square count too: shear along the axes stretches no
    other bond.

    Args:
        points: a lattice or scattered points; nodes outside the body do not count.
        u: displacement [Å], shape [N, d] or [S, N, d].
    """
    body = np.ones(len(points.x), bool) if points.outside is None else ~points.outside
    x, d = points.x[body], points.x.shape[1]
    if points.spacing > 0 and len(points.x) > 1:
        steps = np.array(list(itertools.product((-1, 0, 1), repeat=d)))
        steps = steps[np.isin((steps**2).sum(axis=1), (1, 2))]
        table = neighbour_table(nodes_of(points).lattice.steps[body], steps[len(steps) // 2 :])
        near = np.where(table < 0, np.arange(len(x))[:, None], table)  # each bond once
    else:
        count = min(2 * d + 1, len(x))
        near = cKDTree(x).query(x, k=count)[1].reshape(-1, count)[:, 1:]
    xi = x[near] - x[:, None]
    square = (xi**2).sum(axis=-1)
    unit = xi / np.where(square > 0, square, np.inf)[..., None]
    fields = np.asarray(u).reshape(-1, *points.x.shape)[:, body]
    along = (np.abs((unit * (one[near] - one[:, None])).sum(axis=-1)) for one in fields)
    return max((float(one.max(initial=0)) for one in along), default=0.0)


def edge_strain(x: np.ndarray, triangles: np.ndarray, u: np.ndarray) -> float:
    """As largest_strain, between the ends of the edges of triangles.

    Args:
        x: corners [Å], shape [P, 2].
        triangles: their corners, shape [T, 3].
        u: displacement of the corners [Å], shape [P, 2].
    """
    after = np.roll(triangles, -1, axis=1)
    xi, relative = x[after] - x[triangles], u[after] - u[triangles]
    along = (xi * relative).sum(axis=-1) / (xi**2).sum(axis=-1)
    return float(np.abs(along).max(initial=0.0))
