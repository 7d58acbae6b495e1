"""Problems of bodies with cracks: energy release, opening, tips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike

import warp_peri.core as core
import warp_peri.fracture as fracture
from warp_peri.core.elastic import checked_symmetric, symmetric_part
from warp_peri.errors import ALONE, InputError, Several, Values, agreed, warn
from warp_peri.files.checkpoint import fingerprint, same
from warp_peri.fracture.body import (
    LatticeBody,
    box_nodes,
    lattice_body,
    penny_corners,
    size_and_normal,
    through,
)
from warp_peri.fracture.dynamics import BreakingBody, CrackRun
from warp_peri.fracture.statics import CutSolid, by_component, crack_load, grow
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points import arguments
from warp_peri.points.arguments import (
    NotNegative,
    Options,
    Positive,
    as_array,
    checked,
    offered,
    taken,
    typed,
)
from warp_peri.points.points import Points
from warp_peri.protocols import refuse_uncut
from warp_peri.solvers.motion import Motion, Recorder, asks_for_gradient, refuse_learning
from warp_peri.solvers.solution import CG, Direct, Solution


def linear_of(material: Any, verb: str) -> LPSMaterial:
    """Linear part of a material that cracks may cut; InputError for others, and operators."""
    linear = offered(material, "linear", verb, "a solid with a linear part for a Cracked")
    if not hasattr(linear, "own_nodes"):
        offered(material, "own_nodes", verb, "a material for a Cracked, not its operator")
    return linear  # type: ignore[no-any-return]


@typed
@dataclass(frozen=True, eq=False)
class Cracked:
    """Body on a lattice with free edges and cracks, held where nodes are not interior (C11).

    Attributes:
        points: a lattice; where it ends, the body ends. Displacement is given off the interior.
        b: body force density [stress/length], shape [N, d]; None for no load.
        u: displacement [length], shape [N, d], read where it is given; zero by default. Of a motion
            it is that of the start, of slow loads that of unit load.
        cracks: polylines [length], shape [P, 2] each, that cut bonds; in space the corners of flat
            convex polygons, [P, 3].
        free: components that are not given, shape [N, d] bool, where a node is held in part; by
            default all of the interior.
        pressure: [stress], shape [d, d], of what presses on the faces of the cracks, p n⊗n of a
            fluid (C13); of bodies in equilibrium.
        corrected: give missing bonds, at edges and cracks, the mean gradient of a node's others,
            which makes both as stiff as the solid (C26).

    `solve` and `simulate` raise InputError for points that are no plain lattice, fields of other
    shapes or not finite, a piece that nothing holds, a material without a linear part, and one
    whose cut bonds leave negative eigenvalues.

    >>> wp.solve(model, wp.Cracked(points, u=0.01 * x, cracks=[[(-60, 2.5), (0, 2.5)]])).u.shape
    (441, 2)
    """

    points: Points
    b: Any = None
    u: Any = None
    cracks: Sequence[ArrayLike] = ()
    free: ndarray | None = None
    pressure: Any = None
    corrected: bool = False
    learns = True  # at rest, and pulled

    @property
    def held(self) -> ndarray:
        """Components that are given, shape [N, d] bool; InputError for a mask of another shape."""
        shape = self.points.x.shape
        if self.free is None:
            return by_component(~self.points.interior, shape)
        return ~checked("free", self.free, bool, shape)

    def body(self, material: Any, verb: str) -> LatticeBody:
        """Nodes and bonds of the body; InputError for no linear part, and for other points."""
        refuse_uncut(material, "Cracked")
        if hasattr(material, "numbers") and hasattr(material, "linear"):
            raise InputError(
                f"{verb}: expected a linear solid for a Cracked, as the .linear of "
                f"{type(material).__name__}, whose third order no cut bond knows of"
            )
        linear = linear_of(material, verb)
        linear.own_nodes(self.points)
        if not self.points.is_open_lattice:
            raise InputError("points: a Cracked is for lattices that have no box and none outside")
        return lattice_body(self.points.x, self.points.spacing, linear.horizon)

    @property
    def _cuts(self) -> Values:
        return {"cracks": self.cracks, "corrected": self.corrected}

    def waves(self, material: Any) -> CutSolid:
        """Operator L of a positive solid whose bonds stay, for waves; InputError as of CutSolid."""
        body = self.body(material, "simulate")
        return CutSolid(material, body, self.held, moves=True, **self._cuts)

    def solved(self, material: Any, solver: Any, options: Options) -> Solution:
        """Solve for the body at rest, of a solid with a linear part, or with several moduli."""
        numbers = options.pop("parameters", None)
        taken(options, "solve")
        body = self.body(material, "solve")
        cut = CutSolid(material, body, self.held, solver=solver, **self._cuts)
        b: Any
        b, u = (np.zeros_like(body.x) if one is None else one for one in (self.b, self.u))
        learns = numbers is not None or arguments.is_tensor(b) or arguments.is_tensor(u)
        if not learns:
            u = checked("u", u, float, body.x.shape, self.held)
            b = checked("b", b, float, body.x.shape)
        if self.pressure is not None:
            pressure = checked_symmetric("pressure", self.pressure, (body.dimension,) * 2)
            if learns:
                cut, numbers = core.torch_bridge.with_numbers(cut, numbers or {})
            extra = crack_load(cut, pressure, numbers)
            if not len(self.cracks):
                warn("pressure: there is no crack that it presses on")
            if learns:
                b, extra = map(fracture.adjoint.real, ("b", "pressure"), (b, extra))
                arguments.check_shape("b", b, body.x.shape)
            b = b + extra
        solved = cut.solve_torch(b, u, solver, numbers) if learns else cut.solve(b, u, solver)
        return replace(solved, points=self.points)

    def moved(self, material: Any, options: Options) -> Motion:
        """Simulate the body: waves, breaking bonds, slow growth event by event, or slow loads.

        The options say which:
            density: waves in any positive solid, whose bonds stay; with the options of
                solvers.verlet.march, and its tensors.
            step, steps: motion of a BrittleMaterial. Also `progress`; `every`, `watch`,
                `checkpoint`, `checkpoint_every`, `series` (CrackRun); `no_fail`, `grip`, `ramp`
                (BreakingBody); `v` (its start). The histories are the ledger's and those of
                `watch`; the details are Broken.
            events: slow growth in any positive solid, `no_fail` and `progress` (C7).
            loads, line: SoftBody.pull of a SofteningMaterial, with `no_fail` and that function's
                options.
        """
        if self.pressure is not None:
            raise InputError("pressure: a Cracked under pressure is solved at rest; see Injected")
        u = np.zeros_like(self.points.x) if self.u is None else self.u
        if "density" in options and not hasattr(material, "density"):
            return fracture.adjoint.in_motion(self.waves(material), self.b, u, options)
        body = self.body(material, "simulate")
        if self.corrected and not {"events", "step"} & options.keys():
            raise InputError("corrected: expected slow growth, events=…, or steps")
        if "loads" not in options:
            refuse_learning(self, options, "simulate")
        if {"events", "loads"} & options.keys():
            if self.b is not None:
                raise InputError("b: slow growth and pulls are of given displacements, got a load")
            return self._slowly(material, body, u, options)
        offered(
            material, "density", "simulate", "a BrittleMaterial for steps, or events=…, or loads=…"
        )
        return in_steps(material, body, self.steps(options))

    def steps(self, options: Options) -> tuple[Options, ...]:
        """Sort options of a motion in steps by what takes them: BreakingBody and its start, with
        the problem's fields, CrackRun, and its march."""
        given = "load", "held", "u", "cracks", "nodes", "corrected"
        takers = BreakingBody.__init__, BreakingBody.start, Recorder.__init__, CrackRun.__init__
        how, begin, files, records, run = taken(
            options, "simulate", *takers, CrackRun.march, given=given
        )
        how |= {"load": self.b, "held": self.held, "corrected": self.corrected}
        return how, begin | {"u": self.u, "cracks": self.cracks}, files | records, run

    def _slowly(self, material: Any, body: LatticeBody, u: Any, options: Options) -> Motion:
        if "events" in options:
            u = checked("u", u, float, body.x.shape, self.held)
            (how,) = taken(options, "simulate", grow, given=("cracks", "corrected"))
            return grow(material.linear, body, self.held, u, **how, **self._cuts)
        law = offered(material, "law", "simulate", "a SofteningMaterial for loads=…")
        if self.u is None:
            raise InputError("u: nothing pulls at the body; give its displacement at unit load")
        soft: Any = fracture.adjoint.SoftBody
        own, how = taken(options, "simulate", soft.__init__, soft.pull, given=("cracks",))
        pulled = soft(material.linear, body, law, self.held, cracks=self.cracks, **own)
        return pulled.pull(u, **how)  # type: ignore[no-any-return]


def in_steps(material: Any, body: LatticeBody, options: Any, nodes: Any = None) -> Motion:
    """Motion of a body that breaks, by options as Cracked.steps sorts them, on all of its nodes or
    those that this process has."""
    how, begin, records, run = options
    with agreed(comm := ALONE if nodes is None else nodes.comm):
        moving = BreakingBody(material, body, **how)
        state = moving.start(**begin)
    marching = CrackRun(moving, nodes=nodes, **records)
    with agreed(comm):  # of all steps before the first, lest a ramp that ends loses a run
        shares = marching.loads(run["steps"])
    same(comm, ramp=shares)
    return marching.motion(marching.march(state, **run))


@typed
@dataclass(frozen=True, eq=False)
class Injected:
    """Crack |x| < a on y = 0, in space a penny, that a fluid drives through a body, slowly (C14).

    At each half length the pressure is that of G = G_c; G of unit pressure is half the change of
    the opening's volume with the crack's length or area, that of the bonds cut.

    Attributes:
        points: a lattice along the axes, held off the interior.
        halves: half lengths, or radii, that rise from more than a spacing; InputError for others.
        leak: volume lost per length or area of new face [length].
        compressibility: of the fluid [1 / stress].
    """

    points: Points
    halves: Sequence[float]
    leak: NotNegative = 0.0
    compressibility: NotNegative = 0.0

    def __post_init__(self) -> None:
        if arguments.is_piece(self.points):
            raise InputError("points: expected Points for an Injected, which is not had on ranks")
        h, x = self.points.spacing, self.points.x
        halves = checked("crack", self.halves, float, ("n",))
        flat = np.delete(x, 1, axis=1)  # the plane of the crack
        room = float(np.minimum(-flat.min(axis=0), flat.max(axis=0)).min()) - h
        fit = len(halves) and (np.diff(halves, prepend=h) > 0).all() and halves[-1] <= room
        if not (fit and x[:, 1].min() < 0 < x[:, 1].max()):
            raise InputError(
                f"crack: expected half lengths that rise, from more than {h:g} to at most "
                f"{room:g}, on a plane y = 0 within the body, got {halves.tolist()}"
            )

    def moved(self, material: Any, options: Options) -> Motion:
        """Drive the crack stage by stage through a BrittleMaterial with a toughness.

        The time is the half length; the histories are half, pressure at which the crack is about to
        grow [stress], volume of the fluid in it [length^d], and pumped, leaks included.
        """
        taken(options, "simulate")
        if (toughness := getattr(material, "toughness", None)) is None:
            raise InputError("simulate: expected a BrittleMaterial with a toughness, for Injected")
        h, rows, cuts = self.points.spacing, list[Any](), set[str]()
        for half in self.halves:
            found = [self._at(material, half + d) for d in (0.0, h, -h)]
            cuts.add(fingerprint(found[0].operator.neighbour))
            if len(cuts) == len(rows):
                raise InputError(f"crack: expected half lengths a bond apart, got {[*self.halves]}")
            here, longer, shorter = map(crack_opening_volume, found)
            columns = np.array([len(_columns(one, None)[0]) for one in found])
            area, more, less = columns * h ** (self.points.dimension - 1)  # or lengths in a sheet
            released = (longer - shorter) / (more - less) / 2  # at unit pressure
            pressure = float(np.sqrt(toughness / released))
            volume = pressure * here
            pumped = volume * (1 + self.compressibility * pressure) + self.leak * 2 * area
            rows.append((half, pressure, volume, pumped))
        history = dict(zip(("half", "pressure", "volume", "pumped"), np.array(rows).T))
        return Motion(history["half"], pressure * found[0].u, None, history, found[0], "half")

    def _at(self, material: Any, half: float) -> Solution:
        """Solve for the body at rest under unit pressure at a half length."""
        d = self.points.dimension
        crack = [(-half, 0.0), (half, 0.0)] if d == 2 else penny_corners(half)
        pressure = np.diag([0.0, 1.0, 0.0][:d])
        return Cracked(self.points, cracks=[crack], pressure=pressure).solved(material, None, {})


RADIUS = 4.0
"""Half side of the smaller square around a tip, in horizons; the larger has twice that."""
APART = 0.7
"""Spacings, or their squares in space, from one crack to the next, of an inclined one too."""


@typed
def energy_release(
    material: Any,
    problem: Cracked,
    cracks: Sequence[Sequence[ArrayLike]],
    *,
    shift: float = 0.0,
    solver: Direct | CG | None = None,
) -> float:
    """Energy release rate G [stress · length] from energies of cracks of several lengths (C11).

    The slope by length, in space area, at given displacement and dead loads, by least squares.
    Along rows of nodes two cracks, one spacing either way, are enough; inclined take nine lengths
    over ± 2 spacings, for 2 %, as bonds are cut one by one.

    Args:
        problem: a Cracked, whose cracks are not looked at; loads stay as the crack grows.
        cracks: for each length its polylines; what longer ones add is the new area.
        shift: how much further a tip acts than it is cut [length], by `tip_shift`; G is then by a
            parabola of three lengths or a quartic of five or more (C25).

    Raises InputError for fewer than two lengths a bond apart, three with a shift, for a shift in
    space, a body that nothing pulls at, gradients, and as Cracked.solved.
    """
    given = problem.b, problem.u, problem.pressure
    if asks_for_gradient(given):
        raise InputError(f"energy_release: {arguments.GRADIENT}")
    if not any(np.any(np.nan_to_num(field)) for field in given if field is not None):
        raise InputError("problem: nothing pulls at it; give b, u or pressure")
    energies, lengths, cuts = [], [], set()
    for polylines in cracks:
        solution = replace(problem, cracks=polylines).solved(material, solver, {})
        cuts.add(fingerprint(solution.operator.neighbour))
        cell = problem.points.spacing**problem.points.dimension
        work = cell * float(np.vdot(solution.load, solution.u[solution.operator.inside]))
        energies.append(solution.operator.energy(solution.u) - work)
        lengths.append(sum(size_and_normal(np.asarray(line, float))[0] for line in polylines))
    steps = np.diff(np.sort(lengths))
    few = min(len(lengths), len(cuts)) < (3 if shift else 2)
    if few or steps.min() < APART * problem.points.spacing ** (problem.points.dimension - 1):
        least = "three" if shift else "two"
        raise InputError(f"cracks: expected {least} lengths or more a bond apart, got {lengths}")
    off, back = np.array(lengths) - np.mean(lengths), shift and shift * _moving(cracks)
    degree = (2 if len(lengths) < 5 else 4) if shift else 1
    return -float(np.polyval(np.polyder(np.polyfit(off, energies, degree)), -back))


def _moving(cracks: Sequence[Sequence[ArrayLike]]) -> Any:
    """Number of polyline ends that differ between the first and the last of these sets."""
    first, last = ([np.asarray(line, float) for line in one] for one in (cracks[0], cracks[-1]))
    if len(first) != len(last) or any(line.shape[1:] != (2,) for line in first + last):
        raise InputError("shift: expected the same number of polylines in a sheet at all lengths")
    return sum(np.any(a[end] != b[end]) for a, b in zip(first, last) for end in (0, -1))


@typed
def tip_shift(material: Any, spacing: Positive, *, corrected: bool = False) -> float:
    """Distance [length] by which a crack tip along rows of nodes acts further than it is cut (C25).

    The field of a tip is given around squares of four and eight horizons half side; the shift is
    where the cut tip releases that field's energy, extrapolated by the inverse side. `corrected` is
    as the Cracked that it is for; in space the strain is plane. InputError without a linear part.
    """
    model = linear_of(material, "tip_shift")
    sides = RADIUS * model.horizon * np.array([1.0, 2.0])
    smaller, larger = (_shift(model, spacing, side, corrected) for side in sides)
    return 2 * larger - smaller


def _shift(model: LPSMaterial, h: float, radius: float, corrected: bool) -> float:
    """Shift of tip_shift by one square; the field is M. L. Williams' of 1957, K = 1."""
    d, inner = model.dimension, np.ceil(radius / h - 1e-6) * h
    side = 2 * (inner + 2 * np.ceil(model.horizon / h - 1e-6) * h)
    x = box_nodes((side, side, h)[:d], h)  # all layers are alike
    held, u = (np.abs(x) >= inner).any(axis=1), np.zeros_like(x)
    kolosov, angle = (model.lam + 3 * model.mu) / (model.lam + model.mu), np.arctan2(*x.T[1::-1])
    size = np.sqrt(np.hypot(*x.T[:2]) / (2 * np.pi)) / (2 * model.mu) * (kolosov - np.cos(angle))
    u[:, 0], u[:, 1] = size * np.cos(angle / 2), size * np.sin(angle / 2)
    body, energies = lattice_body(x, h, model.horizon, endless=d == 3), []
    places = h * np.arange(-1, 2)
    for place in places:
        crack = through(-side, place, side, d)
        cut = CutSolid(model, body, held, cracks=[crack], corrected=corrected)
        energies.append(cut.energy(cut.solve(None, u).u) / h ** (d - 2))
    bend, slope, _ = np.polyfit(places, energies, 2)
    released = (kolosov + 1) / (8 * model.mu)  # 1/E of a sheet, (1 − ν²)/E in space
    return float((slope + released) / (2 * bend))


@typed
def j_integral(solution: Solution, tip: Sequence[float], radii: tuple[float, float]) -> float:
    """J integral around the tip of a crack along an axis, for straight growth, by a domain (C12).

    The weight falls from 1 to 0 between two squares about the tip [d], in space cubes about a point
    of a front that is straight in the larger one, over which J is the mean; `radii` are their half
    sides [length], the smaller first, taken to the nearest spacing. The solution is of a Cracked on
    a box of nodes, of one material, with the crack midway between two rows or layers.

    Raises InputError for a body that is no box, several materials, squares that do not differ by a
    spacing or do not fit into the body, and a tip within a spacing of which no crack ends.
    """
    if not getattr(solution.operator, "one", False):
        raise InputError("solution: expected that of a Cracked, of one material, isotropic")
    model, body = solution.operator.model, solution.operator.body
    h, d, u = body.spacing, body.dimension, as_array("solution", solution.u)
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
    x, u = (field[order].reshape(*sides, d) for field in (body.x - end, u))
    gradient = _gradient(u, x, h, axes, sign)
    strain = symmetric_part(gradient)
    trace = np.linalg.trace(strain)[..., None, None]
    stress = 2 * model.mu * strain + model.lam * trace * np.eye(d)
    fall: Any = lambda away: np.clip((r2 - away) / (r2 - r1), 0.0, 1.0)  # noqa: E731
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


def _crack_axes(solution: Solution, tip: ndarray, reach: float) -> tuple[list[int], float]:
    """Axes along the crack that ends in a tip, across it and along its front, and its sense."""
    body, d, h = solution.operator.body, len(tip), solution.operator.body.spacing
    cut = []
    for normal in np.eye(d):  # middles of broken bonds in the plane of the tip
        away = body.x[_columns(solution, normal)[0]] + normal * h / 2 - tip
        cut.append(away[(np.abs(away) <= np.where(normal, 0.49 * h, reach)).all(axis=1)])
    across = int(np.argmax([len(away) for away in cut]))
    behind = np.where(np.arange(d) == across, 0.0, cut[across].sum(axis=0))
    along = int(np.abs(behind).argmax())
    sign = -float(np.sign(behind[along]))
    if not sign or abs((sign * cut[across][:, along]).max() + h / 2) > h:  # behind where it ends
        raise InputError(f"tip: expected the end of a crack along an axis, got {tip.tolist()}")
    return [along, across, *[axis for axis in range(d) if axis not in (along, across)]], sign


def _gradient(u: ndarray, x: ndarray, h: float, axes: list[int], sign: float) -> ndarray:
    """Gradients ∂u_i/∂x_j by differences in a box about a tip, [n₁, n₂, …, d, d]."""
    slopes = [np.gradient(u, h, axis=axis, edge_order=2) for axis in range(u.shape[-1])]
    along, across = axes[:2]
    halves = np.split(u, [round(float((x[..., across] < 0).mean()) * x.shape[across])], axis=across)
    apart = [np.gradient(half, h, axis=across, edge_order=2) for half in halves]
    behind = sign * x[..., along, None] < 0
    slopes[across] = np.where(behind, np.concatenate(apart, axis=across), slopes[across])
    return np.stack(slopes, axis=-1)


@typed
def crack_opening_volume(solution: Solution, normal: Sequence[float] | None = None) -> float:
    """Volume [length^d] between the faces of cracks in a Cracked's solution.

    Each broken bond of one spacing along an axis is a column of what opens along that: along all,
    or along the `normal` of cracks alone. Raises InputError unless that is along an axis.
    """
    volume, u, d = 0.0, as_array("solution", solution.u), solution.u.shape[-1]
    for axis in np.eye(d) if normal is None else [normal]:
        node, far, along = _columns(solution, axis)
        volume += ((u[far] - u[node]) @ along).sum()
    return float(volume * solution.operator.body.spacing ** (d - 1))


def _columns(solution: Solution, normal: ArrayLike | None) -> Several:
    """Nodes below and above a crack, joined by a bond that it broke, and the normal."""
    if not hasattr(solution.operator, "body"):
        raise InputError("solution: expected that of a Cracked, got another's")
    body, neighbour, d = solution.operator.body, solution.operator.neighbour, solution.u.shape[1]
    along = np.eye(d)[1] if normal is None else checked("normal", normal, float, (d,))
    if sorted(np.abs(along)) != [0] * (d - 1) + [1]:
        raise InputError(f"normal: expected an axis, as {(0, 1, 0)[:d]}, got {list(along)}")
    across = np.abs(body.xi - body.spacing * along).max(axis=1)
    step = int(np.argmin(across))
    if across[step] > 1e-6 * body.spacing:
        raise InputError("body: expected a lattice along the axes, got a turned one")
    node = np.flatnonzero((neighbour[:, step] < 0) & (body.neighbour[:, step] >= 0))
    return node, body.neighbour[node, step], along
