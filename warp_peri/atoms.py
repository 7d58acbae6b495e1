"""From atoms and frames to fields on nodes: `warp_peri.atoms`."""

from warp_peri.sources.coarse_graining import coarse_grain, force_on_mesh, smoothing_matrix
from warp_peri.sources.dic import frames_on_lattice, noise_of, read_frame
from warp_peri.sources.dumps import (
    Atoms,
    Average,
    Frame,
    check_box,
    coarse_grain_dumps,
    dump_displacement,
    dump_frames,
    dump_masses,
    dump_positions,
)

__all__ = [
    "coarse_grain",
    "force_on_mesh",
    "frames_on_lattice",
    "noise_of",
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
]
