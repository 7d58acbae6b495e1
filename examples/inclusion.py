"""A round inclusion of another material under equal strain: errors and orders, in plane or space.

Bonds add the compliances of μ along them, balls those of λ − μ; the exact field is on the collar.
"""

import json
import sys
from pathlib import Path

REDUCED = ("sigma", "epsilon/sigma^3")
"""Units of numbers that have none."""
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from matplotlib.axes import Axes

import warp_peri as wp
from examples.cracks.inclusions import MEANS, Mixed
from examples.figures import headline, name_lines, panels, save_figure, ticks
from tools.options import Options
from warp_peri import Cracked
from warp_peri.damage import box
from warp_peri.errors import exit_status

RADIUS = 0.5
RATIO = {2: 3.0, 3: 2.0}
CELLS = {2: [8, 16, 32], 3: [4, 6]}
CASES = {
    "stiff in soft": ((30.0, 10.0), (1.5, 1.0)),
    "soft in stiff": ((1.5, 1.0), (30.0, 10.0)),
    "nearly incompressible inside": ((500.0, 1.0), (1.5, 1.0)),
    "nearly incompressible outside": ((1.5, 1.0), (500.0, 1.0)),
    "nearly incompressible both": ((500.0, 1.0), (500.0, 2.0)),
}
"""(λ, μ) inside and outside."""


def inclusion(
    cells: int, inside: tuple, outside: tuple, mean: str = "series", ball: bool = True, d: int = 2
):
    """Relative l2 error of the displacement at spacing 1/cells, nodes, and displacement."""
    h, ratio = 1 / cells, RATIO[d]
    x = box(d * (2 * (1 + 2 * ratio * h),), h)
    points = wp.Points(x, (np.abs(x) <= 1).all(axis=1), h, units=REDUCED)

    def field(a: float, b: float):
        return lambda place: np.where(np.linalg.norm(place, axis=-1) < RADIUS, a, b)

    lam, mu = (field(*pair) for pair in zip(inside, outside))
    bulk_in, bulk_out = (d * pair[0] + 2 * pair[1] for pair in (inside, outside))
    shear = 2 * (d - 1) * outside[1]
    core = (bulk_out + shear) / (bulk_in + shear)
    radial = np.linalg.norm(x, axis=1)
    exact = x * np.where(radial < RADIUS, core, 1 + (core - 1) * (RADIUS / radial) ** d)[:, None]
    material = Mixed(ratio * h, lam, mu, mean, ball, dimension=d, units=REDUCED)
    u = wp.solve(material, Cracked(points, u=exact)).u
    free = points.interior
    off = np.linalg.norm((u - exact)[free]) / np.linalg.norm(exact[free])
    return float(off), x, u - exact


def draw(ax: Axes, x: np.ndarray, off: np.ndarray, title: str) -> None:
    """Size of an error of u, in space in a plane near the middle, and the interface."""
    plane = (np.abs(x[:, 2:]) == np.abs(x[:, 2:]).min(axis=0)).all(axis=1) & (x[:, 2:] >= 0).all(1)
    plane &= (np.abs(x) <= 1).all(axis=1)
    sides = [np.unique(x[plane, k]) for k in (0, 1)]
    size = np.linalg.norm(off[plane], axis=1).reshape(len(sides[0]), -1)
    drawn = ax.pcolormesh(*sides, size.T, cmap="magma_r", shading="nearest")
    ax.figure.colorbar(drawn, ax=ax, label="error of displacement over the strain far away")
    turn = np.linspace(0, 2 * np.pi, 200)
    ax.plot(RADIUS * np.cos(turn), RADIUS * np.sin(turn), "C0", linewidth=1)
    ax.set(aspect="equal", title=title, xlabel="x₁ [half sides]", ylabel="x₂ [half sides]")


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "inclusion", json=True)
    parser.add("--cells", type=int, nargs="+", help="per unit length")
    parser.add("--space", action="store_true", help="a ball in space, not a disk")
    parser.add("--case", choices=list(CASES), help="one of them, by default all")
    args = parser.parse_args(argv)
    d = 3 if args.space else 2
    args.cells = args.cells or CELLS[d]
    if min(args.cells) < 4 or len(set(args.cells)) < 2:
        parser.error(f"--cells: expected two numbers ≥ 4 or more, got {args.cells}")
    numbers: dict = {}
    figure, (shown, ax) = panels(9.5, 4, count=2)
    for name, materials in CASES.items():
        if args.case not in (None, name):
            continue
        numbers[name] = {}
        ways = [("series, ball", "series", True), *((mean, mean, False) for mean in MEANS)]
        for label, mean, ball in ways:
            errors = [inclusion(n, *materials, mean, ball, d)[0] for n in args.cells]
            order = -np.polyfit(np.log(args.cells), np.log(errors), 1)[0]
            numbers[name][label] = {"errors": errors, "order": float(order)}
        ax.loglog(args.cells, numbers[name]["series, ball"]["errors"], "o-", label=name)
    ax.set(xlabel="nodes per half side", ylabel="relative error of displacement")
    ticks(ax, args.cells)
    name_lines(ax)
    case = args.case or next(iter(CASES))
    _, x, off = inclusion(args.cells[-1], *CASES[case], d=d)
    draw(shown, x, off, case)
    headline(figure, "The error sits at the interface, and falls with the spacing for every pair")
    save_figure(figure, args.out / "inclusion.png")
    print(json.dumps(numbers, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
