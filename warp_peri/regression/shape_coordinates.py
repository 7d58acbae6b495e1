"""Coordinates of the constrained optimum for an influence function given as a callable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_peri.errors import InputError
from warp_peri.models.influence import CANCELLED
from warp_peri.models.shapes import InfluenceFunction
from warp_peri.points.families import BondClasses
from warp_peri.regression.coordinates import Point, scaled
from warp_peri.regression.parameters import Parameters

TINY, SEEN = 1e-3, 1e-9
"""A parameter counts as of its size at the start times the first, at least; a direction counts
where it changes the stiffnesses by more than the second, relative to the one that does most."""


class ShapeCoordinates:
    """y = (κ, size a of K, parameters of the shape); stiffnesses v = a K W (theory.md, 59).

    μ = Σ n r² v is no coordinate, so that a search may pass where the weighted volume is zero.

    Args:
        lattices: bond classes of each lattice.
        shape: the influence function, with the values to start from.

    Raises InputError for a shape whose weighted volume is zero on a lattice.
    """

    def __init__(self, lattices: Sequence[BondClasses], shape: InfluenceFunction) -> None:
        self.lattices, self.shape = lattices, shape
        self._sigma = [classes.count * classes.r**2 for classes in lattices]
        self._ends = shape.ends
        self._first = shape.vector
        self._size = np.maximum(1.0, np.abs(self._first))
        width = self._ends[1] - self._ends[0]
        self._room = np.where(np.isfinite(width), width, self._size)
        for classes, sigma in zip(lattices, self._sigma):
            terms = sigma * classes.weight * shape(classes.r)
            if not abs(terms.sum()) > CANCELLED * np.abs(terms).sum():
                raise InputError(
                    f"influence '{shape.name}': its weighted volume (theory.md, 5) is zero on the "
                    f"lattice of spacing {classes.spacing:g} with {dict(shape.parameters)}"
                )

    def start(self, parameters: Parameters) -> np.ndarray:
        """y of given parameters."""
        if parameters.shape is None:
            raise InputError("parameters: expected those of a shape, got Bernstein coefficients")
        kappa = (parameters.lam - parameters.mu) / parameters.mu**2
        classes, shape = self.lattices[0], parameters.shape
        size = parameters.mu / (self._sigma[0] @ (classes.weight * shape(classes.r)))
        return np.concatenate([[kappa, size], shape.vector])

    def point(self, y: np.ndarray) -> Point:
        """v, z, κ and μ at y, with their derivatives."""
        shape = self.shape.at(np.clip(y[2:], *self._ends))
        v, dv = [], []
        for classes in self.lattices:
            kw = classes.weight * shape(classes.r)
            slope = np.zeros((len(kw), len(y)))
            slope[:, 1] = kw
            slope[:, 2:] = y[1] * classes.weight[:, None] * shape.slopes(classes.r)
            v.append(y[1] * kw)
            dv.append(slope)
        mu, dmu = float(self._sigma[0] @ v[0]), self._sigma[0] @ dv[0]
        for number in range(1, len(v)):
            v[number], dv[number] = scaled(v[number], dv[number], self._sigma[number], mu, dmu)
        limits, dlimits = self._limits(y)
        return Point(float(y[0]), 0.0, mu, dmu, v, v, dv, dv, limits, dlimits)

    def directions(self, y: np.ndarray) -> np.ndarray:
        """Directions that change a stiffness, shape [Y, F]; the scale of a table's K does not."""
        size = np.concatenate([[abs(y[1])], np.maximum(np.abs(y[2:]), TINY * self._size)])
        change = np.concatenate(self.point(y).dv)[:, 1:] * size
        _, values, right = np.linalg.svd(change, full_matrices=False)
        kept = right[values > SEEN * values[0]]
        out = np.zeros((len(y), 1 + len(kept)))
        out[0, 0] = 1.0
        out[1:, 1:] = size[:, None] * kept.T
        return out

    def _limits(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances from the bounds, in parts of what lies between, and their derivative."""
        signed = np.concatenate([(y[2:] - self._ends[0]), (self._ends[1] - y[2:])])
        slopes = np.concatenate([np.eye(len(y))[2:], -np.eye(len(y))[2:]])
        bounded = np.isfinite(signed)
        size = np.concatenate([self._room, self._room])[bounded]
        return signed[bounded] / size, slopes[bounded] / size[:, None]

    def roughness(self, y: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """How far the parameters are from where they began, and the derivative to y.

        It keeps one that hardly matters from running away.
        """
        slopes = np.zeros((len(y) - 2, len(y)))
        slopes[:, 2:] = np.diag(1 / self._size)
        return (y[2:] - self._first) / self._size, slopes

    def parameters(self, y: np.ndarray, losses: list[float]) -> Parameters:
        """λ, μ, the shape and the polynomial that stands for it, at y."""
        kappa, mu = float(y[0]), self.point(y).mu
        shape = self.shape.at(np.clip(y[2:], *self._ends))
        D, _ = shape.coefficients(self.lengths, self.lattices[0].horizon)
        return Parameters(mu + kappa * mu**2, mu, 0.0, D, losses, shape=shape)

    @property
    def lengths(self) -> np.ndarray:
        """Bond lengths of all lattices [Å]."""
        return np.concatenate([classes.r for classes in self.lattices])
