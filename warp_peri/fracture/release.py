"""What a crack releases, by energies of several lengths or by J; how far it opens, and how much
further a tip acts than it is cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.fracture.body import box_nodes, lattice_body, size_and_normal, through
from warp_peri.fracture.statics import CutSolid
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arguments import Positive, checked, typed
from warp_peri.protocols import offered
from warp_peri.solvers.solution import CG, Direct, Solution

RADIUS = 4.0
"""Half side of the smaller square around a tip, in horizons; the larger has twice that."""


@typed
def energy_release(
    material: Any,
    problem: Any,
    cracks: Sequence[Sequence[ArrayLike]],
    *,
    shift: float = 0.0,
    solver: Direct | CG | None = None,
) -> float:
    """G by energies of cracks of several lengths, at given displacement and dead loads (C11).

    Along rows of nodes a shorter and a longer crack, one spacing either way, are enough. Bonds are
    cut one by one where a crack is inclined: take nine lengths over ± 2 spacings there, for 2 %.

    Args:
        material: as of `solve`.
        problem: a Cracked, whose cracks are not looked at; loads stay as the crack grows, their
            potential counts.
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


@typed
def tip_shift(material: Any, spacing: Positive, *, corrected: bool = False) -> float:
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


def _shift(model: LPSMaterial, h: float, radius: float, corrected: bool) -> float:
    """As tip_shift, of one square."""
    d, inner = model.dimension, np.ceil(radius / h - 1e-6) * h
    side = 2 * (inner + 2 * np.ceil(model.horizon / h - 1e-6) * h)
    x = box_nodes((side, side, h)[:d], h)  # all layers are alike
    held, u = (np.abs(x) >= inner).any(axis=1), np.zeros_like(x)
    u[:, :2] = _tip_field(x, model)
    body, energies = lattice_body(x, h, model.horizon, endless=d == 3), []
    places = h * np.arange(-1, 2)
    for place in places:
        crack = through(-side, place, side, d)
        cut = CutSolid(model, body, held, cracks=[crack], corrected=corrected)
        energies.append(cut.energy(cut.solve(None, u).u) / h ** (d - 2))
    bend, slope, _ = np.polyfit(places, energies, 2)
    released = (_kolosov(model) + 1) / (8 * model.mu)  # 1/E of a sheet, (1 − ν²)/E in space
    return float((slope + released) / (2 * bend))


def _kolosov(model: LPSMaterial) -> float:
    return (model.lam + 3 * model.mu) / (model.lam + model.mu)


def _tip_field(x: np.ndarray, model: LPSMaterial) -> np.ndarray:
    """Displacement about a crack's tip at the origin, K = 1; M. L. Williams, 1957."""
    angle = np.arctan2(x[:, 1], x[:, 0])
    size = np.sqrt(np.hypot(*x[:, :2].T) / (2 * np.pi)) / (2 * model.mu)
    size *= _kolosov(model) - np.cos(angle)
    return np.asarray(size[:, None] * np.column_stack([np.cos(angle / 2), np.sin(angle / 2)]))


@typed
def j_integral(solution: Solution, tip: Sequence[float], radii: tuple[float, float]) -> float:
    """J around the tip of a crack along an axis, for its growth straight on, by a domain (C12).

    Gradients are differences, one-sided across the crack; the weight falls from 1 to 0 between two
    squares about the tip. In space these are cubes about a point of a front that is straight within
    the larger one, and J is the mean over what is in it.

    Args:
        solution: of a Cracked on a rectangle or box of nodes, of one material, with the crack
            midway between two of their rows, columns or layers.
        tip: where the crack ends, shape [d].
        radii: half sides of the squares [length], the smaller first; taken to the nearest spacing.

    Raises InputError for a body that is no box, several materials, squares that do not differ by a
    spacing or do not fit into the body, and a tip that no crack is near.
    """
    if not getattr(solution.operator, "one", False):
        raise InputError("solution: expected that of a Cracked, of one material, isotropic")
    model, body = solution.operator.model, solution.operator.body
    h, d = body.spacing, body.dimension
    end = checked("tip", tip, float, (d,))
    r1, r2 = np.rint(checked("radii", radii, float, (2,)) / h) * h
    room = np.minimum(end - body.x.min(axis=0), body.x.max(axis=0) - end).min() + 1e-9 * h
    if not 0 <= r1 < r2 <= room:
        raise InputError(
            f"radii: expected 0 ≤ smaller < larger by a spacing of {h:g} or more, up to {room:g} "
            f"to the edge, got {radii[0]:g}, {radii[1]:g}"
        )
    place = np.rint((body.x - body.x.min(axis=0)) / h).astype(int)
    sides = place.max(axis=0) + 1
    if np.prod(sides) != len(body.x):
        raise InputError("body: expected a full box of nodes for J")
    axes, sign = _crack_axes(solution, end, r2)
    order = np.lexsort(place.T[::-1])
    x, u = (field[order].reshape(*sides, d) for field in (body.x - end, solution.u))
    gradient = _gradient(u, x, h, axes, sign)
    strain = (gradient + gradient.swapaxes(-1, -2)) / 2
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    stress = 2 * model.mu * strain + model.lam * trace * np.eye(d)

    def fall(away: np.ndarray) -> np.ndarray:
        return np.asarray(np.clip((r2 - away) / (r2 - r1), 0.0, 1.0))

    away, total = np.abs(x[..., axes]), 0.0
    around, along = away[..., :2].max(axis=-1), away[..., 2:].max(axis=-1, initial=0.0)
    pull = np.einsum("...ij,...i->...j", stress, gradient[..., axes[0]])
    pull[..., axes[0]] -= (stress * strain).sum(axis=(-1, -2)) / 2
    for n, axis in enumerate(axes):
        far = away[..., n]
        slope = (fall(far + h / 2) - fall(far - h / 2)) / h  # of cells: a tip stands anywhere
        felt = fall(around) if n == 2 else fall(along) * (away[..., :2].argmax(axis=-1) == n)
        total += (pull[..., axis] * np.sign(x[..., axis]) * slope * felt).sum()
    front = fall(along).sum() / np.prod(sides[axes[:2]]) * h ** (d - 2)
    return float(sign * total * h**d / front)


def _crack_axes(solution: Solution, tip: np.ndarray, reach: float) -> tuple[list[int], float]:
    """The axes along the crack that ends in a tip, across it, and along its front; and the sign of
    its growth: it comes from where bonds are broken within reach."""
    body, d = solution.operator.body, len(tip)
    cut = []
    for normal in np.eye(d):
        away = body.x[_columns(solution, normal)[0]] - tip
        cut.append(away[(np.abs(away) <= reach).all(axis=1)])
    across = int(np.argmax([len(away) for away in cut]))
    behind = np.where(np.arange(d) == across, 0.0, cut[across].sum(axis=0))
    along = int(np.abs(behind).argmax())
    if not behind[along]:
        raise InputError(f"tip: expected the end of a crack along an axis, got {tip.tolist()}")
    rest = [axis for axis in range(d) if axis not in (along, across)]
    return [along, across, *rest], -float(np.sign(behind[along]))


def _gradient(u: np.ndarray, x: np.ndarray, h: float, axes: list[int], sign: float) -> np.ndarray:
    """∂u_i/∂x_j by differences of a box of nodes about a tip, one-sided across the crack behind it,
    shape [n₁, n₂, …, d, d]."""
    slopes = [np.gradient(u, h, axis=axis, edge_order=2) for axis in range(u.shape[-1])]
    along, across = axes[:2]
    row = round(float((x[..., across] < 0).mean()) * x.shape[across])
    halves = np.split(u, [row], axis=across)
    apart = [np.gradient(half, h, axis=across, edge_order=2) for half in halves]
    behind = sign * x[..., along, None] < 0
    slopes[across] = np.where(behind, np.concatenate(apart, axis=across), slopes[across])
    return np.stack(slopes, axis=-1)


@typed
def crack_opening_volume(solution: Solution, normal: Sequence[float] | None = None) -> float:
    """Room between the faces of cracks with one normal [length^d], from the bonds across them.

    Each broken bond of one spacing along the normal is a column of the opening; cracks along a
    row of nodes. The solution is that of a Cracked; the normal is the second axis unless given.

    Raises InputError unless the normal is along an axis.
    """
    node, far, along = _columns(solution, normal)
    body, u = solution.operator.body, solution.u
    return float(body.spacing ** (body.dimension - 1) * ((u[far] - u[node]) @ along).sum())


def crack_area(solution: Solution, normal: Sequence[float] | None = None) -> float:
    """Length, in space area, of these cracks: a spacing or a square of it for each column."""
    body = solution.operator.body
    return float(len(_columns(solution, normal)[0]) * body.spacing ** (body.dimension - 1))


def _columns(
    solution: Solution, normal: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes below and above a crack, joined by a bond that it broke, and the normal."""
    body, neighbour, d = solution.operator.body, solution.operator.neighbour, solution.u.shape[1]
    along = np.eye(d)[1] if normal is None else np.asarray(normal, dtype=float)
    if along.shape != (d,) or sorted(np.abs(along)) != [0] * (d - 1) + [1]:
        raise InputError(
            f"normal: expected one along an axis, as {(0, 1, 0)[:d]}, got {list(along)}"
        )
    across = np.abs(body.xi - body.spacing * along).max(axis=1)
    step = int(np.argmin(across))
    if across[step] > 1e-6 * body.spacing:
        raise InputError("body: expected a lattice along the axes, got a turned one")
    node = np.flatnonzero((neighbour[:, step] < 0) & (body.neighbour[:, step] >= 0))
    return node, body.neighbour[node, step], along
