"""Frames of digital image correlation (DIC): tables of many kinds, and samples on a lattice."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy import ndarray
from numpy.linalg import lstsq, norm, pinv
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from warp_peri.errors import InputError, StrPath, hold, warn
from warp_peri.files.atomic import content, encoding_of
from warp_peri.points.arguments import (
    LENGTHS,
    USUAL,
    NotNegative,
    Pair,
    Positive,
    check_shape,
    check_units,
    checked,
    plain,
    typed,
    within,
)
from warp_peri.points.points import PULL, SEEN, Points, Samples, grid_places

MOVES = ("§", "u*", "displacement*", "*displacement", "disp*", "d*",
         "disphorizontaldisplacement§", "dispverticaldisplacement§")  # fmt: skip
RANKS = (
    (("modelcoordinates*", "model*"), ("modeldisplacement*", "model§")),
    (("*undef", "*undeformed", "*ref", "*reference", "*0"), MOVES),
    (("*", "coordinate*", "*coordinate", "coor*"), MOVES),
    (("*def", "*deformed", "*cur", "*current"), MOVES),
)
"""Names of positions and displacements in small letters, * for x or y, § for u or v: first what
stereo systems say of the sheet, not of an image; last positions of the current frame."""
NEGATIVE = "sigma", "match", "corrcoef", "correlation", "zncc", "ncc"
ZERO = "converged", "valid", "isvalid"
"""Columns that are negative, or zero, where the correlation failed."""
UNITS: dict[str, tuple[str | None, float]] = {name: (name, 1.0) for name in LENGTHS}
UNITS |= {"å": ("angstrom", 1.0), "cm": ("mm", 10.0), "micron": ("um", 1.0)}
UNITS |= dict.fromkeys(("in", "inch", "inches"), ("mm", 25.4))
UNITS |= dict.fromkeys(("px", "pixel", "pixels"), (None, 1.0))
"""Unit of LENGTHS by what a table says, none for pixels, and how many of it that is."""
WORDS = dict.fromkeys(("", "-", "na", "n/a", "#n/a", "null", "none", "nv"), np.nan)
FLAGS = WORDS | {"true": 1.0, "false": 0.0}
BEFORE = 1000
"""Lines in which a header is looked for."""
NEAR, OFF, TIMES, DEEP = 12, 0.01, 6.0, 1.6
"""Points that a value which fills in is held against, and how far it is off: as part of how they
differ from it, and in times of what a plane leaves of them; spacings to the first of them."""


def read_table(text: str, size: float, unit: str | None) -> tuple[ndarray, ndarray, str | None]:
    """Reference positions and displacements [P, 2] from a table's text, and their unit of length.

    Rows with a missing number, failed correlation or a filler value for lost points are left out.
    Lengths in pixels, or without a unit, are multiplied by `size` and have `unit`.
    """
    lines = [line.strip("\ufeff\r\n") for line in text.splitlines()]
    headers = (split(re.sub(r"^[\s#%*/]+", "", line)) for line in lines[:BEFORE])
    found = ((n, header, columns_of(header)) for n, header in enumerate(headers))
    number, header, columns = next((one for one in found if one[2]), (0, [""], None))
    if columns is None:
        shown = next((line for line in lines if line.strip()), "nothing")
        raise InputError(f"expected columns x, y, u and v, got {shown[:80]!r}")
    fields, units, current = columns
    rows = [split(line) for line in lines[number + 1 :] if not re.match(r"\s*(#|%|\*{3}|$)", line)]
    if long := [row for row in rows if len(row) > len(header)]:
        raise InputError(f"expected {len(header)} fields, as in its header, got {long[0]}")
    rows = [row + [""] * (len(header) - len(row)) for row in rows]
    if rows and all(_unit(rows[0][n]) for n in fields):
        units, rows = [rows[0][n] for n in fields], rows[1:]
    names = [_named(field)[0] for field in header]
    below, nil = ([n for n, name in enumerate(names) if name in of] for of in (NEGATIVE, ZERO))
    asked = [*fields, *below, *nil]
    table = np.array(
        [[_number(row[n], WORDS if n in fields else FLAGS) for n in asked] for row in rows], float
    )
    table, errors, flags = np.split(table.reshape(-1, len(asked)), [4, 4 + len(below)], axis=1)
    good = np.isfinite(table).all(axis=1) & (errors >= 0).all(axis=1)
    good &= (np.nan_to_num(flags) != 0).all(axis=1)
    table = checked("x, y, u, v", table[good])
    table = table[np.sort(np.unique(table, axis=0, return_index=True)[1])]
    table = table[~filled_in(table[:, :2], table[:, 2:])] if len(table) else table
    if not len(table):
        raise InputError("expected points with finite numbers, got none")
    if len(np.unique(table[:, :2], axis=0)) < len(table):
        raise InputError("expected one displacement for each point, some have two")
    each, unit = _factors(units, size, unit)
    x, u = np.split(each * table, 2, axis=1)
    return x - u if current else x, u, unit


def split(line: str) -> list[str]:
    """Split a line into fields; beside semicolons or tabs a comma is a decimal point."""
    for separator in ";", "\t", ",":
        if separator in line:
            fields = line.rstrip().rstrip(separator).split(separator)
            if separator != ",":
                fields = [field.replace(",", ".") for field in fields]
            return [field.strip().strip('"') for field in fields]
    return re.split(r"\s+(?![\[(])", line.strip())


def columns_of(header: list[str]) -> tuple[list[int], list[str | None], bool] | None:
    """Find a header's columns of x, y, u, v, units, whether positions are current; else None."""
    names, units = zip(*map(_named, header))
    for rank, kinds in enumerate(RANKS):
        found = []
        for templates in kinds:
            for axis, letter in "xu", "yv":
                known = [t.replace("*", axis).replace("§", letter) for t in templates]
                places = [n for n, name in enumerate(names) if name in known]
                capital = [n for n in places if header[n][:1].isupper()]
                found.append(capital if len(capital) == 1 else places)  # VIC writes pixels small
        if all(found):
            if many := next((places for places in found if len(places) > 1), None):
                both = " and ".join(repr(header[n]) for n in many)
                raise InputError(f"expected one column of a kind, got {both}")
            return [n for (n,) in found], [units[n] for (n,) in found], rank == len(RANKS) - 1
    return None


def _named(header: str) -> tuple[str, str | None]:
    """Name of a column in lower case, and its unit, of "x", "x [mm]", "x_mm" or "xmm"."""
    if found := re.fullmatch(r"(.+?)\s*[\[(](.*)[\])]", header):
        return re.sub(r"[^a-z0-9]", "", found[1].lower()), found[2].strip() or None
    plain = re.sub(r"[^a-z0-9µμ]", "", header.lower())
    found = re.fullmatch(r"([xyuv]|[ud][xy])(mm|cm|[uµμn]m|inch|px|pixels?)", plain)
    return (found[1], found[2]) if found else (plain, None)


def _unit(word: str | None) -> tuple[str | None, float] | None:
    """The unit of LENGTHS that a word names, and its multiple; None for no unit."""
    return UNITS.get(re.sub("[µμ]", "u", (word or "").strip("[]()")).lower())


def _number(field: str, words: dict[str, float]) -> float:
    """Read a number or one of these words, NaN for an empty field; InputError for other text."""
    try:
        return words[field.lower()] if field.lower() in words else float(field)
    except ValueError:
        raise InputError(f"expected a number, got {field!r:.60}") from None


def _factors(units: list[Any], size: float, unit: str | None) -> tuple[ndarray, str | None]:
    """Factors that bring x, y, u and v to the unit of x, shape [4], and its name."""
    x, y, u, v = units
    words = [x, y or x, u or x, v or u or y or x]
    if unknown := [word for word in words if word and not _unit(word)]:
        raise InputError(f"expected units of {', '.join(UNITS)}, got {unknown[0]!r}")
    known = [_unit(word) or (None, 1.0) for word in words]
    if None not in {n for n, _ in known} and (size, unit) not in ((1.0, None), (1.0, known[0][0])):
        raise InputError(f"pixel: expected none for a table in {x}, got {size:g} {unit or ''}")
    known = [(name, one) if name else (unit, size) for name, one in known]
    if len({name is None for name, _ in known}) > 1:
        said = ", ".join(f"{axis} in {word or 'no unit'}" for axis, word in zip("xyuv", words))
        raise InputError(f"expected one unit, or the size of a pixel with one, got {said}")
    sizes = [LENGTHS.get(name or "", 1.0) for name, _ in known]
    return np.array([one * (at / sizes[0]) for (_, one), at in zip(known, sizes)]), known[0][0]


def filled_in(x: ndarray, u: ndarray) -> ndarray:
    """Mask of points whose displacement is a filler: 0, −1 or the most frequent value.

    A point is one where it leaves the plane of its neighbours; an isolated one needs both
    components, as it may be a part at rest.
    """
    counted = [np.unique(values, return_counts=True) for values in u.T]
    suspect = (u == 0) | (u == -1) | (u == [values[n.argmax()] for values, n in counted])
    some = suspect.any(axis=1)
    if not some.any() or np.count_nonzero(~some) < NEAR:
        return np.zeros(len(x), bool)
    distance, near = cKDTree(x[~some]).query(x[some], NEAR)
    place, moved = x[~some][near] - x[some, None], u[~some][near]
    place = place / np.abs(place).max(axis=(1, 2), keepdims=True, initial=1e-300)
    design = np.concatenate([np.ones_like(place[..., :1]), place], axis=2)
    plane = pinv(design) @ moved
    left = norm(moved - design @ plane, axis=2).max(axis=1)
    size = np.median(norm(moved - u[some, None], axis=2), axis=1)
    off = norm((plane[:, 0] - u[some]) * suspect[some], axis=1)
    told = (distance[:, 0] < DEEP * spacing_of(x)) | (u[some, 0] == u[some, 1])
    some[some] = told & (off > np.maximum(OFF * size, TIMES * left))
    return np.asarray(some)


LEAST = 4
"""Frames of a folder."""
TABLES = {".csv", ".txt"}
EXPORT = "write x, y, u and v of each frame to a table .csv, as the page on camera frames shows"
"""What frames of a folder are, and what to do with those of Ncorr (.mat) and muDIC."""
FIRST = 0.25
"""Frames of a folder before this part of a test are left: little moves there but errors."""
ON_LATTICE = 0.02
"""Points this near to lattice nodes, in spacings, are taken as those nodes."""
APART = 0.1
"""How far, in spacings, points of two frames may lie apart that are the same."""
REACH = 3
"""Horizon [spacings] of what is learned from frames."""
OFTEN = 0.5
"""Part of the frames that see a node of the sheet; the others may have lost it."""
OWN, FILLED, AROUND = 0.75, 2.5, 12
"""How near a node, in spacings, its own point is, and points that fill it in; so many do."""


@typed
@dataclass(frozen=True, eq=False)
class DICFrame:
    """One frame: reference positions and displacement [P, 2], its file's name and unit of length.
    The unit is None where it is unknown. Points without displacement are left out."""

    x: ndarray
    u: ndarray
    name: str
    length: str | None = None

    def __post_init__(self) -> None:
        x, u = checked("x", self.x, float, ("P", 2)), plain("u", self.u)
        check_shape("u", u, x.shape)
        seen = ~np.isnan(u).any(axis=1)
        hold(self, x=x[seen], u=checked("u", u[seen]))


@typed
def read_dic_frame(path: StrPath, *, pixel: float | str = 1.0) -> DICFrame:
    """Read one frame of image correlation from a table with a header.

    `pixel` is the length of a pixel, or of the table's unit where it names none. With a unit, as
    "0.012mm", or "mm" alone, the frame has that; else that of the names of columns. Points with
    missing numbers or failed correlation are left out; named current positions are taken back to
    the reference. Raises InputError for a table that is not clearly one.
    """
    data, (size, unit) = content(path), length_of(pixel)
    try:
        text = data.decode(encoding_of(data))
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    x, u, unit = within(f"{path}", read_table, text, size, unit)
    return DICFrame(x, u, Path(path).name, unit)


def length_of(pixel: float | str) -> tuple[float, str | None]:
    """Parse a length with its unit, as 0.012, "0.012mm", "0.5 um" or "mm"; the unit may be None."""
    found = re.fullmatch(r"([-+.\deE]*)\s*(.*)", text := str(pixel).strip())
    number, name = found.groups() if found and isinstance(pixel, str) else (text, "")
    unit = {"µm": "um", "μm": "um", "Å": "angstrom"}.get(name, name) or None
    with suppress(ValueError):
        size = float(number or 1.0)
        if 0 < size < np.inf and (unit is None or unit in LENGTHS) and text:
            return size, unit
    raise InputError(
        f"pixel: expected a length > 0, with a unit of {', '.join(LENGTHS)} or none, got {pixel!r}"
    )


@typed
def dic_to_lattice(
    frames: Sequence[DICFrame],
    *,
    spacing: Positive | None = None,
    radius: NotNegative = 0.0,
    positions: Literal["reference", "current"] | None = None,
) -> Samples:
    """Interpolate a sheet's frames to the lattice nodes that most have seen, with a 2δ collar.

    A node that a frame lost is filled in from its neighbours; fits to frames ignore it (SEEN).

    Args:
        spacing: of the lattice; by default that of the points.
        radius: of the smoothing local quadratic fits, in spacings; 0 keeps points that lie on nodes
            as they are, and takes 1.6 for others.
        positions: "reference" or "current"; None finds out, and warns of current ones.

    Samples have the frames' length unit and MPa; Å and TPa without one. Raises InputError for
    frames in several units, and where no node has its surroundings.
    """
    if not frames:
        raise InputError("frames: expected at least one, got none")
    frames = in_reference(frames, positions)
    lengths = {frame.length for frame in frames}
    if len(lengths) > 1:
        said = {frame.length: f"{frame.length or 'no unit'} in {frame.name}" for frame in frames}
        raise InputError(f"frames: expected one unit of length, got {', '.join(said.values())}")
    (length,) = lengths
    named = check_units(USUAL if length is None else (length, "MPa"))
    step = float(spacing or spacing_of(frames[0].x))
    every = np.concatenate([frame.x for frame in frames])
    counts = np.floor(np.ptp(every, axis=0) / step + 1 + ON_LATTICE)
    if counts.min() < (least := 4 * REACH + 1) or counts.max() > 10**7 / counts.min():
        got = f"{counts[0]:g} × {counts[1]:g}"
        raise InputError(f"frames: expected at least {least} nodes a side, got {got}")
    counts = counts.astype(int)
    x = every.min(axis=0) + step * grid_places(counts)
    each = [on_nodes(frame, x, step, radius) for frame in frames]
    fields, seen = np.stack([u for u, _ in each]), np.stack([there for _, there in each])
    there = np.isfinite(fields).all(axis=(0, 2)) & (seen.mean(axis=0) >= OFTEN)
    interior = surrounded(there.reshape(counts), REACH).ravel()[there]
    if not interior.any():
        count = seen.sum(axis=1)
        raise InputError(
            f"frames: expected nodes with all nodes within {2 * REACH} spacings around them, got "
            f"none; {frames[count.argmin()].name} has {count.min()} nodes of {len(x)}, "
            f"{frames[count.argmax()].name} has {count.max()}"
        )
    points, seen = Points(x[there], interior, step, units=named), seen[:, there]
    return Samples(points, fields[:, there], arrays={} if seen.all() else {SEEN: seen})


def surrounded(grid: ndarray, reach: int) -> ndarray:
    """Mask of the grid nodes whose surroundings to twice the reach are all there."""
    a, b = np.ogrid[-reach : reach + 1, -reach : reach + 1]
    ball = a**2 + b**2 <= reach**2
    return np.asarray(binary_erosion(binary_erosion(grid, ball), ball))


def frames_of_folder(
    folder: Path,
    count: int,
    *,
    pixel: float | str = 1.0,
    radius: float,
    positions: Any = None,
    stress: Sequence[float] = (),
    along: str = "x",
) -> Samples:
    """Samples on one lattice from `count` frames of a folder, ordered by their names and numbers.

    Frames are spread from a quarter of the test to its end; other files, as tables of forces, are
    skipped with a warning. `stress` is a PULL of the last frame or of every frame of the folder.
    """
    length_of(pixel)
    pulls = checked("stress", stress, float, ("n",))
    if count < LEAST:
        raise InputError(f"count: expected at least {LEAST} frames, got {count}")
    if not folder.is_dir():
        raise InputError(f"folder: expected one with frames, got {folder}")
    frames, others = [], []
    paths = [path for path in folder.glob("[!.]*") if path.suffix in TABLES]
    for path in sorted(paths, key=by_number):
        try:
            frames.append(read_dic_frame(path, pixel=pixel))
        except InputError as error:
            others.append(str(error))
    if len(frames) < LEAST:
        kinds = sorted({path.suffix for path in folder.iterdir()} - TABLES)
        why = others[0] if others else f"of {', '.join(kinds)} files none; {EXPORT}"
        raise InputError(f"{folder}: expected at least {LEAST} frames, got {len(frames)}; {why}")
    for why in others:
        warn(f"passed over: {why}")
    last = len(frames) - 1
    chosen = np.unique(np.linspace(FIRST * last, last, min(count, len(frames))).astype(int))
    samples = dic_to_lattice([frames[n] for n in chosen], radius=radius, positions=positions)
    if not len(pulls):
        return samples
    if len(pulls) not in (1, len(frames)) or not pulls.min() >= 0 < pulls[-1]:
        raise InputError(
            f"stress: expected one number > 0, or {len(frames)}, one for each frame, got {stress}"
        )
    pull = np.full((len(frames), 2), np.nan)
    pull[-len(pulls) :, "xy".index(along)] = pulls
    return replace(samples, arrays=samples.arrays | {PULL: pull[chosen]})


def in_reference(frames: Sequence[DICFrame], positions: str | None) -> list[DICFrame]:
    """Frames with reference positions, `positions` as of `dic_to_lattice`."""
    back = [replace(frame, x=frame.x - frame.u) for frame in frames]
    if positions is None:
        given, taken = (_apart([frame.x for frame in some]) for some in (frames, back))
        if len(frames) > 1 and min(given, taken) > APART:
            raise InputError(
                "frames: expected the same points in all, in the reference or each where it is; "
                'positions="reference" or "current" says which'
            )
        if 2 * taken < given and taken < (APART if len(frames) > 1 else ON_LATTICE):
            warn("frames: positions are those of the current frame; displacements are taken off")
            positions = "current"
    return back if positions == "current" else list(frames)


def _apart(sets: list[ndarray]) -> float:
    """Largest distance [spacings] of positions from the first set's, or of one set to a lattice."""
    step = spacing_of(sets[0])
    if len(sets) == 1:
        parts = (sets[0] - sets[0].min(axis=0)) / step
        return float(np.median(np.abs(parts - np.rint(parts)).max(axis=1)))
    tree = cKDTree(sets[0])
    return float(max(np.median(tree.query(x)[0]) for x in sets[1:])) / step


def by_number(path: Path) -> list[tuple[int, str]]:
    """Sort key that puts frame10 behind frame9."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if n % 2 else (-1, part) for n, part in enumerate(parts)]


def spacing_of(x: ndarray) -> float:
    """Median distance of points to their nearest neighbour."""
    if len(x) < 2:
        raise InputError("frames: expected points on a lattice, got fewer than two")
    distance, _ = cKDTree(x).query(x, 2)
    step = float(np.median(distance[:, 1]))
    if not step > 0:
        raise InputError("frames: expected each point once, most lie where others do")
    return step


def on_nodes(frame: DICFrame, x: ndarray, step: float, radius: float) -> Pair:
    """Displacement on nodes, [N, 2], NaN where points are too few; and the mask of nodes seen."""
    tree = cKDTree(frame.x)
    distance, nearest = tree.query(x)
    fitted = np.full(x.shape, np.nan)
    seen = distance <= ON_LATTICE * step
    points = radius <= 0 and seen.sum() >= 0.5 * len(frame.x)
    if points:
        fitted[seen] = frame.u[nearest[seen]]
    radius = radius or 1.6
    for n in np.flatnonzero(np.isnan(fitted[:, 0]) & (distance <= FILLED * step)):
        around = tree.query_ball_point(x[n], radius * step * (1 + 1e-9))
        value = surface(frame, around, x[n], step, radius) if len(around) >= 8 else None
        if not points:
            seen[n] = value is not None or distance[n] <= OWN * step
        if value is None and len(frame.x) >= AROUND:
            far, more = tree.query(x[n], AROUND)
            value = surface(frame, more, x[n], step, max(radius, far.max() / step))
        if value is not None:
            fitted[n] = value
    return fitted, seen & np.isfinite(fitted[:, 0])


def surface(
    frame: DICFrame, members: Sequence[int], x: ndarray, step: float, radius: float
) -> ndarray | None:
    """Displacement at a position by a quadratic fit to points; None where they are too few."""
    p, q = local = (frame.x[members] - x).T / step
    weight = np.exp(-(local**2).sum(axis=0) / radius**2)
    design = np.stack([np.ones_like(p), p, q, p * p, p * q, q * q], axis=1) * weight[:, None]
    u, _, rank, _ = lstsq(design, frame.u[members] * weight[:, None], rcond=1e-7)
    return u[0] if rank == 6 else None


@typed
def estimate_noise(samples: Samples) -> ndarray:
    """Standard deviation of the displacement noise of every frame [length], shape [S]. From fourth
    differences, 70 times the variance: subsets that overlap make the estimate too small. Raises
    InputError for points off a lattice."""
    steps, d = samples.lattice.steps, samples.dimension
    grid = np.full((len(samples), *(steps.max(axis=0) + 1), d), np.nan)
    grid[:, *steps.T] = samples.u
    fourth = ([np.diff(one, 4, axis=axis).ravel() for axis in range(d)] for one in grid)
    return np.array([np.nanmedian(np.abs(np.concatenate(d))) / 0.6745 / 70**0.5 for d in fourth])
