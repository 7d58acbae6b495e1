"""The search for a solid from displacement alone: where it stands, its slopes, its steps.

Unknowns are coefficients, directions and exponents of fibres, and numbers of the thickness; (H12)
is their loss, (H13) and (H18) its slopes through the equilibrium.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.points.samples import Samples, seen_of
from warp_peri.tissue.bond_slopes import bond_slopes
from warp_peri.tissue.energy_fit import lower_bounds
from warp_peri.tissue.equilibrium import NoEquilibrium, StaticProblem
from warp_peri.tissue.factors import positive_factors
from warp_peri.tissue.operator import HyperelasticOperator
from warp_peri.tissue.solid import Dictionary, HyperelasticSolid
from warp_peri.tissue.stretch_range import largest_stretch
from warp_peri.tissue.thickness import Thickness

SCALE_WEIGHT = 1e3
"""Of the equation that fixes the initial stiffness, before it is met exactly."""
TURN, GROWTH = 0.2, 1.0
"""Largest change of a fibre's angle [rad] and exponent in one step."""
THICKEN = 0.5
"""Largest change of a number of the thickness in one step."""
LARGEST_EXPONENT = 60.0


@dataclass(frozen=True, eq=False)
class DisplacementFit:
    """A solid known up to its scale.

    Attributes:
        material: with an initial stiffness (H14) of one.
        errors: relative error of the solved displacement of every training frame.
        history: root mean square of those errors after every step.
        frames_left_out: frames whose equilibrium was not found at the start.
        thickness: of the sheet, where it was an unknown.
    """

    material: HyperelasticSolid
    errors: np.ndarray
    history: list[float]
    frames_left_out: list[int]
    thickness: Thickness | None = None


def initial_stiffness(op: HyperelasticOperator) -> np.ndarray:
    """Trace of the second derivative of every energy by the strain at a small stretch, (H14).

    In uniform strain an energy of corners is that of the nodes, whose states are read.
    """
    op = op.with_terms([replace(term, corner=False) for term in op.dictionary.terms])
    traces = np.zeros(len(op.dictionary))
    node = op.interior[0]
    small = 1e-6 * op.points.x
    for number in range(op.dictionary.first_term, len(traces)):
        c = np.zeros(len(traces))
        c[number] = 1.0
        traces[number] = np.trace(op.states(small, c)[2][node][:3, :3])
    count = len(op.dictionary.bonds)
    for k, unit in enumerate(op.unit[: op.bonds.classes]):
        for q in range(count):
            c = np.eye(len(traces))[k * count + q]
            curve = bond_slopes(op.dictionary, np.array([1e-6]), c, np.array([k]))[1][0]
            traces[k * count + q] = curve * (unit @ unit)
    return traces


class Search:
    """Where the search stands: unknowns, solved fields, loss."""

    def __init__(
        self,
        frames: Samples,
        dictionary: Dictionary,
        bounds: tuple[float, float],
        moving: bool,
        thickness: Thickness | None = None,
        *,
        held: bool = False,
    ) -> None:
        self.x, self.thickness, self.held = frames.x, thickness, held
        even = HyperelasticOperator(dictionary, frames)
        self.problem = StaticProblem(even)
        if thickness is not None:
            self.problem = self.problem.with_thickness(thickness.at(self.x))
        self.inner = self.problem.op.interior
        self.data = frames.u
        if not len(self.data):
            raise InputError("frames: expected one or more")
        self.seen = seen_of(frames)[:, self.inner, None]
        inside = self.data[:, self.inner] * self.seen
        self.size = np.linalg.norm(inside.reshape(len(self.data), -1), axis=1)
        if not self.size.all():
            raise InputError(
                f"frames: expected interiors that move, frame {self.size.argmin()} is at rest"
            )
        self.kept = list(range(len(self.data)))
        self.left_out: list[int] = []
        least, greatest = bounds
        self.lower, self.upper = lower_bounds(dictionary, least), np.full(len(dictionary), np.inf)
        deviations = slice(dictionary.first_deviation, dictionary.first_term)
        self.upper[deviations] = max(greatest, least + 1e-9)
        self.measure = initial_stiffness(even)
        if not self.measure.any():
            raise InputError("dictionary: expected an energy with stiffness at rest")
        first = dictionary.first_term
        fibres = [first + n for n, term in enumerate(dictionary.terms) if term.is_fibre]
        self.moving = fibres if moving else []
        self.fields = self.data.copy()
        self.squares = np.full(len(self.data), np.inf)
        self.c = np.zeros(len(dictionary))

    @property
    def loss(self) -> float:
        """Sum of squared relative errors."""
        return float(self.squares[self.kept].sum())

    @property
    def rms(self) -> float:
        """Root mean square of the relative errors."""
        return float(np.sqrt(self.loss / len(self.kept)))

    def scaled(self, c: np.ndarray) -> np.ndarray:
        """The same material with an initial stiffness of one."""
        size = float(self.measure @ c)
        if not size > 0:
            raise InputError("coefficients: expected an initial stiffness > 0")
        return c / size

    def equation_error(self) -> np.ndarray:
        """Coefficients of least internal force on the measured fields; biased under noise."""
        K = len(self.c)
        triangle = np.zeros((0, K))
        for u, seen, size in zip(self.data, self.seen, self.size):
            rows = (self.problem.op.features(u) * seen[..., None]).reshape(-1, K) / size
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))
        weight = SCALE_WEIGHT * np.abs(triangle).max() * self.measure / np.abs(self.measure).max()
        A = np.concatenate([triangle, weight[None]])
        y = np.zeros(len(A))
        y[-1] = SCALE_WEIGHT * np.abs(triangle).max() / np.abs(self.measure).max()
        length = np.linalg.norm(A, axis=0)
        length[length == 0] = 1.0
        least = lsq_linear(A / length, y, (self.lower * length, self.upper * length), method="bvls")
        return self.scaled(least.x / length)

    def descended(
        self, c: np.ndarray, most_steps: int, tolerance: float, progress: bool | str
    ) -> DisplacementFit:
        """The whole search from coefficients c."""
        self.begin(c)
        damping, history = 1e-3, [self.rms]
        name = progress if isinstance(progress, str) else "Gauss-Newton"
        bar = tqdm(range(most_steps), desc=name, disable=not progress, leave=False)
        for _ in bar:
            before = self.loss
            damping = self.step(damping)
            history.append(self.rms)
            bar.set_postfix(error=f"{100 * self.rms:.3f} %")
            if not self.loss < (1 - tolerance) * before:
                break
        op = self.problem.op
        samples = Samples(op.points, self.data)
        solid = HyperelasticSolid(
            op.dictionary,
            self.c,
            op.points.spacing,
            largest_stretch(op, samples.u),
            {"stresses": "scaled to a stiffness of one at rest, no force is known"},
            units=op.points.units,
        )
        return DisplacementFit(solid, np.sqrt(self.squares), history, self.left_out, self.thickness)

    def begin(self, c: np.ndarray) -> None:
        """Solve all frames with the first coefficients; what has no equilibrium is left out."""
        fields, squares = self._solve(self.problem, c)
        self.left_out = [n for n in self.kept if not np.isfinite(squares[n])]
        self.kept = [n for n in self.kept if np.isfinite(squares[n])]
        if not self.kept:
            raise NoEquilibrium("no frame has an equilibrium with the first coefficients")
        self.c, self.fields, self.squares = c, fields, squares

    def _solve(self, problem: StaticProblem, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fields of all kept frames, and their squared relative errors; infinite where none."""
        fields, squares = self.fields.copy(), np.full(len(self.data), np.inf)
        for n in self.kept:
            equilibrium = problem.find(c, None, self.data[n], start=self.fields[n])
            if equilibrium is None:
                if self.squares[n] < np.inf:
                    return fields, squares
                continue
            fields[n] = equilibrium.u
            gap = (equilibrium.u - self.data[n])[self.inner] * self.seen[n]
            squares[n] = (gap**2).sum() / self.size[n] ** 2
        return fields, squares

    def _equations(self) -> tuple[np.ndarray, np.ndarray]:
        """The errors and their derivative by all unknowns in the order of `now`, reduced."""
        op, K = self.problem.op, len(self.c)
        if (pattern := self.problem.pattern) is None:
            raise InputError("problem: expected one whose tangent is factorised")
        triangle = np.zeros((0, len(self.now) + 1))
        for n in self.kept:
            u = self.fields[n]
            factor = positive_factors(pattern.matrix(u, self.c))
            if factor is None:
                continue
            F = [op.features(u).reshape(-1, K)]
            for by in ("angle", "exponent") if self.moving else ():
                slopes = op.features(u, by=by).reshape(-1, K)
                F.append(slopes[:, self.moving] * self.c[self.moving])
            if self.thickness is not None:
                slopes = op.by_thickness(u, self.c, self.thickness.slopes(self.x))
                F.append(slopes.reshape(len(F[0]), -1))
            J = -factor.solve(np.concatenate(F, axis=1)) / self.size[n]
            gap = (u - self.data[n])[self.inner].reshape(-1, 1) / self.size[n]
            rows = np.concatenate([J, gap], axis=1) * np.repeat(self.seen[n], 2, axis=0)
            rows = np.concatenate([triangle, rows])
            triangle = np.asarray(np.linalg.qr(rows, mode="r"))
        return triangle[:, :-1], triangle[:, -1]

    def step(self, damping: float) -> float:
        """One step of Gauss, Newton and Levenberg; the next damping."""
        J, r = self._equations()
        K, now = len(self.c), self.now
        lower, upper = self._bounds(now)
        free: np.ndarray = np.arange(len(now)) >= (K if self.held else 0)
        length = np.linalg.norm(J, axis=0)
        length[length == 0] = 1.0
        fixed = np.zeros((1, len(now)))
        fixed[0, :K] = SCALE_WEIGHT * self.measure / np.abs(self.measure).max()
        for _ in range(8):
            A = np.concatenate([J, np.sqrt(damping) * np.diag(length), fixed]) / length
            y = np.concatenate([J @ now - r, np.sqrt(damping) * length * now, fixed @ now])
            y -= A[:, ~free] @ (now * length)[~free]
            bounds = (lower * length)[free], (upper * length)[free]
            moved = now.copy()
            moved[free] = lsq_linear(A[:, free], y, bounds, method="bvls").x / length[free]
            problem, thickness = self._moved(moved[K:])
            c = self.scaled(np.maximum(moved[:K], 0.0))
            fields, squares = self._solve(problem, c)
            if squares[self.kept].sum() < self.loss:
                self.problem, self.c, self.fields, self.squares = problem, c, fields, squares
                self.thickness = thickness
                return max(damping / 10, 1e-9)
            damping = max(10 * damping, 1e-6)
        return damping

    def _least(self, number: int) -> float:
        term = self.problem.op.dictionary.terms[number - self.problem.op.dictionary.first_term]
        return 2.0 if term.kind == "fibre_power" else 0.0

    @property
    def now(self) -> np.ndarray:
        """Coefficients, angles and exponents of the fibres that move, numbers of the thickness."""
        dictionary = self.problem.op.dictionary
        terms = [dictionary.terms[n - dictionary.first_term] for n in self.moving]
        numbers = np.zeros(0) if self.thickness is None else self.thickness.numbers
        return np.array(
            [*self.c, *(t.angle for t in terms), *(t.exponent for t in terms), *numbers]
        )

    def _bounds(self, now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Between what the unknowns may be after a step."""
        K, M = len(self.c), len(self.moving)
        reach = np.full(len(now), np.inf)
        reach[K : K + M], reach[K + M : K + 2 * M], reach[K + 2 * M :] = TURN, GROWTH, THICKEN
        lower, upper = now - reach, now + reach
        lower[:K], upper[:K] = self.lower, self.upper
        of_exponents = slice(K + M, K + 2 * M)
        lower[of_exponents] = np.maximum(lower[of_exponents], [self._least(n) for n in self.moving])
        upper[of_exponents] = np.minimum(upper[of_exponents], LARGEST_EXPONENT)
        return lower, np.maximum(upper, lower + 1e-12)

    def _moved(self, numbers: np.ndarray) -> tuple[StaticProblem, Thickness | None]:
        """The problem with other angles, exponents and numbers of the thickness."""
        problem, thickness, M = self.problem, self.thickness, len(self.moving)
        if M:
            dictionary = problem.op.dictionary
            terms = list(dictionary.terms)
            for n, angle, exponent in zip(self.moving, numbers[:M], numbers[M : 2 * M]):
                place = n - dictionary.first_term
                terms[place] = replace(terms[place], angle=float(angle), exponent=float(exponent))
            problem = problem.with_terms(terms)
        if thickness is not None:
            thickness = replace(thickness, numbers=numbers[2 * M :])
            problem = problem.with_thickness(thickness.at(self.x))
        return problem, thickness
