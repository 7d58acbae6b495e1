"""Third-order crystals for tests, and Ψ written down as in the theory, from the Green strain."""

from functools import cache

import numpy as np

from tests.crystal.crystals import cubic_tensor, dispersive
from tests.support.problems import AXIS
from warp_peri.materials.crystal_fit import fit_dispersion
from warp_peri.materials.third_order import Smoothing, ThirdOrderMaterial

LAM, MU = 0.3, 0.7
TENSOR = cubic_tensor(2, LAM + 2 * MU, LAM, MU)
CONSTANTS = (-0.5, -6.8, 1.04)
FORMS = ("energy", "filtered")


@cache
def solid(form, horizon=3.0, spacing=1.0):
    """A certified crystal with its guarantee."""
    linear = fit_dispersion(
        dispersive(TENSOR, spacing), spacing, horizon, symmetry="isotropic", tensor=TENSOR
    )
    smoothing = Smoothing(2.0 * spacing, 0.2)
    return ThirdOrderMaterial(linear, *CONSTANTS, smoothing, form, horizon).certified()


def strain(H, axis=0.0):
    """Green strain E at H, shape [..., 2, 2], its trace, and q along an axis [rad]."""
    turned = np.swapaxes(H, -1, -2)
    E = (H + turned + turned @ H) / 2
    q = (E[..., 0, 0] - E[..., 1, 1]) / 2 + 1j * E[..., 0, 1]
    return E, np.trace(E, axis1=-2, axis2=-1), q * np.exp(-2j * axis)


def psi(H, model):
    """Ψ of (N3) [TPa] at H, shape [..., 2, 2], with the small-strain energy taken off."""
    (E, t, q), small = strain(H, AXIS), (H + np.swapaxes(H, -1, -2)) / 2
    lam, mu = model.lame

    def harmonic(strain):
        return lam / 2 * np.trace(strain, axis1=-2, axis2=-1) ** 2 + mu * (strain**2).sum((-2, -1))

    cubic = model.t3 * t**3 + model.tq2 * t * np.abs(q) ** 2 + model.q3 * (q**3).real
    return harmonic(E) - harmonic(small) + cubic
