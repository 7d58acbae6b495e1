"""Explicit dynamics ρ ü = b − L u on a lattice: velocity Verlet, its time step and its energy.

The step is bounded by the symbol (theory, 49–51); the energy that leapfrog keeps is (52).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError, quietly, warn
from warp_peri.files.checkpoint import AllNodes, RunFile, agreed, fingerprint
from warp_peri.files.series import TimeSeriesWriter
from warp_peri.points.arguments import Count, Positive
from warp_peri.points.arrays import check_positive, check_whole, is_piece
from warp_peri.points.arrays import checked as read
from warp_peri.points.lattice import check_lattice
from warp_peri.points.unit_names import USUAL, Units, factors
from warp_peri.protocols import offered, stencil_of
from warp_peri.runtime import shared_by
from warp_peri.solvers.motion import Motion

if TYPE_CHECKING:
    from warp_peri.materials.lps_operator import LPSOperator

KIND = "warp_peri.waves"
"""Of checkpoints."""
INERTIA = 1e-8
"""1 kg/m³ in TPa ps²/Å²."""
PROBE, SMALL = np.array([[1.3, -0.7, 2.1], [0.4, 1.9, -1.1], [-2.3, 0.6, 0.9]]), 1e-4
"""Waves of a field that feels every bond, and its size in spacings."""


def stiffest_of(law: Any, spacing: float, allow_uncertified: bool) -> float:
    """The stiffest wave of a law of tensors, which is for one spacing and needs its proof."""
    offered(law, "max_symbol_eigenvalue", "critical_time_step", "a linear solid or a crystal")
    stencil_of(law, spacing, "critical_time_step")
    if not (allow_uncertified or (law.certificate or law.certified().certificate).holds):
        raise InputError("material: expected one whose certificate holds; waves may grow")
    return float(law.max_symbol_eigenvalue())


@dataclass(frozen=True)
class State:
    """A motion between two steps.

    Attributes:
        u: displacement of all nodes [Å], shape [N, d].
        v: velocity of the interior nodes [Å/ps], shape [I, d].
        g: L u − b on them [TPa/Å], shape [I, d].
        number: of steps before it.
    """

    u: np.ndarray
    v: np.ndarray
    g: np.ndarray
    number: int = 0


NO_FORCE = 1e-9
"""Of the stiffest wave's: what a motion as a whole feels by rounding alone."""


def inertia(density: float, units: Units) -> float:
    """ρ in units of stress · ps² over length², of kg/m³.

    Raises InputError for reduced units, which have neither kilograms nor picoseconds, and for a
    density not > 0.
    """
    check_positive("density", density)
    length, stress = factors(units, USUAL)
    return INERTIA * density * length**2 / stress


class Inert:
    """Interior nodes of some density under a load: m ρ ü = s(t) b − L u.

    m is one, or the operator's own `masses` of nodes over those of whole cells, [N].

    Args:
        operator: L on a lattice.
        interior: nodes that move, shape [N] bool.
        density: ρ [kg/m³].
        load: b on the interior nodes [TPa/Å], shape [I, d].
        signal: s after each step, shape [steps + 1]; None for 1.

    Attributes:
        dot: the scalar product of two fields [I, d]; over all ranks where there are some.
        count: of interior nodes, likewise.
        floats: whether nothing is held, and to move as a whole costs nothing.
    """

    def __init__(
        self,
        operator: LPSOperator,
        interior: np.ndarray,
        density: float,
        load: np.ndarray,
        signal: np.ndarray | None = None,
    ) -> None:
        self.operator, self.interior, self.load, self.signal = operator, interior, load, signal
        masses = getattr(operator, "masses", None)
        share = 1.0 if masses is None else masses[interior, None]
        self.inertia = inertia(density, operator.model.units) * share
        self.dot: Callable[[np.ndarray, np.ndarray], float] = np.vdot
        self.count = int(np.count_nonzero(interior))
        self.floats = False

    def on_all(self, inner: np.ndarray) -> np.ndarray:
        """A field of interior nodes [I, d] on all, zero elsewhere."""
        field = np.zeros((len(self.interior), inner.shape[1]))
        field[self.interior] = inner
        return field

    def share(self, number: int) -> float:
        """s after so many steps."""
        return 1.0 if self.signal is None else float(self.signal[number])

    def state(self, u: np.ndarray, v: np.ndarray, number: int = 0) -> State:
        """The state with displacement [N, d] and velocity [I, d] after so many steps."""
        return State(u, v, self.operator(u) - self.share(number) * self.load, number)

    def potential(self, before: State, after: State, held: np.ndarray) -> float:
        """Halfway in a step, per volume of a node, up to what never changes: of a linear force what
        leapfrog keeps (52), of others the mean of both ends. `held` is the collar's own force."""
        operator: Any = self.operator
        free, load = self.interior, self.load
        if getattr(operator, "is_linear", True):
            constant = held - self.share(before.number) * load  # g at u = 0
            inner = before.u[free]
            along = inner.mean(axis=0) if self.floats else 0.0  # with which only rounding grows
            left = self.dot(inner - along, after.g) + self.dot(constant, after.u[free] + along)
            return left / 2
        volume, total = operator.points.spacing**operator.points.dimension, 0.0
        for one in (before, after):
            work = self.share(one.number) * self.dot(load, one.u[free])
            total += float(operator.energy(one.u)) / volume - work
        return total / 2


def step(body: Inert, state: State, dt: float) -> State:
    """One step of velocity Verlet (theory, 49): kick, drift, force, kick.

    Args:
        body: what moves.
        state: before the step, which is left as it is.
        dt: Δt [ps]; nothing is asked of it. Below zero it undoes the step before the state.
    """
    half = state.v - dt / (2 * body.inertia) * state.g
    u = state.u.copy()
    u[body.interior] += dt * half
    moved = body.state(u, half, state.number + (1 if dt > 0 else -1))
    return State(u, half - dt / (2 * body.inertia) * moved.g, moved.g, moved.number)


def march(
    operator: LPSOperator,
    b: ArrayLike | None,
    u: ArrayLike,
    *,
    v: ArrayLike | None = None,
    density: Positive,
    step: Positive,
    steps: Count,
    every: Count = 1,
    record: ArrayLike | None = None,
    signal: ArrayLike | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: Count = 10,
    series: str | os.PathLike[str] | None = None,
) -> Motion:
    """March ρ ü = b − L u on the interior; the collar stays where it is.

    Only on lattices: on scattered points ``op(u)`` of LPSOperator is a node's share of the load
    around it, whose mass is a matrix. On ranks fields are those of this rank's nodes.

    Args:
        operator: of a model on a lattice.
        b: body force density [TPa/Å], shape [N, d]; None for none.
        u: displacement at the start [Å], shape [N, d].
        v: velocity at the start [Å/ps], shape [N, d], zero by default; that of the collar is not
            looked at.
        density: ρ [kg/m³].
        step: Δt [ps], at most the critical one.
        steps: number of steps.
        every: steps from one record to the next.
        record: nodes whose displacement is recorded, numbers [n] or [N] bool.
        signal: what the load is multiplied by before the first and after each step, shape
            [steps + 1]; 1 by default. The energy is then conserved only while it is constant.
        checkpoint: file to go on from; written every `checkpoint_every` records and at the end.
        series: folder for a file of each record, for ParaView.

    Returns:
        A motion whose time [ps] is half a step after each `every` steps, and whose energy is what
        leapfrog conserves (theory, 52), a mean over interior nodes [TPa]. With `record` there
        is a history "u" too, [R, n, d]: the mean of the displacements around these times.

    Raises InputError for scattered points, arrays that do not fit, a step that is too long, which
    says how long it may be, the checkpoint of another motion, and one beside a record.
    """
    sizes: Any = {"density": density, "step": step, "steps": steps, "every": every}
    nodes, body, state = started(operator, {"u": u, "v": v, "b": b}, signal, **sizes)
    with agreed(nodes.comm):
        check_whole("checkpoint_every", checkpoint_every, 1)
        if not (checkpoint is None or record is None):
            raise InputError("record: expected none beside a checkpoint, which does not hold it")
        seen = recorded_nodes(record, len(body.interior))
    kept = KeptMotion(nodes, body, step, every, checkpoint, checkpoint_every)
    if series is not None:
        kept.series = TimeSeriesWriter(series, nodes, operator.points.x)
    return marched(body, state, step, int(steps), int(every), kept, seen)


def started(
    operator: Any,
    fields: dict[str, Any],
    signal: Any = None,
    *,
    density: float,
    step: float,
    steps: int,
    every: int,
) -> tuple[Any, Inert, State]:
    """Nodes of this process, what moves and its start, after the checks of `march`.

    `fields` are u, v and b, shape [N, d]; None for zero. The rest, and errors, are as of `march`.
    """
    points: Any = operator.points
    nodes: Any = points if is_piece(points) else AllNodes(len(points.x))
    with agreed(nodes.comm):
        check_lattice(points)
        shape = points.x.shape
        start = {
            name: np.zeros(shape) if field is None else read(name, field, float, shape).copy()
            for name, field in fields.items()
        }
        check_positive("step", step)
        steps = check_whole("steps", steps, 1)
        check_whole("every", every, 1)
        signal = None if signal is None else read("signal", signal, float, (steps + 1,))
    allowed = bool(getattr(operator, "allowed", False))
    with shared_by(nodes.comm), quietly(allowed):  # the operator says it once
        own = getattr(operator, "max_symbol_eigenvalue", None)  # of more than its model
        stiffest = own() if own else stiffest_of(operator.model, points.spacing, allowed)
    longest = float(2 * np.sqrt(inertia(density, operator.model.units) / stiffest))
    if step > longest:
        raise InputError(
            f"step: expected at most {longest:.6g} ps (2/ω of the stiffest wave), got {step:.6g} "
            "ps, at which waves may grow without bound"
        )
    free = points.interior
    body = Inert(operator, free, density, start["b"][free], signal)
    if nodes is points:
        body.dot, body.count = points.dot, int(nodes.comm.allreduce(body.count))
    elif free.all():
        along = np.ones(shape)
        felt = np.abs(operator(along) - operator(0 * along)).max()
        body.floats = bool(felt <= NO_FORCE * np.max(body.inertia) * (2 / longest) ** 2)
    return nodes, body, body.state(start["u"], start["v"][free])


def recorded_nodes(record: ArrayLike | None, count: int) -> np.ndarray | None:
    """Numbers of the nodes to record, [n]; InputError for what names none of so many."""
    if record is None:
        return None
    try:
        nodes = np.atleast_1d(np.asarray(record))
        if nodes.ndim != 1:
            raise IndexError(f"got shape {list(nodes.shape)}")
        if nodes.dtype != bool and (nodes < 0).any():  # NumPy counts these from the end
            raise IndexError(f"index {nodes.min()} is below 0")
        return np.asarray(np.arange(count)[nodes])
    except (IndexError, TypeError, ValueError) as error:
        raise InputError(f"record: expected nodes among {count}: {error}") from None


def marched(
    body: Inert,
    state: State,
    dt: float,
    steps: int,
    every: int,
    kept: KeptMotion | None = None,
    record: np.ndarray | None = None,
    passed: Callable[[int, State], None] | None = None,
) -> Motion:
    """A loop over steps, with the energy (52) halfway in every so many of them.

    `kept` may begin later, and sees each record and the end; `record` are numbers of nodes;
    `passed` is told each state by the steps before it.
    """
    free, inertia, dot = body.interior, body.inertia, body.dot
    still = np.where(free[:, None], 0.0, state.u)
    held = body.operator(still)  # what the collar pulls
    begin, energy, seen, bent = 0, list[float](), list[np.ndarray](), 0.0
    operator: Any = body.operator
    if kept is not None:
        state, begin, energy = kept.begun(state, steps)
    for number in range(begin, steps):
        if passed is not None:
            passed(number, state)
        before, state = state, step(body, state, dt)
        recorded = number % every == 0
        if recorded:
            half = state.v + dt / (2 * inertia) * state.g
            kinetic = dot(inertia / 2 * half, half)
            energy.append((kinetic + body.potential(before, state, held)) / body.count)
            if hasattr(operator, "largest_gradient"):
                bent = max(bent, float(operator.largest_gradient(state.u)))
            if record is not None:
                seen.append((before.u[record] + state.u[record]) / 2)
        if kept is not None and (recorded or number + 1 == steps):
            kept.reached(number + 1, state, energy, recorded=recorded, last=number + 1 == steps)
    if not np.isfinite(state.u).all():
        raise InputError(f"step: the motion grew without bound in {steps} steps; shorten it")
    time = (np.arange(len(energy)) * every + 0.5) * dt
    history = {"energy": np.array(energy)} | ({} if record is None else {"u": np.array(seen)})
    if bent and bent > (proven := operator.model.proven_strain(operator.points.spacing)) > 0:
        told = f"strain: the step is stable up to |H| = {proven:.2%}, the motion went to {bent:.2%}"
        warn(told)
    return Motion(time, state.u, body.on_all(state.v), history)


class KeptMotion:
    """Files of a motion: a checkpoint, and records for ParaView.

    Args:
        nodes: of this process, as AllNodes.
        body: what moves.
        dt, every: Δt, and steps from one record to the next.
        checkpoint: file to go on from; written every `often` records and at the end.

    Attributes:
        series: of the records, where they are asked for.
    """

    def __init__(
        self, nodes: Any, body: Inert, dt: float, every: int, checkpoint: Any, often: int
    ) -> None:
        self.nodes, self.body, self.dt, self.every, self.often = nodes, body, dt, every, often
        self.file = None if checkpoint is None else RunFile(checkpoint, KIND, nodes)
        self.series: TimeSeriesWriter | None = None
        self._mark = ""

    def begun(self, state: State, steps: int) -> tuple[State, int, list[float]]:
        """The state to go on from, the steps behind it, and the energies so far.

        Raises InputError for the checkpoint of another motion, and one that is further.
        """
        if self.file is None:
            return state, 0, []
        body, v = self.body, self.body.on_all(state.v)
        of: Any = body.operator
        x, h = of.points.x, of.points.spacing
        probe = SMALL * h * np.sin(x @ PROBE[: x.shape[1], : x.shape[1]] / h)
        felt = of(state.u + probe) - body.load  # of the law, cracks, moduli of nodes
        known = fingerprint(of.model, of.points.units, of.points.axis, body.signal)
        sizes = self.dt, body.inertia, self.every
        self._mark = self.nodes.mark(state.u, v, body.on_all(felt), x, body.interior, *sizes, known)
        if (kept := self.file.read("u", "v")) is None:
            return state, 0, []
        arrays, values = kept
        if values["mark"] != self._mark:
            raise InputError(f"{self.file.path}: expected a checkpoint of this motion")
        if values["steps"] > steps:
            raise InputError(
                f"{self.file.path}: expected at least the {values['steps']} steps of the "
                f"checkpoint, got {steps}; name another file for a shorter run"
            )
        if self.series is not None:
            self.series.times = values["files"]
        there = body.state(arrays["u"], arrays["v"][body.interior], values["steps"])
        return there, values["steps"], values["energy"]

    def reached(
        self, done: int, state: State, energy: list[float], *, recorded: bool, last: bool
    ) -> None:
        """After so many steps: a record, or the end."""
        nodal = {"u": state.u, "v": self.body.on_all(state.v)}
        if self.series is not None and recorded:
            fields = {"displacement": nodal["u"], "velocity": nodal["v"]}
            self.series.write(done, done * self.dt, fields)
        if self.file is not None and (last or len(energy) % self.often == 0):
            values = {"mark": self._mark, "steps": done, "energy": energy}
            times = {} if self.series is None else self.series.times
            self.file.write(nodal, values | {"files": times})
