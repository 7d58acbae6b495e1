"""Problems of bodies with cracks: at rest, in motion, grown slowly, pulled apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import warp_peri.fracture as fracture
from warp_peri.errors import InputError
from warp_peri.fracture.body import LatticeBody, lattice_body, penny_corners
from warp_peri.fracture.dynamics import BreakingBody
from warp_peri.fracture.growth import grow
from warp_peri.fracture.release import crack_area, crack_opening_volume
from warp_peri.fracture.run import CrackRun
from warp_peri.fracture.statics import CutSolid, crack_load
from warp_peri.points.arguments import NotNegative, checked, typed
from warp_peri.points.points import Points
from warp_peri.points.unit_names import check_same
from warp_peri.protocols import is_tensor, offered, refuse_uncut, taken
from warp_peri.solvers.motion import Motion, Recorder, refuse_learning
from warp_peri.solvers.solution import CG, Direct, Solution, refuse_solver


@typed
@dataclass(frozen=True, eq=False)
class Cracked:
    """A body on a lattice with free edges and cracks, held where nodes are not interior (C11).

    Attributes:
        points: a lattice; where it ends, the body ends. Displacement is given off the interior.
        b: body force density [stress/length], shape [N, d]; None for no load.
        u: displacement [length], shape [N, d], read where it is given; zero by default. Of a motion
            it is that of the start, of slow loads that of unit load.
        cracks: polylines [length], shape [P, 2] each, that cut bonds; in space the corners of flat
            convex polygons, [P, 3].
        free: components that are not given, shape [N, d] bool, where a node is held in part;
            by default all of the interior.
        pressure: [stress], shape [d, d], of what presses on the faces of the cracks, p n⊗n of a
            fluid (C13); of bodies in equilibrium.
        corrected: whether bonds that a node lacks, at edges and faces of cracks, take the mean
            gradient of those that it has, so that both are as stiff as the solid (C26); of a solid
            that breaks, not by energy.

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
    free: np.ndarray | None = None
    pressure: Any = None
    corrected: bool = False
    learns = True  # at rest, and pulled

    @property
    def held(self) -> np.ndarray:
        """Components that are given, shape [N, d] bool; InputError for a mask of another shape."""
        shape = self.points.x.shape
        if self.free is None:
            return np.repeat(~self.points.interior[:, None], shape[1], axis=1)
        return ~checked("free", self.free, bool, shape)

    def body(self, material: Any, verb: str) -> LatticeBody:
        """Nodes and bonds; InputError for what has no linear part, and for other points."""
        refuse_uncut(material, "Cracked")
        if hasattr(material, "numbers") and hasattr(material, "linear"):
            raise InputError(
                f"{verb}: expected a linear solid for a Cracked, got {type(material).__name__}, "
                "whose third order no cut bond knows of; its .linear is solved alone"
            )
        linear = offered(material, "linear", verb, "a solid with a linear part for a Cracked")
        check_same(linear.units, self.points.units)
        linear.check_dimension(self.points)
        if not self.points.is_open_lattice:
            raise InputError("points: a Cracked is for lattices that have no box and none outside")
        return lattice_body(self.points.x, self.points.spacing, linear.horizon)

    def waves(self, material: Any) -> CutSolid:
        """L of a positive solid whose bonds stay, which moves; InputError as of CutSolid."""
        how: dict[str, Any] = {"cracks": self.cracks, "corrected": self.corrected, "moves": True}
        return CutSolid(material, self.body(material, "simulate"), self.held, **how)

    def solved(self, material: Any, solver: Any, options: dict[str, Any]) -> Solution:
        """The body at rest, of a solid with a linear part, or of one with several moduli."""
        refuse_solver(solver, (Direct, CG), "a body with cracks")
        numbers = options.pop("parameters", None)
        taken(options, "solve")
        body = self.body(material, "solve")
        how: dict[str, Any] = {"cracks": self.cracks, "corrected": self.corrected, "solver": solver}
        cut = CutSolid(material, body, self.held, **how)
        b: Any
        b, u = (np.zeros_like(body.x) if one is None else one for one in (self.b, self.u))
        learns = numbers is not None or is_tensor(b) or is_tensor(u)
        if not learns:
            u = checked("u", u, float, body.x.shape, self.held)
        if self.pressure is not None:
            pressure = checked("pressure", self.pressure, float, (body.dimension,) * 2)
            extra = crack_load(cut, pressure, numbers or {} if learns else None)
            if learns:
                b, extra = map(fracture.adjoint.as_tensor, ("b", "pressure"), (b, extra))
            else:
                b = checked("b", b, float, body.x.shape)
            b = b + extra
        solved = cut.solve_torch(b, u, solver, numbers) if learns else cut.solve(b, u, solver)
        return replace(solved, points=self.points)

    def moved(self, material: Any, options: dict[str, Any]) -> Motion:
        """Bonds that break: in motion, event by event, or under loads that rise slowly.

        The options say which:
            density: waves in any positive solid, whose bonds stay; with the options of
                solvers.verlet.march, and its tensors.
            step, steps: motion of a BrittleMaterial. Also `progress`; `every`, `regions`,
                `sections`, `watch`, `checkpoint`, `checkpoint_every`, `series` (CrackRun);
                `no_fail`, `grip`, `ramp` (BreakingBody); `v`, `count_cracks` (its start). The
                histories are the ledger's, and of regions, sections and what is watched by their
                names; the details are Broken.
            events: slow growth in any positive solid, `no_fail` and `progress` (C7).
            loads, line: pull of a SofteningMaterial, `no_fail`, `stop` and `progress` (C16). With
                `parameters`, softness, stretch or tail as tensors, or u of torch, the force and
                the displacement at the end are differentiable: see SoftBody.pull.
        """
        if self.pressure is not None:
            raise InputError("pressure: a Cracked under pressure is solved at rest; see Injected")
        if "density" in options and not hasattr(material, "density"):
            u = np.zeros_like(self.points.x) if self.u is None else self.u
            cut = self.waves(material)
            return fracture.adjoint.in_motion(cut, self.b, u, options)
        body = self.body(material, "simulate")
        grows = "events" in options or ("step" in options and not options.get("sections"))
        if self.corrected and not grows:
            raise InputError(
                "corrected: expected slow growth, events=…, or steps without sections; bonds that "
                "soften are not corrected"
            )
        if "loads" not in options:
            refuse_learning(self, options, "simulate")
        if "events" in options or "loads" in options:
            if self.b is not None:
                raise InputError("b: slow growth and pulls are of given displacements, got a load")
            return self._slowly(material, body, options)
        how, begin, files, records, run = options_of_steps(options)
        offered(
            material, "density", "simulate", "a BrittleMaterial for steps, or events=…, or loads=…"
        )
        how |= {"load": self.b, "held": self.held, "corrected": self.corrected}
        moving = BreakingBody(material, body, **how)
        state = moving.start(u=self.u, cracks=self.cracks, **begin)
        marching = CrackRun(moving, **records | files)
        return marching.motion(marching.march(state, **run))

    def _slowly(self, material: Any, body: LatticeBody, options: dict[str, Any]) -> Motion:
        u: Any = np.zeros_like(body.x) if self.u is None else self.u
        u = u if is_tensor(u) else checked("u", u, float, body.x.shape, self.held)
        if "events" in options:
            (how,) = taken(options, "simulate", grow, given=("cracks", "corrected"))
            how |= {"cracks": self.cracks, "corrected": self.corrected}
            return grow(material.linear, body, self.held, u, **how)
        law = offered(material, "law", "simulate", "a SofteningMaterial for loads=…")
        soft: Any = fracture.adjoint.SoftBody
        own, how = taken(options, "simulate", soft.__init__, soft.pull, given=("cracks",))
        pulled = soft(material.linear, body, law, self.held, cracks=self.cracks, **own)
        return pulled.pull(u, **how)  # type: ignore[no-any-return]


def options_of_steps(options: dict[str, Any]) -> tuple[dict[str, Any], ...]:
    """Those of a motion in steps: for BreakingBody, its start, Recorder, CrackRun and its march.

    Raises InputError for others.
    """
    given = "load", "held", "u", "cracks", "nodes", "corrected"
    begin, run = (BreakingBody.__init__, BreakingBody.start), (CrackRun.__init__, CrackRun.march)
    return taken(options, "simulate", *begin, Recorder.__init__, *run, given=given)


@typed
@dataclass(frozen=True, eq=False)
class Injected:
    """A crack |x| < a on y = 0, in space a penny, that a fluid drives through a body, slowly (C14).

    At each half length the pressure is that of G = G_c; G of unit pressure is p² half the change of
    the opening's volume with the crack's length or area, that of the bonds cut.

    Attributes:
        points: a lattice along the axes, held off the interior.
        halves: half lengths, or radii, in rising order, more than a spacing, one or more.
        leak: volume lost per length or area of new face [length], ≥ 0.
        compressibility: of the fluid [1 / stress], ≥ 0.

    Raises InputError for half lengths that do not rise, and a fluid below 0.
    """

    points: Points
    halves: Sequence[float]
    leak: NotNegative = 0.0
    compressibility: NotNegative = 0.0

    def __post_init__(self) -> None:
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

    def moved(self, material: Any, options: dict[str, Any]) -> Motion:
        """Stage by stage, of a BrittleMaterial with a toughness.

        The time is the half length; the histories are half, pressure at which the crack is about to
        grow [stress], volume of the fluid in it [length^d], and pumped, leaks included.
        """
        taken(options, "simulate")
        toughness = getattr(material, "toughness", None)
        if toughness is None:
            raise InputError(
                "simulate: expected a BrittleMaterial with a toughness for an Injected"
            )
        h, normal, rows = self.points.spacing, np.eye(self.points.dimension)[1], []
        for half in self.halves:
            found = [self._at(material, half + d, normal) for d in (0.0, h, -h)]
            here, longer, shorter = (crack_opening_volume(one, normal) for one in found)
            area, more, less = (crack_area(one, normal) for one in found)
            released = (longer - shorter) / (more - less) / 2  # at unit pressure
            pressure = float(np.sqrt(toughness / released))
            volume = pressure * here
            pumped = volume * (1 + self.compressibility * pressure) + self.leak * 2 * area
            rows.append((half, pressure, volume, pumped))
        history = dict(zip(("half", "pressure", "volume", "pumped"), np.array(rows).T))
        return Motion(history["half"], pressure * found[0].u, None, history, found[0])

    def _at(self, material: Any, half: float, normal: np.ndarray) -> Solution:
        """At rest under unit pressure."""
        crack = [(-half, 0.0), (half, 0.0)] if len(normal) == 2 else penny_corners(half)
        problem = Cracked(self.points, cracks=[crack], pressure=np.outer(normal, normal))
        return problem.solved(material, None, {})
