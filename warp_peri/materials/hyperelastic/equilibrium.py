"""Equilibria of sheets: what the one driver asks of them, and how stable they are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh

from warp_peri.errors import warn
from warp_peri.materials.hyperelastic.lattice import softest
from warp_peri.points.arguments import checked_fields
from warp_peri.solvers.direct import lanczos_start, smallest_eigenvalue
from warp_peri.solvers.equilibria import Inner, direction, stable_way

DIRECT = 20_000
"""Unknowns up to which the tangent is factorised; beyond, conjugate gradients take its products."""
LINEAR = 1e-5
"""Strain below which what rounding leaves of forces is seen, and answers are in proportion."""
SMALLEST_AREA = 0.02
"""Of the nodal strain, det C: below it a solve treats a field as folded."""
TOLERANCE = 1e-8
"""Of the residual, relative to the largest force."""


class NoEquilibriumError(RuntimeError):
    """No stable equilibrium was found; the message says how far the load was followed."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A stable equilibrium.

    Attributes:
        u: displacement on all nodes, shape [N, 2].
        residual: largest residual over the largest force.
        smallest_eigenvalue: of the tangent between interior nodes, over that of the five-point
            Laplacian on them: positive where the equilibrium is stable [stress]. Beyond DIRECT
            unknowns it is a lower bound of that, see smallest_of_tangent.
        iterations: Newton steps.
        load_steps: 1 where no continuation was needed.
        followed: whether stable equilibria lead to it from rest along the load, as far as the
            steps tell; false for another minimum, found by going down.
    """

    u: np.ndarray
    residual: float
    smallest_eigenvalue: float
    iterations: int
    load_steps: int
    followed: bool


def stable_equilibrium(
    op: Any, b: np.ndarray | None, u: np.ndarray, tolerance: float = TOLERANCE
) -> Equilibrium:
    """As find_equilibrium, with the smallest eigenvalue, above zero.

    Warns where the answer is not followed from rest. Raises NoEquilibriumError where there is none.
    """
    equilibrium = find_equilibrium(op, b, u, tolerance=tolerance)
    if equilibrium is None:
        raise NoEquilibriumError("no stable equilibrium found on the way to all of load and collar")
    if not equilibrium.followed:
        warn(
            "the branch of stable equilibria that begins at rest ended before all of load and "
            "collar; what is returned is another minimum, perhaps one of many"
        )
    smallest = smallest_of_tangent(op, equilibrium.u)
    if not smallest > 0:
        raise NoEquilibriumError(f"the equilibrium found is unstable: eigenvalue {smallest:.3g}")
    return replace(equilibrium, smallest_eigenvalue=smallest / op.lattice.softest)


def find_equilibrium(
    op: Any,
    b: np.ndarray | None,
    u: np.ndarray,
    *,
    start: np.ndarray | None = None,
    near: Inner | None = None,
    tolerance: float = TOLERANCE,
) -> Equilibrium | None:
    """The equilibrium of a sheet, its smallest eigenvalue NaN; None where no stable one is found.

    Args:
        op: HyperelasticSheetOperator.
        b: body force on all nodes [stress / length], shape [N, 2]; none for no load.
        u: displacement, shape [N, 2]; read on the collar only.
        start: where to begin, shape [N, 2]; at the harmonic extension of the collar without.
        near: the inverse of a tangent near the start, with which Newton's way is tried first; only
            conjugate gradients look for negative curvature then, in a few directions.
        tolerance: of the residual, relative to the largest force.

    Raises InputError for values that are not finite on the collar.
    """
    load, collar = checked_fields(op.points, b, u)
    collar[op.interior] = 0.0
    sheet = Sheet(op, load[op.interior], collar)
    if (times := sheet.too_small()) > 1:
        start = None if start is None else times * start
        larger = find_equilibrium(op, times * load, times * u, start=start, tolerance=tolerance)
        return larger and replace(larger, u=larger.u / times)
    for inverse in (near, None) if near else (None,):
        found, steps, parts, followed = stable_way(sheet, start, inverse, tolerance)
        if found is not None:
            left, scale = sheet.left(found)
            residual = float(np.abs(left).max() / scale)
            return Equilibrium(found, residual, np.nan, steps, parts, followed)
    return None


def smallest_of_tangent(op: Any, u: np.ndarray) -> float:
    """Smallest eigenvalue of the tangent between interior nodes at u [stress / length²].

    Where it is not factorised: its smallest ratio to the Laplacian's quadratic form, times the
    Laplacian's smallest eigenvalue. That has the same sign and, where positive, is not larger.
    """
    sheet, size = Sheet(op, np.zeros((1, 2)), u), 2 * len(op.interior)
    if sheet.rough is None:
        if inverse := op.factors(u)[0]:
            return softest(size, inverse, 1e-3)
        return smallest_eigenvalue(op.interior_tangent(u))  # the nearest to zero may be another

    def flat(apply: Inner) -> LinearOperator:
        of_flat = lambda p: apply(p.reshape(-1, 2)).ravel()  # noqa: E731
        return LinearOperator((size, size), of_flat, dtype=float)

    ends: dict[str, Any] = {"v0": lanczos_start(size), "return_eigenvectors": False}
    K, Minv = flat(lambda p: sheet.jvp(u, p)), flat(op.lattice.laplace)
    L = sp.kron(op.lattice.laplacian[:, op.interior], sp.eye(2)).tocsr()
    found = eigsh(K, 1, L, which="SA", Minv=Minv, tol=1e-2, maxiter=2000, **ends)
    return float(op.lattice.softest * found[0])


@dataclass(frozen=True, eq=False)
class Sheet:
    """A sheet under a load, as the driver asks: fields are of all nodes, loads of the interior."""

    op: Any
    load: np.ndarray
    collar: np.ndarray

    def part(self, share: float) -> Sheet:
        """The same under a share of load and collar."""
        return replace(self, load=share * self.load, collar=share * self.collar)

    def begin(self) -> np.ndarray:
        """Where a search begins."""
        return np.asarray(self.op.lattice.lift(self.collar))

    def on_collar(self, u: np.ndarray) -> np.ndarray:
        """A field with what is given on the collar."""
        return np.where(self.op.points.interior[:, None], u, self.collar)

    def moved(self, u: np.ndarray, step: np.ndarray) -> np.ndarray:
        """A field after a step of the interior."""
        return np.asarray(u + self.op.on_all(step))

    def left(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """What forces leave of the load, and the largest of both."""
        f = self.op.everywhere(u)
        scale = max(np.abs(self.load).max(), np.abs(f).max(), 1e-300)
        return self.load - f[self.op.interior], scale

    def potential(self, u: np.ndarray) -> float:
        """Of all forces, over the area of a node."""
        return float(self.op.nodal_energy(u).sum() - (self.load * u[self.op.interior]).sum())

    def folds(self, u: np.ndarray) -> float:
        """Corners that are turned over, which their energies, functions of C, do not see; infinite
        where the nodal strain folds."""
        return self.op.folded(u) if self.op.smallest_area(u) > SMALLEST_AREA else np.inf

    def jvp(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """The tangent at u along p on the interior."""
        return np.asarray(self.op.jvp(u, self.op.on_all(p)))

    def inverse(self, u: np.ndarray, shifts: bool) -> tuple[Inner | None, bool]:
        """The inverse of the tangent, or of one that is positive definite, and whether it is."""
        found: tuple[Inner | None, bool] = self.op.factors(u, shifts)
        return found

    @property
    def rough(self) -> Inner | None:
        """The inverse that stands for those of all tangents, where none is factorised."""
        return self.op.lattice.laplace if 2 * len(self.op.interior) > DIRECT else None

    def too_small(self) -> float:
        """Times by which load and collar must grow for strains that rounding leaves; or 1.

        Below, what answers them is in proportion: strains are differences of products near one.
        """
        spacing, rest = self.op.points.spacing, np.zeros_like(self.collar)
        strain = float(np.ptp(self.begin(), axis=0).max()) / spacing
        if self.load.any() and strain < LINEAR / 2:
            step = direction(self, rest, self.load, self.rough, False)[0]
            strain = max(strain, float(np.abs(step).max()) / spacing)
        return LINEAR / strain if 0 < strain < LINEAR / 2 else 1.0
