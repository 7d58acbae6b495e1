"""An anisotropic hyperelastic sheet by finite elements: squares to learn from, disks to predict.

The second experiment of Jafarzadeh et al. 2024: a unit square, its edge held, under random body
forces, on 21 × 21 nodes; and disks cut from the same sheet.
"""

import hashlib
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import joblib
import numpy as np
from tqdm import tqdm

from tools.hyperelastic_elements import Elements, NotSolved, finite_elements, triangles
from tools.hyperelastic_energies import Family, Matrix, hgo
from tools.options import Options
from warp_peri import Dataset, InputError, Points, Samples, save
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked, read_arrays, whole_file
from warp_peri.points.unit_names import REDUCED


class RandomField:
    """Σ ξ (π²(k² + l²)/L² + τ²)^(−α/2) cos(π k x/L) cos(π l y/L), scaled to a root mean square.

    `rng`: of the normal ξ; `amplitude`: expected root mean square of each component; `waves`:
    largest k and l; `side`: L of the square; `first`: its lower corner, along both axes.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        amplitude: float,
        *,
        waves: int = 12,
        side: float = 1.0,
        first: float = 0.0,
    ) -> None:
        self.k, self.side, self.first = np.arange(waves + 1), side, first
        k, m = np.meshgrid(self.k, self.k, indexing="ij")
        spectrum = (np.pi**2 * (k**2 + m**2) / side**2 + 25.0) ** -1.25
        mean_square = np.where(k == 0, 1.0, 0.5) * np.where(m == 0, 1.0, 0.5)
        scale = amplitude / np.sqrt((spectrum**2 * mean_square).sum())
        self.numbers = scale * spectrum * rng.standard_normal((2, *spectrum.shape))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The field at points of shape [..., 2]."""
        along, up = (
            np.cos(np.pi * (x[..., n, None] - self.first) / self.side * self.k) for n in (0, 1)
        )
        return np.einsum("...k,dkl,...l->...d", along, self.numbers, up, optimize=True)


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


@dataclass(frozen=True)
class Material:
    """What the sheet is made of.

    `E`, `nu`, `k1`, `k2`: of the HGO energy; `angle`: of the fibre families, ± from the x axis
    [degree]; 90 is one family twice.
    """

    E: float = 0.3278
    nu: float = 0.15
    k1: float = 0.1
    k2: float = 1.5
    angle: float = 90.0

    @property
    def energy(self) -> Matrix:
        """Strain energy of the sheet's material."""
        angle = np.deg2rad(self.angle)
        families = [Family(sign * angle, self.k1, self.k2) for sign in (1, -1)]
        return hgo(self.E, self.nu, families)


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

    Raises InputError for an unknown square, a missing scikit-fem, or another job in the
    folder.
    """
    if square not in SQUARES:
        raise InputError(f"square: expected one of {', '.join(SQUARES)}, got {square!r}")
    finite_elements()
    material = Material() if material is None else material
    folder = Path(folder)
    with locked(folder):
        folder.mkdir(parents=True, exist_ok=True)
        made = solved(folder, material, square, sum(counts[:3]), seed, jobs, progress)
        disk = solved(folder, material, "disk", counts[3], seed + 100_000, jobs, progress)
    ends = np.cumsum(counts[:3])[:-1]
    points = square_points(square)
    sets = {
        name: Samples(points, u, b)
        for name, u, b in zip(
            ("train", "val", "test"), np.split(made[0], ends), np.split(made[1], ends)
        )
        if len(u)
    }
    if counts[3]:
        sets["disks"] = Samples(disk_points(), *disk)
    return sets


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
    side = np.arange(-20, 21)
    steps = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    r = SPACING * np.hypot(*steps.T)
    kept = r <= DISK_RADIUS + 2 * HORIZON * SPACING + 1e-9
    interior: np.ndarray = np.less_equal(r[kept], DISK_RADIUS + 1e-9)
    return Points(SPACING * steps[kept], interior, SPACING, units=REDUCED)


def solved(
    folder: Path, material: Material, shape: str, count: int, seed: int, jobs: int, progress: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The first `count` solvable samples: displacement and load, shapes [S, N, 2]."""
    u: list[np.ndarray] = []
    b: list[np.ndarray] = []
    label = f"{shape}s"
    with (
        tqdm(total=count, desc=label, disable=not progress, leave=False) as bar,
        joblib.Parallel(n_jobs=jobs, return_as="generator") as parallel,
    ):
        for batch in batches(count, seed):
            work = (joblib.delayed(sample)(folder, material, shape, number) for number in batch)
            for pair in parallel(work):
                if pair is not None and len(u) < count:
                    u.append(pair[0])
                    b.append(pair[1])
                    bar.update()
            if len(u) == count:
                break
        else:
            raise InputError(f"{label}: too few equilibria; the loads are too large")
    nodes = len((disk_points() if shape == "disk" else square_points(shape)).x)
    return np.reshape(u, (-1, nodes, 2)), np.reshape(b, (-1, nodes, 2))


def batches(count: int, seed: int) -> Iterator[range]:
    """As many seeds as samples are wanted, then few more at a time."""
    yield range(seed, seed + count)
    last = seed + count
    for _ in range(20):
        step = max(2, count // 10)
        yield range(last, last + step)
        last += step


def sample(
    folder: Path, material: Material, shape: str, seed: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """One sample from the folder, or solved and put there; None where it has no equilibrium."""
    settings = {**asdict(material), "element": "linear", "shape": shape, "seed": seed, "version": 1}
    key = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:24]
    path = folder / f"{shape}_{key}.npz"
    if path.exists():
        try:
            arrays = read_arrays(path)
            return (arrays["u"], arrays["b"]) if len(arrays["u"]) else None
        except (KeyError, ValueError):
            pass  # damaged: solved again
    try:
        u, b = solve_body(material, shape, seed)
    except NotSolved:
        u, b = np.empty((0, 2)), np.empty((0, 2))
    with whole_file(path) as temporary:
        np.savez(temporary, u=u, b=b)
    return (u, b) if len(u) else None


def solve_body(material: Material, shape: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and load on the nodes of a square, or of the disk and its collar."""
    rng, mesh = np.random.default_rng(seed), mesh_of(shape)
    if shape == "disk":
        points = disk_points()
        b = RandomField(rng, rng.uniform(0.2, 0.8), waves=24, side=2.0, first=-1.0)
    else:
        points, side = square_points(shape), SPACING * (side_of(shape) - 1)
        b = RandomField(rng, rng.uniform(0.2, 1.0) / side, waves=round(12 * side), side=side)
    load, steps = mesh.load(b, nodal=True), 2 if shape == "disk" else 1
    u = mesh.solve(material.energy, load, mesh.edge, np.zeros(len(mesh.edge)), steps=steps)
    return on_nodes(mesh, u, points.x), b(points.x)


@lru_cache
def mesh_of(shape: str) -> Elements:
    """Triangles on the nodes of a body, built once in a process."""
    if shape in SQUARES:
        mesh = triangles(side_of(shape) - 1, SPACING * (side_of(shape) - 1))
    else:
        mesh = triangles(40, 2.0, -1.0)
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
    parser = Options(__doc__)
    parser.add("--out", type=Path, default=Path("data/hgo"), help="folder of samples")
    parser.add("--counts", type=int, nargs=4, default=(200, 25, 25, 10))
    parser.add("--seed", type=int, default=1000)
    parser.add("--jobs", type=int, default=-1)
    for name, value in asdict(Material()).items():
        parser.add(f"--{name}", type=float, default=value)
    given = parser.parse_args()
    material = Material(**{name: getattr(given, name) for name in asdict(Material())})
    how = {name: getattr(given, name) for name in ("counts", "seed", "jobs")}
    sets, file = make_hgo(given.out, material=material, **how), given.out.with_suffix(".h5")
    made = vars(given) | {"out": given.out.name}
    save(file, Dataset(sets, thickness=1.0, density=1000.0, provenance=made))
    for name, samples in sets.items():
        print(f"{name}: {len(samples)} samples on {len(samples.x)} nodes, in {file}")


if __name__ == "__main__":
    sys.exit(exit_status(main))
