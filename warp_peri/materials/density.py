"""Materials from a user's energy density: a torch function of the strain with named parameters."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import inv, norm, qr, svd
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from warp_peri.core.elastic import in_shape_of
from warp_peri.core.pointwise import Pointwise
from warp_peri.core.proof import largest
from warp_peri.core.record import FieldUnits, Length, Record, read_json
from warp_peri.core.stencil import half_ball
from warp_peri.core.torch_bridge import own_torch
from warp_peri.errors import InputError, Rows, Values, called, hold
from warp_peri.fitting.long_waves import TOLD
from warp_peri.fitting.regression import norms
from warp_peri.fitting.result import Fit
from warp_peri.materials.crystal_fit import one_set
from warp_peri.points import arguments
from warp_peri.points.arguments import USUAL, Numbers, Pair, Positive, Units, checked, typed
from warp_peri.points.points import PointsLike, check_dimensions
from warp_peri.solvers.equilibria import SOLVES, equilibria_of, probed
from warp_peri.solvers.linear import Inverse, Linear
from warp_peri.solvers.solution import Solution, Solver

Energy = Callable[..., torch.Tensor]
"""Energy per volume [stress] of Green strains E [..., d, d] and of parameters by name, [...]."""
REST = 1e-9
"""Stress at rest, over the stiffness there, that counts as rounding."""
DIFFERENCE, BESIDE = 1e-4, 1e-2
"""Relative step of differences; least size that a number is taken for, over that of its start."""
SHARED = 1e-3
"""Part of a number in a change that data do not tell, from which it is named."""


def sided_gradients(points: Any, horizon: float) -> Pair:
    """Steps [B, d] and weights [2^d, B, d] of least-squares gradients over one corner of the family
    each; all vanish together for rigid fields alone."""
    d, axes = points.dimension, points.lattice.axes
    half = half_ball(horizon / points.spacing, d)
    steps = np.concatenate([0 * half[:1], half, -half])
    xi, weights = points.spacing * steps, []
    for signs in itertools.product((1, -1), repeat=d):
        corner = np.where((steps * signs >= 0).all(axis=1, keepdims=True), xi, 0.0)
        w = corner @ inv(corner.T @ corner)
        w[0] = -w.sum(axis=0)
        weights.append(w @ axes.T)
    return steps, np.array(weights)


@dataclass(frozen=True, eq=False)
class DensityMaterial(Record, format="warp_peri.density"):
    """A material whose energy density is a given function of the Green strain.

    Attributes:
        horizon: of the gradients [length].
        parameters: numbers of the energy, by name, in the units that it was written for.
        dimension: 2 or 3.
        name: of the energy's function.
        energy: W(E, **parameters), E the Green strain [..., d, d]. It is in no file, and no tensor
            that it holds may have a gradient.
        scale: that the energy is of [stress]: 1 in the units that it was written for, which other
            units change while `parameters` stay.
        units: names of the units of length and stress.
        provenance: of the data and the fit; plain JSON values.

    `on` raises InputError for an energy with a stress at rest, or that is not stiff there.

    >>> def shear(E, mu):
    ...     return mu * (E * E).sum((-1, -2))
    >>> wp.DensityMaterial.of(shear, 5.0, {"mu": 0.7}).parameters
    {'mu': 0.7}
    """

    horizon: Length
    parameters: Values
    dimension: int
    name: str
    units: Units = USUAL
    provenance: Values = field(default_factory=dict)
    energy: Annotated[Any, FieldUnits(kept=False)] = None
    scale: Annotated[float, FieldUnits(stress=1, positive=True, omit=True)] = 1.0

    def __post_init__(self) -> None:
        numbers = {n: float(checked(n, one, float, ())) for n, one in self.parameters.items()}
        hold(self, parameters=numbers)
        super().__post_init__()
        check_dimensions("dimension", self.dimension)
        arguments.check_parameters(dict if self.energy is None else self.energy, numbers)

    @classmethod
    def of(
        cls, energy: Energy, horizon: float, parameters: Mapping[str, float], **more: Any
    ) -> Self:
        """Make a material from an energy function, in the plane unless `dimension` is 3."""
        of: Values = {"dimension": 2, "name": _name_of(energy), "energy": energy}
        return cls(horizon, {**parameters}, **of | more)

    certificate = None
    """Nothing is proven of it."""

    def _read_from(self, path: Path | None) -> Self:
        raise InputError(
            f"energy: the file has the parameters of {self.name!r}, whose function is in no file; "
            f"give it: DensityMaterial.read(path, {self.name})"
        )

    @classmethod
    def read(cls, path: Any, energy: Energy) -> Self:
        """Read a material's file with its energy; InputError for another name, and as from_dict."""
        made = cls.from_dict(read_json(path))
        if (name := _name_of(energy)) != made.name:
            raise InputError(f"energy: the file has the parameters of {made.name!r}, got {name!r}")
        return replace(made, energy=energy)

    def rows(self) -> Rows:
        """The summary table of a Record, and the parameters, whose units only the energy knows."""
        return super().rows() + [(name, f"{value:.4g}") for name, value in self.parameters.items()]

    def on(self, points: PointsLike) -> DensityOperator:
        """Build the operator on a lattice whose interior has a collar of twice the horizon."""
        return DensityOperator(self, points)

    def at(self, numbers: Numbers) -> Self:
        """The material with the same energy and other parameters."""
        return replace(self, parameters=self.parameters | {**numbers})

    def proven_strain(self, spacing: Positive) -> float:
        """Strain up to which solutions are proven unique: 0, for nothing is proven."""
        return 0.0


def _name_of(energy: Energy) -> str:
    """Name of a function, or of the class of a callable object."""
    return getattr(energy, "__name__", type(energy).__name__)


class DensityOperator(Pointwise):
    """Operator of a DensityMaterial on a lattice; see Pointwise."""

    def __init__(self, material: DensityMaterial, points: PointsLike) -> None:
        nodes = material.own_nodes(points)
        self.model = self.material = material
        uncompiled = getattr(material.energy, "_torchdynamo_orig_callable", material.energy)
        uncompiled = getattr(uncompiled, "_orig_mod", uncompiled)  # for second derivatives
        what = "energy: expected a function of strains in torch, uncompiled, with derivatives"

        def energy(E: torch.Tensor, **numbers: Any) -> torch.Tensor:
            W = uncompiled(E, **numbers)
            if (got := getattr(W, "shape", type(W).__name__)) != E.shape[:-2]:
                got = got if isinstance(got, str) else list(got)
                raise InputError(
                    f"energy: expected one value a strain, {list(E.shape[:-2])}, got {got}"
                )
            if W.dtype != E.dtype:  # a solve would stop short
                raise InputError(f"{what}, of {E.dtype}, got {W.dtype}")
            return material.scale * W  # type: ignore[no-any-return]

        of = nodes, material.horizon, energy, *sided_gradients(nodes, material.horizon)
        called(what, super().__init__, *of, numbers=material.parameters)
        none = np.zeros((nodes.dimension, nodes.dimension, 1))
        with own_torch():
            if self._energies(none).requires_grad:
                raise InputError(
                    "energy: only parameters have a gradient; write energy.requires_grad_(False) "
                    "of a module, and tensor.detach() of other tensors that it holds"
                )
        stress, stiff = np.abs(self._slopes(none)[0]).max(), np.abs(self.stiffness).max()
        if not stress <= REST * stiff > 0:
            raise InputError(
                f"energy: expected no stress at rest, got {stress:.2e} of a stiffness of "
                f"{stiff:.2e}, and that > 0; subtract its linear part, "
                "and take invariants for eigenvalues, which have no derivatives at rest"
            )

    @cached_property
    def linear(self) -> Linear:
        """The linear operator of the tangent at rest, on the same nodes."""
        return Linear(probed(self), self.points)

    def straight(self, u: ArrayLike) -> ndarray:
        """Force of the tangent at rest, shape [..., I, d]."""
        return in_shape_of(u, self.linear(self.fields(u)))

    def at(self, numbers: Numbers) -> DensityOperator:
        """The operator with other parameters."""
        return DensityOperator(self.material.at(numbers), self.points)

    def max_symbol_eigenvalue(self) -> float:
        """Twice the largest eigenvalue at rest [stress / length²], for steps of small strain."""
        return 2 * largest(self.linear.stencil, np.eye(self.points.dimension, dtype=int)[None])

    def inverse(self, loads: int) -> Inverse:
        """Inverse of the tangent at rest on interior loads: factorised, or by iteration."""
        return self.linear.cheapest_inverse(SOLVES * loads)

    def solve(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar, [N, d] or [S, N, d];
        InputError for arrays that do not fit, and a sample without an equilibrium."""
        return equilibria_of(self, b, u, solver)


def slopes(left: arguments.ArrayMap, x: ndarray) -> ndarray:
    """Derivatives of a function by numbers x [T], [n, T], from both sides, or from one where the
    other has no answer; 0 where neither has."""
    columns = []
    for step in np.diag(DIFFERENCE * np.maximum(np.abs(x), BESIDE)):
        near = ((sign, left(x + sign * step)) for sign in (1, -1, 0))
        ends = [*itertools.islice((end for end in near if np.isfinite(end[1]).all()), 2)]
        (ahead, up), (behind, down) = ends[0], ends[-1]
        columns.append((up - down) / ((ahead - behind or 1) * step.sum()))
    return np.array(columns).T if columns else np.zeros((len(left(x)), 0))


def untold(R: ndarray, first: ndarray) -> ndarray:
    """Which numbers [T] rows R [n, T] do not tell, alone or apart from others. Columns count as
    large as at the `first` numbers, at least: what has become zero by the data is told by them."""
    now = norm(R, axis=0)
    most, before = (size.max(initial=0.0) or 1.0 for size in (now, first))
    R = R / np.where(now > 0, now, 1) * np.maximum(now / most, first / before)
    size, V = svd(qr(R, mode="r"))[1:]
    lost = np.pad(size, (0, len(V) - len(size))) <= TOLD * size.max(initial=0.0)
    return np.asarray((np.abs(V[lost]) > SHARED).any(axis=0))


@typed
@dataclass(frozen=True)
class Density:
    """Settings of a fit of a user's energy density: its parameters are learned.

    Attributes:
        energy: W(E, **parameters) [stress] of Green strains E [..., d, d], in torch, shape [...].
        horizon: of the gradients [length], at least one spacing.
        parameters: where the fit starts, by name.
        loss: "forces" fits L u = b; "displacement" solves for u, for noise or few loads.

    A trial of the search without an equilibrium is a step too long; a number without a slope where
    it starts begins beside it, where that has an answer. `fit` raises InputError for samples
    without loads or displacement, for a start without an answer, and for parameters that they do
    not tell, by name. Its `evaluations` are all forces or solves of the samples, slopes' too.

    >>> def svk(E, lam, mu):
    ...     return lam / 2 * E.diagonal(dim1=-2, dim2=-1).sum(-1) ** 2 + mu * (E * E).sum((-1, -2))
    >>> fit = wp.fit(samples, wp.Density(svk, 5.0, {"lam": 0.1, "mu": 1.0}))
    >>> sorted(fit.material.parameters)
    ['lam', 'mu']
    """

    energy: Energy
    horizon: Positive
    parameters: Mapping[str, float]
    loss: Literal["forces", "displacement"] = "forces"

    def learn(self, samples: Any) -> Fit:
        """Learn the parameters by least squares, each sample over its load or displacement."""
        given = one_set(samples)
        points, inside = given.points, given.interior
        material = DensityMaterial.of(
            self.energy, self.horizon, self.parameters,
            dimension=points.dimension, units=points.units,
        )  # fmt: skip
        operator, names = material.on(points), list(material.parameters)
        by_force = self.loss == "forces"
        right = (given.loads if by_force else given.u)[:, inside]
        size = norms(right)[:, None, None]
        if not (size > 0).all():
            raise InputError(f"samples: expected some that are not zero, got {size.argmin()}")
        if not np.isfinite(force := operator(given.u)).all() and by_force:
            raise InputError("parameters: expected a force on the samples at the start, got NaN")

        def felt(name: str) -> float:
            """Size of a number that changes the force by as much as that is."""
            by = 0.0
            with suppress(InputError):  # of what torch does not differentiate
                by = abs(float(operator.by_numbers(name, given.u, force)))
            return np.vdot(force, force) / by if by else 1.0

        scale = np.array([abs(value) or felt(name) for name, value in material.parameters.items()])

        done = itertools.count()

        def left(x: ndarray) -> ndarray:
            next(done)
            op = operator.at(dict(zip(names, scale * x)))
            found = op(given.u) if by_force else op.solve(given.loads, given.u).u[:, inside]
            return np.pad(((found - right) / size).ravel(), (0, max(0, len(x) - right.size)))

        def tried(x: ndarray) -> ndarray:
            with suppress(InputError):  # a step without an answer is too long
                return left(x)
            return nowhere

        x = np.array([*material.parameters.values()]) / scale
        nowhere = np.nan * left(x)
        known = lru_cache(1)(lambda at: slopes(tried, np.array(at)))  # asked for twice at a start

        def ahead(x: ndarray) -> ndarray:
            return known(tuple(x))

        first = norm(ahead(x), axis=0)
        for step in np.diag(BESIDE * (first <= TOLD * first.max(initial=0.0))):
            sides = (at for at in (x + step, x - step) if step.any())
            x = next((at for at in sides if np.isfinite(tried(at)).all()), x)
        how: Any = {"jac": ahead, "x_scale": "jac", "method": "lm"}
        found = least_squares(tried, x, **how)
        ended = dict(zip(names, (scale * found.x).tolist()))
        if (lost := untold(found.jac * found.x, first)).any():
            those = ", ".join(f"{name} {ended[name]:.4g}" for name in np.array(names)[lost])
            raise InputError(f"parameters: these samples do not tell {those}, or not from there")
        loss = float(np.sqrt(2 * found.cost / len(right)))
        record = {"loss": loss, "by": self.loss, "evaluations": next(done)}
        law = replace(material.at(ended), provenance={"fit": record})
        return Fit(law, None, {}, record)
