"""One way to files and back, whatever they hold."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from warp_peri.core.record import load as load_record
from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.files.foreign import check_regular
from warp_peri.points.arguments import typed
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.mesh import load_mesh
from warp_peri.points.unit_names import Units
from warp_peri.protocols import offered

HDF5 = b"\x89HDF\r\n\x1a\n"


@typed
def load(path: str | os.PathLike[str], *, units: Units | None = None) -> Any:
    """Read a data set (HDF5), a material (JSON) or a mesh (as `points.mesh.load_mesh`).

    Args:
        path: of the file.
        units: names of the units of length and stress to convert to; by default those of the file.

    Raises InputError naming the file and what is wrong with it, and for units that no factor leads
    to, or of what has none.

    >>> wp.save("model.json", model)
    >>> wp.load("model.json", units=("nm", "GPa")).mu
    700.0
    """
    path = Path(path)
    check_regular(path)
    try:
        with open(path, "rb") as file:
            head = file.read(len(HDF5))
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(f"{path}: {reason}") from None
    if head == HDF5 and path.suffix.lower() not in (".med", ".h5m"):  # meshes, of Salome and MOAB
        return load_dataset(path, units=units)
    if path.suffix.lower() == ".json" or head.lstrip()[:1] == b"{":
        loaded = load_record(path)
    else:
        loaded = load_mesh(path)
    if units is None:
        return loaded
    return offered(loaded, "in_units", "units", "a file with units of its own")(units)


@typed
def save(path: str | os.PathLike[str], given: Any) -> None:
    """Write a data set or a material, whole or not at all; `load` reads it again.

    Args:
        path: of the file; .h5 for a data set, .json for a material.
        given: a Dataset, or a material.

    Raises InputError for what no file is made of, OSError where the file cannot be written.

    >>> wp.save("data.h5", wp.Dataset({"train": samples}, thickness=3.35, density=2200.0))
    """
    if isinstance(given, Dataset):
        return save_dataset(path, given)
    content = offered(given, "content", "save", "a data set or a material")
    if hasattr(given, "save"):  # some keep weights beside
        given.save(path)
    else:
        write_json(path, content())
