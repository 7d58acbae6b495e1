"""Loads that hold every wave of a periodic body at once (theory, Q11)."""

from __future__ import annotations

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arguments import Count, Natural, Positive, typed
from warp_peri.points.samples import PointsLike


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
