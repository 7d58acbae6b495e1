"""Where the time of one forward sweep over a lattice goes, least of many rounds.

`python tools/benchmark.py launch` prints it on one and two threads, beside Numba by rows.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_peri.kernels.lps.adjoint import structs
from warp_peri.kernels.lps.force import sweeps
from warp_peri.kernels.lps.influence import influence as influence_kernel
from warp_peri.launch import empty, filled, recorded, threads
from warp_peri.lps.bonds import Bonds, influence, influence_inputs
from warp_peri.lps.rows import Forward
from warp_peri.methods import Solid

ROUNDS, SECONDS = 1000, 6.0
"""Most rounds, and after how long no other is begun."""


def least(functions: Sequence[Callable[[], Any]]) -> list[float]:
    """Least seconds of each over rounds in turn, after one that compiles: by the clock, of one
    thread by the processor's time."""
    clock = time.process_time if threads() == 1 else time.perf_counter
    for function in functions:
        function()
    times: list[list[float]] = []
    begin = time.perf_counter()
    while len(times) < ROUNDS and time.perf_counter() - begin < SECONDS:
        times.append([])
        for function in functions:
            time.sleep(0.02)  # until the threads of the one before stop spinning
            function()
            start = clock()
            function()
            times[-1].append(clock() - start)
    found: list[float] = np.min(times, axis=0).tolist()
    return found


def kernels(bonds: Bonds, solid: Solid, u: np.ndarray) -> Callable[[], None]:
    """The five launches of one sweep on arrays that stay: nothing but kernels, and threads that
    wait for each other.

    `bonds`: of a lattice laid out in rows; `solid`: its numbers; `u`: displacement, shape [N, 2].
    """
    rows, scalar = bonds.laid_out, bonds.scalar
    if rows is None:
        raise RuntimeError("the lattice is not laid out in rows")
    lam, mu, alpha, D = (bonds.floats(np.atleast_1d(v)) for v in solid.values())
    kw, m = influence(bonds, alpha, D)
    law = filled(structs(scalar, bonds.dimension).Law, kw, m, kw, m, lam, mu)
    values: Any = wp.array(u[None], dtype=bonds.vec, device="cpu")
    Lu = empty(1, len(bonds.rows), dtype=bonds.vec)
    table = (*influence_inputs(bonds, len(D) - 1), alpha, D)
    volume = sweeps(scalar, bonds.dimension).weighted_volume
    first = recorded(influence_kernel(len(D) - 1, scalar), len(bonds.r), (0, *table), (kw,))
    second = recorded(volume, 1, (0, bonds.full, bonds.arrays, bonds.r, kw), (m,))
    sweep = Forward(rows, bonds.arrays, 1)
    sweep(law, values, Lu)

    def launched() -> None:
        first.launch()
        second.launch()
        sweep.launch()

    return launched


def parts(
    bonds: Bonds,
    solid: Solid,
    u: np.ndarray,
    forward: Callable[[], Any],
    rivals: dict[str, Callable[[], Any]],
) -> dict[str, float]:
    """Seconds of a sweep, of its parts, which add up to it, and of others that do the same."""
    alone = kernels(bonds, solid, u)
    dtype = getattr(torch, bonds.scalar.__name__)
    tensors = [torch.zeros(1, dtype=dtype) for _ in range(5)]  # u, λ, μ, α, D

    def converted() -> None:
        for tensor in tensors:
            wp.from_torch(tensor.detach().contiguous(), dtype=bonds.scalar)

    whole, bare, shared, *others = least([forward, alone, converted, *rivals.values()])
    return {
        "a sweep": whole,
        "kernels, recorded": bare,
        "torch to Warp": shared,
        "packing, memory, K, checks": whole - bare - shared,
        **dict(zip(rivals, others, strict=True)),
    }
