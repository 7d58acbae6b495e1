"""The bonds of the linear solid in one precision, and what its numbers make of them."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import ArrayLike
from scipy.special import comb

from warp_peri.errors import InputError
from warp_peri.kernels.lps.influence import influence
from warp_peri.kernels.lps.sweeps import struct, sweeps
from warp_peri.launch import DEVICE, empty, filled, floats, ints, known_device, launch_slices, zeros
from warp_peri.lps.model import CANCELLED, Model
from warp_peri.lps.rows import Layout, listed, lists_of, rows_of
from warp_peri.points.families import families_of
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of

PRECISIONS = {"float64": wp.float64, "float32": wp.float32}


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


def check_volumes(bonds: Bonds, model: Model) -> None:
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
