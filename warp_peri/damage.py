"""Cracks: bonds that are cut, break or soften, at rest and in motion (theory, C)."""

from warp_peri.fracture.body import LatticeBody, box, lattice_body, penny, point_force, rectangle
from warp_peri.fracture.dynamics import BrittleSolid, continuum_stretch, positive_kernel
from warp_peri.fracture.growth import apparent_toughness
from warp_peri.fracture.problems import Cracked, Injected
from warp_peri.fracture.release import contour_integral, energy_release, opening_volume, tip_shift
from warp_peri.fracture.softening import BondLaw, SoftSolid

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
