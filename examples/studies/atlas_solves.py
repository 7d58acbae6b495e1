"""Stability atlas: solves that fail through constants or precision."""

import warnings
from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.figure import Figure
from tqdm import tqdm

import warp_peri
from examples.studies.atlas_conditions import unconstrained
from examples.studies.atlas_entry import Entry, square_lattice, words, written
from warp_peri import Dataset, Model, Points, Samples
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.matrices import matrices
from warp_peri.lps.model import stiffnesses
from warp_peri.lps.operator import lps_force
from warp_peri.methods import Conditions, Solid
from warp_peri.points.families import bond_classes
from warp_peri.regression.conditions import LatticeConditions, ZoneSearch
from warp_peri.regression.losses import reduce, sample_weights

MU = 0.7223
HORIZON = 20.0
BULK = np.concatenate([np.logspace(-6, 0, 13), np.logspace(0.5, 6, 12)])
"""(λ + μ)/μ."""
RATIOS, SPACINGS = (1.0, 1e2, 1e4, 1e6), np.pi / np.array([8, 16, 32])
"""λ/μ and h of the errors against elasticity."""

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


def elastic_load(x: np.ndarray, lam: float, mu: float) -> np.ndarray:
    """−[μ∇²u + (λ+μ)∇(∇·u)] of it."""
    return 5 * mu * elastic_field(x, lam, mu) + 5 * (lam + mu) * mu / lam * _gradient_part(x)


def elastic_error(points: Points, lam: float, horizon: float) -> float:
    """Relative ℓ2 error of the solve with K = 1/r against linear elasticity."""
    model = Model(lam, MU, 1.0, np.ones(1), horizon)
    u = elastic_field(points.x, lam, MU)
    solved = quiet_solve(model, points, elastic_load(points.x, lam, MU), u)
    inside = points.interior
    return float(np.linalg.norm((solved - u)[inside]) / np.linalg.norm(u[inside]))


def quiet_solve(model: Model, points: Points, b: np.ndarray, u: np.ndarray) -> np.ndarray:
    """solve, certified or not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return warp_peri.solve(model, warp_peri.Dirichlet(points, b, u), allow_uncertified=True).u


def lame_parameters(data: Dataset) -> Entry:
    """λ + μ → 0, λ < μ and λ/μ → 10⁶, for kernels with and without conditions."""
    train = data["train"]
    kernels = kernels_by_conditions(train)
    symbols, conditions = by_bulk_modulus(kernels, train.spacing)
    errors = [
        [
            elastic_error(square_lattice(round(np.pi / h), 3 * h, h), ratio * MU, 3 * h)
            for h in SPACINGS
        ]
        for ratio in RATIOS
    ]
    orders = [float(np.polyfit(np.log(SPACINGS), np.log(row), 1)[0]) for row in errors]
    least = {name: values[0] for name, values in symbols.items()}
    alpha, D = kernels["conditions 'direct'"]
    soft = Model(-MU * (1 - 1e-6), MU, alpha, D, HORIZON)
    return Entry(
        *written(
            "lame",
            plain=least["1/r"],
            paper=least["conditions 'paper'"],
            direct=least["conditions 'direct'"],
            free=least["no conditions"],
            condition_soft=min(conditions["1/r"]),
            condition_hard=conditions["1/r"][-1],
            condition_direct=conditions["conditions 'direct'"][-1],
            order_soft=orders[0],
            order_hard=orders[-1],
        ),
        [
            words(lambda: Model(-MU, MU, 1.0, np.ones(1), HORIZON)),
            f"certificate: {warp_peri.certify(soft, spacing=train.spacing).statement}",
        ],
        draw_lame(symbols, conditions, errors, orders),
        {"bulk": BULK, "symbol_min": symbols, "condition": conditions, "orders": orders},
    )


def kernels_by_conditions(train: Samples) -> Kernels:
    """1/r, and what the data teach without conditions and with those of each kind."""
    weight = sample_weights([train], normalise=False)[0]
    free, _, _ = unconstrained(reduce(train, HORIZON, weight), 10)
    kernels = {"1/r": (1.0, np.ones(1)), "no conditions": (free.alpha, free.D)}
    for kind in ("direct", "paper"):
        model = warp_peri.fit(
            train,
            warp_peri.LPS(
                horizon=HORIZON,
                kernel=warp_peri.Bernstein(10),
                conditions=warp_peri.methods.Conditions(kind),
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
    search = ZoneSearch(LatticeConditions(classes, Conditions("direct", 1.0)))
    symbols: dict[str, list[float]] = {}
    conditions: dict[str, list[float]] = {}
    unknown = np.repeat(small.interior, 2)
    for name, (alpha, D) in kernels.items():
        symbols[name], conditions[name] = [], []
        for value in tqdm(BULK, desc=name):
            model = Model((value - 1) * MU, MU, alpha, D, HORIZON)
            worst = search.worst(*stiffnesses(model, classes))[0][0] + 1.0
            symbols[name].append(float(worst) / MU)
            L = matrices(model, small).operator(model.lam, model.mu)[:, unknown].toarray()
            conditions[name].append(float(np.linalg.cond(L)))
    return symbols, conditions


def draw_lame(
    symbols: Mapping[str, Sequence[float]],
    conditions: Mapping[str, Sequence[float]],
    errors: Sequence[Sequence[float]],
    orders: Sequence[float],
) -> Figure:
    """Symbol and condition by (λ + μ)/μ, and errors against elasticity by spacing."""
    figure, axes = plt.subplots(1, 3, figsize=(14, 4), layout="constrained")
    for number, name in enumerate(symbols):
        axes[0].plot(BULK, symbols[name], "o-", color=f"C{number}", label=name, markersize=3)
        axes[1].loglog(BULK, conditions[name], "o-", color=f"C{number}", markersize=3)
    axes[0].set_xscale("log")
    axes[0].set_yscale("symlog", linthresh=1e-6)
    axes[0].axhline(0, color="0.6", linewidth=0.8)
    axes[0].set_ylabel("smallest D(k)/s(k) / μ")
    axes[0].legend(frameon=False, fontsize="small")
    axes[1].set_ylabel("condition of L, 12 × 12 nodes, δ = 4h")
    for ax in axes[:2]:
        ax.set_xlabel("(λ + μ)/μ")
    for ratio, row, order in zip(RATIOS, errors, orders):
        axes[2].loglog(SPACINGS, row, "o-", label=f"λ/μ = {ratio:g}, order {order:.2f}")
    axes[2].set_xlabel("h (side π), δ = 3h, K = 1/r")
    axes[2].set_ylabel("relative error against elasticity")
    axes[2].legend(frameon=False, fontsize="small")
    return figure


def single_precision() -> Entry:
    """Forces of a field on top of a rigid shift, in float32 and float64."""
    horizon, points = 3.0, square_lattice(24, 3.0, 1.0)
    shifts = np.logspace(-2, 6, 17)
    strain = 1e-3
    u = strain * np.stack([np.sin(points.x[:, 0] / 3), np.cos(points.x[:, 1] / 4)], axis=1)
    solid = Solid(-0.2, MU, 1.0, [1.0])
    errors: dict[str, list[float]] = {}
    rough = {}
    for precision, dtype in (("float32", torch.float32), ("float64", torch.float64)):
        bonds = Bonds(points, horizon, precision=precision)

        def force(
            field: np.ndarray, bonds: Bonds = bonds, dtype: torch.dtype = dtype
        ) -> np.ndarray:
            return lps_force(bonds, torch.from_numpy(field).to(dtype), solid).double().numpy()

        errors[precision] = []
        exact = lps_force(Bonds(points, horizon), torch.from_numpy(u), solid).numpy()
        for shift in shifts:
            rounded = force(u + shift)
            errors[precision].append(float(np.linalg.norm(rounded - exact) / np.linalg.norm(exact)))
        rough[precision] = float(np.linalg.norm(force(u) - exact) / np.linalg.norm(exact))
    lost = shifts[int(np.argmax(np.array(errors["float32"]) > 0.01))]
    model = Model(-0.2, MU, 1.0, np.ones(1), horizon, certified_on=(1.0,))
    operator = model.on(points)
    return Entry(
        *written(
            "float32", rough_single=rough["float32"], rough_double=rough["float64"], lost=lost
        ),
        [words(lambda: operator(torch.from_numpy(u).float()))],
        draw_precisions(shifts, errors),
        {"shift": shifts, "error": errors, "unshifted": rough},
    )


def draw_precisions(shifts: np.ndarray, errors: Mapping[str, Sequence[float]]) -> Figure:
    """Errors of the force by the rigid shift, in both precisions."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for precision, values in errors.items():
        ax.loglog(shifts, np.maximum(values, 1e-17), "o-", label=precision)
    ax.axhline(1, color="0.6", linewidth=0.8)
    ax.set_xlabel("rigid shift [Å] under displacements of 10⁻³ Å")
    ax.set_ylabel("relative error of L u")
    ax.legend(frameon=False)
    return figure
