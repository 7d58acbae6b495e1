"""Solvers of the chart that are ready to solve, and how they are timed."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from warp_peri import Model, Samples
from warp_peri.lps.matrices import matrices
from warp_peri.statics.equilibrium import lps_linear

Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]
MANY = 100
"""Loads that are solved for at once."""


def by_lu(dtype: Any) -> Callable[[Model, Samples], Solver]:
    """Sparse LU of the assembled operator."""

    def prepare(model: Model, points: Samples) -> Solver:
        L = matrices(model, points).operator(model.lam, model.mu)
        unknown = np.repeat(points.interior, 2)
        factors = splu(sp.csc_array(L[:, unknown]).astype(dtype))
        collar = L[:, ~unknown]

        def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
            right = b.ravel()[unknown] - collar @ u.ravel()[~unknown]
            return factors.solve(right.astype(dtype)).reshape(-1, 2)

        return solve

    return prepare


def by_cg(method: str) -> Callable[[Model, Samples], Solver]:
    """Conjugate gradients to 1e-8."""

    def prepare(model: Model, points: Samples) -> Solver:
        linear = lps_linear(points, model.solid, model.horizon)
        linear.filter(method)

        def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
            return linear.solve(b[None], u[None], 1e-8, method)[0][0][points.interior]

        return solve

    return prepare


def timed(
    prepare: Callable[[], Solver], points: Samples, samples: np.ndarray, rounds: int = 3
) -> dict[str, float]:
    """Best set-up and solve [s] and the mean error of the samples."""
    setup, each = [], []
    errors: list[float] = []
    for _ in range(rounds):
        start = time.perf_counter()
        solver = prepare()
        setup.append(time.perf_counter() - start)
        errors = []
        for s in samples:
            start = time.perf_counter()
            u = solver(points.loads[s], points.u[s])
            each.append(time.perf_counter() - start)
            errors.append(relative(u, points, s))
    return {"setup": min(setup), "solve": min(each), "error": float(np.mean(errors))}


def relative(u: np.ndarray, points: Samples, sample: int) -> float:
    """Error of a displacement of the interior."""
    exact = points.u[sample][points.interior]
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))


def hundred(prepare: Callable[[], Solver], points: Samples, *, stack: bool) -> float:
    """Seconds of set-up and a hundred loads, together where a law takes a stack."""
    which = np.arange(MANY) % len(points)
    start = time.perf_counter()
    solver = prepare()
    if stack:
        solver(points.loads[which], points.u[which])
    else:
        for s in which:
            solver(points.loads[s], points.u[s])
    return time.perf_counter() - start


def smooth_error(points: Samples, prepare: Callable[[Samples], Solver]) -> float:
    """Mean error on the smooth loads of the validation set."""
    solver, both = prepare(points), zip(points.loads, points.u)
    return float(np.mean([relative(solver(b, u), points, s) for s, (b, u) in enumerate(both)]))
