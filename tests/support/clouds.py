"""Scattered points, nodes in space, and displacement of local elasticity with its load."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.random import default_rng

from tests.support.problems import lattice, periodic
from warp_peri import LPSMaterial, Points


def cloud(number, horizon, perturbation=0.3, seed=0, length=None):
    """number × number perturbed nodes, length/number or 1 apart, and a collar for the horizon."""
    h = 1.0 if length is None else length / number
    grid = lattice(number, horizon + (perturbation + 0.5) * h, h, origin=(h / 2, h / 2))
    return shaken(grid, perturbation * h, seed)


def periodic_cloud(number, perturbation=0.3, dimension=2):
    """Perturbed nodes in a periodic box, `number` along each axis, all interior."""
    return shaken(periodic(dimension * (number,))[0], perturbation, 0)


def shaken(points, size, seed):
    """The nodes, each at random up to a size away along each axis."""
    shift = default_rng(seed).uniform(-size, size, points.x.shape)
    return Points(points.x + shift, points.interior, 0.0, box=points.box)


def larger(points, length, **told):
    """The same nodes in a body of another size."""
    return replace(points, x=length * points.x, spacing=length * points.spacing, **told)


def cube(number, horizon, spacing=1.0, centred=False):
    """number³ interior nodes of a cubic lattice, and the 2δ collar they need."""
    inside = np.ones(3 * (number,), bool)
    return lattice(inside, horizon, spacing, origin=3 * (spacing * centred / 2,))


def plain(horizon, lam=0.3, mu=0.8, **law):
    """The model with K = 1/r, whose local limit is linear elasticity, unless told otherwise."""
    return LPSMaterial(**{"lam": lam, "mu": mu, "alpha": 1.0, "D": [1.0], "horizon": horizon} | law)


solid = partial(plain, dimension=3)


def field(x):
    """A smooth displacement in space with divergence and rotation."""
    a, b, c = x.T
    return np.c_[np.sin(a) * np.cos(b), np.cos(b) * np.sin(c), np.sin(a) * np.cos(c)]


def load(x, lam, mu):
    """−[μ∇²u + (λ+μ)∇(∇·u)] of it."""
    a, b, c = x.T
    s, t = np.sin, np.cos
    # ∇·u = cos a cos b − sin b sin c − sin a sin c
    gradient = np.c_[
        -s(a) * t(b) - t(a) * s(c), -t(a) * s(b) - t(b) * s(c), -s(b) * t(c) - s(a) * t(c)
    ]
    return 2 * mu * field(x) - (lam + mu) * gradient
