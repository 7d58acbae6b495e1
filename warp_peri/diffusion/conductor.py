"""Conduction along bonds: numbers, force, equilibria."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy.typing import ArrayLike

from warp_peri.core.record import FieldUnits, Length, Record
from warp_peri.errors import InputError
from warp_peri.kernels.diffusion import flux as kernels
from warp_peri.materials.lps import ALPHA_BOUND, bernstein_basis
from warp_peri.points.arrays import checked, checked_fields, mean_inverse, plain
from warp_peri.points.families import Families, families_of
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import USUAL, Units, check_same
from warp_peri.protocols import OperatorBase
from warp_peri.runtime import floats, ints, launch_slices, zeros
from warp_peri.solvers.adjoint import Implicit, stepped
from warp_peri.solvers.direct import definite_factors
from warp_peri.solvers.solution import Direct, Solution, Solver, refuse_solver

Conductivity = float | np.ndarray | Callable[[np.ndarray], np.ndarray]
ROUNDING = 1e-10
"""Eigenvalues so far below zero, over the largest diagonal, count as zero."""


@dataclass(frozen=True)
class DiffusionGradient:
    """Derivatives of a scalar by what `DiffusionOperator` depends on.

    Attributes:
        phi: by φ, shape [N].
        kappa: by the conductivity of each bond, shape [E].
        D: by the coefficients of the influence function, shape [M + 1].
        alpha: by its exponent.
    """

    phi: np.ndarray
    kappa: np.ndarray
    D: np.ndarray
    alpha: float


class DiffusionOperator(OperatorBase):
    """−∇·κ∇φ, nonlocal, on the interior of a point set (theory, Di1).

    Args:
        law: influence function and conductivity.
        points: a lattice or scattered points with a collar of δ; nodes outside break their bonds,
            which leaves an insulated surface.
        kappa: the conductivity: a number, one by node [N] (harmonic mean along a bond), or a
            function of positions [..., 2], taken in series along each bond (Di2). By default the
            law's.

    ``op(phi)`` takes φ on all nodes, shape [N] or [S, N], and returns L φ on the interior, [I] or
    [S, I].

    Raises InputError for a conductivity not > 0, or points that do not carry the horizon.
    """

    is_linear = True
    what = "diffusion"
    implicit = 0.5

    def __init__(
        self, law: DiffusionMaterial, points: PointsLike, *, kappa: Conductivity | None = None
    ) -> None:
        self.model, self.points = law, nodes_of(points)
        check_same(law.units, self.points.units)
        families = families_of(self.points, law.horizon, bond_based=True)
        bond, self._owner = _bonds_of(families)
        self.neighbour = families.neighbour[bond]
        self.r, weight = _lengths_and_weights(families, bond, self._owner)
        kept = self.neighbour >= 0
        count = len(families.rows)
        K = law.basis(self.r) @ law.D
        self._volume = np.bincount(self._owner, K * self.r**2 * weight, count)
        if (np.abs(self._volume) < 1e-300).any():
            raise InputError("influence function: its weighted volume is zero")
        # broken bonds count in m and carry nothing
        self._owner_all, self._r_all, self._weight_all = self._owner, self.r, weight
        self._kept = kept
        scale = 2 * self.points.dimension
        self.v = (scale * K * weight / self._volume[self._owner])[kept]
        # weights of scattered points are negative here and there, of any kernel
        signed = self.v if families.lattice is not None else (K / self._volume[self._owner])[kept]
        self._changes_sign = bool((signed < 0).any())
        self._owner, self.neighbour, self.r = (
            part[kept] for part in (self._owner, self.neighbour, self.r)
        )
        self.rows = families.rows
        self.given = law.conductivity if kappa is None else kappa
        self.kappa = bond_conductivity(self, self.given)
        row = np.concatenate([[0], np.cumsum(np.bincount(self._owner, minlength=count))])
        self._links = (ints(self.rows), ints(row), ints(self.neighbour), floats(self.v))

    @property
    def shape(self) -> tuple[int, ...]:
        """Of one field, [N]."""
        return (len(self.points.x),)

    @property
    def is_symmetric(self) -> bool:  # type: ignore[override]
        """Whether so is L on the interior: on lattices."""
        return bool(self.points.spacing > 0)

    def force(self, phi: np.ndarray) -> np.ndarray:
        """L φ on the interior, [N] or [S, N] to [I] or [S, I]; InputError for another shape."""
        if np.ndim(phi) == 2 and len(phi):
            return np.stack([self.force(one) for one in phi])
        out = zeros(len(self.rows))
        inputs = (*self._links, floats(self.kappa), self._field(phi))
        launch_slices(kernels.flux, len(self.rows), inputs, (out,))
        result: np.ndarray = out.numpy()
        return result

    def _field(self, phi: np.ndarray) -> wp.array[Any]:
        values = np.ascontiguousarray(phi, dtype=float)
        if values.shape != (len(self.points.x),):
            raise InputError(f"phi: expected shape [{len(self.points.x)}], got {values.shape}")
        return floats(values)

    def matrix(self) -> sp.csr_array:
        """L as a matrix, rows the interior in order, shape [I, N]."""
        stiffness = self.v * self.kappa
        shape = (len(self.rows), len(self.points.x))
        far = sp.csr_array((-stiffness, (self._owner, self.neighbour)), shape=shape)
        own = sp.csr_array((stiffness, (self._owner, self.rows[self._owner])), shape=shape)
        return sp.csr_array(far + own)

    def inner(self) -> sp.csc_array:
        """The columns of `matrix` that belong to the interior, shape [I, I].

        Raises InputError where a kernel that changes sign gives L + Lᵗ
        eigenvalues below zero: φ would grow without end.
        """
        matrix = sp.csc_array(self.matrix()[:, self.rows])
        if self._changes_sign and len(self.rows):
            shift = ROUNDING * np.abs(matrix.diagonal()).max()
            even = (matrix + matrix.T) / 2 + shift * sp.eye_array(len(self.rows))
            if definite_factors(even) is None:
                raise InputError(
                    "influence function: it changes sign on these points, and L + Lᵗ has "
                    "eigenvalues below zero, with which φ grows without end; take D ≥ 0"
                )
        return matrix

    def rhs(self, b: np.ndarray) -> np.ndarray:
        """The source on the interior nodes, [..., I]."""
        inside = self.points.interior
        return checked("b", b, float, (..., len(inside)), inside)[..., self.rows]

    def tangent(self, u: Any) -> sp.csr_array:
        """`matrix`, whatever φ."""
        return self._matrix

    def interior_tangent(self, u: Any) -> sp.csc_array:
        """L between interior nodes, sparse [I, I]."""
        return self.inner()

    @property
    def learnable(self) -> dict[str, Any]:
        """α and D, and κ where it is one number or one a node [N]."""
        own = {"alpha": self.model.alpha, "D": self.model.D}
        return own if callable(self.given) else own | {"kappa": self.given}

    def at(self, numbers: Mapping[str, Any]) -> DiffusionOperator:
        """The same with other numbers; InputError for κ not > 0."""
        law = replace(self.model, alpha=float(numbers["alpha"]), D=numbers["D"])
        return DiffusionOperator(law, self.points, kappa=numbers.get("kappa", self.given))

    def by_numbers(self, name: str, u: np.ndarray, w: np.ndarray) -> Any:
        """Derivatives of Σ w · L φ to a number, of fields [K, N] and weights [K, I]."""
        each = [self.gradient(phi, seed) for phi, seed in zip(u, w)]
        if name != "kappa":
            return sum(np.asarray(getattr(one, name)) for one in each)
        by_bond, values = np.sum([one.kappa for one in each], axis=0), np.asarray(self.given)
        if values.ndim == 0:
            return by_bond.sum()
        found = np.zeros(len(values))
        for ends in (self.rows[self._owner], self.neighbour):  # κ = 2 / (1/κ_i + 1/κ_j)
            np.add.at(found, ends, by_bond * (self.kappa / values[ends]) ** 2 / 2)
        return found

    def vjp(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Lᵗ w on all nodes, [..., N], of w on the interior, [..., I], whatever φ."""
        return np.asarray(plain("w", w) @ self._matrix)

    @cached_property
    def _matrix(self) -> sp.csr_array:
        return self.matrix()

    def energy(self, u: np.ndarray) -> np.ndarray | None:
        """h^d (½ φ_I·L φ_I + φ_I·L φ_C), shape [...]; None on scattered points."""
        return None if self.points.spacing == 0 else self.quadratic(u)

    def solve(self, b: ArrayLike | None, u: ArrayLike, solver: Solver = None) -> Solution:
        """φ with L φ = b on the interior, given on all other nodes.

        Args:
            b: source, shape [N] or [S, N], read on the interior; None for none.
            u: φ, same shape, read off the interior.
            solver: Direct().

        Raises InputError for other shapes, values that are not finite, and when the matrix is
        singular, as of a piece that nothing touches, or has eigenvalues below zero (`inner`).
        """
        refuse_solver(solver, (Direct,), self.what)
        b, phi = checked_fields(self.points, b, u, self.shape)
        left = Implicit(self).rest(b, phi)
        return Solution(phi, self.points, self, self.rhs(b), "lu", measured=left)

    march = stepped  # ∂φ/∂t = −L φ + b by Crank–Nicolson (theory, Di4)

    def storage(self) -> sp.csr_array:
        """What multiplies ∂φ/∂t, one on the interior, sparse [I, N]."""
        return sp.eye_array(len(self.points.x), format="csr")[self.rows]

    def gradient(self, phi: np.ndarray, seed: np.ndarray) -> DiffusionGradient:
        """Derivatives of seed · L φ, seed of shape [I]."""
        count, bonds = len(self.rows), len(self.v)
        own, far, by_kappa, by_v = zeros(count), zeros(bonds), zeros(bonds), zeros(bonds)
        inputs = (*self._links, floats(self.kappa), self._field(phi))
        given = floats(np.ascontiguousarray(seed, dtype=float))
        launch_slices(kernels.flux_adjoint, count, (*inputs, given), (own, far, by_kappa, by_v))
        by_phi = np.bincount(self.neighbour, far.numpy(), len(self.points.x))
        by_phi[self.rows] += own.numpy()
        on_all = np.zeros(len(self._kept))
        on_all[self._kept] = by_v.numpy()
        basis = self.model.basis(self._r_all)
        K, weight, m = basis @ self.model.D, self._weight_all, self._volume
        pulled = np.bincount(self._owner_all, on_all * K * weight, count) / m
        scale = 2 * self.points.dimension
        share = on_all - self._r_all**2 * pulled[self._owner_all]
        by_K = scale * weight / m[self._owner_all] * share
        return DiffusionGradient(
            by_phi, by_kappa.numpy(), by_K @ basis, float(-(by_K * K) @ np.log(self._r_all))
        )


def _bonds_of(families: Families) -> tuple[np.ndarray, np.ndarray]:
    """Bonds of the interior nodes, by number, and whose they are, by place among the interior.

    Bonds to a place that no node is at are left out; on a lattice these are marked −1 and cannot
    be told from bonds broken to node 0, which carry nothing either.
    """
    starts, ends = families.row[families.rows], families.row[families.rows + 1]
    counts = ends - starts
    owner = np.repeat(np.arange(len(starts)), counts)
    bond = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return bond + np.repeat(starts, counts), owner


def _lengths_and_weights(
    families: Families, bond: np.ndarray, owner: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    if families.lattice is None:
        return families.r[bond], families.weight[bond]
    classes = families.lattice
    number = classes.bond_class[bond - families.row[families.rows[owner]]]
    return classes.r[number], classes.weight[number]


def bond_conductivity(operator: DiffusionOperator, kappa: Conductivity) -> np.ndarray:
    """κ of each bond: one number, the harmonic mean of its ends, or series resistance (Di2).

    Raises InputError for another shape, and for values that are not > 0, naming the smallest.
    """
    points = operator.points
    near, far = operator.rows[operator._owner], operator.neighbour
    if callable(kappa):
        xi = points.x[far] - points.x[near]
        if points.box is not None:
            xi -= np.asarray(points.box) * np.rint(xi / points.box)

        def along(place: float) -> np.ndarray:
            values = checked("conductivity", kappa(points.x[near] + place * xi))
            if values.shape not in ((), (len(near),)):
                shown = list(values.shape)
                raise InputError(f"conductivity: expected one a position, {len(near)}, got {shown}")
            _check(values)
            return np.broadcast_to(values, len(near))

        return np.asarray(1 / mean_inverse(along))
    values = checked("conductivity", kappa)
    if values.shape not in ((), (len(points.x),)):
        raise InputError(
            f"conductivity: expected a number, a function, or shape [{len(points.x)}], got "
            f"{list(values.shape)}"
        )
    values = np.broadcast_to(values, len(points.x))
    _check(values)
    harmonic: np.ndarray = 2 / (1 / values[near] + 1 / values[far])
    return harmonic


def _check(values: np.ndarray) -> None:
    if not (values > 0).all() or not np.isfinite(values).all():
        raise InputError(
            f"conductivity: expected finite values > 0, got {np.nanmin(values):g}, with which "
            "diffusion would run backwards"
        )


@dataclass(frozen=True, eq=False, repr=False)
class DiffusionMaterial(Record, format="warp_peri.conductor"):
    """Flux −κ∇φ spread over a ball, with K(r) = r^(−α) Σ_k D_k B_k,M(r/δ).

    Attributes:
        horizon: δ [length].
        conductivity: κ > 0, of where no field of it is given [stress length²/time of a φ without a
            unit].
        alpha: exponent α < 3.
        D: Bernstein coefficients, shape [M + 1]; their common scale has no effect.
        units: names of the units of length and stress that it is in, as a Model's.

    Raises InputError naming the first number out of its range.
    """

    horizon: Length
    conductivity: Annotated[float, FieldUnits(length=2, stress=1, positive=True)] = 1.0
    alpha: float = 1.0
    D: np.ndarray = field(default_factory=lambda: np.ones(1))
    units: Units = USUAL
    dimension: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.alpha < ALPHA_BOUND:
            raise InputError(f"alpha: expected less than {ALPHA_BOUND:g}, got {self.alpha}")
        if self.D.ndim != 1 or not self.D.any():
            raise InputError("D: expected finite coefficients, one of them other than 0")

    def basis(self, r: np.ndarray) -> np.ndarray:
        """r^(−α) B_k(r/δ), shape [..., M + 1]."""
        table: np.ndarray = r[..., None] ** -self.alpha * bernstein_basis(
            r, self.horizon, len(self.D) - 1
        )
        return table

    def on(self, points: PointsLike, *, kappa: Conductivity | None = None) -> DiffusionOperator:
        """The law on points, with a conductivity of its own as of DiffusionOperator."""
        return DiffusionOperator(self, points, kappa=kappa)
