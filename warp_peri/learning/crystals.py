"""Laws of micromodulus tensors as recipes: what is learned of them, and with what held."""

from __future__ import annotations

import warnings
from typing import Any

from warp_peri.errors import InputError
from warp_peri.learning.training_data import listed
from warp_peri.micromodulus.laws import Micromodulus
from warp_peri.micromodulus.third_order_learning import ThirdOrderFit, fit_third_order
from warp_peri.models.smoothing import Smoothing
from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples


def third_order(
    samples: Samples | Dataset, linear: Micromodulus, smoothing: Smoothing | None, form: str
) -> ThirdOrderFit:
    """Tensors and third-order constants at once; arguments and errors as for fit_third_order.

    A UserWarning says where training data reach beyond the proven strain.
    """
    if not isinstance(smoothing, Smoothing):
        raise InputError(
            f"smoothing: expected Smoothing(…) beside micromodulus tensors, got {smoothing!r:.60}"
        )
    if linear.moduli is None:
        raise InputError("moduli: expected some that are held, beside third-order constants")
    auto = isinstance(linear.symmetry, str) and linear.symmetry == "auto"
    found = fit_third_order(
        _one(samples),
        linear.horizon,
        smoothing,
        form=form,
        symmetry="isotropic" if auto else linear.symmetry,
        orientation=linear.orientation,
        moduli=linear.moduli,
    )
    proven = found.material.proven_strain(found.material.spacing)
    if found.largest_gradient > proven:
        warnings.warn(
            f"strain: solutions are proven unique up to |H| = {proven:.2%}, the training data "
            f"reach {found.largest_gradient:.2%}; a larger ridge of the smoothing than "
            f"{smoothing.ridge:g} may prove more",
            stacklevel=4,
        )
    return found


def _one(samples: Any) -> Samples:
    """The samples of one set; of a Dataset `train`, or its only set."""
    sets = listed(samples)
    if len(sets) != 1:
        raise InputError(f"samples: expected one set for micromodulus tensors, got {len(sets)}")
    return sets[0]
