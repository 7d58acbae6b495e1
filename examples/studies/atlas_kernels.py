"""Stability atlas: kernels that fail without conditions, on their lattice, or away from it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy.optimize import least_squares
from tqdm import tqdm

import warp_peri as wp
from examples.figures import ABOVE, curves, name_lines, note, panels
from examples.studies.atlas_entry import Entry, entry, square_lattice
from tools.make_graphene import point_set, read_samples
from warp_peri import Dataset, Model, Samples
from warp_peri.lps.matrices import matrices
from warp_peri.lps.model import bernstein_basis
from warp_peri.methods import Conditions, Optimum
from warp_peri.points.families import bond_classes
from warp_peri.points.quadrature import RESIDUAL, family_weights
from warp_peri.regression.coordinates import Coordinates, Parameters
from warp_peri.regression.losses import ReducedLoss, reduce, sample_weights
from warp_peri.regression.optimum import LatticeConditions
from warp_peri.statics.direct import MatrixProblem

FREE = Optimum(moduli=None)
RATIOS = (2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
DEGREES = (0, 1, 2, 3, 4, 5, 6, 8, 10, 15, 20)
SIDES = range(4, 17)
"""Nodes a side of the rectangles that are solved on."""
LAM, MU = -0.1972, 0.7223
"""Of the potential that the data come from [TPa]."""


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
            v = point.v[0]
            return grid.R @ np.concatenate([v, point.kappa * v[i] * v[j], [1.0]])

        def slope(y: np.ndarray, space: Coordinates = coordinates) -> np.ndarray:
            point = space.point(y)
            v, dv = point.v[0], point.dv[0]
            by_pairs = point.kappa * (v[i][:, None] * dv[j] + v[j][:, None] * dv[i])
            by_pairs[:, 0] += v[i] * v[j]  # y₀ is κ
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
    asked = LatticeConditions(grid.classes, Conditions("direct", 1.0))
    smallest = float(asked.smallest(point.v[0], point.kappa)[0]) + 1.0
    return coordinates.parameters(y, []), float(np.sqrt(2 * cost)), smallest


def sign_changing(data: Dataset) -> Entry:
    """Symbols of the best kernels without conditions, and what they do to static problems."""
    train, test = data["train"], data["test"]
    smallest, models = kernels_without_conditions(train)
    unsafe = smallest <= 0
    # Fits of one horizon and degree, so that nothing but the conditions differs.
    case = next(case for case in sorted(models, key=lambda case: smallest[case]) if unsafe[case])
    free, degree, ratio = models[case], DEGREES[case[0]], RATIOS[case[1]]
    kept = wp.fit(train, wp.LPS(free.horizon, wp.Bernstein(degree), FREE)).material
    errors = {
        f"{RATIOS[column]:g}, {DEGREES[row]}": displacement_error(model, test)
        for (row, column), model in models.items()
        if unsafe[row, column]
    }
    sizes, spectra = rectangle_spectra({"without": free, "with": kept}, train.spacing)
    closest = {
        f"{name} conditions": [float(np.abs(v).min()) for v in rows]
        for name, rows in spectra.items()
    }
    figure, (left, right) = panels(10.5, 4, count=2)
    draw_symbols(left, smallest)
    for (label, near), style in zip(closest.items(), "os"):
        right.semilogy(sizes, near, style, label=label, markersize=4, alpha=0.7)
    right.set(xlabel=f"unknown nodes of a rectangle (δ = {ratio:g}h, degree {degree})")
    right.set_ylabel("least |eigenvalue| over the Laplacian's [TPa]")
    right.legend(**ABOVE, frameon=False)
    negative = [int((values < 0).sum()) for values in spectra["without"]]
    nearest = {name: min(closest[f"{name} conditions"]) for name in spectra}
    numbers = edge_of_safety(unsafe) | {
        "unsafe": np.count_nonzero(unsafe), "pairs": unsafe.size, "smallest": smallest.min(),
        "ratio": ratio, "degree": degree, "negative": max(negative), "rectangles": len(sizes),
        "without": nearest["without"], "kept": nearest["with"],
        "nearer": nearest["with"] / nearest["without"],
        "best": 100 * min(errors.values()), "worst": 100 * max(errors.values()),
    }  # fmt: skip
    problem = wp.Dirichlet(test, test.loads, test.u)
    said = f"certificate: {wp.certify(free, spacing=train.spacing).statement}"
    values = {
        "ratios": RATIOS, "degrees": DEGREES, "symbol_min": smallest, "E_u of the unsafe": errors,
        "negative eigenvalues": negative, "nearest to zero": nearest,
    }  # fmt: skip
    seen = (said, lambda: wp.solve(free, problem).u)
    return entry("sign-changing", numbers, seen, figure, values)


def kernels_without_conditions(train: Samples) -> tuple[np.ndarray, dict[tuple[int, int], Model]]:
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


def edge_of_safety(unsafe: np.ndarray) -> dict[str, str]:
    """Ratios δ/h that are safe at every degree, and of the others the degree where that ends."""
    first = {
        ratio: next((degree for degree, off in zip(DEGREES, column) if off), None)
        for ratio, column in zip(RATIOS, unsafe.T)
    }
    ends = (f"δ/h = {r:g} from M = {degree}" for r, degree in first.items() if degree is not None)
    stable = (f"{ratio:g}" for ratio, degree in first.items() if degree is None)
    return {"edge": "; ".join(ends), "stable": ", ".join(stable)}


def draw_symbols(ax: Axes, smallest: np.ndarray) -> None:
    """Which degrees and horizons are stable: those of a smallest D(k)/s(k) above zero."""
    row, column = np.mgrid[: smallest.shape[0], : smallest.shape[1]]
    for label, style, some in ("stable", "C0o", smallest > 0), ("unstable", "C3X", smallest <= 0):
        ax.plot(np.array(RATIOS)[column[some]], row[some], style, label=label)
    ax.set_yticks(range(len(DEGREES)), [str(degree) for degree in DEGREES])
    ax.set(xlabel="horizon over spacing, δ/h", ylabel="degree of the influence function")
    ax.legend(**ABOVE, frameon=False)


def displacement_error(model: Model, points: Samples) -> float:
    """E_u of what LU gives without asking; `solve` refuses where the operator is indefinite."""
    L = matrices(model, points).operator(model.lam, model.mu)
    solved = MatrixProblem(L, points.interior).solve(points.loads, points.u)
    u, solved = points.u[:, points.interior], solved[:, points.interior]
    wrong = np.linalg.norm(solved - u, axis=(1, 2)) / np.linalg.norm(u, axis=(1, 2))
    return float(wrong.mean())


def other_spacing(data: Dataset, cache: Path) -> Entry:
    """Error on lattices that the model was not trained on, before and after two-grid training."""
    body, loads, samples = read_samples(cache, "test")
    spacings = (2.5, 10 / 3, 4.0, 5.0, 6.25, 8.0)
    disks = [point_set(body, loads, samples, spacing=h) for h in spacings]
    both = [data["train"], data["train_fine"]]
    table: dict[str, list[float]] = {}
    models: list[Model] = []
    for horizon in (12.5, 20.0):
        for name, sets in (("5 Å", both[:1]), ("5 and 2.5 Å", both)):
            law = wp.LPS(horizon, wp.Bernstein(12), FREE, normalise=True)
            models.append(wp.fit(sets, law).material)
            label = f"δ = {horizon:g} Å, trained on {name}"
            table[label] = [
                displacement_error(models[-1], points) if horizon / h >= 2 else np.nan
                for h, points in zip(tqdm(spacings, desc=label), disks)
            ]
    single, two = (table[f"δ = 20 Å, trained on {name}"] for name in ("5 Å", "5 and 2.5 Å"))
    short = table["δ = 12.5 Å, trained on 5 and 2.5 Å"]
    named = {
        "one_fine": single[0], "one_own": single[3], "both_fine": two[0], "both_own": two[3],
        "both_third": two[1], "both_four": two[2], "short_third": short[1], "short_four": short[2],
    }  # fmt: skip
    fine = wp.Dirichlet(disks[0], disks[0].loads, disks[0].u)
    seen = (
        lambda: wp.evaluate(models[0], disks[0]),
        lambda: wp.solve(models[0], fine, allow_uncertified=True).u,
    )
    figure, ax = panels()
    axes = {"xlabel": "spacing of the nodes / 5 Å", "ylabel": "error on unseen disks [%]"}
    styles = "C0o--", "C0s-", "C1o--", "C1s-"
    ratios = np.array(spacings) / 5.0
    curves(ax, "semilogy", ratios, table, *styles, scale=100, legend=ABOVE, **axes)
    numbers = {name: 100 * value for name, value in named.items()}
    return entry("spacing", numbers, seen, figure, {"spacings": spacings, "E_u": table})


def plain_symbol(alpha: float, ratio: float) -> tuple[float, float, float]:
    """C44/μ, smallest D/s over μ, share of the nearest bonds in m, of K = r^(−α), any α."""
    classes = bond_classes(1.0, ratio)
    kw = classes.r**-alpha * classes.weight
    v = MU * kw / (classes.count @ (kw * classes.r**2))
    kappa = (LAM - MU) / MU**2
    x1, x2 = classes.xi.T
    shear = 8 * v[classes.bond_class] @ (x1**2 * x2**2 / (x1**2 + x2**2))
    asked = LatticeConditions(classes, Conditions("direct", 1.0))
    smallest = asked.smallest(v, kappa)[0] + 1.0
    return shear / MU, smallest / MU, classes.count[0] * v[0] / MU


def steep_kernels() -> Entry:
    """α towards 3 and above."""
    alphas = np.concatenate([np.linspace(-2, 2.999, 21), np.linspace(3, 10, 15)])
    table = {ratio: np.array([plain_symbol(a, ratio) for a in alphas]) for ratio in (2.0, 3.0, 5.0)}
    shear, symbol, share = (
        dict(zip((1.0, 2.9, 2.999, 6.0, 10.0), column))
        for column in zip(*(plain_symbol(alpha, 3.0) for alpha in (1.0, 2.9, 2.999, 6.0, 10.0)))
    )
    numbers = {
        "shear_29": shear[2.9], "shear_2999": shear[2.999], "shear_6": shear[6.0],
        "shear_10": shear[10.0], "symbol_2999": symbol[2.999],
        "share_1": share[1.0], "share_2999": share[2.999], "share_10": share[10.0],
    }  # fmt: skip
    figure, axes = panels(10, 4, count=2)
    names = "shear stiffness over μ", "least stiffness of a wave over μ"
    for column, (ax, name) in enumerate(zip(axes, names)):
        for ratio, rows in table.items():
            ax.plot(alphas, rows[:, column], label=f"δ/h = {ratio:g}")
        ax.axvspan(3, 10, color="0.9")
        ax.axhline(0, color="0.6", linewidth=0.8)
        ax.set(xlabel="exponent α of K = r^(−α) (grey: refused)", ylabel=name)
        name_lines(ax)
    values = {"alpha": alphas, "by ratio": {str(ratio): rows for ratio, rows in table.items()}}
    refused = (lambda: Model(LAM, MU, 3.0, np.ones(1), 3.0),)
    return entry("exponent", numbers, refused, figure, values)


def short_horizons() -> Entry:
    """δ/h towards 1: when quadrature weights cease to exist."""
    ratios = np.linspace(1.0, 5.0, 161)
    residuals = [weight_residual(ratio) for ratio in ratios]
    kept = ratios[np.array(residuals) <= RESIDUAL]
    symbols = [plain_symbol(1.0, ratio)[1] for ratio in kept]
    weights = [bond_classes(1.0, ratio).weight for ratio in kept]
    lowest = np.array([float((weight / weight.max()).min()) for weight in weights])
    negative = kept[lowest < 0]
    numbers = {
        "accepted": max(residual for residual in residuals if residual <= RESIDUAL),
        "functions": 2 + 1 + 3 + 4 + 5 + 6 - 3,
        "residual_19": residuals[int(np.argmin(np.abs(ratios - 1.9)))],
        "residual_2": residuals[int(np.argmin(np.abs(ratios - 2.0)))],
        "smallest": min(symbols),
        "smallest_ratio": kept[int(np.argmin(symbols))],
        "negative": f"{negative.min():.2f} to {negative.max():.2f}" if len(negative) else "none",
    }
    figure, (left, right) = panels(10, 4, count=2)
    left.semilogy(ratios, residuals, ".-")
    left.axhline(RESIDUAL, color="C3", linewidth=0.8)
    note(left, "accepted below", (1, RESIDUAL), color="C3")
    horizon = "horizon over spacing, δ/h"
    left.set(xlabel=horizon, ylabel="relative residual of the conditions on weights")
    rows = {"least stiffness of a wave over μ": symbols, "least weight over the largest": lowest}
    curves(right, "plot", kept, rows, ".", xlabel=horizon, legend=ABOVE | {"ncols": 1})
    right.axhline(0, color="0.6", linewidth=0.8)
    seen = (lambda: bond_classes(5.0, 9.9), lambda: bond_classes(5.0, 4.0))
    values = {"ratio": ratios, "residual": residuals, "kept": kept, "symbol_min": symbols}
    return entry("horizon", numbers, seen, figure, values)


def weight_residual(ratio: float) -> float:
    """Relative residual of the best quadrature weights of a lattice family with δ = ratio · h."""
    reach = int(ratio * (1 + 1e-6))
    steps = np.argwhere(np.ones(2 * [2 * reach + 1])) - reach
    length = np.hypot(*steps.T)
    xi = steps[(length > 0) & (length <= ratio * (1 + 1e-6))].astype(float)
    return max(float(family_weights(xi[None], ratio)[1][0]), 1e-17)


def large_degrees(data: Dataset) -> Entry:
    """Conditioning of the Bernstein basis at the bonds, and fits of high degree."""
    train, horizon = data["train"], 20.0
    classes = bond_classes(train.spacing, horizon)
    degrees = (0, 1, 2, 4, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000)
    condition = []
    for degree in degrees:
        size = np.linalg.svd(bernstein_basis(classes.r, horizon, degree), compute_uv=False)
        condition.append(size[0] / size[min(len(size), degree + 1) - 1])
    tried = (0, 2, 5, 10, 20, 50, 100)
    errors, swings = [], []
    r = np.linspace(train.spacing, horizon, 2000)
    for degree in tqdm(tried, desc="high degrees"):
        fit = wp.fit(train, wp.LPS(horizon, wp.Bernstein(degree), FREE))
        errors.append(fit.history[-1].E_res_train)
        at_bonds = np.abs(fit.material.influence(classes.r)).max()
        swings.append(float(np.abs(fit.material.influence(r)).max() / at_bonds))
    worst, widest = int(np.argmax(condition)), int(np.argmax(swings))
    numbers = {
        "worst": condition[worst], "worst_degree": degrees[worst],
        "condition_8": condition[degrees.index(8)], "swing_100": swings[tried.index(100)],
        "error_10": 100 * errors[tried.index(10)], "error_100": 100 * errors[tried.index(100)],
        "swing": swings[widest], "swing_degree": tried[widest],
    }  # fmt: skip
    figure, (left, right) = panels(10, 4, count=2)
    axes = {"xlabel": "degree of the influence function"}
    left.semilogy([*map(str, degrees)], condition, "o-")
    left.tick_params("x", labelsize=8)
    left.set(ylabel="condition of the basis at nine bond lengths", **axes)
    rows = {
        "error of the load, training [%]": 100 * np.array(errors),
        "largest |K| between bonds over that at bonds": np.array(swings),
    }
    above = ABOVE | {"ncols": 1}
    curves(right, "semilogy", [*map(str, tried)], rows, "o-", "s-", legend=above, **axes)
    values = {
        "degrees": degrees, "condition": condition, "tried": tried, "E_res": errors, "swing": swings
    }  # fmt: skip
    refused = (lambda: bernstein_basis(classes.r, horizon, 1030),)
    return entry("degree", numbers, refused, figure, values)
