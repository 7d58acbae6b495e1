"""One way to files and back, whatever they hold."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

from warp_peri.contract import offered
from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.models.lps import read_content
from warp_peri.points.dataset import Dataset
from warp_peri.points.dataset_file import load_dataset, save_dataset
from warp_peri.points.mesh import load_mesh
from warp_peri.points.unit_names import Units

READERS = {
    "warp_peri.model": ("models.nonlinear", "load_any"),
    "warp_peri.third_order_crystal": (
        "micromodulus.third_order",
        "load_third_order_crystal",
    ),
    "warp_peri.brittle_solid": ("damage.solid", "load_brittle_solid"),
    "warp_peri.soft_solid": ("damage.softening", "load_soft_solid"),
    "warp_peri.micromodulus": ("micromodulus.law", "load_crystal"),
    "warp_peri.dressed": ("dressed.law", "load_dressed"),
    "warp_peri.dressed_finite": ("dressed.finite", "load_finite"),
    "warp_peri.hyperelastic": ("tissue.solid", "load_hyperelastic"),
    "warp_peri.neural": ("neural.file", "load"),
    "warp_peri.conductor": ("diffusion.conductor", "load_conductor"),
    "warp_peri.coupled_solid": ("diffusion.coupled", "load_coupled_solid"),
    "warp_peri.flow_law": ("flow.law_file", "load_law"),
    "warp_peri.family": ("prediction.members", "load_members"),
}
"""Module and function that read a JSON file, by the `format` that it names."""
HDF5 = b"\x89HDF\r\n\x1a\n"


def load(path: str | os.PathLike[str], *, units: Units | None = None) -> Any:
    """Read a data set (HDF5), a material (JSON) or a mesh (whatever meshio reads).

    Args:
        path: of the file.
        units: names of the units of length and stress to convert to; by default those of the file.

    Raises InputError naming the file and what is wrong with it, and for units that no factor leads
    to, or of what has none.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            head = file.read(len(HDF5))
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(f"{path}: {reason}") from None
    if head == HDF5:
        return load_dataset(path, units=units)
    if path.suffix.lower() == ".json" or head.lstrip()[:1] == b"{":
        loaded = _material(path)
    else:
        loaded = load_mesh(path)
    if units is None:
        return loaded
    return offered(loaded, "in_units", "units", "a file with units of its own")(units)


def save(path: str | os.PathLike[str], given: Any) -> None:
    """Write a data set or a material, whole or not at all; `load` reads it again.

    Raises InputError for what no file is made of, OSError where the file cannot be written.
    """
    if isinstance(given, Dataset):
        return save_dataset(path, given)
    content = offered(given, "content", "save", "a data set or a material")
    if hasattr(given, "save"):  # some keep weights beside
        given.save(path)
    else:
        write_json(path, content())


def _material(path: Path) -> Any:
    content = read_content(path)
    kind = content.get("format") if isinstance(content, dict) else None
    if kind not in READERS:
        raise InputError(f"{path}: format: expected one of {', '.join(READERS)}, got {kind!r:.50}")
    module, function = READERS[kind]
    return getattr(import_module(f"warp_peri.{module}"), function)(path)
