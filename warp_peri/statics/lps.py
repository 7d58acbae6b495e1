"""The linear peridynamic solid on points: its force, its stress, and its equilibria."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.fft
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, gmres, spilu

from warp_peri.contract import is_tensor
from warp_peri.core.stencil import Stencil
from warp_peri.core.sweeps import torus_symbol
from warp_peri.errors import InputError
from warp_peri.launch import DEVICE
from warp_peri.lps.matrices import matrices, node_fields
from warp_peri.lps.model import Model, Solid, lps_stencil
from warp_peri.points.arrays import checked, checked_fields
from warp_peri.points.families import families_of
from warp_peri.points.lattice import largest_strain, lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.stability.certificate import smallest_eigenvalue
from warp_peri.statics.conjugate_gradients import SolveRecord
from warp_peri.statics.direct import RESIDUAL, MatrixProblem, definite_factors
from warp_peri.statics.linear import (
    BONDS,
    DIRECT,
    STIFF,
    Inverse,
    Linear,
    cheapest_method,
    smallest_ratio,
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
from warp_peri.transfer.operator import LPSOperator

T = TypeVar("T")
Numbers = Solid | Mapping[str, Any]
LARGEST_LU = 40_000
"""Most unknown nodes off lattices that are factorised whole."""


class PlacedLPS(LPSOperator):
    """A linear solid on points: resolved once, bonds built when they are first asked for.

    Arguments, attributes, errors and ``op(u)`` are those of LPSOperator.
    """

    at_once = False

    def __init__(self, model: Any, points: PointsLike, **options: Any) -> None:
        super().__init__(model, points, **options)
        self.allowed = bool(options.get("allow_uncertified", False))
        self._problems: dict[int, MatrixProblem] = {}

    @property
    def is_symmetric(self) -> bool:  # type: ignore[override]
        """Whether so is L on the interior, of a lattice without broken bonds."""
        return self.points.spacing > 0 and self.points.outside is None

    def at(self, numbers: dict[str, Any]) -> PlacedLPS:
        """The same with other numbers; InputError for no solid, or an indefinite whole lattice."""
        model = self.model.having(numbers)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # said of this one
            made = PlacedLPS(model, self.points, allow_uncertified=True, device=self.device)
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
        stress = node_fields(self.model, self.points, u).stress
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
            mine = degree == self.quadrature_degree and self.device == DEVICE
            parts = matrices(
                self.model, self.nodes, quadrature_degree=degree, bonds=self.bonds if mine else None
            )
            L = parts.operator(self.model.lam, self.model.mu)
            self._problems[degree] = MatrixProblem(L, self.nodes.interior)
        return self._problems[degree]

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


def lps_linear(points: PointsLike, solid: Solid, horizon: float, *, degree: int = DEGREE) -> Linear:
    """The stencil of a linear peridynamic solid on the nodes of a lattice.

    Raises InputError as families_of does, for the same point sets.
    """
    nodes = nodes_of(points)
    try:
        stencil = solid_stencil(nodes, solid, horizon, degree)
        return Linear(stencil, nodes, least=2 * int(horizon / nodes.spacing + 1e-6))
    except InputError:
        families_of(nodes, horizon, bond_based=solid.bond_based, degree=degree)
        raise


def solid_stencil(nodes: Points, solid: Solid, horizon: float, degree: int = DEGREE) -> Stencil:
    """The stencil of numbers, arrays or tensors that make a linear peridynamic solid."""
    numbers = solid.map(lambda value: np.asarray(value, dtype=float).ravel())
    lam, mu, alpha = (float(value[0]) for value in (numbers.lam, numbers.mu, numbers.alpha))
    model = Model(lam, mu, alpha, numbers.D, horizon, dimension=nodes.dimension)
    return lps_stencil(model, nodes.spacing, degree=degree)


def bonds_within(horizon: float, spacing: float) -> float:
    """About how many bonds a node of a plane lattice has; BONDS off lattices."""
    return float(np.pi * (horizon / spacing) ** 2 if spacing > 0 else BONDS)


def choose_method(
    points: PointsLike, *, plain: bool, stiff: bool = False, loads: int = 1, bonds: float = BONDS
) -> str:
    """The cheapest method for a point set.

    Args:
        points: whose interior nodes are solved for.
        plain: a lattice without a box or broken bonds.
        stiff: λ ≫ μ.
        loads: how many are solved for; 0 for iteration in any case.
        bonds: of a node, about.
    """
    nodes = int(np.count_nonzero(points.interior))
    if not plain:
        return "lu" if nodes <= LARGEST_LU else "gmres"
    inside = lattice_steps(points)[0][points.interior]
    box = bool(np.prod(np.ptp(inside, axis=0) + 1) == nodes)
    space = points.x.shape[1] == 3
    return cheapest_method(nodes, box=box, space=space, stiff=stiff, loads=loads, bonds=bonds)


def by_gmres(problem: MatrixProblem, b: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The solution by GMRES with an incomplete factorisation, where a whole one is too large."""
    rough = spilu(problem.stiffness, drop_tol=1e-4, fill_factor=10)
    preconditioner = LinearOperator(problem.stiffness.shape, rough.solve)
    right, columns = problem.right(b, u), []
    for column in right.T:
        solved, failed = gmres(
            problem.stiffness, column, M=preconditioner, rtol=RESIDUAL / 10, restart=50, maxiter=20
        )
        if failed:
            raise InputError("GMRES did not converge on these nodes; try the method lu")
        columns.append(solved)
    solution = np.stack(columns, axis=1)
    problem.check(solution, right)
    return problem.filled(u, solution)


def refuse_indefinite(
    points: Points,
    stiffness: sp.csc_array,
    stencil: Callable[[], Stencil],
    *,
    allowed: bool = False,
) -> None:
    """Raise InputError when L_II is not positive definite, on lattices and where bonds are broken.

    On plain lattices by the symbol, and where that proves nothing by the smallest eigenvalue. Where
    bonds are broken, its symmetric part decides: a kernel that changes sign seldom bears that
    (theory, B9). Elsewhere nothing is asked.

    Args:
        points: the nodes.
        stiffness: L_II [stress/length²].
        stencil: gives that of the operator on a plain lattice.
        allowed: warn, where bonds are broken, instead.
    """
    if points.outside is not None:
        nodes = int(np.count_nonzero(points.interior))
        _judge_cut(sp.csc_array((stiffness + stiffness.T) / 2), nodes, allowed)
        return
    if not points.is_plain_lattice:
        return
    sides = np.ptp(lattice_steps(points)[0], axis=0) + 1
    torus = tuple(scipy.fft.next_fast_len(int(n), real=True) for n in sides)
    whole = stencil()
    if smallest_ratio(torus_symbol(torus, whole.steps, whole.tensors), torus) > 0:
        return
    smallest = smallest_eigenvalue(stiffness)
    if not smallest > 0:
        raise InputError(
            f"the operator on these {np.count_nonzero(points.interior)} nodes is indefinite: its "
            f"smallest eigenvalue is {smallest:.1e}, so that its equilibria are not stable"
        )


def _judge_cut(symmetric: sp.csc_array, nodes: int, allowed: bool) -> None:
    """Refuse, or warn of, a symmetric part that is not positive definite."""
    if definite_factors(symmetric) is not None:
        return
    smallest = smallest_eigenvalue(symmetric)
    if smallest > 0:
        return
    message = (
        f"outside: with these bonds broken the operator on {nodes} nodes is not "
        f"positive definite: the smallest eigenvalue of its symmetric part is "
        f"{smallest:.2g}, and its solutions may be wrong; Body(mesh, …) does without broken bonds"
    )
    if not allowed:
        raise InputError(message)
    warnings.warn(message, stacklevel=4)
