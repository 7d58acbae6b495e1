"""Stress around a hole: a plate under tension, elements at its edges and a learned model inside.

    python examples/plate_with_hole.py --model runs/graphene_0K/model.json

Compares the plate with Lekhnitskii's exact one, Kirsch's where the material is isotropic, and draws
the stress along x.
"""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples.exact import hoop_stress, plate_with_hole
from examples.figures import check_place, panels, save_figure
from tools.options import Options
from warp_peri.crystals import crystal_from_lps
from warp_peri.errors import InputError, exit_status
from warp_peri.methods import Coupling
from warp_peri.points.arguments import USUAL, Positive
from warp_peri.points.outlines import Circle, box, mesh_outline

TENSION = 0.005
"""Far from the hole [TPa]."""


class Moduli:
    """C11, C12 and C44 of the long waves of a model."""

    def __init__(self, model: wp.LPSMaterial, spacing: float) -> None:
        vars(self).update(crystal_from_lps(model, spacing).moduli())


def main(arguments: list[str] | None = None) -> int:
    options = {
        "model": (ROOT / "runs/graphene_0K/model.json", "of an LPS"),
        "radius": (40.0, "of the hole [Å]", Positive),
        "half": (100.0, "half the plate's width [Å]", Positive),
        "size": (2.0, "of triangles at the hole [Å]", Positive),
        "spacing": (2.5, "of the nodes inside [Å]", Positive),
        "horizon": (7.5, "at most, there [Å]", Positive),
    }
    given = Options(__doc__, "plate_with_hole", options=options).parse_args(arguments)
    model, h = wp.load(given.model, units=USUAL), given.spacing
    picture = check_place(given.out / "stress.png")
    if not isinstance(model, wp.LPSMaterial):
        raise InputError(f"model: expected an LPSMaterial, got {type(model).__name__}")
    if not model.is_certified_on(h) or given.horizon != model.horizon:
        model = wp.transfers.on_lattice(model, spacing=h, largest_horizon=given.horizon)
    moduli = Moduli(model, h)

    def exact(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return plate_with_hole(x, given.radius, TENSION, moduli)

    hole = [Circle(given.radius, size=given.size)]
    mesh = mesh_outline(box(2 * given.half, 2 * given.half), hole, size=4 * given.size)
    sides = dict.fromkeys(("left", "right", "top", "bottom"), lambda x: exact(x)[0])
    solution = wp.solve(model, wp.Body(mesh, sides, coupling=Coupling(spacing=h)))
    true, body = exact(mesh.x)[0], solution.details
    edge = body.rim.nodes_of("hole")
    x = body.rim.x[edge]
    found, hoop = hoop_stress(x, body.rim_stress[edge]), hoop_stress(x, exact(x)[1])
    stress = body.on_corners()[1][:, 0, 0] / TENSION
    numbers = {
        "u_error": float(np.linalg.norm(solution.u - true) / np.linalg.norm(true)),
        "hoop_stress_error": float(np.abs(found - hoop).max() / hoop.max()),
        "peak_over_tension": float(found.max() / TENSION),
    }
    print(json.dumps(numbers))
    figure, ax = panels(5.5, 4.5)
    shown = ax.tripcolor(
        mesh.x[:, 0], mesh.x[:, 1], stress, triangles=mesh.cells, shading="gouraud"
    )
    ax.set(aspect="equal", xlabel="x [Å]", ylabel="y [Å]", title="Tension along x")
    figure.colorbar(shown, ax=ax, label="stress along x over the tension")
    save_figure(figure, picture, dpi=120)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
