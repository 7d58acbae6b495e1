"""Any straight cracks in an elastic rectangle: what each tip releases (theory, C20–C21).

Each crack adds a series of powers of its own conformal coordinate, the rectangle two polynomials;
both satisfy the equations of plane elasticity, and least squares meet the rim and the faces. Cracks
need not lie on rows of nodes: this is the limit that lattices of cut bonds come to.
"""

import numpy as np
from numpy.typing import ArrayLike

from warp_peri import InputError

RESIDUAL = 3e-3
"""Largest displacement on the rim, and stress on faces, that is left over, in parts of the load;
intensities are right to a tenth of it or so."""
FACES = 3
"""Points on a crack per term of its series."""


class CrackedRectangle:
    """A rectangle about the origin with straight cracks, the displacement of its rim given.

    Args:
        lam, mu: plane Lamé constants [stress]; in plane stress those of the sheet.
        half: half sides [length].
        cracks: ends of each [length], shape [K, 2, 2].
        terms: of each crack's series; cracks close to each other or to the rim need more.
        degree: of the rectangle's polynomials.

    Attributes:
        lam, mu, E: constants of the sheet [stress], E = 4μ(λ + μ)/(λ + 2μ).
        ends, terms: as given.
        length: half lengths [length], shape [K].

    Raises InputError for constants without a stable solid, cracks that leave the rectangle, meet or
    have no length.
    """

    def __init__(
        self,
        lam: float,
        mu: float,
        half: tuple[float, float],
        cracks: ArrayLike,
        *,
        terms: int = 24,
        degree: int = 40,
    ) -> None:
        if not (mu > 0 and lam + mu > 0):
            raise InputError(f"lam, mu: expected μ > 0 and λ + μ > 0, got {lam:g}, {mu:g}")
        ends = _checked(cracks, half)
        self.lam, self.mu, self.ends, self.terms = lam, mu, ends, terms
        self.E = 4 * mu * (lam + mu) / (lam + 2 * mu)
        self._kolosov = (lam + 3 * mu) / (lam + mu)
        start, end = (ends[:, a, 0] + 1j * ends[:, a, 1] for a in (0, 1))
        self.length = np.abs(end - start) / 2
        self._centre, self._along = (start + end) / 2, (end - start) / np.abs(end - start)
        self._size = float(np.hypot(*half))
        self._n, self._powers = np.arange(1, terms + 1), np.arange(degree + 1)
        points = 3 * degree
        t = np.cos((np.arange(points) + 0.5) * np.pi / points)
        self._rim = np.concatenate([half[0] * t + 1j * half[1] * s for s in (1, -1)])
        self._rim = np.append(self._rim, [half[0] * s + 1j * half[1] * t for s in (1, -1)])
        count = FACES * terms
        self.faces = np.cos((np.arange(count) + 0.5) * np.pi / count)
        rows = [self._displacement(self._rim)]
        rows += [self._traction(k) for k in range(len(ends))]
        self._matrix = _real(np.concatenate(rows))

    def solve(self, strain: ArrayLike, pulls: np.ndarray | None = None) -> np.ndarray:
        """Coefficients of the rim pulled to a uniform gradient, and of tractions on the faces.

        Args:
            strain: displacement gradient of the rim, shape [2, 2].
            pulls: tractions that hold the faces of each crack together at the places `faces`,
                normal plus i times shear [stress], shape [K, faces, M] complex.

        Returns shape [unknowns, 1 + M]: the rim alone first, then each pull on a rim at rest.

        Raises InputError where rim and faces are not met by the terms that there are.
        """
        H = np.asarray(strain, dtype=float)
        count = len(self.length) * len(self.faces)
        u = (H[0, 0] + 1j * H[1, 0]) * self._rim.real + (H[0, 1] + 1j * H[1, 1]) * self._rim.imag
        load = np.append(2 * self.mu * u / self._size, np.zeros(count))[:, None]
        if pulls is not None:
            held = np.concatenate([np.zeros((len(u), pulls.shape[2])), *pulls])
            load = np.concatenate([load, held], axis=1)
        right = _real(load.astype(complex))
        scale = np.linalg.norm(self._matrix, axis=0)
        scale[scale == 0] = 1
        x: np.ndarray = np.linalg.lstsq(self._matrix / scale, right, rcond=1e-13)[0]
        x /= scale[:, None]
        left = np.abs(self._matrix @ x[:, 0] - right[:, 0]).max()
        if left > RESIDUAL * np.abs(right[:, 0]).max():
            raise InputError(
                f"cracks: {left / np.abs(right[:, 0]).max():.1e} of the load is left on rim and "
                f"faces, expected {RESIDUAL:g}; give more terms, or a higher degree"
            )
        return x

    def intensities(self, x: np.ndarray) -> np.ndarray:
        """K_I and K_II [stress · √length] of the tips at start and end, shape [K, 2, 2].

        x: one column of `solve`.
        """
        n, out = self._n, np.empty((len(self.length), 2, 2))
        for k, half in enumerate(self.length):
            local = self._series(x, k) / self._along[k]
            for tip, sign in enumerate(((-1.0) ** (n + 1), np.ones(len(n)))):
                both = -2 * np.sqrt(np.pi / half) * (n * sign * local).sum()
                out[k, tip] = both.real, -both.imag
        return out

    def releases(self, x: np.ndarray) -> np.ndarray:
        """Energy released per length by each tip straight ahead [stress · length], shape [K, 2]."""
        released: np.ndarray = (self.intensities(x) ** 2).sum(axis=-1) / self.E
        return released

    def opening(self, x: np.ndarray, crack: int, places: ArrayLike) -> np.ndarray:
        """Opening plus i times sliding of a crack at places from −1 to 1 along it, by columns of x.

        Returns shape [places] or [places, M], complex [length].
        """
        angle = np.arccos(np.asarray(places, dtype=float))
        local = np.conj(self._series(x, crack) / self._along[crack])
        gap: np.ndarray = np.sin(angle[:, None] * self._n) @ local
        return -(self._kolosov + 1) / self.mu * gap

    def gradients(self, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂/∂z and ∂/∂z̄ of u + i v at points z = x + i y off the cracks, by columns of x.

        Returns two arrays of shape [points, M]: half the divergence plus i times the rotation, and
        (ε₁₁ − ε₂₂)/2 + i ε₁₂.
        """
        at, m = z[:, None], len(self._powers)
        rest = x[2 * len(self._along) * len(self._n) :].reshape(4, m, -1)
        _, first, second = self._polynomials(z)
        phi, bent = first @ (rest[0] + 1j * rest[1]), second @ (rest[0] + 1j * rest[1])
        psi = first @ (rest[2] + 1j * rest[3])
        for k, along in enumerate(self._along):
            g, (_, first, second) = self._series(x, k), self._powers_of_crack(z, k)
            arm = np.conj(self._centre[k]) + np.conj(along) ** 2 * (at - self._centre[k])
            own, curved = first @ g, second @ g
            phi, bent = phi + own, bent + curved
            psi = psi + first @ np.conj(g) - np.conj(along) ** 2 * own - arm * curved
        both = self._kolosov * phi - np.conj(phi), -at * np.conj(bent) - np.conj(psi)
        return both[0] / (2 * self.mu), both[1] / (2 * self.mu)

    def _series(self, x: np.ndarray, k: int) -> np.ndarray:
        """Complex coefficients of one crack."""
        count = len(self._n)
        part = x[2 * k * count : 2 * (k + 1) * count]
        series: np.ndarray = part[:count] + 1j * part[count:]
        return series

    def _powers_of_crack(self, z: np.ndarray, k: int) -> tuple[np.ndarray, ...]:
        """w⁻ⁿ and its first two derivatives by z, shape [points, terms] each."""
        place, n = (z - self._centre[k]) / (self.length[k] * self._along[k]), self._n
        root = np.sqrt(place - 1) * np.sqrt(place + 1)
        f, root, place = (place + root)[:, None] ** -n, root[:, None], place[:, None]
        unit = self.length[k] * self._along[k]
        return f, -n * f / root / unit, n * f * (n / root**2 + place / root**3) / unit**2

    def _displacement(self, z: np.ndarray) -> np.ndarray:
        """2μ (u + i v) over the size, a column of each real unknown."""
        columns, at = [], z[:, None]
        for k, along in enumerate(self._along):
            f, first, _ = self._powers_of_crack(z, k)
            arm = np.conj(self._centre[k]) + np.conj(along) ** 2 * (at - self._centre[k])
            for g in (1, 1j):
                psi = np.conj(g) * f - arm * first * g
                columns.append(self._kolosov * g * f - at * np.conj(g * first) - np.conj(psi))
        power, first, _ = self._polynomials(z)
        columns += [self._kolosov * g * power - at * np.conj(g * first) for g in (1, 1j)]
        columns += [-np.conj(g * power) for g in (1, 1j)]
        return np.concatenate(columns, axis=1) / self._size

    def _polynomials(self, z: np.ndarray) -> tuple[np.ndarray, ...]:
        """Powers of z over the size and their first two derivatives by z."""
        m, at = self._powers, (z / self._size)[:, None]
        first = m * at ** np.maximum(m - 1, 0) / self._size
        return at**m, first, m * (m - 1) * at ** np.maximum(m - 2, 0) / self._size**2

    def _traction(self, own: int) -> np.ndarray:
        """Normal plus i times shear stress on one crack's faces, a column of each real unknown."""
        columns, turn = [], self._along[own]
        z = self._centre[own] + self.length[own] * turn * self.faces
        at, angle = np.conj(z)[:, None], np.arccos(self.faces)[:, None]
        for k, along in enumerate(self._along):
            if k == own:  # the singular parts of both faces cancel
                wave = 2 * self._n * np.sin(angle * self._n) / np.sin(angle) / self.length[k]
                columns += [np.conj(g / along) * wave for g in (1, 1j)]
                continue
            _, first, second = self._powers_of_crack(z, k)
            arm = np.conj(self._centre[k]) + np.conj(along) ** 2 * (z[:, None] - self._centre[k])
            for g in (1, 1j):
                psi = (np.conj(g) - np.conj(along) ** 2 * g) * first - arm * second * g
                columns.append(2 * np.real(g * first) + turn**2 * (at * g * second + psi))
        _, first, second = self._polynomials(z)
        columns += [2 * np.real(g * first) + turn**2 * at * g * second for g in (1, 1j)]
        columns += [turn**2 * g * first for g in (1, 1j)]
        return np.concatenate(columns, axis=1)


def _real(a: np.ndarray) -> np.ndarray:
    """Real parts above imaginary ones."""
    return np.concatenate([a.real, a.imag])


def _checked(cracks: ArrayLike, half: tuple[float, float]) -> np.ndarray:
    """Ends of cracks that lie in the rectangle and do not meet, shape [K, 2, 2]."""
    ends = np.asarray(cracks, dtype=float)
    if ends.ndim != 3 or ends.shape[1:] != (2, 2) or not np.isfinite(ends).all():
        raise InputError(f"cracks: expected finite ends, shape [K, 2, 2], got {list(ends.shape)}")
    if not (np.abs(ends) < half).all() or (ends[:, 0] == ends[:, 1]).all(axis=1).any():
        raise InputError(f"cracks: expected a length, and ends within ± {half[0]:g}, {half[1]:g}")
    for k, (a, b) in enumerate(ends):
        for c, d in ends[:k]:
            if meet(a, b, c, d):
                raise InputError(f"cracks: expected cracks apart, number {k} meets another")
    return ends


def meet(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    """Whether the segments from a to b and from c to d have a point in common."""
    return _sides(a, b, c, d) <= 0 and _sides(c, d, a, b) <= 0 and _overlap(a, b, c, d)


def _sides(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    """Above zero if c and d lie on one side of the line through a and b."""
    normal = np.array([a[1] - b[1], b[0] - a[0]])
    return float(normal @ (c - a)) * float(normal @ (d - a))


def _overlap(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    """Whether the boxes around two segments meet."""
    low, high = (
        np.maximum(np.minimum(a, b), np.minimum(c, d)),
        np.minimum(np.maximum(a, b), np.maximum(c, d)),
    )
    return bool((low <= high).all())
