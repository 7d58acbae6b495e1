"""Positive bases, and forces of dressed bodies layer by layer (theory, Dr1–Dr4)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
import scipy.sparse as sp
from scipy.ndimage import maximum_filter

from warp_peri.core.elastic import PAIRS, named_symmetry, voigt
from warp_peri.core.grid import Grid
from warp_peri.core.sweeps import SCALARS, PlaneRows, convolved, entries, inverse
from warp_peri.damage.solid import CrystalBonds
from warp_peri.errors import InputError
from warp_peri.kernels.dressed.bonds import bonds as bond_kernels
from warp_peri.kernels.dressed.elements import element_planes
from warp_peri.launch import floats, ints, launch_slices, threads
from warp_peri.points.families import bond_classes

KINDS = ("elements", "bonds")
EQUAL = 1e-6
"""Eigenvalues of an elastic tensor within this of one another, of the largest, are one part."""
NOTHING = 1e-14
"""Relative, of entries that are rounding."""
AXIS_WEIGHT, DIAGONAL_WEIGHT = 1 / 8, 1 / 16
"""w of the bonds (1, 0) and (1, 1): K(r) = 1/r with Σ w r² = 1 and equal moduli every way."""


@dataclass(frozen=True, eq=False)
class Base:
    """K = Σ over sites of Bᵗ (Σ_a m_a M_a) B / h², every M_a ⪰ 0: K ⪰ 0 for all m_a ≥ 0.

    One site a node x: its strains are B · u(x + corners)/h.

    Attributes:
        kind: "elements" or "bonds".
        corners: in spacings, shape [P, d].
        strains: B, shape [S, P, d]; one whose nodes are not all there is left out.
        parts: M_a, shape [A, S, S].
        moduli: m_a [stress] of the even solid, shape [A].
        names: of the parts, as "bulk" and "shear".
        middle: how much each corner says of a site's own modulus, shape [P].
    """

    kind: str
    corners: np.ndarray
    strains: np.ndarray
    parts: np.ndarray
    moduli: np.ndarray
    names: tuple[str, ...]
    middle: np.ndarray

    @cached_property
    def touched(self) -> np.ndarray:
        """Which corners a strain is made of, shape [S, P] bool."""
        return np.asarray(np.abs(self.strains).max(axis=2) > NOTHING)

    @cached_property
    def matrices(self) -> np.ndarray:
        """Bᵗ M_a B of a whole site, shape [A, P, d, P, d]."""
        B = self.strains
        return np.asarray(np.einsum("spi,ast,tqj->apiqj", B, self.parts, B, optimize=True))

    @cached_property
    def stencils(self) -> np.ndarray:
        """K_a h² of the even solid, F(ξ) with (K u)(x) = Σ F(ξ) u(x + ξ), [A, (2r + 1)^d, d, d]."""
        d = self.corners.shape[1]
        step = self.corners[None] - self.corners[:, None]
        reach = int(np.abs(step).max())
        found = np.zeros((len(self.moduli), *[2 * reach + 1] * d, d, d))
        for p, q in itertools.product(range(len(self.corners)), repeat=2):
            found[(slice(None), *(step[p, q] + reach))] += self.matrices[:, p, :, q]
        return np.asarray(found * self.moduli.reshape(-1, *[1] * (d + 2)))


def base(kind: str, tensor: np.ndarray, dilatation: float = AXIS_WEIGHT) -> Base:
    """The base of a name for an elastic tensor [stress] along the nodes' axes, [d, d, d, d].

    "elements": squares or cubes of multilinear displacement, any tensor; their parts are what the
    tensor's eigenstrains store (Dr2). "bonds", which may break: a linear peridynamic solid with
    K(r) = 1/r on eight bonds in the plane, isotropic (Dr3); of a crystal bonds up to three spacings
    and a dilatation (Dr28). `dilatation` is the weight in θ of its
    bonds along the axes; 1/8 is that of 1/r, another a second influence function (Dr26).

    Raises InputError for another name, a tensor that is not stable, and one that a base cannot
    have.
    """
    if kind not in KINDS:
        raise InputError(f"base: expected one of {', '.join(KINDS)}, got {kind!r:.50}")
    if kind == "elements":
        if dilatation != AXIS_WEIGHT:
            raise InputError("dilatation: expected a base of bonds, got elements")
        return _elements(tensor)
    found = bonds(tensor, dilatation)
    reach = np.inf if dilatation == AXIS_WEIGHT else dilatation_range(tensor)
    if not abs(dilatation - AXIS_WEIGHT) <= reach:
        raise InputError(
            f"dilatation: expected a weight within {reach:.3g} of {AXIS_WEIGHT}, beyond which a "
            f"broken body may be unstable, got {dilatation:g}"
        )
    return found


def _elements(tensor: np.ndarray) -> Base:
    d = tensor.shape[0]
    moduli, shapes, names = _eigenstrains(tensor)
    corner = np.array(list(itertools.product((0, 1), repeat=d)))
    side = 2 * corner - 1
    strains, count = [], 2**d
    for point in itertools.product((-(3**-0.5), 3**-0.5), repeat=d):
        factor = (1 + side * point) / 2
        slope = [side[:, a] * np.prod(np.delete(factor, a, axis=1), axis=1) for a in range(d)]
        for i, j in PAIRS[d]:
            strain = np.zeros((count, d))
            strain[:, i] += slope[j] * (1.0 if i == j else 0.5**0.5)
            if i != j:
                strain[:, j] += slope[i] * 0.5**0.5
            strains.append(strain)
    parts = [np.kron(np.eye(count), shape) / count for shape in shapes]
    middle = np.full(count, 1 / count)
    return Base("elements", corner, np.array(strains), np.array(parts), moduli, names, middle)


def gauss_shapes(at: np.ndarray) -> np.ndarray:
    """N_g: what a strain of an element is at positions in it, [n, d] from 0 to 1, of those at its
    Gauss points: exact, for strains are multilinear. [n, 2^d]."""
    d = at.shape[1]
    points = np.array(list(itertools.product((-(3**0.5), 3**0.5), repeat=d)))
    return np.asarray(np.prod(1 + points * (2 * at[:, None] - 1), axis=2) / 2**d)


def _eigenstrains(tensor: np.ndarray) -> tuple[np.ndarray, list[np.ndarray], tuple[str, ...]]:
    """C = Σ_a m_a P_a with projections P_a, in the order 11, 22, …, √2·12, and their names."""
    d = tensor.shape[0]
    scale = np.where(np.arange(len(PAIRS[d])) < d, 1.0, 2**0.5)
    value, vector = np.linalg.eigh(voigt(tensor) * np.outer(scale, scale))
    if not value[0] > 0:
        raise InputError(f"moduli: expected a stable crystal, got an eigenvalue of {value[0]:.3g}")
    groups = np.split(np.arange(len(value)), np.flatnonzero(np.diff(value) > EQUAL * value[-1]) + 1)
    moduli, shapes, names = [], [], []
    for n, group in enumerate(groups):
        shape = vector[:, group] @ vector[:, group].T
        moduli.append(value[group].mean())
        shapes.append(shape)
        even = np.where(np.arange(len(value)) < d, d**-0.5, 0.0)
        if len(group) == 1 and np.abs(shape - np.outer(even, even)).max() < EQUAL:
            names.append("bulk")
        elif np.abs(shape @ even).max() > EQUAL:
            names.append(f"mixed {n + 1}")
        else:
            names.append("tetragonal" if np.abs(shape[d:, d:]).max() < EQUAL else "shear")
    if len(set(names)) < len(names):
        names = [f"{name} {n + 1}" for n, name in enumerate(names)]
    return np.array(moduli), shapes, tuple(names)


def dilatation_range(tensor: np.ndarray) -> float:
    """How far the weight of Dr26 may be from 1/8: M = 1 + 64 (p − 1/8)² ≤ 2 μ/(μ − λ)."""
    C = voigt(tensor)
    lam, shear = C[0, 1], C[2, 2]
    return float(np.sqrt((lam + shear) / (shear - lam)) / 8) if lam < shear else np.inf


CRYSTAL_REACH = 3.0
"""Of the bonds of a crystal, in spacings."""


def crystal_bonds(tensor: np.ndarray) -> Base:
    """Bonds and a dilatation that have a tensor together (Dr28); InputError for one they cannot."""
    d = tensor.shape[0]
    classes = bond_classes(1.0, CRYSTAL_REACH, dimension=d)
    stiffness, share, excess = CrystalBonds(voigt(tensor), CRYSTAL_REACH).bonds(classes)
    order = np.lexsort(classes.steps.T[::-1])  # a half of them, then the opposite ones
    r, steps = np.linalg.norm(classes.steps, axis=1)[order], classes.steps[order]
    strains = np.zeros((len(r), 1 + len(r), d))
    for j, direction in enumerate(steps / r[:, None]):
        strains[j, 0], strains[j, j + 1] = -direction, direction
    a, c = share[order] * r, stiffness[order] * r**2
    felt = c > NOTHING * c.max()
    soft = float(np.sum(a[felt] ** 2 / c[felt]))
    shear = float(np.trace(voigt(tensor)[d:, d:])) / (d * (d - 1) / 2)
    theta = np.outer(a, a)
    parts = np.array([theta, (np.diag(c) - theta / soft) / shear])
    corner = np.vstack([np.zeros((1, d), int), steps])
    moduli = np.array([excess + 1 / soft, shear])
    return Base("bonds", corner, strains, parts, moduli, ("bulk", "shear"), np.eye(1 + len(r))[0])


def bonds(tensor: np.ndarray, dilatation: float = AXIS_WEIGHT) -> Base:
    """Eight bonds of an isotropic sheet, those of a crystal of any other tensor.

    The first modulus is negative beyond dilatation_range.
    """
    if tensor.shape[0] != 2 or named_symmetry(tensor) != "isotropic":
        if dilatation != AXIS_WEIGHT:
            raise InputError("dilatation: expected an isotropic sheet, got a crystal")
        return crystal_bonds(tensor)
    C = voigt(tensor)
    shear, bulk = C[2, 2], (C[0, 0] + C[0, 1]) / 2
    corner = np.array([(0, 0), *(v for v in np.ndindex(3, 3) if v != (1, 1))])
    corner[1:] -= 1
    length = np.linalg.norm(corner[1:], axis=1)
    w = np.where(length == 1, AXIS_WEIGHT, DIAGONAL_WEIGHT)
    strains = np.zeros((8, 9, 2))
    for j, direction in enumerate(corner[1:] / length[:, None]):
        strains[j, 0], strains[j, j + 1] = -direction, direction
    across = AXIS_WEIGHT - dilatation / 2
    p = np.where(length == 1, dilatation, across)
    theta = np.outer(2 * p * length, 2 * p * length)
    M = float((p**2 * length**2 / w).sum())
    parts = np.array([theta, 8 * np.diag(w) - 2 / M * theta])
    moduli = np.array([bulk - 2 * shear * (1 - 1 / M), shear])
    names = ("bulk" if dilatation == AXIS_WEIGHT else "dilatation", "shear")
    return Base("bonds", corner, strains, parts, moduli, names, np.eye(9)[0])


def composed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The stencil of one convolution after another, both of shape [(2r + 1)^d, d, d]."""
    d = first.shape[-1]
    out = np.zeros((*(a + b - 1 for a, b in zip(first.shape[:d], second.shape[:d])), d, d))
    for at in np.ndindex(*first.shape[:d]):
        if first[at].any():
            part = tuple(slice(a, a + n) for a, n in zip(at, second.shape[:d]))
            out[part] += first[at] @ second
    return out


def spread(steps: np.ndarray, tensors: np.ndarray) -> np.ndarray:
    """u(x) − Σ C(ξ)(u(x) − u(x + ξ)) as a stencil, of one half [H, d], [H, d, d]."""
    d, reach = steps.shape[1], int(np.abs(steps).max())
    found = np.zeros((*[2 * reach + 1] * d, d, d))
    for sign in (1, -1):
        for step, C in zip(sign * steps, tensors):
            found[tuple(step + reach)] += C
    found[(reach,) * d] = np.eye(d) - 2 * tensors.sum(axis=0)
    return found


def half(stencil: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps [H, d] and C(ξ) = −F(ξ) [H, d, d] of one half of a stencil, without empty ones."""
    d = stencil.shape[-1]
    reach = stencil.shape[0] // 2
    steps = np.array(list(np.ndindex(*stencil.shape[:d]))) - reach
    tensors = -stencil.reshape(-1, d, d)
    side = steps @ stencil.shape[0] ** np.arange(d)[::-1] > 0
    kept = side & (np.abs(tensors).max(axis=(1, 2)) > NOTHING * np.abs(tensors).max())
    return steps[kept], (tensors[kept] + tensors[kept].transpose(0, 2, 1)) / 2


class ByLayers(PlaneRows):
    """L u of an even solid of one G in three sweeps, each over as many places as the next reads.

    Args:
        nodes: the box, laid out for the reach of L.
        steps, tensors: of one half of G, [H, d] and [H, d, d].
        base: of the law, K.
        spacing: h.
        dtype: float64 or float32.
    """

    def __init__(
        self,
        nodes: Grid,
        steps: np.ndarray,
        tensors: np.ndarray,
        base: Base,
        spacing: float,
        dtype: Any = np.float64,
    ) -> None:
        super().__init__(nodes.wide, dtype)
        self.nodes = nodes
        mask = np.zeros(nodes.wide, bool)
        mask[nodes.core] = nodes.unknown
        along, K = half(base.stencils.sum(axis=0))
        outer = 1, steps, tensors
        self.stages: list[tuple[Any, ...]] = []
        reach, ends = 0, []
        for dressed, steps_, C in (outer, (0, along, K / spacing**2), outer):
            pieces = self.pieces(maximum_filter(mask, 2 * reach + 1))
            self.stages.insert(0, (pieces, dressed, *self.table(steps_, C)))
            reach += int(np.abs(steps_).max())
            ends.append(int(pieces.numpy()[-1, 0] + (steps_ @ self.strides).max()))
        self.beyond = max(ends) + self.kernels.lanes > self.places

    def __call__(self, planes: np.ndarray) -> np.ndarray:
        """L u at the unknown nodes of planes [S, d, *wide]; planes [S, d, *shape], else zero."""
        nodes, d = self.nodes, self.nodes.dimension
        count, size = len(planes), d * self.places
        first, second = (self.buffer(n, count, size) for n in range(2))
        field = np.ascontiguousarray(planes, self.dtype).reshape(count, -1)
        if self.beyond:  # lanes of the last piece would read past the end
            field = self.buffer(2, count, size)
            field[:] = planes.reshape(count, -1)
        out = np.zeros((count, size), self.dtype)
        ways = ((field, first), (first, second), (second, out))
        for (pieces, *inputs), (given, found) in zip(self.stages, ways):
            self.launch(self.kernels.pulled, pieces, tuple(inputs), given, found)
        force = out.reshape(count, d, *nodes.wide)
        return force[(slice(None), slice(None), *nodes.core)] if nodes.periodic else force


class Chain(NamedTuple):
    """One G of a body and its K: what goes by rows, and what by sparse matrices, [d N, d N].

    Attributes:
        tensors: G of each grain, [g, H, d, d].
        rows, columns: G and Gᵗ where a row is not that of a whole lattice, else empty.
        tables, shares: of elements, as PeriodicElements has them, over h²; none of bonds.
        factors: of bonds, c and q over h² at the sites that are whole, [2, N]; None of elements.
        sites: K of all other sites.
    """

    tensors: np.ndarray
    rows: sp.csr_array
    columns: sp.csr_array
    tables: np.ndarray
    shares: np.ndarray
    factors: np.ndarray | None
    sites: sp.csr_array


class BodyLayers(PlaneRows):
    """L u of all nodes of a body that ends, varies or is broken: by rows of the whole lattice, and
    a short list of rows and sites that are not whole.

    Args:
        body: dressed.
        dtype: float64 or float32.
    """

    def __init__(self, body: Any, dtype: Any = np.float64) -> None:
        base, steps, d = body.model.parts, body.model.steps, len(body.sides)
        self.reach = r = int(np.abs(np.concatenate([steps, base.corners])).max())
        super().__init__([n + 2 * r for n in body.sides], dtype)
        self.periodic = body.points.box is not None
        place = np.ravel_multi_index(tuple((body.grid + r).T), self.wide)
        self.at = (self.places * np.arange(d) + place[:, None]).ravel()
        self.core: Any = (..., *(slice(r, n + r) for n in body.sides))

        def pieces(nodes: np.ndarray) -> Any:
            mask = np.zeros(self.places, bool)
            mask[place[nodes]] = True
            return self.pieces(mask)

        self.stages = []
        for chain in body.chains:
            ways = []
            for odd in (chain.rows, chain.columns):
                plain = np.diff(odd.indptr)[::d] == 0
                each = [
                    (pieces(plain & (body.grain == g)), 1, *self.table(steps, C))
                    for g, C in enumerate(chain.tensors)
                ]
                ways.append((each, self._some(odd)))
            middle: Any = None
            if len(chain.tables):
                middle = PeriodicElements(chain.tables, chain.shares, self.dtype)
            elif chain.factors is not None:
                along, table = bond_table(base)[:2]
                flat = np.zeros((2, self.places))
                flat[:, place] = chain.factors
                self._close(flat)
                inputs = ints(along @ self.strides), self.floats(table)
                every = pieces(np.ones(len(place), bool))
                middle = every, (*inputs, self.floats(flat, spare=True))
            self.stages.append((ways[0], middle, self._some(chain.sites), ways[1]))

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u of fields along the nodes' axes, [S, d N]."""
        count, size = len(u), len(self.wide) * self.places
        given, first, second, last = (self.buffer(n, count, size) for n in range(4))
        given[:, self.at] = u
        total = np.zeros(u.shape, self.dtype)
        for G, middle, sites, Gt in self.stages:
            self._dressed(G, given, first)
            self._based(middle, first, second)
            self._add(sites, first, second)
            self._dressed(Gt, second, last)
            total += last[:, self.at]
        return total

    def _dressed(self, way: Any, given: np.ndarray, found: np.ndarray) -> None:
        whole, (odd, matrix) = way
        self._close(given)
        for pieces, *inputs in whole:
            self.launch(self.kernels.pulled, pieces, tuple(inputs), given, found)
        found[:, odd] = 0
        self._add((odd, matrix), given, found)

    def _based(self, middle: Any, given: np.ndarray, found: np.ndarray) -> None:
        if middle is None:
            found[:] = 0
            return
        if isinstance(middle, PeriodicElements):
            fields = (one.reshape(len(one), -1, *self.wide)[self.core] for one in (given, found))
            for one, out in zip(*fields):
                out[:] = middle(one)
            return
        self._close(given)
        pieces, inputs = middle
        kernels, pulls = bond_kernels(self.scalar), self.buffer(4, len(given), self.places)
        self.launch(kernels.stressed, pieces, inputs, given, pulls)
        self._close(pulls)
        inputs = *inputs, floats(pulls, self.scalar)
        self.launch(kernels.gathered, pieces, inputs, given, found)

    def _add(self, some: tuple[np.ndarray, Any], given: np.ndarray, to: np.ndarray) -> None:
        odd, matrix = some
        for one, out in zip(given, to if len(odd) else ()):
            out[odd] += matrix @ one

    def _some(self, matrix: sp.csr_array) -> tuple[np.ndarray, sp.csr_array]:
        """Rows of a matrix over nodes that are not empty: their places in planes, and they."""
        odd = np.flatnonzero(np.diff(matrix.indptr))
        kept, shape = matrix[odd], (len(odd), len(self.wide) * self.places)
        parts = kept.data.astype(self.dtype), self.at[kept.indices], kept.indptr
        return self.at[odd], sp.csr_array(parts, shape=shape)

    def _close(self, field: np.ndarray) -> None:
        """Fill the images of a period."""
        planes, r = field.reshape(-1, *self.wide), self.reach
        for axis in range(1, planes.ndim if self.periodic else 1):
            line = np.moveaxis(planes, axis, 0)
            line[:r], line[-r:] = line[-2 * r : -r], line[r : 2 * r]


def bond_table(base: Base) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of bonds that vary (Dr25): steps of one half, [H, 2]; a d and the upper triangle of w d ⊗ d,
    [H, 5]; and the matrix that leads from factors of the parts to κ − 2 μ and 8 μ, [2, 2]."""
    bulk, shear = base.moduli
    theta, rest = base.parts
    apart = ~np.eye(len(theta), dtype=bool)
    share = -(rest[apart] @ theta[apart]) / (theta[apart] @ theta[apart])  # 2/M of (Dr26)
    a = theta[np.argmax(np.diag(theta))] / np.sqrt(np.diag(theta).max())
    w = np.diag(rest + share * theta) / 8
    half = slice(len(a) // 2, None)  # the others are opposite
    d = base.strains[np.arange(len(a)), 1 + np.arange(len(a))][half]
    square = entries(w[half, None, None] * d[:, :, None] * d[:, None])
    table = np.concatenate([a[half, None] * d, square], axis=1)
    return base.corners[1:][half], table, np.array([[bulk, -share * shear], [0, 8 * shear]])


PLANE_WORK = 10
"""Of an element in `PeriodicElements`, that of a usual node being 1."""


class PeriodicElements:
    """K of multilinear elements that fill a period, h = 1, and the inverse of an even K (Dr27).

    Args:
        tables: moduli of P phases as matrices, [P, m, m]: Voigt's of elastic solids, with one
            component of displacement an axis; conductivities, m = d, with one component.
        shares: how much of each phase an element has, [P, *sides].
        dtype: float64 or float32.
    """

    def __init__(self, tables: np.ndarray, shares: np.ndarray, dtype: Any = np.float64) -> None:
        self.sides, of = shares.shape[1:], SCALARS[np.dtype(dtype)]
        d, rows = len(self.sides), len(tables[0])
        scalar = rows == d
        self.pairs = tuple((0, j) for j in range(d)) if scalar else PAIRS[d]
        self.components = 1 if scalar else d
        self.tables, self.shares = tables, shares
        upper = list(itertools.combinations_with_replacement(range(rows), 2))
        used = [(i, j) for i, j in upper if i == j or j < d]  # of crystals along the axes
        apart = [abs(tables[:, i, j]).max() for i, j in upper if (i, j) not in used]
        if max(apart, default=0.0) > NOTHING * np.abs(tables).max():
            used = upper
        self._kernel = element_planes(of, d, self.pairs, tuple(used))
        self._wide = tuple(n + 1 for n in self.sides)
        self._places = int(np.prod(self._wide))
        spare = self._kernel.lanes
        first, second = np.array(used).T
        moduli = np.ascontiguousarray(tables[:, first, second], dtype)
        if len(tables) > len(used):  # as many maps as a modulus has entries do
            shares, moduli = np.tensordot(moduli.T, shares, 1), np.eye(len(used), dtype=dtype)
        factors = np.zeros((len(shares), self._places + spare), dtype)
        inner = factors[:, : self._places].reshape(-1, *self._wide)
        inner[(slice(None), *(slice(n) for n in self.sides))] = shares
        size = (1, self.components * self._places + spare)
        self._given, self._found = np.zeros(size, dtype), np.zeros(size, dtype)
        self._arrays = tuple(floats(one, of) for one in (moduli, factors, self._given))
        self._out = floats(self._found, of)

    def affine(self, load: int) -> np.ndarray:
        """Displacement of the mean strain of a row of Voigt's matrix, [c, *sides + 1]."""
        i, j = self.pairs[load]
        x = np.indices(self._wide).astype(float)
        u = np.zeros((self.components, *self._wide))
        u[i] += x[j]
        if self.components > 1 and i != j:
            u[i], u[j] = x[j] / 2, x[i] / 2
        return u

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """K u of a field [c, *sides], or of one that need not be periodic [c, *sides + 1]."""
        fields = (self.components, *self._wide)
        wide, force = (
            one[0, : self.components * self._places].reshape(fields)
            for one in (self._given, self._found)
        )
        core = (slice(None), *(slice(n) for n in self.sides))
        if u.shape == fields:
            wide[:] = u
        else:
            wide[core] = u
            for axis in range(1, wide.ndim):
                np.moveaxis(wide, axis, 0)[-1] = np.moveaxis(wide, axis, 0)[0]
        force[:] = 0
        plane, row = (int(np.prod(self._wide[n:])) for n in (1, 2))
        count = plane - row if len(self.sides) == 3 else self.sides[1]
        for begin in (0, 1):  # planes beside one another add to the same nodes
            launch_slices(
                self._kernel.swept,
                (self.sides[0] + 1 - begin) // 2,
                (begin, plane, row, self._places, count, *self._arrays),
                (self._out,),
                samples=1,
                weight=PLANE_WORK * count,
            )
        for axis in range(1, force.ndim):
            np.moveaxis(force, axis, 0)[0] += np.moveaxis(force, axis, 0)[-1]
        return np.array(force[core])

    @cached_property
    def mean(self) -> np.ndarray:
        """The mean of all moduli, [m, m]."""
        shares = self.shares.reshape(len(self.shares), -1).mean(axis=1)
        return np.asarray(np.tensordot(shares, self.tables, 1))

    @cached_property
    def _inverse(self) -> np.ndarray:
        """K⁻¹ of the mean solid at the waves of the period, packed as torus_symbol packs D."""
        even = PeriodicElements(self.mean[None], np.ones((1, *self.sides)))
        c, axes = self.components, tuple(range(len(self.sides)))
        symbol = np.empty((c * (c + 1) // 2, *self.sides[:-1], self.sides[-1] // 2 + 1))
        for j in range(c):
            pulse = np.zeros((c, *self.sides))
            pulse[(j, *(0,) * len(self.sides))] = 1
            for i, one in enumerate(even(pulse)[: j + 1]):  # the kernel is even: the wave is real
                place = i * c - i * (i - 1) // 2 + j - i
                symbol[place] = scipy.fft.rfftn(one, axes=axes, workers=threads()).real
        if c == 1:
            symbol[(0, *(0,) * len(self.sides))] = np.inf
            return 1 / symbol
        return inverse(symbol)

    def evened(self, force: np.ndarray) -> np.ndarray:
        """K⁻¹ of the mean solid of a force [c, *sides], of zero mean."""
        return convolved(self._inverse, force, self.sides)

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Mean strain of each element, shears twice, of a field [c, *sides], [m, *sides]."""

        def mean(field: np.ndarray, axis: int) -> np.ndarray:
            for other in range(field.ndim):
                ahead = np.roll(field, -1, axis=other)
                field = ahead - field if other == axis else (ahead + field) / 2
            return field

        both = self.components > 1
        return np.array(
            [mean(u[i], j) + (mean(u[j], i) if both and i != j else 0) for i, j in self.pairs]
        )

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """Of strains [m, *sides], elements' means both."""
        return np.asarray(
            sum(share * np.tensordot(C, strain, 1) for C, share in zip(self.tables, self.shares))
        )
