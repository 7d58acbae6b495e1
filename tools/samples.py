"""Samples of atoms at rest under a load, solved in worker processes and kept in a cache."""

import hashlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tools.cache import digest, write_arrays
from tools.graphene import THICKNESS, area_per_atom, disk, sheet
from tools.lammps_session import LammpsSession
from tools.loads import Load, PatchLoad, RimLoad, atom_force
from tools.statics import TOLERANCE, AtomsAtRest, ConvergenceError, Statics
from warp_peri.atoms.calculators import LammpsError
from warp_peri.cli.main import hash_of

TRAINING_STRAIN = 0.02
"""Largest bond strain of every training sample (You et al. 2021, section 6)."""

STRAIN_TOLERANCE = 1e-5
CACHE_VERSION = 1


@dataclass(frozen=True)
class Piece:
    """What carries the load, and the potential that holds it together.

    `bond`: stress-free bond length [Å]; `potential`: Tersoff file; `cells`: four-atom cells of a
    periodic sheet along x and y, or; `radius`: of a free disk [Å]; exactly one of the two is given.
    """

    bond: float
    potential: str
    cells: tuple[int, int] | None = None
    radius: float | None = None

    @property
    def box(self) -> tuple[float, float] | None:
        """Periods of the sheet [Å]; a disk has none."""
        return None if self.cells is None else sheet(self.bond, cells=self.cells)[1]

    def positions(self) -> np.ndarray:
        """Atoms before any relaxation [Å], shape [A, 2]."""
        if self.cells is not None:
            return sheet(self.bond, cells=self.cells)[0]
        assert self.radius is not None
        return disk(self.bond, radius=self.radius)


@dataclass(frozen=True)
class Sample:
    """One body at rest under one load.

    `reference`: unloaded positions of the atoms [Å], shape [A, 2]; `displacement`: from the
    reference [Å], shape [A, 2]; `force`: external force on the atoms [eV/Å], shape [A, 2];
    `amplitude`: of the load [TPa/Å]; `max_bond_strain`: largest |ℓ/ℓ₀ − 1|; `residual`: largest
    component of the force left on an atom [eV/Å].
    """

    reference: np.ndarray
    displacement: np.ndarray
    force: np.ndarray
    amplitude: float
    max_bond_strain: float
    residual: float


def cache_file(cache: str | os.PathLike[str], body: Piece, load: Load) -> Path:
    """Where the sample lives: its name holds a hash of everything that determines it."""
    content = {
        "version": CACHE_VERSION,
        **body_record(body),
        "load": repr(load),
        "amplitude": getattr(load, "amplitude", TRAINING_STRAIN),
        "tolerances": [TOLERANCE, STRAIN_TOLERANCE],
    }
    name = re.sub(r"[^a-z0-9]+", "-", load.load_id).strip("-")
    return Path(cache) / f"{name}-{digest(content)}.npz"


@lru_cache
def body_record(body: Piece) -> dict[str, Any]:
    """What determines the forces between the atoms of a body, for the name of a cache file."""
    return {
        "lammps": version("lammps"),
        "potential": hash_of(Path(body.potential)),
        "positions": hashlib.sha256(body.positions().tobytes()).hexdigest(),
        "box": body.box,
        "thickness": THICKNESS,
    }


def solve_samples(body: Piece, loads: Sequence[Load], cache: str | os.PathLike[str]) -> list[Path]:
    """Solve `loads` on `body` and write each to the cache as soon as it is done.

    Returns their cache files. Raises LammpsError, FileNotFoundError for the potential,
    ConvergenceError naming the load, OSError when the cache cannot be written.
    """
    statics, paths = _statics(body), []
    for load in loads:
        sample = solve(body, statics, load)
        paths.append(cache_file(cache, body, load))
        write_arrays(paths[-1], vars(sample))
    return paths


def solve(body: Piece, statics: Statics, load: Load) -> Sample:
    """Equilibrium under a load; a WaveLoad is scaled until its bond strain is TRAINING_STRAIN."""
    shape = load.shape(statics.reference, body.box)
    unit = atom_force(shape, area_per_atom(body.bond), THICKNESS)
    try:
        if isinstance(load, PatchLoad | RimLoad):
            amplitude = load.amplitude
            rest = statics.equilibrium(amplitude * unit, name=load.load_id)
        else:
            amplitude, rest = _strained(statics, unit, load.load_id)
    except LammpsError as error:
        raise LammpsError(f"load '{load.load_id}': {error}") from None
    strain = statics.max_bond_strain(rest.displacement)
    return Sample(
        statics.reference, rest.displacement, rest.force, amplitude, strain, rest.residual
    )


def _strained(statics: Statics, unit: np.ndarray, name: str) -> tuple[float, AtomsAtRest]:
    """Amplitude and equilibrium at TRAINING_STRAIN; strain grows almost linearly with load."""
    linear = statics.linear_response(unit)
    small = 1e-6 / np.abs(linear).max()
    amplitude = TRAINING_STRAIN * small / statics.max_bond_strain(small * linear)
    guess, slope = amplitude * linear, TRAINING_STRAIN / amplitude
    before: tuple[float, float] | None = None
    for _ in range(20):
        rest = statics.equilibrium(amplitude * unit, name=name, guess=guess)
        strain = statics.max_bond_strain(rest.displacement)
        if abs(strain / TRAINING_STRAIN - 1) <= STRAIN_TOLERANCE:
            return amplitude, rest
        if before is not None:
            slope = (strain - before[1]) / (amplitude - before[0])
        before = amplitude, strain
        amplitude += (TRAINING_STRAIN - strain) / slope
        guess = rest.displacement * (amplitude / before[0])
    raise ConvergenceError(
        f"load '{name}': bond strain {strain:.6g} after 20 amplitudes, wanted {TRAINING_STRAIN}"
    )


@lru_cache(maxsize=2)
def _statics(body: Piece) -> Statics:
    """One factorisation per body and process, however many loads follow."""
    positions, box = body.positions(), body.box
    session = LammpsSession(positions, box=box, potential=body.potential)
    return Statics(positions, box=box, session=session)
