"""Strength and toughness of bonds from one test: a notched plate is pulled, its force is measured.

The same model makes the data, noise of 1 % is added. Bonds soften beyond a stretch, so that the
force is differentiable through all that breaks: torch through `simulate`. Draws a picture.
"""

import json
import sys
import time
from os.path import realpath
from typing import Any

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])

import numpy as np
import torch

import warp_peri as wp
from examples.figures import check_place, panels, save_figure
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.fracture import BondLaw, SofteningMaterial, rectangle_nodes
from warp_peri.points.arguments import Count, Natural

TRUE, GUESS = BondLaw(0.0, stretch=0.02, tail=0.2), BondLaw(0.0, stretch=0.026, tail=0.13)
WIDE, HIGH, HORIZON, NOISE = 24, 16, 3.0, 0.01  # mm
LOADS, GRIP = np.linspace(0.2, 1.0, 9), 0.23
"""Shares of the largest displacement of a grip, and that [mm]."""


def toughness_from_force(seed: int, iterations: int) -> tuple[dict[str, float], Any]:
    """Errors of toughness and strength, other numbers, and a picture."""
    # a plate with a notch, whose upper and lower rows are held by grips
    model = wp.LPSMaterial(1.0, 1.0, 1.0, np.ones(1), HORIZON, units=("mm", "GPa"))
    x = rectangle_nodes(WIDE, HIGH, 1.0)
    grips = np.abs(x[:, 1]) > HIGH / 2 - HORIZON
    apart = GRIP * (np.sign(x) * grips[:, None]) * [0, 1]
    notch, across = ([(-WIDE / 2, 0.0), (end, 0.0)] for end in (-WIDE / 4, WIDE / 2))
    points = wp.Points(x, ~grips, 1.0, units=model.units)
    plate = wp.Cracked(points, u=apart, cracks=[notch])
    pull: dict[str, Any] = {"loads": LOADS, "line": across, "no_fail": grips, "stop": 0.0}

    def force(stretch: Any, tail: Any) -> Any:
        solid, numbers = SofteningMaterial(model, TRUE), {"stretch": stretch, "tail": tail}
        return wp.simulate(solid, plate, parameters=numbers, **pull)["force"]

    data = force(TRUE.stretch, TRUE.tail)
    noise = np.random.default_rng(seed).normal(size=len(data))
    data = data + NOISE * data.max() * torch.from_numpy(noise)

    # ln of strength and tail, from a guess on, until the plate pulls as it did
    z = torch.tensor([GUESS.stretch, GUESS.tail], dtype=torch.float64).log().requires_grad_()
    search = torch.optim.LBFGS([z], 1.0, iterations, line_search_fn="strong_wolfe")
    told, begin = list[torch.Tensor](), time.perf_counter()

    def loss() -> torch.Tensor:
        search.zero_grad()
        told.append(force(*z.exp()))
        wrong = ((told[-1] - data[: len(told[-1])]) / data.max()).square().mean()
        wrong.backward()
        return wrong

    search.step(loss)
    numbers = {"seconds": time.perf_counter() - begin, "gradients": len(told)}
    best = BondLaw(0.0, *z.detach().exp().tolist())
    for name, law in {"start": GUESS, "found": best, "true": TRUE}.items():
        numbers |= {f"toughness, {name}": SofteningMaterial(model, law).toughness(1.0)}
        numbers |= {f"stretch, {name}": law.stretch}
    for name in ("toughness", "stretch"):
        numbers[f"error of {name}"] = abs(numbers[f"{name}, found"] / numbers[f"{name}, true"] - 1)
    rows = {"measured": data, "first guess": told[0], "found": force(best.stretch, best.tail)}
    return numbers, picture(rows)


def picture(rows: dict[str, torch.Tensor]) -> Any:
    """Forces over the displacement of the grips."""
    figure, ax = panels()
    for style, (name, row) in zip((".", ":", "-"), rows.items()):
        ax.plot(2 * GRIP * LOADS[: len(row)], row.detach(), style, label=name)
    ax.set(xlabel="displacement of the grips [mm]", ylabel="force over thickness [GPa mm]")
    ax.set_title("Strength and toughness of bonds follow from one pull")
    ax.legend()
    return figure


def main(args: list[str] | None = None) -> int:
    """Write the picture and print the numbers."""
    options = {"seed": (0, "of the noise", Natural), "iterations": (15, "of L-BFGS", Count)}
    given = Options(__doc__, "toughness_from_crack", options=options).parse_args(args)
    place = check_place(given.out / "toughness_from_crack.png")
    numbers, figure = toughness_from_force(given.seed, given.iterations)
    print(json.dumps(numbers, indent=1))
    save_figure(figure, place)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
