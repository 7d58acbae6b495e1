"""Linear systems by factors, conjugate gradients on one process or many, Newton with GMRES. With
the scalar products of `Inner` the answer has the same bits on any number of ranks."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy import ndarray
from numpy.linalg import eigvalsh, matrix_rank
from scipy.optimize import NoConvergence, newton_krylov
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.errors import InputError

RESIDUAL = 1e-9
"""Largest ‖L u − b‖ / ‖b − collar part‖ that a solution may have."""
ONE_WAY = 2.0**-40
"""Of the stiffness: what couples components one way, in which no row is then a pivot of others."""
SYMMETRIC, PIVOT = 1e-12, 0.01
"""Rounding that symmetry may have; smallest pivot on the diagonal that is kept there."""
DENSE = 1500
"""Numbers of unknowns up to which eigenvalues are computed densely."""
SMALLEST = np.finfo(float).tiny


def factorised(matrix: sp.csc_array) -> Any:
    """LU factors of a matrix; of a symmetric one by minimum degree, a third of the operations."""
    apart = abs(matrix - matrix.T)
    if apart.nnz and apart.max() > SYMMETRIC * abs(matrix).max():
        return splu(matrix)
    return symmetric_factors(matrix, PIVOT)


def symmetric_factors(matrix: sp.sparray | sp.spmatrix, pivot: float = 0.0) -> Any:
    """Sparse factors with pivots on the diagonal, down to a share `pivot` of the largest in their
    column; RuntimeError for a singular matrix."""
    return splu(
        sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=pivot,
        options={"SymmetricMode": True},
    )  # fmt: skip


def is_definite(factors: Any) -> bool:
    """Whether the matrix of symmetric_factors is positive definite, by the signs of its pivots
    (Sylvester's law of inertia), unless rows were exchanged for a zero."""
    plain = np.array_equal(factors.perm_r, factors.perm_c)
    return plain and bool((factors.U.diagonal() > 0).all())


def definite_factors(matrix: sp.sparray | sp.spmatrix) -> Any:
    """Factors of a symmetric matrix where it is positive definite, else None."""
    try:
        factors = symmetric_factors(matrix)
    except RuntimeError:  # exactly singular
        return None
    return factors if is_definite(factors) else None


class Balanced:
    """Factors of R K C, which solve with K. R and C are diagonals of powers of two, `rows` and
    `columns`: of components in units of their own they make the diagonals as large as the first
    component's, and what couples it to another as large both ways, for pivots and residuals are
    compared across them, or next to nothing where it does so one way: these are solved for apart
    from others, `apart` a mask of their unknowns. RuntimeError for a singular matrix."""

    def __init__(
        self, matrix: sp.csc_array, components: int, factorise: Callable[[sp.csc_array], Any] = splu
    ) -> None:
        parts, whole = [slice(n, None, components) for n in range(components)], abs(matrix)
        sizes = np.maximum([[whole[i, j].max() for j in parts] for i in parts], SMALLEST)
        into, back = sizes[0] > SMALLEST, sizes[:, 0] > SMALLEST
        own, first = sizes[0, 0] / sizes.diagonal(), sizes[0, 0]
        columns = np.sqrt(own * np.where(into & back, sizes[:, 0] / sizes[0], 1.0))
        columns = np.where(into & ~back, ONE_WAY * first / sizes[0], columns)
        columns = np.where(back & ~into, own * sizes[:, 0] / (ONE_WAY * first), columns)
        sides = np.exp2(np.rint(np.log2([own / columns, columns])))
        every = np.vstack([sides, into != back])
        self.rows, self.columns, apart = np.tile(every, matrix.shape[0] // components)
        self.apart = apart > 0
        scaled = sp.diags_array(self.rows) @ matrix @ sp.diags_array(self.columns)
        self.factors = factorise(scaled.tocsc())

    def solve(self, right: ndarray, way: str = "N") -> ndarray:
        """Solve K x = right, [n] or [n, S], or Kᵗ x = right the `way` "T"."""
        into, out = (self.rows, self.columns)[:: 1 if way == "N" else -1]
        return np.asarray((self.factors.solve((right.T * into).T, way).T * out).T)


class MatrixProblem:
    """Assembled problem L u = b on the unknown nodes, u given on the collar (theory, 29).

    Args:
        L: the operator's rows of unknowns, of d components a node [TPa/Å²]: shape [d I, d N].
        interior: unknown nodes, shape [N] bool, or components of them, [N, d].
        factorise: of the unknowns' matrix; RuntimeError for one that is singular.

    Attributes:
        left: largest residual of the last answer, over the right-hand side.
    """

    def __init__(
        self,
        L: sp.csr_array,
        interior: ndarray,
        *,
        factorise: Callable[[sp.csc_array], Any] = factorised,
    ) -> None:
        self.components, self.sizes = L.shape[1] // interior.size, abs(L)
        self.unknown = np.repeat(interior.ravel(), self.components)
        self.factorise, self.left = factorise, 0.0
        self.nodes = np.count_nonzero(interior.reshape(len(interior), -1).any(axis=1))
        self.stiffness = sp.csc_array(L[:, self.unknown])
        self.collar = sp.csr_array(L[:, ~self.unknown])

    @cached_property
    def factors(self) -> Balanced:
        """Factors of L_II; InputError where it is singular."""
        try:
            return Balanced(self.stiffness, self.components, self.factorise)
        except RuntimeError as error:
            raise InputError(
                f"the operator on these {self.nodes} nodes is singular: the model is "
                f"not well posed here ({error})"
            ) from None

    def solve(self, b: ndarray, u: ndarray) -> ndarray:
        """Displacement [Å], [S, N, d]: u on the collar, the solution elsewhere; InputError for an
        operator that is singular, or nearly, which leaves a residual."""
        load, field = (one.reshape(len(one), len(self.unknown)) for one in (b, u.copy()))
        right = load[:, self.unknown].T - self.collar @ field[:, ~self.unknown].T
        by, solution = self.factors, self.factors.solve(right)
        sums = by.rows * (self.sizes @ np.resize(by.columns, len(self.unknown)))
        off, self.left = self.stiffness @ solution - right, 0.0
        for own in filter(np.any, (by.apart, ~by.apart)):
            others = self.stiffness @ np.where(own, 0.0, solution.T).T  # which may cancel right
            parts = off.T * by.rows, right.T * by.rows, others.T * by.rows, solution.T / by.columns
            wrong, size, more, answer = (np.linalg.norm(part[:, own], axis=1) for part in parts)
            size += more
            each = wrong / np.where(size > 0, size, np.inf)
            self.left = float(each.max(initial=self.left))
            # A tiny pivot solves its own row exactly: what rounding of L alone would leave counts.
            rounding = np.finfo(float).eps * sums[own].max(initial=0.0) * answer
            if not ((wrong := np.maximum(wrong, rounding)) <= RESIDUAL * size).all():
                raise InputError(
                    "the operator on these nodes is singular to working precision: "
                    f"the residual of the solve is {wrong.max():.1e}"
                )

        field[:, self.unknown] = solution.T
        return field.reshape(u.shape)


def smallest_eigenvalue(symmetric: sp.csc_array | LinearOperator) -> float:
    """Smallest eigenvalue of a symmetric matrix or operator; dense for few unknowns."""
    if (size := symmetric.shape[0]) <= DENSE:
        return float(eigvalsh(symmetric @ np.eye(size))[0])
    return end_of_spectrum(symmetric, "SA", tol=1e-6, ncv=80)


def end_of_spectrum(symmetric: Any, which: str, **how: Any) -> float:
    """Eigenvalue by `scipy.sparse.linalg.eigsh`, from a start that is the same every time and
    without a body's symmetries."""
    start = np.random.default_rng(0).standard_normal(symmetric.shape[0])
    return float(eigsh(symmetric, 1, which=which, v0=start, return_eigenvectors=False, **how)[0])


def turns_of(x: ndarray) -> ndarray:
    """Small turns of positions x [n, d] about their middle, one a pair of axes, [n, d, turns]."""
    x, one = x - x.mean(axis=0), np.eye(x.shape[1])
    pairs = itertools.combinations(range(len(one)), 2)
    return np.stack([x[:, [b]] * one[a] - x[:, [a]] * one[b] for a, b in pairs], axis=-1)


def loose_pieces(x: ndarray, piece: ndarray, held: ndarray) -> Iterator[tuple[ndarray, int, int]]:
    """Iterate over pieces of a body that can still move rigidly: their nodes, how many rigid
    motions are stopped, and of how many (3 or 6). `piece` numbers the piece of each node, [N];
    `held` are components that are given, [N, d] bool."""
    for number in np.unique(piece):
        nodes = np.flatnonzero(piece == number)
        turns = turns_of(x[nodes])
        shifts = np.tile(np.eye(x.shape[1]), (len(nodes), 1, 1))
        motions = np.concatenate([shifts, turns / (np.abs(turns).max() or 1.0)], axis=2)
        felt = motions[held[nodes]]
        rank = int(matrix_rank(felt, tol=1e-9)) if len(felt) else 0
        if rank < motions.shape[2]:
            yield nodes, rank, motions.shape[2]


MOST_ITERATIONS = 1500
RESTARTS = 2
"""Times that a solve goes on from where the true residual was found too large."""
Field = Callable[[Any], Any]


class Inner(NamedTuple):
    """Scalar product, norm, largest absolute value of fields; u += a p in place."""

    dot: Callable[[Any, Any], float]
    norm: Callable[[Any], float]
    largest: Callable[[Any], float]
    add: Callable[[Any, float, Any], Any]


HERE = Inner(
    lambda a, b: float(np.vdot(a, b)),
    lambda a: float(np.linalg.norm(a)),
    lambda a: float(np.abs(a).max(initial=0.0)),
    lambda u, a, p: np.add(u, a * p, out=u),
)
"""Of arrays that this process has the whole of."""


def norm(field: Any, inner: Inner = HERE) -> float:
    """Norm ‖field‖, also where the squares of very small and very large values are no numbers."""
    largest = inner.largest(field)
    return largest and largest * inner.norm(field / largest)


@dataclass
class SolveRecord:
    """Iterations of a solve, and the true ‖L u − b‖ / ‖right-hand side‖ of its answer."""

    iterations: int = 0
    residual: float = 0.0


def definite(
    product: Field,
    precondition: Field,
    right: Any,
    tolerance: float,
    *,
    begin: Field | None = None,
    inner: Inner = HERE,
    where: str = "",
    hint: str = "",
) -> tuple[Any, SolveRecord]:
    """Solve L u = right by conjugate gradients to a true relative residual; also its record.

    `precondition` makes z ≈ L⁻¹ r, in memory of its own; `begin` where a search for L u = r starts,
    zero by default. A field is an array, or what else `inner` measures. Of messages, `where` says
    which nodes, and `hint` what to try. Raises InputError when a direction has no positive energy,
    or the search stalls above the tolerance.
    """
    record, largest, u = SolveRecord(), inner.largest(right), right - right
    if largest == 0:
        return u, record

    def descend(r: Any) -> Any:
        """Correction by the search, until the recursive residual meets the goal."""
        u, p, last = r - r if begin is None else begin(r), None, 1.0
        r = 1 * r if begin is None else r - product(u)
        while inner.norm(r) > 0.9 * tolerance * size and record.iterations < MOST_ITERATIONS:
            z = precondition(r)
            rz = inner.dot(r, z)
            if begin is not None and not rz > 0:
                break  # rounding of what the start answered, which the next start answers
            p = 1 * z if p is None else inner.add(z, rz / last, p)
            q = product(p)
            energy = inner.dot(p, q)
            if not (energy > 0 and rz > 0):
                shown = f"a direction has the energy {energy:.1e}"
                if energy > 0:
                    shown = f"the inverse of its waves answers a force with the work {rz:.1e}"
                raise InputError(f"the operator{where} is indefinite: {shown}")
            record.iterations += 1
            step, last = rz / energy, rz
            inner.add(u, step, p)
            inner.add(r, -step, q)
        return u

    right = right / largest  # squares of very small and very large loads are no numbers
    size, left = inner.norm(right), right
    for _ in range(1 + RESTARTS):
        u += descend(left)
        left = right - product(u)
        record.residual = inner.norm(left) / size
        if record.residual <= tolerance:
            return u * largest, record
        if record.iterations >= MOST_ITERATIONS:
            break
    raise InputError(
        f"the solve stalled: residual {record.residual:.1e} of the right-hand side after "
        f"{record.iterations} iterations, {tolerance:.1e} was asked for; the operator{where} is "
        f"nearly singular{hint}"
    )


MOST, VECTORS = 40, 30
"""Most steps of Newton's method, and most vectors of a step."""
APART = 1e-6
"""Difference that the derivative is taken over, relative to the field."""


def newton(residual: Field, start: ndarray, tolerance: float) -> ndarray:
    """Find a zero of a preconditioned residual, near the identity, as far as it comes."""
    size, last = HERE.largest(residual(start)), deque([start], maxlen=1)
    if not tolerance < size < np.inf:
        return start
    try:  # in parts of the first residual, for SciPy's differences have an absolute step
        newton_krylov(
            lambda v: residual(size * v) / size, start / size, rdiff=APART, method="gmres",
            inner_maxiter=VECTORS, maxiter=MOST, f_tol=tolerance / size, tol_norm=HERE.norm,
            callback=lambda v, _: last.append(size * v.reshape(start.shape)),
        )  # fmt: skip
    except InputError:
        raise
    except (NoConvergence, ValueError):  # also of a step to where there is no force
        pass
    return last.pop()
