"""The rim of a body in finite elements of plane elasticity with the moduli of a lattice (B1–B3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from warp_peri.errors import InputError
from warp_peri.points.mesh import Mesh

Field = Callable[[np.ndarray], np.ndarray]
"""Vectors, shape [n, 2], at positions [Å], shape [n, 2]."""
Traction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Force per area [TPa], shape [n, 2], at positions and outward normals, each of shape [n, 2]."""


@dataclass(frozen=True)
class Moduli:
    """C11, C12 and C44 [TPa] on the axes of a square lattice."""

    C11: float
    C12: float
    C44: float

    def stress(self, gradient: np.ndarray) -> np.ndarray:
        """σ [TPa] of displacement gradients, both of shape [..., 2, 2]."""
        normal = np.diagonal(gradient, axis1=-2, axis2=-1)
        along = self.C11 * normal + self.C12 * normal[..., ::-1]
        shear = self.C44 * (gradient[..., 0, 1] + gradient[..., 1, 0])
        rows = [along[..., 0], shear, shear, along[..., 1]]
        return np.stack(rows, axis=-1).reshape(gradient.shape)


def finite_elements() -> Any:
    """scikit-fem; InputError where it is not installed."""
    try:
        import skfem
    except ImportError:
        raise InputError("scikit-fem is not installed: pip install 'warp_peri[bodies]'") from None
    return skfem


class Rim:
    """Some triangles of a mesh as elements of degree 1, or of degree 2 and curved at the outline.

    Node i has the displacements 2 i and 2 i + 1.

    Args:
        mesh: of the body.
        kept: triangles of the rim, shape [T] bool.
        degree: of the elements.
    """

    def __init__(self, mesh: Mesh, kept: np.ndarray, degree: int = 2) -> None:
        fem = finite_elements()
        corners, triangles = np.unique(mesh.triangles[kept], return_inverse=True)
        triangles = triangles.reshape(-1, 3)
        straight = fem.MeshTri(mesh.x[corners].T.copy(), triangles.T.copy())
        size = len(corners)
        known = np.sort(straight.facets, axis=0)
        order = np.argsort(known[0] * size + known[1])
        place = np.full(len(mesh.x), -1)
        place[corners] = np.arange(size)
        ends = np.sort(place[mesh.edges], axis=1)
        key = (known[0] * size + known[1])[order]
        self.facets = order[np.searchsorted(key, ends[:, 0] * size + ends[:, 1])]
        shape = straight
        if degree == 2:
            shape = fem.MeshTri2.from_mesh(straight)
            positions = shape.doflocs.copy()
            positions[:, shape.dofs.facet_dofs[0, self.facets]] = mesh.middle.T
            shape = replace(shape, doflocs=positions)
        self.mesh, self.corners = mesh, corners
        self.cells = np.full(len(mesh.triangles), -1)
        self.cells[kept] = np.arange(len(triangles))
        self.element = fem.ElementTriP2() if degree == 2 else fem.ElementTriP1()
        self.order = 2 * degree + 2
        self.basis = fem.Basis(shape, self.element, intorder=self.order)
        self.x = np.asarray(self.basis.doflocs.T)
        cut = np.setdiff1d(straight.boundary_facets(), self.facets)
        self.inner = self._nodes(cut)
        self._fem, self._straight = fem, straight
        self._squares = self._assembled()

    def _nodes(self, facets: np.ndarray) -> np.ndarray:
        return np.asarray(self.basis.get_dofs(facets).flatten(), dtype=int)

    @property
    def corner_nodes(self) -> np.ndarray:
        """Nodes at the mesh's corners `corners`, in their order."""
        return np.asarray(self.basis.nodal_dofs[0])

    def nodes_of(self, part: str) -> np.ndarray:
        """Nodes on a named part of the outline."""
        return self._nodes(self.facets[self.mesh.parts[part]])

    def _assembled(self) -> list[sp.csr_array]:
        """∫ ∂_a φ_i ∂_c φ_j for (a, c) = (1, 1), (2, 2), (1, 2), shape [n, n] each."""
        squares = []
        for a, c in ((0, 0), (1, 1), (0, 1)):
            form = self._fem.BilinearForm(lambda u, v, w, a=a, c=c: v.grad[a] * u.grad[c])
            squares.append(sp.csr_array(form.assemble(self.basis)))
        return squares

    def stiffness(self, moduli: Moduli) -> sp.csr_array:
        """K [TPa], shape [2 n, 2 n], linear in the moduli (B2)."""
        first, second, mixed = self._squares
        across = moduli.C12 * mixed + moduli.C44 * mixed.T
        parts = (
            sp.kron(moduli.C11 * first + moduli.C44 * second, _unit(0, 0)),
            sp.kron(moduli.C11 * second + moduli.C44 * first, _unit(1, 1)),
            sp.kron(across, _unit(0, 1)),
            sp.kron(across.T, _unit(1, 0)),
        )
        return sp.csr_array(sum(parts[1:], parts[0]))

    def edge_stiffness(self, part: str, size: float) -> sp.csr_array:
        """∫ E_s (τ · ε(v) τ) (τ · ε(u) τ) over a part of the outline [TPa], as `stiffness` (B10).

        Args:
            part: name of it.
            size: E_s, force in an edge over its strain and the sheet's thickness [TPa Å].
        """
        basis = self._facets(part)
        products = []
        for a, c in ((0, 0), (0, 1), (1, 1)):

            def form(u: Any, v: Any, w: Any, a: int = a, c: int = c) -> Any:
                along = (-w.n[1], w.n[0])
                slopes = [along[0] * z.grad[0] + along[1] * z.grad[1] for z in (u, v)]
                return size * along[a] * along[c] * slopes[0] * slopes[1]

            products.append(sp.csr_array(self._fem.BilinearForm(form).assemble(basis)))
        blocks = (
            (0, 0, products[0]),
            (0, 1, products[1]),
            (1, 0, products[1]),
            (1, 1, products[2]),
        )
        parts = [sp.kron(block, _unit(a, c)) for a, c, block in blocks]
        return sp.csr_array(sum(parts[1:], parts[0]))

    def body_force(self, b: Field) -> np.ndarray:
        """∫ b · φ [TPa Å], shape [n, 2], of a body force density [TPa/Å]."""
        return self._integrals(self.basis, lambda w: b(_points(w.x)))

    def traction(self, part: str, t: Traction) -> np.ndarray:
        """∫ t · φ [TPa Å], shape [n, 2], of a force per area [TPa] on a part of the outline."""
        return self._integrals(self._facets(part), lambda w: t(_points(w.x), _points(w.n)))

    def _facets(self, part: str) -> Any:
        facets = self.facets[self.mesh.parts[part]]
        shape = self.basis.mesh
        return self._fem.FacetBasis(shape, self.element, facets=facets, intorder=self.order)

    def _integrals(self, basis: Any, vectors: Callable[[Any], np.ndarray]) -> np.ndarray:
        columns = []
        for a in (0, 1):
            form = self._fem.LinearForm(
                lambda v, w, a=a: vectors(w)[:, a].reshape(w.x.shape[1:]) * v
            )
            columns.append(form.assemble(basis))
        return np.stack(columns, axis=1)

    def probe(self, x: np.ndarray, triangles: np.ndarray) -> sp.csr_array:
        """Matrix from values at the nodes to values at points, shape [m, n].

        Args:
            x: positions [Å], shape [m, 2].
            triangles: number of the mesh's triangle that holds each, one of the rim's.
        """
        cells = self.cells[triangles]
        local = self.basis.mapping.invF(x.T[:, :, None], tind=cells)
        values, columns = [], []
        for k in range(self.basis.Nbfun):
            value = self.element.gbasis(self.basis.mapping, local, k, tind=cells)[0]
            values.append(np.asarray(value).reshape(len(x)))
            columns.append(self.basis.element_dofs[k, cells])
        rows = np.tile(np.arange(len(x)), self.basis.Nbfun)
        entries = (np.concatenate(values), (rows, np.concatenate(columns)))
        return sp.csr_array(sp.coo_array(entries, shape=(len(x), len(self.x))))

    def stress(self, moduli: Moduli, u: np.ndarray) -> np.ndarray:
        """σ [TPa] at the nodes, the mean over the elements that meet there, shape [n, 2, 2]."""
        places = np.asarray(self.element.doflocs).T
        basis = self._fem.Basis(
            self.basis.mesh, self.element, quadrature=(places, np.ones(places.shape[1]))
        )
        rows = [basis.interpolate(np.ascontiguousarray(u[:, a])).grad for a in (0, 1)]
        gradient = np.moveaxis(np.stack([np.asarray(row) for row in rows]), (0, 1), (-2, -1))
        each = moduli.stress(gradient)  # [elements, places, 2, 2]
        owner = self.basis.element_dofs.T.ravel()
        count = np.bincount(owner, minlength=len(self.x))
        flat = each.reshape(-1, 4)
        sums = [np.bincount(owner, column, len(self.x)) / count for column in flat.T]
        return np.stack(sums, axis=1).reshape(-1, 2, 2)


class RimProblem:
    """K u = f with some displacements given, factorised once.

    Args:
        K: stiffness [TPa], shape [2 n, 2 n].
        fixed: given displacements, shape [2 n] bool.
    """

    def __init__(self, K: sp.csr_array, fixed: np.ndarray) -> None:
        self.free = ~fixed
        rows = K[self.free]
        self.inside = sp.csc_array(rows[:, self.free])
        self.given = sp.csr_array(rows[:, fixed])
        self.factors = splu(self.inside, permc_spec="MMD_AT_PLUS_A")

    def solve(self, f: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Displacement [Å] from a load [TPa Å] and what is given, each of shape [2 n]."""
        u = given.copy()
        u[self.free] = self.factors.solve(f[self.free] - self.given @ given[~self.free])
        return u

    def solve_back(self, by_u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by f and by what is given, shape [2 n] each, of those by u."""
        by_f, by_given = np.zeros_like(by_u), np.zeros_like(by_u)
        by_f[self.free] = self.factors.solve(by_u[self.free], trans="T")
        by_given[~self.free] = by_u[~self.free] - self.given.T @ by_f[self.free]
        return by_f, by_given

    def residual(self, f: np.ndarray, u: np.ndarray) -> float:
        """‖K u − f‖ over ‖f − K of what is given‖ on the free displacements."""
        right = f[self.free] - self.given @ u[~self.free]
        left = right - self.inside @ u[self.free]
        size = float(np.linalg.norm(right))
        return float(np.linalg.norm(left)) / size if size else 0.0


def _unit(a: int, c: int) -> sp.csr_array:
    """1 in row a and column c, shape [2, 2]."""
    return sp.csr_array(([1.0], ([a], [c])), shape=(2, 2))


def _points(field: Any) -> np.ndarray:
    """[2, elements, places] as [n, 2]."""
    return np.moveaxis(np.asarray(field), 0, -1).reshape(-1, 2)
