"""Waves of tensors: velocity Verlet with its discrete adjoint, from few states (theory, 49).

With kicks w_n = Δt/ρ, half of it at both ends, and v between the displacements,

    v ← v − w_n (L u_n − b),   u_{n+1} = u_n + Δt v.

Backwards, with p and q the derivatives of a scalar to u and v, and p_I those of interior nodes,

    q ← q + Δt p_I,   p ← p − w_n L′(u_n)ᵗ q,   b̄ ← b̄ + s_n w_n q,   s̄_n = w_n qᵗ b,

and −w_n qᵗ ∂(L u_n)/∂a to a number a of the material. Displacements are needed for numbers, and
where L is not linear: of n steps some √n states are kept, from which those between are computed
again, the last stretch first.

What flows is stepped implicitly (theory, Di4): of E u̇ + L u = b on the interior, θ in [1/2, 1],

    A u_n = B u_{n−1} + b_n,   A = E/Δt + θ L,   B = E/Δt − (1 − θ) L,

with u_n given elsewhere. Backwards A_IIᵗ w_n = p_I, p ← Bᵗ w_n and the records before, b̄_n = w_n.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy import ndarray

from warp_peri.core.torch_bridge import as_tensor, by_numbers, once, real, with_numbers
from warp_peri.errors import InputError, Values, called, warn
from warp_peri.points import arguments
from warp_peri.points.arguments import (
    Natural,
    Numbers,
    Options,
    Pair,
    Positive,
    checked,
    is_tensor,
    taken,
)
from warp_peri.solvers import verlet
from warp_peri.solvers.motion import Motion, Recorder
from warp_peri.solvers.systems import MatrixProblem

BATCH = 16
"""Fields whose derivatives to numbers are taken at once."""


def moved(
    operator: Any,
    b: Any,
    u: Any,
    *,
    v: Any = None,
    signal: Any = None,
    parameters: Numbers | None = None,
    record: Any = None,
    **sizes: Any,
) -> Motion:
    """Motion of verlet.march with u, v and history "u" as differentiable float64 tensors.

    Args:
        operator, record, sizes: as of verlet.march; sizes are density, step, steps and every.
        b, u, v: load, displacement and velocity, [N, d], tensors or arrays; None for zero b, v.
        signal: of the load, shape [steps + 1], as of verlet.march.
        parameters: numbers of the material by name, as of wp.TorchModule; the others stay.

    Raises InputError as verlet.march, for files, parameters that the material does not have or with
    which waves would grow, and a second derivative.
    """
    if files := sizes.keys() - {"density", "step", "steps", "every"}:
        raise InputError(f"simulate: expected no {', '.join(sorted(files))} of tensors")
    operator, numbers = with_numbers(operator, parameters or {})
    zero, sizes = 0 * as_tensor("u", u), {"every": 1} | sizes
    arguments.check_nodes("steps", (sizes["steps"],), "steps")
    pulse = np.ones(sizes["steps"] + 1) if signal is None else signal
    given: list[Any] = [*(zero if field is None else field for field in (u, v, b)), pulse]
    given = [*map(real, ("u", "v", "b", "signal"), given), *numbers.values()]
    waves = _Waves(
        operator, list(numbers), verlet.recorded_nodes(record, len(operator.points.x)), sizes
    )
    asked = given[4:] if getattr(operator, "is_linear", False) else given
    waves.keeps = torch.is_grad_enabled() and any(one.requires_grad for one in asked)
    end, v, *records = once(waves.there, waves.back, *given)
    return replace(waves.motion, u=end, v=v, history=waves.motion.history | dict(zip("u", records)))


def in_motion(operator: Any, b: Any, u: Any, options: Options) -> Motion:
    """Motion of verlet.march; for tensors, or with `parameters`, that of `moved`."""
    how, files, learned = taken(options, "simulate", verlet.march, Recorder.__init__, moved)
    fields = b, u, how.get("v"), how.get("signal")
    if "parameters" in learned or any(map(is_tensor, fields)):
        return moved(operator, b, u, **how | files | learned)
    return verlet.march(operator, b, u, **how | files)


class _Waves:
    """One motion of an operator, there and back; `options` are those of verlet.started."""

    keeps = False
    """Whether states are kept, from which displacements are computed again."""

    def __init__(self, operator: Any, names: list[str], record: Any, options: Any) -> None:
        self.operator, self.names, self.record, self.options = operator, names, record, options
        self.dt, self.steps, self.every = options["step"], options["steps"], options.pop("every")
        self.kept: list[verlet.State] = []

    def there(self, *given: ndarray) -> list[Any]:
        """Final u and v [N, d], and records [R, n, d], from u, v, b, a signal and numbers."""
        fields = dict(zip(("u", "v", "b"), given))
        nodes, self.body, state = verlet.started(self.operator, fields, given[3], **self.options)
        run = verlet.WaveRun(nodes, self.body, self.dt, self.record, every=self.every)
        if self.keeps:
            for ahead in range(0, self.steps, math.isqrt(self.steps) + 1):
                state = run.march(state, steps=ahead)
                self.kept.append(state)
        self.motion = run.motion(run.march(state, steps=self.steps))
        ends = [self.motion.u, self.motion.v]
        return ends if self.record is None else [*ends, self.motion["u"]]

    def back(self, asked: tuple[bool, ...], p: Any, v: Any, seen: Any = None) -> list[Any]:
        """Derivatives to u, v and b [N, d], the signal, and the asked numbers, from the derivatives
        p, v of the end (p is overwritten) and `seen` of the records."""
        wanted = [*compress(self.names, asked[4:])]
        free, whole, last = self.body.interior, self.dt / self.body.inertia, self.steps
        q, load, totals = v[free], np.zeros_like(v[free]), Values.fromkeys(wanted, 0.0)
        by_signal, batch = np.zeros(last + 1), list[Pair]()
        for number, u in self._backwards():
            if number < last:
                upstream = np.zeros_like(p)
                if seen is not None and number % self.every == 0:
                    np.add.at(upstream, self.record, seen[number // self.every])
                q = q + self.dt * (p + upstream / 2)[free]
                p += upstream
            pull = whole * q / (1 + (number in (0, last)))
            p -= self.operator.vjp(u, pull)
            load += self.body.share(number) * pull
            by_signal[number] = np.vdot(pull, self.body.load)
            if wanted:
                batch.append((u, pull))
            if len(batch) == BATCH or (batch and number == 0):
                found = by_numbers(self.operator, wanted, *map(np.stack, zip(*batch)))
                totals = {name: totals[name] - value for name, value in found.items()}
                batch.clear()
        own = (totals.get(name) for name in self.names)
        return [p, self.body.on_all(q), self.body.on_all(load), by_signal, *own]

    def _backwards(self) -> Iterator[tuple[int, Any]]:
        """Iterate over steps backwards, with displacements where states are kept."""
        if not self.kept:
            yield from ((number, None) for number in reversed(range(self.steps + 1)))
        end = self.steps
        for state in reversed(self.kept):
            way = [state]
            while way[-1].steps < end:
                way.append(verlet.step(self.body, way[-1], self.dt))
            yield from ((one.steps, one.u) for one in reversed(way))
            end = state.steps - 1


def stepped(
    operator: Any,
    b: Any,
    u: Any,
    *,
    step: Positive,
    steps: Natural,
    collar: Any = None,
    parameters: Numbers | None = None,
) -> Motion:
    """Solve linear flow by implicit steps of any length; differentiable once in tensors.

    Args:
        operator: linear; its `tangent`, `storage` and `implicit` are L, E and θ.
        b: load or source of all nodes, [N] or [N, d], or a function of time that gives it; None for
            none. It is read on the interior.
        u: field of all nodes at the start, of the same shape.
        step: Δt > 0.
        steps: number of steps.
        collar: field of all nodes at a time, read off the interior; unchanged by default.
        parameters: numbers of the operator's `learnable` by name. The others stay as they are.

    Returns a motion whose history u is the field at the start and after every step,
    [steps + 1, N, …]; a tensor where one was given. Raises InputError for other shapes, what is not
    finite, a step not > 0, a number of steps below 0, numbers that the operator does not have, a
    solve that loses its digits, and a second derivative.
    """
    operator, numbers = with_numbers(operator, parameters or {})
    if not getattr(operator.model, "storage", 1.0):
        warn("storage: none is stated, with which φ follows flow and coupling at once")
    arguments.check_nodes("steps", (steps, len(operator.points.x)))
    times, tensors = step * np.arange(steps + 1), [u, *(parameters or {}).values()]
    start = real("u", u)
    fields = [start]
    given = np.zeros(start.shape) if b is None else b, u if collar is None else collar
    for name, field in zip(("b", "collar"), given):
        each = []
        for time in times[steps > 0 :] if callable(field) else times[:1]:
            tensors.append(called(f"{name}: expected a field at t = {time:g}", field, time))
            each.append(real(name, tensors[-1]).clone())  # the function may fill one array
            arguments.check_shape(name, each[-1], start.shape)
        fields.append(torch.stack(each).expand(steps, *start.shape))
    flow = Implicit(operator, step, list(numbers))
    (found,) = once(flow.there, flow.back, *fields, *numbers.values())
    found = found if any(map(is_tensor, tensors)) else found.numpy()
    return Motion(times, found[-1], None, {"u": found})


class Implicit:
    """Implicit steps of a linear operator; InputError where a step has no one solution."""

    def __init__(self, operator: Any, step: float, names: list[str]) -> None:
        self.operator, self.step, self.names = operator, step, names
        self.theta = float(operator.implicit)
        operator.interior_tangent(None)  # refuses what would grow
        L, E = sp.csr_array(operator.tangent(None)), sp.csr_array(operator.storage() / step)
        self.ahead = MatrixProblem(sp.csr_array(E + self.theta * L), operator.points.interior)
        self.behind = E - (1 - self.theta) * L

    def there(self, start: Any, loads: Any, given: Any, *_: ndarray) -> tuple[ndarray]:
        """Compute the fields at the start and after each step from loads and given values."""
        one = self.operator.shape
        fields = [checked("u", start, float, one)]
        loads = checked("b", loads, float, (len(loads), *one), ~self.operator.held)
        given = checked("collar", given, float, (len(given), *one), self.operator.held)
        for load, held in zip(loads.copy(), given):
            load.ravel()[self.ahead.unknown] += self.behind @ fields[-1].ravel()
            fields.extend(self.ahead.solve(load[None], held[None]))
        self.fields = np.array(fields)
        return (self.fields,)

    def back(self, asked: tuple[bool, ...], p: ndarray) -> list[Any]:
        """Derivatives to the start, to loads and given values of each step, and to asked numbers,
        from those of the fields, p (overwritten)."""
        wanted = [*compress(self.names, asked[3:])]
        steps, one, free = len(p) - 1, p.shape[1:], self.ahead.unknown
        p, w = p.reshape(steps + 1, -1), np.zeros((steps, np.count_nonzero(free)))
        by_load, by_given = np.zeros((2, steps, len(free)))
        for n in reversed(range(steps)):
            w[n] = self.ahead.factors.solve(p[n + 1, free], "T")
            by_given[n, ~free] = p[n + 1, ~free] - w[n] @ self.ahead.collar
            p[n] += w[n] @ self.behind
        by_load[:, free] = w
        by = [p[0].reshape(one), *(x.reshape(steps, *one) for x in (by_load, by_given))]
        totals: Values = dict.fromkeys(wanted, 0.0)
        own: Any = getattr(self.operator, "storage_slopes", lambda *_: {})
        if wanted and steps:
            weights = -w.reshape(steps, -1, *one[1:])
            middle = self.theta * self.fields[1:] + (1 - self.theta) * self.fields[:-1]
            rates = np.diff(self.fields, axis=0) / self.step
            for found in (
                by_numbers(self.operator, wanted, middle, weights),
                own(wanted, rates, weights),
            ):
                totals |= {name: totals[name] + np.asarray(slope) for name, slope in found.items()}
        return [*by, *(totals.get(name) for name in self.names)]
