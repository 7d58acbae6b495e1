"""The operator of a lattice body with broken bonds: matrix, forces and energies (theory, C1–C4).

The dilatation is plain: a sum over unbroken bonds with the weighted volume of the whole ball. So
the energy is a sum of squares of stretches that any breaking leaves positive where K is positive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import warp as wp

from warp_peri.damage.lattice_body import LatticeBody
from warp_peri.errors import InputError
from warp_peri.kernels.damage import sweeps as kernels
from warp_peri.launch import Recorded, floats, ints, launch_slices, threads, zeros
from warp_peri.lps.model import Model, stiffnesses
from warp_peri.points.families import BondClasses

PAIR = 2
"""Nodes that the recorded sweeps take at a time. Two threads pay from 4000 nodes on, see
docs/archive/cracks.md."""


class SplitBonds(NamedTuple):
    """Energy of a node, ½ Σ c e² + ½ x (Σ a e)² over its unbroken bonds (theory, C1, C28).

    Attributes:
        stiffness: c of the bonds of a ball [stress / length⁴], shape [B].
        share: a, of a bond in the dilatation [1 / length²], shape [B].
        excess: x [stress].
    """

    stiffness: np.ndarray
    share: np.ndarray
    excess: float


def bonds_of(linear: Any, classes: BondClasses) -> SplitBonds:
    """Of a Model, or of a solid with bonds of its own, `bonds(classes)`.

    Raises InputError as bond_weights, or as that method does.
    """
    own = getattr(linear, "bonds", None)
    if callable(own):
        return own(classes)  # type: ignore[no-any-return]
    d, w, r = linear.dimension, bond_weights(linear, classes), classes.r[classes.bond_class]
    return SplitBonds(d * (d + 2) * linear.mu * w / r**2, d * w, linear.lam - linear.mu)


def bond_weights(model: Model, classes: BondClasses) -> np.ndarray:
    """w = K W / m of the bonds of a ball [length⁻²], Σ w r² = 1, shape [B].

    Raises InputError for a model with an influence function of its own for the dilatation.
    """
    if not np.array_equal(model.D, model.dilatation):
        raise InputError(
            "model: expected one influence function, got another one for the dilatation; with "
            "broken bonds nothing is known of two"
        )
    v, _, _ = stiffnesses(model, classes)
    weights: np.ndarray = v[classes.bond_class] / model.mu
    return weights


def unit_toughness(model: Model, classes: BondClasses) -> float:
    """Energy of a straight cut between node rows whose bonds all have stretch 1, (C6), over its
    length; in space (V5), over its area.

    G_c = this × s₀². The dilatation's part is that of nodes whose cut bonds alone are stretched.
    """
    w = bond_weights(model, classes)
    r2 = (classes.xi.astype(float) ** 2).sum(axis=1)
    rows = classes.steps[:, 1]
    h = classes.spacing
    up = rows > 0
    d = model.dimension
    deviatoric = d * (d + 2) * model.mu * h * np.sum((rows * w * r2)[up])
    crossing = [d * np.sum((w * r2)[rows > k]) for k in range(int(rows.max()))]
    dilatational = h * (model.lam - model.mu) * np.sum(np.square(crossing))
    return float(deviatoric + dilatational)


def unit_bond_energy(classes: BondClasses) -> float:
    """G_c over the critical energy of a bond and weight: bonds across a line, by W (C8)."""
    rows, weight = classes.steps[:, 1], classes.weight[classes.bond_class]
    return float(classes.spacing * np.sum((rows * weight)[rows > 0]))


def stiffness_across(model: Model, classes: BondClasses) -> tuple[float, float]:
    """Energy per length or area at unit stretch of positive and negative bonds across a line."""
    w = bond_weights(model, classes)
    r2 = (classes.xi.astype(float) ** 2).sum(axis=1)
    d = model.dimension
    share = d * (d + 2) * model.mu * classes.spacing
    each = share * np.maximum(classes.steps[:, 1], 0) * w * r2
    return float(each[each > 0].sum()), float(each[each < 0].sum())


def stretch_matrix(body: LatticeBody, neighbour: np.ndarray) -> tuple[sp.csr_array, np.ndarray]:
    """e = ξ·(u_j − u_i) of the unbroken bonds as a matrix [length], [E, d N], and their places.

    Component a of node i is column d i + a; the places are numbers in the flat [N B] table.
    """
    place = np.flatnonzero(neighbour.ravel() >= 0)
    node, bond = np.divmod(place, neighbour.shape[1])
    return stretch_rows(body, node, bond, neighbour.ravel()[place]), place


def stretch_rows(
    body: LatticeBody, node: np.ndarray, bond: np.ndarray, far: np.ndarray
) -> sp.csr_array:
    """e of these bonds, by the node that they begin at, their number in the ball and their end."""
    xi, count, d = body.xi[bond], len(bond), body.dimension
    columns = (d * np.column_stack([far, node])[:, :, None] + np.arange(d)).ravel()
    values = np.column_stack([xi, -xi]).ravel()
    rows = np.arange(0, 2 * d * count + 1, 2 * d)
    return sp.csr_array((values, columns, rows), shape=(count, d * len(body.x)))


def cut_matrix(
    body: LatticeBody,
    weights: np.ndarray,
    neighbour: np.ndarray,
    mu: float | np.ndarray,
    excess: float | np.ndarray,
) -> sp.csr_array:
    """L of a cut body as a symmetric matrix [stress / length²], shape [d N, d N] (C4).

    Args:
        body: the body.
        weights: w of the ball, shape [B].
        neighbour: with broken bonds, shape [N, B].
        mu: shear modulus, one or by bond [N, B], the same in both directions.
        excess: λ − μ, one or by node [N].
    """
    d = body.dimension
    return bond_matrix(body, neighbour, d * (d + 2) * mu * weights / body.r**2, d * weights, excess)


def bond_matrix(
    body: LatticeBody,
    neighbour: np.ndarray,
    stiffness: np.ndarray,
    share: np.ndarray,
    excess: float | np.ndarray,
) -> sp.csr_array:
    """L of a cut body as cut_matrix, of SplitBonds; the stiffness may be by bond [N, B]."""
    stretch, place = stretch_matrix(body, neighbour)
    along = np.broadcast_to(stiffness, neighbour.shape).ravel()[place]
    theta = _gathered(body, share, neighbour, stretch, place)
    total = stretch.T @ (sp.diags_array(along) @ stretch)
    total = total + theta.T @ (sp.diags_array(np.broadcast_to(excess, len(neighbour))) @ theta)
    return sp.csr_array(total)


def dilatation_matrix(
    body: LatticeBody, weights: np.ndarray, neighbour: np.ndarray
) -> sp.csr_array:
    """The plain dilatation θ of (C1) as a matrix [1/length], shape [N, d N]."""
    return _gathered(body, body.dimension * weights, neighbour, *stretch_matrix(body, neighbour))


def _gathered(
    body: LatticeBody,
    share: np.ndarray,
    neighbour: np.ndarray,
    stretch: sp.csr_array,
    place: np.ndarray,
) -> sp.csr_array:
    node, bond = np.divmod(place, neighbour.shape[1])
    shape = (len(neighbour), len(place))
    gather = sp.csr_array((share[bond], (node, np.arange(len(place)))), shape=shape)
    return sp.csr_array(gather @ stretch)


class CutOperator:
    """Forces and energies of a lattice body over its unbroken bonds, by Warp.

    Args:
        model: one influence function for both parts, or a solid with bonds of its own.
        body: the nodes and their bonds.
        limits: by bond of the ball, of the criterion, shape [B]; none breaks by default.
        by_energy: the criterion is the bond's energy density instead of e = s r².
        tension_only: bonds in compression do not break.
        no_fail: nodes whose bonds do not break, shape [N] bool.
    """

    def __init__(
        self,
        model: Any,
        body: LatticeBody,
        *,
        limits: np.ndarray | None = None,
        by_energy: bool = False,
        tension_only: bool = True,
        no_fail: np.ndarray | None = None,
    ) -> None:
        self.model, self.body = model, body
        self.bonded = stiffness, share, self.excess = bonds_of(model, body.classes)
        self.bonds = len(share)
        self.nodes = len(body.x)
        self.places = self.nodes + self.nodes % 2  # the sweep takes two nodes at a time
        self.bond_based = self.excess == 0 and not by_energy
        self._criterion = kernels.ENERGY if by_energy else kernels.STRETCH
        self.limits = np.full(self.bonds, np.inf) if limits is None else limits
        d = body.dimension
        self._kernels = kernels.sweeps(d, bool(tension_only))
        table = np.column_stack([body.xi, share, 2 * stiffness, self.limits])
        self._table = floats(np.ascontiguousarray(table), self._kernels.bond)
        self.vector = self._kernels.vec
        self._recorded: dict[tuple[int, ...], tuple[list[Recorded], list[Recorded]]] = {}
        self.early = (0, 0), (0, 0)
        flags: np.ndarray = np.zeros(self.places, np.uint8)
        flags[: self.nodes] = False if no_fail is None else no_fail
        self._no_fail: wp.array[Any] = wp.array(flags, dtype=wp.uint8, device="cpu")
        self._all = ints(np.arange(self.nodes))
        self.theta = zeros(self.places)
        self.lost = zeros(self.places, dtype=wp.int32)
        self._lost = self.lost.numpy()  # shares its memory

    def links(self, neighbour: np.ndarray) -> wp.array[Any]:
        """A table of neighbours [N, B] as the sweeps take it, a copy of its own."""
        held = np.full((self.places, self.bonds), -1, dtype=np.int32)
        held[: self.nodes] = neighbour
        return wp.array(held.ravel(), dtype=wp.int32, device="cpu")

    def sweep(
        self,
        u: wp.array[Any],
        links: wp.array[Any],
        force: wp.array[Any],
        energy: wp.array[Any],
        *,
        breaking: bool = False,
        arrive: Callable[[], None] | None = None,
    ) -> np.ndarray:
        """Fill force and energy densities at u; the nodes that lose bonds by it, by number.

        Force and energy are of all bonds that were there before. `arrive` fills what is still
        missing of u; what feels none of it is swept before.
        """
        arrive = arrive or (lambda: None)
        if breaking and self._criterion == kernels.STRETCH:
            arrays = (u, links, force, energy)
            key = (threads(), *(array.ptr for array in arrays))
            if key not in self._recorded:
                self._recorded = {key: self._record(*arrays)}
            early, late = self._recorded[key]
            for launch in early:
                launch()
            arrive()
            for launch in late:
                launch()
        else:
            arrive()
            criterion = self._criterion if breaking else -1
            self._state_based(u, links, self._all, self._all, criterion, force, energy)
        return np.flatnonzero(self._lost) if breaking else np.empty(0, np.int64)

    def _record(
        self, u: wp.array[Any], links: wp.array[Any], force: wp.array[Any], energy: wp.array[Any]
    ) -> tuple[list[Recorded], list[Recorded]]:
        """The sweeps over these arrays with the stretch criterion, packed: early ones and late."""
        outputs = (force, energy, self.lost, links)
        shapes = (u, self.bonds, self._table)
        excess, (near, far) = self.excess, self.early
        made: list[tuple[Any, ...]] = [
            (near, self._kernels.paired_dilatation, (*shapes, links), (self.theta,)),
            (far, self._kernels.paired_state_based,
             (*shapes, excess, self._no_fail, self.theta), outputs),
        ]  # fmt: skip
        if self.bond_based:
            made = [(near, self._kernels.bond_based, (*shapes, self._no_fail), outputs)]
        early: list[Recorded] = []
        late: list[Recorded] = []
        for (first, last), kernel, inputs, given in made:
            parts = (first, last, early), (0, first, late), (last, self.places // 2, late)
            for begin, end, where in parts:
                if begin < end:
                    swept = {"weight": PAIR, "begin": begin}
                    where.append(Recorded(kernel, end - begin, inputs, given, **swept))
        return early, late

    def sweep_early(self, own: np.ndarray) -> None:
        """Sweep first, of the nodes that feel `own` ones alone [N] bool, the longest run."""
        table = self.body.neighbour

        def feel(mask: np.ndarray) -> np.ndarray:
            return np.asarray(mask & (mask[table] | (table < 0)).all(axis=1))

        near = feel(own)
        first, last = _longest_run(near)
        place = np.arange(len(own)) // PAIR
        swept = near & (first <= place) & (place < last)  # whose dilatation is known early
        self.early = (first, last), _longest_run(feel(swept))

    def again(
        self,
        u: wp.array[Any],
        links: wp.array[Any],
        nodes: np.ndarray,
        force: wp.array[Any],
        energy: wp.array[Any],
    ) -> None:
        """Force and energy where these nodes have lost bonds, and at their neighbours."""
        changed = around = ints(nodes)
        if not self.bond_based:  # θ has changed, and neighbours feel it
            ends = links.numpy().reshape(-1, self.bonds)[nodes]
            around = ints(np.union1d(nodes, ends[ends >= 0]))
        self._state_based(u, links, changed, around, -1, force, energy)

    def _state_based(
        self,
        u: wp.array[Any],
        links: wp.array[Any],
        changed: wp.array[Any],
        around: wp.array[Any],
        criterion: int,
        force: wp.array[Any],
        energy: wp.array[Any],
    ) -> None:
        excess = self.excess
        if excess != 0:
            launch_slices(
                self._kernels.dilatation,
                len(changed),
                (changed, u, self.bonds, self._table, links),
                (self.theta,),
            )
        launch_slices(
            self._kernels.state_based,
            len(around),
            (around, u, self._table, excess, criterion, self._no_fail, self.theta),
            (force, energy, self.lost, links),
        )


def _longest_run(mask: np.ndarray) -> tuple[int, int]:
    """First and last + 1 of the longest run of pairs of nodes that are all in a mask."""
    pairs = np.pad(mask, (0, len(mask) % 2), constant_values=True).reshape(-1, PAIR).all(axis=1)
    ends = np.flatnonzero(np.diff(np.pad(pairs, 1).astype(np.int8)))
    begin, end = ends[::2], ends[1::2]
    longest = int((end - begin).argmax()) if len(begin) else 0
    return (int(begin[longest]), int(end[longest])) if len(begin) else (0, 0)
