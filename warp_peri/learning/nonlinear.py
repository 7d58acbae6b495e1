"""Learning nonlinear solids: the linear optimum with three more columns (theory, N11–N12)."""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.learning.methods import Bernstein, Kernel, Method
from warp_peri.learning.response import as_model, products
from warp_peri.learning.result import Fit
from warp_peri.learning.training_data import Scale, held, scale_of
from warp_peri.points.families import BondClasses
from warp_peri.points.lattice import largest_strain
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import symbols
from warp_peri.regression.coordinates import Parameters
from warp_peri.regression.losses import Features, ReducedLoss, sample_weights, with_rows
from warp_peri.regression.optimum import constrained_optimum
from warp_peri.regression.settings import Optimum
from warp_peri.stability.certificate import certify
from warp_peri.third_order.fit import CONSTANTS, NonlinearFeatures
from warp_peri.third_order.material import NonlinearModel
from warp_peri.third_order.smoothing import Smoothing
from warp_peri.third_order.uniqueness import uniqueness

MOST_PASSES, SETTLED = 30, 1e-7
"""λ, μ and the weights of the energy form are carried over from pass to pass, until they change by
no more than this, relative."""
_BLOCK_BYTES = 2**27
AGREEMENT, ROUNDING = 1e-10, 1e-12
"""Rounding of the reduced residual beside the full one: relative, and of the loads."""


@dataclass(frozen=True)
class Nonlinear:
    """Third-order constants t3, tq2, q3 on the linear solid, to be learned with it.

    They follow long waves: moduli held isotropic, two influence functions and normalised samples
    are the better choice beside them. Geometric terms are held at 1.

    Attributes:
        smoothing: of the data, for the filtered form; None learns the energy form.

    The direction of the crystal is stated by the samples' points (Points.axis).

    Raises InputError for what is no smoothing.
    """

    smoothing: Smoothing | None = None

    def __post_init__(self) -> None:
        if not (self.smoothing is None or isinstance(self.smoothing, Smoothing)):
            raise InputError(
                f"smoothing: expected Smoothing(…) or None, got {self.smoothing!r:.60}"
            )


@dataclass(frozen=True)
class NonlinearFit:
    """A learned nonlinear model and how it was learned.

    Attributes:
        material: the model, with its guarantee.
        linear: the fit of the linear solid that it began with.
        passes: optima that were computed, each with the λ and μ of the one before.
        E_res_train: mean relative residual on the training samples.
        largest_gradient: largest |H| of the training samples within δ of the interior.
        seconds: of everything after the linear fit.
    """

    material: NonlinearModel
    linear: Fit
    passes: int
    E_res_train: float
    largest_gradient: float
    seconds: float


def check_nonlinear(
    nonlinear: Nonlinear,
    sets: Sequence[Samples],
    kernel: Kernel,
    method: Method,
    loss: str,
    noise: Sequence[Samples],
) -> None:
    """InputError for what the nonlinear solid is not learned from or with."""
    for name, given, kind in (
        ("nonlinear", nonlinear, Nonlinear),
        ("kernel", kernel, Bernstein),
        ("method", method, Optimum),
    ):
        if not isinstance(given, kind):
            raise InputError(
                f"{name}: expected {kind.__name__}(…) for a nonlinear solid, got {given!r:.60}"
            )
    if loss not in ("auto", "residual"):
        raise InputError(f"loss: a nonlinear solid has 'residual' only, got {loss!r}")
    if noise:
        raise InputError("noise: expected none for a nonlinear solid, whose residual it misleads")
    spacings = sorted({points.spacing for points in sets})
    if len(spacings) != 1 or not spacings[0] > 0:
        raise InputError(
            f"samples: a nonlinear solid is learned on lattices of one spacing, got {spacings}"
        )


def with_constants(
    linear: Fit, sets: Sequence[Samples], method: Optimum, nonlinear: Nonlinear
) -> NonlinearFit:
    """Learn t3, tq2, q3, and λ, μ and the kernels anew beside them, from the linear optimum on.

    Its λ and μ, and in the energy form its dilatation's weights, are those of Ψ in the next
    optimum, until they settle.

    Args:
        linear: fit of the linear solid to the residual.
        sets: its training samples.
        method: its search.
        nonlinear: form.

    A UserWarning names what may prove more where the data reach beyond the proven strain.

    Raises RuntimeError when an optimum does not keep its conditions, or the reduced loss departs
    from the full one.
    """
    begin = time.perf_counter()
    scale = scale_of(sets, linear.material.horizon, lengths=True)
    task = _Task(linear, sets, method, nonlinear, scale)
    inner, passes = task.settle()
    model = dataclasses.replace(
        inner,
        linear=scale.outer_model(inner.linear, linear.material),
        smoothing=nonlinear.smoothing,
        t3=inner.t3 * scale.stress,
        tq2=inner.tq2 * scale.stress,
        q3=inner.q3 * scale.stress,
    )
    model = _certified(model, sets, linear.material.versions)
    proven = tuple(h / scale.length for h in model.linear.certified_on)
    inner = dataclasses.replace(
        inner, linear=dataclasses.replace(inner.linear, certified_on=proven)
    )
    error, largest = task.check(inner)
    _warn_of_strain(model, largest, sets[0].spacing, linear.settings.conditions[0].zeta)
    seconds = time.perf_counter() - begin
    return NonlinearFit(model, linear, passes, error, largest, seconds)


def _certified(
    model: NonlinearModel, sets: Sequence[Samples], versions: dict[str, Any]
) -> NonlinearModel:
    """The model with its certificate, and up to which strain its solutions are unique."""
    certificate = certify(model.linear, spacing=sets[0].spacing)
    solid = dataclasses.replace(
        model.linear,
        trained_on=tuple(samples.spacing for samples in sets),
        certified_on=(sets[0].spacing,) if certificate.holds else (),
        trained_strain=max(largest_strain(samples, samples.u) for samples in sets),
        certificate={f"{certificate.spacing:g}": certificate.figures()},
        versions=versions,
    )
    model = dataclasses.replace(model, linear=solid)
    if not certificate.holds:
        return model
    proof = uniqueness(model, spacing=certificate.spacing)
    return dataclasses.replace(model, proven={f"{proof.spacing:g}": proof.figures()})


def _warn_of_strain(model: NonlinearModel, largest: float, spacing: float, zeta: float) -> None:
    """Say where training data reach beyond the proven strain, and which option proves more."""
    proven = model.proven_strain(spacing)
    if largest <= proven:
        return
    options = f"conditions=Conditions(zeta=…) with a larger ζ than {zeta:.3g}"
    if model.smoothing is not None:
        options = f"a larger ridge of the smoothing than {model.smoothing.ridge:g}, or " + options
    warnings.warn(
        f"strain: solutions are proven unique up to |H| = {proven:.2%}, the training data reach "
        f"{largest:.2%}; {options} {symbols(model.units)[1]} may prove more",
        stacklevel=5,
    )


class _Task:
    """The linear fit to begin with, its samples, and what they are to be fitted with.

    All of it in the units of a scale, which what is found is in too.
    """

    def __init__(
        self,
        linear: Fit,
        sets: Sequence[Samples],
        method: Optimum,
        nonlinear: Nonlinear,
        scale: Scale,
    ) -> None:
        self.sets = [scale.samples(samples) for samples in sets]
        self.horizon = linear.material.horizon / scale.length
        self.smoothing = nonlinear.smoothing
        if self.smoothing is not None:
            radius = self.smoothing.radius / scale.length
            self.smoothing = dataclasses.replace(self.smoothing, radius=radius)
        self.method = dataclasses.replace(method, moduli=scale.moduli(method.held))
        self.settings = scale.inner_settings(linear.settings)
        start = linear.history[-1].parameters
        lam, mu = start.lam / scale.stress, start.mu / scale.stress
        self.start = dataclasses.replace(start, lam=lam, mu=mu)
        self.classes = self.settings.conditions[0].classes
        self.weights = sample_weights(self.sets, normalise=self.settings.normalise)
        self.model = self._solid(self.start)
        self.loss = self._reduced()

    def settle(self) -> tuple[NonlinearModel, int]:
        """Optimum after optimum, each with the λ, μ and weights of the one before; how many."""
        parameters, settings, before = self.start, self.settings, None
        for passes in range(1, MOST_PASSES + 1):
            if self.smoothing is None and passes > 1:
                self.loss = self._reduced()
            lam, mu = parameters.lam, parameters.mu
            optimum = constrained_optimum(
                [self.loss.reduced(lam, mu)],
                parameters,
                settings.conditions[:1],
                self.method,
                two_functions=settings.two_functions,
            )
            if not optimum.converged:
                raise RuntimeError(
                    f"nonlinear stage: ended with a margin of {optimum.margin:.1e}, and moduli "
                    f"to be held missed by {optimum.departure:.1e}"
                )
            parameters = optimum.parameters
            constants = self.loss.constants(self._products(self._solid(parameters)), lam, mu)
            self.model = self._solid(parameters, *constants)
            now = np.concatenate([self.model.numbers, self.model.weights(self.classes)[0]])
            if before is not None and np.abs(now - before).max() <= SETTLED * np.abs(now).max():
                break
            before = now
        return self.model, passes

    def check(self, model: NonlinearModel) -> tuple[float, float]:
        """Mean residual, relative, and largest |H|; RuntimeError where the loss departs."""
        if self.smoothing is None:
            self.loss = self._reduced()  # with the weights that were settled on
        total, largest, errors = 0.0, 0.0, []
        for points, weight in zip(self.sets, self.weights):
            operator = model.on(points, allow_uncertified=True)
            largest = max(largest, float(operator.largest_gradient(points.u).max()))
            b = points.loads[:, points.interior]
            left = np.linalg.norm((operator(points.u) - b).reshape(len(b), -1), axis=1)
            total += float(weight @ left**2)
            errors.append(left / np.linalg.norm(b.reshape(len(b), -1), axis=1))
        constants, linear = np.array([model.t3, model.tq2, model.q3]), model.linear
        loss = self.loss.loss(constants, self._products(model), linear.lam, linear.mu)
        reduced, full = np.sqrt((loss, total))
        held("residual", abs(reduced - full), AGREEMENT * full + ROUNDING, full)
        return float(np.concatenate(errors).mean()), largest

    def _reduced(self) -> GradientLoss:
        weights = self.model.weights(self.classes)
        return reduce_nonlinear(self.sets, self.horizon, self.weights, weights)

    def _products(self, model: NonlinearModel) -> np.ndarray:
        return products(model.linear, self.classes)

    def _solid(
        self, parameters: Parameters, t3: float = 0.0, tq2: float = 0.0, q3: float = 0.0
    ) -> NonlinearModel:
        units = self.sets[0].points.units
        linear = dataclasses.replace(as_model(parameters, self.horizon), units=units)
        return NonlinearModel(linear, t3, tq2, q3, smoothing=self.smoothing)


@dataclass(frozen=True)
class GradientLoss:
    """The loss of a nonlinear solid with given p_in and p_out on one lattice.

    Attributes:
        classes: bond classes of the lattice.
        R: triangular factor of the columns t3, tq2, q3, the F linear ones, λ and μ of the
            geometric terms, and −b: shape [F + 6, F + 6].
        pairs: class numbers of each quadratic feature, shape [2, C (C + 1) / 2].
    """

    classes: BondClasses
    R: np.ndarray
    pairs: np.ndarray

    def reduced(self, lam: float, mu: float) -> ReducedLoss:
        """The loss of the linear part, geometric terms at λ, μ [TPa], constants at their best."""
        rows = self.R[CONSTANTS:, CONSTANTS:]
        right = rows[:, -3:] @ (lam, mu, 1.0)
        folded = np.column_stack([rows[:, :-3], right])
        return ReducedLoss(self.classes, np.asarray(np.linalg.qr(folded, mode="r")), self.pairs)

    def constants(self, products: np.ndarray, lam: float, mu: float) -> np.ndarray:
        """The best t3, tq2 and q3 [TPa] beside c of (17), shape [F + 1]; back-substitution."""
        others = np.concatenate([products[:-1], (lam, mu, 1.0)])
        top = self.R[:CONSTANTS]
        best: np.ndarray = np.linalg.solve(top[:, :CONSTANTS], -top[:, CONSTANTS:] @ others)
        return best

    def loss(self, constants: np.ndarray, products: np.ndarray, lam: float, mu: float) -> float:
        """Σ_s weight_s ‖L u − b‖² of any constants."""
        e = self.R @ np.concatenate([constants, products[:-1], (lam, mu, 1.0)])
        return float(e @ e)


def reduce_nonlinear(
    sets: Sequence[Samples],
    horizon: float,
    sample_weights: Sequence[np.ndarray],
    weights: tuple[np.ndarray, np.ndarray],
) -> GradientLoss:
    """Sweep data once and factorise their features.

    Args:
        sets: samples on lattices of one spacing, each with an axis of the crystal.
        horizon: δ [Å].
        sample_weights: of each sample of each set in the loss, shape [S].
        weights: p_in and p_out by class, each of shape [C].

    Raises InputError for sets of several spacings or without the collar.
    """
    spacings = sorted({points.spacing for points in sets})
    if len(spacings) != 1:
        raise InputError(f"points: expected lattices of one spacing, got {spacings}")
    R = np.zeros((0, 0))
    for points, weight in zip(sets, sample_weights):
        features = Features(points, horizon)
        nonlinear = NonlinearFeatures(points, horizon, weights)
        columns = features.width + 6
        R = R if R.size else np.zeros((0, columns))
        block = max(1, _BLOCK_BYTES // (16 * columns * np.count_nonzero(points.interior)))
        for first in range(0, len(points), block):
            some = slice(first, first + block)
            more = nonlinear(points.u[some])
            parts = [more[:, :, :3], features(points.u[some]), more[:, :, 3:]]
            parts.append(-points.loads[some][:, points.interior, None, :])
            rows = np.concatenate(parts, axis=2) * np.sqrt(weight[some, None, None, None])
            R = with_rows(R, rows.transpose(0, 1, 3, 2).reshape(-1, columns))
    return GradientLoss(features.classes, R, features.pairs)
