"""Stability atlas: kernels that fail on their lattice, or away from it."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import least_squares
from tqdm import tqdm

import warp_peri
from examples.studies.atlas_entry import Entry, square_lattice, words
from warp_peri.learning.coordinates import Coordinates
from warp_peri.learning.parameters import Parameters
from warp_peri.losses.full import sample_weights
from warp_peri.losses.reduced import ReducedLoss, reduce
from warp_peri.models.influence import bernstein_basis
from warp_peri.models.lps import Model
from warp_peri.operator.matrices import matrices
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import bond_classes
from warp_peri.points.quadrature import RESIDUAL, family_weights
from warp_peri.points.samples import Samples
from warp_peri.stability.conditions import Conditions, LatticeConditions, ZoneSearch
from warp_peri.statics.direct import MatrixProblem

RATIOS = (2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
DEGREES = (0, 1, 2, 3, 4, 5, 6, 8, 10, 15, 20)
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

        def residual(y: np.ndarray, at: Coordinates = coordinates) -> np.ndarray:
            point = at.point(y)
            v, z = point.v[0], point.z[0]
            return grid.R @ np.concatenate([v, point.kappa * z[i] * z[j], [1.0]])

        def slope(y: np.ndarray, at: Coordinates = coordinates) -> np.ndarray:
            point = at.point(y)
            z, dv, dz = point.z[0], point.dv[0], point.dz[0]
            by_pairs = point.kappa * (z[i][:, None] * dz[j] + z[j][:, None] * dz[i])
            by_pairs[:, 0] += z[i] * z[j]  # y₀ is κ
            return grid.R[:, :-1] @ np.concatenate([dv, by_pairs])

        start = coordinates.start(Parameters(-0.2, 0.7, alpha, np.ones(degree + 1)))
        low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
        if coordinates.free_alpha:
            low[-1], high[-1] = -6.0, 2.999
        found = least_squares(
            residual, start, jac=slope, bounds=(low, high), x_scale="jac", xtol=1e-12, ftol=1e-12
        )
        if best is None or found.cost < best[0]:
            best = found.cost, found.x, coordinates
    assert best is not None
    cost, y, coordinates = best
    point = coordinates.point(y)
    search = ZoneSearch(LatticeConditions(grid.classes, Conditions("direct", 1.0)))
    smallest = float(search.worst(point.v[0], point.z[0], point.kappa)[0][0]) + 1.0
    return coordinates.parameters(y, []), float(np.sqrt(2 * cost)), smallest


def sign_changing(data: Dataset) -> Entry:
    """Symbols of the best kernels without conditions, and what they do to static problems."""
    train, test = data["train"], data["test"]
    weight = sample_weights([train], normalise=False)[0]
    smallest = np.empty((len(DEGREES), len(RATIOS)))
    models: dict[tuple[int, int], Model] = {}
    for column, ratio in enumerate(tqdm(RATIOS, desc="kernels without conditions")):
        grid = reduce(train, ratio * train.spacing, weight)
        for row, degree in enumerate(DEGREES):
            found, _, smallest[row, column] = unconstrained(grid, degree)
            if found.mu > 0 and found.lam + found.mu > 0:
                models[row, column] = Model(
                    found.lam, found.mu, found.alpha, found.D, ratio * train.spacing
                )
    unsafe = smallest <= 0
    # Fits of one horizon and degree, so that nothing but the conditions differs.
    at = next(at for at in sorted(models, key=lambda at: smallest[at]) if unsafe[at])
    free, degree, ratio = models[at], DEGREES[at[0]], RATIOS[at[1]]
    kept = warp_peri.fit(train, horizon=free.horizon, kernel=warp_peri.Bernstein(degree)).model
    errors = {key: displacement_error(one, test) for key, one in models.items() if unsafe[key]}
    sides = range(4, 17)
    sizes, spectra = [], {"without": [], "with": []}  # type: ignore[var-annotated]
    shapes = [(a, b) for a in sides for b in sides if a <= b]
    for a, b in tqdm(shapes, desc="rectangles"):
        sizes.append(a * b)
        points = square_lattice((a, b), free.horizon, train.spacing)
        unknown = np.repeat(points.interior, 2)
        squares = np.sin(np.pi / (2 * (np.array([a, b]) + 1))) ** 2
        laplacian = 4 / train.spacing**2 * squares.sum()
        for name, one in (("without", free), ("with", kept)):
            L = matrices(one, points).operator(one.lam, one.mu)[:, unknown].toarray()
            spectra[name].append(np.linalg.eigvalsh((L + L.T) / 2) / laplacian)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4), layout="constrained")
    mesh = left.pcolormesh(
        np.arange(len(RATIOS)), np.arange(len(DEGREES)), np.arcsinh(smallest / 0.01),
        cmap="RdBu", vmin=-np.arcsinh(1e3), vmax=np.arcsinh(1e3), shading="nearest",
    )  # fmt: skip
    for at, value in np.ndenumerate(smallest):
        left.text(at[1], at[0], f"{value:.2g}", ha="center", va="center", fontsize=7)
    left.set_xticks(range(len(RATIOS)), [f"{ratio:g}" for ratio in RATIOS])
    left.set_yticks(range(len(DEGREES)), [str(degree) for degree in DEGREES])
    left.set_xlabel("δ/h")
    left.set_ylabel("degree M")
    left.set_title("smallest D(k)/s(k) [TPa], no conditions asked")
    bar = figure.colorbar(mesh, ax=left, ticks=np.arcsinh(np.array([-1, -0.01, 0, 0.01, 1]) / 0.01))
    bar.ax.set_yticklabels(["−1", "−0.01", "0", "0.01", "1"])
    for name, style in (("without", "o"), ("with", "s")):
        closest = [float(np.abs(values).min()) for values in spectra[name]]
        right.semilogy(sizes, closest, style, label=f"{name} conditions", markersize=4, alpha=0.7)
    right.set_xlabel("unknown nodes of a rectangle")
    right.set_ylabel("smallest |eigenvalue of L| / λ₁ [TPa]")
    right.set_title(f"δ = {ratio:g}h, M = {degree}; λ₁: 5-point Laplacian")
    right.legend(frameon=False)
    negative = [int((values < 0).sum()) for values in spectra["without"]]
    first = [
        next((DEGREES[r] for r in range(len(DEGREES)) if unsafe[r, c]), None)
        for c in range(len(RATIOS))
    ]
    stable = ", ".join(f"{r:g}" for r, d in zip(RATIOS, first) if d is None)
    edge = "; ".join(
        f"δ/h = {ratio:g} from M = {found}" for ratio, found in zip(RATIOS, first)
        if found is not None
    )  # fmt: skip
    nearest = {name: min(float(np.abs(v).min()) for v in spectra[name]) for name in spectra}
    worst = max(errors.values())
    text = f"""The data alone do not ask for a stable operator. The kernel with the smallest residual on the
training samples may have waves of negative stiffness ($D(k)$ of (20) below zero): {np.count_nonzero(unsafe)} of {unsafe.size} pairs
of horizon and degree are unsafe, the worst at {smallest.min():.3g} TPa. The edge, on these data: {edge}; none up to M = 20
at δ/h = {stable}. It is not sharp: where fits are safe without conditions, nothing but the data made them so.

What comes of it depends on the domain. With δ = {ratio:g}h and M = {degree} the kernel without conditions has up to
{max(negative)} negative eigenvalues on rectangles of 4 to 16 nodes a side, and its spectrum passes zero on the way: the
smallest |eigenvalue| over λ₁ of the 5-point Laplacian is {nearest["without"]:.1e} TPa on the worst of {len(shapes)} rectangles, so that
its answers may be {nearest["with"] / nearest["without"]:.0f} times too large there, while the kernel fitted under (23) stays above
{nearest["with"]:.2g} TPa on every one. A load that does not meet such an eigenvalue may look fine: on the four held-out disks the
unsafe kernels, solved without asking, err by {100 * min(errors.values()):.2g} to {100 * worst:.3g} %. In time every one of them blows up at any step."""
    certificate = warp_peri.certify(free, spacing=train.spacing)
    return Entry(
        "Sign-changing kernels without conditions",
        f"{np.count_nonzero(unsafe)} of {unsafe.size} pairs (δ/h, M) have a negative symbol, down to "
        f"{smallest.min():.2g} TPa; rectangles {nearest['with'] / nearest['without']:.0f} times nearer to singular",
        text,
        [
            f"certificate: {certificate.statement}",
            words(lambda: warp_peri.solve(free, test, test.loads, test.u)),
        ],
        figure,
        {
            "ratios": RATIOS,
            "degrees": DEGREES,
            "symbol_min": smallest,
            "E_u of the unsafe": {
                f"{RATIOS[c]:g}, {DEGREES[r]}": e for (r, c), e in errors.items()
            },
            "negative eigenvalues": negative,
            "nearest to zero": nearest,
        },
    )


def displacement_error(model: Model, points: Samples) -> float:
    """E_u of what LU gives without asking; `solve` refuses where the operator is indefinite."""
    L = matrices(model, points).operator(model.lam, model.mu)
    found = MatrixProblem(L, points.interior).solve(points.loads, points.u)
    u = points.u[:, points.interior]
    wrong = np.linalg.norm(found[:, points.interior] - u, axis=(1, 2)) / np.linalg.norm(
        u, axis=(1, 2)
    )
    return float(wrong.mean())


def other_spacing(data: Dataset, cache: Path) -> Entry:
    """Error on lattices that the model was not trained on, before and after two-grid training."""
    from tools.make_graphene import point_set, read_samples

    body, loads, samples = read_samples(cache, "test")
    spacings = (2.5, 10 / 3, 4.0, 5.0, 6.25, 8.0)
    disks = [point_set(body, loads, samples, spacing=h) for h in spacings]
    both = [data["train"], data["train_fine"]]
    table: dict[str, list[float]] = {}
    first: Model | None = None
    for horizon in (12.5, 20.0):
        for name, sets in (("5 Å", both[:1]), ("5 and 2.5 Å", both)):
            model = warp_peri.fit(
                sets, horizon=horizon, kernel=warp_peri.Bernstein(12), normalise=True
            ).model
            first = first or model
            label = f"δ = {horizon:g} Å, trained on {name}"
            table[label] = []
            for h, points in zip(tqdm(spacings, desc=label), disks):
                fits = horizon / h >= 2
                table[label].append(displacement_error(model, points) if fits else np.nan)
    assert first is not None
    model, ratio = first, np.array(spacings) / 5.0
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for number, (label, values) in enumerate(table.items()):
        style = "o--" if number % 2 == 0 else "s-"
        ax.semilogy(ratio, 100 * np.array(values), style, color=f"C{number // 2}", label=label)
    ax.set_xlabel("spacing of the nodes / 5 Å")
    ax.set_ylabel("E_u on held-out disks [%]")
    ax.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    one, two = (table[f"δ = 20 Å, trained on {name}"] for name in ("5 Å", "5 and 2.5 Å"))
    short = table["δ = 12.5 Å, trained on 5 and 2.5 Å"]
    text = f"""A kernel learned on one lattice knows $K$ at the bond lengths of that lattice only. At δ = 20 Å, trained on
5 Å and used on 2.5 Å, it errs by {100 * one[0]:.3g} % (5 Å: {100 * one[3]:.2g} %). Trained on both, it errs by
{100 * two[0]:.2g} and {100 * two[3]:.2g} % there, and between them, on 3.33 and 4 Å, by {100 * two[1]:.3g} and
{100 * two[2]:.3g} % (δ = 12.5 Å: {100 * short[1]:.3g} and {100 * short[2]:.3g} %). So two grids do not teach a third: a
model belongs to the spacings it is certified on. These are errors of answers taken without asking: where the
operator is indefinite, the library refuses."""
    return Entry(
        "A kernel off its training spacing",
        f"E_u on 2.5 Å nodes: {100 * one[0]:.3g} % trained on 5 Å, {100 * two[0]:.2g} % trained on both "
        "(δ = 20 Å)",
        text,
        [
            words(lambda: warp_peri.evaluate(model, disks[0])),
            words(
                lambda: warp_peri.solve(
                    model, disks[0], disks[0].loads, disks[0].u, allow_uncertified=True
                )
            ),
        ],
        figure,
        {"spacings": spacings, "E_u": table},
    )


def plain_symbol(alpha: float, ratio: float) -> tuple[float, float, float]:
    """C44/μ, smallest D/s over μ, share of the nearest bonds in m, of K = r^(−α), any α."""
    classes = bond_classes(1.0, ratio)
    kw = classes.r**-alpha * classes.weight
    v = MU * kw / (classes.count @ (kw * classes.r**2))
    kappa = (LAM - MU) / MU**2
    x1, x2 = classes.xi.T
    shear = 8 * v[classes.bond_class] @ (x1**2 * x2**2 / (x1**2 + x2**2))
    search = ZoneSearch(LatticeConditions(classes, Conditions("direct", 1.0)))
    smallest = search.worst(v, v, kappa)[0][0] + 1.0
    return shear / MU, smallest / MU, classes.count[0] * v[0] / MU


def steep_kernels() -> Entry:
    """α towards 3 and above."""
    alphas = np.concatenate([np.linspace(-2, 2.999, 21), np.linspace(3, 10, 15)])
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    table = {ratio: np.array([plain_symbol(a, ratio) for a in alphas]) for ratio in (2.0, 3.0, 5.0)}
    for ratio, values in table.items():
        for ax, column in zip(axes, (0, 1)):
            ax.plot(alphas, values[:, column], label=f"δ/h = {ratio:g}")
    for ax, name in zip(axes, ("C44/μ of the discrete operator", "smallest D(k)/s(k) / μ")):
        ax.axvspan(3, 10, color="0.9")
        ax.axhline(0, color="0.6", linewidth=0.8)
        ax.set_xlabel("exponent α of K = r^(−α) (grey: refused)")
        ax.set_ylabel(name)
    axes[0].legend(frameon=False)
    at = {a: plain_symbol(a, 3.0) for a in (1.0, 2.9, 2.999, 6.0, 10.0)}
    text = f"""Nothing breaks at α = 3 on a given lattice: the symbol is smooth in α. What goes is accuracy, long before.
The steeper the kernel, the more the nearest bonds carry (δ = 3h: {at[1.0][2]:.0%} of $m$ at α = 1,
{at[2.999][2]:.0%} at 2.999, {at[10.0][2]:.0%} at 10), and nearest bonds alone resist no shear: $C_{{44}}/\\mu$ is 1 at
α = 1 and {at[2.9][0]:.2f} at 2.9, {at[6.0][0]:.2f} at 6 and {at[10.0][0]:.3f} at 10. The quadrature is
consistent for α < 3 only ([Y] remark 1), hence the refusal. A fit ends at 2.999, and its long-wave moduli are
reported beside λ and μ."""
    return Entry(
        "Exponents towards 3 and above",
        f"C44/μ = {at[2.999][0]:.2f} at α = 2.999 and δ = 3h, where it is 1 at α = 1; still "
        f"{at[2.999][1]:.2f} μ of symbol",
        text,
        [words(lambda: Model(LAM, MU, 3.0, np.ones(1), 3.0))],
        figure,
        {"alpha": alphas, "by ratio": {str(ratio): values for ratio, values in table.items()}},
    )


def short_horizons() -> Entry:
    """δ/h towards 1: when quadrature weights cease to exist."""
    ratios = np.linspace(1.0, 5.0, 161)
    residuals, counts = [], []
    for ratio in ratios:
        reach = int(ratio * (1 + 1e-6))
        steps = np.argwhere(np.ones(2 * [2 * reach + 1])) - reach
        length = np.hypot(*steps.T)
        xi = steps[(length > 0) & (length <= ratio * (1 + 1e-6))].astype(float)
        residuals.append(max(float(family_weights(xi[None], ratio)[1][0]), 1e-17))
        counts.append(len(xi))
    good = np.array([residual <= RESIDUAL for residual in residuals])
    kept = ratios[good]
    worst = [plain_symbol(1.0, ratio)[1] for ratio in kept]
    lowest = []
    for ratio in kept:
        classes = bond_classes(1.0, ratio)
        lowest.append(float((classes.weight / classes.weight.max()).min()))
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    axes[0].semilogy(ratios, residuals, ".-")
    axes[0].axhline(RESIDUAL, color="C3", linewidth=0.8, label="accepted")
    axes[0].set_ylabel("relative residual of the quadrature's conditions")
    axes[0].legend(frameon=False)
    axes[1].plot(kept, worst, ".", label="smallest D(k)/s(k) / μ, K = 1/r")
    axes[1].plot(kept, lowest, ".", label="smallest weight / largest")
    axes[1].axhline(0, color="0.6", linewidth=0.8)
    axes[1].legend(frameon=False)
    for ax in axes:
        ax.set_xlabel("δ/h")
    negative = kept[np.array(lowest) < 0]
    holes = f"{negative.min():.2f} to {negative.max():.2f}" if len(negative) else "none"
    text = f"""The weights must be exact on {2 + 1 + 3 + 4 + 5 + 6 - 3} functions (8). Below δ = 2h the 4 to 8 bonds of a family
cannot: the residual jumps from {residuals[int(np.argmin(np.abs(ratios - 1.9)))]:.1e} at 1.9h to
{residuals[int(np.argmin(np.abs(ratios - 2.0)))]:.1e} at 2h. From 2h on weights exist at every ratio up to 5 and the symbol of
K = 1/r stays positive (smallest {min(worst):.2f} μ, at {kept[int(np.argmin(worst))]:.2f}h); ratios with negative
weights: {holes}; at 2h the bond (1, 1) has weight zero."""
    return Entry(
        "Horizons towards one spacing",
        f"no exact weights below δ = 2h; residual {max(r for r, g in zip(residuals, good) if g):.0e} "
        "or less above",
        text,
        [
            words(lambda: bond_classes(5.0, 9.9)),
            words(lambda: bond_classes(5.0, 4.0)),
        ],
        figure,
        {"ratio": ratios, "residual": residuals, "kept": kept, "symbol_min": worst},
    )


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
        found = warp_peri.fit(train, horizon=horizon, kernel=warp_peri.Bernstein(degree))
        errors.append(found.history[-1].E_res_train)
        at_bonds = np.abs(found.model.influence(classes.r)).max()
        swings.append(float(np.abs(found.model.influence(r)).max() / at_bonds))
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    axes[0].loglog(np.maximum(degrees, 0.5), condition, "o-")
    axes[0].set_ylabel("condition of B_k,M(r_c/δ), 9 bond lengths, δ = 4h")
    axes[1].plot(np.maximum(tried, 0.5), 100 * np.array(errors), "o-", label="E_res, training [%]")
    axes[1].plot(np.maximum(tried, 0.5), swings, "s-", label="max |K| between bonds / at bonds")
    axes[1].set_xscale("log")
    axes[1].set_yscale("log")
    axes[1].legend(frameon=False)
    for ax in axes:
        ax.set_xlabel("degree M")
    worst = int(np.argmax(condition))
    text = f"""Nine bond lengths see nine combinations of the M + 1 coefficients. At M = 8 the basis is just square and its
condition {condition[degrees.index(8)]:.1e}; the worst is {condition[worst]:.1e} at M = {degrees[worst]}. The fit works in the span of the
tables (27) instead of in D, so that E_res stays at {100 * errors[3]:.2f} to {100 * errors[-1]:.2f} % from M = 10 to 100,
with no gain; between the bonds the polynomial rises to {max(swings):.3g} times its largest value at a bond (M = {tried[int(np.argmax(swings))]}; {swings[-1]:.2g} times at M = 100, since the
smoothest coefficients are taken).
Above 1029 the binomial coefficients overflow."""
    return Entry(
        "Very high degrees",
        f"condition of the basis {max(condition):.1e} at M = {degrees[worst]}; E_res {100 * errors[3]:.2f} % at M = 10, "
        f"{100 * errors[-1]:.2f} % at 100",
        text,
        [words(lambda: bernstein_basis(classes.r, horizon, 1030))],
        figure,
        {
            "degrees": degrees,
            "condition": condition,
            "tried": tried,
            "E_res": errors,
            "swing": swings,
        },
    )
