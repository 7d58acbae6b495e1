"""A run of many steps: ledger and histories on the way, fields for ParaView, and going on again."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import AllNodes, RunFile, agreed, fingerprint
from warp_peri.files.series import TimeSeriesWriter
from warp_peri.fracture.body import HAIR, section
from warp_peri.fracture.dynamics import BreakingBody, BreakingState, step
from warp_peri.points.arguments import Count, Natural, Positive
from warp_peri.points.arrays import check_positive, check_whole, checked
from warp_peri.solvers.motion import Motion

NODAL = ("u", "v", "force", "energy", "work")
"""Arrays of a state that a checkpoint holds for each node."""
KIND = "warp_peri.crack"
"""Of its checkpoints."""
LEDGER = ("time", "work", "kinetic", "elastic", "dissipated")


class Broken(NamedTuple):
    """How a motion has ended: φ, the share of bonds that a node has lost, [N]; body and state."""

    damage: np.ndarray
    body: BreakingBody
    state: BreakingState


class Section:
    """The bonds across a straight line, to sum the force that they carry.

    Args:
        body: the body in motion.
        line: two ends, shape [2, 2]; in space the corners of a flat polygon, [P, 3].
        own: the nodes whose bonds are summed here.

    Raises InputError for a line of another shape.
    """

    def __init__(self, body: BreakingBody, line: ArrayLike, own: Any) -> None:
        cut, self.ends, normal = section(body.body, line, "section")
        node, bond = np.nonzero(cut)
        here = np.zeros(len(cut), bool)
        here[own] = True
        height = (body.body.x[node] - self.ends[0]) @ normal
        left = here[node] & (height > -HAIR / 2 * body.body.spacing)  # those on it stand there
        self.count = int(here[node].sum())
        self._node, self._bond, self._owner = node[left], bond[left], body

    def carried(self, state: BreakingState) -> np.ndarray:
        """Force density of each bond across the line, shape [E, d]."""
        owner, node, bond = self._owner, self._node, self._bond
        body, (stiffness, share, excess) = owner.body, owner.operator.bonded
        far, kept = body.neighbour[node, bond], owner.operator.kept(state.links, node, bond)
        u, xi = state.u.numpy(), body.xi[bond]
        e = (xi * (u[far] - u[node])).sum(axis=1)
        pull = 2 * stiffness[bond] * e
        if excess != 0:
            theta = owner.operator.dilatation(node) + owner.operator.dilatation(far)
            pull = pull + excess * share[bond] * theta
        return np.asarray((pull * kept)[:, None] * xi)


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
        nodes: which of the body's are this process's own, as AllNodes; all by default.

    Attributes:
        history: of each record by name: those of LEDGER, "u NAME" and "v NAME" of regions,
            "force NAME" across sections, per thickness on the side that lies to the left of the
            line, and what is watched.

    Raises InputError for a step or counts that are not > 0 or too long, for regions without nodes,
    and for sections without bonds.
    """

    def __init__(
        self,
        body: BreakingBody,
        *,
        step: Positive,
        every: Count = 20,
        regions: Mapping[str, ArrayLike] | None = None,
        watch: Mapping[str, Callable[[np.ndarray], Any]] | None = None,
        sections: Mapping[str, ArrayLike] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: Count = 10,
        series: str | os.PathLike[str] | None = None,
        nodes: Any = None,
    ) -> None:
        self.nodes: Any = AllNodes(len(body.body.x)) if nodes is None else nodes
        own, comm = self.nodes.own, self.nodes.comm
        x = body.body.x[own]
        with agreed(comm):
            check_positive("step", step)
            if not step <= body.longest_step:
                raise InputError(
                    f"step: expected at most {body.longest_step:.6g}, the longest that is stable "
                    f"whatever breaks, got {step:.6g}"
                )
            check_whole("every", every, 1)
            check_whole("checkpoint_every", checkpoint_every, 1)
            self.watch: dict[str, Any] = dict(watch or {})
            if not all(map(callable, self.watch.values())) or {*LEDGER} & {*self.watch}:
                raise InputError(
                    f"watch: expected functions by name, none of {', '.join(LEDGER)}, got "
                    f"{watch!r:.50}"
                )
            self.regions = {
                name: checked(f"region {name}", mask, bool, (len(x),))
                for name, mask in (regions or {}).items()
            }
            self.sections = {
                name: Section(body, line, own) for name, line in (sections or {}).items()
            }
        self._size = {name: int(comm.allreduce(int(m.sum()))) for name, m in self.regions.items()}
        for name, size in self._size.items():
            if not size:
                raise InputError(f"region {name}: expected one node or more, got none")
        for name, one in self.sections.items():
            if not comm.allreduce(one.count):
                raise InputError(f"section {name}: expected a line that bonds cross, got another")
        self.body, self.dt, self.every = body, float(step), int(every)
        self.checkpoint_every, self.file, self.series = int(checkpoint_every), None, None
        if checkpoint is not None:
            self.file = RunFile(checkpoint, KIND, self.nodes)
        if series is not None:
            self.series = TimeSeriesWriter(series, getattr(nodes, "piece", self.nodes), x)
        self.history: dict[str, list[Any]] = {}
        self._start, self._first, self._ramp = "", (0.0, 0), list[float]()

    def march(
        self, state: BreakingState, *, steps: Natural, progress: bool = False
    ) -> BreakingState:
        """March to `steps` steps in all, from the checkpoint if there is one, else from `state`.

        Raises InputError for the checkpoint of another body, start, load or step, naming what
        differs, and for fewer steps than the checkpoint or the state has behind it.
        """
        if not self._start or state.steps == 0:
            self._first, self._ramp = (state.time, state.steps), []
            self._start = self.nodes.mark(*self._nodal(state).values(), *self._first)
        steps = check_whole("steps", steps, 0)
        if self.file is not None:
            state = self._resumed(self.file, state, steps)
        if state.steps > steps:
            raise InputError(
                f"steps: expected at least the {state.steps} that the state has taken, got {steps}"
            )
        with tqdm(total=steps, initial=state.steps, disable=not progress, unit="step") as bar:
            while state.steps < steps:
                step(self.body, state, self.dt)
                self._ramp.append(self.body.share(state.time))
                bar.update()
                if state.steps % self.every == 0 or state.steps == steps:
                    self._record(state)
                    if self.file and len(self.history["time"]) % self.checkpoint_every == 0:
                        self._save(self.file, state)
        return state

    def motion(self, state: BreakingState) -> Motion:
        """What has been recorded, with the end at the nodes of this process."""
        body, own = self.body, self.nodes.own
        rows = {name: list[Any]() for name in LEDGER} | self.history
        history = {name: np.array(each) for name, each in rows.items()}
        time = history.pop("time")
        u, v = (field.numpy()[own].copy() for field in (state.u, state.v))
        return Motion(time, u, v, history, Broken(body.damage(state)[own], body, state))

    def _record(self, state: BreakingState) -> None:
        body, nodes = self.body, self.nodes
        u, v = (field.numpy()[nodes.own] for field in (state.u, state.v))
        found: dict[str, Any] = dict(zip(LEDGER, body.ledger(state, nodes)))
        for name, mask in self.regions.items():
            for kind, values in (("u", u), ("v", v)):
                found[f"{kind} {name}"] = nodes.sum(values[mask]) / self._size[name]
        cell = body.body.spacing**body.body.dimension
        for name, across in self.sections.items():
            found[f"force {name}"] = cell * nodes.sum(across.carried(state))
        if self.watch or self.series is not None:
            phi = body.damage(state)[nodes.own]
        if self.watch:
            everywhere = nodes.gather(phi)
            found |= {name: function(everywhere) for name, function in self.watch.items()}
        for name, value in found.items():
            self.history.setdefault(name, []).append(np.asarray(value).tolist())
        if self.series is not None:
            fields = {"displacement": u, "velocity": v, "damage": phi}
            self.series.write(state.steps, state.time, fields)

    def _nodal(self, state: BreakingState) -> dict[str, np.ndarray]:
        """What a checkpoint holds of each node; `left`: bonds of the ball that it has, [m, B]."""
        arrays = {name: getattr(state, name).numpy() for name in NODAL}
        left = self.body.operator.kept(state.links).astype(np.uint8)
        return arrays | {"dissipated": state.dissipated, "whole": state.whole, "left": left}

    def _key(self) -> dict[str, str]:
        """What the run depends on, by name."""
        body, nodes, lines = self.body, self.nodes, [one.ends for one in self.sections.values()]
        masks = [nodes.gather(mask) for mask in self.regions.values()]
        names = list(self.sections), list(self.regions), self.watch
        fields = {name: getattr(body, name).numpy() for name in ("load", "held", "grip")}
        fields |= {"nodes": body.body.x, "no_fail": body.no_fail}
        return {name: nodes.mark(field) for name, field in fields.items()} | {
            "start": self._start,
            "solid": fingerprint(body.solid, body.operator.limits, body.corrected),
            "load history": fingerprint(self._ramp),
            "step": fingerprint(self.dt),
            "records": fingerprint(self.every, names, lines, masks),
        }

    def _save(self, file: RunFile, state: BreakingState) -> None:
        content = {
            "time": state.time,
            "steps": state.steps,
            "key": self._key(),
            "history": self.history,
            "files": {} if self.series is None else self.series.times,
        }
        file.write({n: one[self.nodes.own] for n, one in self._nodal(state).items()}, content)

    def _resumed(self, file: RunFile, state: BreakingState, steps: int) -> BreakingState:
        """The state to go on from, which is the checkpoint's where there is one."""
        if (kept := file.read(*NODAL, "dissipated", "whole", "left")) is None:
            return state
        arrays, content = kept
        key, taken, (begin, first) = content["key"], int(content["steps"]), self._first
        times = np.cumsum([begin, *np.full(taken - first, self.dt)])  # as steps add them up
        self._ramp = [self.body.share(time) for time in times[1:].tolist()]
        if differ := [name for name, own in self._key().items() if key.get(name) != own]:
            raise InputError(
                f"{file.path}: the checkpoint of another body, start, load or step; what differs: "
                f"{', '.join(differ)}"
            )
        if taken > steps:
            raise InputError(
                f"{file.path}: expected at least the {taken} steps of the checkpoint, got {steps}; "
                "name another file for a shorter run"
            )
        for name in NODAL:
            getattr(state, name).numpy()[:] = arrays[name]
        left = np.where(arrays["left"], self.body.body.neighbour, -1)
        state.links = self.body.operator.links(left)
        state.dissipated[:], state.whole = arrays["dissipated"], arrays["whole"]
        state.time, state.steps = float(content["time"]), taken
        self.history = content["history"]
        if self.series is not None:
            self.series.times = content["files"]
        return state
