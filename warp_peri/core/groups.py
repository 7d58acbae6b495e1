"""Point groups of a crystal, and what of them its lattice of nodes shares.

C(−ξ) = C(ξ) whatever the crystal, so that every group here contains the inversion (theory, T5).
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from warp_peri.errors import InputError, optional
from warp_peri.points.arrays import checked

Symmetry: TypeAlias = str | np.ndarray
"""Name of a point group, or rotations of one, shape [G, d, d]."""
TOLERANCE = 1e-5
"""Of the entries of a rotation that maps a lattice onto itself."""
MOST = 400
"""Rotations beyond which generators do not close."""

# Generators in the crystal's axes; the principal axis is the third, in two dimensions the normal.
# Twelvefold turns leave an elastic sheet isotropic; in space "isotropic" is cubic with one equation
# more (elastic.allowed_tensors), since no finite group holds the cube's and makes it so.
_PLANE = {
    "1": "", "2": "", "m": "m", "2mm": "m", "4": "4", "4mm": "4 m", "3": "3", "3m": "3 m",
    "6": "6", "6mm": "6 m", "isotropic": "12 m",
}  # fmt: skip
_SOLID = {
    "-1": "", "2/m": "2", "mmm": "2 m", "4/m": "4", "4/mmm": "4 m", "-3": "3", "-3m": "3 m",
    "6/m": "6", "6/mmm": "6 m", "m-3": "2 m cycle", "m-3m": "4 m cycle",
    "isotropic": "4 m cycle",
}  # fmt: skip
_ALIASES = {
    "1": "-1", "2": "2/m", "m": "2/m", "222": "mmm", "mm2": "mmm", "4": "4/m", "-4": "4/m",
    "422": "4/mmm", "4mm": "4/mmm", "-42m": "4/mmm", "-4m2": "4/mmm", "3": "-3", "32": "-3m",
    "3m": "-3m", "6": "6/m", "-6": "6/m", "622": "6/mmm", "6mm": "6/mmm", "-6m2": "6/mmm",
    "-62m": "6/mmm", "23": "m-3", "m3": "m-3", "432": "m-3m", "-43m": "m-3m", "m3m": "m-3m",
}  # fmt: skip
LEAST = {2: "1", 3: "-1"}
CANDIDATES = {
    2: ("isotropic", "4mm", "4", "2mm", "1"),
    3: ("isotropic", "m-3m", "4/mmm", "mmm", "2/m", "-1"),
}
"""Groups that a fit to fields tries, from the largest."""

KNOWN = ("numbers", "initial_magmoms", "initial_charges", "tags", "mmcharges", "type")
COUNTED = ("positions", "id", "spacegroup_kinds")
"""Arrays of an ase.Atoms that calculators go by, and those that number all atoms of a file."""
LATTICE_GROUP = {2: "4mm", 3: "m-3m"}
"""Of a square and of a cubic lattice of nodes."""


def about_third(degrees: float) -> np.ndarray:
    """A turn about the third axis, shape [3, 3]."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


GENERATORS = {str(n): about_third(360 / n) for n in (2, 3, 4, 6, 12)}
GENERATORS |= {"m": np.diag([1.0, -1.0, 1.0]), "cycle": np.eye(3)[[1, 2, 0]]}


def point_group(symmetry: Symmetry, dimension: int) -> np.ndarray:
    """Rotations of a group in the crystal's axes, shape [G, d, d], with the inversion.

    Args:
        symmetry: a name such as "4mm" (plane) or "m3m", or rotations, shape [G, d, d].
        dimension: 2 or 3.

    Raises InputError for a name that is not known, or matrices that are not rotations.
    """
    if isinstance(symmetry, str):
        table, aliases = (_PLANE, {}) if dimension == 2 else (_SOLID, _ALIASES)
        words = table.get(aliases.get(symmetry, symmetry))
        if words is None:
            raise InputError(f"symmetry: expected one of {', '.join(table)}, got {symmetry!r}")
        named = [GENERATORS[word][:dimension, :dimension] for word in words.split()]
        return _closed(named, dimension)
    given = checked("symmetry", symmetry, float, ("G", dimension, dimension))
    off = np.abs(given @ given.transpose(0, 2, 1) - np.eye(dimension)).max()
    if off > TOLERANCE:
        raise InputError(f"symmetry: expected rotations, got matrices off by {off:.1e}")
    return _closed(list(given), dimension)


def name_of(group: np.ndarray) -> Symmetry:
    """The name of a group along the axes as `point_group` has it; the rotations where none is."""
    d = group.shape[1]
    for name in reversed(_PLANE if d == 2 else _SOLID):
        known = point_group(name, d)
        if name != "isotropic" and len(known) == len(group):
            off = np.abs(group[:, None] - known).max(axis=(2, 3)).min(axis=1)
            if off.max() < TOLERANCE:
                return name
    return group


def _closed(generators: list[np.ndarray], dimension: int) -> np.ndarray:
    """All products of generators and of the inversion."""
    found = [np.eye(dimension), -np.eye(dimension)]
    waiting = list(found)
    while waiting:
        last = waiting.pop()
        for g in generators:
            new = g @ last
            if np.abs(np.array(found) - new).max(axis=(1, 2)).min() > 10 * TOLERANCE:
                found.append(new)
                waiting.append(new)
                if len(found) > MOST:
                    raise InputError("symmetry: expected a finite group of rotations")
    return np.array(found)


def shared_with_nodes(group: np.ndarray, orientation: np.ndarray) -> np.ndarray:
    """What a square or cubic lattice of nodes has in common with a crystal (theory, T5).

    Args:
        group: of the crystal in its own axes, shape [G, d, d].
        orientation: the crystal's axes in those of the nodes, as columns.

    Returns integer matrices in the axes of the nodes, shape [g, d, d].
    """
    turned = orientation @ group @ orientation.T
    whole = np.rint(turned)
    return np.asarray(whole[np.abs(turned - whole).max(axis=(1, 2)) < TOLERANCE].astype(np.int64))


def lattice_group(dimension: int) -> np.ndarray:
    """All turns of a square or cubic lattice of nodes, integer matrices, shape [g, d, d]."""
    group = point_group(LATTICE_GROUP[dimension], dimension)
    return shared_with_nodes(group, np.eye(dimension))


def checked_orientation(orientation: Any, dimension: int) -> np.ndarray:
    """A rotation from the crystal's axes to those of the nodes; or degrees about the third axis.

    Raises InputError for what is no rotation.
    """
    given = checked("orientation", np.eye(dimension) if orientation is None else orientation)
    if given.ndim == 0:
        return about_third(float(given))[:dimension, :dimension]
    one = np.eye(dimension)
    if given.shape != one.shape or np.abs(given @ given.T - one).max() > TOLERANCE:
        words = f"degrees, or a rotation of shape [{dimension}, {dimension}]"
        raise InputError(f"orientation: expected {words}, got {given.tolist()!r:.80}")
    return given


def kinds_of(atoms: Any, names: Sequence[str] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Numbers that tell the atoms of an ase.Atoms apart, shape [n], and a first atom of each kind.

    Atoms are of one kind where all their arrays agree but those of COUNTED, or those that are
    named; numbers to three decimals.
    """
    told = []
    for name, values in atoms.arrays.items():
        if name not in COUNTED if names is None else name in names:
            values = np.round(values, 3) if values.dtype.kind == "f" else values
            told.append(np.unique(values, axis=0, return_inverse=True)[1].reshape(-1))
    _, first, kinds = np.unique(np.transpose(told), axis=0, return_index=True, return_inverse=True)
    return kinds.reshape(-1), first


def by_spglib(ask: str, crystal: tuple[np.ndarray, ...], precision: float, **how: bool) -> Any:
    """What spglib's function `ask` finds of a crystal.

    Args:
        ask: name of the function.
        crystal: edges of the cell as rows [Å], atoms in parts of them, and numbers that tell these
            apart.
        precision: distance [Å] within which atoms are on their sites.
        how: what else the function is told.

    Raises InputError where spglib is not installed, or finds nothing.
    """
    spglib = optional(
        "spglib",
        "symmetry: auto asks spglib for the group of a structure: pip install "
        "'warp_peri[crystals]', or name the group",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of how it will report errors one day
        found = getattr(spglib, ask)(crystal, symprec=precision, **how)
    if found is None:
        raise InputError("symmetry: spglib finds none of this structure")
    return found


def primitive_cell(crystal: tuple[np.ndarray, ...], precision: float) -> Any:
    """The crystal by its primitive cell, in the axes given."""
    return by_spglib("standardize_cell", crystal, precision, to_primitive=True, no_idealize=True)


def group_of_structure(
    cell: np.ndarray, fractions: np.ndarray, species: np.ndarray, *, precision: float = 1e-4
) -> np.ndarray:
    """Point group of a crystal by spglib, in the axes its cell is given in, [G, d, d].

    Args:
        cell: edges as rows [Å], shape [3, 3].
        fractions: positions of the atoms in parts of the edges, shape [n, 3].
        species: numbers that tell atoms apart, shape [n].
        precision: distance [Å] within which atoms are on their sites.

    Raises InputError where spglib is not installed or finds nothing.
    """
    # of the primitive cell: a larger one hides turns that are no whole numbers of its edges
    small = primitive_cell((np.asarray(cell, dtype=float), fractions, species), precision)
    found, edges = by_spglib("get_symmetry", small, precision), np.array(small[0]).T
    return point_group(edges @ found["rotations"].astype(float) @ np.linalg.inv(edges), 3)


def canonical(
    vectors: np.ndarray, group: np.ndarray, margin: float | np.ndarray = 0.0
) -> np.ndarray:
    """Which vectors may lie in one cone whose images under the group fill space, shape [K] bool.

    A vector is left out when all of it, out to `margin` times the 1-norm of the cone's face, has an
    image nearer to one direction in general position (theory, T12). shape [K, d].
    """
    d = vectors.shape[1]
    direction = np.array([1.0, 0.6137, 0.2719])[:d]
    kept = np.ones(len(vectors), bool)
    for face in np.unique(np.round(direction - direction @ group, 12), axis=0):
        kept &= vectors @ face + margin * np.abs(face).sum() >= -1e-12
    return kept


def orbit_grid(intervals: int, group: np.ndarray, dimension: int) -> np.ndarray:
    """Points of a grid on [−π, π]^d, one of each orbit, without 0, shape [K, d]; read only."""
    return _orbits(intervals, group.astype(np.int64).tobytes(), dimension)


@lru_cache(maxsize=8)
def _orbits(intervals: int, bytes_of_group: bytes, dimension: int) -> np.ndarray:
    group = np.frombuffer(bytes_of_group, np.int64).reshape(-1, dimension, dimension)
    line = np.arange(-intervals, intervals + 1)
    grid = np.array(list(itertools.product(line, repeat=dimension)))
    grid = grid[canonical(grid.astype(float), group) & grid.any(axis=1)]
    wave: np.ndarray = grid * (np.pi / intervals)
    wave.flags.writeable = False
    return wave
