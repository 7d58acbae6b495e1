"""What one lattice knows of a material: how it answers plane waves (theory.md, M2–M4)."""

from __future__ import annotations

import numpy as np

from warp_peri.lps.model import Model, stiffnesses
from warp_peri.lps.symbol import symbol
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.regression.losses import ReducedLoss, class_pairs, symbol_rows

WAVES = 60
"""Wave vectors that a kernel is fitted on; twice as many change no error in its third digit."""
GOLDEN_ANGLE = np.pi * (1 + np.sqrt(5))
LONG_WAVES, LONGEST = 4, 0.04
"""Directions of very long waves, and their |k| over the largest that is fitted."""
DIRECTIONS = 7
"""Of the waves that an error is looked for in, over an eighth of the circle."""


def wave_vectors(largest: float, count: int = WAVES) -> np.ndarray:
    """Wave vectors [1/Å] of |k| up to `largest`, shape [count, 2].

    |k| is spread evenly, so that long waves weigh as much as short ones; directions go on by the
    golden angle.
    """
    number = np.arange(count) + 0.5
    size, angle = largest * number / count, GOLDEN_ANGLE * number
    return np.stack([size * np.cos(angle), size * np.sin(angle)], axis=1)


def weighed_waves(largest: float, count: int, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Wave vectors [1/Å] as above, and very long ones, with the weights of all in the loss (M3).

    Only the moduli count on the long ones; together they weigh `weight`, the others 1.
    """
    angle = np.linspace(0, np.pi / 4, LONG_WAVES)
    longest = LONGEST * largest * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    k = np.concatenate([wave_vectors(largest, count), longest])
    return k, np.repeat([1 / count, weight / LONG_WAVES], [count, LONG_WAVES])


def rings(sizes: np.ndarray) -> np.ndarray:
    """Wave vectors [1/Å] of the given |k| in DIRECTIONS directions, shape [sizes, DIRECTIONS, 2].

    From an axis to a diagonal of the lattice: by its symmetry that is all of them.
    """
    angle = np.linspace(0, np.pi / 4, DIRECTIONS)
    vectors: np.ndarray = sizes[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return vectors


def dispersion(model: Model, spacing: float, k: np.ndarray) -> np.ndarray:
    """D(k) [TPa/Å²] of a model on a lattice, shape [..., 2, 2], at k [1/Å], shape [..., 2]."""
    classes = bond_classes(spacing, model.horizon)
    d11, d22, d12 = symbol(classes, k.reshape(-1, 2)).entries(*stiffnesses(model, classes))
    entries = np.stack([d11, d12, d12, d22], axis=1)
    return np.asarray(entries.reshape(*k.shape[:-1], 2, 2))


def wave_loss(
    target: np.ndarray, k: np.ndarray, classes: BondClasses, weight: np.ndarray | None = None
) -> ReducedLoss:
    """The loss (M3) of a lattice against D₀(k), shape [K, 2, 2], at wave vectors k, [K, 2].

    Mean over waves and polarisations of |D₀⁻¹ D e − e|²: the square of the relative error of
    displacement, to first order. With weights of the waves, shape [K], their sum instead.
    """
    d11, d22, d12 = symbol_rows(classes, k).transpose(1, 0, 2)
    D = np.stack([d11, d12, d12, d22], axis=1).reshape(len(k), 2, 2, -1)
    answer = np.einsum("kab,kbcf->kacf", np.linalg.inv(target), D)
    wanted = np.broadcast_to(np.eye(2)[..., None], (len(k), 2, 2, 1))
    share = np.full(len(k), 1 / len(k)) if weight is None else weight
    rows = np.sqrt(share / 2)[:, None, None, None] * np.concatenate([answer, -wanted], axis=3)
    factor = np.linalg.qr(rows.reshape(4 * len(k), -1), mode="r")  # few waves, few rows
    return ReducedLoss(classes, np.asarray(factor), class_pairs(len(classes.r)))


def wave_errors(answer: np.ndarray, target: np.ndarray) -> np.ndarray:
    """‖D⁻¹ D₀ − I‖₂ at wave vectors, shape [..., 2, 2] to [...] (M4).

    The largest relative error of displacement under a load at that wave vector.
    """
    errors: np.ndarray = np.linalg.norm(
        np.linalg.solve(answer, target) - np.eye(2), ord=2, axis=(-2, -1)
    )
    return errors
