"""A model on another lattice: a fit to its own waves, proven there (theory, M2–M6)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.core.groups import lattice_group
from warp_peri.errors import InputError
from warp_peri.fitting.regression import LatticeRows
from warp_peri.fitting.rows import compressed
from warp_peri.fitting.settings import Conditions, Optimum
from warp_peri.fitting.transfer import waves_against
from warp_peri.materials.certificate import Certificate, certify
from warp_peri.materials.lps import Model, Solid, lps_stencil
from warp_peri.materials.lps_fit import LPSFound, optimum, product_basis
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.unit_names import search_length, symbols
from warp_peri.transfer import LEAST, RECIPE

WAVES = 60
"""Wave vectors that a kernel is fitted on; twice as many change no error in its third digit."""
GOLDEN_ANGLE = np.pi * (1 + np.sqrt(5))
LONG_WAVES, LONGEST = 4, 0.04
"""Directions of very long waves, and their |k| over the largest that is fitted."""
DIRECTIONS = 7
"""Of the waves that an error is looked for in, over an eighth of the circle."""


def wave_vectors(largest: float, count: int = WAVES) -> np.ndarray:
    """Wave vectors [1/Å] of |k| up to `largest`, shape [count, 2].

    |k| is spread evenly, so that long waves weigh as much as short ones; directions go on by the
    golden angle.
    """
    number = np.arange(count) + 0.5
    size, angle = largest * number / count, GOLDEN_ANGLE * number
    return np.stack([size * np.cos(angle), size * np.sin(angle)], axis=1)


def weighed_waves(largest: float, count: int, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Wave vectors [1/Å] as above, and very long ones, with the weights of all in the loss (M3).

    Only the moduli count on the long ones; together they weigh `weight`, the others 1.
    """
    angle = np.linspace(0, np.pi / 4, LONG_WAVES)
    longest = LONGEST * largest * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    k = np.concatenate([wave_vectors(largest, count), longest])
    return k, np.repeat([1 / count, weight / LONG_WAVES], [count, LONG_WAVES])


def rings(sizes: np.ndarray) -> np.ndarray:
    """Wave vectors [1/Å] of the given |k| in DIRECTIONS directions, shape [sizes, DIRECTIONS, 2].

    From an axis to a diagonal of the lattice: by its symmetry that is all of them.
    """
    angle = np.linspace(0, np.pi / 4, DIRECTIONS)
    vectors: np.ndarray = sizes[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return vectors


def dispersion(model: Model, spacing: float, k: np.ndarray) -> np.ndarray:
    """D(k) [TPa/Å²] of a model on a lattice, shape [..., 2, 2], at k [1/Å], shape [..., 2]."""
    D = lps_stencil(model, spacing).symbol(spacing * k.reshape(-1, 2))
    return D.reshape(*k.shape[:-1], 2, 2)


def wave_loss(
    target: np.ndarray, k: np.ndarray, classes: BondClasses, weight: np.ndarray | None = None
) -> LatticeRows:
    """The loss (M3) of a lattice against D₀(k), shape [K, 2, 2], at wave vectors k, [K, 2].

    Mean over waves and polarisations of |D₀⁻¹ D e − e|²: the square of the relative error of
    displacement, to first order. With weights of the waves, shape [K], their sum instead.
    """
    share = np.full(len(k), 1 / len(k)) if weight is None else weight
    bonds = product_basis(classes)
    R, y = waves_against(target, k * classes.spacing, bonds, np.sqrt(share / 2))
    return LatticeRows(*compressed(R / classes.spacing**2, y), bonds, lattice_group(2))


def wave_errors(answer: np.ndarray, target: np.ndarray) -> np.ndarray:
    """‖D⁻¹ D₀ − I‖₂ at wave vectors, shape [..., 2, 2] to [...] (M4).

    The largest relative error of displacement under a load at that wave vector.
    """
    errors: np.ndarray = np.linalg.norm(
        np.linalg.solve(answer, target) - np.eye(2), ord=2, axis=(-2, -1)
    )
    return errors


TOLERANCE = 0.005
"""Of waves at least twice as long as the shortest that a kernel is fitted on."""
SHARE = 0.5
"""Waves are compared up to this share of the zone's half width π/h, on both lattices: beyond, a
lattice has a dispersion of its own, which is no property of the material."""
LONG_WEIGHT = 4.0
"""Of very long waves beside all others. It holds the moduli, which smooth loads hang on, and costs
short waves nothing that can be seen."""
SMOOTHNESS = 1e-6
"""Weight of the second differences of D. It costs no error that can be seen, and leaves no free
directions to search in: the ripple of a kernel between the bond lengths goes where it may."""
ZETA = 0.0139
"""c over μ that is asked for, or what is proven at home where that is less: graphene's .010 TPa."""
WORST = 0.05
"""Largest error of the longest waves that a transfer is answered with."""
LARGEST = 5.0
"""Largest horizon that is tried where none is given, in spacings."""
RADII = 40
"""Of the rings of waves that a record lists."""


@dataclass(frozen=True)
class Home:
    """What is known at home: the model there, its spacing, and the shortest wave it speaks of."""

    model: Model
    spacing: float
    largest: float
    zeta: float


def new_lattice(
    model: Model,
    *,
    spacing: float,
    horizon: float | None = None,
    tolerance: float | None = None,
    shortest_wave: float | None = None,
    largest_horizon: float | None = None,
) -> Model:
    """The same material on another square lattice, certified there (theory, M2–M5).

    The kernel is fitted to the dispersion D₀(k) of the model on the nearest lattice that it is
    certified on, with the conditions of a fit kept; no data are needed. A coarser, a finer, or the
    same lattice with fewer bonds.

    Args:
        model: certified on some lattice.
        spacing: h [Å] of the lattice.
        horizon: δ [Å], at least two spacings; None takes the fewest bonds that meet the tolerance.
        tolerance: largest relative error of displacement that is allowed for single waves, against
            the model at home; None asks for TOLERANCE and takes the best there is.
        shortest_wave: length [Å] of the waves that the tolerance is for; None for twice the
            shortest that the kernel is fitted on: those longer than four spacings on both lattices
            and no shorter than the training loads held.
        largest_horizon: bound [Å] where no horizon is given, such as what a collar carries.

    Returns:
        A model whose provenance tells where it comes from and, under "transfer", up to which
        wavelength it agrees with home, and how well; its statement is a line of that.

    Raises InputError for a model without a certificate, waves beyond what its data held or what
    the lattice can carry, a horizon below two spacings, or a tolerance that no horizon meets
    (saying the best there is).
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing: expected a lattice spacing > 0, got {spacing}")
    home = home_of(model, spacing)
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"tolerance: expected a fraction > 0, got {tolerance}")
    band = min(home.largest, SHARE * np.pi / home.spacing, SHARE * np.pi / spacing)
    asked = band / 2
    if shortest_wave is not None:
        asked = _asked(home, spacing, shortest_wave)
        band = max(band, asked)
    candidates = _horizons(spacing, largest_horizon) if horizon is None else [horizon]
    try:
        candidate = _fewest(home, spacing, candidates, band, asked, tolerance)
        return _recorded(home, spacing, band, candidate)
    except InputError as error:
        if certify(model, spacing=home.spacing).holds:
            raise
        at = f"{home.spacing:g} {symbols(model.units)[0]}, in its certified_on"
        raise InputError(f"model: nothing can be proven of it on {at}; {error}") from None


@dataclass(frozen=True)
class _Candidate:
    """A kernel on the new lattice, and its largest error on the waves asked for."""

    model: Model
    classes: BondClasses
    zeta: float
    error: float


def _fewest(
    home: Home,
    spacing: float,
    horizons: list[float],
    band: float,
    asked: float,
    tolerance: float | None,
) -> _Candidate:
    """The first horizon whose kernel meets the tolerance, or without one the best of them.

    Raises InputError where none keeps the conditions, or none meets the tolerance.
    """
    best: _Candidate | None = None
    for length in horizons:
        candidate = _fitted(home, spacing, length, band, asked)
        if candidate is not None and (best is None or candidate.error < best.error):
            best = candidate
        if best is not None and best.error <= (tolerance or TOLERANCE):
            break
    unit = symbols(home.model.units)[0]
    if best is None:
        raise InputError(
            f"horizon: no kernel on the lattice of {spacing:g} {unit} keeps the conditions of a "
            f"certificate within {horizons[-1]:g} {unit}"
        )
    if tolerance is not None and best.error > tolerance:
        raise InputError(
            f"tolerance: on the lattice of {spacing:g} {unit} waves longer than "
            f"{2 * np.pi / asked:.3g} {unit} cannot be had to {100 * tolerance:g} %; "
            f"the best is {100 * best.error:.2g} % at horizon {best.model.horizon:g} {unit}"
        )
    return best


def home_of(model: Model, spacing: float) -> Home:
    """What the nearest certified lattice knows; InputError where there is none."""
    if not model.certified_on:
        raise InputError(
            "model: expected one that is certified on a lattice, which others are fitted to; "
            "this one is certified on none"
        )
    nearest = min(model.certified_on, key=lambda h: abs(np.log(h / spacing)))
    figures = model.certificate.get(f"{nearest:g}", {})
    usual = ZETA * model.mu
    proven = figures.get("symbol_bound", 0.0) if isinstance(figures, dict) else 0.0
    largest = model.largest_wave_number
    if largest is None:  # an older file does not tell
        largest = SHARE * np.pi / min(model.certified_on)
    return Home(model, nearest, largest, min(usual, proven) or max(usual, proven))


def _asked(home: Home, spacing: float, shortest_wave: float) -> float:
    """|k| of the shortest wave asked for.

    Raises InputError for waves that the data did not hold or the lattice does not carry.
    """
    if not (np.isfinite(shortest_wave) and shortest_wave > 0):
        raise InputError(f"shortest_wave: expected a length > 0, got {shortest_wave}")
    k, unit = 2 * np.pi / shortest_wave, symbols(home.model.units)[0]
    if k > home.largest * (1 + 1e-9):
        raise InputError(
            f"shortest_wave: the data held waves down to {2 * np.pi / home.largest:.3g} {unit}, "
            f"nothing is known of {shortest_wave:g} {unit}"
        )
    if k >= np.pi / spacing:
        raise InputError(
            f"shortest_wave: a lattice of {spacing:g} {unit} carries waves longer than "
            f"{2 * spacing:g} {unit}, got {shortest_wave:g} {unit}"
        )
    return k


def _horizons(spacing: float, largest: float | None) -> list[float]:
    """Bond lengths of the lattice from two spacings on [Å]: each adds one class of bonds."""
    reach = int(LARGEST)
    a, b = np.mgrid[0 : reach + 1, 0 : reach + 1]
    squares = np.unique(a**2 + b**2)
    lengths = spacing * np.sqrt(squares[(squares >= LEAST**2) & (squares <= LARGEST**2)])
    kept = [
        float(length) for length in lengths if largest is None or length <= largest * (1 + 1e-9)
    ]
    if not kept:
        raise InputError(
            f"horizon: a lattice of spacing {spacing:g} needs one of {2 * spacing:g} or more, "
            f"{largest:g} is the largest that fits"
        )
    return kept


def _fitted(
    home: Home, spacing: float, horizon: float, band: float, asked: float
) -> _Candidate | None:
    """A kernel of one horizon; None where the conditions cannot be kept."""
    length = search_length(home.model.units, home.model.horizon)
    classes = bond_classes(spacing / length, horizon / length)
    k, weight = weighed_waves(band, WAVES, LONG_WEIGHT)
    unit = home.model.mu  # of stiffness, so that soft materials meet the same tolerances
    target = dispersion(home.model, home.spacing, k) * length**2 / unit
    loss = wave_loss(target, k * length, classes, weight)
    terms = len(classes.r) + 1
    start = LPSFound(Solid(home.model.lam / unit, 1.0, 1.0, np.ones(terms)))
    asked_of, method = Conditions(zeta=home.zeta / unit), Optimum(smoothness=SMOOTHNESS)
    best = optimum([loss], [classes], start, asked_of, method)
    if not best.converged:
        return None
    solid = best.solid
    model = Model(
        unit * solid.lam, unit * solid.mu, solid.alpha, solid.D, horizon, units=home.model.units
    )
    waves = rings(asked * (np.arange(RADII) + 1) / RADII)
    errors = wave_errors(
        dispersion(model, spacing, waves), dispersion(home.model, home.spacing, waves)
    )
    return _Candidate(model, classes, home.zeta, float(errors.max()))


def _recorded(home: Home, spacing: float, band: float, candidate: _Candidate) -> Model:
    """The model with its certificate and its record.

    Raises InputError when the proof does not hold.
    """
    certificate = certify(candidate.model, spacing=spacing)
    unit = symbols(home.model.units)[0]
    if not certificate.holds:
        raise InputError(
            f"horizon: nothing is proven of the kernel on the lattice of {spacing:g} {unit} at "
            f"horizon {candidate.model.horizon:g} {unit}"
        )
    record = _record(home, spacing, band, candidate, certificate)
    kept = home.model
    return dataclasses.replace(
        candidate.model,
        trained_on=kept.trained_on,
        certified_on=(spacing,),
        trained_strain=kept.trained_strain,
        largest_wave_number=band,
        certificate={f"{spacing:g}": certificate.figures()},
        provenance={**kept.provenance, "transfer": record},
        versions=kept.versions,
    )


def _record(
    home: Home, spacing: float, band: float, candidate: _Candidate, certificate: Certificate
) -> dict[str, Any]:
    """Where a transferred model comes from, and its error by wavelength, long waves first."""
    largest = min(home.largest, 0.99 * np.pi / spacing, 0.99 * np.pi / home.spacing)
    sizes = largest * (np.arange(RADII) + 1) / RADII
    waves = rings(sizes)
    errors = wave_errors(
        dispersion(candidate.model, spacing, waves), dispersion(home.model, home.spacing, waves)
    ).max(axis=1)
    bonds = len(candidate.classes.steps)
    unit = symbols(home.model.units)[0]
    parts = []
    for level in (0.005, 0.01, 0.02, WORST):
        wave = agrees_to(2 * np.pi / sizes, errors, level)
        if wave is not None:
            parts.append(f"{wave:.3g} {unit} to {100 * level:g} %")
    if not parts:
        raise InputError(
            f"horizon: expected a kernel on the lattice of {spacing:g} {unit} that answers the "
            f"longest waves as on that of {home.spacing:g} {unit}, within {100 * WORST:g} %; the "
            f"best misses them by {100 * errors[0]:.2g} %"
        )
    agreement = f"waves longer than {', '.join(parts)}"
    return {
        "from_spacing": home.spacing,
        "from_horizon": home.model.horizon,
        "home": home.model.content()["sha256"],
        "recipe": RECIPE,
        "bonds": bonds,
        "fitted_to": 2 * np.pi / band,
        "wavelength": (2 * np.pi / sizes).tolist(),
        "error": errors.tolist(),
        "symbol_bound": certificate.symbol_bound,
        "statement": (
            f"from {home.spacing:g} {unit} to {spacing:g} {unit} "
            f"(δ = {candidate.model.horizon:.4g} {unit}, {bonds} bonds): {agreement}"
        ),
    }


def agrees_to(wavelengths: np.ndarray, errors: np.ndarray, level: float) -> float | None:
    """Length [Å] beyond which all waves agree to a level; None when not even the longest do.

    Args:
        wavelengths: [Å], the longest first.
        errors: of them.
        level: a fraction.
    """
    beyond = np.flatnonzero(errors > level)
    last = beyond[0] - 1 if len(beyond) else len(errors) - 1
    return float(wavelengths[last]) if last >= 0 else None
