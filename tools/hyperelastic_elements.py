"""Plane finite elements at large deformation for any energy: mesh and shapes by scikit-fem."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from tools.hyperelastic_energies import Energy
from warp_peri.errors import InputError

SMALLEST_JACOBIAN = 0.02
"""A field with a smaller det F somewhere is folded: the step that led there is shortened."""

# c = (C11, C22, C12) of F = (F11, F12, F21, F22): ∂²c/∂F².
SECOND = np.zeros((3, 4, 4))
SECOND[0, 0, 0] = SECOND[0, 2, 2] = SECOND[1, 1, 1] = SECOND[1, 3, 3] = 2
SECOND[2, 0, 1] = SECOND[2, 1, 0] = SECOND[2, 2, 3] = SECOND[2, 3, 2] = 1


class NotSolved(RuntimeError):
    """Newton's method found no equilibrium; the message says how far it came."""


class Elements:
    """A meshed sheet.

    Args:
        mesh: of scikit-fem, plane.
        element: of scikit-fem, scalar; quadratic quadrilaterals where none is given.
        order: of the quadrature.
        springs: a stiffness added to that of the sheet, shape [2 N, 2 N].

    Raises InputError when scikit-fem is missing.
    """

    def __init__(
        self,
        mesh: Any,
        element: Any = None,
        *,
        order: int = 4,
        springs: sp.csr_matrix | None = None,
    ) -> None:
        skfem = finite_elements()
        self.basis = skfem.Basis(
            mesh, skfem.ElementQuad2() if element is None else element, intorder=order
        )
        self.x = self.basis.doflocs.T
        self.nodes = len(self.x)
        self.springs = springs
        local = [self.basis.basis[n][0] for n in range(self.basis.Nbfun)]
        cells = self.basis.element_dofs.T
        shape = self.basis.dx.shape
        self.N = np.stack([np.broadcast_to(np.asarray(f), shape) for f in local], axis=-1)
        G = np.stack([np.moveaxis(np.broadcast_to(f.grad, (2, *shape)), 0, -1) for f in local], 2)
        self.cells, self.dx = cells, self.basis.dx
        self.dofs = (2 * cells[:, :, None] + np.arange(2)).reshape(len(cells), -1)
        self.B = np.zeros((*shape, 4, 2 * len(local)))
        for d in range(2):
            self.B[:, :, 2 * d : 2 * d + 2, d::2] = np.swapaxes(G, 2, 3)
        width = self.dofs.shape[1]
        self._rows = np.repeat(self.dofs, width, axis=1).ravel()
        self._columns = np.tile(self.dofs, (1, width)).ravel()
        self.quadrature = np.einsum("eqa,ead->eqd", self.N, self.x[cells])

    @property
    def edge(self) -> np.ndarray:
        """Degrees of freedom on the boundary."""
        nodes = self.basis.get_dofs().flatten()
        return np.sort(np.concatenate([2 * nodes, 2 * nodes + 1]))

    def gradient(self, u: np.ndarray) -> np.ndarray:
        """F at the quadrature points, shape [E, Q, 4]."""
        F = np.einsum("eqia,ea->eqi", self.B, u[self.dofs], optimize=True)
        F[..., [0, 3]] += 1
        return F

    def load(self, b: Callable[[np.ndarray], np.ndarray], *, nodal: bool = False) -> np.ndarray:
        """Forces of a body force b(x) on the degrees of freedom, shape [2 N].

        With nodal its values at the nodes are interpolated by the elements first.
        """
        if nodal:
            field = np.einsum("eqa,ead->eqd", self.N, b(self.x)[self.cells])
        else:
            field = b(self.quadrature)
        local = np.einsum("eqa,eqd,eq->ead", self.N, field, self.dx, optimize=True)
        return np.bincount(self.dofs.ravel(), local.ravel(), 2 * self.nodes)

    def internal(self, energy: Energy, u: np.ndarray) -> np.ndarray | None:
        """Internal forces, shape [2 N]; None where the field is folded."""
        stresses = self._stresses(energy, u)
        if stresses is None:
            return None
        P = stresses[0]
        local = np.einsum("eqia,eqi,eq->ea", self.B, P, self.dx, optimize=True)
        f = np.bincount(self.dofs.ravel(), local.ravel(), 2 * self.nodes)
        return f if self.springs is None else f + self.springs @ u

    def tangent(self, energy: Energy, u: np.ndarray) -> sp.csc_matrix:
        """Their derivative, shape [2 N, 2 N]."""
        stresses = self._stresses(energy, u)
        if stresses is None:
            raise NotSolved("tangent of a folded field")
        _, g, H, B = stresses
        A = np.einsum("eqki,eqkl,eqlj->eqij", B, H, B, optimize=True)
        A += np.einsum("eqk,kij->eqij", g, SECOND)
        A *= self.dx[..., None, None]
        cells, points = self.dx.shape
        AB = np.matmul(A, self.B).reshape(cells, 4 * points, -1)
        local = np.matmul(self.B.reshape(cells, 4 * points, -1).transpose(0, 2, 1), AB)
        K = sp.csc_matrix((local.ravel(), (self._rows, self._columns)), shape=2 * [2 * self.nodes])
        return K if self.springs is None else (K + self.springs).tocsc()

    def _stresses(self, energy: Energy, u: np.ndarray) -> tuple[np.ndarray, ...] | None:
        F = self.gradient(u)
        jacobian = F[..., 0] * F[..., 3] - F[..., 1] * F[..., 2]
        if not jacobian.min() > SMALLEST_JACOBIAN:
            return None
        c = np.stack(
            [
                F[..., 0] ** 2 + F[..., 2] ** 2,
                F[..., 1] ** 2 + F[..., 3] ** 2,
                F[..., 0] * F[..., 1] + F[..., 2] * F[..., 3],
            ],
            axis=-1,
        )
        _, g, H = energy(c)
        B = np.einsum("kij,eqj->eqki", SECOND, F, optimize=True)
        return np.einsum("eqk,eqki->eqi", g, B), g, H, B

    def sample(self, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Displacement at points of shape [P, 2], shape [P, 2]."""
        probes = self.basis.probes(x.T)
        return np.stack([probes @ u[0::2], probes @ u[1::2]], axis=-1)

    def solve(
        self,
        energy: Energy,
        load: np.ndarray,
        fixed: np.ndarray,
        given: np.ndarray,
        *,
        start: np.ndarray | None = None,
        steps: int = 1,
        proportional: bool = True,
        tolerance: float = 1e-9,
    ) -> np.ndarray:
        """Displacement in equilibrium, shape [2 N], by Newton's method on a growing load.

        Args:
            energy: of the sheet.
            load: forces, shape [2 N].
            fixed: degrees of freedom that are given.
            given: their displacements.
            start: where to begin; at rest where none is given.
            steps: load steps to try first; halved where one does not converge.
            proportional: whether the load grows from zero, or is there at once (from a start under
                a smaller one).
            tolerance: of the largest residual, relative to the largest force.

        Raises NotSolved when a load step below a thousandth does not converge.
        """
        u = np.zeros(2 * self.nodes) if start is None else start.copy()
        free = np.setdiff1d(np.arange(2 * self.nodes), fixed)
        origin, done, step = u[fixed].copy(), 0.0, 1.0 / steps
        while done < 1 - 1e-12:
            target = min(1.0, done + step)
            prescribed = origin + target * (given - origin)
            part = target if proportional else 1.0
            moved = self._step(energy, part * load, free, fixed, prescribed, u, tolerance)
            if moved is None:
                step /= 2
                if step < 1e-3:
                    raise NotSolved(f"no equilibrium beyond {100 * done:.1f} % of the load")
            else:
                u, done, step = moved, target, min(1.0, 1.5 * step)
        return u

    def _step(
        self,
        energy: Energy,
        load: np.ndarray,
        free: np.ndarray,
        fixed: np.ndarray,
        given: np.ndarray,
        u: np.ndarray,
        tolerance: float,
    ) -> np.ndarray | None:
        """One load step; None where Newton's method does not converge."""
        internal = self.internal(energy, u)
        if internal is None:
            return None
        K = self.tangent(energy, u)
        move = given - u[fixed]
        pushed = K[free][:, fixed] @ move
        scale = max(np.abs(load).max(), np.abs(internal).max(), np.abs(pushed).max(), 1e-30)
        v = u.copy()
        v[fixed] = given
        v[free] += splu(K[free][:, free]).solve((load - internal)[free] - pushed)
        for _ in range(30):
            internal = self.internal(energy, v)
            if internal is None:
                return None
            residual = (load - internal)[free]
            size = np.abs(residual).max()
            if size < tolerance * scale:
                return v
            dv = splu(self.tangent(energy, v)[free][:, free]).solve(residual)
            part = 1.0
            while True:
                w = v.copy()
                w[free] += part * dv
                internal = self.internal(energy, w)
                if internal is not None and np.abs((load - internal)[free]).max() < 2 * size:
                    break
                part /= 2
                if part < 1e-3:
                    return None
            v = w
        return None


def finite_elements() -> Any:
    """scikit-fem, or InputError that says how to get it."""
    try:
        import skfem
    except ImportError:
        raise InputError("scikit-fem is missing: pip install 'warp_peri[compare]'") from None
    return skfem


def quadrilaterals(count: int, side: float = 1.0, first: float = 0.0) -> Any:
    """A square mesh of count × count quadrilaterals."""
    line = np.linspace(first, first + side, count + 1)
    return finite_elements().MeshQuad.init_tensor(line, line)


def triangles(count: int, side: float = 1.0, first: float = 0.0) -> Any:
    """A square mesh of count × count squares, each of two triangles."""
    line = np.linspace(first, first + side, count + 1)
    return finite_elements().MeshTri.init_tensor(line, line)
