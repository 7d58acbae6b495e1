"""Fits of a sheet in a folder, each written as it ends, from which a second start goes on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.points.arrays import fingerprint
from warp_peri.points.samples import Samples
from warp_peri.tissue.displacement_search import DisplacementFit
from warp_peri.tissue.solid import HyperelasticSolid
from warp_peri.tissue.thickness import Thickness

RECORD = ".fit.json"
"""How the name of a fit's record ends; its material is beside it."""


class KeptFits:
    """Fits by name and by a hash of frames and settings, as a sweep keeps its own.

    Args:
        folder: for the files.
        frames: all of them.
        settings: what else a fit of a name depends on.
    """

    def __init__(self, folder: Path, frames: Samples, settings: object) -> None:
        self.folder, self.key = folder, fingerprint(settings, frames)[:12]

    def count(self) -> tuple[int, int]:
        """Fits of these frames and settings, and of others."""
        there = [path.name for path in self.folder.glob(f"*{RECORD}")]
        own = sum(name.endswith(f"_{self.key}{RECORD}") for name in there)
        return own, len(there) - own

    def fit(self, name: str, compute: Callable[[], DisplacementFit]) -> DisplacementFit:
        """What is kept under this name; where nothing can be read, compute it and write it."""
        stem = f"{name.replace(', ', '_').replace(' ', '_')}_{self.key}"
        record, model = (self.folder / f"{stem}{end}" for end in (RECORD, ".model.json"))
        found = _read(record, model)
        if found is None:
            found = compute()
            found.material.save(model)
            write_json(
                record,
                {
                    "errors": found.errors,
                    "history": found.history,
                    "frames_left_out": found.frames_left_out,
                    "thickness": None if found.thickness is None else vars(found.thickness),
                },
            )
        return found


def _read(record: Path, model: Path) -> DisplacementFit | None:
    try:
        content = json.loads(record.read_text(encoding="utf-8"))
        thickness = content["thickness"]
        errors = np.array(content["errors"], float)
        fit = DisplacementFit(HyperelasticSolid.load(model), **(content | {"errors": errors}))
        return replace(fit, thickness=thickness and Thickness(**thickness))
    except (OSError, ValueError, TypeError, KeyError, InputError):
        return None
