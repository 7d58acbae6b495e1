"""Crystals of any symmetry in two and three dimensions: a tensor for every bond (theory, T)."""

from warp_peri.atoms.force_constants import Polar, from_calculator
from warp_peri.core.elastic import from_voigt
from warp_peri.materials.crystal import Crystal, StencilMaterial, tensors_of
from warp_peri.materials.crystal_fit import (
    Micromodulus,
    fit_symbol,
    from_phonons,
    plane_strain,
    plane_stress,
    transferred,
)

__all__ = [
    "Crystal",
    "Micromodulus",
    "Polar",
    "StencilMaterial",
    "fit_symbol",
    "from_calculator",
    "from_phonons",
    "from_voigt",
    "plane_strain",
    "plane_stress",
    "tensors_of",
    "transferred",
]
