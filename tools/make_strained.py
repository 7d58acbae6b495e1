"""The validation and test loads at larger strain, by continuation: a data set of its own."""

import hashlib
import json
import os
import re
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import joblib
import numpy as np
from tqdm import tqdm

from tools import make_graphene as base
from tools.elastic import cubic_constants, elastic_constants
from tools.graphene import THICKNESS, area_per_atom
from tools.loads import Load, atom_force
from tools.options import Options
from tools.samples import Piece, Sample, _statics, body_record, file_hash, read_sample, write_record
from tools.statics import TOLERANCE, AtomsAtRest, ConvergenceError, Statics
from warp_peri import Dataset, InputError, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.points.dataset import save_dataset

STRAINS = (0.04, 0.06)
"""Largest bond strain of the samples of each set."""
STRAIN_TOLERANCE = 1e-3
"""Relative; loads are found by the secant, one equilibrium each."""
FIRST, MOST_TRIES, LARGEST_CHANGE = 0.5, 25, 0.3
"""The first load is this share of what the linear response asks for; a step of the secant changes
it by at most so much, relative."""
SPACING = 5.0


def make_strained(
    path: str | os.PathLike[str],
    *,
    strains: Sequence[float] = STRAINS,
    jobs: int = -1,
    cache: str | os.PathLike[str] | None = None,
    progress: bool = True,
) -> Path:
    """Make sets `val_4`, `test_4`, … (percent of bond strain) on nodes 5 Å apart.

    Every load of the validation and test sets is scaled until the largest bond strain is what was
    asked for, from one strain to the next. Finished samples stay in the cache.

    Args:
        path: HDF5 file to write.
        strains: largest bond strains, growing.
        jobs: number of processes, −1 for one per core.
        cache: folder of finished samples; by default beside `path`, with the suffix .cache.
        progress: show a bar on stderr.

    Raises what make_graphene raises.
    """
    if list(strains) != sorted(set(strains)) or not strains or not strains[0] > 0:
        raise InputError(f"strains: expected numbers > 0 that grow, got {list(strains)}")
    path = Path(path)
    cache = path.with_suffix(".cache") if cache is None else Path(cache)
    with locked(path), locked(cache):
        cache.mkdir(parents=True, exist_ok=True)
        sheet, disk = base.graphene_bodies()
        groups: dict[str, tuple[Piece, Sequence[Load]]] = {
            "val": (sheet, base.VALIDATION),
            "test": (disk, base.TEST),
        }
        _solve_missing(groups.values(), strains, cache, jobs, progress)
        sets = {
            f"{name}_{100 * strain:g}".replace(".", "p"): _set(body, loads, strain, cache)
            for name, (body, loads) in groups.items()
            for strain in strains
        }
        potential = Path(sheet.potential)
        truth = elastic_constants(sheet.bond, potential=potential)
        provenance = {
            "source": "tools/make_strained.py",
            "temperature": 0.0,
            "versions": base.versions(),
            "potential": {"file": potential.name, "sha256": file_hash(potential)},
            "strains": list(strains),
            "truth": {**truth, **cubic_constants(sheet.bond, potential=potential)},
        }
        density = base.mass_density(sheet.bond)
        save_dataset(path, Dataset(sets, THICKNESS, density, provenance))
    return path


def strained(
    body: Piece, statics: Statics, load: Load, strain: float, before: Sample | None = None
) -> Sample:
    """Equilibrium under a load scaled until the largest bond strain is `strain`.

    Args:
        body: what carries the load.
        statics: of the body.
        load: its own amplitude does not matter.
        strain: above that of `before`.
        before: the same load at a smaller strain, to go on from.

    Raises ConvergenceError naming the load when there is no such equilibrium.
    """
    shape = load.shape(statics.reference, body.box)
    unit = atom_force(shape, area_per_atom(body.bond), THICKNESS)
    linear = statics.linear_response(unit)
    small = 1e-6 / np.abs(linear).max()
    slope = statics.max_bond_strain(small * linear) / small
    amplitude, reached, guess = 0.0, 0.0, np.zeros_like(linear)
    if before is None:
        change = FIRST * strain / slope
        guess = change * linear
    else:
        amplitude, reached, guess = before.amplitude, before.max_bond_strain, before.displacement
        slope = reached / amplitude
        change = (strain - reached) / slope
        change = float(np.clip(change, -LARGEST_CHANGE * amplitude, LARGEST_CHANGE * amplitude))
        guess = guess * (1 + change / amplitude)
    for _ in range(MOST_TRIES):
        trial = amplitude + change
        rest = statics.equilibrium(trial * unit, name=load.load_id, guess=guess)
        now = statics.max_bond_strain(rest.displacement)
        if abs(now / strain - 1) <= STRAIN_TOLERANCE:
            return _sample(statics, rest, trial, now)
        slope = (now - reached) / (trial - amplitude)
        amplitude, reached = trial, now
        most = LARGEST_CHANGE * amplitude
        change = float(np.clip((strain - now) / slope, -most, most))
        guess = rest.displacement * (1 + change / amplitude)
    raise ConvergenceError(
        f"load '{load.load_id}': bond strain {now:.6g} after {MOST_TRIES} loads, wanted {strain:g}"
    )


def strained_file(cache: Path, body: Piece, load: Load, strain: float) -> Path:
    """Where a sample lives: its name holds a hash of everything that determines it."""
    content = {
        **body_record(body),
        "load": repr(load),
        "strain": strain,
        "tolerances": [TOLERANCE, STRAIN_TOLERANCE],
    }
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:20]
    name = re.sub(r"[^a-z0-9]+", "-", load.load_id).strip("-")
    return cache / f"{name}-{100 * strain:g}-{key}.npz"


def solve_strained(
    body: Piece, loads: Sequence[Load], strains: Sequence[float], cache: Path
) -> int:
    """Solve what the cache lacks; how many samples the loads have in all."""
    statics = _statics(body)
    for load in loads:
        before: Sample | None = None
        for strain in strains:
            file = strained_file(cache, body, load, strain)
            equilibrium = read_sample(file)
            if equilibrium is None:
                equilibrium = strained(body, statics, load, strain, before)
                write_record(file, equilibrium)
            before = equilibrium
    return len(loads) * len(strains)


def _solve_missing(groups, strains: Sequence[float], cache: Path, jobs: int, progress: bool):
    tasks = []
    for body, loads in groups:
        missing = [
            load
            for load in loads
            if any(
                read_sample(strained_file(cache, body, load, strain)) is None for strain in strains
            )
        ]
        # A disk relaxes and factorises for longer than its loads take: they share one process.
        chunks = [[load] for load in missing] if body.cells else [missing] if missing else []
        tasks += [(body, chunk) for chunk in chunks]
    tasks.sort(key=lambda task: task[0].cells is not None)
    total = sum(len(chunk) * len(strains) for _, chunk in tasks)
    with tqdm(total=total, unit="sample", mininterval=0.5, disable=not progress) as bar:
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
        with base.one_thread_each():
            finished = parallel(
                joblib.delayed(solve_strained)(body, chunk, strains, cache) for body, chunk in tasks
            )
        for count in finished:
            bar.update(count)


def _sample(statics: Statics, rest: AtomsAtRest, amplitude: float, strain: float) -> Sample:
    return Sample(
        statics.reference, rest.displacement, rest.force, amplitude, strain, rest.residual
    )


def _set(body: Piece, loads: Sequence[Load], strain: float, cache: Path) -> Samples:
    equilibria = [read_sample(strained_file(cache, body, load, strain)) for load in loads]
    samples = [sample for sample in equilibria if sample is not None]
    if len(samples) < len(loads):
        raise OSError(f"{cache}: samples just made cannot be read back")
    return base.point_set(body, loads, samples, spacing=SPACING)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("--out", type=Path, default=Path("data/graphene_0K_strained.h5"), metavar="FILE")
    parser.add("--strains", type=float, nargs="+", default=STRAINS, help="largest bond strains")
    parser.add("--jobs", type=int, default=-1, help="processes; -1 (default) is one for each core")
    parser.add(
        "--cache", type=Path, metavar="FOLDER", help="finished samples (default: beside FILE)"
    )
    parser.add("--quiet", action="store_true", help="no progress bar")
    given = parser.parse_args(arguments)
    warnings.showwarning = base.short_warning

    def work() -> None:
        path = make_strained(
            given.out,
            strains=given.strains,
            jobs=given.jobs,
            cache=given.cache,
            progress=not given.quiet,
        )
        print(path)

    kept = "finished samples are kept and the next run goes on"
    return exit_status(work, kept, name="make_strained")


if __name__ == "__main__":
    sys.exit(main())
