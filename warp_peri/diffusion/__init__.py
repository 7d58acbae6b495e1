"""Conduction and diffusion along bonds, alone and with mechanics (theory, Di)."""

from warp_peri.diffusion.conductor import DiffusionMaterial, DiffusionOperator
from warp_peri.diffusion.coupled import CoupledOperator, ThermoelasticMaterial

__all__ = ["DiffusionMaterial", "CoupledOperator", "ThermoelasticMaterial", "DiffusionOperator"]
