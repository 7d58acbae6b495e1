"""Conduction and diffusion along bonds, alone and with mechanics (theory, Di)."""

from warp_peri.diffusion.conductor import Conductor, DiffusionGradient, DiffusionOperator
from warp_peri.diffusion.coupled import CoupledOperator, CoupledSolid

__all__ = ["Conductor", "CoupledOperator", "CoupledSolid", "DiffusionGradient", "DiffusionOperator"]
