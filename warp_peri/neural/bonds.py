"""The bonds of a lattice, each listed once; what a force state needs of them, and what it does."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.points.families import families_of
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.protocols import Remade


class NetworkBonds(Remade):
    """Bonds within two horizons of the interior of a lattice, each once, those by class.

    Attributes:
        points: the nodes.
        xi: bond vectors of a family [length], shape [B, 2].
        kind: class of each bond of a family by length, shape [B].
        opposite: number of −ξ in the family, shape [B].
        rows: interior nodes, where forces act, shape [I].
        whole: nodes with whole families, whose dilatation is known, shape [F].
        near, far, place: ends of each listed bond, and its number in the family of the near one,
            shape [L]. The first `acting` bonds have an interior end.
        own, other: of the acting bonds, the places of the ends among the whole nodes.

    Raises InputError for scattered points and those in space, broken bonds, and an interior without
    its 2δ collar.
    """

    def __init__(self, points: PointsLike, horizon: float) -> None:
        if not points.spacing > 0:
            raise InputError("points: expected a lattice (spacing > 0), got scattered points")
        if points.x.shape[1] != 2:
            raise InputError(f"points: expected a plane, got {points.x.shape[1]} dimensions")
        if points.outside is not None:
            raise InputError("points: expected none outside of the body")
        families = families_of(points, horizon)
        self.points, self.horizon = nodes_of(points), float(horizon)
        self.xi = families.pattern
        self.opposite = families.reverse
        self.kind = families.classes.bond_class
        self.area = points.spacing**2
        self.rows, self.whole = families.rows, families.whole
        self.neighbour = families.neighbour.reshape(-1, len(self.xi))
        self._list()

    def _list(self) -> None:
        """Every bond of a whole family once; a bond of two such families from its first half."""
        nodes, family = len(self.neighbour), len(self.xi)
        inner = self.points.interior
        self.row = np.full(nodes, -1)
        self.row[self.whole] = np.arange(len(self.whole))
        first = np.arange(family) < self.opposite
        far = self.neighbour[self.whole]
        k, p = np.nonzero(first | (self.row[far] < 0))
        i, j = self.whole[k], far[k, p]
        acts = inner[i] | inner[j]
        order = np.lexsort((p, self.kind[p], ~acts))
        self.near, self.far, self.place = i[order], j[order], p[order]
        self.acting = int(acts.sum())
        self.number = np.full((nodes, family), -1)
        listed = np.arange(len(order))
        self.number[self.near, self.place] = listed
        self.number[self.far, self.opposite[self.place]] = listed
        act = slice(self.acting)
        self.own = torch.from_numpy(self.row[self.near[act]])
        self.other = torch.from_numpy(self.row[self.far[act]])
        self.forward = torch.from_numpy(self.place[act].astype(np.int64))
        self.backward = torch.from_numpy(self.opposite[self.place[act]].astype(np.int64))

    @cached_property
    def lengths(self) -> np.ndarray:
        """|ξ| of the family [length], shape [B]."""
        r: np.ndarray = np.hypot(*self.xi.T)
        return r

    @cached_property
    def _places(self) -> tuple[torch.Tensor, ...]:
        """near, far, place, and the listed bonds of whole families, as torch indexes."""
        found = self.near, self.far, self.place, self.number[self.whole]
        return tuple(torch.as_tensor(one, dtype=torch.int64) for one in found)

    def gather(
        self, u: torch.Tensor, share: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Extensions e = |Y| − |ξ| of the acting bonds [length], [S, A], the dilatations ϑ = Σ
        share e of whole nodes (NO3), [S, F], and the directions M = Y/|Y| of these bonds,
        [S, A, 2], of u [S, N, 2] and shares [B]; Y = ξ + u_j − u_i."""
        near, far, place, number = self._places
        xi = torch.as_tensor(self.xi, dtype=u.dtype)[place]
        r = torch.as_tensor(self.lengths, dtype=u.dtype)[place]
        eta = u[:, far] - u[:, near]
        Y = xi + eta
        length = torch.linalg.vector_norm(Y, dim=2)
        e = ((2 * xi + eta) * eta).sum(dim=2) / (length + r)  # without the cancellation
        acting = slice(self.acting)
        M = Y[:, acting] / torch.where(length > 0, length, 1.0)[:, acting, None]
        return e[:, acting], e[:, number] @ share, M

    def scatter(self, M: torch.Tensor, tension: torch.Tensor) -> torch.Tensor:
        """Minus the force density of the acting bonds' tensions [S, A] at all nodes, [S, N, 2]."""
        near, far = (ends[: self.acting] for ends in self._places[:2])
        pull = self.area * tension[..., None] * M
        nodes = M.new_zeros(len(M), len(self.neighbour), 2)
        return nodes.index_add(1, near, -pull).index_add(1, far, pull)
