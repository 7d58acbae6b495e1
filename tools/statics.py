"""Equilibrium of atoms at 0 K: modified Newton, one sparse factorisation for many loads."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from tools.lammps_session import LammpsSession
from warp_peri.points.points import nearest
from warp_peri.solvers.systems import symmetric_factors

STEP = 1e-4
"""Half width of the central difference [Å]."""


class ColouredHessian:
    """Energy Hessian of atoms whose forces reach the second bonded neighbour.

    A Tersoff bond energy depends on the bonds next to it, so that moving an atom changes the
    forces on atoms up to two bonds away and on no other. Atoms more than four bonds apart have
    no such atom in common and are moved together; their columns are read from one difference.
    """

    def __init__(self, bonds: np.ndarray, atoms: int) -> None:
        """Colour so many atoms; `bonds`: each once, pairs of their numbers, shape [bonds, 2]."""
        i, j = np.concatenate([bonds, bonds[:, ::-1]]).T
        bonded = sp.csr_array((np.ones(len(i)), (i, j)), shape=(atoms, atoms))
        step = bonded + sp.eye_array(atoms, format="csr")
        reach = sp.csr_array(step @ step)
        reach.sort_indices()
        self._colour = _greedy_colours(sp.csr_array(reach @ reach))
        self._row = np.repeat(np.arange(atoms), np.diff(reach.indptr))
        self._column, self._starts = reach.indices.astype(int), reach.indptr
        self.colours = int(self._colour.max()) + 1
        self.atoms = atoms

    def __call__(
        self, forces: Callable[[np.ndarray], np.ndarray], positions: np.ndarray
    ) -> sp.csc_array:
        """Hessian −∂F/∂x [eV/Å²], symmetrised, shape [2A, 2A], degrees of freedom x₀ y₀ x₁ …

        `forces`: of the atoms [eV/Å] at positions [Å], shapes [A, 2], and where.
        """
        blocks = np.empty((len(self._row), 2, 2))
        for colour in range(self.colours):
            moved = self._colour == colour
            entries = np.flatnonzero(moved[self._column])
            for axis in range(2):
                shift = np.zeros_like(positions)
                shift[moved, axis] = STEP
                change = forces(positions - shift) - forces(positions + shift)
                blocks[entries, :, axis] = change[self._row[entries]] / (2 * STEP)
        size = 2 * self.atoms
        hessian = sp.bsr_array((blocks, self._column, self._starts), shape=(size, size))
        return sp.csc_array((hessian + hessian.T) / 2)


def _greedy_colours(conflict: sp.csr_array) -> np.ndarray:
    """The smallest colour free among the neighbours, node by node; shape [A]."""
    colour = np.full(conflict.shape[0], -1)
    starts = conflict.indptr
    for node in range(len(colour)):
        taken = set(colour[conflict.indices[starts[node] : starts[node + 1]]].tolist())
        free = 0
        while free in taken:
            free += 1
        colour[node] = free
    return colour


TOLERANCE = 1e-9
"""Largest force component left on an atom [eV/Å]."""

MAX_STEPS = 200
SLOW = 0.7
"""A step that leaves more than this share of the residual asks for a new factorisation."""
LARGEST_STRETCH = 0.2
"""No bond changes by more in one step, lest atoms collide far from any equilibrium [Å]."""

BOND_CUTOFF = 2.0
"""Between the first (1.46 Å) and second (2.53 Å) neighbour distance of graphene [Å]."""


class ConvergenceError(RuntimeError):
    """No equilibrium was found; the message names the load and the residual reached."""


@dataclass(frozen=True)
class AtomsAtRest:
    """Atoms at rest under a load.

    `displacement`: from the reference [Å], shape [A, 2]; no mean, and in a free body no mean
    rotation (Σ X × u = 0); `force`: the external load actually balanced [eV/Å], shape [A, 2];
    `residual`: largest component of internal plus external force [eV/Å]; `steps`: number of Newton
    steps.
    """

    displacement: np.ndarray
    force: np.ndarray
    residual: float
    steps: int


class Statics:
    """Atoms around a stress-free reference, and their equilibria under dead loads.

    `reference`: positions of the unloaded atoms [Å], shape [A, 2]; `bonds`: pairs of bonded atoms,
    shape [bonds, 2].
    """

    def __init__(
        self, positions: np.ndarray, *, box: tuple[float, float] | None, session: LammpsSession
    ) -> None:
        """Relax the atoms without load and factorise their Hessian.

        `positions`: [Å], shape [A, 2]; `box`: periods [Å], None for a free body; `session`: holds
        the same atoms. Raises ConvergenceError when no unloaded equilibrium is found.
        """
        self._session, self._box = session, box
        self.bonds = find_bonds(positions, box)
        self._hessian = ColouredHessian(self.bonds, len(positions))
        self.reference = np.array(positions, dtype=float)
        self._factor = self._factorise(self.reference)
        if np.abs(session.forces(self.reference)).max() > TOLERANCE:
            relaxed = self.equilibrium(np.zeros_like(self.reference), name="no load")
            self.reference = self.reference + relaxed.displacement
            self._factor = self._factorise(self.reference)
        self._length = self._bond_lengths(self.reference)

    def equilibrium(
        self, force: np.ndarray, *, name: str, guess: np.ndarray | None = None
    ) -> AtomsAtRest:
        """Displacement at which internal forces balance `force`.

        A rigid motion cannot be resisted: the part of the load that pushes or turns the body as
        a whole is taken out, in the deformed configuration.

        `force`: dead load on the atoms [eV/Å], shape [A, 2]; `name`: of the load, for messages;
        `guess`: displacement to start from [Å], shape [A, 2].

        Raises ConvergenceError when the residual does not fall below TOLERANCE.
        """
        u = np.zeros_like(self.reference) if guess is None else self._without_rigid_motion(guess)
        factor, fresh = self._factor, guess is None
        r, load = self._residual(u, force)
        for step in range(MAX_STEPS):
            if np.abs(r).max() <= TOLERANCE:
                return AtomsAtRest(u, load, float(np.abs(r).max()), step)
            du = self._without_rigid_motion(factor(r))
            stretch = np.linalg.norm(du[self.bonds[:, 1]] - du[self.bonds[:, 0]], axis=1).max()
            du *= min(1.0, LARGEST_STRETCH / stretch)
            part = 1.0
            trial, r_trial, load_trial, gain = self._try(u + du, force, r)
            if gain > SLOW and not fresh:
                factor, fresh = self._factorise(self.reference + u), True
                continue
            while not gain < 1 and part > 1e-3:
                part /= 2
                trial, r_trial, load_trial, gain = self._try(u + part * du, force, r)
            if not gain < 1:  # also when it is not a number
                break
            u, r, load, fresh = trial, r_trial, load_trial, False
        raise ConvergenceError(
            f"load '{name}': no equilibrium within {TOLERANCE:g} eV/Å after {step} steps, "
            f"residual {np.abs(r).max():.3g} eV/Å"
        )

    def linear_response(self, force: np.ndarray) -> np.ndarray:
        """Displacement [Å] of the atoms made linear about the reference, shapes [A, 2]."""
        return self._without_rigid_motion(self._factor(self._balanced(force, self.reference)))

    def max_bond_strain(self, displacement: np.ndarray) -> float:
        """Largest |ℓ/ℓ₀ − 1| over the bonds."""
        length = self._bond_lengths(self.reference + displacement)
        return float(np.abs(length / self._length - 1).max())

    def _try(
        self, u: np.ndarray, force: np.ndarray, before: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        r, load = self._residual(u, force)
        return u, r, load, float(np.linalg.norm(r) / np.linalg.norm(before))

    def _residual(self, u: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        positions = self.reference + u
        load = self._balanced(force, positions)
        return self._session.forces(positions) + load, load

    def _balanced(self, force: np.ndarray, positions: np.ndarray) -> np.ndarray:
        return settled(force, positions, self._box)

    def _without_rigid_motion(self, u: np.ndarray) -> np.ndarray:
        return settled(u, self.reference, self._box)

    def _factorise(self, positions: np.ndarray):
        """Solver of Hessian · du = r with the rigid motions pinned."""
        hessian = self._hessian(self._session.forces, positions)
        pinned = [0, 1]
        if self._box is None:
            # The atom farthest from the pinned one, across the line between the two.
            arm = positions - positions[0]
            far = int(np.argmax(np.abs(arm).max(axis=1)))
            pinned.append(2 * far + int(np.argmin(np.abs(arm[far]))))
        free = np.setdiff1d(np.arange(hessian.shape[0]), pinned)
        lu = symmetric_factors(hessian[free][:, free])

        def solve(r: np.ndarray) -> np.ndarray:
            du = np.zeros(r.size)
            du[free] = lu.solve(r.ravel()[free])
            return du.reshape(-1, 2)

        return solve

    def _bond_lengths(self, positions: np.ndarray) -> np.ndarray:
        arm = positions[self.bonds[:, 1]] - positions[self.bonds[:, 0]]
        return np.linalg.norm(nearest(arm, self._box), axis=1)


def find_bonds(positions: np.ndarray, box: tuple[float, float] | None) -> np.ndarray:
    """Pairs of atoms [Å], shape [A, 2], within BOND_CUTOFF of each other; shape [bonds, 2].

    `box` gives the periods [Å], each more than twice the cutoff; None for a free body.
    """
    inside = positions if box is None else np.mod(positions, box)
    return cKDTree(inside, boxsize=box).query_pairs(BOND_CUTOFF, output_type="ndarray")


def settled(
    field: np.ndarray, positions: np.ndarray, box: tuple[float, float] | None
) -> np.ndarray:
    """A field less its mean and, of a body without periods, its mean rotation; shapes [A, 2]."""
    field = field - field.mean(axis=0)
    if box is not None:
        return field
    arm = positions - positions.mean(axis=0)
    turn = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    return field - turn * (np.vdot(turn, field) / np.vdot(turn, turn))
