"""Small materials of one's own: sheets of pair forces, harmonic about rest, with their statics.

A triangular lattice of Lennard-Jones atoms, and a network of springs some of which are weak: what a
new user might bring, with the stiffness known from the lattice itself. Printed: what fits leave.
"""

import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import scipy.sparse as sp
from scipy.optimize import minimize_scalar
from scipy.sparse.linalg import splu

import warp_peri as wp
from warp_peri.cli.main import main as command

THICKNESS = 3.35
"""Of a sheet [Å]."""
TPA = 0.1602176634
"""1 eV/Å³ in TPa."""


@dataclass(frozen=True)
class Network:
    """A periodic sheet of atoms with pair forces, harmonic about its positions.

    `x`: positions [Å], shape [A, 2]; `box`: periods [Å]; `pairs`: atoms of each bond, shape [B, 2];
    `xi`: bond vectors [Å], shape [B, 2]; `along`: V″ of each bond [eV/Å²], shape [B]; `across`:
    V′/r of each bond [eV/Å²], shape [B].
    """

    x: np.ndarray
    box: tuple[float, float]
    pairs: np.ndarray
    xi: np.ndarray
    along: np.ndarray
    across: np.ndarray

    @cached_property
    def blocks(self) -> np.ndarray:
        """Stiffness of each bond [eV/Å²], shape [B, 2, 2]."""
        n = self.xi / np.linalg.norm(self.xi, axis=1)[:, None]
        outer = n[:, :, None] * n[:, None, :]
        return self.along[:, None, None] * outer + self.across[:, None, None] * (np.eye(2) - outer)

    @cached_property
    def factors(self):
        """Factors of the Hessian, with the first atom held."""
        i, j = self.pairs.T
        rows, columns, values = [], [], []
        a, b = np.meshgrid([0, 1], [0, 1], indexing="ij")
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            rows.append((2 * p[:, None, None] + a).ravel())
            columns.append((2 * q[:, None, None] + b).ravel())
            values.append((sign * self.blocks).ravel())
        size = 2 * len(self.x)
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return splu(sp.csc_array(sp.coo_array(entries, shape=(size, size)))[2:, 2:])

    def response(self, force: np.ndarray) -> np.ndarray:
        """Displacement [Å] under forces of zero sum [eV/Å], shape [A, 2]; its mean is zero."""
        flat = np.zeros(2 * len(self.x))
        flat[2:] = self.factors.solve(force.ravel()[2:])
        u = flat.reshape(-1, 2)
        return u - u.mean(axis=0)

    def energy(self, strain: np.ndarray) -> float:
        """Twice the energy [eV] of the sheet under a strain, shape [2, 2], atoms relaxed."""
        stretch = self.xi @ strain.T
        pull = np.einsum("bac,bc->ba", self.blocks, stretch)
        force = np.zeros_like(self.x)
        np.add.at(force, self.pairs[:, 0], pull)
        np.add.at(force, self.pairs[:, 1], -pull)
        return float((stretch * pull).sum() - (force * self.response(force)).sum())

    def moduli(self) -> dict[str, float]:
        """C11, C22, C12, C44 [TPa]."""
        unit = TPA / (self.box[0] * self.box[1] * THICKNESS)
        first, second, area = np.diag([1.0, 0.0]), np.diag([0.0, 1.0]), np.eye(2)
        shear = np.array([[0.0, 0.5], [0.5, 0.0]])
        C11, C22 = self.energy(first) * unit, self.energy(second) * unit
        C12 = (self.energy(area) * unit - C11 - C22) / 2
        return {"C11": C11, "C22": C22, "C12": C12, "C44": self.energy(shear) * unit}


def triangular(spacing: float, cells: tuple[int, int]) -> tuple[np.ndarray, tuple[float, float]]:
    """Positions of a triangular lattice in rectangular cells of two atoms, and their box [Å]."""
    cell = spacing * np.array([1.0, np.sqrt(3)])
    corners = np.argwhere(np.ones(cells)) * cell
    x = np.concatenate([corners, corners + cell / 2])
    return x, (float(cells[0] * cell[0]), float(cells[1] * cell[1]))


def bonds_within(
    x: np.ndarray, box: tuple[float, float], reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of atoms within reach [Å] in a periodic box and their bond vectors, each pair once."""
    i, j = np.triu_indices(len(x), 1)
    xi = x[j] - x[i]
    xi -= np.round(xi / box) * box
    near = (xi**2).sum(axis=1) <= reach**2
    return np.stack([i[near], j[near]], axis=1), xi[near]


def lennard_jones(
    cells: tuple[int, int] = (26, 15), *, epsilon: float = 0.0104, sigma: float = 3.4
) -> Network:
    """A sheet of Lennard-Jones atoms at rest, three shells of neighbours (argon by default)."""

    def slopes(r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s6 = (sigma / r) ** 6
        first = 24 * epsilon * (s6 - 2 * s6**2) / r
        return first, 24 * epsilon * (26 * s6**2 - 7 * s6) / r**2

    shells = np.array([(1.0, 6), (np.sqrt(3), 6), (2.0, 6)])  # distance in a, neighbours

    def cell_energy(a: float) -> float:
        s6 = (sigma / (a * shells[:, 0])) ** 6
        return float((shells[:, 1] * 4 * epsilon * (s6**2 - s6)).sum())

    bounds = (sigma, 1.3 * sigma)
    a = minimize_scalar(cell_energy, bounds=bounds, method="bounded", options={"xatol": 1e-12}).x
    x, box = triangular(a, cells)
    pairs, xi = bonds_within(x, box, 2.2 * a)
    r = np.linalg.norm(xi, axis=1)
    first, second = slopes(r)
    return Network(x, box, pairs, xi, second, first / r)


def springs(
    cells: tuple[int, int] = (26, 15),
    *,
    spacing: float = 3.8,
    stiffness: float = 0.8,
    weak: float = 0.3,
    factor: float = 0.2,
    seed: int = 0,
) -> Network:
    """A triangular network of springs [eV/Å²], a share of which is weaker by a factor."""
    x, box = triangular(spacing, cells)
    pairs, xi = bonds_within(x, box, 1.2 * spacing)
    chosen = np.random.default_rng(seed).random(len(xi)) < weak
    along = stiffness * np.where(chosen, factor, 1.0)
    return Network(x, box, pairs, xi, along, np.zeros(len(xi)))


def wave_loads(network: Network, highest: int = 3, strain: float = 1e-3) -> list[np.ndarray]:
    """Forces [eV/Å] of waves along each axis, scaled to about a strain; shape [A, 2] each."""
    loads = []
    for axis in (0, 1):
        for p in range(highest + 1):
            for q in range(highest + 1):
                if p == q == 0:
                    continue
                k = 2 * np.pi * np.array([p, q]) / network.box
                force = np.zeros_like(network.x)
                force[:, axis] = np.prod(np.cos(network.x * k), axis=1)
                force -= force.mean(axis=0)
                size = np.abs(network.response(force)).max() * np.linalg.norm(k)
                loads.append(force * (strain / size))
    return loads


def write_dump(path: Path, network: Network, u: np.ndarray) -> None:
    """One frame of a LAMMPS dump, positions x + u unwrapped."""
    (width, height), x = network.box, network.x + u
    head = f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n{len(x)}\nITEM: BOX BOUNDS pp pp pp\n"
    bounds = f"0 {width!r}\n0 {height!r}\n-5 5\nITEM: ATOMS id type xu yu zu\n"
    rows = [f"{n} 1 {a!r} {b!r} 0" for n, (a, b) in enumerate(x.tolist(), start=1)]
    path.write_text(head + bounds + "\n".join(rows) + "\n")


def make_dumps(folder: Path, network: Network) -> tuple[list[Path], list[Path], Path]:
    """Dumps and forces of wave loads, and the dump at rest."""
    folder.mkdir(parents=True, exist_ok=True)
    rest = folder / "rest.dump"
    write_dump(rest, network, np.zeros_like(network.x))
    dumps, forces = [], []
    for number, force in enumerate(wave_loads(network), start=1):
        dumps.append(folder / f"load{number}.dump")
        forces.append(folder / f"load{number}.csv")
        write_dump(dumps[-1], network, network.response(force))
        np.savetxt(forces[-1], force, delimiter=",", fmt="%.17g")
    return dumps, forces, rest


SHEET = ("--thickness", 3.35, "--density", 2200)


def left(network: Network, radius: float) -> str:
    """What a fit to dumps smoothed by this radius [Å] leaves, and the error of C11."""
    with tempfile.TemporaryDirectory() as made:
        file = Path(made) / "data.h5"
        dumps, forces, rest = make_dumps(Path(made), network)
        nodes = "--spacing", 8, "--radius", radius, "--reach", 88, "--interior", 45
        given = "--box", *network.box, "--reference", rest, *SHEET, "--out", file
        command([*map(str, ("coarse-grain", *dumps, "--force", *forces, *nodes, *given))])
        samples = wp.load(file)["train"]
    material = wp.fit(samples, wp.LPS(20.0, wp.Bernstein(4)), progress=False).material
    off = 100 * ((material.lam + 2 * material.mu) / network.moduli()["C11"] - 1)
    return f"{radius} Å: C11 {off:+.1f} %. {wp.diagnose(material, samples).sentence}"


if __name__ == "__main__":
    print("Lennard-Jones,", left(lennard_jones((52, 30)), 24))
    for smoothing in (16, 24):
        print("springs, 30 % weak,", left(springs((52, 30)), smoothing))
