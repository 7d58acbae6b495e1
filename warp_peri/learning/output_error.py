"""The optimum of the output-error loss, by Gauss–Newton under the conditions (theory.md, 38)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from warp_peri.learning.response import Response, products
from warp_peri.models.lps import Model
from warp_peri.regression.conditions import LatticeConditions
from warp_peri.regression.optimum import Reached, constrained_optimum
from warp_peri.regression.parameters import Parameters
from warp_peri.regression.reduced import ReducedLoss
from warp_peri.regression.settings import Optimum

STEPS = 12
GAIN = 1e-5
"""Steps end when one lowers the loss by less than this, relative."""


def output_optimum(
    responses: Sequence[Response],
    start: Parameters,
    conditions: Sequence[LatticeConditions],
    horizon: float,
    method: Optimum = Optimum(),  # noqa: B008 (a frozen value)
    *,
    two_functions: bool = False,
    tick: Callable[[float], None] = lambda loss: None,
) -> Reached:
    """Minimise the misfit of displacement under the conditions over the whole zone.

    Each step is a constrained optimum of the loss linearised about the last one. A step that does
    not lower the loss itself ends the search.

    Args:
        responses: of the training set on each lattice.
        start: where to begin.
        conditions: what must hold on each lattice.
        horizon: δ [Å].
        method, two_functions: as for constrained_optimum.
        tick: called with the loss after each step.
    """

    def step(grids: Sequence[ReducedLoss], parameters: Parameters) -> Reached:
        return constrained_optimum(
            grids, parameters, conditions, method, two_functions=two_functions
        )

    def about(parameters: Parameters) -> tuple[list[ReducedLoss], float]:
        model = as_model(parameters, horizon)
        grids = [response.about(model) for response in responses]
        return grids, sum(misfit(grid, model) for grid in grids)

    best = step([response.start() for response in responses], start)
    grids, loss = about(best.parameters)
    losses = [loss]
    for _ in range(STEPS):
        reached = step(grids, best.parameters)
        linearised, lower = about(reached.parameters)
        if not (reached.converged and lower < loss):
            break
        gained = loss - lower
        best, grids, loss = reached, linearised, lower
        losses.append(loss)
        tick(loss)
        if gained <= GAIN * loss:
            break
    parameters = dataclasses.replace(best.parameters, losses=losses)
    return dataclasses.replace(best, parameters=parameters, loss=loss)


def as_model(parameters: Parameters, horizon: float) -> Model:
    """The model of these parameters."""
    return Model(
        parameters.lam,
        parameters.mu,
        parameters.alpha,
        parameters.D,
        horizon,
        D_dilatation=parameters.D_dilatation,
    )


def misfit(grid: ReducedLoss, model: Model) -> float:
    """‖R c‖² of a reduced loss at a model."""
    return float(np.sum((grid.R @ products(model, grid.classes)) ** 2))
