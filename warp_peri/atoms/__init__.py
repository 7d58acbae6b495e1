"""From atoms and frames to fields on nodes, and from crystals to models: `warp_peri.atoms`.

The names below are imported on first use, so that no reader is loaded before it is needed.
"""

from importlib import import_module
from typing import TYPE_CHECKING

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
    "load_mpi_library",
    "fit_crystal",
    "crystal_from_force_constants",
    "from_phonopy",
    "make_calculator",
    "coarse_grain",
    "force_on_mesh",
    "dic_to_lattice",
    "estimate_noise",
    "read_mat",
    "read_dic_frame",
    "smoothing_matrix",
    "ReferenceAtoms",
    "FrameAverage",
    "DumpFrame",
    "check_box",
    "coarse_grain_dumps",
    "mean_displacement",
    "iter_dump",
    "read_masses",
]

_HOMES = {
    "calculators": "load_mpi_library make_calculator",
    "coarse_graining": "coarse_grain force_on_mesh read_mat smoothing_matrix",
    "crystal_fit": "CrystalFit fit_crystal crystal_from_force_constants",
    "dic": "dic_to_lattice estimate_noise read_dic_frame",
    "relaxed": "from_phonopy",
}

if not TYPE_CHECKING:  # a type checker would take any misspelt name for one of these

    def __getattr__(name):
        """A public name, imported now (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        home = next((home for home, names in _HOMES.items() if name in names.split()), "dumps")
        value = globals()[name] = getattr(import_module(f"{__name__}.{home}"), name)
        return value

    def __dir__():
        return sorted(__all__)
