"""Operators in torch: one function for the force of every material; derivatives that are had once
are refused a second time on every path, where torch would leave out terms."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch.autograd import forward_ad

from warp_peri.contract import placed
from warp_peri.errors import InputError

Backward = Callable[..., tuple[torch.Tensor | None, ...]]
TWICE = (
    "second derivative: expected first derivatives alone of a force that is not linear, of its "
    "numbers, or of an equilibrium; operator.product(u, v) is the derivative of a force along v"
)


class _Made(torch.autograd.Function):
    """What `make` makes of tensors; `along` is its derivative, `backs` that to each transposed."""

    @staticmethod
    def forward(make: Any, along: Any, backs: Any, *of: torch.Tensor) -> torch.Tensor:
        return make(*of)  # type: ignore[no-any-return]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        _, ctx.along, ctx.backs, *of = inputs
        ctx.save_for_backward(*of)
        ctx.save_for_forward(*of)

    @staticmethod
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        given, wanted = (*ctx.saved_tensors, *upstream), zip(ctx.backs, ctx.needs_input_grad[3:])
        return None, None, None, *(back(*given) if asked else None for back, asked in wanted)

    @staticmethod
    def vmap(_: Any, in_dims: Any, make: Any, along: Any, backs: Any, *of: Any) -> Any:
        pairs = [*zip(of, in_dims[3:])]
        each = zip(*(x.unbind(d) if d is not None else itertools.repeat(x) for x, d in pairs))
        return torch.stack([_made(make, along, backs, *one) for one in each]), 0

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> torch.Tensor:
        return ctx.along(*ctx.saved_tensors, *tangents[3:])  # type: ignore[no-any-return]


_made: Callable[..., torch.Tensor] = _Made.apply


def _refused(*_: torch.Tensor) -> Any:
    raise InputError(TWICE)


def _called(apply: Callable[..., Any], *fields: torch.Tensor) -> torch.Tensor:
    """What a function of NumPy makes of tensors; float64, without a gradient."""
    given = (field.detach().contiguous().numpy() for field in fields)
    return torch.from_numpy(np.require(apply(*given), float, ["C", "W"]))


def _once(make: Callable[..., torch.Tensor], *of: torch.Tensor) -> torch.Tensor:
    """What is made of tensors and has no derivative by them, and says so."""
    return _made(make, _refused, len(of) * [_refused], *of)


def linear(x: torch.Tensor, there: Callable[..., Any], back: Callable[..., Any]) -> torch.Tensor:
    """A linear map of fields of NumPy, [S, …], which `back` transposes; it has every derivative."""
    return _made(
        functools.partial(_called, there),
        lambda _, tangent: linear(tangent, there, back),
        [lambda _, upstream: linear(upstream, back, there)],
        x,
    )


def nonlinear(make: Any, along: Any, backs: tuple[Any, ...], *of: torch.Tensor) -> torch.Tensor:
    """A map of fields of NumPy that is differentiated once.

    Args:
        make: of the fields.
        along: its derivative, of the fields and tangents; None where it is refused.
        backs: of each field the derivative transposed, of the fields and what is upstream.
        of: the fields.
    """
    tangent, *each = (
        functools.partial(_once, functools.partial(_called, one)) if one else _refused
        for one in (along, *backs)
    )
    return _made(functools.partial(_called, make), tangent, each, *of)


def force_of(operator: Any, u: torch.Tensor) -> torch.Tensor:
    """The force of an operator on the interior nodes, [..., I, d], differentiable in u [..., N, d].

    Raises InputError for another shape or type, and, where `operator.is_linear` is not true, for a
    second derivative.
    """

    def force(fields: torch.Tensor) -> torch.Tensor:
        if operator.is_linear:
            return linear(fields, operator.force, lambda w: operator.product_transpose(None, w))
        backs = (operator.product_transpose,)
        return nonlinear(operator.force, operator.product, backs, fields)

    return on_fields(operator, u, force)


def on_fields(
    operator: Any, u: torch.Tensor, force: Callable[[torch.Tensor], torch.Tensor]
) -> torch.Tensor:
    """What `force` makes of fields [S, N, d] in float64, of u [..., N, d] and in its precision.

    Raises InputError for a u of another shape or type.
    """
    operator.check(u, u.is_floating_point())
    found = force(u.to("cpu", torch.float64).reshape(-1, *operator.shape))
    return found.reshape(*u.shape[: u.dim() - len(operator.shape)], *found.shape[1:]).to(u)


def pair_of(operator: Any, b: Any, u: Any) -> tuple[torch.Tensor, torch.Tensor]:
    """Load and displacement on all nodes as tensors; InputError for what does not fit."""
    b, u = (torch.as_tensor(field) for field in (b, u))
    operator.check(u, not u.is_complex())
    if b.shape != u.shape or b.is_complex():
        raise InputError(f"b: expected shape {list(u.shape)}, got {b.dtype} of {list(b.shape)}")
    return b, u


def at_rest(operator: Any, b: Any, u: Any, solver: Any) -> Any:
    """The Solution of a symmetric operator, its u a tensor with every derivative to b and u.

    Args:
        operator: whose `rest` and `product_transpose` take NumPy fields.
        b, u: of all nodes, [N, d] or [S, N, d]; b counts on the interior, u on the collar.
        solver: of `rest`.

    Raises InputError as `rest`, for a shape that does not fit, and for tensors that ask for a
    gradient of another operator.
    """
    b, u = pair_of(operator, b, u)
    if not operator.is_symmetric:
        refuse_tangents(b, u)
        if b.requires_grad or u.requires_grad:
            raise InputError(
                "solve: expected tensors without a gradient, which the equilibrium of a "
                f"{type(operator.model).__name__} does not have in torch"
            )
        return operator.rest(b.numpy(), u.numpy(), solver)
    inside, axis = operator.points.interior, -len(operator.shape)
    found: list[Any] = []

    def there(both: np.ndarray) -> np.ndarray:
        found.append(operator.rest(both[0], both[1], solver))
        return np.asarray(found[-1].u)

    def back(g: np.ndarray) -> np.ndarray:
        w = operator.rest(g, np.zeros_like(g), solver).u
        pushed = operator.product_transpose(None, np.compress(inside, w, axis))
        return np.stack([w, (g - pushed) * ~inside.reshape(-1, *[1] * (-axis - 1))])

    answer = linear(torch.stack([b.cpu(), u.cpu()]).double(), there, back)
    return replace(found[0], u=answer.to(u if u.is_floating_point() else answer))


class Module(torch.nn.Module):
    """A material on points as a module of torch: ``module(u)`` is the force, as ``operator(u)``.

    Args:
        material: any, or its operator on these points.
        points: the nodes, N of them.
        options: of the material's `on`.

    Attributes:
        operator: the material on the points.
        lam, mu, alpha, D, D_dilatation: parameters of a linear peridynamic solid [stress], [1],
            [M + 1], as it is used on the points. A λ that is μ and a D_dilatation that is D stay
            so, and are none of their own.
        t3, tq2, q3: parameters of a third-order solid [stress]; its linear part is held.
        networks: of a neural operator, the material itself with its parameters.

    Other materials have no parameters and give the gradient in u alone. Parameters are float64;
    with them the second derivative is refused. Raises InputError as `on`, and for a u that does
    not fit.
    """

    def __init__(self, material: Any, points: Any, **options: Any) -> None:
        super().__init__()
        self.operator = placed(material, points, verb="Module", **options)
        for name, value in getattr(self.operator, "learnable", {}).items():
            number = torch.tensor(value, dtype=torch.float64)
            self.register_parameter(name, torch.nn.Parameter(number))
        if isinstance(self.operator.model, torch.nn.Module):
            self.networks = self.operator.model

    def forward(self, u: torch.Tensor) -> torch.Tensor:
        """The force on the interior nodes [stress/length], [..., I, d] of u [..., N, d]."""
        operator, numbers = self.operator, dict(self.named_parameters(recurse=False))
        if not numbers:
            return operator(u)  # type: ignore[no-any-return]
        u = torch.as_tensor(u)
        return on_fields(operator, u, lambda fields: operator.force_with(fields, numbers))


def differentiable_once(backward: Backward) -> Backward:
    """The backward pass of a torch function that saves every tensor it depends on.

    A derivative of what it returns raises InputError, by `backward`, `grad`, `hessian` or `hvp`;
    torch's own once_differentiable lets those pass that do not go through the upstream gradient.
    """

    @functools.wraps(backward)
    def once(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        with torch.no_grad():
            found = backward(ctx, *upstream)
        if not torch.is_grad_enabled():
            return found
        of = [one for one in (*upstream, *ctx.saved_tensors) if one is not None]
        of = [one for one in of if one.requires_grad]
        return tuple(
            one if one is None else _once(lambda *_, n=one: n.clone(), *of) for one in found
        )

    return once


def refuse_tangents(*inputs: Any) -> None:
    """InputError for tensors with a tangent of forward mode, which would be lost."""
    for one in inputs:
        if isinstance(one, torch.Tensor) and forward_ad.unpack_dual(one).tangent is not None:
            raise InputError(
                "tangent: expected no forward-mode derivative; operator.product(u, v) is the "
                "derivative of a force along v"
            )
