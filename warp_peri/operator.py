"""The LPS operator on a point set: Warp forward, Warp's tape backward, torch or NumPy outside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, overload

import numpy as np
import torch
import warp as wp
from torch.autograd.function import once_differentiable

from warp_peri.dataset import PointSet
from warp_peri.errors import InputError
from warp_peri.families import lattice_families
from warp_peri.influence import bernstein_basis
from warp_peri.kernels import lps
from warp_peri.model import Model

DEVICE = "cpu"
wp.config.log_level = wp.LOG_WARNING  # its banner would mix with what commands print


class Sweeps:
    """The Warp launches of (4)–(9) over the interior nodes of a lattice point set.

    Args:
        points: the point set.
        horizon: δ [Å].
        box: periods (Lx, Ly) [Å] when the lattice is periodic.

    Attributes:
        families: families of all nodes.
        rows: interior nodes, where forces are evaluated.
        full: nodes within δ of them, where dilatations are needed.
        links: the arrays that lead every kernel from a node to its bonds.
    """

    def __init__(
        self, points: PointSet, horizon: float, *, box: tuple[float, float] | None = None
    ) -> None:
        self.families = lattice_families(points, horizon, box=box)
        classes, row = self.families.classes, self.families.row
        rows = np.flatnonzero(points.interior)
        reached = points.interior.copy()
        for i in rows:
            reached[self.families.neighbour[row[i] : row[i + 1]]] = True
        self.rows, self.full = _int(rows), _int(np.flatnonzero(reached))
        self.pattern = (_int(self.families.bond), _int(classes.bond_class))
        self.row = _int(row)
        xi: wp.array = wp.array(self.families.xi, dtype=wp.vec2d, device=DEVICE)
        self.links = (self.row, _int(self.families.neighbour), *self.pattern, xi)
        self.r, self.weight = as_float(classes.r), as_float(classes.weight)

    def influence(self, alpha: wp.array, D: wp.array, *, gradient: bool) -> tuple[wp.array, ...]:
        """K W of each class, shape [C], and weighted volumes m, shape [N] (0 where not needed)."""
        classes = self.families.classes
        bernstein = as_float(bernstein_basis(classes.r, classes.horizon, len(D) - 1))
        kw = self.zeros(len(self.r), gradient=gradient)
        m = self.zeros(len(self.row) - 1, gradient=gradient)
        _launch(lps.influence, len(self.r), (self.r, self.weight, bernstein, alpha, D), kw)
        nodes = (self.full, self.row, *self.pattern, self.r, kw)
        _launch(lps.weighted_volume, len(self.full), nodes, m)
        return kw, m

    def force(
        self,
        u: wp.array,
        lam: wp.array,
        mu: wp.array,
        alpha: wp.array,
        D: wp.array,
        D_dilatation: wp.array | None = None,
        *,
        gradient: bool = False,
    ) -> wp.array:
        """L u [TPa/Å] on the interior nodes, shape [S, I]; on the active tape, if there is one."""
        samples = u.shape[0]
        kw, m = self.influence(alpha, D, gradient=gradient)
        kd, md = kw, m
        if D_dilatation is not None:
            kd, md = self.influence(alpha, D_dilatation, gradient=gradient)
        theta = self.zeros(samples, len(self.row) - 1, gradient=gradient)
        Lu = self.zeros(samples, len(self.rows), dtype=wp.vec2d, gradient=gradient)
        tables = (kw, m, kd, md)
        _launch(
            lps.dilatation, (samples, len(self.full)), (self.full, *self.links, kd, md, u), theta
        )
        _launch(
            lps.force,
            (samples, len(self.rows)),
            (self.rows, *self.links, *tables, lam, mu, u, theta),
            Lu,
        )
        return Lu

    @staticmethod
    def zeros(*shape: int, dtype: Any = wp.float64, gradient: bool = False) -> wp.array:
        """A Warp array of zeros."""
        return wp.zeros(shape, dtype=dtype, requires_grad=gradient, device=DEVICE)


def _launch(kernel: Any, dim: Any, inputs: tuple[Any, ...], output: wp.array) -> None:
    wp.launch(kernel, dim=dim, inputs=inputs, outputs=[output], device=DEVICE)


class _Force(torch.autograd.Function):
    """L u as a torch function; the gradient is Warp's tape run backwards."""

    @staticmethod
    def forward(ctx: Any, sweeps: Sweeps, *inputs: torch.Tensor) -> torch.Tensor:
        wanted = any(ctx.needs_input_grad)
        arrays: list[Any] = [
            wp.from_torch(
                tensor.detach().contiguous(),
                dtype=wp.vec2d if number == 0 else wp.float64,
                requires_grad=wanted,
            )
            for number, tensor in enumerate(inputs)
        ]
        ctx.tape, ctx.arrays = wp.Tape(), arrays
        ctx.save_for_backward(*inputs)  # the arrays share their memory
        if wanted:
            with ctx.tape:
                ctx.output = sweeps.force(*arrays, gradient=True)
        else:
            ctx.output = sweeps.force(*arrays)
        return wp.to_torch(ctx.output, requires_grad=False)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors  # an error where one was changed in place since
        seed = wp.from_torch(upstream[0].detach().contiguous(), dtype=wp.vec2d)
        ctx.tape.zero()  # a second backward pass through the same graph starts afresh
        ctx.tape.backward(grads={ctx.output: seed})
        return None, *(wp.to_torch(array.grad).clone() for array in ctx.arrays)


class LPSOperator:
    """Minus the internal force density of a model on a point set; equals b in equilibrium.

    Args:
        model: the model.
        points: a lattice point set whose interior has the 2δ collar.
        box: periods (Lx, Ly) [Å] when the lattice is periodic.
        allow_uncertified: warn instead of raising when the model holds no certificate for this
            spacing.

    Raises InputError for a point set that does not carry the horizon, or an uncertified spacing.

    ``op(u)`` takes u [Å] of shape [N, 2] or [S, N, 2] on all nodes and returns L u [TPa/Å] on the
    interior nodes, shape [I, 2] or [S, I, 2]: NumPy in, NumPy out; torch in, differentiable torch
    out.
    """

    def __init__(
        self,
        model: Model,
        points: PointSet,
        *,
        box: tuple[float, float] | None = None,
        allow_uncertified: bool = False,
    ) -> None:
        model.check_spacing(points.spacing, allow_uncertified=allow_uncertified)
        self.model = model
        self.sweeps = Sweeps(points, model.horizon, box=box)

    @overload
    def __call__(self, u: np.ndarray) -> np.ndarray: ...
    @overload
    def __call__(self, u: torch.Tensor) -> torch.Tensor: ...
    def __call__(self, u: np.ndarray | torch.Tensor) -> np.ndarray | torch.Tensor:
        model = self.model
        tensor = (
            u if isinstance(u, torch.Tensor) else torch.from_numpy(np.require(u, float, ["C", "W"]))
        )
        numbers = (model.lam, model.mu, model.alpha, model.D, model.dilatation)
        Lu = lps_force(self.sweeps, tensor, *numbers)
        return Lu if isinstance(u, torch.Tensor) else Lu.numpy()


def lps_force(
    sweeps: Sweeps,
    u: torch.Tensor,
    lam: float | torch.Tensor,
    mu: float | torch.Tensor,
    alpha: float | torch.Tensor,
    D: Sequence[float] | np.ndarray | torch.Tensor,
    D_dilatation: Sequence[float] | np.ndarray | torch.Tensor | None = None,
) -> torch.Tensor:
    """L u [TPa/Å] on the interior nodes, shape [..., I, 2], differentiable in every argument.

    Args:
        sweeps: the sweeps of a point set with N nodes.
        u: displacement [Å], shape [N, 2] or [S, N, 2], float64.
        lam, mu: Lamé parameters [TPa].
        alpha: exponent α < 3.
        D: Bernstein coefficients, shape [M + 1].
        D_dilatation: those of the dilatation's own influence function, of any degree; None when it
            shares that of D.

    Raises InputError for a u of another shape or type.
    """
    nodes = len(sweeps.row) - 1
    if u.dtype != torch.float64 or u.dim() not in (2, 3) or u.shape[-2:] != (nodes, 2):
        raise InputError(
            f"u: expected float64 of shape [S, {nodes}, 2] or [{nodes}, 2], "
            f"got {u.dtype} of shape {list(u.shape)}"
        )
    numbers = [
        torch.as_tensor(value, dtype=torch.float64).reshape(-1)
        for value in (lam, mu, alpha, D, D_dilatation)
        if value is not None
    ]
    Lu = _Force.apply(sweeps, u.reshape(-1, nodes, 2), *numbers)
    return Lu.reshape(*u.shape[:-2], -1, 2)


def _int(values: np.ndarray) -> wp.array:
    return wp.array(values.astype(np.int32), dtype=wp.int32, device=DEVICE)


def as_float(values: np.ndarray) -> wp.array:
    """A float64 Warp array."""
    return wp.array(values, dtype=wp.float64, device=DEVICE)
