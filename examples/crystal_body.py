"""A block of copper with a void, pulled at its top: tetrahedra at its faces, the law inside."""

import json
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from scipy.interpolate import LinearNDInterpolator

import warp_peri as wp
from examples.crystals import learned
from examples.figures import note, panels, save_figure
from tools.crystals import force_constants
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.methods import Coupling
from warp_peri.points.outlines import Block, Sphere, mesh_solid

SIDE, RADIUS, TENSION = 180.0, 20.0, 1e-3  # Å, Å, TPa


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True)
    parser.add("--out", type=Path, default=ROOT / "runs" / "crystal_body.png")
    given = parser.parse_args(arguments)
    law = learned("Cu", force_constants("Cu"))
    mesh = mesh_solid(Block((SIDE,) * 3), [Sphere(RADIUS, size=5.0)], size=20.0)
    held, pulled = {"bottom": (0, 0, 0)}, {"top": (0, 0, TENSION)}
    began = time.perf_counter()
    solution = wp.solve(law, wp.Body(mesh, held, pulled, coupling=Coupling(degree=1)))
    parts, stress = solution.details, solution.details.on_corners()[1][:, 2, 2] / TENSION
    numbers = {
        "nodes_of_the_lattice": int(parts.points.interior.sum()),
        "corners_of_elements": len(parts.u_rim),
        "exchanges": parts.exchange.exchanges,
        "mismatch": parts.exchange.mismatch,
        "peak_over_tension": float(stress[np.unique(mesh.faces[mesh.parts["void"]])].max()),
        "seconds": time.perf_counter() - began,
    }
    print(json.dumps(numbers, indent=None if given.json else 1))
    line = np.linspace(-SIDE / 2, SIDE / 2, 121)
    x, z = np.meshgrid(line, line)
    shown = LinearNDInterpolator(mesh.x, stress)(x, 0 * x, z)
    shown[np.hypot(x, z) < RADIUS] = np.nan
    figure, axes = panels(5.2, 4.3)
    image = axes.pcolormesh(x, z, shown, cmap="viridis", shading="nearest")
    axes.set(aspect="equal", xlabel="x₁ [Å]", ylabel="x₃ [Å]", ylim=(-0.6 * SIDE, 0.6 * SIDE))
    at = np.linspace(-0.4, 0.4, 5) * SIDE
    axes.quiver(at, at * 0 + 0.52 * SIDE, at * 0, at * 0 + 1, color="C3", scale=15, width=0.006)
    note(axes, "held", (0, -0.5 * SIDE), (-10, -14), color="C3")
    most = np.nanmax(shown[np.hypot(x, z) < 2 * RADIUS])
    axes.set_title(f"At the void the stress is {most:.1f} times the tension")
    figure.colorbar(image, ax=axes, label="stress σ₃₃ over the tension")
    save_figure(figure, given.out)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
