"""Networks of three layers with rectifiers, and the scalar force state of many bonds at once."""

from __future__ import annotations

import itertools
from typing import Any

import torch

from warp_peri.core.once import differentiable_once

CHUNK = 2048
"""Bonds at once: their hidden layers stay in a processor's cache."""


def network(*widths: int) -> torch.nn.Sequential:
    """Linear layers with rectifiers between them."""
    layers: list[torch.nn.Module] = []
    for width, following in itertools.pairwise(widths):
        layers += [torch.nn.Linear(width, following), torch.nn.ReLU()]
    return torch.nn.Sequential(*layers[:-1])


def evaluate(layers: torch.nn.Sequential, inputs: torch.Tensor) -> torch.Tensor:
    """Values of a network of three layers, shape [n], of inputs of shape [n, k].

    Inputs that lie together in memory are best alike: a unit of the first layer whose sign is the
    same for a whole chunk acts linearly, and takes no part in the large product.
    """
    numbers = [p for n in (0, 2, 4) for p in (layers[n].weight, layers[n].bias)]
    value: torch.Tensor = _Chunks.apply(inputs, *numbers)  # type: ignore[no-untyped-call]
    return value


class _Chunks(torch.autograd.Function):
    """The network chunk by chunk, with its adjoint."""

    @staticmethod
    def forward(context: Any, x: torch.Tensor, *numbers: torch.Tensor) -> torch.Tensor:
        keep = any(context.needs_input_grad)
        out, hidden = [], []
        for part in x.split(CHUNK):
            second = _second(part, numbers)[0]
            out.append(second @ numbers[4][0])
            if keep:
                hidden.append(second)
        context.save_for_backward(x, *numbers, *hidden)
        return torch.cat(out).add_(numbers[5])

    @staticmethod
    @differentiable_once
    def backward(context: Any, seed: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        x, W1, b1, W2, b2, W3, _, *hidden = context.saved_tensors
        learns = any(context.needs_input_grad[1:])
        by_x = torch.empty_like(x)
        by_W1, by_b1 = torch.zeros_like(W1), torch.zeros_like(b1)
        by_W2, by_b2, by_W3 = torch.zeros_like(W2), torch.zeros_like(b2), torch.zeros_like(W3)
        for part, g, second, out in zip(
            x.split(CHUNK), seed.split(CHUNK), hidden, by_x.split(CHUNK)
        ):
            steady, mixed = units(part, W1, b1)
            if learns:
                by_W3[0].addmv_(second.t(), g)
            back = torch.outer(g, W3[0]).mul_(second > 0)
            first = torch.addmm(b1[mixed], part, W1[mixed].t()).relu_()
            down = (back @ W2[:, mixed]).mul_(first > 0)
            torch.mm(down, W1[mixed], out=out)
            through = W2[:, steady] @ W1[steady]
            out.addmm_(back, through)
            if not learns:
                continue
            total, moments = back.sum(dim=0), back.t() @ part
            by_b2 += total
            by_W2[:, mixed] += back.t() @ first
            by_W2[:, steady] += moments @ W1[steady].t() + torch.outer(total, b1[steady])
            by_W1[mixed] += down.t() @ part
            by_b1[mixed] += down.sum(dim=0)
            by_W1[steady] += W2[:, steady].t() @ moments
            by_b1[steady] += W2[:, steady].t() @ total
        if not learns:
            return by_x, *6 * [None]
        return by_x, by_W1, by_b1, by_W2, by_b2, by_W3, seed.sum()[None]


def units(x: torch.Tensor, W: torch.Tensor, b: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Units of the first layer that act for all of a box around the inputs, and undecided ones."""
    low, high = x.amin(dim=0), x.amax(dim=0)
    middle, half = (low + high) / 2, (high - low) / 2
    centre, reach = W @ middle + b, W.abs() @ half
    steady = centre - reach > 0
    mixed = ~steady & (centre + reach > 0)
    return steady.nonzero()[:, 0], mixed.nonzero()[:, 0]


def _second(x: torch.Tensor, numbers: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, ...]:
    """The second hidden layer."""
    W1, b1, W2, b2 = numbers[:4]
    steady, mixed = units(x, W1, b1)
    first = torch.addmm(b1[mixed], x, W1[mixed].t()).relu_()
    bias = torch.addmv(b2, W2[:, steady], b1[steady])
    second = torch.addmm(bias, first, W2[:, mixed].t())
    second.addmm_(x, (W2[:, steady] @ W1[steady]).t())
    return second.relu_(), steady, mixed
