"""The coarse problem by PETSc: PCMG on the unknown nodes of levels that are never whole anywhere.

The V-cycle is that of ranks.multigrid: the same levels, operators and Chebyshev smoother with fixed
bounds, hence one symmetric operator, which conjugate gradients need. What differs are matrices in
place of sweeps, and a coarsest level of few nodes, whose factors every rank has.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from scipy.sparse import csr_array, kron

from warp_peri.errors import InputError
from warp_peri.ranks.halo import Halo, Tiles
from warp_peri.ranks.multigrid import largest
from warp_peri.ranks.processes import Comm, world
from warp_peri.statics.multigrid import COARSEST, DEGREE, SMOOTHED

PREFIX = "warp_peri_coarse_"
"""Of these solves in PETSc's options database, by which PETSC_OPTIONS changes them."""


def petsc() -> Any:
    """PETSc, on the MPI library of the ranks.

    Raises InputError without petsc4py, and for one that was built without MPI.
    """
    comm = world()
    try:
        import petsc4py

        petsc4py.init(["", "-no_signal_handler"])  # whoever ends a rank has had his say
        from petsc4py import PETSc
    except ImportError as error:
        raise InputError(
            "preconditioner: petsc needs petsc4py, which is built as docs/archive/ranks.md says "
            f"({error})"
        ) from None
    if comm.size != PETSc.COMM_WORLD.size:
        raise InputError(
            f"preconditioner: petsc sees {PETSc.COMM_WORLD.size} of {comm.size} ranks; petsc4py "
            "was built without MPI, or with another (docs/archive/ranks.md)"
        )
    return PETSc


class PetscCycle:
    """z ≈ A⁻¹ r for a stencil of nearest cells on this rank's nodes of a mask.

    Args:
        comm: the ranks.
        steps, tensors: of one half of the stencil, [H, d] and [H, d, d].
        mask: which of this rank's box are unknown.
        tiles: who owns what.

    Raises InputError as `petsc` does.
    """

    def __init__(
        self, comm: Comm, steps: np.ndarray, tensors: np.ndarray, mask: np.ndarray, tiles: Tiles
    ) -> None:
        PETSc, d = petsc(), mask.ndim
        PETSc.garbage_cleanup(comm)  # of earlier ones, which ranks forget at times of their own
        self.mask, self._place = mask, np.flatnonzero(mask)
        level = _Level(comm, mask, tiles)
        matrices, between = [level.matrix(PETSc, steps, tensors)], []
        while level.count > COARSEST and (few := level.coarser()).count:
            between.append(level.prolongation(PETSc, few))
            tensors, level = tensors * 2.0 ** (d - 2), few
            matrices.append(level.matrix(PETSc, steps, tensors))
        self._r, self._z = matrices[0].createVecs()
        self._cycle = pc = PETSc.PC().create(comm)
        pc.setOptionsPrefix(PREFIX)
        pc.setOperators(matrices[0])
        pc.setType("mg" if between else "redundant")
        if between:
            pc.setMGLevels(len(matrices))
            for n, (A, P) in enumerate(zip(reversed(matrices), [None, *reversed(between)])):
                if P is not None:
                    pc.setMGInterpolation(n, P)
                pc.getMGSmoother(n).setOperators(A)
        high = largest(steps, tensors)
        with _defaults(PETSc.Options(PREFIX), high / SMOOTHED, high):
            pc.setFromOptions()
            pc.setUp()

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """Of planes [d, *box], zero outside the mask."""
        d = len(r)
        self._r.array = r.reshape(d, -1)[:, self._place].T.ravel()
        self._cycle.apply(self._r, self._z)
        z = np.zeros(r.shape)
        z.reshape(d, -1)[:, self._place] = self._z.array_r.reshape(-1, d).T
        return z


@contextmanager
def _defaults(options: Any, low: float, high: float) -> Iterator[None]:
    """What a user has not chosen otherwise, in a database that stays the user's."""
    chosen = {
        "mg_levels_ksp_type": "chebyshev",
        "mg_levels_ksp_chebyshev_eigenvalues": f"{low},{high}",
        "mg_levels_ksp_max_it": DEGREE,
        "mg_levels_pc_type": "jacobi",
        "mg_coarse_pc_type": "redundant",
    }
    chosen = {name: value for name, value in chosen.items() if name not in options}
    for name, value in chosen.items():
        options[name] = value
    try:
        yield
    finally:
        for name in chosen:
            del options[name]


class _Level:
    """Unknown nodes of one level, numbered rank by rank; nothing here asks who owns which."""

    def __init__(self, comm: Comm, mask: np.ndarray, tiles: Tiles) -> None:
        self.comm, self.mask, self.tiles = comm, mask, tiles
        self._halo = Halo(comm, tiles, 1)
        self.own = int(mask.sum())
        counts = comm.allgather(self.own)
        self.count = sum(counts)
        self.number = np.full(mask.shape, -1)
        self.number[mask] = np.arange(self.own) + sum(counts[: comm.rank])

    @property
    def _odd(self) -> tuple[slice, ...]:
        """Where the nodes of the coarser level are: every second of the box, from the second on."""
        corner = self.tiles.corner(self.comm.rank).tolist()
        return tuple(slice((first + 1) % 2, None, 2) for first in corner)

    def coarser(self) -> _Level:
        """The next level; its nodes stay on their ranks."""
        return _Level(self.comm, self.mask[self._odd], self.tiles.coarser())

    def _beside(self, number: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Numbers at this rank's unknown nodes moved by steps [s, d], −1 where none is: [n, s]."""
        wide = self._halo((number + 1)[None])[0] - 1
        more = [(n + 2 - m) // 2 for n, m in zip(self.mask.shape, wide.shape)]
        wide = np.pad(wide, [(n, n) for n in more], constant_values=-1)
        found = [
            wide[tuple(slice(1 + s, 1 + s + n) for s, n in zip(step, self.mask.shape))][self.mask]
            for step in steps.tolist()
        ]
        return np.stack(found, axis=1)

    def matrix(self, PETSc: Any, steps: np.ndarray, tensors: np.ndarray) -> Any:
        """The stencil on the unknown nodes, in blocks of d × d."""
        d = self.mask.ndim
        around = np.concatenate([np.zeros((1, d), int), steps, -steps])
        blocks = np.concatenate([2 * tensors.sum(axis=0)[None], -tensors, -tensors])
        first, column, which = _rows(self._beside(self.number, around))
        csr = first.astype(PETSc.IntType), column.astype(PETSc.IntType), blocks[which].ravel()
        size = (self.own * d, self.count * d)
        A = PETSc.Mat().createBAIJ((size, size), d, csr=csr, comm=self.comm)
        return A.convert("aij")  # which every preconditioner knows

    def prolongation(self, PETSc: Any, few: _Level) -> Any:
        """P: linear interpolation along each axis from the unknown nodes of the coarser level."""
        d = self.mask.ndim
        steps = np.array(list(itertools.product((-1, 0, 1), repeat=d)))
        number = np.full(self.mask.shape, -1)
        number[self._odd] = few.number
        first, column, which = _rows(self._beside(number, steps))
        weight = 0.5 ** np.abs(steps).sum(axis=1)[which]
        P = csr_array((weight, column, first), shape=(self.own, few.count))
        P = kron(P, np.eye(d), "csr")  # of each component
        csr = P.indptr.astype(PETSc.IntType), P.indices.astype(PETSc.IntType), P.data
        sizes = (self.own * d, self.count * d), (few.own * d, few.count * d)
        return PETSc.Mat().createAIJ(sizes, csr=csr, comm=self.comm)


def _rows(number: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of columns [n, s], −1 where none is: the first entry of each row, rising columns, which s."""
    order = np.argsort(number, axis=1)
    number = np.take_along_axis(number, order, axis=1)
    there = number >= 0
    first = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
    return first, number[there], order[there]
