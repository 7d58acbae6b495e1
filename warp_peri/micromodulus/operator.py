"""The operator of a law on nodes: force, tangent product, energy, stress (theory.md, T1, T15)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.core.grid import Grid
from warp_peri.core.stencil import Stencil
from warp_peri.core.sweeps import Product
from warp_peri.points.arrays import checked, checked_fields
from warp_peri.points.points import Points
from warp_peri.statics.linear import Linear
from warp_peri.statics.settings import Krylov, Solver, refuse_solver
from warp_peri.statics.solution import Solution


class TensorOperator:
    """L of one law on the nodes of one lattice, all bonds whole.

    Made by Crystal.on.

    Args:
        points: lattice nodes with a collar, or periodic.
        stencil: of the law.
        elastic: C_ijkl along the nodes' axes [stress], for `stress`.
        method: "rows", "fft", or "auto", which takes what is faster.
        dtype: float64 or float32.
        why: said beside the error for nodes whose bonds are cut.
        model: the law, as it is told.
        product: of these nodes and dtype, in place of rows of the law's own bonds.

    Raises InputError as grid_of does.
    """

    def __init__(
        self,
        points: Points,
        stencil: Stencil,
        elastic: np.ndarray,
        *,
        method: str = "auto",
        dtype: Any = np.float64,
        why: str = "",
        model: Any = None,
        product: Callable[[Grid, Any], Product] | None = None,
    ) -> None:
        self.points, self.spacing, self.model = points, stencil.spacing, model
        self.elastic = elastic
        self.linear = Linear(stencil, points, by=method, dtype=dtype, why=why, product=product)
        self.nodes, self.pull, self.dtype = self.linear.grid, self.linear.pull, self.linear.dtype
        self.steps, self.tensors, self.method = stencil.steps, stencil.tensors, self.linear.by

    def __call__(self, u: ArrayLike) -> np.ndarray:
        """L u, minus the internal force density [stress/length], at the interior nodes.

        u [length], shape [..., N, d]; returns shape [..., I, d]. Raises InputError for another
        shape or values that are not finite.
        """
        fields, lead = self.checked(u)
        force = self.linear(fields)
        return force.reshape(*lead, *force.shape[1:])

    def load(self, b: ArrayLike) -> np.ndarray:
        """b [stress/length] on the interior nodes, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """In equilibrium with b on the interior, u given on the collar, shape [..., N, d].

        Args:
            b, u: on all nodes; b counts on the interior, u on the collar.
            solver: Krylov(preconditioner, tolerance), or None.

        Raises InputError as Linear.solve does.
        """
        refuse_solver(solver, (Krylov,), "a law of micromodulus tensors")
        asked = solver if isinstance(solver, Krylov) else Krylov()
        b, u = checked_fields(self.points, b, u)
        loads, fields = (field.reshape(-1, *self.points.x.shape) for field in (b, u))
        proof = getattr(self.model, "certificate", None)
        if proof is None or not proof.holds:
            self.linear.check_definite()
        found, took = self.linear.solve(loads, fields, asked.tolerance, asked.preconditioner)
        answer = found.reshape(u.shape)
        proven = None
        if proof is not None and proof.holds:
            proven = f"one stable answer: D(k) ≥ {proof.proven:.3g} s(k) for all k"
        return Solution(
            answer,
            self.points,
            self,
            self.load(b),
            self.linear.method(asked.preconditioner),
            tuple(each.iterations for each in took),
            proven,
            details=tuple(took),
            measured=max((each.residual for each in took), default=None),
        )

    def rest_periodic(self, b: ArrayLike, solver: Solver = None) -> Solution:
        """In equilibrium with b on a period, without its mean; as `rest`."""
        return self.rest(b, np.zeros(np.shape(b)), solver)

    def product(self, u: ArrayLike, v: ArrayLike) -> np.ndarray:
        """The derivative of L u along v, shape [..., I, d]: L v, whatever u, for L is linear."""
        return self(v)

    def energy(self, u: ArrayLike) -> np.ndarray | float:
        """Energy [stress · length^d] of all bonds with an unknown at an end, shape [...] (T15).

        Its derivative to the interior displacement is h^d L u. (In the plane for a unit thickness.)
        """
        fields, lead = self.checked(u)
        planes = self.nodes.scatter(fields)
        nodes, r = self.nodes, self.nodes.reach
        inside = nodes.unknown
        asked = np.pad(inside, r, mode="wrap" if nodes.periodic else "constant")
        middle = planes[(slice(None), slice(None), *nodes.core)]
        total = np.zeros(len(fields))
        for sign in (1, -1):
            for step, C in zip(sign * self.steps, self.tensors):
                part = tuple(slice(r + s, n - r + s) for s, n in zip(step, nodes.wide))
                pull = middle - planes[(slice(None), slice(None), *part)]
                weight = np.where(asked[part], 0.25, 0.5) * inside  # a bond of two unknowns: twice
                bent = np.einsum("ij,sj...->si...", C, pull)
                total += ((pull * bent).sum(axis=1) * weight).reshape(len(fields), -1).sum(axis=1)
        total *= self.spacing**nodes.dimension
        return total.reshape(lead) if lead else float(total[0])

    def gradient(self, u: ArrayLike) -> np.ndarray:
        """∂u_a/∂x_b at the interior nodes by least squares over the family, [..., I, d, d]."""
        fields, lead = self.checked(u)
        planes, nodes, r = self.nodes.scatter(fields), self.nodes, self.nodes.reach
        d = nodes.dimension
        xi = self.spacing * self.steps
        inverse = np.linalg.inv(2 * xi.T @ xi)
        found = np.zeros((len(fields), d, d, *(n - 2 * r for n in nodes.wide)))
        for step, weight in zip(self.steps, xi @ inverse):
            ahead, behind = (
                planes[
                    (
                        slice(None),
                        slice(None),
                        *(slice(r + s * g, n - r + s * g) for s, n in zip(step, nodes.wide)),
                    )
                ]
                for g in (1, -1)
            )
            for b in range(d):
                found[:, :, b] += weight[b] * (ahead - behind)
        if not nodes.periodic:
            found = np.pad(found, [(0, 0)] * 3 + [(r, r)] * d)
        flat = found.reshape(len(fields), d, d, -1)[..., nodes.interior]
        A = nodes.axes
        local = np.einsum("ai,sijn,bj->snab", A, flat, A, optimize=True)
        return np.asarray(local.reshape(*lead, *local.shape[1:]))

    def stress(self, u: ArrayLike) -> np.ndarray:
        """σ = C : ε at the interior nodes [stress], ε from `gradient`, shape [..., I, d, d].

        Exact on affine fields; on others the stress of the solid that long waves see.
        """
        A = self.nodes.axes
        C = np.einsum("ai,bj,ck,dl,ijkl->abcd", A, A, A, A, self.elastic, optimize=True)
        return np.asarray(np.einsum("abcd,...cd->...ab", C, self.gradient(u), optimize=True))

    def matrix(self) -> sp.csr_array:
        """L as a sparse matrix of all nodes' displacements, shape [d I, d N]."""
        nodes, A, d = self.nodes, self.nodes.axes, self.nodes.dimension
        number = np.full(int(np.prod(nodes.shape)), -1)
        number[nodes.place] = nodes.near
        at = np.stack(np.unravel_index(nodes.interior, nodes.shape), axis=1)
        far = at[:, None] + np.concatenate([0 * self.steps[:1], self.steps, -self.steps])
        far = far % nodes.shape if nodes.periodic else far
        ends = number[np.ravel_multi_index(tuple(np.moveaxis(far, -1, 0)), nodes.shape)]
        C = A @ self.tensors @ A.T
        blocks = np.concatenate([2 * C.sum(axis=0)[None], -C, -C])
        count = len(blocks) * np.arange(len(at) + 1)
        parts = np.broadcast_to(blocks, (len(at), *blocks.shape)).reshape(-1, d, d)
        shape = (d * len(at), d * len(self.points.x))
        return sp.csr_array(sp.bsr_array((parts, ends.ravel(), count), shape=shape))

    def checked(self, u: ArrayLike) -> tuple[np.ndarray, tuple[int, ...]]:
        """Fields [S, N, d] and the shape of what stands before a field."""
        shape = self.points.x.shape
        values = checked("u", u, float, (..., *shape))
        return values.reshape(-1, *shape), values.shape[:-2]
