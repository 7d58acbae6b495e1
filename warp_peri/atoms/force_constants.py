"""Force constants of atoms, and their effective stiffness on a lattice of nodes (theory, T14)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from ase import Atoms
from ase.build import make_supercell
from numpy import ndarray
from numpy.linalg import det, eigvalsh, inv, lstsq, norm, solve

from warp_peri.core import elastic
from warp_peri.core.elastic import acoustic, directions, kinds_of, point_group, symmetric_part
from warp_peri.errors import InputError, Several, hold, warn
from warp_peri.fitting.regression import norms, relative
from warp_peri.points import arguments
from warp_peri.points.arguments import EV_IN_TPA, ArrayMap, checked, typed, typed_methods
from warp_peri.points.points import grid_places

STEP, WIDER = 2e-3, 5
"""Displacement of finite differences [Å], and the second one over it."""
KINKED, CUT = 0.01, 0.05
"""Change of Φ between both displacements, and share of Σ |Φ| r² at the edge, worth a word."""
EDGE = 0.45
"""Of a supercell's width: pairs that far apart are at its edge."""
NEGLIGIBLE = 1e-9
"""Of the largest Φ: smaller ones are rounding, and what they sum up to goes to the atom itself."""
ON_SITE = 1e-3
"""Of the cell's edges, that atoms of a supercell may be off their sites."""
NEAREST = 1e-5
"""Images whose distances differ by less, relative, count as equally near."""
LONG = 4e-3
"""|k| [1/Å] of waves that have the moduli of moments where Φ keeps its sums."""
SMALL = 2e-3
"""|k| [1/Å] of the differences that second moments of ions' fields are taken by."""
COULOMB = 14.399645
"""e²/(4π ε₀) [eV Å]."""
UNBALANCED = 0.1
"""Of the largest charge, or of 1 e: calculated ones miss zero by 0.01–0.1 e, which all atoms then
share; one that is missing, or another crystal's, by a whole one."""
DECAYED, NEGLECTED = 3.5, 36.0
"""x with erfc(x) ≈ 0 at half a supercell, and exponents of Gaussians that are left out."""
MOST_WAVES = 1e7
"""Waves times atoms of sums over dipoles: a gigabyte."""
TINY = float(np.finfo(float).tiny)
"""Divides what is zero."""
SOFT = 1e-14
"""Λmin of a dynamical matrix over the largest Φ, below which a wave has no stiffness."""
FLAT = 1e-3
"""Heights of a sheet's atoms within so much of one another [Å] are a plane's."""
HELD = 1e3
"""Of the largest Φ, that a sheet's mean height is held with."""
NOT_ELASTIC = 3e-3
"""Of long waves, that may be missed by all elastic tensors of the symmetry."""


@typed
@dataclass(frozen=True, eq=False)
class NonAnalyticCorrection:
    """Dipole–dipole part of the force constants of ions (theory, T18).

    Of the effective charges `born` of a cell's atoms [e], [n, 3, 3], less their mean, and the
    clamped-ion `dielectric` tensor [3, 3]; `decay` is Λ [1/Å] of the Gaussians, 0 by default.
    Raises InputError for charges whose sum is a tenth of the largest, or of 1 e, and for a tensor
    that is not symmetric and positive.
    """

    born: ndarray
    dielectric: ndarray
    decay: arguments.NotNegative = 0.0

    def __post_init__(self) -> None:
        born = checked("born", self.born, shape=("n", 3, 3))
        most = UNBALANCED * np.abs(born).max(initial=1.0)
        if (np.abs(total := born.sum(axis=0)) > most).any():
            raise InputError(
                f"born: expected charges of a cell whose sum is 0 within {most:.2g} e, got "
                f"{np.round(total, 4).tolist()}"
            )
        tensor = checked("dielectric", self.dielectric, shape=(3, 3))
        hold(self, born=born - born.mean(axis=0), dielectric=symmetric_part(tensor))
        # calculated ones are symmetric to some digits
        alike = np.allclose(tensor, tensor.T, rtol=0, atol=0.01 * np.abs(tensor).max())
        if not (alike and (eigvalsh(tensor) > 0).all()):
            raise InputError(f"dielectric: expected a symmetric positive tensor, got {tensor}")

    def matrix(
        self, k: ndarray, cell: ndarray, positions: ndarray, *, field: bool = True
    ) -> ndarray:
        """Dipole–dipole matrix [eV/Å²], [K, n, 3, n, 3]; without macroscopic `field` smooth."""
        k, cell = checked("k", k, shape=("K", 3)), checked("cell", cell, shape=(3, 3))
        positions = checked("positions", positions, shape=(len(self.born), 3))
        least = eigvalsh(self.dielectric)[0]
        furthest = 2 * self.decay * np.sqrt(NEGLECTED / least) + norms(k).max()
        most = np.ceil(furthest * norms(cell) / (2 * np.pi))
        waves = np.prod(2.0 * most + 1) * len(positions)
        if not waves <= MOST_WAVES:
            raise InputError(
                f"dielectric: expected at most {MOST_WAVES:g} waves times atoms, got {waves:.2g} "
                f"of {self.dielectric.tolist()} and the decay {self.decay:g}/Å"
            )
        counts = grid_places(2 * most.astype(int) + 1) - most
        G = 2 * np.pi * counts @ inv(cell).T
        zero = self._sums(np.zeros(3), G, cell, positions).sum(axis=2)
        around = G if field else G[counts.any(axis=1)]
        D = np.stack([self._sums(one, around, cell, positions) for one in k])
        atoms = np.arange(len(positions))
        # translations cost nothing; a site of low symmetry leaves a part that is not symmetric
        D[:, atoms, :, atoms, :] -= ((zero + zero.conj().mT) / 2)[:, None]
        return D

    def at_long_waves(self, e: ndarray, cell: ndarray) -> ndarray:
        """Macroscopic field's part of D along unit vectors e [K, 3], shape [K, n, 3, n, 3]."""
        e = checked("e", e, shape=("K", 3))
        pull = np.einsum("kb,nba->kna", e, self.born)
        screened = np.einsum("ki,ij,kj->k", e, self.dielectric, e)
        factor = 4 * np.pi * COULOMB / abs(det(cell)) / screened
        return np.asarray(np.einsum("k,kia,kjb->kiajb", factor, pull, pull))

    def _sums(self, k: ndarray, G: ndarray, cell: ndarray, positions: ndarray) -> Any:
        """Sums of dipole interactions over the waves k + G, [n, 3, n, 3]."""
        K = k + G
        square = np.einsum("gi,ij,gj->g", K, self.dielectric, K)
        kept = (square > 1e-14) & (square < 4 * self.decay**2 * NEGLECTED)
        K, square = K[kept], square[kept]
        factor = np.exp(-square / (4 * self.decay**2)) / square
        factor *= 4 * np.pi * COULOMB / abs(det(cell))
        phase = np.exp(1j * G[kept] @ positions.T)
        pull = np.einsum("gb,nba->gna", K, self.born) * phase[..., None]
        return np.einsum("g,gia,gjb->iajb", factor, pull, pull.conj(), optimize=True)


@typed_methods
@dataclass(frozen=True, eq=False)
class ForceConstants:
    """Force constants Φ between the atoms of one cell and all others, as a list of pairs.

    Attributes:
        cell: edges as rows [Å], shape [3, 3].
        positions: of the atoms of the cell [Å], shape [n, 3].
        species: atomic numbers, shape [n].
        pairs: atoms i and j of the cell, shape [P, 2].
        vectors: from i to an image of j [Å], shape [P, 3].
        values: Φ [eV/Å²], ∂²E/∂u_i ∂u_j, shape [P, 3, 3]; shared among images equally near.
        kinds: numbers that tell atoms apart, of one species too, shape [n].
        thickness: of a sheet in the plane of the first two axes [Å]; None for a solid.
        polar: dipoles of ions, which `values` then are without.
        stress: that the crystal is held under [TPa], shape [d, d]; None for one at rest.
        edge: share of Σ |Φ| r² at half the supercell's width, where none should be.
        change: relative change of Φ between the two steps of finite differences, if known.
        doubt: independent standard errors of `values`, shape [Q, P, 3, 3]; None where unknown.
        spread: the same, with changes by the size of displacements independent for each number
            instead of common; None without changes.
        cut: part of `values` at half the supercell's width, an error of moduli, or None.
    """

    cell: ndarray
    positions: ndarray
    species: ndarray
    pairs: ndarray
    vectors: ndarray
    values: ndarray
    kinds: ndarray
    thickness: float | None = None
    polar: NonAnalyticCorrection | None = None
    stress: ndarray | None = None
    edge: float = 0.0
    change: float | None = None
    doubt: ndarray | None = None
    spread: ndarray | None = None
    cut: ndarray | None = None

    @property
    def dimension(self) -> int:
        """2 for a sheet, 3 for a solid."""
        return 3 if self.thickness is None else 2

    @property
    def volume(self) -> float:
        """Volume of a cell [Å³]; of a sheet its area times the thickness."""
        d = self.dimension
        return float(abs(det(self.cell[:d, :d]))) * (self.thickness or 1.0)

    @property
    def moving(self) -> int:
        """Number of coordinates in which atoms move: 2 for a flat sheet, else 3."""
        return 2 if self.dimension == 2 and np.ptp(self.positions[:, 2]) < FLAT else 3

    def dynamical(self, k: ndarray, moving: int | None = None) -> ndarray:
        """Stiffness matrix D_at(k) [eV/Å²] at k [1/Å], without masses, [K, n m, n m]. m is
        `moving`, by default the property; the mean height of a sheet's cell is held."""
        d, m, n = self.dimension, moving or self.moving, len(self.positions)
        k = checked("k", k, shape=("K", d))
        phase = np.exp(1j * (k @ self.vectors[:, :d].T))
        D = self._by_atoms(phase, self.values[:, :m, :m]).transpose(2, 0, 3, 1, 4)
        if self.polar is not None:
            D = D + self.polar.matrix(k, self.cell, self.positions)
        if m > d:
            D[:, :, 2, :, 2] += HELD * np.abs(self.values).max()
        flat = D.reshape(len(k), n * m, n * m)
        return np.asarray((flat + flat.conj().mT) / 2)

    def stiffness_error(self, k: ndarray, waves: ndarray) -> Any:
        """Standard errors [eV/Å²] of the stiffness of waves [..., n, m] at k [1/Å], or 0."""
        doubt, m = self.doubt if self.spread is None else self.spread, waves.shape[-1]
        if doubt is None:
            return np.zeros(waves.shape[:-2])
        phase = np.exp(1j * (self.vectors[:, : len(k)] @ k))
        off = self._by_atoms(phase[None], np.moveaxis(doubt[..., :m, :m], 0, -1))[:, :, 0]
        ends = np.einsum("...ia,ijabq,...jb->...q", waves.conj(), off, waves, optimize=True)
        return norm(ends.real, axis=-1)

    def effective(self, k: ndarray) -> ndarray:
        """Stiffness D_eff(k) [TPa/Å²] of a cell's mean displacement, all relaxed, [K, d, d] (T14).

        D_eff = [(V/n²) Pᵗ D_at(k)⁻¹ P]⁻¹ at k [1/Å], [K, d]. Raises InputError for unstable waves.
        """
        d, m, n = self.dimension, self.moving, len(self.positions)
        D = self.dynamical(k)
        least = eigvalsh(D)[:, 0]
        if least.min() <= SOFT * np.abs(self.values).max():
            raise InputError(
                f"force constants: expected a stable crystal, got the stiffness {least.min():.2e} "
                f"eV/Å² at k = {np.round(k[least.argmin()], 4).tolist()} 1/Å"
            )
        moved = solve(D, np.tile(np.eye(m, d, dtype=complex), (n, 1)))
        flexible = moved.reshape(len(k), n, m, d)[:, :, :d].mean(axis=1).real * (self.volume / n)
        return symmetric_part(inv(flexible) * EV_IN_TPA)

    def _by_atoms(self, weight: ndarray, phi: ndarray) -> ndarray:
        """Sum weight [K, P] · phi [P, ...] over the pairs of each two atoms, [n, n, K, ...]."""
        n = len(self.positions)
        sums = np.zeros((n, n, len(weight), *phi.shape[1:]), weight.dtype)
        for i, j in np.unique(self.pairs, axis=0):
            some = (self.pairs == (i, j)).all(axis=1)
            sums[i, j] = np.tensordot(weight[:, some], phi[some], 1)
        return sums

    def moments(self, values: ndarray | None = None) -> Several:
        """Moments Σ Φ r⁰ [..., n, 3, n, 3], Σ Φ r¹ [..., n, 3, 3, 3], Σ Φ r² [..., 3, 3, 3, 3].
        Dipoles count but for the macroscopic field; `values` [..., P, 3, 3] replace Φ."""
        r, phi = self.vectors, np.moveaxis(self.values if values is None else values, -3, 0)
        sums = self._by_atoms(np.column_stack([np.ones(len(r)), r]).T, phi)
        zeroth = np.moveaxis(sums[:, :, 0], (0, 1), (-4, -2))
        first = np.moveaxis(sums[:, :, 1:].sum(axis=1), (0, 1), (-4, -1))
        second = np.tensordot(phi, r[:, :, None] * r[:, None], (0, 0))
        if self.polar is not None:
            ions = self._of_ions
            zeroth, first, second = zeroth + ions[0], first + ions[1], second + ions[2]
        return (zeroth + np.moveaxis(zeroth, (-4, -3), (-2, -1))) / 2, first, second

    @cached_property
    def _of_ions(self) -> Several:
        """Moments of the ions' fields, by differences at k = 0."""
        polar: Any = self.polar
        n, signs = len(self.positions), np.array([1.0, -1.0])
        steps = np.einsum("s,cx->scx", signs, np.eye(3)) * SMALL
        k = steps[:, None, :, None] + steps[None, :, None]  # ± along c, ± along d
        D = polar.matrix(k.reshape(-1, 3), self.cell, self.positions, field=False)
        D = D.reshape(2, 2, 3, 3, n, 3, n, 3)
        first = np.einsum("cciajb->iabc", D[0, 0] - D[1, 1]).imag / (4 * SMALL)
        second = np.einsum("s,t,stcdiajb->abcd", signs, signs, D).real / (-4 * SMALL**2)
        return D[0, 1, 0, 0].real, first, second

    def acoustic(self, e: ndarray, values: ndarray | None = None, *, field: bool = True) -> ndarray:
        """Stiffness D_eff(k)/|k|² [TPa] of long waves along unit vectors e, [K, d, d] (T14).
        `values` as for `moments`; without `field` ions make no macroscopic one."""
        d, m, n = self.dimension, self.moving, len(self.positions)
        zeroth, first, second = self.moments(values)
        push = np.einsum("iabc,nc->niab", first[:, :m, :d, :d], e).reshape(len(e), n * m, d)
        A = -0.5 * np.einsum("abcd,nc,nd->nab", second[:d, :d, :d, :d], e, e, optimize=True)
        if n > 1:
            stiff = np.broadcast_to(zeroth, (len(e), *zeroth.shape))
            if self.polar is not None and field:
                stiff = stiff + self.polar.at_long_waves(e, self.cell)
            flat = stiff[:, :, :m, :, :m].reshape(len(e), n * m, n * m)
            A = A - push.mT @ relaxing(flat, m) @ push
        return symmetric_part(A / self.volume * EV_IN_TPA)

    def nearest_elastic(
        self, allowed: ndarray, values: ndarray | None = None, *, field: bool = True
    ) -> tuple[ndarray, float]:
        """Nearest elastic tensor in the span of `allowed`, and the share of waves it misses."""
        e = directions(60, self.dimension)
        wanted = self.acoustic(e, values, field=field)
        if self.stress is not None:
            wanted = wanted - acoustic(elastic.stress_brackets(self.stress), e)
        from_each = np.einsum("mijkl,nj,nl->nikm", allowed, e, e, optimize=True)
        rows = from_each.reshape(-1, len(allowed))
        c = lstsq(rows, wanted.ravel())[0]
        return np.tensordot(c, allowed, 1), relative(rows @ c - wanted.ravel(), wanted)

    def elastic(self, allowed: ndarray) -> ndarray:
        """Elastic tensor [TPa] of long waves, [d, d, d, d], in the span of tensors [m, d, d, d, d].

        Relaxed-ion, without the crystal's own stress. Warns of Φ that has not decayed or depends on
        its step. Raises InputError for long waves of no such tensor, as of piezoelectric crystals.
        """
        doubts, e = self.doubts(), directions(60, self.dimension)
        C, off = self.nearest_elastic(allowed)
        waves = self.effective(LONG * e) / LONG**2
        off += relative(waves - self.acoustic(e), waves)
        if off > NOT_ELASTIC:
            without = self.nearest_elastic(allowed, field=False)[1]
            if self.polar is not None and without <= NOT_ELASTIC:
                doubts.insert(0, "a piezoelectric crystal: it is one but for its ions' field")
            why = "; ".join(doubts) or (
                "a piezoelectric crystal's non-analytic term, a stress that it is held under, or "
                "another symmetry may be why"
            )
            raise InputError(
                f"force constants: long waves are {off:.1%} off those of every elastic solid of "
                f"this symmetry; {why}"
            )
        for doubt in doubts:
            warn(f"force constants: {doubt}")
        return C

    def elastic_doubt(self, allowed: ndarray, *, bent: bool = False) -> ndarray:
        """Independent standard errors of the elastic tensor [TPa], shape [Q, d, d, d, d]. With
        `bent` [2 Q, ...]: those even in the errors of Φ behind those odd in them."""
        given = [*(() if self.doubt is None else self.doubt)]
        given += [] if self.cut is None else [self.cut]
        near = partial(self.nearest_elastic, allowed)
        ends = [[near(self.values + sign * one)[0] for sign in (1, -1)] for one in given]
        middle = near()[0]
        found = [(a - b) / 2 for a, b in ends]
        found += [(a + b) / 2 - middle for a, b in ends] if bent else []
        return np.array(found).reshape(-1, *middle.shape)

    def doubts(self) -> list[str]:
        """Reasons why the elastic moduli of these force constants are not to be trusted."""
        said = []
        if self.change is not None and self.change > KINKED:
            said.append(
                f"they change by {self.change:.1%} of the largest between steps of {STEP:g} and "
                f"{WIDER * STEP:g} Å: the potential has kinks or is anharmonic, and no one modulus"
            )
        if self.edge > CUT:
            said.append(
                f"{self.edge:.0%} of what moduli are made of, Σ |Φ| r², is at half the supercell's "
                "width, where it should have decayed: moduli may be as much off; a wider one is due"
            )
        return said

    def group(self) -> ndarray:
        """Point group of the crystal by spglib, [G, d, d], in the axes of its coordinates."""
        turns = elastic.group_of_structure(self.cell, self.positions @ inv(self.cell), self.kinds)
        if self.dimension == 3:
            return turns
        return point_group(turns[np.abs(np.abs(turns[:, 2, 2]) - 1) < 1e-6][:, :2, :2], 2)


def relaxing(stiff: ndarray, moving: int) -> ndarray:
    """Response of atoms to forces that sum to zero: Σ Φ [..., n m, n m] inverted on these."""
    n = stiff.shape[-1] // moving
    whole = np.kron(np.ones((n, n)) / n, np.eye(moving))
    size = np.abs(stiff).max() or 1.0
    return inv(stiff + size * whole) - whole / size


class Supercell:
    """Supercell of a crystal, and `pairs` of the cell's atoms with the nearest images of all.

    `cell` and the supercell `many` are ase.Atoms; moments, charges and tags tell atoms apart.
    `displaced` are the numbers in the supercell of the cell's atoms, in turn, length n; other
    arguments are of ForceConstants.
    """

    def __init__(
        self,
        cell: Any,
        many: Any,
        displaced: Sequence[int],
        *,
        thickness: float | None = None,
        polar: NonAnalyticCorrection | None = None,
        stress: ndarray | None = None,
    ) -> None:
        edges, box, x, X = map(np.array, (cell.cell, many.cell, cell.positions, many.positions))
        self.displaced, self.box = list(displaced), box
        self.apart = X - X[self.displaced][:, None]
        to_site = self.apart @ inv(edges)
        off = np.abs(to_site - np.rint(to_site)).max(axis=2)
        if off.min(axis=0).max() > ON_SITE:
            raise InputError("supercell: expected atoms on the sites of the structure")
        self.site = off.argmin(axis=0)
        if polar is not None:
            if len(polar.born) != len(x):
                raise InputError(f"born: expected {len(x)} charges, got {len(polar.born)}")
            if thickness is not None:
                raise InputError("BORN: expected a solid; the field of a sheet's ions is another")
            most = eigvalsh(polar.dielectric)[-1] ** 0.5
            decay = polar.decay or 2 * DECAYED * most / norms(box).min()
            polar = replace(polar, decay=decay)
        fraction = self.apart @ inv(box)
        shifts = grid_places((3, 3, 3)) - 1
        near = ((fraction - np.rint(fraction))[:, :, None] + shifts) @ box
        far = norm(near, axis=3)
        tie = far <= far.min(axis=2, keepdims=True) + NEAREST * norm(edges[0])
        i, j, image = np.nonzero(tie)
        share = 1 / tie.sum(axis=2)
        self.entries, self.share = (i, j), share[i, j][:, None, None]
        pairs, none = np.stack([i, self.site[j]], axis=1), np.zeros((len(i), 3, 3))
        of = edges, x, np.array(cell.numbers), pairs, near[i, j, image], none, kinds_of(cell)[0]
        self.pairs = ForceConstants(*of, thickness, polar, stress)
        widths = 1 / norm(inv(box), axis=0)[: 3 if thickness is None else 2]
        self.at_edge = far[i, j, image] > EDGE * widths.min()

    def values(self, phi: ndarray) -> ndarray:
        """Values of Φ [..., n, N, 3, 3] by pair, shape [..., P, 3, 3]."""
        return np.asarray(phi[..., *self.entries, :, :] * self.share)

    def short_ranged(self, phi: ndarray) -> ndarray:
        """Subtract the ions' dipole part from Φ [n, N, 3, 3]; InputError for another shape."""
        shape = len(self.displaced), len(self.site), 3, 3
        if phi.shape != shape:
            raise InputError(f"phi: expected shape {list(shape)}, got {list(phi.shape)}")
        return phi if self.pairs.polar is None else phi - self.field_of_ions()

    def field_of_ions(self) -> ndarray:
        """Dipole part of Φ, [n, N, 3, 3]: the mean of waves that fit the supercell."""
        polar: Any = self.pairs.polar
        cell, x = self.pairs.cell, self.pairs.positions
        multiples = np.rint(self.box @ inv(cell)).astype(int)
        whole = make_supercell(Atoms("X", cell=np.eye(3)), multiples.T)
        parts = np.round(whole.get_scaled_positions(), 9) % 1.0
        k = 2 * np.pi * (parts - (parts > 0.5)) @ inv(cell).T
        D = polar.matrix(k, cell, x)
        phase = np.exp(-1j * np.einsum("kc,nNc->knN", k, self.apart)) / len(k)
        phi = np.empty((*self.apart.shape, 3))
        for j in range(len(x)):
            some = self.site == j
            phi[:, some] = np.einsum("kiN,kiab->iNab", phase[:, :, some], D[:, :, :, j]).real
        return phi

    def balanced(self, phi: ndarray) -> ndarray:
        """Correct Φ of each atom with itself so that its sums are zero (translations)."""
        phi = phi.copy()
        for row, atom in zip(phi, self.displaced):
            row[atom] -= row.sum(axis=0)
            row[atom] = symmetric_part(row[atom])
        return phi

    def edge(self, values: ndarray) -> float:
        """Share of Σ |Φ| r² at half the supercell's width, of a sheet in its plane."""
        moment = np.abs(values).max(axis=(1, 2)) * norms(self.pairs.vectors) ** 2
        return float(moment[self.at_edge].sum() / max(moment.sum(), TINY))


def from_supercell(
    cell: Any, many: Any, phi: ndarray, displaced: Sequence[int], **how: Any
) -> ForceConstants:
    """Force constants of a cell from Φ [eV/Å²] of a Supercell of these arguments, [n, N, 3, 3]."""
    every = Supercell(cell, many, displaced, **how)
    phi = every.short_ranged(phi)
    size = np.abs(phi).max(axis=(2, 3), keepdims=True)
    if not size.max() > 0:
        raise InputError(f"phi: expected forces between atoms, got none in {len(many)} atoms")
    phi = every.balanced(np.where(size > NEGLIGIBLE * size.max(), phi, 0.0))
    values, made = every.values(phi), every.pairs
    kept = values.any(axis=(1, 2))
    some: Any = {"pairs": made.pairs[kept], "vectors": made.vectors[kept], "values": values[kept]}
    return replace(made, **some, edge=every.edge(values))


def forces_of(many: Any, calculator: Any) -> ArrayMap:
    """Make a function from positions [Å] to a calculator's forces [eV/Å] on these atoms."""
    many = many.copy()
    many.calc = calculator

    def forces(x: ndarray) -> ndarray:
        many.positions[:] = x
        return np.array(many.get_forces(apply_constraint=False))

    return forces
