"""A pre-cracked glass plate under a sudden pull: the crack runs, and branches.

The plate is 100 × 40 mm, E 72 GPa, ρ 2440 kg/m³, G_c 135 J/m², pulled at 12 MPa; SI units. Also
Kalthoff and Winkler's plate with two notches that a projectile hits between them (--kalthoff);
cracks like some directions of the lattice, so --turn shows what is the lattice's part. Under
mpiexec the plate is spread over ranks, with the same bits (docs/how-to/ranks.md).
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from matplotlib.figure import Figure

import warp_peri as wp
from tools.options import Options
from warp_peri import Cracked
from warp_peri.damage import BrittleSolid, rectangle
from warp_peri.errors import exit_status
from warp_peri.ranks import gather, is_first, partition

DAMAGED = 0.35
"""φ from which a node counts as on a crack."""


def rayleigh(lam: float, mu: float, density: float) -> float:
    """Speed of surface waves, by Viktorov's fit [m/s]."""
    nu = lam / (2 * (lam + mu))
    return float(np.sqrt(mu / density) * (0.862 + 1.14 * nu) / (1 + nu))


def glass(h: float, ratio: float, stress: float, toughness: float = 135.0, hole: float = 0.0):
    """The solid, its plate, maybe with a round hole off the path of the crack, and its options."""
    mu = 72e9 * 3 / 8  # λ = μ: ν = 1/3 in plane stress
    model = wp.Model(lam=mu, mu=mu, alpha=1.0, D=np.ones(1), horizon=ratio * h)
    solid = BrittleSolid(model, 2440.0, toughness=toughness)
    x = rectangle(0.1, 0.04, h)
    x = x[np.hypot(x[:, 0] - 0.02, x[:, 1] - 0.008) >= hole]
    points = partition(wp.Points(x, np.ones(len(x), bool), h))
    x = points.x
    edge = np.abs(x[:, 1]) > 0.02 - h
    load = np.where(edge[:, None], np.sign(x) * (0.0, stress / h), 0.0)
    no_fail = np.abs(x[:, 1]) > 0.02 - ratio * h
    crack = [(-0.051, 0.0), (0.0, 0.0)]
    return solid, Cracked(points, load, cracks=[crack]), {"no_fail": no_fail}


def steel(h: float, ratio: float, turn: float = 0.0, speed: float = 16.5):
    """Kalthoff and Winkler's plate with its notches, and the velocity of the part that is hit.

    The plate is turned by some degrees on the lattice; x comes back in its own axes.
    """
    E, nu = 190e9, 0.25  # plane strain, bond-based
    mu = E / (2 * (1 + nu))
    model = wp.Model(lam=mu, mu=mu, alpha=1.0, D=np.ones(1), horizon=ratio * h)
    solid = BrittleSolid(model, 8000.0, toughness=2.213e4)
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    axes = np.array([[cos, sin], [-sin, cos]])  # of the plate
    lattice = rectangle(0.24, 0.24, h)
    x = lattice @ axes.T
    inside = (np.abs(x[:, 0]) < 0.05) & (np.abs(x[:, 1]) < 0.1)
    x, lattice = x[inside], lattice[inside]
    hit = (x[:, 0] < -0.05 + (1.5 if turn else 1.0) * h) & (np.abs(x[:, 1]) < 0.025)
    points = partition(wp.Points(lattice, ~hit, h))
    grip = np.where(points.interior[:, None], 0.0, speed * axes[0])
    notches = [np.array([(-0.053, y), (0.0, y)]) @ axes for y in (-0.025001, 0.025001)]
    return solid, Cracked(points, cracks=notches), {"grip": grip}, x


def crack_angles(x: np.ndarray, phi: np.ndarray, h: float) -> tuple[float | None, float | None]:
    """Angles to the notches of both cracks' mean direction and of the way to their tips, means.

    None before both have grown.
    """
    angles = []
    for side in (1, -1):
        new = (phi > DAMAGED) & (x[:, 0] > 2 * h) & (x[:, 0] < 0.048) & (side * x[:, 1] > 0.025)
        if np.count_nonzero(new) < 10:
            return None, None
        along, up = x[new, 0], np.abs(x[new, 1])
        end = along[up > up.max() - 1.5 * h].mean(), up.max() - 0.025
        angles.append((np.arctan(1 / np.polyfit(up, along, 1)[0]), np.arctan2(end[1], end[0])))
    mean, tip = np.degrees(np.mean(angles, axis=0))
    return float(mean), float(tip)


def tip(x: np.ndarray, phi: np.ndarray) -> float:
    """How far to the right the damage has come."""
    ahead = x[(phi > DAMAGED) & (np.abs(x[:, 0]) < 0.0499), 0]
    return float(ahead.max()) if len(ahead) else 0.0


def branch_point(x: np.ndarray, phi: np.ndarray, h: float) -> float | None:
    """Where the damage first lies in two bands a millimetre apart, NaN where it does not."""
    for column in np.unique(np.round(x[:, 0], 9)):
        there = np.abs(x[:, 0] - column) < h / 4
        y = np.sort(x[there & (phi > DAMAGED), 1])
        if column > 0 and len(y) > 1 and np.diff(y).max() > 1.5e-3:
            return float(column)
    return None


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "branching", json=True)
    parser.add("--spacing", type=float, default=0.5e-3, help="[m]")
    parser.add("--ratio", type=float, default=4.0, help="horizon over spacing")
    parser.add("--time", type=float, help="[s]; 45e-6, or 85e-6 of the plate that is hit")
    parser.add("--share", type=float, default=0.4, help="of the longest step")
    parser.add("--kalthoff", action="store_true", help="the plate that is hit, instead")
    parser.add("--turn", type=float, default=0.0, help="of that plate [degrees]")
    parser.add("--hole", type=float, default=0.0, help="radius of a hole [m]")
    parser.add("--series", action="store_true", help="write files for ParaView")
    parser.add("--progress", action="store_true", help="show how far it is")
    args = parser.parse_args(argv)
    if not (args.spacing > 0 and args.share > 0 and (args.time is None or args.time > 0)):
        parser.error("--spacing, --share, --time: expected numbers > 0")
    h = args.spacing
    if args.kalthoff:
        solid, plate, options, x = steel(h, args.ratio, args.turn)
    else:
        solid, plate, options = glass(h, args.ratio, 12e6, hole=args.hole)
        x = gather(plate.points, plate.points.x)
    step = args.share * solid.longest_step(h)
    steps = round((args.time or (85e-6 if args.kalthoff else 45e-6)) / step)
    every = max(1, steps // 100)
    options |= {"step": step, "steps": every * (steps // every), "every": every}
    options |= {"series": args.out / "series" if args.series else None, "progress": args.progress}
    run = wp.move(solid, plate, watch={"tip": lambda phi: tip(x, phi)}, **options)
    phi = gather(plate.points, run.details.damage)
    if not is_first():
        return 0
    numbers: dict[str, float | None] = {"nodes": len(x), "steps": options["steps"]}
    numbers["ledger"] = run.missing
    if args.kalthoff:
        numbers["angle"], numbers["angle to the tips"] = crack_angles(x, phi, h)
    else:
        numbers["branch"] = branch_point(x, phi, h)
        tips = np.column_stack([run.time, run["tip"]])
        runs = tips[(tips[:, 1] > 2e-3) & (tips[:, 1] < 0.045)]
        width = max(3, len(runs) // 8)
        windows = (runs[k : k + width] for k in range(len(runs) - width + 1))
        slopes = [float(np.polyfit(part[:, 0], part[:, 1], 1)[0]) for part in windows]
        speed = max(slopes, default=float("nan"))
        numbers["speed_over_rayleigh"] = speed / rayleigh(
            solid.model.lam, solid.model.mu, solid.density
        )
    figure = Figure(figsize=(4, 6) if args.kalthoff else (8, 3.6), layout="constrained")
    ax = figure.subplots()
    shown = ax.scatter(1e3 * x[:, 0], 1e3 * x[:, 1], c=phi, s=4, cmap="magma_r", vmin=0, vmax=0.6)
    ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    when = f"after {run.time[-1] * 1e6:.0f} µs"
    ax.set_title(f"damage {when}" if args.kalthoff else f"The crack has split in two {when}")
    if not args.kalthoff:
        for side in (-1, 1):
            for at in (-40, -20, 0, 20, 40):
                ax.annotate("", (at, 25 * side), (at, 20.5 * side),
                            arrowprops={"arrowstyle": "->", "color": "C0"})  # fmt: skip
        ax.set_ylim(-27, 27)
        ax.text(42, 22, "pull", color="C0")
        ax.plot([-50, 0], [0, 0], color="k", linewidth=1)
        ax.text(-30, 1.5, "notch")
    figure.colorbar(shown, ax=ax, label="share of broken bonds")
    figure.savefig(args.out / "damage.png", dpi=120)
    print(json.dumps(numbers, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
