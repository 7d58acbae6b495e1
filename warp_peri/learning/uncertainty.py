"""How sure a fit is: by its noise, and by learning again from parts."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
from scipy.special import ndtri, stdtrit
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.learning.laws import fit
from warp_peri.learning.response import WaveResponse, as_model, products
from warp_peri.learning.result import Fit
from warp_peri.learning.training_data import listed, scale_of
from warp_peri.lps.model import Model
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import WAVE_VECTOR, Samples, part
from warp_peri.points.unit_names import check_same
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.losses import (
    Features,
    ReducedLoss,
    check_noise,
    corrected,
    noise_loss,
    reduce,
    sample_weights,
)
from warp_peri.regression.optimum import ConstrainedProblem, coordinates_of

LEAST_LOADS, DRAWS = 4, 40
ONE_DEVIATION = (0.1587, 0.8413)
"""Of normal numbers, the parts below minus and plus one standard deviation."""
REDRAWN = 0.2
"""Of the draws, that may determine no law and are drawn again."""


@dataclass(frozen=True)
class Resampled:
    """Materials learned from other choices of the loads.

    It is asked as `Uncertainty` of `fit_uncertainty` is.

    Attributes:
        materials: one of each choice.
        loads: how many there were.
        spread: what the materials' standard deviation is multiplied by.
        drawn: whether they are draws. Their deviation then is half of what lies between 16 and
            84 % of them: a draw that hardly determines a law does not widen the band.
        knows: what the bands hold and what they do not, in a sentence.
    """

    materials: list[Any]
    loads: int
    spread: float
    knows: str
    drawn: bool = False

    def deviation(self, quantity: Callable[[Any], np.ndarray | float]) -> np.ndarray:
        """Standard deviation of anything a material determines, of the shape of the quantity."""
        values = np.array([np.asarray(quantity(material)) for material in self.materials])
        if not self.drawn:
            return np.asarray(self.spread * values.std(axis=0))
        low, high = np.quantile(values, ONE_DEVIATION, axis=0)
        return np.asarray(self.spread * (high - low) / 2)

    def band(
        self, material: Any, quantity: Callable[[Any], np.ndarray | float], level: float = 0.9
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of the band that holds a quantity with probability `level`.

        About the material learned from all loads, by Student's distribution of their number.
        Raises InputError for a level that is no probability.
        """
        if not 0 < level < 1:
            raise InputError(f"level: expected a probability between 0 and 1, got {level}")
        half = stdtrit(self.loads - 1, (1 + level) / 2) * self.deviation(quantity)
        middle = np.asarray(quantity(material))
        return middle - half, middle + half


def resample_loads(
    samples: Samples | Dataset,
    law: Any,
    *,
    leave_one_out: bool = False,
    draws: int = DRAWS,
    seed: int = 0,
    progress: bool = False,
    **options: Any,
) -> Resampled:
    """The same fit to other choices of the loads: bootstrap, or each load left out in turn.

    Args:
        samples: that the law is learned from; of a Dataset `train`, or its only set.
        law: as for `fit`; one with symmetry="auto" is given the symmetry that all loads have.
        leave_one_out: as many fits as loads, instead of `draws` choices with repetition.
        draws, seed: of the bootstrap.
        progress: show a progress bar.
        options: of `fit`.

    Raises InputError for fewer than four loads or ten draws, and what `fit` raises: for a load left
    out always, of a bootstrap where a fifth of the draws determine no law.
    """
    one = samples.obvious("train") if isinstance(samples, Dataset) else samples
    count = len(one)
    if count < LEAST_LOADS:
        raise InputError(f"samples: expected at least {LEAST_LOADS} loads, got {count}")
    if not leave_one_out and draws < 10:
        raise InputError(f"draws: expected at least 10, got {draws}")
    if getattr(law, "symmetry", None) == "auto":
        law = dataclasses.replace(law, symmetry=fit(one, law, **options).material.symmetry)
    rng, again = np.random.default_rng(seed), 0
    wanted = count if leave_one_out else draws
    bar = tqdm(total=wanted, desc="fits", unit="fit", disable=not progress)
    materials: list[Any] = []
    while len(materials) < wanted:
        if leave_one_out:
            choice = np.delete(np.arange(count), len(materials))
        else:
            choice = rng.integers(count, size=count)
        try:
            with warnings.catch_warnings():  # the fit to all loads warns; a draw has less to go by
                warnings.simplefilter("ignore", UserWarning)
                materials.append(fit(part(one, choice), law, **options).material)
        except InputError:
            again += 1
            if leave_one_out or again > REDRAWN * draws:
                raise
            continue
        bar.update()
    bar.close()
    if leave_one_out:
        spread, how = float(np.sqrt(count - 1)), "each load left out in turn"
    else:
        spread = float(np.sqrt(count / (count - 1)))
        how = f"{draws} choices of the loads with repetition"
        how += f" ({again} more told of no model)" if again else ""
    knows = (
        f"{how}, of {count}: what differs from load to load, noise among it; not an error that all "
        "loads share"
    )
    return Resampled(materials, count, spread, knows, drawn=not leave_one_out)


ACTIVE = 0.02
"""A condition is active where its margin is below this part of ζ."""
SAME = 1e-3
"""Conditions at neighbouring wave vectors whose gradients differ by less than this are one."""
SMALLER = (1.0, 0.25, 0.05, 0.01, 1e-3, 1e-5)
"""Parts of a standard deviation that are tried, one after the other."""
BENT = 0.5
"""Second difference of the residual along a step, relative to the first, that is too large."""
PULLED = 0.3
"""Bias in standard deviations that is warned about; a 90 % band then covers 87 %."""
HIDDEN = 0.3
"""Uncertainty of the loss's curvature by noise, relative to it, that is warned about."""
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

    @property
    def knows(self) -> str:
        """What the bands hold and what they do not, in a sentence."""
        return "the fields of noise that were given; no error of the model, no bias of a loss"

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
    own. Bands hold noise alone, no error of the model. Those of "output" and "corrected" are
    calibrated (docs/archive/noise.md); where noise hides the curvature of the corrected loss
    itself, they are too narrow, and a warning says so. Noise pulls the "residual" loss to one side,
    by more than its bands are wide unless there is next to none: a warning says how far.

    Args:
        found: the fit, by any loss except "output" on loads that are not single waves.
        points: the training sets that it learned from, in that order.
        noise: fields of noise alone for each, two at least.

    Raises InputError for data that the fit cannot have learned from, data in other units, or for a
    loss "output" on loads that are not single waves.
    """
    model, settings = found.material, found.settings
    sets, fields = _sets_and_noise(points, noise, len(settings.conditions))
    for samples in (*sets, *fields):
        check_same(model.units, samples.points.units)
    scale = scale_of(sets, model.horizon, lengths=found.influence is None)
    sets, fields = ([scale.samples(each) for each in some] for some in (sets, fields))
    model, settings = scale.inner_model(model), scale.inner_settings(settings)
    weights = sample_weights(sets, normalise=settings.normalise)
    losses = [_linearised(found.loss.name, model, *each) for each in zip(sets, fields, weights)]
    own = model.dilatation if settings.two_functions else None
    numbers = (model.lam, model.mu, model.alpha, model.D)
    optimum = Parameters(*numbers, D_dilatation=own, shape=found.influence)
    lattices = [loss.classes for loss in losses]
    coordinates = coordinates_of(lattices, optimum, two_functions=settings.two_functions)
    problem = ConstrainedProblem(losses, settings.conditions, coordinates, settings.moduli)
    y = coordinates.start(optimum)
    pushes, bends = [], []
    slopes = problem.product_slopes(coordinates.point(y))
    for samples, unloaded, weight, slope in zip(sets, fields, weights, slopes):
        if found.loss.name == "output":
            pushes.append(_response_pushes(model, samples, unloaded, slope))
        else:
            sweep = _swept(model, samples, unloaded, weight, slope)
            pushes.append(_residual_pushes(sweep, estimated=found.loss.name == "corrected"))
            bends.append(_curvatures(sweep))
    step = _steps(problem, y)
    follow = step @ step.T
    axes, deviation, _ = np.linalg.svd(follow @ np.concatenate(pushes, axis=1))
    if found.loss.name == "residual":
        pull = sum(_pull(model, *each) for each in zip(sets, fields, weights, slopes))
        _warn_of_bias(axes.T @ (follow @ pull), deviation)
    if found.loss.name == "corrected":
        _warn_of_curvature(step.T @ np.concatenate(bends) @ step)
    steps = (axes[:, : len(deviation)] * deviation).T[deviation > 1e-12 * deviation[0]]
    pairs = [_beside(problem, y, model, step) for step in steps]
    back = found.material
    return Uncertainty(
        [(scale.outer_model(a, back), scale.outer_model(b, back), off) for a, b, off in pairs]
    )


def _beside(
    problem: ConstrainedProblem, y: np.ndarray, model: Model, step: np.ndarray
) -> tuple[Model, Model, float]:
    """Models a step above and below the fit, within what is linear, and the part of the step."""
    for off in SMALLER:
        try:
            above, below = (
                replace(
                    as_model(problem.coordinates.parameters(y + ahead, []), model.horizon),
                    units=model.units,
                )
                for ahead in (off * step, -off * step)
            )
        except InputError:  # μ or λ + μ is not above zero there
            continue
        if off == SMALLER[-1] or _is_straight(problem, y, off * step):
            return above, below, off
    raise InputError("noise: it is so strong that nothing can be said of this fit")


def _steps(problem: ConstrainedProblem, y: np.ndarray) -> np.ndarray:
    """X with X Xᵗ how far the optimum moves against a gradient, −dy by gradient, shape [Y, T]."""
    free = _tangent(problem, y)
    size, right = np.linalg.svd(problem.slopes(y, problem.coordinates.point(y)) @ free)[1:]
    kept = size > DETERMINED * size[0]
    steps: np.ndarray = free @ (right[: len(size)][kept].T / (np.sqrt(2) * size[kept]))
    return steps


def _is_straight(problem: ConstrainedProblem, y: np.ndarray, step: np.ndarray) -> bool:
    """Whether the residual changes along a step as its derivative says, about."""
    above, here, below = (
        problem.values(moved, problem.coordinates.point(moved)) for moved in (y + step, y, y - step)
    )
    bend = np.linalg.norm(above + below - 2 * here)
    return bool(bend <= BENT * np.linalg.norm(above - below))


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


@dataclass(frozen=True)
class _Sweep:
    """A set and its noise through the operator, and through its derivative to the coordinates.

    Attributes:
        seeds, weight: of the samples, shape [S].
        left, own: residuals of the samples, [S, n], and their derivatives, [S, n, Y].
        force, bend: L e of the noise, [E, n], and its derivative, [E, n, Y].
    """

    seeds: np.ndarray
    weight: np.ndarray
    left: np.ndarray
    own: np.ndarray
    force: np.ndarray
    bend: np.ndarray

    @property
    def joint(self) -> float:
        """Σ of squared weights of seeds: samples of one seed share their noise."""
        groups = (self.weight[self.seeds == seed].sum() for seed in np.unique(self.seeds))
        return float(sum(size**2 for size in groups))


def _swept(
    model: Model, points: Samples, noise: Samples, weight: np.ndarray, slope: np.ndarray
) -> _Sweep:
    features = Features(points, model.horizon)
    c = products(model, features.classes)[:-1]

    def swept(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = features(u[None])[0].transpose(0, 2, 1).reshape(-1, features.width)
        return rows @ c, rows @ slope[:-1]

    force, bend = (np.stack(part) for part in zip(*(swept(u) for u in noise.u)))
    own, own_bend = (np.stack(part) for part in zip(*(swept(u) for u in points.u)))
    left = own - points.loads[:, points.interior].reshape(len(points), -1)
    seeds = np.asarray(points.arrays.get("seed", np.arange(len(points))))
    return _Sweep(seeds, weight, left, own_bend, force, bend)


def _residual_pushes(sweep: _Sweep, *, estimated: bool) -> np.ndarray:
    """Gradients of a residual loss by noise: columns whose outer products add up to Cov.

    With `estimated` they hold also what the estimate of the noise is unsure of.
    """
    columns = np.concatenate(
        [
            sum(
                2 * sweep.weight[s] * (sweep.own[s].T @ sweep.force.T + bent)
                for s in np.flatnonzero(sweep.seeds == seed)
                for bent in [np.einsum("eny,n->ye", sweep.bend, sweep.left[s])]
            )
            for seed in np.unique(sweep.seeds)
        ],
        axis=1,
    ) / np.sqrt(len(sweep.force))
    columns = _squares_once(columns, sweep)
    if not estimated:
        return columns
    added = 2 * sweep.weight.sum() * np.einsum("eny,en->ye", sweep.bend, sweep.force)
    spread = added - added.mean(axis=1, keepdims=True)
    number = len(sweep.force)
    return np.concatenate([columns, spread / np.sqrt(number * (number - 1))], axis=1)


def _squares_once(columns: np.ndarray, sweep: _Sweep) -> np.ndarray:
    """The columns with squares of noise counted once (theory, 39).

    A field put on a sample meets the noise that is there already: 2 eᵗM e′ has twice the variance
    of eᵗM e, which the sample itself has. Pairs of fields say how much of Cov that is.
    """
    number = len(sweep.force)
    pairs = np.einsum("eny,fn->efy", sweep.bend, sweep.force)
    pairs = 2 * (pairs + pairs.transpose(1, 0, 2))[~np.eye(number, dtype=bool)]
    scale = np.linalg.norm(columns, axis=1, keepdims=True)
    scale[scale == 0] = 1
    axes, size, _ = np.linalg.svd(columns / scale, full_matrices=False)
    kept = size > np.sqrt(np.finfo(float).eps) * size[0]
    axes, size = axes[:, kept], size[kept]
    whitened = (pairs / scale.T) @ axes / size * np.sqrt(sweep.joint / len(pairs))
    part, turn = np.linalg.svd(whitened)[1:]
    half = np.ones(len(size))
    half[: len(part)] -= np.minimum(part**2, 1) / 2
    once: np.ndarray = scale * (axes * size) @ turn.T * np.sqrt(half)
    return once


def _curvatures(sweep: _Sweep) -> np.ndarray:
    """Deviations of the loss's Hessian by noise: matrices whose squares add up, [E, Y, Y]."""
    number = len(sweep.bend)
    each = 2 * np.einsum("eny,enz->eyz", sweep.bend, sweep.bend)
    spread = (sweep.joint + sweep.weight.sum() ** 2 / number) / (number - 1)
    curvatures: np.ndarray = (each - each.mean(axis=0)) * np.sqrt(spread)
    return curvatures


def _warn_of_curvature(relative: np.ndarray) -> None:
    """Warn when noise makes the curvature itself uncertain, [E, T, T] in units of it."""
    doubt = np.sqrt((np.linalg.norm(relative, 2, axis=(1, 2)) ** 2).sum())
    if doubt > HIDDEN:
        warnings.warn(
            f"noise: it makes the curvature of the loss uncertain by {100 * doubt:.0f} % in some "
            f"direction, and beyond {100 * HIDDEN:.0f} % bands are too narrow: of 90 % bands, some "
            "held the truth less than 80 times in 100; fit with loss='output', or take more "
            "samples",
            stacklevel=3,
        )


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
    sets, fields = listed(points, "points"), listed(noise, "noise")
    if not len(sets) == len(fields) == number:
        raise InputError(
            f"points, noise: expected {number} sets each, got {len(sets)} and {len(fields)}"
        )
    for unloaded, samples in zip(fields, sets):
        check_noise(unloaded, samples)
        if len(unloaded) < 2:
            raise InputError(f"noise: expected two fields at least, got {len(unloaded)}")
    return sets, fields


def _tangent(problem: ConstrainedProblem, y: np.ndarray) -> np.ndarray:
    """Directions that keep the active conditions where they are, shape [Y, T]."""
    point = problem.coordinates.point(y)
    problem.look(point, all_of_them=True)
    active = problem.margins(point) < ACTIVE * problem.asked[0].zeta
    rows = problem.margin_slopes(point)[active]
    if problem.moduli is not None:
        rows = np.concatenate([rows, problem.departure_slopes(point)])
    if len(rows) == 0:
        return np.eye(len(y))
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(scipy.linalg.null_space(rows, rcond=SAME))
