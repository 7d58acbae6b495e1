"""The same operator by SciPy and by Numba, and the model that a positive kernel can be."""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import torch
from scipy.optimize import least_squares
from scipy.sparse.linalg import LinearOperator, cg

from tools import numba_rival, rivals
from warp_peri import InputError, Model, Points, Samples
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.matrices import matrices
from warp_peri.points.lattice import lattice_steps
from warp_peri.regression.losses import class_weights, reduce, sample_weights

TOLERANCE = 1e-8
Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]


def by_scipy(model: Model, points: Samples) -> Solver:
    """SciPy's conjugate gradients, without a preconditioner, around the assembled CSR matrix."""
    L = matrices(model, points).operator(model.lam, model.mu)
    unknown = np.repeat(points.interior, 2)
    stiffness, collar = sp.csr_array(L[:, unknown]), L[:, ~unknown]

    def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
        right = b.ravel()[unknown] - collar @ u.ravel()[~unknown]
        return _descend(stiffness, right)

    return solve


def by_numba(model: Model, points: Samples) -> Solver:
    """The same iterations around two parallel sweeps in Numba, on a torus around the points.

    Setting up includes compiling, as it would for a user. The influence functions must be one.
    """
    step, axes = lattice_steps(points)
    shape = step.max(axis=0) + 1 + int(np.ceil(2 * model.horizon / points.spacing))
    box = shape * points.spacing
    x = points.spacing * np.argwhere(np.ones(shape))
    sides = (float(box[0]), float(box[1]))
    torus = Points(x, np.ones(len(x), bool), points.spacing, box=sides)
    bonds = Bonds(torus, model.horizon)
    field = np.zeros((len(x), 2))
    law = {"alpha": model.alpha, "D": model.D, "lam": model.lam, "mu": model.mu}
    tables = rivals.tables(bonds, x, box, field, np.zeros_like(field), **law)
    force, _ = numba_rival.numba_parallel(tables, np.float64, fastmath=False)
    place = np.ravel_multi_index(tuple(step.T), tuple(shape))
    inside = place[points.interior]
    force()  # compiles

    def product(v: np.ndarray) -> np.ndarray:
        field[:] = 0
        field[inside] = v.reshape(-1, 2)
        return force()[inside].ravel()

    stiffness = LinearOperator((2 * len(inside), 2 * len(inside)), product, dtype=float)

    def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
        field[:] = 0
        field[place[~points.interior]] = u[~points.interior] @ axes
        right = (b[points.interior] @ axes).ravel() - force()[inside].ravel()
        return _descend(stiffness, right) @ axes.T

    return solve


def _descend(stiffness: sp.csr_array | LinearOperator, right: np.ndarray) -> np.ndarray:
    u, failed = cg(stiffness, right, rtol=TOLERANCE)
    if failed:
        raise RuntimeError("conjugate gradients did not converge")
    return u.reshape(-1, 2)


def positive_model(train: Samples, *, horizon: float, degree: int, starts: int = 3) -> Model:
    """The best LPS with D ≥ 0, μ > 0 and λ + μ > 0: least squares of (10) from random starts.

    Raises InputError when no start converges.
    """
    reduced = reduce(train, horizon, sample_weights([train], normalise=False)[0])
    i, j = (torch.from_numpy(pair) for pair in reduced.pairs)
    R, load = torch.from_numpy(reduced.R), torch.ones(1, dtype=torch.float64)

    def residual(y: torch.Tensor) -> torch.Tensor:
        sum_of_both, mu, alpha, D = y[0], y[1], y[2], y[3:]
        w = class_weights(reduced.classes, alpha, D)
        return R @ torch.cat([mu * w, (sum_of_both - 2 * mu) * w[i] * w[j], load])

    def slope(y: np.ndarray) -> np.ndarray:
        return torch.autograd.functional.jacobian(residual, torch.from_numpy(y)).numpy()

    low = np.concatenate([[1e-3, 1e-3, -6.0], np.zeros(degree + 1)])
    high = np.concatenate([[np.inf, np.inf, 2.999], np.full(degree + 1, 10.0)])
    best = None
    for seed in range(starts):
        D = np.random.default_rng(seed).uniform(0.1, 1, degree + 1)
        fitted = least_squares(
            lambda y: residual(torch.from_numpy(y)).numpy(),
            np.concatenate([[0.5, 0.7, 1.0], D]),
            slope,
            bounds=(low, high),
            max_nfev=500,
        )
        if fitted.success and (best is None or fitted.cost < best.cost):
            best = fitted
    if best is None:
        raise InputError("positive kernel: no start converged")
    y = best.x
    spacings = (train.spacing,)
    return Model(
        lam=float(y[0] - y[1]),
        mu=float(y[1]),
        alpha=float(y[2]),
        D=y[3:],
        horizon=horizon,
        trained_on=spacings,
        certified_on=spacings,
    )
