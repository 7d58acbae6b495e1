"""A pre-cracked glass plate under a sudden pull: the crack runs, and branches.

    python examples/branching.py [--spacing 5e-4] [--series]

The plate is 100 × 40 mm, E 72 GPa, ρ 2440 kg/m³, G_c 135 J/m², pulled at 12 MPa; SI units. Prints
where the crack branches and how fast it runs over the speed of surface waves, and draws the damage.
Under mpiexec the plate is spread over processes, with the same bits.
"""

import json
import sys
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])

import numpy as np

import warp_peri as wp
from examples.figures import check_place, panels, save_figure
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.fracture import BrittleMaterial, rectangle_nodes
from warp_peri.mpi import gather, is_root, partition
from warp_peri.points.arguments import Positive

SI, PS = ("m", "Pa"), 1e-12
"""Units of length and stress; a picosecond, in which motions are timed [s]."""
DAMAGED = 0.35
"""φ from which a node counts as on a crack."""


def glass(h: float, ratio: float) -> tuple[BrittleMaterial, wp.Cracked, np.ndarray]:
    """The solid, its plate, and nodes whose bonds do not break."""
    mu = 72e9 * 3 / 8  # λ = μ: ν = 1/3 in plane stress
    model = wp.LPSMaterial(lam=mu, mu=mu, alpha=1.0, D=np.ones(1), horizon=ratio * h, units=SI)
    solid, x = BrittleMaterial(model, 2440.0, toughness=135.0), rectangle_nodes(0.1, 0.04, h)
    points = partition(wp.Points(x, np.ones(len(x), bool), h, units=SI))
    edge = np.abs(points.x[:, 1:]) > 0.02 - h
    load = np.where(edge, np.sign(points.x) * (0.0, 12e6 / h), 0.0)
    plate = wp.Cracked(points, load, cracks=[[(-0.051, 0.0), (0.0, 0.0)]])
    return solid, plate, np.abs(points.x[:, 1]) > 0.02 - ratio * h


def tip(x: np.ndarray, phi: np.ndarray) -> float:
    """How far to the right the damage has come [m]."""
    ahead = x[(phi > DAMAGED) & (np.abs(x[:, 0]) < 0.0499), 0]
    return float(ahead.max()) if len(ahead) else 0.0


def branch_point(x: np.ndarray, phi: np.ndarray, h: float) -> float | None:
    """Where the damage first lies in two bands a millimetre apart [m], None where it does not."""
    for column in np.unique(np.round(x[:, 0], 9)):
        y = np.sort(x[(np.abs(x[:, 0] - column) < h / 4) & (phi > DAMAGED), 1])
        if column > 0 and len(y) > 1 and np.diff(y).max() > 1.5e-3:
            return float(column)
    return None


def main(arguments: list[str] | None = None) -> int:
    options = {
        "spacing": (0.5e-3, "[m]", Positive),
        "ratio": (4.0, "horizon over spacing", Positive),
        "time": (45e-6, "[s]", Positive),
        "share": (0.4, "of the longest step", Positive),
        "series": (False, "write files for ParaView"),
    }
    given = Options(__doc__, "branching", options=options).parse_args(arguments)
    h, picture = given.spacing, check_place(given.out / "damage.png")
    solid, plate, no_fail = glass(h, given.ratio)
    x, step = gather(plate.points, plate.points.x), given.share * solid.longest_step(h)
    steps = max(1, round(given.time / PS / step))
    every = max(1, steps // 100)
    run = wp.simulate(
        solid, plate, step=step, steps=every * (steps // every), every=every,
        no_fail=no_fail, watch={"tip": lambda phi: tip(x, phi)},
        series=given.out / "series" if given.series else None,
    )  # fmt: skip
    phi = gather(plate.points, run.details.damage)
    if not is_root():
        return 0
    nu, mu = 1 / 3, solid.model.mu
    rayleigh = np.sqrt(mu / solid.density) * (0.862 + 1.14 * nu) / (1 + nu)  # Viktorov's fit
    runs = [(t, s) for t, s in zip(PS * run.time, run["tip"]) if 2e-3 < s < 0.045]
    width = max(3, len(runs) // 8)
    windows = (np.transpose(runs[k : k + width]) for k in range(len(runs) - width + 1))
    speeds = [np.polyfit(part[0], part[1], 1)[0] / rayleigh for part in windows]
    numbers = {"nodes": len(x), "ledger": run.missing, "branch": branch_point(x, phi, h)}
    title = f"The crack has {'not yet ' * (numbers['branch'] is None)}split in two"
    print(json.dumps(numbers | {"speed_over_rayleigh": max(speeds, default=None)}))
    figure, ax = panels(8, 3.6)
    shown = ax.scatter(1e3 * x[:, 0], 1e3 * x[:, 1], c=phi, s=4, cmap="magma_r", vmin=0, vmax=0.6)
    ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title=title)
    figure.colorbar(shown, ax=ax, label="share of broken bonds")
    save_figure(figure, picture, dpi=120)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
