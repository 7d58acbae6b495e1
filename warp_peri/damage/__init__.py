"""Cracks: bonds that are cut, break or soften, at rest and in motion (theory, C)."""

from warp_peri.damage.cut_solid import contour_integral, opening_volume
from warp_peri.damage.lattice_body import (
    LatticeBody,
    box,
    lattice_body,
    penny,
    point_force,
    rectangle,
)
from warp_peri.damage.problems import Cracked, Injected
from warp_peri.damage.release import energy_release, tip_shift
from warp_peri.damage.slow_growth import apparent_toughness
from warp_peri.damage.softening import BondLaw, SoftSolid
from warp_peri.damage.solid import BrittleSolid, continuum_stretch, positive_kernel

__all__ = [
    "BondLaw",
    "BrittleSolid",
    "Cracked",
    "Injected",
    "LatticeBody",
    "SoftSolid",
    "apparent_toughness",
    "box",
    "continuum_stretch",
    "contour_integral",
    "energy_release",
    "lattice_body",
    "opening_volume",
    "penny",
    "point_force",
    "positive_kernel",
    "rectangle",
    "tip_shift",
]
