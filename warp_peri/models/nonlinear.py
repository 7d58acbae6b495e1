"""The nonlinear solid as numbers, and its file (`warp_peri.model`, kind "nonlinear")."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from warp_peri.core.record import Quantity, Record, Stress
from warp_peri.errors import InputError
from warp_peri.models.lps import Model, by_spacing
from warp_peri.models.smoothing import Smoothing
from warp_peri.models.uniqueness import check_strain, uniqueness
from warp_peri.points.unit_names import Units, shown_moduli, symbols
from warp_peri.shown import error_rows

if TYPE_CHECKING:  # families load Warp
    from warp_peri.points.families import BondClasses
    from warp_peri.points.samples import PointsLike
    from warp_peri.statics.nonlinear import PlacedThirdOrder

OWN = 1e-4
"""What Σ n r² p of a `gradient` may miss 1 by on the lattice that it was made for."""
CUBIC = ("t3", "tq2", "q3")


@dataclass(frozen=True, eq=False, repr=False)
class NonlinearModel(Record, format="warp_peri.model", kind="nonlinear"):
    """A linear peridynamic solid and the energy Ψ of a displacement gradient (theory.md, N1–N6).

    Attributes:
        linear: the linear solid, which is the tangent at zero; its λ and μ are those of Ψ.
        t3, tq2, q3: third-order elastic constants [TPa], q3 in the frame of the crystal, whose
            zigzag direction the points state (Points.axis).
        smoothing: of the data, for the filtered form; None for the energy form, whose gradient and
            force have the weights of the linear dilatation.
        gradient: weights by bond class [1/Å²] of the gradient and the force of an energy form that
            was transferred to another lattice (theory.md, N21); None for those of the dilatation.
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
    gradient: Annotated[tuple[float, ...] | None, Quantity(length=-2, omit=True)] = None
    dimension: ClassVar[int] = 2
    ORDER = ("linear", *CUBIC, "proven", "errors", "provenance", "smoothing", "gradient")

    @property
    def units(self) -> Units:
        """Names of the units of length and stress, which are the linear solid's."""
        return self.linear.units

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gradient is not None and self.smoothing is not None:
            raise InputError("gradient: expected None beside a smoothing")

    @property
    def form(self) -> str:
        """ "energy" or "filtered"."""
        return "energy" if self.smoothing is None else "filtered"

    @property
    def horizon(self) -> float:
        """The horizon δ [Å]."""
        return self.linear.horizon

    @property
    def numbers(self) -> np.ndarray:
        """λ, μ, t3, tq2, q3 and 0 [TPa], shape [6]: of a crystal along x."""
        return self.numbers_at(0.0)

    def numbers_at(self, axis: float) -> np.ndarray:
        """λ, μ, t3, tq2, Re and Im of q3 e^(−6ia) [TPa], shape [6], of a crystal at a [rad]."""
        turned = self.q3 * np.exp(-6j * axis)
        linear = self.linear
        return np.array([linear.lam, linear.mu, self.t3, self.tq2, turned.real, turned.imag])

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
        kw = self.linear.influence_dilatation(classes.r) * classes.weight
        p = kw / (classes.count @ (kw * classes.r**2))
        return p, p

    def proven_strain(self, spacing: float) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        return float(
            self.proven.get(f"{self.linear.nominal_spacing(spacing):g}", {}).get("strain", 0.0)
        )

    def check_spacing(self, spacing: float, *, allow_uncertified: bool = False) -> None:
        """Refuse, or warn about, a lattice spacing [Å] that the linear part is not certified for.

        Raises InputError for scattered points, which Ψ is not made for.
        """
        if not spacing > 0:
            raise InputError("points: a nonlinear model is for lattices, got scattered points")
        self.linear.check_spacing(spacing, allow_uncertified=allow_uncertified)

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

    def on(
        self, points: PointsLike, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> PlacedThirdOrder:
        """The model on a lattice, its linear part transferred; as PlacedThirdOrder."""
        from warp_peri.statics.nonlinear import PlacedThirdOrder

        asked = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        return PlacedThirdOrder(self, points, **asked)

    def summary(self) -> dict[str, Any]:
        """Constants, guarantee and errors, and those of the linear part, as plain values."""
        own = {name: getattr(self, name) for name in (*CUBIC, "proven", "errors")}
        return self.linear.summary() | {"format": f"model, nonlinear, {self.form} form"} | own

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, those of the linear solid last."""
        length = symbols(self.units)[0]
        constants = shown_moduli(self.units, (getattr(self, name) for name in CUBIC))
        rows = [("form", self.form), (", ".join(CUBIC), constants)]
        for spacing, figures in self.proven.items():
            if figures.get("strain"):
                unique = f"one solution up to |H| = {figures['strain']:.2%}"
                rows.append((f"proven on {spacing} {length}", unique))
        return rows + error_rows(self.errors) + self.linear.rows()


def energy_density(H: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Ψ of (N3) [stress] at displacement gradients of shape [..., 2, 2].

    `numbers` are λ, μ, t3, tq2, Re and Im of q3 e^(−6ia), as NonlinearModel.numbers_at.
    """
    lam, mu, t3, tq2, *turned = numbers
    small = (H + H.swapaxes(-1, -2)) / 2
    square = H.swapaxes(-1, -2) @ H / 2
    E = small + square
    trace, added = (np.trace(of, axis1=-2, axis2=-1) for of in (small, square))
    # of the harmonic part only what the square adds: the linear solid has the rest
    density = lam / 2 * added * (2 * trace + added)
    density += mu * (square * (2 * small + square)).sum(axis=(-2, -1))
    t = trace + added
    q = (E[..., 0, 0] - E[..., 1, 1]) / 2 + 1j * E[..., 0, 1]
    cubic = t3 * t**3 + tq2 * t * np.abs(q) ** 2 + (complex(*turned) * q**3).real
    return np.asarray(density + cubic)
