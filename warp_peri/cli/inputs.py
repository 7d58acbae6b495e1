"""What commands take besides data and model files: forces on atoms, nodes, influence functions."""

from __future__ import annotations

import argparse
import dataclasses
import io
from pathlib import Path
from typing import Any

import numpy as np

import warp_peri
from warp_peri.contract import offered
from warp_peri.errors import InputError
from warp_peri.files.atomic import read_arrays
from warp_peri.files.foreign import content
from warp_peri.points.arrays import checked
from warp_peri.points.dataset import Dataset, load_dataset
from warp_peri.points.points import Points


def atom_forces(path: Path, atoms: int) -> np.ndarray:
    """External forces on the atoms [eV/Å], shape [A, 2]: f_x, f_y in the order of the atoms' ids.

    From the one array of an .npz file (numpy.savez), or from text with commas.

    Raises InputError for a file that cannot be read or of another shape.
    """
    try:
        if path.suffix == ".npz":
            (force,) = read_arrays(path).values()
        else:
            force = np.loadtxt(io.BytesIO(content(path)), delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: expected one array in .npz (numpy.savez, not compressed), or a .csv file "
            f"({error})"
        ) from None
    if np.shape(force) != (atoms, 2):
        raise InputError(
            f"{path}: expected shape [{atoms}, 2], got {list(np.shape(force))}; the columns are "
            "f_x, f_y [eV/Å] alone, the rows in the order of the atoms' ids"
        )
    return checked(f"{path}: force", force)


def node_lattice(spacing: float, reach: float, interior: float, *, round_body: bool) -> Points:
    """Nodes of a square lattice within `reach` of its middle [Å], by radius for a round body.

    Raises InputError for lengths that leave no collar.
    """
    if not 0 < spacing <= interior < reach:
        raise InputError(
            "spacing, interior, reach: expected 0 < spacing ≤ interior < reach, got "
            f"{spacing:g}, {interior:g}, {reach:g} Å"
        )
    count = int(reach / spacing + 1e-9)
    line = spacing * np.arange(-count, count + 1)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    size = np.linalg.norm(x, axis=1) if round_body else np.abs(x).max(axis=1)
    kept = size <= reach * (1 + 1e-9)
    return Points(x=x[kept], interior=size[kept] <= interior * (1 + 1e-9), spacing=spacing)


def shape_of(
    name: str, horizon: float, spacing: float, unit: str
) -> warp_peri.shapes.InfluenceFunction:
    """The influence function of a name, or of a table in a .csv file for a lattice, in a unit."""
    if not name.endswith(".csv"):
        return warp_peri.shapes.named(name, horizon)
    from warp_peri.points.families import bond_classes

    text = content(name)
    try:
        r, K = influence_table(text.decode())
        shape = warp_peri.shapes.table(r, K)
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    longest = bond_classes(spacing, horizon).r[-1] if spacing else horizon
    if not r[-1] >= longest * (1 - 1e-6):
        raise InputError(
            f"{name}: expected K out to the longest bond, {longest:g} {unit}, got it to "
            f"{r[-1]:g} {unit}"
        )
    return shape


def influence_table(text: str) -> tuple[np.ndarray, np.ndarray]:
    """r and K of a text: two columns, or those of these names under a line of names.

    Raises InputError for any other.
    """
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    columns, first = [0, 1], lines[0].split(",") if lines else []
    names = [(word.split() or [""])[0] for word in first]
    if "r" in names and "K" in names:
        columns, lines = [names.index("r"), names.index("K")], lines[1:]
    elif len(first) != 2:
        raise InputError(f"expected two columns r, K with a comma, or their names, got {first}")
    r, K = np.loadtxt(lines, delimiter=",", usecols=columns, ndmin=2, unpack=True)
    return r, K


def data_for(given: argparse.Namespace, model: Any) -> Dataset:
    """The data in the units of a model, with the axis of its crystal where one was typed."""
    offered(model, "on", given.command, "a material that is placed on nodes")
    data = load_dataset(given.data, units=model.units)
    if given.axis is None:
        return data
    turned = {}
    for name, samples in data.sets.items():
        points = dataclasses.replace(samples.points, axis=given.axis)
        turned[name] = dataclasses.replace(samples, points=points)
    return dataclasses.replace(data, sets=turned)
