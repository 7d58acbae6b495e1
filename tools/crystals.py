"""Crystals whose potentials come with LAMMPS: constants of force, and what their atoms answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import ase
import ase.build
import numpy as np
import scipy.sparse as sp
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from tools.solid_session import SolidSession
from warp_peri.micromodulus.force_constants import (
    ForceConstants,
    finite_differences,
    from_supercell,
)
from warp_peri.points.unit_names import STRESSES

EV_IN_TPA = STRESSES["eV/angstrom^3"]


@dataclass(frozen=True)
class Recipe:
    """Where a crystal's atoms lie and what holds them together.

    Attributes:
        structure: as ase.build.bulk names it.
        guess: lattice parameter [Å].
        style, potential: of LAMMPS.
        repeats: cells of the supercell that force constants are made on.
    """

    structure: str
    guess: float
    style: str
    potential: str
    repeats: int


RECIPES = {
    "Cu": Recipe("fcc", 3.615, "eam/alloy", "Cu_mishin1.eam.alloy", 8),
    "Al": Recipe("fcc", 4.08, "eam/alloy", "Al_zhou.eam.alloy", 10),
    "Ni": Recipe("fcc", 3.52, "eam/alloy", "NiAlH_jea.eam.alloy", 9),
    "W": Recipe("bcc", 3.165, "eam/alloy", "W_zhou.eam.alloy", 13),
    "Fe": Recipe("bcc", 2.855, "eam/fs", "Fe_mm.eam.fs", 9),
    "Si": Recipe("diamond", 5.431, "sw", "Si.sw", 4),
}


def structure(name: str, a: float) -> ase.Atoms:
    """The cubic cell of a crystal with lattice parameter a [Å]."""
    return ase.build.bulk(name, RECIPES[name].structure, a=a, cubic=True)


def session(name: str, positions: np.ndarray, box: list[float] | None) -> SolidSession:
    """Atoms of a crystal in LAMMPS."""
    recipe = RECIPES[name]
    return SolidSession(
        positions, box=box, style=recipe.style, potential=recipe.potential, elements=name
    )


def lattice_parameter(name: str) -> float:
    """Where the energy of a cell is least [Å]."""
    guess = RECIPES[name].guess
    repeats = int(np.ceil(12.0 / guess))

    def energy(a: float) -> float:
        atoms = structure(name, a).repeat(repeats)
        with session(name, atoms.positions, list(np.diag(atoms.cell))) as lammps:
            return lammps.energy() / len(atoms)

    for _ in range(2):
        steps = guess * 0.004 * np.linspace(-1, 1, 9)
        slope = np.polyder(np.polyfit(steps, [energy(guess + step) for step in steps], 5))
        reach = 3 * steps[-1]
        guess += float(brentq(lambda step, c=slope: np.polyval(c, step), -reach, reach))
    return guess


def force_constants(name: str, a: float) -> ForceConstants:
    """Of the cubic cell, by finite differences on a supercell."""
    cell = structure(name, a)
    supercell = cell.repeat(RECIPES[name].repeats)
    with session(name, supercell.positions, list(np.diag(supercell.cell))) as lammps:
        lammps.forces(supercell.positions)
        phi = finite_differences(lammps.nearby_forces, supercell.positions, range(len(cell)))
    return from_supercell(cell, supercell, phi, range(len(cell)))


# ------------------------------------------------------------------ periodic loads


@dataclass
class Waves:
    """Atoms of a period under loads, seen from nodes, as amplitudes at the waves of the nodes.

    Attributes:
        k: [1/Å], shape [K, 3], the first of them 0.
        u: of smoothed displacement [Å], shape [S, K, 3].
        b: of load density [TPa/Å].
    """

    k: np.ndarray
    u: np.ndarray
    b: np.ndarray

    def errors(self, symbol: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
        """Means of E_res and E_u [%] of a law with this symbol, k [K, 3] to [K, 3, 3]."""
        D = symbol(self.k)
        D[0] = np.eye(3)
        u, b = self.u[:, 1:], self.b[:, 1:]
        left = np.einsum("kij,skj->ski", D[1:], u) - b
        solved = np.einsum("kij,skj->ski", np.linalg.inv(D[1:]), b)
        sizes = [np.linalg.norm(x.reshape(len(u), -1), axis=1) for x in (left, b, solved - u, u)]
        return float(100 * (sizes[0] / sizes[1]).mean()), float(100 * (sizes[2] / sizes[3]).mean())


def random_waves(
    rng: np.random.Generator, x: np.ndarray, length: float, longest: float, shortest: float
) -> np.ndarray:
    """Forces on atoms [eV/Å]: six waves with wavelengths between two bounds [Å], shape [A, 3]."""
    most = int(length / shortest)
    line = np.arange(-most, most + 1)
    n = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    size = np.linalg.norm(n, axis=1)
    kept = (size > 0) & (length / np.maximum(size, 1e-9) > shortest)
    kept &= length / np.maximum(size, 1e-9) <= longest
    stars: dict[tuple[int, ...], list[np.ndarray]] = {}
    for wave in n[kept]:
        stars.setdefault(tuple(sorted(np.abs(wave).tolist(), reverse=True)), []).append(wave)
    names = sorted(stars)
    weight = np.array([1 / np.linalg.norm(name) for name in names])
    force = np.zeros_like(x)
    for pick in rng.choice(len(names), size=6, p=weight / weight.sum()):
        star = stars[names[pick]]
        k = 2 * np.pi * star[rng.integers(len(star))] / length
        for axis in range(3):
            phase = rng.uniform(0, 2 * np.pi)
            force[:, axis] += rng.normal() * np.linalg.norm(k) * np.cos(x @ k + phase)
    return force - force.mean(axis=0)


def waves(
    atoms: ForceConstants, cells: int, *, longest: float, shortest: float, loads: int, seed: int
) -> Waves:
    """What a period of so many cells each way answers to random loads, one node a cell.

    Wavelengths are in lattice parameters. Smoothed with a cone of two spacings.
    """
    a, basis = float(atoms.cell[0, 0]), atoms.positions
    count, length = len(basis), cells * float(atoms.cell[0, 0])
    line = np.arange(cells) * a
    corner = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    x = (corner[:, None] + basis).reshape(-1, 3)
    rng = np.random.default_rng(seed)
    force = np.array(
        [random_waves(rng, x, length, longest * a, shortest * a) for _ in range(loads)]
    )
    number = np.fft.fftfreq(cells) * 2 * np.pi / a
    k = np.stack(np.meshgrid(number, number, number, indexing="ij"), axis=-1).reshape(-1, 3)
    amplitude = _amplitudes(force, x, basis, k, cells)
    moved = np.zeros_like(amplitude)
    flat = amplitude.reshape(loads, len(k), -1)
    for block in np.array_split(np.arange(1, len(k)), max(1, len(k) // 500)):
        D = atoms.dynamical(k[block])
        moved[:, block] = (
            np.linalg.solve(D, flat[:, block].transpose(1, 2, 0))
            .transpose(2, 0, 1)
            .reshape(loads, len(block), count, 3)
        )
    displacement = _from_amplitudes(moved, basis, k, cells)
    smooth = smoothing(x, corner, 2 * a, length)
    density = np.asarray(smooth.sum(axis=1)).ravel()

    def seen(fields: np.ndarray) -> np.ndarray:
        flat = smooth @ fields.transpose(1, 0, 2).reshape(len(x), -1)
        return flat.reshape(len(corner), loads, 3).transpose(1, 0, 2)

    u = seen(displacement) / density[:, None]
    b = seen(force) * (EV_IN_TPA / a**3)
    shape = (loads, cells, cells, cells, 3)
    transform = [
        np.fft.fftn(f.reshape(shape), axes=(1, 2, 3)).reshape(loads, -1, 3) for f in (u, b)
    ]
    return Waves(k, *transform)


def _amplitudes(
    fields: np.ndarray, x: np.ndarray, basis: np.ndarray, k: np.ndarray, cells: int
) -> np.ndarray:
    """Σ over cells of fields e^(−i k·x) with the phases of atoms' positions, [S, K, n, 3]."""
    count = len(basis)
    grid = fields.reshape(len(fields), cells, cells, cells, count, 3)
    wave = np.fft.fftn(grid, axes=(1, 2, 3)).reshape(len(fields), -1, count, 3)
    return wave * np.exp(-1j * (k @ basis.T))[None, :, :, None]


def _from_amplitudes(wave: np.ndarray, basis: np.ndarray, k: np.ndarray, cells: int) -> np.ndarray:
    """The fields of amplitudes, [S, A, 3]."""
    count = len(basis)
    wave = wave * np.exp(1j * (k @ basis.T))[None, :, :, None]
    grid = wave.reshape(len(wave), cells, cells, cells, count, 3)
    return np.fft.ifftn(grid, axes=(1, 2, 3)).real.reshape(len(wave), -1, 3)


def smoothing(
    x: np.ndarray, nodes: np.ndarray, radius: float, length: float | None
) -> sp.csr_matrix:
    """Cone weights of atoms at nodes that sum to 1 over all nodes, [nodes, atoms]."""
    trees = [cKDTree(y if length is None else y % length, boxsize=length) for y in (nodes, x)]
    far = trees[0].sparse_distance_matrix(trees[1], radius, output_type="coo_matrix")
    weight = sp.coo_matrix((radius - far.data, (far.row, far.col)), shape=far.shape).tocsr()
    total = np.asarray(weight.sum(axis=0)).ravel()
    return (weight @ sp.diags(1 / np.where(total > 0, total, 1))).tocsr()
