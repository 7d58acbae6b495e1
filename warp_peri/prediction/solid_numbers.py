"""What loads tell of the numbers of a linear peridynamic solid, near those it has (Q11)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.samples import Samples
from warp_peri.transfer.waves import dispersion, wave_vectors

WAVES = np.pi / 2
"""Largest |k| h of the waves whose answers are the quantity by default."""
STEP = 1e-5
"""Of a number, relative to the shear modulus or to the influence function, in a slope."""

Quantity = Callable[[Any], Any]
Told = tuple[np.ndarray, np.ndarray, Callable[[Samples], tuple[np.ndarray, np.ndarray]]]
"""Slopes of a quantity [n, P], information without loads [P, P], and of samples the information
[S, P, P] and right-hand side [S, P] of each at a residual of one."""


def of_solid(material: Model, quantity: Quantity | None) -> Told:
    """The same by central differences at λ, μ and the coefficients of the influence functions.

    Args:
        material: a sheet, learned on one lattice.
        quantity: of a material; by default its answers to waves down to four spacings.

    Raises InputError for a solid in space, and one that no lattice is stated of.
    """
    spacings = material.trained_on or material.certified_on
    if material.dimension != 2 or not spacings:
        raise InputError("next_load: expected a solid of a sheet that states its lattice")
    h, pairs = float(spacings[0]), varied(material)
    if quantity is None:
        k = wave_vectors(WAVES / h)
        home = np.linalg.inv(dispersion(material, h, k))

        def quantity(one: Model) -> np.ndarray:
            return np.asarray(home @ dispersion(one, h, k))

    slopes = np.stack([_slope(quantity, pair) for pair in pairs], axis=1)
    count = len(pairs)

    def information(samples: Samples) -> tuple[np.ndarray, np.ndarray]:
        load = samples.loads[:, samples.interior].reshape(len(samples), -1)

        def force(one: Model) -> np.ndarray:
            with warnings.catch_warnings(action="ignore"):
                placed = one.on(samples.points, allow_uncertified=True)
            return np.asarray(placed(samples.u)).reshape(len(samples), -1)

        size = np.maximum(np.linalg.norm(load, axis=1), 1e-300)[:, None]
        wrong = (load - force(material)) / size
        R = np.stack([_slope(force, pair).reshape(wrong.shape) / size for pair in pairs], axis=-1)
        return np.einsum("sip,siq->spq", R, R), np.einsum("sip,si->sp", R, wrong)

    return slopes, np.eye(count), information


def varied(material: Model) -> list[tuple[Model, Model]]:
    """The solid with each of its numbers a step larger and smaller."""
    same = np.array_equal(material.D, material.dilatation)
    kernels = [("D", "D_dilatation")] if same else [("D",), ("D_dilatation",)]
    moves: list[dict[str, Any]] = [{"lam": material.mu}, {"mu": material.mu}]
    for names in kernels:
        D = getattr(material, names[0])
        unit = np.sqrt((D**2).mean()) * np.eye(len(D))
        moves += [dict.fromkeys(names, one) for one in unit]

    def moved(by: dict[str, Any], step: float) -> Model:
        return replace(material, **{n: getattr(material, n) + step * v for n, v in by.items()})

    return [(moved(by, STEP), moved(by, -STEP)) for by in moves]


def _slope(quantity: Quantity, pair: tuple[Model, Model]) -> np.ndarray:
    """Of a quantity, to a number in units of its scale, flat."""
    ahead, behind = (np.ravel(quantity(one)) for one in pair)
    return np.asarray(ahead - behind) / (2 * STEP)
