"""Least squares under equalities, and cuts that keep a symbol above a floor (theory.md, T7–T9)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from scipy.optimize import nnls

from warp_peri.core.basis import Basis
from warp_peri.core.stencil import bend, laplacian, ratios, zone_sample
from warp_peri.errors import InputError

ROUNDS, NEW_CUTS = 60, 40
MET = 1e-6
"""Relative, of the floor: what is above (1 − MET) of it is met."""
DEPENDENT = 1e-10


@dataclass
class Learned:
    """Numbers of a law and how they came out.

    Attributes:
        p: of the invariant tensors, shape [P].
        loss: ‖R p − y‖ / ‖y‖.
        free: the same without cuts.
        cuts: active or not, that were needed.
        smallest: smallest Λmin D(k)/s(k) on the grid, in the units of p times h².
    """

    p: np.ndarray
    loss: float
    free: float
    cuts: int
    smallest: float
    history: list[float] = field(default_factory=list)


def learn(
    R: np.ndarray,
    y: np.ndarray,
    bonds: Basis,
    group: np.ndarray,
    *,
    equal: tuple[np.ndarray, np.ndarray],
    floor: float,
) -> Learned:
    """min ‖R p − y‖ with A p = a and vᵗ D(k) v ≥ floor s(k) h² wherever a wave was found below it.

    Args:
        R, y: rows of the fit, shape [n, P] and [n].
        bonds: the family and its basis.
        group: of the nodes, which says how much of the zone is looked at.
        equal: A and a, shape [E, P] and [E], the largest entries of A around 1; rows that depend on
            others or vanish are allowed.
        floor: ζ in the units of p.

    Raises InputError for equalities that contradict one another, more numbers than the rows can
    tell, or a floor that no law of this family meets.
    """
    R, y = compressed(R, y)
    p0, free = particular(*equal)
    reduced = R @ free
    rest = y - R @ p0
    scale = float(np.linalg.norm(y)) or 1.0
    sizes = np.linalg.svd(reduced, compute_uv=False)
    if np.count_nonzero(sizes > 1e-12 * sizes.max(initial=0.0)) < free.shape[1]:
        raise InputError(
            f"data: expected enough to tell {free.shape[1]} numbers of {len(bonds.steps) * 2} "
            "bonds apart; give more loads, shorter waves, a smaller horizon or a larger symmetry"
        )
    phase = zone_sample(group, bonds.dimension)
    s, wave = laplacian(phase), bend(phase, bonds.steps)
    G, g = np.zeros((0, free.shape[1])), np.zeros(0)
    x = _inequality_least_squares(reduced, rest, G, g)
    unbound = float(np.linalg.norm(reduced @ x - rest)) / scale
    for _ in range(ROUNDS):
        tensors = np.tensordot(p0 + free @ x, bonds.basis, 1)
        value, vector = ratios(bonds.steps, tensors, phase)
        below = np.argsort(value)[:NEW_CUTS]
        below = below[value[below] < floor * (1 - MET)]
        if not len(below):
            break
        v = vector[below]
        work = np.einsum("axij,ki,kj->kax", bonds.basis, v, v, optimize=True)
        rows = np.einsum("kax,kx->ka", work, wave[below]) / s[below, None]
        G, g = np.concatenate([G, rows @ free]), np.append(g, floor - rows @ p0)
        x = _inequality_least_squares(reduced, rest, G, g)
    else:
        raise InputError(f"stability: the cuts did not settle in {ROUNDS} rounds")
    loss = float(np.linalg.norm(reduced @ x - rest)) / scale
    return Learned(p0 + free @ x, loss, unbound, len(g), float(value.min()))


def compressed(R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As few rows with the same least squares."""
    if len(R) <= R.shape[1] + 1:
        return R, y
    factor = scipy.linalg.qr(np.column_stack([R, y]), mode="r", overwrite_a=True)[0]
    factor = factor[: R.shape[1] + 1]
    return factor[:, :-1], factor[:, -1]


def particular(A: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One solution of A p = a and a basis of those of A p = 0, as columns."""
    if not len(A):
        return np.zeros(A.shape[1]), np.eye(A.shape[1])
    U, size, V = np.linalg.svd(A)
    rank = int((size > DEPENDENT).sum())
    p0 = V[:rank].T @ ((U[:, :rank].T @ a) / size[:rank])
    if np.abs(A @ p0 - a).max() > 1e-6 * max(np.abs(a).max(), 1e-300):
        raise InputError(
            "moduli: no law of this horizon and symmetry has them; a larger horizon or a "
            "smaller symmetry may"
        )
    return p0, V[rank:].T


def _inequality_least_squares(
    R: np.ndarray, y: np.ndarray, G: np.ndarray, g: np.ndarray
) -> np.ndarray:
    """min ‖R x − y‖ with G x ≥ g, by non-negative least squares (Lawson and Hanson, ch. 23)."""
    Q, T = np.linalg.qr(R)
    z = Q.T @ y
    if len(g):
        moved = scipy.linalg.solve_triangular(T, G.T, trans="T").T
        right = g - moved @ z
        size = np.linalg.norm(moved, axis=1)
        moved, right = moved / size[:, None], right / size
        unit = max(float(np.abs(right).max()), 1e-300)
        stacked = np.vstack([moved.T, right / unit])
        last = np.zeros(len(stacked))
        last[-1] = 1.0
        weight, _ = nnls(stacked, last, maxiter=50 * stacked.shape[1])
        left = stacked @ weight - last
        if abs(left[-1]) < 1e-14:
            raise InputError("stability: no law of this horizon and symmetry meets the floor")
        z = z - left[:-1] / left[-1] * unit
    return np.asarray(scipy.linalg.solve_triangular(T, z))
