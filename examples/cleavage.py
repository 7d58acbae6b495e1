"""Crystals that cleave: bonds break at a stretch by direction, from energies of faces of atoms.

Moduli and energies of faces are those of LAMMPS atoms. A strip of the crystal, half of it cut along
a plane, is opened until the crack runs; beside it stands Griffith's load, at which the strip ahead
stores what the faces cost. Strain is plane, along an axis that the crystal is mirrored across.

python examples/cleavage.py           numbers, one a line
python examples/cleavage.py --json    the same as JSON
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import ase
import numpy as np
from ase.build import bulk, graphene

import warp_peri as wp
from examples.cracked_graphene import Continuum
from examples.studies.crack_directions import SMALL, crack
from tools.cracked_sheet import cracked_sheet, critical_strain, ideal_strength, opened
from tools.elastic import elastic_constants
from tools.graphene import THICKNESS, bond_length
from tools.options import Options
from warp_peri.atoms import named_calculator
from warp_peri.core.elastic import plane_isotropic, turned, voigt
from warp_peri.core.groups import point_group
from warp_peri.damage import BrittleCrystal, Cracked, CrystalBonds, box
from warp_peri.damage.slow_growth import apparent_toughness, cleaved, strip_release
from warp_peri.errors import exit_status
from warp_peri.structures.learn import known_constants
from warp_peri.structures.rest import at_rest, cleavage_energy

REACH, HEIGHT = 4.0, 200.0
"""Of bonds in spacings, and of the strips between their held edges [Å]."""
MEASURED, CELLS, GROWTH = 20, (16, 24, 32), 4
"""Heights in spacings, of the strip that `spent` is of and of those predicted; growth of these."""
HELD, RUN = 0.9, 1.05
"""Shares of Griffith's load that edges go to in motion."""
PREDICTED, SHORTER = (16, SMALL), (10, 16)
"""Cracks in sheets of graphene, and half their sides, in hexagons."""
PLANE = np.ix_([0, 1, 5], [0, 1, 5])
"""Of a Voigt matrix, in plane strain."""


@dataclass(frozen=True)
class Case:
    """A crystal and the plane that it cleaves on.

    `built`: its conventional cell by lattice parameter [Å], of which `guess` is one; `potential`:
    style and file of LAMMPS; `axes`: along the crack, across its plane, along its front; `planes`:
    whose energies are asked. Both are in Miller indices.
    """

    built: Callable[[float], ase.Atoms]
    guess: float
    potential: tuple[str, str]
    axes: tuple[tuple[int, int, int], ...]
    planes: tuple[tuple[int, int, int], ...]

    def atoms(self) -> tuple[np.ndarray, dict[tuple[int, int, int], float]]:
        """C_ijkl along the cell's axes [TPa], and 2γ by plane [TPa Å]."""
        style, file = self.potential
        cell = self.built(self.guess)
        calculator = named_calculator(f"lammps:pair_style {style}", cell.symbols, file)
        rest = at_rest(cell, calculator)
        moduli = np.asarray(known_constants(rest, calculator)[1])  # LAMMPS has stresses
        share = len(cell) / len(rest.cell) * rest.cell.get_volume() / cell.get_volume()
        cell = self.built(self.guess * share ** (1 / 3))
        return moduli, {p: cleavage_energy(cell, calculator, p) for p in self.planes}

    def solid(self) -> tuple[BrittleCrystal, dict[str, float]]:
        """The crystal in plane strain on nodes along its axes, and energies [J/m²] of its faces."""
        moduli, energies = self.atoms()
        turn = np.array(self.axes) / np.linalg.norm(self.axes, axis=1)[:, None]
        elastic = voigt(turned(moduli, turn))[PLANE]
        known = {}
        for plane, energy in energies.items():
            images = point_group("m-3m", 3) @ (np.array(plane) / np.linalg.norm(plane)) @ turn.T
            for normal in np.round(images[np.abs(images[:, 2]) < 1e-6], 9) + 0.0:
                known[tuple(normal[:2].tolist())] = energy
        shown = {"γ " + "".join(map(str, plane)): 50 * e for plane, e in energies.items()}
        return brittle((elastic + elastic.T) / 2, known), shown


def brittle(elastic: np.ndarray, known: dict[tuple[float, ...], float]) -> BrittleCrystal:
    """A crystal of these moduli [TPa] and energies of both faces by normal [TPa Å]."""
    solid = CrystalBonds(elastic, REACH * spacing_of(MEASURED))
    return BrittleCrystal(solid, 1.0, np.array(list(known)), np.array(list(known.values())))


def spacing_of(cells: int) -> float:
    """Of nodes of a strip [Å], HEIGHT between the first that are held."""
    return HEIGHT / (cells + 1)


CASES = {
    "Si {111}": Case(
        lambda a: bulk("Si", "diamond", a=a, cubic=True),
        5.43,
        ("sw", "Si.sw"),
        ((1, 1, -2), (1, 1, 1), (1, -1, 0)),
        ((1, 1, 1), (1, 1, 0), (0, 0, 1), (1, 1, 2), (1, 1, 3), (2, 2, 1)),
    ),
    "W {100}": Case(
        lambda a: bulk("W", "bcc", a=a, cubic=True),
        3.165,
        ("eam/alloy", "W_zhou.eam.alloy"),
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((1, 0, 0), (1, 1, 0), (2, 1, 0), (3, 1, 0), (3, 2, 0)),
    ),
}


def at_spacing(solid: BrittleCrystal, h: float) -> BrittleCrystal:
    """The same crystal for other nodes."""
    return replace(solid, model=replace(solid.model, horizon=REACH * h))


def strips(solid: BrittleCrystal) -> dict[str, float]:
    """Loads at which cracks run through strips of one height, over Griffith's, by spacing.

    Beside those of the strip's own energies stand loads over that of an elastic strip.
    """
    found, stiff = {}, solid.model.elastic[1, 1]
    for cells in CELLS:
        h = spacing_of(cells)
        strip = cleaved(at_spacing(solid, h), h, cells=cells, length=GROWTH)
        load = strip.loads[2:].max()
        elastic = stiff * h**2 / (2 * HEIGHT)
        name = f"load over Griffith's, {cells} spacings"
        found[name] = float(load * np.sqrt(strip.release / solid.toughness))
        found[f"{name}, continuum"] = float(load * np.sqrt(elastic / solid.toughness))
    return found


def moved(solid: BrittleCrystal, cells: int = CELLS[0]) -> dict[str, float]:
    """Strips in motion whose edges go slowly to a share of Griffith's load.

    How far the crack runs of what is ahead of it; and the largest share of the work that the ledger
    misses.
    """
    h, found, missing = spacing_of(cells), {}, 0.0
    solid, wide = at_spacing(solid, h), 4 * cells
    x = box((wide * h, (cells + 2 * REACH) * h), h)
    held = np.abs(x[:, 1]) > cells * h / 2
    unit = np.outer(np.sign(x[:, 1]) * held, (0, h / 2))
    unit *= np.sqrt(solid.toughness / strip_release(solid, h, cells=cells))
    points, crack = wp.Points(x, ~held, h), [[(-wide * h, 0.0), (0.0, 0.0)]]
    start = wp.solve(solid, Cracked(points, u=0.7 * unit, cracks=crack)).u
    step = 0.4 * solid.longest_step(h)
    slow = 40 * cells * h / np.sqrt(solid.model.elastic[2, 2] / solid.density)
    for share in (HELD, RUN):
        motion = wp.move(
            solid,
            Cracked(points, u=start, cracks=crack),
            step=step,
            steps=int(1.5 * slow / step),
            grip=unit * (share - 0.7) / slow,
            ramp=lambda time: float(time < slow),
            no_fail=held,
            every=100,
        )
        tip = x[(np.abs(x[:, 1]) < h) & (motion.details.damage > 0.3), 0].max(initial=0.0)
        found[f"run at {share:g}"] = float(tip / x[:, 0].max())
        spent = motion["kinetic"] + motion["elastic"] + motion["dissipated"]
        missing = max(missing, float(np.abs(motion["work"] / spent - 1).max()))
    return found | {"missing work": missing}


@dataclass(frozen=True)
class Opened:
    """A crack in a sheet of atoms as it opens, and what the continuum makes of it.

    `along`: "zigzag" or "armchair" rows; `long`, `half`: of the crack and the sheet, in hexagons.
    """

    along: str
    long: int
    half: int

    def strain_and_release(self) -> tuple[float, Callable[[float], float]]:
        """Strain of the atoms; G at unit strain of a toughness, Irwin's zone included (C17)."""
        bond = bond_length()
        step, constants = float(np.sqrt(3) * bond), elastic_constants(bond)
        turn = 30.0 * (self.along == "armchair")
        ends, half = crack(turn, self.long, step), self.half * step
        long = opened(cracked_sheet([ends], half=half, turned=turn), ends) / 2 / step
        strain = critical_strain([ends], 0.04, half=half, turned=turn)["strain"]
        strength = ideal_strength(along_zigzag=turn > 0)[0]
        sheet = Continuum(constants["lambda"], constants["mu"], step, self.half)
        release = sheet.release(self.half // 2 + 2)
        wide = constants["E"] / (2 * np.pi * strength**2) / step
        return strain, lambda toughness: release(long + wide * toughness)

    def spent(self, begin: float) -> float:
        """Toughness that makes the strain right."""
        strain, release = self.strain_and_release()
        for _ in range(50):
            begin = release(begin) * strain**2
        return begin


def of_sheets() -> dict[str, dict[str, float]]:
    """Graphene: strips along both kinds of rows, and cracks of 40 Å beside atoms.

    Predicted is what 2γ says; what atoms of a shorter crack along the same row spend, in a smaller
    sheet; and what they spend along zigzag rows, over 2γ, for both.
    """
    bond = bond_length()
    constants = elastic_constants(bond)
    cell = graphene(a=float(np.sqrt(3) * bond), vacuum=10)
    cell.pbc = True
    calculator = named_calculator("lammps:pair_style tersoff", cell.symbols, "SiC_1989.tersoff")
    first, second = (
        cleavage_energy(cell, calculator, plane, thickness=THICKNESS)
        for plane in ((1, 0, 0), (1, 1, 0))
    )
    found, fitted = {}, 1.0
    for along, own, other in (("zigzag", first, second), ("armchair", second, first)):
        angles = np.pi / 6 * np.arange(6)
        normals = np.round(np.column_stack([np.sin(angles), np.cos(angles)]), 9) + 0.0
        known = {tuple(n): (own, other)[k % 2] for k, n in enumerate(normals.tolist())}
        solid = brittle(plane_isotropic(constants["lambda"], constants["mu"]), known)
        numbers = {"2γ": 100 * own} | strips_of(solid)
        strain, release = Opened(along, *PREDICTED).strain_and_release()
        shorter = Opened(along, *SHORTER).spent(own) / own
        fitted = shorter if along == "zigzag" else fitted
        numbers |= {"strain, atoms": strain, "spent by a shorter crack, over 2γ": shorter}
        for name, share in (("", 1.0), (", shorter", shorter), (", shorter zigzag", fitted)):
            unit = float(np.sqrt(share * own / release(share * own)))
            numbers[f"error{name}"] = unit / strain - 1
        found[f"graphene {along}"] = numbers
    return found


def strips_of(solid: BrittleCrystal) -> dict[str, float]:
    """What a growing crack spends over 2γ, and all strips of the crystal that knows it."""
    spent = apparent_toughness(solid, spacing_of(MEASURED), cells=MEASURED)
    solid = replace(solid, spent=spent)
    return {"spent over 2γ": spent} | strips(solid) | moved(solid)


def main(args: list[str] | None = None) -> int:
    """Print the numbers."""
    options = Options(__doc__, json=True)
    options.add("--only", nargs="+", choices=[*CASES, "graphene"], help="of the crystals")
    given = options.parse_args(args)
    found, only = {}, given.only or [*CASES, "graphene"]
    for name, case in CASES.items():
        if name in only:
            began = time.perf_counter()
            solid, shown = case.solid()
            found[name] = shown | strips_of(solid) | {"seconds": time.perf_counter() - began}
    if "graphene" in only:
        found |= of_sheets()
    if given.json:
        print(json.dumps(found))
    else:
        for name, numbers in found.items():
            for what, value in numbers.items():
                print(f"{name}: {what} {value:.4g}")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
