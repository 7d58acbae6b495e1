"""Straight cracks whose tips turn into rows of bonds at an angle (theory, C24).

Cracks and the rows ahead of their tips are chains of short pieces, each with one opening and one
sliding; polynomials meet the rim. Two dislocations bound a piece, so that all fields are closed
expressions.
"""

from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from examples.cracks.cohesive_zone import CubicEnergy, HeldCracks, check_lengths
from examples.cracks.straight_cracks import CrackedRectangle, meet
from warp_peri import InputError

Potentials: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""φ, φ′, φ″, ψ and ψ′ of (C20), a column of each source."""
PIECES = 4
"""Of a step."""
TERMS, DEGREE = 60, 40
"""Of the series that give the intensities, and of the polynomials that meet the rim."""


class KinkedCracks(HeldCracks):
    """Straight cracks in a rectangle; rows of bonds that turn off at their tips hold them.

    Each tip turns into the row, one of six directions, that the crack without kinks would open
    most, (C19). Use HeldCracks where cracks follow rows.

    Args:
        lam, mu: plane Lamé constants [stress].
        half: half sides of the rectangle [length].
        cracks: ends of each, midway between bonds [length], shape [K, 2, 2].
        step: between bonds along a row [length].
        cells: bonds ahead of each tip that may open.
        cubic: the sheet's energy of third order, whose axis is along rows; None for a linear sheet
            with rows along x.
        height: between rows [length]. Over this height the law of a row stands for the sheet.

    Attributes:
        kinks: angles by which tips turn [radians], shape [K, 2].
        bonds, drive, compliance, bent: as of HeldCracks.

    Raises what CrackedRectangle raises, and InputError for a step or height that is not > 0, and
    rows that leave the rectangle or meet another crack's.
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
        cubic: CubicEnergy | None = None,
        height: float = 0.0,
    ) -> None:
        check_lengths(step, height, cubic)
        whole = CrackedRectangle(lam, mu, half, cracks, terms=TERMS)
        self.kinks, rows = _turned(whole, 0.0 if cubic is None else cubic.axis)
        _check_apart(whole.ends, step * cells * rows, half)
        start, end, cell = _pieces(whole.ends @ (1, 1j), rows, step, cells)
        along = (end - start) / np.abs(end - start)
        fields, middle = _Fields(lam, mu, half, start, end), (start + end) / 2
        bonds = int(cell.max()) + 1

        def traction(by_z: np.ndarray, by_conjugate: np.ndarray) -> np.ndarray:
            """Normal, then shear stress on the pieces."""
            turned = 2 * mu * by_conjugate / along[:, None] ** 2
            return np.concatenate([2 * (lam + mu) * by_z.real - turned.real, turned.imag])

        of_all = fields.gradients(middle, np.eye(1 + 2 * len(start)))
        by_pull, by_gap = np.split(traction(*of_all), [1], axis=1)
        held = cell[:, None] == np.arange(bonds)
        pulls = np.kron(np.eye(2), held)
        gaps = np.linalg.solve(by_gap, np.column_stack([-by_pull, pulls]))
        means = pulls.T @ gaps / PIECES
        self.drive, self.compliance = means[:, 0], -means[:, 1:]
        where = held.T @ middle / PIECES
        self.bonds = np.column_stack([where.real, where.imag])
        self.bent = np.zeros(3 * (gaps.shape[1],))
        if cubic is None:
            return

        def beside(z: np.ndarray) -> np.ndarray:
            place = (z[:, None] - start) / along
            off = place - np.clip(place.real, 0, np.abs(end - start))
            return np.asarray(np.abs(off).min(axis=1) > height / 2)

        unit = np.vstack([np.eye(1, gaps.shape[1]), gaps])
        of_unit = partial(fields.gradients, columns=unit)
        self.bent = cubic.bent(half, step, height, beside, of_unit, gaps.shape[1])


def _turned(whole: CrackedRectangle, axis: float) -> tuple[np.ndarray, np.ndarray]:
    """By which angle each tip turns, and the direction of its row as e^{iθ}, shape [K, 2]."""
    K = whole.intensities(whole.solve([[0, 0], [0, 1]])[:, 0])[:, :, None]
    ahead = whole.ends[:, 1] - whole.ends[:, 0]
    out = np.arctan2(ahead[:, 1], ahead[:, 0])[:, None, None] + np.array([[np.pi], [0.0]])
    turn = axis + np.radians(np.arange(0, 360, 60)) - out
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    c = np.where(np.abs(turn) < np.pi / 2, np.cos(turn / 2), 0.0)
    opens = c * (K[..., 0] * c**2 - 1.5 * K[..., 1] * np.sin(turn))
    kinks = np.take_along_axis(turn, opens.argmax(axis=2)[..., None], axis=2)
    return kinks[..., 0], np.exp(1j * (kinks + out)[..., 0])


def _check_apart(ends: np.ndarray, rows: np.ndarray, half: tuple[float, float]) -> None:
    """Refuse rows that leave the rectangle, or meet another crack or its rows."""
    ahead = ends + np.stack([rows.real, rows.imag], axis=-1)
    if not (np.abs(ahead) < half).all():
        raise InputError("cracks: expected room for rows of bonds ahead of tips, the rim is nearer")
    chains = [((a, p), (a, b), (b, q)) for (a, b), (p, q) in zip(ends, ahead, strict=True)]
    for k, chain in enumerate(chains):
        for other in chains[:k]:
            if any(meet(*one, *two) for one in chain for two in other):
                raise InputError(f"cracks: expected rows ahead of tips apart, {k}'s meet another's")


def _pieces(
    cracks: np.ndarray, rows: np.ndarray, step: float, cells: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends of all pieces, and the bond whose cell each is a part of, −1 for those of cracks."""
    start, end, cell, bond = [], [], [], 0
    for (low, high), directions in zip(cracks, rows, strict=True):
        places = np.linspace(low, high, 1 + max(4, round(PIECES * abs(high - low) / step)))
        start.append(places[:-1])
        end.append(places[1:])
        cell.append(np.full(len(places) - 1, -1))
        for tip, direction, side in zip((low, high), directions, (0, 1), strict=True):
            places = tip + direction * step / PIECES * np.arange(cells * PIECES + 1)
            start.append(places[:-1] if side else places[1:])  # its left is the crack's left
            end.append(places[1:] if side else places[:-1])
            cell.append(bond + np.arange(cells * PIECES) // PIECES)
            bond += cells
    return np.concatenate(start), np.concatenate(end), np.concatenate(cell)


class _Fields:
    """Fields of a rectangle whose rim follows a unit strain ε₂₂, and of each piece's unit opening
    and sliding with the rim at rest."""

    def __init__(
        self, lam: float, mu: float, half: tuple[float, float], start: np.ndarray, end: np.ndarray
    ) -> None:
        self._kolosov, self._mu = (lam + 3 * mu) / (lam + mu), mu
        along = (end - start) / np.abs(end - start)
        self._ends = np.tile(start, 2), np.tile(end, 2)
        self._jump = 1j * mu / np.pi / (self._kolosov + 1) * np.append(1j * along, along)
        self._size, self._powers = float(np.hypot(*half)), np.arange(DEGREE + 1)
        t = np.cos((np.arange(3 * DEGREE) + 0.5) * np.pi / (3 * DEGREE))
        sides = [half[0] * t + 1j * half[1] * s for s in (1, -1)]
        rim = np.concatenate(sides + [half[0] * s + 1j * half[1] * t for s in (1, -1)])
        ours = np.column_stack([1j * rim.imag, -self._displacement(self._of_pieces(rim), rim)])
        polynomials = self._displacement(self._of_polynomials(rim), rim)
        left, right = (np.concatenate([a.real, a.imag]) for a in (polynomials, ours))
        scale = np.linalg.norm(left, axis=0)
        scale[scale == 0] = 1
        self._meet = np.linalg.lstsq(left / scale, right, rcond=1e-13)[0] / scale[:, None]

    def gradients(self, z: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂/∂z and ∂/∂z̄ of u + i v, as of CrackedRectangle, shape [points, M].

        columns: how much of the strain, then of every opening and sliding, shape [1 + 2P, M].
        """
        own = self._gradients(self._of_pieces(z), z)
        met = self._gradients(self._of_polynomials(z), z)
        by_z, by_conjugate = (
            of_pieces @ columns[1:] + of_rim @ (self._meet @ columns)
            for of_pieces, of_rim in zip(own, met, strict=True)
        )
        return by_z, by_conjugate

    def _of_pieces(self, z: np.ndarray) -> Potentials:
        """Of two opposite dislocations each."""
        a, (start, end), at = self._jump, self._ends, z[:, None]
        near, far = 1 / (at - start), 1 / (at - end)
        log = np.log(far / near)  # its cut is the piece
        phi, psi = a * log, np.conj(a) * log - a * (np.conj(start) * near - np.conj(end) * far)
        slope = np.conj(a) * (near - far)
        slope += a * (np.conj(start) * near**2 - np.conj(end) * far**2)
        return phi, a * (near - far), a * (far**2 - near**2), psi, slope

    def _of_polynomials(self, z: np.ndarray) -> Potentials:
        """Of powers of z in φ, then in ψ, with real and imaginary coefficients."""
        m, at = self._powers, (z / self._size)[:, None]
        power, first = at**m, m * at ** np.maximum(m - 1, 0) / self._size
        second = m * (m - 1) * at ** np.maximum(m - 2, 0) / self._size**2
        none = np.zeros((len(z), 2 * len(m)), complex)
        in_phi = [np.column_stack([f, 1j * f, none]) for f in (power, first, second)]
        in_psi = [np.column_stack([none, f, 1j * f]) for f in (power, first)]
        return in_phi[0], in_phi[1], in_phi[2], in_psi[0], in_psi[1]

    def _displacement(self, potentials: Potentials, z: np.ndarray) -> np.ndarray:
        """u + i v, a column of each."""
        phi, first, _, psi, _ = potentials
        both: np.ndarray = self._kolosov * phi - z[:, None] * np.conj(first) - np.conj(psi)
        return both / (2 * self._mu)

    def _gradients(self, potentials: Potentials, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂/∂z and ∂/∂z̄ of it."""
        _, first, second, _, slope = potentials
        by_z = self._kolosov * first - np.conj(first)
        by_conjugate = -z[:, None] * np.conj(second) - np.conj(slope)
        return by_z / (2 * self._mu), by_conjugate / (2 * self._mu)
