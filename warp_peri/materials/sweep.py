"""The sweep over horizons and degrees of the LPS."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, cast

import joblib
import numpy as np
from tqdm import tqdm

from warp_peri.errors import InputError, StrPath, warn
from warp_peri.files.atomic import locked
from warp_peri.files.checkpoint import fingerprint
from warp_peri.fitting.evaluate import ERRORS, evaluate
from warp_peri.fitting.regression import check_alike
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_fit import LPS
from warp_peri.materials.lps_law import DEGREES, HORIZONS, Bernstein, GaussNewton, TwoStage
from warp_peri.points import arguments
from warp_peri.points.arguments import Bound, checked, is_positive, symbols, typed, within
from warp_peri.points.families import bond_classes, families_of
from warp_peri.points.points import Samples

COST_TOLERANCE = 0.1
"""How much worse than the best AvgE the cheapest choice may be, relative."""
TIE = 1e-3


@dataclass(frozen=True)
class Trial:
    """One fit of a sweep.

    Attributes:
        horizon: δ [length].
        degree: M.
        bonds: bonds of a family, which is what a sweep of the operator costs.
        E_res_train, E_res_val: error of the equation (theory, 30) on training and validation
            samples, a fraction.
        E_u_train, E_u_val: of the solved displacement (31).
        E_u_test: on the test set; None without one. It takes no part in any choice.
        lam, mu, alpha: learned, moduli [stress].
        symbol_bound: proven lower bound of D/s [stress].
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


@arguments.typed_methods
@dataclass(frozen=True)
class SweepResult:
    """All fits of a sweep and the chosen ones.

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


FREE = LPS(HORIZONS[0], method=GaussNewton(moduli=None))
Jobs = Annotated[int, Bound("a number of processes, or −1 for one per core", lambda n: n != 0)]


@typed
def sweep(
    train: Samples,
    val: Samples,
    folder: StrPath,
    *,
    test: Samples | None = None,
    noise: Samples | None = None,
    law: LPS = FREE,
    horizons: Sequence[float] | None = None,
    degrees: Sequence[int] = DEGREES,
    jobs: Jobs = -1,
    progress: bool = False,
) -> SweepResult:
    """Fit every horizon and degree and choose.

    Finished fits stay in `folder` with their errors, known by a hash of the data and the settings,
    so that an interrupted sweep goes on where it was; they are proven again. A fit that finds no
    optimum is warned about and left out.

    Args:
        train, val: training and validation samples.
        folder: for the models and their errors.
        test: samples whose error is reported and takes no part in the choice.
        noise: fields of noise alone on the training nodes, as in `fit`.
        law: what is fitted, and how, with each horizon and degree in the place of its own. The
            default learns moduli freely, by GaussNewton(moduli=None); LPS(…) by itself holds those
            of long waves. Algorithm 2 as printed has method=TwoStage().
        horizons: δ [length of train]; by default HORIZONS, which are in Å.
        degrees: M.
        jobs: processes, −1 for one per core; joblib.parallel_config chooses another backend.
        progress: show a progress bar.

    Raises InputError for input that cannot be used, as a horizon that the nodes do not carry, or a
    folder that another job writes to; RuntimeError when every fit failed.
    """
    if horizons is None:
        horizons = arguments.usual_lengths("horizons", HORIZONS, train.units).tolist()
    if not (len(checked("horizons", horizons, float, ("n",))) and len(degrees)):
        raise InputError("sweep: expected at least one horizon and one degree")
    sets = {"train": train, "val": val} | ({} if test is None else {"test": test})
    _check_sets(sets, horizons)
    files = {}
    for horizon, degree in itertools.product(horizons, degrees):
        trial = replace(law, horizon=horizon, kernel=Bernstein(degree))
        key = fingerprint(trial, sets, noise)
        files[Path(folder) / f"d{horizon:g}_M{degree}_{key[:12]}.model.json"] = trial, key
    with locked(folder):
        found = {file: _read(file, train.spacing, key) for file, (_, key) in files.items()}
        todo = [file for file in files if found[file] is None]
        work = (joblib.delayed(_fit)(*files[file], sets, noise, file) for file in todo)
        # each process starts at once, with work or without
        failures = joblib.Parallel(min(jobs, len(todo) or 1), return_as="generator_unordered")(work)
        about = {"total": len(files), "initial": len(files) - len(todo), "unit": "fit"}
        for failure in sorted(filter(None, tqdm(failures, **about, disable=not progress))):
            warn(f"sweep: {failure}; the other fits go on")
        found |= {file: _read(file, train.spacing, files[file][1]) for file in todo}
    if not (trials := [trial for trial in found.values() if trial is not None]):
        raise RuntimeError("sweep: every fit failed")
    return choose(trials)


def _check_sets(sets: dict[str, Samples], horizons: Sequence[float]) -> None:
    """Raise InputError for sets in several units, without loads, or empty, and a horizon that the
    nodes of one do not carry; all are evaluated with the fit's own, on other lattices too."""
    check_alike([*sets.values()])
    for name, one in sets.items():
        told = one.loads[:, one.interior].any() and one.u[:, one.interior].any()
        if not (told or (name == "test" and len(one))):
            raise InputError(f"{name}: expected loads inside and u: errors are divided by them")
    for horizon, one in itertools.product(horizons, sets.values()):
        within(f"horizon {horizon:g}", families_of, one, horizon)


def choose(trials: list[Trial]) -> SweepResult:
    """Choose among finished trials by Algorithm 2, as printed and by cost."""
    by_degree = [
        min((t for t in trials if t.degree == degree), key=lambda t: t.E_res_train)
        for degree in sorted({trial.degree for trial in trials})
    ]
    base = by_degree[0]
    average = [_average(trial, base) for trial in by_degree]
    # Averages equal to three digits are one optimum: the lowest degree is kept.
    printed = by_degree[next(i for i, a in enumerate(average) if a <= min(average) * (1 + TIE))]
    bound = (1 + COST_TOLERANCE) * min(_average(trial, base) for trial in trials)
    good = [trial for trial in trials if _average(trial, base) <= bound]
    cheapest = min(good, key=lambda trial: (trial.bonds, trial.degree))
    return SweepResult(trials, by_degree, average, printed, cheapest)


def _average(trial: Trial, base: Trial) -> float:
    """AvgE: errors over those of the baseline, averaged."""
    names = ("E_res_train", "E_u_train", "E_res_val", "E_u_val")
    return float(np.mean([getattr(trial, name) / getattr(base, name) for name in names]))


def _fit(law: LPS, key: str, sets: dict[str, Samples], noise: Samples | None, file: Path) -> str:
    """Fit, evaluate, and save the model with its errors in `file`, its state beside it meanwhile;
    returns the failure where no optimum is found."""
    state, train, kernel = file.with_suffix(".h5"), sets["train"], cast(Bernstein, law.kernel)
    if isinstance(law.method, TwoStage):
        law = replace(law, method=replace(law.method, checkpoint=state))
    try:
        model = law.learn(train, noise=noise, progress=False).material
    except RuntimeError as error:
        return f"δ = {law.horizon:g} {symbols(train.units)[0]}, M = {kernel.degree}: {error}"
    tables = {name: evaluate(model, one, allow_uncertified=True) for name, one in sets.items()}
    errors = {kind: {name: table[kind] for name, table in tables.items()} for kind in ERRORS}
    model = replace(model, errors=errors)
    replace(model, provenance=model.provenance | {"sweep": _mark(model, key)}).save(file)
    if isinstance(law.method, TwoStage):
        state.unlink(missing_ok=True)
    return ""


def _mark(model: LPSMaterial, key: str) -> str:
    """Key that identifies a finished fit's file."""
    return fingerprint(key, model, model.errors, model.certificate)


def _read(file: Path, spacing: float, key: str) -> Trial | None:
    """The finished trial of a file, checked by `load`; None where there is none with this key."""
    try:
        model = LPSMaterial.load(file)
        if model.provenance["sweep"] != _mark(model, key):
            return None
        res, u = (model.errors[name] for name in ("E_res", "E_u"))
        bonds = int(bond_classes(spacing, model.horizon).count.sum())
        errors = res["train"], u["train"], res["val"], u["val"], u.get("test")
        bound = model.certificate[f"{spacing:g}"]["symbol_bound"]
        if not all(map(is_positive, (bound, *errors[:4], *filter(None, errors[4:])))):
            return None
        numbers = model.lam, model.mu, model.alpha, bound
        return Trial(model.horizon, model.degree, bonds, *errors, *numbers, file.name)
    except (InputError, KeyError, TypeError):
        return None
