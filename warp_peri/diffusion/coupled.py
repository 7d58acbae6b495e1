"""Diffusion and mechanics that feel each other: σ = σ_mech + ε φ I (theory.md, D5)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from warp_peri.damage.lattice_body import Body
from warp_peri.damage.operator import bond_weights, cut_matrix, dilatation_matrix
from warp_peri.damage.stability import check_cut
from warp_peri.diffusion.operator import DiffusionOperator
from warp_peri.errors import InputError
from warp_peri.models.lps import Model

RESIDUAL = 1e-9


class Coupled:
    """L u + ε Φᵗ φ = b and c ∂φ/∂t − ε ∂θ/∂t + L_κ φ = g, θ = Φ u, by backward Euler.

    Φᵗ is minus the nonlocal gradient that goes with the dilatation, so that what one side works
    the other receives. The nodes of body and diffusion are the same, in the same order.

    Args:
        model: of the solid, one influence function.
        body: its nodes and bonds.
        diffusion: the operator of φ; its interior is what is free, of u as well.
        coupling: ε [stress].
        storage: c ≥ 0.
        neighbour: with broken bonds; the body's own by default.

    Raises InputError for other nodes, a coupling that is not finite, a storage below 0, and for
    kernels that change sign and leave one of the two with eigenvalues below zero.
    """

    def __init__(
        self,
        model: Model,
        body: Body,
        diffusion: DiffusionOperator,
        *,
        coupling: float,
        storage: float,
        neighbour: np.ndarray | None = None,
    ) -> None:
        if not np.array_equal(body.x, diffusion.points.x):
            raise InputError("body: expected the nodes of the diffusion, in the same order")
        if not (np.isfinite(coupling) and 0 <= storage < np.inf):
            raise InputError(
                f"coupling, storage: expected a finite number and one ≥ 0, got {coupling} and "
                f"{storage}"
            )
        table = body.neighbour if neighbour is None else neighbour
        w = bond_weights(model, body.classes)
        rows = diffusion.rows
        self.rows, self.storage = rows, float(storage)
        self.free = np.column_stack([2 * rows, 2 * rows + 1]).ravel()
        theta = dilatation_matrix(body, w, table)
        self._solid = cut_matrix(body, w, table, model.mu, model.lam - model.mu)[self.free]
        if (w < 0).any():
            check_cut(self._solid[:, self.free])
        diffusion.inner()  # refuses one that would grow
        self._pull = sp.csr_array(coupling * theta.T)[self.free]
        self._squeeze = sp.csr_array(-coupling * theta[rows])
        self._flux = diffusion.matrix()

    def step(
        self,
        before: tuple[np.ndarray, np.ndarray],
        given: tuple[np.ndarray, np.ndarray],
        dt: float,
        *,
        b: np.ndarray,
        source: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """u, shape [N, 2], and φ, shape [N], one step later; dt = inf solves the steady state.

        Args:
            before: u and φ of all nodes before the step.
            given: u and φ after it, of which the nodes off the interior are taken.
            dt: step.
            b: body force density, shape [N, 2].
            source: g, shape [N].

        Raises InputError for a step not > 0, other shapes, or a solve that loses its digits.
        """
        if not dt > 0:
            raise InputError(f"step: expected a number > 0, got {dt}")
        count = self._flux.shape[1]
        fields = {"b": (b, (count, 2)), "source": (source, (count,))}
        for name, pair in (("before", before), ("given", given)):
            fields |= {f"{name} u": (pair[0], (count, 2)), f"{name} φ": (pair[1], (count,))}
        for name, (field, shape) in fields.items():
            if np.shape(field) != shape:
                raise InputError(f"{name}: expected shape {list(shape)}, got {np.shape(field)}")
        rate = 1 / dt
        u, phi = np.array(given[0], dtype=float).ravel(), np.array(given[1], dtype=float)
        u[self.free], phi[self.rows] = 0, 0
        store = sp.csr_array(
            (np.full(len(self.rows), self.storage * rate), (range(len(self.rows)), self.rows)),
            shape=self._flux.shape,
        )
        lower, flux = rate * self._squeeze, self._flux + store
        system = sp.block_array(
            [
                [self._solid[:, self.free], self._pull[:, self.rows]],
                [lower[:, self.free], flux[:, self.rows]],
            ],
            format="csc",
        )
        old_u, old_phi = np.ravel(before[0]), np.asarray(before[1])
        memory = lower @ old_u + store @ old_phi
        right = np.concatenate(
            [
                np.ravel(b)[self.free] - self._solid @ u - self._pull @ phi,
                source[self.rows] + memory - lower @ u - flux @ phi,
            ]
        )
        x = splu(sp.csc_matrix(system)).solve(right)
        if not np.linalg.norm(system @ x - right) <= RESIDUAL * np.linalg.norm(right):
            raise InputError("coupled: the solve lost its digits, or what is given is not finite")
        u[self.free], phi[self.rows] = x[: len(self.free)], x[len(self.free) :]
        return u.reshape(-1, 2), phi
