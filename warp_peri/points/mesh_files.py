"""Meshes of bodies from files: Gmsh, VTK, XDMF, and one flat part of Abaqus."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
from numpy import ndarray
from numpy.linalg import det

from warp_peri.errors import Arrays, InputError, StrPath, warn
from warp_peri.files.atomic import check_hdf5, check_xml, content, meshio_of
from warp_peri.points.arguments import check_nodes
from warp_peri.points.mesh import REST, Mesh, facets_of, make_mesh

CORNERS = {"triangle": 3, "triangle6": 3, "tetra": 4, "tetra10": 4}
CORNERS |= dict.fromkeys(("quad", "quad8", "quad9"), 4)
"""Of cells, by meshio's names; they come first."""
FORMATS = {".msh": "gmsh", ".vtk": "vtk", ".vtu": "vtu", ".xdmf": "xdmf", ".inp": "abaqus"}
"""Meshes that are read, by how their files' names end."""
GROUPS = (":physical", ":ref", "cell_tags")
"""How data of cells end that are numbers of groups, in files that meshio made of others too."""


def load_mesh(path: StrPath) -> Mesh:
    """Read a mesh of Gmsh (.msh), VTK (.vtk, .vtu), XDMF or Abaqus (.inp, one flat part), in Å.

    Tetrahedra, of second order too, of which the corners count; or triangles and quadrilaterals
    (cut in two), straight or of second order, whose edges' midpoints are kept on the outline. Parts
    are the lines' physical names, sets or numbers of groups, of a surface those of its triangles,
    and Abaqus's sets of nodes; what is named inside the body is left out with a warning. Raises
    InputError for another format, a file that is not read, without meshio (the extra `bodies`),
    with cells of other kinds or none, for triangles that are not plane, for what `read_abaqus` does
    not read, and as `make_mesh`.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    form = FORMATS.get(path.suffix.lower())
    if form is None:
        raise InputError(
            f"{path}: expected a mesh in {', '.join(FORMATS)}; convert it with meshio, then check "
            "the groups"
        )
    try:
        if form == "abaqus":
            return _body_of(read_abaqus(content(path).decode("utf-8", "replace")))
        if form in ("vtu", "xdmf"):
            _check_arrays(path)
        if form == "gmsh":  # meshio makes an array of as many as the largest number, in text
            nodes = path.read_bytes().partition(b"$Nodes")[2].partition(b"$End")[0].splitlines()
            first = [row[0] for row in map(bytes.split, nodes) if len(row) not in (0, 3)]
            check_nodes("$Nodes", [max(map(int, filter(bytes.isdigit, first)), default=0)])
        if form == "vtk" and b"UNSTRUCTURED_GRID" not in content(path).upper():
            raise InputError("expected an UNSTRUCTURED_GRID, got none")
        return _body_of(meshio_of("bodies").read(path, file_format=form))
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except (Exception, SystemExit) as error:  # meshio leaves the program on some files
        raise InputError(f"{path}: not a mesh of {form} ({error})") from None


def _check_arrays(path: Path) -> None:
    """Raise InputError for XML with entities, and XDMF arrays not in HDF5 beside it."""
    check_xml(path, text := content(path))
    if path.suffix.lower() == ".vtu":
        return
    items = [*ElementTree.fromstring(text).iter("DataItem")]
    if any(item.get("Format") not in (None, "XML", "HDF") for item in items):
        raise InputError("expected arrays in the file or in HDF5, got others")
    for name in {(i.text or "").strip().split(":")[0] for i in items if i.get("Format") == "HDF"}:
        if Path(name).name != name or not (beside := path.with_name(name)).is_file():
            raise InputError(f"expected its arrays in HDF5 beside it, got {name!r}")
        with h5py.File(beside, "r") as file:
            check_hdf5(file)


def _body_of(read: Any) -> Mesh:
    """Body of a meshio mesh; InputError for one with cells of other kinds."""
    points = np.asarray(read.points, float)
    kinds = {block.type for block in read.cells if block.dim > 1}
    d = max([block.dim for block in read.cells], default=0)
    for block in read.cells:
        if not np.size(block.data) or np.shape(block.data)[1] < CORNERS.get(block.type, 1):
            raise InputError(f"expected whole cells, got a block of {block.type} that is cut off")
    known = {kind for kind in CORNERS if d == 2 or not kind.startswith("quad")}
    if not kinds or not kinds <= known:
        kinds = kinds - known or {block.type for block in read.cells}
        raise InputError(
            "expected triangles and quadrilaterals, or tetrahedra, and no other cells, got "
            + (", ".join(sorted(kinds)) or "nothing")
        )
    if d == 2 and points.shape[1] == 3 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points, 0).max():
        raise InputError(f"expected a plane mesh, z varies by {np.ptp(points[:, 2]):g}")
    x, every, middle = points[:, :d], [], dict[tuple[int, int], ndarray]()
    for block in read.cells:
        if block.dim != d:
            continue
        n, cells = CORNERS[block.type], np.asarray(block.data)
        every.append(_halves(x, cells[:, :4]) if d < n - 1 else cells[:, :n])
        if d == 2 and cells.shape[1] > n:
            for k in range(n):
                ends = np.sort(cells[:, [k, (k + 1) % n]])
                middle |= {tuple(pair): x[m] for pair, m in zip(ends.tolist(), cells[:, n + k])}
    cells = np.concatenate(every)
    if "gmsh:physical" in read.cell_data:  # where cells of several groups stand once for each
        cells = cells[np.sort(np.unique(np.sort(cells), axis=0, return_index=True)[1])]
    return make_mesh(x, cells, _groups(read, cells), middle, inner=True)


def _halves(x: ndarray, quads: ndarray) -> ndarray:
    """Cut quadrilaterals [T, 4] in two triangles, [n, 3], at a reentrant corner if there is one;
    those with a repeated corner are one triangle."""
    cuts = quads[:, [[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]]]
    size = det(x[cuts[..., 1:]] - x[cuts[..., :1]])
    least = (size * np.sign(size.sum(axis=2, keepdims=True))).min(axis=2)
    second = (least[:, 0] <= 0) & (least[:, 1] > 0)
    halves = np.where(second[:, None, None], cuts[:, 1], cuts[:, 0])
    every = np.swapaxes(halves, 0, 1).reshape(-1, 3)
    return every[(np.diff(np.sort(every)) > 0).all(axis=1)]


def _groups(read: Any, body: ndarray) -> Arrays:
    """Lines or triangles of a meshio mesh by the names or numbers of its sets and groups; of a set
    of nodes the outline's sides with all corners in it."""
    dim = body.shape[1] - 2
    sets: dict[str, list[ndarray]] = {}
    names = {int(v[0]): [name] for name, v in read.field_data.items() if v[1] == dim}
    lines = [(n, np.asarray(block.data)) for n, block in enumerate(read.cells) if block.dim == dim]
    for number, data in lines:
        found = data[:, : dim + 1]
        if dim == 1:  # Abaqus has an edge's midpoint second, others last
            found = np.where(np.isin(found[:, 1:], body), found, data[:, [0, -1]])
        for key in (key for key in read.cell_data if key.endswith(GROUPS)):
            tags = np.asarray(read.cell_data[key][number])
            for tag in np.unique(tags[tags != 0]).tolist():
                for name in names.get(tag, names.get(-tag, [str(abs(tag))])):
                    sets.setdefault(name, []).append(found[tags == tag])
        for name, kept in read.cell_sets.items():
            if not name.startswith("gmsh:") and kept[number] is not None and len(kept[number]):
                sets.setdefault(name, []).append(found[kept[number]])
    _, outer, _, count = facets_of(body)
    for name, nodes in read.point_sets.items():
        if not name.startswith("gmsh:"):
            sides = outer[(count == 1) & np.isin(outer, nodes).all(axis=1)]
            if not len(sides):
                warn(f"{name}: no side of the outline is between its nodes")
            sets.setdefault(name, []).append(sides)
    if lines and not sets:
        warn(
            f"none of the {sum(len(data) for _, data in lines)} {('lines', 'faces')[dim - 1]} in "
            f"the file is in a group: all parts are '{REST}'; vtu, vtk and xdmf keep no sets, .msh "
            "and .inp do"
        )
    return {name: np.concatenate(facets) for name, facets in sets.items()}


PLANE = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
ELEMENTS = dict.fromkeys(("CPS", "CPE", "S", "M3D"), (2, PLANE))
ELEMENTS |= {"C3D": (3, {4: "tetra", 10: "tetra10"})}
ELEMENTS |= dict.fromkeys(("T2D", "T3D"), (1, {2: "line", 3: "line3"}))
ELEMENTS |= dict.fromkeys(("B2", "B3"), (1, {1: "line", 2: "line3"}))
"""Dimension of elements by their letters, and meshio's names by the number behind these."""
OF_SETS = {"INSTANCE", "GENERATE", "INTERNAL", "UNSORTED"}
READ = {
    "NODE": {"NSET"},
    "ELEMENT": {"TYPE", "ELSET"},
    "NSET": {"NSET"} | OF_SETS,
    "ELSET": {"ELSET"} | OF_SETS,
    "PART": {"NAME"},
    "INSTANCE": {"NAME", "PART"},
}
"""Keywords that are read, and all their options that are."""
FRAME = {"HEADING", "PREPRINT", "END PART", "ASSEMBLY", "END INSTANCE", "END ASSEMBLY"}
BESIDE = {
    "MATERIAL", "ELASTIC", "DENSITY", "EXPANSION", "PLASTIC", "HYPERELASTIC", "DAMPING",
    "CONDUCTIVITY", "SPECIFIC HEAT", "SOLID SECTION", "SHELL SECTION", "MEMBRANE SECTION",
    "BEAM SECTION", "BOUNDARY", "AMPLITUDE", "INITIAL CONDITIONS", "RESTART", "STEP",
}  # fmt: skip
"""Keywords that say nothing of the shape, without a word and with one."""


EXPONENT = re.compile(r"(?<=[\d.])(?:D|(?=[+-]))")
"""How the exponent of a number begins in FORTRAN, where that is by no E."""


def keywords(text: str) -> Iterator[tuple[str, dict[str, str], list[list[str]]]]:
    """Iterate over an Abaqus file's keywords, options and words by line, up to the first *STEP."""
    lines = [line.strip() for line in text.splitlines() if not line.startswith("**")]
    joined = re.sub(r"^(\*.*,)\n", r"\1", "\n".join(filter(None, lines)), flags=re.M)
    first, *parts = ("\n" + joined).split("\n*")
    if first.strip():
        raise InputError(f"expected a keyword, as *NODE, got {first.split()[0]!r}")
    for part in parts:
        head, *rows = part.split("\n")
        name, *words = (word.strip() for word in head.split(","))
        pairs = (word.partition("=") for word in words)
        options = {key.strip().upper(): value.strip(' \t"') for key, _, value in pairs}
        blank = "0" if name.upper() == "NODE" else ""
        split = ([word.strip(' \t"') or blank for word in row.split(",")] for row in rows)
        yield " ".join(name.upper().split()), options, [[*filter(None, row)] for row in split]
        if name.upper() == "STEP":
            return


def read_abaqus(text: str) -> SimpleNamespace:
    """Read points, cells and sets (of any case) of an Abaqus file, named as meshio does. Warns
    of keywords beside the shape; InputError for all others that are not read, and options:
    instances moved or repeated, coordinate systems, nodes and elements made of others, surfaces."""
    nodes, elements = dict[int, list[float]](), set[int]()
    blocks: list[tuple[int, str, ndarray]] = []
    sets: dict[str, dict[str, set[int]]] = {"NSET": {}, "ELSET": {}}
    passed, once, first = list[str](), set[str](), dict[str, str]()
    for name, options, rows in keywords(text):
        if name in BESIDE:
            passed.append(f"*{name}")
        if name in BESIDE | FRAME:
            continue
        more = [f", {key}" for key in options if key not in READ.get(name, options)]
        if more or name not in READ:
            raise InputError(
                f"*{name}{''.join(more[:1])} is not read; give one part with nodes, elements and "
                "sets, in x, y, z as it is"
            )
        if name in ("INSTANCE", "PART") and (rows or name in once):
            raise InputError(f"*{name}: expected one that is not moved; give one flat part")
        once.add(name)
        members = set[int]()
        if name == "NODE":
            own = {  # 1.0D+1 and 1.0+1 too
                int(n): [float(EXPONENT.sub("E", w.upper())) for w in [*x, "0", "0"][:3]]
                for n, *x in rows
            }
            members, known = {*own}, {*nodes}
            nodes |= own
        elif name == "ELEMENT":
            blocks.append(_elements(options.get("TYPE", ""), rows))
            rows, members = [*blocks[-1][2]], {*blocks[-1][2][:, 0].tolist()}
            known, elements = elements, elements | members
        if members and (len(members) < len(rows) or members & known):
            raise InputError(f"*{name}: expected each number once")
        kind = {"NODE": "NSET", "ELEMENT": "ELSET"}.get(name, name)
        if name in sets:
            there = {*nodes} if kind == "NSET" else elements
            members = _members(f"*{kind}, {options[kind]}", options, rows, sets[kind], there)
        if name in sets or kind in options:
            first.setdefault(key := options[kind].upper(), options[kind])
            sets[kind].setdefault(key, set()).update(members)
    if passed:
        warn(f"not read: {', '.join(dict.fromkeys(passed))}")
    row = {number: n for n, number in enumerate(nodes)}
    if missing := {n for *_, cells in blocks for n in cells[:, 1:].flat} - {*row}:
        raise InputError(f"*ELEMENT: expected nodes that are there, got {min(missing)}")
    at = np.vectorize(row.get, otypes=[int])
    return SimpleNamespace(
        points=np.array([*nodes.values()]).reshape(-1, 3),
        cells=[SimpleNamespace(dim=d, type=kind, data=at(c[:, 1:])) for d, kind, c in blocks],
        cell_data={},
        field_data={},
        point_sets={first[name]: [row[n] for n in own] for name, own in sets["NSET"].items()},
        cell_sets={
            first[name]: [np.flatnonzero(np.isin(cells[:, 0], [*own])) for *_, cells in blocks]
            for name, own in sets["ELSET"].items()
        },
    )


def _elements(told: str, rows: list[list[str]]) -> tuple[int, str, ndarray]:
    """Dimension and kind of cells, and their numbers with their corners', [T, 1 + n]."""
    found = re.fullmatch(r"(CPS|CPE|S|M3D|C3D|T2D|T3D|B2|B3)(\d+)(?:[A-Z]+\d*)?", told.upper())
    d, kinds = ELEMENTS[found[1]] if found else (0, {})
    if found is None or (size := int(found[2])) not in kinds:
        raise InputError(f"*ELEMENT, TYPE={told} is not read; tetrahedra, sheets and bars are")
    count = size + (found[1][0] == "B")
    numbers = [int(word) for row in rows for word in row]
    if not numbers or len(numbers) % (1 + count):
        raise InputError(f"*ELEMENT, TYPE={told}: expected {count} nodes of each")
    return d, kinds[size], np.array(numbers).reshape(-1, 1 + count)


def _members(
    told: str,
    options: dict[str, str],
    rows: list[list[str]],
    sets: dict[str, set[int]],
    there: set[int],
) -> set[int]:
    """Numbers in a set, of those that exist; InputError for others."""
    if "GENERATE" in options:
        runs = [range(int(a), int(b) + 1, *map(int, step)) for a, b, *step in rows]
        return {n for run in runs for n in there if n in run}
    found = set[int]()
    for word in itertools.chain(*rows):
        one = {int(word)} if word.isdigit() else sets.get(word.upper())
        if one is None or not one <= there:
            raise InputError(f"{told}: {word} is not there")
        found |= one
    return found
