"""Stiffness maps of a plate from one shot of waves, heard at its rim: torch through `move`.

The same model makes the data, noise of 1 % is added. The fit begins with an even plate.

python examples/waves_to_map.py           numbers, and a picture in runs/waves_to_map
python examples/waves_to_map.py --json    error of the worse map, seconds, and more
"""

import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

import warp_peri as wp
from examples.figures import headline, panels, save_figure
from tools.options import Options
from warp_peri.dressed import DressedSolid
from warp_peri.errors import exit_status

SIDE, SPACING, DENSITY, NOISE = 64, 5.0, 2200.0, 0.01
DISCS = ((-14, 10, 8), (12, 12, 7), (4, -14, 9))
"""Middles and radii of the inclusions, in spacings; each map has other moduli there."""
INSIDE = {"bulk": (1.5, 0.6, 1.35), "shear": (1.4, 1.3, 0.6)}
EDGES, SMALLEST = 1e-3, 0.05
"""Weight of the total variation of ln(map), and a slope below which it is a square."""


def plate() -> tuple[DressedSolid, wp.Points, dict[str, np.ndarray]]:
    """An isotropic solid with λ = 0.3 and μ = 0.5 TPa, its nodes, and the true maps, [N] each."""
    elastic = np.array([[1.3, 0.3, 0], [0.3, 1.3, 0], [0, 0, 0.5]])
    dressing = 0.03 * np.ones((1, 2, 1, 1)) * np.eye(2)
    law = DressedSolid(SPACING, "elements", elastic, np.eye(2, dtype=int), dressing)
    x = np.argwhere(np.ones((SIDE, SIDE))) - (SIDE - 1) / 2
    maps = {name: np.ones(len(x)) for name in INSIDE}
    for number, (*middle, radius) in enumerate(DISCS):
        depth = 1 / (1 + np.exp((np.linalg.norm(x - middle, axis=1) - radius) / 0.75))
        for name, inside in INSIDE.items():
            maps[name] += (inside[number] - 1) * depth
    return law, wp.Points(SPACING * x, np.ones(len(x), bool), SPACING, axis=0.0), maps


def recovered(seed: int, iterations: int) -> tuple[wp.Points, dict, dict, dict[str, float]]:
    """Nodes, true maps and found ones, [N] each, and numbers."""
    law, points, true = plate()
    h, x = SPACING, points.x
    rim = np.abs(x).max(axis=1) > (SIDE / 2 - 1) * h
    knock = np.exp(-np.square(x - [-28 * h, -20 * h]).sum(axis=1) / (8 * h**2))[:, None] * [1, 0.6]
    step = 0.6 * wp.proofs.critical_time_step(law.certified(), spacing=h, density=DENSITY)
    shot = {"v": knock - knock.mean(axis=0), "density": DENSITY, "step": step, "steps": 250}
    at_rest = wp.Dirichlet(points, None, np.zeros_like(x))
    heard = wp.move(law.on(points, edges=True, maps=true), at_rest, **shot, record=rim)["u"]
    size = np.sqrt(np.square(heard).mean())
    noisy = heard + NOISE * size * np.random.default_rng(seed).normal(size=heard.shape)
    body, data = law.on(points, edges=True), torch.from_numpy(noisy)
    z = torch.zeros(2, len(x), dtype=torch.float64, requires_grad=True)  # ln of the maps
    search = torch.optim.LBFGS([z], 1, iterations, history_size=20, line_search_fn="strong_wolfe")
    misfits, clock = list[float](), np.zeros(2)  # seconds there and back

    def loss() -> torch.Tensor:
        search.zero_grad()
        begin = time.perf_counter()
        maps = dict(zip(true, z.exp()))
        told = wp.move(body, at_rest, **shot, record=rim, parameters=maps)["u"]
        misfit = ((told - data) ** 2).mean() / size**2
        y = z.reshape(2, SIDE, SIDE)
        square = (y[:, 1:, 1:] - y[:, :-1, 1:]) ** 2 + (y[:, 1:, 1:] - y[:, 1:, :-1]) ** 2
        whole = misfit + EDGES * (square + SMALLEST**2).sqrt().mean()
        end = time.perf_counter()
        whole.backward()
        clock[:] += end - begin, time.perf_counter() - end
        misfits.append(float(misfit.detach().sqrt()))
        return whole

    begin = time.perf_counter()
    search.step(loss)
    seconds = time.perf_counter() - begin
    found = dict(zip(true, z.detach().exp().numpy()))
    norm = np.linalg.norm
    errors = {name: float(norm(found[name] - true[name]) / norm(true[name])) for name in true}
    start = max(float(norm(1 - one) / norm(one)) for one in true.values())
    numbers = {"error": max(errors.values()), "seconds": seconds, **errors, "error at start": start}
    numbers |= {"misfit": misfits[-1], "gradients": len(misfits)}
    return points, true, found, numbers | {"backward over forward": float(clock[1] / clock[0])}


def main(args: list[str] | None = None) -> int:
    """Write the picture and print the numbers."""
    options = Options(__doc__, "waves_to_map", json=True)
    options.add("--seed", type=int, default=0, help="of the noise")
    options.add("--iterations", type=int, default=60, help="of L-BFGS")
    given = options.parse_args(args)
    points, true, found, numbers = recovered(given.seed, given.iterations)
    print(json.dumps(numbers, indent=None if given.json else 1))
    figure, axes = panels(6.4, 6, count=2, rows=2, sharex=True, sharey=True)
    for row, name, sign in zip(axes, true, "κμ"):
        for ax, maps, what in zip(row, (true, found), ("true", "from waves")):
            shown = ax.scatter(*points.x.T, c=maps[name], s=5, marker="s", vmin=0.5, vmax=1.6)
            ax.set(title=f"{sign}, {what}", aspect="equal")
    figure.colorbar(shown, ax=axes, label="modulus over that of the plate")
    figure.supxlabel("position [Å]")
    headline(figure, "Waves through the plate find its inclusions, in κ and in μ")
    save_figure(figure, given.out / "maps.png")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
