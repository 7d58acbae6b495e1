"""The bonds of a lattice as a force state reads them, and what its tensions do."""

from __future__ import annotations

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.points.families import families_of
from warp_peri.points.points import PointsLike, nodes_of
from warp_peri.protocols import Remade


class NetworkBonds(Remade):
    """Families of the nodes within a horizon of the interior of a lattice.

    Attributes:
        points: the nodes.
        xi: bond vectors of a family [length], shape [B, 2], r their lengths.
        kind: class of each bond of a family by length, shape [B].
        whole: nodes with whole families, whose dilatation is known, shape [F].
        ends: the node at each of their bonds, shape [F, B].
        row: place of each node among the whole ones, shape [N]; −1 of others.
        own: of the interior nodes, shape [I].
        node, place: the bonds with an interior end, in one of both directions each, by their first
            node among the whole ones and their number in its family, shape [A].
        forward, back: numbers among these of the bonds of the interior nodes, and of the same bonds
            from their other end, shape [I, B].

    Raises InputError for scattered points and those in space, broken bonds, and an interior without
    its 2δ collar.
    """

    def __init__(self, points: PointsLike, horizon: float) -> None:
        if points.x.shape[1] != 2:
            raise InputError(f"points: expected a plane, got {points.x.shape[1]} dimensions")
        if points.outside is not None:
            raise InputError("points: expected none outside of the body")
        families = families_of(points, horizon)
        self.points, self.kind = nodes_of(points), families.classes.bond_class
        self.xi, self.whole = families.pattern, families.whole
        self.r = np.hypot(*self.xi.T)
        self.ends = families.neighbour.reshape(-1, len(self.xi))[self.whole]
        self.row = np.full(len(points.x), -1)
        self.row[self.whole] = np.arange(len(self.whole))
        self.own = self.row[families.rows]
        acts = points.interior[self.whole][:, None] | points.interior[self.ends]
        number = np.cumsum(acts).reshape(acts.shape) - 1
        self.node, self.place = np.nonzero(acts)
        self.forward = number[self.own]
        self.back = number[self.row[self.ends[self.own]], families.reverse]

    def stretch(
        self, u: torch.Tensor, share: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Extensions e = |Y| − |ξ| of whole families [length], [S, F, B], dilatations ϑ = Σ share e
        (NO3), [S, F], and directions M = Y/|Y| of the interior's bonds, [S, I, B, 2], of u
        [S, N, 2] and shares [B]; Y = ξ + u_j − u_i."""
        xi, r = (torch.as_tensor(one, dtype=u.dtype) for one in (self.xi, self.r))
        eta = u[:, self.ends] - u[:, self.whole, None]
        Y = xi + eta
        length = torch.linalg.vector_norm(Y, dim=-1)
        e = ((2 * xi + eta) * eta).sum(dim=-1) / (length + r)  # without the cancellation
        length = length[:, self.own]
        M = Y[:, self.own] / torch.where(length > 0, length, 1.0)[..., None]
        return e, e @ share, M
