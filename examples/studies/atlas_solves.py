"""Stability atlas: solves that fail through constants, points, surfaces or precision."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import spsolve
from tqdm import tqdm

import warp_peri
from examples.studies.atlas_entry import Entry, square_lattice, words
from examples.studies.atlas_kernels import unconstrained
from warp_peri.launch import ints
from warp_peri.losses.full import sample_weights
from warp_peri.losses.reduced import reduce
from warp_peri.models.lps import Model
from warp_peri.models.solid import Solid
from warp_peri.operator.bonds import Bonds
from warp_peri.operator.launches import influence
from warp_peri.operator.lps import lps_force
from warp_peri.operator.matrices import assemble, matrices
from warp_peri.operator.symbol import stiffnesses
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import bond_classes, families_of
from warp_peri.points.points import Points
from warp_peri.stability.conditions import Conditions, LatticeConditions, ZoneSearch

MU = 0.7223


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
    found = quiet_solve(model, points, elastic_load(points.x, lam, MU), u)
    inside = points.interior
    return float(np.linalg.norm((found - u)[inside]) / np.linalg.norm(u[inside]))


def quiet_solve(model: Model, points: Points, b: np.ndarray, u: np.ndarray) -> np.ndarray:
    """solve, certified or not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return warp_peri.solve(model, points, b, u, allow_uncertified=True)


def lame_parameters(data: Dataset) -> Entry:
    """λ + μ → 0, λ < μ and λ/μ → 10⁶, for kernels with and without conditions."""
    train = data["train"]
    horizon = 20.0
    weight = sample_weights([train], normalise=False)[0]
    free, _, _ = unconstrained(reduce(train, horizon, weight), 10)
    kernels = {"1/r": (1.0, np.ones(1)), "no conditions": (free.alpha, free.D)}
    for kind in ("direct", "paper"):
        model = warp_peri.fit(
            train,
            horizon=horizon,
            kernel=warp_peri.Bernstein(10),
            conditions=warp_peri.Conditions(kind),
        ).model
        kernels[f"conditions '{kind}'"] = (model.alpha, model.D)
    bulk = np.concatenate([np.logspace(-6, 0, 13), np.logspace(0.5, 6, 12)])  # (λ + μ)/μ
    small = square_lattice(12, horizon, train.spacing)
    classes = bond_classes(train.spacing, horizon)
    search = ZoneSearch(LatticeConditions(classes, Conditions("direct", 1.0)))
    symbols: dict[str, list[float]] = {}
    conditions: dict[str, list[float]] = {}
    for name, (alpha, D) in kernels.items():
        symbols[name], conditions[name] = [], []
        for value in tqdm(bulk, desc=name):
            model = Model((value - 1) * MU, MU, alpha, D, horizon)
            worst = search.worst(*stiffnesses(model, classes))[0][0] + 1.0
            symbols[name].append(float(worst) / MU)
            unknown = np.repeat(small.interior, 2)
            L = matrices(model, small).operator(model.lam, model.mu)[:, unknown].toarray()
            conditions[name].append(float(np.linalg.cond(L)))
    ratios = (1.0, 1e2, 1e4, 1e6)
    spacings = np.pi / np.array([8, 16, 32])
    orders, errors = [], []
    for ratio in ratios:
        row = [
            elastic_error(square_lattice(round(np.pi / h), 3 * h, h), ratio * MU, 3 * h)
            for h in spacings
        ]
        errors.append(row)
        orders.append(float(np.polyfit(np.log(spacings), np.log(row), 1)[0]))
    figure, axes = plt.subplots(1, 3, figsize=(14, 4), layout="constrained")
    for number, name in enumerate(kernels):
        axes[0].plot(bulk, symbols[name], "o-", color=f"C{number}", label=name, markersize=3)
        axes[1].loglog(bulk, conditions[name], "o-", color=f"C{number}", markersize=3)
    axes[0].set_xscale("log")
    axes[0].set_yscale("symlog", linthresh=1e-6)
    axes[0].axhline(0, color="0.6", linewidth=0.8)
    axes[0].set_ylabel("smallest D(k)/s(k) / μ")
    axes[0].legend(frameon=False, fontsize="small")
    axes[1].set_ylabel("condition of L, 12 × 12 nodes, δ = 4h")
    for ax in axes[:2]:
        ax.set_xlabel("(λ + μ)/μ")
    for ratio, row, order in zip(ratios, errors, orders):
        axes[2].loglog(spacings, row, "o-", label=f"λ/μ = {ratio:g}, order {order:.2f}")
    axes[2].set_xlabel("h (side π), δ = 3h, K = 1/r")
    axes[2].set_ylabel("relative error against elasticity")
    axes[2].legend(frameon=False, fontsize="small")
    least = {name: values[0] for name, values in symbols.items()}
    text = f"""λ < μ is no danger by itself; the true graphene has λ = −0.27 μ. Nor is λ + μ → 0 for the continuum under
Dirichlet data, whose longitudinal stiffness λ + 2μ stays at μ. For a kernel it may be: at (λ + μ)/μ = 10⁻⁶ the
smallest $D/s$ over μ is {least["1/r"]:.2g} for K = 1/r, {least["conditions 'paper'"]:.1e} for the kernel fitted under (24), whose
condition (iii) is active at its optimum, {least["conditions 'direct'"]:.2g} under (23) and {least["no conditions"]:.2g} without conditions. Condition (iii) of (24) is what carries a kernel to *any*
λ > −μ; (23) speaks of the fitted λ only, so certify again after changing it. Upwards nothing turns negative, but the
condition number of $L$ grows with λ: from {min(conditions["1/r"]):.0f} to {conditions["1/r"][-1]:.1e} at λ/μ = 10⁶
(K = 1/r; {conditions["conditions 'direct'"][-1]:.1e} under (23)). There is no locking on lattices: the order of the error against
elasticity is {orders[0]:.2f} at λ/μ = 1 and {orders[-1]:.2f} at 10⁶. On scattered points it is lost at 10⁴ ([theory](theory.md), last
section but one)."""
    alpha, D = kernels["conditions 'direct'"]
    soft = Model(-MU * (1 - 1e-6), MU, alpha, D, horizon)
    return Entry(
        "λ + μ → 0 and λ/μ → 10⁶",
        f"condition {conditions['1/r'][-1]:.0e} at λ/μ = 10⁶, order of convergence still {orders[-1]:.2f}",
        text,
        [
            words(lambda: Model(-MU, MU, 1.0, np.ones(1), horizon)),
            f"certificate: {warp_peri.certify(soft, spacing=train.spacing).statement}",
        ],
        figure,
        {"bulk": bulk, "symbol_min": symbols, "condition": conditions, "orders": orders},
    )


def perturbed(number: int, horizon: float, perturbation: float, seed: int) -> Points:
    """number × number nodes shifted by up to `perturbation` spacings, and their collar."""
    pad = int(np.ceil(2 * horizon + 2 * perturbation + 1))
    steps = np.argwhere(np.ones(2 * [number + 2 * pad])) - pad
    shift = np.random.default_rng(seed).uniform(-perturbation, perturbation, steps.shape)
    inside = np.all((steps >= 0) & (steps < number), axis=1)
    return Points(steps + shift, inside, 0.0)


def scaled(points: Points, h: float) -> Points:
    """The same nodes, h times as far apart."""
    return replace(points, x=h * points.x)


def scattered_points() -> Entry:
    """Irregularity, clusters and holes: weights, eigenvalues and errors."""
    horizon, number, seeds = 3.0, 12, range(4)
    shifts = np.linspace(0, 0.5, 11)
    figures = np.full((len(shifts), len(seeds), 4), np.nan)
    lam, h = 0.3 * MU, np.pi / number
    model = Model(lam, MU, 1.0, np.ones(1), horizon)
    for row, shift in enumerate(tqdm(shifts, desc="scattered points")):
        for seed in seeds:
            points = perturbed(number, horizon, shift, seed)
            found = warp_peri.solvability(model, points)
            error = elastic_error(scaled(points, h), lam, horizon * h)
            figures[row, seed] = (
                found.symmetric_min, found.asymmetry, found.negative_weights, error,
            )  # fmt: skip
    cases = {}
    base = perturbed(number, horizon, 0.2, 0)
    middle = base.x[base.interior].mean(axis=0)
    away = np.linalg.norm(base.x - middle, axis=1)
    for radius in (0.8, 1.6, 2.4):
        kept = away > radius
        cases[f"hole of radius {radius:g} h"] = replace(
            base, x=base.x[kept], interior=base.interior[kept]
        )
    near = np.argsort(away)[:8]
    for gap in (0.3, 0.1, 0.03, 0.01):
        x = base.x.copy()
        x[near] = middle + gap * np.random.default_rng(1).normal(size=(8, 2))
        cases[f"8 nodes within {gap:g} h"] = replace(base, x=x)
    rows: dict[str, list[Any]] = {}
    for name, points in cases.items():
        try:
            found = warp_peri.solvability(model, points)
            error = elastic_error(scaled(points, h), lam, horizon * h)
            rows[name] = [found.symmetric_min, found.negative_weights, error]
        except warp_peri.InputError as refused:
            rows[name] = [str(refused)]
    mean, low, high = figures.mean(axis=1), figures.min(axis=1), figures.max(axis=1)
    figure, axes = plt.subplots(1, 4, figsize=(16, 3.8), layout="constrained")
    names = (
        "smallest eigenvalue of (L + Lᵗ)/2 [TPa/h²]",
        "asymmetry ‖L − Lᵗ‖/‖L + Lᵗ‖",
        "share of negative weights",
        "relative error against elasticity",
    )
    for ax, name, column in zip(axes, names, range(4)):
        ax.plot(shifts, mean[:, column], "o-", markersize=3)
        ax.fill_between(shifts, low[:, column], high[:, column], alpha=0.25)
        ax.set_xlabel("perturbation [h]")
        ax.set_ylabel(name)
    axes[0].axhline(0, color="0.6", linewidth=0.8)
    solved = {name: row for name, row in rows.items() if len(row) == 3}
    table = "\n".join(
        f"| {name} | " + (f"{row[0]:.3g} | {row[1]:.1%} | {row[2]:.2%} |" if len(row) == 3
                           else f"refused: {row[0][:60]}… | | |")
        for name, row in rows.items()
    )  # fmt: skip
    turn = "it stays positive"
    if low[:, 0].min() < 0:
        turn = f"below zero for some seed from {shifts[int(np.argmax(low[:, 0] < 0))]:.2f} h on"
    text = f"""With nodes shifted by up to 0.5 spacings (δ = 3h, K = 1/r, λ = 0.3 μ, {len(seeds)} seeds, {number} × {number} unknown nodes) the
smallest eigenvalue of the symmetric part falls from {mean[0, 0]:.3g} to {low[-1, 0]:.3g} TPa/h²
({turn}), the asymmetry rises to {high[-1, 1]:.2f}, the share of
negative weights to {high[-1, 2]:.1%} (first seen at {shifts[int(np.argmax(high[:, 2] > 0))]:.2f} h), the error from {mean[0, 3]:.2%} to
{high[-1, 3]:.2%} (so coarse a grid errs by that much anyway). Holes and clusters, at 0.2 h:

| | smallest eigenvalue | negative weights | error |
|---|---|---|---|
{table}

No certificate speaks for scattered points; `solvability` gives these figures for the nodes at hand."""
    twice = base.x.copy()
    twice[near[1]] = twice[near[0]]
    return Entry(
        "Scattered points",
        f"smallest eigenvalue {mean[0, 0]:.3g} → {low[-1, 0]:.3g} TPa/h², negative weights 0 → "
        f"{high[-1, 2]:.0%} from 0 to 0.5 h",
        text,
        [
            words(lambda: warp_peri.LPSOperator(model, base)),
            words(lambda: families_of(replace(base, x=twice), horizon)),
            words(lambda: families_of(perturbed(6, 2.0, 0.5, 0), 2.0)),
        ],
        figure,
        {"shifts": shifts, "figures": figures, "cases": rows, "solved": len(solved)},
    )


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
    one = torch.ones(1, dtype=torch.float64)
    alpha, D = (bonds.floats(one.numpy()) for _ in range(2))
    tables = 2 * influence(bonds, alpha, D)
    L = assemble(bonds, tables).operator(lam, MU)
    unknown = np.repeat(body.interior, 2)
    given = np.where(outside[:, None], 0.0, exact).ravel()
    found = spsolve(sp.csc_array(L[:, unknown]), -L[:, ~unknown] @ given[~unknown])
    return float(np.abs(found - exact.ravel()[unknown]).max())


def free_surfaces() -> Entry:
    """A free edge with and without the corrected dilatation (41)."""
    numbers = np.array([8, 16, 32, 64])
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    table: dict[str, list[float]] = {}
    orders: dict[str, float] = {}
    for number, ratio in enumerate((-0.27, 3.0)):
        for corrected in (True, False):
            name = f"λ/μ = {ratio:g}, {'corrected' if corrected else 'not corrected'}"
            table[name] = [
                free_edge(n, ratio * MU, corrected=corrected) for n in tqdm(numbers, desc=name)
            ]
            orders[name] = float(np.polyfit(np.log(1 / numbers), np.log(table[name]), 1)[0])
            style = "o-" if corrected else "s--"
            label = f"{name}, order {orders[name]:.2f}"
            ax.loglog(1 / numbers, table[name], style, color=f"C{number}", label=label)
    ax.set_xlabel("h (side 1), δ = 3h")
    ax.set_ylabel("largest error of u")
    ax.legend(frameon=False)
    fine = {name: values[-1] for name, values in table.items()}
    soft, hard = ("λ/μ = -0.27", "λ/μ = 3")
    text = f"""On a square with one free edge an affine field without traction is exact in elasticity. With the
dilatation renormalised over the unbroken bonds (40–41) the error falls with δ: orders
{orders[soft + ", corrected"]:.2f} and {orders[hard + ", corrected"]:.2f} at λ/μ = −0.27 and 3. Left as it is, with its bonds broken, the orders are
{orders[soft + ", not corrected"]:.2f} and {orders[hard + ", not corrected"]:.2f}, and at 64 nodes a side the errors are
{fine[soft + ", not corrected"] / fine[soft + ", corrected"]:.1f} and {fine[hard + ", not corrected"] / fine[hard + ", corrected"]:.1f} times those of the corrected one.
The library corrects wherever `outside` is given, and refuses a body that simply ends. (23) says nothing about
free surfaces."""
    points = square_lattice(6, 3.0, 1.0)
    body = points.x[:, 0] <= 5
    cut = Points(points.x[body], points.interior[body], 1.0)
    return Entry(
        "Free surfaces with and without the correction",
        f"order {orders[hard + ', corrected']:.2f} with and {orders[hard + ', not corrected']:.2f} without; errors "
        f"{fine[hard + ', not corrected'] / fine[hard + ', corrected']:.1f} (λ/μ = 3) and "
        f"{fine[soft + ', not corrected'] / fine[soft + ', corrected']:.1f} times (−0.27) larger without",
        text,
        [words(lambda: families_of(cut, 3.0))],
        figure,
        {"numbers": numbers, "error": table, "order": orders},
    )


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
            found = force(u + shift)
            errors[precision].append(float(np.linalg.norm(found - exact) / np.linalg.norm(exact)))
        rough[precision] = float(np.linalg.norm(force(u) - exact) / np.linalg.norm(exact))
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for precision, values in errors.items():
        ax.loglog(shifts, np.maximum(values, 1e-17), "o-", label=precision)
    ax.axhline(1, color="0.6", linewidth=0.8)
    ax.set_xlabel("rigid shift [Å] under displacements of 10⁻³ Å")
    ax.set_ylabel("relative error of L u")
    ax.legend(frameon=False)
    lost = shifts[int(np.argmax(np.array(errors["float32"]) > 0.01))]
    text = f"""The force is a sum of differences of $u$. In float32 they keep 7 digits of the *largest* displacement,
not of the difference: smooth displacements of 10⁻³ Å give forces with a relative error of
{rough["float32"]:.0e} (float64: {rough["float64"]:.0e}), with a rigid shift of {lost:.2g} Å the error passes 1 %. A solve cannot
do better than that residual. The public operator, the fits, the certificate and the solves are float64
throughout; float32 sweeps exist inside the library for charts of speed and gain 5 to 50 % only."""
    model = Model(-0.2, MU, 1.0, np.ones(1), horizon, certified_on=(1.0,))
    operator = warp_peri.LPSOperator(model, points)
    return Entry(
        "float32 where it is not enough",
        f"forces {rough['float32']:.0e} off without, 1 % off with a rigid shift of {lost:.2g} Å "
        "under displacements of 10⁻³ Å",
        text,
        [words(lambda: operator(torch.from_numpy(u).float()))],
        figure,
        {"shift": shifts, "error": errors, "unshifted": rough},
    )
