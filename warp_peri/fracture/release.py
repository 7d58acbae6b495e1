"""What a crack releases, by energies of several lengths or by J; how far it opens, and how much
further a tip acts than it is cut."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.fracture.body import LatticeBody, box_nodes, lattice_body, size_and_normal, through
from warp_peri.fracture.statics import CutSolid
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arguments import Positive, typed
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

    From which side the crack comes is where the displacement jumps most. Gradients are differences
    on a full box of nodes, one-sided across the crack; the weight falls from 1 to 0 between two
    squares about the tip. In space these are cubes about a point of the front, which runs straight
    along an axis within the larger one, and J is the mean over what is in it.

    Args:
        solution: of a Cracked on a rectangle or box of nodes, of one material, with the crack
            midway between two of their rows, columns or layers.
        tip: where the crack ends, shape [d].
        radii: half sides of the squares [length], the smaller first; taken to the nearest spacing.

    Raises InputError for a body that is no box, several materials, and squares that do not differ
    by a spacing or do not fit into the body.
    """
    if not getattr(solution.operator, "one", False):
        raise InputError("solution: expected that of a Cracked, of one material, isotropic")
    return domain_integral(solution.operator.model, solution.operator.body, solution.u, tip, radii)


def domain_integral(
    model: LPSMaterial,
    body: LatticeBody,
    u: np.ndarray,
    tip: Sequence[float],
    radii: tuple[float, float],
) -> float:
    """As j_integral, of a displacement of all nodes [N, d]."""
    h, d = body.spacing, body.dimension
    if not (np.isfinite(radii).all() and 0 <= round(radii[0] / h) < round(radii[1] / h)):
        raise InputError(
            f"radii: expected 0 ≤ smaller < larger by a spacing of {h:g} or more, got "
            f"{radii[0]:g}, {radii[1]:g}"
        )
    r1, r2 = (round(radius / h) * h for radius in radii)
    if np.shape(tip) != (d,):
        raise InputError(f"tip: expected a point of shape [{d}], got {list(np.shape(tip))}")
    place = np.rint((body.x - body.x.min(axis=0)) / h).astype(int)
    sides = place.max(axis=0) + 1
    if np.prod(sides) != len(body.x):
        raise InputError("body: expected a full box of nodes for J")
    order = np.lexsort(place.T[::-1])
    x = body.x[order].reshape(*sides, d) - np.asarray(tip, dtype=float)
    low, high = (end.min() for end in (-x.reshape(-1, d).min(axis=0), x.reshape(-1, d).max(axis=0)))
    if (room := min(low, high)) < r2 - 1e-9 * h:
        raise InputError(f"radii: {r2:g} is more than from the tip to the edge, {room:g}")
    field, x = _from_the_left(u[order].reshape(*sides, d), x, r2)
    gradient = crack_gradient(field, h, _line(x, 0) < 0, int(np.count_nonzero(_line(x, 1) < 0)))
    strain = (gradient + gradient.swapaxes(-1, -2)) / 2
    stress = 2 * model.mu * strain
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    stress = stress + model.lam * trace * np.eye(d)
    density = (stress * strain).sum(axis=(-1, -2)) / 2
    away = np.abs(x)
    across, along = away[..., :2].max(axis=-1), away[..., 2:].max(axis=-1, initial=0.0)
    sideways = np.arange(d) == away[..., :2].argmax(axis=-1)[..., None]
    within = np.clip((r2 - along) / (r2 - r1), 0.0, 1.0)  # along the front, in space
    slope = np.where(sideways, within[..., None] * _fall(away, h, r1, r2), 0.0)
    slope[..., 2:] = (np.clip((r2 - across) / (r2 - r1), 0.0, 1.0) * _fall(along, h, r1, r2))[
        ..., None
    ]
    slope *= np.sign(x)
    pull = np.einsum("...ij,...i->...j", stress, gradient[..., 0])
    integrand = density * slope[..., 0] - (pull * slope).sum(axis=-1)
    front = within[0, 0].sum() * h ** (d - 2)
    return float(-integrand.sum() * h**d / front)


def _from_the_left(field: np.ndarray, x: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and places about a tip, [n₁, …, d], turned so that the crack comes along −x₁.

    Its faces then look along x₂. The jump across half a plane is what neighbours on both sides do
    not explain.
    """
    d, views, jumps = x.shape[-1], [], []
    for axes in itertools.permutations(range(d)):
        turned, places = (np.transpose(a, (*axes, d))[..., list(axes)] for a in (field, x))
        steps, row = np.diff(turned, axis=1), int(np.count_nonzero(_line(places, 1) < 0))
        around = steps[:, max(row - 2, 0)] + steps[:, min(row, steps.shape[1] - 1)]
        jump = np.square(steps[:, row - 1] - around / 2).sum(axis=-1)
        at = places[:, row - 1]
        near = (np.abs(np.delete(at, 1, axis=-1)) <= reach).all(axis=-1)
        for sign in (1, -1):
            jumps.append(jump[near & (sign * at[..., 0] < 0)].sum())
            flip = np.where(np.arange(d) == 0, sign, 1.0)
            views.append((turned[::sign] * flip, places[::sign] * flip))
    return views[int(np.argmax(jumps))]


def _line(x: np.ndarray, axis: int) -> np.ndarray:
    """Coordinates along one axis of a box of places, [n₁, …, d]."""
    return np.asarray(np.moveaxis(x[..., axis], axis, -1)[(0,) * (x.shape[-1] - 1)])


def _fall(away: np.ndarray, h: float, r1: float, r2: float) -> np.ndarray:
    """Mean slope, over a cell, of what falls from 1 to 0 between r1 and r2.

    The tip may then stand anywhere between two columns of nodes.
    """
    outer, inner = (np.clip((r2 - away + d) / (r2 - r1), 0.0, 1.0) for d in (-h / 2, h / 2))
    return np.asarray((outer - inner) / h)


def crack_gradient(field: np.ndarray, h: float, behind: np.ndarray, row: int) -> np.ndarray:
    """∂u_i/∂x_j by differences, shape [n₁, n₂, …, d, d], one-sided across rows row − 1 and row."""
    d = field.shape[-1]
    slopes = [np.gradient(field, h, axis=axis, edge_order=2) for axis in range(d)]
    halves = (field[:, :row], field[:, row:])
    apart = np.concatenate([np.gradient(half, h, axis=1, edge_order=2) for half in halves], axis=1)
    slopes[1] = np.where(behind.reshape(-1, *(d * (1,))), apart, slopes[1])
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
    solution: Solution, normal: Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes below and above a crack, joined by a bond that it broke, and the normal."""
    body, neighbour, d = solution.operator.body, solution.operator.neighbour, solution.u.shape[1]
    along = np.eye(d)[1] if normal is None else np.asarray(normal, dtype=float)
    if along.shape != (d,) or sorted(np.abs(along)) != [0] * (d - 1) + [1]:
        raise InputError(f"normal: expected one along an axis, as {(0, 1, 0)[:d]}, got {normal}")
    across = np.abs(body.xi - body.spacing * along).max(axis=1)
    step = int(np.argmin(across))
    if across[step] > 1e-6 * body.spacing:
        raise InputError("body: expected a lattice along the axes, got a turned one")
    node = np.flatnonzero((neighbour[:, step] < 0) & (body.neighbour[:, step] >= 0))
    return node, body.neighbour[node, step], along
