"""Frames of digital image correlation: tables of many programs, onto one lattice.

A frame is a table of points with positions in the reference and displacements. Its columns are
recognised by their header: a plain x, y, u, v; DICe's solution files; ARAMIS' nodemap.txt; tables
with units in brackets. Separators are commas, semicolons, tabs or blanks.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import LENGTHS, USUAL, Units, check_units

NAMES = {
    "x": ("x", "coordinatex", "xcoordinate", "xundef", "coorx", "xpixel", "xmm"),
    "y": ("y", "coordinatey", "ycoordinate", "yundef", "coory", "ypixel", "ymm"),
    "u": ("u", "ux", "displacementx", "xdisplacement", "dispx", "dx"),
    "v": ("v", "uy", "displacementy", "ydisplacement", "dispy", "dy"),
}
"""Names of the columns, in small letters and without units or signs."""
NODEMAP = {"x": 1, "y": 2, "u": 4, "v": 5}
"""Columns of a nodemap.txt, whose header is a comment: number, x, y, z, ux, uy, uz and strains."""
LARGEST_FILE = 2**28
LEAST = 4
"""Frames of a folder."""
FIRST = 0.25
"""Frames of a folder before this part of a test are left: little moves there but errors."""
ON_LATTICE = 0.02
"""Points this near to lattice nodes, in spacings, are taken as those nodes."""
FOURTH = 70**0.5
"""Standard deviation of a fourth difference of independent noise of one."""


@dataclass(frozen=True, eq=False)
class SheetFrame:
    """One frame.

    Attributes:
        x: positions in the reference, shape [P, 2].
        u: displacement, shape [P, 2]; points without one are left out.
        name: of the file.
        length: name of the unit of length; None where nobody said it.
    """

    x: np.ndarray
    u: np.ndarray
    name: str
    length: str | None = None


def read_frame(path: str | os.PathLike[str], *, pixel: float | str = 1.0) -> SheetFrame:
    """Read one frame.

    Args:
        path: a table with a header.
        pixel: length of the table's unit; positions and displacements are multiplied by it. With
            its unit, as "0.012mm", or "mm" alone, the frame carries that; without one, the unit in
            brackets behind a column's name.

    Points are left out where a number is missing or not finite, or where DICe's SIGMA is negative
    (the correlation failed). Raises InputError for a table without the columns, or without points,
    and a pixel that is no length > 0.
    """
    size, unit = length_of(pixel)
    path = Path(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path}: expected at most {LARGEST_FILE} bytes")
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    body = [line for line in lines if line.strip() and not line.startswith(("#", "***"))]
    if not body:
        raise InputError(f"{path}: expected a table of points, got none")
    columns = columns_of(split(body[0]))
    if unit is None and columns and size == 1.0:
        unit = unit_in(split(body[0])[columns["x"]])
    if columns:
        body = body[1:]
    elif any(line.startswith("#") for line in lines) and len(split(body[0])) >= 6:
        columns = NODEMAP
    else:
        raise InputError(f"{path}: expected columns x, y, u and v, got {body[0][:80]!r}")
    table = np.array([numbers(split(line), columns) for line in body], float).reshape(-1, 5)
    good = np.isfinite(table[:, :4]).all(axis=1) & ~(table[:, 4] < 0)
    if not good.any():
        raise InputError(f"{path}: expected points with finite numbers, got none")
    return SheetFrame(size * table[good, :2], size * table[good, 2:4], path.name, unit)


def length_of(pixel: float | str) -> tuple[float, str | None]:
    """A length and the name of its unit, as of 0.012, "0.012mm", "0.5 um" or "mm"."""
    found = re.fullmatch(r"([-+.\deE]*)\s*(.*)", str(pixel))
    number, name = found.groups() if found and isinstance(pixel, str) else (str(pixel), "")
    unit = {"µm": "um", "Å": "angstrom"}.get(name, name) or None
    try:
        size = float(number or 1.0)
    except ValueError:
        size = np.nan
    if not 0 < size < np.inf or (unit is not None and unit not in LENGTHS):
        raise InputError(
            f"pixel: expected a length > 0, with a unit of {', '.join(LENGTHS)} or none, got "
            f"{pixel!r}"
        )
    return size, unit


def unit_in(header: str) -> str | None:
    """The unit of length in the brackets of a column's name, if it is known."""
    found = re.search(r"[\[(]\s*(\w+)\s*[\])]", header)
    unit = found[1].replace("µ", "u") if found else None
    return unit if unit in LENGTHS else None


def split(line: str) -> list[str]:
    """Fields of a line; a decimal comma is not one beside semicolons or tabs."""
    for separator in (";", "\t", ","):
        if separator in line:
            fields = line.rstrip().rstrip(separator).split(separator)
            if separator != ",":
                fields = [field.replace(",", ".") for field in fields]
            return [field.strip().strip('"') for field in fields]
    return line.split()


def columns_of(header: Sequence[str]) -> dict[str, int]:
    """Places of x, y, u, v, and of sigma where there is one; empty where one is missing."""
    plain = [re.sub(r"[^a-z]", "", re.sub(r"\[.*?\]|\(.*?\)", "", h.lower())) for h in header]
    places_of = {}
    for name, known in NAMES.items():
        places = [n for n, field in enumerate(plain) if field in known]
        if not places:
            return {}
        places_of[name] = places[0]
    if "sigma" in plain:
        places_of["sigma"] = plain.index("sigma")
    return places_of


def numbers(fields: Sequence[str], columns: dict[str, int]) -> list[float]:
    """x, y, u, v and sigma of a line; NaN for what is missing, 0 for a sigma that no one gave."""
    values = []
    for name in ("x", "y", "u", "v"):
        try:
            values.append(float(fields[columns[name]]))
        except (IndexError, ValueError):
            values.append(np.nan)
    sigma = columns.get("sigma")
    try:
        values.append(0.0 if sigma is None else float(fields[sigma]))
    except (IndexError, ValueError):
        values.append(-1.0)
    return values


def frames_on_lattice(
    frames: Sequence[SheetFrame],
    *,
    spacing: float | None = None,
    radius: float = 0.0,
    reach: int = 3,
    mask: np.ndarray | None = None,
    units: Units | str | None = None,
) -> Samples:
    """All frames on the nodes that every frame has, with the collar that a model needs.

    Args:
        frames: with positions in one reference.
        spacing: of the lattice; that of the points where none is given.
        radius: of the local quadratic fits that smooth, in spacings; 0 keeps points that lie on
            nodes as they are, and takes 1.6 for others.
        reach: horizon in spacings; nodes whose surroundings to twice that are there are interior.
        mask: polygon, shape [M, 2], whose inside alone is used.
        units: of the samples' lengths and of the stresses to be learned; by default the length
            that the frames carry, with MPa, and Å and TPa where they carry none.

    Raises InputError for frames in several units, or other ones than asked, and where points are
    too few or no node has its surroundings.
    """
    if not frames:
        raise InputError("frames: expected at least one, got none")
    first, lengths = frames[0].x, {frame.length for frame in frames}
    if len(lengths) > 1:
        said = {frame.length: f"{frame.length or 'no unit'} in {frame.name}" for frame in frames}
        raise InputError(f"frames: expected one unit of length, got {', '.join(said.values())}")
    if not radius >= 0:
        raise InputError(f"radius: expected spacings ≥ 0, got {radius}")
    (length,) = lengths
    named = check_units(units or (USUAL if length is None else (length, "MPa")))
    if length not in (None, named[0]):
        raise InputError(f"units: the frames are in {length}, expected that, got {named[0]}")
    step = spacing_of(first) if spacing is None else float(spacing)
    origin = first.min(axis=0)
    counts = np.floor((np.ptp(first, axis=0)) / step + 1 + ON_LATTICE).astype(int)
    if counts.min() < 4 * reach + 1 or counts.prod() > 10**7:
        raise InputError(
            f"frames: expected at least {4 * reach + 1} nodes a side, got {counts[0]} × {counts[1]}"
        )
    nodes = np.argwhere(np.ones(counts, bool))
    x = origin + step * nodes
    fields = np.stack([on_nodes(frame, x, step, radius) for frame in frames])
    there = np.isfinite(fields).all(axis=(0, 2))
    if mask is not None:
        from matplotlib.path import Path as Polygon

        there &= Polygon(np.asarray(mask, float)).contains_points(x, radius=1e-9 * step)
    grid = there.reshape(counts)
    a, b = np.ogrid[-reach : reach + 1, -reach : reach + 1]
    ball = a**2 + b**2 <= reach**2
    interior = binary_erosion(binary_erosion(grid, ball), ball).ravel()[there]
    if not interior.any():
        seen = np.isfinite(fields).all(axis=2).sum(axis=1)
        raise InputError(
            f"frames: expected nodes with all nodes within {2 * reach} spacings around them in "
            f"every frame, got none; {frames[seen.argmin()].name} has {seen.min()} nodes of "
            f"{len(x)}, {frames[seen.argmax()].name} has {seen.max()}"
        )
    points = Points(x[there], interior, step, units=named)
    return Samples(points, fields[:, there])


def frames_of_folder(
    folder: Path, count: int, *, pixel: float | str = 1.0, radius: float
) -> Samples:
    """So many frames of a folder, in the order of their names and numbers, on one lattice.

    They are spread from a quarter of the test to its end. Files that are no frames are passed over
    with a warning: tables of forces lie beside frames.

    Args:
        folder: with files for `read_frame`.
        count: of frames.
        pixel: as for `read_frame`.
        radius: as for `frames_on_lattice`.

    Raises InputError for what is no folder, or has fewer than four frames; for a pixel, a count or
    a radius of no sense.
    """
    length_of(pixel)
    if count < LEAST:
        raise InputError(f"count: expected at least {LEAST} frames, got {count}")
    if not folder.is_dir():
        raise InputError(f"folder: expected one with frames, got {folder}")
    frames, others = [], []
    paths = [path for path in folder.glob("[!.]*") if path.suffix in (".csv", ".txt")]
    for path in sorted(paths, key=by_number):
        try:
            frames.append(read_frame(path, pixel=pixel))
        except InputError as error:
            others.append(str(error))
    if len(frames) < LEAST:
        why = f"; {others[0]}" if others else ""
        raise InputError(f"{folder}: expected at least {LEAST} frames, got {len(frames)}{why}")
    for why in others:
        warnings.warn(f"passed over: {why}", stacklevel=2)
    last = len(frames) - 1
    chosen = np.unique(np.linspace(FIRST * last, last, count).astype(int))
    return frames_on_lattice([frames[n] for n in chosen], radius=radius)


def by_number(path: Path) -> list[tuple[int, str]]:
    """To sort names by, so that frame10 comes behind frame9."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if n % 2 else (-1, part) for n, part in enumerate(parts)]


def spacing_of(x: np.ndarray) -> float:
    """Median distance to the nearest other point."""
    if len(x) < 2:
        raise InputError("frames: expected points on a lattice, got fewer than two")
    distance, _ = cKDTree(x).query(x, 2)
    return float(np.median(distance[:, 1]))


def on_nodes(frame: SheetFrame, x: np.ndarray, step: float, radius: float) -> np.ndarray:
    """Displacement on nodes, NaN where there are too few points, shape [N, 2]."""
    tree = cKDTree(frame.x)
    distance, nearest = tree.query(x)
    fitted = np.full(x.shape, np.nan)
    near = distance <= ON_LATTICE * step
    if radius <= 0:
        fitted[near] = frame.u[nearest[near]]
        if near.sum() >= 0.5 * len(frame.x):
            return fitted
        radius = 1.6
    for n, members in enumerate(tree.query_ball_point(x, radius * step * (1 + 1e-9))):
        if len(members) < 8:
            continue
        local = (frame.x[members] - x[n]) / step
        weight = np.exp(-(local**2).sum(axis=1) / radius**2)
        p, q = local.T
        design = np.stack([np.ones_like(p), p, q, p * p, p * q, q * q], axis=1)
        scaled = design * weight[:, None]
        if np.linalg.matrix_rank(scaled, tol=1e-6) == 6:
            surface, *_ = np.linalg.lstsq(scaled, frame.u[members] * weight[:, None], rcond=None)
            fitted[n] = surface[0]
    return fitted


def noise_of(samples: Samples) -> np.ndarray:
    """Standard deviation of the noise of every frame, from fourth differences, shape [S].

    In units of the displacement. It takes the noise of neighbours as independent; subsets that
    overlap make it less, and the estimate too small.
    """
    steps = np.rint((samples.x - samples.x.min(axis=0)) / samples.spacing).astype(int)
    grid = np.full((len(samples), *(steps.max(axis=0) + 1), 2), np.nan)
    grid[:, steps[:, 0], steps[:, 1]] = samples.u
    fourth = [np.diff(grid, 4, axis=axis).reshape(len(samples), -1) for axis in (1, 2)]
    both = np.abs(np.concatenate(fourth, axis=1))
    deviation: np.ndarray = np.nanmedian(both, axis=1) / 0.6745 / FOURTH
    return deviation
