"""The bonds of the linear solid in one precision, where its nodes lie for the sweeps over them, and
what its numbers make of them.

A lattice lies row by row in a box, many nodes at a time; anything else as it is numbered, with
lists of bonds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import ArrayLike
from scipy.special import comb

from warp_peri.errors import InputError
from warp_peri.kernels.lps.influence import influence
from warp_peri.kernels.lps.sweeps import BYTES, struct, sweeps
from warp_peri.materials.lps import CANCELLED, LPSMaterial
from warp_peri.points.families import Families, families_of
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.runtime import (
    DEVICE,
    empty,
    filled,
    floats,
    ints,
    known_device,
    launch_slices,
    zeros,
)

PRECISIONS = {"float64": wp.float64, "float32": wp.float32}
SPARE = 2
"""Largest box, in places a node: beyond that the nodes are better left in their lists."""
SHORT = 4
"""Least mean length of a piece that is worth it."""


@dataclass(frozen=True)
class Layout:
    """Places and bonds, as kernels/lps/sweeps.py says. Pieces have shape [·] of vectors.

    Attributes:
        in_rows: whether all places share one family, and are laid out in planes.
        row, end: first bond of each place, and places from one to the end of each bond.
        bond: vectors ξ [Å] and 1/r², shape [E, d + 1], of rows [B, d + 1].
        places: of a plane, P.
        images: place and number of every node, periodic images included; None of lists.
        home: place of every node, shape [N], or all of them.
        pieces: to be "laid" out, where dilatations are "needed", and "forces"; "back" and "nodes",
            the same of the transpose, of forces to all nodes; "whole", needed without images;
            none for None.
        ready: launches and planes that nobody uses.
    """

    in_rows: bool
    row: np.ndarray
    end: np.ndarray
    bond: np.ndarray
    places: int
    images: tuple[np.ndarray, np.ndarray] | None
    home: Any
    pieces: dict[str | None, wp.array[Any]]
    ready: dict[Any, list[Any]] = field(default_factory=dict)


def listed(points: Points, families: Families) -> tuple[np.ndarray, ...]:
    """Owner, far end and vector of each bond, and its number in tables by class, shape [E].

    Broken bonds, and those to nodes that are not there, end at a negative node.
    """
    row, end = families.row, families.neighbour
    owner = np.repeat(np.arange(len(row) - 1), np.diff(row))
    if families.lattice is not None:
        nodes = len(row) - 1
        kind = np.tile(families.lattice.bond_class, nodes)
        return owner, end, np.tile(families.pattern, (nodes, 1)), kind
    xi = points.x[np.where(end < 0, -1 - end, end)] - points.x[owner]
    if points.box is not None:  # the nearest images
        xi -= points.box * np.rint(xi / points.box)
    return owner, end, xi, np.arange(len(end))


def lists_of(points: Points, families: Families, device: str = DEVICE) -> Layout:
    """The layout of nodes as they are numbered."""
    owner, end, xi, _ = listed(points, families)
    nodes, full = np.arange(len(points.x)), np.concatenate([families.whole, families.cut])

    def pieces(places: np.ndarray) -> wp.array[Any]:
        return _pieces(places, np.arange(len(places)), 1, device)

    of: dict[str | None, Any] = dict.fromkeys((None, "laid", "back"), pieces(nodes[:0]))
    of |= dict.fromkeys(("needed", "whole"), pieces(np.sort(full)))
    of |= {"forces": pieces(families.rows), "nodes": pieces(nodes)}
    to = np.where(end < 0, 0, end - owner)
    return Layout(False, families.row, to, _bond(xi), len(nodes), None, slice(None), of)


def rows_of(points: Points, families: Families, scalar: Any) -> Layout | None:
    """The layout of a lattice in a box; None with broken bonds, and where the box or the pieces of
    it would be mostly empty."""
    if families.lattice is None or len(families.cut):
        return None
    grid, steps = lattice_steps(points)[0], families.lattice.steps
    period = np.zeros(points.dimension, np.int64)
    if points.box is not None:
        period = np.rint(np.divide(points.box, points.spacing)).astype(np.int64)
    order = np.argsort(np.abs(grid[1:2] - grid[:1]).sum(axis=0), kind="stable")
    grid, steps, period = grid[:, order], steps[:, order], period[order]  # numbered last along it
    grid = (grid - grid.min(axis=0)) % np.where(period, period, grid.max() - grid.min() + 1)
    size, reach = grid.max(axis=0) + 1, int(np.abs(steps).max())
    if size.prod() > SPARE * len(grid):
        return None
    ring = reach if points.box is None else 2 * reach
    sides = np.where(period, period, size) + 2 * ring
    stride = np.append(np.cumprod(sides[:0:-1])[::-1], 1)
    lanes = BYTES // wp.types.type_size_in_bytes(scalar)
    room = reach * int(stride.sum()) + lanes  # for bonds off the box, and the last piece's lanes

    def places(steps: np.ndarray) -> np.ndarray:
        corner: np.ndarray = room + (steps + ring) @ stride
        return corner

    def pieces(places: np.ndarray, numbers: np.ndarray) -> wp.array[Any]:
        return _pieces(places, numbers, lanes, DEVICE)

    home, numbers = places(grid), np.arange(len(grid))
    nodes = pieces(home, numbers)
    if SHORT * len(nodes) > len(grid):
        return None
    row_numbers, needed = np.full(len(grid), -1), np.zeros(len(grid), bool)
    row_numbers[families.rows], needed[families.whole] = np.arange(len(families.rows)), True
    owner, image = _images(grid, period, ring)
    around = places(_images(grid[needed], period, reach)[1])
    inside, at = row_numbers[owner] >= 0, places(image)
    of: dict[str | None, Any] = {
        None: pieces(home[:0], home[:0]),
        "laid": pieces(at, owner),
        "needed": pieces(around, around),
        "forces": pieces(home[families.rows], row_numbers[families.rows]),
        "back": pieces(at[inside], row_numbers[owner[inside]]),
        "nodes": nodes,
        "whole": pieces(home[families.whole], home[families.whole]),
    }
    pairs = np.argsort(np.minimum(np.arange(len(steps)), families.reverse), kind="stable")
    row, end, xi = np.array([0, len(steps)]), steps[pairs] @ stride, families.pattern[pairs]
    count = int(sides.prod() + 2 * room)
    return Layout(True, row, end, _bond(xi), count, (at, owner), home, of)


def _bond(xi: np.ndarray) -> np.ndarray:
    return np.hstack([xi, 1 / (xi**2).sum(axis=1, keepdims=True)])


def _images(grid: np.ndarray, period: np.ndarray, ring: int) -> tuple[np.ndarray, np.ndarray]:
    """Number and steps of all nodes and of their periodic images in a ring around the period."""
    owners, images = [np.arange(len(grid))], [grid]
    if period.any():
        border = np.flatnonzero(((grid < ring) | (grid >= period - ring)).any(axis=1))
        for shift in np.ndindex(*[3] * len(period)):
            image = grid[border] + (np.array(shift) - 1) * period
            inside = ((image >= -ring) & (image < period + ring)).all(axis=1)
            if np.any(np.array(shift) != 1):
                owners.append(border[inside])
                images.append(image[inside])
    return np.concatenate(owners), np.concatenate(images)


def _pieces(places: np.ndarray, numbers: np.ndarray, lanes: int, device: str) -> wp.array[Any]:
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
    return wp.array(table, dtype=wp.vec3i, device=device)


class Bonds:
    """Families of a point set and what kernels read of them, in one precision.

    Args:
        points: a lattice, or scattered points (spacing 0). Bonds to nodes outside are broken, and
            the dilatation of nodes that had such bonds is corrected (theory, 40–41).
        horizon: δ [Å].
        bond_based: λ = μ, of which no dilatation is seen: a collar of δ is enough.
        quadrature_degree: of the polynomials that the weights are exact for.
        precision: "float64" or "float32".
        device: where the arrays lie and the kernels run, as Warp names it: "cpu", "cuda:0". The
            families are found on the processor.

    Attributes:
        families: families of all nodes.
        dimension: 2 or 3.
        scalar: type of numbers in this precision.
        nodes: their number N.
        plain: whether plain sweeps run, elsewhere than on the processor.
        layout: of nodes and bonds.
        kept: the last law, and the numbers that it is of.

    Raises InputError for what families_of refuses, another precision, and an unknown device.
    """

    def __init__(
        self,
        points: PointsLike,
        horizon: float,
        *,
        bond_based: bool = False,
        quadrature_degree: int = DEGREE,
        precision: str = "float64",
        device: str = DEVICE,
    ) -> None:
        if precision not in PRECISIONS:
            raise InputError(f"precision: expected one of {list(PRECISIONS)}, got {precision!r}")
        self.scalar, self.device = PRECISIONS[precision], known_device(device)
        self.plain = self.device != DEVICE
        self.points, self.horizon, self.bond_based = nodes_of(points), float(horizon), bond_based
        self.nodes, self.dimension = points.x.shape
        self.families = families_of(
            points, horizon, bond_based=bond_based, degree=quadrature_degree
        )
        self.kept: tuple[Any, SweepLaw] | None = None

    @property
    def lattice(self) -> bool:
        """Whether the points are a lattice, whose nodes share one pattern of bonds."""
        return self.families.lattice is not None

    @cached_property
    def layout(self) -> Layout:
        """In rows where that can be, and in lists otherwise."""
        rows = None if self.plain else rows_of(self.points, self.families, self.scalar)
        return rows or lists_of(self.points, self.families, self.device)

    @cached_property
    def left(self) -> list[np.ndarray]:
        """As `listed`, the bonds that nodes have left which have lost some."""
        bonds = listed(self.points, self.families)
        left = np.flatnonzero((bonds[1] >= 0) & np.isin(bonds[0], self.families.cut))
        return [one[left] for one in bonds]

    @cached_property
    def tables(self) -> tuple[Any, ...]:
        """r, ln r and W of each class of bonds, shape [C]."""
        r = self.families.r
        return tuple(map(self.floats, (r, np.log(r), self.families.weight)))

    @cached_property
    def links(self) -> tuple[Any, ...]:
        """What leads kernels from a place to its bonds."""
        layout, families = self.layout, self.families
        slot = np.zeros(1) if families.lattice is None else families.lattice.bond_class
        links = (ints(one, self.device) for one in (layout.row, layout.end, slot))
        dtype = wp.types.vector(self.dimension + 1, self.scalar)
        return *links, floats(layout.bond, dtype, self.device)

    def empty(self, *shape: int) -> wp.array[Any]:
        """A Warp array that a kernel is about to fill, where the bonds are."""
        return empty(*shape, dtype=self.scalar, device=self.device)

    def floats(self, values: ArrayLike) -> wp.array[Any]:
        """A Warp array in this precision, where the bonds are."""
        return floats(np.ascontiguousarray(values), self.scalar, self.device)

    def zeros(self, *shape: int, gradient: bool = False) -> wp.array[Any]:
        """A Warp array of zeros, where the bonds are."""
        return zeros(*shape, dtype=self.scalar, gradient=gradient, device=self.device)

    def influence(self, alpha: ArrayLike, D: ArrayLike, by: Any = None) -> Any:
        """K W of each class, [C]; with derivatives of a scalar to it those to α and D, by Warp's
        tape, which is this call's alone."""
        numbers = [np.ravel(value).astype(float) for value in (alpha, D)]
        taped, degree = by is not None, len(numbers[1]) - 1
        given: list[Any] = [
            wp.array(one, dtype=self.scalar, device=self.device, requires_grad=taped)
            for one in numbers
        ]
        kernel = influence(degree, self.scalar)
        kw = self.zeros(len(self.families.r), gradient=taped)
        fixed = (self.scalar(self.horizon), self.floats(comb(degree, np.arange(degree + 1))))
        inputs = (*fixed, *self.tables, *given)
        if not taped:
            launch_slices(kernel, len(kw), inputs, (kw,))
            return kw.numpy()
        tape: Any = wp.Tape()
        kernel.module.load(self.device)
        tape.record_launch(kernel, len(kw), 0, [0, *inputs], [kw], self.device)
        tape.backward(grads={kw: self.floats(by)})
        return [array.grad.numpy() for array in given]

    def law(self, *values: Any) -> SweepLaw:
        """What sweeps read of λ, μ, α and D; that of the last is kept."""
        arrays = [np.array(value).ravel() for value in values]  # copies, which nobody changes
        key, last = [array.tobytes() for array in arrays], self.kept
        if last is None or last[0] != key:
            same = last is not None and last[0][2:] == key[2:]
            table = last[1].table if last and same else Stiffness(self, *arrays[2:])
            last = self.kept = key, SweepLaw(self, table, *arrays)
        return last[1]


class Stiffness:
    """What α and D make of bonds.

    Attributes:
        kw, m: K W of each class [C] and weighted volume of each node [N], of a lattice one number.
        own: K W/m of each bond of the layout, 0 of broken ones.
    """

    def __init__(self, bonds: Bonds, alpha: np.ndarray, D: np.ndarray) -> None:
        self.bonds, families, layout = bonds, bonds.families, bonds.layout
        self.kw = bonds.influence(alpha, D)
        m = volumes(bonds, self.kw * families.r**2)
        self.m = np.where(m == 0, 1, m)  # of nodes that need none
        if families.lattice is not None:
            self._own = (self.kw / self.m)[families.lattice.bond_class]
            if not layout.in_rows:
                self._own = np.tile(self._own, bonds.nodes)
        else:
            self._own = self.kw / np.repeat(self.m, np.diff(families.row))
        if not layout.in_rows:
            self._own[families.neighbour < 0] = 0
        self.own = bonds.floats(self._own)
        self.volumes = bonds.floats(np.broadcast_to(self.m, bonds.nodes))

    @cached_property
    def far(self) -> wp.array[Any]:
        """The same of the bond back; of lattices, where it is `own`, nothing."""
        bonds = self.bonds
        return bonds.floats([] if bonds.lattice else self._own[bonds.families.reverse])

    @cached_property
    def surface(self) -> sp.csr_array:
        """Dilatations of the nodes that have lost bonds from displacements, [·, d N]."""
        return surface(self.bonds, self.kw)


def volumes(bonds: Bonds, terms: np.ndarray) -> Any:
    """The sum of a table by class over each whole ball, [N]; of a lattice one number."""
    if bonds.lattice:
        return (bonds.families.classes.count * terms).sum()
    return np.add.reduceat(terms, bonds.families.row[:-1])


def inverted(bonds: Bonds, kw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """S⁻¹ ξ [·, d] of the bonds `left`, (40–41), of K W of each, and whose they are among `cut`."""
    owner, _, xi, _ = bonds.left
    place, d = np.searchsorted(bonds.families.cut, owner), bonds.dimension
    shape = np.zeros((len(bonds.families.cut), d, d))
    np.add.at(shape, place, kw[:, None, None] * xi[:, :, None] * xi[:, None])
    return np.einsum("eab,eb->ea", np.linalg.inv(shape)[place], xi), place


def surface(bonds: Bonds, kw: np.ndarray) -> sp.csr_array:
    """Dilatations of the nodes that have lost bonds from displacements, (40–41), [·, d N], of K W
    of each class."""
    owner, end, _, kind = bonds.left
    d, cut = bonds.dimension, bonds.families.cut
    turned, place = inverted(bonds, kw[kind].astype(float))
    bent, row = kw[kind, None] * turned, place[:, None].repeat(d, axis=1)
    parts = [
        sp.coo_array((bent.ravel(), (row.ravel(), (d * at[:, None] + np.arange(d)).ravel())),
                     (len(cut), d * bonds.nodes)).tocsr()
        for at in (end, owner)
    ]  # fmt: skip
    return sp.csr_array(parts[0] - parts[1])


class SweepLaw:
    """What sweeps read of a solid's numbers: λ and μ of shape [1], or [N], one value a node."""

    def __init__(self, bonds: Bonds, table: Stiffness, *values: np.ndarray) -> None:
        self.table, self.values, self.bonds = table, values, bonds
        lam, mu = values[:2]
        for name, one in (("lambda", lam), ("mu", mu)):
            if one.size not in (1, bonds.nodes):
                raise InputError(
                    f"{name}: expected one number, or one of each of {bonds.nodes} nodes, got "
                    f"shape {list(one.shape)}"
                )
        self.fields = max(lam.size, mu.size) > 1
        self._moduli = [bonds.floats(self._placed(one)) for one in (lam - mu, mu)]
        self.forward = self._filled(table.own if bonds.plain else bonds.zeros(0))

    @property
    def kernels(self) -> Any:
        """That take these moduli on the processor."""
        bonds = self.bonds
        of = {"lattice": bonds.layout.in_rows, "fields": self.fields}
        return sweeps(bonds.scalar, bonds.dimension, **of)

    def bulk_at(self, nodes: np.ndarray) -> Any:
        """λ − μ of some nodes, or of all."""
        bulk = self.values[0] - self.values[1]
        return bulk if bulk.size == 1 else bulk[nodes]

    def _placed(self, values: np.ndarray) -> np.ndarray:
        """One value a place, of fields."""
        layout = self.bonds.layout
        if not self.fields:
            return values
        values = np.broadcast_to(values, self.bonds.nodes)
        if layout.images is None:
            return values
        plane, (places, owner) = np.zeros(layout.places), layout.images
        plane[places] = values[owner]
        return plane

    def _filled(self, far: wp.array[Any]) -> Any:
        bonds, table = self.bonds, self.table
        of = struct(bonds.scalar, bonds.dimension)
        return filled(of, *bonds.links, table.own, far, table.volumes, *self._moduli)

    @cached_property
    def back(self) -> Any:
        """Of the transpose."""
        return self.forward if self.bonds.lattice else self._filled(self.table.far)


def changes_sign(bonds: Bonds, model: LPSMaterial) -> bool:
    """Whether a bond has K W below zero."""
    return bool((bonds.influence(model.alpha, model.D) < 0).any())


def check_volumes(bonds: Bonds, model: LPSMaterial) -> None:
    """Refuse an influence function whose weighted volume vanishes: the operator divides by it.

    Raises InputError saying how many nodes that concerns; on a lattice it is all of them.
    """
    families = bonds.families
    terms = bonds.influence(model.alpha, model.D) * families.r**2
    needed = slice(None) if bonds.lattice else np.concatenate([families.whole, families.cut])
    m, size = (np.atleast_1d(volumes(bonds, x))[needed] for x in (terms, np.abs(terms)))
    bad = np.count_nonzero(~(np.abs(m) > CANCELLED * size))
    if bad:
        where = "every node" if bonds.lattice else f"{bad} nodes"
        raise InputError(
            f"influence function: its weighted volume m (theory, 5) is zero at {where}: "
            f"positive and negative parts cancel to {np.abs(m).min() / size.max():.0e}"
        )
