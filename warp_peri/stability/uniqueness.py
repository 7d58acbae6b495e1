"""Up to which gradient a nonlinear solid has one solution, proven (theory.md, N13–N19).

With stresses of gradients projected to |H| ≤ ε, u ← u + L_LPS⁻¹ (b − L u) contracts in the energy
norm of the linear solid by C(ε) κ_in κ_out. C bounds Ψ″ on the ball, κ_p² the ratio of |h_p(k)|² to
Λmin D(k) over the zone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from warp_peri.launch import in_blocks
from warp_peri.models.nonlinear import NonlinearModel
from warp_peri.operator.symbol import long_wave_moduli, stiffnesses, symbol, zone_wedge
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.unit_names import USUAL, Units, symbols
from warp_peri.stability.proof import (
    AT_ONCE,
    CORNERS,
    ROUNDING,
    affine_part,
    lowest,
    second_derivative,
    slowest,
)

DIRECTIONS = 400
"""Intervals on which homogeneous parts of Ψ are sampled along each of two angles."""
INTERVALS = 160
"""Intervals of the zone grid on which κ is sampled."""
SLACKS = (1.002, 1.005, 1.01, 1.02, 1.05, 1.1, 1.25, 1.5, 2.0, 4.0)
"""Multiples of the sampled κ² that are tried, smallest first."""
FIRST_CELLS, MOST_CELLS = 16, 400_000
CONTRACTION = 0.999
"""What C κ_in κ_out must stay below."""


@dataclass(frozen=True)
class Uniqueness:
    """The guarantee of a nonlinear model on one lattice.

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
        """What is proven, in one sentence."""
        length = symbols(self.units)[0]
        if not self.strain > 0:
            return f"Nothing is proven on the lattice of spacing {self.spacing:g} {length}."
        return (
            f"On any finite set of nodes of the square lattice of spacing {self.spacing:g} "
            f"{length}, with displacement given out to twice the horizon around it, for every "
            f"load, at most one solution has |H| ≤ {self.strain:.4f} at every node within the "
            "horizon of an unknown."
        )

    def figures(self) -> dict[str, Any]:
        """The figures as plain values, and the statement."""
        figures = asdict(self) | {"statement": self.statement}
        del figures["units"]
        return figures


def uniqueness(model: NonlinearModel, *, spacing: float) -> Uniqueness:
    """Prove up to which |H| solutions on a lattice are unique.

    Args:
        model: the model.
        spacing: h [Å].

    Raises InputError when the horizon is below one spacing.
    """
    classes = bond_classes(spacing, model.horizon)
    stiff = stiffnesses(model.linear, classes)
    p_in, p_out = model.weights(classes)
    kappa_out = proven_kappa(classes, *stiff, p_out)
    kappa_in = kappa_out if p_in is p_out else proven_kappa(classes, *stiff, p_in)
    return uniqueness_of(model, spacing, kappa_in, kappa_out)


def uniqueness_of(model: Any, spacing: float, kappa_in: float, kappa_out: float) -> Uniqueness:
    """The largest |H| that proven bounds of κ [TPa^(−1/2)] leave unique (N15).

    Args:
        model: with the `numbers` and `units` of a NonlinearModel.
        spacing: h [Å].
        kappa_in, kappa_out: infinite where none was proven.
    """
    parts = largest_parts(model)
    strain = 0.0
    if np.isfinite(kappa_in * kappa_out):
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = (low + high) / 2
            small = curvature_bound(parts, middle) * kappa_in * kappa_out < CONTRACTION
            low, high = (middle, high) if small else (low, middle)
        strain = low
    bound = curvature_bound(parts, strain)
    return Uniqueness(spacing, strain, kappa_in, kappa_out, bound, tuple(parts), model.units)


def curvature_bound(parts: Sequence[float], strain: float) -> float:
    """C(ε) = Σ_d d (d − 1) M_d ε^(d−2) [TPa], (N16): no eigenvalue of Ψ″ is larger in |H| ≤ ε."""
    return float(sum(d * (d - 1) * m * strain ** (d - 2) for d, m in enumerate(parts, start=3)))


def largest_parts(model: Any) -> list[float]:
    """M_d ≥ max |Ψ_d| over |H| = 1 of the parts of degree d = 3, 4, 5, 6 of Ψ [TPa], (N17).

    Ψ_d depends on t, |q|, ω and, through q3, on the phase of q, which is put where it is worst. A
    polynomial of degree d on the sphere, sampled at a distance of η at most, is nowhere larger than
    its largest sample over cos dη (M. Riesz).
    """
    a, b = np.meshgrid(np.linspace(0, np.pi, DIRECTIONS + 1), np.linspace(0, np.pi / 2, DIRECTIONS))
    t, q, w = np.sqrt(2) * np.cos(a), np.sin(a) * np.cos(b) / np.sqrt(2), np.sin(a) * np.sin(b)
    w = w / np.sqrt(2)
    step = np.pi / DIRECTIONS
    reach = step / np.sqrt(2)  # of the nearest sample, from any point
    # e = t + e2 and m = |z|² = 1 + t + m2 by degree, the index of the first axis
    zero = np.zeros_like(t)
    e = np.stack([zero, t, t**2 / 4 + w**2 + q**2])
    m = np.stack([zero + 1, t, t**2 / 4 + w**2])
    s = _product(np.stack([zero, zero, q**2]), m)
    square = _product(e, e)
    lam, mu, t3, tq2, q3, _ = model.numbers
    terms = [
        (lam + mu, square / 2),
        (2 * mu, s),
        (t3, _product(e, square)),
        (tq2, _product(e, s)),
    ]
    parts = []
    size = np.hypot(t / 2, w)
    for d in range(3, 7):
        smooth = sum(factor * term[d] for factor, term in terms if len(term) > d)
        binomial = (1, 3, 3, 1)[d - 3]
        worst = np.abs(smooth) + abs(q3) * binomial * q**3 * size ** (d - 3)
        parts.append(float(worst.max() / np.cos(d * reach)))
    return parts


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The product of polynomials, by degree."""
    product = np.zeros((len(a) + len(b) - 1, *a.shape[1:]))
    for i, coefficient in enumerate(a):
        product[i : i + len(b)] += coefficient * b
    return product


def proven_kappa(
    classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float, p: np.ndarray
) -> float:
    """A proven upper bound of κ_p [TPa^(−1/2)]; infinite when none was found.

    Args:
        classes: bond classes of the lattice.
        v, z, kappa: stiffnesses [TPa/Å²] and κ [1/TPa] of the linear solid.
        p: weights by class [1/Å²], Σ n r² p = 1.
    """
    table = symbol(classes, zone_wedge(classes.spacing, INTERVALS))
    smallest = table.ratio(v, z, kappa) * table.laplacian
    if not smallest.min() > 0:
        return float(np.inf)
    sampled = float((((table.phi @ p) ** 2).sum(axis=1) / smallest).max())
    for slack in SLACKS:
        if _holds(classes, v, z, kappa, p, 1 / (slack * sampled)):
            return float(np.sqrt(slack * sampled))
    return float(np.inf)


def _holds(
    classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float, p: np.ndarray, c: float
) -> bool:
    """Whether D(k) ≥ c |h_p(k)|² is proven for all k, by cells that are halved where they fail."""
    edge = np.pi / classes.spacing
    ball = _taylor_radius(classes, v, z, kappa, p, c)
    if ball == 0:
        return False
    first, second, third = (classes.count @ (np.abs(p) * classes.r**n) for n in (1, 2, 3))
    curvature = second_derivative(classes, v, z, kappa)
    curvature += 2 * c * (4 * first * third + second**2)
    slack = ROUNDING * (32 * (classes.count @ np.abs(v)) + 4 * c * first**2)
    half = edge / FIRST_CELLS / 2
    middle = np.stack(np.tril_indices(FIRST_CELLS), axis=1) * 2 * half + half
    work = 0

    def cells(half: float, k: np.ndarray) -> np.ndarray:
        d, slopes = affine_part(classes, v, z, kappa, 0.0, k)
        value, slope = _square(classes, p, k)
        d[:2] -= c * value
        slopes[:, :2] -= c * slope[:, None]
        return lowest(d, slopes, half)

    while len(middle):
        middle = middle[np.hypot(*(middle + half).T) > ball]
        work += len(middle)
        if work > MOST_CELLS:
            return False
        bound = in_blocks(partial(cells, half), middle, AT_ONCE)
        failed = bound - curvature * half**2 - slack <= 0
        half /= 2
        middle = (middle[failed][:, None, :] + half * CORNERS).reshape(-1, 2)
        middle = middle[middle[:, 0] + 2 * half >= middle[:, 1]]  # the wedge k₂ ≤ k₁
    return True


def _taylor_radius(
    classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float, p: np.ndarray, c: float
) -> float:
    """|k| [1/Å] inside which the long-wave moduli prove D ≥ c |h_p|², (N19); 0 if they do not."""
    least = slowest(*long_wave_moduli(classes, v, kappa)) - c
    if not least > 0:
        return 0.0
    mu = classes.count @ (v * classes.r**2)
    fourth_v, fourth_z, fourth_p = (classes.count @ (np.abs(x) * classes.r**4) for x in (v, z, p))
    # least − a k² − b k⁴ ≥ 0
    a = 2 / 3 * (fourth_v + abs(kappa * mu) * fourth_z + c * fourth_p)
    b = abs(kappa) * fourth_z**2 / 9 + c * fourth_p**2 / 9
    return float(np.sqrt((-a + np.sqrt(a**2 + 4 * b * least)) / (2 * b)))


def _square(classes: BondClasses, p: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """|h_p(k)|², shape [K], and its derivatives to k, shape [2, K]."""
    xi, weight = classes.xi, p[classes.bond_class]
    phase = k @ xi.T
    h = 2 * np.sin(phase) @ (weight[:, None] * xi)
    slope = 2 * np.einsum("kb,b,ba,bc->akc", np.cos(phase), weight, xi, xi, optimize=True)
    return (h**2).sum(axis=1), 2 * (h * slope).sum(axis=2)
