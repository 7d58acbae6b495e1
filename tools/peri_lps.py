"""LAMMPS's linear peridynamic solid (pair_style peri/lps) on a cubic lattice, beside the library's.

    python tools/peri_lps.py [--json]

Moduli are read off the force on the atom in the middle of a free cube under quadratic fields. In a
periodic box LAMMPS (22 Jul 2025) takes the weighted volume of bonds through a face from the far
ends' unwrapped distance, so that atoms near a face are too soft; with those volumes a sum over the
same bonds has its forces, which is what `periodic` shows. Its first run, which makes the bonds,
leaves the critical stretches of atoms as the memory was: they are set here, or bonds would break in
the next run.
"""

import ctypes
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from tools.options import Options
from warp_peri import Model
from warp_peri.atoms.calculators import LammpsError, lammps_class, lammps_words
from warp_peri.materials.lps import moduli
from warp_peri.points.families import HORIZON_TOLERANCE, BondClasses, bond_classes

BULK, SHEAR = 1.4, 0.5
"""Moduli asked for; their unit is that of stress, as the spacing is that of length."""
SIZE = 1e-6
"""Of displacements, where what is quadratic in them is lost beside rounding of a spacing."""
WHOLE = 1e20
"""A critical stretch that nothing reaches."""
INPUT = """
units si
boundary {faces}
atom_style peri
atom_modify map array sort 0 0
neighbor 0.3 bin
lattice sc 1.0
region box block -0.5 {end} -0.5 {end} -0.5 {end}
create_box 1 box
create_atoms 1 box
pair_style peri/lps
pair_coeff * * {bulk} {shear} {horizon} 1e9 0.25
set group all density 1.0
set group all volume 1.0
fix 1 all nve
run 0
compute damage all damage/atom
compute worst all reduce max c_damage
"""


class PeriLps:
    """nodes³ atoms of spacing and volume 1, free or periodic. Raises LammpsError without LAMMPS."""

    def __init__(self, nodes: int, horizon: float, *, periodic: bool = False) -> None:
        with lammps_words():
            self._lammps = lammps_class()(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
            settings = {"end": nodes - 0.5, "bulk": BULK, "shear": SHEAR}
            settings["horizon"] = horizon * (1 + HORIZON_TOLERANCE)
            faces = "p p p" if periodic else "f f f"
            self._lammps.commands_string(INPUT.format(faces=faces, **settings))
            self._lammps.numpy.extract_atom("s0")[:] = WHOLE
            self.x = self._gathered("x")

    def _gathered(self, name: str) -> np.ndarray:
        return np.array(self._lammps.gather_atoms(name, 1, 3)).reshape(-1, 3)

    def march(self, steps: int) -> None:
        """So many short steps of motion from where it is."""
        with lammps_words():
            self._lammps.command(f"run {steps} pre no post no")

    def force(self, u: np.ndarray) -> np.ndarray:
        """Of the atoms, shape [N, 3], at a displacement of the same shape."""
        moved = np.ascontiguousarray(self.x + u)
        pointer = moved.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        with lammps_words():
            self._lammps.scatter_atoms("x", 1, 3, pointer)
            self._lammps.command("run 0")
            return self._gathered("f")

    def close(self) -> None:
        """Free LAMMPS. Raises LammpsError if a bond has broken, for the forces are wrong then."""
        worst = self._lammps.extract_compute("worst", 0, 0)
        self._lammps.close()
        if worst != 0:
            raise LammpsError(f"peri/lps: expected whole bonds, got a damage of {worst:g}")


def lammps_classes(horizon: float) -> BondClasses:
    """Bonds of the lattice with LAMMPS's volumes: they fall off over the last half spacing."""
    classes = bond_classes(1.0, horizon, dimension=3)
    off = classes.r > horizon - 0.5
    return replace(classes, weight=np.where(off, horizon + 0.5 - classes.r, 1.0))


def solid(horizon: float) -> Model:
    """The library's, with LAMMPS's influence function 1/r."""
    lam = BULK - 2 * SHEAR / 3
    return Model(lam, SHEAR, 1.0, np.ones(1), horizon=horizon, dimension=3)


def measured_moduli(horizon: float) -> dict[str, float]:
    """C11, C12, C44 of LAMMPS, from the atom whose family and whose neighbours' are whole."""
    middle = 2 * int(horizon)
    lammps = PeriLps(2 * middle + 1, horizon)
    x, y, _ = (lammps.x - middle).T
    zero = np.zeros_like(x)
    fields = [(x * x / 2, zero, zero), (y * y / 2, zero, zero), (zero, x * y, zero)]
    here = int(np.flatnonzero((lammps.x == middle).all(axis=1))[0])
    forces = [lammps.force(SIZE * np.stack(field, axis=1))[here] / SIZE for field in fields]
    lammps.close()
    C11, C44, mixed = (float(force[0]) for force in forces)
    return {"C11": C11, "C12": mixed - C44, "C44": C44}


def isotropic(constants: dict[str, float]) -> tuple[float, float]:
    """Bulk modulus, and the shear modulus of Voigt's mean over directions."""
    C11, C12, C44 = (constants[name] for name in ("C11", "C12", "C44"))
    return (C11 + 2 * C12) / 3, (C11 - C12 + 3 * C44) / 5


def summed_force(x: np.ndarray, u: np.ndarray, horizon: float, *, wrapped: bool) -> np.ndarray:
    """The same solid of a periodic cube as a sum over bonds in NumPy, with LAMMPS's volumes.

    `x`, `u`: positions on a lattice of spacing 1 and displacements, shape [N, 3]; `horizon`: in
    spacings; `wrapped`: the weighted volume from the bonds' own lengths; otherwise as LAMMPS has
    it.
    """
    classes = lammps_classes(horizon)
    nodes = round(len(x) ** (1 / 3))
    number = np.empty(3 * (nodes,), int)
    place = np.rint(x).astype(int)
    number[tuple(place.T)] = np.arange(len(x))
    far = number[tuple(((place[:, None] + classes.steps) % nodes).transpose(2, 0, 1))]
    r, volume = classes.r[classes.bond_class], classes.weight[classes.bond_class]
    length = np.linalg.norm(x[far] - x[:, None], axis=2)
    m = (np.broadcast_to(r, length.shape) if wrapped else length) @ volume
    extension = ((u[far] - u[:, None]) * classes.xi).sum(axis=2) / r
    share = 3 * extension @ volume / m**2
    pull = (BULK - 5 / 3 * SHEAR) * 3 * (share[:, None] + share[far])
    pull += 15 * SHEAR * (1 / m[:, None] + 1 / m[far]) * extension / r
    return np.einsum("nb,bi->ni", pull * volume / r, classes.xi)


def periodic_errors(nodes: int, horizon: float) -> tuple[float, dict[bool, float]]:
    """LAMMPS's share of a shear wave's force; largest error of both sums at random, relative."""
    lammps = PeriLps(nodes, horizon, periodic=True)
    x = lammps.x
    wave = SIZE * np.outer(np.sin(2 * np.pi * x[:, 0] / nodes), (0, 1, 0))
    u = SIZE * np.random.default_rng(0).normal(size=x.shape)
    soft, given = lammps.force(wave), lammps.force(u)
    lammps.close()
    share = np.vdot(wave, soft) / np.vdot(wave, summed_force(x, wave, horizon, wrapped=True))
    errors = {}
    for wrapped in (True, False):
        ours = summed_force(x, u, horizon, wrapped=wrapped)
        errors[wrapped] = float(np.abs(ours - given).max() / np.abs(given).max())
    return float(share), errors


def main() -> None:
    """Print both."""
    parser = Options(__doc__, json=True)
    as_json = parser.parse_args().json
    found: dict[str, Any] = {"bulk": BULK, "shear": SHEAR, "horizon": {}}
    for horizon in (2.0, 3.0, 4.0):
        theirs, model = measured_moduli(horizon), solid(horizon)
        same = moduli(model, lammps_classes(horizon))
        ours = moduli(model, bond_classes(1.0, horizon, dimension=3))
        bulk, shear = isotropic(theirs)
        found["horizon"][f"{horizon:g}"] = {
            "bulk": bulk / BULK,
            "shear": shear / SHEAR,
            "C44": theirs["C44"] / SHEAR,
            "C44_weights": ours["C44"] / SHEAR,
            "same_volumes": max(abs(theirs[name] / same[name] - 1) for name in same),
        }
    share, errors = periodic_errors(10, 2.0)
    found["periodic"] = {"share": share, "wrapped": errors[True], "unwrapped": errors[False]}
    if as_json:
        print(json.dumps(found))
        return
    print(
        "LAMMPS over what is asked: bulk, Voigt's shear, C44; C44 with exact weights; worst error"
    )
    for name, row in found["horizon"].items():
        print(f"  δ = {name} h  " + "  ".join(f"{value:.6g}" for value in row.values()))
    print("A shear wave in a periodic cube of 10 h has {share:.2f} of its force; errors of a sum "
          "over bonds with wrapped volumes {wrapped:.1e}, with unwrapped ones {unwrapped:.1e}"
          .format(**found["periodic"]))  # fmt: skip


if __name__ == "__main__":
    main()
