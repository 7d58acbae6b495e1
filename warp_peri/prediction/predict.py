"""A tolerance in, an answer with its error out (theory, Q1–Q5).

The cheapest member is solved, the richest is evaluated, never solved: what its residual asks for is
both the estimate and the improvement.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arguments import Positive, checked_fields, typed
from warp_peri.points.points import Samples, nodes_of
from warp_peri.prediction.answer import AXIS, Prediction, combined
from warp_peri.prediction.ensemble import MOST, CalibrationFactors, EnsembleMaterial
from warp_peri.prediction.members import EnsembleOperator, norm
from warp_peri.protocols import placed

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
FREE_EDGE = "free edges: the ensemble was learned inside a body, and atoms at an edge differ"
BROKEN = "broken bonds: the ensemble knows none"
ALONE = "waves: force constants alone determine the error of the moduli, and no other"


@typed
def predict(
    material: Any, problem: Any, tolerance: Positive | None = 0.01, **options: Any
) -> Prediction | tuple[Prediction, ...]:
    """The cheapest answer that keeps a tolerance, and how wrong it is.

    Args:
        material: an ensemble, from fit(samples, prediction.Ensemble(…)), or its EnsembleOperator
            where the same points are asked again. A crystal of `fit_crystal` whose moduli have
            standard errors gives those alone, and says so.
        problem: Dirichlet(points, b, u).
        tolerance: largest displacement error, relative to the displacement of the interior; None
            for the best answer, with its error.
        options: of the material's `on`: transfer, allow_uncertified.

    Returns an answer, or one for each of several loads; one whose tolerance is not kept says so.
    Raises InputError for a material that is no ensemble, a problem of another kind, and whatever
    `solve` refuses.

    >>> ensemble = wp.fit(samples, Ensemble(wp.LPS(12.5, wp.Bernstein(3)))).material
    >>> bool(wp.predict(ensemble, wp.Dirichlet(points, b[0], u[0]), tolerance=0.05).kept)
    True
    """
    record = getattr(material, "provenance", {})
    if record.get("moduli_error") and not isinstance(material, EnsembleMaterial):
        plain = CalibrationFactors(1.0, 1.0, 0.0)
        material = EnsembleMaterial(material, material, (material, material), factors=plain)
    if not all(hasattr(problem, name) for name in ("points", "b", "u")):
        what = type(problem).__name__
        raise InputError(f"predict: expected a problem, Dirichlet(points, b, u), got {what}")
    points = problem.points
    asked = {"verb": "predict", "by": "ensemble_on", "has": "doubts", "kinds": FAMILY}
    members = placed(material, nodes_of(points), **asked, **options)
    load, field = checked_fields(members.points, problem.b, problem.u)
    uncovered = _uncovered(members, points)
    flat = [each.reshape(-1, *members.points.x.shape) for each in (load, field)]
    members.loads = max(members.loads, len(flat[0]))
    noise = _noise(points, len(field) if field.ndim == 3 else 1)
    answers = tuple(
        _predict(members, b, u, tolerance, uncovered, n) for b, u, n in zip(*flat, noise)
    )
    return answers if load.ndim == 3 else answers[0]


def _predict(
    placed: EnsembleOperator,
    b: np.ndarray,
    given: np.ndarray,
    tolerance: float | None,
    uncovered: tuple[str, ...],
    noise: float,
) -> Prediction:
    """The answer for one load: a linear solve, and corrections."""
    inside, load = placed.points.interior, placed.rhs(b)
    share = SOLVED if tolerance is None else min(SOLVED, SHARE * tolerance)
    start = np.where(inside[:, None], 0.0, given)
    start[inside] = placed.inverse(load - placed.straight(start), share)
    told, unseen = placed.recorded(start)
    first = Prediction(start, {"noise": noise}, uncovered, 0, tolerance, placed, load)
    found = _corrected(first, told)
    beyond = _beyond(placed, found.u, unseen)
    unknown = {part: math.nan for part, _ in beyond if part}
    return replace(
        found, parts=found.parts | unknown, uncovered=uncovered + tuple(why for _, why in beyond)
    )


def _corrected(first: Prediction, told: float | None) -> Prediction:
    """Correct until the tolerance is kept, or cannot be; without one until nothing improves.

    Args:
        first: the linear answer, with the part that noise has.
        told: error of such fields by the record.
    """
    placed, load, tolerance, u = first.operator, first.load, first.tolerance, first.u
    factors, inside, noise = placed.family.factors, placed.points.interior, first.parts["noise"]
    before, slowed, least, best = math.inf, 0.0, math.inf, (u, u[inside], 0)

    def share(field: np.ndarray) -> float:
        return norm(field) / (norm(u[inside]) or 1.0)

    def judged(u: np.ndarray, left: np.ndarray, done: int) -> Prediction:
        fields, size = placed.doubts(u, left, told, slowed), norm(u[inside]) or 1.0
        found = combined(fields, factors, lambda part: norm(part) / size)
        names = ("left", "waves", "data", "strain", *("axis",) * ("axis" in found))
        parts = {name: float(found.get(name, 0.0)) for name in names} | {"noise": noise}
        return replace(first, u=u, parts=parts, known=fields, corrections=done)

    added = None if placed.nonlinear else placed.bent(u)
    bent = 0.0 if added is None else share(added)
    for done in count():
        left = placed.correction(load, u)
        moved, rest = share(left), math.inf  # the latter where only members know
        slowed = max(slowed, moved / before) if done == 1 else slowed
        if placed.nonlinear:
            bent = share((first.u - u)[inside] - left)
        if told is not None and placed.turned is None:
            screen = {  # of the record alone, which asks no member: it may suffice (Q5)
                "left": factors.left * moved,
                "waves": factors.floor * told,
                "data": placed.family.moduli_error,
                "strain": factors.floor * placed.series(placed.gradient(u), slowed) * bent,
                "noise": noise,
            }
            rest = _rest(screen)
            if tolerance is not None and math.hypot(*screen.values()) <= tolerance:
                return replace(first, u=u, parts=screen, corrections=done)
        worth = moved if rest == math.inf else math.hypot(factors.left * moved, rest)
        if worth < least:
            best, least = (u, left, done), worth
        last = done == MOST or moved > STALLED * before
        # waves and strain that a screen sees say where an answer with no tolerance settles
        goal = SETTLED * rest if tolerance is None else tolerance
        if factors.left * moved <= goal or last:
            found = judged(u, left, done)
            floor = _rest(found.parts)
            if tolerance is None:
                enough = found.parts["left"] <= SETTLED * floor
            else:  # or what is left is not what keeps it from being kept
                enough = found.error <= tolerance or (floor > tolerance and done > 0)
            if enough or last:
                if best[2] < done and not (tolerance and found.error <= tolerance):  # led away
                    found = min(found, judged(*best), key=lambda one: one.error)
                break
        u, before = u.copy(), moved
        u[inside] += left
    return found


def _uncovered(placed: EnsembleOperator, points: Any) -> tuple[str, ...]:
    """What the error of a problem does not speak of."""
    found = [ALONE] if placed.family.second is placed.family.rich else []
    if placed.points.outside is not None:
        found += [FREE_EDGE, BROKEN]
    if placed.turned is not None and placed.points.axis is None:
        found.append(AXIS)
    there = getattr(points, "arrays", {}).get("temperature")
    mine = placed.family.temperature
    if there is not None and mine is not None and not np.allclose(there, mine):
        found.append(f"temperature: learned at {mine:g} K, asked at {np.max(there):g} K")
    return tuple(found)


def _beyond(placed: EnsembleOperator, u: np.ndarray, unseen: float) -> list[tuple[str, str]]:
    """The part that is unknown, and what the family's data say nothing of.

    `unseen` is the share of waves shorter than the data's.
    """
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


def _noise(points: Any, number: int) -> list[float]:
    """Noise of the displacement that is given, over it, of each sample."""
    if isinstance(points, Samples) and "snr" in points.arrays and len(points) == number:
        return [float(1 / value) if value > 0 else 0.0 for value in points.arrays["snr"]]
    return [0.0] * number


def _rest(parts: dict[str, float]) -> float:
    return math.hypot(*(part for name, part in parts.items() if name != "left"))
