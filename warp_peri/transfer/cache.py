"""The model for a set of points: its own, kept from before, or transferred."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Any

from warp_peri.errors import InputError
from warp_peri.materials.certificate import with_proof
from warp_peri.materials.lps import Model
from warp_peri.points.arrays import is_number
from warp_peri.points.families import AT_EDGES, carried_horizon
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import check_same, symbols
from warp_peri.transfer import LEAST, RECIPE

FOLDER = ".lattices"
"""A folder of this ending beside a model file holds its transfers; they are model files too."""

_memory: dict[tuple[str, str], Model] = {}
_said: set[tuple[str, str]] = set()


def on_lattice(
    model: Model,
    *,
    spacing: float,
    horizon: float | None = None,
    tolerance: float | None = None,
    shortest_wave: float | None = None,
    largest_horizon: float | None = None,
) -> Model:
    """The same material on another square lattice, certified there (theory, M2–M5).

    As new_lattice, which says what the arguments are and what is raised; the second call finds the
    result in a folder beside the model's file, or in the user's cache where that cannot be
    written. The model's own file never changes.
    """
    asked = {
        "horizon": horizon,
        "tolerance": tolerance,
        "shortest_wave": shortest_wave,
        "largest_horizon": largest_horizon,
    }
    for word, value in {"spacing": spacing, **asked}.items():
        if not (is_number(value) or (value is None and word != "spacing")):
            raise InputError(f"{word}: expected a number > 0, got {value!r}")
    if not isinstance(model, Model):
        raise InputError(
            f"on_lattice: expected a linear peridynamic solid, got {type(model).__name__}; "
            "micromodulus.transferred(law, spacing) carries a crystal"
        )
    home = model.content()["sha256"]
    named = {"spacing": spacing, **asked}
    name = "_".join(f"{key}_{value:.9g}" for key, value in named.items() if value is not None)
    if (home, name) in _memory:
        return _memory[home, name]
    places = _places(model, home, name)
    transferred = next((kept for path in places if (kept := _read(path, home))), None)
    if transferred is None:
        from warp_peri.transfer.lattice import new_lattice  # loads torch, 185 MB a rank

        transferred = new_lattice(model, spacing=spacing, **asked)
        _write(transferred, places)
    _memory[home, name] = transferred
    return transferred


def forget() -> None:
    """Drop what is kept in memory, so that the next call reads the files."""
    _memory.clear()


def model_at(
    model: Model,
    spacing: float,
    *,
    largest_horizon: float | None = None,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> Model:
    """The model for a lattice of some spacing [Å]: itself where it is certified, or transferred.

    Args:
        model: certified on some lattice; one certified on none is proven on this, or refused.
        spacing: h [Å]; 0 for scattered points, which have no transfer.
        largest_horizon: what the points carry [Å].
        transfer: False refuses other spacings.
        allow_uncertified: the model's own numbers, with a warning.

    Raises InputError where the model is certified on no lattice, and nothing is proven of it here.
    """
    if spacing and transfer and not (model.certified_on or allow_uncertified):
        model = _proven(model, spacing)
    at_home = spacing == 0 or model.is_certified_on(spacing)
    if at_home or allow_uncertified or not transfer or not model.certified_on:
        model.check_spacing(spacing, allow_uncertified=allow_uncertified)
        return model
    transferred = on_lattice(model, spacing=spacing)
    if largest_horizon is not None and transferred.horizon > largest_horizon * (1 + 1e-9):
        transferred = on_lattice(model, spacing=spacing, largest_horizon=largest_horizon)
    record = transferred.provenance["transfer"]
    once = record["home"], record["statement"]
    if once not in _said:
        _said.add(once)
        warnings.warn(f"transferred {record['statement']}", stacklevel=4)
    return transferred


def _proven(model: Model, spacing: float) -> Model:
    """The model with a proof on this lattice, looked for once; as it is where there is none."""
    key = model.content()["sha256"], f"proof_{spacing:.9g}"
    if key not in _memory:
        try:
            _memory[key] = with_proof(model, spacing)
        except InputError:  # nothing holds of it here: whoever asks says what that means
            _memory[key] = model
    return _memory[key]


def _places(model: Model, home: str, name: str) -> list[Path]:
    """Where a transfer may lie, the best place first; none for a model without a file."""
    if model.file is None:
        return []
    if sys.platform == "win32":
        cache = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    else:
        cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    file = f"{name}.json"
    beside = model.file.with_name(model.file.stem + FOLDER)
    return [beside / file, Path(cache) / "warp_peri" / home[:32] / file]


def _read(path: Path, home: str) -> Model | None:
    """A transfer that was made of this very model, by this recipe."""
    try:
        kept = Model.load(path)
    except InputError:  # not there, or damaged: it is made again
        return None
    record: Any = kept.provenance.get("transfer")
    mine = isinstance(record, dict) and record.get("home") == home
    return kept if mine and record.get("recipe") == RECIPE else None


def _write(model: Model, places: list[Path]) -> None:
    for path in places:
        try:
            model.save(path)
        except (OSError, InputError):  # cannot be written, a full disk: the next place, or none
            continue
        return


def model_for(
    model: Model, points: PointsLike, *, transfer: bool = True, allow_uncertified: bool = False
) -> Model:
    """As model_at, for the spacing of the points and the horizon that their collar carries.

    Raises InputError also where the points are in other units than the model.
    """
    check_same(model.units, nodes_of(points).units)
    carried = None
    if points.spacing > 0 and not model.is_certified_on(points.spacing):
        carried = carried_horizon(points)
        if transfer and not allow_uncertified and model.certified_on:
            _refuse_edges(points, carried)
    return model_at(
        model,
        points.spacing,
        largest_horizon=carried,
        transfer=transfer,
        allow_uncertified=allow_uncertified,
    )


def _refuse_edges(points: PointsLike, carried: float) -> None:
    """Raise InputError where the collar carries no horizon that a transfer could have."""
    least = LEAST * points.spacing
    if carried < least * (1 - 1e-6):
        unit = symbols(nodes_of(points).units)[0]
        raise InputError(
            f"points: interior nodes lie {2 * carried:.3g} {unit} from an edge, where nodes end; a "
            f"lattice of spacing {points.spacing:g} {unit} needs {2 * least:g} {unit}, twice its "
            f"smallest horizon. {AT_EDGES}"
        )
