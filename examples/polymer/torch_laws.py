"""From velocities to the law: plane flows in torch, differentiable in a law's numbers (F31)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize

from examples.polymer import PlaneFlow, SpringLaw
from examples.polymer.closure import check_time_step, heun
from examples.polymer.laws import carried, eigenvalues, from_eigenvalues, stack, unpack
from warp_peri import InputError


@dataclass(frozen=True)
class TorchSpring:
    """A learned spring whose process has its values at the data as numbers to be found.

    `law`: with a product kernel; its data give the kernel's places and lengths; `values`:
    log(S_i/c_i) − mean at the data, shape [n], float64, in place of those learned.
    """

    law: SpringLaw
    values: torch.Tensor

    @property
    def rest(self) -> np.ndarray:
        """That of the law it started from."""
        return self.law.rest

    def spring(self, C: torch.Tensor) -> torch.Tensor:
        """The spring's moments S(C), shape [n, 4]."""
        process = self.law.process
        c1, c2, c3, cosine, sine = eigenvalues(C)
        c = torch.clamp(torch.stack([c1, c2, c3], dim=-1), min=1e-6)
        j, k = torch.roll(c, -1, -1), torch.roll(c, -2, -1)
        X = torch.stack([c.log(), (j * k).log(), (j + k).log()], dim=-1)
        lengths = torch.as_tensor(process.scale * np.exp(process.log_lengths))
        Z = (X - torch.as_tensor(process.centre)) / lengths
        squares = ((Z[..., None, :] - torch.as_tensor(process.points)) ** 2).sum(-1)
        kernel = np.exp(2 * process.log_amplitude) * torch.exp(-0.5 * squares)
        factor = torch.as_tensor(process.factor)
        weights = torch.cholesky_solve(self.values[:, None], factor)[:, 0]
        S = c * torch.exp(process.mean + kernel @ weights)
        tensor: torch.Tensor = from_eigenvalues(S[..., 0], S[..., 1], S[..., 2], cosine, sine)
        return tensor

    def stress(self, C: torch.Tensor) -> torch.Tensor:
        """The stress s = S − I, shape [n, 4]."""
        xx, xy, yy, zz = unpack(self.spring(C))
        tensor: torch.Tensor = stack([xx - 1, xy, yy - 1, zz - 1])
        return tensor

    def rate(self, K: torch.Tensor, C: torch.Tensor) -> torch.Tensor:
        """dC/dt of conformations, shape [n, 4]."""
        tensor: torch.Tensor = carried(K, C) - self.stress(C)
        return tensor


def velocities(law: Any, flow: PlaneFlow, until: float, dt: float, every: int = 1) -> torch.Tensor:
    """u [T, cells + 1] of a plane flow from rest, by the scheme of `run_plane`, in torch.

    Args:
        law: a named law whose numbers may be torch scalars, or a TorchSpring.
        flow: what moves the fluid.
        until: time at the end [t0].
        dt: time step [t0].
        every: steps between two records.

    Raises InputError for a time step beyond `flow.longest_step`.
    """
    check_time_step(dt, flow.longest_step)
    dy, steps = 1 / flow.cells, round(until / dt)
    u = torch.zeros(flow.cells + 1, dtype=torch.float64)
    sigma = torch.zeros(flow.cells, dtype=torch.float64)
    C = torch.as_tensor(law.rest).expand(flow.cells, 4)
    zero, records = torch.zeros(flow.cells, dtype=torch.float64), []

    def slope(u: torch.Tensor, t: float) -> torch.Tensor:
        total = sigma + flow.solvent * torch.diff(u) / dy
        return (torch.diff(total) / dy + flow.force(t)) / flow.Re

    for n in range(steps):
        inner = u[1:-1] + (dt / 2 if n == 0 else dt) * slope(u, n * dt)
        top = torch.full((1,), flow.top((n + 0.5) * dt), dtype=torch.float64)
        u = torch.cat([zero[:1], inner, top])
        K = torch.stack([zero, flow.De * torch.diff(u) / dy, zero, zero], dim=-1)
        C = heun(law, K, C, dt / flow.De)
        sigma = law.stress(C)[:, 1] / flow.De
        if (n + 1) % every == 0:
            now = u[1:-1] + dt / 2 * slope(u, (n + 1) * dt)
            records.append(torch.cat([zero[:1], now, top]))
    return torch.stack(records)


def fit_velocities(
    observed: np.ndarray,
    law: Callable[[torch.Tensor], Any],
    *,
    start: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    run: Callable[[Any], torch.Tensor],
    iterations: int = 50,
) -> tuple[np.ndarray, float]:
    """The numbers of a law that make a flow's velocities nearest to those observed.

    Args:
        observed: velocities, of the shape that run gives.
        law: makes a law of its numbers, a float64 tensor.
        start: numbers to start from.
        bounds: of each number.
        run: the flow of a law, `velocities` with all else given.
        iterations: of L-BFGS-B.

    Returns the numbers and the root of the mean square that is left. Raises InputError for observed
    velocities that are not finite.
    """
    if not np.isfinite(observed).all():
        raise InputError("velocities: expected finite numbers")
    target = torch.as_tensor(observed)

    def loss(theta: np.ndarray) -> tuple[float, np.ndarray]:
        numbers = torch.tensor(theta, dtype=torch.float64, requires_grad=True)
        value = ((run(law(numbers)) - target) ** 2).mean() / (target**2).mean()
        (gradient,) = torch.autograd.grad(value, numbers)
        return float(value.detach()), gradient.numpy()

    optimum = minimize(
        loss, np.array(start, dtype=float), jac=True, bounds=bounds, method="L-BFGS-B",
        options={"maxiter": iterations, "ftol": 1e-15, "gtol": 1e-12},
    )  # fmt: skip
    return optimum.x, float(np.sqrt(optimum.fun * np.mean(observed**2)))
