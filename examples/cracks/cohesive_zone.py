"""Cracks whose tips are held by rows of bonds: the strain at which a bond gives way (C22).

The bonds of a crystal ahead of a tip open one after the other. Each pulls by a law of its own over
one step of the row; all around is elastic, linear or to third order (C23). Nothing says where the
tip is: that comes out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from examples.cracks.straight_cracks import CrackedRectangle
from warp_peri import InputError

FINER = 2
"""Points of the sheet in a step, and in a height."""


CHUNK = 4000
"""Of these points, whose fields are held at a time."""


@dataclass(frozen=True)
class CubicEnergy:
    """The cubic part of the energy density of a displacement gradient, (N3).

    `stiffness`: λ + μ and μ [stress], which finite strains multiply; `t3`, `tq2`, `q3`: third-order
    constants [stress]; `axis`: angle of the zigzag direction from x [radians].
    """

    stiffness: tuple[float, float]
    t3: float
    tq2: float
    q3: float
    axis: float = 0.0

    def density(self, by_z: np.ndarray, by_conjugate: np.ndarray) -> np.ndarray:
        """Energy density [stress] of the gradients that CrackedRectangle gives."""
        t, q = 2 * by_z.real, by_conjugate * np.exp(-2j * self.axis)
        bulk, shear = self.stiffness
        finite = t**2 / 4 + by_z.imag**2 + np.abs(q) ** 2
        cubic = self.t3 * t**3 + self.tq2 * t * np.abs(q) ** 2 + self.q3 * (q**3).real
        density: np.ndarray = bulk * t * finite + 2 * shear * t * np.abs(q) ** 2 + cubic
        return density

    def _curvature(self, t: np.ndarray, turn: np.ndarray, a: np.ndarray, b: np.ndarray) -> Any:
        """Second derivatives of the density by t, ω and both parts of q, shape [4, 4, points]."""
        bulk, shear = self.stiffness
        mixed, q3, none = 2 * (bulk + 2 * shear + self.tq2), 6 * self.q3, np.zeros_like(t)
        return np.array(
            [
                [(1.5 * bulk + 6 * self.t3) * t, 2 * bulk * turn, mixed * a, mixed * b],
                [2 * bulk * turn, 2 * bulk * t, none, none],
                [mixed * a, none, mixed * t + q3 * a, -q3 * b],
                [mixed * b, none, -q3 * b, mixed * t - q3 * a],
            ]
        )

    def between(self, by_z: np.ndarray, by_conjugate: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Third derivatives of the energy by the columns of the gradients, shape [M, M, M].

        weight: area of each point, shape [points].
        """
        q = by_conjugate * np.exp(-2j * self.axis)
        parts = np.array([2 * by_z.real, by_z.imag, q.real, q.imag])
        flat, tensor = parts.reshape(-1, parts.shape[2]), []
        for k in range(parts.shape[2]):
            curved = weight * self._curvature(*parts[:, :, k])
            tensor.append(flat.T @ np.einsum("abp,bpm->apm", curved, parts).reshape(flat.shape))
        return np.array(tensor)

    def bent(
        self,
        half: tuple[float, float],
        step: float,
        height: float,
        beside: Callable[[np.ndarray], np.ndarray],
        gradients: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
        size: int,
    ) -> np.ndarray:
        """`between` over a rectangle but where rows have a law of their own, per step, [M, M, M].

        `half`: half sides of the rectangle [length]; `step`, `height`: between bonds along a row,
        and between rows [length]; `beside`: which points x + i y belong to the sheet; `gradients`:
        columns of the displacement gradient at points, as of `between`; `size`: M, of these
        columns.
        """
        z, area = squares(half, (step / FINER, height / FINER))
        kept = beside(z)
        z, area, total = z[kept], area[kept] / step, np.zeros(3 * (size,))
        for part in np.array_split(np.arange(len(z)), 1 + len(z) // CHUNK):
            total += self.between(*gradients(z[part]), area[part])
        return total


def check_lengths(step: float, height: float, cubic: CubicEnergy | None) -> None:
    """Raise InputError for a step, or beside a cubic energy a height, that is not > 0."""
    for name, value in (("step", step), ("height", 1.0 if cubic is None else height)):
        if not value > 0:
            raise InputError(f"{name}: expected a number > 0, got {value}")


def squares(half: tuple[float, float], size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points x + i y in a rectangle about the origin, and the area of each, shape [points]."""
    axes = []
    for reach, step in zip(half, size, strict=True):
        x = (np.arange(-int(reach / step) - 2, int(reach / step) + 2) + 0.5) * step
        axes.append(x[np.abs(x) < reach])
    z = (axes[0] + 1j * axes[1][:, None]).ravel()
    return z, np.full(len(z), 4 * half[0] * half[1] / len(z))


ROUNDS = 60
NODES = 6
"""Points of a cell over which its opening is averaged, so that the compliance is symmetric."""
STAGES = 40
"""Steps along the path of equilibria in which a bond alone would come to the end of the law."""


class RowLaw:
    """How a row of bonds holds two halves of a crystal that move apart.

    Args:
        separation: of the halves, from 0 to where the bonds count as broken [length], shape [P].
        traction: there, 0 first [stress], shape [P].

    Raises InputError unless the separations rise from 0 and the traction begins at 0 and rises.
    """

    def __init__(self, separation: ArrayLike, traction: ArrayLike) -> None:
        self.separation, self.traction = (np.asarray(a, float) for a in (separation, traction))
        s, t = self.separation, self.traction
        fine = s.ndim == 1 and s.shape == t.shape and len(s) > 3 and np.isfinite(t).all()
        if not (fine and s[0] == t[0] == 0 and (np.diff(s) > 0).all() and t[1] > 0):
            raise InputError("law: expected separations that rise from 0, and traction from 0 up")
        self._curve = CubicSpline(s, t)

    @property
    def stiffness(self) -> float:
        """Slope at rest [stress / length]; the crystal around has this compliance already."""
        return float(self._curve(0.0, 1))

    def __call__(self, separation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Traction and its slope; linear below 0 and beyond the end."""
        inside = np.clip(separation, 0, self.separation[-1])
        slope = self._curve(inside, 1)
        return self._curve(inside) + slope * (separation - inside), slope

    def times(self, factor: float) -> "RowLaw":
        """The law of a row so many times as strong, and as tough."""
        return RowLaw(self.separation, factor * self.traction)


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
        cubic: the sheet's energy of third order; None for a linear sheet.
        height: between rows [length]. Over this height the law of a row stands for the sheet.

    Attributes:
        bonds: where they are [length], shape [B, 2].
        drive: mean openings, then slidings, of their cells at unit strain ε₂₂ of the rim if nothing
            held [length], shape [2B].
        compliance: by which unit tractions, normal then shear, undo them [length / stress],
            symmetric, shape [2B, 2B].
        bent: third derivatives of the sheet's energy by the strain and the tractions, per step,
            shape [1 + 2B, 1 + 2B, 1 + 2B]; zero in a linear sheet.

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
        cubic: CubicEnergy | None = None,
        height: float = 0.0,
    ) -> None:
        check_lengths(step, height, cubic)
        rows = _rows(np.asarray(cracks, dtype=float), step, cells)
        ends = np.array([row[0] for row in rows])
        solid = CrackedRectangle(lam, mu, half, ends, terms=terms)
        owner = np.concatenate([np.full(len(row[1]), k) for k, row in enumerate(rows)])
        places = np.concatenate([row[1] for row in rows])
        width = step / solid.length / 2  # half of a cell, in half lengths
        pulls = np.zeros((len(ends), len(solid.faces), 2 * len(owner)), complex)
        edges = np.cos(np.arange(len(solid.faces) + 1) * np.pi / len(solid.faces))
        for b, (k, place) in enumerate(zip(owner, places, strict=True)):
            within = np.clip(edges, place - width[k], place + width[k])
            pulls[k, :, b] = np.diff(within) / np.diff(edges)  # so that no force is lost
        pulls[:, :, len(owner) :] = 1j * pulls[:, :, : len(owner)]
        x = solid.solve([[0, 0], [0, 1]], pulls)
        node, weight = np.polynomial.legendre.leggauss(NODES)
        gap = np.zeros((len(owner), x.shape[1]), complex)
        for k in range(len(ends)):
            mine = owner == k
            inside = places[mine][:, None] + width[k] * node
            opening = solid.opening(x, k, inside.ravel()).reshape(*inside.shape, -1)
            gap[mine] = np.einsum("bqm,q->bm", opening, weight / 2)
        both = np.concatenate([gap.real, gap.imag])
        self.drive, self.compliance = both[:, 0], -both[:, 1:]
        middle, arm = ends.mean(axis=1), (ends[:, 1] - ends[:, 0]) / 2
        self.bonds = middle[owner] + places[:, None] * arm[owner]
        self.bent = np.zeros(3 * (x.shape[1],))
        if cubic is not None:

            def beside(z: np.ndarray) -> np.ndarray:
                local = (z[:, None] - middle @ (1, 1j)) / (arm @ (1, 1j))
                law_speaks = np.abs(local.imag) * solid.length < height / 2
                return np.asarray(~(law_speaks & (np.abs(local.real) < 1)).any(axis=1))

            fields = partial(solid.gradients, x)
            self.bent = cubic.bent(half, step, height, beside, fields, x.shape[1])

    def opened(self, law: RowLaw) -> tuple[np.ndarray, np.ndarray]:
        """Equilibria as bonds open, along their path through folds, to the end of the law.

        A bond that has lost a part of its stiffness across the row has lost it along the row too.

        Returns the strains, shape [S], and the separations of all bonds, shape [S, B]; at the last
        the widest is at the end of the law.

        Raises InputError where Newton's method loses the path.
        """
        end, count = float(law.separation[-1]), len(self.bonds)
        scales = np.append(np.full(count, law.stiffness), np.ones(count))
        first = np.linalg.solve(self.compliance, self.drive) / scales
        unit = float(self.drive.max())
        way = np.append(first * np.repeat((1, 1 / law.stiffness), count), unit)
        way /= np.linalg.norm(way)
        at, stride = np.zeros(len(way)), end / STAGES
        path = [at]
        while at[:count].max() < end:
            if len(path) > 100 * STAGES:
                raise InputError("cracks: no bond came to the end of the law")
            at = self._next(at, stride * way, law, unit)
            way = (at - path[-1]) / np.linalg.norm(at - path[-1])
            path.append(at)
        tops = [point[:count].max() for point in path[-2:]]
        path[-1] = path[-2] + (path[-1] - path[-2]) * (end - tops[0]) / (tops[1] - tops[0])
        found = np.array(path)
        return found[:, -1] / unit, found[:, :count]

    def _next(self, at: np.ndarray, move: np.ndarray, law: RowLaw, unit: float) -> np.ndarray:
        """The equilibrium on the plane across a move.

        Unknowns are separations, shear tractions over the law's stiffness, and strain × unit.
        """
        k, count, z = law.stiffness, len(self.bonds), at + move
        for _ in range(ROUNDS):
            opening, sheared, strain = z[:count], z[count:-1], z[-1] / unit
            pull, slope = law(opening)
            lost = np.where(np.abs(opening) > 1e-9, k * opening / pull - 1, 0.0)
            by_opening = np.where(lost != 0, (k - (lost + 1) * slope) / pull, 0.0)
            apart = np.concatenate([opening - pull / k, lost * sheared])
            held = np.concatenate([[strain], pull, k * sheared])
            bent = self.bent @ held  # what (C23) adds to the drive and takes from the compliance
            compliance = np.column_stack([-self.drive, self.compliance])
            off = apart + (compliance - bent[1:] / 2) @ held
            answer = compliance - bent[1:]
            tangent = np.zeros((len(z), len(z)))
            tangent[:-1, :-1] = answer[:, 1:] * np.append(slope, np.full(count, k))
            row = np.arange(count)
            tangent[row, row] += 1 - slope / k
            tangent[count + row, row] += by_opening * sheared
            tangent[count + row, count + row] += lost
            tangent[:-1, -1], tangent[-1] = answer[:, 0] / unit, move
            step = np.linalg.solve(tangent, -np.append(off, move @ (z - at - move)))
            z = z + step
            if np.abs(step).max() < 1e-9 * law.separation[-1]:
                found: np.ndarray = z
                return found
        raise InputError("cracks: the path of equilibria was lost; no row holds like this")

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
        spans = spans[np.argsort(spans[:, 0])]
        low, high = spans[0, 0] - cells * step, spans[-1, 1] + cells * step
        ahead = step * (np.arange(cells) + 0.5)
        parts = [low + ahead, spans[-1, 1] + ahead]
        for left_end, right_end in zip(spans[:-1, 1], spans[1:, 0]):
            count = max(1, round((right_end - left_end) / step))  # whole bonds between two cracks
            parts.append(left_end + (right_end - left_end) * (np.arange(count) + 0.5) / count)
        places = np.sort(np.concatenate(parts))
        ends = (start + low * along, start + high * along)
        rows.append((ends, (2 * places - low - high) / (high - low)))
    return rows
