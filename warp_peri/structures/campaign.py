"""Loads on a crystal's atoms, held in equilibrium by their calculator, as nodes see them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.points.samples import Samples
from warp_peri.structures.phonons import forces_of
from warp_peri.structures.rest import Reference
from warp_peri.structures.waves import EV_IN_TPA, watched

INTERIOR, LOADS, WAVES = {2: 16, 3: 8}, {2: 24, 3: 10}, 6
"""Nodes along an axis where equilibrium is asked, loads, and waves of each."""
PERIOD, SHORTEST = {2: 18.0, 3: 9.0}, 2.7
"""Of the supercell, and the shortest wave, in spacings."""
STRAIN = 2e-3
"""Largest sum of |k| |u| over the waves of a load."""
QUIET, TRIES = 1e-6, 60
"""Forces left, over the largest of the load, and the steps that may take."""


def load_campaign(
    reference: Reference,
    atoms: ForceConstants,
    calculator: Any,
    spacing: float,
    horizon: float,
    *,
    seed: int = 0,
) -> Samples:
    """Displacement and load on nodes of a supercell under waves of force, relaxed.

    The force constants give each step of the relaxation and are no part of its answer.

    Args:
        reference, atoms: the crystal at rest and its force constants.
        calculator: with forces.
        spacing, horizon: of the nodes, and of the law that the collar is to carry [Å].
        seed: of the loads.

    Raises InputError where a load does not come to rest.
    """
    d, cell = reference.dimension, reference.cell
    edges = np.array(cell.cell)
    heights = 1 / np.linalg.norm(np.linalg.inv(edges), axis=0)
    counts = np.ceil(PERIOD[d] * spacing / heights).astype(int)
    counts[d:] = 1
    many = cell.repeat(tuple(counts.tolist()))
    x = np.array(many.positions)
    k, to_waves, from_waves = _transforms(atoms, counts, x)
    D = atoms.dynamical(k[:, :d])
    flexible = np.empty_like(D)
    flexible[1:] = np.linalg.inv(D[1:])
    flexible[0] = np.linalg.pinv(D[0], rcond=1e-6, hermitian=True)  # translations stay
    forces = forces_of(many, calculator)
    still = forces(x)
    pushes, answers = [], []
    rng = np.random.default_rng(seed)
    for _ in range(LOADS[d]):
        push = _push(rng, k[:, :d], x[:, :d], d, spacing)
        u = _answer(flexible, to_waves, from_waves, push, atoms.moving)
        push *= STRAIN / _steepest(u, k, to_waves)
        u *= 0.0
        for _ in range(TRIES):
            left = forces(x + u) - still + push
            left -= left.mean(axis=0)
            if d == 2:  # a sheet's mean height is held
                whole = left.reshape(-1, len(cell), 3)
                whole[:, :, 2] -= whole[:, :, 2].mean(axis=1, keepdims=True)
            if np.abs(left).max() <= QUIET * np.abs(push).max():
                break
            u += _answer(flexible, to_waves, from_waves, left, atoms.moving)
        else:
            raise InputError(
                f"loads: a load of strain {STRAIN} does not come to rest; learn from phonons"
            )
        pushes.append(push[:, :d])
        answers.append(u[:, :d] - u[:, :d].mean(axis=0))
    return _seen(atoms, counts, np.array(answers), np.array(pushes), spacing, horizon)


def _transforms(
    atoms: ForceConstants, counts: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """Waves of a supercell [K, 3], and what takes fields [A, m] to their amplitudes and back."""
    n = len(atoms.positions)
    shape = tuple(counts.tolist())
    parts = np.stack(np.meshgrid(*(np.fft.fftfreq(c) for c in counts), indexing="ij"), axis=-1)
    k = 2 * np.pi * parts.reshape(-1, 3) @ np.linalg.inv(atoms.cell).T
    phase = np.exp(-1j * k @ atoms.positions.T)[:, :, None]  # [K, n, 1]

    def to_waves(field: np.ndarray) -> np.ndarray:
        cells = field.reshape(*shape, n, -1)
        return np.asarray(np.fft.fftn(cells, axes=(0, 1, 2)).reshape(len(k), n, -1) * phase)

    def from_waves(amplitude: np.ndarray) -> np.ndarray:
        cells = (amplitude / phase).reshape(*shape, n, -1)
        return np.asarray(np.fft.ifftn(cells, axes=(0, 1, 2)).real.reshape(len(x), -1))

    return k, to_waves, from_waves


def _answer(
    flexible: np.ndarray,
    to_waves: Callable[..., np.ndarray],
    from_waves: Callable[..., np.ndarray],
    force: np.ndarray,
    m: int,
) -> np.ndarray:
    """Displacement [A, 3] of atoms whose force constants are all there is."""
    waves = to_waves(force[:, :m])
    moved = np.einsum("kab,kb->ka", flexible, waves.reshape(len(waves), -1))
    u = np.zeros((len(force), 3))
    u[:, :m] = from_waves(moved.reshape(waves.shape))
    return u


def _steepest(u: np.ndarray, k: np.ndarray, to_waves: Callable[..., np.ndarray]) -> float:
    """Σ |k| |u| over waves, of the mean of a cell's atoms."""
    amplitude = to_waves(u).mean(axis=1) / len(k)
    return float((np.linalg.norm(k, axis=1) * np.linalg.norm(amplitude, axis=1)).sum())


def _push(
    rng: np.random.Generator, k: np.ndarray, x: np.ndarray, d: int, spacing: float
) -> np.ndarray:
    """A force on every atom [eV/Å], [A, 3], of a few waves of the supercell."""
    size = np.linalg.norm(k, axis=1)
    fits = np.flatnonzero((size > 0) & (size < 2 * np.pi / (SHORTEST * spacing)))
    weight = size[fits] ** -(d - 1.0)  # every length as often as any other
    push = np.zeros((len(x), 3))
    for pick in rng.choice(fits, size=WAVES, p=weight / weight.sum()):
        wave = np.cos(x @ k[pick] + rng.uniform(0, 2 * np.pi))
        push[:, :d] += np.outer(wave, size[pick] * rng.normal(size=d))
    push -= push.mean(axis=0)
    return push


def _seen(
    atoms: ForceConstants,
    counts: np.ndarray,
    u: np.ndarray,
    force: np.ndarray,
    spacing: float,
    horizon: float,
) -> Samples:
    """Smoothed on nodes: an interior, and a collar of twice the horizon."""
    d, n = atoms.dimension, len(atoms.positions)
    collar = int(np.ceil(2 * horizon / spacing - 1e-9))
    points, x, kind, smooth = watched(atoms, spacing, INTERIOR[d], collar, None)
    cell = np.rint((x - atoms.positions[kind, :d]) @ np.linalg.inv(atoms.cell[:d, :d])).astype(int)
    number = np.ravel_multi_index(tuple((cell % counts[:d]).T), tuple(counts[:d])) * n + kind
    density = np.asarray(smooth.sum(axis=1))
    share = EV_IN_TPA / (spacing**d * (atoms.thickness or 1.0))
    displacement = np.array([smooth @ field[number] / density for field in u])
    load = np.array([share * (smooth @ field[number]) for field in force])
    return Samples(points, displacement, load)
