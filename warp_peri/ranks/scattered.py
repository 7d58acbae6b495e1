"""A linear body at rest on scattered points of many ranks: Tᵗ L T u = Tᵗ b (theory.md, M7).

A rank assembles the rows of its own nodes, from all nodes that these feel. Conjugate gradients are
preconditioned by the inverse of the diagonal, which is right for short waves, and by multigrid on a
coarse lattice in rows for long ones (R4).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.core.elements import q1_tensors
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.micromodulus.lps import tensors_of
from warp_peri.points.interpolation import FINER, NEIGHBOURS
from warp_peri.points.points import Points
from warp_peri.ranks.halo import NodeHalo
from warp_peri.ranks.kept import Kept
from warp_peri.ranks.multigrid import cycle
from warp_peri.ranks.petsc import PetscCycle
from warp_peri.ranks.processes import agreed, in_turn
from warp_peri.ranks.sums import inner
from warp_peri.ranks.tiles import Halo
from warp_peri.statics.conjugate_gradients import Inner, SolveRecord, definite
from warp_peri.statics.scattered import ThroughLattice
from warp_peri.transfer.cache import model_at

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece
    from warp_peri.statics.linear import Inverse

TOUCH = 2.0 * np.sqrt(NEIGHBOURS / np.pi)
"""Mean spacings within which a place of the lattice finds the nodes that it is interpolated from,
and more."""
INSIDE = 0.5
"""Share of a coarse node's neighbourhood that is unknown where it is."""
SHARPER = 0.1
"""Of a residual that is asked for as on a lattice: of the same one more is left of long waves."""
LONG = 2.0
"""Share of the long waves' answer beside the diagonal's."""


class ScatteredOperator:
    """A = Tᵗ L T of scattered nodes, and what inverts it nearly.

    Args:
        model: a linear solid, certified on some lattice.
        piece: the nodes of this rank, of scattered points.
        petsc: whether its coarse problem is PETSc's.

    Raises InputError as ThroughLattice does.
    """

    def __init__(self, model: Model, piece: Piece, petsc: bool = False) -> None:
        comm, carrier = piece.comm, piece.carrier
        self.points = piece
        felt = FINER * carrier * TOUCH
        stencil = carrier * np.ceil(2 * model.horizon / carrier)
        self.halo = halo = NodeHalo(piece, 2 * felt + 2 * stencil)
        inside = np.zeros(len(halo.x), bool)
        inside[halo.own] = piece.interior
        self.through: ThroughLattice | None = None  # where no node is unknown
        self.model = in_turn(comm, lambda: model_at(model, carrier))
        with agreed(comm):
            if inside.any():
                here = Points(halo.x, inside, 0.0, units=piece.units, axis=piece.axis)
                self.through = ThroughLattice(self.model, here, spacing=carrier)
        self._diagonal = np.zeros((0, 2))
        if self.through is not None:
            A = self.through.problem.stiffness
            self._diagonal = A.diagonal().reshape(-1, 2)
        self._long = _Coarse(piece, carrier, self.model, petsc)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """A u at this rank's interior nodes, shape [i, 2], of u [n, 2]."""
        field = np.zeros_like(self.halo.x)
        field[self.halo.own] = u
        self.halo.exchange(field)
        return field[:0] if self.through is None else self.through(field[None])[0]

    @property
    def proven(self) -> str | None:
        """What the certificate of the lattice says, if it holds."""
        model = self.model
        figures = model.certificate.get(f"{model.nominal_spacing(self.points.carrier):g}", {})
        return str(figures["statement"]) if "statement" in figures else None

    def load(self, b: np.ndarray) -> np.ndarray:
        """Tᵗ b at this rank's interior nodes, of b [n, 2] at the nodes."""
        around = self.halo.around(b)
        return around[:0] if self.through is None else self.through.load(around[None])[0]

    def inner(self) -> Inner:
        """Scalar products and largest values over all ranks, of fields at interior nodes."""
        return inner(self.points.comm, lambda a, b: (a * b).sum(axis=1))

    def solve(
        self, b: np.ndarray, u: np.ndarray, tolerance: float, kept: Kept | None = None
    ) -> tuple[Any, SolveRecord]:
        """Displacement [n, 2] with load b on the interior and u given elsewhere.

        Raises InputError for a checkpoint.
        """
        if kept is not None:
            raise InputError("checkpoint: expected a lattice on ranks, got scattered points")
        inside = self.points.interior
        field = np.where(inside[:, None], 0.0, u)
        field[inside], record = self.inverted(self.load(b) - self(field), tolerance)
        return field, record

    def inverse(self, loads: int) -> Inverse:
        """A⁻¹ of a load on this rank's interior [i, 2], to a relative residual, for `predict`."""
        return lambda right, tolerance: self.inverted(right, SHARPER * tolerance)[0]

    def inverted(self, right: np.ndarray, tolerance: float) -> tuple[np.ndarray, SolveRecord]:
        """v at this rank's interior nodes with A v = right, both [i, 2], zero on the collar."""
        inside = self.points.interior

        def product(v: np.ndarray) -> np.ndarray:
            alone = np.zeros_like(self.points.x)
            alone[inside] = v
            return self(alone)

        def nearly_inverse(r: np.ndarray) -> np.ndarray:
            return r / self._diagonal + LONG * self._long(r)

        return definite(product, nearly_inverse, right, tolerance, inner=self.inner())


class _Coarse:
    """N V Nᵗ: linear interpolation from a coarse lattice to interior nodes, and multigrid there.

    Sums go by rows of its cells: those of one row are all on one rank.
    """

    def __init__(self, piece: Piece, spacing: float, model: Model, petsc: bool) -> None:
        if piece.tiles is None or piece.at is None:
            raise InputError("points: expected scattered points by rows, got a lattice")
        comm, tiles, inside = piece.comm, piece.tiles, piece.interior
        self.shape = tiles.box(comm.rank)
        cell = np.floor(piece.at).astype(np.int64)
        share, cell = piece.at - cell, cell - tiles.corner(comm.rank)
        self._share, self._cell = share[inside], cell[inside]
        self._halo = Halo(comm, tiles, 1)
        whole = self._summed(share, cell, np.ones((len(cell), 1)))
        free = self._summed(share, cell, inside[:, None].astype(float))
        self.mask = (free > INSIDE * whole)[0] & (whole > 0)[0]
        elastic = tensors_of(model, spacing).tensor()
        near = q1_tensors(elastic * spacing**-2)
        made = PetscCycle if petsc else cycle
        self._cycle = made(comm, *near, self.mask, tiles)

    def _summed(self, share: np.ndarray, cell: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Nᵗ of values [n, c] at nodes, planes [c, rows, ...]."""
        low, high = (self._row(side, share, cell, values) for side in (0, 1))
        return np.asarray(low + self._halo(high)[:, : self.shape[0]])

    def _row(
        self, side: int, share: np.ndarray, cell: np.ndarray, values: np.ndarray
    ) -> np.ndarray:
        along = share[:, :1] if side else 1 - share[:, :1]
        planes = np.zeros((values.shape[1], int(np.prod(self.shape))))
        for beside in (0, 1):
            weight = along * (share[:, 1:] if beside else 1 - share[:, 1:])
            place = np.ravel_multi_index((cell[:, 0], cell[:, 1] + beside), self.shape)
            for plane, part in zip(planes, (weight * values).T):
                plane += np.bincount(place, part, plane.size)
        return planes.reshape(-1, *self.shape)

    def __call__(self, r: np.ndarray) -> np.ndarray:
        seen = self._summed(self._share, self._cell, r) * self.mask
        z = self._halo(self._cycle(seen))[:, 1:]
        found, (s, t) = 0.0, self._share.T
        for side in (0, 1):
            for beside in (0, 1):
                weight = (s if side else 1 - s) * (t if beside else 1 - t)
                k, n = self._cell.T
                found = found + weight * z[:, k + side, n + beside]
        return np.asarray(found).T
