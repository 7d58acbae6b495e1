"""A crack at rest in a plane under tension: opening, energy release and J against the exact ones.

Westergaard's field is given on the collar; the bonds across the crack are cut. With --edge cracks
run in from the edge of a strip that dead loads pull at.
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import warp_peri as wp
from examples.exact import westergaard
from examples.figures import panels
from tools.options import Options
from warp_peri import damage
from warp_peri.damage import energy_release, tip_shift
from warp_peri.errors import exit_status

REDUCED = ("sigma", "epsilon/sigma^3")
"""Units of numbers that have none."""
HALF = 0.5
"""Half the crack's length; the square is 2 × 2."""


def static_crack(cells: int, ratio: float, lam: float) -> tuple[dict[str, float], tuple]:
    """Relative errors at spacing 1/cells and horizon ratio/cells, and what the picture needs."""
    h = 1 / cells
    model = wp.Model(lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio * h, units=REDUCED)
    side = 2 * (1 + 2 * int(np.ceil(ratio)) * h)
    x = damage.rectangle(side, side, h)
    points = wp.Points(x, (np.abs(x) <= 1).all(axis=1), h, units=REDUCED)
    exact = westergaard(x, HALF, 1.0, lam, 1.0)
    crack = damage.Cracked(points, u=exact, cracks=[[(-HALF, 0), (HALF, 0)]])
    solution = wp.solve(model, crack)
    u = solution.u
    longer, shorter = ([[(-HALF - d, 0), (HALF + d, 0)]] for d in (h, -h))
    G = energy_release(model, crack, (shorter, longer))
    J = damage.contour_integral(solution, (HALF, 0.0), (0.2, 0.4))
    face = (np.abs(x[:, 1] - h / 2) < h / 4) & (np.abs(x[:, 0]) < 0.8 * HALF)
    expected = np.pi * HALF / model.E
    inside = points.interior
    off = np.linalg.norm((u - exact)[inside]) / np.linalg.norm(exact[inside])
    numbers = {
        "displacement": float(off),
        "G": G / expected - 1,
        "J": J / expected - 1,
        "opening": float(np.mean(u[face, 1] / exact[face, 1])) - 1,
    }
    return numbers, (x, u, exact, h)


def edge_crack(
    model: wp.Model,
    n: int,
    share: float,
    shift: float = 0.0,
    start: float = 0,
    *,
    corrected: bool = False,
) -> float:
    """G over the exact one of a crack, n spacings of 1 long, in the edge of a strip that is pulled.

    `share` is the crack's of the strip's width; B. Gross and J. E. Srawley, 1965, within 0.5 %.
    Corrected: missing bonds take the mean gradient, and five lengths are compared for three.
    """
    width = round(n / share)
    height = 3 * width
    x = damage.rectangle(width, height, 1.0)
    back = np.flatnonzero(x[:, 0] == x[:, 0].max())
    middle = back[np.argsort(np.abs(x[back, 1]))[:2]]
    free = np.ones(x.shape, bool)
    free[middle[0]], free[middle[1], 0] = False, False  # not loose, and nothing else
    b = np.where(np.abs(x[:, 1:]) > height / 2 - 1, np.sign(x) * (0.0, 1.0), 0.0)
    points, reach = wp.Points(x, np.ones(len(x), bool), 1.0, units=REDUCED), 1 + corrected
    strip = damage.Cracked(points, b, free=free, corrected=corrected)
    ends = range(-reach, reach + 1)
    cracks = [[[(start - width / 2, 0), (n + d - width / 2, 0)]] for d in ends]
    shape = np.polyval([30.382, -21.71, 10.55, -0.231, 1.122], share)
    G = energy_release(model, strip, cracks, shift=shift)
    return float(G * model.E / (np.pi * n * shape**2))


def edge_cracks(lam: float) -> dict[str, dict[str, list[float]]]:
    """Errors of G as cut, with the shift of the tip, and corrected, by length and horizon."""
    table: dict[str, dict[str, list[float]]] = {}
    for ratio in (2.0, 3.0, 4.0):
        model = wp.Model(lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio, units=REDUCED)
        shift, other = (tip_shift(model, 1.0, corrected=one) for one in (False, True))
        row = table[f"horizon {ratio:g}h, shift {shift:.3f}h"] = {}
        for n in (6, 13, 26):
            for share in (0.25, 0.5):
                off = [edge_crack(model, n, share, by) - 1 for by in (0.0, shift)]
                off.append(edge_crack(model, n, share, other, corrected=True) - 1)
                row[f"a = {n}h, {share:g} of the strip"] = off
    return table


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "static_crack", json=True)
    parser.add("--cells", type=int, nargs="+", default=[8, 16, 32], help="per unit length")
    parser.add("--ratio", type=float, default=3.0, help="horizon over spacing")
    parser.add("--lam", type=float, default=1.0, help="λ, with μ = 1")
    parser.add("--growth", action="store_true", help="also what a growing crack spends")
    parser.add("--edge", action="store_true", help="G of cracks from an edge instead")
    args = parser.parse_args(argv)
    if min(args.cells) < 4:
        parser.error(f"--cells: expected numbers ≥ 4, got {args.cells}")
    if args.edge:
        print(json.dumps(edge_cracks(args.lam), indent=None if args.json else 1))
        return 0
    table = {}
    for cells in args.cells:
        table[f"L/{cells}"], (x, u, exact, h) = static_crack(cells, args.ratio, args.lam)
    if args.growth:
        model = wp.Model(
            lam=args.lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=args.ratio, units=REDUCED
        )
        table["growth"] = {"apparent_toughness": damage.apparent_toughness(model, 1.0)}
    print(json.dumps(table) if args.json else json.dumps(table, indent=1))
    figure, (left, right) = panels(9, 4, count=2)
    shown = left.scatter(*(x + 0.1 * u).T, c=u[:, 1], s=2, cmap="RdBu")
    left.set(aspect="equal", title="displacement u₂, drawn 0.1 times")
    figure.colorbar(shown, ax=left)
    row = (np.abs(x[:, 1] - h / 2) < h / 4) & (np.abs(x[:, 0]) < 1)
    right.plot(x[row, 0], u[row, 1], "o", markersize=3, label="peridynamic")
    right.plot(x[row, 0], exact[row, 1], "k", linewidth=0.8, label="Westergaard")
    right.set(xlabel="x₁", ylabel="u₂ above the crack", title=f"L/{args.cells[-1]}")
    right.legend(frameon=False)
    figure.savefig(args.out / "crack.png", dpi=120)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
