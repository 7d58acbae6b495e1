"""Crystals of any symmetry in two and three dimensions: a tensor for every bond (theory, T)."""

from warp_peri.atoms.force_constants import NonAnalyticCorrection
from warp_peri.atoms.phonons import from_calculator
from warp_peri.core.elastic import voigt_to_tensor
from warp_peri.materials.crystal import CrystalMaterial, StencilMaterial, crystal_from_lps
from warp_peri.materials.crystal_fit import (
    Crystal,
    fit_dispersion,
    fit_phonons,
    plane_strain,
    plane_stress,
    transfer_to_lattice,
)

__all__ = [
    "CrystalMaterial",
    "Crystal",
    "NonAnalyticCorrection",
    "StencilMaterial",
    "fit_dispersion",
    "from_calculator",
    "fit_phonons",
    "voigt_to_tensor",
    "plane_strain",
    "plane_stress",
    "crystal_from_lps",
    "transfer_to_lattice",
]
