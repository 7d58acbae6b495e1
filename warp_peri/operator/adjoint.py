"""The gradient of L u by gathering over bonds and their reverse bonds (theory.md, 43–47).

No atomics, so the nodes may be shared out among threads; sums over nodes run over fixed blocks, so
that the result does not depend on how many threads there are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from warp_peri.kernels.lps import influence as influence_kernels
from warp_peri.kernels.lps.adjoint import adjoints
from warp_peri.launch import at_once, empty, launch, launch_slices
from warp_peri.operator.sweeps import State, Sweeps

BLOCKS = 8
"""Parts in which the nodes are summed over."""


@dataclass(frozen=True)
class Gradient:
    """Derivatives of a scalar; None where they were not asked for.

    Attributes:
        u: shape [S, N] of vectors.
        lam, mu, alpha: numbers.
        D, D_dilatation: shape [M + 1]; the second is None with one influence function.
    """

    u: wp.array[Any] | None = None
    lam: float = 0.0
    mu: float = 0.0
    alpha: float = 0.0
    D: np.ndarray | None = None
    D_dilatation: np.ndarray | None = None


def gradient(
    sweeps: Sweeps,
    state: State,
    arrays: Sequence[wp.array[Any]],
    g: wp.array[Any],
    *,
    displacement: bool = True,
    parameters: bool = True,
) -> Gradient:
    """Gradient of a scalar, given its derivative g to L u.

    Args:
        sweeps: of a point set without broken bonds.
        state: what sweeps.evaluate(*arrays) returned.
        arrays: u, λ, μ, α, D and, with two influence functions, D of the dilatation.
        g: shape [S, I] of vectors.
        displacement: whether to return the derivative to u.
        parameters: whether to return those to λ, μ, α, D.
    """
    u, lam, mu, alpha, *coefficients = arrays
    kernels, links = adjoints(sweeps.scalar), sweeps.links
    samples, nodes = u.shape
    h = sweeps.zeros(samples, nodes, dtype=sweeps.vec)
    rows = len(sweeps.rows)
    launch_slices(
        kernels.scaled, rows, (sweeps.rows, sweeps.lattice, state.m, g), (h,), samples=samples
    )
    hd = h
    if state.md is not state.m:
        hd = sweeps.zeros(samples, nodes, dtype=sweeps.vec)
        launch_slices(
            kernels.scaled, rows, (sweeps.rows, sweeps.lattice, state.md, g), (hd,), samples=samples
        )
    tau = sweeps.zeros(samples, nodes)
    inputs: tuple[Any, ...]
    if not sweeps.bond_based:
        inputs = (sweeps.full, *links, sweeps.reverse, state.kd, state.md, lam, mu, hd)
        launch_slices(kernels.dilatation_adjoint, len(sweeps.full), inputs, (tau,), samples=samples)
    u_bar = None
    if displacement:
        u_bar = empty(samples, nodes, dtype=sweeps.vec, device=sweeps.device)
        inputs = (*links, sweeps.reverse, state.kw, state.kd, mu, h, tau)
        launch_slices(kernels.displacement_adjoint, nodes, inputs, (u_bar,), samples=samples)
    if not parameters:
        return Gradient(u_bar)
    tables = _Tables(sweeps, state, alpha, coefficients, parts=sweeps.zeros(BLOCKS, 2))
    fields = (lam, mu, u, state.theta, h, hd, tau)
    at_once([tables.job(block, fields) for block in range(BLOCKS)])
    shear, bulk = tables.parts.numpy().sum(axis=0, dtype=float)
    by_D, by_alpha = tables.gradients()
    return Gradient(u_bar, -2 * bulk, 2 * bulk - 16 * shear, by_alpha, *by_D)


class _Tables:
    """The sums over bonds behind ∂/∂(K W), block by block, and from there to α and D."""

    def __init__(
        self,
        sweeps: Sweeps,
        state: State,
        alpha: wp.array[Any],
        coefficients: Sequence[wp.array[Any]],
        parts: wp.array[Any],
    ) -> None:
        self.sweeps, self.state, self.parts = sweeps, state, parts
        self.alpha, self.coefficients = alpha, coefficients
        nodes, row = sweeps.full.numpy(), sweeps.families.row
        self.ends = [len(nodes) * n // BLOCKS for n in range(BLOCKS + 1)]
        self.spans = [(0, len(sweeps.families.pattern))] * BLOCKS  # bonds of each block
        if not sweeps.lattice:
            at = [row[nodes[min(end, len(nodes) - 1)]] for end in self.ends]
            at[-1] = row[-1]
            self.spans = list(pairwise(at))
        self.kernel = adjoints(sweeps.scalar).table_adjoint
        self.kernel.module.load(wp.get_device(sweeps.device))
        self.backwards, self.sums = [], []
        for D in coefficients:
            kernel = influence_kernels.influence_adjoint(len(D) - 1, sweeps.scalar)
            kernel.module.load(wp.get_device(sweeps.device))
            self.backwards.append((kernel, sweeps.influence_inputs(len(D) - 1), D))
            self.sums.append(sweeps.zeros(BLOCKS, len(D) + 1))
        self.by_pattern = [np.zeros((BLOCKS, len(sweeps.families.pattern))) for _ in coefficients]

    def job(self, block: int, fields: Sequence[wp.array[Any]]) -> Callable[[], None]:
        """One block: ∂/∂(K W) of its bonds; on scattered points onwards to α and D."""
        begin, end = self.ends[block : block + 2]
        first, last = (int(value) for value in self.spans[block])

        def run() -> None:
            if begin == end:
                return
            sweeps, state = self.sweeps, self.state
            bars = [sweeps.zeros(last - first) for _ in self.coefficients]
            one = int(len(bars) == 1)
            tables = (sweeps.r, state.kw, state.m, state.kd, state.md)
            inputs = (block, first, sweeps.full, begin, end, *sweeps.links, *tables, *fields, one)
            launch(self.kernel, 1, inputs, (bars[0], bars[-1], self.parts))
            for n, bar in enumerate(bars):
                if sweeps.lattice:
                    self.by_pattern[n][block] = bar.numpy()
                else:
                    self._backward(n, block, first, last, bar)

        return run

    def _backward(self, n: int, block: int, first: int, last: int, bar: wp.array[Any]) -> None:
        kernel, inputs, D = self.backwards[n]
        launch(kernel, 1, (block, first, last, *inputs, self.alpha, D, bar), (self.sums[n],))

    def gradients(self) -> tuple[list[np.ndarray], float]:
        """∂/∂D of each influence function and ∂/∂α, after all blocks."""
        sweeps, by_D, by_alpha = self.sweeps, [], 0.0
        for n, sums in enumerate(self.sums):
            if sweeps.lattice:
                bars = self.by_pattern[n].sum(axis=0)
                by_class = np.bincount(sweeps.families.classes.bond_class, bars)
                self._backward(n, 0, 0, len(by_class), sweeps.floats(by_class))
            total = sums.numpy().sum(axis=0, dtype=float)
            by_D.append(total[:-1])
            by_alpha += float(total[-1])
        return by_D, by_alpha
