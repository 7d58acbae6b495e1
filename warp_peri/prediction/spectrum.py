"""What part of a field has which wavelength, and what a material leaves of each (Q6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import PointsLike

KNOTS = 2.0 * 2.0 ** (np.arange(12) / 2)
"""Wavelengths in spacings between which a record is interpolated."""


@dataclass(frozen=True)
class Record:
    """The relative error of a material's answers by wavelength.

    Attributes:
        wavelength: [length], growing, shape [K].
        error: a fraction, shape [K]; between the wavelengths its square is linear in their
            logarithms, and it is constant beyond them.
    """

    wavelength: np.ndarray
    error: np.ndarray

    def of(self, points: PointsLike, u: np.ndarray) -> float:
        """The error of a field [N, d] on a lattice, relative to the field."""
        return float(np.sqrt(shares(points, u, self.wavelength) @ self.error**2))


def shares(points: PointsLike, u: np.ndarray, wavelength: np.ndarray) -> np.ndarray:
    """Shares of ‖u‖² by wavelength, shape [K]; what is affine in a field belongs to none.

    The field is taken to zero towards the edge of its nodes.
    """
    grid, _ = lattice_steps(points)
    grid = grid - grid.min(axis=0)
    shape = tuple(grid.max(axis=0) + 1)
    there = np.zeros(shape, bool)
    there[tuple(grid.T)] = True
    depth = distance_transform_edt(np.pad(there, 1))[(slice(1, -1),) * len(shape)]
    window = np.sin(np.pi / 2 * depth[tuple(grid.T)] / depth.max()) ** 2
    affine = np.column_stack([np.ones(len(grid)), grid])
    left = u - affine @ np.linalg.lstsq(affine, u, rcond=None)[0]
    field = np.zeros((*shape, u.shape[1]))
    field[tuple(grid.T)] = left * window[:, None]
    wide = [2 * n for n in shape]
    axes = tuple(range(len(shape)))
    power = (np.abs(np.fft.fftn(field, s=wide, axes=axes)) ** 2).sum(axis=-1) / np.prod(wide)
    waves = np.meshgrid(*(np.fft.fftfreq(n, points.spacing) for n in wide), indexing="ij")
    length = 1 / np.maximum(np.linalg.norm(waves, axis=0), 1e-300)
    place = np.interp(np.log(length).ravel(), np.log(wavelength), np.arange(len(wavelength)))
    low = np.minimum(place.astype(int), len(wavelength) - 2)
    upper, power = place - low, power.ravel()
    count = len(wavelength)
    found = np.bincount(low, power * (1 - upper), count)
    found += np.bincount(low + 1, power * upper, count)
    whole = float(((u * window[:, None]) ** 2).sum())
    return np.asarray(found / whole if whole > 0 else found)


def recorded(
    longest: float, wavelength: np.ndarray, rows: np.ndarray, errors: np.ndarray
) -> Record:
    """The root mean square of the errors of samples, by what they have of a wavelength.

    Args:
        longest: wavelengths from there on have no error here [length].
        wavelength: [length], shape [K].
        rows: `shares` of the samples there, shape [S, K].
        errors: of their answers, fractions, shape [S].
    """
    square = (rows * errors[:, None] ** 2).sum(axis=0) / np.maximum(rows.sum(axis=0), 1e-300)
    return Record(wavelength, np.sqrt(np.where(wavelength < longest, square, 0.0)))
