"""Elements at the rim of a body, and its loads: tractions, held parts, body forces (B1–B3)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy import ndarray
from numpy.linalg import norm, pinv
from numpy.typing import ArrayLike
from scipy.ndimage import binary_dilation
from scipy.signal import upfirdn
from scipy.sparse.linalg import LinearOperator, splu

from warp_peri.core.elastic import voigt_to_tensor
from warp_peri.core.stencil import numbers_at
from warp_peri.errors import OF_POSITIONS, InputError, Values, called, optional
from warp_peri.points.arguments import ArrayMap, Pair, check_function, check_mapping, checked
from warp_peri.points.mesh import Mesh, pieces
from warp_peri.solvers.systems import loose_pieces

Field = ArrayMap
"""Vectors, shape [n, d], at positions [Å], shape [n, d]."""
Traction = Callable[[ndarray, ndarray], ndarray]
"""Force per area [TPa], shape [n, d], at positions and outward normals, each of shape [n, d]."""


@dataclass(frozen=True, eq=False)
class Moduli:
    """Elastic moduli C_ijkl [stress] of a solid, shape [d, d, d, d]."""

    tensor: ndarray

    @classmethod
    def square(cls, C11: float, C12: float, C44: float) -> Moduli:
        """Moduli of a sheet whose axes are those of a square lattice."""
        return cls(voigt_to_tensor(np.array([[C11, C12, 0], [C12, C11, 0], [0, 0, C44]])))

    C11, C12, C44 = (  # of the first two axes
        property(lambda self, at=at: float(self.tensor[at]))  # type: ignore[misc]
        for at in ((0, 0, 0, 0), (0, 0, 1, 1), (0, 1, 0, 1))
    )

    def stress(self, gradient: ndarray) -> ndarray:
        """Stress σ [stress] of displacement gradients, both of shape [..., d, d]."""
        return np.asarray(np.einsum("ijkl,...kl->...ij", self.tensor, gradient))


MOST_STEPS, FOUND = 30, 1e-11
"""Of Newton's method for a position in a cell, and a step of it that is none."""


class Rim:
    """Elements of degree 1, or of degree 2 and curved at the outline, on cells `kept` [T] of a
    mesh. Node i has the displacements d i to d i + d − 1."""

    def __init__(self, mesh: Mesh, kept: ndarray, degree: int = 2) -> None:
        needed = "scikit-fem is not installed: pip install 'warp_peri[bodies]'"
        self._fem, self.d, self.mesh = optional("skfem", needed), mesh.dimension, mesh
        kind = {2: "Tri", 3: "Tet"}[self.d]
        self.corners, cells = np.unique(mesh.cells[kept], return_inverse=True)
        cells, place = cells.reshape(-1, self.d + 1), numbers_at(len(mesh.x), self.corners)
        make = getattr(self._fem, f"Mesh{kind}")
        shape = straight = make(mesh.x[self.corners].T.copy(), cells.T.copy())
        self.facets = _columns(place[mesh.faces], straight.facets)
        if degree == 2 and len(mesh.curved):
            shape = getattr(self._fem, f"Mesh{kind}2").from_mesh(straight)
            positions, kinds = shape.doflocs.copy(), ("facet", "edge")[self.d - 2]
            edge = _columns(place[mesh.curved], getattr(straight, f"{kinds}s"))
            dofs = getattr(shape.dofs, f"{kinds}_dofs")[0, edge[edge >= 0]]
            positions[:, dofs] = mesh.middle[edge >= 0].T
            shape = replace(shape, doflocs=positions)
        self.cells = numbers_at(len(mesh.cells), kept)
        self.element, self.order = getattr(self._fem, f"Element{kind}P{degree}")(), 2 * degree + 2
        self.basis = self._fem.Basis(shape, self.element, intorder=self.order)
        self.x = np.asarray(self.basis.doflocs.T)
        self.inner = self._nodes(np.setdiff1d(straight.boundary_facets(), self.facets))

    def _nodes(self, facets: ndarray) -> ndarray:
        return np.asarray(self.basis.get_dofs(facets).flatten(), int)

    @property
    def corner_nodes(self) -> ndarray:
        """Nodes at the mesh's corners `corners`, in their order."""
        return np.asarray(self.basis.nodal_dofs[0])

    def nodes_of(self, part: str) -> ndarray:
        """Nodes on a named part of the outline."""
        return self._nodes(self.facets[self.mesh.parts[part]])

    @cached_property
    def _squares(self) -> dict[tuple[int, int], sp.csr_array]:
        """Integrals ∫ ∂_a φ_i ∂_c φ_j, [n, n] by a and c."""
        each = {}
        for a, c in itertools.combinations_with_replacement(range(self.d), 2):
            form = self._fem.BilinearForm(lambda u, v, w, a=a, c=c: v.grad[a] * u.grad[c])
            each[a, c] = sp.csr_array(form.assemble(self.basis))
        return {(c, a): square.T for (a, c), square in each.items()} | each

    def stiffness(self, moduli: Moduli) -> sp.csr_array:
        """Stiffness K [stress], shape [d n, d n], linear in the moduli (B2)."""
        C, squares = moduli.tensor, self._squares.items()
        return sp.csr_array(sum(sp.kron(square, C[:, a, :, c]) for (a, c), square in squares))

    def body_force(self, b: Field) -> ndarray:
        """Nodal loads ∫ b · φ [TPa Å], shape [n, d], of a body force density [TPa/Å]."""
        return self._load(self.basis, b)

    def traction(self, part: str, t: Traction) -> ndarray:
        """Nodal loads ∫ t · φ [TPa Å], shape [n, d], of a force per area [TPa] on a part."""
        facets, on = self.facets[self.mesh.parts[part]], (self.basis.mesh, self.element)
        basis = self._fem.FacetBasis(*on, facets=facets, intorder=self.order)
        return self._load(basis, lambda x: t(x, _points(basis.normals)))

    def _load(self, basis: Any, density: Field) -> ndarray:
        x, f = np.asarray(basis.global_coordinates()), np.zeros_like(self.x)
        values = density(_points(x)).reshape(*x.shape[1:], self.d)
        for nodes, of in zip(basis.element_dofs, basis.basis):
            np.add.at(f, nodes, np.einsum("eq,eqa->ea", np.asarray(of[0]) * basis.dx, values))
        return f

    def probe(self, x: ndarray, holding: ndarray) -> sp.csr_array:
        """Matrix [m, n] from nodal values to values at x [m, d], in the rim's cells `holding`."""
        cells, mapping = self.cells[holding], self.basis.mapping
        at, count = self._places(x, cells), range(self.basis.Nbfun)
        values = [self.element.gbasis(mapping, at, k, tind=cells)[0] for k in count]
        columns = self.basis.element_dofs[:, cells].ravel()
        entries = np.reshape(values, -1), (np.tile(np.arange(len(x)), len(count)), columns)
        return sp.csr_array(entries, shape=(len(x), len(self.x)))

    def _places(self, x: ndarray, cells: ndarray) -> ndarray:
        """Positions in coordinates of their cells, or a little outside, [d, m, 1], by Newton."""
        mapping, goal = self.basis.mapping, x.T[:, :, None]
        places = np.full(goal.shape, 1 / (self.d + 1))
        for _ in range(MOST_STEPS):
            left = goal - mapping.F(places, tind=cells)
            step = np.einsum("ijkl,jkl->ikl", mapping.invDF(places, tind=cells), left)
            places = places + step
            if np.abs(step).max(initial=0.0) < FOUND:
                return np.asarray(places)
        raise InputError("mesh: expected curved cells that are one-to-one, some are folded")

    def stress(self, moduli: Moduli, u: ndarray) -> ndarray:
        """Stress σ [TPa] at the nodes, shape [n, d, d]: means over the elements that meet there.

        In each element it is the linear field through its values at d + 1 places inside, which are
        more accurate than those at nodes, above all in curved elements.
        """
        basis = self._fem.Basis(self.basis.mesh, self.element, intorder=2)
        nodes = self.basis.element_dofs.T
        gradient = sum(
            np.einsum("ei,aeq->eqia", u[each], of[0].grad) for each, of in zip(nodes.T, basis.basis)
        )
        inside = moduli.stress(gradient).reshape(*gradient.shape[:2], -1)
        x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
        middle = x.mean(axis=1, keepdims=True)
        slope = pinv(x - middle) @ inside  # [elements, d, d²]
        each = inside.mean(axis=1, keepdims=True) + (self.x[nodes] - middle) @ slope
        means = np.zeros((len(self.x), self.d**2))
        np.add.at(means, nodes, each)
        return (means.T / np.bincount(nodes.ravel())).T.reshape(-1, self.d, self.d)


class RimProblem(LinearOperator):  # type: ignore[misc]
    """Problem K u = f with displacements given where `fixed` [d n], factorised once; K in TPa. A
    linear map from (f, given), flat [2 d n], to u, flat [d n]."""

    def __init__(self, K: sp.csr_array, fixed: ndarray) -> None:
        super().__init__(float, (len(fixed), 2 * len(fixed)))
        self.free, self._rows = ~fixed, K[~fixed]
        self.inside = sp.csc_array(self._rows[:, self.free])
        self._factors = splu(self.inside, permc_spec="MMD_AT_PLUS_A") if not fixed.all() else None

    def _matvec(self, q: ndarray) -> ndarray:
        f, given = np.split(q.ravel(), 2)
        u = np.where(self.free, 0.0, given)
        if self._factors:
            u[self.free] = self._factors.solve(f[self.free] - self._rows @ u)
        return u

    def _rmatvec(self, by_u: ndarray) -> ndarray:
        """Derivatives by f and by given displacements, of derivatives by u."""
        by_f = np.zeros((2, len(self.free)))
        if self._factors:
            by_f[0, self.free] = w = self._factors.solve(by_u.ravel()[self.free])
            by_f[1] = -self._rows.T @ w
        by_f[1] = np.where(self.free, 0.0, by_u.ravel() + by_f[1])
        return by_f.ravel()

    def residual(self, f: ndarray, u: ndarray) -> float:
        """Residual ‖K u − f‖ over ‖f − K of what is given‖ on the free displacements."""
        left, right = (f[self.free] - self._rows @ one for one in (u, np.where(self.free, 0.0, u)))
        return float(norm(left) / (norm(right) or 1.0))


def _columns(asked: ndarray, there: ndarray) -> ndarray:
    """Column of `there` [k, m] with the numbers of each row of `asked` [n, k], −1 for none."""
    size = (there.max() + 1) ** np.arange(len(there))
    known, keys = size @ np.sort(there, axis=0), np.sort(asked, axis=1) @ size
    order = np.argsort(known)
    found = order[np.minimum(np.searchsorted(known[order], keys), len(order) - 1)]
    return np.where((known[found] == keys) & (asked >= 0).all(axis=1), found, -1)


def _points(field: Any) -> ndarray:
    """Reshape a field [d, elements, places] to [n, d]."""
    return np.moveaxis(np.asarray(field), 0, -1).reshape(-1, len(field))


FINE = 4
"""Places in a spacing, on either axis, where the density is read for a lattice."""
SAME = 1e-9
"""Of the largest displacement that is given: two that differ by less are one."""


@dataclass(frozen=True)
class BodyLoads:
    """Displacement [Å], NaN for free components, traction by part of the outline; body force."""

    held: Mapping[str, Field]
    pulls: Mapping[str, Traction]
    b: Field | None

    def on(self, rim: Rim) -> ndarray:
        """Load of tractions and the body force on the nodes of elements [TPa Å], shape [n, d]."""
        f = np.zeros_like(rim.x) if self.b is None else rim.body_force(self.b)
        for name, pull in self.pulls.items():
            f += rim.traction(name, pull)
        return f

    def density(self, x: ndarray, spacing: float) -> ndarray:
        """Body force density [TPa/Å] at lattice nodes x, along the axes [Å], both of shape [n, d].

        The mean around a node, read up to 2.5 spacings away (B16): no force is lost between nodes,
        quadratic fields stay, and jumps between triangles are smoothed.
        """
        if self.b is None:
            return np.zeros_like(x)
        cells = np.rint((x - x.min(axis=0)) / spacing).astype(int) + 2
        d = x.shape[1]
        near = np.zeros(cells.max(axis=0) + 3, bool)
        near[*cells.T] = True
        near = binary_dilation(near, np.ones((5,) * d))
        places = np.argwhere(np.kron(near, np.ones((FINE,) * d, bool)))
        fine = np.zeros((*(FINE * np.array(near.shape)), d))
        fine[*places.T] = self.b(x.min(axis=0) + spacing * ((places + 0.5) / FINE - 2.5))
        s = np.abs((np.arange(5 * FINE) + 0.5) / FINE - 2.5)
        inner, outer = 1 + s**2 * (1.5 * s - 2.5), 2 - s * (4 - s * (2.5 - 0.5 * s))
        weight = np.where(s < 1, inner, np.where(s < 2, outer, 0.0)) / FINE
        for axis in range(d):  # of every node the mean of five spacings, the last read as number 5
            fine = upfirdn([0.0, *weight], fine, down=FINE, axis=axis)
        return np.asarray(fine[*(cells + 3).T])

    def given(self, rim: Rim) -> Pair:
        """Held displacements of the nodes of elements, and their mask, shape [n, d] each. Raises
        InputError for parts that differ where both are, at a corner too."""
        given, whose = np.full(rim.x.shape, np.nan), np.zeros(rim.x.shape, int)
        every = [values(rim.x[rim.nodes_of(name)]) for name, values in self.held.items()]
        largest = np.nanmax(np.abs(np.concatenate([given, *every])), initial=0.0)
        for n, (name, u) in enumerate(zip(self.held, every)):
            nodes, known = rim.nodes_of(name), np.isfinite(u)
            if name in self.pulls and known.all():
                raise InputError(f"part '{name}': expected it held or pulled, got both")
            off = np.abs(u - given[nodes])  # NaN where one is free
            if (most := np.nanmax(off, initial=0.0)) > SAME * largest:
                other = [*self.held][whose[nodes].flat[np.nanargmax(off)]]
                raise InputError(
                    f"parts '{other}', '{name}': expected one displacement where both are, got two "
                    f"that differ by {most:.3g}"
                )
            given[nodes] = np.where(known, u, given[nodes])
            whose[nodes] = np.where(known, n, whose[nodes])
        return np.nan_to_num(given), np.isfinite(given)

    def refuse_loose(self, rim: Rim, fixed: ndarray) -> None:
        """Raise InputError when displacements that are fixed, [n, d], let a piece move rigidly."""
        piece, label = pieces(rim.mesh.cells), np.zeros(len(rim.x), int)
        label[rim.basis.element_dofs] = piece[rim.cells >= 0]
        if any(loose_pieces(rim.x, label, fixed)):
            raise InputError(
                "displacement: expected parts that hold the body against shifts and turns, got "
                + (", ".join(self.held) or "none")
                + (f"; the mesh is of {piece.max() + 1} pieces" if piece.max() else "")
            )


def loads_on(
    mesh: Mesh,
    displacement: Mapping[str, Field | ArrayLike],
    traction: Mapping[str, Traction | ArrayLike] | None,
    b: Field | None,
) -> BodyLoads:
    """Make loads as functions, which raise InputError for other shapes and values not finite.
    Raises InputError for a part without faces in the mesh, or a body force that is no function."""
    there = sorted(name for name, faces in mesh.parts.items() if len(faces))

    def fields(name: str, given: Any, *of: str) -> Values:
        check_mapping(name, given)
        for part in given:
            if part not in there:
                raise InputError(f"part '{part}': the outline has {', '.join(there)}")
        return {n: _field(f"part '{n}'", one, *of, free=not of[1:]) for n, one in given.items()}

    held = fields("displacement", displacement, "positions")
    pulls = fields("traction", traction or {}, "positions", "normals")
    if b is not None:
        check_function("b", b, "positions")
        b = _field("b", b, "positions")
    return BodyLoads(held, pulls, b)


def _field(name: str, value: Field | Traction | ArrayLike, *of: str, free: bool = False) -> Any:
    """Make a function with finite values of a value, or a function of these, whose arguments are
    copies; NaN where it may be free."""
    if callable(value):
        check_function(name, value, *of)

    def answer(*where: ndarray) -> ndarray:
        given = called(f"{name}: {OF_POSITIONS}", value, *map(np.copy, where))
        vectors, shape = checked(name, given, read=False), where[0].shape
        own = shape[1:] if vectors.shape == shape[1:] else shape
        checked(name, given, float, own, ~(free & np.isnan(vectors)))
        return np.broadcast_to(vectors, shape)

    return answer
