"""Problems on many ranks: bodies at rest, waves, and bodies that break.

A rank that breaks a body steps its nodes and those of others that they feel: within δ for bonds, 2δ
with a dilatation. After each drift the displacement of others' nodes comes from their owners, while
nodes that feel none of them are swept. All bonds that its own nodes feel then break here as they do
there, and nothing else is sent.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.contract import MATERIAL, SINGULAR, OnPoints, is_tensor, offered, taken
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
from warp_peri.kernels.damage.sweeps import sweep
from warp_peri.lps.model import Model
from warp_peri.points.arrays import checked_fields, plain
from warp_peri.points.families import HORIZON_TOLERANCE, bond_classes
from warp_peri.points.unit_names import check_same
from warp_peri.ranks.halo import NodeHalo
from warp_peri.ranks.linear import (
    Felt,
    RowDressed,
    RowOperator,
    ScatteredOperator,
    proven_at,
    tensors_at,
)
from warp_peri.ranks.petsc import petsc as loaded
from warp_peri.ranks.processes import build, in_turn, total
from warp_peri.statics.conjugate_gradients import SolveRecord, gmres, norm
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


UNEVEN = {"edges", "maps", "broken", "grains"}
"""Options of a dressed solid that ends, varies or is broken."""
STAGE, ROUNDS = 1e-3, 20
"""Of a residual, after which a linear solve with a checkpoint writes it; passes of GMRES, each of
which leaves some percent, on an adjoint."""


def solve(material: Any, problem: Any, solver: Solver, options: dict[str, Any]) -> Solution:
    """A Dirichlet problem on a piece; u and load are those of this rank's nodes.

    With the option checkpoint=PATH what was found is written as the solve goes, and a later one
    goes on from there, on any number of ranks. Of tensors, or with `parameters`, u is
    differentiable: see OnRanks.

    A dressed solid takes `edges`, `maps`, `broken` and `grains` as RowDressed has them.

    Raises InputError for other problems and laws, and as RowOperator, RowDressed and `definite` do.
    """
    numbers = options.pop("parameters", None)
    known = signature(getattr(material, "on", _asked)).parameters
    uneven = {name: options.pop(name) for name in UNEVEN & options.keys() & known.keys()}
    is_uneven = any(given is not None and given is not False for given in uneven.values())
    (asked,) = taken(options, "solve", _asked)
    piece, path = problem.points, _asked(**asked)
    with agreed(piece.comm):
        if not hasattr(problem, "u") or hasattr(problem, "cracks"):
            raise InputError("solve: expected a Dirichlet(points, b, u) on ranks")
        offered(material, "on", "solve", MATERIAL)
        learns = numbers is not None or is_tensor(problem.b) or is_tensor(problem.u)
        b, u = problem.b, problem.u
        if not learns:
            b, u = checked_fields(piece, b, u)
        elif path is not None:
            raise InputError("solve: expected no checkpoint of tensors")
        if getattr(solver, "eigenvalues", False):
            raise InputError("eigenvalues: not on ranks; one process knows them")
        petsc = _by_petsc(kind := getattr(solver, "preconditioner", None))
        if is_uneven and (learns or kind or piece.carrier):
            raise InputError("solve: expected a lattice, and neither tensors nor a preconditioner, "
                             f"with {', '.join(sorted(uneven))} on ranks")  # fmt: skip
        given = {n: np.asarray(plain(n, v.detach() if is_tensor(v) else v)).tolist()
                 for n, v in (numbers or {}).items()}  # fmt: skip
    if any(others != given for others in piece.comm.allgather(given)):
        raise InputError("parameters: expected the same on every rank")
    if is_uneven:
        return rest(RowDressed(material, piece, uneven), b, u, solver, path)
    operator = operator_on(material, piece, petsc)
    if not learns:
        return rest(operator, b, u, solver, path)
    b = np.zeros(np.shape(u)) if b is None else b
    learned: Solution = OnRanks(operator, material, solver).rest_in_torch(b, u, solver, numbers)
    return learned


def rest(operator: Any, b: np.ndarray, u: np.ndarray, solver: Solver, path: Any = None) -> Solution:
    """The Solution of `solve`, of what is on a piece, with a checkpoint where there is a path."""
    piece, bends = operator.points, hasattr(operator, "equilibria")
    kind = Newton if bends else Krylov
    refuse_solver(solver, (kind,), f"a {'nonlinear' if bends else 'linear'} body on ranks")
    tolerance = TOLERANCE if solver is None else solver.tolerance  # type: ignore[union-attr]
    inside, flat = piece.interior, [field.reshape(-1, *piece.x.shape) for field in (b, u)]
    kept = None
    if path is not None:
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
    petsc = solver is not None and getattr(solver, "preconditioner", None) == PETSC
    return Solution(
        answers.reshape(u.shape),
        piece,
        operator,
        loads.reshape(*b.shape[:-2], -1, b.shape[-1]),
        records[0].method if bends else operator.method + ", PETSc" * petsc,
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


class RowNonlinear(Felt):
    """L of a nonlinear solid on a lattice in tiles, and where it balances a load.

    Args:
        material: certified on the lattice, or on another.
        piece: the nodes of this rank, in tiles.

    Raises InputError as `material.on` and RowOperator do.
    """

    def __init__(self, material: Any, piece: Subdomain) -> None:
        super().__init__(piece, 2 * material.horizon * (1 + HORIZON_TOLERANCE), material.on)
        in_turn(piece.comm, lambda: self.placed(self._rest))  # one compiles
        self.model = self.placed.model
        self.strain = float(self.placed.model.proven_strain(piece.spacing))

    @cached_property
    def linear(self) -> RowOperator:
        """Its linear part in tiles, which is what is inverted."""
        return RowOperator(tensors_at(self.placed.model.linear, self.points), self.points)

    def _pulled(self, force: Callable[[np.ndarray], np.ndarray], u: np.ndarray) -> np.ndarray:
        """A force of the placed law at this rank's interior nodes, shape [i, d]."""
        return np.asarray(force(self.around(u)))[: self.points.interior.sum()]

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        return self._pulled(self.placed, u)

    def straight(self, u: np.ndarray) -> np.ndarray:
        """Its linear part at u, as above."""
        return self._pulled(self.placed.straight, u)

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
        if self.asked:
            square[self.placed.sweeps.full] = (H**2).sum(axis=(-2, -1))
        square = self.halo.joined(square, np.maximum)  # of its owner and of whoever feels it
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


class RowCut(Felt):
    """L of a Cracked whose bonds stay, on a lattice in parts: each rank has the bonds that its
    nodes feel.

    Args:
        material: positive on the lattice.
        problem: the Cracked, on the nodes of this rank.

    Raises InputError as Cracked.waves, and for nodes that are held in part.
    """

    def __init__(self, material: Any, problem: Cracked) -> None:
        piece: Any = problem.points
        with agreed(piece.comm):
            self.model = offered(material, "linear", "move", "a solid with a linear part")
            if problem.free is not None or problem.pressure is not None:
                raise InputError("move: expected neither free components nor a pressure on ranks")
        reach = 2 * self.model.horizon * (1 + HORIZON_TOLERANCE)
        alone = replace(problem, b=None, u=None)
        super().__init__(piece, reach, lambda here: replace(alone, points=here).waves(material))

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """L u at this rank's interior nodes, shape [i, d], of u [n, d]."""
        return np.asarray(self.placed.force(self.around(u)))[: self.points.interior.sum()]

    def stiffest_wave(self) -> float:
        """As CutSolid.stiffest_wave, of the rows of all ranks."""
        if not self.placed.corrected:
            return float(self.placed.stiffest_wave())
        own = float(abs(self.placed.matrix)[self.placed.free].sum(axis=1).max())
        return float(max(self.points.comm.allgather(own if self.asked else 0.0)))


class OnRanks(OnPoints):
    """A solid on ranks as torch sees it: its solve transposed, and derivatives to its numbers.

    What is differentiated is the sum over ranks of what each makes of its own nodes. Load and
    displacement of a rank get the part of its nodes, a number the whole on every rank. All ranks
    run backwards together.

    Args:
        operator: of operator_on.
        material: that it was made of.
        solver: of its solves.
    """

    def __init__(self, operator: Any, material: Any, solver: Solver) -> None:
        self.operator, self.points, self.solver = operator, operator.points, solver
        self.bends, self.model = isinstance(operator, Felt), material
        self.is_linear = not self.bends

    @cached_property
    def felt(self) -> Any:
        """The law on the nodes that this rank feels, as that of one process."""
        if self.bends:
            return self.operator
        if self.points.carrier:
            return _Carried(self.operator)
        stencil, piece = self.operator.stencil, self.points
        reach = max(stencil.reach * piece.spacing, 2 * self.model.horizon)
        return Felt(piece, reach * (1 + HORIZON_TOLERANCE), self.model.on)

    def rest(self, b: Any, u: Any, solver: Solver = None) -> Solution:
        """The Solution on this rank's nodes."""
        return rest(self.operator, *checked_fields(self.points, b, u), solver)

    @property
    def learnable(self) -> dict[str, Any]:
        """Numbers of the law by name, as on one process."""
        law = self.operator.model if self.points.carrier else self.felt.placed
        return law.learnable  # type: ignore[no-any-return]

    def at(self, numbers: Mapping[str, Any]) -> OnRanks:
        """The same with other numbers; InputError for those with which nothing is proven."""
        old, piece = self.operator, self.points
        if piece.carrier:
            operator: Any = ScatteredOperator(old.model.having(numbers), piece, old.petsc, old)
            return OnRanks(operator, operator.model, self.solver)
        felt = copy(self.felt)
        felt.placed = felt.placed.at(numbers)
        model = felt.placed.model
        if self.bends:
            felt.model, felt.strain = model, float(model.proven_strain(piece.spacing))
            return OnRanks(felt, model, self.solver)
        made = OnRanks(RowOperator(proven_at(model, piece), piece, old.petsc), model, self.solver)
        made.__dict__["felt"] = felt
        return made

    def _summed(self, each: Callable[[Any, np.ndarray], np.ndarray], u: Any, w: Any) -> np.ndarray:
        """Over ranks, at the own nodes [S, n, d], of what a law makes of fields and weights."""
        felt, pushed = self.felt, []
        for one, weights in zip(u, w):
            around = felt.around(one)
            here = each(around, weights) if felt.asked else np.zeros_like(felt.halo.x)
            pushed.append(felt.halo.joined(here, np.add))
        return np.array(pushed)

    def product_transpose(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The derivative transposed: of w on the interior [..., i, d], on all nodes [..., n, d]."""
        fields = np.reshape(u, (-1, *self.shape))
        flat = fields, w.reshape(len(fields), *w.shape[-2:])
        found = self._summed(lambda *of: self.felt.placed.product_transpose(*of), *flat)
        return found.reshape(np.shape(u))

    def load_transpose(self, w: np.ndarray) -> np.ndarray:
        """`load` transposed, of w on the interior [..., i, d], on all nodes [..., n, d]."""
        if not self.points.carrier:
            return self.on_all(w)
        none = np.zeros((int(np.prod(w.shape[:-2])), *self.shape))
        flat = w.reshape(len(none), *w.shape[-2:])
        found = self._summed(lambda _, one: self.felt.placed.load_transpose(one), none, flat)
        return found.reshape(*w.shape[:-2], *self.shape)

    def transposed(self, u: np.ndarray, g: np.ndarray) -> np.ndarray:
        """L′⁻ᵗ of g on the interior, [S, i, d] or one alone, at fields [S, n, d]."""
        tolerance = TOLERANCE if self.solver is None else self.solver.tolerance  # type: ignore[union-attr]
        g = g.reshape(len(u), *g.shape[-2:])
        if not self.bends:
            return np.array([self.operator.inverted(one, tolerance)[0] for one in g])
        return np.array([self._by_steps(*pair, tolerance) for pair in zip(u, g)])

    def _by_steps(self, field: np.ndarray, g: np.ndarray, tolerance: float) -> np.ndarray:
        """The same of one, by GMRES on what the linear part makes of residuals."""
        inside, inner, inverse = self.points.interior, self.points.inner, self.operator.inverse(1)

        def product(w: np.ndarray) -> np.ndarray:
            return np.asarray(self.product_transpose(field, w)[inside])

        w, size, left = np.zeros_like(g), inner.norm(g), g
        for _ in range(ROUNDS):
            if inner.norm(left) <= tolerance * size:
                return np.asarray(w)
            w = w + gmres(lambda p: inverse(product(p), STAGE), inverse(left, STAGE), inner)
            left = g - product(w)
        raise InputError(f"solve: {SINGULAR}")

    def by_numbers(self, name: str, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Derivatives of Σ w · force(u) to a number, of fields [K, n, d], summed over ranks."""
        around, own = np.stack([self.felt.around(one) for one in u]), np.shape(self.learnable[name])
        found: Any = np.zeros(own)
        if self.felt.asked:
            found = self.felt.placed.number_slopes([name], around, w)[name]
        return np.asarray(self.points.sum(np.reshape(found, (1, *own))))


class _Carried:
    """The same of scattered points, as Felt."""

    def __init__(self, operator: ScatteredOperator) -> None:
        self.halo, through = operator.halo, operator.through
        self.asked, self.around = through is not None, self.halo.felt
        if through is not None:
            given: dict[str, Any] = {"allow_uncertified": True, "carrier": through}
            self.placed = operator.model.on(through.points, **given)


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
    Of one with a density, or an unbroken body: see dynamics.verlet.march.

    Raises InputError for anything but steps, and for bonds that break by energy.
    """
    piece, comm = problem.points, problem.points.comm
    if hasattr(problem, "b") and not isinstance(problem, Cracked):
        with agreed(comm):
            offered(material, "on", "move", MATERIAL)
            (options,) = taken(options, "move", march)
        return march(operator_on(material, piece), problem.b, problem.u, **options)
    if isinstance(problem, Cracked) and "density" in options and not hasattr(material, "density"):
        with agreed(comm):
            (options,) = taken(options, "move", march)
        cut: Any = RowCut(material, problem)
        start = np.zeros_like(piece.x) if problem.u is None else problem.u
        return march(cut, problem.b, start, **options)
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
    d = piece.dimension
    excess = bonds_of(model, bond_classes(piece.spacing, model.horizon, dimension=d)).excess
    build(comm, neighbours.lattice_neighbours, sweep(d).sweep, halves(d).kick_and_drift)
    balls = 1 if excess == 0 and not problem.corrected else 2
    felt = balls * model.horizon * (1 + HORIZON_TOLERANCE)
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
        moving = BreakingBody(material, body, corrected=problem.corrected, **here, **how)
        state = moving.start(**at_start, cracks=problem.cracks, **begin)
    marching = CrackRun(moving, nodes=halo, **records)
    moving.operator.sweep_early(halo.is_own)
    moving.exchange = lambda u: halo.start(u.numpy())
    return broken(marching, state, run)
