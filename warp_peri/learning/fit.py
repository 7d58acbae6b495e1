"""Learning the linear peridynamic solid: data, loss, stages of a method, checks, certificate."""

from __future__ import annotations

import dataclasses
import math
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import torch
from tqdm.auto import tqdm

from warp_peri.core.elastic import from_voigt, plane_isotropic
from warp_peri.core.stencil import difference_tensors
from warp_peri.errors import InputError, quietly, warn
from warp_peri.files.checkpoint import fingerprint
from warp_peri.fitting.augmented_lagrangian import to_the_optimum
from warp_peri.fitting.evaluate import evaluate
from warp_peri.fitting.long_waves import lame_of_long_waves
from warp_peri.fitting.losses import without_noise
from warp_peri.fitting.regression import LatticeRows, Regression
from warp_peri.fitting.result import Fit, FitSettings, LossSelection, Stage
from warp_peri.fitting.settings import (
    LONG_WAVES,
    Bernstein,
    Conditions,
    Constrained,
    Kernel,
    Method,
    Optimum,
    TwoStage,
)
from warp_peri.fitting.training_data import check_noise, listed, sample_weights
from warp_peri.learning import LOSSES
from warp_peri.learning.response import fit_output_error, reduced_loss, responses_of
from warp_peri.learning.two_stage import (
    SMALLEST_MODULUS,
    TorchLaw,
    fit_positive_kernel,
    fit_signed_kernel,
)
from warp_peri.materials.certificate import certify
from warp_peri.materials.crystal import Crystal
from warp_peri.materials.crystal_fit import AGREE, POOR, SPREADS
from warp_peri.materials.influence import InfluenceFunction, shapes_of
from warp_peri.materials.lps import Solid
from warp_peri.materials.lps import moduli as moduli_of
from warp_peri.materials.lps_fit import (
    HEADROOM,
    LPSFound,
    LPSLaw,
    Products,
    noise_rows,
    optimum,
    products,
)
from warp_peri.materials.lps_loss import OperatorLoss, stiffness_of
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.lattice import check_lattice, largest_strain
from warp_peri.points.samples import WAVE_VECTOR, Samples, largest_wave_number
from warp_peri.points.unit_names import symbols

RELATIVE_ZETA = 0.0161
"""ζ over the stiffness that the data show, where none was asked for: 0.0100 TPa on graphene."""
USUAL_STIFFNESS = 0.6212640458
"""A stiffness [TPa] that the steps of Adam suit: that which graphene's data show."""
SAME_LOSS = 1e-6
"""Relative: starts that end so near to one another have found one optimum."""
SMALL_SHARE = 0.01
"""A residual loss is taken as it is when noise is less than this of its squares."""
ON_BOUND = 1e-3
"""A modulus this near its bound, relative, has ended there."""
PLAIN_EXPONENTS = (1.0, 2.0, 2.9)
"""Kernels r^(−α) that an optimum is looked for from."""
MOST_NODES, MOST_REACH = 2000, 8
"""Unknown nodes up to which a fit is compared with local elasticity, and its differences' reach."""
ERROR_TOLERANCE, ROUNDING = 1e-6, 1e-8
"""By which the residual by rows may depart from the operator's: of it, and of the loads."""
Tick = Callable[[float], None]


@dataclass(frozen=True)
class TrainingData:
    """What every method learns from.

    Attributes:
        sets: training sets.
        horizon: δ [length].
        weights: of each sample in the loss.
        conditions: to keep on each lattice, with their ζ.
        noise: fields of noise of each set; empty when nothing is known of it.
        stiffness: that the data show.
        lattices: bond classes of each lattice that carries the conditions.
        by_operator: the loss of each set by Warp's operator.
    """

    sets: list[Samples]
    horizon: float
    weights: list[np.ndarray]
    conditions: Conditions
    noise: list[Samples]
    stiffness: float
    lattices: list[BondClasses]
    by_operator: list[OperatorLoss]

    @cached_property
    def rows(self) -> list[LatticeRows]:
        """The loss of each set as rows."""
        return [Products(s, self.horizon).rows(w) for s, w in zip(self.sets, self.weights)]

    @cached_property
    def noise_rows(self) -> list[np.ndarray]:
        """R of what noise adds to each loss: ‖R p‖² is its expectation."""
        return [noise_rows(of, self.horizon, w) for of, w in zip(self.noise, self.weights)]

    def losses(self, name: str) -> list[LatticeRows]:
        """Rows of the loss of a name, where "output" begins with the corrected one."""
        if name == "residual" or not self.noise:
            return self.rows
        less = [without_noise(one.R, one.y, of) for one, of in zip(self.rows, self.noise_rows)]
        return [LatticeRows(R, y, one.bonds, one.group) for one, (R, y) in zip(self.rows, less)]

    def error(self, solid: Solid) -> float:
        """E_res over all samples."""
        each = [one.errors(*solid.values()) for one in self.by_operator]
        return float(np.concatenate(each).mean())

    def check(self, solid: Solid) -> None:
        """Hold the residual of the rows to the operator's; RuntimeError where they depart."""
        with torch.no_grad():
            whole = sum(float(one.loss(*solid.values())) for one in self.by_operator)
        of_rows = reduced_loss(self.rows, self.lattices, LPSFound(solid).model(self.horizon))
        apart, size = abs(math.sqrt(of_rows) - math.sqrt(whole)), math.sqrt(whole)
        if not apart <= ERROR_TOLERANCE * size + ROUNDING:
            raise RuntimeError(
                f"the residual by rows departs from the operator's by {apart:.1e} of {size:.1e}"
            )


def training_data(
    sets: list[Samples],
    horizon: float,
    conditions: Conditions,
    noise: list[Samples],
    *,
    normalise: bool,
) -> TrainingData:
    """Check the sets and what is known of their noise.

    Args:
        sets: training sets on lattices.
        horizon: δ [length].
        conditions: to keep on each lattice.
        noise: fields of noise alone on the nodes of each.
        normalise: divide each sample by ‖b‖ in the residual.

    Raises InputError for sets that cannot be learned from.
    """
    for each in sets:
        check_lattice(each)
    weights = sample_weights(sets, normalise=normalise)
    if noise and len(noise) != len(sets):
        raise InputError(f"noise: expected {len(sets)} sets, got {len(noise)}")
    for of_noise, samples in zip(noise, sets):
        check_noise(of_noise, samples)
    classes = [bond_classes(each.spacing, horizon) for each in sets]
    by_operator = [OperatorLoss(*of) for of in zip(sets, [horizon] * len(sets), weights)]
    stiffness = stiffness_of(sets, horizon)
    asked = dataclasses.replace(conditions, zeta=conditions.zeta or RELATIVE_ZETA * stiffness)
    return TrainingData(sets, horizon, weights, asked, noise, stiffness, classes, by_operator)


def choose_loss(asked: str, data: TrainingData, start: LPSFound, method: Method) -> LossSelection:
    """The loss that was asked for, or for "auto" the one that the noise calls for.

    Args:
        asked: one of LOSSES.
        data: training data, with what is known of their noise.
        start: where the optimum of the residual is looked for from.
        method: TwoStage has the residual alone.

    Raises InputError for a loss that these data or the method cannot have.
    """
    if asked not in LOSSES:
        raise InputError(f"loss: expected one of {', '.join(LOSSES)}, got {asked!r}")
    if asked == "corrected" and not data.noise:
        raise InputError("loss: 'corrected' needs fields of noise")
    if asked in ("corrected", "output") and isinstance(method, TwoStage):
        raise InputError(f"loss: {asked!r} is not for the two-stage method")
    if asked != "auto":
        return LossSelection(asked, "asked for")
    if isinstance(method, TwoStage):
        return LossSelection("residual", "Algorithm 1 has no other")
    if not data.noise:
        return LossSelection("residual", "no fields of noise were given")
    found = optimum(data.rows, data.lattices, start, data.conditions).model(data.horizon)
    c = [products(found, classes) for classes in data.lattices]
    whole = sum(np.sum((of.R @ p - of.y) ** 2) for of, p in zip(data.rows, c))
    share = float(sum(np.sum((N @ p) ** 2) for N, p in zip(data.noise_rows, c)) / whole)
    why = f"noise is {100 * share:.3g} % of the squared residual at its optimum"
    if share < SMALL_SHARE:
        return LossSelection("residual", why)
    waves = all(WAVE_VECTOR in points.arrays for points in data.sets)
    return LossSelection("output" if waves else "corrected", why)


class Stages:
    """Runs the stages of one fit on its data, each timed, and shown while it runs.

    Args:
        data: training data.
        losses: rows of the loss.
        progress: show a bar for each stage; None shows it where somebody can see it.

    Attributes:
        history: the stages that were run, in order.
        starts: E of stage 3 by start.
        known: optima of stage 3 that are known before it, by start.
    """

    def __init__(
        self, data: TrainingData, losses: Sequence[LatticeRows], progress: bool | None
    ) -> None:
        self.data, self.losses = data, losses
        self.disable = None if progress is None else not progress
        self.history: list[Stage] = []
        self.starts: dict[str, float] = {}
        self.known: dict[str, LPSFound] = {}

    def _run(self, name: str, run: Callable[[Tick], LPSFound]) -> LPSFound:
        begin, steps = time.perf_counter(), 0
        with tqdm(desc=name, unit=" steps", disable=self.disable) as bar:  # its end is not known

            def tick(loss: float) -> None:
                nonlocal steps
                steps += 1
                bar.update()
                if steps % 100 == 0:
                    bar.set_postfix_str(f"relative residual {100 * np.sqrt(loss):.2f} %")

            found = run(tick)
        error, seconds = self.data.error(found.solid), time.perf_counter() - begin
        self.history.append(Stage(name, found.solid, error, seconds, found.losses, steps))
        return found

    def _optimum(self, start: LPSFound, method: Optimum) -> LPSFound:
        """The constrained optimum from one start; InputError where it was led out of a domain."""
        data = self.data
        return optimum(self.losses, data.lattices, start, data.conditions, method)

    def hold(self, method: Optimum, name: str, start: LPSFound) -> Optimum:
        """The method with the moduli of long waves, where it asks for them and free ones miss them.

        Free ones are those of one start, named as in stage 3, which keeps what it reached.
        """
        free = dataclasses.replace(method, moduli=method.held)
        if method.moduli != LONG_WAVES or self.data.noise:
            return free
        try:
            waves = lame_of_long_waves(self.data.sets)
            held = dataclasses.replace(method, moduli=(waves.lam, waves.mu))
            alone = self._optimum(start, free)
            model = alone.model(self.data.horizon)
            own = [moduli_of(model, classes) for classes in self.data.lattices]
            off = np.abs([(of["C12"] - waves.lam, of["C44"] - waves.mu) for of in own])
            sure = waves.errors.max() <= AGREE * (waves.lam + 2 * waves.mu)
            sure &= waves.misfit <= min(POOR, alone.loss**0.5)  # else the fit tells more than they
            apart = (off > SPREADS * waves.errors).any()
            beside = self._optimum(start, held) if sure and apart else alone
        except InputError:  # they do not tell, or a function is not defined where it was led
            return free
        taken = beside is not alone and beside.converged and beside.loss <= POOR**2
        self.known[name] = beside if taken else alone
        return held if taken else free

    def two_stage(self, rough: LPSFound, method: TwoStage, key: str) -> LPSFound:
        """Stages 1 and 2, from a rough start; `key` says what a checkpoint depends on."""
        unit = self.data.stiffness / USUAL_STIFFNESS
        first = self._run(
            "1 positive",
            lambda tick: fit_positive_kernel(self.data, rough, method, unit, tick=tick),
        )
        return self._run(
            "2 sign-changing",
            lambda tick: fit_signed_kernel(self.data, first, method, unit, key=key, tick=tick),
        )

    def adam(self, rough: LPSFound, method: Constrained, asked: Optimum) -> LPSFound:
        """Adam and the augmented Lagrangian on Warp's operator, from a rough start."""
        data = self.data
        law = LPSLaw(data.lattices, rough, data.conditions, asked)
        in_torch = TorchLaw(law, data.lattices, data.by_operator)
        problem = Regression(data.rows, law, law.zeta, 1.0)
        how: dict[str, Any] = {"steps": method.steps, "rounds": method.rounds}

        def run(tick: Tick) -> LPSFound:
            given = problem, law.start(rough), in_torch.loss
            margins = partial(in_torch.margins, cuts=problem.cuts)
            return law.found(*to_the_optimum(*given, margins, tick=tick, **how))

        return self._run("1 Adam", run)

    def optimum(self, starts: dict[str, LPSFound], method: Optimum) -> LPSFound:
        """Stage 3: the best of the constrained optima reached from all starts.

        Raises RuntimeError when no start ends with the conditions and the moduli kept.
        """
        return self._run("3 constrained", lambda tick: self._best(starts, method, tick))

    def _best(self, starts: dict[str, LPSFound], method: Optimum, tick: Tick) -> LPSFound:
        results = []
        for name, start in starts.items():
            try:
                reached = self.known.get(name) or self._optimum(start, method)
            except InputError as error:  # a function that is not defined where it was led
                failed = error
                continue
            tick(reached.loss)
            self.starts[name] = float(np.sqrt(reached.loss))
            results.append(reached)
        if not results:
            raise failed
        kept = [reached for reached in results if reached.converged]
        if not kept:
            margin = max(reached.margin for reached in results)
            closest = min(reached.departure for reached in results)
            raise RuntimeError(
                "stage 3: no start ended with the conditions kept; smallest margin "
                f"{margin:.1e}, moduli to be held missed by {closest:.1e} or more"
            )
        lowest = min(reached.loss for reached in kept)
        # Equal losses are one optimum: the first start is kept, whatever the rounding.
        return next(reached for reached in kept if reached.loss <= lowest * (1 + SAME_LOSS))

    def output(self, start: LPSFound, method: Optimum) -> LPSFound:
        """Stage 4: on from there to the least misfit of displacement.

        Raises RuntimeError when it ends with the conditions or the moduli not kept.
        """
        data = self.data
        responses = responses_of(data.sets, data.horizon, self.losses)

        def refined(tick: Tick) -> LPSFound:
            given = responses, data.lattices, start, data.conditions, method
            found = fit_output_error(*given, tick=tick)
            if not found.converged:
                raise RuntimeError(
                    f"stage 4: ended with a margin of {found.margin:.1e}, and moduli to be held "
                    f"missed by {found.departure:.1e}"
                )
            return found

        return self._run("4 output error", refined)


def worse_than_local(data: TrainingData, found: LPSFound) -> bool:
    """Whether the training displacement is better had from local elasticity of these moduli.

    Local elasticity is of central differences; sets of many unknowns are not solved for this.
    """
    if any(np.count_nonzero(each.interior) > MOST_NODES for each in data.sets):
        return False
    model = found.model(data.horizon, units=data.sets[0].points.units)
    C = from_voigt(plane_isotropic(model.lam, model.mu))
    errors = np.zeros(2)
    with quietly():
        for each in data.sets:
            own = evaluate(model, each, allow_uncertified=True)
            errors += [len(each) * table["E_u"] for table in (own, _local(C, each))]
    return bool(errors[0] > errors[1])


def _local(C: np.ndarray, samples: Samples) -> dict[str, Any]:
    """Errors of local elasticity, by the widest differences that the collar has nodes for."""
    h, no_axis = samples.spacing, dataclasses.replace(samples.points, axis=None)
    for reach in range(MOST_REACH, 1, -1):
        steps, tensors = difference_tensors(C, reach)
        try:
            law = Crystal(h, steps, tensors / h**2, samples.points.units)  # isotropic
            return evaluate(law, dataclasses.replace(samples, points=no_axis))
        except InputError:  # bonds reach beyond the collar
            continue
    return {"E_u": np.inf}


def learn(
    samples: Samples | Dataset | Sequence[Samples],
    horizon: float,
    kernel: Kernel = Bernstein(10),  # noqa: B008 (a frozen value)
    *,
    method: Method = Optimum(),  # noqa: B008
    conditions: Conditions = Conditions(),  # noqa: B008
    loss: str = "auto",
    noise: Samples | Sequence[Samples] | None = None,
    normalise: bool = False,
    progress: bool | None = None,
) -> Fit:
    """Learn λ, μ, α and D from displacement and load fields on one lattice or several.

    Args:
        samples: one set or several, on different lattices; of a Dataset `train`, or its only set.
            Interior nodes need the 2δ collar.
        horizon: δ [Å], at least one spacing.
        kernel: Bernstein polynomials, or on lattices a function of the bond length whose parameters
            are learned, from the values it has. Several functions are several starts, and the best
            is kept; a start that leads out of the domain of its function is passed over.
        method: Optimum() starts at the constrained optimum, from plain kernels; TwoStage() is
            Algorithm 1 of You et al. (2021); Constrained() takes Adam there, and checks it.
        conditions: what must hold on every lattice.
        loss: "residual" is (10); "corrected" takes off what noise adds to it; "output" goes on to
            fit displacement, at the wave vectors of the loads (`wave_vector` of the samples) or,
            for any loads, as solved with the collar given. "auto" takes the residual where noise
            does not matter or nothing is known of it, else "output" for loads at wave vectors,
            "corrected" for others.
        noise: fields of noise alone on the nodes of each training set, their loads of no account.
        normalise: divide each sample by ‖b‖ in the residual.
        progress: show a bar for each stage; None shows it on a terminal and in a notebook.

    Raises InputError for input that cannot be used, RuntimeError when the rows depart from Warp's
    operator or no start of stage 3 ends with the conditions and the moduli kept.
    """
    sets, quiet = listed(samples), listed(noise, "noise")
    shapes = check_choices(kernel, method, conditions)
    data = training_data(sets, horizon, conditions, quiet, normalise=normalise)
    ones = np.ones(1 + kernel.degree) if isinstance(kernel, Bernstein) else None
    starts = _shaped(data, shapes) if ones is None else _plain(ones, data.stiffness)
    probe = [*starts][:2][-1]  # from which the share of noise, and what moduli cost, are found
    choice = choose_loss(loss, data, starts[probe], method)
    stages = Stages(data, data.losses(choice.name), progress)
    if isinstance(method, TwoStage):
        asked = Optimum(moduli=None)
        depends = dataclasses.replace(method, checkpoint=None), kernel, data.conditions, normalise
        key = fingerprint(horizon, depends, sets)
        final = stages.two_stage(_random(kernel, method, data.stiffness), method, key)
    else:
        asked = method.optimum if isinstance(method, Constrained) else method
        asked = stages.hold(asked, probe, starts[probe])
        if isinstance(method, Constrained) and ones is not None:
            first = stages.adam(_random(kernel, method, data.stiffness), method, asked)
            starts = {"Adam": first} | starts
        final = stages.optimum(starts, asked)
        unasked = loss == "auto" and choice.name == "residual"
        if unasked and isinstance(asked.moduli, tuple) and worse_than_local(data, final):
            choice = LossSelection(
                "output", "the residual's optimum is worse than local elasticity"
            )
        if choice.name == "output":
            final = stages.output(final, asked)
    data.check(final.solid)
    _check_end(final, choice.name, data, method)
    return _certified(data, final, stages, FitSettings(data.conditions, asked.held), choice)


def check_choices(
    kernel: Kernel, method: Method, conditions: Conditions
) -> list[InfluenceFunction]:
    """The influence functions that were given; InputError for what is none or goes with nothing."""
    if not isinstance(conditions, Conditions):
        raise InputError(f"conditions: expected Conditions(…), got {conditions!r:.60}")
    if not isinstance(method, (TwoStage, Optimum, Constrained)):
        raise InputError(
            f"method: expected Optimum(…), TwoStage(…) or Constrained(…), got {method!r:.60}"
        )
    if isinstance(kernel, Bernstein):
        return []
    shapes = shapes_of(kernel)
    if not shapes:
        raise InputError(f"kernel: expected Bernstein(…) or influence functions, got {kernel!r}")
    if isinstance(method, TwoStage):
        raise InputError("kernel: influence functions are learned by Optimum or Constrained")
    return shapes


def _random(kernel: Any, method: TwoStage | Constrained, stiffness: float) -> LPSFound:
    """The random kernel that Adam starts from; as printed the constants are random too."""
    random = np.random.default_rng(method.seed)
    D = random.uniform(size=1 + kernel.degree)
    printed = isinstance(method, TwoStage) and method.parametrisation == "relu"
    lam, mu, alpha = random.uniform(size=3) if printed else (0.0, 1.0, 1.0)
    unit = stiffness / USUAL_STIFFNESS
    return LPSFound(Solid(lam * unit, mu * unit, alpha, D))


def _plain(ones: np.ndarray, stiffness: float) -> dict[str, LPSFound]:
    """Plain kernels to look for an optimum from, by name."""
    return {f"r^-{a:.3g}": LPSFound(Solid(0.0, stiffness, a, ones)) for a in PLAIN_EXPONENTS}


def _shaped(data: TrainingData, shapes: Sequence[InfluenceFunction]) -> dict[str, LPSFound]:
    """The functions that were given, with the values they have, by number and name."""
    lengths = np.concatenate([classes.r for classes in data.lattices])
    found = {}
    for number, shape in enumerate(shapes):
        D, _ = shape.coefficients(lengths, data.horizon)
        solid = Solid(0.0, data.stiffness / USUAL_STIFFNESS, 0.0, D)
        found[f"{number} {shape.name}"] = LPSFound(solid, shape)
    return found


def _check_end(final: LPSFound, loss: str, data: TrainingData, method: Method) -> None:
    """InputError for a fit that explains less than nothing: its loss is no less than without.

    A UserWarning says which modulus ended on its lower bound. The last loss is relative to the
    loads, or with "output" to the displacement.
    """
    if final.losses and not final.loss < 1:
        what = "displacements" if loss == "output" else "loads"
        raise InputError(
            f"u, b: the best model leaves {100 * math.sqrt(final.loss):.4g} % of the {what}, "
            "no less than no model: they do not belong together, or noise drowns them"
        )
    bound = HEADROOM * data.conditions.level
    if isinstance(method, TwoStage):
        bound = SMALLEST_MODULUS * data.stiffness / USUAL_STIFFNESS
    lam, mu = final.solid.lam, final.solid.mu
    ended = {"μ": mu, "λ + μ": lam + mu}
    low = [name for name, value in ended.items() if value <= bound * (1 + ON_BOUND)]
    if low:
        unit = symbols(data.sets[0].points.units)[1]
        warn(
            f"{' and '.join(low)} ended on the lower bound, {bound:.3g} {unit}, "
            f"where the data show a stiffness of {data.stiffness:.3g} {unit}: they do not "
            "determine it, or ask for less"
        )


def _certified(
    data: TrainingData,
    final: LPSFound,
    stages: Stages,
    settings: FitSettings,
    choice: LossSelection,
) -> Fit:
    """The model of these parameters with its certificate on every training lattice."""
    sets, asked = data.sets, data.conditions
    bare = final.model(data.horizon, units=sets[0].points.units)
    certificates = [certify(bare, spacing=points.spacing, points=points) for points in sets]
    certified = tuple(
        certificate.spacing
        for certificate in certificates
        if certificate.holds and (asked.kind != "paper" or bool(certificate.paper))
    )
    provenance = {"zeta": {"zeta": asked.zeta, "stiffness of the data": data.stiffness}}
    if final.shape is not None:
        lengths = np.concatenate([classes.r for classes in data.lattices])
        _, departure = final.shape.coefficients(lengths, data.horizon)
        provenance["influence"] = final.shape.record(departure)
    model = dataclasses.replace(
        bare,
        trained_on=tuple(points.spacing for points in sets),
        certified_on=certified,
        trained_strain=max(largest_strain(points, points.u) for points in sets),
        largest_wave_number=max(largest_wave_number(points) or 0.0 for points in sets) or None,
        certificate={f"{proof.spacing:g}": proof.figures() for proof in certificates},
        provenance=provenance,
        versions=_versions(),
    )
    moduli = [moduli_of(model, classes) for classes in data.lattices]
    history, starts = stages.history, stages.starts
    return Fit(model, certificates, moduli, history, starts, choice, settings, final.shape)


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in ("warp_peri", "warp-lang", "torch", "numpy", "scipy"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions
