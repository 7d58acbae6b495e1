"""A file from which stage 2 goes on where it was."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.archive import read_arrays
from warp_peri.files.atomic import whole_file


@dataclass(frozen=True)
class Progress:
    """What stage 2 needs to go on: its tensors, the losses so far, penalty and iteration."""

    tensors: list[np.ndarray]
    losses: list[float]
    penalty: float
    iteration: int


class Checkpoint:
    """The state of one run in an .npz file, written whole or not at all.

    Args:
        path: of the file.
        key: says what the run depends on; a file of another run is refused.
    """

    def __init__(self, path: str | os.PathLike[str], key: str) -> None:
        self.path, self.key = Path(path), key

    def save(
        self, tensors: Sequence[np.ndarray], *, losses: list[float], penalty: float, iteration: int
    ) -> None:
        """Write the state to the checkpoint's file, whole."""
        content: dict[str, Any] = {"key": np.array(self.key), "losses": np.array(losses)}
        content |= {"penalty": penalty, "iteration": iteration}
        content |= {f"tensor{number}": value for number, value in enumerate(tensors)}
        with whole_file(self.path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **content)

    def load(self) -> Progress | None:
        """The state, or None when there is no file.

        Raises InputError for a file that cannot be read or belongs to another run.
        """
        if not self.path.exists():
            return None
        try:
            content = read_arrays(self.path)
            key = str(content["key"])
            state = Progress(
                [content[f"tensor{number}"] for number in range(len(content) - 4)],
                content["losses"].tolist(),
                float(content["penalty"]),
                int(content["iteration"]),
            )
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise InputError(f"{self.path}: not a readable checkpoint ({error})") from None
        if key != self.key:
            raise InputError(f"{self.path}: the checkpoint of a run on other data or settings")
        return state
