"""Certificates of materials and domains: `warp_peri.certificates`."""

from typing import Any

import numpy as np

from warp_peri.core.proof import Certificate, StencilCertificate, certify, largest
from warp_peri.materials.certificate import (
    Solvability,
    Uniqueness,
    check_solvability,
    prove_uniqueness,
)
from warp_peri.materials.transfer import model_at
from warp_peri.points.arguments import Positive, offered, typed
from warp_peri.solvers.verlet import inertia, stiffest_of

__all__ = ["Certificate", "StencilCertificate", "Solvability", "Uniqueness"]
__all__ += ["certify", "critical_time_step", "check_solvability", "prove_uniqueness"]


@typed
def critical_time_step(
    model: Any, *, spacing: Positive, density: Positive, allow_uncertified: bool = False
) -> float:
    """Compute the time step [ps] below which velocity Verlet is stable on a lattice (51, T21).

    2/ω with ω² = max Λmax D(k)/ρ, the maximum proven over the whole zone and at most 0.02 % too
    large (T21). It holds on any nodes with displacement given out to 2δ, and on periodic boxes.

    Args:
        model: certified on some lattice, transferred to others: where D(k) is not positive
            definite, waves grow at any step. A crystal's law is for its own spacing.
        spacing: of the lattice [Å].
        density: mass per volume [kg/m³].
        allow_uncertified: the model's own numbers, with a warning.

    Raises InputError for a model of which nothing is proven there, a horizon below one spacing, a
    density not > 0.
    """
    if hasattr(model, "max_symbol_eigenvalue"):
        stiffest = stiffest_of(model, spacing, allow_uncertified)
    else:
        offered(model, "is_certified_on", "critical_time_step", "a linear solid or a crystal")
        model = model_at(model, spacing, allow_uncertified=allow_uncertified)
        stiffest = largest(model.stencil(model.certified_spacing_near(spacing)), model.group)
    return float(2 * np.sqrt(inertia(density, model.units) / stiffest))
