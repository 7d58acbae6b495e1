"""One training run, and the sweep over horizons and degrees."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from tqdm import tqdm

from warp_peri.errors import InputError, warn
from warp_peri.files.atomic import locked, write_json
from warp_peri.files.checkpoint import fingerprint
from warp_peri.fitting.evaluate import evaluate
from warp_peri.fitting.settings import Bernstein, Conditions, Method, Optimum, TwoStage
from warp_peri.learning import DEGREES, HORIZONS
from warp_peri.learning.fit import learn
from warp_peri.materials.lps import Model
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import symbols

ERRORS = ("E_res", "E_u", "E_res_abs")
"""Those of the means of `evaluate` that a model is kept with, where the metrics hold them."""


@dataclasses.dataclass(frozen=True)
class Run:
    """What a training run found.

    Attributes:
        fit: the material, its certificate and the way to them.
        tables: of `evaluate`, by the name of the set.
        refused: why a set was not evaluated, by its name.
        seconds: of learning and of prediction.
    """

    fit: Any
    tables: dict[str, dict[str, Any]]
    refused: dict[str, str]
    seconds: dict[str, float]

    def mean(self, error: str) -> dict[str, float]:
        """An error of `evaluate`, averaged over the samples of each set, by the set's name."""
        return {name: table[error] for name, table in self.tables.items()}

    def save(
        self, folder: Path, metrics: dict[str, Any], *, data: Path, provenance: Mapping[str, Any]
    ) -> Any:
        """Write model.json, with its errors and the hash of its data, and metrics.json.

        Args:
            folder: made if it is not there.
            metrics: contents of metrics.json.
            data: the file that was learned from.
            provenance: what else the model says of how it came to be.

        Raises OSError when a file cannot be written.
        """
        material = self.fit.material
        said = {"errors": {key: metrics[key] for key in ERRORS if key in metrics}}
        said["provenance"] = {
            **getattr(material, "provenance", {}),
            "data": data.name,
            "sha256": hashlib.sha256(data.read_bytes()).hexdigest(),
            **provenance,
        }
        model = dataclasses.replace(
            material, **{name: value for name, value in said.items() if hasattr(material, name)}
        )
        model.save(folder / "model.json")
        write_json(folder / "metrics.json", metrics)
        return model


def train(
    law: Any,
    samples: Samples,
    sets: Mapping[str, Samples],
    *,
    allow_uncertified: bool = False,
    **options: Any,
) -> Run:
    """Learn a law from samples, and evaluate it on sets.

    Args:
        law: what is learned, as LPS(…).
        samples: training samples.
        sets: to evaluate on, by name; one that `evaluate` refuses is passed over with its reason.
        allow_uncertified: warn about an uncertified spacing instead of refusing the set.
        options: of the law's `learn`: progress, and noise where it takes it.

    Raises what `fit` raises.
    """
    begin = time.perf_counter()
    learned = law.learn(samples, **options)
    between = time.perf_counter()
    tables, refused = {}, {}
    for name, points in sets.items():
        try:
            tables[name] = evaluate(learned.material, points, allow_uncertified=allow_uncertified)
        except InputError as error:  # no load, another spacing, a collar too small
            refused[name] = str(error)
    seconds = {"learning": between - begin, "prediction": time.perf_counter() - between}
    return Run(learned, tables, refused, seconds)


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
        E_res_train: error of the equation (theory, 30) on the training set, a fraction.
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
    method: Method = Optimum(moduli=None),  # noqa: B008 (a frozen value)
    jobs: int = -1,
    progress: bool = False,
) -> Sweep:
    """Fit every horizon and degree and choose.

    Finished fits stay in `folder` as model files with their errors, so that an interrupted sweep
    goes on where it was; they are known by a hash of the data and the settings, and proven again.
    A fit that finds no optimum is warned about and left out.

    Args:
        train, val: training and validation samples.
        folder: for the models and their errors.
        test: samples whose error is reported and takes no part in the choice.
        noise: fields of noise alone on the training nodes, as in `fit`.
        horizons: δ [Å].
        degrees: M.
        conditions: "direct" or "paper", as in Conditions.
        method: of each fit; Algorithm 2 as printed has TwoStage("relu", "dense").
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
    sets = {"train": train, "val": val} | ({} if test is None else {"test": test})
    common = (sets, noise, Conditions(conditions), method)
    files = {}
    for horizon, degree in itertools.product(horizons, degrees):
        key = fingerprint(horizon, degree, *common)
        name = f"d{horizon:g}_M{degree}_{key[:12]}.model.json"
        files[Path(folder) / name] = (horizon, degree, key)
    with locked(folder):
        found = {file: _read(file, train, case) for file, case in files.items()}
        todo = [file for file in files if found[file] is None]
        work = (joblib.delayed(_fit)(*common, *files[file], file) for file in todo)
        failed = []
        with tqdm(
            total=len(files), initial=len(files) - len(todo), unit="fit", disable=not progress
        ) as bar:
            parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
            for failure in parallel(work) if todo else ():
                failed += [failure] if failure else []
                bar.update()
        for failure in sorted(failed):
            warn(f"sweep: {failure}; the other fits go on")
        found |= {file: _read(file, train, files[file]) for file in todo}
    if not (trials := [trial for trial in found.values() if trial is not None]):
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


def _fit(
    sets: dict[str, Samples],
    noise: Samples | None,
    conditions: Conditions,
    method: Method,
    horizon: float,
    degree: int,
    key: str,
    file: Path,
) -> str:
    """Fit, evaluate, and leave the model with its errors in `file`.

    Returns what went wrong when a fit finds no optimum; nothing is left then, and the next run
    tries again. A fit of hours keeps its state beside the model, and goes on from there. Input
    that cannot be used ends the sweep.
    """
    state, train = file.with_suffix(".npz"), sets["train"]
    if isinstance(method, TwoStage):
        method = dataclasses.replace(method, checkpoint=state)
    asked: dict[str, Any] = {"method": method, "conditions": conditions, "noise": noise}
    try:
        model = learn(train, horizon, Bernstein(degree), progress=False, **asked).material
    except RuntimeError as error:
        unit = symbols(train.points.units)[0]
        return f"δ = {horizon:g} {unit}, M = {degree}: {error}"
    tables = {name: evaluate(model, one, allow_uncertified=True) for name, one in sets.items()}
    errors = {key: {name: table[key] for name, table in tables.items()} for key in ERRORS}
    provenance = model.provenance | {"sweep": fingerprint(key, errors, model.learnable)}
    dataclasses.replace(model, errors=errors, provenance=provenance).save(file)
    state.unlink(missing_ok=True)
    return ""


def _read(file: Path, train: Samples, case: tuple[float, int, str]) -> Trial | None:
    """A finished trial, whose file and proof `load` checks; None where there is none of this."""
    horizon, degree, key = case
    try:
        model = Model.load(file)
        mark = fingerprint(key, model.errors, model.learnable)
        if (model.horizon, model.degree, model.provenance["sweep"]) != (horizon, degree, mark):
            return None
        res, u = (model.errors[name] for name in ("E_res", "E_u"))
        bonds = int(bond_classes(train.spacing, model.horizon).count.sum())
        errors = res["train"], u["train"], res["val"], u["val"], u.get("test")
        bound = model.certificate[f"{train.spacing:g}"]["symbol_bound"]
        numbers = model.lam, model.mu, model.alpha, bound
        return Trial(model.horizon, model.degree, bonds, *errors, *numbers, file.name)
    except (InputError, KeyError, TypeError):
        return None
