"""How far atoms bear a load: equilibria under a load that grows, to the last there is.

The potential's stock cut-off begins at 1.8 Å, where a bond is stretched by a quarter, and stiffens
it there. Here it begins at 2.2 Å, and pairs of one sublattice, which it might reach, are excluded:
up to 1.8 Å forces are the same to the last digits.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order

from tools.graphene import THICKNESS, area_per_atom
from tools.lammps_session import POTENTIAL, LammpsSession, potential_file
from tools.loads import Load, atom_force
from tools.samples import Piece, Sample
from tools.statics import ConvergenceError, Statics, find_bonds
from warp_peri.structures.calculators import LammpsError

MIDDLE, WIDTH = 2.3, 0.1
"""Middle and half width of the cut-off [Å]."""
FIRST_STEP, LAST_STEP = 0.05, 0.001
"""The load grows by shares of itself; where there is no equilibrium by half of that."""
LARGEST_CHANGE = 0.03
"""Of the largest bond strain in a step: more is another state, of atoms that have come apart."""
TOLERANCE = 1e-6
"""Largest force component left on an atom [eV/Å]."""


def longer_cutoff(folder: Path) -> Path:
    """The wheel's potential with the cut-off moved, one carbon, as a file in a folder."""
    for line in potential_file(POTENTIAL).read_text().splitlines():
        words = line.split()
        if words[:3] == ["C", "C", "C"]:
            words[13], words[14] = str(MIDDLE), str(WIDTH)
            path = folder / "carbon.tersoff"
            path.write_text(" ".join(words) + "\n")
            return path
    raise LookupError("the potential has no line for carbon")


def to_failure(body: Piece, load: Load, start: Sample) -> list[Sample]:
    """Equilibria under a load that grows, the last one within LAST_STEP of the largest load.

    Args:
        body: what carries the load; as many atoms of one sublattice as of the other.
        load: its own amplitude does not matter.
        start: an equilibrium under this load, which is not 0, no bond beyond the stock cut-off.

    Raises ConvergenceError when `start` is no equilibrium, ValueError for one without a load and
    for a body of unequal sublattices.
    """
    if not abs(start.amplitude) > 0:
        raise ValueError(f"start: expected one under a load, got {start.amplitude:g} TPa/Å")
    order = _alternating(find_bonds(start.reference, body.box), len(start.reference))
    reference = start.reference[order]
    shape = load.shape(reference, body.box)
    unit = atom_force(shape, area_per_atom(body.bond), THICKNESS)
    with tempfile.TemporaryDirectory() as folder:
        potential = longer_cutoff(Path(folder))
        elements = ("C", "C")
        with LammpsSession(
            reference, box=body.box, potential=potential, elements=elements
        ) as session:
            session.exclude_like_pairs()
            statics = Statics(reference, box=body.box, session=session)
            alike = replace(start, displacement=start.displacement[order])
            path = _path(statics, unit, alike, (MIDDLE - WIDTH) / body.bond - 1)
    back = np.argsort(order)
    return [
        replace(
            sample,
            reference=start.reference,
            displacement=sample.displacement[back],
            force=sample.force[back],
        )
        for sample in path
    ]


def _path(statics: Statics, unit: np.ndarray, start: Sample, most: float) -> list[Sample]:
    """Equilibria under unit times amplitudes that grow, bond strains up to `most`."""
    amplitude, step = start.amplitude, FIRST_STEP
    rest = statics.equilibrium(
        amplitude * unit, name="start", guess=start.displacement, tolerance=TOLERANCE
    )
    u, slope, path = rest.displacement, rest.displacement / amplitude, []
    reached = statics.max_bond_strain(u)
    while step > LAST_STEP:
        larger = amplitude * (1 + step)
        guess = u + slope * (larger - amplitude)
        try:
            rest = statics.equilibrium(
                larger * unit, name=f"{larger:g}", guess=guess, tolerance=TOLERANCE
            )
            stretch = statics.max_bond_strain(rest.displacement)
        except (ConvergenceError, LammpsError):
            stretch = np.inf
        if not stretch < min(most, reached + LARGEST_CHANGE):
            step /= 2
            continue
        slope = (rest.displacement - u) / (larger - amplitude)
        u, amplitude, reached = rest.displacement, larger, stretch
        path.append(Sample(statics.reference, u, rest.force, amplitude, stretch, rest.residual))
    return path


def _alternating(bonds: np.ndarray, atoms: int) -> np.ndarray:
    """Numbers of the atoms, those of the two sublattices in turn."""
    i, j = np.concatenate([bonds, bonds[:, ::-1]]).T
    bonded = sp.csr_array((np.ones(len(i)), (i, j)), shape=(atoms, atoms))
    order, before = breadth_first_order(bonded, 0, directed=False)
    second = np.zeros(atoms, dtype=bool)
    for atom in order[1:]:
        second[atom] = not second[before[atom]]
    halves = np.flatnonzero(~second), np.flatnonzero(second)
    if len(order) < atoms or len(halves[0]) != len(halves[1]):
        raise ValueError("atoms: expected one piece with as many atoms of either sublattice")
    return np.stack(halves, axis=1).ravel()
