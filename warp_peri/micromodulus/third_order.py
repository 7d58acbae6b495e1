"""A crystal of micromodulus tensors with third-order constants, and its file (theory.md, N22–N25).

Of sheets whose long waves are isotropic: crystals with three- or sixfold axes, as graphene.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.micromodulus.law import SAME_SPACING, Crystal
from warp_peri.models.lps import content_hash, read_content
from warp_peri.models.nonlinear import CUBIC
from warp_peri.models.smoothing import Smoothing, fitted_weights
from warp_peri.points.arrays import is_number, is_positive
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.samples import PointsLike
from warp_peri.points.unit_names import Units, factors, shown_moduli
from warp_peri.shown import as_table, in_rows
from warp_peri.stability.uniqueness import uniqueness_of

if TYPE_CHECKING:
    from warp_peri.micromodulus.third_order_operator import PlacedCrystal

FORMAT, VERSION = "warp_peri.third_order_crystal", 1
FORMS = ("filtered", "energy")
ISOTROPIC = 1e-6
"""Relative, by which moduli of long waves may miss C11 = C12 + 2 C44."""


@dataclass(frozen=True, eq=False)
class ThirdOrderCrystal:
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
    t3: float
    tq2: float
    q3: float
    smoothing: Smoothing
    form: str
    reach: float
    proven: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in CUBIC:
            value = getattr(self, name)
            if not (is_number(value) and np.isfinite(value)):
                raise InputError(f"{name}: expected a finite number, got {value!r:.50}")
            object.__setattr__(self, name, float(value))
        if self.form not in FORMS:
            raise InputError(f"form: expected one of {', '.join(FORMS)}, got {self.form!r:.50}")
        if not isinstance(self.smoothing, Smoothing):
            raise InputError(f"smoothing: expected Smoothing(…), got {self.smoothing!r:.50}")
        if not is_positive(self.reach):
            raise InputError(f"reach: expected a length > 0, got {self.reach!r:.50}")
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

    def __repr__(self) -> str:
        return in_rows("ThirdOrderCrystal", self.rows())

    def _repr_html_(self) -> str:
        return as_table(self.rows())

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
        classes = bond_classes(self.spacing, self.reach)
        unique = uniqueness_of(self, self.linear.stencil, self.linear.group, classes)
        return replace(self, proven=unique.figures())

    def on(self, points: PointsLike, **options: Any) -> PlacedCrystal:
        """The law on a lattice, carried over to its spacing; as PlacedCrystal."""
        from warp_peri.micromodulus.third_order_operator import PlacedCrystal

        return PlacedCrystal(self, points, **options)

    def in_units(self, units: Units) -> ThirdOrderCrystal:
        """The same law in other units; of what is proven the strain, which has none, goes along.

        Raises InputError where no factor leads to them.
        """
        if units == self.units:
            return self
        length, stress = factors(self.units, units)
        strain = {"strain": self.proven["strain"]} if "strain" in self.proven else {}
        return replace(
            self,
            linear=self.linear.in_units(units),
            **{name: getattr(self, name) * stress for name in CUBIC},
            smoothing=replace(self.smoothing, radius=self.smoothing.radius * length),
            reach=self.reach * length,
            proven=strain,
        )

    def summary(self) -> dict[str, Any]:
        """Constants, moduli and guarantee as plain values."""
        own = {name: getattr(self, name) for name in (*CUBIC, "form", "reach", "proven")}
        return own | {"moduli": self.linear.moduli(), "bonds": self.linear.bonds}

    def content(self) -> dict[str, Any]:
        """What a file holds, plain values."""
        names = (*CUBIC, "form", "reach", "proven", "provenance")
        content: dict[str, Any] = {"format": FORMAT, "version": VERSION}
        content["linear"] = self.linear.content()
        content |= {name: getattr(self, name) for name in names}
        content["smoothing"] = asdict(self.smoothing)
        content["sha256"] = content_hash(content)
        return content

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a JSON file, whole or not at all."""
        write_json(path, self.content())

    @classmethod
    def of_content(cls, content: dict[str, Any]) -> ThirdOrderCrystal:
        """The law that a file holds. Raises InputError naming what is wrong."""
        names = {*CUBIC, "form", "reach", "proven", "provenance", "linear", "smoothing"}
        if missing := sorted(names - set(content)):
            raise InputError(f"missing keys: {', '.join(missing)}")
        if unknown := sorted(set(content) - names - {"format", "version", "sha256"}):
            raise InputError(f"unknown keys: {', '.join(unknown)}")
        for key in ("proven", "provenance"):
            if not isinstance(content[key], dict):
                raise InputError(f"{key}: expected an object, got {content[key]!r:.50}")
        smoothing = content["smoothing"]
        if not isinstance(smoothing, dict) or set(smoothing) != {"radius", "ridge"}:
            raise InputError(f"smoothing: expected a radius and a ridge, got {smoothing!r:.50}")
        if "sha256" in content and content["sha256"] != content_hash(content):
            raise InputError(
                "sha256: the contents are not what was written; remove this key to accept them"
            )
        try:
            linear = Crystal.of_content(content["linear"])
        except InputError as error:
            raise InputError(f"linear: {error}") from None
        given = {name: content[name] for name in names - {"linear", "smoothing"}}
        return cls(linear, smoothing=Smoothing(**smoothing), **given)


def load_third_order_crystal(path: str | os.PathLike[str]) -> ThirdOrderCrystal:
    """Read a file that `save` wrote. Raises InputError naming the file and what is wrong."""
    content = read_content(path)
    kind = content.get("format") if isinstance(content, dict) else None
    try:
        if kind != FORMAT or content.get("version") != VERSION:
            raise InputError(f"format: expected {FORMAT!r}, version {VERSION}, got {kind!r:.50}")
        return ThirdOrderCrystal.of_content(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


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
