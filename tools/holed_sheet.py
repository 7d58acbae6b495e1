"""Graphene with free edges at rest under loads: plates with a hole, strips; edges' stiffness.

Every sample is kept as soon as it is done, so that an interrupted run goes on where it was.
"""

import hashlib
import json
import os
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from tqdm import tqdm

from tools.graphene import THICKNESS, _crystal, area_per_atom, bond_length
from tools.lammps_session import POTENTIAL, LammpsSession
from tools.loads import atom_force
from tools.options import Options
from tools.samples import Sample, file_hash, read_record, write_record
from tools.statics import TOLERANCE, Statics, find_bonds
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.sources.coarse_graining import EV_PER_CUBIC_ANGSTROM
from warp_peri.structures.calculators import potential_file

TENSION = 0.005
"""Far from the hole, and about the stress that waves make [TPa]."""
GRIP = 10.0
"""Width of what is pulled at each end [Å]."""
CALM = (10.0, 20.0)
"""Distance from edges below which a wave pushes nothing, and beyond which all of it [Å]."""
WAVES = (110.0, 80.0, 40.0)
"""Lengths of the waves [Å]; the last ones push edges as well."""
SEED = 7
RECIPE = 3
"""Of the loads: what was made by another is made again."""
STRAIN = 1e-3
"""Of strips whose edges' stiffness is measured."""
STRIPS = (40.0, 80.0)
"""Their widths [Å]."""


@dataclass(frozen=True)
class Plate:
    """A rectangle of graphene with a round hole in the middle, the zigzag direction along x.

    `half`: half of its sides [Å]; `radius`: of the hole [Å]; 0 for none.
    """

    half: tuple[float, float]
    radius: float = 0.0

    @property
    def name(self) -> str:
        """The name in the files of the cache."""
        sides = f"{2 * self.half[0]:g}x{2 * self.half[1]:g}"
        return f"{sides}-hole-{self.radius:g}" if self.radius else sides

    def positions(self, bond: float) -> np.ndarray:
        """Atoms before any relaxation [Å], shape [A, 2], none with fewer than two neighbours.

        The origin is the centre of a hexagon.
        """
        cells = np.ceil(np.divide(self.half, (np.sqrt(3) * bond, 3 * bond))).astype(int) + 1
        x, _ = _crystal(bond, (2 * int(cells[0]), 2 * int(cells[1])))
        x = x[(np.abs(x) < self.half).all(axis=1) & (np.hypot(*x.T) > self.radius)]
        while True:
            enough = np.bincount(find_bonds(x, None).ravel(), minlength=len(x)) >= 2
            if enough.all():
                return x
            x = x[enough]

    def effective_radius(self, bond: float) -> float:
        """Radius of the disk whose area is that of the atoms missing in the hole [Å]."""
        missing = len(Plate(self.half).positions(bond)) - len(self.positions(bond))
        return float(np.sqrt(missing * area_per_atom(bond) / np.pi))

    def effective_height(self, bond: float) -> float:
        """Half the height [Å] of the rectangle whose area is that of the atoms of a strip."""
        x = self.positions(bond)
        period = np.sqrt(3) * bond
        count = int(self.half[0] / period) - 2
        inside = np.count_nonzero((x[:, 0] >= -count * period) & (x[:, 0] < count * period))
        return float(inside * area_per_atom(bond) / (4 * count * period))

    def edge_distance(self, x: np.ndarray) -> np.ndarray:
        """Distance of positions to the nearest edge [Å], shape [n]."""
        inward = (np.array(self.half) - np.abs(x)).min(axis=1)
        return np.minimum(inward, np.hypot(*x.T) - self.radius) if self.radius else inward


@dataclass(frozen=True)
class EndsPulled:
    """Tension along one axis: the ends of a plate are pulled apart."""

    axis: int
    tension: float = TENSION

    @property
    def name(self) -> str:
        """The name in the files of the cache."""
        return f"pull-{'xy'[self.axis]}"

    def density(self, plate: Plate, x: np.ndarray) -> np.ndarray:
        """Body force density [TPa/Å] at positions, both of shape [n, 2]."""
        b = np.zeros_like(x)
        along = x[:, self.axis]
        gripped = np.abs(along) > plate.half[self.axis] - GRIP
        b[gripped, self.axis] = np.sign(along[gripped]) * self.tension / GRIP
        return b


@dataclass(frozen=True)
class Wave:
    """A wave of body force in a direction, with a phase and a polarisation, drawn by its number."""

    number: int
    tension: float = TENSION

    @property
    def name(self) -> str:
        """The name in the files of the cache."""
        return f"wave-{self.number}"

    def density(self, plate: Plate, x: np.ndarray) -> np.ndarray:
        """Body force density [TPa/Å] at the atoms, both of shape [n, 2].

        None beside edges, but of the shortest waves, which push them like everything else.

        What pushes or turns the plate as a whole is taken out where the wave pushes, not at edges.
        """
        length = WAVES[self.number % len(WAVES)]
        way, phase, axis = np.random.default_rng((SEED, self.number)).uniform(0, 2 * np.pi, 3)
        k = 2 * np.pi / length
        size = self.tension * k * np.cos(k * (x @ (np.cos(way), np.sin(way))) + phase)
        s = np.clip((plate.edge_distance(x) - CALM[0]) / (CALM[1] - CALM[0]), 0, 1)
        share = (s**2 * (3 - 2 * s))[:, None]
        if length == WAVES[-1]:
            share = np.ones_like(share)
        b = share * size[:, None] * (np.cos(axis), np.sin(axis))
        turn = np.stack([-x[:, 1], x[:, 0]], axis=1)
        motions = [np.broadcast_to((1.0, 0.0), x.shape), np.broadcast_to((0.0, 1.0), x.shape), turn]
        sums = [[np.vdot(v, share * w) for w in motions] for v in motions]
        weights = np.linalg.solve(sums, [np.vdot(v, b) for v in motions])
        return b - share * sum(weight * v for weight, v in zip(weights, motions))


Load = EndsPulled | Wave

HOLES = (Plate((120.0, 120.0), 25.0), Plate((120.0, 120.0), 40.0))
STRIP = Plate((120.0, 50.0))


def loads_of(
    plate: Plate, tension: float = TENSION, waves: Sequence[int] = tuple(range(len(WAVES)))
) -> tuple[Load, ...]:
    """What a plate is loaded by: pulls, and waves by number; stresses are about a tension [TPa]."""
    pulls = (
        (EndsPulled(0, tension), EndsPulled(1, tension))
        if plate.radius
        else (EndsPulled(0, tension),)
    )
    return (*pulls, *(Wave(number, tension) for number in waves))


def held_samples(
    cache: str | os.PathLike[str],
    *,
    plates: Sequence[Plate] = (*HOLES, STRIP),
    tension: float = TENSION,
    waves: Sequence[int] = tuple(range(len(WAVES))),
    progress: bool,
) -> dict[Plate, list[Sample]]:
    """Plates at rest under their loads, from the cache or solved, in the order of `loads_of`.

    Raises LammpsError, ConvergenceError naming the load, OSError when the cache cannot be written.
    """
    cache = Path(cache)
    cache.mkdir(parents=True, exist_ok=True)
    bond, potential = bond_length(), potential_file(POTENTIAL)
    samples: dict[Plate, list[Sample]] = {}
    count = sum(len(loads_of(plate, tension, waves)) for plate in plates)
    with locked(cache), tqdm(total=count, disable=not progress) as bar:
        for plate in plates:
            loads = loads_of(plate, tension, waves)
            files = {load: _file(cache, plate, load, bond, potential) for load in loads}
            kept = {load: read_record(file, Sample) for load, file in files.items()}
            missing = [load for load in files if kept[load] is None]
            bar.update(len(files) - len(missing))
            if missing:
                statics = _at_rest(plate, bond)
            for load in missing:
                sample = kept[load] = _sample(statics, plate, load, bond)
                write_record(files[load], sample)
                bar.update()
            samples[plate] = [sample for sample in kept.values() if sample is not None]
    return samples


def _at_rest(plate: Plate, bond: float) -> Statics:
    """The plate with its edges relaxed."""
    x = plate.positions(bond)
    return Statics(x, box=None, session=LammpsSession(x, box=None))


def _sample(statics: Statics, plate: Plate, load: Load, bond: float) -> Sample:
    """Equilibrium under one load."""
    density = load.density(plate, statics.reference)
    force = atom_force(density, area_per_atom(bond), THICKNESS)
    rest = statics.equilibrium(force, name=f"{plate.name} {load.name}")
    strain = statics.max_bond_strain(rest.displacement)
    amplitude = float(np.abs(density).max())
    return Sample(
        statics.reference, rest.displacement, rest.force, amplitude, strain, rest.residual
    )


def _file(cache: Path, plate: Plate, load: Load, bond: float, potential: Path) -> Path:
    """Where a sample lies: its name holds a hash of everything that determines it."""
    content = {
        "lammps": version("lammps"),
        "potential": file_hash(potential),
        "bond": bond,
        "plate": repr(plate),
        "load": [repr(load), GRIP, CALM, WAVES, SEED, RECIPE],
        "tolerance": TOLERANCE,
    }
    key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    return cache / f"{re.sub(r'[^a-z0-9]+', '-', plate.name)}-{load.name}-{key}.npz"


def edge_constants(*, armchair: bool) -> dict[str, float]:
    """Stiffness and tension of an edge of a strip, its atoms relaxed, from two widths.

    The force in a periodic strip of width W, the area of its atoms over its length, is
    F = W σ + 2 τ: what does not grow with W belongs to the edges.

    `armchair`: edges along the armchair direction instead of the zigzag direction.

    Returns: `E` of the sheet [TPa], `stiffness` dτ/dε and `tension` τ of one edge [TPa Å], all for
    the thickness THICKNESS.
    """
    bond = bond_length()
    widths, slopes, tensions = [], [], []
    for width in STRIPS:
        minus, rest, plus = (_strip(bond, width, s, armchair=armchair) for s in (-1, 0, 1))
        widths.append(rest[0])
        slopes.append((plus[1] - minus[1]) / (2 * STRAIN))
        tensions.append(rest[1])
    E = (slopes[1] - slopes[0]) / (widths[1] - widths[0])
    return {
        "E": float(E),
        "stiffness": float(slopes[0] - E * widths[0]) / 2,
        "tension": float(np.mean(tensions)) / 2,
    }


def _strip(bond: float, width: float, sign: int, *, armchair: bool) -> tuple[float, float]:
    """Width [Å], and force over the thickness [TPa Å], of a strip at sign · STRAIN."""
    count = 2 * int(width / bond / 3) + 4
    x, period = _crystal(bond, (count, 4) if armchair else (4, count))
    length = period[1 if armchair else 0]
    if armchair:
        x = x[:, ::-1]
    x = x[np.abs(x[:, 1]) < width / 2]
    while True:
        box = (float(length), float(width + 30))
        enough = np.bincount(find_bonds(x, box).ravel(), minlength=len(x)) >= 2
        if enough.all():
            break
        x = x[enough]
    stretched = x * (1 + sign * STRAIN, 1.0)
    box = (box[0] * (1 + sign * STRAIN), box[1])
    with LammpsSession(stretched, box=box) as session:
        statics = Statics(stretched, box=box, session=session)
        session.forces(statics.reference)
        force = session.membrane_stress()[0, 0] * box[1]
    thick = EV_PER_CUBIC_ANGSTROM / THICKNESS
    return len(x) * area_per_atom(bond) / length, float(force * thick)


def main(arguments: list[str] | None = None) -> int:
    """Command line: make what is missing."""
    parser = Options(__doc__)
    parser.add("--cache", type=Path, default=Path("data/holes"), metavar="FOLDER")
    parser.add("--quiet", action="store_true", help="no progress bar")
    parser.add("--tension", type=float, default=TENSION, help="about the stress [TPa]")
    given = parser.parse_args(arguments)

    def work() -> None:
        held_samples(given.cache, tension=given.tension, progress=not given.quiet)
        print(given.cache)

    kept = "finished samples are kept and the next run goes on"
    return exit_status(work, kept, name="holed_sheet")


if __name__ == "__main__":
    sys.exit(main())
