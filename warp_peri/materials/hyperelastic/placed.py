"""A sheet on points: force, stress, equilibria, errors; stretches beyond what was trained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import warn
from warp_peri.materials.hyperelastic.energies import HyperelasticMaterial
from warp_peri.materials.hyperelastic.equilibrium import (
    NoEquilibriumError,
    StaticProblem,
    TangentPattern,
)
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.points.arguments import typed
from warp_peri.points.arrays import checked_fields
from warp_peri.points.samples import PointsLike, Samples, nodes_of, seen_of
from warp_peri.points.unit_names import check_same
from warp_peri.protocols import OperatorBase
from warp_peri.solvers.solution import Newton, Solution, Solver, refuse_solver

BEYOND = 1.1
"""Stretches less one above this many times those of the training data are worth a warning."""


def largest_stretch(op: HyperelasticOperator, u: np.ndarray) -> float:
    """Largest principal stretch of the nodal strain in fields u [length], shape [..., N, 2]."""
    E = op.strain(u).reshape(-1, 3)
    mean, half = (E[:, 0] + E[:, 1]) / 2, np.hypot((E[:, 0] - E[:, 1]) / 2, E[:, 2] / 2)
    return float(np.sqrt(1 + 2 * (mean + half).max()))


def warn_beyond(solid: HyperelasticMaterial, op: HyperelasticOperator, u: np.ndarray) -> None:
    """Warn when fields are stretched beyond the data that a solid was learned from."""
    if solid.stretch is None or not len(u):
        return
    largest = largest_stretch(op, u)
    if largest - 1 > BEYOND * (solid.stretch - 1):
        warn(
            f"stretch: the fields reach {largest:.4g}, the training data {solid.stretch:.4g}: "
            "nothing is known of the material beyond"
        )


@typed
def evaluate_hyperelastic(
    solid: HyperelasticMaterial,
    samples: Samples,
    *,
    thickness: np.ndarray | None = None,
    operator: HyperelasticOperator | None = None,
    near: np.ndarray | None = None,
) -> dict[str, Any]:
    """Relative ℓ2 errors on the interior, (30) and (31), as means over samples and one by one.

    Args:
        solid: a material, of the same spacing or another.
        samples: with loads or, for E_u alone, without.
        thickness: of every node of the samples, shape [N]; an even sheet where none is given.
        operator: of the solid's dictionary on these samples, where there is one already.
        near: fields of the same points under other loads, shape [M, N, 2]: each search begins at
            their combination that fits its collar best. It begins at rest where none are given.

    Returns:
        E_res where there are loads; E_u over the samples that were solved, not_solved, their
        number, and left_branch, the number of those that (Equilibrium.followed) another branch may
        hold; residuals and displacements with the errors of every sample, NaN where not solved.

    Raises InputError for samples in other units than the solid.

    Warns of solved fields that are stretched beyond the data that the solid was learned from.
    """
    check_same(solid.units, samples.points.units)
    op = operator or HyperelasticOperator(solid.dictionary, samples, thickness=thickness)
    problem, c, loads = StaticProblem(op), solid.coefficients, samples.b
    errors_of: dict[str, Any] = {}
    if loads is not None:
        left = op.force(samples.u, c) - loads[:, op.interior]
        residuals = _size(left) / _size(loads[:, op.interior])
        errors_of = {"E_res": float(residuals.mean()), "residuals": residuals}
    found = []
    for u, b in zip(samples.u, [None] * len(samples) if loads is None else loads):
        start, solved = None if near is None else _combined(problem, near, u), None
        if start is not None and problem.pattern and (factors := problem.factors(c, start)[0]):
            solved = problem.find(c, b, u, start=start, near=factors)
        found.append(solved or problem.find(c, b, u, start=start))
    fields = np.array([one.u if one else np.full_like(op.points.x, np.nan) for one in found])
    gaps, seen = fields.reshape(samples.u.shape) - samples.u, seen_of(samples)[:, op.interior, None]
    errors = _size(gaps[:, op.interior] * seen) / _size(samples.u[:, op.interior] * seen)
    there = [one for one in found if one]
    warn_beyond(solid, op, np.array([one.u for one in there]))
    return errors_of | {
        "E_u": float(np.nanmean(errors)) if there else float("nan"),
        "not_solved": len(found) - len(there),
        "left_branch": sum(not one.followed for one in there),
        "displacements": errors,
    }


def _combined(problem: StaticProblem, near: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The fields that fit u on the collar best, and the harmonic extension of what they miss."""
    collar = ~problem.op.points.interior
    given = near[:, collar].reshape(len(near), -1)
    mixed = np.tensordot(np.linalg.lstsq(given.T, u[collar].ravel(), rcond=None)[0], near, 1)
    return np.asarray(mixed + problem.lift(u - mixed))


def _size(fields: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(fields, axis=(1, 2)))


class HyperelasticSheetOperator(OperatorBase):
    """A solid on a lattice.

    Args:
        model: the solid.
        points: a lattice.
        thickness: of every node, shape [N]; an even sheet where none is given.

    Attributes:
        energies: the operator of its dictionary, for any coefficients.

    Raises InputError for points that are no lattice, in other units, or whose collar is too narrow.
    """

    def __init__(
        self,
        model: HyperelasticMaterial,
        points: PointsLike,
        *,
        thickness: np.ndarray | None = None,
    ) -> None:
        self.model, self.points, self.thickness = model, nodes_of(points), thickness
        check_same(model.units, self.points.units)
        self.energies = HyperelasticOperator(model.dictionary, self.points, thickness=thickness)

    def force(self, u: np.ndarray) -> np.ndarray:
        """Minus the internal force density on interior nodes, shape [..., I, 2]."""
        return self.energies.force(u, self.model.coefficients)

    def jvp(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The derivative at u along v, shape [..., I, 2]."""
        everywhere = self.energies.jvp(u, self.model.coefficients, v)
        return np.asarray(everywhere[..., self.points.interior, :])

    def vjp(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The transposed product, on all nodes [..., N, 2]: that of energies is symmetric."""
        return self.energies.jvp(u, self.model.coefficients, self.on_all(w))

    @property
    def learnable(self) -> dict[str, np.ndarray]:
        """The coefficients of the energies [stress]."""
        return {"coefficients": self.model.coefficients}

    def at(self, numbers: Mapping[str, Any]) -> HyperelasticSheetOperator:
        """The same with other coefficients."""
        model = replace(self.model, coefficients=numbers["coefficients"], provenance={})
        return HyperelasticSheetOperator(model, self.points, thickness=self.thickness)

    def by_numbers(self, name: str, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Derivatives of Σ w · force(u) to the coefficients, of fields [K, N, 2]."""
        return self.energies.pairing(u, w)

    def interior_tangent(self, u: np.ndarray) -> Any:
        """The derivative of the force at a field, between interior nodes, sparse [2 I, 2 I]."""
        op = self.energies.near_interior()
        return TangentPattern(op).matrix(op, u, self.model.coefficients)

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy [stress · area], shape [...]."""
        return self.energies.energy(u, self.model.coefficients)

    def stress(self, u: np.ndarray) -> np.ndarray:
        """First Piola–Kirchhoff stress at the interior nodes, shape [..., I, 2, 2]."""
        return self.energies.stress(u, self.model.coefficients)[..., self.points.interior, :, :]

    def errors(self, samples: Samples) -> dict[str, Any]:
        """For `evaluate`: as evaluate_hyperelastic, samples that are not solved told apart."""
        return evaluate_hyperelastic(self.model, samples, operator=self.energies)

    def solve(self, b: ArrayLike | None, u: ArrayLike, solver: Solver = None) -> Solution:
        """The stable equilibrium under a load, displacement given on the collar.

        Args:
            b: body force [stress/length], shape [N, 2] or [S, N, 2]; None for no load.
            u: displacement, same shape; read on the collar only.
            solver: Newton(tolerance).

        The details of the solution are an Equilibrium for each sample, with the smallest
        eigenvalue of its tangent. Warns of stretches beyond the data that the solid was learned
        from. Raises NoEquilibriumError where none was found, naming the sample; InputError for
        arrays that do not fit.
        """
        refuse_solver(solver, (Newton,), "a hyperelastic solid")
        load, given = checked_fields(self.points, b, u)
        asked = solver if isinstance(solver, Newton) else Newton()
        problem, found = StaticProblem(self.energies, tolerance=asked.tolerance), []
        fields = given.reshape(-1, *given.shape[-2:])
        for number, (force, field) in enumerate(zip(load.reshape(fields.shape), fields)):
            try:
                found.append(problem.solve(self.model.coefficients, force, field))
            except NoEquilibriumError as error:
                raise NoEquilibriumError(f"sample {number}: {error}") from None
        answer = np.reshape([one.u for one in found], fields.shape)
        warn_beyond(self.model, self.energies, answer)
        return Solution(
            answer.reshape(given.shape),
            self.points,
            self,
            self.rhs(load),
            "newton",
            tuple(one.iterations for one in found),
            details=tuple(found),
            measured=max((one.residual for one in found), default=None),
        )
