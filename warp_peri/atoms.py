"""From atoms and frames to fields on nodes: `warp_peri.atoms`."""

from warp_peri.sources.coarse_graining import (
    coarse_grain,
    force_on_mesh,
    read_fields,
    smoothing_matrix,
)
from warp_peri.sources.dic import frames_on_lattice, noise_of, read_frame
from warp_peri.sources.dump_files import Frame, dump_frames
from warp_peri.sources.dumps import (
    Atoms,
    Average,
    check_box,
    coarse_grain_dumps,
    dump_displacement,
    dump_masses,
    dump_positions,
    write_atoms,
)
from warp_peri.structures.calculators import find_mpi, named_calculator
from warp_peri.structures.learn import LearnedCrystal, from_atoms, from_force_constants
from warp_peri.structures.rest import from_phonopy
from warp_peri.structures.rest import unit_cell as unit_cell

__all__ = [
    "LearnedCrystal",
    "find_mpi",
    "from_atoms",
    "from_force_constants",
    "from_phonopy",
    "named_calculator",
    "coarse_grain",
    "force_on_mesh",
    "frames_on_lattice",
    "noise_of",
    "read_fields",
    "read_frame",
    "smoothing_matrix",
    "Atoms",
    "Average",
    "Frame",
    "check_box",
    "coarse_grain_dumps",
    "dump_displacement",
    "dump_frames",
    "dump_masses",
    "dump_positions",
    "write_atoms",
]
