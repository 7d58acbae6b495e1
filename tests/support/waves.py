"""Samples of single waves on an infinite lattice, exact for a known model, and noise for them."""

import dataclasses

import numpy as np

from tests.support.problems import lattice
from tests.support.symbols import symbol
from warp_peri import Samples
from warp_peri.points.points import nodes_of


def waves(model, cells=6, period=19.0, highest=4):
    """Loads cos k₁x cos k₂y along each axis, answered exactly by the model; |u| ≈ 1 each."""
    points = lattice(cells, model.horizon)
    k = np.array([(p, q) for p in range(highest) for q in range(highest)][1:]) * 2 * np.pi / period
    k = np.repeat(k, 2, axis=0)
    D = symbol(model, k)
    load = np.tile(np.eye(2), (len(k) // 2, 1))
    answer = np.linalg.solve(D, load[..., None])[..., 0]
    scale = 1 / np.linalg.norm(answer, axis=1, keepdims=True)
    answer, load = answer * scale, load * scale
    u = np.zeros((len(k), len(points.x), 2))
    b = np.zeros_like(u)
    for s, (wave, axis) in enumerate(zip(k, np.tile([0, 1], len(k) // 2))):
        cos, sin = np.cos(wave * points.x).prod(axis=1), np.sin(wave * points.x).prod(axis=1)
        u[s, :, axis], u[s, :, 1 - axis] = answer[s, axis] * cos, -answer[s, 1 - axis] * sin
        b[s, :, axis] = load[s, axis] * cos
    return Samples(points, u, b, {"wave_vector": k})


def fluctuation(points, count, size, seed):
    """White noise of a size on every node, as a set without loads."""
    random = np.random.default_rng(seed)
    u = size * random.normal(size=(count, len(points.x), 2))
    return Samples(nodes_of(points), u)


def noisy(points, size, seed):
    """The samples with white noise added to u."""
    return dataclasses.replace(points, u=points.u + fluctuation(points, len(points), size, seed).u)
