"""Crystals of any symmetry in two and three dimensions: a tensor for every bond (theory, T)."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.atoms.force_constants import NonAnalyticCorrection as NonAnalyticCorrection
    from warp_peri.atoms.phonons import from_calculator as from_calculator
    from warp_peri.core.elastic import voigt_to_tensor as voigt_to_tensor
    from warp_peri.materials.crystal import CrystalMaterial as CrystalMaterial
    from warp_peri.materials.crystal import StencilMaterial as StencilMaterial
    from warp_peri.materials.crystal import crystal_from_lps as crystal_from_lps
    from warp_peri.materials.crystal_fit import Crystal as Crystal
    from warp_peri.materials.crystal_fit import fit_dispersion as fit_dispersion
    from warp_peri.materials.crystal_fit import fit_phonons as fit_phonons
    from warp_peri.materials.crystal_fit import plane_strain as plane_strain
    from warp_peri.materials.crystal_fit import plane_stress as plane_stress
    from warp_peri.materials.crystal_fit import transfer_to_lattice as transfer_to_lattice
else:
    __getattr__, __dir__, __all__ = lazy(__name__)
