"""The model and its file (`warp_peri.model`, version 1)."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.files.atomic import plain, write_json
from warp_peri.models.influence import ALPHA_BOUND, LARGEST_DEGREE, bernstein_basis
from warp_peri.models.solid import Solid
from warp_peri.points.arrays import is_number
from warp_peri.points.quadrature import DEGREE, SINGULARITY
from warp_peri.points.unit_names import USUAL, Units, check_units, factors, shown_moduli, symbols
from warp_peri.shown import as_table, error_rows, in_rows, proven_rows

if TYPE_CHECKING:  # the operator stands above its numbers
    from warp_peri.points.samples import PointsLike
    from warp_peri.statics.lps import PlacedLPS

FORMAT, VERSION = "warp_peri.model", 1
QUADRATURE = {"degree": DEGREE, "singularity": SINGULARITY}
_NUMBERS = {"lambda": "lam", "mu": "mu", "alpha": "alpha", "horizon": "horizon"}
SPACING_TOLERANCE = 1e-6
"""A lattice within this of a certified one, relative to its spacing, is taken as that lattice."""
LARGEST_MODULUS = 1e100
"""[TPa]; products of larger ones soon are no numbers."""
LARGEST_FILE = 2**24
"""Bytes of a model file that are read at most."""
_OPTIONAL = {"trained_strain", "largest_wave_number", "dimension", "sha256"}
_RECORDS = ("certificate", "errors", "provenance", "versions")
_KEYS = {
    "format",
    "version",
    "length_unit",
    "stress_unit",
    "degree",
    "D",
    "D_dilatation",
    "quadrature",
    "trained_on",
    "certified_on",
    *_NUMBERS,
    *_RECORDS,
}


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """A linear peridynamic solid with K(r) = r^(−α) Σ_k D_k B_k,M(r/δ) (theory.md, 4–9, V1–V3).

    Attributes:
        lam: Lamé parameter λ [TPa].
        mu: Lamé parameter μ, the shear modulus [TPa].
        alpha: exponent α < 3.
        D: Bernstein coefficients of any sign, shape [M + 1]; their common scale has no effect.
        D_dilatation: coefficients of the dilatation's own influence function, shape [M + 1]; those
            of D where none are given.
        horizon: δ [Å].
        trained_on: spacings of the training lattices [Å].
        certified_on: spacings of the lattices that solves accept [Å].
        trained_strain: largest strain of neighbouring nodes in the training fields, if known.
        largest_wave_number: largest |k| that the training loads held [1/Å], if known; nothing is
            claimed of the model beyond it.
        certificate: figures of the certificate, by spacing.
        errors: on data sets, by name.
        provenance: of the data and the fit.
        versions: of the packages.
        units: names of the units of length and stress that all of it is in; Å and TPa where these
            lines say so.
        file: that the model was read from; not part of its contents.
        dimension: 2, a sheet, or 3, a solid.

    Raises InputError naming the first number out of its range.
    """

    lam: float
    mu: float
    alpha: float
    D: np.ndarray
    horizon: float
    D_dilatation: np.ndarray | None = None
    trained_on: tuple[float, ...] = ()
    certified_on: tuple[float, ...] = ()
    trained_strain: float | None = None
    largest_wave_number: float | None = None
    certificate: dict[str, Any] = field(default_factory=dict)
    errors: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, Any] = field(default_factory=dict)
    units: Units = USUAL
    file: Path | None = None
    dimension: int = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "units", check_units(self.units))
        length, stress = symbols(self.units)
        if self.dimension not in (2, 3) or isinstance(self.dimension, bool):
            raise InputError(f"dimension: expected 2 or 3, got {self.dimension!r:.50}")
        for name in ("lam", "mu", "alpha", "horizon"):
            object.__setattr__(self, name, _number(name, getattr(self, name)))
        if self.D_dilatation is None:
            object.__setattr__(self, "D_dilatation", self.D)
        for name in ("D", "D_dilatation", "trained_on", "certified_on"):
            value = np.array(_numbers(name, getattr(self, name)))
            object.__setattr__(self, name, value if name[0] == "D" else tuple(value.tolist()))
        for name in ("trained_strain", "largest_wave_number"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _number(name, getattr(self, name)))
        if self.largest_wave_number is not None and not self.largest_wave_number > 0:
            raise InputError(
                f"largest_wave_number: expected more than 0, got {self.largest_wave_number}"
            )
        if len(self.D) == 0:
            raise InputError("D: expected at least one coefficient (degree ≥ 0), got none")
        if len(self.D) > LARGEST_DEGREE + 1:
            raise InputError(f"D: expected at most {LARGEST_DEGREE + 1}, got {len(self.D)} of them")
        if not self.alpha < ALPHA_BOUND:
            raise InputError(f"alpha: expected less than {ALPHA_BOUND:g}, got {self.alpha}")
        if not self.horizon > 0:
            raise InputError(f"horizon: expected a length > 0 {length}, got {self.horizon}")
        if not max(abs(self.lam), abs(self.mu)) <= LARGEST_MODULUS:
            raise InputError(
                f"lambda, mu: expected at most {LARGEST_MODULUS:g} {stress}, got {self.lam}, "
                f"{self.mu}"
            )
        bulk = "λ + μ" if self.dimension == 2 else "λ + 2μ/3"
        if not (self.mu > 0 and self.lam + 2 * self.mu / self.dimension > 0):
            raise InputError(
                f"lambda, mu: expected μ > 0 and {bulk} > 0, got {self.lam}, {self.mu}"
            )
        if not (np.any(self.D) and np.any(self.dilatation)):
            raise InputError("D: expected a coefficient other than 0")
        if len(self.dilatation) != len(self.D):
            raise InputError(
                f"D_dilatation: expected {len(self.D)} coefficients, got {len(self.dilatation)}"
            )

    @property
    def degree(self) -> int:
        """Degree M of the Bernstein polynomial."""
        return len(self.D) - 1

    @property
    def solid(self) -> Solid:
        """λ, μ, α, D and D of the dilatation as one value."""
        return Solid(self.lam, self.mu, self.alpha, self.D, self.dilatation)

    @property
    def linear(self) -> Model:
        """Itself: the linear solid at zero strain, which nonlinear laws have too."""
        return self

    @property
    def bond_based(self) -> bool:
        """Whether λ = μ: no dilatation enters (theory.md, 42), and a collar of δ is enough."""
        return self.solid.bond_based

    @property
    def E(self) -> float:
        """Young's modulus of the continuum [TPa]; of a sheet in plane stress."""
        if self.dimension == 3:
            return self.mu * (3 * self.lam + 2 * self.mu) / (self.lam + self.mu)
        return 4 * self.mu * (self.lam + self.mu) / (self.lam + 2 * self.mu)

    @property
    def nu(self) -> float:
        """Poisson's ratio of the continuum; of a sheet in plane stress."""
        if self.dimension == 3:
            return self.lam / (2 * (self.lam + self.mu))
        return self.lam / (self.lam + 2 * self.mu)

    @property
    def dilatation(self) -> np.ndarray:
        """Coefficients of the dilatation's influence function, shape [M + 1]."""
        assert self.D_dilatation is not None  # filled in above
        return self.D_dilatation

    def influence(self, r: ArrayLike) -> np.ndarray:
        """K of the deviatoric part at the distances r [Å] in (0, δ]."""
        return self._kernel(r, self.D)

    def influence_dilatation(self, r: ArrayLike) -> np.ndarray:
        """K of the dilatation at the distances r [Å] in (0, δ]."""
        return self._kernel(r, self.dilatation)

    def _kernel(self, r: ArrayLike, D: np.ndarray) -> np.ndarray:
        r = np.asarray(r, dtype=float)
        K: np.ndarray = r**-self.alpha * (bernstein_basis(r, self.horizon, self.degree) @ D)
        return K

    def nominal_spacing(self, spacing: float) -> float:
        """The certified spacing [Å] that a lattice within SPACING_TOLERANCE of it is taken as.

        Between bond lengths K may swing by orders of magnitude, so that what is proven of one
        spacing says nothing of the next millionth. Any other spacing is returned as it is.
        """
        known = min(self.certified_on, key=lambda h: abs(h - spacing), default=0.0)
        near = 0 < known and abs(spacing - known) <= SPACING_TOLERANCE * known
        return known if near else spacing

    def is_certified_on(self, spacing: float) -> bool:
        """Whether a lattice spacing [Å] counts as one that the model holds a certificate for."""
        return spacing > 0 and self.nominal_spacing(spacing) in self.certified_on

    def check_spacing(self, spacing: float, *, allow_uncertified: bool = False) -> None:
        """Refuse, or warn about, a lattice spacing [Å] that the model is not certified for."""
        if self.is_certified_on(spacing):
            return
        unit = symbols(self.units)[0]
        known = ", ".join(f"{value:.10g} {unit}" for value in self.certified_on) or "no spacing"
        here = f"{spacing:.10g} {unit}" if spacing else "scattered points"
        message = (
            f"spacing: the model is certified on {known}, not on {here}, where its static "
            "problems may have no solution or a wrong one"
        )
        if not allow_uncertified:
            raise InputError(message)
        warnings.warn(message, stacklevel=3)

    def check_dimension(self, points: PointsLike) -> None:
        """Raise InputError for points of another dimension than the model's."""
        if points.x.shape[1] != self.dimension:
            raise InputError(
                f"points: expected {self.dimension} dimensions, the model's, got shape "
                f"{list(points.x.shape)}"
            )

    @property
    def transferred_from(self) -> float | None:
        """Spacing [Å] of the lattice whose dispersion this model was fitted to; None at home."""
        record = self.provenance.get("transfer")
        spacing = record.get("from_spacing") if isinstance(record, dict) else None
        return float(spacing) if isinstance(spacing, (int, float)) else None

    def in_units(self, units: Units) -> Model:
        """The same material with its numbers in other units.

        K keeps its coefficients, whose common scale has no effect. The figures of the certificate
        go along, for a transfer asks for as much as is proven; its statement and records of errors
        and provenance stay in the units that they were made in, which the provenance then names.

        Raises InputError for units that are not known, or that no factor leads to.
        """
        length, stress = factors(self.units, units)
        if self.units == tuple(units):
            return self
        shortest = self.largest_wave_number
        return replace(
            self,
            lam=self.lam * stress,
            mu=self.mu * stress,
            horizon=self.horizon * length,
            trained_on=tuple(spacing * length for spacing in self.trained_on),
            certified_on=tuple(spacing * length for spacing in self.certified_on),
            largest_wave_number=None if shortest is None else shortest / length,
            certificate={
                f"{h * length:g}": _figures_in(self.certificate[f"{h:g}"], length, stress)
                for h in dict.fromkeys((*self.certified_on, *self.trained_on))
                if f"{h:g}" in self.certificate
            },
            provenance={**self.provenance, "units_before": list(self.units)},
            units=check_units(units),
            file=None,
        )

    def on(self, points: PointsLike, **options: Any) -> PlacedLPS:
        """The model on points: transferred there, certified, its bonds built when first needed.

        Args:
            points: a lattice or scattered points.
            options: transfer=False refuses what the model itself holds no certificate for;
                allow_uncertified=True takes its own numbers, with a warning; device,
                quadrature_degree.

        Raises InputError as LPSOperator does.
        """
        from warp_peri.statics.lps import PlacedLPS

        return PlacedLPS(self, points, **options)

    def content(self) -> dict[str, Any]:
        """What the file of the model holds."""
        return model_content(self)

    def summary(self) -> dict[str, Any]:
        """Constants, lattices and errors, as plain values."""
        names = ("mu", "E", "nu", "alpha", "degree", "horizon")
        lists = ("units", "trained_on", "certified_on")
        return {
            "format": "model",
            "lambda": self.lam,
            **{name: getattr(self, name) for name in names},
            **{name: list(getattr(self, name)) for name in lists},
            "errors": self.errors,
            "versions": self.versions,
        }

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        length = symbols(self.units)[0]
        kernels = "K" if np.array_equal(self.D, self.dilatation) else "K, K of dilatation"
        rows = [
            ("λ, μ", shown_moduli(self.units, (self.lam, self.mu))),
            ("E, ν", f"{shown_moduli(self.units, (self.E,))}, {self.nu:.3g}"),
            ("horizon", f"{self.horizon:g} {length}"),
            (kernels, f"degree {self.degree}, α = {self.alpha:.3g}"),
        ]
        spacings = (f"{h:g} {length}" for h in self.certified_on)
        rows.append(("certified on", ", ".join(spacings) or "no lattice"))
        return rows + proven_rows(self.certificate) + error_rows(self.errors)

    def __repr__(self) -> str:
        return in_rows("Model", self.rows())

    def _repr_html_(self) -> str:
        return as_table(self.rows())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model as JSON, whole or not at all."""
        write_json(path, self.content())


def _figures_in(figures: Any, length: float, stress: float) -> Any:
    """Figures of a certificate in other units; anything else as it is."""
    if not isinstance(figures, dict):
        return figures
    times = {"spacing": length} | dict.fromkeys(("symbol_min", "symbol_bound"), stress)
    times |= dict.fromkeys(("gamma_min", "gamma_minus_2phi_min", "gamma_max"), length**-2)
    return {
        name: value * times[name] if name in times and is_number(value) else value
        for name, value in figures.items()
    }


def model_content(model: Model) -> dict[str, Any]:
    """What the file of a model holds."""
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "length_unit": model.units[0],
        "stress_unit": model.units[1],
    }
    content |= {key: getattr(model, name) for key, name in _NUMBERS.items()}
    content |= {"degree": model.degree, "D": model.D, "D_dilatation": model.D_dilatation}
    content["quadrature"] = QUADRATURE
    content |= {key: getattr(model, key) for key in ("trained_on", "certified_on", *_RECORDS)}
    for key in ("trained_strain", "largest_wave_number"):
        if getattr(model, key) is not None:
            content[key] = getattr(model, key)
    if model.dimension != 2:  # files of sheets name none
        content["dimension"] = model.dimension
    content["sha256"] = content_hash(content)
    return content


def read_content(path: str | os.PathLike[str]) -> Any:
    """The JSON of a model file; InputError where there is none."""
    try:
        with open(path, "rb") as file:
            raw = file.read(LARGEST_FILE + 1)
        if len(raw) > LARGEST_FILE:
            raise InputError(f"{path}: expected a model file of at most {LARGEST_FILE} bytes")
        return json.loads(raw.decode("utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such model file") from None
    except InputError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a readable JSON file ({error})") from None


def load_model(path: str | os.PathLike[str], *, units: Units | None = None) -> Model:
    """Read the file of a linear model, in the units that it names, or converted to others.

    Raises InputError naming what is wrong: not JSON, another format, version or quadrature, units
    that are not known or cannot be converted, missing or unknown keys, numbers out of range,
    contents that are not what was written.
    """
    content = read_content(path)
    try:
        model = replace(model_from(content), file=Path(path))
        return model if units is None else model.in_units(units)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def model_from(content: Any) -> Model:
    """The model of a file's content, as `load_model`."""
    if not isinstance(content, dict):
        raise InputError(f"expected a JSON object, got {type(content).__name__}")
    for key, expected in {"format": FORMAT, "version": VERSION}.items():
        if content.get(key) != expected:
            raise InputError(f"{key}: expected {expected!r}, got {content.get(key)!r}")
    if "kind" in content:
        raise InputError(
            f"kind: expected a linear model, got a {content['kind']!r:.50} one; "
            "warp_peri.load_nonlinear reads nonlinear models"
        )
    written = content
    if not {"length_unit", "stress_unit"} & set(content):
        warnings.warn("the model names no units: taken as Å and TPa", stacklevel=3)
        content = {**content, "length_unit": USUAL[0], "stress_unit": USUAL[1]}
    if missing := sorted(_KEYS - set(content)):
        raise InputError(f"missing keys: {', '.join(missing)}")
    if unknown := sorted(set(content) - _KEYS - _OPTIONAL):
        raise InputError(f"unknown keys: {', '.join(unknown)}")
    if content["quadrature"] != QUADRATURE:
        raise InputError(f"quadrature: expected {QUADRATURE!r}, got {content['quadrature']!r}")
    for key in ("D", "D_dilatation", "trained_on", "certified_on"):
        if not isinstance(content[key], list):
            raise InputError(f"{key}: expected a list, got {content[key]!r}")
    for key in _RECORDS:
        if not isinstance(content[key], dict):
            raise InputError(f"{key}: expected an object, got {content[key]!r}")
    model = Model(
        **{name: content[key] for key, name in _NUMBERS.items()},
        **{
            key: content[key]
            for key in ("D", "D_dilatation", "trained_on", "certified_on", *_RECORDS)
        },
        trained_strain=content.get("trained_strain"),
        largest_wave_number=content.get("largest_wave_number"),
        units=(content["length_unit"], content["stress_unit"]),
        dimension=content.get("dimension", 2),
    )
    if content["degree"] != model.degree:
        raise InputError(
            f"degree: expected {model.degree} for {len(model.D)} coefficients, "
            f"got {content['degree']!r}"
        )
    if "sha256" in content and content["sha256"] != content_hash(written):
        raise InputError(
            "sha256: the contents are not what was written; remove this key to accept them"
        )
    return model


def content_hash(content: dict[str, Any]) -> str:
    """SHA-256 of everything else in a model file."""
    kept = {key: value for key, value in content.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(plain(kept), sort_keys=True).encode()).hexdigest()


def _number(name: str, value: Any) -> float:
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    try:
        number = float(value) if real else np.nan
    except OverflowError:  # a whole number beyond floating point
        number = np.inf
    if not np.isfinite(number):
        raise InputError(f"{name}: expected a finite number, got {value!r:.50}")
    return number


def _numbers(name: str, values: Any) -> list[float]:
    flat = list(values) if isinstance(values, (list, tuple)) or np.ndim(values) == 1 else [values]
    return [_number(name, value) for value in flat]
