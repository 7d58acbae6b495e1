"""Nonlocal diffusion on any points: conductivity of bonds, operator, matrix, gradient (D1–D3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp

from warp_peri.damage.stability import negative_eigenvalues
from warp_peri.diffusion.conductor import Conductor
from warp_peri.errors import InputError
from warp_peri.kernels.diffusion import flux as kernels
from warp_peri.launch import floats, ints, launch_slices, zeros
from warp_peri.points.families import Families, families_of
from warp_peri.points.points import Points

Conductivity = float | np.ndarray | Callable[[np.ndarray], np.ndarray]
SAMPLES = 32
"""Places along a bond at which a field of conductivity is read."""
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


class DiffusionOperator:
    """−∇·κ∇φ, nonlocal, on the interior of a point set (theory.md, D1).

    Args:
        law: influence function and conductivity.
        points: a lattice or scattered points with a collar of δ; nodes outside break their bonds,
            which leaves an insulated surface.
        kappa: the conductivity: a number, one by node [N] (harmonic mean along a bond), or a
            function of positions [..., 2], taken in series along each bond (D2). By default the
            law's.

    ``op(phi)`` takes φ on all nodes, shape [N], and returns L φ on the interior, [I].

    Raises InputError for a conductivity not > 0, or points that do not carry the horizon.
    """

    def __init__(
        self, law: Conductor, points: Points, *, kappa: Conductivity | None = None
    ) -> None:
        self.law, self.points = law, points
        families = families_of(points, law.horizon, bond_based=True)
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
        self.v = (4 * K * weight / self._volume[self._owner])[kept]
        # weights of scattered points are negative here and there, of any kernel
        signed = self.v if families.lattice is not None else (K / self._volume[self._owner])[kept]
        self._changes_sign = bool((signed < 0).any())
        self._owner, self.neighbour, self.r = (
            part[kept] for part in (self._owner, self.neighbour, self.r)
        )
        self.rows = families.rows
        self.kappa = bond_conductivity(self, law.conductivity if kappa is None else kappa)
        row = np.concatenate([[0], np.cumsum(np.bincount(self._owner, minlength=count))])
        self._links = (ints(self.rows), ints(row), ints(self.neighbour), floats(self.v))

    def __call__(self, phi: np.ndarray) -> np.ndarray:
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

        Raises InputError, with their number, where a kernel that changes sign gives L + Lᵗ
        eigenvalues below zero: φ would grow without end.
        """
        matrix = sp.csc_array(self.matrix()[:, self.rows])
        if self._changes_sign and len(self.rows):
            shift = ROUNDING * np.abs(matrix.diagonal()).max()
            count = negative_eigenvalues(matrix + shift * sp.eye_array(len(self.rows)))
            if count:
                raise InputError(
                    f"influence function: it changes sign on these points, and L + Lᵗ has {count} "
                    "eigenvalues below zero, with which φ grows without end; take D ≥ 0"
                )
        return matrix

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
        basis = self.law.basis(self._r_all)
        K, weight, m = basis @ self.law.D, self._weight_all, self._volume
        pulled = np.bincount(self._owner_all, on_all * K * weight, count) / m
        by_K = 4 * weight / m[self._owner_all] * (on_all - self._r_all**2 * pulled[self._owner_all])
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
    """κ of each bond: one number, the harmonic mean of its ends, or series resistance (D2).

    Raises InputError for another shape, and for values that are not > 0, naming the smallest.
    """
    points = operator.points
    near, far = operator.rows[operator._owner], operator.neighbour
    if callable(kappa):
        xi = points.x[far] - points.x[near]
        if points.box is not None:
            xi -= np.asarray(points.box) * np.rint(xi / points.box)
        resistance = np.zeros(len(near))
        for place in (np.arange(SAMPLES) + 0.5) / SAMPLES:
            values = np.asarray(kappa(points.x[near] + place * xi), dtype=float)
            _check(values)
            resistance += 1 / values
        return SAMPLES / resistance
    values = np.asarray(kappa, dtype=float)
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
