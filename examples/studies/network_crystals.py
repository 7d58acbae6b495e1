"""Sixty crystals, and their elastic constants by tools that people use, ions relaxed.

Each tool is asked by its own way, on the calculator that it is given.
"""

import copy
import importlib
import os
from contextlib import suppress
from typing import Any

import ase.build
import numpy as np
from ase.filters import FrechetCellFilter
from ase.optimize import BFGS
from ase.spacegroup import crystal
from ase.units import GPa

import warp_peri as wp
from warp_peri.structures.learn import known_constants
from warp_peri.structures.phonons import edge_phonons
from warp_peri.structures.rest import at_rest

SYMMETRY = {"hcp": "hexagonal", "wurtzite": "hexagonal", "rutile": "tetragonal_high",
            "corundum": "trigonal_high"}  # fmt: skip
"""Of prototypes that are not cubic."""
GROUPS: dict[str, tuple[int, list[tuple[float, ...]]]] = {
    "rutile": (136, [(0, 0, 0), (0.305, 0.305, 0)]),
    "perovskite": (221, [(0, 0, 0), (0.5, 0.5, 0.5), (0.5, 0.5, 0)]),
    "L1_2": (221, [(0, 0, 0), (0.5, 0.5, 0)]),
    "corundum": (167, [(0, 0, 0.352), (0.306, 0, 0.25)]),
}
"""Space group and sites of what `ase.build.bulk` has not."""
PROTOTYPES = {
    "fcc": "Al Cu Ag Au Ni Pd Pt Ir Rh Ca Pb",
    "bcc": "Li Na K V Nb Ta Mo W Fe Cr",
    "hcp": "Mg Ti Zr Co Zn Ru Be",
    "diamond": "C Si Ge",
    "rocksalt": "MgO:4.21 NaCl:5.64 LiF:4.03 KCl:6.29 CaO:4.81 TiC:4.33 TiN:4.24 PbTe:6.46",
    "zincblende": "GaAs:5.65 ZnS:5.41 SiC:4.36 InP:5.87 BN:3.62",
    "wurtzite": "GaN:3.19:5.19 ZnO:3.25:5.21 AlN:3.11:4.98",
    "cesiumchloride": "CsCl:4.12 NiAl:2.89 CuZn:2.95",
    "fluorite": "CaF2:5.46 CeO2:5.41 SiMg2:6.35",
    "rutile": "TiO2:4.59:2.96 SnO2:4.74:3.19",
    "perovskite": "SrTiO3:3.91 KMgF3:3.99",
    "corundum": "Al2O3:4.76:12.99",
    "L1_2": "AlNi3:3.57 AuCu3:3.75",
}
"""Sixty crystals, chosen before any was tried, with edges [Å] that relaxation starts at."""
CRYSTALS: dict[str, tuple[Any, ...]] = {one.split(":")[0]: (kind, *map(float, one.split(":")[1:]))
            for kind, names in PROTOTYPES.items() for one in names.split()}  # fmt: skip
WIDTH, DISPLACED = 12.0, (0.01, 0.03, 0.06)
"""Of a supercell at least, and displacements of one atom, for phonons [Å]."""
VOIGT = [0, 4, 8, 5, 2, 1]
"""Places of xx, yy, zz, yz, xz, xy in a matrix."""
QUIET = 0.01
"""Forces [eV/Å] that the other tools relax to; matcalc's default is 0.1, without relaxed ions."""


def kind_of(name: str) -> str:
    """Symmetry of a crystal, as matscipy calls it."""
    return SYMMETRY.get(CRYSTALS[name][0], "cubic")


def structure(name: str) -> Any:
    """A crystal's cell in the axes of its conventional one."""
    kind, *edges = CRYSTALS[name]
    if kind not in GROUPS:
        known = {key: value for key, value in zip("ac", edges)}
        return ase.build.bulk(name, kind if edges else None, **known)
    group, sites = GROUPS[kind]
    a, c = edges[0], edges[-1]
    turn = 120 if group == 167 else 90
    symbols = list(dict.fromkeys(ase.Atoms(name).get_chemical_symbols()))
    cell = [a, a, c, 90, 90, turn]
    return crystal(symbols, sites, spacegroup=group, cellpar=cell, primitive_cell=True)


def needed(module: str, package: str) -> Any:
    """A module that this study needs and the library does not; InputError without it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise wp.InputError(f"{package}: expected it here; pip install {package}") from None


def by_matcalc(name: str, calculator: Any) -> dict[str, Any]:
    """Voigt matrix [GPa] by matcalc, ions relaxed; strains are its own, 1 and 6 %."""
    tool = needed("matcalc", "matcalc").ElasticityCalc(
        calculator, fmax=QUIET, relax_deformed_structures=True, units_GPa=True
    )
    return {"C": np.array(tool.calc(structure(name))["elastic_tensor"].voigt)}


def by_matscipy(name: str, calculator: Any) -> dict[str, Any]:
    """Voigt matrix [GPa] by matscipy, ions relaxed, five strains up to 1 %."""
    tool = needed("matscipy.elasticity", "matscipy")
    cell = structure(name)
    cell.calc = calculator
    moving: Any = FrechetCellFilter(cell)
    BFGS(moving, logfile=None).run(fmax=QUIET / 10, steps=200)
    how: dict[str, Any] = {"verbose": False, "graphics": False, "logfile": None, "fmax": QUIET}
    C, _ = tool.fit_elastic_constants(cell, kind_of(name), 5, 0.005, BFGS, **how)
    return {"C": np.array(C) / GPa}


def by_phonopy(name: str, calculator: Any) -> dict[str, Any]:
    """Waves of an even supercell, one atom displaced, for each of three steps.

    Their lowest frequency [THz], and the share of those at the zone's edge that lie within two of
    the errors that this library tells.
    """
    phonopy, rest, known = needed("phonopy", "phonopy"), at_rest(structure(name), calculator), None
    with suppress(wp.InputError):  # of an unstable crystal none are told
        known = edge_phonons(known_constants(rest, calculator)[0])
    cell = rest.cell
    heights = 1 / np.linalg.norm(np.linalg.inv(np.array(cell.cell)), axis=0)
    counts = 2 * np.ceil(WIDTH / 2 / heights).astype(int)
    small = phonopy.structure.atoms.PhonopyAtoms(
        numbers=cell.numbers, cell=np.array(cell.cell), positions=cell.positions
    )
    lowest, within = {}, {}
    for step in DISPLACED:
        one = phonopy.Phonopy(small, np.diag(counts), primitive_matrix=np.eye(3), log_level=0)
        one.generate_displacements(distance=step, is_plusminus=True)
        forces = []
        for moved in one.supercells_with_displacements:
            many = ase.Atoms(moved.numbers, positions=moved.positions, cell=moved.cell, pbc=True)
            many.calc = calculator
            forces.append(many.get_forces())
        one.forces = forces
        one.produce_force_constants()
        one.symmetrize_force_constants()
        one.run_mesh(counts, is_gamma_center=True)
        away = np.abs(one.mesh.qpoints).max(axis=1) > 0
        lowest[f"{step:g} Å"] = float(one.mesh.frequencies[away].min())
        if known:
            one.run_qpoints(known[2])
            off = np.abs(known[0] - one.qpoints.frequencies)
            within[f"{step:g} Å"] = float(np.mean(off <= 2 * known[1]))
    told = ", ".join(f"{value:.2f} THz by {step}" for step, value in lowest.items())
    told = f"lowest of {' x '.join(map(str, counts))} cells: {told}; within two errors: {within}"
    return {"why": told, "lowest": lowest, "within": within}


def by_lists(name: str, calculator: Any) -> dict[str, Any]:
    """Seconds for 32 cells of 2 × 2 × 2 by CHGNet's own function, one at a time and sixteen.

    The second list of sixteen has the memory of the first.
    """
    to_own, seconds = needed("pymatgen.io.ase", "chgnet").AseAtomsAdaptor.get_structure, []
    for size in (1, 16, 16):
        begin = os.times()
        cells = [to_own(structure(name).repeat(2)) for _ in range(32)]
        calculator.model.predict_structure(cells, batch_size=size)
        end = os.times()
        seconds.append(f"{end.user - begin.user:.1f} + {end.system - begin.system:.1f}")
    told = "user and system seconds: {} one at a time, {} by 16, {} again"
    return {"why": told.format(*seconds)}


def listed(calculator: Any) -> Any:
    """The same calculator, which gives CHGNet all strained cells as a list."""
    to_own = needed("pymatgen.io.ase", "chgnet").AseAtomsAdaptor.get_structure
    many = copy.copy(calculator)

    def calculate_many(cells: Any, _: Any) -> list[dict[str, Any]]:
        found = many.model.predict_structure([to_own(one) for one in cells])
        size = many.stress_weight
        return [{"forces": one["f"], "stress": size * one["s"].ravel()[VOIGT]} for one in found]

    many.calculate_many = calculate_many
    return many
