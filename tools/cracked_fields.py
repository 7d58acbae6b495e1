"""Linear atoms of a cracked sheet whose rim is pulled, seen from nodes on either side."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tools.cracked_sheet import CutSession, Pulled, cracked_sheet, longer_cutoff
from tools.hessian import ColouredHessian
from warp_peri.stability.inertia import symmetric_factors

AROUND = 5.0
"""Radius within which atoms of a node's own side tell its displacement [Å]."""


@dataclass(frozen=True)
class Opened:
    """A sheet with a crack along y = 0.

    Attributes:
        x: atoms at rest, their faces relaxed [Å], shape [A, 2].
        u: displacement over the strain of the rim along y [Å], shape [A, 2].
        length: half of the crack [Å].
        step: width of a hexagon along the crack [Å].
        half: half sides of the part that moves [Å].
    """

    x: np.ndarray
    u: np.ndarray
    length: float
    step: float
    half: float

    def seen(self, nodes: np.ndarray) -> np.ndarray:
        """u at nodes [n, 2], quadratic fits to atoms around; across the crack none are asked."""
        tree, found = cKDTree(self.x), np.empty_like(nodes)
        for i, near in enumerate(tree.query_ball_point(nodes, AROUND)):
            near = np.array(near)
            if abs(nodes[i, 0]) < self.length + AROUND:
                near = near[self.x[near, 1] * nodes[i, 1] > 0]
            dx, dy = (self.x[near] - nodes[i]).T
            weight = np.sqrt(np.maximum(AROUND - np.hypot(dx, dy), 0))[:, None]
            terms = np.column_stack([np.ones(len(near)), dx, dy, dx**2, dx * dy, dy**2])
            found[i] = np.linalg.lstsq(weight * terms, weight * self.u[near])[0][0]
        return found


def opened_sheet(steps: int = 10, half: float = 70.0) -> Opened:
    """The linear answer of a square with a crack of 2 · steps cut bonds, at 0 K."""
    step = cracked_sheet([], half=10.0).step
    ends = np.array([[-steps * step, 0.0], [steps * step, 0.0]])
    body = cracked_sheet([ends], half=half)
    with tempfile.TemporaryDirectory() as folder:
        potential = longer_cutoff(Path(folder))
        with CutSession(body, potential) as session:
            x, found = Pulled(body, session).rest(body.positions)
            if not found:
                raise RuntimeError("the cracked sheet found no rest")
            H = ColouredHessian(body.bonds, len(x))(session.forces, x)
    held = np.repeat(body.held, 2)
    u = x * (0.0, 1.0)
    flat = u.ravel()
    right = -(H[~held][:, held] @ flat[held])
    flat[~held] = symmetric_factors(H[~held][:, ~held]).solve(right)
    return Opened(x, flat.reshape(-1, 2), steps * step, step, half)
