"""Bonds that soften before they break, pulled slowly until the body comes apart (C16)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.operator.damage import bond_weights
from warp_peri.points.body import Body, cracked, crossing_bonds
from warp_peri.stability.breaking import check_breakable
from warp_peri.statics.cracked import symmetric_factors

NEWTON = 40
TOLERANCE = 1e-8


@dataclass(frozen=True)
class Pull:
    """A body pulled slowly.

    Attributes:
        load: factors of the displacement of the held nodes, shape [K].
        force: per thickness across the section, at each load [stress · length], shape [K].
        broken: bonds broken by then, shape [K].
    """

    load: np.ndarray
    force: np.ndarray
    broken: np.ndarray

    @property
    def peak(self) -> tuple[float, float]:
        """Load and force at the largest force."""
        highest = int(np.argmax(self.force))
        return float(self.load[highest]), float(self.force[highest])


class SoftBody:
    """A bond-based body whose bonds pull with k d exp(−β s), s = d/r² > 0, and k d in compression.

    Args:
        model: λ = μ, positive on the lattice.
        body: the body.
        softness: β ≥ 0; a bond pulls hardest at s = 1/β.
        held: components of the displacement that are given, shape [N, 2] bool.
        cracks: polylines open from the start.
        no_fail: nodes whose bonds do not break, shape [N] bool.
    """

    def __init__(
        self,
        model: Model,
        body: Body,
        softness: float,
        held: np.ndarray,
        *,
        cracks: list[ArrayLike] | None = None,
        no_fail: np.ndarray | None = None,
    ) -> None:
        if model.lam != model.mu:
            raise InputError("model: expected λ = μ, bonds without a dilatation")
        if not softness >= 0:
            raise InputError(f"softness: expected a number ≥ 0, got {softness}")
        check_breakable(model, body.classes)
        self.body, self.softness, self.held = body, float(softness), held
        table = cracked(body, cracks or [])
        node, bond = np.nonzero(table > np.arange(len(table))[:, None])  # each bond once
        far = table[node, bond]
        self._node, self._bond = node, bond
        xi, count = body.xi[bond], len(node)
        columns = np.column_stack([2 * far, 2 * far + 1, 2 * node, 2 * node + 1]).ravel()
        values = np.column_stack([xi, -xi]).ravel()
        rows = np.arange(0, 4 * count + 1, 4)
        self._d = sp.csr_array((values, columns, rows), shape=(count, 2 * len(table)))
        self._k = 16 * model.mu * bond_weights(model, body.classes)[bond] / body.r[bond] ** 2
        self._square = body.r[bond] ** 2
        safe = np.zeros(len(table), bool) if no_fail is None else no_fail
        self._breakable = ~(safe[node] | safe[far])
        self._free = ~held.ravel()

    def rest(self, u: np.ndarray, alive: np.ndarray) -> np.ndarray:
        """u at rest from a start that holds the given components, by Newton's method, flat [2N]."""
        for _ in range(NEWTON):
            d = self._d @ u
            s = np.maximum(d / self._square, 0)
            weak = np.exp(-self.softness * s)
            total = self._d.T @ (self._k * alive * d * weak)
            force = total[self._free]
            if np.linalg.norm(force) <= TOLERANCE * np.linalg.norm(total):
                return u
            tangent = self._k * alive * weak * np.maximum(1 - self.softness * s, 0.02)
            matrix = sp.csr_array(self._d.T @ (sp.diags_array(tangent) @ self._d))
            inner = sp.csc_array(matrix[self._free][:, self._free])
            u = u.copy()
            u[self._free] -= symmetric_factors(inner).solve(force)
        raise InputError("softening: no equilibrium was found; the body may have come apart")

    def across(self, u: np.ndarray, alive: np.ndarray, line: ArrayLike) -> float:
        """Pull per thickness across a line along x, of what is above on what is below."""
        cut = crossing_bonds(self.body, line)[self._node, self._bond]
        d = self._d @ u
        weak = np.exp(-self.softness * np.maximum(d / self._square, 0))
        xi = self.body.xi[self._bond]
        pull = (self._k * alive * d * weak)[cut] * np.abs(xi[cut, 1])
        return float(self.body.spacing**2 * pull.sum())

    def pull(
        self,
        u: np.ndarray,
        loads: ArrayLike,
        stretch: float,
        line: ArrayLike,
        *,
        stop: float = 0.7,
        progress: bool = False,
    ) -> Pull:
        """Raise the load step by step; at each, break what is beyond `stretch` until nothing is.

        Args:
            u: given components at unit load, shape [N, 2].
            loads: rising factors.
            stretch: s₀ at which bonds break; inf for none.
            line: across which the force is read, [2, 2].
            stop: ends when the force has fallen to this share of its largest.
            progress: shows a bar.
        """
        given = np.where(self.held, u, 0).ravel()
        alive = np.ones(len(self._k))
        field, rows, before = np.zeros_like(given), [], 0.0
        for load in tqdm(np.asarray(loads, dtype=float), disable=not progress, unit="load"):
            field = field * (load / before) if before else load * np.ravel(u)
            field = np.where(self.held.ravel(), load * given, field)
            try:
                while True:
                    field = self.rest(field, alive)
                    beyond = (self._d @ field > stretch * self._square) & self._breakable
                    beyond &= alive > 0
                    if not beyond.any():
                        break
                    alive[beyond] = 0
            except InputError:
                rows.append((load, 0.0, int((alive == 0).sum())))
                break
            before = load
            rows.append((load, self.across(field, alive, line), int((alive == 0).sum())))
            if rows[-1][1] < stop * max(row[1] for row in rows):
                break
        return Pull(*np.array(rows).T)
