"""Force constants and phonons of a structure, and what their waves say."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ase
import numpy as np
import scipy.sparse as sp
from ase.data import atomic_masses
from scipy.spatial import cKDTree

from warp_peri.atoms.calculator_noise import EV_IN_TPA, TIMES, rattled
from warp_peri.atoms.force_constants import (
    EDGE,
    STEP,
    ForceConstants,
    Polar,
    finite_differences,
    forces_of,
    from_supercell,
)
from warp_peri.atoms.relaxed import Reference
from warp_peri.errors import InputError, warn
from warp_peri.materials.crystal import Crystal
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples

CONE = 2.0
"""Radius of the smoothing, in spacings."""
PERIOD, PART, COLLAR = 18, {2: 18, 3: 10}, 4
"""Nodes along an axis: of the loads' period, and where atoms and nodes are out of step of the part
that is asked, and of the collar around it."""


@dataclass
class Loads:
    """What atoms answer to loads of a few waves, as nodes see it.

    Attributes:
        samples: on nodes; of a cubic cell on a period, else with a collar.
        k: of the waves [1/Å], shape [S, W, d].
        u: complex amplitudes of the mean displacement [Å], shape [S, W, d].
        b: of the load density [TPa/Å].
        seen: fields on the nodes of amplitudes on all atoms alike, [S, W, d] to [S, N, d].
    """

    samples: Samples
    k: np.ndarray
    u: np.ndarray
    b: np.ndarray
    seen: Callable[[np.ndarray], np.ndarray]

    def errors(self, symbol: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
        """Means of E_res and E_u [%] of a solid without nodes, k [K, d] to [K, d, d]."""
        D = symbol(self.k.reshape(-1, self.k.shape[-1])).reshape(*self.k.shape, -1)
        load = self.seen(np.einsum("swij,swj->swi", D, self.u))
        moved = self.seen(np.linalg.solve(D, self.b[..., None])[..., 0])
        inside = self.samples.interior
        true = self.samples
        return relative(load, true.loads, inside), relative(moved, true.u, inside)

    def errors_of(self, law: Crystal) -> tuple[float, float]:
        """The same of a law on the nodes."""
        return placed_errors(law, self.samples)


def placed_errors(law: Crystal, samples: Samples) -> tuple[float, float]:
    """Means of E_res and E_u [%] of a law on nodes, displacement given around them if any is."""
    operator, inside = law.on(samples.points), samples.interior
    force, load = np.zeros_like(samples.u), np.zeros_like(samples.u)
    force[:, inside], load[:, inside] = operator(samples.u), samples.loads[:, inside]
    given = samples.u
    if samples.points.box is not None:  # of a period the mean is free
        given = given - given.mean(axis=1, keepdims=True)
    u = operator.rest(load, given).u
    return relative(force, load, inside), relative(u, given, inside)


def relative(found: np.ndarray, true: np.ndarray, inside: np.ndarray) -> float:
    """Mean over samples of ‖found − true‖ / ‖true‖ on some nodes [%]."""
    wrong, whole = (
        np.linalg.norm(x[:, inside].reshape(len(x), -1), axis=1) for x in (found - true, true)
    )
    return float(100 * (wrong / whole).mean())


def wave_loads(
    atoms: ForceConstants,
    spacing: float,
    *,
    longest: float,
    shortest: float,
    loads: int,
    seed: int,
    collar: int = COLLAR,
) -> Loads:
    """Loads of six waves each with wavelengths between two bounds, in spacings, smoothed on nodes.

    Waves are a period's of PERIOD nodes. Of a cubic cell as large as the spacing the nodes are that
    period's, else a part of it with a collar that is given.

    Args:
        atoms: all of the crystal, which answers as its force constants say.
        spacing: of the nodes [Å].
        collar: nodes around the interior, where there is no period.
    """
    d, count = atoms.dimension, len(atoms.positions)
    length = PERIOD * spacing
    cells_across = length * np.linalg.inv(atoms.cell[:d, :d])
    in_step = bool(np.abs(cells_across - np.rint(cells_across)).max() < 1e-6)
    cells, collar = (PERIOD, 0) if in_step else (PART[d], collar)
    rng = np.random.default_rng(seed)
    ends = length, longest * spacing, shortest * spacing
    k, force = zip(*(random_waves(rng, d, *ends) for _ in range(loads)))
    K, f = np.array(k), np.array(force)
    u = atoms.answer(K.reshape(-1, d), f.reshape(-1, d)).reshape(*f.shape[:2], count, d)
    points, x, kind, smooth = watched(atoms, spacing, cells, collar, length if in_step else None)
    density = np.asarray(smooth.sum(axis=1))

    def fields(amplitude: np.ndarray) -> np.ndarray:
        """Of amplitudes of each atom of the cell, [S, W, n, d], smoothed but not averaged."""
        found = []
        for waves, values in zip(K, amplitude):
            phase = np.exp(1j * (x @ waves.T))
            found.append(smooth @ np.einsum("aw,wad->ad", phase, values[:, kind]).real)
        return np.array(found)

    def seen(amplitude: np.ndarray) -> np.ndarray:
        alike = np.broadcast_to(amplitude[:, :, None], (*amplitude.shape[:2], count, d))
        return np.asarray(fields(alike) / density)

    per_volume = EV_IN_TPA * count / atoms.volume
    share = EV_IN_TPA / (spacing**d * (atoms.thickness or 1.0))
    alike = np.broadcast_to(f[:, :, None], u.shape)
    samples = Samples(points, fields(u) / density, share * fields(alike))
    return Loads(samples, K, u.mean(axis=2), per_volume * f, seen)


def random_waves(
    rng: np.random.Generator, d: int, length: float, longest: float, shortest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Six waves of a period: k [1/Å] and amplitudes of the force on an atom [eV/Å], [6, d]."""
    most = int(length / shortest)
    line = np.arange(-most, most + 1)
    n = np.stack(np.meshgrid(*[line] * d, indexing="ij"), axis=-1).reshape(-1, d)
    size = np.linalg.norm(n, axis=1)
    kept = (size > 0) & (length / np.maximum(size, 1e-9) > shortest)
    kept &= length / np.maximum(size, 1e-9) <= longest
    stars: dict[tuple[int, ...], list[np.ndarray]] = {}
    for wave in n[kept]:
        stars.setdefault(tuple(sorted(np.abs(wave).tolist(), reverse=True)), []).append(wave)
    names = sorted(stars)
    weight = np.array([1 / np.linalg.norm(name) for name in names])
    k, force = np.zeros((6, d)), np.zeros((6, d), complex)
    for row, pick in enumerate(rng.choice(len(names), size=6, p=weight / weight.sum())):
        star = stars[names[pick]]
        k[row] = 2 * np.pi * star[rng.integers(len(star))] / length
        for axis in range(d):
            phase = rng.uniform(0, 2 * np.pi)
            force[row, axis] = rng.normal() * np.linalg.norm(k[row]) * np.exp(1j * phase)
    return k, force


def watched(
    atoms: ForceConstants, spacing: float, cells: int, collar: int, box: float | None
) -> tuple[Points, np.ndarray, np.ndarray, sp.csr_matrix]:
    """A cube of nodes in a crystal, and what they see of its atoms.

    Args:
        atoms: the crystal.
        spacing: of the nodes [Å].
        cells: interior nodes along an axis.
        collar: nodes around them; none on a period.
        box: period [Å], or None.

    Returns the nodes; positions of atoms, [A, d], and their numbers in the cell; and the weights of
    atoms at nodes, [N, A].
    """
    d = atoms.dimension
    edge = 0 if box is not None else collar + int(CONE) + 1
    line = np.arange(-edge, cells + edge) * spacing
    nodes = np.stack(np.meshgrid(*[line] * d, indexing="ij"), axis=-1).reshape(-1, d)
    x, kind = atoms_around(atoms, nodes, spacing, box)
    smooth = smoothing(x, nodes, CONE * spacing, box)
    from_edge = (np.abs(nodes - (cells - 1) * spacing / 2) / spacing - (cells - 1) / 2).max(axis=1)
    kept = from_edge <= collar + 1e-6
    periods = None if box is None else (box,) * d
    points = Points(nodes[kept], from_edge[kept] < 1e-6, spacing, box=periods)
    return points, x, kind, smooth[kept]


def atoms_around(
    atoms: ForceConstants, nodes: np.ndarray, spacing: float, box: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the atoms that the nodes see, [A, d], and their numbers in the cell."""
    d = atoms.dimension
    edges, reach = atoms.cell[:d, :d], CONE * spacing
    low, high = nodes.min(axis=0) - reach, nodes.max(axis=0) + reach
    if box is not None:
        low, high = np.zeros(d), np.full(d, box)
    corners = np.stack(np.meshgrid(*zip(low, high), indexing="ij"), axis=-1).reshape(-1, d)
    parts = corners @ np.linalg.inv(edges)
    lines = [np.arange(np.floor(a) - 1, np.ceil(b) + 2) for a, b in zip(parts.min(0), parts.max(0))]
    cells = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, d) @ edges
    x = (cells[:, None] + atoms.positions[:, :d]).reshape(-1, d)
    kind = np.tile(np.arange(len(atoms.positions)), len(cells))
    edge = 1e-6 * spacing  # of a period each atom counts once
    inside = ((x >= low - edge) & (x < high - edge)).all(axis=1)
    return x[inside], kind[inside]


def smoothing(
    x: np.ndarray, nodes: np.ndarray, radius: float, length: float | None
) -> sp.csr_matrix:
    """Cone weights of atoms at nodes that sum to 1 over all nodes, [nodes, atoms]."""
    if length is not None:
        nodes, x = nodes % length % length, x % length % length  # -1e-17 % length is length
    trees = [cKDTree(y, boxsize=length) for y in (nodes, x)]
    far = trees[0].sparse_distance_matrix(trees[1], radius, output_type="coo_matrix")
    weight = sp.coo_matrix((radius - far.data, (far.row, far.col)), shape=far.shape).tocsr()
    total = np.asarray(weight.sum(axis=0)).ravel()
    return (weight @ sp.diags(1 / np.where(total > 0, total, 1))).tocsr()


WIDTHS = (10.0, 14.0, 18.0, 22.0, 26.0, 32.0, 40.0)
"""Of supercells [Å], tried in turn."""
NARROW = (5.0, 7.0)
"""Of those before, which tell what memory the first takes, and stand in for it."""
REACHED = 1e-5
"""Force at half the width of a supercell, over the largest, that is none."""
ENDED = 0.05
"""The same of a surface that is rough, whose forces far away are no noise."""
MOST_ATOMS, NOISY_ATOMS = 6000, 700
"""In a supercell; where forces are noisy strains tell moduli better than what is further away."""
FILLED = 0.75
"""Of the memory that there is, which the calculator may take; the rest is for what else runs."""
WITH_IONS = 14.0
"""Width of a supercell [Å] where Born charges take off what reaches further."""
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
    if supercell is not None:
        repeats = tuple(int(n) for n in supercell)
        if len(repeats) != 3 or min(repeats) < 1 or (d == 2 and repeats[2] != 1):
            raise InputError(f"supercell: expected three counts, a sheet's third 1, got {repeats}")
    else:
        widths = WIDTHS if polar is None else (WITH_IONS,)
        repeats = _wide_enough(reference, calculator, widths)
    many = cell.repeat(repeats)
    ions = "" if polar is None else ", and the field of ions by the calculator's Born charges"
    cells = f"{' x '.join(map(str, repeats[:d]))} cells, {len(many)} atoms"
    taken = {"force constants": cells + ions}
    how: Any = {"thickness": reference.thickness, "polar": polar, "stress": reference.stress}
    if reference.noise is not None:
        found, said = rattled(cell, many, calculator, reference.noise, **how)
        check_phonons(found)
        return found, taken | said
    forces, every = forces_of(many, calculator), range(len(cell))
    phi, change = finite_differences(forces, np.array(many.positions), every)
    found = from_supercell(cell, many, phi, every, **how, change=change)
    check_phonons(found)
    return found, taken


def born_charges(reference: Reference, calculator: Any) -> Polar | None:
    """Charges that a calculator gives under ASE's names; None where it has none, or they vanish.

    Raises InputError for those of a sheet, or without the dielectric tensor.
    """
    given = getattr(calculator, "implemented_properties", ())
    if BORN not in given:
        return None
    cell = reference.cell.copy()
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
    return Polar(born, np.asarray(calculator.get_property(DIELECTRIC, cell), dtype=float))


def _wide_enough(reference: Reference, calculator: Any, widths: Sequence[float]) -> tuple[int, ...]:
    """Repeats of the cell at half of whose width forces have ended, or as many as memory holds."""
    cell, d, noise = reference.cell, reference.dimension, reference.noise
    heights = 1 / np.linalg.norm(np.linalg.inv(np.array(cell.cell)), axis=0)
    counts = [np.ceil(width / heights).astype(int) for width in (*NARROW, *widths)]
    for one in counts:
        one[d:] = 1
    if len(widths) == 1:
        return tuple(counts[-1].tolist())
    rim, repeats, ended = np.nan, (1, 1, 1), ""
    with suppress(OSError):  # what was computed before is no part of this peak
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    fullest = _kilobytes("self/status", "VmHWM")
    for number, count in enumerate(counts):
        wider = tuple(count.tolist())
        atoms, narrow = int(np.prod(count)) * len(cell), number < len(NARROW)
        if rim >= 0 and atoms > (MOST_ATOMS if noise is None else NOISY_ATOMS):
            break
        if narrow and wider == repeats:
            continue
        grown = (_kilobytes("self/status", "VmHWM") - fullest) * np.prod(wider) / np.prod(repeats)
        held = _kilobytes("self/status", "VmRSS") + _kilobytes("meminfo", "MemAvailable")
        if repeats != (1, 1, 1) and fullest + grown > FILLED * held:
            ended = f"; {atoms} atoms would need more memory than there is"
            break
        many = cell.repeat(wider)
        forces = forces_of(many, calculator)
        try:
            still = forces(np.array(many.positions))
        except (MemoryError, RuntimeError) as error:  # networks' libraries raise the latter
            if repeats == (1, 1, 1) or not MEMORY.search(f"{type(error).__name__} {error}"):
                raise
            ended = f"; {atoms} atoms need more memory than there is"
            break
        repeats = wider
        if not narrow:
            rim, reached = _at_rim(many, forces, still, (count * heights)[:d].min(), reference)
            if rim <= reached:
                return repeats
    cells = f"{' x '.join(map(str, repeats[:d]))} cells"
    left = f"at half the width of {cells} forces still are {rim:.1e} of the largest"
    left = left if rim >= 0 else f"{cells}, narrower than {widths[0]:g} Å"
    told = f"supercell: {left}{ended or '; supercell=… takes a wider one'}"
    warn(told)
    return repeats


def _at_rim(
    many: ase.Atoms, forces: Any, still: np.ndarray, width: float, reference: Reference
) -> tuple[float, float]:
    """The force at half a supercell's width from a displaced atom, over the largest; none's."""
    noise, x, rim, none = reference.noise, np.array(many.positions), 0.0, REACHED
    part = (x - x[0]) @ np.linalg.inv(np.array(many.cell))
    far = np.linalg.norm((part - np.rint(part)) @ np.array(many.cell), axis=1)
    for axis in range(reference.dimension):
        moved = x.copy()
        moved[0, axis] += STEP if noise is None else noise.length
        change = np.abs(forces(moved) - still).max(axis=1)
        if not change.max() > 0:
            raise InputError(LOOSE)
        rim = max(rim, float(change[far > EDGE * width].max(initial=0.0) / change.max()))
        if noise is not None:
            least = TIMES**2 * noise.force / float(change.max())
            none = max(none, least, ENDED if noise.rough else 0.0)
    return rim, none


def _kilobytes(file: str, name: str) -> float:
    """A figure of memory by Linux; zero elsewhere, where what a cell takes is not foreseen."""
    with suppress(OSError, IndexError):
        text = Path("/proc", file).read_text(encoding="ascii")
        return float(text.partition(f"{name}:")[2].split()[0])
    return 0.0


def check_phonons(atoms: ForceConstants) -> None:
    """Raise InputError for imaginary phonons, with the worst wave vector.

    A grid of waves is looked at, and the edges of the zone with it; a sheet's mean height is held,
    so that its bending is not. Raises it too for parts that feel no force from the rest.
    """
    d = atoms.dimension
    line = np.arange(GRID[d]) / GRID[d]
    parts = np.array(list(itertools.product(line, repeat=d)))
    parts = np.where(parts > 0.5, parts - 1, parts)
    parts = parts[parts @ [1.0, 1e-3, 1e-6][:d] >= 0]
    back, weight, D = _modes(atoms, parts)
    least = np.linalg.eigvalsh(D)
    worst = int(least[:, 0].argmin())
    top = least[:, -2 if d == 2 else -1].max()  # above it is what a mean height is held with
    error = 0.0
    if atoms.doubt is not None and least[worst, 0] < 0:
        wave = np.linalg.eigh(D[worst])[1][:, 0] * weight
        error = float(atoms.stiffness_error(parts[worst] @ back, wave.reshape(-1, 3)))
    if least[worst, 0] >= -max(SOFT * top, TIMES * error):
        stiffest = np.linalg.eigvalsh(atoms.dynamical(parts @ back))[:, 0].max()
        if stiffest <= SOFT * np.abs(atoms.values).max():
            raise InputError(LOOSE)
        return
    k, imaginary = parts[worst] @ back, THZ * np.sqrt(-least[worst, 0])
    told = error > SOFT * top
    bar = f" ± {THZ * error / (2 * np.sqrt(-least[worst, 0])):.2g}" if told else ""
    raise InputError(
        f"structure: expected a stable crystal, got an imaginary phonon, the worst of "
        f"{imaginary:.2f}{bar}i THz at k = {np.round(parts[worst], 4).tolist()} of the reciprocal "
        f"edges ({np.round(k, 4).tolist()} 1/Å); displace atoms along it in a larger cell and relax"
    )


def _modes(atoms: ForceConstants, parts: np.ndarray) -> tuple[np.ndarray, ...]:
    """Reciprocal edges [1/Å], 1/√mass of each coordinate, and D over masses of waves."""
    back = 2 * np.pi * np.linalg.inv(atoms.cell[: atoms.dimension, : atoms.dimension]).T
    weight = 1 / np.sqrt(np.repeat(atomic_masses[atoms.species], 3))
    return back, weight, atoms.dynamical(parts @ back, moving=3) * weight * weight[:, None]


def edge_phonons(atoms: ForceConstants) -> tuple[np.ndarray, ...]:
    """Phonons [THz] of halves of the reciprocal edges and their errors, [K, 3 n], and parts [K]."""
    parts = np.array(list(itertools.product((0, 0.5), repeat=atoms.dimension)))[1:]
    back, weight, D = _modes(atoms, parts)
    size, modes = np.linalg.eigh(D)
    waves = (modes.swapaxes(1, 2) * weight).reshape(*size.shape, -1, 3)
    off = np.array([atoms.stiffness_error(k, one) for k, one in zip(parts @ back, waves)])
    low, middle, high = (THZ * np.sqrt(np.clip(size + way * off, 0, None)) for way in (-1, 0, 1))
    return middle, (high - low) / 2, parts


def at_zone_edge(atoms: ForceConstants) -> tuple[float, float, float]:
    """The softest phonon [THz] of those, its error, and the largest error."""
    size, error, _ = edge_phonons(atoms)
    soft = np.unravel_index(size.argmin(), size.shape)
    return float(size[soft]), float(error[soft]), float(error.max())
