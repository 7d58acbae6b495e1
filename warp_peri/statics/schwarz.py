"""Rim and bulk of a body, which hand displacement to each other until they agree (B5–B7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, gmres

from warp_peri.errors import InputError
from warp_peri.statics.bulk import Bulk
from warp_peri.statics.rim import RimProblem

MOST_EXCHANGES = 100


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
    """

    def __init__(
        self,
        rim: RimProblem,
        bulk: Bulk,
        inner: np.ndarray,
        to_rim: sp.csr_array,
        to_bulk: sp.csr_array,
    ) -> None:
        self.rim, self.bulk, self.inner = rim, bulk, inner
        self.to_rim, self.to_bulk = to_rim, to_bulk

    def once(
        self, f: np.ndarray, given: np.ndarray, b: np.ndarray, side: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Displacement of the rim [n, 2] and the bulk [I, 2] for one of the inner side [G, 2]."""
        given = given.copy()
        given[self.inner] = side
        of_rim = self.rim.solve(f.ravel(), given.ravel()).reshape(-1, 2)
        of_bulk = self.bulk.solve(b - self.bulk.pull(self.to_bulk @ of_rim))
        return of_rim, of_bulk

    def solve(
        self,
        f: np.ndarray,
        given: np.ndarray,
        b: np.ndarray,
        start: np.ndarray,
        tolerance: float,
    ) -> tuple[np.ndarray, np.ndarray, Exchange]:
        """Displacement of rim [n, 2] and bulk [I, 2] that agree, and the record.

        One exchange maps the inner side's displacement g to M g + r; GMRES solves (I − M) g = r.

        Args:
            f: load on the rim [TPa Å], shape [n, 2].
            given: displacement held on the rim [Å], shape [n, 2].
            b: body force density on the unknown nodes [TPa/Å], shape [I, 2].
            start: a first guess of the inner side [Å], shape [G, 2].
            tolerance: of the mismatch.

        Raises InputError when they do not come to agree.
        """
        record = Exchange(exchanges=1)
        nothing = np.zeros_like(f), np.zeros_like(given), np.zeros_like(b)
        of_rim, of_bulk = self.once(f, given, b, start)
        off = (self.to_rim @ of_bulk - start).ravel()
        asked: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

        def left(side: np.ndarray) -> np.ndarray:
            record.exchanges += 1
            asked[:] = [(side.copy(), *self.once(*nothing, side.reshape(start.shape)))]
            gap: np.ndarray = side - (self.to_rim @ asked[0][2]).ravel()
            return gap

        matrix = LinearOperator((off.size, off.size), left, dtype=float)
        goal = 0.5 * tolerance * float(np.linalg.norm(start + off.reshape(start.shape)))
        if np.linalg.norm(off) > goal:
            step, _ = gmres(matrix, off, rtol=0.0, atol=goal, restart=MOST_EXCHANGES, maxiter=1)
            if not (asked and np.array_equal(asked[0][0], step)):
                left(step)  # GMRES mostly asks for its answer's own residual last
            of_rim, of_bulk = of_rim + asked[0][1], of_bulk + asked[0][2]
            start = start + step.reshape(start.shape)
        self._judge(record, (f, given, b), of_rim, of_bulk, start)
        if not record.mismatch <= tolerance:
            raise InputError(
                f"rim and bulk do not agree: mismatch {record.mismatch:.1e} after "
                f"{record.exchanges} exchanges, {tolerance:.1e} was asked for"
            )
        return of_rim, of_bulk, record

    def _judge(
        self,
        record: Exchange,
        loads: tuple[np.ndarray, np.ndarray, np.ndarray],
        of_rim: np.ndarray,
        of_bulk: np.ndarray,
        side: np.ndarray,
    ) -> None:
        """Fill the record in from the fields as they stand."""
        f, _, b = loads
        back = self.to_rim @ of_bulk
        size = np.linalg.norm(back)
        record.mismatch = float(np.linalg.norm(back - side) / size) if size else 0.0
        right = b - self.bulk.pull(self.to_bulk @ of_rim)
        left = np.linalg.norm(right - self.bulk.apply(of_bulk))
        record.bulk_residual = float(left / (np.linalg.norm(right) or 1.0))
        whole = of_rim.copy()
        whole[self.inner] = back
        record.rim_residual = self.rim.residual(f.ravel(), whole.ravel())
