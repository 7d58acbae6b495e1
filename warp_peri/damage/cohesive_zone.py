"""Cracks whose tips are held by rows of bonds: the strain at which a bond gives way (C22).

The bonds of a crystal ahead of a tip open one after the other. Each pulls by a law of its own over
one step of the row; all around is elastic. Nothing says where the tip is: that comes out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from warp_peri.damage.straight_cracks import CrackedRectangle
from warp_peri.errors import InputError

ROUNDS = 60
STAGES = 60
"""Openings of the widest bond, up to the end of the law, at which equilibria are found."""


@dataclass(frozen=True)
class RowLaw:
    """How a row of bonds holds two halves of a crystal that move apart.

    Attributes:
        separation: of the halves, from 0 to where the bonds count as broken [length], shape [P].
        traction: there, 0 first [stress], shape [P].

    Raises InputError unless the separations rise from 0 and the traction begins at 0 and rises.
    """

    separation: np.ndarray
    traction: np.ndarray

    def __post_init__(self) -> None:
        s, t = np.asarray(self.separation), np.asarray(self.traction)
        fine = s.ndim == 1 and s.shape == t.shape and len(s) > 3 and np.isfinite(t).all()
        if not (fine and s[0] == t[0] == 0 and (np.diff(s) > 0).all() and t[1] > 0):
            raise InputError("law: expected separations that rise from 0, and traction from 0 up")
        object.__setattr__(self, "_curve", CubicSpline(s, t))

    @property
    def stiffness(self) -> float:
        """Slope at rest [stress / length]; the crystal around has this compliance already."""
        return float(self._curve(0.0, 1))

    def __call__(self, separation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Traction and its slope; linear below 0 and beyond the end."""
        inside = np.clip(separation, 0, self.separation[-1])
        slope = self._curve(inside, 1)
        return self._curve(inside) + slope * (separation - inside), slope

    def times(self, factor: float) -> RowLaw:
        """The law of a row so many times as strong, and as tough."""
        return RowLaw(self.separation, factor * np.asarray(self.traction))


class HeldCracks:
    """Straight cracks in a rectangle, rows of bonds ahead of their tips.

    Args:
        lam, mu: plane Lamé constants [stress].
        half: half sides of the rectangle [length].
        cracks: ends of each, midway between bonds [length], shape [K, 2, 2].
        step: between bonds along a row [length].
        cells: bonds ahead of each tip that may open. Cracks of one row with twice as many or fewer
            between them share all that are there.
        terms: of the series of each row, as in CrackedRectangle.

    Attributes:
        bonds: where they are [length], shape [B, 2].
        drive: opening at unit strain ε₂₂ of the rim if nothing held [length], shape [B].
        compliance: by which unit tractions close it [length / stress], shape [B, B].

    Raises what CrackedRectangle raises, and InputError for a step that is not > 0.
    """

    def __init__(
        self,
        lam: float,
        mu: float,
        half: tuple[float, float],
        cracks: ArrayLike,
        step: float,
        *,
        cells: int = 4,
        terms: int = 100,
    ) -> None:
        if not step > 0:
            raise InputError(f"step: expected a number > 0, got {step}")
        rows = _rows(np.asarray(cracks, dtype=float), step, cells)
        ends = np.array([row[0] for row in rows])
        solid = CrackedRectangle(lam, mu, half, ends, terms=terms)
        owner = np.concatenate([np.full(len(row[1]), k) for k, row in enumerate(rows)])
        places = np.concatenate([row[1] for row in rows])
        width = step / solid.length / 2  # half of a cell, in half lengths
        pulls = np.zeros((len(ends), len(solid.faces), len(owner)))
        for b, (k, place) in enumerate(zip(owner, places, strict=True)):
            pulls[k, :, b] = np.abs(solid.faces - place) < width[k]
        x = solid.solve([[0, 0], [0, 1]], pulls)
        each = [solid.opening(x, k, places[owner == k]) for k in range(len(ends))]
        gap = np.concatenate(each)
        self.drive, self.compliance = gap[:, 0], -gap[:, 1:]
        middle, arm = ends.mean(axis=1), (ends[:, 1] - ends[:, 0]) / 2
        self.bonds = middle[owner] + places[:, None] * arm[owner]

    def opened(self, law: RowLaw) -> tuple[np.ndarray, np.ndarray]:
        """Equilibria as the widest bond opens to the end of the law.

        Returns the strains, shape [S], and the separations of all bonds, shape [S, B].

        Raises InputError where Newton's method finds none.
        """
        k, count = law.stiffness, len(self.drive)
        first = np.linalg.solve(k * self.compliance, self.drive)
        widest = int(np.argmax(first))
        stages = np.linspace(0, law.separation[-1], STAGES + 1)[1:]
        opening, strain = first / first[widest] * stages[0], stages[0] / first[widest]
        strains, openings = [], []
        for stage in stages:
            for _ in range(ROUNDS):
                pull, slope = law(opening)
                off = opening - pull / k + self.compliance @ pull - strain * self.drive
                tangent = np.zeros((count + 1, count + 1))
                tangent[:-1, :-1] = np.diag(1 - slope / k) + self.compliance * slope
                tangent[:-1, -1], tangent[-1, widest] = -self.drive, 1
                move = np.linalg.solve(tangent, -np.append(off, opening[widest] - stage))
                move *= min(1.0, 0.1 * law.separation[-1] / np.abs(move[:-1]).max())
                opening, strain = opening + move[:-1], strain + move[-1]
                if np.abs(move[:-1]).max() < 1e-8 * law.separation[-1]:
                    break
            else:
                raise InputError(f"cracks: no equilibrium with a bond open by {stage:.3g}")
            strains.append(strain)
            openings.append(opening)
            if opening.max() > law.separation[-1]:
                break
        return np.array(strains), np.array(openings)

    def critical_strain(self, law: RowLaw) -> float:
        """The largest strain ε₂₂ of the rim before a bond reaches the end of the law."""
        return float(self.opened(law)[0].max())


def _rows(
    cracks: np.ndarray, step: float, cells: int
) -> list[tuple[tuple[np.ndarray, np.ndarray], np.ndarray]]:
    """Lines of cracks and bonds ahead: their ends, and the bonds' places from −1 to 1 on them."""
    left: list[list[np.ndarray]] = [[crack] for crack in cracks]
    rows = []
    while left:
        group = left.pop()
        start, end = group[0]
        along = (end - start) / np.hypot(*(end - start))
        reach = 2 * cells * step + 1e-6 * step
        joined = True
        while joined:
            spans = np.sort([(crack - start) @ along for crack in group], axis=1)
            joined = False
            for number, other in enumerate(left):
                away = other[0] - start
                height = np.abs(away[:, 0] * along[1] - away[:, 1] * along[0]).max()
                span = np.sort(away @ along)
                gap = np.maximum(span[0] - spans[:, 1], spans[:, 0] - span[1]).min()
                if height < 1e-6 * step and gap < reach:
                    group += left.pop(number)
                    joined = True
                    break
        low, high = spans.min() - cells * step, spans.max() + cells * step
        places = np.arange(low + step / 2, high, step)
        inside = (places[:, None] > spans[:, 0]) & (places[:, None] < spans[:, 1])
        places = places[~inside.any(axis=1)]
        ends = (start + low * along, start + high * along)
        rows.append((ends, (2 * places - low - high) / (high - low)))
    return rows
