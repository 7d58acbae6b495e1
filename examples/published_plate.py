"""A cracked plate against atoms that others published: the large one predicted from the small one.

A plate of |x| < L, |y| < 2 L with a central crack of length L, pulled at its ends; forces of
molecular dynamics from github.com/fishmoon1234/PeridynamicNeuralOperator (Upscaling Fracture
Mechanics/validation), quoted here at a few times. Everything is settled on the plates of L = 50:
stiffness and softening of the bonds on the whole one, strength and toughness on the cracked one.
What the large plate does, at this horizon and at one twice as long, is then predicted.
"""

import json
import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.optimize import minimize_scalar

import warp_peri as wp
from examples.figures import panels
from tools.options import Options
from warp_peri import Cracked
from warp_peri.damage import BondLaw, SoftSolid
from warp_peri.errors import exit_status

WHOLE = {20: 176.7, 40: 346.7, 60: 523.0, 80: 673.0, 100: 817.0, 150: 1167.0}
"""Force across the middle of the whole plate, L = 50, over t."""
SMALL = {76: 496.0, 80: 518.0, 84: 540.0, 88: 551.0, 92: 557.0, 96: 571.0}
"""The same of the cracked plate of L = 50, until it comes apart."""
SMALL_PEAK, LARGE_PEAK = (96.0, 572.0), (67.0, 928.0)
"""t and force at the peaks of the cracked plates, L = 50 and 100."""
STRENGTHS = (0.05, 0.055, 0.06)
"""Stretches at which bonds may begin to fail. The whole plate bears a strain of 0.05 at the end of
its curve (t = 200), so none is less; one more and bonds that break at once are too strong."""
SMALL_TIMES = np.concatenate([np.arange(52, 76, 12.0), np.arange(76, 110, 2.0)])
LARGE_TIMES = np.concatenate([np.arange(40, 56, 4.0), np.arange(56, 100, 1.0)])
SPACING, HORIZON = 5.0, 15.05
"""Those of the network that was published beside them [1e-10 m]."""


def rate(half: float) -> float:
    """Displacement of an end over t."""
    return 0.025 * half / 50


def plate(half: float, spacing: float, horizon: float, crack: bool) -> tuple[Cracked, np.ndarray]:
    """The plate, its ends displaced by one, and nodes whose bonds do not break."""
    n = round(half / spacing)
    across = np.arange(-n, n + 1) * spacing
    along = (np.arange(-2 * n, 2 * n) + 0.5) * spacing
    x = np.stack(np.meshgrid(across, along, indexing="ij"), axis=-1).reshape(-1, 2)
    free = np.column_stack(
        [np.abs(x[:, 0]) >= 1e-9 * spacing, np.abs(x[:, 1]) <= 2 * half - spacing]
    )
    start = np.column_stack([-x[:, 0] / 3, x[:, 1]]) / (2 * half)
    given = np.column_stack([0 * x[:, 0], np.sign(x[:, 1])])
    points = wp.Points(x, np.asarray(free.any(axis=1)), spacing)
    cracks = [[(-half / 2, 0), (half / 2, 0)]] if crack else []
    problem = Cracked(points, u=np.where(free, start, given), cracks=cracks, free=free)
    return problem, np.abs(x[:, 1]) > 2 * half - 2 * horizon


def pulled(
    half: float,
    times: np.ndarray,
    law: BondLaw,
    *,
    spacing: float = SPACING,
    horizon: float = HORIZON,
    crack: bool = True,
) -> wp.Motion:
    """Forces in units of the stiffness over loads, rate · t, as far as there is an equilibrium."""
    problem, rim = plate(half, spacing, horizon, crack)
    solid = SoftSolid(wp.Model(lam=1.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=horizon), law)
    line = [(-1.5 * half, 0.0), (1.5 * half, 0.0)]
    with warnings.catch_warnings():  # trials of a fit fail, which counts against them
        warnings.filterwarnings("ignore", message="load .* left out")
        return wp.move(solid, problem, loads=rate(half) * times, line=line, no_fail=rim, stop=0.9)


def peak(run: wp.Motion, half: float) -> tuple[float, float]:
    """t and force at the largest force."""
    highest = int(np.argmax(run["force"]))
    return float(run.time[highest] / rate(half)), float(run["force"][highest])


def fit_whole() -> tuple[float, float, float]:
    """Softness, stiffness, and the mean relative error of the whole plate's forces."""
    times, forces = np.array(list(WHOLE), float), np.array(list(WHOLE.values()))

    def compare(softness: float) -> tuple[float, float]:
        run = pulled(50, times, BondLaw(softness), crack=False)
        ratio = np.interp(times, run.time / rate(50), run["force"], right=0.0) / forces
        stiffness = ratio.sum() / (ratio @ ratio)
        return stiffness, float(np.abs(stiffness * ratio - 1).mean())

    best = minimize_scalar(
        lambda beta: compare(beta)[1], bounds=(2, 8), method="bounded", options={"xatol": 0.2}
    )
    return float(best.x), *compare(best.x)


def fit_tail(softness: float, stiffness: float, stretch: float) -> tuple[BondLaw, wp.Motion, float]:
    """The law of one strength whose peak on the small cracked plate is the published one.

    Also its run, and the mean relative error of the forces up to the peak.
    """
    low, high, tried = 0.0, 0.1, []
    for _ in range(6):
        law = BondLaw(softness, stretch, (low + high) / 2)
        run = pulled(50, SMALL_TIMES, law)
        highest = stiffness * peak(run, 50)[1]
        tried.append((abs(highest - SMALL_PEAK[1]), law, run))
        low, high = (low, law.tail) if highest > SMALL_PEAK[1] else (law.tail, high)
    _, law, run = min(tried, key=lambda trial: trial[0])
    forces = stiffness * np.interp(list(SMALL), run.time / rate(50), run["force"], right=0.0)
    return law, run, float(np.abs(forces / list(SMALL.values()) - 1).mean())


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "published_plate", json=True)
    args = parser.parse_args(argv)
    softness, stiffness, error = fit_whole()
    fits = {stretch: fit_tail(softness, stiffness, stretch) for stretch in STRENGTHS}
    law, small, curve = min(fits.values(), key=lambda trial: trial[2])
    longer = law.at_horizon(2.0)
    large = pulled(100, LARGE_TIMES, law)
    coarse = pulled(100, LARGE_TIMES, longer, spacing=2 * SPACING, horizon=2 * HORIZON)
    numbers = {
        "law": vars(law),
        "law, horizon × 2": vars(longer),
        "whole plate, mean error": error,
        "L = 50, mean error by strength": {name: trial[2] for name, trial in fits.items()},
        "L = 50, mean error": curve,
        "peaks": {
            name: {
                "t": t,
                "force": stiffness * force,
                "t error": t / atoms[0] - 1,
                "force error": stiffness * force / atoms[1] - 1,
            }
            for name, (t, force), atoms in (
                ("L = 50, fitted", peak(small, 50), SMALL_PEAK),
                ("L = 100", peak(large, 100), LARGE_PEAK),
                ("L = 100, horizon × 2", peak(coarse, 100), LARGE_PEAK),
            )
        },
    }
    figure, ax = panels(5, 3.6)
    curves = {"L = 50": (small, 50), "L = 100": (large, 100), "L = 100, horizon × 2": (coarse, 100)}
    for label, (run, half) in curves.items():
        ax.plot(run.time / rate(half), stiffness * run["force"], label=label)
    ax.plot(*np.transpose([SMALL_PEAK, LARGE_PEAK]), "ks", label="atoms, peaks")
    ax.set(xlabel="t", ylabel="force across the middle")
    ax.legend(frameon=False)
    figure.savefig(args.out / "force.png", dpi=120)
    print(json.dumps(numbers, ensure_ascii=False, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
