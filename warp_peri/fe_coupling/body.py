"""Bodies with free edges at rest, and its gradient to load and material (theory, B).

A kernel that changes sign does not bear families that an edge cuts. The operator stays where its
families are whole; a rim along the outline is elasticity with the operator's own long-wave moduli.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.errors import InputError, warn
from warp_peri.fe_coupling.boundary_elements import (
    Field,
    Moduli,
    Rim,
    RimProblem,
    Traction,
    check_part,
    loads_on,
)
from warp_peri.fe_coupling.lattice_interior import (
    MARGIN,
    Bulk,
    Tried,
    bulk_lattice,
    bulk_points,
    cubic,
)
from warp_peri.fe_coupling.schwarz import Exchange, Schwarz, WholeBody
from warp_peri.materials.certificate import with_proof
from warp_peri.materials.lps import LPSMaterial, moduli
from warp_peri.materials.lps_transfer import LARGEST, model_at
from warp_peri.points.arrays import is_number
from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import largest_strain
from warp_peri.points.mesh import Mesh
from warp_peri.points.points import Points
from warp_peri.points.samples import edge_strain
from warp_peri.points.unit_names import symbols
from warp_peri.solvers.direct import definite_factors
from warp_peri.solvers.linear import STIFF
from warp_peri.solvers.solution import TOLERANCE, warn_beyond
from warp_peri.solvers.solution import Coupling as Coupling

UNTOLD = Coupling()
OVERLAP, CRYSTAL_OVERLAP = 2.0, 4.0
"""Overlap of rim and bulk where none is given: in horizons, of a crystal in spacings."""


@dataclass(frozen=True, eq=False)
class BodySolution:
    """A body in equilibrium.

    Attributes:
        model: of the bulk, on its lattice; a peridynamic solid or a crystal.
        spacing: of this lattice [Å].
        tried: lattices that were looked at, where none was asked for.
        moduli: of the rim, and of the bulk at long waves.
        rim: its elements, with their nodes `rim.x`.
        u_rim: displacement of these [Å], shape [n, d].
        points: nodes of the bulk, unknown and collar; None where elements are alone.
        u_bulk: displacement of these [Å], shape [N, d].
        overlap: of the two [Å].
        exchange: what it took, and residuals of both.
        problem: what was solved, factorised; for gradients.
    """

    model: Any
    spacing: float
    tried: tuple[Tried, ...]
    moduli: Moduli
    rim: Rim
    u_rim: np.ndarray
    points: Points | None
    u_bulk: np.ndarray
    overlap: float
    exchange: Exchange
    problem: Schwarz | RimProblem

    @property
    def rim_stress(self) -> np.ndarray:
        """σ [TPa] at the rim's nodes, shape [n, d, d]."""
        return self.rim.stress(self.moduli, self.u_rim)

    @property
    def bulk_stress(self) -> np.ndarray:
        """σ [TPa] at the unknown nodes of the bulk, shape [I, d, d]."""
        if not isinstance(self.problem, Schwarz):
            return np.zeros((0, self.rim.d, self.rim.d))
        return self.problem.bulk.stress(self.u_bulk)

    def on_corners(self) -> tuple[np.ndarray, np.ndarray]:
        """u [Å], shape [P, d], and σ [TPa], shape [P, d, d], at the mesh's corners.

        The rim's where it is, the bulk's elsewhere.
        """
        mesh = self.rim.mesh
        d = self.rim.d
        u, stress = np.empty(mesh.x.shape), np.empty((len(mesh.x), d, d))
        corner_nodes = self.rim.corner_nodes
        u[self.rim.corners] = self.u_rim[corner_nodes]
        stress[self.rim.corners] = self.rim_stress[corner_nodes]
        rest = np.setdiff1d(np.arange(len(mesh.x)), self.rim.corners)
        if len(rest) and self.points is not None:
            matrix = cubic(self.points, mesh.x[rest])
            u[rest] = matrix @ self.u_bulk[self.points.interior]
            flat = matrix @ self.bulk_stress.reshape(-1, d * d)
            stress[rest] = flat.reshape(-1, d, d)
        return u, stress

    def probe(self, x: np.ndarray) -> tuple[sp.csr_array, sp.csr_array]:
        """Matrices R and B, u(x) = R u_rim + B u_bulk, shapes [m, n] and [m, N].

        The rim's where it is, the bulk's elsewhere.

        Args:
            x: positions [Å], shape [m, d].

        Raises InputError for positions outside the mesh.
        """
        cell = self.rim.mesh.holding(x)
        if (cell < 0).any():
            raise InputError(f"x: {np.count_nonzero(cell < 0)} positions are outside the mesh")
        in_rim = self.rim.cells[cell] >= 0
        to_x = _rows(np.flatnonzero(in_rim), len(x))
        R = to_x @ self.rim.probe(x[in_rim], cell[in_rim])
        B = sp.csr_array((len(x), len(self.u_bulk)))
        if self.points is not None and not in_rim.all():
            inside = np.flatnonzero(self.points.interior)
            from_bulk = cubic(self.points, x[~in_rim]) @ _rows(inside, len(self.u_bulk)).T
            B = _rows(np.flatnonzero(~in_rim), len(x)) @ from_bulk
        return sp.csr_array(R), sp.csr_array(B)

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """u [Å] at positions of the body, both of shape [m, 2]; as `probe`."""
        R, B = self.probe(x)
        return np.asarray(R @ self.u_rim + B @ self.u_bulk)


def _rows(kept: np.ndarray, count: int) -> sp.csr_array:
    """Puts values in the rows that are kept, shape [count, len(kept)]."""
    entries = (np.ones(len(kept)), (kept, np.arange(len(kept))))
    return sp.csr_array(entries, shape=(count, len(kept)))


def solve_body(
    model: Any,
    mesh: Mesh,
    *,
    displacement: Mapping[str, Field | ArrayLike],
    traction: Mapping[str, Traction | ArrayLike] | None = None,
    b: Field | None = None,
    edge: Mapping[str, float] | None = None,
    coupling: Coupling = UNTOLD,
    allow_uncertified: bool = False,
) -> BodySolution:
    """A body in equilibrium, its outline held in part, pulled in part, free elsewhere (B1–B7).

    Args:
        model: a peridynamic solid, certified on some lattice and transferred to that of the bulk,
            in the plane; or a crystal, on its own lattice, its axes those of the mesh.
        mesh: the body [Å], triangles or tetrahedra.
        displacement: [Å] by part, vectors or functions of positions [n, 2]; NaN leaves one free.
        traction: force per area [TPa] by part, or functions of positions and outward normals.
        b: body force density [TPa/Å] as a function of positions [n, 2].
        edge: stiffness of an edge of its own [TPa Å] by part, negative where it is softer (B10);
            in the plane.
        coupling: how rim and bulk meet.
        allow_uncertified: the model's own numbers on a lattice that nothing is proven of.

    Warns of strains far beyond the data that the model was trained on.

    Raises InputError for unknown parts, other shapes, loads that are not finite, a body free to
    move, a mesh in another unit or of another dimension, a hole below the overlap, or what is not
    positive definite.
    """
    loads = loads_on(mesh, displacement, traction, b)
    springs, plane = _springs(edge or {}, mesh), isinstance(model, LPSMaterial)
    _refuse_dimension(2 if plane else model.dimension, mesh)
    tried: tuple[Tried, ...] = ()
    if plane:
        if not (model.certified_on or (allow_uncertified and coupling.spacing)):
            model = with_proof(model, coupling.spacing)
        if coupling.spacing is None:
            model, tried = bulk_lattice(model, mesh, loads.b, coupling.overlap)
        else:
            model = model_at(model, coupling.spacing, allow_uncertified=allow_uncertified)
        spacing = coupling.spacing or tried[-1].spacing
        stiff, reach, usual = long_wave(model, spacing), 2 * model.horizon, OVERLAP * model.horizon
    else:
        stiff, spacing, reach = _of_crystal(model, coupling), model.spacing, model.horizon
        usual = CRYSTAL_OVERLAP * spacing
    overlap = usual if coupling.overlap is None else coupling.overlap
    collar = max(reach + MARGIN * spacing, coupling.depth or 0.0)
    lattice = bulk_points(mesh, spacing, reach, collar, units=model.units)
    depth = mesh.distance(mesh.x, spacing / 10)
    kept = (depth < collar + overlap)[mesh.cells].any(axis=1)
    if lattice is None:
        kept[:] = True
    else:  # and cells that hold the collar
        points, cell = lattice
        kept[cell[~points.interior]] = True
    rim = Rim(mesh, kept, coupling.degree)
    f, (given, fixed) = loads.on(rim), loads.given(rim)
    loads.refuse_loose(rim, fixed)
    fixed[rim.inner] = True
    problem = RimProblem(rim.stiffness(stiff, springs), fixed.ravel())
    if min(springs.values(), default=0.0) < 0 and definite_factors(problem.inside) is None:
        raise InputError(
            "edge: with this negative stiffness the rim is not positive definite, so that its "
            "equilibria are not stable; expected a smaller size, or larger triangles at the edge"
        )
    if lattice is None or kept.all():
        deepest = depth[mesh.cells].min(axis=1).max()
        warn(_alone(model, collar + overlap, deepest, coupling))
        u_rim = problem.solve(f.ravel(), given.ravel()).reshape(f.shape)
        record = Exchange(rim_residual=problem.residual(f.ravel(), u_rim.ravel()))
        fields: Any = u_rim, None, np.zeros((0, rim.d)), overlap, record, problem
    else:
        _refuse_small_holes(mesh, overlap, symbols(model.units)[0])
        if not plane:  # the mesh lies as the nodes of the law do
            points = replace(points, axis=_axis_of(model))
        bulk = Bulk(model, points, stiff=stiff.C12 > STIFF * stiff.C44)
        elements = Rim(mesh, np.ones(len(mesh.cells), bool), degree=1)
        whole = WholeBody(elements, elements.stiffness(stiff, springs), loads, rim, depth, collar)
        to_bulk = rim.probe(points.x[bulk.collar], cell[bulk.collar])
        two = Schwarz(problem, bulk, rim.inner, cubic(points, rim.x[rim.inner]), to_bulk, whole)
        b_bulk = loads.density(points.x[bulk.inside], spacing)
        u_rim, inner, record = two.solve(f, given, b_bulk, coupling.tolerance)
        u_bulk = np.empty_like(points.x)
        u_bulk[bulk.inside], u_bulk[bulk.collar] = inner, to_bulk @ u_rim
        fields = u_rim, points, u_bulk, overlap, record, two
    solution = BodySolution(model, spacing, tried, stiff, rim, *fields)
    if plane:
        warn_beyond(model, lambda: _largest_strain(solution))
    return solution


def _refuse_dimension(dimension: int, mesh: Mesh) -> None:
    """Raise InputError for a mesh of another dimension than the law."""
    if mesh.dimension != dimension:
        kind = {2: "triangles", 3: "tetrahedra"}
        raise InputError(
            f"mesh: expected {kind[dimension]}, for a model of {dimension} dimensions, got "
            f"{kind[mesh.dimension]}"
        )


def _refuse_small_holes(mesh: Mesh, overlap: float, unit: str) -> None:
    """Raise InputError where a hole is smaller than the overlap."""
    smallest = mesh.hole_sizes.min(initial=np.inf)
    if smallest < overlap:
        raise InputError(
            f"mesh: a hole of {smallest:.3g} {unit} is smaller than the overlap of rim and bulk, "
            f"{overlap:g} {unit}"
        )


def _of_crystal(crystal: Any, coupling: Coupling) -> Moduli:
    """The long waves' moduli of a crystal; InputError for what elements cannot go on with."""
    if coupling.spacing not in (None, crystal.spacing):
        raise InputError(
            f"coupling: expected spacing {crystal.spacing:g} or None, got {coupling.spacing:g}; "
            "transferred(law, spacing) fits another"
        )
    if crystal.stress is not None and np.any(crystal.stress):
        raise InputError(
            "model: expected a crystal at rest; one under stress pulls on its free faces, which "
            "elements do not know"
        )
    C, d = crystal.tensor(), crystal.dimension
    a, c = np.triu_indices(d)
    if np.linalg.eigvalsh(C[a[:, None], c[:, None], a, c]).min() <= 0:
        raise InputError("model: expected long-wave moduli of positive energy, got some of none")
    return Moduli(C)


def _axis_of(crystal: Any) -> Any:
    """How the crystal lies on its own nodes, as points state it."""
    turn = np.asarray(crystal.orientation)
    return float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))) if len(turn) == 2 else turn


def _largest_strain(found: BodySolution) -> float:
    """Largest strain along an edge of the mesh, or between nodes of the bulk."""
    mesh = found.rim.mesh
    strain = edge_strain(mesh.x, mesh.cells, found.on_corners()[0])
    return max(strain, largest_strain(found.points, found.u_bulk)) if found.points else strain


def _alone(model: Any, needed: float, deepest: float, coupling: Coupling) -> str:
    """Why elements are alone, and what gives the lattice room.

    Args:
        model: on the lattice that was tried.
        needed: depth of a triangle without elements: two horizons, a margin and the overlap [Å].
        deepest: of the mesh's triangles [Å].
        coupling: what was asked for.
    """
    unit, plane = symbols(model.units)[0], isinstance(model, LPSMaterial)
    cell = "triangle" if model.dimension == 2 else "tetrahedron"
    cures = ["a smaller depth"] if coupling.depth is not None else []
    own, horizons = (0.0, 4) if coupling.overlap is None else (coupling.overlap, 2)
    room = (deepest - own) / (horizons * LARGEST + MARGIN)  # of kernels with the most bonds
    if room > 0 and plane:
        digits = 10.0 ** (np.floor(np.log10(room)) - 1)
        cures.insert(0, f"Coupling(spacing={np.floor(room / digits) * digits:.2g}) or less")
    cures.append(f"a body {np.ceil(11 * needed / deepest) / 10:g} times as large")
    return (
        f"mesh: no {cell} is {needed:g} {unit} from the body's edge, "
        f"{'two horizons' if plane else 'a horizon'} and the overlap (the deepest is "
        f"{deepest:.3g} {unit}); it is solved by elements alone. Room for the lattice: "
        f"{', or '.join(cures)}"
    )


def long_wave(model: LPSMaterial, spacing: float) -> Moduli:
    """The moduli of a model on its lattice; InputError unless their energy is positive."""
    stiff = Moduli.square(**moduli(model, bond_classes(spacing, model.horizon)))
    if not (stiff.C44 > 0 and stiff.C11 > abs(stiff.C12)):
        raise InputError(
            "model: expected long-wave moduli of positive energy, got C11, C12, C44 = "
            f"{stiff.C11:.4g}, {stiff.C12:.4g}, {stiff.C44:.4g} "
            f"{symbols(model.units)[1]}"
        )
    return stiff


def _springs(edge: Mapping[str, float], mesh: Mesh) -> dict[str, float]:
    """Edge stiffnesses by part, checked."""
    if edge:
        _refuse_dimension(2, mesh)
    for name, size in edge.items():
        check_part(name, mesh)
        if not (is_number(size) and np.isfinite(size)):
            raise InputError(f"edge '{name}': expected a finite stiffness, got {size!r}")
    return {name: float(size) for name, size in edge.items()}


@dataclass(frozen=True, eq=False)
class BodyGradient:
    """Derivatives of J(u), with everything else held.

    Attributes:
        lam, mu: by λ and μ of the model on its lattice [J/TPa], in the bulk and the rim's moduli.
        f: by the load on the rim's nodes [J/(TPa Å)], shape [n, 2].
        b: by the body force density at the bulk's unknown nodes [J/(TPa/Å)], shape [I, 2].
        given: by the displacement of the rim's held nodes [J/Å], shape [n, 2]; zero elsewhere.
        solution: of the body.
    """

    lam: float
    mu: float
    f: np.ndarray
    b: np.ndarray
    given: np.ndarray
    solution: BodySolution

    def along(
        self,
        *,
        displacement: Mapping[str, Field | ArrayLike] | None = None,
        traction: Mapping[str, Traction | ArrayLike] | None = None,
        b: Field | None = None,
    ) -> float:
        """dJ of a change of the loads, given as solve_body takes them.

        Raises InputError for a part that the mesh has not, and displacement where none was held.
        """
        rim, points = self.solution.rim, self.solution.points
        change = loads_on(rim.mesh, displacement or {}, traction, b)
        total = float(np.vdot(self.f, change.on(rim)))
        if points is not None:
            total += float(
                np.vdot(self.b, change.density(points.x[points.interior], points.spacing))
            )
        given, fixed = change.given(rim)
        problem = self.solution.problem
        held = ~(problem.rim if isinstance(problem, Schwarz) else problem).free.reshape(-1, 2)
        held[rim.inner] = False
        if (fixed & ~held).any():
            raise InputError("displacement: expected parts that are held, and the same components")
        return total + float(np.vdot(self.given, given))


def body_gradient(
    solution: BodySolution,
    by_rim: np.ndarray,
    by_bulk: np.ndarray | None = None,
    *,
    tolerance: float = TOLERANCE,
) -> BodyGradient:
    """Derivatives of J by loads, held displacement, λ and μ, by one adjoint solve.

    Args:
        solution: of solve_body.
        by_rim: ∂J/∂u of the rim's nodes, shape [n, 2].
        by_bulk: ∂J/∂u of the bulk's nodes, shape [N, 2]; None for none. `probe` of the solution
            turns derivatives at positions into both.
        tolerance: of the adjoint exchange.

    Raises InputError for other shapes.
    """
    model, problem = solution.model, solution.problem
    if not isinstance(model, LPSMaterial):
        raise InputError("solution: expected a body of a peridynamic solid, got one of a crystal")
    by_bulk = np.zeros_like(solution.u_bulk) if by_bulk is None else np.asarray(by_bulk, float)
    by_rim = np.asarray(by_rim, dtype=float)
    if by_rim.shape != solution.u_rim.shape or by_bulk.shape != solution.u_bulk.shape:
        raise InputError(
            f"by_rim, by_bulk: expected shapes {list(solution.u_rim.shape)} and "
            f"{list(solution.u_bulk.shape)}, got {list(by_rim.shape)} and {list(by_bulk.shape)}"
        )
    if isinstance(problem, Schwarz):
        bulk = problem.bulk
        by_rim = by_rim + problem.to_bulk.T @ by_bulk[bulk.collar]
        f, given, b = problem.transposed(by_rim, by_bulk[bulk.inside], tolerance)
        given[problem.inner] = 0  # not held: the bulk's
    else:
        f, given = (part.reshape(-1, 2) for part in problem.transposed(by_rim.ravel()))
        b = np.zeros((0, 2))
    # −(w · ∂K u + v · ∂L u) by λ and μ, of which K and L are homogeneous of degree one (B14)
    here = _work(solution, model, f, b)
    further = _work(solution, replace(model, lam=model.lam + model.mu), f, b)
    by_lam = (further - here) / model.mu
    return BodyGradient(-by_lam, -(here - model.lam * by_lam) / model.mu, f, b, given, solution)


def _work(solution: BodySolution, model: LPSMaterial, f: np.ndarray, b: np.ndarray) -> float:
    """w · K u + v · L u with the λ and μ of a model."""
    K = solution.rim.stiffness(long_wave(model, solution.spacing))
    total = float(np.vdot(f, K @ solution.u_rim.ravel()))
    if solution.points is not None:
        force = model.on(solution.points, allow_uncertified=True)(solution.u_bulk)
        total += float(np.vdot(b, force))
    return total
