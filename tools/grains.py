"""Copper in columns along [001], each grain turned by an angle of its own; linear at 0 K.

A column's atoms lie in two planes that mirror it, so that what is pushed along them stays in them:
a sheet as thick as a cell, its plane strain that of the solid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import ase
import ase.build
import numpy as np
from scipy.spatial import cKDTree

from tools.crystals import at_rest, force_constants, session
from tools.hessian import ColouredHessian
from tools.uneven_sheets import patch, waves
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.stability.inertia import symmetric_factors
from warp_peri.structures.waves import CONE, EV_IN_TPA, smoothing

NAME = "Cu"
PERIOD = 10 * 10**0.5
"""In cells: of a lattice turned by atan(1/3), and nearly so of one that is not."""
NODES = 32
"""Each way."""
CUT = 5.51
"""The potential reaches no further [Å]."""
NEAR = 0.7
"""Of the distance of neighbours: of two atoms closer than that one is left out."""
REST, STEPS = 1e-5, 2000
"""Norm of the forces at rest [eV/Å], and steps of descent that are allowed."""
BORDER = 1e-6
"""Of the period: atoms so near beyond its upper border belong to the other one."""
SHORTEST = 4.0
"""Wavelength of loads, in spacings; and radii of local ones."""
PATCHES = (5.0, 3.0, 2.0)


@dataclass(frozen=True)
class Columns:
    """Grains under loads.

    Attributes:
        sets: "waves" and "patch", displacement [Å] and load [TPa/Å] on nodes.
        grain: number of each node's own, [N].
        atoms: of them at rest, [A, 3] [Å].
        stress: of the period at rest, in its plane [TPa].
    """

    sets: dict[str, Samples]
    grain: np.ndarray
    atoms: np.ndarray
    stress: np.ndarray


def plane_constants() -> ForceConstants:
    """Of one crystal, for what is pushed along (001) and even along [001]."""
    solid = force_constants(NAME)
    flat = np.array([1.0, 1.0, 0.0])
    return replace(
        solid,
        positions=solid.positions * flat,
        vectors=solid.vectors * flat,
        values=solid.values * np.outer(flat, flat),
        thickness=float(solid.cell[2, 2]),
    )


def columns(
    number: Callable[[np.ndarray], np.ndarray],
    degrees: Sequence[float],
    *,
    loads: int = 8,
    seed: int = 0,
    period: float = PERIOD,
    nodes: int = NODES,
) -> Columns:
    """Atoms' linear answers seen from nodes.

    Args:
        number: of the grain at positions over the box, [n, 2] from −½ to ½, [n].
        degrees: by which each grain is turned.
        loads: of either set.
        seed: of the loads.
        period: in cells, either way.
        nodes: either way.
    """
    rng = np.random.default_rng(seed)
    cell, _ = at_rest(NAME)
    a = float(cell.cell[0, 0])
    side = period * a
    h = side / nodes
    atoms = _filled(cell, side, number, degrees)
    with session(NAME, atoms) as lammps:
        rest = lammps.relax(REST, STEPS)
        rest[:, 2] = a / 2 * np.rint(2 * rest[:, 2] / a)  # what rounding took off the mirrors
        lammps.forces(rest)
        stress = lammps.stress()[:2, :2]
        wide = rest.copy()

        def forces(x: np.ndarray) -> np.ndarray:
            wide[:, :2] = x
            return lammps.nearby_forces(wide)[:, :2]

        edges = np.array([side, side, a])
        near = cKDTree(np.mod(np.mod(rest, edges), edges), boxsize=edges)
        bonds = near.query_pairs(CUT, output_type="ndarray")
        H = ColouredHessian(bonds, len(rest))(forces, rest[:, :2])
    x = rest[:, :2] - side / 2
    box = (side, side)
    pushed = [waves(x, box, rng, SHORTEST * h) for _ in range(loads)]
    pushed += [patch(x, box, r * h, rng) for r in np.resize(PATCHES, loads)]
    pushed = [force - force.mean(axis=0) for force in pushed]
    factors = symmetric_factors(H[2:, 2:])
    moved = [np.append([0, 0], factors.solve(f.ravel()[2:])).reshape(-1, 2) for f in pushed]
    line = (np.arange(nodes) + 0.5) * h - side / 2
    at = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    smooth = smoothing(x + side / 2, at + side / 2, CONE * h, side)
    density = np.asarray(smooth.sum(axis=1)).reshape(-1, 1)
    u = np.array([(smooth @ v) / density for v in moved])
    u -= u.mean(axis=1, keepdims=True)
    b = np.array([smooth @ f for f in pushed]) * (EV_IN_TPA / (h**2 * a))
    points = Points.sheet((nodes, nodes), h)
    sets = {
        "waves": Samples(points, u[:loads], b[:loads]),
        "patch": Samples(points, u[loads:], b[loads:]),
    }
    return Columns(sets, number(at / side), rest, stress)


def _filled(
    cell: ase.Atoms,
    side: float,
    number: Callable[[np.ndarray], np.ndarray],
    degrees: Sequence[float],
) -> ase.Atoms:
    """Each grain's own lattice where it is, without atoms that stand too near to another."""
    a = float(cell.cell[0, 0])
    many = int(0.75 * side / a) + 2
    at = np.stack(np.meshgrid(*[np.arange(-many, many + 1)] * 2), axis=-1).reshape(-1, 2)
    found = []
    for grain, angle in enumerate(np.deg2rad(degrees)):
        flat = (at[:, None] + cell.positions[:, :2] / a).reshape(-1, 2) * a
        height = np.tile(cell.positions[:, 2], len(at))
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        flat = flat @ turn.T
        own = ((flat / side >= -0.5 - BORDER) & (flat / side < 0.5 - BORDER)).all(axis=1)
        own[own] = number(flat[own] / side) == grain
        found.append(np.column_stack([flat[own] + side / 2, height[own]]))
    x = np.concatenate(found)
    box = np.array([side, side, a])
    near = cKDTree(np.mod(x, box), boxsize=box).query_pairs(
        NEAR * a / 2**0.5, output_type="ndarray"
    )
    kept = np.ones(len(x), bool)
    for i, j in near:
        if kept[i] and kept[j]:
            kept[max(i, j)] = False
    return ase.Atoms([NAME] * int(kept.sum()), positions=x[kept], cell=box, pbc=True)
