"""Soft tissue: hyperelastic sheets, learned from loads or from displacement (theory, H)."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.materials.hyperelastic.energies import EnergyTerm as EnergyTerm
    from warp_peri.materials.hyperelastic.energies import Hyperelastic as Hyperelastic
    from warp_peri.materials.hyperelastic.fibres import ThicknessField as ThicknessField
    from warp_peri.materials.hyperelastic.fibres import fibre_families as fibre_families
    from warp_peri.materials.hyperelastic.fibres import fibre_fan as fibre_fan
    from warp_peri.materials.hyperelastic.fibres import with_corners as with_corners
    from warp_peri.materials.hyperelastic.model_selection import Candidate as Candidate
    from warp_peri.materials.hyperelastic.model_selection import in_words as in_words
    from warp_peri.materials.hyperelastic.model_selection import material_terms as material_terms
    from warp_peri.materials.hyperelastic.model_selection import save_febio as save_febio
    from warp_peri.materials.hyperelastic.model_selection import select_model as select_model
    from warp_peri.materials.hyperelastic.model_selection import uniaxial_stress as uniaxial_stress
    from warp_peri.materials.hyperelastic.operator import (
        HyperelasticMaterial as HyperelasticMaterial,
    )
    from warp_peri.materials.hyperelastic.operator import (
        HyperelasticSheetOperator as HyperelasticSheetOperator,
    )
    from warp_peri.materials.hyperelastic.sheet_fit import SheetFit as SheetFit
    from warp_peri.materials.hyperelastic.sheet_fit import fit_fibre_families as fit_fibre_families
    from warp_peri.solvers.equilibria import NoEquilibriumError as NoEquilibriumError
    from warp_peri.solvers.equilibria import NonlinearRecord as NonlinearRecord
else:
    __getattr__, __dir__, __all__ = lazy(__name__)
