"""Transfer of an LPS to another lattice: a kernel fitted to its waves (theory, M2–M6, T9)."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy import ndarray
from numpy.linalg import eigvalsh, inv, norm, solve

from warp_peri.core import elastic
from warp_peri.core.elastic import GOLDEN_ANGLE, directions, lattice_group, orbit_grid
from warp_peri.core.proof import certify
from warp_peri.core.record import made_once
from warp_peri.core.stencil import Basis
from warp_peri.errors import InputError, called, warn
from warp_peri.fitting.regression import LatticeRows, compressed, norms
from warp_peri.materials import lps_law
from warp_peri.materials.certificate import with_proof
from warp_peri.materials.lps import SPACING_TOLERANCE, LPSMaterial, LPSParameters
from warp_peri.materials.lps_law import GaussNewton, LPSFound, optimum, product_basis
from warp_peri.points.arguments import LENGTHS, ArrayMap, Pair, Positive, Units, symbols, typed
from warp_peri.points.families import AT_EDGES, bond_classes, carried_horizon, families_of
from warp_peri.points.points import Points, PointsLike, unit_vectors

WaveSymbol = ArrayMap
"""k [K, d] along the nodes' axes to D(k) [K, d, d] [stress/length²]."""
WAVES, LARGEST_WAVE = 400, 2.0
"""Waves that a symbol is matched on, and their largest |k| h."""
LONG_WAVES, LONGEST, LONG_WEIGHT = 30, 0.02, 4.0
"""Long waves among the rows, their |k| h, and what they weigh together."""
ZONE_INTERVALS, ZONE_WEIGHT = {2: 12, 3: 10}, 0.1
"""Of a grid on the rest of the zone."""
USUAL_HORIZON = 16.0
"""A horizon [Å] that the numbers of searches suit."""


def wave_rows(
    target: WaveSymbol,
    spacing: float,
    bonds: Basis,
    group: ndarray,
    largest_wave: float = LARGEST_WAVE,
) -> Pair:
    """Rows R and y that fit p = C h² [stress] to D₀(k): waves up to `largest_wave` = |k| h, very
    long ones, and lightly the rest of the zone. InputError for D₀ not symmetric and positive."""
    d = bonds.dimension
    size = largest_wave * (0.02 + 0.98 * ((np.arange(WAVES) * 0.6180339887) % 1))
    grid = orbit_grid(ZONE_INTERVALS[d], group, d)
    blocks = (
        (size[:, None] * directions(WAVES, d), 1.0),
        (LONGEST * directions(LONG_WAVES, d), np.sqrt(LONG_WEIGHT)),
        (grid[norms(grid) > largest_wave], ZONE_WEIGHT),
    )
    phase = np.concatenate([waves for waves, _ in blocks])
    each = [np.full(len(waves), weight / max(len(waves), 1) ** 0.5) for waves, weight in blocks]
    D = called("target: expected a function of k [K, d]", target, phase / spacing)
    D = elastic.checked_symmetric("target", D, (len(phase), d, d)) * spacing**2
    if not (least := eigvalsh(D)[:, 0].min()) > 0:
        raise InputError(f"target: expected a stable crystal, got a wave of stiffness {least:.3g}")
    return compressed(*waves_against(D, phase, bonds, np.concatenate(each)))


def waves_against(target: ndarray, phase: ndarray, bonds: Basis, share: ndarray) -> Pair:
    """Rows R and y of ‖D₀⁻¹ D e − e‖ over polarisations e, for D₀ [K, d, d] and k h, weighted."""
    rows = inv(target)[:, None] @ bonds.symbol(phase)
    right = np.broadcast_to(np.eye(bonds.dimension), target.shape) * share[:, None, None]
    rows = rows.transpose(0, 2, 3, 1) * share[:, None, None, None]
    return rows.reshape(-1, rows.shape[-1]), right.ravel()


def wave_errors(answer: ndarray, target: ndarray) -> ndarray:
    """Relative displacement error ‖D⁻¹ D₀ − I‖₂ at wave vectors, [..., d, d] to [...] (M4)."""
    wrong = solve(answer, target) - np.eye(answer.shape[-1])
    return np.asarray(norm(wrong, ord=2, axis=(-2, -1)))


def carried_symbol(symbol: WaveSymbol, spacing: float, turn: ndarray) -> WaveSymbol:
    """Symbol D(k) of a solid turned on its nodes, for k of any other nodes; beyond the zone of
    coarser nodes, where it would repeat, the local limit goes on."""

    def carried(k: ndarray) -> ndarray:
        size = norm(k, axis=1, keepdims=True)
        part = np.minimum(1.0, LARGEST_WAVE / np.maximum(size * spacing, 1e-300))
        D = symbol(part * k @ turn) / part[:, :, None] ** 2
        return np.asarray(turn @ D @ turn.T)

    return carried


LEAST, LARGEST = 2.0, 5.0
"""Smallest horizon that a lattice has, and the largest that is tried, in spacings."""
FINEST = 10.0
"""Horizon at home in spacings: on finer lattices kernels miss too much, and searches do not end."""
FITTED, LONG, LONG_SHARE = 60, 4, 0.04
"""Wave vectors that a kernel is fitted on; very long ones, their |k| over the largest of these, and
their weight beside all others: it holds the moduli and costs short waves nothing."""
DIRECTIONS, RADII = 7, 40
"""Of the waves that errors are told of: over an eighth of the circle, and lengths."""
TOLERANCE, WORST = 0.005, 0.05
"""Of waves twice as long as the shortest that are fitted; error of the longest that is taken."""
SHARE = 0.5
"""Of the zone's half width π/h, up to which waves are compared, on both lattices: beyond, a lattice
has a dispersion of its own."""
SMOOTHNESS = 1e-6
"""Weight of the second differences of D, which leaves no free directions to search in."""
ZETA = 0.0139
"""c over μ that is asked for, or what is proven at home where that is less: graphene's .010 TPa."""

_said: set[str] = set()


@typed
def on_lattice(
    model: LPSMaterial, *, spacing: Positive, largest_horizon: Positive | None = None
) -> LPSMaterial:
    """Transfer a material to another square lattice and certify it there (theory, M2–M5).

    The kernel is fitted to the dispersion D₀(k) of the model on the nearest lattice that it is
    certified on, with the conditions of a fit kept; no data are needed. A coarser, a finer, or the
    same lattice with fewer bonds. A process fits each once.

    Args:
        model: certified on some lattice.
        spacing: h [Å] of the lattice.
        largest_horizon: largest δ [Å], at least two spacings, such as what a collar carries.

    The horizon is that of the fewest bonds with which waves twice as long as the shortest that the
    kernel is fitted on err by at most TOLERANCE against home, else the most accurate one. The
    model's provenance tells where it comes from and, under "transfer", up to which wavelength it
    agrees with home, and how well. Raises InputError for a model without a certificate, a
    spacing below a tenth of its horizon, and a horizon below two spacings.
    """
    return made_once(_transferred, model, spacing, largest_horizon)  # type: ignore[no-any-return]


def _transferred(model: LPSMaterial, spacing: float, largest_horizon: float | None) -> LPSMaterial:
    unit = symbols(model.units)[0]
    if model.dimension == 3:
        raise InputError(
            "on_lattice: in space crystals.transfer_to_lattice carries crystal_from_lps(model)"
        )
    if not model.certified_on:
        what = "one that is certified on a lattice, which others are fitted to"
        raise InputError(f"model: expected {what}; this one is certified on none")
    horizons = _horizons(model.horizon, spacing, largest_horizon, unit)
    home = min(model.certified_on, key=lambda h: abs(np.log(h / spacing)))
    largest = model.largest_wave_number or SHARE * np.pi / min(model.certified_on)
    band = min(largest, SHARE * np.pi / home, SHARE * np.pi / spacing)
    found = {}
    for last in horizons:
        if (one := _fitted(model, home, spacing, last, band)) is not None:
            found[_errors(one, spacing, model, home, band / 2).max()] = one
        if min(found, default=np.inf) <= TOLERANCE:
            break
    if not found:
        raise InputError(
            f"horizon: no kernel on the lattice of {spacing:g} {unit} keeps the conditions of a "
            f"certificate within {last:g} {unit}"
        )
    return _recorded(model, home, largest, found[min(found)], spacing, band)


def check_carried(horizon: float, points: Points, spacing: float | None) -> None:
    """Raise InputError for nodes that a material of this horizon [Å] refuses, learned at a spacing
    [Å], on another than which it is transferred; None: for those it is learned on."""
    own = spacing is None or abs(points.spacing / spacing - 1) <= SPACING_TOLERANCE
    if own or points.dimension == 3:
        families_of(points, horizon)
    else:
        unit = symbols(points.units)[0]
        _horizons(horizon, points.spacing, carried_horizon(points), unit)


def _horizons(own: float, spacing: float, largest: float | None, unit: str) -> list[float]:
    """Horizons [Å] that a material of an `own` one may get on a lattice: its bond lengths from two
    spacings on, each adds one class of bonds. InputError for too fine a lattice, or none."""
    if spacing * FINEST < own * (1 - 1e-9):
        raise InputError(
            f"spacing: expected at least a {FINEST:g}th of the model's horizon of "
            f"{own:g} {unit}, got {spacing:g}"
        )
    squares = np.unique(np.add.outer(*2 * [np.arange(int(LARGEST) + 1) ** 2]))
    lengths = spacing * np.sqrt(squares[(squares >= LEAST**2) & (squares <= LARGEST**2)])
    kept: list[float] = lengths[lengths <= (largest or np.inf) * (1 + 1e-9)].tolist()
    if not kept:
        raise InputError(
            f"horizon: a lattice of spacing {spacing:g} {unit} needs one of {LEAST * spacing:g} or "
            f"more, {largest:g} is the largest that fits; nodes end at twice it. {AT_EDGES}"
        )
    return kept


def wave_vectors(largest: float) -> Pair:
    """Wave vectors [1/Å] spread evenly in |k| up to `largest`, [K, 2], and weights (M3), [K]; last
    very long waves, on which only the moduli count."""
    number = np.arange(FITTED) + 0.5
    size = np.append(largest * number / FITTED, np.full(LONG, LONG_SHARE * largest))
    angle = np.append(GOLDEN_ANGLE * number, np.linspace(0, np.pi / 4, LONG))
    k = size[:, None] * unit_vectors(angle)
    return k, np.repeat([1 / FITTED, LONG_WEIGHT / LONG], [FITTED, LONG])


def wave_loss(
    target: ndarray, k: ndarray, spacing: float, bonds: Basis, weight: ndarray
) -> LatticeRows:
    """Loss (M3) of a lattice's symbol against D₀(k), [K, 2, 2], at wave vectors k, [K, 2]: half the
    sum of weight · |D₀⁻¹ D e − e|², the squared relative error of displacement to first order."""
    R, y = waves_against(target, k * spacing, bonds, np.sqrt(weight / 2))
    return LatticeRows(*compressed(R / spacing**2, y), bonds, lattice_group(2))


def _fitted(
    model: LPSMaterial, home: float, spacing: float, horizon: float, band: float
) -> LPSMaterial | None:
    """Fit the kernel at one horizon; None where the conditions cannot be kept."""
    proven = model.figures.get(home, {}).get("symbol_bound", 0.0)
    unit = model.mu  # of stiffness: soft materials meet the same tolerances
    zeta = min(ZETA * unit, proven) or ZETA * unit
    length = search_length(model.units, model.horizon)
    classes = bond_classes(spacing / length, horizon / length)
    k, weight = wave_vectors(band)
    target = model.stencil(home).symbol(home * k) * length**2 / unit
    loss = wave_loss(target, k * length, classes.spacing, product_basis(classes), weight)
    start = LPSFound(LPSParameters(model.lam / unit, 1.0, 1.0, np.ones(len(classes.r) + 1)))
    method = GaussNewton(smoothness=SMOOTHNESS)
    best = optimum([loss], [classes], start, lps_law.StabilityConditions(zeta=zeta / unit), method)
    if not best.converged:
        return None
    lam, mu, alpha, D = best.solid.values()
    return LPSMaterial(unit * lam, unit * mu, alpha, D, horizon, units=model.units)


def _errors(
    there: LPSMaterial, spacing: float, model: LPSMaterial, home: float, largest: float
) -> ndarray:
    """Largest relative displacement error of waves of |k| up to `largest` (M4), [RADII], in
    directions from an axis to a diagonal, by symmetry all."""
    angle = np.linspace(0, np.pi / 4, DIRECTIONS)
    size = largest * (np.arange(RADII) + 1) / RADII
    k = (size[:, None, None] * unit_vectors(angle)).reshape(-1, 2)
    D, target = there.stencil(spacing).symbol(spacing * k), model.stencil(home).symbol(home * k)
    return np.asarray(wave_errors(D, target).reshape(RADII, DIRECTIONS).max(axis=1))


def _recorded(
    model: LPSMaterial, home: float, largest: float, found: LPSMaterial, spacing: float, band: float
) -> LPSMaterial:
    """The certified model with its origin and its error by wavelength; InputError when the proof
    does not hold, or the longest waves are missed."""
    certificate, unit = certify(found, spacing=spacing), symbols(model.units)[0]
    on = f"on the lattice of {spacing:g} {unit}"
    if not certificate.holds:
        raise InputError(
            f"horizon: nothing is proven of the kernel {on} at horizon {found.horizon:g} {unit}"
        )
    largest = min(largest, 0.99 * np.pi / spacing, 0.99 * np.pi / home)
    wavelengths = 2 * np.pi / (largest * (np.arange(RADII) + 1) / RADII)
    errors = _errors(found, spacing, model, home, largest)
    good = {x: np.argmax(np.append(errors, np.inf) > x) for x in (0.005, 0.01, 0.02, WORST)}
    parts = [f"{wavelengths[n - 1]:.3g} {unit} to {100 * x:g} %" for x, n in good.items() if n]
    if not parts:
        raise InputError(
            f"horizon: no kernel {on} answers the longest waves as on that of {home:g} {unit}, "
            f"within {100 * WORST:g} %; the best misses them by {100 * errors[0]:.2g} %"
        )
    bonds = len(bond_classes(spacing, found.horizon).steps)
    record = {
        "units": list(model.units),
        "from_spacing": home,
        "from_horizon": model.horizon,
        "home": model.content()["sha256"],
        "bonds": bonds,
        "fitted_to": 2 * np.pi / band,
        "wavelength": wavelengths.tolist(),
        "error": errors.tolist(),
        "symbol_bound": certificate.symbol_bound,
        "statement": (
            f"from {home:g} {unit} to {spacing:g} {unit} (δ = {found.horizon:.4g} {unit}, {bonds} "
            f"bonds): waves longer than {', '.join(parts)}"
        ),
    }
    return replace(
        found,
        trained_on=model.trained_on,
        certified_on=(spacing,),
        trained_strain=model.trained_strain,
        largest_wave_number=band,
        certificate={f"{spacing:g}": certificate.figures()},
        provenance={**model.provenance, "transfer": record},
        versions=model.versions,
    )


def model_at(
    model: LPSMaterial,
    spacing: float,
    points: PointsLike | None = None,
    *,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> LPSMaterial:
    """The model for a lattice spacing [Å] (0: scattered points): itself where certified, else
    transferred, within the horizon that the collar of points carries; one certified on none is
    proven here. Without `transfer` other spacings are refused; with `allow_uncertified` it is
    itself, with a warning. Raises InputError where nothing is proven of it here, and for points in
    other units or with a collar that no transfer fits."""
    if points is not None:
        model.own_nodes(points)
    if model.dimension == 3 and not model.is_certified_on(spacing):
        model = replace(model, certified_on=())  # in space no kernel is carried: it is proven anew
    if spacing and transfer and not (model.certified_on or allow_uncertified):
        with suppress(InputError):  # where nothing holds here whoever asks says what that means
            model = made_once(with_proof, model, spacing)
    at_home = spacing == 0 or model.is_certified_on(spacing)
    if at_home or allow_uncertified or not transfer or not model.certified_on:
        model.check_spacing(spacing, allow_uncertified=allow_uncertified)
        return model
    found = on_lattice(model, spacing=spacing)
    if points is not None and found.horizon > (largest := carried_horizon(points)) * (1 + 1e-9):
        found = on_lattice(model, spacing=spacing, largest_horizon=largest)
    if (once := found.content()["sha256"]) not in _said:
        _said.add(once)
        warn(f"transferred {found.provenance['transfer']['statement']}")
    return found


def search_length(units: Units, horizon: float) -> float:
    """Unit of length that a search works in, in that of `units`, for a horizon in it. Starts,
    steps, bounds and tolerances of a search are numbers. It works in Å whatever the data are in, so
    that it finds the same in any units; of horizons of another size than usual in powers of 2⁶ of
    it, to the bits of these."""
    known = LENGTHS.get(units[0], 1.0)
    return math.ldexp(1.0, 6 * round(math.log2(horizon * known / USUAL_HORIZON) / 6)) / known
