"""The two verbs of mechanics: what is at rest, and what moves."""

from __future__ import annotations

from typing import Any

from warp_peri.files.checkpoint import ALONE, agreed
from warp_peri.points.arguments import check_flag, check_mapping, is_piece
from warp_peri.protocols import offered, uncompiled
from warp_peri.solvers.motion import Motion, refuse_learning
from warp_peri.solvers.solution import Solution, Solver, told

PROBLEMS = "a problem: Dirichlet(points, b, u), Periodic(points, b), Body(mesh, …) or Cracked(…)"


def solve(material: Any, problem: Any, *, solver: Solver = None, **options: Any) -> Solution:
    """A material in equilibrium.

    Args:
        material: what `fit` or `load` gave, or its operator, `material.on(points)`, where the same
            points are solved on again.
        problem: Dirichlet(points, b, u), Periodic(points, b), Body(mesh, …), Cracked(…).
        solver: Direct(…), CG(…) or Newton(…), as the material has them; chosen by default.
        options: transfer=False refuses points that the material itself holds no certificate for;
            allow_uncertified=True takes its own numbers there, with a warning; parameters={name:
            tensor} of the operator's `learnable`, which the answer is then differentiable in.

    Returns:
        The solution, with its residual, what is proven of it, and what was warned of. Of tensors
        in a Dirichlet its u is differentiable, along the branch of equilibria that it lies on.

    Raises InputError for what does not fit, naming what was expected, and for a gradient that is
    asked for and not had.

    >>> wp.solve(model, wp.Dirichlet(points, b[0], u[0])).residual < 1e-8
    True
    """
    solved = offered(problem, "solved", "solve", PROBLEMS)
    _check(problem, options, "solve")
    if _on_ranks(problem):
        return told(lambda: problem.points.solve(material, problem, solver, options))
    return told(uncompiled(lambda: solved(material, solver, options)))


def simulate(material: Any, problem: Any, **options: Any) -> Motion:
    """A material in motion: waves, growing cracks, loads that rise slowly, flow.

    Args:
        material: as for `solve`.
        problem: what is given; its displacement is that of the start.
        options: of the material's motion: `step` [ps] and `steps`, `density` [kg/m³], `every`
            (steps between two records), `record` (nodes), `checkpoint`, `progress`; see the
            `moved` of the problem.

    Returns:
        The motion: times, histories by name, the fields at the end. Waves, heat and coupled fields
        of torch tensors are differentiable, in `parameters` too: see solvers.adjoint.

    Raises InputError for what does not fit, and for a step that is not proven stable.

    >>> start = wp.Dirichlet(points, b[0], u[0])
    >>> wp.simulate(model, start, density=2e3, step=0.005, steps=4).u.shape
    (441, 2)
    """
    moved = offered(
        problem, "moved", "simulate", "a problem that moves, as Dirichlet(points, b, u)"
    )
    _check(problem, options, "simulate")
    if _on_ranks(problem):
        return problem.points.move(material, problem, options)  # type: ignore[no-any-return]
    return uncompiled(moved)(material, options)  # type: ignore[no-any-return]


FLAGS = {"transfer", "allow_uncertified", "count_cracks"}
"""Options that are True or False."""


def _check(problem: Any, options: dict[str, Any], verb: str) -> None:
    """InputError, on all ranks, for options of another kind than their names say, and for tensors
    that ask for a gradient of a problem that has none."""
    with agreed(problem.points.comm if _on_ranks(problem) else ALONE):
        for name in FLAGS & options.keys():
            check_flag(name, options[name])
        for name in {"parameters", "watch", "regions", "sections"} & options.keys():
            if options[name] is not None:
                check_mapping(name, options[name])
        if _on_ranks(problem) or not hasattr(problem, "learns"):
            refuse_learning(problem, options, verb)


def _on_ranks(problem: Any) -> bool:
    """Whether its points are a piece of some that many processes have."""
    return is_piece(getattr(problem, "points", None))
