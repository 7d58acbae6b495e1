"""Linear bodies at rest on many ranks, on a lattice in tiles."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.core.grid import SCALARS, Grid, complete, refuse_cut, torus_symbol
from warp_peri.core.stencil import q1_tensors
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import agreed
from warp_peri.kernels.micromodulus.rows import rows as row_kernels
from warp_peri.materials.crystal import StencilMaterial, crystal_from_lps
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_transfer import model_at
from warp_peri.mpi.halo import Halo
from warp_peri.mpi.multigrid import LONG, MOST, Between, Convolution, cycle, inverse_filter
from warp_peri.mpi.processes import build, in_turn, inner, world
from warp_peri.points.points import Points
from warp_peri.points.unit_names import check_same
from warp_peri.runtime import shared_by
from warp_peri.solvers.conjugate_gradients import Inner, SolveRecord, definite
from warp_peri.solvers.multigrid import coarser

if TYPE_CHECKING:
    from warp_peri.mpi.subdomain import Subdomain


class RowOperator:
    """L of a lattice in tiles, and what inverts it nearly.

    Args:
        law: certified on the lattice.
        piece: the nodes of this rank, in tiles.

    Raises InputError for a law without a proof, and interior nodes near the edge of the box.
    """

    method = "multigrid"

    def __init__(self, law: StencilMaterial, piece: Subdomain) -> None:
        if piece.tiles is None:
            raise InputError("points: expected a lattice in tiles for a body at rest on ranks")
        comm, tiles, d = piece.comm, piece.tiles, piece.dimension
        self.model, self.points, self.dimension = law, piece, d
        self._tiles, self._box = tiles, tiles.box(comm.rank)
        place = np.ravel_multi_index(tuple((piece.grid - tiles.corner(comm.rank)).T), self._box)
        self._grid = Grid(
            np.eye(d), self._box, 0, False, np.arange(len(place)), place, place[piece.interior]
        )
        self.mask = self._grid.mask()
        with agreed(comm):
            check_same(law.units, piece.units)
            if self.proven is None:
                raise InputError("material: expected one that is proven stable on the lattice")
        self.stencil = stencil = law.stencil
        self._check_whole()
        build(comm, row_kernels(SCALARS[np.dtype(np.float64)], d).pulled)
        tensors = stencil.tensors * stencil.spacing**2
        scale = stencil.spacing**-2
        self._L = Convolution(
            comm,
            tiles,
            stencil.reach,
            lambda torus: scale * torus_symbol(torus, stencil.steps, tensors),
        )

    @cached_property
    def _near(self) -> tuple[Convolution, Between, Any]:
        """What nearly inverts L, which waves do not need: a filter for short waves, and multigrid
        on every second node."""
        law, comm, tiles, d = self.model, self.points.comm, self._tiles, self.dimension
        scale = self.stencil.spacing**-2
        width, symbol = inverse_filter(law)
        short = Convolution(comm, tiles, width, lambda torus: symbol(torus) / scale, np.float32)
        between = Between(comm, tiles)
        near = q1_tensors(law.tensor() * 2.0 ** (d - 2) * scale)
        return short, between, cycle(comm, *near, coarser(self.mask), between.coarse)

    def _check_whole(self) -> None:
        """InputError where nodes are missing within the law's reach of an unknown one."""
        grid, comm, steps = self._grid, self.points.comm, self.stencil.steps
        there = np.zeros((1, *self._box), np.int8)
        there.flat[grid.place] = 1
        body = Halo(comm, self._tiles.everywhere(), self.stencil.reach)(there)[0] > 0
        cut = self.mask & ~complete(body, steps, self.stencil.reach)
        lacking, count = np.sum(comm.allgather((int(cut.sum()), len(grid.interior))), axis=0)
        width = self.stencil.spacing * np.linalg.norm(steps, axis=1).max()
        refuse_cut(lacking, count, f"; give a collar {width:g} wide")

    @property
    def proven(self) -> str | None:
        """What is proven of the law, in one sentence."""
        proof = self.model.certificate
        if proof is None or not proof.holds:
            return None
        return f"one stable answer: D(k) ≥ {proof.proven:.3g} s(k) for all k"

    def product(self, field: np.ndarray) -> np.ndarray:
        """L of planes, at the unknown nodes."""
        pulled = self._L(field)
        pulled *= self.mask
        return pulled

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        field = self._grid.scatter(np.asarray(u)[None])[0]
        return np.asarray(self._grid.gather(self.product(field)[None])[0])

    def rhs(self, b: np.ndarray) -> np.ndarray:
        """b on this rank's interior, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

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

    def inverted(self, right: np.ndarray, tolerance: float) -> tuple[np.ndarray, SolveRecord]:
        """L⁻¹ of a load on this rank's interior, both [i, d]."""
        _ = self._near  # made before the search has its fields
        planes = self._grid.scatter_interior(right)
        found, record = definite(
            self.product, self.nearly_inverse, planes, tolerance, inner=self.inner()
        )
        return self._grid.gather(found[None])[0], record


_proven: dict[tuple[str, float], StencilMaterial] = {}
"""By what a solid holds, not by the object: ranks must agree on what is known."""


def _tensors_of(model: LPSMaterial, spacing: float) -> StencilMaterial:
    """The stencil of a solid on a spacing, proven there by all ranks."""
    comm, here, key = world(), model, (str(model.content()["sha256"]), spacing)
    if key not in _proven:
        if not model.is_certified_on(spacing):
            here = in_turn(comm, lambda: model_at(model, spacing))
        if len(_proven) == MOST:
            del _proven[next(iter(_proven))]
        with shared_by(comm):
            _proven[key] = crystal_from_lps(here, spacing)
    return _proven[key]


def operator_on(material: Any, piece: Subdomain) -> Any:
    """RowOperator of a linear solid on a lattice in tiles; a Model is transferred as `model_at`
    does.

    Raises InputError for other materials, as RowOperator and as their `fitting` does.
    """
    with agreed(piece.comm):
        if not hasattr(material, "stencil"):
            what = type(material).__name__
            raise InputError(f"material: expected a linear solid or a crystal on ranks, got {what}")
        if not isinstance(material, LPSMaterial):
            h, x = piece.spacing, piece.spacing * np.argwhere(np.ones((3,) * piece.dimension))
            material.fitting(Points(x, x[:, 0] == h, h, units=piece.units, axis=piece.axis))
    if isinstance(material, LPSMaterial):
        material = _tensors_of(material, piece.spacing)
    return RowOperator(material, piece)
