"""Launches of Warp kernels: slices of the nodes on Python threads."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any

import numpy as np
import warp as wp
from numpy import ndarray

from warp_peri.errors import InputError, sharing

DEVICE = "cpu"
"""Where arrays are made and kernels run."""
LARGEST = 2**16
"""Number of threads that is none."""
LINE = 16
"""Counters of a sweep that threads share are so far apart, as in kernels/bonds.py."""
SLICE = 2000
"""Least number of nodes a thread is worth starting for."""
PHASES = 3
"""Of the work in a kernel that threads share, see kernels/bonds.py."""
BLOCK = 100
"""Rows of a block, of which ranks share many."""
wp.config.log_level = wp.LOG_WARNING  # its banner would mix with what commands print


def _start() -> None:
    """Start Warp without its messages on a missing CUDA driver."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


_start()
_count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
_asked: SimpleQueue[Callable[[], None]] = SimpleQueue()
_helpers = _staying = 0
_box = np.zeros(56, np.int64)
"""Where a sweep leaves its work for helpers that stay in a kernel, see kernels/bonds.py."""
ASLEEP, BELL, BED = 32, 40, 48
"""Places in the box: helpers that sleep, what ends their stays, and their semaphore."""
_sleeps = sys.platform == "linux"
_wake = ctypes.CDLL(None).sem_post if _sleeps else None


def _without_helpers() -> None:
    """Forget the helpers: a process that forks from this one has none of its threads."""
    global _asked, _helpers, _staying
    _asked, _helpers, _staying = SimpleQueue(), 0, 0
    _box[:] = 0


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_without_helpers)


def _help(asked: SimpleQueue[Callable[[], None]]) -> None:
    """Loop of a helper thread; a queue wakes it in half the time that a pool takes."""
    while True:
        asked.get()()


def _helped(count: int) -> SimpleQueue[Callable[[], None]]:
    """Queue that at least `count` helpers wait on."""
    global _helpers
    for _ in range(count - _helpers):
        Thread(target=_help, args=(_asked,), daemon=True, name="warp_peri").start()
        _helpers += 1
    return _asked


def _serve(task: Future[None], work: Callable[[], None]) -> None:
    """Do a helper's work, unless it was taken back."""
    if task.set_running_or_notify_cancel():
        try:
            work()
            task.set_result(None)
        except BaseException as error:
            task.set_exception(error)


def set_num_threads(count: int) -> None:
    """Run the sweeps of a point set on `count` Python threads (default: all processors). Results
    are bitwise the same for any number. Raises InputError for a count below 1."""
    global _count
    whole = isinstance(count, (int, np.integer)) and not isinstance(count, (bool, np.timedelta64))
    if not (whole and 0 < count < LARGEST):
        raise InputError(f"count: expected a whole number ≥ 1, got {count!r:.60}")
    _count = int(count)


def get_num_threads() -> int:
    """Number of threads the sweeps run on."""
    return _count


def at_once(jobs: Sequence[Callable[[], None]]) -> None:
    """Run jobs that touch different memory, on as many threads as there are, this one included."""
    global _staying
    waiting = iter(jobs)  # a list's iterator gives each job once, whoever asks

    def work() -> None:
        for job in waiting:
            job()

    count = min(_count, len(jobs)) - 1
    _box[BELL] += count > 0  # nobody stays where others wait
    tasks: list[Future[None]] = [Future() for _ in range(count)]
    if tasks:
        _staying = 0
        for _ in range(int(_box[ASLEEP])):
            _wake(ctypes.c_void_p(_box[BED:].ctypes.data))  # type: ignore[misc]
    for task in tasks:
        _helped(count).put(partial(_serve, task, work))
    try:
        work()
    finally:
        # a helper that has not begun finds nothing left to do: nobody waits for it to wake up
        failures = [task.exception() for task in tasks if not task.cancel()]
    for failure in filter(None, failures):
        raise failure


def ranks_started() -> int | None:
    """Number of processes that mpiexec started with this one, by any launcher; else None."""
    for name in ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return None


def in_blocks(work: Callable[[ndarray], ndarray], rows: ndarray) -> ndarray:
    """Apply `work` to rows in blocks of at most BLOCK, joined; blocks do not depend on the number
    of ranks, and so the result has the same bits on any."""
    blocks = np.array_split(rows, -(-len(rows) // BLOCK) or 1)
    if not (comm := sharing()):
        return np.concatenate([work(block) for block in blocks])
    done = comm.allgather([work(block) for block in blocks[comm.rank :: comm.size]])
    return np.concatenate([done[n % comm.size][n // comm.size] for n in range(len(blocks))])


def launch(kernel: Any, dim: Any, given: Sequence[Any], *, packed: bool = False) -> Any:
    """Launch a kernel on its inputs and outputs, on no tape, which is the process's; or pack that
    on the processor once, which takes longer than a small sweep: what is given later is None."""
    return wp.launch(kernel, dim, given, device=DEVICE, record_cmd=packed, record_tape=False)


def launch_slices(
    kernel: Any, count: int, given: Sequence[Any], *, samples: int = 0, weight: int = 1
) -> None:
    """Launch a gather kernel, whose first argument is the first index, on slices of 0 … count. With
    samples the dimensions are (samples, slice); `weight` is the work of an index, 1 for a node."""
    work = count * max(samples, 1) * weight
    slices = max(1, min(_count, count, work // SLICE))
    ends = [count * n // slices for n in range(slices + 1)]

    def job(first: int, last: int) -> Callable[[], None]:
        dim = (samples, last - first) if samples else last - first
        return lambda: launch(kernel, dim, [first, *given])

    if len(ends) > 2:
        kernel.module.load(DEVICE)  # not from two threads at once
    at_once([job(first, last) for first, last in pairwise(ends)])


class Shared:
    """A kernel that shares its work out among threads, packed once. Its first argument, which
    `given` leaves out, counts what has been taken and done of all PHASES, see kernels/bonds.py;
    helpers `stay` in a kernel a while to serve what comes next. The work, 1 a node, is of all
    phases."""

    def __init__(self, kernel: Any, given: Sequence[Any], work: int, stay: Any) -> None:
        self._helpers = max(1, min(_count, work // SLICE)) - 1
        self._turns = np.zeros(LINE * (1 + PHASES * (2 + self._helpers)), np.int32)
        self._turns[1] = 1 + self._helpers
        self._turns[2:4] = np.array([_box.ctypes.data]).view(np.int32)
        self._held = [ints(self._turns), *given]  # of which the launch knows addresses
        self._launch = launch(kernel, 1, self._held, packed=True)
        if self._helpers:
            self._stay = launch(stay, 1, [floats(_box, wp.int64)], packed=True)

    def give(self, place: int, value: Any) -> None:
        """Replace an array or struct, number 0 being the first given; it must live until the
        launch is over, for its memory is all that is known here."""
        self._launch.set_param_at_index(place + 1, value)

    def _come(self, bell: int) -> None:
        if bell == _box[BELL]:
            self._stay.launch()

    def __call__(self) -> None:
        """Launch the kernel, and wait for all threads."""
        global _staying
        self._turns[0], self._turns[LINE:] = 0, 0
        for _ in range(self._helpers - _staying):
            _staying += _sleeps
            _helped(self._helpers).put(partial(self._come, int(_box[BELL])))
        self._launch.launch()


def recording() -> Any:
    """Warp's tape that records, or None."""
    return wp._src.context.runtime.tape  # type: ignore[attr-defined]  # it has no public name


def zeros(*shape: int, dtype: Any = wp.float64) -> wp.array[Any]:
    """Make a Warp array of zeros."""
    return wp.zeros(shape, dtype=dtype, device=DEVICE)


def ints(values: ndarray, dtype: Any = wp.int32) -> wp.array[Any]:
    """Make an int32 Warp array; shares memory with an int32 NumPy array."""
    return floats(np.ascontiguousarray(values, dtype=np.int32), dtype)


def filled(struct: Any, *values: Any) -> Any:
    """Make an instance of a kernel's struct from its members in order."""
    instance = struct()
    for name, value in zip(struct.vars, values):
        setattr(instance, name, value)
    return instance


def floats(values: ndarray, dtype: Any = wp.float64) -> wp.array[Any]:
    """Make a Warp array of scalars or vectors; shares memory with `values` where it can."""
    return wp.array(values, dtype=dtype, device=DEVICE, copy=False)


class _TorchThreads:
    """Callers that are inside `one_thread`, and how many threads torch had before the first."""

    lock, inside, before = Lock(), 0, 1


@contextmanager
def one_thread(wanted: bool = True) -> Iterator[None]:
    """Keep torch on one thread, where wanted, until the last such call has left; each caller has
    its own number of threads, a new thread the last one set."""
    if not wanted:
        yield
        return
    import torch

    with _TorchThreads.lock:
        if not _TorchThreads.inside:
            _TorchThreads.before = torch.get_num_threads()
        _TorchThreads.inside += 1
        torch.set_num_threads(1)
    try:
        yield
    finally:
        with _TorchThreads.lock:
            _TorchThreads.inside -= 1
            torch.set_num_threads(_TorchThreads.before)
