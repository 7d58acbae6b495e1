"""One influence function for many lattices, to be carried to other codes (theory, M8)."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.arrays import is_positive
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.unit_names import search_length, symbols
from warp_peri.regression.coordinates import LARGEST_ALPHA, SMALLEST_ALPHA, Coordinates, Parameters
from warp_peri.regression.losses import ReducedLoss
from warp_peri.regression.optimum import ConstrainedProblem
from warp_peri.stability.certificate import certify
from warp_peri.transfer.lattice import (
    Home,
    dispersion,
    home_of,
    rings,
    wave_errors,
    wave_loss,
    weighed_waves,
)

CERTIFIED = 9
"""Lattices that the conditions are proven on, their spacings in equal steps."""
CLOSE = 0.12
"""Just before a new length of bonds: this part of the way from the length before it."""
CLOSEST = 0.001
"""Lengths nearer to each other in h/δ are left out: fine lattices have very many."""
WIDE = 0.008
"""Lattices are fitted in the middle too, where two lengths are farther apart in h/δ."""
BETWEEN = 10
"""Lattices between and beside them, never fitted on, whose errors are recorded."""
RATIOS = (0.11, 0.3)
"""Spacings over the horizon that a kernel is meant for."""
MARGIN = 1.06
"""Lattices are fitted a little beyond the ratios that are claimed."""
DEGREE = 8
"""More coefficients gain at short waves what they lose at long ones."""
STEPS = 60
SMOOTHNESS = 1e-6
WAVES = 20
"""Wave vectors on each lattice; twice as many change no error in its third digit."""
LONG_WEIGHT = 16.0
"""Of very long waves beside all others: the moduli hang on them."""
RADII = 12


def one_kernel(
    model: Model, *, horizon: float, ratios: tuple[float, float] = RATIOS, degree: int = DEGREE
) -> Model:
    """One influence function for a range of lattices, h/δ from ratios[0] to ratios[1].

    For codes that take K on grids of their own: a K learned on one lattice means nothing between
    its bond lengths. Fitted to the dispersion of the model on some seventy lattices at once, with
    very long waves weighed most: moduli of one kernel differ from lattice to lattice (M8).

    Args:
        model: certified on some lattice.
        horizon: δ [Å].
        ratios: smallest and largest h/δ, the largest at most 0.45.
        degree: M of the Bernstein polynomials.

    Returns:
        A model certified on nine lattices in equal steps of h/δ; its provenance tells, under
        "many_lattices", the errors by h/δ on ten that it was not fitted on.

    Raises InputError for a horizon that is no length, ratios that are none, or a kernel without a
    proof on each of them.
    """
    (low, high), unit = ratios, model.mu
    if not is_positive(horizon):
        raise InputError(
            f"horizon: expected a length > 0 {symbols(model.units)[0]}, got {horizon!r}"
        )
    if not 0.02 <= low < high <= 0.45:
        raise InputError(f"ratios: expected 0.02 ≤ smallest < largest ≤ 0.45, got {ratios}")
    home = home_of(model, horizon * high)
    band = min(home.largest, 0.5 * np.pi / home.spacing, 0.5 * np.pi / (horizon * high))
    length = search_length(model.units, horizon)
    lattices = [
        bond_classes(horizon * ratio / length, horizon / length) for ratio in _fitted_on(low, high)
    ]
    start = Parameters(model.lam / unit, 1.0, 1.0, np.ones(degree + 1))
    parameters = _least_squares(_losses(home, band, lattices, (length, unit)), start)
    kernel = Model(
        unit * parameters.lam,
        unit * parameters.mu,
        parameters.alpha,
        parameters.D,
        horizon,
        trained_on=model.trained_on,
        units=model.units,
    )
    certificates = [
        certify(kernel, spacing=float(h)) for h in horizon * np.linspace(low, high, CERTIFIED)
    ]
    if not all(proof.holds for proof in certificates):
        raise InputError(
            f"ratios, degree: nothing is proven of the kernel of degree {degree} on some of the "
            f"lattices of h/δ from {low:g} to {high:g}"
        )
    record = _record(kernel, horizon, ratios, Home(model, home.spacing, band, home.zeta))
    return dataclasses.replace(
        kernel,
        certified_on=tuple(proof.spacing for proof in certificates),
        trained_strain=model.trained_strain,
        largest_wave_number=band,
        certificate={f"{proof.spacing:g}": proof.figures() for proof in certificates},
        provenance={**model.provenance, "many_lattices": record},
        versions=model.versions,
    )


def _least_squares(losses: list[ReducedLoss], start: Parameters) -> Parameters:
    """The optimum without conditions, which are not active here: they are proven afterwards."""
    lattices = [loss.classes for loss in losses]
    coordinates = Coordinates(lattices, start.alpha, len(start.D) - 1)
    problem = ConstrainedProblem(losses, [], coordinates, None, SMOOTHNESS)
    y = coordinates.start(start)
    most = np.full(len(y), np.inf)
    least = -most
    if coordinates.free_alpha:
        least[-1], most[-1] = SMALLEST_ALPHA, LARGEST_ALPHA
    best = least_squares(
        lambda y: problem.residual(y)[0],
        y,
        jac=lambda y: problem.residual(y)[1],
        x_scale="jac",
        bounds=(least, most),
        max_nfev=STEPS,
    )
    return coordinates.parameters(best.x, [])


def _fitted_on(low: float, high: float) -> list[float]:
    """h/δ that a kernel is fitted on: at each new length of bonds, and just before it.

    The weights of all bonds jump where one more length comes within the horizon, and with them the
    moduli of a kernel that does not know of it; between two lengths they are smooth.
    """
    most = int(np.ceil((MARGIN / low) ** 2)) + 1
    a, b = np.mgrid[0 : int(np.sqrt(most)) + 2, 0 : int(np.sqrt(most)) + 2]
    squares = np.unique(a**2 + b**2)
    ends = 1 / np.sqrt(squares[squares > 0])
    ratios: list[float] = []
    for longer, shorter in itertools.pairwise(ends):
        if ratios and ratios[-1] - shorter < CLOSEST:
            continue
        ratios.append(longer)
        if longer - shorter > WIDE:
            ratios.append((longer + shorter) / 2)
        ratios.append(shorter + CLOSE * (longer - shorter))
    unseen = np.linspace(low, high, BETWEEN)
    return [
        float(ratio)
        for ratio in ratios
        if low / MARGIN <= ratio <= high * MARGIN and not np.isclose(ratio, unseen).any()
    ]


def _losses(
    home: Home, band: float, lattices: list[BondClasses], units: tuple[float, float]
) -> list[ReducedLoss]:
    """(M8) on each lattice: waves up to a |k|, and very long ones that hold the moduli.

    Lattices are in the units of length and stiffness that are given.
    """
    length, stiffness = units
    k, weight = weighed_waves(band, WAVES, LONG_WEIGHT)
    target = dispersion(home.model, home.spacing, k) * length**2 / stiffness
    return [wave_loss(target, k * length, lattice, weight / len(lattices)) for lattice in lattices]


def _record(
    kernel: Model, horizon: float, ratios: tuple[float, float], home: Home
) -> dict[str, Any]:
    """Errors by h/δ on lattices in between."""
    errors = _between(kernel, horizon, ratios, home)
    return {
        "from_spacing": home.spacing,
        "h_over_horizon": np.linspace(*ratios, BETWEEN).tolist(),
        "mean_error": [float(error.mean()) for error in errors],
        "largest_error": [float(error.max()) for error in errors],
        "waves_longer_than": 2 * np.pi / home.largest,
    }


def _between(
    kernel: Model, horizon: float, ratios: tuple[float, float], home: Home
) -> list[np.ndarray]:
    """Errors by wave on lattices that a kernel was not fitted on, of BETWEEN values of h/δ."""
    waves = rings(home.largest * (np.arange(RADII) + 1) / RADII)
    wanted = dispersion(home.model, home.spacing, waves)
    return [
        wave_errors(dispersion(kernel, float(horizon * ratio), waves), wanted)
        for ratio in np.linspace(*ratios, BETWEEN)
    ]
