"""Cut bodies at rest: their displacement, energy release and J (theory.md, C11–C12)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

from warp_peri.damage.lattice_body import Body, cracked
from warp_peri.damage.operator import bond_weights, cut_matrix
from warp_peri.damage.stability import check_cut, check_horizon
from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.stability import inertia

RESIDUAL = 1e-9
"""Largest relative residual of a solve."""


class CutSolid:
    """A body with broken bonds at rest, its operator factorised once.

    Args:
        model: with one influence function; one that changes sign is checked by inertia.
        body: nodes and bonds.
        held: components of the displacement that are given, shape [N] or [N, 2] bool.
        neighbour: with broken bonds, shape [N, B]; the body's own by default.
        cracks: polylines that cut it, instead.

    Attributes:
        matrix: L of (C4), symmetric, shape [2N, 2N].
        left: residual of the last solve over its right-hand side.

    Raises InputError for a piece of the body that nothing holds, naming it, for an operator
    with negative eigenvalues, and for a body of another horizon.
    """

    def __init__(
        self,
        model: Model,
        body: Body,
        held: ArrayLike,
        *,
        neighbour: np.ndarray | None = None,
        cracks: Sequence[ArrayLike] = (),
    ) -> None:
        self.model, self.body = model, body
        check_horizon(model, body)
        self.neighbour = cracked(body, cracks) if neighbour is None else neighbour
        held = np.asarray(held, dtype=bool)
        held = np.repeat(held[:, None], 2, axis=1) if held.ndim == 1 else held
        if held.shape != (len(body.x), 2):
            raise InputError(f"held: expected shape [{len(body.x)}] or [{len(body.x)}, 2] of bool")
        check_pieces(body, self.neighbour, held)
        weights = bond_weights(model, body.classes)
        self.matrix = cut_matrix(body, weights, self.neighbour, model.mu, model.lam - model.mu)
        self.free = ~held.ravel()
        inner = self.matrix[self.free][:, self.free]
        if (weights < 0).any():
            check_cut(inner)
        self._inner = sp.csc_array(inner)
        self._factors = symmetric_factors(self._inner)
        self.left = np.inf

    def solve(self, u: np.ndarray, b: np.ndarray | None = None) -> np.ndarray:
        """u at rest, shape [N, 2].

        Args:
            u: holds the given components; the others are not looked at, shape [N, 2].
            b: body force density [stress / length], shape [N, 2]; none by default.

        Raises InputError for other shapes and for what is not finite.
        """
        shape = self.body.x.shape
        load = np.zeros(shape) if b is None else np.asarray(b, dtype=float)
        for name, field in (("u", np.asarray(u, dtype=float)), ("b", load)):
            if field.shape != shape:
                raise InputError(f"{name}: expected shape {list(shape)}, got {list(field.shape)}")
        solved, load = np.array(u, dtype=float).ravel(), load.ravel()
        solved[self.free] = 0
        if not (np.isfinite(solved).all() and np.isfinite(load).all()):
            raise InputError("u, b: expected finite numbers where displacement or load is given")
        right = (load - self.matrix @ solved)[self.free]
        x = self._factors.solve(right)
        size = np.linalg.norm(right)
        left = float(np.linalg.norm(self._inner @ x - right))
        if left > RESIDUAL * size:
            raise InputError("operator: the solve lost its digits; parts of the body hang loose")
        self.left = left / float(size) if size else 0.0
        solved[self.free] = x
        return solved.reshape(-1, 2)

    def energy(self, u: np.ndarray) -> float:
        """Elastic energy per thickness, bonds among held nodes included [stress · area]."""
        flat = np.ravel(u)
        return float(self.body.spacing**2 * (flat @ (self.matrix @ flat)) / 2)


def symmetric_factors(matrix: sp.csc_array) -> Any:
    """Sparse factors of a symmetric matrix, pivots on the diagonal; InputError if singular."""
    try:
        return inertia.symmetric_factors(matrix)
    except RuntimeError as error:
        raise InputError(f"operator: parts of the body hang loose ({error})") from None


def check_pieces(body: Body, neighbour: np.ndarray, held: np.ndarray) -> None:
    """Refuse a body of which a piece may move freely: cracks have cut it off and nothing holds it.

    A piece needs three held components; a translation or the rotation is named when it is free.
    """
    node, bond = np.nonzero(neighbour >= 0)
    count = len(body.x)
    links = sp.csr_array((np.ones(len(node)), (node, neighbour[node, bond])), shape=(count, count))
    pieces, label = connected_components(links, directed=False)
    for piece in range(pieces):
        nodes = np.flatnonzero(label == piece)
        if held[nodes].all(axis=1).sum() > 1:
            continue
        away = body.x[nodes] - body.x[nodes].mean(axis=0)
        size = max(np.abs(away).max(), body.spacing)
        motions = np.zeros((len(nodes), 2, 3))
        motions[:, 0, 0] = motions[:, 1, 1] = 1
        motions[:, 0, 2], motions[:, 1, 2] = -away[:, 1] / size, away[:, 0] / size
        felt = motions[held[nodes]]
        rank = np.linalg.matrix_rank(felt, tol=1e-9) if len(felt) else 0
        if rank < 3:
            raise InputError(
                f"crack: a piece of {len(nodes)} nodes, node {nodes[0]} among them, is held "
                f"against {rank} of its 3 rigid motions only; hold it or leave it whole"
            )


def energy_release(
    model: Model,
    body: Body,
    held: np.ndarray,
    u: np.ndarray,
    cracks: Sequence[Sequence[ArrayLike]],
    *,
    b: np.ndarray | None = None,
) -> float:
    """G by energies of cracks of several lengths, at given displacement and dead loads (C11).

    Along rows of nodes a shorter and a longer crack, one spacing either way, are enough. Bonds are
    cut one by one where a crack is inclined: take nine lengths over ± 2 spacings there, for 2 %.

    Args:
        model, body, held: as for CutSolid.
        u: with the given components, shape [N, 2].
        cracks: for each length its polylines, two or more; what longer ones add is the new area.
        b: dead load, a body force density that stays as the crack grows [stress / length], shape
            [N, 2]; its potential counts. None by default.

    Returns what is released per length added, by least squares [stress · length]; with two tips,
    of each.

    Raises InputError for fewer than two lengths, and as CutSolid and its `solve`.
    """
    energies, lengths = [], []
    for polylines in cracks:
        solid = CutSolid(model, body, held, cracks=polylines)
        rest = solid.solve(u, b)
        work = 0.0 if b is None else body.spacing**2 * float(np.vdot(b, rest))
        energies.append(solid.energy(rest) - work)
        corners = (np.diff(np.asarray(line, dtype=float), axis=0) for line in polylines)
        lengths.append(sum(float(np.hypot(*part.T).sum()) for part in corners))
    if len(set(lengths)) < 2:
        raise InputError(f"cracks: expected two lengths or more, got {lengths}")
    off = np.array(lengths) - np.mean(lengths)
    return float(off @ np.array(energies) / -(off @ off)) + 0.0  # no −0


def contour_integral(
    model: Model, body: Body, u: np.ndarray, tip: tuple[float, float], radii: tuple[float, float]
) -> float:
    """J around the tip of a crack along an axis, for its growth straight on, by a domain (C12).

    From which of the four sides the crack comes is where the displacement jumps most. Gradients are
    differences on a full rectangle of nodes, one-sided across the crack; the weight falls from 1 to
    0 between two squares about the tip.

    Args:
        model: λ and μ.
        body: a rectangle of nodes, the crack midway between two of their rows or columns.
        u: displacement, shape [N, 2].
        tip: where the crack ends.
        radii: half sides of the squares [length], the smaller first; taken to the nearest spacing.

    Raises InputError for a body that is no rectangle, another shape of u, and squares that do not
    differ by a spacing or do not fit into the body.
    """
    h = body.spacing
    if not (np.isfinite(radii).all() and 0 <= round(radii[0] / h) < round(radii[1] / h)):
        raise InputError(
            f"radii: expected 0 ≤ smaller < larger by a spacing of {h:g} or more, got "
            f"{radii[0]:g}, {radii[1]:g}"
        )
    r1, r2 = (round(radius / h) * h for radius in radii)
    if np.shape(u) != body.x.shape:
        raise InputError(f"u: expected shape {list(body.x.shape)}, got {list(np.shape(u))}")
    place = np.rint((body.x - body.x.min(axis=0)) / h).astype(int)
    sides = place.max(axis=0) + 1
    if np.prod(sides) != len(body.x):
        raise InputError("body: expected a full rectangle of nodes for J")
    order = np.argsort(place @ (sides[1], 1))
    field = u[order].reshape(*sides, 2)
    x, y = (body.x[order, a].reshape(sides) - tip[a] for a in (0, 1))
    room = min(-x[0, 0], x[-1, 0], -y[0, 0], y[0, -1])
    if room < r2 - 1e-9 * h:
        raise InputError(f"radii: {r2:g} is more than from the tip to the edge, {room:g}")
    field, x, y = _from_the_left(field, x, y, r2)
    gradient = crack_gradient(field, h, x[:, 0] < 0, int(np.count_nonzero(y[0] < 0)))
    strain = (gradient + gradient.swapaxes(-1, -2)) / 2
    stress = 2 * model.mu * strain
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    stress = stress + model.lam * trace * np.eye(2)
    density = (stress * strain).sum(axis=(-1, -2)) / 2
    sideways = np.abs(x) >= np.abs(y)
    slope = [
        np.where(side, np.sign(axis) * _fall(np.abs(axis), h, r1, r2), 0.0)
        for side, axis in ((sideways, x), (~sideways, y))
    ]
    pull = np.einsum("...ij,...i->...j", stress, gradient[..., 0])
    integrand = (density - pull[..., 0]) * slope[0] - pull[..., 1] * slope[1]
    return float(-integrand.sum() * h * h)


def _from_the_left(
    field: np.ndarray, x: np.ndarray, y: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement and places about a tip, mirrored so that the crack comes from the left.

    The jump across a half-line is what neighbours on both sides do not explain.
    """
    turned = field.swapaxes(0, 1)[..., ::-1], y.T, x.T
    jumps, views = [], []
    for values, ahead, up in ((field, x, y), turned):
        steps, row = np.diff(values, axis=1), int(np.count_nonzero(up[0] < 0))
        around = steps[:, max(row - 2, 0)] + steps[:, min(row, steps.shape[1] - 1)]
        jump = np.square(steps[:, row - 1] - around / 2).sum(axis=1)
        along = ahead[:, 0]
        near = np.abs(along) <= reach
        jumps += [jump[near & (along < 0)].sum(), jump[near & (along > 0)].sum()]
        mirror = values[::-1] * (-1.0, 1.0), -ahead[::-1], up[::-1]
        views += [(values, ahead, up), mirror]
    return views[int(np.argmax(jumps))]


def _fall(away: np.ndarray, h: float, r1: float, r2: float) -> np.ndarray:
    """Mean slope, over a cell, of what falls from 1 to 0 between r1 and r2.

    The tip may then stand anywhere between two columns of nodes.
    """
    outer, inner = (np.clip((r2 - away + d) / (r2 - r1), 0.0, 1.0) for d in (-h / 2, h / 2))
    slope: np.ndarray = (outer - inner) / h
    return slope


def crack_gradient(field: np.ndarray, h: float, behind: np.ndarray, row: int) -> np.ndarray:
    """∂u_i/∂x_j by differences, shape [n₁, n₂, 2, 2], one-sided across rows row − 1 and row."""
    by_x, by_y = (np.gradient(field, h, axis=axis, edge_order=2) for axis in (0, 1))
    halves = (field[:, :row], field[:, row:])
    apart = np.concatenate([np.gradient(half, h, axis=1, edge_order=2) for half in halves], axis=1)
    by_y = np.where(behind[:, None, None], apart, by_y)
    return np.stack([by_x, by_y], axis=-1)


def westergaard(x: np.ndarray, half: float, stress: float, lam: float, mu: float) -> np.ndarray:
    """Displacement around a crack |x| < half on y = 0 in a plane under equal tension, shape [N, 2].

    Plane stress with the two-dimensional λ and μ; H. M. Westergaard, 1939.
    """
    kolosov = (lam + 3 * mu) / (lam + mu)
    z = x[:, 0] + 1j * x[:, 1]
    root = np.sqrt(z - half) * np.sqrt(z + half)
    Z, integral = stress * z / root, stress * root
    y = x[:, 1]
    u = ((kolosov - 1) / 2 * integral.real - y * Z.imag) / (2 * mu)
    v = ((kolosov + 1) / 2 * integral.imag - y * Z.real) / (2 * mu)
    return np.column_stack([u, v])
