"""Products Gᵗ K G by rows, K even or with moduli at every element or node (theory.md, D22, D25)."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import maximum_filter

from warp_peri.core.grid import Grid
from warp_peri.core.sweeps import FASTER, SCALARS, entries, row_pieces
from warp_peri.dressed.bases import Base, half
from warp_peri.kernels.dressed.bonds import bonds
from warp_peri.kernels.dressed.elements import elements
from warp_peri.kernels.micromodulus.rows import rows
from warp_peri.launch import DEVICE, floats, ints, launch_slices

MODES = {"elements": 5, "bonds": 1}
"""What a site leaves for its nodes: modes of a square element that are not rigid; a dilatation."""


class ByLayers:
    """L u of one G in three sweeps, each over as many places as the next one reads.

    Args:
        nodes: the box, laid out for the reach of L.
        steps, tensors: of one half of G, [H, d] and [H, d, d].
        base: of the law, K.
        spacing: h.
        factors: moduli of each part over those of the even solid at the sites of the box,
            [A, *wide]; None for the even solid. In the plane.
        dtype: float64 or float32.
    """

    def __init__(
        self,
        nodes: Grid,
        steps: np.ndarray,
        tensors: np.ndarray,
        base: Base,
        spacing: float,
        factors: np.ndarray | None = None,
        dtype: Any = np.float64,
    ) -> None:
        self.nodes, self.dtype = nodes, np.dtype(dtype)
        self.scalar = SCALARS[self.dtype]
        self.kernels = rows(self.scalar, nodes.dimension)
        self.strides = np.array([int(np.prod(nodes.wide[a + 1 :])) for a in range(nodes.dimension)])
        mask = np.zeros(nodes.wide, bool)
        mask[nodes.core] = nodes.unknown
        middle = half(base.stencils.sum(axis=0))
        outer = (steps, tensors)
        self.stages: list[tuple[Any, ...]] = []
        reach, own = 0, int(np.abs(steps).max())
        for dressed, (along, C) in ((1, outer), (0, middle), (1, outer)):
            pieces = self._pieces(maximum_filter(mask, 2 * reach + 1))
            values = C if dressed else C / spacing**2
            tables = ints(along @ self.strides), self._floats(entries(values))
            self.stages.insert(0, (pieces, dressed, *tables))
            reach += int(np.abs(along).max())
        places = int(np.prod(nodes.wide))
        ends = [int(p.numpy()[-1, 0]) + int(o.numpy().max()) for p, _, o, _ in self.stages]
        self.beyond = max(ends) + self.kernels.lanes + int(self.strides.sum()) > places
        self.kind, self.maps = base.kind, None
        if factors is not None:
            sites = self._pieces(maximum_filter(mask, 2 * (own + 1) + 1))
            flat = factors.reshape(len(factors), -1) / spacing**2
            where: Any  # offsets of bonds, or of the next row of elements
            if base.kind == "bonds":
                self.uneven = bonds(self.scalar)
                along, table, mixed = bond_table(base)
                where, flat = ints(along @ self.strides), mixed @ flat
            else:
                self.uneven, table = elements(self.scalar), element_modes(base)
                where = int(self.strides[0])
            self.maps = sites, (where, self._floats(table), self._floats(flat, spare=True))
        self._buffers: dict[tuple[int, int], np.ndarray] = {}

    def __call__(self, planes: np.ndarray) -> np.ndarray:
        """L u at the unknown nodes of planes [S, d, *wide]; planes [S, d, *shape], else zero."""
        nodes, d = self.nodes, self.nodes.dimension
        count, size = len(planes), d * int(np.prod(nodes.wide))
        first, second = (self._buffer(n, count, size) for n in range(2))
        field = np.ascontiguousarray(planes, self.dtype).reshape(count, -1)
        if self.beyond:  # lanes of the last piece would read past the end
            field = self._buffer(2, count, size)
            field[:] = planes.reshape(count, -1)
        out = np.zeros((count, size), self.dtype)
        for number, (given, found) in enumerate(((field, first), (first, second), (second, out))):
            if number == 1 and self.maps is not None:
                self._uneven(self.maps, given, found)
            else:
                self._launch(
                    self.kernels.pulled,
                    self.stages[number][0],
                    self.stages[number][1:],
                    given,
                    found,
                )
        force = out.reshape(count, d, *nodes.wide)
        return force[(slice(None), slice(None), *nodes.core)] if nodes.periodic else force

    def _uneven(self, maps: tuple[Any, Any], given: np.ndarray, found: np.ndarray) -> None:
        (sites, inputs), nodes = maps, self.stages[1][0]
        stresses = self._buffer(3, len(given), MODES[self.kind] * int(np.prod(self.nodes.wide)))
        self._launch(self.uneven.stressed, sites, inputs, given, stresses)
        if self.kind == "bonds":
            both = (*inputs, floats(stresses, self.scalar))
            self._launch(self.uneven.gathered, nodes, both, given, found)
        else:
            self._launch(self.uneven.gathered, nodes, inputs[:1], stresses, found)

    def _launch(
        self, kernel: Any, pieces: Any, inputs: tuple[Any, ...], given: np.ndarray, out: np.ndarray
    ) -> None:
        launch_slices(
            kernel,
            len(pieces),
            (pieces, *inputs, floats(given, self.scalar)),
            (floats(out, self.scalar),),
            samples=len(given),
            weight=self.kernels.lanes // FASTER,
        )

    def _buffer(self, number: int, count: int, size: int) -> np.ndarray:
        """[S, size] with room behind for the last piece's lanes, kept between calls."""
        key = number, count
        if key not in self._buffers:
            self._buffers[key] = np.zeros(count * size + self.kernels.lanes, self.dtype)
        return self._buffers[key][: count * size].reshape(count, size)

    def _pieces(self, asked: np.ndarray) -> Any:
        return wp.array(
            row_pieces(asked.ravel(), self.kernels.lanes), dtype=wp.vec2i, device=DEVICE
        )

    def _floats(self, values: np.ndarray, spare: bool = False) -> Any:
        if not spare:
            return floats(values.astype(self.dtype), self.scalar)
        room = np.zeros(values.size + self.kernels.lanes, self.dtype)
        laid = room[: values.size].reshape(values.shape)
        laid[:] = values
        return floats(laid, self.scalar)


def element_modes(base: Base) -> np.ndarray:
    """What sums of corner displacement of a square element cost, with its moduli, [A, 9]: of
    ∂₁u₁, ∂₂u₂ and ∂₂u₁ + ∂₁u₂ the upper triangle, and that of the two hourglass modes."""
    found = []
    root = 2**-0.5
    for modulus, part in zip(base.moduli, base.parts):
        P = modulus * part[:3, :3]  # of one Gauss point of four: the quarter of half sums squared
        even = np.diag([1, 1, root])
        bent = [np.array([[1, 0], [0, 0], [0, root]]), np.array([[0, 0], [0, 1], [root, 0]])]
        Q = sum(V.T @ P @ V for V in bent) / 3
        found.append(np.concatenate([entries((even @ P @ even)[None])[0], entries(Q[None])[0]]))
    return np.array(found)


def bond_table(base: Base) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of bonds that vary (D25): steps of one half, [H, 2]; a d and the upper triangle of w d ⊗ d,
    [H, 5]; and the matrix that leads from factors of the parts to κ − 2 μ and 8 μ, [2, 2]."""
    bulk, shear = base.moduli
    theta, rest = base.parts
    apart = ~np.eye(len(theta), dtype=bool)
    share = -(rest[apart] @ theta[apart]) / (theta[apart] @ theta[apart])  # 2/M of (D26)
    a = theta[np.argmax(np.diag(theta))] / np.sqrt(np.diag(theta).max())
    w = np.diag(rest + share * theta) / 8
    half = slice(len(a) // 2, None)  # the others are opposite
    d = base.strains[np.arange(len(a)), 1 + np.arange(len(a))][half]
    square = entries(w[half, None, None] * d[:, :, None] * d[:, None])
    table = np.concatenate([a[half, None] * d, square], axis=1)
    return base.corners[1:][half], table, np.array([[bulk, -share * shear], [0, 8 * shear]])
