"""A crystal of micromodulus tensors with third-order constants, and its file (theory.md, N22–N25).

Of sheets whose long waves are isotropic: crystals with three- or sixfold axes, as graphene.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.core.record import Length, Record, Stress
from warp_peri.errors import InputError
from warp_peri.micromodulus.law import SAME_SPACING, Crystal
from warp_peri.models.nonlinear import CUBIC
from warp_peri.models.smoothing import Smoothing, fitted_weights
from warp_peri.models.uniqueness import Uniqueness, check_strain, uniqueness_of
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.samples import PointsLike
from warp_peri.points.unit_names import Units, shown_moduli

if TYPE_CHECKING:
    from warp_peri.micromodulus.third_order_operator import PlacedCrystal

FORMS = ("filtered", "energy")
ISOTROPIC = 1e-6
"""Relative, by which moduli of long waves may miss C11 = C12 + 2 C44."""


@dataclass(frozen=True, eq=False, repr=False)
class ThirdOrderCrystal(Record, format="warp_peri.third_order_crystal"):
    """A law of micromodulus tensors and the energy Ψ of a displacement gradient (N22).

    Attributes:
        linear: the tensors, which are the tangent at zero; the λ and μ of their long waves are
            those of Ψ.
        t3, tq2, q3: third-order elastic constants [stress], q3 in the frame of the crystal, whose
            zigzag direction the points state (Points.axis).
        smoothing: of the data that the law answers for.
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
            raise InputError("linear: third-order constants are for sheets, got a law in space")
        C = self.linear.tensor()
        shear, miss = C[0, 1, 0, 1], _anisotropy(C)
        if miss > ISOTROPIC * abs(shear):
            raise InputError(
                f"linear: third-order constants are for isotropic long waves, got C11, C22, C16 or "
                f"C26 off by {miss / shear:.1e} of the shear modulus; symmetry='isotropic' has them"
            )

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, those of the tensors last."""
        constants = shown_moduli(self.units, (getattr(self, name) for name in CUBIC))
        rows = [("form", self.form), (", ".join(CUBIC), constants)]
        if self.proven.get("strain"):
            rows.append(("proven", f"one solution up to |H| = {self.proven['strain']:.2%}"))
        return rows + self.linear.rows()

    @property
    def dimension(self) -> int:
        """2."""
        return self.linear.dimension

    @property
    def units(self) -> Units:
        """Names of the units of length and stress, which are the tensors'."""
        return self.linear.units

    @property
    def spacing(self) -> float:
        """Of the nodes."""
        return self.linear.spacing

    @property
    def horizon(self) -> float:
        """Of the longest bond that tensors or gradient have."""
        return max(self.linear.horizon, self.reach)

    def numbers_at(self, axis: float) -> np.ndarray:
        """λ, μ, t3, tq2, Re and Im of q3 e^(−6ia) [stress], shape [6], of a crystal at a [rad]."""
        C, turned = self.linear.tensor(), self.q3 * np.exp(-6j * axis)
        lam, mu = C[0, 0, 1, 1], C[0, 1, 0, 1]
        return np.array([lam, mu, self.t3, self.tq2, turned.real, turned.imag])

    @property
    def numbers(self) -> np.ndarray:
        """The same of a crystal along x."""
        return self.numbers_at(0.0)

    def weights(self, classes: BondClasses) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/length²], each of shape [C]."""
        return gradient_weights(self.smoothing, self.form, classes)

    def proven_strain(self, spacing: float) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        here = abs(spacing / self.spacing - 1) <= SAME_SPACING
        return float(self.proven.get("strain", 0.0)) if here else 0.0

    def certified(self) -> ThirdOrderCrystal:
        """The law with its guarantee of uniqueness, where its tensors are certified (N25)."""
        proof = self.linear.certificate
        if proof is None or not proof.holds:
            return self
        return replace(self, proven=self._unique().figures())

    def _unique(self) -> Uniqueness:
        classes = bond_classes(self.spacing, self.reach)
        return uniqueness_of(self, self.linear.stencil, self.linear.group, classes)

    def check_proofs(self) -> None:
        """As of a Record, of the strain up to which solutions are said to be unique."""
        if self.proven:
            check_strain(self.proven, self._unique)

    def elsewhere(self, length: float, stress: float) -> dict[str, Any]:
        """Of what is proven the strain, which has no unit, goes along."""
        return {"proven": {k: v for k, v in self.proven.items() if k == "strain"}}

    def on(self, points: PointsLike, **options: Any) -> PlacedCrystal:
        """The law on a lattice, carried over to its spacing; as PlacedCrystal."""
        from warp_peri.micromodulus.third_order_operator import PlacedCrystal

        return PlacedCrystal(self, points, **options)

    def summary(self) -> dict[str, Any]:
        """Constants, moduli and guarantee as plain values."""
        own = {name: getattr(self, name) for name in (*CUBIC, "form", "reach", "proven")}
        return own | {"moduli": self.linear.moduli(), "bonds": self.linear.bonds}


def gradient_weights(
    smoothing: Smoothing, form: str, classes: BondClasses
) -> tuple[np.ndarray, np.ndarray]:
    """p_in and p_out by class [1/length²]: of the filtered form (N6), of the energy form (N23)."""
    if form == "filtered":
        return smoothing.weights(classes)
    own = fitted_weights(classes, smoothing.root, np.pi / classes.spacing)
    return own, own


def _anisotropy(C: np.ndarray) -> float:
    """How far a tensor of the plane is from isotropic [stress]."""
    wanted = C[0, 0, 1, 1] + 2 * C[0, 1, 0, 1]
    off = (C[0, 0, 0, 0] - wanted, C[1, 1, 1, 1] - wanted, C[0, 0, 0, 1], C[1, 1, 0, 1])
    return float(np.abs(off).max())
