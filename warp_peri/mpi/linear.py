"""Linear bodies at rest on many ranks: stencils on tiles and their approximate inverses (R1, R2).

Each tile has its own transform over its nodes and those around it; none crosses ranks, so that the
bits are the same on any number of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache, reduce
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.fft

from warp_peri.core.stencil import SCALARS, Grid, complete, q1_tensors, refuse_cut, torus_symbol
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import agreed
from warp_peri.kernels.micromodulus import rows as row_kernels
from warp_peri.materials.crystal import StencilMaterial, crystal_from_lps
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.transfer import model_at
from warp_peri.mpi.processes import Comm, Halo, Tiles, build, in_turn, inner, world
from warp_peri.points.points import Points
from warp_peri.points.unit_names import check_same
from warp_peri.runtime import get_num_threads, shared_by
from warp_peri.solvers.multigrid import (
    SHIFT,
    VCycle,
    coarser,
    largest,
    prolong,
    restrict,
    seen_by_coarser,
    shear,
    shifted_inverse,
)
from warp_peri.solvers.systems import Inner, SolveRecord, definite

if TYPE_CHECKING:
    from warp_peri.mpi.subdomain import Subdomain

WIDTH = {2: 32, 3: 12}
"""Half the width of the inverse filter [nodes]."""
LONG = 0.7
"""Share of the long waves' answer beside the filter's, which is alone right for short ones: with
less than all of it the iterations grow by one or two, not three, from 128² to 2000²."""
TORUS = 8
"""Widths of the torus that the filter is taken from."""
MOST = 32
"""Solids whose filters, tensors and proofs are remembered."""


class Convolution:
    """Product of a symmetric stencil with fields in tiles, zero beyond the box. `symbol` gives the
    stencil's transform on a torus of a given shape, [d, d, *torus] halved."""

    def __init__(
        self,
        comm: Comm,
        tiles: Tiles,
        reach: int,
        symbol: Callable[[tuple[int, ...]], np.ndarray],
        dtype: type = np.float64,
    ) -> None:
        self.reach, self.dtype = reach, dtype
        self.box, self.parts = tiles.box(comm.rank), tiles.parts(tiles.box(comm.rank))
        self.halo, cuts = Halo(comm, tiles, reach), len(tiles.block)
        across = (max(n, reach + 1) + reach for n in tiles.shape[cuts:])  # the stencil fits too
        sizes = (*(n + 2 * reach for n in tiles.block), *across)
        self.torus = tuple(scipy.fft.next_fast_len(n, real=True) for n in sizes)
        self.symbol: np.ndarray = symbol(self.torus).astype(dtype)

    def start(self, field: np.ndarray) -> None:
        """Request the nodes of other ranks; `finish` gives the product."""
        self._wide, self._fill_halo = self.halo.start(field.astype(self.dtype, copy=False))

    def finish(self) -> np.ndarray:
        """Product with the field given to `start`, [d, *box]; inner tiles first."""
        out: np.ndarray = np.empty((len(self._wide), *self.box), self.dtype)
        inner = [part for part in self.parts if self._is_inner(part)]
        for part in inner:
            self._fill(out, part)
        self._fill_halo()
        for part in self.parts:
            if part not in inner:
                self._fill(out, part)
        del self._wide, self._fill_halo
        return out

    def _is_inner(self, part: tuple[slice, ...]) -> bool:
        """Whether a tile's stencils reach no node of other ranks."""
        far = self.reach
        return all(p.start >= far and p.stop + far <= n for p, n in zip(part, self.box))

    def _fill(self, out: np.ndarray, part: tuple[slice, ...]) -> None:
        """Compute one tile of the product, a component at a time to save memory."""
        d, far, torus = len(self._wide), self.reach, self.torus
        here = self._wide[:, *(slice(p.start, p.stop + 2 * far) for p in part)]
        kept = [slice(far, far + p.stop - p.start) for p in part]
        kept += [slice(0, n) for n in self.box[len(part) :]]
        wave = np.empty((d, *torus[:-1], torus[-1] // 2 + 1), np.result_type(self.dtype, 1j))
        for one, there in zip(wave, here):
            one[...] = scipy.fft.rfftn(there, s=torus, workers=get_num_threads())
        for i in range(d):
            mixed = np.einsum("j...,j...->...", self.symbol[i], wave)
            found = scipy.fft.irfftn(mixed, s=torus, workers=get_num_threads(), overwrite_x=True)
            out[i][part] = found[*kept]

    def __call__(self, field: np.ndarray) -> np.ndarray:
        self.start(field)
        return self.finish()


@lru_cache(MOST)
def inverse_filter(law: StencilMaterial) -> Callable[[tuple[int, ...]], np.ndarray]:
    """Short-range part of the inverse of D + SHIFT G p(k) as a symbol, beside multigrid. Windowed
    by Bartlett's window, whose transform is not negative, so that it stays positive (R2)."""
    steps, d = law.stencil.steps, law.dimension
    width, axes = WIDTH[d], tuple(range(d))
    torus, size = (TORUS * width,) * d, 2 * width + 1
    tensors = law.stencil.tensors * law.stencil.spacing**2
    shift = SHIFT * shear(law.tensor()) * seen_by_coarser(torus)
    along = 1 - np.abs(np.arange(-width, width + 1)) / (width + 1)
    window = reduce(np.multiply.outer, d * [along])
    kernel = [
        np.roll(scipy.fft.irfftn(one, s=torus), d * (width,), axes)[d * (slice(size),)] * window
        for row in shifted_inverse(torus, steps, tensors, shift)
        for one in row
    ]

    def symbol(torus: tuple[int, ...]) -> np.ndarray:
        waves = np.empty((d * d, *torus[:-1], torus[-1] // 2 + 1))
        for part, wave in zip(kernel, waves):  # one at a time: transforms are large in space
            field = np.zeros(torus)
            field[d * (slice(size),)] = part
            wave[:] = scipy.fft.rfftn(np.roll(field, d * (-width,), axes)).real
        return waves.reshape(d, d, *waves.shape[1:])

    return symbol


WHOLE = 10_000
"""Most nodes of a level that every rank has all of."""


class Between:
    """Restriction from the nodes of ranks to every second one, and prolongation back."""

    def __init__(self, comm: Comm, tiles: Tiles) -> None:
        self.coarse, every = tiles.coarser(), tiles.everywhere()
        self._all, self._few = Halo(comm, every, 1), Halo(comm, self.coarse.everywhere(), 1)
        follows = (at + 1 < count for at, count in zip(every.at(comm.rank), every.grid))
        self._with_next = tuple(slice(1, None if more else -1) for more in follows)
        self._wide = tuple(n + 2 for n in tiles.box(comm.rank))

    def around(self, field: np.ndarray) -> np.ndarray:
        """Values on the nodes of this rank and one more around them."""
        return self._all(field)

    def restrict(self, field: np.ndarray) -> np.ndarray:
        """Restriction Pᵗ from this rank's nodes, and one of the next rank's along each cut."""
        return restrict(self.around(field)[:, *self._with_next])

    def prolong(self, field: np.ndarray) -> np.ndarray:
        """Prolongation P to the nodes of this rank."""
        d = len(self._wide)
        before = self._few(field)[:, *(slice(None, -1),) * d]
        return prolong(before, self._wide)[:, *(slice(2, None),) * d]


def cycle(
    comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
) -> _InTiles | _Gathered:
    """Make a multigrid V-cycle on this rank's nodes of a mask, gathered where nodes are few."""
    if np.prod(tiles.shape) <= WHOLE or any(size % 2 for size in tiles.block):
        return _Gathered(comm, steps, tensors, mask, tiles)
    return _InTiles(comm, steps, tensors, mask, tiles)


class _InTiles(Between, VCycle):
    """VCycle of this rank's nodes, whose levels read one more node around them."""

    def __init__(
        self, comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
    ) -> None:
        Between.__init__(self, comm, tiles)
        self._lay(steps, tensors, mask)
        self.largest, few = largest(steps, tensors), coarser(mask)
        self.coarser = cycle(comm, steps, tensors * 2.0 ** (mask.ndim - 2), few, self.coarse)


class _Gathered:
    """Multigrid level that every rank computes as a whole, with one exchange."""

    def __init__(
        self, comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
    ) -> None:
        self.comm, self.mask, self._shape = comm, mask, tiles.shape
        self._own = [tiles.own(r) for r in range(comm.size)]
        full = self._whole(mask[None].astype(float))[0] > 0.5
        self._cycle = VCycle(steps, tensors, full) if full.any() else None

    def _whole(self, field: np.ndarray) -> np.ndarray:
        whole = np.empty((len(field), *self._shape))
        for own, values in zip(self._own, self.comm.allgather(field)):
            whole[:, *own] = values
        return whole

    def __call__(self, r: np.ndarray) -> np.ndarray:
        whole = self._whole(r)
        if self._cycle is None:
            return np.zeros_like(r)
        return self._cycle(whole)[:, *self._own[self.comm.rank]]


class RowOperator:
    """Operator L of a proven material on a lattice in tiles, and an approximate inverse. Raises
    InputError without a proof, and for interior nodes near the edge of the box."""

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
        tensors, scale = stencil.tensors * stencil.spacing**2, stencil.spacing**-2
        symbol = lambda torus: scale * torus_symbol(torus, stencil.steps, tensors)  # noqa: E731
        self._L = Convolution(comm, tiles, stencil.reach, symbol)

    @cached_property
    def _near(self) -> tuple[Convolution, Between, Any]:
        """Parts of the approximate inverse: a filter of short waves, multigrid for long ones."""
        law, comm, tiles, d = self.model, self.points.comm, self._tiles, self.dimension
        scale = self.stencil.spacing**-2
        near, between = inverse_filter(law), Between(comm, tiles)
        short = Convolution(comm, tiles, WIDTH[d], lambda torus: near(torus) / scale, np.float32)
        long = q1_tensors(law.tensor() * 2.0 ** (d - 2) * scale)
        return short, between, cycle(comm, *long, coarser(self.mask), between.coarse)

    def _check_whole(self) -> None:
        """Raise InputError where nodes are missing within reach of an unknown one."""
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
        """Statement in one sentence of what is proven of the material, or None."""
        proof = self.model.certificate
        if proof is None or not proof.holds:
            return None
        return f"one stable answer: D(k) ≥ {proof.proven:.3g} s(k) for all k"

    def product(self, field: np.ndarray) -> np.ndarray:
        """Product L u of planes, at the unknown nodes."""
        pulled = self._L(field)
        pulled *= self.mask
        return pulled

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Force L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        field = self._grid.scatter(np.asarray(u)[None])[0]
        return np.asarray(self._grid.gather(self.product(field)[None])[0])

    def rhs(self, b: np.ndarray) -> np.ndarray:
        """Right-hand side b on this rank's interior."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

    def nearly_inverse(self, r: np.ndarray) -> np.ndarray:
        """Approximate L⁻¹ r by multigrid, while the filter's nodes are sent, and by the filter."""
        short, between, coarse = self._near
        short.start(r)
        long = coarse(between.restrict(r) * coarse.mask)
        z: np.ndarray = between.prolong(long)
        z *= LONG  # in place: here a rank has most in memory
        z += short.finish()
        z *= self.mask
        return z

    def inner(self) -> Inner:
        """Scalar products and largest values over all ranks, summed by rows and tiles."""
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
        """Solve L u = right on this rank's interior, both [i, d]."""
        _ = self._near  # made before the search has its fields
        planes = self._grid.scatter_interior(right)
        found, record = definite(
            self.product, self.nearly_inverse, planes, tolerance, inner=self.inner()
        )
        return self._grid.gather(found[None])[0], record


_proven: dict[tuple[str, float], StencilMaterial] = {}
"""By what a solid holds, not by the object: ranks must agree on what is known."""


def _tensors_of(model: LPSMaterial, spacing: float) -> StencilMaterial:
    """Stencil of a solid on a spacing, proven there by all ranks."""
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
    """Make the RowOperator of a linear solid on a lattice in tiles, of an LPS by `model_at`. Raises
    InputError for other materials, as RowOperator and as their `fitting`."""
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
