"""Meshes of Abaqus: one flat part, its elements, and the boundaries that its sets name."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np

from warp_peri.errors import InputError

PLANE = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
SOLID = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15"}
SOLID |= {20: "hexahedron20", 27: "hexahedron27"}
KINDS = dict.fromkeys(("CPS", "CPE", "S", "M3D"), (2, PLANE)) | {"C3D": (3, SOLID)}
KINDS |= dict.fromkeys(("T2D", "T3D"), (1, {2: "line", 3: "line3"}))
KINDS |= dict.fromkeys(("B2", "B3"), (1, {1: "line", 2: "line3"}))
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
BESIDE = {"MATERIAL", "ELASTIC", "DENSITY", "EXPANSION", "PLASTIC", "HYPERELASTIC", "DAMPING"}
BESIDE |= {"CONDUCTIVITY", "SPECIFIC HEAT", "SOLID SECTION", "SHELL SECTION", "MEMBRANE SECTION"}
BESIDE |= {"BEAM SECTION", "BOUNDARY", "AMPLITUDE", "INITIAL CONDITIONS", "RESTART"}
"""Keywords that say nothing of the shape, without a word and with one."""

Keyword = tuple[str, dict[str, str], list[str]]


def keywords(text: str) -> Iterator[Keyword]:
    """Each keyword, its options, and its lines of data; those from the first *STEP on are left."""
    current: Keyword | None = None
    lines = iter(line.strip() for line in text.splitlines() if not line.startswith("**"))
    for line in lines:
        if line.startswith("*"):
            if current is not None:
                yield current
            while line.endswith(","):
                line += next(lines, "*")
            head, *words = (word.strip() for word in line[1:].split(","))
            pairs = (word.partition("=") for word in words)
            options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
            current = " ".join(head.upper().split()), options, []
            if current[0] == "STEP":
                break
        elif line and current is None:
            raise InputError(f"expected a keyword, as *NODE, got {line!r}")
        elif line and current is not None:
            current[2].append(line)
    if current is not None:
        yield current


def read_abaqus(text: str) -> SimpleNamespace:
    """Points, cells and sets, named as meshio names them.

    Warns of keywords beside the shape. Raises InputError for every other that is not read, and its
    options: instances that are moved or repeated, systems of coordinates, what makes nodes and
    elements of others, surfaces.
    """
    nodes: dict[int, tuple[float, ...]] = {}
    blocks: list[tuple[int, str, np.ndarray]] = []
    given: list[tuple[str, dict[str, str], list[str]]] = []
    elements: set[int] = set()
    passed, once = list[str](), Counter[str]()
    for name, options, rows in keywords(text):
        once[name] += 1
        if name in BESIDE or name == "STEP":
            passed.append(f"*{name}")
            continue
        if name in FRAME:
            continue
        if more := [f", {key}" for key in options if key not in READ.get(name, options)]:
            raise InputError(f"*{name}{more[0]}: it is not read; give one part in x, y, z as it is")
        if name not in READ:
            raise InputError(f"*{name} is not read; give one part with nodes, elements and sets")
        if (name == "INSTANCE" and (rows or once[name] > 1)) or (name == "PART" and once[name] > 1):
            raise InputError(f"*{name}: expected one that is not moved; give one flat part")
        if name == "NODE":
            own = {int(n): x for n, *x in (row.rstrip(",").split(",") for row in rows)}
            if len(own) < len(rows) or own.keys() & nodes.keys():
                raise InputError("*NODE: expected each number once")
            nodes |= {n: (*map(float, x), 0.0, 0.0)[:3] for n, x in own.items()}
            members = [*own]
        elif name == "ELEMENT":
            d, kind, cells = _elements(options.get("TYPE", ""), rows)
            members = cells[:, 0].tolist()
            if len({*members}) < len(members) or elements & {*members}:
                raise InputError("*ELEMENT: expected each number once")
            elements |= {*members}
            blocks.append((d, kind, cells))
        if name in ("NSET", "ELSET"):
            given.append((name, options, rows))
        elif name in ("NODE", "ELEMENT"):
            kind_of_set = "NSET" if name == "NODE" else "ELSET"
            if kind_of_set in options:
                given.append((kind_of_set, options, [*map(str, members)]))
    if passed:
        warnings.warn(f"not read: {', '.join(dict.fromkeys(passed))}", stacklevel=4)
    sets = _sets(given, {"NSET": {*nodes}, "ELSET": elements})
    row = {number: n for n, number in enumerate(nodes)}
    if missing := {n for *_, cells in blocks for n in cells[:, 1:].flat} - {*row}:
        raise InputError(f"*ELEMENT: expected nodes that are there, got {min(missing)}")
    at = np.vectorize(row.get, otypes=[int])
    return SimpleNamespace(
        points=np.array([*nodes.values()]).reshape(-1, 3),
        cells=[SimpleNamespace(dim=d, type=kind, data=at(c[:, 1:])) for d, kind, c in blocks],
        cell_data={},
        field_data={},
        point_sets={
            name: [row[n] for n in own] for (of, name), own in sets.items() if of == "NSET"
        },
        cell_sets={
            name: [np.flatnonzero(np.isin(cells[:, 0], [*own])) for *_, cells in blocks]
            for (of, name), own in sets.items()
            if of == "ELSET"
        },
    )


def _elements(told: str, rows: list[str]) -> tuple[int, str, np.ndarray]:
    """Dimension and kind of cells, and their numbers with their corners', [T, 1 + n]."""
    found = re.fullmatch(r"(CPS|CPE|S|M3D|C3D|T2D|T3D|B2|B3)(\d+)(?:[A-Z]+\d*)?", told.upper())
    d, kinds = KINDS[found[1]] if found else (0, {})
    if found is None or (size := int(found[2])) not in kinds:
        raise InputError(f"*ELEMENT, TYPE={told}: it is not read; solids, sheets and bars are")
    count = size + (found[1][0] == "B")
    numbers = [int(word) for row in rows for word in row.split(",") if word.strip()]
    if not numbers or len(numbers) % (1 + count):
        raise InputError(f"*ELEMENT, TYPE={told}: expected {count} nodes of each")
    return d, kinds[size], np.array(numbers).reshape(-1, 1 + count)


def _sets(
    given: list[tuple[str, dict[str, str], list[str]]], there: dict[str, set[int]]
) -> dict[tuple[str, str], set[int]]:
    """Numbers in each set, by its keyword and name; InputError for those that are not there."""
    found: dict[tuple[str, str], set[int]] = {}
    for name, options, rows in given:
        label, here = options.get(name, ""), set[int]()
        for row in rows:
            words = [word.strip().strip('"') for word in row.split(",") if word.strip()]
            if "GENERATE" in options:
                first, last, *step = map(int, words)
                here |= {n for n in there[name] if n in range(first, last + 1, *step)}
                continue
            for word in words:
                one = {int(word)} if word.isdigit() else found.get((name, word))
                if one is None or not one <= there[name]:
                    raise InputError(f"*{name}, {label}: {word} is not there")
                here |= one
        found[name, label] = found.get((name, label), set()) | here
    return found
