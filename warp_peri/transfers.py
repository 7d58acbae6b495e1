"""A material on another lattice, and one influence function for many: `warp_peri.transfers`."""

from warp_peri.points.interpolation import onto_lattice
from warp_peri.transfer.cache import on_lattice
from warp_peri.transfer.shared_kernel import one_kernel

__all__ = ["on_lattice", "one_kernel", "onto_lattice"]
