"""Where the time of one forward sweep over a lattice goes, least of many rounds.

`python tools/benchmark.py launch` prints it on one and two threads, beside Numba by rows.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_peri.kernels.lps.adjoint import structs
from warp_peri.kernels.lps.force import sweeps
from warp_peri.kernels.lps.influence import influence as influence_kernel
from warp_peri.launch import _slices, at_once, empty, launch, threads
from warp_peri.models.solid import Solid
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import filled, influence, influence_inputs

ROUNDS = 100


def least(function: Callable[[], Any], rounds: int = ROUNDS) -> float:
    """Least seconds over the rounds, after one that compiles: by the clock, of one thread by the
    processor's time."""
    clock = time.process_time if threads() == 1 else time.perf_counter
    function()
    times = []
    for _ in range(rounds):
        start = clock()
        function()
        times.append(clock() - start)
    return min(times)


class Pieces:
    """The five launches of one sweep on arrays that stay, each as slices for the threads.

    Args:
        bonds: of a lattice laid out in rows.
        solid: its numbers.
        u: displacement, shape [N, 2].
    """

    def __init__(self, bonds: Bonds, solid: Solid, u: np.ndarray) -> None:
        rows, scalar = bonds.laid_out, bonds.scalar
        if rows is None:
            raise RuntimeError("the lattice is not laid out in rows")
        lam, mu, alpha, D = (bonds.floats(np.atleast_1d(v)) for v in solid.values())
        kw, m = influence(bonds, alpha, D)
        law = filled(structs(scalar, bonds.dimension).Law, kw, m, kw, m, lam, mu)
        planes, theta = rows.planes("forward", 1)
        values: Any = wp.array(u[None], dtype=bonds.vec, device="cpu")
        Lu = empty(1, len(bonds.rows), dtype=bonds.vec)
        degree, of, weight = len(D) - 1, rows.pieces, rows.kernels.lanes // 4
        table = (*influence_inputs(bonds, degree), alpha, D)
        shared = (rows.offset, bonds.arrays, law, planes)
        volume = sweeps(scalar, bonds.dimension).weighted_volume
        calls: list[tuple[Any, int, int, tuple[Any, ...], Any]] = [
            (influence_kernel(degree, scalar), len(bonds.r), 0, table, kw),
            (volume, 1, 0, (bonds.full, bonds.arrays, bonds.r, kw), m),
            (rows.kernels.laid_out, len(of.images), 1, (of.images, rows.one, values), planes),
            (rows.kernels.dilatation, len(of.needed), 1, (of.needed, *shared), theta),
            (rows.kernels.force, len(of.forces), 1, (of.forces, *shared, theta), Lu),
        ]
        self.slices: list[list[tuple[Any, Any, tuple[Any, ...], Any]]] = []
        for kernel, count, samples, inputs, output in calls:
            ends = _slices(count, count * weight if samples else count, output.device)
            self.slices.append(
                [
                    (kernel, (samples, b - a) if samples else b - a, (a, *inputs), output)
                    for a, b in pairwise(ends)
                ]
            )
        self.recorded = [
            [
                wp.launch(
                    k, dim=d, inputs=list(i), outputs=[o], device="cpu", record_cmd=True
                ).launch
                for k, d, i, o in one
            ]
            for one in self.slices
        ]

    def packed(self) -> None:
        """As the library launches them: arguments are packed anew."""
        for one in self.slices:
            at_once([partial(launch, k, d, i, (o,)) for k, d, i, o in one])

    def alone(self) -> None:
        """Recorded before: nothing but the kernels, and threads that wait for each other."""
        for one in self.recorded:
            at_once(one)


def parts(
    bonds: Bonds, solid: Solid, u: np.ndarray, forward: Callable[[], Any]
) -> dict[str, float]:
    """Seconds of a sweep, and of its parts, which add up to it."""
    pieces = Pieces(bonds, solid, u)
    dtype = getattr(torch, bonds.scalar.__name__)
    tensors = [torch.zeros(1, dtype=dtype) for _ in range(5)]  # u, λ, μ, α, D

    def converted() -> None:
        for tensor in tensors:
            wp.from_torch(tensor.detach().contiguous(), dtype=bonds.scalar)

    whole, packed, recorded, shared = (
        least(f) for f in (forward, pieces.packed, pieces.alone, converted)
    )
    return {
        "a sweep": whole,
        "kernels, recorded": recorded,
        "packing arguments": packed - recorded,
        "torch to Warp": shared,
        "memory, K, checks, autograd": whole - packed - shared,
    }
