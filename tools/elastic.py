"""The potential's own elastic constants at 0 K: the truth that a learned model is held to."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tools.graphene import THICKNESS, sheet
from tools.lammps_session import LammpsSession
from tools.statics import Statics
from warp_peri.sources.coarse_graining import EV_PER_CUBIC_ANGSTROM

STRAIN = 1e-4


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


def lame_constants(lam: float, mu: float) -> dict[str, float]:
    """`lambda`, `mu` as given, and `E` [TPa] and `nu` of the plane solid that has them."""
    c11 = lam + 2 * mu
    return {"lambda": lam, "mu": mu, "E": 4 * mu * (lam + mu) / c11, "nu": lam / c11}


def _stress(
    bond: float, strain: np.ndarray, potential: str | Path | None, elements: Sequence[str]
) -> np.ndarray:
    """Normal stresses σxx, σyy [TPa] of the sheet under strains εxx, εyy."""
    positions, periods = sheet(bond, cells=(3, 2))
    positions = positions * (1 + strain)
    box = (periods[0] * (1 + strain[0]), periods[1] * (1 + strain[1]))
    with LammpsSession(positions, box=box, potential=potential, elements=elements) as session:
        session.forces(Statics(positions, box=box, session=session).reference)
        return np.diag(session.membrane_stress()) * EV_PER_CUBIC_ANGSTROM / THICKNESS
