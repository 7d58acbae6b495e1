"""The verbs fit, load and save; solve and simulate stand with the problems that they take."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import warp_peri.fitting as fitting
from warp_peri.core.record import load as load_record
from warp_peri.errors import InputError, StrPath, heard, quietly, warn
from warp_peri.files.atomic import check_regular, write_json
from warp_peri.fitting.result import LOUD, Fit
from warp_peri.points.arguments import Units, offered, typed
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset, sets_of
from warp_peri.points.mesh_files import load_mesh
from warp_peri.points.points import Samples
from warp_peri.protocols import options_of

if TYPE_CHECKING:
    from warp_peri.materials.crystal_fit import Crystal
    from warp_peri.materials.lps_fit import LPS
    from warp_peri.materials.third_order import ThirdOrder

Sets = Samples | Dataset | Sequence[Samples]


@overload
def fit(samples: Sets, law: LPS | Crystal | ThirdOrder, **options: Any) -> Fit: ...
@overload
def fit(samples: Any, law: Any, **options: Any) -> Any: ...
def fit(samples: Any, law: Any = None, **options: Any) -> Any:
    """Learn a material from samples.

    Args:
        samples: one set or several; of a Dataset `train`, or its only set.
        law: what may be learned, and how: LPS(horizon, …), ThirdOrder(Crystal(…)),
            hyperelastic.Hyperelastic(…).
        options: of its `learn`; all take `progress`, linear solids `noise`: fields of noise
            alone on the nodes of each training set.

    Returns a fit with `material`, and with `certificate` and `history` where the model has them.
    Warns where data ask for another kind of solid, and for which. Raises InputError for input that
    cannot be used, RuntimeError where a search fails.

    >>> round(wp.fit(samples, wp.LPS(12.5, wp.Bernstein(3))).material.mu, 3)
    0.7
    """
    learned = offered(
        law, "learn", "fit", "a model: LPS(…), ThirdOrder(…), hyperelastic.Hyperelastic(…)"
    )
    options = options_of(learned, "fit", options)
    with heard():  # what its parts say alike is said once
        found = learned(samples, **options)
        if isinstance(found, Fit) and found.left > LOUD:
            for each, noise in zip_longest(sets_of(samples), sets_of(options.get("noise"))):
                with suppress(InputError):  # in space, scattered, too few
                    with quietly():  # said by the fit
                        told = fitting.diagnose.diagnose(found.material, each, noise).advice
                    if told:
                        warn(told)
    return found


HDF5 = b"\x89HDF\r\n\x1a\n"


@typed
def load(path: StrPath, *, units: Units | None = None) -> Any:
    """Read a data set (HDF5), a material (JSON) or a mesh (as `points.mesh_files.load_mesh`).

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
def save(path: StrPath, given: Any) -> None:
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
