"""Learning a model: training data once, the loss, the method, checks, the certificate."""

from __future__ import annotations

import dataclasses
import math
import platform
import warnings
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import fingerprint
from warp_peri.learning.methods import Bernstein, Constrained, Kernel, Method, TwoStage
from warp_peri.learning.response import as_model
from warp_peri.learning.result import Fit, LossChoice, Settings
from warp_peri.learning.stages import Stages, choose_loss
from warp_peri.learning.training_data import (
    ConsistencyCheck,
    Scale,
    TrainingData,
    listed,
    scaled_data,
)
from warp_peri.materials.certificate import certify
from warp_peri.materials.influence import InfluenceFunction, shapes_of
from warp_peri.materials.lps import moduli as moduli_of
from warp_peri.points.dataset import Dataset
from warp_peri.points.lattice import check_lattice, largest_strain
from warp_peri.points.samples import Samples, largest_wave_number
from warp_peri.points.unit_names import symbols
from warp_peri.regression.coordinates import SMALLEST_MODULUS, Parameters
from warp_peri.regression.optimum import HEADROOM, Conditions
from warp_peri.regression.settings import Optimum

ON_BOUND = 1e-3
"""A modulus this near its bound, relative, has ended there."""


def check_explained(final: Parameters, loss: str) -> None:
    """Raise InputError for a fit that explains less than nothing: its loss is no less than without.

    The last loss of the search is relative to the loads, or with "output" to the displacement.
    """
    if final.losses and not final.losses[-1] < 1:
        what = "displacements" if loss == "output" else "loads"
        raise InputError(
            f"u, b: the best model leaves {100 * math.sqrt(final.losses[-1]):.4g} % of the {what}, "
            "no less than no model: they do not belong together, or noise drowns them"
        )


def warn_of_bounds(final: Parameters, data: TrainingData, scale: Scale, method: Method) -> None:
    """Warn of a modulus that ended on its lower bound; all but the scale in the fit's own units."""
    zeta = HEADROOM * data.conditions[0].zeta
    bound = SMALLEST_MODULUS if isinstance(method, TwoStage) else zeta
    moduli = {"μ": final.mu, "λ + μ": final.lam + final.mu}
    low = [name for name, value in moduli.items() if value <= bound * (1 + ON_BOUND)]
    if low:
        unit = symbols(scale.units)[1]
        warnings.warn(
            f"{' and '.join(low)} ended on the lower bound, {bound * scale.stress:.3g} {unit}, "
            f"where the data show a stiffness of {scale.stiffness:.3g} {unit}: they do not "
            "determine it, or ask for less",
            stacklevel=3,
        )


CHECKED_DEGREE = 10
"""Of the kernel that reduced and full loss are compared at first, where none was asked for."""
PLAIN_EXPONENTS = (1.0, 2.0, 2.9)
"""Kernels r^(−α) that an optimum is looked for from."""
PROBED = "r^-2"
"""Of these the one from which the share of noise, and what held moduli cost, are found."""


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
        samples: one set or several, on different lattices or scattered points (each sample on its
            own if need be); of a Dataset `train`, or its only set. Interior nodes need the 2δ
            collar. Scattered points train on the full loss, by TwoStage.
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

    Raises InputError for input that cannot be used, RuntimeError when the reduced loss departs
    from the full one or no start of stage 3 ends with the conditions and the moduli kept.
    """
    sets, quiet = listed(samples), listed(noise, "noise")
    shapes = check_choices(kernel, method, conditions)
    carrier = method.lattice_spacing if isinstance(method, TwoStage) else None
    for each in sets if carrier is None else ():
        check_lattice(each)
    given, steps = (sets, horizon, conditions, quiet, carrier), not isinstance(method, TwoStage)
    data, scale = scaled_data(*given, normalise=normalise, lengths=not shapes, steps=steps)
    method = scale.method(method)
    bernstein = kernel if isinstance(kernel, Bernstein) else None
    starts = _shaped(data, shapes) if bernstein is None else _plain(bernstein)
    probe = next((name for name in starts if name == PROBED), next(iter(starts)))
    choice = choose_loss(loss, data, starts[probe], responds=steps)
    consistency = ConsistencyCheck(data.grids, data.full)
    rough = _rough(bernstein, method)
    consistency.check(rough)
    stages = Stages(data, data.losses(choice.name), progress)
    optimum = stages.hold(_second(method), probe, starts[probe])
    depends = (bernstein, conditions, normalise, choice.name)
    final = _learned(stages, starts, rough, method, optimum, depends)
    unasked = steps and loss == "auto" and choice.name == "residual"
    if unasked and isinstance(optimum.moduli, tuple) and stages.worse_than_local(final):
        choice = LossChoice("output", "the residual's optimum is worse than local elasticity")
        final = stages.output(final, optimum)
    consistency.check(final)
    check_explained(final, choice.name)
    warn_of_bounds(final, data, scale, method)
    kept = scale.lattice_conditions(data, horizon)
    held = scale.moduli(optimum.held, back=True)
    settings = Settings(kept, held)
    return _certified(sets, scale.parameters(final), stages.ended(scale), choice, settings, scale)


def _learned(
    stages: Stages,
    starts: dict[str, Parameters],
    rough: Parameters,
    method: Method,
    optimum: Optimum,
    depends: tuple[Bernstein | None, Conditions, bool, str],
) -> Parameters:
    """The stages of a method, one after the other, its optimum with the moduli that are held.

    `depends` is what a checkpoint depends on.
    """
    kernel, _, _, loss = depends
    if kernel is not None and isinstance(method, TwoStage):
        first, data = method, stages.data
        asked = (dataclasses.replace(first, checkpoint=None), *depends)
        key = fingerprint(data.horizon, data.spacings, asked, data.sets, data.noise)
        return stages.two_stage(rough, first, key)
    if kernel is not None and isinstance(method, Constrained):
        starts = {"Adam": stages.lagrangian(rough, method, optimum)} | starts
    final = stages.optimum(starts, optimum)
    return stages.output(final, optimum) if loss == "output" else final


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


def _second(method: Method) -> Optimum:
    """Settings of the search for the optimum; a fit without it holds no moduli."""
    if isinstance(method, Optimum):
        return method
    return method.optimum if isinstance(method, Constrained) else Optimum(moduli=None)


def _rough(kernel: Bernstein | None, method: Method) -> Parameters:
    """The random kernel that Algorithm 1 starts from and the consistency looks at first.

    As printed the constants are random too, in the units of the fit.
    """
    random = np.random.default_rng(0 if isinstance(method, Optimum) else method.seed)
    terms = 1 + (CHECKED_DEGREE if kernel is None else kernel.degree)
    D = random.uniform(size=terms)
    printed = isinstance(method, TwoStage) and method.parametrisation == "relu"
    lam, mu, alpha = random.uniform(size=3) if printed else (0.0, 1.0, 1.0)
    return Parameters(lam, mu, alpha, D)


def _plain(kernel: Bernstein) -> dict[str, Parameters]:
    """Plain kernels to look for an optimum from, by name."""
    ones = np.ones(1 + kernel.degree)
    return {f"r^-{a:.3g}": Parameters(0.0, 1.0, a, ones) for a in PLAIN_EXPONENTS}


def _shaped(data: TrainingData, shapes: Sequence[InfluenceFunction]) -> dict[str, Parameters]:
    """The functions that were given, with the values they have."""
    lengths = np.concatenate([lattice.classes.r for lattice in data.conditions])
    begin = [(shape, shape.coefficients(lengths, data.horizon)[0]) for shape in shapes]
    return {
        f"{number} {shape.name}": Parameters(0.0, 1.0, 0.0, D, shape=shape)
        for number, (shape, D) in enumerate(begin)
    }


def _certified(
    sets: Sequence[Samples],
    final: Parameters,
    stages: Stages,
    choice: LossChoice,
    settings: Settings,
    scale: Scale,
) -> Fit:
    """The model of these parameters with its certificate on every training lattice."""
    asked = settings.conditions
    horizon = asked[0].classes.horizon
    bare = dataclasses.replace(as_model(final, horizon), units=sets[0].points.units)
    if all(points.spacing > 0 for points in sets):
        certificates = [certify(bare, spacing=points.spacing, points=points) for points in sets]
    else:
        certificates = [certify(bare, spacing=lattice.classes.spacing) for lattice in asked]
    certified = tuple(
        certificate.spacing
        for certificate, lattice in zip(certificates, asked)
        if certificate.holds and (lattice.kind != "paper" or bool(certificate.paper))
    )
    provenance = {"zeta": {"zeta": asked[0].zeta, "stiffness of the data": scale.stiffness}}
    if final.shape is not None:
        lengths = np.concatenate([lattice.classes.r for lattice in asked])
        _, departure = final.shape.coefficients(lengths, horizon)
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
    moduli = [moduli_of(model, lattice.classes) for lattice in asked]
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
