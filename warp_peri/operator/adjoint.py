"""The gradient of L u by gathering over bonds and their reverse bonds (theory.md, 43–47).

No atomics, so the nodes may be shared out among threads; sums over nodes run over fixed blocks, so
that the result does not depend on how many threads there are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warp_peri.kernels.lps import influence as influence_kernels
from warp_peri.kernels.lps.adjoint import adjoints
from warp_peri.launch import at_once, empty, launch, launch_slices
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import Evaluation, filled, influence_inputs
from warp_peri.operator.node_blocks import BLOCKS
from warp_peri.operator.rows import Rows


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
    kernels = adjoints(bonds.scalar, bonds.dimension)
    e = evaluation
    law = filled(kernels.Law, e.kw, e.m, e.kd, e.md, lam, mu)
    h, hd = _scaled(bonds, evaluation, g)
    tau = bonds.zeros(*u.shape)
    u_bar = empty(*u.shape, dtype=bonds.vec, device=bonds.device) if displacement else None
    if bonds.laid_out is not None:
        _by_rows(bonds, bonds.laid_out, law, g, tau if parameters else None, u_bar)
    else:
        _by_bonds(bonds, law, (h, hd), tau, u_bar)
    if not parameters:
        return Gradient(u_bar)
    fields = filled(kernels.Fields, u, evaluation.theta, h, hd, tau)
    tables = _Tables(bonds, law, fields, alpha, coefficients)
    tables.run()
    shear, bulk = tables.parts.numpy().sum(axis=0, dtype=float)
    by_D, by_alpha = tables.gradients()
    d = bonds.dimension
    c1, c2 = d, 2 * d * (d + 2)
    return Gradient(u_bar, -c1 * bulk, c1 * bulk - c2 * shear, by_alpha, *by_D)


def _scaled(
    bonds: Bonds, evaluation: Evaluation, g: wp.array[Any]
) -> tuple[wp.array[Any], wp.array[Any]]:
    """h = g/m and hd = g/md on all nodes, one array where they are the same."""
    scaled = []
    for m in (evaluation.m, evaluation.md)[: 1 + (evaluation.md is not evaluation.m)]:
        scaled.append(bonds.zeros(len(g), bonds.nodes, dtype=bonds.vec))
        inputs = (bonds.rows, bonds.arrays, m, g)
        kernel = adjoints(bonds.scalar, bonds.dimension).scaled
        launch_slices(kernel, len(bonds.rows), inputs, (scaled[-1],), samples=len(g))
    return scaled[0], scaled[-1]


def _by_bonds(
    bonds: Bonds,
    law: Any,
    scaled: tuple[wp.array[Any], wp.array[Any]],
    tau: wp.array[Any],
    u_bar: wp.array[Any] | None,
) -> None:
    """τ, and ∂/∂u where an array is given, through the lists of neighbours."""
    kernels, links = adjoints(bonds.scalar, bonds.dimension), (bonds.arrays, bonds.reverse)
    inputs: tuple[Any, ...]
    if not bonds.bond_based:
        inputs = (bonds.full, *links, law.kd, law.md, law.lam, law.mu, scaled[1])
        count, samples = len(bonds.full), len(tau)
        launch_slices(kernels.dilatation_adjoint, count, inputs, (tau,), samples=samples)
    if u_bar is not None:
        inputs = (*links, law.kw, law.kd, law.mu, scaled[0], tau)
        launch_slices(kernels.displacement_adjoint, bonds.nodes, inputs, (u_bar,), samples=len(tau))


def _by_rows(
    bonds: Bonds,
    rows: Rows,
    law: Any,
    g: wp.array[Any],
    tau: wp.array[Any] | None,
    u_bar: wp.array[Any] | None,
) -> None:
    """τ by node and ∂/∂u, where arrays are given, on a lattice laid out in rows."""
    kernels, pieces = rows.kernels, rows.pieces
    planes, dilatation = rows.planes("backward", len(g))
    rows.lay_out(pieces.row_images, g, planes, law.md)
    law_of_bonds = (bonds.arrays, law, planes)
    rows.sweep(kernels.dilatation_adjoint, pieces.needed, law_of_bonds, dilatation)
    if u_bar is not None:
        if law.m is not law.md:
            rows.lay_out(pieces.row_images, g, planes, law.m)
        inputs = (*law_of_bonds, dilatation)
        rows.sweep(kernels.displacement_adjoint, pieces.nodes, inputs, u_bar)
    if tau is not None:
        rows.take_up(dilatation, tau)
    rows.give_back("backward", planes, dilatation)


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
        self.blocks = bonds.blocks
        self.kernel = adjoints(bonds.scalar, bonds.dimension).table_adjoint
        self.backwards, self.sums = [], []
        for D in coefficients:
            kernel = influence_kernels.influence_adjoint(len(D) - 1, bonds.scalar)
            self.backwards.append((kernel, influence_inputs(bonds, len(D) - 1), D))
            self.sums.append(bonds.zeros(BLOCKS, len(D) + 1))
        self.bars: list[wp.array[Any]] = []

    def run(self) -> None:
        """All blocks: ∂/∂(K W) of their bonds; on scattered points onwards to α and D."""
        bonds, blocks = self.bonds, self.blocks
        if bonds.lattice:
            size = BLOCKS * len(bonds.families.pattern)
            self.bars = [bonds.zeros(size) for _ in self.coefficients]
            outputs = (self.bars[0], self.bars[-1], self.parts)
            weight = max(len(bonds.full) // BLOCKS, 1)
            launch_slices(self.kernel, BLOCKS, self._inputs(), outputs, weight=weight)
            return
        for kernel in (self.kernel, *(kernel for kernel, *_ in self.backwards)):
            kernel.module.load(wp.get_device(bonds.device))  # not from two threads at once
        at_once([self._job(n) for n in range(BLOCKS) if blocks.ends[n] < blocks.ends[n + 1]])

    def _inputs(self) -> tuple[Any, ...]:
        bonds = self.bonds
        reads = (bonds.full, bonds.arrays, bonds.r, self.law, self.fields)
        return (self.blocks.spans, *reads, int(len(self.coefficients) == 1))

    def _job(self, block: int) -> Callable[[], None]:
        """One block of scattered points, whose bonds take memory while it runs."""
        first, last = self.blocks.bonds[block]

        def run() -> None:
            bars = [self.bonds.zeros(last - first) for _ in self.coefficients]
            outputs = (bars[0], bars[-1], self.parts)
            launch(self.kernel, 1, (block, *self._inputs()), outputs)
            for n, bar in enumerate(bars):
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
                bars = self.bars[n].numpy().reshape(BLOCKS, -1).sum(axis=0, dtype=float)
                by_class = np.bincount(bonds.families.classes.bond_class, bars)
                self._backward(n, 0, 0, len(by_class), bonds.floats(by_class))
            total = sums.numpy().sum(axis=0, dtype=float)
            by_D.append(total[:-1])
            by_alpha += float(total[-1])
        return by_D, by_alpha
