"""How sure a fit is: covariance of what noise in the displacement makes of it (theory.md, 39).

Noise moves the gradient of the loss; the optimum follows by the Gauss–Newton Hessian within the
tangent space of the active conditions. Fields of noise, put on every sample in turn, give the
covariance of the gradient, and their independence from one seed to the next adds it up.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.special import ndtri

from warp_peri.errors import InputError
from warp_peri.learning.output_error import as_model
from warp_peri.learning.response import WaveResponse, products
from warp_peri.learning.result import Fit
from warp_peri.losses.full import sample_weights
from warp_peri.losses.noise import check_noise, corrected, noise_loss
from warp_peri.losses.reduced import Features, ReducedLoss, reduce
from warp_peri.models.lps import Model
from warp_peri.operator.symbol import symbol
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.points.wave_number import WAVE_VECTOR
from warp_peri.regression.optimum import Problem, coordinates_of
from warp_peri.regression.parameters import Parameters
from warp_peri.stability.conditions import ZoneSearch

ACTIVE = 0.02
"""A condition is active where its margin is below this part of ζ."""
SAME = 1e-3
"""Conditions at neighbouring wave vectors whose gradients differ by less than this are one."""
SMALLER = (1.0, 0.25, 0.05, 0.01, 1e-3, 1e-5)
"""Parts of a standard deviation that are tried, one after the other."""
PULLED = 0.3
"""Bias in standard deviations that is warned about; a 90 % band then covers 87 %."""
DETERMINED = 1e-9
"""Directions in which the data bend the loss less than this of the most do not count."""


@dataclass(frozen=True)
class Uncertainty:
    """Models to either side of a fit, along independent directions of its covariance.

    Attributes:
        pairs: models above and below, and how many standard deviations they are off: one, or less
            where that far no solid is left.
    """

    pairs: list[tuple[Model, Model, float]]

    def deviation(self, quantity: Callable[[Model], np.ndarray | float]) -> np.ndarray:
        """Standard deviation of anything a model determines, of the shape of the quantity."""
        total: np.ndarray | float = 0.0
        for above, below, off in self.pairs:
            total = total + ((np.asarray(quantity(above)) - quantity(below)) / (2 * off)) ** 2
        return np.sqrt(total)

    def band(
        self, model: Model, quantity: Callable[[Model], np.ndarray | float], level: float = 0.9
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of the band that holds a quantity with probability `level`."""
        if not 0 < level < 1:
            raise InputError(f"level: expected a probability between 0 and 1, got {level}")
        half = ndtri((1 + level) / 2) * self.deviation(quantity)
        middle = np.asarray(quantity(model))
        return middle - half, middle + half


def fit_uncertainty(
    found: Fit, points: Samples | Sequence[Samples], noise: Samples | Sequence[Samples]
) -> Uncertainty:
    """What noise makes of a fit.

    Samples of one `seed` (an array of the set) carry the same noise; without it each carries its
    own. Bands hold noise alone, no error of the model. Those of the output-error loss are
    calibrated, those of "corrected" are rough (docs/noise.md). Noise pulls the "residual" loss to
    one side, by more than its bands are wide unless there is next to none: a warning says how far.

    Args:
        found: the fit, by any loss except "output" on loads that are not single waves.
        points: the training sets that it learned from, in that order.
        noise: fields of noise alone for each, two at least.

    Raises InputError for data that the fit cannot have learned from, or for a loss "output" on
    loads that are not single waves.
    """
    model, settings = found.model, found.settings
    sets, fields = _sets_and_noise(points, noise, len(settings.conditions))
    weights = sample_weights(sets, normalise=settings.normalise)
    losses = [_linearised(found.loss.name, model, *each) for each in zip(sets, fields, weights)]
    own = model.dilatation if settings.two_functions else None
    numbers = (model.lam, model.mu, model.alpha, model.D)
    optimum = Parameters(*numbers, D_dilatation=own, shape=found.influence)
    lattices = [loss.classes for loss in losses]
    coordinates = coordinates_of(lattices, optimum, two_functions=settings.two_functions)
    problem = Problem(losses, settings.conditions, coordinates, settings.moduli)
    y = coordinates.start(optimum)
    pushes = []
    slopes = problem.product_slopes(coordinates.point(y))
    for samples, unloaded, weight, slope in zip(sets, fields, weights, slopes):
        if found.loss.name == "output":
            pushes.append(_response_pushes(model, samples, unloaded, slope))
        else:
            pushes.append(
                _residual_pushes(model, samples, unloaded, weight, slope, found.loss.name)
            )
    follow = _compliance(problem, y)
    axes, deviation, _ = np.linalg.svd(follow @ np.concatenate(pushes, axis=1))
    if found.loss.name == "residual":
        pull = sum(_pull(model, *each) for each in zip(sets, fields, weights, slopes))
        _warn_of_bias(axes.T @ (follow @ pull), deviation)

    def beside(step: np.ndarray) -> tuple[Model, Model, float]:
        for off in SMALLER:
            try:
                above, below = (
                    as_model(coordinates.parameters(y + sign * off * step, []), model.horizon)
                    for sign in (1, -1)
                )
            except InputError:  # μ or λ + μ is not above zero there
                continue
            return above, below, off
        raise InputError("noise: it is so strong that nothing can be said of this fit")

    steps = (axes[:, : len(deviation)] * deviation).T[deviation > 1e-12 * deviation[0]]
    return Uncertainty([beside(step) for step in steps])


def _compliance(problem: Problem, y: np.ndarray) -> np.ndarray:
    """How far the optimum moves against a gradient, −dy by gradient, shape [Y, Y]."""
    free = _tangent(problem, y)
    size, right = np.linalg.svd(problem.slopes(y, problem.coordinates.point(y)) @ free)[1:]
    kept = size > DETERMINED * size[0]
    follow = free @ (right[: len(size)][kept].T / (2 * size[kept] ** 2))
    moved: np.ndarray = follow @ right[: len(size)][kept] @ free.T
    return moved


def _pull(
    model: Model, points: Samples, noise: Samples, weight: np.ndarray, slope: np.ndarray
) -> np.ndarray:
    """Mean gradient of what noise adds to the residual loss, ‖R_e c‖² of (36)."""
    R = noise_loss(noise, points, model.horizon, weight)
    c = products(model, bond_classes(points.spacing, model.horizon))
    gradient: np.ndarray = 2 * (R @ slope).T @ (R @ c)
    return gradient


def _warn_of_bias(bias: np.ndarray, deviation: np.ndarray) -> None:
    """Warn when noise pulls a fit by what its bands do not hold, in standard deviations."""
    known = deviation > 1e-12 * deviation[0]
    off = np.abs(bias[: len(deviation)][known]) / deviation[known]
    if off.max(initial=0.0) > PULLED:
        warnings.warn(
            f"loss: noise pulls a fit by 'residual' to one side, here by {off.max():.2g} standard "
            "deviations: its bands do not hold the truth; fit with loss='corrected' or 'output'",
            stacklevel=3,
        )


def _linearised(
    loss: str, model: Model, points: Samples, noise: Samples, weight: np.ndarray
) -> ReducedLoss:
    """The loss that the fit minimised, about its model."""
    if loss == "output":
        if WAVE_VECTOR not in points.arrays:
            raise InputError(f"loss: with 'output' expected loads with their {WAVE_VECTOR}")
        return WaveResponse(points, model.horizon).about(model)
    grid = reduce(points, model.horizon, weight)
    if loss == "residual":
        return grid
    return corrected(grid, noise_loss(noise, points, model.horizon, weight))


def _response_pushes(
    model: Model, points: Samples, noise: Samples, slope: np.ndarray
) -> np.ndarray:
    """Gradients of the output-error loss by noise: columns whose outer products add up to Cov."""
    response = WaveResponse(points, model.horizon)
    by_y = response.answer(model)[1] @ slope[:-1]
    scale = 2 / ((response.u**2).sum(axis=1) * len(points))
    each = np.einsum("s,say,sea->sye", scale, by_y, response.of(noise.u))
    return _by_seed(points, each)


def _residual_pushes(
    model: Model,
    points: Samples,
    noise: Samples,
    weight: np.ndarray,
    slope: np.ndarray,
    loss: str,
) -> np.ndarray:
    """Gradients of a residual loss by noise: columns whose outer products add up to Cov.

    With "corrected" they hold also what the estimate of the noise is unsure of.
    """
    features = Features(points, model.horizon)
    c = products(model, features.classes)[:-1]

    def swept(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = features(u[None])[0].transpose(0, 2, 1).reshape(-1, features.width)
        return rows @ c, rows @ slope[:-1]

    force, bend = (np.stack(part) for part in zip(*(swept(u) for u in noise.u)))
    each = []
    for u, b, size in zip(points.u, points.loads, weight):
        own, own_bend = swept(u)
        residual = own - b[points.interior].ravel()
        each.append(2 * size * (own_bend.T @ force.T + np.einsum("eny,n->ye", bend, residual)))
    columns = _by_seed(points, np.stack(each))
    if loss == "residual":
        return columns
    added = 2 * weight.sum() * np.einsum("eny,en->ye", bend, force)
    spread = added - added.mean(axis=1, keepdims=True)
    return np.concatenate([columns, spread / np.sqrt(len(noise) * (len(noise) - 1))], axis=1)


def _by_seed(points: Samples, each: np.ndarray) -> np.ndarray:
    """Gradients of samples by field of noise, [S, Y, E], as columns: one seed, one noise."""
    seeds = np.asarray(points.arrays.get("seed", np.arange(len(points))))
    groups = [each[seeds == seed].sum(axis=0) for seed in np.unique(seeds)]
    columns: np.ndarray = np.concatenate(groups, axis=1) / np.sqrt(each.shape[2])
    return columns


def _sets_and_noise(
    points: Samples | Sequence[Samples], noise: Samples | Sequence[Samples], number: int
) -> tuple[list[Samples], list[Samples]]:
    """Training sets and their noise, as lists of the number that the fit knows."""
    sets = [points] if isinstance(points, Samples) else list(points)
    fields = [noise] if isinstance(noise, Samples) else list(noise)
    if not len(sets) == len(fields) == number:
        raise InputError(
            f"points, noise: expected {number} sets each, got {len(sets)} and {len(fields)}"
        )
    for unloaded, samples in zip(fields, sets):
        check_noise(unloaded, samples)
        if len(unloaded) < 2:
            raise InputError(f"noise: expected two fields at least, got {len(unloaded)}")
    return sets, fields


def _tangent(problem: Problem, y: np.ndarray) -> np.ndarray:
    """Directions that keep the active conditions where they are, shape [Y, T]."""
    point = problem.coordinates.point(y)
    tables = []
    for asked, v, z in zip(problem.asked, point.v, point.z):
        _, worst = ZoneSearch(asked).worst(v, z, point.kappa)
        tables.append(symbol(asked.classes, worst))
    active = problem.margins(point, tables) < ACTIVE * problem.asked[0].zeta
    rows = problem.margin_slopes(point, tables)[active]
    if problem.moduli is not None:
        rows = np.concatenate([rows, problem.departure_slopes(point)])
    if len(rows) == 0:
        return np.eye(len(y))
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(scipy.linalg.null_space(rows, rcond=SAME))
