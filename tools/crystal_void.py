"""A spherical void in a crystal held outside: atoms by LAMMPS, and a law with elements around it.

Micromodulus tensors do not bear cut bonds (theory, T16), so that a shell of curved quadratic
elements with the law's own moduli lies around the void. Shell and nodes hand displacement to each
other until they agree, as the rim and bulk of a sheet do (theory, B5).
"""

import functools
import itertools
import operator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import splu

from tools.crystal_ball import at_rest, cut, lattice_inverse, response, seen, stiffness
from tools.crystals import session
from warp_peri import Points, Samples
from warp_peri.atoms.force_constants import ForceConstants
from warp_peri.atoms.phonons import CONE, relative
from warp_peri.micromodulus import Crystal

VOID, HELD, INNER = 2.6, 10.6, 7.0
"""Radii of the void, of the atoms that are held, and of the unknown nodes, in spacings."""
MARGIN, OVERLAP = 0.2, 1.6
"""Between shell and collar of the nodes, and of the part that both solve for, in spacings."""
STRAINS = (
    np.diag([0.0, 0.0, 1.0]),
    np.array([[0, 1.0, 0], [1, 0, 0], [0, 0, 0]]) / 2,
    np.array([[0.6, 0.2, -0.1], [0.2, -0.5, 0.3], [-0.1, 0.3, 0.1]]),
)
SIDES, LAYERS = 4, 3
"""Of the shell's elements: along an edge of the cube around it, and from inside out."""
EXCHANGES, AGREED = 60, 1e-6


@dataclass(frozen=True)
class Void:
    """What nodes see of a strained crystal with a void.

    `samples`: without load; interior nodes out to INNER; `radius`: of a sphere with the volume of
    the atoms that are missing [Å].
    """

    samples: Samples
    radius: float


def void(name: str, constants: ForceConstants, spacing: float) -> Void:
    """Atoms out to two spacings beyond HELD, those beyond it strained, the others relaxed."""
    h = spacing
    atoms, cells = cut(constants, (HELD + CONE) * h)
    far = np.linalg.norm(atoms.positions, axis=1)
    kept = (far > VOID * h) & (far <= (HELD + CONE) * h)
    sites, missing = np.flatnonzero(kept), np.count_nonzero(far <= VOID * h)
    atoms = atoms[kept]
    x, held = atoms.positions, far[kept] > HELD * h
    filtered = lattice_inverse(constants, cells, sites)

    def free(v: np.ndarray) -> np.ndarray:
        return np.where(held[:, None], 0.0, v)

    with session(name, atoms, free=True) as lammps:
        rest = at_rest(lammps, filtered, lambda _, f: free(f), np.flatnonzero(held))
        pull = stiffness(lammps, rest)
        answers = []
        for strain in STRAINS:
            affine = x @ strain
            answers.append(affine + response(pull, filtered, free(-pull(affine)), free))
    points, smooth = seen(x, h, HELD - 0.1, INNER)
    away = np.linalg.norm(points.x, axis=1) >= (VOID + CONE) * h  # cones that the void cuts not
    density = np.asarray(smooth[away].sum(axis=1))
    u = np.array([(smooth[away] @ answer) / density for answer in answers])
    volume = missing * constants.volume / len(constants.positions)
    nodes = Points(points.x[away], points.interior[away], h)
    return Void(Samples(nodes, u, np.zeros_like(u)), float((3 * volume / (4 * np.pi)) ** (1 / 3)))


def void_error(law: Crystal, found: Void) -> float | None:
    """Mean E_u [%] on the nodes within INNER that are seen cleanly, u given on those beyond.

    None for a law that reaches further than the nodes that are given.
    """
    h, seen = law.spacing, found.samples
    if law.horizon > (HELD - INNER) * h:
        return None
    collar = found.radius / h + MARGIN
    near = collar + law.horizon / h  # unknown nodes from here on
    shell = Shell(law.tensor(), found.radius, (near + OVERLAP) * h)
    side = int(np.ceil(HELD + law.horizon / h)) + 1
    line = np.arange(-side, side + 1)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    far = np.linalg.norm(grid, axis=1)
    body = (far >= collar) & (far <= np.linalg.norm(seen.x, axis=1).max() / h + 1e-9)
    x, far = h * grid[body], far[body]
    inside = (far >= near) & (far <= INNER + 1e-9)
    placed = law.on(Points(x, inside, h))
    given = np.zeros((len(seen.u), len(x), 3))
    place = np.full(len(grid), -1)
    place[body] = np.arange(len(x))
    number = np.rint(seen.x / h).astype(int) + side
    where = place[np.ravel_multi_index(tuple(number.T), (2 * side + 1,) * 3)]
    given[:, where] = seen.u  # those of unknown nodes are not read
    by_shell = far < near
    probe = shell.probe(x[by_shell])
    b = np.zeros_like(given)
    u, last = given.copy(), None
    for _ in range(EXCHANGES):
        edge = np.array([_interpolated(one, place, side, shell.outer / h) for one in u])
        now = shell.solve(edge)
        u[:, by_shell] = np.einsum("xn,snd->sxd", probe.toarray(), now)
        u = placed.rest(b, u).u
        if last is not None and np.linalg.norm(now - last) < AGREED * np.linalg.norm(now):
            break
        last = now
    else:
        raise RuntimeError(f"shell and nodes did not agree in {EXCHANGES} exchanges")
    return relative(u[:, where], seen.u, seen.interior)


def _interpolated(u: np.ndarray, place: np.ndarray, side: int, at: np.ndarray) -> np.ndarray:
    """Cubic splines of nodes at positions in spacings, [n, 3]; nodes that are none count as 0."""
    size = 2 * side + 1
    box = np.where(place[:, None] >= 0, u[place], 0.0).reshape(size, size, size, 3)
    return np.stack(
        [map_coordinates(box[..., a], (at + side).T, order=3) for a in range(3)], axis=1
    )


class Shell:
    """Quadratic elements between two spheres, the inner one free; factorised once.

    `elastic`: C_ijkl; `inner`, `outer`: radii.
    """

    def __init__(self, elastic: np.ndarray, inner: float, outer: float) -> None:
        cubes, element = _nested_cubes(), skfem.ElementHex2()
        curved = skfem.MeshHex2.from_mesh(cubes)
        self.inner, self.growth = inner, outer / inner
        curved = replace(curved, doflocs=self._swollen(curved.doflocs))
        self.basis = skfem.Basis(curved, skfem.ElementVector(element), intorder=4)
        self.scalar = skfem.Basis(cubes, element, intorder=4)

        def energy(u: Any, v: Any, w: Any) -> Any:
            return np.einsum("ijkl,kl...,ij...->...", elastic, u.grad, v.grad)

        K = sp.csc_array(skfem.BilinearForm(energy).assemble(self.basis))
        x = self.basis.doflocs
        self.edge = np.flatnonzero(np.linalg.norm(x, axis=0) > outer * (1 - 1e-6))
        self.free = np.setdiff1d(np.arange(x.shape[1]), self.edge)
        self.outer = x[:, self.edge[::3]].T
        self.push = K[self.free][:, self.edge]
        inner_part = sp.csc_matrix(K[self.free][:, self.free])
        self.factor = splu(
            inner_part,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def solve(self, edge: np.ndarray) -> np.ndarray:
        """Displacement of the nodes [S, n, 3] for that of the outer ones, [S, outer, 3]."""
        flat = edge.reshape(len(edge), -1)
        u = np.zeros((len(edge), self.basis.N))
        u[:, self.edge] = flat
        u[:, self.free] = self.factor.solve(-(self.push @ flat.T)).T
        return u.reshape(len(edge), -1, 3)

    def _swollen(self, x: np.ndarray) -> np.ndarray:
        """Spheres of nested cubes, [3, n]."""
        depth = np.abs(x).max(axis=0)
        way = np.tan(np.pi / 4 * x / depth)
        size = self.inner * self.growth ** (depth - 1)
        return np.asarray(size * way / np.linalg.norm(way, axis=0))

    def probe(self, x: np.ndarray) -> sp.csr_matrix:
        """Values at positions [m, 3] of nodal ones, [m, n], quadratic on the cubes."""
        depth = 1 + np.log(np.linalg.norm(x, axis=1) / self.inner) / np.log(self.growth)
        flat = np.arctan(x / np.abs(x).max(axis=1, keepdims=True)) * (4 / np.pi)
        return self.scalar.probes((depth[:, None] * flat).T)


def _nested_cubes() -> skfem.MeshHex:
    """Elements between the cubes of side 2 and 4, face by face."""
    line, layer = np.linspace(-1, 1, SIDES + 1), np.linspace(1, 2, LAYERS + 1)
    block = skfem.MeshHex.init_tensor(layer, line, line)
    corner = block.p[:1] * np.vstack([np.ones_like(block.p[:1]), block.p[1:]])
    faces = itertools.product(range(3), (1, -1))
    return functools.reduce(
        operator.add,
        (skfem.MeshHex(np.roll(sign * corner, axis, 0), block.t) for axis, sign in faces),
    )
