"""One solve or motion on many processes, under mpiexec: `mpiexec -n 64 python my_script.py`.

A rank is one of the processes. Each owns a piece of the nodes; what comes back is on these.
"""

from warp_peri.ranks.pieces import Piece, lattice, spread, whole
from warp_peri.ranks.world import is_first

__all__ = ["Piece", "is_first", "lattice", "spread", "whole"]
