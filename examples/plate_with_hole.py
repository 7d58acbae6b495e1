"""Stress around a hole: a plate under tension, elements at its edges and the learned model inside.

Compared with Lekhnitskii's exact plate, Kirsch's where the material is isotropic.
"""

import json
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from matplotlib.tri import Triangulation

import warp_peri as wp
from examples.exact import hoop_stress, plate_with_hole
from examples.figures import panels
from tools.options import Options
from warp_peri.edges.body import BodySolution, long_wave, solve_body
from warp_peri.errors import exit_status
from warp_peri.methods import Coupling
from warp_peri.points.outlines import Circle, box, mesh_outline

TENSION = 0.005
"""Far from the hole [TPa]."""


def solve_plate(
    model: wp.Model, radius: float, half: float, size: float, coupling: Coupling
) -> tuple[dict[str, float], BodySolution]:
    """The numbers of a square plate 2 · half wide whose sides have the exact displacement."""
    stiff = long_wave(model, coupling.spacing or model.certified_on[0])
    mesh = mesh_outline(box(2 * half, 2 * half), [Circle(radius, size=size)], size=4 * size)
    sides = ("left", "right", "top", "bottom")
    held = {side: lambda x: plate_with_hole(x, radius, TENSION, stiff)[0] for side in sides}
    start = time.perf_counter()
    solution = solve_body(model, mesh, displacement=held, coupling=coupling)
    seconds = time.perf_counter() - start
    u, _ = solution.on_corners()
    exact, _ = plate_with_hole(mesh.x, radius, TENSION, stiff)
    edge = solution.rim.nodes_of("hole")
    x = solution.rim.x[edge]
    hoop = hoop_stress(x, plate_with_hole(x, radius, TENSION, stiff)[1])
    off = hoop_stress(x, solution.rim_stress[edge]) - hoop
    numbers = {
        "u_error": float(np.linalg.norm(u - exact) / np.linalg.norm(exact)),
        "hoop_stress_error": float(np.abs(off).max() / hoop.max()),
        "peak_over_tension": float(hoop_stress(x, solution.rim_stress[edge]).max() / TENSION),
        "exact_peak_over_tension": float(hoop.max() / TENSION),
        **reported(solution),
        "seconds": seconds,
    }
    return numbers, solution


def solve_three_holes(model: wp.Model, coupling: Coupling) -> tuple[dict[str, float], BodySolution]:
    """The numbers of a plate of 500 Å with three holes, held at one side and pulled at another."""
    holes = [
        Circle(40.0, (-120.0, -100.0), size=2.5),
        Circle(30.0, (110.0, -60.0), size=2.5),
        Circle(50.0, (0.0, 120.0), size=2.5),
    ]
    mesh = mesh_outline(box(500, 500), holes, size=10)
    start = time.perf_counter(), time.process_time()
    solution = solve_body(
        model,
        mesh,
        displacement={"left": (0.0, 0.0)},
        traction={"right": (TENSION, 0.0)},
        coupling=coupling,
    )
    end = time.perf_counter(), time.process_time()
    edge = solution.rim.nodes_of("hole")
    numbers = {
        "peak_over_tension": float(np.linalg.eigvalsh(solution.rim_stress[edge]).max() / TENSION),
        **reported(solution),
        "seconds": end[0] - start[0],
        "cpu_seconds": end[1] - start[1],
    }
    return numbers, solution


def reported(solution: BodySolution) -> dict[str, float]:
    """What a solution tells of itself."""
    return {
        "spacing": solution.spacing,
        "horizon": solution.model.horizon,
        "lattice_nodes": 0 if solution.points is None else int(solution.points.interior.sum()),
        "rim_nodes": len(solution.rim.x),
        **vars(solution.exchange),
        "overlap": solution.overlap,
    }


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "plate_with_hole", json=True)
    file = ROOT / "runs" / "graphene_0K" / "model.json"
    parser.add("--model", type=Path, default=file, help="a model file")
    parser.add("--radius", type=float, default=40.0, help="of the hole [Å]")
    parser.add("--half", type=float, default=100.0, help="half the plate's width [Å]")
    parser.add("--size", type=float, default=2.0, help="of the triangles at the hole [Å]")
    parser.add("--spacing", type=float, default=2.5, help="of the bulk's lattice [Å]")
    parser.add("--horizon", type=float, default=7.5, help="there [Å]")
    parser.add("--overlap", type=float, help="of rim and bulk [Å]")
    parser.add("--three-holes", action="store_true", help="a plate of 500 Å instead")
    args = parser.parse_args(argv)
    model = wp.load(args.model)
    if not model.is_certified_on(args.spacing) or args.horizon != model.horizon:
        model = wp.transfers.on_lattice(model, spacing=args.spacing, horizon=args.horizon)
    coupling = Coupling(spacing=args.spacing, overlap=args.overlap)
    if args.three_holes:
        numbers, solution = solve_three_holes(model, coupling)
    else:
        numbers, solution = solve_plate(model, args.radius, args.half, args.size, coupling)
    print(json.dumps(numbers) if args.json else json.dumps(numbers, indent=1))
    mesh = solution.rim.mesh
    _, stress = solution.on_corners()
    figure, axes = panels(5.5, 4.5)
    triangles = Triangulation(mesh.x[:, 0], mesh.x[:, 1], mesh.cells)
    shown = axes.tripcolor(triangles, stress[:, 0, 0] / TENSION, shading="gouraud", cmap="viridis")
    right, top = mesh.x.max(axis=0)
    for y in np.linspace(-0.8 * top, 0.8 * top, 5):
        for side in (-1, 1):
            axes.annotate("", (1.25 * side * right, y), (1.03 * side * right, y),
                          arrowprops={"arrowstyle": "->", "color": "C3"})  # fmt: skip
    axes.text(0, 1.06 * top, "tension along x", color="C3", ha="center")
    axes.set(aspect="equal", xlabel="x [Å]", ylabel="y [Å]", xlim=(-1.3 * right, 1.3 * right))
    axes.set_ylim(-1.1 * top, 1.2 * top)
    axes.set_title(f"The stress is up to {stress[:, 0, 0].max() / TENSION:.1f} times the tension")
    figure.colorbar(shown, ax=axes, label="stress along x over the tension")
    figure.savefig(args.out / "stress.png", dpi=120)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
