"""The bonds of a lattice, each listed once, and the sweeps over them with their adjoints."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_peri.contract import Remade
from warp_peri.core.tensors import differentiable_once
from warp_peri.errors import InputError
from warp_peri.kernels.neural.sweeps import sweeps
from warp_peri.launch import floats, ints, launch_slices
from warp_peri.points.families import families_of
from warp_peri.points.samples import PointsLike, nodes_of

SCALARS = {torch.float32: wp.float32, torch.float64: wp.float64}


class NetworkBonds(Remade):
    """Bonds within two horizons of the interior of a lattice, each once, those by class.

    Attributes:
        points: the nodes.
        xi: bond vectors of a family [length], shape [B, 2].
        kind: class of each bond of a family by length, shape [B].
        opposite: number of −ξ in the family, shape [B].
        rows: interior nodes, where forces act, shape [I].
        whole: nodes with whole families, whose dilatation is known, shape [F].
        near, far, place: ends of each listed bond, and its number in the family of the near one,
            shape [L]. The first `acting` bonds have an interior end.
        own, other: of the acting bonds, the places of the ends among the whole nodes.

    Raises InputError for scattered points and those in space, broken bonds, and an interior without
    its 2δ collar.
    """

    def __init__(self, points: PointsLike, horizon: float) -> None:
        if not points.spacing > 0:
            raise InputError("points: expected a lattice (spacing > 0), got scattered points")
        if points.x.shape[1] != 2:
            raise InputError(f"points: expected a plane, got {points.x.shape[1]} dimensions")
        if points.outside is not None:
            raise InputError("points: expected none outside of the body")
        families = families_of(points, horizon)
        self.points, self.horizon = nodes_of(points), float(horizon)
        self.xi = families.pattern
        self.opposite = families.reverse
        self.kind = families.classes.bond_class
        self.area = points.spacing**2
        self.rows, self.whole = families.rows, families.whole
        self.neighbour = families.neighbour.reshape(-1, len(self.xi))
        self._list()
        self._placed: dict[Any, Any] = {}

    def _list(self) -> None:
        """Every bond of a whole family once; a bond of two such families from its first half."""
        nodes, family = len(self.neighbour), len(self.xi)
        inner = self.points.interior
        self.row = np.full(nodes, -1)
        self.row[self.whole] = np.arange(len(self.whole))
        first = np.arange(family) < self.opposite
        far = self.neighbour[self.whole]
        k, p = np.nonzero(first | (self.row[far] < 0))
        i, j = self.whole[k], far[k, p]
        acts = inner[i] | inner[j]
        order = np.lexsort((p, self.kind[p], ~acts))
        self.near, self.far, self.place = i[order], j[order], p[order]
        self.acting = int(acts.sum())
        self.number = np.full((nodes, family), -1)
        listed = np.arange(len(order))
        self.number[self.near, self.place] = listed
        self.number[self.far, self.opposite[self.place]] = listed
        act = slice(self.acting)
        self.own = torch.from_numpy(self.row[self.near[act]])
        self.other = torch.from_numpy(self.row[self.far[act]])
        self.forward = torch.from_numpy(self.place[act].astype(np.int64))
        self.backward = torch.from_numpy(self.opposite[self.place[act]].astype(np.int64))

    @cached_property
    def lengths(self) -> np.ndarray:
        """|ξ| of the family [length], shape [B]."""
        r: np.ndarray = np.hypot(*self.xi.T)
        return r

    def of(self, dtype: torch.dtype) -> Any:
        """Kernels, lattice and lists of nodes in one precision."""
        if dtype not in SCALARS:
            raise InputError(f"u: expected float32 or float64, got {dtype}")
        if dtype not in self._placed:
            kernels = sweeps(SCALARS[dtype])
            real = np.float32 if dtype == torch.float32 else np.float64
            lattice = kernels.Lattice()
            lattice.xi = floats(self.xi.astype(real), kernels.vec)
            lattice.length = floats(self.lengths.astype(real), kernels.scalar)
            lattice.opposite, lattice.place = ints(self.opposite), ints(self.place)
            lattice.neighbour, lattice.number = ints(self.neighbour), ints(self.number)
            lattice.near, lattice.far = ints(self.near), ints(self.far)
            self._placed[dtype] = kernels, lattice
        return self._placed[dtype]

    @cached_property
    def lists(self) -> dict[str, Any]:
        """Lists of nodes as the kernels read them."""
        every = np.arange(len(self.neighbour))
        return {
            name: ints(values)
            for name, values in (("rows", self.rows), ("whole", self.whole), ("every", every))
        } | {"row": ints(self.row)}

    def extension(self, u: torch.Tensor) -> torch.Tensor:
        """e of every listed bond [length], shape [S, L]."""
        kernels, lattice = self.of(u.dtype)
        out = u.new_empty(len(u), len(self.near))
        self._sweep(kernels.extension, kernels, len(self.near), (lattice, u), out)
        return out

    def stretching(self, u: torch.Tensor, v: torch.Tensor, count: int) -> torch.Tensor:
        """M·(v_j − v_i) of the first bonds, shape [S, count]."""
        kernels, lattice = self.of(u.dtype)
        out = u.new_empty(len(v), count)
        self._sweep(kernels.stretching, kernels, count, (lattice, u, v), out)
        return out

    def average(self, e: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
        """Σ share e over the families of whole nodes, shape [S, F]."""
        kernels, lattice = self.of(e.dtype)
        out = e.new_empty(len(e), len(self.whole))
        given = (lattice, self.lists["whole"], e, share)
        self._sweep(kernels.average, kernels, len(self.whole), given, out, len(self.xi))
        return out

    def by_share(self, e: torch.Tensor, seed: torch.Tensor) -> torch.Tensor:
        """Derivative of Σ seed average(e, share) to the shares, shape [B]."""
        kernels, lattice = self.of(e.dtype)
        out = e.new_empty(len(self.xi))
        given = (lattice, self.lists["whole"], wp.from_torch(e), wp.from_torch(seed))
        launch_slices(kernels.by_share, len(out), given, (wp.from_torch(out),), weight=seed.numel())
        return out

    def spread(self, e: torch.Tensor, share: torch.Tensor, seed: torch.Tensor) -> torch.Tensor:
        """`e` with the adjoint of `average` added in place."""
        kernels, lattice = self.of(e.dtype)
        given = (lattice, self.lists["row"], share, seed)
        self._sweep(kernels.spread, kernels, e.shape[1], given, e)
        return e

    def pull(self, u: torch.Tensor, tension: torch.Tensor, nodes: str) -> torch.Tensor:
        """−Σ tension M at the interior ("rows") or every node, shape [S, ·, 2]."""
        kernels, lattice = self.of(u.dtype)
        out = u.new_empty(len(tension), len(self.lists[nodes]), 2)
        given = (lattice, self.lists[nodes], u, tension)
        self._sweep(kernels.pull, kernels, out.shape[1], given, out, len(self.xi))
        return out

    def turn(
        self, u: torch.Tensor, v: torch.Tensor, tension: torch.Tensor, nodes: str
    ) -> torch.Tensor:
        """−Σ tension Ṁ, Ṁ of the motion v, shape [S, ·, 2]."""
        kernels, lattice = self.of(u.dtype)
        out = u.new_empty(len(tension), len(self.lists[nodes]), 2)
        given = (lattice, self.lists[nodes], u, v, tension)
        self._sweep(kernels.turn, kernels, out.shape[1], given, out, len(self.xi))
        return out

    def _sweep(
        self,
        kernel: Any,
        kernels: Any,
        count: int,
        given: tuple[Any, ...],
        out: torch.Tensor,
        weight: int = 1,
    ) -> None:
        """Launch on torch tensors where they lie; those of rank three are vectors."""

        def lent(value: Any) -> Any:
            if not isinstance(value, torch.Tensor):
                return value
            vectors = kernels.vec if value.dim() == 3 else kernels.scalar
            return wp.from_torch(value.detach().contiguous(), dtype=vectors)

        arrays = [lent(value) for value in given]
        launch_slices(kernel, count, arrays, (lent(out),), samples=len(out), weight=weight)

    def on_every(self, inner: torch.Tensor) -> torch.Tensor:
        """A field of the interior as one of all nodes, zero elsewhere."""
        field = inner.new_zeros(len(inner), len(self.neighbour), 2)
        field[:, self.rows] = inner
        return field


class Gather(torch.autograd.Function):
    """u [S, N, 2] and shares [B] → extensions of the acting bonds [S, A] and ϑ [S, F]."""

    @staticmethod
    def forward(
        context: Any, u: torch.Tensor, share: torch.Tensor, bonds: NetworkBonds
    ) -> tuple[torch.Tensor, torch.Tensor]:
        e = bonds.extension(u)
        context.bonds = bonds
        context.save_for_backward(u, share, e)
        return e[:, : bonds.acting].contiguous(), bonds.average(e, share)

    @staticmethod
    @differentiable_once
    def backward(
        context: Any, by_e: torch.Tensor, by_theta: torch.Tensor
    ) -> tuple[torch.Tensor | None, torch.Tensor | None, None]:
        u, share, e = context.saved_tensors
        bonds, by_theta = context.bonds, by_theta.contiguous()
        by_u = by_share = None
        if context.needs_input_grad[0]:
            seed = torch.zeros_like(e)
            seed[:, : bonds.acting] = by_e
            by_u = bonds.pull(u, bonds.spread(seed, share, by_theta), "every")
        if context.needs_input_grad[1]:
            by_share = bonds.by_share(e, by_theta)
        return by_u, by_share, None


class Scatter(torch.autograd.Function):
    """u [S, N, 2] and tensions of the acting bonds [S, A] → forces on the interior [S, I, 2]."""

    @staticmethod
    def forward(
        context: Any, u: torch.Tensor, tension: torch.Tensor, bonds: NetworkBonds
    ) -> torch.Tensor:
        context.bonds = bonds
        context.save_for_backward(u, tension)
        return bonds.area * bonds.pull(u, tension, "rows")

    @staticmethod
    @differentiable_once
    def backward(
        context: Any, seed: torch.Tensor
    ) -> tuple[torch.Tensor | None, torch.Tensor | None, None]:
        u, tension = context.saved_tensors
        bonds = context.bonds
        wide = bonds.area * bonds.on_every(seed)
        by_u = by_tension = None
        if context.needs_input_grad[0]:
            by_u = bonds.turn(u, wide, tension, "every")
        if context.needs_input_grad[1]:
            by_tension = bonds.stretching(u, wide, bonds.acting)
        return by_u, by_tension, None
