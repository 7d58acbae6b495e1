"""Waves in an unbroken solid on many ranks: the steps of dynamics.verlet, with forces by tiles.

The force has the same bits on any number of ranks (theory.md, R1), and so has the motion; energies
are sums that do not depend on them (R3).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.contract import MATERIAL, offered, taken
from warp_peri.dynamics.motion import Motion
from warp_peri.dynamics.verlet import Inert, State, check_step, checked, marched
from warp_peri.errors import InputError
from warp_peri.launch import shared_by
from warp_peri.points.arrays import check_whole
from warp_peri.ranks.files import Series, as_text, read_arrays, read_text, write_arrays
from warp_peri.ranks.processes import agreed
from warp_peri.ranks.sums import fingerprint

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece

FORMAT = "warp_peri.ranks.waves"


def move(material: Any, problem: Any, options: dict[str, Any]) -> Motion:
    """Motion of a Dirichlet problem on ranks; fields are those of this rank's nodes.

    `options` are those of dynamics.verlet.march, and of Kept.

    Raises InputError as that does, and for a law that has no proven step.
    """
    piece, comm = problem.points, problem.points.comm
    with agreed(comm):
        if piece.spacing == 0 or piece.tiles is None:
            raise InputError("points: expected a lattice in tiles for waves on ranks")
        offered(material, "on", "move", MATERIAL)
        steps, files = taken(options, "move", _of_steps, KeptMotion.__init__)
        given = {"u": problem.u, "v": steps.pop("v", None), "b": problem.b}
        dt, density = steps["step"], steps.pop("density")
        steps.setdefault("every", 1)
        start = checked(piece, given, **steps)
        with shared_by(comm):
            check_step(material, piece.spacing, density, dt, allow_uncertified=False)
    operator = piece.operator(material)
    free = piece.interior

    count = comm.allreduce(int(np.count_nonzero(free)))
    body = Inert(operator, free, density, start["b"][free], dot=piece.dot, count=count)
    state = body.state(start["u"], start["v"][free])
    kept = KeptMotion(piece, dt, steps["every"], **files)
    return marched(body, state, dt, steps["steps"], steps["every"], kept)


def _of_steps(
    *, v: ArrayLike | None = None, density: float, step: float, steps: int, every: int = 1
) -> None:
    """Options of the steps, as dynamics.verlet.march has them."""


class KeptMotion:
    """Files of a motion: a checkpoint, and records for ParaView.

    Args:
        piece: the nodes of this rank.
        step, every: Δt, and steps from one record to the next.
        checkpoint: file to go on from, with any number of ranks; written every `checkpoint_every`
            records and at the end.
        series: folder for a file of each record.

    Raises InputError for a count that is not > 0.
    """

    def __init__(
        self,
        piece: Piece,
        step: float,
        every: int,
        *,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: int = 10,
        series: str | os.PathLike[str] | None = None,
    ) -> None:
        check_whole("checkpoint_every", checkpoint_every, 1)
        self.piece, self.step, self.often = piece, step, int(checkpoint_every)
        self.every = int(every)
        self.path = None if checkpoint is None else Path(checkpoint)
        self.series = None if series is None else Series(series, piece)
        self._mark = ""

    def _whole(self, v: np.ndarray) -> np.ndarray:
        """A field of interior nodes on all of this rank's."""
        field = np.zeros(self.piece.x.shape)
        field[self.piece.interior] = v
        return field

    def begun(self, body: Inert, state: State, steps: int) -> tuple[State, int, list[float]]:
        """The state to go on from, the steps behind it, and the energies so far.

        Raises InputError for the checkpoint of another motion, and one that is further.
        """
        if self.path is None:
            return state, 0, []
        comm, number = self.piece.comm, self.piece.number
        ahead = state.u + self.step * self._whole(state.v)  # feels the law, wherever it begins
        fields = state.u, self._whole(state.v), self._whole(body.operator(ahead) - body.load)
        mark = fingerprint(comm, number, *fields, self.piece.interior)
        self._mark = f"{mark} {self.step!r} {body.inertia!r} {self.every}"
        if not comm.bcast(self.path.exists()):
            return state, 0, []
        names = {"u": number, "v": number, "text": None}
        arrays, attributes = read_arrays(self.path, comm, names)
        with agreed(comm):
            if attributes.get("format") != FORMAT or attributes.get("mark") != self._mark:
                raise InputError(f"{self.path}: expected a checkpoint of this motion")
            done = int(attributes["steps"])
            if done > steps:
                raise InputError(
                    f"{self.path}: expected at least the {done} steps of the checkpoint, got "
                    f"{steps}; name another file for a shorter run"
                )
        content = read_text(arrays["text"])
        if self.series is not None:
            self.series.times = content["times"]
        v = arrays["v"][self.piece.interior]
        return body.state(arrays["u"], v), done, content["energy"]

    def reached(self, done: int, state: State, energy: list[float], *, recorded: bool) -> None:
        """After so many steps: a record, or the end."""
        piece = self.piece
        if self.series is not None and recorded:
            fields = {"displacement": state.u, "velocity": self._whole(state.v)}
            self.series.write(done, done * self.step, fields)
        if self.path is not None and (not recorded or len(energy) % self.often == 0):
            times = {} if self.series is None else self.series.times
            nodal = {"u": state.u, "v": self._whole(state.v)}
            whole = {name: (field, piece.number, piece.count) for name, field in nodal.items()}
            whole["text"] = as_text(piece.comm, {"energy": energy, "times": times})
            numbers = {"format": FORMAT, "mark": self._mark, "steps": done}
            write_arrays(self.path, piece.comm, whole, numbers)
