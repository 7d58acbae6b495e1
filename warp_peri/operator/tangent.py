"""The derivative of the nonlinear force as a sparse matrix (theory.md, N5)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from warp_peri.operator.gradient_sweeps import GradientSweeps


class TangentMatrices:
    """H by entry from u, L u from P by entry, and L_LPS, of one model on one lattice.

    Args:
        sweeps: of the lattice.
        tables: 16 μ w/r², 2 p, 2 p_in and 2 p_out by class, shape [4, C].
        bulk: λ − μ [TPa].
    """

    def __init__(self, sweeps: GradientSweeps, tables: np.ndarray, bulk: float) -> None:
        a, p, p_in, p_out = tables[:, sweeps.classes.bond_class]
        self.sweeps, xi = sweeps, sweeps.xi.T
        full, rows = sweeps.full, sweeps.rows
        pairs = [(i, k) for i in range(2) for k in range(2)]
        self.into = [_from(self._differences(full, p_in * xi[k]), i) for i, k in pairs]
        forces = [self._gathering(p_out * xi[k]) for k in range(2)]
        self.out = [_to(-forces[k], i) for i, k in pairs]
        theta = sum(_from(self._differences(full, p * xi[i]), i) for i in range(2))
        self.linear = sp.csr_array((2 * len(rows), 2 * sweeps.nodes))
        for i in range(2):
            bulks = _to(self._gathering(p * xi[i]), i) @ theta
            self.linear = self.linear - bulk * bulks
            for k in range(2):
                bonds = self._differences(rows, a * xi[i] * xi[k])
                self.linear = self.linear - _to(_from(bonds, k), i)

    def tangent(self, second: np.ndarray) -> sp.csr_array:
        """L_LPS + Σ out Ψ″ in, shape [2 I, 2 N], from Ψ″ of every node, shape [4, 4, F]."""
        tangent = self.linear
        for out, row in zip(self.out, second):
            for into, entries in zip(self.into, row):
                tangent = tangent + out @ sp.diags_array(entries) @ into
        return sp.csr_array(tangent)

    def _differences(self, nodes_with: np.ndarray, weight: np.ndarray) -> sp.csr_array:
        """Σ_b weight_b (value_j − value_i) at some nodes, shape [len(at), N]."""
        nodes, count = self.sweeps.nodes, len(weight)
        line = np.repeat(np.arange(len(nodes_with)), count)
        far = self.sweeps.neighbour.reshape(nodes, count)[nodes_with].ravel()
        ends = sp.coo_array(
            (np.tile(weight, len(nodes_with)), (line, far)), shape=(len(nodes_with), nodes)
        )
        own = (np.full(len(nodes_with), weight.sum()), (np.arange(len(nodes_with)), nodes_with))
        return sp.csr_array(
            ends.tocsr() - sp.coo_array(own, shape=(len(nodes_with), nodes)).tocsr()
        )

    def _gathering(self, weight: np.ndarray) -> sp.csr_array:
        """Σ_b weight_b (value_j + value_i) on the interior of values at `full`, [I, F].

        The weights of opposite bonds cancel, so that the node's own value does not count.
        """
        full = self.sweeps.full
        gathered = self._differences(self.sweeps.rows, weight)
        return sp.csr_array(gathered.tocsc()[:, full])


def _from(matrix: sp.csr_array, a: int) -> sp.csr_array:
    """Acting on component a of a vector field."""
    return sp.csr_array(sp.kron(matrix, np.eye(2)[a][None]))


def _to(matrix: sp.csr_array, a: int) -> sp.csr_array:
    """Giving component a of a vector field."""
    return sp.csr_array(sp.kron(matrix, np.eye(2)[a][:, None]))
