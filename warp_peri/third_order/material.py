"""A linear solid with third-order elastic constants, and its files (theory, N1–N6, N22–N25).

Of sheets whose long waves are isotropic: crystals with three- or sixfold axes, as graphene. The
linear part is an LPS, or a crystal of micromodulus tensors.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
import torch

from warp_peri.contract import SAME_SPACING
from warp_peri.core.record import Entry, Length, OnLinear, Stress
from warp_peri.errors import InputError
from warp_peri.lps.model import Model, by_spacing, on_nominal_lattice
from warp_peri.micromodulus.law import Crystal, TensorOperator
from warp_peri.micromodulus.waves import transferred
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike
from warp_peri.points.unit_names import check_same, shown_moduli, symbols
from warp_peri.shown import error_rows
from warp_peri.statics.lps import PlacedLPS
from warp_peri.third_order.operator import PlacedThirdOrder
from warp_peri.third_order.smoothing import Smoothing, carried_weights, gradient_weights
from warp_peri.third_order.sweeps import GradientSweeps
from warp_peri.third_order.uniqueness import check_strain, uniqueness
from warp_peri.transfer.cache import model_for
from warp_peri.transfer.lattice import home_of

FORMS = ("filtered", "energy")
CUBIC = ("t3", "tq2", "q3")
OWN = 1e-4
"""What Σ n r² p of a `gradient` may miss 1 by on the lattice that it was made for."""
ISOTROPIC = 1e-6
"""Relative, by which moduli of long waves may miss C11 = C12 + 2 C44."""

_known: dict[tuple[object, ...], Any] = {}
"""Solids that were transferred, by what they depend on."""
Solid = TypeVar("Solid", bound="ThirdOrderSolid")


class ThirdOrderSolid(OnLinear):
    """A linear solid and the energy Ψ of a displacement gradient (theory, N1–N6).

    Attributes:
        linear: the linear solid, which is the tangent at zero; the λ and μ of its long waves are
            those of Ψ.
        t3, tq2, q3: third-order elastic constants [stress], q3 in the frame of the crystal, whose
            zigzag direction the points state (Points.axis).
        smoothing: of the data, where the weights of the gradient undo it.
        form: "filtered", or "energy", whose tangent is symmetric.
        reach: horizon of the gradient [length].
    """

    DILATES: ClassVar[bool]
    """Whether the linear part has a dilatation of its own."""
    t3: Any
    tq2: Any
    q3: Any
    smoothing: Any
    form: Any
    reach: Any
    proven: dict[str, Any]

    @property
    def lame(self) -> tuple[float, float]:
        """λ and μ of long waves [stress]."""
        raise NotImplementedError

    @property
    def numbers(self) -> np.ndarray:
        """λ, μ, t3, tq2, q3 and 0 [stress], shape [6]: of a crystal along x."""
        return self.numbers_at(0.0)

    def numbers_at(self, axis: float) -> np.ndarray:
        """λ, μ, t3, tq2, Re and Im of q3 e^(−6ia) [stress], shape [6], of a crystal at a [rad]."""
        turned = self.q3 * np.exp(-6j * axis)
        return np.array([*self.lame, self.t3, self.tq2, turned.real, turned.imag])

    def weights(self, classes: BondClasses) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/length²], each of shape [C]."""
        raise NotImplementedError

    def proven_strain(self, spacing: float) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        raise NotImplementedError

    def at(
        self: Solid, points: Points, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> Solid:
        """The solid for the spacing of the points: its linear part transferred, proven anew.

        Constants, smoothing and reach belong to the material and go along; the weights follow the
        lattice.
        """
        raise NotImplementedError

    def nominal(self, points: Points) -> PointsLike:
        """The points, their spacing that of the law where the two differ by rounding."""
        return points

    def tables(self, sweeps: GradientSweeps, points: Points) -> tuple[np.ndarray, float]:
        """Tables and λ − μ of Numbers."""
        raise NotImplementedError

    def straight_on(self, points: Points) -> Any:
        """The linear part on nodes that it is for."""
        raise NotImplementedError

    def on(
        self, points: PointsLike, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> PlacedThirdOrder:
        """The solid on a lattice, its linear part transferred; as PlacedThirdOrder."""
        asked = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        return PlacedThirdOrder(self, points, **asked)

    def _constants(self) -> list[tuple[str, str]]:
        shown = shown_moduli(self.units, (getattr(self, name) for name in CUBIC))
        return [("form", self.form), (", ".join(CUBIC), shown)]


@dataclass(frozen=True, eq=False, repr=False)
class NonlinearModel(ThirdOrderSolid, format="warp_peri.model", kind="nonlinear"):
    """A linear peridynamic solid and the energy Ψ of a displacement gradient (theory, N1–N6).

    Attributes:
        linear, t3, tq2, q3: as of ThirdOrderSolid.
        smoothing: of the data, for the filtered form; None for the energy form, whose gradient and
            force have the weights of the linear dilatation.
        gradient: weights by bond class [1/Å²] of the gradient and the force of an energy form that
            was transferred to another lattice (theory, N21); None for those of the dilatation.
        proven: figures of the guarantee of uniqueness, by spacing.
        errors: on data sets, by name.
        provenance: of the data and the fit.

    Raises InputError naming the first number that is not finite, and for a gradient beside a
    smoothing, which has weights of its own.
    """

    linear: Model
    t3: Stress
    tq2: Stress
    q3: Stress
    smoothing: Smoothing | None = None
    proven: dict[str, Any] = field(default_factory=dict)
    errors: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    gradient: Annotated[tuple[float, ...] | None, Entry(length=-2, omit=True)] = None
    ORDER = ("linear", *CUBIC, "proven", "errors", "provenance", "smoothing", "gradient")
    DILATES = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.linear.dimension != 2:
            raise InputError("linear: third-order constants are for sheets, got a solid in space")
        if self.gradient is not None and self.smoothing is not None:
            raise InputError("gradient: expected None beside a smoothing")

    @property
    def form(self) -> str:
        """ "energy" or "filtered"."""
        return "energy" if self.smoothing is None else "filtered"

    @property
    def reach(self) -> float:
        """Horizon of the gradient, that of the linear part."""
        return self.horizon

    @property
    def lame(self) -> tuple[float, float]:
        """λ and μ [stress]."""
        return self.linear.lam, self.linear.mu

    def weights(self, classes: BondClasses) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/Å²], each of shape [C].

        Raises InputError for another lattice than a `gradient` was made for: other classes, or
        uniform strain that it does not return, Σ n r² p ≠ 1.
        """
        if self.smoothing is not None:
            return self.smoothing.weights(classes)
        if self.gradient is not None:
            if len(self.gradient) != len(classes.r):
                raise InputError(
                    f"gradient: expected weights of {len(classes.r)} classes of bonds, "
                    f"got {len(self.gradient)}"
                )
            own = np.array(self.gradient)
            uniform = float((classes.count * classes.r**2) @ own)
            if not abs(uniform - 1) <= OWN:
                raise InputError(
                    f"gradient: expected weights of this lattice, Σ n r² p = 1, got {uniform:g}"
                )
            return own, own
        p = _normalised(self.linear.influence_dilatation(classes.r), classes)
        return p, p

    def tables(self, sweeps: GradientSweeps, points: Points) -> tuple[np.ndarray, float]:
        """Tables and λ − μ of Numbers."""
        classes, linear = sweeps.classes, self.linear
        w, p = (
            _normalised(K(classes.r), classes)
            for K in (linear.influence, linear.influence_dilatation)
        )
        p_in, p_out = self.weights(classes)
        by_class = np.stack([16 * linear.mu * w / classes.r**2, 2 * p, 2 * p_in, 2 * p_out])
        return sweeps.by_pair(torch.from_numpy(by_class)).numpy(), linear.lam - linear.mu

    def nominal(self, points: Points) -> PointsLike:
        """The points, their spacing that of the law where the two differ by rounding."""
        return on_nominal_lattice(self.linear, points)

    def straight_on(self, points: Points) -> PlacedLPS:
        """The LPS on nodes that it is for."""
        return PlacedLPS(self.linear, points, transfer=False, allow_uncertified=True)

    def proven_strain(self, spacing: float) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        there = f"{self.linear.nominal_spacing(spacing):g}"
        return float(self.proven.get(there, {}).get("strain", 0.0))

    def at(
        self, points: Points, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> NonlinearModel:
        """The solid for the spacing of the points and the horizon that their collar carries.

        Weights of the energy form follow (N21) on finer lattices, and on any other one once they
        have. Raises InputError for scattered points, and as model_for does.
        """
        if not points.spacing > 0:
            raise InputError("points: a nonlinear model is for lattices, got scattered points")
        options = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        linear = model_for(self.linear, points, **options)
        if linear is self.linear:
            return self
        spacing = linear.nominal_spacing(points.spacing)
        home = home_of(self.linear, spacing).spacing
        gradient = None
        if self.smoothing is None and (spacing < home or self.gradient is not None):
            # else no wave is shorter than at home
            classes = bond_classes(home, self.horizon)
            there = bond_classes(spacing, linear.horizon)
            gradient = tuple(carried_weights(classes, self.weights(classes)[0], there).tolist())
        solid = replace(self, linear=linear, proven={}, gradient=gradient)
        key = (replace(solid, errors={}, provenance={}).content()["sha256"], spacing)
        if key not in _known:
            _known[key] = uniqueness(solid, spacing=spacing).figures()
        return replace(solid, proven={f"{spacing:g}": _known[key]})

    def elsewhere(self, length: float, stress: float) -> dict[str, Any]:
        """What is proven goes along with its spacing, in the units that it was made in."""
        return {
            "proven": {
                f"{spacing * length:g}": self.proven[f"{spacing:g}"]
                for spacing in self.linear.certified_on
                if f"{spacing:g}" in self.proven
            }
        }

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """Without the axis that files of before had of the points that they were learned on."""
        if axis := content.pop("axis", None):
            warnings.warn(
                f"axis: the file has {axis!r:.20} rad of the points that it was learned on; "
                "points state their own now, Points(…, axis=degrees)",
                stacklevel=3,
            )
        return content

    def check_proofs(self) -> None:
        """As of a Record, on every spacing that solutions are said to be unique on."""
        on = (*self.linear.certified_on, *self.linear.trained_on)
        for spacing, each in by_spacing("proven", self.proven, on).items():
            check_strain(each, partial(uniqueness, self, spacing=spacing))

    def _read_from(self, path: Path | None) -> NonlinearModel:
        return replace(self, linear=self.linear._read_from(path))

    def summary(self) -> dict[str, Any]:
        """Constants, guarantee and errors, and those of the linear part, as plain values."""
        own = {name: getattr(self, name) for name in (*CUBIC, "proven", "errors")}
        return self.linear.summary() | {"format": f"model, nonlinear, {self.form} form"} | own

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, those of the linear solid last."""
        rows, length = self._constants(), symbols(self.units)[0]
        for spacing, figures in self.proven.items():
            if figures.get("strain"):
                unique = f"one solution up to |H| = {figures['strain']:.2%}"
                rows.append((f"proven on {spacing} {length}", unique))
        return rows + error_rows(self.errors) + self.linear.rows()


def _normalised(K: np.ndarray, classes: BondClasses) -> np.ndarray:
    """K W over the weighted volume, by class."""
    kw = K * classes.weight
    return np.asarray(kw / (classes.count @ (kw * classes.r**2)))


@dataclass(frozen=True, eq=False, repr=False)
class ThirdOrderCrystal(ThirdOrderSolid, format="warp_peri.third_order_crystal"):
    """A law of micromodulus tensors and the energy Ψ of a displacement gradient (N22).

    Attributes:
        linear, t3, tq2, q3, smoothing, form, reach: as of ThirdOrderSolid.
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
    DILATES = False

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

    def weights(self, classes: BondClasses) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/length²], each of shape [C]."""
        return gradient_weights(self.smoothing, self.form, classes)

    def tables(self, sweeps: GradientSweeps, points: Points) -> tuple[np.ndarray, float]:
        """Tables of Numbers, in the coordinates of the points."""
        axes, law = lattice_steps(points)[1], self.linear
        inner = bond_classes(self.spacing, self.reach)
        p = 2 * np.stack(self.weights(inner))[:, inner.bond_class].T
        known = _of_steps(np.rint(inner.xi / self.spacing).astype(int), p)
        turned = (axes @ law.tensors @ axes.T).reshape(-1, 4)[:, [0, 1, 3]]
        tensors = _of_steps(np.concatenate([law.steps, -law.steps]), np.tile(turned, (2, 1)))
        steps = np.rint(sweeps.xi[sweeps.half] @ axes / points.spacing).astype(int).tolist()
        none = (np.zeros(3), np.zeros(2))
        rows = [(*tensors.get(tuple(s), none[0]), 0, *known.get(tuple(s), none[1])) for s in steps]
        return np.array(rows).T.copy(), 0.0

    def straight_on(self, points: Points) -> TensorOperator:
        """The tensors on nodes that they are for."""
        return self.linear.on(points)

    def proven_strain(self, spacing: float) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        here = abs(spacing / self.spacing - 1) <= SAME_SPACING
        return float(self.proven.get("strain", 0.0)) if here else 0.0

    def at(
        self, points: Points, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> ThirdOrderCrystal:
        """The law for the spacing of the points: its tensors transferred, proven anew.

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
        """The law with its guarantee of uniqueness, where its tensors are certified (N25)."""
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
        rows = self._constants()
        if self.proven.get("strain"):
            rows.append(("proven", f"one solution up to |H| = {self.proven['strain']:.2%}"))
        return rows + self.linear.rows()


def _of_steps(steps: np.ndarray, values: np.ndarray) -> dict[tuple[int, ...], np.ndarray]:
    """Values by the step of their bond."""
    return {tuple(step): value for step, value in zip(steps.tolist(), values)}


def _anisotropy(C: np.ndarray) -> float:
    """How far a tensor of the plane is from isotropic [stress]."""
    wanted = C[0, 0, 1, 1] + 2 * C[0, 1, 0, 1]
    off = (C[0, 0, 0, 0] - wanted, C[1, 1, 1, 1] - wanted, C[0, 0, 0, 1], C[1, 1, 0, 1])
    return float(np.abs(off).max())
