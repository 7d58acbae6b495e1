"""A lattice laid out row by row in a rectangle, for the sweeps that take many nodes at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warp_peri.kernels.bonds import stay
from warp_peri.kernels.lps.adjoint import structs
from warp_peri.kernels.lps.rows import BYTES, rows
from warp_peri.launch import DEVICE, Shared, ints, launch_slices, threads, zeros
from warp_peri.points.families import BondClasses, Families

SPARE = 2
"""Largest rectangle, in places a node: beyond that the nodes are better left in their lists."""
SHORT = 4
"""Least mean length of a piece that is worth it."""
KEPT = 2**25
"""Most numbers that planes keep between evaluations: 256 MB in double precision."""
BLOCKS = 8
"""Parts in which nodes are summed over, whatever the number of threads."""
FASTER = 4
"""How much less a thread has to do with a node here than in its list of neighbours."""


@dataclass(frozen=True)
class Pieces:
    """Nodes that follow one another in the rectangle and in their numbering, shape [P] of (first
    place, first number, count), see kernels/lps/rows.py.

    Attributes:
        forces: the interior, by number in `rows`.
        nodes: all nodes, by their own number.
        images, row_images: the same two, and the images of theirs that a periodic set needs.
        onto: `images` with the first place for the first number, and the other way round.
        needed: where dilatations are needed.
        whole: the nodes that need one, by place.
    """

    forces: wp.array[Any]
    nodes: wp.array[Any]
    images: wp.array[Any]
    row_images: wp.array[Any]
    onto: wp.array[Any]
    needed: wp.array[Any]
    whole: wp.array[Any]


class Rows:
    """Where the nodes of a lattice lie in the rectangle, and the planes of fields on it.

    Made by `rows_of`.

    Attributes:
        pieces: of nodes.
        offset: places from a node to the end of each bond of the pattern, shape [B].
        places: of a plane, with room around the rectangle that bonds may lead to, P.
        home: place of every node, shape [N].
        by_place: whether `forces` and `nodes` are by place, because by number they would be short.
        kernels: the sweeps.
        ready: launches that nobody uses, see `lent`.
    """

    def __init__(
        self, pieces: Pieces, offset: np.ndarray, places: int, home: np.ndarray, scalar: Any
    ) -> None:
        self.pieces, self.offset, self.home = pieces, ints(offset), home
        self.places, self.scalar, self.kernels = places, scalar, rows(scalar)
        self.by_place = False
        self.one = wp.ones(1, dtype=scalar, device=DEVICE)
        self.none: wp.array[Any] = zeros(0, dtype=wp.vec3i)
        self._spare: dict[str, list[tuple[wp.array[Any], wp.array[Any]]]] = {}
        self.ready: list[Forward] = []

    def planes(
        self, use: str, samples: int, numbers: int = 1
    ) -> tuple[wp.array[Any], wp.array[Any]]:
        """Planes of a vector field [S, 2 P] and of numbers [S, n P], zero off the pieces of a use.

        They are to be given back: a use writes to the same places every time.
        """
        spare = self._spare.get(use, [])
        while True:
            try:
                kept = spare.pop()
            except IndexError:
                break
            if len(kept[0]) == samples:
                return kept
        sizes = (2 * self.places, numbers * self.places)
        vectors, plane = (zeros(samples, size, dtype=self.scalar) for size in sizes)
        return vectors, plane

    def give_back(self, use: str, vectors: wp.array[Any], numbers: wp.array[Any]) -> None:
        """Keep planes that are not too large for the next evaluation of as many samples."""
        if vectors.size + numbers.size <= KEPT:
            self._spare.setdefault(use, []).append((vectors, numbers))

    def lay_out(
        self,
        pieces: wp.array[Any],
        values: wp.array[Any],
        planes: wp.array[Any],
        divisor: wp.array[Any] | None = None,
    ) -> None:
        """Vectors by number into their planes, divided by a number on the device."""
        inputs = (pieces, self.one if divisor is None else divisor, values)
        self.launch(self.kernels.laid_out, inputs, planes)

    def take_up(self, plane: wp.array[Any], numbers: wp.array[Any]) -> None:
        """Numbers from their places back to all nodes."""
        self.launch(self.kernels.taken_up, (self.pieces.nodes, plane), numbers)

    def by_pair(
        self, arrays: Any, pairs: np.ndarray, u: Any, theta: Any, seeds: Any, tau: Any
    ) -> np.ndarray:
        """Three sums of each pair of bonds [3, H], for ∂/∂(K W): of one bond of each by number, u
        and θ by node [S, N], and planes of h and τ."""
        planes, plane = self.planes("sums", len(u))
        self.lay_out(self.pieces.images, u, planes)
        self.launch(self.kernels.taken_up, (self.pieces.onto, theta), plane)
        whole, lanes = self.pieces.whole, self.kernels.lanes
        bars = zeros(BLOCKS, 3 * lanes * len(pairs), dtype=self.scalar)
        ends = ints(np.arange(BLOCKS + 1) * len(whole) // BLOCKS)
        inputs = ends, whole, ints(pairs), self.offset, arrays, planes, plane, seeds, tau
        weight = max(len(whole) * len(u) * lanes // FASTER // BLOCKS, 1)
        launch_slices(self.kernels.by_pair, BLOCKS, inputs, (bars,), weight=weight)
        self.give_back("sums", planes, plane)
        sums = bars.numpy().reshape(BLOCKS, -1, 3, lanes)
        return np.asarray(sums.sum(axis=(0, 3), dtype=float).T)

    def shared(self, kernel: Any, pieces: Sequence[wp.array[Any] | None], *inputs: Any) -> Shared:
        """A sweep of three phases, packed: pieces laid out, needed and asked for, None for none;
        divisor, what leads kernels to bonds, law, values, planes, numbers and vectors."""
        divisor, arrays, law, values, planes, numbers, vectors = inputs
        phases = [self.none if of is None else of for of in pieces]
        given = (*phases, divisor, self.offset, arrays, law, values)
        work = sum(map(len, phases)) * len(planes) * self.kernels.lanes // FASTER
        return Shared(kernel, given, (planes, numbers, vectors), len(phases), work, stay)

    def launch(self, kernel: Any, inputs: tuple[Any, ...], output: wp.array[Any]) -> None:
        """A kernel whose inputs begin with pieces, on all of them and all samples of the output."""
        count, samples = len(inputs[0]), output.shape[0]
        weight = self.kernels.lanes // FASTER
        launch_slices(kernel, count, inputs, (output,), samples=samples, weight=weight)


class Forward:
    """Dilatation and force on a lattice laid out in rows, planes and launch made once.

    Attributes:
        fits: samples and threads that it is for.
        dilatation: by place, after a sweep.
        size: numbers in the planes.
        launch: sweeps what was given last.
    """

    def __init__(self, rows: Rows, arrays: Any, samples: int) -> None:
        vectors = zeros(samples, 2 * rows.places, dtype=rows.scalar)
        self.dilatation = zeros(samples, rows.places, dtype=rows.scalar)
        self.fits, self.size = (samples, threads()), vectors.size + self.dilatation.size
        pieces = rows.pieces.images, rows.pieces.needed, rows.pieces.forces
        given = rows.one, arrays, structs(rows.scalar, 2).Law(), None
        fields = vectors, self.dilatation, None
        self.launch = rows.shared(rows.kernels.forward, pieces, *given, *fields)

    def __call__(self, law: Any, u: wp.array[Any], Lu: wp.array[Any]) -> None:
        """L u into an array, both [S, N] and [S, I] of vectors."""
        for place, value in ((6, law), (7, u), (10, Lu)):
            self.launch.give(place, value)
        self.launch()


@contextmanager
def lent(ready: list[Any], fits: Any, make: Callable[[], Any]) -> Iterator[Any]:
    """One of the ready that fits and nobody else uses meanwhile, made where there is none; ready
    again afterwards unless its size is too large."""
    one = None
    while one is None or one.fits != fits:
        try:
            one = ready.pop()
        except IndexError:
            one = make()
    yield one
    if one.size <= KEPT:
        ready.append(one)


def rows_of(
    families: Families,
    x: np.ndarray,
    box: tuple[float, ...] | None,
    scalar: Any,
    *,
    sparse: bool = False,
) -> Rows | None:
    """The layout of a lattice; None with broken bonds, and where the rectangle or the pieces of it
    would be mostly empty.

    Args:
        families: of the lattice.
        x: its nodes [Å], shape [N, 2].
        box: its periods [Å].
        scalar: type of numbers.
        sparse: whether to lay it out even if mostly empty, and in any order of the nodes.
    """
    grid, steps, period = _grid(families.classes, families.pattern, x, box)
    size = grid.max(axis=0) + 1
    if len(families.cut) or (size.prod() > SPARE * len(grid) and not sparse):
        return None
    reach = int(np.abs(steps).max())
    ring = reach if box is None else 2 * reach
    height, width = (size if box is None else period) + 2 * ring
    room = reach * (width + 1) + BYTES  # for bonds off the rectangle, and the last piece's lanes

    def places(steps: np.ndarray) -> np.ndarray:
        """Places of nodes that are so many steps from the first corner."""
        corner: np.ndarray = room + (steps + ring) @ (width, 1)
        return corner

    lanes = rows(scalar).lanes
    numbers, row_numbers = np.arange(len(grid)), np.full(len(grid), -1)
    row_numbers[families.rows] = np.arange(len(families.rows))
    needed = np.zeros(len(grid), bool)
    needed[families.whole] = True
    home = places(grid)
    nodes = _pieces(home, numbers, lanes)
    short = SHORT * len(nodes) > len(grid)
    if short and not sparse:
        return None
    owner, image = _images(grid, period, ring)
    _, around = _images(grid[needed], period, reach)
    interior = row_numbers[owner] >= 0
    image_places = places(image)
    pieces = Pieces(
        forces=_pieces(home[families.rows], row_numbers[families.rows], lanes),
        nodes=nodes,
        images=_pieces(image_places, owner, lanes),
        onto=_pieces(owner, image_places, lanes),
        row_images=_pieces(image_places[interior], row_numbers[owner[interior]], lanes),
        needed=_pieces(places(around), places(around), lanes),
        whole=_pieces(home[families.whole], home[families.whole], lanes),
    )
    laid = Rows(pieces, steps @ (width, 1), int(height * width + 2 * room), home, scalar)
    if short:
        forces = _pieces(home[families.rows], home[families.rows], lanes)
        laid.pieces = replace(pieces, forces=forces, nodes=_pieces(home, home, lanes))
        laid.by_place = True
    return laid


def _grid(
    classes: BondClasses, pattern: np.ndarray, x: np.ndarray, box: tuple[float, ...] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps of all nodes from the first corner, of all bonds, and of the period (0 for none), the
    axis along which the nodes are numbered last."""
    axes = np.linalg.lstsq(classes.xi, pattern, rcond=None)[0].T
    grid = np.rint((x - x[0]) @ axes / classes.spacing).astype(np.int64)
    grid -= grid.min(axis=0)
    steps, period = classes.steps, np.zeros(2, np.int64)
    if box is not None:
        period = np.rint(np.array(box) / classes.spacing).astype(np.int64)
        grid %= period
    if len(grid) > 1 and grid[0, 1] == grid[1, 1]:  # numbered along the other axis
        grid, steps, period = grid[:, ::-1], steps[:, ::-1], period[::-1]
    return grid, steps, period


def _images(grid: np.ndarray, period: np.ndarray, ring: int) -> tuple[np.ndarray, np.ndarray]:
    """Number and steps of all nodes and of their periodic images in a ring around the period."""
    owners, images = [np.arange(len(grid))], [grid]
    if period.any():
        border = np.flatnonzero(((grid < ring) | (grid >= period - ring)).any(axis=1))
        for shift in np.ndindex(3, 3):
            image = grid[border] + (np.array(shift) - 1) * period
            inside = ((image >= -ring) & (image < period + ring)).all(axis=1)
            if shift != (1, 1):
                owners.append(border[inside])
                images.append(image[inside])
    return np.concatenate(owners), np.concatenate(images)


def _pieces(places: np.ndarray, numbers: np.ndarray, lanes: int) -> wp.array[Any]:
    """Pieces of at most so many lanes, in the order of their places, shape [P] of vectors."""
    if (np.diff(places) <= 0).any():
        order = np.argsort(places, kind="stable")
        places, numbers = places[order], numbers[order]
    broken = np.ones(len(places), bool)
    broken[1:] = (np.diff(places) != 1) | (np.diff(numbers) != 1)
    begin = np.flatnonzero(broken)
    length = np.diff(np.append(begin, len(places)))
    parts = -(-length // lanes)
    step = lanes * (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts))
    first = np.repeat(begin, parts) + step
    count = np.minimum(np.repeat(length, parts) - step, lanes)
    table = np.stack([places[first], numbers[first], count], axis=1).astype(np.int32)
    return wp.array(table, dtype=wp.vec3i, device=DEVICE)
