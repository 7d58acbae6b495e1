"""Equilibria of a neural operator, and the derivative of what is found to its numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, SuperLU, gmres, splu

from warp_peri.errors import InputError
from warp_peri.neural.matrix import matrix
from warp_peri.neural.placed import Placed, Tangent
from warp_peri.statics.at_rest import probed
from warp_peri.statics.equilibria import Equilibria
from warp_peri.statics.linear import Linear

TOLERANCE = 1e-8
"""‖force − b‖ over that of the field that the search begins with."""
ROUNDING = 16
"""In units of the networks' precision: a residual that steps of Newton no longer lower."""
ADJOINT = 1e-8
"""Relative residual of an adjoint's linear solve."""
MOST_PRODUCTS, ROUNDS = 40, 5
"""Directions that the adjoint's GMRES keeps, and how often it begins anew."""
LOADS = 8
"""Loads that the solid at rest is set up for."""


@dataclass(frozen=True)
class Found:
    """An equilibrium, or where the search ended.

    Attributes:
        u: displacement of all nodes [length], shape [N, 2].
        residual: ‖force − b‖ over that of the start.
        steps: solves of the solid at rest.
        converged: whether the residual is within the tolerance, or within rounding: networks in
            single precision leave some 1e-7 of it.
    """

    u: np.ndarray
    residual: float
    steps: int
    converged: bool


class NeuralEquilibrium:
    """Equilibria of one operator, with the stencil that it was at rest before them.

    The material's numbers may change meanwhile. Raises InputError for points without a collar.
    """

    def __init__(self, placed: Placed) -> None:
        points = placed.points
        if points.interior.all():
            raise InputError(
                "points: expected a collar where u is given; without one it is known up to a motion"
            )
        self.placed, self.rows = placed, placed.bonds.rows
        self.unknown = (2 * self.rows[:, None] + [0, 1]).ravel()
        linear = Linear(probed(placed), points)
        self.inverse = linear.cheapest_inverse(LOADS, definite=False)
        straight = lambda u: linear(u[None])[0]  # noqa: E731
        self.way = Equilibria(placed, straight, self.inverse, points.interior)

    @property
    def _rounding(self) -> float:
        return float(ROUNDING * torch.finfo(self.placed.dtype).eps)

    def factors_of(self, tangent: Tangent) -> SuperLU:
        """LU of the tangent's rows and columns of the interior."""
        return splu(matrix(tangent)[:, self.unknown].tocsc())

    def solve(self, b: ArrayLike, u: ArrayLike, *, tolerance: float = TOLERANCE) -> Found:
        """Where the force on the interior is b [stress/length], of shape [N, 2].

        Args:
            b: load; only interior values count.
            u: displacement [length], shape [N, 2]: data on the collar, the start on the interior.
            tolerance: ‖force − b‖ over that of the start with a zero interior.

        Raises InputError for arrays of other shapes.
        """
        load, field = self._checked(b, u)
        enough = max(tolerance, self._rounding)
        found, record = self.way.solve_from(load, field, enough)
        return Found(found, record.residual, record.solves, record.residual <= enough)

    def from_rest(self, b: ArrayLike, u: ArrayLike, *, tolerance: float = TOLERANCE) -> Found:
        """Where the force on the interior is b, on the branch that leaves the state of rest.

        Arguments and errors are those of `solve`; what `u` has inside does not count. Where it is
        not found, what the solid at rest answers is returned.
        """
        load, given = self._checked(b, u)
        enough = max(tolerance, self._rounding)
        try:
            found, record = self.way.solve(load, given, enough)
        except InputError:
            field = np.where(self.placed.points.interior[:, None], 0.0, given)
            field[self.rows] = self.inverse(load - self.way.straight(field), enough)
            left = np.linalg.norm(load - self.placed(field))
            return Found(field, float(left / (np.linalg.norm(load) or 1.0)), 1, False)
        return Found(found, record.residual, record.solves, True)

    def gradient(self, u: torch.Tensor, by_u: torch.Tensor) -> None:
        """Add to the gradients of the material's numbers those of a loss of an equilibrium, (NO10).

        Args:
            u: the equilibrium [length], shape [N, 2].
            by_u: derivative of the loss to u on the interior, shape [I, 2].

        What it takes in time and memory does not depend on how the equilibrium was found. Raises
        InputError where the tangent there is singular, or nearly.
        """
        placed, rows = self.placed, self.rows
        tangent, right = placed.tangent(u), by_u.detach().double().numpy()
        enough = max(ADJOINT, self._rounding)  # a smaller residual would never be reached

        def product(v: np.ndarray) -> np.ndarray:
            inner = torch.as_tensor(v.reshape(-1, 2), dtype=placed.dtype)
            return np.asarray(tangent.transposed(inner)[rows].double().numpy().ravel())

        def before(v: np.ndarray) -> np.ndarray:
            return self.inverse(v.reshape(-1, 2), ADJOINT).ravel()

        J, M = (
            LinearOperator(2 * (right.size,), matvec=part, dtype=float)
            for part in (product, before)
        )
        asked = {"rtol": enough, "restart": MOST_PRODUCTS, "maxiter": ROUNDS}
        w, failed = gmres(J, right.ravel(), M=M, **asked)
        if failed:
            raise InputError("the tangent of the operator is singular at this field, or nearly")
        weight = torch.as_tensor(w.reshape(-1, 2), dtype=u.dtype)
        (-(placed(u.detach()) * weight).sum()).backward()

    def _checked(self, b: ArrayLike, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The load on the interior, and the field."""
        load, field = (np.array(part, float) for part in (b, u))
        shape = self.placed.points.x.shape
        for name, part in (("b", load), ("u", field)):
            if part.shape != shape:
                raise InputError(f"{name}: expected shape {[*shape]}, got {[*part.shape]}")
        return load[self.rows], field
