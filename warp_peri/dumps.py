"""LAMMPS dumps, read frame by frame: what users call warp_peri.dumps."""

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
