"""A solid of third order on a lattice: force, tangent, energy, stress, equilibria (N1–N12, N24)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy.typing import ArrayLike

from warp_peri.contract import OnPoints, stencil_of
from warp_peri.core.proof import largest
from warp_peri.errors import InputError
from warp_peri.launch import floats
from warp_peri.points.arrays import checked_fields, plain
from warp_peri.points.samples import PointsLike, axis_of, nodes_of
from warp_peri.stability.certificate import smallest_eigenvalue
from warp_peri.statics.equilibria import SOLVES, Equilibria, figures_of, solve_each, warn_beyond
from warp_peri.statics.linear import DIRECT, Inverse
from warp_peri.statics.lps import bonds_within
from warp_peri.statics.solution import Newton, Solution, Solver, refuse_solver
from warp_peri.third_order.sweeps import GradientSweeps, Numbers, TangentMatrices, third_order_force

if TYPE_CHECKING:
    from warp_peri.third_order.material import ThirdOrderCrystal


class PlacedThirdOrder(OnPoints):
    """Minus the internal force density of a solid of third order; b in equilibrium.

    Args:
        material: certified on some lattice.
        points: a lattice, whose interior has a collar as wide as the linear part needs and twice
            the gradient's horizon; their axis is that of the crystal, x where none is stated, which
            is said once.
        transfer: False refuses lattices that the material itself is not certified on.
        allow_uncertified: take what holds no certificate, with a warning.
        radius: largest |H| that the stress sees, projected to it from beyond (N10); 0 for none.

    Attributes:
        home: the material that was given.
        model: the one that is used, its linear part transferred where need be.
        numbers: of the solid on these nodes.

    Raises InputError for scattered points, nodes without the collar, other units, and an
    uncertified spacing.
    """

    def __init__(
        self,
        material: ThirdOrderCrystal,
        points: PointsLike,
        *,
        transfer: bool = True,
        allow_uncertified: bool = False,
        radius: float = 0.0,
    ) -> None:
        self.home, self.points = material, nodes_of(points)
        given = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        self.model = here = material.at(self.points, **given)
        self.sweeps = GradientSweeps(self.points, here.horizon)
        axis = axis_of(self.points) if here.q3 else 0.0
        tables = here.tables(self.sweeps, self.points)
        self.numbers = Numbers(tables, here.numbers_at(axis), float(radius))

    @cached_property
    def straight(self) -> Any:
        """The linear part alone, on the same nodes."""
        return self.model.linear.on(self.points)

    @cached_property
    def _matrices(self) -> TangentMatrices:
        return TangentMatrices(self.sweeps, self.numbers)

    def force(self, u: ArrayLike) -> np.ndarray:
        """L u [stress/length] on the interior nodes, shape [..., I, 2]."""
        Lu = self.sweeps.force(self._flat(u), self.numbers).numpy()
        return np.asarray(Lu.reshape(*np.shape(u)[:-2], -1, 2))

    @property
    def learnable(self) -> dict[str, float]:
        """The constants of third order [stress]."""
        return {name: getattr(self.model, name) for name in ("t3", "tq2", "q3")}

    def force_with(self, u: torch.Tensor, numbers: dict[str, torch.Tensor]) -> torch.Tensor:
        """The force of fields [S, N, 2] with other constants, differentiable once in all."""
        of, turned = self.numbers, np.exp(-6j * axis_of(self.points))
        t3, tq2, q3 = (numbers[name] for name in self.learnable)
        lame = torch.from_numpy(of.cubic[:2].copy())
        constants = torch.stack([t3, tq2, q3 * turned.real, q3 * turned.imag])
        given = torch.from_numpy(of.tables), torch.cat([lame, constants])
        return third_order_force(self.sweeps, u, *given, radius=of.radius)

    def at(self, numbers: Mapping[str, Any]) -> PlacedThirdOrder:
        """The same with other constants, of which nothing is proven."""
        own = {name: float(value) for name, value in numbers.items()}
        model: Any = self.model
        return self._of(replace(model, **own, proven={}))

    def clipped(self, radius: float) -> PlacedThirdOrder:
        """The same with stresses of gradients clipped to a radius (N10)."""
        return self._of(self.model, radius=radius)

    def _of(self, model: Any, **more: Any) -> PlacedThirdOrder:
        """Another model of the same linear part on the same nodes."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # said of this one
            given: dict[str, Any] = {"transfer": False, "allow_uncertified": True}
            return PlacedThirdOrder(model, self.points, **given, **more)

    def gradients(self, u: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """H and P [stress] at the nodes `sweeps.full`, each of shape [..., F, 2, 2]."""
        field = _array(u)
        H, P = self.sweeps.gradients(self._flat(field), self.numbers)
        shape = (*field.shape[:-2], len(self.sweeps.full), 2, 2)
        return H.reshape(shape), P.reshape(shape)

    def largest_gradient(self, u: ArrayLike) -> np.ndarray:
        """Largest |H| of each field over the nodes within δ of the interior, shape [...]."""
        H, _ = self.gradients(u)
        largest: np.ndarray = np.linalg.norm(H, axis=(-2, -1)).max(axis=-1)
        return largest

    def tangent(self, u: ArrayLike) -> sp.csr_array:
        """∂(L u)/∂u at a field [N, 2], without clipping: sparse, shape [2 I, 2 N] (N5)."""
        return self._matrices.tangent(self.sweeps.curvatures(self._flat(u), self.numbers))

    def product(self, u: ArrayLike, v: ArrayLike) -> np.ndarray:
        """The derivative at u along v, shape [..., I, 2]."""
        rate = self.sweeps.product(self._flat(u), self._flat(v), self.numbers).numpy()
        return np.asarray(rate.reshape(*np.shape(u)[:-2], -1, 2))

    def product_transpose(self, u: ArrayLike, w: ArrayLike) -> np.ndarray:
        """The transposed product with w on the interior [..., I, 2], on all nodes [..., N, 2]."""
        g = floats(_array(w).reshape(-1, len(self.sweeps.rows), 2), self.sweeps.kernels.vec)
        by_u, _ = self.sweeps.adjoint(self._flat(u), self.numbers, g, parameters=False)
        return np.asarray(by_u.numpy().reshape(np.shape(u)))

    def energy(self, u: np.ndarray) -> np.ndarray | None:
        """Of the linear part, and h² Σ Ψ(H) [stress · length²], shape [...], up to what the collar
        alone has: its derivative to the interior displacement is h² L u (N1, N24). None of the
        filtered form."""
        if self.model.form != "energy":
            return None
        H, _ = self.gradients(u)
        own = energy_density(H, self.numbers.cubic).sum(axis=-1)
        return np.asarray(self.straight.energy(u) + self.points.spacing**2 * own)

    def stiffest_wave(self) -> float:
        """A bound on the eigenvalues of the tangent [stress / length²] up to the proven strain, for
        time steps: twice that of the linear part (N15).

        Raises InputError for the filtered form, which has no energy that a motion could keep.
        """
        if self.model.form != "energy":
            raise InputError(
                "move: expected form='energy', got 'filtered', whose force is no gradient: its "
                "waves would gain or lose energy"
            )
        return 2 * largest(*stencil_of(self.model.linear, self.points.spacing, "move"))

    def stress(self, u: np.ndarray) -> np.ndarray:
        """σ of the linear part and P of Ψ [stress] at the interior nodes, [..., I, 2, 2] (N2)."""
        _, P = self.gradients(u)
        inside = self.points.interior[self.sweeps.full]
        return np.asarray(self.straight.stress(u) + P[..., inside, :, :])

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of the linear part, of a load on the interior: factorised, or by iteration."""
        bonds = bonds_within(self.model.horizon, self.points.spacing)
        inverse: Inverse = self.straight.linear.cheapest_inverse(SOLVES * loads, bonds)
        return inverse

    def figures(self, solution: Solution) -> dict[str, Any]:
        """What solves took, and whether their answers are the only ones, for `evaluate`."""
        return figures_of(solution.details)

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar.

        Args:
            b: body force density [stress/length], [N, 2] or [S, N, 2]; only interior values count.
            u: displacement [length], same shape; only collar values count.
            solver: Newton(…).

        A UserWarning says where |H| exceeds the proven strain, so that another solution is not
        ruled out. The details of the solution are one NonlinearRecord for each sample.

        Raises InputError for arrays that do not fit, and a sample for which no equilibrium was
        found.
        """
        refuse_solver(solver, (Newton,), "a nonlinear solid")
        asked = solver if isinstance(solver, Newton) else Newton()
        load, field = checked_fields(self.points, b, u)
        inside, nodes = self.points.interior, len(self.points.x)
        answers = field.reshape(-1, nodes, 2)
        proven = self.model.proven_strain(self.points.spacing)
        clipped = (lambda: self.clipped(proven)) if proven > 0 else None
        way = Equilibria(self, self.straight, self.inverse(len(answers)), inside, clipped)
        few = asked.eigenvalues and np.count_nonzero(inside) <= DIRECT
        smallest = self._smallest if few else None
        loads, largest = load.reshape(-1, nodes, 2)[:, inside], self.largest_gradient
        records, sure = solve_each(way, loads, answers, asked.tolerance, proven, largest, smallest)
        warn_beyond(records, proven)
        return Solution(
            answers.reshape(field.shape),
            self.points,
            self,
            self.load(load),
            records[0].method if len({r.method for r in records}) == 1 else "fixed point, newton",
            tuple(record.solves for record in records),
            sure,
            details=tuple(records),
            measured=max((record.residual for record in records), default=None),
        )

    def _smallest(self, field: np.ndarray) -> float:
        """Smallest eigenvalue of the symmetric part of the tangent on the unknowns."""
        rows = self.sweeps.rows
        unknown = np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()
        tangent = sp.csr_array(self.tangent(field).tocsc()[:, unknown])
        return smallest_eigenvalue(sp.csc_array((tangent + tangent.T) / 2))

    def _flat(self, u: ArrayLike) -> Any:
        """Fields as the kernels read them, shape [S, N] of vectors."""
        self.check(field := _array(u))
        return floats(field.reshape(-1, *self.shape), self.sweeps.kernels.vec)


def _array(u: ArrayLike) -> np.ndarray:
    return np.require(plain("u", u), float, ["C", "W"])


def energy_density(H: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Ψ of (N3) [stress] at displacement gradients of shape [..., 2, 2].

    `numbers` are λ, μ, t3, tq2, Re and Im of q3 e^(−6ia), as ThirdOrderCrystal.numbers_at.
    """
    lam, mu, t3, tq2, *turned = numbers
    small = (H + H.swapaxes(-1, -2)) / 2
    square = H.swapaxes(-1, -2) @ H / 2
    E = small + square
    trace, added = (np.trace(of, axis1=-2, axis2=-1) for of in (small, square))
    # of the harmonic part only what the square adds: the linear solid has the rest
    density = lam / 2 * added * (2 * trace + added)
    density += mu * (square * (2 * small + square)).sum(axis=(-2, -1))
    t = trace + added
    q = (E[..., 0, 0] - E[..., 1, 1]) / 2 + 1j * E[..., 0, 1]
    cubic = t3 * t**3 + tq2 * t * np.abs(q) ** 2 + (complex(*turned) * q**3).real
    return np.asarray(density + cubic)
