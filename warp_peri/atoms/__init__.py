"""From atoms and frames to fields on nodes, and from crystals to models: `warp_peri.atoms`.

The names below are imported on first use, so that no reader is loaded before it is needed.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warp_peri.atoms.calculators import find_mpi, named_calculator
    from warp_peri.atoms.coarse_graining import (
        coarse_grain,
        force_on_mesh,
        read_fields,
        smoothing_matrix,
    )
    from warp_peri.atoms.crystal_fit import LearnedCrystal, from_atoms, from_force_constants
    from warp_peri.atoms.dic import frames_on_lattice, noise_of, read_frame
    from warp_peri.atoms.dumps import (
        Atoms,
        Average,
        Frame,
        check_box,
        coarse_grain_dumps,
        dump_displacement,
        dump_frames,
        dump_masses,
    )
    from warp_peri.atoms.relaxed import from_phonopy

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
]

_HOMES = {
    "calculators": "find_mpi named_calculator",
    "coarse_graining": "coarse_grain force_on_mesh read_fields smoothing_matrix",
    "crystal_fit": "LearnedCrystal from_atoms from_force_constants",
    "dic": "frames_on_lattice noise_of read_frame",
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
