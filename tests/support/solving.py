"""Solves and fits with what they are asked for one by one, which tests like to vary."""

from typing import get_args

from warp_peri import CG, LPS, Direct, Dirichlet
from warp_peri import solve as solved
from warp_peri.solvers.solution import Preconditioner


def solve(model, points, b, u, *, method="auto", iteration=None, **options):
    """Displacement; the method by its name, `iteration` as tolerance and records."""
    iteration = dict(iteration or {})
    records = iteration.pop("records", None)
    solver = None
    if method in get_args(Preconditioner) or (method == "auto" and iteration):
        solver = CG(None if method == "auto" else method, **iteration)
    elif method != "auto":
        solver = Direct(method == "gmres")
    solution = solved(model, Dirichlet(points, b, u), solver=solver, **options)
    if records is not None and solution.details:
        records.extend(solution.details)
    return solution.u


def fit(samples, horizon, kernel=None, *, noise=None, progress=None, **options):
    return LPS(horizon, kernel, **options).learn(samples, noise=noise, progress=progress)
