"""The published HGO fields of the MetaNO repository, held against our finite elements.

The repository (github.com/fishmoon1234/MetaNO, MIT licence) has displacement of a square on 41 × 41
nodes: one edge fixed, traction on the other, six parameters a task. It is read where you put it;
two of its loads are kept with the tests (tests/examples/metano, with its licence). Linear triangles
on the same nodes give the published numbers back; what quadratic elements and fibres that carry
compression would change is measured beside it.
"""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

from tools.hyperelastic_elements import (
    Elements,
    NotSolved,
    finite_elements,
    quadrilaterals,
    triangles,
)
from tools.hyperelastic_energies import Family, Matrix, hgo
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain

DATA = "data/Example1_HGO/Neumann_indis_sensitive_analysis_balance_range_grf_alpha_2"
TABLE = "HGO_neumann_indistribution_sensitive_analysis_balance_range_grf_alpha_2.txt"
NODES = 41


def published(repository: Path, task: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters E, ν, k1, k2, α; tractions, shape [S, 41]; displacements, shape [S, 41, 41, 2]."""
    folder = repository / DATA
    try:
        table = np.loadtxt(folder / TABLE, ndmin=2)
        tractions = np.loadtxt(folder / "Traction_neumann.txt")
        u = np.loadtxt(folder / f"displacement_neumann{task}.txt")
    except OSError as error:
        raise InputError(f"{repository}: expected the MetaNO repository ({error})") from None
    return table[table[:, 0] == task][0, 1:], tractions, u.reshape(-1, NODES, NODES, 2)


class PulledSheet:
    """A meshed square, fixed below and pulled upwards above."""

    def __init__(self, mesh: Any, element: Any, order: int) -> None:
        self.skfem = finite_elements()
        self.mesh = Elements(mesh, element, order=order)
        above = mesh.facets_satisfying(lambda x: np.isclose(x[1], 1))
        self.edge = self.skfem.FacetBasis(mesh, element, facets=above)
        below = np.flatnonzero(np.isclose(self.mesh.x[:, 1], 0))
        self.fixed = np.sort(np.concatenate([2 * below, 2 * below + 1]))
        line = np.linspace(0, 1, NODES)
        self.x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)

    def error(self, energy: Matrix, traction: np.ndarray, u: np.ndarray) -> float:
        """Relative difference from a published field; NaN where no equilibrium is found."""
        line = np.linspace(0, 1, len(traction))
        form = self.skfem.LinearForm(lambda v, w: np.interp(w.x[0], line, traction) * v)
        load = np.zeros(2 * self.mesh.nodes)
        load[1::2] = form.assemble(self.edge)
        try:
            solved = self.mesh.solve(energy, load, self.fixed, np.zeros(len(self.fixed)), steps=4)
        except NotSolved:
            return float("nan")
        gap = self.mesh.sample(solved, self.x).reshape(u.shape) - u
        return float(np.linalg.norm(gap) / np.linalg.norm(u))


def check(repository: Path, tasks: list[int], samples: list[int]) -> dict[str, dict[str, Any]]:
    """Relative differences by task and by way of computing."""
    skfem = finite_elements()
    linear = PulledSheet(triangles(NODES - 1), skfem.ElementTriP1(), 2)
    quadratic = PulledSheet(quadrilaterals(20), skfem.ElementQuad2(), 4)
    differences = {}
    for task in tasks:
        (E, nu, k1, k2, angle), tractions, u = published(repository, task)
        families = [Family(sign * angle, k1, k2) for sign in (1, -1)]
        ways = {
            "linear triangles": (linear, hgo(E, nu, families)),
            "quadratic elements": (quadratic, hgo(E, nu, families)),
            "compressed fibres": (quadratic, hgo(E, nu, families, tension_only=False)),
        }
        differences[f"task {task}"] = {
            name: [body.error(energy, tractions[s], u[s]) for s in samples]
            for name, (body, energy) in ways.items()
        }
    return differences


def main() -> None:
    parser = Options(__doc__, json=True)
    parser.add("repository", type=Path, help="a clone of MetaNO")
    parser.add("--tasks", type=int, nargs="+", default=[0, 1])
    parser.add("--samples", type=int, nargs="+", default=[0, 1, 5])
    given = parser.parse_args()
    differences = check(given.repository, given.tasks, given.samples)
    if given.json:
        print(json.dumps(plain(differences), indent=2))
        return
    for task, ways in differences.items():
        for name, errors in ways.items():
            print(f"{task}, {name}: {', '.join(f'{100 * e:.4f} %' for e in errors)}")


if __name__ == "__main__":
    sys.exit(exit_status(main))
