"""A material of one's own: boron nitride, from LAMMPS dumps to a certified model.

Makes what a user would bring, LAMMPS dumps and CSV files of forces, then uses the command alone:
coarse-grain, fit, certify. Constants are held to those of lattice statics, displacements under
patches of load, which no fit sees, to local elasticity.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from ase.data import atomic_masses, atomic_numbers
from tqdm import tqdm

from examples.local_elasticity import errors_by_model
from tools.elastic import elastic_constants
from tools.graphene import bond_length, sheet
from tools.lammps_session import LammpsSession
from tools.loads import TRAINING, VALIDATION, Load
from tools.options import Options, check_new
from tools.statics import Statics
from warp_peri import load
from warp_peri.atoms.calculators import potential_file
from warp_peri.cli.main import main as warp_peri
from warp_peri.core.elastic import plane_isotropic
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked, write_json

ELEMENTS = ("B", "N")
MASSES = [atomic_masses[atomic_numbers[name]] for name in ELEMENTS]
Sets = dict[str, tuple[list[Path], list[Path]]]
CELLS, HIGHEST, STRAIN = (39, 23), 3, 0.01
"""Cells of the sheet; most periods of a wave along each axis; largest strain of a bond."""


def make_dumps(folder: Path) -> tuple[Sets, Path, tuple[float, float]]:
    """Dumps and forces of loads by set, the dump without load, and the periods [Å]."""
    potential = potential_file("BNC.tersoff")
    bond = bond_length(potential, elements=ELEMENTS)
    positions, box = sheet(bond, cells=CELLS)
    masses = np.resize(MASSES, len(positions))[:, None]
    share = masses / masses.mean()  # a load goes over the atoms of a cell by mass
    loads: list[tuple[str, Load]] = [("val", patch) for patch in VALIDATION]
    loads[:0] = [("train", wave) for wave in TRAINING if max(wave.waves) <= HIGHEST]
    folder.mkdir(parents=True, exist_ok=True)
    found: Sets = {"train": ([], []), "val": ([], [])}
    rest = folder / "rest.dump"
    with LammpsSession(positions, box=box, potential=potential, elements=ELEMENTS) as session:
        statics = Statics(positions, box=box, session=session)
        session.forces(statics.reference)
        session.write_dump(rest)
        for number, (name, load) in enumerate(tqdm(loads, desc="loads", unit="load"), start=1):
            shape = load.shape(statics.reference, box) * share
            linear = statics.linear_response(shape)
            size = 1e-6 / np.abs(linear).max()
            size *= STRAIN / statics.max_bond_strain(size * linear)
            equilibrium = statics.equilibrium(size * shape, name=load.load_id)
            session.forces(statics.reference + equilibrium.displacement)
            dump, force = (folder / f"load{number}.{end}" for end in ("dump", "csv"))
            session.write_dump(dump)
            np.savetxt(force, equilibrium.force, delimiter=",", fmt="%.15g")
            found[name][0].append(dump)
            found[name][1].append(force)
    return found, rest, box


def run(out: Path) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """Dumps, then the command as it would be typed; learned and true constants, and E_u."""
    sets, rest, box = make_dumps(out / "dumps")
    data, model = out / "bn.h5", out / "model"
    atoms = ["--reference", rest, "--box", *box, "--mass", *MASSES]
    nodes = ["--reach", 55, "--interior", 30, "--thickness", 3.35, "--density", 2100]
    grained = [
        ["coarse-grain", *dumps, "--force", *forces, *atoms, *nodes, "--set", name, "--out", data]
        for name, (dumps, forces) in sets.items()
    ]
    fit = ["fit", data, "--horizon", 12.5, "--degree", 5, "--out", model]
    for line in (*grained, fit, ["certify", model / "model.json"]):
        status = warp_peri([str(word) for word in line])
        if status:
            raise RuntimeError(f"warp-peri {line[0]} ended with status {status}")
    potential = potential_file("BNC.tersoff")
    bond = bond_length(potential, elements=ELEMENTS)
    truth = elastic_constants(bond, potential=potential, elements=ELEMENTS)
    learned = load(model / "model.json")
    own = {"lambda": learned.lam, "mu": learned.mu, "E": learned.E, "nu": learned.nu}
    constants = {"learned": own, "lattice statics": truth}
    true = plane_isotropic(truth["lambda"], truth["mu"])
    return constants, errors_by_model({"linear solid": learned}, dict(load(data).sets), true)


def main(arguments: list[str] | None = None) -> int:
    given = Options(__doc__, "boron_nitride").parse_args(arguments)
    check_new(given.out, "dumps/*", "constants.json", "errors.json")
    with locked(given.out):
        rows, errors = run(given.out)
        write_json(given.out / "constants.json", rows)
        write_json(given.out / "errors.json", errors)
    for name, row in rows.items():
        print(f"{name:16}", ", ".join(f"{key} = {value:.4f}" for key, value in row.items()))
    for name, row in errors.items():
        print(f"{name:44}", ", ".join(f"{key} {100 * e:.2f} %" for key, e in row.items()))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
