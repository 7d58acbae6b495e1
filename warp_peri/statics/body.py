"""Bodies with holes, notches and free edges: elements at the outline, the learned operator inside.

A kernel that changes sign does not bear families that an edge cuts. The operator stays where its
families are whole; a rim along the outline is elasticity with the operator's own long-wave moduli.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.operator.stress import node_fields
from warp_peri.operator.symbol import moduli
from warp_peri.points.families import bond_classes
from warp_peri.points.mesh import Mesh
from warp_peri.points.points import Points
from warp_peri.statics.bulk import MARGIN, Bulk, bulk_points, cubic
from warp_peri.statics.rim import Field, Moduli, Rim, RimProblem, Traction
from warp_peri.statics.schwarz import Exchange, Schwarz
from warp_peri.transfer.kept import model_at

OVERLAP = 2.0
"""Overlap of rim and bulk where none is given, in horizons."""
TOLERANCE = 1e-8


@dataclass(frozen=True)
class Coupling:
    """How rim and bulk meet.

    Attributes:
        spacing: of the bulk's lattice [Å]; None for one that the model is certified on.
        overlap: width of what both solve for [Å]; None for two horizons.
        degree: 2 for quadratic elements, curved at the outline; 1 for linear ones.
        tolerance: of the mismatch on the rim's inner side.
    """

    spacing: float | None = None
    overlap: float | None = None
    degree: int = 2
    tolerance: float = TOLERANCE


@dataclass(frozen=True, eq=False)
class BodySolution:
    """A body in equilibrium.

    Attributes:
        model: of the bulk, on its lattice.
        moduli: of the rim, and of the bulk at long waves.
        rim: its elements, with their nodes `rim.x`.
        u_rim: displacement of these [Å], shape [n, 2].
        points: nodes of the bulk, unknown and collar; None where elements are alone.
        u_bulk: displacement of these [Å], shape [N, 2].
        overlap: of the two [Å].
        exchange: what it took, and residuals of both.
    """

    model: Model
    moduli: Moduli
    rim: Rim
    u_rim: np.ndarray
    points: Points | None
    u_bulk: np.ndarray
    overlap: float
    exchange: Exchange

    @property
    def rim_stress(self) -> np.ndarray:
        """σ [TPa] at the rim's nodes, shape [n, 2, 2]."""
        return self.rim.stress(self.moduli, self.u_rim)

    @property
    def bulk_stress(self) -> np.ndarray:
        """σ [TPa] at the unknown nodes of the bulk, shape [I, 2, 2]."""
        if self.points is None:
            return np.zeros((0, 2, 2))
        return np.asarray(node_fields(self.model, self.points, self.u_bulk).stress[0])

    def on_corners(self) -> tuple[np.ndarray, np.ndarray]:
        """u [Å], shape [P, 2], and σ [TPa], shape [P, 2, 2], at the mesh's corners.

        The rim's where it is, the bulk's elsewhere.
        """
        mesh = self.rim.mesh
        u, stress = np.empty((len(mesh.x), 2)), np.empty((len(mesh.x), 2, 2))
        corner_nodes = self.rim.corner_nodes
        u[self.rim.corners] = self.u_rim[corner_nodes]
        stress[self.rim.corners] = self.rim_stress[corner_nodes]
        rest = np.setdiff1d(np.arange(len(mesh.x)), self.rim.corners)
        if len(rest) and self.points is not None:
            matrix = cubic(self.points, mesh.x[rest])
            u[rest] = matrix @ self.u_bulk[self.points.interior]
            flat = matrix @ self.bulk_stress.reshape(-1, 4)
            stress[rest] = flat.reshape(-1, 2, 2)
        return u, stress


def solve_body(
    model: Model,
    mesh: Mesh,
    *,
    displacement: Mapping[str, Field | ArrayLike],
    traction: Mapping[str, Traction | ArrayLike] | None = None,
    b: Field | None = None,
    coupling: Coupling = Coupling(),
    allow_uncertified: bool = False,
) -> BodySolution:
    """A body in equilibrium, its outline held in part, pulled in part, free elsewhere (B1–B7).

    Args:
        model: certified on some lattice; on others it is transferred.
        mesh: the body [Å].
        displacement: [Å] by part of the outline, a vector or a function of positions [n, 2]; a
            component that is NaN is free.
        traction: force per area [TPa] by part, a vector or a function of positions and outward
            normals.
        b: body force density [TPa/Å] as a function of positions [n, 2]; None for none.
        coupling: how rim and bulk meet.
        allow_uncertified: the model's own numbers on a lattice that nothing is proven of.

    Raises InputError for a part that the mesh has not, values of another shape, a body that is not
    held against every rigid motion, a mesh that is not in Å or too coarse, a hole smaller than the
    overlap, a model without positive long-wave moduli, an operator that is not definite.
    """
    if coupling.degree not in (1, 2):
        raise InputError(f"degree: expected 1 or 2, got {coupling.degree!r}")
    held = {name: _field(name, value, mesh) for name, value in displacement.items()}
    pulls = {name: _field(name, value, mesh) for name, value in (traction or {}).items()}
    spacing = model.certified_on[0] if coupling.spacing is None else coupling.spacing
    model = model_at(model, spacing, allow_uncertified=allow_uncertified)
    stiff = long_wave(model, spacing)
    overlap = _overlap(model, mesh, coupling)
    lattice = bulk_points(mesh, spacing, model.horizon)
    if lattice is None:
        message = f"mesh: nowhere is the body's edge {2 * model.horizon:g} Å away, two horizons"
        warnings.warn(f"{message}; it is solved by elements alone", stacklevel=2)
    kept = _rim_triangles(mesh, spacing, model.horizon, overlap, lattice)
    rim = Rim(mesh, kept, coupling.degree)
    f = _loads(rim, pulls, b)
    given, fixed = _given(rim, held)
    fixed[rim.inner] = True
    problem = RimProblem(rim.stiffness(stiff), fixed.ravel())
    if lattice is None:
        u = problem.solve(f.ravel(), given.ravel())
        record = Exchange(rim_residual=problem.residual(f.ravel(), u))
        return BodySolution(
            model, stiff, rim, u.reshape(-1, 2), None, np.zeros((0, 2)), overlap, record
        )
    points, triangle = lattice
    bulk = Bulk(model, points, coupling.tolerance)
    to_bulk = rim.probe(points.x[bulk.collar], triangle[bulk.collar])
    two = Schwarz(problem, bulk, rim.inner, cubic(points, rim.x[rim.inner]), to_bulk)
    load = np.zeros((len(bulk.inside), 2)) if b is None else b(points.x[bulk.inside])
    start = _by_elements(mesh, stiff, rim.x[rim.inner], held, pulls, b)
    u_rim, inner, record = two.solve(f, given, load, start, coupling.tolerance)
    u_bulk = bulk.field(inner, two.to_bulk @ u_rim)
    return BodySolution(model, stiff, rim, u_rim, points, u_bulk, overlap, record)


def _overlap(model: Model, mesh: Mesh, coupling: Coupling) -> float:
    """Width of the overlap [Å]; InputError where a hole is smaller."""
    overlap = OVERLAP * model.horizon if coupling.overlap is None else coupling.overlap
    if mesh.loop_sizes.min() < overlap:
        raise InputError(
            f"mesh: a hole of {mesh.loop_sizes.min():.3g} Å is smaller than the overlap of rim and "
            f"bulk, {overlap:g} Å"
        )
    return overlap


def long_wave(model: Model, spacing: float) -> Moduli:
    """The moduli of a model on its lattice; InputError unless their energy is positive."""
    stiff = Moduli(**moduli(model, bond_classes(spacing, model.horizon)))
    if not (stiff.C44 > 0 and stiff.C11 > abs(stiff.C12)):
        raise InputError(
            "model: expected long-wave moduli of positive energy, got C11, C12, C44 = "
            f"{stiff.C11:.4g}, {stiff.C12:.4g}, {stiff.C44:.4g} TPa"
        )
    return stiff


def _field(name: str, value: Field | Traction | ArrayLike, mesh: Mesh) -> Any:
    """A value on a part as a function that answers with vectors of the right shape."""
    if name not in mesh.parts:
        raise InputError(f"part '{name}': the outline has {', '.join(sorted(mesh.parts))}")

    def answer(*where: np.ndarray) -> np.ndarray:
        vectors = np.asarray(value(*where) if callable(value) else value, dtype=float)
        try:
            return np.broadcast_to(vectors, where[0].shape)
        except ValueError:
            raise InputError(
                f"part '{name}': expected vectors of shape {list(where[0].shape)}, got "
                f"{list(vectors.shape)}"
            ) from None

    return answer


def _rim_triangles(
    mesh: Mesh,
    spacing: float,
    horizon: float,
    overlap: float,
    lattice: tuple[Points, np.ndarray] | None,
) -> np.ndarray:
    """Triangles with a corner within 2δ and the overlap of the outline, or that hold the collar."""
    if lattice is None:
        return np.ones(len(mesh.triangles), bool)
    points, triangle = lattice
    width = 2 * horizon + MARGIN * spacing + overlap
    near = mesh.distance(mesh.x, spacing / 10) < width
    kept = near[mesh.triangles].any(axis=1)
    kept[triangle[~points.interior]] = True
    return np.asarray(kept)


def _loads(rim: Rim, pulls: Mapping[str, Traction], b: Field | None) -> np.ndarray:
    """Load of tractions and a body force on the rim's nodes [TPa Å], shape [n, 2]."""
    f = np.zeros_like(rim.x) if b is None else rim.body_force(b)
    for name, pull in pulls.items():
        f += rim.traction(name, pull)
    return f


def _by_elements(
    mesh: Mesh,
    stiff: Moduli,
    x: np.ndarray,
    held: Mapping[str, Field],
    pulls: Mapping[str, Traction],
    b: Field | None,
) -> np.ndarray:
    """Displacement [Å] at positions x by linear elements on the whole body, shape [n, 2]."""
    whole = Rim(mesh, np.ones(len(mesh.triangles), bool), degree=1)
    given, fixed = _given(whole, held)
    problem = RimProblem(whole.stiffness(stiff), fixed.ravel())
    u = problem.solve(_loads(whole, pulls, b).ravel(), given.ravel()).reshape(-1, 2)
    return np.asarray(whole.probe(x, mesh.holding(x)) @ u)


def _given(rim: Rim, held: Mapping[str, Field]) -> tuple[np.ndarray, np.ndarray]:
    """Held displacements of the rim's nodes, and which they are, each of shape [n, 2].

    Raises InputError when the body is left a rigid motion.
    """
    given, fixed = np.zeros_like(rim.x), np.zeros(rim.x.shape, bool)
    for name, values in held.items():
        nodes = rim.nodes_of(name)
        there = values(rim.x[nodes])
        known = np.isfinite(there)
        given[nodes] = np.where(known, there, given[nodes])
        fixed[nodes] |= known
    centred = rim.x - rim.x.mean(axis=0)
    size = np.abs(centred).max()
    turn = np.stack([-centred[:, 1], centred[:, 0]], axis=1) / size
    motions = [np.broadcast_to(v, rim.x.shape) for v in np.eye(2)] + [turn]
    held_motions = np.stack([motion[fixed] for motion in motions], axis=1)
    if np.linalg.matrix_rank(held_motions, tol=1e-6) < 3:
        raise InputError(
            "displacement: expected parts that hold the body against shifts and turns, got "
            + (", ".join(held) or "none")
        )
    return given, fixed
