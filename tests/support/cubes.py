"""Points, models and manufactured solutions in three dimensions, defined once."""

import numpy as np

from warp_peri import LPSMaterial, Points


def cube(number, horizon, spacing=1.0, centred=False):
    """number³ interior nodes of a cubic lattice, and the 2δ collar they need."""
    pad = int(np.ceil(2 * horizon / spacing))
    steps = np.argwhere(np.ones(3 * [number + 2 * pad])) - pad
    inside = ((steps >= 0) & (steps < number)).all(axis=1)
    return Points(spacing * (steps + 0.5 * centred), inside, spacing)


def periodic_cloud(number, perturbation=0.2, seed=0):
    """number³ perturbed nodes in a periodic box, all interior."""
    steps = np.argwhere(np.ones(3 * [number]))
    shift = np.random.default_rng(seed).uniform(-perturbation, perturbation, steps.shape)
    box = 3 * (float(number),)
    return Points(steps + shift, np.ones(len(steps), bool), 0.0, box=box)


def solid(horizon, lam=0.3, mu=0.8, **law):
    """A model in space; K = 1/r, whose local limit is linear elasticity, unless told otherwise."""
    return LPSMaterial(
        **{"lam": lam, "mu": mu, "alpha": 1.0, "D": [1.0], "horizon": horizon} | law, dimension=3
    )


def field(x):
    """A smooth displacement with divergence and rotation."""
    a, b, c = x.T
    return np.stack([np.sin(a) * np.cos(b), np.cos(b) * np.sin(c), np.sin(a) * np.cos(c)], axis=1)


def load(x, lam, mu):
    """−[μ∇²u + (λ+μ)∇(∇·u)] of it."""
    a, b, c = x.T
    s, t = np.sin, np.cos
    # ∇·u = cos a cos b − sin b sin c − sin a sin c
    gradient = np.stack(
        [-s(a) * t(b) - t(a) * s(c), -t(a) * s(b) - t(b) * s(c), -s(b) * t(c) - s(a) * t(c)], axis=1
    )
    return 2 * mu * field(x) - (lam + mu) * gradient
