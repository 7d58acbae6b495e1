"""Dressed sheets at finite strain: numbers, force, equilibria and fit (theory, Dr14–Dr20)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from warp_peri.contract import MaterialFit, OnPoints
from warp_peri.core.elastic import from_voigt, plane_isotropic
from warp_peri.core.record import Length, Record, Stress
from warp_peri.dressed.law import DressedSolid, third_order_moduli
from warp_peri.errors import InputError
from warp_peri.kernels.dressed.finite import gather, pull, spread
from warp_peri.launch import floats, ints, launch_slices
from warp_peri.micromodulus.learning import one_set
from warp_peri.points.arrays import checked_fields, plain
from warp_peri.points.dataset import Dataset
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.samples import PointsLike, Samples, axis_of
from warp_peri.points.unit_names import USUAL, Units, shown_moduli, symbols
from warp_peri.stability.certificate import smallest_eigenvalue
from warp_peri.statics.equilibria import SOLVES, Equilibria, figures_of, solve_each, warn_beyond
from warp_peri.statics.linear import Inverse, Linear
from warp_peri.statics.solution import Newton, Solution, Solver, refuse_solver
from warp_peri.third_order.material import CUBIC
from warp_peri.third_order.smoothing import Smoothing
from warp_peri.third_order.uniqueness import curvature_bound, largest_parts

STEPS = np.array([[0, 1], [1, 0], [1, -1], [1, 1]])
"""One half of the neighbours of G: along the axes, and across."""
MARGIN, HALVINGS = 0.999, 60
"""Part of the stiffness that curvature may take; steps of the search for the strain."""


@dataclass(frozen=True, eq=False, repr=False)
class FiniteSolid(Record, format="warp_peri.dressed_finite"):
    """A sheet with the energy Ψ₂(E(∇G u)) + Ψ₃(E(∇F u)), E the Green strain (Dr14).

    Attributes:
        spacing: of the nodes, h, in the unit of length.
        lam, mu: λ and μ of Ψ₂ [stress].
        along, across: of G, what it takes from each of four neighbours along the nodes' axes and of
            four across.
        share: of F, what it takes from each of four neighbours along the axes.
        t3, tq2, q3: third-order constants of Ψ₃ [stress], q3 in the frame of the crystal, whose
            zigzag direction the points state (Points.axis).
        units: names of the units of length and stress.
        provenance: how it came to be; plain JSON values.

    Raises InputError for what is no finite number, and a spacing or moduli that are no solid's.
    """

    spacing: Length
    lam: Stress
    mu: Stress
    along: float
    across: float
    share: float
    t3: Stress
    tq2: Stress
    q3: Stress
    units: Units = USUAL
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.mu > 0 and self.lam + self.mu > 0):
            raise InputError(
                "moduli: expected spacing, μ and λ + μ > 0, got "
                f"{self.spacing:g}, {self.mu:g} and {self.lam + self.mu:g}"
            )

    @property
    def dimension(self) -> int:
        """2."""
        return 2

    @property
    def horizon(self) -> float:
        """Length of the longest bond of the tangent, which a collar must hold."""
        return 3 * 2**0.5 * self.spacing

    @cached_property
    def at_rest(self) -> DressedSolid:
        """The tangent at rest: elements of λ and μ under G."""
        C = plane_isotropic(self.lam, self.mu)
        g = np.array([self.along, self.along, self.across, self.across])
        tensors = g[None, :, None, None] * np.eye(2)
        return DressedSolid(
            self.spacing, "elements", C, STEPS, tensors, self.units, "isotropic", 0.0
        )

    def second(self) -> np.ndarray:
        """Ψ₂'' as a matrix of E₁₁, E₂₂, 2E₁₂ [stress], [3, 3]."""
        return np.asarray(self.at_rest.elastic)

    def third(self, axis: float) -> np.ndarray:
        """Ψ₃''' of the same strains [stress], [3, 3, 3], of a crystal at an angle [rad]."""
        return third_derivatives(self.t3, self.tq2, self.q3 * np.exp(-6j * axis))

    @cached_property
    def strain(self) -> float:
        """Largest |H| up to which solutions are proven unique on any finite set of nodes; 0 where
        nothing is proven (Dr17–Dr18)."""
        corner = np.array([0.0, 2.0, 0.0, 2.0]), np.array([0.0, 0.0, 2.0, 2.0])
        x, y = corner  # 1 − cos k_a h, in which Ĝ is bilinear and F̂ linear
        G = 1 - 2 * self.along * (x + y) - 4 * self.across * (x + y - x * y)
        F = 1 - 2 * self.share * (x + y)
        if not G.min() > 0:
            return 0.0
        ratio = float(np.abs(F / G).max())
        stiff = min(self.mu, self.mu + 2 * (self.lam + self.mu))
        plain = largest_parts(SimpleNamespace(numbers=(self.lam, self.mu, 0, 0, 0, 0)))
        cubic = largest_parts(SimpleNamespace(numbers=(0, 0, self.t3, self.tq2, self.q3, 0)))
        parts = [one + ratio**2 * three for one, three in zip(plain, cubic)]
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            small = curvature_bound(parts, middle) < MARGIN * stiff
            low, high = (middle, high) if small else (low, middle)
        return low

    def proven_strain(self, spacing: float) -> float:
        """The same on nodes of a spacing; 0 on others than the law's own."""
        return self.strain if abs(spacing / self.spacing - 1) < 1e-6 else 0.0

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        length = symbols(self.units)[0]
        constants = shown_moduli(self.units, (getattr(self, name) for name in CUBIC))
        proven = f"one solution up to |H| = {self.strain:.2%}" if self.strain else "nothing"
        return [
            ("spacing", f"{self.spacing:g} {length}"),
            ("λ, μ", shown_moduli(self.units, (self.lam, self.mu))),
            (", ".join(CUBIC), constants),
            ("G; F", f"{self.along:.4g}, {self.across:.4g}; {self.share:.4g}"),
            ("proven", proven),
        ]

    def on(self, points: PointsLike) -> FiniteBody:
        """The operator on nodes of the law's own spacing, with a collar or periodic.

        Raises InputError for another spacing or units, and nodes without that collar.
        """
        return FiniteBody(self, points)


def third_derivatives(t3: float, tq2: float, q3: complex) -> np.ndarray:
    """Of t3 t³ + tq2 t |q|² + Re(q3 q³) to E₁₁, E₂₂ and 2E₁₂, [3, 3, 3] (Dr15)."""
    K = np.zeros((3, 3, 3))  # of t, Re q and Im q
    K[0, 0, 0] = 6 * t3
    for one in (1, 2):
        K[0, one, one] = K[one, 0, one] = K[one, one, 0] = 2 * tq2
    K[1, 1, 1], K[2, 2, 2] = 6 * q3.real, 6 * q3.imag
    K[1, 2, 2] = K[2, 1, 2] = K[2, 2, 1] = -6 * q3.real
    K[1, 1, 2] = K[1, 2, 1] = K[2, 1, 1] = -6 * q3.imag
    A = np.array([[1, 1, 0], [0.5, -0.5, 0], [0, 0, 0.5]])
    return np.asarray(np.einsum("abc,ai,bj,ck->ijk", K, A, A, A))


def unit_energies(axis: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Second and third derivatives of an energy of λ, of μ, t3, tq2 or q3 of one, at an angle."""
    none, turn = np.zeros((3, 3, 3)), np.exp(-6j * axis)
    plain = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0.0]]), np.diag([2.0, 2.0, 1.0])
    three = [third_derivatives(*row) for row in ((1, 0, 0j), (0, 1, 0j), (0, 0, turn))]
    return [*((C, none) for C in plain), *((np.zeros((3, 3)), T) for T in three)]


def strains(H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """E₁₁, E₂₂, 2E₁₂ of displacement gradients [..., 2, 2], and their derivatives to H:
    [..., 3] and [..., 3, 2, 2]."""
    F = H + np.eye(2)
    E = (H + np.swapaxes(H, -1, -2) + np.einsum("...ki,...kj->...ij", H, H)) / 2
    e = np.stack([E[..., 0, 0], E[..., 1, 1], 2 * E[..., 0, 1]], axis=-1)
    V = np.zeros((*e.shape, 2, 2))
    V[..., 0, :, 0], V[..., 1, :, 1] = F[..., 0], F[..., 1]
    V[..., 2, :, 0], V[..., 2, :, 1] = F[..., 1], F[..., 0]
    return e, V


def density(e: np.ndarray, C: np.ndarray, T: np.ndarray) -> np.ndarray:
    """½ C e e + ⅙ T e e e [stress], of strains [..., 3]."""
    return np.asarray(np.einsum("...i,...i->...", e, e @ C / 2 + _twice(e, T) / 6))


def stress(H: np.ndarray, C: np.ndarray, T: np.ndarray) -> np.ndarray:
    """P = ∂Ψ/∂H [stress], of gradients [..., 2, 2]."""
    a, b, c, d = np.moveaxis(H.reshape(*H.shape[:-2], 4), -1, 0)
    e = np.stack([a + (a * a + c * c) / 2, d + (b * b + d * d) / 2, b + c + a * b + c * d], -1)
    a, d = 1 + a, 1 + d  # F
    first, second, shear = np.moveaxis(e @ C + _twice(e, T) / 2, -1, 0)
    P = np.empty_like(H)
    P[..., 0, 0], P[..., 0, 1] = a * first + b * shear, a * shear + b * second
    P[..., 1, 0], P[..., 1, 1] = c * first + d * shear, c * shear + d * second
    return P


def curvature(H: np.ndarray, C: np.ndarray, T: np.ndarray) -> np.ndarray:
    """∂P/∂H [stress], [..., 2, 2, 2, 2]."""
    e, V = strains(H)
    s = e @ C + _twice(e, T) / 2
    S = np.stack([np.stack([s[..., 0], s[..., 2]], -1), np.stack([s[..., 2], s[..., 1]], -1)], -2)
    D = C + np.tensordot(e, T, 1)
    turned = np.einsum("ik,...jl->...ijkl", np.eye(2), S)
    return np.asarray(turned + np.einsum("...vij,...vw,...wkl->...ijkl", V, D, V, optimize=True))


def _twice(e: np.ndarray, T: np.ndarray) -> np.ndarray:
    """T e e, [..., 3]."""
    if not T.any():
        return np.zeros_like(e)
    x, y, z = np.moveaxis(e, -1, 0)
    pairs = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=-1)
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return np.asarray(pairs @ T[:, rows, columns].T)


Filter = tuple[float, float, np.ndarray, np.ndarray]
"""What a convolution takes from neighbours along and across, and C and T of its energy."""
PAIRS = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])


class ByElements:
    """Σ over filters of Gᵗ f(G u) with the pulls f of square elements.

    Args:
        near: neighbours of each node along the axes and across, −1 where none is, [N, 8].
        corner: nodes of each element, [E, 4].
        slope: ∂₁ and ∂₂ of its shape functions at each Gauss point, [8, 4].
        weight: of a Gauss point.
        filters: convolutions and energies.
    """

    def __init__(
        self,
        near: np.ndarray,
        corner: np.ndarray,
        slope: np.ndarray,
        weight: float,
        filters: tuple[Filter, ...],
    ) -> None:
        self.count, self.elements, self.weight = len(near), len(corner), weight
        around = np.full((len(near), 4), -1)
        for k in range(4):  # the element of which a node is the k-th corner
            around[corner[:, k], k] = 4 * np.arange(len(corner)) + k
        self.near, self.corner, self.around = ints(near), ints(corner), ints(around)
        self.slope = _table(slope)
        self.filters = [
            (along, across, _table(C), _table(T[:, PAIRS[0], PAIRS[1]]))
            for along, across, C, T in filters
        ]

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """The force of fields [S, N, 2], right where all neighbours are there."""
        samples, total = len(u), np.zeros_like(u)
        given = floats(np.ascontiguousarray(u), wp.vec2d)
        nodes, force, back = (np.empty((samples, self.count, 2)) for _ in range(3))
        pulls = np.empty((samples, 4 * self.elements, 2))
        for along, across, C, T in self.filters:
            moved = floats(nodes, wp.vec2d)
            self._launch(spread, self.count, (self.near, along, across, given), moved, samples)
            each = floats(pulls, wp.vec2d)
            inputs = (self.corner, self.slope, C, T, self.weight, moved)
            self._launch(pull, self.elements, inputs, each, samples)
            summed = floats(force, wp.vec2d)
            self._launch(gather, self.count, (self.around, each), summed, samples)
            out = floats(back, wp.vec2d)
            self._launch(spread, self.count, (self.near, along, across, summed), out, samples)
            total += back
        return total

    def _launch(self, kernel: Any, count: int, inputs: Any, out: Any, samples: int) -> None:
        launch_slices(kernel, count, inputs, (out,), samples=samples, weight=4)


def _table(values: np.ndarray) -> Any:
    return floats(np.ascontiguousarray(values, dtype=float))


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


class FiniteBody(OnPoints):
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

    def force(self, u: ArrayLike) -> np.ndarray:
        """Minus the internal force density [stress/length], [..., N, 2] to [..., I, 2]."""
        return self._force(self.fields(u)).reshape(*np.shape(u)[:-2], -1, 2)

    def _force(self, fields: np.ndarray) -> np.ndarray:
        return np.asarray(self._sweep(fields)[:, self.points.interior])

    def energy(self, u: ArrayLike) -> np.ndarray:
        """[stress · length²] of the elements that interior nodes move, shape [...] (Dr14)."""
        fields = self.fields(u)
        each = [density(strains(gradients(D, fields))[0], C, T) for D, C, T in self.parts]
        total = WEIGHT * self.points.spacing**2 * np.sum(each, axis=0).sum(axis=-1)
        return np.asarray(total.reshape(np.shape(u)[:-2]))

    def stress(self, u: ArrayLike) -> np.ndarray:
        """P [stress] at the interior nodes, the mean of four elements, [..., I, 2, 2]."""
        fields = self.fields(u)
        P = sum(stress(gradients(D, fields), C, T) for D, C, T in self.parts)
        mean = np.asarray(P).reshape(len(fields), -1, 4, 4).mean(axis=2)
        found = np.stack([self.slopes.around @ one for one in mean])
        return found.reshape(*np.shape(u)[:-2], -1, 2, 2)

    def tangent(self, u: ArrayLike) -> sp.csr_array:
        """∂(op(u))/∂u at a field [N, 2], symmetric on the unknowns: [2 I, 2 N]."""
        fields = self.fields(u)
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
        pairs = zip(self.fields(u), self.fields(v), strict=True)
        rates = [self.tangent(f) @ a.ravel() for f, a in pairs]
        return np.reshape(rates, (*np.shape(u)[:-2], -1, 2))

    def product_transpose(self, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """The transposed product with w on the interior [..., I, 2], on all nodes [..., N, 2]."""
        fields, w = self.fields(u), plain("w", w)
        pairs = zip(fields, w.reshape(len(fields), -1), strict=True)
        return np.reshape([self.tangent(f).T @ one for f, one in pairs], np.shape(u))

    @property
    def learnable(self) -> dict[str, float]:
        """λ and μ, and the constants of third order [stress]."""
        return {name: getattr(self.model, name) for name in ("lam", "mu", *CUBIC)}

    def at(self, numbers: Mapping[str, Any]) -> FiniteBody:
        """The same with other moduli and constants; InputError for no solid's."""
        own: dict[str, Any] = {name: float(value) for name, value in numbers.items()}
        return FiniteBody(replace(self.model, **own | {"provenance": {}}), self.points)

    def by_numbers(self, name: str, u: ArrayLike, w: ArrayLike) -> float:
        """The derivative of Σ w · force(u) to a number, of fields [K, N, 2], weights [K, I, 2]."""
        number = list(self.learnable).index(name)
        (D, _, _), own = self.parts[number > 1], self.columns[number > 1]
        kinds = unit_energies(axis_of(self.points) if name == "q3" else 0.0)
        force = gathered(own, stress(gradients(D, self.fields(u)), *kinds[number]))
        return float(np.sum(force * np.asarray(w)))

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of the solid at rest, of a load on the interior."""
        return self._at_rest.cheapest_inverse(SOLVES * loads)

    def largest_gradient(self, u: ArrayLike) -> np.ndarray:
        """Largest |H| of each field under G or F at a Gauss point, shape [...]."""
        fields = self.fields(u)
        sizes = [np.linalg.norm(gradients(D, fields), axis=(2, 3)) for D, _, _ in self.parts]
        return np.asarray(np.max(sizes, axis=(0, 2)).reshape(np.shape(u)[:-2]))

    @cached_property
    def _at_rest(self) -> Linear:
        return Linear(self.model.at_rest.crystal.stencil, self.points)

    def straight(self, u: ArrayLike) -> np.ndarray:
        """The force of the solid at rest, shape [..., I, 2]."""
        return self._at_rest(self.fields(u)).reshape(*np.shape(u)[:-2], -1, 2)

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
            raise InputError(
                "interior: expected nodes that are held: no periodic problem is solved"
            )
        b, u = checked_fields(self.points, b, u)
        answers, loads = (field.reshape(-1, *self.points.x.shape) for field in (u, b))
        inverse = self.inverse(len(answers))
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


CONVERGED, ISOTROPIC = 1e-8, 1e-6
"""Relative, of the loss, and of moduli."""
STEP = 1e-4
"""Of differences of the loss to along, across and share."""


@dataclass(frozen=True)
class FiniteStrain:
    """W = Ψ₂(E(∇G u)) + Ψ₃(E(∇F u)) of an isotropic sheet with third-order constants (Dr14).

    Attributes:
        moduli: a Voigt matrix [stress], or the Smoothing of the data, of which those of their long
            waves are found with third order taken off (Dr20). They are held.
    """

    moduli: Any

    def learn(self, samples: Samples | Dataset, *, progress: bool | None = None) -> MaterialFit:
        """The fit on one set of samples, which state the crystal's axis.

        Raises InputError for samples without a collar, without loads, or in space, and for moduli
        that are not isotropic.
        """
        return fit_finite(one_set(samples), self.moduli)


def fit_finite(samples: Samples, moduli: Any) -> MaterialFit:
    """The numbers that fit L u = b best, each sample weighed by 1/‖b‖; as FiniteStrain.learn."""
    found = _FiniteFit(samples)
    C = third_order_moduli(samples, moduli) if isinstance(moduli, Smoothing) else from_voigt(moduli)
    pair = np.array([C[0, 0, 1, 1], C[0, 1, 0, 1]])
    if C.shape != (2,) * 4 or abs(C[0, 0, 0, 0] - pair[0] - 2 * pair[1]) > ISOTROPIC * pair[1]:
        raise InputError("moduli: expected those of an isotropic sheet")
    record = found.settle(pair) | {"from": "fields", "samples": len(samples.u), "numbers": 6}
    own: dict[str, Any] = {"units": samples.points.units, "provenance": {"fit": record}}
    solid = FiniteSolid(samples.spacing, *pair, *found.q, *found.constants, **own)
    body = FiniteBody(solid, samples.points)
    wrong = np.linalg.norm((body(samples.u) - found.b).reshape(len(found.b), -1), axis=1)
    history = record | {
        "E_res": float((wrong / found.size).mean()),
        "largest_gradient": float(body.largest_gradient(samples.u).max()),
    }
    return MaterialFit(solid, history)


class _FiniteFit:
    """Forces of the samples as a function of along, across, share, and linear in the rest.

    Attributes:
        q: along, across, share.
        constants: t3, tq2, q3 at their best.
        b, size: loads of the interior [S, I, 2] and their norms.
    """

    def __init__(self, samples: Samples) -> None:
        if samples.points.dimension != 2:
            raise InputError("samples: finite strain is for sheets, got nodes in space")
        self.samples, self.slopes = samples, Slopes(samples.points)
        self.b = samples.loads[:, samples.interior]
        self.size = np.linalg.norm(self.b.reshape(len(self.b), -1), axis=1)
        if not (self.size > 0).all():
            raise InputError(f"b: expected loads, got none on sample {int(np.argmin(self.size))}")
        own = self.slopes.plain
        self._bases = [own, *(own @ shell for shell in self.slopes.shells)]
        self._H = [gradients(D, samples.u) for D in self._bases]
        unknown = np.flatnonzero(samples.interior)
        self._own = [D.tocsc()[:, unknown].tocsr() for D in self._bases]
        kinds = unit_energies(axis_of(samples.points))
        self._plain, self._cubic = kinds[:2], kinds[2:]
        self.q, self.constants = np.zeros(3), np.zeros(3)

    def _columns(self, H: np.ndarray, D: Any, kinds: list[Any]) -> np.ndarray:
        """Forces of energies with unit constants, [S, I, 2, n]."""
        return np.stack([gathered(D, stress(H, C, T)) for C, T in kinds], axis=-1)

    def columns(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of λ and μ under G, and of t3, tq2 and q3 under F."""
        (H, first, second), (D, one, two) = self._H, self._own
        plain = self._columns(
            H + q[0] * first + q[1] * second, D + q[0] * one + q[1] * two, self._plain
        )
        return plain, self._columns(H + q[2] * first, D + q[2] * one, self._cubic)

    def _left(self, q: np.ndarray, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the best constants leave, over ‖b‖, and those constants."""
        plain, cubic = self.columns(q)
        weight = 1 / self.size[:, None, None] / len(self.size) ** 0.5
        y = ((self.b - plain @ pair) * weight).ravel()
        R = (cubic * weight[..., None]).reshape(-1, 3)
        best = np.linalg.lstsq(R, y)[0]
        return y - R @ best, best

    def settle(self, pair: np.ndarray) -> dict[str, Any]:
        """Find q and the constants of some moduli; the loss, and its evaluations."""
        answer = least_squares(
            lambda q: self._left(q, pair)[0], self.q, diff_step=STEP, x_scale=0.1,
            xtol=CONVERGED, ftol=CONVERGED, gtol=CONVERGED,
        )  # fmt: skip
        self.q = answer.x
        left, self.constants = self._left(self.q, pair)
        return {"loss": float(np.linalg.norm(left)), "evaluations": answer.nfev}
