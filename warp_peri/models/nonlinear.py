"""The nonlinear solid as numbers, and its file (`warp_peri.model`, kind "nonlinear")."""

from __future__ import annotations

import os
import warnings
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.models.lps import (
    FORMAT,
    VERSION,
    Model,
    content_hash,
    model_content,
    model_from,
    read_content,
)
from warp_peri.models.smoothing import Smoothing
from warp_peri.points.arrays import is_number
from warp_peri.points.unit_names import Units, factors, shown_moduli, symbols
from warp_peri.shown import as_table, error_rows, in_rows

if TYPE_CHECKING:  # families load Warp
    from warp_peri.points.families import BondClasses
    from warp_peri.points.samples import PointsLike
    from warp_peri.statics.nonlinear import PlacedThirdOrder

KIND = "nonlinear"
OWN = 1e-4
"""What Σ n r² p of a `gradient` may miss 1 by on the lattice that it was made for."""
CUBIC = ("t3", "tq2", "q3")
_RECORDS = ("proven", "errors", "provenance")
_OPTIONAL = {"sha256", "gradient", "axis"}
_KEYS = {"format", "version", "kind", "linear", "smoothing", *_OPTIONAL, *CUBIC, *_RECORDS}


@dataclass(frozen=True, eq=False, repr=False)
class NonlinearModel:
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
    t3: float
    tq2: float
    q3: float
    smoothing: Smoothing | None = None
    proven: dict[str, Any] = field(default_factory=dict)
    errors: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    gradient: tuple[float, ...] | None = None
    dimension: ClassVar[int] = 2

    @property
    def units(self) -> Units:
        """Names of the units of length and stress, which are the linear solid's."""
        return self.linear.units

    def __post_init__(self) -> None:
        for name in CUBIC:
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"{name}: expected a finite number, got {value!r:.50}")
            if not np.isfinite(value):
                raise InputError(f"{name}: expected a finite number, got {value!r:.50}")
            object.__setattr__(self, name, float(value))
        if self.gradient is None:
            return
        if self.smoothing is not None:
            raise InputError("gradient: expected None beside a smoothing")
        p = np.asarray(self.gradient, float)
        if p.ndim != 1 or not np.isfinite(p).all():
            raise InputError(f"gradient: expected finite weights, got {self.gradient!r:.60}")
        object.__setattr__(self, "gradient", tuple(p.tolist()))

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

    def in_units(self, units: Units) -> NonlinearModel:
        """The same solid with its numbers in other units.

        Proven strains, which have no unit, go along with their spacings; other figures and records
        stay as they are, as in Model.in_units.

        Raises InputError for units that are not known, or that no factor leads to.
        """
        length, stress = factors(self.units, units)
        linear, smoothing, gradient = self.linear.in_units(units), self.smoothing, self.gradient
        if linear is self.linear:
            return self
        return replace(
            self,
            linear=linear,
            t3=self.t3 * stress,
            tq2=self.tq2 * stress,
            q3=self.q3 * stress,
            smoothing=smoothing and replace(smoothing, radius=smoothing.radius * length),
            gradient=gradient and tuple(p / length**2 for p in gradient),
            proven={
                f"{spacing * length:g}": self.proven[f"{spacing:g}"]
                for spacing in self.linear.certified_on
                if f"{spacing:g}" in self.proven
            },
        )

    def on(
        self, points: PointsLike, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> PlacedThirdOrder:
        """The model on a lattice, its linear part transferred; as PlacedThirdOrder."""
        from warp_peri.statics.nonlinear import PlacedThirdOrder

        asked = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        return PlacedThirdOrder(self, points, **asked)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model as JSON, whole or not at all."""
        write_json(path, self.content())

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

    def __repr__(self) -> str:
        return in_rows("NonlinearModel", self.rows())

    def _repr_html_(self) -> str:
        return as_table(self.rows())

    def content(self) -> dict[str, Any]:
        """What the file of the model holds."""
        content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "kind": KIND}
        content["linear"] = model_content(self.linear)
        content |= {name: getattr(self, name) for name in (*CUBIC, *_RECORDS)}
        content["smoothing"] = None if self.smoothing is None else asdict(self.smoothing)
        if self.gradient is not None:
            content["gradient"] = list(self.gradient)
        content["sha256"] = content_hash(content)
        return content


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


def nonlinear_from(content: dict[str, Any]) -> NonlinearModel:
    """The model of a file's content.

    Raises InputError naming what is wrong: missing or unknown keys, numbers that are none, contents
    that are not what was written.
    """
    if missing := sorted(_KEYS - _OPTIONAL - set(content)):
        raise InputError(f"missing keys: {', '.join(missing)}")
    if unknown := sorted(set(content) - _KEYS):
        raise InputError(f"unknown keys: {', '.join(unknown)}")
    for key in _RECORDS:
        if not isinstance(content[key], dict):
            raise InputError(f"{key}: expected an object, got {content[key]!r}")
    kept = content["smoothing"]
    smoothing = None
    if kept is not None:
        if not isinstance(kept, dict) or set(kept) != {"radius", "ridge"}:
            raise InputError(f"smoothing: expected a radius and a ridge, got {kept!r:.50}")
        smoothing = Smoothing(**kept)
    if "sha256" in content and content["sha256"] != content_hash(content):
        raise InputError(
            "sha256: the contents are not what was written; remove this key to accept them"
        )
    numbers = {name: content[name] for name in (*CUBIC, *_RECORDS)}
    if content.get("axis"):
        warnings.warn(
            f"axis: the file has {content['axis']!r:.20} rad of the points that it was learned on; "
            "points state their own now, Points(…, axis=degrees)",
            stacklevel=3,
        )
    gradient = content.get("gradient")
    if not (gradient is None or (isinstance(gradient, list) and all(map(is_number, gradient)))):
        raise InputError(f"gradient: expected a list of numbers, got {gradient!r:.50}")
    try:
        linear = model_from(content["linear"])
    except InputError as error:
        raise InputError(f"linear: {error}") from None
    own = None if gradient is None else tuple(gradient)
    return NonlinearModel(linear, smoothing=smoothing, gradient=own, **numbers)


def load_nonlinear(path: str | os.PathLike[str]) -> NonlinearModel:
    """Read the file of a nonlinear model; InputError as for load_model."""
    model: Any = load_any(path)
    if model.linear is model:
        raise InputError(f"{path}: kind: expected a nonlinear model, got a linear one")
    return model  # type: ignore[no-any-return]


def load_any(path: str | os.PathLike[str]) -> Model | NonlinearModel:
    """Read a model file of either kind; InputError as for load_model."""
    content = read_content(path)
    nonlinear = isinstance(content, dict) and content.get("kind") == KIND
    try:
        if nonlinear:
            solid = nonlinear_from(content)
            return replace(solid, linear=replace(solid.linear, file=Path(path)))
        return replace(model_from(content), file=Path(path))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
