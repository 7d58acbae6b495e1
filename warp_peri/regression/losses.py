"""The loss of a fit: full, reduced to few rows, and without its noise (theory, 10–17, 36–37).

With the weights w_c = K(r_c) W_c / m of each bond class, the residual is affine in the products
μ w_c and (λ−μ) w_c w_d (theory, 14–17). One sweep of the data and a QR factorisation give
‖L u − b‖² over all samples and nodes as ‖R c‖².
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_peri.errors import InputError
from warp_peri.kernels.lps import features as kernels
from warp_peri.launch import DEVICE
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.model import Solid, bernstein_basis
from warp_peri.lps.operator import lps_force
from warp_peri.lps.symbol import Symbol
from warp_peri.points.families import BondClasses
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

    def _squares(self, *parameters: Any, taped: bool = False) -> torch.Tensor:
        residual = lps_force(self.bonds, self.u, Solid(*parameters), taped=taped) - self.b
        return (residual**2).sum(dim=(1, 2))

    def loss(self, *parameters: Any, taped: bool = False) -> torch.Tensor:
        """The loss at (λ, μ, α, D), differentiable; `taped` by Warp's tape."""
        return self.weight @ self._squares(*parameters, taped=taped)

    def errors(self, *parameters: Any) -> np.ndarray:
        """‖L u − b‖/‖b‖ of each sample that has a load."""
        load = (self.b**2).sum(dim=(1, 2))
        loaded = load > 0
        with torch.no_grad():
            return (self._squares(*parameters)[loaded] / load[loaded]).sqrt().numpy()


_BLOCK_BYTES = 2**27
"""Rows are factorised in blocks of about this size, so memory does not grow with the data."""


@dataclass(frozen=True)
class ReducedLoss:
    """The loss (10) of one data set on one lattice, as a small least-squares problem.

    Attributes:
        classes: bond classes of the lattice.
        R: triangular factor, shape [F + 1, F + 1]; its last column belongs to −b.
        pairs: class numbers of each quadratic feature, shape [2, C (C + 1) / 2].
    """

    classes: BondClasses
    R: np.ndarray
    pairs: np.ndarray

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


class Features:
    """Features of displacement fields on one lattice: L u is affine in the products c of (17).

    Args:
        points: the lattice.
        horizon: δ [Å].
        quadrature_degree: of the polynomials that the weights are exact for.
        device: where the sweeps run, as for Bonds.

    Raises InputError for a set that does not carry the horizon.
    """

    def __init__(
        self,
        points: Samples,
        horizon: float,
        *,
        quadrature_degree: int = DEGREE,
        device: str = DEVICE,
    ) -> None:
        self.bonds = Bonds(points, horizon, quadrature_degree=quadrature_degree, device=device)
        self.classes = self.bonds.families.classes
        number = len(self.classes.r)
        self.pairs = class_pairs(number)
        column = np.empty((number, number), dtype=np.int32)
        column[tuple(self.pairs)] = column[tuple(self.pairs[::-1])] = number + np.arange(
            self.pairs.shape[1]
        )
        self.width = number + self.pairs.shape[1]
        self._columns: wp.array[Any] = wp.array(column, dtype=wp.int32, device=self.bonds.device)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Features of u [Å], shape [S, N, 2], on the interior nodes: shape [S, I, F, 2]."""
        samples, nodes, _ = u.shape
        bonds, device = self.bonds, self.bonds.device
        field: wp.array[Any] = wp.array(u, dtype=wp.vec2d, device=device)
        theta = wp.zeros((samples, nodes, len(self.classes.r)), dtype=wp.float64, device=device)
        out = wp.zeros((samples, len(bonds.rows), self.width), dtype=wp.vec2d, device=device)
        wp.launch(
            kernels.class_dilatation,
            dim=(samples, len(bonds.full)),
            inputs=[bonds.full, bonds.arrays, field],
            outputs=[theta],
            device=device,
        )
        wp.launch(
            kernels.class_force,
            dim=(samples, len(bonds.rows)),
            inputs=[bonds.rows, bonds.arrays, self._columns, field, theta],
            outputs=[out],
            device=device,
        )
        forces: np.ndarray = out.numpy()
        return forces


def reduce(
    points: Samples,
    horizon: float,
    weight: np.ndarray,
    *,
    quadrature_degree: int = DEGREE,
    device: str = DEVICE,
) -> ReducedLoss:
    """Sweep a lattice data set once and factorise its features.

    Args:
        points: samples on a lattice.
        horizon: δ [Å].
        weight: of each sample in the loss, shape [S]; see sample_weights.
        quadrature_degree: of the polynomials that the weights are exact for.
        device: where the sweeps run, as for Bonds.

    Raises InputError for a set that does not carry the horizon.
    """
    factor = np.sqrt(weight)
    features = Features(points, horizon, quadrature_degree=quadrature_degree, device=device)
    columns = features.width + 1
    block = max(1, _BLOCK_BYTES // (16 * columns * np.count_nonzero(points.interior)))
    R = np.zeros((0, columns))
    for first in range(0, len(points), block):
        some = slice(first, first + block)
        rows = features(points.u[some])
        rows = np.concatenate([rows, -points.loads[some][:, points.interior, None, :]], axis=2)
        rows *= factor[some, None, None, None]
        R = with_rows(R, rows.transpose(0, 1, 3, 2).reshape(-1, columns))
    return ReducedLoss(features.classes, R, features.pairs)


def with_rows(R: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Triangular factor of more rows: RᵗR of the result is RᵗR + rowsᵗ rows."""
    return np.asarray(np.linalg.qr(np.concatenate([R, rows]), mode="r"))


def symbol_rows(table: Symbol) -> np.ndarray:
    """D11, D22, D12 at the wave vectors of a table by the products (v, κ v v), shape [K, 3, F]."""
    i, j = class_pairs(table.phi.shape[2])
    twice = np.where(i == j, 1.0, 2.0)
    p1, p2 = table.phi[:, 0], table.phi[:, 1]
    quadratic = [
        twice * p1[:, i] * p1[:, j],
        twice * p2[:, i] * p2[:, j],
        twice / 2 * (p1[:, i] * p2[:, j] + p1[:, j] * p2[:, i]),
    ]
    return np.concatenate([table.gamma, np.stack(quadratic, axis=1)], axis=2)


KNOWN = 0.1
"""Directions of which a larger part of the data's squares than 1 − KNOWN is noise are left out."""


def noise_loss(noise: Samples, points: Samples, horizon: float, weight: np.ndarray) -> np.ndarray:
    """Factor R_e of what the noise adds to a reduced loss: ‖R_e c‖² is its expectation.

    Args:
        noise: fields of noise alone, on the nodes of `points`; its loads are not looked at.
        points: the training samples; each is taken to carry noise of the same size.
        horizon: δ [Å].
        weight: of each training sample, shape [S].

    Returns:
        Triangular, of the shape of the ReducedLoss of `points`.

    Raises InputError for noise without fields or on other nodes.
    """
    check_noise(noise, points)
    bare = Samples(noise.points, noise.u, np.zeros_like(noise.u))
    each = np.full(len(noise), weight.sum() / len(noise))
    return reduce(bare, horizon, each).R


def corrected(loss: ReducedLoss, R_noise: np.ndarray) -> ReducedLoss:
    """The loss less what the noise adds to it: a square and a constant, both not below zero.

    Loads carry no noise, so that ‖F c + l‖² − ‖R_e c‖² is a quadratic form of the products c that
    has the minimum of ‖√(1−ν) Vᵗ F c + (1−ν)^(−½) Uᵗ l‖² (theory, 37). Directions of which
    less than KNOWN is not noise count nothing. No squares are subtracted, so that digits are kept.
    """
    load, width = loss.R[:, -1], loss.R.shape[1] - 1
    left, size, right = np.linalg.svd(loss.R[:, :-1], full_matrices=False)
    kept = size > np.finfo(float).eps * width * size[0]
    left, size, right = left[:, kept], size[kept], right[kept]
    root, axes = np.linalg.svd((R_noise[:, :-1] @ right.T) / size)[1:]
    share = np.zeros(len(axes))
    share[: len(root)] = root**2
    along = axes @ (left.T @ load)
    known = 1 - share > KNOWN
    gain = np.sqrt(1 - share[known])
    form = np.zeros((len(gain) + 1, width + 1))
    form[:-1, :-1] = gain[:, None] * (axes[known] * size) @ right
    form[:-1, -1] = along[known] / gain
    rest = load @ load - (form[:-1, -1] ** 2).sum()  # a constant: of no weight in the minimum
    form[-1, -1] = np.sqrt(max(0.0, rest))
    return dataclasses.replace(loss, R=with_rows(np.zeros_like(loss.R), form))


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
