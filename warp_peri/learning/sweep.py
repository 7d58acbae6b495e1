"""Algorithm 2 of You et al. (2021): choose horizon and degree by a sweep over both."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import joblib
import numpy as np
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.files.atomic import locked, write_json
from warp_peri.learning import DEGREES, HORIZONS
from warp_peri.learning.evaluate import evaluate
from warp_peri.learning.fit import learn
from warp_peri.learning.methods import Bernstein
from warp_peri.lps.model import Model
from warp_peri.points.arrays import fingerprint
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import symbols
from warp_peri.regression.conditions import Conditions

COST_TOLERANCE = 0.1
"""How much worse than the best AvgE the cheapest choice may be, relative."""
TIE = 1e-3


@dataclass(frozen=True)
class Trial:
    """One fit of a sweep.

    Attributes:
        horizon: δ [Å].
        degree: M.
        bonds: bonds of a family, which is what a sweep of the operator costs.
        E_res_train: error of the equation (theory.md, 30) on the training set, a fraction.
        E_u_train: error of the solved displacement (31) there.
        E_res_val: as E_res_train, on the validation set.
        E_u_val: as E_u_train, on the validation set.
        E_u_test: on the test set; None without one. It takes no part in any choice.
        lam: learned λ [TPa].
        mu: learned μ [TPa].
        alpha: exponent.
        symbol_bound: proven lower bound of D/s [TPa].
        model: name of the model's file in the folder of the sweep.
    """

    horizon: float
    degree: int
    bonds: int
    E_res_train: float
    E_u_train: float
    E_res_val: float
    E_u_val: float
    E_u_test: float | None
    lam: float
    mu: float
    alpha: float
    symbol_bound: float
    model: str


@dataclass(frozen=True)
class Sweep:
    """Result of a sweep.

    Attributes:
        trials: every fit.
        by_degree: for each degree, the trial whose E_res_train is smallest.
        average: AvgE of each of them: the mean of its four errors over those of the first.
        printed: the trial of the smallest AvgE, Algorithm 2 as printed.
        cheapest: the trial with the fewest bonds, then the lowest degree, whose AvgE over all
            trials is within COST_TOLERANCE of the smallest.
    """

    trials: list[Trial]
    by_degree: list[Trial]
    average: list[float]
    printed: Trial
    cheapest: Trial


def sweep(
    train: Samples,
    val: Samples,
    folder: str | os.PathLike[str],
    *,
    test: Samples | None = None,
    noise: Samples | None = None,
    horizons: Sequence[float] = HORIZONS,
    degrees: Sequence[int] = DEGREES,
    conditions: str = "direct",
    jobs: int = -1,
    progress: bool = False,
) -> Sweep:
    """Fit every horizon and degree to its constrained optimum and choose.

    Finished fits stay in `folder`, so that an interrupted sweep goes on where it was; they are
    known by a hash of the data and the settings. A fit that finds no optimum is warned about and
    left out.

    Args:
        train, val: training and validation samples.
        folder: for the models and their errors.
        test: samples whose error is reported and takes no part in the choice.
        noise: fields of noise alone on the training nodes, as in `fit`.
        horizons: δ [Å].
        degrees: M.
        conditions: "direct" or "paper", as in Conditions.
        jobs: number of processes, −1 for one per core; a joblib.parallel_config around the call
            chooses another backend.
        progress: show a progress bar.

    Raises InputError for input that cannot be used or a folder that another job writes to,
    RuntimeError when every fit failed.
    """
    if not (len(horizons) and len(degrees)):
        raise InputError("sweep: expected at least one horizon and one degree")
    if not isinstance(jobs, int) or jobs == 0:
        raise InputError(
            f"jobs: expected a number of processes, or −1 for one per core, got {jobs!r}"
        )
    sets, grid = (train, val, test, noise), (horizons, degrees)
    with locked(folder):
        return _sweep(*sets, Path(folder), *grid, conditions, jobs, progress)


def _sweep(
    train: Samples,
    val: Samples,
    test: Samples | None,
    noise: Samples | None,
    folder: Path,
    horizons: Sequence[float],
    degrees: Sequence[int],
    conditions: str,
    jobs: int,
    progress: bool,
) -> Sweep:
    key = fingerprint(conditions, train, val, test, noise)[:12]
    cases = [(horizon, degree) for horizon in horizons for degree in degrees]
    files = [folder / f"d{horizon:g}_M{degree}_{key}.json" for horizon, degree in cases]
    todo = [(case, file) for case, file in zip(cases, files) if _read(file) is None]
    with tqdm(
        total=len(cases), initial=len(cases) - len(todo), unit="fit", disable=not progress
    ) as bar:
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
        work = (
            joblib.delayed(_trial)(train, val, test, noise, horizon, degree, conditions, file)
            for (horizon, degree), file in todo
        )
        failed = []
        for failure in parallel(work) if todo else ():
            failed += [failure] if failure else []
            bar.update()
    for failure in sorted(failed):
        warnings.warn(f"sweep: {failure}; the other fits go on", stacklevel=3)
    trials = [trial for file in files if (trial := _read(file)) is not None]
    if not trials:
        raise RuntimeError("sweep: every fit failed")
    return choose(trials)


def choose(trials: list[Trial]) -> Sweep:
    """The choices of Algorithm 2 and by cost, among finished trials."""
    degrees = sorted({trial.degree for trial in trials})
    by_degree = [
        min((t for t in trials if t.degree == degree), key=lambda t: t.E_res_train)
        for degree in degrees
    ]
    base = by_degree[0]
    average = [_average(trial, base) for trial in by_degree]
    # Averages equal to three digits are one optimum: the lowest degree is kept.
    printed = by_degree[next(i for i, a in enumerate(average) if a <= min(average) * (1 + TIE))]
    bound = (1 + COST_TOLERANCE) * min(_average(trial, base) for trial in trials)
    good = [trial for trial in trials if _average(trial, base) <= bound]
    cheapest = min(good, key=lambda trial: (trial.bonds, trial.degree))
    return Sweep(trials, by_degree, average, printed, cheapest)


def _average(trial: Trial, base: Trial) -> float:
    """AvgE: errors over those of the baseline, averaged."""
    names = ("E_res_train", "E_u_train", "E_res_val", "E_u_val")
    return float(np.mean([getattr(trial, name) / getattr(base, name) for name in names]))


def _trial(
    train: Samples,
    val: Samples,
    test: Samples | None,
    noise: Samples | None,
    horizon: float,
    degree: int,
    conditions: str,
    file: Path,
) -> str:
    """Fit, evaluate, and leave the record in `file` and the model beside it.

    Returns what went wrong when a fit finds no optimum; nothing is left then, and the next run
    tries again. Input that cannot be used ends the sweep.
    """
    try:
        learned = learn(
            train,
            horizon,
            Bernstein(degree),
            conditions=Conditions(conditions),
            noise=noise,
            progress=False,
        )
    except RuntimeError as error:
        unit = symbols(train.points.units)[0]
        return f"δ = {horizon:g} {unit}, M = {degree}: {error}"
    model = learned.material
    tables = [evaluate(model, points, allow_uncertified=True) for points in (train, val)]
    E_u_test = None if test is None else evaluate(model, test, allow_uncertified=True)["E_u"]
    model_file = file.with_suffix(".model.json")
    model.save(model_file)
    record = Trial(
        horizon=horizon,
        degree=degree,
        bonds=int(bond_classes(train.spacing, horizon).count.sum()),
        E_res_train=tables[0]["E_res"],
        E_u_train=tables[0]["E_u"],
        E_res_val=tables[1]["E_res"],
        E_u_val=tables[1]["E_u"],
        E_u_test=E_u_test,
        lam=model.lam,
        mu=model.mu,
        alpha=model.alpha,
        symbol_bound=learned.certificate.symbol_bound,
        model=model_file.name,
    )
    write_json(file, asdict(record))
    return ""


def _read(file: Path) -> Trial | None:
    """A finished trial; None when there is none or its files cannot be read."""
    try:
        trial = Trial(**json.loads(file.read_text(encoding="utf-8")))
        Model.load(file.parent / trial.model)
    except (OSError, ValueError, TypeError):
        return None
    return trial
