"""Square plates with a round hole, meshed ring by ring."""

import numpy as np

from tests.support.clouds import plain
from warp_peri.points.mesh import make_mesh

MODEL = plain(3.0, D=[0.4, 0.6, -0.3, 0.6, -0.2], certified_on=(1.0,))
"""Of a kernel that changes sign, three spacings wide, and proven there."""


def plate(radius, half, rings, around):
    """Triangles between a hole and the sides of a square about it; parts "hole" and "sides"."""
    angle = 2 * np.pi * np.arange(around) / around
    circle = np.c_[np.cos(angle), np.sin(angle)]
    square = circle / np.abs(circle).max(1)[:, None]
    share = np.linspace(0, 1, rings + 1)[:, None, None] ** 1.5  # finer at the hole
    x = (radius * circle * (1 - share) + half * square * share).reshape(-1, 2)
    grid = np.arange((rings + 1) * around).reshape(-1, around)
    turned = np.roll(grid, -1, axis=1)
    triangles = np.stack([[grid[:-1], turned[:-1], grid[1:]], [turned[:-1], turned[1:], grid[1:]]])
    hole = np.c_[grid[0], turned[0]]
    ends = np.sort(hole, axis=1)
    middle = x[ends].sum(1)
    middle *= radius / np.hypot(*middle.T)[:, None]
    return make_mesh(
        x,
        triangles.transpose(2, 0, 3, 1).reshape(-1, 3),  # ring by ring
        {"hole": hole, "sides": hole + rings * around},
        {(a, b): point for (a, b), point in zip(ends.tolist(), middle)},
    )
