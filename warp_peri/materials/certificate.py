"""Solvability on points of any kind (theory, 20), and uniqueness at large strain (N13–N17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy import ndarray
from numpy.linalg import svd

from warp_peri.core.proof import Figures, certify, prove, stencil_of
from warp_peri.core.stencil import Stencil, stencil_in_box
from warp_peri.errors import InputError
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.points.arguments import USUAL, Positive, Units, offered, symbols, typed
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.points import PointsLike
from warp_peri.solvers.systems import DENSE, smallest_eigenvalue

DIRECTIONS = 400
"""Intervals on which homogeneous parts of Ψ are sampled along each of two angles."""
SLACKS = (1.001, 1.002, 1.005, 1.01, 1.02, 1.05, 1.1, 1.25, 1.5, 2.0, 4.0)
"""Multiples of the sampled κ² that are tried, smallest first."""
CONTRACTION = 0.999
"""What C κ_in κ_out must stay below."""


@dataclass(frozen=True)
class Solvability:
    """Eigenvalue and singular-value figures of L on the interior of a point set.

    Attributes:
        symmetric_min: smallest eigenvalue of (L + Lᵗ)/2 [TPa/Å²]; above 0, every Dirichlet problem
            on the nodes has exactly one solution.
        singular_min: smallest singular value of L [TPa/Å²]; above 0, this one has. None of more
            than 1500 unknown numbers.
    """

    symmetric_min: float
    singular_min: float | None


@typed
def check_solvability(model: LPSMaterial, points: PointsLike) -> Solvability:
    """Compute the solvability figures of L on points of any kind; between scattered ones W_ij ≠
    W_ji and no certificate speaks. Raises InputError where they do not carry the horizon."""
    L = LPSOperator(model, points).matrix()
    A = sp.csc_array(L[:, np.repeat(points.interior, model.dimension)])
    few = A.shape[0] <= DENSE
    singular = float(svd(A.toarray(), compute_uv=False)[-1]) if few else None
    return Solvability(smallest_eigenvalue((A + A.T) / 2), singular)


def with_proof(model: LPSMaterial, spacing: float | None = None) -> LPSMaterial:
    """An uncertified model, certified for a lattice spacing (default: its data's, else a third of
    its horizon); InputError where the proof fails."""
    home = spacing or max(model.trained_on, default=model.horizon / 3)
    proof = certify(model, spacing=home)
    if not proof.holds:
        raise InputError(
            f"model: nothing is proven of it on {home:g} {symbols(model.units)[0]}; "
            f"{proof.statement}"
        )
    figures = {f"{proof.spacing:g}": proof.figures()}
    return replace(model, certified_on=(proof.spacing,), certificate=figures)


@dataclass(frozen=True)
class Uniqueness(Figures):
    """Guarantee of unique solutions of a third-order solid on one lattice.

    Attributes:
        spacing: h [Å].
        strain: ε*, largest |H| up to which solutions are proven unique; 0 where nothing is.
        kappa_in, kappa_out: proven bounds of κ [TPa^(−1/2)].
        curvature: the bound C(ε*) of Ψ″ [TPa].
        largest_parts: M_d, bounds of the homogeneous parts of Ψ of degree 3 to 6 at |H| = 1 [TPa].
        units: names of the units of length and stress.
    """

    spacing: float
    strain: float
    kappa_in: float
    kappa_out: float
    curvature: float
    largest_parts: tuple[float, ...]
    units: Units = USUAL

    @property
    def statement(self) -> str:
        """What the guarantee says of uniqueness, in one sentence."""
        length = symbols(self.units)[0]
        if not self.strain > 0:
            return f"Nothing is proven on the lattice of spacing {self.spacing:g} {length}."
        return (
            f"On any finite set of nodes of the square lattice of spacing {self.spacing:g} "
            f"{length}, with displacement given out to twice the horizon around it, for every "
            f"load, at most one solution has |H| ≤ {self.strain:.4f} at every node within the "
            "horizon of an unknown."
        )


@typed
def prove_uniqueness(model: Any, *, spacing: Positive) -> Uniqueness:
    """Prove up to which |H| solutions of a third-order solid are unique on a lattice (N15). Raises
    InputError for a horizon below one spacing, and other materials."""
    offered(model, "reach", "prove_uniqueness", "a solid of third order")
    stencil, group = stencil_of(model.linear, spacing, "prove_uniqueness")
    classes = bond_classes(spacing, model.reach)
    p_in, p_out = model.weights(classes)
    kappa_out = proven_kappa(stencil, group, classes, p_out)
    kappa_in = kappa_out if p_in is p_out else proven_kappa(stencil, group, classes, p_in)
    parts = largest_parts(model)
    kappas, strain, high = (kappa_in, kappa_out), 0.0, 1.0
    for _ in range(60):
        middle = (strain + high) / 2
        small = curvature_bound(parts, middle) * kappa_in * kappa_out < CONTRACTION
        strain, high = (middle, high) if small else (strain, middle)
    bound = curvature_bound(parts, strain)
    return Uniqueness(stencil.spacing, strain, *kappas, bound, tuple(parts), model.units)


def curvature_bound(parts: Sequence[float], strain: float) -> float:
    """Bound C(ε) = Σ_d d (d − 1) M_d ε^(d−2) [TPa] of the eigenvalues of Ψ″ in |H| ≤ ε (N16)."""
    return float(sum(d * (d - 1) * m * strain ** (d - 2) for d, m in enumerate(parts, start=3)))


def largest_parts(model: Any) -> list[float]:
    """Bounds M_d ≥ max |Ψ_d| over |H| = 1 of the parts of Ψ of degree d = 3 to 6 [TPa] (N17): on a
    sphere sampled within η none is larger than its largest sample over cos dη (M. Riesz)."""
    a, b = np.meshgrid(np.linspace(0, np.pi, DIRECTIONS + 1), np.linspace(0, np.pi / 2, DIRECTIONS))
    t, side = np.sqrt(2) * np.cos(a), np.sin(a) / np.sqrt(2)
    q, w = side * np.cos(b), side * np.sin(b)
    reach = np.pi / DIRECTIONS / np.sqrt(2)  # of the nearest sample, from any point
    s = np.exp(2j * np.pi * np.arange(8) / 8)[:, None, None]  # sizes of H, whose powers FFTs tell
    m = 1 + s * t + s**2 * (t**2 / 4 + w**2)
    e, shear = m - 1 + s**2 * q**2, s**2 * q**2 * m
    lam, mu, t3, tq2, q3 = model.numbers
    psi = (lam + mu) / 2 * e**2 + 2 * mu * shear + t3 * e**3 + tq2 * e * shear
    smooth, size, parts = np.fft.fft(psi, axis=0).real / 8, np.hypot(t / 2, w), []
    for d, binomial in enumerate((1, 3, 3, 1), start=3):
        worst = np.abs(smooth[d]) + abs(q3) * binomial * q**3 * size ** (d - 3)
        parts.append(float(worst.max() / np.cos(d * reach)))
    return parts


def proven_kappa(stencil: Stencil, group: ndarray, classes: BondClasses, p: ndarray) -> float:
    """Proven upper bound of κ_p [stress^(−1/2)] of weights p by class [1/length²], or inf (N14)."""
    gradient = stencil.dimension * p[classes.bond_class, None] * classes.xi
    weight = squared(stencil.spacing, classes.steps, gradient)
    proven = prove(stencil, group, weight, tuple(1 / slack for slack in SLACKS)).proven
    return float(1 / np.sqrt(proven)) if proven > 0 else np.inf


def squared(spacing: float, steps: ndarray, field: ndarray) -> Stencil:
    """Stencil f ∗ f of a field f(ξ) = −f(−ξ) on whole families [B, d]; symbol |Σ f(ξ) sin k·ξ|²."""
    d, far = steps.shape[1], 2 * np.abs(steps).max()
    box = np.zeros((2 * far + 1,) * d)
    for step, f in zip(steps, field):
        np.add.at(box, tuple((step + steps + far).T), field @ f)
    return stencil_in_box(spacing, box[..., None, None] * np.eye(d))
