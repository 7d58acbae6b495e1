"""The Warp launches of the nonlinear solid on a lattice, and their adjoint (theory.md, N1–N9)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from warp_peri.errors import InputError
from warp_peri.kernels.nonlinear.sweeps import sweeps
from warp_peri.launch import DEVICE, at_once, floats, ints, launch, launch_slices, zeros
from warp_peri.points.families import BondClasses, families_of
from warp_peri.points.samples import PointsLike

BLOCKS = 8
"""Parts in which the nodes are summed over, whatever the number of threads."""


class GradientSweeps:
    """The launches of (N1–N9) over the interior nodes of a lattice.

    Args:
        points: a lattice, all of it in the body.
        horizon: δ [Å].

    Attributes:
        classes: bond classes of the lattice.
        rows: interior nodes, where forces are evaluated.
        full: nodes within δ of them, which have complete families.
        xi: bond vectors of a family [Å], shape [B, 2].

    Raises InputError for what families_of refuses, scattered points and broken bonds.
    """

    def __init__(self, points: PointsLike, horizon: float) -> None:
        families = families_of(points, horizon)
        self.classes: BondClasses = families.classes
        if len(families.cut):
            raise InputError("points: Ψ is not made for bodies with broken bonds")
        self.kernels = sweeps(wp.float64)
        self.rows, self.full = families.rows, families.whole
        self.nodes, self.xi = len(points.x), families.pattern
        self.neighbour = families.neighbour
        self._rows, self._full = ints(self.rows), ints(self.full)
        self._neighbour = ints(families.neighbour)

    def bonds(self, tables: np.ndarray) -> wp.array[Any]:
        """ξ and the four tables of every bond of a family, from their values by class [4, C]."""
        values = np.hstack([self.xi, tables[:, self.classes.bond_class].T])
        return floats(values, self.kernels.bond)

    def numbers(self, values: np.ndarray) -> Any:
        """Six numbers of a material for a kernel."""
        return self.kernels.numbers(*(float(value) for value in values))

    def state(
        self, u: wp.array[Any], bonds: wp.array[Any], numbers: np.ndarray, radius: float
    ) -> tuple[wp.array[Any], wp.array[Any], wp.array[Any]]:
        """θ, H and P of every sample and node, zero where no force needs them."""
        samples = u.shape[0]
        kernels = self.kernels
        theta = zeros(samples, self.nodes)
        H, P = (zeros(samples, self.nodes, dtype=kernels.mat) for _ in range(2))
        inputs = (self._full, self._neighbour, bonds, self.numbers(numbers), radius, u)
        launch_slices(kernels.state, len(self.full), inputs, (theta, H, P), samples=samples)
        return theta, H, P

    def force(
        self,
        u: wp.array[Any],
        bonds: wp.array[Any],
        bulk: float,
        theta: wp.array[Any],
        P: wp.array[Any],
    ) -> wp.array[Any]:
        """L u on the interior nodes, shape [S, I] of vectors."""
        Lu = zeros(u.shape[0], len(self.rows), dtype=self.kernels.vec)
        inputs = (self._rows, self._neighbour, bonds, bulk, u, theta, P)
        launch_slices(self.kernels.force, len(self.rows), inputs, (Lu,), samples=u.shape[0])
        return Lu

    def adjoint(
        self,
        given: tuple[wp.array[Any], np.ndarray, float, np.ndarray, float],
        state: tuple[wp.array[Any], wp.array[Any], wp.array[Any]],
        g: wp.array[Any],
        *,
        parameters: bool,
    ) -> tuple[wp.array[Any], tuple[np.ndarray, float, np.ndarray] | None]:
        """∂/∂u, and ∂/∂ of the tables [4, C], λ − μ and the numbers [6], where they are wanted.

        Args:
            given: u, the tables by class, λ − μ, the numbers, the radius of clipping.
            state: what `state` returned for them.
            g: derivative to L u on all nodes, zero off the interior, shape [S, N] of vectors.
            parameters: whether the second part is wanted.
        """
        u, tables, bulk, numbers, radius = given
        theta, H, P = state
        kernels, bonds, samples = self.kernels, self.bonds(tables), u.shape[0]
        material = self.numbers(numbers)
        theta_bar = zeros(samples, self.nodes)
        P_bar, H_bar = (zeros(samples, self.nodes, dtype=kernels.mat) for _ in range(2))
        inputs: tuple[Any, ...] = (self._full, self._neighbour, bonds, bulk, material, radius, g, H)
        outputs = (theta_bar, P_bar, H_bar)
        launch_slices(kernels.state_adjoint, len(self.full), inputs, outputs, samples=samples)
        u_bar = zeros(samples, self.nodes, dtype=kernels.vec)
        inputs = (self._neighbour, bonds, g, theta_bar, H_bar)
        launch_slices(kernels.displacement_adjoint, self.nodes, inputs, (u_bar,), samples=samples)
        if not parameters:
            return u_bar, None
        by_numbers, by_bulk = zeros(BLOCKS, dtype=kernels.numbers), zeros(BLOCKS)
        bars = [zeros(len(self.xi), dtype=kernels.four) for _ in range(BLOCKS)]
        ends = [len(self.full) * n // BLOCKS for n in range(BLOCKS + 1)]
        fields = kernels.Fields()
        fields.u, fields.theta, fields.H, fields.P = u, theta, H, P
        fields.g, fields.theta_bar, fields.P_bar, fields.H_bar = g, theta_bar, P_bar, H_bar
        kernels.table_adjoint.module.load(wp.get_device(DEVICE))

        def job(block: int) -> Callable[[], None]:
            where = (block, self._full, ends[block], ends[block + 1], self._neighbour, bonds)
            out = (bars[block], by_numbers, by_bulk)
            return lambda: launch(kernels.table_adjoint, 1, (*where, bulk, radius, fields), out)

        at_once([job(block) for block in range(BLOCKS)])
        by_bond = np.sum([bar.numpy() for bar in bars], axis=0)
        classes = self.classes.bond_class
        by_class = np.stack([np.bincount(classes, column) for column in by_bond.T])
        return u_bar, (by_class, float(by_bulk.numpy().sum()), by_numbers.numpy().sum(axis=0))

    def curvatures(self, u: wp.array[Any], bonds: wp.array[Any], numbers: np.ndarray) -> np.ndarray:
        """Ψ″ [TPa] of one field at the nodes `full`, shape [4, 4, F], entries 11, 12, 21, 22."""
        _, H, _ = self.state(u, bonds, numbers, 0.0)
        curved = zeros(4, len(self.full), dtype=self.kernels.mat)
        inputs = (self._full, self.numbers(numbers), H)
        launch_slices(self.kernels.tangents, len(self.full), inputs, (curved,), samples=4)
        curvatures: np.ndarray = curved.numpy().reshape(4, -1, 4).transpose(2, 0, 1)
        return curvatures
