"""A leaflet in a biaxial test, by finite elements: displacement is seen, the load is not.

A thin incompressible sheet with two families of fibres is pulled by five tines a side, in seven
protocols, as valve leaflets are. What is kept is the displacement on a lattice in the middle, as
digital image correlation would give it, and the pull of two sides.
"""

import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import scipy.sparse as sp
from tqdm import tqdm

from tools.cache import digest, in_parallel, kept
from tools.hyperelastic_elements import Elements, square_mesh
from tools.hyperelastic_energies import Energy, Family, plane_stress_hgo
from tools.options import JOBS, Folder, Options, fields_of
from warp_peri import Points, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.points.arguments import REDUCED, Bound, NotNegative, Positive, typed
from warp_peri.points.points import grid_points

PROTOCOLS = ((1, 1), (1, 0.66), (1, 0.33), (0.66, 1), (0.33, 1), (0.05, 1), (1, 0.1))
"""Pull along x and y, as parts of the largest."""
LEARNED = (0, 2, 4)
"""Protocols to learn from; the others are held out."""
LEVELS = 4
NODES, SPACING, COLLAR = 33, 0.05, 6
SIDE, TINES_AT, TINE, SPRING, PULL = 1.7, 0.75, 0.05, 60.0, 0.45


@typed
@dataclass(frozen=True)
class Leaflet:
    """The sheet.

    `mu`: shear modulus of the matrix [kPa]; `k1`, `k2`: of both fibre families [kPa, −]; `first`,
    `second`: directions of the families [degree]; `uneven`: how much the thickness varies, see
    `thickness`; 0 for an even sheet.
    """

    mu: Positive = 10.0
    k1: NotNegative = 15.0
    k2: NotNegative = 2.0
    first: float = -25.0
    second: float = -65.0
    uneven: Annotated[float, Bound("a number from −10 to 10", lambda x: abs(x) <= 10)] = 0.0

    @property
    def energy(self) -> Energy:
        """Strain energy of the leaflet's material."""
        families = [Family(np.deg2rad(a), self.k1, self.k2) for a in (self.first, self.second)]
        return plane_stress_hgo(self.mu, families)

    def thickness(self, x: np.ndarray) -> np.ndarray:
        """Thickness at points of shape [..., 2], over that at the centre; no polynomial (H18)."""
        wave = np.sin(2 * x[..., 0]) + np.cos(3 * x[..., 1]) - 1 - x[..., 0] * x[..., 1]
        values: np.ndarray = np.exp(self.uneven * wave)
        return values


def make_leaflet(
    folder: str | os.PathLike[str],
    *,
    leaflet: Leaflet | None = None,
    levels: int = LEVELS,
    travel: float = PULL,
    jobs: int = -1,
    progress: bool = True,
) -> dict[str, Samples]:
    """Sets train and test of frames; protocols that are done stay in the folder.

    Each protocol has so many frames, up to the largest `travel` of the tines. Every set has the
    arrays protocol, level and force (pull along x and y [kPa × length]) by frame.
    The interior is 21 × 21 nodes; the six layers around it are the collar.
    """
    folder, every = Path(folder), range(len(PROTOCOLS))
    tasks = [(folder, leaflet or Leaflet(), n, levels, travel) for n in every]
    with locked(folder):
        folder.mkdir(parents=True, exist_ok=True)
        made = in_parallel(jobs, protocol, tasks)
        protocols = [*tqdm(made, "protocols", len(every), leave=False, disable=not progress)]
    steps = np.argwhere(np.ones((NODES, NODES), bool))
    inner: np.ndarray = np.all((steps >= COLLAR) & (steps < NODES - COLLAR), axis=1)
    points = Points(SPACING * (steps - NODES // 2), inner, SPACING, units=REDUCED)
    sets = {}
    for name, held in (("train", False), ("test", True)):
        chosen = [n for n in every if (n not in LEARNED) == held]
        arrays = {
            "protocol": np.repeat(chosen, levels),
            "level": np.tile(np.arange(1, levels + 1) / levels, len(chosen)),
            "force": np.concatenate([protocols[n][1] for n in chosen]),
        }
        u = np.concatenate([protocols[n][0] for n in chosen])
        sets[name] = Samples(points, u, arrays=arrays)
    return sets


def protocol(
    folder: Path, leaflet: Leaflet, number: int, levels: int = LEVELS, travel: float = PULL
) -> tuple[np.ndarray, np.ndarray]:
    """Frames and pulls of one protocol, from the folder or solved and put there."""
    settings = {**asdict(leaflet), "protocol": PROTOCOLS[number], "levels": levels, "version": 1}
    if travel != PULL:
        settings["pull"] = travel
    if not leaflet.uneven:
        del settings["uneven"]
    path = folder / f"protocol_{digest(settings, 24)}.npz"
    parts = PROTOCOLS[number]
    frames = kept(path, lambda: dict(zip(("u", "force"), pull(leaflet, parts, levels, travel))))
    return frames["u"], frames["force"]


def pull(
    leaflet: Leaflet, parts: tuple[float, float], levels: int = LEVELS, travel: float = PULL
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement on the lattice and pull of two sides at every level."""
    mesh = Elements(square_mesh("MeshQuad", 34, SIDE, -SIDE / 2))
    sides = [(axis, sign, tines(mesh, axis, sign)) for axis in (0, 1) for sign in (1, -1)]
    mesh.springs = sum((springs for _, _, springs in sides[1:]), sides[0][2]).tocsr()
    mesh.dx = mesh.dx * leaflet.thickness(mesh.quadrature)
    x = grid_points(SPACING * (np.arange(NODES) - NODES // 2), 2)
    u = np.zeros(2 * mesh.nodes)
    nothing = np.zeros(0, int)
    frames, pulls = [], []
    for level in range(1, levels + 1):
        targets = []
        for axis, sign, _ in sides:
            target = np.zeros(2 * mesh.nodes)
            target[axis::2] = sign * travel * parts[axis] * level / levels
            targets.append(target)
        load = sum(springs @ target for (_, _, springs), target in zip(sides, targets))
        u = mesh.solve(leaflet.energy, load, nothing, np.zeros(0), start=u, proportional=False)
        frames.append(mesh.sample(u, x))
        pulls.append([(sides[n][2] @ (targets[n] - u))[sides[n][0] :: 2].sum() for n in (0, 2)])
    return np.array(frames), np.array(pulls)


def tines(mesh: Elements, axis: int, sign: int) -> sp.csr_matrix:
    """The springs of five tines on one side, each a Gaussian patch, shape [2 N, 2 N]."""
    density = np.zeros(mesh.dx.shape)
    for place in np.linspace(-0.5, 0.5, 5):
        centre = np.array([sign * TINES_AT, place])[:: 1 if axis == 0 else -1]
        patch = np.exp(-((mesh.quadrature - centre) ** 2).sum(axis=-1) / (2 * TINE**2))
        density += SPRING * patch / (patch * mesh.dx).sum()
    local = np.einsum("eqa,eqb,eq->eab", mesh.N, mesh.N, mesh.dx * density, optimize=True)
    width = mesh.cells.shape[1]
    rows = np.repeat(mesh.cells, width, axis=1).ravel()
    columns = np.tile(mesh.cells, (1, width)).ravel()
    scalar = sp.coo_matrix((local.ravel(), (rows, columns)), shape=2 * [mesh.nodes])
    return sp.kron(scalar, sp.eye(2)).tocsr()


def main() -> None:
    """Make the frames from a shell."""
    how = {"out": (Path("data/leaflet"), "folder of protocols", Folder), "jobs": JOBS}
    sheet = fields_of(Leaflet, "of the leaflet")
    given = Options(__doc__, options=how | sheet).parse_args()
    leaflet = Leaflet(**{name: getattr(given, name) for name in sheet})
    for name, frames in make_leaflet(given.out, leaflet=leaflet, jobs=given.jobs).items():
        print(f"{name}: {len(frames)} frames on {len(frames.x)} nodes")


if __name__ == "__main__":
    sys.exit(exit_status(main))
