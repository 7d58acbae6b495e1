"""Graphene at 0 K: its bond length, a periodic sheet and a free disk, built by ASE."""

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import ase
import numpy as np
from scipy.optimize import brentq

from tools.lammps_session import LammpsSession
from tools.statics import find_bonds

THICKNESS = 3.35
"""Distance between the layers of graphite [Å] (You et al. 2021, section 6.1)."""

SHEET_CELLS = (39, 23)
DISK_RADIUS = 100.0
"""[Å] (You et al. 2021, section 6.1)"""


def area_per_atom(bond: float) -> float:
    """Area of the sheet that belongs to one atom [Å²], for a bond length [Å]."""
    return 3 * math.sqrt(3) / 4 * bond**2


def bond_length(potential: str | Path | None = None, *, elements: Sequence[str] = ("C",)) -> float:
    """Bond length at which the sheet is free of stress, its minimum of energy per atom [Å].

    Raises what LammpsSession raises, ValueError when there is no minimum from 1.3 to 1.6 Å.
    """

    def tension(bond: float) -> float:
        positions, box = sheet(bond, cells=(3, 2))
        with LammpsSession(positions, box=box, potential=potential, elements=elements) as session:
            session.forces(positions)
            return float(np.trace(session.membrane_stress()))

    return float(brentq(tension, 1.3, 1.6, xtol=1e-12, rtol=1e-14))


def sheet(
    bond: float, *, cells: tuple[int, int] = SHEET_CELLS
) -> tuple[np.ndarray, tuple[float, float]]:
    """Periodic sheet of rectangular four-atom cells, its centre of mass at the origin.

    The origin is then no symmetry point of the crystal. With a hexagon centre there, the columns
    of nodes and of atoms run in step (5 Å is nearly twice the half cell), and the ripple that
    smoothing leaves adds up instead of averaging out.

    `bond`: bond length [Å]; `cells`: number of cells, √3 bond × 3 bond each, along x and y.

    Returns: positions [Å], shape [A, 2], bonds between even and odd numbers, and periods (Lx, Ly)
    [Å].
    """
    positions, box = _crystal(bond, cells)
    return positions - positions.mean(axis=0), (float(box[0]), float(box[1]))


@lru_cache(maxsize=4)
def _crystal(bond: float, cells: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Positions from −L/2 to L/2 around the centre of a hexagon, and L [Å]."""
    side = np.array([math.sqrt(3) * bond, 3 * bond])
    # Hexagon centres at the corner and the middle of the cell: the origin is one for any `cells`.
    cell = ase.Atoms(
        "C4",
        scaled_positions=[(1 / 2, 1 / 6, 0), (0, 1 / 3, 0), (0, 2 / 3, 0), (1 / 2, 5 / 6, 0)],
        cell=[*side, 1.0],
        pbc=(True, True, False),
    )
    atoms = cell.repeat((*cells, 1))
    return atoms.positions[:, :2] - side * cells / 2, side * cells


def disk(bond: float, *, radius: float = DISK_RADIUS) -> np.ndarray:
    """Free disk cut from the sheet around the centre of a hexagon, positions [Å], shape [A, 2].

    Atoms left with fewer than two neighbours are removed, as often as needed.
    """
    side = np.array([math.sqrt(3) * bond, 3 * bond])
    half = np.ceil(radius / side).astype(int) + 1
    positions, _ = _crystal(bond, (2 * half[0], 2 * half[1]))
    positions = positions[np.linalg.norm(positions, axis=1) <= radius]
    while True:
        bonds = find_bonds(positions, None)
        enough = np.bincount(bonds.ravel(), minlength=len(positions)) >= 2
        if enough.all():
            return positions
        positions = positions[enough]
