"""Rows of a fit to the waves of another solid: errors of displacement (theory, T9, M3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warp_peri.core.elastic import directions, orbit_grid
from warp_peri.core.stencil import Basis
from warp_peri.fitting.rows import compressed

WaveSymbol = Callable[[np.ndarray], np.ndarray]
"""k [K, d] along the nodes' axes to D(k) [K, d, d] [stress/length²]."""
WAVES, LARGEST_WAVE = 400, 2.0
"""Waves that a symbol is matched on, and their largest |k| h."""
LONG_WAVES, LONGEST, LONG_WEIGHT = 30, 0.02, 4.0
"""Long waves among the rows, their |k| h, and what they weigh together."""
ZONE_INTERVALS, ZONE_WEIGHT = {2: 12, 3: 10}, 0.1
"""Of a grid on the rest of the zone."""


def wave_rows(
    target: WaveSymbol,
    spacing: float,
    bonds: Basis,
    group: np.ndarray,
    largest_wave: float = LARGEST_WAVE,
) -> tuple[np.ndarray, np.ndarray]:
    """R and y of p = C h² [stress] against D₀(k): waves up to the largest |k| h, long ones, and
    lightly the rest of the zone."""
    d, number = bonds.dimension, np.arange(WAVES)
    size = largest_wave * (0.02 + 0.98 * ((number * 0.6180339887) % 1))
    grid = orbit_grid(ZONE_INTERVALS[d], group, d)
    blocks = (
        (size[:, None] * directions(WAVES, d), 1.0),
        (LONGEST * directions(LONG_WAVES, d), np.sqrt(LONG_WEIGHT)),
        (grid[np.linalg.norm(grid, axis=1) > largest_wave], ZONE_WEIGHT),
    )
    phase = np.concatenate([waves for waves, _ in blocks])
    each = [np.full(len(waves), weight / max(len(waves), 1) ** 0.5) for waves, weight in blocks]
    D = target(phase / spacing) * spacing**2
    return compressed(*waves_against(D, phase, bonds, np.concatenate(each)))


def waves_against(
    target: np.ndarray, phase: np.ndarray, bonds: Basis, share: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """R and y of ‖D₀⁻¹ D e − e‖ over polarisations e of single waves.

    Args:
        target: D₀ in the units of the symbol of the basis, shape [K, d, d].
        phase: k h, shape [K, d].
        share: weight of each wave, shape [K].
    """
    rows = np.linalg.inv(target)[:, None] @ bonds.symbol(phase)
    right = np.broadcast_to(np.eye(bonds.dimension), target.shape) * share[:, None, None]
    rows = rows.transpose(0, 2, 3, 1) * share[:, None, None, None]
    return rows.reshape(-1, rows.shape[-1]), right.ravel()


def wave_errors(answer: np.ndarray, target: np.ndarray) -> np.ndarray:
    """‖D⁻¹ D₀ − I‖₂ at wave vectors, shape [..., d, d] to [...] (theory, M4).

    The largest relative error of displacement under a load at that wave vector.
    """
    wrong = np.linalg.solve(answer, target) - np.eye(answer.shape[-1])
    return np.asarray(np.linalg.norm(wrong, ord=2, axis=(-2, -1)))


def carried_symbol(symbol: WaveSymbol, spacing: float, turn: np.ndarray) -> WaveSymbol:
    """D(k) of a solid on nodes of a spacing, turned on them, for k of any other nodes.

    Beyond the zone of coarser nodes their symbol repeats; the local limit goes on there.
    """

    def carried(k: np.ndarray) -> np.ndarray:
        size = np.linalg.norm(k, axis=1, keepdims=True)
        part = np.minimum(1.0, LARGEST_WAVE / np.maximum(size * spacing, 1e-300))
        D = symbol(part * k @ turn) / part[:, :, None] ** 2
        return np.asarray(turn @ D @ turn.T)

    return carried
