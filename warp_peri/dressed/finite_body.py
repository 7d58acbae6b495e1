"""A dressed sheet at finite strain on its nodes: force, tangent, energy, rest (theory.md, D14)."""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.dressed.finite import STEPS, FiniteSolid, curvature, density, strains, stress
from warp_peri.dressed.finite_sweeps import ByElements
from warp_peri.errors import InputError
from warp_peri.points.arrays import checked, checked_fields
from warp_peri.points.axis import axis_of
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.samples import PointsLike
from warp_peri.stability.solvability import smallest_eigenvalue
from warp_peri.statics.equilibria import SOLVES, Equilibria, figures_of, solve_each, warn_beyond
from warp_peri.statics.linear import Linear
from warp_peri.statics.settings import Newton, Solver, refuse_solver
from warp_peri.statics.solution import Solution

CORNERS = np.array(list(itertools.product((0, 1), repeat=2)))
WEIGHT = 1 / 4
"""Of a Gauss point, in parts of h²."""


class Slopes:
    """Gradients of convolved displacement at the Gauss points of a lattice's elements.

    Args:
        points: lattice nodes with a collar, or periodic.

    Attributes:
        near: four neighbours of each node along the axes and four across, −1 for none, [N, 8].
        corner: nodes of the elements, [E, 4].
        slope: ∂₁ and ∂₂ of their shape functions at four Gauss points, [8, 4].
        plain: slopes of the nodes' values, [8 E, N]: of each element and Gauss point ∂₁ and ∂₂.
        shells: what G and F add, by neighbours along the axes and across: of a field u
            Σ (u(x + ξ) − u(x)), [N, N] each.
        around: elements around each node, in parts of one, [I, E].

    Raises InputError for nodes without a collar of three spacings.
    """

    def __init__(self, points: PointsLike) -> None:
        grid, axes = lattice_steps(points)
        count = len(grid)
        box = getattr(points, "box", None)
        period = None if box is None else np.rint(np.asarray(box) / points.spacing).astype(int)
        near = neighbour_table(grid, np.concatenate([STEPS, -STEPS]), period)
        corner = neighbour_table(grid, CORNERS, period)
        inside = points.interior
        moved = inside | np.append(inside, False)[near].any(axis=1)
        kept = np.append(moved, False)[corner].any(axis=1)
        corner = corner[kept]
        asked = moved | np.isin(np.arange(count), corner)
        lacking = asked & (near < 0).any(axis=1)
        first = neighbour_table(grid, CORNERS - 1, period)[moved]  # elements that touch a node
        if lacking.any() or (corner < 0).any() or (first < 0).any():
            raise InputError(
                "points: some interior nodes have cut bonds; give a collar of three spacings each "
                f"way, {3 * points.spacing:g}, or a period"
            )
        self.near = near[:, [0, 1, 4, 5, 2, 3, 6, 7]]  # along the axes, then across
        self.corner, self.slope = corner, _slope(points.spacing, axes)
        self.plain = _slopes(corner, count, self.slope)
        self.shells = [_shell(near[:, pair], count) for pair in ([0, 1, 4, 5], [2, 3, 6, 7])]
        whole = np.full(corner.shape, 0.25).ravel()
        numbers = np.repeat(np.arange(len(corner)), 4)
        around = sp.csr_array((whole, (corner.ravel(), numbers)), shape=(count, len(corner)))
        self.around = around[np.flatnonzero(inside)]

    def of(self, along: float, across: float) -> sp.csr_array:
        """Slopes after one convolution, [8 E, N]."""
        first, second = (self.plain @ shell for shell in self.shells)
        return sp.csr_array(self.plain + along * first + across * second)


def gradients(D: sp.csr_array, u: np.ndarray) -> np.ndarray:
    """H at the Gauss points of fields [S, N, 2], [S, 4 E, 2, 2]."""
    count = len(u)
    flat = D @ u.transpose(1, 2, 0).reshape(u.shape[1], -1)
    return np.asarray(flat.reshape(-1, 2, 2, count).transpose(3, 0, 2, 1))


def gathered(D: sp.csr_array, P: np.ndarray) -> np.ndarray:
    """What stresses [S, 4 E, 2, 2] pull at nodes, D of those nodes' columns: [S, I, 2]."""
    count = len(P)
    flat = P.transpose(1, 3, 2, 0).reshape(D.shape[0], -1)
    return np.asarray((WEIGHT * (D.T @ flat)).reshape(-1, 2, count).transpose(2, 0, 1))


class FiniteBody:
    """The operator of a FiniteSolid on nodes, made by its `on`; b in equilibrium.

    Attributes:
        parts: slopes under G and F, with Ψ₂'' and Ψ₃''' of each.

    Raises InputError as FiniteSolid.on.
    """

    def __init__(self, solid: FiniteSolid, points: PointsLike) -> None:
        self.points, self.model = solid.at_rest.crystal.fitting(points), solid
        self.slopes = Slopes(self.points)
        axis = axis_of(self.points) if solid.q3 else 0.0
        none = np.zeros((3, 3, 3))
        self.parts = (
            (self.slopes.of(solid.along, solid.across), solid.second(), none),
            (self.slopes.of(solid.share, 0.0), np.zeros((3, 3)), solid.third(axis)),
        )
        filters = ((solid.along, solid.across), (solid.share, 0.0))
        each = tuple((*pair, C, T) for pair, (_, C, T) in zip(filters, self.parts))
        of = self.slopes
        self._sweep = ByElements(of.near, of.corner, of.slope, WEIGHT, each)
        unknown = np.flatnonzero(self.points.interior)
        self.columns = [sp.csr_array(D.tocsc()[:, unknown]) for D, _, _ in self.parts]

    def __call__(self, u: ArrayLike) -> np.ndarray:
        """Minus the internal force density [stress/length], [..., N, 2] to [..., I, 2]."""
        return self._force(self._fields(u)).reshape(*np.shape(u)[:-2], -1, 2)

    def _force(self, fields: np.ndarray) -> np.ndarray:
        return np.asarray(self._sweep(fields)[:, self.points.interior])

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on the interior nodes, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

    def energy(self, u: ArrayLike) -> np.ndarray:
        """[stress · length²] of the elements that interior nodes move, shape [...] (D14)."""
        fields = self._fields(u)
        each = [density(strains(gradients(D, fields))[0], C, T) for D, C, T in self.parts]
        total = WEIGHT * self.points.spacing**2 * np.sum(each, axis=0).sum(axis=-1)
        return np.asarray(total.reshape(np.shape(u)[:-2]))

    def stress(self, u: ArrayLike) -> np.ndarray:
        """P [stress] at the interior nodes, the mean of four elements, [..., I, 2, 2]."""
        fields = self._fields(u)
        P = sum(stress(gradients(D, fields), C, T) for D, C, T in self.parts)
        mean = np.asarray(P).reshape(len(fields), -1, 4, 4).mean(axis=2)
        found = np.stack([self.slopes.around @ one for one in mean])
        return found.reshape(*np.shape(u)[:-2], -1, 2, 2)

    def tangent(self, u: ArrayLike) -> sp.csr_array:
        """∂(op(u))/∂u at a field [N, 2], symmetric on the unknowns: [2 I, 2 N]."""
        fields = self._fields(u)
        found = []
        for own, (D, C, T) in zip(self.columns, self.parts):
            A = curvature(gradients(D, fields)[0], C, T)
            blocks = A.transpose(0, 2, 1, 4, 3).reshape(-1, 4, 4)  # rows and columns (j, i)
            place = np.arange(len(blocks) + 1)
            middle = sp.bsr_array((WEIGHT * blocks, place[:-1], place), shape=(4 * len(A),) * 2)
            left, right = (sp.kron(one, sp.eye_array(2), format="csr") for one in (own, D))
            found.append(left.T @ (middle.tocsr() @ right))
        return sp.csr_array(found[0] + found[1])

    def product(self, u: ArrayLike, v: ArrayLike) -> np.ndarray:
        """The derivative at u along v, shape [..., I, 2]."""
        pairs = zip(self._fields(u), self._fields(v), strict=True)
        rates = [self.tangent(f) @ a.ravel() for f, a in pairs]
        return np.reshape(rates, (*np.shape(u)[:-2], -1, 2))

    def largest_gradient(self, u: ArrayLike) -> np.ndarray:
        """Largest |H| of each field under G or F at a Gauss point, shape [...]."""
        fields = self._fields(u)
        sizes = [np.linalg.norm(gradients(D, fields), axis=(2, 3)) for D, _, _ in self.parts]
        return np.asarray(np.max(sizes, axis=(0, 2)).reshape(np.shape(u)[:-2]))

    @cached_property
    def _at_rest(self) -> Linear:
        return Linear(self.model.at_rest.crystal.stencil, self.points)

    def straight(self, u: ArrayLike) -> np.ndarray:
        """The force of the solid at rest, shape [..., I, 2]."""
        return self._at_rest(self._fields(u)).reshape(*np.shape(u)[:-2], -1, 2)

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """In equilibrium with b on the interior, u given on the collar, shape [..., N, 2].

        A UserWarning says where |H| exceeds the proven strain. The details of the solution are a
        NonlinearRecord for each sample.

        Raises InputError for another solver, a body that nothing holds, and a sample for which no
        equilibrium was found.
        """
        refuse_solver(solver, (Newton,), "a dressed solid at finite strain")
        asked = solver if isinstance(solver, Newton) else Newton()
        inside = self.points.interior
        if inside.all():
            raise InputError("interior: expected some nodes that are held, got none")
        b, u = checked_fields(self.points, b, u)
        answers, loads = (field.reshape(-1, *self.points.x.shape) for field in (u, b))
        inverse = self._at_rest.cheapest_inverse(SOLVES * len(answers))
        way = Equilibria(lambda field: self._force(field[None])[0], self.straight, inverse, inside)
        proven = self.model.proven_strain(self.points.spacing)
        smallest, largest = self._smallest if asked.eigenvalues else None, self.largest_gradient
        records, sure = solve_each(
            way, loads[:, inside], answers, asked.tolerance, proven, largest, smallest
        )
        warn_beyond(records, proven)
        return Solution(
            answers.reshape(np.shape(u)),
            self.points,
            self,
            self.load(b),
            ", ".join(sorted({record.method for record in records})),
            tuple(record.solves for record in records),
            sure,
            details=tuple(records),
            measured=max((record.residual for record in records), default=None),
        )

    def figures(self, solution: Solution) -> dict[str, Any]:
        """What solves took, and whether their answers are the only ones, for `evaluate`."""
        return figures_of(solution.details)

    def _smallest(self, field: np.ndarray) -> float:
        """Smallest eigenvalue of the tangent on the unknowns."""
        free = np.repeat(self.points.interior, 2)
        return smallest_eigenvalue(sp.csc_array(self.tangent(field).tocsc()[:, free]))

    def _fields(self, u: ArrayLike) -> np.ndarray:
        """Fields [S, N, 2] of finite numbers."""
        values = checked("u", u, float)
        if values.ndim < 2 or values.shape[-2:] != self.points.x.shape:
            expected = ", ".join(map(str, self.points.x.shape))
            raise InputError(f"u: expected shape [..., {expected}], got {list(values.shape)}")
        return values.reshape(-1, *self.points.x.shape)


def _slope(spacing: float, axes: np.ndarray) -> np.ndarray:
    """∂₁ and ∂₂ of an element's shape functions at four Gauss points, [8, 4]."""
    side, values = 2 * CORNERS - 1, []
    for y in itertools.product((0.5 - 12**-0.5, 0.5 + 12**-0.5), repeat=2):
        along = np.where(CORNERS == 1, y, 1 - np.array(y))
        values.append(axes @ np.array([side[:, 0] * along[:, 1], side[:, 1] * along[:, 0]]))
    return np.array(values).reshape(8, 4) / spacing


def _slopes(corner: np.ndarray, count: int, slope: np.ndarray) -> sp.csr_array:
    """Of bilinear elements at four Gauss points, [8 E, N]."""
    size = len(corner)
    row = np.repeat(np.arange(8 * size), 4)
    column = np.repeat(corner, 8, axis=0).ravel()
    value = np.tile(slope, (size, 1)).ravel()
    return sp.csr_array((value, (row, column)), shape=(8 * size, count))


def _shell(near: np.ndarray, count: int) -> sp.csr_array:
    """Σ (u(x + ξ) − u(x)) over neighbours [N, 4], at nodes that have them all."""
    node = np.flatnonzero((near >= 0).all(axis=1))
    row = np.repeat(node, near.shape[1])
    ones = np.ones(len(row))
    total = sp.csr_array((ones, (row, near[node].ravel())), shape=(count, count))
    return total - sp.csr_array((ones, (row, row)), shape=(count, count))
