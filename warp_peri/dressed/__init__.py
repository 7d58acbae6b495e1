"""Solids of a positive base between two short convolutions: accurate, uneven, with edges (D)."""

from warp_peri.dressed.body import grown, torn
from warp_peri.dressed.finite import FiniteSolid, FiniteStrain
from warp_peri.dressed.law import Dressed, DressedSolid, from_phonons, transferred
from warp_peri.dressed.maps import DensityLaw, Effective, MapFit, effective, fit_density, fit_maps

__all__ = [
    "DensityLaw",
    "Dressed",
    "DressedSolid",
    "Effective",
    "FiniteSolid",
    "FiniteStrain",
    "MapFit",
    "effective",
    "fit_density",
    "fit_maps",
    "from_phonons",
    "grown",
    "torn",
    "transferred",
]
