"""Problems on many ranks: bodies at rest, waves, and bodies that break.

A rank that breaks a body steps its nodes and those of others that they feel: within δ for bonds, 2δ
with a dilatation. After each drift the displacement of others' nodes comes from their owners, while
nodes that feel none of them are swept. All bonds that its own nodes feel then break here as they do
there, and nothing else is sent.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.contract import MATERIAL, offered, taken
from warp_peri.damage.lattice_body import lattice_body
from warp_peri.damage.march import CrackRun
from warp_peri.damage.motion import BreakingBody
from warp_peri.damage.operator import bonds_of
from warp_peri.damage.problems import Cracked, broken, options_of_steps
from warp_peri.dynamics.motion import Motion
from warp_peri.dynamics.verlet import march
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import RunFile, agreed
from warp_peri.kernels import neighbours
from warp_peri.kernels.damage.motion import halves
from warp_peri.kernels.damage.sweeps import sweeps
from warp_peri.lps.model import Model
from warp_peri.points.arrays import checked_fields
from warp_peri.points.families import HORIZON_TOLERANCE, bond_classes
from warp_peri.points.points import Points
from warp_peri.points.unit_names import check_same
from warp_peri.ranks.halo import NodeHalo
from warp_peri.ranks.linear import RowOperator, ScatteredOperator, one_node, tensors_at
from warp_peri.ranks.petsc import petsc as loaded
from warp_peri.ranks.processes import build, in_turn, total
from warp_peri.statics.conjugate_gradients import SolveRecord, norm
from warp_peri.statics.equilibria import Equilibria, Force, solve_each, warn_beyond
from warp_peri.statics.solution import (
    PETSC,
    TOLERANCE,
    Krylov,
    Newton,
    Solution,
    Solver,
    refuse_solver,
)

if TYPE_CHECKING:
    from warp_peri.ranks.subdomain import Subdomain
    from warp_peri.statics.linear import Inverse


STAGE = 1e-3
"""Of a residual, after which a linear solve with a checkpoint writes it."""


def solve(material: Any, problem: Any, solver: Solver, options: dict[str, Any]) -> Solution:
    """A Dirichlet problem on a piece; u and load are those of this rank's nodes.

    With the option checkpoint=PATH what was found is written as the solve goes, and a later one
    goes on from there, on any number of ranks.

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
        b, u = checked_fields(piece, problem.b, problem.u)
        if getattr(solver, "eigenvalues", False):
            raise InputError("eigenvalues: not on ranks; one process knows them")
        petsc = _by_petsc(getattr(solver, "preconditioner", None))
    operator = operator_on(material, piece, petsc)
    inside, flat = piece.interior, [field.reshape(-1, *piece.x.shape) for field in (b, u)]
    kept = None
    if (path := _asked(**asked)) is not None:
        if len(flat[0]) > 1:
            raise InputError(f"checkpoint: expected one load, got {len(flat[0])}")
        kept = Kept(path, piece, flat[0][0], flat[1][0])
    answers, records = np.where(inside[:, None], 0.0, flat[1]), list[Any]()
    loads = np.stack([operator.load(load) for load in flat[0]])
    if bends:
        way, strain = operator.equilibria(kept), operator.strain
        largest = operator.largest_gradient
        records, proven = solve_each(way, loads, answers, tolerance, strain, largest)
        warn_beyond(records, strain)
    else:
        for field, load, given in zip(answers, *flat):
            field[:], record = solved(operator, load, given, tolerance, kept)
            records.append(record)
        proven = operator.proven
    return Solution(
        answers.reshape(u.shape),
        piece,
        operator,
        loads.reshape(*b.shape[:-2], -1, b.shape[-1]),
        records[0].method if bends else "multigrid, PETSc" if petsc else "multigrid",
        tuple(record.solves if bends else record.iterations for record in records),
        proven,
        details=tuple(records),
        measured=max(record.residual for record in records),
    )


def solved(
    operator: Any, b: np.ndarray, u: np.ndarray, tolerance: float, kept: Kept | None
) -> tuple[np.ndarray, SolveRecord]:
    """Displacement [n, d] of a linear operator with load b on the interior, u given elsewhere.

    With `kept` the answer is written each time that the residual is STAGE of what it was.
    """
    inside, load = operator.points.interior, operator.load(b)
    field = np.where(inside[:, None], 0.0, u)
    right = load - operator(field)
    if kept is None:
        field[inside], record = operator.inverted(right, tolerance)
        return field, record
    inner, record, last = operator.points.inner, SolveRecord(), np.inf
    size = norm(right, inner)
    if (start := kept.start()) is not None:
        field[inside] = start[inside]
    while (left := norm(rest := load - operator(field), inner)) > tolerance * size:
        if not left < last:
            raise InputError(
                f"tolerance: {tolerance:.1e} of the load was asked for, the residual stays at "
                f"{last / size:.1e}, which is rounding"
            )
        last = left
        more, part = operator.inverted(rest, max(tolerance * size / left, STAGE))
        field[inside] += more
        record.iterations += part.iterations
        kept.keep(field)
    record.residual = left / size if size > 0 else 0.0
    return field, record


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
        loaded()
    return preconditioner == PETSC


def operator_on(material: Any, piece: Subdomain, petsc: bool = False) -> Any:
    """A solid on a lattice in tiles: RowOperator, or RowNonlinear with third-order constants; or
    a linear one on scattered points, ScatteredOperator. With `petsc` the coarse problem of a
    linear solid is PETSc's.

    Raises InputError for other laws, and as these do.
    """
    bends = hasattr(material, "proven_strain")
    with agreed(piece.comm):
        linear = getattr(material, "linear", material)
        if not hasattr(linear, "stencil") or not (bends or linear is material):
            raise InputError(
                "material: expected a linear solid, a crystal, or one with third-order constants "
                f"on ranks, got {type(material).__name__}"
            )
        if piece.carrier and (bends or not isinstance(linear, Model)):
            raise InputError("material: expected a linear solid on scattered points on ranks")
        law = None if bends or piece.carrier else tensors_at(linear, piece)
    if law is not None:
        return RowOperator(law, piece, petsc)
    if piece.carrier:
        return ScatteredOperator(linear, piece, petsc)
    return RowNonlinear(material, piece)


class RowNonlinear:
    """L of a nonlinear solid on a lattice in tiles, and where it balances a load.

    Args:
        material: certified on the lattice, or on another.
        piece: the nodes of this rank, in tiles.

    Raises InputError as `material.on` and RowOperator do.
    """

    def __init__(self, material: Any, piece: Subdomain) -> None:
        comm = piece.comm
        self.points = piece
        reach = 2 * material.horizon * (1 + HORIZON_TOLERANCE)
        self.halo = halo = NodeHalo(piece, reach)
        x, inside = halo.x, np.zeros(len(halo.x), bool)
        inside[halo.own] = piece.interior
        self._asked = bool(inside.any())
        if not self._asked:  # the law needs an unknown node: one of a body of its own, at rest
            x, inside = one_node(2, piece.spacing, reach)
        self._rest = np.zeros_like(x)
        with agreed(comm):
            here = Points(x, inside, piece.spacing, units=piece.units, axis=piece.axis)
            self.placed = material.on(here)
        in_turn(comm, lambda: self.placed(self._rest))  # one compiles
        self.model = self.placed.model
        self.strain = float(self.placed.model.proven_strain(piece.spacing))

    @cached_property
    def linear(self) -> RowOperator:
        """Its linear part in tiles, which is what is inverted."""
        return RowOperator(tensors_at(self.placed.model.linear, self.points), self.points)

    def around(self, u: np.ndarray) -> np.ndarray:
        """u [n, d] on all nodes that this rank feels."""
        field = self.halo.felt(u)
        return field if self._asked else self._rest

    def _pulled(self, force: Callable[[np.ndarray], np.ndarray], u: np.ndarray) -> np.ndarray:
        """A force of the placed law at this rank's interior nodes, shape [i, d]."""
        return np.asarray(force(self.around(u)))[: self.points.interior.sum()]

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        return self._pulled(self.placed, u)

    def straight(self, u: np.ndarray) -> np.ndarray:
        """Its linear part at u, as above."""
        return self._pulled(self.placed.straight, u)

    def load(self, b: np.ndarray) -> np.ndarray:
        """b on this rank's interior, which the operator equals in equilibrium."""
        return np.asarray(b, dtype=float)[..., self.points.interior, :]

    def inverse(self, loads: int) -> Inverse:
        """As RowOperator.inverse, of the linear part."""
        return self.linear.inverse(loads)

    def largest_gradient(self, u: np.ndarray) -> float:
        """Largest |H|, of all ranks."""
        own = float(self.placed.largest_gradient(self.around(u)))
        return float(max(self.points.comm.allgather(own)))

    def mean_gradient(self, u: np.ndarray) -> float:
        """Root mean square of |H| over all nodes within δ of unknown ones, of all ranks."""
        H, _ = self.placed.gradients(self.around(u))
        square = np.full(len(self.halo.x), -1.0)
        if self._asked:
            square[self.placed.sweeps.full] = (H**2).sum(axis=(-2, -1))
        square = self.halo.largest(square)  # of its owner and of whoever feels it
        felt = square >= 0
        added, count = total(self.points.comm, np.stack([square * felt, felt], axis=1))
        return float(np.sqrt(added / count))

    def equilibria(self, kept: Kept | None) -> Equilibria:
        """Where it balances loads on this rank's interior."""
        piece = self.points

        def clipped() -> Force:
            return partial(self._pulled, self.placed.clipped(self.strain))

        return Equilibria(
            self, self.straight, self.inverse(1), piece.interior,
            clipped if self.strain > 0 else None, inner=piece.inner, kept=kept,
        )  # fmt: skip


class Kept:
    """A checkpoint of a body at rest.

    Args:
        path: of the file; it need not be there yet.
        piece: the nodes of this rank.
        b, u: what is given of the problem, shape [n, d]; a file of another one is refused.
    """

    def __init__(
        self, path: str | os.PathLike[str], piece: Subdomain, b: np.ndarray, u: np.ndarray
    ) -> None:
        inside = piece.interior[:, None]
        self.file = RunFile(path, "warp_peri.rest", piece)
        self._least = np.inf
        self._mark = piece.mark(np.where(inside, b, 0.0), np.where(inside, 0.0, u), inside)

    def start(self) -> np.ndarray | None:
        """The displacement [n, d] that was kept; None before one was.

        Raises InputError for a file of another problem, or none that can be read.
        """
        if (kept := self.file.read("u")) is None:
            return None
        if kept[1]["mark"] != self._mark:
            raise InputError(f"{self.file.path}: expected a checkpoint of this problem")
        return kept[0]["u"]

    def seen(self, u: np.ndarray, size: float) -> None:
        """Keep u where its residual is the smallest so far; all ranks come here."""
        if size < self._least:
            self._least = size
            self.keep(u)

    def keep(self, u: np.ndarray) -> None:
        """Write u [n, d], whole or not at all; all ranks come here."""
        self.file.write({"u": u}, {"mark": self._mark})


def move(material: Any, problem: Any, options: dict[str, Any]) -> Motion:
    """Motion of a Cracked on ranks: see Cracked.moved; fields are those of this rank's nodes.
    Of an unbroken body: see dynamics.verlet.march.

    Raises InputError for anything but steps, and for bonds that break by energy.
    """
    piece, comm = problem.points, problem.points.comm
    if hasattr(problem, "b") and not isinstance(problem, Cracked):
        with agreed(comm):
            offered(material, "on", "move", MATERIAL)
            (options,) = taken(options, "move", march)
        return march(operator_on(material, piece), problem.b, problem.u, **options)
    with agreed(comm):
        if not isinstance(problem, Cracked) or "step" not in options:
            raise InputError("move: expected a Dirichlet or Cracked, and step=…, steps=… on ranks")
        offered(material, "density", "move", "a BrittleSolid")
        if material.by_energy or problem.pressure is not None:
            raise InputError(
                "move: expected bonds that break by their stretch, and no pressure, on ranks"
            )
        check_same(material.units, piece.units)
        material.linear.check_dimension(piece)
        how, begin, records, run = options_of_steps(options)
    model = material.model
    classes = bond_classes(piece.spacing, model.horizon, dimension=piece.dimension)
    excess = bonds_of(model, classes).excess
    d, made = piece.dimension, sweeps(piece.dimension, bool(material.tension_only))
    build(comm, neighbours.lattice_neighbours, made.state_based, halves(d).kick_and_drift)
    felt = model.horizon * (1 + HORIZON_TOLERANCE) * (1 if excess == 0 else 2)
    halo = NodeHalo(piece, felt)
    given: dict[str, Any] = {"load": problem.b, "held": problem.held, "u": problem.u}
    given |= {name: how.pop(name, None) for name in ("no_fail", "grip")}
    given["v"] = begin.pop("v", None)
    with agreed(comm):
        for name, values in given.items():
            if values is not None and len(np.asarray(values)) != len(piece.x):
                raise InputError(f"{name}: expected {len(piece.x)} nodes of this rank")
    here: dict[str, Any] = {
        name: None if v is None else halo.around(v) for name, v in given.items()
    }
    with agreed(comm):
        body = lattice_body(halo.x, piece.spacing, model.horizon)
        if not np.array_equal(body.axes, np.eye(d)):
            raise InputError("points: expected a lattice along the axes on ranks, got a turned one")
        at_start = {name: here.pop(name) for name in ("u", "v")}
        moving = BreakingBody(material, body, **here, **how)
        state = moving.start(**at_start, cracks=problem.cracks, **begin)
    marching = CrackRun(moving, nodes=halo, **records)
    moving.operator.sweep_early(halo.is_own)
    moving.exchange = lambda u: halo.start(u.numpy())
    return broken(marching, state, run)
