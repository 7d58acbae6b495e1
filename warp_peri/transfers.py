"""A material on another lattice, and samples on one: `warp_peri.transfers`."""

from warp_peri.materials.lps_transfer import on_lattice
from warp_peri.points.interpolation import onto_lattice

__all__ = ["on_lattice", "onto_lattice"]
