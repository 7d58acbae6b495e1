"""Learning a model: the two stages of the paper, then the optimum its conditions allow."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version

import numpy as np
import torch
from tqdm import tqdm

from warp_peri.certificate import Certificate, certify
from warp_peri.conditions import Conditions, ZoneSearch
from warp_peri.dataset import PointSet
from warp_peri.errors import InputError
from warp_peri.full_loss import FullLoss
from warp_peri.model import Model
from warp_peri.optimum import constrained_optimum
from warp_peri.reduced import ReducedLoss, reduce
from warp_peri.symbol import moduli
from warp_peri.two_stage import Parameters, positive_stage, sign_changing_stage

METHODS = ("constrained", "two-stage", "optimum")
AGREEMENT = 1e-10
"""Reduced and full loss must agree to this, relative; their gradients to this times the
gradient's norm at the start."""
SAME_LOSS = 1e-6
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
class Fit:
    """A learned model and how it was learned.

    Attributes:
        model: the model; certified for the training spacing if its certificate holds.
        certificate: the certificate.
        moduli: long-wave moduli C11, C12, C44 of the discrete operator [TPa].
        history: the stages, in order.
        starts: E of stage 3 by start, the square root of its relative loss; empty when not run.
    """

    model: Model
    certificate: Certificate
    moduli: dict[str, float]
    history: list[Stage]
    starts: dict[str, float]


def fit(
    points: PointSet,
    *,
    horizon: float,
    degree: int,
    method: str = "constrained",
    conditions: str = "direct",
    zeta: float = 0.01,
    normalise: bool = False,
    seed: int = 0,
    progress: bool = False,
) -> Fit:
    """Learn λ, μ, α and D from displacement and load fields on a lattice.

    Args:
        points: training samples; interior nodes need the 2δ collar.
        horizon: δ [Å], at least one spacing.
        degree: M ≥ 0 of the Bernstein polynomials.
        method: "two-stage" is Algorithm 1 of You et al. (2021); "constrained" goes on from it to
            the constrained optimum; "optimum" starts at the optimum, from plain kernels.
        conditions: "direct", D(k) ≥ ζ s(k); "paper" asks for (i) and (iii) of (4.6) besides.
        zeta: ζ [TPa].
        normalise: divide each sample by ‖b‖ in the loss.
        seed: of the initial D.
        progress: show a progress bar for each stage.

    Raises InputError for input that cannot be used, RuntimeError when the reduced loss departs
    from the full one.
    """
    if method not in METHODS:
        raise InputError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    if not (isinstance(degree, (int, np.integer)) and degree >= 0):
        raise InputError(f"degree: expected a whole number ≥ 0, got {degree!r}")
    full = FullLoss(points, horizon, normalise=normalise)
    reduced = reduce(points, horizon, normalise=normalise)
    asked = Conditions(reduced.classes, conditions, zeta)
    oracle = _Oracle(reduced, full)
    history: list[Stage] = []

    def stage(name: str, run: Callable[[Callable[[float], None]], Parameters]) -> Parameters:
        begin = time.perf_counter()
        with tqdm(desc=name, unit=" steps", disable=not progress, leave=True) as bar:

            def tick(loss: float) -> None:
                bar.update()
                if bar.n % 100 == 0:
                    bar.set_postfix_str(f"relative residual {100 * np.sqrt(loss):.2f} %")

            found = run(tick)
        seconds = time.perf_counter() - begin
        error = full.mean_error(found.lam, found.mu, found.alpha, found.D)
        history.append(Stage(name, found, error, seconds, found.losses))
        return found

    rough = np.random.default_rng(seed).uniform(size=degree + 1)
    oracle.check(Parameters(0.0, 1.0, 1.0, rough))
    starts: dict[str, Parameters] = {}
    if method != "optimum":
        first = stage(
            "1 positive", lambda tick: positive_stage(reduced, degree, seed=seed, tick=tick)
        )
        final = second = stage(
            "2 sign-changing", lambda tick: sign_changing_stage(reduced, first, asked, tick=tick)
        )
        starts = {"stage 2": second, "stage 1": first}
    reached: dict[str, float] = {}
    if method != "two-stage":
        exponents = (second.alpha,) if starts else PLAIN_EXPONENTS
        for alpha in exponents:
            starts[f"r^-{alpha:.3g}"] = Parameters(0.0, 1.0, alpha, np.ones(degree + 1))

        def best(tick: Callable[[float], None]) -> Parameters:
            search = ZoneSearch(asked)
            found = {}
            for name, start in starts.items():
                found[name] = constrained_optimum(reduced, start, asked, search)
                reached[name] = float(np.sqrt(found[name].loss))
                tick(found[name].loss)
            kept = [one for one in found.values() if one.converged]
            if not kept:
                raise RuntimeError(
                    "stage 3: no start ended with the conditions kept; smallest "
                    f"margin {max(one.margin for one in found.values()):.1e} TPa"
                )
            lowest = min(one.loss for one in kept)
            # Equal losses are one optimum: the first start is kept, whatever the rounding.
            return next(one for one in kept if one.loss <= lowest * (1 + SAME_LOSS)).parameters

        final = stage("3 constrained", best)
    oracle.check(final)
    bare = Model(final.lam, final.mu, final.alpha, final.D, horizon)
    certificate = certify(bare, spacing=points.spacing, points=points)
    certified = certificate.holds and (conditions != "paper" or bool(certificate.schwarz))
    model = Model(
        final.lam,
        final.mu,
        final.alpha,
        final.D,
        horizon,
        trained_on=(points.spacing,),
        certified_on=(points.spacing,) if certified else (),
        certificate={f"{points.spacing:g}": certificate.figures()},
        versions=_versions(),
    )
    return Fit(model, certificate, moduli(model, reduced.classes), history, reached)


class _Oracle:
    """Holds the reduced loss to the full one and to the gradients of Warp's tape."""

    def __init__(self, reduced: ReducedLoss, full: FullLoss) -> None:
        self.reduced, self.full = reduced, full
        self.gradient_size: float | None = None

    def check(self, at: Parameters) -> None:
        """Compare at one point; the first one sets the size of the gradient."""
        results = []
        for path in ("reduced", "full"):
            numbers = [
                torch.tensor(value, dtype=torch.float64, requires_grad=True)
                for value in (at.lam, at.mu, at.alpha, at.D)
            ]
            lam, mu, alpha, D = numbers
            if path == "full":
                loss = self.full.loss(lam, mu, alpha, D)
            else:
                loss = self.reduced.loss(lam, mu, self.reduced.class_weights(alpha, D))
            gradient = torch.cat([g.reshape(-1) for g in torch.autograd.grad(loss, numbers)])
            results.append((loss.item(), gradient))
        (found, gradient), (expected, reference) = results
        self.gradient_size = self.gradient_size or float(reference.norm())
        if abs(found - expected) > AGREEMENT * expected:
            raise RuntimeError(
                f"the reduced loss {found:.15e} departs from the full {expected:.15e}"
            )
        difference = float((gradient - reference).norm())
        if difference > AGREEMENT * self.gradient_size:
            raise RuntimeError(
                f"the reduced gradient departs from Warp's tape by {difference:.1e}, "
                f"the gradient at the start is {self.gradient_size:.1e}"
            )


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in ("warp_peri", "warp-lang", "torch", "numpy", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
