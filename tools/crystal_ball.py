"""Bodies of atoms under load, relaxed by LAMMPS, and what nodes see of them."""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import ase
import numpy as np
import scipy.fft
from scipy.spatial import cKDTree

from tools.crystals import RECIPES, session
from tools.lammps_session import SolidSession
from warp_peri import Points, Samples
from warp_peri.atoms.calculator_noise import EV_IN_TPA
from warp_peri.atoms.force_constants import ForceConstants
from warp_peri.atoms.phonons import CONE, smoothing
from warp_peri.core.groups import point_group

RADIUS, SEEN, INNER = 11.0, 8.6, 5.5
"""Of the ball, of the nodes that are smoothed cleanly, and of the unknowns, in spacings."""
TOLERANCE = 1e-6
BONDED = {"Si": 0.5, "Ge": 0.5}
"""Of the spacing: atoms closer than that are bonded, where few bonds can be left."""
PUSH = 1e-5
"""Largest displacement of the differences that stand for a product with the Hessian [Å]."""
LIMIT = 600
NEAR_REST, REST, NEWTON = 0.3, 1e-7, 8
"""Norms of the forces [eV/Å] where descent ends and Newton's method does, and its steps."""


@dataclass(frozen=True)
class Ball:
    """What nodes see of a free ball of atoms.

    `samples`: displacement [Å] and load [TPa/Å], interior 5.5 spacings. The spacing is that of the
    crystal as its surface has squeezed it; `strain`: of the inside at rest along the axes, shape
    [3]; `atoms`: at rest [Å], shape [A, 3]; `forces`: on them [eV/Å], shape [S, A, 3].
    """

    samples: Samples
    strain: np.ndarray
    atoms: np.ndarray
    forces: np.ndarray


def ball(name: str, constants: ForceConstants, spacing: float, *, loads: int = 5) -> Ball:
    """A relaxed free ball under loads.

    Nodes are around an atom; smoothed with a cone of two spacings. The period's own force constants
    precondition the answer, and are no part of it.
    """
    h = spacing
    atoms, cells = cut(constants, RADIUS * h)
    kept = np.linalg.norm(atoms.positions, axis=1) <= RADIUS * h
    for _ in range(4):  # atoms of the edge that hang by one bond
        inside = np.flatnonzero(kept)
        x = atoms.positions[inside]
        near = cKDTree(x).query_ball_point(x, BONDED.get(name, 1.0) * h)
        kept[inside[[len(others) - 1 < 2 for others in near]]] = False
    sites, atoms = np.flatnonzero(kept), atoms[kept]
    x = atoms.positions
    inside = np.linalg.norm(x, axis=1) < INNER * h
    filtered = lattice_inverse(constants, cells, sites)
    with session(name, atoms, free=True) as lammps:
        rest = at_rest(lammps, filtered, lambda y, f: _without(f, _rigid(y)))
        slope = np.linalg.lstsq(x[inside], (rest - x)[inside])[0]
        group = point_group(RECIPES[name].symmetry, 3)  # the ball is not quite as symmetric
        strain = np.diag((group @ slope @ group.transpose(0, 2, 1)).mean(axis=0))
        rigid = _rigid(rest)
        pushes = [_without(push, rigid) for push in _loads(rest, RADIUS * h, INNER * h)[:loads]]
        pull = stiffness(lammps, rest)

        def free(v: np.ndarray) -> np.ndarray:
            return _without(v, rigid)

        answers = [response(pull, filtered, push, free) for push in pushes]
    h *= float(np.prod(1 + strain) ** (1 / 3))
    points, smooth = seen(rest, h, SEEN, INNER)
    density = np.asarray(smooth.sum(axis=1))
    u = np.array([(smooth @ answer) / density for answer in answers])
    b = np.array([smooth @ push for push in pushes]) * (EV_IN_TPA / h**3)
    return Ball(Samples(points, u, b), strain, rest, np.array(pushes))


def cut(constants: ForceConstants, radius: float) -> tuple[ase.Atoms, tuple[int, ...]]:
    """Whole cells around an atom that hold a ball [Å], and how many each way."""
    edges = np.diag(constants.cell)
    side = np.ceil(radius / edges).astype(int) + 1
    cell = ase.Atoms(constants.species, positions=constants.positions, cell=edges)
    atoms = cell.repeat(tuple(2 * side))
    atoms.positions -= constants.positions[0] + side * edges
    return atoms, tuple((2 * side).tolist())


def seen(x: np.ndarray, h: float, clean: float, inner: float) -> tuple[Points, np.ndarray]:
    """Nodes around the middle whose cones atoms at x [Å] fill, and the cones, [nodes, atoms]."""
    side = int(RADIUS) + 3
    line = np.arange(-side, side + 1) * h
    nodes = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    far = np.linalg.norm(nodes, axis=1)
    kept = far <= clean * h
    return Points(nodes[kept], far[kept] <= inner * h, h), smoothing(x, nodes, CONE * h, None)[kept]


def at_rest(
    lammps: SolidSession,
    filtered: Callable[[np.ndarray], np.ndarray],
    free: Callable[[np.ndarray, np.ndarray], np.ndarray],
    held: np.ndarray | None = None,
) -> np.ndarray:
    """Positions [Å] without forces: near them by LAMMPS's descent, and then by Newton's method.

    free takes positions and leaves of forces what atoms may follow.
    """
    x = lammps.relax(NEAR_REST, held=held)
    for _ in range(NEWTON):
        force = free(x, lammps.forces(x))
        if np.linalg.norm(force) < REST:
            return x
        x = x + response(
            stiffness(lammps, x), filtered, force, functools.partial(free, x), tolerance=1e-3
        )
    raise RuntimeError(f"the atoms did not settle in {NEWTON} steps of Newton's method")


def stiffness(lammps: SolidSession, rest: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Products with the Hessian at rest [eV/Å²], by differences of forces."""
    lammps.forces(rest)
    still = lammps.nearby_forces(rest)

    def product(v: np.ndarray) -> np.ndarray:
        scale = PUSH / np.abs(v).max()
        return (still - lammps.nearby_forces(rest + scale * v)) / scale

    return product


def lattice_inverse(
    constants: ForceConstants, cells: tuple[int, ...], sites: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """What a period of so many cells each way answers to forces on some of its atoms, at these."""
    count, edges = len(constants.positions), np.diag(constants.cell)
    lines = [np.fft.fftfreq(n) for n in cells[:2]] + [np.fft.rfftfreq(cells[2])]
    k = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3) * (2 * np.pi / edges)
    phase = np.exp(1j * (k @ constants.positions.T)).repeat(3, axis=1)
    table = np.empty((len(k), 3 * count, 3 * count), np.complex64)
    for block in np.array_split(np.arange(len(k)), len(k) // 500 + 1):
        D = constants.dynamical(k[block])
        if block[0] == 0:  # the mean is free: as stiff as the softest wave
            D[0] += np.linalg.eigvalsh(D[1])[0] * np.eye(3 * count)
        # atoms of a cell in the phase of their cell, as the transform has them
        inner = np.linalg.inv(D) * phase[block][:, :, None] * phase[block].conj()[:, None, :]
        table[block] = inner
    shape = (*cells, 3 * count)

    def apply(r: np.ndarray) -> np.ndarray:
        field = np.zeros((int(np.prod(cells)) * count, 3), np.float32)
        field[sites] = r
        wave = scipy.fft.rfftn(field.reshape(shape), axes=(0, 1, 2))
        wave = (table @ wave.reshape(len(k), -1, 1)).reshape(wave.shape)
        back = scipy.fft.irfftn(wave, s=shape[:3], axes=(0, 1, 2))
        return back.reshape(-1, 3)[sites].astype(float)

    return apply


def _rigid(x: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the six rigid motions, shape [3 A, 6]."""
    shift = np.tile(np.eye(3), (len(x), 1))
    turn = np.cross(x[:, None], np.eye(3)[None]).transpose(0, 2, 1).reshape(-1, 3)
    return np.linalg.qr(np.hstack([shift, turn]))[0]


def _without(v: np.ndarray, rigid: np.ndarray) -> np.ndarray:
    flat = v.ravel()
    return (flat - rigid @ (rigid.T @ flat)).reshape(v.shape)


def _loads(x: np.ndarray, R: float, inner: float) -> list[np.ndarray]:
    """Forces on the atoms [eV/Å]: pulled at two poles, squeezed, sheared, at random, and inside."""
    rng = np.random.default_rng(7)
    r = np.linalg.norm(x, axis=1)
    e = x / np.maximum(r, 1e-9)[:, None]
    edge = (r > inner)[:, None]
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)

    def spot(middle: np.ndarray, width: float) -> np.ndarray:
        return np.exp(-((x - middle) ** 2).sum(axis=1) / (2 * width**2))[:, None]

    pole = 0.85 * R * np.array([0, 0, 1.0])
    pull = (spot(pole, 0.2 * R) - spot(-pole, 0.2 * R)) * np.array([0, 0, 1.0]) * edge
    squeeze = e * ((e @ axis) ** 2 - 1 / 3)[:, None] * edge
    shear = np.stack([x[:, 1], x[:, 0], 0 * r], axis=1) / R
    shear = shear * edge * (1 + np.cos(np.pi * x[:, 2:] / R))
    k = rng.normal(size=(8, 3))
    k *= (2 * np.pi / (R * rng.uniform(0.5, 1.2, 8)) / np.linalg.norm(k, axis=1))[:, None]
    random = np.zeros_like(x)
    for wave in k:
        random += rng.normal(size=3) * np.cos(x @ wave + rng.uniform(0, 2 * np.pi))[:, None]
    inside = spot(0.2 * R * axis, 0.12 * R) - spot(-0.2 * R * axis, 0.12 * R)
    return [pull, squeeze, shear, random, inside * np.roll(axis, 1)]


def response(
    stiffness: Callable[[np.ndarray], np.ndarray],
    filtered: Callable[[np.ndarray], np.ndarray],
    force: np.ndarray,
    free: Callable[[np.ndarray], np.ndarray],
    tolerance: float = TOLERANCE,
) -> np.ndarray:
    """u with H u = force among what is free, a projection, by conjugate gradients."""
    u, r = np.zeros_like(force), free(force)
    z = free(filtered(r))
    p, rz = z.copy(), float(np.vdot(r, z))
    goal = tolerance * float(np.linalg.norm(r))
    for _ in range(LIMIT):
        q = free(stiffness(p))
        step = rz / float(np.vdot(p, q))
        u += step * p
        r -= step * q
        if np.linalg.norm(r) < goal:
            return free(u)
        z = free(filtered(r))
        last, rz = rz, float(np.vdot(r, z))
        p = z + (rz / last) * p
    raise RuntimeError(f"the atoms did not settle in {LIMIT} iterations")
