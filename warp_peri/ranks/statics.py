"""A body at rest on many ranks: which of its nodes' fields fit, and what solves it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.contract import MATERIAL, offered, taken
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.micromodulus.law import Crystal
from warp_peri.points.arrays import checked
from warp_peri.ranks.kept import Kept
from warp_peri.ranks.linear import RowOperator, tensors_at
from warp_peri.ranks.nonlinear import RowNonlinear
from warp_peri.ranks.processes import agreed
from warp_peri.statics.equilibria import warn_beyond
from warp_peri.statics.settings import PETSC, TOLERANCE, Krylov, Newton, Solver, refuse_solver
from warp_peri.statics.solution import Solution

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece


def solve(material: Any, problem: Any, solver: Solver, options: dict[str, Any]) -> Solution:
    """A Dirichlet problem on a piece; u and load are those of this rank's nodes.

    A nonlinear solid is solved as in ranks.nonlinear. With the option checkpoint=PATH what was
    found is written as the solve goes, and a later one goes on from there, on any number of ranks.

    Raises InputError for other problems and laws, and as RowOperator and `definite` do.
    """
    (asked,) = taken(options, "solve", _asked)
    bends = hasattr(material, "proven_strain")
    kind = Newton if bends else Krylov
    refuse_solver(solver, (kind,), f"a {'nonlinear' if bends else 'linear'} body on ranks")
    tolerance = TOLERANCE if solver is None else solver.tolerance  # type: ignore[union-attr]
    piece = problem.points
    with agreed(piece.comm):
        if not hasattr(problem, "u") or hasattr(problem, "cracks"):
            raise InputError("solve: expected a Dirichlet(points, b, u) on ranks")
        offered(material, "on", "solve", MATERIAL)
        shape, inside = (..., *piece.x.shape), piece.interior[:, None]
        b = checked("b", problem.b, float, shape, inside)
        u = checked("u", problem.u, float, shape, ~inside)
        if b.shape != u.shape or b.ndim not in (2, 3):
            raise InputError(
                f"b, u: expected shape {list(piece.x.shape)} of this rank's nodes, or of samples, "
                f"got {list(b.shape)} and {list(u.shape)}"
            )
        if getattr(solver, "eigenvalues", False):
            raise InputError("eigenvalues: not on ranks; one process knows them")
        petsc = _by_petsc(getattr(solver, "preconditioner", None))
    operator = operator_on(material, piece, petsc)
    flat = [field.reshape(-1, *piece.x.shape) for field in (b, u)]
    kept = None
    if (path := _asked(**asked)) is not None:
        if len(flat[0]) > 1:
            raise InputError(f"checkpoint: expected one load, got {len(flat[0])}")
        kept = Kept(path, piece, flat[0][0], flat[1][0])
    found = [operator.solve(load, given, tolerance, kept) for load, given in zip(*flat)]
    records = tuple(record for _, record in found)
    if bends:
        warn_beyond(list(records), operator.strain)
    return Solution(
        np.reshape([answer for answer, _ in found], u.shape),
        piece,
        operator,
        np.reshape([operator.load(load) for load in flat[0]], (*b.shape[:-2], -1, b.shape[-1])),
        records[0].method if bends else "multigrid, PETSc" if petsc else "multigrid",
        tuple(record.solves if bends else record.iterations for record in records),
        operator.proven,
        details=records,
        measured=max(record.residual for record in records),
    )


def _asked(*, checkpoint: str | os.PathLike[str] | None = None) -> Any:
    """The options of a solve on ranks: the file of a checkpoint."""
    return checkpoint


def _by_petsc(preconditioner: str | None) -> bool:
    """Whether PETSc is asked for, and there."""
    if preconditioner not in (None, "multigrid", PETSC):
        raise InputError(
            f"preconditioner: expected multigrid or {PETSC} on ranks, got {preconditioner!r}"
        )
    if preconditioner == PETSC:
        from warp_peri.ranks.petsc import petsc

        petsc()
    return preconditioner == PETSC


def operator_on(material: Any, piece: Piece, petsc: bool = False) -> Any:
    """A solid on a lattice in tiles: RowOperator, or RowNonlinear with third-order constants; or
    a linear one on scattered points, ScatteredOperator. With `petsc` the coarse problem of a
    linear solid is PETSc's.

    Raises InputError for other laws, and as these do.
    """
    bends = hasattr(material, "proven_strain")
    with agreed(piece.comm):
        linear = getattr(material, "linear", material)
        if not isinstance(linear, (Crystal, Model)) or not (bends or linear is material):
            raise InputError(
                "material: expected a linear solid, a crystal, or one with third-order constants "
                f"on ranks, got {type(material).__name__}"
            )
        if piece.carrier and (bends or isinstance(linear, Crystal)):
            raise InputError("material: expected a linear solid on scattered points on ranks")
        law = None if bends or piece.carrier else tensors_at(linear, piece)
    if law is not None:
        return RowOperator(law, piece, petsc)
    if piece.carrier:
        from warp_peri.ranks.scattered import ScatteredOperator

        return ScatteredOperator(linear, piece, petsc)  # type: ignore[arg-type]  # checked above
    return RowNonlinear(material, piece)
