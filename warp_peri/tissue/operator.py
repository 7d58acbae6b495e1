"""A hyperelastic solid on a lattice: force, energy, tangent, forces of single energies."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
import warp as wp

from warp_peri.core.tensors import nonlinear
from warp_peri.errors import InputError
from warp_peri.kernels.hyperelastic.corner_tangent import corner_tangents
from warp_peri.kernels.hyperelastic.corners import corners
from warp_peri.kernels.hyperelastic.parts import CORNER, types
from warp_peri.kernels.hyperelastic.sweeps import sweeps
from warp_peri.kernels.hyperelastic.tangent import features, tangents
from warp_peri.launch import empty, floats, ints, launch, zeros
from warp_peri.points.arrays import plain
from warp_peri.points.lattice import neighbour_table, straight_steps
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.tissue.solid import (
    ACROSS,
    BONDS,
    KINDS,
    Dictionary,
    Term,
    half_family,
    strain_weights,
)

SHORT_REACH = 2**0.5
"""Horizon of the short strain in spacings, (H4)."""
AXIS_TOLERANCE = 1e-3
"""Degrees between the stated axis and that of the lattice."""


@dataclass(frozen=True, eq=False)
class LatticeBonds:
    """Whole families on the nodes of a square lattice, bonds ξ and −ξ of one class.

    Attributes:
        steps: bond vectors in lattice steps, those of the half family first, shape [2 C, 2].
        neighbour: far end of every bond, −1 where there is none, shape [N, 2 C].
        whole: which strains a node has: 1 the strain, 2 the short strain, 3 both, shape [N].
        spacing: of the lattice [length].
        grid: place of every node in lattice steps, shape [N, 2].
        axes: of the lattice, which directions of the solid are told from, as columns.
    """

    steps: np.ndarray
    neighbour: np.ndarray
    whole: np.ndarray
    spacing: float
    grid: np.ndarray
    axes: np.ndarray

    @property
    def xi(self) -> np.ndarray:
        """Bond vectors [length], shape [2 C, 2]."""
        vectors: np.ndarray = self.spacing * self.steps @ self.axes.T
        return vectors

    @property
    def classes(self) -> int:
        """Number of bond classes C."""
        return len(self.steps) // 2

    @cached_property
    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every bond once: its ends i and j and its class."""
        i, c = np.nonzero(self.neighbour[:, : self.classes] >= 0)
        return i, self.neighbour[i, c], c


def lattice_bonds(points: PointsLike, reach: float) -> LatticeBonds:
    """Families of `reach` spacings on a lattice.

    The axes are those of the lattice: along the points' axis where it is stated, else at most 45°
    from x.

    Raises InputError for scattered points, an axis beside those of the lattice, or where no
    interior node keeps 2δ from the edge.
    """
    if not points.spacing > 0:
        raise InputError("points: expected a lattice (spacing > 0), got scattered points")
    if points.box is not None or points.outside is not None:
        raise InputError("points: expected neither a box nor nodes outside of the body")
    steps, axes = straight_steps(points.x, points.spacing)
    steps, axes = _along(points.axis, steps, axes)
    half = half_family(reach)
    family = np.concatenate([half, -half])
    neighbour = neighbour_table(steps, family)
    near = (family**2).sum(axis=1) <= SHORT_REACH**2 + 1e-9
    whole: np.ndarray = np.all(neighbour >= 0, axis=1).astype(int)
    whole = whole + 2 * np.all(neighbour[:, near] >= 0, axis=1)
    inner = (neighbour[points.interior] >= 0).all(axis=1)
    far = neighbour[points.interior][inner]
    if not inner.all() or not (whole[far] % 2 == 1).all():
        raise InputError("points: interior nodes need complete families out to twice the horizon")
    return LatticeBonds(family, neighbour, whole, points.spacing, steps, axes)


def _along(
    axis: float | None, steps: np.ndarray, axes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps and axes of a lattice by quarter turns of its axes to the stated one."""
    if axis is None:
        return steps, axes
    own = float(np.rad2deg(np.arctan2(axes[1, 0], axes[0, 0])))
    quarters = round((axis - own) / 90)
    if abs(axis - own - 90 * quarters) > AXIS_TOLERANCE:
        raise InputError(
            "axis: directions of a hyperelastic solid are told from an axis of the lattice; "
            f"expected none, or {own:.4g}° and quarter turns from it, got {axis:g}°"
        )
    turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), quarters % 4)
    return steps @ turn, axes @ turn


CHUNK = 2**26
"""Bytes of the states of single energies that are held at once."""
FAR = 3
"""Spacings from the interior to the last node whose short strain shares an energy with it."""
SMALLEST_AREA = 0.02
"""Of the nodal strain, det C: below it a solve treats a field as folded."""


class HyperelasticOperator:
    """The internal force of a dictionary of energies on a lattice; equals b in equilibrium.

    Args:
        dictionary: the energies.
        points: a lattice whose interior has the 2δ collar.
        thickness: of every node, > 0, shape [N]; an even sheet where none is given, (H18).
        dtype: wp.float64 or wp.float32.

    ``op.force(u, c)`` is differentiable in both for torch tensors; the other functions take and
    give NumPy arrays. Displacements have shape [S, N, 2] or [N, 2]. Forces are per volume of the
    reference, (H8), of a sheet of thickness one.

    Raises InputError for points without the collar, or a thickness that is none.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        points: PointsLike,
        *,
        thickness: np.ndarray | None = None,
        dtype: Any = wp.float64,
    ) -> None:
        self.dictionary, self.points, self.scalar = dictionary, nodes_of(points), dtype
        self.bonds = lattice_bonds(self.points, dictionary.reach)
        self.interior = np.flatnonzero(points.interior)
        self.of = types(dtype)
        self.thickness = self._thick(thickness)
        self.apexes = np.ones(len(self.points.x), bool)
        self.lattice = self._place()
        self._packed: tuple[np.ndarray, Any] | None = None
        self._rows, self._all = ints(self.interior), ints(np.arange(len(points.x)))

    def near_interior(self) -> HyperelasticOperator:
        """The same forces on the interior, without short strains and corners that it does not move.

        Far out in the collar a field may be folded, and its energy no number.
        """
        bonds = self.bonds
        moved: np.ndarray = np.isin(np.arange(len(self.points.x)), self.interior)
        near = bonds.neighbour[:, (np.abs(bonds.steps) <= 1).all(axis=1)]
        for _ in range(FAR):
            moved = moved | np.where(near >= 0, moved[near], False).any(axis=1)
        other = copy(self)
        other.apexes = self.points.interior.copy()
        axes = bonds.neighbour[:, np.abs(bonds.steps).sum(axis=1) == 1]
        other.apexes |= ((axes >= 0) & self.points.interior[axes]).any(axis=1)
        other.bonds = replace(bonds, whole=np.where(moved, bonds.whole, bonds.whole % 2))
        other.lattice = other._place()
        return other

    def with_terms(self, terms: Sequence[Term]) -> HyperelasticOperator:
        """The same lattice with other strain energies."""
        other = copy(self)
        other.dictionary = self.dictionary.with_terms(terms)
        other._packed = None
        return other

    def with_thickness(self, thickness: np.ndarray | None) -> HyperelasticOperator:
        """The same lattice with another thickness of every node, shape [N]; even for none."""
        return self._weighed(self._thick(thickness))

    def _weighed(self, weights: np.ndarray | None) -> HyperelasticOperator:
        """The same with energies weighed by any numbers, one a node."""
        other, lattice = copy(self), self.of.Lattice()
        for name in self.of.Lattice.vars:
            setattr(lattice, name, getattr(self.lattice, name))
        lattice.thickness = self._of_nodes(weights)
        other.lattice, other.thickness = lattice, weights
        return other

    def _of_nodes(self, weights: np.ndarray | None) -> Any:
        """Weights as the kernels read them, empty for an even sheet."""
        real = np.float64 if self.scalar == wp.float64 else np.float32
        return floats((np.zeros(0) if weights is None else weights).astype(real), self.scalar)

    def _thick(self, thickness: np.ndarray | None) -> np.ndarray | None:
        if thickness is None:
            return None
        values = plain("thickness", thickness).copy()
        if values.shape != (len(self.points.x),):
            raise InputError(
                f"thickness: expected {len(self.points.x)} numbers, got shape {list(values.shape)}"
            )
        if not (np.isfinite(values).all() and values.min() > 0):
            raise InputError("thickness: expected finite numbers > 0")
        return values

    def _place(self) -> Any:
        """The bonds as the kernels read them."""
        bonds, h, C = self.bonds, self.bonds.spacing, self.bonds.classes
        real = np.float64 if self.scalar == wp.float64 else np.float32
        xi = h * bonds.steps  # strains and their weights are told in the frame of the lattice
        square = (xi**2).sum(axis=1)
        short = np.zeros((C, 3))
        near = (bonds.steps[:C] ** 2).sum(axis=1) <= SHORT_REACH**2 + 1e-9
        short[near] = strain_weights(SHORT_REACH, 2)
        weight = np.concatenate([strain_weights(self.dictionary.reach, 4), short], axis=1) / h**2
        self.weight = weight
        self.unit = (
            np.stack([xi[:, 0] ** 2, xi[:, 1] ** 2, xi[:, 0] * xi[:, 1]], axis=1) / square[:, None]
        )
        deviation = np.full(C, -1)
        for number, step in enumerate(self.dictionary.deviations):
            deviation[(bonds.steps[:C] == step).all(axis=1)] = number
        self.deviation = deviation
        lattice = self.of.Lattice()
        lattice.neighbour = ints(bonds.neighbour)
        lattice.whole = ints(bonds.whole)
        lattice.apex = ints(self.apexes.astype(int))
        lattice.xi = floats(bonds.xi.astype(real), self.of.vec)
        lattice.inverse = floats((1 / square).astype(real), self.scalar)
        lattice.weight = floats(np.tile(weight, (2, 1)).astype(real), self.of.six)
        lattice.unit = floats(self.unit.astype(real), wp.types.vector(3, self.scalar))
        lattice.bond_class = ints(np.tile(np.arange(C), 2))
        lattice.deviation = ints(np.tile(deviation, 2))
        lattice.thickness = self._of_nodes(self.thickness)
        return lattice

    def _terms(self, c: np.ndarray) -> Any:
        """The energies as the kernels read them; a search asks for the same ones many times."""
        if self._packed is not None and np.array_equal(self._packed[0], c):
            return self._packed[1]
        dictionary = self.dictionary
        terms = dictionary.terms
        real = np.float64 if self.scalar == wp.float64 else np.float32
        packed = self.of.Terms()
        packed.bond_kind = ints(np.array([BONDS[name] for name in dictionary.bonds], int))
        packed.kind = ints(np.array([KINDS[term.kind] for term in terms], int))
        seen = [int(t.ripple) if t.across is None else 2 + ACROSS.index(t.across) for t in terms]
        seen = [CORNER if term.corner else n for term, n in zip(terms, seen)]
        packed.seen = ints(np.array(seen, int))
        packed.angle = floats(np.array([term.angle for term in terms], real), self.scalar)
        packed.exponent = floats(np.array([term.exponent for term in terms], real), self.scalar)
        packed.c = floats(np.array(c, real), self.scalar)
        packed.first_deviation = dictionary.first_deviation
        packed.first_term = dictionary.first_term
        packed.local = bool(dictionary.deviations) or any(1 < n < CORNER for n in seen)
        self._packed = np.array(c, float), packed
        return packed

    def _field(self, u: np.ndarray) -> Any:
        """A displacement as the kernels read it, shape [S, N]."""
        u = plain("u", u)
        n = len(self.points.x)
        if u.ndim not in (2, 3) or u.shape[-2:] != (n, 2):
            raise InputError(f"u: expected shape [S, {n}, 2] or [{n}, 2], got {list(u.shape)}")
        real = np.float64 if self.scalar == wp.float64 else np.float32
        return floats(np.ascontiguousarray(u.reshape(-1, n, 2), real), self.of.vec)

    def _coefficients(self, c: np.ndarray) -> np.ndarray:
        c = np.asarray(c, float)
        if c.shape != (len(self.dictionary),):
            raise InputError(
                f"c: expected {len(self.dictionary)} coefficients, got shape {list(c.shape)}"
            )
        return c

    def _states(self, field: Any, terms: Any) -> tuple[Any, Any]:
        """Strains and their stresses."""
        kernels = sweeps(self.scalar)
        E, G = (empty(*field.shape, dtype=self.of.six) for _ in range(2))
        launch(kernels.strain, field.shape, [self.lattice, field], [E])
        launch(kernels.stress, field.shape, [self.lattice, terms, field, E], [G])
        return E, G

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Nodal Green strain E11, E22, 2 E12, (H3), shape [..., N, 3]; zero near the edge."""
        field = self._field(u)
        E = empty(*field.shape, dtype=self.of.six)
        launch(sweeps(self.scalar).strain, field.shape, [self.lattice, field], [E])
        strains: np.ndarray = E.numpy()[..., :3].reshape(*np.shape(u)[:-1], 3)
        return strains

    def smallest_area(self, u: np.ndarray) -> float:
        """Smallest det C of the nodal strain, 1 at rest; not positive where a field folds."""
        E = self.strain(u).reshape(-1, 3)
        return float(((1 + 2 * E[:, 0]) * (1 + 2 * E[:, 1]) - E[:, 2] ** 2).min())

    def folded(self, u: np.ndarray) -> int:
        """Number of corners with an interior node that one field turns over, shape of u [N, 2]."""
        y, C = self.points.x + u, self.bonds.classes
        inside = self.points.interior
        count = 0
        for first in (1, 1 + C):  # ACROSS: bonds (0, 1) and (1, 0) come first
            for second in (0, C):
                ends = self.bonds.neighbour[:, [first, second]]
                n = np.flatnonzero((ends >= 0).all(axis=1))
                p, q = ends[n].T
                Y, Z = y[p] - y[n], y[q] - y[n]
                sign = 1 if (first < C) == (second < C) else -1
                over = sign * (Y[:, 0] * Z[:, 1] - Y[:, 1] * Z[:, 0]) <= 0
                count += int((over & (inside[n] | inside[p] | inside[q])).sum())
        return count

    def energy(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """U, (H1), for every sample [stress × area], shape [S] or []."""
        total: np.ndarray = self.nodal_energy(u, c).sum(axis=-1) * self.bonds.spacing**2
        return total

    def nodal_energy(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """What every node and half of its bonds hold, over h², shape [..., N]."""
        field, terms = self._field(u), self._terms(self._coefficients(c))
        E, _ = self._states(field, terms)
        U = empty(*field.shape, dtype=self.scalar)
        launch(sweeps(self.scalar).energy, field.shape, [self.lattice, terms, field, E], [U])
        if self.dictionary.cornered:
            launch(corners(self.scalar).energy, field.shape, [self.lattice, terms, field], [U])
        energies: np.ndarray = U.numpy().reshape(np.shape(u)[:-1])
        return energies

    def force(
        self, u: np.ndarray | torch.Tensor, c: np.ndarray | torch.Tensor
    ) -> np.ndarray | torch.Tensor:
        """The force (H8) on the interior nodes [stress / length], shape [..., I, 2]."""
        if isinstance(u, torch.Tensor) or isinstance(c, torch.Tensor):
            u, c = torch.as_tensor(u), torch.as_tensor(c)
            backs = (self.product, lambda u, c, g: self.pairing(u, g))
            force = nonlinear(self.everywhere, None, backs, u, c)
            return force[..., self.interior, :].to(u.dtype)
        return self.everywhere(u, c)[..., self.interior, :]

    def everywhere(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """The derivative of U by every node's displacement over h², shape [..., N, 2]."""
        field, terms = self._field(u), self._terms(self._coefficients(c))
        E, G = self._states(field, terms)
        f = empty(*field.shape, dtype=self.of.vec)
        launch(sweeps(self.scalar).force, field.shape, [self.lattice, terms, field, E, G], [f])
        if self.dictionary.cornered:
            launch(corners(self.scalar).force, field.shape, [self.lattice, terms, field], [f])
        forces: np.ndarray = f.numpy().reshape(np.shape(u))
        return forces

    def product(self, u: np.ndarray, c: np.ndarray, v: np.ndarray) -> np.ndarray:
        """K v, the derivative of the force along v, (H10), on all nodes, shape [..., N, 2]."""
        field, along = self._field(u), self._field(v)
        if np.shape(v) != np.shape(u):
            raise InputError(
                f"v: expected the shape of u, {list(np.shape(u))}, got {list(np.shape(v))}"
            )
        terms, kernels = self._terms(self._coefficients(c)), tangents(self.scalar)
        E, G = self._states(field, terms)
        H = empty(*field.shape, dtype=self.of.block)
        dE, dG = (empty(*field.shape, dtype=self.of.six) for _ in range(2))
        df = empty(*field.shape, dtype=self.of.vec)
        shape, lattice = field.shape, self.lattice
        launch(kernels.curvature, shape, [lattice, terms, E], [H])
        launch(kernels.strain_rate, shape, [lattice, field, along], [dE])
        launch(kernels.stress_rate, shape, [lattice, terms, field, along, H, E, dE], [dG])
        launch(kernels.force_rate, shape, [lattice, terms, field, along, E, dE, G, dG], [df])
        if self.dictionary.cornered:
            launch(
                corner_tangents(self.scalar).product, shape, [lattice, terms, field, along], [df]
            )
        rates: np.ndarray = df.numpy().reshape(np.shape(u))
        return rates

    def features(self, u: np.ndarray, *, by: str = "coefficient") -> np.ndarray:
        """The force of every energy with coefficient one, shape [..., I, 2, K].

        Args:
            u: displacements.
            by: "angle" or "exponent" for the derivative of that force by the fibre's number; the
                other columns are then zero.
        """
        which = {"coefficient": 0, "angle": 1, "exponent": 2}[by]
        fields = plain("u", u).reshape(-1, len(self.points.x), 2)
        forces = self._features(fields, which, self._rows)
        if which:
            forces[..., : self.dictionary.first_term] = 0.0
        return forces.reshape(*np.shape(u)[:-2], len(self.interior), 2, len(self.dictionary))

    def by_thickness(self, u: np.ndarray, c: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """The derivative of the force by what the thickness depends on, shape [..., I, 2, P].

        Args:
            u: displacements.
            c: coefficients.
            slopes: derivative of every node's thickness by those numbers, shape [N, P].

        The force is linear in the thickness, so this is the force of sheets as thick as the slopes.
        """
        parts = [self._weighed(slope).everywhere(u, c) for slope in np.asarray(slopes).T]
        return np.stack([part[..., self.interior, :] for part in parts], axis=-1)

    def _features(self, fields: np.ndarray, which: int, rows: Any) -> np.ndarray:
        """Forces of single energies on some nodes, chunk by chunk of samples."""
        terms = self._terms(np.zeros(len(self.dictionary)))
        kernels, K = features(self.scalar), len(self.dictionary)
        states = K - self.dictionary.first_deviation
        chunk = max(1, CHUNK // (48 * max(states, 1) * len(self.points.x)))
        forces = np.empty((len(fields), len(rows), 2, K))
        for first in range(0, len(fields), chunk):
            field = self._field(fields[first : first + chunk])
            E = empty(*field.shape, dtype=self.of.six)
            launch(sweeps(self.scalar).strain, field.shape, [self.lattice, field], [E])
            G = zeros(*field.shape, states, dtype=self.of.six)
            inputs = [self.lattice, terms, which, field, E]
            launch(kernels.stress_of_each, G.shape, inputs, [G])
            F = zeros(len(field), len(rows), K, dtype=self.of.vec)
            inputs = [self.lattice, terms, rows, field, E, G]
            launch(kernels.force_of_each, F.shape[:2], inputs, [F])
            if self.dictionary.cornered:
                inputs = [self.lattice, terms, which, rows, field]
                launch(corners(self.scalar).force_of_each, F.shape[:2], inputs, [F])
            forces[first : first + chunk] = F.numpy().transpose(0, 1, 3, 2)
        return forces

    def pairing(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Σ f_k·v over samples and nodes for every energy k with coefficient one, shape [K]."""
        fields = plain("u", u).reshape(-1, len(self.points.x), 2)
        seeds = plain("v", v).reshape(fields.shape)
        sums = np.zeros(len(self.dictionary))
        for field, seed in zip(fields, seeds):
            F = self._features(field[None], 0, self._all)[0]
            sums += np.einsum("idk,id->k", F, seed)
        return sums

    def curved_states(self, u: np.ndarray, c: np.ndarray) -> tuple[Any, Any, Any, Any, Any]:
        """Field, energies, strains, stresses and curvatures as the kernels read them."""
        field, terms = self._field(u), self._terms(self._coefficients(c))
        E, G = self._states(field, terms)
        H = empty(*field.shape, dtype=self.of.block)
        launch(tangents(self.scalar).curvature, field.shape, [self.lattice, terms, E], [H])
        return field, terms, E, G, H

    def corner_stress(self, u: np.ndarray, c: np.ndarray) -> np.ndarray:
        """What corners add to the stress (H16) at the nodes of one field, shape [N, 2, 2]."""
        field, terms = self._field(u), self._terms(self._coefficients(c))
        P = zeros(*field.shape, dtype=wp.types.matrix((2, 2), self.scalar))
        launch(corners(self.scalar).stress, field.shape, [self.lattice, terms, field], [P])
        stresses: np.ndarray = P.numpy()[0]
        return stresses

    def states(self, u: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Strains, their stresses and curvatures of one field, shapes [N, 6], [N, 6], [N, 6, 6]."""
        _, _, E, G, H = self.curved_states(u, c)
        return E.numpy()[0], G.numpy()[0], H.numpy()[0]


def laplacian(op: HyperelasticOperator) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """The five-point Laplacian between interior nodes, and from the collar (columns: all nodes)."""
    steps = op.bonds.steps
    near = np.flatnonzero(np.abs(steps).sum(axis=1) == 1)
    far = op.bonds.neighbour[op.interior][:, near]
    number = np.full(len(op.points.x), -1)
    number[op.interior] = np.arange(len(op.interior))
    rows = np.repeat(np.arange(len(op.interior)), len(near))
    square = op.bonds.spacing**2
    whole = sp.csr_matrix(
        (np.full(len(rows), -1 / square), (rows, far.ravel())),
        shape=(len(op.interior), len(op.points.x)),
    )
    inside = op.points.interior
    own = whole[:, inside] + sp.eye(len(op.interior)) * (len(near) / square)
    collar = whole @ sp.diags((~inside).astype(float))
    return own.tocsr(), collar.tocsr()
