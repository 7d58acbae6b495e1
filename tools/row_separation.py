"""What a sheet without a crack says of cracks: how one row of its bonds parts, what it stores.

With it go the cracks of a continuum that this row law holds (theory, C20–C22).
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from examples.cracks.cohesive_zone import CubicEnergy, HeldCracks, RowLaw
from examples.cracks.kinked_cracks import KinkedCracks
from tools.cracked_sheet import EV, OPEN, cracked_sheet, longer_cutoff, opened_ends
from tools.elastic import cubic_constants, elastic_constants
from tools.graphene import THICKNESS, bond_length, sheet
from tools.lammps_session import LammpsSession

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


@dataclass(frozen=True)
class Whole:
    """What sheets without a crack say.

    `lam`, `mu`: plane Lamé constants [TPa]; `law`: of a row of bonds along zigzag [Å, TPa];
    `cubic`: energy of third order [TPa], None for a linear sheet.
    """

    lam: float
    mu: float
    law: RowLaw
    cubic: CubicEnergy | None

    @property
    def E(self) -> float:
        """Young's modulus of the sheet [TPa]."""
        return 4 * self.mu * (self.lam + self.mu) / (self.lam + 2 * self.mu)

    def rim(self, half: ArrayLike) -> tuple[float, float]:
        """Half sides [Å] of the rectangle through the first atoms that are held.

        half: half sides of the part of the sheet that moves [Å].
        """
        inner = np.broadcast_to(np.asarray(half, float), 2)
        x = np.abs(cracked_sheet([], half=half).positions)
        first = [float(x[x[:, axis] > inner[axis], axis].min()) for axis in (0, 1)]
        return first[0], first[1]

    def ends(self, cracks: Sequence[np.ndarray], half: ArrayLike) -> list[np.ndarray]:
        """Where straight cracks, by their ends [Å], part the bonds of a sheet."""
        body = cracked_sheet([], half=half)  # with cracks, atoms that lost two bonds are not there
        return [opened_ends(body, np.asarray(crack, float)) for crack in cracks]

    def held(
        self, cracks: Sequence[np.ndarray], half: ArrayLike, *, kinks: bool = False
    ) -> HeldCracks:
        """The continuum of straight cracks in a rectangle, rows of bonds ahead of them.

        kinks: whether rows may turn off at the tips, for cracks at an angle to zigzag.
        """
        step, height = float(np.sqrt(3) * bond_length()), 1.5 * bond_length()
        given = (self.lam, self.mu, self.rim(half), np.array(self.ends(cracks, half)), step)
        kind = KinkedCracks if kinks else HeldCracks
        return kind(*given, cubic=self.cubic, height=height)

    def factor(self, cracks: HeldCracks, strain: float) -> float:
        """By which rows are stronger than the law, so that cracks are critical at a strain."""

        def off(factor: float) -> float:
            return cracks.critical_strain(self.law.times(factor)) - strain

        return float(brentq(off, 0.5, 2.0, xtol=1e-5))


@cache
def sheet_to_third_order(bond: float) -> tuple[float, float, CubicEnergy]:
    """λ and μ [TPa] of a sheet without a crack, and its energy of third order; kept."""
    constants, cubic = elastic_constants(bond), cubic_constants(bond)
    lam, mu = constants["lambda"], constants["mu"]
    return lam, mu, CubicEnergy((lam + mu, mu), *(cubic[name] for name in ("t3", "tq2", "q3")))


def whole(*, linear: bool = False) -> Whole:
    """All that is known without a crack; for comparison, of a linear sheet."""
    lam, mu, cubic = sheet_to_third_order(bond_length())
    return Whole(lam, mu, row_law(), None if linear else cubic)
