"""Motion of a body whose bonds break: its state, one step, the ledger of energies, and runs.

Velocity Verlet keeps the force of a breaking bond for the step's second half-kick (theory, C10):
work = kinetic + elastic + dissipated then holds to second order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy import ndarray
from numpy.typing import ArrayLike

from warp_peri.errors import Arrays, InputError, Values, agreed, called
from warp_peri.files.checkpoint import AllNodes, fingerprint
from warp_peri.fracture.body import LatticeBody, cracked
from warp_peri.fracture.bonds import CutOperator, SurfaceCorrection, unit_toughness
from warp_peri.fracture.materials import BrittleMaterial
from warp_peri.fracture.statics import by_component, check_no_fail
from warp_peri.kernels.damage import halves
from warp_peri.points.arguments import REDUCED, Positive, check_nodes, check_shape, checked, plain
from warp_peri.runtime import floats, launch_slices, zeros
from warp_peri.solvers.motion import Motion, Recorder

SPREAD = 0.25
"""Least eigenvalue of the shape tensor of a node that is corrected in motion, over a whole ball's:
a straight edge has half."""
SHORTER = 0.95
"""Of the step (C9), where bonds are corrected: breaking at random raises Λmax by up to 1.05."""


@dataclass(eq=False)
class BreakingState:
    """State of a motion with breaking bonds; arrays are Warp's.

    Attributes:
        links: unbroken bonds, to be read by the operator's `kept`.
        correction: of missing bonds, before those that the next step breaks; or None.
        force, energy: internal force and elastic energy density over the unbroken bonds.
        work: done on the body so far and what it started with, per node and area [stress].
        dissipated: energy density of the bonds broken so far [stress].
        whole: bonds that count as undamaged at the start, shape [N].
    """

    u: wp.array[Any]
    v: wp.array[Any]
    links: wp.array[Any]
    correction: SurfaceCorrection | None
    force: wp.array[Any]
    energy: wp.array[Any]
    work: wp.array[Any]
    dissipated: ndarray
    whole: ndarray
    time: float = 0.0
    steps: int = 0

    @property
    def swept(self) -> tuple[wp.array[Any], ...]:
        """Arrays that a sweep reads and fills."""
        return self.u, self.links, self.force, self.energy


class BreakingBody:
    """Brittle solid on a lattice body, with its loads: what `step` marches.

    Args:
        solid: the solid; its influence function must be positive on the lattice.
        body: nodes and bonds, of the solid's horizon.
        no_fail: nodes whose bonds do not break, shape [N] bool.
        load: body force density b [stress / length], shape [N, d].
        held: components of the displacement that are prescribed, shape [N] or [N, d] bool.
        grip: velocity of held components, shape [N, d]; zero by default, and where not held.
        ramp: share of load and grip at a time; 1 by default.
        corrected: as of Cracked.

    Attributes:
        longest_step: Δt proven stable whatever breaks (theory, C9); corrected less, measured.
        exchange: fills the displacement [N, d] of nodes that another process moves, or None.

    Raises InputError for a model that changes sign, or arrays that do not fit.
    """

    def __init__(
        self,
        solid: BrittleMaterial,
        body: LatticeBody,
        *,
        no_fail: ArrayLike | None = None,
        load: ArrayLike | None = None,
        held: ArrayLike | None = None,
        grip: ArrayLike | None = None,
        ramp: Callable[[float], float] | None = None,
        corrected: bool = False,
    ) -> None:
        self.solid, self.body, self.ramp, self.corrected = solid, body, ramp, corrected
        self.shares: dict[float, float] = {}
        self.longest_step = solid.longest_step(body.spacing) * (SHORTER if corrected else 1)
        self.no_fail = check_no_fail(no_fail, len(body.x))
        stretch = solid.critical_stretch
        if solid.toughness is not None:
            stretch = np.sqrt(solid.toughness / unit_toughness(solid.model, body.classes))
        limits = stretch * body.r**2
        self.operator = CutOperator(solid.model, body, limits=limits, no_fail=self.no_fail)
        if grip is not None and held is None:
            raise InputError("grip: expected held components too, whose velocity it is")
        held = None if held is None else by_component(held, body.x.shape).astype(float)
        given = {"load": load, "held": held, "grip": grip}
        self.load, self.held, self.grip = (self._nodal(*one) for one in given.items())
        self.exchange: Callable[[ndarray], None] | None = None

    def _nodal(self, name: str, field: ArrayLike | None) -> wp.array[Any]:
        """Copy a field [N, d] to Warp; zeros for None."""
        shape = self.body.x.shape
        values = np.zeros(shape) if field is None else checked(name, field, float, shape)
        return floats(values.copy(), self.operator.vector)

    def share(self, time: float) -> float:
        """Share of the loads at a time, by the ramp; InputError where it is no number."""
        if time not in self.shares:  # asked for once, whatever it remembers
            name, ramp = f"ramp at t = {time:g}", 1.0 if self.ramp is None else self.ramp
            given = called(f"{name}: expected a number", ramp, time)
            self.shares[time] = float(checked(name, given, float, ()))
        return self.shares[time]

    def start(
        self,
        *,
        u: ArrayLike | None = None,
        v: ArrayLike | None = None,
        cracks: Sequence[ArrayLike] = (),
    ) -> BreakingState:
        """State at time zero, with u and v [N, d], zero by default, and cracks open. Raises
        InputError for a u beyond the criterion: such a body breaks at rest."""
        fields, neighbour = (self._nodal("u", u), self._nodal("v", v)), cracked(self.body, cracks)
        count = len(self.body.x)
        state = BreakingState(
            *fields,
            self.operator.links(neighbour),
            self.correction(neighbour >= 0),
            force=zeros(count, dtype=self.operator.vector),
            energy=zeros(count),
            work=zeros(count),
            dissipated=np.zeros(count),
            whole=(neighbour >= 0).sum(axis=1, dtype=float),
        )
        broken = self.operator.sweep(*state.swept, breaking=u is not None)
        if len(broken):
            raise InputError(
                f"criterion: bonds of {len(broken)} nodes are beyond it in the displacement "
                "at rest, before anything moves"
            )
        self.correct(state)
        kinetic = self.solid.inertia / 2 * np.square(fields[1].numpy()).sum(axis=1)
        state.work = floats(kinetic + state.energy.numpy())
        return state

    def correction(self, there: ndarray) -> SurfaceCorrection | None:
        """Surface correction with these bonds, [N, B] bool, where one is asked for."""
        if not self.corrected:
            return None
        return SurfaceCorrection(self.body, there, self.operator.bonded, SPREAD)

    def correct(self, state: BreakingState) -> None:
        """Add the surface correction to force and energy."""
        if state.correction is not None:
            more, stored = state.correction(state.u.numpy())
            state.force.numpy()[:] += more
            state.energy.numpy()[state.correction.node] += stored

    def damage(self, state: BreakingState) -> ndarray:
        """Damage φ, the share of bonds that a node has lost, shape [N]."""
        left = self.operator.kept(state.links).sum(axis=1)
        return np.asarray(1 - left / np.maximum(state.whole, 1))

    def ledger(self, state: BreakingState, nodes: Any) -> list[float]:
        """Time, work, kinetic, elastic and dissipated energy [stress · volume] over all processes.
        In a sheet they are per thickness; work = kinetic + elastic + dissipated."""
        body = self.body
        kinetic = self.solid.inertia / 2 * np.square(state.v.numpy()).sum(axis=1)
        fields = state.work.numpy(), kinetic, state.energy.numpy(), state.dissipated
        sums = nodes.sum(np.stack([field[nodes.own] for field in fields], axis=1))
        return [state.time, *(body.spacing**body.dimension * sums).tolist()]


def step(body: BreakingBody, state: BreakingState, dt: float) -> BreakingState:
    """Advance a state by dt in place and return it; CrackRun refuses one above `longest_step`."""
    operator, count = body.operator, len(body.body.x)
    density, kernels = body.solid.inertia, halves(body.body.dimension)
    share, later = (body.share(time) for time in (state.time, state.time + dt))
    moving = state.v, state.work
    launch_slices(
        kernels.kick_and_drift,
        count,
        (dt, density, share, later, state.force, body.load, body.held, body.grip, *moving, state.u),
    )
    if body.exchange:
        body.exchange(state.u.numpy())
    lost = operator.sweep(*state.swept, breaking=True)
    body.correct(state)
    kicked = dt, density, later, state.force, body.load, body.held, *moving
    launch_slices(kernels.second_kick, count, kicked)
    if len(lost):
        full = state.energy.numpy()[lost]
        if body.corrected:  # to have the same bits wherever nothing breaks
            operator.sweep(*state.swept)
            state.correction = body.correction(operator.kept(state.links))
            body.correct(state)
        else:
            operator.again(state.links, lost, state.force, state.energy)
        state.dissipated[lost] += full - state.energy.numpy()[lost]
    state.time += dt
    state.steps += 1
    return state


NODAL = "u", "v", "force", "energy", "work"
"""Arrays of a state that a checkpoint holds for each node."""
GROWN = dict[str, str]()
"""Marks of functions that watch as a run leaves them, with what they keep, and those before it."""
SAME = 1e-9
"""Values that a function gives again differ by less, relatively, whatever sums them."""
LEDGER = "time", "work", "kinetic", "elastic", "dissipated"


class Broken(NamedTuple):
    """End of a motion: damage φ, the share of bonds that a node has lost, [N]; body and state."""

    damage: ndarray
    body: BreakingBody
    state: BreakingState


class CrackRun(Recorder):
    """Recorder that marches a body, and goes on from its checkpoint with the same bits.

    Args:
        body: the body; on ranks that of the nodes here. Records are of the whole.
        step: Δt, at most the body's longest.
        watch: functions of φ [N] alone, the share of bonds that nodes lost, recorded by name.
        nodes: which of the body's are this process's own, as AllNodes; all by default.
        files: the options of Recorder; `every` is 20 by default.

    Raises InputError for a step or counts that are not > 0 or too long.
    """

    kind = "warp_peri.crack"

    def __init__(
        self,
        body: BreakingBody,
        *,
        step: Positive,
        watch: Mapping[str, Callable[[ndarray], Any]] | None = None,
        nodes: Any = None,
        **files: Any,
    ) -> None:
        nodes = AllNodes(len(body.body.x)) if nodes is None else nodes
        body.exchange = getattr(nodes, "exchange", None)
        super().__init__(nodes, body.body.x[nodes.own], **{"every": 20} | files)
        with agreed(nodes.comm):
            if not step <= body.longest_step:
                raise InputError(
                    f"step: expected at most {body.longest_step:.6g}, the longest that is stable "
                    f"whatever breaks, got {step:.6g}"
                )
            self.watch = dict(watch or {})
            if not all(map(callable, self.watch.values())) or {*LEDGER} & {*self.watch}:
                raise InputError(
                    f"watch: expected functions, none named {', '.join(LEDGER)}, got {watch!r:.40}"
                )
        self.body, self.dt = body, float(step)
        self.history = {name: [] for name in LEDGER}
        mark = self._told()  # before functions that keep things are called
        self.watched = GROWN.get(mark, mark)

    def _told(self) -> str:
        """Mark of what is recorded, where a file is to know it."""
        return fingerprint(self.every, self.watch, named=True) if self.file or self.series else ""

    def _marched(self, state: BreakingState, steps: int, progress: bool) -> Any:
        try:
            return super()._marched(state, steps, progress)
        except InputError as error:
            error.motion = self.motion(state)
            raise
        finally:
            GROWN[self._told()] = self.watched

    def motion(self, state: BreakingState) -> Motion:
        """Records so far as a Motion, with the end at the nodes of this process."""
        own, (time, history) = self.nodes.own, self.recorded()
        u, v = (field.numpy()[own].copy() for field in (state.u, state.v))
        end = Broken(self.body.damage(state)[own], self.body, state)
        named = self.body.solid.units != REDUCED
        return Motion(time, u, v, history, end, "time [ps]" if named else "time")

    def advance(self, state: BreakingState) -> BreakingState:
        return step(self.body, state, self.dt)

    def record(self, state: BreakingState) -> tuple[float, Values, Values]:
        body, nodes = self.body, self.nodes
        found: Values = dict(zip(LEDGER, body.ledger(state, nodes)))
        phi = body.damage(state)[nodes.own] if self.watch or self.series else None
        if self.watch:
            everywhere = nodes.gather(phi)
            with agreed(nodes.comm):
                for name, function in self.watch.items():
                    seen = called(f"watch {name}: expected values", function, everywhere.copy())
                    found[name] = plain(f"watch {name}", seen)
                    for one in self.history.get(name, [])[:1]:
                        check_shape(f"watch {name}", found[name], np.shape(one))
        return state.time, found, {} if phi is None else {"damage": phi}

    def check_end(self, state: BreakingState, rows: Mapping[str, list[Any]]) -> None:
        if not (self.watch and rows["time"]):
            return
        found = self.record(state)[1]
        for name in self.watch:
            each = plain(f"watch {name}", rows[name])
            again, last = found[name], each[-1]
            small = SAME * np.abs(each[np.isfinite(each)]).max(initial=0)
            if again.shape != last.shape or not np.allclose(again, last, SAME, small, True):
                raise InputError(
                    f"watch {name}: expected a function of φ alone, the checkpoint's; at its state "
                    f"that gave {last}, this gives {again}"
                )

    def nodal(self, state: BreakingState) -> Arrays:
        """Arrays by name: `left`, the unbroken bonds of the ball at each node, [m, B]."""
        arrays = {name: getattr(state, name).numpy() for name in NODAL}
        left = self.body.operator.kept(state.links).astype(np.uint8)
        return arrays | {"dissipated": state.dissipated, "whole": state.whole, "left": left}

    def times(self, steps: int) -> list[float]:
        """Times of the start and after each of so many steps, as they add up."""
        check_nodes("steps", (steps,), "steps")
        return np.cumsum([0.0] + steps * [self.dt]).tolist()  # type: ignore[no-any-return]

    def loads(self, steps: int) -> list[float]:
        """Shares of the loads at these times."""
        return [*map(self.body.share, self.times(steps))]

    def key(self, steps: int) -> dict[str, str]:
        body, nodes, of = self.body, self.nodes, self.body.operator
        fields = {name: getattr(body, name).numpy() for name in ("load", "held", "grip")}
        fields |= {"nodes": body.body.x, "no_fail": body.no_fail}
        return {name: nodes.mark(field) for name, field in fields.items()} | {
            "solid": fingerprint(of.bonded, of.limits, body.solid.inertia, body.corrected),
            "load history": fingerprint(self.loads(steps)),
            "step": fingerprint(self.dt),
            "records": self.watched,
        }

    def restored(self, state: BreakingState, arrays: Arrays, steps: int) -> BreakingState:
        for name in NODAL:
            getattr(state, name).numpy()[:] = arrays[name]
        left = np.where(arrays["left"], self.body.body.neighbour, -1)
        state.links = self.body.operator.links(left)
        state.correction = self.body.correction(left >= 0)
        state.dissipated[:], state.whole = arrays["dissipated"], arrays["whole"]
        state.time, state.steps = self.times(steps)[-1], steps
        return state
