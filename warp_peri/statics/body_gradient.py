"""Derivatives of a function of a body's displacement by its loads and by λ and μ (B12–B14)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.lps.operator import NodeOperator
from warp_peri.lps.symbol import moduli
from warp_peri.points.families import bond_classes
from warp_peri.statics.body import BodySolution
from warp_peri.statics.body_loads import loads_on
from warp_peri.statics.rim import Field, Moduli, Traction
from warp_peri.statics.schwarz import Schwarz
from warp_peri.statics.settings import TOLERANCE


@dataclass(frozen=True, eq=False)
class BodyGradient:
    """Derivatives of J(u), with everything else held.

    Attributes:
        lam, mu: by λ and μ of the model on its lattice [J/TPa], in the bulk and the rim's moduli.
        f: by the load on the rim's nodes [J/(TPa Å)], shape [n, 2].
        b: by the body force density at the bulk's unknown nodes [J/(TPa/Å)], shape [I, 2].
        given: by the displacement of the rim's held nodes [J/Å], shape [n, 2]; zero elsewhere.
        solution: of the body.
    """

    lam: float
    mu: float
    f: np.ndarray
    b: np.ndarray
    given: np.ndarray
    solution: BodySolution

    def along(
        self,
        *,
        displacement: Mapping[str, Field | ArrayLike] | None = None,
        traction: Mapping[str, Traction | ArrayLike] | None = None,
        b: Field | None = None,
    ) -> float:
        """dJ of a change of the loads, given as solve_body takes them.

        Raises InputError for a part that the mesh has not, and displacement where none was held.
        """
        rim, points = self.solution.rim, self.solution.points
        change = loads_on(rim.mesh, displacement or {}, traction, b)
        total = float(np.vdot(self.f, change.on(rim)))
        if points is not None:
            total += float(
                np.vdot(self.b, change.density(points.x[points.interior], points.spacing))
            )
        given, fixed = change.given(rim)
        if (fixed & ~_held(self.solution)).any():
            raise InputError("displacement: expected parts that are held, and the same components")
        return total + float(np.vdot(self.given, given))


def _held(solution: BodySolution) -> np.ndarray:
    """Displacements of the rim's nodes that were held, shape [n, 2] bool."""
    problem = solution.problem
    rim = problem.rim if isinstance(problem, Schwarz) else problem
    held = ~rim.free.reshape(-1, 2)
    held[solution.rim.inner] = False
    return held


def body_gradient(
    solution: BodySolution,
    by_rim: np.ndarray,
    by_bulk: np.ndarray | None = None,
    *,
    tolerance: float = TOLERANCE,
) -> BodyGradient:
    """Derivatives of J by loads, held displacement, λ and μ, by one adjoint solve.

    Args:
        solution: of solve_body.
        by_rim: ∂J/∂u of the rim's nodes, shape [n, 2].
        by_bulk: ∂J/∂u of the bulk's nodes, shape [N, 2]; None for none. `probe` of the solution
            turns derivatives at positions into both.
        tolerance: of the adjoint exchange.

    Raises InputError for other shapes.
    """
    if not isinstance(solution.model, Model):
        raise InputError("solution: expected a body of a peridynamic solid, got one of a crystal")
    by_bulk = np.zeros_like(solution.u_bulk) if by_bulk is None else np.asarray(by_bulk, float)
    by_rim = np.asarray(by_rim, dtype=float)
    if by_rim.shape != solution.u_rim.shape or by_bulk.shape != solution.u_bulk.shape:
        raise InputError(
            f"by_rim, by_bulk: expected shapes {list(solution.u_rim.shape)} and "
            f"{list(solution.u_bulk.shape)}, got {list(by_rim.shape)} and {list(by_bulk.shape)}"
        )
    problem = solution.problem
    if isinstance(problem, Schwarz):
        bulk = problem.bulk
        by_rim = by_rim + problem.to_bulk.T @ by_bulk[bulk.collar]
        (f, b), given = problem.solve_back(by_rim, by_bulk[bulk.inside], tolerance)
        given[problem.inner] = 0  # not held: the bulk's
    else:
        f, given = (part.reshape(-1, 2) for part in problem.solve_back(by_rim.ravel()))
        b = np.zeros((0, 2))
    lam, mu = _by_lame(solution, f, b)
    return BodyGradient(lam, mu, f, b, given, solution)


def _by_lame(solution: BodySolution, f: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """−(w · ∂K u + v · ∂L u) by λ and μ, of which K and L are homogeneous of degree one (B14)."""
    model = solution.model
    here = _work(solution, model, f, b)
    further = _work(solution, dataclasses.replace(model, lam=model.lam + model.mu), f, b)
    lam = (further - here) / model.mu
    return -lam, -(here - model.lam * lam) / model.mu


def _work(solution: BodySolution, model: Model, f: np.ndarray, b: np.ndarray) -> float:
    """w · K u + v · L u with the λ and μ of a model."""
    classes = bond_classes(solution.spacing, model.horizon)
    K = solution.rim.stiffness(Moduli.square(**moduli(model, classes)))
    total = float(np.vdot(f, (K @ solution.u_rim.ravel()).reshape(-1, 2)))
    if solution.points is not None:
        force = NodeOperator(model, solution.points, allow_uncertified=True)(solution.u_bulk)
        total += float(np.vdot(b, force))
    return total
