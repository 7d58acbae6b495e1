"""Equilibria of sheets: tangents and their factors, Newton, continuation to stable branches."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.errors import InputError
from warp_peri.kernels.hyperelastic.corner_tangent import corner_tangents
from warp_peri.kernels.hyperelastic.rows import Window, tangent_rows
from warp_peri.launch import ints, launch, zeros
from warp_peri.points.arrays import checked_fields
from warp_peri.stability.certificate import lanczos_start, smallest_eigenvalue
from warp_peri.statics.direct import definite_factors
from warp_peri.tissue.operator import SMALLEST_AREA, HyperelasticOperator, laplacian
from warp_peri.tissue.solid import Term

DENSE = 1200
"""Unknowns up to which a matrix is eliminated as a full one: tangents have hundreds in each row."""


LARGEST_BAND = 4 * 10**7
"""Entries of a band that is eliminated as one, in a quarter of the time of sparse factors."""


class FullFactors:
    """Cholesky's factors of a full matrix."""

    def __init__(self, factor: np.ndarray) -> None:
        self.factor = factor

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y by the factors."""
        x: np.ndarray = lapack.dpotrs(self.factor, y, lower=1)[0].reshape(y.shape)
        return x


class BandFactors:
    """Cholesky's factors of a banded matrix, as rows of nodes on a lattice have it.

    Args:
        factor: the lower triangle by diagonals.
        order: of the unknowns in it.
    """

    def __init__(self, factor: np.ndarray, order: np.ndarray) -> None:
        self.factor, self.order, self.shape = factor, order, (factor.shape[1],) * 2

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
    if K.shape[0] > DENSE:
        band = band or Band.of(K.indices, K.indptr, np.arange(K.shape[0]))
        if (filled := band.filled(K.data)) is None:
            return definite_factors(K)
        try:
            return BandFactors(cholesky_banded(filled, True, True, check_finite=False), band.order)
        except np.linalg.LinAlgError:
            return None
    factor, fault = lapack.dpotrf(K.toarray(order="F"), lower=1, overwrite_a=1, clean=0)
    # LAPACK need not call numbers that are none a fault
    return None if fault or not np.isfinite(factor.diagonal()).all() else FullFactors(factor)


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
        window: where the nodes around another stand in its row, as the kernel reads it.
        width: number of places in a row.
        rows: interior nodes.
        taken: places that are entries of the matrix, row by row.
        columns: their columns.
        ends: where rows begin among them.
        band: of the matrix, narrow by lines of nodes along the shorter side.
    """

    op: HyperelasticOperator
    window: Any
    width: int
    rows: Any
    taken: np.ndarray
    columns: np.ndarray
    ends: np.ndarray
    band: Band

    @classmethod
    def of(cls, op: HyperelasticOperator) -> TangentPattern:
        """The pattern of an operator."""
        steps, interior, C = op.bonds.steps, op.interior, op.bonds.classes
        near = np.flatnonzero((op.weight[:, 3:] != 0).any(axis=1))
        linked = np.flatnonzero(op.deviation >= 0)
        reach = 2 * int(np.abs(steps).max())
        side = 2 * reach + 1
        stride = np.array([side, 1])
        window: Any = Window()
        window.shift, window.centre = ints(steps @ stride), reach * side + reach
        window.near, window.linked = (ints(np.concatenate([p, p + C])) for p in (near, linked))
        place = op.bonds.grid - op.bonds.grid.min(axis=0)
        number = np.full(place.max(axis=0) + 1 + 2 * reach, -1)
        number[tuple((place[interior] + reach).T)] = np.arange(len(interior))
        offsets = reached(steps, near, np.union1d(near, linked))
        far = np.stack([number[tuple((place[interior] + reach + o).T)] for o in offsets], axis=1)
        row, which = np.nonzero(far >= 0)
        block = row * side**2 + window.centre + offsets[which] @ stride
        axis = np.arange(2)
        taken = 4 * block[:, None, None] + 2 * axis[:, None] + axis
        rows = np.broadcast_to(2 * row[:, None, None] + axis[:, None], taken.shape).ravel()
        columns = np.broadcast_to(2 * far[row, which][:, None, None] + axis, taken.shape).ravel()
        order = np.lexsort((columns, rows))
        ends = np.searchsorted(rows[order], np.arange(2 * len(interior) + 1))
        inner = place[interior]
        shorter = int(np.argmin(np.ptp(inner, axis=0)))
        nodes = np.lexsort((inner[:, shorter], inner[:, 1 - shorter]))
        columns = columns[order].astype(np.int32)
        unknowns = np.stack([2 * nodes, 2 * nodes + 1], axis=1).ravel()
        return cls(
            op, window, side**2, ints(interior), taken.ravel()[order],
            columns, ends.astype(np.int32), Band.of(columns, ends, unknowns),
        )  # fmt: skip

    def matrix(self, u: np.ndarray, c: np.ndarray) -> sp.csc_matrix:
        """K between interior nodes at a field u of shape [N, 2], (H10), shape [2 I, 2 I]."""
        size = len(self.ends) - 1
        # symmetric: rows stand for columns
        return sp.csc_matrix((self._entries(u, c), self.columns, self.ends), shape=(size, size))

    def factors(self, u: np.ndarray, c: np.ndarray) -> Any:
        """Factors of that matrix where it is positive definite, else None."""
        return positive_factors(self.matrix(u, c), self.band)

    def _entries(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Entries of the matrix, row by row."""
        op = self.op
        field, terms, E, G, H = op.curved_states(u, c)
        pair = wp.types.matrix((2, 2), op.scalar)
        K = zeros(len(op.interior), self.width, dtype=pair)
        inputs = [op.lattice, terms, self.rows, self.window, field, E, G, H]
        launch(tangent_rows(op.scalar), len(op.interior), inputs, [K])
        if op.dictionary.cornered:
            inputs = [op.lattice, terms, self.rows, self.window, field]
            launch(corner_tangents(op.scalar).rows, len(op.interior), inputs, [K])
        entries: np.ndarray = K.numpy().reshape(-1)[self.taken]
        return entries


def reached(steps: np.ndarray, near: np.ndarray, linked: np.ndarray) -> np.ndarray:
    """Offsets of nodes that share an energy with a node: by two bonds, or by three short ones."""
    C, zero = len(steps) // 2, np.zeros((1, 2), int)
    family = np.concatenate([zero, steps])
    short, link = (np.concatenate([zero, steps[p], steps[p + C]]) for p in (near, linked))
    two = (family[:, None] + family).reshape(-1, 2)
    three = (short[:, None, None] + link[:, None] + short).reshape(-1, 2)
    offsets: np.ndarray = np.unique(np.concatenate([two, three]), axis=0)
    return offsets


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

    Args:
        op: the operator.
        tolerance: of the residual, relative to the largest force.
        direct: unknowns up to which the tangent is factorised.
    """

    def __init__(
        self, op: HyperelasticOperator, *, tolerance: float = 1e-8, direct: int = DIRECT
    ) -> None:
        self.op, self.tolerance = op.near_interior(), tolerance
        self.direct = 2 * len(op.interior) <= direct
        self.pattern = TangentPattern.of(self.op) if self.direct else None
        self._laplacian, self._to_collar = laplacian(op)
        self._laplace = splu(self._laplacian.tocsc())
        self.softest = float(self._laplacian.diagonal()[0])
        if len(op.interior) > 1:
            inverse = LinearOperator(self._laplace.shape, self._laplace.solve, dtype=float)
            self.softest = float(
                eigsh(
                    self._laplacian,
                    1,
                    sigma=0,
                    OPinv=inverse,
                    v0=lanczos_start(len(op.interior)),
                    return_eigenvectors=False,
                    tol=1e-4,
                )[0]
            )

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
        nodes = self.op.points.x.shape
        load, collar = checked_fields(self.op.points, b, u)
        if collar.shape != nodes:
            raise InputError(f"u: expected shape {list(nodes)}, got {list(collar.shape)}")
        load = load[self.op.interior]
        collar[self.op.points.interior] = 0.0
        first = (
            self.lift(collar)
            if start is None
            else np.where(self.op.points.interior[:, None], start, collar)
        )
        if (times := self._too_small(c, load, collar)) > 1:
            known = None if start is None else times * start
            larger = self.find(c, None if b is None else times * b, times * u, start=known)
            return larger and replace(larger, u=larger.u / times)
        steps, followed = 1, True
        field, count = self._newton(c, load, first, near=near)
        softened = None
        if field is None and near is not None:
            return None
        if field is None:
            softened, factor, used = self._soften(c, load, collar, first)
            field = softened if factor == 1.0 else None
            count += used
        if field is None:
            branch, done, steps, used = self._continue(c, load, collar)
            count, followed = count + used, done == 1.0
            field = branch if followed else None
            guesses = [branch * (1.0 / done if done else 1.0), first]
            for guess in guesses if softened is None else [softened, *guesses]:
                if field is None:
                    guess = np.where(self.op.points.interior[:, None], guess, collar)
                    field, used = self._newton(c, load, guess, shifts=True)
                    count += used
        if field is None:
            return None
        f = self.op.everywhere(field, c)
        left = load - f[self.op.interior]
        residual = float(np.abs(left).max() / max(np.abs(load).max(), np.abs(f).max(), 1e-300))
        return Equilibrium(field, residual, np.nan, count, steps, followed)

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
        other = copy(self)
        other.op = self.op.with_terms(terms)
        if self.pattern is not None:
            other.pattern = replace(self.pattern, op=other.op)
        return other

    def with_thickness(self, thickness: np.ndarray | None) -> StaticProblem:
        """The same lattice with another thickness of every node, shape [N]."""
        other = copy(self)
        other.op = self.op.with_thickness(thickness)
        if self.pattern is not None:
            other.pattern = replace(self.pattern, op=other.op)
        return other

    def _soften(
        self, c: np.ndarray, load: np.ndarray, collar: np.ndarray, first: np.ndarray
    ) -> tuple[np.ndarray | None, float, int]:
        """Solve with stiffer deviations and follow the answer while they soften.

        The last answer, how stiff its deviations were, Newton steps.
        """
        deviations = slice(self.op.dictionary.first_deviation, self.op.dictionary.first_term)
        stiff, factor, ratio = c.copy(), STIFFER, SOFTENING[0]
        if not np.any(c[deviations] > 0):
            return None, factor, 0
        stiff[deviations] *= factor
        last, count = self._newton(stiff, load, first)
        if last is None:
            branch, done, _, used = self._continue(stiff, load, collar)
            last, count = branch if done == 1.0 else None, count + used
        while last is not None and factor > 1.0 and ratio > SOFTENING[1]:
            target = max(1.0, factor / ratio)
            stiff[deviations] = target * c[deviations]
            field, used = self._newton(stiff, load, last)
            count += used
            if field is None:
                ratio = ratio**0.5
            else:
                last, factor = field, target
        return last, factor, count

    def _continue(
        self, c: np.ndarray, load: np.ndarray, collar: np.ndarray
    ) -> tuple[np.ndarray, float, int, int]:
        """Follow load and collar from rest: the last field, how far, load and Newton steps."""
        done, step, steps, count = 0.0, 0.25, 0, 0
        now = before = np.zeros_like(collar)
        last = 0.0
        while done < 1 and step >= SMALLEST_STEP:
            target = min(1.0, done + step)
            if done > last:
                guess = now + (target - done) / (done - last) * (now - before)
            else:
                guess = self.lift(target * collar)
            field, used = self._newton(c, target * load, guess)
            count += used
            if field is None:
                step /= 2
            else:
                before, last, now, done, steps = now, done, field, target, steps + 1
        return now, done, steps, count

    def _newton(
        self,
        c: np.ndarray,
        load: np.ndarray,
        u: np.ndarray,
        *,
        shifts: bool = False,
        near: Any = None,
    ) -> tuple[np.ndarray | None, int]:
        """Minimise the potential from u; None where that does not end in an equilibrium.

        Without shifts it also ends where the tangent is not positive definite: the branch of
        stable equilibria that u lies near has been left. With factors of a tangent near none is
        factorised. Else, of many unknowns, the first and the last are.
        """
        if self.op.smallest_area(u) <= SMALLEST_AREA:
            return None, 0
        given, again = near is not None, not shifts and 2 * len(self.op.interior) > DENSE
        for count in range(60 if shifts else 15):
            f = self.op.everywhere(u, c)
            residual = load - f[self.op.interior]
            scale = max(np.abs(load).max(), np.abs(f).max(), 1e-300)
            if not np.isfinite(f).all():  # a bond or the short strain is folded
                return None, count
            small = np.abs(residual).max() <= self.tolerance * scale
            if small and not given:
                near = None
            step, shift, factor = self._direction(c, u, residual, shifts, near)
            near = factor if given or again else None
            if shift > 0 and not shifts:
                return None, count
            if small and shift == 0.0:
                return (None if self._folded(u) else u), count
            moved = self._search(c, load, u, step, residual, scale)
            if moved is None:
                return None, count
            u = moved
        return None, count

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

        They stop at negative curvature (Steihaug).
        """
        inner = self.op.interior
        x, r = np.zeros_like(residual), residual.copy()
        z = inverse(r)
        p, rz, first = z.copy(), float((r * z).sum()), np.linalg.norm(r)
        if first == 0:
            return x, 0.0, 0
        v, count = np.zeros_like(u), 0
        for count in range(1, 501):
            v[inner] = p
            Kp = self.op.product(u, c, v)[inner]
            curvature = float((p * Kp).sum())
            if curvature <= 0:
                return (x if x.any() else z), 1.0, count
            step = rz / curvature
            x += step * p
            r -= step * Kp
            if np.linalg.norm(r) < 1e-4 * first:
                break
            z = inverse(r)
            rz, before = float((r * z).sum()), rz
            p = z + rz / before * p
        return x, 0.0, count

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
        area = self.op.bonds.spacing**2
        before = float(self.op.energy(u, c)) - area * float((load * u[inner]).sum())
        slope = -area * float((residual * step).sum())
        size, folded = np.linalg.norm(residual), self._folded(u)
        part = 1.0
        while part > 1e-4:
            moved = u.copy()
            moved[inner] += part * step
            if self.op.smallest_area(moved) > SMALLEST_AREA and self._folded(moved) <= folded:
                after = float(self.op.energy(moved, c)) - area * float((load * moved[inner]).sum())
                if np.isfinite(after) and after <= before + 1e-4 * part * slope:
                    return moved
                left = load - self.op.everywhere(moved, c)[inner]
                if np.linalg.norm(left) < 0.5 * size or np.abs(left).max() < self.tolerance * scale:
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
            inverse = LinearOperator(K.shape, factor.solve, dtype=float)
            values = eigsh(
                K, 1, sigma=0, OPinv=inverse, v0=lanczos_start(K.shape[0]),
                return_eigenvectors=False, tol=1e-3,
            )  # fmt: skip
            return float(values[0])
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
