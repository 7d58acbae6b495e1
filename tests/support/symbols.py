"""The symbol of the LPS by its formula, (18): D = Γ + κ φφᵗ; samples of its waves, and noise."""

from dataclasses import replace

import numpy as np
from numpy.linalg import eigvalsh, norm, solve
from numpy.random import default_rng

from tests.support.problems import lattice, normal
from warp_peri import Samples
from warp_peri.core.elastic import lattice_group
from warp_peri.core.stencil import laplacian
from warp_peri.fitting.regression import Zone
from warp_peri.materials.lps import stiffnesses
from warp_peri.materials.lps_law import product_basis
from warp_peri.points.families import bond_classes
from warp_peri.points.points import grid_points, nodes_of

anywhere = lambda count, seed, d=2: default_rng(seed).uniform(-np.pi, np.pi, (count, d))
"""Wave vectors at random in the zone, shape [count, d]."""
smallest = lambda D, k: eigvalsh(D)[:, 0] / laplacian(k)
"""Λmin / s, shape [K]."""


def zone(count, d=2):
    """Wave vectors of a grid over the zone, [count^d, d]."""
    return grid_points(np.linspace(-np.pi, np.pi, count), d)


def form(classes, k, v, kappa):
    """Γ + κ φφᵗ of stiffnesses v at wave vectors k [K, 2], shape [K, 2, 2]."""
    xi, each = classes.xi, v[classes.bond_class]
    square = xi[:, :, None] * xi[:, None] / (xi**2).sum(1)[:, None, None]
    gamma = np.einsum("kb,b,bij->kij", 16 * (1 - np.cos(k @ xi.T)), each, square)
    phi = 2 * np.sin(k @ xi.T) @ (each[:, None] * xi)
    return gamma + kappa * phi[:, :, None] * phi[:, None]


def symbol(model, k, spacing=1.0):
    """D(k) of a model."""
    classes = bond_classes(spacing, model.horizon)
    return form(classes, k, *stiffnesses(model, classes))


def smallest_margins(classes, conditions, v, kappa):
    """Smallest Λmin / s less its level of each condition, as the search finds them."""
    zone, (i, j) = Zone(product_basis(classes), lattice_group(2)), np.triu_indices(len(v))
    mu = classes.count * classes.r**2 @ v
    return np.array(
        [
            zone.softest(np.concatenate([v, own * v[i] * v[j]]), -np.inf)[0] - level
            for own, level in conditions.forms(kappa, mu, conditions.zeta)
        ]
    )


def waves(model, cells=6, highest=4):
    """Loads cos k₁x cos k₂y along each axis, answered exactly by the model; |u| ≈ 1 each."""
    points = lattice(cells, model.horizon)
    k = np.array([(p, q) for p in range(highest) for q in range(highest)][1:]) * 2 * np.pi / 19
    k = np.repeat(k, 2, axis=0)
    load = np.tile(np.eye(2), (len(k) // 2, 1))
    answer = solve(symbol(model, k), load[..., None])[..., 0]
    scale = 1 / norm(answer, axis=1, keepdims=True)
    answer, load = answer * scale, load * scale
    u = np.zeros((len(k), len(points.x), 2))
    b = np.zeros_like(u)
    for s, (wave, axis) in enumerate(zip(k, np.tile([0, 1], len(k) // 2))):
        cos, sin = np.cos(wave * points.x).prod(1), np.sin(wave * points.x).prod(1)
        u[s, :, axis], u[s, :, 1 - axis] = answer[s, axis] * cos, -answer[s, 1 - axis] * sin
        b[s, :, axis] = load[s, axis] * cos
    return Samples(points, u, b, {"wave_vector": k})


def fluctuation(points, count, size, seed):
    """White noise of a size on every node, as a set without loads."""
    return Samples(nodes_of(points), size * normal((count, len(points.x), 2), seed))


def noisy(points, size, seed):
    """The samples with white noise added to u."""
    return replace(points, u=points.u + fluctuation(points, len(points), size, seed).u)
