"""A fluid that presses on a crack: minus the force that its missing bonds would carry (C13)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_peri.damage.cut_solid import CutSolid
from warp_peri.damage.operator import bond_weights, cut_matrix
from warp_peri.errors import InputError
from warp_peri.statics.solution import Solution


def crack_load(cut: CutSolid, stress: np.ndarray) -> np.ndarray:
    """Body force density [stress / length] that presses on what has been cut, shape [N, d].

    The bonds that are missing would carry some force in a body
    under the uniform stress; this is minus that force, so that a crack with it in a body pulled by
    the stress is as if it were not there (C13).

    Args:
        cut: the solid, of one material.
        stress: symmetric, shape [d, d]; p n⊗n for a pressure on faces with normal n.

    Raises InputError for another stress, and several materials.
    """
    if not cut.one:
        raise InputError("pressure: expected one material, got several")
    model, body = cut.model, cut.body
    lam, mu, d = model.lam, model.mu, model.dimension
    stress = np.asarray(stress, dtype=float)
    fine = stress.shape == (d, d) and np.isfinite(stress).all() and np.allclose(stress, stress.T)
    if not fine:
        raise InputError(
            f"stress: expected a finite, symmetric one of shape [{d}, {d}], got {stress.tolist()}"
        )
    bulk = d * (lam + 2 * mu / d)
    strain = (stress - lam / bulk * np.trace(stress) * np.eye(d)) / (2 * mu)
    u = (body.x @ strain).ravel()
    w = bond_weights(model, body.classes)
    whole = cut_matrix(body, w, body.neighbour, mu, lam - mu)
    load: np.ndarray = (whole @ u - cut.matrix @ u).reshape(body.x.shape)
    return load


def opening_volume(solution: Solution, normal: Sequence[float] | None = None) -> float:
    """Room between the faces of cracks with one normal [length^d], from the bonds across them.

    Each broken bond of one spacing along the normal is a column of the opening; cracks along a
    row of nodes. The solution is that of a Cracked; the normal is the second axis unless given.

    Raises InputError unless the normal is along an axis.
    """
    node, far, along = _columns(solution, normal)
    body, u = solution.operator.body, solution.u
    return float(body.spacing ** (body.dimension - 1) * ((u[far] - u[node]) @ along).sum())


def crack_area(solution: Solution, normal: Sequence[float] | None = None) -> float:
    """Length, in space area, of these cracks: a spacing or a square of it for each column."""
    body = solution.operator.body
    return float(len(_columns(solution, normal)[0]) * body.spacing ** (body.dimension - 1))


def _columns(
    solution: Solution, normal: Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes below and above a crack, joined by a bond that it broke, and the normal."""
    body, neighbour, d = solution.operator.body, solution.operator.neighbour, solution.u.shape[1]
    along = np.eye(d)[1] if normal is None else np.asarray(normal, dtype=float)
    if along.shape != (d,) or sorted(np.abs(along)) != [0] * (d - 1) + [1]:
        raise InputError(f"normal: expected one along an axis, as {(0, 1, 0)[:d]}, got {normal}")
    across = np.abs(body.xi - body.spacing * along).max(axis=1)
    step = int(np.argmin(across))
    if across[step] > 1e-6 * body.spacing:
        raise InputError("body: expected a lattice along the axes, got a turned one")
    node = np.flatnonzero((neighbour[:, step] < 0) & (body.neighbour[:, step] >= 0))
    return node, body.neighbour[node, step], along
