"""The LPS operator on a point set: Warp forward and backward, torch or NumPy outside."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, overload

import numpy as np
import torch
import warp as wp

from warp_peri.core.once import differentiable_once, refuse_tangents
from warp_peri.errors import InputError
from warp_peri.launch import DEVICE
from warp_peri.models.lps import Model
from warp_peri.models.solid import Solid
from warp_peri.operator.adjoint import gradient
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import check_volumes, evaluate
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.operator.tables import Tabulated
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike


class _Force(torch.autograd.Function):
    """L u as a torch function; its gradient gathers over bonds, or is Warp's tape run backwards."""

    @staticmethod
    def forward(ctx: Any, bonds: Bonds, *inputs: torch.Tensor) -> torch.Tensor:
        ctx.bonds = bonds
        # The gathering adjoint knows no broken bonds, and its few blocks are no work for a GPU,
        # where the tape's atomic sums are right.
        ctx.gathers = len(bonds.cut) == 0 and bonds.device == DEVICE
        ctx.save_for_backward(*inputs)  # the arrays share their memory
        taped = any(ctx.needs_input_grad) and not ctx.gathers
        ctx.arrays = _arrays(bonds, inputs, gradient=taped)
        if taped:
            with wp.Tape() as ctx.tape:
                ctx.evaluation = evaluate(bonds, *ctx.arrays, gradient=True)
        else:
            ctx.evaluation = evaluate(bonds, *ctx.arrays)
        Lu: torch.Tensor = wp.to_torch(ctx.evaluation.Lu, requires_grad=False)
        return Lu

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        inputs = ctx.saved_tensors  # an error where one was changed in place since
        seed = wp.from_torch(upstream[0].detach().contiguous(), dtype=ctx.bonds.vec)
        if not ctx.gathers:
            ctx.tape.zero()  # a second backward pass through the same graph starts afresh
            ctx.tape.backward(grads={ctx.evaluation.Lu: seed})
            return None, *(wp.to_torch(array.grad).clone() for array in ctx.arrays)
        wanted = ctx.needs_input_grad[1:]
        by = gradient(
            ctx.bonds,
            ctx.evaluation,
            ctx.arrays,
            seed,  # type: ignore[arg-type]  # Warp declares a wider return type
            displacement=wanted[0],
            parameters=any(wanted[1:]),
        )
        by_u = None if by.u is None else wp.to_torch(by.u, requires_grad=False)
        parts = (by.lam, by.mu, by.alpha, by.D, by.D_dilatation)
        return (
            None,
            by_u,
            *(
                torch.as_tensor(part, dtype=tensor.dtype).reshape(-1) if asked else None
                for part, tensor, asked in zip(parts, inputs[1:], wanted[1:])
            ),
        )


_force: Callable[..., torch.Tensor] = _Force.apply


def _arrays(bonds: Bonds, tensors: Sequence[torch.Tensor], *, gradient: bool = False) -> list[Any]:
    """u and the numbers as Warp arrays, which share the tensors' memory."""
    types = [bonds.vec] + (len(tensors) - 1) * [bonds.scalar]
    return [
        wp.from_torch(tensor.detach().contiguous(), dtype=dtype, requires_grad=gradient)
        for tensor, dtype in zip(tensors, types)
    ]


class NodeOperator:
    """Minus the internal force density of a model on a point set; equals b in equilibrium.

    Args:
        model: the model.
        points: a lattice or scattered points, whose interior has the 2δ collar; bonds to nodes
            outside the body are broken.
        quadrature_degree: of the polynomials that the weights are exact for.
        allow_uncertified: warn instead of raising when the model holds no certificate for this
            spacing.
        device: where the kernels run, as for Bonds.

    A model with λ = μ is bond-based: it needs no dilatation, and a collar of δ is enough.

    Raises InputError for a point set that does not carry the horizon, or an uncertified spacing.

    ``op(u)`` takes u [Å] of shape [N, d] or [S, N, d] on all nodes and returns L u [TPa/Å] on the
    interior nodes, shape [I, d] or [S, I, d]: NumPy in, NumPy out; torch in, differentiable torch
    out.
    """

    at_once = True
    """Whether bonds are built at the start; solves by stencils need none."""

    def __init__(
        self,
        model: Model,
        points: PointsLike,
        *,
        quadrature_degree: int = DEGREE,
        allow_uncertified: bool = False,
        device: str = DEVICE,
    ) -> None:
        model.check_spacing(points.spacing, allow_uncertified=allow_uncertified)
        self.model, self.nodes = model, on_nominal_lattice(model, points)
        self.quadrature_degree, self.device = quadrature_degree, device
        if self.at_once:
            _ = self.bonds

    @cached_property
    def bonds(self) -> Bonds:
        """The bonds of the nodes, on the device."""
        bonds = Bonds(
            self.nodes,
            self.model.horizon,
            bond_based=self.model.bond_based,
            quadrature_degree=self.quadrature_degree,
            device=self.device,
        )
        check_volumes(bonds, self.model)
        return bonds

    @cached_property
    def _tabulated(self) -> Tabulated | None:
        apart = not self.bonds.lattice and self.device == DEVICE
        return Tabulated(self.bonds) if apart else None

    @overload
    def __call__(self, u: np.ndarray) -> np.ndarray: ...
    @overload
    def __call__(self, u: torch.Tensor) -> torch.Tensor: ...
    def __call__(self, u: np.ndarray | torch.Tensor) -> np.ndarray | torch.Tensor:
        if isinstance(u, torch.Tensor):
            tensor = u
        else:
            tensor = torch.from_numpy(np.require(u, float, ["C", "W"])).to(self.bonds.device)
        solid = self.model.solid
        differentiated = torch.is_grad_enabled() and tensor.requires_grad
        if self._tabulated is None or differentiated:
            Lu = lps_force(self.bonds, tensor, solid)
        else:
            check_field(self.bonds, tensor)
            refuse_tangents(tensor)
            fields = tensor.detach().reshape(-1, *tensor.shape[-2:]).contiguous()
            vectors: Any = wp.from_torch(fields, dtype=self.bonds.vec)
            made = self._tabulated(vectors, solid)
            Lu = wp.to_torch(made, requires_grad=False)
            Lu = Lu.reshape(*tensor.shape[:-2], -1, tensor.shape[-1])
        return Lu if isinstance(u, torch.Tensor) else Lu.cpu().numpy()


def lps_force(bonds: Bonds, u: torch.Tensor, solid: Solid) -> torch.Tensor:
    """L u [TPa/Å] on the interior nodes, shape [..., I, d], differentiable in u and in every value
    of the solid.

    Args:
        bonds: of a point set with N nodes.
        u: displacement [Å], shape [N, d] or [S, N, d], in the precision of the bonds.
        solid: numbers, arrays or tensors; λ = μ for bonds that are bond-based.

    Raises InputError for a u of another shape or type, or λ ≠ μ on bond-based bonds, whose
    derivative to λ is zero: (42) is a function of μ.
    """
    check_field(bonds, u)
    refuse_tangents(u, *solid.values())
    numbers = [
        torch.as_tensor(value, dtype=u.dtype, device=u.device).reshape(-1)
        for value in solid.values()
    ]
    if bonds.bond_based and not torch.equal(*numbers[:2]):
        raise InputError(
            f"lambda, mu: expected equal values (bond-based), got {solid.lam}, {solid.mu}"
        )
    inputs = (u.reshape(-1, bonds.nodes, bonds.dimension), *numbers)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs):
        Lu = _force(bonds, *inputs)
    else:  # autograd's own bookkeeping takes longer than a sweep over a thousand nodes
        made = evaluate(bonds, *_arrays(bonds, inputs), dilatation=False).Lu
        Lu = wp.to_torch(made, requires_grad=False)
    return Lu.reshape(*u.shape[:-2], -1, bonds.dimension)


def check_field(bonds: Bonds, u: torch.Tensor) -> None:
    """Refuse a displacement whose device, type or shape is not that of the bonds."""
    nodes, d, dtype = bonds.nodes, bonds.dimension, getattr(torch, bonds.scalar.__name__)
    if u.device != torch.device(bonds.device):
        raise InputError(f"u: expected a tensor on {bonds.device}, got one on {u.device}")
    fits = u.dim() in (2, 3) and u.shape[-2:] == (nodes, d) and u.shape[0] > 0
    if u.dtype != dtype or not fits:
        raise InputError(
            f"u: expected {bonds.scalar.__name__} of shape [S, {nodes}, {d}], S ≥ 1, or "
            f"[{nodes}, {d}], got {u.dtype} of shape {list(u.shape)}"
        )


__all__ = ["Bonds", "DEVICE", "NodeOperator", "lps_force"]
