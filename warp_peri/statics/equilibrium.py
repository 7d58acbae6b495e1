"""Equilibrium as a differentiable function of load, collar and model, by the implicit adjoint.

u_I = L_II⁻¹ (b_I − L_IC u_C). With g the derivative of a scalar to u and L_IIᵗ w = g_I,

    b̄ = w,   ū_C = g_C − L_ICᵗ w,   and to any parameter p of the model  −wᵗ (∂L/∂p) u:

one more solve, and one gradient of the operator. On lattices that gradient is the correlation of w
and u, which autograd takes from the stencil to λ, μ, α and D.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from warp_peri.errors import InputError
from warp_peri.models.solid import Solid
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import influence
from warp_peri.operator.lps import lps_force
from warp_peri.operator.matrices import assemble
from warp_peri.operator.stencil import stencil
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.statics.conjugate_gradients import SolveRecord
from warp_peri.statics.definiteness import refuse_indefinite
from warp_peri.statics.direct import MatrixProblem
from warp_peri.statics.dirichlet import Dirichlet
from warp_peri.statics.domain import Domain, domain
from warp_peri.statics.settings import PRECONDITIONERS, TOLERANCE

Inverse: TypeAlias = Callable[[np.ndarray, float], np.ndarray]
"""An inverse of the linear part: of a load on the interior [I, d], to a relative residual."""


class _OnLattice(torch.autograd.Function):
    """Stencil, load [S, N, 2] and collar [S, N, 2] to displacement [S, N, 2]."""

    @staticmethod
    def forward(
        ctx: Any,
        system: Dirichlet,
        tolerance: float,
        records: list[SolveRecord],
        *tensors: torch.Tensor,
    ) -> torch.Tensor:
        A, b, u = tensors
        solved, domain = u.clone(), system.domain
        for s in range(len(b)):
            right = domain.gather_free(b[s][domain.interior])
            right -= system.pull(domain.gather_near(u[s]) * domain.collar)
            inner, record = system.solve(right, tolerance)
            records.append(record)
            solved[s, domain.interior] = domain.scatter_free(inner)
        ctx.system, ctx.tolerance = system, tolerance
        ctx.save_for_backward(solved)
        ctx.reach = A.shape[-1] // 2
        return solved

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (g,), (solved,), system = upstream, ctx.saved_tensors, ctx.system
        domain, wanted = system.domain, ctx.needs_input_grad[3:]
        by_b, by_u, by_A = torch.zeros_like(g), g.clone(), None
        for s in range(len(g)):
            w, _ = system.solve(domain.gather_free(g[s][domain.interior]), ctx.tolerance)
            by_b[s, domain.interior] = domain.scatter_free(w)
            wide = domain.widen(w)
            if wanted[2]:
                pulled = domain.torus.product(system.symbol, wide)
                by_u[s] -= domain.scatter_near(pulled, len(g[s]))
            if wanted[0]:
                part = domain.torus.correlation(wide, domain.gather_near(solved[s]), ctx.reach)
                by_A = -part if by_A is None else by_A - part
        by_u[:, domain.interior] = 0
        return None, None, None, by_A, by_b, by_u


class _ByLU(torch.autograd.Function):
    """The same on any points: the parameters go through the gradient of L u."""

    @staticmethod
    def forward(
        ctx: Any,
        bonds: Bonds,
        points: PointsLike,
        b: torch.Tensor,
        u: torch.Tensor,
        *parameters: torch.Tensor,
    ) -> torch.Tensor:
        solid = Solid(*(value.detach().numpy() for value in parameters))
        alpha, D, own = (bonds.floats(v) for v in (solid.alpha, solid.D, solid.dilatation))
        tables = [*influence(bonds, alpha, D), *influence(bonds, alpha, own)]
        L = assemble(bonds, tables).operator(float(solid.lam[0]), float(solid.mu[0]))
        problem = MatrixProblem(L, points.interior)
        solved = problem.solve(b.detach().numpy(), u.detach().numpy())
        refuse_indefinite(nodes_of(points), bonds.horizon, solid, problem.stiffness)
        ctx.bonds, ctx.problem = bonds, problem
        result = torch.from_numpy(solved)
        ctx.save_for_backward(result, *parameters)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        solved, *parameters = ctx.saved_tensors
        flat = upstream[0].numpy().reshape(len(solved), -1)
        problem, unknown = ctx.problem, ctx.problem.unknown
        w = problem.factors.solve(np.ascontiguousarray(flat[:, unknown].T), "T").T
        by_b, by_u = np.zeros_like(flat), np.zeros_like(flat)
        by_b[:, unknown] = w
        by_u[:, ~unknown] = flat[:, ~unknown] - (problem.collar.T @ w.T).T
        shape = solved.shape
        found_by: Sequence[torch.Tensor | None] = [None] * len(parameters)
        if any(ctx.needs_input_grad[4:]):
            with torch.enable_grad():
                leaves = [value.detach().requires_grad_() for value in parameters]
                force = lps_force(ctx.bonds, solved, Solid(*leaves))
                pull = torch.from_numpy(-w.reshape(shape[0], -1, shape[-1]).copy())
                found_by = torch.autograd.grad(force, leaves, pull, allow_unused=True)
        fields = (torch.from_numpy(field.reshape(shape)) for field in (by_b, by_u))
        return None, None, *fields, *found_by


_on_lattice: Callable[..., torch.Tensor] = _OnLattice.apply
_by_lu: Callable[..., torch.Tensor] = _ByLU.apply


def equilibrium(
    points: PointsLike,
    b: torch.Tensor,
    u_collar: torch.Tensor,
    solid: Solid,
    *,
    horizon: float,
    method: str,
    tolerance: float = TOLERANCE,
    records: list[SolveRecord] | None = None,
) -> torch.Tensor:
    """Displacement in equilibrium (theory.md, 29), differentiable in all tensors.

    Args:
        points: a lattice, or for the method lu any points.
        b: body force density [TPa/Å], shape [S, N, d] or [N, d]; only interior values count. The
            iterative methods run on its device, "lu" on the processor.
        u_collar: displacement [Å], same shape; only collar values count.
        solid: numbers, arrays or tensors. Where λ and μ are equal the problem is bond-based, and
            its derivatives to them are those of (42).
        horizon: δ [Å].
        method: "lu", or on lattices "sine" (rectangles), "multigrid", "strip"
            (λ ≫ μ), "fft", "cg".
        tolerance: of iterative solves, true residual over right-hand side.
        records: takes one SolveRecord for each sample of an iterative solve.

    Returns:
        u [Å], shape as given: u_collar on the collar, the solution on the interior.

    Raises InputError for what families_of refuses, another method, and an operator that is singular
    or, on a lattice without broken bonds, indefinite.
    """
    solid = solid.map(lambda v: torch.as_tensor(v, dtype=torch.float64).reshape(-1).cpu())
    shape = b.shape
    b, u = (field.double().reshape(-1, *points.x.shape) for field in (b, u_collar))
    inside = torch.from_numpy(points.interior)[:, None].to(b.device)
    b, u = b.where(inside, 0.0), u.where(~inside, 0.0)
    if method == "lu":
        bonds = Bonds(points, horizon, bond_based=solid.bond_based)
        solved = _by_lu(bonds, points, b.cpu(), u.cpu(), *solid.values())
        return solved.reshape(shape).to(b.device)
    if method not in PRECONDITIONERS:
        raise InputError(f"method: expected lu, {', '.join(PRECONDITIONERS)}, got {method!r}")
    if points.spacing == 0:
        raise InputError(f"method: {method} is for lattices, got scattered points; try lu")
    nodes = domain(points, horizon, bond_based=solid.bond_based, device=b.device)
    return on_domain(nodes, b, u, solid, method, tolerance, records).reshape(shape)


def on_domain(
    nodes: Domain,
    b: torch.Tensor,
    u: torch.Tensor,
    solid: Solid,
    method: str,
    tolerance: float,
    records: list[SolveRecord] | None = None,
) -> torch.Tensor:
    """Equilibrium on a lattice laid out before; b is zero on the collar, u on the interior."""
    A = stencil(nodes.classes, solid)
    system = Dirichlet(nodes, A.detach(), method)
    A = A.to(b.device)
    return _on_lattice(system, tolerance, [] if records is None else records, A, b, u)


def iterated_inverse(points: PointsLike, horizon: float, solid: Solid, method: str) -> Inverse:
    """L⁻¹ on the unknown nodes of a plain lattice by conjugate gradients, set up once.

    Raises InputError as Dirichlet does.
    """
    where = domain(points, horizon, device=torch.device("cpu"))
    with torch.no_grad():
        A = stencil(where.classes, solid)
    system = Dirichlet(where, A, method)

    def solved(right: np.ndarray, tolerance: float) -> np.ndarray:
        field, _ = system.solve(where.gather_free(torch.from_numpy(right)), tolerance)
        free: np.ndarray = where.scatter_free(field).numpy()
        return free

    return solved
