"""Dressed bodies in equilibrium: factorised, iterated, or held by nothing (theory.md, D10)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu

from warp_peri.errors import InputError
from warp_peri.statics.conjugate_gradients import definite
from warp_peri.statics.direct import MatrixProblem
from warp_peri.statics.settings import Direct, Krylov, Solver, refuse_solver
from warp_peri.statics.solution import Solution

if TYPE_CHECKING:
    from warp_peri.dressed.body import DressedBody

MOST_DIRECT = 1500
"""Nodes in space beyond which conjugate gradients are taken for a factorisation."""
BALANCED, MET = 1e-4, 1e-6
"""Relative, of the resultant of a free body's load, which is taken off, and of a residual."""
WHY = "one answer; L = Gᵗ K G ⪰ 0 whatever is uneven, missing or broken"


def at_rest(body: DressedBody, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
    """A body in equilibrium with b on the interior, u given elsewhere, shape [..., N, d].

    With no node held the load must balance, and the answer neither moves nor turns as a whole (on a
    period it does not move).

    Raises InputError for another solver, for loads that do not balance, and for a body that falls
    apart.
    """
    refuse_solver(solver, (Direct, Krylov), "a dressed body")
    inside, iterated = body.points.interior, isinstance(solver, Krylov)
    if solver is None:
        iterated = body.points.x.shape[1] == 3 and int(inside.sum()) > MOST_DIRECT
    asked = solver if isinstance(solver, Krylov) else Krylov()
    if asked.preconditioner is not None:
        raise InputError(
            "solver: expected Krylov(tolerance=…) alone for a dressed body, whose "
            f"preconditioner is its own diagonal, got {asked!r:.100}"
        )
    turned, pulled = (body.fields(field) @ body.axes for field in (u, b))
    alive = body.stiffness.any(axis=1)
    dead = np.abs(pulled[:, inside & ~alive]).max(initial=0.0)
    if dead > BALANCED * np.abs(pulled).max():
        raise InputError("b: expected no load on nodes that nothing belongs to")
    took: tuple[int, ...] = ()
    if iterated:
        answer, left, steps = _iterated(body, pulled, turned, alive & inside, asked.tolerance)
        took = (steps,) * len(pulled)
    elif inside.all():
        answer, left = _free(body, pulled)
    else:
        unknown = np.repeat(alive & inside, turned.shape[-1])
        problem = MatrixProblem(sp.csr_array(body.L[unknown]), alive & inside)
        answer = problem.solve(pulled, turned)
        left = problem.left
    answer = (answer @ body.axes.T).reshape(np.shape(u))
    answer = np.where(inside[:, None], answer, u)
    method = "cg" if iterated else "lu"
    return Solution(answer, body.points, body, body.load(b), method, took, WHY, measured=left)


def _iterated(
    body: DressedBody, loads: np.ndarray, held: np.ndarray, unknown: np.ndarray, tolerance: float
) -> tuple[np.ndarray, float, int]:
    """u [S, N, d] by conjugate gradients of G, K and G in turn, residual and iterations."""
    shape, mask = held.shape, np.repeat(unknown, held.shape[-1])[:, None]
    rigid = _rigid(body) if body.points.interior.all() else np.zeros((mask.size, 0))
    diagonal = body.stiffness.reshape(-1, 1)
    inverse = mask / np.where(diagonal > 0, diagonal, 1.0)

    def alone(r: np.ndarray) -> np.ndarray:
        return np.asarray(r - rigid @ (rigid.T @ r))

    def product(v: np.ndarray) -> np.ndarray:
        return alone(mask * body.in_turn(alone(v)))

    def precondition(r: np.ndarray) -> np.ndarray:
        return alone(inverse * alone(r))

    flat, start = (f.reshape(len(f), -1).T for f in (loads, np.where(unknown[:, None], 0.0, held)))
    right = mask * (_balanced(flat, rigid) - body.in_turn(start))
    try:
        found, record = definite(product, precondition, right, tolerance)
    except InputError as error:  # L ⪰ 0: a direction without energy is a part that is loose
        raise InputError(f"the body falls apart, or nearly: {error}") from None
    answer = (start + found).T.reshape(shape)
    return answer, record.residual, record.iterations


def _balanced(right: np.ndarray, rigid: np.ndarray) -> np.ndarray:
    """Loads [d N, S] without their resultant, which must be small."""
    along = rigid.T @ right
    if np.linalg.norm(along) > BALANCED * np.linalg.norm(right):
        raise InputError(
            "b: expected loads that balance, for no node is held; their resultant is "
            f"{np.linalg.norm(along) / np.linalg.norm(right):.1e} of them"
        )
    return np.asarray(right - rigid @ along)


def _free(body: DressedBody, loads: np.ndarray) -> tuple[np.ndarray, float]:
    """u [S, N, d] of a body that nothing holds, and the relative residual."""
    rigid = _rigid(body)
    right = _balanced(loads.reshape(len(loads), -1).T, rigid)
    stiffness = body.L.diagonal()
    scale = float(stiffness.max())
    # rigid motions are held by rows of their own, and so is what belongs to nothing
    alone = sp.diags_array(np.where(stiffness > 0, 0.0, scale))
    edge = sp.csr_array(scale * rigid)
    bordered = sp.block_array([[body.L + alone, edge], [edge.T, None]], format="csc")
    try:
        found = splu(bordered).solve(np.vstack([right, np.zeros((rigid.shape[1], len(loads)))]))
    except RuntimeError as error:
        raise InputError(f"the body falls apart: it is singular ({error})") from None
    answer = found[: len(right)]
    size = np.maximum(np.linalg.norm(right, axis=0), 1e-300)
    left = float((np.linalg.norm(body.L @ answer - right, axis=0) / size).max())
    if not left < MET:
        raise InputError(f"the body falls apart: the residual of its solve is {left:.1e}")
    return answer.T.reshape(loads.shape), left


def _rigid(body: DressedBody) -> np.ndarray:
    """Orthonormal rigid motions of the nodes that carry something, [d N, m].

    On a period translations alone.
    """
    x = (body.points.x - body.points.x.mean(axis=0)) @ body.axes
    count, d = x.shape
    found = [np.tile(np.eye(d)[a], count) for a in range(d)]
    if body.points.box is None:
        for a in range(d):
            for c in range(a):
                turn = np.zeros((count, d))
                turn[:, a], turn[:, c] = x[:, c], -x[:, a]
                found.append(turn.ravel())
    return np.linalg.qr(np.array(found).T * (body.stiffness.ravel() > 0)[:, None])[0]
