"""Tables of image correlation: what a column means, in which unit, and which rows are no data."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.points.unit_names import LENGTHS
from warp_peri.sources.dump_files import encoding_of

MATCHID = ("disphorizontaldisplacement§", "dispverticaldisplacement§")
MOVES = ("§", "u*", "displacement*", "*displacement", "disp*", "d*", *MATCHID)
RANKS = (
    (("modelcoordinates*",), ("modeldisplacement*",)),
    (("*undef", "*undeformed", "*ref", "*reference", "*0"), MOVES),
    (("*", "coordinate*", "*coordinate", "coor*"), MOVES),
    (("*def", "*deformed", "*cur", "*current"), MOVES),
)
"""Names of positions and displacements in small letters, * for x or y, § for u or v: first what
stereo systems say of the sheet, not of an image; last positions of the current frame."""
NEGATIVE = ("sigma", "match", "corrcoef", "correlation", "zncc", "ncc")
ZERO = ("converged", "valid", "isvalid")
"""Columns that are negative, or zero, where the correlation failed."""
UNITS: dict[str, tuple[str | None, float]] = {name: (name, 1.0) for name in LENGTHS}
UNITS |= {"å": ("angstrom", 1.0), "cm": ("mm", 10.0), "micron": ("um", 1.0)}
UNITS |= dict.fromkeys(("in", "inch", "inches"), ("mm", 25.4))
UNITS |= dict.fromkeys(("px", "pixel", "pixels"), (None, 1.0))
"""Unit of LENGTHS by what a table says, none for pixels, and how many of it that is."""
WORDS = {"true": 1.0, "false": 0.0}
WORDS |= dict.fromkeys(("", "-", "na", "n/a", "#n/a", "null", "none", "nv"), np.nan)
LARGEST_FILE = 2**28
BEFORE = 1000
"""Lines in which a header is looked for."""
NEAR, OFF, TIMES = 12, 0.01, 6.0
"""Points that a value which fills in is held against, and how far it is off: as part of how they
differ from it, and in times of what a plane leaves of them."""


def read_table(
    path: Path, size: float, unit: str | None
) -> tuple[np.ndarray, np.ndarray, str | None]:
    """Positions in the reference and displacements, shape [P, 2], and their unit of length.

    Rows are left out where a number is missing or the correlation failed: by a column that says so,
    or by a number in both components that fills in for lost points.

    Args:
        path: of a table whose header names its columns.
        size, unit: of a pixel, and of what is in no unit.

    Raises InputError for what is no such table, and where it contradicts itself.
    """
    lines = [line.strip("\ufeff\r\n") for line in _text(path).splitlines()]
    headers = [split(re.sub(r"^[\s#%*/]+", "", line)) for line in lines[:BEFORE]]
    found = ((n, columns_of(path, header)) for n, header in enumerate(headers))
    number, columns = next(((n, columns) for n, columns in found if columns), (0, None))
    if columns is None:
        shown = next((line for line in lines if line.strip()), "nothing")
        raise InputError(f"{path}: expected columns x, y, u and v, got {shown[:80]!r}")
    header, (fields, units, current) = headers[number], columns
    rows = [split(line) for line in lines[number + 1 :] if not re.match(r"\s*(#|%|\*{3}|$)", line)]
    if long := [row for row in rows if len(row) > len(header)]:
        raise InputError(f"{path}: expected {len(header)} fields, as in its header, got {long[0]}")
    rows = [row + [""] * (len(header) - len(row)) for row in rows]
    if rows and all(_unit(rows[0][n]) for n in fields):
        units, rows = [rows[0][n] for n in fields], rows[1:]
    names = [_named(field)[0] for field in header]
    below, nil = ([n for n, name in enumerate(names) if name in of] for of in (NEGATIVE, ZERO))
    asked = [*fields, *below, *nil]
    table = np.array([[_number(path, row[n]) for n in asked] for row in rows], float)
    table = table.reshape(-1, len(asked))
    ends = 4 + len(below)
    good = np.isfinite(table[:, :4]).all(axis=1) & (table[:, 4:ends] >= 0).all(axis=1)
    table = table[good & (np.nan_to_num(table[:, ends:]) != 0).all(axis=1), :4]
    table = table[np.sort(np.unique(table, axis=0, return_index=True)[1])]
    table = table[~filled_in(table[:, :2], table[:, 2:])]
    if not len(table):
        raise InputError(f"{path}: expected points with finite numbers, got none")
    if len(np.unique(table[:, :2], axis=0)) < len(table):
        raise InputError(f"{path}: expected one displacement for each point, some have two")
    each, unit = _factors(path, units, size, unit)
    x, u = each[:2] * table[:, :2], each[2:] * table[:, 2:]
    return x - u if current else x, u, unit


def _text(path: Path) -> str:
    """A file's text: UTF-16 or UTF-8, else Latin-1."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path}: expected at most {LARGEST_FILE} bytes")
        data = path.read_bytes()
        return data.decode(encoding_of(data))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        return data.decode("latin-1")


def split(line: str) -> list[str]:
    """Fields of a line; a decimal comma is not one beside semicolons or tabs."""
    for separator in (";", "\t", ","):
        if separator in line:
            fields = line.rstrip().rstrip(separator).split(separator)
            if separator != ",":
                fields = [field.replace(",", ".") for field in fields]
            return [field.strip().strip('"') for field in fields]
    return re.split(r"\s+(?![\[(])", line.strip())


def columns_of(path: Path, header: list[str]) -> tuple[list[int], list[str | None], bool] | None:
    """Places of x, y, u and v, their units, and whether x and y are of the current frame.

    None where one is missing; InputError where two say the same.
    """
    names, units = zip(*map(_named, header))
    for rank, kinds in enumerate(RANKS):
        found = []
        for templates in kinds:
            for axis, letter in ("xu", "yv"):
                known = [t.replace("*", axis).replace("§", letter) for t in templates]
                places = [n for n, name in enumerate(names) if name in known]
                capital = [n for n in places if header[n][:1].isupper()]
                found.append(capital if len(capital) == 1 else places)  # VIC writes pixels small
        if all(found):
            if many := next((places for places in found if len(places) > 1), None):
                both = " and ".join(repr(header[n]) for n in many)
                raise InputError(f"{path}: expected one column of a kind, got {both}")
            return [n for (n,) in found], [units[n] for (n,) in found], rank == len(RANKS) - 1
    return None


def _named(header: str) -> tuple[str, str | None]:
    """Name of a column in small letters, and its unit, of "x", "x [mm]", "x_mm" or "xmm"."""
    if found := re.fullmatch(r"(.+?)\s*[\[(](.*)[\])]", header):
        return re.sub(r"[^a-z0-9]", "", found[1].lower()), found[2].strip() or None
    plain = re.sub(r"[^a-z0-9µμ]", "", header.lower())
    found = re.fullmatch(r"([xyuv]|[ud][xy])(mm|cm|[uµμn]m|inch|px|pixels?)", plain)
    return (found[1], found[2]) if found else (plain, None)


def _unit(word: str | None) -> tuple[str | None, float] | None:
    """The unit of LENGTHS that a word says, and how many of it; None for no unit."""
    return UNITS.get(re.sub("[µμ]", "u", (word or "").strip("[]()")).lower())


def _number(path: Path, field: str) -> float:
    """A number, NaN for none; InputError for other text."""
    try:
        return float(field)
    except ValueError:
        if field.lower() in WORDS:
            return WORDS[field.lower()]
    raise InputError(f"{path}: expected a number, got {field!r:.60}")


def _factors(
    path: Path, units: list[Any], size: float, unit: str | None
) -> tuple[np.ndarray, str | None]:
    """What x, y, u and v are multiplied by to be in the unit of x, shape [4], and its name.

    What says no unit is in that of x, displacements in that of their position.
    """
    x, y, u, v = units
    words = [x, y or x, u or x, v or y or x]
    if unknown := [word for word in words if word and not _unit(word)]:
        raise InputError(f"{path}: expected units of {', '.join(UNITS)}, got {unknown[0]!r}")
    known = [_unit(word) or (None, 1.0) for word in words]
    if None not in {n for n, _ in known} and (size, unit) not in ((1.0, None), (1.0, known[0][0])):
        raise InputError(f"pixel: {path} is in {x}, expected that alone, got {size:g} {unit or ''}")
    known = [(name, one) if name else (unit, size) for name, one in known]
    if len({name is None for name, _ in known}) > 1:
        said = ", ".join(f"{axis} in {word or 'no unit'}" for axis, word in zip("xyuv", words))
        raise InputError(f"{path}: expected one unit, or the size of a pixel with one, got {said}")
    sizes = [LENGTHS.get(name or "", 1.0) for name, _ in known]
    return np.array([one * (at / sizes[0]) for (_, one), at in zip(known, sizes)]), known[0][0]


def filled_in(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Points whose displacement is one number in both components, and not that of those around.

    So programs fill in for points that they lost: 0, 0 or −1, −1. A plane through the nearest other
    points tells what a point that is there shows.
    """
    same = u[:, 0] == u[:, 1]
    values, counts = np.unique(u[same, 0], return_counts=True)
    suspect = same & np.isin(u[:, 0], [0.0, -1.0, *values[counts == counts.max(initial=0)]])
    if not suspect.any() or np.count_nonzero(~suspect) < NEAR:
        return np.zeros(len(x), bool)
    near = cKDTree(x[~suspect]).query(x[suspect], NEAR)[1]
    place, moved = x[~suspect][near] - x[suspect, None], u[~suspect][near] - u[suspect, None]
    place = place / np.abs(place).max(axis=(1, 2), keepdims=True)
    design = np.concatenate([np.ones_like(place[..., :1]), place], axis=2)
    plane = np.linalg.pinv(design) @ moved
    left = np.linalg.norm(moved - design @ plane, axis=2).max(axis=1)
    size = np.median(np.linalg.norm(moved, axis=2), axis=1)
    suspect[suspect] = np.linalg.norm(plane[:, 0], axis=1) > np.maximum(OFF * size, TIMES * left)
    return np.asarray(suspect)
