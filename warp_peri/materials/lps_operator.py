"""The linear peridynamic solid on points: its force, its stress, and its equilibria."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp
import torch
import warp as wp
from numpy.typing import ArrayLike

from warp_peri.contract import OnPoints, is_tensor
from warp_peri.errors import InputError
from warp_peri.launch import DEVICE, recording
from warp_peri.lps.bonds import Bonds, SweepLaw, check_volumes
from warp_peri.lps.force import (
    Felt,
    check_bond_based,
    check_field,
    evaluate,
    force_by,
    gradient,
    pulled,
)
from warp_peri.lps.matrices import Matrices, matrices, node_fields
from warp_peri.lps.model import Model, Solid, lps_stencil, on_nominal_lattice
from warp_peri.points.arrays import checked, checked_fields, plain
from warp_peri.points.lattice import largest_strain
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.statics.conjugate_gradients import SolveRecord
from warp_peri.statics.direct import RESIDUAL, MatrixProblem
from warp_peri.statics.linear import DIRECT, STIFF, Inverse, Linear
from warp_peri.statics.lps import (
    bonds_within,
    by_gmres,
    choose_method,
    lps_linear,
    refuse_indefinite,
)
from warp_peri.statics.solution import (
    TOLERANCE,
    Direct,
    Krylov,
    Solution,
    Solver,
    refuse_solver,
    warn_beyond,
)
from warp_peri.transfer.cache import model_for

T = TypeVar("T")
Numbers = Solid | Mapping[str, Any]


class LPSOperator(OnPoints):
    """The operator of a model's material on points of any kind (theory, M2–M5).

    ``op(u)`` is L u [TPa/Å] of the model there, on interior nodes; in equilibrium it is b. On
    scattered points each family has weights of its own, of which nothing is proven: they ask for
    allow_uncertified. A model with λ = μ is bond-based: it needs no dilatation, and a collar of δ
    is enough, but for derivatives to λ and μ.

    Args:
        model: certified on some lattice; on others it is transferred, which is said once.
        points: a lattice or scattered points, whose interior has the 2δ collar; bonds to nodes
            outside the body are broken.
        quadrature_degree: of the polynomials that the weights are exact for.
        transfer: False refuses what the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.
        lazy: whether bonds are built when they are first asked for; solves by stencils need none.
        device: where the kernels run, as for Bonds.

    Attributes:
        home: the model that was given.
        points: the nodes that were given.
        model: the one that is used.
        nodes: the points as it is certified on them.
        bonds: of the nodes.

    Raises InputError for a point set that does not carry the horizon, an uncertified spacing
    without a transfer, and scattered points without allow_uncertified.
    """

    is_linear = True

    def __init__(
        self,
        model: Model,
        points: PointsLike,
        *,
        quadrature_degree: int = DEGREE,
        transfer: bool = True,
        allow_uncertified: bool = False,
        lazy: bool = False,
        device: str = DEVICE,
    ) -> None:
        model.check_dimension(points)
        self.home, self.allowed = model, allow_uncertified
        how = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        self.model = model_for(model, points, **how)
        self.nodes, self.points = on_nominal_lattice(self.model, points), nodes_of(points)
        self.quadrature_degree, self.device = quadrature_degree, device
        self._problems: dict[int, MatrixProblem] = {}
        if not lazy:
            _ = self.bonds

    @cached_property
    def bonds(self) -> Bonds:
        """The bonds of the nodes, on the device."""
        how: dict[str, Any] = {"quadrature_degree": self.quadrature_degree, "device": self.device}
        try:
            bonds = Bonds(self.nodes, self.model.horizon, **how)
        except InputError:
            if not self.model.bond_based or np.size(self.moduli[0]) > 1:
                raise
            bonds = Bonds(self.nodes, self.model.horizon, bond_based=True, **how)
        check_volumes(bonds, self.model)
        return bonds

    @property
    def moduli(self) -> tuple[Any, Any]:
        """λ and μ [TPa]: numbers, or one value a node, shape [N]."""
        return self.model.lam, self.model.mu

    @property
    def _law(self) -> SweepLaw:
        return self.bonds.law(*self.moduli, self.model.alpha, self.model.D)

    def force_in_torch(self, u: Any) -> Any:
        """The force of a tensor, which stays where it is."""
        if self.device == DEVICE:
            return super().force_in_torch(u)
        return self.force_with(u, self.learnable)

    def _fields(self, values: Any) -> wp.array[Any]:
        """Fields of NumPy as kernels read them, [S, d ·]."""
        return self.bonds.floats(values.reshape(-1, values.shape[-2] * values.shape[-1]))

    def force(self, u: ArrayLike) -> np.ndarray:
        """L u on the interior nodes, shape [..., I, d]; InputError for another shape."""
        field = np.require(plain("u", u), float, ["C", "W"])
        check_field(self.bonds, torch.from_numpy(field), DEVICE)
        Lu = evaluate(self.bonds, self._fields(field), self._law, kept=False).Lu.numpy()
        return np.asarray(Lu.reshape(*field.shape[:-2], -1, field.shape[-1]))

    def product_transpose(self, u: Any, w: ArrayLike) -> np.ndarray:
        """Lᵗ w on all nodes, shape [..., N, d], of w on the interior [..., I, d], whatever u."""
        w = np.require(plain("w", w), float, ["C", "W"])
        by_u = pulled(self.bonds, self._law, self._fields(w)).by_u.numpy()
        return np.asarray(by_u.reshape(*w.shape[:-2], *self.shape))

    def felt(self, u: np.ndarray) -> tuple[np.ndarray, Felt]:
        """The force of one field [N, d], and what `pulls` reads of it."""
        found = evaluate(self.bonds, self._fields(u), self._law)
        return np.asarray(found.Lu.numpy().reshape(-1, self.bonds.dimension)), found

    def pulls(self, felt: Felt, w: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        """Lᵗ w on all nodes [N, d] and derivatives of w · force to numbers by name, w [I, d]."""
        by = dict(vars(gradient(self.bonds, felt, self._fields(w))))
        by_u = by.pop("u").numpy().reshape(self.shape)
        return by_u, {name: np.reshape(by[name], np.shape(x)) for name, x in self.learnable.items()}

    @property
    def gathers(self) -> bool:
        """Whether `felt` and `pulls` are had: of bonds with dilatations, on the processor."""
        return not (self.bonds.bond_based or self.bonds.plain)

    def launch(self, u: Any, out: Any, parameters: Solid | None = None) -> None:
        """L u of Warp arrays, on the tape that records, if one does.

        ``tape.backward`` adds to the gradients of those arrays that require one.

        Args:
            u: displacement [Å], shape [S, N] of vectors of float64, contiguous.
            out: takes L u [TPa/Å], shape [S, I] of such vectors.
            parameters: λ, μ, α and D, of shape [1] and [M + 1]; the model's own by default.

        Raises InputError for other arrays and another device.
        """
        bonds, d = self.bonds, self.bonds.dimension
        if bonds.plain:
            raise InputError(f"launch: expected an operator on {DEVICE}, got {bonds.device}")
        for name, array, nodes in (("u", u, bonds.nodes), ("out", out, len(bonds.families.rows))):
            fits = isinstance(array, wp.array) and array.is_contiguous and array.ndim == 2
            seen = array.numpy() if fits and len(u) else np.zeros(0)
            if seen.dtype != float or seen.shape != (len(u), nodes, d):
                raise InputError(
                    f"{name}: expected a contiguous array of Warp of shape [{len(u)}, {nodes}], "
                    f"of {d} float64 each, got {type(array).__name__} of {list(np.shape(array))}"
                )
        numbers: list[Any] = [] if parameters is None else list(parameters.values())
        values = [one.numpy() for one in numbers] or list(self.learnable.values())
        asked = any(one.requires_grad for one in numbers[:2])
        check_bond_based(bonds, values[0], values[1], asked)
        felt = evaluate(bonds, self._fields(u.numpy()), bonds.law(*values))
        out.numpy()[:] = felt.Lu.numpy().reshape(out.numpy().shape)

        def back() -> None:
            learns = any(one.requires_grad for one in numbers)
            asked = {"moduli": learns, "influence": learns}
            by = gradient(bonds, felt, self._fields(out.grad.numpy()), **asked)
            by_u: Any = by.u
            of = by_u.numpy().reshape(u.numpy().shape), by.lam, by.mu, by.alpha, by.D
            for array, part in zip((u, *numbers), of):
                if array.requires_grad:
                    array.grad.numpy()[:] += part

        arrays = [array for array in (u, *numbers) if array.requires_grad]
        if arrays and (tape := recording()) is not None:
            tape.record_func(back, [out, *arrays])  # RuntimeError of Warp: out without a gradient

    @property
    def learnable(self) -> dict[str, Any]:
        """λ, μ, α and D by name."""
        return self.model.learnable

    def force_with(self, u: torch.Tensor, numbers: dict[str, torch.Tensor]) -> torch.Tensor:
        """The force of fields [S, N, d] with other numbers, differentiable once in all."""
        return force_by(self.bonds, u, *(numbers[name] for name in self.learnable))

    def matrix(self) -> sp.csr_array:
        """L as a sparse matrix of all nodes' displacements, shape [d I, d N]."""
        return self._matrices(self.quadrature_degree).operator(*self.moduli)

    def load(self, b: np.ndarray) -> np.ndarray:
        """What the operator equals in equilibrium with b [TPa/Å], on the interior nodes.

        Raises InputError for another shape than [N, d] or [S, N, d].
        """
        b, (nodes, d) = plain("b", b), self.points.x.shape
        if b.ndim not in (2, 3) or b.shape[-2:] != (nodes, d):
            raise InputError(
                f"b: expected shape [S, {nodes}, {d}] or [{nodes}, {d}], got {list(b.shape)}"
            )
        return b[..., self.points.interior, :]

    @property
    def is_symmetric(self) -> bool:  # type: ignore[override]
        """Whether so is L on the interior, of a lattice without broken bonds."""
        return self.points.spacing > 0 and self.points.outside is None

    def at(self, numbers: dict[str, Any]) -> LPSOperator:
        """The same with other numbers; InputError for no solid, or an indefinite whole lattice."""
        model = self.model.having(numbers)
        options: dict[str, Any] = {"allow_uncertified": True, "lazy": True, "device": self.device}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # said of this one
            made = LPSOperator(model, self.points, **options)
        if model.bond_based or not self.bonds.bond_based:
            made.__dict__["bonds"] = self.bonds
        if self.nodes.is_plain_lattice or self.nodes.box is not None:
            made.linear.check_definite()
        return made

    @cached_property
    def linear(self) -> Linear:
        """Its stencil on the nodes of a lattice."""
        return lps_linear(self.nodes, self.model.solid, self.model.horizon)

    @property
    def proven(self) -> str | None:
        """What the certificate of the lattice says, if it holds."""
        spacing = self.points.spacing
        if not self.model.is_certified_on(spacing):
            return None
        figures = self.model.certificate.get(f"{self.model.nominal_spacing(spacing):g}", {})
        return str(figures["statement"]) if "statement" in figures else None

    def energy(self, u: np.ndarray) -> np.ndarray | None:
        """h^d (½ u_I·L u_I + u_I·L u_C) [stress · length^d], shape [...]; on lattices."""
        return None if self.points.spacing == 0 else self.quadratic(u)

    def stress(self, u: np.ndarray) -> np.ndarray | None:
        """σ [TPa] at the interior nodes, [..., I, d, d]."""
        stress = node_fields(self.model, self.points, u, self.moduli).stress
        return stress if np.ndim(u) == 3 else stress[0]

    def rest(
        self, b: Any, u: Any, solver: Solver = None, *, parameters: Numbers | None = None
    ) -> Solution:
        """Equilibrium with b on the interior, u given on the collar (theory, 29).

        Args:
            b: body force density [TPa/Å], shape [N, d] or [S, N, d]; only interior values count.
            u: displacement [Å], same shape; only collar values count. Of torch tensors the answer
                is one, differentiable in both.
            solver: Direct(…) or Krylov(…); None takes the cheapest by size and shape.
            parameters: λ, μ, α and D, or some of them by name, the material's own by default; the
                answer is differentiable in tensors among them.

        Raises InputError for arrays that do not fit, a solver that does not go with the points, or
        an operator that is singular or (with allow_uncertified a warning) not positive definite.
        """
        refuse_solver(solver, (Direct, Krylov), "a linear solid")
        if is_tensor(b) or is_tensor(u) or parameters is not None:
            return self.rest_in_torch(b, u, solver, parameters)
        load, field = checked_fields(self.points, b, u)
        records: list[SolveRecord] = []
        nodes = self.nodes
        flat_load, flat = (f.reshape(-1, *nodes.x.shape) for f in (load, field))

        def solved(method: str) -> np.ndarray:
            if method not in ("lu", "gmres"):
                return self._iterated(flat_load, flat, method, solver, records)
            degree = self.quadrature_degree
            if isinstance(solver, Direct):
                degree = solver.quadrature_degree
            return self._factorised(flat_load, flat, method, degree)

        answer, method = self._chosen(solver, len(flat), solved)
        flat[:, nodes.interior] = answer[:, nodes.interior]
        warn_beyond(self.model, lambda: largest_strain(nodes, flat))
        return self._told(field, self.load(load), method, records)

    def rest_in_torch(
        self, b: Any, u: Any, solver: Solver = None, parameters: Numbers | None = None
    ) -> Solution:
        """`rest` of tensors or with other numbers; InputError for numbers that do not count."""
        if isinstance(solver, Direct) and solver.quadrature_degree != self.quadrature_degree:
            raise InputError(
                f"quadrature_degree: expected that of the operator, {self.quadrature_degree}, for "
                f"a gradient, got {solver.quadrature_degree}"
            )
        named = vars(parameters) if isinstance(parameters, Solid) else parameters
        solution: Solution = super().rest_in_torch(b, u, solver, named)
        return solution

    def rest_periodic(self, b: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium on a period under a load whose mean is removed; u has zero mean.

        Args:
            b: body force density [stress/length], shape [N, d] or [S, N, d].
            solver: None.

        Raises InputError for points that do not fill a period, a load that does not fit, and an
        operator that is not positive definite there.
        """
        refuse_solver(solver, (), "a periodic sheet, which has one way")
        nodes = self.nodes
        if nodes.box is None or not nodes.interior.all():
            raise InputError(
                "points: expected a lattice with a box, all of its nodes interior, for a periodic "
                "problem; see Points.sheet"
            )
        load = checked("b", b, float, (..., *nodes.x.shape))
        field = np.zeros(load.shape)
        count = int(np.prod(np.rint(np.divide(nodes.box, nodes.spacing))))
        if len(nodes.x) != count:
            raise InputError(
                f"points: expected {count} nodes that fill the box, got {len(nodes.x)}"
            )
        self.linear.check_definite()
        flat = field.reshape(-1, *nodes.x.shape)
        u, records = self.linear.solve(load.reshape(flat.shape), flat, TOLERANCE)
        warn_beyond(self.model, lambda: largest_strain(nodes, u))
        load = load - load.mean(axis=-2, keepdims=True)
        return self._told(u.reshape(field.shape), load, "fft", list(records))

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of what the operator equals on the interior [I, d], to a relative residual; set up
        once for so many loads."""
        if self.nodes.is_plain_lattice and self.quadrature_degree == DEGREE:
            return self.linear.cheapest_inverse(
                loads, bonds_within(self.model.horizon, self.nodes.spacing)
            )
        return self._problem(self.quadrature_degree).inverse

    def _told(self, u: Any, load: Any, method: str, records: list[SolveRecord]) -> Solution:
        measured = max((r.residual for r in records), default=None)
        count = tuple(record.iterations for record in records)
        proven, details = self.proven, tuple(records) or None
        return Solution(u, self.points, self, load, method, count, proven, (), details, measured)

    def _chosen(self, solver: Solver, loads: int, solved: Callable[[str], T]) -> tuple[T, str]:
        """An answer and its method. What iteration refuses, few nodes can be factorised for: the
        symbol does not prove every definite operator so."""
        method = self._method(solver, loads)
        try:
            return solved(method), method
        except InputError:
            few = np.count_nonzero(self.points.interior) <= DIRECT
            if solver is not None or not few or method == "lu":
                raise
        return solved("lu"), "lu"

    def _method(self, solver: Solver, loads: int) -> str:
        """The name of the method; InputError where it does not go with the points."""
        plain = self.nodes.is_plain_lattice and self.quadrature_degree == DEGREE
        if isinstance(solver, Direct):
            return solver.method
        chosen = solver.preconditioner if isinstance(solver, Krylov) else None
        if isinstance(solver, Krylov) and not plain:
            raise InputError(
                "solver: Krylov(…) is for lattices without a box and without broken bonds, with "
                "quadrature of the usual degree; try Direct()"
            )
        if chosen is not None:
            return chosen
        stiff = self.model.lam > STIFF * self.model.mu
        loads = 0 if isinstance(solver, Krylov) else loads
        bonds = bonds_within(self.model.horizon, self.nodes.spacing)
        return choose_method(self.nodes, plain=plain, stiff=stiff, loads=loads, bonds=bonds)

    def _factorised(self, load: np.ndarray, u: np.ndarray, method: str, degree: int) -> np.ndarray:
        """The solution of the assembled problem."""
        model, nodes, problem = self.model, self.nodes, self._problem(degree)
        answer = problem.solve(load, u) if method == "lu" else by_gmres(problem, load, u)
        refuse_indefinite(
            nodes,
            problem.stiffness,
            lambda: lps_stencil(model, nodes.spacing, degree=degree),
            allowed=self.allowed,
        )
        return answer

    def _problem(self, degree: int) -> MatrixProblem:
        """The assembled problem, which keeps its factors."""
        if degree not in self._problems:
            L = self._matrices(degree).operator(*self.moduli)
            self._problems[degree] = MatrixProblem(L, self.nodes.interior)
        return self._problems[degree]

    def _matrices(self, degree: int) -> Matrices:
        mine = degree == self.quadrature_degree and self.device == DEVICE
        bonds = self.bonds if mine else None
        how: dict[str, Any] = {"quadrature_degree": degree, "bonds": bonds, "mu": self.moduli[1]}
        return matrices(self.model, self.nodes, **how)

    def stiffness_at(self, u: Any) -> Any:
        """L between interior nodes, sparse [d I, d I]."""
        return self._problem(self.quadrature_degree).stiffness

    def _iterated(
        self,
        load: np.ndarray,
        u: np.ndarray,
        method: str,
        solver: Solver,
        records: list[SolveRecord],
    ) -> np.ndarray:
        """The solution by conjugate gradients, where they are asked to run."""
        asked = solver if isinstance(solver, Krylov) else self._unasked()
        self.linear.check_definite()
        answer, took = self.linear.solve(load, u, asked.tolerance, method)
        records += took
        return answer

    def _unasked(self) -> Krylov:
        """Settings of an iteration that nobody asked for: closer than a factorisation is held to,
        where one would have been possible."""
        few = np.count_nonzero(self.points.interior) <= DIRECT
        return Krylov(tolerance=RESIDUAL / 10 if few else TOLERANCE)
