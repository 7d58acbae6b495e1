"""The operator of the LPS on points: force, also of torch, equilibria and stress."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy import ndarray
from numpy.linalg import inv
from numpy.typing import ArrayLike

import warp_peri.core as core
from warp_peri.core.elastic import in_shape_of, symmetric_part
from warp_peri.core.proof import largest
from warp_peri.errors import InputError, Values, warn
from warp_peri.materials.lps_force import Bonds, Law, Matrices, assemble, bonds_of
from warp_peri.points.arguments import check_shape, checked, checked_fields, is_tensor
from warp_peri.points.families import DEGREE, families_of, largest_strain
from warp_peri.points.points import PointsLike, nodes_of
from warp_peri.protocols import OperatorBase
from warp_peri.runtime import recording
from warp_peri.solvers import solution
from warp_peri.solvers.linear import DIRECT, Inverse, Linear
from warp_peri.solvers.solution import CG, TOLERANCE, Direct, Solution, Solver, refuse_solver
from warp_peri.solvers.systems import (
    RESIDUAL,
    MatrixProblem,
    SolveRecord,
    definite_factors,
    smallest_eigenvalue,
)

if TYPE_CHECKING:
    from torch import Tensor

    from warp_peri.materials.lps import LPSMaterial, LPSParameters

SAME = 1e-6
"""Of the horizon, within which nodes are those that fields of moduli are for."""


class LPSOperator(OperatorBase):
    """The operator of a linear peridynamic solid on points of any kind (theory, M2–M5).

    On scattered points each family has weights of its own, of which nothing is proven. With λ = μ
    no dilatation enters, and a collar of δ is enough, but for derivatives to λ and μ. Of moduli
    that are fields the energy is the sum of those of all nodes, each with its own moduli, and
    positive where K is; at an interface displacements are of first order in δ.

    Args:
        model: as it is used; `LPSMaterial.on` asks for its certificate, or transfers it.
        points: a lattice or scattered points, whose interior has the 2δ collar; bonds to nodes
            outside the body are broken.
        quadrature_degree: of the polynomials that the weights are exact for.
        allow_uncertified: whether broken bonds may leave it indefinite, with a warning.

    Attributes:
        nodes: the points as the model is certified on them.
        bonds: of the nodes, built when they are first asked for; solves by stencils need none.

    Raises InputError for points of other units or dimensions, and other nodes than those of fields;
    `bonds` does for a point set that does not carry the horizon.
    """

    is_linear = True

    def __init__(
        self,
        model: LPSMaterial,
        points: PointsLike,
        *,
        quadrature_degree: int = DEGREE,
        allow_uncertified: bool = False,
    ) -> None:
        self.model, self.allowed = model, allow_uncertified
        self.nodes, self.points = model.certified_nodes(points), nodes_of(points)
        self.quadrature_degree = quadrature_degree
        if (x := model.nodes) is not None and not (
            x.shape == self.shape and np.abs(x - self.points.x).max() <= SAME * model.horizon
        ):
            raise InputError(
                f"points: expected the {len(x)} nodes of the fields λ and μ, got others"
            )

    @cached_property
    def bonds(self) -> Bonds:
        """The bonds of the nodes."""
        bonds = bonds_of(self.model, self.nodes, self.quadrature_degree)
        if self.model.nodes is not None and (bonds.law(*self.learnable.values()).kw < 0).any():
            warn(
                "lambda, mu: fields are proven stable for an influence function that is nowhere "
                "below zero, this one changes sign: its static problems are not proven to have one "
                "stable answer"
            )
        return bonds

    @property
    def _law(self) -> Law:
        return self.bonds.law(*self.learnable.values())

    def force(self, u: ArrayLike) -> ndarray:
        """Force L u on the interior nodes, shape [..., I, d]; InputError for another shape."""
        field = np.require(self.as_fields(u), float, ["C", "W"])
        Lu = self._law.force(field.reshape(-1, self.points.x.size))[0]
        return Lu.reshape(*field.shape[:-2], -1, field.shape[-1])

    def vjp(self, u: Any, w: ArrayLike) -> ndarray:
        """Transposed product Lᵗ w on all nodes, [..., N, d], for w [..., I, d], at any u."""
        w = np.require(self.of_interior(w, u), float, ["C", "W"])
        by_u = self._law.transposed(w.reshape(-1, w.shape[-2] * w.shape[-1]))[0]
        return by_u.reshape(*w.shape[:-2], *self.shape)

    def launch(self, u: Any, out: Any, parameters: LPSParameters | None = None) -> None:
        """Write L u [TPa/Å] of Warp arrays into `out`, on the tape that records, if one does.

        Args:
            u, out: [S, N] and [S, I] of vectors of float64, contiguous; u [Å].
            parameters: arrays of λ, μ, α [1] and D [M + 1]; the model's own by default.

        Raises InputError for other arrays.
        """
        d = self.points.dimension
        for name, array, nodes in (("u", u, len(self.points.x)), ("out", out, self._unknown)):
            fits = isinstance(array, wp.array) and array.is_contiguous and array.ndim == 2
            seen = array.numpy() if fits and len(u) else np.zeros(0)
            if seen.dtype != float or seen.shape != (len(u), nodes, d):
                raise InputError(
                    f"{name}: expected a contiguous array of Warp of shape [{len(u)}, {nodes}], "
                    f"of {d} float64 each, got {type(array).__name__} of {list(np.shape(array))}"
                )
        numbers: Any = () if parameters is None else getattr(parameters, "values", tuple)()
        if parameters is not None and not (numbers and all(hasattr(n, "numpy") for n in numbers)):
            raise InputError(
                "parameters: expected LPSParameters of arrays of Warp, got "
                f"{type(parameters).__name__}"
            )
        given = Values()
        for (name, own), one in zip(self.learnable.items(), numbers):
            check_shape(name, one, np.atleast_1d(own).shape)
            given[name] = one.numpy().reshape(np.shape(own))
        law = self.bonds.law(*self.model.with_parameters(given).learnable.values())
        Lu, *felt = law.force(u.numpy().reshape(len(u), -1))
        out.numpy()[:] = Lu.reshape(out.numpy().shape)
        arrays = [u, *numbers]
        asked = [one.requires_grad for one in arrays] + [False] * (5 - len(arrays))

        def back() -> None:
            parts = law.gradient(felt, out.grad.numpy().reshape(len(u), -1), asked)
            for array, part in compress(zip(arrays, parts), asked):
                array.grad.numpy()[:] += np.reshape(part, array.grad.numpy().shape)

        if any(asked) and (tape := recording()) is not None:
            # RuntimeError of Warp: out without a gradient
            tape.record_func(back, [out, *compress(arrays, asked)])

    @property
    def learnable(self) -> Values:
        """Numbers λ, μ, α and D by name."""
        return self.model.learnable

    def force_with_parameters(self, u: Tensor, numbers: dict[str, Tensor]) -> Tensor:
        """The force of fields [S, N, d] with other numbers, differentiable once in all."""
        return lps_force(self.bonds, u, *(numbers[name] for name in self.learnable))

    def matrix(self) -> sp.csr_array:
        """L as a sparse matrix of all nodes' displacements, shape [d I, d N]."""
        return self.matrices.operator(self.model.lam, self.model.mu)

    @property
    def matrices(self) -> Matrices:
        """Matrices Γ, Φ and Ψ on the nodes."""
        law = self._law
        return assemble(self.bonds, law.kw, law.m, self.model.mu)

    @property
    def is_symmetric(self) -> bool:  # type: ignore[override]
        """Whether L is symmetric on the interior: on lattices without broken bonds."""
        return self.points.spacing > 0 and self.points.outside is None

    def at(self, numbers: Values) -> LPSOperator:
        """The operator with other numbers; InputError for no solid, or an indefinite lattice."""
        model = self.model.with_parameters(numbers)
        made = LPSOperator(
            model, self.points, quadrature_degree=self.quadrature_degree, allow_uncertified=True
        )
        if model.bond_based or not self.bonds.bond_based:
            made.__dict__["bonds"] = self.bonds
        if model.nodes is None and (self.nodes.is_open_lattice or self.nodes.box is not None):
            made.linear.check_definite()
        return made

    @cached_property
    def linear(self) -> Linear:
        """Stencil operator of a lattice; of fields of moduli with their means, beside products."""
        nodes, mean = self.nodes, self.model.mean
        try:
            stencil = mean.stencil(nodes.spacing, degree=self.quadrature_degree)
            linear = Linear(stencil, nodes, least=2 * int(mean.horizon / nodes.spacing + 1e-6))
        except InputError:
            families_of(nodes, mean.horizon, bond_based=mean.bond_based)  # which says it better
            raise
        if self.model.nodes is not None:
            grid = linear.grid

            def pull(planes: ndarray) -> ndarray:
                u = np.zeros((len(planes), *self.shape))
                u[:, grid.near] = grid.gather(grid.within(planes), grid.place)
                return np.stack([grid.scatter_interior(one) for one in self.force(u)])

            linear.pull = pull
        return linear

    @property
    def proven(self) -> str | None:
        """Statement of the lattice's certificate, if it holds for these weights and all bonds."""
        spacing, whole = self.points.spacing, self.points.outside is None
        if not (whole and self.model.is_certified_on(spacing) and self.quadrature_degree == DEGREE):
            return None
        return self.model.statements.get(self.model.certified_spacing_near(spacing))

    def energy(self, u: ndarray) -> ndarray | None:
        """Energy h^d (½ u_I·L u_I + u_I·L u_C) [stress · length^d], [...], where L is symmetric;
        without what the collar alone has, it may be below zero."""
        return self.quadratic(u) if self.is_symmetric else None

    def stress(self, u: ndarray) -> ndarray | None:
        """Stress σ [TPa] at the interior nodes, [..., I, d, d]."""
        return in_shape_of(u, node_fields(self.model, self.points, u).stress)

    def max_symbol_eigenvalue(self) -> float:
        """Upper bound of L's eigenvalues [stress/length²] on a lattice, for time steps; of fields
        their means', times how much stiffer a node is (InputError for a K that changes sign)."""
        model, mean = self.model, self.model.mean
        bound = largest(mean.stencil(self.nodes.spacing, degree=self.quadrature_degree), mean.group)
        if model.nodes is None:
            return bound
        if (self._law.kw < 0).any():
            raise InputError("simulate: expected K W ≥ 0 for moduli as fields, got one below zero")
        parts = np.asarray(model.mu), np.asarray(model.lam + 2 * model.mu / model.dimension)
        return bound * max(float(one.max() / one.mean()) for one in parts)

    def solve(self, b: Any, u: Any, solver: Solver = None, *, parameters: Any = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar (theory, 29).

        Args:
            b, u: [TPa/Å] and [Å], shape [N, d] or [S, N, d]; of tensors it is differentiable.
            solver: Direct(…) or CG(…); None takes the cheapest by size and shape.
            parameters: some of λ, μ, α and D by name, the material's own by default.

        Raises InputError for arrays that do not fit, a solver that does not go with the points, or
        an operator that is singular or (with allow_uncertified a warning) not positive definite.
        """
        refuse_solver(solver, (Direct, CG), "a linear solid")
        if is_tensor(b) or is_tensor(u) or parameters is not None:
            return self.solve_torch(b, u, solver, parameters)  # type: ignore[no-any-return]
        load, given = checked_fields(self.points, b, u)
        fields = [one.reshape(-1, *self.shape) for one in (load, given)]
        method, few = self._method(solver, len(fields[0])), self._unknown <= DIRECT
        if method != "lu":
            # closer than a factorisation is held to, where one would have been possible
            tolerance = getattr(solver, "tolerance", RESIDUAL / 10 if few else TOLERANCE)
            try:
                return self._iterated(load, method, tolerance, *fields)
            except InputError:
                if solver is not None or not few:
                    raise
                method = "lu"  # the symbol does not prove every definite operator so
        found = self._problem.solve(*fields)
        self._refuse_indefinite()
        return self._answer(load, found, method)

    def solve_periodic(self, b: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium on a period, u of zero mean, under a load [N, d] or [S, N, d] less its mean.
        InputError for points that do not fill a period, as `solve`, and an indefinite operator."""
        refuse_solver(solver, (), "a periodic sheet, which has one way")
        nodes = self.nodes
        sides = () if nodes.box is None else np.rint(np.divide(nodes.box, nodes.spacing))
        if not nodes.interior.all() or len(nodes.x) != np.prod(sides):
            raise InputError(
                "points: expected a lattice that fills its box, all of its nodes interior, for a "
                "periodic problem; see Points.sheet"
            )
        load = checked("b", b, float, (..., *self.shape))
        load = load - load.mean(axis=-2, keepdims=True)
        fields = load.reshape(-1, *self.shape)
        return self._iterated(load, "fft", TOLERANCE, fields, np.zeros(fields.shape))

    def inverse(self, loads: int) -> Inverse:
        """Inverse of L on a lattice's interior [I, d], to a relative residual, for many loads."""
        if self.model.nodes is not None:
            return lambda right, tolerance: self.linear.inverse(right, tolerance)[0]
        return self.linear.cheapest_inverse(loads)

    def _iterated(
        self, load: ndarray, method: str, tolerance: float, b: ndarray, u: ndarray
    ) -> Solution:
        """Equilibrium of fields [S, N, d] by iteration."""
        if self.model.nodes is None:
            self.linear.check_definite()
        found, took = self.linear.solve(b, u, tolerance, method)
        return self._answer(load, found, method, took)

    def _answer(
        self, load: ndarray, found: ndarray, method: str, took: Sequence[SolveRecord] = ()
    ) -> Solution:
        """Solution in the shape of the load; warns of strain beyond the data."""
        u = found.reshape(load.shape)
        solution.warn_beyond(self.model, lambda: largest_strain(self.nodes, u))
        return solution.by_sample(self, u, self.rhs(load), took, method, self.proven)

    @property
    def _unknown(self) -> int:
        return int(np.count_nonzero(self.points.interior))

    def _method(self, solver: Solver, loads: int) -> str:
        """Name of the solve method, the cheapest by default; InputError where it cannot be used."""
        asked = solver.preconditioner if isinstance(solver, CG) else None
        if self.nodes.is_open_lattice and not isinstance(solver, Direct):
            return self.linear.method(asked, 0 if solver else loads)
        if not isinstance(solver, CG):
            return "lu"
        raise InputError(
            "solver: CG(…) is for lattices without a box and without broken bonds; try Direct()"
        )

    @cached_property
    def _problem(self) -> MatrixProblem:
        """The assembled problem, which keeps its factors."""
        return MatrixProblem(self.matrix(), self.nodes.interior)

    def interior_tangent(self, u: Any) -> Any:
        """Sparse matrix of L between interior nodes, [d I, d I]."""
        return self._problem.stiffness.copy()

    def _refuse_indefinite(self) -> None:
        """Raise InputError where the symmetric part of L_II is not positive definite, on open
        lattices and where bonds are broken (theory, B9)."""
        cut, whole = self.nodes.outside is not None, self.nodes.is_open_lattice
        if whole and self.model.nodes is None:
            with suppress(InputError):
                return self.linear.check_definite()
        if not (cut or whole):
            return None
        stiffness = self._problem.stiffness
        symmetric = sp.csc_array((stiffness + stiffness.T) / 2)
        if definite_factors(symmetric) or (least := smallest_eigenvalue(symmetric)) > 0:
            return None
        message = (
            f"{'outside: with these bonds broken ' * cut}the operator on these {self._unknown} "
            "nodes is indefinite: the smallest eigenvalue of its symmetric part is "
            f"{least:.2g}, and its solutions may be wrong"
            f"{'; Body(mesh, …) does without broken bonds' * cut}"
        )
        if cut and self.allowed:
            return warn(message)
        raise InputError(message)


def lps_force(bonds: Bonds, u: Tensor, *values: Any) -> Tensor:
    """L u [TPa/Å] on the interior nodes, shape [..., I, d], differentiable once in all arguments: u
    [Å] [N, d] or [S, N, d], λ and μ (numbers or [N]), α and D. Bond-based bonds ask for λ = μ
    without a gradient; InputError otherwise, and for moduli of another shape."""
    bridge, felt = core.torch_bridge, list[Any]()

    def there(u: ndarray, *values: ndarray) -> tuple[ndarray]:
        law = bonds.law(*values)
        Lu, *kept = law.force(np.ascontiguousarray(u))
        felt[:] = law, kept
        return (Lu,)

    def back(asked: tuple[bool, ...], g: ndarray) -> list[Any]:
        law, kept = felt
        return law.gradient(kept, g, asked)  # type: ignore[no-any-return]

    flat = u.double().reshape(-1, bonds.nodes * bonds.dimension)
    numbers = [bridge.real(name, value) for name, value in zip(("lam", "mu", "alpha", "D"), values)]
    (Lu,) = bridge.once(there, back, flat, *numbers)
    return Lu.reshape(*u.shape[:-2], -1, bonds.dimension)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class NodeFields:
    """Stress, strain, dilatation and energy of a displacement at the interior nodes.

    Attributes:
        stress: σ [TPa], shape [S, I, d, d], symmetric.
        strain: ε, symmetric part of the least-squares gradient over the family, same shape.
        dilatation: θ, shape [S, I].
        energy: density [TPa], shape [S, I].
    """

    stress: ndarray
    strain: ndarray
    dilatation: ndarray
    energy: ndarray


def node_fields(model: LPSMaterial, points: PointsLike, u: ArrayLike) -> NodeFields:
    """Compute nodal stress (collapsed, S. A. Silling and R. B. Lehoucq 2008), strain and energy.

    The stress is that of a family deformed as the node's own force state is; on a lattice it is
    exact on affine fields and approaches the stress of the local solid as fields become smooth. On
    scattered points only as far as the weights of each family are symmetric; the strain is exact.

    Args:
        model: of which no certificate is asked.
        points: a lattice or scattered points.
        u: displacement [Å] on all nodes, shape [N, d] or [S, N, d].

    Raises InputError for a u of another shape, points as of LPSOperator, a set that does not carry
    the horizon, or nodes outside the body: the stress is that of complete families.
    """
    if (given := nodes_of(points)).outside is not None:
        raise InputError("outside: expected none, for stress needs complete families")
    operator = LPSOperator(model, points)  # which refuses others than fields'
    bonds, u = bonds_of(model, operator.nodes), operator.fields(u)
    law = bonds.law(*model.learnable.values())
    nodes, d, inside = bonds.nodes, bonds.dimension, np.flatnonzero(given.interior)
    mine = given.interior[bonds.listing[0]]
    owner, far, xi, kind = (one[mine] for one in bonds.listing)
    lam, mu, m = (np.broadcast_to(one, nodes)[inside] for one in (model.lam, model.mu, law.m))
    total = partial(np.add.reduceat, indices=np.flatnonzero(np.diff(owner, prepend=-1)))  # [I, …]
    K, outer, c2 = law.kw[kind], xi[:, :, None] * xi[:, None, :], d * (d + 2)
    sheared = K / (xi**2).sum(axis=1)
    shape, inverse = total(K[:, None, None] * outer), inv(total(outer))
    parts = []
    for field in u:
        eta = field[far] - field[owner]
        along = (xi * eta).sum(axis=1)
        theta = d / m * total(K * along)
        stress = ((lam - mu) * d / m * theta)[:, None, None] * shape
        stress += (c2 * mu / m)[:, None, None] * total((sheared * along)[:, None, None] * outer)
        gradient = total(eta[:, :, None] * xi[:, None, :]) @ inverse
        energy = ((lam - mu) * theta**2 + c2 * mu / m * total(sheared * along**2)) / 2
        parts.append((stress, symmetric_part(gradient), theta, energy))
    return NodeFields(*(np.stack(part) for part in zip(*parts)))
