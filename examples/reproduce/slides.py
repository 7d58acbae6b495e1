"""Claims of Trask's slides, computed: one function a table, printed as Markdown.

    python examples/reproduce/slides.py functionals edges      (default: every table)

Everything takes some five minutes of a processor; docs/record/slides.json has what came out.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import product
from math import factorial, pi, prod
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

import warp_peri as wp
from examples import diffusion, pressurised_crack
from examples.exact import continuum_symbol, fitted_order
from examples.prose import Table, print_tables
from warp_peri import InputError, Points
from warp_peri.errors import exit_status
from warp_peri.fracture import continuum_stretch
from warp_peri.fracture.bonds import unit_toughness
from warp_peri.materials.lps_force import Bonds, Matrices, assemble
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.points.families import HORIZON_TOLERANCE, ball_integral, bond_classes
from warp_peri.solvers.systems import MatrixProblem
from warp_peri.transfers import mean_spacing

EXPONENTS = (1.0, 2.0, 2.5, 3.0, 3.5)
SLOPE = np.array([0.7, -0.4, 0.5])
"""u = exp(a·x) of the pointwise rates."""
RADII = 0.3 * 0.75 ** np.arange(5)
"""Horizons of the pointwise rates; the nodes shrink with them."""
MU, LENGTH = 0.8, 2.0
HORIZON, KNOWN_MU = 12.5, 0.4545
"""Fixed horizon [Å] and shear modulus [TPa] of the limit that is nonlocal."""
CELLS = (8, 16, 32, 64)
"""Nodes a side, δ = 3h."""
NAMES = {
    "bond": "bond-based, λ = μ",
    "state": "state-based, λ = 3μ",
    "quintic": "bond-based, degree 5 throughout",
    "cells": "bond-based, cells as weights",
}
EDGES = {"bond-based, the printed field": 1.0, "state-based, λ = −0.27μ": -0.27, "λ = 3μ": 3.0}
"""λ/μ below a free edge."""
PERIOD, PARTS = 50.0, (10, 12, 16, 20, 32, 40)
"""Side of the square at a fixed horizon [Å], and its nodes a side."""
FUNCTIONALS = {"u": 0, "∂₁u": 1, "∂₁∂₂u": 2}
"""By name, and how many derivatives they hold."""
STIFFER, SIDES, SEEDS = (3.0, 1e2, 1e4, 1e6), (8, 16, 32), range(5)
"""λ/μ, nodes a side, and draws of the nodes."""
RADIUS, FINER, DRAWS = 0.5, (12, 24), range(3)
"""Of the inclusion, its nodes per unit length, and their draws."""
CASES = {
    "stiff in soft": ((30.0, 10.0), (1.5, 1.0)),
    "nearly incompressible inside": ((1e4, 1.0), (1.5, 1.0)),
    "nearly incompressible outside": ((1.5, 1.0), (1e4, 1.0)),
    "nearly incompressible both": ((1e4, 1.0), (1e4, 2.0)),
}
"""(λ, μ) inside and outside."""
APART = 1.3
"""Least distance between two nodes with a dilatation, in spacings: about half of all nodes."""
DEGREE, NEIGHBOURS = 3, 20
"""Of the polynomials that derivatives are exact for, and how many nearest nodes they read."""
SUPPORT = 1.05
"""Radius of the weight over the distance of the farthest of these."""
EXACT = 1e-6
"""Largest error of a derivative of a monomial that weights may have."""

# Moving least squares


def least_squares(
    y: np.ndarray,
    x: np.ndarray,
    orders: Sequence[tuple[int, ...]],
    *,
    degree: int = DEGREE,
    neighbours: int = NEIGHBOURS,
) -> list[sp.csr_array]:
    """Partial derivatives of these orders at y from values at x, by moving least squares (48b).

    `y`, `x`: places and nodes [length], shapes [Y, d] and [X, d]; `orders`: how often by each axis,
    zeros for the value itself; exact for polynomials of that degree, from so many nearest nodes.

    Returns a matrix of shape [Y, X] for each order. Raises InputError for too few nodes, or nodes
    on a curve of that degree.
    """
    if len(x) < neighbours:
        raise InputError(f"points: expected at least {neighbours} nodes to read, got {len(x)}")
    r, near = cKDTree(x).query(y, neighbours)
    radius = SUPPORT * r[:, -1, None]
    s = (x[near] - y[:, None]) / radius[..., None]
    weight = (1 - r / radius) ** 2
    d = x.shape[1]
    powers = np.array([p for p in product(range(degree + 1), repeat=d) if sum(p) <= degree])
    P = np.prod(s[:, :, None] ** powers, axis=-1)
    right = np.stack([prod(map(factorial, e)) * (powers == e).all(axis=1) for e in orders], axis=1)
    moments = np.einsum("yka,yk,ykb->yab", P, weight, P)
    try:
        answers = np.linalg.solve(moments, np.broadcast_to(1.0 * right, (len(y), *right.shape)))
        wrong = np.abs(moments @ answers - right).max()
    except np.linalg.LinAlgError:
        wrong = np.inf
    if not wrong <= EXACT:
        raise InputError(f"points: nodes to read lie on a curve of degree {degree}")
    W = np.einsum("yka,yac,yk->cyk", P, answers, weight)
    row = neighbours * np.arange(len(y) + 1)
    scaled = (w / radius ** sum(order) for w, order in zip(W, orders))
    return [sp.csr_array((w.ravel(), near.ravel(), row), shape=(len(y), len(x))) for w in scaled]


def derivatives(y: np.ndarray, x: np.ndarray) -> list[sp.csr_array]:
    """∂₁ and ∂₂ at y from values at x, exact for cubics (48b): two matrices of shape [Y, X]."""
    return least_squares(y, x, [(1, 0), (0, 1)])


def tensors(
    at_few: list[sp.csr_array], at_nodes: list[sp.csr_array]
) -> tuple[sp.csr_array, sp.csr_array]:
    """D, the divergence of displacements at some nodes, and G, a gradient at others (48a)."""
    axes = np.eye(2)
    D = sum(sp.kron(part, e[None]) for part, e in zip(at_few, axes))
    G = sum(sp.kron(part, e[:, None]) for part, e in zip(at_nodes, axes))
    return sp.csr_array(D), sp.csr_array(G)


def thinned(x: np.ndarray, among: np.ndarray, apart: float) -> np.ndarray:
    """Numbers of nodes of which no two are nearer than that, taken in their order."""
    near = cKDTree(x[among]).query_ball_point(x[among], apart)
    kept = np.zeros(len(among), bool)
    for number, others in enumerate(near):
        kept[number] = not kept[others].any()
    return np.asarray(among[kept])


def staggered(model: wp.LPSMaterial, nodes: Points) -> MatrixProblem:
    """Equilibrium on scattered points of the plane, whatever λ/μ: L = μ Γ − (λ−μ) G D (48a–48c).

    Γ is the model's own. D and G are the derivatives of its local limit, so that the answer tends
    to linear elasticity as horizon and spacing shrink together; nothing is proven of L. Where
    points say what is `outside`, edges are free: G sums over unbroken bonds there.
    """
    x, inside = nodes.x, nodes.interior
    body = np.ones(len(x), bool) if nodes.outside is None else ~nodes.outside
    few = thinned(x, np.flatnonzero(inside), APART * mean_spacing(nodes))
    parts = LPSOperator(model, nodes).matrices
    of_body = sp.eye_array(len(x), format="csr")[body]
    slopes = [part @ of_body for part in derivatives(x[few], x[body])]
    D, G = tensors(slopes, derivatives(x[inside], x[few]))
    if not body.all():
        cut = cKDTree(x[~body]).query(x[inside])[0] <= model.horizon * (1 + HORIZON_TOLERANCE)
        edge = sp.diags_array(np.repeat(cut, 2).astype(float))
        rows = sp.csc_array(edge @ parts.psi)
        read = np.flatnonzero(np.diff(rows.indptr))
        (values,) = least_squares(x[read], x[few], [(0, 0)], degree=2, neighbours=12)
        G = sp.csr_array(G - edge @ G + rows[:, read] @ values)
    return MatrixProblem(Matrices(parts.gamma, D, G).operator(model.lam, model.mu), inside)


# Rates


def pattern(d: int) -> np.ndarray:
    """Perturbed nodes around the origin within a ball of radius 1, none at it, shape [B, d]."""
    rng, reach = np.random.default_rng(d), 4 if d == 2 else 3
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * d), axis=-1).reshape(-1, d)
    shift = rng.uniform(-0.2, 0.2, ((2 * reach + 1) ** d - 1, d))
    xi = (steps[np.any(steps != 0, axis=1)] + shift) / reach
    return np.asarray(xi[np.linalg.norm(xi, axis=1) <= 1])


def functional(d: int, name: str, degree: int) -> list[str]:
    """Rate of a functional of u at 0 by moving least squares, and its largest error over the bound.

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
    rate = -fitted_order(RADII, errors)
    claimed = degree + 1 - FUNCTIONALS[name]
    return [*map(str, (d, name, degree, read, claimed)), f"{rate:.2f}", f"{max(shares):.2f}"]


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


def pointwise(d: int, exponent: float, degree: int) -> list[str]:
    """Rate of ∫ r^−α (u(x + ξ) − u(x)) dξ on perturbed nodes.

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
    rate = -fitted_order(RADII, errors)
    claimed = f"{degree - exponent + d + 1:.1f}"
    return [f"{d}", f"{exponent:g}", f"{degree}", f"{len(xi)}", claimed, f"{rate:.2f}"]


# Two limits


def lattice(cells: int, horizon: float, length: float) -> Points:
    """A square of nodes at the centres of cells, with the collar that the horizon needs."""
    h = length / cells
    pad = int(np.ceil(2 * horizon / h + 1e-9))
    steps = np.argwhere(np.ones((cells + 2 * pad,) * 2)) - pad
    inside: np.ndarray = np.all((steps >= 0) & (steps < cells), axis=1)
    return Points(h * (steps + 0.5), inside, h)


def plain(lam: float, mu: float, horizon: float, spacing: float) -> wp.LPSMaterial:
    """The solid with K = 1/r, whose positive kernel needs no certificate."""
    return wp.LPSMaterial(lam, mu, 1.0, np.ones(1), horizon, certified_on=(spacing,))


def error_of(material: Any, points: Points, u: np.ndarray, b: np.ndarray) -> float:
    """Relative ℓ2 error of the solution inside, u given on the collar."""
    return float(wp.evaluate(material, wp.Samples(points, u[None], b[None]))["E_u"])


def by_cells(points: Points, horizon: float, mu: float) -> MatrixProblem:
    """The bond-based solid as standard codes have it: nodes weigh a cell, m is the integral."""
    bonds = Bonds(points, horizon)
    kw = points.spacing**2 / bonds.families.r
    L = assemble(bonds, kw, 2 * pi * horizon**3 / 3).operator(mu, mu)
    return MatrixProblem(L, points.interior)


def off(problem: MatrixProblem, points: Points, u: np.ndarray, b: np.ndarray | float = 0) -> float:
    """Relative ℓ2 error of a solution inside, u given on the collar."""
    wrong, inside = problem.solve(b + 0 * u[None], u[None])[0] - u, points.interior
    return float(np.linalg.norm(wrong[inside]) / np.linalg.norm(u[inside]))


def no_dilatation(x: np.ndarray) -> np.ndarray:
    """u = (sin x sin y, cos x cos y)."""
    a, b = x.T
    return np.stack([np.sin(a) * np.sin(b), np.cos(a) * np.cos(b)], axis=1)


def at_degree(degree: int, lam: float, points: Points, u: np.ndarray, b: np.ndarray) -> float:
    """Error at the fixed horizon with weights exact to a degree."""
    law = plain(lam, KNOWN_MU, HORIZON, points.spacing)
    return error_of(law.on(points, quadrature_degree=degree), points, u, b)


def fixed_horizon() -> dict[str, list[float]]:
    """u_h^δ → u^δ: the load is that of the integral, δ = 12.5 stays, nodes come closer.

    The field is two waves across their own direction, so that the integral only scales it, and by
    the same factor whatever λ.
    """
    q = 2 * pi / PERIOD
    across = np.array([1.0, 1.0]) / 2**0.5
    wave = q * np.array([1.0, -1.0])
    factor = across @ continuum_symbol(wave, KNOWN_MU, KNOWN_MU, HORIZON) @ across
    found: dict[str, list[float]] = {"bond": [], "state": [], "quintic": [], "cells": []}
    found["degree"] = []
    for number in PARTS:
        points = lattice(number, HORIZON, PERIOD)
        u = no_dilatation(q * points.x)
        b = factor * u

        for degree in (13, 11, 9, 7, 5):
            try:
                found["bond"].append(at_degree(degree, KNOWN_MU, points, u, b))
                break
            except InputError:  # families too poor for that degree
                continue
        found["degree"].append(degree)
        found["state"].append(at_degree(degree, 3 * KNOWN_MU, points, u, b))
        found["quintic"].append(at_degree(5, KNOWN_MU, points, u, b))
        found["cells"].append(off(by_cells(points, HORIZON, KNOWN_MU), points, u, b))
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
        found["cells"].append(off(by_cells(points, horizon, MU), points, u, b))
    return found


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
    law = bonds.law(lam, MU, 1.0, np.ones(1))
    L = assemble(bonds, law.kw, law.m).operator(lam, MU)
    given = np.where(outside[:, None], 0.0, exact)
    u = MatrixProblem(L, body.interior).solve(0 * given[None], given[None])[0]
    return float(np.abs(u - exact)[body.interior].max())


# Near-incompressible solids


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


def forms(model: wp.LPSMaterial, points: Points) -> dict[str, Callable[[], MatrixProblem]]:
    """Ways to write the dilatational part; the deviatoric one is the same in all."""
    inside = points.interior

    def solid(change: Callable[[Matrices], Matrices]) -> MatrixProblem:
        parts = change(LPSOperator(model, points).matrices)
        return MatrixProblem(parts.operator(model.lam, model.mu), inside)

    def everywhere(parts: Matrices) -> Matrices:
        """Derivatives exact for cubics, the dilatation at every interior node."""
        x = points.x[inside]
        return Matrices(parts.gamma, *tensors(derivatives(x, points.x), derivatives(x, x)))

    return {
        "as written (9)": lambda: solid(lambda parts: parts),
        "moving least squares, θ at all nodes": lambda: solid(everywhere),
        "the same, θ at half the nodes": lambda: staggered(model, points),
    }


def bending(points: Points, ratio: float) -> np.ndarray:
    """Pure bending, σ_yy = σ_xy = 0 everywhere: in equilibrium whatever face y = const is free."""
    x, y = (points.x - LENGTH / 2).T
    return np.stack([x * y, -(x**2 + ratio / (ratio + 2) * y**2) / 2], axis=1)


def edge_error(number: int, ratio: float, seed: int, form: str) -> float:
    """Relative ℓ2 error of u where nodes above y = LENGTH are no part of the body."""
    points, horizon = scattered(number, seed)
    outside = points.x[:, 1] > LENGTH
    body = Points(points.x, points.interior & ~outside, 0.0, outside=outside)
    model = wp.LPSMaterial(ratio * MU, MU, 1.0, np.ones(1), horizon)
    exact = np.where(outside[:, None], 0.0, bending(points, ratio))
    if form != "as written (9)":
        return off(staggered(model, body), body, exact)
    L = LPSOperator(model, body).matrix()
    return off(MatrixProblem(L, body.interior), body, exact)


def ends(errors: Iterable[float]) -> list[float]:
    """Least and largest."""
    known = list(errors)
    return [min(known), max(known)]


def inclusion_error(number: int, case: str, seed: int) -> float:
    """Relative ℓ2 error of u around a disk of another material under equal strain.

    Bonds take μ in series along them; derivatives read one material only, and where balls hold both
    G is Ψ with the pressure of each node's own side.
    """
    inside, around = CASES[case]
    h = 1 / number
    flat = lattice(2 * number, 3.4 * h, 2.0)
    shift = np.random.default_rng(seed).uniform(-0.3 * h, 0.3 * h, flat.x.shape)
    points = Points(flat.x - 1 + shift, flat.interior, 0.0)
    x, nodes = points.x, np.flatnonzero(points.interior)
    r = np.linalg.norm(x, axis=1)
    core = r < RADIUS
    parts = LPSOperator(wp.LPSMaterial(1.0, 1.0, 1.0, np.ones(1), 3 * h), points).matrices
    few = thinned(x, nodes, 1.3 * h)
    D: list[Any] = [0, 0]
    G: list[Any] = [0, 0]
    value: Any = 0
    for side in (core, ~core):
        reads, own = picked(side), picked(side[few])
        some, rows = x[few][side[few]], picked(side[nodes])
        for axis, (at_few, at_nodes) in enumerate(
            zip(derivatives(some, x[side]), derivatives(x[nodes][side[nodes]], some))
        ):
            D[axis] = D[axis] + own.T @ at_few @ reads
            G[axis] = G[axis] + rows.T @ at_nodes @ own
        (values,) = least_squares(x[side], some, [(0, 0)], degree=2, neighbours=12)
        value = value + reads.T @ values @ own
    across = sp.diags_array(np.repeat(np.abs(r[nodes] - RADIUS) < 3 * h, 2).astype(float))
    divergence, gradient = tensors(D, G)
    gradient = gradient - across @ gradient + across @ parts.psi @ value
    excess = np.where(core[few], inside[0] - inside[1], around[0] - around[1])
    gamma = in_series(parts.gamma, x, nodes, inside[1], around[1])
    L = sp.csr_array(gamma - gradient @ sp.diags_array(excess) @ divergence)
    bulk, shear = inside[0] + inside[1], around[1]
    swell = (around[0] + 2 * shear) / (bulk + shear)
    exact = x * np.where(core, swell, 1 + (swell - 1) * (RADIUS / r) ** 2)[:, None]
    return off(MatrixProblem(L, points.interior), points, exact)


def picked(mask: np.ndarray) -> sp.csr_array:
    """The rows of the identity where the mask is true."""
    return sp.eye_array(len(mask), format="csr")[np.flatnonzero(mask)]


def in_series(
    gamma: sp.csr_array, x: np.ndarray, nodes: np.ndarray, inside: float, around: float
) -> sp.csr_array:
    """Γ of one material with each bond's μ the harmonic mean along it."""
    entries = gamma.tocoo()
    i, j = nodes[entries.row // 2], entries.col // 2
    bonds = i != j
    along = (np.arange(16) + 0.5) / 16
    a, b = x[i[bonds]], x[j[bonds]]
    share = sum((np.hypot(*(a + t * (b - a)).T) < RADIUS) / 16 for t in along)
    mu = 1 / (share / inside + (1 - share) / around)
    data, row, col = entries.data[bonds] * mu, entries.row[bonds], entries.col[bonds]
    own = 2 * nodes[row // 2] + col % 2
    return sp.coo_array(
        (np.concatenate([data, -data]), (np.tile(row, 2), np.concatenate([col, own]))),
        shape=gamma.shape,
    ).tocsr()


# Tables


def row(name: str, errors: Sequence[float], numbers: Sequence[int] = ()) -> list[str]:
    """Errors of one case, with their order where numbers of nodes are given."""
    end = [f"{fitted_order(numbers, errors):.2f}"] if numbers else []
    return [name, *(f"{e:.1e}" for e in errors), *end]


def ranges(name: list[str], errors: list[list[float]], numbers: Sequence[int]) -> list[str]:
    """Least and largest errors of several draws, and the order of the largest."""
    cells = (f"{least:.1e} to {worst:.1e}" for least, worst in errors)
    return [*name, *cells, f"{fitted_order(numbers, [worst for _, worst in errors]):.1f}"]


def functionals() -> Table:
    """Rates of functionals by moving least squares."""
    cases = product((2, 3), FUNCTIONALS, (2, 3, 4))
    columns = ["d", "functional", "degree m", "nodes read", "claimed rate", "fitted rate"]
    return [*columns, "error over bound"], [functional(*case) for case in cases]


def quadrature() -> Table:
    """Rates of the quadrature."""
    cases = product((2, 3), EXPONENTS, (2, 3, 4))
    columns = ["d", "α", "n", "bonds", "claimed rate", "fitted rate"]
    return columns, [pointwise(*case) for case in cases]


def nonlocal_limit() -> Table:
    """Errors at a fixed horizon, by nodes a side."""
    found = fixed_horizon()
    degrees = ["degree", *(f"{degree}" for degree in found.pop("degree"))]
    return ["", *map(str, PARTS)], [degrees, *(row(NAMES[n], e) for n, e in found.items())]


def local_limit() -> Table:
    """Errors at a fixed ratio of horizon and spacing, by nodes a side."""
    rows = [row(NAMES[name], errors, CELLS) for name, errors in fixed_ratio().items()]
    return ["", *map(str, CELLS), "order"], rows


def stretches() -> Table:
    """The lattice's own critical stretch over the printed one, by δ/h."""
    rows, reaches = [], (2, 3, 4, 6)
    for d, ratio in product((2, 3), (0.5, 1.0, 2.0)):
        cells = []
        for reach in reaches:
            solid = wp.LPSMaterial(ratio, 1.0, 1.0, np.ones(1), float(reach), dimension=d)
            own = 1 / unit_toughness(solid, bond_classes(1.0, float(reach), dimension=d)) ** 0.5
            cells.append(f"{own / continuum_stretch(solid, 1.0):.3f}")
        rows.append([f"{d}", f"{ratio:g}", *cells])
    return ["d", "λ/μ", *map(str, reaches)], rows


def edges() -> Table:
    """Largest errors below a free edge."""
    rows = []
    for (name, ratio), corrected in product(EDGES.items(), (True, False)):
        if ratio == 1 and not corrected:
            continue  # no dilatation in it
        errors = [free_edge(n, ratio, corrected=corrected) for n in CELLS]
        end = "" if ratio == 1 else ", renormalised" if corrected else ", not renormalised"
        rows.append(row(name + end, errors, CELLS))
    return ["", *map(str, CELLS), "order"], rows


def near_incompressible() -> Table:
    """Smooth fields on scattered points, by form and λ/μ."""
    found: dict[tuple[str, float], list[list[float]]] = {}
    for ratio, number in product(STIFFER, SIDES):
        errors: dict[str, list[float]] = {}
        for seed in SEEDS:
            points, horizon = scattered(number, seed)
            model = wp.LPSMaterial(ratio * MU, MU, 1.0, np.ones(1), horizon)
            u, b = curl_and_pressure(points.x, ratio)
            for name, problem in forms(model, points).items():
                errors.setdefault(name, []).append(off(problem(), points, u, b))
        for name, several in errors.items():
            found.setdefault((name, ratio), []).append(ends(several))
    rows = [ranges([form, f"{ratio:g}"], each, SIDES) for (form, ratio), each in found.items()]
    return ["dilatational part", "λ/μ", *map(str, SIDES), "order"], rows


def near_incompressible_edge() -> Table:
    """The same below a free edge."""
    rows = []
    for ratio, form in product(STIFFER, ("as written (9)", "θ at half the nodes")):
        errors = [ends(edge_error(n, ratio, seed, form) for seed in SEEDS) for n in SIDES]
        rows.append(ranges([form, f"{ratio:g}"], errors, SIDES))
    return ["dilatational part", "λ/μ", *map(str, SIDES), "order"], rows


def near_incompressible_inclusion() -> Table:
    """The same around an inclusion, by nodes per unit length."""
    rows = []
    for case in CASES:
        errors = [ends(inclusion_error(n, case, seed) for seed in DRAWS) for n in FINER]
        rows.append(ranges([case], errors, FINER))
    return ["", *map(str, FINER), "order"], rows


def conduction() -> Table:
    """Diffusion, by nodes per unit length."""
    cases: dict[str, Callable[[int], float]] = {
        "homogeneous, lattice": lambda n: diffusion.smooth(n, 0.0),
        "homogeneous, scattered": lambda n: diffusion.smooth(n, 0.2),
        "κ jumps 1:10, in series along bonds": diffusion.jump,
        "the same, mean of the ends": lambda n: diffusion.jump(n, along=False),
        "a jump of the flux": lambda n: diffusion.jump(n, 1.0, 3.0),
        "the same, κ jumps 1:10 there": lambda n: diffusion.jump(n, flux=3.0),
    }
    rows = [row(name, [error(n) for n in SIDES], SIDES) for name, error in cases.items()]
    both = zip(*(diffusion.coupled(n) for n in SIDES))
    rows += [row(f"coupled to mechanics, {name}", e, SIDES) for name, e in zip("uφ", both)]
    return ["", *map(str, SIDES), "order"], rows


def pressure() -> Table:
    """Opening and volume of a crack under pressure over Sneddon's."""
    found = {n: pressurised_crack.opening(n)[0] for n in SIDES}
    rows = [[f"L/{n}", f"{f['opening']:.3f}", f"{f['volume']:.4f}"] for n, f in found.items()]
    return ["spacing", "opening", "volume"], rows


TABLES = (
    functionals, quadrature, nonlocal_limit, local_limit, stretches, edges, near_incompressible,
    near_incompressible_edge, near_incompressible_inclusion, conduction, pressure,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(exit_status(lambda: print_tables(__doc__, TABLES)))
