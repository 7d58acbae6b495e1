"""Equilibria of sheets: tangents and their factors, Newton, continuation to stable branches."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.errors import InputError
from warp_peri.materials.hyperelastic.energies import Term
from warp_peri.materials.hyperelastic.operator import SMALLEST_AREA, HyperelasticOperator
from warp_peri.points.arrays import checked_fields
from warp_peri.stability.certificate import lanczos_start, smallest_eigenvalue
from warp_peri.statics.conjugate_gradients import definite
from warp_peri.statics.direct import definite_factors

LARGEST_BAND = 4 * 10**7
"""Entries of a band that is eliminated as one, in a quarter of the time of sparse factors."""


@dataclass(frozen=True, eq=False)
class BandFactors:
    """Cholesky's factors of a banded matrix, as rows of nodes on a lattice have it.

    Attributes:
        factor: the lower triangle by diagonals.
        order: of the unknowns in it.
    """

    factor: np.ndarray
    order: np.ndarray

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y by the factors, in their precision."""
        given = y[self.order].astype(self.factor.dtype)  # else SciPy turns the factor, every time
        x = np.empty(y.shape)
        x[self.order] = cho_solve_banded((self.factor, True), given, check_finite=False)
        return x


@dataclass(frozen=True, eq=False)
class Band:
    """Where the entries of a symmetric sparse matrix stand in a band.

    Attributes:
        order: of the unknowns in it.
        below: which of the entries belong to its lower triangle.
        places: theirs, diagonal by diagonal of each column.
        width: number of diagonals.
    """

    order: np.ndarray
    below: np.ndarray
    places: np.ndarray
    width: int

    @classmethod
    def of(cls, indices: np.ndarray, ends: np.ndarray, order: np.ndarray) -> Band:
        """The band of a matrix by columns."""
        place = np.argsort(order)
        row, column = place[indices], np.repeat(place, np.diff(ends))
        width = int((row - column).max()) + 1
        places = column * width + row - column
        below = np.flatnonzero(row >= column)
        below = below[np.argsort(places[below])]
        return cls(order, below, places[below], width)

    def filled(self, entries: np.ndarray) -> np.ndarray | None:
        """The lower triangle by diagonals; None where they are too many, or entries no numbers."""
        values, size = entries[self.below], self.width * len(self.order)
        if size > LARGEST_BAND or not np.isfinite(values).all():
            return None
        band = np.zeros(size)
        band[self.places] = values
        return band.reshape((self.width, -1), order="F")


def positive_factors(K: sp.csc_matrix, band: Band | None = None) -> Any:
    """Factors with a `solve` of a symmetric matrix where it is positive definite, else None.

    Where its entries stand in a band is found in the order of the unknowns, unless it is given.
    """
    band = band or Band.of(K.indices, K.indptr, np.arange(K.shape[0]))
    if (filled := band.filled(K.data)) is None:
        return definite_factors(K)
    try:
        return BandFactors(cholesky_banded(filled, True, True, check_finite=False), band.order)
    except np.linalg.LinAlgError:
        return None


def rough(factors: Any) -> Any:
    """The same in half the memory where that is large: for fields near by."""
    if isinstance(factors, BandFactors):
        return BandFactors(factors.factor.astype(np.float32), factors.order)
    return factors


@dataclass(frozen=True, eq=False)
class TangentPattern:
    """What the tangent is made of, apart from the field: build once for an operator.

    Attributes:
        op: the operator.
        half: places of the nodes in a row, 0 and one of each ±, by lattice steps.
        row: of every node, the number of interior nodes I for those of the collar, shape [N].
        taken: places in blocks [half, 2, 2, I] that are entries of the matrix, row by row.
        columns: their columns.
        ends: where rows begin among them.
        band: of the matrix, narrow by lines of nodes along the shorter side.
    """

    op: HyperelasticOperator
    half: dict[tuple[int, ...], int]
    row: np.ndarray
    taken: np.ndarray
    columns: np.ndarray
    ends: np.ndarray
    band: Band

    @classmethod
    def of(cls, op: HyperelasticOperator) -> TangentPattern:
        """The pattern of an operator."""
        bonds, interior, inside = op.bonds, op.interior, len(op.interior)
        family = np.concatenate([0 * bonds.steps[:1], bonds.steps])
        steps = np.unique((family[:, None] + family).reshape(-1, 2), axis=0)
        middle = len(steps) // 2  # they are in order, ξ before 0 before −ξ
        number = np.full(len(bonds.grid) + 1, inside)  # the last is of no node
        number[interior] = np.arange(inside)
        far = number[bonds.beside(steps)[:, interior]]
        which, row = np.nonzero(far < inside)
        column, turned = far[which, row], (which < middle)[:, None, None]
        a, b = np.indices((2, 2))
        block = 4 * np.abs(which - middle)[:, None, None] + np.where(turned, 2 * b + a, 2 * a + b)
        taken = inside * block + np.where(turned[:, 0, 0], column, row)[:, None, None]
        rows, columns = ((2 * n[:, None, None] + k).ravel() for n, k in ((row, a), (column, b)))
        order = np.lexsort((columns, rows))
        ends = np.searchsorted(rows[order], np.arange(2 * inside + 1)).astype(np.int32)
        inner = bonds.grid[interior]
        shorter = int(np.argmin(np.ptp(inner, axis=0)))
        nodes = np.lexsort((inner[:, shorter], inner[:, 1 - shorter]))
        unknowns = np.stack([2 * nodes, 2 * nodes + 1], axis=1).ravel()
        columns = columns[order].astype(np.int32)
        half = {tuple(step): n for n, step in enumerate(steps[middle:].tolist())}
        band = Band.of(columns, ends, unknowns)
        return cls(op, half, number[:-1], taken.ravel()[order], columns, ends, band)

    def matrix(self, u: np.ndarray, c: np.ndarray) -> sp.csc_matrix:
        """K between interior nodes at a field u of shape [N, 2], (H10), shape [2 I, 2 I]."""
        size = len(self.ends) - 1
        entries = self._blocks(u, c).ravel()[self.taken]  # symmetric: rows stand for columns
        return sp.csc_matrix((entries, self.columns, self.ends), shape=(size, size))

    def factors(self, u: np.ndarray, c: np.ndarray) -> Any:
        """Factors of that matrix where it is positive definite, else None."""
        return positive_factors(self.matrix(u, c), self.band)

    def _blocks(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Blocks of the rows at the steps of a half, shape [half, 2, 2, I]."""
        op, inside = self.op, self.op.interior
        K, axis = np.zeros((len(self.half), 2, 2, len(inside))), np.arange(2)
        tension, Y, curved = op.curvatures(u, c)
        K[0, axis, axis] = abs(op.bonds.ends[inside]) @ tension
        for k, step in enumerate(op.bonds.steps[: op.bonds.classes].tolist()):
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


FEW = 1200
"""Unknowns up to which the tangent of every step is factorised."""
KRYLOV = 1e-4
"""Residual that conjugate gradients leave of a step's equation."""
MANY = 12
"""Products that make factors of another tangent dearer than its own."""
DIRECT = 20_000
"""Unknowns up to which the tangent is factorised; beyond, conjugate gradients take its products."""
LINEAR = 1e-5
"""Strain below which what rounding leaves of forces is seen, and answers are in proportion."""
SMALLEST_STEP = 1 / 64
"""Of the load, in continuation."""
STIFFER = 6.0
"""Times that deviations are stiffened where a plain solve fails; then they soften again."""
SOFTENING = (1.5, 1.01)
"""Largest and smallest ratio of two stiffnesses on that way."""


class NoEquilibrium(RuntimeError):
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
        followed: whether stable equilibria lead to it, from rest along the load or from stiffer
            deviations, as far as the steps tell; false for another minimum, found by going down.
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
        self.pattern = TangentPattern.of(self.op) if 2 * len(op.interior) <= direct else None
        near, inside = op.bonds.ends[:, op.bonds.pairs[2] < 2], op.points.interior
        laplacian = (near @ near.T).tocsr()[op.interior] / op.bonds.spacing**2
        self._laplacian, self._to_collar = (
            laplacian[:, inside],
            laplacian @ sp.diags_array(1.0 * ~inside),
        )
        self._laplace = splu(self._laplacian.tocsc())
        self._count = 0  # of Newton steps of a search
        self.softest = _nearest_zero(self._laplacian, self._laplace.solve, 1e-4)

    def lift(self, u: np.ndarray) -> np.ndarray:
        """u with its interior replaced by the harmonic extension of the collar."""
        lifted = u.copy()
        lifted[self.op.interior] = self._laplace.solve(-(self._to_collar @ u))
        return lifted

    def solve(
        self, c: np.ndarray, b: np.ndarray | None, u: np.ndarray, *, start: np.ndarray | None = None
    ) -> Equilibrium:
        """The stable equilibrium under a load with displacement given on the collar.

        Args:
            c: coefficients, shape [K].
            b: body force on all nodes [stress / length], shape [N, 2]; none for no load.
            u: displacement, shape [N, 2]; read on the collar only.
            start: where to begin; at the harmonic extension of the collar where none is given.

        Warns where the answer is not followed from rest. Raises NoEquilibrium; InputError for
        arrays of other shapes or with values that are not finite on the collar.
        """
        equilibrium = self.find(c, b, u, start=start)
        if equilibrium is None:
            raise NoEquilibrium("no stable equilibrium found on the way to all of load and collar")
        if not equilibrium.followed:
            warnings.warn(
                "the branch of stable equilibria that begins at rest ended before all of load and "
                "collar; what is returned is another minimum, perhaps one of many",
                stacklevel=2,
            )
        smallest = self.smallest_eigenvalue(c, equilibrium.u)
        if not smallest > 0:
            raise NoEquilibrium(f"the equilibrium found is unstable: eigenvalue {smallest:.3g}")
        return replace(equilibrium, smallest_eigenvalue=smallest / self.softest)

    def find(
        self,
        c: np.ndarray,
        b: np.ndarray | None,
        u: np.ndarray,
        *,
        start: np.ndarray | None = None,
        near: Any = None,
    ) -> Equilibrium | None:
        """As solve, without the smallest eigenvalue (NaN); None where no equilibrium is found.

        The tangent was positive definite in the last step all the same, unless factors of one
        `near` the start are given: then Newton's way from there alone is tried, and conjugate
        gradients saw no negative curvature in a few directions.
        """
        nodes, inside = self.op.points.x.shape, self.op.points.interior
        load, collar = checked_fields(self.op.points, b, u)
        if collar.shape != nodes:
            raise InputError(f"u: expected shape {list(nodes)}, got {list(collar.shape)}")
        load, collar[inside] = load[inside], 0.0
        first = self.lift(collar) if start is None else start
        if (times := self._too_small(c, load, collar)) > 1:
            known = None if start is None else times * start
            larger = self.find(c, None if b is None else times * b, times * u, start=known)
            return larger and replace(larger, u=larger.u / times)
        self._count, steps, followed = 0, 1, True
        first = np.where(inside[:, None], first, collar)
        field = self._newton(c, load, first, near=near)
        if field is None and near is None:
            softened, factor = self._soften(c, load, collar, first)
            field = softened if factor == 1.0 else None
            if field is None:
                branch, done, steps = self._continue(c, load, collar)
                followed = done == 1.0
                field = branch if followed else None
                ahead = np.where(inside[:, None], branch / (done or 1.0), collar)
                for guess in (softened, ahead, first):
                    if field is None and guess is not None:
                        field = self._newton(c, load, guess, shifts=True)
        if field is None:
            return None
        f = self.op.everywhere(field, c)
        left = load - f[self.op.interior]
        residual = float(np.abs(left).max() / max(np.abs(load).max(), np.abs(f).max(), 1e-300))
        return Equilibrium(field, residual, np.nan, self._count, steps, followed)

    def _too_small(self, c: np.ndarray, load: np.ndarray, collar: np.ndarray) -> float:
        """Times by which load and collar must grow for strains that rounding leaves; or 1.

        Below, what answers them is in proportion: strains are differences of products near one.
        """
        strain = float(np.ptp(self.lift(collar), axis=0).max()) / self.op.bonds.spacing
        if load.any() and strain < LINEAR / 2:
            step = self._direction(c, np.zeros_like(collar), load, False)[0]
            strain = max(strain, float(np.abs(step).max()) / self.op.bonds.spacing)
        return LINEAR / strain if 0 < strain < LINEAR / 2 else 1.0

    def with_terms(self, terms: Sequence[Term]) -> StaticProblem:
        """The same lattice with other strain energies; what is built once is shared."""
        return self._with(self.op.with_terms(terms))

    def with_thickness(self, thickness: np.ndarray | None) -> StaticProblem:
        """The same lattice with another thickness of every node, shape [N]."""
        return self._with(self.op.with_thickness(thickness))

    def _with(self, op: HyperelasticOperator) -> StaticProblem:
        other = copy(self)
        other.op, other.pattern = op, self.pattern and replace(self.pattern, op=op)
        return other

    def _soften(
        self, c: np.ndarray, load: np.ndarray, collar: np.ndarray, first: np.ndarray
    ) -> tuple[np.ndarray | None, float]:
        """Solve with stiffer deviations and follow the answer while they soften.

        The last answer, and how stiff its deviations were.
        """
        deviations = slice(self.op.dictionary.first_deviation, self.op.dictionary.first_term)
        stiff, factor, ratio = c.copy(), STIFFER, SOFTENING[0]
        if not np.any(c[deviations] > 0):
            return None, factor
        stiff[deviations] *= factor
        last = self._newton(stiff, load, first)
        if last is None:
            branch, done, _ = self._continue(stiff, load, collar)
            last = branch if done == 1.0 else None
        while last is not None and factor > 1.0 and ratio > SOFTENING[1]:
            target = max(1.0, factor / ratio)
            stiff[deviations] = target * c[deviations]
            field = self._newton(stiff, load, last)
            if field is None:
                ratio = ratio**0.5
            else:
                last, factor = field, target
        return last, factor

    def _continue(
        self, c: np.ndarray, load: np.ndarray, collar: np.ndarray
    ) -> tuple[np.ndarray, float, int]:
        """Follow load and collar from rest: the last field, how far, load steps."""
        done, step, steps = 0.0, 0.25, 0
        now = before = np.zeros_like(collar)
        last = 0.0
        while done < 1 and step >= SMALLEST_STEP:
            target = min(1.0, done + step)
            if done > last:
                guess = now + (target - done) / (done - last) * (now - before)
            else:
                guess = self.lift(target * collar)
            field = self._newton(c, target * load, guess)
            if field is None:
                step /= 2
            else:
                before, last, now, done, steps = now, done, field, target, steps + 1
        return now, done, steps

    def _newton(
        self,
        c: np.ndarray,
        load: np.ndarray,
        u: np.ndarray,
        *,
        shifts: bool = False,
        near: Any = None,
    ) -> np.ndarray | None:
        """Minimise the potential from u; None where that does not end in an equilibrium.

        Without shifts it also ends where the tangent is not positive definite: the branch of
        stable equilibria that u lies near has been left. With factors of a tangent near none is
        factorised. Else, of many unknowns, the first and the last are.
        """
        if self.op.smallest_area(u) <= SMALLEST_AREA:
            return None
        given, again = near is not None, not shifts and 2 * len(self.op.interior) > FEW
        for _ in range(60 if shifts else 15):
            f = self.op.everywhere(u, c)
            residual = load - f[self.op.interior]
            scale = max(np.abs(load).max(), np.abs(f).max(), 1e-300)
            if not np.isfinite(f).all():  # a bond or the short strain is folded
                return None
            small = np.abs(residual).max() <= self.tolerance * scale
            if small and not given:
                near = None
            step, shift, factor = self._direction(c, u, residual, shifts, near)
            near = factor if given or again else None
            if shift > 0 and not shifts:
                return None
            if small and shift == 0.0:
                return None if self._folded(u) else u
            moved = self._search(c, load, u, step, residual, scale)
            if moved is None:
                return None
            self._count, u = self._count + 1, moved
        return None

    def _direction(
        self, c: np.ndarray, u: np.ndarray, residual: np.ndarray, shifts: bool, near: Any = None
    ) -> tuple[np.ndarray, float, Any]:
        """A direction of descent, the shift that makes the tangent positive definite, factors."""
        if self.pattern is None:
            return *self._krylov(c, u, residual, self._laplace.solve)[:2], None
        if near is not None:
            inverse = lambda r: near.solve(r.ravel()).reshape(r.shape)  # noqa: E731
            step, shift, products = self._krylov(c, u, residual, inverse)
            if shift == 0:
                return step, shift, near if products <= MANY else None
        K = self.pattern.matrix(u, c)
        shift, diagonal = 0.0, K.diagonal()
        size = 1e-3 * abs(diagonal).max()
        for _ in range(12):
            factor = positive_factors(K, self.pattern.band)
            if factor is not None:
                return factor.solve(residual.ravel()).reshape(residual.shape), shift, factor
            shift = size if shift == 0 else 4 * shift
            K.setdiag(diagonal + shift)  # a sum would drop entries that are zero
            if not shifts:
                break
        return residual / size, size, None

    def _krylov(
        self,
        c: np.ndarray,
        u: np.ndarray,
        residual: np.ndarray,
        inverse: Callable[[np.ndarray], np.ndarray],
    ) -> tuple[np.ndarray, float, int]:
        """Direction, shift and products of conjugate gradients.

        At negative curvature it is what the inverse answers.
        """
        v = np.zeros_like(u)

        def product(p: np.ndarray) -> np.ndarray:
            v[self.op.interior] = p
            return self.op.product(u, c, v)[self.op.interior]

        try:
            step, record = definite(product, inverse, residual, KRYLOV)
        except InputError:
            return inverse(residual), 1.0, 0
        return step, 0.0, record.iterations

    def _search(
        self,
        c: np.ndarray,
        load: np.ndarray,
        u: np.ndarray,
        step: np.ndarray,
        residual: np.ndarray,
        scale: float,
    ) -> np.ndarray | None:
        """u after the longest step that lowers the potential, or the residual near the end."""
        inner = self.op.interior

        def potential(u: np.ndarray) -> float:
            return float(self.op.energy(u, c) / self.op.bonds.spacing**2 - (load * u[inner]).sum())

        before, slope, folded = potential(u), (residual * step).sum(), self._folded(u)
        part, moved = 1.0, u.copy()
        while part > 1e-4:
            moved[inner] = u[inner] + part * step
            if self.op.smallest_area(moved) > SMALLEST_AREA and self._folded(moved) <= folded:
                if potential(moved) <= before - 1e-4 * part * slope:
                    return moved
                left = load - self.op.everywhere(moved, c)[inner]
                nearer = np.linalg.norm(left) < 0.5 * np.linalg.norm(residual)
                if nearer or np.abs(left).max() < self.tolerance * scale:
                    return moved
            part /= 2
        return None

    def _folded(self, u: np.ndarray) -> int:
        """Corners that are turned over, which their energies, functions of C, do not see."""
        return self.op.folded(u) if self.op.dictionary.cornered else 0

    def smallest_eigenvalue(self, c: np.ndarray, u: np.ndarray) -> float:
        """Smallest eigenvalue of the tangent between interior nodes at u [stress / length²].

        Where it is not factorised: its smallest ratio to the Laplacian's quadratic form, times the
        Laplacian's smallest eigenvalue. That has the same sign and, where positive, is not larger.
        """
        if self.pattern is not None:
            K = self.pattern.matrix(u, c)
            factor = positive_factors(K, self.pattern.band)
            if factor is None:  # what is nearest to zero need not be the smallest
                return smallest_eigenvalue(K)
            return _nearest_zero(K, factor.solve, 1e-3)
        inner, v = self.op.interior, np.zeros_like(u)

        def product(p: np.ndarray) -> np.ndarray:
            v[inner] = p.reshape(-1, 2)
            Kp: np.ndarray = self.op.product(u, c, v)[inner].ravel()
            return Kp

        size = 2 * len(inner)
        K = LinearOperator((size, size), product, dtype=float)
        L = sp.kron(self._laplacian, sp.eye(2)).tocsr()
        inverse = LinearOperator(
            (size, size), lambda p: self._laplace.solve(p.reshape(-1, 2)).ravel(), dtype=float
        )
        values = eigsh(
            K, 1, M=L, Minv=inverse, which="SA", v0=lanczos_start(size), return_eigenvectors=False,
            tol=1e-2, maxiter=2000,
        )  # fmt: skip
        return float(values[0]) * self.softest


def _nearest_zero(K: Any, solve: Callable[[np.ndarray], np.ndarray], tolerance: float) -> float:
    """The eigenvalue of a symmetric matrix that is nearest to zero."""
    if K.shape[0] == 1:
        return float(K.diagonal()[0])
    inverse, start = LinearOperator(K.shape, solve, dtype=float), lanczos_start(K.shape[0])
    ends = {"v0": start, "return_eigenvectors": False, "tol": tolerance}
    return float(eigsh(K, 1, sigma=0, OPinv=inverse, **ends)[0])
