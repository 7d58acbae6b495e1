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
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import Evaluation, influence_inputs

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
    bonds: Bonds,
    evaluation: Evaluation,
    arrays: Sequence[wp.array[Any]],
    g: wp.array[Any],
    *,
    displacement: bool = True,
    parameters: bool = True,
) -> Gradient:
    """Gradient of a scalar, given its derivative g to L u.

    Args:
        bonds: of a point set without broken bonds.
        evaluation: what evaluate(bonds, *arrays) returned.
        arrays: u, λ, μ, α, D and, with two influence functions, D of the dilatation.
        g: shape [S, I] of vectors.
        displacement: whether to return the derivative to u.
        parameters: whether to return those to λ, μ, α, D.
    """
    u, lam, mu, alpha, *coefficients = arrays
    kernels, links = adjoints(bonds.scalar), bonds.arrays
    samples, nodes = u.shape
    scaled = []
    for m in (evaluation.m, evaluation.md)[: 1 + (evaluation.md is not evaluation.m)]:
        scaled.append(bonds.zeros(samples, nodes, dtype=bonds.vec))
        inputs: tuple[Any, ...] = (bonds.rows, links, m, g)
        launch_slices(kernels.scaled, len(bonds.rows), inputs, (scaled[-1],), samples=samples)
    h, hd = scaled[0], scaled[-1]
    kw, kd = evaluation.kw, evaluation.kd
    tau = bonds.zeros(samples, nodes)
    if not bonds.bond_based:
        inputs = (bonds.full, links, bonds.reverse, kd, evaluation.md, lam, mu, hd)
        launch_slices(kernels.dilatation_adjoint, len(bonds.full), inputs, (tau,), samples=samples)
    u_bar = None
    if displacement:
        u_bar = empty(samples, nodes, dtype=bonds.vec, device=bonds.device)
        inputs = (links, bonds.reverse, kw, kd, mu, h, tau)
        launch_slices(kernels.displacement_adjoint, nodes, inputs, (u_bar,), samples=samples)
    if not parameters:
        return Gradient(u_bar)
    law = _filled(kernels.Law, kw, evaluation.m, kd, evaluation.md, lam, mu)
    fields = _filled(kernels.Fields, u, evaluation.theta, h, hd, tau)
    tables = _Tables(bonds, law, fields, alpha, coefficients)
    at_once([tables.job(block) for block in range(BLOCKS)])
    shear, bulk = tables.parts.numpy().sum(axis=0, dtype=float)
    by_D, by_alpha = tables.gradients()
    return Gradient(u_bar, -2 * bulk, 2 * bulk - 16 * shear, by_alpha, *by_D)


def _filled(struct: Any, *values: wp.array[Any]) -> Any:
    """An instance of a kernel's struct, its members in order."""
    instance = struct()
    for name, value in zip(struct.vars, values):
        setattr(instance, name, value)
    return instance


class _Tables:
    """The sums over bonds behind ∂/∂(K W), block by block, and from there to α and D."""

    def __init__(
        self,
        bonds: Bonds,
        law: Any,
        fields: Any,
        alpha: wp.array[Any],
        coefficients: Sequence[wp.array[Any]],
    ) -> None:
        self.bonds, self.law, self.fields = bonds, law, fields
        self.alpha, self.coefficients = alpha, coefficients
        self.parts = bonds.zeros(BLOCKS, 2)
        nodes, row = bonds.full.numpy(), bonds.families.row
        self.ends = [len(nodes) * n // BLOCKS for n in range(BLOCKS + 1)]
        self.spans = [(0, len(bonds.families.pattern))] * BLOCKS  # bonds of each block
        if not bonds.lattice:
            bounds = [row[nodes[min(end, len(nodes) - 1)]] for end in self.ends]
            bounds[-1] = row[-1]
            self.spans = list(pairwise(bounds))
        self.kernel = adjoints(bonds.scalar).table_adjoint
        self.kernel.module.load(wp.get_device(bonds.device))
        self.backwards, self.sums = [], []
        for D in coefficients:
            kernel = influence_kernels.influence_adjoint(len(D) - 1, bonds.scalar)
            kernel.module.load(wp.get_device(bonds.device))
            self.backwards.append((kernel, influence_inputs(bonds, len(D) - 1), D))
            self.sums.append(bonds.zeros(BLOCKS, len(D) + 1))
        self.by_pattern = [np.zeros((BLOCKS, len(bonds.families.pattern))) for _ in coefficients]

    def job(self, block: int) -> Callable[[], None]:
        """One block: ∂/∂(K W) of its bonds; on scattered points onwards to α and D."""
        begin, end = self.ends[block : block + 2]
        first, last = (int(value) for value in self.spans[block])

        def run() -> None:
            if begin == end:
                return
            bonds = self.bonds
            bars = [bonds.zeros(last - first) for _ in self.coefficients]
            span, one_table = wp.vec3i(first, begin, end), int(len(bars) == 1)
            reads = (bonds.full, bonds.arrays, bonds.r, self.law, self.fields)
            inputs = (block, span, *reads, one_table)
            launch(self.kernel, 1, inputs, (bars[0], bars[-1], self.parts))
            for n, bar in enumerate(bars):
                if bonds.lattice:
                    self.by_pattern[n][block] = bar.numpy()
                else:
                    self._backward(n, block, first, last, bar)

        return run

    def _backward(self, n: int, block: int, first: int, last: int, bar: wp.array[Any]) -> None:
        kernel, inputs, D = self.backwards[n]
        launch(kernel, 1, (block, first, last, *inputs, self.alpha, D, bar), (self.sums[n],))

    def gradients(self) -> tuple[list[np.ndarray], float]:
        """∂/∂D of each influence function and ∂/∂α, after all blocks."""
        bonds, by_D, by_alpha = self.bonds, [], 0.0
        for n, sums in enumerate(self.sums):
            if bonds.lattice:
                bars = self.by_pattern[n].sum(axis=0)
                by_class = np.bincount(bonds.families.classes.bond_class, bars)
                self._backward(n, 0, 0, len(by_class), bonds.floats(by_class))
            total = sums.numpy().sum(axis=0, dtype=float)
            by_D.append(total[:-1])
            by_alpha += float(total[-1])
        return by_D, by_alpha
