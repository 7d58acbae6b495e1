"""A hyperelastic solid from displacement alone: no load is known, so only ratios can be learned.

The loss is the error of the solved displacement, (H12); its derivatives go through the equilibrium
(H13), and every step is a linear least-squares problem with signs. Coefficients are scaled to an
initial stiffness of one; a known force sets the scale afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.learning.energy_fit import largest_stretch, lower_bounds
from warp_peri.models.hyperelastic import Dictionary, HyperelasticSolid
from warp_peri.operator.hyperelastic import HyperelasticOperator
from warp_peri.operator.hyperelastic_stress import piola_stress
from warp_peri.points.samples import Samples
from warp_peri.stability.positive import positive_factors
from warp_peri.statics.large_deformation import NoEquilibrium, StaticProblem

SCALE_WEIGHT = 1e3
"""Of the equation that fixes the initial stiffness, before it is met exactly."""
TURN, GROWTH = 0.2, 1.0
"""Largest change of a fibre's angle [rad] and exponent in one step."""
LARGEST_EXPONENT = 60.0
AFFINE = 1e-6
"""A set of frames whose distance from affine displacement is below this fraction says nothing."""


@dataclass(frozen=True, eq=False)
class DisplacementFit:
    """A solid known up to its scale.

    Attributes:
        solid: with an initial stiffness (H14) of one.
        errors: relative error of the solved displacement of every training frame.
        history: root mean square of those errors after every step.
        frames_left_out: frames whose equilibrium was not found at the start.
    """

    solid: HyperelasticSolid
    errors: np.ndarray
    history: list[float]
    frames_left_out: list[int]


def fit_displacement(
    frames: Samples,
    dictionary: Dictionary,
    *,
    stiffness: float = 0.05,
    moving: bool = False,
    start: np.ndarray | None = None,
    most_steps: int = 15,
    tolerance: float = 1e-4,
    progress: bool = False,
) -> DisplacementFit:
    """Learn from displacement on a lattice whose collar is data and whose interior carries no load.

    Args:
        frames: samples without loads.
        dictionary: energies that are safe with coefficients ≥ 0.
        stiffness: least coefficient of the deviations, in units of the initial stiffness.
        moving: whether angles and exponents of fibres are unknowns too.
        start: coefficients to begin with, shape [K]; those of least equation error where none.
        most_steps: of Gauss and Newton.
        tolerance: ends when a step lowers the loss by less than this fraction.
        progress: show a bar on stderr.

    Raises InputError for frames with loads, affine frames, or energies that guarantee nothing.
    """
    if frames.b is not None and np.any(frames.b[:, frames.interior]):
        raise InputError("frames: expected no load on the interior; with loads use fit_energy")
    if not dictionary.guaranteed:
        raise InputError(
            "dictionary: expected energies that are convex and stress-free at rest only"
        )
    check_identifiable(frames)
    path = _Path(frames, dictionary, stiffness, moving)
    c = path.equation_error() if start is None else path.scaled(np.maximum(start, path.lower))
    path.begin(c)
    damping, history = 1e-3, [path.rms]
    bar = tqdm(range(most_steps), desc="Gauss-Newton", disable=not progress, leave=False)
    for _ in bar:
        before = path.loss
        damping = path.step(damping)
        history.append(path.rms)
        bar.set_postfix(error=f"{100 * path.rms:.3f} %")
        if not path.loss < (1 - tolerance) * before:
            break
    op = path.problem.op
    solid = HyperelasticSolid(
        op.dictionary, path.c, frames.spacing, stretch=largest_stretch(op, frames)
    )
    return DisplacementFit(solid, np.sqrt(path.squares), history, path.left_out)


def check_identifiable(frames: Samples) -> None:
    """Raise InputError where every frame is affine: any homogeneous body could have moved so."""
    design = np.concatenate([np.ones((len(frames.x), 1)), frames.x], axis=1)
    bent = 0.0
    for u in frames.u:
        rest = u - design @ np.linalg.lstsq(design, u, rcond=None)[0]
        size = float(np.linalg.norm(u))
        bent = max(bent, float(np.linalg.norm(rest)) / size if size > 0 else 0.0)
    if len(frames) == 0 or bent < AFFINE:
        raise InputError(
            "frames: expected displacement that is not affine; a homogeneous body of any material "
            "follows affine edges, so that such frames say nothing about it"
        )


def initial_stiffness(op: HyperelasticOperator) -> np.ndarray:
    """Trace of the second derivative of every energy by the strain at a small stretch, (H14)."""
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
            curve = op.bond_slopes(np.array([1e-6]), c, np.array([k]))[1][0]
            traces[k * count + q] = curve * (unit @ unit)
    return traces


class _Path:
    """Where the search stands: coefficients, solved fields, loss."""

    def __init__(
        self, frames: Samples, dictionary: Dictionary, stiffness: float, moving: bool
    ) -> None:
        self.problem = StaticProblem(HyperelasticOperator(dictionary, frames))
        self.inner = self.problem.op.interior
        self.data = frames.u
        self.size = np.linalg.norm(self.data[:, self.inner].reshape(len(self.data), -1), axis=1)
        self.kept = list(range(len(self.data)))
        self.left_out: list[int] = []
        self.lower = lower_bounds(dictionary, stiffness)
        self.measure = initial_stiffness(self.problem.op)
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
        for u, size in zip(self.data, self.size):
            rows = self.problem.op.features(u).reshape(-1, K) / size
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))
        weight = SCALE_WEIGHT * np.abs(triangle).max() * self.measure / np.abs(self.measure).max()
        A = np.concatenate([triangle, weight[None]])
        y = np.zeros(len(A))
        y[-1] = SCALE_WEIGHT * np.abs(triangle).max() / np.abs(self.measure).max()
        length = np.linalg.norm(A, axis=0)
        length[length == 0] = 1.0
        least = lsq_linear(A / length, y, (self.lower * length, np.inf), method="bvls")
        return self.scaled(least.x / length)

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
            gap = (equilibrium.u - self.data[n])[self.inner]
            squares[n] = (gap**2).sum() / self.size[n] ** 2
        return fields, squares

    def _equations(self) -> tuple[np.ndarray, np.ndarray]:
        """The errors and their derivative by coefficients, angles and exponents, reduced."""
        op, K = self.problem.op, len(self.c)
        assert self.problem.pattern is not None
        triangle = np.zeros((0, K + 2 * len(self.moving) + 1))
        for n in self.kept:
            u = self.fields[n]
            factor = positive_factors(self.problem.pattern.matrix(u, self.c))
            if factor is None:
                continue
            F = [op.features(u).reshape(-1, K)]
            for by in ("angle", "exponent") if self.moving else ():
                slopes = op.features(u, by=by).reshape(-1, K)
                F.append(slopes[:, self.moving] * self.c[self.moving])
            J = -factor.solve(np.concatenate(F, axis=1)) / self.size[n]
            gap = (u - self.data[n])[self.inner].reshape(-1, 1) / self.size[n]
            rows = np.concatenate([triangle, np.concatenate([J, gap], axis=1)])
            triangle = np.asarray(np.linalg.qr(rows, mode="r"))
        return triangle[:, :-1], triangle[:, -1]

    def step(self, damping: float) -> float:
        """One step of Gauss, Newton and Levenberg; the next damping."""
        J, r = self._equations()
        K, M = len(self.c), len(self.moving)
        now = np.concatenate([self.c, self._numbers()])
        lower = np.concatenate([self.lower, now[K : K + M] - TURN, now[K + M :] - GROWTH])
        lower[K + M :] = np.maximum(lower[K + M :], [self._least(n) for n in self.moving])
        upper = np.concatenate([np.full(K, np.inf), now[K : K + M] + TURN, now[K + M :] + GROWTH])
        upper[K + M :] = np.minimum(upper[K + M :], LARGEST_EXPONENT)
        length = np.linalg.norm(J, axis=0)
        length[length == 0] = 1.0
        fixed = np.zeros((1, len(now)))
        fixed[0, :K] = SCALE_WEIGHT * self.measure / np.abs(self.measure).max()
        for _ in range(8):
            A = np.concatenate([J, np.sqrt(damping) * np.diag(length), fixed]) / length
            y = np.concatenate([J @ now - r, np.sqrt(damping) * length * now, fixed @ now])
            upper = np.maximum(upper, lower + 1e-12)
            moved = lsq_linear(A, y, (lower * length, upper * length), method="bvls").x / length
            problem = self._moved(moved[K : K + M], moved[K + M :])
            c = self.scaled(np.maximum(moved[:K], 0.0))
            fields, squares = self._solve(problem, c)
            if squares[self.kept].sum() < self.loss:
                self.problem, self.c, self.fields, self.squares = problem, c, fields, squares
                return max(damping / 10, 1e-9)
            damping = max(10 * damping, 1e-6)
        return damping

    def _least(self, number: int) -> float:
        term = self.problem.op.dictionary.terms[number - self.problem.op.dictionary.first_term]
        return 2.0 if term.kind == "fibre_power" else 0.0

    def _numbers(self) -> np.ndarray:
        """Angles and exponents of the fibres that move."""
        dictionary = self.problem.op.dictionary
        terms = [dictionary.terms[n - dictionary.first_term] for n in self.moving]
        return np.array([t.angle for t in terms] + [t.exponent for t in terms])

    def _moved(self, angles: np.ndarray, exponents: np.ndarray) -> StaticProblem:
        """The problem with other angles and exponents."""
        if not self.moving:
            return self.problem
        dictionary = self.problem.op.dictionary
        terms = list(dictionary.terms)
        for n, angle, exponent in zip(self.moving, angles, exponents):
            place = n - dictionary.first_term
            terms[place] = replace(terms[place], angle=float(angle), exponent=float(exponent))
        return self.problem.with_terms(terms)


def scaled_by_force(
    solid: HyperelasticSolid,
    frames: Samples,
    forces: np.ndarray,
    *,
    width: float,
    axis: int = 0,
) -> HyperelasticSolid:
    """The same solid with the scale that measured forces give.

    Args:
        solid: known up to its scale.
        frames: that the forces belong to.
        forces: pull along the axis on a section across it, over the thickness, shape [S]
            in stress times length.
        width: of that section in the reference; the stress on it is taken as that of the interior.
        axis: 0 for x, 1 for y.

    Raises InputError for forces of another number, or where the solid carries none.
    """
    forces = np.asarray(forces, float)
    if forces.shape != (len(frames),) or not np.isfinite(forces).all():
        raise InputError(f"forces: expected {len(frames)} finite numbers")
    op = HyperelasticOperator(solid.dictionary, frames)
    carried = np.array(
        [
            width * piola_stress(op, u, solid.coefficients)[op.interior, axis, axis].mean()
            for u in frames.u
        ]
    )
    size = float(carried @ carried)
    if not size > 0 or not float(carried @ forces) > 0:
        raise InputError("forces: expected a pull with the sign of the solid's stress")
    factor = float(carried @ forces) / size
    return replace(solid, coefficients=factor * solid.coefficients)
