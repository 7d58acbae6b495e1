"""A dressed sheet at finite strain: numbers, energy, proof and file (theory.md, D14–D18)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.core.elastic import plane_isotropic
from warp_peri.core.record import Length, Record, Stress
from warp_peri.dressed.law import DressedSolid
from warp_peri.errors import InputError
from warp_peri.points.samples import PointsLike
from warp_peri.points.unit_names import USUAL, Units, shown_moduli, symbols
from warp_peri.third_order.material import CUBIC
from warp_peri.third_order.uniqueness import curvature_bound, largest_parts

if TYPE_CHECKING:
    from warp_peri.dressed.finite_body import FiniteBody

STEPS = np.array([[0, 1], [1, 0], [1, -1], [1, 1]])
"""One half of the neighbours of G: along the axes, and across."""
MARGIN, HALVINGS = 0.999, 60
"""Part of the stiffness that curvature may take; steps of the search for the strain."""


@dataclass(frozen=True, eq=False, repr=False)
class FiniteSolid(Record, format="warp_peri.dressed_finite"):
    """A sheet with the energy Ψ₂(E(∇G u)) + Ψ₃(E(∇F u)), E the Green strain (D14).

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
        nothing is proven (D17–D18)."""
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
        from warp_peri.dressed.finite_body import FiniteBody

        return FiniteBody(self, points)


def third_derivatives(t3: float, tq2: float, q3: complex) -> np.ndarray:
    """Of t3 t³ + tq2 t |q|² + Re(q3 q³) to E₁₁, E₂₂ and 2E₁₂, [3, 3, 3] (D15)."""
    K = np.zeros((3, 3, 3))  # of t, Re q and Im q
    K[0, 0, 0] = 6 * t3
    for one in (1, 2):
        K[0, one, one] = K[one, 0, one] = K[one, one, 0] = 2 * tq2
    K[1, 1, 1], K[2, 2, 2] = 6 * q3.real, 6 * q3.imag
    K[1, 2, 2] = K[2, 1, 2] = K[2, 2, 1] = -6 * q3.real
    K[1, 1, 2] = K[1, 2, 1] = K[2, 1, 1] = -6 * q3.imag
    A = np.array([[1, 1, 0], [0.5, -0.5, 0], [0, 0, 0.5]])
    return np.asarray(np.einsum("abc,ai,bj,ck->ijk", K, A, A, A))


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
