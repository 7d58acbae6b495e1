"""Bodies whose bonds are cut, at rest, under pressure too; and slow growth of their cracks.

In slow growth the most stretched bond breaks first, one after the other; between events the body is
linear, and the largest loads give what the crack spends (theory, C7).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy import ndarray
from numpy.typing import ArrayLike
from tqdm import tqdm

import warp_peri.fracture as fracture
from warp_peri.core.elastic import in_shape_of
from warp_peri.errors import InputError, Shape, Values
from warp_peri.fracture.body import LatticeBody, box_nodes, cracked, lattice_body, through
from warp_peri.fracture.bonds import (
    CutRows,
    bond_matrix,
    bond_weights,
    bonds_of,
    check_breakable,
    largest_stiffness,
    unit_toughness,
)
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arguments import Count, Numbers, Positive, checked, typed
from warp_peri.points.families import BondClasses
from warp_peri.points.mesh import joined
from warp_peri.points.points import Points
from warp_peri.protocols import OperatorBase
from warp_peri.solvers.motion import Motion
from warp_peri.solvers.solution import CG, Direct, Solution, Solver, by_sample, refuse_solver
from warp_peri.solvers.systems import (
    MatrixProblem,
    SolveRecord,
    definite,
    is_definite,
    loose_pieces,
    symmetric_factors,
)

TOLERANCE = 1e-11
"""Of a body that has lost bonds, by the factors that it had before."""
INDEFINITE = (
    "operator: it is not positive definite, with negative eigenvalues on the free nodes; hold the "
    "body, take λ + μ > 0 and an influence function that bears these cuts (with_positive_kernel "
    "keeps the moduli)"
)


class CutSolid(OperatorBase):
    """Operator of a body with broken bonds at rest, factorised once.

    Args:
        material: with one influence function, checked by inertia if it changes sign, as is one with
            `moduli(body, weights)`: μ of bonds and λ − μ of nodes.
        body: nodes and bonds.
        held: components of the displacement that are given, shape [N] or [N, d] bool.
        neighbour: with broken bonds, shape [N, B]; the body's own by default.
        cracks, corrected: as of Cracked, the former instead of `neighbour`.
        solver: Direct, or CG by rows.
        moves: for waves alone; nothing need hold it, and it is not factorised.
        near: factors of the body before it lost some bonds, as preconditioner.

    Attributes:
        factors: of the rows and columns of L that are free, or `near`; none for CG.

    Raises InputError for a piece of the body that nothing holds, an operator with negative
    eigenvalues, and CG for another material; of one that moves for an influence function that
    changes sign, and nodes that are held in part.
    """

    is_linear = is_symmetric = True
    held = np.zeros((0, 0), bool)
    unlearned = "none, which corrected bodies and those of several materials have"

    def __init__(
        self,
        material: Any,
        body: LatticeBody,
        held: ArrayLike,
        *,
        neighbour: ndarray | None = None,
        cracks: Sequence[ArrayLike] = (),
        corrected: bool = False,
        solver: Solver = None,
        moves: bool = False,
        near: Any = None,
    ) -> None:
        self.model, self.body, self.corrected = material.linear, body, corrected
        self.moves, self.solver, self.factors = moves, solver, near
        self.neighbour = cracked(body, cracks) if neighbour is None else neighbour
        self.held = held = by_component(held, body.x.shape)
        if not moves:
            check_pieces(body, self.neighbour, held)
        self.one, of = not hasattr(material, "moduli"), (self.model, body.classes)
        moduli = None if self.one else material.moduli(body, bond_weights(*of))
        self.bonds = bonds_of(*of, moduli)
        self.inside = np.asarray(~held.all(axis=1))
        squares = self.one and not (self.bonds.stiffness < 0).any()
        self._rows = None
        self._searches = isinstance(solver, CG) or near is not None
        if moves or self._searches:
            plain = moves or not getattr(solver, "preconditioner", None)
            part = moves and (held != held[:, :1]).any()
            if part or not (squares and plain):
                what = "simulate: expected" if moves else "solver: expected CG() for"
                got = "nodes held in part" if part else solver if squares else "another material"
                raise InputError(
                    f"{what} one material with a positive influence function, in motion with nodes "
                    f"held in all components or in none; got {got}"
                )
            if not body.endless:
                self._rows = CutRows(self.model, body, self.neighbour, corrected)
            return
        rows = sp.csr_array(self.matrix[~held.ravel()])
        self._problem = MatrixProblem(rows, ~held, factorise=symmetric_factors)
        self.factors = self._problem.factors
        if not (squares or is_definite(self.factors.factors)):
            raise InputError(INDEFINITE)

    @cached_property
    def matrix(self) -> sp.csr_array:
        """Matrix L of (C4), symmetric, shape [d N, d N]."""
        return bond_matrix(self.body, self.neighbour, self.bonds, corrected=self.corrected)

    def times(self, fields: ndarray) -> ndarray:
        """Product L u of fields of all nodes, [S, N, d]."""
        if self._rows is not None:
            return self._rows(fields)
        return np.asarray(fields.reshape(len(fields), -1) @ self.matrix).reshape(fields.shape)

    @cached_property
    def points(self) -> Points:
        """Nodes as Points; those free in part are interior."""
        return Points(self.body.x, self.inside, self.body.spacing, units=self.model.units)

    def force(self, u: ndarray) -> ndarray:
        """Minus the internal force density on nodes not held, [..., N, d] to [..., I, d]."""
        return in_shape_of(u, self.times(self.fields(u))[:, self.inside])

    def vjp(self, u: Any, w: ndarray) -> ndarray:
        """Transposed product L w, of w on nodes not held [..., I, d], on all nodes [..., N, d]."""
        fields = self.on_all(self.of_interior(w, u))
        return self.times(fields.reshape(-1, *self.shape)).reshape(fields.shape)

    def solve(self, b: Any, u: Any, solver: Solver = None) -> Solution:
        """Solve for the body at rest under b [stress / length] or None, u given where held."""
        refuse_solver(solver, (Direct, CG), "a body with cracks")
        given = np.where(self.held, checked("u", u, float, (..., *self.shape), self.held), 0.0)
        load = np.zeros(given.shape) if b is None else checked("b", b, float, given.shape)
        fields = [one.reshape(-1, *self.shape) for one in (load, given)]
        inner = load[..., self.inside, :]
        if self._searches:
            answer, records = self._searched(*fields)
            return by_sample(self, answer.reshape(given.shape), inner, records, "cg")
        answer = self._problem.solve(*fields).reshape(given.shape)
        return Solution(answer, self.points, self, inner, "lu", measured=self._problem.left)

    def _searched(self, load: ndarray, known: ndarray) -> tuple[ndarray, list[SolveRecord]]:
        """Solve for fields [S, N, d] at rest by conjugate gradients."""
        free = ~self.held
        scale = free / np.where(free, self._rows.diagonal, 1.0) if self._rows else free

        def inverse(r: ndarray) -> ndarray:
            z: ndarray = r * scale
            if self.factors is not None:
                z[free] = self.factors.solve(r[free])
            return z

        product = lambda u: free * self.times(u[None])[0]  # noqa: E731
        goal = self.solver.tolerance if isinstance(self.solver, CG) else TOLERANCE
        hint = "; Direct() factorises the operator"
        rights = free * (load - self.times(known))
        found, records = zip(*(definite(product, inverse, r, goal, hint=hint) for r in rights))
        return known + np.stack(found), list(records)

    @property
    def learnable(self) -> Values:
        """Learnable parameters λ, μ, α and D by name; none of several materials, or corrected."""
        return self.model.learnable if self.one and not self.corrected else {}

    def at(self, numbers: Numbers) -> CutSolid:
        """Body with other parameters; InputError where they leave it indefinite."""
        law, of = self.model.with_parameters(numbers), (self.body, self.held)
        return CutSolid(law, *of, neighbour=self.neighbour, solver=self.solver, moves=self.moves)

    def force_with_parameters(self, u: Any, numbers: Any) -> Any:
        """Force of tensors [S, N, d] with other parameters, which has every derivative."""
        force = fracture.adjoint.bond_force(self.model, self.body, self.neighbour, u, numbers)
        return force[:, self.inside]

    def max_symbol_eigenvalue(self) -> float:
        """Proven upper bound of Λmax L [stress / length²]: (C9), or S. Gershgorin's of 1931. Raises
        InputError unless the body was made with `moves`."""
        if not self.moves:
            raise InputError("simulate: expected a Cracked of a BrittleMaterial, or a density")
        if not self.corrected:
            return largest_stiffness(self.model, self.body.classes)
        return float(abs(self.matrix).sum(axis=1).max())

    def energy(self, u: ndarray) -> Any:
        """Elastic energy [stress · length^d], bonds among held nodes included, shape [...]."""
        fields = self.fields(u)
        energy = (fields * self.times(fields)).sum(axis=(1, 2)) / 2
        return self.body.spacing**self.body.dimension * in_shape_of(u, energy)[()]


def by_component(held: ArrayLike, shape: Shape) -> ndarray:
    """Mask of given components, shape [N, d], of nodes [N] or components [N, d] bool."""
    mask = checked("held", held, bool)
    if mask.shape == shape[:1]:
        mask = np.broadcast_to(mask[:, None], shape)
    return checked("held", mask, bool, shape).copy()


def check_no_fail(no_fail: ArrayLike | None, count: int) -> ndarray:
    """Nodes whose bonds do not break, shape [N] bool; InputError for numbers or another shape."""
    return checked("no_fail", np.zeros(count, bool) if no_fail is None else no_fail, bool, (count,))


def check_pieces(body: LatticeBody, neighbour: ndarray, held: ndarray) -> None:
    """Refuse a body of which cracks have cut a piece that nothing holds, as loose_pieces finds."""
    if held.all():
        raise InputError("free: expected at least one component, got none")
    node, bond = np.nonzero(neighbour >= 0)
    piece = joined(len(body.x), np.column_stack([node, neighbour[node, bond]]))
    for nodes, rank, most in loose_pieces(body.x, piece, held):
        raise InputError(
            f"crack: a piece of {len(nodes)} nodes, node {nodes[0]} among them, is held against "
            f"{rank} of its {most} rigid motions only; hold it or leave it whole"
        )


def crack_load(cut: CutSolid, stress: ndarray, numbers: Any = None) -> Any:
    """Body force density [stress / length] that presses on the cut faces, shape [N, d].

    Minus the force that the missing bonds would carry under the uniform stress: a body pulled by it
    is as if the crack were not there (C13). Differentiable in parameters that are tensors, unless
    corrected. The stress is symmetric, [d, d]. Raises InputError for several materials.
    """
    if not cut.one:
        raise InputError("pressure: expected one material, isotropic")
    model, body = cut.model, cut.body
    if numbers is not None and not cut.corrected:
        return fracture.adjoint.crack_load(cut, stress, numbers)
    u = body.x @ strain_of(stress, model.lam, model.mu, np.eye(body.dimension))
    whole = CutRows(model, body, body.neighbour, cut.corrected)
    return (whole(u[None]) - cut.times(u[None]))[0]


def strain_of(stress: Any, lam: Any, mu: Any, even: Any) -> Any:
    """Strain of an isotropic solid under a stress, NumPy or torch; `even` is the identity."""
    d = len(even)
    bulk = d * (lam + 2 * mu / d)
    return (stress - lam / bulk * stress.trace() * even) / (2 * mu)


MOST = 40
"""Iterations of an event after which the body is factorised anew."""
TOGETHER = 1e-6
"""Bonds so close to the most stretched one break with it: mirror images, to rounding."""


def grow(
    model: LPSMaterial,
    body: LatticeBody,
    held: ArrayLike,
    u: ndarray,
    *,
    events: Count,
    cracks: Sequence[ArrayLike] = (),
    no_fail: ndarray | None = None,
    corrected: bool = False,
    progress: bool = False,
) -> Motion:
    """Break the bond most stretched, and its mirror images, event by event.

    Args:
        model, body, held, cracks, corrected: as of CutSolid; one that changes sign is refused.
        u: the held components at unit load, shape [N, d].
        events: how many, fewer when the body comes apart; InputError where nothing may break.
        no_fail: nodes whose bonds do not break, shape [N] bool.

    Returns a motion whose time is the load, the factor of u at which each event's bond breaks, over
    the critical stretch. Its histories are load, energy: elastic at unit load before each event
    [stress · area], and broken: bonds up to it, both directions; details: the neighbours [N, B].
    """
    check_breakable(model, body.classes)
    table, rows, near = cracked(body, cracks), list[Any](), None
    safe = check_no_fail(no_fail, len(body.x))
    node, bond = np.nonzero(table >= 0)
    far, xi, square = table[node, bond], body.xi[bond], body.r[bond] ** 2
    safe = safe[node] | safe[far]
    for _ in tqdm(range(events), disable=not progress, unit="event"):
        try:
            cut = CutSolid(model, body, held, neighbour=table, corrected=corrected, near=near)
        except InputError:
            if not rows:
                raise
            break  # a piece has come off
        found = cut.solve(None, u)
        near = cut.factors if max(found.iterations, default=0) <= MOST else None
        left = table[node, bond] >= 0
        along = ((found.u[far] - found.u[node]) * xi).sum(axis=1)
        stretch = np.where(left & ~safe, along / square, 0.0)
        if not (largest := float(stretch.max())) > 0:
            if not rows:
                raise InputError("events: nothing may break; u stretches no bond that may")
            break
        rows.append((1 / largest, float(cut.energy(found.u)), int(np.sum(~left))))
        end, table = found.u / largest, table.copy()
        lost = stretch > largest * (1 - TOGETHER)
        table[node[lost], bond[lost]] = -1 - far[lost]
    load, energy, broken = np.array(rows).T
    history = {"load": load, "energy": energy, "broken": broken.astype(int)}
    return Motion(load, end, None, history, table, "load")


@typed
def apparent_toughness(
    model: LPSMaterial, spacing: Positive, *, cells: Count = 20, length: Count = 3
) -> float:
    """Energy that a growing crack spends, over the toughness of (C6) behind its critical stretch.

    From a central crack in a plane under tension, `cells` spacings from the middle to the collar,
    of half length 0.4 of that, grown by `length` spacings: the mean of each spacing's largest load.
    Divide a stretch by its root to calibrate it (C7). The model must be positive on the lattice. In
    space strain is plane and the front straight; for a bent front this is an upper end.
    """
    h, d = spacing, model.dimension
    side = 2 * (cells + 2 * np.ceil(model.horizon / spacing)) * h
    if not (half := round(0.4 * cells) * h):
        raise InputError(f"cells: expected at least 2, for a crack with a length, got {cells}")
    x = box_nodes((side, side, h)[:d], h)
    held = (np.abs(x) > cells * h).any(axis=1)
    u = np.zeros_like(x)
    u[:, :2] = _westergaard(x, half, model.lam, model.mu)
    body = lattice_body(x, h, model.horizon, endless=d == 3)
    events = length * cut_by_spacing(body.classes) + 1  # an event is 4 directed bonds
    growth = grow(model, body, held, u, events=events, cracks=[through(-half, half, side, d)])
    return spent(growth, body.classes, tips=2) / unit_toughness(model, body.classes)


def _westergaard(x: ndarray, half: float, lam: float, mu: float) -> ndarray:
    """Displacement around a crack |x| < half in a plane under unit tension, [N, 2] (1939)."""
    y, z = x[:, 1], x[:, 0] + 1j * x[:, 1]
    root, kolosov = np.sqrt(z - half) * np.sqrt(z + half), (lam + 3 * mu) / (lam + mu)
    u = (kolosov - 1) / 2 * root.real - y * (z / root).imag
    v = (kolosov + 1) / 2 * root.imag - y * (z / root).real
    return np.column_stack([u, v]) / (2 * mu)


def cut_by_spacing(classes: BondClasses) -> int:
    """Number of bonds that a straight crack cuts as it grows by a spacing."""
    return int(classes.steps[:, 1].clip(0).sum())


def spent(growth: Motion, classes: BondClasses, *, tips: int) -> float:
    """Energy release rate at unit critical stretch of a growth by spacings, of equal tips."""
    grown = growth["broken"] / (2 * tips * cut_by_spacing(classes))  # spacings of each tip
    peaks = []
    for k in range(int(grown[-1])):
        cycle = (grown >= k) & (grown < k + 1)
        ends = np.interp([k, k + 1], grown, growth["energy"])
        area = tips * classes.spacing ** (classes.steps.shape[1] - 1)
        peaks.append(growth.time[cycle].max() ** 2 * (ends[0] - ends[1]) / area)  # at unit load
    return float(np.mean(peaks))
