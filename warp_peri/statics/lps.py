"""How equilibria of a linear solid are found: its stencil, and methods that go with its points."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import scipy.fft
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, gmres, spilu

from warp_peri.core.stencil import Stencil
from warp_peri.core.sweeps import torus_symbol
from warp_peri.errors import InputError
from warp_peri.lps.model import Model, Solid, lps_stencil
from warp_peri.points.families import families_of
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.stability.certificate import smallest_eigenvalue
from warp_peri.statics.direct import RESIDUAL, MatrixProblem, definite_factors
from warp_peri.statics.linear import BONDS, Linear, cheapest_method, smallest_ratio

LARGEST_LU = 40_000
"""Most unknown nodes off lattices that are factorised whole."""


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
