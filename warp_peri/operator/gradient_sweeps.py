"""The Warp launches of the nonlinear solid on a lattice, and their adjoint (theory.md, N1–N10)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from warp_peri.errors import InputError
from warp_peri.kernels.nonlinear.rows import P_IN, P_OUT, PLANES, rows
from warp_peri.kernels.nonlinear.sums import SUMS, sums
from warp_peri.launch import empty, floats, ints, launch_slices, zeros
from warp_peri.operator.rows import FASTER, Rows, rows_of
from warp_peri.points.families import BondClasses, families_of
from warp_peri.points.samples import PointsLike

BLOCKS = 8
"""Parts in which the nodes are summed over, whatever the number of threads."""
AT_ONCE = 2**22
"""Most numbers in the planes of a field and of its state; more samples follow one another."""

BROKEN = "points: Ψ is not made for bodies with broken bonds"


class GradientSweeps:
    """The launches of (N1–N10) over the interior nodes of a lattice.

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
        self._families = families = families_of(points, horizon)
        self.classes: BondClasses = families.classes
        self.kernels = rows(wp.float64)
        self.rows, self.full = families.rows, families.whole
        self.nodes, self.xi = len(points.x), families.pattern
        self.neighbour = families.neighbour
        self._places = (np.array(points.x), points.box)
        self._half = np.flatnonzero(np.arange(len(self.xi)) < families.reverse)
        if len(families.cut):
            raise InputError(BROKEN)

    @cached_property
    def _laid_out(self) -> Rows:
        """The lattice in rows, with room for bonds in pairs."""
        laid = rows_of(self._families, *self._places, wp.float64, sparse=True)
        if laid is None:
            raise InputError(BROKEN)
        return laid

    @cached_property
    def _offset(self) -> wp.array[Any]:
        return ints(self._laid_out.offset.numpy()[self._half])

    def bonds(self, tables: np.ndarray) -> wp.array[Any]:
        """ξ and the four tables of one bond of each pair ±ξ, from their values by class [4, C]."""
        half = self._half
        values = np.hstack([self.xi[half], tables[:, self.classes.bond_class[half]].T])
        return floats(values, self.kernels.pair)

    def numbers(self, values: np.ndarray) -> Any:
        """Six numbers of a material for a kernel."""
        return self.kernels.numbers(*(float(value) for value in values))

    def force(
        self,
        u: wp.array[Any],
        bonds: wp.array[Any],
        bulk: float,
        numbers: np.ndarray,
        radius: float,
    ) -> wp.array[Any]:
        """L u on the interior nodes, shape [S, I] of vectors, of u, shape [S, N] of vectors."""
        laid, offset = self._laid_out, self._offset
        Lu = empty(u.shape[0], len(self.rows), dtype=self.kernels.vec)
        for part in self._parts(u.shape[0]):
            planes, state = self._state(u[part], bonds, numbers, radius)
            inputs = (laid.pieces.forces, offset, bonds, P_OUT, bulk, planes, state)
            self._gather(inputs, self.rows, Lu[part])
            laid.give_back("forward", planes, state)
        return Lu

    def gradients(
        self, u: wp.array[Any], bonds: wp.array[Any], numbers: np.ndarray, radius: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """H and P at the nodes `full`, each of shape [S, F, 2, 2]."""
        laid, found = self._laid_out, []
        for part in self._parts(u.shape[0]):
            planes, state = self._state(u[part], bonds, numbers, radius)
            by_plane = state.numpy().reshape(-1, PLANES, laid.places)
            found.append(by_plane[:, :, laid.home[self.full]])
            laid.give_back("forward", planes, state)
        whole = np.concatenate(found).transpose(0, 2, 1)
        shape = (*whole.shape[:2], 2, 2)
        return whole[..., 5:].reshape(shape), whole[..., :4].reshape(shape)

    def mean_gradient(
        self, u: wp.array[Any], bonds: wp.array[Any], numbers: np.ndarray, radius: float
    ) -> float:
        """Root mean square of |H| of one field over the nodes `full`."""
        laid = self._laid_out
        planes, state = self._state(u, bonds, numbers, radius)
        H = np.take(state.numpy().reshape(PLANES, -1)[5:], laid.home[self.full], axis=1)
        laid.give_back("forward", planes, state)
        return float(np.sqrt(np.vdot(H, H) / H.shape[1]))

    def adjoint(
        self,
        given: tuple[wp.array[Any], np.ndarray, float, np.ndarray, float],
        g: wp.array[Any],
        *,
        parameters: bool,
    ) -> tuple[wp.array[Any], tuple[np.ndarray, float, np.ndarray] | None]:
        """∂/∂u, and ∂/∂ of the tables [4, C], λ − μ and the numbers [6], where they are wanted.

        Args:
            given: u, the tables by class, λ − μ, the numbers, the radius of clipping.
            g: derivative to L u, shape [S, I] of vectors.
            parameters: whether the second part is wanted.
        """
        u, tables, bulk, numbers, radius = given
        laid, offset, bonds = self._laid_out, self._offset, self.bonds(tables)
        u_bar = empty(*u.shape, dtype=self.kernels.vec)
        gathered = sums(wp.float64)
        bars = zeros(BLOCKS, gathered.pair * len(self._half))
        by_numbers = zeros(BLOCKS, gathered.material)
        for part in self._parts(u.shape[0]):
            planes, state = self._state(u[part], bonds, numbers, radius)
            seeds, back = laid.planes("backward", planes.shape[0], PLANES)
            laid.lay_out(laid.pieces.row_images, g[part], seeds)
            law = (offset, bonds, self.numbers(numbers), radius)
            inputs: tuple[Any, ...] = (laid.pieces.needed, *law, state, seeds)
            laid.launch(self.kernels.state_adjoint, inputs, back)
            inputs = (laid.pieces.nodes, offset, bonds, P_IN, bulk, seeds, back)
            self._gather(inputs, slice(None), u_bar[part])
            if parameters:
                whole = laid.pieces.whole
                ends = ints(np.arange(BLOCKS + 1) * len(whole) // BLOCKS)
                inputs = (ends, whole, offset, bonds, radius, planes, state, seeds, back)
                weight = len(whole) * planes.shape[0] * self.kernels.lanes // FASTER // BLOCKS
                outputs = (bars, by_numbers)
                launch_slices(gathered.kernel, BLOCKS, inputs, outputs, weight=max(weight, 1))
            laid.give_back("forward", planes, state)
            laid.give_back("backward", seeds, back)
        if not parameters:
            return u_bar, None
        shear, across, own, into, out = (
            bars.numpy().reshape(BLOCKS, -1, SUMS, self.kernels.lanes).sum(axis=(0, 3)).T
        )
        classes = self.classes.bond_class[self._half]
        by_pair = (-shear, bulk * (own - across), into, -out)
        by_class = np.stack([np.bincount(classes, column) for column in by_pair])
        by_bulk = -float(tables[1, classes] @ across)
        material = by_numbers.numpy().reshape(BLOCKS, 6, -1).sum(axis=(0, 2))
        return u_bar, (by_class, by_bulk, material)

    def curvatures(self, u: wp.array[Any], bonds: wp.array[Any], numbers: np.ndarray) -> np.ndarray:
        """Ψ″ [TPa] of one field at the nodes `full`, shape [4, 4, F], entries 11, 12, 21, 22."""
        laid = self._laid_out
        planes, state = self._state(u, bonds, numbers, 0.0)
        curved = empty(4, len(self.full), dtype=self.kernels.mat)
        inputs = (ints(laid.home[self.full]), self.numbers(numbers), state)
        launch_slices(self.kernels.tangents, len(self.full), inputs, (curved,), samples=4)
        laid.give_back("forward", planes, state)
        curvatures: np.ndarray = curved.numpy().reshape(4, -1, 4).transpose(2, 0, 1)
        return curvatures

    def _state(
        self, u: wp.array[Any], bonds: wp.array[Any], numbers: np.ndarray, radius: float
    ) -> tuple[wp.array[Any], wp.array[Any]]:
        """Planes of u and of P, θ and H, to be given back."""
        laid = self._laid_out
        planes, state = laid.planes("forward", u.shape[0], PLANES)
        laid.lay_out(laid.pieces.images, u, planes)
        law = (self._offset, bonds, self.numbers(numbers), radius)
        laid.launch(self.kernels.state, (laid.pieces.needed, *law, planes), state)
        return planes, state

    def _gather(
        self, inputs: tuple[Any, ...], nodes: np.ndarray | slice, output: wp.array[Any]
    ) -> None:
        """The force sweep at some nodes, by their number."""
        laid = self._laid_out
        if not laid.by_place:
            laid.launch(self.kernels.force, inputs, output)
            return
        placed = empty(output.shape[0], laid.places, dtype=self.kernels.vec)
        laid.launch(self.kernels.force, inputs, placed)
        output.assign(placed.numpy()[:, laid.home[nodes]])

    def _parts(self, samples: int) -> Iterator[slice]:
        """Samples that are swept at once."""
        most = max(AT_ONCE // ((PLANES + 2) * self._laid_out.places), 1)
        return (slice(n, min(n + most, samples)) for n in range(0, samples, most))
