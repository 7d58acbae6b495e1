"""Ranks of mpiexec: output, errors, sums with the same bits on any number (R3), slabs, halos."""

from __future__ import annotations

import atexit
import functools
import math
import os
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np
from numpy import ndarray

from warp_peri import errors
from warp_peri.errors import InputError, Shape, Values, agreed, shared_by
from warp_peri.points.arguments import ArrayMap
from warp_peri.runtime import DEVICE, get_num_threads, ranks_started, set_num_threads
from warp_peri.solvers.systems import HERE, Inner

Comm: TypeAlias = Any
"""A communicator of mpi4py."""
GRACE = 0.5
"""Seconds that the first rank has to speak, where all meet the same error."""
ENDED = "ranks: expected all here, each with its piece, but another's script has ended"
ENDING: Values = {}
"""Of this rank: the `status` it leaves with by sys.exit, and whether there were `pieces`."""
PATIENCE = 30.0
"""Seconds that a rank that leaves with a status other than 0 gives the others to leave, too."""
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
        sys.excepthook, sys.exit = functools.partial(_uncaught, comm), _leave
        atexit.register(_at_end, comm)
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
    sys.stdout.flush()
    print(line, file=sys.__stderr__, flush=True)
    time.sleep(GRACE / 5)  # mpiexec, busy as it may be, hears it before it ends all
    comm.Abort(status)
    os._exit(status)  # what has been said is not said again


def _uncaught(comm: Comm, kind: type[BaseException], error: BaseException, trace: Any) -> None:
    known = isinstance(error, InputError)
    lines = [f"error: {error}"] if known else traceback.format_exception(kind, error, trace)
    _ended(comm, f"rank {comm.rank}: " * (not known) + "".join(lines).rstrip(), 2 if known else 1)


class _Left(SystemExit):
    """What sys.exit raises on ranks: Python asks for its code, from no frame, if none caught it."""

    @property
    def code(self) -> Any:  # type: ignore[override]
        status, *_ = *self.args, None
        if sys._getframe().f_back is None:
            ENDING.update(status=status)
            return 1 if isinstance(status, str) else status  # which is said at the end
        return status


def _leave(*status: Any) -> NoReturn:
    raise _Left(*status)


def _at_end(comm: Comm) -> None:
    """As a rank's script ends. Where sys.exit told an error, all end, unless the others leave as
    well; once there are pieces, those that wait for this rank to agree are told that it ended."""
    from mpi4py.MPI import Is_finalized

    if Is_finalized():
        return
    if status := ENDING.get("status"):
        left, whole, since = comm.Ibarrier(), isinstance(status, int), time.monotonic()
        while not (whole and left.Test()):  # a message is said whoever else leaves
            if time.monotonic() >= since + PATIENCE * whole:
                _ended(comm, f"rank {comm.rank} has left: {status}", status if whole else 1)
            time.sleep(GRACE / 10)
    while ENDING.get("pieces") and {*comm.allgather(ENDED)} != {ENDED}:
        pass


def together() -> AbstractContextManager[None]:
    """Share proofs among ranks, each some of the cells; all ranks must come here. Results do not
    depend on the number of ranks. Without mpiexec nothing changes."""
    return shared_by(world()) if ranks_started() else nullcontext()


def in_turn(comm: Comm, make: Callable[[], Any]) -> Any:
    """Call `make` on one rank, then on others, which find its files; an InputError is on all."""
    found = None
    for turn in comm.rank == 0, comm.rank != 0:
        with agreed(comm), shared_by(None):  # no other rank comes here
            if turn:
                found = make()
    return found


def build(comm: Comm, *kernels: Any) -> None:
    """Compile kernels on one rank and load them on the others from Warp's cache."""
    in_turn(comm, lambda: [kernel.module.load(DEVICE) for kernel in kernels])


LIMB, LIMBS = 30, 4
"""Bits of a part, of which 2³³ fit into a whole number, and parts: 120 bits below the largest."""


def total(comm: Comm, values: ndarray) -> ndarray:
    """Sum values [n, ...] along the first axis over all ranks, shape [...], in any order alike.
    Each value is rounded to multiples of one power of two far below the largest of all ranks."""
    from mpi4py import MPI

    values = np.asarray(values, float)
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
    exact = sum(limb.astype(object) << LIMB * n for n, limb in enumerate(sums[::-1]))
    return np.asarray(np.ldexp(np.asarray(exact / (1 << LIMB * LIMBS), float), exponent))


def inner(comm: Comm, along: Callable[[ndarray, ndarray], ndarray]) -> Inner:
    """Scalar products and largest values over all ranks, for conjugate gradients. `along` gives the
    products of two fields in parts that do not depend on the number of ranks."""
    from mpi4py import MPI

    def dot(a: ndarray, b: ndarray) -> float:
        return float(total(comm, along(a, b)))

    def largest(a: ndarray) -> float:
        here = max(a.max(initial=0.0), -a.min(initial=0.0))
        return float(comm.allreduce(float(here), op=MPI.MAX))

    return Inner(dot, lambda a: dot(a, a) ** 0.5, largest, HERE.add)


@dataclass(frozen=True, eq=False)
class Slabs:
    """Box of lattice nodes in slabs of rows, the first axis, each owned by one rank.

    Attributes:
        shape: nodes of the box along the axes.
        rows: of a slab.
        starts: first rows of the ranks, and the number of rows, shape [p + 1].
    """

    shape: Shape
    rows: int
    starts: ndarray

    def own(self, rank: int) -> slice:
        """Rows of a rank."""
        return slice(int(self.starts[rank]), int(self.starts[rank + 1]))

    def box(self, rank: int) -> Shape:
        """Number of a rank's nodes along each axis."""
        return int(np.diff(self.starts)[rank]), *self.shape[1:]

    def coarser(self) -> Slabs:
        """Slabs of every second node along each axis, from the second on."""
        return Slabs(tuple(n // 2 for n in self.shape), self.rows // 2, self.starts // 2)


def cut(comm: Comm, shape: Shape, rows: int) -> Slabs:
    """Cut a box of nodes into slabs of an even number of rows for all ranks, evenly. Raises
    InputError for more ranks than slabs."""
    count, ranks = -(-shape[0] // rows), comm.size
    if ranks > count:
        raise InputError(
            f"ranks: expected at most {count} for {' × '.join(map(str, shape))} nodes, slabs of "
            f"{rows} rows, got {ranks}"
        )
    ENDING["pieces"] = True
    starts = np.minimum(rows * (count * np.arange(ranks + 1) // ranks), shape[0])
    return Slabs(tuple(map(int, shape)), rows, starts)


def halo(comm: Comm, slabs: Slabs, w: int) -> ArrayMap:
    """Make what lays `w` nodes of other ranks around a field [c, *box] of this rank's; zeros beyond
    the box."""
    own, give, take = slabs.own(comm.rank), list[Any](), list[Any]()
    for rank in range(comm.size):
        if rank != comm.rank:
            theirs = slabs.own(rank)
            for pairs, have, want, margin in (give, own, theirs, 0), (take, theirs, own, w):
                rows = max(have.start, want.start - w), min(have.stop, want.stop + w)
                if rows[0] < rows[1]:
                    place = slice(*(row - own.start + margin for row in rows))
                    pairs.append((rank, (slice(None), place)))

    def around(field: ndarray) -> ndarray:
        wide = np.pad(field, [(0, 0), (w, w)] + [(0, 0)] * (field.ndim - 2))
        exchange(comm, field, wide, give, take)
        return np.pad(wide, [(0, 0)] * 2 + [(w, w)] * (field.ndim - 2))

    return around


def exchange(comm: Comm, field: ndarray, wide: ndarray, give: Any, take: Any) -> None:
    """Send parts of a field to others, and receive theirs, as pairs (rank, place)."""
    from mpi4py import MPI

    out = [(r, np.ascontiguousarray(field[place])) for r, place in give]
    buffers = [(r, np.empty_like(wide[place], order="C")) for r, place in take]
    requests = [comm.Irecv(buffer, source=r) for r, buffer in buffers]
    requests += [comm.Isend(buffer, dest=r) for r, buffer in out]
    MPI.Request.Waitall(requests)
    for (_, place), (_, buffer) in zip(take, buffers):
        wide[place] = buffer
