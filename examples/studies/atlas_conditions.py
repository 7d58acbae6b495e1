"""Stability atlas: kernels fitted without conditions, and what they do to static problems."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import least_squares
from tqdm import tqdm

import warp_peri
from examples.studies.atlas_entry import Entry, square_lattice, words, written
from warp_peri import Dataset, Model, Samples
from warp_peri.lps.matrices import matrices
from warp_peri.methods import Conditions
from warp_peri.regression.conditions import LatticeConditions, ZoneSearch
from warp_peri.regression.coordinates import Coordinates
from warp_peri.regression.losses import ReducedLoss, reduce, sample_weights
from warp_peri.regression.parameters import Parameters
from warp_peri.statics.direct import MatrixProblem

RATIOS = (2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
DEGREES = (0, 1, 2, 3, 4, 5, 6, 8, 10, 15, 20)
SIDES = range(4, 17)
"""Nodes a side of the rectangles that are solved on."""


def unconstrained(grid: ReducedLoss, degree: int) -> tuple[Parameters, float, float]:
    """The least residual that kernels of a degree allow when nothing else is asked.

    Returns the parameters, the relative residual and the smallest D(k)/s(k) [TPa].
    """
    i, j = grid.pairs
    best = None
    for alpha in (1.0, 2.0):
        coordinates = Coordinates([grid.classes], alpha, degree)

        def residual(y: np.ndarray, space: Coordinates = coordinates) -> np.ndarray:
            point = space.point(y)
            v, z = point.v[0], point.z[0]
            return grid.R @ np.concatenate([v, point.kappa * z[i] * z[j], [1.0]])

        def slope(y: np.ndarray, space: Coordinates = coordinates) -> np.ndarray:
            point = space.point(y)
            z, dv, dz = point.z[0], point.dv[0], point.dz[0]
            by_pairs = point.kappa * (z[i][:, None] * dz[j] + z[j][:, None] * dz[i])
            by_pairs[:, 0] += z[i] * z[j]  # y₀ is κ
            return grid.R[:, :-1] @ np.concatenate([dv, by_pairs])

        start = coordinates.start(Parameters(-0.2, 0.7, alpha, np.ones(degree + 1)))
        low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
        if coordinates.free_alpha:
            low[-1], high[-1] = -6.0, 2.999
        trial = least_squares(
            residual, start, jac=slope, bounds=(low, high), x_scale="jac", xtol=1e-12, ftol=1e-12
        )
        if best is None or trial.cost < best[0]:
            best = trial.cost, trial.x, coordinates
    assert best is not None
    cost, y, coordinates = best
    point = coordinates.point(y)
    search = ZoneSearch(LatticeConditions(grid.classes, Conditions("direct", 1.0)))
    smallest = float(search.worst(point.v[0], point.z[0], point.kappa)[0][0]) + 1.0
    return coordinates.parameters(y, []), float(np.sqrt(2 * cost)), smallest


def sign_changing(data: Dataset) -> Entry:
    """Symbols of the best kernels without conditions, and what they do to static problems."""
    train, test = data["train"], data["test"]
    smallest, models = kernels_without_conditions(train)
    unsafe = smallest <= 0
    # Fits of one horizon and degree, so that nothing but the conditions differs.
    case = next(case for case in sorted(models, key=lambda case: smallest[case]) if unsafe[case])
    free, degree, ratio = models[case], DEGREES[case[0]], RATIOS[case[1]]
    kept = warp_peri.fit(
        train, warp_peri.LPS(horizon=free.horizon, kernel=warp_peri.Bernstein(degree))
    ).material
    errors = {
        f"{RATIOS[column]:g}, {DEGREES[row]}": displacement_error(model, test)
        for (row, column), model in models.items()
        if unsafe[row, column]
    }
    sizes, spectra = rectangle_spectra({"without": free, "with": kept}, train.spacing)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4), layout="constrained")
    draw_symbols(figure, left, smallest)
    draw_spectra(right, sizes, spectra)
    right.set_title(f"δ = {ratio:g}h, M = {degree}; λ₁: 5-point Laplacian")
    negative = [int((values < 0).sum()) for values in spectra["without"]]
    nearest = {name: min(float(np.abs(v).min()) for v in spectra[name]) for name in spectra}
    stable, edge = edge_of_safety(unsafe)
    certificate = warp_peri.certify(free, spacing=train.spacing)
    return Entry(
        *written(
            "sign-changing",
            unsafe=np.count_nonzero(unsafe),
            pairs=unsafe.size,
            smallest=smallest.min(),
            edge=edge,
            stable=stable,
            ratio=ratio,
            degree=degree,
            negative=max(negative),
            rectangles=len(sizes),
            without=nearest["without"],
            kept=nearest["with"],
            nearer=nearest["with"] / nearest["without"],
            best=100 * min(errors.values()),
            worst=100 * max(errors.values()),
        ),
        [
            f"certificate: {certificate.statement}",
            words(lambda: warp_peri.solve(free, warp_peri.Dirichlet(test, test.loads, test.u)).u),
        ],
        figure,
        {
            "ratios": RATIOS,
            "degrees": DEGREES,
            "symbol_min": smallest,
            "E_u of the unsafe": errors,
            "negative eigenvalues": negative,
            "nearest to zero": nearest,
        },
    )


def kernels_without_conditions(
    train: Samples,
) -> tuple[np.ndarray, dict[tuple[int, int], Model]]:
    """Smallest D(k)/s(k) [TPa] by degree and δ/h, and the models that are solids, by place."""
    weight = sample_weights([train], normalise=False)[0]
    smallest = np.empty((len(DEGREES), len(RATIOS)))
    models: dict[tuple[int, int], Model] = {}
    for column, ratio in enumerate(tqdm(RATIOS, desc="kernels without conditions")):
        horizon = ratio * train.spacing
        grid = reduce(train, horizon, weight)
        for row, degree in enumerate(DEGREES):
            fitted, _, smallest[row, column] = unconstrained(grid, degree)
            if fitted.mu > 0 and fitted.lam + fitted.mu > 0:
                models[row, column] = Model(fitted.lam, fitted.mu, fitted.alpha, fitted.D, horizon)
    return smallest, models


def rectangle_spectra(
    models: Mapping[str, Model], spacing: float
) -> tuple[list[int], dict[str, list[np.ndarray]]]:
    """Unknown nodes of each rectangle, and eigenvalues of each model there over λ₁ [TPa]."""
    shapes = [(a, b) for a in SIDES for b in SIDES if a <= b]
    sizes = [a * b for a, b in shapes]
    spectra: dict[str, list[np.ndarray]] = {name: [] for name in models}
    for shape in tqdm(shapes, desc="rectangles"):
        squares = np.sin(np.pi / (2 * (np.array(shape) + 1))) ** 2
        laplacian = 4 / spacing**2 * squares.sum()
        for name, model in models.items():
            points = square_lattice(shape, model.horizon, spacing)
            unknown = np.repeat(points.interior, 2)
            L = matrices(model, points).operator(model.lam, model.mu)[:, unknown].toarray()
            spectra[name].append(np.linalg.eigvalsh((L + L.T) / 2) / laplacian)
    return sizes, spectra


def edge_of_safety(unsafe: np.ndarray) -> tuple[str, str]:
    """Ratios δ/h that are safe at every degree, and of the others the degree where that ends."""
    first = [
        next((DEGREES[row] for row in range(len(DEGREES)) if unsafe[row, column]), None)
        for column in range(len(RATIOS))
    ]
    stable = ", ".join(f"{ratio:g}" for ratio, degree in zip(RATIOS, first) if degree is None)
    edge = "; ".join(
        f"δ/h = {ratio:g} from M = {degree}"
        for ratio, degree in zip(RATIOS, first)
        if degree is not None
    )
    return stable, edge


def draw_symbols(figure: Figure, ax: Axes, smallest: np.ndarray) -> None:
    """Smallest D(k)/s(k) by degree and horizon."""
    mesh = ax.pcolormesh(
        np.arange(len(RATIOS)), np.arange(len(DEGREES)), np.arcsinh(smallest / 0.01),
        cmap="RdBu", vmin=-np.arcsinh(1e3), vmax=np.arcsinh(1e3), shading="nearest",
    )  # fmt: skip
    for (row, column), value in np.ndenumerate(smallest):
        ax.text(column, row, f"{value:.2g}", ha="center", va="center", fontsize=7)
    ax.set_xticks(range(len(RATIOS)), [f"{ratio:g}" for ratio in RATIOS])
    ax.set_yticks(range(len(DEGREES)), [str(degree) for degree in DEGREES])
    ax.set_xlabel("δ/h")
    ax.set_ylabel("degree M")
    ax.set_title("smallest D(k)/s(k) [TPa], no conditions asked")
    bar = figure.colorbar(mesh, ax=ax, ticks=np.arcsinh(np.array([-1, -0.01, 0, 0.01, 1]) / 0.01))
    bar.ax.set_yticklabels(["−1", "−0.01", "0", "0.01", "1"])


def draw_spectra(
    ax: Axes, sizes: Sequence[int], spectra: Mapping[str, Sequence[np.ndarray]]
) -> None:
    """How near to singular each rectangle is, with conditions and without."""
    for name, style in (("without", "o"), ("with", "s")):
        closest = [float(np.abs(values).min()) for values in spectra[name]]
        ax.semilogy(sizes, closest, style, label=f"{name} conditions", markersize=4, alpha=0.7)
    ax.set_xlabel("unknown nodes of a rectangle")
    ax.set_ylabel("smallest |eigenvalue of L| / λ₁ [TPa]")
    ax.legend(frameon=False)


def displacement_error(model: Model, points: Samples) -> float:
    """E_u of what LU gives without asking; `solve` refuses where the operator is indefinite."""
    L = matrices(model, points).operator(model.lam, model.mu)
    solved = MatrixProblem(L, points.interior).solve(points.loads, points.u)
    u, solved = points.u[:, points.interior], solved[:, points.interior]
    wrong = np.linalg.norm(solved - u, axis=(1, 2)) / np.linalg.norm(u, axis=(1, 2))
    return float(wrong.mean())
