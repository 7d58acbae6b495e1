"""A fluid that presses on a crack: minus the force that its missing bonds would carry (C13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.damage.cut_solid import CutSolid
from warp_peri.damage.lattice_body import Body, cracked
from warp_peri.damage.operator import bond_weights, cut_matrix
from warp_peri.damage.stability import check_horizon
from warp_peri.errors import InputError
from warp_peri.models.lps import Model


def crack_load(model: Model, body: Body, neighbour: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """Body force density [stress / length] that presses on what has been cut, shape [N, 2].

    The bonds that are missing between `body` and `neighbour` would carry some force in a body
    under the uniform stress; this is minus that force, so that a crack with it in a body pulled by
    the stress is as if it were not there (C13).

    Args:
        model: of the solid.
        body: with its whole bonds.
        neighbour: with broken bonds, shape [N, B].
        stress: symmetric, shape [2, 2]; p n⊗n for a pressure on faces with normal n.

    Raises InputError for another stress, and a body of another horizon.
    """
    check_horizon(model, body)
    lam, mu = model.lam, model.mu
    stress = np.asarray(stress, dtype=float)
    fine = stress.shape == (2, 2) and np.isfinite(stress).all() and np.allclose(stress, stress.T)
    if not fine:
        raise InputError(
            f"stress: expected a finite, symmetric one of shape [2, 2], got {stress.tolist()}"
        )
    strain = (stress - lam / (2 * (lam + mu)) * np.trace(stress) * np.eye(2)) / (2 * mu)
    u = (body.x @ strain).ravel()
    w = bond_weights(model, body.classes)
    matrices = (cut_matrix(body, w, table, mu, lam - mu) for table in (body.neighbour, neighbour))
    whole, cut = (matrix @ u for matrix in matrices)
    load: np.ndarray = (whole - cut).reshape(-1, 2)
    return load


def opening_volume(
    body: Body, u: np.ndarray, neighbour: np.ndarray, normal: tuple[float, float] = (0.0, 1.0)
) -> float:
    """Area between the faces of cracks with one normal [length²], from the bonds across them.

    Each broken bond of one spacing along the normal is a column of the opening; cracks along a
    row of nodes.

    Raises InputError unless the normal is along an axis.
    """
    if sorted(np.abs(normal)) != [0, 1]:
        raise InputError(f"normal: expected one along an axis, as (0, 1), got {normal}")
    across = np.abs(body.xi - body.spacing * np.array(normal)).max(axis=1)
    step = int(np.argmin(across))
    if across[step] > 1e-6 * body.spacing:
        raise InputError("body: expected a lattice along the axes, got a turned one")
    node = np.flatnonzero((neighbour[:, step] < 0) & (body.neighbour[:, step] >= 0))
    far = body.neighbour[node, step]
    return float(body.spacing * ((u[far] - u[node]) @ normal).sum())


@dataclass(frozen=True)
class Injection:
    """A crack that a fluid drives through a body.

    Attributes:
        half: its half length at each stage, shape [K].
        pressure: at which it is about to grow [stress], shape [K].
        volume: of the fluid in it then [length²], shape [K].
        pumped: volume pumped at each stage, leaks included, shape [K].
    """

    half: np.ndarray
    pressure: np.ndarray
    volume: np.ndarray
    pumped: np.ndarray


def inject(
    model: Model,
    body: Body,
    held: np.ndarray,
    halves: Sequence[float],
    toughness: float,
    *,
    leak: float = 0.0,
    compressibility: float = 0.0,
) -> Injection:
    """Slow growth of a crack |x| < a on y = 0 by pressure, with the fluid's balance (C14).

    At each half length the pressure is that of G = G_c; G of unit pressure is p² half the change of
    the opening's volume with the crack's length.

    Args:
        model, body, held: as for CutSolid.
        halves: half lengths in rising order, multiples of the spacing, one or more.
        toughness: G_c [stress · length].
        leak: volume lost per length of new face [length], ≥ 0.
        compressibility: of the fluid [1 / stress], ≥ 0.

    Raises InputError for half lengths that do not rise, a toughness not > 0, and a fluid below 0.
    """
    if not (0 <= leak < np.inf and 0 <= compressibility < np.inf):
        raise InputError(
            f"leak, compressibility: expected numbers ≥ 0, got {leak} and {compressibility}"
        )
    rising = len(halves) > 0 and halves[0] > body.spacing and (np.diff(halves) > 0).all()
    if not (rising and 0 < toughness < np.inf):
        raise InputError(
            f"crack: expected half lengths that rise from more than {body.spacing:g} and a "
            f"toughness > 0, got {list(halves)} and {toughness:g}"
        )
    h, stress = body.spacing, np.array([[0.0, 0.0], [0.0, 1.0]])

    def volume(half: float) -> float:
        neighbour = cracked(body, [[(-half, 0.0), (half, 0.0)]])
        solid = CutSolid(model, body, held, neighbour=neighbour)
        u = solid.solve(np.zeros_like(body.x), crack_load(model, body, neighbour, stress))
        return opening_volume(body, u, neighbour)

    rows = []
    for half in halves:
        here, longer, shorter = (volume(half + d) for d in (0.0, h, -h))
        released = (longer - shorter) / (2 * h) / 4  # per tip, at unit pressure: ½ dV/d(2a)
        pressure = float(np.sqrt(toughness / released))
        open_volume = pressure * here
        pumped = open_volume * (1 + compressibility * pressure) + leak * 4 * half
        rows.append((half, pressure, open_volume, pumped))
    return Injection(*np.array(rows).T)


def sneddon_opening(
    x: ArrayLike, half: float, pressure: float, lam: float, mu: float
) -> np.ndarray:
    """Half the opening of a crack |x| < half under pressure in a plane; I. N. Sneddon, 1946."""
    inside = np.sqrt(np.maximum(half**2 - np.square(x), 0.0))
    opening: np.ndarray = pressure * (lam + 2 * mu) / (2 * mu * (lam + mu)) * inside
    return opening
