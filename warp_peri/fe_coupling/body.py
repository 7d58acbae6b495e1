"""Equilibria of bodies with free edges, and their gradients to load and material (theory, B).

The operator stays where its families are whole; a rim along the outline is elasticity with the
operator's own long-wave moduli.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy import ndarray
from numpy.linalg import eigvalsh
from numpy.typing import ArrayLike

from warp_peri.errors import InputError, warn
from warp_peri.fe_coupling.boundary_elements import (
    Field,
    Moduli,
    Rim,
    RimProblem,
    Traction,
    loads_on,
)
from warp_peri.fe_coupling.schwarz import (
    MARGIN,
    Bulk,
    Exchange,
    Schwarz,
    Tried,
    bulk_lattice,
    bulk_points,
    check_extent,
    collar_and_overlap,
    cubic,
    in_elements,
)
from warp_peri.materials.certificate import with_proof
from warp_peri.materials.lps import LPSMaterial, moduli
from warp_peri.materials.transfer import model_at
from warp_peri.points.arguments import Pair, Share, checked, symbols, typed
from warp_peri.points.families import bond_classes, largest_strain
from warp_peri.points.mesh import Mesh
from warp_peri.points.points import Points
from warp_peri.solvers.solution import TOLERANCE, warn_beyond
from warp_peri.solvers.solution import Coupling as Coupling

UNTOLD = Coupling()


@dataclass(frozen=True, eq=False)
class BodySolution:
    """Body in equilibrium.

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
        exchange: record of the iterations, and residuals of both.
        problem: the factorised problem, for gradients.
    """

    model: Any
    spacing: float
    tried: tuple[Tried, ...]
    moduli: Moduli
    rim: Rim
    u_rim: ndarray
    points: Points | None
    u_bulk: ndarray
    overlap: float
    exchange: Exchange
    problem: Schwarz | RimProblem

    @property
    def rim_stress(self) -> ndarray:
        """Stress σ [TPa] at the rim's nodes, shape [n, d, d]."""
        return self.rim.stress(self.moduli, self.u_rim)

    @property
    def bulk_stress(self) -> ndarray:
        """Stress σ [TPa] at the unknown nodes of the bulk, shape [I, d, d]."""
        if not isinstance(self.problem, Schwarz):
            return np.zeros((0, self.rim.d, self.rim.d))
        return np.asarray(self.problem.bulk.stress(self.u_bulk))

    def on_corners(self) -> Pair:
        """Displacement [Å], [P, d], and stress [TPa], [P, d, d], at the mesh's corners."""
        rim, d, count = self.rim, self.rim.d, len(self.rim.mesh.x)
        u, stress, rest = np.empty((count, d)), np.empty((count, d, d)), np.ones(count, bool)
        u[rim.corners] = self.u_rim[rim.corner_nodes]
        stress[rim.corners] = self.rim_stress[rim.corner_nodes]
        rest[rim.corners] = False
        if rest.any() and self.points is not None:
            matrix = cubic(self.points, rim.mesh.x[rest])
            u[rest] = matrix @ self.u_bulk[self.points.interior]
            stress[rest] = (matrix @ self.bulk_stress.reshape(-1, d * d)).reshape(-1, d, d)
        return u, stress

    def probe(self, x: ArrayLike) -> tuple[sp.csr_array, sp.csr_array]:
        """Matrices R [m, n] and B [m, N] with u(x) = R u_rim + B u_bulk at positions x [m, d]. The
        rim's where it is, the bulk's elsewhere; InputError outside the mesh, or for none."""
        x = checked("x", x, float, ("m", self.rim.d))
        cell = self.rim.mesh.holding(x)
        if (cell < 0).any():
            raise InputError(f"x: {np.count_nonzero(cell < 0)} positions are outside the mesh")
        in_rim, to_x = self.rim.cells[cell] >= 0, sp.csc_array(sp.eye_array(len(x)))
        R = to_x[:, in_rim] @ self.rim.probe(x[in_rim], cell[in_rim])
        B = sp.csr_array((len(x), len(self.u_bulk)))
        if self.points is not None and not in_rim.all():
            unknown = sp.csr_array(sp.eye_array(len(self.u_bulk)))[self.points.interior]
            B = to_x[:, ~in_rim] @ cubic(self.points, x[~in_rim]) @ unknown
        return sp.csr_array(R), sp.csr_array(B)

    def displacement(self, x: ArrayLike) -> ndarray:
        """Displacement [Å] at positions of the body, both of shape [m, 2]; as `probe`."""
        R, B = self.probe(x)
        return np.asarray(R @ self.u_rim + B @ self.u_bulk)


def solve_body(
    model: Any,
    mesh: Mesh,
    *,
    displacement: Mapping[str, Field | ArrayLike],
    traction: Mapping[str, Traction | ArrayLike] | None = None,
    b: Field | None = None,
    coupling: Coupling = UNTOLD,
    allow_uncertified: bool = False,
) -> BodySolution:
    """Solve a problems.Body, with its errors (B1–B7): of a peridynamic solid in the plane, which is
    certified on some lattice and transferred to that of the bulk unless its own parameters are
    allowed there, or of a crystal on its own. Warns of strains far beyond the training data."""
    loads = loads_on(mesh, displacement, traction, b)
    model, stiff, spacing, tried = _on_lattice(model, mesh, loads.b, coupling, allow_uncertified)
    reach, overlap = collar_and_overlap(model, model.horizon, coupling)
    collar = max(reach + MARGIN * spacing, coupling.depth or 0.0)
    lattice = bulk_points(mesh, spacing, reach, collar, units=model.units)
    depth = mesh.distance(mesh.x, spacing / 10)
    kept = (depth < collar + overlap)[mesh.cells].any(axis=1) | (lattice is None)
    if lattice is not None:  # and cells that hold the collar
        kept[lattice[1][~lattice[0].interior]] = True
    rim = Rim(mesh, kept, coupling.degree)
    f, (given, fixed) = loads.on(rim), loads.given(rim)
    loads.refuse_loose(rim, fixed)
    fixed[rim.inner] = True
    problem = RimProblem(rim.stiffness(stiff), fixed.ravel())
    if lattice is None or kept.all():
        warn(_alone(model, collar + overlap, depth[mesh.cells].min(axis=1).max()))
        u_rim = (problem @ np.append(f, given)).reshape(f.shape)
        record = Exchange(rim_residual=problem.residual(f.ravel(), u_rim.ravel()))
        fields: Any = u_rim, None, np.zeros((0, rim.d)), overlap, record, problem
    else:
        if (hole := mesh.hole_sizes.min(initial=np.inf)) < overlap:
            unit = symbols(model.units)[0]
            raise InputError(
                f"mesh: a hole of {hole:.3g} {unit} is smaller than the overlap of rim and bulk, "
                f"{overlap:g} {unit}"
            )
        points, cell = lattice
        if not isinstance(model, LPSMaterial):  # the mesh lies as the nodes of the law do
            turn = model.orientation
            angle = np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
            points = replace(points, axis=float(angle) if len(turn) == 2 else turn)
        bulk = Bulk(model, points)
        two = Schwarz(rim, problem, bulk, cell, in_elements(stiff, loads, rim, depth < collar))
        b_bulk = loads.density(points.x[bulk.inside], spacing)
        u_rim, u_bulk, record = two.solve(f, given, b_bulk, coupling.tolerance)
        fields = u_rim, points, u_bulk, overlap, record, two
    solution = BodySolution(model, spacing, tried, stiff, rim, *fields)
    if isinstance(model, LPSMaterial):
        warn_beyond(model, lambda: _largest_strain(solution))
    return solution


def _on_lattice(
    model: Any, mesh: Mesh, b: Field | None, coupling: Coupling, allow_uncertified: bool
) -> tuple[Any, Moduli, float, tuple[Tried, ...]]:
    """Model on the bulk's lattice, its long-wave moduli, the spacing, and the lattices tried."""
    spacing, tried, plane = coupling.spacing, tuple[Tried, ...](), isinstance(model, LPSMaterial)
    if mesh.dimension != (dimension := 2 if plane else model.dimension):
        kind = {2: "triangles", 3: "tetrahedra"}
        raise InputError(
            f"mesh: expected {kind[dimension]}, for a model of {dimension} dimensions, got "
            f"{kind[mesh.dimension]}"
        )
    if not plane:
        if spacing not in (None, model.spacing):
            raise InputError(
                f"coupling: expected spacing {model.spacing:g} or None, got {spacing:g}; "
                "transfer_to_lattice(law, spacing) fits another"
            )
        if model.stress is not None and np.any(model.stress):
            raise InputError(
                "model: expected a crystal at rest; elements do not know the stress of another"
            )
        return model, long_wave(model, model.spacing), model.spacing, tried
    if spacing is not None:
        check_extent(mesh, spacing, model.units)
    if not (model.certified_on or (allow_uncertified and spacing)):
        model = with_proof(model, spacing)
    if spacing is None:
        model, tried = bulk_lattice(model, mesh, b, coupling)
        spacing = tried[-1].spacing
    else:
        model = model_at(model, spacing, allow_uncertified=allow_uncertified)
    return model, long_wave(model, spacing), spacing, tried


def _alone(model: Any, needed: float, deepest: float) -> str:
    """Explain why elements are alone, and what gives the lattice room; depths of cells, [Å]."""
    unit, cell = symbols(model.units)[0], "triangle" if model.dimension == 2 else "tetrahedron"
    return (
        f"mesh: no {cell} is {needed:g} {unit} from the body's edge, the collar and the overlap "
        f"(the deepest is {deepest:.3g} {unit}); it is solved by elements alone. Room for the "
        "lattice: a smaller spacing, overlap or depth in Coupling(…), or a larger body"
    )


def long_wave(model: Any, spacing: float) -> Moduli:
    """Moduli of a model's long waves on its lattice; InputError unless their energy is positive."""
    if isinstance(model, LPSMaterial):
        found = Moduli.square(**moduli(model, bond_classes(spacing, model.horizon)))
    else:
        found = Moduli(model.tensor())
    a, c = np.triu_indices(model.dimension)
    if (least := eigvalsh(found.tensor[a[:, None], c[:, None], a, c]).min()) <= 0:
        raise InputError(
            f"model: expected positive long-wave moduli, got {least:.4g} {symbols(model.units)[1]}"
        )
    return found


def _largest_strain(found: BodySolution) -> float:
    """Largest strain along an edge of the mesh, or between nodes of the bulk."""
    mesh = found.rim.mesh
    ends = mesh.cells[:, [0, 1, 2, 0]]
    xi, moved = (np.diff(of[ends], axis=1) for of in (mesh.x, found.on_corners()[0]))
    strain = float(np.abs((xi * moved).sum(axis=-1) / (xi**2).sum(axis=-1)).max())
    return max(strain, largest_strain(found.points, found.u_bulk)) if found.points else strain


@dataclass(frozen=True, eq=False)
class BodyGradient:
    """Derivatives of a function J of a body's displacement by its loads and material.

    Attributes:
        lam, mu: by λ and μ of the model on its lattice [J/TPa], in the bulk and the rim's moduli.
        f: by the load on the rim's nodes [J/(TPa Å)], shape [n, 2].
        b: by the body force density at the bulk's unknown nodes [J/(TPa/Å)], shape [I, 2].
        given: by the displacement of the rim's held nodes [J/Å], shape [n, 2]; zero elsewhere.
        solution: of the body.
    """

    lam: float
    mu: float
    f: ndarray
    b: ndarray
    given: ndarray
    solution: BodySolution

    def along(
        self,
        *,
        displacement: Mapping[str, Field | ArrayLike] | None = None,
        traction: Mapping[str, Traction | ArrayLike] | None = None,
        b: Field | None = None,
    ) -> float:
        """Derivative dJ along a change of the loads, given as solve_body takes them. Raises
        InputError for a part that the mesh has not, and displacement where none was held."""
        rim, points, problem = self.solution.rim, self.solution.points, self.solution.problem
        change = loads_on(rim.mesh, displacement or {}, traction, b)
        total = np.vdot(self.f, change.on(rim))
        if points is not None:
            total += np.vdot(self.b, change.density(points.x[points.interior], points.spacing))
        given, fixed = change.given(rim)
        held = ~(problem.rim if isinstance(problem, Schwarz) else problem).free.reshape(-1, 2)
        held[rim.inner] = False
        if (fixed & ~held).any():
            raise InputError("displacement: expected parts that are held, and the same components")
        return float(total + np.vdot(self.given, given))


@typed
def body_gradient(
    solution: BodySolution, x: ArrayLike, by_u: ArrayLike, *, tolerance: Share = TOLERANCE
) -> BodyGradient:
    """Derivatives of J by loads, held displacement, λ and μ, by one adjoint solve.

    J depends on the displacement at positions x of the body [Å], with ∂J/∂u = by_u there [J/Å],
    both [m, 2]. Raises InputError for other shapes, and positions outside the mesh.
    """
    model, problem = solution.model, solution.problem
    if not isinstance(model, LPSMaterial):
        raise InputError("solution: expected a body of a peridynamic solid, got one of a crystal")
    R, B = solution.probe(x)
    by_rim, by_bulk = (one.T @ checked("by_u", by_u, float, (R.shape[0], 2)) for one in (R, B))
    if isinstance(problem, Schwarz):
        f, given, b = problem.transposed(by_rim, by_bulk, tolerance)
    else:
        (f, given), b = (problem.T @ by_rim.ravel()).reshape(2, -1, 2), by_bulk
    # −(w · ∂K u + v · ∂L u) by λ and μ, of which K and L are homogeneous of degree one (B14)
    here = _work(solution, model, f, b)
    by_lam = (_work(solution, replace(model, lam=model.lam + model.mu), f, b) - here) / model.mu
    return BodyGradient(-by_lam, -(here - model.lam * by_lam) / model.mu, f, b, given, solution)


def _work(solution: BodySolution, model: LPSMaterial, f: ndarray, b: ndarray) -> float:
    """Virtual work w · K u + v · L u with the λ and μ of a model."""
    K = solution.rim.stiffness(long_wave(model, solution.spacing))
    total = np.vdot(f, K @ solution.u_rim.ravel())
    if solution.points is not None:
        total += np.vdot(b, model.on(solution.points, allow_uncertified=True)(solution.u_bulk))
    return float(total)
