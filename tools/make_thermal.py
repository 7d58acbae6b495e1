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
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import joblib
import numpy as np
from tqdm import tqdm

from tools.elastic import elastic_constants, lame_constants
from tools.graphene import THICKNESS, area_per_atom
from tools.loads import Load, WaveLoad
from tools.make_graphene import (
    SPACINGS,
    load_record,
    mass_density,
    on_nodes,
    one_thread_each,
    short_warning,
    solve_all,
    versions,
)
from tools.options import Options
from tools.samples import Piece, Sample, file_hash
from tools.thermal import (
    REDUCTIONS,
    Bath,
    Plan,
    Task,
    ThermalRun,
    graphene_plans,
    noise,
    read_run,
    reduced,
    run,
    run_file,
)
from warp_peri import Dataset, InputError, Samples
from warp_peri.atoms.coarse_graining import EV_PER_CUBIC_ANGSTROM
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.points.dataset import save_dataset

LONGEST = 2
"""Loads with p₁² + p₂² up to this count as long waves."""


def long_wave_constants(
    body: Piece,
    reference: np.ndarray,
    loads: Sequence[Load],
    displacement: np.ndarray,
    force: np.ndarray,
) -> dict[str, float]:
    """λ and μ of the isotropic solid that answers the longest WaveLoads as the atoms do.

    A load B cos k₁x cos k₂y along x moves such a solid by u = (U cos cos, V sin sin) with
    ((λ+2μ) k₁² + μ k₂²) U − (λ+μ) k₁k₂ V = B and (μ k₁² + (λ+2μ) k₂²) V = (λ+μ) k₁k₂ U. U, V and B
    are least-squares amplitudes over the atoms; λ and μ solve all these equations, relative to B,
    in the least-squares sense.

    Args:
        body: a periodic sheet.
        reference: of the atoms [Å], shape [A, 2].
        loads: of the samples; one of the longest waves at least.
        displacement, force: of the atoms [Å] and [eV/Å], shape [S, A, 2].

    Returns:
        `lambda`, `mu`, `E` [TPa] for the thickness THICKNESS, and `nu`.

    Raises ValueError without a long wave or without a box.
    """
    if body.box is None:
        raise ValueError("body: expected a periodic sheet")
    density = force * (EV_PER_CUBIC_ANGSTROM / (area_per_atom(body.bond) * THICKNESS))
    rows, right = [], []
    for load, u, b in zip(loads, displacement, density):
        if not isinstance(load, WaveLoad) or np.square(load.waves).sum() > LONGEST:
            continue
        k = load.wave_vector(body.box)
        cos, sin = np.cos(k * reference).prod(axis=1), np.sin(k * reference).prod(axis=1)
        along, across = load.axis, 1 - load.axis
        B, U = b[:, along] @ cos / (cos @ cos), u[:, along] @ cos / (cos @ cos)
        V = u[:, across] @ sin / (sin @ sin) if k.all() else 0.0
        own, other, mixed = k[along] ** 2, k[across] ** 2, k.prod()
        rows.append([own * U - mixed * V, (2 * own + other) * U - mixed * V])
        right.append(B)
        rows[-1] = [entry / B for entry in rows[-1]]
        right[-1] = 1.0
        if k.all():
            second = [other * V - mixed * U, (own + 2 * other) * V - mixed * U]
            rows.append([entry / B for entry in second])
            right.append(0.0)
    if not rows:
        raise ValueError(f"loads: expected a WaveLoad with p₁² + p₂² ≤ {LONGEST}")
    lam, mu = np.linalg.lstsq(np.array(rows), np.array(right))[0]
    return lame_constants(float(lam), float(mu))


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
        jobs: number of processes, −1 for one per core.
        progress: show a bar on stderr, with the time left.

    Returns:
        The path of each reduction and factor.

    Raises InputError for values that make no sense, LammpsError naming load and seed, OSError when
    the disk is full.
    """
    bath = Bath() if bath is None else bath
    if jobs == 0 or jobs < -1:
        raise InputError(f"jobs: expected a number of processes ≥ 1, or −1, got {jobs}")
    if not factors or not all(np.isfinite(factor) and factor > 0 for factor in factors):
        raise InputError(f"factors: expected numbers > 0, got {list(factors)}")
    if not reductions or not set(reductions) <= set(REDUCTIONS):
        raise InputError(f"reduction: expected of {', '.join(REDUCTIONS)}, got {list(reductions)}")
    plans = graphene_plans() if plans is None else plans
    out = Path(out)
    cache = out / "graphene_0K.cache" if cache is None else Path(cache)
    cache.mkdir(parents=True, exist_ok=True)
    with locked(cache):
        at_rest, runs = run_all(plans, factors, bath, cache, jobs=jobs, progress=progress)
        truth = thermal_constants(plans, runs, at_rest, max(factors))
        paths = {}
        for factor in factors:
            for reduction in reductions:
                data = data_set(
                    plans, runs, at_rest, bath, reduction=reduction, factor=factor, fine=fine
                )
                data.provenance["truth"] = truth
                path = out / file_name(bath.temperature, reduction, factor)
                with locked(path):
                    save_dataset(path, data)
                paths[reduction, factor] = path
    return paths


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
    sets: dict[str, Samples] = {}
    snr = {}
    for plan in plans:
        body, rested = plan.body, at_rest[plan.body]
        reference = next(iter(rested.values())).reference
        for group, loads in plan.groups.items():
            fields = reduced(plan, group, runs, rested, reduction=reduction, factor=factor)
            force = factor * np.stack([rested[load].force for load in loads])
            for end, spacing in spacings.items():
                points = on_nodes(body, reference, fields.displacement, force, spacing=spacing)
                points.arrays.update(load_record(body, loads))
                points.arrays.update(snr=fields.snr, seed=fields.seed)
                points.arrays["amplitude"] = np.array([factor * rested[x].amplitude for x in loads])
                sets[group + end] = points
            snr[group] = float(fields.snr.mean())
        fluctuation = noise(plan, runs, reference, reduction=reduction, factor=factor)
        name = "noise" if body.cells else "noise_test"
        for end, spacing in spacings.items():
            sets[name + end] = on_nodes(
                body, reference, fluctuation, np.zeros_like(fluctuation), spacing=spacing
            )
    sheet, disk = (next(p.body for p in plans if bool(p.body.cells) == x) for x in (True, False))
    potential = Path(sheet.potential)
    provenance: dict[str, Any] = {
        "source": "tools/make_thermal.py",
        **asdict(bath),
        "reduction": reduction,
        "factor": factor,
        "snr": snr,
        "versions": versions(),
        "potential": {"file": potential.name, "sha256": file_hash(potential)},
        "bond_length": sheet.bond,
        "box": sheet.box,
        "disk_radius": disk.radius,
    }
    return Dataset(sets, THICKNESS, mass_density(sheet.bond), provenance)


def thermal_constants(
    plans: Sequence[Plan], runs: Mapping[Task, ThermalRun], at_rest: Equilibria, factor: float
) -> dict[str, float]:
    """λ, μ, E [TPa] and ν of the sheet at the temperature of the runs.

    The response of shared seeds to the longest waves. What that response departs from the
    potential's own constants at 0 K, where these are known, is taken off: waves are not endless
    and strains not endlessly small.
    """
    plan = next(plan for plan in plans if plan.body.cells)
    body, rested = plan.body, at_rest[plan.body]
    fields = reduced(plan, "train", runs, rested, reduction="shared", factor=factor)
    samples = [rested[load] for load in fields.loads]
    reference, force = samples[0].reference, np.stack([sample.force for sample in samples])
    cold = np.stack([sample.displacement for sample in samples])
    constants = long_wave_constants(
        body, reference, fields.loads, fields.displacement, factor * force
    )
    response = long_wave_constants(body, reference, fields.loads, cold, force)
    truth = elastic_constants(body.bond, potential=body.potential)
    return lame_constants(
        *(constants[key] + truth[key] - response[key] for key in ("lambda", "mu"))
    )


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
    runs = {task: read_run(file) for task, file in files.items()}

    def work(task: Task) -> float:
        return float(len(start(task).reference) * bath.steps)

    def start(task: Task) -> Sample:
        samples = at_rest[task.body]
        return next(iter(samples.values())) if task.load is None else samples[task.load]

    missing = [task for task, known in runs.items() if known is None]
    with tqdm(
        desc=f"{bath.temperature:g} K",
        total=sum(map(work, tasks)),
        initial=sum(map(work, tasks)) - sum(map(work, missing)),
        unit=" atom steps",
        unit_scale=True,
        mininterval=0.5,
        disable=not progress,
    ) as bar:
        bar.set_postfix_str(f"{len(tasks) - len(missing)}/{len(tasks)} runs")
        if missing:
            parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
            with one_thread_each():
                finished = parallel(
                    joblib.delayed(run)(task, start(task), bath, cache) for task in missing
                )
            for number, done in enumerate(finished, start=len(tasks) - len(missing) + 1):
                bar.set_postfix_str(f"{number}/{len(tasks)} runs", refresh=False)
                bar.update(done)
    result = {}
    for task, file in files.items():
        means = runs[task] or read_run(file)
        if means is None:
            raise OSError(f"{file}: a run just made cannot be read back")
        result[task] = means
    return at_rest, result


def argument_parser() -> Options:
    """Options of this tool."""
    parser = Options(__doc__)
    bath = Bath()
    parser.add("--out", type=Path, default=DATA, metavar="FOLDER", help="(default: data)")
    parser.add(
        "--reduction",
        choices=REDUCTIONS,
        action="append",
        help="may be given several times (default: all three, which cost no more)",
    )
    parser.add(
        "--factors",
        type=float,
        nargs="+",
        default=[1.0],
        metavar="F",
        help="on the loads, e.g. 1 0.25 0.1 (default: 1)",
    )
    parser.add("--temperature", type=float, default=bath.temperature, help="[K]")
    parser.add("--steps", type=int, default=bath.steps, help=f"of a run (default: {bath.steps})")
    parser.add(
        "--transient",
        type=int,
        default=bath.transient,
        help=f"steps that averages leave out (default: {bath.transient})",
    )
    parser.add("--iota", type=float, default=bath.iota, help=f"of (2.10) (default: {bath.iota})")
    parser.add("--fine", action="store_true", help="also on nodes 2.5 Å apart")
    parser.add("--jobs", type=int, default=-1, help="processes; -1 (default) is one for each core")
    parser.add("--cache", type=Path, metavar="FOLDER", help="finished runs (default: in --out)")
    parser.add("--quiet", action="store_true", help="no progress bar")
    return parser


def main(arguments: list[str] | None = None) -> int:
    parser = argument_parser()
    given = parser.parse_args(arguments)
    warnings.showwarning = short_warning

    def work() -> None:
        paths = make_thermal(
            given.out,
            bath=Bath(given.temperature, given.steps, given.transient, given.iota),
            factors=given.factors,
            reductions=given.reduction or REDUCTIONS,
            cache=given.cache,
            fine=given.fine,
            jobs=given.jobs,
            progress=not given.quiet,
        )
        for path in paths.values():
            print(path)

    # LammpsError and a killed worker are RuntimeErrors.
    kept = "finished runs are kept and the next call goes on"
    return exit_status(work, kept, name="make_thermal")


if __name__ == "__main__":
    sys.exit(main())
