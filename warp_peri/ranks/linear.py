"""A linear body at rest on many ranks: conjugate gradients, a windowed inverse and multigrid."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.core.elements import q1_tensors
from warp_peri.core.sweeps import SCALARS, torus_symbol
from warp_peri.errors import InputError
from warp_peri.kernels.micromodulus.rows import rows as row_kernels
from warp_peri.launch import shared_by
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.lps import tensors_of
from warp_peri.points.points import Points
from warp_peri.points.unit_names import check_same
from warp_peri.ranks.convolution import LONG, Convolution, inverse_filter
from warp_peri.ranks.multigrid import Between, cycle
from warp_peri.ranks.petsc import PetscCycle
from warp_peri.ranks.processes import agreed, build, in_turn
from warp_peri.ranks.sums import inner
from warp_peri.statics.conjugate_gradients import Inner, SolveRecord, definite, norm
from warp_peri.statics.multigrid import coarser

if TYPE_CHECKING:
    from warp_peri.ranks.kept import Kept
    from warp_peri.ranks.pieces import Piece
    from warp_peri.statics.linear import Inverse

STAGE = 1e-3
"""Of a residual, after which a solve with a checkpoint writes it."""


class RowOperator:
    """L of a lattice in tiles, and what inverts it nearly.

    Args:
        law: certified tensors of the lattice's spacing.
        piece: the nodes of this rank, in tiles.
        petsc: whether its coarse problem is PETSc's.

    Raises InputError for a law without a proof, and interior nodes near the edge of the box.
    """

    def __init__(self, law: Crystal, piece: Piece, petsc: bool = False) -> None:
        if piece.tiles is None:
            raise InputError("points: expected a lattice in tiles for a body at rest on ranks")
        comm, tiles, d = piece.comm, piece.tiles, piece.dimension
        self.model, self.points, self.dimension = law, piece, d
        self._tiles, self._box, self._petsc = tiles, tiles.box(comm.rank), petsc
        self._place = np.ravel_multi_index(
            tuple((piece.grid - tiles.corner(comm.rank)).T), self._box
        )
        self.reach = int(np.abs(law.steps).max())
        self.mask = np.zeros(self._box, bool)
        self.mask.flat[self._place[piece.interior]] = True
        with agreed(comm):
            self._check()
        self._check_whole()
        build(comm, row_kernels(SCALARS[np.dtype(np.float64)], d).pulled)
        tensors = law.tensors * law.spacing**2
        scale = law.spacing**-2
        self._L = Convolution(
            comm, tiles, self.reach, lambda torus: scale * torus_symbol(torus, law.steps, tensors)
        )

    @cached_property
    def _near(self) -> tuple[Convolution, Between, Any]:
        """What nearly inverts L, which waves do not need: a filter for short waves, and multigrid
        on every second node."""
        law, comm, tiles, d = self.model, self.points.comm, self._tiles, self.dimension
        scale = law.spacing**-2
        width, symbol = inverse_filter(law.steps, law.tensors * law.spacing**2, law.tensor())
        short = Convolution(comm, tiles, width, lambda torus: symbol(torus) / scale, np.float32)
        between = Between(comm, tiles)
        near = q1_tensors(law.tensor() * 2.0 ** (d - 2) * scale)
        made = PetscCycle if self._petsc else cycle
        return short, between, made(comm, *near, coarser(self.mask), between.coarse)

    def _check(self) -> None:
        piece, law = self.points, self.model
        check_same(law.units, piece.units)
        if self.proven is None:
            raise InputError("material: expected one that is proven stable on the lattice")
        inside = piece.grid[piece.interior]
        most = np.array(self._tiles.shape) - 1
        if len(inside) and min(inside.min(), (most - inside).min()) < self.reach:
            raise InputError(
                f"points: expected {self.reach} nodes around the interior, whose displacement is "
                f"given, in a box of {self._tiles.shape}"
            )

    def _check_whole(self) -> None:
        """InputError where nodes are missing within the law's reach of an unknown one."""
        piece, law, d = self.points, self.model, self.dimension
        if piece.count == np.prod(self._tiles.shape):
            return
        bonds = np.broadcast_to(np.eye(d), (len(law.steps), d, d))
        count = Convolution(
            piece.comm, self._tiles, self.reach, lambda torus: torus_symbol(torus, law.steps, bonds)
        )
        there = self.take_up(count(self.lay_out(np.ones_like(piece.x))))
        cut = int(np.abs(there[piece.interior, 0]).round().astype(bool).sum())
        if cut := sum(piece.comm.allgather(cut)):
            raise InputError(
                f"points: expected all bonds of every interior node on ranks, got {cut} nodes with "
                "cut bonds"
            )

    @property
    def proven(self) -> str | None:
        """What is proven of the law, in one sentence."""
        proof = self.model.certificate
        if proof is None or not proof.holds:
            return None
        return f"one stable answer: D(k) ≥ {proof.proven:.3g} s(k) for all k"

    def lay_out(self, values: np.ndarray) -> np.ndarray:
        """Vectors of the nodes [n, d] in planes [d, *box]."""
        field = np.zeros((self.dimension, int(np.prod(self._box))))
        field[:, self._place] = values.T
        return field.reshape(self.dimension, *self._box)

    def take_up(self, field: np.ndarray) -> np.ndarray:
        """Planes at the nodes of this rank, [n, d]."""
        return np.ascontiguousarray(field.reshape(self.dimension, -1)[:, self._place].T)

    def product(self, field: np.ndarray) -> np.ndarray:
        """L of planes, at the unknown nodes."""
        pulled = self._L(field)
        pulled *= self.mask
        return pulled

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        pulled: np.ndarray = self.take_up(self.product(self.lay_out(u)))[self.points.interior]
        return pulled

    def nearly_inverse(self, r: np.ndarray) -> np.ndarray:
        """z ≈ L⁻¹ r: multigrid while the nodes for the filter are on their way, then the filter."""
        short, between, coarse = self._near
        short.start(r)
        long = coarse(between.restrict(r) * coarse.mask)
        z: np.ndarray = between.prolong(long, self._box)
        z *= LONG  # in place: here a rank has most in memory
        z += short.finish()
        z *= self.mask
        return z

    def inner(self) -> Inner:
        """Scalar products and largest values over all ranks; sums of the rows of each tile, then
        of all of them."""
        parts = self._tiles.parts(self._box)
        columns = [(slice(None), *p[1:]) for p in parts if p[0].start == 0]

        def along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            sums = []
            for part in columns:
                rows = (f[:, *part].reshape(*f.shape[:2], -1) for f in (a, b))
                sums.append(np.einsum("arn,arn->ar", *rows).ravel())
            return np.concatenate(sums)

        return inner(self.points.comm, along)

    def solve(
        self, b: np.ndarray, u: np.ndarray, tolerance: float, kept: Kept | None = None
    ) -> tuple[Any, SolveRecord]:
        """Displacement [n, d] with load b on the interior and u given elsewhere.

        With `kept` the answer is written each time that the residual is STAGE of what it was.
        """
        given, right = self.sides(b, u)
        if kept is None:
            found, record = self.inverted(right, tolerance)
            return given + self.take_up(found), record
        start, inner, record = kept.start(), self.inner(), SolveRecord()
        last = np.inf
        inside, size = self.points.interior[:, None], norm(right, inner)
        found = self.lay_out(np.where(inside, 0.0 if start is None else start, 0.0))
        while (left := norm(rest := right - self.product(found), inner)) > tolerance * size:
            if not left < last:
                raise InputError(
                    f"tolerance: {tolerance:.1e} of the load was asked for, the residual stays at "
                    f"{last / size:.1e}, which is rounding"
                )
            last = left
            more, part = self.inverted(rest, max(tolerance * size / left, STAGE))
            found += more
            record.iterations += part.iterations
            kept.keep(given + self.take_up(found))
        record.residual = left / size if size > 0 else 0.0
        return given + self.take_up(found), record

    def sides(self, b: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u where it is given, zero elsewhere, [n, d]; the load in planes, less what that pulls."""
        inside = self.points.interior[:, None]
        given = np.where(inside, 0.0, u)
        return given, self.lay_out(np.where(inside, b, 0.0)) - self.product(self.lay_out(given))

    def inverted(self, right: np.ndarray, tolerance: float) -> tuple[np.ndarray, SolveRecord]:
        """Planes, zero off the unknown nodes, with L of them as given there."""
        _ = self._near  # made before the search has its fields
        return definite(self.product, self.nearly_inverse, right, tolerance, inner=self.inner())

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of a load on this rank's interior [i, d], to a relative residual, for `predict`."""

        def solved(right: np.ndarray, tolerance: float) -> np.ndarray:
            whole = np.zeros(self.points.x.shape)
            whole[self.points.interior] = right
            found = self.take_up(self.inverted(self.lay_out(whole), tolerance)[0])
            return np.asarray(found[self.points.interior])

        return solved

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on this rank's interior, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]


def tensors_at(linear: Any, piece: Piece) -> Crystal:
    """A linear solid or a crystal as tensors on a piece's lattice, proven by all ranks.

    A linear solid is transferred as `model_at` does. Raises InputError as that, and for a crystal
    as Crystal.fitting does.
    """
    if isinstance(linear, Crystal):
        x, inside = one_node(piece.dimension, piece.spacing, linear.horizon)
        with agreed(piece.comm):
            linear.fitting(Points(x, inside, piece.spacing, units=piece.units, axis=piece.axis))
        return linear
    if not linear.is_certified_on(piece.spacing):
        from warp_peri.transfer.cache import model_at  # loads torch, 185 MB a rank

        linear = in_turn(piece.comm, lambda: model_at(linear, piece.spacing))
    with shared_by(piece.comm):
        return tensors_of(linear, piece.spacing)


def one_node(dimension: int, spacing: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """A cube of nodes to a distance around one that is unknown: positions and which it is."""
    steps = int(np.ceil(reach / spacing))
    grid = np.argwhere(np.ones((2 * steps + 1,) * dimension)) - steps
    return spacing * grid, np.asarray((grid == 0).all(axis=1))
