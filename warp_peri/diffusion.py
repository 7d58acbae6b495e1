"""Nonlocal diffusion (theory, Di) alone, and coupled with mechanics: σ = σ_mech + ε φ I (Di5)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse as sp
import torch
from numpy import ndarray
from numpy.typing import ArrayLike

from warp_peri.core.record import FieldUnits, Length, Record, Stress
from warp_peri.core.torch_bridge import own_torch
from warp_peri.errors import OF_POSITIONS, InputError, Shape, Values, called, kept
from warp_peri.fracture.adjoint import bond_force
from warp_peri.fracture.body import lattice_body
from warp_peri.fracture.bonds import bond_matrix, bonds_of, dilatations
from warp_peri.fracture.statics import INDEFINITE
from warp_peri.materials.lps import LPSMaterial, Modulus, bernstein_basis, check_influence
from warp_peri.materials.lps_force import Bonds
from warp_peri.points.arguments import (
    USUAL,
    ArrayMap,
    Numbers,
    Units,
    check_same,
    checked,
    checked_fields,
    mean_inverse,
)
from warp_peri.points.points import PointsLike, nearest, nodes_of
from warp_peri.protocols import OperatorBase, renumbered
from warp_peri.solvers.adjoint import stepped
from warp_peri.solvers.solution import Direct, Solution, Solver, refuse_solver
from warp_peri.solvers.systems import MatrixProblem, definite_factors

__all__ = ["DiffusionMaterial", "CoupledOperator", "ThermoelasticMaterial", "DiffusionOperator"]
ROUNDING = 1e-10
"""Eigenvalues so far below zero, over the largest diagonal, count as zero."""


class FlowOperator(OperatorBase):
    """Linear operator by a sparse matrix from flat fields to the interior; also flows in time."""

    is_linear = True
    matrix: sp.csr_array
    march = stepped  # ∂φ/∂t = −L φ + b by implicit steps (theory, Di4)

    def force(self, u: ndarray) -> ndarray:
        """Force L u on the interior, [..., I, …], of u [..., N, …]; InputError for other shapes."""
        lead, flat = self._flat(self.as_fields(u))
        return np.asarray((flat @ self.matrix.T).reshape(*lead, -1, *self.shape[1:]))

    def vjp(self, u: ndarray, w: ndarray) -> ndarray:
        """Transposed product Lᵗ w on all nodes, [..., N, …], of w on the interior, [..., I, …]."""
        lead, flat = self._flat(self.of_interior(w, u))
        return np.asarray((flat @ self.matrix).reshape(*lead, *self.shape))

    def _flat(self, fields: ndarray) -> tuple[Shape, ndarray]:
        """Leading shape of fields, and these as rows."""
        lead = fields.shape[: fields.ndim - len(self.shape)]
        return lead, fields.reshape(math.prod(lead), -1)

    def tangent(self, u: Any) -> sp.csr_array:
        """Tangent L at any u, a copy of `matrix`."""
        return self.matrix.copy()

    def interior_tangent(self, u: Any) -> sp.csc_array:
        """Tangent L between interior nodes, sparse."""
        components = math.prod(self.shape[1:])
        return self.matrix.tocsc()[:, np.repeat(self.points.interior, components)]

    def transposed(self, g: ndarray) -> ndarray:
        """L⁻ᵗ g of loads on the interior, flat [S, …]."""
        return MatrixProblem(self.matrix, self.points.interior).factors.solve(g.T, "T").T

    def solve(self, b: ArrayLike | None, u: ArrayLike, solver: Solver = None) -> Solution:
        """Solve L u = b (or 0) for the steady state, given on other nodes, [N, …] or [S, N, …].

        Raises InputError for other shapes, values not finite, and a matrix that is singular, as of
        a piece that nothing touches, or has eigenvalues below zero.
        """
        refuse_solver(solver, (Direct,), "what flows")
        b, given = checked_fields(self.points, b, u, self.shape)
        self.interior_tangent(None)  # refuses what would grow
        problem = MatrixProblem(self.matrix, self.points.interior)
        fields = problem.solve(*(one.reshape(-1, *self.shape) for one in (b, given)))
        answer = fields.reshape(given.shape), self.points, self, self.rhs(b)
        return Solution(*answer, "lu", measured=problem.left)


class DiffusionOperator(FlowOperator):
    """Nonlocal diffusion −∇·κ∇φ on the interior of a point set (theory, Di1).

    Args:
        law: influence function and conductivity.
        points: a lattice or scattered points with a collar of δ; nodes outside break their bonds,
            which leaves an insulated surface.
        kappa: the conductivity: a number, one by node [N] (harmonic mean along a bond), or a
            function of positions [..., 2], in series along each bond (Di2). By default the law's.

    ``op(phi)`` takes φ on all nodes, [N] or [S, N], and returns L φ on the interior, [I] or [S, I].
    Raises InputError for a conductivity not > 0, or points that do not carry the horizon.
    """

    implicit = 0.5

    def __init__(
        self, law: DiffusionMaterial, points: PointsLike, *, kappa: Modulus | None = None
    ) -> None:
        self.model, self.points = law, nodes_of(points)  # in the plane or in space
        check_same(law.units, self.points.units)
        self.is_symmetric = self.points.spacing > 0  # on lattices
        bonds = Bonds(self.points, law.horizon, bond_based=True)
        families, inside = bonds.families, self.points.interior
        self.rows, classes = families.rows, families.lattice
        near, far, _, kind = (one[inside[bonds.listing[0]]] for one in bonds.listing)
        self._owner = (np.cumsum(inside) - 1)[near]  # among the interior nodes
        self._r, self._weight = families.r[kind], families.weight[kind]
        self._kept = far >= 0  # broken bonds count in m and carry nothing
        self._ends = near[self._kept], far[self._kept]
        given: Any = law.conductivity if kappa is None else kappa
        self._series = self._along_bonds(given) if callable(given) else None
        if self._series is None:
            given = kept(_conductivities(given, len(self.points.x), "node"))
        self.given = given
        with own_torch():
            strength = self._strengths(**_tensors(self.learnable)).detach().numpy()
        shape, rows = 2 * (len(self.points.x),), np.tile(self._ends[0], 2)
        entries = np.concatenate([strength, -strength]), (rows, np.concatenate(self._ends))
        self.matrix = sp.csr_array(entries, shape=shape)[self.rows]
        # weights of scattered points are negative here and there, of any kernel
        signs = 1.0 if classes is not None else np.sign(self._weight[self._kept])
        self._changes_sign = bool((strength * signs < 0).any())

    def _strengths(self, alpha: Any, D: Any, kappa: Any = None) -> torch.Tensor:
        """Strength v κ of each bond, shape [E], as a tensor with torch's derivatives."""
        r, weight, own = map(torch.from_numpy, (self._r, self._weight, self._owner))
        basis = bernstein_basis(self._r, self.model.horizon, len(D) - 1)
        K = r**-alpha * (torch.from_numpy(basis) @ D)
        volume = r.new_zeros(len(self.rows)).index_add(0, own, K * r**2 * weight)
        if (volume.abs() < 1e-300).any():
            raise InputError("influence function: its weighted volume is zero")
        scale = 2 * self.points.dimension
        v = (scale * K * weight / volume[own])[torch.from_numpy(self._kept)]
        if kappa is None:
            kappa = torch.from_numpy(self._series)
        elif kappa.dim():
            kappa = 2 / sum(1 / kappa[end] for end in self._ends)
        return torch.as_tensor(v * kappa)

    def _along_bonds(self, kappa: ArrayMap) -> ndarray:
        """Conductivity κ of each bond, its parts in series (Di2), shape [E]."""
        points, (near, far) = self.points, self._ends
        xi = nearest(points.x[far] - points.x[near], points.box)

        def along(place: float) -> ndarray:
            values = called(f"kappa: {OF_POSITIONS}", kappa, points.x[near] + place * xi)
            return np.broadcast_to(_conductivities(values, len(near), "position"), len(near))

        return 1 / mean_inverse(along)

    @property
    def shape(self) -> Shape:
        """Shape of one field, [N]."""
        return (len(self.points.x),)

    def interior_tangent(self, u: Any) -> sp.csc_array:
        """Tangent L [I, I] of interior nodes; InputError for eigenvalues of L + Lᵗ below zero."""
        matrix = super().interior_tangent(u)
        if self._changes_sign and len(self.rows):
            shift = ROUNDING * np.abs(matrix.diagonal()).max()
            even = (matrix + matrix.T) / 2 + shift * sp.eye_array(len(self.rows))
            if definite_factors(even) is None:
                raise InputError(
                    "influence function: it changes sign on these points, and L + Lᵗ has "
                    "eigenvalues below zero, with which φ grows without end; take D ≥ 0"
                )
        return matrix

    @property
    def learnable(self) -> Values:
        """Learnable parameters α and D, and κ where it is one number or one a node [N]."""
        own = {"alpha": self.model.alpha, "D": self.model.D}
        return own if callable(self.given) else own | {"kappa": self.given}

    def at(self, numbers: Numbers) -> DiffusionOperator:
        """Operator with other parameters; InputError for κ not > 0."""
        own = renumbered(self.learnable, numbers)
        kappa = own.pop("kappa", self.given)
        return DiffusionOperator(replace(self.model, **own), self.points, kappa=kappa)

    @own_torch()
    def by_numbers(self, name: str, u: ndarray, w: ndarray) -> ndarray:
        """Derivative of Σ w · L φ by one parameter, of fields [K, N] and weights [K, I]."""
        (near, far), (u, w) = self._ends, self.pairs(u, w)
        work = ((u[:, near] - u[:, far]) * w[:, self._owner[self._kept]]).sum(axis=0)
        numbers = _tensors(self.learnable)
        strengths, work = self._strengths(**numbers), torch.from_numpy(work)
        return np.asarray(torch.autograd.grad(strengths, numbers[name], work)[0])

    def energy(self, u: ndarray) -> ndarray | None:
        """Energy h^d (½ φ_I·L φ_I + φ_I·L φ_C), shape [...], without what the collar alone has;
        None on scattered points."""
        return None if self.points.spacing == 0 else self.quadratic(u)

    def storage(self) -> sp.csr_array:
        """Storage matrix of ∂φ/∂t, one on the interior, sparse [I, N]."""
        return sp.eye_array(len(self.points.x), format="csr")[self.rows]


def _tensors(numbers: Numbers) -> dict[str, torch.Tensor]:
    return {n: torch.tensor(v, dtype=torch.float64, requires_grad=True) for n, v in numbers.items()}


def _conductivities(given: Any, count: int, place: str) -> ndarray:
    """Check one conductivity, or one a place."""
    values = checked("conductivity", given)
    if values.shape not in ((), (count,)):
        raise InputError(
            f"conductivity: expected one number or one a {place}, [{count}], got {values.shape}"
        )
    if not (values > 0).all():
        raise InputError(f"conductivity: expected finite values > 0, got {values.min():g}")
    return values


@dataclass(frozen=True, eq=False, repr=False)
class DiffusionMaterial(Record, format="warp_peri.conductor"):
    """Material with flux −κ∇φ over a ball, K(r) = r^(−α) Σ_k D_k B_k,M(r/δ).

    Attributes:
        horizon: δ [length].
        conductivity: κ > 0 where no field is given [stress length²/time of a φ without a unit].
        alpha: exponent α < 3; InputError for others.
        D: Bernstein coefficients, shape [M + 1]; their common scale has no effect.
        units: names of the units of length and stress.
    """

    horizon: Length
    conductivity: Annotated[float, FieldUnits(length=2, stress=1, positive=True)]
    alpha: float = 1.0
    D: ndarray = field(default_factory=lambda: np.ones(1))
    units: Units = USUAL
    dimension: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        check_influence(self.alpha, self.D)

    def on(self, points: PointsLike, *, kappa: Modulus | None = None) -> DiffusionOperator:
        """Operator on points; `kappa` as of DiffusionOperator."""
        return DiffusionOperator(self, points, kappa=kappa)


@dataclass(frozen=True, eq=False, repr=False)
class ThermoelasticMaterial(Record, format="warp_peri.coupled_solid"):
    """Solid with a diffusing field φ: fields are u₁, u₂ and φ, loads b₁, b₂ and the source.

    L u + ε Φᵗ φ = b and c ∂φ/∂t − ε ∂θ/∂t + L_κ φ = g, θ = Φ u; Φᵗ is minus the nonlocal gradient
    of the dilatation, so that energy is exchanged exactly.

    Attributes:
        model: of the solid, one influence function.
        conductor: of φ.
        coupling: ε [stress].
        storage: c ≥ 0 [stress].

    Raises InputError for a coupling that is not finite, a storage below 0, and differing units.
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
        """Horizon δ [length], the longer of solid and conductor."""
        return max(self.model.horizon, self.conductor.horizon)

    @property
    def units(self) -> Units:
        """Names of the units of length and stress."""
        return self.model.units

    def with_parameters(self, numbers: Numbers) -> ThermoelasticMaterial:
        """Material with other parameters of the solid or coupling; a conductor's are left out."""
        mine = {n: value for n, value in numbers.items() if not n.startswith(OF_CONDUCTOR)}
        own = renumbered(self.model.learnable | {"coupling": self.coupling}, mine)
        return replace(self, coupling=own.pop("coupling"), model=self.model.with_parameters(own))

    def on(self, points: PointsLike, *, kappa: Modulus | None = None) -> CoupledOperator:
        """Operator on a lattice; `kappa` as of DiffusionOperator."""
        return CoupledOperator(self, points, kappa=kappa)


OF_CONDUCTOR = "conductor_"
"""What names of the conductor's numbers begin with."""


class CoupledOperator(FlowOperator):
    """Coupled solid on a lattice, whose interior are the free nodes of u and of φ.

    ``op(u)`` takes u₁, u₂, φ on all nodes, [N, 3], and returns steady loads and source, [I, 3].
    Raises InputError for kernels that leave eigenvalues below zero, and as DiffusionOperator.
    """

    implicit = 1.0

    def __init__(
        self, material: ThermoelasticMaterial, points: PointsLike, *, kappa: Modulus | None = None
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
    def shape(self) -> Shape:
        """Shape of one field, [N, 3]."""
        return (len(self.points.x), 3)

    def _whole(self, blocks: list[list[Any]]) -> sp.csr_array:
        """Assemble blocks of displacement and φ in the order of fields."""
        both = sp.block_array(blocks, format="csr")
        rows, columns = (
            np.column_stack([2 * n, 2 * n + 1, 2 * len(n) + n]).ravel()
            for n in map(np.arange, (len(self.rows), len(self.points.x)))
        )
        whole = both[rows][:, columns]
        whole.sort_indices()  # or the first solve does, and sums have other digits from then on
        return whole

    @property
    def learnable(self) -> Values:
        """Learnable parameters λ, μ, α, D, ε, and the conductor's as conductor_alpha and so on."""
        conductor = {OF_CONDUCTOR + n: value for n, value in self.diffusion.learnable.items()}
        return self.model.model.learnable | {"coupling": self.model.coupling} | conductor

    def _of_conductor(self, numbers: Numbers) -> Values:
        return {name: numbers[OF_CONDUCTOR + name] for name in self.diffusion.learnable}

    def at(self, numbers: Numbers) -> CoupledOperator:
        """Operator with other parameters; InputError as the class, and for κ not > 0."""
        own = renumbered(self.learnable, numbers)
        diffusion = self.diffusion.at(self._of_conductor(own))
        material = replace(self.model.with_parameters(own), conductor=diffusion.model)
        return CoupledOperator(material, self.points, kappa=diffusion.given)

    def force_with_parameters(self, u: Any, numbers: Any) -> Any:
        """Force of tensors [S, N, 3] with other parameters, differentiable once in all."""
        field, phi = u[..., :2], u[..., 2].double()
        parts = self.model.model, self.body, self.table
        force = bond_force(*parts, field, numbers, numbers["coupling"] * phi)
        flux = self.diffusion.force_with_parameters(phi, self._of_conductor(numbers))
        return torch.cat([force[:, self.rows], flux[..., None]], dim=-1)

    def storage(self) -> sp.csr_array:
        """Storage matrix of the rates of u₁, u₂ and φ, sparse [3 I, 3 N]."""
        return self._storage.copy()

    @own_torch()
    def storage_slopes(self, names: list[str], rates: ndarray, w: ndarray) -> Values:
        """Derivatives of Σ w · storage() rates by parameters, of rates [K, N, 3], w [K, I, 3]."""
        numbers = _tensors(self.learnable)
        phi = torch.from_numpy(self.on_all(w)[..., 2])
        rate = torch.from_numpy(np.ascontiguousarray(rates[..., :2]))
        parts = self.model.model, self.body, self.table, 0 * rate, numbers
        work = -(rate * bond_force(*parts, numbers["coupling"] * phi)).sum()
        each = torch.autograd.grad(work, [numbers[n] for n in names], allow_unused=True)
        return {name: one.numpy() for name, one in zip(names, each) if one is not None}
