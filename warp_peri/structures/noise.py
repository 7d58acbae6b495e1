"""Force constants and elastic constants, each with its error, of a calculator that is noisy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import ase
import numpy as np
import scipy.sparse as sp
from ase.stress import voigt_6_to_full_3x3_stress

from warp_peri.core.elastic import PAIRS, stress_brackets, voigt
from warp_peri.core.groups import by_spglib, kinds_of
from warp_peri.errors import InputError
from warp_peri.micromodulus.force_constants import (
    NEAREST,
    TINY,
    ForceConstants,
    Polar,
    field_of_ions,
    from_supercell,
    nearest,
    relaxing,
)
from warp_peri.points.unit_names import STRESSES

EV_IN_TPA = STRESSES["eV/angstrom^3"]
ON_SITES = 1e-4
"""Distance [Å] within which atoms are on their sites."""
SHAKEN, COPIES, ENOUGH = 0.01, 3, 8
"""Displacement [Å] of the atoms that noise is looked at on, copies of each, and how many atoms."""
EXACT = 1e-7
"""Noise over the force that a displacement of SHAKEN makes, below which it is rounding."""
BENT = 0.56
"""Length [Å] whose square divides third differences of the force by first ones, in most solids."""
LEAST, MOST = 0.003, 0.03
"""Displacements [Å] that noise may ask for."""
PULLED = (0.3, 0.6, 1.0)
"""Sizes of strains over the largest, which is LARGEST where noise asks for a displacement MOST."""
LARGEST = 0.01
TIMES = 3
"""Pairs of displaced crystals; numbers asked of each unknown; standard errors that are told."""
AWAY = 30.0
"""Noise over the stiffness, of the distance from sites that it may leave an atom at."""
NONE = 1e-8
"""Of singular values of the rules: an equation that holds by symmetry."""


@dataclass(frozen=True)
class Noise:
    """What a calculator's forces scatter by.

    Attributes:
        force: standard error of a component [eV/Å].
        stress: of a component [TPa], on the cell at rest; zero where there is none.
        stiffness: root mean square force over the displacement that made it [eV/Å²].
    """

    force: float
    stress: float
    stiffness: float

    @property
    def rounding(self) -> bool:
        """Whether it is too small to matter."""
        return self.force <= EXACT * SHAKEN * self.stiffness

    @property
    def length(self) -> float:
        """Displacement [Å] at which noise and the force's third differences are the same."""
        wanted = (BENT**2 * self.force / max(self.stiffness, TINY)) ** (1 / 3)
        return float(np.clip(wanted, LEAST, MOST))

    @property
    def sites(self) -> float:
        """Distance [Å] from sites that noise may leave an atom at."""
        return max(ON_SITES, AWAY * self.force / max(self.stiffness, TINY))

    @property
    def strain(self) -> float:
        """Largest strain, by the same rule; sums of long range are rough on smaller ones."""
        return LARGEST * max(self.length / MOST, PULLED[0])


def measured(cell: ase.Atoms, calculator: Any, flat: bool) -> Noise:
    """Noise of forces and stress: of one displaced crystal, translated and turned about z.

    Args:
        cell: the crystal.
        calculator: with forces.
        flat: whether it is a sheet across z.
    """
    rng = np.random.default_rng(0)
    counts = np.ones(3, dtype=int)
    while counts.prod() * len(cell) < ENOUGH:
        wide = np.linalg.norm(np.array(cell.cell), axis=1) * counts
        counts[wide[: 2 if flat else 3].argmin()] += 1
    many = cell.repeat(tuple(counts.tolist()))
    u = _directions(rng, len(many), SHAKEN)
    found, pulled = [], []
    for sign in (1, -1):
        forces, stresses = [], []
        for number in range(COPIES):
            angle = 40.0 * number * (number < COPIES - 1)
            one = many.copy()
            one.positions += sign * u + rng.uniform(0, 3, 3) * [1, 1, not flat] * (number > 0)
            one.rotate(angle, "z", rotate_cell=True)
            one.calc = calculator
            try:
                force = np.array(one.get_forces(apply_constraint=False))
            except Exception:  # a calculator may go by axes of its own
                if not angle:
                    raise
                continue
            c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
            back = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
            forces.append(force @ back.T)
            try:
                full = voigt_6_to_full_3x3_stress(one.get_stress(apply_constraint=False))
                stresses.append(back @ full @ back.T)
            except Exception:  # without stress
                continue
        found.append(np.array(forces))
        pulled.append(np.array(stresses))
    spread = [np.sqrt(np.mean(np.var(one, axis=0, ddof=1))) for one in found]
    push = (found[0].mean(axis=0) - found[1].mean(axis=0)) / 2
    tight = 0.0
    if all(len(one) > 1 for one in pulled):
        var = np.mean([np.mean(np.var(one, axis=0, ddof=1)) for one in pulled])
        tight = float(np.sqrt(var * len(many) / len(cell))) * EV_IN_TPA
    size = float(np.sqrt(np.mean(push**2) / np.mean(u**2)))
    return Noise(float(np.hypot(*spread) / np.sqrt(2)), tight, size)


def _directions(rng: np.random.Generator, count: int, size: float) -> np.ndarray:
    u = rng.standard_normal((count, 3))
    return np.asarray(size * u / np.linalg.norm(u, axis=1, keepdims=True))


class Orbits:
    """Numbers that force constants on a supercell have under its space group and exchange.

    Args:
        cell: the crystal's cell, an ase.Atoms.
        supercell: of it, an ase.Atoms with its atoms on sites.

    `basis` is the orthonormal basis of Φ, sparse, of rows (i, j, image, 3, 3) and a column for each
    number.
    """

    def __init__(self, cell: ase.Atoms, supercell: ase.Atoms) -> None:
        self.cell, self.supercell = cell, supercell
        edges, self.box = np.array(cell.cell), np.array(supercell.cell)
        self.edges, self.x, self.n = edges, np.array(cell.positions), len(cell)
        whole = np.rint(self.box @ np.linalg.inv(edges))
        self.size = round(abs(np.linalg.det(whole)))
        self.adjoint = np.rint(np.linalg.inv(whole) * self.size).astype(int)
        parts = (np.array(supercell.positions)[:, None] - self.x) @ np.linalg.inv(edges)
        self.kind = np.abs(parts - np.rint(parts)).max(axis=2).argmin(axis=1)
        t = np.rint(parts[np.arange(len(parts)), self.kind]).astype(int)
        self.codes, first = np.unique(self._code(t), return_index=True)
        self.shifts = t[first]
        if len(self.codes) != self.size or len(supercell) != self.size * self.n:
            raise InputError("supercell: expected each site of the structure in it once")
        self.image = self.number(t)
        self.place = np.empty((self.n, self.size), int)
        self.place[self.kind, self.image] = np.arange(len(t))
        self.basis = self._basis(whole)

    def _code(self, t: np.ndarray) -> np.ndarray:
        part = (t @ self.adjoint) % self.size
        return np.asarray(part @ np.array([self.size**2, self.size, 1]))

    def number(self, t: np.ndarray) -> np.ndarray:
        """Number of the cell of a supercell that a shift by whole edges leads to."""
        return np.searchsorted(self.codes, self._code(t))

    def turns(self, whole: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, ...]]:
        """Of the space group, kept by a supercell if given: W, R, images of atoms, their shifts."""
        parts, kinds = self.cell.get_scaled_positions(wrap=False), kinds_of(self.cell)[0]
        found = by_spglib("get_symmetry", (self.edges, parts, kinds), ON_SITES)
        if found is None:
            raise InputError("symmetry: spglib finds none of this structure")
        for W, w in zip(found["rotations"], found["translations"]):
            if whole is not None:
                kept = whole @ W.T @ np.linalg.inv(whole)
                if np.abs(kept - np.rint(kept)).max() > 1e-6:
                    continue
            to = (parts @ W.T + w)[:, None] - parts
            off = np.linalg.norm((to - np.rint(to)) @ self.edges, axis=2)
            image = np.where(kinds[:, None] == kinds, off, np.inf).argmin(axis=1)
            shift = np.rint(to[np.arange(self.n), image]).astype(int)
            yield W, self.edges.T @ W @ np.linalg.inv(self.edges.T), image, shift

    def _basis(self, whole: np.ndarray) -> sp.csr_array:
        n, size = self.n, self.size
        i, j, c = (a.ravel() for a in np.indices((n, n, size)))
        t = self.shifts[c]
        exchanged = (j * n + i) * size + self.number(-t)
        swap = np.eye(9).reshape(3, 3, 9).swapaxes(0, 1).reshape(9, 9)
        to, how = [], []
        for W, R, image, shift in self.turns(whole):
            there = self.number(t @ W.T + shift[j] - shift[i])
            moved = (image[i] * n + image[j]) * size + there
            to += [moved, exchanged[moved]]
            how += [np.kron(R, R), swap @ np.kron(R, R)]
        maps, turned = np.array(to), np.array(how)
        done = np.zeros(len(i), bool)
        rows, columns, values, count = [], [], [], 0
        for pair in range(len(i)):
            if done[pair]:
                continue
            images, first = np.unique(maps[:, pair], return_index=True)
            done[images] = True
            kept, U = np.linalg.eigh(turned[maps[:, pair] == pair].mean(axis=0))
            U = U[:, kept > 1 - 1e-6]
            block = turned[first] @ U / np.sqrt(len(images))
            at = images[:, None, None] * 9 + np.arange(9)[:, None]
            rows.append(np.broadcast_to(at, block.shape).ravel())
            column = count + np.arange(U.shape[1])
            columns.append(np.broadcast_to(column, block.shape).ravel())
            values.append(block.ravel())
            count += U.shape[1]
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_array(entries, shape=(9 * len(i), count))

    @cached_property
    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """Vectors between pairs, to each of equally near images, and the numbers of the pairs."""
        i, j, c = (a.ravel() for a in np.indices((self.n, self.n, self.size)))
        apart = self.x[j] - self.x[i] + self.shifts[c] @ self.edges
        return nearest(apart, self.box, NEAREST * float(np.linalg.norm(self.edges[0])))

    def pairs_of(self, atoms: ForceConstants) -> np.ndarray:
        """Numbers of the pairs, here, of all entries of force constants."""
        i, j = atoms.pairs.T
        t = (atoms.vectors - (self.x[j] - self.x[i])) @ np.linalg.inv(self.edges)
        return np.asarray((i * self.n + j) * self.size + self.number(np.rint(t).astype(int)))

    def rows(self, u: np.ndarray) -> np.ndarray:
        """Forces −Φ u on all atoms for each number, u [N, 3], shape [N, 3, numbers]."""
        n, size, count = self.n, self.size, self.basis.shape[1]
        B = self.basis.tocoo()
        i, j, c, a, b = np.unravel_index(B.row, (n, n, size, 3, 3))
        row = np.ravel_multi_index((i, a, B.col), (n, 3, count))
        column = np.ravel_multi_index((j, c, b), (n, size, 3))
        spread = sp.csr_array((B.data, (row, column)), shape=(n * 3 * count, n * size * 3))
        near = self.number(self.shifts[:, None] + self.shifts)  # [cell, shift]
        moved = u[self.place[:, near]]  # [j, cell, shift, 3]
        pulled = spread @ moved.transpose(0, 2, 3, 1).reshape(-1, size)
        forces = np.empty((len(self.kind), 3, count))
        forces[self.place] = -pulled.reshape(n, 3, count, size).transpose(0, 3, 1, 2)
        return forces

    def pull_of(self, phi: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The same of known Φ [n, 3, N, 3] of the atoms of a cell, [N, 3]."""
        near = self.number(self.shifts[:, None] + self.shifts)
        forces = np.empty((len(self.kind), 3))
        for cell in range(self.size):
            v = u[self.place[self.kind, near[cell, self.image]]]
            forces[self.place[:, cell]] = -np.einsum("iaNb,Nb->ia", phi, v)
        return forces

    def rules(self, atoms: ForceConstants) -> tuple[np.ndarray, np.ndarray]:
        """Equations that the numbers keep, rows [E, numbers] and right sides [E].

        Translations, turns of the crystal (M. Born, K. Huang, 1954) and the stress it is under
        (Huang's relations). `atoms` says what ions' fields and a stress add.
        """
        vectors, pair = self.images
        share = 1 / np.bincount(pair)[pair]
        furthest = float(np.linalg.norm(vectors, axis=1).max())
        n, size, count = self.n, self.size, self.basis.shape[1]
        r = vectors / furthest
        powers = [np.ones(len(r)), *r.T, *(r[:, a] * r[:, b] for a in range(3) for b in range(3))]
        sums = []
        for power in powers:
            mean = np.bincount(pair, share * power, n * n * size)
            scaled = sp.diags_array(np.repeat(mean, 9)) @ self.basis
            whole = sp.kron(np.eye(n), sp.kron(np.ones((1, n * size)), np.eye(9)))
            sums.append((whole @ scaled).toarray().reshape(n, 3, 3, count))
        zeroth, first, second = sums[0], np.array(sums[1:4]), np.array(sums[4:]).sum(axis=1)
        ions: tuple[np.ndarray, ...] = tuple(
            np.zeros(s) for s in ((n, 3, n, 3), (n, 3, 3, 3), (3, 3, 3, 3))
        )
        if atoms.polar is not None:
            ions = atoms.moments(0 * atoms.values)
        held = np.zeros((3, 3))
        if atoms.stress is not None:
            d = len(atoms.stress)
            held[:d, :d] = atoms.stress / EV_IN_TPA
        volume = -2 * abs(np.linalg.det(self.edges))
        if atoms.thickness is not None:
            volume = -2 * atoms.volume
        known = (ions[2] - volume * stress_brackets(held)) / furthest**2
        bare = first.transpose(1, 2, 3, 0, 4)  # [i, a, b, r, number]
        turned = ions[1] / furthest
        square = second.reshape(3, 3, 3, 3, count).transpose(2, 3, 0, 1, 4)
        equations = [
            zeroth.reshape(-1, count),
            (bare - bare.swapaxes(2, 3)).reshape(-1, count),
            (square - square.transpose(2, 3, 0, 1, 4)).reshape(-1, count),
        ]
        right = [
            -ions[0].sum(axis=2).ravel(),
            -(turned - turned.swapaxes(2, 3)).ravel(),
            -(known - known.transpose(2, 3, 0, 1)).ravel(),
        ]
        return np.concatenate(equations), np.concatenate(right)


def _solved(A: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A⁺ and the null space of the rules, whose size is that of translations."""
    U, size, rows = np.linalg.svd(A, full_matrices=True)
    rank = int((size > NONE).sum())
    return rows[:rank].T @ ((U[:, :rank].T @ y) / size[:rank]), rows[rank:].T


def projected(atoms: ForceConstants, supercell: ase.Atoms) -> ForceConstants:
    """The nearest force constants that keep what physics asks, their change as standard error.

    Args:
        atoms: force constants.
        supercell: that they were made on.
    """
    cell = ase.Atoms(atoms.species, positions=atoms.positions, cell=atoms.cell, pbc=True)
    if atoms.kinds is not None:
        cell.set_tags(atoms.kinds)
    orbits = Orbits(cell, supercell)
    pair = orbits.pairs_of(atoms)
    phi = np.zeros((orbits.n**2 * orbits.size, 9))
    np.add.at(phi, pair, atoms.values.reshape(-1, 9))
    numbers = orbits.basis.T @ phi.ravel()
    A, right = orbits.rules(atoms)
    numbers = numbers + _solved(A, right - A @ numbers)[0]
    share = 1 / np.bincount(pair)[pair]
    values = (orbits.basis @ numbers).reshape(-1, 3, 3)[pair] * share[:, None, None]
    return replace(atoms, values=values, doubt=(values - atoms.values)[None])


def rattled(
    cell: ase.Atoms,
    many: ase.Atoms,
    calculator: Any,
    noise: Noise,
    *,
    thickness: float | None,
    polar: Polar | None,
    stress: np.ndarray | None,
) -> tuple[ForceConstants, dict[str, str]]:
    """Force constants with their standard errors of crystals whose atoms all are displaced.

    Args:
        cell, many: the crystal at rest and its supercell.
        calculator: with forces.
        noise: which says how far atoms are displaced.
        thickness, polar, stress: as for `from_supercell`.

    Returns what was found on the way as well. The rules of physics hold in the fit itself. Beside
    displacements of one size some of half of it are asked: what forces change by is an error too.
    """
    orbits, rng, h = Orbits(cell, many), np.random.default_rng(1), noise.length
    first = orbits.place[:, orbits.number(np.zeros((1, 3), int))[0]].tolist()
    shape = (orbits.n, 3, len(many), 3)
    field = np.zeros(shape)
    if polar is not None:
        polar, field = field_of_ions(polar, cell, many, first)
    zero = np.zeros(shape)
    zero[0, 0, 0, 0] = 1.0  # any: rules ask for ions' fields and stress alone
    rules, right = orbits.rules(
        replace(
            from_supercell(cell, many, zero, first, thickness=thickness, stress=stress), polar=polar
        )
    )
    known, free = _solved(rules, right)
    pairs = max(TIMES, int(np.ceil(TIMES * free.shape[1] / (3 * len(many)))))
    x, rows, forces = np.array(many.positions), [], []
    moving = many.copy()
    moving.calc = calculator
    for size in [h] * pairs + [h / 2]:
        u = _directions(rng, len(many), size)
        ends = []
        for sign in (1, -1):
            moving.positions[:] = x + sign * u
            ends.append(np.array(moving.get_forces(apply_constraint=False)))
        force = (ends[0] - ends[1]) / 2
        if polar is not None:
            force = force - orbits.pull_of(field, u)
        row = orbits.rows(u).reshape(-1, orbits.basis.shape[1])
        rows.append(row @ free)
        forces.append(force.ravel() - row @ known)
    X, y = np.concatenate(rows[:-1]), np.concatenate(forces[:-1])
    U, sizes, V = np.linalg.svd(X, full_matrices=False)
    kept = sizes > NONE * sizes[0]
    way = V[kept].T / sizes[kept]
    z = way @ (U.T[kept] @ y)
    error = float(np.linalg.norm(y - X @ z) / np.sqrt(max(len(y) - kept.sum(), 1)))
    half = rows[-1] @ z
    slope = float(half @ forces[-1] / (half @ half)) - 1
    bent = slope if abs(slope) > TIMES * error / float(np.linalg.norm(half)) else 0.0
    numbers = np.column_stack([known + free @ z, free @ way * error, bent * (free @ z)])
    phi = (orbits.basis @ numbers).T.reshape(-1, orbits.n, orbits.n, orbits.size, 3, 3)
    given = np.empty((len(phi), *shape))
    given[:, :, :, orbits.place] = phi.transpose(0, 1, 4, 2, 3, 5)
    made = from_supercell(cell, many, given[0], first, thickness=thickness, stress=stress)
    pair = orbits.pairs_of(made)
    share = (1 / np.bincount(pair)[pair])[:, None, None]
    doubt = phi[1:].reshape(len(phi) - 1, -1, 3, 3)[:, pair] * share
    said = {
        "noise": f"{noise.force:.1e} eV/Å; {error:.1e} eV/Å between forces and force constants",
        "displacements": f"{h:.3g} Å of all atoms, {pairs} pairs; at half of it forces are "
        f"{slope:+.1%} of linear ones",
    }
    return replace(made, polar=polar, doubt=doubt), said


def by_strains(
    cell: ase.Atoms, calculator: Any, noise: Noise, atoms: ForceConstants, allowed: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """C_ijkl [TPa] by finite strains, atoms relaxed by force constants, and standard errors.

    Args:
        cell: at rest.
        calculator: with forces and stress; None is returned where it has none.
        noise: which says how large strains are.
        atoms: force constants.
        allowed: elastic tensors of the symmetry, shape [m, d, d, d, d].

    Returns [d, d, d, d] and [Q, d, d, d, d].
    """
    d, flat = atoms.dimension, atoms.thickness is not None
    kinds = PAIRS[d]
    e = noise.strain * np.array(PULLED)
    S = np.zeros((2, len(kinds), len(e), d, d))
    F = np.zeros((2, len(kinds), len(e), len(cell), 3))
    counts = (2, 2, 1) if flat else (2, 2, 2)
    many = cell.repeat(counts)
    for kind, (i, j) in enumerate(kinds):
        for row, size in enumerate(e):
            for side, sign in enumerate((1, -1)):
                G = np.eye(3)
                G[i, j] += sign * size / 2
                G[j, i] += sign * size / 2
                one = many.copy()
                one.set_cell(np.array(many.cell) @ G, scale_atoms=True)
                one.calc = calculator
                try:
                    sigma = voigt_6_to_full_3x3_stress(one.get_stress(apply_constraint=False))
                except NotImplementedError:
                    return None
                if flat:
                    sigma = sigma * (cell.cell[2, 2] / atoms.thickness)
                inside = np.linalg.inv(G[:d, :d])
                S[side, kind, row] = (
                    np.linalg.det(G[:d, :d]) * inside @ sigma[:d, :d] @ inside.T * EV_IN_TPA
                )
                force = np.array(one.get_forces(apply_constraint=False))
                F[side, kind, row] = force.reshape(-1, len(cell), 3).mean(axis=0)
    odd, even = (S[0] - S[1]) / 2, (S[0] + S[1]) / 2
    C, errors = _fitted(allowed, odd, e)
    short, unsure = _fitted(allowed, odd[:, :2], e[:2])
    # a stress that is left strains the crystal; how stiffness goes with strain is in even parts
    basis = np.column_stack([np.ones(len(e)), e**2])
    fitted = np.linalg.lstsq(basis, even.swapaxes(0, 1).reshape(len(e), -1))[0]
    rest = fitted[0].reshape(len(kinds), -1).mean(axis=0)
    if atoms.stress is not None:
        rest = rest - atoms.stress.ravel()
    left = np.linalg.solve(voigt(C), [rest.reshape(d, d)[pair] for pair in kinds])
    spread = [2 * np.abs(fitted[1]).max() / np.abs(C).max() * np.abs(left).max() * C]
    if np.linalg.norm(C - short) > TIMES * np.linalg.norm(unsure):
        spread.append(C - short)
    if len(cell) > 1:
        push, tau = _slopes(F, e)
        Lambda = np.zeros((len(cell), 3, d, d))
        for kind, (i, j) in enumerate(kinds):
            Lambda[..., i, j] = Lambda[..., j, i] = push[kind]
        given, noise_of = _relaxed(atoms, Lambda, tau, allowed)
        C = C - given
        errors = np.concatenate([errors, noise_of])
        for one in atoms.doubt if atoms.doubt is not None else ():
            stiffer = atoms.values + one
            spread.append(given - _relaxed(atoms, Lambda, tau, allowed, stiffer)[0])
    return C, np.concatenate([errors, np.array(spread)])


def _fitted(allowed: np.ndarray, odd: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """C of the symmetry by the odd parts of stresses, C e + D e³, and its errors."""
    d = allowed.shape[1]
    kinds = PAIRS[d]
    unit = np.zeros((len(kinds), d, d))
    for kind, (i, j) in enumerate(kinds):
        unit[kind, i, j] += 0.5
        unit[kind, j, i] += 0.5
    lead = np.einsum("mabcd,kcd->mkab", allowed, unit)
    pick = tuple(np.array(kinds).T)
    first = (lead[:, :, None] * e[:, None, None])[(..., *pick)].reshape(len(allowed), -1)
    third = np.kron(np.eye(len(kinds)), np.kron((e**3)[:, None], np.eye(len(kinds))))
    third = third / e.max() ** 2
    X, y = np.column_stack([first.T, third]), odd[(..., *pick)].ravel()
    c = np.linalg.lstsq(X, y)[0]
    free = max(len(y) - np.linalg.matrix_rank(X), 1)
    left = float(np.linalg.norm(y - X @ c) / np.sqrt(free))
    root = np.linalg.pinv(X)[: len(allowed)]
    U, sizes, _ = np.linalg.svd(root, full_matrices=False)
    errors = np.tensordot((U * sizes * left).T, allowed, 1)
    return np.tensordot(c[: len(allowed)], allowed, 1), errors


def _slopes(F: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, float]:
    """Forces on the atoms of a cell for a strain of each kind, [kinds, n, 3], and their error."""
    y = (F[0] - F[1]).swapaxes(0, 1).reshape(len(e), -1) / 2
    X = np.column_stack([e, e**3 / e.max() ** 2])
    c = np.linalg.lstsq(X, y)[0]
    left = np.linalg.norm(y - X @ c) / np.sqrt(y.shape[1] * (len(e) - 2))
    return c[0].reshape(F.shape[1], *F.shape[3:]), float(
        left * np.linalg.norm(np.linalg.pinv(X)[0])
    )


def _relaxed(
    atoms: ForceConstants,
    push: np.ndarray,
    error: float,
    allowed: np.ndarray,
    values: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What atoms that relax take off C [TPa], of the symmetry, and its standard errors.

    push: forces on atoms for a strain [eV/Å], shape [n, 3, d, d]; error: of one of its components.
    """
    n, d, m = len(push), atoms.dimension, atoms.moving
    push = (push - push.mean(axis=0))[:, :m].reshape(n * m, d, d)
    stiff = atoms.moments(values)[0][:, :m, :, :m].reshape(n * m, n * m)
    moved = np.tensordot(relaxing(stiff, m), push, 1)
    size = EV_IN_TPA / atoms.volume
    taken = np.einsum("Iab,Icd->abcd", push, moved) * size
    flat = allowed.reshape(len(allowed), -1)
    onto = np.linalg.pinv(flat).T  # of a tensor to its share of each
    each = np.einsum("mabcd,Icd->mIab", onto.reshape(allowed.shape), moved)
    rows = 2 * size * error * each.reshape(len(allowed), -1)
    U, sizes, _ = np.linalg.svd(rows, full_matrices=False)
    return np.tensordot(onto @ taken.ravel(), allowed, 1), np.tensordot((U * sizes).T, allowed, 1)


def joined(
    atoms: ForceConstants, allowed: np.ndarray, C: np.ndarray, errors: np.ndarray
) -> tuple[ForceConstants, float, float]:
    """Force constants moved by their own errors until their moduli agree with others (R. Kalman).

    Args:
        atoms: force constants with `doubt`.
        allowed: elastic tensors of the symmetry, shape [m, d, d, d, d].
        C, errors: of finite strains, as `by_strains` gives them.

    Returns them, χ² between both for each modulus, and how far Φ moved. Errors of force constants
    are widened by √χ² above one, for what they know nothing of: a supercell that forces leave.
    """
    flat = allowed.reshape(len(allowed), -1)
    onto = np.linalg.pinv(flat).T

    def seen(values: np.ndarray) -> np.ndarray:
        return np.asarray(onto @ atoms.nearest_elastic(allowed, values)[0].ravel())

    J = onto @ atoms.elastic_doubt(allowed).reshape(-1, flat.shape[1]).T
    other, spread = onto @ C.ravel(), onto @ errors.reshape(len(errors), -1).T
    off = other - seen(atoms.values)
    chi = float(off @ np.linalg.pinv(J @ J.T + spread @ spread.T) @ off) / len(allowed)
    doubt: np.ndarray = np.asarray(atoms.doubt) * max(1.0, chi**0.5)
    J = J * max(1.0, chi**0.5)
    S = J @ J.T + spread @ spread.T
    gain = J.T @ np.linalg.pinv(S)
    values, before, step = atoms.values, atoms.values, np.zeros(len(doubt))
    for _ in range(3):  # moduli bend a little in Φ where atoms of a cell relax
        step = gain @ (other - seen(values) + J @ step)
        values = before + np.tensordot(step, doubt, 1)
    parts, vectors = np.linalg.eigh(np.eye(len(doubt)) - gain @ J)
    root = vectors * np.sqrt(np.clip(parts, 0, None))
    after = np.tensordot(root.T, doubt, 1)
    moved = float(np.linalg.norm(values - before) / np.linalg.norm(before))
    return replace(atoms, values=values, doubt=after), chi, moved
