"""Rows of the linear peridynamic solid: what samples say of the products of its stiffnesses.

With the stiffness v = μ w of each bond class and κ = (λ−μ)/μ², L u is linear in the products v and
κ v v (theory, 14–17, T17).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from warp_peri.core.elastic import lattice_group
from warp_peri.core.grid import grid_of
from warp_peri.core.stencil import Basis, half_ball
from warp_peri.fitting.regression import LatticeRows
from warp_peri.fitting.rows import forces, rows
from warp_peri.materials.lps import LPSMaterial, stiffnesses
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.points import Samples
from warp_peri.points.quadrature import DEGREE


def class_pairs(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Class numbers of each quadratic product, each of shape [C (C + 1) / 2]."""
    return np.triu_indices(number)


def products(model: LPSMaterial, classes: BondClasses) -> np.ndarray:
    """The products of a model on a lattice: v, and κ v v of the pairs of classes; shape [P]."""
    v, kappa = stiffnesses(model, classes)
    i, j = class_pairs(len(v))
    return np.concatenate([v, kappa * v[i] * v[j]])


def product_basis(classes: BondClasses) -> Basis:
    """C h² of the products of bond classes, of range 2δ (T17)."""
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
    """Forces of the products on a set of samples.

    Args:
        samples: on a lattice.
        horizon: δ [length].
        quadrature_degree: of the polynomials that the weights are exact for.
    """

    def __init__(
        self, samples: Samples, horizon: float, *, quadrature_degree: int = DEGREE
    ) -> None:
        d, h = samples.points.dimension, samples.spacing
        self.samples, self.least = samples, 2 * int(horizon / h + 1e-6)
        self.classes = bond_classes(h, horizon, dimension=d, degree=quadrature_degree)
        self.bonds = product_basis(self.classes)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Of u, shape [S, N, d], on the interior nodes: shape [S, I, P, d]."""
        nodes = grid_of(self.samples.points, self.bonds.steps, least=self.least)
        F = forces(u, nodes, self.bonds) / self.samples.spacing**2
        return np.asarray(np.einsum("sika,lk->sial", F, nodes.axes))

    def rows(self, weight: np.ndarray, samples: Samples | None = None) -> LatticeRows:
        """Rows of Σ_s weight_s ‖L u − b‖², weight [S], of its samples or others on the nodes."""
        given: dict[str, Any] = {"weight": np.sqrt(weight), "least": self.least}
        R, y = rows(self.samples if samples is None else samples, self.bonds, **given)
        return LatticeRows(R, y, self.bonds, lattice_group(self.bonds.dimension))
