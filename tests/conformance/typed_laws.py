"""Materials and operators as the contract's protocols: mypy holds them to it."""

from warp_peri import LPS
from warp_peri.contract import Law, Material, Operator, Problem
from warp_peri.materials.hyperelastic.energies import Dictionary, HyperelasticSolid
from warp_peri.materials.hyperelastic.placed import PlacedSheet
from warp_peri.materials.lps import Model
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.materials.third_order import PlacedThirdOrder, ThirdOrderCrystal
from warp_peri.materials.third_order_fit import ThirdOrder
from warp_peri.points.points import Points
from warp_peri.problems import Body, Dirichlet, Periodic


def materials(one: Model, two: ThirdOrderCrystal, three: HyperelasticSolid) -> list[Material]:
    return [one, two, three]


def operators(one: LPSOperator, two: PlacedThirdOrder, three: PlacedSheet) -> list[Operator]:
    return [one, two, three]


def problems(one: Dirichlet, two: Periodic, three: Body) -> list[Problem]:
    return [one, two, three]


def laws(one: LPS, two: ThirdOrder, three: Dictionary) -> list[Law]:
    return [one, two, three]


def placed(material: Material, points: Points) -> Operator:
    return material.on(points)
