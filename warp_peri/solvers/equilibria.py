"""Equilibria of one force on one body: mixed steps of the solid at rest, Newton, load increments.

u ← u + L₀⁻¹ (b − f(u)), L₀ the solid at rest, whose inverse is all that is asked of a material
beside its force. The last steps are mixed (D. G. Anderson, 1965). Where that stalls, clipped
gradients make it a contraction if a strain is proven (theory, N13–N15); then Newton's method with
GMRES on the same preconditioned residual; then the load in parts. Of a solid with an energy
Newton's method goes down its potential instead, through tangents that are positive definite; then
the load in parts; then past negative curvature, to another minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.linalg import lstsq
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator

from warp_peri.core.elastic import symmetric_part
from warp_peri.core.stencil import Stencil, stencil_in_box
from warp_peri.errors import InputError, quietly, warn
from warp_peri.points.arguments import ArrayMap, checked_fields
from warp_peri.points.points import Points, grid_places
from warp_peri.solvers.linear import DIRECT, Inverse
from warp_peri.solvers.solution import TOLERANCE, Newton, Solution, Solver, by_sample, refuse_solver
from warp_peri.solvers.systems import HERE, definite, newton, norm, smallest_eigenvalue

NOTHING = 1e-12
"""Relative, of tensors that are rounding."""


def probed(operator: Any) -> Stencil:
    """Stencil at rest of a placed material, along the axes of its nodes, by probing its force,
    which reaches two horizons and is odd in u at rest."""
    nodes = operator.points
    h, axes, d = nodes.spacing, nodes.lattice.axes, nodes.dimension
    reach = 2 * int(operator.material.horizon / h + 1e-6)
    grid = grid_places((4 * reach + 1,) * d) - 2 * reach
    interior = np.abs(grid).max(axis=1) <= reach
    around = Points(h * grid @ axes.T, interior, h, units=nodes.units, axis=nodes.axis)
    placed = operator.material.on(around)
    columns, none = [], np.zeros(grid.shape)
    for axis in axes.T:
        v = none.copy()
        v[len(v) // 2] = axis
        columns.append(-placed.jvp(none, v) @ axes)
    C = np.stack(columns, axis=2)
    C = symmetric_part((C + C[::-1]) / 2)  # ξ and −ξ
    return stencil_in_box(h, C.reshape(*d * (2 * reach + 1,), d, d), NOTHING)


ROUGH, LINEAR_SHARE = 1e-3, 1e-2
"""Iterative linear solves of mixed steps are carried to this, far below what a step leaves; those
of Newton's method, which differences them, to this share of the tolerance."""
NEWTON_SHARE = 1e-2
"""Of the tolerance, to which Newton's method carries the preconditioned residual, over u."""
SOLVES = 2
"""What the solves of mixed steps cost at the least, in whole iterative solves."""
MEMORY = 5
"""Differences that Anderson acceleration mixes."""
MOST_STEPS, PATIENCE = 60, 8
"""Of the fixed point; it is given up after so many steps without a smaller residual."""
LEAST_PART = 1 / 64
"""Of a load and what is given on the collar, that is applied at once where more is too much."""
KRYLOV, MANY = 1e-4, 12
"""Residual that conjugate gradients leave of a step's equation; products that make factors of
another tangent dearer than its own."""
STEPS_DOWN, STEPS_PAST = 15, 60
"""Most of Newton's steps through stable tangents, and past others."""
SHORTEST, DESCENT, NEARER = 1e-4, 1e-4, 0.5
"""Shortest part of a step down; what of its promise it must keep, or by what residuals shrink."""
LINEAR = 1e-5
"""Strain below which what rounding leaves of forces is seen, and answers are in proportion."""
Force = ArrayMap
"""A field of all nodes [N, d] to the force on the interior [I, d]."""


@dataclass
class NonlinearRecord:
    """Record of one sample's nonlinear solve.

    Attributes:
        solves: linear solves in all.
        method: "fixed point", "clipped", "newton" or "parts" of the load, whatever gave the answer.
        residual: ‖L u − b‖ over the linear right-hand side; down a potential, the largest residual
            over the largest force.
        largest_gradient: largest |H| within δ of the unknowns.
        unique: whether |H| stays below the proven strain, so that no other solution does.
        eigenvalue: smallest eigenvalue of the symmetric part of the tangent at the answer
            [stress/length²]; above zero the answer is stable. None where not asked for, and above
            DIRECT nodes.
        converged: whether the residual is within the tolerance.
        followed: whether stable equilibria lead to it from rest along the load, as far as the steps
            tell; false for another minimum, found by going down.
    """

    solves: int = 0
    method: str = "fixed point"
    residual: float = np.inf
    largest_gradient: float = 0.0
    unique: bool = False
    eigenvalue: float | None = None
    converged: bool = True
    followed: bool = True

    @property
    def iterations(self) -> int:
        """Linear solves, which are what a Solution counts."""
        return self.solves


class NoEquilibriumError(InputError):
    """No stable equilibrium was found; the message says how far the load was followed."""


@dataclass(frozen=True, eq=False)
class Equilibria:
    """Solver for the displacements whose force on the interior equals given loads.

    Attributes:
        force: of a field of all nodes.
        straight: the same of the solid at rest.
        inverse: of the solid at rest, of a load on the interior.
        inside: unknown nodes, shape [N] bool.
        clipped: the force with gradients clipped to a proven strain, where one is.
        rounding: smallest residual that is asked for.
    """

    force: Force
    straight: Force
    inverse: Inverse
    inside: ndarray
    clipped: Force | None = None
    rounding: float = 0.0

    def solve(
        self, load: ndarray, given: ndarray, tolerance: float
    ) -> tuple[ndarray, NonlinearRecord]:
        """Displacement u [N, d] with force = load [I, d] and u given elsewhere, on the branch from
        rest; InputError where none is found."""
        record = NonlinearRecord()
        field = np.where(self.inside[:, None], 0.0, given)
        right = load - self.straight(field)
        scale = norm(right)
        if scale == 0:
            record.residual = 0.0
            return field, record

        def part(share: float, guess: ndarray | None) -> ndarray | None:
            if guess is None:
                record.solves += 1
                guess = self.inverse(share * right, ROUGH)
            of_share = share * load, share * field, guess, share * scale
            inner = self._found(*of_share, tolerance, record)
            return inner if record.converged else None

        field[self.inside], done, parts = follow(part)
        if done < 1:
            raise InputError(
                f"no equilibrium was found beyond {done:.0%} of the load, in {record.solves} "
                "linear solves; it may be more than the solid bears"
            )
        if parts > 1:
            record.method = "parts"
        return field, record

    def solve_from(
        self, load: ndarray, start: ndarray, tolerance: float
    ) -> tuple[ndarray, NonlinearRecord]:
        """Displacement from a start [N, d] near it, by Newton's method, with no guarantee; the
        record's residual is relative to that of the start with a zero interior."""
        record, field = NonlinearRecord(method="newton"), start.copy()
        zero = np.where(self.inside[:, None], 0.0, start)
        scale = norm(load - self.force(zero)) or 1.0
        given = load, field, start[self.inside], scale
        field[self.inside] = self._found(*given, tolerance, record, mixes=False)
        return field, record

    def _found(
        self,
        load: ndarray,
        field: ndarray,
        begin: ndarray,
        scale: float,
        tolerance: float,
        record: NonlinearRecord,
        *,
        mixes: bool = True,
    ) -> ndarray:
        """Displacement of the interior, as far as it converges (see the record)."""

        def left(inner: ndarray, force: Force = self.force) -> ndarray:
            field[self.inside] = inner
            with np.errstate(all="ignore"):  # of a step that ran away
                return (load - force(field)) / scale

        def correction(to: float, residual: ndarray) -> ndarray:
            record.solves += 1
            return self.inverse(residual * scale, to)

        tolerance = max(tolerance, self.rounding)
        v, size, rough = begin, np.inf, partial(correction, ROUGH)
        if mixes:
            v, size = anderson(left, rough, begin, tolerance)
            if size > tolerance and self.clipped is not None:
                record.method = "clipped"
                v, _ = anderson(partial(left, force=self.clipped), rough, begin, tolerance)
                size = HERE.norm(left(v))
        if not size <= tolerance:
            record.method = "newton"
            exact = partial(correction, LINEAR_SHARE * tolerance)
            v = newton(lambda w: exact(left(w)), v, NEWTON_SHARE * tolerance * HERE.norm(v))
            size = HERE.norm(left(v))
        record.residual, record.converged = float(size), bool(size <= tolerance)
        return v


def follow(solve: Callable[[float, ndarray | None], ndarray | None]) -> tuple[Any, float, int]:
    """Follow answers of `solve` from a share of zero to one, at once or in steps that halve on
    failure. It is given a share of the load and a guess, and answers None where it fails. Returns
    the last answer, or zero, its share, and the number of steps."""
    done, last, step, steps = 0.0, 0.0, 1.0, 0
    now: Any = 0.0
    before = now
    while done < 1 and step >= LEAST_PART:
        share, guess = min(1.0, done + step), None
        if steps:
            guess = now + (share - done) / (done - last) * (now - before)
        if (found := solve(share, guess)) is None:
            step /= 2
        else:
            before, last, now, done, steps = now, done, found, share, steps + 1
    return now, done, steps


def anderson(
    left: Force, correction: Force, start: ndarray, tolerance: float
) -> tuple[ndarray, float]:
    """Iterate u ← u + correction(left(u)), `left` the relative residual, mixing the last steps (D.
    G. Anderson, 1965). Returns the field of the smallest residual, and its norm."""
    u, best, waited = start, (start, np.inf), 0
    steps, fields = list[ndarray](), list[ndarray]()
    for _ in range(MOST_STEPS):
        residual = left(u)
        size = HERE.norm(residual)
        waited += 1
        if size < best[1]:
            best, waited = (u, size), 0
        if size <= tolerance or waited > PATIENCE or not np.isfinite(size):
            break
        steps.append(correction(residual))
        fields.append(u)
        del steps[: -MEMORY - 1], fields[: -MEMORY - 1]
        u = u + steps[-1]
        if len(steps) > 1:
            by_step, by_field = (
                np.stack([earlier - each[-1] for earlier in each[:-1]], axis=-1)
                for each in (steps, fields)
            )
            flat = by_step.reshape(-1, by_step.shape[-1])
            u = u + (by_step + by_field) @ lstsq(flat, -steps[-1].ravel(), rcond=1e-12)[0]
    return best


Inner = Force
"""What a matrix, or its inverse, makes of the interior [I, d]."""


@dataclass(frozen=True, eq=False)
class Descent:
    """Solver for stable equilibria of an operator with an energy, down its potential.

    Beside a force the operator offers that of `everywhere`, its `nodal_energy`, `folds` of a field,
    `factors` of its tangent, where none are taken a `rough` inverse, and `lift`, a search's start.
    """

    op: Any

    def solve(
        self, load: ndarray, given: ndarray, tolerance: float
    ) -> tuple[ndarray, NonlinearRecord]:
        """Stable displacement u [N, d] with force = load [I, d] and u given on the collar;
        NoEquilibriumError where there is none, a warning where it is not followed from rest."""
        u, record = self.find(load, given, tolerance)
        if not record.converged:
            raise NoEquilibriumError(
                "no stable equilibrium found on the way to all of load and collar"
            )
        if not record.followed:
            warn(
                "the branch of stable equilibria that begins at rest ended before all of load and "
                "collar; what is returned is another minimum, perhaps one of many"
            )
        record.eigenvalue = self.op.smallest_eigenvalue(u)
        if not record.eigenvalue > 0:
            raise NoEquilibriumError(
                f"the equilibrium found is unstable: eigenvalue {record.eigenvalue:.3g}"
            )
        return u, record

    def find(
        self,
        load: ndarray,
        given: ndarray,
        tolerance: float,
        start: ndarray | None = None,
        near: Inner | None = None,
    ) -> tuple[ndarray, NonlinearRecord]:
        """Find an equilibrium, stable as far as the steps tell; the record says if there is one.

        Args:
            load, given: on the interior [I, d]; a field whose collar is given, [N, d].
            tolerance: of the largest residual, over the largest force.
            start: field to begin at; by default the operator's own.
            near: inverse of a tangent near the start, for a first try; negative curvature is then
                looked for by conjugate gradients alone, in a few directions.
        """
        op, record = self.op, NonlinearRecord(method="newton")
        given = np.where(op.points.interior[:, None], 0.0, given)
        if (times := self._too_small(load, given)) > 1:
            start = None if start is None else times * start
            u, record = self.find(times * load, times * given, tolerance, start)
            return u / times, record
        first = op.lift(given) if start is None else start
        answer: Any

        def part(share: float, guess: ndarray | None, **how: Any) -> ndarray | None:
            if guess is None:
                guess = first if share == 1 else op.lift(share * given)
            u = np.where(op.points.interior[:, None], guess, share * given)
            found, steps = self._down(share * load, u, tolerance, **how)
            record.solves += steps
            return found

        if near is None or (answer := part(1.0, first, near=near)) is None:
            answer, done, parts = follow(part)
            record.method = "newton" if parts == 1 else "parts"
            record.followed = done == 1
            for guess in [] if done == 1 else [answer / done, first] if done else [first]:
                if (answer := part(1.0, guess, shifts=True)) is not None:
                    break
        record.converged = answer is not None
        if answer is None:
            return first, record
        left, scale = self._left(load, answer)
        record.residual = float(np.abs(left).max() / scale)
        return answer, record

    def _too_small(self, load: ndarray, given: ndarray) -> float:
        """Factor by which load and collar must grow for strains above rounding; 1 if none."""
        spacing, rest = self.op.points.spacing, 0 * given
        strain = float(np.ptp(self.op.lift(given), axis=0).max()) / spacing
        if load.any() and strain < LINEAR / 2:
            step = self._direction(rest, load, self.op.rough, False)[0]
            strain = max(strain, float(np.abs(step).max()) / spacing)
        return LINEAR / strain if 0 < strain < LINEAR / 2 else 1.0

    def _left(self, load: ndarray, u: ndarray) -> tuple[ndarray, float]:
        """Residual of force and load, and the largest of both."""
        f = self.op.everywhere(u)
        return load - f[self.op.points.interior], max(np.abs(load).max(), np.abs(f).max(), 1e-300)

    def _potential(self, load: ndarray, u: ndarray) -> float:
        """Potential energy of all forces, over the area of a node."""
        return float(self.op.nodal_energy(u).sum() - (load * u[self.op.points.interior]).sum())

    def _down(
        self,
        load: ndarray,
        u: ndarray,
        tolerance: float,
        *,
        near: Inner | None = None,
        shifts: bool = False,
    ) -> tuple[ndarray | None, int]:
        """Minimise the potential down from u; the field, or None, and Newton's steps. Without
        shifts it also ends where the tangent is not positive definite: the branch of stable
        equilibria that u lies near has been left. With the inverse of a tangent `near` none is
        factorised; else the first and the last are, and those that many products tell to be far."""
        given, rough, folds = near is not None, self.op.rough, self.op.folds(u)
        near = near or rough
        for steps in range(STEPS_PAST if shifts else STEPS_DOWN):
            left, scale = self._left(load, u)
            if not (folds < np.inf and np.isfinite(scale)):
                break
            small = np.abs(left).max() <= tolerance * scale
            near = rough if small and not given else near
            step, stable, near = self._direction(u, left, near, shifts)
            if step is None or not (stable or shifts):
                break
            if small and stable:
                return (None if folds else u), steps
            if (ahead := self._searched(load, u, step, left, tolerance * scale, folds)) is None:
                break
            u, folds = ahead
        return None, steps

    def _direction(
        self, u: ndarray, left: ndarray, near: Inner | None, shifts: bool
    ) -> tuple[Any, bool, Inner | None]:
        """Step down, whether the tangent seems positive definite, and its inverse or one near."""
        op, rough = self.op, near is not None and near is self.op.rough
        if near is not None:
            try:
                product = lambda p: op.jvp(u, op.on_all(p))  # noqa: E731
                step, record = definite(product, near, left, KRYLOV)
                return step, True, near if rough or record.iterations <= MANY else None
            except InputError:  # of negative curvature
                if rough:
                    return near(left), False, near
        inverse, stable = op.factors(u, shifts)
        return inverse and inverse(left), stable, None if shifts else inverse

    def _searched(
        self, load: ndarray, u: ndarray, step: ndarray, left: ndarray, small: float,
        folds: float,
    ) -> tuple[ndarray, float] | None:  # fmt: skip
        """Field after the longest part of a step that lowers potential or residual; its folds."""
        before, slope, part = self._potential(load, u), float((left * step).sum()), 1.0
        while part > SHORTEST:
            ahead = u + self.op.on_all(part * step)
            if (turned := self.op.folds(ahead)) <= folds:
                if self._potential(load, ahead) <= before - DESCENT * part * slope:
                    return ahead, turned
                there = self._left(load, ahead)[0]
                nearer = norm(there) < NEARER * norm(left)
                if nearer or np.abs(there).max() < small:
                    return ahead, turned
            part /= 2
        return None


def equilibria_of(
    operator: Any,
    b: ArrayLike | None,
    u: ArrayLike,
    solver: Solver,
    way: Equilibria | Descent | None = None,
    *,
    proven: float | None = None,
) -> Solution:
    """Solve equilibria of a nonlinear operator: b [S, N, d] on the interior, u given on the collar.

    Args:
        operator: that offers products with its tangent, `largest_gradient` if it has one, and
            without a `way` `force(u, radius=)` and, of the solid at rest, `straight` and `inverse`.
        b, u, solver: as of Operator.solve; the solver is a Newton.
        way: solver for a sample; by default Equilibria of the solid at rest.
        proven: |H| up to which answers are unique, 0 for none, warned of beyond; None: not asked.

    The details of the Solution are one NonlinearRecord for each sample. Raises InputError for
    arrays that do not fit, another solver, and a sample for which no equilibrium was found.
    """
    refuse_solver(solver, (Newton,), "a nonlinear solid")
    asked: Any = solver or Newton()
    load, field = checked_fields(operator.points, b, u)
    inside, answers = operator.points.interior, field.reshape(-1, *operator.shape)
    clipped = partial(operator.force, radius=proven) if proven else None
    if way is None:
        inverse = operator.inverse(len(answers))
        way = Equilibria(operator, operator.straight, inverse, inside, clipped)
    gradient = getattr(operator, "largest_gradient", lambda field: 0.0)
    few = asked.eigenvalues and np.count_nonzero(inside) <= DIRECT
    records = []
    for n, (each, right) in enumerate(zip(answers, load.reshape(answers.shape)[:, inside])):
        try:
            each[:], record = way.solve(right, each, asked.tolerance)
        except InputError as error:
            more = ""
            with quietly(), suppress(InputError):
                if asked.tolerance < TOLERANCE and way.solve(right, each, TOLERANCE):
                    more = f"; to {TOLERANCE:g} there is one: rounding may be above the tolerance"
            raise type(error)(f"sample {n}: {error}{more}") from None
        record.largest_gradient = float(gradient(each))
        record.unique = proven is not None and record.largest_gradient <= proven
        if few and record.eigenvalue is None:
            record.eigenvalue = smallest_of(operator, each)
        records.append(record)
    if proven is not None:
        warn_beyond(records, proven)
    sure = proven and all(record.unique for record in records)
    method = ", ".join(sorted({record.method for record in records}))
    told, load = f"no other solution has |H| ≤ {proven:.2%}" if sure else None, operator.rhs(load)
    return by_sample(operator, answers.reshape(field.shape), load, records, method, told)


def smallest_of(operator: Any, field: ndarray) -> float:
    """Smallest eigenvalue of the symmetric part of the tangent at a field, on the unknowns."""
    inside = operator.points.interior
    free = np.count_nonzero(inside), operator.shape[1]

    def product(x: ndarray) -> ndarray:
        w = x.T.reshape(-1, *free)
        u = np.broadcast_to(field, (len(w), *operator.shape))
        both = operator.jvp(u, operator.on_all(w)) + operator.vjp(u, w)[:, inside]
        return np.asarray(both.reshape(x.T.shape).T / 2)

    shape = 2 * (free[0] * free[1],)
    return smallest_eigenvalue(LinearOperator(shape, product, matmat=product, dtype=float))


def warn_beyond(records: list[NonlinearRecord], proven: float) -> None:
    """Warn where answers go beyond the proven strain."""
    if not (beyond := sum(not record.unique for record in records)):
        return
    largest = max(record.largest_gradient for record in records)
    known = f"|H| = {proven:.2%}" if proven > 0 else "no strain, for want of a certificate"
    warn(
        f"strain: solutions are proven unique up to {known}; {beyond} of {len(records)} "
        f"samples go beyond it, to {largest:.2%}, where others may exist"
    )
