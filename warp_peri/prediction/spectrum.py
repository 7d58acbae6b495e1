"""What part of a field has which wavelength, and what a material leaves of each (Q6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.fft
import scipy.sparse as sp
from scipy.ndimage import distance_transform_edt

from warp_peri.core.record import Quantity
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import PointsLike

SEEN = 0.5
"""Samples' worth of a wavelength from which its error counts as known."""
KNOTS = 2.0 * 2.0 ** (np.arange(12) / 2)
"""Wavelengths in spacings between which a record is interpolated."""


@dataclass(frozen=True)
class ErrorSpectrum:
    """The relative error of a material's answers by wavelength.

    Attributes:
        wavelength: [length], growing, shape [K].
        error: a fraction, shape [K]; between the wavelengths its square is linear in their
            logarithms, and it is constant beyond them.
        shortest: wavelength that samples held enough of [length]; below it the largest error that
            is known stands for one that is not.
    """

    wavelength: Annotated[np.ndarray, Quantity(length=1)]
    error: np.ndarray
    shortest: Annotated[float, Quantity(length=1)] = 0.0

    def of(self, shares: np.ndarray) -> float:
        """The error of a field with those shares, relative to the field."""
        return float(np.sqrt(shares @ self.error**2))

    def unseen(self, shares: np.ndarray) -> float:
        """The share of a field that is shorter than all that samples held."""
        return float(shares[self.wavelength < self.shortest * (1 - 1e-9)].sum())

    def told(self, shares: np.ndarray) -> tuple[float, float]:
        """Both: the error, and the share that is not seen."""
        return self.of(shares), self.unseen(shares)


class Spectrum:
    """Shares of fields on a lattice by wavelength; what is affine in a field belongs to none.

    A field is taken to zero towards the edge of its nodes.

    Args:
        points: the lattice.
        wavelength: [length], growing, shape [K].
    """

    def __init__(self, points: PointsLike, wavelength: np.ndarray) -> None:
        grid, _ = lattice_steps(points)
        grid = grid - grid.min(axis=0)
        self.shape = tuple(int(n) for n in grid.max(axis=0) + 1)
        self.place = np.ravel_multi_index(tuple(grid.T), self.shape)
        there = np.zeros(self.shape, bool)
        there.flat[self.place] = True
        depth = distance_transform_edt(np.pad(there, 1))[(slice(1, -1),) * len(self.shape)]
        depth = depth.flat[self.place]
        self.window = np.sin(np.pi / 2 * depth / depth.max()) ** 2
        self.affine = np.linalg.qr(np.column_stack([np.ones(len(grid)), grid]))[0]
        self.wide = [scipy.fft.next_fast_len(2 * n, real=True) for n in self.shape]
        lines = [np.fft.fftfreq(n, points.spacing) for n in self.wide[:-1]]
        lines.append(np.fft.rfftfreq(self.wide[-1], points.spacing))
        waves = np.meshgrid(*lines, indexing="ij")
        length = 1 / np.maximum(np.linalg.norm(waves, axis=0), 1e-300)
        twice = np.full(len(lines[-1]), 2.0)  # of ±k one is not computed
        twice[[0] if self.wide[-1] % 2 else [0, -1]] = 1.0
        share, count = twice / np.prod(self.wide), len(wavelength)
        knot = np.interp(np.log(length), np.log(wavelength), np.arange(count)).ravel()
        low = np.minimum(knot.astype(int), count - 2)
        upper, whole = knot - low, np.broadcast_to(share, length.shape).ravel()
        values = np.concatenate([whole * (1 - upper), whole * upper])
        at = np.concatenate([low, low + 1]), np.tile(np.arange(low.size), 2)
        self.by_knot = sp.csr_array((values, at), (count, low.size))

    def shares(self, u: np.ndarray) -> np.ndarray:
        """Shares of the square of a field [N, d], shape [K]."""
        u = u / max(float(np.abs(u).max()), 1e-300)
        left = (u - self.affine @ (self.affine.T @ u)) * self.window[:, None]
        field = np.zeros((u.shape[1], int(np.prod(self.shape))), np.float32)
        field[:, self.place] = left.T
        axes = tuple(range(1, 1 + len(self.shape)))
        wave = scipy.fft.rfftn(field.reshape(-1, *self.shape), s=self.wide, axes=axes)
        power = (wave.real**2 + wave.imag**2).sum(axis=0).ravel()
        found = self.by_knot @ power
        size = float(((u * self.window[:, None]) ** 2).sum())
        return np.asarray(found / size if size > 0 else found)


def recorded(wavelength: np.ndarray, rows: np.ndarray, errors: np.ndarray) -> ErrorSpectrum:
    """The root mean square of the errors of samples, by what they have of a wavelength.

    Args:
        wavelength: [length], shape [K].
        rows: shares of the samples there, shape [S, K].
        errors: of their answers, fractions, shape [S].
    """
    there = rows.sum(axis=0)
    error = np.sqrt((rows * errors[:, None] ** 2).sum(axis=0) / np.maximum(there, 1e-300))
    first = int(np.argmax(there >= min(SEEN, there.max())))
    error[:first] = error[first:][there[first:] >= min(SEEN, there.max())].max()
    return ErrorSpectrum(wavelength, error, float(wavelength[first]))
