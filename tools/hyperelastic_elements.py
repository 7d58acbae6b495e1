"""Plane finite elements at large deformation for any energy: mesh and shapes by scikit-fem."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch

from tools.hyperelastic_energies import Energy
from warp_peri import InputError
from warp_peri.solvers.systems import symmetric_factors

SMALLEST_JACOBIAN = 0.02
"""A field with a smaller det F somewhere is folded: the step that led there is shortened."""


class NotSolved(RuntimeError):
    """Newton's method found no equilibrium; the message says how far it came."""


class Elements:
    """A meshed sheet.

    Args:
        mesh: of scikit-fem, plane.
        element: of scikit-fem, scalar; quadratic quadrilaterals where none is given.
        order: of the quadrature.

    Raises InputError when scikit-fem is missing.
    """

    springs: sp.csr_matrix | None = None
    """A stiffness added to that of the sheet, shape [2 N, 2 N]."""

    def __init__(self, mesh: Any, element: Any = None, *, order: int = 4) -> None:
        skfem = finite_elements()
        self.basis = skfem.Basis(
            mesh, skfem.ElementQuad2() if element is None else element, intorder=order
        )
        self.x = self.basis.doflocs.T
        self.nodes = len(self.x)
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
        width, size = self.dofs.shape[1], 2 * self.nodes
        keys = np.tile(self.dofs, (1, width)) * size + np.repeat(self.dofs, width, axis=1)
        entries, self._entry = np.unique(keys.ravel(), return_inverse=True)
        self._rows = (entries % size).astype(np.int32)
        self._ends = np.searchsorted(entries // size, np.arange(size + 1)).astype(np.int32)
        self.quadrature = np.einsum("eqa,ead->eqd", self.N, self.x[cells])

    @property
    def edge(self) -> np.ndarray:
        """Degrees of freedom on the boundary."""
        nodes = self.basis.get_dofs().flatten()
        return np.sort(np.concatenate([2 * nodes, 2 * nodes + 1]))

    def gradient(self, u: np.ndarray) -> np.ndarray:
        """F at the quadrature points, shape [E, Q, 4]."""
        cells, points = self.dx.shape
        F = np.matmul(self.B.reshape(cells, 4 * points, -1), u[self.dofs][:, :, None])
        F = F.reshape(cells, points, 4)
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

    def forces(self, P: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Internal forces of ∂W/∂F, and of springs at u, shape [2 N]."""
        cells = len(self.dx)
        carried = (P * self.dx[..., None]).reshape(cells, 1, -1)
        local = np.matmul(carried, self.B.reshape(cells, carried.shape[2], -1))
        f = np.bincount(self.dofs.ravel(), local.ravel(), 2 * self.nodes)
        return f if self.springs is None else f + self.springs @ u

    def stiffness(self, A: np.ndarray) -> sp.csc_matrix:
        """Their derivative, of ∂²W/∂F², shape [2 N, 2 N]."""
        cells, points = self.dx.shape
        AB = np.matmul(A * self.dx[..., None, None], self.B).reshape(cells, 4 * points, -1)
        local = np.matmul(self.B.reshape(cells, 4 * points, -1).transpose(0, 2, 1), AB)
        # symmetric: what stands row by row may be read column by column
        values = np.bincount(self._entry, local.ravel(), len(self._rows))
        K = sp.csc_matrix((values, self._rows, self._ends), shape=2 * [2 * self.nodes])
        return K if self.springs is None else (K + self.springs).tocsc()

    def state(self, energy: Energy, u: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """∂W/∂F [E, Q, 4] and ∂²W/∂F² [E, Q, 4, 4] at the quadrature points; None if folded."""
        F = torch.from_numpy(self.gradient(u)).requires_grad_()
        xx, xy, yx, yy = F.unbind(-1)
        if not (xx * yy - xy * yx).min() > SMALLEST_JACOBIAN:
            return None
        c = torch.stack([xx**2 + yx**2, xy**2 + yy**2, xx * xy + yx * yy], dim=-1)
        (P,) = torch.autograd.grad(energy(c).sum(), F, create_graph=True)
        rows = [torch.autograd.grad(one.sum(), F, retain_graph=True)[0] for one in P.unbind(-1)]
        return P.detach().numpy(), torch.stack(rows, dim=-2).numpy()

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
        state = self.state(energy, u)
        if state is None:
            return None
        internal, K = self.forces(state[0], u), self.stiffness(state[1])
        move = given - u[fixed]
        v, w = np.zeros_like(u), u.copy()
        v[fixed] = move
        pushed = (K @ v)[free]
        scale = max(np.abs(load).max(), np.abs(internal).max(), np.abs(pushed).max(), 1e-30)
        w[fixed] = given
        w[free] += symmetric_factors(between(K, free)).solve((load - internal)[free] - pushed)
        state = self.state(energy, w)
        for _ in range(30):
            if state is None:
                return None
            residual = (load - self.forces(state[0], w))[free]
            size = np.abs(residual).max()
            if size < tolerance * scale:
                return w
            step = symmetric_factors(between(self.stiffness(state[1]), free)).solve(residual)
            part = 1.0
            while True:
                v = w.copy()
                v[free] += part * step
                state = self.state(energy, v)
                if state is not None:
                    left = np.abs((load - self.forces(state[0], v))[free]).max()
                    if left < 2 * size:
                        break
                part /= 2
                if part < 1e-3:
                    return None
            w = v
        return None


def between(K: sp.csc_matrix, free: np.ndarray) -> sp.csc_matrix:
    """Rows and columns of the free degrees of freedom."""
    return K if len(free) == K.shape[0] else K[free][:, free]


def finite_elements() -> Any:
    """scikit-fem, or InputError that says how to get it."""
    try:
        import skfem
    except ImportError:
        raise InputError("scikit-fem is missing: pip install 'warp_peri[compare]'") from None
    return skfem


def square_mesh(kind: str, count: int, side: float = 1.0, first: float = 0.0) -> Any:
    """A square of count × count squares of scikit-fem's MeshQuad, or of MeshTri's two triangles."""
    line = np.linspace(first, first + side, count + 1)
    return getattr(finite_elements(), kind).init_tensor(line, line)
