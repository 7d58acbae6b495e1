"""Lattices within the tolerance of a certified spacing, taken as the certified lattice."""

from __future__ import annotations

import dataclasses

from warp_peri.models.lps import Model
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import check_same


def on_nominal_lattice(model: Model, points: PointsLike) -> Points:
    """The nodes, scaled to the certified spacing that theirs is taken as.

    What is proven of a lattice holds there, and not a millionth beside it: with the bond lengths of
    the certified lattice the operator is the one of the proof. Any other lattice, and scattered
    points, are returned as they are.

    Raises InputError where the points are in other units or dimensions than the model.
    """
    nodes = nodes_of(points)
    check_same(model.units, nodes.units)
    model.check_dimension(nodes)
    spacing = model.nominal_spacing(nodes.spacing)
    if spacing == nodes.spacing:
        return nodes
    scale = spacing / nodes.spacing
    box = None if nodes.box is None else tuple(scale * side for side in nodes.box)
    return dataclasses.replace(nodes, x=scale * nodes.x, spacing=spacing, box=box)
