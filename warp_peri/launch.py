"""Where and how Warp kernels run: the device, and slices of the nodes on Python threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from warp_peri.errors import InputError

DEVICE = "cpu"
SLICE = 2000
"""Least number of nodes a thread is worth starting for."""

wp.config.log_level = wp.LOG_WARNING  # its banner would mix with what commands print
_count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
_pool: ThreadPoolExecutor | None = None


def set_threads(count: int) -> None:
    """Run the sweeps of a point set on `count` Python threads (default: all processors).

    Results are bitwise the same for any number. Raises InputError for a count below 1.
    """
    global _count, _pool
    if not isinstance(count, (int, np.integer)) or isinstance(count, bool) or count < 1:
        raise InputError(f"threads: expected a whole number ≥ 1, got {count!r}")
    _count = int(count)
    if _pool is not None:
        _pool.shutdown()
        _pool = None


def threads() -> int:
    """Number of threads the sweeps run on."""
    return _count


def at_once(jobs: Sequence[Callable[[], None]]) -> None:
    """Run jobs that touch different memory, on as many threads as there are."""
    global _pool
    if _count == 1 or len(jobs) == 1:
        for job in jobs:
            job()
        return
    if _pool is None:
        _pool = ThreadPoolExecutor(_count, thread_name_prefix="warp_peri")
    for done in [_pool.submit(job) for job in jobs]:
        done.result()


def launch(kernel: Any, dim: Any, inputs: Sequence[Any], outputs: Sequence[Any] = ()) -> None:
    """Launch a kernel once; on the active tape, if there is one."""
    wp.launch(kernel, dim=dim, inputs=list(inputs), outputs=list(outputs), device=DEVICE)


def launch_slices(
    kernel: Any, count: int, inputs: Sequence[Any], outputs: Sequence[Any], *, samples: int = 0
) -> None:
    """Launch a gather kernel, whose first argument is the first index, on slices of 0 … count.

    With samples the dimensions are (samples, slice). Must not be called while a tape records.
    """
    slices = max(1, min(_count, count * max(samples, 1) // SLICE))
    ends = [count * n // slices for n in range(slices + 1)]

    def job(first: int, last: int) -> Callable[[], None]:
        dim = (samples, last - first) if samples else last - first
        return lambda: launch(kernel, dim, [first, *inputs], outputs)

    if slices > 1:
        kernel.module.load(wp.get_device(DEVICE))  # not from two threads at once
    at_once([job(first, last) for first, last in pairwise(ends)])


def zeros(*shape: int, dtype: Any = wp.float64, gradient: bool = False) -> wp.array:
    """A Warp array of zeros."""
    return wp.zeros(shape, dtype=dtype, requires_grad=gradient, device=DEVICE)


def empty(*shape: int, dtype: Any) -> wp.array:
    """A Warp array that a kernel is about to fill."""
    return wp.empty(shape, dtype=dtype, device=DEVICE)


def ints(values: np.ndarray) -> wp.array:
    """An int32 Warp array; shares memory with an int32 NumPy array where the device can."""
    values = np.ascontiguousarray(values, dtype=np.int32)
    return wp.array(values, dtype=wp.int32, device=DEVICE, copy=False)


def floats(values: np.ndarray, dtype: Any = wp.float64) -> wp.array:
    """A Warp array of scalars or vectors; shares memory with `values` where it can."""
    return wp.array(values, dtype=dtype, device=DEVICE, copy=False)
