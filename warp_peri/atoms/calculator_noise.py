"""Force constants and elastic constants, with standard errors, of a calculator that is noisy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import ase
import numpy as np
from numpy import ndarray
from numpy.linalg import det, eigh, inv, lstsq, norm, pinv, solve, svd
from scipy.spatial.transform import Rotation

from warp_peri.atoms.force_constants import TINY, ForceConstants, Supercell, forces_of, relaxing
from warp_peri.core.elastic import PAIRS, stress_brackets, symmetric_part, voigt
from warp_peri.errors import optional
from warp_peri.fitting.regression import norms, particular, relative
from warp_peri.points.arguments import EV_IN_TPA, Pair

ON_SITES = 1e-4
"""Distance [Å] within which atoms are on their sites."""
SHAKEN, ANGLES, ENOUGH = 0.01, (0.0, 0.0, 25.0, 40.0), 8
"""Displacement [Å] of the atoms that noise is looked at on, turns of the copies, how many atoms."""
EXACT = 1e-7
"""Noise over the force that a displacement of SHAKEN makes, below which it is rounding."""
BENT = 0.56
"""Length [Å] whose square divides third differences of the force by first ones, in most solids."""
LEAST, MOST = 0.003, 0.03
"""Displacements [Å] that noise may ask for."""
PULLED, STRAIN, LARGEST = (0.3, 0.6, 1.0), 0.003, 0.01
"""Sizes of strains over the largest; what that is without noise, and where that asks for MOST."""
SMALLER = len(PULLED) - 1
"""Sizes of strains below the largest."""
TIMES = 3
"""Pairs of displaced crystals; numbers asked of each unknown; standard errors that are told."""
AWAY = 30.0
"""Noise over the stiffness, of the distance from sites that it may leave an atom at."""
ROUGH = 0.05
"""Of the force, that is not linear in displacements of SHAKEN, from which a surface is rough."""
ROUGHER = 3
"""How many times smaller displacements are that say what a rough surface's forces change by."""
BENDING = 0.01
"""Of stress over strain, that changes from STRAIN to LARGEST, from which a surface is rough; more
than was seen of any potential that is smooth."""
NONE = 1e-8
"""Of the largest singular value of rows: what they do not tell."""


@dataclass(frozen=True)
class Noise:
    """Noise of a calculator's forces and stress.

    Attributes:
        force: standard error of a force component [eV/Å].
        stress: of a stress component of the cell at rest [TPa]; zero without stress.
        stiffness: root mean square force over the displacement that made it [eV/Å²].
        rough: force on twice a small displacement less twice the force, or stress likewise [eV/Å];
            zero of smooth energies. Networks may have a dimple at perfect crystals.
    """

    force: float
    stress: float
    stiffness: float
    rough: float = 0.0

    @property
    def linear(self) -> float:
        """Root mean square force component [eV/Å] under the displacement SHAKEN."""
        return SHAKEN * self.stiffness / 3**0.5

    @property
    def rounding(self) -> bool:
        """Whether the noise is too small to matter."""
        return self.force <= EXACT * SHAKEN * self.stiffness

    @property
    def length(self) -> float:
        """Displacement [Å] at which noise and roughness equal the force's third differences."""
        wanted = (BENT**2 * max(self.force, self.rough) / max(self.stiffness, TINY)) ** (1 / 3)
        return float(np.clip(wanted, LEAST, MOST))

    @property
    def sites(self) -> float:
        """Largest distance [Å] from its site at which noise may leave an atom."""
        return max(ON_SITES, AWAY * self.force / max(self.stiffness, TINY))

    @property
    def strain(self) -> float:
        """Largest strain of finite differences, by the rule of `length`."""
        return max(LARGEST * self.length / MOST, STRAIN)


def measured(cell: ase.Atoms, calculator: Any, flat: bool) -> Noise:
    """Measure the noise of forces and stress on one displaced crystal, translated and turned."""
    rng, count = np.random.default_rng(0), int(np.ceil((ENOUGH / len(cell)) ** (1 / (3 - flat))))
    many = cell.repeat((count, count, 1 if flat else count))
    u = _directions(rng, len(many), SHAKEN)
    axis = np.array([0, 0, 1.0]) if flat else np.array([1, 2, 3]) / 14**0.5

    def told(sign: int, angle: float) -> Pair | None:
        one, turn = many.copy(), Rotation.from_rotvec(angle * axis, degrees=True).as_matrix()
        one.positions += sign * u + rng.uniform(0, 3, 3) * [1, 1, not flat]
        one.rotate(angle, axis, rotate_cell=True)
        one.calc = calculator
        try:
            force = np.array(one.get_forces()) @ turn
        except Exception:  # a calculator may go by axes of its own
            if not angle:
                raise
            return None
        stress = np.full((3, 3), np.nan)
        with suppress(Exception):  # calculators without stress raise whatever they do
            stress = one.get_stress(voigt=False)
        return force, turn.T @ stress @ turn

    sides = [[one for a in ANGLES if (one := told(sign, a)) is not None] for sign in (1, -1)]
    force, stress = (np.array([[one[n] for one in side] for side in sides]) for n in (0, 1))

    def scatter(values: ndarray) -> float:
        return float(np.sqrt(values.var(axis=1, ddof=1).mean()))

    known = np.isfinite(stress).all()
    tight = scatter(stress) * np.sqrt(len(many) / len(cell)) * EV_IN_TPA if known else 0.0
    odd = np.subtract(*force.mean(axis=1)) / 2
    found = Noise(scatter(force), float(tight), float(np.sqrt(np.mean(odd**2) / np.mean(u**2))))
    if found.rounding:
        return found
    at, x = forces_of(many, calculator), np.array(many.positions)
    bent = float(np.sqrt(np.mean((at(x + u / 2) - at(x - u / 2) - odd) ** 2)))
    if bent <= max(ROUGH * found.linear, 2 * TIMES * found.force):
        share = bent_by_strain(cell, calculator, flat, found.stress) if known else 0.0
        bent = share * found.linear if share > BENDING else 0.0
    return replace(found, rough=bent)


def strained(calculator: Any, cell: ase.Atoms, turns: ndarray) -> Iterator[ase.Atoms]:
    """Yield a cell under each of the deformation gradients [K, 3, 3], with the calculator."""
    for F in turns:
        one = cell.copy()
        one.set_cell(np.array(cell.cell) @ F, scale_atoms=True)
        one.calc = calculator
        yield one


def unit_strains(d: int) -> ndarray:
    """Unit strains in Voigt's order, [k, 3, 3]; a shear has half of it on both sides."""
    return symmetric_part(np.array([np.outer(*np.eye(3)[list(pair)]) for pair in PAIRS[d]]))


def bent_by_strain(cell: ase.Atoms, calculator: Any, flat: bool, noise: float) -> float:
    """Relative change of the moduli from strain STRAIN to LARGEST; 0 within the noise [TPa]."""
    rng, slopes = np.random.default_rng(0), []
    G = rng.standard_normal((2, 3, 3)) * (np.outer([1, 1, 0], [1, 1, 0]) if flat else 1)
    own = unit_strains(2 if flat else 3)  # of moduli, as far along an axis
    ways = np.concatenate([symmetric_part(G), own])
    ways /= norm(ways, axis=(1, 2))[:, None, None]
    for size in STRAIN, LARGEST:
        turns = np.eye(3) + np.concatenate([size * ways, -size * ways])
        ends = np.array([one.get_stress() for one in strained(calculator, cell, turns)])
        slopes.append(np.subtract(*np.split(ends, 2)) / (2 * size))
    off, error = norm(slopes[1] - slopes[0]), noise / EV_IN_TPA / STRAIN
    share = off / norm(slopes[0])
    return float(share) if off > 2 * TIMES * error * slopes[0].size ** 0.5 else 0.0


def _directions(rng: np.random.Generator, count: int, size: float) -> ndarray:
    u = rng.standard_normal((count, 3))
    return np.asarray(size * u / norm(u, axis=1, keepdims=True))


class Symmetric(Supercell):
    """Symmetrised force constants on a supercell, in an orthonormal `basis` [M, n, N, 3, 3]."""

    def __init__(
        self, cell: ase.Atoms, many: ase.Atoms, displaced: Sequence[int], **how: Any
    ) -> None:
        super().__init__(cell, many, displaced, **how)
        how_to = "symfc: pip install 'warp_peri[phonons]'"
        sets, utils = (optional(f"symfc.{name}", how_to) for name in ("basis_sets", "utils.utils"))
        kinds, parts, count = self.pairs.kinds[self.site], many.get_scaled_positions(), len(many)
        atoms = utils.SymfcAtoms(cell=self.box, scaled_positions=parts, numbers=kinds + 1)
        found = sets.FCBasisSetO2(atoms, symprec=ON_SITES).run()
        self.translations = found.translation_permutations
        rows = 9 * count * np.array(self.displaced)[:, None] + np.arange(9 * count)
        basis = found.compression_matrix.tocsr()[rows.ravel()].toarray().T
        self.basis = (count / len(cell)) ** 0.5 * basis.reshape(-1, len(cell), count, 3, 3)

    def forces(self, u: ndarray) -> ndarray:
        """Forces −Φ u on all atoms by each Φ of the basis, for u [N, 3], shape [3 N, M]."""
        pulled = np.einsum("mijab,ljb->iaml", self.basis, u[self.translations], optimize=True)
        forces = np.empty((len(u), 3, len(self.basis)))
        for place, atom in enumerate(self.displaced):
            forces[self.translations[:, atom]] = -pulled[place].transpose(2, 0, 1)
        return forces.reshape(-1, len(self.basis))

    def rules(self) -> Pair:
        """Particular solution of the invariances in basis coefficients, and a basis of the rest.

        Translations and turns cost nothing (M. Born, K. Huang, 1954), and second moments are those
        of the crystal's stress (Huang's relations).
        """
        atoms, held = self.pairs, np.zeros((3, 3))
        furthest = norms(atoms.vectors).max()
        if atoms.stress is not None:
            held[: atoms.dimension, : atoms.dimension] = atoms.stress / EV_IN_TPA

        def broken(values: ndarray) -> ndarray:
            zeroth, first, second = atoms.moments(values)
            second = second + 2 * atoms.volume * stress_brackets(held)
            huang = (second - np.moveaxis(second, (-4, -3), (-2, -1))) / furthest**2
            parts = zeroth.sum(axis=-2), (first - first.mT) / furthest, huang
            flat = [part.reshape(*part.shape[: values.ndim - 3], -1) for part in parts]
            return np.concatenate(flat, axis=-1)

        known = broken(atoms.values)
        return particular((broken(self.values(self.basis)) - known).T, -known)


def projected(
    cell: ase.Atoms, many: ase.Atoms, phi: ndarray, displaced: Sequence[int], **how: Any
) -> ForceConstants:
    """Nearest force constants that obey symmetry and invariance; the change is their error. What
    they have at half the supercell's width should have decayed, and is an error too."""
    every = Symmetric(cell, many, displaced, **how)
    phi = every.balanced(every.short_ranged(phi))
    known, free = every.rules()
    numbers = np.tensordot(every.basis, phi, phi.ndim) - known
    kept = np.tensordot(known + free @ (free.T @ numbers), every.basis, 1)
    rim = np.zeros((*kept.shape[:2], 1, 1), bool)
    rim[every.entries] = every.at_edge[:, None, None]
    cut = every.balanced(np.where(rim, kept, 0.0))
    values, moved, cut = (every.values(one) for one in (kept, kept - phi, cut))
    return replace(every.pairs, values=values, doubt=moved[None], cut=cut, edge=every.edge(values))


def rattled(
    cell: ase.Atoms, many: ase.Atoms, calculator: Any, noise: Noise, **how: Any
) -> tuple[ForceConstants, dict[str, str]]:
    """Force constants with standard errors from crystals whose atoms are all displaced.

    The fit obeys the invariances; smaller displacements show what depends on size, an error too.
    Returns notes by name as well.
    """
    h = noise.length
    every = Symmetric(cell, many, range(len(cell)), **how)
    known, free = every.rules()
    pairs = max(TIMES, int(np.ceil(TIMES * free.shape[1] / (3 * len(many)))))
    small, few = (h / ROUGHER, pairs) if noise.rough else (h / 2, 1)
    rng, at, x = np.random.default_rng(1), forces_of(many, calculator), np.array(many.positions)
    rows, forces = [], []
    for size in [h] * pairs + [small] * few:
        u = _directions(rng, len(many), size)
        own = every.forces(u)
        rows.append(own @ free)
        forces.append((at(x + u) - at(x - u)).ravel() / 2 - own @ known)
    X, short = np.concatenate(rows[:pairs]), np.concatenate(rows[pairs:])
    y, less = np.concatenate(forces[:pairs]), np.concatenate(forces[pairs:])
    U, sizes, V = svd(X, full_matrices=False)
    kept = sizes > NONE * sizes[0]
    way = V[kept].T / sizes[kept]
    z = way @ (U.T[kept] @ y)
    error = norm(y - X @ z) / np.sqrt(max(len(y) - kept.sum(), 1))
    half = short @ z
    slope = half @ less / (half @ half) - 1
    scatter, each = way * error, way[:, :0]
    bent = slope * z if abs(slope) > TIMES * error / norm(half) else 0 * z
    if noise.rough:  # each number has a slope of its own
        bent = lstsq(short, less, NONE)[0] - z
        both = np.hstack([scatter, free.T * (free @ bent)])
        U, sizes, _ = svd(both, full_matrices=False)
        each = U * sizes
    numbers = np.column_stack([known + free @ z, free @ np.column_stack([scatter, bent, each])])
    values = np.tensordot(numbers.T, every.values(every.basis), 1)
    (values,), doubt, spread = np.split(values, [1, scatter.shape[1] + 2])
    found = replace(
        every.pairs, values=values, doubt=doubt, edge=every.edge(values),
        spread=spread if noise.rough else None,
    )  # fmt: skip
    said = {
        "noise": f"{noise.force:.1e} eV/Å; {error:.1e} eV/Å between forces and force constants",
        "displacements": f"{h:.3g} Å of all atoms, {pairs} pairs; at {small:.3g} Å forces are "
        f"{slope:+.1%} of linear ones",
    }
    if noise.rough:
        said["rough"] = (
            f"forces on {SHAKEN:g} Å, or stress on {LARGEST:.0%} of strain, are "
            f"{noise.rough / noise.linear:.0%} off what smaller steps say: moduli are those of the "
            "largest steps, and how they change down to the smallest is in their errors"
        )
    return found, said


def by_strains(
    cell: ase.Atoms, calculator: Any, noise: Noise, atoms: ForceConstants, allowed: ndarray
) -> Pair | None:
    """Elastic tensor C_ijkl [TPa] by finite strains with relaxed atoms, and its standard errors.

    From differences of the second Piola–Kirchhoff stress S = det F · F⁻¹ σ F⁻ᵗ, as (T19) has it.
    Where slopes depend on the strain, as of a rough surface, those of the largest are taken and the
    differences are the last errors. Returns [d, d, d, d] and [Q, d, d, d, d]; None without stress.
    """
    d, e, rough = atoms.dimension, noise.strain * np.array(PULLED), noise.rough > 0
    try:
        S, F = _under_strain(cell, calculator, e, atoms)
    except NotImplementedError:
        return None
    means = (S.sum(axis=0) / 2).reshape(len(e), -1)
    even = lstsq(np.column_stack([e**0, e**2]), means)[0]
    odd = (S[0] - S[1]) / 2
    slope, error, gain = _slope(odd, e, rough)
    few = [slice(k, k + 1) for k in range(SMALLER)] if rough else [slice(0, 2)]
    short, _, wider = zip(*(_slope(odd[k], e[k], rough) for k in few))
    onto = pinv(voigt(allowed).reshape(len(allowed), -1).T)
    C, *off = (np.tensordot(onto @ one.ravel(), allowed, 1) for one in (slope, *(slope - short)))
    errors = [*np.tensordot(error * onto.T, allowed, 1)]
    seen = TIMES * error * wider[0] / gain * norm(onto, "nuc")
    if not rough and norm(onto @ (slope - short[0]).ravel()) > seen:
        errors.append(off[0])
    # a stress that is left strains the crystal; how stiffness goes with strain is in even parts
    rest = even[0].reshape(len(PAIRS[d]), -1).mean(axis=0)
    if atoms.stress is not None:
        rest = rest - [atoms.stress[pair] for pair in PAIRS[d]]
    strain = np.abs(solve(voigt(C), rest)).max()
    errors.append(2 * np.abs(even[1]).max() / np.abs(C).max() * strain * C)
    if len(cell) > 1:
        push, tau, _ = _slope((F[0] - F[1]) / 2, e, rough)
        Lambda = np.zeros((len(cell), 3, d, d))
        for kind, (i, j) in enumerate(PAIRS[d]):
            Lambda[..., i, j] = Lambda[..., j, i] = push[kind]
        n, m, size = len(cell), atoms.moving, EV_IN_TPA / atoms.volume
        Lambda = (Lambda - Lambda.mean(axis=0))[:, :m].reshape(n * m, d, d)
        onto = pinv(allowed.reshape(len(allowed), -1).T)

        def relaxed(values: ndarray | None = None) -> Pair:
            """Reduction of C by relaxing atoms, and its errors."""
            stiff = atoms.moments(values)[0][:, :m, :, :m].reshape(n * m, n * m)
            moved = np.tensordot(relaxing(stiff, m), Lambda, 1)
            taken = onto @ np.einsum("Iab,Icd->abcd", Lambda, moved).ravel() * size
            each = np.einsum("mabcd,Icd->Iabm", onto.reshape(allowed.shape), moved)
            errors = 2 * size * tau * each.reshape(-1, len(onto))
            return np.tensordot(taken, allowed, 1), np.tensordot(errors, allowed, 1)

        taken, more = relaxed()
        errors += [*more]
        if atoms.doubt is not None:
            errors += [taken - relaxed(atoms.values + one)[0] for one in atoms.doubt]
        C = C - taken
    return C, np.array([*errors, *off] if rough else errors)


def _under_strain(cell: ase.Atoms, calculator: Any, e: ndarray, atoms: ForceConstants) -> Pair:
    """S [TPa] and forces [eV/Å] under strains of sizes e, [2, E, kinds, 3 or 6 | n, 3]."""
    d, n, flat = atoms.dimension, len(cell), atoms.thickness is not None
    G = np.eye(3) + np.einsum("e,s,kij->eksij", e, [1, -1], unit_strains(d))
    each = strained(calculator, cell.repeat((2, 2, 1 if flat else 2)), G.reshape(-1, 3, 3))
    stresses, pushes = zip(*((one.get_stress(voigt=False), one.get_forces()) for one in each))
    tall = EV_IN_TPA * (cell.cell[2, 2] / atoms.thickness if flat else 1.0)
    back = inv(G)
    pulled = det(G)[..., None, None] * back @ np.reshape(stresses, G.shape) * tall
    S = (pulled @ back.mT)[..., *tuple(np.transpose(PAIRS[d]))].transpose(2, 0, 1, 3)
    return S, np.reshape(pushes, (*G.shape[:3], -1, n, 3)).mean(axis=3).transpose(2, 0, 1, 3, 4)


def _slope(y: ndarray, e: ndarray, secant: bool) -> tuple[ndarray, float, float]:
    """Slopes a of y = a e + b e³, their standard error, and that over y's; b is 0 of a secant."""
    X = e[:, None] if secant else np.column_stack([e, e**3])
    flat, P = y.reshape(len(e), -1), pinv(X)
    free = flat.shape[1] * max(len(e) - X.shape[1], 1)
    left = norm(flat - X @ P @ flat) / np.sqrt(free)
    gain = float(norm(P[0]))
    return (P[0] @ flat).reshape(y.shape[1:]), left * gain, gain


def joined(
    atoms: ForceConstants, allowed: ndarray, C: ndarray, errors: ndarray, *, shared: int = 0
) -> tuple[ForceConstants, float, float]:
    """Force constants moved by their own errors until their moduli agree with C (R. Kalman).

    C, errors as of `by_strains`; the last `shared` errors stay. Returns χ² per modulus, and the
    move of Φ, as well; above χ² = 1 errors of Φ grow by √χ².
    """
    onto = pinv(allowed.reshape(len(allowed), -1).T)
    own, both = np.split(onto @ errors.reshape(len(errors), -1).T, [len(errors) - shared], axis=1)
    other, seen = onto @ C.ravel(), onto @ atoms.nearest_elastic(allowed)[0].ravel()
    off = other - seen

    def compared() -> tuple[ndarray, float]:
        J = onto @ atoms.elastic_doubt(allowed).reshape(-1, onto.shape[1]).T
        return J, off @ pinv(J @ J.T + own @ own.T) @ off / len(allowed)

    J, chi = compared()
    wider = chi
    if atoms.spread is not None:  # moduli would else tell how all of Φ changes with displacements
        atoms = replace(atoms, doubt=atoms.spread, spread=None)
        J, wider = compared()
    doubt, J = (max(1.0, wider**0.5) * one for one in (atoms.doubt, J))
    gain = J.T @ pinv(J @ J.T + own @ own.T)
    values, step = atoms.values, np.zeros(len(doubt))
    for _ in range(3):  # moduli bend a little in Φ where atoms of a cell relax
        step = gain @ (other - seen + J @ step)
        values = atoms.values + np.tensordot(step, doubt, 1)
        seen = onto @ atoms.nearest_elastic(allowed, values)[0].ravel()
    parts, vectors = eigh(np.eye(len(doubt)) - gain @ J)
    left = (vectors * np.sqrt(np.clip(parts, 0, None))).T, (pinv(J) @ both).T
    after = np.tensordot(np.concatenate(left), doubt, 1)
    moved = relative(values - atoms.values, atoms.values)
    return replace(atoms, values=values, doubt=after), chi, moved
