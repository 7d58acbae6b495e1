"""Strength and toughness of bonds from one test: a notched plate is pulled, its force is measured.

The same model makes the data, noise of 1 % is added. Bonds soften beyond a stretch, so that the
force is differentiable through all that breaks: torch through `move`.

python examples/toughness_from_crack.py           numbers, and a picture
python examples/toughness_from_crack.py --json    errors of toughness and strength, seconds
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

import warp_peri as wp
from examples.figures import name_lines, panels, save_figure
from tools.options import Options
from warp_peri.damage import BondLaw, SoftSolid, lattice_body
from warp_peri.damage.operator import unit_toughness
from warp_peri.errors import exit_status

SIZE, HORIZON, NOISE = (24, 16), 3.0, 0.01
TRUE, GUESS = {"stretch": 0.02, "tail": 0.2}, {"stretch": 0.026, "tail": 0.13}
MODEL = wp.Model(1.0, 1.0, 1.0, np.ones(1), HORIZON, units=("mm", "GPa"))
LOADS, GRIP = np.linspace(0.2, 1.0, 9), 0.23
"""Shares of the largest displacement of a grip, and that [mm]."""


def plate() -> tuple[wp.Cracked, np.ndarray, float]:
    """The notched plate, nodes in the grips, whose bonds hold, and G_c of bonds with s₀ = 1."""
    x = np.argwhere(np.ones(SIZE)) - (np.array(SIZE) - 1) / 2
    grips = np.abs(x[:, 1]) > SIZE[1] / 2 - HORIZON
    u = np.column_stack([0 * x[:, 0], GRIP * np.sign(x[:, 1]) * grips])
    points = wp.Points(x, ~grips, 1.0, units=MODEL.units)
    notch = [[(-SIZE[0] / 2, 0.0), (-SIZE[0] / 4, 0.0)]]
    unit = unit_toughness(MODEL, lattice_body(x, 1.0, HORIZON).classes)
    return wp.Cracked(points, u=u, cracks=notch), grips, unit


def recovered(seed: int, iterations: int) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Forces [GPa mm] by name over LOADS, and numbers."""
    problem, grips, unit = plate()
    line = [(-SIZE[0] / 2, 0.0), (SIZE[0] / 2, 0.0)]

    def force(numbers: dict) -> Any:
        solid = SoftSolid(MODEL, BondLaw(0.0, **TRUE))
        how = {"loads": LOADS, "line": line, "no_fail": grips, "stop": 0.0}
        return wp.move(solid, problem, parameters=numbers, **how)["force"]

    def toughness(numbers: dict) -> float:
        return 2 * unit * BondLaw(0.0, **{n: float(v) for n, v in numbers.items()}).spent()

    clean = force({n: torch.tensor(v) for n, v in TRUE.items()}).numpy()
    data = clean + NOISE * clean.max() * np.random.default_rng(seed).normal(size=clean.shape)
    z = torch.tensor([np.log(v) for v in GUESS.values()], requires_grad=True)
    search = torch.optim.LBFGS([z], 1.0, iterations, line_search_fn="strong_wolfe")
    told: list[np.ndarray] = []

    def loss() -> torch.Tensor:
        search.zero_grad()
        found = force(dict(zip(TRUE, z.exp())))
        told.append(found.detach().numpy())
        short = min(len(found), len(data))
        wrong = ((found[:short] - torch.from_numpy(data[:short])) / data.max()).square().mean()
        wrong.backward()
        return wrong

    begin = time.perf_counter()
    search.step(loss)
    numbers = {"seconds": time.perf_counter() - begin, "gradients": len(told)}
    best = dict(zip(TRUE, z.detach().exp()))
    for name, values in {"start": GUESS, "found": best, "true": TRUE}.items():
        numbers |= {
            f"toughness, {name}": toughness(values),
            f"stretch, {name}": float(values["stretch"]),
        }
    for name in ("toughness", "stretch"):
        numbers[f"error of {name}"] = abs(numbers[f"{name}, found"] / numbers[f"{name}, true"] - 1)
    rows = {"measured": data, "first guess": told[0], "found": force(best).detach().numpy()}
    return rows, numbers


def main(args: list[str] | None = None) -> int:
    """Write the picture and print the numbers."""
    options = Options(__doc__, "toughness_from_crack", json=True)
    options.add("--seed", type=int, default=0, help="of the noise")
    options.add("--iterations", type=int, default=15, help="of L-BFGS")
    given = options.parse_args(args)
    rows, numbers = recovered(given.seed, given.iterations)
    print(json.dumps(numbers, indent=None if given.json else 1))
    figure, ax = panels()
    for style, (name, row) in zip((".", ":", "-"), rows.items()):
        ax.plot(2 * GRIP * LOADS[: len(row)], row, style, label=name)
    ax.set(xlabel="displacement of the grips [mm]", ylabel="force over thickness [GPa mm]")
    ax.set_title("The toughness that is found follows the measured force")
    name_lines(ax)
    save_figure(figure, given.out / "toughness_from_crack.png")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
