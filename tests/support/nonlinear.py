"""Nonlinear models for tests, and Ψ written down as in the theory, from the Green strain."""

import numpy as np

from tests.support.problems import AXIS, kernel
from warp_peri.third_order.material import NonlinearModel
from warp_peri.third_order.smoothing import Smoothing

CONSTANTS = (-0.5, -6.8, 1.04)
FORMS = ("energy", "filtered")


def solid(form, horizon=3.0, spacing=1.0, lam=-0.2):
    """A nonlinear model on a lattice, its linear part taken as certified."""
    linear = kernel("two functions", horizon, spacing, lam=lam)
    smoothing = Smoothing(2.0 * spacing) if form == "filtered" else None
    return NonlinearModel(linear, *CONSTANTS, smoothing=smoothing)


def psi(H, model, axis=AXIS):
    """Ψ of (N3) [TPa] at H, shape [..., 2, 2], with the small-strain energy taken off."""
    small = (H + np.swapaxes(H, -1, -2)) / 2
    E = small + np.swapaxes(H, -1, -2) @ H / 2
    linear = model.linear

    def harmonic(strain):
        trace = np.trace(strain, axis1=-2, axis2=-1)
        return linear.lam / 2 * trace**2 + linear.mu * (strain**2).sum(axis=(-2, -1))

    t = np.trace(E, axis1=-2, axis2=-1)
    q = (E[..., 0, 0] - E[..., 1, 1]) / 2 + 1j * E[..., 0, 1]
    q = q * np.exp(-2j * axis)
    cubic = model.t3 * t**3 + model.tq2 * t * np.abs(q) ** 2 + model.q3 * (q**3).real
    return harmonic(E) - harmonic(small) + cubic


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
