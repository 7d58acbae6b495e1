"""Displacement that is solved for, and fits, with what they are asked for one by one."""

from warp_peri import LPS, Dirichlet
from warp_peri import solve as solved

solve = lambda model, points, b, u, **options: solved(model, Dirichlet(points, b, u), **options).u


def fit(samples, horizon, kernel=None, *, noise=None, progress=None, **options):
    return LPS(horizon, kernel, **options).learn(samples, noise=noise, progress=progress)
