"""Warp launches of a solid of third order on a lattice, as torch and as sparse matrices (N1–N10).

L u is that of tensors C of each bond and of P = Ψ′(H).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
import warp as wp

from warp_peri.core.tensors import differentiable_once, refuse_tangents
from warp_peri.errors import InputError
from warp_peri.kernels.nonlinear.rows import P_IN, P_OUT, PLANES, rows
from warp_peri.kernels.nonlinear.sums import SUMS, sums
from warp_peri.launch import empty, floats, ints, launch_slices, zeros
from warp_peri.lps.rows import BLOCKS, FASTER, Rows, rows_of
from warp_peri.points.families import BondClasses, families_of
from warp_peri.points.samples import PointsLike

AT_ONCE = 2**22
"""Most numbers in the planes of a field and of its state; more samples follow one another."""

BROKEN = "points: Ψ is not made for bodies with broken bonds"


@dataclass(frozen=True)
class Numbers:
    """Those of a solid on one lattice.

    Attributes:
        tables: C₁₁, C₁₂, C₂₂, 2 p_in and 2 p_out of a bond of each pair ±ξ, shape [5, H].
        cubic: λ, μ, t3, tq2, Re and Im of q3 e^(−6ia) of Ψ [stress], shape [6].
        radius: largest |H| that P sees, projected to it from beyond (N10); 0 for none.
    """

    tables: np.ndarray
    cubic: np.ndarray
    radius: float = 0.0


class GradientSweeps:
    """The launches of (N1–N10) over the interior nodes of a lattice.

    Args:
        points: a lattice, all of it in the body.
        horizon: δ [Å], of the longest bond.

    Attributes:
        classes: bond classes of the lattice.
        rows: interior nodes, where forces are evaluated.
        full: nodes within δ of them, which have complete families.
        xi: bond vectors of a family [Å], shape [B, 2].
        half: numbers of one bond of each pair ±ξ, shape [H].

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
        self.half = np.flatnonzero(np.arange(len(self.xi)) < families.reverse)
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
        return ints(self._laid_out.offset.numpy()[self.half])

    @cached_property
    def pair(self) -> np.ndarray:
        """Of every bond the number of its pair, shape [B]."""
        number = np.empty(len(self.xi), int)
        number[self.half] = number[self._families.reverse[self.half]] = np.arange(len(self.half))
        return number

    def _law(self, of: Numbers) -> tuple[Any, ...]:
        """What the kernels read of a solid."""
        bonds = floats(np.hstack([self.xi[self.half], of.tables.T]), self.kernels.pair)
        return self._offset, bonds, self.kernels.numbers(*map(float, of.cubic)), of.radius

    def force(self, u: wp.array[Any], of: Numbers) -> wp.array[Any]:
        """L u on the interior nodes, shape [S, I] of vectors, of u, shape [S, N] of vectors."""
        laid, law = self._laid_out, self._law(of)
        Lu = empty(u.shape[0], len(self.rows), dtype=self.kernels.vec)
        for part in self._parts(u.shape[0]):
            planes, state = self._state(u[part], law)
            inputs = (laid.pieces.forces, *law[:2], P_OUT, planes, state)
            self._gather(inputs, self.rows, Lu[part])
            laid.give_back("forward", planes, state)
        return Lu

    def product(self, u: wp.array[Any], v: wp.array[Any], of: Numbers) -> wp.array[Any]:
        """The derivative of L u along v, shape [S, I] of vectors."""
        laid, law = self._laid_out, self._law(of)
        rate = empty(u.shape[0], len(self.rows), dtype=self.kernels.vec)
        for part in self._parts(u.shape[0]):
            planes, state = self._state(u[part], law)
            along, change = self._curved("along", laid.pieces.images, v[part], law, P_IN, state)
            inputs = (laid.pieces.forces, *law[:2], P_OUT, along, change)
            self._gather(inputs, self.rows, rate[part])
            laid.give_back("forward", planes, state)
            laid.give_back("along", along, change)
        return rate

    def gradients(self, u: wp.array[Any], of: Numbers) -> tuple[np.ndarray, np.ndarray]:
        """H and P at the nodes `full`, each of shape [S, F, 2, 2]."""
        laid, law, found = self._laid_out, self._law(of), []
        for part in self._parts(u.shape[0]):
            planes, state = self._state(u[part], law)
            by_plane = state.numpy().reshape(-1, PLANES, laid.places)
            found.append(by_plane[:, :, laid.home[self.full]])
            laid.give_back("forward", planes, state)
        whole = np.concatenate(found).transpose(0, 2, 1)
        shape = (*whole.shape[:2], 2, 2)
        return whole[..., 4:].reshape(shape), whole[..., :4].reshape(shape)

    def adjoint(
        self, u: wp.array[Any], of: Numbers, g: wp.array[Any], *, parameters: bool
    ) -> tuple[wp.array[Any], tuple[np.ndarray, np.ndarray] | None]:
        """∂/∂u, and ∂/∂ of the tables [5, H] and the numbers [6], where they are wanted.

        Args:
            u, of: as for `force`.
            g: derivative to L u, shape [S, I] of vectors.
            parameters: whether the second part is wanted.
        """
        laid, law = self._laid_out, self._law(of)
        u_bar = empty(*u.shape, dtype=self.kernels.vec)
        gathered = sums(wp.float64)
        bars = zeros(BLOCKS, gathered.pair * len(self.half))
        by_numbers = zeros(BLOCKS, gathered.material)
        for part in self._parts(u.shape[0]):
            planes, state = self._state(u[part], law)
            images = laid.pieces.row_images
            seeds, back = self._curved("backward", images, g[part], law, P_OUT, state)
            inputs: tuple[Any, ...] = (laid.pieces.nodes, *law[:2], P_IN, seeds, back)
            self._gather(inputs, slice(None), u_bar[part])
            if parameters:
                whole = laid.pieces.whole
                ends = ints(np.arange(BLOCKS + 1) * len(whole) // BLOCKS)
                inputs = (ends, whole, *law[:2], of.radius, planes, state, seeds, back)
                weight = len(whole) * planes.shape[0] * self.kernels.lanes // FASTER // BLOCKS
                outputs = (bars, by_numbers)
                launch_slices(gathered.kernel, BLOCKS, inputs, outputs, weight=max(weight, 1))
            laid.give_back("forward", planes, state)
            laid.give_back("backward", seeds, back)
        if not parameters:
            return u_bar, None
        *C, into, out = (
            bars.numpy().reshape(BLOCKS, -1, SUMS, self.kernels.lanes).sum(axis=(0, 3)).T
        )
        by_table = np.stack([*(-each for each in C), into, -out])
        material = by_numbers.numpy().reshape(BLOCKS, 6, -1).sum(axis=(0, 2))
        return u_bar, (by_table, material)

    def curvatures(self, u: wp.array[Any], of: Numbers) -> np.ndarray:
        """Ψ″ [stress] of one field at the nodes `full`, shape [4, 4, F], entries 11, 12, 21, 22."""
        laid, law = self._laid_out, self._law(of)
        planes, state = self._state(u, (*law[:3], 0.0))
        curved = empty(4, len(self.full), dtype=self.kernels.mat)
        inputs = (ints(laid.home[self.full]), law[2], state)
        launch_slices(self.kernels.tangents, len(self.full), inputs, (curved,), samples=4)
        laid.give_back("forward", planes, state)
        curvatures: np.ndarray = curved.numpy().reshape(4, -1, 4).transpose(2, 0, 1)
        return curvatures

    def _state(self, u: wp.array[Any], law: tuple[Any, ...]) -> tuple[wp.array[Any], wp.array[Any]]:
        """Planes of u and of P and H, to be given back."""
        laid = self._laid_out
        planes, state = laid.planes("forward", u.shape[0], PLANES)
        laid.lay_out(laid.pieces.images, u, planes)
        laid.launch(self.kernels.state, (laid.pieces.needed, *law, planes), state)
        return planes, state

    def _curved(
        self,
        held: str,
        images: Any,
        field: wp.array[Any],
        law: tuple[Any, ...],
        weight: int,
        state: wp.array[Any],
    ) -> tuple[wp.array[Any], wp.array[Any]]:
        """Planes of a field and of Ψ″ by its gradients with a weight, to be given back."""
        laid = self._laid_out
        planes, curved = laid.planes(held, field.shape[0], PLANES)
        laid.lay_out(images, field, planes)
        inputs = (laid.pieces.needed, *law[:2], weight, *law[2:], state, planes)
        laid.launch(self.kernels.curved, inputs, curved)
        return planes, curved

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


class _ThirdOrderForce(torch.autograd.Function):
    """u, tables of pairs [5, H] and the six numbers to L u."""

    @staticmethod
    def forward(
        ctx: Any,
        sweeps: GradientSweeps,
        radius: float,
        u: torch.Tensor,
        tables: torch.Tensor,
        cubic: torch.Tensor,
    ) -> torch.Tensor:
        ctx.sweeps = sweeps
        ctx.save_for_backward(u, tables, cubic)
        ctx.field = wp.from_torch(u.detach().contiguous(), dtype=sweeps.kernels.vec)
        ctx.of = Numbers(tables.detach().numpy(), cubic.detach().numpy(), radius)
        Lu: torch.Tensor = wp.to_torch(sweeps.force(ctx.field, ctx.of), requires_grad=False)
        return Lu

    @staticmethod
    @differentiable_once
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors  # an error where one was changed in place since
        g = wp.from_torch(upstream[0].detach().contiguous(), dtype=ctx.sweeps.kernels.vec)
        wanted = any(ctx.needs_input_grad[3:])
        by_u, others = ctx.sweeps.adjoint(ctx.field, ctx.of, g, parameters=wanted)
        by_u = wp.to_torch(by_u, requires_grad=False)
        if others is None:
            return None, None, by_u, None, None
        return None, None, by_u, *map(torch.from_numpy, others)


_force: Callable[..., torch.Tensor] = _ThirdOrderForce.apply


def third_order_force(
    sweeps: GradientSweeps,
    u: torch.Tensor,
    tables: torch.Tensor,
    cubic: torch.Tensor,
    *,
    radius: float = 0.0,
) -> torch.Tensor:
    """L u [stress/length] on the interior nodes, [..., I, 2], differentiable in every tensor.

    Args:
        sweeps: of a lattice with N nodes.
        u: displacement [length], shape [N, 2] or [S, N, 2], float64.
        tables, cubic, radius: as for Numbers.

    Raises InputError for a u of another shape or type.
    """
    nodes = sweeps.nodes
    fits = u.dim() in (2, 3) and u.shape[-2:] == (nodes, 2) and u.shape[0] > 0
    if u.dtype != torch.float64 or not fits:
        raise InputError(
            f"u: expected float64 of shape [S, {nodes}, 2], S ≥ 1, or [{nodes}, 2], "
            f"got {u.dtype} of shape {list(u.shape)}"
        )
    refuse_tangents(u, tables, cubic)
    Lu = _force(sweeps, radius, u.reshape(-1, nodes, 2), tables, cubic)
    return Lu.reshape(*u.shape[:-2], -1, 2)


class TangentMatrices:
    """H by entry from u, L u from P by entry, and the linear part, of one solid on one lattice."""

    def __init__(self, sweeps: GradientSweeps, of: Numbers) -> None:
        c11, c12, c22, p_in, p_out = of.tables[:, sweeps.pair]
        self.sweeps, xi = sweeps, sweeps.xi.T
        full, rows = sweeps.full, sweeps.rows
        pairs = [(i, k) for i in range(2) for k in range(2)]
        self.into = [_from(self._differences(full, p_in * xi[k]), i) for i, k in pairs]
        forces = [self._gathering(p_out * xi[k]) for k in range(2)]
        self.out = [_to(-forces[k], i) for i, k in pairs]
        bonds = [self._differences(rows, C) for C in (c11, c12, c12, c22)]
        self.linear = -sum(_to(_from(each, k), i) for each, (i, k) in zip(bonds, pairs))

    def tangent(self, second: np.ndarray) -> sp.csr_array:
        """L_linear + Σ out Ψ″ in, shape [2 I, 2 N], from Ψ″ of every node, shape [4, 4, F]."""
        tangent = self.linear
        for out, row in zip(self.out, second):
            for into, entries in zip(self.into, row):
                tangent = tangent + out @ sp.diags_array(entries) @ into
        return sp.csr_array(tangent)

    def _differences(self, nodes_with: np.ndarray, weight: np.ndarray) -> sp.csr_array:
        """Σ_b weight_b (value_j − value_i) at some nodes, shape [len(at), N]."""
        nodes, count = self.sweeps.nodes, len(weight)
        line = np.repeat(np.arange(len(nodes_with)), count)
        far = self.sweeps.neighbour.reshape(nodes, count)[nodes_with].ravel()
        ends = sp.coo_array(
            (np.tile(weight, len(nodes_with)), (line, far)), shape=(len(nodes_with), nodes)
        )
        own = (np.full(len(nodes_with), weight.sum()), (np.arange(len(nodes_with)), nodes_with))
        return sp.csr_array(
            ends.tocsr() - sp.coo_array(own, shape=(len(nodes_with), nodes)).tocsr()
        )

    def _gathering(self, weight: np.ndarray) -> sp.csr_array:
        """Σ_b weight_b (value_j + value_i) on the interior of values at `full`, [I, F].

        The weights of opposite bonds cancel, so that the node's own value does not count.
        """
        full = self.sweeps.full
        gathered = self._differences(self.sweeps.rows, weight)
        return sp.csr_array(gathered.tocsc()[:, full])


def _from(matrix: sp.csr_array, a: int) -> sp.csr_array:
    """Acting on component a of a vector field."""
    return sp.csr_array(sp.kron(matrix, np.eye(2)[a][None]))


def _to(matrix: sp.csr_array, a: int) -> sp.csr_array:
    """Giving component a of a vector field."""
    return sp.csr_array(sp.kron(matrix, np.eye(2)[a][:, None]))
