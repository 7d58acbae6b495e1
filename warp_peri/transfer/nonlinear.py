"""A nonlinear model on lattices of other spacings: its linear part transferred, proven anew."""

from __future__ import annotations

import dataclasses

from warp_peri.models.lps import model_content
from warp_peri.models.nonlinear import NonlinearModel
from warp_peri.points.samples import PointsLike
from warp_peri.stability.uniqueness import Uniqueness, uniqueness
from warp_peri.transfer.points import model_for

_known: dict[tuple[object, ...], Uniqueness] = {}


def nonlinear_for(
    model: NonlinearModel,
    points: PointsLike,
    *,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> NonlinearModel:
    """The model for the spacing of the points and the horizon that their collar carries.

    t3, tq2, q3 and the smoothing belong to the material and go along; the weights of Ψ follow the
    lattice, and the proven strain is that of the model there.

    Args:
        model: certified on some lattice.
        points: a lattice.
        transfer: False refuses other spacings.
        allow_uncertified: the linear part's own numbers, with a warning.

    Raises InputError as model_for does.
    """
    options = {"transfer": transfer, "allow_uncertified": allow_uncertified}
    linear = model_for(model.linear, points, **options)
    if linear is model.linear:
        return model
    transferred = dataclasses.replace(model, linear=linear, proven={})
    spacing = linear.nominal_spacing(points.spacing)
    smoothing = None if model.smoothing is None else dataclasses.astuple(model.smoothing)
    key = (model_content(linear)["sha256"], *model.numbers.tolist(), smoothing, spacing)
    if key not in _known:
        _known[key] = uniqueness(transferred, spacing=spacing)
    return dataclasses.replace(transferred, proven={f"{spacing:g}": _known[key].figures()})
