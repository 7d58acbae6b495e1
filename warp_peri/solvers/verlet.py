"""Explicit dynamics ρ ü = b − L u on a lattice: velocity Verlet, its time step and its energy. The
symbol bounds the step (theory, 49–51); the energy that leapfrog keeps is (52)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike

from warp_peri.core.proof import stencil_of
from warp_peri.errors import Arrays, InputError, Values, agreed, quietly, shared_by, warn
from warp_peri.files.checkpoint import AllNodes, fingerprint, is_users
from warp_peri.points import arguments
from warp_peri.points.arguments import USUAL, Count, Positive, Units, factors, offered, typed
from warp_peri.points.arguments import checked as read
from warp_peri.points.mesh import checked_numbers
from warp_peri.points.points import check_lattice
from warp_peri.solvers.motion import Motion, Recorder

if TYPE_CHECKING:
    from warp_peri.materials.lps_operator import LPSOperator

INERTIA = 1e-8
"""1 kg/m³ in TPa ps²/Å²."""
PROBE, SMALL = np.array([[1.3, -0.7, 2.1], [0.4, 1.9, -1.1], [-2.3, 0.6, 0.9]]), 1e-4
"""Waves of a field that feels every bond, and its size in spacings."""


def stiffest_of(law: Any, spacing: float, allow_uncertified: bool) -> float:
    """Largest symbol eigenvalue of a law of tensors, for its own spacing, which needs a proof."""
    offered(law, "max_symbol_eigenvalue", "critical_time_step", "a linear solid or a crystal")
    stencil_of(law, spacing, "critical_time_step")
    if not (allow_uncertified or law.statement or law.certified().certificate.holds):
        raise InputError("material: expected one whose certificate holds; waves may grow")
    return float(law.max_symbol_eigenvalue())


@dataclass(frozen=True)
class State:
    """State of a motion after some steps: u [N, d], v and L u − b of the interior [I, d]."""

    u: ndarray
    v: ndarray
    g: ndarray
    steps: int = 0


NO_FORCE = 1e-9
"""Of the stiffest wave's: what a motion as a whole feels by rounding alone."""


@typed
def inertia(density: Positive, units: Units) -> float:
    """Density ρ in units of stress · ps² over length², from kg/m³; InputError for reduced units,
    which have neither kilograms nor picoseconds, and a density not > 0."""
    length, stress = factors(units, USUAL)
    return INERTIA * density * length**2 / stress


class Inert:
    """Interior nodes with inertia under a load: ρ ü = s(t) b − L u.

    Args:
        operator: L on a lattice.
        interior: nodes that move, shape [N] bool.
        density: ρ [kg/m³].
        load: b on the interior nodes [TPa/Å], shape [I, d].
        u: displacement of all nodes, shape [N, d]; that of the collar stays.
        signal: s after each step, shape [steps + 1]; None for 1.

    Attributes:
        dot: the scalar product of two fields [I, d]; over all ranks where there are some.
        count: of interior nodes, likewise.
        floats: whether nothing is held, and to move as a whole costs nothing.
    """

    def __init__(
        self,
        operator: LPSOperator,
        interior: ndarray,
        density: float,
        load: ndarray,
        u: ndarray,
        signal: ndarray | None = None,
    ) -> None:
        self.operator, self.interior, self.load, self.signal = operator, interior, load, signal
        self.inertia = inertia(density, operator.model.units)
        self.dot: Callable[[ndarray, ndarray], float] = np.vdot
        self.count = int(np.count_nonzero(interior))
        self.held = operator(np.where(interior[:, None], 0.0, u))  # what the collar pulls
        self.floats = False

    def on_all(self, inner: ndarray) -> ndarray:
        """Extend a field of interior nodes [I, d] to all by zeros."""
        field = np.zeros((len(self.interior), inner.shape[1]))
        field[self.interior] = inner
        return field

    def share(self, steps: int) -> float:
        """Load factor s(t) after so many steps."""
        return 1.0 if self.signal is None else float(self.signal[steps])

    def state(self, u: ndarray, v: ndarray, steps: int = 0) -> State:
        """The state with displacement [N, d] and velocity [I, d] after so many steps."""
        return State(u, v, self.operator(u) - self.share(steps) * self.load, steps)

    def potential(self, before: State, after: State) -> float:
        """Potential energy per volume of a node halfway in a step, up to a constant: of a linear
        force what leapfrog keeps (52), of others the mean of both ends."""
        operator: Any = self.operator
        free, load = self.interior, self.load
        if getattr(operator, "is_linear", True):
            constant = self.held - self.share(before.steps) * load  # g at u = 0
            inner = before.u[free]
            along = inner.mean(axis=0) if self.floats else 0.0  # with which only rounding grows
            left = self.dot(inner - along, after.g) + self.dot(constant, after.u[free] + along)
            return left / 2
        volume, total = operator.points.spacing**operator.points.dimension, 0.0
        for one in (before, after):
            work = self.share(one.steps) * self.dot(load, one.u[free])
            total += float(operator.energy(one.u)) / volume - work
        return total / 2


def step(body: Inert, state: State, dt: float) -> State:
    """Make one step Δt [ps] of velocity Verlet (theory, 49): kick, drift, force, kick. The state is
    left as it is."""
    half = state.v - dt / (2 * body.inertia) * state.g
    u = state.u.copy()
    u[body.interior] += dt * half
    moved = body.state(u, half, state.steps + 1)
    return State(u, half - dt / (2 * body.inertia) * moved.g, moved.g, moved.steps)


def march(
    operator: LPSOperator,
    b: ArrayLike | None,
    u: ArrayLike,
    *,
    v: Any = None,
    density: Positive,
    step: Positive,
    steps: Count,
    record: ArrayLike | None = None,
    signal: Any = None,
    **files: Any,
) -> Motion:
    """March ρ ü = b − L u on the interior of a lattice; the collar stays where it is.

    Only on lattices: on scattered points ``op(u)`` of LPSOperator is a node's share of the load
    around it, whose mass is a matrix. On ranks fields are those of this rank's nodes.

    Args:
        operator: of a model on a lattice.
        b: body force density [TPa/Å], shape [N, d]; None for none.
        u: displacement at the start [Å], shape [N, d].
        v: velocity at the start [Å/ps], shape [N, d], zero by default, read on the interior.
        density: ρ [kg/m³].
        step: Δt [ps], at most the critical one.
        steps: number of steps.
        record: nodes whose displacement is recorded, numbers [n] or [N] bool.
        signal: what the load is multiplied by before the first and after each step, shape
            [steps + 1]; 1 by default. The energy is then conserved only while it is constant.
        files: every, checkpoint, checkpoint_every and series, as of Recorder.

    Returns a motion whose time [ps] is half a step after each `every` steps, and whose energy is
    what leapfrog conserves (theory, 52), a mean over interior nodes [TPa]. With `record` there is a
    history "u" too, [R, n, d]: the mean of the displacements around these times. Raises InputError
    for scattered points, arrays that do not fit, a step that is too long, which says how long it
    may be, the checkpoint of another motion, and one beside a record.
    """
    nodes, body, state = started(
        operator, {"u": u, "v": v, "b": b}, signal, density=density, step=step, steps=steps
    )
    with agreed(nodes.comm):
        if not (files.get("checkpoint") is None or record is None):
            raise InputError("record: expected none beside a checkpoint, which does not hold it")
        seen = recorded_nodes(record, len(body.interior))
    run = WaveRun(nodes, body, step, seen, **files)
    return run.motion(run.march(state, steps=steps))


def started(
    operator: Any, fields: Values, signal: Any = None, *, density: float, step: float, steps: int
) -> tuple[Any, Inert, State]:
    """Check the arguments of `march`, `fields` u, v and b, [N, d], of the last two None for zero;
    returns nodes of this process, the moving body and its start."""
    points: Any = operator.points
    nodes: Any = points if arguments.is_piece(points) else AllNodes(len(points.x))
    with agreed(nodes.comm):
        check_lattice(points)
        shape, zero = points.x.shape, 0 * points.x
        start = {
            name: read(name, zero if field is None and name != "u" else field, float, shape).copy()
            for name, field in fields.items()
        }
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
    body = Inert(operator, free, density, start["b"][free], start["u"], signal)
    if nodes is points:
        body.dot, body.count = points.inner.dot, int(nodes.comm.allreduce(body.count))
    elif free.all():
        along = np.ones(shape)
        felt = np.abs(operator(along) - operator(0 * along)).max()
        body.floats = bool(felt <= NO_FORCE * body.inertia * (2 / longest) ** 2)
    return nodes, body, body.state(start["u"], start["v"][free])


def recorded_nodes(record: ArrayLike | None, count: int) -> ndarray | None:
    """Numbers of the nodes to record, [n]; InputError for what names none of `count` nodes."""
    if record is None:
        return None
    nodes = np.atleast_1d(arguments.as_array("record", record))
    if nodes.dtype == bool:
        nodes = np.flatnonzero(read("record", nodes, bool, (count,)))
    return checked_numbers("record", nodes, ("n",), count, "nodes")


class WaveRun(Recorder):
    """Motion that records the energy (52) halfway in every so many steps, and displacements of the
    nodes `seen`; `files` are the other arguments of Recorder."""

    kind, phase, ends = "warp_peri.waves", 1, False

    def __init__(
        self, nodes: Any, body: Inert, dt: float, seen: ndarray | None = None, **files: Any
    ) -> None:
        super().__init__(nodes, body.operator.points.x, **files)
        self.body, self.dt, self.seen = body, dt, seen

    def advance(self, state: State) -> State:
        self.before = state
        return step(self.body, state, self.dt)

    def record(self, state: State) -> tuple[float, Values, Values]:
        body, before, operator = self.body, self.before, self.body.operator
        half = state.v + self.dt / (2 * body.inertia) * state.g
        energy = body.dot(body.inertia / 2 * half, half) + body.potential(before, state)
        if hasattr(operator, "largest_gradient"):
            self.bent = max(self.bent, float(operator.largest_gradient(state.u)))
        values = {"time": (before.steps + 0.5) * self.dt, "energy": energy / body.count}
        if self.seen is not None:
            values["u"] = (before.u[self.seen] + state.u[self.seen]) / 2
        return state.steps * self.dt, values, {}

    def nodal(self, state: State) -> Arrays:
        return {"u": state.u, "v": self.body.on_all(state.v)}

    def restored(self, state: State, arrays: Arrays, steps: int) -> State:
        return self.body.state(arrays["u"], arrays["v"][self.body.interior], steps)

    @cached_property
    def law(self) -> str:
        """Mark of the solid on its nodes, which costs a force."""
        body, of, points = self.body, self.body.operator, self.body.operator.points
        d, h = points.dimension, points.spacing
        felt = of(SMALL * h * np.sin(points.x @ PROBE[:d, :d] / h))  # all of a linear law
        told = getattr(of, "is_linear", False) and not is_users(type(of.model).__module__)
        known = None if told else of.model, body.inertia
        return str(self.nodes.mark(body.on_all(felt), points.x, body.interior)) + fingerprint(known)

    def key(self, steps: int) -> dict[str, str]:
        body = self.body
        signal = np.ones(0) if body.signal is None else body.signal[: steps + 1]
        return {
            "law": self.law,
            "load": self.nodes.mark(body.on_all(body.load)),
            "signal": fingerprint(signal if (signal != 1).any() else None),
            "step": fingerprint(self.dt, self.every),
        }

    def motion(self, state: State) -> Motion:
        """Motion so far; InputError for unbounded growth, warns beyond the proven strain."""
        if not np.isfinite(state.u).all():
            raise InputError(
                f"step: the motion grew without bound in {state.steps} steps; shorten it"
            )
        operator: Any = self.body.operator
        time, history = self.recorded()
        if self.bent:
            proven = operator.model.proven_strain(operator.points.spacing)
            if self.bent > proven > 0:
                warn(
                    f"strain: the step is stable up to |H| = {proven:.2%}, the motion went to "
                    f"{self.bent:.2%}"
                )
        return Motion(time, state.u, self.body.on_all(state.v), history, axis="time [ps]")
