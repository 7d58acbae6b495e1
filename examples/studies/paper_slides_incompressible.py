"""Nearly incompressible solids on scattered points, for the page on the slides: see papers.py."""

from collections.abc import Callable, Iterable
from itertools import product
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.spatial import ConvexHull, Voronoi

import warp_peri as wp
from examples.studies.paper_slides_rates import LENGTH, MU, lattice
from examples.studies.staggered import derivatives, least_squares, staggered, tensors, thinned
from warp_peri import Points
from warp_peri.lps.matrices import Matrices, matrices
from warp_peri.statics.direct import MatrixProblem

STIFFER, CELLS, SEEDS = (3.0, 1e2, 1e4, 1e6), (8, 16, 32), range(5)
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


def forms(model: wp.Model, points: Points) -> dict[str, Callable[[], MatrixProblem]]:
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
            model = wp.Model(ratio * MU, MU, 1.0, np.ones(1), horizon)
            u, b = curl_and_pressure(points.x, ratio)
            for name, problem in forms(model, points).items():
                solved = problem().solve(b[None], u[None])[0]
                error = np.linalg.norm(solved - u) / np.linalg.norm(u[points.interior])
                errors.setdefault(name, []).append(float(error))
        for name, several in errors.items():
            found.setdefault((name, ratio), []).append(ends(several))
    return [{"form": name, "ratio": ratio, "errors": e} for (name, ratio), e in found.items()]


def incompressible_row(found: dict[str, Any]) -> list[str]:
    """A form at one λ/μ, and the order of its largest errors."""
    return [found["form"], f"{found['ratio']:g}", *told(found["errors"], CELLS)]


# A free edge


def bending(points: Points, ratio: float) -> np.ndarray:
    """Pure bending, σ_yy = σ_xy = 0 everywhere: in equilibrium whatever face y = const is free."""
    x, y = (points.x - LENGTH / 2).T
    return np.stack([x * y, -(x**2 + ratio / (ratio + 2) * y**2) / 2], axis=1)


def edge_error(number: int, ratio: float, seed: int, form: str) -> float:
    """Relative ℓ2 error of u where nodes above y = LENGTH are no part of the body."""
    points, horizon = scattered(number, seed)
    outside = points.x[:, 1] > LENGTH
    body = Points(points.x, points.interior & ~outside, 0.0, outside=outside)
    model = wp.Model(ratio * MU, MU, 1.0, np.ones(1), horizon)
    exact = bending(points, ratio)
    given = np.where(outside[:, None], 0.0, exact)
    if form == "as written (9)":
        L = matrices(model, body).operator(model.lam, model.mu)
        problem = MatrixProblem(L, body.interior)
    else:
        problem = staggered(model, body)
    solved = problem.solve(0 * given[None], given[None])[0]
    off = (solved - exact)[body.interior]
    return float(np.linalg.norm(off) / np.linalg.norm(exact[body.interior]))


def free_edge() -> list[dict[str, Any]]:
    """Least and largest errors below a free edge, by form and λ/μ."""
    return [
        {"form": form, "ratio": ratio, "errors": [
            ends(edge_error(number, ratio, seed, form) for seed in SEEDS) for number in CELLS
        ]}
        for ratio, form in product(STIFFER, ("as written (9)", "θ at half the nodes"))
    ]  # fmt: skip


def ends(errors: Iterable[float]) -> list[float]:
    """Least and largest."""
    known = list(errors)
    return [min(known), max(known)]


# An inclusion


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
    parts = matrices(wp.Model(1.0, 1.0, 1.0, np.ones(1), 3 * h), points)
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
    solved = MatrixProblem(L, points.interior).solve(0 * exact[None], exact[None])[0]
    return float(np.linalg.norm(solved - exact) / np.linalg.norm(exact[nodes]))


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


def inclusion() -> list[dict[str, Any]]:
    """Least and largest errors by case."""
    return [
        {"case": case, "errors": [
            ends(inclusion_error(number, case, seed) for seed in DRAWS) for number in FINER
        ]}
        for case in CASES
    ]  # fmt: skip


def inclusion_row(found: dict[str, Any]) -> list[str]:
    """A case and the order of its largest errors."""
    return [found["case"], *told(found["errors"], FINER)]


def told(errors: list[list[float]], numbers: tuple[int, ...]) -> list[str]:
    """Ranges of errors by the number of nodes, and the order of the largest."""
    order = -np.polyfit(np.log(numbers), np.log([worst for _, worst in errors]), 1)[0]
    return [*(f"{least:.1e} to {worst:.1e}" for least, worst in errors), f"{order:.1f}"]
