"""Equilibrium as a differentiable function of load, collar and model, by the implicit adjoint.

u_I = L_II⁻¹ (b_I − L_IC u_C). With g the derivative of a scalar to u and L_IIᵗ w = g_I,

    b̄ = w,   ū_C = g_C − L_ICᵗ w,   and to any parameter p of the model  −wᵗ (∂L/∂p) u:

one more solve, and one gradient of the operator.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import scipy.fft
import scipy.sparse as sp
import torch

from warp_peri.core.stencil import Stencil
from warp_peri.core.sweeps import torus_symbol
from warp_peri.core.tensors import differentiable_once
from warp_peri.errors import InputError
from warp_peri.lps.bonds import Bonds, influence
from warp_peri.lps.matrices import assemble
from warp_peri.lps.model import Model, Solid, lps_stencil
from warp_peri.lps.operator import lps_force
from warp_peri.points.families import families_of
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.stability.certificate import smallest_eigenvalue
from warp_peri.statics.conjugate_gradients import SolveRecord
from warp_peri.statics.direct import MatrixProblem, definite_factors
from warp_peri.statics.linear import METHODS, Linear, smallest_ratio
from warp_peri.statics.solution import TOLERANCE


class _System(Protocol):
    """A linear problem of some nodes."""

    def solve(self, b: np.ndarray, u: np.ndarray) -> np.ndarray:
        """u [S, N, d] with L u = b on the interior, as given elsewhere."""
        ...

    def adjoint(self, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """L_II⁻ᵗ of g [S, I, d], and Lᵗ of that on all nodes, [S, N, d]."""
        ...


class _Iterated:
    """By conjugate gradients of a stencil."""

    def __init__(
        self, linear: Linear, method: str, tolerance: float, records: list[SolveRecord]
    ) -> None:
        linear.check_definite()
        self.linear, self.method, self.tolerance = linear, method, tolerance
        self.records = records

    def solve(self, b: np.ndarray, u: np.ndarray) -> np.ndarray:
        solved, records = self.linear.solve(b, u, self.tolerance, self.method)
        self.records += records
        return solved

    def adjoint(self, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        w = np.stack([self.linear.inverse(one, self.tolerance, self.method)[0] for one in g])
        return w, np.stack([self.linear.push(one) for one in w])


class _Factorised:
    """By a factorisation, on any points."""

    def __init__(self, bonds: Bonds, points: PointsLike, solid: Solid) -> None:
        alpha, D, own = (bonds.floats(v) for v in (solid.alpha, solid.D, solid.dilatation))
        tables = [*influence(bonds, alpha, D), *influence(bonds, alpha, own)]
        L = assemble(bonds, tables).operator(float(solid.lam[0]), float(solid.mu[0]))
        self.problem, nodes = MatrixProblem(L, points.interior), nodes_of(points)

        def stencil() -> Stencil:
            return solid_stencil(nodes, solid, bonds.horizon)

        refuse_indefinite(nodes, self.problem.stiffness, stencil)

    def solve(self, b: np.ndarray, u: np.ndarray) -> np.ndarray:
        return self.problem.solve(b, u)

    def adjoint(self, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        problem, flat = self.problem, np.ascontiguousarray(g.reshape(len(g), -1).T)
        w = problem.factors.solve(flat, "T").T
        pushed = np.zeros((len(g), len(problem.unknown)))
        pushed[:, ~problem.unknown] = (problem.collar.T @ w.T).T
        return w.reshape(g.shape), pushed.reshape(len(g), -1, g.shape[-1])


class _AtRest(torch.autograd.Function):
    """Load [S, N, d], collar [S, N, d] and parameters to displacement [S, N, d]."""

    @staticmethod
    def forward(
        ctx: Any,
        system: _System,
        bonds: Callable[[], Bonds],
        interior: np.ndarray,
        b: torch.Tensor,
        u: torch.Tensor,
        *parameters: torch.Tensor,
    ) -> torch.Tensor:
        solved = torch.from_numpy(system.solve(b.detach().numpy(), u.detach().numpy()))
        ctx.system, ctx.bonds, ctx.interior = system, bonds, interior
        ctx.save_for_backward(solved, *parameters)
        return solved

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (g,), (solved, *parameters) = upstream, ctx.saved_tensors
        w, pushed = ctx.system.adjoint(g.numpy()[:, ctx.interior])
        by_b, by_u = torch.zeros_like(g), g - torch.from_numpy(pushed)
        by_b[:, ctx.interior], by_u[:, ctx.interior] = torch.from_numpy(w), 0.0
        found_by: Sequence[torch.Tensor | None] = [None] * len(parameters)
        if any(ctx.needs_input_grad[5:]):
            with torch.enable_grad():
                leaves = [value.detach().requires_grad_() for value in parameters]
                force = lps_force(ctx.bonds(), solved, Solid(*leaves))
                pull = torch.from_numpy(-np.ascontiguousarray(w))
                found_by = torch.autograd.grad(force, leaves, pull, allow_unused=True)
        return None, None, None, by_b, by_u, *found_by


_at_rest: Callable[..., torch.Tensor] = _AtRest.apply


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
    linear: Linear | None = None,
) -> torch.Tensor:
    """Displacement in equilibrium (theory.md, 29), differentiable in all tensors.

    Args:
        points: a lattice, or for the method lu any points.
        b: body force density [TPa/Å], shape [S, N, d] or [N, d]; only interior values count.
        u_collar: displacement [Å], same shape; only collar values count.
        solid: numbers, arrays or tensors. Where λ and μ are equal the problem is bond-based, and
            its derivatives to them are those of (42).
        horizon: δ [Å].
        method: "lu", or on lattices one of linear.METHODS.
        tolerance: of iterative solves, true residual over right-hand side.
        records: takes one SolveRecord for each sample of an iterative solve.
        linear: of these points and this solid, where it is there already.

    Returns:
        u [Å], shape as given: u_collar on the collar, the solution on the interior.

    Raises InputError for what families_of refuses, another method, and an operator that is singular
    or, on a lattice without broken bonds, indefinite.
    """
    solid = solid.map(lambda v: torch.as_tensor(v, dtype=torch.float64).reshape(-1).cpu())
    shape, device = b.shape, b.device
    b, u = (field.double().cpu().reshape(-1, *points.x.shape) for field in (b, u_collar))
    inside = torch.from_numpy(points.interior)[:, None]
    b, u = b.where(inside, 0.0), u.where(~inside, 0.0)

    def bonds() -> Bonds:
        return Bonds(points, horizon, bond_based=solid.bond_based)

    plain = solid.map(lambda v: v.detach().numpy())
    system: _System
    if method == "lu":
        placed = bonds()
        system, made = _Factorised(placed, points, plain), lambda: placed
    else:
        if method not in METHODS:
            raise InputError(f"method: expected lu, {', '.join(METHODS)}, got {method!r}")
        if points.spacing == 0:
            raise InputError(f"method: {method} is for lattices, got scattered points; try lu")
        linear = linear or lps_linear(points, plain, horizon)
        system = _Iterated(linear, method, tolerance, [] if records is None else records)
        made = bonds
    solved = _at_rest(system, made, points.interior, b, u, *solid.values())
    return solved.reshape(shape).to(device)


def lps_linear(points: PointsLike, solid: Solid, horizon: float, *, degree: int = DEGREE) -> Linear:
    """The stencil of a linear peridynamic solid on the nodes of a lattice.

    Raises InputError as families_of does, for the same point sets.
    """
    nodes = nodes_of(points)
    try:
        stencil = solid_stencil(nodes, solid, horizon, degree)
        return Linear(stencil, nodes, least=2 * int(horizon / nodes.spacing + 1e-6))
    except InputError:
        families_of(nodes, horizon, bond_based=solid.bond_based, degree=degree)
        raise


def solid_stencil(nodes: Points, solid: Solid, horizon: float, degree: int = DEGREE) -> Stencil:
    """The stencil of numbers, arrays or tensors that make a linear peridynamic solid."""
    numbers = solid.map(lambda value: np.asarray(value, dtype=float).ravel())
    lam, mu, alpha = (float(value[0]) for value in (numbers.lam, numbers.mu, numbers.alpha))
    own, d = numbers.dilatation, nodes.dimension
    model = Model(lam, mu, alpha, numbers.D, horizon, D_dilatation=own, dimension=d)
    return lps_stencil(model, nodes.spacing, degree=degree)


def refuse_indefinite(
    points: Points,
    stiffness: sp.csc_array,
    stencil: Callable[[], Stencil],
    *,
    allowed: bool = False,
) -> None:
    """Raise InputError when L_II is not positive definite, on lattices and where bonds are broken.

    On plain lattices by the symbol, and where that proves nothing by the smallest eigenvalue. Where
    bonds are broken, its symmetric part decides: a kernel that changes sign seldom bears that
    (theory.md, B9). Elsewhere nothing is asked.

    Args:
        points: the nodes.
        stiffness: L_II [stress/length²].
        stencil: gives that of the operator on a plain lattice.
        allowed: warn, where bonds are broken, instead.
    """
    if points.outside is not None:
        nodes = int(np.count_nonzero(points.interior))
        _judge_cut(sp.csc_array((stiffness + stiffness.T) / 2), nodes, allowed)
        return
    if not points.is_plain_lattice:
        return
    sides = np.ptp(lattice_steps(points)[0], axis=0) + 1
    torus = tuple(scipy.fft.next_fast_len(int(n), real=True) for n in sides)
    whole = stencil()
    if smallest_ratio(torus_symbol(torus, whole.steps, whole.tensors), torus) > 0:
        return
    smallest = smallest_eigenvalue(stiffness)
    if not smallest > 0:
        raise InputError(
            f"the operator on these {np.count_nonzero(points.interior)} nodes is indefinite: its "
            f"smallest eigenvalue is {smallest:.1e}, so that its equilibria are not stable"
        )


def _judge_cut(symmetric: sp.csc_array, nodes: int, allowed: bool) -> None:
    """Refuse, or warn of, a symmetric part that is not positive definite."""
    if definite_factors(symmetric) is not None:
        return
    smallest = smallest_eigenvalue(symmetric)
    if smallest > 0:
        return
    message = (
        f"outside: with these bonds broken the operator on {nodes} nodes is not "
        f"positive definite: the smallest eigenvalue of its symmetric part is "
        f"{smallest:.2g}, and its solutions may be wrong; Body(mesh, …) does without broken bonds"
    )
    if not allowed:
        raise InputError(message)
    warnings.warn(message, stacklevel=4)
