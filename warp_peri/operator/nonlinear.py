"""The nonlinear solid on a lattice: Warp forward and backward, torch or NumPy outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, overload

import numpy as np
import scipy.sparse as sp
import torch
import warp as wp
from numpy.typing import ArrayLike

from warp_peri.core.once import differentiable_once
from warp_peri.errors import InputError
from warp_peri.launch import floats
from warp_peri.models.influence import bernstein_basis
from warp_peri.models.nonlinear import NonlinearModel
from warp_peri.operator.gradient_sweeps import GradientSweeps
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.operator.tangent import TangentMatrices
from warp_peri.points.axis import axis_of
from warp_peri.points.families import BondClasses
from warp_peri.points.samples import PointsLike


class _ThirdOrderForce(torch.autograd.Function):
    """u, tables by class [4, C], λ − μ and the six numbers to L u."""

    @staticmethod
    def forward(
        ctx: Any,
        sweeps: GradientSweeps,
        radius: float,
        u: torch.Tensor,
        tables: torch.Tensor,
        bulk: torch.Tensor,
        numbers: torch.Tensor,
    ) -> torch.Tensor:
        ctx.sweeps = sweeps
        ctx.save_for_backward(u, tables, bulk, numbers)
        field: wp.array[Any] = wp.from_torch(  # type: ignore[assignment]
            u.detach().contiguous(), dtype=sweeps.kernels.vec
        )
        table, material = tables.detach().numpy(), numbers.detach().numpy()
        bonds = sweeps.bonds(table)
        ctx.given = (field, table, float(bulk), material, radius)
        Lu = sweeps.force(field, bonds, float(bulk), material, radius)
        force: torch.Tensor = wp.to_torch(Lu, requires_grad=False)
        return force

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors  # an error where one was changed in place since
        g = wp.from_torch(upstream[0].detach().contiguous(), dtype=ctx.sweeps.kernels.vec)
        wanted = ctx.needs_input_grad[3:]
        by_u, others = ctx.sweeps.adjoint(ctx.given, g, parameters=any(wanted))
        parts: tuple[torch.Tensor | None, ...] = (None, None, None)
        if others is not None:
            by_class, by_bulk, by_numbers = others
            parts = (
                torch.from_numpy(by_class),
                torch.tensor([by_bulk], dtype=torch.float64),
                torch.from_numpy(by_numbers.astype(float)),
            )
        return None, None, wp.to_torch(by_u, requires_grad=False), *parts


_force: Callable[..., torch.Tensor] = _ThirdOrderForce.apply


def class_tables(
    classes: BondClasses,
    mu: torch.Tensor,
    alpha: torch.Tensor,
    D: torch.Tensor,
    D_dilatation: torch.Tensor,
    weights: tuple[torch.Tensor, torch.Tensor] | None,
) -> torch.Tensor:
    """16 μ w/r², 2 p, 2 p_in and 2 p_out by class, shape [4, C]; differentiable.

    Without weights p_in = p_out = p, those of the dilatation (the energy form).
    """
    r, count = torch.from_numpy(classes.r), torch.from_numpy(classes.count).to(torch.float64)
    normalised = []
    for coefficients in (D, D_dilatation):
        basis = torch.from_numpy(bernstein_basis(classes.r, classes.horizon, len(coefficients) - 1))
        kw = torch.from_numpy(classes.weight) * r**-alpha * (basis @ coefficients)
        normalised.append(kw / (count @ (kw * r**2)))
    w, p = normalised
    p_in, p_out = (p, p) if weights is None else weights
    return torch.stack([16 * mu * w / r**2, 2 * p, 2 * p_in, 2 * p_out])


def nonlinear_force(
    sweeps: GradientSweeps,
    u: torch.Tensor,
    tables: torch.Tensor,
    bulk: torch.Tensor,
    numbers: torch.Tensor,
    *,
    radius: float = 0.0,
) -> torch.Tensor:
    """L u [TPa/Å] on the interior nodes, shape [..., I, 2], differentiable in every tensor.

    Args:
        sweeps: of a lattice with N nodes.
        u: displacement [Å], shape [N, 2] or [S, N, 2], float64.
        tables: by class, as class_tables returns them.
        bulk: λ − μ of the dilatational part [TPa], shape [1].
        numbers: λ, μ, t3, tq2, Re and Im of q3 e^(−6ia) of the energy Ψ [TPa], shape [6].
        radius: largest |H| that P sees, projected to it from beyond; 0 for none.

    Raises InputError for a u of another shape or type.
    """
    nodes = sweeps.nodes
    fits = u.dim() in (2, 3) and u.shape[-2:] == (nodes, 2) and u.shape[0] > 0
    if u.dtype != torch.float64 or not fits:
        raise InputError(
            f"u: expected float64 of shape [S, {nodes}, 2], S ≥ 1, or [{nodes}, 2], "
            f"got {u.dtype} of shape {list(u.shape)}"
        )
    Lu = _force(sweeps, radius, u.reshape(-1, nodes, 2), tables, bulk, numbers)
    return Lu.reshape(*u.shape[:-2], -1, 2)


class NonlinearOperator:
    """Minus the internal force density of a nonlinear model on a lattice; b in equilibrium.

    Args:
        model: the model.
        points: a lattice, whose interior has the 2δ collar; their axis is that of the crystal, x
            where none is stated, which is said once.
        radius: largest |H| that the stress sees, projected to it from beyond (theory.md, N10); 0
            for none.
        allow_uncertified: warn instead of raising when the linear part holds no certificate for
            this spacing.

    ``op(u)`` takes u [Å] of shape [N, 2] or [S, N, 2] on all nodes and returns L u [TPa/Å] on the
    interior nodes, shape [I, 2] or [S, I, 2]: NumPy in, NumPy out; torch in, differentiable torch
    out.

    Raises InputError for a point set that is no lattice or does not carry the horizon, or an
    uncertified spacing.
    """

    def __init__(
        self,
        model: NonlinearModel,
        points: PointsLike,
        *,
        radius: float = 0.0,
        allow_uncertified: bool = False,
    ) -> None:
        model.check_spacing(points.spacing, allow_uncertified=allow_uncertified)
        self.model, self.radius = model, float(radius)
        self.sweeps = GradientSweeps(on_nominal_lattice(model.linear, points), model.horizon)
        linear = model.linear
        mu, alpha, D, D_dilatation = (
            torch.tensor(value, dtype=torch.float64)
            for value in (linear.mu, linear.alpha, linear.D, linear.dilatation)
        )
        weights = None
        if model.smoothing is not None or model.gradient is not None:
            p_in, p_out = model.weights(self.sweeps.classes)
            weights = torch.from_numpy(p_in), torch.from_numpy(p_out)
        self.tables = class_tables(self.sweeps.classes, mu, alpha, D, D_dilatation, weights)
        self.bulk = torch.tensor([linear.lam - linear.mu], dtype=torch.float64)
        axis = axis_of(points) if model.q3 else 0.0
        self.numbers = torch.from_numpy(model.numbers_at(axis))
        self._matrices: TangentMatrices | None = None

    @overload
    def __call__(self, u: np.ndarray) -> np.ndarray: ...
    @overload
    def __call__(self, u: torch.Tensor) -> torch.Tensor: ...
    def __call__(self, u: np.ndarray | torch.Tensor) -> np.ndarray | torch.Tensor:
        given = u if isinstance(u, torch.Tensor) else torch.from_numpy(_array(u))
        numbers = (self.tables, self.bulk, self.numbers)
        Lu = nonlinear_force(self.sweeps, given, *numbers, radius=self.radius)
        return Lu if isinstance(u, torch.Tensor) else Lu.numpy()

    def gradients(self, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """H and P [TPa] at the nodes `sweeps.full`, each of shape [..., F, 2, 2]."""
        field = _array(u)
        flat = floats(field.reshape(-1, self.sweeps.nodes, 2), self.sweeps.kernels.vec)
        bonds = self.sweeps.bonds(self.tables.numpy())
        H, P = self.sweeps.gradients(flat, bonds, self.numbers.numpy(), self.radius)
        shape = (*field.shape[:-2], len(self.sweeps.full), 2, 2)
        return H.reshape(shape), P.reshape(shape)

    def mean_gradient(self, u: ArrayLike) -> float:
        """Root mean square of |H| of one field [N, 2] over the nodes within δ of the interior."""
        field = floats(_array(u)[None], self.sweeps.kernels.vec)
        bonds = self.sweeps.bonds(self.tables.numpy())
        return self.sweeps.mean_gradient(field, bonds, self.numbers.numpy(), self.radius)

    def largest_gradient(self, u: ArrayLike) -> np.ndarray:
        """Largest |H| of each field over the nodes within δ of the interior, shape [...]."""
        H, _ = self.gradients(u)
        largest: np.ndarray = np.linalg.norm(H, axis=(-2, -1)).max(axis=-1)
        return largest

    def tangent(self, u: ArrayLike) -> sp.csr_array:
        """∂(L u)/∂u at a field [N, 2], without clipping: sparse, shape [2 I, 2 N] (N5)."""
        sweeps, tables = self.sweeps, self.tables.numpy()
        if self._matrices is None:
            self._matrices = TangentMatrices(sweeps, tables, float(self.bulk))
        field = floats(_array(u)[None], sweeps.kernels.vec)
        second = sweeps.curvatures(field, sweeps.bonds(tables), self.numbers.numpy())
        return self._matrices.tangent(second)


def _array(u: ArrayLike) -> np.ndarray:
    return np.require(u, float, ["C", "W"])
