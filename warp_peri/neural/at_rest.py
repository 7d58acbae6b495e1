"""A neural operator on a lattice as the contract asks for it: loads, equilibria, errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.neural.equilibrium import NeuralEquilibrium
from warp_peri.neural.evaluation import evaluate
from warp_peri.neural.placed import Placed
from warp_peri.points.arrays import checked_fields
from warp_peri.points.samples import Samples
from warp_peri.statics.settings import Newton, Solver, refuse_solver
from warp_peri.statics.solution import Solution


class AtRest(Placed):
    """Placed, with equilibria by Newton's method."""

    @property
    def model(self) -> Any:
        """The material."""
        return self.material

    def load(self, b: ArrayLike) -> np.ndarray:
        """b on the interior nodes, which the operator equals in equilibrium."""
        loads: np.ndarray = np.asarray(b, dtype=float)[..., self.points.interior, :]
        return loads

    def errors(self, samples: Samples) -> dict[str, Any]:
        """For `evaluate`: samples whose equilibrium is not found are told apart."""
        return evaluate(self.model, samples)

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar, shape [N, 2] or [S, N, 2].

        The details of the solution are what Equilibrium.solve found of each sample. Raises
        InputError for arrays that do not fit or are not finite, and for a sample without an
        equilibrium, naming it.
        """
        refuse_solver(solver, (Newton,), "a neural operator")
        asked = solver if isinstance(solver, Newton) else Newton()
        load, given = checked_fields(self.points, b, u)
        search = NeuralEquilibrium(self)
        pairs = zip(*(np.reshape(f, (-1, *self.points.x.shape)) for f in (load, given)))
        found = [search.from_rest(*pair, tolerance=asked.tolerance) for pair in pairs]
        for number, one in enumerate(found):
            if not one.converged:
                raise InputError(
                    f"sample {number}: no equilibrium was found; residual {one.residual:.1e}"
                )
        return Solution(
            np.reshape([one.u for one in found], given.shape),
            self.points,
            self,
            self.load(load),
            "newton",
            tuple(one.steps for one in found),
            details=tuple(found),
            measured=max((one.residual for one in found), default=None),
        )
