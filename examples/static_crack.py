"""A crack in equilibrium in a plane under tension: opening, energy release and J.

    python examples/static_crack.py

Westergaard's exact field is given on the collar; the bonds across the crack are cut. Prints errors
at three spacings. `edge_crack` has a crack that runs in from the edge of a strip.
"""

import sys
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])

import numpy as np

import warp_peri as wp
from examples.exact import relative_error, westergaard
from tools.options import Options
from warp_peri import fracture
from warp_peri.errors import exit_status

UNITS = ("sigma", "epsilon/sigma^3")  # of numbers that have none
HALF = 0.5
"""Half the crack's length; the square is 2 × 2."""


def static_crack(cells: int, ratio: float, lam: float) -> dict[str, float]:
    """Relative errors at spacing 1/cells and horizon ratio/cells, μ = 1."""
    h = 1 / cells
    model = wp.LPSMaterial(lam=lam, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio * h, units=UNITS)
    side = 2 * (1 + 2 * int(np.ceil(ratio)) * h)
    x = fracture.rectangle_nodes(side, side, h)
    points = wp.Points(x, (np.abs(x) <= 1).all(axis=1), h, units=UNITS)
    exact = westergaard(x, HALF, 1.0, lam, 1.0)
    crack = fracture.Cracked(points, u=exact, cracks=[[(-HALF, 0), (HALF, 0)]])
    solution = wp.solve(model, crack)
    u = solution.u
    longer, shorter = ([[(-HALF - d, 0), (HALF + d, 0)]] for d in (h, -h))
    expected, inside = np.pi * HALF / model.E, points.interior
    face = (np.abs(x[:, 1] - h / 2) < h / 4) & (np.abs(x[:, 0]) < 0.8 * HALF)
    return {
        "displacement": relative_error(u[inside], exact[inside]),
        "G": fracture.energy_release(model, crack, (shorter, longer)) / expected - 1,
        "J": fracture.j_integral(solution, (HALF, 0.0), (0.2, 0.4)) / expected - 1,
        "opening": float(np.mean(u[face, 1] / exact[face, 1])) - 1,
    }


def edge_crack(
    model: wp.LPSMaterial, n: int, share: float, shift: float = 0.0, *, corrected: bool = False
) -> float:
    """G over the exact one of a crack, n spacings of 1 long, in the edge of a strip that is pulled.

    `share` is the crack's of the strip's width; B. Gross and J. E. Srawley, 1965, within 0.5 %.
    Corrected: missing bonds take the mean gradient, and five lengths are compared for three.
    """
    width = round(n / share)
    height = 3 * width
    x = fracture.rectangle_nodes(width, height, 1.0)
    back = np.flatnonzero(x[:, 0] == x[:, 0].max())
    middle = back[np.argsort(np.abs(x[back, 1]))[:2]]
    free = np.ones(x.shape, bool)
    free[middle[0]], free[middle[1], 0] = False, False  # not loose, and nothing else
    b = np.where(np.abs(x[:, 1:]) > height / 2 - 1, np.sign(x) * (0.0, 1.0), 0.0)
    points, reach = wp.Points(x, np.ones(len(x), bool), 1.0, units=UNITS), 1 + corrected
    strip = fracture.Cracked(points, b, free=free, corrected=corrected)
    ends = range(-reach, reach + 1)
    cracks = [[[(-width / 2, 0), (n + d - width / 2, 0)]] for d in ends]
    shape = np.polyval([30.382, -21.71, 10.55, -0.231, 1.122], share)
    G = fracture.energy_release(model, strip, cracks, shift=shift)
    return float(G * model.E / (np.pi * n * shape**2))


def main() -> None:
    Options(__doc__).parse_args()
    for cells in (8, 16, 32):
        errors = static_crack(cells, 3.0, 1.0)
        print(f"L/{cells}:", ", ".join(f"{k} {100 * e:.2f} %" for k, e in errors.items()))


if __name__ == "__main__":
    sys.exit(exit_status(main))
