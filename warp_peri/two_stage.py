"""Algorithm 1 of You et al. (2021): Adam on positive kernels, then an augmented Lagrangian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from warp_peri.conditions import Conditions
from warp_peri.reduced import ReducedLoss
from warp_peri.symbol import Symbol, symbol, zone_wedge

LEARNING_RATE = 1e-3
EPOCHS = 4000
"""Most epochs of stage 1; the paper's loss stagnates between 1000 and 2000."""
INNER_EPOCHS = 500
OUTER_ITERATIONS = 20
STAGNATION = 1e-3
"""A stage ends when its loss fell by less than this fraction over the last window of epochs."""
WINDOW = 200
PENALTY_GROWTH, REQUIRED_DECREASE, TOLERANCE = 5.0, 0.25, 1e-5
ZONE_INTERVALS = 24
SMALLEST_MODULUS, LARGEST_ALPHA = 1e-3, 3 - 1e-3


@dataclass(frozen=True)
class Parameters:
    """λ, μ [TPa], α and D of one stage, inside their bounds, and the loss on the way there."""

    lam: float
    mu: float
    alpha: float
    D: np.ndarray
    losses: list[float] = field(default_factory=list, repr=False)


class _Zone(torch.autograd.Function):
    """Smallest margin over sampled wave vectors; its gradient is that of the worst one."""

    @staticmethod
    def forward(
        ctx: Any, conditions: Conditions, at: Symbol, v: torch.Tensor, kappa: torch.Tensor
    ) -> torch.Tensor:
        numbers = v.detach().numpy(), float(kappa)
        margins = conditions.margins(at, *numbers)
        gradient = []
        for form, k in enumerate(margins.argmin(axis=1)):
            one = Symbol(at.gamma[[k]], at.phi[[k]], at.laplacian[[k]])
            gradient.append(conditions.gradients(one, *numbers)[form, 0])
        ctx.gradient = torch.from_numpy(np.array(gradient))
        return torch.from_numpy(margins.min(axis=1))

    @staticmethod
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        total = upstream[0] @ ctx.gradient
        return None, None, total[1:], total[0].reshape(())


class Variables:
    """λ, μ, α, D as torch leaves, put back inside their bounds after every step.

    The bounds are those of the printed parametrisation (4.8), applied as a projection: a ReLU
    inside the loss has no gradient once its argument is negative, and λ + μ, which every run
    drives to zero early in stage 1, would stay there for good.
    """

    def __init__(
        self, lam: float, mu: float, alpha: float, D: np.ndarray, *, positive: bool
    ) -> None:
        values = (lam, mu, alpha, D)
        self.leaves = [torch.tensor(value, dtype=torch.float64) for value in values]
        self.lam, self.mu, self.alpha, self.D = (leaf.requires_grad_() for leaf in self.leaves)
        self.positive = positive

    def project(self) -> None:
        """μ > 0, λ + μ > 0, α < 3 and, for a positive kernel, D ≥ 0."""
        with torch.no_grad():
            self.mu.clamp_(min=SMALLEST_MODULUS)
            self.lam.clamp_(min=SMALLEST_MODULUS - self.mu)
            self.alpha.clamp_(max=LARGEST_ALPHA)
            if self.positive:
                self.D.clamp_(min=0.0)

    def parameters(self, losses: list[float]) -> Parameters:
        """Their values, with the loss on the way."""
        numbers = (self.lam.item(), self.mu.item(), self.alpha.item())
        return Parameters(*numbers, self.D.detach().numpy().copy(), losses)


def _adam(
    variables: Variables,
    extra: list[torch.Tensor],
    objective: Callable[[], tuple[torch.Tensor, torch.Tensor]],
    epochs: int,
    tick: Callable[[float], None],
) -> list[float]:
    """Adam on the variables until the objective stagnates; returns the loss by epoch.

    `objective` gives what is minimised and the loss that is part of it.
    """
    optimiser = torch.optim.Adam([*variables.leaves, *extra], lr=LEARNING_RATE)
    totals: list[float] = []
    losses: list[float] = []
    for _ in range(epochs):
        optimiser.zero_grad()
        total, loss = objective()
        total.backward()
        optimiser.step()
        variables.project()
        totals.append(total.item())
        losses.append(loss.item())
        tick(losses[-1])
        if _stagnant(totals, WINDOW):
            break
    return losses


def _stagnant(losses: list[float], window: int) -> bool:
    return len(losses) > window and losses[-1 - window] - losses[-1] < STAGNATION * abs(losses[-1])


def positive_stage(
    reduced: ReducedLoss, degree: int, *, seed: int, tick: Callable[[float], None]
) -> Parameters:
    """Stage 1: Adam with D ≥ 0, from D ~ U(0, 1), λ = 0, μ = 1 TPa, α = 1.

    Args:
        reduced: the loss.
        degree: M.
        seed: of the initial D.
        tick: called with the loss after every epoch.
    """
    D = np.random.default_rng(seed).uniform(size=degree + 1)
    variables = Variables(0.0, 1.0, 1.0, D, positive=True)

    def objective() -> tuple[torch.Tensor, torch.Tensor]:
        w = reduced.class_weights(variables.alpha, variables.D)
        loss = reduced.loss(variables.lam, variables.mu, w)
        return loss, loss

    return variables.parameters(_adam(variables, [], objective, EPOCHS, tick))


def sign_changing_stage(
    reduced: ReducedLoss,
    start: Parameters,
    conditions: Conditions,
    *,
    tick: Callable[[float], None],
) -> Parameters:
    """Stage 2: D of any sign, the conditions held by an augmented Lagrangian with slacks ϖ.

    H_p = (smallest margin of condition p over the sampled zone) − ϖ_p². Where the printed
    algorithm is inconsistent, |H| is what is tested, against 1e-5, and the multiplier term is
    φ_p H_p + (ψ/2) H_p², so that φ_p ← φ_p + ψ H_p is the ascent of the dual.

    Args:
        reduced: the loss.
        start: result of stage 1.
        conditions: what must hold on the lattice.
        tick: called with the loss after every epoch.
    """
    at = symbol(reduced.classes, zone_wedge(reduced.classes.spacing, ZONE_INTERVALS))
    variables = Variables(start.lam, start.mu, start.alpha, start.D, positive=False)
    slack = torch.ones(len(conditions.names), dtype=torch.float64, requires_grad=True)
    multiplier, penalty = torch.zeros_like(slack, requires_grad=False), 1.0

    def loss_and_violation() -> tuple[torch.Tensor, torch.Tensor]:
        lam, mu = variables.lam, variables.mu
        w = reduced.class_weights(variables.alpha, variables.D)
        margin = _Zone.apply(conditions, at, mu * w, (lam - mu) / mu**2)
        return reduced.loss(lam, mu, w), margin - slack**2

    def objective() -> tuple[torch.Tensor, torch.Tensor]:
        loss, H = loss_and_violation()
        return loss + multiplier @ H + penalty / 2 * (H @ H), loss

    losses: list[float] = []
    previous = torch.full_like(slack, torch.inf, requires_grad=False)
    for _ in range(OUTER_ITERATIONS):
        losses += _adam(variables, [slack], objective, INNER_EPOCHS, tick)
        with torch.no_grad():
            signed = loss_and_violation()[1]
        H = signed.abs()
        if (H <= TOLERANCE).all() and _stagnant(losses, INNER_EPOCHS):
            break
        if ((REQUIRED_DECREASE * previous <= H) & (H > TOLERANCE)).any():
            penalty *= PENALTY_GROWTH
        else:
            multiplier = multiplier + penalty * signed
        previous = H
    return variables.parameters(losses)
