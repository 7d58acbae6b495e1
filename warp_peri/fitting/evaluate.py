"""Errors of a model on data (theory, 30–31), training runs, and bootstrap bands."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy import ndarray
from numpy.linalg import lstsq
from numpy.typing import ArrayLike
from scipy.special import stdtrit
from tqdm import tqdm

from warp_peri.errors import InputError, Values, quietly, warn
from warp_peri.files.atomic import write_json
from warp_peri.fitting.regression import norms, sizes
from warp_peri.points.arguments import (
    Bound,
    Pair,
    Seed,
    Share,
    checked,
    offered,
    typed,
    typed_methods,
)
from warp_peri.points.dataset import Dataset, warn_of_unseen
from warp_peri.points.points import Samples
from warp_peri.protocols import options_of, placed
from warp_peri.solvers.systems import turns_of

ERRORS = ("E_res", "E_u", "E_res_abs")
"""Those of the means of `evaluate` that a model is kept with, where the metrics hold them."""
ROUNDING = 1e-12
"""What is less than this beside the parts that cancel in it is rounding."""


@typed
def evaluate(
    material: Any,
    samples: Samples | Dataset,
    *,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> Values:
    """Compute a material's errors on every sample of a set and their means.

    Args:
        material: any, or its operator on their points. A solid certified on some lattice is
            transferred to others, which is said once.
        samples: samples with displacement and load; of a Dataset its only set.
        transfer: False refuses lattices that the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.

    Returns:
        E_res = mean ‖L u − b‖₂/‖b‖₂, E_u = mean ‖u_solved − u‖₂/‖u‖₂ on interior nodes, u solved
            with b on the interior and u given on the collar, both less their means where no node is
            held; E_shape, as E_u with ‖u‖ less its rigid part below the line, which no translation
            or turn of the body changes; E_res_abs = mean ‖L u − b‖₂ [TPa/Å]; the lists of
            per-sample values E_res_samples, E_res_abs_samples, E_u_samples, E_shape_samples; and of
            a transferred model transferred_from, the spacing [Å] of the lattice that it comes from.
            For a nonlinear model also linear_solves and largest_gradient, the most linear solves
            and |H| of a sample, and unique, whether all answers are proven to be the only ones.

    Samples whose interior carries no load, or one that is rounding, have no E_res, rigid motions no
    E_shape, those at rest no E_u: None, and the means are those of the others; None where there are
    none. Raises InputError for a set without samples, or that the model cannot be used on.

    >>> wp.evaluate(model, samples)["E_u"] < 1e-9
    True
    """
    if isinstance(samples, Dataset):
        samples = samples.obvious()
    if len(samples) == 0:
        raise InputError("the set has no samples to evaluate")
    proofs: Any = {"transfer": transfer, "allow_uncertified": allow_uncertified}
    operator = placed(material, samples.points, verb="evaluate", **proofs)
    offered(operator, "jvp", "evaluate", "a material whose fields are displacements")
    if hasattr(operator, "errors"):  # a law whose samples may fail one by one
        return operator.errors(samples)  # type: ignore[no-any-return]
    warn_of_unseen(samples)
    load = operator.rhs(samples.loads)
    size, residual = norms(load), residuals(operator, samples.u, load)
    # the force of the interior's displacement alone, which that of the collar takes off again;
    # a load that is rounding beside it counts as none
    straight = getattr(operator, "straight", operator)
    inner = norms(straight(np.where(samples.interior[:, None], samples.u, 0.0)))
    size = np.where(size > ROUNDING * inner, size, 0)
    solution = operator.solve(samples.loads, samples.u)
    figures = operator.figures(solution) if hasattr(operator, "figures") else {}
    home = getattr(getattr(operator.model, "linear", None), "transferred_from", None)
    return _table(samples, residual, size, solution.u, home) | figures


def _table(
    points: Samples, residual: ndarray, load: ndarray, solved: ndarray, home: float | None
) -> Values:
    """Table of errors of solutions; `home` is the spacing that a transferred model comes from."""
    inside = points.interior
    size, wrong = sizes(points.u, inside), sizes(solved - points.u, inside)
    table = errors_of("E_res", residual, load) | errors_of("E_u", wrong, size)
    bent = norms(without_rigid_part(points.x[inside], points.u[:, inside]))
    bent = np.where(bent > ROUNDING * size, bent, 0.0)
    table |= errors_of("E_shape", wrong, bent) | errors_of("E_res_abs", residual)
    if home is not None:
        table["transferred_from"] = home
    return table


def residuals(operator: Any, u: ndarray, load: ndarray) -> ndarray:
    """Norms of op(u) − load [S]; warns of a sample on which the force is no number."""
    found = norms(operator(u) - load)
    if (none := np.isnan(found)).any():
        warn(f"samples: the force on sample {none.argmax()} is no number, and left out of E_res")
    return found


def errors_of(key: str, off: ArrayLike, whole: ArrayLike = 1.0) -> Values:
    """Mean error, and those of S samples, None where `off` is NaN or `whole` 0."""
    pairs = np.broadcast(off, whole)
    values = [float(a / b) if b > 0 and a == a else None for a, b in pairs]
    known = [value for value in values if value is not None]
    return {key: float(np.mean(known)) if known else None, f"{key}_samples": values}


def without_rigid_part(x: ndarray, u: ndarray) -> ndarray:
    """Fields u, [S, N, d], less the translation and small rotation nearest to them."""
    left = (u - u.mean(axis=1, keepdims=True)).reshape(len(u), -1).T
    T = turns_of(x).reshape(x.size, -1)
    return np.asarray((left - T @ lstsq(T, left)[0]).T.reshape(u.shape))


@dataclass(frozen=True)
class Run:
    """A fit, tables of `evaluate` and why it refused a set, by the set's name, and seconds."""

    fit: Any
    tables: dict[str, Values]
    refused: dict[str, str]
    seconds: dict[str, float]

    def mean(self, error: str) -> dict[str, float]:
        """Mean of one error of `evaluate` over the samples of each set, by the set's name."""
        return {name: table[error] for name, table in self.tables.items()}

    def save(self, folder: Path, metrics: Values, *, data: Path, provenance: Values) -> Any:
        """Write model.json, with its errors, the name of its data file and provenance, and
        metrics.json into a folder, made if missing; OSError where a file cannot be written."""
        material = self.fit.material
        said = {"errors": {key: metrics[key] for key in ERRORS if key in metrics}}
        said["provenance"] = {
            **getattr(material, "provenance", {}),
            "data": data.name,
            **provenance,
        }
        known = {name: value for name, value in said.items() if hasattr(material, name)}
        model = replace(material, **known)
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
    """Learn a law from samples with `options` of its `learn`, and evaluate it on named sets; one
    that `evaluate` refuses is passed over with its reason. Raises what `fit` raises."""
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


LEAST_LOADS, LEAST_DRAWS, DRAWS = 4, 10, 40
ONE_DEVIATION = (0.1587, 0.8413)
"""Of normal numbers, the parts below minus and plus one standard deviation."""
Draws = Annotated[int, Bound(f"at least {LEAST_DRAWS}", lambda draws: draws >= LEAST_DRAWS)]
REDRAWN = 0.2
"""Of the draws, that may determine no law and are drawn again."""


@typed_methods
@dataclass(frozen=True)
class BootstrapResult:
    """Materials learned from random choices of the loads (bootstrap).

    Attributes:
        materials: one of each choice.
        loads: how many there were.
        knows: what the bands hold and what they do not, in a sentence.
    """

    materials: list[Any]
    loads: int
    knows: str

    def deviation(self, quantity: Callable[[Any], ndarray | float]) -> ndarray:
        """Standard deviation of a quantity of the material, in its shape: half of what lies between
        16 and 84 % of the draws, so that one poorly determined law does not widen it."""
        values = checked("quantity", [quantity(material) for material in self.materials])
        low, high = np.quantile(values, ONE_DEVIATION, axis=0)
        return np.asarray(np.sqrt(self.loads / (self.loads - 1)) * (high - low) / 2)

    def band(
        self, material: Any, quantity: Callable[[Any], ndarray | float], level: Share = 0.9
    ) -> Pair:
        """Lower and upper end of the band that holds a quantity with probability `level` (else
        InputError), about the material of all loads, by Student's distribution of the loads."""
        half = stdtrit(self.loads - 1, (1 + level) / 2) * self.deviation(quantity)
        middle = checked("quantity", quantity(material))
        return middle - half, middle + half


@typed
def bootstrap(
    samples: Samples | Dataset,
    law: Any,
    *,
    draws: Draws = DRAWS,
    seed: Seed = 0,
    progress: bool = False,
    **options: Any,
) -> BootstrapResult:
    """Repeat a fit on random choices of the loads, with repetition (bootstrap).

    Args:
        samples: that the law is learned from; of a Dataset `train`, or its only set.
        law: as for `fit`; the symmetry or the degree that all loads ask for is kept.
        draws, seed: how many choices, and of which random numbers.
        progress: show a progress bar.
        options: of `fit`.

    Raises InputError for fewer than four loads or ten draws, what `fit` raises, and where a fifth
    of the draws determine no law.
    """
    one = samples.obvious("train") if isinstance(samples, Dataset) else samples
    warn_of_unseen(one)
    count, rng, again = len(one), np.random.default_rng(seed), 0
    if count < LEAST_LOADS:
        raise InputError(f"samples: expected at least {LEAST_LOADS} loads, got {count}")
    learn = offered(law, "learn", "bootstrap", "a model: LPS(…), Crystal(…)")
    options = options_of(learn, "bootstrap", options)
    if getattr(law, "symmetry", None) == "auto":
        law = replace(law, symmetry=law.learn(one, **options).material.symmetry)
    if getattr(law, "kernel", law) is None:
        law = replace(law, kernel=law.learn(one, **options).law.kernel)
    materials: list[Any] = []
    with tqdm(total=draws, desc="fits", unit="fit", disable=not progress) as bar:
        while len(materials) < draws:
            try:
                with quietly():  # the fit to all loads warns
                    chosen = one[rng.integers(count, size=count)]
                    materials.append(law.learn(chosen, **options).material)
                bar.update()
            except InputError:
                again += 1
                if again > REDRAWN * draws:
                    raise
    more = f" ({again} more told of no model)" if again else ""
    knows = (
        f"{draws} choices of the loads with repetition{more}, of {count}: what differs from load "
        "to load, noise among it; not an error that all loads share"
    )
    return BootstrapResult(materials, count, knows)
