"""An anisotropic hyperelastic sheet by finite elements: squares to learn from, disks to predict.

The second experiment of Jafarzadeh et al. 2024: a unit square, its edge held, under random body
forces, on 21 × 21 nodes; and disks cut from the same sheet.
"""

import os
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import count as numbers_from
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from tqdm import tqdm

from tools.cache import check_made, digest, in_parallel, kept
from tools.hyperelastic_elements import Elements, NotSolved, finite_elements, square_mesh
from tools.hyperelastic_energies import Energy, Family, hgo
from tools.options import JOBS, Folder, Options, fields_of
from warp_peri import Dataset, InputError, Points, Samples, save
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.points.arguments import REDUCED, Bound, Natural, NotNegative, Positive, typed

NODES = 21
"""Nodes a side of the square."""
SPACING = 0.05
HORIZON = 3
"""In spacings; interior nodes keep twice that from the nodes of the edge, which is the collar."""
SQUARES = {"square": 3, "square_4": 4, "square_5": 5}
"""Horizons of the squares in spacings; those with a wider collar have as many interior nodes."""
DISK_RADIUS = 0.5
MESHED_RADIUS = 0.95
"""Disks are cut from a larger one whose edge is held, so that they have a collar."""


def random_field(
    rng: np.random.Generator, amplitude: float, waves: int, side: float = 1.0, first: float = 0.0
) -> Callable[[np.ndarray], np.ndarray]:
    """Σ ξ (π²(k² + l²)/L² + τ²)^(−α/2) cos(π k x/L) cos(π l y/L), scaled to a root mean square.

    `rng`: of the normal ξ; `amplitude`: expected root mean square of each component; `waves`:
    largest k and l; `side`: L of the square; `first`: its lower corner, along both axes.
    Returns a function of points [..., 2].
    """
    n = np.arange(waves + 1)
    k, m = np.meshgrid(n, n, indexing="ij")
    spectrum = (np.pi**2 * (k**2 + m**2) / side**2 + 25.0) ** -1.25
    mean_square = np.where(k == 0, 1.0, 0.5) * np.where(m == 0, 1.0, 0.5)
    scale = amplitude / np.sqrt((spectrum**2 * mean_square).sum())
    factors = scale * spectrum * rng.standard_normal((2, *spectrum.shape))

    def field(x: np.ndarray) -> np.ndarray:
        along, up = (np.cos(np.pi * (x[..., a, None] - first) / side * n) for a in (0, 1))
        return np.einsum("...k,dkl,...l->...d", along, factors, up, optimize=True)

    return field


@typed
@dataclass(frozen=True)
class Material:
    """What the sheet is made of.

    `E`, `nu`, `k1`, `k2`: of the HGO energy; `angle`: of the fibre families, ± from the x axis
    [degree]; 90 is one family twice.
    """

    E: Positive = 0.3278
    nu: Annotated[float, Bound("a number between −1 and ½", lambda nu: -1 < nu < 0.5)] = 0.15
    k1: NotNegative = 0.1
    k2: NotNegative = 1.5
    angle: float = 90.0

    @property
    def energy(self) -> Energy:
        """Strain energy of the sheet's material."""
        angle = np.deg2rad(self.angle)
        return hgo(self.E, self.nu, [Family(s * angle, self.k1, self.k2) for s in (1, -1)])


def make_hgo(
    folder: str | os.PathLike[str],
    *,
    material: Material | None = None,
    counts: tuple[int, int, int, int] = (200, 25, 25, 10),
    seed: int = 1000,
    square: str = "square",
    jobs: int = -1,
    progress: bool = True,
) -> dict[str, Samples]:
    """Sets train, val and test on the square and disks; finished samples stay in the folder.

    Loads whose equilibrium is not found are left out and the next seed taken, so that the sets are
    the same however often the work was interrupted.

    Args:
        folder: of finished samples.
        material: of the sheet; that of the published data where none is given.
        counts: samples in train, val, test and disks.
        seed: of the first load; disks count from seed + 100 000.
        square: one of SQUARES; a larger one is held and loaded farther out, its loads smaller by
            its side, so that strains are alike.
        jobs: number of processes, −1 for one per core.
        progress: show a bar on stderr.

    Raises InputError for an unknown square, a missing scikit-fem, or another job in the folder.
    """
    if square not in SQUARES:
        raise InputError(f"square: expected one of {', '.join(SQUARES)}, got {square!r}")
    finite_elements()
    folder, how = Path(folder), (material or Material(), jobs, progress)
    with locked(folder):
        folder.mkdir(parents=True, exist_ok=True)
        u, b = solved(folder, square, sum(counts[:3]), seed, *how)
        disks = solved(folder, "disk", counts[3], seed + 100_000, *how)
    ends, points = np.cumsum(counts[:3])[:-1], square_points(square)
    parts = zip(("train", "val", "test"), np.split(u, ends), np.split(b, ends))
    sets = {name: Samples(points, moved, load) for name, moved, load in parts if len(moved)}
    return sets | ({"disks": Samples(disk_points(), *disks)} if counts[3] else {})


def side_of(square: str) -> int:
    """Nodes a side."""
    return NODES + 4 * (SQUARES[square] - HORIZON)


def square_points(square: str = "square") -> Points:
    """The nodes of the square, row by row along y."""
    side, collar = side_of(square), 2 * SQUARES[square]
    steps = np.argwhere(np.ones((side, side), bool))
    inner: np.ndarray = np.all((steps >= collar) & (steps < side - collar), axis=1)
    return Points(SPACING * steps, inner, SPACING, units=REDUCED)


def disk_points() -> Points:
    """The nodes of a disk of radius 0.5 and of its collar."""
    steps = np.argwhere(np.ones((41, 41))) - 20
    r = SPACING * np.hypot(*steps.T)
    near = r <= DISK_RADIUS + 2 * HORIZON * SPACING + 1e-9
    interior: np.ndarray = np.less_equal(r[near], DISK_RADIUS + 1e-9)
    return Points(SPACING * steps[near], interior, SPACING, units=REDUCED)


def solved(
    folder: Path, shape: str, count: int, seed: int, material: Material, jobs: int, progress: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The first `count` solvable samples: displacement and load, shapes [S, N, 2]."""
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    seeds, points = numbers_from(seed), disk_points() if shape == "disk" else square_points(shape)
    with tqdm(total=count, desc=f"{shape}s", disable=not progress, leave=False) as bar:
        for batch in [count, *20 * [max(2, count // 10)]]:
            tasks = [(folder, material, shape, number) for number in islice(seeds, batch)]
            for pair in in_parallel(jobs, sample, tasks):
                if pair is not None and len(pairs) < count:
                    pairs.append(pair)
                    bar.update()
            if len(pairs) == count:
                u, b = (np.reshape([p[n] for p in pairs], (-1, len(points.x), 2)) for n in (0, 1))
                return u, b
    raise InputError(f"{shape}s: too few equilibria; the loads are too large")


def sample(
    folder: Path, material: Material, shape: str, seed: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """One sample from the folder, or solved and put there; None where it has no equilibrium."""
    settings = {**asdict(material), "element": "linear", "shape": shape, "seed": seed, "version": 1}

    def solve() -> dict[str, np.ndarray]:
        try:
            return dict(zip("ub", solve_body(material, shape, seed)))
        except NotSolved:
            return dict.fromkeys("ub", np.empty((0, 2)))

    fields = kept(folder / f"{shape}_{digest(settings, 24)}.npz", solve)
    return (fields["u"], fields["b"]) if len(fields["u"]) else None


def solve_body(material: Material, shape: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and load on the nodes of a square, or of the disk and its collar."""
    rng, mesh = np.random.default_rng(seed), mesh_of(shape)
    if shape == "disk":
        points, steps = disk_points(), 2
        b = random_field(rng, rng.uniform(0.2, 0.8), 24, 2.0, -1.0)
    else:
        points, side, steps = square_points(shape), SPACING * (side_of(shape) - 1), 1
        b = random_field(rng, rng.uniform(0.2, 1.0) / side, round(12 * side), side)
    load = mesh.load(b, nodal=True)
    u = mesh.solve(material.energy, load, mesh.edge, np.zeros(len(mesh.edge)), steps=steps)
    return on_nodes(mesh, u, points.x), b(points.x)


@lru_cache
def mesh_of(shape: str) -> Elements:
    """Triangles on the nodes of a body, built once in a process."""
    if shape in SQUARES:
        mesh = square_mesh("MeshTri", side_of(shape) - 1, SPACING * (side_of(shape) - 1))
    else:
        mesh = square_mesh("MeshTri", 40, 2.0, -1.0)
        within = (np.linalg.norm(mesh.p[:, mesh.t], axis=0) <= MESHED_RADIUS + 1e-3).all(axis=0)
        mesh = mesh.restrict(np.flatnonzero(within))
    return Elements(mesh, finite_elements().ElementTriP1(), order=2)


def on_nodes(mesh: Elements, u: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The displacement at mesh nodes that lie on lattice nodes, shape [N, 2]."""
    where = {tuple(place): n for n, place in enumerate(np.rint(mesh.x * 1e6).astype(int).tolist())}
    nodes = [where[tuple(place)] for place in np.rint(x * 1e6).astype(int).tolist()]
    return u.reshape(-1, 2)[nodes]


def main() -> None:
    """Make the data from a shell."""
    how: dict[str, tuple[Any, ...]] = {
        "out": (Path("data/hgo"), "folder of samples; the data set is a file beside it", Folder),
        "counts": ([200, 25, 25, 10], "samples of train, val, test and disks", Natural),
        "seed": (1000, "of the first load", Natural),
        "jobs": JOBS,
        "overwrite": (False, "replace a file of other settings, too"),
    }
    sheet = fields_of(Material, "of the energy")
    given = vars(Options(__doc__, options=how | sheet).parse_args())
    material = Material(**{name: given[name] for name in sheet})
    if len(given["counts"]) != 4:
        raise InputError(f"counts: expected four numbers, got {given['counts']}")
    chosen = {name: given[name] for name in ("counts", "seed")}
    provenance, out = chosen | asdict(material), given["out"].resolve()
    if check_made(file := Path(f"{out}.h5"), provenance, overwrite=given["overwrite"]):
        print(f"{file} is there already")
        return
    sets = make_hgo(out, material=material, **chosen, jobs=given["jobs"])
    save(file, Dataset(sets, thickness=1.0, density=1000.0, provenance=provenance))
    for name, samples in sets.items():
        print(f"{name}: {len(samples)} samples on {len(samples.x)} nodes, in {file}")


if __name__ == "__main__":
    from tools import make_hgo as by_name  # under which processes find what they are to do

    sys.exit(exit_status(by_name.main))
