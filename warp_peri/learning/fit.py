"""Learning a model: the two stages of the paper, then the optimum its conditions allow."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import joblib
import numpy as np
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.learning.checkpoint import Checkpoint
from warp_peri.learning.loss_choice import LossChoice, choose_loss
from warp_peri.learning.margins import DenseMargins, SymbolMargins
from warp_peri.learning.optimum import ISOTROPIC, Optimum, constrained_optimum
from warp_peri.learning.options import METHODS
from warp_peri.learning.oracle import Oracle
from warp_peri.learning.output_error import STEPS, output_optimum
from warp_peri.learning.parameters import PARAMETRISATIONS, Parameters
from warp_peri.learning.two_stage import (
    EPOCHS,
    INNER_EPOCHS,
    OUTER_ITERATIONS,
    positive_stage,
    sign_changing_stage,
)
from warp_peri.losses.full import FullLoss, sample_weights
from warp_peri.losses.noise import corrected, noise_loss
from warp_peri.losses.reduced import ReducedLoss, reduce
from warp_peri.losses.response import responses_of
from warp_peri.models.lps import Model
from warp_peri.models.shapes import InfluenceFunction, shapes_of
from warp_peri.operator.symbol import moduli as moduli_of
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.points.strain import largest_strain
from warp_peri.stability.certificate import Certificate, certify
from warp_peri.stability.conditions import Conditions

CONSTRAINTS = ("symbol", "dense")
SAME_LOSS = 1e-6
CHECKED_DEGREE = 10
"""Of the kernel that reduced and full loss are compared at first, where none was asked for."""
PLAIN_EXPONENTS = (1.0, 2.0, 2.9)
"""Kernels r^(−α) that the method "optimum" starts from."""


@dataclass(frozen=True)
class Stage:
    """One stage of a fit: its result, E_res on the training set, and how long it took.

    `loss` is the trace of the reduced loss: by epoch (stages 1, 2) or round of cuts (stage 3).
    """

    name: str
    parameters: Parameters
    E_res_train: float
    seconds: float
    loss: list[float] = field(repr=False)


@dataclass(frozen=True)
class Settings:
    """What a fit was asked for: conditions on each lattice, and the options of `fit`."""

    conditions: list[Conditions]
    normalise: bool
    two_functions: bool
    moduli: tuple[float, float] | str | None


@dataclass(frozen=True)
class Fit:
    """A learned model and how it was learned.

    Attributes:
        model: the model; certified for the training spacing if its certificate holds.
        certificates: the certificate on each training lattice.
        moduli: long-wave moduli C11, C12, C44 of the discrete operator on each of them [TPa].
        history: the stages, in order.
        starts: E of stage 3 by start, the square root of its relative loss; empty when not run.
        loss: which loss was minimised, and why.
        settings: what was asked for.
        influence: the influence function with its learned parameters, where one was given.
    """

    model: Model
    certificates: list[Certificate]
    moduli: list[dict[str, float]]
    history: list[Stage]
    starts: dict[str, float]
    loss: LossChoice
    settings: Settings
    influence: InfluenceFunction | None = None

    @property
    def certificate(self) -> Certificate:
        """The certificate on the first training lattice."""
        return self.certificates[0]


def fit(
    points: Samples | Sequence[Samples],
    *,
    horizon: float,
    degree: int | None = None,
    influence: InfluenceFunction | Sequence[InfluenceFunction] | None = None,
    method: str = "constrained",
    conditions: str = "direct",
    zeta: float = 0.01,
    normalise: bool = False,
    loss: str = "auto",
    noise: Samples | Sequence[Samples] | None = None,
    two_functions: bool = False,
    moduli: tuple[float, float] | str | None = None,
    parametrisation: str = "projected",
    constraints: str = "symbol",
    checkpoint: str | os.PathLike[str] | None = None,
    lattice_spacing: float | None = None,
    seed: int = 0,
    jobs: int = 1,
    progress: bool = False,
) -> Fit:
    """Learn λ, μ, α and D from displacement and load fields on one lattice or several.

    Args:
        points: training samples, one set or several on different lattices or scattered points
            (each sample on its own if need be); interior nodes need the 2δ collar. Scattered
            points train on the full loss, by the two-stage method.
        horizon: δ [Å], at least one spacing.
        degree: M ≥ 0 of the Bernstein polynomials of the influence function.
        influence: in their place, a function of the bond length whose parameters are learned; on
            lattices, from the values it has, straight to the optimum. Several are several starts,
            of one function or of different ones, and the best of them is kept; a start from which
            the search leaves the domain of its function is passed over.
        method: "two-stage" is Algorithm 1 of You et al. (2021); "constrained" goes on from it to
            the constrained optimum; "optimum" starts at the optimum, from plain kernels.
        conditions: "direct", D(k) ≥ ζ s(k); "paper" asks for (i) and (iii) of (4.6) besides.
        zeta: ζ [TPa].
        normalise: divide each sample by ‖b‖ in the residual.
        loss: "residual" is (10); "corrected" takes off what noise adds to it; "output" goes on to
            fit displacement, at the wave vectors of the loads (`wave_vector` of the samples) or,
            for any loads, as solved with the collar given. "auto" takes the residual where noise
            does not matter or nothing is known of it, else "output" for loads at wave vectors,
            "corrected" for others.
        noise: fields of noise alone on the nodes of each training set, their loads of no account.
        two_functions: give the dilatation an influence function of its own.
        moduli: (λ, μ) [TPa] to hold at long waves on every lattice (8 Σ w ξ₁²ξ₂²/r² = 1 makes them
            the moduli of the discrete operator); "isotropic" holds that condition and learns λ
            and μ; None learns them freely. Not with "two-stage".
        parametrisation: of stages 1 and 2, "projected" or, as printed, "relu"; see Variables.
        constraints: of stage 2, "symbol" (over the zone) or, as printed and far slower, "dense"
            (eigenvalues on the training domain).
        lattice_spacing: for training sets of scattered points, which have no symbol: spacing [Å]
            of the lattice on which the conditions are kept.
        checkpoint: file that stage 2 keeps its state in and goes on from.
        seed: of the initial D of stage 1.
        jobs: threads for the starts of stage 3.
        progress: show a progress bar for each stage.

    Raises InputError for input that cannot be used, RuntimeError when the reduced loss departs
    from the full one or no start of stage 3 ends with the conditions and the moduli kept.
    """
    if method not in METHODS:
        raise InputError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    shapes = shapes_of(influence)
    if (degree is None) != bool(shapes):
        raise InputError("degree, influence: expected one of the two")
    if degree is not None and not (isinstance(degree, (int, np.integer)) and degree >= 0):
        raise InputError(f"degree: expected a whole number ≥ 0, got {degree!r}")
    if shapes and (method == "two-stage" or two_functions):
        raise InputError(
            "influence: a function of its own is learned by method='constrained' or 'optimum', "
            "one for both parts"
        )
    if not (isinstance(seed, (int, np.integer)) and seed >= 0):
        raise InputError(f"seed: expected a whole number ≥ 0, got {seed!r}")
    if parametrisation not in PARAMETRISATIONS:
        raise InputError(
            f"parametrisation: expected one of {', '.join(PARAMETRISATIONS)}, "
            f"got {parametrisation!r}"
        )
    if constraints not in CONSTRAINTS:
        raise InputError(
            f"constraints: expected one of {', '.join(CONSTRAINTS)}, got {constraints!r}"
        )
    if moduli is not None:
        if method == "two-stage":
            raise InputError("moduli: the two-stage method cannot hold them")
        if isinstance(moduli, str):
            if moduli != ISOTROPIC:
                raise InputError(f"moduli: expected (λ, μ) or {ISOTROPIC!r}, got {moduli!r}")
        elif not _are_moduli(moduli):
            raise InputError(f"moduli: expected (λ, μ) with μ > 0, λ + μ > 0, got {moduli!r:.60}")
    sets = [points] if isinstance(points, Samples) else list(points)
    if not sets:
        raise InputError("points: expected at least one training set, got none")
    weights = sample_weights(sets, normalise=normalise)
    full = [FullLoss(one, horizon, weight) for one, weight in zip(sets, weights)]
    scattered = any(one.spacing == 0 for one in sets)
    grids = []
    if not scattered:
        if lattice_spacing is not None:
            raise InputError("lattice_spacing: only for scattered points")
        grids = [reduce(one, horizon, weight) for one, weight in zip(sets, weights)]
        spacings = [one.spacing for one in sets]
    elif shapes:
        raise InputError("influence: a function of its own is learned on lattices only")
    elif method == "two-stage" and constraints == "symbol" and lattice_spacing is not None:
        spacings = [lattice_spacing]
    else:
        raise InputError(
            "points: scattered points need method='two-stage', constraints='symbol' and a "
            "lattice_spacing whose symbol keeps the conditions"
        )
    asked = [Conditions(bond_classes(h, horizon), conditions, zeta) for h in spacings]
    unloaded = [noise] if isinstance(noise, Samples) else list(noise or [])
    if unloaded and len(unloaded) != len(sets):
        raise InputError(f"noise: expected {len(sets)} sets, got {len(unloaded)}")
    added = [
        noise_loss(one, points, horizon, weight)
        for one, points, weight in zip(unloaded, sets if grids else [], weights)
    ]
    responds = method != "two-stage"
    terms = 1 + (CHECKED_DEGREE if degree is None else degree)
    random = np.random.default_rng(seed)
    D = random.uniform(size=terms)
    own = random.uniform(size=terms) if two_functions else None
    rough = Parameters(0.0, 1.0, 1.0, D, D_dilatation=own)
    plain = {f"r^-{a:.3g}": Parameters(0.0, 1.0, a, np.ones(terms)) for a in PLAIN_EXPONENTS}
    probe = Parameters(0.0, 1.0, 2.0, np.ones(terms))
    if shapes:
        lengths = np.concatenate([one.classes.r for one in asked])
        begin = [(shape, shape.coefficients(lengths, horizon)[0]) for shape in shapes]
        plain = {
            f"{number} {shape.name}": Parameters(0.0, 1.0, 0.0, D, shape=shape)
            for number, (shape, D) in enumerate(begin)
        }
        probe = next(iter(plain.values()))
    choice = choose_loss(loss, sets, grids, added, asked, horizon, probe, responds=responds)
    oracle = Oracle(grids, full)
    if added and choice.name != "residual":
        grids = [corrected(grid, R) for grid, R in zip(grids, added)]
    losses: Sequence[ReducedLoss | FullLoss] = grids or full
    history: list[Stage] = []

    def stage(
        name: str, most: int, run: Callable[[Callable[[float], None]], Parameters]
    ) -> Parameters:
        begin = time.perf_counter()
        with tqdm(desc=name, unit=" steps", total=most, disable=not progress) as bar:

            def tick(loss: float) -> None:
                bar.update()
                if bar.n % 100 == 0:
                    bar.set_postfix_str(f"relative residual {100 * np.sqrt(loss):.2f} %")

            found = run(tick)
            bar.total = bar.n  # a stage may end early
            bar.refresh()
        seconds = time.perf_counter() - begin
        errors = [one.errors(*_numbers(found)) for one in full]
        error = float(np.concatenate(errors).mean())
        history.append(Stage(name, found, error, seconds, found.losses))
        return found

    oracle.check(rough)
    starts = plain
    if method != "optimum" and not shapes:
        margins = DenseMargins(sets, horizon) if constraints == "dense" else SymbolMargins(asked)
        kept_in = None
        if checkpoint is not None:
            options = (horizon, degree, conditions, zeta, normalise, two_functions, seed, spacings)
            key = _key([*sets, *unloaded], *options, parametrisation, constraints, choice.name)
            kept_in = Checkpoint(checkpoint, key)
        first = stage(
            "1 positive",
            EPOCHS,
            lambda tick: positive_stage(losses, rough, parametrisation=parametrisation, tick=tick),
        )
        final = second = stage(
            "2 sign-changing",
            INNER_EPOCHS * OUTER_ITERATIONS,
            lambda tick: sign_changing_stage(
                losses,
                first,
                margins,
                parametrisation=parametrisation,
                checkpoint=kept_in,
                tick=tick,
            ),
        )
        bare = dataclasses.replace(probe, alpha=second.alpha)
        starts = {"stage 2": second, "stage 1": first, f"r^-{second.alpha:.3g}": bare}
    reached: dict[str, float] = {}
    if method != "two-stage":

        def best(tick: Callable[[float], None]) -> Parameters:
            def attempt(start: Parameters) -> Optimum | InputError:
                try:
                    return constrained_optimum(
                        grids, start, asked, two_functions=two_functions, moduli=moduli
                    )
                except InputError as error:  # a function that is not defined where it was led
                    return error

            run = joblib.Parallel(n_jobs=jobs, prefer="threads")
            results = []
            for name, one in zip(starts, run(map(joblib.delayed(attempt), starts.values()))):
                tick(np.nan if isinstance(one, InputError) else one.loss)
                if isinstance(one, InputError):
                    failed = one
                    continue
                reached[name] = float(np.sqrt(one.loss))
                results.append(one)
            if not results:
                raise failed
            kept = [one for one in results if one.converged]
            if not kept:
                best_margin = max(one.margin for one in results)
                closest = min(one.departure for one in results)
                raise RuntimeError(
                    "stage 3: no start ended with the conditions kept; smallest margin "
                    f"{best_margin:.1e} TPa, moduli to be held missed by {closest:.1e} TPa or more"
                )
            lowest = min(one.loss for one in kept)
            # Equal losses are one optimum: the first start is kept, whatever the rounding.
            found: Parameters = next(
                one for one in kept if one.loss <= lowest * (1 + SAME_LOSS)
            ).parameters
            return found

        final = third = stage("3 constrained", len(starts), best)
        if choice.name == "output":
            responses = responses_of(sets, horizon, grids)

            def refined(tick: Callable[[float], None]) -> Parameters:
                one = output_optimum(
                    responses,
                    third,
                    asked,
                    horizon,
                    two_functions=two_functions,
                    moduli=moduli,
                    tick=tick,
                )
                if not one.converged:
                    raise RuntimeError(
                        f"stage 4: ended with a margin of {one.margin:.1e} TPa, and moduli to be "
                        f"held missed by {one.departure:.1e} TPa"
                    )
                return one.parameters

            final = stage("4 output error", STEPS, refined)
    oracle.check(final)
    numbers = (final.lam, final.mu, final.alpha, final.D)
    uncertified = Model(*numbers, horizon, D_dilatation=final.D_dilatation)
    if scattered:
        certificates = [certify(uncertified, spacing=h) for h in spacings]
    else:
        certificates = [certify(uncertified, spacing=one.spacing, points=one) for one in sets]
    certified = tuple(
        one.spacing
        for one in certificates
        if one.holds and (conditions != "paper" or bool(one.paper))
    )
    provenance = {}
    if final.shape is not None:
        _, departure = final.shape.coefficients(lengths, horizon)
        provenance = {"influence": final.shape.record(departure)}
    model = dataclasses.replace(
        uncertified,
        trained_on=tuple(one.spacing for one in sets),
        certified_on=certified,
        trained_strain=max(largest_strain(one, one.u) for one in sets),
        certificate={f"{one.spacing:g}": one.figures() for one in certificates},
        provenance=provenance,
        versions=_versions(),
    )
    found = [moduli_of(model, one.classes) for one in asked]
    settings = Settings(asked, normalise, two_functions, moduli)
    return Fit(model, certificates, found, history, reached, choice, settings, final.shape)


def _are_moduli(given: Any) -> bool:
    """Whether it is (λ, μ) of a solid."""
    try:
        lam, mu = map(float, given)
    except (TypeError, ValueError):
        return False
    return bool(np.isfinite([lam, mu]).all() and mu > 0 and lam + mu > 0)


def _key(sets: Sequence[Samples], *settings: object) -> str:
    """Hash of the training data and settings."""
    digest = hashlib.sha256(repr(settings).encode())
    for points in sets:
        for values in (points.x, points.interior, points.u, points.loads):
            digest.update(values.tobytes())
    return digest.hexdigest()


def _numbers(at: Parameters) -> tuple[Any, ...]:
    """What lps_force takes after u."""
    own = () if at.D_dilatation is None else (at.D_dilatation,)
    return (at.lam, at.mu, at.alpha, at.D, *own)


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in ("warp_peri", "warp-lang", "torch", "numpy", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
