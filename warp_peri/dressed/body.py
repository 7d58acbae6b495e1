"""A dressed solid on nodes that end, vary and break, at rest (theory, Dr1–Dr12, Dr23, Dr24)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.contract import OnPoints
from warp_peri.core.elastic import PAIRS
from warp_peri.core.sweeps import SCALARS
from warp_peri.damage.lattice_body import LatticeBody, cracked, lattice_body
from warp_peri.dressed.sweeps import (
    BodyLayers,
    Chain,
    bond_table,
    composed,
    gauss_shapes,
    half,
    spread,
)
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.points.arrays import checked, checked_fields
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.statics.conjugate_gradients import definite
from warp_peri.statics.direct import MatrixProblem
from warp_peri.statics.solution import Direct, Krylov, Solution, Solver, refuse_solver

if TYPE_CHECKING:
    from warp_peri.dressed.law import DressedSolid


def torn(points: Points, cracks: Sequence[ArrayLike], *, reach: float = 1.5) -> np.ndarray:
    """Pairs of neighbouring nodes of a plane lattice that cracks part, [n, 2], for `broken`.

    Args:
        points: without a box.
        cracks: polylines [length], shape [P, 2] each.
        reach: of what is parted, in spacings; 3 for a crystal's bonds.
    """
    if not isinstance(points, Points):  # a piece of some lacks pairs that ranks share
        raise InputError(f"points: expected Points, all of them, got {type(points).__name__}")
    body = lattice_body(points.x, points.spacing, max(2.0, reach) * points.spacing)
    return _parted(body, cracked(body, cracks), reach)


def grown(points: Points, growth: Motion) -> np.ndarray:
    """Pairs of neighbouring nodes whose bond was cut or broke when cracks grew in the base, [n, 2].

    Args:
        points: of the body.
        growth: of its `plain` solid, move(law.plain, Cracked(points, …), events=…) (Dr12, C7).

    Raises InputError for another motion.
    """
    for horizon, reach in ((2.0, 1.5), (3.0, 3.0)):  # of a sheet, and of a crystal
        body = lattice_body(points.x, points.spacing, horizon * points.spacing)
        if np.shape(growth.details) == body.neighbour.shape:
            return _parted(body, np.asarray(growth.details), reach)
    raise InputError("growth: expected slow growth, move(…, events=…), on these points")


def _parted(body: LatticeBody, neighbour: np.ndarray, reach: float) -> np.ndarray:
    cut = (neighbour < 0) & (body.neighbour >= 0)
    node, bond = np.nonzero(cut & (body.r < (reach + 1e-3) * body.spacing))
    other = body.neighbour[node, bond]
    return np.stack([node, other], axis=1)[node < other]


def pairs(broken: ArrayLike | None, count: int) -> np.ndarray:
    """Pairs of nodes as one number each, whichever stands first."""
    if broken is None:
        return np.zeros(0, int)
    given = checked("broken", broken, float)
    whole = given.astype(int)
    if given.ndim != 2 or given.shape[1] != 2 or (whole != given).any():
        raise InputError(f"broken: expected pairs of nodes [n, 2], got {list(given.shape)}")
    if len(given) and not (whole.min() >= 0 and whole.max() < count):
        raise InputError(f"broken: expected numbers of nodes below {count}")
    return np.unique(key(whole[:, 0], whole[:, 1], count))


def key(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """One number a pair, the same for both orders."""
    return np.asarray(np.minimum(first, second) * count + np.maximum(first, second))


Grains = tuple[Sequence["DressedSolid"], ArrayLike]
"""Laws, and the number of that which each node belongs to, [N]."""
SAME, ALIKE = 1e-6, 1e-12
"""Relative, of spacings that are one, and of tables of bonds."""


def grains_of(
    solid: DressedSolid, grains: Grains | None, count: int
) -> tuple[list[DressedSolid], np.ndarray]:
    """Laws and the number of each node's own, checked."""
    if grains is None:
        return [solid], np.zeros(count, int)
    if not (isinstance(grains, tuple) and len(grains) == 2):
        raise InputError("grains: expected a pair (models, numbers of the nodes' own)")
    laws, given = list(grains[0]), checked("grains", grains[1], float)
    number = given.astype(int)
    if given.shape != (count,) or (number != given).any():
        raise InputError(f"grains: expected {count} whole numbers, got shape {list(given.shape)}")
    if not (len(laws) and number.min() >= 0 and number.max() < len(laws)):
        raise InputError(
            f"grains: expected numbers of {len(laws)} models, got {number.min()} to {number.max()}"
        )
    for law in laws:
        same = law.base == solid.base and abs(law.spacing / solid.spacing - 1) < SAME
        if not (
            same
            and law.units == solid.units
            and np.array_equal(law.steps, solid.steps)
            and law.tensors.shape == solid.tensors.shape
            and len(law.parts.moduli) == len(solid.parts.moduli)
        ):
            raise InputError(
                "grains: expected models of one base, spacing, units and neighbours, with as many "
                "parts each, as from_phonons or transferred make them for other orientations"
            )
    return laws, number


FINE = {2: 20, 3: 8}
"""Positions along an axis of an element that are asked whether they lie inside."""
LEAST = 0.02
"""Share of an element below which it is left out."""


def cut_elements(
    x: np.ndarray, axes: np.ndarray, spacing: float, inside: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """W, ∫ N_g N_g' over the part of each element inside a body, [N, 2^d, 2^d].

    Args:
        x: first corners of the elements, [N, d].
        axes: of the nodes, as columns.
        spacing: h.
        inside: which positions [n, d] lie in the body, [n] bool.

    Raises InputError for a function that says anything else.
    """
    d = len(axes)
    line = (np.arange(FINE[d]) + 0.5) / FINE[d]
    fine = np.array(list(itertools.product(line, repeat=d)))
    shapes = gauss_shapes(fine)
    square = np.einsum("ng,nf->ngf", shapes, shapes).reshape(len(shapes), -1) / len(shapes)
    gram = np.zeros((len(x), 2**d, 2**d))
    for part in np.array_split(np.arange(len(x)), len(x) // 1000 + 1):
        at = x[part, None] + spacing * fine @ axes.T
        said = np.asarray(inside(at.reshape(-1, d)), dtype=bool)
        if said.shape != (at.size // d,):
            raise InputError(f"edges: expected one bool a position, got {list(said.shape)}")
        share = said.reshape(len(part), -1)
        held = np.where(share.mean(axis=1, keepdims=True) < LEAST, 0.0, share)
        gram[part] = np.einsum("nf,fg->ng", held, square).reshape(len(part), 2**d, 2**d)
        gram[part[share.all(axis=1)]] = np.eye(2**d) / 2**d
    return gram


MOST_DIRECT = 300
"""Nodes in space beyond which conjugate gradients are taken for a factorisation."""
BALANCED, MET = 1e-4, 1e-6
"""Relative, of the resultant of a free body's load, which is taken off, and of a residual."""
WHY = "one answer; L = Gᵗ K G ⪰ 0 whatever is uneven, missing or broken"


def at_rest(body: DressedBody, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
    """A body in equilibrium with b on the interior, u given elsewhere, shape [..., N, d].

    With no node held the load must balance, and the answer neither moves nor turns as a whole (on a
    period it does not move).

    Raises InputError for another solver, for loads that do not balance, and for a body that falls
    apart.
    """
    refuse_solver(solver, (Direct, Krylov), "a dressed body")
    inside, iterated = body.points.interior, isinstance(solver, Krylov)
    if solver is None:
        iterated = body.points.x.shape[1] == 3 and int(inside.sum()) > MOST_DIRECT
    asked = solver if isinstance(solver, Krylov) else Krylov()
    if asked.preconditioner is not None:
        raise InputError(
            "solver: expected Krylov(tolerance=…) alone for a dressed body, whose "
            f"preconditioner is its own diagonal, got {asked!r:.100}"
        )
    b, u = checked_fields(body.points, b, u)
    turned, pulled = (body.fields(field) @ body.axes for field in (u, b))
    alive = body.stiffness.any(axis=1)
    dead = np.abs(pulled[:, inside & ~alive]).max(initial=0.0)
    if dead > BALANCED * np.abs(pulled).max():
        raise InputError("b: expected no load on nodes that nothing belongs to")
    took: tuple[int, ...] = ()
    if iterated:
        answer, left, steps = _iterated(body, pulled, turned, alive & inside, asked.tolerance)
        took = (steps,) * len(pulled)
    elif inside.all():
        answer, left = _free(body, pulled)
    else:
        unknown = np.repeat(alive & inside, turned.shape[-1])
        problem = MatrixProblem(sp.csr_array(body.L[unknown]), alive & inside)
        answer = problem.solve(pulled, turned)
        left = problem.left
    answer = (answer @ body.axes.T).reshape(np.shape(u))
    answer = np.where(inside[:, None], answer, u)
    method = "cg" if iterated else "lu"
    return Solution(answer, body.points, body, body.load(b), method, took, WHY, measured=left)


def _iterated(
    body: DressedBody, loads: np.ndarray, held: np.ndarray, unknown: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float, int]:
    """u [S, N, d] by conjugate gradients of G, K and G in turn, residual and iterations."""
    shape, mask = held.shape, np.repeat(unknown, held.shape[-1])[:, None]
    rigid = _rigid(body) if body.points.interior.all() else np.zeros((mask.size, 0))
    diagonal = body.stiffness.reshape(-1, 1)
    inverse = mask / np.where(diagonal > 0, diagonal, 1.0)

    def alone(r: np.ndarray) -> np.ndarray:
        return np.asarray(r - rigid @ (rigid.T @ r))

    def product(v: np.ndarray) -> np.ndarray:
        return alone(mask * body.in_turn(alone(v)))

    def precondition(r: np.ndarray) -> np.ndarray:
        return alone(inverse * alone(r))

    flat, start = (f.reshape(len(f), -1).T for f in (loads, np.where(unknown[:, None], 0.0, held)))
    right = mask * (_balanced(flat, rigid) - body.in_turn(start))
    try:
        found, record = definite(product, precondition, right, tolerance)
    except InputError as error:  # L ⪰ 0: a direction without energy is a part that is loose
        raise InputError(f"the body falls apart, or nearly: {error}") from None
    answer = (start + found).T.reshape(shape)
    return answer, record.residual, record.iterations


def _balanced(right: np.ndarray, rigid: np.ndarray) -> np.ndarray:
    """Loads [d N, S] without their resultant, which must be small."""
    along = rigid.T @ right
    if np.linalg.norm(along) > BALANCED * np.linalg.norm(right):
        raise InputError(
            "b: expected loads that balance, for no node is held; their resultant is "
            f"{np.linalg.norm(along) / np.linalg.norm(right):.1e} of them"
        )
    return np.asarray(right - rigid @ along)


def _free(body: DressedBody, loads: np.ndarray) -> tuple[np.ndarray, float]:
    """u [S, N, d] of a body that nothing holds, and the relative residual."""
    rigid = _rigid(body)
    right = _balanced(loads.reshape(len(loads), -1).T, rigid)
    stiffness = body.L.diagonal()
    scale = float(stiffness.max())
    # rigid motions are held by rows of their own, and so is what belongs to nothing
    alone = sp.diags_array(np.where(stiffness > 0, 0.0, scale))
    edge = sp.csr_array(scale * rigid)
    bordered = sp.block_array([[body.L + alone, edge], [edge.T, None]], format="csc")
    try:
        found = splu(bordered).solve(np.vstack([right, np.zeros((rigid.shape[1], len(loads)))]))
    except RuntimeError as error:
        raise InputError(f"the body falls apart: it is singular ({error})") from None
    answer = found[: len(right)]
    size = np.maximum(np.linalg.norm(right, axis=0), 1e-300)
    left = float((np.linalg.norm(body.L @ answer - right, axis=0) / size).max())
    if not left < MET:
        raise InputError(f"the body falls apart: the residual of its solve is {left:.1e}")
    return answer.T.reshape(loads.shape), left


def _picked(nodes: np.ndarray, d: int) -> sp.dia_array:
    """The identity on some nodes [N], zero on the others."""
    return sp.diags_array(np.repeat(nodes, d).astype(float))


def _rigid(body: DressedBody) -> np.ndarray:
    """Orthonormal rigid motions of the nodes that carry something, [d N, m].

    On a period translations alone.
    """
    x = (body.points.x - body.points.x.mean(axis=0)) @ body.axes
    count, d = x.shape
    found = [np.tile(np.eye(d)[a], count) for a in range(d)]
    if body.points.box is None:
        for a in range(d):
            for c in range(a):
                turn = np.zeros((count, d))
                turn[:, a], turn[:, c] = x[:, c], -x[:, a]
                found.append(turn.ravel())
    return np.linalg.qr(np.array(found).T * (body.stiffness.ravel() > 0)[:, None])[0]


Edges = bool | Callable[[np.ndarray], np.ndarray]
"""Whether a body may end before its bonds do; or which positions [n, d] lie inside, [n] bool."""


class DressedBody(OnPoints):
    """L = Σ_a Gᵗ K_a G on the nodes of one body, K of the sites and strains that are there.

    Made by DressedSolid.on. No eigenvalue is negative and no rigid motion costs anything,
    whatever is missing (theory, Dr10).

    Args:
        solid: the law.
        points: nodes on a lattice of its spacing, or periodic; those that are not interior are
            held.
        edges, maps, broken, grains, dtype: as of DressedSolid.on.

    Attributes:
        factors: modulus of each part over that of the even solid at each site, [A, N].
        grid, sides: steps of the nodes, [N, d], and of the box or the period around them.
    """

    is_linear = is_symmetric = True
    lists = False
    """Whether elements go by lists: no sum then depends on the box a node lies in, as of ranks."""

    def __init__(
        self,
        solid: DressedSolid,
        points: Points | Samples,
        *,
        edges: Edges = True,
        maps: Mapping[str, ArrayLike] | None = None,
        broken: ArrayLike | None = None,
        grains: Grains | None = None,
        dtype: Any = np.float64,
    ) -> None:
        self.points, self.model = solid.crystal.fitting(points), solid
        self.grid, self.axes = lattice_steps(self.points)
        self.sides = tuple((self.grid.max(axis=0) + 1).tolist())
        if self.points.box is not None:
            period = np.rint(np.asarray(self.points.box) / self.points.spacing)
            self.sides = tuple(period.astype(int).tolist())
        self._steps = np.concatenate([solid.steps, -solid.steps])
        self.laws, self.grain = grains_of(solid, grains, len(self.grid))
        base = solid.parts
        self._corner = self._neighbours(base.corners)
        count = len(self.grid)
        if callable(edges) and solid.base != "elements":
            raise InputError("edges: expected True for a base of bonds; outlines cut elements")
        place = self.points.x, self.axes, solid.spacing
        self.gram = cut_elements(*place, edges) if callable(edges) else None
        self.share = np.ones(count) if self.gram is None else self.gram.sum(axis=(1, 2))
        self.maps = dict(maps or {})
        self.factors = self._factors(self.maps) * (self.share > 0)
        torn = pairs(broken, count)
        self._there, self._linked = self._sites(torn)
        if not edges:
            self._refuse_edges()
        alive = bool((self.factors > 0).any(axis=0).all())
        self._even = (
            alive and len(self.laws) == 1 and not edges and not len(torn)
        )  # whole rows of G at every unknown
        self.dtype = np.dtype(dtype)
        if self.dtype not in SCALARS:
            raise InputError(f"dtype: expected float64 or float32, got {self.dtype}")

    def stiffest_wave(self) -> float:
        """A bound on the eigenvalues of L over the masses [stress / length²], for time steps.

        Of sheets and blocks with maps alone it is proven, the even solid's times the largest map;
        of others the largest eigenvalue, to a thousandth.
        """
        if self._even:
            return float(self.factors.max()) * self.model.stiffest_wave()
        light = np.repeat(self.masses**-0.5, self.points.x.shape[1])
        size, start = self.stiffness.max(), np.random.default_rng(0).normal(size=len(light))
        how: dict[str, Any] = {"tol": 1e-4, "v0": start, "return_eigenvectors": False}
        waves = LinearOperator(  # in any units
            2 * (len(light),), lambda v: light * self._exact(light * v.ravel()[None])[0] / size
        )
        return float(1.001 * size * eigsh(waves, 1, which="LA", **how)[0])

    @cached_property
    def masses(self) -> np.ndarray:
        """Mass of each node over that of a whole cell: its parts of the elements around it, [N].

        An element counts as far as it lies inside. Nodes have whole cells where bonds are the
        base, and where there is nothing.
        """
        count, corners = self._corner.shape
        if self.model.base != "elements":
            return np.ones(count)
        there = (self._corner >= 0).all(axis=1) & (self.factors > 0).any(axis=0)
        found = np.zeros(count + 1)
        each = np.repeat(np.where(there, self.share, 0.0) / corners, corners)
        np.add.at(found, self._corner.ravel(), each)
        return np.where(found[:-1] > 0, found[:-1], 1.0)

    def _neighbours(self, steps: np.ndarray) -> np.ndarray:
        """Numbers of the nodes that steps lead to, −1 where none is, [N, n]."""
        period = None if self.points.box is None else np.array(self.sides)
        found = neighbour_table(self.grid, steps, period).astype(int)
        if self.points.outside is not None:
            found[np.append(self.points.outside, False)[found]] = -1
        return found

    def _factors(self, maps: Mapping[str, ArrayLike]) -> np.ndarray:
        base, count = self.model.parts, len(self.points.x)
        if unknown := sorted(set(maps) - set(base.names)):
            raise InputError(
                f"maps: expected some of {', '.join(base.names)}, got {', '.join(unknown)}"
            )
        found = np.ones((len(base.names), count))
        for part, name in enumerate(base.names):
            if name not in maps:
                continue
            values = checked(f"maps[{name!r}]", maps[name], float)
            if values.shape != (count,) or values.min() < 0:
                raise InputError(
                    f"maps[{name!r}]: expected {count} numbers ≥ 0, one a node, got shape "
                    f"{list(values.shape)}, the smallest {values.min():g}"
                )
            around = np.append(values, 0.0)[self._corner].T
            found[part] = sum(share * one for share, one in zip(base.middle, around))
        return found

    def _sites(self, torn: np.ndarray) -> tuple[np.ndarray, dict[tuple[int, ...], np.ndarray]]:
        """Which strains are there, [N, S], and from which nodes a step of one spacing leads on.

        A strain is there where all its nodes are, none of them torn from another. Two nodes are
        linked while a strain of some stiffness is made of both.
        """
        base = self.model.parts
        corner, touched = self._corner, base.touched
        there: np.ndarray = ((corner >= 0)[:, None] | ~touched).all(axis=2)
        count = len(corner)
        for p in range(touched.shape[1]):
            for q in range(p):
                both = touched[:, p] & touched[:, q]
                if len(torn) and both.any():
                    cut = np.isin(key(corner[:, p], corner[:, q], count), torn)
                    there &= ~np.logical_and.outer(cut, both)
        stiff = np.asarray((self.factors > 0).any(axis=0))
        alive = there & stiff[:, None]
        linked: dict[tuple[int, ...], np.ndarray] = {}
        for p in range(touched.shape[1]):
            for q in range(touched.shape[1]):
                step = tuple((base.corners[q] - base.corners[p]).tolist())
                some = (alive & touched[:, p] & touched[:, q]).any(axis=1)
                if any(step) and max(map(abs, step)) == 1:
                    mine = linked.setdefault(step, np.zeros(count, bool))
                    mine[corner[some, p]] = True
        return there, linked

    def _whole(self, step: np.ndarray) -> np.ndarray:
        """From which nodes every way along a step of G, of at most two links, is whole, [N]."""
        own = tuple(step.tolist())
        if own in self._linked:
            return self._linked[own]
        whole = np.ones(len(self.points.x), bool)
        for first, start in self._linked.items():
            second = tuple((step - first).tolist())
            if second in self._linked:
                middle = self._neighbours(np.array([first]))[:, 0]
                whole &= start & self._linked[second][middle] & (middle >= 0)
        return whole

    def _refuse_edges(self) -> None:
        """Raise InputError where an interior node lacks one that L leads to, whatever its maps."""
        law = self.model
        K = np.abs(law.parts.stencils).sum(axis=0)
        G = np.abs(spread(law.steps, np.abs(law.tensors).sum(axis=0)))
        steps, _ = half(composed(G, composed(K, G)))
        there = self._neighbours(np.concatenate([steps, -steps])) >= 0
        lacking = int((~there.all(axis=1) & self.points.interior).sum())
        if lacking:
            raise InputError(
                f"points: {lacking} of {int(self.points.interior.sum())} interior nodes have cut "
                f"bonds; give a collar {law.spacing * np.linalg.norm(steps, axis=1).max():g} wide, "
                "or edges=True where the body itself ends there"
            )

    @cached_property
    def strains(self) -> sp.csr_array:
        """B/h of all sites, those left out zero, [N S, d N]."""
        return self._strains(np.arange(len(self._there)))

    def _strains(self, sites: np.ndarray) -> sp.csr_array:
        base, (count, _) = self.model.parts, self._corner.shape
        s, p, i = np.nonzero(np.abs(base.strains) > 0)
        site, entry = np.nonzero(self._there[sites][:, s])
        site = sites[site]
        row = site * len(base.strains) + s[entry]
        column = self._corner[site, p[entry]] * base.corners.shape[1] + i[entry]
        value = base.strains[s, p, i][entry] / self.model.spacing
        shape = (count * len(base.strains), count * base.corners.shape[1])
        return sp.csr_array(sp.coo_array((value, (row, column)), shape=shape))

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Neighbours by steps of G, [N, 2 H], and which pairs ±ξ a row of G has, [H, N]."""
        neighbour = self._neighbours(self._steps)
        full = np.array((neighbour >= 0).all(axis=1), bool)
        full[self._corner[self.share < 1].ravel()] = False  # which an outline cuts
        half = len(self.model.steps)
        whole = np.array([full & self._whole(step) for step in self._steps]).reshape(-1, len(full))
        return neighbour, whole[:half] & whole[half:]

    def _dressing(self, tensors: np.ndarray, rows: np.ndarray) -> sp.csr_array:
        """G of tensors of each grain [g, H, d, d], of the nodes `rows` [N]: a row is of its node's
        own grain, and the identity where a neighbour is not there; torn pairs ±ξ are left out."""
        (count, d), (neighbour, pairs) = self.points.x.shape, self._pairs
        bond, node = np.nonzero(np.tile(pairs & rows, (2, 1)))
        i, j = np.indices((d, d))
        row, own = (d * node[:, None, None] + axis for axis in (i, j))
        column = d * neighbour[node, bond][:, None, None] + j
        value = np.tile(tensors, (1, 2, 1, 1))[self.grain[node], bond]
        shift = sp.coo_array(
            (
                np.concatenate([value.ravel(), -value.ravel()]),
                (np.tile(row.ravel(), 2), np.concatenate([column.ravel(), own.ravel()])),
            ),
            shape=(d * count, d * count),
        )
        return sp.csr_array(_picked(rows, d) + shift)

    def base_displacement(self, u: ArrayLike) -> np.ndarray:
        """v = G u, in which the energy is the base's own ½ vᵗ K v, shape [..., N, d]."""
        return self._through(lambda flat: self._one_dressing() @ flat, u)

    def displacement(self, v: ArrayLike) -> np.ndarray:
        """u = G⁻¹ v of what the base alone answers, as of a crack that grew in it (Dr12).

        Raises InputError for a split dressing, which has no single v.
        """
        return self._through(splu(sp.csc_array(self._one_dressing())).solve, v)

    def _one_dressing(self) -> sp.csr_array:
        if len(self.dressings) > 1:
            raise InputError("displacement: expected one G, got one for each part (split)")
        return self.dressings[0]

    def _through(self, matrix: Callable[[np.ndarray], np.ndarray], u: ArrayLike) -> np.ndarray:
        return np.asarray(matrix(self.flat(u).T).T.reshape(np.shape(u)) @ self.axes.T)

    def tensors(self, number: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """m_a M_a of each grain, [S, S], and its share of each site, [N]; one between grains is a
        mean of theirs."""
        base = self.model.parts
        return [
            (
                np.append(self.grain == grain, False)[self._corner] @ base.middle,
                law.parts.parts[number] * law.parts.moduli[number],
            )
            for grain, law in enumerate(self.laws)
        ]

    def part(
        self, number: int, factor: np.ndarray, strains: sp.csr_array | None = None
    ) -> sp.csr_array:
        """K_a of one part with a factor at each site, [N]: symmetric, [d N, d N]."""
        base, strains = self.model.parts, self.strains if strains is None else strains
        inner = sp.csr_array((strains.shape[0],) * 2)
        for share, M in self.tensors(number):
            weight = sp.diags_array(share * factor)
            inner = inner + sp.kron(weight, sp.csr_array(M), format="csr")
        if self.gram is not None:  # M = 1 ⊗ P / 2^d becomes W ⊗ P
            place = np.arange(len(factor) + 1)
            W = sp.bsr_array((self.gram * len(self.gram[0]), place[:-1], place))
            inner = inner @ sp.kron(W, sp.eye_array(len(base.strains) // len(self.gram[0])))
        return sp.csr_array(strains.T @ (inner @ strains))

    @cached_property
    def dressings(self) -> list[sp.csr_array]:
        """G, or one for each part, [d N, d N]."""
        every = np.ones(len(self.grain), bool)
        return [self._dressing(g, every) for g in self._tensors]

    @property
    def _tensors(self) -> np.ndarray:
        """Those of each G by grain, [A or 1, g, H, d, d]."""
        return np.stack([law.tensors for law in self.laws], axis=1)

    @cached_property
    def _sites_whole(self) -> np.ndarray:
        """Which sites go by rows, [N]: of elements, and of bonds of one kind in the plane."""
        elements = self.model.base == "elements"
        rows = elements and not self.lists
        if not elements and len(self.axes) == 2:
            own, *others = (bond_table(law.parts)[1] for law in self.laws)
            rows = all(np.allclose(own, other, rtol=ALIKE, atol=0) for other in others)
        return np.asarray(self._there.all(axis=1) & (self.share == 1) & rows)

    def phases(self, parts: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
        """Voigt's matrices of these parts of all grains, [P, m, m], and the share of each at the
        elements of the box that are whole, [P, *sides]."""
        d, order = len(self.sides), np.ravel_multi_index(tuple(self.grid.T), self.sides)
        rows = len(PAIRS[d])
        shear = np.where(np.arange(rows) < d, 1.0, 2**-0.5)
        tables, shares = [], []
        for a in parts:
            for share, M in self.tensors(a):
                shares.append(np.zeros(self.sides))
                shares[-1].flat[order] = share * self.factors[a] * self._sites_whole
                tables.append(2**d * M[:rows, :rows] * np.outer(shear, shear))
        return np.array(tables), np.array(shares)

    @cached_property
    def chains(self) -> list[Chain]:
        """What goes by rows, and the short list of what does not, of each G."""
        h, d, elements = self.model.spacing, len(self.axes), self.model.base == "elements"
        neighbour, pairs = self._pairs
        plain = np.asarray(pairs.all(axis=0))
        near = plain[neighbour] & (self.grain[neighbour] == self.grain[:, None]) & (neighbour >= 0)
        short = ~(plain & near.all(axis=1))  # rows of Gᵗ
        felt = short.copy()
        felt[neighbour[short]] = True
        odd = np.flatnonzero(~self._sites_whole & self._there.any(axis=1))
        strains, found = self._strains(odd), []
        for number, tensors in enumerate(self._tensors):
            parts = [number] if len(self._tensors) > 1 else list(range(len(self.factors)))
            K = sum(self.part(a, self.factors[a], strains) for a in parts)
            G, Gt = self._dressing(tensors, ~plain), self._dressing(tensors, felt).T
            tables, shares = np.zeros((0, d, d)), np.zeros(0)
            if elements and not self.lists:
                tables, shares = self.phases(parts)
            factors = None
            if not elements and self._sites_whole.any():
                live = (self.factors * self._sites_whole / h**2)[parts]
                factors = sum(
                    row[:, None] * (share * one)  # no product of matrices: its bits go by the box
                    for law, (share, _) in zip(self.laws, self.tensors(0))
                    for row, one in zip(bond_table(law.parts)[2][:, parts].T, live)
                )
            rows = G, sp.csr_array(_picked(short, d) @ Gt)
            found.append(Chain(tensors, *rows, tables / h**2, shares, factors, sp.csr_array(K)))
        return found

    @cached_property
    def _exact(self) -> BodyLayers:
        """L of all nodes."""
        return BodyLayers(self)

    @cached_property
    def _sweep(self) -> BodyLayers:
        """L of all nodes, in the body's own precision."""
        return self._exact if self.dtype == np.float64 else BodyLayers(self, self.dtype)

    @cached_property
    def layers(self) -> list[sp.csr_array]:
        """K of each G, [d N, d N]."""
        each = [self.part(a, factor) for a, factor in enumerate(self.factors)]
        return each if len(self.dressings) > 1 else [sp.csr_array(sum(each[1:], each[0]))]

    @cached_property
    def stiffness(self) -> np.ndarray:
        """Diagonal of K, zero where nothing belongs to a node, [N, d]."""
        B, d = self.model.parts.strains / self.model.spacing, len(self.axes)
        found = np.zeros((len(self.grid) + 1, d))
        for chain in self.chains:
            found[:-1] += chain.sites.diagonal().reshape(-1, d)
        for a, factor in enumerate(self.factors * self._sites_whole):
            for share, M in self.tensors(a):
                own = np.einsum("spi,st,tpi->pi", B, M, B)
                for near, each in zip(self._corner.T, own):
                    found[near] += (share * factor)[:, None] * each
        return found[:-1]

    def in_turn(self, flat: np.ndarray) -> np.ndarray:
        """L of columns [d N, S], by rows."""
        return self._exact(flat.T).T

    @cached_property
    def L(self) -> sp.csr_array:
        """[d N, d N], symmetric, [stress/length²]; vectors are along the nodes' axes."""
        dressed = [G.T @ (K @ G) for G, K in zip(self.dressings, self.layers)]
        L = sum(dressed[1:], dressed[0])
        return sp.csr_array((L + L.T) / 2)

    def force(self, u: ArrayLike) -> np.ndarray:
        """L u at the interior nodes [stress/length], shape [..., N, d] to [..., I, d]."""
        found = self._sweep(self.flat(u)).reshape(np.shape(u))[..., self.points.interior, :]
        return np.asarray(found @ self.axes.T.astype(self.dtype))

    def product_transpose(self, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """L of w on the interior [..., I, d], zero elsewhere, on all nodes [..., N, d]."""
        return self._through(self.in_turn, self.on_all(w))

    @property
    def learnable(self) -> dict[str, np.ndarray]:
        """Maps of the parts by name, [N] each."""
        even = dict.fromkeys(self.model.parts.names, np.ones(len(self.points.x)))
        return even | {name: np.asarray(values) for name, values in self.maps.items()}

    def at(self, numbers: Mapping[str, ArrayLike]) -> DressedBody:
        """The same body with other maps; InputError where one is not > 0: there links would end."""
        if not all(np.min(values) > 0 for values in numbers.values()):
            raise InputError("maps: expected numbers > 0 where they are learned")
        return DressedBody(*self._made_of[0], **self._made_of[1] | {"maps": dict(numbers)})

    def by_numbers(self, name: str, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """The derivative of Σ w · force(u) to the map of a part, [N], of fields [K, N, d] and
        weights of the interior nodes [K, I, d]."""
        base, count = self.model.parts, len(self.share)
        number = base.names.index(name)
        through = self.strains @ self.dressings[min(number, len(self.dressings) - 1)]
        each = (through @ self.flat(field).T for field in (u, self.on_all(w)))
        felt, asked = (one.reshape(count, len(base.strains), -1) for one in each)
        if self.gram is not None:  # as in `part`
            parts = felt.reshape(count, len(self.gram[0]), -1)
            felt = (self.gram * len(self.gram[0]) @ parts).reshape(felt.shape)
        by_site = sum(
            share * np.einsum("nsk,st,ntk->n", asked, M, felt, optimize=True)
            for share, M in self.tensors(number)
        )
        found = np.zeros(count + 1)
        np.add.at(found, self._corner, np.multiply.outer(by_site * (self.share > 0), base.middle))
        return found[:-1]

    def balanced(self, g: np.ndarray) -> np.ndarray:
        """Of a load [..., N, d] what a solve takes: none on nodes that nothing belongs to and, with
        no node held, no resultant."""
        flat = (self.flat(g) * (self.stiffness.ravel() > 0)).T
        if self.points.interior.all():
            rigid = _rigid(self)
            flat = flat - rigid @ (rigid.T @ flat)
        return self._through(lambda _: flat, g)

    def energy(self, u: ArrayLike) -> np.ndarray | float:
        """½ h^d uᵗ L u of all nodes, shape [...]; never negative."""
        flat = self.flat(u)
        volume = self.points.spacing ** self.points.x.shape[1]
        total = 0.5 * volume * np.einsum("sn,sn->s", flat, self._exact(flat))
        return float(total[0]) if np.ndim(u) == 2 else total.reshape(np.shape(u)[:-2])

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """In equilibrium with b on the interior, u given elsewhere, shape [..., N, d]; as in
        rest.at_rest."""
        return at_rest(self, b, u, solver)

    def flat(self, u: ArrayLike) -> np.ndarray:
        """Fields along the nodes' axes, one a row, [S, d N]."""
        fields = self.fields(u)
        return np.asarray((fields @ self.axes).reshape(len(fields), -1))
