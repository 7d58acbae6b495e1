"""What a sheet without a crack says of cracks: how one row of its bonds parts, what it stores."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from tools.cracked_sheet import EV, OPEN, _uniaxial_stress, longer_cutoff
from tools.graphene import THICKNESS, bond_length, sheet
from tools.lammps_session import LammpsSession
from warp_peri.damage.cohesive_zone import RowLaw

STEP = 0.05
"""Between separations [Å]."""


def row_law() -> RowLaw:
    """Traction [TPa] over separation [Å] of two halves of a sheet, between two zigzag rows.

    The halves move apart as they are; the atoms at both ends of the row's bonds find their rest
    between. The last separation is the one at which the bonds are OPEN long.
    """
    bond = bond_length()
    x, box = sheet(bond, cells=(4, 4))
    heights = np.unique(np.round(x[:, 1], 6))
    gap = np.diff(heights)
    middle = (heights[1:] + heights[:-1])[gap > 0.9 * bond] / 2
    y = middle[len(middle) // 2]
    above = x[:, 1] > y
    ends = np.abs(x[:, 1] - y) < 0.6 * bond
    rows, separation = [(0.0, 0.0)], STEP
    with tempfile.TemporaryDirectory() as folder:
        potential = longer_cutoff(Path(folder))

        def pulled(apart: float) -> tuple[float, float]:
            """Traction, and how far the ends of the row's bonds lag behind their halves."""
            moved = x + np.outer(above * apart, (0, 1))
            with LammpsSession(
                moved, box=(box[0], box[1] + apart), potential=potential, elements=("C", "C")
            ) as session:
                session.exclude_like_pairs()

                def forces(lag: float) -> np.ndarray:
                    back = np.where(above, -lag, lag) * ends
                    return np.asarray(session.forces(moved + np.outer(back, (0, 1))))[:, 1]

                lag = brentq(lambda s: forces(s)[above & ends].sum(), -0.01, 0.3, xtol=1e-9)
                pull = -forces(lag)[above].sum() * EV / (box[0] * THICKNESS)
            return float(pull), float(lag)

        def length(apart: float) -> float:
            return bond + apart - 2 * pulled(apart)[1]

        while length(separation) < OPEN:
            rows.append((separation, pulled(separation)[0]))
            separation += STEP
        last = brentq(lambda s: length(s) - OPEN, separation - STEP, separation, xtol=1e-6)
        if last - rows[-1][0] < STEP / 5:
            rows.pop()
        rows.append((last, pulled(last)[0]))
    return RowLaw(*np.array(rows).T)


def stored_energy(largest: float = 0.18, step: float = 0.01) -> CubicSpline:
    """Energy density [TPa] of a whole sheet by its strain across zigzag rows, its width kept."""
    strains = np.arange(0, largest + step / 2, step)
    with tempfile.TemporaryDirectory() as folder:
        potential = longer_cutoff(Path(folder))
        stress = [_uniaxial_stress(bond_length(), float(e), potential, 1) for e in strains[1:]]
    return CubicSpline(strains, [0.0, *stress]).antiderivative()
