"""Meshes of Abaqus: one flat part, its elements, and the boundaries that its sets name."""

from __future__ import annotations

import itertools
import re
import warnings
from collections import Counter
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np

from warp_peri.errors import InputError

PLANE = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
SOLID = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15"}
SOLID |= {20: "hexahedron20", 27: "hexahedron27"}
BAR = {2: "line", 3: "line3"}
ELEMENTS = {
    **dict.fromkeys(("CPS", "CPE", "S", "M3D"), PLANE),
    "STRI": {3: "triangle", 65: "triangle6"},
    "C3D": SOLID,
    **dict.fromkeys(("T2D", "T3D"), BAR),
    "B": {21: "line", 31: "line", 22: "line3", 32: "line3"},
}
"""Kinds of cells by an element's letters and number."""
SIDES = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
    "pyramid": ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "wedge": ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "hexahedron": (
        *((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    ),
}
"""Corners of the sides of a kind, in the order of VTK and of Abaqus."""
OF_SETS = {"INSTANCE", "GENERATE", "INTERNAL", "UNSORTED"}
READ: dict[str, set[str]] = {
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

    Sides of the outline all of whose corners are in a set of nodes are a boundary of its name.

    Warns of keywords beside the shape. Raises InputError for every other that is not read, and its
    options: instances that are moved or repeated, systems of coordinates, what makes nodes and
    elements of others, surfaces.
    """
    nodes: dict[int, tuple[float, ...]] = {}
    blocks: list[tuple[str, np.ndarray]] = []
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
            kind, cells = _elements(options.get("TYPE", ""), rows)
            members = cells[:, 0].tolist()
            if len({*members}) < len(members) or elements & {*members}:
                raise InputError("*ELEMENT: expected each number once")
            elements |= {*members}
            blocks.append((kind, cells))
        if name in ("NSET", "ELSET"):
            given.append((name, options, rows))
        elif name in ("NODE", "ELEMENT"):
            kind_of_set = "NSET" if name == "NODE" else "ELSET"
            if kind_of_set in options:
                given.append((kind_of_set, options, [*map(str, members)]))
    if passed:
        warnings.warn(f"not read: {', '.join(dict.fromkeys(passed))}", stacklevel=4)
    return _mesh(nodes, blocks, _sets(given, {"NSET": {*nodes}, "ELSET": elements}))


def _elements(told: str, rows: list[str]) -> tuple[str, np.ndarray]:
    """Kind of cells, and their numbers with their corners', [T, 1 + n]."""
    found = re.fullmatch(r"(CPS|CPE|STRI|S|M3D|C3D|T2D|T3D|B)(\d+)(?:[A-Z]+\d*)?", told.upper())
    kind = ELEMENTS[found[1]].get(int(found[2])) if found else None
    if kind is None:
        raise InputError(f"*ELEMENT, TYPE={told}: it is not read; solids, sheets and bars are")
    count = 1 + (int("".join(filter(str.isdigit, kind)) or 0) or len(_corners(kind)))
    numbers = [int(word) for row in rows for word in row.split(",") if word.strip()]
    if not numbers or len(numbers) % count:
        raise InputError(f"*ELEMENT, TYPE={told}: expected {count - 1} nodes of each")
    return kind, np.array(numbers).reshape(-1, count)


def _corners(kind: str) -> set[int]:
    return {0, 1} if kind == "line" else {*itertools.chain(*SIDES[kind])}


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


def _mesh(
    nodes: dict[int, tuple[float, ...]],
    blocks: list[tuple[str, np.ndarray]],
    sets: dict[tuple[str, str], set[int]],
) -> SimpleNamespace:
    row = {number: n for n, number in enumerate(nodes)}
    if missing := {n for _, cells in blocks for n in cells[:, 1:].flat} - {*row}:
        raise InputError(f"*ELEMENT: expected nodes that are there, got {min(missing)}")
    d = max((_dimension(kind) for kind, _ in blocks), default=0)
    sides: Counter[frozenset[int]] = Counter()
    turned: dict[frozenset[int], tuple[int, ...]] = {}
    for kind, numbered in blocks:
        for side in SIDES[_straight(kind)] if _dimension(kind) == d > 1 else ():
            for corners in numbered[:, [1 + k for k in side]].tolist():
                sides[frozenset(corners)] += 1
                turned[frozenset(corners)] = tuple(corners)
    cells = [
        _block(kind, [[row[n] for n in one] for one in c[:, 1:].tolist()]) for kind, c in blocks
    ]
    named: dict[str, list[Any]] = {}
    for (what, name), numbers in sets.items():
        if what == "ELSET":
            kept = [np.flatnonzero(np.isin(c[:, 0], [*numbers])) for _, c in blocks]
            named.setdefault(name, []).extend(enumerate(kept))
            continue
        outer = [turned[s] for s, count in sides.items() if count == 1 and s <= numbers]
        if not outer:
            warnings.warn(
                f"*NSET, {name}: no side of the outline has all its corners", stacklevel=5
            )
        for size in {len(side) for side in outer}:
            of_size = [[row[n] for n in side] for side in outer if len(side) == size]
            named.setdefault(name, []).append((len(cells), np.arange(len(of_size))))
            cells.append(_block({2: "line", 3: "triangle", 4: "quad"}[size], of_size))
    empty = np.zeros(0, int)
    kept_of = {name: dict(kept) for name, kept in named.items()}
    return SimpleNamespace(
        points=np.array([*nodes.values()]).reshape(-1, 3),
        cells=cells,
        cell_data={},
        field_data={},
        cell_sets={n: [k.get(i, empty) for i in range(len(cells))] for n, k in kept_of.items()},
    )


def _straight(kind: str) -> str:
    return kind.rstrip("0123456789")


def _dimension(kind: str) -> int:
    return {"line": 1, "triangle": 2, "quad": 2}.get(_straight(kind), 3)


def _block(kind: str, corners: list[list[int]]) -> SimpleNamespace:
    return SimpleNamespace(type=kind, dim=_dimension(kind), data=np.array(corners))
