"""Hyperelastic sheets for tests: lattices, dictionaries with every energy, and smooth fields."""

import numpy as np
from numpy.random import default_rng

from warp_peri.materials.hyperelastic.energies import NEAREST, EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.points.points import Points, grid_places

SPACING = 0.1


def square(interior, *, spacing=SPACING):
    """Interior nodes a side and the collar they need."""
    steps = grid_places(2 * [interior + 12])
    return Points(spacing * steps, ((steps >= 6) & (steps < interior + 6)).all(1), spacing)


def dictionary_of(*kinds, deviations=NEAREST):
    """A dictionary of terms that are told by their numbers in order."""
    return Hyperelastic(3.0, deviations, tuple(EnergyTerm(*kind) for kind in kinds))


def everything():
    """Deviations and energies of nodes, bonds and corners, but mooney and yeoh."""
    matrix = ("neo_hookean",), ("volumetric",), ("plane_stress",)
    fibres = ("fibre_power", 0.2, 2.5), ("fibre_exponential", 1.9), ("fibre_exponential", 2.8, 1.5)
    corners = ("fibre_power", 0.7, 2.5, True), ("volumetric", 0.0, 0.0, True, (2, -1))
    bond, near = ("fibre_power", 0.0, 2.5, False, (2, -1)), (*NEAREST, (2, 0))
    return dictionary_of(*matrix, *fibres, *corners, bond, deviations=near)


def hgo_dictionary():
    """A matrix and one exponential fibre family, with deviations against hourglasses."""
    return dictionary_of(("neo_hookean",), ("volumetric",), ("fibre_exponential", 1.2, 1.5))


def sheet_on(points, dictionary=None, c=None, thickness=None):
    """A sheet of a dictionary, of HGO without one, on points; coefficients of one without some."""
    dictionary = dictionary or hgo_dictionary()
    c = np.ones(len(dictionary)) if c is None else np.asarray(c, float)
    return HyperelasticMaterial(dictionary, c, points.spacing).on(points, thickness=thickness)


def waves(points, amplitude=0.1, seed=0):
    """A smooth field with displacement gradients about as large as the amplitude, shape [N, 2]."""
    random = default_rng(seed)
    extent = np.ptp(points.x, axis=0).max()
    u = np.zeros_like(points.x)
    for k in ((1, 0), (0, 1), (1, 1), (2, -1)):
        phase = 2 * np.pi * (points.x @ k / extent + random.random())
        u += np.sin(phase)[:, None] * random.normal(size=2) / np.hypot(*k)
    return amplitude * extent / (4 * np.pi) * u
