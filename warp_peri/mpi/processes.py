"""Ranks of mpiexec: output, errors, sums with the same bits on any number of them (R3), tiles,
halos."""

from __future__ import annotations

import functools
import hashlib
import itertools
import math
import os
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from warp_peri import errors
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import agreed
from warp_peri.runtime import DEVICE, get_num_threads, ranks_started, set_num_threads, shared_by
from warp_peri.solvers.systems import Inner

Comm: TypeAlias = Any
"""A communicator of mpi4py."""
GRACE = 0.5
"""Seconds that the first rank has to speak, where all meet the same error."""
THREADS = get_num_threads()
"""Before anybody says a number."""


@functools.cache
def world() -> Comm:
    """Communicator of all ranks; from here on the first prints, and an error of one ends all.

    Sweeps run on one thread unless set otherwise. Raises InputError without mpi4py, and under
    another mpiexec than that of its MPI library.
    """
    os.environ.setdefault("MPIR_CVAR_SUPPRESS_ABORT_MESSAGE", "1")  # our line says it
    started = ranks_started() or 1
    if started > len(os.sched_getaffinity(0)):  # whoever waits gives way to whoever works
        os.environ.setdefault("MPIR_CVAR_CH4_PROGRESS_THROTTLE", "1")
        os.environ.setdefault("MPIR_CVAR_CH4_PROGRESS_THROTTLE_NO_PROGRESS_COUNT", "10")
    if started == 1:
        os.environ.setdefault("UCX_TLS", "self")  # as atoms.load_mpi_library
    elif os.environ.get("UCX_TLS") == "self":
        del os.environ["UCX_TLS"]  # inherited from a process that was alone
    try:
        import mpi4py

        mpi4py.rc.thread_level = "funneled"
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        raise InputError(f"ranks: needs mpi4py: pip install 'warp_peri[mpi]' ({error})") from None
    comm = MPI.COMM_WORLD
    if started > comm.size:
        raise InputError(
            f"mpiexec: {started} processes were started, and they do not see each other: this one "
            f"belongs to another MPI than the library that is loaded; use {own_mpiexec()}"
        )
    if comm.size > 1:
        if get_num_threads() == THREADS:
            set_num_threads(1)
        errors.LAST_WORDS.append(functools.partial(_ended, comm))
        sys.excepthook = functools.partial(_uncaught, comm)
        if comm.rank:
            sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (until the end)
    return comm


def own_mpiexec() -> str:
    """Path of this environment's mpiexec, beside its Python where there is one."""
    beside = Path(sys.executable).with_name("mpiexec")
    return str(beside) if beside.exists() else "the mpiexec of that library"


def is_root() -> bool:
    """Whether this process is the one that writes and draws: alone, or the first rank."""
    return not ranks_started() or world().rank == 0


def _ended(comm: Comm, line: str, status: int) -> None:
    """Print one line, once, and end all ranks."""
    if comm.rank:
        time.sleep(GRACE)
    print(line, file=sys.__stderr__, flush=True)
    time.sleep(GRACE / 5)  # mpiexec, busy as it may be, hears it before it ends all
    comm.Abort(status)
    os._exit(status)  # what has been said is not said again


def _uncaught(comm: Comm, kind: type[BaseException], error: BaseException, trace: Any) -> None:
    known = isinstance(error, InputError)
    lines = [f"error: {error}"] if known else traceback.format_exception(kind, error, trace)
    _ended(comm, f"rank {comm.rank}: " * (not known) + "".join(lines).rstrip(), 2 if known else 1)


def together() -> AbstractContextManager[None]:
    """Share proofs among ranks, each some of the cells; all ranks must come here. Results do not
    depend on the number of ranks. Without mpiexec nothing changes."""
    return shared_by(world()) if ranks_started() else nullcontext()


def in_turn(comm: Comm, make: Callable[[], Any]) -> Any:
    """Call `make` on one rank, then on others, which find its files; an InputError is on all."""
    found = None
    for turn in (comm.rank == 0, comm.rank != 0):
        with agreed(comm):
            if turn:
                found = make()
    return found


def build(comm: Comm, *kernels: Any) -> None:
    """Compile kernels on one rank and load them on the others from Warp's cache."""
    in_turn(comm, lambda: [kernel.module.load(DEVICE) for kernel in kernels])


LIMB, LIMBS = 30, 4
"""Bits of a part, of which 2³³ fit into a whole number, and parts: 120 bits below the largest."""


def total(comm: Comm, values: np.ndarray) -> np.ndarray:
    """Sum values [n, ...] along the first axis over all ranks, shape [...], in any order alike.
    Each value is rounded to multiples of one power of two far below the largest of all ranks."""
    from mpi4py import MPI

    values = np.asarray(values, dtype=float)
    largest = float(np.abs(values).max(initial=0.0))
    highest = comm.allreduce(largest if math.isfinite(largest) else math.inf, op=MPI.MAX)
    if highest == 0 or not math.isfinite(highest):
        return np.full(values.shape[1:], 0.0 if highest == 0 else math.nan)
    exponent = math.frexp(highest)[1]
    rest, parts = np.ldexp(values, -exponent), []
    for _ in range(LIMBS):
        rest = np.ldexp(rest, LIMB)
        whole = np.trunc(rest)
        rest = rest - whole
        parts.append(whole.astype(np.int64).sum(axis=0))
    sums = np.array(parts)
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    exact: Any = sum(limb.astype(object) << LIMB * n for n, limb in enumerate(sums[::-1]))
    return np.asarray(np.ldexp(np.asarray(exact / (1 << LIMB * LIMBS), dtype=float), exponent))


def nodal_fingerprint(comm: Comm, number: np.ndarray, *arrays: np.ndarray) -> str:
    """Fingerprint of arrays [n, ...] on nodes of these global numbers, whoever owns them."""
    marks = np.zeros((len(arrays), 2), np.uint64)
    with np.errstate(over="ignore"):
        for mark, array in zip(marks, arrays):
            flat = np.ascontiguousarray(array, dtype=float).reshape(len(number), -1)
            mixed = _mixed(number.astype(np.uint64))
            for column in flat.view(np.uint64).T:
                mixed = _mixed(mixed ^ column)
            mark[:] = mixed.sum(), _mixed(mixed).sum()
        sums = np.sum(comm.allgather(marks), axis=0)
    return hashlib.sha256(sums.tobytes()).hexdigest()


def _mixed(x: np.ndarray) -> np.ndarray:
    """Hash numbers by Splitmix64, a bijection that spreads every bit."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: np.ndarray = x ^ (x >> np.uint64(31))
    return mixed


def inner(comm: Comm, along: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Inner:
    """Scalar products and largest values over all ranks, for conjugate gradients. `along` gives the
    products of two fields in parts that do not depend on the number of ranks."""
    from mpi4py import MPI

    def dot(a: np.ndarray, b: np.ndarray) -> float:
        return float(total(comm, along(a, b)))

    def largest(a: np.ndarray) -> float:
        here = max(a.max(initial=0.0), -a.min(initial=0.0))
        return float(comm.allreduce(float(here), op=MPI.MAX))

    def add(u: np.ndarray, step: float, p: np.ndarray) -> np.ndarray:
        u += step * p
        return u

    return Inner(dot, lambda a: dot(a, a) ** 0.5, largest, add)


@dataclass(frozen=True, eq=False)
class Tiles:
    """Box of lattice nodes in tiles along its first axes, owned by a grid of ranks.

    Attributes:
        shape: nodes of the box along the axes.
        block: nodes of a tile along the axes that are cut; of slabs of rows that is one.
        starts: along each of these the ranks' first nodes, and the number of nodes, shape [p + 1].
    """

    shape: tuple[int, ...]
    block: tuple[int, ...]
    starts: tuple[np.ndarray, ...]

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of ranks along the axes that are cut."""
        return tuple(len(starts) - 1 for starts in self.starts)

    def at(self, rank: int) -> tuple[int, ...]:
        """Position of a rank in the grid."""
        return tuple(int(n) for n in np.unravel_index(rank, self.grid))

    def own(self, rank: int) -> tuple[slice, ...]:
        """Slices of a rank's nodes along the axes that are cut."""
        return tuple(slice(int(s[i]), int(s[i + 1])) for s, i in zip(self.starts, self.at(rank)))

    def box(self, rank: int) -> tuple[int, ...]:
        """Number of a rank's nodes along each axis."""
        own = self.own(rank)
        return (*(part.stop - part.start for part in own), *self.shape[len(own) :])

    def corner(self, rank: int) -> np.ndarray:
        """First node of a rank, shape [d]."""
        first = [part.start for part in self.own(rank)]
        return np.array(first + [0] * (len(self.shape) - len(first)), np.int32)

    def parts(self, box: tuple[int, ...]) -> list[tuple[slice, ...]]:
        """Slices of the tiles of a rank with so many nodes, from its own first node."""
        along = [
            [slice(first, min(first + size, count)) for first in range(0, count, size)]
            for size, count in zip(self.block, box)
        ]
        return list(itertools.product(*along))

    def everywhere(self) -> Tiles:
        """Tiles cut along all axes, into one part along those that were not."""
        rest = self.shape[len(self.block) :]
        ends = tuple(np.array([0, n]) for n in rest)
        return replace(self, block=self.block + rest, starts=self.starts + ends)

    def coarser(self) -> Tiles:
        """Tiles of every second node along each axis, from the second on."""
        return replace(
            self,
            shape=tuple(n // 2 for n in self.shape),
            block=tuple(n // 2 for n in self.block),
            starts=tuple(starts // 2 for starts in self.starts),
        )


def cut(comm: Comm, shape: tuple[int, ...], block: tuple[int, ...]) -> Tiles:
    """Cut a box of nodes into tiles for all ranks, evenly and with few nodes along the cuts.

    `block` are the nodes of a tile along the first axes, even numbers. Raises InputError for other
    tiles, and for more ranks than tiles or a number that forms no grid.
    """
    fits = 0 < len(block) <= len(shape) and all(isinstance(n, int) for n in block)
    if not fits or any(n < 2 or n % 2 for n in block):
        raise InputError(f"block: expected even numbers, at most {len(shape)}, got {block}")
    while len(block) > 1 and block[-1] >= shape[len(block) - 1]:
        block = block[:-1]  # as wide as the box: not cut there
    counts = tuple(-(-n // size) for n, size in zip(shape, block))
    if comm.size > (most := math.prod(counts)):
        nodes, tile = (" × ".join(map(str, sizes)) for sizes in (shape, block))
        raise InputError(
            f"ranks: expected at most {most} for {nodes} nodes in tiles of {tile}, got {comm.size}"
        )
    found = _grid(comm.size, shape, block, counts)
    if found is None:
        fewer = (n for n in range(comm.size, 0, -1) if _grid(n, shape, block, counts))
        raise InputError(
            f"ranks: expected a product of numbers up to {' and '.join(map(str, counts))}, the "
            f"tiles along the axes, got {comm.size}; {next(fewer)} would do"
        )
    starts = tuple(
        np.minimum(size * (count * np.arange(p + 1) // p), n)
        for n, size, count, p in zip(shape, block, counts, found)
    )
    return Tiles(tuple(int(n) for n in shape), tuple(int(n) for n in block), starts)


def _grid(
    ranks: int, shape: tuple[int, ...], block: tuple[int, ...], counts: tuple[int, ...]
) -> tuple[int, ...] | None:
    """Find the best grid of so many ranks; None where no grid has a tile for each."""
    factors = [n for n in range(ranks, 0, -1) if ranks % n == 0]  # along the first axis at best
    grids = [
        grid
        for grid in itertools.product(*[[n for n in factors if n <= count] for count in counts])
        if math.prod(grid) == ranks
    ]

    def cost(grid: tuple[int, ...]) -> tuple[int, float]:
        most = math.prod(-(-count // p) for count, p in zip(counts, grid))
        return most, sum((p - 1) / n for p, n in zip(grid, shape))  # nodes of the cuts, over all

    return min(grids, key=cost, default=None)


class Halo:
    """Layer, `width` nodes wide, of other ranks' nodes around this one's; zeros beyond the box."""

    def __init__(self, comm: Comm, tiles: Tiles, width: int) -> None:
        self.comm, self.width = comm, width
        own = tiles.own(comm.rank)
        self._inside = tuple(slice(width, width + part.stop - part.start) for part in own)
        others = [(r, tiles.own(r)) for r in range(comm.size) if r != comm.rank]
        given = [(r, _shared(own, theirs, width)) for r, theirs in others]
        taken = [(r, _shared(theirs, own, width)) for r, theirs in others]
        self._give = [(r, (slice(None), *_from(box, own, 0))) for r, box in given if box]
        self._take = [(r, (slice(None), *_from(box, own, width))) for r, box in taken if box]

    def start(self, field: np.ndarray) -> tuple[np.ndarray, Callable[[], None]]:
        """Start an exchange: a field [c, *box] among zeros, and the function that fills these."""
        w, cuts = self.width, len(self._inside)
        sides = (n + 2 * w * (axis < cuts) for axis, n in enumerate(field.shape[1:]))
        wide = np.zeros((len(field), *sides), field.dtype)
        wide[:, *self._inside] = field
        return wide, exchange(self.comm, field, wide, self._give, self._take, w)

    def __call__(self, field: np.ndarray) -> np.ndarray:
        """Field with the nodes of other ranks around it."""
        wide, finish = self.start(field)
        finish()
        return wide


def exchange(
    comm: Comm, field: np.ndarray, wide: np.ndarray, give: Any, take: Any, tag: int = 0
) -> Callable[[], None]:
    """Send parts of a field, as pairs (rank, place); returns the function that receives theirs."""
    from mpi4py import MPI

    out = [(r, np.ascontiguousarray(field[place])) for r, place in give]
    buffers = [(r, np.empty_like(wide[place], order="C")) for r, place in take]
    requests = [comm.Irecv(buffer, source=r, tag=tag) for r, buffer in buffers]
    requests += [comm.Isend(buffer, dest=r, tag=tag) for r, buffer in out]

    def finish() -> None:
        MPI.Request.Waitall(requests)
        for (_, place), (_, buffer) in zip(take, buffers):
            wide[place] = buffer
        out.clear()

    return finish


def _shared(
    have: tuple[slice, ...], want: tuple[slice, ...], width: int
) -> tuple[slice, ...] | None:
    """Part of one box within another that is widened by `width`; None for nothing."""
    both = tuple(
        slice(max(h.start, w.start - width), min(h.stop, w.stop + width))
        for h, w in zip(have, want)
    )
    return both if all(part.start < part.stop for part in both) else None


def _from(box: tuple[slice, ...], own: tuple[slice, ...], margin: int) -> tuple[slice, ...]:
    """Box in coordinates that begin a margin before the first of a rank's own nodes."""
    shifts = (margin - part.start for part in own)
    return tuple(slice(part.start + s, part.stop + s) for part, s in zip(box, shifts))
