"""A framed graphene sheet with cracks, pulled to the fold: critical strains by LAMMPS at 0 K.

The potential's stock cut-off stiffens bonds just before they break and makes the sheet 2.8 times
too strong. Here the switch starts at 2.6 Å, and pairs of one sublattice, which the longer cut-off
would reach, are excluded; so are the bonds that a crack cuts.
"""

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.sparse.csgraph import breadth_first_order

from tools.graphene import THICKNESS, bond_length, sheet
from tools.lammps_session import CARBON_MASS, POTENTIAL, LammpsSession, potential_file
from tools.statics import ColouredHessian, find_bonds
from warp_peri import InputError
from warp_peri.statics.direct import symmetric_factors

SWITCH, WIDTH = 2.65, 0.05
"""Middle and half width of the cut-off [Å]; from 2.7 on atoms across a hexagon, 2.92 Å apart at
rest, stay strangers where the faces of a crack contract."""
FRAME = 7.0
"""Width of the rim whose displacement is given [Å]."""
HALF = 100.0
"""Half side of the square inside the rim [Å]."""
OPEN = SWITCH - WIDTH
"""A bond this long is broken [Å]."""
EV = 0.1602176634
"""1 eV/Å³ in TPa."""
PLACE = 1e-4
"""Largest force at rest [eV/Å]."""


def longer_cutoff(folder: Path, *, middle: float = SWITCH, width: float = WIDTH) -> Path:
    """The wheel's potential with the cut-off moved, one carbon, as a file in a folder.

    `folder`: to write to; `middle`: of the switch [Å]; `width`: half of the switch [Å].
    """
    for line in potential_file(POTENTIAL).read_text().splitlines():
        words = line.split()
        if words[:3] == ["C", "C", "C"]:
            words[13], words[14] = str(middle), str(width)
            path = folder / "carbon.tersoff"
            path.write_text(" ".join(words) + "\n")
            return path
    raise LookupError("the potential has no line for carbon")


@dataclass(frozen=True)
class CrackedSheet:
    """Atoms, what is held, and the bonds that cracks cut.

    `positions`: at rest [Å], shape [A, 2]; `bonds`: pairs of atoms, shape [bonds, 2]; `cut`: which
    bonds are cut, shape [bonds] bool; `held`: atoms of the rim, shape [A] bool; `step`: width of a
    hexagon along the zigzag direction [Å].
    """

    positions: np.ndarray
    bonds: np.ndarray
    cut: np.ndarray
    held: np.ndarray
    step: float


def cracked_sheet(
    cracks: Sequence[np.ndarray], *, half: ArrayLike = HALF, turned: float = 0.0
) -> CrackedSheet:
    """A rectangular sheet with straight cracks.

    `cracks`: ends of each [Å], shape [2, 2]; y = 0 runs through the middle of bonds when the crack
    runs along the zigzag direction, x = 0 midway between two of them; `half`: half sides of the
    part that moves [Å], one for a square, or two; `turned`: degrees from the zigzag direction to
    the x axis; 30 is the armchair direction.
    """
    bond = bond_length()
    step = np.sqrt(3) * bond
    inner = np.broadcast_to(np.asarray(half, float), 2)
    width = inner + FRAME
    reach = width if turned == 0 else np.full(2, np.hypot(*width))
    cells = (2 * int(reach[0] / step) + 8, 2 * int(reach[1] / (3 * bond)) + 8)
    positions, _ = sheet(bond, cells=cells)
    pairs = find_bonds(positions, None)
    middle = positions[pairs].mean(axis=1)
    upright = np.abs(np.diff(positions[pairs], axis=1)[:, 0, 0]) < 0.1
    centre = middle[upright][np.argmin((middle[upright] ** 2).sum(axis=1))]
    positions = positions - centre + (step / 2, 0.0)
    if turned:
        cos, sin = np.cos(np.radians(turned)), np.sin(np.radians(turned))
        positions = positions @ np.array([[cos, -sin], [sin, cos]])
    positions = positions[(np.abs(positions) < width).all(axis=1)]
    while True:  # atoms with one bond left, on the rim or along a slanted crack, are taken away
        pairs = find_bonds(positions, None)
        cut = np.zeros(len(pairs), bool)
        for start, end in cracks:
            cut |= _crossing(positions[pairs], np.asarray(start, float), np.asarray(end, float))
        enough = np.bincount(pairs[~cut].ravel(), minlength=len(positions)) >= 2
        if enough.all():
            break
        positions = positions[enough]
    return CrackedSheet(positions, pairs, cut, (np.abs(positions) > inner).any(axis=1), step)


def _crossing(ends: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Which bonds meet a segment."""
    place = _places(ends, start, end)
    crossing: np.ndarray = (place > 0) & (place < 1)
    return crossing


def _places(ends: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Where bonds meet the line of a segment, from 0 to 1 on it; NaN for those that do not."""
    along = end - start
    normal = np.array([-along[1], along[0]])
    height = (ends - start) @ normal
    share = height[:, 0] / (height[:, 0] - height[:, 1] + 1e-300)
    meet = ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])
    place: np.ndarray = (meet - start) @ along / (along @ along)
    return np.where(height[:, 0] * height[:, 1] < 0, place, np.nan)


def opened_ends(body: CrackedSheet, ends: np.ndarray) -> np.ndarray:
    """Ends of an open crack [Å], shape [2, 2]: midway from its last bond to the next whole one.

    The sheet may have the crack or not.

    Raises InputError for a crack that meets no bond, or all on its line to one side.
    """
    start, end = ends
    place = _places(body.positions[body.bonds], start, end)
    mine = place[(place > 0) & (place < 1)]
    whole = place[~body.cut & ~((place > 0) & (place < 1))]
    if not len(mine) or not (whole < mine.min()).any() or not (whole > mine.max()).any():
        raise InputError(f"crack {ends.tolist()}: expected to meet bonds, and some beyond")
    low = (mine.min() + whole[whole < mine.min()].max()) / 2
    high = (mine.max() + whole[whole > mine.max()].min()) / 2
    return np.array([start + low * (end - start), start + high * (end - start)])


def opened(body: CrackedSheet, ends: np.ndarray) -> float:
    """Length of an open crack [Å]; see opened_ends."""
    return float(np.linalg.norm(np.diff(opened_ends(body, ends), axis=0)))


class CutSession(LammpsSession):
    """Forces of a cracked sheet: pairs of one sublattice and cut bonds do not see each other.

    Types are sublattice × (no cut bond, above a crack, below it); pairs above–below are excluded,
    bonds around a tip that would be caught by it excepted, which is checked.
    """

    def __init__(self, body: CrackedSheet, potential: Path) -> None:
        positions = body.positions
        self.atoms, self._height_over_bar = len(positions), 0.0
        self._xyz = np.zeros((self.atoms, 3))
        self._xyz[:, :2] = positions
        types = 1 + _sublattice(body) + 2 * _sides(body)
        low, high = positions.min(axis=0) - 40, positions.max(axis=0) + 40
        pairs = [(a, b) for a in range(1, 7) for b in range(a, 7) if (a - b) % 2 == 0]
        before = (
            "atom_style atomic",
            "boundary f f p",
            f"region cell block {low[0]} {high[0]} {low[1]} {high[1]} -10 10",
            "create_box 6 cell",
            f"mass * {CARBON_MASS}",
        )
        after = (
            "pair_style tersoff",
            f'pair_coeff * * "{potential}" C C C C C C',
            "neighbor 0.05 bin",
            *(f"neigh_modify exclude type {a} {b}" for a, b in [*pairs, (3, 6), (4, 5)]),
            "thermo_modify lost error norm no",
        )
        self._fill(before, types.tolist(), after)


def _sublattice(body: CrackedSheet) -> np.ndarray:
    """0 or 1, so that every bond joins the two."""
    count = len(body.positions)
    i, j = np.concatenate([body.bonds, body.bonds[:, ::-1]]).T
    order, before = breadth_first_order(sp.csr_array((np.ones(len(i)), (i, j)), (count, count)), 0)
    colour = np.zeros(count, dtype=int)
    for atom in order[1:]:
        colour[atom] = 1 - colour[before[atom]]
    if (colour[body.bonds[:, 0]] == colour[body.bonds[:, 1]]).any():
        raise ValueError("sheet: a ring of odd length has no sublattices")
    return colour


def _sides(body: CrackedSheet) -> np.ndarray:
    """0 away from cracks, 1 above and 2 below them; raises ValueError for a bond caught by it."""
    ends = body.bonds[body.cut]
    side = np.zeros(len(body.positions), dtype=int)
    upper = body.positions[ends[:, 0], 1] > body.positions[ends[:, 1], 1]
    side[np.where(upper, ends[:, 0], ends[:, 1])] = 1
    side[np.where(upper, ends[:, 1], ends[:, 0])] = 2
    pairs = side[body.bonds]
    caught = (pairs.min(axis=1) == 1) & (pairs.max(axis=1) == 2) & ~body.cut
    if caught.any():
        raise ValueError(f"crack: {caught.sum()} bonds at its tips would be cut too; move its ends")
    return side


class Pulled:
    """Equilibria of a cracked sheet under a growing strain along y, the rim held to it."""

    def __init__(self, body: CrackedSheet, session: CutSession) -> None:
        self.body, self.session = body, session
        self._hessian = ColouredHessian(body.bonds, len(body.positions))
        self._free = np.repeat(~body.held, 2)
        self._factors: spla.SuperLU | None = None

    def factorise(self, x: np.ndarray) -> None:
        """Factors of the Hessian at x, kept if none of its eigenvalues is negative."""
        hessian = self._hessian(self.session.forces, x)
        factors = symmetric_factors(hessian[self._free][:, self._free])
        if self._factors is None or not (factors.U.diagonal() < 0).any():
            self._factors = factors

    def rest(self, x: np.ndarray, steps: int = 80) -> tuple[np.ndarray, bool]:
        """Atoms at rest downhill from x, the rim held, and whether they were found, none parted.

        Newton's method with old factors while they serve. A step that goes uphill is halved, eight
        times at most: a tip that snaps from one equilibrium to the next, a bond further open, is
        followed there.
        """
        x = x.copy()
        force, energy = self._pull(x)
        fresh = self._factors is None
        if fresh:
            self.factorise(x)
        for _ in range(steps):
            if self.longest(x) > OPEN:
                break
            if np.abs(force).max() < PLACE:
                return x, True
            assert self._factors is not None
            move = self._factors.solve(force)
            move *= min(1.0, 0.15 / np.abs(move).max())
            for _ in range(8):
                trial = x.copy()
                trial.reshape(-1)[self._free] += move
                after, level = self._pull(trial)
                if level < energy + 1e-11 * abs(energy):
                    break
                move = move / 2
            slow = np.linalg.norm(after) > 0.5 * np.linalg.norm(force)
            x, force, energy = trial, after, level
            if slow and not fresh:
                self.factorise(x)
            fresh = slow and not fresh
        return x, False

    def _pull(self, x: np.ndarray) -> tuple[np.ndarray, float]:
        """Forces on free atoms [eV/Å], flat, and the energy [eV]."""
        force = self.session.forces(x).ravel()[self._free]
        return force, self.session.energy()

    def longest(self, x: np.ndarray) -> float:
        """Longest bond that is not cut [Å]."""
        ends = x[self.body.bonds[~self.body.cut]]
        return float(np.hypot(*(ends[:, 1] - ends[:, 0]).T).max())

    def critical_strain(self, expected: float) -> tuple[float, float]:
        """The last strain at which the sheet held, and the one at which it did not.

        `expected`: a guess from below the truth is safe; steps are in parts of it.
        """
        rest, rim = self.body.positions, self.body.held
        x, strain, step = rest.copy(), 0.0, 0.6 * expected
        while step > 0.004 * expected:
            to = strain + step
            trial = rest + (x - rest) * (to / strain) if strain else rest * (1, 1 + to)
            trial[rim] = rest[rim] * (1, 1 + to)
            trial, at_rest = self.rest(trial)
            if at_rest:
                x, strain, step = trial, to, min(step, 0.08 * expected)
            else:
                step, self._factors = step / 2, None
        return strain, strain + 2 * step


def critical_strain(
    cracks: Sequence[np.ndarray], expected: float, *, half: ArrayLike = HALF, turned: float = 0.0
) -> dict[str, float]:
    """Critical strain of a sheet with cracks, and what it took."""
    began = time.perf_counter()
    body = cracked_sheet(cracks, half=half, turned=turned)
    with tempfile.TemporaryDirectory() as folder:
        potential = longer_cutoff(Path(folder))
        with CutSession(body, potential) as session:
            low, high = Pulled(body, session).critical_strain(expected)
    return {
        "strain": (low + high) / 2,
        "low": low,
        "high": high,
        "cut_bonds": int(body.cut.sum()),
        "atoms": len(body.positions),
        "seconds": time.perf_counter() - began,
    }


def finished(path: Path, *figures: str) -> dict[str, dict[str, Any]]:
    """Sheets that earlier runs wrote to a file; those without all of the figures are left out.

    Raises InputError for a file that is none of theirs.
    """
    if not path.exists():
        return {}
    try:
        sheets = json.loads(path.read_text(encoding="utf-8"))
        return {name: sheet for name, sheet in sheets.items() if {*figures} <= {*sheet}}
    except (ValueError, AttributeError, TypeError) as error:
        raise InputError(f"{path}: expected sheets that were pulled before ({error})") from None


def ideal_strength(*, step: float = 0.01, along_zigzag: bool = False) -> tuple[float, float]:
    """Largest stress of a whole sheet under uniaxial strain [TPa], and the strain there.

    The sheet is pulled across its zigzag rows, as cracks along them are opened, or along them, as
    armchair cracks are; its width is kept, sublattices are free to shift.
    """
    bond = bond_length()
    best = (0.0, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        potential = longer_cutoff(Path(folder))
        for strain in np.arange(step, 0.4, step):
            stress = _uniaxial_stress(bond, float(strain), potential, 0 if along_zigzag else 1)
            if stress < best[0]:
                break
            best = (stress, float(strain))
    return best


def _uniaxial_stress(bond: float, strain: float, potential: Path, axis: int) -> float:
    """σ along an axis [TPa] of a periodic sheet strained along it, one sublattice at rest."""
    positions, box = sheet(bond, cells=(4, 3))
    growth = np.ones(2)
    growth[axis] += strain
    stretched, sides = positions * growth, (box[0] * growth[0], box[1] * growth[1])
    with LammpsSession(stretched, box=sides, potential=potential, elements=("C", "C")) as session:
        session.exclude_like_pairs()

        def pull(shift: float) -> float:
            moved = stretched.copy()
            moved[::2, 1] += shift
            return float(session.forces(moved)[::2, 1].mean())

        reach = 0.1 + bond * abs(strain) * axis
        brentq(pull, -reach, reach, xtol=1e-8)
        stress = session.membrane_stress()[axis, axis]
    return float(stress * EV / THICKNESS)
