"""The bonds of a point set on a device, and the launches of L u on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from scipy.special import comb

from warp_peri.errors import InputError
from warp_peri.kernels.bonds import bonds
from warp_peri.kernels.lps import adjoint as lps_adjoint
from warp_peri.kernels.lps import force as lps
from warp_peri.kernels.lps import influence as influence_kernels
from warp_peri.kernels.lps.tables import tables
from warp_peri.launch import (
    DEVICE,
    empty,
    filled,
    floats,
    ints,
    known_device,
    launch,
    launch_slices,
    recorded,
    threads,
    zeros,
)
from warp_peri.lps.model import CANCELLED, Model, Solid
from warp_peri.lps.rows import BLOCKS, Forward, Rows, lent, rows_of
from warp_peri.points.families import Families, families_of
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike


@dataclass(frozen=True)
class Blocks:
    """The BLOCKS parts of the nodes with complete families, one after another.

    Attributes:
        ends: first node of each block, and the end of the last, shape [BLOCKS + 1].
        bonds: first bond of each and the end, on scattered points.
        spans: what the kernel reads of each: the bond that its sums begin with, and its nodes.
    """

    ends: list[int]
    bonds: list[tuple[int, int]]
    spans: wp.array[Any]


def blocks_of(families: Families, full: np.ndarray, device: str) -> Blocks:
    """Those of the nodes `full`; the sums of a lattice lie in one array, block after block."""
    ends = [len(full) * n // BLOCKS for n in range(BLOCKS + 1)]
    if families.lattice is not None:
        bounds = [-len(families.pattern) * n for n in range(BLOCKS + 1)]
    else:
        bounds = [int(families.row[full[min(end, len(full) - 1)]]) for end in ends]
        bounds[-1] = int(families.row[-1])
    table = np.stack([bounds[:-1], ends[:-1], ends[1:]], axis=1).astype(np.int32)
    spans: Any = wp.array(table, dtype=wp.vec3i, device=device)
    return Blocks(ends, list(pairwise(bounds)), spans)


LIGHT = 8
"""How much less than a usual node a bond has to do for its K, for the number of threads."""
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
        scalar, vec, mat: types of numbers, vectors and matrices in this precision.
        arrays: what leads every kernel from a node to its bonds, see kernels/bonds.py.
        rows: interior nodes, where forces are evaluated, shape [I].
        full: nodes within δ of them, where dilatations are needed; `cut` are those of them with
            broken bonds, `whole` the others.
        r, weight: length [Å] and quadrature weight [Å^d] of each bond class, shape [C].
        reverse: number of the bond from j back to i; not read on lattices, shape [E].
        kept: tables of the last evaluation, by the α and D that they are of.

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
        self.scalar = PRECISIONS[precision]
        self.device = known_device(device)
        self.dimension = points.x.shape[1]
        types = bonds(self.scalar, self.dimension)
        self.vec, self.mat = types.vec, types.mat
        self.families = families = families_of(
            points, horizon, bond_based=bond_based, degree=quadrature_degree
        )
        self.horizon, self.bond_based = float(horizon), bond_based
        self.rows, self.whole = self.ints(families.rows), self.ints(families.whole)
        self.cut = self.ints(families.cut)
        self.full = self.ints(np.sort(np.concatenate([families.whole, families.cut])))
        self.r, self.weight = self.floats(families.r), self.floats(families.weight)
        self.reverse = self.ints(families.reverse)
        self.arrays = self._arrays(types, points.x, points.box)
        self._places = (np.array(points.x) if self.lattice else points.x, points.box)
        self.kept: dict[tuple[bytes, bytes], tuple[wp.array[Any], wp.array[Any]]] = {}
        self._prepared: list[Prepared] = []

    def _arrays(self, types: Any, x: np.ndarray, box: tuple[float, ...] | None) -> Any:
        """The kernels' struct; of what only the other kind of point set has, one idle entry."""
        families, lattice, d = self.families, self.families.lattice, self.dimension
        bond_class = np.zeros(1) if lattice is None else lattice.bond_class
        pattern = np.ones((1, d)) if lattice is None else families.pattern
        inverse_square = 1 / (pattern**2).sum(axis=1, keepdims=True)
        periods = 2 * d * (0.0,) if box is None else (*box, *(1 / side for side in box))
        arrays = types.BondArrays()
        arrays.lattice = int(self.lattice)
        arrays.row, arrays.neighbour = self.ints(families.row), self.ints(families.neighbour)
        arrays.bond_class = self.ints(bond_class)
        arrays.pattern = floats(np.hstack([pattern, inverse_square]), types.bond, self.device)
        arrays.x = floats(x if lattice is None else np.zeros((1, d)), self.vec, self.device)
        arrays.box = types.box(*(self.scalar(value) for value in periods))
        return arrays

    @property
    def lattice(self) -> bool:
        """Whether the points are a lattice, whose nodes share one pattern of bonds."""
        return self.families.lattice is not None

    @property
    def nodes(self) -> int:
        """Number of nodes N."""
        return len(self.families.row) - 1

    @cached_property
    def laid_out(self) -> Rows | None:
        """A square lattice without broken bonds as rows of a rectangle, for the processor's sweeps
        that take many nodes at a time; None for what else there is.
        """
        if not self.lattice or self.dimension != 2 or self.device != DEVICE:
            return None
        return rows_of(self.families, *self._places, self.scalar)

    @cached_property
    def log_r(self) -> wp.array[Any]:
        """ln r of each bond class, shape [C]."""
        return self.floats(np.log(self.families.r))

    @cached_property
    def pairs(self) -> np.ndarray:
        """Numbers of one bond of each pair ±ξ of a lattice's pattern, shape [H]."""
        reverse = self.families.reverse
        return np.flatnonzero(np.arange(len(self.families.pattern)) < reverse)

    @cached_property
    def blocks(self) -> Blocks:
        """Parts of the nodes `full` in which gradients are summed."""
        return blocks_of(self.families, self.full.numpy(), self.device)

    def floats(self, values: np.ndarray) -> wp.array[Any]:
        """A Warp array in this precision, where the bonds are."""
        return floats(values, self.scalar, self.device)

    def ints(self, values: np.ndarray) -> wp.array[Any]:
        """A Warp array of int32, where the bonds are."""
        return ints(values, self.device)

    def zeros(self, *shape: int, dtype: Any = None, gradient: bool = False) -> wp.array[Any]:
        """A Warp array of zeros, where the bonds are."""
        dtype = dtype or self.scalar
        return zeros(*shape, dtype=dtype, gradient=gradient, device=self.device)

    def forget(self) -> None:
        """Drop what was kept of the last model, so that the next evaluation computes it anew."""
        self.kept.clear()
        for prepared in self._prepared:
            prepared.forget()

    def force(self, u: Any, values: Sequence[Any], Lu: Any) -> None:
        """L u of tensors [..., N, d] and [..., I, d], on a lattice laid out in rows."""
        numbers = [
            one.detach().numpy().reshape(-1) if hasattr(one, "detach") else np.ravel(one)
            for one in values
        ]
        samples = u.numel() // (self.nodes * self.dimension)
        fits = samples, len(numbers[3]) - 1, threads()
        with lent(self._prepared, fits, lambda: Prepared(self, fits)) as prepared:
            prepared(u.data_ptr(), numbers, Lu.data_ptr())


@dataclass(frozen=True)
class Evaluation:
    """L u and what led to it, in the precision of the bonds.

    Attributes:
        kw, m: K W of each bond class [C] and weighted volume of each node [N], or of all nodes of a
            lattice [1].
        theta: dilatation of each sample and node, shape [S, N], or [S, 0] where nobody
            asked for it.
        Lu: L u on the interior nodes, shape [S, I] of vectors.
    """

    kw: wp.array[Any]
    m: wp.array[Any]
    theta: wp.array[Any]
    Lu: wp.array[Any]


@cache
def _binomials(degree: int) -> np.ndarray:
    """Of the Bernstein polynomials; SciPy takes longer than a sweep over a thousand nodes."""
    coefficients: np.ndarray = comb(degree, np.arange(degree + 1))
    return coefficients


def influence_inputs(bonds: Bonds, degree: int) -> tuple[Any, ...]:
    """What the influence kernels of a degree read before α and D."""
    binomial = bonds.floats(_binomials(degree))
    return (bonds.scalar(bonds.horizon), binomial, bonds.r, bonds.weight)


def powers(bonds: Bonds, alpha: wp.array[Any], D: wp.array[Any]) -> Any:
    """What the kernels read that take many bonds at a time."""
    struct = influence_kernels.by_lanes(len(D) - 1, bonds.scalar).Powers
    return filled(struct, *influence_inputs(bonds, len(D) - 1), bonds.log_r, alpha, D)


def influence(
    bonds: Bonds, alpha: wp.array[Any], D: wp.array[Any], *, gradient: bool = False
) -> tuple[wp.array[Any], wp.array[Any]]:
    """K W of each class, shape [C], and weighted volumes m; kept while only u changes.

    m has shape [N], 0 where not needed; on a lattice shape [1], the same for all nodes.
    """
    degree = len(D) - 1
    key = (alpha.numpy().tobytes(), D.numpy().tobytes())
    if not gradient and (known := bonds.kept.get(key)):
        return known
    kw = bonds.zeros(len(bonds.r), gradient=gradient)
    m = bonds.zeros(1 if bonds.lattice else bonds.nodes, gradient=gradient)
    if gradient or bonds.lattice or bonds.device != DEVICE or len(kw) < influence_kernels.BYTES:
        kernel = influence_kernels.influence(degree, bonds.scalar)
        _launch(gradient, kernel, len(kw), (*influence_inputs(bonds, degree), alpha, D), kw)
    else:
        lanes = influence_kernels.by_lanes(degree, bonds.scalar)
        chunks, inputs = -(-len(kw) // lanes.size), (powers(bonds, alpha, D),)
        launch_slices(lanes.values, chunks, inputs, (kw,), weight=lanes.size // LIGHT)
    count = 1 if bonds.lattice else len(bonds.full)
    kernel = lps.sweeps(bonds.scalar, bonds.dimension).weighted_volume
    _launch(gradient, kernel, count, (bonds.full, bonds.arrays, bonds.r, kw), m)
    if not gradient:
        bonds.kept = {key: (kw, m)}
    return kw, m


def check_volumes(bonds: Bonds, model: Model) -> None:
    """Refuse an influence function whose weighted volume vanishes: the operator divides by it.

    Raises InputError saying how many nodes that concerns; on a lattice it is all of them.
    """
    families = bonds.families
    kw, _ = influence(bonds, bonds.floats(np.array([model.alpha])), bonds.floats(model.D))
    terms = kw.numpy() * families.r**2
    if families.lattice is not None:
        terms = (families.lattice.count * terms)[None]
        m, size = terms.sum(axis=1), np.abs(terms).sum(axis=1)
    else:
        m = np.add.reduceat(terms, families.row[:-1])[bonds.full.numpy()]
        size = np.add.reduceat(np.abs(terms), families.row[:-1])[bonds.full.numpy()]
    bad = np.count_nonzero(~(np.abs(m) > CANCELLED * size))
    if bad:
        where = "every node" if bonds.lattice else f"{bad} nodes"
        raise InputError(
            f"influence function: its weighted volume m (theory, 5) is zero at {where}: "
            f"positive and negative parts cancel to {np.abs(m).min() / size.max():.0e}"
        )


def surface_shape(bonds: Bonds, kw: wp.array[Any], *, gradient: bool = False) -> wp.array[Any]:
    """S of the nodes with broken bonds, (40), shape [N]."""
    shape = bonds.zeros(bonds.nodes, dtype=bonds.mat, gradient=gradient)
    kernel = lps.sweeps(bonds.scalar, bonds.dimension).surface_shape
    _launch(gradient, kernel, len(bonds.cut), (bonds.cut, bonds.arrays, kw), shape)
    return shape


def evaluate(
    bonds: Bonds,
    u: wp.array[Any],
    lam: wp.array[Any],
    mu: wp.array[Any],
    alpha: wp.array[Any],
    D: wp.array[Any],
    *,
    gradient: bool = False,
    dilatation: bool = True,
) -> Evaluation:
    """L u [TPa/Å] and all that led to it; with `gradient` for the active tape, in one thread.

    Args:
        bonds: of a point set with N nodes.
        u: displacement [Å], shape [S, N] of vectors.
        lam, mu: Lamé parameters [TPa], shape [1] each, equal for bond-based bonds.
        alpha: exponent, shape [1].
        D: Bernstein coefficients, shape [M + 1].
        gradient: whether to record derivatives.
        dilatation: whether θ is wanted by node, and not only for the force.
    """
    samples, kernels, arrays = u.shape[0], lps.sweeps(bonds.scalar, bonds.dimension), bonds.arrays
    kw, m = influence(bonds, alpha, D, gradient=gradient)
    Lu = _forces(bonds, samples, gradient=gradient)
    if bonds.laid_out is not None and not gradient:
        theta = bonds.zeros(samples, bonds.nodes if dilatation else 0)
        law = filled(lps_adjoint.structs(bonds.scalar, bonds.dimension).Law, kw, m, lam, mu)
        _by_rows(bonds, bonds.laid_out, law, u, Lu, theta if dilatation else None)
        return Evaluation(kw, m, theta, Lu)
    theta = bonds.zeros(samples, bonds.nodes, gradient=gradient)
    inputs: Any = (bonds.whole, arrays, kw, m, u)
    _launch(gradient, kernels.dilatation, len(bonds.whole), inputs, theta, samples)
    if len(bonds.cut):
        shape = surface_shape(bonds, kw, gradient=gradient)
        inputs = (bonds.cut, arrays, kw, shape, u)
        _launch(gradient, kernels.surface_dilatation, len(bonds.cut), inputs, theta, samples)
    inputs = (bonds.rows, arrays, kw, m, lam, mu, u, theta)
    _launch(gradient, kernels.force, len(bonds.rows), inputs, Lu, samples)
    return Evaluation(kw, m, theta, Lu)


def _forces(bonds: Bonds, samples: int, *, gradient: bool) -> wp.array[Any]:
    """Memory for L u; that of a gradient begins with zeros."""
    if gradient:
        return bonds.zeros(samples, len(bonds.rows), dtype=bonds.vec, gradient=True)
    return empty(samples, len(bonds.rows), dtype=bonds.vec, device=bonds.device)


def _by_rows(
    bonds: Bonds, rows: Rows, law: Any, u: wp.array[Any], Lu: wp.array[Any], theta: Any
) -> None:
    """Dilatation and force on a lattice laid out in rows; θ by node where an array is given."""
    fits = len(u), threads()
    with lent(rows.ready, fits, lambda: Forward(rows, bonds.arrays, len(u))) as forward:
        forward(law, u, Lu)
        if theta is not None:
            rows.take_up(forward.dilatation, theta)


def _launch(
    tape: bool,
    kernel: Any,
    count: int,
    inputs: tuple[Any, ...],
    output: wp.array[Any],
    samples: int = 0,
) -> None:
    if tape:
        launch(kernel, (samples, count) if samples else count, (0, *inputs), (output,))
    else:
        launch_slices(kernel, count, inputs, (output,), samples=samples)


class Prepared:
    """The force of a lattice laid out in rows, of which all but fields and numbers is packed once.

    Args:
        bonds: of the lattice.
        fits: samples, degree of the influence function, and threads.

    Call it with the addresses of u, [S, N] vectors, and of memory for L u, [S, I], and λ, μ, α, D.
    K and the weighted volume are computed anew where α or a coefficient has changed.
    """

    def __init__(self, bonds: Bonds, fits: tuple[int, int, int]) -> None:
        samples, degree, _ = self.fits = fits
        lam, mu, alpha, D = arrays = [bonds.zeros(size) for size in (1, 1, 1, degree + 1)]
        self._numbers, self._key = [array.numpy() for array in arrays], b""
        kw, m = bonds.zeros(len(bonds.r)), bonds.zeros(1)
        given = (*influence_inputs(bonds, degree), alpha, D)
        self._held = arrays, kw, m, given  # of which the launches know addresses
        kernel = influence_kernels.influence(degree, bonds.scalar)
        volume = lps.sweeps(bonds.scalar, bonds.dimension).weighted_volume
        of = bonds.full, bonds.arrays, bonds.r, kw
        self._volumes = [
            recorded(kernel, len(bonds.r), (0, *given), (kw,)),
            recorded(volume, 1, (0, *of), (m,)),
        ]
        law = lps_adjoint.structs(bonds.scalar, bonds.dimension).Law
        forward = Forward(bonds.laid_out, bonds.arrays, samples)  # type: ignore[arg-type]
        self.size, self._launch = forward.size, forward.launch
        self._launch.give(6, filled(law, kw, m, lam, mu))
        sizes = bonds.nodes, len(bonds.rows)
        self._ends = [empty(samples, size, dtype=bonds.vec).__ctype__() for size in sizes]
        for place, end in zip((7, 10), self._ends):
            self._launch.give(place, end)

    def __call__(self, u: int, numbers: Sequence[np.ndarray], Lu: int) -> None:
        for kept, value in zip(self._numbers, numbers, strict=True):
            kept[:] = value
        key = b"".join(kept.tobytes() for kept in self._numbers[2:])
        if key != self._key:
            for launch in self._volumes:
                launch.launch()
            self._key = key
        self._ends[0].data, self._ends[1].data = u, Lu
        self._launch()

    def forget(self) -> None:
        """Compute K the next time."""
        self._key = b""


class Tabulated:
    """The force as tables of its bonds.

    Args:
        bonds: of any point set, on the processor.

    Call it with u, shape [S, N] of vectors, and a solid of plain numbers: returns L u, shape [S, I]
    of vectors. The tables are made anew whenever α or a coefficient differs from those they were
    made for; λ and μ are no part of them. They take 8 (d + 1) bytes a bond in double precision.
    """

    def __init__(self, bonds: Bonds) -> None:
        self.bonds, self.kernels = bonds, tables(bonds.scalar, bonds.dimension)
        self._made_for: tuple[bytes, ...] | None = None
        self._table: Any = None
        self._surface: tuple[wp.array[Any], wp.array[Any]] | None = None

    def __call__(self, u: wp.array[Any], solid: Solid) -> wp.array[Any]:
        bonds, samples = self.bonds, len(u)
        lam, mu, alpha, D = (
            bonds.floats(np.atleast_1d(np.asarray(value, float))) for value in solid.values()
        )
        key = alpha.numpy().tobytes(), D.numpy().tobytes()
        if key != self._made_for:
            self._make(alpha, D)
            self._made_for = key
        theta = bonds.zeros(samples, bonds.nodes)
        self._launch(self.kernels.dilatation, bonds.whole, (u,), theta)
        if self._surface is not None:
            kernel = lps.sweeps(bonds.scalar, bonds.dimension).surface_dilatation
            inputs = (bonds.cut, bonds.arrays, *self._surface, u)
            launch_slices(kernel, len(bonds.cut), inputs, (theta,), samples=samples)
        Lu = empty(samples, len(bonds.rows), dtype=bonds.vec, device=bonds.device)
        self._launch(self.kernels.force, bonds.rows, (lam, mu, u, theta), Lu)
        return Lu

    def _launch(
        self, kernel: Any, nodes: wp.array[Any], inputs: tuple[Any, ...], output: wp.array[Any]
    ) -> None:
        inputs = (nodes, self._table, *inputs)
        launch_slices(kernel, len(nodes), inputs, (output,), samples=len(output))

    def _make(self, alpha: wp.array[Any], D: wp.array[Any]) -> None:
        bonds, families = self.bonds, self.bonds.families
        kw, m = influence(bonds, alpha, D)
        bonds.forget()  # what the tables are made of is not read again
        table = self.kernels.Table()
        broken = families.neighbour < 0
        table.row, table.ends = bonds.arrays.row, bonds.arrays.neighbour
        if broken.any():
            owner = np.repeat(np.arange(bonds.nodes), np.diff(families.row))
            table.ends = bonds.ints(np.where(broken, owner, families.neighbour))
        edges = len(families.neighbour)
        table.vectors, table.numbers = bonds.zeros(edges, dtype=bonds.vec), bonds.zeros(edges)
        inputs = (bonds.full, bonds.arrays, kw, m)
        outputs = (table.vectors, table.numbers)
        launch_slices(self.kernels.filled, len(bonds.full), inputs, outputs)
        self._table = table
        self._surface = (kw, surface_shape(bonds, kw)) if len(bonds.cut) else None
