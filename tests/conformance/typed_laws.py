"""Materials and operators as the contract's protocols: mypy holds them to it."""

from warp_peri import LPS
from warp_peri.materials.hyperelastic.energies import Hyperelastic
from warp_peri.materials.hyperelastic.operator import (
    HyperelasticMaterial,
    HyperelasticSheetOperator,
)
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.materials.third_order import PlacedThirdOrder, ThirdOrder, ThirdOrderMaterial
from warp_peri.points.points import Points
from warp_peri.problems import Body, Dirichlet, Periodic
from warp_peri.protocols import FittableModel, Material, Operator, Problem


def materials(
    one: LPSMaterial, two: ThirdOrderMaterial, three: HyperelasticMaterial
) -> list[Material]:
    return [one, two, three]


def operators(
    one: LPSOperator, two: PlacedThirdOrder, three: HyperelasticSheetOperator
) -> list[Operator]:
    return [one, two, three]


def problems(one: Dirichlet, two: Periodic, three: Body) -> list[Problem]:
    return [one, two, three]


def laws(one: LPS, two: ThirdOrder, three: Hyperelastic) -> list[FittableModel]:
    return [one, two, three]


def placed(material: Material, points: Points) -> Operator:
    return material.on(points)
