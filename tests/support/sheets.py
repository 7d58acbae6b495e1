"""Hyperelastic sheets for tests: lattices, dictionaries with every energy, and smooth fields."""

import numpy as np

from warp_peri.materials.hyperelastic.energies import KINDS, EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.points.points import Points

SPACING = 0.1
NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))


def square(interior, *, spacing=SPACING):
    """Interior nodes a side and the collar they need."""
    steps = np.argwhere(np.ones(2 * [interior + 12]))
    return Points(spacing * steps, ((steps >= 6) & (steps < interior + 6)).all(axis=1), spacing)


def everything():
    """Deviations and every strain energy once, but mooney and yeoh."""
    angles = iter(np.linspace(0.2, 2.8, 4))
    others = ("fibre", "mooney", "yeoh")
    terms = [EnergyTerm(kind) for kind in KINDS if not kind.startswith(others)]
    terms += [EnergyTerm("fibre_power", next(angles), p) for p in (2.5, 3.0)]
    terms += [EnergyTerm("fibre_exponential", next(angles), k2) for k2 in (0.0, 1.5)]
    terms += [EnergyTerm("volumetric", corner=True)]
    terms += [EnergyTerm("fibre_power", 0.7, 2.5, corner=True)]
    return Hyperelastic(3.0, (*NEAREST, (2, 0)), tuple(terms))


def hgo_dictionary():
    """A matrix and one exponential fibre family, with deviations against hourglasses."""
    kinds = ("neo_hookean",), ("volumetric",), ("fibre_exponential", 1.2, 1.5)
    return Hyperelastic(3.0, NEAREST, tuple(EnergyTerm(*kind) for kind in kinds))


def sheet_on(points, dictionary=None, c=None, thickness=None):
    """A sheet of a dictionary, of HGO without one, on points; coefficients of one without some."""
    dictionary = dictionary or hgo_dictionary()
    c = np.ones(len(dictionary)) if c is None else np.asarray(c, float)
    return HyperelasticMaterial(dictionary, c, points.spacing).on(points, thickness=thickness)


def waves(points, amplitude=0.1, seed=0):
    """A smooth field with displacement gradients about as large as the amplitude, shape [N, 2]."""
    random = np.random.default_rng(seed)
    extent = np.ptp(points.x, axis=0).max()
    u = np.zeros_like(points.x)
    for k in ((1, 0), (0, 1), (1, 1), (2, -1)):
        phase = 2 * np.pi * (points.x @ np.array(k) / extent + random.random())
        u += np.sin(phase)[:, None] * random.normal(size=2) / np.hypot(*k)
    return amplitude * extent / (4 * np.pi) * u
