"""Linear bodies at rest on many ranks, on a lattice in tiles and on scattered points.

Of scattered points the system is Tᵗ L T u = Tᵗ b (theory, M7). A rank assembles the rows of its
own nodes, from all nodes that these feel; conjugate gradients are preconditioned by the inverse of
the diagonal, which is right for short waves, and by multigrid on a coarse lattice for
long ones (R4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from warp_peri.core.grid import Grid, complete, refuse_cut
from warp_peri.core.stencil import q1_tensors
from warp_peri.core.sweeps import SCALARS, torus_symbol
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import agreed
from warp_peri.kernels.micromodulus.rows import rows as row_kernels
from warp_peri.launch import shared_by
from warp_peri.lps.model import Model
from warp_peri.micromodulus.law import StencilMaterial, tensors_of
from warp_peri.points.arrays import checked
from warp_peri.points.interpolation import FINER, NEIGHBOURS
from warp_peri.points.points import Points
from warp_peri.points.unit_names import check_same
from warp_peri.ranks.halo import Halo, NodeHalo
from warp_peri.ranks.multigrid import LONG, Between, Convolution, cycle, inverse_filter
from warp_peri.ranks.petsc import PetscCycle
from warp_peri.ranks.processes import build, in_turn, inner
from warp_peri.statics.conjugate_gradients import Inner, SolveRecord, definite
from warp_peri.statics.multigrid import coarser
from warp_peri.statics.scattered import ThroughLattice
from warp_peri.transfer.cache import carried, model_at

if TYPE_CHECKING:
    from warp_peri.ranks.subdomain import Subdomain
    from warp_peri.statics.linear import Inverse


GRAINS, LOST = "grains", 1e-4
"""Name of the numbers of grains beside maps; of a load, what may act on nodes without stiffness."""
MOST = 32
"""Solids whose tensors, proofs and filters are remembered, by what their files would hold."""


class RowOperator:
    """L of a lattice in tiles, and what inverts it nearly.

    Args:
        law: certified on the lattice.
        piece: the nodes of this rank, in tiles.
        petsc: whether its coarse problem is PETSc's.

    Raises InputError for a law without a proof, and interior nodes near the edge of the box.
    """

    method = "multigrid"

    def __init__(self, law: StencilMaterial, piece: Subdomain, petsc: bool = False) -> None:
        if piece.tiles is None:
            raise InputError("points: expected a lattice in tiles for a body at rest on ranks")
        comm, tiles, d = piece.comm, piece.tiles, piece.dimension
        self.model, self.points, self.dimension = law, piece, d
        self._tiles, self._box, self.petsc = tiles, tiles.box(comm.rank), petsc
        place = np.ravel_multi_index(tuple((piece.grid - tiles.corner(comm.rank)).T), self._box)
        self._grid = Grid(
            np.eye(d), self._box, 0, False, np.arange(len(place)), place, place[piece.interior]
        )
        self.mask = self._grid.mask()
        with agreed(comm):
            check_same(law.units, piece.units)
            if self.proven is None:
                raise InputError("material: expected one that is proven stable on the lattice")
        self.stencil = stencil = law.stencil
        self._check_whole()
        build(comm, row_kernels(SCALARS[np.dtype(np.float64)], d).pulled)
        tensors = stencil.tensors * stencil.spacing**2
        scale = stencil.spacing**-2
        self._L = Convolution(
            comm,
            tiles,
            stencil.reach,
            lambda torus: scale * torus_symbol(torus, stencil.steps, tensors),
        )

    @cached_property
    def _near(self) -> tuple[Convolution, Between, Any]:
        """What nearly inverts L, which waves do not need: a filter for short waves, and multigrid
        on every second node."""
        law, comm, tiles, d = self.model, self.points.comm, self._tiles, self.dimension
        scale = self.stencil.spacing**-2
        width, symbol = _filter(law)
        short = Convolution(comm, tiles, width, lambda torus: symbol(torus) / scale, np.float32)
        between = Between(comm, tiles)
        near = q1_tensors(law.tensor() * 2.0 ** (d - 2) * scale)
        made = PetscCycle if self.petsc else cycle
        return short, between, made(comm, *near, coarser(self.mask), between.coarse)

    def _check_whole(self) -> None:
        """InputError where nodes are missing within the law's reach of an unknown one."""
        grid, comm, steps = self._grid, self.points.comm, self.stencil.steps
        there = np.zeros((1, *self._box), np.int8)
        there.flat[grid.place] = 1
        body = Halo(comm, self._tiles.everywhere(), self.stencil.reach)(there)[0] > 0
        cut = self.mask & ~complete(body, steps, self.stencil.reach)
        lacking, count = np.sum(comm.allgather((int(cut.sum()), len(grid.interior))), axis=0)
        width = self.stencil.spacing * np.linalg.norm(steps, axis=1).max()
        refuse_cut(lacking, count, f"; give a collar {width:g} wide")

    @property
    def proven(self) -> str | None:
        """What is proven of the law, in one sentence."""
        proof = self.model.certificate
        if proof is None or not proof.holds:
            return None
        return f"one stable answer: D(k) ≥ {proof.proven:.3g} s(k) for all k"

    def product(self, field: np.ndarray) -> np.ndarray:
        """L of planes, at the unknown nodes."""
        pulled = self._L(field)
        pulled *= self.mask
        return pulled

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        field = self._grid.scatter(np.asarray(u)[None])[0]
        return np.asarray(self._grid.gather(self.product(field)[None])[0])

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on this rank's interior, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of a load on this rank's interior [i, d], to a relative residual, for `predict`."""
        return lambda right, tolerance: self.inverted(right, tolerance)[0]

    def nearly_inverse(self, r: np.ndarray) -> np.ndarray:
        """z ≈ L⁻¹ r: multigrid while the nodes for the filter are on their way, then the filter."""
        short, between, coarse = self._near
        short.start(r)
        long = coarse(between.restrict(r) * coarse.mask)
        z: np.ndarray = between.prolong(long, self._box)
        z *= LONG  # in place: here a rank has most in memory
        z += short.finish()
        z *= self.mask
        return z

    def inner(self) -> Inner:
        """Scalar products and largest values over all ranks; sums of the rows of each tile, then
        of all of them."""
        parts = self._tiles.parts(self._box)
        columns = [(slice(None), *p[1:]) for p in parts if p[0].start == 0]

        def along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            sums = []
            for part in columns:
                rows = (f[:, *part].reshape(*f.shape[:2], -1) for f in (a, b))
                sums.append(np.einsum("arn,arn->ar", *rows).ravel())
            return np.concatenate(sums)

        return inner(self.points.comm, along)

    def inverted(self, right: np.ndarray, tolerance: float) -> tuple[np.ndarray, SolveRecord]:
        """L⁻¹ of a load on this rank's interior, both [i, d]."""
        _ = self._near  # made before the search has its fields
        planes = self._grid.scatter_interior(right)
        found, record = definite(
            self.product, self.nearly_inverse, planes, tolerance, inner=self.inner()
        )
        return self._grid.gather(found[None])[0], record


@lru_cache(MOST)
def _filter(law: StencilMaterial) -> tuple[int, Callable[[tuple[int, ...]], np.ndarray]]:
    stencil = law.stencil
    return inverse_filter(stencil.steps, stencil.tensors * stencil.spacing**2, law.tensor())


_proven: dict[tuple[str, float], StencilMaterial] = {}


def tensors_at(linear: Any, piece: Subdomain) -> StencilMaterial:
    """A linear solid as one stencil on a piece's lattice, a Model proven there by all ranks.

    A Model is transferred as `model_at` does. Raises InputError as that, and for others as their
    `fitting` does.
    """
    if not isinstance(linear, Model):
        x, inside = one_node(piece.dimension, piece.spacing, linear.horizon)
        with agreed(piece.comm):
            linear.fitting(Points(x, inside, piece.spacing, units=piece.units, axis=piece.axis))
        return linear  # type: ignore[no-any-return]
    if not linear.is_certified_on(piece.spacing):
        linear = in_turn(piece.comm, lambda: model_at(linear, piece.spacing))
    return proven_at(linear, piece)


def proven_at(linear: Any, piece: Subdomain) -> StencilMaterial:
    """A linear solid as one stencil on a piece's lattice, with its own numbers and their proof."""
    known = str(linear.content()["sha256"]), piece.spacing
    if known not in _proven:
        if len(_proven) == MOST:
            del _proven[next(iter(_proven))]
        with shared_by(piece.comm):
            is_lps = isinstance(linear, Model)
            _proven[known] = tensors_of(linear, piece.spacing) if is_lps else linear.certified()
    return _proven[known]


def one_node(dimension: int, spacing: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """A cube of nodes to a distance around one that is unknown: positions and which it is."""
    steps = int(np.ceil(reach / spacing))
    grid = np.argwhere(np.ones((2 * steps + 1,) * dimension)) - steps
    return spacing * grid, np.asarray((grid == 0).all(axis=1))


def among(operator: Callable[[np.ndarray], np.ndarray], piece: Subdomain) -> Any:
    """An operator on fields of a piece as one of fields [i, d] of its interior."""

    def product(v: np.ndarray) -> np.ndarray:
        alone = np.zeros_like(piece.x)
        alone[piece.interior] = v
        return operator(alone)

    return product


class Felt:
    """A law on all nodes that this rank feels, of which its own unknown ones are unknown.

    Args:
        piece: the nodes of this rank.
        reach: how far a node feels [length].
        place: makes the law on Points; what it keeps in files is made by one rank.
    """

    def __init__(self, piece: Subdomain, reach: float, place: Callable[[Points], Any]) -> None:
        self.points, self.halo = piece, NodeHalo(piece, reach)
        x, inside = self.halo.x, np.zeros(len(self.halo.x), bool)
        inside[self.halo.own] = piece.interior
        self.asked = bool(inside.any())
        if not self.asked:  # the law needs an unknown node: one of a body of its own, at rest
            x, inside = one_node(piece.dimension, piece.spacing, reach)
        self._rest = np.zeros_like(x)
        here = Points(x, inside, piece.spacing, units=piece.units, axis=piece.axis)
        self.placed = in_turn(piece.comm, lambda: place(here))

    def around(self, u: np.ndarray) -> np.ndarray:
        """u [n, d] on all nodes that this rank feels."""
        field = self.halo.felt(u)
        return field if self.asked else self._rest

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on this rank's interior, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]


class RowDressed(Felt):
    """L of a dressed solid that ends, varies or is broken, on a lattice in parts, and its inverse.

    A rank has all that decides which rows of its nodes are whole, and no sum depends on its box.

    Args:
        solid: of the lattice's spacing.
        piece: the nodes of this rank, some of some rank held.
        uneven: edges, maps, broken, grains of the solid's `on`; maps and numbers of grains of this
            rank's nodes, pairs by numbers of the whole body, whichever rank names them.

    Raises InputError as `on` does, and for axes that are not those of the coordinates.
    """

    method = "cg"
    proven = "one answer; L = Gᵗ K G ⪰ 0 whatever is uneven, missing or broken"

    def __init__(self, solid: Any, piece: Subdomain, uneven: dict[str, Any]) -> None:
        comm, grains, edges = piece.comm, uneven.get("grains"), uneven.get("edges", False)
        laws, number = grains if isinstance(grains, tuple) and len(grains) == 2 else ((), grains)
        nodal = dict(uneven.get("maps") or {}) | ({} if grains is None else {GRAINS: number})
        with agreed(comm):
            size = (len(piece.x),)
            nodal = {name: checked(name, nodal[name], float, size) for name in sorted(nodal)}
            torn = uneven.get("broken")
            torn = checked("broken", np.zeros((0, 2)) if torn is None else torn, float, ("n", 2))
            if not np.isin(torn, np.arange(piece.count)).all():
                raise InputError("broken: expected pairs of numbers of nodes of the whole body")
        said = list(nodal), len(laws), bool(edges)
        told = comm.allgather((said, not piece.interior.all()))
        if any(one != said for one, _ in told) or not any(held for _, held in told):
            raise InputError("solve: expected maps and grains by rank alike, and some nodes held")
        torn = np.concatenate(comm.allgather(torn)).astype(int)
        reach = 2 * (np.abs(solid.steps).max(initial=1) + solid.parts.stencils.shape[1] // 2) + 1
        super().__init__(piece, reach * piece.spacing, lambda here: here)
        here, known = self.placed, self.halo.number
        own = {name: self.halo.around(values) for name, values in nodal.items()}
        kinds = None if grains is None else (laws, own.pop(GRAINS))
        torn = np.searchsorted(known, torn[np.isin(torn, known).all(axis=1)])

        def place() -> Any:
            if not self.asked:
                return None
            body = solid.on(here, edges=edges, maps=own, broken=torn, grains=kinds)
            if not np.array_equal(body.axes, np.eye(piece.dimension)):
                raise InputError("points: expected a lattice along the axes on ranks")
            body.lists = True
            body(self._rest)  # one compiles
            return body

        self.placed = in_turn(comm, place)
        stiffness = self.placed.stiffness[self.halo.own] if self.asked else 0 * piece.x
        free = piece.interior & stiffness.any(axis=1)
        self.points, self._loose = replace(piece, interior=free), piece.interior & ~free
        self._free, found = free[piece.interior], stiffness[free]
        self._diagonal = np.where(found > 0, found, 1.0)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes that something belongs to, [i, d], of u [n, d]."""
        around = self.around(u)
        return np.asarray(self.placed(around)[self._free] if self.asked else around[:0])

    def load(self, b: np.ndarray) -> np.ndarray:
        """b there; InputError for a load where nothing is."""
        sizes = [np.abs(part).max(initial=0.0) for part in (b[..., self._loose, :], b)]
        lost, most = np.max(self.points.comm.allgather(sizes), axis=0)
        if lost > LOST * most:
            raise InputError("b: expected no load on nodes that nothing belongs to")
        return super().load(b)

    def inverted(self, right: np.ndarray, tolerance: float) -> tuple[np.ndarray, SolveRecord]:
        """L⁻¹ of a load there, both [i, d]; InputError for a body that falls apart."""
        product, where = among(self, self.points), " of a body that falls apart, or nearly,"
        how: dict[str, Any] = {"inner": self.points.inner, "where": where}
        return definite(product, lambda r: r / self._diagonal, right, tolerance, **how)


TOUCH = 2.0 * np.sqrt(NEIGHBOURS / np.pi)
"""Mean spacings within which a place of the lattice finds the nodes that it is interpolated from,
and more."""
INSIDE = 0.5
"""Share of a coarse node's neighbourhood that is unknown where it is."""
SHARPER = 0.1
"""Of a residual that is asked for as on a lattice: of the same one more is left of long waves."""
LONG_SHARE = 2.0
"""Share of the long waves' answer beside the diagonal's, on scattered points."""


class ScatteredOperator:
    """A = Tᵗ L T of scattered nodes, and what inverts it nearly.

    Args:
        model: a linear solid, certified on some lattice.
        piece: the nodes of this rank, of scattered points.
        petsc: whether its coarse problem is PETSc's.
        like: another model's on the same piece; this one is then taken as it is.

    Raises InputError as ThroughLattice does.
    """

    method = "multigrid"

    def __init__(
        self,
        model: Model,
        piece: Subdomain,
        petsc: bool = False,
        like: ScatteredOperator | None = None,
    ) -> None:
        comm, carrier = piece.comm, piece.carrier
        self.points, self.petsc = piece, petsc
        felt = FINER * carrier * TOUCH
        stencil = carrier * np.ceil(2 * model.horizon / carrier)
        halo: NodeHalo = like.halo if like else NodeHalo(piece, 2 * felt + 2 * stencil)
        self.halo: NodeHalo = halo
        inside = np.zeros(len(halo.x), bool)
        inside[halo.own] = piece.interior
        self.through: ThroughLattice | None = None  # where no node is unknown
        self.model = model if like else in_turn(comm, lambda: carried(model, carrier))
        with agreed(comm):
            if inside.any():
                here = Points(halo.x, inside, 0.0, units=piece.units, axis=piece.axis)
                T = like.through if like else None
                self.through = ThroughLattice(self.model, here, spacing=carrier, carrier=T)
        self._diagonal = np.zeros((0, 2))
        if self.through is not None:
            A = self.through.problem.stiffness
            self._diagonal = A.diagonal().reshape(-1, 2)
        self._long = _Coarse(piece, carrier, self.model, petsc)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """A u at this rank's interior nodes, shape [i, 2], of u [n, 2]."""
        field = self.halo.felt(u)
        return field[:0] if self.through is None else self.through(field[None])[0]

    @property
    def proven(self) -> str | None:
        """What the certificate of the lattice says, if it holds."""
        model = self.model
        figures = model.certificate.get(f"{model.nominal_spacing(self.points.carrier):g}", {})
        return str(figures["statement"]) if "statement" in figures else None

    def load(self, b: np.ndarray) -> np.ndarray:
        """Tᵗ b at this rank's interior nodes, of b [n, 2] at the nodes."""
        around = self.halo.around(b)
        return around[:0] if self.through is None else self.through.load(around[None])[0]

    def inverse(self, loads: int) -> Inverse:
        """A⁻¹ of a load on this rank's interior [i, 2], to a relative residual, for `predict`."""
        return lambda right, tolerance: self.inverted(right, SHARPER * tolerance)[0]

    def inverted(self, right: np.ndarray, tolerance: float) -> tuple[np.ndarray, SolveRecord]:
        """v at this rank's interior nodes with A v = right, both [i, 2], zero on the collar."""

        def nearly_inverse(r: np.ndarray) -> np.ndarray:
            return r / self._diagonal + LONG_SHARE * self._long(r)

        product = among(self, self.points)
        return definite(product, nearly_inverse, right, tolerance, inner=self.points.inner)


class _Coarse:
    """N V Nᵗ: linear interpolation from a coarse lattice to interior nodes, and multigrid there.

    Sums go by rows of its cells: those of one row are all on one rank.
    """

    def __init__(self, piece: Subdomain, spacing: float, model: Model, petsc: bool) -> None:
        if piece.tiles is None or piece.at is None:
            raise InputError("points: expected scattered points by rows, got a lattice")
        comm, tiles, inside = piece.comm, piece.tiles, piece.interior
        self.shape = tiles.box(comm.rank)
        cell = np.floor(piece.at).astype(np.int64)
        N = _between(piece.at - cell, cell - tiles.corner(comm.rank), self.shape)
        self._N = [side[inside] for side in N]
        self._halo = Halo(comm, tiles, 1)
        whole, free = (self._summed(N, ask[:, None]) for ask in (np.ones(len(cell)), 1.0 * inside))
        self.mask = (free > INSIDE * whole)[0] & (whole > 0)[0]
        elastic = tensors_of(model, spacing).tensor()
        near = q1_tensors(elastic * spacing**-2)
        made = PetscCycle if petsc else cycle
        self._cycle = made(comm, *near, self.mask, tiles)

    def _summed(self, N: list[sp.csr_array], values: np.ndarray) -> np.ndarray:
        """Nᵗ of values [n, c] at nodes, planes [c, rows, ...]."""
        low, high = ((side.T @ values).T.reshape(-1, *self.shape) for side in N)
        return np.asarray(low + self._halo(high)[:, : self.shape[0]])

    def __call__(self, r: np.ndarray) -> np.ndarray:
        z = self._halo(self._cycle(self._summed(self._N, r) * self.mask))[:, 1:]
        low, high = (part.reshape(len(z), -1).T for part in (z[:, :-1], z[:, 1:]))
        return np.asarray(self._N[0] @ low + self._N[1] @ high)


def _between(share: np.ndarray, cell: np.ndarray, shape: tuple[int, ...]) -> list[sp.csr_array]:
    """Linear interpolation to nodes from their row of a box of cells, and from the next row."""
    (s, t), (k, n) = share.T, cell.T
    place = np.stack([k * shape[1] + n, k * shape[1] + n + 1], axis=1)
    first, size = np.arange(len(cell) + 1) * 2, (len(cell), int(np.prod(shape)))
    along = np.stack([1 - t, t], axis=1)
    sides = ((side[:, None] * along).ravel() for side in (1 - s, s))
    return [sp.csr_array((weight, place.ravel(), first), shape=size) for weight in sides]
