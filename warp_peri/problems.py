"""Problems that a material is solved for: points, loads, boundary values; solve and simulate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import ALONE, InputError, agreed
from warp_peri.fe_coupling.body import solve_body
from warp_peri.fe_coupling.boundary_elements import Field, Traction
from warp_peri.points.arguments import (
    Options,
    as_array,
    check_mapping,
    checked,
    is_piece,
    is_tensor,
    offered,
    picked,
    taken,
    typed,
)
from warp_peri.points.mesh import Mesh
from warp_peri.points.points import Points, PointsLike, nodes_of
from warp_peri.protocols import OF_PROOFS, check_collar, placed, uncompiled
from warp_peri.solvers.adjoint import in_motion
from warp_peri.solvers.motion import Motion, refuse_learning
from warp_peri.solvers.solution import Coupling, Solution, Solver, refuse_solver, told

GIVEN = ("displacement", "traction", "b", "coupling")
"""What a Body says itself, and no option may."""
OPTIONS_OF = {"signal": ("b",), "ramp": ("b", "grip"), "checkpoint_every": ("checkpoint",)}
"""Options, and what is given or asked for beside them, without which they change nothing."""
LINEAR = (
    "a linear material for a Body; of another, displacement is given on a collar (wp.Dirichlet), "
    "and free edges are for finite elements (a sheet: hyperelastic.save_febio)"
)


@typed
@dataclass(frozen=True, eq=False)
class Dirichlet:
    """Problem with load on the interior and displacement given on the collar (theory, 29).

    Attributes:
        points: a lattice or scattered points, or samples on them.
        b: body force density [stress/length], shape [N, d] or [S, N, d]; None for no load. Only
            interior values count; on scattered points also those of the collar next to it, since
            the load goes over as a density. Of diffusion the source, shape [N]. Of tensors the
            answer is one, differentiable in b, u and `parameters`.
        u: displacement [length], same shape; only collar values count. Of diffusion φ, [N].

    `solve` raises InputError for a shape that does not fit, naming the array.

    >>> wp.solve(model, wp.Dirichlet(points, b, u)).u.shape
    (12, 441, 2)
    """

    points: PointsLike
    b: Any
    u: Any
    learns = True  # gradients

    def __post_init__(self) -> None:
        if self.u is None:
            raise InputError("u: expected a displacement, zeros of a body held at rest, got None")

    def solved(self, material: Any, solver: Any, options: Options) -> Solution:
        """Solve for the material at rest."""
        extra = picked(options, "parameters")
        check_collar(nodes := nodes_of(self.points))
        operator = placed(material, nodes, **options)
        load = self.b
        if load is None:
            load = np.zeros((self.u if is_tensor(self.u) else as_array("u", self.u)).shape)
        rest = operator.solve
        if extra or is_tensor(self.b) or is_tensor(self.u):
            rest = getattr(operator, "solve_torch", rest)
        return rest(load, self.u, solver, **extra)  # type: ignore[no-any-return]

    def moved(self, material: Any, options: Options) -> Motion:
        """Solve for the material in motion, from the displacement u.

        `options` are those of the law's own motion, or of solvers.verlet.march: `v`, `density`,
        `step`, `steps`, `every`, `record`, `signal`; and `transfer`, `allow_uncertified`. Of
        tensors, or with `parameters`, it is that of solvers.adjoint.moved. Flow, as of heat, has
        the options of solvers.adjoint.stepped.
        """
        operator = placed(material, nodes_of(self.points), **picked(options, *OF_PROOFS))
        if hasattr(operator, "march"):
            if "parameters" not in signature(operator.march).parameters:
                refuse_learning(self, options, "simulate")
            (options,) = taken(options, "simulate", operator.march)
            return operator.march(self.b, self.u, **options)  # type: ignore[no-any-return]
        offered(operator, "jvp", "simulate", "a material that moves on points")
        return in_motion(operator, self.b, self.u, options)


@typed
@dataclass(frozen=True, eq=False)
class Periodic:
    """Problem with a load of zero mean on a periodic lattice (theory, 59).

    Attributes:
        points: a lattice with a box, all of its nodes interior; see Points.sheet.
        b: body force density [stress/length], shape [N, d] or [S, N, d]; its mean is removed. Of
            tensors the answer is one, as of a Dirichlet.

    `solve` raises InputError for points that are no lattice with a box, for nodes that are not
    interior, for a load of another shape, and for a material that solves no periodic problems.

    >>> sheet = wp.Points.sheet((12, 12), 5.0)
    >>> wp.solve(model, wp.Periodic(sheet, 1e-4 * np.sin(2 * np.pi * sheet.x / 60))).u.shape
    (144, 2)
    """

    points: Points
    b: Any
    learns = True

    def solved(self, material: Any, solver: Any, options: Options) -> Solution:
        """Solve for the material at rest, with a displacement of zero mean."""
        extra = picked(options, "parameters")
        operator = placed(material, nodes_of(self.points), **options)
        rest = offered(operator, "solve_periodic", "solve", "a model that solves periodic problems")
        if extra or is_tensor(self.b):
            like = self.b.detach() if is_tensor(self.b) else as_array("b", self.b)
            return operator.solve_torch(self.b, 0 * like, solver, **extra)  # type: ignore[no-any-return]
        load = checked("b", self.b, float, (..., *self.points.x.shape))
        return rest(load, solver)  # type: ignore[no-any-return]


@typed
@dataclass(frozen=True, eq=False)
class Body:
    """A body with free edges on a mesh: held in part, pulled in part (theory, B1–B7).

    Attributes:
        mesh: the body, triangles or, of a crystal in space, tetrahedra; its positions [length].
        displacement: [length] by part of the outline: a vector [d], or a function of positions
            [n, d] that gives [n, d]; NaN leaves a component free.
        traction: force per area [stress] by part: a vector [d], or a function of positions and
            outward normals [n, d] that gives [n, d].
        b: body force density [stress/length], a function of positions [n, d] that gives [n, d].
        coupling: how elements and lattice meet.

    `solve` raises InputError for parts that the mesh does not have, or that are held apart where
    they meet, fields of other shapes or not finite, a body that is free to move, a hole narrower
    than the overlap, another unit or dimension, and a material not linear or not positive definite.

    >>> body = wp.Body(mesh, {"left": (0.0, 0.0)}, {"right": (0.005, 0.0)})
    >>> wp.solve(model, body).residual < 1e-8
    True
    """

    mesh: Mesh
    displacement: Mapping[str, Field | ArrayLike]
    traction: Mapping[str, Traction | ArrayLike] | None = None
    b: Field | None = None
    coupling: Coupling = field(default_factory=Coupling)

    def solved(self, material: Any, solver: Any, options: Options) -> Solution:
        """Solve for the material at rest; the solution's details are a BodySolution."""
        if not hasattr(material, "tensors"):  # a crystal, which elements go on for at the edge
            offered(material, "spread", "solve", LINEAR)
        refuse_solver(solver, (), "a Body, whose coupling says how it is solved")
        (options,) = taken(options, "solve", solve_body, given=GIVEN)
        body = solve_body(material, self.mesh, **{n: getattr(self, n) for n in GIVEN}, **options)
        method = "elements" if body.points is None else "elements and lattice"
        u, made = body.on_corners()[0], body.exchange
        off = max(made.rim_residual, made.bulk_residual)
        return Solution(u, None, None, None, method, (made.exchanges,), details=body, measured=off)


PROBLEMS = "a problem: Dirichlet(points, b, u), Periodic(points, b), Body(mesh, …) or Cracked(…)"


def solve(material: Any, problem: Any, *, solver: Solver = None, **options: Any) -> Solution:
    """Solve for the equilibrium of a material.

    Args:
        material: what `fit` or `load` gave, or its operator, `material.on(points)`, where the same
            points are solved on again.
        problem: Dirichlet(points, b, u), Periodic(points, b), Body(mesh, …), Cracked(…).
        solver: Direct(…), CG(…) or Newton(…), as the material has them; chosen by default.
        options: transfer=False refuses points that the material itself holds no certificate for;
            allow_uncertified=True takes its own numbers there, with a warning; parameters={name:
            tensor} of the operator's `learnable`, which the answer is then differentiable in.

    Returns the solution, with its residual, what is proven of it, and what was warned of. Of
    tensors in a Dirichlet its u is differentiable, along the branch of equilibria that it lies on.
    Raises InputError for what does not fit, naming what was expected, and for gradients not had.

    >>> wp.solve(model, wp.Dirichlet(points, b[0], u[0])).residual < 1e-8
    True
    """
    solved = offered(problem, "solved", "solve", PROBLEMS)
    if _on_ranks(problem, options, "solve"):
        return told(lambda: problem.points.solve(material, problem, solver, options))
    return told(uncompiled(lambda: solved(material, solver, options)))


def simulate(material: Any, problem: Any, **options: Any) -> Motion:
    """Solve for the motion of a material: waves, growing cracks, loads that rise slowly, flow.

    Args:
        material: as for `solve`.
        problem: what is given; its displacement is that of the start.
        options: of the material's motion: `step` [ps] and `steps`, `density` [kg/m³], `every`
            (steps between two records), `record` (nodes), `checkpoint`, `progress`; see the `moved`
            of the problem.

    Returns times, histories by name, the fields at the end. Waves, heat and coupled fields of torch
    tensors are differentiable, in `parameters` too: see solvers.adjoint. Raises InputError for what
    does not fit, and for a step that is not proven stable.

    >>> start = wp.Dirichlet(points, b[0], u[0])
    >>> wp.simulate(model, start, density=2e3, step=0.005, steps=4).u.shape
    (441, 2)
    """
    moved = offered(
        problem, "moved", "simulate", "a problem that moves, as Dirichlet(points, b, u)"
    )
    if _on_ranks(problem, options, "simulate"):
        return problem.points.move(material, problem, options)  # type: ignore[no-any-return]
    return uncompiled(moved)(material, options)  # type: ignore[no-any-return]


def _on_ranks(problem: Any, options: Options, verb: str) -> bool:
    """Whether a problem's points are a piece of a body; InputError, on all ranks, for options
    of another kind than their names say or of nothing, and tensors whose gradient is not had."""
    points = getattr(problem, "points", None)
    pieces = is_piece(points)
    with agreed(points.comm if pieces else ALONE):  # type: ignore[union-attr]
        for name in ("parameters", "watch"):
            if options.get(name) is not None:
                check_mapping(name, options[name])
        for name, of in OPTIONS_OF.items():
            if options.get(name) is not None and not any(
                one in options or getattr(problem, one, None) is not None for one in of
            ):
                raise InputError(f"{name}: expected {' or '.join(of)} beside it, which it is of")
        if pieces or not hasattr(problem, "learns"):
            refuse_learning(problem, options, verb)
    return pieces
