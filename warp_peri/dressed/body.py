"""Dressed bodies that are uneven, end at edges or are broken (theory.md, D9–D11, D22)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu

from warp_peri.damage.lattice_body import LatticeBody, cracked, lattice_body
from warp_peri.dressed.sweeps import ByLayers
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.micromodulus.nodes import Nodes, lay_out
from warp_peri.points.arrays import checked
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.statics.direct import MatrixProblem
from warp_peri.statics.settings import Direct, Solver, refuse_solver
from warp_peri.statics.solution import Solution

if TYPE_CHECKING:
    from warp_peri.dressed.law import DressedSolid

Edges = bool | Callable[[np.ndarray], np.ndarray]
"""Whether a body may end before its bonds do; or which positions [n, d] lie inside, [n] bool."""
FINE = {2: 20, 3: 8}
"""Positions along an axis of an element that are asked whether they lie inside."""
LEAST = 0.02
"""Share of an element below which it is left out."""
BALANCED, MET = 1e-4, 1e-6
"""Relative, of the resultant of a free body's load, which is taken off, and of a residual."""


class Body:
    """L = Σ_a Gᵗ K_a G on the nodes of one body, K of the sites and strains that are there.

    Made by DressedSolid.on. No eigenvalue is negative and no rigid motion costs anything,
    whatever is missing (theory.md, D10).

    Args:
        solid: the law.
        points: nodes on a lattice of its spacing, or periodic; those that are not interior are
            held.
        edges, maps, broken: as of DressedSolid.on.

    Attributes:
        factors: modulus of each part over that of the even solid at each site, [A, N].
        grid, sides: steps of the nodes, [N, d], and of the box or the period around them.
    """

    def __init__(
        self,
        solid: DressedSolid,
        points: Points | Samples,
        *,
        edges: Edges = True,
        maps: Mapping[str, ArrayLike] | None = None,
        broken: ArrayLike | None = None,
    ) -> None:
        self.points, self.model = solid.crystal.fitting(points), solid
        self.grid, self.axes = lattice_steps(self.points)
        self.sides = tuple((self.grid.max(axis=0) + 1).tolist())
        if self.points.box is not None:
            period = np.rint(np.asarray(self.points.box) / self.points.spacing)
            self.sides = tuple(period.astype(int).tolist())
        self._steps = np.concatenate([solid.steps, -solid.steps])
        base = solid.parts
        self._corner = self._neighbours(base.corners)
        count = len(self.grid)
        self.share = self._inside(edges) if callable(edges) else np.ones(count)
        self.factors = self._factors(maps or {}) * self.share
        torn = _pairs(broken, count)
        self._there, self._linked = self._sites(torn)
        if not edges:
            self._refuse_edges()
        alive = bool((self.factors > 0).any(axis=0).all())
        self._even = alive and not edges and not len(torn)  # whole rows of G at every unknown

    def _neighbours(self, steps: np.ndarray) -> np.ndarray:
        """Numbers of the nodes that steps lead to, −1 where none is, [N, n]."""
        period = None if self.points.box is None else np.array(self.sides)
        found = neighbour_table(self.grid, steps, period).astype(int)
        if self.points.outside is not None:
            found[np.append(self.points.outside, False)[found]] = -1
        return found

    def _inside(self, inside: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Share of each element that lies inside the body, [N]."""
        if self.model.base != "elements":
            raise InputError("edges: expected True for a base of bonds; outlines cut elements")
        d = len(self.axes)
        line = (np.arange(FINE[d]) + 0.5) / FINE[d]
        fine = np.array(list(itertools.product(line, repeat=d))) * self.model.spacing
        share = np.zeros(len(self.points.x))
        for part in np.array_split(np.arange(len(share)), len(share) // 1000 + 1):
            at = self.points.x[part, None] + fine @ self.axes.T
            said = np.asarray(inside(at.reshape(-1, d)), dtype=bool)
            if said.shape != (at.size // d,):
                raise InputError(f"edges: expected one bool a position, got {list(said.shape)}")
            share[part] = said.reshape(len(part), -1).mean(axis=1)
        return np.where(share < LEAST, 0.0, share)

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
            found[part] = np.append(values, 0.0)[self._corner] @ base.middle
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
                    cut = np.isin(_key(corner[:, p], corner[:, q], count), torn)
                    there &= ~(cut[:, None] & both)
        alive = there & (self.factors > 0).any(axis=0)[:, None]
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
        """Raise InputError where an interior node lacks one that L leads to."""
        steps = self.model.crystal.steps
        there = self._neighbours(np.concatenate([steps, -steps])) >= 0
        lacking = int((~there.all(axis=1) & self.points.interior).sum())
        if lacking:
            raise InputError(
                f"points: {lacking} of {int(self.points.interior.sum())} interior nodes have cut "
                f"bonds; give a collar {self.model.horizon:g} wide, or edges=True where the body "
                "itself ends there"
            )

    @cached_property
    def strains(self) -> sp.csr_array:
        """B/h of all sites, those left out zero, [N S, d N]."""
        there = self._there
        base, (count, _) = self.model.parts, self._corner.shape
        s, p, i = np.nonzero(np.abs(base.strains) > 0)
        site, entry = np.nonzero(there[:, s])
        row = site * len(base.strains) + s[entry]
        column = self._corner[site, p[entry]] * base.corners.shape[1] + i[entry]
        value = base.strains[s, p, i][entry] / self.model.spacing
        shape = (count * len(base.strains), count * base.corners.shape[1])
        return sp.csr_array(sp.coo_array((value, (row, column)), shape=shape))

    def _dressing(self, tensors: np.ndarray) -> sp.csr_array:
        """G: a row is the identity where a neighbour is not there; torn pairs ±ξ are left out."""
        count, d = self.points.x.shape
        neighbour = self._neighbours(self._steps)
        full = np.array((neighbour >= 0).all(axis=1), bool)
        full[self._corner[self.share < 1].ravel()] = False  # which an outline cuts
        half = len(tensors)
        whole = np.array([full & self._whole(step) for step in self._steps])
        whole = np.tile(whole[:half] & whole[half:], (2, 1))
        bond, node = np.nonzero(whole)
        i, j = np.indices((d, d))
        row, own = (d * node[:, None, None] + axis for axis in (i, j))
        column = d * neighbour[node, bond][:, None, None] + j
        value = np.tile(tensors, (2, 1, 1))[bond]
        shift = sp.coo_array(
            (
                np.concatenate([value.ravel(), -value.ravel()]),
                (np.tile(row.ravel(), 2), np.concatenate([column.ravel(), own.ravel()])),
            ),
            shape=(d * count, d * count),
        )
        return sp.csr_array(sp.eye_array(d * count) + shift)

    def base_displacement(self, u: ArrayLike) -> np.ndarray:
        """v = G u, in which the energy is the base's own ½ vᵗ K v, shape [..., N, d]."""
        return self._through(lambda flat: self._one_dressing() @ flat, u)

    def displacement(self, v: ArrayLike) -> np.ndarray:
        """u = G⁻¹ v of what the base alone answers, as of a crack that grew in it (D12).

        Raises InputError for a split dressing, which has no single v.
        """
        return self._through(splu(sp.csc_array(self._one_dressing())).solve, v)

    def _one_dressing(self) -> sp.csr_array:
        if len(self.dressings) > 1:
            raise InputError("displacement: expected one G, got one for each part (split)")
        return self.dressings[0]

    def _through(self, matrix: Callable[[np.ndarray], np.ndarray], u: ArrayLike) -> np.ndarray:
        return np.asarray(matrix(self._flat(u).T).T.reshape(np.shape(u)) @ self.axes.T)

    def part(self, number: int, factor: np.ndarray) -> sp.csr_array:
        """K_a of one part with a factor at each site, [N]: symmetric, [d N, d N]."""
        base = self.model.parts
        M = sp.csr_array(base.parts[number] * base.moduli[number])
        weight = sp.diags_array(np.repeat(factor, len(base.strains)))
        inner = sp.kron(sp.eye_array(len(factor)), M, format="csr") @ weight
        return sp.csr_array(self.strains.T @ (inner @ self.strains))

    @cached_property
    def dressings(self) -> list[sp.csr_array]:
        """G, or one for each part, [d N, d N]."""
        return [self._dressing(g) for g in self.model.tensors]

    @cached_property
    def _sweep(self) -> tuple[Nodes, ByLayers] | None:
        """L by rows, of sheets of square elements that nothing cuts."""
        law = self.model
        if not (self._even and law.layered and law.base == "elements" and law.dimension == 2):
            return None
        nodes = lay_out(self.points, law.crystal.steps)
        factors = np.ones((len(self.factors), int(np.prod(nodes.shape))))
        factors[:, nodes.place] = self.factors[:, nodes.near]
        factors = factors.reshape(-1, *nodes.shape)
        if nodes.periodic:
            factors = np.pad(factors, [(0, 0), *[(nodes.reach,) * 2] * 2], mode="wrap")
        sweep = ByLayers(nodes, law.steps, law.tensors[0], law.parts, law.spacing, factors)
        return nodes, sweep

    @cached_property
    def L(self) -> sp.csr_array:
        """[d N, d N], symmetric, [stress/length²]; vectors are along the nodes' axes."""
        each = [self.part(a, factor) for a, factor in enumerate(self.factors)]
        if len(self.dressings) == 1:
            each = [sum(each[1:], each[0])]
        dressed = [G.T @ (K @ G) for G, K in zip(self.dressings, each)]
        L = sum(dressed[1:], dressed[0])
        return sp.csr_array((L + L.T) / 2)

    def __call__(self, u: ArrayLike) -> np.ndarray:
        """L u at the interior nodes [stress/length], shape [..., N, d] to [..., I, d]."""
        if self._sweep is not None:
            nodes, sweep = self._sweep
            found = nodes.take_up(sweep(nodes.lay_out(self._fields(u))))
            return found.reshape(*np.shape(u)[:-2], *found.shape[1:])
        flat = self._flat(u)
        force = (self.L @ flat.T).T.reshape(*np.shape(u)) @ self.axes.T
        return np.asarray(force[..., self.points.interior, :])

    def load(self, b: ArrayLike) -> np.ndarray:
        """b [stress/length] on the interior nodes, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

    def product(self, u: ArrayLike, v: ArrayLike) -> np.ndarray:
        """L v, whatever u, for L is linear, shape [..., I, d]."""
        return self(v)

    def energy(self, u: ArrayLike) -> np.ndarray | float:
        """½ h^d uᵗ L u of all nodes, shape [...]; never negative."""
        flat = self._flat(u)
        volume = self.points.spacing ** self.points.x.shape[1]
        total = 0.5 * volume * np.einsum("sn,sn->s", flat, (self.L @ flat.T).T)
        return float(total[0]) if np.ndim(u) == 2 else total.reshape(np.shape(u)[:-2])

    def stress(self, u: ArrayLike) -> None:
        """None: strains lie on sites, not on nodes."""

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """In equilibrium with b on the interior, u given elsewhere, shape [..., N, d].

        With no node held the load must balance, and the answer neither moves nor turns as a whole
        (on a period it does not move).

        Raises InputError for another solver, for loads that do not balance, and for a body that
        falls apart.
        """
        refuse_solver(solver, (Direct,), "a dressed body")
        fields, loads = self._fields(u), self._fields(b)
        turned, pulled = fields @ self.axes, loads @ self.axes
        if self.points.interior.all():
            answer, left = self._free(pulled)
        else:
            unknown = np.repeat(self.points.interior, turned.shape[-1])
            problem = MatrixProblem(sp.csr_array(self.L[unknown]), self.points.interior)
            answer = problem.solve(pulled, turned)
            left = problem.left
        answer = (answer @ self.axes.T).reshape(np.shape(u))
        answer = np.where(self.points.interior[:, None], answer, u)
        why = "one answer; L = Gᵗ K G ⪰ 0 whatever is uneven, missing or broken"
        return Solution(answer, self.points, self, self.load(b), "lu", (), why, measured=left)

    def _free(self, loads: np.ndarray) -> tuple[np.ndarray, float]:
        """u [S, N, d] of a body that nothing holds, and the relative residual."""
        rigid = self._rigid()
        right = loads.reshape(len(loads), -1).T
        along = rigid.T @ right
        if np.linalg.norm(along) > BALANCED * np.linalg.norm(right):
            raise InputError(
                "b: expected loads that balance, for no node is held; their resultant is "
                f"{np.linalg.norm(along) / np.linalg.norm(right):.1e} of them"
            )
        right = right - rigid @ along
        stiffness = self.L.diagonal()
        scale = float(stiffness.max())
        # rigid motions are held by rows of their own, and so is what belongs to nothing
        alone = sp.diags_array(np.where(stiffness > 0, 0.0, scale))
        edge = sp.csr_array(scale * rigid)
        bordered = sp.block_array([[self.L + alone, edge], [edge.T, None]], format="csc")
        try:
            found = splu(bordered).solve(np.vstack([right, np.zeros((rigid.shape[1], len(loads)))]))
        except RuntimeError as error:
            raise InputError(f"the body falls apart: it is singular ({error})") from None
        answer = found[: len(right)]
        size = np.maximum(np.linalg.norm(right, axis=0), 1e-300)
        left = float((np.linalg.norm(self.L @ answer - right, axis=0) / size).max())
        if not left < MET:
            raise InputError(f"the body falls apart: the residual of its solve is {left:.1e}")
        return answer.T.reshape(loads.shape), left

    def _rigid(self) -> np.ndarray:
        """Orthonormal rigid motions of the nodes that carry something, [d N, m].

        On a period translations alone.
        """
        x = (self.points.x - self.points.x.mean(axis=0)) @ self.axes
        count, d = x.shape
        found = [np.tile(np.eye(d)[a], count) for a in range(d)]
        if self.points.box is None:
            for a in range(d):
                for c in range(a):
                    turn = np.zeros((count, d))
                    turn[:, a], turn[:, c] = x[:, c], -x[:, a]
                    found.append(turn.ravel())
        return np.linalg.qr(np.array(found).T * (self.L.diagonal() > 0)[:, None])[0]

    def _fields(self, u: ArrayLike) -> np.ndarray:
        """Fields [S, N, d] of finite numbers."""
        values = checked("u", u, float)
        if values.ndim < 2 or values.shape[-2:] != self.points.x.shape:
            raise InputError(
                f"u: expected shape [..., {', '.join(map(str, self.points.x.shape))}], got "
                f"{list(values.shape)}"
            )
        return values.reshape(-1, *self.points.x.shape)

    def _flat(self, u: ArrayLike) -> np.ndarray:
        """Fields along the nodes' axes, one a row, [S, d N]."""
        fields = self._fields(u)
        return np.asarray((fields @ self.axes).reshape(len(fields), -1))


def torn(points: Points, cracks: Sequence[ArrayLike]) -> np.ndarray:
    """Pairs of neighbouring nodes of a plane lattice that cracks part, [n, 2], for `broken`.

    Args:
        points: without a box.
        cracks: polylines [length], shape [P, 2] each.
    """
    body = lattice_body(points.x, points.spacing, 2 * points.spacing)
    return _parted(body, cracked(body, cracks))


def grown(points: Points, growth: Motion) -> np.ndarray:
    """Pairs of neighbouring nodes whose bond was cut or broke when cracks grew in the base, [n, 2].

    Args:
        points: of the body.
        growth: of its `plain` solid, move(law.plain, Cracked(points, …), events=…) (D12, C7).

    Raises InputError for another motion.
    """
    body = lattice_body(points.x, points.spacing, 2 * points.spacing)
    if np.shape(growth.details) != body.neighbour.shape:
        raise InputError("growth: expected slow growth, move(…, events=…), on these points")
    return _parted(body, np.asarray(growth.details))


def _parted(body: LatticeBody, neighbour: np.ndarray) -> np.ndarray:
    cut = (neighbour < 0) & (body.neighbour >= 0)
    node, bond = np.nonzero(cut & (body.r < 1.5 * body.spacing))
    other = body.neighbour[node, bond]
    return np.stack([node, other], axis=1)[node < other]


def _pairs(broken: ArrayLike | None, count: int) -> np.ndarray:
    """Pairs of nodes as one number each, whichever stands first."""
    if broken is None:
        return np.zeros(0, int)
    given = checked("broken", broken, float)
    whole = given.astype(int)
    if given.ndim != 2 or given.shape[1] != 2 or (whole != given).any():
        raise InputError(f"broken: expected pairs of nodes [n, 2], got {list(given.shape)}")
    if len(given) and not (whole.min() >= 0 and whole.max() < count):
        raise InputError(f"broken: expected numbers of nodes below {count}")
    return np.unique(_key(whole[:, 0], whole[:, 1], count))


def _key(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """One number a pair, the same for both orders."""
    return np.asarray(np.minimum(first, second) * count + np.maximum(first, second))
