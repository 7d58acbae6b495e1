"""Runs at finite temperature: Langevin dynamics of one body under one load, kept in a cache.

A run keeps what every reduction needs: the displacement smoothed in time (You et al. 2021, 2.10)
and its plain average after a transient. Runs of one seed see the same random forces, so the
difference of a loaded and an unloaded one has far less noise than either.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from tools.cache import digest, write_arrays
from tools.lammps_session import LammpsSession
from tools.loads import TEST, TRAINING, VALIDATION, Load
from tools.make_graphene import graphene_bodies
from tools.samples import Piece, Sample, body_record, cache_file
from tools.statics import settled
from warp_peri import InputError
from warp_peri.atoms.calculators import LammpsError
from warp_peri.points.arguments import Bound, Count, Natural, Positive, typed
from warp_peri.points.points import nearest

CACHE_VERSION = 1


Iota = Annotated[float, Bound("a number above 0, at most 1", lambda value: 0 < value <= 1)]


@typed
@dataclass(frozen=True)
class Bath:
    """A heat bath and how long the atoms stay in it.

    `temperature`: [K]; `steps`: of a run; `transient`: steps at its begin that the plain average
    leaves out; `iota`: ι of the smoothing in time; `timestep`, `damping`: of the Langevin dynamics
    [ps]. The paper's text says 5.0 fs, with which atoms are lost, and 5.0E-16 s, which is taken.
    """

    temperature: Positive = 300.0
    steps: Count = 4000
    transient: Natural = 1200
    iota: Iota = 0.01
    timestep: Positive = 0.0005
    damping: Positive = 0.1

    def __post_init__(self) -> None:
        if not self.transient < self.steps:
            raise InputError(
                f"steps: expected more than the transient of {self.transient}, got {self.steps}"
            )


@dataclass(frozen=True)
class Task:
    """One run: a body, its load times a factor or None, and a seed."""

    body: Piece
    load: Load | None
    factor: float
    seed: int


@dataclass(frozen=True)
class ThermalRun:
    """What is kept of a run.

    `average`: mean displacement from the reference after the transient [Å], shape [A, 2];
    `smoothed`: displacement at the end, smoothed in time by (2.10) [Å], shape [A, 2]; `snr`:
    √(Σ|B|²/Σ|B + F|²), sums over atoms, and over steps after the transient.
    """

    average: np.ndarray
    smoothed: np.ndarray
    snr: float


def run_file(cache: str | os.PathLike[str], task: Task, bath: Bath) -> Path:
    """Where a run lives: its name holds a hash of everything that determines it."""
    at_rest = None if task.load is None else cache_file(cache, task.body, task.load).stem
    content = {
        "version": CACHE_VERSION,
        "begin": at_rest or body_record(task.body),
        "factor": task.factor,
        "seed": task.seed,
        "bath": asdict(bath),
    }
    name = "unloaded" if at_rest is None else at_rest.rsplit("-", 1)[0]
    return Path(cache) / f"{name}-s{task.seed}-{digest(content)}.npz"


def run(task: Task, at_rest: Sample, bath: Bath, cache: str | os.PathLike[str]) -> float:
    """Make a run and leave it in the cache.

    Args:
        task: what to run.
        at_rest: the body at rest at 0 K under the same load, factor 1, or under any load when the
            task has none. A run begins at its displacement times the factor.
        bath: temperature and steps.
        cache: folder.

    Returns:
        atoms times steps, the work done.

    Raises LammpsError naming the load, OSError when the cache cannot be written.
    """
    body, box, reference = task.body, task.body.box, at_rest.reference
    factor = 0.0 if task.load is None else task.factor
    force = factor * at_rest.force
    average, smoothed = np.zeros_like(reference), np.zeros_like(reference)
    total = 0.0
    with LammpsSession(reference, box=box, potential=body.potential) as session:
        steps = session.trajectory(
            reference + factor * at_rest.displacement,
            force,
            temperature=bath.temperature,
            seed=task.seed,
            steps=bath.steps,
            timestep=bath.timestep,
            damping=bath.damping,
        )
        try:
            for step, (x, inner) in enumerate(steps):
                u = nearest(x - reference, box)
                smoothed *= 1 - bath.iota
                smoothed += bath.iota * u
                if step >= bath.transient:
                    average += u
                    total += float(((force + inner) ** 2).sum())
        except LammpsError as error:
            name = "no load" if task.load is None else f"load '{task.load.load_id}'"
            raise LammpsError(f"{name}, seed {task.seed}: {error}") from None
    kept = bath.steps - bath.transient
    snr = float(np.sqrt(kept * (force**2).sum() / total))
    found = {"average": average / kept, "smoothed": smoothed, "snr": snr}
    write_arrays(run_file(cache, task, bath), found)
    return float(len(reference) * bath.steps)


@dataclass(frozen=True)
class Plan:
    """Runs of one body.

    A load runs with one of the seeds 1 … `seeds`, in turn. Unloaded runs exist for these and for
    `spare` more seeds, whose noise no loaded run shares. Every `repeat`-th load runs a second time
    with the next seed: the difference is the noise of the shared-seed reduction.

    `body`: what runs; `groups`: loads by set name; `seeds`, `spare`: numbers of seeds; two at
    least, one at least; `repeat`: how far apart the repeated loads are.
    """

    body: Piece
    groups: dict[str, Sequence[Load]]
    seeds: int
    spare: int
    repeat: int

    def seed(self, number: int) -> int:
        """Seed of the load of this number in its group."""
        return 1 + number % self.seeds

    def repeated(self, group: str) -> dict[int, int]:
        """Second seeds by the numbers of the loads that run again."""
        return {n: self.seed(n + 1) for n in range(0, len(self.groups[group]), self.repeat)}

    def unloaded(self, seed: int) -> Task:
        """The run without load."""
        return Task(self.body, None, 0.0, seed)

    def every_seed(self) -> range:
        """Seeds of the unloaded runs; those after `seeds` are of no other runs."""
        return range(1, self.seeds + self.spare + 1)

    def tasks(self, factors: Sequence[float]) -> list[Task]:
        """Every run, for every factor on the loads."""
        tasks = [self.unloaded(seed) for seed in self.every_seed()]
        for factor in factors:
            for group, loads in self.groups.items():
                for number, load in enumerate(loads):
                    tasks.append(Task(self.body, load, factor, self.seed(number)))
                for number, seed in self.repeated(group).items():
                    tasks.append(Task(self.body, loads[number], factor, seed))
        return tasks


def graphene_plans() -> list[Plan]:
    """The sheet with training and validation loads, and the disk."""
    sheet, disk = graphene_bodies()
    return [
        # The disk first: its runs are the longest.
        Plan(disk, {"test": TEST}, seeds=4, spare=4, repeat=4),
        Plan(sheet, {"train": TRAINING, "val": VALIDATION}, seeds=20, spare=8, repeat=9),
    ]


REDUCTIONS = ("shared", "plain", "iota")


def reduced(
    plan: Plan,
    group: str,
    runs: Mapping[Task, ThermalRun],
    reference: np.ndarray,
    *,
    reduction: str,
    factor: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every load of a group by one reduction: displacement of the atoms [Å], SNR and seed.

    Of shapes [S, A, 2], [S] and [S]; `reference`: of the atoms [Å], shape [A, 2].
    """
    seeds = [plan.seed(number) for number in range(len(plan.groups[group]))]
    tasks = [Task(plan.body, x, factor, seed) for x, seed in zip(plan.groups[group], seeds)]
    loaded = [runs[task] for task in tasks]
    told = (_field(plan, runs, run, seed, reduction) for run, seed in zip(loaded, seeds))
    fields = [settled(field, reference, plan.body.box) for field in told]
    return np.stack(fields), np.array([run.snr for run in loaded]), np.array(seeds)


def _field(
    plan: Plan, runs: Mapping[Task, ThermalRun], run: ThermalRun, seed: int, reduction: str
) -> np.ndarray:
    """Displacement of a run by a reduction; of one alone on the disk less the mean of others."""
    if reduction == "shared":
        return np.asarray(run.average - runs[plan.unloaded(seed)].average)
    field = run.average if reduction == "plain" else run.smoothed
    if plan.body.box is not None:
        return field
    others = [runs[plan.unloaded(other)].average for other in plan.every_seed() if other != seed]
    return field - np.mean(others, axis=0)


def noise(
    plan: Plan,
    runs: Mapping[Task, ThermalRun],
    reference: np.ndarray,
    *,
    reduction: str,
    factor: float,
) -> np.ndarray:
    """Noise of a reduction by itself: fields [Å], shape [S, A, 2], that no load caused.

    Of the plain average and of the smoothing: unloaded runs of the spare seeds. Of the shared
    seeds: what a load gives with two seeds, difference over √2.
    """
    fields = []
    if reduction == "shared":
        for group, loads in plan.groups.items():
            for number, second in plan.repeated(group).items():
                tasks = (
                    Task(plan.body, loads[number], factor, s) for s in (plan.seed(number), second)
                )
                one, two = (_field(plan, runs, runs[t], t.seed, reduction) for t in tasks)
                fields.append((one - two) / np.sqrt(2))
    else:
        for seed in plan.every_seed()[plan.seeds :]:
            fields.append(_field(plan, runs, runs[plan.unloaded(seed)], seed, reduction))
    return np.stack([settled(field, reference, plan.body.box) for field in fields])
