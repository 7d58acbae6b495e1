"""Nonlinear solids of third order on a lattice: force, tangent, energy, stress and equilibria."""

from __future__ import annotations

import warnings
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.models.nonlinear import NonlinearModel, energy_density
from warp_peri.operator.lps import NodeOperator
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.operator.nonlinear import NonlinearOperator
from warp_peri.operator.stress import node_fields
from warp_peri.points.arrays import checked_fields
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.stability.solvability import smallest_eigenvalue
from warp_peri.statics.equilibria import (
    SOLVES,
    Equilibria,
    figures_of,
    solve_each,
    warn_beyond,
)
from warp_peri.statics.equilibrium import lps_linear
from warp_peri.statics.linear import DIRECT, Inverse
from warp_peri.statics.lps import bonds_within, linear_energy
from warp_peri.statics.settings import Newton, Solver, refuse_solver
from warp_peri.statics.solution import Solution
from warp_peri.transfer.nonlinear import nonlinear_for


class PlacedThirdOrder(NonlinearOperator):
    """A nonlinear solid on a lattice, its linear part transferred where need be.

    Args:
        model: certified on some lattice.
        points: a lattice.
        transfer: False refuses lattices that the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.

    ``op(u)`` is that of NonlinearOperator. Raises InputError for scattered points and an
    uncertified spacing.
    """

    def __init__(
        self,
        model: NonlinearModel,
        points: PointsLike,
        *,
        transfer: bool = True,
        allow_uncertified: bool = False,
    ) -> None:
        asked = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        here = nonlinear_for(model, points, **asked)
        self.home, self.points = model, nodes_of(points)
        with warnings.catch_warnings():  # said once, above
            warnings.filterwarnings("ignore", message="spacing: the model is certified")
            super().__init__(here, points, allow_uncertified=allow_uncertified)

    @cached_property
    def straight(self) -> NodeOperator:
        """The linear part alone."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="spacing: the model is certified")
            return NodeOperator(self.model.linear, self.points, allow_uncertified=True)

    def clipped(self, radius: float) -> NonlinearOperator:
        """The same with stresses of gradients clipped to a radius (N10)."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="spacing: the model is certified")
            return NonlinearOperator(self.model, self.points, radius=radius, allow_uncertified=True)

    def inverse(self, loads: int) -> Inverse:
        """L_LPS⁻¹ of a load on the interior [I, 2], to a relative residual."""
        linear = self.model.linear
        nodes = on_nominal_lattice(linear, self.points)
        bonds = bonds_within(linear.horizon, nodes.spacing)
        at_rest = lps_linear(nodes, linear.solid, linear.horizon)
        return at_rest.cheapest_inverse(SOLVES * loads, bonds)

    def figures(self, solution: Solution) -> dict[str, Any]:
        """What solves took, and whether their answers are the only ones, for `evaluate`."""
        return figures_of(solution.details)

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on the interior nodes, which the operator equals in equilibrium."""
        return np.compress(self.points.interior, np.asarray(b, dtype=float), axis=-2)

    def product(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The derivative at u along v, shape [..., I, 2]."""
        fields, along = (np.reshape(field, (-1, *self.points.x.shape)) for field in (u, v))
        rates = [self.tangent(f) @ np.ravel(a) for f, a in zip(fields, along, strict=True)]
        return np.reshape(rates, (*np.shape(u)[:-2], -1, 2))

    def energy(self, u: np.ndarray) -> np.ndarray | None:
        """Of the linear solid, and h² Σ Ψ(H) (N1) [stress · area]; None for the filtered form."""
        if self.model.smoothing is not None:
            return None
        H, _ = self.gradients(u)
        own = energy_density(H, self.numbers.numpy()).sum(axis=-1)
        linear = linear_energy(self.straight, self.points, u)
        return np.asarray(linear + self.points.spacing**2 * own)

    def stress(self, u: np.ndarray) -> np.ndarray:
        """σ of the linear solid and P of Ψ [TPa] at the interior nodes, [..., I, 2, 2] (N2)."""
        _, P = self.gradients(u)
        linear = node_fields(self.model.linear, self.points, u).stress
        linear = linear if np.ndim(u) == 3 else linear[0]
        return np.asarray(linear + P[..., self.points.interior[self.sweeps.full], :, :])

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar.

        Args:
            b: body force density [TPa/Å], shape [N, 2] or [S, N, 2]; only interior values count.
            u: displacement [Å], same shape; only collar values count.
            solver: Newton(…).

        A UserWarning says where |H| exceeds the proven strain, so that another solution is not
        ruled out. The details of the solution are one NonlinearRecord for each sample.

        Raises InputError for arrays that do not fit, and a sample for which no equilibrium was
        found.
        """
        refuse_solver(solver, (Newton,), "a nonlinear solid")
        asked = solver if isinstance(solver, Newton) else Newton()
        load, field = checked_fields(self.points, b, u)
        inside, nodes = self.points.interior, len(self.points.x)
        answers = field.reshape(-1, nodes, 2)
        proven = self.model.proven_strain(self.points.spacing)
        clipped = (lambda: self.clipped(proven)) if proven > 0 else None
        inverse = self.inverse(len(answers))
        way = Equilibria(self, self.straight, inverse, inside, clipped)
        few = asked.eigenvalues and np.count_nonzero(inside) <= DIRECT
        smallest = partial(smallest_tangent, self) if few else None
        loads, largest = load.reshape(-1, nodes, 2)[:, inside], self.largest_gradient
        records, sure = solve_each(way, loads, answers, asked.tolerance, proven, largest, smallest)
        warn_beyond(records, proven)
        return Solution(
            answers.reshape(field.shape),
            self.points,
            self,
            self.load(load),
            records[0].method if len({r.method for r in records}) == 1 else "fixed point, newton",
            tuple(record.solves for record in records),
            sure,
            details=tuple(records),
            measured=max((record.residual for record in records), default=None),
        )


def smallest_tangent(operator: NonlinearOperator, field: np.ndarray) -> float:
    """Smallest eigenvalue of the symmetric part of the tangent on the unknowns [TPa/Å²]."""
    tangent = _unknown_columns(operator, operator.tangent(field))
    return smallest_eigenvalue(sp.csc_array((tangent + tangent.T) / 2))


def _unknown_columns(operator: NonlinearOperator, matrix: sp.csr_array) -> sp.csr_array:
    rows = operator.sweeps.rows
    return sp.csr_array(matrix.tocsc()[:, np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()])
