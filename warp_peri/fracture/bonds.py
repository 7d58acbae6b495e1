"""Operators of a lattice body with broken bonds: matrix, forces and energies (theory, C1–C4).

The weighted volume in the dilatation is that of the whole ball, so that the energy is a sum of
squares of stretches, positive whatever breaks where K is positive.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import warp as wp
from numpy import ndarray
from numpy.linalg import eigvalsh, inv
from numpy.typing import ArrayLike

from warp_peri.core.elastic import lattice_group
from warp_peri.core.proof import largest
from warp_peri.errors import InputError, Several
from warp_peri.fracture.body import LatticeBody
from warp_peri.kernels import damage as kernels
from warp_peri.kernels.bonds import stay
from warp_peri.materials.lps import LPSMaterial, stencil_of, stiffnesses
from warp_peri.points.arguments import Pair
from warp_peri.points.families import BondClasses
from warp_peri.points.points import straight_steps
from warp_peri.runtime import Shared, filled, floats, get_num_threads, ints, zeros

WEIGHT = 4
"""Work of a piece, that of a node in other sweeps being 1: two threads pay from 16 000 nodes on."""
ROUNDING = 1e-12
"""Relative, of weights: below it a bond is without force, whatever its sign."""
SPANNED = 1e-3
"""Least eigenvalue of a node's shape tensor, over that of a whole ball, whose bonds span space."""


class SplitBonds(NamedTuple):
    """Coefficients of a node's energy ½ Σ c e² + ½ x (Σ a e)² over its bonds (theory, C1).

    `stiffness` c [stress / length⁴] of the bonds of a ball [B], or of all [N, B]; `share` a of a
    bond in the dilatation [1 / length²], [B]; `excess` x [stress], one or of each node [N].
    """

    stiffness: ndarray
    share: ndarray
    excess: Any


def bonds_of(model: LPSMaterial, classes: BondClasses, moduli: Any = None) -> SplitBonds:
    """Energy coefficients of a ball's bonds, or with moduli (μ [N, B], λ − μ [N]) of a body's."""
    d, w = model.dimension, bond_weights(model, classes)
    mu, excess = (model.mu, model.lam - model.mu) if moduli is None else moduli
    return SplitBonds(d * (d + 2) * mu * w / classes.r[classes.bond_class] ** 2, d * w, excess)


def bond_weights(model: LPSMaterial, classes: BondClasses) -> ndarray:
    """Dilatation weights w = K W / m of a ball's bonds [length⁻²], Σ w r² = 1, shape [B]."""
    v, _ = stiffnesses(model, classes)
    return np.asarray(v[classes.bond_class] / model.mu)


def unit_toughness(model: LPSMaterial, classes: BondClasses) -> float:
    """Energy per length (in space area) of a straight cut whose bonds have stretch 1 (C6, V5). G_c
    = this × s₀². The dilatation's part is that of nodes whose cut bonds alone are stretched."""
    w, rows = bond_weights(model, classes), classes.steps[:, 1]
    r2 = (classes.xi.astype(float) ** 2).sum(axis=1)
    d, h = model.dimension, classes.spacing
    deviatoric = d * (d + 2) * model.mu * h * np.sum((rows * w * r2)[rows > 0])
    crossing = [d * np.sum((w * r2)[rows > k]) for k in range(int(rows.max()))]
    return float(deviatoric + h * (model.lam - model.mu) * np.sum(np.square(crossing)))


def check_breakable(model: LPSMaterial, classes: BondClasses | None = None) -> None:
    """Raise InputError for an influence function that changes sign, here or on a lattice (C3)."""
    if classes is None:
        w, where = model.influence(model.horizon * np.linspace(0.1, 1.0, 91)), ""
    else:
        w, where = bond_weights(model, classes), f" on the lattice of spacing {classes.spacing:g}"
    if (w < -ROUNDING * np.abs(w).max()).any():
        raise InputError(
            f"model: its influence function changes sign{where}, from {w.min():.4g} to "
            f"{w.max():.4g}, and breaking some bonds leaves energies below zero; bonds may break "
            "in a positive kernel (with_positive_kernel keeps its moduli)"
        )


def largest_stiffness(model: LPSMaterial, classes: BondClasses) -> float:
    """Proven upper bound of Λmax L [stress / length²] of every body, whatever breaks (C9). max(μ, κ
    d / (d + 2)) max_k Λmax Γ(k), κ = λ + 2 μ/d. Raises InputError as check_breakable."""
    check_breakable(model, classes)
    v = np.bincount(classes.bond_class, bond_weights(model, classes)) / classes.count
    d = model.dimension
    stiffer = max(model.mu, d / (d + 2) * (model.lam + 2 * model.mu / d))  # shear or bulk
    return stiffer * largest(stencil_of(classes, v, 0.0), lattice_group(d))


def stretch_matrix(body: LatticeBody, neighbour: ndarray) -> tuple[sp.csr_array, ndarray]:
    """Matrix [length] from u to e = ξ·(u_j − u_i) of unbroken bonds, [E, d N]; places in [N B]."""
    node, bond = np.nonzero(neighbour >= 0)
    return stretch_rows(body, node, bond, neighbour[node, bond]), node * neighbour.shape[1] + bond


def stretch_rows(body: LatticeBody, node: ndarray, bond: ndarray, far: ndarray) -> sp.csr_array:
    """Rows of stretch_matrix of bonds, by their first node, number in the ball and end."""
    xi, count, d = body.xi[bond], len(bond), body.dimension
    columns = (d * np.column_stack([far, node])[:, :, None] + np.arange(d)).ravel()
    values = np.column_stack([xi, -xi]).ravel()
    rows = np.arange(0, 2 * d * count + 1, 2 * d)
    return sp.csr_array((values, columns, rows), shape=(count, d * len(body.x)))


def bond_matrix(
    body: LatticeBody, neighbour: ndarray, bonds: SplitBonds, *, corrected: bool = False
) -> sp.csr_array:
    """Matrix L [stress / length²] of a body with broken bonds, symmetric, [d N, d N] (C4)."""
    stretch, place = stretch_matrix(body, neighbour)
    each = np.broadcast_to(bonds.stiffness, neighbour.shape)
    total = stretch.T @ (sp.diags_array(each.ravel()[place]) @ stretch)
    if np.any(bonds.excess):  # else it is as wide as two balls, and zero
        of_nodes = np.broadcast_to(bonds.excess, len(neighbour))
        theta = dilatations(body, bonds.share, neighbour, np.arange(len(neighbour)))
        total = total + theta.T @ (sp.diags_array(of_nodes) @ theta)
    if corrected:
        total = total + SurfaceCorrection(body, neighbour >= 0, bonds, SPANNED).matrix()
    total = sp.csr_array(total)
    total.eliminate_zeros()
    return total


class SurfaceCorrection:
    """Correction (C26) of a body near nodes that lack bonds.

    Args:
        body: nodes and bonds.
        there: unbroken bonds, shape [N, B] bool.
        bonds: their coefficients.
        least: eigenvalue of a node's shape tensor, over that of a whole ball, from which on its
            bonds span space; other nodes are left as they are.
    """

    def __init__(self, body: LatticeBody, there: ndarray, bonds: SplitBonds, least: float) -> None:
        node, count = np.flatnonzero(~there.all(axis=1)), len(there)
        each = np.broadcast_to(bonds.stiffness, there.shape)[node]
        spans, *made = mean_gradients(body.xi, there[node], each, bonds.share, least)
        self.node, slopes, self._squares, self._lacked = (one[spans] for one in (node, *made))
        flat = slopes.reshape(-1, slopes.shape[2])
        row, bond = np.nonzero(flat)
        value, own = flat[row, bond], self.node[row // body.dimension]
        columns = np.concatenate([body.neighbour[own, bond], own])
        entries = np.concatenate([value, -value]), (np.tile(row, 2), columns)
        self._slopes = sp.csr_array(sp.coo_array(entries, shape=(len(flat), count)))
        self._excess = np.broadcast_to(bonds.excess, count)[self.node]
        self._theta = sp.csr_array((len(self.node), body.x.size))
        if self._excess.any():
            table = np.where(there, body.neighbour, -1)
            self._theta = dilatations(body, bonds.share, table, self.node)

    def matrix(self) -> sp.csr_array:
        """Matrix that L has more, [d N, d N]."""
        width, size = self._lacked.shape
        gradient = sp.csr_array(sp.kron(self._slopes, sp.eye_array(int(size**0.5))))  # by j and i
        blocks = sp.bsr_array((self._squares, np.arange(width), np.arange(width + 1)))
        rows = np.repeat(np.arange(width), size), np.arange(size * width)
        more = sp.csr_array((self._lacked.ravel(), rows), shape=(width, size * width)) @ gradient
        of_nodes = sp.diags_array(self._excess)
        crossed = more.T @ (of_nodes @ self._theta)
        total = gradient.T @ (sp.csr_array(blocks) @ gradient)
        return sp.csr_array(total + crossed + crossed.T + more.T @ (of_nodes @ more))

    def __call__(self, u: ndarray) -> Pair:
        """Force density of all nodes, and energy density of `node`, at a displacement."""
        gradient = (self._slopes @ u).reshape(self._lacked.shape)
        theta, more = self._theta @ u.ravel(), (self._lacked * gradient).sum(axis=1)
        stress = (self._squares @ gradient[..., None])[..., 0]
        energy = (gradient * stress).sum(axis=1) / 2 + self._excess * more * (theta + more / 2)
        stress += (self._excess * (theta + more))[:, None] * self._lacked
        pull = self._slopes.T @ stress.reshape(-1, u.shape[1])
        pull += (self._theta.T @ (self._excess * more)).reshape(u.shape)
        return -pull, energy


def mean_gradients(
    xi: ndarray, there: ndarray, stiffness: ndarray, share: ndarray, least: float
) -> Several:
    """Mean gradients (C26) of nodes with the bonds `there` [n, B] of a ball, xi [B, d].

    Returns where the bonds span space, with eigenvalues of the shape tensor above `least` of a
    whole ball's, [n]; and, zero elsewhere, ∂u_i/∂x_j by each bond's u_j − u_i, weighted by |a| [n,
    d, B], and what missing bonds make of it, by j and i: stress [n, d², d²], dilatation [n, d²].
    Node by node: the bits are the same however many.
    """
    along = np.einsum("bj,bi->bji", xi, xi).reshape(len(xi), -1)  # e = along · gradient
    weight = np.abs(share)
    pull = ((there * weight)[:, :, None] * xi).mT
    shape, whole = pull @ xi, (weight * xi.T) @ xi
    spans = eigvalsh(shape)[:, 0] > least * eigvalsh(whole)[0]
    shape[~spans] = np.eye(len(whole))
    lack = ~there & spans[:, None]
    slopes = spans[:, None, None] * (inv(shape) @ pull)
    squares = ((lack * stiffness)[:, None] * along.T) @ along
    return spans, slopes, squares, ((lack * share)[:, None] @ along)[:, 0]


def dilatations(
    body: LatticeBody, share: ndarray, neighbour: ndarray, nodes: ndarray
) -> sp.csr_array:
    """Matrix of the plain dilatation θ of (C1) of some nodes [1/length], shape [n, d N]."""
    at, bond = np.nonzero(neighbour[nodes] >= 0)
    gather = sp.csr_array((share[bond], (at, np.arange(len(at)))), shape=(len(nodes), len(at)))
    return sp.csr_array(gather @ stretch_rows(body, nodes[at], bond, neighbour[nodes[at], bond]))


class CutOperator:
    """Forces and energies of a lattice body over its unbroken bonds, by rows in Warp.

    `limits` are the e = s r² at which bonds of the ball break, [B]; none breaks by default. Those
    of the nodes `no_fail`, [N] bool, do not.
    """

    def __init__(
        self,
        model: LPSMaterial,
        body: LatticeBody,
        *,
        limits: ArrayLike = np.inf,
        no_fail: ArrayLike = False,
    ) -> None:
        self.model, self.body = model, body
        self.bonded = stiffness, share, self.excess = bonds_of(model, body.classes)
        self.bonds = len(share)
        self.limits = np.broadcast_to(limits, self.bonds)
        d = body.dimension
        self._kernels = kernels.sweep(d)
        self.vector = self._kernels.vec
        table = np.column_stack([body.xi, share, 2 * stiffness, self.limits])
        offset, home = _places(body)
        first, self._row = _rows(home)
        self._lane = (home - first[self._row]).astype(np.uint16)
        self._pieces = np.column_stack([first, np.arange(len(first))]).astype(np.int32)
        size = int(home.max() + np.abs(offset).max()) + 2 * kernels.LANES
        # of zeros, which no memory holds until they are written: a rectangle may be mostly empty
        self._number = np.zeros(size, np.int32)
        self._number[home] = np.arange(1, len(home) + 1)
        flags = np.zeros(size, np.uint8)
        flags[home] = no_fail
        self._planes = floats(np.zeros(d * size))
        self._theta = floats(np.zeros(size if self.excess else 1))
        self._at = ints(offset), floats(np.ascontiguousarray(table), self._kernels.bond)
        self._nodes = ints(self._number), floats(flags, wp.uint8)
        self._lost = zeros(len(first), dtype=wp.uint16)
        self._recorded: dict[tuple[Any, ...], Shared] = {}

    def links(self, neighbour: ndarray) -> wp.array[Any]:
        """Pack the bonds of a table of neighbours [N, B] as sweeps take them."""
        words = np.zeros((len(self._pieces), self.bonds), np.uint16)
        for lane in range(kernels.LANES):
            nodes = np.flatnonzero(self._lane == lane)
            words[self._row[nodes]] |= (neighbour[nodes] >= 0).astype(np.uint16) << lane
        return wp.array(words.ravel(), dtype=wp.uint16, device="cpu")

    def kept(self, links: wp.array[Any]) -> ndarray:
        """Mask of unbroken bonds, [N, B] bool."""
        words = links.numpy().reshape(-1, self.bonds)
        return np.asarray(words[self._row] >> self._lane[:, None] & 1, bool)

    def sweep(
        self,
        u: wp.array[Any],
        links: wp.array[Any],
        force: wp.array[Any],
        energy: wp.array[Any],
        *,
        breaking: bool = False,
    ) -> ndarray:
        """Fill force and energy at u over bonds before breaking; returns nodes that lose some."""
        arrays = u, links, force, energy
        key = get_num_threads(), breaking, *(array.ptr for array in arrays)
        if key not in self._recorded:
            if len(self._recorded) > 1:
                self._recorded.clear()
            self._recorded[key] = self._shared(3 * (self._pieces,), breaking, *arrays)
        self._recorded[key]()
        lost = self._lost.numpy()
        rows, lanes = np.flatnonzero(lost), np.arange(kernels.LANES)
        losing = self._number[self._pieces[rows, :1] + lanes][lost[rows, None] >> lanes & 1 > 0]
        return np.sort(losing) - 1

    def _shared(self, pieces: Sequence[ndarray], breaking: bool, *fields: wp.array[Any]) -> Shared:
        """Arguments to lay out u, fill θ, and fill force and energy, of pieces packed apart."""
        laid, dilated, swept = pieces
        dilated = dilated if self.excess else laid[:0]
        phases = [ints(of, wp.vec2i) for of in (laid, dilated, swept)]
        how = self.excess, int(breaking), self._planes, self._theta, self._lost
        of = filled(self._kernels.Cut, *phases, *self._at, *self._nodes, *how, *fields)
        return Shared(self._kernels.sweep, (of,), WEIGHT * len(swept), stay)

    def again(
        self, links: wp.array[Any], nodes: ndarray, force: wp.array[Any], energy: wp.array[Any]
    ) -> None:
        """Recompute force and energy at and around nodes that lost bonds in the last sweep."""
        changed = around = np.unique(self._row[nodes])
        if self.excess:  # θ has changed, and neighbours feel it
            ends = self.body.neighbour[nodes]
            around = np.union1d(changed, self._row[ends[ends >= 0]])
        pieces = [self._pieces[rows] for rows in (np.arange(0), changed, around)]
        self._shared(pieces, False, force, links, force, energy)()  # no u is laid out


class CutRows:
    """Operator L of a cut body that is not endless on fields [S, N, d]; arguments of CutSolid."""

    def __init__(
        self, model: LPSMaterial, body: LatticeBody, neighbour: ndarray, corrected: bool
    ) -> None:
        self._operator = CutOperator(model, body)
        count, vector = len(body.x), self._operator.vector
        self._fields = [zeros(count, dtype=one) for one in (vector, vector, wp.float64)]
        self._neighbour, self._links = neighbour, self._operator.links(neighbour)
        self._more = sp.csr_array(2 * (body.x.size,))
        if corrected:
            bonds = self._operator.bonded
            self._more = SurfaceCorrection(body, neighbour >= 0, bonds, SPANNED).matrix()

    @property
    def diagonal(self) -> ndarray:
        """Diagonal of L, shape [N, d]."""
        (stiffness, share, excess), xi = self._operator.bonded, self._operator.body.xi
        once, twice = (2 * stiffness)[:, None] * xi**2, share[:, None] * xi
        there = self._neighbour >= 0
        found = there @ (once + excess * twice**2) + excess * (there @ twice) ** 2
        return np.asarray(found + self._more.diagonal().reshape(found.shape))

    def __call__(self, fields: ndarray) -> ndarray:
        """Minus the internal force density, of all nodes."""
        found, (u, force, energy) = np.empty_like(fields), self._fields
        for field, out in zip(fields, found):
            u.numpy()[:] = field
            self._operator.sweep(u, self._links, force, energy)
            out[:] = (self._more @ field.ravel()).reshape(out.shape) - force.numpy()
        return found


def _places(body: LatticeBody) -> Pair:
    """Offsets from a node to its bonds' ends [B], and places of nodes [N], in rows with margins."""
    grid, _ = straight_steps(body.x, body.spacing)
    steps, d = body.classes.steps, body.dimension
    along = int(np.count_nonzero(np.diff(grid, axis=0), axis=0).argmax())  # as nodes are numbered
    axes = [*(a for a in range(d) if a != along), along]
    wide = (grid.max(axis=0) + 1 + np.abs(steps).max())[axes]
    strides = np.array([wide[a + 1 :].prod() for a in range(d)], np.int64)
    offset = steps[:, axes] @ strides
    return offset, grid[:, axes] @ strides + np.abs(offset).max()


def _rows(home: ndarray) -> Pair:
    """First places of as few pieces as hold all nodes, and the piece of every node [N]."""
    places = np.sort(home)
    after = np.searchsorted(places, places + kernels.LANES).tolist()
    begin, at = [], 0
    while at < len(places):
        begin.append(at)
        at = after[at]
    first = places[begin]
    return first, np.searchsorted(first, home, side="right") - 1
