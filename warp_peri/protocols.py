"""Protocols of materials, operators, problems and laws: what each must offer.

Nothing need derive from these. A new law is whatever offers the same, and passes the conformance
test (tests/conformance). `OperatorBase` gives an operator its torch tensors and copies.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from functools import wraps
from inspect import signature
from typing import TYPE_CHECKING, Any, Protocol, Self, overload

import numpy as np
from numpy import ndarray

import warp_peri.core as core
from warp_peri.errors import InputError, Shape, Values, quietly
from warp_peri.points.arguments import (
    Numbers,
    Options,
    Pair,
    Units,
    check_arguments,
    check_flag,
    check_mapping,
    check_shape,
    checked,
    is_piece,
    is_tensor,
    offered,
    plain,
    taken,
)
from warp_peri.points.points import Samples

if TYPE_CHECKING:
    from torch import Tensor

SINGULAR = "expected an equilibrium where the tangent has an inverse, got a singular one, or nearly"


class Operator(Protocol):
    """A material on points: built once, and then used.

    In equilibrium ``op(u)`` equals ``op.rhs(b)``: b itself on the interior nodes, or on scattered
    points a node's share of the load around it.
    """

    model: Any
    """The material's numbers as they are used on these points."""
    points: Any

    def __call__(self, u: Any) -> Any:
        """Minus the internal force density [stress/length] on the interior nodes, [..., I, d]."""

    def rhs(self, b: ndarray) -> ndarray:
        """Right-hand side on the interior nodes for a body force b [..., N, d]; [..., I, d]."""

    def jvp(self, u: ndarray, v: ndarray) -> ndarray:
        """Derivative of the operator at u along v, shape [..., I, d]."""

    def vjp(self, u: ndarray, w: ndarray) -> ndarray:
        """Transposed derivative at u times w [..., I, d], on all nodes [..., N, d]."""

    def energy(self, u: ndarray) -> ndarray | None:
        """Potential, with ∂(energy)/∂u_i = h^d op(u)_i on the interior, up to any part of the
        collar alone; None for a law without."""

    def stress(self, u: ndarray) -> ndarray | None:
        """Stress at the interior nodes, shape [..., I, d, d]; None where a law has none."""

    def solve(self, b: Any, u: Any, solver: Any) -> Any:
        """The Solution in equilibrium with b on the interior, u given on the collar."""


class Remade:
    """Base of values that are copied and pickled by the arguments they were made with."""

    _made_of: tuple[tuple[Any, ...], Values]

    def __new__(cls, *given: Any, **options: Any) -> Self:
        made = super().__new__(cls)
        kept = {name: _kept(value) for name, value in options.items()}
        made._made_of = tuple(map(_kept, given)), kept
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return _remade, (type(self), *self._made_of)


def _kept(value: Any) -> Any:
    """The points of samples; a copy of values that are often changed afterwards."""
    if isinstance(value, ndarray | list | dict):
        with suppress(TypeError):  # of what has no copies, which checks refuse
            return deepcopy(value)
    return value.points if isinstance(value, Samples) else value


def _remade(kind: Callable[..., Any], given: tuple[Any, ...], options: Options) -> Any:
    with quietly():  # said of the first
        return kind(*given, **options)


def uncompiled(call: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function so that torch.compile leaves it as it is."""
    made: list[Callable[..., Any]] = []

    @wraps(call)
    def plainly(*given: Any, **options: Any) -> Any:
        if (compiler := sys.modules.get("torch._dynamo")) is None:
            return call(*given, **options)
        if not made:
            made.append(compiler.disable(call))
        return made[0](*given, **options)

    return plainly


class OperatorBase(Remade):
    """Base of operators: NumPy in, NumPy out; torch in, differentiable torch out.

    ``op(u)`` takes fields on all nodes, [N, d] or [S, N, d], of torch [..., N, d], and gives the
    force on the interior nodes, [..., I, d]. Tensors of another precision than float64, or on
    another device, are computed in float64 on the processor, and so is their gradient. torch's
    first derivative is `vjp`, and `jvp` has the one along a field; the second is right for a linear
    force, of others refused by an InputError.
    """

    is_linear = False
    """Whether the force is linear in u, so that derivatives of any order are had."""
    is_symmetric = False
    """Whether it is linear, and symmetric on the interior: `solve` is then its own adjoint."""
    networks: tuple[Any, ...] = ()
    """Parameters of torch that the material itself holds."""
    points: Any
    force: Callable[[Any], ndarray]
    """The force of fields of NumPy."""

    @property
    def shape(self) -> Shape:
        """Shape of one field, [N, d]."""
        return tuple(self.points.x.shape)

    @overload
    def __call__(self, u: ndarray) -> ndarray: ...
    @overload
    def __call__(self, u: Tensor) -> Tensor: ...
    @uncompiled
    def __call__(self, u: Any) -> Any:
        """Minus the internal force density on the interior; InputError for another shape."""
        return self.force_torch(u) if is_tensor(u) else self.force(u)

    def jvp(self, u: Any, v: Any) -> ndarray:
        """Derivative of the force at u along v, [..., I, d]; the force of v if linear."""
        if u is not None:
            self.as_fields(u)
        return self.force(v)

    def rhs(self, b: Any) -> ndarray:
        """Right-hand side: b on the interior nodes, [..., I, d]."""
        load = checked("b", b, float, (..., *self.shape), ~self.held)
        return np.compress(self.points.interior, load, axis=-len(self.shape))

    def energy(self, u: Any) -> Any:
        """Potential, [...], as Operator's; None where there is none, as here."""

    def stress(self, u: Any) -> Any:
        """Stress at the interior nodes, [..., I, d, d]; None where there is none, as here."""

    def force_torch(self, u: Any) -> Any:
        """Force of a displacement tensor, differentiable."""
        return core.torch_bridge.force_of(self, u)

    def force_with_parameters(self, u: Any, numbers: Any) -> Any:
        """Force of tensors [S, N, d] with other `learnable` numbers, once differentiable in all;
        needs `at(numbers)` and `by_numbers(name, u, w)`."""
        return core.torch_bridge.force_with_parameters(self, u, numbers)

    def solve_torch(self, b: Any, u: Any, solver: Any = None, parameters: Any = None) -> Any:
        """Solve with tensors, differentiable in both and in numbers: core.torch_bridge.at_rest."""
        return core.torch_bridge.at_rest(self, b, u, solver, parameters)

    @property
    def held(self) -> ndarray:
        """Which components of fields are given in a solve, of a shape that broadcasts to [N, d]."""
        return np.asarray(~self.points.interior.reshape(-1, *[1] * (len(self.shape) - 1)))

    def check(self, u: Any, real: bool = True) -> None:
        """Raise InputError for values that are no real fields on the nodes."""
        one, given = self.shape, tuple(u.shape)
        if not real or given[-len(one) :] != one or 0 in given:
            shown = ", ".join(map(str, one))
            raise InputError(
                f"u: expected float64 of shape [S, {shown}], S ≥ 1, or [{shown}], got {u.dtype} of "
                f"shape {list(given)}"
            )

    def fields(self, u: Any) -> ndarray:
        """Convert u to fields of finite numbers, [S, N, d]."""
        return self.as_fields(checked("u", u)).reshape(-1, *self.shape)

    def as_fields(self, u: Any) -> ndarray:
        """Convert u to fields, [..., N, d], whose values may be anything; they may run away."""
        self.check(values := plain("u", u))
        return values

    def quadratic(self, u: Any) -> ndarray:
        """Energy h^d (½ u_I·L u_I + u_I·L u_C) of a linear force on a lattice, shape [...], without
        what the collar alone has."""
        u, held, of = self.as_fields(u), self.held, self.points
        axes = tuple(range(-len(self.shape), 0))
        own, collar = (self.force(np.where(one, u, 0.0)) for one in (~held, held))
        inner = np.compress(of.interior, u, axes[0])
        return np.asarray(of.spacing**of.dimension * (inner * (own / 2 + collar)).sum(axis=axes))

    def of_interior(self, w: Any, u: Any = None) -> ndarray:
        """Check w on the interior nodes, [..., I, d], and a u on all; InputError for others."""
        if u is not None:
            self.as_fields(u)
        values, one = plain("w", w), (int(self.points.interior.sum()), *self.shape[1:])
        if values.shape[-len(one) :] != one or 0 in values.shape[: -len(one)]:
            raise InputError(
                f"w: expected shape [..., {', '.join(map(str, one))}], got {list(values.shape)}"
            )
        return values

    def pairs(self, u: Any, w: Any) -> Pair:
        """Check as many fields u [S, N, d] as w on the interior, [S, I, d]."""
        fields, w = self.as_fields(u).reshape(-1, *self.shape), self.of_interior(w)
        weights = w.reshape(-1, *w.shape[-len(self.shape) :])
        check_shape("w, on u", weights, (len(fields), *weights.shape[1:]))
        return fields, weights

    def on_all(self, w: Any) -> ndarray:
        """Extend fields of the interior nodes [..., I, d] to all by zeros, [..., N, d]."""
        w, rest = self.of_interior(w), len(self.shape)
        fields = np.zeros((*np.shape(w)[:-rest], *self.shape))
        fields[(..., self.points.interior, *[slice(None)] * (rest - 1))] = w
        return fields


def renumbered(own: Numbers, numbers: Numbers) -> Values:
    """Learnable numbers of a material, others in the place of some; InputError for names that it
    has not, and values that `plain` refuses. The material checks what they are."""
    check_mapping("parameters", numbers)
    for name, value in numbers.items():
        if name not in own:
            raise InputError(f"parameters: expected some of {', '.join(own)}, got {name}")
        plain(name, value)
    return {**own, **numbers}


class Material(Protocol):
    """A material: a law with its numbers, which is put on points and saved."""

    @property
    def dimension(self) -> int:
        """Dimension d of the space that the material fills."""

    @property
    def units(self) -> Units:
        """Names of the units of length and stress."""

    @property
    def horizon(self) -> float:
        """Horizon δ [length]."""

    def on(self, points: Any) -> Operator:
        """The material on points: transferred there, certified, with its bonds."""

    def content(self) -> Values:
        """Contents of the material's file; `load` reads it again."""


class Problem(Protocol):
    """A problem on a body: the given values, and how to solve."""

    def solved(self, material: Any, solver: Any, options: Options) -> Any:
        """Solve for a material, or for its operator on the problem's points; returns a Solution."""


class FittableModel(Protocol):
    """Settings of a fit: a family of materials, and how its numbers are learned."""

    @property
    def learn(self) -> Callable[..., Any]:
        """Function of samples and options that returns a Fit: material, certificate, history."""


def refuse_uncut(material: Any, problem: str) -> None:
    """Raise InputError for a law that does not bear cut bonds, in its own words (`uncut`)."""
    if why := getattr(getattr(material, "model", material), "uncut", ""):
        raise InputError(f"solve: the bonds of a {problem} end at its edges, and {why}")


MATERIAL = "a material, as fit(…).material or load(…)"


def check_collar(points: Any) -> None:
    """Raise InputError for points of one process that have no nodes on which u is given."""
    if not is_piece(points) and points.interior.all():
        raise InputError(
            "points: expected nodes on a collar, where u is given; Periodic(…) needs none"
        )


OF_PROOFS = {"transfer": True, "allow_uncertified": False}
"""Options, as they usually are, of solids that are proven on lattices and transferred to others."""


def placed(
    material: Any,
    points: Any,
    *,
    verb: str = "solve",
    by: str = "on",
    has: str = "solve",
    kinds: str = MATERIAL,
    **options: Any,
) -> Any:
    """Operator of a material on points; an operator on these points is returned as it is.

    Args:
        material: that offers `by`, or what came of it and offers `has`.
        points: where it is wanted.
        verb, kinds: for errors, what it was wanted for, and what was expected.
        by, has: names of the contract.
        options: of `by`, which an operator has had.

    Raises InputError for an operator on other points, what is neither, and other options.
    """
    mine, on, known = getattr(material, "points", None), None, Values()
    if mine is not None and hasattr(material, has) and not hasattr(material, by):
        if mine is not points and (what := mine.first_difference(points)):
            raise InputError(
                "operator: expected one on the points of the problem, got another's, which differ "
                f"in {what}"
            )
    else:
        on = offered(material, by, verb, kinds)
        known = dict(signature(on).parameters)
    open_ended = any(one.kind is one.VAR_KEYWORD for one in known.values())
    unknown = {*options} - {*known}
    for name in unknown.intersection(OF_PROOFS):
        check_flag(name, options[name])
        if not open_ended or options[name] == OF_PROOFS[name]:
            del options[name]  # where nothing is transferred, nor has to be certified
    if not open_ended and (others := ", ".join(sorted(unknown.difference(OF_PROOFS)))):
        what = f"{type(material).__name__}{', which is on its points already' * (on is None)}"
        raise InputError(f"{verb}: {others}: not among the options of a {what}")
    return material if on is None else on(points, **check_arguments(on, options))


def options_of(learn: Callable[..., Any], verb: str, options: Options) -> Options:
    """Options of a law's `learn`, checked as by `taken` unless it takes any."""
    if any(one.kind is one.VAR_KEYWORD for one in signature(learn).parameters.values()):
        return options
    return taken(options, verb, learn)[0]
