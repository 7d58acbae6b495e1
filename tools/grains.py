"""Copper in columns along [1̄10], each grain turned by an angle of its own; linear at 0 K.

A column's atoms lie in two planes that mirror it, so that what is pushed along them stays in them:
a sheet two planes thick, its plane strain that of the solid. Turned by ±35.26° two grains are twins
where they share a layer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import ase
import ase.build
import numpy as np
from scipy.spatial import cKDTree

from tools.crystals import at_rest, force_constants, session
from tools.statics import ColouredHessian
from tools.uneven_sheets import patch, waves
from warp_peri import Points, Samples
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.statics.direct import symmetric_factors
from warp_peri.structures.noise import EV_IN_TPA
from warp_peri.structures.phonons import CONE, smoothing

NAME = "Cu"
AXES = np.array([[0, 0, 2**0.5], [1, 1, 0], [1, -1, 0]]) / 2**0.5
"""Of a grain that is not turned, in the crystal's: [001], [110] and that of the columns."""
PERIODS = {False: (34, 36, 40), True: (17, 18, 20)}
"""Steps along a twin boundary in a period, close-packed layers across half of it, a
multiple of three for the period to close, and nodes either way; half as wide or not."""
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

    `sets`: "waves" and "patch", displacement [Å] and load [TPa/Å] on nodes; `grain`: number of each
    node's own, [N]; `atoms`: of them at rest, [A, 3] [Å]; `stress`: of the period at rest, in its
    plane [TPa].
    """

    sets: dict[str, Samples]
    grain: np.ndarray
    atoms: np.ndarray
    stress: np.ndarray


def plane_constants() -> ForceConstants:
    """Of one crystal, for what is pushed across its columns and even along them."""
    solid = force_constants(NAME)
    own = solid.pairs[:, 0] == 0  # all atoms are alike
    a = float(solid.cell[0, 0])
    flat = AXES * np.array([[1.0], [1.0], [0.0]])
    return replace(
        solid,
        cell=np.diag([a, a / 8**0.5, 2 * a]),
        positions=np.zeros((1, 3)),
        species=solid.species[:1],
        pairs=0 * solid.pairs[own],
        vectors=solid.vectors[own] @ flat.T,
        values=flat @ solid.values[own] @ flat.T,
        thickness=a / 2**0.5,
    )


def columns(
    number: Callable[[np.ndarray], np.ndarray],
    degrees: Sequence[float],
    *,
    loads: int = 8,
    seed: int = 0,
    half: bool = False,
) -> Columns:
    """Atoms' linear answers seen from nodes.

    `number`: of the grain at positions over the box, [n, 2] from −½ to ½, [n]; `degrees`: by which
    each grain is turned; `loads`: of either set; `seed`: of the loads; `half`: a period half as
    wide.
    """
    rng = np.random.default_rng(seed)
    cell, _ = at_rest(NAME)
    a = float(cell.cell[0, 0])
    steps, layers, nodes = PERIODS[half]
    side = np.array([steps * 1.5**0.5, 2 * layers / 3**0.5]) * a
    thick = a / 2**0.5
    h = float(np.prod(side) ** 0.5) / nodes  # sides are one to 2e-3: nodes are taken as square
    atoms = _filled(cell, side, number, degrees)
    with session(NAME, atoms) as lammps:
        rest = lammps.relax(REST, STEPS)
        rest[:, 2] = (
            thick / 2 * np.rint(2 * rest[:, 2] / thick)
        )  # what rounding took off the mirrors
        lammps.forces(rest)
        stress = lammps.stress()[:2, :2]
        wide = rest.copy()

        def forces(x: np.ndarray) -> np.ndarray:
            wide[:, :2] = x
            return lammps.nearby_forces(wide)[:, :2]

        edges = np.array([*side, thick])
        near = cKDTree(np.mod(np.mod(rest, edges), edges), boxsize=edges)
        bonds = near.query_pairs(CUT, output_type="ndarray")
        H = ColouredHessian(bonds, len(rest))(forces, rest[:, :2])
    x = rest[:, :2] - side / 2
    box = (float(side[0]), float(side[1]))
    pushed = [waves(x, box, rng, SHORTEST * h) for _ in range(loads)]
    pushed += [patch(x, box, r * h, rng) for r in np.resize(PATCHES, loads)]
    pushed = [force - force.mean(axis=0) for force in pushed]
    factors = symmetric_factors(H[2:, 2:])
    moved = [np.append([0, 0], factors.solve(f.ravel()[2:])).reshape(-1, 2) for f in pushed]
    line = (np.arange(nodes) + 0.5) / nodes - 0.5
    at = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2) * side
    square = nodes * h / side
    smooth = smoothing((x + side / 2) * square, (at + side / 2) * square, CONE * h, nodes * h)
    density = np.asarray(smooth.sum(axis=1)).reshape(-1, 1)
    u = np.array([(smooth @ v) / density for v in moved])
    u -= u.mean(axis=1, keepdims=True)
    b = np.array([smooth @ f for f in pushed]) * (EV_IN_TPA / (h**2 * thick))
    points = Points.sheet((nodes, nodes), h)
    sets = {
        "waves": Samples(points, u[:loads], b[:loads]),
        "patch": Samples(points, u[loads:], b[loads:]),
    }
    return Columns(sets, number(at / side), rest, stress)


def _filled(
    cell: ase.Atoms,
    side: np.ndarray,
    number: Callable[[np.ndarray], np.ndarray],
    degrees: Sequence[float],
) -> ase.Atoms:
    """Each grain's own lattice where it is, without atoms that stand too near to another."""
    a, most = float(cell.cell[0, 0]), int(0.75 * side.max() / cell.cell[0, 0]) + 2
    line = np.arange(-most, most + 1)
    cells = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    x = (cells[:, None] * a + cell.positions).reshape(-1, 3) @ AXES.T
    thick = a / 2**0.5
    x = x[(x[:, 2] > -BORDER * a) & (x[:, 2] < thick - BORDER * a)]
    found = []
    for grain, angle in enumerate(np.deg2rad(degrees)):
        c, s = np.cos(angle), np.sin(angle)
        flat = x[:, :2] @ np.array([[c, s], [-s, c]])
        own = ((flat / side >= -0.5 - BORDER) & (flat / side < 0.5 - BORDER)).all(axis=1)
        own[own] = number(flat[own] / side) == grain
        found.append(np.column_stack([flat[own] + side / 2, x[own, 2]]))
    x = np.concatenate(found)
    box = np.array([*side, thick])
    tree = cKDTree(np.mod(np.mod(x, box), box), boxsize=box)
    near = tree.query_pairs(NEAR * a / 2**0.5, output_type="ndarray")
    kept = np.ones(len(x), bool)
    for i, j in near:
        if kept[i] and kept[j]:
            kept[max(i, j)] = False
    return ase.Atoms([NAME] * int(kept.sum()), positions=x[kept], cell=box, pbc=True)
