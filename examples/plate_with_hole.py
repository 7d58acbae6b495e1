"""Stress around a hole: a plate under tension, elements at its edges and a learned model inside.

    python examples/plate_with_hole.py --model runs/graphene_0K/model.json

Compares the plate with Lekhnitskii's exact one, Kirsch's where the material is isotropic, and draws
the stress along x.
"""

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import matplotlib
import numpy as np

import warp_peri as wp
from examples.exact import hoop_stress, plate_with_hole
from warp_peri.crystals import crystal_from_lps
from warp_peri.errors import exit_status
from warp_peri.methods import Coupling
from warp_peri.points.outlines import Circle, box, mesh_outline

matplotlib.use("Agg")
import matplotlib.pyplot as plt

TENSION = 0.005
"""Far from the hole [TPa]."""


class Moduli:
    """C11, C12 and C44 of the long waves of a model."""

    def __init__(self, model: wp.LPSMaterial, spacing: float) -> None:
        vars(self).update(crystal_from_lps(model, spacing).moduli())


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, default=ROOT / "runs/graphene_0K/model.json")
    parser.add_argument("--radius", type=float, default=40.0, help="of the hole [Å]")
    parser.add_argument("--half", type=float, default=100.0, help="half the plate's width [Å]")
    parser.add_argument("--size", type=float, default=2.0, help="of triangles at the hole [Å]")
    parser.add_argument("--spacing", type=float, default=2.5, help="of the nodes inside [Å]")
    parser.add_argument("--horizon", type=float, default=7.5, help="at most, there [Å]")
    parser.add_argument("--out", type=Path, default=ROOT / "runs/plate_with_hole")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    model, h = wp.load(given.model), given.spacing
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
    figure, ax = plt.subplots(figsize=(5.5, 4.5), layout="constrained")
    shown = ax.tripcolor(
        mesh.x[:, 0], mesh.x[:, 1], stress, triangles=mesh.cells, shading="gouraud"
    )
    ax.set(aspect="equal", xlabel="x [Å]", ylabel="y [Å]", title="Tension along x")
    figure.colorbar(shown, ax=ax, label="stress along x over the tension")
    figure.savefig(given.out / "stress.png", dpi=120)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
