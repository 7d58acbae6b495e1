"""Equilibria of sheets: their tangent as a band, and the ways of the one driver to a stable one."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.errors import InputError, warn
from warp_peri.materials.hyperelastic.operator import SMALLEST_AREA, HyperelasticOperator
from warp_peri.points.arrays import checked_fields
from warp_peri.points.lattice import neighbour_table
from warp_peri.solvers.direct import lanczos_start, smallest_eigenvalue
from warp_peri.solvers.equilibria import Inner, direction, stable_way

DIRECT = 20_000
"""Unknowns up to which the tangent is factorised; beyond, conjugate gradients take its products."""
LINEAR = 1e-5
"""Strain below which what rounding leaves of forces is seen, and answers are in proportion."""
SHIFTS = 1e-3 * 4.0 ** np.arange(12)
"""Of the largest entry of the diagonal, added to all until a tangent is positive definite."""


@dataclass(frozen=True, eq=False)
class BandFactors:
    """Cholesky's factors of a tangent, by diagonals, its unknowns in another order."""

    band: np.ndarray
    order: np.ndarray

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y by the factors, in their precision."""
        given = y[self.order].astype(self.band.dtype)  # else SciPy turns the band, every time
        x = np.empty(y.shape)
        x[self.order] = cho_solve_banded((self.band, True), given, check_finite=False)
        return x

    def inverse(self, r: np.ndarray) -> np.ndarray:
        """The same of a residual [I, 2]."""
        return self.solve(r.ravel()).reshape(r.shape)

    def rough(self) -> BandFactors:
        """The same in half the memory, for fields near by."""
        return BandFactors(self.band.astype(np.float32), self.order)


class TangentPattern:
    """Where the entries of the tangent between interior nodes stand: built once for an operator.

    Attributes:
        half: places of the nodes in a row, 0 and one of each ±, by lattice steps.
        row: of every node, the number of interior nodes I for those of the collar, shape [N].
        taken: places in blocks [half, 2, 2, I] of the entries of half of the matrix.
        places: their rows and columns.
        doubled: which of them stand on blocks of the diagonal, where both halves do.
        order: of the unknowns in a band that is narrow, by lines of nodes along the shorter side.
        width: number of its diagonals.
    """

    def __init__(self, op: HyperelasticOperator) -> None:
        bonds, interior, inside = op.bonds, op.interior, len(op.interior)
        family = np.concatenate([0 * bonds.steps[:1], bonds.steps])
        steps = np.unique((family[:, None] + family).reshape(-1, 2), axis=0)
        steps = steps[len(steps) // 2 :]  # they are in order, ξ before 0 before −ξ
        self.half = {tuple(step): n for n, step in enumerate(steps.tolist())}
        number = np.full(len(bonds.grid) + 1, inside)  # the last is of no node
        number[interior] = np.arange(inside)
        self.row = number[:-1]
        far = number[neighbour_table(bonds.grid, steps)[interior]].T
        which, row = np.nonzero(far < inside)
        a, b = np.indices((2, 2)).reshape(2, 4, 1)
        self.taken = inside * (4 * which + 2 * a + b) + row
        self.places = 2 * row + a, 2 * far[which, row] + b
        self.doubled = which == 0
        inner = bonds.grid[interior]
        shorter = int(np.argmin(np.ptp(inner, axis=0)))
        nodes = np.lexsort((inner[:, shorter], inner[:, 1 - shorter]))
        self.order = (2 * nodes[:, None] + [0, 1]).ravel()
        ends = np.sort(np.argsort(self.order)[np.stack(self.places)], axis=0)
        self._at = ends[1] - ends[0], ends[0]
        self.width = int(self._at[0].max()) + 1

    def matrix(self, op: HyperelasticOperator, u: np.ndarray, c: np.ndarray) -> sp.csc_matrix:
        """K between interior nodes at a field u of shape [N, 2], (H10), shape [2 I, 2 I]."""
        entries = np.where(self.doubled, 0.5, 1.0) * self._blocks(op, u, c).ravel()[self.taken]
        half = sp.coo_matrix((entries.ravel(), [each.ravel() for each in self.places]))
        return (half + half.T).tocsc()

    def factors(
        self, op: HyperelasticOperator, u: np.ndarray, c: np.ndarray, shifts: bool = False
    ) -> tuple[BandFactors | None, bool]:
        """Factors of that matrix where it is positive definite, and whether it is.

        With shifts of it and a multiple of one that is enough, where it is not.
        """
        band = np.zeros((self.width, len(self.order)), order="F")
        band[self._at] = self._blocks(op, u, c).ravel()[self.taken]
        diagonal = band[0].copy()
        for shift in (0.0, *SHIFTS) if shifts else (0.0,):
            band[0] = diagonal + shift * np.abs(diagonal).max()
            try:
                return BandFactors(cholesky_banded(band, lower=True), self.order), shift == 0
            except (np.linalg.LinAlgError, ValueError):  # not definite, or no numbers
                continue
        return None, False

    def _blocks(self, op: HyperelasticOperator, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Blocks of the rows at the steps of a half, shape [half, 2, 2, I]."""
        inside = op.interior
        K, axis = np.zeros((len(self.half), 2, 2, len(inside))), np.arange(2)
        tension, Y, curved = op.curvatures(u, c)
        K[0, axis, axis] = abs(op.bonds.ends[inside]) @ tension
        for k, step in enumerate(op.bonds.steps[: len(op.bonds.steps) // 2].tolist()):
            K[self.half[tuple(step)], axis, axis] = -tension[op.bonds.number[inside, k]]
        for patch, H in curved:
            count = H.shape[-1]
            B = np.zeros((len(patch.offsets), len(H), 2, count + 1))  # ∂q/∂u; the last of no site
            for low, high, w, bond in zip(*patch.ends, patch.weights, patch.bonds):
                change = w[:, None, None] * Y[:, bond]
                B[low, ..., :-1] -= change
                B[high, ..., :-1] += change
            all_bent = np.einsum("pqn,vqin->vpin", np.pad(H, ((0, 0), (0, 0), (0, 1))), B)
            for bent, offset, nodes in zip(all_bent, patch.offsets, patch.nodes):
                at = np.full(len(inside) + 1, count)
                at[self.row[nodes]] = np.arange(count)
                steps = [tuple(step) for step in (patch.offsets - offset).tolist()]
                others = [v for v, step in enumerate(steps) if step in self.half]
                blocks = np.einsum("pin,vpjn->vijn", bent, B[others])
                places = [self.half[steps[v]] for v in others]
                K[places] += np.take(blocks, at[:-1], axis=-1, mode="clip")
        return K


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
            unknowns it is a lower bound of that, see StaticProblem.smallest_eigenvalue.
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


class StaticProblem:
    """Equilibria of one dictionary on one lattice, for many coefficients, loads and collars.

    A search begins at the harmonic extension of the collar, by the five-point Laplacian.

    Args:
        op: the operator.
        tolerance: of the residual, relative to the largest force.
        direct: unknowns up to which the tangent is factorised.
    """

    def __init__(
        self, op: HyperelasticOperator, *, tolerance: float = 1e-8, direct: int = DIRECT
    ) -> None:
        self.op, self.tolerance = op.near_interior(), tolerance
        self.pattern = TangentPattern(op) if 2 * len(op.interior) <= direct else None
        near, inside = op.bonds.ends[:, op.bonds.pairs[2] < 2], op.points.interior
        laplacian = (near @ near.T).tocsr()[op.interior] / op.bonds.spacing**2
        self._laplacian = laplacian[:, inside]
        self._to_collar = laplacian @ sp.diags_array(1.0 * ~inside)
        self.laplace = splu(self._laplacian.tocsc()).solve
        self.softest = _softest(len(op.interior), self.laplace, 1e-4)

    def lift(self, u: np.ndarray) -> np.ndarray:
        """u with its interior replaced by the harmonic extension of the collar."""
        lifted = u.copy()
        lifted[self.op.interior] = self.laplace(-(self._to_collar @ u))
        return lifted

    def of(self, op: HyperelasticOperator) -> StaticProblem:
        """The same lattice with other energies or thickness; what is built once is shared."""
        other = copy(self)
        other.op = op
        return other

    def solve(self, c: np.ndarray, b: np.ndarray | None, u: np.ndarray) -> Equilibrium:
        """The stable equilibrium under a load with displacement given on the collar.

        Args:
            c: coefficients, shape [K].
            b: body force on all nodes [stress / length], shape [N, 2]; none for no load.
            u: displacement, shape [N, 2]; read on the collar only.

        Warns where the answer is not followed from rest. Raises NoEquilibriumError; InputError for
        arrays of other shapes or with values that are not finite on the collar.
        """
        equilibrium = self.find(c, b, u)
        if equilibrium is None:
            raise NoEquilibriumError(
                "no stable equilibrium found on the way to all of load and collar"
            )
        if not equilibrium.followed:
            warn(
                "the branch of stable equilibria that begins at rest ended before all of load and "
                "collar; what is returned is another minimum, perhaps one of many"
            )
        smallest = self.smallest_eigenvalue(c, equilibrium.u)
        if not smallest > 0:
            raise NoEquilibriumError(
                f"the equilibrium found is unstable: eigenvalue {smallest:.3g}"
            )
        return replace(equilibrium, smallest_eigenvalue=smallest / self.softest)

    def find(
        self,
        c: np.ndarray,
        b: np.ndarray | None,
        u: np.ndarray,
        *,
        start: np.ndarray | None = None,
        near: BandFactors | None = None,
    ) -> Equilibrium | None:
        """As solve, without the smallest eigenvalue (NaN); None where no equilibrium is found.

        It begins at the harmonic extension of the collar where no start is given.

        The tangent was positive definite in the last step all the same, unless factors of one
        `near` the start are given: then Newton's way from there alone is tried, and conjugate
        gradients saw no negative curvature in a few directions.
        """
        nodes, inside = self.op.points.x.shape, self.op.points.interior
        load, collar = checked_fields(self.op.points, b, u)
        if collar.shape != nodes:
            raise InputError(f"u: expected shape {list(nodes)}, got {list(collar.shape)}")
        collar[inside] = 0.0
        sheet = Sheet(self, c, load[inside], collar)
        if (times := sheet.too_small()) > 1:
            known = None if start is None else times * start
            larger = self.find(c, None if b is None else times * b, times * u, start=known)
            return larger and replace(larger, u=larger.u / times)
        inverse = None if near is None else near.inverse
        found, steps, parts, followed = stable_way(sheet, start, inverse, self.tolerance)
        if found is None:
            return None
        left, scale = sheet.left(found)
        residual = float(np.abs(left).max() / scale)
        return Equilibrium(found, residual, np.nan, steps, parts, followed)

    def factors(self, c: np.ndarray, u: np.ndarray, shifts: bool = False) -> Any:
        """As TangentPattern.factors."""
        if self.pattern is None:
            raise InputError("problem: expected one whose tangent is factorised")
        return self.pattern.factors(self.op, u, c, shifts)

    def smallest_eigenvalue(self, c: np.ndarray, u: np.ndarray) -> float:
        """Smallest eigenvalue of the tangent between interior nodes at u [stress / length²].

        Where it is not factorised: its smallest ratio to the Laplacian's quadratic form, times the
        Laplacian's smallest eigenvalue. That has the same sign and, where positive, is not larger.
        """
        shape = 2 * (2 * len(self.op.interior),)
        if self.pattern is not None:
            factors = self.factors(c, u)[0]
            if factors is None:  # what is nearest to zero need not be the smallest
                return smallest_eigenvalue(self.pattern.matrix(self.op, u, c))
            return _softest(shape[0], factors.solve, 1e-3)
        sheet = Sheet(self, c, np.zeros((1, 2)), u)

        def flat(apply: Inner) -> LinearOperator:
            of_flat = lambda p: apply(p.reshape(-1, 2)).ravel()  # noqa: E731
            return LinearOperator(shape, of_flat, dtype=float)

        L, start = sp.kron(self._laplacian, sp.eye(2)).tocsr(), lanczos_start(shape[0])
        ends: dict[str, Any] = {"v0": start, "return_eigenvectors": False, "maxiter": 2000}
        K, Minv = flat(lambda p: sheet.jvp(u, p)), flat(self.laplace)
        return self.softest * float(eigsh(K, 1, L, which="SA", Minv=Minv, tol=1e-2, **ends)[0])


@dataclass(frozen=True, eq=False)
class Sheet:
    """A sheet under a load, as the driver asks: fields are of all nodes, loads of the interior."""

    problem: StaticProblem
    c: np.ndarray
    load: np.ndarray
    collar: np.ndarray

    def part(self, share: float) -> Sheet:
        """The same under a share of load and collar."""
        return replace(self, load=share * self.load, collar=share * self.collar)

    def begin(self) -> np.ndarray:
        """Where a search begins."""
        return self.problem.lift(self.collar)

    def on_collar(self, u: np.ndarray) -> np.ndarray:
        """A field with what is given on the collar."""
        return np.where(self.problem.op.points.interior[:, None], u, self.collar)

    def moved(self, u: np.ndarray, step: np.ndarray) -> np.ndarray:
        """A field after a step of the interior."""
        u = u.copy()
        u[self.problem.op.interior] += step
        return u

    def left(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """What forces leave of the load, and the largest of both."""
        f = self.problem.op.everywhere(u, self.c)
        scale = max(np.abs(self.load).max(), np.abs(f).max(), 1e-300)
        return self.load - f[self.problem.op.interior], scale

    def potential(self, u: np.ndarray) -> float:
        """Of all forces, over the area of a node."""
        op = self.problem.op
        return float(op.nodal_energy(u, self.c).sum() - (self.load * u[op.interior]).sum())

    def folds(self, u: np.ndarray) -> float:
        """Corners that are turned over, which their energies, functions of C, do not see; infinite
        where the nodal strain folds."""
        op = self.problem.op
        if not op.smallest_area(u) > SMALLEST_AREA:
            return np.inf
        return op.folded(u) if op.dictionary.cornered else 0

    def jvp(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """The tangent at u along p on the interior."""
        op = self.problem.op
        return op.jvp(u, self.c, self.moved(0 * u, p))[op.interior]

    def inverse(self, u: np.ndarray, shifts: bool) -> tuple[Inner | None, bool]:
        """The inverse of the tangent, or of one that is positive definite, and whether it is."""
        factors, stable = self.problem.factors(self.c, u, shifts)
        return factors and factors.inverse, stable

    @property
    def rough(self) -> Inner | None:
        """The inverse that stands for those of all tangents, where none is factorised."""
        return None if self.problem.pattern else self.problem.laplace

    def too_small(self) -> float:
        """Times by which load and collar must grow for strains that rounding leaves; or 1.

        Below, what answers them is in proportion: strains are differences of products near one.
        """
        spacing, rest = self.problem.op.bonds.spacing, np.zeros_like(self.collar)
        strain = float(np.ptp(self.begin(), axis=0).max()) / spacing
        if self.load.any() and strain < LINEAR / 2:
            step = direction(self, rest, self.load, self.rough, False)[0]
            strain = max(strain, float(np.abs(step).max()) / spacing)
        return LINEAR / strain if 0 < strain < LINEAR / 2 else 1.0


def _softest(size: int, inverse: Inner, tolerance: float) -> float:
    """The smallest eigenvalue of what is positive, by its inverse."""
    if size <= 2:
        return 1 / float(np.linalg.eigvalsh(inverse(np.eye(size)))[-1])
    ends = {"v0": lanczos_start(size), "return_eigenvectors": False, "tol": tolerance}
    K = LinearOperator((size, size), inverse, dtype=float)
    return 1 / float(eigsh(K, 1, which="LA", **ends)[0])
