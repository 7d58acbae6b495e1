"""Fits of energies, fibres and thickness to displacement alone: (H12), its slopes (H13), (H18)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion
from tqdm import tqdm

from warp_peri.errors import InputError, warn
from warp_peri.fitting.rows import compressed
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.energy_fit import (
    ThicknessField,
    between,
    columns,
    equations,
    fibre_numbers,
    fibres_of,
    lower_bounds,
    sheet_on,
    with_numbers,
)
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.points.arguments import Count, NotNegative, Share, typed, typed_methods
from warp_peri.points.points import PULL, Points, Samples, seen_of
from warp_peri.solvers.equilibria import Descent, NoEquilibriumError


class Sections:
    """Lines of nodes across a sheet from edge to edge, with 2δ of such lines around; InputError
    where there is none. Beyond the edges displacement is mirrored."""

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
        self.op, self.axis, self.shape = sheet_on(dictionary, points), axis, (-1, width)
        around = ((0, 0), (0, 0), (R, R), (0, 0))
        fields = np.pad(frames.u[:, number[near]], around, "reflect", reflect_type="odd")
        self.fields = fields.reshape(len(frames), -1, 2)

    def stress(
        self, n: int, solid: HyperelasticMaterial, thickness: ThicknessField | None
    ) -> np.ndarray:
        """Pull over width and mean thickness on every line of frame n, [L]; without deviations."""
        c, of_nodes = solid.coefficients.copy(), None
        c[solid.dictionary.first_deviation : solid.dictionary.first_term] = 0.0
        if thickness is not None:
            of_nodes = thickness.at(self.op.points.x)
            of_nodes = of_nodes / of_nodes[self.op.interior].mean()
        op = self.op.changed(replace(solid, coefficients=c), of_nodes)
        P = op.stress(self.fields[n])[:, self.axis, self.axis].reshape(self.shape)
        return np.asarray((P[:, :-1] + P[:, 1:]).mean(axis=1) / 2)


SCALE_WEIGHT = 1e3
"""Of the equation that fixes the initial stiffness, before it is met exactly."""
DAMPING, MOST_DAMPING = (1e-9, 1e-6, 1e-3), 1e3
"""Of Levenberg: least, that of a step from the optimum, first; that of the last that is tried."""
TRIES = 4
"""Steps that are tried for each that is asked for, those with more damping included."""
NO_ERROR = 1e-8
"""Of fields that no unknowns could fit better."""
STIFFEN = 30.0
"""Largest ratio of a deviation that is stiffer than the sheet at rest to itself before a step."""
SETTLED = 1e-4
"""Residual of equilibria, over the largest force, that one more step of Newton's takes away."""
NO_FORCE = {"stresses": "scaled to a stiffness of one at rest, no force is known"}
TURN, GROWTH, THICKEN = 0.2, 1.0, 0.5
"""Largest change of an angle [rad], an exponent and a number of the thickness in one step."""


@typed_methods
@dataclass(frozen=True, eq=False)
class DisplacementFit:
    """A material fitted to displacement, known up to its scale where no frame has a pull.

    Attributes:
        material: with an initial stiffness (H14) of `scale`.
        errors: relative error of the solved displacement of every training frame.
        history: root mean square of those errors after every step.
        frames_left_out: frames without an equilibrium at the start, on which it does not stand.
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


@dataclass(frozen=True, eq=False)
class Place:
    """State of a search: unknowns, equilibria and both linearised.

    Attributes:
        x: coefficients, angles and exponents of fibres, numbers of the thickness, shape [T].
        fields: of all frames, shape [S, N, 2].
        slopes: of displacement inside by unknowns, [2 I, T], by frame that has an equilibrium.
        equations: of these, rows whose squared sum is the loss: slopes, and errors as they are.
    """

    x: np.ndarray
    fields: np.ndarray
    slopes: dict[int, np.ndarray]
    equations: dict[int, np.ndarray]

    def errors(self, change: Any = 0.0) -> np.ndarray:
        """Relative errors of the frames after a change of the unknowns, to first order."""
        moved = np.append(change + 0 * self.x, 1.0)
        return np.array([np.linalg.norm(rows @ moved) for rows in self.equations.values()])

    def loss(self, change: Any = 0.0) -> float:
        """Sum of squared frame errors after a change of the unknowns."""
        return float((self.errors(change) ** 2).sum())

    @property
    def rms(self) -> float:
        """Root mean square of the frames' relative errors."""
        return float(np.sqrt(self.loss() / len(self.equations)))


class Search:
    """Gauss-Newton-Levenberg search for coefficients that are not `held` (deviations ≥
    `stiffness`), numbers of `moving` fibres, and a thickness."""

    def __init__(
        self,
        frames: Samples,
        dictionary: Hyperelastic,
        stiffness: float,
        moving: bool = False,
        thickness: ThicknessField | None = None,
        *,
        held: bool = False,
    ) -> None:
        self.data, self.thickness, self.held = frames.u, thickness, held
        self.op = sheet_on(dictionary, frames)
        self.inner = self.op.interior
        if not len(self.data):
            raise InputError("frames: expected one or more")
        seen = np.repeat(seen_of(frames)[:, self.inner], 2, axis=1)
        size = np.linalg.norm(self.data[:, self.inner].reshape(seen.shape) * seen, axis=1)
        if not size.all():
            raise InputError(
                f"frames: expected interiors that move, frame {size.argmin()} is at rest"
            )
        self.weight = seen / size[:, None]
        pull = np.asarray(frames.arrays.get(PULL, np.full((len(frames), 2), np.nan)), float)
        self.pulled = np.argwhere(np.isfinite(pull))
        self.pull = pull[tuple(self.pulled.T)]
        self.sections = {axis: Sections(frames, dictionary, axis) for axis in {*self.pulled[:, 1]}}
        self.own = slice(dictionary.first_deviation, dictionary.first_term)
        self.measure = dictionary.stiffness
        self.moving = fibres_of(dictionary) if moving else []
        fibres, (least, most) = fibre_numbers(dictionary, self.moving)
        thick = np.zeros(0) if thickness is None else thickness.numbers
        free, none = np.full(len(dictionary), np.inf), np.full(len(thick), np.inf)
        turns = np.repeat([TURN, GROWTH], len(self.moving))
        self.low = np.concatenate([lower_bounds(dictionary, stiffness), least, -none])
        self.high = np.concatenate([free, most, none])
        self.reach = np.concatenate([free, turns, np.minimum(none, THICKEN)])
        self.rest = np.append(fibres, thick)

    def scaled(self, c: np.ndarray) -> np.ndarray:
        """The coefficients scaled to an initial stiffness of one."""
        size = float(self.measure @ c)
        if not size > 0:
            raise InputError("coefficients: expected an initial stiffness > 0")
        return np.asarray(c / size)

    def equation_error(self) -> np.ndarray:
        """Coefficients of least internal force on the measured fields; biased under noise."""
        J, y = equations(self.op, self.data, 0 * self.weight, self.weight)
        now, K = self.scaled(self.measure), len(self.measure)
        bounds = self.low[:K], self.high[:K]
        return self._nearest(J / np.abs(J).max(), y, now, bounds, 0.0)

    def _nearest(
        self, J: np.ndarray, y: np.ndarray, now: np.ndarray, bounds: Any, damping: float
    ) -> np.ndarray:
        """Unknowns of least |J x − y|, damped by Levenberg, of the same initial stiffness."""
        K, held = len(self.measure), np.zeros((1, len(now)))
        held[0, :K] = SCALE_WEIGHT * self.measure / np.abs(self.measure).max()
        x = between(J, y, now, bounds, damping, held)
        x[:K] = now[:K] if self.held else self.scaled(np.maximum(x[:K], 0.0))
        return x

    def sheet(self, x: np.ndarray) -> tuple[HyperelasticMaterial, ThicknessField | None]:
        """The material and the thickness of the unknowns x."""
        K, thickness = len(self.measure) + 2 * len(self.moving), self.thickness
        if thickness is not None:
            thickness = replace(thickness, numbers=x[K:])
        return with_numbers(self.op.model, self.moving, x[:K]), thickness

    def step(self, place: Place, damping: float, left: Sequence[int] = ()) -> np.ndarray:
        """Change of the unknowns that meets the equations best, some frames left out."""
        rows = np.concatenate([one for n, one in place.equations.items() if n not in left])
        low, high = np.maximum(self.low, place.x - self.reach), place.x + self.reach
        high[self.own] = STIFFEN * np.maximum(place.x[self.own], 1.0)
        bounds = low, np.maximum(np.minimum(self.high, high), low + 1e-9)
        J, r = rows[:, :-1].copy(), rows[:, -1]
        J[:, : len(self.measure) * self.held] = 0.0
        return np.asarray(self._nearest(J, J @ place.x - r, place.x, bounds, damping) - place.x)

    def moved(self, place: Place, change: np.ndarray) -> Place:
        """State of the search after a change of the unknowns."""
        fields = place.fields.copy()
        for n, J in place.slopes.items():
            fields[n, self.inner] += (J @ change).reshape(-1, 2)
        return self.settled(place.x + change, fields, place.slopes)

    def settled(self, x: np.ndarray, fields: np.ndarray, frames: Iterable[int]) -> Place:
        """State with equilibria of frames, from fields near them; no equations without one."""
        (solid, thickness), fields = self.sheet(x), fields.copy()
        nodes = self.op.points.x
        op = self.op.changed(solid, None if thickness is None else thickness.at(nodes))
        slopes, equations = dict[int, np.ndarray](), dict[int, np.ndarray]()
        none = np.zeros((len(self.inner), 2))
        for n in frames:
            start, given = fields[n], self.data[n]
            near = op.factors(start)[0] if op.folds(start) < np.inf else None
            u, record = Descent(op).find(none, given, SETTLED, start, near)
            if not (record.converged and (inverse := near or op.factors(u)[0])):
                continue
            F = [columns(op, u, self.moving)]
            if thickness is not None:
                F.append(op.by_thickness(u, thickness.slopes(nodes)).reshape(len(F[0]), -1))
            fields[n], J = u, -inverse(np.concatenate(F, axis=1))
            # the force is linear in the coefficients, and so is what Newton's step has left
            left = J[:, : len(self.measure)] @ op.model.coefficients
            fields[n, self.inner] += left.reshape(-1, 2)
            gap, weight = (fields[n] - given)[self.inner].ravel(), self.weight[n]
            slopes[n] = J
            equations[n] = np.column_stack(compressed(J * weight[:, None], gap * weight))
        return Place(x, fields, slopes, equations)

    def descended(
        self,
        c: np.ndarray,
        most_steps: int,
        tolerance: float,
        progress: bool | str,
        start: np.ndarray | None = None,
    ) -> DisplacementFit:
        """Run the search from coefficients c, and from fields, by default the measured ones."""
        name = progress if isinstance(progress, str) else "Gauss-Newton"
        bar = tqdm(range(TRIES * most_steps), desc=name, disable=not progress, leave=False)
        fields = self.data if start is None else start
        place = self.settled(np.append(c, self.rest), fields, range(len(fields)))
        if not place.equations:
            raise NoEquilibriumError("no frame has an equilibrium with the first coefficients")
        damping, history = DAMPING[2], [place.rms]
        for _ in bar:
            promise, least = place.loss(self.step(place, DAMPING[0])), place.loss()
            if place.rms <= NO_ERROR or promise > (1 - tolerance) * least:
                break
            there = self.moved(place, self.step(place, damping))
            if there.equations.keys() == place.equations.keys() and there.loss() < least:
                place, damping = there, max(damping / 10, DAMPING[0])
                history.append(place.rms)
                bar.set_postfix(error=f"{100 * place.rms:.3f} %")
            elif (damping := max(100 * damping, DAMPING[1])) > MOST_DAMPING:
                break
        each = [*place.equations] if len(place.equations) > 1 else []
        others = [self._fit(place, [n]) for n in each]
        return replace(self._fit(place, []), history=history, others=others, fields=place.fields)

    def _fit(self, place: Place, left: list[int]) -> DisplacementFit:
        """The fit at a state, or one step on with some frames left out, in the scale of forces."""
        errors = np.full(len(self.data), np.inf)
        change = self.step(place, DAMPING[1], left) if left else 0 * place.x
        errors[[*place.equations]] = place.errors(change)
        solid, thickness = self.sheet(place.x + change)
        scale, scatter = self._scale(left, solid, thickness)
        solid = replace(
            solid,
            coefficients=scale * solid.coefficients,
            stretch=self.op.largest_stretch(self.data),
            provenance={} if len(self.pull) else NO_FORCE,
        )
        left = [*(n for n in range(len(errors)) if n not in place.equations), *left]
        rms = float(np.sqrt(np.delete(errors**2, left).mean()))
        return DisplacementFit(solid, errors, [rms], left, thickness, scale=scale, scatter=scatter)

    def _scale(
        self, left: list[int], solid: HyperelasticMaterial, thickness: ThicknessField | None
    ) -> tuple[float, float]:
        """Scale that pulls of frames not left out give to a stress of one, and its scatter."""
        if not len(self.pull):
            return 1.0, 0.0
        own = ~np.isin(self.pulled[:, 0], left)
        own |= not own.any()  # without its only force a fit has the scale of that
        lines = [self.sections[axis].stress(n, solid, thickness) for n, axis in self.pulled[own]]
        F, T = self.pull[own], np.array([line.mean() for line in lines])
        if not F @ T > 0:
            raise InputError(f"{PULL}: expected a pull with the sign of the sheet's stress")
        scale = float(F @ T) / float(T @ T)
        gaps = np.hypot(scale * np.array([line.std() for line in lines]), scale * T - F)
        return scale, float(np.linalg.norm(gaps) / np.linalg.norm(F))


INTERPOLATES = 50.0
"""Times as stiff as the sheet at rest: such deviations fill in the collar as a stiff plate does."""
TEN = 10
"""Of what `check_enough` counts, for each number that is learned, at least."""
SMALL = 0.02
"""Of half of the nodes, E11, E22 or 2 E12: below it moduli are not determined."""
AFFINE = 1e-6
"""A set of frames whose distance from affine displacement is below this fraction says nothing."""


@typed
def fit_displacement(
    frames: Samples,
    dictionary: Hyperelastic,
    *,
    stiffness: NotNegative = 0.05,
    moving: bool = False,
    start: Any = None,
    thickness: int = 0,
    most_steps: Count = 15,
    tolerance: Share = 1e-4,
    progress: bool | str = False,
) -> DisplacementFit:
    """Learn a material from displacement on a lattice whose interior carries no load.

    Args:
        frames: samples without loads; the collar is data.
        dictionary: energies that are safe with coefficients ≥ 0.
        stiffness: least coefficient of the deviations, in units of the initial stiffness.
        moving: whether angles and exponents of fibres are unknowns too.
        start: coefficients to begin with, shape [K], or a fit of the same frames and energies;
            coefficients of least equation error where none.
        thickness: degree of the polynomial that is the logarithm of the sheet's thickness, (H18); 0
            for an even sheet.
        most_steps, tolerance: of Gauss and Newton, and the fraction of the loss that a step must
            take away to go on.
        progress: show a bar on stderr; a text is its name.

    Warns where deviations come out so stiff that they, and not a material, explain the frames.
    Raises InputError for frames with loads, affine frames, a frame at rest, fewer than ten measured
    components inside, of all frames, for each energy, energies that guarantee nothing, and numbers
    out of range; NoEquilibriumError where no frame has one at the start.
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
    search = Search(frames, dictionary, stiffness, moving, uneven)
    fields = None
    if isinstance(start, DisplacementFit):
        start, fields = search.scaled(start.material.coefficients), start.fields
    if start is None:
        c = search.equation_error()
    else:
        if np.shape(start) != (len(dictionary),):
            raise InputError(f"start: expected {len(dictionary)} coefficients, got {start!r:.60}")
        c = search.scaled(np.maximum(start, search.low[: len(start)]))
    fit = search.descended(c, most_steps, tolerance, progress, fields)
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
    """Fit the thickness (H18) of a sheet whose material is known, from its displacement.

    The coefficients stay, scaled to an initial stiffness of one; `degree` is that of the
    polynomial, the others are as in fit_displacement. Raises InputError for frames with loads,
    none, or at rest; NoEquilibriumError where no frame has one in an even sheet.
    """
    check_unloaded(frames)
    uneven = ThicknessField.over(frames.x, degree)
    search = Search(frames, solid.dictionary, 0.0, thickness=uneven, held=True)
    return search.descended(search.scaled(solid.coefficients), most_steps, tolerance, progress)


def check_enough(count: int, what: str, numbers: int) -> None:
    """Raise InputError for fewer than ten measured values (`what`) for each unknown."""
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
    op = sheet_on(Hyperelastic(terms=(EnergyTerm("plane_stress"),)), frames)
    strains = np.abs(op.strain(frames.u)[:, op.interior]).max(axis=-1)
    typical = float(np.median(strains, axis=1).max())
    if typical < SMALL:
        raise InputError(
            f"frames: expected strains of {100 * SMALL:g} % or more in one, got "
            f"{100 * typical:.2g} % at most nodes; below, noise decides on moduli, above all on "
            "that of the area (bulk)"
        )


def stiffest_deviation(fit: DisplacementFit) -> float:
    """Largest coefficient of the deviations, in units of the initial stiffness."""
    dictionary, c = fit.material.dictionary, fit.material.coefficients
    own = c[dictionary.first_deviation : dictionary.first_term]
    return float(own.max(initial=0.0)) / fit.scale
