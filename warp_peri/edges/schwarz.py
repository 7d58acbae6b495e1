"""How rim and bulk meet: alternating solves, and whole bodies in elements (B5–B7, B11)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, gmres, splu

from warp_peri.edges.bulk import Bulk
from warp_peri.edges.rim import BodyLoads, Rim, RimProblem
from warp_peri.errors import InputError


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
        self.elements, self.loads = elements, loads
        self.given, fixed = loads.given(elements)
        self.problem = RimProblem(K, fixed.ravel())
        is_corner = np.full(len(rim.x), -1)
        is_corner[rim.corner_nodes] = rim.corners
        corner = is_corner[rim.inner]
        self.rows = np.flatnonzero(corner >= 0)
        """Of the inner side's nodes those that are corners."""
        side = corner[self.rows]
        inside = np.setdiff1d(rim.corners, side)
        shared, outer = inside[depth[inside] >= collar], inside[depth[inside] < collar]
        side, shared, self.outer = (
            (rim.d * elements.corner_nodes[corners][:, None] + np.arange(rim.d)).ravel()
            for corners in (side, shared, outer)
        )
        shared = shared[~fixed.ravel()[shared]]
        K = sp.csr_array(K)
        self.overlap = splu(K[shared][:, shared].tocsc()) if len(shared) else None
        self.from_side = K[shared][:, side]
        self.to_outer = K[self.outer][:, shared]
        self.past = K[self.outer][:, side]
        x = rim.x[rim.inner]
        self.trace = elements.probe(x, rim.mesh.holding(x))

    def guess(self) -> np.ndarray:
        """Displacement of the rim's inner side [Å], shape [G, d]."""
        f = self.loads.on(self.elements)
        u = self.problem.solve(f.ravel(), self.given.ravel()).reshape(f.shape)
        return np.asarray(self.trace @ u)

    def correct(self, jump: np.ndarray) -> np.ndarray:
        """(I − M)⁻¹ of these elements, of a jump of the inner side, both of shape [G, d]."""
        side = jump[self.rows].ravel()
        pull = -self.past @ side
        if self.overlap is not None:
            pull += self.to_outer @ self.overlap.solve(self.from_side @ side)
        f = np.zeros(self.elements.x.size)
        f[self.outer] = pull
        u = self.problem.solve(f, np.zeros_like(f)).reshape(self.elements.x.shape)
        corrected: np.ndarray = jump + self.trace @ u
        return corrected

    def correct_transposed(self, jump: np.ndarray) -> np.ndarray:
        """The transpose of `correct`."""
        f = np.asarray(self.trace.T @ jump).ravel()
        u = self.problem.solve(f, np.zeros_like(f))[self.outer]
        side = -self.past.T @ u
        if self.overlap is not None:
            side += self.from_side.T @ self.overlap.solve(self.to_outer.T @ u, trans="T")
        corrected = np.array(jump)
        corrected[self.rows] += side.reshape(-1, jump.shape[1])
        return corrected


MOST_EXCHANGES = 100
ROUNDS = 3
"""Times that GMRES goes on from where the true mismatch was found too large."""
KNOWN = 1e-10
"""A vector this close to the span of earlier ones needs no exchange of its own."""
GOAL = 0.5
"""Share of the tolerance that GMRES aims at."""

Fields = tuple[np.ndarray, np.ndarray]
"""Of the rim, shape [n, d], and of the bulk's unknown nodes, shape [I, d]."""


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
        self.rim, self.bulk, self.inner, self.whole = rim, bulk, inner, whole
        self.to_rim, self.to_bulk = to_rim, to_bulk

    def once(
        self, f: np.ndarray, given: np.ndarray, b: np.ndarray, side: np.ndarray, tolerance: float
    ) -> Fields:
        """Displacement of the rim [n, d] and the bulk [I, d] for one of the inner side [G, d]."""
        given = given.copy()
        given[self.inner] = side
        of_rim = self.rim.solve(f.ravel(), given.ravel()).reshape(given.shape)
        of_bulk = self.bulk.solve(b - self.bulk.pull(self.to_bulk @ of_rim), tolerance)
        return of_rim, of_bulk

    def once_back(
        self, by_rim: np.ndarray, by_bulk: np.ndarray, side: np.ndarray, tolerance: float
    ) -> tuple[Fields, np.ndarray]:
        """The transpose of `once`, of derivatives by its answers and by the inner side (B13).

        Returns:
            Derivatives by the loads, as of_rim and of_bulk, and by what is given on the rim,
            shape [n, d]; the inner side's are among these.
        """
        by_b = self.bulk.solve(by_bulk + self.to_rim.T @ side, tolerance)
        by_rim = by_rim - self.to_bulk.T @ self.bulk.push(by_b)
        by_f, by_given = self.rim.solve_back(by_rim.ravel())
        return (by_f.reshape(by_rim.shape), by_b), by_given.reshape(by_rim.shape)

    def solve(
        self, f: np.ndarray, given: np.ndarray, b: np.ndarray, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray, Exchange]:
        """Displacement of rim [n, d] and bulk [I, d] that agree, and the record.

        One exchange maps the inner side's displacement g to M g + r; GMRES solves (I − M) g = r.

        Args:
            f: load on the rim [TPa Å], shape [n, d].
            given: displacement held on the rim [Å], shape [n, d].
            b: body force density on the unknown nodes [TPa/Å], shape [I, d].
            tolerance: of the mismatch.

        Raises InputError when they do not come to agree.
        """
        side = self.whole.guess()
        fields = self.once(f, given, b, side, tolerance)
        nothing = np.zeros_like(f), np.zeros_like(given), np.zeros_like(b)

        def exchange(step: np.ndarray, accuracy: float) -> tuple[np.ndarray, Fields]:
            answer = self.once(*nothing, step, accuracy)
            return self.to_rim @ answer[1], answer

        record = Exchange(exchanges=1)
        for _ in range(ROUNDS):
            off = self.to_rim @ fields[1] - side
            goal = tolerance * float(np.linalg.norm(side + off))
            if np.linalg.norm(off) <= goal:
                break
            step, change, count = fixed_point(exchange, self.whole.correct, off, GOAL * goal)
            side = side + step
            fields = fields[0] + change[0], fields[1] + change[1]
            record.exchanges += count
        self._judge(record, (f, given, b), fields, side)
        if not record.mismatch <= tolerance:
            raise InputError(
                f"rim and bulk do not agree: mismatch {record.mismatch:.1e} after "
                f"{record.exchanges} exchanges, {tolerance:.1e} was asked for"
            )
        return *fields, record

    def solve_back(
        self, by_rim: np.ndarray, by_bulk: np.ndarray, tolerance: float
    ) -> tuple[Fields, np.ndarray]:
        """Derivatives by loads and by what is given, of ones by displacement (B12, B13).

        Args:
            by_rim: by the rim's displacement, shape [n, d].
            by_bulk: by that of the bulk's unknown nodes, shape [I, d].
            tolerance: as for `solve`.
        """
        side = np.zeros((len(self.inner), by_rim.shape[1]))
        fields, by_given = self.once_back(by_rim, by_bulk, side, tolerance)
        nothing = np.zeros_like(by_rim), np.zeros_like(by_bulk)
        answers: list[np.ndarray] = [*fields, by_given]

        def exchange(step: np.ndarray, accuracy: float) -> tuple[np.ndarray, list[np.ndarray]]:
            (by_f, by_b), past = self.once_back(*nothing, step, accuracy)
            return past[self.inner], [by_f, by_b, past]

        off = by_given[self.inner]
        goal = GOAL * tolerance * float(np.linalg.norm(off))
        _, change, _ = fixed_point(exchange, self.whole.correct_transposed, off, goal)
        answers = [answer + more for answer, more in zip(answers, change)]
        return (answers[0], answers[1]), answers[2]

    def _judge(
        self,
        record: Exchange,
        loads: tuple[np.ndarray, np.ndarray, np.ndarray],
        fields: Fields,
        side: np.ndarray,
    ) -> None:
        """Fill the record in from the fields as they stand."""
        f, _, b = loads
        of_rim, of_bulk = fields
        back = self.to_rim @ of_bulk
        size = np.linalg.norm(back)
        record.mismatch = float(np.linalg.norm(back - side) / size) if size else 0.0
        right = b - self.bulk.pull(self.to_bulk @ of_rim)
        left = np.linalg.norm(right - self.bulk.apply(of_bulk))
        record.bulk_residual = float(left / (np.linalg.norm(right) or 1.0))
        whole = of_rim.copy()
        whole[self.inner] = back
        record.rim_residual = self.rim.residual(f.ravel(), whole.ravel())


def fixed_point(
    exchange: Callable[[np.ndarray, float], tuple[np.ndarray, Sequence[np.ndarray]]],
    correct: Callable[[np.ndarray], np.ndarray],
    off: np.ndarray,
    goal: float,
) -> tuple[np.ndarray, list[np.ndarray], int]:
    """g with ‖g − M g − off‖ ≤ goal by GMRES, and what the exchange answers to it (B6, B11).

    Every exchange is linear, so that the fields of the answer are combined of those of the vectors
    asked for. Later vectors count for less and are worked out less closely.

    Args:
        exchange: M g and fields, all linear in g, to a relative accuracy.
        correct: nearly (I − M)⁻¹.
        off: shape [G, d].
        goal: largest norm of what is left.

    Returns:
        g, its fields, and how many exchanges were made.
    """
    size = float(np.linalg.norm(off))
    vectors: list[np.ndarray] = []
    answers: list[list[np.ndarray]] = []
    accuracy = [goal / size]

    def left(v: np.ndarray) -> np.ndarray:
        weights, rest = _in_span(vectors, v)
        if rest > KNOWN * np.linalg.norm(v):
            step = correct(v.reshape(off.shape))
            after, fields = exchange(step, accuracy[0])
            vectors.append(v.copy())
            answers.append([step - after, step, *fields])
            return answers[-1][0].ravel()
        gap: np.ndarray = sum(a * answer[0] for a, answer in zip(weights, answers)).ravel()
        return gap

    def loosen(residual: float) -> None:
        accuracy[0] = min(1.0, goal / (residual * size)) if residual else 1.0

    matrix = LinearOperator((off.size, off.size), left, dtype=float)
    y, _ = gmres(
        matrix,
        off.ravel(),
        rtol=0.0,
        atol=goal,
        restart=MOST_EXCHANGES,
        maxiter=1,
        callback=loosen,
        callback_type="pr_norm",
    )
    weights, _ = _in_span(vectors, y)
    combined = [
        np.asarray(sum(a * answer[n] for a, answer in zip(weights, answers)))
        for n in range(1, len(answers[0]))
    ]
    return combined[0], combined[1:], len(vectors)


def _in_span(vectors: list[np.ndarray], v: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights of vectors that make another, and the norm of what they leave."""
    if not vectors:
        return np.zeros(0), float(np.linalg.norm(v))
    basis = np.stack(vectors, axis=1)
    weights = np.linalg.lstsq(basis, v)[0]
    return weights, float(np.linalg.norm(v - basis @ weights))
