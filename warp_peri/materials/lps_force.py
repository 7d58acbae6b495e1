"""The LPS on points of any kind: its bonds, its force, all derivatives of it, and its matrices.

A lattice lies row by row in a box, many nodes at a time; other points as numbered, with lists of
bonds. L is its own transpose once each bond reads the stiffness of the bond back. Sums over nodes
run over fixed blocks, without atomics: threads change no bit. Nothing that a call writes is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy import ndarray
from numpy.linalg import inv
from numpy.typing import ArrayLike
from scipy.special import comb

from warp_peri import runtime
from warp_peri.core.stencil import numbers_at, row_pieces
from warp_peri.errors import InputError, Several
from warp_peri.kernels.bonds import stay
from warp_peri.kernels.influence import BLOCK, influence
from warp_peri.kernels.lps import LANES, Balls, Sums, by_influence, stiffnesses, struct, sweeps
from warp_peri.points.arguments import Pair
from warp_peri.points.families import DEGREE, families_of
from warp_peri.points.points import PointsLike, nearest, nodes_of
from warp_peri.runtime import DEVICE, SLICE, Shared, filled, floats, ints, launch_slices, zeros

if TYPE_CHECKING:
    from warp_peri.materials.lps import LPSMaterial

CANCELLED = 1e-10
"""A weighted volume below this fraction of the sum of its terms' sizes counts as zero."""
SPARE, SHORT = 2, 4
"""Largest box, in places a node, and least mean length of a piece, that are worth it."""
BLOCKS = 8
"""Parts in which nodes are summed over, whatever the number of threads."""
FASTER = 4
"""How much less a thread has to do with a node in rows than in its list of bonds."""


@dataclass(frozen=True)
class Layout:
    """Places and bonds in the order of kernels/lps.py.

    Attributes:
        balls: bonds of each place, of rows of all places together.
        end: places from one to the end of each bond, 0 of a broken one, [E], of rows [B].
        bond: vectors ξ [Å] and 1/r², shape [E] or [B] of d + 1.
        in_rows: whether all places share one family, and are laid out in planes.
        back: number of the bond back, or of itself where broken, [E]; of rows nothing.
        node: number of the node at each place, periodic images included, N where none, [P].
        home: place of every node, shape [N].
        pieces: by name, shape [·] of vectors: to be "laid" out, where dilatations are "needed", and
            "forces"; "back" and "nodes", the same of the transpose, of forces to all nodes;
            "whole", needed without images; none for None.
    """

    balls: Any
    end: wp.array[Any]
    bond: wp.array[Any]
    in_rows: bool
    back: ndarray
    node: ndarray
    home: ndarray
    pieces: dict[str | None, wp.array[Any]]


class Bonds:
    """Families of a point set in the layouts that sweeps read; InputError as of families_of.

    Args:
        points: a lattice, or scattered points (spacing 0). Bonds to nodes outside are broken, and
            the dilatation of nodes that had such bonds is corrected (theory, 40–41).
        horizon: δ [Å].
        bond_based: λ = μ, of which no dilatation is seen: a collar of δ is enough.
        quadrature_degree: of the polynomials that the weights are exact for.

    Attributes:
        nodes, dimension: number of the nodes N, and 2 or 3.
        ready: launches that nobody uses.
        kept: the last law, and the numbers that it is of.
    """

    def __init__(
        self,
        points: PointsLike,
        horizon: float,
        *,
        bond_based: bool = False,
        quadrature_degree: int = DEGREE,
    ) -> None:
        self.points, self.horizon, self.bond_based = nodes_of(points), float(horizon), bond_based
        self.nodes, self.dimension = points.x.shape
        self.families = families_of(
            points, horizon, bond_based=bond_based, degree=quadrature_degree
        )
        self.ready: dict[Any, list[Any]] = {}
        self.kept: tuple[Any, Law] | None = None

    @cached_property
    def listing(self) -> Several:
        """Owner, far end (negative: broken or nowhere), vector, and class index of each bond."""
        families, points, end = self.families, self.points, self.families.neighbour
        owner = np.repeat(np.arange(self.nodes), np.diff(families.row))
        if families.lattice is not None:
            kind = np.tile(families.lattice.bond_class, self.nodes)
            return owner, end, np.tile(families.pattern, (self.nodes, 1)), kind
        xi = points.x[np.where(end < 0, -1 - end, end)] - points.x[owner]
        return owner, end, nearest(xi, points.box), np.arange(len(end))

    @cached_property
    def layout(self) -> Layout:
        """Layout of the bonds, in rows where possible, else in lists."""
        return self._rows() or self._lists()

    def _lists(self) -> Layout:
        """Layout of nodes as they are numbered."""
        families, (owner, end, xi, kind) = self.families, self.listing
        nodes, needed = np.arange(self.nodes), np.append(families.whole, families.cut)
        places = {"needed": needed, "whole": needed, "forces": families.rows, "nodes": nodes}
        of = dict.fromkeys((None, "laid", "back"), nodes[:0])
        pieces = {n: _pieces(np.sort(at), np.arange(len(at)), 1) for n, at in (of | places).items()}
        back = families.reverse
        if families.lattice is not None:
            back = families.row[end] + np.tile(back, self.nodes)
        to, back = np.where(end < 0, 0, end - owner), np.where(end < 0, np.arange(len(end)), back)
        return self._laid(families.row, to, xi, kind, False, back, nodes, nodes, pieces)

    def _laid(self, row: ndarray, end: ndarray, xi: ndarray, kind: ndarray, *others: Any) -> Layout:
        """Layout of bonds of these classes, with its other members."""
        weight, r2 = self.families.weight[kind], (xi**2).sum(axis=1)
        of_bond = map(floats, (np.where(end == 0, 0.0, weight), weight * r2))
        balls = filled(Balls, ints(row), floats(self.lengths[2][kind], wp.int64), *of_bond)
        return Layout(balls, ints(end), _vectors(np.column_stack([xi, 1 / r2])), *others)

    def _rows(self) -> Layout | None:
        """Layout of a lattice in a box; None with broken bonds, or for a mostly empty box."""
        families, box = self.families, self.points.box
        if families.lattice is None or len(families.cut):
            return None
        grid, steps = self.points.lattice.steps, families.lattice.steps
        order = np.argsort(np.abs(grid[1:2] - grid[:1]).sum(axis=0), kind="stable")
        grid, steps = grid[:, order], steps[:, order]  # numbered last along the last axis
        grid, reach = grid - grid.min(axis=0), np.abs(steps).max()
        size, ring = grid.max(axis=0) + 1, reach
        if box is not None:
            size, ring = np.rint(np.divide(box, self.points.spacing))[order].astype(int), 2 * reach
            grid %= size
        if size.prod() > SPARE * self.nodes:
            return None
        inside = self.dimension * (slice(ring, -ring),)
        node = np.full(size + 2 * ring, self.nodes)
        node[inside][*grid.T] = np.arange(self.nodes)
        if box is not None:
            node = np.pad(node[inside], ring, mode="wrap")
        stride = np.append(np.cumprod(node.shape[:0:-1])[::-1], 1)
        room = reach * stride.sum() + LANES  # for bonds off the box, lanes beyond a piece
        home = room + (grid + ring) @ stride
        seen = np.zeros(node.shape, bool)  # near enough to have its family, of images too
        seen[self.dimension * (slice(reach, -reach),)] = True
        node, seen = (np.pad(x.ravel(), room, constant_values=v) for x, v in
                      ((node, self.nodes), (seen, False)))  # fmt: skip
        row, needed = (numbers_at(self.nodes + 1, of) for of in (families.rows, families.whole))
        laid, back = np.flatnonzero(node < self.nodes), np.flatnonzero(row[node] >= 0)
        of = {
            None: (laid[:0],),
            "laid": (laid, node[laid]),
            "needed": (np.flatnonzero((needed[node] >= 0) & seen),),
            "forces": (home[families.rows], np.arange(len(families.rows))),
            "back": (back, row[node[back]]),
            "nodes": (home, np.arange(self.nodes)),
            "whole": (home[families.whole],),
        }
        pieces = {name: _pieces(at[0], at[-1], LANES) for name, at in of.items()}
        if SHORT * len(pieces["nodes"]) > self.nodes:
            return None
        pairs = np.minimum(np.arange(len(steps)), families.reverse).argsort(kind="stable")
        of_bond = steps[pairs] @ stride, families.pattern[pairs], families.lattice.bond_class[pairs]
        return self._laid(np.array([0, len(steps)]), *of_bond, True, pairs[:0], node, home, pieces)

    @cached_property
    def lengths(self) -> Several:
        """Lengths r that K has a value of, their logarithms, and which of them each class has, [C]:
        of scattered points a bond has that of the bond back."""
        families, of = self.families, np.arange(len(self.families.r))
        back = of if families.lattice is not None else families.reverse
        first = of <= back
        r = families.r[first]
        return r, np.log(r), (np.cumsum(first) - 1)[np.minimum(of, back)]

    def influence(self, alpha: ArrayLike, D: ndarray, by: Any = None) -> Any:
        """Influence K of each length; with derivatives `by` to it, those to α and D."""
        terms, taped, (r, log_r, _) = np.size(D), by is not None, self.lengths
        count = -(-len(r) // BLOCK)
        pieces = max(1, min(BLOCKS, count * BLOCK // SLICE)) if taped else 1  # on any threads
        vector = wp.types.vector(terms, wp.float64)
        numbers = (np.ravel(alpha), wp.float64), ([D], vector)
        given: list[list[Any]] = [
            [wp.array(one, dtype=of, device=DEVICE, requires_grad=taped) for one, of in numbers]
            for _ in range(pieces)
        ]
        binomials = floats(comb(terms - 1, np.arange(terms))[None], vector)
        inputs = [wp.float64(self.horizon), binomials, floats(r), floats(log_r)]
        kernel, K = influence(terms), zeros(len(r))
        if not taped:
            launch_slices(kernel, count, [*inputs, *given[0], K], weight=BLOCK)
            return K.numpy()
        kernel.module.load(DEVICE)
        K.grad = floats(by)

        def back(n: int) -> None:
            first, last = (count * end // pieces for end in (n, n + 1))
            tape = wp.Tape()
            tape.record_launch(kernel, last - first, 0, [first, *inputs, *given[n]], [K], DEVICE)
            tape.backward()

        runtime.at_once([partial(back, n) for n in range(pieces)])
        return [sum(one.grad.numpy().ravel() for one in each) for each in zip(*given)]

    @cached_property
    def left(self) -> ndarray:
        """Indices of the unbroken bonds of nodes with broken ones."""
        if not len(cut := self.families.cut):
            return cut
        owner, end, _, _ = self.listing
        return np.flatnonzero((end >= 0) & np.isin(owner, cut))

    def inverted(self, kw: ndarray) -> Several:
        """K W and S⁻¹ ξ, (40–41), of the bonds `left`, and the indices of their owners in `cut`."""
        owner, _, xi, kind = (one[self.left] for one in self.listing)
        place, d, weight = np.searchsorted(self.families.cut, owner), self.dimension, kw[kind]
        shape = np.zeros((len(self.families.cut), d, d))
        np.add.at(shape, place, weight[:, None, None] * xi[:, :, None] * xi[:, None])
        return weight, np.einsum("eab,eb->ea", inv(shape)[place], xi), place

    def bent(self, kw: ndarray, own: ndarray) -> ndarray:
        """Factors of u(ξ) − u in θ, [E, d]: d K W/m ξ, or K W S⁻¹ ξ beside broken bonds (40–41)."""
        found: ndarray = self.dimension * own[:, None] * self.listing[2]
        if len(self.left):
            weight, turned, _ = self.inverted(kw)
            found[self.left] = weight[:, None] * turned
        return found

    def law(self, *values: Any) -> Law:
        """The Law on these bonds of given λ, μ, α and D; the last one is cached."""
        arrays = [np.array(value, float).ravel() for value in values]  # nobody changes copies
        key, last = [array.tobytes() for array in arrays], self.kept
        if not last or last[0] != key:
            known = last[1] if last and last[0][2:] == key[2:] else None
            last = self.kept = key, Law(self, arrays, known)
        return last[1]

    def check_volumes(self, alpha: float, D: ndarray) -> None:
        """Raise InputError for an influence function whose weighted volume vanishes."""
        families, balls = self.families, self.layout.balls
        terms = balls.square.numpy() * self.influence(alpha, D)[balls.length.numpy()]
        needed = ... if self.layout.in_rows else np.append(families.whole, families.cut)
        start = balls.row.numpy()[:-1]
        m, size = (np.add.reduceat(x, start)[needed] for x in (terms, np.abs(terms)))
        if bad := np.count_nonzero(~(np.abs(m) > CANCELLED * size)):
            where = f"{bad} nodes" if families.lattice is None else "every node"
            raise InputError(
                f"influence function: its weighted volume m (theory, 5) is zero at {where}: "
                f"positive and negative parts cancel to {np.abs(m).min() / size.max():.0e}"
            )


def _vectors(values: ndarray) -> wp.array[Any]:
    return floats(np.ascontiguousarray(values), wp.types.vector(values.shape[1], wp.float64))


def _pieces(places: ndarray, numbers: ndarray, lanes: int) -> wp.array[Any]:
    """Pieces of at most `lanes` lanes, in the order of their places, [P] of vectors."""
    order = np.argsort(places, kind="stable")
    return ints(row_pieces(places[order], lanes, numbers[order]), wp.vec3i)


def bonds_of(model: LPSMaterial, points: PointsLike, degree: int = DEGREE) -> Bonds:
    """The bonds of a model on points or their certified lattice; InputError as of Bonds."""
    make = partial(Bonds, model.certified_nodes(points), model.horizon, quadrature_degree=degree)
    try:
        bonds = make()
    except InputError:
        if not model.bond_based:
            raise
        bonds = make(bond_based=True)
    bonds.check_volumes(model.alpha, model.D)
    return bonds


class Law:
    """An LPS on bonds: its numbers as sweeps read them, and the sweeps.

    Fields are flat, [S, d N] of all nodes and [S, d I] of the interior, contiguous.

    Args:
        values: λ and μ of shape [1], or [N], one value a node; α [1] and D [M + 1].
        known: a Law of the same α and D.

    Attributes:
        K: influence of each length.
        m: weighted volume of each node, [N], of a lattice in rows one number, [1].
        own: K W/m of each bond of the layout, 0 of broken ones.

    Raises InputError for moduli of another shape, and λ ≠ μ on bonds that are bond-based.
    """

    def __init__(self, bonds: Bonds, values: list[ndarray], known: Law | None) -> None:
        self.bonds, self.values = bonds, values
        lam, mu, alpha, D = values
        for name, one in (("lambda", lam), ("mu", mu)):
            if one.size not in (1, bonds.nodes):
                raise InputError(
                    f"{name}: expected one number, or one of each of {bonds.nodes} nodes, got "
                    f"shape {list(one.shape)}"
                )
        if bonds.bond_based and (lam != mu).any():
            refuse_bond_based()
        self.bulk, self.fields, layout = lam - mu, max(lam.size, mu.size) > 1, bonds.layout
        if known is None:
            self.K = bonds.influence(alpha, D)
            self.own, self.m = np.empty(len(layout.end)), np.empty(len(layout.balls.row) - 1)
            found = map(floats, (self.K, self.own, self.m))
            launch_slices(stiffnesses, len(self.m), [layout.balls, *found])
        else:
            self.K, self.m, self.own = known.K, known.m, known.own
        self.kernels = sweeps(bonds.dimension, lattice=layout.in_rows, fields=self.fields)

    @cached_property
    def kw(self) -> ndarray:
        """K W of each bond class, [C]."""
        bonds = self.bonds
        return np.asarray(bonds.families.weight * self.K[bonds.lengths[2]])

    @cached_property
    def forward(self) -> Any:
        """Arrays that a sweep for L reads; of lists without the bonds back."""
        bonds, layout, moduli = self.bonds, self.bonds.layout, (self.bulk, self.values[1])
        if self.fields:  # one value a place
            every = (np.append(np.broadcast_to(one, bonds.nodes), 0.0) for one in moduli)
            moduli = tuple(one[layout.node] for one in every)
        d = bonds.dimension
        bent = bonds.bent(self.kw, self.own) if len(bonds.left) else np.empty((0, d))
        known = layout.balls.row, layout.end, layout.bond, *map(floats, (self.own, *moduli))
        return filled(struct(d), *known, _vectors(bent))

    @cached_property
    def back(self) -> Any:
        """Arrays that a sweep for Lᵗ reads; in rows the same as `forward`."""
        of, layout, Form = self.forward, self.bonds.layout, struct(self.bonds.dimension)
        if layout.in_rows:
            return of
        bent = -of.bent.numpy()[layout.back[: len(of.bent)]]
        known = [getattr(of, name) for name in Form.vars][:7]
        return filled(Form, *known, floats(self.own[layout.back]), _vectors(bent))

    def _sweep(self, of: Any, pieces: Sequence[str | None], *fields: ndarray) -> None:
        """Lay out values, find dilatations, then forces, on the named pieces (None: skip); fields
        are values by number, planes, dilatations and forces by number."""
        bonds, samples = self.bonds, len(fields[0])
        key = (*pieces, samples, runtime.get_num_threads(), self.fields)
        ready = bonds.ready.setdefault(key, [])
        try:
            shared, ends, last = ready.pop()
        except IndexError:
            known, last = [floats(one).__ctype__() for one in fields], of
            ends = [type(one).from_buffer_copy(one) for one in known]
            nodes = [bonds.layout.pieces[name] for name in pieces]
            work = sum(map(len, nodes)) * samples * max(1, self.kernels.lanes // FASTER)
            shared = Shared(self.kernels.swept, (*nodes, of, *4 * (None,)), work, stay)
            for place, end in enumerate(ends, 4):
                shared.give(place, end)
        if last is not of:
            shared.give(3, of)
        for end, one in zip(ends, fields):
            end.data = one.ctypes.data
        shared()
        ready.append((shared, ends, of))

    def force(self, u: ndarray) -> Several:
        """L u, and the laid-out displacement and dilatations, which a gradient reads."""
        bonds, size, places = self.bonds, len(u), len(self.bonds.layout.node)
        d = bonds.dimension
        Lu, theta = (np.zeros((size, n)) for n in (d * len(bonds.families.rows), places))
        planes = np.zeros((size, d * places)) if bonds.layout.in_rows else u
        self._sweep(self.forward, ("laid", "needed", "forces"), u, planes, theta, Lu)
        return Lu, planes, theta

    def transposed(self, g: ndarray, *, asked: bool = True) -> Several:
        """Lᵗ g on all nodes if asked, g laid out, and its dilatation by the transpose."""
        bonds, layout, size, d = self.bonds, self.bonds.layout, len(g), self.bonds.dimension
        seeds, tau = (np.zeros((size, n * len(layout.node))) for n in (d, 1))
        if not layout.in_rows:
            seeds.reshape(size, -1, d)[:, bonds.families.rows] = g.reshape(size, -1, d)
        by_u = np.zeros((size, d * bonds.nodes))
        self._sweep(self.back, ("back", "needed", "nodes" if asked else None), g, seeds, tau, by_u)
        return by_u, seeds, tau

    def gradient(self, felt: Sequence[ndarray], g: ndarray, asked: Sequence[bool]) -> list[Any]:
        """Derivatives of a scalar to u [S, d N], λ and μ, α and D, None where not asked, from
        planes and dilatations of `force` (`felt`) and the derivative g to L u."""
        bonds, layout, (lam, mu, alpha, D) = self.bonds, self.bonds.layout, self.values
        if bonds.bond_based and any(asked[1:3]):
            refuse_bond_based()
        by_u, *pull = self.transposed(g, asked=asked[0])
        if not any(asked[1:]):
            return [by_u, *4 * [None]]
        lanes, blocks = self.kernels.lanes, BLOCKS if layout.in_rows else 1
        by_own = np.zeros((blocks, lanes * len(layout.end)))
        shear, bulk = np.zeros((2, len(layout.node)))
        whole, sums = layout.pieces["whole"], map(floats, (*felt, *pull, by_own, shear, bulk))
        ends = ints(np.arange(BLOCKS + 1) * len(whole) // BLOCKS)
        inputs = ends, whole, self.back, filled(Sums, *sums)
        launch_slices(self.kernels.slopes, BLOCKS, inputs, weight=len(whole) * len(g) // BLOCKS)
        moduli = [
            part[layout.home] if one.size > 1 else part.sum()
            for part, one in ((bulk, lam), (shear - bulk, mu))
        ]
        if not any(asked[3:]):
            return [by_u, *moduli, None, None]
        if layout.in_rows:
            by_own = by_own.reshape(blocks, -1, lanes).sum(axis=(0, 2))
        by_K = self._by_length(by_own.ravel(), felt[0], pull[1])
        return [by_u, *moduli, *bonds.influence(alpha, D, by_K)]

    def _by_length(self, by: ndarray, u: ndarray, tau: ndarray) -> ndarray:
        """Derivatives by K of each length from those to `own` of each bond, [E], as if every
        dilatation were d own ξ·(u(ξ) − u). At nodes with broken bonds (40–41) a bond f adds p_f ·
        S⁻¹ ξ_f − (S⁻¹ ξ_f) · (Σ_e K W p_e ⊗ S⁻¹ ξ_e) ξ_f, p the derivative to K W S⁻¹ ξ."""
        bonds, d, lost = self.bonds, self.bonds.dimension, 0.0
        if len(bonds.left):
            owner, end, xi, kind = (one[bonds.left] for one in bonds.listing)
            weight, turned, place = bonds.inverted(self.kw)
            u = u.reshape(len(tau), -1, d)
            pull = np.broadcast_to(self.bulk, bonds.nodes)[owner] * tau[:, owner]
            p = (pull[:, :, None] * (u[:, end] - u[:, owner])).sum(axis=0)
            by[bonds.left] -= d * (xi * p).sum(axis=1)
            both = np.zeros((len(bonds.families.cut), d, d))
            np.add.at(both, place, weight[:, None, None] * p[:, :, None] * turned[:, None])
            lost = (p * turned).sum(axis=1) - np.einsum("ea,eab,eb->e", turned, both[place], xi)
            lost *= bonds.families.weight[kind]
        of = bonds.layout.balls
        launch_slices(by_influence, len(self.m), [of, *map(floats, (self.own, self.m, by))])
        by[bonds.left] += lost
        return np.bincount(of.length.numpy(), by)


def refuse_bond_based() -> None:
    """Raise InputError for λ ≠ μ, or a gradient to one of them, on bonds without dilatations."""
    raise InputError(
        "lambda, mu: expected equal values without a gradient on a collar of one horizon, which "
        "has no dilatations; take a collar of two, or requires_grad_(False) of a TorchModule"
    )


@dataclass(frozen=True)
class Matrices:
    """Sparse matrices of an LPS on N nodes, I interior; component a of node i is d i + a.

    Attributes:
        gamma: Γ, forces on the interior nodes from displacements [Å⁻²], shape [d I, d N]; of a
            field μ μ Γ, the mean of both ends in each bond.
        phi: Φ, dilatations at all nodes from displacements [Å⁻¹], shape [N, d N]; zero rows where
            no force needs them.
        psi: Ψ, Σ_j (d/m) K ξ (θ_i + θ_j) W on the interior nodes [Å⁻¹], shape [d I, N].
    """

    gamma: sp.csr_array
    phi: sp.csr_array
    psi: sp.csr_array

    def within(self, interior: ndarray) -> Pair:
        """Γ and Φ between interior nodes alone, dense, [d I, d I] and [I, d I]."""
        unknown = np.repeat(interior, self.gamma.shape[1] // len(interior))
        return self.gamma[:, unknown].toarray(), self.phi[interior][:, unknown].toarray()

    def operator(self, lam: Any, mu: Any) -> sp.csr_array:
        """Assemble L [TPa/Å²], shape [d I, d N]."""
        if np.ndim(lam - mu):
            return sp.csr_array(self.gamma - self.psi @ (sp.diags_array(lam - mu) @ self.phi))
        return sp.csr_array(mu * self.gamma - (lam - mu) * (self.psi @ self.phi))


def assemble(bonds: Bonds, kw: ndarray, m: Any, mu: Any = 1.0) -> Matrices:
    """Assemble Γ, Φ and Ψ from K W by class, weighted volumes (of nodes or one), and a field μ."""
    families, nodes, d = bonds.families, bonds.nodes, bonds.dimension
    owner, end, xi, kind = bonds.listing
    own = kw[kind] / np.broadcast_to(m, nodes)[owner]
    needed = np.isin(owner, np.concatenate([families.whole, families.cut]))
    some = np.flatnonzero((end >= 0) & needed)
    push, bent = d * own[some, None] * xi[some], bonds.bent(kw, own)[some]
    owner, end, xi, one = owner[some], end[some], xi[some], np.ones((len(some), 1))
    shear = 2 * (d + 2) / (xi**2).sum(axis=1)
    shear = shear * (mu[owner] + mu[end]) / 2 if np.ndim(mu) else shear

    def at(where: ndarray, values: ndarray) -> sp.csr_array:
        """Map fields of c components to values · field at a node of each bond, [E, c N]."""
        c = values.shape[1]
        columns = c * where[:, None] + np.arange(c)
        entries = values.ravel(), columns.ravel(), c * np.arange(len(some) + 1)
        return sp.csr_array(entries, shape=(len(some), c * nodes))

    interior = (d * families.rows[:, None] + np.arange(d)).ravel()
    force, along = sp.csr_array(at(owner, push).T)[interior], at(end, xi) - at(owner, xi)
    return Matrices(
        sp.csr_array(force @ (sp.diags_array(-shear) @ along)),
        sp.csr_array(at(owner, one).T @ (at(end, bent) - at(owner, bent))),
        sp.csr_array(force @ (at(owner, one) + at(end, one))),
    )
