"""A run of many steps: ledger and histories on the way, fields for ParaView, and going on again."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.damage.lattice_body import HAIR, cells, crossing_bonds, size_and_normal
from warp_peri.damage.motion import BreakingBody, BreakingState, check_step, step
from warp_peri.errors import InputError
from warp_peri.files.atomic import as_path
from warp_peri.files.checkpoint import ALONE, AllNodes, RunFile, agreed, fingerprint
from warp_peri.files.series import Series
from warp_peri.points.arrays import check_mapping, check_whole, checked

NODAL = ("u", "v", "force", "energy", "work")
"""Arrays of a state that a checkpoint holds for each node."""
KIND = "warp_peri.crack"
"""Of its checkpoints."""
LEDGER = ("time", "work", "kinetic", "elastic", "dissipated")


@dataclass
class History:
    """What was written down on the way.

    Attributes:
        ledger: time, work, kinetic, elastic, dissipated, one row a record.
        u, v: mean displacement and velocity of named regions, one row a record.
        force: force per thickness across named sections, on the side that lies to the left of the
            line.
        watched: what was asked of the damage, by name.
    """

    ledger: list[list[float]] = field(default_factory=list)
    u: dict[str, list[list[float]]] = field(default_factory=dict)
    v: dict[str, list[list[float]]] = field(default_factory=dict)
    force: dict[str, list[list[float]]] = field(default_factory=dict)
    watched: dict[str, list[Any]] = field(default_factory=dict)

    @property
    def missing(self) -> float:
        """Largest part of the largest work so far that the ledger does not account for.

        Raises InputError when nothing has been recorded.
        """
        if not self.ledger:
            raise InputError("history: expected a run of some steps, nothing has been recorded")
        rows = np.array(self.ledger)
        missing, scale = np.abs(rows[:, 1] - rows[:, 2:].sum(axis=1)), np.abs(rows[:, 1]).max()
        return float(missing.max() / scale) if scale else 0.0

    def by_name(self) -> dict[str, np.ndarray]:
        """Histories as arrays: the ledger, "u NAME", "v NAME", "force NAME", what is watched."""
        named = {name: self.column(name) for name in LEDGER[1:]}
        for kind in ("u", "v", "force"):
            named |= {f"{kind} {name}": np.array(r) for name, r in getattr(self, kind).items()}
        return named | {name: np.array(rows) for name, rows in self.watched.items()}

    def column(self, name: str) -> np.ndarray:
        """One column of the ledger, by its name, shape [K]; InputError for another name."""
        if name not in LEDGER:
            raise InputError(f"column: expected one of {', '.join(LEDGER)}, got {name!r}")
        return np.reshape(self.ledger, (-1, len(LEDGER)))[:, LEDGER.index(name)]


class Section:
    """The bonds across a straight line, to sum the force that they carry.

    Args:
        body: the body in motion.
        line: two ends, shape [2, 2]; in space the corners of a flat polygon, [P, 3].
        own: the nodes whose bonds are summed here.

    Raises InputError for a line of another shape.
    """

    def __init__(self, body: BreakingBody, line: ArrayLike, own: Any) -> None:
        cut = crossing_bonds(body.body, line)
        self.ends = ends = checked("section", line)
        if body.body.dimension == 2 and len(ends) != 2:
            raise no_section(ends)
        node, bond = np.nonzero(cut)
        here = np.zeros(len(cut), bool)
        here[own] = True
        height = (body.body.x[node] - ends[0]) @ size_and_normal(ends)[1]
        left = height > -HAIR / 2 * body.body.spacing  # nodes on the line stand on its left
        left &= here[node]
        self.count = int(here[node].sum())
        self._node, self._bond, self._owner = node[left], bond[left], body

    def carried(self, state: BreakingState) -> np.ndarray:
        """Force density of each bond across the line, shape [E, d]."""
        owner, node, bond = self._owner, self._node, self._bond
        body, (stiffness, share, excess) = owner.body, owner.operator.bonded
        far, kept = body.neighbour[node, bond], owner.operator.kept(state.links, node, bond)
        u, xi = owner.displacement(state), body.xi[bond]
        e = (xi * (u[far] - u[node])).sum(axis=1)
        pull = 2 * stiffness[bond] * e
        if excess != 0:
            theta = owner.operator.dilatation(node) + owner.operator.dilatation(far)
            pull = pull + excess * share[bond] * theta
        carried: np.ndarray = (pull * kept)[:, None] * xi
        return carried


def no_section(ends: np.ndarray) -> InputError:
    """What is said of a line that is no section."""
    return InputError(f"section: expected two ends of a line that bonds cross, got {ends.tolist()}")


class CrackRun:
    """Marches a body, and goes on from its checkpoint with the same bits.

    On ranks the body is that of some nodes, and all records are of the whole body.

    Args:
        body: the body; on ranks of the nodes here.
        step: Δt, at most the body's longest.
        every: steps from one record to the next.
        regions: own nodes whose mean displacement and velocity are recorded, [n] bool by name.
        watch: functions of φ [N], the share of bonds that nodes have lost, recorded by name.
        sections: lines across which the force is recorded, [2, 2] by name; in space polygons.
        checkpoint: file to go on from; written every `checkpoint_every` records.
        series: folder for ParaView's files, one a record.
        allow_unstable: warn about a step that is too long instead of raising.
        nodes: which of the body's are this process's own, as AllNodes; all by default.

    Raises InputError for a step or counts that are not > 0, for regions without nodes, and for
    sections without bonds.
    """

    def __init__(
        self,
        body: BreakingBody,
        *,
        step: float,
        every: int = 20,
        regions: Mapping[str, ArrayLike] | None = None,
        watch: Mapping[str, Callable[[np.ndarray], Any]] | None = None,
        sections: Mapping[str, ArrayLike] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: int = 10,
        series: str | os.PathLike[str] | None = None,
        allow_unstable: bool = False,
        nodes: Any = None,
    ) -> None:
        self.nodes: Any = AllNodes(len(body.body.x)) if nodes is None else nodes
        own, comm = self.nodes.own, self.nodes.comm
        x = body.body.x[own]
        with agreed(comm):
            check_step(body, step, allow_unstable=allow_unstable)
            check_whole("every", every, 1)
            for name, given in (("watch", watch), ("regions", regions), ("sections", sections)):
                check_mapping(name, given or {})
            if not all(map(callable, (watch or {}).values())):
                raise InputError(f"watch: expected functions by name, got {watch!r:.50}")
            check_whole("checkpoint_every", checkpoint_every, 1)
            self.regions = {
                name: checked(f"region {name}", mask, bool, (len(x),))
                for name, mask in (regions or {}).items()
            }
            lines = (sections or {}).items()
            self.sections = {name: Section(body, line, own) for name, line in lines}
        self._size = {name: int(comm.allreduce(int(m.sum()))) for name, m in self.regions.items()}
        for name, size in self._size.items():
            if not size:
                raise InputError(f"region {name}: expected one node or more, got none")
        for section in self.sections.values():
            if not comm.allreduce(section.count):
                raise no_section(section.ends)
        self.body, self.dt, self.every = body, float(step), int(every)
        self.watch = dict(watch or {})
        self.path = None if checkpoint is None else as_path("checkpoint", checkpoint)
        self.checkpoint_every = int(checkpoint_every)
        self.series = None
        if series is not None and comm is ALONE:
            self.series = Series(series, self.nodes, x, cells(body.body))
        elif series is not None:
            self.series = Series(series, nodes.piece)
        self.history = History()
        self._began, self._first, self._ramp = "", (0.0, 0), list[float]()

    def march(self, state: BreakingState, *, steps: int, progress: bool = False) -> BreakingState:
        """March to `steps` steps in all, from the checkpoint if there is one, else from `state`.

        Raises InputError for the checkpoint of another body, start, load or step, naming what
        differs, and for fewer steps than the checkpoint or the state has behind it.
        """
        if not self._began or state.steps == 0:
            self._first, self._ramp = (state.time, state.steps), []
            self._began = self._start_mark(state)
        steps = check_whole("steps", steps, 0)
        state = self._resumed(state, steps)
        if state.steps > steps:
            raise InputError(
                f"steps: expected at least the {state.steps} that the state has taken, got {steps}"
            )
        with tqdm(total=steps, initial=state.steps, disable=not progress, unit="step") as bar:
            while state.steps < steps:
                step(self.body, state, self.dt)
                bar.update()
                if state.steps % self.every == 0 or state.steps == steps:
                    self._record(state)
                    records = len(self.history.ledger)
                    if self.path is not None and records % self.checkpoint_every == 0:
                        self._save(self.path, state)
        return state

    def _record(self, state: BreakingState) -> None:
        body, nodes, history = self.body, self.nodes, self.history
        own = nodes.own
        history.ledger.append(body.ledger(state, nodes))
        u, v = body.displacement(state)[own], body.velocity(state)[own]
        for name, mask in self.regions.items():
            for values, where in ((u, history.u), (v, history.v)):
                mean = nodes.sum(values[mask]) / self._size[name]
                where.setdefault(name, []).append(mean.tolist())
        cell = body.body.spacing**body.body.dimension
        for name, section in self.sections.items():
            force = cell * nodes.sum(section.carried(state))
            history.force.setdefault(name, []).append(force.tolist())
        if self.watch or self.series is not None:
            phi = body.damage(state)[own]
        if self.watch:
            everywhere = nodes.gather(phi)
            for name, function in self.watch.items():
                seen = np.asarray(function(everywhere)).tolist()
                history.watched.setdefault(name, []).append(seen)
        if self.series is not None:
            fields = {"displacement": u, "velocity": v, "damage": phi}
            self.series.write(state.steps, state.time, fields)

    def _start_mark(self, state: BreakingState) -> str:
        fields = [field.numpy() for field in (state.u, state.v)]
        parts = [*fields, self._left(state), state.whole, state.work.numpy(), state.dissipated]
        return str(self.nodes.mark(*parts, *self._first))

    def _left(self, state: BreakingState) -> np.ndarray:
        """Which bonds of the ball a node still has, shape [m, B]."""
        return self.body.operator.kept(state.links).astype(np.uint8)

    def _record_marks(self) -> tuple[Any, ...]:
        lines = [section.ends for section in self.sections.values()]
        names = list(self.sections), [*self.regions, *self.watch]
        masks = [self.nodes.gather(mask) for mask in self.regions.values()]
        return (self.every, *names, *lines, *masks)

    def _key(self) -> dict[str, str]:
        """What the run depends on, by name; its load history is kept by its values, `_applied`."""
        body = self.body
        return {
            "start": self._began,
            "nodes": self.nodes.mark(body.body.x),
            "solid": fingerprint(body.solid, body.operator.limits, body.corrected),
            "no_fail": self.nodes.mark(body.no_fail),
            "load": self.nodes.mark(body.load.numpy()),
            "held": self.nodes.mark(body.held.numpy()),
            "grip": self.nodes.mark(body.grip.numpy()),
            "step": fingerprint(self.dt),
            "records": fingerprint(self._record_marks(), self.watch),
        }

    def _applied(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """All times up to so many steps, as `step` adds them up, and the ramp there."""
        begin, first = self._first
        times = np.cumsum([begin, *np.full(steps - first, self.dt)])
        new = times[len(self._ramp) :].tolist()
        self._ramp += [self.body.share(time) for time in new]
        return times, np.array(self._ramp[: len(times)])

    def _check(self, content: Mapping[str, Any], steps: int) -> None:
        """Refuse the checkpoint of another run, naming what differs, or one further than asked."""
        kept, own = content["key"], self._key()
        differ = [name for name in own if kept.get(name) != own[name]]
        taken, ramps = int(content["steps"]), np.array(content["ramp"])
        if not differ:  # the history of loads is that of the same steps
            times, ramp = self._applied(taken)
            other = np.flatnonzero(ramp != ramps)
            if len(other):
                n = other[0]
                differ = [
                    f"load history, from t = {times[n]:g} on ({ramps[n]:g} there, {ramp[n]:g} here)"
                ]
        if differ:
            raise InputError(
                f"{self.path}: the checkpoint of another body, start, load or step; what differs: "
                f"{', '.join(differ)}"
            )
        if taken > steps:
            raise InputError(
                f"{self.path}: expected at least the {taken} steps of the checkpoint, got {steps}; "
                "name another file for a shorter run"
            )

    def _save(self, path: Any, state: BreakingState) -> None:
        own = self.nodes.own
        arrays = {name: getattr(state, name).numpy() for name in NODAL}
        arrays |= {"dissipated": state.dissipated, "whole": state.whole, "left": self._left(state)}
        content = {
            "time": state.time,
            "steps": state.steps,
            "key": self._key(),
            "ramp": self._applied(state.steps)[1].tolist(),
            "history": vars(self.history),
            "files": {} if self.series is None else self.series.times,
        }
        nodal = {name: array[own] for name, array in arrays.items()}
        RunFile(path, KIND, self.nodes).write(nodal, content)

    def _resumed(self, state: BreakingState, steps: int) -> BreakingState:
        if self.path is None:
            return state
        kept = RunFile(self.path, KIND, self.nodes).read(*NODAL, "dissipated", "whole", "left")
        if kept is None:
            return state
        arrays, content = kept
        self._check(content, steps)
        for name in NODAL:
            getattr(state, name).numpy()[:] = arrays[name]
        left = np.where(arrays["left"], self.body.body.neighbour, -1)
        state.links = self.body.operator.links(left)
        state.dissipated[:], state.whole = arrays["dissipated"], arrays["whole"]
        state.time, state.steps = float(content["time"]), int(content["steps"])
        self.history = History(**content["history"])
        if self.series is not None:
            self.series.times = content["files"]
        return state
