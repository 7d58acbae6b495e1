"""A hyperelastic solid on a lattice: force, energy, tangent, forces of single energies.

All that an energy sees is linear in e = |ξ|² s, (H2), of the bonds around a site: q = Wᵗ e. Stress
and curvature by q are torch's derivatives; the stress pulls at the bonds, and these at their ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import torch
from numpy.typing import ArrayLike

from warp_peri.core.pointwise import FEW
from warp_peri.errors import InputError
from warp_peri.materials.hyperelastic.energies import (
    BONDS,
    KINDS,
    Density,
    EnergyTerm,
    Hyperelastic,
    deviation,
    half_family,
    read,
    strain_weights,
)
from warp_peri.points.arrays import checked, plain
from warp_peri.points.lattice import neighbour_table, straight_steps
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.runtime import one_thread

SHORT_REACH = 2**0.5
"""Horizon of the short strain in spacings, (H4)."""
CORNERS = ((1, 1), (1, -1), (-1, 1), (-1, -1))
"""Sides of the bonds along both axes that a corner of a cell has, (H19)."""
AXIS_TOLERANCE = 1e-3
"""Degrees between the stated axis and that of the lattice."""
FAR = 3
"""Spacings from the interior to the last node whose short strain shares an energy with it."""
SMALLEST_AREA = 0.02
"""Of the nodal strain, det C: below it a solve treats a field as folded."""
MOST = 2**22
"""Bonds of sites that are held at once; more samples follow one another."""


@dataclass(frozen=True, eq=False)
class LatticeBonds:
    """Families on the nodes of a square lattice, bonds ξ and −ξ of one class.

    Attributes:
        steps: bond vectors in lattice steps, those of the half family first, shape [2 C, 2].
        neighbour: far end of every bond, −1 where there is none, shape [N, 2 C].
        spacing: of the lattice [length].
        grid: place of every node in lattice steps, shape [N, 2].
        pairs: every bond once: its ends i and j and its class.
        xi: their vectors [length], shape [2, pairs].
        number: which pair begins at a node, by class, shape [N, C].
        ends: 1 at a pair's end and −1 at its beginning, shape [N, pairs].
    """

    steps: np.ndarray
    neighbour: np.ndarray
    spacing: float
    grid: np.ndarray
    pairs: tuple[np.ndarray, np.ndarray, np.ndarray]
    xi: np.ndarray
    number: np.ndarray
    ends: sp.csr_array


def lattice_bonds(points: PointsLike, reach: float) -> LatticeBonds:
    """Families of `reach` spacings on a lattice.

    The axes, from which directions of the solid are told, are those of the lattice: along the
    points' axis where it is stated, else at most 45° from x.

    Raises InputError for scattered points, an axis beside those of the lattice, or where no
    interior node keeps 2δ from the edge.
    """
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
                "axis: directions of a hyperelastic solid are told from an axis of the lattice; "
                f"expected none, or {own:.4g}° and quarter turns from it, got {points.axis:g}°"
            )
        turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarters % 4)
        grid, axes = grid @ turn, axes @ turn
    half = half_family(reach)
    steps = np.concatenate([half, -half])
    neighbour = neighbour_table(grid, steps)
    far = neighbour[points.interior]
    if not ((far >= 0).all() and (neighbour[far] >= 0).all()):
        raise InputError("points: interior nodes need complete families out to twice the horizon")
    there = neighbour[:, : len(half)] >= 0
    i, c = np.nonzero(there)
    j, number = neighbour[i, c], np.cumsum(there).reshape(there.shape) - 1
    places, signs = (np.append(j, i), np.tile(np.arange(len(i)), 2)), np.repeat([1.0, -1.0], len(i))
    ends = sp.csr_array((signs, places), shape=(len(grid), len(i)))
    xi = np.ascontiguousarray(points.spacing * axes @ half[c].T)
    return LatticeBonds(steps, neighbour, points.spacing, grid, (i, j, c), xi, number, ends)


class Energy(NamedTuple):
    """An energy of what its sites see."""

    number: int
    density: Density
    angle: Any = 0.0
    exponent: Any = 0.0
    is_fibre: bool = False


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


Active = list[tuple[Patch, list[Energy]]]
"""Energies by what they see."""


class HyperelasticOperator:
    """The internal force of a dictionary of energies on a lattice; equals b in equilibrium.

    Args:
        dictionary: the energies.
        points: a lattice whose interior has the 2δ collar.
        thickness: of every node, > 0, shape [N]; an even sheet where none is given, (H18).

    Displacements have shape [S, N, 2] or [N, 2]. Forces are per volume of the reference, (H8), of a
    sheet of thickness one.

    Raises InputError for points without the collar, or a thickness that is none.
    """

    def __init__(
        self, dictionary: Hyperelastic, points: PointsLike, *, thickness: np.ndarray | None = None
    ) -> None:
        self.dictionary, self.points = dictionary, nodes_of(points)
        self.bonds = lattice_bonds(self.points, dictionary.reach)
        self.interior = np.flatnonzero(self.points.interior)
        self.thickness = self._thick(thickness)
        self._moved = self._apexes = np.ones(len(self.points.x), bool)
        self._patches: dict[Any, Patch] = {}
        self.energies = self._energies()

    def near_interior(self) -> HyperelasticOperator:
        """The same forces on the interior, without short strains and corners that it does not move.

        Far out in the collar a field may be folded, and its energy no number.
        """
        other, steps = copy(self), np.abs(self.bonds.steps)

        def grown(nodes: np.ndarray, near: np.ndarray) -> np.ndarray:
            far = self.bonds.neighbour[:, near]
            return np.asarray(nodes | (nodes[far] & (far >= 0)).any(axis=1))

        other._moved, other._patches = self.points.interior, {}
        other._apexes = grown(other._moved, steps.sum(axis=1) == 1)
        for _ in range(FAR):
            other._moved = grown(other._moved, (steps <= 1).all(axis=1))
        other.energies = other._energies()
        return other

    def with_terms(self, terms: Sequence[EnergyTerm]) -> HyperelasticOperator:
        """The same lattice with other strain energies."""
        other = copy(self)
        other.dictionary = self.dictionary.with_terms(terms)
        other.energies = other._energies()
        return other

    def with_thickness(self, thickness: np.ndarray | None) -> HyperelasticOperator:
        """The same lattice with another thickness of every node, shape [N]; even for none."""
        other = copy(self)
        other.thickness = self._thick(thickness)
        return other

    def _thick(self, thickness: np.ndarray | None) -> np.ndarray | None:
        if thickness is None:
            return None
        values = checked("thickness", thickness, float, (len(self.points.x),))
        if not values.min() > 0:
            raise InputError("thickness: expected finite numbers > 0")
        return values.copy()

    def _energies(self) -> Active:
        own, found = self.dictionary, dict[Any, list[Energy]]()
        for number, (k, q) in enumerate(np.ndindex(own.classes, len(own.bonds))):
            found.setdefault(("bond", k), []).append(Energy(number, BONDS[own.bonds[q]]))
        for number, step in enumerate(own.deviations, own.first_deviation):
            found["deviation", *step] = [Energy(number, deviation)]
        for number, term in enumerate(own.terms, own.first_term):
            energy = Energy(number, KINDS[term.kind], term.angle, term.exponent, term.is_fibre)
            for of in CORNERS if term.corner else ((),):
                sees = ("corner" if term.corner else "strain", *of)
                found.setdefault(sees, []).append(energy)
        return [(self.patch(*sees), each) for sees, each in found.items()]

    def patch(self, kind: str = "strain", *of: int) -> Patch:
        """Where strains, bonds, deviations or corners are, which are built once."""
        if (kind, *of) not in self._patches:
            self._patches[kind, *of] = self._patch(kind, *of)
        return self._patches[kind, *of]

    def _patch(self, kind: str, *of: int) -> Patch:
        bonds, far, known = self.bonds, np.zeros(2, int), np.ones(len(self.points.x), bool)
        C = len(bonds.steps) // 2

        def strain(w: np.ndarray, at: Any = (0, 0)) -> tuple[np.ndarray, ...]:
            """First nodes and classes of the bonds of a node's strain, and their weights."""
            low = np.concatenate([0 * bonds.steps[: len(w)], bonds.steps[C : C + len(w)]])
            return low + at, np.tile(np.arange(len(w)), 2), np.tile(w, (2, 1))

        def bond(step: Any, w: Any, at: Any = (0, 0)) -> tuple[np.ndarray, ...]:
            k = np.flatnonzero((bonds.steps[:C] == step).all(axis=1))
            return np.array([at]), k, np.array([w], float)

        if kind == "strain":
            parts = [strain(strain_weights(self.dictionary.reach, 4))]
        elif kind == "bond":
            far = bonds.steps[of[0]]
            parts = [bond(far, (1 / (far @ far),))]
        elif kind == "corner":
            (p, q), known = of, self._apexes
            third = bond((1, -p * q), (0, 0, -p * q), (0, q) if p > 0 else (p, 0))
            first = bond((1, 0), (1, 0, p * q), (min(p, 0), 0))
            parts = [first, bond((0, 1), (0, 1, p * q), (0, min(q, 0))), third]
        else:
            far = np.array(of)
            known = self._moved & self._moved[neighbour_table(bonds.grid, far[None])[:, 0]]
            x, y = far / np.sqrt(far @ far)
            w = strain_weights(SHORT_REACH, 2)
            along = np.stack([0 * w[:, 0], w @ [x * x, y * y, x * y]], axis=1)
            parts = [strain(along), strain(along, far), bond(far, (2 / (far @ far), 0))]
        low, k, weights = map(np.concatenate, zip(*parts))
        joined = np.concatenate([low, low + bonds.steps[k], [0 * far, far]])
        offsets, place = np.unique(joined, axis=0, return_inverse=True)
        nodes = neighbour_table(bonds.grid, offsets).T
        *ends, own, other = place.ravel()
        nodes = nodes[:, known & (nodes >= 0).all(axis=0)]
        both = np.reshape(ends, (2, len(low)))
        numbers, weights = bonds.number[nodes[both[0]], k[:, None]], weights / bonds.spacing**2
        pair = nodes[[own, other]]
        return Patch(nodes, offsets, both, numbers, weights, pair, kind == "corner")

    def _stored(self, patch: Patch, each: Sequence[Energy], q: torch.Tensor, c: Any) -> Any:
        """Energy of every site over h², shape [S, n]."""
        seen = read(q)
        total = sum(c[e.number] * e.density(seen, e.angle, e.exponent) for e in each)
        share = 1 / len(CORNERS) if patch.corner else 1.0
        if self.thickness is None:
            return share * total
        return torch.from_numpy(share * self.thickness[patch.pair].mean(axis=0)) * total

    def _slope(
        self, patch: Patch, each: Sequence[Energy], q: torch.Tensor, c: Any, graph: bool = False
    ) -> torch.Tensor:
        """∂U/∂q over h², shape [Q, S, n]; with a graph of q, which becomes a leaf."""
        stored = self._stored(patch, each, q.requires_grad_(), c).sum()
        return torch.autograd.grad(stored, q, create_graph=graph)[0]

    def _swept(self, sweep: Callable[..., np.ndarray], *fields: ArrayLike) -> np.ndarray:
        """What a sweep makes of fields [S, N, 2], a few samples at once, one after another."""
        given, shape = [plain("u", field) for field in fields], self.points.x.shape
        for name, one in zip("uv", given):
            if one.ndim not in (2, 3) or (one.shape[-2:], one.shape) != (shape, given[0].shape):
                expected = f"[S, {shape[0]}, 2] or [{shape[0]}, 2]"
                raise InputError(f"{name}: expected shape {expected}, got {list(one.shape)}")
        flat = [each.reshape(-1, *shape) for each in given]
        most = max(patch.bonds.size for patch, _ in self.energies)
        step, count = max(1, MOST // most), len(flat[0])
        with torch.enable_grad(), one_thread(3 * len(self.points.x) * min(step, count) < FEW):
            parts = [sweep(*(u[at : at + step] for u in flat)) for at in range(0, count, step)]
        whole = np.concatenate(parts)
        return whole.reshape(*given[0].shape[:-2], *whole.shape[1:])

    def _differences(self, u: np.ndarray) -> np.ndarray:
        """η = u_j − u_i of fields [S, N, 2], shape [S, 2, pairs]."""
        (i, j, _), u = self.bonds.pairs, np.ascontiguousarray(u.swapaxes(1, 2))
        eta: np.ndarray = np.take(u, j, axis=2) - np.take(u, i, axis=2)
        return eta

    def _stretched(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bonds ξ + η as they are now, [S, 2, pairs], and e = ξ·η + ½ η·η, [S, pairs]."""
        eta, xi = self._differences(u), self.bonds.xi
        return xi + eta, ((xi + eta / 2) * eta).sum(axis=1)

    def _active(self, c: np.ndarray) -> Active:
        """Energies whose coefficient is not zero."""
        checked("c", c, float, (len(self.dictionary),))
        active = ((patch, [one for one in each if c[one.number]]) for patch, each in self.energies)
        return [(patch, each) for patch, each in active if each]

    def _tension(self, e: np.ndarray, c: np.ndarray, active: Active) -> np.ndarray:
        """What energies pull at bonds e [S, pairs], over ξ + η."""
        tension = np.zeros_like(e)
        for patch, each in active:
            patch.pull(self._slope(patch, each, patch.seen(e), c), tension)
        return tension

    def _at_ends(self, pull: np.ndarray) -> np.ndarray:
        """What pulls of the bonds [S, 2, pairs] come to at the nodes, [S, N, 2]."""
        flat = self.bonds.ends @ pull.reshape(-1, pull.shape[2]).T
        return np.asarray(flat.reshape(-1, len(pull), 2).swapaxes(0, 1))

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Nodal Green strain E11, E22, 2 E12, (H3), shape [..., N, 3]; zero near the edge."""
        patch = self.patch()

        def sweep(u: np.ndarray) -> np.ndarray:
            E = np.zeros((*u.shape[:2], 3))
            E[:, patch.pair[0]] = patch.seen(self._stretched(u)[1]).movedim(0, -1)
            return E

        return self._swept(sweep, u)

    def smallest_area(self, u: np.ndarray) -> float:
        """Smallest det C of the nodal strain, 1 at rest; not positive where a field folds."""
        e = self._stretched(np.reshape(u, (-1, *self.points.x.shape)))[1]
        return min(1.0, float(read(self.patch().seen(e)).area.min()))

    def folded(self, u: np.ndarray) -> int:
        """Number of corners with an interior node that one field turns over, shape of u [N, 2]."""
        (Y,), count = self._stretched(u[None])[0], 0
        for patch in (self.patch("corner", *of) for of in CORNERS):
            first, second, _ = np.moveaxis(Y[:, patch.bonds], 1, 0)
            over = first[0] * second[1] - first[1] * second[0] <= 0
            count += int((over & self.points.interior[patch.nodes].any(axis=0)).sum())
        return count

    def energy(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """U, (H1), for every sample [stress × area], shape [S] or []."""
        return np.asarray(self.nodal_energy(u, c).sum(axis=-1) * self.bonds.spacing**2)

    def nodal_energy(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """What every node and the bonds that begin there hold, over h², shape [..., N]."""
        active = self._active(c)

        def sweep(u: np.ndarray) -> np.ndarray:
            e, total = self._stretched(u)[1], np.zeros(u.shape[:2])
            for patch, each in active:
                total[:, patch.pair[0]] += self._stored(patch, each, patch.seen(e), c).numpy()
            return total

        return self._swept(sweep, u)

    def force(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """The force (H8) on the interior nodes [stress / length], shape [..., I, 2]."""
        return self.everywhere(u, c)[..., self.interior, :]

    def everywhere(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """The derivative of U by every node's displacement over h², shape [..., N, 2]."""
        active = self._active(c)

        def sweep(u: np.ndarray) -> np.ndarray:
            Y, e = self._stretched(u)
            return self._at_ends(self._tension(e, c, active)[:, None] * Y)

        return self._swept(sweep, u)

    def jvp(self, u: np.ndarray, c: np.ndarray, v: np.ndarray) -> np.ndarray:
        """K v, the derivative of the force along v, (H10), on all nodes, shape [..., N, 2]."""
        active = self._active(c)

        def sweep(u: np.ndarray, v: np.ndarray) -> np.ndarray:
            (Y, e), away = self._stretched(u), self._differences(v)
            along, tension, change = (Y * away).sum(axis=1), np.zeros_like(e), np.zeros_like(e)
            for patch, each in active:
                stress = self._slope(patch, each, q := patch.seen(e), c, graph=True)
                patch.pull(torch.autograd.grad(stress, q, patch.seen(along))[0], change)
                patch.pull(stress.detach(), tension)
            return self._at_ends(tension[:, None] * away + change[:, None] * Y)

        return self._swept(sweep, u, v)

    def curvatures(self, u: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[Any]]:
        """Of one field what pulls at bonds [pairs], these bonds as they are now [2, pairs], and
        patches with the second derivatives of their energies [Q, Q, n].
        """
        (Y,), e = self._stretched(plain("u", u)[None])
        tension, found = np.zeros_like(e), list[Any]()
        with torch.enable_grad(), one_thread(3 * len(self.points.x) < FEW):
            for patch, each in self._active(c):
                stress = self._slope(patch, each, q := patch.seen(e), c, graph=True)
                patch.pull(stress.detach(), tension)
                rows = [torch.autograd.grad(s.sum(), q, retain_graph=True)[0] for s in stress]
                found.append((patch, torch.stack(rows)[:, :, 0].numpy()))
        return tension[0], Y, found

    def features(self, u: np.ndarray, *, by: str = "coefficient") -> np.ndarray:
        """The force of every energy with coefficient one, shape [..., I, 2, K].

        Args:
            u: displacements.
            by: "angle" or "exponent" for the derivative of that force by the fibre's number; the
                other columns are then zero.
        """

        def sweep(u: np.ndarray) -> np.ndarray:
            Y, e = self._stretched(u)
            forces = np.zeros((len(u), len(self.interior), 2, len(self.dictionary)))
            for patch, number, stress in self._single(e, by):
                tension = np.zeros_like(e)
                patch.pull(stress, tension)
                forces[..., number] += self._at_ends(tension[:, None] * Y)[:, self.interior]
            return forces

        return self._swept(sweep, u)

    def _single(self, e: np.ndarray, by: str) -> Iterator[tuple[Patch, int, torch.Tensor]]:
        """Stress [Q, S, n] of every energy with coefficient one, or its derivative."""
        one = np.ones(len(self.dictionary))
        for patch, each in self.energies:
            q = patch.seen(e)
            for energy in each:
                if by == "coefficient":
                    yield patch, energy.number, self._slope(patch, [energy], q, one)
                elif energy.is_fibre:
                    number = torch.tensor(getattr(energy, by), dtype=q.dtype, requires_grad=True)
                    moved: Energy = energy._replace(**{by: number})  # type: ignore[arg-type]
                    stored = self._stored(patch, [moved], q.requires_grad_(), one).sum()
                    (slope,) = torch.autograd.grad(stored, number, create_graph=True)
                    yield patch, energy.number, torch.autograd.grad(slope, q)[0]

    def by_thickness(self, u: np.ndarray, c: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """The derivative of the force by what the thickness depends on, shape [..., I, 2, P].

        Args:
            u: displacements.
            c: coefficients.
            slopes: derivative of every node's thickness by those numbers, shape [N, P].

        The force is linear in the thickness, so this is the force of sheets as thick as the slopes.
        """
        parts, other = [], copy(self)
        for other.thickness in np.asarray(slopes).T:
            parts.append(other.force(u, c))
        return np.stack(parts, axis=-1)

    def pairing(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Σ f_k·w over samples and interior nodes for every energy k with coefficient one, [K]."""
        return np.asarray(np.tensordot(w, self.features(u), np.ndim(w)))

    def stress(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """First Piola stress P = ½ Σ t (ξ + η)⊗ξ of a node's bonds, (H16), shape [..., N, 2, 2].

        It is ∂W/∂F in uniform strain, on nodes whose neighbours all have whole families; nearer to
        the edge it misses what bonds to outside would carry. Of a sheet that is not even it is the
        pull per length of a section, over thickness one. Corners carry theirs at their apex.
        """
        active = self._active(c)

        def sweep(u: np.ndarray) -> np.ndarray:
            Y, e = self._stretched(u)
            nodal = [(patch, each) for patch, each in active if not patch.corner]
            carried = np.einsum("sb,sib,jb->bsij", self._tension(e, c, nodal), Y, self.bonds.xi)
            P = abs(self.bonds.ends) @ carried.reshape(e.shape[1], -1) / 2
            P = P.reshape(-1, len(u), 2, 2).swapaxes(0, 1)
            for patch, each in active:
                if patch.corner:
                    t = patch.along(self._slope(patch, each, patch.seen(e), c))
                    given = t, Y[..., patch.bonds], self.bonds.xi[:, patch.bonds]
                    P[:, patch.pair[0]] += np.einsum("sln,siln,jln->snij", *given)
            return np.asarray(P)

        return self._swept(sweep, u)
