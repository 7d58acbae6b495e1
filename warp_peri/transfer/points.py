"""The model for a set of points."""

from __future__ import annotations

from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.collar import carried_horizon
from warp_peri.points.families import AT_EDGES
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import check_same, symbols
from warp_peri.transfer.cache import model_at
from warp_peri.transfer.lattice import LEAST


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
        if transfer and not allow_uncertified and model.certified_on:
            _refuse_edges(points, carried)
    return model_at(
        model,
        points.spacing,
        largest_horizon=carried,
        transfer=transfer,
        allow_uncertified=allow_uncertified,
    )


def _refuse_edges(points: PointsLike, carried: float) -> None:
    """Raise InputError where the collar carries no horizon that a transfer could have."""
    least = LEAST * points.spacing
    if carried < least * (1 - 1e-6):
        unit = symbols(nodes_of(points).units)[0]
        raise InputError(
            f"points: interior nodes lie {2 * carried:.3g} {unit} from an edge, where nodes end; a "
            f"lattice of spacing {points.spacing:g} {unit} needs {2 * least:g} {unit}, twice its "
            f"smallest horizon. {AT_EDGES}"
        )
