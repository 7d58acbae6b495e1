"""What the page on the slides of Trask shows: see papers.py."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from math import factorial, pi
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, Voronoi

import warp_peri
from examples.graphene_report import save_figure
from examples.prose import rows_of
from examples.studies.manufactured import HORIZON, LAM, QUADRATURE_DEGREES, continuum_symbol
from examples.studies.manufactured import MU as MANUFACTURED_MU
from warp_peri.operator.matrices import Matrices, matrices
from warp_peri.points.points import Points
from warp_peri.points.quadrature import ball_integral
from warp_peri.statics.direct import MatrixProblem
from warp_peri.statics.staggered import derivatives, staggered, tensors

NEEDED: dict[str, str] = {}
TEMPLATE = Path(__file__).with_suffix(".md")
EXPONENTS = (1.0, 2.0, 2.5, 3.0, 3.5)
SLOPE = np.array([0.7, -0.4, 0.5])
"""u = exp(a·x) of the pointwise rates."""
RADII = 0.3 * 0.75 ** np.arange(5)
"""Horizons of the pointwise rates; the nodes shrink with them."""
MU, LENGTH = 0.8, 2.0
STIFFER, CELLS, SEEDS = (3.0, 1e2, 1e4, 1e6), (8, 16, 32), range(5)
"""λ/μ, nodes a side, and draws of the nodes of the nearly incompressible solid."""


def values(runs: Path, kept: Callable[..., Any], figures: Path) -> dict[str, str]:
    """The parts of the page, by the names that its template gives them."""
    del runs
    rates = kept("rates", lambda: [pointwise(d, a, n) for d, a, n in asked()])
    nonlocal_limit = kept("nonlocal_limit", fixed_horizon)
    local = kept("local_limit", lambda: [fixed_ratio(lam) for lam in (MU, 3 * MU)])
    draw(figures / "slides_rates.png", rates)
    return {
        "rates": rows_of(map(rate_row, rates)),
        "nonlocal_limit": rows_of(nonlocal_limit["rows"]),
        "local_limit": rows_of(row["cells"] for row in local),
        "incompressible": rows_of(map(incompressible_row, kept("incompressible", incompressible))),
    }


def asked() -> list[tuple[int, float, int]]:
    """Dimension, exponent and degree of each rate."""
    return [(d, a, n) for d in (2, 3) for a in EXPONENTS for n in (2, 3, 4)]


def weights(xi: np.ndarray, exponent: float, degree: int) -> np.ndarray:
    """Least weights exact on f and on f/r^α for all polynomials f ≤ degree, shape [B].

    δ = 1. A term whose integral does not converge is asked for only where symmetry makes it zero.
    """
    d = xi.shape[1]
    r = np.linalg.norm(xi, axis=1)
    rows, exact = [], []
    for powers in product(range(degree + 1), repeat=d):
        if (n := sum(powers)) > degree:
            continue
        monomial = np.prod(xi ** np.array(powers), axis=1)
        odd = any(p % 2 for p in powers)
        for a in (0.0, exponent):
            if odd or n - a + d > 0:
                rows.append(monomial / r**a)
                exact.append(ball_integral(powers, a))
    W, *_ = np.linalg.lstsq(np.array(rows), np.array(exact), rcond=1e-12)
    return np.asarray(W)


def pointwise(d: int, exponent: float, degree: int) -> dict[str, Any]:
    """Errors of ∫ r^−α (u(x + ξ) − u(x)) dξ on perturbed nodes, and the fitted rate.

    The integral of u = exp(a·x) at 0 is the sum over k of |a|^2k/(2k)! ∫ ξ₁^2k r^−α.
    """
    rng = np.random.default_rng(d)
    reach = 4 if d == 2 else 3
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * d), axis=-1).reshape(-1, d)
    nodes = steps[np.any(steps != 0, axis=1)] + rng.uniform(
        -0.2, 0.2, ((2 * reach + 1) ** d - 1, d)
    )
    xi = nodes / reach
    xi = xi[np.linalg.norm(xi, axis=1) <= 1]
    W = weights(xi, exponent, degree)
    a = SLOPE[:d]
    errors = []
    for radius in RADII:
        exact = sum(
            np.dot(a, a) ** k
            / factorial(2 * k)
            * ball_integral([2 * k, *[0] * (d - 1)], exponent)
            * radius ** (2 * k - exponent + d)
            for k in range(1, 12)
        )
        y = radius * xi
        found = radius**d * W @ (np.expm1(y @ a) / np.linalg.norm(y, axis=1) ** exponent)
        errors.append(abs(found - exact))
    rate = np.polyfit(np.log(RADII), np.log(errors), 1)[0]
    return {
        "dimension": d, "exponent": exponent, "degree": degree, "errors": errors, "rate": rate,
        "claimed": degree - exponent + d + 1, "bonds": len(xi),
    }  # fmt: skip


def rate_row(found: dict[str, Any]) -> list[str]:
    """One row of the rates."""
    keys = ("dimension", "exponent", "degree", "bonds")
    return [*(f"{found[key]:g}" for key in keys), f"{found['claimed']:.1f}", f"{found['rate']:.2f}"]


def lattice(cells: int, horizon: float, length: float) -> Points:
    """A square of nodes at the centres of cells, with the collar that the horizon needs."""
    h = length / cells
    pad = int(np.ceil(2 * horizon / h + 1e-9))
    steps = np.argwhere(np.ones((cells + 2 * pad,) * 2)) - pad
    inside: np.ndarray = np.all((steps >= 0) & (steps < cells), axis=1)
    return Points(h * (steps + 0.5), inside, h)


def plain(lam: float, mu: float, horizon: float, spacing: float) -> warp_peri.Model:
    """The solid with K = 1/r, whose positive kernel needs no certificate."""
    return warp_peri.Model(lam, mu, 1.0, np.ones(1), horizon, certified_on=(spacing,))


def error_of(material: Any, points: Points, u: np.ndarray, b: np.ndarray) -> float:
    """Relative ℓ2 error of the solution inside, u given on the collar."""
    return float(warp_peri.evaluate(material, warp_peri.Samples(points, u[None], b[None]))["E_u"])


def fixed_horizon() -> dict[str, Any]:
    """u_h^δ → u^δ: the load is that of the integral, δ stays, nodes come closer."""
    wave = np.array([2 * pi / 50, 2 * pi / 100])
    D = continuum_symbol(wave)
    table = []
    quintic = dict.fromkeys(QUADRATURE_DEGREES, 5)
    for name, degrees in (("5", quintic), ("5, 11, 13", QUADRATURE_DEGREES)):
        errors = []
        for h, degree in degrees.items():
            points = lattice(round(50 / h), HORIZON, 50.0)
            u = np.stack([np.sin(points.x @ wave), np.cos(points.x @ wave)], axis=1)
            model = plain(LAM, MANUFACTURED_MU, HORIZON, h)
            law = model.on(points, quadrature_degree=degree)
            errors.append(error_of(law, points, u, u @ D))
        table.append([f"degree {name}", *(f"{e:.1e}" for e in errors)])
    return {"rows": table}


def fixed_ratio(lam: float) -> dict[str, Any]:
    """u_h^δ → u: δ = 3h, u = (sin x sin y, cos x cos y), which has no dilatation, b = 2μu."""
    errors, cells = [], (8, 16, 32, 64)
    for number in cells:
        horizon = 3 * LENGTH / number
        points = lattice(number, horizon, LENGTH)
        x, y = points.x.T
        u = np.stack([np.sin(x) * np.sin(y), np.cos(x) * np.cos(y)], axis=1)
        solid = plain(lam, MU, horizon, points.spacing)
        errors.append(error_of(solid, points, u, 2 * MU * u))
    order = float(-np.polyfit(np.log(cells), np.log(errors), 1)[0])
    name = "bond-based, λ = μ" if lam == MU else f"state-based, λ = {lam / MU:g}μ"
    return {"cells": [name, *(f"{e:.1e}" for e in errors), f"{order:.2f}"]}


def scattered(cells: int, seed: int) -> tuple[Points, float]:
    """Nodes shifted by up to 0.3 spacings along each axis, and a horizon of three spacings."""
    h = LENGTH / cells
    points = lattice(cells, 3.4 * h, LENGTH)
    shift = np.random.default_rng(seed).uniform(-0.3 * h, 0.3 * h, points.x.shape)
    return Points(points.x + shift, points.interior, 0.0), 3 * h


def curl_and_pressure(x: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """u = curl cos x cos 2y + (μ/λ) ∇(sin x sin 2y), whose pressure stays finite, and its load."""
    a, b = x.T
    slope = np.stack([np.cos(a) * np.sin(2 * b), 2 * np.sin(a) * np.cos(2 * b)], axis=1)
    curl = np.stack([-2 * np.cos(a) * np.sin(2 * b), np.sin(a) * np.cos(2 * b)], axis=1)
    u = curl + slope / ratio
    return u, 5 * MU * (u + (1 + 1 / ratio) * slope)


def forms(model: warp_peri.Model, points: Points) -> dict[str, Callable[[], MatrixProblem]]:
    """Ways to write the dilatational part; the deviatoric one is the same in all."""
    inside = points.interior

    def solid(change: Callable[[Matrices], Matrices]) -> MatrixProblem:
        parts = change(matrices(model, points))
        return MatrixProblem(parts.operator(model.lam, model.mu), inside)

    def adjoint(parts: Matrices) -> Matrices:
        """−Ψ is the adjoint of Φ in the areas of the nodes' cells."""
        area = cell_areas(points.x)
        rows = sp.diags_array(1 / np.repeat(area[inside], 2)) @ (
            sp.csr_array(parts.phi.T)[np.repeat(inside, 2)] @ sp.diags_array(area)
        )
        return Matrices(parts.gamma, parts.phi, sp.csr_array(-rows))

    def everywhere(parts: Matrices) -> Matrices:
        """Derivatives exact for cubics, the dilatation at every interior node."""
        x = points.x[inside]
        return Matrices(parts.gamma, *tensors(derivatives(x, points.x), derivatives(x, x)))

    return {
        "as written (9)": lambda: solid(lambda parts: parts),
        "force the adjoint of dilatation": lambda: solid(adjoint),
        "moving least squares, θ at all nodes": lambda: solid(everywhere),
        "the same, θ at half the nodes": lambda: staggered(model, points),
    }


def cell_areas(x: np.ndarray) -> np.ndarray:
    """Areas of the Voronoi cells; of the outermost, whose cells do not close, their median."""
    cells = Voronoi(x)
    areas = np.full(len(x), np.nan)
    for node, number in enumerate(cells.point_region):
        if (corners := cells.regions[number]) and -1 not in corners:
            areas[node] = ConvexHull(cells.vertices[corners]).volume
    return np.where(areas < 4 * np.nanmedian(areas), areas, np.nanmedian(areas))


def incompressible() -> list[dict[str, Any]]:
    """Least and largest relative ℓ2 error over the draws, by form, λ/μ and number of nodes."""
    found: dict[tuple[str, float], list[list[float]]] = {}
    for ratio, number in product(STIFFER, CELLS):
        errors: dict[str, list[float]] = {}
        for seed in SEEDS:
            points, horizon = scattered(number, seed)
            model = warp_peri.Model(ratio * MU, MU, 1.0, np.ones(1), horizon)
            u, b = curl_and_pressure(points.x, ratio)
            for name, problem in forms(model, points).items():
                solved = problem().solve(b[None], u[None])[0]
                error = np.linalg.norm(solved - u) / np.linalg.norm(u[points.interior])
                errors.setdefault(name, []).append(float(error))
        for name, several in errors.items():
            found.setdefault((name, ratio), []).append([min(several), max(several)])
    return [{"form": name, "ratio": ratio, "errors": e} for (name, ratio), e in found.items()]


def incompressible_row(found: dict[str, Any]) -> list[str]:
    """A form at one λ/μ, and the order of its largest errors."""
    order = -np.polyfit(np.log(CELLS), np.log([worst for _, worst in found["errors"]]), 1)[0]
    errors = (f"{least:.1e} to {worst:.1e}" for least, worst in found["errors"])
    return [found["form"], f"{found['ratio']:g}", *errors, f"{order:.1f}"]


def draw(path: Path, rates: Sequence[dict[str, Any]]) -> None:
    """Errors over the horizon, degree 4."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    for ax, d in zip(figure.subplots(1, 2), (2, 3)):
        for color, found in enumerate(
            one for one in rates if one["dimension"] == d and one["degree"] == 4
        ):
            label = f"α = {found['exponent']:g}: {found['rate']:.1f} ({found['claimed']:.1f})"
            ax.loglog(RADII, found["errors"], "o-", color=f"C{color}", label=label)
        ax.set(xlabel="horizon δ", ylabel="error of the integral", title=f"{d} dimensions")
        ax.legend(title="rate (claimed)", frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    save_figure(figure, path)
