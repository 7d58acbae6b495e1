"""Motions in steps and their records, also for ParaView, whatever the law."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray
from tqdm import tqdm

from warp_peri.errors import Arrays, InputError, Rows, Shown, StrPath, Values, agreed, warn
from warp_peri.files.atomic import meshio_of, write_text, write_vtu, written
from warp_peri.files.checkpoint import AllNodes, RunFile, fingerprint, gathered, held, same
from warp_peri.points import arguments
from warp_peri.points.arguments import Count, Natural, Options, check_mapping, plain, typed_methods

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@typed_methods
@dataclass(frozen=True, eq=False, repr=False)
class Motion(Shown):
    """A motion, or a load that rises slowly, as a solver returns it.

    Attributes:
        time: of the records (of slow loads their factor), shape [R].
        u: displacement at the end [length], shape [N, d].
        v: velocity at the end [length/time], shape [N, d]; None of what has none.
        history: what was written down at these times, by name, first dimension R.
        details: what only this material knows: the state at the end, the body.
        axis: what `time` is, in plots, with its unit where that is known.

    >>> start = wp.Dirichlet(points, None, u[0])
    >>> wp.simulate(model, start, density=2200.0, step=0.005, steps=4).time.shape
    (4,)
    """

    time: ndarray
    u: ndarray
    v: ndarray | None = None
    history: dict[str, ndarray] = field(default_factory=dict)
    details: Any = None
    axis: str = "time"

    def __getitem__(self, name: str) -> ndarray:
        """A history by its name; InputError lists those there are."""
        if name not in self.history:
            raise InputError(
                f"motion: expected one of {', '.join(self.history) or 'none'}, got {name!r}"
            )
        return self.history[name]

    @property
    def energy(self) -> ndarray:
        """Conserved energy of the motion, shape [R]."""
        return self["energy"]

    @property
    def drift(self) -> float:
        """Largest relative departure of the energy from its first value; InputError for a motion
        without, as that of a body that breaks, whose books are `missing`."""
        energy = self._recorded("energy")
        gone = np.abs(energy - energy[0]).max()
        return float(gone / np.abs(energy[0])) if gone else 0.0

    @property
    def missing(self) -> float:
        """Largest relative part of the work that the energy ledger does not account for."""
        work = self._recorded("work")
        missing = np.abs(work - self["kinetic"] - self["elastic"] - self["dissipated"])
        return float(missing.max() / np.abs(work).max()) if work.any() else 0.0

    def plot(self, name: str = "", *, ax: Axes | None = None) -> Axes:
        """Plot a history over time, or the load; the first one where none is named."""
        import matplotlib.pyplot as plt

        name = name or next(iter(self.history), "")
        values = self._recorded(name)
        ax = plt.figure(layout="constrained").add_subplot() if ax is None else ax
        ax.plot(self.time, values.reshape(len(values), -1))
        ax.set(xlabel=self.axis, ylabel=name)
        return ax

    def _recorded(self, name: str) -> ndarray:
        """A history; InputError where there are no records."""
        if not len(self.time):
            raise InputError("motion: expected a run of some steps, nothing has been recorded")
        return self[name]

    def rows(self) -> Rows:
        """Name and value of each line of the motion's summary table."""
        span = f"{self.time[0]:.4g} to {self.time[-1]:.4g}" if len(self.time) else "no time"
        names = ", ".join(self.history) or "none"
        return [("records", f"{len(self.time)}, {span}"), ("histories", names)]


PVD, END = '<VTKFile type="Collection"><Collection>', "</Collection></VTKFile>\n"
"""How `motion.pvd` begins and ends."""
RECORD = r'<DataSet .*file="(?=record_(\d+))(.*)"/>'
"""Line of a record, with its step and file."""
NAME = r"""[^<&"\0-\x1f\ud800-\udfff\ufffe\uffff]+"""
"""Of a field in XML, which nothing escapes."""


class TimeSeriesWriter:
    """Writer of a motion's records for ParaView, the same from any number of ranks: a file
    `record_<step>.vtu` of each, and `motion.pvd`, which names them with their times.

    Args:
        folder: for the files; made if it is not there.
        nodes: those of this process, as AllNodes, mpi.Subdomain or Points.
        x: their positions, shape [n, d], where the nodes have none themselves.
        resume: go on after records of one's own writer there, of the same nodes and fields.
    """

    def __init__(
        self, folder: StrPath, nodes: Any, x: ndarray | None = None, *, resume: bool = False
    ) -> None:
        meshio_of()
        arguments.check_flag("resume", resume)
        self.path, self.x = Path(folder, "motion.pvd"), nodes.x if x is None else x
        self.nodes = nodes if hasattr(nodes, "comm") else AllNodes(len(self.x))
        self.resume, self.dropped = resume, -1

    def claim(self, mark: Callable[[int], str], goes_on: bool = True) -> None:
        """Take the folder for a motion, of which `mark` tells what so many steps depend on;
        InputError where records of another are, or any unless it `goes_on`."""
        pvd = self.path
        text = "another's" * any(pvd.parent.glob("record_*.vtu"))
        text = self.nodes.comm.bcast(pvd.read_text(errors="replace") if pvd.is_file() else text)
        known = re.match(re.escape(PVD) + r"<!-- (\d{1,16}) (\w+) -->\n", text)
        self.last, self.kept = int(known[1]) if known else -1, _stamp(pvd)
        with agreed(self.nodes.comm):
            if text and not (known and goes_on and known[2] == mark(self.last)):
                raise InputError(
                    f"{pvd}: is there, or records by it, of another motion, program, run, nodes or "
                    "fields, or of more steps; name another folder, or resume=True for your own"
                )
        self.mark = mark

    def write(self, step: Natural, time: float, fields: Arrays) -> None:
        """Write one record of the motion, after which later ones are none; vectors in the plane get
        a third component. InputError, on all ranks, for other fields than [n] or [n, d] of the own
        nodes, or than other ranks', and for a full disk."""
        nodes, found = self.nodes, Values()
        with agreed(nodes.comm):
            given = {"step": step, "time": time, "fields": fields}
            step, time, fields = arguments.check_arguments(TimeSeriesWriter.write, given).values()
            for name, values in fields.items():
                if not re.fullmatch(NAME, name := str(name)):
                    raise InputError(f"fields: expected names that XML holds, got {name!r:.60}")
                found[name] = one = plain(name, values)
                arguments.check_shape(name, one, (len(self.x), *one.shape[1:2]))
        self.kinds = {name: one[:0] for name, one in found.items()}
        same(nodes.comm, step=step, time=time, fields=self.kinds)
        if not hasattr(self, "mark"):
            place = nodes.mark(self.x)
            self.claim(lambda _: fingerprint(place, self.kinds), self.resume)
        whole = gathered(nodes.comm, {"": self.x, **found}, nodes.number, nodes.count)
        head = f"{PVD}<!-- {step} {self.mark(step)} -->"
        with agreed(nodes.comm), written(self.path.parent):
            if nodes.comm.rank == 0:
                pvd, x, name = self.path, whole.pop(""), f"record_{step:08d}.vtu"
                if not pvd.exists():  # or a record of a job that is killed here is nobody's
                    write_text(pvd, f"{head}\n{END}")
                    self.kept = _stamp(pvd)
                elif self.kept != _stamp(pvd):
                    raise InputError(f"{pvd}: another writer writes here")
                write_vtu(pvd.parent / name, x, ("vertex", np.arange(len(x))[:, None]), whole)
                before = re.finditer(RECORD, pvd.read_text())
                lines = [
                    one[0] for one in before
                    if self.dropped != int(one[1]) < step and (pvd.parent / one[2]).exists()
                ]  # fmt: skip
                line = f'<DataSet timestep="{float(time)!r}" file="{name}"/>'
                write_text(pvd, "\n".join([head, *lines, line, END]))
                self.last, self.kept = step, _stamp(pvd)


def _stamp(path: Path) -> Any:
    """By which a file that another program writes again is known, or False of no file."""
    return path.exists() and path.stat().st_mtime_ns


class Recorder:
    """Loop over steps of a state that counts its `steps`: records, a checkpoint to go on from with
    the same bits, and files for ParaView. What a step is, a subclass says.

    Args:
        nodes: of this process, as AllNodes.
        x: positions of the own ones.
        every: steps from one record to the next.
        checkpoint: file to go on from; written every `checkpoint_every` records and at the end.
        series: folder for ParaView's files, one a record.

    Attributes:
        history: of each record by name.
    """

    kind = ""
    """Of checkpoints."""
    phase, ends, bent = 0, True, 0.0
    """Steps before the first record, whether the last step is recorded whatever its number, and the
    largest strain of the records."""
    advance: Callable[[Any], Any]
    """The next state."""
    record: Callable[[Any], tuple[float, Values, Values]]
    """Of a state its time, histories by name, and fields beside u and v for ParaView."""
    nodal: Callable[[Any], Arrays]
    """Arrays of a state on nodes by name, u and v among them."""
    restored: Callable[[Any, Arrays, int], Any]
    """A state with such arrays after so many steps."""
    key: Callable[[int], dict[str, str]]
    """Marks of what so many steps depend on, by name."""

    def __init__(
        self,
        nodes: Any,
        x: ndarray,
        *,
        every: Count = 1,
        checkpoint: StrPath | None = None,
        checkpoint_every: Count = 10,
        series: StrPath | None = None,
    ) -> None:
        self.every, self.often, self.nodes, self.start = every, checkpoint_every, nodes, ""
        self.history: dict[str, list[Any]] = {}
        self.file = None if checkpoint is None else RunFile(checkpoint, self.kind, nodes)
        of_body = getattr(nodes, "piece", nodes)
        self.series = None if series is None else TimeSeriesWriter(series, of_body, x)

    def march(self, state: Any, *, steps: Natural, progress: bool = False) -> Any:
        """March to `steps` steps in all, from the checkpoint if there is one, else from `state`;
        InputError for another motion's files, or another job's, or fewer steps than are done."""
        with held(self.nodes.comm, *(one.path for one in (self.file, self.series) if one)):
            return self._marched(state, steps, progress)

    def _marched(self, state: Any, steps: int, progress: bool) -> Any:
        """State after so many steps."""
        own = self.nodes.own
        if (self.file or self.series) and (not self.start or state.steps == 0):
            self.start = self.nodes.mark(*self.nodal(state).values(), state.steps)
        if self.series is not None:
            self.series.claim(lambda n: fingerprint(self.key(n), self.start) if n <= steps else "")
        if self.file is not None:
            state = self._resumed(self.file, state, steps)
        _check(state.steps, steps)
        with tqdm(total=steps, initial=state.steps, disable=not progress, unit="step") as bar:
            while state.steps < steps:
                state = self.advance(state)
                bar.update()
                last = state.steps == steps
                due = (state.steps - self.phase) % self.every == 0 or (last and self.ends)
                if due:
                    time, values, fields = self.record(state)
                    for name, value in values.items():
                        self.history.setdefault(name, []).append(value)
                    if self.series is not None:
                        nodal = self.nodal(state)
                        fields |= {"displacement": nodal["u"][own], "velocity": nodal["v"][own]}
                        self.series.write(state.steps, time, fields)
                if self.file and (last or (due and len(self.history["time"]) % self.often == 0)):
                    arrays = {name: one[own] for name, one in self.nodal(state).items()}
                    history = {name: np.array(rows).tolist() for name, rows in self.history.items()}
                    key = self.key(state.steps) | {"start": self.start}
                    content = {"history": history, "bent": self.bent}
                    self.file.write(arrays, {"steps": state.steps, "key": key} | content)
        return state

    def recorded(self) -> tuple[ndarray, Arrays]:
        """Times of the records, and the histories by name."""
        history = {name: np.array(rows) for name, rows in self.history.items()}
        return history.pop("time"), history

    def _resumed(self, file: RunFile, state: Any, steps: int) -> Any:
        """State to go on from, the checkpoint's where there is one."""
        if (kept := file.read(self.nodal(state))) is None:
            return state
        arrays, content = kept
        check_mapping(str(file.path), content)
        for name in ("key", "history"):
            check_mapping(f"{file.path}: {name}", content.get(name))
        taken = arguments.check_whole(f"{file.path}: steps", content.get("steps"), 0)
        rows = content["history"]
        counts = {plain(f"{file.path}: {name}", one).shape[:1] for name, one in rows.items()}
        if not {*self.history} <= {*rows} or len(counts) > 1 or () in counts:
            raise InputError(f"{file.path}: expected histories of as many records, by name")
        _check(taken, steps)
        key = self.key(taken) | {"start": self.start}
        if differ := [name for name, mark in key.items() if content["key"].get(name) != mark]:
            raise InputError(
                f"{file.path}: expected a checkpoint of this motion, got another's; what differs: "
                f"{', '.join(differ)}"
            )
        state = self.restored(state, arrays, taken)
        self.check_end(state, rows)
        if self.ends and taken < steps and (taken - self.phase) % self.every:  # it is no end now
            for one in rows.values():
                del one[-1:]
            if self.series is not None:
                self.series.dropped = taken
        last = taken if self.series is None else self.series.last
        if -1 < last < taken - (taken - self.phase) % self.every:
            warn(f"series: no records after step {last} until {taken}, when it was left out")
        self.history = rows
        self.bent = float(plain(f"{file.path}: bent", content.get("bent")))
        return state

    def check_end(self, state: Any, rows: Mapping[str, list[Any]]) -> None:
        """Raise InputError for histories, of a checkpoint, that its state does not end."""


def _check(taken: int, steps: int) -> None:
    """Raise InputError for more steps than are asked for, whose marks may be long in the making."""
    if taken > steps:
        raise InputError(
            f"steps: expected at least the {taken} taken before, got {steps}; a shorter run needs "
            "a state, or a checkpoint, of its own"
        )


def refuse_learning(problem: Any, options: Options, verb: str) -> None:
    """Raise InputError for tensors whose gradient a problem does not have."""
    if asks_for_gradient((vars(problem), options)) or "parameters" in options:
        raise InputError(
            f"{verb}: expected tensors without a gradient, which only {LEARNS[verb]} have; got a "
            f"{type(problem).__name__}"
        )


LEARNS = {
    "solve": "a Dirichlet, a Periodic and a Cracked of one process",
    "simulate": "waves, what flows, and pulls of bonds that soften, of one process",
}


def asks_for_gradient(given: Any) -> bool:
    """Whether values, mappings or sequences hold a tensor that asks for a gradient."""
    if isinstance(given, Mapping):
        given = [*given.values()]
    if isinstance(given, list | tuple):
        return any(map(asks_for_gradient, given))
    return arguments.is_tensor(given) and bool(given.requires_grad)
