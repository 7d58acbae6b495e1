"""Maps of κ = λ + μ and of μ in a plate from one shot of waves, heard along a ring near its rim.

    python examples/waves_to_map.py [--side 64] [--noise 0.01] [--iterations 40]

`simulate` gives the gradient of what is heard to λ and μ at every node. The same model makes the
data.
"""

import json
import sys
from collections.abc import Callable
from os.path import realpath
from typing import Any

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])

import numpy as np
import torch

import warp_peri as wp
from tools.options import Options, at_least
from warp_peri.errors import exit_status
from warp_peri.points.arguments import Count, NotNegative

H, HORIZON, DENSITY, LAM, MU = 5.0, 3, 2200.0, 0.3, 0.5  # Å, spacings, kg/m³, TPa, TPa
DISCS = (((-14, 10), 8, (1.5, 1.4)), ((12, 12), 7, (0.6, 1.3)), ((4, -14), 9, (1.35, 0.6)))
"""Middle and radius of each inclusion in spacings of 64 nodes, and its κ and μ over the plate's."""
EDGES, BLUNT = 1e-3, 0.05  # weight of the maps' variation, and where its kink is rounded


def plate(side: int) -> tuple[Any, np.ndarray, torch.Tensor]:
    """The operator, held around side² nodes; places in spacings [N, 2]; maps of κ and μ [2, N]."""
    pad = 2 * HORIZON
    x = np.argwhere(np.ones((side + 2 * pad,) * 2)) - pad - (side - 1) / 2
    points = wp.Points(H * x, np.abs(x).max(axis=1) < side / 2, H)
    maps = torch.ones(2, len(x), dtype=torch.float64)
    for middle, radius, inside in DISCS:
        away = torch.from_numpy(np.linalg.norm(x * 64 / side - middle, axis=-1))
        more = torch.tensor(inside, dtype=maps.dtype)[:, None] - 1
        maps += more * torch.sigmoid((radius - away) / 0.75)
    solid = wp.LPSMaterial(LAM, MU, 1.0, np.ones(1), HORIZON * H, certified_on=(H,))
    return solid.on(points, lam=np.full(len(x), LAM), mu=np.full(len(x), MU)), x, maps


def shot(body: Any, x: np.ndarray, side: int) -> Callable[[torch.Tensor], torch.Tensor]:
    """What the ring hears of a knock in one corner, of a plate with given maps."""
    at_rest = wp.Dirichlet(body.points, None, 0 * x)
    knock = np.exp(-np.square(x - side * np.array([-0.36, -0.28])).sum(axis=1) / 8)
    longest = 2 * np.sqrt(1e-8 * DENSITY / body.max_symbol_eigenvalue())
    options = {
        "v": (body.points.interior * knock)[:, None] * [1, 0.6],
        "density": DENSITY,
        "step": 0.6 * longest,
        "steps": 4 * side,
        "record": np.abs(np.abs(x).max(axis=1) - side / 2 + 3.5) < 0.1,
    }

    def heard(maps: torch.Tensor) -> Any:
        moduli = {"lam": (LAM + MU) * maps[0] - MU * maps[1], "mu": MU * maps[1]}
        return wp.simulate(body, at_rest, **options, parameters=moduli)["u"]

    return heard


def variation(z: torch.Tensor) -> torch.Tensor:
    """The mean length of the gradient of both maps."""
    width = round(z.shape[1] ** 0.5)
    z = z.reshape(2, width, width)
    steps = z.diff(dim=1)[:, :, 1:].square() + z.diff(dim=2)[:, 1:].square()
    return (steps + BLUNT**2).sqrt().mean()


def main(arguments: list[str] | None = None) -> int:
    options = {
        "side": (64, "unknown nodes along a side", at_least(8)),
        "noise": (0.01, "over the mean size of the data", NotNegative),
        "iterations": (40, "of L-BFGS, at most", Count),
    }
    given = Options(__doc__, options=options).parse_args(arguments)
    body, x, true = plate(given.side)
    heard, inside = shot(body, x, given.side), torch.tensor(body.points.interior)
    with torch.no_grad():
        data = heard(true)
    size, random = data.square().mean().sqrt(), np.random.default_rng(0)
    data += given.noise * size * torch.from_numpy(random.normal(size=data.shape))

    # ln of the maps from an even plate on, until the ring hears the same; few edges are preferred
    z = torch.zeros_like(true, requires_grad=True)
    how = {"max_iter": given.iterations, "history_size": 20, "line_search_fn": "strong_wolfe"}
    search, misfits = torch.optim.LBFGS([z], **how), list[float]()

    def loss() -> torch.Tensor:
        search.zero_grad()
        log_of_all = torch.where(inside, z, 0.0)
        misfit = (heard(log_of_all.exp()) - data).square().mean() / size**2
        whole = misfit + EDGES * variation(log_of_all)
        whole.backward()
        misfits.append(float(misfit.detach().sqrt()))
        return whole

    search.step(loss)
    found, true = z.detach().exp()[:, inside], true[:, inside]
    errors, at_start = ((m - true).norm(dim=1) / true.norm(dim=1) for m in (found, 1))
    names = "κ", "μ", "κ at start", "μ at start", "misfit", "shots"
    values = *errors.tolist(), *at_start.tolist(), misfits[-1], len(misfits)
    print(json.dumps(dict(zip(names, values)), ensure_ascii=False))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
