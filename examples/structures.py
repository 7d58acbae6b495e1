"""Structures to laws: seventeen crystals by LAMMPS and ASE's EMT, each through one call.

python examples/structures.py            a table
python examples/structures.py --picture runs/atoms.png
"""

import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import ase.build
import numpy as np

import warp_peri as wp
from tools.options import Options
from warp_peri.core.elastic import voigt
from warp_peri.errors import exit_status

EMT = "ase.calculators.emt:EMT"
TERSOFF = ("lammps:tersoff", "SiC_1989.tersoff")
CASES: dict[str, tuple[Any, str, str | None, dict[str, Any]]] = {
    "Cu": (ase.build.bulk("Cu"), "lammps:eam/alloy", "Cu_mishin1.eam.alloy", {}),
    "Si": (ase.build.bulk("Si"), "lammps:sw", "Si.sw", {}),
    "MoS2": (ase.build.mx2("MoS2", vacuum=10), "lammps:sw/mod", "tmd.sw.mod", {}),
    "BN": (ase.build.graphene("BN", vacuum=10), "lammps:tersoff", "BNC.tersoff", {}),
    "graphene": (ase.build.graphene(vacuum=10), *TERSOFF, {}),
    "graphene, stretched": (
        ase.build.graphene(a=2.529676 * 1.05, vacuum=10), *TERSOFF, {"hold": ["xx"]}
    ),
    "SiC": (ase.build.bulk("SiC", "zincblende", a=4.4), *TERSOFF, {}),
    "Al": (ase.build.bulk("Al"), EMT, None, {}),
    "Cu, EMT": (ase.build.bulk("Cu"), EMT, None, {}),
    "Ni": (ase.build.bulk("Ni"), EMT, None, {}),
    "Au": (ase.build.bulk("Au"), EMT, None, {}),
    "GaN": (ase.build.bulk("GaN", "wurtzite", a=3.19, c=5.2), "lammps:sw", "GaN.sw", {}),
    "WSe2": (
        ase.build.mx2("WSe2", a=3.3, thickness=3.3, vacuum=10), "lammps:sw/mod", "tmd.sw.mod", {}
    ),
    "Fe": (ase.build.bulk("Fe"), "lammps:eam/fs", "Fe_mm.eam.fs", {}),
    "Zr": (ase.build.bulk("Zr"), "lammps:eam/fs", "Zr_mm.eam.fs", {}),
    "MoTe2": (
        ase.build.mx2("MoTe2", a=3.5, thickness=3.6, vacuum=10), "lammps:sw/mod", "tmd.sw.mod", {}
    ),
    "Pd": (ase.build.bulk("Pd"), EMT, None, {}),
}  # fmt: skip
"""Structure, calculator, potential, options; from SiC on, but for Al, Cu and Ni by EMT, chosen
before they were tried."""


def learned(name: str) -> wp.atoms.LearnedCrystal:
    """One crystal."""
    atoms, calculator, potential, options = CASES[name]
    made = wp.atoms.named_calculator(calculator, atoms.get_chemical_symbols(), potential)
    return wp.from_atoms(atoms, made, **options)


def row(name: str) -> str:
    """A line of the table: moduli, how far off finite strains, waves, errors of unseen loads, s."""
    begin = time.perf_counter()
    found = learned(name)
    assert found.strained is not None
    law, true = voigt(found.law.tensor()), voigt(found.strained)
    off = 100 * np.abs(law - true).max() / np.abs(true).max()
    C = ", ".join(f"{value:.1f}" for value in found.law.moduli("GPa").values())
    unseen = " | ".join(f"{e['law']:.2f}, {e['local']:.2f}" for e in found.unseen.values())
    waves = ", ".join(f"{found.holds_to[key]:.1f}" for key in ("law", "local"))
    return f"| {name} | {C} | {off:.2f} | {waves} | {unseen} | {time.perf_counter() - begin:.1f} |"


def main(words: list[str] | None = None) -> None:
    """Print the table, or draw one crystal."""
    parser = Options(__doc__)
    parser.add("crystals", nargs="*", default=list(CASES), metavar="NAME")
    parser.add("--picture", type=Path, help="draw the first there, and nothing else")
    given = parser.parse_args(words)
    if given.picture is not None:
        given.picture.parent.mkdir(parents=True, exist_ok=True)
        learned(given.crystals[0]).plot().savefig(given.picture, dpi=100)
        return
    for name in given.crystals:
        print(row(name), flush=True)


if __name__ == "__main__":
    sys.exit(exit_status(main))
