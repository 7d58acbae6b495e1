"""Meshes of Abaqus: one flat part, its elements, and the boundaries that its sets name."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np

from warp_peri.errors import InputError, warn

PLANE = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
KINDS = dict.fromkeys(("CPS", "CPE", "S", "M3D"), (2, PLANE))
KINDS |= {"C3D": (3, {4: "tetra", 10: "tetra10"})}
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
BESIDE |= {"BEAM SECTION", "BOUNDARY", "AMPLITUDE", "INITIAL CONDITIONS", "RESTART", "STEP"}
"""Keywords that say nothing of the shape, without a word and with one."""


def keywords(text: str) -> Iterator[tuple[str, dict[str, str], list[list[str]]]]:
    """Each keyword, its options, and the words of its lines; those from the first *STEP on are
    left."""
    lines = [line.strip() for line in text.splitlines() if not line.startswith("**")]
    joined = re.sub(r"^(\*.*,)\n", r"\1", "\n".join(filter(None, lines)), flags=re.M)
    first, *parts = ("\n" + joined).split("\n*")
    if first.strip():
        raise InputError(f"expected a keyword, as *NODE, got {first.split()[0]!r}")
    for part in parts:
        head, *rows = part.split("\n")
        name, *words = (word.strip() for word in head.split(","))
        pairs = (word.partition("=") for word in words)
        options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
        split = ([word.strip().strip('"') for word in row.split(",")] for row in rows)
        yield " ".join(name.upper().split()), options, [[*filter(None, row)] for row in split]
        if name.upper() == "STEP":
            return


def read_abaqus(text: str) -> SimpleNamespace:
    """Points, cells and sets, named as meshio names them.

    Warns of keywords beside the shape. Raises InputError for every other that is not read, and its
    options: instances that are moved or repeated, systems of coordinates, what makes nodes and
    elements of others, surfaces.
    """
    nodes: dict[int, tuple[float, ...]] = {}
    elements: set[int] = set()
    blocks: list[tuple[int, str, np.ndarray]] = []
    sets: dict[str, dict[str, set[int]]] = {"NSET": {}, "ELSET": {}}
    passed, once = list[str](), set[str]()
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
        members: set[int] = set()
        if name == "NODE":
            own = {int(n): (*map(float, x), 0.0, 0.0)[:3] for n, *x in rows}
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
            sets[kind].setdefault(options[kind], set()).update(members)
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
        point_sets={name: [row[n] for n in own] for name, own in sets["NSET"].items()},
        cell_sets={
            name: [np.flatnonzero(np.isin(cells[:, 0], [*own])) for *_, cells in blocks]
            for name, own in sets["ELSET"].items()
        },
    )


def _elements(told: str, rows: list[list[str]]) -> tuple[int, str, np.ndarray]:
    """Dimension and kind of cells, and their numbers with their corners', [T, 1 + n]."""
    found = re.fullmatch(r"(CPS|CPE|S|M3D|C3D|T2D|T3D|B2|B3)(\d+)(?:[A-Z]+\d*)?", told.upper())
    d, kinds = KINDS[found[1]] if found else (0, {})
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
    """Numbers of a set, of those that are there; InputError for others."""
    if "GENERATE" in options:
        runs = [(int(row[0]), int(row[1]) + 1, *map(int, row[2:])) for row in rows]
        return {n for run in runs for n in there if n in range(*run)}
    found: set[int] = set()
    for word in itertools.chain(*rows):
        one = {int(word)} if word.isdigit() else sets.get(word)
        if one is None or not one <= there:
            raise InputError(f"{told}: {word} is not there")
        found |= one
    return found
