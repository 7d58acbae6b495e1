"""Soft tissue: hyperelastic sheets, learned from loads or from displacement (theory, H)."""

from warp_peri.materials.hyperelastic.energies import Dictionary, HyperelasticSolid, Term
from warp_peri.materials.hyperelastic.energy_fit import EnergyFit, shortest_margin
from warp_peri.materials.hyperelastic.equilibrium import Equilibrium, NoEquilibrium
from warp_peri.materials.hyperelastic.febio import in_words, material_terms, save_febio
from warp_peri.materials.hyperelastic.fibres import (
    families,
    read_material,
    rose,
    rose_of,
    with_corners,
)
from warp_peri.materials.hyperelastic.from_displacement import (
    DisplacementFit,
    Thickness,
    fit_thickness,
)
from warp_peri.materials.hyperelastic.model_selection import SheetChoice, choose_sheet, uniaxial
from warp_peri.materials.hyperelastic.placed import PlacedSheet, hyperelastic_errors

__all__ = [
    "Dictionary",
    "DisplacementFit",
    "EnergyFit",
    "Equilibrium",
    "HyperelasticSolid",
    "NoEquilibrium",
    "PlacedSheet",
    "SheetChoice",
    "Term",
    "Thickness",
    "choose_sheet",
    "families",
    "fit_thickness",
    "hyperelastic_errors",
    "in_words",
    "material_terms",
    "read_material",
    "rose",
    "rose_of",
    "save_febio",
    "shortest_margin",
    "uniaxial",
    "with_corners",
]
