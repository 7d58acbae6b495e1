"""Plane elasticity, linear or of third order, by finite elements of scikit-fem on a lattice."""

from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from warp_peri import InputError
from warp_peri.core.elastic import from_voigt
from warp_peri.points.samples import PointsLike

STEPS, SETTLED = 60, 1e-9
"""Most linear solves of a load of third order, and the relative residual that ends them."""


def elastic_solver(
    points: PointsLike, *, order: int, C: np.ndarray, third: Sequence[float] | None = None
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Assemble and factorise; the result solves for u [Å] on the interior, shape [..., I, 2].

    Args:
        points: a lattice. With order 2 the nodes are those of elements two spacings wide, so that
            the unknowns are the same nodes.
        order: 1 or 2 of the quadrilateral elements.
        C: Voigt matrix of plane elasticity [TPa], along the nodes' axes, shape [3, 3].
        third: t3, tq2 and q3 [TPa] of a crystal whose zigzag direction is the nodes' x axis; None
            for linear elasticity.

    The load is interpolated by the elements (consistent mass matrix).

    Raises InputError when scikit-fem is missing, and for a load of third order without answer.
    """
    try:
        import skfem
    except ImportError:
        raise InputError(
            "finite elements need scikit-fem: pip install 'warp_peri[compare]'"
        ) from None

    tensor = from_voigt(C)

    @skfem.BilinearForm
    def stiffness(u, v, w):
        return (np.tensordot(tensor, u.grad, 2) * v.grad).sum(axis=(0, 1))

    @skfem.BilinearForm
    def mass(u, v, w):
        return u[0] * v[0] + u[1] * v[1]

    @skfem.LinearForm
    def work(v, w):
        return (piola(w["u"].grad, tensor, third) * v.grad).sum(axis=(0, 1))

    mesh_nodes, cells = quadrilaterals(points, order)
    mesh = skfem.MeshQuad(points.x[mesh_nodes].T.copy(), cells)
    element = skfem.ElementQuad1() if order == 1 else skfem.ElementQuad2()
    basis = skfem.Basis(mesh, skfem.ElementVector(element), intorder=2 * order)
    K = stiffness.assemble(basis)
    M = mass.assemble(basis)
    component = np.zeros(basis.N, int)
    for dofs in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
        if dofs.size:
            component[dofs[1]] = 1
    distance, node = cKDTree(points.x).query(basis.doflocs.T)
    if distance.max() > 1e-6 * points.spacing:
        raise InputError("points: elements of two spacings need nodes at their middles")
    free = points.interior[node]
    if 2 * np.count_nonzero(points.interior) != np.count_nonzero(free):
        raise InputError("points: some interior nodes are not nodes of the elements")
    place = np.cumsum(points.interior)[node[free]] - 1
    factors = splu(sp.csc_matrix(K[free][:, free]))
    collar = K[free][:, ~free]

    def bent(start: np.ndarray, load: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """All unknowns of one load in third-order elasticity, by repeated linear solves."""
        found = start.copy()
        for _ in range(STEPS):
            left = load - work.assemble(basis, u=basis.interpolate(found))[free]
            if np.linalg.norm(left) <= SETTLED * np.linalg.norm(load - pull):
                return found
            found[free] += factors.solve(left)
        raise InputError("b: third-order elasticity finds no equilibrium under this load")

    def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
        load, given = b[..., node, component].T, u[..., node, component].T
        right, pull = (M @ load)[free], collar @ given[~free]
        solution = factors.solve(right - pull)
        if third is not None:
            start = given.copy()
            start[free] = solution
            columns = zip(*(each.reshape(len(each), -1).T for each in (start, right, pull)))
            solution = np.stack([bent(*column)[free] for column in columns], axis=-1)
            solution = solution.reshape(right.shape)
        inner = np.empty((*b.shape[:-2], np.count_nonzero(points.interior), 2))
        inner[..., place, component[free]] = solution.T
        return inner

    return solve


def piola(H: np.ndarray, C: np.ndarray, third: Sequence[float] | None) -> np.ndarray:
    """First Piola stress [TPa] of ½ E:C:E + t3 t³ + tq2 t |q|² + q3 Re q³, H of shape [2, 2, …].

    E is the Green strain, t its trace, q = (E₁₁ − E₂₂)/2 + i E₁₂.
    """
    t3, tq2, q3 = third or (0.0, 0.0, 0.0)
    F = H + np.eye(2).reshape(2, 2, *[1] * (H.ndim - 2))
    E = (np.einsum("ki...,kj...->ij...", F, F) - F + H) / 2
    t, q = E[0, 0] + E[1, 1], (E[0, 0] - E[1, 1]) / 2 + 1j * E[0, 1]
    by_t, by_q = 3 * t3 * t**2 + tq2 * abs(q) ** 2, 2 * tq2 * t * q + 3 * q3 * np.conj(q) ** 2
    S = np.tensordot(C, E, 2)
    S = S + np.array([[by_t + by_q.real / 2, by_q.imag / 2], [by_q.imag / 2, by_t - by_q.real / 2]])
    return np.asarray(np.einsum("ik...,kj...->ij...", F, S))


def quadrilaterals(points: PointsLike, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the lattice, so many spacings wide: nodes at their corners, and four each.

    Returns the numbers of the nodes, shape [V], and the corners of the squares among them, [4, C].
    """
    step = np.rint((points.x - points.x.min(axis=0)) / points.spacing).astype(int)
    number = np.full(step.max(axis=0) + 2 * width, -1)
    number[tuple(step.T)] = np.arange(len(step))
    first = step[(step % width == 0).all(axis=1)]
    corners = np.array(
        [
            number[tuple((first + shift).T)]
            for shift in width * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        ]
    )
    whole = (corners >= 0).all(axis=0)
    nodes, cells = np.unique(corners[:, whole], return_inverse=True)
    return nodes, cells.reshape(4, -1)
