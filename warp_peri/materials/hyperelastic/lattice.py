"""Lattice of a hyperelastic sheet. All that an energy sees is linear in e = |ξ|² s,
(H2), of the bonds around a site: q = S e."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy import ndarray
from numpy.linalg import eigvalsh, matrix_power
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import LinearOperator, splu

from warp_peri.errors import InputError
from warp_peri.materials.hyperelastic.energies import half_family, strain_weights
from warp_peri.points.arguments import Pair
from warp_peri.points.families import neighbour_table
from warp_peri.points.points import Points
from warp_peri.solvers.equilibria import Inner
from warp_peri.solvers.systems import end_of_spectrum

DIRECT = 20_000
"""Unknowns up to which the tangent is factorised; beyond, conjugate gradients take its products."""
SMALLEST_AREA = 0.02
"""Of the nodal strain, det C: below it a solve treats a field as folded."""
SHORT_REACH = 2**0.5
"""Horizon of the short strain in spacings, (H4)."""
AXIS_TOLERANCE = 1e-3
"""Degrees between the stated axis and that of the lattice."""
SHIFTS = 1e-3 * 4.0 ** np.arange(12)
"""Of the largest entry of the diagonal, added to all until a tangent is positive definite."""


@dataclass(frozen=True, eq=False)
class Sites:
    """The n sites where energies with the same Q inputs act.

    Attributes:
        S: of q = S e [1/length²], rows of one number after the other, shape [Q n, pairs].
        pair: the site, and the node that shares its energy or the site again, shape [2, n].
        corner: whether it is a corner at a node.
    """

    S: sp.csr_array
    pair: ndarray
    corner: bool

    def seen(self, e: ndarray) -> torch.Tensor:
        """Inputs q of the energies from bonds e [pairs, S], shape [Q, n, S]."""
        return torch.from_numpy((self.S @ e).reshape(-1, self.pair.shape[1], e.shape[1]))

    def pull(self, stress: Any) -> ndarray:
        """Bond tensions over ξ + η, [pairs, S], from energy derivatives [Q, n, S]."""
        return np.asarray(self.S.T @ np.asarray(stress).reshape(self.S.shape[0], -1))


class SheetLattice:
    """Bonds of range `reach` spacings on a square lattice, ξ and −ξ of one class.

    Directions of the material are relative to an axis of the lattice: that along the points' axis
    where it is stated, else the one at most 45° from x.

    Attributes:
        interior: numbers of the interior nodes, shape [I].
        grid: place of every node in lattice steps, shape [N, 2].
        steps: bond vectors in lattice steps, those of the half family first, shape [2 C, 2].
        neighbour: far end of every bond, −1 where there is none, shape [N, 2 C].
        pairs: every bond once: its ends i and j, shape [2, pairs].
        kind, xi: class and vector [length] of each, shapes [pairs] and [pairs, 2].
        number: which pair every bond is, shape [N, 2 C].
        ends: 1 at a pair's end and −1 at its beginning, shape [N, pairs].

    Raises InputError for scattered points, an axis beside those of the lattice, or where an
    interior node does not keep 2δ from the edge.
    """

    def __init__(self, points: Points, reach: float) -> None:
        self.points, self.reach, self.spacing = points, reach, points.spacing
        if points.box is not None or points.outside is not None:
            raise InputError("points: expected neither a box nor nodes outside of the body")
        grid, axes = points.lattice
        if points.axis is not None:
            own = np.rad2deg(np.arctan2(axes[1, 0], axes[0, 0]))
            quarters = round((points.axis - own) / 90)
            if abs(points.axis - own - 90 * quarters) > AXIS_TOLERANCE:
                raise InputError(
                    "axis: directions of a hyperelastic solid are told from an axis of the lattice;"
                    f" expected none, or {own:.4g}° and quarter turns from it, got {points.axis:g}°"
                )
            turn = matrix_power(np.array([[0, -1], [1, 0]]), quarters % 4)
            grid, axes = grid @ turn, axes @ turn
        half = half_family(reach)
        self.grid, self.steps = grid, np.concatenate([half, -half])
        self.neighbour = neighbour_table(grid, self.steps)
        self.interior = np.flatnonzero(points.interior)
        far = self.neighbour[points.interior]
        if not ((far >= 0).all() and (self.neighbour[far] >= 0).all()):
            raise InputError(
                "points: interior nodes need complete families out to twice the horizon"
            )
        ahead, behind = np.split(self.neighbour, 2, axis=1)
        i, self.kind = np.nonzero(ahead >= 0)
        self.pairs = np.stack([i, ahead[i, self.kind]])
        number = np.cumsum(ahead >= 0).reshape(ahead.shape) - 1
        self.number = np.concatenate([number, number[behind, np.arange(len(half))]], axis=1)
        numbers = np.tile(np.arange(len(i)), 2)
        self.ends = sp.csr_array((np.repeat([-1.0, 1.0], len(i)), (self.pairs.ravel(), numbers)))
        self.xi = points.spacing * half[self.kind] @ axes.T
        self.sites = cache(self._sites)

    def differences(self, u: ndarray) -> ndarray:
        """Bond displacements η = u_j − u_i of fields [S, N, 2], shape [pairs, 2, S]."""
        (i, j), u = self.pairs, np.ascontiguousarray(u.transpose(1, 2, 0))
        return np.asarray(np.take(u, j, axis=0) - np.take(u, i, axis=0))

    def stretched(self, u: ndarray) -> Pair:
        """Deformed bonds ξ + η, [pairs, 2, S], and e = ξ·η + ½ η·η, [pairs, S]."""
        eta, xi = self.differences(u), self.xi[..., None]
        return xi + eta, np.einsum("pas,pas->ps", xi + eta / 2, eta)

    def at_ends(self, pull: ndarray) -> ndarray:
        """Sum bond forces [pairs, 2, S] at the nodes, [S, N, 2]."""
        flat = self.ends @ pull.reshape(len(pull), -1)
        return np.asarray(flat.reshape(-1, *pull.shape[1:]).transpose(2, 0, 1))

    def _sites(self, kind: str = "strain", *of: int) -> Sites:
        """Sites of strains, bonds, deviations or corners; those that the interior does not move are
        left out (not of strains), for in the collar a field may be folded, its energy no number."""
        inside, number = self.points.interior, self.number
        one = sp.eye_array(len(self.kind), format="csr")  # its rows are bonds
        if kind == "strain":
            strains, whole, _ = self._strains(self.reach, 4)
            own = other = np.flatnonzero(whole)
            rows = [E[own] for E in strains]
        elif kind == "corner":
            p, q = of
            along, across, third = map(self.steps.tolist().index, ([p, 0], [0, q], [-p, q]))
            near = self.neighbour[:, [along, across]]
            moves = inside | inside[near].any(axis=1)
            own = other = np.flatnonzero((near >= 0).all(axis=1) & moves)
            x, y = one[number[own, along]], one[number[own, across]]
            rows = [x / p**2, y / q**2, (x + y - one[number[near[own, 0], third]]) / (p * q)]
        else:
            (x, y), length = of, np.dot(of, of)
            strains, whole, moves = self._strains(SHORT_REACH, 2)
            known = whole[self.pairs].all(axis=0) & moves[self.pairs].any(axis=0)
            chosen = np.flatnonzero(known & (self.steps[self.kind] == of).all(axis=1))
            own, other = self.pairs[:, chosen]
            mean = (x * x * strains[0] + y * y * strains[1] + x * y * strains[2]) / length
            s = one[chosen] / length
            rows = [s] if kind == "bond" else [2 * s, mean[own] + mean[other]]
        S = sp.csr_array(sp.vstack(rows) / self.spacing**2)
        return Sites(S, np.stack([own, other]), kind == "corner")

    def _strains(self, reach: float, order: int) -> tuple[list[Any], Any, Any]:
        """Nodal strains by bonds [N, pairs]; where whole, and moved by the interior, [N]."""
        w, inside = strain_weights(reach, order), self.points.interior
        short, C = len(w), len(self.steps) // 2
        family = self.neighbour[:, [*range(short), *range(C, C + short)]]
        of_bond, both = np.pad(w, ((0, C - short), (0, 0)))[self.kind], abs(self.ends)
        strains = [both @ sp.diags_array(one) for one in of_bond.T]
        return strains, (family >= 0).all(axis=1), inside | inside[family].any(axis=1)

    @cached_property
    def laplacian(self) -> sp.csr_array:
        """Five-point Laplacian on the interior, shape [I, N]."""
        near = self.ends[:, (self.steps[self.kind] ** 2).sum(axis=1) == 1]
        return sp.csr_array(near @ near.T)[self.interior] / self.spacing**2

    @cached_property
    def laplace(self) -> Any:
        """Inverse of the Laplacian between interior nodes."""
        return splu(self.laplacian[:, self.interior].tocsc()).solve

    def lift(self, u: ndarray) -> ndarray:
        """Replace the interior of u [N, 2] by the harmonic extension of the collar."""
        lifted = np.where(self.points.interior[:, None], 0.0, u)
        lifted[self.interior] = self.laplace(-(self.laplacian @ lifted))
        return lifted

    @property
    def rough(self) -> Inner | None:
        """Approximate inverse for all tangents, where none is factorised."""
        return self.laplace if 2 * len(self.interior) > DIRECT else None

    @cached_property
    def order(self) -> ndarray:
        """Numbering of the interior nodes by lines along the shorter side, for a narrow band."""
        inner = self.grid[self.interior]
        shorter = np.argmin(np.ptp(inner, axis=0))
        return np.lexsort((inner[:, shorter], inner[:, 1 - shorter]))

    def factors(self, K: sp.csc_array, shifts: bool = False) -> tuple[Inner | None, bool]:
        """Inverse of a tangent where it is positive definite, and whether it is; with `shifts` else
        that of a tangent made so by a multiple of one."""
        order = (2 * self.order[:, None] + [0, 1]).ravel()
        lower = sp.tril(K[order][:, order], format="coo")
        row, col = lower.coords
        band = np.zeros(((row - col).max() + 1, len(order)), order="F")
        band[row - col, col] = lower.data
        diagonal = band[0].copy()
        for shift in (0.0, *SHIFTS) if shifts else (0.0,):
            band[0] = diagonal + shift * np.abs(diagonal).max()
            try:
                factors = cholesky_banded(band, not shifts, lower=True)
            except (np.linalg.LinAlgError, ValueError):  # not definite, or no numbers
                continue
            return partial(_solve, factors, order), shift == 0
        return None, False


def _solve(factors: ndarray, order: ndarray, y: ndarray) -> ndarray:
    """K⁻¹ y from banded factors, its unknowns in an order; y as fields [I, 2] or [2 I, ...]."""
    x = np.empty((len(order), y.size // len(order)))
    x[order] = cho_solve_banded((factors, True), y.reshape(x.shape)[order], check_finite=False)
    return x.reshape(y.shape)


def softest(size: int, inverse: Inner, tolerance: float) -> float:
    """Smallest eigenvalue of a positive definite matrix, from its inverse."""
    if size <= 2:
        return 1 / float(eigvalsh(inverse(np.eye(size)))[-1])
    flexibility = LinearOperator((size, size), inverse, dtype=float)
    return 1 / end_of_spectrum(flexibility, "LA", tol=tolerance)
