"""Products and inverses of a stencil on the nodes of one body (theory, T15).

L_II is a block of the operator of a torus, so the smallest eigenvalue of that operator's symbol
bounds it from below: above zero, conjugate gradients find the one answer.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, reduce
from typing import Any, TypeAlias

import numpy as np

from warp_peri.core.elastic import elastic_from_brackets
from warp_peri.core.proof import smallest_eigenvalue
from warp_peri.core.stencil import FFT_BONDS, SCALARS, ByFFT, ByRows, Stencil, convolved, grid_of
from warp_peri.errors import InputError
from warp_peri.points.points import Points
from warp_peri.solvers.multigrid import Edge, Filter, block, multigrid, shear, sine, torus_inverse
from warp_peri.solvers.systems import SolveRecord, definite, definite_factors, factorised

Inverse: TypeAlias = Callable[[np.ndarray, float], np.ndarray]
"""An inverse of the linear part: of a load on the interior [I, d], to a relative residual."""
Pull: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""Products of planes around the unknowns [S, d, *wide], at them."""
FEW = DIRECT = 4_000
"""Most unknown nodes for which multigrid, whose iterations do not grow, is not worth its set-up;
and most that are factorised."""
STIFFEST = 4 * DIRECT
"""Likewise most that are factorised where λ ≫ μ and loads are many: each takes long to iterate."""
MANY = 10
"""Loads that are many."""
FEW_IN_SPACE = 500
"""Most unknown nodes in space whose factors, which fill up there, cost less than iteration."""
PAYS = {"sine": 3400, "fft": 7000}
"""A factorisation pays from 2 + n H/3400 loads on n nodes, H half of a stencil's bonds, where the
sine transform does, from 2 + n H/7000 elsewhere."""
STIFF = 30.0
"""λ/μ from which the strip at the edge costs less than the iterations that it saves."""
SINGULAR = 1e-13
"""A bound of the smallest eigenvalue below this fraction of the largest is no bound."""
ROUNDING = 1e-14
"""Of a load's component, which is its mean where no more is left without that."""
WAVES = 1 << 17
"""Of a torus, whose eigenvalues are taken at once."""


class Linear:
    """Operator L of one stencil on the nodes of one body or of one period, all bonds whole.

    Args:
        stencil: of the solid.
        points: lattice nodes with a collar of its reach, or periodic.
        by: "rows", "fft", or "auto", which takes what is faster; how products are taken.
        dtype: float64 or float32.
        why, least: of grid_of.

    Raises InputError as grid_of does.
    """

    def __init__(
        self,
        stencil: Stencil,
        points: Points,
        *,
        by: str = "auto",
        dtype: Any = np.float64,
        why: str = "",
        least: int | None = None,
    ) -> None:
        self.stencil, self.points = stencil, points
        self.grid = grid_of(points, stencil.steps, why=why, least=least)
        if np.dtype(dtype) not in SCALARS:
            raise InputError(f"dtype: expected float64 or float32, got {np.dtype(dtype)}")
        self.dtype = np.dtype(dtype)
        if by == "auto":
            by = "fft" if len(stencil.steps) >= FFT_BONDS[self.grid.dimension] else "rows"
        self.by = by
        make: type[ByFFT | ByRows] = ByFFT if by == "fft" else ByRows
        self.pull: Pull = make(self.grid, stencil.steps, stencil.tensors, self.dtype)
        self._filters: dict[str, tuple[Filter, Filter | None]] = {}

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Force L u of fields [S, N, d] at the interior nodes, [S, I, d]."""
        return self.grid.gather(self.pull(self.grid.scatter(u, self.dtype)))

    @cached_property
    def _torus(self) -> ByFFT:
        if isinstance(self.pull, ByFFT) and self.dtype == np.float64:
            return self.pull
        return ByFFT(self.grid, self.stencil.steps, self.stencil.tensors)

    def push(self, inner: np.ndarray) -> np.ndarray:
        """Transposed product Lᵗ of a field on the interior [I, d], on all nodes, [N, d]."""
        grid, by = self.grid, self._torus
        field = convolved(by.symbol, grid.scatter_interior(inner), by.torus)
        field = field[(slice(None), *(slice(0, n) for n in grid.shape))]
        out = np.zeros(self.points.x.shape)
        out[grid.near] = field.reshape(len(field), -1)[:, grid.place].T @ grid.axes.T
        return out

    def check_definite(self) -> None:
        """Raise InputError unless the symbol proves that L_II is positive definite."""
        grid, by = self.grid, self._torus
        ratio = smallest_ratio(by.symbol, by.torus)
        # every node's Laplacian is at least that of the box's longest wave
        halves = [n + 1.0 - 2 * grid.reach for n in grid.shape]
        if grid.periodic:
            halves = [max(grid.shape) / 2]
        long = sum(4 * np.sin(np.pi / 2 / n) ** 2 for n in halves)
        scale = 2 * float(self.stencil.tensors[:, 0, 0].sum())
        if ratio * long > SINGULAR * scale:
            return
        kind = "singular" if abs(ratio) * long <= SINGULAR * scale else "indefinite"
        raise InputError(
            f"the operator on these {len(grid.interior)} nodes is {kind} or cannot be told from "
            f"it: the smallest Λmin D(k)/s(k) is {ratio * self.stencil.spacing**2:.2e}, and static "
            "problems of the model have no unique or no stable answer here"
        )

    @cached_property
    def _stiff(self) -> bool:
        """Whether λ ≫ μ at long waves."""
        C, d = elastic_from_brackets(self.stencil.brackets), self.grid.dimension
        mu = shear(C)
        return bool(np.einsum("iijj", C) / d**2 - 2 * mu / d > STIFF * mu)

    def method(self, asked: str | None = None, loads: int = 0) -> str:
        """Name of the solve method: `asked`, or the cheapest for so many loads, of 0 by iteration;
        InputError where the nodes do not allow it."""
        grid, nodes, stiff = self.grid, len(self.grid.interior), self._stiff
        if grid.periodic:
            return "fft"
        if asked == "sine" and not grid.is_box:
            raise InputError("method: sine is for boxes of nodes; try multigrid")
        if asked:
            return asked
        pays = 2 + nodes * len(self.stencil.steps) / PAYS["sine" if grid.is_box else "fft"]
        most = STIFFEST if stiff and loads >= MANY else DIRECT
        few = (
            nodes <= FEW_IN_SPACE
            if grid.dimension == 3
            else nodes <= most and (stiff or loads > pays)
        )
        if few and loads:
            return "lu"
        if stiff:
            return "strip"
        return "sine" if grid.is_box else "fft" if nodes <= FEW else "multigrid"

    def filter(self, method: str) -> tuple[Filter, Filter | None]:
        """Preconditioner z ≈ L_II⁻¹ r of planes [d, *shape], and where a search begins."""
        if method not in self._filters:
            stencil, h2 = self.stencil, self.stencil.spacing**2
            args = self.grid, stencil.steps, stencil.tensors * h2
            if method in ("sine", "multigrid"):
                make = sine if method == "sine" else multigrid
                inner = make(*args, elastic_from_brackets(stencil.brackets))
            else:
                inner = torus_inverse(*args)
            edge = Edge(self.grid, stencil) if method == "strip" else None
            product = self._product

            def apply(r: np.ndarray) -> np.ndarray:
                z = inner(r) * h2
                return z if edge is None else z - edge(product(z))

            self._filters[method] = apply, edge
        return self._filters[method]

    def _product(self, field: np.ndarray) -> np.ndarray:
        """Product of L with planes [d, *shape], at the unknowns, zero elsewhere."""
        grid = self.grid
        if grid.periodic:
            around = [(0, 0), *[(grid.reach,) * 2] * grid.dimension]
            field = np.pad(field, around, mode="wrap")
        return np.asarray(self.pull(field[None])[0])

    def _inverted(
        self, right: np.ndarray, method: str, tolerance: float
    ) -> tuple[np.ndarray, SolveRecord]:
        """Solution of L_II x = r in planes [d, *shape]."""
        if self.dtype != np.float64:
            raise InputError(f"dtype: expected float64 for a solve, got {self.dtype}")
        apply, begin = self.filter(method)
        return definite(
            self._product,
            apply,
            right,
            tolerance,
            begin=begin,
            where=f" on these {len(self.grid.interior)} nodes",
            hint=f", or so nearly incompressible that {method} does not come close to it: try "
            "strip, or lu where nodes are few",
        )

    def inverse(
        self, right: np.ndarray, tolerance: float, method: str | None = None
    ) -> tuple[np.ndarray, SolveRecord]:
        """Solution L_II⁻¹ b of an interior field [I, d], zero on the collar, and its record."""
        planes = self.grid.scatter_interior(right)
        z, record = self._inverted(planes, self.method(method), tolerance)
        return self.grid.gather(z[None])[0], record

    def cheapest_inverse(self, loads: int, *, definite: bool = True) -> Inverse:
        """L_II⁻¹ for so many loads: factorised, or iterated to the tolerance that it is asked for.
        Few nodes are factorised even if L_II is not proven definite; `definite` False takes any
        factors. InputError as check_definite for more nodes, and for bad factors."""
        grid, nodes, how = self.grid, len(self.grid.interior), self.method(loads=loads)
        try:
            self.check_definite()
            if how != "lu":
                return lambda right, tolerance: self.inverse(right, tolerance)[0]
        except InputError:
            if nodes > DIRECT:
                raise
            if definite and definite_factors(block(self.stencil, grid.mask())) is None:
                raise
        factors, axes = factorised(block(self.stencil, grid.mask())), grid.axes
        order = np.argsort(grid.interior)  # as they follow one another in the box

        def solved(right: np.ndarray, tolerance: float) -> np.ndarray:
            found = np.empty_like(right)
            found[order] = factors.solve((right @ axes)[order].ravel()).reshape(right.shape)
            return np.asarray(found @ axes.T)

        return solved

    def solve(
        self, b: np.ndarray, u: np.ndarray, tolerance: float, method: str | None = None
    ) -> tuple[np.ndarray, list[SolveRecord]]:
        """Solve L u = b at the interior nodes, u given elsewhere.

        Args:
            b: loads [stress/length] on all nodes, shape [S, N, d]; only the interior's are read.
            u: displacement on all nodes, same shape; only the collar's is read. On a period nothing
                is, and the answer's mean is zero.
            tolerance: of the true relative residual.
            method: what stands before conjugate gradients; None takes the cheapest.

        Raises InputError for a method that does not fit, or a solve that stalls.
        """
        asked, method = self.points.interior[:, None], self.method(method)
        answer, records = np.where(asked, 0.0, u), []
        for one, field in zip(b, answer):
            right = self.grid.scatter(np.where(asked, one, 0.0)[None])
            if self.grid.periodic:
                right = right[(slice(None), slice(None), *self.grid.core)]
                over: Any = {"axis": tuple(range(2, right.ndim)), "keepdims": True}
                largest = np.abs(right).max(**over)
                right = right - right.mean(**over)
                right = np.where(np.abs(right).max(**over) > ROUNDING * largest, right, 0.0)
            else:
                right = right - self.pull(self.grid.scatter(field[None]))
            z, took = self._inverted(right[0], method, tolerance)
            field[self.points.interior] = self.grid.gather(z[None])[0]
            records.append(took)
        return answer, records


def smallest_ratio(symbol: np.ndarray, torus: tuple[int, ...]) -> float:
    """Smallest Λmin D(k) / Σ_a 4 sin²(k_a h/2) over waves k ≠ 0 of a torus and its torus_symbol."""
    waves = [4 * np.sin(np.pi * np.arange(n) / n) ** 2 for n in torus]
    waves[-1] = waves[-1][: symbol.shape[-1]]
    s = reduce(np.add.outer, waves).ravel()
    D, smallest = symbol.reshape(*symbol.shape[:2], -1).T, np.inf
    for first in range(1, len(s), WAVES):  # k = 0 is the first
        part = slice(first, first + WAVES)
        low = smallest_eigenvalue(D[part])
        smallest = min(smallest, float((low / s[part]).min()))
    return smallest
