"""Fits of a sheet's energies, fibres and thickness to loads (H11), or to displacement alone (H12),
whose slopes are (H13)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.linalg import lstsq, norm
from scipy.ndimage import binary_dilation, binary_erosion
from scipy.optimize import lsq_linear
from tqdm import tqdm

from warp_peri.core.stencil import numbers_at
from warp_peri.errors import InputError, quietly, warn
from warp_peri.fitting.regression import compressed, relative
from warp_peri.materials.hyperelastic.energies import NEAREST, EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.fibres import (
    ThicknessField,
    fibre_families,
    fibre_fan,
    fibre_numbers,
    fibres_of,
    with_numbers,
)
from warp_peri.materials.hyperelastic.operator import (
    HyperelasticMaterial,
    HyperelasticSheetOperator,
    check_explained,
)
from warp_peri.points import arguments
from warp_peri.points.arguments import Count, Natural, NotNegative, Share, checked, typed
from warp_peri.points.dataset import seen_of, warn_of_unseen
from warp_peri.points.points import PULL, Points, PointsLike, Samples
from warp_peri.solvers.equilibria import Descent, NoEquilibriumError


def sheet_on(dictionary: Hyperelastic, points: PointsLike) -> HyperelasticSheetOperator:
    """Build the sheet operator of all energies with coefficient one."""
    one = np.ones(len(dictionary))
    return HyperelasticMaterial(dictionary, one, points.spacing, units=points.units).on(points)


class Sections:
    """Lines of nodes across a sheet from edge to edge, with 2δ of such lines around; InputError
    where there is none. Beyond the edges displacement is mirrored."""

    def __init__(self, frames: Samples, dictionary: Hyperelastic, axis: int) -> None:
        R, turn, origin = 2 * int(dictionary.reach), [axis, 1 - axis], frames.x.min(axis=0)
        line, place = np.rint((frames.x - origin) / frames.spacing).astype(int)[:, turn].T
        number = numbers_at((line.max() + 1, place.max() + 1), (line, place))
        lines = binary_erosion((number >= 0).all(axis=1), iterations=R)
        if not lines.any():
            raise InputError(
                f"{PULL}: expected lines of nodes across {'xy'[axis]} from edge to edge of the "
                f"sheet, with {R} such lines on both sides, got none; a hole or the outline cuts "
                "them, and no other mean is the force over width and thickness"
            )
        near, width = np.flatnonzero(binary_dilation(lines, iterations=R)), number.shape[1]
        steps = np.array([(a, b) for a in near for b in range(-R, width + R)])
        own = lines[steps[:, 0]] & (steps[:, 1] >= 0) & (steps[:, 1] < width)
        x = origin + frames.spacing * steps[:, turn]
        points = Points(x, own, frames.spacing, units=frames.units)
        self.op, self.axis, self.shape = sheet_on(dictionary, points), axis, (-1, width)
        around = ((0, 0), (0, 0), (R, R), (0, 0))
        fields = np.pad(frames.u[:, number[near]], around, "reflect", reflect_type="odd")
        self.fields = fields.reshape(len(frames), -1, 2)

    def stress(
        self, n: int, solid: HyperelasticMaterial, thickness: ThicknessField | None
    ) -> ndarray:
        """Pull over width and mean thickness on every line of frame n, [L]; without deviations."""
        c, of_nodes = solid.coefficients.copy(), None
        c[: solid.dictionary.first_term] = 0.0
        if thickness is not None:
            of_nodes = thickness.at(self.op.points.x)
            of_nodes /= of_nodes[self.op.interior].mean()
        op = self.op.changed(replace(solid, coefficients=c), of_nodes)
        P = op.stress(self.fields[n])[:, self.axis, self.axis].reshape(self.shape)
        return np.asarray((P[:, :-1] + P[:, 1:]).mean(axis=1) / 2)


RIDGE = 1e-9
"""Of the squared length of the scaled coefficients, relative to the data."""
SCALE_WEIGHT = 1e3
"""Of the equation that fixes the initial stiffness, before it is met exactly."""
DAMPING, MOST_DAMPING = (1e-9, 1e-6, 1e-3), 1e3
"""Of Levenberg: least, that of a step from the optimum, first; that of the last that is tried."""
TRIES = 4
"""Steps that are tried for each that is asked for, those with more damping included."""
NO_ERROR = 1e-8
"""Of samples that no unknowns could fit better."""
STIFFEN = 30.0
"""Largest ratio of a deviation that is stiffer than the sheet at rest to itself before a step."""
SETTLED = 1e-4
"""Residual of equilibria, over the largest force, that one more step of Newton's takes away."""
NO_FORCE = {"stresses": "scaled to a stiffness of one at rest, no force is known"}
TURN, GROWTH, THICKEN = 0.2, 1.0, 0.5
"""Largest change of an angle [rad], an exponent and a number of the thickness in one step."""


@arguments.typed_methods
@dataclass(frozen=True, eq=False)
class SheetFit:
    """A material fitted to loads, or to displacement: known up to its scale where no frame has a
    pull, and then with an initial stiffness (H14) of one.

    Attributes:
        material: the material.
        errors: relative error of every training sample, of its load or its solved displacement.
        history: root mean square of those errors after every step.
        frames_left_out: frames without an equilibrium at the start, on which it does not stand.
        thickness: of the sheet, where it was an unknown.
        others: the same with each frame left out in turn, by one Gauss-Newton step from here, with
            the errors that its linear equations tell.
        fields: solved displacement of every training frame, shape [S, N, 2].
        scale: by what frames with a PULL say; one where none has.
        scatter: relative, of what sections and frames say that it is.
        guaranteed: whether all coefficients keep bounds ≥ 0, so that (H9) holds.
    """

    material: HyperelasticMaterial
    errors: ndarray
    history: list[float]
    frames_left_out: list[int]
    thickness: ThicknessField | None = None
    others: list[SheetFit] = field(default_factory=list)
    fields: ndarray | None = None
    scale: float = 1.0
    scatter: float = 0.0
    guaranteed: bool = True

    @property
    def residual(self) -> float:
        """Root mean square of the relative errors."""
        return self.history[-1]

    @property
    def stiffest_deviation(self) -> float:
        """Largest coefficient of the deviations, in units of the initial stiffness."""
        first = self.material.dictionary.first_term
        return float(self.material.coefficients[:first].max(initial=0.0)) / self.scale


@dataclass(frozen=True, eq=False)
class Place:
    """State of a search: unknowns, fields and the equations linearised.

    Attributes:
        x: coefficients, angles and exponents of fibres, numbers of the thickness, shape [T].
        fields: of all samples, shape [S, N, 2]: measured with loads, else in equilibrium.
        slopes: of displacement inside by unknowns, [2 I, T], by frame that has an equilibrium.
        equations: by sample, rows whose squared sum is the loss: slopes, and errors as they are.
    """

    x: ndarray
    fields: ndarray
    slopes: dict[int, ndarray]
    equations: dict[int, ndarray]

    def errors(self, change: Any = 0.0) -> ndarray:
        """Relative errors of the samples after a change of the unknowns, to first order."""
        moved = np.append(change + 0 * self.x, 1.0)
        return np.array([norm(rows @ moved) for rows in self.equations.values()])

    def loss(self, change: Any = 0.0) -> float:
        """Sum of squared errors after a change of the unknowns."""
        return float((self.errors(change) ** 2).sum())

    @property
    def rms(self) -> float:
        """Root mean square of the relative errors."""
        return float(np.sqrt(self.loss() / len(self.equations)))


class Search:
    """Gauss-Newton-Levenberg search for coefficients ≥ `least` (deviations ≥ `stiffness`), numbers
    of `moving` fibres, and a thickness."""

    def __init__(
        self,
        samples: Samples,
        dictionary: Hyperelastic,
        stiffness: float,
        moving: bool = False,
        thickness: ThicknessField | None = None,
        *,
        least: float = 0.0,
    ) -> None:
        self.data, self.thickness, self.op = samples.u, thickness, sheet_on(dictionary, samples)
        self.inner, self.by_load = self.op.interior, samples.b is not None
        target = (samples.loads if self.by_load else samples.u)[:, self.inner]
        if self.by_load:
            warn_of_unseen(samples)
        self.target = target.reshape(-1, 2 * len(self.inner))
        seen = np.repeat(seen_of(samples)[:, self.inner], 2, axis=1) | self.by_load
        size = norm(self.target * seen, axis=1)
        if not (len(size) and size.all()):
            what = "a load on it" if self.by_load else "a displacement of it"
            raise InputError(
                "samples: expected one or more, an interior in each and "
                f"{what}, got {f'none in number {size.argmin()}' if len(size) else 'no sample'}; "
                "without loads at all, leave b out"
            )
        self.weight = seen / size[:, None]
        pull = arguments.plain(PULL, samples.arrays.get(PULL, np.full((len(samples), 2), np.nan)))
        pull = checked(PULL, pull, float, (len(samples), 2), np.equal(pull, pull))
        self.pulled = np.argwhere(~np.isnan(pull) & (not self.by_load))
        self.pull = pull[*self.pulled.T]
        self.sections = {axis: Sections(samples, dictionary, axis) for axis in {*self.pulled[:, 1]}}
        self.measure, K = dictionary.stiffness, len(dictionary)
        self.moving = fibres_of(dictionary) if moving else []
        fibres, (low, high) = fibre_numbers(dictionary, self.moving)
        thick = np.zeros(0) if thickness is None else thickness.numbers
        none = np.full(len(thick), np.inf)
        self.low = np.concatenate([np.full(K, least), low, -none])
        self.low[: dictionary.first_term] = stiffness or least
        self.high = np.concatenate([np.full(K, np.inf), high, none])
        turns = np.repeat([TURN, GROWTH], len(self.moving))
        self.reach = np.concatenate([np.full(K, np.inf), turns, np.minimum(none, THICKEN)])
        self.rest = np.append(fibres, thick)

    def scaled(self, c: ndarray) -> ndarray:
        """The coefficients scaled to an initial stiffness of one."""
        size = float(self.measure @ c)
        if not size > 0:
            raise InputError("coefficients: expected an initial stiffness > 0")
        return c / size

    def begun(self, start: Any) -> Place:
        """State to begin with, its coefficients kept to their bounds: of a fit, of coefficients, or
        by default of the least ones, without loads of those of least internal force on the measured
        fields, which are biased under noise."""
        K, low, fields = len(self.measure), self.low[: len(self.measure)], self.data
        if isinstance(start, SheetFit):
            fields = fields if start.fields is None else start.fields
            start = start.material.coefficients
        if start is not None or self.by_load:
            start = 0.0 if start is None else checked("start", start, shape=(K,))
            linear = self.by_load and not len(self.rest)  # a start would only pull at it
            c = np.maximum(0.0 if linear else start, low)
            c = c if self.by_load else self.scaled(c)
        else:
            x = np.append(self.scaled(self.measure), self.rest)
            none, rows = ((0, 0), (0, len(self.rest))), dict[int, ndarray]()
            for n, u in enumerate(fields):
                F = np.pad(self.op.features(u).reshape(-1, K), none)  # fibres and thickness stay
                rows[n] = self._rows(n, F, F @ x)
            place = Place(x, fields, {}, rows)
            c = (x + self.step(place, DAMPING[0]))[:K]
        place = self.settled(np.append(c, self.rest), fields, range(len(fields)))
        if not place.equations:
            raise NoEquilibriumError("no frame has an equilibrium with the first coefficients")
        return place

    def _rows(self, n: int, J: ndarray, gap: ndarray) -> ndarray:
        """Equations J dx + gap = 0 of a sample, in its error, as few as have the same squares."""
        weight = self.weight[n]
        if not np.isfinite(J).all():
            raise InputError(f"samples: sample {n} folds the sheet; is a point of it far off?")
        return np.column_stack(compressed(J * weight[:, None], gap * weight))

    def sheet(self, x: ndarray) -> tuple[HyperelasticMaterial, ThicknessField | None]:
        """The material and the thickness of the unknowns x."""
        K, thickness = len(self.measure) + 2 * len(self.moving), self.thickness
        if thickness is not None:
            thickness = replace(thickness, numbers=x[K:])
        return with_numbers(self.op.model, self.moving, x[:K]), thickness

    def step(self, place: Place, damping: float, left: Sequence[int] = ()) -> ndarray:
        """Change of the unknowns that meets the equations best between their bounds, some samples
        left out, damped by Levenberg; without loads the initial stiffness stays one."""
        rows = np.concatenate([one for n, one in place.equations.items() if n not in left])
        J, x, K = rows[:, :-1], place.x, len(self.measure)
        low, high = np.maximum(self.low, x - self.reach), np.minimum(self.high, x + self.reach)
        length = norm(J, axis=0)
        length[length == 0] = 1.0
        A = [J / length, np.sqrt(damping) * np.eye(len(x))]
        right = [J @ x - rows[:, -1], np.sqrt(damping) * length * x]
        if not self.by_load:
            first = self.op.model.dictionary.first_term
            high[:first] = STIFFEN * np.maximum(x[:first], 1.0)
            held = np.append(self.measure / self.measure.max(), 0 * self.rest)
            A.append(SCALE_WEIGHT * np.abs(J).max() * held[None] / length)
            right.append(A[-1] @ (length * x))
        bounds = low, np.maximum(high, low + 1e-9)
        within = [bound * length for bound in bounds]
        how = {"method": "bvls", "max_iter": 10 * len(x)}
        x_scaled = lsq_linear(np.concatenate(A), np.concatenate(right), within, **how).x
        found = np.clip(x_scaled / length, *bounds)
        if not self.by_load:
            found[:K] = self.scaled(np.maximum(found[:K], 0.0))
        return np.asarray(found - x)

    def moved(self, place: Place, change: ndarray) -> Place:
        """State of the search after a change of the unknowns."""
        fields = place.fields.copy()
        for n, J in place.slopes.items():
            fields[n, self.inner] += (J @ change).reshape(-1, 2)
        return self.settled(place.x + change, fields, place.equations)

    def settled(self, x: ndarray, fields: ndarray, samples: Iterable[int]) -> Place:
        """State with the equations of samples: by load at their fields, else in equilibria from
        fields near them, and none without one."""
        (solid, thickness), fields, K = self.sheet(x), fields.copy(), len(self.measure)
        nodes = self.op.points.x
        op = self.op.changed(solid, None if thickness is None else thickness.at(nodes))
        slopes, equations = dict[int, ndarray](), dict[int, ndarray]()
        for n in samples:
            u, inverse = (fields[n], None) if self.by_load else self._rest(op, fields[n], n)
            if u is None:
                continue
            F = [op.features(u, self.moving)]
            if thickness is not None:
                F.append(op.by_thickness(u, thickness.slopes(nodes)))
            J = np.concatenate(F, axis=-1).reshape(2 * len(self.inner), -1)
            at = J[:, :K] @ solid.coefficients  # the force is linear in the coefficients
            if inverse:  # and so is what Newton's step has left
                slopes[n] = J = -inverse(J)
                fields[n] = u
                fields[n, self.inner] += (J[:, :K] @ solid.coefficients).reshape(-1, 2)
                at = fields[n, self.inner].ravel()
            equations[n] = self._rows(n, J, at - self.target[n])
        return Place(x, fields, slopes, equations)

    def _rest(self, op: HyperelasticSheetOperator, start: ndarray, n: int) -> tuple[Any, Any]:
        """Equilibrium of a frame near a start and the inverse of a tangent there, or None."""
        near = op.factors(start)[0] if op.folds(start) < np.inf else None
        u, record = Descent(op).find(0 * start[self.inner], self.data[n], SETTLED, start, near)
        inverse = record.converged and (near or op.factors(u)[0])
        return (u, inverse) if inverse else (None, None)

    def descended(
        self, place: Place, most_steps: int, tolerance: float, progress: bool | str
    ) -> tuple[Place, list[float]]:
        """Run the search from a state; the last state and the errors after every step."""
        name = progress if isinstance(progress, str) else "Gauss-Newton"
        bar = tqdm(range(TRIES * most_steps), desc=name, disable=not progress, leave=False)
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
        return place, history

    def fit(self, place: Place, left: Sequence[int] = ()) -> SheetFit:
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
            provenance={} if self.by_load or len(self.pull) else NO_FORCE,
        )
        left = [*np.flatnonzero(np.isinf(errors)).tolist(), *left]
        rms = float(np.sqrt(np.delete(errors**2, left).mean()))
        return SheetFit(solid, errors, [rms], left, thickness, scale=scale, scatter=scatter)

    def _scale(
        self, left: Sequence[int], solid: HyperelasticMaterial, thickness: ThicknessField | None
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
        return scale, relative(gaps, F)


INTERPOLATES = 50.0
"""Times as stiff as the sheet at rest: such deviations fill in the collar as a stiff plate does."""
TEN = 10
"""Of what `check_enough` counts, for each number that is learned, at least."""
SMALL = 0.02
"""Of half of the nodes, E11, E22 or 2 E12: below it moduli are not determined."""
AFFINE = 1e-6
"""A set of frames whose distance from affine displacement is below this fraction says nothing."""
LEAST_STIFFNESS = 0.05
"""Of deviations without loads, in units of the initial stiffness."""


@typed
def fit_sheet(
    samples: Samples,
    dictionary: Hyperelastic,
    *,
    positive: bool = False,
    stiffness: NotNegative | None = None,
    moving: bool = False,
    start: Any = None,
    thickness: Natural = 0,
    most_steps: Count = 15,
    tolerance: Share = 1e-4,
    progress: bool | str = False,
) -> SheetFit:
    """Fit a dictionary of energies to displacement and loads on a lattice, or to displacement
    alone where the samples have no loads: the interior then carries none, and the collar is data.

    Args:
        samples: the data; frames that have a "pull" say the scale where there are no loads.
        dictionary: of energies.
        positive: coefficients ≥ 0, as they always are without loads; else of any sign.
        stiffness: least coefficient of the deviations, against hourglasses: with loads [stress], 0
            by default; without in units of the initial stiffness, 0.05 by default.
        moving: whether angles and exponents of fibres are unknowns too.
        start: coefficients to begin with, shape [K], or a fit of the same frames and energies; by
            default the least, without loads those of least equation error; linear fits need none.
        thickness: degree of the polynomial that is its logarithm, (H18); 0 for an even sheet.
        most_steps, tolerance: of Gauss and Newton; the part of the loss that a step must take away.
        progress: show a bar on stderr; a text is its name.

    Warns where deviations, and not a material, explain the frames, and where much of the loads is
    left. Raises InputError for no samples, one without a load or at rest, loads that are left
    whole, numbers out of range; without loads for affine frames, strains below 2 %, fewer than ten
    measured components inside for each energy; NoEquilibriumError where no frame has one at first.
    """
    by_load = samples.b is not None
    positive |= not by_load
    uneven = ThicknessField.over(samples.x, thickness) if thickness else None
    if stiffness is None:
        stiffness = 0.0 if by_load else LEAST_STIFFNESS
    least = 0.0 if positive else -np.inf
    search = Search(samples, dictionary, stiffness, moving, uneven, least=least)
    if not by_load:
        check_identifiable(samples, search.op)
    place = search.begun(start)
    if by_load and not (moving or thickness):  # linear
        place, most_steps = search.moved(place, search.step(place, RIDGE)), 0
    place, history = search.descended(place, most_steps, tolerance, progress)
    fit, each = search.fit(place), [] if by_load or len(place.equations) == 1 else place.equations
    others = [search.fit(place, [n]) for n in each]
    solved = None if by_load else place.fields
    fit = replace(fit, history=history, others=others, fields=solved, guaranteed=positive)
    if by_load:
        check_explained(fit.residual)
    elif (stiffest := fit.stiffest_deviation) > INTERPOLATES:
        warn(
            f"deviations came out {stiffest:.0f} times as stiff as the sheet at rest: they "
            "interpolate the collar, whatever the material; is the sheet heterogeneous "
            "(thickness=), or were the frames smoothed?"
        )
    return fit


def check_enough(count: int, what: str, numbers: int) -> None:
    """Raise InputError for fewer than ten measured values (`what`) for each unknown."""
    if count < TEN * numbers:
        raise InputError(
            f"frames: expected {TEN * numbers} {what} for {numbers} numbers, got {count}"
        )


def check_identifiable(frames: Samples, op: HyperelasticSheetOperator) -> None:
    """Raise InputError where any homogeneous body could have moved so, the strain is small, or too
    little is measured for so many unknowns."""
    design = np.column_stack([np.ones(len(frames.x)), frames.x])
    u = np.moveaxis(frames.u, 0, 1).reshape(len(frames.x), -1)
    rest = u - design @ lstsq(design, u)[0]
    rest, size = (norm(v.reshape(len(v), -1, 2), axis=(0, 2)) for v in (rest, u))
    if not (rest > AFFINE * size).any():
        raise InputError(
            "frames: expected displacement that is not affine; a homogeneous body of any material "
            "follows affine edges, so that such frames say nothing about it"
        )
    typical = np.median(np.abs(op.strain(frames.u)[:, op.interior]).max(axis=-1), axis=1).max()
    if typical < SMALL:
        raise InputError(
            f"frames: expected strains of {100 * SMALL:g} % or more in one, got "
            f"{100 * typical:.2g} % at most nodes; below, noise decides on moduli, above all on "
            "that of the area (bulk)"
        )
    measured = 2 * int(np.count_nonzero(seen_of(frames)[:, frames.interior]))
    check_enough(measured, "measured components inside", len(op.model.coefficients))


ENOUGH = 40
"""Samples that the directions are sought on; all are used for the coefficients at the end."""


@typed
def fit_fibre_families(
    samples: Samples,
    *,
    matrix: Sequence[str] = ("neo_hookean", "volumetric"),
    deviations: tuple[tuple[int, int], ...] = NEAREST,
    stiffness: NotNegative = 0.0,
    directions: Count = 16,
    most_steps: Count = 12,
) -> HyperelasticMaterial:
    """Fit a material of few parameters: matrix moduli, fibre families with direction, k1, k2.

    A fit on many directions says where the families are; then angles and exponents are unknowns of
    a Gauss–Newton method, and families that meet become one.

    Args:
        samples: with loads.
        matrix: kinds of the energies beside the fibres.
        deviations, stiffness: as of Hyperelastic, and their least coefficient.
        directions, most_steps: of the first fit, and of Gauss and Newton.
    """
    few = Samples(samples.points, samples.u[:ENOUGH], samples.loads[:ENOUGH])
    terms = (*map(EnergyTerm, matrix), *fibre_fan(directions))
    how: Any = {"stiffness": stiffness, "positive": True}
    search: Any = {"moving": True, "most_steps": most_steps, "tolerance": TOLERANCE, **how}
    with quietly():  # the last fit says what is left
        solid = fit_sheet(few, Hyperelastic(3.0, deviations, terms), **how).material
        for within, share in ((1.6 * np.pi / directions, 0.02), (0.1, 0.01)):
            dictionary, c = fibre_families(solid, within=within, share=share)
            solid = fit_sheet(few, dictionary, start=c, **search).material
    return fit_sheet(samples, solid.dictionary, **how).material.sparse


TOLERANCE = 1e-5
"""Fraction of the loss that a step must take away where families are sought."""
