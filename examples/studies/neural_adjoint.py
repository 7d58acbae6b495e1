"""Two derivatives of an equilibrium to the numbers of the networks: what they give and cost.

One goes back through every step of the printed search by conjugate directions, the other solves one
linear problem at the equilibrium. The shipped weights of the leaflet, in double precision, on a
sheet whose edge is stretched and bent. Seconds are of one processor; memory is what torch keeps for
the way back, and for the adjoint the factors of the tangent too.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import torch
from torch.autograd.graph import saved_tensors_hooks

import warp_peri as wp
from examples.reproduce.descent import Descent, polak_ribiere
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.launch import set_threads
from warp_peri.neural import NeuralEquilibrium

WEIGHTS = ROOT / "examples" / "neural_weights" / "leaflet.json"
SPACING, SIDE, STRETCH = 0.05, 16, 0.2
"""Of the nodes, nodes with equations along a side, and how far the edge is stretched."""
STEPS = (10, 20, 40, 80)
ENOUGH = 1e-5
"""Of the residual over that of the start, where starts are compared."""


class Kept:
    """Bytes of different memory that torch keeps for the way back while this is entered."""

    def __init__(self) -> None:
        self.seen: dict[int, int] = {}
        self.hooks = saved_tensors_hooks(self._keep, lambda part: part)

    def _keep(self, part: torch.Tensor) -> torch.Tensor:
        memory = part.untyped_storage()
        self.seen[memory.data_ptr()] = memory.nbytes()
        return part

    @property
    def megabytes(self) -> float:
        return sum(self.seen.values()) / 1e6


def edge(x: np.ndarray, stretch: float) -> np.ndarray:
    """A displacement that stretches along x and bends, shape [N, 2]."""
    bent = 0.3 * stretch * np.sin(3 * x[:, ::-1]) * [1.0, 0.5]
    return stretch * x * [1.0, -0.3] + bent


def gradient(material: Any) -> torch.Tensor:
    """All derivatives that were added up, in one row; they are set to zero."""
    found = torch.cat([part.grad.ravel().clone() for part in material.parameters()])
    material.zero_grad()
    return found


def measured() -> dict[str, Any]:
    """Both derivatives of the squared distance from a target, and two starts."""
    material = wp.load(WEIGHTS).double()
    wide = round(2 * material.horizon / SPACING)
    steps = np.indices(2 * (SIDE + 2 * wide,)).reshape(2, -1).T - wide
    inner = ((steps >= 0) & (steps < SIDE)).all(axis=1)
    points = wp.Points(SPACING * (steps - (SIDE - 1) / 2), inner, SPACING, units=material.units)
    placed = material.on(points)
    rows, inside = torch.as_tensor(placed.bonds.rows), points.interior[:, None]
    wanted = edge(points.x, STRETCH)
    u = torch.as_tensor(np.where(inside, 0.0, wanted))
    target, zeros = torch.as_tensor(1.02 * wanted)[rows], torch.zeros(len(rows), 2)

    def force(inner: torch.Tensor) -> torch.Tensor:
        return placed(u.index_copy(0, rows, inner))

    def walked(start: torch.Tensor, tolerance: float, most: int) -> tuple[torch.Tensor, Descent]:
        return polak_ribiere(force, start.double(), tolerance=tolerance, most=most)

    began, none = time.process_time(), np.zeros_like(wanted)
    search, kept = NeuralEquilibrium(placed), Kept()
    problem = wp.Dirichlet(points, torch.as_tensor(none), u)
    answer = wp.solve(placed, problem, solver=wp.Newton(tolerance=1e-12)).u
    adjoint, began = {"solve": time.process_time() - began}, time.process_time()
    with kept.hooks:
        ((answer[rows] - target) ** 2).sum().backward()
    adjoint["derivative"], exact = time.process_time() - began, gradient(material)
    adjoint["MB"] = kept.megabytes
    unrolled = []
    for most in STEPS:
        kept, began = Kept(), time.process_time()
        with kept.hooks:
            there, record = walked(zeros, 0.0, most)
            ((there - target) ** 2).sum().backward()
        seconds = time.process_time() - began
        gap = float((gradient(material) - exact).norm() / exact.norm())
        unrolled.append(
            {"steps": record.steps, "residual": record.residual, "gap": gap}
            | {"seconds": seconds, "MB": kept.megabytes}
        )
    before = search.from_rest(none, edge(points.x, 0.9 * STRETCH)).u
    needed: dict[str, int | None] = {}
    scale = float(force(zeros.double()).detach().norm())
    for name, start in (("zeros", zeros), ("neighbour", torch.as_tensor(before)[rows])):
        with torch.no_grad():
            own = float(force(start.double()).norm())
            record = walked(start, ENOUGH * scale / own, 1000)[1]
        needed[name] = record.steps if record.converged else None
    return {"nodes": len(rows), "adjoint": adjoint, "unrolled": unrolled, "steps_from": needed}


def main() -> int:
    """Measure and print."""
    parser = Options(__doc__, json=True)
    given = parser.parse_args()
    set_threads(1)
    torch.set_num_threads(1)
    numbers = measured()
    print(json.dumps(numbers) if given.json else json.dumps(numbers, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
