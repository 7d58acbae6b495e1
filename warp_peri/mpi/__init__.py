"""Parallel solves and motions on ranks, processes of `mpiexec -n 64 python my_script.py`.

Each rank owns a piece of the nodes; what comes back is on these.
"""

from contextlib import suppress

from warp_peri.errors import InputError
from warp_peri.mpi.processes import is_root, together, world
from warp_peri.mpi.subdomain import Subdomain, gather, lattice, partition
from warp_peri.runtime import ranks_started
from warp_peri.solvers.motion import TimeSeriesWriter

if ranks_started():
    with suppress(InputError):  # raised again where ranks are used
        world()  # from here on one rank speaks

__all__ = ["TimeSeriesWriter", "Subdomain", "gather", "is_root", "lattice", "partition", "together"]
