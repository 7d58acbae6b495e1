"""Diffusion and mechanics that feel each other: σ = σ_mech + ε φ I (theory, Di5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
import torch

from warp_peri.core.record import Record, Stress
from warp_peri.diffusion.conductor import (
    Conductivity,
    DiffusionMaterial,
    DiffusionOperator,
    FlowOperator,
)
from warp_peri.errors import InputError
from warp_peri.fracture.adjoint import bond_force
from warp_peri.fracture.body import lattice_body
from warp_peri.fracture.bonds import bond_matrix, bonds_of, dilatations
from warp_peri.fracture.statics import INDEFINITE
from warp_peri.materials.lps import LPSMaterial
from warp_peri.points.points import PointsLike
from warp_peri.points.unit_names import Units, check_same
from warp_peri.solvers.direct import definite_factors


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

    def with_parameters(self, numbers: Mapping[str, Any]) -> ThermoelasticMaterial:
        """The same with other numbers of the solid, and another coupling."""
        own = {name: numbers[name] for name in self.model.learnable}
        return replace(
            self, model=self.model.with_parameters(own), coupling=float(numbers["coupling"])
        )

    def on(self, points: PointsLike, *, kappa: Conductivity | None = None) -> CoupledOperator:
        """The solid on a lattice, with a conductivity of its own as of DiffusionOperator."""
        return CoupledOperator(self, points, kappa=kappa)


OF_CONDUCTOR = "conductor_"
"""What names of the conductor's numbers begin with."""


class CoupledOperator(FlowOperator):
    """A coupled solid on a lattice.

    Args:
        material: the solid.
        points: a lattice; its interior is what is free, of u and of φ.
        kappa: conductivity, as of DiffusionOperator.

    ``op(u)`` takes u₁, u₂, φ of all nodes, shape [N, 3], and returns what loads and source are in
    the steady state, [I, 3].

    Raises InputError for kernels that change sign and leave one of the two with eigenvalues below
    zero, and as DiffusionOperator.
    """

    implicit = 1.0

    def __init__(
        self,
        material: ThermoelasticMaterial,
        points: PointsLike,
        *,
        kappa: Conductivity | None = None,
    ) -> None:
        self.model, model = material, material.model
        self.diffusion = diffusion = DiffusionOperator(material.conductor, points, kappa=kappa)
        self.points, self.rows = nodes, rows = diffusion.points, diffusion.rows
        if nodes.box is not None:
            raise InputError("box: a coupled solid is for a body that does not repeat")
        self.body = body = lattice_body(nodes.x, nodes.spacing, model.horizon)
        self.table = table = body.neighbour
        if nodes.outside is not None:
            gone = np.append(nodes.outside, False)
            self.table = table = np.where(gone[table] | nodes.outside[:, None], -1, table)
        bonds, free = bonds_of(model, body.classes), np.ravel(2 * rows[:, None] + [0, 1])
        theta = dilatations(body, bonds.share, table, np.arange(len(table)))
        solid = bond_matrix(body, table, bonds)[free]
        if (bonds.share < 0).any() and definite_factors(solid[:, free]) is None:
            raise InputError(INDEFINITE)
        diffusion.interior_tangent(None)  # refuses one that would grow
        pull = sp.csr_array(material.coupling * theta.T)[free]
        squeeze = sp.csr_array(-material.coupling * theta[rows])
        self.matrix = self._whole([[solid, pull], [None, diffusion.matrix]])
        kept = material.storage * diffusion.storage()
        self._storage = self._whole([[0 * solid, 0 * pull], [squeeze, kept]])

    @property
    def shape(self) -> tuple[int, ...]:
        """Of one field, [N, 3]."""
        return (len(self.points.x), 3)

    def _whole(self, blocks: list[list[Any]]) -> sp.csr_array:
        """A matrix of the blocks of displacement and φ, in the order of fields."""
        both = sp.block_array(blocks, format="csr")
        rows, columns = (
            np.column_stack([2 * n, 2 * n + 1, 2 * len(n) + n]).ravel()
            for n in map(np.arange, (len(self.rows), len(self.points.x)))
        )
        return both[rows][:, columns]

    @property
    def learnable(self) -> dict[str, Any]:
        """λ, μ, α and D of the solid, ε, and the conductor's as conductor_alpha and so on."""
        conductor = {OF_CONDUCTOR + n: value for n, value in self.diffusion.learnable.items()}
        return self.model.model.learnable | {"coupling": self.model.coupling} | conductor

    def _of_conductor(self, numbers: Mapping[str, Any]) -> dict[str, Any]:
        return {name: numbers[OF_CONDUCTOR + name] for name in self.diffusion.learnable}

    def at(self, numbers: Mapping[str, Any]) -> CoupledOperator:
        """The same with other numbers; InputError as the class, and for κ not > 0."""
        diffusion = self.diffusion.at(self._of_conductor(numbers))
        material = replace(self.model.with_parameters(numbers), conductor=diffusion.model)
        return CoupledOperator(material, self.points, kappa=diffusion.given)

    def force_with_parameters(self, u: Any, numbers: Any) -> Any:
        """The force of tensors [S, N, 3] with other numbers, differentiable once in all."""
        field, phi = u[..., :2], u[..., 2]
        parts = self.model.model, self.body, self.table
        force = bond_force(*parts, field, numbers, numbers["coupling"] * phi)
        flux = self.diffusion.force_with_parameters(phi, self._of_conductor(numbers))
        return torch.cat([force[:, self.rows], flux[..., None]], dim=-1)

    def storage(self) -> sp.csr_array:
        """What multiplies the rates of u₁, u₂ and φ, sparse [3 I, 3 N]."""
        return self._storage

    def storage_slopes(self, names: list[str], rates: np.ndarray, w: np.ndarray) -> dict[str, Any]:
        """Derivatives of Σ w · storage() rates to numbers, of rates [K, N, 3], w [K, I, 3]."""
        with torch.enable_grad():
            numbers = {
                name: torch.tensor(value, dtype=torch.float64, requires_grad=True)
                for name, value in self.learnable.items()
            }
            phi = torch.from_numpy(self.on_all(w)[..., 2])
            parts = self.model.model, self.body, self.table
            rate = torch.from_numpy(np.ascontiguousarray(rates[..., :2]))
            pull = bond_force(*parts, 0 * rate, numbers, numbers["coupling"] * phi)
            asked = [numbers[name] for name in names]
            each = torch.autograd.grad(-(rate * pull).sum(), asked, allow_unused=True)
        return {name: one.numpy() for name, one in zip(names, each) if one is not None}
