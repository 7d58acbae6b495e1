"""Local elasticity of a plane, linear or of third order, by finite elements of scikit-fem.

On the nodes of a lattice, and on points between them that are so near that no mesh errs.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import binary_erosion, convolve1d
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

import warp_peri as wp
from tools.hyperelastic_elements import finite_elements
from warp_peri import InputError, Points, Samples
from warp_peri.core.elastic import voigt, voigt_to_tensor
from warp_peri.points.points import PointsLike

STEPS, SETTLED = 60, 1e-9
"""Most linear solves of a load of third order, and the relative residual that ends them."""
FINER = 4
"""Points of elements, which are two of them wide, in a spacing."""
BETWEEN = np.zeros(19)
BETWEEN[::2] = np.array([35, -405, 2268, -8820, 39690, 39690, -8820, 2268, -405, 35]) / 2**16
BETWEEN[9] = 1.0
"""Ten-point interpolation half way, on points twice as dense."""


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
    skfem, tensor = finite_elements(), voigt_to_tensor(C)

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
    component = np.arange(basis.N) % 2  # x and y of a place in turn
    distance, node = cKDTree(points.x).query(basis.doflocs.T)
    free = points.interior[node]
    every = 2 * np.count_nonzero(points.interior) == np.count_nonzero(free)
    if not (every and distance.max() < 1e-6 * points.spacing):
        raise InputError("points: expected all interior nodes, and no others, on the elements")
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
    shifts = width * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = np.array([number[tuple((first + shift).T)] for shift in shifts])
    whole = (corners >= 0).all(axis=0)
    nodes, cells = np.unique(corners[:, whole], return_inverse=True)
    return nodes, cells.reshape(4, -1)


def local_solver(
    points: PointsLike, C: np.ndarray, third: Sequence[float] | None = None
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Assemble and factorise; the result solves for u on the interior, shape [..., I, 2].

    `points`: a square lattice with a collar of five nodes at least; `C`, `third`: as of
    elastic_solver.
    """
    steps, axes = points.lattice
    place = FINER * (steps - steps.min(axis=0))
    shape = tuple(place.max(axis=0) + 1)
    body = np.zeros(shape, bool)  # the elements that touch the interior
    for corner in np.ndindex(2 * FINER + 1, 2 * FINER + 1):
        body[tuple((place[points.interior] + corner - FINER).T)] = True
    free = binary_erosion(body, np.ones((3, 3)))
    free[tuple(place[~points.interior].T)] = False
    spacing = points.spacing / FINER
    fine = Points(np.argwhere(body) * spacing, free[body], spacing)
    factorised = elastic_solver(fine, order=2, C=C, third=third)
    unknown = np.zeros(shape, int)
    unknown[free] = np.arange(np.count_nonzero(free))
    nodes = unknown[tuple(place[points.interior].T)]

    def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
        stacks = (np.reshape(field, (-1, *field.shape[-2:])) for field in (b, u))
        load, held = (_refined(field @ axes, place, shape)[:, body] for field in stacks)
        found = factorised(load, held)[:, nodes] @ axes.T
        return found.reshape(*u.shape[:-2], *found.shape[1:])

    return solve


def _refined(field: np.ndarray, place: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A field [S, N, 2] on points a quarter of a spacing apart, [S, *shape, 2]."""
    grid = np.zeros((len(field), *shape, 2))
    grid[:, place[:, 0], place[:, 1]] = field
    wide = np.zeros(2 * len(BETWEEN) - 1)
    wide[::2] = BETWEEN  # half way between nodes first
    for weights in (wide, BETWEEN):
        for axis in (1, 2):
            grid = convolve1d(grid, weights, axis=axis, mode="constant")
    return grid


def errors_of_local(samples: Samples, C: np.ndarray) -> np.ndarray:
    """E_u of local elasticity by sample: relative ℓ2 errors on the interior, shape [S]."""
    found = local_solver(samples.points, C)(samples.loads, samples.u)
    true = samples.u[:, samples.interior]
    wrong, size = (np.linalg.norm(f.reshape(len(f), -1), axis=1) for f in (found - true, true))
    return np.asarray(wrong / size)


def moduli_of(material: Any, spacing: float) -> np.ndarray:
    """Voigt matrix [3, 3] of the long waves of a law of sheets, of its linear part if it has one.

    Raises InputError for a law that has none.
    """
    law = getattr(material, "linear", material)
    law = wp.crystals.crystal_from_lps(law, spacing) if isinstance(law, wp.LPSMaterial) else law
    if not isinstance(law, wp.crystals.CrystalMaterial) or law.dimension != 2:
        raise InputError(f"model: expected a law of sheets that is linear, got {law!r:.80}")
    return voigt(law.tensor())
