"""The loss of a fit: full, reduced to few rows, and without its noise (theory, 10–17, 36–37).

With the weights w_c = K(r_c) W_c / m of each bond class, the residual is affine in the products
μ w_c and (λ−μ) w_c w_d (theory, 14–17). One sweep of the data and a QR factorisation give
‖L u − b‖² over all samples and nodes as ‖R c‖².
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch

from warp_peri.core.grid import grid_of
from warp_peri.core.groups import point_group, shared_with_nodes
from warp_peri.core.stencil import Basis, half_ball, invariant_basis
from warp_peri.errors import InputError
from warp_peri.fitting.losses import without_noise
from warp_peri.fitting.regression import LatticeRows
from warp_peri.fitting.rows import forces, rows
from warp_peri.materials.lps import Solid, bernstein_basis
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import Samples


def sample_weights(sets: Sequence[Samples], *, normalise: bool) -> list[np.ndarray]:
    """Weight of each sample's ‖L u − b‖² in the loss, one array of shape [S] a set.

    The loss is Σ f² ‖L u − b‖² / Σ f² ‖b‖² over the samples of all sets, f = 1, or 1/‖b‖ with
    `normalise`. Raises InputError for a set without samples or loads, or a sample without load
    that is to be normalised.
    """
    factors, total = [], 0.0
    for points in sets:
        if len(points) == 0:
            raise InputError("the training set has no samples")
        load = np.linalg.norm(points.loads[:, points.interior].reshape(len(points), -1), axis=1)
        if not load.any():
            raise InputError("the training set has no loads on its interior")
        if normalise and not load.all():
            raise InputError(f"sample {int(np.argmin(load))} has no load and cannot be normalised")
        factors.append(1 / load if normalise else np.ones(len(points)))
        total += float(((factors[-1] * load) ** 2).sum())
    return [factor**2 / total for factor in factors]


class FullLoss:
    """Σ_s weight_s ‖L u − b‖² over the interior of one set.

    Args:
        points: samples on a lattice.
        horizon: δ [Å].
        weight: of each sample, shape [S].
    """

    def __init__(self, points: Samples, horizon: float, weight: np.ndarray) -> None:
        self.bonds = Bonds(points, horizon)
        self.u = torch.tensor(points.u)  # a copy: the set may be read-only
        self.b = torch.tensor(points.loads[:, points.interior])
        self.weight = torch.from_numpy(weight)

    def _squares(self, *parameters: Any) -> torch.Tensor:
        residual = lps_force(self.bonds, self.u, Solid(*parameters)) - self.b
        return (residual**2).sum(dim=(1, 2))

    def loss(self, *parameters: Any) -> torch.Tensor:
        """The loss at (λ, μ, α, D), differentiable."""
        return self.weight @ self._squares(*parameters)

    def errors(self, *parameters: Any) -> np.ndarray:
        """‖L u − b‖/‖b‖ of each sample that has a load."""
        load = (self.b**2).sum(dim=(1, 2))
        loaded = load > 0
        with torch.no_grad():
            return (self._squares(*parameters)[loaded] / load[loaded]).sqrt().numpy()


def lattice_group(dimension: int) -> np.ndarray:
    """Of a square or a cubic lattice, integer matrices [g, d, d]."""
    name = {2: "4mm", 3: "m-3m"}[dimension]
    return shared_with_nodes(point_group(name, dimension), np.eye(dimension))


@dataclass(frozen=True)
class ReducedLoss:
    """The loss (10) of one data set on one lattice, as a small least-squares problem.

    Attributes:
        classes: bond classes of the lattice.
        R: as few rows as that takes, shape [n, F + 1]; its last column belongs to −b.
    """

    classes: BondClasses
    R: np.ndarray

    @cached_property
    def pairs(self) -> np.ndarray:
        """Class numbers of each quadratic feature, shape [2, C (C + 1) / 2]."""
        return class_pairs(len(self.classes.r))

    @cached_property
    def block(self) -> LatticeRows:
        """What it says of the products, for a regression."""
        bonds = product_basis(self.classes)
        return LatticeRows(self.R[:, :-1], -self.R[:, -1], bonds, lattice_group(bonds.dimension))

    def loss(
        self, lam: torch.Tensor, mu: torch.Tensor, alpha: torch.Tensor, D: torch.Tensor
    ) -> torch.Tensor:
        """Σ_s weight_s ‖L u − b‖² = ‖R c‖², c of (17); differentiable."""
        w = class_weights(self.classes, alpha, D)
        products = torch.cat([mu * w, (lam - mu) * w[self.pairs[0]] * w[self.pairs[1]], _ONE])
        residual = torch.from_numpy(self.R) @ products
        return residual @ residual


def class_weights(classes: BondClasses, alpha: torch.Tensor, D: torch.Tensor) -> torch.Tensor:
    """w_c = K(r_c) W_c / m [Å⁻²] of an influence function, shape [C]; differentiable."""
    r, weight = torch.from_numpy(classes.r), torch.from_numpy(classes.weight)
    basis = torch.from_numpy(bernstein_basis(classes.r, classes.horizon, len(D) - 1))
    kw = weight * r**-alpha * (basis @ D)
    return kw / (torch.from_numpy(classes.count) * r**2 * kw).sum()


_ONE = torch.ones(1, dtype=torch.float64)


def class_pairs(number: int) -> np.ndarray:
    """Class numbers of each quadratic feature, shape [2, C (C + 1) / 2]."""
    return np.array(np.triu_indices(number))


def product_basis(classes: BondClasses) -> Basis:
    """C h² of the products (v, κ v v) of bond classes and of their pairs, of range 2δ (T17)."""
    d, count, x = classes.steps.shape[1], len(classes.r), classes.steps
    h, of = classes.spacing, classes.bond_class
    steps = half_ball(2 * classes.horizon / h, d)
    far = 2 * int(np.abs(x).max())
    place = np.full((2 * far + 1,) * d, -1)
    steps = steps[np.abs(steps).max(axis=1) <= far]
    place[tuple((steps + far).T)] = np.arange(len(steps))
    i, j = class_pairs(count)
    column = np.zeros((count, count), int)
    column[i, j] = column[j, i] = count + np.arange(len(i))
    tensors = np.zeros((count + len(i), len(steps), d, d))
    alone = place[tuple((x + far).T)]
    own = alone >= 0
    along = x[:, :, None] * x[:, None] / (x**2).sum(axis=1)[:, None, None]
    tensors[of[own], alone[own]] = 2 * d * (d + 2) * h**2 * along[own]
    first, second = np.indices((len(x), len(x))).reshape(2, -1)
    at = place[tuple((x[first] + x[second] + far).T)]
    first, second, at = first[at >= 0], second[at >= 0], at[at >= 0]
    across = d**2 * h**4 * x[first][:, :, None] * x[second][:, None]
    across = (across + across.transpose(0, 2, 1)) / 2
    np.add.at(tensors, (column[of[first], of[second]], at), across)
    used = tensors.any(axis=(0, 2, 3))
    return Basis(steps[used], tensors[:, used])


class Products:
    """Forces of the products c of (17): L u is affine in them.

    Args:
        points: samples on a lattice.
        horizon: δ [Å].
        quadrature_degree: of the polynomials that the weights are exact for.
    """

    def __init__(self, points: Samples, horizon: float, *, quadrature_degree: int = DEGREE) -> None:
        d, h = points.points.dimension, points.spacing
        self.points, self.least = points, 2 * int(horizon / h + 1e-6)
        self.classes = bond_classes(h, horizon, dimension=d, degree=quadrature_degree)
        self.bonds, every = (
            product_basis(self.classes),
            invariant_basis(2 * horizon / h, lattice_group(d)),
        )
        place = {tuple(step): n for n, step in enumerate(every.steps.tolist())}
        tensors = every.basis[:, [place[tuple(step)] for step in self.bonds.steps.tolist()]]
        self.every = Basis(self.bonds.steps, tensors[tensors.any(axis=(1, 2, 3))])
        flat, own = (one.basis.reshape(len(one.basis), -1) for one in (self.every, self.bonds))
        self.mix = np.linalg.pinv(flat.T) @ own.T

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Of u, shape [S, N, d], on the interior nodes: shape [S, I, F, d]."""
        nodes = grid_of(self.points.points, self.every.steps, least=self.least)
        F = forces(u, nodes, self.every) @ self.mix / self.points.spacing**2
        return np.asarray(np.einsum("sika,lk->sial", F, nodes.axes))

    def rows(self, weight: np.ndarray) -> np.ndarray:
        """R of the loss with weights of each sample, shape [n, F + 1]."""
        given = {"weight": np.sqrt(weight), "mix": self.mix, "least": self.least}
        R, y = rows(self.points, self.every, **given)
        return np.column_stack([R, -y])


def reduce(
    points: Samples, horizon: float, weight: np.ndarray, *, quadrature_degree: int = DEGREE
) -> ReducedLoss:
    """Sweep a lattice data set once and factorise its features.

    Args:
        points: samples on a lattice.
        horizon: δ [Å].
        weight: of each sample in the loss, shape [S]; see sample_weights.
        quadrature_degree: of the polynomials that the weights are exact for.

    Raises InputError for a set that does not carry the horizon.
    """
    products = Products(points, horizon, quadrature_degree=quadrature_degree)
    return ReducedLoss(products.classes, products.rows(weight))


def noise_loss(noise: Samples, points: Samples, horizon: float, weight: np.ndarray) -> np.ndarray:
    """Factor R_e of what the noise adds to a reduced loss: ‖R_e c‖² is its expectation.

    Args:
        noise: fields of noise alone, on the nodes of `points`; its loads are not looked at.
        points: the training samples; each is taken to carry noise of the same size.
        horizon: δ [Å].
        weight: of each training sample, shape [S].

    Returns:
        Rows of the same columns as the ReducedLoss of `points`.

    Raises InputError for noise without fields or on other nodes.
    """
    check_noise(noise, points)
    bare = Samples(noise.points, noise.u, np.zeros_like(noise.u))
    each = np.full(len(noise), weight.sum() / len(noise))
    return reduce(bare, horizon, each).R


def corrected(loss: ReducedLoss, R_noise: np.ndarray) -> ReducedLoss:
    """The loss less what the noise adds to it: a square and a constant, both not below zero."""
    R, y = without_noise(loss.R[:, :-1], loss.R[:, -1], R_noise[:, :-1])
    return dataclasses.replace(loss, R=np.column_stack([R, y]))


def check_noise(noise: Samples, points: Samples) -> None:
    """Raise InputError when noise does not belong to a training set."""
    if len(noise) == 0:
        raise InputError("noise: expected at least one field, got none")
    if noise.x.shape != points.x.shape or not np.array_equal(noise.interior, points.interior):
        raise InputError(
            f"noise: expected the {len(points.x)} nodes of the training set, got {len(noise.x)}"
        )
    if not np.allclose(noise.x, points.x, rtol=0, atol=1e-6 * points.spacing):
        raise InputError("noise: expected the nodes of the training set, got others")
