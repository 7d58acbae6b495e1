"""The LPS on a point set: Warp forward and backward, torch or NumPy outside.

No atomics, so the nodes may be shared out among threads; sums over nodes run over fixed blocks, so
that the result does not depend on how many threads there are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import ArrayLike

from warp_peri.contract import OnPoints
from warp_peri.core.tensors import differentiable_once, refuse_tangents
from warp_peri.errors import InputError
from warp_peri.kernels.lps import influence as influence_kernels
from warp_peri.kernels.lps.adjoint import adjoints
from warp_peri.launch import (
    DEVICE,
    at_once,
    empty,
    filled,
    floats,
    launch,
    launch_slices,
    unrecorded,
)
from warp_peri.lps.bonds import Bonds, Evaluation, Tabulated, check_volumes, evaluate, powers
from warp_peri.lps.model import Model, Solid, on_nominal_lattice
from warp_peri.lps.rows import BLOCKS, Rows
from warp_peri.points.arrays import plain
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike


@dataclass(frozen=True)
class Gradient:
    """Derivatives of a scalar; None where they were not asked for.

    Attributes:
        u: shape [S, N] of vectors.
        lam, mu, alpha: numbers.
        D: shape [M + 1].
    """

    u: wp.array[Any] | None = None
    lam: float = 0.0
    mu: float = 0.0
    alpha: float = 0.0
    D: np.ndarray | None = None


def gradient(
    bonds: Bonds,
    evaluation: Evaluation,
    arrays: Sequence[wp.array[Any]],
    g: wp.array[Any],
    *,
    displacement: bool = True,
    parameters: bool = True,
) -> Gradient:
    """Gradient of a scalar, given its derivative g to L u.

    Args:
        bonds: of a point set without broken bonds.
        evaluation: what evaluate(bonds, *arrays) returned.
        arrays: u, λ, μ, α and D.
        g: shape [S, I] of vectors.
        displacement: whether to return the derivative to u.
        parameters: whether to return those to λ, μ, α, D.
    """
    u, lam, mu, alpha, D = arrays
    kernels = adjoints(bonds.scalar, bonds.dimension)
    e = evaluation
    law = filled(kernels.Law, e.kw, e.m, lam, mu)
    u_bar = empty(*u.shape, dtype=bonds.vec, device=bonds.device) if displacement else None
    sums, fields = None, None
    if bonds.laid_out is not None:
        of = (u, evaluation.theta) if parameters else None
        sums = _by_rows(bonds, bonds.laid_out, law, g, u_bar, of)
    else:
        h, tau = bonds.zeros(len(g), bonds.nodes, dtype=bonds.vec), bonds.zeros(*u.shape)
        inputs = (bonds.rows, bonds.arrays, e.m, g)
        launch_slices(kernels.scaled, len(bonds.rows), inputs, (h,), samples=len(g))
        _by_bonds(bonds, law, h, tau, u_bar)
        fields = filled(kernels.Fields, u, evaluation.theta, h, tau)
    if not parameters:
        return Gradient(u_bar)
    c1, c2 = bonds.dimension, 2 * bonds.dimension * (bonds.dimension + 2)
    tables = _Tables(bonds, law, alpha, D)
    shear, bulk = tables.run(fields) if sums is None else tables.take(sums)
    by_D, by_alpha = tables.gradients()
    return Gradient(u_bar, -c1 * bulk, c1 * bulk - c2 * shear, by_alpha, by_D)


def _by_bonds(
    bonds: Bonds, law: Any, h: wp.array[Any], tau: wp.array[Any], u_bar: wp.array[Any] | None
) -> None:
    """τ, and ∂/∂u where an array is given, through the lists of neighbours."""
    kernels, links = adjoints(bonds.scalar, bonds.dimension), (bonds.arrays, bonds.reverse)
    inputs: Any = (bonds.full, *links, law.kw, law.m, law.lam, law.mu, h)
    launch_slices(kernels.dilatation_adjoint, len(bonds.full), inputs, (tau,), samples=len(tau))
    if u_bar is not None:
        inputs = (*links, law.kw, law.mu, h, tau)
        launch_slices(kernels.displacement_adjoint, bonds.nodes, inputs, (u_bar,), samples=len(tau))


def _by_rows(
    bonds: Bonds,
    rows: Rows,
    law: Any,
    g: wp.array[Any],
    u_bar: wp.array[Any] | None,
    fields: tuple[wp.array[Any], wp.array[Any]] | None,
) -> np.ndarray | None:
    """∂/∂u, where an array is given, on a lattice laid out in rows; with u and θ the sums of
    Rows.by_pair."""
    kernels, pieces = rows.kernels, rows.pieces
    planes, dilatation = rows.planes("backward", len(g))
    given = bonds.arrays, law, g, planes, dilatation, g if u_bar is None else u_bar
    phases = pieces.row_images, pieces.needed, None if u_bar is None else pieces.nodes
    rows.shared(kernels.backward, phases, law.m, *given)()
    sums = None
    if fields is not None:
        sums = rows.by_pair(bonds.arrays, bonds.pairs, *fields, planes, dilatation)
    rows.give_back("backward", planes, dilatation)
    return sums


class _Tables:
    """The sums over bonds behind ∂/∂(K W), block by block, and from there to α and D."""

    def __init__(self, bonds: Bonds, law: Any, alpha: wp.array[Any], D: wp.array[Any]) -> None:
        self.bonds, self.law = bonds, law
        self.parts = bonds.zeros(BLOCKS, 2)
        self.blocks = bonds.blocks
        self.kernel = adjoints(bonds.scalar, bonds.dimension).table_adjoint
        self.to_D = influence_kernels.by_lanes(len(D) - 1, bonds.scalar).adjoint
        self.powers, self.sums = powers(bonds, alpha, D), bonds.zeros(BLOCKS, len(D) + 1)
        self.by_class: np.ndarray = np.zeros(0)

    def run(self, fields: Any) -> Any:
        """All blocks: ∂/∂(K W) of their bonds; on scattered points onwards to α and D. Returns what
        ∂/∂λ and ∂/∂μ are made of, (47)."""
        bonds, blocks = self.bonds, self.blocks
        reads = (bonds.full, bonds.arrays, bonds.r, self.law, fields)
        inputs = (blocks.spans, *reads)
        if bonds.lattice:
            bar = bonds.zeros(BLOCKS * len(bonds.families.pattern))
            weight = max(len(bonds.full) // BLOCKS, 1)
            launch_slices(self.kernel, BLOCKS, inputs, (bar, self.parts), weight=weight)
            by_bond = bar.numpy().reshape(BLOCKS, -1).sum(axis=0, dtype=float)
            self.by_class = np.bincount(bonds.families.classes.bond_class, by_bond)
        else:
            for kernel in (self.kernel, self.to_D):
                kernel.module.load(wp.get_device(bonds.device))  # not from two threads at once
            some = [n for n in range(BLOCKS) if blocks.ends[n] < blocks.ends[n + 1]]
            at_once([self._job(n, inputs) for n in some])
        return self.parts.numpy().sum(axis=0, dtype=float)

    def take(self, sums: np.ndarray) -> tuple[float, float]:
        """The same of a lattice's sums by pairs of bonds, [3, H], (45–47)."""
        of, law, c1 = self.bonds.families.classes, self.law, self.bonds.dimension
        kw, m, lam, mu = (x.numpy().astype(float) for x in (law.kw, law.m, law.lam, law.mu))
        bent, bulk, pressed = (np.bincount(of.bond_class[self.bonds.pairs], one) for one in sums)
        shear = bent / of.r**2
        by_w = -2 * c1 * (c1 + 2) * mu * shear
        by_d = pressed - c1 * (lam - mu) * bulk
        for each in by_w, by_d:  # the volume divides all of them
            each -= kw @ each / m * of.count * of.r**2
        self.by_class = by_w + by_d
        return float(kw @ shear), float(kw @ bulk)

    def _job(self, block: int, inputs: tuple[Any, ...]) -> Callable[[], None]:
        """One block of scattered points, whose bonds take memory while it runs."""
        first, last = self.blocks.bonds[block]

        def run() -> None:
            bar = self.bonds.zeros(last - first)
            launch(self.kernel, 1, (block, *inputs), (bar, self.parts))
            self._backward(block, first, last, bar)

        return run

    def _backward(self, block: int, first: int, last: int, bar: wp.array[Any]) -> None:
        launch(self.to_D, 1, (block, first, last, self.powers, bar), (self.sums,))

    def gradients(self) -> tuple[np.ndarray, float]:
        """∂/∂D and ∂/∂α, after all blocks."""
        if self.bonds.lattice:
            self._backward(0, 0, len(self.by_class), self.bonds.floats(self.by_class))
        total = self.sums.numpy().sum(axis=0, dtype=float)
        return total[:-1], float(total[-1])


class _Force(torch.autograd.Function):
    """L u as a torch function; its gradient gathers over bonds, or is Warp's tape run backwards."""

    @staticmethod
    def forward(ctx: Any, bonds: Bonds, taped: bool, *inputs: torch.Tensor) -> torch.Tensor:
        ctx.bonds = bonds
        ctx.gathers = gathers(bonds) and not taped
        ctx.save_for_backward(*inputs)  # the arrays share their memory
        taped = any(ctx.needs_input_grad) and not ctx.gathers
        ctx.arrays = _arrays(bonds, inputs, gradient=taped)
        if taped:
            with unrecorded(), wp.Tape() as ctx.tape:
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
            return None, None, *(wp.to_torch(array.grad).clone() for array in ctx.arrays)
        wanted = ctx.needs_input_grad[2:]
        by = gradient(
            ctx.bonds,
            ctx.evaluation,
            ctx.arrays,
            seed,  # type: ignore[arg-type]  # Warp declares a wider return type
            displacement=wanted[0],
            parameters=any(wanted[1:]),
        )
        by_u = None if by.u is None else wp.to_torch(by.u, requires_grad=False)
        parts = (by.lam, by.mu, by.alpha, by.D)
        return (
            None,
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


class NodeOperator(OnPoints):
    """Minus the internal force density of a model on a point set; equals b in equilibrium.

    Args:
        model: the model.
        points: a lattice or scattered points, whose interior has the 2δ collar; bonds to nodes
            outside the body are broken.
        quadrature_degree: of the polynomials that the weights are exact for.
        allow_uncertified: warn instead of raising when the model holds no certificate for this
            spacing.
        device: where the kernels run, as for Bonds.

    A model with λ = μ is bond-based: it needs no dilatation, and a collar of δ is enough, but for
    derivatives to λ and μ.

    Raises InputError for a point set that does not carry the horizon, or an uncertified spacing.
    """

    is_linear = True
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
        self.points: Any = self.nodes
        self.quadrature_degree, self.device = quadrature_degree, device
        if self.at_once:
            _ = self.bonds

    @cached_property
    def bonds(self) -> Bonds:
        """The bonds of the nodes, on the device."""
        how: dict[str, Any] = {"quadrature_degree": self.quadrature_degree, "device": self.device}
        try:
            bonds = Bonds(self.nodes, self.model.horizon, **how)
        except InputError:
            if not self.model.bond_based:
                raise
            bonds = Bonds(self.nodes, self.model.horizon, bond_based=True, **how)
        check_volumes(bonds, self.model)
        return bonds

    @cached_property
    def _tabulated(self) -> Tabulated | None:
        apart = not self.bonds.lattice and self.device == DEVICE
        return Tabulated(self.bonds) if apart else None

    def force_in_torch(self, u: Any) -> Any:
        """The force of a tensor, which stays where it is."""
        if self.device == DEVICE:
            return super().force_in_torch(u)
        return lps_force(self.bonds, u, self.model.solid)

    def force(self, u: ArrayLike) -> np.ndarray:
        """L u on the interior nodes, shape [..., I, d]; InputError for another shape."""
        field = torch.from_numpy(np.require(plain("u", u), float, ["C", "W"])).to(self.bonds.device)
        if self._tabulated is None:
            return lps_force(self.bonds, field, self.model.solid).cpu().numpy()
        check_field(self.bonds, field)
        vectors: Any = wp.from_torch(field.reshape(-1, *field.shape[-2:]), dtype=self.bonds.vec)
        Lu = self._tabulated(vectors, self.model.solid).numpy()
        return np.asarray(Lu.reshape(*field.shape[:-2], -1, field.shape[-1]))

    @cached_property
    def _evaluated(self) -> tuple[list[Any], Evaluation]:
        """The numbers as Warp arrays, and what the adjoint reads of bonds, which no u changes."""
        bonds = self.bonds
        numbers = [bonds.floats(np.atleast_1d(value)) for value in self.model.solid.values()]
        return numbers, evaluate(bonds, bonds.zeros(1, bonds.nodes, dtype=bonds.vec), *numbers)

    def product_transpose(self, u: Any, w: ArrayLike) -> np.ndarray:
        """Lᵗ w on all nodes, shape [..., N, d], of w on the interior [..., I, d], whatever u."""
        w, bonds = np.require(plain("w", w), float, ["C", "W"]), self.bonds
        seed = w.reshape(-1, *w.shape[-2:])
        if gathers(bonds):
            numbers, tables = self._evaluated
            field = empty(len(seed), bonds.nodes, dtype=bonds.vec)
            g = floats(seed, bonds.vec)
            by_u: Any = gradient(bonds, tables, [field, *numbers], g, parameters=False).u
        else:
            shape, at = (len(seed), bonds.nodes, bonds.dimension), bonds.device
            leaf = torch.zeros(shape, dtype=torch.float64, device=at, requires_grad=True)
            with torch.enable_grad():
                Lu = lps_force(bonds, leaf, self.model.solid)
            by_u = torch.autograd.grad(Lu, leaf, torch.from_numpy(seed).to(at))[0].cpu()
        return np.asarray(by_u.numpy().reshape(*w.shape[:-2], bonds.nodes, bonds.dimension))

    def felt(self, u: np.ndarray) -> tuple[np.ndarray, Any]:
        """The force of one field [N, d], and what `pulls` reads of it; where bonds `gather`."""
        field = floats(np.ascontiguousarray(u)[None], self.bonds.vec)
        found = evaluate(self.bonds, field, *self._evaluated[0])
        return np.asarray(found.Lu.numpy()[0]), (found, field)

    def pulls(self, felt: Any, w: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        """Lᵗ w on all nodes [N, d] and derivatives of w · force to numbers by name, w [I, d]."""
        (found, field), bonds = felt, self.bonds
        g = floats(np.ascontiguousarray(w)[None], bonds.vec)
        by = gradient(bonds, found, (field, *self._evaluated[0]), g)
        by_u: Any = by.u
        return by_u.numpy()[0], dict(vars(by))

    @property
    def gathers(self) -> bool:
        """Whether `felt` and `pulls` are had: whole bonds with dilatations, on the processor."""
        return not self.bonds.bond_based and gathers(self.bonds)

    def launch(self, u: Any, out: Any, parameters: Solid | None = None) -> None:
        """L u of Warp arrays, on the tape that records, if one does.

        ``tape.backward`` adds to the gradients of those arrays that require one.

        Args:
            u: displacement [Å], shape [S, N] of vectors of float64, contiguous.
            out: takes L u [TPa/Å], shape [S, I] of such vectors.
            parameters: λ, μ, α and D, of shape [1] and [M + 1]; the model's own by default.

        Raises InputError for other arrays and another device.
        """
        with unrecorded() as tape:
            back, arrays = self._launched(u, out, parameters, recorded=tape is not None)
        if tape is not None and len(arrays) > 1:
            tape.record_func(back, arrays)  # RuntimeError of Warp for an out without a gradient

    def _launched(
        self, u: Any, out: Any, parameters: Solid | None, *, recorded: bool
    ) -> tuple[Any, list[Any]]:
        """The pass backwards, and the arrays whose gradients it reads and adds to."""
        bonds, d = self.bonds, self.bonds.dimension
        if bonds.device != DEVICE:
            raise InputError(f"launch: expected an operator on {DEVICE}, got {bonds.device}")
        for name, array, nodes in (("u", u, bonds.nodes), ("out", out, len(bonds.rows))):
            fits = isinstance(array, wp.array) and array.is_contiguous and array.ndim == 2
            seen = array.numpy() if fits and len(u) else np.zeros(0)
            if seen.dtype != float or seen.shape != (len(u), nodes, d):
                raise InputError(
                    f"{name}: expected a contiguous array of Warp of shape [{len(u)}, {nodes}], "
                    f"of {d} float64 each, got {type(array).__name__} of {list(np.shape(array))}"
                )
        numbers = self._evaluated[0] if parameters is None else list(parameters.values())
        asked = any(one.requires_grad for one in numbers[:2])
        _check_bond_based(bonds, bool(numbers[0].numpy() == numbers[1].numpy()), asked)
        taped = recorded and not gathers(bonds)  # broken bonds: a tape of copies, inside
        of = [wp.clone(one, requires_grad=True) if taped else one for one in (u, *numbers)]
        with wp.Tape() if taped else nullcontext() as tape:
            found = evaluate(bonds, *of, gradient=taped)
        wp.copy(out, found.Lu)

        def back() -> None:
            parts: Any
            if tape is not None:
                tape.zero()
                tape.backward(grads={found.Lu: out.grad})
                parts = [one.grad.numpy() for one in of]
            else:
                learns = any(array.requires_grad for array in numbers)
                by = gradient(bonds, found, of, out.grad, parameters=learns)
                by_u: Any = by.u
                parts = (by_u.numpy(), by.lam, by.mu, by.alpha, by.D)
            for array, part in zip((u, *numbers), parts):
                if array.requires_grad:
                    array.grad.numpy()[:] += part

        return back, [out, *(array for array in (u, *numbers) if array.requires_grad)]

    @property
    def learnable(self) -> dict[str, Any]:
        """λ, μ, α and D by name."""
        return self.model.learnable

    def force_with(self, u: torch.Tensor, numbers: dict[str, torch.Tensor]) -> torch.Tensor:
        """The force of fields [S, N, d] with other numbers, differentiable once in all."""
        return lps_force(self.bonds, u, Solid(**numbers))


def gathers(bonds: Bonds) -> bool:
    """Whether the gathering adjoint takes these bonds, and no tape is needed.

    It knows no broken bonds, and its few blocks are no work for a GPU, where the tape's atomic sums
    are right.
    """
    return len(bonds.cut) == 0 and bonds.device == DEVICE


def lps_force(bonds: Bonds, u: torch.Tensor, solid: Solid, *, taped: bool = False) -> torch.Tensor:
    """L u [TPa/Å] on the interior nodes, shape [..., I, d], differentiable in u and in every value
    of the solid.

    Args:
        bonds: of a point set with N nodes.
        u: displacement [Å], shape [N, d] or [S, N, d], in the precision of the bonds.
        solid: numbers, arrays or tensors; λ = μ, of which neither asks for a gradient, for bonds
            that are bond-based.
        taped: the gradient by Warp's tape run backwards, the reference of the gathering one.

    Raises InputError for a u of another shape or type, or such λ and μ on bond-based bonds.
    """
    check_field(bonds, u)
    values = list(solid.values())
    refuse_tangents(u, *values)
    asked = [torch.is_grad_enabled() and getattr(one, "requires_grad", False) for one in values]
    learned = any(asked) or (torch.is_grad_enabled() and u.requires_grad)
    _check_bond_based(bonds, bool(solid.lam == solid.mu), any(asked[:2]))
    if bonds.laid_out is not None and not learned:  # torch takes longer than a small sweep
        Lu = u.new_empty(*u.shape[:-2], len(bonds.rows), bonds.dimension)
        bonds.force(u.detach().contiguous(), values, Lu)
        return Lu
    numbers = [
        torch.as_tensor(value, dtype=u.dtype, device=u.device).reshape(-1) for value in values
    ]
    inputs = (u.reshape(-1, bonds.nodes, bonds.dimension), *numbers)
    if learned:
        Lu = _force(bonds, taped, *inputs)
    else:
        made = evaluate(bonds, *_arrays(bonds, inputs), dilatation=False).Lu
        Lu = wp.to_torch(made, requires_grad=False)
    return Lu.reshape(*u.shape[:-2], -1, bonds.dimension)


def _check_bond_based(bonds: Bonds, equal: bool, asked: bool) -> None:
    """Refuse bonds without dilatations for λ ≠ μ, and for a gradient to one of them."""
    if bonds.bond_based and (asked or not equal):
        raise InputError(
            "lambda, mu: expected equal values without a gradient on a collar of one horizon, "
            "which has no dilatations; a collar of two has them"
        )


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
