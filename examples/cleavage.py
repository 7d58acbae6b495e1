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
from tools.graphene import THICKNESS, bond_length
from tools.options import Options
from warp_peri.atoms import named_calculator
from warp_peri.core.elastic import turned, voigt
from warp_peri.core.groups import point_group
from warp_peri.damage import BrittleCrystal, Cracked, CrystalBonds, box
from warp_peri.damage.slow_growth import apparent_toughness, cleaved
from warp_peri.errors import exit_status
from warp_peri.structures.learn import known_constants
from warp_peri.structures.rest import at_rest, cleavage_energy

REACH, HEIGHT = 3.0, 200.0
"""Of bonds in spacings, and of the strips between their held edges [Å]."""
MEASURED, CELLS, GROWTH = 16, (12, 24), 4
"""Heights in spacings of the strip that `spent` is of and of those predicted; spacings of growth."""
PLANE = np.ix_([0, 1, 5], [0, 1, 5])
"""Of a Voigt matrix, in plane strain."""
JOULE = 0.01
"""1 J/m² in TPa Å."""


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

    @property
    def turn(self) -> np.ndarray:
        """From the cell's axes to those of the nodes, [3, 3]."""
        return np.array(self.axes) / np.linalg.norm(self.axes, axis=1)[:, None]

    def atoms(self) -> tuple[np.ndarray, dict[tuple[int, ...], float]]:
        """C_ijkl along the cell's axes [TPa], and 2γ by plane [TPa Å]."""
        style, file = self.potential
        cell = self.built(self.guess)
        calculator = named_calculator(f"lammps:pair_style {style}", cell.symbols, file)
        rest = at_rest(cell, calculator)
        _, moduli, _ = known_constants(rest, calculator)
        share = len(cell) / len(rest.cell) * rest.cell.get_volume() / cell.get_volume()
        cell = self.built(self.guess * share ** (1 / 3))
        return moduli, {p: cleavage_energy(cell, calculator, p) for p in self.planes}

    def solid(self, spacing: float) -> BrittleCrystal:
        """The crystal in plane strain on nodes along its axes."""
        moduli, energies = self.atoms()
        elastic = voigt(turned(moduli, self.turn))[PLANE]
        normals, known = [], []
        for plane, energy in energies.items():
            images = point_group("m-3m", 3) @ (np.array(plane) / np.linalg.norm(plane))
            images = np.unique(np.round(images @ self.turn.T, 9) + 0.0, axis=0)
            for normal in images[np.abs(images[:, 2]) < 1e-6]:
                normals.append(normal[:2])
                known.append(energy)
        bonds = CrystalBonds((elastic + elastic.T) / 2, REACH * spacing)
        return BrittleCrystal(bonds, 1.0, np.array(normals), np.array(known))


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


def strips(solid: BrittleCrystal) -> dict[str, dict[str, float]]:
    """Loads of strips of one height on finer and finer nodes, over Griffith's.

    `load`: over that of the strip's own energies; `continuum`: over that of an elastic strip, of the
    height between the first held nodes; as strains ahead of the crack.
    """
    found = {}
    stiff = solid.model.tensor()[:, 1, :, 1]
    for cells in CELLS:
        h = HEIGHT / (cells + 1)
        finer = replace(solid, model=replace(solid.model, horizon=REACH * h))
        strip = cleaved(finer, h, cells=cells, length=GROWTH)
        load = strip.loads[2:].max()  # the crack runs on at the largest
        elastic = stiff[1, 1] * h**2 / (2 * HEIGHT)
        found[f"{HEIGHT:g} Å at {h:.3g} Å"] = {
            "load": load * np.sqrt(strip.release / solid.toughness),
            "continuum": load * np.sqrt(elastic / solid.toughness),
            "strain": load * h / HEIGHT,
        }
    return found


def held_and_run(solid: BrittleCrystal, spacing: float, cells: int = 12) -> dict[str, float]:
    """A strip in motion whose edges go on to a share of Griffith's load: by how far its crack runs.

    In spacings, of 24 ahead of it; and the share of the work that no energy of the ledger holds.
    """
    h, found = spacing, {}
    x = box((48 * h, (cells + 6) * h), h)
    held = np.abs(x[:, 1]) > cells * h / 2
    release = cleaved(solid, h, cells=cells, length=1).release
    unit = np.outer(np.sign(x[:, 1]) * held, (0, h / 2)) * np.sqrt(solid.toughness / release)
    crack = [[(-48 * h, 0.0), (0.0, 0.0)]]
    points = wp.Points(x, ~held, h)
    start = wp.solve(solid, Cracked(points, u=0.7 * unit, cracks=crack)).u
    step = 0.8 * solid.longest_step(h)
    slow = 40 * cells * h / np.sqrt(solid.model.elastic[2, 2] / solid.density)
    for share in (0.9, 1.1):
        grip = unit * (share - 0.7) / slow
        motion = wp.move(
            solid,
            Cracked(points, u=start, cracks=crack),
            step=step,
            steps=int(1.5 * slow / step),
            grip=grip,
            ramp=lambda t: float(t < slow),
            every=100,
        )
        near = np.abs(x[:, 1]) < h
        tip = x[near & (motion.details.damage > 0.3)]
        found[f"runs at {share:g}"] = float((tip[:, 0].max() / h if len(tip) else 0.0))
        work = max(abs(motion["work"]).max(), 1e-300)
        left = motion["work"] - motion["kinetic"] - motion["elastic"] - motion["dissipated"]
        found[f"missing at {share:g}"] = float(np.abs(left).max() / work)
    return found
