"""Equilibrium of nonlinear solids: the linear solve repeated, Newton where that does not do.

u ← u + L_LPS⁻¹ (b − L u), Anderson accelerated. Where it stalls, the same iteration with clipped
gradients, which a proven strain makes a contraction (theory.md, N13–N15), then Newton–Krylov with a
line search on the equation preconditioned by L_LPS⁻¹.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.optimize import NoConvergence, newton_krylov

from warp_peri.errors import InputError
from warp_peri.models.nonlinear import NonlinearModel, energy_density
from warp_peri.operator.lps import NodeOperator
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.operator.nonlinear import NonlinearOperator
from warp_peri.operator.stress import node_fields
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.stability.solvability import smallest_eigenvalue
from warp_peri.statics.direct import factorised
from warp_peri.statics.equilibrium import lps_linear
from warp_peri.statics.linear import Inverse
from warp_peri.statics.lps import bonds_within, checked_fields, choose_method, linear_energy
from warp_peri.statics.settings import Newton, Solver, refuse_solver
from warp_peri.statics.solution import Solution
from warp_peri.transfer.nonlinear import nonlinear_for

ROUGH, LINEAR_SHARE = 1e-3, 1e-2
"""Iterative linear solves of the fixed point are carried to this, far below what a step of it
leaves; those of Newton's method, which differences them, to this share of the tolerance."""
DIRECT = 4_000
"""Most unknown nodes whose tangent is factorised."""
SOLVES = 2
"""What the solves of a fixed point cost at the least, in whole iterative solves."""
MEMORY = 5
"""Differences that Anderson acceleration mixes."""
MOST_STEPS, PATIENCE = 60, 8
"""Of the fixed point; it is given up after so many steps without a smaller residual."""
MOST_NEWTON = 40


@dataclass
class NonlinearRecord:
    """What the solve of one sample took, and what is known of its answer.

    Attributes:
        solves: linear solves in all.
        method: "fixed point", "clipped" or "newton", whatever gave the answer.
        residual: ‖L u − b‖ over the linear right-hand side.
        largest_gradient: largest |H| within δ of the unknowns.
        unique: whether |H| stays below the proven strain, so that no other solution does.
        eigenvalue: smallest eigenvalue of the symmetric part of the tangent at the answer
            [TPa/Å²]; above zero the answer is stable. None where not asked for, and above DIRECT
            nodes.
    """

    solves: int = 0
    method: str = "fixed point"
    residual: float = np.inf
    largest_gradient: float = 0.0
    unique: bool = False
    eigenvalue: float | None = None


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
        """L_LPS⁻¹ of a load on the interior; as linear_solver."""
        return linear_solver(self, self.points, loads)

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
        answers, records = field.reshape(-1, nodes, 2), []
        way = _Solver(self, self.points, asked.tolerance, len(answers))
        for number, (force, one) in enumerate(zip(load.reshape(-1, nodes, 2), answers)):
            try:
                one[inside], record = way.solve(force[inside], one)
            except InputError as error:
                raise InputError(f"sample {number}: {error}") from None
            if asked.eigenvalues:
                record.eigenvalue = way.smallest_eigenvalue(one)
            records.append(record)
        proven = self.model.proven_strain(self.points.spacing)
        warn_beyond(records, proven)
        sure = f"no other solution has |H| ≤ {proven:.2%}" if proven > 0 else None
        return Solution(
            answers.reshape(field.shape),
            self.points,
            self,
            self.load(load),
            records[0].method if len({r.method for r in records}) == 1 else "fixed point, newton",
            tuple(record.solves for record in records),
            sure if all(record.unique for record in records) else None,
            details=tuple(records),
            measured=max(record.residual for record in records),
        )


class _Solver:
    """Solves of one model on one point set."""

    def __init__(
        self, operator: PlacedThirdOrder, points: PointsLike, tolerance: float, loads: int
    ) -> None:
        self.operator, self.tolerance, self.inside = operator, tolerance, points.interior
        self.proven = operator.model.proven_strain(points.spacing)
        self.linear = operator.inverse(loads)

    @cached_property
    def clipped(self) -> NonlinearOperator:
        """Placed only where the plain iteration stalls, which few loads ask for."""
        return self.operator.clipped(self.proven)

    def solve(self, load: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, NonlinearRecord]:
        """Displacement of the interior, from the field's collar; the record.

        Raises InputError when nothing finds an equilibrium.
        """
        record = NonlinearRecord()
        field = field.copy()
        field[self.inside] = 0
        right = load - self.operator.straight(field)
        scale = float(np.linalg.norm(right))
        if scale == 0:
            record.residual, record.unique = 0.0, self.proven > 0
            return field[self.inside], record

        def left(operator: NonlinearOperator, inner: np.ndarray) -> np.ndarray:
            field[self.inside] = inner
            unbalanced: np.ndarray = (load - operator(field)) / scale
            return unbalanced

        def correction(residual: np.ndarray, to: float = ROUGH) -> np.ndarray:
            record.solves += 1
            return self.linear(residual * scale, to)

        inner = correction(right / scale)
        inner, record.residual = anderson(
            lambda v: left(self.operator, v), correction, inner, self.tolerance
        )
        if record.residual > self.tolerance and self.proven > 0:
            record.method = "clipped"
            near, _ = anderson(
                lambda v: left(self.clipped, v),
                correction,
                correction(right / scale),
                self.tolerance,
            )
            record.residual = float(np.linalg.norm(left(self.operator, near)))
            inner = near
        if record.residual > self.tolerance:
            record.method = "newton"
            exact = partial(correction, to=LINEAR_SHARE * self.tolerance)
            inner = self._newton(lambda v: left(self.operator, v), exact, inner)
            record.residual = float(np.linalg.norm(left(self.operator, inner)))
        if not record.residual <= self.tolerance:
            raise InputError(
                f"no equilibrium was found: residual {record.residual:.1e} of the right-hand side "
                f"after {record.solves} linear solves; the load may be more than the solid bears"
            )
        field[self.inside] = inner
        record.largest_gradient = float(self.operator.largest_gradient(field))
        record.unique = record.largest_gradient <= self.proven
        return inner, record

    def _newton(
        self,
        left: Callable[[np.ndarray], np.ndarray],
        correction: Callable[[np.ndarray], np.ndarray],
        start: np.ndarray,
    ) -> np.ndarray:
        """Newton–Krylov with a line search on L_LPS⁻¹ (b − L u) = 0, as far as it comes."""
        scale = max(float(np.abs(start).max()), 1e-300)
        try:
            inner = newton_krylov(
                lambda v: correction(left(v * scale)) / scale,
                start / scale,
                f_tol=self.tolerance * 1e-2,
                maxiter=MOST_NEWTON,
                line_search="armijo",
            )
        except NoConvergence as error:
            inner = np.reshape(error.args[0], start.shape)
        except (ValueError, ZeroDivisionError):  # steps that ran away
            return start
        answer: np.ndarray = inner * scale
        return answer

    def smallest_eigenvalue(self, field: np.ndarray) -> float | None:
        """Smallest eigenvalue of the symmetric part of the tangent on the unknowns [TPa/Å²]."""
        if np.count_nonzero(self.inside) > DIRECT:
            return None
        return smallest_tangent(self.operator, field)


def smallest_tangent(operator: NonlinearOperator, field: np.ndarray) -> float:
    """Smallest eigenvalue of the symmetric part of the tangent on the unknowns [TPa/Å²]."""
    tangent = _unknown_columns(operator, operator.tangent(field))
    return smallest_eigenvalue(sp.csc_array((tangent + tangent.T) / 2))


def anderson(
    left: Callable[[np.ndarray], np.ndarray],
    correction: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    tolerance: float,
    *,
    norm: Callable[[np.ndarray], float] = lambda field: float(np.linalg.norm(field)),
    fitted: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda differences, step: (
        np.linalg.lstsq(differences.reshape(-1, differences.shape[-1]), -step.ravel(), rcond=1e-12)[
            0
        ]
    ),
) -> tuple[np.ndarray, float]:
    """u ← u + correction(left(u)), accelerated by mixing the last steps (D. G. Anderson, 1965).

    Args:
        left: residual of a field, relative.
        correction: the step that answers a residual.
        start: a field.
        tolerance: of the residual's norm.
        norm: of a field.
        fitted: how much of differences [..., k] comes closest to minus a step, shape [k].

    Returns:
        The field of the smallest residual, and that residual's norm.
    """
    u, best = start, (start, np.inf)
    steps: list[np.ndarray] = []
    fields: list[np.ndarray] = []
    waited = 0
    for _ in range(MOST_STEPS):
        residual = left(u)
        size = norm(residual)
        waited = 0 if size < best[1] else waited + 1
        if size < best[1]:
            best = (u, size)
        if size <= tolerance or waited > PATIENCE or not np.isfinite(size):
            break
        steps.append(correction(residual))
        fields.append(u)
        del steps[: -MEMORY - 1], fields[: -MEMORY - 1]
        u = u + steps[-1]
        if len(steps) > 1:
            by_step = np.stack([earlier - steps[-1] for earlier in steps[:-1]], axis=-1)
            by_field = np.stack([earlier - fields[-1] for earlier in fields[:-1]], axis=-1)
            u = u + (by_step + by_field) @ fitted(by_step, steps[-1])
    return best


def linear_solver(operator: NonlinearOperator, points: PointsLike, loads: int) -> Inverse:
    """L_LPS⁻¹ of a load on the interior [I, 2], to a relative residual: factorised, or iterated.

    `loads` is the number of samples it is for. Raises InputError for a linear part that is not
    positive definite.
    """
    nodes = on_nominal_lattice(operator.model.linear, points)
    bonds = bonds_within(operator.model.linear.horizon, nodes.spacing)
    method = choose_method(nodes, plain=True, loads=SOLVES * loads, bonds=bonds)
    if method == "lu":
        return factorised_tangent(operator)
    linear = operator.model.linear
    try:
        return lps_linear(nodes, linear.solid, linear.horizon).definite_inverse(method)
    except InputError:  # the symbol does not prove every definite operator so
        if np.count_nonzero(nodes.interior) > DIRECT:
            raise
        return factorised_tangent(operator)


def factorised_tangent(operator: NonlinearOperator) -> Inverse:
    """The inverse of the tangent at rest on the interior."""
    tangent = operator.tangent(np.zeros((operator.sweeps.nodes, 2)))
    factors = factorised(sp.csc_array(_unknown_columns(operator, tangent)))
    return lambda right, tolerance: factors.solve(right.ravel()).reshape(-1, 2)


def _unknown_columns(operator: NonlinearOperator, matrix: sp.csr_array) -> sp.csr_array:
    rows = operator.sweeps.rows
    return sp.csr_array(matrix.tocsc()[:, np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()])


def figures_of(records: tuple[NonlinearRecord, ...]) -> dict[str, Any]:
    """Most solves, largest gradient, and whether all answers are the only ones."""
    return {
        "linear_solves": max(record.solves for record in records),
        "largest_gradient": max(record.largest_gradient for record in records),
        "unique": all(record.unique for record in records),
    }


def warn_beyond(records: list[NonlinearRecord], proven: float) -> None:
    """A UserWarning where answers go beyond the proven strain."""
    beyond = [n for n, record in enumerate(records) if not record.unique]
    if not beyond:
        return
    largest = max(record.largest_gradient for record in records)
    known = f"|H| = {proven:.2%}" if proven > 0 else "no strain, for want of a certificate"
    warnings.warn(
        f"strain: solutions are proven unique up to {known}; {len(beyond)} of {len(records)} "
        f"samples go beyond it, to {largest:.2%}, where others may exist",
        stacklevel=3,
    )
