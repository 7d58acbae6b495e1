"""Algorithm 1 of You et al. (2021): Adam on positive kernels, then an augmented Lagrangian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    """λ, μ [TPa], α, D of one stage, inside their bounds, and the loss on the way there.

    D_dilatation holds the coefficients of the dilatation's own influence function, if it has one.
    """

    lam: float
    mu: float
    alpha: float
    D: np.ndarray
    losses: list[float] = field(default_factory=list, repr=False)
    D_dilatation: np.ndarray | None = None

    @property
    def dilatation(self) -> np.ndarray:
        """Coefficients of the dilatation's influence function, shape [M + 1]."""
        return self.D if self.D_dilatation is None else self.D_dilatation


class Variables:
    """λ, μ, α, D as torch leaves, put back inside their bounds after every step.

    The bounds are those of the printed parametrisation (4.8), applied as a projection: a ReLU
    inside the loss has no gradient once its argument is negative, and λ + μ, which every run
    drives to zero early in stage 1, would stay there for good.
    """

    def __init__(self, start: Parameters, *, positive: bool) -> None:
        values = [start.lam, start.mu, start.alpha, start.D]
        if start.D_dilatation is not None:
            values.append(start.D_dilatation)
        self.leaves = [torch.tensor(value, dtype=torch.float64) for value in values]
        for leaf in self.leaves:
            leaf.requires_grad_()
        self.lam, self.mu, self.alpha, self.D = self.leaves[:4]
        self.kernels = self.leaves[3:]
        self.positive = positive

    def project(self) -> None:
        """μ > 0, λ + μ > 0, α < 3 and, for a positive kernel, D ≥ 0."""
        with torch.no_grad():
            self.mu.clamp_(min=SMALLEST_MODULUS)
            self.lam.clamp_(min=SMALLEST_MODULUS - self.mu)
            self.alpha.clamp_(max=LARGEST_ALPHA)
            if self.positive:
                for D in self.kernels:
                    D.clamp_(min=0.0)

    def loss(self, grids: Sequence[ReducedLoss]) -> tuple[torch.Tensor, list[torch.Tensor]]:
        """The loss over all lattices, and their stiffnesses (v, z) one after the other."""
        total, stiffness = torch.zeros((), dtype=torch.float64), []
        for grid in grids:
            w = grid.class_weights(self.alpha, self.D)
            p = grid.class_weights(self.alpha, self.kernels[-1]) if len(self.kernels) > 1 else w
            total = total + grid.loss(self.lam, self.mu, w, p)
            stiffness += [self.mu * w, self.mu * p]
        return total, stiffness

    def parameters(self, losses: list[float]) -> Parameters:
        """Their values, with the loss on the way."""
        lam, mu, alpha, *kernels = (leaf.detach().numpy().copy() for leaf in self.leaves)
        own = kernels[1] if len(kernels) > 1 else None
        return Parameters(float(lam), float(mu), float(alpha), kernels[0], losses, own)


class _Zone(torch.autograd.Function):
    """Smallest margin over sampled wave vectors; its gradient is that of the worst one."""

    @staticmethod
    def forward(
        ctx: Any,
        conditions: Conditions,
        at: Symbol,
        v: torch.Tensor,
        z: torch.Tensor,
        kappa: torch.Tensor,
    ) -> torch.Tensor:
        numbers = v.detach().numpy(), z.detach().numpy(), float(kappa)
        margins = conditions.margins(at, *numbers)
        gradient = []
        for form, k in enumerate(margins.argmin(axis=1)):
            one = Symbol(at.gamma[[k]], at.phi[[k]], at.laplacian[[k]])
            gradient.append(conditions.gradients(one, *numbers)[form, 0])
        ctx.gradient = torch.from_numpy(np.array(gradient))
        return torch.from_numpy(margins.min(axis=1))

    @staticmethod
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        by_kappa, by_v, by_z = (upstream[0] @ ctx.gradient).tensor_split(
            (1, 1 + (ctx.gradient.shape[1] - 1) // 2)
        )
        return None, None, by_v, by_z, by_kappa.reshape(())


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
    grids: Sequence[ReducedLoss], start: Parameters, *, tick: Callable[[float], None]
) -> Parameters:
    """Stage 1: Adam with D ≥ 0.

    Args:
        grids: the reduced loss of each lattice.
        start: λ, μ, α and D to start from.
        tick: called with the loss after every epoch.
    """
    variables = Variables(start, positive=True)

    def objective() -> tuple[torch.Tensor, torch.Tensor]:
        loss, _ = variables.loss(grids)
        return loss, loss

    return variables.parameters(_adam(variables, [], objective, EPOCHS, tick))


def sign_changing_stage(
    grids: Sequence[ReducedLoss],
    start: Parameters,
    conditions: Sequence[Conditions],
    *,
    tick: Callable[[float], None],
) -> Parameters:
    """Stage 2: D of any sign, the conditions held by an augmented Lagrangian with slacks ϖ.

    H_p = (smallest margin of condition p over the sampled zone) − ϖ_p². Where the printed
    algorithm is inconsistent, |H| is what is tested, against 1e-5, and the multiplier term is
    φ_p H_p + (ψ/2) H_p², so that φ_p ← φ_p + ψ H_p is the ascent of the dual.

    Args:
        grids: the reduced loss of each lattice.
        start: result of stage 1.
        conditions: what must hold on each lattice.
        tick: called with the loss after every epoch.
    """
    tables = [symbol(g.classes, zone_wedge(g.classes.spacing, ZONE_INTERVALS)) for g in grids]
    variables = Variables(start, positive=False)
    count = sum(len(one.names) for one in conditions)
    slack = torch.ones(count, dtype=torch.float64, requires_grad=True)
    multiplier, penalty = torch.zeros_like(slack, requires_grad=False), 1.0

    def loss_and_violation() -> tuple[torch.Tensor, torch.Tensor]:
        loss, stiffness = variables.loss(grids)
        kappa = (variables.lam - variables.mu) / variables.mu**2
        margins = [
            _Zone.apply(one, table, stiffness[2 * g], stiffness[2 * g + 1], kappa)
            for g, (one, table) in enumerate(zip(conditions, tables))
        ]
        return loss, torch.cat(margins) - slack**2

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
        if ((H >= REQUIRED_DECREASE * previous) & (H > TOLERANCE)).any():
            penalty *= PENALTY_GROWTH
        else:
            multiplier = multiplier + penalty * signed
        previous = H
    return variables.parameters(losses)
