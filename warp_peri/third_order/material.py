"""A crystal with third-order elastic constants, and its files (theory, N1–N6, N22–N24).

Of sheets whose long waves are isotropic: crystals with three- or sixfold axes, as graphene. The
linear part is a crystal of micromodulus tensors; an LPS goes in by tensors_of(model, spacing).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from warp_peri.contract import SAME_SPACING
from warp_peri.core.record import Length, OnLinear, Stress
from warp_peri.errors import InputError
from warp_peri.micromodulus.crystal_fit import transferred
from warp_peri.micromodulus.law import Crystal
from warp_peri.points.families import BondClasses
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike
from warp_peri.points.unit_names import check_same, shown_moduli
from warp_peri.third_order.operator import PlacedThirdOrder
from warp_peri.third_order.smoothing import Smoothing, gradient_weights
from warp_peri.third_order.uniqueness import check_strain, uniqueness

FORMS = ("filtered", "energy")
CUBIC = ("t3", "tq2", "q3")
ISOTROPIC = 1e-6
"""Relative, by which moduli of long waves may miss C11 = C12 + 2 C44."""

_known: dict[tuple[str, float], ThirdOrderCrystal] = {}
"""Laws that were transferred, by the hash of their content and the spacing."""


@dataclass(frozen=True, eq=False, repr=False)
class ThirdOrderCrystal(OnLinear, format="warp_peri.third_order_crystal"):
    """A law of micromodulus tensors and the energy Ψ of a displacement gradient (N1–N6, N22).

    Attributes:
        linear: the tensors, which are the tangent at zero; the λ and μ of their long waves are
            those of Ψ.
        t3, tq2, q3: third-order elastic constants [stress], q3 in the frame of the crystal, whose
            zigzag direction the points state (Points.axis).
        smoothing: of the data, where the weights of the gradient undo it.
        form: "filtered", or "energy", whose tangent is symmetric.
        reach: horizon of the gradient [length].
        proven: figures of the guarantee of uniqueness on the spacing of the law.
        provenance: of the data and the fit; plain JSON values.

    Raises InputError for numbers that are none, a law in space, and moduli of long waves that are
    not isotropic, which Ψ is not made for.
    """

    linear: Crystal
    t3: Stress
    tq2: Stress
    q3: Stress
    smoothing: Smoothing
    form: str
    reach: Length
    proven: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    ORDER = ("linear", *CUBIC, "form", "reach", "proven", "provenance", "smoothing")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form not in FORMS:
            raise InputError(f"form: expected one of {', '.join(FORMS)}, got {self.form!r:.50}")
        if self.linear.dimension != 2:
            raise InputError("linear: third-order constants are for sheets, got a model in space")
        C = self.linear.tensor()
        shear, miss = C[0, 1, 0, 1], _anisotropy(C)
        if miss > ISOTROPIC * abs(shear):
            raise InputError(
                f"linear: third-order constants are for isotropic long waves, got C11, C22, C16 or "
                f"C26 off by {miss / shear:.1e} of the shear modulus; symmetry='isotropic' has them"
            )

    @property
    def spacing(self) -> float:
        """Of the nodes."""
        return self.linear.spacing

    @property
    def horizon(self) -> float:
        """Of the longest bond that tensors or gradient have."""
        return max(self.linear.horizon, self.reach)

    @property
    def lame(self) -> tuple[float, float]:
        """λ and μ of long waves [stress]."""
        C = self.linear.tensor()
        return C[0, 0, 1, 1], C[0, 1, 0, 1]

    @property
    def numbers(self) -> np.ndarray:
        """λ, μ, t3, tq2 and q3 [stress], shape [5]."""
        return np.array([*self.lame, self.t3, self.tq2, self.q3])

    def weights(self, classes: BondClasses) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/length²], each of shape [C]."""
        return gradient_weights(self.smoothing, self.form, classes)

    def on(
        self, points: PointsLike, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> PlacedThirdOrder:
        """The law on a lattice, its tensors transferred; as PlacedThirdOrder."""
        asked = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        return PlacedThirdOrder(self, points, **asked)

    def proven_strain(self, spacing: float) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        here = abs(spacing / self.spacing - 1) <= SAME_SPACING
        return float(self.proven.get("strain", 0.0)) if here else 0.0

    def at(
        self, points: Points, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> ThirdOrderCrystal:
        """The law for the spacing of the points: its tensors transferred, proven anew.

        Constants, smoothing and reach belong to the material and go along; the weights follow the
        lattice.

        Raises InputError for other units, scattered points, and tensors without a certificate.
        """
        check_same(self.units, points.units)
        if not points.spacing > 0:
            raise InputError("points: a third-order crystal is for lattices, got scattered points")
        here = self
        if abs(points.spacing / self.spacing - 1) > SAME_SPACING:
            if not transfer:
                raise InputError(
                    f"spacing: the model is for {self.spacing:g}, the points have "
                    f"{points.spacing:g}, and transfer=False"
                )
            key = (self.content()["sha256"], points.spacing)
            if key not in _known:
                linear = transferred(self.linear, points.spacing)
                _known[key] = replace(self, linear=linear, proven={}).certified()
            here = _known[key]
        proof = here.linear.certificate
        if proof is None or not proof.holds:
            said = "the crystal model has no certificate on this lattice"
            if not allow_uncertified:
                raise InputError(f"certificate: {said}; allow_uncertified=True takes them")
            warnings.warn(f"certificate: {said}", stacklevel=4)
        return here

    def certified(self) -> ThirdOrderCrystal:
        """The law with its guarantee of uniqueness, where its tensors are certified (N14)."""
        proof = self.linear.certificate
        if proof is None or not proof.holds:
            return self
        return replace(self, proven=uniqueness(self, spacing=self.spacing).figures())

    def check_proofs(self) -> None:
        """As of a Record, of the strain up to which solutions are said to be unique."""
        if self.proven:
            check_strain(self.proven, partial(uniqueness, self, spacing=self.spacing))

    def elsewhere(self, length: float, stress: float) -> dict[str, Any]:
        """Of what is proven the strain, which has no unit, goes along."""
        return {"proven": {k: v for k, v in self.proven.items() if k == "strain"}}

    def summary(self) -> dict[str, Any]:
        """Constants, moduli and guarantee as plain values."""
        own = {name: getattr(self, name) for name in (*CUBIC, "form", "reach", "proven")}
        return own | {"moduli": self.linear.moduli(), "bonds": self.linear.bonds}

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, those of the tensors last."""
        shown = shown_moduli(self.units, (getattr(self, name) for name in CUBIC))
        rows = [("form", self.form), (", ".join(CUBIC), shown)]
        if self.proven.get("strain"):
            rows.append(("proven", f"one solution up to |H| = {self.proven['strain']:.2%}"))
        return rows + self.linear.rows()


def _anisotropy(C: np.ndarray) -> float:
    """How far a tensor of the plane is from isotropic [stress]."""
    wanted = C[0, 0, 1, 1] + 2 * C[0, 1, 0, 1]
    off = (C[0, 0, 0, 0] - wanted, C[1, 1, 1, 1] - wanted, C[0, 0, 0, 1], C[1, 1, 0, 1])
    return float(np.abs(off).max())
