"""Linear bodies at rest on many ranks: stencils on slabs of rows and a V-cycle before conjugate
gradients, whose bits are the same on any number of ranks (R1)."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

from warp_peri.core.elastic import q1_tensors
from warp_peri.core.stencil import SCALARS, Grid, complete, refuse_cut
from warp_peri.errors import InputError, agreed, shared_by
from warp_peri.kernels.micromodulus import rows as row_kernels
from warp_peri.materials.crystal import StencilMaterial, crystal_from_lps
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.transfer import model_at
from warp_peri.mpi.processes import Comm, Slabs, build, halo, in_turn, inner
from warp_peri.points.arguments import Options, Pair, check_arguments, check_same, offered, picked
from warp_peri.points.points import Points, grid_places
from warp_peri.protocols import OF_PROOFS
from warp_peri.solvers.linear import VCycle, coarser, largest, prolong, restrict
from warp_peri.solvers.systems import SolveRecord, definite

if TYPE_CHECKING:
    from warp_peri.mpi.subdomain import Subdomain

WHOLE = 10_000
"""Most nodes of a level that every rank has all of."""


class Level(VCycle):
    """VCycle of this rank's nodes of a mask, which reads the rows of others around them, with steps
    and tensors of the level `below`."""

    def __init__(
        self,
        comm: Comm,
        slabs: Slabs,
        mask: ndarray,
        steps: ndarray,
        tensors: ndarray,
        below: Pair | None = None,
    ) -> None:
        self._lay(steps, tensors, mask)
        self.comm, self.largest, self._fewer = comm, largest(steps, tensors), slabs.coarser()
        self._below = below or (steps, tensors * 2.0 ** (mask.ndim - 2))
        self._far, self._near = (halo(comm, slabs, width) for width in (self.reach, 1))
        self._few = halo(comm, self._fewer, 1)
        self._end = None if comm.rank + 1 < comm.size else -1  # with a row of the next rank

    @cached_property
    def coarser(self) -> Level | _Gathered:
        few = self._fewer
        whole = np.prod(few.shape) <= WHOLE or few.rows % 2
        return (_Gathered if whole else Level)(self.comm, few, coarser(self.mask), *self._below)

    def around(self, field: ndarray) -> ndarray:
        return self._far(field)

    def restrict(self, field: ndarray) -> ndarray:
        core = (slice(1, self._end), *[slice(1, -1)] * (self.mask.ndim - 1))
        return restrict(self._near(field)[:, *core])

    def prolong(self, field: ndarray) -> ndarray:
        before = self._few(field)[:, *[slice(None, -1)] * self.mask.ndim]
        wide = prolong(before, tuple(n + 2 for n in self.shape))
        return wide[:, *[slice(2, None)] * self.mask.ndim]


class _Gathered:
    """Level that every rank computes as a whole, with one exchange."""

    def __init__(
        self, comm: Comm, slabs: Slabs, mask: ndarray, steps: ndarray, tensors: ndarray
    ) -> None:
        self.comm, self.mask, self._own = comm, mask, slabs.own(comm.rank)
        full = np.concatenate(comm.allgather(mask))
        self._cycle = VCycle(steps, tensors, full) if full.any() else None

    def __call__(self, r: ndarray) -> ndarray:
        whole = np.concatenate(self.comm.allgather(r), axis=1)
        if self._cycle is None:
            return np.zeros_like(r)
        return self._cycle(whole)[:, self._own]


class RowOperator:
    """Operator L of a proven material on a lattice in slabs, and an approximate inverse. Raises
    InputError without a proof, and for interior nodes near the edge of the box."""

    method, is_linear = "multigrid", True

    def __init__(self, law: StencilMaterial, piece: Subdomain) -> None:
        comm, d, stencil = piece.comm, piece.dimension, law.stencil
        self.model, self.points, self.dimension, self.stencil = law, piece, d, stencil
        self.proven = law.statement
        box = piece.slabs.box(comm.rank)
        steps = piece.grid - np.eye(1, d, dtype=int) * piece.slabs.own(comm.rank).start
        place = np.ravel_multi_index(tuple(steps.T), box)
        self._grid = Grid(
            np.eye(d), box, 0, False, np.arange(len(place)), place, place[piece.interior]
        )
        with agreed(comm):
            check_same(law.units, piece.units)
            if self.proven is None:
                raise InputError("material: expected one that is proven stable on the lattice")
        mask, there = self._grid.mask(), np.zeros((1, *box), np.int8)
        there.flat[place] = 1
        body = halo(comm, piece.slabs, stencil.reach)(there)[0] > 0
        cut = mask & ~complete(body, stencil.steps, stencil.reach)  # nodes within reach are missing
        lacking, count = np.sum(comm.allgather((int(cut.sum()), len(self._grid.interior))), axis=0)
        refuse_cut(lacking, count, stencil.spacing * stencil.steps)
        build(comm, row_kernels(SCALARS[np.dtype(np.float64)], d).pulled)
        below = q1_tensors(law.tensor() * 2.0 ** (d - 2) * stencil.spacing**-2)
        how = piece.slabs, mask, stencil.steps, stencil.tensors, below
        self._level = Level(comm, *how)

    def __call__(self, u: ndarray) -> ndarray:
        """Force L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        field = self._grid.scatter(np.asarray(u)[None])[0]
        return np.asarray(self._grid.gather(self._level.product(field)[None])[0])

    def energy(self, *_: Any) -> Any:
        """Raise InputError: it is not had on ranks."""
        raise InputError("operator: energy and stress are not had on ranks")

    stress = energy

    def rhs(self, b: ndarray) -> ndarray:
        """Right-hand side b on this rank's interior."""
        return np.asarray(b, float)[..., self.points.interior, :]

    def inverted(self, right: ndarray, tolerance: float) -> tuple[ndarray, SolveRecord]:
        """Solve L u = right on this rank's interior, both [i, d]."""

        def along(a: ndarray, b: ndarray) -> ndarray:  # planes, summed by rows
            rows = (field.reshape(*field.shape[:2], -1) for field in (a, b))
            return np.ravel(np.einsum("arn,arn->ar", *rows))

        level, planes = self._level, self._grid.scatter_interior(right)
        over_ranks = inner(self.points.comm, along)
        found, record = definite(level.product, level, planes, tolerance, inner=over_ranks)
        return self._grid.gather(found[None])[0], record


def operator_on(material: Any, piece: Subdomain, options: Options) -> Any:
    """Make the RowOperator of a linear solid on a lattice in slabs, of an LPS by `model_at`, whose
    options it takes out. InputError for other materials, as RowOperator and as their `fitting`."""
    with agreed(piece.comm):
        offered(material, "stencil", "material", "a linear solid or a crystal on ranks")
        if not isinstance(material, LPSMaterial):
            h, x = piece.spacing, piece.spacing * grid_places((3,) * piece.dimension)
            material.fitting(Points(x, x[:, 0] == h, h, units=piece.units, axis=piece.axis))
    if isinstance(model := material, LPSMaterial):
        how = check_arguments(model_at, picked(options, *OF_PROOFS))
        if not model.is_certified_on(piece.spacing):
            material = in_turn(piece.comm, lambda: model_at(model, piece.spacing, **how))
        with shared_by(piece.comm):
            material = crystal_from_lps(material, piece.spacing)
    return RowOperator(material, piece)
