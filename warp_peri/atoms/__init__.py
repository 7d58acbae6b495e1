"""Fields on nodes from atoms and frames, and models from crystals; names come on first use."""

from typing import TYPE_CHECKING

from warp_peri import lazy

if TYPE_CHECKING:
    from warp_peri.atoms.calculators import load_mpi_library as load_mpi_library
    from warp_peri.atoms.calculators import make_calculator as make_calculator
    from warp_peri.atoms.coarse_graining import coarse_grain as coarse_grain
    from warp_peri.atoms.coarse_graining import read_mat as read_mat
    from warp_peri.atoms.coarse_graining import smoothing_matrix as smoothing_matrix
    from warp_peri.atoms.crystal_fit import CrystalFit as CrystalFit
    from warp_peri.atoms.crystal_fit import (
        crystal_from_force_constants as crystal_from_force_constants,
    )
    from warp_peri.atoms.crystal_fit import fit_crystal as fit_crystal
    from warp_peri.atoms.dic import dic_to_lattice as dic_to_lattice
    from warp_peri.atoms.dic import estimate_noise as estimate_noise
    from warp_peri.atoms.dic import read_dic_frame as read_dic_frame
    from warp_peri.atoms.dumps import DumpFrame as DumpFrame
    from warp_peri.atoms.dumps import ReferenceAtoms as ReferenceAtoms
    from warp_peri.atoms.dumps import check_box as check_box
    from warp_peri.atoms.dumps import coarse_grain_dumps as coarse_grain_dumps
    from warp_peri.atoms.dumps import iter_dump as iter_dump
    from warp_peri.atoms.dumps import mean_displacement as mean_displacement
    from warp_peri.atoms.dumps import read_masses as read_masses
    from warp_peri.atoms.phonons import from_phonopy as from_phonopy

else:  # a type checker would take any misspelt name for one of these
    __getattr__, __dir__, __all__ = lazy(__name__)
