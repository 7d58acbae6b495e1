"""Solids of a positive base between two short convolutions: accurate, uneven, with edges (D)."""

from warp_peri.dressed.broken import grown, torn
from warp_peri.dressed.finite import FiniteSolid
from warp_peri.dressed.finite_learning import FiniteFit, FiniteStrain
from warp_peri.dressed.law import DressedSolid
from warp_peri.dressed.laws import Dressed, DressedFit
from warp_peri.dressed.learning import from_phonons, transferred
from warp_peri.dressed.maps import DensityLaw, MapFit, fit_density, fit_maps

__all__ = [
    "DensityLaw",
    "Dressed",
    "DressedFit",
    "DressedSolid",
    "FiniteFit",
    "FiniteSolid",
    "FiniteStrain",
    "MapFit",
    "fit_density",
    "fit_maps",
    "from_phonons",
    "grown",
    "torn",
    "transferred",
]
