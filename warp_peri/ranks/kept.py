"""The last displacement of a solve in a file, from where any number of ranks goes on."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import RunFile

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece


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
        self.file = RunFile(path, "warp_peri.rest", piece)
        self._mark = piece.mark(np.where(inside, b, 0.0), np.where(inside, 0.0, u), inside)

    def start(self) -> np.ndarray | None:
        """The displacement [n, d] that was kept; None before one was.

        Raises InputError for a file of another problem, or none that can be read.
        """
        if (kept := self.file.read("u")) is None:
            return None
        if kept[1]["mark"] != self._mark:
            raise InputError(f"{self.file.path}: expected a checkpoint of this problem")
        return kept[0]["u"]

    def keep(self, u: np.ndarray) -> None:
        """Write u [n, d], whole or not at all; all ranks come here."""
        self.file.write({"u": u}, {"mark": self._mark})
