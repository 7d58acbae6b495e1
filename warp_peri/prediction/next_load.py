"""Which loads tell most, designed or next (theory, Q11)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import null_space

from warp_peri.contract import offered
from warp_peri.core.elastic import bracket_rows, huang_rows
from warp_peri.core.stencil import Basis, invariant_basis
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.regression import rows
from warp_peri.micromodulus.waves import wave_rows
from warp_peri.points.arrays import is_positive
from warp_peri.points.samples import PointsLike, Samples, part
from warp_peri.transfer.lattice import dispersion, wave_vectors


def mixed_waves(
    x: np.ndarray, box: tuple[float, ...] | np.ndarray, shortest: float, *, seed: int = 0
) -> np.ndarray:
    """Σ |k| e cos(k·x + φ) over the waves of a period with |k| ≤ 2π/shortest (theory, Q10).

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
    if not (is_positive(shortest) and shortest <= box.max()):
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


def design_loads(points: PointsLike, shortest_wave: float, *, number: int = 2) -> np.ndarray:
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


WAVES = np.pi / 2
"""Largest |k| h of the waves whose answers are the quantity by default."""
NUMBER_STEP = 1e-5
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

    return [(moved(by, NUMBER_STEP), moved(by, -NUMBER_STEP)) for by in moves]


def _slope(quantity: Quantity, pair: tuple[Model, Model]) -> np.ndarray:
    """Of a quantity, to a number in units of its scale, flat."""
    ahead, behind = (np.ravel(quantity(one)) for one in pair)
    return np.asarray(ahead - behind) / (2 * NUMBER_STEP)


RESIDUAL = 0.02
"""Relative residual of a load that is taken for one standard deviation where none is known."""
GUESSED = 4
"""Loads that this guess counts for beside those that cross-validation sees."""
ROUNDS = 5
"""Of finding that residual, which the prior alone makes depend on itself."""
STEP = 1e-4
"""Of a number, relative to the largest, in the slope of a quantity."""
KINDS = "a crystal model or a linear peridynamic solid"


@dataclass(frozen=True)
class NextLoad:
    """What a pool offers.

    Attributes:
        number: of the candidate that leaves the least uncertainty.
        deviation: of the quantity after each candidate, root mean square of its entries, [S].
        before: the same without any.
        residual: relative residual of a load that the deviations are made with; of the known loads
            by cross-validation.
    """

    number: int
    deviation: np.ndarray
    before: float
    residual: float


def next_load(
    material: Any,
    candidates: Samples,
    quantity: Quantity | None = None,
    *,
    known: Samples | None = None,
) -> NextLoad:
    """The load to simulate next: the one that leaves a quantity least uncertain (A-optimal).

    Args:
        material: a crystal's law, as fit(samples, Micromodulus(…)) learns it, or a linear
            peridynamic solid of a sheet, from few loads or guessed; its answers stand for the
            candidates' own.
        candidates: loads; of periodic points nothing else is read, of others also u on the collar.
        quantity: of a material, numbers; by default its answers to waves down to four spacings.
        known: what was learned from, at least three loads calibrate the deviations.

    Raises InputError for another law, and samples that do not carry its horizon.
    """
    tensors = hasattr(material, "tensors")
    if not tensors:
        offered(material, "influence_dilatation", "next_load", KINDS)
    slopes, prior, information = (_of_tensors if tensors else of_solid)(material, quantity)
    told_by, _ = information(_answered(material, candidates))
    before, residual = prior, RESIDUAL
    if known is not None and len(known):
        told, pull = information(known)
        before = prior + told.sum(axis=0) / residual**2
        if len(known) > 2:
            seen, count = calibrated(told, pull, prior, slopes), len(known)
            residual = np.sqrt((GUESSED * RESIDUAL**2 + count * seen**2) / (GUESSED + count))
            before = prior + told.sum(axis=0) / residual**2
    after = [deviation(before + each / residual**2, slopes) for each in told_by]
    return NextLoad(
        int(np.argmin(after)), np.array(after), deviation(before, slopes), float(residual)
    )


def deviation(information: np.ndarray, slopes: np.ndarray) -> float:
    """Root mean square deviation of a quantity of those slopes [n, P] (Q12)."""
    square = np.trace(slopes @ np.linalg.solve(information, slopes.T))
    return float(np.sqrt(square / len(slopes)))


def calibrated(told: np.ndarray, pull: np.ndarray, prior: np.ndarray, slopes: np.ndarray) -> float:
    """The relative residual with which leaving loads out moves a quantity as foretold (Q13).

    Args:
        told, pull: information and right-hand side of each load at a residual of one.
        prior: information without any.
        slopes: of the quantity.
    """
    residual, square, right = RESIDUAL, slopes.T @ slopes, pull.sum(axis=0)
    for _ in range(ROUNDS):
        whole = prior * residual**2 + told.sum(axis=0)
        without = np.linalg.inv(whole - told)
        moved = np.einsum("sij,sj->si", without, right - pull) - np.linalg.solve(whole, right)
        foretold = np.einsum("sij,ij->", without - np.linalg.inv(whole), square)
        residual = float(np.sqrt(np.einsum("si,ij,sj->", moved, square, moved) / foretold))
    return residual


def _of_tensors(material: Crystal, quantity: Quantity | None) -> Told:
    """Slopes of a quantity, the prior, and what loads tell, in the directions that are free."""
    bonds = invariant_basis(material.horizon / material.spacing, material.group)
    free, p = _coordinates(material, bonds), _numbers(material, bonds)
    if quantity is None:
        waves, _ = wave_rows(material.symbol, material.spacing, bonds, material.group, WAVES)
        slopes = waves @ free / material.spacing**2
    else:
        slopes = _slopes(material, bonds, free, quantity)
    prior = np.eye(free.shape[1]) / float((p**2).mean())
    return slopes, prior, lambda samples: _information(samples, bonds, free, p)


def _numbers(material: Crystal, bonds: Basis) -> np.ndarray:
    """p of a law, in units of stress."""
    basis = bonds.basis.reshape(len(bonds.basis), -1)
    if not np.array_equal(bonds.steps, material.steps):
        raise InputError("next_load: expected a model on a whole ball of bonds")
    tensors = material.tensors.ravel() * material.spacing**2
    return np.asarray(np.linalg.lstsq(basis.T, tensors, rcond=None)[0])


def _coordinates(material: Crystal, bonds: Basis) -> np.ndarray:
    """Directions that p may move in: moduli stay where they were held, [P, F]."""
    held = dict(material.provenance.get("fit", {})).get("moduli_held", False)
    asked = (bracket_rows if held else huang_rows)(bonds.moments())
    return np.asarray(null_space(asked / np.abs(bonds.moments()).max(), rcond=1e-8))


def _slopes(material: Crystal, bonds: Basis, free: np.ndarray, quantity: Quantity) -> np.ndarray:
    """Of a quantity, by central differences, [n, F]."""
    step = STEP * float(np.abs(_numbers(material, bonds)).max())

    def at(change: np.ndarray) -> np.ndarray:
        moved = np.tensordot(change, bonds.basis, 1) / material.spacing**2
        return np.ravel(quantity(replace(material, tensors=material.tensors + moved)))

    return np.stack([(at(step * z) - at(-step * z)) / (2 * step) for z in free.T], axis=1)


def _answered(material: Any, candidates: Samples) -> Samples:
    """The candidates with the answers of the material."""
    operator, b = material.on(candidates.points), candidates.loads
    periodic = candidates.points.box is not None
    found = operator.rest_periodic(b) if periodic else operator.rest(b, candidates.u)
    return replace(candidates, u=np.asarray(found.u))


def _information(
    samples: Samples, bonds: Basis, free: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """RᵗR and Rᵗ(y − R p) of each load over ‖b‖², its residual counted as one number (Q11)."""
    told, pull = [], []
    for n in range(len(samples)):
        R, y = rows(part(samples, slice(n, n + 1)), bonds, normalise=True)
        R = R / samples.spacing**2
        told.append(free.T @ R.T @ R @ free)
        pull.append(free.T @ R.T @ (y - R @ p))
    return np.array(told), np.array(pull)
