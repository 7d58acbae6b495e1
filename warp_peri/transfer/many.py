"""One influence function for many lattices, to be carried to other codes (theory.md, M8)."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.points.families import bond_classes
from warp_peri.regression.optimum import constrained_optimum
from warp_peri.regression.parameters import Parameters
from warp_peri.regression.settings import Optimum
from warp_peri.stability.certificate import certify
from warp_peri.stability.conditions import Conditions, LatticeConditions
from warp_peri.transfer.lattice import Home, home_of
from warp_peri.transfer.waves import dispersion, rings, wave_errors, wave_loss, wave_vectors

LATTICES = 13
"""That a kernel is fitted on, their spacings in equal steps."""
BETWEEN = 10
"""Lattices between and beside them, never fitted on, whose errors are recorded."""
RATIOS = (0.11, 0.3)
"""Spacings over the horizon that a kernel is meant for."""
MARGIN = 1.05
"""Lattices are fitted a little beyond the ratios that are claimed."""
DEGREE = 14
SMOOTHNESS = 1e-9
RADII = 12


def one_kernel(
    model: Model,
    *,
    horizon: float,
    ratios: tuple[float, float] = RATIOS,
    degree: int = DEGREE,
) -> Model:
    """One influence function for a range of lattices, h/δ from ratios[0] to ratios[1].

    For codes that take K on grids of their own: a K learned on one lattice means nothing between
    its bond lengths. Fitted to the dispersion of the model on LATTICES spacings at once.

    Args:
        model: certified on some lattice.
        horizon: δ [Å].
        ratios: smallest and largest h/δ, the largest at most 0.45.
        degree: M of the Bernstein polynomials.

    Returns:
        A model certified on the spacings it was fitted on, as far as the proof holds; its
        provenance tells, under "many_lattices", the errors by h/δ on lattices it was not fitted on.

    Raises InputError for ratios that are none, or a fit that does not keep its conditions.
    """
    low, high = ratios
    if not 0.02 <= low < high <= 0.45:
        raise InputError(f"ratios: expected 0.02 ≤ smallest < largest ≤ 0.45, got {ratios}")
    home = home_of(model, horizon * high)
    spacings = horizon * np.linspace(low / MARGIN, high * MARGIN, LATTICES)
    classes = [bond_classes(float(h), horizon) for h in spacings]
    band = min(home.largest, 0.5 * np.pi / home.spacing, 0.5 * np.pi / (horizon * high))
    k = wave_vectors(band)
    target = dispersion(model, home.spacing, k)
    unit = model.mu
    best = constrained_optimum(
        [wave_loss(target / unit, k, lattice) for lattice in classes],
        Parameters(model.lam / unit, 1.0, 1.0, np.ones(degree + 1)),
        [LatticeConditions(lattice, Conditions(zeta=home.zeta / unit)) for lattice in classes],
        Optimum(smoothness=SMOOTHNESS),
    )
    if not best.converged:
        raise InputError(
            f"ratios, degree: no kernel of degree {degree} keeps the conditions on lattices of h/δ "
            f"from {low:g} to {high:g}"
        )
    parameters = best.parameters
    kernel = Model(
        unit * parameters.lam,
        unit * parameters.mu,
        parameters.alpha,
        parameters.D,
        horizon,
        trained_on=model.trained_on,
    )
    certificates = [certify(kernel, spacing=float(h)) for h in spacings]
    record = _record(kernel, horizon, ratios, Home(model, home.spacing, band, home.zeta))
    return dataclasses.replace(
        kernel,
        certified_on=tuple(lattice.spacing for lattice in certificates if lattice.holds),
        trained_strain=model.trained_strain,
        largest_wave_number=band,
        certificate={f"{lattice.spacing:g}": lattice.figures() for lattice in certificates},
        provenance={**model.provenance, "many_lattices": record},
        versions=model.versions,
    )


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
