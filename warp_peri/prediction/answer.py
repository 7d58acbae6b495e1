"""Predictions to a tolerance (Q1–Q5): solved by the cheapest member, corrected by the richest."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.linalg import norm
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from warp_peri.core.elastic import symmetric_part
from warp_peri.core.proof import prove, stencil_of
from warp_peri.errors import Arrays, InputError, Rows, Shown, Values
from warp_peri.materials.certificate import curvature_bound
from warp_peri.points.arguments import Positive, checked, checked_fields, typed, typed_methods
from warp_peri.points.points import PointsLike, Samples, nodes_of
from warp_peri.prediction.ensemble import (
    MOST,
    CalibrationFactors,
    EnsembleMaterial,
    EnsembleOperator,
    Measure,
    kelvin,
)
from warp_peri.problems import Dirichlet
from warp_peri.protocols import check_collar, placed

SOLVED, SHARE = 0.03, 0.3
"""The first linear solve goes to this relative residual, or to this share of the tolerance; the
correction sees what it leaves."""
SETTLED = 0.01
"""Without a tolerance corrections end where what is left is this share of all other parts."""
STALLED = 0.9
"""A correction larger than this times the one before does not lead on."""
SHORTER, STRAINED = 0.01, 1.2
"""Share of waves shorter than the data's, and strain over the data's where the rich member is
linear, from which the error does not speak of an answer."""
FAMILY = "an ensemble, as fit(samples, Ensemble(…)).material; one model knows nothing of its error"
ACCURATE = 1e-5
"""Relative residual of the one solve that the bound takes."""


@typed_methods
@dataclass(frozen=True, repr=False)
class ErrorBound(Shown):
    """Proven bound of a prediction's distance from the rich member's solution, not from the atoms.

    Attributes:
        energy: bound of ‖u_rich − u‖_L [√(stress · length)] on the interior, ‖v‖²_L = Σ v·L v.
        relative: the same over ‖u‖_L.
        contraction: q of the fixed point; 0 of a linear member.
        largest_gradient: bound of |H| of u_rich, below the proven strain.
        displacement: bound of ‖u_rich − u‖₂ over ‖u‖₂.
        statement: in one sentence.
    """

    energy: float
    relative: float
    contraction: float
    largest_gradient: float
    displacement: float
    statement: str

    def rows(self) -> Rows:
        names = "relative", "displacement", "contraction", "largest_gradient"
        return [("proven", self.statement), *((n, f"{getattr(self, n):.3g}") for n in names)]


def contraction(model: Any, gradient: float, size: float) -> tuple[float, float] | None:
    """Contraction q and a radius κ_in size/(1 − q) of gradients that no iterate leaves; or None."""
    names = "strain", "kappa_in", "kappa_out", "largest_parts"
    if not (all(name in model.proven for name in names) and model.stands):
        return None
    most, inner, outer, parts = (model.proven[name] for name in names)
    radius = gradient
    for _ in range(100):
        q = curvature_bound(parts, radius) * inner * outer
        if not (radius <= most and q < 1):
            return None
        needed = gradient + inner * size / (1 - q)
        if needed <= radius:
            return q, radius
        radius = 1.001 * needed
    return None


AXIS = "axis: the points do not state the direction of the crystal; its largest swing is a part"
WORDS = {
    "left": "what is left to correct",
    "waves": "waves",
    "data": "data",
    "strain": "strain beyond third order",
    "axis": "the direction of the crystal, which is not stated",
}


def said(error: float, form: str = "{:.2f}%") -> str:
    """Format an error in %, or say that it is unknown."""
    return "unknown" if np.isnan(error) else form.format(100 * error)


@dataclass(frozen=True)
class QuantityEstimate:
    """Value of a quantity, its likely error `bar`, and signed `correction` to the rich member's.
    Bars use the factors of whole fields, so that at a single place more than one value in ten may
    be further off."""

    value: ndarray
    correction: ndarray
    bar: ndarray


@typed_methods
@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Shown):
    """Displacement of a body at rest with its likely error.

    Attributes:
        u: displacement [length] on all nodes, shape [N, d].
        parts: likely error of u on the interior over u by origin: left, waves, data, strain, and
            axis where a crystal's direction is not stated; NaN where unknown, as of waves shorter
            than any of the data.
        uncovered: error sources that are not included.
        corrections: how often the rich member corrected.
        tolerance: that was asked for; None for the best.
        slowed: the second correction over the first, where both are known.
    """

    u: ndarray
    parts: dict[str, float]
    uncovered: tuple[str, ...]
    corrections: int
    tolerance: float | None
    operator: EnsembleOperator
    load: ndarray
    slowed: float

    @property
    def error(self) -> float:
        """Likely relative error, root sum of squares of `parts`; nine of ten are closer (Q4)."""
        return math.hypot(*self.parts.values())

    @property
    def _within(self) -> bool:
        return self.tolerance is None or self.error <= self.tolerance

    @property
    def kept(self) -> bool:
        """Whether the error is within the tolerance and no source but the axis is uncovered."""
        return self._within and all(one == AXIS for one in self.uncovered)

    @property
    def why(self) -> str:
        """One sentence on what was done and what most of the error is."""
        n, parts = self.corrections, self.parts
        way = "linear" + (f" and {n} nonlinear correction{'s' * (n != 1)}" if n else "")
        largest = max(parts, key=lambda name: (math.isnan(parts[name]), parts[name]))
        told = f"{way}; {said(self.error, '{:.2g} %')}, most of it {WORDS[largest]}"
        if not self._within:
            told += f"; {100 * (self.tolerance or 0):g} % is not kept"
        return told + "".join(f"; not covered: {one.split(':')[0]}" for one in self.uncovered)

    @cached_property
    def fields(self) -> Arrays:
        """Error fields on the interior by origin, computed on first use."""
        placed, left = self.operator, self.operator.correction(self.load, self.u)
        return placed.doubts(self.u, left, placed.recorded(self.u)[0], self.slowed)

    @property
    def corrected(self) -> ndarray:
        """Displacement with the remaining correction added, on all nodes."""
        return self._plus(self.fields["left"])

    def of(self, quantity: Callable[[ndarray], Any]) -> QuantityEstimate:
        """Estimate a quantity, a function of nodal displacements [N, d], with its error (Q4).
        warp_peri.prediction has strain and stress."""
        at = checked("quantity", quantity(self.u.copy())).copy()  # it may write, or give its own
        changes = {
            name: checked("quantity", quantity(self._plus(part)), shape=at.shape) - at
            for name, part in self.fields.items()
        }
        return QuantityEstimate(at, changes["left"], self._bar(changes))

    def map(self) -> ndarray:
        """Likely error of the displacement at each node [length], shape [N]; 0 on the collar. As of
        a quantity, more than one node in ten may be further off."""
        bar = np.zeros(len(self.u))
        sizes = {name: norm(part, axis=-1) for name, part in self.fields.items()}
        bar[self.operator.points.interior] = self._bar(sizes)
        return bar

    def _bar(self, sizes: Arrays) -> ndarray:
        """Likely error of numbers that error fields change by `sizes`; NaN where it is unknown."""
        bar = norm([*combined(sizes, self.operator.family.factors).values()], axis=0)
        return np.where(np.isnan(self.error), np.nan, bar)

    @cached_property
    def guarantee(self) -> ErrorBound | None:
        """Proven bound of the distance from the rich member's solution, or None (Q9)."""
        placed, u = self.operator, self.u
        operator = placed.rich
        points, inside = placed.points, placed.points.interior
        if not points.is_open_lattice:
            return None
        law = getattr(operator.model, "linear", operator.model)
        proof = prove(*stencil_of(law, points.spacing, "predict"))
        if not proof.holds:
            return None
        grid = points.lattice.steps[inside]
        sides = np.ptp(grid, axis=0) + 1  # of the box, whose Laplacian is softer
        laplacian = float(sum(4 * np.sin(np.pi / 2 / (n + 1)) ** 2 for n in sides))
        smallest = proof.proven * laplacian / points.spacing**2

        r, inner = self.load - operator(u), u[inside]
        e = placed.inverse(r, ACCURATE)
        le = placed.straight(operator.on_all(e))
        rest = r - le
        # r·L⁻¹r = e·Le + 2 e·rest + rest·L⁻¹rest, and L ≥ smallest
        square = np.vdot(e, le) + 2 * np.vdot(e, rest) + np.vdot(rest, rest) / smallest
        size = float(np.sqrt(max(square, 0.0)))
        q = largest = 0.0
        if placed.nonlinear:
            found = contraction(operator.model, float(operator.largest_gradient(u)), size)
            if found is None:
                return None
            q, largest = found
        stored = np.vdot(inner, placed.straight(operator.on_all(inner)))
        bound, whole = size / (1 - q), float(np.sqrt(max(stored, 0.0)))
        relative = bound / whole if whole > 0 else np.inf
        moved = bound / float(np.sqrt(smallest)) / max(float(norm(inner)), 1e-300)
        alone = f", and no other has |H| ≤ {largest:.2%}." if placed.nonlinear else "."
        words = (
            f"The model's own solution lies within {100 * relative:.2g} % of this answer in the "
            "energy norm, the root of twice the strain energy of their difference over that of the "
            f"answer{alone}"
        )
        return ErrorBound(bound, relative, q, largest, moved, words)

    def _plus(self, part: ndarray) -> ndarray:
        return self.u + self.operator.rich.on_all(part)  # type: ignore[no-any-return]

    def rows(self) -> Rows:
        parts = ", ".join(f"{name} {said(value)}" for name, value in self.parts.items() if value)
        rows = [("likely error", said(self.error)), ("of it", parts or "nothing")]
        if self.operator.points.axis is not None:
            rows.append(("axis", "stated, believed"))
        rows += [("not covered", one) for one in self.uncovered]
        return [*rows, ("why", self.why)]


def combined(sizes: Values, factors: CalibrationFactors) -> Values:
    """Combine sizes of error fields, or of what they change, to likely errors by origin (Q4)."""
    share = factors.floor / np.sqrt(2)
    weights = {"left": factors.left, "waves": share, "data": share, "strain": factors.floor}
    found = {name: weights.get(name, 1.0) * abs(size) for name, size in sizes.items()}
    if "moduli" in found:
        found["data"] = np.hypot(found["data"], found.pop("moduli"))
    return found


@typed
def strain(points: PointsLike, at: ArrayLike) -> Measure:
    """Make a measure of the strain ε at the nodes nearest to positions [m, d], shape [m, d, d]. By
    central differences. Raises InputError for scattered points, and nodes without neighbours."""
    nodes = nodes_of(points)
    if not nodes.spacing > 0:
        raise InputError("strain: expected a lattice, got scattered points")
    tree, steps = cKDTree(nodes.x), nodes.spacing * np.eye(nodes.dimension)
    middle = nodes.x[tree.query(checked("at", at, float, ("m", nodes.dimension)))[1]][:, None]
    off, (after, before) = tree.query(np.stack([middle + steps, middle - steps]))
    if (off > 1e-3 * nodes.spacing).any():
        raise InputError("strain: expected positions whose nodes have neighbours along the axes")

    def of(u: ndarray) -> ndarray:
        u = checked("u", u, float, nodes.x.shape)
        return symmetric_part((u[after] - u[before]) / (2 * nodes.spacing))

    return of


@typed
def stress(placed: EnsembleOperator, at: ArrayLike) -> Measure:
    """Make a measure of the rich member's stress at the nodes nearest to positions [m, d], shape
    [m, d, d]. Raises InputError where these are not interior."""
    nodes = placed.points
    near = cKDTree(nodes.x).query(checked("at", at, float, ("m", nodes.dimension)))[1]
    if not nodes.interior[near].all():
        raise InputError("stress: expected positions whose nearest nodes are interior")
    rows = np.cumsum(nodes.interior)[near] - 1
    return lambda u: placed.rich.stress(u)[rows]


@typed
def predict(
    material: Any, problem: Any, tolerance: Positive | None = 0.01, **options: Any
) -> Prediction | tuple[Prediction, ...]:
    """Predict a displacement within a tolerance at the least cost, with its likely error.

    Args:
        material: an ensemble, from fit(samples, prediction.Ensemble(…)), or its EnsembleOperator
            where the same points are asked again. A crystal of `fit_crystal` whose moduli have
            standard errors gives those alone, and says so.
        problem: Dirichlet(points, b, u).
        tolerance: largest displacement error, relative to the displacement of the interior; None
            for the best prediction.
        options: of the material's `on`: transfer, allow_uncertified.

    Returns a prediction, or one for each of several loads; `kept` tells whether within the
    tolerance. Raises InputError for a material that is no ensemble, other problems, and as `solve`.

    >>> ensemble = wp.fit(samples, Ensemble(wp.LPS(12.5, wp.Bernstein(3)))).material
    >>> bool(wp.predict(ensemble, wp.Dirichlet(points, b[0], u[0]), tolerance=0.05).kept)
    True
    """
    record = getattr(material, "provenance", {})
    if record.get("moduli_error") and not isinstance(material, EnsembleMaterial):
        plain = CalibrationFactors(1.0, 1.0, 0.0)
        material = EnsembleMaterial(material, material, (material, material), factors=plain)
    if not isinstance(problem, Dirichlet | Samples):  # of others more than u and b counts
        raise InputError(
            f"predict: expected a problem, Dirichlet(points, b, u), got {type(problem).__name__}"
        )
    points = problem.points
    check_collar(nodes_of(points))
    asked = {"verb": "predict", "by": "ensemble_on", "has": "doubts", "kinds": FAMILY}
    members = placed(material, nodes_of(points), **asked, **options)
    load, field = checked_fields(members.points, problem.b, problem.u)
    uncovered = _uncovered(members, points)
    flat = [each.reshape(-1, *members.points.x.shape) for each in (load, field)]
    members.loads = max(members.loads, len(flat[0]))
    answers = [_answer(members, b, u, tolerance, uncovered) for b, u in zip(*flat)]
    return tuple(answers) if load.ndim == 3 else answers[0]


def _answer(
    placed: EnsembleOperator,
    b: ndarray,
    given: ndarray,
    tolerance: float | None,
    uncovered: tuple[str, ...],
) -> Prediction:
    """Solve by the linear part, and correct until the tolerance is kept or cannot be."""
    inside, load, factors = placed.points.interior, placed.rich.rhs(b), placed.family.factors
    u = np.where(inside[:, None], 0.0, given)
    to = SOLVED if tolerance is None else min(SOLVED, SHARE * tolerance)
    u[inside] = placed.inverse(load - placed.straight(u), to)
    told, unseen = placed.recorded(u)
    before, slowed, earlier, start = math.inf, 0.0, (u, u[inside], 0), u[inside]
    bent = None if placed.nonlinear else placed.bent(u)

    def share(field: ndarray | None) -> float:
        return 0.0 if field is None else float(norm(field) / (norm(u[inside]) or 1.0))

    def judged(u: ndarray, left: ndarray, done: int) -> Prediction:
        fields = placed.doubts(u, left, told, slowed)
        sizes = {"strain": 0.0} | {name: share(part) for name, part in fields.items()}
        parts = combined(sizes, factors)
        return Prediction(u, parts, uncovered, done, tolerance, placed, load, slowed)

    for done in count():
        left = placed.correction(load, u)
        moved = share(left)
        slowed = max(slowed, moved / before) if done == 1 else slowed
        if told is not None and tolerance is not None and placed.turned is None:
            bent = start - u[inside] - left if placed.nonlinear else bent
            screen = {  # of the record alone, which asks no member: it may suffice (Q5)
                "left": factors.left * moved,
                "waves": factors.floor * told,
                "data": placed.family.moduli_error,
                "strain": factors.floor * placed.series(placed.gradient(u), slowed) * share(bent),
            }
            found = Prediction(u, screen, uncovered, done, tolerance, placed, load, slowed)
            if found.error <= tolerance:
                break
        last = done == MOST or moved > STALLED * before
        if tolerance is None or factors.left * moved <= tolerance or last:
            found = judged(u, left, done)
            floor = math.hypot(*(part for name, part in found.parts.items() if name != "left"))
            if tolerance is None:
                enough = found.parts["left"] <= SETTLED * floor
            else:  # or what is left is not what keeps it from being kept
                enough = found.error <= tolerance or (floor > tolerance and done > 0)
            if enough or last:
                break
        earlier, before, u = (u, left, done), moved, u.copy()
        u[inside] += left
    found = found if moved <= before else judged(*earlier)  # the last correction led away
    beyond = _beyond(placed, found.u, unseen)
    parts = found.parts | {part: math.nan for part, _ in beyond if part}
    return replace(found, parts=parts, uncovered=uncovered + tuple(why for _, why in beyond))


def _uncovered(placed: EnsembleOperator, points: Any) -> tuple[str, ...]:
    """Error sources of a problem that the prediction does not include."""
    found = []
    if placed.family.second is placed.family.rich:
        found.append("waves: force constants alone determine the error of the moduli, and no other")
    if placed.points.outside is not None:
        found.append("free edges: the ensemble was learned inside a body; atoms at an edge differ")
        found.append("broken bonds: the ensemble knows none")
    if placed.turned is not None and placed.points.axis is None:
        found.append(AXIS)
    there, mine = kelvin(points), placed.family.temperature
    if not (there is None or mine is None or np.allclose(there, mine)):
        found.append(f"temperature: learned at {mine:g} K, asked at {np.max(there):g} K")
    return tuple(found)


def _beyond(placed: EnsembleOperator, u: ndarray, unseen: float) -> Rows:
    """Parts of the error that are unknown, each with the limit of the data that is exceeded."""
    found = []
    if unseen > SHORTER:
        found.append(("waves", "short waves: shorter than any that the ensemble learned from"))
    known = placed.family.strain
    if not placed.nonlinear and known > 0:
        strain = placed.gradient(u)
        if placed.grid is None:
            found.append(("strain", "strain: nothing in the ensemble tells what its law misses"))
        elif strain > STRAINED * known:
            words = f"strain: {strain:.2%} is beyond the {known:.2%} of the data of a linear law"
            found.append(("", words))
    return found
