"""Equilibrium of a nonlinear solid as a differentiable function, by the implicit adjoint (N20)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import splu
from torch.autograd.function import once_differentiable

from warp_peri.launch import floats
from warp_peri.models.nonlinear import NonlinearModel
from warp_peri.operator.gradient_sweeps import GradientSweeps
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.operator.nonlinear import nonlinear_force
from warp_peri.operator.tangent import TangentMatrices
from warp_peri.points.samples import PointsLike
from warp_peri.statics.nonlinear import PlacedThirdOrder
from warp_peri.statics.settings import TOLERANCE, Newton


class _Equilibrium(torch.autograd.Function):
    """Load, collar, and what nonlinear_force takes, to displacement [S, N, 2]."""

    @staticmethod
    def forward(
        ctx: Any,
        sweeps: GradientSweeps,
        solution: torch.Tensor,
        b: torch.Tensor,
        u_collar: torch.Tensor,
        *parameters: torch.Tensor,
    ) -> torch.Tensor:
        ctx.sweeps = sweeps
        ctx.save_for_backward(solution, *parameters)
        return solution.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        solution, *parameters = ctx.saved_tensors
        sweeps, (g,) = ctx.sweeps, upstream
        tables, bulk, numbers = (parameter.detach().numpy() for parameter in parameters)
        matrices = TangentMatrices(sweeps, tables, float(bulk[0]))
        bonds = sweeps.bonds(tables)
        rows = sweeps.rows
        unknown = np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()
        by_b, by_u = torch.zeros_like(g), g.clone()
        pull = np.empty((len(g), len(rows), 2))
        for s, answer in enumerate(solution.numpy()):
            field = floats(np.ascontiguousarray(answer[None]), sweeps.kernels.vec)
            tangent = matrices.tangent(sweeps.curvatures(field, bonds, numbers)).tocsc()
            factors = splu(sp.csc_array(tangent[:, unknown]))
            w = factors.solve(np.ascontiguousarray(g[s].numpy().reshape(-1)[unknown]), "T")
            pull[s] = w.reshape(-1, 2)
            by_b[s, rows] = torch.from_numpy(pull[s])
            by_u[s] -= torch.from_numpy((tangent.T @ w).reshape(-1, 2))
        by_u[:, rows] = 0
        gradients: tuple[torch.Tensor | None, ...] = (None, None, None)
        if any(ctx.needs_input_grad[4:]):
            with torch.enable_grad():
                leaves = [parameter.detach().requires_grad_() for parameter in parameters]
                force = nonlinear_force(sweeps, solution, leaves[0], leaves[1], leaves[2])
                gradients = torch.autograd.grad(force, leaves, torch.from_numpy(-pull))
        return None, None, by_b, by_u, *gradients


_equilibrium: Callable[..., torch.Tensor] = _Equilibrium.apply


def nonlinear_equilibrium(
    model: NonlinearModel,
    points: PointsLike,
    b: torch.Tensor,
    u_collar: torch.Tensor,
    *,
    tables: torch.Tensor,
    bulk: torch.Tensor,
    numbers: torch.Tensor,
    tolerance: float = TOLERANCE,
) -> torch.Tensor:
    """Displacement in equilibrium, differentiable in load, collar and parameters (theory.md, N20).

    Args:
        model: what is solved with; the tensors below must have its values.
        points: a lattice with few enough unknowns to factorise.
        b: body force density [TPa/Å], shape [S, N, 2]; only interior values count.
        u_collar: displacement [Å], same shape; only collar values count.
        tables, bulk, numbers: as for nonlinear_force.
        tolerance: as for PlacedThirdOrder.rest.

    Returns:
        u [Å], shape [S, N, 2].

    Raises InputError as PlacedThirdOrder.rest does.
    """
    nodes = on_nominal_lattice(model.linear, points)
    fields = (b.detach().numpy(), u_collar.detach().numpy())
    operator = PlacedThirdOrder(model, nodes, transfer=False)
    solved = operator.rest(*fields, Newton(tolerance)).u
    sweeps = GradientSweeps(nodes, model.horizon)
    return _equilibrium(sweeps, torch.from_numpy(solved), b, u_collar, tables, bulk, numbers)
