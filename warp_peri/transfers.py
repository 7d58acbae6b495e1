"""A material on another lattice, and samples on one: `warp_peri.transfers`."""

from warp_peri.points.interpolation import onto_lattice
from warp_peri.transfer.cache import on_lattice

__all__ = ["on_lattice", "onto_lattice"]
