"""The cell of a structure: checked, sheet or solid, its axes, its smallest and its exact form."""

from __future__ import annotations

import warnings
from typing import Any

import ase
import numpy as np
from ase.neighborlist import neighbor_list
from scipy.linalg import sqrtm

from warp_peri.core.groups import by_spglib, group_of_structure, kinds_of, primitive_cell
from warp_peri.errors import InputError

VACUUM = 8.0
"""A gap between atoms [Å] that counts as vacuum."""
WIDE = 5.0
"""A gap [Å] that is no vacuum yet, and wide for a solid."""
HEIGHT = 40.0
"""Of the box around a sheet, beside the sheet itself [Å]."""
FULL, UPON = 0.999, 0.5
"""Occupancy of a site that an atom fills; distance [Å] that no two atoms are nearer than."""
FLAT = 1e-3
"""Smallest singular value of the directions of a cell's edges."""
ALMOST = 1e-3
"""Of a turn's matrix, off whole numbers that it is meant to have."""
ON_SITES = 1e-4
"""Distance [Å] within which atoms are on their sites."""
SAME, ROUNDING = 1e-4, 1e-6
"""Energies of an atom in two cells that are one crystal's: apart by less [eV], and relative."""


def _check_sites(atoms: ase.Atoms) -> None:
    """Raise InputError for atoms upon each other, and shared sites, of which ASE keeps one atom."""
    for site in (atoms.info.get("occupancy") or {}).values():
        if len(site) > 1 or min(site.values()) < FULL:
            shared = ", ".join(f"{kind} {part:g}" for kind, part in site.items())
            raise InputError(
                f"structure: expected sites that one element fills, got one of {shared}; "
                "give a cell with every atom on a site of its own"
            )
    edges, x = np.array(atoms.cell), np.array(atoms.positions)
    if not len(atoms) or not (np.isfinite(edges).all() and np.isfinite(x).all()):
        raise InputError("structure: expected one atom or more, at finite places in a finite cell")
    edges = edges[np.array(atoms.pbc)]
    lengths = np.linalg.norm(edges, axis=1)
    if not lengths.all() or np.linalg.svd(edges / lengths[:, None])[1].min(initial=1.0) < FLAT:
        raise InputError("structure: expected edges of the cell that span one, got some in a plane")
    first, second, apart = neighbor_list("ijd", atoms, UPON)
    if len(apart):
        n = apart.argmin()
        raise InputError(
            f"structure: expected atoms {UPON:g} Å apart or more, got {apart[n]:.2g} Å between "
            f"atoms {first[n]} and {second[n]} of {len(atoms)}; is a site there twice, or are "
            "lengths not in Å?"
        )


def oriented(atoms: ase.Atoms, turning: bool) -> tuple[ase.Atoms, bool]:
    """The structure with a sheet across z, amid a high box, and whether it is one.

    Without turning, axes stay as they are; InputError for a sheet that is not across z then.
    """
    _check_sites(atoms)
    periodic, cell = np.array(atoms.pbc), np.array(atoms.cell)
    if not periodic.any():
        raise InputError("structure: expected a crystal with a periodic cell, got a free cluster")
    empty = [a for a in range(3) if not periodic[a] or gap(atoms, a) >= VACUUM]
    if len(empty) > 1:
        raise InputError(
            f"structure: expected a sheet or a solid; along {len(empty)} edges of the cell there "
            "is vacuum or no period"
        )
    ready: ase.Atoms = atoms.copy()
    ready.set_constraint()
    ready.calc = None
    if not empty:
        widest = max(gap(atoms, a) for a in range(3))
        if widest >= WIDE:
            warnings.warn(
                f"structure: taken for a solid, with a gap of {widest:.3g} Å along an edge; a "
                f"sheet has {VACUUM:g} Å of vacuum or more",
                stacklevel=4,
            )
        ready.pbc = True
        return to_shared_axes(ready) if turning else ready, False
    first, second = ((1, 2), (2, 0), (0, 1))[empty[0]]
    normal = np.cross(cell[first], cell[second])
    along = cell[first] / np.linalg.norm(cell[first])
    up = normal / np.linalg.norm(normal)
    turn = np.array([along, np.cross(up, along), up])
    if not turning:
        if abs(up[2]) < 1 - FLAT**2:
            raise InputError("hold: expected a sheet across z, whose strains have names in x and y")
        first, second = (first, second) if up[2] > 0 else (second, first)
        turn = np.eye(3)
    x = np.array(ready.positions) @ turn.T
    if periodic[empty[0]]:  # a sheet that the period cuts is put together at the gap
        x = _joined(atoms, empty[0], x, turn)
    edges = np.array([turn @ cell[first], turn @ cell[second], [0, 0, HEIGHT + np.ptp(x[:, 2])]])
    x[:, 2] += edges[2, 2] / 2 - (x[:, 2].min() + x[:, 2].max()) / 2
    ready.set_cell(edges)
    ready.positions[:] = x
    ready.pbc = True
    return ready, True


def _heights(atoms: ase.Atoms, axis: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Parts of an edge at which atoms are, rising, their order, and how far its faces are apart."""
    part = np.linalg.solve(np.array(atoms.cell).T, np.array(atoms.positions).T)[axis] % 1.0
    order = np.argsort(part)
    apart = 1 / np.linalg.norm(np.linalg.inv(np.array(atoms.cell))[:, axis])
    return part[order], order, float(apart)


def gap(atoms: ase.Atoms, axis: int) -> float:
    """Largest distance between neighbours along an edge [Å]."""
    part, _, apart = _heights(atoms, axis)
    return float(np.diff(np.append(part, part[0] + 1)).max() * apart)


def _joined(atoms: ase.Atoms, axis: int, x: np.ndarray, turn: np.ndarray) -> np.ndarray:
    part, order, _ = _heights(atoms, axis)
    last = int(np.diff(np.append(part, part[0] + 1)).argmax())
    edge = turn @ np.array(atoms.cell)[axis]
    whole = np.floor(np.linalg.solve(np.array(atoms.cell).T, np.array(atoms.positions).T)[axis])
    x = x - np.outer(whole, edge)
    if last < len(part) - 1:
        x[order[: last + 1]] += edge
    return x


def to_shared_axes(atoms: ase.Atoms) -> ase.Atoms:
    """A solid turned to spglib's standard axes, where these share more turns with nodes."""
    given = np.array(atoms.cell), atoms.get_scaled_positions(), kinds_of(atoms)[0]
    found = by_spglib("get_symmetry_dataset", given, ON_SITES)
    if found is None:
        return atoms
    group = group_of_structure(*given)
    turn = np.array(found.std_rotation_matrix)

    def shared(turns: np.ndarray) -> int:
        return int((np.abs(turns - np.rint(turns)).max(axis=(1, 2)) < 1e-6).sum())

    if shared(turn @ group @ turn.T) > shared(group):
        atoms = atoms.copy()
        atoms.set_cell(np.array(atoms.cell) @ turn.T, scale_atoms=True)
    return atoms


def exact_cell(atoms: ase.Atoms) -> ase.Atoms:
    """The cell without the last digits that break its symmetry, and turns of nodes: 1e-4 Å."""
    given = np.array(atoms.cell), atoms.get_scaled_positions(), kinds_of(atoms)[0]
    found = by_spglib("get_symmetry", given, ON_SITES)
    if found is None:
        return atoms
    W, edges = found["rotations"].astype(float), np.array(atoms.cell).T
    metric = (W.transpose(0, 2, 1) @ (edges.T @ edges) @ W).mean(axis=0)
    back = np.linalg.inv(edges)
    edges = np.real(sqrtm(back.T @ metric @ back)) @ edges
    turns = edges @ W @ np.linalg.inv(edges)
    whole = np.rint(turns)
    near = np.abs(turns - whole).max(axis=(1, 2)) < ALMOST
    U, _, V = np.linalg.svd((turns[near] @ whole[near].transpose(0, 2, 1)).mean(axis=0))
    exact: ase.Atoms = atoms.copy()
    exact.set_cell(((U @ V).T @ edges).T, scale_atoms=True)
    return exact


def smallest(atoms: ase.Atoms, flat: bool, calculator: Any) -> ase.Atoms:
    """The primitive cell in the same axes; a sheet's third edge stays.

    Its atoms keep their moments, charges and tags. Where the calculator has another energy of an
    atom in it, by whatever else it goes, the cell stays as it is, with a warning.
    """
    kinds, first = kinds_of(atoms)
    small = primitive_cell((np.array(atoms.cell), atoms.get_scaled_positions(), kinds), ON_SITES)
    if small is None or len(small[2]) >= len(atoms):
        return atoms
    edges = np.array(small[0])
    x = small[1] @ edges
    if flat:
        (up,) = np.flatnonzero(np.abs(edges[:, :2]).max(axis=1) < 1e-6)
        edges = edges[[(up + 1) % 3, (up + 2) % 3, up]]
        if np.linalg.det(edges) < 0:
            edges[2] *= -1
        x[:, 2] %= abs(edges[2, 2])
    one: ase.Atoms = atoms[first[small[2]]]
    one.set_cell(edges)
    one.positions[:] = x
    try:
        whole, part = (_energy(cell, calculator) for cell in (atoms, one))
    except Exception:  # without energies; forces that are not there are told where they are asked
        return one
    if abs(whole - part) > min(SAME, ROUNDING * max(abs(whole), abs(part))):
        warnings.warn(
            f"structure: the cell of {len(atoms)} atoms is kept: the calculator has {whole:.6g} eV "
            f"an atom in it and {part:.6g} eV in the smallest, of {len(one)}",
            stacklevel=3,
        )
        return atoms
    return one


def _energy(cell: ase.Atoms, calculator: Any) -> float:
    """Of an atom [eV]."""
    cell = cell.copy()
    cell.calc = calculator
    return float(cell.get_potential_energy()) / len(cell)
