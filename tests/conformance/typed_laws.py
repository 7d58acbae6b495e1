"""Materials and operators as the contract's protocols: mypy holds them to it."""

from warp_peri import LPS, Body, Dirichlet, LPSMaterial, Periodic, protocols
from warp_peri.materials.hyperelastic.energies import Hyperelastic
from warp_peri.materials.hyperelastic.operator import (
    HyperelasticMaterial,
    HyperelasticSheetOperator,
)
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.materials.third_order import PlacedThirdOrder, ThirdOrder, ThirdOrderMaterial

Law = LPS | ThirdOrder | Hyperelastic
Solid = LPSMaterial | ThirdOrderMaterial | HyperelasticMaterial
Placed = LPSOperator | PlacedThirdOrder | HyperelasticSheetOperator


def fits(
    law: Law, problem: Dirichlet | Periodic | Body
) -> tuple[protocols.FittableModel, protocols.Problem]:
    return law, problem


def solids(solid: Solid, placed: Placed) -> tuple[protocols.Material, protocols.Operator]:
    return solid, placed
