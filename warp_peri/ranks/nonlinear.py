"""Nonlinear solids at rest on many ranks: the fixed point of statics.nonlinear, by tiles.

u ← u + L_lin⁻¹ (b − L u): a rank computes L u at its own nodes, from all that they feel, and the
linear solve is that of ranks.linear.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.checkpoint import agreed
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.points import Points
from warp_peri.ranks.halo import NodeHalo
from warp_peri.ranks.linear import RowOperator, one_node, tensors_at
from warp_peri.ranks.processes import in_turn
from warp_peri.ranks.sums import total
from warp_peri.statics.conjugate_gradients import norm
from warp_peri.statics.equilibria import ROUGH, NonlinearRecord, balanced

if TYPE_CHECKING:
    from warp_peri.ranks.kept import Kept
    from warp_peri.ranks.pieces import Piece
    from warp_peri.statics.linear import Inverse


class RowNonlinear:
    """L of a nonlinear solid on a lattice in tiles, and where it balances a load.

    Args:
        material: certified on the lattice, or on another.
        piece: the nodes of this rank, in tiles.

    Raises InputError as `material.on` and RowOperator do.
    """

    def __init__(self, material: Any, piece: Piece) -> None:
        comm = piece.comm
        self.points = piece
        reach = 2 * material.horizon * (1 + HORIZON_TOLERANCE)
        self.halo = halo = NodeHalo(piece, reach)
        x, inside = halo.x, np.zeros(len(halo.x), bool)
        inside[halo.own] = piece.interior
        self._asked = bool(inside.any())
        if not self._asked:  # the law needs an unknown node: one of a body of its own, at rest
            x, inside = one_node(2, piece.spacing, reach)
        self._rest = np.zeros_like(x)
        with agreed(comm):
            here = Points(x, inside, piece.spacing, units=piece.units, axis=piece.axis)
            self.placed = material.on(here)
        self._law = tensors_at(self.placed.model.linear, piece)  # all ranks prove it together
        in_turn(comm, lambda: self.placed(self._rest))  # one compiles
        self.model = self.placed.model
        self.strain = float(self.placed.model.proven_strain(piece.spacing))
        self.proven = f"no other solution has |H| ≤ {self.strain:.2%}" if self.strain > 0 else None

    @cached_property
    def linear(self) -> RowOperator:
        """Its linear part in tiles, which is what is inverted."""
        return RowOperator(self._law, self.points)

    def around(self, u: np.ndarray) -> np.ndarray:
        """u [n, d] on all nodes that this rank feels."""
        field = np.zeros_like(self.halo.x)
        field[self.halo.own] = u
        self.halo.exchange(field)
        return field if self._asked else self._rest

    def _pulled(self, force: Callable[[np.ndarray], np.ndarray], u: np.ndarray) -> np.ndarray:
        """A force of the placed law at this rank's interior nodes, shape [i, d]."""
        return np.asarray(force(self.around(u)))[: self.points.interior.sum()]

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        return self._pulled(self.placed, u)

    def straight(self, u: np.ndarray) -> np.ndarray:
        """Its linear part at u, as above."""
        return self._pulled(self.placed.straight, u)

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on this rank's interior, which the operator equals in equilibrium."""
        return self.linear.load(b)

    def inverse(self, loads: int) -> Inverse:
        """As RowOperator.inverse, of the linear part."""
        return self.linear.inverse(loads)

    def largest_gradient(self, u: np.ndarray) -> float:
        """Largest |H|, of all ranks."""
        own = float(self.placed.largest_gradient(self.around(u)))
        return float(max(self.points.comm.allgather(own)))

    def mean_gradient(self, u: np.ndarray) -> float:
        """Root mean square of |H| over all nodes within δ of unknown ones, of all ranks."""
        H, _ = self.placed.gradients(self.around(u))
        square = np.full(len(self.halo.x), -1.0)
        if self._asked:
            square[self.placed.sweeps.full] = (H**2).sum(axis=(-2, -1))
        square = self.halo.largest(square)  # of its owner and of whoever feels it
        felt = square >= 0
        added, count = total(self.points.comm, np.stack([square * felt, felt], axis=1))
        return float(np.sqrt(added / count))

    def solve(
        self, b: np.ndarray, u: np.ndarray, tolerance: float, kept: Kept | None = None
    ) -> tuple[np.ndarray, NonlinearRecord]:
        """Displacement [n, d] with load b on the interior and u given elsewhere, and the record.

        With `kept` every step that comes closer is written, and the search begins with the last.

        Raises InputError where neither the fixed point comes there, plain or clipped (N13–N15),
        nor Newton's method.
        """
        record, rows, inside = NonlinearRecord(), self.linear, self.points.interior
        inner = rows.inner()
        given, right = rows.sides(b, u)
        scale, least = norm(right, inner), [np.inf]
        if scale == 0:
            record.residual, record.unique = 0.0, self.strain > 0
            return given, record

        def left(force: Callable[[np.ndarray], np.ndarray], v: np.ndarray) -> np.ndarray:
            unbalanced = np.zeros_like(given)
            pulled = self._pulled(force, given + rows.take_up(v))
            unbalanced[inside] = (b[inside] - pulled) / scale
            rest = rows.lay_out(unbalanced)
            if kept is not None and (size := inner.norm(rest)) < least[0]:
                least[0] = size
                kept.keep(given + rows.take_up(v))
            return rest

        def correction(residual: np.ndarray, to: float) -> np.ndarray:
            record.solves += 1
            return rows.inverted(residual * scale, to)[0]

        begin = None if kept is None else kept.start()
        if begin is None:
            start = correction(right / scale, ROUGH)
        else:
            start = rows.lay_out(np.where(inside[:, None], begin, 0.0))

        def clipped() -> Callable[[np.ndarray], np.ndarray] | None:
            return partial(left, self.placed.clipped(self.strain)) if self.strain > 0 else None

        v = balanced(
            partial(left, self.placed), correction, start, tolerance, record,
            clipped=clipped, inner=inner,
        )  # fmt: skip
        if not record.residual <= tolerance:
            raise InputError(
                f"no equilibrium was found: residual {record.residual:.1e} of the right-hand side "
                f"after {record.solves} linear solves; the load may be more than the solid bears"
            )
        answer = given + rows.take_up(v)
        record.largest_gradient = self.largest_gradient(answer)
        record.unique = record.largest_gradient <= self.strain
        return answer, record
