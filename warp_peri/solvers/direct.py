"""A Dirichlet problem as matrices: one factorisation for any loads, collars and adjoints."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.errors import InputError

RESIDUAL = 1e-9
"""Largest ‖L u − b‖ / ‖b − collar part‖ that a solution may have."""
SYMMETRIC, PIVOT = 1e-12, 0.01
"""Rounding that symmetry may have; smallest pivot on the diagonal that is kept there."""
DENSE = 1500
"""Numbers of unknowns up to which eigenvalues are computed densely."""


def factorised(matrix: sp.csc_array) -> Any:
    """LU of a matrix; of a symmetric one by minimum degree, which has a third of the operations."""
    apart = abs(matrix - matrix.T)
    if apart.nnz and apart.max() > SYMMETRIC * abs(matrix).max():
        return splu(matrix)
    return symmetric_factors(matrix, PIVOT)


def symmetric_factors(matrix: sp.sparray | sp.spmatrix, pivot: float = 0.0) -> Any:
    """Sparse factors with pivots on the diagonal, down to a share of the largest of their column.
    Raises RuntimeError for a singular matrix."""
    options = {"SymmetricMode": True}
    how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": pivot, "options": options}
    return splu(sp.csc_matrix(matrix), **how)


def is_definite(factors: Any) -> bool:
    """Whether what symmetric_factors are of is positive definite: the signs of their pivots are
    those of its eigenvalues (Sylvester's law of inertia), unless rows were exchanged for a zero."""
    plain = np.array_equal(factors.perm_r, factors.perm_c)
    return plain and bool((factors.U.diagonal() > 0).all())


def definite_factors(matrix: sp.sparray | sp.spmatrix) -> Any:
    """The factors of a symmetric matrix where it is positive definite, else None."""
    try:
        factors = symmetric_factors(matrix)
    except RuntimeError:  # exactly singular
        return None
    return factors if is_definite(factors) else None


class MatrixProblem:
    """L u = b on the unknown nodes, u given on the collar (theory, 29).

    Args:
        L: the rows of the operator that belong to unknowns, of d components a node [TPa/Å²]:
            shape [d I, d N].
        interior: unknown nodes, shape [N] bool, or components of them, [N, d].
        factorise: of the unknowns' matrix; RuntimeError for one that is singular.

    Attributes:
        left: largest residual of the last answer, over the right-hand side.
    """

    def __init__(
        self,
        L: sp.csr_array,
        interior: np.ndarray,
        *,
        factorise: Callable[[sp.csc_array], Any] = factorised,
    ) -> None:
        self.unknown = np.repeat(interior.ravel(), L.shape[1] // interior.size)
        self.factorise, self.left = factorise, 0.0
        self.nodes = np.count_nonzero(interior.reshape(len(interior), -1).any(axis=1))
        self.stiffness = sp.csc_array(L[:, self.unknown])
        self.collar = sp.csr_array(L[:, ~self.unknown])
        # A tiny pivot solves its own row exactly: what rounding of L alone would leave counts too.
        self.rounding = np.finfo(float).eps * np.max(abs(L).sum(axis=1), initial=0.0)

    def right(self, b: np.ndarray, u: np.ndarray) -> np.ndarray:
        """b − L u of the collar [TPa/Å], one column a sample: shape [d I, S].

        Args:
            b: load, shape [S, N, d].
            u: displacement, same shape; that of the collar counts.
        """
        load, held = (field.reshape(len(field), len(self.unknown)) for field in (b, u))
        return np.asarray(load[:, self.unknown].T - self.collar @ held[:, ~self.unknown].T)

    @cached_property
    def factors(self) -> Any:
        """L_II factorised; InputError where it is singular."""
        try:
            return self.factorise(self.stiffness)
        except RuntimeError as error:
            raise InputError(
                f"the operator on these {self.nodes} nodes is singular: the model is "
                f"not well posed here ({error})"
            ) from None

    def inverse(self, right: np.ndarray, tolerance: float) -> np.ndarray:
        """L_II⁻¹ of a load on the unknown nodes [I, d]; exact, whatever the tolerance."""
        return np.asarray(self.factors.solve(right.ravel()).reshape(right.shape))

    def check(self, solution: np.ndarray, right: np.ndarray) -> None:
        """Raise InputError unless every column of the solution has a small residual."""
        wrong = np.linalg.norm(self.stiffness @ solution - right, axis=0)
        size = np.linalg.norm(right, axis=0)
        self.left = float(np.max(wrong / np.where(size > 0, size, np.inf), initial=0.0))
        wrong = np.maximum(wrong, self.rounding * np.linalg.norm(solution, axis=0))
        if not (wrong <= RESIDUAL * size).all():
            raise InputError(
                "the operator on these nodes is singular to working precision: "
                f"the residual of the solve is {wrong.max():.1e}"
            )

    def solve(self, b: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Displacement [Å], shape [S, N, d]: u on the collar, the solution elsewhere.

        Raises InputError for an operator that is singular, or nearly.
        """
        right = self.right(b, u)
        solution = self.factors.solve(right)
        self.check(solution, right)
        return self.filled(u, solution)

    def filled(self, u: np.ndarray, solution: np.ndarray) -> np.ndarray:
        """u with the columns of a solution on its unknown nodes."""
        flat = u.reshape(len(u), len(self.unknown)).copy()
        flat[:, self.unknown] = solution.T
        return flat.reshape(u.shape)


def smallest_eigenvalue(symmetric: sp.csc_array | LinearOperator) -> float:
    """Smallest eigenvalue of what is symmetric; dense for few unknowns."""
    if (size := symmetric.shape[0]) <= DENSE:
        return float(np.linalg.eigvalsh(symmetric @ np.eye(size))[0])
    found = eigsh(
        symmetric, 1, which="SA", tol=1e-6, ncv=80, v0=lanczos_start(size),
        return_eigenvectors=False,
    )  # fmt: skip
    return float(found[0])


def lanczos_start(size: int) -> np.ndarray:
    """A start of Lanczos iterations, shape [size], the same every time so that results repeat.

    It has no symmetry of the body's: ones would be orthogonal to half of a symmetric body's modes.
    """
    return np.random.default_rng(0).standard_normal(size)


def loose_pieces(
    x: np.ndarray, piece: np.ndarray, held: np.ndarray
) -> Iterator[tuple[np.ndarray, int, int]]:
    """Pieces of a body that what is held lets move rigidly: their nodes, how many of their rigid
    motions it stops, and how many they have, three in the plane and six in space.

    Args:
        x: positions [length], shape [N, d].
        piece: number of the piece of each node, shape [N].
        held: components that are given, shape [N, d] bool.
    """
    d = x.shape[1]
    turns = list(itertools.combinations(range(d), 2))
    for number in np.unique(piece):
        nodes = np.flatnonzero(piece == number)
        away = x[nodes] - x[nodes].mean(axis=0)
        away /= np.abs(away).max() or 1.0
        motions = np.zeros((len(nodes), d, d + len(turns)))
        motions[:, range(d), range(d)] = 1
        for turn, (a, b) in enumerate(turns, d):
            motions[:, a, turn], motions[:, b, turn] = -away[:, b], away[:, a]
        felt = motions[held[nodes]]
        rank = int(np.linalg.matrix_rank(felt, tol=1e-9)) if len(felt) else 0
        if rank < motions.shape[2]:
            yield nodes, rank, motions.shape[2]
