"""Energies and thickness fitted to displacement alone.

Unknowns are coefficients, directions and exponents of fibres, and numbers of the thickness; (H12)
is their loss, (H13) and (H18) its slopes through the equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion
from tqdm import tqdm

from warp_peri.errors import InputError, warn
from warp_peri.fitting.rows import compressed
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic, HyperelasticMaterial
from warp_peri.materials.hyperelastic.energy_fit import between, columns, lower_bounds
from warp_peri.materials.hyperelastic.equilibrium import NoEquilibriumError, StaticProblem
from warp_peri.materials.hyperelastic.fibres import fibre_numbers, fibres_of, with_numbers
from warp_peri.materials.hyperelastic.operator import SMALLEST_AREA, HyperelasticOperator
from warp_peri.materials.hyperelastic.placed import largest_stretch
from warp_peri.points.arguments import Count, Share, typed, typed_methods
from warp_peri.points.arrays import checked, is_number
from warp_peri.points.points import Points
from warp_peri.points.samples import PULL, Samples, seen_of

LARGEST_DEGREE = 6
LARGEST = 20.0
"""Of the polynomial: beyond ± this the thickness stays at e^± this, so that it is a number."""


@typed_methods
@dataclass(frozen=True, eq=False)
class ThicknessField:
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
        if not np.size(self.numbers):
            object.__setattr__(self, "numbers", np.zeros(len(self.names)))
        for name, count in (("centre", 2), ("half", 2), ("numbers", len(self.names))):
            object.__setattr__(self, name, checked(name, getattr(self, name), shape=(count,)))
        if not self.half.min() > 0:
            raise InputError(f"half: expected two lengths > 0, got {self.half.tolist()}")

    @classmethod
    def over(cls, x: np.ndarray, degree: int) -> ThicknessField:
        """An even thickness whose coordinates go from −1 to 1 over the nodes x, shape [N, 2]."""
        low, high = np.min(x, axis=0), np.max(x, axis=0)
        return cls(degree, (low + high) / 2, (high - low) / 2)

    @property
    def _powers(self) -> list[tuple[int, int]]:
        return [(total - b, b) for total in range(1, self.degree + 1) for b in range(total + 1)]

    @property
    def names(self) -> list[str]:
        """Names of the numbers: x, y, x^2, x y, …"""
        words = {0: "", 1: "{} "} | {n: f"{{}}^{n} " for n in range(2, LARGEST_DEGREE + 1)}
        return [(words[a].format("x") + words[b].format("y")).strip() for a, b in self._powers]

    def _terms(self, x: np.ndarray) -> np.ndarray:
        x, y = ((checked("x", x, shape=("N", 2)) - self.centre) / self.half).T
        return np.stack([x**a * y**b for a, b in self._powers], axis=1)

    def at(self, x: np.ndarray) -> np.ndarray:
        """Thickness at positions [length] of shape [N, 2], over that at the centre, shape [N]."""
        return np.asarray(np.exp(np.clip(self._terms(x) @ self.numbers, -LARGEST, LARGEST)))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Its derivative by the numbers, shape [N, P]."""
        inside = np.abs((terms := self._terms(x)) @ self.numbers) <= LARGEST
        return np.asarray((inside * self.at(x))[:, None] * terms)


class Sections:
    """Lines of nodes across an axis from edge to edge of a sheet, with such lines on both sides.

    Args:
        frames: displacement on a lattice along x and y.
        dictionary: of the energies, whose 2δ is how far lines on both sides go.
        axis: 0 for x, 1 for y.

    Beyond the edges displacement goes on as its mirror image in the point there. Raises InputError
    where a hole or an edge leaves no such line.
    """

    def __init__(self, frames: Samples, dictionary: Hyperelastic, axis: int) -> None:
        R, turn, origin = 2 * int(dictionary.reach), [axis, 1 - axis], frames.x.min(axis=0)
        line, place = np.rint((frames.x - origin) / frames.spacing).astype(int)[:, turn].T
        number = np.full((line.max() + 1, place.max() + 1), -1)
        number[line, place] = np.arange(len(line))
        lines = binary_erosion((number >= 0).all(axis=1), iterations=R)
        if not lines.any():
            raise InputError(
                f"{PULL}: expected lines of nodes across {'xy'[axis]} from edge to edge of the "
                f"sheet, with {R} such lines on both sides, got none; a hole or the outline cuts "
                "them, and no other mean is the force over width and thickness"
            )
        near, width = np.flatnonzero(binary_dilation(lines, iterations=R)), number.shape[1]
        sides = np.meshgrid(near, np.arange(-R, width + R), indexing="ij")
        steps = np.stack(sides, axis=-1).reshape(-1, 2)
        own = lines[steps[:, 0]] & (steps[:, 1] >= 0) & (steps[:, 1] < width)
        x = origin + frames.spacing * steps[:, turn]
        points = Points(x, own, frames.spacing, units=frames.points.units)
        self.op, self.axis = HyperelasticOperator(replace(dictionary, deviations=()), points), axis
        self.of_lattice = range(dictionary.first_deviation, dictionary.first_term)
        self.shape, around = (-1, width), ((0, 0), (0, 0), (R, R), (0, 0))
        fields = np.pad(frames.u[:, number[near]], around, "reflect", reflect_type="odd")
        self.fields = fields.reshape(len(frames), -1, 2)

    def stress(
        self, n: int, terms: Sequence[EnergyTerm], c: np.ndarray, thickness: ThicknessField | None
    ) -> np.ndarray:
        """Pull over width and mean thickness on every line of a frame, shape [L].

        Without deviations: they belong to the lattice, and see noise at edges.
        """
        op, c = self.op.with_terms(terms), np.delete(c, self.of_lattice)
        if thickness is not None:
            of_nodes = thickness.at(op.points.x)
            op = op.with_thickness(of_nodes / of_nodes[op.interior].mean())
        P = op.stress(self.fields[n], c)[op.interior, self.axis, self.axis]
        P = P.reshape(self.shape)
        return np.asarray((P[:, :-1] + P[:, 1:]).mean(axis=1) / 2)


SCALE_WEIGHT = 1e3
"""Of the equation that fixes the initial stiffness, before it is met exactly."""
DAMPING, MOST_DAMPING = (1e-9, 1e-6, 1e-3), 1e3
"""Of Levenberg: least, that of a step from the optimum, first; that of the last that is tried."""
TRIES = 4
"""Steps that are tried for each that is asked for, those with more damping included."""
GAINED = 0.15
"""Of the tolerance: what the last step gained more by has slopes of its end."""
NO_ERROR = 1e-8
"""Of fields that no unknowns could fit better."""
STIFFEN = 30.0
"""Largest ratio of a deviation that is stiffer than the sheet at rest to itself before a step."""
NO_FORCE = {"stresses": "scaled to a stiffness of one at rest, no force is known"}
THICKEN = 0.5
"""Largest change of a number of the thickness in one step."""


@typed_methods
@dataclass(frozen=True, eq=False)
class DisplacementFit:
    """A solid, known up to its scale where no frame has a pull.

    Attributes:
        material: with an initial stiffness (H14) of `scale`.
        errors: relative error of the solved displacement of every training frame.
        history: root mean square of those errors after every step.
        frames_left_out: frames that it does not stand on: no equilibrium was found at the start.
        thickness: of the sheet, where it was an unknown.
        others: the same with each frame left out in turn, by one Gauss-Newton step from here, with
            the errors that its linear equations tell.
        fields: solved displacement of every training frame, shape [S, N, 2].
        scale: by what frames with a PULL say; one where none has.
        scatter: relative, of what sections and frames say that it is.
    """

    material: HyperelasticMaterial
    errors: np.ndarray
    history: list[float]
    frames_left_out: list[int]
    thickness: ThicknessField | None = None
    others: list[DisplacementFit] = field(default_factory=list)
    fields: np.ndarray | None = None
    scale: float = 1.0
    scatter: float = 0.0


class Search:
    """Where the search stands: unknowns, fields and what both are to first order.

    A step of Gauss and Newton moves unknowns and fields at once, so that it costs a tangent a frame
    and no equilibrium; these are solved for at the end, and where a step promised too much.
    """

    def __init__(
        self,
        frames: Samples,
        dictionary: Hyperelastic,
        bounds: tuple[float, float],
        moving: bool,
        thickness: ThicknessField | None = None,
        *,
        held: bool = False,
    ) -> None:
        self.x, self.data, self.thickness, self.held = frames.x, frames.u, thickness, held
        thick = None if thickness is None else thickness.at(self.x)
        self.problem = StaticProblem(HyperelasticOperator(dictionary, frames, thickness=thick))
        self.inner = self.problem.op.interior
        if not len(self.data):
            raise InputError("frames: expected one or more")
        seen = np.repeat(seen_of(frames)[:, self.inner], 2, axis=1)
        size = np.linalg.norm(self._inside(self.data) * seen, axis=1)
        if not size.all():
            raise InputError(
                f"frames: expected interiors that move, frame {size.argmin()} is at rest"
            )
        self.weight = seen / size[:, None]
        pull = np.asarray(frames.arrays.get(PULL, np.full((len(frames), 2), np.nan)), float)
        self.pulled = np.argwhere(np.isfinite(pull))
        self.pull = pull[tuple(self.pulled.T)]
        self.sections = {axis: Sections(frames, dictionary, axis) for axis in {*self.pulled[:, 1]}}
        self.kept, self.left_out = list(range(len(self.data))), list[int]()
        self.lower, self.upper = (
            lower_bounds(dictionary, bounds[0]),
            np.full(len(dictionary), np.inf),
        )
        self.own = slice(dictionary.first_deviation, dictionary.first_term)
        self.upper[self.own] = max(bounds[1], bounds[0] + 1e-9)
        self.measure = dictionary.stiffness
        if not self.measure.any():
            raise InputError("dictionary: expected an energy with stiffness at rest")
        self.moving = fibres_of(dictionary) if moving else []
        self.c, self.growth = np.zeros(len(dictionary)), STIFFEN
        self.linear: dict[int, tuple[np.ndarray, np.ndarray, Any]] = {}
        self.equations_of: dict[int, np.ndarray] = {}

    def _inside(self, fields: np.ndarray) -> np.ndarray:
        """Of fields [..., N, 2] the interior in a row, [..., 2 I]."""
        inside = fields[..., self.inner, :]
        return inside.reshape(*inside.shape[:-2], -1)

    @property
    def equations(self) -> np.ndarray:
        """Rows whose squared sum is the loss: slopes by the unknowns, and errors as they are."""
        return np.concatenate([*self.equations_of.values()])

    def loss(self, change: Any = 0.0) -> float:
        """Sum of squared relative errors in equilibrium after a change of the unknowns, to first
        order."""
        rows = self.equations
        return float(((rows[:, :-1] @ (change + 0 * self.now) + rows[:, -1]) ** 2).sum())

    @property
    def rms(self) -> float:
        """Root mean square of the relative errors."""
        return float(np.sqrt(self.loss() / len(self.kept)))

    def scaled(self, c: np.ndarray) -> np.ndarray:
        """The same material with an initial stiffness of one."""
        size = float(self.measure @ c)
        if not size > 0:
            raise InputError("coefficients: expected an initial stiffness > 0")
        return c / size

    def equation_error(self) -> np.ndarray:
        """Coefficients of least internal force on the measured fields; biased under noise."""
        J = np.zeros((0, len(self.c)))
        for u, weight in zip(self.data, self.weight):
            J = np.concatenate([J, columns(self.problem.op, u) * weight[:, None]])
            J, _ = compressed(J, np.zeros(len(J)))
        now, bounds = self.scaled(self.measure), (self.lower, self.upper)
        return self._nearest(J / np.abs(J).max(), np.zeros(len(J)), now, bounds, 0.0)

    def _nearest(
        self, J: np.ndarray, y: np.ndarray, now: np.ndarray, bounds: Any, damping: float
    ) -> np.ndarray:
        """Unknowns between bounds of least |J x − y|, as Levenberg damps them, of the same initial
        stiffness."""
        K, held = len(self.c), np.zeros((1, len(now)))
        held[0, :K] = SCALE_WEIGHT * self.measure / np.abs(self.measure).max()
        x = between(J, y, now, bounds, damping, held)
        x[:K] = now[:K] if self.held else self.scaled(np.maximum(x[:K], 0.0))
        return x

    def step(self, damping: float, equations: np.ndarray | None = None) -> np.ndarray:
        """The change of the unknowns that meets the equations best, all where none are given."""
        now, rows = self.now, self.equations if equations is None else equations
        J, r = rows[:, :-1].copy(), rows[:, -1]
        J[:, : len(self.c) * self.held] = 0.0
        there = self._nearest(J, J @ now - r, now, self._bounds(now), damping)
        return np.asarray(there - now)

    def descended(
        self,
        c: np.ndarray,
        most_steps: int,
        tolerance: float,
        progress: bool | str,
        known: DisplacementFit | None = None,
    ) -> DisplacementFit:
        """The whole search from coefficients c, or from a known fit where that promises more."""
        name = progress if isinstance(progress, str) else "Gauss-Newton"
        bar = tqdm(range(TRIES * most_steps), desc=name, disable=not progress, leave=False)
        self.begin(c, known)
        damping, history, balanced = DAMPING[2], [self.rms], False
        for _ in bar:
            if self.growth > 1 and not self.promising(tolerance):
                break
            loss, step = self.loss(), self.step(damping)
            self.growth = STIFFEN
            before = vars(self).copy()
            self.move(step)
            if self.linearise() and self.loss() <= (1 + tolerance) * loss:
                damping, balanced = max(damping / 10, DAMPING[0]), False
                history.append(self.rms)
                bar.set_postfix(error=f"{100 * self.rms:.3f} %")
                continue
            vars(self).update(before)
            damping = max(100 * damping, DAMPING[1])
            if damping > MOST_DAMPING:
                break
            if not balanced:  # what the equations promise may be what fields lack
                balanced = self.balance()
                if not (balanced and self.linearise()):
                    break
        loss, before = self.loss(), vars(self).copy()
        self.move(self.step(damping))
        if not (self.balance() and self.loss() <= (1 + tolerance) * loss):
            vars(self).update(before)
            self.balance()
        elif self.loss() < (1 - GAINED * tolerance) * loss:  # slopes of there, for frames left out
            self.linearise()
        history.append(self.rms)
        each = self.linear if len(self.linear) > 1 else ()
        fit, *others = [self._fit(left) for left in ([], *([n] for n in each))]
        return replace(fit, history=history, others=others, fields=self.fields)

    def promising(self, tolerance: float) -> bool:
        """Whether the equations promise a step that lowers the loss by more than a fraction."""
        ahead = self.loss(self.step(DAMPING[0]))
        return self.rms > NO_ERROR and ahead < (1 - tolerance) * self.loss()

    def begin(self, c: np.ndarray, known: DisplacementFit | None = None) -> None:
        """Begin at the measured fields, or those of a known fit where they promise more.

        Where a tangent there is not positive definite, at equilibria of the first coefficients;
        what has none is left out.
        """
        starts, begun, least = [(c, self.data, 1.0)], {}, np.inf
        if known is not None and known.fields is not None:
            starts.append((self.scaled(known.material.coefficients), known.fields, STIFFEN))
        for self.c, self.fields, self.growth in starts:  # stiffer ones would add to noise at first
            if self.linearise() and (left := self.loss(self.step(DAMPING[2]))) < least:
                begun, least = vars(self).copy(), left
        if begun:
            vars(self).update(begun)
            return
        self.c, self.fields = c, self.data.copy()
        found = [self.problem.find(c, None, u, start=u) for u in self.data]
        self.kept = [n for n, one in enumerate(found) if one]
        self.left_out = [n for n, one in enumerate(found) if not one]
        self.fields[self.kept] = [one.u for one in found if one] or self.fields[:0]
        if not (self.kept and self.linearise()):
            raise NoEquilibriumError("no frame has an equilibrium with the first coefficients")

    def _fit(self, left: list[int]) -> DisplacementFit:
        """What is here, or one step from here with some frames left out, in the scale of forces."""
        step, errors = 0 * self.now, np.full(len(self.data), np.inf)
        if left:
            rest = [rows for n, rows in self.equations_of.items() if n not in left]
            step = self.step(DAMPING[1], np.concatenate(rest))
        for n, rows in self.equations_of.items():
            errors[n] = np.linalg.norm(rows[:, :-1] @ step + rows[:, -1])
        numbers, K = self.now + step, len(self.c)
        problem, thickness = self._moved(numbers[K:])
        scale, scatter = self._scale(left, problem.op.dictionary, numbers[:K], thickness)
        solid = HyperelasticMaterial(
            problem.op.dictionary,
            scale * numbers[:K],
            problem.op.points.spacing,
            largest_stretch(problem.op, self.data),
            {} if len(self.pull) else NO_FORCE,
            units=problem.op.points.units,
        )
        left = [*self.left_out, *left]
        rms = float(np.sqrt(np.delete(errors**2, left).mean()))
        return DisplacementFit(solid, errors, [rms], left, thickness, scale=scale, scatter=scatter)

    def _scale(
        self,
        left: list[int],
        dictionary: Hyperelastic,
        c: np.ndarray,
        thickness: ThicknessField | None,
    ) -> tuple[float, float]:
        """What the pulls of frames that are not left out say that a stress of one is, and the
        relative scatter of that; one where there is no pull."""
        if not len(self.pull):
            return 1.0, 0.0
        own = ~np.isin(self.pulled[:, 0], left)
        own |= not own.any()  # without its only force a fit has the scale of that
        lines = [
            self.sections[axis].stress(n, dictionary.terms, c, thickness)
            for n, axis in self.pulled[own]
        ]
        F, T = self.pull[own], np.array([line.mean() for line in lines])
        if not F @ T > 0:
            raise InputError(f"{PULL}: expected a pull with the sign of the sheet's stress")
        scale = float(F @ T) / float(T @ T)
        gaps = np.hypot(scale * np.array([line.std() for line in lines]), scale * T - F)
        return scale, float(np.linalg.norm(gaps) / np.linalg.norm(F))

    def linearise(self) -> bool:
        """Derivatives of the fields by all unknowns in the order of `now`, Newton's step to
        equilibrium, and the equations of the errors there.

        False where a tangent is not positive definite, or a field folds.
        """
        op, self.linear = self.problem.op, {}
        for n in self.kept:
            u, factors = self.fields[n], None
            if op.smallest_area(u) > SMALLEST_AREA:
                factors = self.problem.factors(self.c, u)[0]
            if factors is None:
                return False
            F = [columns(op, u, self.moving, self.c)]
            if self.thickness is not None:
                slopes = op.by_thickness(u, self.c, self.thickness.slopes(self.x))
                F.append(slopes.reshape(len(F[0]), -1))
            J = -factors.solve(np.concatenate(F, axis=1))
            # the force is linear in the coefficients, and so are Newton's steps
            self.linear[n] = J, J[:, : len(self.c)] @ self.c, factors.rough()
        self._reduce()
        return True

    def _reduce(self) -> None:
        """The equations of the errors of every frame, as few as tell the same."""
        self.equations_of = {}
        for n, (J, away, _) in self.linear.items():
            gap, weight = self._inside(self.fields[n] - self.data[n]) + away, self.weight[n]
            rows = compressed(J * weight[:, None], gap * weight)
            self.equations_of[n] = np.column_stack(rows)

    def move(self, change: np.ndarray) -> None:
        """Move unknowns, and fields to first order."""
        numbers, K, self.fields = self.now + change, len(self.c), self.fields.copy()
        for n, (J, away, _) in self.linear.items():
            self.fields[n, self.inner] += (J @ change + away).reshape(-1, 2)
        self.problem, self.thickness = self._moved(numbers[K:])
        self.c = numbers[:K]

    def balance(self) -> bool:
        """Solve for all equilibria, slopes as they are; False where one is not found."""
        self.fields, self.linear = self.fields.copy(), self.linear.copy()
        for n, (J, away, near) in self.linear.items():
            given, start = (self.c, None, self.data[n]), self.fields[n]
            found = self.problem.find(*given, start=start, near=near)
            found = found or self.problem.find(*given, start=start)
            if found is None:
                return False
            self.fields[n], self.linear[n] = found.u, (J, 0 * away, near)
        self._reduce()
        return True

    @property
    def now(self) -> np.ndarray:
        """Coefficients, angles and exponents of the fibres that move, numbers of the thickness."""
        numbers = np.zeros(0) if self.thickness is None else self.thickness.numbers
        fibres, _ = fibre_numbers(self.problem.op.dictionary, self.moving)
        return np.concatenate([self.c, fibres, numbers])

    def _bounds(self, now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Between what the unknowns may be after a step."""
        K, own = len(self.c), self.own
        numbers = now[K + 2 * len(self.moving) :]
        low, high = fibre_numbers(self.problem.op.dictionary, self.moving)[1]
        lower = np.concatenate([self.lower, low, numbers - THICKEN])
        upper = np.concatenate([self.upper, high, numbers + THICKEN])
        most = np.maximum(self.growth * now[own], now[own] if self.growth == 1 else 1.0)
        upper[own] = np.minimum(upper[own], most)
        return lower, np.maximum(upper, lower + 1e-12)

    def _moved(self, numbers: np.ndarray) -> tuple[StaticProblem, ThicknessField | None]:
        """The problem with other angles, exponents and numbers of the thickness."""
        op, thickness, M = self.problem.op, self.thickness, 2 * len(self.moving)
        if M:
            op = op.with_terms(with_numbers(op.dictionary, self.moving, numbers[:M]))
        if thickness is not None:
            thickness = replace(thickness, numbers=numbers[M:])
            op = op.with_thickness(thickness.at(self.x))
        return self.problem.of(op), thickness


INTERPOLATES = 50.0
"""Times as stiff as the sheet at rest: such deviations fill in the collar as a stiff plate does."""
TEN = 10
"""Of what `check_enough` counts, for each number that is learned, at least."""
SMALL = 0.02
"""Of half of the nodes, E11, E22 or 2 E12: below it moduli are not determined."""
AFFINE = 1e-6
"""A set of frames whose distance from affine displacement is below this fraction says nothing."""


def fit_displacement(
    frames: Samples,
    dictionary: Hyperelastic,
    *,
    stiffness: float | tuple[float, float] = 0.05,
    moving: bool = False,
    start: np.ndarray | DisplacementFit | None = None,
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
        start: coefficients to begin with, shape [K]; those of least equation error where none. Of
            a fit of the same frames and energies the search begins there if that promises more.
        thickness: degree of the polynomial that is the logarithm of the sheet's thickness, (H18);
            0 for an even sheet.
        most_steps: of Gauss and Newton.
        tolerance: ends when a step lowers the loss by less than this fraction.
        progress: show a bar on stderr; a text is its name.

    Warns where deviations come out so stiff that they, and not a material, explain the frames.
    Raises InputError for frames with loads, affine frames, a frame at rest, fewer than ten measured
    components inside, of all frames, for each energy, energies that guarantee nothing, and numbers
    that make no sense; NoEquilibriumError where no frame has one at the start.
    """
    check_unloaded(frames)
    if not dictionary.guaranteed:
        raise InputError(
            "dictionary: expected energies that are convex and stress-free at rest only"
        )
    check_identifiable(frames)
    uneven = ThicknessField.over(frames.x, thickness) if thickness else None
    measured = 2 * int(np.count_nonzero(seen_of(frames)[:, frames.interior]))
    check_enough(measured, "measured components inside", len(dictionary))
    bounds = bounds_of(stiffness)
    search = Search(frames, dictionary, bounds, moving, uneven)
    known: DisplacementFit | None = None
    if isinstance(start, DisplacementFit):
        known, start = start, None
    if start is None:
        c = search.equation_error()
    else:
        if np.shape(start) != (len(dictionary),):
            raise InputError(f"start: expected {len(dictionary)} coefficients, got {start!r:.60}")
        c = search.scaled(np.clip(start, search.lower, search.upper))
    fit = search.descended(c, most_steps, tolerance, progress, known)
    if (stiffest := stiffest_deviation(fit)) > INTERPOLATES:
        warn(
            f"deviations came out {stiffest:.0f} times as stiff as the sheet at rest: they "
            "interpolate the collar, whatever the material; is the sheet heterogeneous "
            "(thickness=), or were the frames smoothed?"
        )
    return fit


@typed
def fit_thickness(
    frames: Samples,
    solid: HyperelasticMaterial,
    degree: int = 2,
    *,
    most_steps: Count = 10,
    tolerance: Share = 1e-4,
    progress: bool = False,
) -> DisplacementFit:
    """The thickness (H18) of a sheet whose material is known, from its own displacement.

    Args:
        frames: samples without loads.
        solid: the material; its coefficients stay, scaled to an initial stiffness of one.
        degree: of the polynomial.
        most_steps, tolerance, progress: as in fit_displacement.

    Raises InputError for frames with loads, none, or a frame at rest, and for another degree;
    NoEquilibriumError where no frame has one in an even sheet.
    """
    check_unloaded(frames)
    uneven = ThicknessField.over(frames.x, degree)
    search = Search(frames, solid.dictionary, (0.0, np.inf), False, uneven, held=True)
    return search.descended(search.scaled(solid.coefficients), most_steps, tolerance, progress)


def bounds_of(stiffness: float | tuple[float, float]) -> tuple[float, float]:
    """Least and greatest coefficient of the deviations; InputError where they are none."""
    given: Any = (stiffness, np.inf) if is_number(stiffness) else stiffness
    pair = isinstance(given, (tuple, list)) and len(given) == 2 and all(map(is_number, given))
    if not (pair and 0 <= given[0] <= given[1] and given[0] < np.inf):
        raise InputError(f"stiffness: expected 0 ≤ least ≤ greatest, got {stiffness!r:.60}")
    return float(given[0]), float(given[1])


def check_enough(count: int, what: str, numbers: int) -> None:
    """Raise InputError where there are fewer than ten of what is counted for each number.

    A fit counts components of all frames. A choice counts nodes: frames of one test are much alike.
    """
    if count < TEN * numbers:
        raise InputError(
            f"frames: expected {TEN * numbers} {what} for {numbers} numbers, got {count}"
        )


def check_unloaded(frames: Samples) -> None:
    """Raise InputError where the interior carries a load."""
    if frames.b is not None and np.any(frames.b[:, frames.interior]):
        raise InputError("frames: expected no load on the interior; with loads use fit_energy")


def check_identifiable(frames: Samples) -> None:
    """Raise InputError where any homogeneous body could have moved so, or the strain is small."""
    design = np.concatenate([np.ones((len(frames.x), 1)), frames.x], axis=1)
    u = np.moveaxis(frames.u, 0, 1).reshape(len(frames.x), -1)
    rest = u - design @ np.linalg.lstsq(design, u, rcond=None)[0]
    rest, size = (np.linalg.norm(v.reshape(len(v), -1, 2), axis=(0, 2)) for v in (rest, u))
    if not (rest > AFFINE * size).any():
        raise InputError(
            "frames: expected displacement that is not affine; a homogeneous body of any material "
            "follows affine edges, so that such frames say nothing about it"
        )
    op = HyperelasticOperator(Hyperelastic(terms=(EnergyTerm("plane_stress"),)), frames)
    strains = np.abs(op.strain(frames.u)[:, op.interior]).max(axis=-1)
    typical = float(np.median(strains, axis=1).max())
    if typical < SMALL:
        raise InputError(
            f"frames: expected strains of {100 * SMALL:g} % or more in one, got "
            f"{100 * typical:.2g} % at most nodes; below, noise decides on moduli, above all on "
            "that of the area (bulk)"
        )


def stiffest_deviation(fit: DisplacementFit) -> float:
    """Largest of the deviations, in units of the initial stiffness."""
    dictionary, c = fit.material.dictionary, fit.material.coefficients
    own = c[dictionary.first_deviation : dictionary.first_term]
    return float(own.max(initial=0.0)) / fit.scale
