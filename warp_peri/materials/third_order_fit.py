"""A third-order crystal learned by one least squares (theory, N28–N29)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from scipy.optimize import root

from warp_peri.core.elastic import checked_orientation
from warp_peri.core.pointwise import Pointwise
from warp_peri.core.stencil import Stencil
from warp_peri.errors import InputError, warn
from warp_peri.fitting.long_waves import long_wave_moduli, long_wave_rows, moduli_of
from warp_peri.fitting.regression import Settled
from warp_peri.fitting.result import Fit
from warp_peri.fitting.rows import load_sizes, norms, rows, swept
from warp_peri.materials.crystal_fit import Crystal, Tensors, one_set
from warp_peri.materials.third_order import (
    CUBIC,
    PlacedThirdOrder,
    Smoothing,
    ThirdOrderMaterial,
    energy_density,
    gradient_stencil,
)
from warp_peri.points.arguments import typed
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import bond_classes
from warp_peri.points.points import Samples, axis_of, lattice_steps

SETTLED = 1e-9
"""Relative, of moduli that are found."""


@typed
@dataclass(frozen=True)
class ThirdOrder:
    """A crystal with third-order elastic constants t3, tq2, q3 (theory, N1–N6, N22–N29).

    Attributes:
        linear: Crystal(…), whose tensors are learned with the constants by one least squares;
            its "auto" symmetry is "isotropic" here. "long waves" holds the moduli with which no
            long wave is left of the loads (N29).
        smoothing: of the data, which the weights of the gradient undo.
        form: "filtered", closer to the data, or "energy", whose force has an energy and can move.

    The direction of the crystal is stated by the samples' points (Points.axis). An LPS goes in by
    ThirdOrderMaterial(crystal_from_lps(model, spacing), …). Raises InputError for another linear
    part or smoothing; `fit` for another form, and where no moduli are held.

    >>> law = wp.ThirdOrder(wp.Crystal(10.0), wp.methods.Smoothing(10.0, 0.2), "energy")
    >>> wp.fit(samples, law).material.proven_strain(5.0) > 0
    True
    """

    linear: Crystal
    smoothing: Smoothing
    form: Literal["filtered", "energy"] = "filtered"

    def learn(
        self, samples: Samples | Dataset | Sequence[Samples], *, progress: bool | None = None
    ) -> Fit:
        """The fit: the residual is linear in tensors and constants; each sample counts by 1/‖b‖.

        Its errors have the mean relative residual on the training samples, E_res, and its history
        the largest |H| of these within reach of the interior. A UserWarning says where that is
        beyond the proven strain.

        Raises InputError for samples that do not carry twice the horizon, do not determine the law,
        or have no load.
        """
        begin, (asked, smoothing) = time.perf_counter(), (self.linear, self.smoothing)
        if asked.moduli is None:
            raise InputError("moduli: expected some that are held, beside third-order constants")
        given = one_set(samples)
        horizon, h = asked.horizon, given.spacing
        if given.points.dimension != 2:
            raise InputError("samples: expected a sheet; in space LPS and Crystal are learned")
        turn = np.eye(2)
        if asked.orientation is not None:
            turn = lattice_steps(given)[1].T @ checked_orientation(asked.orientation, 2)
        auto = isinstance(asked.symmetry, str) and asked.symmetry == "auto"
        tensors = Tensors(h, horizon, "isotropic" if auto else asked.symmetry, turn)
        weights = smoothing.weights(bond_classes(h, horizon), self.form)
        moduli, misfit = asked.held_moduli(turn), None
        learning = Learning(given, tensors, nonlinear_features(given, horizon, weights))
        if moduli is None:
            moduli, misfit = learning.found_moduli()
        found, _ = learning.at(moduli)
        linear = tensors.crystal(found, given.points.units, {})
        t3, tq2, q3 = found.p[0][len(tensors.bonds.basis) :]
        record = {
            "from": "fields",
            "loss": found.loss,
            "long_wave_misfit": misfit,
            "cuts": found.cuts,
            "numbers": len(found.p[0]),
        }
        law = ThirdOrderMaterial(
            linear, t3, tq2, q3, smoothing, self.form, float(horizon), provenance={"fit": record}
        ).certified()
        operator = PlacedThirdOrder(law, given.points)
        b = given.loads[:, given.interior]
        wrong = norms(operator(given.u) - b)
        largest = float(operator.largest_gradient(given.u).max())
        if largest > (proven := law.proven_strain(law.spacing)):
            warn(
                f"strain: solutions are proven unique up to |H| = {proven:.2%}, the training data "
                f"reach {largest:.2%}; a larger ridge of the smoothing than {smoothing.ridge:g} "
                "may prove more"
            )
        history = record | {"largest_gradient": largest, "seconds": time.perf_counter() - begin}
        return Fit(
            law, linear.certificate, {"E_res": float((wrong / learning.size).mean())}, history
        )


def nonlinear_features(
    points: Samples, horizon: float, weights: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """The force of t3, tq2, q3, λ and μ of Ψ, each at 1, along the nodes' axes, [S, I, 2, 5].

    Args:
        points: the samples, whose points state the axis of the crystal.
        horizon: δ [Å].
        weights: p_in and p_out by class, each of shape [C].
    """
    (steps, into), (_, out) = (gradient_stencil(points, horizon, p) for p in weights)
    energy, none = partial(energy_density, axis=axis_of(points)), np.zeros((2, 2, 2))
    numbers, columns = dict.fromkeys((*CUBIC, "lam", "mu"), 0.0), []
    operator = Pointwise(
        points, horizon, energy, steps, into, back=out, numbers=numbers,
        stencil=Stencil(points.spacing, np.eye(2, dtype=int), none),
    )  # fmt: skip
    for name in numbers:
        operator.take(numbers | {name: 1.0})
        columns.append(operator.force(points.u) @ lattice_steps(points)[1])
    return np.stack(columns, axis=-1)


class Learning:
    """The regression of tensors with columns of t3, tq2, q3, and of λ and μ in Ψ.

    Args:
        samples: the data.
        tensors: the linear part.
        extra: forces of the columns along the nodes' axes, [S, I, 2, 5].
    """

    def __init__(self, samples: Samples, tensors: Tensors, extra: np.ndarray) -> None:
        self.samples, self.tensors, self.extra = samples, tensors, extra
        self.size = load_sizes(samples)
        if not (self.size > 0).all():
            raise InputError(f"b: expected loads, got none on sample {int(np.argmin(self.size))}")
        self.R, self.y = rows(samples, tensors.bonds, weight=1 / self.size, extra=extra)
        if len(self.R) < self.R.shape[1]:
            raise InputError(
                f"data: expected enough to tell {self.R.shape[1]} numbers apart; give more loads"
            )

    def at(self, tensor: np.ndarray) -> tuple[Settled, np.ndarray]:
        """The fit with some moduli, and the numbers that belong to all columns."""
        lame = np.array([tensor[0, 0, 1, 1], tensor[0, 1, 0, 1]])  # Ψ has those of the tensors
        y = self.y - self.R[:, -2:] @ lame
        found = self.tensors.fitted(self.R[:, :-2], y, tensor)
        return found, np.concatenate([found.p[0], lame])

    def found_moduli(self) -> tuple[np.ndarray, float]:
        """The moduli with which what the law leaves of the loads has no long waves (N29)."""
        allowed, samples = self.tensors.allowed, self.samples
        values, kept, moments = long_wave_rows(samples, allowed, 0)
        place, seen, load = (np.cumsum(samples.interior) - 1)[kept], [], []
        for _, F, b in swept(samples, self.tensors.bonds, self.extra):
            seen.append(np.einsum("vn,snka->svka", values, F[:, place], optimize=True))
            load.append(np.einsum("vn,snk->svk", values, b[:, place], optimize=True))
        weight = 1 / self.size[:, None, None, None]
        long, right = np.concatenate(seen) * weight, np.concatenate(load) * weight[..., 0]
        own = long[..., -2:] @ np.array([[C[0, 0, 1, 1], C[0, 1, 0, 1]] for C in allowed]).T
        R = np.concatenate([moments * weight + own, long[..., -5:-2]], axis=-1)

        def left(c: np.ndarray) -> np.ndarray:
            return np.asarray(right - long @ self.at(np.tensordot(c, allowed, 1))[1])

        def change(c: np.ndarray) -> np.ndarray:
            return moduli_of(R, left(c))[0][: len(c)]

        guess = long_wave_moduli(samples, allowed)[0]
        start = np.linalg.lstsq(allowed.reshape(len(allowed), -1).T, guess.ravel())[0]
        c = root(change, start, tol=SETTLED).x
        misfit = np.linalg.norm(left(c)) / np.linalg.norm(right)
        return np.tensordot(c, allowed, 1), float(misfit)
