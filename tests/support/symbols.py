"""The symbol of the LPS by its formula, (18): D = Γ + κ φφᵗ, for any form of it."""

import numpy as np

from warp_peri.core.elastic import lattice_group
from warp_peri.core.stencil import laplacian
from warp_peri.fitting.regression import Zone
from warp_peri.materials.lps import stiffnesses
from warp_peri.materials.lps_law import product_basis
from warp_peri.points.families import bond_classes


def form(classes, k, v, kappa):
    """Γ + κ φφᵗ of stiffnesses v at wave vectors k [K, 2], shape [K, 2, 2]."""
    xi, each = classes.xi, v[classes.bond_class]
    square = xi[:, :, None] * xi[:, None] / (xi**2).sum(axis=1)[:, None, None]
    gamma = np.einsum("kb,b,bij->kij", 16 * (1 - np.cos(k @ xi.T)), each, square)
    phi = 2 * np.sin(k @ xi.T) @ (each[:, None] * xi)
    return gamma + kappa * phi[:, :, None] * phi[:, None]


def symbol(model, k, spacing=1.0):
    """D(k) of a model."""
    classes = bond_classes(spacing, model.horizon)
    return form(classes, k, *stiffnesses(model, classes))


def smallest(D, k, spacing=1.0):
    """Λmin / s, shape [K]."""
    return np.linalg.eigvalsh(D)[:, 0] * spacing**2 / laplacian(spacing * k)


def smallest_margins(classes, conditions, v, kappa):
    """Smallest Λmin / s less its level of each condition, as the search finds them."""
    zone, (i, j) = Zone(product_basis(classes), lattice_group(2)), np.triu_indices(len(v))
    mu = classes.count * classes.r**2 @ v
    return np.array(
        [
            zone.softest(np.concatenate([v, own * v[i] * v[j]]), -np.inf)[0] - level
            for own, level in conditions.forms(kappa, mu)
        ]
    )
