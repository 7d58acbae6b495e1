"""Graphene with a hole, and a strip with free edges: the coupled model against LAMMPS.

Atoms relax their edges first and are then loaded, at their ends or by waves of body force in the
plate. The model holds the sides where the atoms are, takes their forces by the work they do, and
knows of the edges nothing but, in a second solve, a stiffness that strips of two widths have told.
Displacements are compared around atoms, the model's taken at the same atoms.
"""

import json
import sys
import time
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import scipy.sparse as sp
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

import warp_peri as wp
from examples.figures import panels
from tools.elastic import elastic_constants
from tools.graphene import THICKNESS, bond_length
from tools.holed_sheet import (
    HOLES,
    STRIP,
    TENSION,
    WAVES,
    Plate,
    edge_constants,
    held_samples,
    loads_of,
)
from tools.options import Options
from tools.samples import Sample
from warp_peri import Mesh
from warp_peri.atoms import force_on_mesh, smoothing_matrix
from warp_peri.edges.body import solve_body
from warp_peri.errors import exit_status
from warp_peri.methods import Coupling
from warp_peri.points.outlines import Circle, box, mesh_outline

INSIDE = 100.0
"""Half of the model's plate [Å]; the atoms go on beyond it."""
OFF_EDGES = 10.0
"""How far from free edges displacements are compared once more [Å]."""
COARSE = 30.0
"""Spacing of a lattice that has no room [Å]."""
AROUND = 5.0
"""Radius within which atoms tell the displacement at a point [Å]."""


def mesh_of(plate: Plate, bond: float) -> Mesh:
    """The model's plate, its hole as large as the area of the atoms that are missing."""
    if plate.radius:
        hole = Circle(plate.effective_radius(bond), size=2.0)
        return mesh_outline(box(2 * INSIDE, 2 * INSIDE), [hole], size=8.0)
    return mesh_outline(box(2 * INSIDE, 2 * plate.effective_height(bond), size=3.5), size=3.5)


def held_sides(plate: Plate, sample: Sample) -> dict:
    """Displacement [Å] on the plate's sides where atoms go on: a quadratic fit to those around.

    A linear fit would flatten short waves.
    """
    tree = cKDTree(sample.reference)

    def field(x: np.ndarray) -> np.ndarray:
        u = np.empty_like(x)
        for i, near in enumerate(tree.query_ball_point(x, AROUND)):
            dx, dy = (sample.reference[near] - x[i]).T
            weight = np.sqrt(AROUND - np.hypot(dx, dy))[:, None]
            terms = np.column_stack([np.ones(len(near)), dx, dy, dx**2, dx * dy, dy**2])
            u[i] = np.linalg.lstsq(weight * terms, weight * sample.displacement[near])[0][0]
        return u

    sides = ("left", "right", "bottom", "top") if plate.radius else ("left", "right")
    return dict.fromkeys(sides, field)


def compare(
    model: wp.Model, plate: Plate, sample: Sample, edge: float, whole: Mesh, coupling: Coupling
) -> dict[str, float]:
    """Errors of one plate under one load, without and with the stiffness of its edges."""
    mesh = mesh_of(plate, bond_length())
    inside = (np.abs(sample.reference) <= INSIDE).all(axis=1)
    atoms, force = sample.reference[inside], sample.force[inside]
    held, b = held_sides(plate, sample), force_on_mesh(mesh, atoms, force, thickness=THICKNESS)
    parts = ("hole",) if plate.radius else ("bottom", "top")
    plain = solve_body(model, mesh, displacement=held, b=b, coupling=coupling)
    coupling = Coupling(spacing=plain.spacing)
    stiff = solve_body(
        model, mesh, displacement=held, b=b, edge=dict.fromkeys(parts, edge), coupling=coupling
    )
    there = mesh.holding(atoms) >= 0  # the model's edge leaves a few atoms of the outermost out
    x, u = atoms[there], sample.displacement[inside][there]
    off = plate.edge_distance(x) >= OFF_EDGES
    # the two atoms of a cell also move against each other, which no continuum has
    around = smoothing_matrix(x, x, radius=AROUND, density=True)
    around = sp.diags_array(1 / around.sum(axis=1)) @ around
    u, of_plain, of_stiff = (
        around @ field for field in (u, plain.displacement(x), stiff.displacement(x))
    )

    def error(values: np.ndarray, truth: np.ndarray = u, where: np.ndarray = off) -> float:
        return float(np.linalg.norm(values[where]) / np.linalg.norm(truth[where]))

    everywhere = np.ones(len(x), bool)
    numbers = {
        "error": error(of_plain - u),
        "error_with_edge": error(of_stiff - u),
        "error_up_to_edges": error(of_plain - u, where=everywhere),
        "edge_changes": error(of_stiff - of_plain),
        "spacing": plain.spacing,
        "exchanges": plain.exchange.exchanges,
        "bond_strain": sample.max_bond_strain,
        "displacement": float(np.sqrt((u**2).mean())),
    }
    if plate.radius:
        on_whole = force_on_mesh(whole, atoms, force, thickness=THICKNESS)
        without = solve_body(model, whole, displacement=held, b=on_whole, coupling=coupling)
        added = u - around @ without.displacement(x)
        numbers["error_of_what_the_hole_adds"] = error(of_plain - u, added)
        numbers["the_same_with_edge"] = error(of_stiff - u, added)
    return numbers


def elements_alone(bond: float) -> tuple[wp.Model, Coupling]:
    """The atoms' own moduli, on a lattice so coarse that no body has room for it."""
    own = elastic_constants(bond)
    model = wp.Model(
        own["lambda"], own["mu"], 1.0, np.ones(1), horizon=3 * COARSE, certified_on=(COARSE,)
    )
    return model, Coupling(spacing=COARSE)


def draw(table: dict[str, dict[str, float]]) -> Figure:
    """Errors of every case, without and with the edges' own stiffness."""
    figure, axes = panels(6.5, 4.0)
    place = np.arange(len(table))
    for shift, key, label in (
        (-0.2, "error", "edges like the inside"),
        (0.2, "error_with_edge", "edges' own stiffness"),
    ):
        axes.barh(place + shift, [100 * row[key] for row in table.values()], 0.4, label=label)
    axes.set(yticks=place, yticklabels=table, xlabel="error of displacement, 10 Å off edges, in %")
    axes.invert_yaxis()
    axes.axvline(3.0, color="grey", linewidth=1)
    axes.legend()
    return figure


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "hole_against_atoms", json=True)
    file = ROOT / "runs" / "graphene_0K" / "model.json"
    parser.add("--model", type=Path, default=file, help="a model file")
    parser.add("--cache", type=Path, default=ROOT / "data" / "holes", help="of the atoms")
    parser.add("--tension", type=float, default=TENSION, help="about the stress [TPa]")
    waves = tuple(range(len(WAVES)))
    parser.add("--waves", type=int, nargs="+", default=waves, help="their numbers, from 0")
    parser.add("--edge-times", type=float, default=1.0, help="of an edge's stiffness")
    parser.add("--elements", action="store_true", help="alone, the atoms' own moduli")
    args = parser.parse_args(argv)
    warnings.simplefilter("ignore")
    start = time.perf_counter()
    asked = {"tension": args.tension, "waves": args.waves}
    samples = held_samples(args.cache, **asked, progress=not args.json)
    if args.elements:
        model, coupling = elements_alone(bond_length())
    else:
        model, coupling = wp.load(args.model), Coupling()
    zigzag, armchair = (edge_constants(armchair=turned) for turned in (False, True))
    round_edge = (zigzag["stiffness"] + armchair["stiffness"]) / 2
    whole = mesh_outline(box(2 * INSIDE, 2 * INSIDE), size=8.0)
    table: dict[str, dict[str, float]] = {}
    for plate in (*HOLES, STRIP):
        edge = args.edge_times * (round_edge if plate.radius else zigzag["stiffness"])
        for load, sample in zip(loads_of(plate, **asked), samples[plate]):
            name = f"{plate.name} {load.name}"
            table[name] = compare(model, plate, sample, edge, whole, coupling)
    numbers = {
        "zigzag_edge": zigzag,
        "armchair_edge": armchair,
        "largest_error": max(row["error"] for row in table.values()),
        "cases": table,
        "seconds": time.perf_counter() - start,
    }
    print(json.dumps(numbers) if args.json else json.dumps(numbers, indent=1))
    draw(table).savefig(args.out / "errors.png", dpi=120)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
