"""The chart's laws beside the linear solid: third order, tensors, predict, a network."""

import functools
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.optimize import least_squares
from scipy.sparse.linalg import LinearOperator, cg, splu

import warp_peri as wp
from examples.predict import rich_law
from tools import make_graphene as making
from tools import numba_rival, rivals
from tools.loads import DESIGNED
from tools.make_scenes import DISK, make_scenes
from tools.make_strained import strained_file
from tools.samples import read_sample
from warp_peri import InputError, Model, Points, Samples
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.matrices import matrices
from warp_peri.methods import Smoothing
from warp_peri.points.lattice import lattice_steps, neighbour_table
from warp_peri.points.samples import PointsLike
from warp_peri.prediction import Family
from warp_peri.regression.losses import class_weights, reduce, sample_weights
from warp_peri.statics.lps import lps_linear

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


def by_factors(material: Any, points: Samples) -> Solver:
    """Sparse LU of the matrix of a crystal's operator."""
    L, unknown = material.on(points.points).matrix(), np.repeat(points.interior, 2)
    factors, collar = splu(sp.csc_array(L[:, unknown])), L[:, ~unknown]

    def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
        right = b[points.interior].ravel() - collar @ u.ravel()[~unknown]
        return factors.solve(right).reshape(-1, 2)

    return solve


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
    prepare: Callable[[], Solver],
    points: Samples,
    samples: np.ndarray,
    rounds: int = 3,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Best set-up and solve [s] and the mean error of the samples."""
    setup, each = [], []
    errors: list[float] = []
    for _ in range(rounds):
        start = clock()
        solver = prepare()
        setup.append(clock() - start)
        errors = []
        for s in samples:
            start = clock()
            u = solver(points.loads[s], points.u[s])
            each.append(clock() - start)
            errors.append(relative(u, points, s))
    return {"setup": min(setup), "solve": min(each), "error": float(np.mean(errors))}


def relative(u: np.ndarray, points: Samples, sample: int) -> float:
    """Error of a displacement of the interior."""
    exact = points.u[sample][points.interior]
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))


def hundred(
    prepare: Callable[[], Solver],
    points: Samples,
    *,
    stack: bool,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Seconds of set-up and a hundred loads, together where a law takes a stack."""
    which = np.arange(MANY) % len(points)
    start = clock()
    solver = prepare()
    if stack:
        solver(points.loads[which], points.u[which])
    else:
        for s in which:
            solver(points.loads[s], points.u[s])
    return clock() - start


def smooth_error(points: Samples, prepare: Callable[[Samples], Solver]) -> float:
    """Mean error on the smooth loads of the validation set."""
    solver, both = prepare(points), zip(points.loads, points.u)
    return float(np.mean([relative(solver(b, u), points, s) for s, (b, u) in enumerate(both)]))


TOLERANCE = 1e-8


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


ROOT = Path(__file__).resolve().parent.parent.parent
NETWORK = ROOT / "examples" / "neural_weights" / "graphene.json"
"""The printed neural operator, as it was trained on all seventy loads in 25 minutes."""
TOLERANCES = (0.10, 0.05, 0.02, 0.01, 0.005)
STRAINS = (0.01, 0.05, 0.10)
"""Largest bond strains of the disks that say how errors grow with strain."""


def laws() -> dict[str, tuple[str, Any, float]]:
    """Label: kind, law and horizon [Å], all on nodes 5 Å apart."""
    tensors = wp.Micromodulus(15.0, normalise=True)
    return {
        "third order on a crystal model, 28 bonds": (
            "third-order model",
            wp.ThirdOrder(tensors, Smoothing(10.0)),
            15.0,
        ),
        "crystal model, 20 bonds": ("crystal model", wp.Micromodulus(12.5), 12.5),
        "crystal model, 28 bonds": ("crystal model", wp.Micromodulus(15.0), 15.0),
    }


def learned(train: Samples, val: Samples) -> Iterator[tuple[str, str, Any, float, float]]:
    """Label, kind, material, horizon, and seconds of its fit."""
    for label, (kind, law, horizon) in laws().items():
        material, seconds = _timed_fit(train, law)
        yield label, kind, material, horizon, seconds
    family, seconds = _timed_fit(train, Family(rich_law()), validation=val)
    yield "predict", "predict", family, 15.0, seconds


def _timed_fit(samples: Samples, law: Any, **options: Any) -> tuple[Any, float]:
    start = time.perf_counter()
    with warnings.catch_warnings(action="ignore"):
        material = wp.fit(samples, law, progress=False, **options).material
    return material, time.perf_counter() - start


def by_rest(material: Any) -> Callable[[Samples], Solver]:
    """A material placed once, and its own equilibrium; of one load or a stack."""

    def prepare(points: Samples) -> Solver:
        with warnings.catch_warnings(action="ignore"):
            operator = material.on(points.points)

        def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
            with warnings.catch_warnings(action="ignore"):
                answer = np.asarray(operator.rest(b, u).u)
            return answer[..., points.interior, :]

        return solve

    return prepare


def by_predict(family: Any, tolerance: float) -> Callable[[Samples], Solver]:
    """Answers of a family within a tolerance."""

    def prepare(points: Samples) -> Solver:
        placed = family.with_doubts(points.points)

        def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
            answers = wp.predict(placed, wp.Dirichlet(points.points, b, u), tolerance)
            each = answers if isinstance(answers, tuple) else (answers,)
            found = np.stack([one.u[points.interior] for one in each])
            return found if b.ndim == 3 else found[0]

        return solve

    return prepare


def rows(
    train: Samples, val: Samples, kinds: Sequence[str] | None = None
) -> Iterator[tuple[str, str, float, str, Callable[[Samples], Solver], float]]:
    """Label, kind, horizon, method, how it is solved, and seconds of the fit; of some kinds."""
    for label, kind, material, horizon, seconds in learned(train, val):
        if kinds and kind not in kinds:
            continue
        if kind == "crystal model":
            how = functools.partial(by_factors, material)
            yield f"{label}, h = 5, LU", kind, horizon, "lu", how, seconds
        if kind != "predict":
            yield f"{label}, h = 5", kind, horizon, "rest", by_rest(material), seconds
            continue
        for tolerance in TOLERANCES:
            name = f"prediction at {100 * tolerance:g} %"
            yield name, kind, horizon, "predict", by_predict(material, tolerance), seconds
    if kinds and "network" not in kinds:
        return
    network = wp.load(NETWORK)
    seconds = float(network.provenance["seconds"])
    yield "neural operator, δ = 20", "network", 20.0, "network", by_rest(network), seconds


def two_loads(cache: Path) -> Samples:
    """The designed loads, each both ways, on nodes 5 Å apart."""
    sheet, _ = making.graphene_bodies()
    samples = making.solve_all({sheet: DESIGNED}, cache, 1, False)[sheet]
    return making.point_set(sheet, DESIGNED, samples, spacing=5.0)


def gradient_size(points: PointsLike, u: np.ndarray) -> float:
    """Root mean square of |grad u| of a field [N, d] on a lattice, by central differences where
    both neighbours are nodes."""
    grid = lattice_steps(points)[0]
    d = grid.shape[1]
    table = neighbour_table(grid, np.concatenate([np.eye(d, dtype=int), -np.eye(d, dtype=int)]))
    square = 0.0
    for axis in range(d):
        ahead, behind = table[:, axis], table[:, d + axis]
        both = (ahead >= 0) & (behind >= 0)
        slope = (u[ahead[both]] - u[behind[both]]) / (2 * points.spacing)
        square += float((slope**2).sum() / max(int(both.sum()), 1))
    return float(np.sqrt(square))


def strained_disks(file: Path, spacing: float) -> list[tuple[float, Samples]]:
    """Disks of growing strain on nodes so far apart [Å]: mean |H|, and samples."""
    make_scenes(file)  # what is there is read
    _, disk = making.graphene_bodies()
    found = []
    for strain in STRAINS:
        paths = [strained_file(file.with_suffix(".cache"), disk, one, strain) for one in DISK]
        samples = [one for one in map(read_sample, paths) if one is not None]
        points = making.point_set(disk, DISK, samples, spacing=spacing)
        found.append((np.sqrt(np.mean([gradient_size(points, u) ** 2 for u in points.u])), points))
    return found
