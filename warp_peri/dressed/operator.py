"""L u = Gᵗ K G u of an even solid on whole lattices, one short convolution after another (D5)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.dressed.bases import half
from warp_peri.micromodulus.nodes import Nodes
from warp_peri.micromodulus.operator import Operator
from warp_peri.micromodulus.sweeps import ByRows
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples

if TYPE_CHECKING:
    from warp_peri.dressed.law import DressedSolid


def placed(solid: DressedSolid, points: Points | Samples) -> Operator:
    """The operator of the same micromodulus law, its product taken in three short ones."""
    operator = solid.crystal.on(points)
    operator.model = solid
    operator.pull = InTurn(operator.nodes, solid)
    return operator


class InTurn:
    """G, then K, then G, each by rows of its own half family."""

    def __init__(self, nodes: Nodes, solid: DressedSolid) -> None:
        dress = int(np.abs(solid.steps).max())
        K = solid.parts.stencils / solid.spacing**2
        if len(solid.tensors) == 1:
            K = K.sum(axis=0, keepdims=True)
        inner = dress + K.shape[1] // 2
        self.nodes, self.parts = nodes, []
        self.core = (slice(None), slice(None), *nodes.core)
        for part, g in zip(K, solid.tensors):
            first = ByRows(_within(nodes, dress), solid.steps, g)
            middle = ByRows(_within(nodes, inner), *half(part))
            self.parts.append((first, middle, ByRows(nodes, solid.steps, g)))

    def __call__(self, planes: np.ndarray) -> np.ndarray:
        """L u at the unknown nodes of planes [S, d, *wide]; planes [S, d, *shape], else zero."""
        total: Any = 0.0
        for first, middle, last in self.parts:
            w = middle(planes - first(planes))
            total = total + (w[self.core] if self.nodes.periodic else w) - last(w)
        mask = self.nodes.mask()
        return np.asarray(total if mask.all() else total * mask)


def _within(nodes: Nodes, reach: int) -> Nodes:
    """All places of the wide box that are so many steps inside it, as unknowns."""
    asked = np.zeros(nodes.wide, bool)
    asked[tuple(slice(reach, n - reach) for n in nodes.wide)] = True
    none = np.zeros(0, int)
    return Nodes(nodes.axes, nodes.wide, reach, False, none, none, np.flatnonzero(asked))
