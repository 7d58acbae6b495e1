"""Coordinates of the constrained optimum for an influence function given as a callable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_peri.coordinates import Point
from warp_peri.errors import InputError
from warp_peri.families import BondClasses
from warp_peri.influence import CANCELLED
from warp_peri.parameters import Parameters
from warp_peri.shapes import InfluenceFunction


class ShapeCoordinates:
    """y = (κ, μ, parameters of the shape); stiffnesses v = μ K W / Σ n r² K W (theory.md, 59).

    Args:
        lattices: bond classes of each lattice.
        shape: the influence function, with the values to start from.

    Raises InputError for a shape whose weighted volume is zero on a lattice.
    """

    def __init__(self, lattices: Sequence[BondClasses], shape: InfluenceFunction) -> None:
        self.lattices, self.shape = lattices, shape
        self._sigma = [one.count * one.r**2 for one in lattices]
        self._ends = shape.ends
        self._first = shape.vector
        self._size = np.maximum(1.0, np.abs(self._first))
        width = self._ends[1] - self._ends[0]
        self._room = np.where(np.isfinite(width), width, self._size)
        for one, sigma in zip(lattices, self._sigma):
            terms = sigma * one.weight * shape(one.r)
            if not abs(terms.sum()) > CANCELLED * np.abs(terms).sum():
                raise InputError(
                    f"influence '{shape.name}': its weighted volume (theory.md, 5) is zero on the "
                    f"lattice of spacing {one.spacing:g} Å with {dict(shape.parameters)}"
                )

    def start(self, parameters: Parameters) -> np.ndarray:
        """y of given parameters."""
        assert parameters.shape is not None
        kappa = (parameters.lam - parameters.mu) / parameters.mu**2
        return np.concatenate([[kappa, parameters.mu], parameters.shape.vector])

    def point(self, y: np.ndarray) -> Point:
        """v, z, κ and μ at y, with their derivatives."""
        mu = float(y[1])
        dmu = np.eye(len(y))[1]
        shape = self.shape.at(np.clip(y[2:], *self._ends))
        v, dv = [], []
        for one, sigma in zip(self.lattices, self._sigma):
            kw = one.weight * shape(one.r)
            dkw = one.weight[:, None] * shape.slopes(one.r)
            # On its way SLSQP may look where the weighted volume vanishes.
            total = sigma @ kw or np.finfo(float).tiny
            slope = np.zeros((len(kw), len(y)))
            slope[:, 1] = kw / total
            slope[:, 2:] = mu / total * (dkw - np.outer(kw / total, sigma @ dkw))
            v.append(mu * kw / total)
            dv.append(slope)
        limits, dlimits = self._limits(y)
        return Point(float(y[0]), 0.0, mu, dmu, v, v, dv, dv, limits, dlimits)

    def _limits(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances from the bounds, in parts of what lies between, and their derivative."""
        signed = np.concatenate([(y[2:] - self._ends[0]), (self._ends[1] - y[2:])])
        slopes = np.concatenate([np.eye(len(y))[2:], -np.eye(len(y))[2:]])
        bounded = np.isfinite(signed)
        size = np.concatenate([self._room, self._room])[bounded]
        return signed[bounded] / size, slopes[bounded] / size[:, None]

    def roughness(self, y: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """How far the parameters are from where they began, and the derivative to y.

        It keeps the scale of K, which has no effect, from drifting.
        """
        slopes = np.zeros((len(y) - 2, len(y)))
        slopes[:, 2:] = np.diag(1 / self._size)
        return (y[2:] - self._first) / self._size, slopes

    def parameters(self, y: np.ndarray, losses: list[float]) -> Parameters:
        """λ, μ, the shape and the polynomial that stands for it, at y."""
        kappa, mu = float(y[0]), float(y[1])
        shape = self.shape.at(np.clip(y[2:], *self._ends))
        D, _ = shape.coefficients(self.lengths, self.lattices[0].horizon)
        return Parameters(mu + kappa * mu**2, mu, 0.0, D, losses, shape=shape)

    @property
    def lengths(self) -> np.ndarray:
        """Bond lengths of all lattices [Å]."""
        return np.concatenate([one.r for one in self.lattices])
