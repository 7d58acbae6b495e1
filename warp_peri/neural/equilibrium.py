"""Equilibrium of a neural operator, and the derivative of what is found to its numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, SuperLU, gmres, splu

from warp_peri.errors import InputError
from warp_peri.neural.matrix import matrix
from warp_peri.neural.placed import Placed, Tangent

TOLERANCE = 1e-8
"""‖force − b‖ over that of the field that the search begins with."""
ROUNDING = 16
"""In units of the networks' precision: a residual that steps of Newton no longer lower."""
MOST_STEPS, MOST_HALVINGS = 40, 12
MOST_PRODUCTS = 40
"""Of a linear solve, before the tangent is factorised anew."""
FORCING, ADJOINT = 1e-3, 1e-8
"""Relative residuals of the linear solves of a step, and of an adjoint."""
PARTS = (1, 2, 4, 8)
"""Equal parts that a load and what is given on the collar are applied in, until all are found."""


@dataclass(frozen=True)
class Found:
    """An equilibrium, or where the search ended.

    Attributes:
        u: displacement of all nodes [length], shape [N, 2].
        residual: ‖force − b‖ over that of the start.
        steps: of Newton.
        converged: whether the residual is within the tolerance, or within rounding: networks in
            single precision leave some 1e-7 of it.
    """

    u: np.ndarray
    residual: float
    steps: int
    converged: bool


class Equilibrium:
    """Newton's method for one operator: the tangent at rest is factorised once, for all loads.

    Linear solves are GMRES on the products of the tangent, which is not symmetric in general, with
    the last factors before them. The material's numbers may change meanwhile. Raises InputError for
    points without a collar.
    """

    def __init__(self, placed: Placed) -> None:
        if placed.points.interior.all():
            raise InputError(
                "points: expected a collar where u is given; without one it is known up to a motion"
            )
        self.placed = placed
        rows = placed.bonds.rows
        self.unknown = (2 * rows[:, None] + [0, 1]).ravel()
        self.at_rest = placed.tangent(torch.zeros(self._shape, dtype=placed.dtype))
        self.factors = self.factors_of(self.at_rest)

    @property
    def _rounding(self) -> float:
        return float(ROUNDING * torch.finfo(self.placed.dtype).eps)

    @property
    def _shape(self) -> tuple[int, int]:
        return len(self.placed.points.x), 2

    def factors_of(self, tangent: Tangent) -> SuperLU:
        """LU of the tangent's rows and columns of the interior."""
        return splu(matrix(tangent)[:, self.unknown].tocsc())

    def solve(
        self, b: ArrayLike, u: ArrayLike, *, tolerance: float = TOLERANCE, most: int = MOST_STEPS
    ) -> Found:
        """Where the force on the interior is b [stress/length], of shape [N, 2].

        Args:
            b: load; only interior values count.
            u: displacement [length], shape [N, 2]: data on the collar, the start on the interior.
            tolerance: ‖force − b‖ over that of the start with a zero interior.
            most: steps of Newton.

        Raises InputError for arrays of other shapes.
        """
        rows = self.placed.bonds.rows
        load, field = (np.array(part, float) for part in (b, u))
        for name, part in (("b", load), ("u", field)):
            if part.shape != self._shape:
                raise InputError(f"{name}: expected shape {[*self._shape]}, got {[*part.shape]}")
        load = load[rows]
        zero = field.copy()
        zero[rows] = 0
        scale = float(np.linalg.norm(self.placed(zero) - load)) or 1.0
        left = self.placed(field) - load
        size, steps = float(np.linalg.norm(left)) / scale, 0
        while size > tolerance and steps < most:
            tangent = self.placed.tangent(torch.as_tensor(field, dtype=self.placed.dtype))
            move = self._solved(tangent, -left, FORCING, "N")
            best = self._along(field, move, load, scale, size)
            if best is None:
                break
            field, left, size = best
            steps += 1
        return Found(field, size, steps, size <= max(tolerance, self._rounding))

    def from_rest(self, b: ArrayLike, u: ArrayLike, *, tolerance: float = TOLERANCE) -> Found:
        """Where the force on the interior is b, on the branch that leaves the state of rest.

        The search begins with the linear solution of the tangent at rest, which a start of zeros is
        far from wherever the collar moves. Where it fails, load and collar come in more parts.
        Arguments and errors are those of `solve`; what `u` has inside does not count. Where no
        number of parts finds it, the end of the first search is returned.
        """
        load, given = np.array(b, float), np.array(u, float)
        first = None
        for parts in PARTS:
            field = self._linear(load / parts, given / parts)
            for part in range(1, parts + 1):
                start = np.where(self.placed.points.interior[:, None], field, part / parts * given)
                found = self.solve(part / parts * load, start, tolerance=tolerance)
                if not found.converged:
                    break
                field = (part + 1) / part * found.u
            first = first or found
            if found.converged:
                return found
        assert first is not None
        return first

    def _linear(self, load: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The equilibrium of the tangent at rest, shape [N, 2]; `given` on the collar."""
        rows = self.placed.bonds.rows
        field = given.copy()
        field[rows] = 0
        pull = self.at_rest(torch.as_tensor(field, dtype=self.placed.dtype)).double().numpy()
        field[rows] = self._solved(self.at_rest, load[rows] - pull, FORCING, "N")
        return field

    def gradient(self, u: torch.Tensor, by_u: torch.Tensor) -> None:
        """Add to the gradients of the material's numbers those of a loss of an equilibrium, (NO10).

        Args:
            u: the equilibrium [length], shape [N, 2].
            by_u: derivative of the loss to u on the interior, shape [I, 2].

        What it takes in time and memory does not depend on how the equilibrium was found.
        """
        placed = self.placed
        tangent = placed.tangent(u)
        enough = max(ADJOINT, self._rounding)  # a smaller residual would never be reached
        multiplier = self._solved(tangent, by_u.detach().double().numpy(), enough, "T")
        weight = torch.as_tensor(multiplier, dtype=u.dtype)
        (-(placed(u.detach()) * weight).sum()).backward()

    def _solved(
        self, tangent: Tangent, right: np.ndarray, tolerance: float, side: str
    ) -> np.ndarray:
        """J⁻¹ or J⁻ᵗ ("T") of a field of the interior; poor factors are renewed."""
        placed, rows, count = self.placed, self.placed.bonds.rows, right.size

        def product(v: np.ndarray) -> np.ndarray:
            inner = torch.as_tensor(v.reshape(-1, 2), dtype=placed.dtype)
            if side == "T":
                return tangent.transposed(inner)[rows].double().numpy().ravel()
            return tangent(placed.bonds.on_every(inner[None])[0]).double().numpy().ravel()

        def before(v: np.ndarray) -> np.ndarray:
            return self.factors.solve(v, trans=side)  # type: ignore[no-any-return]

        J, M = (
            LinearOperator(2 * (count,), matvec=part, dtype=float) for part in (product, before)
        )
        asked = {"rtol": tolerance, "restart": MOST_PRODUCTS, "maxiter": 1}
        answer, failed = gmres(J, right.ravel(), M=M, **asked)
        if failed:
            self.factors = self.factors_of(tangent)
            answer = before(right.ravel())
        return np.asarray(answer).reshape(-1, 2)

    def _along(
        self, field: np.ndarray, move: np.ndarray, load: np.ndarray, scale: float, size: float
    ) -> tuple[np.ndarray, np.ndarray, float] | None:
        """The first of the halved steps with a smaller residual; None where there is none."""
        share = 1.0
        for _ in range(MOST_HALVINGS):
            there = field.copy()
            there[self.placed.bonds.rows] += share * move
            left = self.placed(there) - load
            new = float(np.linalg.norm(left)) / scale
            if new < (1 - 1e-4 * share) * size:
                return there, left, new
            share /= 2
        return None
