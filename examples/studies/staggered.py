"""Nearly incompressible solids on scattered points: θ at fewer nodes (theory, 48a–48c)."""

from collections.abc import Sequence
from itertools import product
from math import factorial, prod

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from warp_peri import InputError, Model
from warp_peri.lps.matrices import Matrices, matrices
from warp_peri.points.families import HORIZON_TOLERANCE
from warp_peri.points.interpolation import mean_spacing
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.statics.direct import MatrixProblem

APART = 1.3
"""Least distance between two nodes with a dilatation, in spacings: about half of all nodes."""
DEGREE, NEIGHBOURS = 3, 20
"""Of the polynomials that derivatives are exact for, and how many nearest nodes they read."""
SUPPORT = 1.05
"""Radius of the weight over the distance of the farthest of these."""
EXACT = 1e-6
"""Largest error of a derivative of a monomial that weights may have."""


def staggered(model: Model, points: PointsLike) -> MatrixProblem:
    """Equilibrium on scattered points of the plane, whatever λ/μ: L = μ Γ − (λ−μ) G D (48a–48c).

    Γ is the model's own. D and G are the derivatives of its local limit, so that the answer tends
    to linear elasticity as horizon and spacing shrink together; nothing is proven of L. Where
    points say what is `outside`, edges are free: G sums over unbroken bonds there.
    `staggered(model, points).solve(b, u)` takes loads [stress/length] and displacements [length]
    of shape [S, N, 2] and gives displacements, those of the collar as they came.

    Raises InputError for points in space, or fewer interior nodes than derivatives need.
    """
    nodes = nodes_of(points)
    if nodes.dimension != 2:
        raise InputError("points: expected points of the plane, got points in space")
    x, inside = nodes.x, nodes.interior
    body = np.ones(len(x), bool) if nodes.outside is None else ~nodes.outside
    few = thinned(x, np.flatnonzero(inside), APART * mean_spacing(nodes))
    parts = matrices(model, nodes)
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


def derivatives(y: np.ndarray, x: np.ndarray) -> list[sp.csr_array]:
    """∂₁ and ∂₂ at y from values at x, exact for cubics (48b): two matrices of shape [Y, X].

    Raises InputError for too few nodes, or nodes on a curve of the third degree.
    """
    return least_squares(y, x, [(1, 0), (0, 1)])


def least_squares(
    y: np.ndarray,
    x: np.ndarray,
    orders: Sequence[tuple[int, ...]],
    *,
    degree: int = DEGREE,
    neighbours: int = NEIGHBOURS,
) -> list[sp.csr_array]:
    """Partial derivatives of these orders at y from values at x, by moving least squares (48b).

    Args:
        y: places [length], shape [Y, d].
        x: nodes [length], shape [X, d].
        orders: how often by each axis; zeros for the value itself.
        degree: of the polynomials that they are exact for.
        neighbours: nearest nodes that each place reads.

    Returns a matrix of shape [Y, X] for each order.

    Raises InputError for too few nodes, or nodes on a curve of that degree.
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
