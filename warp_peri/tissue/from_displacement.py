"""Energies and thickness fitted to displacement alone.

Unknowns are coefficients, directions and exponents of fibres, and numbers of the thickness; (H12)
is their loss, (H13) and (H18) its slopes through the equilibrium.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number
from warp_peri.points.samples import Samples, seen_of
from warp_peri.tissue.energy_fit import lower_bounds
from warp_peri.tissue.equilibrium import NoEquilibrium, StaticProblem, positive_factors, rough
from warp_peri.tissue.operator import SMALLEST_AREA, HyperelasticOperator
from warp_peri.tissue.placed import bond_slopes, largest_stretch, piola_stress
from warp_peri.tissue.solid import Dictionary, HyperelasticSolid

LARGEST_DEGREE = 6
LARGEST = 20.0
"""Of the polynomial: beyond ± this the thickness stays at e^± this, so that it is a number."""


@dataclass(frozen=True, eq=False)
class Thickness:
    """A thickness that is positive everywhere and one at the centre.

    Attributes:
        degree: of the polynomial, 1 to 6.
        centre, half: where −1 and 1 of its coordinates are: centre ± half [length], shape [2].
        numbers: its coefficients in the order of `names`, shape [P]; zeros where none are given.

    The thickness of the whole sheet is no number here: from displacement alone it cannot be told.
    Raises InputError for another degree, halves that are not positive, or numbers of another count.
    """

    degree: int
    centre: np.ndarray
    half: np.ndarray
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        whole = isinstance(self.degree, (int, np.integer)) and not isinstance(self.degree, bool)
        if not (whole and 1 <= self.degree <= LARGEST_DEGREE):
            raise InputError(f"degree: expected 1 to {LARGEST_DEGREE}, got {self.degree!r}")
        centre, half = (np.array(value, float) for value in (self.centre, self.half))
        if centre.shape != (2,) or half.shape != (2,) or not np.isfinite(centre).all():
            raise InputError("centre, half: expected two finite lengths each")
        if not (np.isfinite(half).all() and half.min() > 0):
            raise InputError(f"half: expected two lengths > 0, got {half.tolist()}")
        numbers = np.array(self.numbers, float)
        if not numbers.size:
            numbers = np.zeros(len(self.names))
        if numbers.shape != (len(self.names),) or not np.isfinite(numbers).all():
            raise InputError(
                f"numbers: expected {len(self.names)} finite numbers, got shape {numbers.shape}"
            )
        for name, value in (("centre", centre), ("half", half), ("numbers", numbers)):
            object.__setattr__(self, name, value)

    @classmethod
    def over(cls, x: np.ndarray, degree: int) -> Thickness:
        """An even thickness whose coordinates go from −1 to 1 over the nodes x, shape [N, 2]."""
        low, high = np.min(x, axis=0), np.max(x, axis=0)
        return cls(degree, (low + high) / 2, (high - low) / 2)

    @property
    def _powers(self) -> list[tuple[int, int]]:
        return [(total - b, b) for total in range(1, self.degree + 1) for b in range(total + 1)]

    @property
    def names(self) -> list[str]:
        """Names of the numbers: x, y, x^2, x y, …"""
        words = []
        for powers in self._powers:
            parts = [f"{s}^{p}" if p > 1 else s for s, p in zip("xy", powers) if p]
            words.append(" ".join(parts))
        return words

    def _terms(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        if x.ndim != 2 or x.shape[1] != 2:
            raise InputError(f"x: expected positions of shape [N, 2], got {list(x.shape)}")
        place = (x - self.centre) / self.half
        return np.stack([place[:, 0] ** a * place[:, 1] ** b for a, b in self._powers], axis=1)

    def at(self, x: np.ndarray) -> np.ndarray:
        """Thickness at positions [length] of shape [N, 2], over that at the centre, shape [N]."""
        values: np.ndarray = np.exp(np.clip(self._terms(x) @ self.numbers, -LARGEST, LARGEST))
        return values

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Its derivative by the numbers, shape [N, P]."""
        terms = self._terms(x)
        inside = np.abs(terms @ self.numbers) <= LARGEST
        values: np.ndarray = (inside * self.at(x))[:, None] * terms
        return values


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
        self.linearise()

    def _solve(
        self, problem: StaticProblem, c: np.ndarray, change: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fields of all kept frames, and their squared relative errors; infinite where none.

        They are looked for from where a change of the unknowns leads, to first order.
        """
        fields, squares = self.fields.copy(), np.full(len(self.data), np.inf)
        for n in self.kept:
            start, near = self.fields[n].copy(), None
            if change is not None and n in self.linear:
                slopes, near = self.linear[n]
                start[self.inner] += (slopes @ change).reshape(-1, 2)
                if problem.op.smallest_area(start) <= SMALLEST_AREA:
                    start = self.fields[n]
            equilibrium = problem.find(c, None, self.data[n], start=start, near=near)
            if equilibrium is None:
                if self.squares[n] < np.inf:
                    return fields, squares
                continue
            fields[n] = equilibrium.u
            gap = (equilibrium.u - self.data[n])[self.inner] * self.seen[n]
            squares[n] = (gap**2).sum() / self.size[n] ** 2
        return fields, squares

    def linearise(self) -> bool:
        """Derivatives of the fields by all unknowns in the order of `now`; whether all are stable.

        With the reduced equations of their errors.
        """
        op, K = self.problem.op, len(self.c)
        if (pattern := self.problem.pattern) is None:
            raise InputError("problem: expected one whose tangent is factorised")
        triangle = np.zeros((0, len(self.now) + 1))
        linear: dict[int, tuple[np.ndarray, Any]] = {}
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
            J = -factor.solve(np.concatenate(F, axis=1))
            linear[n] = J, rough(factor)
            gap = (u - self.data[n])[self.inner].reshape(-1, 1)
            rows = np.concatenate([J, gap], axis=1) / self.size[n]
            rows = np.concatenate([triangle, rows * np.repeat(self.seen[n], 2, axis=0)])
            triangle = np.asarray(np.linalg.qr(rows, mode="r"))
        self.linear, self.equations = linear, triangle
        return len(linear) == len(self.kept)

    def step(self, damping: float) -> float:
        """One step of Gauss, Newton and Levenberg; the next damping."""
        J, r = self.equations[:, :-1], self.equations[:, -1]
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
            before = vars(self).copy()
            fields, squares = self._solve(problem, c, np.array([*c, *moved[K:]]) - now)
            if squares[self.kept].sum() < self.loss:
                self.problem, self.c, self.fields, self.squares = problem, c, fields, squares
                self.thickness = thickness
                if self.linearise():
                    return max(damping / 10, 1e-9)
                vars(self).update(before)
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


INTERPOLATES = 50.0
"""Times as stiff as the sheet at rest: such deviations fill in the collar as a stiff plate does."""
NODES = 10
"""Measured components, or nodes inside, for each number that is learned, at least."""
AFFINE = 1e-6
"""A set of frames whose distance from affine displacement is below this fraction says nothing."""


def fit_displacement(
    frames: Samples,
    dictionary: Dictionary,
    *,
    stiffness: float | tuple[float, float] = 0.05,
    moving: bool = False,
    start: np.ndarray | None = None,
    thickness: int = 0,
    most_steps: int = 15,
    tolerance: float = 1e-4,
    progress: bool | str = False,
) -> DisplacementFit:
    """Learn from displacement on a lattice whose collar is data and whose interior carries no load.

    Args:
        frames: samples without loads.
        dictionary: energies that are safe with coefficients ≥ 0.
        stiffness: least coefficient of the deviations, in units of the initial stiffness, or the
            least and the greatest: what is held low does not fit the frames in place of a material.
        moving: whether angles and exponents of fibres are unknowns too.
        start: coefficients to begin with, shape [K]; those of least equation error where none.
        thickness: degree of the polynomial that is the logarithm of the sheet's thickness, (H18);
            0 for an even sheet.
        most_steps: of Gauss and Newton.
        tolerance: ends when a step lowers the loss by less than this fraction.
        progress: show a bar on stderr; a text is its name.

    Warns where deviations come out so stiff that they, and not a material, explain the frames.
    Raises InputError for frames with loads, affine frames, a frame at rest, fewer than ten measured
    components inside, of all frames, for each energy, energies that guarantee nothing, and numbers
    that make no sense; NoEquilibrium where no frame has one at the start.
    """
    check_unloaded(frames)
    if not dictionary.guaranteed:
        raise InputError(
            "dictionary: expected energies that are convex and stress-free at rest only"
        )
    check_identifiable(frames)
    uneven = Thickness.over(frames.x, thickness) if thickness else None
    numbers = len(dictionary)
    count = 2 * np.count_nonzero(seen_of(frames)[:, frames.interior])
    if count < NODES * numbers:
        raise InputError(
            f"frames: expected {NODES * numbers} measured components inside for {numbers} numbers, "
            f"got {count}"
        )
    bounds = bounds_of(stiffness)
    search = Search(frames, dictionary, bounds, moving, uneven)
    if start is None:
        c = search.equation_error()
    else:
        if np.shape(start) != (len(dictionary),):
            raise InputError(f"start: expected {len(dictionary)} coefficients, got {start!r:.60}")
        c = search.scaled(np.clip(start, search.lower, search.upper))
    fit = search.descended(c, most_steps, tolerance, progress)
    warn_of_interpolation(fit.material)
    return fit


def fit_thickness(
    frames: Samples,
    solid: HyperelasticSolid,
    degree: int = 2,
    *,
    most_steps: int = 10,
    tolerance: float = 1e-4,
    progress: bool = False,
) -> DisplacementFit:
    """The thickness (H18) of a sheet whose material is known, from its own displacement.

    Args:
        frames: samples without loads.
        solid: the material; its coefficients stay, scaled to an initial stiffness of one.
        degree: of the polynomial.
        most_steps, tolerance, progress: as in fit_displacement.

    Raises InputError for frames with loads, none, or a frame at rest, and for another degree;
    NoEquilibrium where no frame has one in an even sheet.
    """
    check_unloaded(frames)
    uneven = Thickness.over(frames.x, degree)
    search = Search(frames, solid.dictionary, (0.0, np.inf), False, uneven, held=True)
    return search.descended(search.scaled(solid.coefficients), most_steps, tolerance, progress)


def bounds_of(stiffness: float | tuple[float, float]) -> tuple[float, float]:
    """Least and greatest coefficient of the deviations; InputError where they are none."""
    given: Any = (stiffness, np.inf) if is_number(stiffness) else stiffness
    if not (isinstance(given, (tuple, list)) and len(given) == 2 and all(map(is_number, given))):
        raise InputError(f"stiffness: expected one number or two, got {stiffness!r:.60}")
    least, greatest = float(given[0]), float(given[1])
    if not (0 <= least <= greatest and least < np.inf):
        raise InputError(f"stiffness: expected 0 ≤ least ≤ greatest, got {stiffness!r:.60}")
    return least, greatest


def check_unloaded(frames: Samples) -> None:
    """Raise InputError where the interior carries a load."""
    if frames.b is not None and np.any(frames.b[:, frames.interior]):
        raise InputError("frames: expected no load on the interior; with loads use fit_energy")


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


def stiffest_deviation(solid: HyperelasticSolid) -> float:
    """Largest of the deviations, in units of an initial stiffness of one."""
    dictionary = solid.dictionary
    deviations = solid.coefficients[dictionary.first_deviation : dictionary.first_term]
    return float(deviations.max(initial=0.0))


def warn_of_interpolation(solid: HyperelasticSolid) -> None:
    """Warn where the deviations of a solid with an initial stiffness of one outweigh it by far."""
    stiffest = stiffest_deviation(solid)
    if stiffest > INTERPOLATES:
        warnings.warn(
            f"deviations came out {stiffest:.0f} times as stiff as the sheet at rest: they "
            "interpolate the collar, whatever the material; is the sheet uneven (thickness=), or "
            "were the frames smoothed?",
            stacklevel=3,
        )


def scaled_by_force(
    solid: HyperelasticSolid,
    frames: Samples,
    forces: np.ndarray,
    *,
    width: float,
    axis: int = 0,
    thickness: np.ndarray | None = None,
) -> HyperelasticSolid:
    """The same solid with the scale that measured forces give.

    Args:
        solid: known up to its scale.
        frames: that the forces belong to.
        forces: pull along the axis on a section across it, over the thickness, shape [S]
            in stress times length.
        width: of that section in the reference [length], > 0; the stress on it is taken as that of
            the interior.
        axis: 0 for x, 1 for y.
        thickness: of every node over that which the forces are divided by, shape [N]; one for none.

    Raises InputError for forces of another number, another axis or width, or where the solid
    carries no force.
    """
    if axis not in (0, 1) or not 0 < width < np.inf:
        raise InputError(f"axis, width: expected 0 or 1 and a length > 0, got {axis} and {width}")
    forces = np.asarray(forces, float)
    if forces.shape != (len(frames),) or not np.isfinite(forces).all():
        raise InputError(f"forces: expected {len(frames)} finite numbers")
    op = HyperelasticOperator(solid.dictionary, frames, thickness=thickness)
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
    known = {name: value for name, value in solid.provenance.items() if name != "stresses"}
    return replace(solid, coefficients=factor * solid.coefficients, provenance=known)
