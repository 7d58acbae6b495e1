"""How rim and bulk meet: alternating solves, and whole bodies in elements (B5–B7, B11)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, aslinearoperator, gmres

from warp_peri.errors import InputError
from warp_peri.fe_coupling.boundary_elements import BodyLoads, Moduli, Rim, RimProblem
from warp_peri.fe_coupling.lattice_interior import Bulk, cubic

MOST_EXCHANGES = 100
ROUNDS = 3
"""Times that GMRES goes on from where the true mismatch was found too large."""
GOAL = 0.5
"""Share of the tolerance that GMRES aims at."""


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


def in_elements(
    moduli: Moduli, springs: Mapping[str, float], loads: BodyLoads, rim: Rim, outside: np.ndarray
) -> tuple[np.ndarray, LinearOperator]:
    """The whole body in linear elements: a first guess of the rim's inner side [Å], flat [d G], and
    (I − M)⁻¹ of a jump of it, [d G, d G].

    Were the bulk elements of the same kind, one exchange would be g ↦ M g + r with a matrix M for
    which (I − M)⁻¹ is a solve of the whole body. What is left for GMRES is the difference between
    the bulk and those elements.

    Args:
        moduli, springs, loads: of the body.
        rim: its rim.
        outside: corners of the mesh that are less deep than unknown nodes of the bulk, shape [P].
    """
    elements = Rim(rim.mesh, np.ones(len(rim.mesh.cells), bool), degree=1)
    K, d = elements.stiffness(moduli, springs), rim.d
    given, fixed = (each.ravel() for each in loads.given(elements))
    whole, x = RimProblem(K, fixed), rim.x[rim.inner]
    trace = vectors(elements.probe(x, rim.mesh.holding(x)), d)
    guess = trace @ (whole @ np.append(loads.on(elements), given))
    corner = np.full(len(rim.x), -1)
    corner[rim.corner_nodes] = elements.corner_nodes[rim.corners]
    corner = corner[rim.inner]
    side = np.flatnonzero(corner >= 0)
    entries = np.ones(len(side)), (corner[side], side)
    jump = vectors(sp.csr_array(entries, shape=(len(elements.x), len(x))), d)
    kinds = np.zeros((2, len(elements.x)), bool)
    kinds[:, elements.corner_nodes[rim.corners]] = ~outside[rim.corners], outside[rim.corners]
    kinds[:, corner[side]] = False
    shared, outer = np.repeat(kinds, d, axis=1)
    # nodes that rim and bulk share follow a jump; the outer ones feel what both pull
    follow, one = RimProblem(K, fixed | ~shared), sp.eye_array(len(fixed))
    as_load, as_given = (sp.vstack([a * one, (1 - a) * one]) for a in (1, 0))
    pull = as_load @ (-sp.diags_array(outer.astype(float)) @ K)
    chain = [trace, whole, pull, follow, as_given @ jump]
    felt, pulled, *more = (aslinearoperator(part) for part in chain)
    for part in (pulled, *more):
        felt = felt @ part
    return np.asarray(guess), aslinearoperator(sp.eye_array(x.size)) + felt


class Schwarz:
    """The two problems and what passes between them.

    One exchange is linear in the loads q = (f, given, b) and in the inner side g, which is among
    what is given: u = S (q + P g), and the bulk hands back g = R u. Derivatives are the same
    exchange with Sᵗ, Rᵗ and Pᵗ (B12, B13).

    Args:
        rim, problem: elements and their problem, in which the inner side is among what is given.
        bulk: the other.
        cell: of the mesh, that holds each of the bulk's nodes.
        whole: of `in_elements`, for what passes slowly.
    """

    def __init__(
        self, rim: Rim, problem: RimProblem, bulk: Bulk, cell: np.ndarray, whole: Any
    ) -> None:
        self.rim, self.bulk, self.d, self.inner = problem, bulk, rim.d, rim.inner
        self.guess, self.correct = whole
        self.to_bulk = rim.probe(bulk.points.x[bulk.collar], cell[bulk.collar])
        n, inside = rim.x.size, bulk.shape[0]
        places = (self.d * rim.inner[:, None] + np.arange(self.d)).ravel()
        entries = np.ones(len(places)), (n + places, np.arange(len(places)))
        self.place = sp.csr_array(entries, shape=(2 * n + inside, len(places)))
        from_bulk = vectors(cubic(bulk.points, rim.x[rim.inner]), self.d)
        self.read = sp.csr_array(sp.hstack([sp.csr_array((len(places), n)), from_bulk]))
        shape = n + inside, 2 * n + inside
        self.once = LinearOperator(shape, self._once, self._transposed, dtype=float)

    def _once(self, q: np.ndarray) -> np.ndarray:
        f_and_given, b = np.split(q.ravel(), [self.rim.shape[1]])
        of_rim = self.rim @ f_and_given
        collar = self.to_bulk @ of_rim.reshape(-1, self.d)
        return np.append(of_rim, self.bulk @ np.append(b, collar))

    def _transposed(self, by: np.ndarray) -> np.ndarray:
        by_rim, by_bulk = np.split(by.ravel(), [self.rim.shape[0]])
        by_b, by_collar = np.split(self.bulk.T @ by_bulk, [len(by_bulk)])
        pushed = self.to_bulk.T @ by_collar.reshape(-1, self.d)
        return np.append(self.rim.T @ (by_rim + pushed.ravel()), by_b)

    def solve(
        self, f: np.ndarray, given: np.ndarray, b: np.ndarray, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray, Exchange]:
        """Displacement of rim [n, d] and bulk [N, d] that agree to a tolerance, and the record.

        Of the load f [TPa Å] and the held displacement on the rim, [n, d], and the body force
        density b [TPa/Å] on the unknown nodes, [I, d]. Raises InputError when they do not agree.
        """
        q = np.concatenate([f.ravel(), given.ravel(), b.ravel()])
        ways = self.once, self.place, self.read, self.correct
        u, record = self._joined(*ways, q, self.guess, tolerance)
        if not record.mismatch <= tolerance:
            raise InputError(
                f"rim and bulk do not agree: mismatch {record.mismatch:.1e} after "
                f"{record.exchanges} exchanges, {tolerance:.1e} was asked for"
            )
        of_rim, of_bulk = (part.reshape(-1, self.d) for part in np.split(u, [f.size]))
        side = of_rim.copy()
        side[self.inner] = (self.read @ u).reshape(-1, self.d)
        record.rim_residual = self.rim.residual(f.ravel(), side.ravel())
        u_bulk = self.bulk.joined(of_bulk, self.to_bulk @ of_rim)
        record.bulk_residual = self.bulk.residual(b, u_bulk)
        return of_rim, u_bulk, record

    def transposed(
        self, by_rim: np.ndarray, by_bulk: np.ndarray, tolerance: float
    ) -> tuple[np.ndarray, ...]:
        """The transpose of `solve`: derivatives by f, what is given and b, of ones by the
        displacement of the rim [n, d] and of the bulk's nodes [N, d]."""
        by_rim = by_rim + self.to_bulk.T @ by_bulk[self.bulk.collar]
        by, n = np.append(by_rim, by_bulk[self.bulk.inside]), by_rim.size
        ways = self.once.T, self.read.T, self.place.T, self.correct.T
        found, _ = self._joined(*ways, by, np.zeros_like(self.guess), tolerance)
        by_f, by_given, by_b = (part.reshape(-1, self.d) for part in np.split(found, [n, 2 * n]))
        by_given[self.inner] = 0  # not held: the bulk's
        return by_f, by_given, by_b

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
        record, bulk = Exchange(), self.bulk

        def exchange(q: np.ndarray) -> np.ndarray:
            record.exchanges += 1
            return np.asarray(once @ q)

        def left(v: np.ndarray) -> np.ndarray:
            step = correct @ v
            return np.asarray(step - read @ exchange(place @ step))

        for last in [False] * ROUNDS + [True]:
            bulk.accuracy = tolerance
            u = exchange(q + place @ side)
            off = read @ u - side
            size, whole = (float(np.linalg.norm(one)) for one in (off, side + off))
            record.mismatch = size / (whole or 1.0)
            if record.mismatch <= tolerance or last:
                break
            goal = GOAL * tolerance * whole
            bulk.accuracy = goal / size

            def loosen(residual: float, size: float = size, goal: float = goal) -> None:
                bulk.accuracy = min(1.0, goal / (residual * size)) if residual else 1.0

            matrix = LinearOperator(2 * (len(off),), left, dtype=float)
            how: dict[str, Any] = {"restart": MOST_EXCHANGES, "maxiter": 1, "callback": loosen}
            y, _ = gmres(matrix, off, rtol=0.0, atol=goal, callback_type="pr_norm", **how)
            side = side + correct @ y
        return u, record


def vectors(matrix: sp.csr_array, d: int) -> sp.csr_array:
    """A matrix of values, for each component of vectors, shape [d m, d n]."""
    return sp.csr_array(sp.kron(matrix, np.eye(d)))
