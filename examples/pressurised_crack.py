"""A fluid opens a crack: the opening against Sneddon's, and growth at the fluid's balance.

The load is minus the force that the missing bonds would carry.
"""

import json
import sys
from os.path import realpath
from typing import Annotated

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])

import numpy as np

import warp_peri as wp
from examples.exact import sneddon_opening, westergaard
from examples.figures import check_place, panels, save_figure
from tools.options import Options, at_least
from warp_peri import fracture
from warp_peri.errors import exit_status
from warp_peri.points.arguments import REDUCED, Bound

HALF, RATIO, TOUGHNESS = 0.5, 3.0, 0.01
GROWTH = Annotated[int, Bound("0, or a whole number ≥ 4", lambda n: n == 0 or n >= 4)]


def square(cells: int, lam: float):
    """The solid and its points, at spacing 1/cells."""
    h = 1 / cells
    model = wp.LPSMaterial(
        lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=RATIO * h, units=REDUCED
    )
    side = 2 * (1 + 2 * RATIO * h)
    x = fracture.rectangle_nodes(side, side, h)
    solid = fracture.BrittleMaterial(model, 1.0, toughness=TOUGHNESS)
    return solid, wp.Points(x, (np.abs(x) <= 1).all(axis=1), h, units=REDUCED)


def opening(cells: int, lam: float = 1.0):
    """Opening and its volume over Sneddon's under unit pressure, and the row above the crack."""
    solid, points = square(cells, lam)
    x, h = points.x, points.spacing
    exact = westergaard(x, HALF, 1.0, lam, 1.0) - x / (2 * (lam + 1))
    crack, fluid = [(-HALF, 0), (HALF, 0)], np.diag([0.0, 1.0])
    solution = wp.solve(solid, fracture.Cracked(points, u=exact, cracks=[crack], pressure=fluid))
    u = solution.u
    row = (np.abs(x[:, 1] - h / 2) < h / 4) & (np.abs(x[:, 0]) < HALF)
    expected = sneddon_opening(x[row, 0], HALF, 1.0, lam, 1.0)
    inner = np.abs(x[row, 0]) < 0.8 * HALF
    whole = np.pi * HALF * sneddon_opening(0.0, HALF, 1.0, lam, 1.0)
    numbers = {
        "opening": float(np.mean((u[row, 1] / expected)[inner])),
        "volume": float(fracture.crack_opening_volume(solution) / whole),
    }
    return numbers, (x[row, 0], u[row, 1], expected)


def main(argv: list[str] | None = None) -> int:
    options = {
        "cells": ([8, 16, 32], "per unit length", at_least(4)),
        "growth": (16, "cells of the growing crack, 0: none", GROWTH),
    }
    args = Options(__doc__, "pressurised_crack", options=options).parse_args(argv)
    numbers: dict = {"over Sneddon": {}}
    picture = check_place(args.out / "opening.png")
    figure, (left, right) = panels(9, 4, count=2)
    for cells in args.cells:
        numbers["over Sneddon"][f"L/{cells}"], (place, opened, expected) = opening(cells)
        left.plot(place, opened, ".", label=f"L/{cells}")
    left.plot(place, expected, "k", linewidth=0.8, label="Sneddon")
    left.set(xlabel="x₁", ylabel="u₂ above the crack, p = 1")
    left.legend(frameon=False)
    if args.growth:
        solid, points = square(args.growth, 1.0)
        halves = [k / args.growth for k in range(2, args.growth // 2 + 1)]
        run = wp.simulate(solid, fracture.Injected(points, halves, leak=0.001))
        exact = np.sqrt(solid.model.E * TOUGHNESS / (np.pi * run["half"]))  # of an endless plane
        numbers["growth"] = {name: value.tolist() for name, value in run.history.items()}
        numbers["growth"]["pressure over the plane's"] = (run["pressure"] / exact).tolist()
        right.plot(run["pumped"], run["pressure"], "o-", label="square, edges held")
        right.plot(run["pumped"], exact, "k", linewidth=0.8, label="plane")
        right.set(xlabel="volume pumped", ylabel="pressure")
        right.legend(frameon=False)
    save_figure(figure, picture, dpi=120)
    print(json.dumps(numbers, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
