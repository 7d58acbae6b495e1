"""Bodies whose bonds are cut, at rest, under pressure too."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

from warp_peri.contract import OnPoints
from warp_peri.damage.lattice_body import LatticeBody, cracked
from warp_peri.damage.operator import CutRows, bond_matrix, bond_weights, bonds_of, cut_matrix
from warp_peri.damage.solid import check_cut, check_horizon, largest_stiffness
from warp_peri.errors import InputError
from warp_peri.materials.lps import Model
from warp_peri.points.arrays import checked
from warp_peri.points.points import Points
from warp_peri.statics import direct
from warp_peri.statics.conjugate_gradients import definite
from warp_peri.statics.solution import Direct, Krylov, Solution, Solver, refuse_solver

SYMMETRIC = 1e-9
"""What a stress and its transpose may differ by, over the largest component."""


def in_torch() -> Any:
    """Forces over bonds and derivatives of bodies that break, which load torch."""
    return import_module("warp_peri.damage.adjoint")


class CutSolid(OnPoints):
    """A body with broken bonds at rest, its operator factorised once.

    Args:
        material: with one influence function; one that changes sign is checked by inertia, and so
            is one with `moduli(body, weights)`, μ of bonds and λ − μ of nodes.
        body: nodes and bonds.
        held: components of the displacement that are given, shape [N] or [N, d] bool.
        neighbour: with broken bonds, shape [N, B]; the body's own by default.
        cracks: polylines, in space flat polygons, that cut it, instead.
        corrected: bonds that a node lacks, at edges and cracks, take the mean gradient of those
            that it has (C26).
        moves: for waves alone; nothing need hold it, and it is not factorised.

    Attributes:
        factors: of the rows and columns of L that are free; none for Krylov.
        left: residual of the last solve over its right-hand side.

    Raises InputError for a piece of the body that nothing holds, naming it, for an operator
    with negative eigenvalues, for a body of another horizon, and Krylov for another material; of
    one that moves for an influence function that changes sign, and nodes that are held in part.
    """

    is_linear = is_symmetric = True

    def __init__(
        self,
        material: Any,
        body: LatticeBody,
        held: ArrayLike,
        *,
        neighbour: np.ndarray | None = None,
        cracks: Sequence[ArrayLike] = (),
        corrected: bool = False,
        solver: Direct | Krylov | None = None,
        moves: bool = False,
    ) -> None:
        self.model, self.body, self.corrected = material.linear, body, corrected
        self.moves = moves
        self.solver = solver
        check_horizon(self.model, body)
        self.neighbour = cracked(body, cracks) if neighbour is None else neighbour
        held = np.asarray(held, dtype=bool)
        count, d = body.x.shape
        held = np.repeat(held[:, None], d, axis=1) if held.ndim == 1 else held
        if held.shape != (count, d):
            raise InputError(f"held: expected shape [{count}] or [{count}, {d}] of bool")
        if not moves:
            check_pieces(body, self.neighbour, held)
        self._bonds, uneven = bonds_of(self.model, body.classes), hasattr(material, "moduli")
        self.one = not uneven
        if uneven:
            weights = bond_weights(self.model, body.classes)
            moduli = material.moduli(body, weights)
            self.matrix = cut_matrix(body, weights, self.neighbour, *moduli, corrected=corrected)
        self._rows: CutRows | None = None
        self.free, self.inside = ~held.ravel(), np.asarray(~held.all(axis=1))
        self.left = np.inf
        squares = not uneven and not (self._bonds.stiffness < 0).any()
        if moves and not (squares and (self.held == self.held[:, :1]).all()):
            raise InputError(
                "move: expected one material with a positive influence function, whose nodes "
                "are held in all components or in none"
            )
        if self.one and not squares:
            check_cut(self.matrix[self.free][:, self.free])
        if isinstance(solver, Krylov) and (not squares or solver.preconditioner):
            raise InputError(
                "solver: expected Krylov() for one material with a positive influence "
                f"function, or Direct(), got {solver}"
            )
        if moves or isinstance(solver, Krylov):
            self._rows = CutRows(self.model, body, self.neighbour, corrected)
            return
        rows = sp.csr_array(self.matrix[self.free])
        self._problem = direct.MatrixProblem(rows, ~held, factorise=symmetric_factors)
        self.factors = self._problem.factors
        if uneven:
            check_mixed(self.factors)

    @cached_property
    def matrix(self) -> sp.csr_array:
        """L of (C4), symmetric, shape [d N, d N]."""
        return bond_matrix(self.body, self.neighbour, *self._bonds, corrected=self.corrected)

    def times(self, fields: np.ndarray) -> np.ndarray:
        """L of fields of all nodes, [S, N, d]."""
        if self._rows is not None:
            return self._rows(fields)
        return np.asarray(fields.reshape(len(fields), -1) @ self.matrix).reshape(fields.shape)

    @property
    def held(self) -> np.ndarray:
        """Components that are given, [N, d]."""
        return np.asarray(~self.free.reshape(self.body.x.shape))

    @cached_property
    def points(self) -> Points:
        """The nodes; those free in part are interior."""
        return Points(self.body.x, self.inside, self.body.spacing, units=self.model.units)

    def force(self, u: np.ndarray) -> np.ndarray:
        """Minus the internal force density on nodes that are not held, [..., N, d] to [..., I, d].

        Raises InputError for another shape and what is not finite.
        """
        force = self.times(self.fields(u))[:, self.inside]
        return force.reshape(*np.shape(u)[:-2], *force.shape[1:])

    def product_transpose(self, u: Any, w: np.ndarray) -> np.ndarray:
        """The matrix, which is symmetric, of w on nodes that are not held, on all, [..., N, d]."""
        fields = self.on_all(w)
        return self.times(fields.reshape(-1, *self.shape)).reshape(fields.shape)

    def solve(self, b: ArrayLike | None, u: ArrayLike) -> np.ndarray:
        """u at rest, shape [..., N, d].

        Args:
            b: body force density [stress / length], same shape; None for none.
            u: holds the given components; the others are not looked at.

        Raises InputError for other shapes and for what is not finite.
        """
        one, held = self.body.x.shape, self.held
        given = np.where(held, checked("u", u, float, (..., *one), held), 0.0)
        load = np.zeros(given.shape) if b is None else checked("b", b, float, given.shape)
        load, known = load.reshape(-1, *one), given.reshape(-1, *one)
        if isinstance(self.solver, Krylov):
            return self._searched(load, known, self.solver.tolerance).reshape(given.shape)
        answer = self._problem.solve(load, known)
        self.left = self._problem.left
        return np.asarray(answer.reshape(given.shape))

    def _searched(self, load: np.ndarray, known: np.ndarray, tolerance: float) -> np.ndarray:
        """The same of fields [S, N, d] by conjugate gradients."""
        rows: Any = self._rows
        free = ~self.held
        search = partial(
            definite,
            lambda u: free * rows(u[None])[0],
            lambda r: r * (free / rows.diagonal),
            tolerance=tolerance,
            hint="; Direct() factorises the operator",
        )
        found, records = zip(*map(search, free * (load - rows(known))))
        self.left = max(record.residual for record in records)
        return np.asarray(known + np.stack(found))

    def rest(self, b: Any, u: Any, solver: Solver = None) -> Solution:
        """The Solution of `solve`, of nodes that are not held."""
        refuse_solver(solver, (Direct, Krylov), "a body with cracks")
        solved, load = self.solve(b, u), np.asarray(b, float)[..., self.inside, :]
        method = "cg" if isinstance(self.solver, Krylov) else "lu"
        return Solution(solved, self.points, self, load, method, measured=self.left)

    @property
    def learnable(self) -> dict[str, Any]:
        """λ, μ, α and D by name; none of several materials, or corrected."""
        return self.model.learnable if self.one and not self.corrected else {}

    def at(self, numbers: Mapping[str, Any]) -> CutSolid:
        """The same body with other numbers; InputError where they leave it indefinite."""
        model = self.model.having(numbers)
        how: dict[str, Any] = {"neighbour": self.neighbour, "solver": self.solver}
        return CutSolid(model, self.body, self.held, **how)

    def force_with(self, u: Any, numbers: Any) -> Any:
        """The force of tensors [S, N, d] with other numbers, which has every derivative."""
        force = in_torch().bond_force(self.model, self.body, self.neighbour, u, numbers)
        return force[:, self.inside]

    def stiffest_wave(self) -> float:
        """A proven upper bound of Λmax L [stress / length²]: (C9), or S. Gershgorin's of 1931.

        Raises InputError at rest: whether such a body may move is not looked at there.
        """
        if not self.moves:
            raise InputError("move: expected a Cracked of a BrittleSolid, or one with a density")
        if not self.corrected:
            return largest_stiffness(self.model, self.body.classes)
        return float(abs(self.matrix).sum(axis=1).max())

    def energy(self, u: np.ndarray) -> Any:
        """Elastic energy [stress · length^d], bonds among held nodes included, shape [...]."""
        fields = np.reshape(u, (-1, *self.shape))
        energy = (fields * self.times(fields)).sum(axis=(1, 2)) / 2
        return self.body.spacing**self.body.dimension * energy.reshape(np.shape(u)[:-2])[()]


def symmetric_factors(matrix: sp.csc_array) -> Any:
    """Sparse factors of a symmetric matrix, pivots on the diagonal; InputError if singular."""
    try:
        return direct.symmetric_factors(matrix)
    except RuntimeError as error:
        raise InputError(f"operator: parts of the body hang loose ({error})") from None


def check_mixed(factors: Any) -> None:
    """Raise InputError where moduli leave a body indefinite, by the factors of its operator."""
    signed = direct.pivots(factors)
    if signed is None or not (signed > 0).all():
        raise InputError(
            "mixed: the operator on the free nodes is not positive definite; hold the body, and "
            "expect λ + μ > 0 of its materials"
        )


def check_pieces(body: LatticeBody, neighbour: np.ndarray, held: np.ndarray) -> None:
    """Refuse a body of which a piece may move freely: cracks have cut it off and nothing holds it.

    A piece needs as many held components as it has rigid motions, three in the plane and six in
    space.
    """
    node, bond = np.nonzero(neighbour >= 0)
    count, d = body.x.shape
    links = sp.csr_array((np.ones(len(node)), (node, neighbour[node, bond])), shape=(count, count))
    pieces, label = connected_components(links, directed=False)
    for piece in range(pieces):
        nodes = np.flatnonzero(label == piece)
        if d == 2 and held[nodes].all(axis=1).sum() > 1:
            continue
        away = body.x[nodes] - body.x[nodes].mean(axis=0)
        away /= max(np.abs(away).max(), body.spacing)
        turns = np.zeros((len(nodes), d, d * (d - 1) // 2))
        for number, (a, b) in enumerate(itertools.combinations(range(d), 2)):
            turns[:, a, number], turns[:, b, number] = -away[:, b], away[:, a]
        shifts = np.broadcast_to(np.eye(d), (len(nodes), d, d))
        motions = np.concatenate([shifts, turns], axis=2)
        felt = motions[held[nodes]]
        rank = np.linalg.matrix_rank(felt, tol=1e-9) if len(felt) else 0
        if rank < motions.shape[2]:
            raise InputError(
                f"crack: a piece of {len(nodes)} nodes, node {nodes[0]} among them, is held "
                f"against {rank} of its {motions.shape[2]} rigid motions only; hold it or leave "
                "it whole"
            )


def contour_integral(solution: Solution, tip: Sequence[float], radii: tuple[float, float]) -> float:
    """J around the tip of a crack along an axis, for its growth straight on, by a domain (C12).

    From which side the crack comes is where the displacement jumps most. Gradients are differences
    on a full box of nodes, one-sided across the crack; the weight falls from 1 to 0 between two
    squares about the tip. In space these are cubes about a point of the front, which runs straight
    along an axis within the larger one, and J is the mean over what is in it.

    Args:
        solution: of a Cracked on a rectangle or box of nodes, of one material, with the crack
            midway between two of their rows, columns or layers.
        tip: where the crack ends, shape [d].
        radii: half sides of the squares [length], the smaller first; taken to the nearest spacing.

    Raises InputError for a body that is no box, several materials, and squares that do not differ
    by a spacing or do not fit into the body.
    """
    if not getattr(solution.operator, "one", False):
        raise InputError("solution: expected that of a Cracked, of one material, isotropic")
    return domain_integral(solution.operator.model, solution.operator.body, solution.u, tip, radii)


def domain_integral(
    model: Model, body: LatticeBody, u: np.ndarray, tip: Sequence[float], radii: tuple[float, float]
) -> float:
    """As contour_integral, of a displacement of all nodes [N, d]."""
    h, d = body.spacing, body.dimension
    if not (np.isfinite(radii).all() and 0 <= round(radii[0] / h) < round(radii[1] / h)):
        raise InputError(
            f"radii: expected 0 ≤ smaller < larger by a spacing of {h:g} or more, got "
            f"{radii[0]:g}, {radii[1]:g}"
        )
    r1, r2 = (round(radius / h) * h for radius in radii)
    if np.shape(tip) != (d,):
        raise InputError(f"tip: expected a point of shape [{d}], got {list(np.shape(tip))}")
    if np.shape(u) != body.x.shape:
        raise InputError(f"u: expected shape {list(body.x.shape)}, got {list(np.shape(u))}")
    place = np.rint((body.x - body.x.min(axis=0)) / h).astype(int)
    sides = place.max(axis=0) + 1
    if np.prod(sides) != len(body.x):
        raise InputError("body: expected a full box of nodes for J")
    order = np.lexsort(place.T[::-1])
    x = body.x[order].reshape(*sides, d) - np.asarray(tip, dtype=float)
    low, high = (end.min() for end in (-x.reshape(-1, d).min(axis=0), x.reshape(-1, d).max(axis=0)))
    if (room := min(low, high)) < r2 - 1e-9 * h:
        raise InputError(f"radii: {r2:g} is more than from the tip to the edge, {room:g}")
    field, x = _from_the_left(u[order].reshape(*sides, d), x, r2)
    gradient = crack_gradient(field, h, _line(x, 0) < 0, int(np.count_nonzero(_line(x, 1) < 0)))
    strain = (gradient + gradient.swapaxes(-1, -2)) / 2
    stress = 2 * model.mu * strain
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    stress = stress + model.lam * trace * np.eye(d)
    density = (stress * strain).sum(axis=(-1, -2)) / 2
    away = np.abs(x)
    across, along = away[..., :2].max(axis=-1), away[..., 2:].max(axis=-1, initial=0.0)
    sideways = np.arange(d) == away[..., :2].argmax(axis=-1)[..., None]
    within = np.clip((r2 - along) / (r2 - r1), 0.0, 1.0)  # along the front, in space
    slope = np.where(sideways, within[..., None] * _fall(away, h, r1, r2), 0.0)
    slope[..., 2:] = (np.clip((r2 - across) / (r2 - r1), 0.0, 1.0) * _fall(along, h, r1, r2))[
        ..., None
    ]
    slope *= np.sign(x)
    pull = np.einsum("...ij,...i->...j", stress, gradient[..., 0])
    integrand = density * slope[..., 0] - (pull * slope).sum(axis=-1)
    front = within[0, 0].sum() * h ** (d - 2)
    return float(-integrand.sum() * h**d / front)


def _from_the_left(field: np.ndarray, x: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and places about a tip, [n₁, …, d], turned so that the crack comes along −x₁.

    Its faces then look along x₂. The jump across half a plane is what neighbours on both sides do
    not explain.
    """
    d, views, jumps = x.shape[-1], [], []
    for axes in itertools.permutations(range(d)):
        turned, places = (np.transpose(a, (*axes, d))[..., list(axes)] for a in (field, x))
        steps, row = np.diff(turned, axis=1), int(np.count_nonzero(_line(places, 1) < 0))
        around = steps[:, max(row - 2, 0)] + steps[:, min(row, steps.shape[1] - 1)]
        jump = np.square(steps[:, row - 1] - around / 2).sum(axis=-1)
        at = places[:, row - 1]
        near = (np.abs(np.delete(at, 1, axis=-1)) <= reach).all(axis=-1)
        for sign in (1, -1):
            jumps.append(jump[near & (sign * at[..., 0] < 0)].sum())
            flip = np.where(np.arange(d) == 0, sign, 1.0)
            views.append((turned[::sign] * flip, places[::sign] * flip))
    return views[int(np.argmax(jumps))]


def _line(x: np.ndarray, axis: int) -> np.ndarray:
    """Coordinates along one axis of a box of places, [n₁, …, d]."""
    coordinates: np.ndarray = np.moveaxis(x[..., axis], axis, -1)[(0,) * (x.shape[-1] - 1)]
    return coordinates


def _fall(away: np.ndarray, h: float, r1: float, r2: float) -> np.ndarray:
    """Mean slope, over a cell, of what falls from 1 to 0 between r1 and r2.

    The tip may then stand anywhere between two columns of nodes.
    """
    outer, inner = (np.clip((r2 - away + d) / (r2 - r1), 0.0, 1.0) for d in (-h / 2, h / 2))
    slope: np.ndarray = (outer - inner) / h
    return slope


def crack_gradient(field: np.ndarray, h: float, behind: np.ndarray, row: int) -> np.ndarray:
    """∂u_i/∂x_j by differences, shape [n₁, n₂, …, d, d], one-sided across rows row − 1 and row."""
    d = field.shape[-1]
    slopes = [np.gradient(field, h, axis=axis, edge_order=2) for axis in range(d)]
    halves = (field[:, :row], field[:, row:])
    apart = np.concatenate([np.gradient(half, h, axis=1, edge_order=2) for half in halves], axis=1)
    slopes[1] = np.where(behind.reshape(-1, *(d * (1,))), apart, slopes[1])
    return np.stack(slopes, axis=-1)


def crack_load(cut: CutSolid, stress: np.ndarray) -> np.ndarray:
    """Body force density [stress / length] that presses on what has been cut, shape [N, d].

    The bonds that are missing would carry some force in a body
    under the uniform stress; this is minus that force, so that a crack with it in a body pulled by
    the stress is as if it were not there (C13).

    Args:
        cut: the solid, of one material.
        stress: symmetric, shape [d, d]; p n⊗n for a pressure on faces with normal n.

    Raises InputError for another stress, and several materials.
    """
    if not cut.one:
        raise InputError("pressure: expected one material, isotropic")
    model, body = cut.model, cut.body
    lam, mu, d = model.lam, model.mu, model.dimension
    stress = checked("stress", stress, float, (d, d))
    if np.abs(stress - stress.T).max() > SYMMETRIC * np.abs(stress).max():
        raise InputError(f"stress: expected a symmetric one, got {stress.tolist()}")
    bulk = d * (lam + 2 * mu / d)
    strain = (stress - lam / bulk * np.trace(stress) * np.eye(d)) / (2 * mu)
    u, whole = (body.x @ strain)[None], CutRows(model, body, body.neighbour, cut.corrected)
    return np.asarray((whole(u) - cut.times(u))[0])


def opening_volume(solution: Solution, normal: Sequence[float] | None = None) -> float:
    """Room between the faces of cracks with one normal [length^d], from the bonds across them.

    Each broken bond of one spacing along the normal is a column of the opening; cracks along a
    row of nodes. The solution is that of a Cracked; the normal is the second axis unless given.

    Raises InputError unless the normal is along an axis.
    """
    node, far, along = _columns(solution, normal)
    body, u = solution.operator.body, solution.u
    return float(body.spacing ** (body.dimension - 1) * ((u[far] - u[node]) @ along).sum())


def crack_area(solution: Solution, normal: Sequence[float] | None = None) -> float:
    """Length, in space area, of these cracks: a spacing or a square of it for each column."""
    body = solution.operator.body
    return float(len(_columns(solution, normal)[0]) * body.spacing ** (body.dimension - 1))


def _columns(
    solution: Solution, normal: Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes below and above a crack, joined by a bond that it broke, and the normal."""
    body, neighbour, d = solution.operator.body, solution.operator.neighbour, solution.u.shape[1]
    along = np.eye(d)[1] if normal is None else np.asarray(normal, dtype=float)
    if along.shape != (d,) or sorted(np.abs(along)) != [0] * (d - 1) + [1]:
        raise InputError(f"normal: expected one along an axis, as {(0, 1, 0)[:d]}, got {normal}")
    across = np.abs(body.xi - body.spacing * along).max(axis=1)
    step = int(np.argmin(across))
    if across[step] > 1e-6 * body.spacing:
        raise InputError("body: expected a lattice along the axes, got a turned one")
    node = np.flatnonzero((neighbour[:, step] < 0) & (body.neighbour[:, step] >= 0))
    return node, body.neighbour[node, step], along
