"""Elements at the rim of a body, and what is given there: tractions, held parts, loads (B1–B3)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.ndimage import binary_dilation
from scipy.sparse.linalg import splu

from warp_peri.errors import InputError, optional
from warp_peri.points.arrays import checked
from warp_peri.points.mesh import Mesh, pieces

Field = Callable[[np.ndarray], np.ndarray]
"""Vectors, shape [n, d], at positions [Å], shape [n, d]."""
Traction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Force per area [TPa], shape [n, d], at positions and outward normals, each of shape [n, d]."""


@dataclass(frozen=True, eq=False)
class Moduli:
    """C_ijkl [stress] of an elastic solid, shape [d, d, d, d]."""

    tensor: np.ndarray

    @classmethod
    def square(cls, C11: float, C12: float, C44: float) -> Moduli:
        """Of a sheet whose axes are those of a square lattice."""
        C = np.zeros((2, 2, 2, 2))
        for a in (0, 1):
            C[a, a, a, a], C[a, a, 1 - a, 1 - a] = C11, C12
            C[a, 1 - a, a, 1 - a] = C[a, 1 - a, 1 - a, a] = C44
        return cls(C)

    @property
    def C11(self) -> float:
        return float(self.tensor[0, 0, 0, 0])

    @property
    def C12(self) -> float:
        return float(self.tensor[0, 0, 1, 1])

    @property
    def C44(self) -> float:
        """The shear modulus of the first two axes."""
        return float(self.tensor[0, 1, 0, 1])

    def stress(self, gradient: np.ndarray) -> np.ndarray:
        """σ [stress] of displacement gradients, both of shape [..., d, d]."""
        return np.asarray(np.einsum("ijkl,...kl->...ij", self.tensor, gradient))


def finite_elements() -> Any:
    """scikit-fem; InputError where it is not installed."""
    return optional("skfem", "scikit-fem is not installed: pip install 'warp_peri[bodies]'")


MOST_STEPS, FOUND = 30, 1e-11
"""Of Newton's method for a position in a cell, and a step of it that is none."""


class Rim:
    """Some cells of a mesh as elements of degree 1, or of degree 2 and curved at the outline.

    Node i has the displacements d i to d i + d − 1.

    Args:
        mesh: of the body, triangles or tetrahedra.
        kept: cells of the rim, shape [T] bool.
        degree: of the elements.
    """

    def __init__(self, mesh: Mesh, kept: np.ndarray, degree: int = 2) -> None:
        fem, self.d = finite_elements(), mesh.dimension
        corners, cells = np.unique(mesh.cells[kept], return_inverse=True)
        cells = cells.reshape(-1, self.d + 1)
        kinds = {
            2: (fem.MeshTri, fem.MeshTri2, fem.ElementTriP1, fem.ElementTriP2),
            3: (fem.MeshTet, fem.MeshTet2, fem.ElementTetP1, fem.ElementTetP2),
        }
        make, bent, *elements = kinds[self.d]
        shape = straight = make(mesh.x[corners].T.copy(), cells.T.copy())
        place = np.full(len(mesh.x), -1)
        place[corners] = np.arange(len(corners))
        self.facets = _columns(place[mesh.faces], straight.facets)
        if degree == 2 and len(mesh.curved):
            shape = bent.from_mesh(straight)
            positions = shape.doflocs.copy()
            plane = self.d == 2
            edge = _columns(place[mesh.curved], straight.facets if plane else straight.edges)
            dofs = shape.dofs.facet_dofs if plane else shape.dofs.edge_dofs
            positions[:, dofs[0, edge[edge >= 0]]] = mesh.middle[edge >= 0].T
            shape = replace(shape, doflocs=positions)
        self.mesh, self.corners = mesh, corners
        self.cells = np.full(len(mesh.cells), -1)
        self.cells[kept] = np.arange(len(cells))
        self.element = elements[degree - 1]()
        self.order = 2 * degree + 2
        self.basis = fem.Basis(shape, self.element, intorder=self.order)
        self.x = np.asarray(self.basis.doflocs.T)
        self.inner = self._nodes(np.setdiff1d(straight.boundary_facets(), self.facets))
        self._fem = fem
        self._squares = {
            (a, c): self._product(self.basis, lambda u, v, w, a=a, c=c: v.grad[a] * u.grad[c])
            for a, c in itertools.combinations_with_replacement(range(self.d), 2)
        }

    def _product(self, basis: Any, form: Callable[..., Any]) -> sp.csr_array:
        return sp.csr_array(self._fem.BilinearForm(form).assemble(basis))

    def _nodes(self, facets: np.ndarray) -> np.ndarray:
        return np.asarray(self.basis.get_dofs(facets).flatten(), dtype=int)

    @property
    def corner_nodes(self) -> np.ndarray:
        """Nodes at the mesh's corners `corners`, in their order."""
        return np.asarray(self.basis.nodal_dofs[0])

    def nodes_of(self, part: str) -> np.ndarray:
        """Nodes on a named part of the outline."""
        return self._nodes(self.facets[self.mesh.parts[part]])

    def stiffness(self, moduli: Moduli, springs: Mapping[str, float] | None = None) -> sp.csr_array:
        """K [stress], shape [d n, d n], linear in the moduli (B2).

        Args:
            moduli: of the elements.
            springs: stiffness E_s of an edge of its own by part of the outline, its force over its
                strain and the sheet's thickness [stress · length]: ∫ E_s (τ · ε(v) τ) (τ · ε(u) τ)
                (B10); in the plane.
        """
        C = moduli.tensor
        K = sum(sp.kron(square, C[:, a, :, c]) for (a, c), square in self._squares.items())
        K += sum(
            sp.kron(square.T, C[:, c, :, a]) for (a, c), square in self._squares.items() if a != c
        )
        for part, size in (springs or {}).items():
            for a, c in itertools.product(range(2), repeat=2):

                def form(u: Any, v: Any, w: Any, a: int = a, c: int = c, size: float = size) -> Any:
                    along = (-w.n[1], w.n[0])
                    slopes = [along[0] * z.grad[0] + along[1] * z.grad[1] for z in (u, v)]
                    return size * along[a] * along[c] * slopes[0] * slopes[1]

                there = np.outer(np.arange(2) == a, np.arange(2) == c)
                K += sp.kron(self._product(self._facets(part), form), there)
        return sp.csr_array(K)

    def body_force(self, b: Field) -> np.ndarray:
        """∫ b · φ [TPa Å], shape [n, d], of a body force density [TPa/Å]."""
        return self._integrals(self.basis, lambda w: b(_points(w.x)))

    def traction(self, part: str, t: Traction) -> np.ndarray:
        """∫ t · φ [TPa Å], shape [n, d], of a force per area [TPa] on a part of the outline."""
        return self._integrals(self._facets(part), lambda w: t(_points(w.x), _points(w.n)))

    def _facets(self, part: str) -> Any:
        facets = self.facets[self.mesh.parts[part]]
        shape = self.basis.mesh
        return self._fem.FacetBasis(shape, self.element, facets=facets, intorder=self.order)

    def _integrals(self, basis: Any, vectors: Callable[[Any], np.ndarray]) -> np.ndarray:
        columns = []
        for a in range(self.d):
            component = lambda v, w, a=a: vectors(w)[:, a].reshape(w.x.shape[1:]) * v  # noqa: E731
            columns.append(self._fem.LinearForm(component).assemble(basis))
        return np.stack(columns, axis=1)

    def probe(self, x: np.ndarray, holding: np.ndarray) -> sp.csr_array:
        """Matrix from values at the nodes to values at points, shape [m, n].

        Args:
            x: positions [Å], shape [m, d].
            holding: number of the mesh's cell that holds each, one of the rim's.
        """
        cells = self.cells[holding]
        local = self._places(x, cells)
        values, columns = [], []
        for k in range(self.basis.Nbfun):
            value = self.element.gbasis(self.basis.mapping, local, k, tind=cells)[0]
            values.append(np.asarray(value).reshape(len(x)))
            columns.append(self.basis.element_dofs[k, cells])
        rows = np.tile(np.arange(len(x)), self.basis.Nbfun)
        entries = (np.concatenate(values), (rows, np.concatenate(columns)))
        return sp.csr_array(sp.coo_array(entries, shape=(len(x), len(self.x))))

    def _places(self, x: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """Positions in the coordinates of their cells, shape [d, m, 1], by Newton's method.

        A position next to a curved face may lie a little outside of the cell that held it.
        """
        mapping, goal = self.basis.mapping, x.T[:, :, None]
        places = np.full(goal.shape, 1 / (self.d + 1))
        for _ in range(MOST_STEPS):
            left = goal - mapping.F(places, tind=cells)
            step = np.einsum("ijkl,jkl->ikl", mapping.invDF(places, tind=cells), left)
            places = places + step
            if np.abs(step).max(initial=0.0) < FOUND:
                return np.asarray(places)
        raise InputError("mesh: expected curved cells that are one-to-one, some are folded")

    def stress(self, moduli: Moduli, u: np.ndarray) -> np.ndarray:
        """σ [TPa] at the nodes, shape [n, d, d]: means over the elements that meet there.

        In each element it is the linear field through its values at d + 1 places inside. Those are
        more accurate than values at nodes, above all in elements with curved sides.
        """
        basis = self._fem.Basis(self.basis.mesh, self.element, intorder=2)
        rows = [basis.interpolate(np.ascontiguousarray(u[:, a])).grad for a in range(self.d)]
        gradient = np.moveaxis(np.stack([np.asarray(row) for row in rows]), (0, 1), (-2, -1))
        inside = moduli.stress(gradient).reshape(*gradient.shape[:2], -1)
        x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
        middle = x.mean(axis=1, keepdims=True)
        slope = np.linalg.pinv(x - middle) @ inside  # [elements, d, d²]
        each = inside.mean(axis=1, keepdims=True)
        each = each + (self.x[self.basis.element_dofs.T] - middle) @ slope
        owner = self.basis.element_dofs.T.ravel()
        count = np.bincount(owner, minlength=len(self.x))
        flat = each.reshape(len(owner), -1)
        sums = [np.bincount(owner, column, len(self.x)) / count for column in flat.T]
        return np.stack(sums, axis=1).reshape(-1, self.d, self.d)


class RimProblem:
    """K u = f with some displacements given, factorised once.

    Args:
        K: stiffness [TPa], shape [d n, d n].
        fixed: given displacements, shape [d n] bool.
    """

    def __init__(self, K: sp.csr_array, fixed: np.ndarray) -> None:
        self.free = ~fixed
        rows = K[self.free]
        self.inside = sp.csc_array(rows[:, self.free])
        self.given = sp.csr_array(rows[:, fixed])
        self.factors = splu(self.inside, permc_spec="MMD_AT_PLUS_A")

    def solve(self, f: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Displacement [Å] from a load [TPa Å] and what is given, each of shape [d n]."""
        u = given.copy()
        u[self.free] = self.factors.solve(f[self.free] - self.given @ given[~self.free])
        return u

    def transposed(self, by_u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The transpose of `solve`, which is linear: derivatives by f and by what is given."""
        by_f, by_given = np.zeros_like(by_u), np.zeros_like(by_u)
        by_f[self.free] = self.factors.solve(by_u[self.free], "T")
        by_given[~self.free] = by_u[~self.free] - self.given.T @ by_f[self.free]
        return by_f, by_given

    def residual(self, f: np.ndarray, u: np.ndarray) -> float:
        """‖K u − f‖ over ‖f − K of what is given‖ on the free displacements."""
        right = f[self.free] - self.given @ u[~self.free]
        left = right - self.inside @ u[self.free]
        size = float(np.linalg.norm(right))
        return float(np.linalg.norm(left)) / size if size else 0.0


def _columns(asked: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Column of `there` [k, m] with the numbers of each row of `asked` [n, k], −1 for none."""
    size = (there.max() + 1) ** np.arange(len(there))
    known, keys = size @ np.sort(there, axis=0), np.sort(asked, axis=1) @ size
    order = np.argsort(known)
    found = order[np.minimum(np.searchsorted(known[order], keys), len(order) - 1)]
    return np.where((known[found] == keys) & (asked >= 0).all(axis=1), found, -1)


def _points(field: Any) -> np.ndarray:
    """[d, elements, places] as [n, d]."""
    return np.moveaxis(np.asarray(field), 0, -1).reshape(-1, len(field))


FINE = 4
"""Places in a spacing, on either axis, where the density is read for a lattice."""


@dataclass(frozen=True)
class BodyLoads:
    """Displacement and traction by part of the outline, and a body force.

    Attributes:
        held: displacement [Å] as functions of positions; NaN leaves a component free.
        pulls: force per area [TPa] as functions of positions and outward normals.
        b: body force density [TPa/Å] as a function of positions; None for none.
    """

    held: Mapping[str, Field]
    pulls: Mapping[str, Traction]
    b: Field | None

    def on(self, rim: Rim) -> np.ndarray:
        """Load of tractions and the body force on the nodes of elements [TPa Å], shape [n, d]."""
        f = np.zeros_like(rim.x) if self.b is None else rim.body_force(self.b)
        for name, pull in self.pulls.items():
            f += rim.traction(name, pull)
        return f

    def density(self, x: np.ndarray, spacing: float) -> np.ndarray:
        """The body force density [TPa/Å] that nodes of a lattice feel, both of shape [n, d].

        Its mean around a node (B16), by weights that add up to one over the nodes and
        leave quadratic fields as they are: no force is lost between nodes, and what changes from
        triangle to triangle is not taken for a long wave. It is read up to 2.5 spacings away.

        x: along the axes, so that they lie on a lattice of the spacing [Å].
        """
        if self.b is None:
            return np.zeros_like(x)
        cells = np.rint((x - x.min(axis=0)) / spacing).astype(int) + 2
        d = x.shape[1]
        near = np.zeros(cells.max(axis=0) + 3, bool)
        near[tuple(cells.T)] = True
        near = binary_dilation(near, np.ones((5,) * d))
        places = np.argwhere(np.kron(near, np.ones((FINE,) * d, bool)))
        at = x.min(axis=0) + spacing * ((places + 0.5) / FINE - 2.5)
        fine = np.zeros((*(FINE * np.array(near.shape)), d))
        fine[tuple(places.T)] = self.b(at)
        s = np.abs((np.arange(5 * FINE) + 0.5) / FINE - 2.5)
        inner, outer = 1 + s**2 * (1.5 * s - 2.5), 2 - s * (4 - s * (2.5 - 0.5 * s))
        weight = np.where(s < 1, inner, np.where(s < 2, outer, 0.0)) / FINE
        felt, count = fine, np.array(near.shape) - 4
        for span in FINE * count:  # axis by axis, each to the end of the line when it is done
            felt = np.moveaxis(
                sum(w * felt[n : n + span : FINE] for n, w in enumerate(weight)), 0, d - 1
            )
        there: np.ndarray = felt[tuple((cells - 2).T)]
        return there

    def given(self, rim: Rim) -> tuple[np.ndarray, np.ndarray]:
        """Held displacements of the nodes of elements, and which they are, shape [n, d] each."""
        given, fixed = np.zeros_like(rim.x), np.zeros(rim.x.shape, bool)
        for name, values in self.held.items():
            nodes = rim.nodes_of(name)
            there = values(rim.x[nodes])
            known = np.isfinite(there)
            if name in self.pulls and known.all():
                raise InputError(f"part '{name}': expected it held or pulled, got both")
            if (fixed[nodes] & known & (there != given[nodes])).any():
                parts, own = rim.mesh.parts, rim.mesh.parts[name]
                for other in (one for one in (*self.held,) if one != name):
                    if np.intersect1d(own, parts[other]).size:  # corners may jump
                        raise InputError(
                            f"parts '{other}', '{name}': expected one displacement where both are"
                        )
            given[nodes] = np.where(known, there, given[nodes])
            fixed[nodes] |= known
        return given, fixed

    def refuse_loose(self, rim: Rim, fixed: np.ndarray) -> None:
        """Raise InputError when displacements that are fixed, [n, d], let a piece move rigidly."""
        piece = pieces(rim.mesh.cells)[rim.cells >= 0]
        for number in np.unique(piece):
            nodes = np.unique(rim.basis.element_dofs[:, piece == number])
            centred = rim.x[nodes] - rim.x[nodes].mean(axis=0)
            size = np.abs(centred).max()
            motions = [np.broadcast_to(v, centred.shape) for v in np.eye(rim.d)]
            for a, c in itertools.combinations(range(rim.d), 2):
                turn = np.zeros_like(centred)
                turn[:, a], turn[:, c] = -centred[:, c] / size, centred[:, a] / size
                motions.append(turn)
            held_motions = np.stack([motion[fixed[nodes]] for motion in motions], axis=1)
            if np.linalg.matrix_rank(held_motions, tol=1e-6) < len(motions):
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
    """Loads as functions, which raise InputError for other shapes and what is not finite.

    Raises InputError for a part that the mesh has not, or a body force that is no function.
    """
    for name, given in (("displacement", displacement), ("traction", traction or {})):
        if not isinstance(given, Mapping):
            raise InputError(
                f"{name}: expected values by part, as {{'left': (0, 0)}}, got {given!r:.40}"
            )
    for name in (*displacement, *(traction or {})):
        check_part(name, mesh)
    held = {
        name: _field(f"part '{name}'", value, free=True) for name, value in displacement.items()
    }
    pulls = {name: _field(f"part '{name}'", value) for name, value in (traction or {}).items()}
    if b is not None and not callable(b):
        raise InputError(f"b: expected a function of positions [n, 2], got {b!r:.60}")
    return BodyLoads(held, pulls, None if b is None else _field("b", b))


def check_part(name: str, mesh: Mesh) -> None:
    """Raise InputError unless the outline has a part of this name."""
    if name not in mesh.parts:
        raise InputError(f"part '{name}': the outline has {', '.join(sorted(mesh.parts))}")


def _field(name: str, value: Field | Traction | ArrayLike, *, free: bool = False) -> Any:
    """A value as a function that answers with finite vectors of the right shape.

    Args:
        name: of it in messages.
        value: vectors, or a function of positions, and of normals where it is a traction.
        free: NaN is taken, for a component that is not held.
    """

    def answer(*where: np.ndarray) -> np.ndarray:
        given = value(*where) if callable(value) else value
        vectors = checked(name, given, read=False)
        vectors = checked(name, given, read=~(free & np.isnan(vectors)))
        if vectors.shape == where[0].shape[1:]:
            vectors = np.broadcast_to(vectors, where[0].shape)
        if vectors.shape != where[0].shape:
            raise InputError(
                f"{name}: expected vectors of shape {list(where[0].shape)}, got shape "
                f"{list(np.shape(given))}" + (f" ({given!r:.40})" if np.ndim(given) == 0 else "")
            )
        return vectors

    return answer
