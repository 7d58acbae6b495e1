"""The reduced regression: the full loss of a lattice data set in a few hundred rows.

With the weights w_c = K(r_c) W_c / m of each bond class, the residual is affine in the products
μ w_c and (λ−μ) w_c w_d (theory.md, 14–17). One sweep of the data and a QR factorisation give
‖L u − b‖² over all samples and nodes as ‖R c‖².
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_peri.kernels.lps import features as kernels
from warp_peri.launch import DEVICE
from warp_peri.models.influence import bernstein_basis
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.symbol import symbol
from warp_peri.points.families import BondClasses
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import Samples

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
        self,
        lam: torch.Tensor,
        mu: torch.Tensor,
        alpha: torch.Tensor,
        D: torch.Tensor,
        D_dilatation: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Σ_s weight_s ‖L u − b‖² = ‖R c‖², c of (17); differentiable."""
        w = class_weights(self.classes, alpha, D)
        p = w if D_dilatation is None else class_weights(self.classes, alpha, D_dilatation)
        products = torch.cat([mu * w, (lam - mu) * p[self.pairs[0]] * p[self.pairs[1]], _ONE])
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


def symbol_rows(classes: BondClasses, k: np.ndarray) -> np.ndarray:
    """D11, D22, D12 at wave vectors by the products (v, κ z z), shape [K, 3, F]."""
    table = symbol(classes, k)
    i, j = class_pairs(len(classes.r))
    twice = np.where(i == j, 1.0, 2.0)
    p1, p2 = table.phi[:, 0], table.phi[:, 1]
    quadratic = [
        twice * p1[:, i] * p1[:, j],
        twice * p2[:, i] * p2[:, j],
        twice / 2 * (p1[:, i] * p2[:, j] + p1[:, j] * p2[:, i]),
    ]
    return np.concatenate([table.gamma, np.stack(quadratic, axis=1)], axis=2)
