"""Runs at finite temperature: Langevin dynamics of one body under one load, kept in a cache.

A run keeps what every reduction needs: the displacement smoothed in time (You et al. 2021, 2.10)
and its plain average after a transient. Runs of one seed see the same random forces, so the
difference of a loaded and an unloaded one has far less noise than either.
"""

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tools.lammps_session import LammpsSession
from tools.loads import Load
from tools.samples import Piece, Sample, body_record, cache_file, read_record, write_record
from warp_peri import InputError
from warp_peri.structures.lammps import LammpsError

CACHE_VERSION = 1


@dataclass(frozen=True)
class Bath:
    """A heat bath and how long the atoms stay in it.

    Attributes:
        temperature: [K].
        steps: of a run.
        transient: steps at its begin that the plain average leaves out.
        iota: ι of the smoothing in time.
        timestep, damping: of the Langevin dynamics [ps]. The paper's text says 5.0 fs, with which
            atoms are lost, and 5.0E-16 s, which is taken.
    """

    temperature: float = 300.0
    steps: int = 4000
    transient: int = 1200
    iota: float = 0.01
    timestep: float = 0.0005
    damping: float = 0.1

    def __post_init__(self) -> None:
        if not (np.isfinite(self.temperature) and self.temperature > 0):
            raise InputError(f"temperature: expected more than 0 K, got {self.temperature}")
        if not 0 <= self.transient < self.steps:
            raise InputError(
                f"steps: expected more than the transient of {self.transient}, got {self.steps}"
            )
        if not 0 < self.iota <= 1:
            raise InputError(f"iota: expected 0 < ι ≤ 1, got {self.iota}")


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

    Attributes:
        average: mean displacement from the reference after the transient [Å], shape [A, 2].
        smoothed: displacement at the end, smoothed in time by (2.10) [Å], shape [A, 2].
        snr: √(Σ|B|²/Σ|B + F|²), sums over atoms, and over steps after the transient.
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
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:20]
    name = "unloaded" if at_rest is None else at_rest.rsplit("-", 1)[0]
    return Path(cache) / f"{name}-s{task.seed}-{key}.npz"


def read_run(path: Path) -> ThermalRun | None:
    """The run in a cache file; None when there is none, with a warning when it is corrupt."""
    return read_record(path, ThermalRun)


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
                u = x - reference
                if box is not None:
                    u -= box * np.rint(u / box)
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
    write_record(run_file(cache, task, bath), ThermalRun(average / kept, smoothed, snr))
    return float(len(reference) * bath.steps)
