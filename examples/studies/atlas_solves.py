"""Stability atlas: solves that fail through constants, precision, points, or free surfaces."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import spsolve
from tqdm import tqdm

import warp_peri as wp
from examples.figures import curves, name_lines, panels, ticks
from examples.prose import rows_of
from examples.studies.atlas_entry import Entry, as_read, entry, square_lattice
from examples.studies.atlas_kernels import unconstrained
from warp_peri import Dataset, Model, Points, Samples
from warp_peri.launch import ints
from warp_peri.lps.bonds import Bonds, influence
from warp_peri.lps.matrices import assemble, matrices
from warp_peri.lps.model import stiffnesses
from warp_peri.lps.operator import lps_force
from warp_peri.methods import Conditions, Solid
from warp_peri.points.families import bond_classes, families_of
from warp_peri.regression.losses import reduce, sample_weights
from warp_peri.regression.optimum import LatticeConditions

MU = 0.7223
HORIZON = 20.0
BULK = np.concatenate([np.logspace(-6, 0, 13), np.logspace(0.5, 6, 12)])
"""(λ + μ)/μ."""
RATIOS, SPACINGS = (1.0, 1e2, 1e4, 1e6), np.pi / np.array([8, 16, 32])
"""λ/μ and h of the errors against elasticity."""
REACH, NUMBER, SEEDS = 3.0, 12, range(4)
"""δ/h, unknown nodes a side, and seeds of the scattered points."""
LAM = 0.3 * MU
SOFT, HARD = "λ/μ = -0.27", "λ/μ = 3"

Kernels = Mapping[str, tuple[float, np.ndarray]]
"""α and D by name."""


def _gradient_part(x: np.ndarray) -> np.ndarray:
    a, b = x.T
    return np.stack([np.cos(a) * np.sin(2 * b), 2 * np.sin(a) * np.cos(2 * b)], axis=1)


def elastic_field(x: np.ndarray, lam: float, mu: float) -> np.ndarray:
    """curl ψ + (μ/λ) ∇χ, ψ = cos x cos 2y, χ = sin x sin 2y: its pressure is finite at any λ."""
    a, b = x.T
    curl = np.stack([-2 * np.cos(a) * np.sin(2 * b), np.sin(a) * np.cos(2 * b)], axis=1)
    return curl + mu / lam * _gradient_part(x)


def elastic_error(points: Points, lam: float, horizon: float) -> float:
    """Relative ℓ2 error of the solve with K = 1/r against linear elasticity."""
    model = Model(lam, MU, 1.0, np.ones(1), horizon)
    u = elastic_field(points.x, lam, MU)
    b = 5 * MU * (u + (1 + MU / lam) * _gradient_part(points.x))  # −[μ∇²u + (λ+μ)∇(∇·u)]
    solved = quiet_solve(model, points, b, u)
    inside = points.interior
    return float(np.linalg.norm((solved - u)[inside]) / np.linalg.norm(u[inside]))


def quiet_solve(model: Model, points: Points, b: np.ndarray, u: np.ndarray) -> np.ndarray:
    """solve, certified or not."""
    with warnings.catch_warnings(action="ignore"):
        return wp.solve(model, wp.Dirichlet(points, b, u), allow_uncertified=True).u


def lame_parameters(data: Dataset) -> Entry:
    """λ + μ → 0, λ < μ and λ/μ → 10⁶, for kernels with and without conditions."""
    train = data["train"]
    kernels = kernels_by_conditions(train)
    symbols, conditions = by_bulk_modulus(kernels, train.spacing)
    errors = {
        ratio: [
            elastic_error(square_lattice(round(np.pi / h), 3 * h, h), ratio * MU, 3 * h)
            for h in SPACINGS
        ]
        for ratio in RATIOS
    }
    orders = [_order(SPACINGS, row) for row in errors.values()]
    least = {name: values[0] for name, values in symbols.items()}
    alpha, D = kernels["conditions 'direct'"]
    soft = Model(-MU * (1 - 1e-6), MU, alpha, D, HORIZON)
    numbers = {
        "plain": least["1/r"], "paper": least["conditions 'paper'"],
        "direct": least["conditions 'direct'"], "free": least["no conditions"],
        "condition_soft": min(conditions["1/r"]), "condition_hard": conditions["1/r"][-1],
        "condition_direct": conditions["conditions 'direct'"][-1],
        "order_soft": orders[0], "order_hard": orders[-1],
    }  # fmt: skip
    seen = (
        lambda: Model(-MU, MU, 1.0, np.ones(1), HORIZON),
        f"certificate: {wp.certify(soft, spacing=train.spacing).statement}",
    )
    figure, (left, middle, right) = panels(13, 4, count=3)
    for name in symbols:
        said = name.replace("'direct'", "of solvability").replace("'paper'", "of the source")
        left.loglog(BULK, symbols[name], "o-", label=said, markersize=3)
        middle.loglog(BULK, conditions[name], "o-", markersize=3)
    left.set(xlabel="(λ + μ)/μ", ylabel="least stiffness of a wave over μ, where positive")
    name_lines(left)
    middle.set(xlabel="(λ + μ)/μ", ylabel="condition of the operator, 12 × 12 nodes")
    rows = {
        as_read(f"λ/μ = {ratio:.0e}, order {order:.2f}"): row
        for (ratio, row), order in zip(errors.items(), orders)
    }
    axes = {"xlabel": "spacing (side π), δ = 3h", "ylabel": "relative error against elasticity"}
    curves(right, "loglog", SPACINGS, rows, "o-", **axes)
    ticks(right, SPACINGS, [f"π/{round(np.pi / h)}" for h in SPACINGS])
    values = {"bulk": BULK, "symbol_min": symbols, "condition": conditions, "orders": orders}
    return entry("lame", numbers, seen, figure, values)


def _order(spacings: np.ndarray, errors: Sequence[float]) -> float:
    """Of convergence: the slope of log error over log h."""
    return float(np.polyfit(np.log(spacings), np.log(errors), 1)[0])


def kernels_by_conditions(train: Samples) -> Kernels:
    """1/r, and what the data teach without conditions and with those of each kind."""
    weight = sample_weights([train], normalise=False)[0]
    free, _, _ = unconstrained(reduce(train, HORIZON, weight), 10)
    kernels = {"1/r": (1.0, np.ones(1)), "no conditions": (free.alpha, free.D)}
    for kind in ("direct", "paper"):
        model = wp.fit(
            train,
            wp.LPS(
                HORIZON,
                wp.Bernstein(10),
                wp.methods.Optimum(moduli=None),
                wp.methods.Conditions(kind),
            ),
        ).material
        kernels[f"conditions '{kind}'"] = (model.alpha, model.D)
    return kernels


def by_bulk_modulus(
    kernels: Kernels, spacing: float
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Smallest D(k)/s(k) over μ, and the condition of L on 12 × 12 nodes, for every BULK."""
    small = square_lattice(12, HORIZON, spacing)
    classes = bond_classes(spacing, HORIZON)
    asked = LatticeConditions(classes, Conditions("direct", 1.0))
    symbols: dict[str, list[float]] = {}
    conditions: dict[str, list[float]] = {}
    unknown = np.repeat(small.interior, 2)
    for name, (alpha, D) in kernels.items():
        symbols[name], conditions[name] = [], []
        for value in tqdm(BULK, desc=name):
            model = Model((value - 1) * MU, MU, alpha, D, HORIZON)
            worst = asked.smallest(*stiffnesses(model, classes))[0] + 1.0
            symbols[name].append(float(worst) / MU)
            L = matrices(model, small).operator(model.lam, model.mu)[:, unknown].toarray()
            conditions[name].append(float(np.linalg.cond(L)))
    return symbols, conditions


def single_precision() -> Entry:
    """Forces of a field on top of a rigid shift, in float32 and float64."""
    horizon, points = 3.0, square_lattice(24, 3.0, 1.0)
    shifts = np.logspace(-2, 6, 17)
    u = 1e-3 * np.stack([np.sin(points.x[:, 0] / 3), np.cos(points.x[:, 1] / 4)], axis=1)
    solid = Solid(-0.2, MU, 1.0, [1.0])
    errors: dict[str, list[float]] = {}
    rough = {}
    exact = lps_force(Bonds(points, horizon), torch.from_numpy(u), solid).numpy()
    for precision, dtype in (("float32", torch.float32), ("float64", torch.float64)):
        bonds = Bonds(points, horizon, precision=precision)

        def error(field: np.ndarray, bonds: Bonds = bonds, dtype: torch.dtype = dtype) -> float:
            force = lps_force(bonds, torch.from_numpy(field).to(dtype), solid).double().numpy()
            return float(np.linalg.norm(force - exact) / np.linalg.norm(exact))

        errors[precision] = [error(u + shift) for shift in shifts]
        rough[precision] = error(u)
    lost = shifts[int(np.argmax(np.array(errors["float32"]) > 0.01))]
    figure, ax = panels()
    axes = {"xlabel": "rigid shift [Å] under displacements of 10⁻³ Å"}
    axes["ylabel"] = "relative error of the force"
    rows = {name: np.maximum(values, 1e-17) for name, values in errors.items()}
    curves(ax, "loglog", shifts, rows, "o-", **axes)
    ax.axhline(1, color="0.6", linewidth=0.8)
    numbers = {"rough_single": rough["float32"], "rough_double": rough["float64"], "lost": lost}
    values = {"shift": shifts, "error": errors, "unshifted": rough}
    single = Bonds(points, horizon, precision="float32")
    seen = (lambda: lps_force(single, torch.from_numpy(u), solid),)
    return entry("float32", numbers, seen, figure, values)


def perturbed(number: int, horizon: float, perturbation: float, seed: int) -> Points:
    """number × number nodes shifted by up to `perturbation` spacings, and their collar."""
    pad = int(np.ceil(2 * horizon + 2 * perturbation + 1))
    steps = np.argwhere(np.ones(2 * [number + 2 * pad])) - pad
    shift = np.random.default_rng(seed).uniform(-perturbation, perturbation, steps.shape)
    inside = np.all((steps >= 0) & (steps < number), axis=1)
    return Points(steps + shift, inside, 0.0)


def scattered_points() -> Entry:
    """Irregularity, clusters and holes: weights, eigenvalues and errors."""
    shifts = np.linspace(0, 0.5, 11)
    figures = np.array(
        [
            [figures_of(perturbed(NUMBER, REACH, shift, seed)) for seed in SEEDS]
            for shift in tqdm(shifts, desc="scattered points")
        ]
    )
    base = perturbed(NUMBER, REACH, 0.2, 0)
    away = np.linalg.norm(base.x - base.x[base.interior].mean(axis=0), axis=1)
    near = np.argsort(away)[:8]
    twice = base.x.copy()
    twice[near[1]] = twice[near[0]]
    rows = {name: damaged(points) for name, points in holes_and_clusters(base, away, near).items()}
    mean, low, high = figures.mean(axis=1), figures.min(axis=1), figures.max(axis=1)
    turn = "it stays positive"
    if low[:, 0].min() < 0:
        turn = f"below zero for some seed from {shifts[int(np.argmax(low[:, 0] < 0))]:.2f} h on"
    numbers = {
        "seeds": len(SEEDS), "number": NUMBER, "turn": turn, "asymmetry": high[-1, 1],
        "eigenvalue": mean[0, 0], "eigenvalue_half": low[-1, 0],
        "negative": high[-1, 2], "first_negative": shifts[int(np.argmax(high[:, 2] > 0))],
        "error": mean[0, 3], "error_half": high[-1, 3],
        "rows": rows_of([name, *cells(row)] for name, row in rows.items()),
    }  # fmt: skip
    seen = (
        lambda: solid().on(base),
        lambda: families_of(replace(base, x=twice), REACH),
        lambda: families_of(perturbed(6, 2.0, 0.5, 0), 2.0),
    )
    figure, axes = panels(9, 6.4, count=2, rows=2)
    names = (
        "smallest eigenvalue [TPa/h²]",
        "asymmetry of the operator",
        "share of negative weights",
        "relative error against elasticity",
    )
    for ax, name, column in zip(axes.flat, names, range(4)):
        ax.plot(shifts, mean[:, column], "o-", markersize=3)
        ax.fill_between(shifts, low[:, column], high[:, column], alpha=0.25)
        ax.set(xlabel="shift of the nodes [spacings]", ylabel=name)
    axes[0, 0].axhline(0, color="0.6", linewidth=0.8)
    solved = sum(len(row) == 3 for row in rows.values())
    values = {"shifts": shifts, "figures": figures, "cases": rows, "solved": solved}
    return entry("scattered", numbers, seen, figure, values)


def solid() -> Model:
    """K = 1/r and λ = 0.3 μ, lengths in spacings."""
    return Model(LAM, MU, 1.0, np.ones(1), REACH)


def figures_of(points: Points) -> tuple[float, float, float, float]:
    """Smallest eigenvalue, asymmetry, share of negative weights, and error against elasticity."""
    figures = wp.proofs.solvability(solid(), points)
    h = np.pi / NUMBER
    error = elastic_error(replace(points, x=h * points.x), LAM, REACH * h)
    return figures.symmetric_min, figures.asymmetry, figures.negative_weights, error


def holes_and_clusters(base: Points, away: np.ndarray, near: np.ndarray) -> dict[str, Points]:
    """Points without the nodes of a disk, or with eight of them close together, by name."""
    cases = {}
    for radius in (0.8, 1.6, 2.4):
        kept = away > radius
        cases[f"hole of radius {radius:g} h"] = replace(
            base, x=base.x[kept], interior=base.interior[kept]
        )
    middle = base.x[base.interior].mean(axis=0)
    for gap in (0.3, 0.1, 0.03, 0.01):
        x = base.x.copy()
        x[near] = middle + gap * np.random.default_rng(1).normal(size=(8, 2))
        cases[f"8 nodes within {gap:g} h"] = replace(base, x=x)
    return cases


def damaged(points: Points) -> list[float] | list[str]:
    """Smallest eigenvalue, share of negative weights and error; or why it is refused."""
    try:
        smallest, _, negative, error = figures_of(points)
    except wp.InputError as refused:
        return [str(refused)]
    return [smallest, negative, error]


def cells(row: Sequence[float | str]) -> list[str]:
    """The row of `damaged` in a table."""
    if len(row) == 1:
        return [f"refused: {str(row[0])[:60]}…", "", ""]
    return [f"{row[0]:.3g}", f"{row[1]:.1%}", f"{row[2]:.2%}"]


def free_edge(number: int, lam: float, *, corrected: bool) -> float:
    """Largest error on a unit square whose right edge is free, under an affine field, no load."""
    h = 1 / number
    horizon = 3 * h
    points = square_lattice(number, horizon, h)
    points = replace(points, x=points.x + 0.5 * h)
    outside = points.x[:, 0] > 1
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    a, b = points.x.T
    stretch = 3 * lam / (lam + 2 * MU)  # no stress across the edge
    exact = np.stack([stretch * a + b, -a - 3 * b], axis=1)
    bonds = Bonds(body, horizon)
    if not corrected:
        bonds.cut = ints(np.zeros(0))  # dilatation as at whole nodes, (6), its bonds broken
    scalar = torch.ones(1, dtype=torch.float64)
    alpha, D = (bonds.floats(scalar.numpy()) for _ in range(2))
    L = assemble(bonds, *influence(bonds, alpha, D)).operator(lam, MU)
    unknown = np.repeat(body.interior, 2)
    given = np.where(outside[:, None], 0.0, exact).ravel()
    u = spsolve(sp.csc_array(L[:, unknown]), -L[:, ~unknown] @ given[~unknown])
    return float(np.abs(u - exact.ravel()[unknown]).max())


def free_surfaces() -> Entry:
    """A free edge with and without the corrected dilatation (41)."""
    spacings = 1 / np.array([8, 16, 32, 64])
    table: dict[str, list[float]] = {}
    for name, ratio in ((SOFT, -0.27), (HARD, 3.0)):
        for kind, corrected in (("corrected", True), ("not corrected", False)):
            label = f"{name}, {kind}"
            table[label] = [
                free_edge(round(1 / h), ratio * MU, corrected=corrected)
                for h in tqdm(spacings, desc=label)
            ]
    orders = {label: _order(spacings, errors) for label, errors in table.items()}
    numbers = {}
    for name, key in ((SOFT, "soft"), (HARD, "hard")):
        kinds = f"{name}, corrected", f"{name}, not corrected"
        numbers[f"{key}_order"], numbers[f"{key}_plain_order"] = (orders[kind] for kind in kinds)
        numbers[f"{key}_times"] = table[kinds[1]][-1] / table[kinds[0]][-1]
    points = square_lattice(6, 3.0, 1.0)
    body = points.x[:, 0] <= 5
    cut = Points(points.x[body], points.interior[body], 1.0)
    figure, ax = panels(7.4, 4.2)
    rows = {f"{label}: order {orders[label]:.2f}": errors for label, errors in table.items()}
    axes = {"xlabel": "spacing (side 1), δ = 3h", "ylabel": "largest error of displacement"}
    curves(ax, "loglog", spacings, rows, "C0o-", "C0s--", "C1o-", "C1s--", **axes)
    ticks(ax, spacings, [f"1/{1 / h:g}" for h in spacings])
    values = {"numbers": np.round(1 / spacings).astype(int), "error": table, "order": orders}
    return entry("surfaces", numbers, (lambda: families_of(cut, 3.0),), figure, values)
