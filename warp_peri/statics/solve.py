"""Forward solves: displacement from loads, with a Dirichlet collar or on a periodic sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, gmres, spilu

from warp_peri.errors import InputError, renamed
from warp_peri.launch import DEVICE, known_device
from warp_peri.models.lps import Model
from warp_peri.operator.matrices import matrices
from warp_peri.operator.nominal_lattice import on_nominal_lattice
from warp_peri.operator.symbol import stiffnesses, symbol
from warp_peri.points.families import bond_classes, lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.strain import largest_strain, lattice_strain
from warp_peri.statics.definiteness import refuse_indefinite
from warp_peri.statics.direct import RESIDUAL, MatrixProblem
from warp_peri.statics.dirichlet import PRECONDITIONERS, SolveRecord
from warp_peri.statics.equilibrium import TOLERANCE, equilibrium
from warp_peri.statics.scattered import ThroughLattice
from warp_peri.statics.strain_range import warn_beyond
from warp_peri.transfer.cache import model_at
from warp_peri.transfer.points import model_for

DIRECT_METHODS = ("lu", "gmres")
DIRECT, LARGEST_LU = 4_000, 40_000
"""Most unknown nodes that are solved for directly, on lattices and on other point sets."""
STIFF = 30.0
"""λ/μ from which the strip at the edge costs less than the iterations that it saves."""
SINGULAR = 1e-13
"""Eigenvalues of the symbol below this fraction of the largest count as zero."""


@dataclass(frozen=True)
class Iteration:
    """Conjugate gradients of a solve.

    Attributes:
        tolerance: true residual over right-hand side.
        device: where they run, as Warp names it; factorisations stay on the processor.
        records: takes one SolveRecord for each sample that they solved.
    """

    tolerance: float = TOLERANCE
    device: str = DEVICE
    records: list[SolveRecord] | None = None


@renamed(
    box="part of Points(…, box=…)",
    outside="part of Points(…, outside=…)",
    **dict.fromkeys(("tolerance", "device", "records"), "part of iteration=Iteration(…)"),
)
def solve(
    model: Model,
    points: PointsLike,
    b: ArrayLike | None,
    u_collar: ArrayLike,
    *,
    quadrature_degree: int = DEGREE,
    method: str = "auto",
    transfer: bool = True,
    allow_uncertified: bool = False,
    iteration: Iteration = Iteration(),
) -> np.ndarray:
    """Displacement in equilibrium with b on the interior, given on the collar (theory.md, 29).

    Args:
        model: certified on some lattice; on others it is transferred, which is said once.
        points: a lattice or scattered points, which are solved on through a certified lattice of
            half their spacing (ThroughLattice); displacement outside the body is handed through.
        b: body force density [TPa/Å], shape [N, 2] or [S, N, 2]; only interior values count.
        u_collar: displacement [Å], same shape; only collar values count.
        quadrature_degree: as for LPSOperator.
        method: "auto" takes the cheapest by size and shape: "lu" for few nodes; on larger lattices
            conjugate gradients with "sine" for rectangles, "multigrid" for any nodes, or "strip"
            where λ ≫ μ; "gmres" with an incomplete LU for many scattered points. "fft" (the inverse
            symbol) and "cg" (plain) are there to compare.
        transfer: False refuses lattices that the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.
        iteration: tolerance and device of conjugate gradients, and records of what they took.

    Returns:
        u [Å], shape as given: u_collar on the collar, the solution on the interior.

    Raises InputError for arrays that do not fit, an uncertified spacing, another method, or an
    operator that is singular or (with allow_uncertified a warning) not positive definite.
    """
    known = ("auto", *DIRECT_METHODS, *PRECONDITIONERS)
    if method not in known:
        raise InputError(f"method: expected one of {', '.join(known)}, got {method!r}")
    load, u = checked_fields(nodes_of(points), b, u_collar)
    if points.spacing == 0 and transfer and not allow_uncertified and model.certified_on:
        return _through_lattice(model, points, load, u, method)
    model = model_for(model, points, transfer=transfer, allow_uncertified=allow_uncertified)
    nodes = on_nominal_lattice(model, points)
    plain = nodes.is_plain_lattice
    if method == "auto":
        method = choose_method(nodes, plain=plain, stiff=model.lam > STIFF * model.mu)
    load, u = (field.reshape(-1, len(nodes.x), 2) for field in (load, u))
    if method in PRECONDITIONERS:
        if not plain or quadrature_degree != DEGREE:
            raise InputError(
                f"method: {method} is for lattices without a box and without broken bonds, with "
                "quadrature of the usual degree; try lu or gmres"
            )
        answer = _iterated(nodes, load, u, model, method, iteration)
    else:
        options = method, quadrature_degree
        answer = _direct(nodes, load, u, model, *options, allowed=allow_uncertified)
    u[:, nodes.interior] = answer[:, nodes.interior]
    warn_beyond(model, lambda: largest_strain(nodes, u))
    return u.reshape(np.shape(u_collar))


def _direct(
    nodes: Points,
    load: np.ndarray,
    u: np.ndarray,
    model: Model,
    method: str,
    degree: int,
    *,
    allowed: bool,
) -> np.ndarray:
    """The solution of the assembled problem."""
    parts = matrices(model, nodes, quadrature_degree=degree)
    problem = MatrixProblem(parts.operator(model.lam, model.mu), nodes.interior)
    answer = problem.solve(load, u) if method == "lu" else by_gmres(problem, load, u)
    stiffness = problem.stiffness
    refuse_indefinite(nodes, model.horizon, model.solid, stiffness, degree=degree, allowed=allowed)
    return answer


def _iterated(
    nodes: Points, load: np.ndarray, u: np.ndarray, model: Model, method: str, iteration: Iteration
) -> np.ndarray:
    """The solution by conjugate gradients, where they are asked to run."""
    there = known_device(iteration.device)
    with torch.no_grad():
        answer = equilibrium(
            nodes,
            torch.from_numpy(load).to(there),
            torch.from_numpy(u).to(there),
            model.solid,
            horizon=model.horizon,
            method=method,
            tolerance=iteration.tolerance,
            records=iteration.records,
        )
    return answer.cpu().numpy()


def _through_lattice(
    model: Model, points: PointsLike, load: np.ndarray, u: np.ndarray, method: str
) -> np.ndarray:
    """The solution on scattered points by the operator of a certified lattice."""
    if method not in ("auto", "lu"):
        raise InputError(
            f"method: expected auto or lu on scattered points, got {method!r}, which is for the "
            "model's own numbers there (allow_uncertified)"
        )
    flat = u.reshape(-1, len(points.x), 2)
    answer = ThroughLattice(model, points).solve(load.reshape(flat.shape), flat)
    return answer.reshape(u.shape)


def checked_fields(
    points: Points, b: ArrayLike | None, u_collar: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    """Load and displacement as arrays, the second a copy; InputError where they do not fit."""
    if b is None:
        raise InputError("b: expected loads, got None")
    load, u = np.ascontiguousarray(b, dtype=float), np.array(u_collar, dtype=float, order="C")
    if load.shape != u.shape or load.ndim not in (2, 3) or load.shape[-2:] != (len(points.x), 2):
        raise InputError(
            f"b, u_collar: expected shape [S, {len(points.x)}, 2] or "
            f"[{len(points.x)}, 2], got {list(load.shape)} and {list(u.shape)}"
        )
    free = points.interior
    if not (np.isfinite(load[..., free, :]).all() and np.isfinite(u[..., ~free, :]).all()):
        raise InputError("b, u_collar: expected finite values")
    return load, u


def choose_method(points: PointsLike, *, plain: bool, stiff: bool = False) -> str:
    """The cheapest method for a point set.

    Args:
        points: whose interior nodes are solved for.
        plain: a lattice without a box or broken bonds.
        stiff: λ ≫ μ.
    """
    nodes = int(np.count_nonzero(points.interior))
    if not plain:
        return "lu" if nodes <= LARGEST_LU else "gmres"
    if nodes <= DIRECT:
        return "lu"
    if stiff:
        return "strip"
    inside, _ = lattice_steps(
        Points(points.x[points.interior], np.ones(nodes, bool), points.spacing)
    )
    return "sine" if np.prod(inside.max(axis=0) + 1) == nodes else "multigrid"


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


def solve_periodic(
    model: Model,
    b: ArrayLike,
    *,
    spacing: float,
    transfer: bool = True,
    allow_uncertified: bool = False,
) -> np.ndarray:
    """Displacement of a periodic sheet under a load of zero mean, by FFT of the symbol.

    Args:
        model: certified on some lattice; on others it is transferred, which is said once.
        b: body force density on the lattice [TPa/Å], shape [..., n₁, n₂, 2]; its mean is removed.
        spacing: h [Å].
        transfer: False refuses lattices that the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.

    Returns:
        u [Å] of zero mean, shape as given.

    Raises InputError for a load that does not fit, an uncertified spacing, or a symbol that is
    singular at a wave vector of the sheet.
    """
    model = model_at(model, spacing, transfer=transfer, allow_uncertified=allow_uncertified)
    spacing = model.nominal_spacing(spacing)
    b = np.asarray(b, dtype=float)
    if b.ndim < 3 or b.shape[-1] != 2 or not np.isfinite(b).all():
        raise InputError(
            f"b: expected finite values of shape [..., n1, n2, 2], got {list(b.shape)}"
        )
    classes = bond_classes(spacing, model.horizon)
    shape = b.shape[-3:-1]
    waves = [2 * np.pi * np.fft.fftfreq(n, spacing) for n in shape]
    k = np.stack(np.meshgrid(*waves, indexing="ij"), axis=-1).reshape(-1, 2)
    d11, d22, d12 = symbol(classes, k).entries(*stiffnesses(model, classes))
    d11[0] = d22[0] = 1.0  # k = 0: a mean load has no answer; the transform below is zeroed there
    D = np.stack([d11, d12, d12, d22], axis=1).reshape(*shape, 2, 2)
    transform = np.fft.fftn(b, axes=(-3, -2))
    transform[..., 0, 0, :] = 0
    size = np.abs(np.linalg.eigvalsh(D))
    if not size.min() > SINGULAR * size.max():
        raise InputError("the symbol is singular at a wave vector of this sheet")
    wave = np.linalg.solve(D, transform[..., None])[..., 0]
    u: np.ndarray = np.fft.ifftn(wave, axes=(-3, -2)).real
    warn_beyond(model, lambda: lattice_strain(u, spacing))
    return u
