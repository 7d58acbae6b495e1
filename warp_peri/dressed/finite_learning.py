"""A dressed sheet at finite strain, learned from fields (theory.md, D19–D20)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from warp_peri.core.elastic import from_voigt
from warp_peri.dressed.finite import FiniteSolid, stress, third_derivatives
from warp_peri.dressed.finite_body import FiniteBody, Slopes, gathered, gradients
from warp_peri.dressed.learning import third_order_moduli
from warp_peri.errors import InputError
from warp_peri.micromodulus.laws import one_set
from warp_peri.points.axis import axis_of
from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples
from warp_peri.third_order.smoothing import Smoothing

CONVERGED, ISOTROPIC = 1e-8, 1e-6
"""Relative, of the loss, and of moduli."""
STEP = 1e-4
"""Of differences of the loss to along, across and share."""


@dataclass(frozen=True)
class FiniteFit:
    """A learned solid.

    Attributes:
        material: the solid.
        history: loss, mean E_res, largest |H| of the samples.
    """

    material: FiniteSolid
    history: dict[str, Any]


@dataclass(frozen=True)
class FiniteStrain:
    """W = Ψ₂(E(∇G u)) + Ψ₃(E(∇F u)) of an isotropic sheet with third-order constants (D14).

    Attributes:
        moduli: a Voigt matrix [stress], or the Smoothing of the data, of which those of their long
            waves are found with third order taken off (D20). They are held.
    """

    moduli: Any

    def learn(self, samples: Samples | Dataset, *, progress: bool | None = None) -> FiniteFit:
        """The fit on one set of samples, which state the crystal's axis.

        Raises InputError for samples without a collar, without loads, or in space, and for moduli
        that are not isotropic.
        """
        return fit_finite(one_set(samples), self.moduli)


def fit_finite(samples: Samples, moduli: Any) -> FiniteFit:
    """The numbers that fit L u = b best, each sample weighed by 1/‖b‖; as FiniteStrain.learn."""
    found = _FiniteFit(samples)
    C = third_order_moduli(samples, moduli) if isinstance(moduli, Smoothing) else from_voigt(moduli)
    pair = np.array([C[0, 0, 1, 1], C[0, 1, 0, 1]])
    if C.shape != (2,) * 4 or abs(C[0, 0, 0, 0] - pair[0] - 2 * pair[1]) > ISOTROPIC * pair[1]:
        raise InputError("moduli: expected those of an isotropic sheet")
    record = found.settle(pair) | {"from": "fields", "samples": len(samples.u), "numbers": 6}
    own: dict[str, Any] = {"units": samples.points.units, "provenance": {"fit": record}}
    solid = FiniteSolid(samples.spacing, *pair, *found.q, *found.constants, **own)
    body = FiniteBody(solid, samples.points)
    wrong = np.linalg.norm((body(samples.u) - found.b).reshape(len(found.b), -1), axis=1)
    history = record | {
        "E_res": float((wrong / found.size).mean()),
        "largest_gradient": float(body.largest_gradient(samples.u).max()),
    }
    return FiniteFit(solid, history)


class _FiniteFit:
    """Forces of the samples as a function of along, across, share, and linear in the rest.

    Attributes:
        q: along, across, share.
        constants: t3, tq2, q3 at their best.
        b, size: loads of the interior [S, I, 2] and their norms.
    """

    def __init__(self, samples: Samples) -> None:
        if samples.points.dimension != 2:
            raise InputError("samples: finite strain is for sheets, got nodes in space")
        self.samples, self.slopes = samples, Slopes(samples.points)
        self.b = samples.loads[:, samples.interior]
        self.size = np.linalg.norm(self.b.reshape(len(self.b), -1), axis=1)
        if not (self.size > 0).all():
            raise InputError(f"b: expected loads, got none on sample {int(np.argmin(self.size))}")
        own = self.slopes.plain
        self._bases = [own, *(own @ shell for shell in self.slopes.shells)]
        self._H = [gradients(D, samples.u) for D in self._bases]
        unknown = np.flatnonzero(samples.interior)
        self._own = [D.tocsc()[:, unknown].tocsr() for D in self._bases]
        turn = np.exp(-6j * axis_of(samples.points))
        none = np.zeros((3, 3, 3))
        self._plain = [
            (np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0.0]]), none),
            (np.diag([2.0, 2.0, 1.0]), none),
        ]
        three = [third_derivatives(*row) for row in ((1, 0, 0j), (0, 1, 0j), (0, 0, turn))]
        self._cubic = [(np.zeros((3, 3)), T) for T in three]
        self.q, self.constants = np.zeros(3), np.zeros(3)

    def _columns(self, H: np.ndarray, D: Any, kinds: list[Any]) -> np.ndarray:
        """Forces of energies with unit constants, [S, I, 2, n]."""
        return np.stack([gathered(D, stress(H, C, T)) for C, T in kinds], axis=-1)

    def columns(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of λ and μ under G, and of t3, tq2 and q3 under F."""
        (H, first, second), (D, one, two) = self._H, self._own
        plain = self._columns(
            H + q[0] * first + q[1] * second, D + q[0] * one + q[1] * two, self._plain
        )
        return plain, self._columns(H + q[2] * first, D + q[2] * one, self._cubic)

    def _left(self, q: np.ndarray, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the best constants leave, over ‖b‖, and those constants."""
        plain, cubic = self.columns(q)
        weight = 1 / self.size[:, None, None] / len(self.size) ** 0.5
        y = ((self.b - plain @ pair) * weight).ravel()
        R = (cubic * weight[..., None]).reshape(-1, 3)
        best = np.linalg.lstsq(R, y)[0]
        return y - R @ best, best

    def settle(self, pair: np.ndarray) -> dict[str, Any]:
        """Find q and the constants of some moduli; the loss, and its evaluations."""
        answer = least_squares(
            lambda q: self._left(q, pair)[0], self.q, diff_step=STEP, x_scale=0.1,
            xtol=CONVERGED, ftol=CONVERGED, gtol=CONVERGED,
        )  # fmt: skip
        self.q = answer.x
        left, self.constants = self._left(self.q, pair)
        return {"loss": float(np.linalg.norm(left)), "evaluations": answer.nfev}
