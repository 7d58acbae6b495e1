"""The model for a set of points."""

from __future__ import annotations

from warp_peri.models.lps import Model
from warp_peri.points.collar import carried_horizon
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import check_same
from warp_peri.transfer.cache import model_at


def model_for(
    model: Model,
    points: PointsLike,
    *,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> Model:
    """As model_at, for the spacing of the points and the horizon that their collar carries.

    Raises InputError also where the points are in other units than the model.
    """
    check_same(model.units, nodes_of(points).units)
    carried = None
    if points.spacing > 0 and not model.is_certified_on(points.spacing):
        carried = carried_horizon(points)
    return model_at(
        model,
        points.spacing,
        largest_horizon=carried,
        transfer=transfer,
        allow_uncertified=allow_uncertified,
    )
