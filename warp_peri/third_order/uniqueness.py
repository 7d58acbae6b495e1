"""Up to which gradient a nonlinear solid has one solution, proven (theory, N13–N17).

With stresses of gradients projected to |H| ≤ ε, u ← u + L_LPS⁻¹ (b − L u) contracts in the energy
norm of the linear solid by C(ε) κ_in κ_out. C bounds Ψ″ on the ball, κ_p² the ratio of |h_p(k)|² to
Λmin D(k) over the zone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from warp_peri.contract import offered, stencil_of
from warp_peri.core.proof import prove
from warp_peri.core.stencil import Stencil, squared
from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.unit_names import USUAL, Units, symbols

DIRECTIONS = 400
"""Intervals on which homogeneous parts of Ψ are sampled along each of two angles."""
SLACKS = (1.001, 1.002, 1.005, 1.01, 1.02, 1.05, 1.1, 1.25, 1.5, 2.0, 4.0)
"""Multiples of the sampled κ² that are tried, smallest first."""
CONTRACTION = 0.999
"""What C κ_in κ_out must stay below."""
SAME = 1e-5
"""Relative, that a proven strain may be above that of a proof anew."""


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


def uniqueness(model: Any, *, spacing: float) -> Uniqueness:
    """Prove up to which |H| solutions on a lattice are unique: the largest that proven bounds of κ
    [stress^(−1/2)] leave (N15).

    Args:
        model: a solid of third order.
        spacing: h [length].

    Raises InputError when the horizon is below one spacing, and for another material.
    """
    offered(model, "reach", "uniqueness", "a solid of third order")
    stencil, group = stencil_of(model.linear, spacing, "uniqueness")
    classes = bond_classes(spacing, model.reach)
    p_in, p_out = model.weights(classes)
    kappa_out = proven_kappa(stencil, group, classes, p_out)
    kappa_in = kappa_out if p_in is p_out else proven_kappa(stencil, group, classes, p_in)
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
    return Uniqueness(
        stencil.spacing, strain, kappa_in, kappa_out, bound, tuple(parts), model.units
    )


def check_strain(proven: dict[str, Any], unique: Callable[[], Uniqueness]) -> None:
    """Raise InputError unless the strain that a file says to be proven is, of these numbers."""
    said = proven.get("strain", 0.0)
    if not (is_number(said) and 0 <= said <= (1 + SAME) * (unique().strain if said else 0.0)):
        raise InputError(f"proven: one solution up to |H| = {said!r:.20} is not proven of these")


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
    lam, mu, t3, tq2, q3 = model.numbers
    terms = [(lam + mu, square / 2), (2 * mu, s), (t3, _product(e, square)), (tq2, _product(e, s))]
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


def proven_kappa(stencil: Stencil, group: np.ndarray, classes: BondClasses, p: np.ndarray) -> float:
    """A proven upper bound of κ_p [stress^(−1/2)]; infinite when none was found (N14).

    Args:
        stencil: of the linear solid, certified.
        group: integer matrices under which it is invariant, shape [g, d, d].
        classes: bond classes of the gradient's family.
        p: its weights by class [1/length²], Σ n r² p = 1.
    """
    d = stencil.dimension
    gradient = d * p[classes.bond_class, None] * classes.xi
    weight = squared(stencil.spacing, classes.steps, gradient)
    proven = prove(stencil, group, weight, tuple(1 / slack for slack in SLACKS)).proven
    return float(1 / np.sqrt(proven)) if proven > 0 else float(np.inf)
