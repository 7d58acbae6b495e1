"""Sums over all nodes that have the same bits however the nodes lie on ranks (theory.md, R3)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable

import numpy as np

from warp_peri.ranks.processes import Comm
from warp_peri.statics.conjugate_gradients import Inner

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
    flat = [_joined(column, exponent) for column in sums.reshape(LIMBS, -1).T.tolist()]
    return np.reshape(flat, values.shape[1:])


def _joined(parts: list[int], exponent: int) -> float:
    number = 0
    for part in parts:
        number = (number << LIMB) + part
    return math.ldexp(number / (1 << LIMB * LIMBS), exponent)


def fingerprint(comm: Comm, number: np.ndarray, *arrays: np.ndarray) -> str:
    """Of arrays [n, ...] on the nodes of these global numbers, whoever owns them."""
    from mpi4py import MPI

    marks = np.zeros((len(arrays), 2), np.uint64)
    with np.errstate(over="ignore"):
        for mark, array in zip(marks, arrays):
            flat = np.ascontiguousarray(array, dtype=float).reshape(len(number), -1)
            mixed = _mixed(number.astype(np.uint64))
            for column in flat.view(np.uint64).T:
                mixed = _mixed(mixed ^ column)
            mark[:] = mixed.sum(), _mixed(mixed).sum()
    sums = np.zeros_like(marks)
    comm.Allreduce(marks, sums, op=MPI.SUM)
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
