"""Loads of waves on a crystal, what its atoms answer, and what nodes see of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.micromodulus.law import Crystal
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import STRESSES

EV_IN_TPA = STRESSES["eV/angstrom^3"]
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
) -> Loads:
    """Loads of six waves each with wavelengths between two bounds, in spacings, smoothed on nodes.

    Waves are a period's of PERIOD nodes. Of a cubic cell as large as the spacing the nodes are that
    period's, else a part of it with a collar that is given.

    Args:
        atoms: all of the crystal, which answers as its force constants say.
        spacing: of the nodes [Å].
    """
    d, count = atoms.dimension, len(atoms.positions)
    length = PERIOD * spacing
    cells_across = length * np.linalg.inv(atoms.cell[:d, :d])
    in_step = bool(np.abs(cells_across - np.rint(cells_across)).max() < 1e-6)
    cells, collar = (PERIOD, 0) if in_step else (PART[d], COLLAR)
    rng = np.random.default_rng(seed)
    k, force = zip(
        *(random_waves(rng, d, length, longest * spacing, shortest * spacing) for _ in range(loads))
    )
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
