"""Stability atlas: scattered points, holes, clusters and free surfaces."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import torch
from matplotlib.figure import Figure
from scipy.sparse.linalg import spsolve
from tqdm import tqdm

import warp_peri
from examples.prose import rows_of
from examples.studies.atlas_entry import Entry, square_lattice, words, written
from examples.studies.atlas_solves import MU, elastic_error
from warp_peri import Model, Points
from warp_peri.launch import ints
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.launches import influence
from warp_peri.lps.matrices import assemble
from warp_peri.points.families import families_of

HORIZON, NUMBER, SEEDS = 3.0, 12, range(4)
"""δ/h, unknown nodes a side, and seeds of the scattered points."""
LAM = 0.3 * MU
SOFT, HARD = "λ/μ = -0.27", "λ/μ = 3"


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
            [figures_of(perturbed(NUMBER, HORIZON, shift, seed)) for seed in SEEDS]
            for shift in tqdm(shifts, desc="scattered points")
        ]
    )
    base = perturbed(NUMBER, HORIZON, 0.2, 0)
    away = np.linalg.norm(base.x - base.x[base.interior].mean(axis=0), axis=1)
    near = np.argsort(away)[:8]
    twice = base.x.copy()
    twice[near[1]] = twice[near[0]]
    rows = {name: damaged(points) for name, points in holes_and_clusters(base, away, near).items()}
    mean, low, high = figures.mean(axis=1), figures.min(axis=1), figures.max(axis=1)
    turn = "it stays positive"
    if low[:, 0].min() < 0:
        turn = f"below zero for some seed from {shifts[int(np.argmax(low[:, 0] < 0))]:.2f} h on"
    model = solid()
    return Entry(
        *written(
            "scattered",
            seeds=len(SEEDS),
            number=NUMBER,
            eigenvalue=mean[0, 0],
            eigenvalue_half=low[-1, 0],
            turn=turn,
            asymmetry=high[-1, 1],
            negative=high[-1, 2],
            first_negative=shifts[int(np.argmax(high[:, 2] > 0))],
            error=mean[0, 3],
            error_half=high[-1, 3],
            rows=rows_of([name, *cells(row)] for name, row in rows.items()),
        ),
        [
            words(lambda: model.on(base)),
            words(lambda: families_of(replace(base, x=twice), HORIZON)),
            words(lambda: families_of(perturbed(6, 2.0, 0.5, 0), 2.0)),
        ],
        draw_scattered(shifts, mean, low, high),
        {
            "shifts": shifts,
            "figures": figures,
            "cases": rows,
            "solved": sum(len(row) == 3 for row in rows.values()),
        },
    )


def solid() -> Model:
    """K = 1/r and λ = 0.3 μ, lengths in spacings."""
    return Model(LAM, MU, 1.0, np.ones(1), HORIZON)


def figures_of(points: Points) -> tuple[float, float, float, float]:
    """Smallest eigenvalue, asymmetry, share of negative weights, and error against elasticity."""
    figures = warp_peri.proofs.solvability(solid(), points)
    h = np.pi / NUMBER
    error = elastic_error(replace(points, x=h * points.x), LAM, HORIZON * h)
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
    except warp_peri.InputError as refused:
        return [str(refused)]
    return [smallest, negative, error]


def cells(row: Sequence[float | str]) -> list[str]:
    """The row of `damaged` in a table."""
    if len(row) == 1:
        return [f"refused: {str(row[0])[:60]}…", "", ""]
    return [f"{row[0]:.3g}", f"{row[1]:.1%}", f"{row[2]:.2%}"]


def draw_scattered(
    shifts: np.ndarray, mean: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Figure:
    """What irregularity does: mean and range over the seeds."""
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
    return figure


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
    tables = 2 * influence(bonds, alpha, D)
    L = assemble(bonds, tables).operator(lam, MU)
    unknown = np.repeat(body.interior, 2)
    given = np.where(outside[:, None], 0.0, exact).ravel()
    u = spsolve(sp.csc_array(L[:, unknown]), -L[:, ~unknown] @ given[~unknown])
    return float(np.abs(u - exact.ravel()[unknown]).max())


def free_surfaces() -> Entry:
    """A free edge with and without the corrected dilatation (41)."""
    numbers = np.array([8, 16, 32, 64])
    table: dict[str, list[float]] = {}
    for name, ratio in ((SOFT, -0.27), (HARD, 3.0)):
        for kind, corrected in (("corrected", True), ("not corrected", False)):
            label = f"{name}, {kind}"
            table[label] = [
                free_edge(n, ratio * MU, corrected=corrected) for n in tqdm(numbers, desc=label)
            ]
    orders = {
        label: float(np.polyfit(np.log(1 / numbers), np.log(errors), 1)[0])
        for label, errors in table.items()
    }
    times = {
        name: table[f"{name}, not corrected"][-1] / table[f"{name}, corrected"][-1]
        for name in (SOFT, HARD)
    }
    points = square_lattice(6, 3.0, 1.0)
    body = points.x[:, 0] <= 5
    cut = Points(points.x[body], points.interior[body], 1.0)
    return Entry(
        *written(
            "surfaces",
            soft_order=orders[f"{SOFT}, corrected"],
            hard_order=orders[f"{HARD}, corrected"],
            soft_plain_order=orders[f"{SOFT}, not corrected"],
            hard_plain_order=orders[f"{HARD}, not corrected"],
            soft_times=times[SOFT],
            hard_times=times[HARD],
        ),
        [words(lambda: families_of(cut, 3.0))],
        draw_surfaces(numbers, table, orders),
        {"numbers": numbers, "error": table, "order": orders},
    )


def draw_surfaces(
    numbers: np.ndarray, table: Mapping[str, Sequence[float]], orders: Mapping[str, float]
) -> Figure:
    """Errors by spacing, with and without the correction."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for number, (label, errors) in enumerate(table.items()):
        style = "s--" if "not" in label else "o-"
        text = f"{label}, order {orders[label]:.2f}"
        ax.loglog(1 / numbers, errors, style, color=f"C{number // 2}", label=text)
    ax.set_xlabel("h (side 1), δ = 3h")
    ax.set_ylabel("largest error of u")
    ax.legend(frameon=False)
    return figure
