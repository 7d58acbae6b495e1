"""From atoms and frames to fields on nodes, and from crystals to models: `warp_peri.atoms`.

The names below are imported on first use, so that no reader is loaded before it is needed.
"""

from typing import TYPE_CHECKING

from warp_peri.lazy import lazy

if TYPE_CHECKING:
    from warp_peri.atoms.calculators import load_mpi_library, make_calculator
    from warp_peri.atoms.coarse_graining import (
        coarse_grain,
        force_on_mesh,
        read_mat,
        smoothing_matrix,
    )
    from warp_peri.atoms.crystal_fit import CrystalFit, crystal_from_force_constants, fit_crystal
    from warp_peri.atoms.dic import dic_to_lattice, estimate_noise, read_dic_frame
    from warp_peri.atoms.dumps import (
        DumpFrame,
        FrameAverage,
        ReferenceAtoms,
        check_box,
        coarse_grain_dumps,
        iter_dump,
        mean_displacement,
        read_masses,
    )
    from warp_peri.atoms.relaxed import from_phonopy

__all__ = [
    "CrystalFit",
    "DumpFrame",
    "FrameAverage",
    "ReferenceAtoms",
    "check_box",
    "coarse_grain",
    "coarse_grain_dumps",
    "crystal_from_force_constants",
    "dic_to_lattice",
    "estimate_noise",
    "fit_crystal",
    "force_on_mesh",
    "from_phonopy",
    "iter_dump",
    "load_mpi_library",
    "make_calculator",
    "mean_displacement",
    "read_dic_frame",
    "read_masses",
    "read_mat",
    "smoothing_matrix",
]

_HOMES = {
    "calculators": "load_mpi_library make_calculator",
    "coarse_graining": "coarse_grain force_on_mesh read_mat smoothing_matrix",
    "crystal_fit": "CrystalFit fit_crystal crystal_from_force_constants",
    "dic": "dic_to_lattice estimate_noise read_dic_frame",
    "dumps": "DumpFrame FrameAverage ReferenceAtoms check_box coarse_grain_dumps iter_dump "
    "mean_displacement read_masses",
    "relaxed": "from_phonopy",
}

if not TYPE_CHECKING:  # a type checker would take any misspelt name for one of these
    __getattr__, __dir__ = lazy(__name__, _HOMES)
