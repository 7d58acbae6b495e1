"""Soft tissue: hyperelastic sheets, learned from loads or from displacement (theory, H)."""

from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.energy_fit import (
    EnergyFit,
    ThicknessField,
    fibre_energy_by_angle,
    fibre_families,
    fibre_fan,
    fit_fibre_families,
    with_corners,
)
from warp_peri.materials.hyperelastic.equilibrium import Equilibrium, NoEquilibriumError
from warp_peri.materials.hyperelastic.from_displacement import DisplacementFit, fit_thickness
from warp_peri.materials.hyperelastic.model_selection import (
    ModelSelection,
    in_words,
    material_terms,
    save_febio,
    select_model,
    uniaxial_stress,
)
from warp_peri.materials.hyperelastic.operator import (
    HyperelasticMaterial,
    HyperelasticSheetOperator,
    evaluate_hyperelastic,
)

__all__ = [
    "Hyperelastic",
    "DisplacementFit",
    "EnergyFit",
    "Equilibrium",
    "HyperelasticMaterial",
    "NoEquilibriumError",
    "HyperelasticSheetOperator",
    "ModelSelection",
    "EnergyTerm",
    "ThicknessField",
    "select_model",
    "fibre_families",
    "fit_thickness",
    "evaluate_hyperelastic",
    "in_words",
    "material_terms",
    "fit_fibre_families",
    "fibre_fan",
    "fibre_energy_by_angle",
    "save_febio",
    "uniaxial_stress",
    "with_corners",
]
