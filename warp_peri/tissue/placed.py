"""A hyperelastic sheet on a lattice: its force, its stress, its stable equilibria."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.points.arrays import checked_fields
from warp_peri.points.samples import PointsLike, Samples, nodes_of
from warp_peri.points.unit_names import check_same
from warp_peri.statics.settings import Newton, Solver, refuse_solver
from warp_peri.statics.solution import Solution
from warp_peri.tissue.equilibrium import Equilibrium, NoEquilibrium, StaticProblem
from warp_peri.tissue.fit_errors import hyperelastic_errors
from warp_peri.tissue.operator import HyperelasticOperator
from warp_peri.tissue.solid import HyperelasticSolid
from warp_peri.tissue.stress import piola_stress
from warp_peri.tissue.stretch_range import warn_beyond


class PlacedSheet:
    """A solid on a lattice.

    Args:
        model: the solid.
        points: a lattice.
        thickness: of every node, shape [N]; an even sheet where none is given.

    Attributes:
        energies: the operator of its dictionary, for any coefficients.

    ``op(u)`` takes u [length], shape [N, 2] or [S, N, 2], and returns minus the internal force
    density on interior nodes. Raises InputError for points that are no lattice, in other units, or
    whose collar is too narrow.
    """

    def __init__(
        self, model: HyperelasticSolid, points: PointsLike, *, thickness: np.ndarray | None = None
    ) -> None:
        self.model, self.points, self.thickness = model, nodes_of(points), thickness
        check_same(model.units, self.points.units)
        self.energies = HyperelasticOperator(model.dictionary, self.points, thickness=thickness)

    def __call__(self, u: Any) -> Any:
        return self.energies.force(u, self.model.coefficients)

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on the interior nodes, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

    def product(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The derivative at u along v, shape [..., I, 2]."""
        everywhere = self.energies.product(u, self.model.coefficients, v)
        return np.asarray(everywhere[..., self.points.interior, :])

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Elastic energy [stress · area], shape [...]."""
        return np.asarray(self.energies.energy(u, self.model.coefficients))

    def stress(self, u: np.ndarray) -> np.ndarray:
        """First Piola–Kirchhoff stress at the interior nodes, shape [..., I, 2, 2]."""
        fields = np.reshape(u, (-1, len(self.points.x), 2))
        c, inside = self.model.coefficients, self.points.interior
        stress = np.stack([piola_stress(self.energies, field, c)[inside] for field in fields])
        return stress if np.ndim(u) == 3 else stress[0]

    def errors(self, samples: Samples) -> dict[str, Any]:
        """For `evaluate`: as hyperelastic_errors, samples that are not solved told apart."""
        return hyperelastic_errors(self.model, samples, operator=self.energies)

    def rest(self, b: ArrayLike | None, u: ArrayLike, solver: Solver = None) -> Solution:
        """The stable equilibrium under a load, displacement given on the collar.

        Args:
            b: body force [stress/length], shape [N, 2] or [S, N, 2]; None for no load.
            u: displacement, same shape; read on the collar only.
            solver: Newton(tolerance).

        The details of the solution are an Equilibrium for each sample, with the smallest
        eigenvalue of its tangent. Warns of stretches beyond the data that the solid was learned
        from. Raises NoEquilibrium where none was found, naming the sample; InputError for arrays
        that do not fit.
        """
        refuse_solver(solver, (Newton,), "a hyperelastic solid")
        load, given = checked_fields(self.points, b, u)
        asked = solver if isinstance(solver, Newton) else Newton()
        problem, found = StaticProblem(self.energies, tolerance=asked.tolerance), []
        fields = given.reshape(-1, *given.shape[-2:])
        for number, (force, field) in enumerate(zip(load.reshape(fields.shape), fields)):
            found.append(self._one(problem, number, None if b is None else force, field))
        answer = np.reshape([one.u for one in found], fields.shape)
        warn_beyond(self.model, self.energies, answer)
        return Solution(
            answer.reshape(given.shape),
            self.points,
            self,
            self.load(load),
            "newton",
            tuple(one.iterations for one in found),
            details=tuple(found),
            measured=max((one.residual for one in found), default=None),
        )

    def _one(
        self, problem: StaticProblem, number: int, b: np.ndarray | None, u: np.ndarray
    ) -> Equilibrium:
        try:
            return problem.solve(self.model.coefficients, b, u)
        except NoEquilibrium as error:
            raise NoEquilibrium(f"sample {number}: {error}") from None
