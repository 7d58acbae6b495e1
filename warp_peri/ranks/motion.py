"""Breaking bodies in motion on many ranks, with the bits of one process.

A rank steps its nodes and those of others that they feel: within δ for bonds, 2δ with a dilatation.
After each drift the displacement of others' nodes comes from their owners, while nodes that feel
none of them are swept. All bonds that its own nodes feel then break here as they do there, and
nothing else is sent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.contract import offered
from warp_peri.damage.lattice_body import LatticeBody, lattice_body
from warp_peri.damage.march import LEDGER, CrackRun, History, Section
from warp_peri.damage.motion import BreakingBody, BreakingState, Ledger
from warp_peri.damage.problems import Broken, Cracked, options_of_steps
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.kernels import neighbours
from warp_peri.kernels.damage.motion import halves
from warp_peri.kernels.damage.sweeps import sweeps
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.unit_names import check_same
from warp_peri.ranks.files import Series, as_text, read_arrays, read_text, write_arrays
from warp_peri.ranks.halo import NodeHalo
from warp_peri.ranks.processes import agreed, build
from warp_peri.ranks.sums import fingerprint, total

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece

NODAL = ("u", "v", "force", "energy", "work")
"""Arrays of a state that a checkpoint holds for each node."""
FORMAT = "warp_peri.ranks.checkpoint"


class RankedRun(CrackRun):
    """As CrackRun, of the nodes of this rank: records are of the whole body, on every rank.

    Args:
        body: the nodes of this rank and those of others that it feels.
        halo: which are whose.
        piece: the nodes of this rank.
        regions, sections, series: as of CrackRun; regions are masks of this rank's nodes.
        other: as of CrackRun; what is watched sees φ of all nodes.

    Raises InputError as CrackRun does.
    """

    def __init__(
        self,
        body: BreakingBody,
        halo: NodeHalo,
        piece: Piece,
        *,
        regions: Mapping[str, ArrayLike] | None = None,
        sections: Mapping[str, ArrayLike] | None = None,
        series: Any = None,
        **other: Any,
    ) -> None:
        super().__init__(body, **other)
        self.halo, self.piece = halo, piece
        self.series: Any = None if series is None else Series(series, piece)
        self.regions = {name: np.asarray(mask) for name, mask in (regions or {}).items()}
        self._section_of = {name: _cut(body, halo, line) for name, line in (sections or {}).items()}
        self._lines = [np.asarray(line, dtype=float) for line in (sections or {}).values()]
        self._size: dict[str, int] = {}
        for name, mask in self.regions.items():
            if mask.shape != (len(piece.x),) or mask.dtype != bool:
                raise InputError(
                    f"regions: expected bool of this rank's {len(piece.x)} nodes, got {name!r} of "
                    f"shape {list(mask.shape)}"
                )

    def check(self) -> None:
        """Raise InputError for regions and sections that no rank has a part of; all ranks ask."""
        comm = self.piece.comm
        for name, mask in self.regions.items():
            self._size[name] = comm.allreduce(int(np.count_nonzero(mask)))
            if not self._size[name]:
                raise InputError(f"regions: expected some nodes, got none in {name!r}")
        for name, section in self._section_of.items():
            if not comm.allreduce(int(section is not None)):
                raise InputError(f"section: expected a line that bonds cross, got {name!r}")

    def ledger(self, state: BreakingState) -> Ledger:
        """Energies of the whole body."""
        own, density = self.halo.own, self.body.solid.density
        v = self.body.velocity(state)[own]
        kinetic = density / 2 * np.square(v).sum(axis=1)
        parts = (state.work.numpy()[own], kinetic, state.energy.numpy()[own])
        sums = total(self.piece.comm, np.stack([*parts, state.dissipated[own]], axis=1))
        cell = self.body.body.spacing**self.body.body.dimension
        return Ledger(state.time, *(cell * sums).tolist())

    def _record(self, state: BreakingState) -> None:
        comm, own, body = self.piece.comm, self.halo.own, self.body
        ledger, history = self.ledger(state), self.history
        history.ledger.append([getattr(ledger, name) for name in LEDGER])
        u, v = body.displacement(state)[own], body.velocity(state)[own]
        for name, mask in self.regions.items():
            for field, where in ((u, history.u), (v, history.v)):
                mean = total(comm, field[mask]) / self._size[name]
                where.setdefault(name, []).append(mean.tolist())
        for name, section in self._section_of.items():
            shape = (0, self.piece.dimension)
            carried = np.zeros(shape) if section is None else section.carried(state)
            force = self.piece.spacing**self.piece.dimension * total(comm, carried)
            history.force.setdefault(name, []).append(force.tolist())
        if self.watch or self.series is not None:
            phi = body.damage(state)[own]
        if self.watch:
            everywhere = self.piece.gather(phi)
            for name, function in self.watch.items():
                seen = np.asarray(function(everywhere)).tolist()
                history.watched.setdefault(name, []).append(seen)
        if self.series is not None:
            fields = {"displacement": u, "velocity": v, "damage": phi}
            self.series.write(state.steps, state.time, fields)

    def _mark(self, *arrays: Any) -> str:
        """Of arrays on the nodes here, by this rank's own."""
        parts = [np.asarray(array)[self.halo.own] for array in arrays]
        return fingerprint(self.piece.comm, self.piece.number, *parts)

    def _start_mark(self, state: BreakingState) -> str:
        kept = (self.body.neighbour(state) >= 0).sum(axis=1)
        fields = (state.u, state.v, state.work)
        arrays = [*(field.numpy() for field in fields), state.dissipated, state.whole, kept]
        return self._mark(*arrays)

    def _record_marks(self) -> tuple[Any, ...]:
        lines = [line.tolist() for line in self._lines]
        masks = [mask.astype(float)[:, None] for mask in self.regions.values()]
        regions = fingerprint(self.piece.comm, self.piece.number, *masks)
        return self.every, list(self._section_of), [*self.regions, *self.watch], lines, regions

    def _save(self, path: Path, state: BreakingState) -> None:
        own, piece, history = self.halo.own, self.piece, self.history
        arrays = {name: getattr(state, name).numpy()[own] for name in NODAL}
        arrays |= {"dissipated": state.dissipated[own], "whole": state.whole[own]}
        arrays["kept"] = (self.body.neighbour(state)[own] >= 0).astype(np.uint8)
        content = {
            "key": self._key(),
            "ramp": self._applied(state.steps)[1].tolist(),
            "ledger": history.ledger,
            **{kind: getattr(history, kind) for kind in ("u", "v", "force", "watched")},
            "times": {} if self.series is None else self.series.times,
        }
        whole = {name: (values, piece.number, piece.count) for name, values in arrays.items()}
        numbers = {"format": FORMAT, "time": state.time, "steps": state.steps}
        whole["text"] = as_text(piece.comm, content)
        write_arrays(path, piece.comm, whole, numbers)

    def _resumed(self, state: BreakingState, steps: int) -> BreakingState:
        comm = self.piece.comm
        if self.path is None or not comm.bcast(self.path.exists()):
            return state
        names = [*NODAL, "dissipated", "whole", "kept"]
        place: dict[str, Any] = dict.fromkeys(names, self.halo.number)
        arrays, numbers = read_arrays(self.path, comm, place | {"text": None})
        content = read_text(arrays.pop("text"))
        taken_so_far = np.array(int(numbers["steps"]))
        kept = {"key": np.array(json.dumps(content["key"])), "steps": taken_so_far}
        self._check(kept | {"ramp": np.array(content["ramp"])}, steps)
        here = len(self.halo.number)
        for name in NODAL:
            field = getattr(state, name)
            field.numpy()[:here] = arrays[name]
        links = self.body.neighbour(state)
        broken = (arrays["kept"] == 0) & (links >= 0)
        links[broken] = -1 - links[broken]
        state.dissipated[:here], state.whole = arrays["dissipated"], arrays["whole"]
        state.time, state.steps = float(numbers["time"]), int(numbers["steps"])
        self.history = History(content["ledger"])
        for kind in ("u", "v", "force", "watched"):
            setattr(self.history, kind, content[kind])
        if self.series is not None:
            self.series.times = content["times"]
        return state


def _cut(body: BreakingBody, halo: NodeHalo, line: ArrayLike) -> Section | None:
    """The part of a section that this rank's nodes carry."""
    try:
        section = Section(body, line)
    except InputError:
        return None
    return section.of(halo.own)


def move(material: Any, problem: Any, options: dict[str, Any]) -> Motion:
    """Motion of a Cracked on ranks: see Cracked.moved; fields are those of this rank's nodes.
    Of an unbroken body: see ranks.waves.

    Raises InputError for anything but steps, and for bonds that break by energy.
    """
    piece, comm = problem.points, problem.points.comm
    if hasattr(problem, "b") and not isinstance(problem, Cracked):
        from warp_peri.ranks import waves

        return waves.move(material, problem, options)
    with agreed(comm):
        if not isinstance(problem, Cracked) or "step" not in options:
            raise InputError("move: expected a Dirichlet or Cracked, and step=…, steps=… on ranks")
        offered(material, "density", "move", "a BrittleSolid")
        if material.by_energy or problem.pressure is not None:
            raise InputError(
                "move: expected bonds that break by their stretch, and no pressure, on ranks"
            )
        check_same(material.units, piece.units)
        material.linear.check_dimension(piece)
        how, begin, records, run = options_of_steps(options)
    model = material.model
    build(comm, *_kernels(piece.dimension, material.tension_only))
    felt = model.horizon * (1 + HORIZON_TOLERANCE) * (1 if model.lam == model.mu else 2)
    halo = NodeHalo(piece, felt)
    given: dict[str, Any] = {"load": problem.b, "held": problem.held, "u": problem.u}
    given |= {name: how.pop(name, None) for name in ("no_fail", "grip")}
    given["v"] = begin.pop("v", None)
    with agreed(comm):
        for name, values in given.items():
            if values is not None and len(np.asarray(values)) != len(piece.x):
                raise InputError(f"{name}: expected {len(piece.x)} nodes of this rank")
    here: dict[str, Any] = {
        name: None if v is None else halo.around(v) for name, v in given.items()
    }
    with agreed(comm):
        body = lattice_body(halo.x, piece.spacing, model.horizon)
        _check_straight(body)
        at_start = {name: here.pop(name) for name in ("u", "v")}
        moving = BreakingBody(material, body, **here, **how)
        state = moving.start(**at_start, cracks=problem.cracks, **begin)
        marching = RankedRun(moving, halo, piece, **records)
    marching.check()
    moving.operator.sweep_early(halo.is_own)
    moving.exchange = lambda u: halo.start(u.numpy())
    state = marching.march(state, **run)
    own = halo.own
    return Motion(
        marching.history.column("time"),
        moving.displacement(state)[own],
        moving.velocity(state)[own],
        marching.history.by_name(),
        Broken(moving.damage(state)[own], moving, state),
    )


def _check_straight(body: LatticeBody) -> None:
    if not np.array_equal(body.axes, np.eye(body.dimension)):
        raise InputError("points: expected a lattice along the axes on ranks, got a turned one")


def _kernels(dimension: int, tension_only: bool) -> list[Any]:
    made, steps = sweeps(dimension, bool(tension_only)), halves(dimension)
    return [neighbours.lattice_neighbours, made.state_based, steps.kick_and_drift]
