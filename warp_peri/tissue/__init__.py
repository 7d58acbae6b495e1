"""Soft tissue: hyperelastic sheets, learned from loads or from displacement (theory.md, H)."""

from warp_peri.tissue.displacement_search import DisplacementFit
from warp_peri.tissue.energy_fit import EnergyFit
from warp_peri.tissue.equilibrium import Equilibrium, NoEquilibrium
from warp_peri.tissue.febio import in_words, material_terms, save_febio
from warp_peri.tissue.fibres import (
    families,
    read_material,
    rose,
    rose_of,
    with_corners,
    with_directions,
    with_families,
)
from warp_peri.tissue.fit_errors import hyperelastic_errors
from warp_peri.tissue.from_displacement import fit_thickness, scaled_by_force
from warp_peri.tissue.placed import PlacedSheet
from warp_peri.tissue.sheet_choice import SheetChoice, choose_sheet, uniaxial
from warp_peri.tissue.solid import Dictionary, HyperelasticSolid, Term
from warp_peri.tissue.thickness import Thickness
from warp_peri.tissue.uniform_strain import shortest_margin

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
    "scaled_by_force",
    "shortest_margin",
    "uniaxial",
    "with_corners",
    "with_directions",
    "with_families",
]
