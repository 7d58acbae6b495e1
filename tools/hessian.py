"""Hessian of the atoms' energy from differences of forces, many columns at a time."""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

STEP = 1e-4
"""Half width of the central difference [Å]."""


class ColouredHessian:
    """Energy Hessian of atoms whose forces reach the second bonded neighbour.

    A Tersoff bond energy depends on the bonds next to it, so that moving an atom changes the
    forces on atoms up to two bonds away and on no other. Atoms more than four bonds apart have
    no such atom in common and are moved together; their columns are read from one difference.
    """

    def __init__(self, bonds: np.ndarray, atoms: int) -> None:
        """Colour the atoms.

        Args:
            bonds: each bond once, pairs of atom numbers, shape [bonds, 2].
            atoms: number of atoms A.
        """
        i, j = np.concatenate([bonds, bonds[:, ::-1]]).T
        bonded = sp.csr_array((np.ones(len(i)), (i, j)), shape=(atoms, atoms))
        step = bonded + sp.eye_array(atoms, format="csr")
        reach = sp.csr_array(step @ step)
        reach.sort_indices()
        self._colour = _greedy_colours(sp.csr_array(reach @ reach))
        self._row = np.repeat(np.arange(atoms), np.diff(reach.indptr))
        self._column = reach.indices.astype(int)
        self.colours = int(self._colour.max()) + 1
        self.atoms = atoms

    def __call__(
        self, forces: Callable[[np.ndarray], np.ndarray], positions: np.ndarray
    ) -> sp.csc_array:
        """Hessian −∂F/∂x [eV/Å²], symmetrised, shape [2A, 2A], degrees of freedom x₀ y₀ x₁ …

        Args:
            forces: of the atoms [eV/Å] at positions [Å], both of shape [A, 2].
            positions: where to take the Hessian [Å], shape [A, 2].
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
        a, b = np.meshgrid([0, 1], [0, 1], indexing="ij")
        rows = 2 * self._row[:, None, None] + a
        columns = 2 * self._column[:, None, None] + b
        size = 2 * self.atoms
        hessian = sp.csc_array((blocks.ravel(), (rows.ravel(), columns.ravel())), (size, size))
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
