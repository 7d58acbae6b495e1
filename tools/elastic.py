"""The potential's own elastic constants at 0 K: the truth that a learned model is held to."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tools.graphene import THICKNESS, sheet
from tools.lammps_session import LammpsSession
from tools.statics import Statics
from warp_peri.points.arguments import EV_IN_TPA

STRAIN = 1e-4
CUBIC_STRAINS = (0.01, 0.03)
"""Strains of the grids that third-order constants are fitted on, with fourth-order terms."""


def elastic_constants(
    bond: float, *, potential: str | Path | None = None, elements: Sequence[str] = ("C",)
) -> dict[str, float]:
    """Plane elastic constants of the sheet, its atoms free to relax inside the strained cell.

    Stress by central differences of a uniform strain along x and along y; in the plane
    C11 = λ + 2μ, C12 = λ, E = 4μ(λ + μ)/(λ + 2μ) and ν = λ/(λ + 2μ).

    Args:
        bond: stress-free bond length [Å].
        potential, elements: as in LammpsSession.

    Returns:
        `lambda`, `mu` and `E` [TPa] for the thickness THICKNESS, and `nu`.

    Raises what LammpsSession and Statics raise.
    """
    stiffness = np.empty((2, 2))
    for axis in range(2):
        strain = STRAIN * np.eye(2)[axis]
        plus, minus = (_stress(bond, s * strain, potential, elements) for s in (1, -1))
        change = plus - minus
        stiffness[:, axis] = change / (2 * STRAIN)
    c11 = np.trace(stiffness) / 2
    lame = (stiffness[0, 1] + stiffness[1, 0]) / 2
    return lame_constants(float(lame), float((c11 - lame) / 2))


def cubic_constants(bond: float) -> dict[str, float]:
    """Third-order elastic constants of the sheet, its atoms free to relax inside the strained cell.

    The energy of strains along x and y is ½ λ t² + μ E:E + t3 t³ + tq2 t q² + q3 q³ and terms of
    fourth order, t = E₁₁ + E₂₂, q = (E₁₁ − E₂₂)/2, E the Green strain; its derivatives, the second
    Piola–Kirchhoff stresses, are fitted on a grid of strains. x is the zigzag direction.

    `bond`: stress-free bond length [Å].

    Returns: `t3`, `tq2`, `q3` [TPa], and from them `C111`, `C222`, `C112` [TPa].
    """
    rows, stresses = [], []
    for size in CUBIC_STRAINS:
        for a, b in itertools.product((-size, 0.0, size), repeat=2):
            stretch = np.array([1 + a, 1 + b])
            cauchy = _stress(bond, stretch - 1)
            stresses.append(cauchy * stretch[::-1] / stretch)
            E = (stretch**2 - 1) / 2
            t, q = E.sum(), (E[0] - E[1]) / 2
            by_t = [t, 0, 3 * t**2, q**2, 0, 4 * t**3, 2 * t * q**2, 0, q**3]
            by_q = [0, 4 * q, 0, 2 * t * q, 3 * q**2, 0, 2 * t**2 * q, 4 * q**3, 3 * t * q**2]
            rows.append([np.add(by_t, s * np.array(by_q)) for s in (0.5, -0.5)])
    A: np.ndarray = np.concatenate(rows)
    t3, tq2, q3 = np.linalg.lstsq(A, np.concatenate(stresses), rcond=None)[0][2:5].tolist()
    return {
        **{"t3": t3, "tq2": tq2, "q3": q3},
        "C111": 6 * (t3 + tq2 / 4 + q3 / 8),
        "C222": 6 * (t3 + tq2 / 4 - q3 / 8),
        "C112": 2 * (3 * t3 - tq2 / 4 - 3 * q3 / 8),
    }


def lame_constants(lam: float, mu: float) -> dict[str, float]:
    """`lambda`, `mu` as given, and `E` [TPa] and `nu` of the plane solid that has them."""
    c11 = lam + 2 * mu
    return {"lambda": lam, "mu": mu, "E": 4 * mu * (lam + mu) / c11, "nu": lam / c11}


def _stress(
    bond: float,
    strain: np.ndarray,
    potential: str | Path | None = None,
    elements: Sequence[str] = ("C",),
) -> np.ndarray:
    """Normal stresses σxx, σyy [TPa] of the sheet under strains εxx, εyy."""
    positions, periods = sheet(bond, cells=(3, 2))
    positions = positions * (1 + strain)
    box = (periods[0] * (1 + strain[0]), periods[1] * (1 + strain[1]))
    with LammpsSession(positions, box=box, potential=potential, elements=elements) as session:
        session.forces(Statics(positions, box=box, session=session).reference)
        return np.diag(session.membrane_stress()) * EV_IN_TPA / THICKNESS
