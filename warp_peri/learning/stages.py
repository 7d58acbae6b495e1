"""The stages of a fit, one after the other: each timed, shown while it runs, and remembered."""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import joblib
import numpy as np
from tqdm.auto import tqdm

from warp_peri.core.elastic import from_voigt, plane_isotropic
from warp_peri.core.stencil import difference_tensors
from warp_peri.errors import InputError
from warp_peri.fitting.long_waves import lame_of_long_waves
from warp_peri.learning import LOSSES
from warp_peri.learning.evaluate import evaluate
from warp_peri.learning.methods import Constrained, TwoStage
from warp_peri.learning.response import STEPS, as_model, output_optimum, products, responses_of
from warp_peri.learning.result import LossChoice, Stage
from warp_peri.learning.training_data import Scale, TrainingData
from warp_peri.learning.two_stage import (
    Checkpoint,
    DenseMargins,
    SymbolMargins,
    positive_stage,
    sign_changing_stage,
)
from warp_peri.materials.lps import Model, moduli
from warp_peri.micromodulus import Crystal
from warp_peri.micromodulus.crystal_fit import AGREE, POOR, SPREADS
from warp_peri.points.samples import WAVE_VECTOR, Samples
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.lagrangian import augmented_lagrangian
from warp_peri.regression.optimum import Reached, constrained_optimum
from warp_peri.regression.settings import LONG_WAVES, Optimum

SMALL_SHARE = 0.01
"""A residual loss is taken as it is when noise is less than this of its squares."""


def choose_loss(
    asked: str, data: TrainingData, start: Parameters, *, responds: bool = True
) -> LossChoice:
    """The loss that was asked for, or for "auto" the one that the noise calls for.

    Args:
        asked: one of LOSSES.
        data: training data, with what is known of their noise.
        start: where the optimum of the residual is looked for from.
        responds: whether the method can take the output-error loss.

    Raises InputError for a loss that these data or the method cannot have.
    """
    if asked not in LOSSES:
        raise InputError(f"loss: expected one of {', '.join(LOSSES)}, got {asked!r}")
    if asked == "corrected" and not data.added:
        raise InputError("loss: 'corrected' needs fields of noise")
    if asked == "output" and not responds:
        raise InputError("loss: 'output' is not for the two-stage method")
    if not data.grids and asked in ("corrected", "output"):
        raise InputError(f"loss: scattered points have 'residual' only, got {asked!r}")
    if asked != "auto":
        return LossChoice(asked, "asked for")
    if not data.added:
        return LossChoice("residual", "no fields of noise were given")
    share = noise_share(data, start)
    why = f"noise is {100 * share:.3g} % of the squared residual at its optimum"
    if share < SMALL_SHARE:
        return LossChoice("residual", why)
    if responds and all(WAVE_VECTOR in points.arrays for points in data.sets):
        return LossChoice("output", f"{why}; loads are single waves")
    return LossChoice("corrected", why)


def noise_share(data: TrainingData, start: Parameters) -> float:
    """Part of the squared residual that is noise, at the optimum of the residual."""
    optimum = constrained_optimum(data.grids, start, data.conditions).parameters
    model = Model(optimum.lam, optimum.mu, optimum.alpha, optimum.D, data.horizon)
    c = [products(model, grid.classes) for grid in data.grids]
    whole = sum(np.sum((grid.R @ values) ** 2) for grid, values in zip(data.grids, c))
    return float(sum(np.sum((R @ values) ** 2) for R, values in zip(data.added, c)) / whole)


SAME_LOSS = 1e-6
MOST_NODES, MOST_REACH = 2000, 8
"""Unknown nodes up to which a fit is compared with local elasticity, and its differences' reach."""
Tick = Callable[[float], None]


class Stages:
    """Runs the stages of one fit on its data.

    Args:
        data: training data.
        losses: what is minimised.
        progress: show a bar for each stage; None shows it where somebody can see it.

    Attributes:
        history: the stages that were run, in order.
        starts: E of stage 3 by start.
        reached: optima of stage 3 that are known before it, by start.
    """

    def __init__(self, data: TrainingData, losses: Sequence[Any], progress: bool | None) -> None:
        self.data, self.losses = data, losses
        self.disable = None if progress is None else not progress
        self.history: list[Stage] = []
        self.starts: dict[str, float] = {}
        self.reached: dict[str, Reached] = {}

    def _run(self, name: str, most: int, run: Callable[[Tick], Parameters]) -> Parameters:
        begin = time.perf_counter()
        with tqdm(desc=name, unit=" steps", total=most, disable=self.disable) as bar:

            def tick(loss: float) -> None:
                bar.update()
                if bar.n % 100 == 0:
                    bar.set_postfix_str(f"relative residual {100 * np.sqrt(loss):.2f} %")

            parameters = run(tick)
            bar.total = bar.n  # a stage may end early
            bar.refresh()
        seconds = time.perf_counter() - begin
        error = self.data.errors(*numbers(parameters))
        self.history.append(Stage(name, parameters, error, seconds, parameters.losses))
        return parameters

    def ended(self, scale: Scale) -> Stages:
        """These stages, with what was found in the units of the data."""
        self.history = [
            dataclasses.replace(stage, parameters=scale.parameters(stage.parameters))
            for stage in self.history
        ]
        return self

    def _reach(self, start: Parameters, method: Optimum) -> Reached:
        """The constrained optimum from one start; InputError where it was led out of a domain."""
        return constrained_optimum(self.losses, start, self.data.conditions, method)

    def hold(self, method: Optimum, name: str, start: Parameters) -> Optimum:
        """The method with the moduli of long waves, where it asks for them and free ones miss them.

        Free ones are those of one start, named as in stage 3, which keeps what it reached.
        """
        free = dataclasses.replace(method, moduli=method.held)
        if method.moduli != LONG_WAVES or not self.data.grids or self.data.noise:
            return free
        try:
            waves = lame_of_long_waves(self.data.sets)
            found = waves.lam, waves.mu
            held = dataclasses.replace(method, moduli=found)
            alone = self._reach(start, free)
            off = np.abs(self._moduli(alone.parameters) - found)
            sure = waves.errors.max() <= AGREE * (waves.lam + 2 * waves.mu)
            sure &= waves.misfit <= min(POOR, alone.loss**0.5)  # else the fit tells more than they
            apart = (off > SPREADS * waves.errors).any()
            beside = self._reach(start, held) if sure and apart else alone
        except InputError:  # they do not tell, or a function is not defined where it was led
            return free
        taken = beside is not alone and beside.converged and beside.loss <= POOR**2
        self.reached[name] = beside if taken else alone
        return held if taken else free

    def _moduli(self, parameters: Parameters) -> np.ndarray:
        """C12 and C44 of long waves on each lattice, shape [L, 2]."""
        model = as_model(parameters, self.data.horizon)
        found = [moduli(model, grid.classes) for grid in self.data.grids]
        return np.array([[one["C12"], one["C44"]] for one in found])

    def two_stage(self, rough: Parameters, method: TwoStage, key: str) -> Parameters:
        """Stages 1 and 2, from a rough start; `key` says what a checkpoint depends on."""
        data, kept_in = self.data, None
        dense = method.constraints == "dense"
        margins = DenseMargins(data.sets, data.horizon) if dense else SymbolMargins(data.conditions)
        if method.checkpoint is not None:
            kept_in = Checkpoint(method.checkpoint, key)
        first = self._run(
            "1 positive",
            method.epochs,
            lambda tick: positive_stage(self.losses, rough, method, tick=tick),
        )
        return self._run(
            "2 sign-changing",
            method.inner_epochs * method.outer_iterations,
            lambda tick: sign_changing_stage(
                self.losses, first, margins, method, checkpoint=kept_in, tick=tick
            ),
        )

    def lagrangian(self, rough: Parameters, method: Constrained, optimum: Optimum) -> Parameters:
        """Adam and the augmented Lagrangian, from a rough start."""
        return self._run(
            "1 Adam",
            method.steps * method.rounds,
            lambda tick: (
                augmented_lagrangian(
                    self.losses,
                    rough,
                    self.data.conditions,
                    optimum,
                    steps=method.steps,
                    rounds=method.rounds,
                    tick=tick,
                ).parameters
            ),
        )

    def optimum(self, starts: dict[str, Parameters], method: Optimum) -> Parameters:
        """Stage 3: the best of the constrained optima reached from all starts.

        Raises RuntimeError when no start ends with the conditions and the moduli kept.
        """
        return self._run(
            "3 constrained", len(starts), lambda tick: self._best(starts, method, tick)
        )

    def _best(self, starts: dict[str, Parameters], method: Optimum, tick: Tick) -> Parameters:
        def attempt(name: str) -> Reached | InputError:
            try:
                return self.reached.get(name) or self._reach(starts[name], method)
            except InputError as error:  # a function that is not defined where it was led
                return error

        run = joblib.Parallel(n_jobs=method.jobs, prefer="threads")
        results = []
        for name, reached in zip(starts, run(map(joblib.delayed(attempt), starts))):
            tick(np.nan if isinstance(reached, InputError) else reached.loss)
            if isinstance(reached, InputError):
                failed = reached
                continue
            self.starts[name] = float(np.sqrt(reached.loss))
            results.append(reached)
        if not results:
            raise failed
        kept = [reached for reached in results if reached.converged]
        if not kept:
            margin = self.data.stress * max(reached.margin for reached in results)
            closest = self.data.stress * min(reached.departure for reached in results)
            raise RuntimeError(
                "stage 3: no start ended with the conditions kept; smallest margin "
                f"{margin:.1e}, moduli to be held missed by {closest:.1e} or more"
            )
        lowest = min(reached.loss for reached in kept)
        # Equal losses are one optimum: the first start is kept, whatever the rounding.
        first = next(reached for reached in kept if reached.loss <= lowest * (1 + SAME_LOSS))
        parameters: Parameters = first.parameters
        return parameters

    def worse_than_local(self, parameters: Parameters) -> bool:
        """Whether the training displacement is better had from local elasticity of these moduli.

        Local elasticity is of central differences; sets of many unknowns are not solved for this.
        """
        model, sets = as_model(parameters, self.data.horizon), self.data.sets
        if any(np.count_nonzero(each.interior) > MOST_NODES for each in sets):
            return False
        C = from_voigt(plane_isotropic(parameters.lam, parameters.mu))
        errors = np.zeros(2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            for each in sets:
                own = evaluate(model, each, allow_uncertified=True)
                errors += [len(each) * found["E_u"] for found in (own, _local(C, each))]
        return bool(errors[0] > errors[1])

    def output(self, start: Parameters, method: Optimum) -> Parameters:
        """Stage 4: on from there to the least misfit of displacement.

        Raises RuntimeError when it ends with the conditions or the moduli not kept.
        """
        data = self.data
        responses = responses_of(data.sets, data.horizon, self.losses)

        def refined(tick: Tick) -> Parameters:
            reached = output_optimum(
                responses, start, data.conditions, data.horizon, method, tick=tick
            )
            if not reached.converged:
                margin, departure = data.stress * reached.margin, data.stress * reached.departure
                raise RuntimeError(
                    f"stage 4: ended with a margin of {margin:.1e}, and moduli to be "
                    f"held missed by {departure:.1e}"
                )
            return reached.parameters

        return self._run("4 output error", STEPS, refined)


def _local(C: np.ndarray, samples: Samples) -> dict[str, Any]:
    """Errors of local elasticity, by the widest differences that the collar has nodes for."""
    h, no_axis = samples.spacing, dataclasses.replace(samples.points, axis=None)
    for reach in range(MOST_REACH, 1, -1):
        steps, tensors = difference_tensors(C, reach)
        try:
            law = Crystal(h, steps, tensors / h**2)  # isotropic
            return evaluate(law, dataclasses.replace(samples, points=no_axis))
        except InputError:  # bonds reach beyond the collar
            continue
    return {"E_u": np.inf}


def numbers(parameters: Parameters) -> tuple[Any, ...]:
    """What lps_force takes after u."""
    return parameters.lam, parameters.mu, parameters.alpha, parameters.D
