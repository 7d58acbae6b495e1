"""Graphene at 0 K by LAMMPS, coarse-grained: the data set of You et al. 2021, section 6.1."""

import dataclasses
import os
import platform
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from tqdm import tqdm

from tools.cache import check_made, in_parallel, read_record
from tools.elastic import elastic_constants
from tools.graphene import DISK_RADIUS, SHEET_CELLS, THICKNESS, area_per_atom, bond_length
from tools.lammps_session import CARBON_MASS, POTENTIAL
from tools.loads import DESIGNED, TEST, TRAINING, VALIDATION, Load, WaveLoad
from tools.options import JOBS, Folder, NewFile, Options
from tools.samples import Piece, Sample, cache_file, solve_samples
from tools.statics import TOLERANCE
from warp_peri import Dataset, Points, Samples
from warp_peri.atoms import coarse_grain, smoothing_matrix
from warp_peri.atoms.calculators import potential_file
from warp_peri.cli.main import hash_of
from warp_peri.cluster import scheduler
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.points.arguments import Positive
from warp_peri.points.dataset import save_dataset
from warp_peri.points.points import grid_points

LOADS: dict[str, Sequence[Load]] = {"designed": DESIGNED}
"""What the training set may be made of in place of TRAINING, by name."""
SPACINGS = {"": 5.0, "_fine": 2.5}
"""Node spacing [Å] by suffix of the set names."""

ZIGZAG = 0.0
"""Angle of the crystal's zigzag direction from the x axis [degrees]: cells are laid so."""
REACH = 100.0
"""Nodes lie within it of the origin [Å], along each axis on the sheet and by radius on the disk."""

INTERIOR = 50.0
SMOOTHING_RADIUS = 10.0
AMU_IN_KG = 1.66053906892e-27


def make_graphene(
    path: str | os.PathLike[str],
    *,
    jobs: int = -1,
    cache: str | os.PathLike[str] | None = None,
    smoothing_radius: float = SMOOTHING_RADIUS,
    training: Sequence[Load] | None = None,
    overwrite: bool = False,
    progress: bool = True,
) -> Path:
    """Make the data set: training and validation loads on a sheet, test loads on a disk.

    Sets `train`, `val`, `test` on nodes 5 Å apart and the same with `_fine` 2.5 Å apart. Finished
    samples stay in the cache, so that an interrupted run goes on where it was; the data set
    itself is written whole or not at all.

    Args:
        path: HDF5 file to write.
        jobs: number of processes, −1 for one per core; a joblib.parallel_config around the call
            chooses another backend.
        cache: folder of finished samples; by default beside `path`, with the suffix .cache.
        smoothing_radius: R of the coarse graining [Å].
        training: loads to learn from, on the sheet; TRAINING without.
        overwrite: replace a file of other settings, too.
        progress: show a bar on stderr.

    Returns:
        The path written.

    Raises InputError for jobs = 0 or below −1, for a file of other settings, and when another job
    writes to `path` or the cache, FileNotFoundError for a missing potential, LammpsError,
    ConvergenceError naming the load, OSError when the disk is full.
    """
    path, asked = Path(path), training or TRAINING
    cache = path.resolve().with_suffix(".cache") if cache is None else Path(cache)
    smoothing = {"shape": "cone", "radius": smoothing_radius, "normalisation": "infinite lattice"}
    loads = [repr(load) for load in training] if training else None
    settings = {"temperature": 0.0, "smoothing": smoothing, "training": loads}
    with locked(path), locked(cache):
        if check_made(path, settings, overwrite=overwrite):
            return path
        cache.mkdir(parents=True, exist_ok=True)
        sheet, disk = graphene_bodies()
        # The disk first: it is the longest piece of work.
        samples = solve_all({disk: TEST, sheet: [*asked, *VALIDATION]}, cache, jobs, progress)
        learned, count, radius = samples[sheet], len(asked), smoothing_radius
        groups = {
            "train": (sheet, asked, learned[:count]),
            "val": (sheet, VALIDATION, learned[count:]),
            "test": (disk, TEST, samples[disk]),
        }
        sets = {
            name + suffix: point_set(*group, spacing=spacing, radius=radius)
            for suffix, spacing in SPACINGS.items()
            for name, group in groups.items()
        }
        provenance = origin(sheet, disk, "tools/make_graphene.py") | {
            "atoms": {
                n: len(groups[k][2][0].reference) for n, k in (("sheet", "train"), ("disk", "test"))
            },
            "tolerance": TOLERANCE,
            "truth": elastic_constants(sheet.bond, potential=sheet.potential),
        }
        provenance |= {name: value for name, value in settings.items() if value is not None}
        if "wave_number" in sets["train"].arrays:
            change = shape_change(sets["train"], sheet, learned[:count], radius)
            provenance["u_change_cone_to_paraboloid"] = change
        save_dataset(path, Dataset(sets, THICKNESS, mass_density(sheet.bond), provenance))
    return path


def origin(sheet: Piece, disk: Piece, source: str) -> dict[str, Any]:
    """What is said of the bodies and of the programs that make a data set."""
    potential = Path(sheet.potential)
    numbers = {"python": platform.python_version()}
    for name in ("warp_peri", "lammps", "ase", "numpy", "scipy"):
        try:
            numbers[name] = version(name)
        except PackageNotFoundError:  # run from a checkout
            numbers[name] = "not installed"
    return {
        "source": source,
        "versions": numbers,
        "potential": {"file": potential.name, "sha256": hash_of(potential)},
        "bond_length": sheet.bond,
        "box": sheet.box,
        "disk_radius": disk.radius,
    }


def mass_density(bond: float) -> float:
    """Mass density of the sheet [kg/m³]."""
    return CARBON_MASS * AMU_IN_KG / (area_per_atom(bond) * THICKNESS * 1e-30)


def graphene_bodies() -> tuple[Piece, Piece]:
    """The periodic sheet and the free disk of the data set."""
    potential = potential_file(POTENTIAL)
    bond = bond_length(potential)
    sheet = Piece(bond, str(potential), cells=SHEET_CELLS)
    return sheet, Piece(bond, str(potential), radius=DISK_RADIUS)


def solve_all(
    work: Mapping[Piece, Sequence[Load]], cache: Path, jobs: int, progress: bool
) -> dict[Piece, list[Sample]]:
    """Every sample, from the cache or solved in parallel; lists in the order of the loads."""
    cached = {
        (body, load): read_record(cache_file(cache, body, load), Sample)
        for body, loads in work.items()
        for load in loads
    }
    tasks = []
    for body, loads in work.items():
        missing = [load for load in loads if cached[body, load] is None]
        # A disk relaxes and factorises for longer than its loads take: they share one process.
        chunks = [[load] for load in missing] if body.cells else [missing] if missing else []
        tasks += [(body, chunk, cache) for chunk in chunks]
    todo = sum(len(chunk) for _, chunk, _ in tasks)
    shown: dict[str, Any] = {"initial": len(cached) - todo, "unit": "sample", "mininterval": 0.5}
    with tqdm(total=len(cached), disable=not progress, **shown) as bar:
        for paths in in_parallel(jobs, solve_samples, tasks, ordered=False):
            bar.update(len(paths))
    result: dict[Piece, list[Sample]] = {}
    for body, loads in work.items():
        result[body] = []
        for load in loads:
            file = cache_file(cache, body, load)
            sample = cached[body, load] or read_record(file, Sample)
            if sample is None:
                raise OSError(f"{file}: a sample just made cannot be read back")
            result[body].append(sample)
    return result


def point_set(
    body: Piece, loads: Sequence[Load], samples: Sequence[Sample], *, spacing: float, **how: Any
) -> Samples:
    """Samples of one body, and their loads, smoothed to a lattice of nodes as on_nodes does."""
    fields = (np.stack([getattr(s, name) for s in samples]) for name in ("displacement", "force"))
    points = on_nodes(body, samples[0].reference, *fields, spacing=spacing, **how)
    record = load_record(body, loads)
    for name in ("amplitude", "max_bond_strain", "residual"):
        record[name] = np.array([getattr(sample, name) for sample in samples])
    return dataclasses.replace(points, arrays=record)


def on_nodes(
    body: Piece,
    reference: np.ndarray,
    displacement: np.ndarray,
    force: np.ndarray,
    *,
    spacing: float,
    shape: Literal["cone", "paraboloid"] = "cone",
    radius: float = SMOOTHING_RADIUS,
) -> Samples:
    """Fields on the atoms of one body, smoothed to a lattice of nodes.

    `body`: a sheet is evaluated through its periodic images; `reference`: of the atoms [Å], shape
    [A, 2]; `displacement`, `force`: of the atoms [Å] and [eV/Å], shape [S, A, 2]; `spacing`: of the
    nodes [Å]; `shape`: of the smoothing function, "cone" or "paraboloid"; `radius`: of the
    smoothing function [Å].
    """
    count = int(REACH / spacing)
    x = grid_points(spacing * np.arange(-count, count + 1), 2)
    if body.box is None:
        distance = np.linalg.norm(x, axis=1)
        x, interior = x[distance <= REACH], distance[distance <= REACH] < INTERIOR
    else:
        interior = (np.abs(x) <= INTERIOR).all(axis=1)
    omega = smoothing_matrix(
        reference, x, radius=radius, shape=shape, box=body.box, spacing=spacing
    )
    how = {"mass": CARBON_MASS, "node_area": spacing**2, "thickness": THICKNESS}
    u, b = coarse_grain(omega, displacement=displacement, force=force, **how)
    return Samples(Points(x, interior, spacing, axis=ZIGZAG), u, b)


def load_record(body: Piece, loads: Sequence[Load]) -> dict[str, np.ndarray]:
    """Per-sample arrays of a set that belong to its loads."""
    record = {"load_id": np.array([load.load_id for load in loads])}
    waves = [load.wave_vector(body.box) for load in loads if isinstance(load, WaveLoad)]
    if waves:
        record["wave_vector"] = np.array(waves)
        record["wave_number"] = np.linalg.norm(waves, axis=1)
    return record


def shape_change(
    cone: Samples, body: Piece, samples: Sequence[Sample], radius: float
) -> dict[str, float]:
    """Relative ℓ2 change of u on the interior when a paraboloid takes the place of the cone.

    The paraboloid is a little wider, so that the change grows as |k|²: the paper's 0.3 % is that
    of the longest waves.
    """
    other = point_set(
        body, TRAINING, samples, spacing=cone.spacing, shape="paraboloid", radius=radius
    )
    inside = cone.interior
    change = np.linalg.norm((other.u - cone.u)[:, inside], axis=(1, 2))
    change /= np.linalg.norm(cone.u[:, inside], axis=(1, 2))
    longest = int(np.argmin(cone.arrays["wave_number"]))
    return {
        "training_mean": float(change.mean()),
        "longest_wave": float(change[longest]),
        "largest": float(change.max()),
    }


OPTIONS: dict[str, tuple[Any, ...]] = {
    "out": (Path("data/graphene_0K.h5"), "file to write", NewFile),
    "jobs": JOBS,
    "scheduler": (str, "address of a Dask scheduler, whose workers do the work"),
    "cache": (Path, "folder of finished samples, beside the file by default", Folder),
    "smoothing_radius": (SMOOTHING_RADIUS, "R [Å]", Positive),
    "loads": (("waves", *LOADS), "to learn from: seventy waves, or two loads, each both ways"),
    "overwrite": (False, "replace a file of other settings, too"),
    "quiet": (False, "no progress bar"),
}


def main(arguments: list[str] | None = None) -> int:
    given = vars(Options(__doc__, options=OPTIONS).parse_args(arguments))
    warnings.showwarning = lambda said, *_, **__: print(f"warning: {said}", file=sys.stderr)

    def work() -> None:
        given["training"], given["progress"] = LOADS.get(given.pop("loads")), not given.pop("quiet")
        with scheduler(given.pop("scheduler")):
            print(make_graphene(given.pop("out"), **given))

    # LammpsError, ConvergenceError, a killed worker and some of h5py's are RuntimeErrors.
    kept = "finished samples are kept and the next run goes on"
    return exit_status(work, kept, name="make_graphene")


if __name__ == "__main__":
    sys.exit(main())
