"""The processes that mpiexec started: who speaks, how an error ends all, and sums over all nodes.

Sums have the same bits however the nodes lie on ranks (theory, R3).
"""

from __future__ import annotations

import functools
import hashlib
import math
import os
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
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
    """All ranks. From here on the first one speaks, an error of one ends all, and a rank sweeps on
    one thread unless another number has been set.

    Raises InputError without mpi4py, and under another mpiexec than that of its MPI library.
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
    """The mpiexec of this environment, beside its Python where there is one."""
    beside = Path(sys.executable).with_name("mpiexec")
    return str(beside) if beside.exists() else "the mpiexec of that library"


def is_root() -> bool:
    """Whether this process is the one that writes and draws: alone, or the first rank."""
    return not ranks_started() or world().rank == 0


def _ended(comm: Comm, line: str, status: int) -> None:
    """Say one line, once, and end all ranks."""
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
    """Proofs inside, which all ranks must come to, are shared: each looks at some of the cells.

    What is proven does not depend on how many they are. Without mpiexec nothing changes.
    """
    return shared_by(world()) if ranks_started() else nullcontext()


def in_turn(comm: Comm, make: Callable[[], Any]) -> Any:
    """What `make` gives, first on one rank, which keeps in files what the others then find there.

    Raises InputError on all, where it does on any.
    """
    found = None
    for turn in (comm.rank == 0, comm.rank != 0):
        with agreed(comm):
            if turn:
                found = make()
    return found


def build(comm: Comm, *kernels: Any) -> None:
    """Load kernels, which one rank compiles and the others then find in Warp's cache."""
    in_turn(comm, lambda: [kernel.module.load(DEVICE) for kernel in kernels])


LIMB, LIMBS = 30, 4
"""Bits of a part, of which 2³³ fit into a whole number, and parts: 120 bits below the largest."""


def total(comm: Comm, values: np.ndarray) -> np.ndarray:
    """Sums along the first axis over all ranks, shape [...] of values [n, ...].

    Each value is cut to whole multiples of one power of two, far below the largest of all ranks;
    sums of whole numbers do not depend on their order.
    """
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
    """Of arrays [n, ...] on the nodes of these global numbers, whoever owns them."""
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
    """Splitmix64, a bijection that spreads every bit."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: np.ndarray = x ^ (x >> np.uint64(31))
    return mixed


def inner(comm: Comm, along: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Inner:
    """Scalar products and largest values over all ranks, for conjugate gradients.

    `along` gives the products of two fields in parts that do not depend on the number of ranks.
    """
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
