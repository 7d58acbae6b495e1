"""Energy release rate of cracks at rest, and how much further a tip acts than it is cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.contract import offered
from warp_peri.damage.cut_solid import CutSolid
from warp_peri.damage.lattice_body import box, lattice_body, size_and_normal
from warp_peri.damage.problems import Cracked
from warp_peri.errors import InputError
from warp_peri.materials.lps import Model
from warp_peri.statics.solution import Direct, Krylov

RADIUS = 4.0
"""Half side of the smaller square around a tip, in horizons; the larger has twice that."""


def energy_release(
    material: Any,
    problem: Cracked,
    cracks: Sequence[Sequence[ArrayLike]],
    *,
    shift: float = 0.0,
    solver: Direct | Krylov | None = None,
) -> float:
    """G by energies of cracks of several lengths, at given displacement and dead loads (C11).

    Along rows of nodes a shorter and a longer crack, one spacing either way, are enough. Bonds are
    cut one by one where a crack is inclined: take nine lengths over ± 2 spacings there, for 2 %.

    Args:
        material: as of `solve`.
        problem: its cracks are not looked at; loads stay as the crack grows, their potential
            counts.
        cracks: for each length its polylines, two or more; what longer ones add is the new area.
        shift: how much further a tip acts than it is cut [length], `tip_shift` of the solid; G is
            then that of the length asked for, by a parabola through three lengths or a quartic
            through five or more (C25).
        solver: as of `solve`.

    Returns what is released per length added, in space per area, by least squares
    [stress · length]; with two tips, of each.

    Raises InputError for fewer than two lengths, with a shift fewer than three or in space, for a
    body that nothing pulls at, and as Cracked.solved.
    """
    given = (problem.b, problem.u, problem.pressure)
    if not any(np.any(np.nan_to_num(np.asarray(field))) for field in given if field is not None):
        raise InputError(
            "problem: nothing pulls at it, b, u and pressure are zero or missing; give one of them"
        )
    energies, lengths = [], []
    for polylines in cracks:
        solution = replace(problem, cracks=polylines).solved(material, solver, {})
        cell = problem.points.spacing**problem.points.dimension
        work = cell * float(np.vdot(solution.load, solution.u[solution.operator.inside]))
        energies.append(solution.operator.energy(solution.u) - work)
        sizes = (size_and_normal(np.asarray(line, dtype=float))[0] for line in polylines)
        lengths.append(sum(sizes))
    if len(set(lengths)) < (3 if shift else 2):
        least = "three" if shift else "two"
        raise InputError(f"cracks: expected {least} lengths or more, got {lengths}")
    if not shift:
        return -float(np.polyfit(lengths, energies, 1)[0])
    off = np.array(lengths) - np.mean(lengths)
    slope = np.polyder(np.polyfit(off, energies, 2 if len(lengths) < 5 else 4))
    return -float(np.polyval(slope, -shift * _moving(cracks)))


def _moving(cracks: Sequence[Sequence[ArrayLike]]) -> int:
    """How many ends of the polylines are elsewhere in the last of these sets than in the first."""
    first, last = (
        [np.asarray(line, dtype=float) for line in one] for one in (cracks[0], cracks[-1])
    )
    if len(first) != len(last) or any(line.shape[1:] != (2,) for line in first + last):
        raise InputError("shift: expected the same number of polylines in a sheet at all lengths")
    ends = [(a[end], b[end]) for a, b in zip(first, last) for end in (0, -1)]
    return sum(not np.array_equal(a, b) for a, b in ends)


def tip_shift(material: Any, spacing: float, *, corrected: bool = False) -> float:
    """How much further the tip of a crack along rows of nodes acts than it is cut (C25) [length].

    The field of a tip in an endless sheet is given around squares of four and eight horizons half
    side; the place where the cut tip releases what that field brings is behind its origin by the
    shift. What is left falls with the inverse of the side and is taken off.

    Args:
        material: a solid with a linear part; in space the strain is plane.
        spacing: of the nodes [length].
        corrected: as of the Cracked that it is for.

    Raises InputError for a solid without a linear part.
    """
    model = offered(material, "linear", "tip_shift", "a solid with a linear part")
    sides = RADIUS * model.horizon * np.array([1.0, 2.0])
    smaller, larger = (_shift(model, spacing, side, corrected) for side in sides)
    return 2 * larger - smaller


def _shift(model: Model, h: float, radius: float, corrected: bool) -> float:
    """As tip_shift, of one square."""
    d, inner = model.dimension, np.ceil(radius / h - 1e-6) * h
    side = 2 * (inner + 2 * np.ceil(model.horizon / h - 1e-6) * h)
    x = box((side, side, h)[:d], h)  # all layers are alike
    held, u = (np.abs(x) >= inner).any(axis=1), np.zeros_like(x)
    u[:, :2] = _tip_field(x, model)
    body, energies = lattice_body(x, h, model.horizon, endless=d == 3), []
    places, frame = h * np.arange(-1, 2), side * np.array([-1, 1, 1, -1])
    for place in places:
        crack: list[tuple[float, ...]] = [(-side, 0.0), (place, 0.0)]
        if d == 3:
            crack = [(at, 0.0, z) for at, z in zip((-side, -side, place, place), frame)]
        cut = CutSolid(model, body, held, cracks=[crack], corrected=corrected)
        energies.append(cut.energy(cut.solve(None, u)) / h ** (d - 2))
    bend, slope, _ = np.polyfit(places, energies, 2)
    released = (_kolosov(model) + 1) / (8 * model.mu)  # 1/E of a sheet, (1 − ν²)/E in space
    return float((slope + released) / (2 * bend))


def _kolosov(model: Model) -> float:
    return (model.lam + 3 * model.mu) / (model.lam + model.mu)


def _tip_field(x: np.ndarray, model: Model) -> np.ndarray:
    """Displacement about a crack's tip at the origin, K = 1; M. L. Williams, 1957."""
    angle = np.arctan2(x[:, 1], x[:, 0])
    size = np.sqrt(np.hypot(*x[:, :2].T) / (2 * np.pi)) / (2 * model.mu)
    size *= _kolosov(model) - np.cos(angle)
    return np.asarray(size[:, None] * np.column_stack([np.cos(angle / 2), np.sin(angle / 2)]))
