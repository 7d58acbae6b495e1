"""Dressed bodies that are uneven, end at edges or are broken (theory.md, D9–D11, D22)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import eigsh, splu

from warp_peri.core.grid import Grid, grid_of
from warp_peri.dressed.bases import composed, half, spread
from warp_peri.dressed.broken import key, pairs
from warp_peri.dressed.grains import Grains, grains_of
from warp_peri.dressed.outline import cut_elements
from warp_peri.dressed.rest import at_rest
from warp_peri.dressed.sweeps import ByLayers
from warp_peri.errors import InputError
from warp_peri.points.arrays import checked
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.statics.settings import Solver
from warp_peri.statics.solution import Solution

if TYPE_CHECKING:
    from warp_peri.dressed.law import DressedSolid

Edges = bool | Callable[[np.ndarray], np.ndarray]
"""Whether a body may end before its bonds do; or which positions [n, d] lie inside, [n] bool."""


class DressedBody:
    """L = Σ_a Gᵗ K_a G on the nodes of one body, K of the sites and strains that are there.

    Made by DressedSolid.on. No eigenvalue is negative and no rigid motion costs anything,
    whatever is missing (theory.md, D10).

    Args:
        solid: the law.
        points: nodes on a lattice of its spacing, or periodic; those that are not interior are
            held.
        edges, maps, broken, grains, dtype: as of DressedSolid.on.

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
        self.factors = self._factors(maps or {}) * (self.share > 0)
        torn = pairs(broken, count)
        self._there, self._linked = self._sites(torn)
        if not edges:
            self._refuse_edges()
        alive = bool((self.factors > 0).any(axis=0).all())
        self._even = (
            alive and len(self.laws) == 1 and not edges and not len(torn)
        )  # whole rows of G at every unknown
        self.dtype = np.dtype(dtype)
        if self.dtype != np.float64 and not (self.dtype == np.float32 and self._sweep):
            raise InputError(
                "dtype: expected float64, or float32 of a sheet with or without maps that nothing "
                f"cuts, got {self.dtype}"
            )

    def stiffest_wave(self) -> float:
        """A bound on the eigenvalues of L [stress / length²], for time steps.

        Of sheets and blocks with maps alone it is proven, the even solid's times the largest map;
        of others the largest eigenvalue, to a thousandth.
        """
        if self._even:
            return float(self.factors.max()) * self.model.stiffest_wave()
        value = eigsh(self.L, 1, which="LA", tol=1e-4, return_eigenvectors=False)
        return float(1.001 * value[0])

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
        """G of tensors of each grain [g, H, d, d]: a row is of its node's own grain, and the
        identity where a neighbour is not there; torn pairs ±ξ are left out."""
        count, d = self.points.x.shape
        neighbour = self._neighbours(self._steps)
        full = np.array((neighbour >= 0).all(axis=1), bool)
        full[self._corner[self.share < 1].ravel()] = False  # which an outline cuts
        half = len(self.model.steps)
        whole = np.array([full & self._whole(step) for step in self._steps])
        whole = np.tile(whole[:half] & whole[half:], (2, 1))
        bond, node = np.nonzero(whole)
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

    def part(self, number: int, factor: np.ndarray) -> sp.csr_array:
        """K_a of one part with a factor at each site, [N]: symmetric, [d N, d N]."""
        base = self.model.parts
        inner = sp.csr_array((self.strains.shape[0],) * 2)
        for share, M in self.tensors(number):
            weight = sp.diags_array(share * factor)
            inner = inner + sp.kron(weight, sp.csr_array(M), format="csr")
        if self.gram is not None:  # M = 1 ⊗ P / 2^d becomes W ⊗ P
            place = np.arange(len(factor) + 1)
            W = sp.bsr_array((self.gram * len(self.gram[0]), place[:-1], place))
            inner = inner @ sp.kron(W, sp.eye_array(len(base.strains) // len(self.gram[0])))
        return sp.csr_array(self.strains.T @ (inner @ self.strains))

    @cached_property
    def dressings(self) -> list[sp.csr_array]:
        """G, or one for each part, [d N, d N]."""
        return [self._dressing(g) for g in np.stack([law.tensors for law in self.laws], axis=1)]

    @cached_property
    def _sweep(self) -> tuple[Grid, ByLayers] | None:
        """L by rows, of sheets that nothing cuts."""
        law = self.model
        if not (self._even and law.layered and law.dimension == 2):
            return None
        nodes = grid_of(self.points, law.crystal.steps)
        factors = np.ones((len(self.factors), int(np.prod(nodes.shape))))
        factors[:, nodes.place] = self.factors[:, nodes.near]
        factors = factors.reshape(-1, *nodes.shape)
        if nodes.periodic:
            factors = np.pad(factors, [(0, 0), *[(nodes.reach,) * 2] * 2], mode="wrap")
        return nodes, ByLayers(
            nodes, law.steps, law.tensors[0], law.parts, law.spacing, factors, self.dtype
        )

    @cached_property
    def layers(self) -> list[sp.csr_array]:
        """K of each G, [d N, d N]."""
        each = [self.part(a, factor) for a, factor in enumerate(self.factors)]
        return each if len(self.dressings) > 1 else [sp.csr_array(sum(each[1:], each[0]))]

    @cached_property
    def stiffness(self) -> np.ndarray:
        """Diagonal of K, zero where nothing belongs to a node, [N, d]."""
        each = np.sum([K.diagonal() for K in self.layers], axis=0)
        return np.asarray(each.reshape(self.points.x.shape))

    def in_turn(self, flat: np.ndarray) -> np.ndarray:
        """L of columns [d N, S] by G, K and G in turn."""
        each = [G.T @ (K @ (G @ flat)) for G, K in zip(self.dressings, self.layers)]
        return np.asarray(np.sum(each, axis=0))

    @cached_property
    def L(self) -> sp.csr_array:
        """[d N, d N], symmetric, [stress/length²]; vectors are along the nodes' axes."""
        dressed = [G.T @ (K @ G) for G, K in zip(self.dressings, self.layers)]
        L = sum(dressed[1:], dressed[0])
        return sp.csr_array((L + L.T) / 2)

    def __call__(self, u: ArrayLike) -> np.ndarray:
        """L u at the interior nodes [stress/length], shape [..., N, d] to [..., I, d]."""
        if self._sweep is not None:
            nodes, sweep = self._sweep
            found = nodes.gather(sweep(nodes.scatter(self.fields(u), self.dtype)))
            return found.reshape(*np.shape(u)[:-2], *found.shape[1:])
        flat = self.flat(u)
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
        flat = self.flat(u)
        volume = self.points.spacing ** self.points.x.shape[1]
        total = 0.5 * volume * np.einsum("sn,sn->s", flat, (self.L @ flat.T).T)
        return float(total[0]) if np.ndim(u) == 2 else total.reshape(np.shape(u)[:-2])

    def stress(self, u: ArrayLike) -> None:
        """None: strains lie on sites, not on nodes."""

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """In equilibrium with b on the interior, u given elsewhere, shape [..., N, d]; as in
        rest.at_rest."""
        return at_rest(self, b, u, solver)

    def fields(self, u: ArrayLike) -> np.ndarray:
        """Fields [S, N, d] of finite numbers."""
        values = checked("u", u, float)
        if values.ndim < 2 or values.shape[-2:] != self.points.x.shape:
            raise InputError(
                f"u: expected shape [..., {', '.join(map(str, self.points.x.shape))}], got "
                f"{list(values.shape)}"
            )
        return values.reshape(-1, *self.points.x.shape)

    def flat(self, u: ArrayLike) -> np.ndarray:
        """Fields along the nodes' axes, one a row, [S, d N]."""
        fields = self.fields(u)
        return np.asarray((fields @ self.axes).reshape(len(fields), -1))
