"""The last displacement of a solve in a file, from where any number of ranks goes on."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_peri.errors import InputError
from warp_peri.ranks.files import read_arrays, write_arrays
from warp_peri.ranks.processes import agreed
from warp_peri.ranks.sums import fingerprint

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece

FORMAT = "warp_peri.ranks.solve"


class Kept:
    """A checkpoint of a body at rest.

    Args:
        path: of the file; it need not be there yet.
        piece: the nodes of this rank.
        b, u: what is given of the problem, shape [n, d]; a file of another one is refused.
    """

    def __init__(
        self, path: str | os.PathLike[str], piece: Piece, b: np.ndarray, u: np.ndarray
    ) -> None:
        inside = piece.interior[:, None]
        given = np.where(inside, b, 0.0), np.where(inside, 0.0, u), inside
        self.path, self.piece = Path(path), piece
        self._mark = fingerprint(piece.comm, piece.number, *given)

    def start(self) -> np.ndarray | None:
        """The displacement [n, d] that was kept; None before one was.

        Raises InputError for a file of another problem, or none that can be read.
        """
        comm, number = self.piece.comm, self.piece.number
        if not comm.bcast(self.path.exists()):
            return None
        found, attributes = read_arrays(self.path, comm, {"u": number})
        with agreed(comm):
            if attributes.get("format") != FORMAT or attributes.get("mark") != self._mark:
                raise InputError(f"{self.path}: expected a checkpoint of this problem")
        return found["u"]

    def keep(self, u: np.ndarray) -> None:
        """Write u [n, d], whole or not at all; all ranks come here."""
        piece = self.piece
        arrays = {"u": (u, piece.number, piece.count)}
        write_arrays(self.path, piece.comm, arrays, {"format": FORMAT, "mark": self._mark})
