"""Conduction and diffusion along bonds, alone and with mechanics (theory.md, D)."""

from warp_peri.diffusion.conductor import Conductor
from warp_peri.diffusion.coupled import CoupledOperator, CoupledSolid
from warp_peri.diffusion.operator import DiffusionGradient, DiffusionOperator

__all__ = [
    "Conductor",
    "CoupledOperator",
    "CoupledSolid",
    "DiffusionGradient",
    "DiffusionOperator",
]
