"""The LPS operator on points of any lattice spacing."""

from __future__ import annotations

from warp_peri.errors import renamed
from warp_peri.launch import DEVICE
from warp_peri.models.lps import Model
from warp_peri.operator import lps
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike
from warp_peri.transfer.points import model_for


class LPSOperator(lps.LPSOperator):
    """The operator of a model's material on points: on lattices of any spacing (theory.md, M2–M5).

    As operator.lps.LPSOperator, which the other arguments are of; `model` is the one that is used.

    Args:
        model: certified on some lattice; on others it is transferred, which is said once.
        points: a lattice, or with allow_uncertified scattered points.
        transfer: False refuses lattices that the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.

    Raises InputError for a point set that does not carry the horizon, scattered points, or an
    uncertified spacing without a transfer.
    """

    @renamed(box="part of Points(…, box=…)", outside="part of Points(…, outside=…)")
    def __init__(
        self,
        model: Model,
        points: PointsLike,
        *,
        quadrature_degree: int = DEGREE,
        transfer: bool = True,
        allow_uncertified: bool = False,
        device: str = DEVICE,
    ) -> None:
        here = model_for(model, points, transfer=transfer, allow_uncertified=allow_uncertified)
        super().__init__(
            here,
            points,
            quadrature_degree=quadrature_degree,
            allow_uncertified=allow_uncertified,
            device=device,
        )
