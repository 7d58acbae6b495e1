"""Scattered points, cut bodies and manufactured solutions, defined once."""

import numpy as np

from warp_peri import LPSMaterial, Points


def cloud(number, horizon, perturbation=0.3, seed=0, length=None):
    """number × number perturbed nodes, length/number or 1 apart, and a collar for the horizon."""
    h = 1.0 if length is None else length / number
    pad = int(np.ceil(2 * horizon / h + 2 * perturbation + 1))
    steps = np.argwhere(np.ones(2 * [number + 2 * pad])) - pad
    shift = np.random.default_rng(seed).uniform(-perturbation, perturbation, steps.shape)
    inside = ((steps >= 0) & (steps < number)).all(axis=1)
    return Points(h * (steps + 0.5 + shift), inside, 0.0)


def periodic_cloud(number, perturbation=0.3, seed=0):
    """number × number perturbed nodes in a periodic box, all interior, and the box."""
    steps = np.argwhere(np.ones((number, number)))
    shift = np.random.default_rng(seed).uniform(-perturbation, perturbation, steps.shape)
    box = (float(number), float(number))
    return Points(steps + shift, np.ones(len(steps), bool), 0.0, box=box), box


def plain(horizon, lam=0.3, mu=0.8):
    """The model with K = 1/r, whose local limit is linear elasticity."""
    return LPSMaterial(lam=lam, mu=mu, alpha=1.0, D=[1.0], horizon=horizon)


def bond_based_field(x):
    """The paper's manufactured displacement; it has no dilatation."""
    a, b = x.T
    return np.stack([np.sin(a) * np.sin(b), np.cos(a) * np.cos(b)], axis=1)


def bond_based_load(x, mu):
    """−[μ∇²u + 2μ∇(∇·u)] of it."""
    return 2 * mu * bond_based_field(x)


def _gradient_part(x):
    a, b = x.T
    return np.stack([np.cos(a) * np.sin(2 * b), 2 * np.sin(a) * np.cos(2 * b)], axis=1)


def state_based_field(x, lam, mu):
    """curl ψ + (μ/λ) ∇χ, ψ = cos x cos 2y, χ = sin x sin 2y: its pressure stays finite."""
    a, b = x.T
    curl = np.stack([-2 * np.cos(a) * np.sin(2 * b), np.sin(a) * np.cos(2 * b)], axis=1)
    return curl + mu / lam * _gradient_part(x)


def state_based_load(x, lam, mu):
    """−[μ∇²u + (λ+μ)∇(∇·u)] of it."""
    pressure = 5 * (lam + mu) * mu / lam * _gradient_part(x)
    return 5 * mu * state_based_field(x, lam, mu) + pressure
