"""Stiffness maps of a plate from one shot of waves, heard at its rim: torch through `move`.

The same model makes the data, noise of 1 % is added. The fit begins with an even plate.

python examples/waves_to_map.py           numbers, and a picture in runs/waves_to_map
python examples/waves_to_map.py --json    error of the worse map, seconds, and more
"""

import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

import warp_peri as wp
from examples.figures import panels, shown
from warp_peri.core.elastic import plane_isotropic
from warp_peri.dressed import DressedSolid
from warp_peri.errors import exit_status

SIDE, H, DENSITY, NOISE = 64, 5.0, 2200.0, 0.01  # nodes, Å, kg/m³
DISCS = (((-14, 10), 8, (1.5, 1.4)), ((12, 12), 7, (0.6, 1.3)), ((4, -14), 9, (1.35, 0.6)))
"""Middle and radius of each inclusion in spacings, and its κ and μ over those of the plate."""
X = np.stack(np.meshgrid(*2 * [np.arange(SIDE) - (SIDE - 1) / 2], indexing="ij"), axis=-1)
"""Places of nodes in spacings, [SIDE, SIDE, 2]."""


def plate() -> tuple[Any, torch.Tensor]:
    """A plate with free edges, λ = 0.3 and μ = 0.5 TPa, and maps of κ and μ, [2, SIDE, SIDE]."""
    dressing = np.full((1, 2, 1, 1), 0.03) * np.eye(2)
    law = DressedSolid(H, "elements", plane_isotropic(0.3, 0.5), np.eye(2, dtype=int), dressing)
    points = wp.Points(H * X.reshape(-1, 2), np.ones(SIDE**2, bool), H, axis=0.0)
    maps = torch.ones(2, SIDE, SIDE, dtype=torch.float64)
    for middle, radius, inside in DISCS:
        away = torch.from_numpy(np.linalg.norm(X - middle, axis=-1))
        more = torch.tensor(inside, dtype=maps.dtype)[:, None, None] - 1
        maps += more * torch.sigmoid((radius - away) / 0.75)
    return law.on(points, edges=True), maps


def maps_from_waves(seed: int, iterations: int) -> tuple[dict[str, float], Any]:
    """Errors of the maps of κ and μ, other numbers, and a picture."""
    # a knock in one corner, and what the rim hears of it through given maps
    (body, true), x = plate(), X.reshape(-1, 2)
    at_rest = wp.Dirichlet(body.points, None, 0 * x)
    knock = np.exp(-np.square(x - [-28, -20]).sum(axis=1) / 8)[:, None] * [1, 0.6]
    step = 0.6 * wp.proofs.critical_time_step(body.model.certified(), spacing=H, density=DENSITY)
    shot = {"v": knock - knock.mean(axis=0), "density": DENSITY, "step": step, "steps": 250}
    shot["record"] = np.abs(x).max(axis=1) > SIDE / 2 - 1

    def heard(maps: torch.Tensor) -> Any:
        parameters = {"bulk": maps[0], "shear": maps[1]}
        return wp.move(body, at_rest, **shot, parameters=parameters)["u"]

    data = heard(true)
    size, random = data.square().mean().sqrt(), np.random.default_rng(seed)
    data = data + NOISE * size * torch.from_numpy(random.normal(size=data.shape))

    # ln of the maps from an even plate on, until the rim hears the same; few edges are preferred
    z = torch.zeros_like(true, requires_grad=True)
    search = torch.optim.LBFGS([z], 1, iterations, history_size=20, line_search_fn="strong_wolfe")
    misfits, begin = list[float](), time.perf_counter()

    def loss() -> torch.Tensor:
        search.zero_grad()
        misfit = (heard(z.exp()) - data).square().mean() / size**2
        edges = z.diff(dim=1)[:, :, 1:].square() + z.diff(dim=2)[:, 1:].square()
        whole = misfit + 1e-3 * (edges + 0.05**2).sqrt().mean()
        whole.backward()
        misfits.append(float(misfit.detach().sqrt()))
        return whole

    search.step(loss)
    seconds, found = time.perf_counter() - begin, z.detach().exp()
    start, end = ((maps - true).norm(dim=(1, 2)) / true.norm(dim=(1, 2)) for maps in (1, found))
    numbers = {"error": float(end.max()), "seconds": seconds, "error at start": float(start.max())}
    numbers |= {"bulk": float(end[0]), "shear": float(end[1]), "misfit": misfits[-1]}
    return numbers | {"gradients": len(misfits)}, picture(true, found)


def picture(true: torch.Tensor, found: torch.Tensor) -> Any:
    """Maps of κ and μ, true and found."""
    figure, axes = panels(6.4, 6, count=2, rows=2, sharex=True, sharey=True)
    rim = [-H * SIDE / 2, H * SIDE / 2]
    for row, name, *pair in zip(axes, "κμ", true, found):
        for ax, one, what in zip(row, pair, ("true", "from waves")):
            shade = ax.imshow(one.T, vmin=0.5, vmax=1.6, origin="lower", extent=2 * rim)
            ax.set_title(f"{name}, {what}")
    figure.colorbar(shade, ax=axes, label="modulus over that of the plate")
    figure.supxlabel("position [Å]")
    return figure


def main(args: list[str] | None = None) -> int:
    """Write the picture and print the numbers."""
    options = {"seed": (0, "of the noise"), "iterations": (60, "of L-BFGS")}
    return shown(__doc__, "waves_to_map", maps_from_waves, args, **options)


if __name__ == "__main__":
    sys.exit(exit_status(main))
