"""A sheet's third-order energy on the fields of its linear cracks (theory.md, C23).

The energy of an elastic body is stationary at rest, so the energy of third order on the linear
field is what it adds, to first order.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri import InputError

FINER = 2
"""Points of the sheet in a step, and in a height."""
CHUNK = 4000
"""Of these points, whose fields are held at a time."""


@dataclass(frozen=True)
class CubicEnergy:
    """The cubic part of the energy density of a displacement gradient, (N3).

    Attributes:
        stiffness: λ + μ and μ [stress], which finite strains multiply.
        t3, tq2, q3: third-order constants [stress].
        axis: angle of the zigzag direction from x [radians].
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

        Args:
            half: half sides of the rectangle [length].
            step, height: between bonds along a row, and between rows [length].
            beside: which points x + i y belong to the sheet.
            gradients: columns of the displacement gradient at points, as of `between`.
            size: M, of these columns.
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
