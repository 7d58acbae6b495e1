"""Laws and elastic constants of calculators whose forces are noisy, and how true their errors are.

python examples/noisy_calculators.py            a table
python examples/noisy_calculators.py --json     laws, error, coverage
python examples/noisy_calculators.py Al --seeds 2 --noise 1e-5
"""

import json
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import ase.build
import numpy as np
from ase.calculators.calculator import Calculator
from ase.calculators.emt import EMT

import warp_peri as wp
from tools.crystals import LEWIS_CATLOW
from tools.options import Options
from warp_peri.atoms.calculators import lammps_calculator
from warp_peri.atoms.crystal_fit import errors_of, known_constants, with_errors
from warp_peri.atoms.phonons import BORN, DIELECTRIC
from warp_peri.atoms.relaxed import at_rest
from warp_peri.core.elastic import allowed_tensors, named_moduli
from warp_peri.core.groups import name_of, point_group
from warp_peri.errors import exit_status

CRYSTALS = ("Al", "Cu", "Ni", "Si", "MgO")
LEVELS = (0.0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""Noise of forces [eV/Å]."""
BAND = 1.6448536
"""Standard errors on each side of a value that hold 90 %."""


class Noisy(Calculator):
    """A calculator with Gaussian noise on its forces, and a tenth of it [eV/Å³] on its stress.

    Noise of the stress falls with the root of the number of atoms.
    """

    def __init__(self, inner: Any, noise: float, seed: int | Sequence[int] = 0) -> None:
        super().__init__()
        self.inner, self.noise, self.rng = inner, noise, np.random.default_rng(seed)
        self.implemented_properties = list(inner.implemented_properties)

    def calculate(
        self, atoms: Any = None, properties: Sequence[str] = (), changes: Sequence[str] = ()
    ) -> None:
        """All that ASE asks for."""
        super().calculate(atoms, properties, changes)
        one: Any = atoms.copy()
        one.calc = self.inner
        forces, stress = one.get_forces(), one.get_stress()
        random = self.rng.standard_normal
        stress = stress + 0.1 * self.noise / np.sqrt(len(one)) * random(6)
        self.results = {
            **self.inner.results,
            "forces": forces + self.noise * random(forces.shape),
            "stress": stress,
        }


def rigid_ions() -> Any:
    """Magnesium oxide by LAMMPS, whose ions' charges are told."""
    wp.atoms.find_mpi()
    from ase.calculators.lammpslib import LAMMPSlib

    base: Any = LAMMPSlib

    class RigidIons(base):  # type: ignore[misc]
        implemented_properties = (*LAMMPSlib.implemented_properties, BORN, DIELECTRIC)

        def calculate(self, atoms: Any = None, properties: Any = (), changes: Any = ()) -> None:
            super().calculate(atoms, ["energy", "forces", "stress"], changes)
            charges = np.where(atoms.numbers == 12, 2.0, -2.0)
            self.results[BORN] = charges[:, None, None] * np.eye(3)
            self.results[DIELECTRIC] = np.eye(3)

    return RigidIons(
        lmpcmds=list(LEWIS_CATLOW),
        atom_types={"Mg": 1, "O": 2},
        lammps_header=["units metal", "atom_style charge", "atom_modify map array sort 0 0"],
        amendments=["set type 1 charge 2.0", "set type 2 charge -2.0"],
        keep_alive=True,
        log_file=None,
    )


def crystal(name: str) -> tuple[Any, Any]:
    """Structure and exact calculator."""
    if name == "MgO":
        return ase.build.bulk("MgO", "rocksalt", a=4.2), rigid_ions()
    calculator = lammps_calculator("sw", ["Si"], "Si.sw") if name == "Si" else EMT()
    return ase.build.bulk(name), calculator


def moduli(name: str, noise: float, seed: int) -> dict[str, tuple[float, float]]:
    """Moduli and standard errors [GPa] of a crystal, by force constants and strains."""
    structure, exact = crystal(name)
    own = [seed, *name.encode()]  # or all crystals would share their draws
    calculator = Noisy(exact, noise, own) if noise else exact
    reference = at_rest(structure, calculator)
    atoms, strained, _ = known_constants(reference, calculator)
    group = name_of(atoms.group())
    C = atoms.elastic(allowed_tensors(group, point_group(group, 3), np.eye(3)))
    return with_errors(C, errors_of(atoms, strained, group))


def made(name: str, noise: float) -> dict[str, Any]:
    """The law of a crystal, whether there is one, and seconds."""
    structure, exact = crystal(name)
    begin = time.perf_counter()
    try:
        found = wp.from_atoms(structure, Noisy(exact, noise) if noise else exact)
    except wp.InputError as error:
        return {"made": False, "why": str(error), "seconds": time.perf_counter() - begin}
    seconds = time.perf_counter() - begin
    return {"made": True, "moduli_GPa": named_moduli(1e3 * found.tensor), "seconds": seconds}


def study(names: Sequence[str], levels: Sequence[float], seeds: int) -> dict[str, Any]:
    """Laws made; largest and root mean square error of C over C; share of C in its 90 % band."""
    laws: dict[str, Any] = {name: {} for name in names}
    wrong: dict[str, dict[str, list[float]]] = {name: {} for name in names}
    within: dict[str, list[bool]] = {}
    for name in names:
        exact = moduli(name, 0.0, 0)
        for noise in levels:
            key = f"{noise:g}"
            laws[name][key] = made(name, noise)
            off = wrong[name].setdefault(key, [])
            for seed in range(seeds if noise else 0):
                for modulus, (value, bar) in moduli(name, noise, seed).items():
                    true, own = exact[modulus]
                    off.append(abs(value - true) / abs(true))
                    inside = abs(value - true) <= BAND * np.hypot(bar, own)
                    within.setdefault(key, []).append(bool(inside))
            print(f"{name} {key}", file=sys.stderr, flush=True)
    told = {
        name: {k: {"largest": max(v), "rms": float(np.mean(np.square(v)) ** 0.5)}
               for k, v in each.items() if v}
        for name, each in wrong.items()
    }  # fmt: skip
    coverage = {key: float(np.mean(one)) for key, one in within.items()}
    if within:
        coverage["all"] = float(np.mean([inside for one in within.values() for inside in one]))
    return {"laws": laws, "error": told, "coverage": coverage}


def shown(found: dict[str, Any]) -> str:
    """A table in Markdown: a row for each noise, in a cell the largest and the rms error [%]."""
    names = list(found["laws"])
    lines = ["| noise [eV/Å] | laws | " + " | ".join(names) + " | in the 90 % band |"]
    lines.append("|" + "---|" * (len(names) + 3))
    for key in found["laws"][names[0]]:
        laws = sum(found["laws"][name][key]["made"] for name in names)
        cells = []
        for name in names:
            off = found["error"][name].get(key)
            cells.append(f"{100 * off['largest']:.3f}, {100 * off['rms']:.3f}" if off else "–")
        share = found["coverage"].get(key)
        told = "–" if share is None else f"{share:.1%}"
        lines.append(f"| {key} | {laws} of {len(names)} | " + " | ".join(cells) + f" | {told} |")
    return "\n".join(lines)


def main(words: list[str] | None = None) -> None:
    """Print the table, or JSON."""
    parser = Options(__doc__)
    parser.add("crystals", nargs="*", default=list(CRYSTALS), metavar="NAME")
    parser.add("--noise", nargs="+", type=float, default=list(LEVELS), help="eV/Å")
    parser.add("--seeds", type=int, default=10, help="of the noise, for error and coverage")
    parser.add("--json", action="store_true", help="print laws, error and coverage as JSON")
    given = parser.parse_args(words)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        found = study(given.crystals, given.noise, given.seeds)
    print(json.dumps(found, indent=1) if given.json else shown(found))


if __name__ == "__main__":
    sys.exit(exit_status(main))
