"""Derivatives that are had once: the second is refused on every path, where torch would leave out
terms."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import torch
from torch.autograd import forward_ad

from warp_peri.errors import InputError

Backward = Callable[..., tuple[torch.Tensor | None, ...]]


class _First(torch.autograd.Function):
    """A first derivative that knows what it came of, so that a second one meets an error."""

    @staticmethod
    def forward(ctx: Any, found: torch.Tensor, *_: torch.Tensor) -> torch.Tensor:
        return found.clone()

    @staticmethod
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        raise InputError(
            "second derivative: expected first derivatives alone of a force or an equilibrium; "
            "operator.product(u, v) is the derivative of a force along v"
        )


_first: Callable[..., torch.Tensor] = _First.apply


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
        return tuple(one if one is None else _first(one, *of) for one in found)

    return once


def refuse_tangents(*inputs: Any) -> None:
    """InputError for tensors with a tangent of forward mode, which would be lost."""
    for one in inputs:
        if isinstance(one, torch.Tensor) and forward_ad.unpack_dual(one).tangent is not None:
            raise InputError(
                "tangent: expected no forward-mode derivative; operator.product(u, v) is the "
                "derivative of a force along v"
            )
