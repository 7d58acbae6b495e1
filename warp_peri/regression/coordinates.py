"""Numbers of a solid while they are learned, and coordinates of the optimum (theory, 26–28).

A kernel r^(−α) Σ D_k B_k,M gives every bond class of every lattice a table entry K W. Only the span
of these tables can be told apart; its coordinates q take the place of D, and the scale of K falls
out because stiffnesses are v = μ w. α is a variable only where the coefficients do not already
reach every bond length; elsewhere it is redundant and keeps its value, as it does in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from warp_peri.errors import InputError
from warp_peri.materials.influence import InfluenceFunction
from warp_peri.materials.lps import CANCELLED, bernstein_basis
from warp_peri.points.families import BondClasses
from warp_peri.regression.losses import FullLoss, ReducedLoss, class_weights

SMALLEST_MODULUS, LARGEST_ALPHA = 1e-3, 3 - 1e-3
"""μ and λ + μ [TPa] stay above the first, α below the second."""


@dataclass(frozen=True)
class Parameters:
    """λ, μ [TPa], α, D of one stage, inside their bounds, and the loss on the way there.

    shape is the influence function that D stands for, if its parameters are what is learned.
    """

    lam: float
    mu: float
    alpha: float
    D: np.ndarray
    losses: list[float] = field(default_factory=list, repr=False)
    shape: InfluenceFunction | None = None


class Variables:
    """λ, μ, α, D as torch leaves for Adam.

    Args:
        start: their values.
        positive: keep D ≥ 0.
        parametrisation: "relu" is the printed one (4.8): the loss sees ReLU(μ), ReLU(λ + μ) −
            ReLU(μ), 3 − ReLU(3 − α) and, for a positive kernel, ReLU(D). A ReLU has no gradient
            once its argument is negative, and λ + μ, which every run drives to zero early in
            stage 1, stays there for good. "projected" keeps the same bounds by moving the leaves
            back after every step.
    """

    def __init__(self, start: Parameters, *, positive: bool, parametrisation: str) -> None:
        values = start.lam, start.mu, start.alpha, start.D
        self.leaves = [torch.tensor(value, dtype=torch.float64) for value in values]
        for leaf in self.leaves:
            leaf.requires_grad_()
        self.positive, self.relu = positive, parametrisation == "relu"

    def bounded(self) -> list[torch.Tensor]:
        """λ, μ, α and D, as the loss sees them."""
        if not self.relu:
            return self.leaves
        lam, mu, alpha, D = self.leaves
        stiff = torch.relu(mu)
        D = torch.relu(D) if self.positive else D
        return [torch.relu(lam + mu) - stiff, stiff, 3 - torch.relu(3 - alpha), D]

    def project(self) -> None:
        """Move the leaves back inside their bounds; nothing to do under the ReLU."""
        if self.relu:
            return
        lam, mu, alpha, D = self.leaves
        with torch.no_grad():
            mu.clamp_(min=SMALLEST_MODULUS)
            lam.clamp_(min=SMALLEST_MODULUS - mu)
            alpha.clamp_(max=LARGEST_ALPHA)
            if self.positive:
                D.clamp_(min=0.0)

    def loss(self, terms: Sequence[ReducedLoss | FullLoss]) -> torch.Tensor:
        """The loss over all training sets."""
        values = self.bounded()
        return torch.stack([term.loss(*values) for term in terms]).sum()

    def weights(self, lattices: Sequence[BondClasses]) -> list[torch.Tensor]:
        """Class weights w on each lattice."""
        _, _, alpha, D = self.bounded()
        return [class_weights(classes, alpha, D) for classes in lattices]

    def parameters(self, losses: list[float]) -> Parameters:
        """Their values strictly inside the bounds, with the loss on the way."""
        values = [value.detach().numpy().copy() for value in self.bounded()]
        lam, mu, alpha = (float(value) for value in values[:3])
        mu = max(mu, SMALLEST_MODULUS)
        lam, alpha = max(lam, SMALLEST_MODULUS - mu), min(alpha, LARGEST_ALPHA)
        return Parameters(lam, mu, alpha, values[3], losses)


RANK_TOLERANCE = 1e-11
SMALLEST_ALPHA = -6.0
ALPHA_IN_SIGHT = (-12.0, 6.0)


@dataclass(frozen=True)
class Point:
    """What one y stands for, and derivatives to y.

    Attributes:
        kappa, alpha: κ = (λ−μ)/μ² [1/TPa] and α.
        mu: μ [TPa]; dmu its derivative, shape [Y].
        v: stiffnesses on each lattice [TPa/Å²].
        dv: their derivatives, each of shape [C, Y].
        limits: what must not be negative for y to be within its bounds; dlimits its derivative.
    """

    kappa: float
    alpha: float
    mu: float
    dmu: np.ndarray
    v: list[np.ndarray]
    dv: list[np.ndarray]
    limits: np.ndarray
    dlimits: np.ndarray


class Coordinates:
    """y = (κ, q[, α]).

    Args:
        lattices: bond classes of each lattice; the first sets the scale of the kernels.
        alpha: exponent to start from, or to keep.
        degree: M.
    """

    def __init__(self, lattices: Sequence[BondClasses], alpha: float, degree: int) -> None:
        self.lattices, self.alpha = lattices, alpha
        tables = np.concatenate([_tables(classes, alpha, degree) for classes in lattices])
        scale = np.abs(tables).max()
        left, size, right = np.linalg.svd(tables / scale)
        rank = int(np.sum(size > RANK_TOLERANCE * size[0]))
        lengths = np.concatenate([classes.r for classes in lattices])
        reached = np.abs(tables).max(axis=1) > RANK_TOLERANCE * scale
        self.free_alpha = rank < len(np.unique(lengths[reached].round(9))) and (
            lattices[0].steps.shape[1] == 2
        )
        self.rank, self._q = rank, slice(1, 1 + rank)
        ends = np.cumsum([len(classes.r) for classes in lattices])
        self._basis = np.split(left[:, :rank], ends[:-1])  # tables of unit q
        self._q_of_D = size[:rank, None] * right[:rank] * scale
        self._D_of_q = right[:rank].T / (size[:rank] * scale)
        self._second = np.diff(np.eye(degree + 1), n=2, axis=0)
        free = right[rank:].T  # coefficients that no bond sees: take those that smooth
        if free.size and len(self._second):
            smooth = np.linalg.lstsq(self._second @ free, self._second @ self._D_of_q, rcond=None)
            self._D_of_q = self._D_of_q - free @ smooth[0]
        self._sigma = [classes.count * classes.r**2 for classes in lattices]
        self._log_r = [np.log(classes.r / classes.horizon) for classes in lattices]

    def start(self, parameters: Parameters) -> np.ndarray:
        """y of given parameters."""
        q = self._q_of_D @ parameters.D
        q = q * parameters.mu / (self._sigma[0] @ (self._basis[0] @ q))
        kappa = (parameters.lam - parameters.mu) / parameters.mu**2
        return np.concatenate([[kappa], q, [self.alpha] * self.free_alpha])

    def point(self, y: np.ndarray) -> Point:
        """v, κ and μ at y, with their derivatives."""
        # Constraints bound α; on its way SLSQP may look where r^(−α) overflows.
        alpha = float(np.clip(y[-1], *ALPHA_IN_SIGHT)) if self.free_alpha else self.alpha
        v, dv = self._kernels(y, alpha)
        mu, dmu = float(self._sigma[0] @ v[0]), self._sigma[0] @ dv[0]
        for number in range(1, len(v)):  # Σ n r² v = μ on every lattice
            v[number], dv[number] = scaled(v[number], dv[number], self._sigma[number], mu, dmu)
        limits, dlimits = np.zeros(0), np.zeros((0, len(y)))
        if self.free_alpha:
            limits = np.array([LARGEST_ALPHA - alpha, alpha - SMALLEST_ALPHA])
            dlimits = np.zeros((2, len(y)))
            dlimits[:, -1] = (-1, 1)
        return Point(float(y[0]), alpha, mu, dmu, v, dv, limits, dlimits)

    def _kernels(self, y: np.ndarray, alpha: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Tables K W of each lattice and their derivatives to y, before any scaling."""
        values, slopes = [], []
        for basis, log_r in zip(self._basis, self._log_r):
            tilted = np.exp((self.alpha - alpha) * log_r)[:, None] * basis
            values.append(tilted @ y[self._q])
            slope = np.zeros((len(basis), len(y)))
            slope[:, self._q] = tilted
            if self.free_alpha:
                slope[:, -1] = -log_r * values[-1]
            slopes.append(slope)
        return values, slopes

    def _plain_volume(self, alpha: float) -> tuple[float, float]:
        """Σ n r² K W of K = (r/δ)^(−α) on the first lattice, and its derivative to α."""
        classes, log_r = self.lattices[0], self._log_r[0]
        terms = self._sigma[0] * classes.weight * np.exp(-alpha * log_r)
        return float(terms.sum()), float(-log_r @ terms)

    def roughness(self, y: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Second differences of D, and their derivative to y."""
        volume, dvolume = self._plain_volume(point.alpha)
        plain = self._second @ self._D_of_q  # second differences of unit q
        values = plain @ y[self._q] * (volume / point.mu)
        slopes = np.zeros((len(values), len(y)))
        slopes[:, self._q] = plain * (volume / point.mu)
        slopes -= np.outer(values, point.dmu / point.mu)
        if self.free_alpha:
            slopes[:, -1] += values * (dvolume / volume)
        return values, slopes

    def parameters(self, y: np.ndarray, losses: list[float]) -> Parameters:
        """λ, μ, α and the smoothest coefficients at y, of the weighted volume of K = r^(−α)."""
        point, q = self.point(y), y[self._q]
        mu, kappa = point.mu, point.kappa
        tilt = np.exp((self.alpha - point.alpha) * self._log_r[0])
        volume = self._sigma[0] @ (tilt * (self._basis[0] @ q))
        D = self._D_of_q @ q * (self._plain_volume(point.alpha)[0] / volume)
        return Parameters(mu + kappa * mu**2, mu, point.alpha, D, losses)


def _tables(classes: BondClasses, alpha: float, degree: int) -> np.ndarray:
    """K W of unit coefficients, with (r/δ)^(−α) for r^(−α), shape [C, M + 1]."""
    basis = bernstein_basis(classes.r, classes.horizon, degree)
    tables: np.ndarray = (classes.weight * (classes.r / classes.horizon) ** -alpha)[:, None] * basis
    return tables


def scaled(
    x: np.ndarray, dx: np.ndarray, sigma: np.ndarray, total: float, dtotal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """x scaled so that σ·x = total, and its derivative."""
    have, dhave = sigma @ x, sigma @ dx
    slope = dx * (total / have) + np.outer(x, dtotal / have - total * dhave / have**2)
    return x * (total / have), slope


class ShapeCoordinates:
    """y = (κ, size a of K, parameters of the shape); stiffnesses v = a K W (theory, 59).

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
                    f"influence '{shape.name}': its weighted volume (theory, 5) is zero on the "
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
        """v, κ and μ at y, with their derivatives."""
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
        return Point(float(y[0]), 0.0, mu, dmu, v, dv, limits, dlimits)

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
