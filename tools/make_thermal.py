"""Graphene at a finite temperature by LAMMPS, reduced three ways: You et al. 2021, 2.10 and 6.3.

Each loaded run has an unloaded partner of the same seed. From the same runs come

  shared   loaded minus its partner: the noise that both have in common is gone
  plain    average after a transient
  iota     smoothing in time as printed, (2.10)

and a data set each, for every factor on the loads. Finished runs are kept; a second call goes on.
"""

import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from tqdm import tqdm

from tools.cache import check_made, in_parallel, read_record
from tools.graphene import THICKNESS
from tools.loads import Load
from tools.make_graphene import SPACINGS, load_record, mass_density, on_nodes, origin, solve_all
from tools.options import JOBS, Folder, Options, one_of
from tools.samples import Piece, Sample
from tools.thermal import (
    REDUCTIONS,
    Bath,
    Iota,
    Plan,
    Task,
    ThermalRun,
    graphene_plans,
    noise,
    reduced,
    run,
    run_file,
)
from warp_peri import Dataset, InputError, Samples
from warp_peri.cli.main import hash_of
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.points.arguments import Count, Natural, Positive
from warp_peri.points.dataset import save_dataset

DATA = Path("data")

Equilibria = Mapping[Piece, Mapping[Load, Sample]]


def make_thermal(
    out: str | os.PathLike[str] = DATA,
    *,
    bath: Bath | None = None,
    factors: Sequence[float] = (1.0,),
    reductions: Sequence[str] = REDUCTIONS,
    plans: Sequence[Plan] | None = None,
    cache: str | os.PathLike[str] | None = None,
    fine: bool = False,
    overwrite: bool = False,
    jobs: int = -1,
    progress: bool = True,
) -> dict[tuple[str, float], Path]:
    """Make the data sets, one for each reduction and factor on the loads.

    Sets `train` and `val` on the sheet and `test` on the disk, and beside them `noise` and
    `noise_test`: fields of the reduction's noise alone, without load. A file is written whole or
    not at all.

    Args:
        out: folder for the files.
        bath: temperature and steps; 300 K by default.
        factors: on the loads of the 0 K data.
        reductions: of `shared`, `plain`, `iota`.
        plans: bodies, loads and seeds; all of the paper's by default.
        cache: folder of finished runs, and of the samples at 0 K that they start from; by default
            graphene_0K.cache in `out`.
        fine: every set a second time, named with `_fine`, on nodes 2.5 Å apart.
        overwrite: replace files of other settings, too.
        jobs: number of processes, −1 for one per core.
        progress: show a bar on stderr, with the time left.

    Returns:
        The path of each reduction and factor.

    Raises InputError for values that make no sense and files of other settings, LammpsError naming
    load and seed, OSError when the disk is full.
    """
    bath = Bath() if bath is None else bath
    if not factors or not all(np.isfinite(factor) and factor > 0 for factor in factors):
        raise InputError(f"factors: expected numbers > 0, got {list(factors)}")
    if not reductions or not set(reductions) <= set(REDUCTIONS):
        raise InputError(f"reduction: expected of {', '.join(REDUCTIONS)}, got {list(reductions)}")
    given, plans = plans, graphene_plans() if plans is None else plans
    out, paths = Path(out), dict[tuple[str, float], Path]()
    for reduction, factor in product(reductions, factors):
        path = out / file_name(bath.temperature, reduction, factor)
        if path in paths.values() and (reduction, factor) not in paths:
            raise InputError(f"factors: expected such as differ in six digits, got {list(factors)}")
        check_made(path, settings(bath, reduction, factor, fine, given), overwrite=overwrite)
        paths[reduction, factor] = path
    cache = out / "graphene_0K.cache" if cache is None else Path(cache)
    cache.mkdir(parents=True, exist_ok=True)
    with locked(cache):
        at_rest, runs = run_all(plans, factors, bath, cache, jobs=jobs, progress=progress)
        for (reduction, factor), path in paths.items():
            how: dict[str, Any] = {"reduction": reduction, "factor": factor, "fine": fine}
            data = data_set(plans, runs, at_rest, bath, **how)
            data.provenance.update(said := settings(bath, **how, plans=given))
            with locked(path):  # which another job may have made meanwhile
                if not check_made(path, said, overwrite=overwrite):
                    save_dataset(path, data)
    return paths


def settings(
    bath: Bath, reduction: str, factor: float, fine: bool, plans: Sequence[Plan] | None = None
) -> dict[str, Any]:
    """What a data set's provenance says of how it was made; `plans`: other than the paper's."""
    runs = (
        None
        if plans is None
        else [
            f"{hash_of(Path(body.potential))} {body.bond:.9g} {body.cells} {body.radius} {told}"
            for body, *told in (vars(plan).values() for plan in plans)
        ]
    )
    how = {"reduction": reduction, "factor": factor, "fine": fine or None, "plans": runs}
    return asdict(bath) | how


def file_name(temperature: float, reduction: str, factor: float) -> str:
    """The file of one data set, e.g. graphene_300K_shared_f0.1.h5."""
    return f"graphene_{temperature:g}K_{reduction}_f{factor:g}.h5"


def data_set(
    plans: Sequence[Plan],
    runs: Mapping[Task, ThermalRun],
    at_rest: Equilibria,
    bath: Bath,
    *,
    reduction: str,
    factor: float,
    fine: bool = False,
) -> Dataset:
    """One reduction of the runs for one factor, on nodes."""
    spacings = {end: h for end, h in SPACINGS.items() if fine or not end}
    how: dict[str, Any] = {"reduction": reduction, "factor": factor}
    sets: dict[str, Samples] = {}
    snr = {}
    for plan in plans:
        body, rested = plan.body, at_rest[plan.body]
        reference = next(iter(rested.values())).reference
        for group, loads in plan.groups.items():
            u, ratio, seed = reduced(plan, group, runs, reference, **how)
            force = factor * np.stack([rested[load].force for load in loads])
            for end, spacing in spacings.items():
                points = on_nodes(body, reference, u, force, spacing=spacing)
                points.arrays.update(load_record(body, loads), snr=ratio, seed=seed)
                points.arrays["amplitude"] = np.array([factor * rested[x].amplitude for x in loads])
                sets[group + end] = points
            snr[group] = float(ratio.mean())
        fluctuation = noise(plan, runs, reference, **how)
        name = "noise" if body.cells else "noise_test"
        for end, spacing in spacings.items():
            sets[name + end] = on_nodes(
                body, reference, fluctuation, np.zeros_like(fluctuation), spacing=spacing
            )
    sheet, disk = (next(p.body for p in plans if bool(p.body.cells) == x) for x in (True, False))
    said = settings(bath, reduction, factor, fine) | {"snr": snr}
    provenance = origin(sheet, disk, "tools/make_thermal.py") | said
    return Dataset(sets, THICKNESS, mass_density(sheet.bond), provenance)


def run_all(
    plans: Sequence[Plan],
    factors: Sequence[float],
    bath: Bath,
    cache: Path,
    *,
    jobs: int,
    progress: bool,
) -> tuple[Equilibria, dict[Task, ThermalRun]]:
    """Every run of the plans, from the cache or made in parallel, and the samples at rest."""
    wanted = {
        plan.body: [load for loads in plan.groups.values() for load in loads] for plan in plans
    }
    solved = solve_all(wanted, cache, jobs, progress)
    at_rest = {body: dict(zip(loads, solved[body])) for body, loads in wanted.items()}
    tasks = [task for plan in plans for task in plan.tasks(factors)]
    files = {task: run_file(cache, task, bath) for task in tasks}
    runs = {task: read_record(file, ThermalRun) for task, file in files.items()}

    def work(task: Task) -> float:
        return float(len(start(task).reference) * bath.steps)

    def start(task: Task) -> Sample:
        samples = at_rest[task.body]
        return next(iter(samples.values())) if task.load is None else samples[task.load]

    missing = [task for task, known in runs.items() if known is None]
    total, todo = (sum(map(work, some)) for some in (tasks, missing))
    shown: dict[str, Any] = {"unit": " atom steps", "unit_scale": True, "mininterval": 0.5}
    shown |= {"desc": f"{bath.temperature:g} K", "initial": total - todo}
    with tqdm(total=total, disable=not progress, **shown) as bar:
        starts = [(task, start(task), bath, cache) for task in missing]
        for done in in_parallel(jobs, run, starts, ordered=False):
            bar.update(done)
    result = {}
    for task, file in files.items():
        means = runs[task] or read_record(file, ThermalRun)
        if means is None:
            raise OSError(f"{file}: a run just made cannot be read back")
        result[task] = means
    return at_rest, result


OPTIONS: dict[str, tuple[Any, ...]] = {
    "out": (DATA, "folder for the files", Folder),
    "reduction": (
        [*REDUCTIONS], "of shared, plain, iota; all cost no more than one", one_of(REDUCTIONS)
    ),
    "factors": ([1.0], "on the loads, e.g. 1 0.25 0.1", Positive),
    "temperature": (Bath.temperature, "[K]", Positive),
    "steps": (Bath.steps, "of a run", Count),
    "transient": (Bath.transient, "steps that averages leave out", Natural),
    "iota": (Bath.iota, "of (2.10)", Iota),
    "fine": (False, "also on nodes 2.5 Å apart"),
    "jobs": JOBS,
    "cache": (Path, "folder of finished runs, in --out by default", Folder),
    "overwrite": (False, "replace files of other settings, too"),
    "quiet": (False, "no progress bar"),
}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    given = vars(Options(__doc__, options=OPTIONS).parse_args(arguments))
    warnings.showwarning = lambda said, *_, **__: print(f"warning: {said}", file=sys.stderr)

    def work() -> None:
        bath = {name: given.pop(name) for name in ("temperature", "steps", "transient", "iota")}
        given["reductions"], given["progress"] = given.pop("reduction"), not given.pop("quiet")
        print(*make_thermal(bath=Bath(**bath), **given).values(), sep="\n")

    # LammpsError and a killed worker are RuntimeErrors.
    kept = "finished runs are kept and the next call goes on"
    return exit_status(work, kept, name="make_thermal")


if __name__ == "__main__":
    sys.exit(main())
