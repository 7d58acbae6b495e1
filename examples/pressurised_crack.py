"""A fluid opens a crack: the opening against Sneddon's, and growth at the fluid's balance.

The load is minus the force that the missing bonds would carry.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from matplotlib.figure import Figure

from warp_peri import Model
from warp_peri.damage.cut_solid import CutSolid, westergaard
from warp_peri.damage.lattice_body import cracked, lattice_body, rectangle
from warp_peri.damage.pressurised import crack_load, inject, opening_volume, sneddon_opening
from warp_peri.errors import exit_status

HALF, RATIO, TOUGHNESS = 0.5, 3.0, 0.01


def square(cells: int, lam: float):
    """The solid, its body, what is held, at spacing 1/cells."""
    h = 1 / cells
    model = Model(lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=RATIO * h)
    side = 2 * (1 + 2 * RATIO * h)
    body = lattice_body(rectangle(side, side, h), h, model.horizon)
    return model, body, (np.abs(body.x) > 1).any(axis=1)


def opening(cells: int, lam: float = 1.0):
    """Opening and its volume over Sneddon's under unit pressure, and the row above the crack."""
    model, body, held = square(cells, lam)
    x, h = body.x, body.spacing
    exact = westergaard(x, HALF, 1.0, lam, 1.0) - x / (2 * (lam + 1))
    neighbour = cracked(body, [[(-HALF, 0), (HALF, 0)]])
    load = crack_load(model, body, neighbour, np.diag([0.0, 1.0]))
    u = CutSolid(model, body, held, neighbour=neighbour).solve(exact, load)
    row = (np.abs(x[:, 1] - h / 2) < h / 4) & (np.abs(x[:, 0]) < HALF)
    expected = sneddon_opening(x[row, 0], HALF, 1.0, lam, 1.0)
    inner = np.abs(x[row, 0]) < 0.8 * HALF
    whole = np.pi * HALF * sneddon_opening(0.0, HALF, 1.0, lam, 1.0)
    numbers = {
        "opening": float(np.mean((u[row, 1] / expected)[inner])),
        "volume": float(opening_volume(body, u, neighbour) / whole),
    }
    return numbers, (x[row, 0], u[row, 1], expected)


def main(argv: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="+", default=[8, 16, 32], help="per unit length")
    parser.add_argument(
        "--growth", type=int, default=16, help="cells of the growing crack, 0: none"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "pressurised_crack")
    parser.add_argument("--json", action="store_true", help="print the numbers as one object")
    args = parser.parse_args(argv)
    if min(args.cells) < 4:
        parser.error(f"--cells: expected numbers ≥ 4, got {args.cells}")
    numbers: dict = {"over Sneddon": {}}
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for cells in args.cells:
        numbers["over Sneddon"][f"L/{cells}"], (place, opened, expected) = opening(cells)
        left.plot(place, opened, ".", label=f"L/{cells}")
    left.plot(place, expected, "k", linewidth=0.8, label="Sneddon")
    left.set(xlabel="x₁", ylabel="u₂ above the crack, p = 1")
    left.legend(frameon=False)
    if args.growth:
        model, body, held = square(args.growth, 1.0)
        halves = [k / args.growth for k in range(2, args.growth // 2 + 1)]
        stages = inject(model, body, held, halves, TOUGHNESS, leak=0.001)
        exact = np.sqrt(model.E * TOUGHNESS / (np.pi * stages.half))  # of a plane without an end
        numbers["growth"] = {name: value.tolist() for name, value in vars(stages).items()}
        numbers["growth"]["pressure over the plane's"] = (stages.pressure / exact).tolist()
        right.plot(stages.pumped, stages.pressure, "o-", label="square, edges held")
        right.plot(stages.pumped, exact, "k", linewidth=0.8, label="plane")
        right.set(xlabel="volume pumped", ylabel="pressure")
        right.legend(frameon=False)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "opening.png", dpi=120)
    print(json.dumps(numbers, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
