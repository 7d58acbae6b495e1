"""How rim and bulk meet: alternating solves, and whole bodies in elements (B5–B7, B11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, gmres, splu

from warp_peri.errors import InputError
from warp_peri.fe_coupling.boundary_elements import BodyLoads, Rim, RimProblem
from warp_peri.fe_coupling.lattice_interior import Bulk

MOST_EXCHANGES = 100
ROUNDS = 3
"""Times that GMRES goes on from where the true mismatch was found too large."""
GOAL = 0.5
"""Share of the tolerance that GMRES aims at."""


class WholeBody:
    """Linear elements on every cell, factorised once.

    Were the bulk elements of the same kind, one exchange would be g ↦ M g + r with a matrix M for
    which (I − M)⁻¹ is a solve of the whole body: `correct`. What is left for GMRES is the
    difference between the bulk and those elements.

    Args:
        elements: all cells of the body's mesh, of degree 1.
        K: their stiffness [TPa], shape [d P, d P].
        loads: of the body.
        rim: its rim.
        depth: distance of the mesh's corners from the outline [Å], shape [P].
        collar: depth of the bulk's collar [Å].

    Attributes:
        guess: displacement of the rim's inner side [Å], shape [d G].
        correct: (I − M)⁻¹ of these elements, of a jump of the inner side; an operator [d G, d G].
    """

    def __init__(
        self,
        elements: Rim,
        K: sp.csr_array,
        loads: BodyLoads,
        rim: Rim,
        depth: np.ndarray,
        collar: float,
    ) -> None:
        given, fixed = (each.ravel() for each in loads.given(elements))
        problem, d = RimProblem(K, fixed), rim.d
        corner = np.full(len(rim.x), -1)
        corner[rim.corner_nodes] = rim.corners
        corner = corner[rim.inner]
        inside = np.setdiff1d(rim.corners, corner)
        shared, outer = inside[depth[inside] >= collar], inside[depth[inside] < collar]
        side, shared, outer = (
            (d * elements.corner_nodes[corners][:, None] + np.arange(d)).ravel()
            for corners in (corner[corner >= 0], shared, outer)
        )
        shared = shared[~fixed[shared]]
        rows = (d * np.flatnonzero(corner >= 0)[:, None] + np.arange(d)).ravel()
        K = sp.csr_array(K)
        overlap = splu(K[shared][:, shared].tocsc()) if len(shared) else None
        x = rim.x[rim.inner]
        trace = _vectors(elements.probe(x, rim.mesh.holding(x)), d)
        none = np.zeros(len(fixed))

        def correct(jump: np.ndarray) -> np.ndarray:
            moved, f = jump.ravel()[rows], none.copy()
            f[outer] = -K[outer][:, side] @ moved
            if overlap is not None:
                f[outer] += K[outer][:, shared] @ overlap.solve(K[shared][:, side] @ moved)
            return np.asarray(jump.ravel() + trace @ problem.solve(f, none))

        def transposed(jump: np.ndarray) -> np.ndarray:
            u, back = problem.solve(trace.T @ jump.ravel(), none)[outer], jump.ravel().copy()
            back[rows] -= K[side][:, outer] @ u
            if overlap is not None:
                back[rows] += K[side][:, shared] @ overlap.solve(K[shared][:, outer] @ u)
            return back

        self.guess = np.asarray(trace @ problem.solve(loads.on(elements).ravel(), given))
        self.correct = LinearOperator(2 * (x.size,), correct, transposed, dtype=float)


@dataclass
class Exchange:
    """What an exchange took, and how well both sides are solved at the end.

    Attributes:
        exchanges: solves of the rim, each with one of the bulk.
        mismatch: of the rim's inner side, relative: what the bulk hands back less what it was
            given.
        rim_residual: ‖K u − f‖ over the right-hand side, its inner side as the bulk has it.
        bulk_residual: ‖L u − b‖ over the right-hand side, its collar as the rim has it.
    """

    exchanges: int = 0
    mismatch: float = 0.0
    rim_residual: float = 0.0
    bulk_residual: float = 0.0


class Schwarz:
    """The two problems and what passes between them.

    One exchange is linear in the loads q = (f, given, b) and in the inner side g, which is among
    what is given: u = S (q + P g), and the bulk hands back g = R u. Both stiffnesses are their own
    transposes, and derivatives are the same exchange with Sᵗ, Rᵗ and Pᵗ (B12, B13).

    Args:
        rim: its problem; its inner side is among what is given.
        bulk: the other.
        inner: nodes of the rim's inner side, shape [G].
        to_rim: from unknown nodes of the bulk to these, shape [G, I].
        to_bulk: from nodes of the rim to the collar of the bulk, shape [C, n].
        whole: the body in linear elements, for what passes slowly.
    """

    def __init__(
        self,
        rim: RimProblem,
        bulk: Bulk,
        inner: np.ndarray,
        to_rim: sp.csr_array,
        to_bulk: sp.csr_array,
        whole: WholeBody,
    ) -> None:
        self.rim, self.bulk, self.inner, self.whole, self.to_bulk = rim, bulk, inner, whole, to_bulk
        self.d = bulk.points.dimension
        n, inside = len(rim.free), self.d * len(bulk.inside)
        places = (self.d * inner[:, None] + np.arange(self.d)).ravel()
        columns = np.arange(len(places))
        entries = np.ones(len(places)), (n + places, columns)
        self.place = sp.csr_array(entries, shape=(2 * n + inside, len(places)))
        nothing = sp.csr_array((len(places), n))
        self.read = sp.csr_array(sp.hstack([nothing, _vectors(to_rim, self.d)]))
        shape = (n + inside, 2 * n + inside)
        self.once = LinearOperator(shape, self._once, self._transposed, dtype=float)
        self.accuracy = 0.0
        """Of the bulk's solve in an exchange, as of `Bulk.solve`."""

    def _once(self, q: np.ndarray) -> np.ndarray:
        f, given, b = np.split(q.ravel(), [len(self.rim.free), 2 * len(self.rim.free)])
        of_rim = self.rim.solve(f, given)
        right = self._planes(b) - self.bulk.pull(self.to_bulk @ self._planes(of_rim))
        return np.append(of_rim, self.bulk.solve(right, self.accuracy))

    def _transposed(self, by: np.ndarray) -> np.ndarray:
        by_rim, by_bulk = np.split(by.ravel(), [len(self.rim.free)])
        by_b = self.bulk.solve(self._planes(by_bulk), self.accuracy)
        pushed = self.to_bulk.T @ self.bulk.push(by_b)
        return np.concatenate([*self.rim.transposed(by_rim - pushed.ravel()), by_b.ravel()])

    def _planes(self, values: np.ndarray) -> np.ndarray:
        return values.reshape(-1, self.d)

    def solve(
        self, f: np.ndarray, given: np.ndarray, b: np.ndarray, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray, Exchange]:
        """Displacement of rim [n, d] and bulk [I, d] that agree, and the record.

        Args:
            f: load on the rim [TPa Å], shape [n, d].
            given: displacement held on the rim [Å], shape [n, d].
            b: body force density on the unknown nodes [TPa/Å], shape [I, d].
            tolerance: of the mismatch.

        Raises InputError when they do not come to agree.
        """
        q = np.concatenate([f.ravel(), given.ravel(), b.ravel()])
        ways = self.once, self.place, self.read, self.whole.correct
        u, record = self._joined(*ways, q, self.whole.guess, tolerance)
        if not record.mismatch <= tolerance:
            raise InputError(
                f"rim and bulk do not agree: mismatch {record.mismatch:.1e} after "
                f"{record.exchanges} exchanges, {tolerance:.1e} was asked for"
            )
        of_rim, of_bulk = (self._planes(each) for each in np.split(u, [f.size]))
        right = b - self.bulk.pull(self.to_bulk @ of_rim)
        left = np.linalg.norm(right - self.bulk.apply(of_bulk))
        record.bulk_residual = float(left / (np.linalg.norm(right) or 1.0))
        whole = of_rim.copy()
        whole[self.inner] = self._planes(self.read @ u)
        record.rim_residual = self.rim.residual(f.ravel(), whole.ravel())
        return of_rim, of_bulk, record

    def transposed(
        self, by_rim: np.ndarray, by_bulk: np.ndarray, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The transpose of `solve`: derivatives by f, what is given and b, of ones by displacement.

        Args:
            by_rim: by the rim's displacement, shape [n, d].
            by_bulk: by that of the bulk's unknown nodes, shape [I, d].
            tolerance: as for `solve`.
        """
        by = np.append(by_rim, by_bulk)
        ways = self.once.T, self.read.T, self.place.T, self.whole.correct.T
        found, _ = self._joined(*ways, by, np.zeros(self.inner.size * self.d), tolerance)
        by_f, by_given, by_b = np.split(found, [by_rim.size, 2 * by_rim.size])
        return self._planes(by_f), self._planes(by_given), self._planes(by_b)

    def _joined(
        self,
        once: LinearOperator,
        place: sp.csr_array,
        read: sp.csr_array,
        correct: LinearOperator,
        q: np.ndarray,
        side: np.ndarray,
        tolerance: float,
    ) -> tuple[np.ndarray, Exchange]:
        """u = once (q + place g) with g = read u, by GMRES; correct is nearly (I − M)⁻¹ (B6, B11).

        Later vectors count for less and are worked out less closely.
        """
        record = Exchange()

        def exchange(q: np.ndarray) -> np.ndarray:
            record.exchanges += 1
            return np.asarray(once @ q)

        def left(v: np.ndarray) -> np.ndarray:
            step = correct @ v
            return np.asarray(step - read @ exchange(place @ step))

        for last in [False] * ROUNDS + [True]:
            self.accuracy = tolerance
            u = exchange(q + place @ side)
            off = read @ u - side
            size, whole = (float(np.linalg.norm(one)) for one in (off, side + off))
            record.mismatch = size / (whole or 1.0)
            if record.mismatch <= tolerance or last:
                break
            goal = GOAL * tolerance * whole
            self.accuracy = goal / size

            def loosen(residual: float, size: float = size, goal: float = goal) -> None:
                self.accuracy = min(1.0, goal / (residual * size)) if residual else 1.0

            matrix = LinearOperator(2 * (len(off),), left, dtype=float)
            how: dict[str, Any] = {"restart": MOST_EXCHANGES, "maxiter": 1, "callback": loosen}
            y, _ = gmres(matrix, off, rtol=0.0, atol=goal, callback_type="pr_norm", **how)
            side = side + correct @ y
        return u, record


def _vectors(matrix: sp.csr_array, d: int) -> sp.csr_array:
    """A matrix of values, for each component of vectors, shape [d m, d n]."""
    return sp.csr_array(sp.kron(matrix, np.eye(d)))
