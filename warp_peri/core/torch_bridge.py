"""Operators in torch: one force function for every material; a derivative that can be had once is
refused a second time on every path, where torch would leave out terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy import ndarray
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, gmres, splu
from torch.autograd import forward_ad

from warp_peri.core.elastic import in_shape_of
from warp_peri.errors import InputError, Several, Values, quietly
from warp_peri.points.arguments import Numbers, as_array, check_mapping, check_shape, plain, typed
from warp_peri.protocols import SINGULAR, OperatorBase, placed, uncompiled
from warp_peri.runtime import one_thread

DIRECT = 4_000
"""Unknown nodes up to which a tangent is factorised for its adjoint, as `statics` does."""
EXACT, ROUGH, KEPT, ROUNDS = 1e-11, 1e-10, 40, 10
"""Relative residual of an adjoint in steps, and of the inverse before it; directions that GMRES
keeps, and how often it begins anew."""
FEW = 100_000
"""Numbers of an array below which threads cost more than they save."""
MOST = 2**23
"""Numbers of the gradients that are held at once; more samples follow one another."""


@contextmanager
def own_torch() -> Iterator[None]:
    """Torch with gradients and on the processor inside, whatever the user does with his."""
    here = torch.get_default_device().type == "cpu"  # a device's context takes time at each call
    with torch.inference_mode(False), nullcontext() if here else torch.device("cpu"):
        yield


def _refused(*_: Any) -> Any:
    raise InputError(
        "second derivative: expected first derivatives alone of a force that is not linear, of its "
        "numbers, or of an equilibrium; operator.jvp(u, v) is the derivative of a force along v"
    )


def _no_tangent(*_: Any) -> Any:
    raise InputError(
        "expected no tangents of forward mode; operator.jvp(u, v) is the derivative along v"
    )


class _Made(torch.autograd.Function):
    """Function `make` of tensors; `back` is its derivative transposed, given which are asked for,
    the tensors and the upstream gradient."""

    jvp = staticmethod(_no_tangent)  # type: ignore[assignment]

    @staticmethod
    def forward(ctx: Any, make: Any, back: Any, *of: torch.Tensor) -> Any:
        ctx.back = back
        ctx.save_for_backward(*of)
        return make(*of)

    @staticmethod
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        upstream = tuple(real("gradient", one) for one in upstream)
        return None, None, *ctx.back(ctx.needs_input_grad[2:], *ctx.saved_tensors, *upstream)


_made: Callable[..., Any] = _Made.apply


def _arrays(tensors: Iterable[torch.Tensor]) -> Several:
    return tuple(one.detach().contiguous().numpy() for one in tensors)


def linear(x: torch.Tensor, there: Callable[..., Any], back: Callable[..., Any]) -> torch.Tensor:
    """Linear map of NumPy fields [S, …] with transpose `back`, differentiable to any order."""
    return _made(  # type: ignore[no-any-return]
        lambda x: torch.from_numpy(np.require(there(*_arrays([x])), float, ["C", "W"])),
        lambda *given: (linear(given[-1], back, there),),
        x,
    )


def once(there: Any, back: Any, *of: torch.Tensor) -> Any:
    """Function `there` of arrays, differentiable once: `back` makes the derivatives of upstream
    arrays, given which are asked for; None is zero. A second derivative raises InputError; torch's
    once_differentiable lets those pass that do not go through the upstream gradient."""

    def make(*of: torch.Tensor) -> tuple[torch.Tensor, ...]:
        # NumPy copies: torch's own wait for its threads, which others may keep busy
        return tuple(torch.from_numpy(np.array(one, float)) for one in there(*_arrays(of)))

    def pulled(asked: Any, *given: torch.Tensor) -> list[torch.Tensor | None]:
        upstream = (np.array(one.detach().numpy(), order="C") for one in given[len(of) :])
        slopes = [
            _like(one, number) if wanted and one is not None else None
            for one, number, wanted in zip(back(asked, *upstream), given, asked)
        ]
        felt = [one for one in given if torch.is_grad_enabled() and one.requires_grad]
        return [
            _made(lambda *_, n=one: n.clone(), _refused, *felt) if felt and one is not None else one
            for one in slopes
        ]

    return _made(make, pulled, *of)


def _like(slope: Any, number: torch.Tensor) -> Any:
    """A derivative in the shape of the number it is by."""
    slope = torch.as_tensor(slope, dtype=torch.float64, device="cpu")
    return (slope if slope.dim() else slope.expand(number.shape)).reshape_as(number).to(number)


def force_of(operator: Any, u: torch.Tensor) -> torch.Tensor:
    """Force of an operator on the interior nodes, [..., I, d], differentiable in u [..., N, d];
    InputError for another shape or type, and for a second derivative of a nonlinear one."""

    def force(fields: torch.Tensor) -> torch.Tensor:
        if operator.is_linear:
            return linear(fields, operator.force, lambda w: operator.vjp(None, w))
        return force_with_parameters(operator, fields, {})

    return on_fields(operator, u, force)


def on_fields(
    operator: Any, u: torch.Tensor, force: Callable[[torch.Tensor], torch.Tensor]
) -> torch.Tensor:
    """Apply `force` to u [..., N, d] as fields [S, N, d] in float64, back in u's precision;
    InputError for a u of another shape or type."""
    operator.check(u, u.is_floating_point())
    found = force(real("u", u).reshape(-1, *operator.shape))
    return found.reshape(*u.shape[: u.dim() - len(operator.shape)], *found.shape[1:]).to(u)


def as_tensor(name: str, value: Any) -> torch.Tensor:
    """Convert numbers to a float64 tensor (tensors stay; of a list torch would keep half the
    digits), masked entries NaN; InputError for other values."""
    if isinstance(value, torch.Tensor):
        return value
    array = as_array(name, value)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: expected an array of real numbers, got {type(value).__name__}")
    return torch.from_numpy(np.ma.filled(array.astype(float, order="C"), np.nan))


def real(name: str, value: Any) -> torch.Tensor:
    """A float64 tensor on the processor; InputError for complex numbers, booleans, lazy views, and
    tensors of torch.func and its kin."""
    kinds, tensor = torch._C._functorch, as_tensor(name, value)
    if kinds.is_functorch_wrapped_tensor(tensor) or kinds.is_legacy_batchedtensor(tensor):
        raise InputError(
            "torch.func: expected plain tensors, none of vmap or is_grads_batched; torch.autograd."
            "grad and backward() have the gradient, operator.jvp(u, v) the derivative along v"
        )
    if tensor.is_meta or tensor.layout is not torch.strided:
        raise InputError(
            f"{name}: expected a dense tensor with values, got {tensor.layout} on {tensor.device}"
        )
    if tensor.is_complex() or tensor.dtype == torch.bool:
        raise InputError(f"{name}: expected real numbers, got {tensor.dtype}")
    return tensor.to("cpu", torch.float64)


def with_numbers(operator: Any, numbers: Numbers) -> tuple[Any, dict[str, torch.Tensor]]:
    """The operator with some `learnable` numbers changed (itself if equal), and these as float64
    tensors; InputError for other names, and as its `at`."""
    check_mapping("parameters", numbers)
    known = getattr(operator, "learnable", {}) if hasattr(operator, "at") else {}
    given = {name: real(name, value) for name, value in numbers.items()}
    values = Values()
    for name, tensor in given.items():
        value, own = tensor.detach().numpy(), known.get(name, ())
        fits = value.shape == np.shape(own) or value.size == np.size(own) == 1  # a number, as [1]
        if name not in known or not fits or not np.isfinite(value).all():
            got = f"{name} {list(value.shape)}: {value!r:.60}"
            names = ", ".join(f"{n} {list(np.shape(own))}" for n, own in known.items())
            names = names or getattr(operator, "unlearned", "none")
            raise InputError(f"parameters: expected finite numbers among {names}, got {got}")
        values[name] = value.reshape(np.shape(own))
    same = all(np.array_equal(value, known[name]) for name, value in values.items())
    return operator if same else operator.at(known | values), given


def force_with_parameters(operator: Any, u: torch.Tensor, numbers: Numbers) -> torch.Tensor:
    """Force of fields [S, N, d] with other numbers, by an operator's `at` and `by_numbers`."""
    names, made = list(numbers), list[Any]()

    def there(u: ndarray, *values: ndarray) -> tuple[ndarray]:
        made[:] = u, with_numbers(operator, dict(zip(names, values)))[0]
        return (made[1].force(u),)

    def back(asked: tuple[bool, ...], w: ndarray) -> list[Any]:
        u, at = made
        slopes = by_numbers(at, [*compress(names, asked[1:])], u, w)
        return [at.vjp(u, w) if asked[0] else None, *map(slopes.get, names)]

    (force,) = once(there, back, u, *numbers.values())
    return force  # type: ignore[no-any-return]


def by_numbers(operator: Any, names: list[str], u: ndarray, w: ndarray) -> Values:
    """Derivatives of Σ w · force(u) by numbers, for fields [K, N, d] and weights [K, I, d]."""
    if not names:
        return {}
    if hasattr(operator, "by_numbers"):
        return {name: operator.by_numbers(name, u, w) for name in names}
    with own_torch():
        numbers = {
            name: torch.tensor(value, dtype=torch.float64, requires_grad=name in names)
            for name, value in operator.learnable.items()
        }
        force = operator.force_with_parameters(torch.from_numpy(u), numbers)
        leaves = [numbers[name] for name in names]
        return dict(zip(names, torch.autograd.grad(force, leaves, torch.from_numpy(w))))


def at_rest(operator: Any, b: Any, u: Any, solver: Any = None, parameters: Any = None) -> Any:
    """Solution of any operator in equilibrium, its u a tensor with a gradient (theory, 29).

    With g the derivative of a scalar to u and L′ᵗ w = g on the interior, L′ the derivative of the
    force at the answer, b has w, u on the collar g − L′ᵗ w, and a number a −wᵗ ∂(L u)/∂a. What is
    linear has every derivative to b and u; of others, and to numbers, the second is refused.

    The operator offers `solve`, and `interior_tangent` or `inverse` where it is not symmetric; b
    and u are of all nodes, [N, d] or [S, N, d]. `parameters` are some of its `learnable` by name,
    those of a network are learned without being named. InputError as `solve`, where L′ is singular.
    """
    given = as_tensor("u", u)
    fields = [real("b", b), real("u", given)]
    operator.check(fields[1])
    check_shape("b", fields[0], given.shape)
    operator, named = with_numbers(operator, parameters or {})
    numbers = [*named.values(), *operator.networks]
    found: list[Any] = []

    def there(b: ndarray, u: ndarray, *_: ndarray) -> tuple[ndarray]:
        found.append(_rest(operator, b, u, solver))
        return (found[-1].u,)

    def back(asked: tuple[bool, ...], g: ndarray) -> list[Any]:
        u = found[0].u
        w, *by = _pulled(operator, u, g, solver)
        u = u.reshape(-1, *operator.shape)
        w = -w.reshape(len(u), *w.shape[-len(operator.shape) :])  # of a rank it may be empty
        slopes = by_numbers(operator, [*compress(named, asked[2:])], u, w)
        held = [one for one in operator.networks if one.requires_grad]
        if held:
            with own_torch():
                force = operator(torch.from_numpy(u))
            held = [*torch.autograd.grad(force, held, torch.from_numpy(w), allow_unused=True)]
        learned = (held.pop(0) if one.requires_grad else None for one in operator.networks)
        return [*by, *(slopes.get(name) for name in named), *learned]

    asked = (p.requires_grad or forward_ad.unpack_dual(p).tangent is not None for p in numbers)
    if operator.is_linear and not any(asked):
        pulled = lambda g: np.stack(_pulled(operator, g, g, solver)[1:])  # noqa: E731
        answer = linear(torch.stack(fields), lambda both: there(*both)[0], pulled)
    else:
        (answer,) = once(there, back, *fields, *numbers)
    return replace(found[0], u=answer.to(given if given.is_floating_point() else answer))


def _rest(operator: Any, b: ndarray, u: ndarray, solver: Any) -> Any:
    """Solution by an operator; of nodes without a collar that of a period."""
    if operator.points.interior.all() and hasattr(operator, "solve_periodic"):
        return operator.solve_periodic(b, solver)
    return operator.solve(b, u, solver)


def _pulled(operator: Any, u: ndarray, g: ndarray, solver: Any) -> Several:
    """Adjoint L′⁻ᵗ g on the interior [..., I, d], L′ at the answer, and derivatives to b and u."""
    one, inside = operator.shape, operator.points.interior
    axis = -len(one)
    with quietly():  # g is no displacement
        if operator.is_symmetric:
            w = np.compress(inside, _rest(operator, g, np.zeros_like(g), solver).u, axis)
        else:
            inner = np.compress(inside, g, axis)
            w = _transposed(operator, u.reshape(-1, *one), inner).reshape(inner.shape)
    return w, operator.on_all(w), (g - operator.vjp(u, w)) * operator.held


def _transposed(operator: Any, fields: ndarray, g: ndarray) -> ndarray:
    """L′⁻ᵗ g of each field on the interior, by factors, or by GMRES of many tangents."""
    right, factors, found = g.reshape(len(fields), -1), None, []
    if hasattr(operator, "transposed"):
        return operator.transposed(right)  # type: ignore[no-any-return]
    many = not operator.is_linear and np.count_nonzero(operator.points.interior) > DIRECT
    steps = (many and hasattr(operator, "inverse")) or not hasattr(operator, "interior_tangent")
    # each field takes some eight inverses, and so many loads may be worth factors
    inverse = operator.inverse(8 * len(fields)) if steps else None
    for field, one in zip(fields, right):
        if inverse is not None:
            found.append(in_steps(operator, field, one.reshape(-1, field.shape[-1]), inverse))
        else:
            if factors is None or not operator.is_linear:
                try:
                    factors = splu(sp.csc_matrix(operator.interior_tangent(field)))
                except RuntimeError as error:
                    raise InputError(f"solve: {SINGULAR} ({error})") from None
            found.append(factors.solve(np.ascontiguousarray(one), "T"))
    return np.array(found)


def in_steps(operator: Any, u: ndarray, g: ndarray, inverse: Any) -> ndarray:
    """L′⁻ᵗ g on the interior by GMRES, [d I], of one field [N, d] and g [I, d], preconditioned by
    the solid's `inverse`; InputError where L′ is nearly singular."""
    inside = operator.points.interior
    J, M = (
        LinearOperator(2 * (g.size,), matvec=part, dtype=float)
        for part in (
            lambda w: operator.vjp(u, w.reshape(g.shape))[inside].ravel(),
            lambda r: inverse(r.reshape(g.shape), ROUGH).ravel(),
        )
    )
    w, failed = gmres(J, g.ravel(), M=M, rtol=EXACT, restart=KEPT, maxiter=ROUNDS)
    if failed:
        raise InputError(f"solve: {SINGULAR}")
    return np.asarray(w)


@typed
class TorchModule(torch.nn.Module):
    """A material on points as a module of torch: ``module(u)`` is the force, as ``operator(u)``.

    Args:
        material: any, or its operator on these points.
        points: the nodes, N of them.
        options: of the material's `on`.

    Attributes:
        operator: the material on the points.
        lam, mu, alpha, D: parameters of a linear peridynamic solid [stress], [1], [M + 1], as it is
            used on the points.
        t3, tq2, q3: parameters of a third-order solid [stress]; its linear part is held.
        tensors: those of a crystal [stress/length²], [H, d, d].
        networks: of a neural operator, the material itself with its parameters.

    Other materials have no parameters and give the gradient in u alone. Parameters are float64;
    with them the second derivative is refused. Raises InputError as `on`, and for a u that does not
    fit.

    >>> tuple(wp.TorchModule(model, points)(torch.from_numpy(u)).shape)
    (12, 121, 2)
    """

    def __init__(self, material: Any, points: Any, **options: Any) -> None:
        super().__init__()
        self.operator = placed(material, points, verb="TorchModule", **options)
        for name, value in getattr(self.operator, "learnable", {}).items():
            number = torch.tensor(value, dtype=torch.float64)
            self.register_parameter(name, torch.nn.Parameter(number))
        if isinstance(self.operator.model, torch.nn.Module):
            self.networks = self.operator.model

    @uncompiled
    def forward(self, u: torch.Tensor) -> torch.Tensor:
        """The force on the interior nodes [stress/length], [..., I, d] of u [..., N, d]."""
        operator, numbers = self.operator, dict(self.named_parameters(recurse=False))
        if not numbers:
            return operator(u)  # type: ignore[no-any-return]
        u = u if isinstance(u, torch.Tensor) else as_tensor("u", plain("u", u))
        force = on_fields(operator, u, lambda f: operator.force_with_parameters(f, numbers))
        if hasattr(operator.model, "with_parameters"):  # others are made anew, and so checked
            operator.model.with_parameters({n: one.detach().numpy() for n, one in numbers.items()})
        return force


class Swept(OperatorBase):
    """An operator that works on a few samples at once: `size` numbers each, arrays of `parts`."""

    size: int
    parts = 1

    def _swept(self, sweep: Any, *fields: ArrayLike, total: bool = False) -> ndarray:
        """Results of a sweep over fields [S, N, d], a few at once, in their leading shape."""
        given = [self.as_fields(field) for field in fields]
        for each in given:
            check_shape("v or w, along u", each, given[0].shape)
        flat = [each.reshape(-1, *self.shape) for each in given]
        step, count = max(1, MOST // self.size), len(flat[0])
        few = self.size * min(step, count) < FEW * self.parts
        with own_torch(), one_thread(few), np.errstate(all="ignore"):  # run away
            found = [sweep(*(f[n : n + step] for f in flat)) for n in range(0, count, step)]
        if total:
            return np.asarray(np.sum(found, axis=0))
        return in_shape_of(given[0], np.concatenate(found))
