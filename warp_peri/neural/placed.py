"""A neural material on nodes: force, tangent, equilibria, other lattices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.core.torch_bridge import on_fields, refuse_tangents
from warp_peri.errors import InputError
from warp_peri.neural.bonds import NetworkBonds
from warp_peri.points.arguments import typed
from warp_peri.points.arrays import checked_fields, plain
from warp_peri.points.samples import Samples
from warp_peri.protocols import OperatorBase
from warp_peri.solvers.equilibria import Equilibria, probed
from warp_peri.solvers.linear import Inverse, Linear
from warp_peri.solvers.solution import Newton, Solution, Solver, refuse_solver

if TYPE_CHECKING:
    from warp_peri.neural.material import NeuralOperator

CHUNK = 2048
"""Bonds at once: their hidden layers stay in a processor's cache."""
SOLVED = 1e-5
"""Tolerance of the equilibria of frames."""


def matrix(tangent: Tangent) -> sp.csr_array:
    """J = ∂force/∂u, rows of the interior and columns of all nodes, shape [2 I, 2 N], (NO9)."""
    bonds = tangent.bonds
    u = tangent.u[0].double().numpy()
    nodes, listed, acting = len(u), len(bonds.near), bonds.acting
    Y = bonds.xi[bonds.place] + u[bonds.far] - u[bonds.near]
    length = np.linalg.norm(Y, axis=1)
    M = Y / length[:, None]
    stretching = _between(bonds.near, bonds.far, M, nodes)
    k, p = np.indices((len(bonds.whole), len(bonds.xi))).reshape(2, -1)
    share = tangent.share.double().numpy()[p]
    number = bonds.number[bonds.whole].ravel()
    average = sp.csr_array((share, (k, number)), shape=(len(bonds.whole), listed)) @ stretching
    first = stretching[:acting]
    rows = (2 * bonds.rows[:, None] + [0, 1]).ravel()
    pull = first.T[rows]
    J = pull @ (sp.diags_array(tangent.to_e.double().numpy().ravel()) @ first)
    slopes = np.concatenate([tangent.to_own.double().numpy(), tangent.to_other.double().numpy()])
    ends = np.tile(np.arange(acting), 2), np.concatenate([bonds.own.numpy(), bonds.other.numpy()])
    by_theta = sp.csr_array((slopes, ends), shape=(acting, len(bonds.whole)))
    J = J + (pull @ by_theta) @ average
    t = tangent.tension.double().numpy().ravel() / length[:acting]
    across = np.stack([-M[:acting, 1], M[:acting, 0]], axis=1)
    turned = _between(bonds.near[:acting], bonds.far[:acting], across, nodes)
    J = J + turned.T[rows] @ (sp.diags_array(t) @ turned)
    return sp.csr_array(bonds.area * J)


def _between(near: np.ndarray, far: np.ndarray, M: np.ndarray, nodes: int) -> sp.csr_array:
    """Rows M·(v_far − v_near), shape [n, 2 nodes]."""
    n = np.arange(len(near))
    columns = np.stack([2 * near, 2 * near + 1, 2 * far, 2 * far + 1], axis=1)
    values = np.concatenate([-M, M], axis=1)
    given = (values.ravel(), (np.repeat(n, 4), columns.ravel()))
    return sp.csr_array(given, shape=(len(n), 2 * nodes))


TOLERANCE = 1e-8
"""‖force − b‖ over that of the field that the search begins with."""
ROUNDING = 16
"""In units of the networks' precision: a residual that steps of Newton no longer lower."""
LOADS = 8
"""Loads that the solid at rest is set up for."""


@dataclass(frozen=True)
class Found:
    """An equilibrium, or where the search ended.

    Attributes:
        u: displacement of all nodes [length], shape [N, 2].
        residual: ‖force − b‖ over that of the start.
        steps: solves of the solid at rest.
        converged: whether the residual is within the tolerance, or within rounding: networks in
            single precision leave some 1e-7 of it.
    """

    u: np.ndarray
    residual: float
    steps: int
    converged: bool


class EquilibriumSolver:
    """Equilibria of one operator, with the stencil that it was at rest before them.

    The material's numbers may change meanwhile. Raises InputError for points without a collar.
    """

    def __init__(self, placed: Placed) -> None:
        points = placed.points
        if points.interior.all():
            raise InputError(
                "points: expected a collar where u is given; without one it is known up to a motion"
            )
        self.placed, self.rows = placed, placed.bonds.rows
        linear = Linear(probed(placed), points)
        self.inverse = linear.cheapest_inverse(LOADS, definite=False)
        straight = lambda u: linear(u[None])[0]  # noqa: E731
        self.way = Equilibria(placed, straight, self.inverse, points.interior)

    @property
    def _rounding(self) -> float:
        return float(ROUNDING * torch.finfo(self.placed.dtype).eps)

    def solve(self, b: ArrayLike, u: ArrayLike, *, tolerance: float = TOLERANCE) -> Found:
        """Where the force on the interior is b [stress/length], of shape [N, 2].

        Args:
            b: load; only interior values count.
            u: displacement [length], shape [N, 2]: data on the collar, the start on the interior.
            tolerance: ‖force − b‖ over that of the start with a zero interior.

        Raises InputError for arrays of other shapes.
        """
        load, field = self._checked(b, u)
        enough = max(tolerance, self._rounding)
        found, record = self.way.solve_from(load, field, enough)
        return Found(found, record.residual, record.solves, record.residual <= enough)

    def solve_by_continuation(
        self, b: ArrayLike, u: ArrayLike, *, tolerance: float = TOLERANCE
    ) -> Found:
        """Where the force on the interior is b, on the branch that leaves the state of rest.

        Arguments and errors are those of `solve`; what `u` has inside does not count. Where it is
        not found, what the solid at rest answers is returned.
        """
        load, given = self._checked(b, u)
        enough = max(tolerance, self._rounding)
        try:
            found, record = self.way.solve(load, given, enough)
        except InputError:
            field = np.where(self.placed.points.interior[:, None], 0.0, given)
            field[self.rows] = self.inverse(load - self.way.straight(field), enough)
            left = np.linalg.norm(load - self.placed(field))
            return Found(field, float(left / (np.linalg.norm(load) or 1.0)), 1, False)
        return Found(found, record.residual, record.solves, True)

    def _checked(self, b: ArrayLike, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The load on the interior, and the field."""
        load, field = checked_fields(self.placed.points, b, u)
        return load[self.rows], field


CELLS = 16
"""Of the grid, along the range of the dilatation and that of the extension."""
MARGIN = 1 + 1e-4
"""Grids are so much larger than the range of the values."""


def interpolated_force(
    placed: Placed, u: torch.Tensor, *, cells: int = CELLS, offset: tuple[float, float] = (0.5, 0.5)
) -> torch.Tensor:
    """Forces on the interior [stress/length], shape [S, I, 2], for u of shape [S, N, 2].

    Args:
        placed: the operator on a lattice.
        u: displacements [length].
        cells: of the grid along each axis, not counting one more.
        offset: share of a cell by which the grid begins before the range; drawn anew in every step
            of a training, corners stand nowhere twice.

    Differentiable in the material's numbers; the error falls with the square of 1/cells.
    """
    bonds, material = placed.bonds, placed.material
    omega, share, r = placed.shares(u.dtype)
    e, theta, M = bonds.gather(u, share)
    kinds = np.arange(len(bonds.xi)) if material.anisotropic else bonds.kind
    first = torch.as_tensor(np.unique(kinds, return_index=True)[1])
    kind = torch.as_tensor(kinds, dtype=torch.int64)
    side = cells + 2
    low, step = _range(theta.detach().abs().max(), cells, offset[0])
    ends = []
    for nodes, places in ((bonds.own, bonds.forward), (bonds.other, bonds.backward)):
        ends.append((kind[places], (theta[:, nodes] - low) / step))
    largest, most = e.detach().abs().amax(dim=0), e.new_zeros(len(first))
    for k, _ in ends:
        most.scatter_reduce_(0, k, largest, "amax")
    least, rise = _range(most, cells, offset[1])
    corners = []
    for k, x in ends:
        y = (e - least[k]) / rise[k]
        column, row = (part.detach().floor().clamp(0, side - 2) for part in (x, y))
        corners.append((((k * side + row.long()) * side + column.long()), x - column, y - row))
    wanted = torch.zeros(len(first) * side * side, dtype=torch.bool)
    beside = (0, 1, side, side + 1)
    for corner, _, _ in corners:
        for shift in beside:
            wanted[corner + shift] = True
    place = wanted.nonzero()[:, 0]
    k, row, column = place // side**2, place // side % side, place % side
    state = material.force_state(
        omega[first][k], low + column * step, least[k] + row * rise[k], r[first][k]
    )
    table = state.new_zeros(len(wanted)).index_copy(0, place, state)
    tension = torch.zeros_like(e)
    for corner, x, y in corners:
        a, b, c, d = (table[corner + shift] for shift in beside)
        tension = tension + (1 - y) * ((1 - x) * a + x * b) + y * ((1 - x) * c + x * d)
    return bonds.scatter(M, tension)[:, bonds.rows]


def _range(most: torch.Tensor, cells: int, offset: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Where a grid over values from −most to most begins, and its step."""
    most = most * MARGIN + torch.finfo(most.dtype).tiny
    step = 2 * most / cells
    return -most - offset * step, step


class Placed(OperatorBase):
    """Minus the internal force density of a neural operator on a lattice; b in equilibrium."""

    def __init__(self, material: NeuralOperator, bonds: NetworkBonds) -> None:
        self.material, self.bonds, self.points = material, bonds, bonds.points

    @property
    def model(self) -> Any:
        """The material."""
        return self.material

    def inverse(self, loads: int) -> Inverse:
        """Of the solid at rest, of a load on the interior."""
        return EquilibriumSolver(self).inverse

    def errors(self, samples: Samples) -> dict[str, Any]:
        """For `evaluate`: samples whose equilibrium is not found are told apart."""
        return evaluate(self.model, samples)

    def solve(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar, shape [N, 2] or [S, N, 2].

        The details of the solution are what Equilibrium.solve found of each sample. Raises
        InputError for arrays that do not fit or are not finite, and for a sample without an
        equilibrium, naming it.
        """
        refuse_solver(solver, (Newton,), "a neural operator")
        asked = solver if isinstance(solver, Newton) else Newton()
        load, given = checked_fields(self.points, b, u)
        search = EquilibriumSolver(self)
        pairs = zip(*(np.reshape(f, (-1, *self.points.x.shape)) for f in (load, given)))
        found = [search.solve_by_continuation(*pair, tolerance=asked.tolerance) for pair in pairs]
        for number, one in enumerate(found):
            if not one.converged:
                raise InputError(
                    f"sample {number}: no equilibrium was found; residual {one.residual:.1e}"
                )
        return Solution(
            np.reshape([one.u for one in found], given.shape),
            self.points,
            self,
            self.rhs(load),
            "newton",
            tuple(one.steps for one in found),
            details=tuple(found),
            measured=max((one.residual for one in found), default=None),
        )

    @property
    def networks(self) -> tuple[torch.nn.Parameter, ...]:  # type: ignore[override]
        """The numbers of the networks."""
        return tuple(self.material.parameters())

    def interior_tangent(self, u: np.ndarray) -> sp.csc_array:
        """The derivative of the force at a field, between interior nodes, sparse [2 I, 2 I]."""
        unknown = (2 * self.bonds.rows[:, None] + [0, 1]).ravel()
        return matrix(self.tangent(self._taken(u)))[:, unknown].tocsc()

    def force_torch(self, u: torch.Tensor) -> Any:
        """Forces on the interior, (NO6), differentiable in the networks' numbers too."""
        if not any(p.requires_grad for p in self.material.parameters()):
            return super().force_torch(u)
        refuse_tangents(u)
        return on_fields(self, u, lambda fields: self._force(fields.to(self.dtype)))

    def force(self, u: Any) -> np.ndarray:
        """Forces on the interior, shape [..., I, 2], (NO6)."""
        field = self._taken(u)
        with torch.no_grad():
            force = self._force(self._checked(field)).double().numpy()
        return np.asarray(force.reshape(*field.shape[:-2], -1, 2))

    def jvp(self, u: Any, v: Any) -> Any:
        """Derivative of the force at u along v, both [N, 2] or [S, N, 2], or u [N, 2] alone."""
        if isinstance(u, torch.Tensor):
            self._checked(v, "v")
            return self.tangent(u)(v)
        if np.ndim(u) == 3 and np.shape(u) == np.shape(v):
            return np.stack([self.jvp(*pair) for pair in zip(u, v)])
        with torch.no_grad():
            return self.jvp(self._taken(u), self._taken(v)).double().numpy()

    def vjp(self, u: Any, w: Any) -> np.ndarray:
        """The transposed product with w on the interior [..., I, 2], on all nodes [..., N, 2]."""
        fields, seeds = (self._taken(f).reshape(-1, *np.shape(f)[-2:]) for f in (u, w))
        with torch.no_grad():
            pairs = zip(fields, seeds, strict=True)
            found = torch.stack([self.tangent(f).transposed(one) for f, one in pairs])
        return found.double().numpy().reshape(np.shape(u))

    def stress(self, u: Any) -> np.ndarray:
        """First Piola–Kirchhoff stress [stress] at the interior nodes, shape [..., I, 2, 2].

        Half of Σ tension M ⊗ ξ over a node's bonds, (NO13); exact for uniform strain.
        """
        bonds, field = self.bonds, np.reshape(u, (-1, *self.points.x.shape))
        with torch.no_grad():
            tension, M = (one.double().numpy() for one in self.tension(self._taken(field)))
        near, far = bonds.near[: bonds.acting], bonds.far[: bonds.acting]
        xi, pull = bonds.xi[bonds.place[: bonds.acting]], tension[..., None] * M
        part = 0.5 * bonds.area * pull[..., :, None] * xi[:, None, :]
        whole = np.zeros((len(self.points.x), len(field), 2, 2))
        for ends in (near, far):
            np.add.at(whole, ends, part.swapaxes(0, 1))
        rows = whole[bonds.rows].swapaxes(0, 1)
        stress: np.ndarray = rows.reshape(*np.shape(u)[:-2], len(bonds.rows), 2, 2)
        return stress

    def _force(self, u: torch.Tensor) -> torch.Tensor:
        """Forces [S, I, 2] of u [S, N, 2]."""
        tension, M = self.tension(u)
        return self.bonds.scatter(M, tension)[:, self.bonds.rows]

    def tension(self, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Force states of both ends of the acting bonds [stress/length³], [S, A] of u [S, N, 2],
        and the directions of these bonds, [S, A, 2]."""
        omega, share, r = self.shares(u.dtype)
        e, theta, M = self.bonds.gather(u, share)
        own, other = self.inputs(omega, theta, e, r)
        state = self.material.force_state
        return (state(*own) + state(*other)).reshape(len(u), -1), M

    def shares(self, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """ω, ω |ξ| / Σ ω |ξ|² and |ξ| of the bonds of a family, each of shape [B]."""
        bonds = self.bonds
        net = self.material
        turn = np.radians(self.points.axis or 0.0)  # directions are those of the material
        along = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        xi = torch.as_tensor(bonds.xi @ along, dtype=dtype)
        r = torch.as_tensor(bonds.lengths, dtype=dtype)
        if net.anisotropic:
            omega = net.omega(xi)
        else:  # one value for a class
            kind = torch.as_tensor(bonds.kind, dtype=torch.int64)
            first = [int(n) for n in np.unique(bonds.kind, return_index=True)[1]]
            omega = net.omega(xi[first])[kind]
        return omega, omega * r / (omega * r**2).sum(), r

    def inputs(
        self, omega: torch.Tensor, theta: torch.Tensor, e: torch.Tensor, r: torch.Tensor
    ) -> tuple[tuple[torch.Tensor, ...], tuple[torch.Tensor, ...]]:
        """What the force state takes of either end of the acting bonds, each of shape [S A]."""
        bonds = self.bonds

        def seen(nodes: torch.Tensor, places: torch.Tensor) -> tuple[torch.Tensor, ...]:
            parts = (omega[places], theta[:, nodes], e, r[places])
            return tuple(part.expand_as(e).reshape(-1) for part in parts)

        return seen(bonds.own, bonds.forward), seen(bonds.other, bonds.backward)

    def tangent(self, u: torch.Tensor) -> Tangent:
        """The derivative of the force at one field, shape [N, 2]."""
        if u.dim() != 2:
            raise InputError(f"u: expected shape {[*self.points.x.shape]}, got {[*u.shape]}")
        return Tangent(self, self._checked(u).detach())

    @property
    def dtype(self) -> torch.dtype:
        """The material's precision."""
        return next(self.material.parameters()).dtype

    def _taken(self, u: Any) -> torch.Tensor:
        """NumPy's field in the material's precision."""
        return torch.as_tensor(np.ascontiguousarray(plain("u", u)), dtype=self.dtype)

    def _checked(self, u: torch.Tensor, name: str = "u") -> torch.Tensor:
        """A field of shape [S, N, 2] in the material's precision."""
        nodes = len(self.points.x)
        if u.dim() not in (2, 3) or u.shape[-2:] != (nodes, 2):
            raise InputError(
                f"{name}: expected shape [{nodes}, 2] or [S, {nodes}, 2], got {[*u.shape]}"
            )
        if not len(u):
            raise InputError(f"{name}: expected at least one sample, got none")
        if u.dtype != self.dtype:
            raise InputError(
                f"{name}: expected {self.dtype}, the material's precision, got {u.dtype}"
            )
        return u.reshape(-1, nodes, 2)


class Tangent:
    """J = ∂force/∂u at one field: products with fields and with forces, without the networks.

    The slopes of every bond's force state to its extension and to the dilatations of its ends are
    computed once; the force with these slopes in their place is torch's to differentiate.
    """

    def __init__(self, placed: Placed, u: torch.Tensor) -> None:
        self.bonds, self.u = placed.bonds, u
        with torch.no_grad():
            omega, self.share, r = placed.shares(u.dtype)
            self.e, self.theta, _ = self.bonds.gather(u, self.share)
        both = []
        for seen in placed.inputs(omega, self.theta, self.e, r):
            parts = [
                _slopes(placed.material, *part) for part in zip(*(x.split(CHUNK) for x in seen))
            ]
            both.append([torch.cat(part) for part in zip(*parts)])
        (own, self.to_own, by_e), (other, self.to_other, by_far) = both
        self.tension, self.to_e = (own + other)[None], (by_e + by_far)[None]

    def _force(self, u: torch.Tensor) -> torch.Tensor:
        """The force of force states that are linear in what they see, [S, I, 2] of [S, N, 2]."""
        bonds = self.bonds
        e, theta, M = bonds.gather(u, self.share)
        theta = theta - self.theta
        tension = self.tension + self.to_e * (e - self.e)
        tension = (
            tension + self.to_own * theta[:, bonds.own] + self.to_other * theta[:, bonds.other]
        )
        return bonds.scatter(M, tension)[:, bonds.rows]

    def __call__(self, v: torch.Tensor) -> torch.Tensor:
        """J v on the interior, shape [I, 2] or [S, I, 2], of v, shape [N, 2] or [S, N, 2]."""
        fields = v.reshape(-1, *self.u.shape[1:])
        with torch.enable_grad():
            u = self.u.expand_as(fields).clone().requires_grad_()
            force = self._force(u)
            seed = torch.zeros_like(force, requires_grad=True)
            (back,) = torch.autograd.grad(force, u, seed, create_graph=True)  # linear in the seed
            (rate,) = torch.autograd.grad(back, seed, fields)
        return rate if v.dim() == 3 else rate[0]

    def transposed(self, w: torch.Tensor) -> torch.Tensor:
        """Jᵗ w on all nodes, shape [N, 2], of w on the interior, shape [I, 2]."""
        with torch.enable_grad():
            u = self.u.clone().requires_grad_()
            (back,) = torch.autograd.grad(self._force(u), u, w[None])
        return back[0]


def _slopes(material: NeuralOperator, *seen: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Force states of bonds and their derivatives to ϑ and e, all of shape [n]."""
    omega, theta, e, r = seen
    with torch.enable_grad():
        by = theta.clone().requires_grad_(), e.clone().requires_grad_()
        state = material.force_state(omega, *by, r)
        return state.detach(), *torch.autograd.grad(state.sum(), by)


def affine(samples: Samples, u: np.ndarray) -> np.ndarray:
    """A field with the interior on the affine motion that fits its collar best, shape [N, 2]."""
    places = np.column_stack([samples.x, np.ones(len(u))])
    collar = ~samples.interior
    motion, *_ = np.linalg.lstsq(places[collar], u[collar], rcond=None)
    return np.where(collar[:, None], u, places @ motion)


SMALL = {torch.float64: 1e-8, torch.float32: 1e-5}
"""Of the solves that an error is told of, by precision."""


@typed
def evaluate(
    material: NeuralOperator,
    samples: Samples,
    *,
    solve: bool = True,
    most: int | None = None,
    tolerance: float | None = None,
    progress: bool = False,
) -> dict[str, Any]:
    """Errors on one set, means over samples and by sample ("samples"), relative ℓ2 norms.

    E_res_abs is ‖force − b‖ [stress/length], E_u the error of the displacement that is solved for
    from zero or, without loads, from the affine motion of the collar, "converged" the share of the
    samples whose equilibrium was found; an E_u is told of all, found or not. A sample without a
    load has no E_res, and nodes that are all interior, as of a periodic sheet, have no E_u. With
    `most`, only the first so many samples are solved.
    """
    placed = material.on(samples.points)
    inside = samples.interior
    loads = np.zeros_like(samples.u) if samples.b is None else samples.loads
    search = EquilibriumSolver(placed) if solve and not inside.all() else None
    enough = SMALL[placed.dtype] if tolerance is None else tolerance
    rows: dict[str, list[float]] = {"E_res": [], "E_res_abs": [], "E_u": [], "converged": []}
    pairs = tqdm(list(zip(samples.u, loads)), disable=not progress, leave=False)
    for number, (u, b) in enumerate(pairs):
        with torch.no_grad():
            miss = float(np.linalg.norm(placed(u) - b[inside]))
        size = float(np.linalg.norm(b[inside]))
        rows["E_res_abs"].append(miss)
        rows["E_res"].append(miss / size if size else np.nan)
        if search is not None and (most is None or number < most):
            if samples.b is None:
                found = search.solve(b, affine(samples, u), tolerance=enough)
            else:
                found = search.solve_by_continuation(b, u, tolerance=enough)
            gap = np.linalg.norm((found.u - u)[inside])
            rows["E_u"].append(float(gap / np.linalg.norm(u[inside])))
            rows["converged"].append(float(found.converged))
    kept = {key: values for key, values in rows.items() if values and np.isfinite(values).all()}
    if not kept:
        raise InputError("samples: expected at least one")
    return {key: float(np.mean(values)) for key, values in kept.items()} | {"samples": kept}
