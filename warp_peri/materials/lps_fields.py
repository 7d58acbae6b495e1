"""Linear solids whose λ and μ differ from node to node: a force state has those of its node."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.core.proof import largest
from warp_peri.errors import InputError
from warp_peri.lps.model import Model, Solid
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.points.arrays import checked
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.statics.conjugate_gradients import definite
from warp_peri.statics.direct import definite_factors
from warp_peri.statics.linear import Inverse, Linear, Solved
from warp_peri.statics.lps import lps_linear
from warp_peri.statics.solution import Solver

Modulus = ArrayLike | Callable[[np.ndarray], ArrayLike]
AVERAGED = 8
"""Positions along the radius of the ball that a function is averaged over."""


class FieldOperator(LPSOperator):
    """A linear solid of which λ and μ are one value a node.

    Its energy is the sum of those of all nodes, each with its own moduli, and positive where K is
    (of a K that changes sign nothing is proven). At an interface displacements are of first order
    in δ. Lattices are solved by conjugate gradients, before which stands the solid of mean moduli.

    Args:
        model: its α, D and horizon, and λ or μ where no field of it is given.
        points: nodes x.
        lam, mu: numbers, one value a node, shape [N], or functions of x [N, d], of which
            λ + 2μ/d and μ are averaged harmonically over a ball of δ/2 around each node.
        options: of LPSOperator.

    Raises InputError as LPSOperator does, and for moduli that do not fit or are not positive.
    """

    def __init__(
        self,
        model: Model,
        points: PointsLike,
        *,
        lam: Modulus | None = None,
        mu: Modulus | None = None,
        **options: Any,
    ) -> None:
        given = (model.lam if lam is None else lam), (model.mu if mu is None else mu)
        self._moduli = moduli_on(nodes_of(points), model.horizon, *given)
        super().__init__(model, points, **({"lazy": True} | options))

    @property
    def moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """λ and μ of each node [TPa], shape [N] each."""
        return self._moduli

    @property
    def learnable(self) -> dict[str, Any]:
        """λ, μ, α and D by name."""
        return self.model.learnable | dict(zip(("lam", "mu"), self.moduli))

    def at(self, numbers: Mapping[str, Any]) -> FieldOperator:
        """The same with other fields and numbers."""
        shape = {name: numbers[name] for name in ("alpha", "D") if name in numbers}
        fields = dict(zip(("lam", "mu"), self.moduli)) | dict(numbers)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # said of this one
            made = FieldOperator(
                self.model.having(shape), self.points, lam=fields["lam"], mu=fields["mu"],
                allow_uncertified=True, device=self.device,
            )  # fmt: skip
        made.__dict__["bonds"] = self.bonds
        return made

    @cached_property
    def linear(self) -> Linear:
        """The stencil of the solid of mean moduli."""
        lam, mu = (one.mean() for one in self.moduli)
        mean = Solid(lam, mu, self.model.alpha, self.model.D)
        return lps_linear(self.nodes, mean, self.model.horizon)

    @property
    def proven(self) -> None:
        """Nothing: what is proven of the model is so of moduli that are numbers."""

    def stiffest_wave(self) -> float:
        """A bound on the eigenvalues of L [stress/length²], for time steps: of the solid of mean
        moduli, times how much stiffer a node is.

        Raises InputError for a K that changes sign, of which that is not so.
        """
        if (self.bonds.influence(self.model.alpha, self.model.D) < 0).any():
            raise InputError("move: expected K W ≥ 0 for moduli as fields, got one below zero")
        lam, mu = self.moduli
        parts = mu, lam + 2 * mu / self.nodes.dimension
        stiffer = max(one.max() / one.mean() for one in parts)
        return float(stiffer * largest(self.linear.stencil, self.model.group))

    def rest_periodic(self, b: ArrayLike, solver: Solver = None) -> Any:
        """Refused: a period has no mean solid that its own inverse stands before."""
        raise InputError("points: expected nodes with a collar for moduli as fields, got a period")

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of what the operator equals on the interior [I, d], to a relative residual."""
        if not self.nodes.is_plain_lattice:
            return super().inverse(loads)
        return lambda right, tolerance: self._descended(right, tolerance, None)[0]

    def _factorised(self, load: np.ndarray, u: np.ndarray, method: str, degree: int) -> np.ndarray:
        if (
            self.nodes.is_plain_lattice
            and definite_factors(self._problem(degree).stiffness) is None
        ):
            raise InputError("lambda, mu: expected a positive definite operator, got another")
        return super()._factorised(load, u, method, degree)

    def _descended(
        self, right: np.ndarray, tolerance: float, method: str | None
    ) -> tuple[np.ndarray, Any]:
        """L_II⁻¹ of a field on the interior [I, d], and its record."""
        grid, method = self.linear.grid, self.linear.method(method)

        def product(planes: np.ndarray) -> np.ndarray:
            return grid.scatter_interior(self.force(self.on_all(grid.gather(planes[None])[0])))

        where = f" on these {len(right)} nodes"
        planes, record = definite(
            product,
            self.linear.filter(method),
            grid.scatter_interior(right),
            tolerance,
            where=where,
        )
        took = Solved(record.iterations, record.residual, method)
        return grid.gather(planes[None])[0], took

    def _iterated(
        self, load: np.ndarray, u: np.ndarray, method: str, solver: Solver, records: list[Any]
    ) -> np.ndarray:
        tolerance = getattr(solver, "tolerance", self._unasked().tolerance)
        inside, answer = self.nodes.interior, u.copy()
        answer[:, inside] = 0
        for one, field in zip(load, answer):
            found, took = self._descended(one[inside] - self.force(field), tolerance, method)
            field[inside] = found
            records.append(took)
        return answer


def moduli_on(
    nodes: Points, horizon: float, lam: Modulus, mu: Modulus
) -> tuple[np.ndarray, np.ndarray]:
    """λ and μ of each node, shape [N] each, of numbers, fields or functions of position.

    Raises InputError for others than one a node, and where μ > 0 and λ + 2μ/d > 0 do not hold.
    """
    x, d = nodes.x, nodes.dimension

    def at(value: Modulus, name: str, places: np.ndarray) -> np.ndarray:
        given = checked(name, value(places) if callable(value) else value)
        if given.shape not in ((), (len(x),)):
            raise InputError(
                f"{name}: expected a number, a function, or shape [{len(x)}], got "
                f"{list(given.shape)}"
            )
        return np.broadcast_to(given, len(x)).astype(float)

    def both(places: np.ndarray) -> list[np.ndarray]:
        first, second = at(lam, "lambda", places), at(mu, "mu", places)
        stiff = [second, first + 2 * second / d]
        if not all((one > 0).all() for one in stiff):
            raise InputError("lambda, mu: expected μ > 0 and λ + 2μ/d > 0 at every node")
        return stiff

    shear, bulk = both(x)
    if callable(lam) or callable(mu):
        steps = (np.indices((2 * AVERAGED + 1,) * d).reshape(d, -1).T - AVERAGED) / AVERAGED
        ball = steps[(steps**2).sum(axis=1) <= 1] * horizon / 2
        shear, bulk = 1 / np.mean([[1 / one for one in both(x + step)] for step in ball], axis=0)
    return bulk - 2 * shear / d, shear
