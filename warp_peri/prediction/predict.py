"""A tolerance in, an answer with its error out (theory, Q1–Q5).

The cheapest member is solved, the richest is evaluated, never solved: what its residual asks for is
both the estimate and the improvement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arguments import Positive, typed
from warp_peri.points.arrays import checked_fields
from warp_peri.points.samples import Samples, nodes_of
from warp_peri.prediction.answer import WORDS, Prediction, combined, said
from warp_peri.prediction.ensemble import MOST, CalibrationFactors, EnsembleMaterial
from warp_peri.prediction.members import EnsembleOperator, Parts, norm
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
AXIS = "axis: the points do not state the direction of the crystal; its largest swing is a part"


@dataclass
class _Stage:
    """One displacement and what is known of it; `unseen` is the share of waves shorter than the
    data's."""

    u: np.ndarray
    parts: dict[str, float]
    fields: Parts | None
    corrections: int
    unseen: float = 0.0

    @property
    def error(self) -> float:
        return _size(self.parts)


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

    Returns:
        An answer, or one for each of several loads. One whose tolerance is not kept says so.

    Raises InputError for a material that is no ensemble, a problem of another kind, a tolerance
    that is no number above zero, and whatever `solve` refuses.

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
    stage = _corrected(placed, load, start, tolerance, noise)
    beyond = _beyond(placed, stage)
    stage.parts |= {part: math.nan for part, _ in beyond if part}
    kept = tolerance is None or stage.error <= tolerance
    uncovered += tuple(why for _, why in beyond)
    why = _reason(stage, tolerance, kept, uncovered)
    only_axis = all(one == AXIS for one in uncovered)
    return Prediction(
        stage.u, stage.error, stage.parts, kept and only_axis, why, uncovered, stage.corrections,
        tolerance, placed, load, stage.fields,
    )  # fmt: skip


def _corrected(
    placed: EnsembleOperator, load: np.ndarray, u: np.ndarray, tolerance: float | None, noise: float
) -> _Stage:
    """Correct until the tolerance is kept, or cannot be; without one until nothing improves.

    A screen, parts that ask the record alone and no member, may suffice (Q5).
    """
    factors, first, inside = placed.family.factors, u, placed.points.interior
    told, unseen = placed.recorded(u)
    before, slowed, least, best = math.inf, 0.0, math.inf, (u, u[inside], 0)

    def share(field: np.ndarray) -> float:
        return norm(field) / (norm(u[inside]) or 1.0)

    def judged(u: np.ndarray, left: np.ndarray, done: int) -> _Stage:
        fields, size = placed.doubts(u, left, told, slowed), norm(u[inside]) or 1.0
        found = combined(fields, factors, lambda part: norm(part) / size)
        names = ("left", "waves", "data", "strain", *("axis",) * ("axis" in found))
        parts = {name: float(found.get(name, 0.0)) for name in names} | {"noise": noise}
        return _Stage(u, parts, fields, done, unseen)

    added = None if placed.nonlinear else placed.bent(u)
    bent = 0.0 if added is None else share(added)
    for done in range(MOST + 1):
        left = placed.correction(load, u)
        moved, rest = share(left), math.inf  # the latter where only members know
        slowed = max(slowed, moved / before) if done == 1 else slowed
        if placed.nonlinear:
            bent = share((first - u)[inside] - left)
        if told is not None and placed.turned is None:
            screen = {
                "left": factors.left * moved,
                "waves": factors.floor * told,
                "data": placed.family.moduli_error,
                "strain": factors.floor * placed.series(placed.gradient(u), slowed) * bent,
                "noise": noise,
            }
            rest = _rest(screen)
            if tolerance is not None and _size(screen) <= tolerance:
                return _Stage(u, screen, None, done, unseen)
        worth = moved if rest == math.inf else math.hypot(factors.left * moved, rest)
        if worth < least:
            best, least = (u, left, done), worth
        last = done == MOST or moved > STALLED * before
        # waves and strain that a screen sees say where an answer with no tolerance settles
        goal = SETTLED * rest if tolerance is None else tolerance
        if factors.left * moved <= goal or last:
            stage = judged(u, left, done)
            floor = _rest(stage.parts)
            if tolerance is None:
                enough = stage.parts["left"] <= SETTLED * floor
            else:  # or what is left is not what keeps it from being kept
                enough = stage.error <= tolerance or (floor > tolerance and done > 0)
            if enough or last:
                if best[2] < done and not (tolerance and stage.error <= tolerance):  # led away
                    stage = min(stage, judged(*best), key=lambda one: one.error)
                return stage
        u, before = u.copy(), moved
        u[inside] += left
    raise AssertionError("the last correction ends the loop")


def _reason(stage: _Stage, tolerance: float | None, kept: bool, uncovered: tuple[str, ...]) -> str:
    """One sentence."""
    n = stage.corrections
    way = "linear" + (f" and {n} nonlinear correction{'s' * (n != 1)}" if n else "")
    way = way.replace(" 1 ", " one ")
    largest = max(stage.parts, key=lambda name: (math.isnan(stage.parts[name]), stage.parts[name]))
    told = f"{way}; {said(stage.error, '{:.2g} %')}, most of it {WORDS[largest]}"
    if tolerance is not None and not kept:
        told += f"; {100 * tolerance:g} % is not kept"
    return told + "".join(f"; not covered: {one.split(':')[0]}" for one in uncovered)


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


def _beyond(placed: EnsembleOperator, stage: _Stage) -> list[tuple[str, str]]:
    """What the family's data say nothing of, and the part that is unknown by it."""
    found = []
    if stage.unseen > SHORTER:
        found.append(("waves", "short waves: shorter than any that the ensemble learned from"))
    known = placed.family.strain
    if not placed.nonlinear and known > 0:
        strain = placed.gradient(stage.u)
        if placed.grid is None:
            found.append(("strain", "strain: nothing in the ensemble tells what its law misses"))
        elif strain > STRAINED * known:
            words = f"strain: {strain:.2%} is beyond the {known:.2%} of the data of a linear law"
            found.append(("", words))
    return found


def _noise(points: Any, count: int) -> list[float]:
    """Noise of the displacement that is given, over it, of each sample."""
    if isinstance(points, Samples) and "snr" in points.arrays and len(points) == count:
        return [float(1 / value) if value > 0 else 0.0 for value in points.arrays["snr"]]
    return [0.0] * count


def _size(parts: dict[str, float]) -> float:
    return math.hypot(*parts.values())


def _rest(parts: dict[str, float]) -> float:
    return _size({name: part for name, part in parts.items() if name != "left"})
