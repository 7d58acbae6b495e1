"""What a finished fit is held to: it explains something, and no modulus lies on its bound."""

from __future__ import annotations

import math
import warnings

from warp_peri.errors import InputError
from warp_peri.learning.methods import Method, TwoStage
from warp_peri.learning.scale import Scale
from warp_peri.learning.training_data import TrainingData
from warp_peri.points.unit_names import symbols
from warp_peri.regression.optimum import HEADROOM
from warp_peri.regression.parameters import SMALLEST_MODULUS, Parameters

ON_BOUND = 1e-3
"""A modulus this near its bound, relative, has ended there."""


def check_explained(final: Parameters, loss: str) -> None:
    """Raise InputError for a fit that explains less than nothing: its loss is no less than without.

    The last loss of the search is relative to the loads, or with "output" to the displacement.
    """
    if final.losses and not final.losses[-1] < 1:
        what = "displacements" if loss == "output" else "loads"
        raise InputError(
            f"u, b: the best model leaves {100 * math.sqrt(final.losses[-1]):.4g} % of the {what}, "
            "no less than no model: they do not belong together, or noise drowns them"
        )


def warn_of_bounds(final: Parameters, data: TrainingData, scale: Scale, method: Method) -> None:
    """Warn of a modulus that ended on its lower bound; all but the scale in the fit's own units."""
    zeta = HEADROOM * data.conditions[0].zeta
    bound = SMALLEST_MODULUS if isinstance(method, TwoStage) else zeta
    moduli = {"μ": final.mu, "λ + μ": final.lam + final.mu}
    low = [name for name, value in moduli.items() if value <= bound * (1 + ON_BOUND)]
    if low:
        unit = symbols(scale.units)[1]
        warnings.warn(
            f"{' and '.join(low)} ended on the lower bound, {bound * scale.stress:.3g} {unit}, "
            f"where the data show a stiffness of {scale.stiffness:.3g} {unit}: they do not "
            "determine it, or ask for less",
            stacklevel=3,
        )
