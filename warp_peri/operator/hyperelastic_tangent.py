"""The tangent of a hyperelastic solid as a sparse matrix, for direct solves of small bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from warp_peri.operator.hyperelastic import HyperelasticOperator


@dataclass(frozen=True, eq=False)
class TangentPattern:
    """What the tangent is made of, apart from the field: build once for an operator.

    Attributes:
        op: the operator.
        Q: strains by bond strains, shape [6 N, P], for P bonds counted once.
        mean: short strain of both ends along a bond by strains, shape [P', 6 N].
        deviating: the bonds of those rows, whose deviation (H6) is penalised, shape [P'].
        free: degrees of freedom of the interior, shape [2 I].
    """

    op: HyperelasticOperator
    Q: sp.csr_matrix
    mean: sp.csr_matrix
    deviating: np.ndarray
    free: np.ndarray

    @classmethod
    def of(cls, op: HyperelasticOperator) -> TangentPattern:
        """The pattern of an operator."""
        i, j, k = op.bonds.pairs
        nodes, pairs = len(op.points.x), len(i)
        square = op.bonds.spacing**2 * (op.bonds.steps[k] ** 2).sum(axis=1)
        q = op.weight[k] * square[:, None]
        number = np.arange(pairs)
        whole = np.stack(3 * [op.bonds.whole % 2] + 3 * [op.bonds.whole // 2], axis=1)
        six = np.arange(6)
        rows = np.concatenate([6 * i[:, None] + six, 6 * j[:, None] + six])
        values = np.concatenate([q * whole[i], q * whole[j]])
        columns = np.broadcast_to(np.tile(number, 2)[:, None], rows.shape)
        Q = sp.csr_matrix(
            (values.ravel(), (rows.ravel(), columns.ravel())), shape=(6 * nodes, pairs)
        )
        Q.eliminate_zeros()
        both = (op.bonds.whole[i] >= 2) & (op.bonds.whole[j] >= 2)
        deviating = np.flatnonzero(both & (op.deviation[k] >= 0))
        row = np.arange(len(deviating))
        three = np.arange(3, 6)
        ends = np.concatenate(
            [6 * i[deviating][:, None] + three, 6 * j[deviating][:, None] + three], axis=1
        )
        units = np.tile(op.unit[k[deviating]], 2)
        mean = sp.csr_matrix(
            (0.5 * units.ravel(), (np.repeat(row, 6), ends.ravel())),
            shape=(len(row), 6 * nodes),
        )
        free = (2 * op.interior[:, None] + np.arange(2)).ravel()
        return cls(op, Q, mean, deviating, free)

    def matrix(self, u: np.ndarray, c: np.ndarray) -> sp.csc_matrix:
        """K between interior nodes at a field u of shape [N, 2], (H10), shape [2 I, 2 I]."""
        op = self.op
        first, last = op.dictionary.first_deviation, op.dictionary.first_term
        E, G, H = op.states(u, c)
        i, j, k = op.bonds.pairs
        Y = op.bonds.spacing * op.bonds.steps[k] + u[j] - u[i]
        square = op.bonds.spacing**2 * (op.bonds.steps[k] ** 2).sum(axis=1)
        s = ((Y**2).sum(axis=1) / square - 1) / 2
        slopes, curves = op.bond_slopes(s, c, k)
        B = self._bond_rates(Y / square[:, None], i, j)
        K = B.T @ sp.diags(curves) @ B
        QB = self.Q @ B
        nodes = np.arange(len(u) + 1)
        blocks = sp.bsr_matrix((H, nodes[:-1], nodes), shape=2 * [6 * len(u)]).tocsr()
        K = K + QB.T @ (blocks @ QB)
        if last > first:
            K = K + self._deviations(c[first:last], s, slopes, B, QB, E, k)
        tension = slopes / square + ((G[i] + G[j]) * op.weight[k]).sum(axis=1)
        return (K + sp.kron(self._geometry(tension, i, j), sp.eye(2))).tocsc()

    def _deviations(
        self,
        stiffness: np.ndarray,
        s: np.ndarray,
        slopes: np.ndarray,
        B: sp.csr_matrix,
        QB: sp.csr_matrix,
        E: np.ndarray,
        k: np.ndarray,
    ) -> sp.csr_matrix:
        """What the deviations add to the tangent; their tensions are added to `slopes`."""
        bonds = self.deviating
        c = stiffness[self.op.deviation[k[bonds]]]
        own, mean = 1 / (1 + 2 * s[bonds]), 1 / (1 + 2 * (self.mean @ E.ravel()))
        with np.errstate(invalid="ignore"):  # a folded field has no tangent: NaN
            d = 0.5 * np.log(mean / own)
        slopes[bonds] += c * d * own * mean
        by_own, by_mean = sp.diags(own) @ B[bonds], sp.diags(mean) @ (self.mean @ QB)
        twice = by_own.T @ sp.diags(c * mean * (1 - 2 * d)) @ by_own
        twice = twice + by_mean.T @ sp.diags(c * mean * (1 + 6 * d + 4 * d**2)) @ by_mean
        mixed = by_own.T @ sp.diags(c * mean * (1 + 2 * d)) @ by_mean
        return twice - mixed - mixed.T

    def _bond_rates(self, along: np.ndarray, i: np.ndarray, j: np.ndarray) -> sp.csr_matrix:
        """Bond strains by displacements of the interior, shape [P, 2 I]."""
        number = np.full(len(self.op.points.x), -1)
        number[self.op.interior] = np.arange(len(self.op.interior))
        rows, columns, values = [], [], []
        for end, sign in ((i, -1.0), (j, 1.0)):
            kept = np.flatnonzero(number[end] >= 0)
            rows.append(np.repeat(kept, 2))
            columns.append((2 * number[end[kept]][:, None] + np.arange(2)).ravel())
            values.append(sign * along[kept].ravel())
        places = (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_matrix(
            (np.concatenate(values), places), shape=(len(i), 2 * len(self.op.interior))
        )

    def _geometry(self, tension: np.ndarray, i: np.ndarray, j: np.ndarray) -> sp.csr_matrix:
        """The Laplacian of bonds under tension, between interior nodes."""
        nodes, interior = len(self.op.points.x), self.op.interior
        diagonal = np.bincount(i, tension, nodes) + np.bincount(j, tension, nodes)
        number = np.full(nodes, -1)
        number[interior] = np.arange(len(interior))
        a, b = number[i], number[j]
        both = (a >= 0) & (b >= 0)
        ends = (np.concatenate([a[both], b[both]]), np.concatenate([b[both], a[both]]))
        off = sp.coo_matrix((np.tile(tension[both], 2), ends), shape=2 * [len(interior)])
        return (sp.diags(diagonal[interior]) - off).tocsr()
