"""A run of many steps: ledger and histories on the way, fields for ParaView, and going on again."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.damage.lattice_body import HAIR, crossing_bonds, size_and_normal
from warp_peri.damage.motion import BreakingBody, BreakingState, check_step, step
from warp_peri.damage.paraview import DamageSeries
from warp_peri.errors import InputError
from warp_peri.files.archive import read_arrays
from warp_peri.files.atomic import whole_file
from warp_peri.points.arrays import check_whole, fingerprint

_ARRAYS = ("u", "v", "links", "force", "energy", "work")
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

    Raises InputError for a line of another shape, and one that no bond crosses.
    """

    def __init__(self, body: BreakingBody, line: ArrayLike) -> None:
        cut = crossing_bonds(body.body, line)
        self.ends = ends = np.asarray(line, dtype=float)
        if (body.body.dimension == 2 and len(ends) != 2) or not cut.any():
            raise InputError(
                f"section: expected two ends of a line that bonds cross, got {ends.tolist()}"
            )
        node, bond = np.nonzero(cut)
        height = (body.body.x[node] - ends[0]) @ size_and_normal(ends)[1]
        left = height > -HAIR / 2 * body.body.spacing  # nodes on the line stand on its left
        self._node, self._bond, self._owner = node[left], bond[left], body

    def of(self, nodes: np.ndarray) -> Section:
        """The same of bonds that begin at these nodes only; itself."""
        kept = np.isin(self._node, nodes)
        self._node, self._bond = self._node[kept], self._bond[kept]
        return self

    def force(self, state: BreakingState) -> np.ndarray:
        """Force per thickness on the nodes to the left of the line, over the polygon; shape [d]."""
        body = self._owner.body
        total: np.ndarray = body.spacing**body.dimension * self.carried(state).sum(axis=0)
        return total

    def carried(self, state: BreakingState) -> np.ndarray:
        """Force density of each bond across the line, shape [E, d]."""
        owner, node, bond = self._owner, self._node, self._bond
        body, model, w = owner.body, owner.operator.model, owner.operator.weights[self._bond]
        far = owner.neighbour(state)[node, bond]
        kept = far >= 0
        u, xi, d = owner.displacement(state), body.xi[bond], body.dimension
        e = (xi * (u[far] - u[node])).sum(axis=1)
        pull = 2 * d * (d + 2) * model.mu * w * e / body.r[bond] ** 2
        if model.lam != model.mu:
            theta = owner.operator.theta.numpy()
            pull = pull + d * (model.lam - model.mu) * w * (theta[node] + theta[far])
        carried: np.ndarray = (pull * kept)[:, None] * xi
        return carried


class CrackRun:
    """Marches a body, and goes on from its checkpoint with the same bits.

    Args:
        body: the body.
        step: Δt, at most the body's longest.
        every: steps from one record to the next.
        regions: nodes whose mean displacement and velocity are recorded, [N] bool by name.
        watch: functions of φ [N], the share of bonds that nodes have lost, recorded by name.
        sections: lines across which the force is recorded, [2, 2] by name; in space polygons.
        checkpoint: file to go on from; written every `checkpoint_every` records.
        series: folder for ParaView's files, one a record.
        allow_unstable: warn about a step that is too long instead of raising.

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
    ) -> None:
        check_step(body, step, allow_unstable=allow_unstable)
        check_whole("every", every, 1)
        check_whole("checkpoint_every", checkpoint_every, 1)
        self.body, self.dt, self.every = body, float(step), int(every)
        self.regions = {name: np.asarray(mask) for name, mask in (regions or {}).items()}
        for name, mask in self.regions.items():
            if mask.shape != (len(body.body.x),) or mask.dtype != bool or not mask.any():
                raise InputError(
                    f"regions: expected some of {len(body.body.x)} nodes as bool, got {name!r} of "
                    f"shape {list(mask.shape)} with {np.count_nonzero(mask)}"
                )
        self.watch = dict(watch or {})
        self.sections = {name: Section(body, line) for name, line in (sections or {}).items()}
        self.path = None if checkpoint is None else Path(checkpoint)
        self.checkpoint_every = int(checkpoint_every)
        self.series = None if series is None else DamageSeries(series, body.body)
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
        ledger = self.body.ledger(state)
        self.history.ledger.append([getattr(ledger, name) for name in LEDGER])
        u, v = self.body.displacement(state), self.body.velocity(state)
        for name, mask in self.regions.items():
            self.history.u.setdefault(name, []).append(u[mask].mean(axis=0).tolist())
            self.history.v.setdefault(name, []).append(v[mask].mean(axis=0).tolist())
        for name, section in self.sections.items():
            self.history.force.setdefault(name, []).append(section.force(state).tolist())
        if self.watch:
            phi = self.body.damage(state)
            for name, function in self.watch.items():
                self.history.watched.setdefault(name, []).append(np.asarray(function(phi)).tolist())
        if self.series is not None:
            fields = {"displacement": u, "velocity": v, "damage": self.body.damage(state)}
            self.series.write(state.steps, state.time, fields)

    def _start_mark(self, state: BreakingState) -> str:
        parts = (state.u.numpy(), state.v.numpy(), state.links.numpy(), state.whole)
        return fingerprint(*parts, state.work.numpy(), state.dissipated, *self._first)

    def _mark(self, array: np.ndarray) -> str:
        return fingerprint(array)

    def _record_marks(self) -> tuple[Any, ...]:
        lines = [section.ends for section in self.sections.values()]
        names = list(self.sections), [*self.regions, *self.watch]
        return (self.every, *names, *lines, *self.regions.values())

    def _key(self) -> dict[str, str]:
        """What the run depends on, by name; its load history is kept by its values, `_applied`."""
        body, solid, model = self.body, self.body.solid, self.body.solid.model
        numbers = (model.lam, model.mu, model.alpha, *model.D, model.horizon, solid.density)
        return {
            "start": self._began,
            "nodes": self._mark(body.body.x),
            "solid": fingerprint(
                *numbers, body.operator.limits, solid.by_energy, solid.tension_only, model.units
            ),
            "no_fail": self._mark(body.no_fail),
            "load": self._mark(body.load.numpy()),
            "held": self._mark(body.held.numpy()),
            "grip": self._mark(body.grip.numpy()),
            "step": fingerprint(self.dt),
            "records": fingerprint(self._record_marks(), self.watch),
        }

    def _applied(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """All times up to so many steps, as `step` adds them up, and the ramp there."""
        begin, first = self._first
        times = np.cumsum([begin, *np.full(steps - first, self.dt)])
        ramp = self.body.ramp
        new = times[len(self._ramp) :].tolist()
        self._ramp += [1.0 if ramp is None else float(ramp(time)) for time in new]
        return times, np.array(self._ramp[: len(times)])

    def _check(self, content: Mapping[str, np.ndarray], steps: int) -> None:
        """Refuse the checkpoint of another run, naming what differs, or one further than asked."""
        kept, own = json.loads(str(content["key"])), self._key()
        differ = [name for name in own if kept.get(name) != own[name]]
        taken = int(content["steps"])
        if not differ:  # the history of loads is that of the same steps
            times, ramp = self._applied(taken)
            other = np.flatnonzero(ramp != content["ramp"])
            if len(other):
                n = other[0]
                differ = [
                    f"load history, from t = {times[n]:g} on ({content['ramp'][n]:g} there, "
                    f"{ramp[n]:g} here)"
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

    def _save(self, path: Path, state: BreakingState) -> None:
        content = {name: getattr(state, name).numpy() for name in _ARRAYS}
        content |= {"dissipated": state.dissipated, "whole": state.whole}
        content |= {"time": np.array(state.time), "steps": np.array(state.steps)}
        content |= {"key": np.array(json.dumps(self._key())), "ramp": self._applied(state.steps)[1]}
        content["ledger"] = np.array(self.history.ledger)
        for kind in ("u", "v", "force", "watched"):
            for name, rows in getattr(self.history, kind).items():
                content[f"history_{kind}_{name}"] = np.array(rows)
        if self.series is not None:
            content["times"] = np.array(list(self.series.times.values()))
            content["files"] = np.array(list(self.series.times))
        with whole_file(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **content)

    def _resumed(self, state: BreakingState, steps: int) -> BreakingState:
        if self.path is None or not self.path.exists():
            return state
        try:
            content = read_arrays(self.path)
            self._check(content, steps)
            for name in _ARRAYS:
                array = getattr(state, name)
                wp.copy(array, wp.array(content[name], dtype=array.dtype, device="cpu"))
            state.dissipated, state.whole = content["dissipated"], content["whole"]
            state.time, state.steps = float(content["time"]), int(content["steps"])
            self.history = History(content["ledger"].tolist())
            for name, rows in content.items():
                if name.startswith("history_"):
                    _, kind, label = name.split("_", 2)
                    getattr(self.history, kind)[label] = rows.tolist()
            if self.series is not None and "files" in content:
                times = content["times"].tolist()
                self.series.times = dict(zip(content["files"].tolist(), times))
        except InputError:
            raise
        except (OSError, KeyError, ValueError, TypeError, AttributeError) as error:
            raise InputError(f"{self.path}: not a readable checkpoint ({error})") from None
        return state
