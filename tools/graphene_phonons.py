"""Force constants of graphene, and its free disk under smooth loads, both linear at 0 K."""

import ase
import numpy as np

from tools.graphene import DISK_RADIUS, THICKNESS, area_per_atom, bond_length, disk, sheet
from tools.lammps_session import POTENTIAL, LammpsSession
from tools.make_graphene import SMOOTHING_RADIUS, ZIGZAG
from tools.statics import Statics
from warp_peri import Points, Samples
from warp_peri.atoms import coarse_grain, smoothing_matrix
from warp_peri.micromodulus.force_constants import (
    ForceConstants,
    finite_differences,
    from_supercell,
)
from warp_peri.structures.calculators import potential_file

CELLS = (9, 6)
"""Of the supercell, four atoms each; forces reach two bonds."""
LONGEST, SHORTEST, WINDOW = 200.0, 60.0, 75.0
"""Wavelengths of the loads on the disk, and the radius that they end at [Å]."""
SEEN, FILLED = 85.0, 0.93
"""Radius up to which the disk is compared [Å], and how much of a node's cone atoms must fill."""


def force_constants(
    potential: str = POTENTIAL, elements: tuple[str, ...] = ("C",)
) -> ForceConstants:
    """Of the rectangular cell of four atoms, by finite differences on a supercell.

    `potential`: a Tersoff file of the wheel; `elements`: of the atoms, in turn, on the sites of
    graphene.
    """
    file = potential_file(potential)
    bond = bond_length(file)
    flat, box = sheet(bond, cells=CELLS)
    x = np.pad(flat, ((0, 0), (0, 1)))
    names = [elements[n % len(elements)] for n in range(len(x))]
    cell = [box[0] / CELLS[0], box[1] / CELLS[1], 20.0]
    one = ase.Atoms(names[:4], positions=x[:4], cell=cell, pbc=True)
    many = ase.Atoms(names, positions=x, cell=[*box, 20.0], pbc=True)
    with LammpsSession(flat, box=box, potential=file, elements=elements) as session:

        def forces(moved: np.ndarray) -> np.ndarray:
            return np.pad(session.forces(moved[:, :2]), ((0, 0), (0, 1)))

        phi, change = finite_differences(forces, x, range(4))
    return from_supercell(one, many, phi, range(4), thickness=THICKNESS, change=change)


def free_disk(spacing: float = 5.0, loads: int = 8, seed: int = 3) -> tuple[Samples, np.ndarray]:
    """Smooth balanced loads on a free disk of atoms, and where u is known, [N] bool.

    Nodes reach beyond the disk, so that every element it cuts has its corners; all are interior.
    """
    bond = bond_length()
    x = disk(bond, radius=DISK_RADIUS)
    with LammpsSession(x, box=None) as session:
        statics = Statics(x, box=None, session=session)
        x = statics.reference
        rng = np.random.default_rng(seed)
        forces = np.array([_load(x, rng) for _ in range(loads)])
        moved = np.array([statics.linear_response(force) for force in forces])
    most = int(DISK_RADIUS / spacing) + 2
    line = spacing * np.arange(-most, most + 1)
    nodes = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    nodes = nodes[np.linalg.norm(nodes, axis=1) < DISK_RADIUS + 1.5 * spacing]
    omega = smoothing_matrix(x, nodes, radius=SMOOTHING_RADIUS, spacing=spacing)
    u, b = coarse_grain(
        omega, displacement=moved, force=forces, node_area=spacing**2, thickness=THICKNESS
    )
    filled = np.asarray(omega.sum(axis=1)) * area_per_atom(bond) / spacing**2
    known = (np.linalg.norm(nodes, axis=1) < SEEN) & (filled > FILLED)
    points = Points(nodes, np.ones(len(nodes), bool), spacing, axis=ZIGZAG)
    return Samples(points, u, b), known


def _load(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One wave in a window around the middle, without resultant and moment, [A, 2]."""
    k, angle = rng.normal(size=2), rng.uniform(0, 2 * np.pi)
    k *= 2 * np.pi / rng.uniform(SHORTEST, LONGEST) / np.linalg.norm(k)
    window = np.cos(np.pi / 2 * np.minimum(1, np.linalg.norm(x, axis=1) / WINDOW)) ** 2
    wave = window * np.cos(x @ k + rng.uniform(0, 2 * np.pi))
    force = np.outer(wave, [np.cos(angle), np.sin(angle)])
    one = np.ones(len(x))
    rigid = np.stack([np.outer(one, (1, 0)), np.outer(one, (0, 1)), x[:, ::-1] * (-1, 1)])
    inside = rigid * window[:, None]
    share = np.linalg.solve(
        np.einsum("aij,bij->ab", rigid, inside), np.einsum("aij,ij->a", rigid, force)
    )
    return force - np.tensordot(share, inside, 1)
