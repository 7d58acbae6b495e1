"""Bonds of a sheet's lattice, the sites where energies act on them, and the tangent as a band.

All that an energy sees is linear in e = |ξ|² s, (H2), of the bonds around a site: q = Wᵗ e.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from warp_peri.errors import InputError
from warp_peri.materials.hyperelastic.energies import half_family, strain_weights
from warp_peri.points.lattice import neighbour_table, straight_steps
from warp_peri.points.points import Points
from warp_peri.solvers.direct import lanczos_start
from warp_peri.solvers.equilibria import Inner

SHORT_REACH = 2**0.5
"""Horizon of the short strain in spacings, (H4)."""
CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Sides of the bonds along both axes that a corner of a cell has, (H19)."""
AXIS_TOLERANCE = 1e-3
"""Degrees between the stated axis and that of the lattice."""
SHIFTS = 1e-3 * 4.0 ** np.arange(12)
"""Of the largest entry of the diagonal, added to all until a tangent is positive definite."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Bonds around each of the n sites where energies act that see the same.

    Attributes:
        nodes: that a site's bonds join, shape [V, n].
        offsets: their places in lattice steps from the site, shape [V, 2].
        ends: which of them a bond begins and ends at, shape [2, L].
        bonds: numbers of the bonds, shape [L, n].
        weights: W [1/length²], shape [L, Q].
        pair: the site, and the node that shares its energy with it or the site again, [2, n].
        corner: whether it is one of the four corners at a node, which share an energy.
    """

    nodes: np.ndarray
    offsets: np.ndarray
    ends: np.ndarray
    bonds: np.ndarray
    weights: np.ndarray
    pair: np.ndarray
    corner: bool

    @cached_property
    def sums(self) -> sp.csr_array:
        """Sums by bond, shape [pairs up to the last, L n]."""
        bonds = self.bonds.ravel()
        places, one = np.arange(len(bonds) + 1), np.ones(len(bonds))
        return sp.csr_array(sp.csc_array((one, bonds, places)))

    def seen(self, e: np.ndarray) -> torch.Tensor:
        """q of bonds [S, pairs], shape [Q, S, n]."""
        return torch.from_numpy((self.weights.T @ e[:, self.bonds]).swapaxes(0, 1))

    def along(self, stress: torch.Tensor) -> np.ndarray:
        """What stresses [Q, S, n] pull at each site's bonds, [S, L, n]."""
        return np.asarray(self.weights @ stress.numpy().swapaxes(0, 1))

    def pull(self, stress: torch.Tensor, tension: np.ndarray) -> None:
        """Add what stresses [Q, S, n] pull at the bonds to their tension [S, pairs]."""
        pulled = self.sums @ self.along(stress).reshape(len(tension), -1).T
        tension[:, : len(pulled)] += pulled.T


class SheetLattice:
    """Families of `reach` spacings on the nodes of a square lattice, bonds ξ and −ξ of one class.

    The axes, from which directions of the solid are told, are those of the lattice: along the
    points' axis where it is stated, else at most 45° from x.

    Attributes:
        interior: numbers of the interior nodes, shape [I].
        grid: place of every node in lattice steps, shape [N, 2].
        steps: bond vectors in lattice steps, those of the half family first, shape [2 C, 2].
        neighbour: far end of every bond, −1 where there is none, shape [N, 2 C].
        pairs: every bond once: its ends i and j, shape [2, pairs].
        xi: their vectors [length], shape [2, pairs].
        number: which pair begins at a node, by class, shape [N, C].
        ends: 1 at a pair's end and −1 at its beginning, shape [N, pairs].

    Raises InputError for scattered points, an axis beside those of the lattice, or where an
    interior node does not keep 2δ from the edge.
    """

    def __init__(self, points: Points, reach: float) -> None:
        self.points, self.reach, self.spacing = points, reach, points.spacing
        if not points.spacing > 0:
            raise InputError("points: expected a lattice (spacing > 0), got scattered points")
        if points.box is not None or points.outside is not None:
            raise InputError("points: expected neither a box nor nodes outside of the body")
        grid, axes = straight_steps(points.x, points.spacing)
        if points.axis is not None:
            own = float(np.rad2deg(np.arctan2(axes[1, 0], axes[0, 0])))
            quarters = round((points.axis - own) / 90)
            if abs(points.axis - own - 90 * quarters) > AXIS_TOLERANCE:
                raise InputError(
                    "axis: directions of a hyperelastic solid are told from an axis of the lattice;"
                    f" expected none, or {own:.4g}° and quarter turns from it, got {points.axis:g}°"
                )
            turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarters % 4)
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
        there = self.neighbour[:, : len(half)] >= 0
        i, c = np.nonzero(there)
        self.pairs = np.stack([i, self.neighbour[i, c]])
        self.number = np.cumsum(there).reshape(there.shape) - 1
        signs, numbers = np.repeat([-1.0, 1.0], len(i)), np.tile(np.arange(len(i)), 2)
        self.ends = sp.csr_array((signs, (self.pairs.ravel(), numbers)))
        self.xi = np.ascontiguousarray(points.spacing * axes @ half[c].T)
        self._patches: dict[Any, Patch] = {}

    def differences(self, u: np.ndarray) -> np.ndarray:
        """η = u_j − u_i of fields [S, N, 2], shape [S, 2, pairs]."""
        (i, j), u = self.pairs, np.ascontiguousarray(u.swapaxes(1, 2))
        return np.asarray(np.take(u, j, axis=2) - np.take(u, i, axis=2))

    def stretched(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bonds ξ + η as they are now, [S, 2, pairs], and e = ξ·η + ½ η·η, [S, pairs]."""
        eta = self.differences(u)
        return self.xi + eta, ((self.xi + eta / 2) * eta).sum(axis=1)

    def at_ends(self, pull: np.ndarray) -> np.ndarray:
        """What pulls of the bonds [S, 2, pairs] come to at the nodes, [S, N, 2]."""
        flat = self.ends @ pull.reshape(-1, pull.shape[2]).T
        return np.asarray(flat.reshape(-1, len(pull), 2).swapaxes(0, 1))

    def patch(self, kind: str = "strain", *of: int) -> Patch:
        """Where strains, bonds, deviations or corners are, which are built once.

        Those that the interior does not move are left out, but strains: far out in the collar a
        field may be folded, and its energy no number.
        """
        if (kind, *of) not in self._patches:
            self._patches[kind, *of] = self._patch(kind, *of)
        return self._patches[kind, *of]

    def _patch(self, kind: str, *of: int) -> Patch:
        far, C = np.zeros(2, int), len(self.steps) // 2

        def strain(w: np.ndarray, at: Any = (0, 0)) -> tuple[np.ndarray, ...]:
            """First nodes and classes of the bonds of a node's strain, and their weights."""
            low = np.concatenate([0 * self.steps[: len(w)], self.steps[C : C + len(w)]])
            return low + at, np.tile(np.arange(len(w)), 2), np.tile(w, (2, 1))

        def bond(step: Any, w: Any, at: Any = (0, 0)) -> tuple[np.ndarray, ...]:
            k = np.flatnonzero((self.steps[:C] == step).all(axis=1))
            return np.array([at]), k, np.array([w], float)

        if kind == "strain":
            parts = [strain(strain_weights(self.reach, 4))]
        elif kind == "bond":
            far = self.steps[of[0]]
            parts = [bond(far, (1 / (far @ far),))]
        elif kind == "corner":
            p, q = of
            third = bond((1, -p * q), (0, 0, -p * q), (0, q) if p > 0 else (p, 0))
            first = bond((1, 0), (1, 0, p * q), (min(p, 0), 0))
            parts = [first, bond((0, 1), (0, 1, p * q), (0, min(q, 0))), third]
        else:
            far = np.array(of)
            x, y = far / np.sqrt(far @ far)
            w = strain_weights(SHORT_REACH, 2)
            along = np.stack([0 * w[:, 0], w @ [x * x, y * y, x * y]], axis=1)
            parts = [strain(along), strain(along, far), bond(far, (2 / (far @ far), 0))]
        low, k, weights = map(np.concatenate, zip(*parts))
        joined = np.concatenate([low, low + self.steps[k], [0 * far, far]])
        offsets, place = np.unique(joined, axis=0, return_inverse=True)
        nodes = neighbour_table(self.grid, offsets).T
        kept = (nodes >= 0).all(axis=0)
        if kind != "strain":
            kept &= self.points.interior[nodes].any(axis=0)
        nodes, (*ends, own, other) = nodes[:, kept], place.ravel()
        both = np.reshape(ends, (2, len(low)))
        numbers, pair = self.number[nodes[both[0]], k[:, None]], nodes[[own, other]]
        weights = weights / self.spacing**2
        return Patch(nodes, offsets, both, numbers, weights, pair, kind == "corner")

    @cached_property
    def tangent(self) -> TangentPattern:
        """Where the entries of tangents stand."""
        return TangentPattern(self)

    @cached_property
    def laplacian(self) -> sp.csr_array:
        """Of five points, on the interior, shape [I, N]."""
        i, j = self.pairs
        near = self.ends[:, np.abs(self.grid[j] - self.grid[i]).sum(axis=1) == 1]
        return sp.csr_array(near @ near.T)[self.interior] / self.spacing**2

    @cached_property
    def laplace(self) -> Any:
        """The inverse of the Laplacian between interior nodes."""
        return splu(self.laplacian[:, self.interior].tocsc()).solve

    @cached_property
    def softest(self) -> float:
        """The smallest eigenvalue of that Laplacian [1 / length²]."""
        return softest(len(self.interior), self.laplace, 1e-4)

    def lift(self, u: np.ndarray) -> np.ndarray:
        """u [N, 2] with its interior replaced by the harmonic extension of the collar."""
        lifted = np.where(self.points.interior[:, None], 0.0, u)
        lifted[self.interior] = self.laplace(-(self.laplacian @ lifted))
        return lifted


def softest(size: int, inverse: Inner, tolerance: float) -> float:
    """The smallest eigenvalue of what is positive, by its inverse."""
    if size <= 2:
        return 1 / float(np.linalg.eigvalsh(inverse(np.eye(size)))[-1])
    ends = {"v0": lanczos_start(size), "return_eigenvectors": False, "tol": tolerance}
    K = LinearOperator((size, size), inverse, dtype=float)
    return 1 / float(eigsh(K, 1, which="LA", **ends)[0])


@dataclass(frozen=True, eq=False)
class BandFactors:
    """Cholesky's factors of a tangent, by diagonals, its unknowns in another order."""

    band: np.ndarray
    order: np.ndarray

    def solve(self, y: np.ndarray) -> np.ndarray:
        """K⁻¹ y."""
        x = np.empty(y.shape)
        x[self.order] = cho_solve_banded((self.band, True), y[self.order], check_finite=False)
        return x

    def inverse(self, r: np.ndarray) -> np.ndarray:
        """The same of a residual [I, 2]."""
        return self.solve(r.ravel()).reshape(r.shape)


class TangentPattern:
    """Where the entries of the tangent between interior nodes stand: built once for a lattice.

    Attributes:
        half: places of the nodes in a row, 0 and one of each ±, by lattice steps.
        row: of every node, the number of interior nodes I for those of the collar, shape [N].
        taken: places in blocks [half, 2, 2, I] of the entries of half of the matrix.
        places: their rows and columns.
        doubled: which of them stand on blocks of the diagonal, where both halves do.
        order: of the unknowns in a band that is narrow, by lines of nodes along the shorter side.
        width: number of its diagonals.
    """

    def __init__(self, lattice: SheetLattice) -> None:
        self.lattice, interior, inside = lattice, lattice.interior, len(lattice.interior)
        family = np.concatenate([0 * lattice.steps[:1], lattice.steps])
        steps = np.unique((family[:, None] + family).reshape(-1, 2), axis=0)
        steps = steps[len(steps) // 2 :]  # they are in order, ξ before 0 before −ξ
        self.half = {tuple(step): n for n, step in enumerate(steps.tolist())}
        number = np.full(len(lattice.grid) + 1, inside)  # the last is of no node
        number[interior] = np.arange(inside)
        self.row = number[:-1]
        far = number[neighbour_table(lattice.grid, steps)[interior]].T
        which, row = np.nonzero(far < inside)
        a, b = np.indices((2, 2)).reshape(2, 4, 1)
        self.taken = inside * (4 * which + 2 * a + b) + row
        self.places = 2 * row + a, 2 * far[which, row] + b
        self.doubled = which == 0
        inner = lattice.grid[interior]
        shorter = int(np.argmin(np.ptp(inner, axis=0)))
        nodes = np.lexsort((inner[:, shorter], inner[:, 1 - shorter]))
        self.order = (2 * nodes[:, None] + [0, 1]).ravel()
        ends = np.sort(np.argsort(self.order)[np.stack(self.places)], axis=0)
        self._at = ends[1] - ends[0], ends[0]
        self.width = int(self._at[0].max()) + 1

    def matrix(self, *curved: Any) -> sp.csc_matrix:
        """K between interior nodes, (H10), shape [2 I, 2 I], of an operator's `curvatures`."""
        entries = np.where(self.doubled, 0.5, 1.0) * self._blocks(*curved).ravel()[self.taken]
        half = sp.coo_matrix((entries.ravel(), [each.ravel() for each in self.places]))
        return (half + half.T).tocsc()

    def factors(self, *curved: Any, shifts: bool = False) -> tuple[BandFactors | None, bool]:
        """Factors of that matrix where it is positive definite, and whether it is.

        With shifts of it and a multiple of one that is enough, where it is not.
        """
        band = np.zeros((self.width, len(self.order)), order="F")
        band[self._at] = self._blocks(*curved).ravel()[self.taken]
        diagonal = band[0].copy()
        for shift in (0.0, *SHIFTS) if shifts else (0.0,):
            band[0] = diagonal + shift * np.abs(diagonal).max()
            try:
                return BandFactors(cholesky_banded(band, lower=True), self.order), shift == 0
            except (np.linalg.LinAlgError, ValueError):  # not definite, or no numbers
                continue
        return None, False

    def _blocks(self, tension: np.ndarray, Y: np.ndarray, curved: list[Any]) -> np.ndarray:
        """Blocks of the rows at the steps of a half, shape [half, 2, 2, I]."""
        lattice, inside = self.lattice, self.lattice.interior
        K, axis = np.zeros((len(self.half), 2, 2, len(inside))), np.arange(2)
        K[0, axis, axis] = abs(lattice.ends[inside]) @ tension
        for k, step in enumerate(lattice.steps[: len(lattice.steps) // 2].tolist()):
            K[self.half[tuple(step)], axis, axis] = -tension[lattice.number[inside, k]]
        for patch, H in curved:
            count = H.shape[-1]
            B = np.zeros((len(patch.offsets), len(H), 2, count + 1))  # ∂q/∂u; the last of no site
            for low, high, w, bond in zip(*patch.ends, patch.weights, patch.bonds):
                change = w[:, None, None] * Y[:, bond]
                B[low, ..., :-1] -= change
                B[high, ..., :-1] += change
            all_bent = np.einsum("pqn,vqin->vpin", np.pad(H, ((0, 0), (0, 0), (0, 1))), B)
            for bent, offset, nodes in zip(all_bent, patch.offsets, patch.nodes):
                at = np.full(len(inside) + 1, count)
                at[self.row[nodes]] = np.arange(count)
                steps = [tuple(step) for step in (patch.offsets - offset).tolist()]
                others = [v for v, step in enumerate(steps) if step in self.half]
                blocks = np.einsum("pin,vpjn->vijn", bent, B[others])
                places = [self.half[steps[v]] for v in others]
                K[places] += np.take(blocks, at[:-1], axis=-1, mode="clip")
        return K
