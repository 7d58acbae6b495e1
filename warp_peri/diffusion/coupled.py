"""Diffusion and mechanics that feel each other: σ = σ_mech + ε φ I (theory, Di5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.core.record import Record, Stress
from warp_peri.diffusion.conductor import Conductivity, DiffusionMaterial, DiffusionOperator
from warp_peri.errors import InputError
from warp_peri.fracture.body import lattice_body
from warp_peri.fracture.bonds import bond_matrix, bonds_of, dilatations
from warp_peri.fracture.statics import check_definite, in_torch, symmetric_factors
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.arrays import checked_fields, plain
from warp_peri.points.samples import PointsLike
from warp_peri.points.unit_names import Units, check_same
from warp_peri.protocols import OperatorBase
from warp_peri.solvers.adjoint import Implicit, stepped
from warp_peri.solvers.solution import Direct, Solution, Solver, refuse_solver


@dataclass(frozen=True, eq=False, repr=False)
class ThermoelasticMaterial(Record, format="warp_peri.coupled_solid"):
    """A solid and what diffuses in it: fields are u₁, u₂ and φ, loads b₁, b₂ and the source.

    L u + ε Φᵗ φ = b and c ∂φ/∂t − ε ∂θ/∂t + L_κ φ = g, θ = Φ u. Φᵗ is minus the nonlocal gradient
    that goes with the dilatation, so that what one side works the other receives.

    Attributes:
        model: of the solid, one influence function.
        conductor: of φ.
        coupling: ε [stress].
        storage: c ≥ 0 [stress].

    Raises InputError for a coupling that is not finite, a storage below 0, and other units of one.
    """

    model: LPSMaterial
    conductor: DiffusionMaterial
    coupling: Stress
    storage: Stress = 0.0
    dimension: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        check_same(self.model.units, self.conductor.units)
        if self.storage < 0:
            raise InputError(f"storage: expected a number ≥ 0, got {self.storage}")

    @property
    def horizon(self) -> float:
        """δ, the longer of the two [length]."""
        return max(self.model.horizon, self.conductor.horizon)

    @property
    def units(self) -> Units:
        """Names of the units of length and stress."""
        return self.model.units

    def on(self, points: PointsLike, *, kappa: Conductivity | None = None) -> CoupledOperator:
        """The solid on a lattice, with a conductivity of its own as of DiffusionOperator."""
        return CoupledOperator(self, points, kappa=kappa)


OF_CONDUCTOR = "conductor_"
"""What names of the conductor's numbers begin with."""


def _of_conductor(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of the conductor by its own names."""
    return {
        name.removeprefix(OF_CONDUCTOR): value
        for name, value in numbers.items()
        if name.startswith(OF_CONDUCTOR)
    }


class CoupledOperator(OperatorBase):
    """A coupled solid on a lattice.

    Args:
        material: the solid.
        points: a lattice; its interior is what is free, of u and of φ.
        kappa: conductivity, as of DiffusionOperator.
        neighbour: with broken bonds, shape [N, B]; those of the lattice by default.

    ``op(u)`` takes u₁, u₂, φ of all nodes, shape [N, 3], and returns what loads and source are in
    the steady state, [I, 3].

    Raises InputError for kernels that change sign and leave one of the two with eigenvalues below
    zero, and as DiffusionOperator.
    """

    is_linear = True
    what = "a coupled solid"
    implicit = 1.0

    def __init__(
        self,
        material: ThermoelasticMaterial,
        points: PointsLike,
        *,
        kappa: Conductivity | None = None,
        neighbour: np.ndarray | None = None,
    ) -> None:
        self.model, model = material, material.model
        self.diffusion = diffusion = DiffusionOperator(material.conductor, points, kappa=kappa)
        self.points = diffusion.points
        body = lattice_body(self.points.x, self.points.spacing, model.horizon)
        table = body.neighbour if neighbour is None else neighbour
        if self.points.box is not None:
            raise InputError("box: a coupled solid is for a body that does not repeat")
        if self.points.outside is not None:
            gone = np.append(self.points.outside, False)
            table = np.where(gone[table] | self.points.outside[:, None], -1, table)
        self.body, self.table = body, table
        bonds = bonds_of(model, body.classes)
        rows = diffusion.rows
        self.rows = rows
        self.free = np.column_stack([2 * rows, 2 * rows + 1]).ravel()
        theta = dilatations(body, bonds.share, table, np.arange(len(table)))
        self._solid = bond_matrix(body, table, bonds)[self.free]
        if (bonds.share < 0).any():
            check_definite(symmetric_factors(self._solid[:, self.free]))
        diffusion.inner()  # refuses one that would grow
        self._pull = sp.csr_array(material.coupling * theta.T)[self.free]
        self._squeeze = sp.csr_array(-material.coupling * theta[rows])
        self._flux = diffusion.matrix()

    @property
    def shape(self) -> tuple[int, ...]:
        """Of one field, [N, 3]."""
        return (len(self.points.x), 3)

    def force(self, u: np.ndarray) -> np.ndarray:
        """On the interior, shape [N, 3] or [S, N, 3] to [..., I, 3]."""
        u = plain("u", u)
        self.check(u)
        if u.ndim > 2:
            return np.stack([self.force(one) for one in u])
        force = self._solid @ u[:, :2].ravel() + self._pull @ u[:, 2]
        return np.column_stack([force.reshape(-1, 2), self._flux @ u[:, 2]])

    def tangent(self, u: np.ndarray) -> sp.csr_array:
        """The force as a matrix, rows of the interior and columns of all nodes, [3 I, 3 N]."""
        return self._whole([[self._solid, self._pull], [None, self._flux]])

    def interior_tangent(self, u: Any) -> sp.csc_array:
        """The force between interior nodes, sparse [3 I, 3 I]."""
        return self.tangent(u).tocsc()[:, np.repeat(self.points.interior, 3)]

    def _whole(self, blocks: list[list[Any]]) -> sp.csr_array:
        """A matrix of the blocks of displacement and φ, in the order of fields."""
        both = sp.block_array(blocks, format="csr")
        rows, columns = (
            np.column_stack([2 * n, 2 * n + 1, 2 * len(n) + n]).ravel()
            for n in map(np.arange, (len(self.rows), len(self.points.x)))
        )
        return both[rows][:, columns]

    def vjp(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """That transposed: of w on the interior, [..., I, 3], on all nodes, [..., N, 3]."""
        w = plain("w", w)
        flat, source = w[..., :2].reshape(*w.shape[:-2], -1), w[..., 2]
        pushed = (flat @ self._solid).reshape(*w.shape[:-2], -1, 2)
        phi = flat @ self._pull + source @ self._flux
        return np.concatenate([pushed, phi[..., None]], axis=-1)

    @property
    def learnable(self) -> dict[str, Any]:
        """λ, μ, α and D of the solid, ε, and the conductor's as conductor_alpha and so on."""
        conductor = {OF_CONDUCTOR + n: value for n, value in self.diffusion.learnable.items()}
        return self.model.model.learnable | {"coupling": self.model.coupling} | conductor

    def at(self, numbers: Mapping[str, Any]) -> CoupledOperator:
        """The same with other numbers; InputError as the class, and for κ not > 0."""
        diffusion = self.diffusion.at(_of_conductor(numbers))
        model = self.model.model.with_parameters(
            {n: numbers[n] for n in self.model.model.learnable}
        )
        material = replace(
            self.model, model=model, conductor=diffusion.model, coupling=float(numbers["coupling"])
        )
        return CoupledOperator(material, self.points, kappa=diffusion.given, neighbour=self.table)

    def force_with_parameters(self, u: Any, numbers: Any) -> Any:
        """The force of tensors [S, N, 3] with other numbers, differentiable once in all."""
        field, phi = u[..., :2], u[..., 2]
        parts = self.model.model, self.body, self.table
        force = in_torch().bond_force(*parts, field, numbers, numbers["coupling"] * phi)
        flux = self.diffusion.force_with_parameters(phi, _of_conductor(numbers))
        return in_torch().torch.cat([force[:, self.rows], flux[..., None]], dim=-1)

    def solve(self, b: ArrayLike | None, u: ArrayLike, solver: Solver = None) -> Solution:
        """The steady state.

        Args:
            b: loads and source, [N, 3] or [S, N, 3], read on the interior; None for none.
            u: displacement and φ, same shape, read off the interior.
            solver: Direct().

        Raises InputError for other shapes, or a solve that loses its digits.
        """
        refuse_solver(solver, (Direct,), self.what)
        load, given = checked_fields(self.points, b, u, self.shape)
        Implicit(self).rest(load, given)
        return Solution(given, self.points, self, self.rhs(load), "lu")

    march = stepped  # by backward Euler, b a load or a function of time

    def storage(self) -> sp.csr_array:
        """What multiplies the rates of u₁, u₂ and φ, sparse [3 I, 3 N]."""
        kept = sp.eye_array(len(self.points.x), format="csr")[self.rows]
        return self._whole(
            [[0 * self._solid, 0 * self._pull], [self._squeeze, self.model.storage * kept]]
        )

    def storage_slopes(self, names: list[str], rates: np.ndarray, w: np.ndarray) -> dict[str, Any]:
        """Derivatives of Σ w · storage() rates to numbers, of rates [K, N, 3], w [K, I, 3]."""
        torch = in_torch().torch
        own = self.model.model.learnable | {"coupling": self.model.coupling}
        asked = [name for name in names if name in own]
        if not asked:
            return {}
        with torch.enable_grad():
            numbers = {
                name: torch.tensor(value, dtype=torch.float64, requires_grad=name in asked)
                for name, value in own.items()
            }
            phi = torch.from_numpy(self.on_all(w)[..., 2])
            parts = self.model.model, self.body, self.table
            rate = torch.from_numpy(np.ascontiguousarray(rates[..., :2]))
            pull = in_torch().bond_force(*parts, 0 * rate, numbers, numbers["coupling"] * phi)
            each = torch.autograd.grad(
                -(rate * pull).sum(), [numbers[name] for name in asked], allow_unused=True
            )
        return {name: one.numpy() for name, one in zip(asked, each) if one is not None}
