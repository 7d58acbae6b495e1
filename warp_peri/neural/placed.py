"""Operator of a neural material on a lattice: force, tangent, equilibria, errors."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy import ndarray
from numpy.linalg import lstsq, norm
from numpy.typing import ArrayLike
from tqdm import tqdm

from warp_peri.core.elastic import checked_orientation, in_shape_of
from warp_peri.core.stencil import numbers_at
from warp_peri.core.torch_bridge import on_fields
from warp_peri.errors import InputError, Values
from warp_peri.fitting.evaluate import errors_of
from warp_peri.fitting.regression import norms
from warp_peri.points.arguments import check_shape, typed
from warp_peri.points.dataset import warn_of_unseen
from warp_peri.points.families import families_of
from warp_peri.points.points import PointsLike, Samples, nodes_of
from warp_peri.protocols import OperatorBase
from warp_peri.solvers.equilibria import Equilibria, equilibria_of, probed
from warp_peri.solvers.linear import Inverse, Linear
from warp_peri.solvers.solution import Solution, Solver

if TYPE_CHECKING:
    from warp_peri.neural.material import NeuralOperator

SOLVED = 1e-5
"""Tolerance of the equilibria of frames."""
ROUNDING = 16
"""In units of the networks' precision: a residual that steps of Newton no longer lower."""
LOADS = 8
"""Loads that the solid at rest is set up for."""


class EquilibriumSolver(Equilibria):
    """Solver for equilibria of one operator, preconditioned by its stencil at rest."""

    def __init__(self, placed: Placed) -> None:
        points = placed.points
        if points.interior.all():
            raise InputError("points: expected a collar; without one u is known up to a motion")
        linear = Linear(probed(placed), points)
        inverse = linear.cheapest_inverse(LOADS, definite=False)
        ways = placed, lambda u: linear(u[None])[0], inverse, points.interior
        super().__init__(*ways, rounding=ROUNDING * torch.finfo(placed.dtype).eps)


CELLS = 16
"""Of the grid, along the range of the dilatation and that of the extension."""
MARGIN = 1 + 1e-4
"""Grids are so much larger than the range of the values."""


def interpolated_force(
    placed: Placed, u: torch.Tensor, *, cells: int = CELLS, offset: tuple[float, float] = (0.5, 0.5)
) -> torch.Tensor:
    """Forces on the interior [stress/length], [S, I, 2], in u [S, N, 2], by an interpolated state.

    The grid has `cells` + 1 cells along both axes and begins a share of a cell below the range,
    `offset`: drawn anew in each step of a training. The error falls with the square of 1/cells.
    """
    material, size = placed.material, cells + 2
    omega, share, r = placed.shares(u.dtype)
    every, theta, M = placed.stretch(u, share)
    kinds = np.arange(len(placed.xi)) if material.anisotropic else placed.kind
    first = np.unique(kinds, return_index=True)[1]
    kind = torch.as_tensor(kinds[placed.place])
    e, theta = every[:, placed.node, placed.place], theta[:, placed.node]
    furthest = e.detach().abs().amax(dim=0)
    most = furthest.new_zeros(len(first)).scatter_reduce(0, kind, furthest, "amax")
    low, step = _range(theta.detach().abs().max(), cells, offset[0])
    least, rise = _range(most, cells, offset[1])
    n = torch.arange(size)
    k, row, column = torch.cartesian_prod(torch.arange(len(first)), n, n).T
    table = material.force_state(
        omega[first][k], low + column * step, least[k] + row * rise[k], r[first][k]
    ).reshape(1, 1, len(first), size, size)
    x, y = (theta - low) / step, (e - least[kind]) / rise[kind]
    last = torch.tensor([size - 1, size - 1, max(len(first) - 1, 1)])
    at = 2 * torch.stack([x, y, kind.expand_as(e)], dim=-1) / last - 1
    tension = torch.nn.functional.grid_sample(table, at[None, None], align_corners=True)
    return placed.force_of(tension[0, 0, 0], M)


def _range(most: torch.Tensor, cells: int, offset: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Start and step of a grid over values from −most to most."""
    most = most * MARGIN + torch.finfo(most.dtype).tiny
    step = 2 * most / cells
    return -most - offset * step, step


class Placed(OperatorBase):
    """Minus the internal force density of a neural operator on a lattice; b in equilibrium.

    Attributes:
        xi: bond vectors of a family [length], shape [B, 2], r their lengths.
        kind: class of each bond of a family by length, shape [B].
        whole: nodes with whole families, whose dilatation is known, shape [F].
        ends: the node at each of their bonds, shape [F, B].
        own: places of the interior nodes among the whole ones, shape [I].
        node, place: the bonds with an interior end, once each, by their first node among the whole
            ones and their number in its family, shape [A].
        forward, back: numbers among these of the bonds of the interior nodes, and of the same bonds
            from their other end, shape [I, B].

    Raises InputError for points in space or scattered, broken bonds, or no 2δ collar.
    """

    def __init__(self, material: NeuralOperator, points: PointsLike) -> None:
        self.model = self.material = material
        if points.x.shape[1] != 2:
            raise InputError(f"points: expected a plane, got {points.x.shape[1]} dimensions")
        if points.outside is not None:
            raise InputError("points: expected none outside of the body")
        check_precision({part.dtype for part in self.networks})
        families = families_of(points, material.horizon)
        self.points, self.kind = nodes_of(points), families.classes.bond_class
        self.xi, self.whole = families.pattern, families.whole
        self.r = np.hypot(*self.xi.T)
        self.ends = families.neighbour.reshape(-1, len(self.xi))[self.whole]
        row = numbers_at(len(points.x), self.whole)
        self.own = row[families.rows]
        acts = points.interior[self.whole][:, None] | points.interior[self.ends]
        number = np.cumsum(acts).reshape(acts.shape) - 1
        self.node, self.place = np.nonzero(acts)
        self.forward = number[self.own]
        self.back = number[row[self.ends[self.own]], families.reverse]

    def stretch(self, u: torch.Tensor, share: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Extensions |Y| − |ξ| [S, F, B], dilatations [S, F], Y/|Y| [S, I, B, 2] (NO3)."""
        xi, r = (torch.as_tensor(one, dtype=u.dtype) for one in (self.xi, self.r))
        eta = u[:, self.ends] - u[:, self.whole, None]
        Y = xi + eta
        length = torch.linalg.vector_norm(Y, dim=-1)
        e = ((2 * xi + eta) * eta).sum(dim=-1) / (length + r)  # without the cancellation
        length = length[:, self.own]
        return e, e @ share, Y[:, self.own] / torch.where(length > 0, length, 1.0)[..., None]

    def inverse(self, loads: int) -> Inverse:
        """Inverse of the force's linear part at rest, for `loads` loads on the interior."""
        return EquilibriumSolver(self).inverse

    def errors(self, samples: Samples) -> Values:
        """Errors on samples for `evaluate`; samples without an equilibrium are told apart."""
        return evaluate(self.model, samples)

    def solve(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Solve with b on the interior, u given on the collar; details are a NonlinearRecord for
        each sample. InputError for arrays that do not fit, and a sample without an equilibrium."""
        exact = self  # single precision may not reach the tolerance
        if self.dtype != torch.float64:
            exact = copy.deepcopy(self.material).double().on(self.points)
        return equilibria_of(self, b, u, solver, EquilibriumSolver(exact))

    @property
    def networks(self) -> tuple[torch.nn.Parameter, ...]:  # type: ignore[override]
        """Weights of the networks."""
        return tuple(self.material.parameters())

    def force_torch(self, u: torch.Tensor) -> Any:
        """Forces on the interior, (NO6), differentiable in the weights too."""
        if not any(p.requires_grad for p in self.networks):
            return super().force_torch(u)
        return on_fields(self, u, lambda f: self.force_of(*self.tension(f.to(self.dtype))))

    @torch.no_grad()
    def force(self, u: Any) -> ndarray:
        """Forces on the interior, shape [..., I, 2], (NO6)."""
        return in_shape_of(u, self.force_of(*self.tension(self._taken(u))).double().numpy())

    def jvp(self, u: Any, v: Any) -> ndarray:
        """Derivative of the force at u along v, both [N, 2] or [S, N, 2]."""
        fields, along = self._taken(u), self._taken(v)
        check_shape("v, along u", along, fields.shape)
        found = [self.tangent(field) @ one.ravel() for field, one in zip(fields, along.numpy())]
        return np.reshape(found, (*np.shape(v)[:-2], -1, 2))

    def vjp(self, u: Any, w: Any) -> ndarray:
        """Transposed derivative of the force at u times w [..., I, 2], on all nodes [..., N, 2]."""
        pairs = zip(*self.pairs(u, w))
        found = [self.tangent(field).T @ one.ravel() for field, one in pairs]
        return np.reshape(found, np.shape(u))

    def interior_tangent(self, u: ndarray) -> sp.csc_array:
        """Derivative of the force at a field, between interior nodes, sparse [2 I, 2 I]."""
        return sp.csc_array(self.tangent(u)[:, np.repeat(self.points.interior, 2)])

    @torch.inference_mode(False)
    def tangent(self, u: Any) -> sp.csr_array:
        """Tangent ∂force/∂u at one field [N, 2], interior by all nodes, sparse [2 I, 2 N] (NO9)."""
        fields = self._taken(u)
        check_shape("u, one field", fields, (1, *self.shape))
        x = fields[0].double().numpy()
        with torch.no_grad():
            omega, share, r = self.shares(self.dtype)
            e, theta, _ = self.stretch(fields, share)
            omega, theta, e, r = self.inputs(omega, theta, e, r)
        by = theta.clone().requires_grad_(), e.clone().requires_grad_()
        state = self.material.force_state(omega, *by, r)
        slopes = torch.autograd.grad(state.sum(), by)
        t, to_theta, to_e = (one.detach().double().numpy() for one in (state, *slopes))
        Y = self.xi + x[self.ends] - x[self.whole][:, None]
        length = norm(Y, axis=-1)[..., None]
        M, own, node, place = Y / length, self.own, self.node, self.place
        along, far = M[node, place][:, None, None], self.ends[node, place][:, None]
        by_e = sp.diags_array(to_e) @ _differences(along, far, self.whole[node], len(x))
        average = (share.double().numpy()[:, None] * M)[:, :, None]
        dilatation = _differences(average, self.ends, self.whole, len(x))
        by_theta = sp.csr_array((to_theta, node, np.arange(len(t) + 1)), (len(t), len(M)))
        both = np.concatenate([self.forward, self.back], axis=1)
        pull = _blocks(np.tile(M[own], (1, 2, 1))[..., None], both, len(t))
        J = pull @ by_e + (pull @ by_theta) @ dilatation
        across = np.eye(2) - M[own][..., :, None] * M[own][..., None, :]
        turning = ((t[self.forward] + t[self.back])[..., None] / length[own])[..., None] * across
        J = J + _differences(turning, self.ends[own], self.whole[own], len(x))
        return sp.csr_array(-(self.points.spacing**2) * J)

    @torch.no_grad()
    def stress(self, u: Any) -> ndarray:
        """First Piola–Kirchhoff stress at interior nodes, [..., I, 2, 2], ½ Σ t M ⊗ ξ (NO13)."""
        pull = self._pull(*self.tension(self._taken(u)))
        stress = torch.einsum("sibx,by->sixy", pull, torch.as_tensor(self.xi, dtype=pull.dtype))
        return in_shape_of(u, self.points.spacing**2 / 2 * stress.double().numpy())

    def tension(self, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Force states [stress/length³] of interior nodes' bonds [S, A], and directions Y/|Y|."""
        omega, share, r = self.shares(u.dtype)
        e, theta, M = self.stretch(u, share)
        return self.material.force_state(*self.inputs(omega, theta, e, r)).reshape(len(u), -1), M

    def _pull(self, tension: torch.Tensor, M: torch.Tensor) -> torch.Tensor:
        """Sum the force states of both ends along the interior nodes' bonds, [S, I, B, 2]."""
        return (tension[:, self.forward] + tension[:, self.back])[..., None] * M

    def force_of(self, tension: torch.Tensor, M: torch.Tensor) -> torch.Tensor:
        """Forces on the interior [S, I, 2] from the results of `tension`."""
        area: float = self.points.spacing**2
        return self._pull(tension, M).sum(dim=2) * -area

    def shares(self, dtype: torch.dtype) -> tuple[torch.Tensor, ...]:
        """Influence ω of a family's bonds, dilatation weight ω |ξ| / Σ ω |ξ|², length, each [B]."""
        material = self.material
        turned = checked_orientation(self.points.axis, 2)  # directions are those of the material
        xi = torch.as_tensor(self.xi @ turned, dtype=dtype)
        r = torch.tensor(self.r, dtype=dtype)
        if material.anisotropic:
            omega = material.omega(xi)
        else:  # one value for a class
            _, first, kind = np.unique(self.kind, return_index=True, return_inverse=True)
            omega = material.omega(xi[first])[kind]
        return omega, omega * r / (omega * r**2).sum(), r

    def inputs(
        self, omega: torch.Tensor, theta: torch.Tensor, e: torch.Tensor, r: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        """Inputs of the force state for the bonds with an interior end, each of shape [S A]."""
        e = e[:, self.node, self.place]
        parts = omega[self.place], theta[:, self.node], e, r[self.place]
        return tuple(part.expand_as(e).reshape(-1) for part in parts)

    @property
    def dtype(self) -> torch.dtype:
        """The material's precision."""
        return self.networks[0].dtype

    def _taken(self, u: Any) -> torch.Tensor:
        """Convert fields to [S, N, 2] in the material's precision; InputError for other shapes."""
        fields = np.ascontiguousarray(self.as_fields(u).reshape(-1, *self.shape))
        return torch.as_tensor(fields, dtype=self.dtype)


def _differences(blocks: ndarray, ends: ndarray, own: ndarray, count: int) -> sp.bsr_array:
    """Matrix of Σ over bonds of blocks [n, B, k, 2] times v_end − v_own, sparse [k n, 2 count]."""
    blocks = np.concatenate([blocks, -blocks.sum(axis=1, keepdims=True)], axis=1)
    return _blocks(blocks, np.column_stack([ends, own]), count)


def _blocks(values: ndarray, columns: ndarray, count: int) -> sp.bsr_array:
    """Sparse matrix [k n, c count] of blocks [n, m, k, c] in the columns [n, m]."""
    (n, m), (*_, k, c) = columns.shape, values.shape
    blocks = values.reshape(-1, k, c), columns.ravel(), m * np.arange(n + 1)
    return sp.bsr_array(blocks, shape=(k * n, c * count))


def affine(samples: Samples, u: ndarray) -> ndarray:
    """Replace the interior of a field by the affine motion that fits its collar best, [N, 2]."""
    places, collar = np.column_stack([samples.x, np.ones(len(u))]), ~samples.interior
    motion, *_ = lstsq(places[collar], u[collar])
    return np.where(collar[:, None], u, places @ motion)


SMALL = {torch.float64: 1e-8, torch.float32: 1e-5}
"""Of the solves that an error is told of, by precision."""


def check_precision(kinds: set[torch.dtype]) -> None:
    """Raise InputError for weights that are not all of one precision that forces are had in."""
    if len(kinds) > 1 or not kinds <= {*SMALL}:
        raise InputError(f"networks: expected weights all of float32 or of float64, got {kinds}")


@typed
def evaluate(
    material: NeuralOperator, samples: Samples, *, solve: bool = True, progress: bool = False
) -> Values:
    """Evaluate a neural material on samples: mean relative ℓ2 errors, and by sample (E_u_samples).

    E_res_abs is ‖force − b‖ [stress/length]; E_u the error of the solved displacement from zero, or
    from the collar's affine motion without loads, found or not; "converged" the share of equilibria
    found. Without loads there is no E_res, of a sample without one None; without a collar no E_u,
    of a sample at rest None. Raises InputError for no samples.
    """
    if not len(samples):
        raise InputError("samples: expected at least one")
    warn_of_unseen(samples)
    placed, inside = material.on(samples.points), samples.interior
    loads = np.zeros_like(samples.u) if samples.b is None else samples.loads
    search = EquilibriumSolver(placed) if solve and not inside.all() else None
    enough = SMALL[placed.dtype]
    miss, wrong, there = [], [], []
    for u, b in tqdm(list(zip(samples.u, loads)), disable=not progress, leave=False):
        miss.append(norm(placed.force(u) - b[inside]))
        if search is not None:
            found, converged = np.where(inside[:, None], 0.0, u), False
            if samples.b is None:
                found, record = search.solve_from(b[inside], affine(samples, u), enough)
                converged = record.converged
            else:
                try:
                    found, converged = search.solve(b[inside], u, enough)[0], True
                except InputError:  # the linear answer
                    found[inside] = search.inverse(b[inside] - search.straight(found), enough)
            wrong.append(norm((found - u)[inside]))
            there.append(converged)
    table = errors_of("E_res_abs", miss)
    if samples.b is not None:
        table |= errors_of("E_res", miss, norms(loads[:, inside]))
    if search is not None:
        table |= errors_of("E_u", wrong, norms(samples.u[:, inside]))
        table |= errors_of("converged", there)
    return table
