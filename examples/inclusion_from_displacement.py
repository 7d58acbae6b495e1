"""A stiff inclusion found from three displacement fields with noise: a map of μ, λ = 3/8 μ.

    python examples/inclusion_from_displacement.py [--side 60] [--noise 0.01]

The misfit of three solves and the total variation of log μ are minimised by L-BFGS; the gradient
to μ at every node costs one solve more for each field. Displacement alone does not see the scale of
μ: that of the collar, which is known, sets it.
"""

import json
import sys
from collections.abc import Callable
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])

import numpy as np
import torch
from scipy.optimize import minimize

import warp_peri as wp
from tools.options import Options, at_least
from warp_peri.errors import exit_status
from warp_peri.points.arguments import REDUCED, Count, NotNegative

HORIZON, RATIO, STIFFER = 3.0, 0.375, 4.0  # in spacings; λ/μ; μ inside over μ outside
WEIGHT, SMOOTH = 0.001, 0.01  # of the total variation, and where its kink is rounded


def body(side: int) -> tuple[wp.Points, np.ndarray, np.ndarray]:
    """Nodes, μ of each, and displacements of three loads that the collar is held at."""
    pad = 2 * int(HORIZON)
    steps = np.argwhere(np.ones((side + 2 * pad,) * 2)) - pad
    inside = np.abs(steps - (side - 1) / 2).max(axis=1) < side / 2
    points = wp.Points(steps.astype(float), inside, 1.0, units=REDUCED)
    near = np.hypot(*(points.x - side * np.array([0.4, 0.55])).T) < side / 5
    x, y = 0.01 * (points.x - (side - 1) / 2).T
    loads = [(x, 0 * y), (0 * x, y), (y, x)]
    return points, np.where(near, STIFFER, 1.0), np.stack([np.stack(one, 1) for one in loads])


def measured(operator, held: np.ndarray, noise: float) -> torch.Tensor:
    """The three displacement fields with noise on the interior, over their mean size."""
    exact = operator.solve(0 * held, held).u
    size = exact[:, operator.points.interior].std(axis=(1, 2)).mean()
    added = noise * size * np.random.default_rng(0).normal(size=exact.shape)
    return torch.from_numpy(exact + added * operator.points.interior[:, None])


def variation(log_mu: torch.Tensor, width: int) -> torch.Tensor:
    """The mean length of the gradient of log μ."""
    q = log_mu.reshape(width, width)
    down, right = q[1:, :-1] - q[:-1, :-1], q[:-1, 1:] - q[:-1, :-1]
    return (torch.sqrt(down**2 + right**2 + SMOOTH**2) - SMOOTH).mean()


def loss_of(operator, held: np.ndarray, seen: torch.Tensor) -> Callable:
    """Misfit and total variation of log μ on all nodes, with its gradient."""
    inside = torch.tensor(operator.points.interior)
    u, width = torch.from_numpy(held), round(len(inside) ** 0.5)
    solver, size = wp.CG(tolerance=1e-6), seen[:, inside].std(dim=(1, 2)).mean() ** 2

    def loss(log_mu: np.ndarray) -> tuple[float, np.ndarray]:
        unknown = torch.tensor(log_mu, requires_grad=True)
        log_of_all = torch.where(inside, unknown, 0.0)
        mu = log_of_all.exp()
        given = {"lam": RATIO * mu, "mu": mu}
        found = operator.solve(0 * u, u, solver, parameters=given).u
        misfit = ((found - seen)[:, inside] ** 2).sum(dim=-1).mean() / size
        total = misfit / 2 + WEIGHT * variation(log_of_all, width)
        total.backward()
        return total.item(), np.asarray(unknown.grad)

    return loss


def main(arguments: list[str] | None = None) -> int:
    options = {
        "side": (60, "unknown nodes along a side", at_least(2)),
        "noise": (0.01, "over the mean size of u", NotNegative),
        "steps": (80, "of L-BFGS, at most", Count),
    }
    given = Options(__doc__, options=options).parse_args(arguments)
    points, truth, held = body(given.side)
    solid = wp.LPSMaterial(
        RATIO, 1.0, 1.0, np.ones(1), HORIZON, certified_on=(1.0,), units=points.units
    )
    seen = measured(solid.on(points, lam=RATIO * truth, mu=truth), held, given.noise)
    operator = solid.on(points, lam=np.full(len(truth), RATIO), mu=np.ones(len(truth)))
    loss = loss_of(operator, held, seen)
    how = {"maxiter": given.steps, "maxcor": 20, "ftol": 1e-10, "gtol": 1e-9}
    found = minimize(loss, np.zeros(len(truth)), jac=True, method="L-BFGS-B", options=how)
    inside, mu = points.interior, np.exp(found.x)
    off = np.linalg.norm((mu - truth)[inside]) / np.linalg.norm(truth[inside])
    stiff = inside & (truth > 1)
    numbers = {
        "map error": float(off),
        "mean in the inclusion": float(mu[stiff].mean()),
        "mean outside": float(mu[inside & ~stiff].mean()),
        "losses": int(found.nfev),
    }
    print(json.dumps(numbers))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
