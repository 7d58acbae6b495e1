"""Force constants and phonons of a structure, and what their waves say."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import ase
import numpy as np
from ase.data import atomic_masses
from scipy.special import j0

from warp_peri.atoms.calculator_noise import EV_IN_TPA, TIMES, rattled
from warp_peri.atoms.force_constants import (
    EDGE,
    STEP,
    ForceConstants,
    NonAnalyticCorrection,
    finite_differences,
    forces_of,
    from_supercell,
)
from warp_peri.atoms.relaxed import Reference
from warp_peri.errors import InputError, warn

SMOOTHING_RADIUS, PERIOD, WAVES = 2.0, 18, 6
"""Radius of the smoothing and period of the loads, in spacings, and waves of one load."""


@dataclass
class WaveLoads:
    """What atoms answer to loads of a few waves each, as nodes see it.

    Attributes:
        k: of the waves [1/Å], shape [S, W, d].
        u: complex amplitudes of the mean displacement [Å], shape [S, W, d].
        b: of the load density [TPa/Å].
        seen: part of each wave that smoothing leaves, shape [S, W, 1].
    """

    k: np.ndarray
    u: np.ndarray
    b: np.ndarray
    seen: np.ndarray

    def error(self, symbol: Callable[[np.ndarray], np.ndarray]) -> float:
        """Mean relative error of displacement [%] of a solid D(k) [TPa/Å²], [K, d] to [K, d, d]."""
        D = symbol(self.k.reshape(-1, self.k.shape[-1])).reshape(*self.k.shape, -1)
        answer = np.linalg.solve(D, self.b[..., None])[..., 0]
        off, size = (np.linalg.norm(self.seen * u, axis=(1, 2)) for u in (answer - self.u, self.u))
        return float(100 * (off / size).mean())


def wave_loads(
    atoms: ForceConstants, spacing: float, lengths: tuple[float, float], *, loads: int, seed: int
) -> WaveLoads:
    """Loads of WAVES waves of a period, of the longest to the shortest length, in spacings.

    Args:
        atoms: all of the crystal, which answers as its force constants say.
        spacing: of the nodes [Å], which see waves smoothed by a cone.
    """
    d, rng = atoms.dimension, np.random.default_rng(seed)
    ends = PERIOD * spacing, *(spacing * length for length in lengths)
    k, f = map(np.array, zip(*(random_waves(rng, d, *ends) for _ in range(loads))))
    u = atoms.answer(k.reshape(-1, d), f.reshape(-1, d, 1)).mean(axis=1).reshape(f.shape)
    r = SMOOTHING_RADIUS * spacing * (np.arange(200) + 0.5) / 200
    far = np.linalg.norm(k, axis=-1, keepdims=True) * r
    ring = j0(far) if d == 2 else np.sinc(far / np.pi)
    seen = ring @ ((SMOOTHING_RADIUS * spacing - r) * r ** (d - 1))
    return WaveLoads(k, u, EV_IN_TPA * len(atoms.positions) / atoms.volume * f, seen[..., None])


def random_waves(
    rng: np.random.Generator, d: int, length: float, longest: float, shortest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Waves of a period: k [1/Å] and amplitudes of the force on an atom [eV/Å], [WAVES, d].

    Stars of waves of one length are drawn as often as they are long.
    """
    most = int(length / shortest)
    n = np.stack(np.meshgrid(*[np.arange(-most, most + 1)] * d, indexing="ij"), axis=-1)
    size = np.linalg.norm(n, axis=-1)
    n = n[(size * shortest < length) & (size * longest >= length)]
    stars: dict[tuple[int, ...], list[np.ndarray]] = {}
    for wave in n:
        stars.setdefault(tuple(sorted(np.abs(wave).tolist(), reverse=True)), []).append(wave)
    names = sorted(stars)
    weight = np.array([1 / np.linalg.norm(name) for name in names])
    k, force = np.zeros((WAVES, d)), np.zeros((WAVES, d), complex)
    for row, pick in enumerate(rng.choice(len(names), size=WAVES, p=weight / weight.sum())):
        star = stars[names[pick]]
        k[row] = 2 * np.pi * star[rng.integers(len(star))] / length
        for axis in range(d):
            phase = rng.uniform(0, 2 * np.pi)
            force[row, axis] = rng.normal() * np.linalg.norm(k[row]) * np.exp(1j * phase)
    return k, force


WIDTHS, WITH_IONS = (10.0, 14.0, 18.0, 22.0, 26.0, 32.0, 40.0), (14.0,)
"""Of supercells [Å], tried in turn; the one where Born charges take off what reaches further."""
DECAYED_FORCE, DECAYED_FORCE_ROUGH = 1e-5, 0.05
"""Force at half the width of a supercell, over the largest, that is none; that of a surface that
is rough, whose forces far away are no noise."""
MOST_ATOMS, NOISY_ATOMS = 6000, 700
"""In a supercell; where forces are noisy strains tell moduli better than what is further away."""
GRID = {2: 24, 3: 8}
"""Wave vectors along each reciprocal edge that are looked at for soft modes."""
SOFT = 1e-5
"""Of the largest eigenvalue: a negative one beyond it is no rounding."""
MEMORY = re.compile("memory|alloc", re.IGNORECASE)
"""In what a calculator says where it has too little."""
LOOSE = (
    "structure: parts of it feel no force from the rest; expected one crystal, without loose atoms "
    "or layers"
)
BORN, DIELECTRIC = "born_effective_charges", "dielectric_tensor"
"""ASE's names for what a calculator may give."""
NEUTRAL = 1e-3
"""Charges [e] that are none."""
THZ = 15.633302
"""√(eV/Å²/amu) / 2π [THz]."""


def force_constants(
    reference: Reference, calculator: Any, supercell: Sequence[int] | None = None
) -> tuple[ForceConstants, dict[str, str]]:
    """Φ of a crystal at rest by finite differences, and what was taken for it, by name.

    Under noise all atoms are displaced at once, and Φ has its standard errors (`rattled`).

    Args:
        reference: at rest.
        calculator: with forces.
        supercell: repeats of the smallest cell along its edges; by default the smallest supercell
            at half whose width a displaced atom's forces have ended.

    A calculator that gives Born charges (ASE's `born_effective_charges` and `dielectric_tensor`)
    has the field of its ions in every wave, in any supercell (theory, T18).

    Raises InputError for repeats that are not three counts, a crystal with imaginary phonons, Born
    charges of a sheet, or without the dielectric tensor.
    """
    d, cell = reference.dimension, reference.cell
    polar = born_charges(reference, calculator)
    if supercell is None:
        repeats = wide_enough(reference, calculator, WIDTHS if polar is None else WITH_IONS)
    else:
        repeats = tuple(int(n) for n in supercell)
        if len(repeats) != 3 or min(repeats) < 1 or (d == 2 and repeats[2] != 1):
            raise InputError(f"supercell: expected three counts, a sheet's third 1, got {repeats}")
    many = cell.repeat(repeats)
    ions = "" if polar is None else ", and the field of ions by the calculator's Born charges"
    told = {"force constants": f"{_cells(repeats[:d])}, {len(many)} atoms{ions}"}
    how: Any = {"thickness": reference.thickness, "polar": polar, "stress": reference.stress}
    if reference.noise is None:
        every = range(len(cell))
        phi, change = finite_differences(forces_of(many, calculator), many.positions, every)
        found = from_supercell(cell, many, phi, every, **how, change=change)
    else:
        found, said = rattled(cell, many, calculator, reference.noise, **how)
        told |= said
    check_phonons(found)
    return found, told


def _cells(repeats: Sequence[int]) -> str:
    return f"{' x '.join(map(str, repeats))} cells"


def born_charges(reference: Reference, calculator: Any) -> NonAnalyticCorrection | None:
    """Charges that a calculator gives under ASE's names; None where it has none, or they vanish.

    Raises InputError for those of a sheet, or without the dielectric tensor.
    """
    given, cell = getattr(calculator, "implemented_properties", ()), reference.cell.copy()
    if BORN not in given:
        return None
    cell.calc = calculator
    born = np.asarray(calculator.get_property(BORN, cell), dtype=float)
    if np.abs(born).max() < NEUTRAL:
        return None
    if reference.dimension == 2:
        raise InputError(
            "calculator: it gives Born charges of a sheet; the field of a sheet's ions is another "
            "than a solid's, and no model here has it"
        )
    if DIELECTRIC not in given:
        raise InputError(f"calculator: it gives {BORN} without {DIELECTRIC}; expected both")
    return NonAnalyticCorrection(
        born, np.asarray(calculator.get_property(DIELECTRIC, cell), dtype=float)
    )


def wide_enough(reference: Reference, calculator: Any, widths: Sequence[float]) -> tuple[int, ...]:
    """Repeats of the cell at half of whose width forces have ended, or the widest that may be.

    Of one width [Å] nothing is asked. A supercell that the calculator has no memory for is told.
    """
    cell, d = reference.cell, reference.dimension
    heights = 1 / np.linalg.norm(np.linalg.inv(np.array(cell.cell)), axis=0)
    most = MOST_ATOMS if reference.noise is None else NOISY_ATOMS
    repeats, rim, ended = (), np.nan, "supercell=… takes a wider one"
    for width in widths:
        count = np.where(np.arange(3) < d, np.ceil(width / heights), 1).astype(int)
        many = cell.repeat(wider := tuple(count.tolist()))
        if len(widths) == 1:
            return wider
        if repeats and len(many) > most:
            break
        try:
            rim, none = _at_rim(many, calculator, (count * heights)[:d].min(), reference)
        except (MemoryError, RuntimeError) as error:  # networks' libraries raise the latter
            if not (repeats and MEMORY.search(f"{type(error).__name__} {error}")):
                raise
            ended = f"{len(many)} atoms need more memory than there is"
            break
        repeats = wider
        if rim <= none:
            return repeats
    warn(
        f"supercell: at half the width of {_cells(repeats[:d])} forces still are {rim:.1e} of the "
        f"largest; {ended}"
    )
    return repeats


def _at_rim(
    many: ase.Atoms, calculator: Any, width: float, reference: Reference
) -> tuple[float, float]:
    """The force at half a supercell's width from a displaced atom, over the largest; none's."""
    noise, x, rim, none = reference.noise, np.array(many.positions), 0.0, DECAYED_FORCE
    forces = forces_of(many, calculator)
    still, far = forces(x), many.get_distances(0, range(len(many)), mic=True)
    for axis in range(reference.dimension):
        moved = x.copy()
        moved[0, axis] += STEP if noise is None else noise.length
        change = np.abs(forces(moved) - still).max(axis=1)
        if not change.max() > 0:
            raise InputError(LOOSE)
        rim = max(rim, float(change[far > EDGE * width].max(initial=0.0) / change.max()))
        if noise is not None:
            least = TIMES**2 * noise.force / float(change.max())
            none = max(none, least, DECAYED_FORCE_ROUGH if noise.rough else 0.0)
    return rim, none


def check_phonons(atoms: ForceConstants) -> None:
    """Raise InputError for imaginary phonons, with the worst wave vector.

    A grid of waves is looked at, and the edges of the zone with it; a sheet's mean height is held,
    so that its bending is not. Raises it too for parts that feel no force from the rest.
    """
    d = atoms.dimension
    parts = np.array(list(itertools.product(np.arange(GRID[d]) / GRID[d], repeat=d)))
    parts = np.where(parts > 0.5, parts - 1, parts)
    parts = parts[parts @ [1.0, 1e-3, 1e-6][:d] >= 0]
    k, size, waves = _phonons(atoms, parts)
    worst = int(size[:, 0].argmin())
    least, top = size[worst, 0], size[:, -2 if d == 2 else -1].max()  # a sheet's last is held
    error = 0.0
    if atoms.doubt is not None and least < 0:
        error = float(atoms.stiffness_error(k[worst], waves[worst, 0]))
    if least >= -max(SOFT * top, TIMES * error):
        stiffest = np.linalg.eigvalsh(atoms.dynamical(k))[:, 0].max()
        if stiffest <= SOFT * np.abs(atoms.values).max():
            raise InputError(LOOSE)
        return
    imaginary = THZ * np.sqrt(-least)
    bar = f" ± {imaginary * error / (-2 * least):.2g}" if error > SOFT * top else ""
    raise InputError(
        f"structure: expected a stable crystal, got an imaginary phonon, the worst of "
        f"{imaginary:.2f}{bar}i THz at k = {np.round(parts[worst], 4).tolist()} of the reciprocal "
        f"edges ({np.round(k[worst], 4).tolist()} 1/Å); displace atoms along it in a larger cell "
        "and relax"
    )


def _phonons(atoms: ForceConstants, parts: np.ndarray) -> tuple[np.ndarray, ...]:
    """At parts [K, d] of the reciprocal edges: k [1/Å], ω², and modes over √mass [K, 3 n, n, 3]."""
    d = atoms.dimension
    k = 2 * np.pi * parts @ np.linalg.inv(atoms.cell[:d, :d]).T
    weight = 1 / np.sqrt(np.repeat(atomic_masses[atoms.species], 3))
    size, modes = np.linalg.eigh(atoms.dynamical(k, moving=3) * weight * weight[:, None])
    return k, size, (modes.swapaxes(1, 2) * weight).reshape(*size.shape, -1, 3)


def at_zone_edge(atoms: ForceConstants) -> tuple[float, float, float]:
    """The softest phonon [THz] at halves of the reciprocal edges, its error, the largest error."""
    parts = np.array(list(itertools.product((0, 0.5), repeat=atoms.dimension)))[1:]
    k, size, waves = _phonons(atoms, parts)
    off = np.array([atoms.stiffness_error(*pair) for pair in zip(k, waves)])
    low, middle, high = (THZ * np.sqrt(np.clip(size + way * off, 0, None)) for way in (-1, 0, 1))
    soft, error = middle.argmin(), (high - low) / 2
    return float(middle.flat[soft]), float(error.flat[soft]), float(error.max())
