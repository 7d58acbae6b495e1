"""Seconds that the choice of a rubber sheet's material takes, by the number of points.

    python examples/studies/sheet_seconds.py [--sizes 31x35 45x49 91x99] [--json]

Six frames of a sheet of Yeoh's material, pulled and bent, with noise of 0.002 spacings. Seconds are
the processor's, one thread; beside them the errors of frames left out, and of tension at 1.5.
"""

import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

import warp_peri as wp
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.launch import set_threads
from warp_peri.tissue import Dictionary, HyperelasticSolid, Term, uniaxial

NEAR = ((0, 1), (1, 0), (1, 1), (1, -1))
TERMS = (Term("plane_stress"), Term("yeoh", exponent=2.0), Term("yeoh", exponent=3.0))
TRUTH = HyperelasticSolid(
    Dictionary(3.0, (), NEAR, TERMS), np.array([0.1] * 4 + [0.25, 0.02, 0.03]), 0.1
)
COLLAR, FRAMES, NOISE = 6, 6, 0.002


def frames(size: str) -> wp.Samples:
    """A sheet of so many points along its sides, in equilibrium at every edge."""
    sides = np.array([int(side) for side in size.split("x")])
    steps = np.argwhere(np.ones(sides, bool))
    inside = np.all((steps >= COLLAR) & (steps < sides - COLLAR), axis=1)
    points = wp.Points(TRUTH.spacing * (steps - (sides - 1) / 2), inside, TRUTH.spacing)
    lengths = np.ptp(points.x, axis=0)
    along, across = (points.x / lengths).T
    edges = [
        points.x @ np.array([[0.5, 0.05], [0.0, 0.2]]) * (n + 3) / 8
        + 0.03 * lengths.max() * np.stack([np.sin(6 * across + n), np.cos(4 * along + n)], axis=-1)
        for n in range(FRAMES)
    ]
    u = np.array([wp.solve(TRUTH, wp.Dirichlet(points, None, edge)).u for edge in edges])
    noise = np.random.default_rng(3).standard_normal(u.shape)
    return wp.Samples(points, u + NOISE * TRUTH.spacing * noise)


def measured(size: str) -> dict[str, Any]:
    """Seconds of every candidate and of the whole, and what was found."""
    samples, seconds = frames(size), []
    began = time.process_time()

    def done(candidate: Any) -> None:
        seconds.append((candidate.name, time.process_time() - began, candidate.held_out))

    choice = wp.tissue.choose_sheet(samples, done=done)
    whole = time.process_time() - began
    stretches = [1.01, 1.5]
    found, true = (uniaxial(solid, stretches) for solid in (choice.material, TRUTH))
    middle, low, high = choice.curves(stretches[1:])
    return {
        "points": len(samples.x),
        "interior": int(samples.interior.sum()),
        "seconds": whole,
        "candidates": {name: [until, error] for name, until, error in seconds},
        "chosen": choice.best.name,
        "coefficients": choice.material.coefficients.tolist(),
        "error of tension": float(found[1] / found[0] / (true[1] / true[0]) - 1),
        "half width of the band": float((high - low)[0] / middle[0] / 2),
    }


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, json=True)
    sizes = ["31x35", "45x49", "91x99"]
    parser.add("--sizes", nargs="+", default=sizes, metavar="AxB", help="points along the sides")
    given = parser.parse_args(arguments)
    set_threads(1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of materials that do not fit
        rows = [measured(size) for size in given.sizes]
    if given.json:
        print(json.dumps(rows))
        return
    for row in rows:
        print(
            f"{row['points']} points, {row['interior']} inside: {row['seconds']:.0f} s, "
            f"{row['chosen']}, tension at 1.5 off by {100 * row['error of tension']:.2f} %, "
            f"band ± {100 * row['half width of the band']:.2f} %"
        )


if __name__ == "__main__":
    sys.exit(exit_status(main))
