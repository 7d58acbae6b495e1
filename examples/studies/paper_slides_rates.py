"""Rates of the page on the slides: functionals, quadrature, both limits, edges (see papers.py)."""

from dataclasses import replace
from itertools import product
from math import factorial, pi
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

import warp_peri as wp
from examples.studies.manufactured import HORIZON, continuum_symbol
from examples.studies.manufactured import MU as MANUFACTURED_MU
from examples.studies.staggered import least_squares
from warp_peri import InputError, Points
from warp_peri.damage import continuum_stretch
from warp_peri.damage.operator import unit_toughness
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.matrices import assemble
from warp_peri.points.families import HORIZON_TOLERANCE, bond_classes
from warp_peri.points.quadrature import ball_integral
from warp_peri.statics.direct import MatrixProblem

EXPONENTS = (1.0, 2.0, 2.5, 3.0, 3.5)
SLOPE = np.array([0.7, -0.4, 0.5])
"""u = exp(a·x) of the pointwise rates."""
RADII = 0.3 * 0.75 ** np.arange(5)
"""Horizons of the pointwise rates; the nodes shrink with them."""
MU, LENGTH = 0.8, 2.0
CELLS = (8, 16, 32, 64)
"""Nodes a side, δ = 3h."""
PERIOD, PARTS = 50.0, (10, 12, 16, 20, 32, 40)
"""Side of the square at a fixed horizon [Å], and its nodes a side."""
FUNCTIONALS = {"u": 0, "∂₁u": 1, "∂₁∂₂u": 2}
"""By name, and how many derivatives they hold."""


def pattern(d: int) -> np.ndarray:
    """Perturbed nodes around the origin within a ball of radius 1, none at it, shape [B, d]."""
    rng, reach = np.random.default_rng(d), 4 if d == 2 else 3
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * d), axis=-1).reshape(-1, d)
    shift = rng.uniform(-0.2, 0.2, ((2 * reach + 1) ** d - 1, d))
    xi = (steps[np.any(steps != 0, axis=1)] + shift) / reach
    return np.asarray(xi[np.linalg.norm(xi, axis=1) <= 1])


def functional(d: int, name: str, degree: int) -> dict[str, Any]:
    """Errors of a functional of u at 0 by moving least squares, and the largest over its bound.

    Of u − p only the second sum is left: |τ(u − p)| = 0 for the Taylor polynomial p, and
    |τʰ(u − p)| ≤ Σ_j |w_j| max_j |u_j − p_j|.
    """
    order = tuple(int(axis < FUNCTIONALS[name]) for axis in range(d))
    a, xi = SLOPE[:d], pattern(d)
    read = 2 * sum(sum(p) <= degree for p in product(range(degree + 1), repeat=d))
    errors, shares = [], []
    for radius in RADII:
        x = radius * xi
        (weights,) = least_squares(np.zeros((1, d)), x, [order], degree=degree, neighbours=read)
        w = weights.toarray()[0]
        errors.append(abs(w @ np.exp(x @ a) - np.prod(a ** np.array(order))))
        rest = np.exp(x @ a) - sum((x @ a) ** k / factorial(k) for k in range(degree + 1))
        shares.append(errors[-1] / (np.abs(w).sum() * np.abs(rest[w != 0]).max()))
    rate = np.polyfit(np.log(RADII), np.log(errors), 1)[0]
    return {
        "dimension": d, "functional": name, "degree": degree, "read": read, "rate": rate,
        "claimed": degree + 1 - FUNCTIONALS[name], "share": max(shares), "errors": errors,
    }  # fmt: skip


def functional_row(found: dict[str, Any]) -> list[str]:
    """One row of the functionals."""
    keys = ("dimension", "functional", "degree", "read", "claimed")
    return [*(f"{found[key]}" for key in keys), f"{found['rate']:.2f}", f"{found['share']:.2f}"]


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
    xi = pattern(d)
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


def plain(lam: float, mu: float, horizon: float, spacing: float) -> wp.Model:
    """The solid with K = 1/r, whose positive kernel needs no certificate."""
    return wp.Model(lam, mu, 1.0, np.ones(1), horizon, certified_on=(spacing,))


def error_of(material: Any, points: Points, u: np.ndarray, b: np.ndarray) -> float:
    """Relative ℓ2 error of the solution inside, u given on the collar."""
    return float(wp.evaluate(material, wp.Samples(points, u[None], b[None]))["E_u"])


def free_edge(number: int, ratio: float, *, corrected: bool) -> float:
    """Largest error on a unit square whose right edge is free, under an affine field, no load."""
    horizon, lam = 3 / number, ratio * MU
    points = lattice(number, horizon, 1.0)
    outside = points.x[:, 0] > 1
    body = replace(points, interior=points.interior & ~outside, outside=outside)
    a, b = points.x.T
    stretch = 3 * lam / (lam + 2 * MU)  # no stress across the edge
    exact = np.stack([stretch * a + b, -a - 3 * b], axis=1)
    bonds = Bonds(body, horizon)
    if not corrected:
        families = bonds.families  # dilatation as at whole nodes, (6), its bonds broken
        whole = np.sort(np.concatenate([families.whole, families.cut]))
        bonds.families = replace(families, whole=whole, cut=families.cut[:0])
    table = bonds.law(lam, MU, 1.0, np.ones(1)).table
    L = assemble(bonds, table.kw, table.m).operator(lam, MU)
    given = np.where(outside[:, None], 0.0, exact)
    u = MatrixProblem(L, body.interior).solve(0 * given[None], given[None])[0]
    return float(np.abs(u - exact)[body.interior].max())


def by_cells(points: Points, horizon: float, mu: float) -> MatrixProblem:
    """The bond-based solid as standard codes have it: nodes weigh a cell, m is the integral."""
    x, nodes = points.x, np.flatnonzero(points.interior)
    near = cKDTree(x).query_ball_point(x[nodes], horizon * (1 + HORIZON_TOLERANCE))
    i = np.repeat(np.arange(len(nodes)), [len(some) for some in near])
    j = np.concatenate(near)
    i, j = i[j != nodes[i]], j[j != nodes[i]]
    xi = x[j] - x[nodes[i]]
    r = np.linalg.norm(xi, axis=1)
    volume = 2 * pi * horizon**3 / 3
    block = (
        16 * mu / volume * points.spacing**2 * xi[:, :, None] * xi[:, None] / r[:, None, None] ** 3
    )
    row = np.broadcast_to((2 * i[:, None] + np.arange(2))[:, :, None], block.shape)

    def at(column: np.ndarray) -> np.ndarray:
        return np.broadcast_to((2 * column[:, None] + np.arange(2))[:, None], block.shape)

    entries = np.concatenate([block.ravel(), -block.ravel()])
    columns = np.concatenate([at(nodes[i]).ravel(), at(j).ravel()])
    shape = (2 * len(nodes), 2 * len(x))
    L = sp.coo_array((entries, (np.tile(row.ravel(), 2), columns)), shape=shape).tocsr()
    return MatrixProblem(L, points.interior)


def solved_by_cells(
    points: Points, horizon: float, mu: float, u: np.ndarray, b: np.ndarray
) -> float:
    """Its relative ℓ2 error inside."""
    off = by_cells(points, horizon, mu).solve(b[None], u[None])[0] - u
    return float(np.linalg.norm(off) / np.linalg.norm(u[points.interior]))


def no_dilatation(x: np.ndarray) -> np.ndarray:
    """u = (sin x sin y, cos x cos y)."""
    a, b = x.T
    return np.stack([np.sin(a) * np.sin(b), np.cos(a) * np.cos(b)], axis=1)


def at_degree(degree: int, lam: float, points: Points, u: np.ndarray, b: np.ndarray) -> float:
    """Error at the fixed horizon with weights exact to a degree."""
    law = plain(lam, MANUFACTURED_MU, HORIZON, points.spacing)
    return error_of(law.on(points, quadrature_degree=degree), points, u, b)


def fixed_horizon(numbers: tuple[int, ...] = PARTS) -> dict[str, list[float]]:
    """u_h^δ → u^δ: the load is that of the integral, δ = 12.5 stays, nodes come closer.

    The field is two waves across their own direction, so that the integral only scales it, and by
    the same factor whatever λ.
    """
    q = 2 * pi / PERIOD
    across = np.array([1.0, 1.0]) / 2**0.5
    factor = across @ continuum_symbol(q * np.array([1.0, -1.0])) @ across
    found: dict[str, list[float]] = {"bond": [], "state": [], "quintic": [], "cells": []}
    found["degree"] = []
    for number in numbers:
        points = lattice(number, HORIZON, PERIOD)
        u = no_dilatation(q * points.x)
        b = factor * u

        for degree in (13, 11, 9, 7, 5):
            try:
                found["bond"].append(at_degree(degree, MANUFACTURED_MU, points, u, b))
                break
            except InputError:  # families too poor for that degree
                continue
        found["degree"].append(degree)
        found["state"].append(at_degree(degree, 3 * MANUFACTURED_MU, points, u, b))
        found["quintic"].append(at_degree(5, MANUFACTURED_MU, points, u, b))
        found["cells"].append(solved_by_cells(points, HORIZON, MANUFACTURED_MU, u, b))
    return found


def fixed_ratio() -> dict[str, list[float]]:
    """u_h^δ → u: δ = 3h, b = 2μu."""
    found: dict[str, list[float]] = {"bond": [], "state": [], "cells": []}
    for number in CELLS:
        horizon = 3 * LENGTH / number
        points = lattice(number, horizon, LENGTH)
        u = no_dilatation(points.x)
        b = 2 * MU * u
        for name, lam in (("bond", MU), ("state", 3 * MU)):
            found[name].append(error_of(plain(lam, MU, horizon, points.spacing), points, u, b))
        found["cells"].append(solved_by_cells(points, horizon, MU, u, b))
    return found


def order(numbers: tuple[int, ...], errors: list[float]) -> str:
    """Of convergence, by all of them."""
    return f"{-np.polyfit(np.log(numbers), np.log(errors), 1)[0]:.2f}"


def stretches() -> list[list[str]]:
    """The lattice's own critical stretch over the printed one, in the plane and in space."""
    rows = []
    for d, ratio in product((2, 3), (0.5, 1.0, 2.0)):
        cells = []
        for reach in (2, 3, 4, 6):
            solid = wp.Model(ratio, 1.0, 1.0, np.ones(1), float(reach), dimension=d)
            own = 1 / unit_toughness(solid, bond_classes(1.0, float(reach), dimension=d)) ** 0.5
            cells.append(f"{own / continuum_stretch(solid, 1.0):.3f}")
        rows.append([f"{d}", f"{ratio:g}", *cells])
    return rows
