"""A whole body in linear elements: a first guess, and the long waves of an exchange (B11)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from warp_peri.statics.body_loads import BodyLoads
from warp_peri.statics.rim import Rim, RimProblem


class WholeBody:
    """Linear elements on every cell, factorised once.

    Were the bulk elements of the same kind, one exchange would be g ↦ M g + r with a matrix M for
    which (I − M)⁻¹ is a solve of the whole body: `correct`. What is left for GMRES is the
    difference between the bulk and those elements.

    Args:
        elements: all cells of the body's mesh, of degree 1.
        K: their stiffness [TPa], shape [d P, d P].
        loads: of the body.
        rim: its rim.
        depth: distance of the mesh's corners from the outline [Å], shape [P].
        collar: depth of the bulk's collar [Å].
    """

    def __init__(
        self,
        elements: Rim,
        K: sp.csr_array,
        loads: BodyLoads,
        rim: Rim,
        depth: np.ndarray,
        collar: float,
    ) -> None:
        self.elements, self.loads = elements, loads
        self.given, fixed = loads.given(elements)
        self.problem = RimProblem(K, fixed.ravel())
        is_corner = np.full(len(rim.x), -1)
        is_corner[rim.corner_nodes] = rim.corners
        corner = is_corner[rim.inner]
        self.rows = np.flatnonzero(corner >= 0)
        """Of the inner side's nodes those that are corners."""
        side = corner[self.rows]
        inside = np.setdiff1d(rim.corners, side)
        shared, outer = inside[depth[inside] >= collar], inside[depth[inside] < collar]
        side, shared, self.outer = (
            _displacements(elements.corner_nodes[corners], rim.d)
            for corners in (side, shared, outer)
        )
        shared = shared[~fixed.ravel()[shared]]
        K = sp.csr_array(K)
        self.overlap = splu(K[shared][:, shared].tocsc()) if len(shared) else None
        self.from_side = K[shared][:, side]
        self.to_outer = K[self.outer][:, shared]
        self.past = K[self.outer][:, side]
        x = rim.x[rim.inner]
        self.trace = elements.probe(x, rim.mesh.holding(x))

    def guess(self) -> np.ndarray:
        """Displacement of the rim's inner side [Å], shape [G, d]."""
        f = self.loads.on(self.elements)
        u = self.problem.solve(f.ravel(), self.given.ravel()).reshape(f.shape)
        return np.asarray(self.trace @ u)

    def correct(self, jump: np.ndarray) -> np.ndarray:
        """(I − M)⁻¹ of these elements, of a jump of the inner side, both of shape [G, d]."""
        side = jump[self.rows].ravel()
        pull = -self.past @ side
        if self.overlap is not None:
            pull += self.to_outer @ self.overlap.solve(self.from_side @ side)
        f = np.zeros(self.elements.x.size)
        f[self.outer] = pull
        u = self.problem.solve(f, np.zeros_like(f)).reshape(self.elements.x.shape)
        corrected: np.ndarray = jump + self.trace @ u
        return corrected

    def correct_transposed(self, jump: np.ndarray) -> np.ndarray:
        """The transpose of `correct`."""
        f = np.asarray(self.trace.T @ jump).ravel()
        u = self.problem.solve(f, np.zeros_like(f))[self.outer]
        side = -self.past.T @ u
        if self.overlap is not None:
            side += self.from_side.T @ self.overlap.solve(self.to_outer.T @ u, trans="T")
        corrected = np.array(jump)
        corrected[self.rows] += side.reshape(-1, jump.shape[1])
        return corrected


def _displacements(nodes: np.ndarray, d: int) -> np.ndarray:
    """All displacements of each node."""
    return np.asarray((d * nodes[:, None] + np.arange(d)).ravel())
