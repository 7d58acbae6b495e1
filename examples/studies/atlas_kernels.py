"""Stability atlas: kernels that fail on their lattice, or away from it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import warp_peri
from examples.studies.atlas_conditions import displacement_error
from examples.studies.atlas_entry import Entry, words, written
from warp_peri import Dataset, Model
from warp_peri.lps.model import bernstein_basis
from warp_peri.methods import Conditions
from warp_peri.points.families import bond_classes
from warp_peri.points.quadrature import RESIDUAL, family_weights
from warp_peri.regression.conditions import LatticeConditions, ZoneSearch

LAM, MU = -0.1972, 0.7223
"""Of the potential that the data come from [TPa]."""


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
                sets, warp_peri.LPS(horizon=horizon, kernel=warp_peri.Bernstein(12), normalise=True)
            ).material
            first = first or model
            label = f"δ = {horizon:g} Å, trained on {name}"
            table[label] = []
            for h, points in zip(tqdm(spacings, desc=label), disks):
                fits = horizon / h >= 2
                table[label].append(displacement_error(model, points) if fits else np.nan)
    assert first is not None
    model = first
    single, two = (table[f"δ = 20 Å, trained on {name}"] for name in ("5 Å", "5 and 2.5 Å"))
    short = table["δ = 12.5 Å, trained on 5 and 2.5 Å"]
    return Entry(
        *written(
            "spacing",
            one_fine=100 * single[0],
            one_own=100 * single[3],
            both_fine=100 * two[0],
            both_own=100 * two[3],
            both_third=100 * two[1],
            both_four=100 * two[2],
            short_third=100 * short[1],
            short_four=100 * short[2],
        ),
        [
            words(lambda: warp_peri.evaluate(model, disks[0])),
            words(
                lambda: (
                    warp_peri.solve(
                        model,
                        warp_peri.Dirichlet(disks[0], disks[0].loads, disks[0].u),
                        allow_uncertified=True,
                    ).u
                )
            ),
        ],
        draw_spacings(spacings, table),
        {"spacings": spacings, "E_u": table},
    )


def draw_spacings(spacings: Sequence[float], table: Mapping[str, Sequence[float]]) -> Figure:
    """Errors on the disks by the spacing of their nodes, for each training."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for number, (label, values) in enumerate(table.items()):
        style = "o--" if number % 2 == 0 else "s-"
        ratio = np.array(spacings) / 5.0
        ax.semilogy(ratio, 100 * np.array(values), style, color=f"C{number // 2}", label=label)
    ax.set_xlabel("spacing of the nodes / 5 Å")
    ax.set_ylabel("E_u on held-out disks [%]")
    ax.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


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
    table = {ratio: np.array([plain_symbol(a, ratio) for a in alphas]) for ratio in (2.0, 3.0, 5.0)}
    shear, symbol, share = (
        dict(zip((1.0, 2.9, 2.999, 6.0, 10.0), column))
        for column in zip(*(plain_symbol(alpha, 3.0) for alpha in (1.0, 2.9, 2.999, 6.0, 10.0)))
    )
    return Entry(
        *written(
            "exponent",
            shear_29=shear[2.9],
            shear_2999=shear[2.999],
            shear_6=shear[6.0],
            shear_10=shear[10.0],
            symbol_2999=symbol[2.999],
            share_1=share[1.0],
            share_2999=share[2.999],
            share_10=share[10.0],
        ),
        [words(lambda: Model(LAM, MU, 3.0, np.ones(1), 3.0))],
        draw_exponents(alphas, table),
        {"alpha": alphas, "by ratio": {str(ratio): values for ratio, values in table.items()}},
    )


def draw_exponents(alphas: np.ndarray, table: Mapping[float, np.ndarray]) -> Figure:
    """Shear modulus and smallest symbol by exponent, for each δ/h."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for ratio, values in table.items():
        for ax, column in zip(axes, (0, 1)):
            ax.plot(alphas, values[:, column], label=f"δ/h = {ratio:g}")
    for ax, name in zip(axes, ("C44/μ of the discrete operator", "smallest D(k)/s(k) / μ")):
        ax.axvspan(3, 10, color="0.9")
        ax.axhline(0, color="0.6", linewidth=0.8)
        ax.set_xlabel("exponent α of K = r^(−α) (grey: refused)")
        ax.set_ylabel(name)
    axes[0].legend(frameon=False)
    return figure


def short_horizons() -> Entry:
    """δ/h towards 1: when quadrature weights cease to exist."""
    ratios = np.linspace(1.0, 5.0, 161)
    residuals = [weight_residual(ratio) for ratio in ratios]
    kept = ratios[np.array(residuals) <= RESIDUAL]
    symbols = [plain_symbol(1.0, ratio)[1] for ratio in kept]
    weights = [bond_classes(1.0, ratio).weight for ratio in kept]
    lowest = np.array([float((weight / weight.max()).min()) for weight in weights])
    negative = kept[lowest < 0]
    return Entry(
        *written(
            "horizon",
            accepted=max(residual for residual in residuals if residual <= RESIDUAL),
            functions=2 + 1 + 3 + 4 + 5 + 6 - 3,
            residual_19=residuals[int(np.argmin(np.abs(ratios - 1.9)))],
            residual_2=residuals[int(np.argmin(np.abs(ratios - 2.0)))],
            smallest=min(symbols),
            smallest_ratio=kept[int(np.argmin(symbols))],
            negative=f"{negative.min():.2f} to {negative.max():.2f}" if len(negative) else "none",
        ),
        [
            words(lambda: bond_classes(5.0, 9.9)),
            words(lambda: bond_classes(5.0, 4.0)),
        ],
        draw_horizons(ratios, residuals, kept, symbols, lowest),
        {"ratio": ratios, "residual": residuals, "kept": kept, "symbol_min": symbols},
    )


def weight_residual(ratio: float) -> float:
    """Relative residual of the best quadrature weights of a lattice family with δ = ratio · h."""
    reach = int(ratio * (1 + 1e-6))
    steps = np.argwhere(np.ones(2 * [2 * reach + 1])) - reach
    length = np.hypot(*steps.T)
    xi = steps[(length > 0) & (length <= ratio * (1 + 1e-6))].astype(float)
    return max(float(family_weights(xi[None], ratio)[1][0]), 1e-17)


def draw_horizons(
    ratios: np.ndarray,
    residuals: Sequence[float],
    kept: np.ndarray,
    symbols: Sequence[float],
    lowest: np.ndarray,
) -> Figure:
    """Residual of the weights, and where they exist the symbol and the smallest of them."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    axes[0].semilogy(ratios, residuals, ".-")
    axes[0].axhline(RESIDUAL, color="C3", linewidth=0.8, label="accepted")
    axes[0].set_ylabel("relative residual of the quadrature's conditions")
    axes[0].legend(frameon=False)
    axes[1].plot(kept, symbols, ".", label="smallest D(k)/s(k) / μ, K = 1/r")
    axes[1].plot(kept, lowest, ".", label="smallest weight / largest")
    axes[1].axhline(0, color="0.6", linewidth=0.8)
    axes[1].legend(frameon=False)
    for ax in axes:
        ax.set_xlabel("δ/h")
    return figure


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
        fit = warp_peri.fit(
            train, warp_peri.LPS(horizon=horizon, kernel=warp_peri.Bernstein(degree))
        )
        errors.append(fit.history[-1].E_res_train)
        at_bonds = np.abs(fit.material.influence(classes.r)).max()
        swings.append(float(np.abs(fit.material.influence(r)).max() / at_bonds))
    worst, widest = int(np.argmax(condition)), int(np.argmax(swings))
    return Entry(
        *written(
            "degree",
            worst=condition[worst],
            worst_degree=degrees[worst],
            condition_8=condition[degrees.index(8)],
            error_10=100 * errors[tried.index(10)],
            error_100=100 * errors[tried.index(100)],
            swing=swings[widest],
            swing_degree=tried[widest],
            swing_100=swings[tried.index(100)],
        ),
        [words(lambda: bernstein_basis(classes.r, horizon, 1030))],
        draw_degrees((degrees, condition), (tried, errors, swings)),
        {
            "degrees": degrees,
            "condition": condition,
            "tried": tried,
            "E_res": errors,
            "swing": swings,
        },
    )


def draw_degrees(basis: tuple[Any, Any], fits: tuple[Any, Any, Any]) -> Figure:
    """Degrees and condition of the basis; degrees, errors and swings of fits."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    degrees, condition = basis
    axes[0].loglog(np.maximum(degrees, 0.5), condition, "o-")
    axes[0].set_ylabel("condition of B_k,M(r_c/δ), 9 bond lengths, δ = 4h")
    tried, errors, swings = fits
    axes[1].plot(np.maximum(tried, 0.5), 100 * np.array(errors), "o-", label="E_res, training [%]")
    axes[1].plot(np.maximum(tried, 0.5), swings, "s-", label="max |K| between bonds / at bonds")
    axes[1].set_xscale("log")
    axes[1].set_yscale("log")
    axes[1].legend(frameon=False)
    for ax in axes:
        ax.set_xlabel("degree M")
    return figure
