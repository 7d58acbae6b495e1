"""Waves of tensors: velocity Verlet with its discrete adjoint, from few states (theory.md, 49).

With kicks w_n = Δt/ρ, half of it at both ends, and v between the displacements,

    v ← v − w_n (L u_n − b),   u_{n+1} = u_n + Δt v.

Backwards, with p and q the derivatives of a scalar to u and v, and p_I those of interior nodes,

    q ← q + Δt p_I,   p ← p − w_n L′(u_n)ᵗ q,   b̄ ← b̄ + w_n q,   and −w_n qᵗ ∂(L u_n)/∂a

to a number a of the material. Displacements are needed for numbers, and where L is not linear.
They are made anew from every √steps-th state, so that the memory grows as √steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isqrt
from typing import Any

import numpy as np
import torch

from warp_peri.core.tensors import differentiable_once, refuse_tangents
from warp_peri.dynamics import verlet
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError


def moved(
    operator: Any,
    b: Any,
    u: Any,
    *,
    v: Any = None,
    parameters: Mapping[str, Any] | None = None,
    record: Any = None,
    **sizes: Any,
) -> Motion:
    """The motion of verlet.march, its u, v and history "u" differentiable tensors in float64.

    Args:
        operator, record, sizes: as of verlet.march; sizes are density, step, steps and every.
        b, u, v: load, displacement and velocity, shape [N, d], tensors or arrays; None for zero.
        parameters: numbers of the material by name, as of wp.Module: of a linear peridynamic
            solid, or maps of a dressed body. The others stay as they are.

    Raises InputError as verlet.march, for files, parameters that the material does not have or
    with which waves would grow, a second derivative and a tangent of forward mode.
    """
    if files := sizes.keys() - {"density", "step", "steps", "every"}:
        raise InputError(f"move: expected no {', '.join(sorted(files))} of tensors")
    numbers, zero, sizes = dict(parameters or {}), 0 * torch.as_tensor(u), {"every": 1} | sizes
    given = [*(zero if field is None else field for field in (u, v, b)), *numbers.values()]
    refuse_tangents(*given)
    given = [torch.as_tensor(value).to("cpu", torch.float64) for value in given]
    values = {name: value.detach().numpy() for name, value in zip(numbers, given[3:])}
    seen = verlet.recorded_nodes(record, len(operator.points.x))
    waves = _Waves(with_numbers(operator, values), list(numbers), seen, sizes)
    end, v, *records = _Moved.apply(waves, *given)  # type: ignore[no-untyped-call]
    history = waves.motion.history | dict(zip("u", records))
    return replace(waves.motion, u=end, v=v, history=history)


def with_numbers(operator: Any, numbers: dict[str, np.ndarray]) -> Any:
    """The operator with some of its `learnable` numbers changed, itself where they are its own.
    Raises InputError for others, and as its `at`."""
    known = getattr(operator, "learnable", {}) if hasattr(operator, "at") else {}
    names = ", ".join(f"{name} {list(np.shape(own))}" for name, own in known.items()) or "none"
    for name, value in numbers.items():
        if value.size != np.size(known.get(name, ())) or not np.isfinite(value).all():
            got = f"{name} {list(value.shape)}"
            raise InputError(f"parameters: expected finite numbers of shape {names}, got {got}")
    numbers = {name: value.reshape(np.shape(known[name])) for name, value in numbers.items()}
    same = all(np.array_equal(value, known[name]) for name, value in numbers.items())
    return operator if same else operator.at(known | numbers)


class _Waves:
    """One motion of an operator, there and back; `options` are those of verlet.started."""

    def __init__(self, operator: Any, names: list[str], record: Any, options: Any) -> None:
        self.operator, self.names, self.record, self.options = operator, names, record, options
        self.dt, self.steps, self.every = (options[name] for name in ("step", "steps", "every"))
        self.kept: list[verlet.State] = []

    def there(self, fields: dict[str, Any], *, keep: bool) -> list[Any]:
        """u and v [N, d] at the end, and the records [R, n, d] where there are some."""
        _, self.body, state = verlet.started(self.operator, fields, **self.options)
        self.stretch = isqrt(self.steps - 1) + 1

        def passed(number: int, state: verlet.State) -> None:
            if keep and number % self.stretch == 0:
                self.kept.append(state)

        sizes = self.dt, self.steps, self.every
        self.motion = verlet.marched(self.body, state, *sizes, record=self.record, passed=passed)
        ends = [self.motion.u, self.motion.v]
        return ends if self.record is None else [*ends, self.motion["u"]]

    def back(self, wanted: list[str], p: Any, v: Any, seen: Any = None) -> list[Any]:
        """Derivatives to u, v and b [N, d], and to the numbers that are wanted, by name.

        p, v, seen: what is upstream of u and v at the end, and of the records; p is overwritten.
        """
        free, whole = self.body.interior, self.dt / self.body.inertia
        q, load, totals = v[free], np.zeros_like(v[free]), dict[str, Any].fromkeys(wanted, 0.0)
        for first in (self.steps, *reversed(range(0, self.steps, self.stretch))):
            fields, pulls = self._again(first), list[np.ndarray]()
            for number in reversed(range(first, first + len(fields))):
                if number < self.steps:
                    upstream = np.zeros_like(p)
                    if seen is not None and number % self.every == 0:
                        np.add.at(upstream, self.record, seen[number // self.every])
                    q = q + self.dt * (p + upstream / 2)[free]
                    p += upstream
                pulls.insert(0, whole * q / (1 + (number in (0, self.steps))))
                p -= self.operator.product_transpose(fields[number - first], pulls[0])
                load += pulls[0]
            for name, value in self._by_numbers(wanted, fields, pulls).items():
                totals[name] -= value
            del fields  # before others are made
        return [p, self.body.on_all(q), self.body.on_all(load), totals]

    def _again(self, first: int) -> list[Any]:
        """Displacements before the steps of a stretch, None where nothing asks for them."""
        if first == self.steps:
            return [self.motion.u]
        count = min(self.stretch, self.steps - first)
        if not self.kept:
            return [None for _ in range(count)]
        states = [self.kept[first // self.stretch]]
        while len(states) < count:
            states.append(verlet.step(self.body, states[-1], self.dt))
        return [state.u for state in states]

    def _by_numbers(self, names: list[str], u: list[Any], w: list[Any]) -> dict[str, Any]:
        """Derivatives of Σ w · force(u) to numbers, of fields [N, d] and weights [I, d]."""
        if not names:
            return {}
        fields, weights, operator = np.stack(u), np.stack(w), self.operator
        if hasattr(operator, "by_numbers"):
            return {name: operator.by_numbers(name, fields, weights) for name in names}
        with torch.enable_grad():
            numbers = {
                name: torch.tensor(value, dtype=torch.float64, requires_grad=name in names)
                for name, value in operator.learnable.items()
            }
            force = operator.force_with(torch.from_numpy(fields), numbers)
            leaves = [numbers[name] for name in names]
            return dict(zip(names, torch.autograd.grad(force, leaves, torch.from_numpy(weights))))


class _Moved(torch.autograd.Function):
    """Displacement, velocity, load [N, d] and numbers to u, v [N, d] and records [R, n, d]."""

    @staticmethod
    def forward(ctx: Any, waves: _Waves, *given: torch.Tensor) -> tuple[torch.Tensor, ...]:
        ctx.waves, asked = waves, ctx.needs_input_grad[1:]
        ctx.save_for_backward(*given)
        fields = dict(zip(("u", "v", "b"), (field.detach().numpy() for field in given)))
        keep = any(asked if not getattr(waves.operator, "is_linear", False) else asked[3:])
        return tuple(map(torch.tensor, waves.there(fields, keep=keep)))

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        numbers = dict(zip(ctx.waves.names, ctx.saved_tensors[3:]))
        wanted = [name for name, asked in zip(numbers, ctx.needs_input_grad[4:]) if asked]
        *by, found = ctx.waves.back(wanted, *(one.detach().clone().numpy() for one in upstream))
        for name in wanted:
            found[name] = torch.as_tensor(found[name]).reshape(numbers[name].shape)
        return None, *map(torch.from_numpy, by), *map(found.get, numbers)
