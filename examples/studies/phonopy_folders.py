"""Models of phonopy's folders, beside what phonopy itself says of the same forces.

python examples/studies/phonopy_folders.py phonopy/example/*    folders of its own sources

A row has the model's moduli with their errors, or why there is none; phonopy's lowest frequency on
a mesh, its long waves' moduli, and by how many errors they differ.
"""

import sys
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

import warp_peri as wp
from tools.options import Options
from warp_peri.core.elastic import allowed_tensors, named_moduli
from warp_peri.core.groups import name_of, point_group
from warp_peri.core.stencil import directions
from warp_peri.errors import exit_status
from warp_peri.structures.learn import errors_of, with_errors
from warp_peri.structures.noise import EV_IN_TPA
from warp_peri.structures.rest import YAML

LONG, WAYS, MESH = 4e-3, 60, 12
"""|k| [1/Å] of long waves, their directions, and wave vectors along an edge of the mesh."""
LEAST = 1e-3
"""Errors [GPa] that are none: symmetry leaves force constants nothing to be brought to."""


def of_phonopy(folder: Path, allowed: np.ndarray) -> tuple[float, dict[str, float]]:
    """Lowest frequency [THz] away from Γ, and moduli [GPa] nearest to long waves, by phonopy."""
    import phonopy
    from phonopy.interface import calculator

    file = next(folder / name for name in YAML if (folder / name).is_file())
    beside: dict[str, Any] = {
        f"{name.lower()}_filename": folder / name
        for name in ("FORCE_SETS", "BORN")
        if (folder / name).is_file()
    }
    one: Any = phonopy.load(file, **beside, symmetrize_fc=False, log_level=0)
    one.symmetrize_force_constants()
    units: Any = vars(calculator)["get_calculator_physical_units"](one.calculator)
    one.run_mesh([MESH] * 3, is_gamma_center=True)
    away = np.abs(one.mesh.qpoints).max(axis=1) > 0
    lowest = float(one.mesh.frequencies[away].min())
    cell, n = np.array(one.primitive.cell), len(one.primitive)
    e = directions(WAYS, 3)
    root = np.repeat(np.sqrt(one.primitive.masses), 3)
    uniform = np.tile(np.eye(3), (n, 1))
    found = []
    for way in e:
        one.dynamical_matrix.run(cell @ (LONG * way) / (2 * np.pi))
        D = np.asarray(one.dynamical_matrix.dynamical_matrix) * np.outer(root, root)
        flexible = uniform.T @ np.linalg.inv(D) @ uniform / n**2
        found.append(np.linalg.inv(flexible).real / LONG**2 / abs(np.linalg.det(cell)))
    rows = np.einsum("mijkl,nj,nl->nikm", allowed, e, e, optimize=True).reshape(-1, len(allowed))
    size = EV_IN_TPA * units.force_to_eVperA / units.distance_to_A**2
    c = np.linalg.lstsq(rows, np.array(found).ravel() * size)[0]
    return lowest, named_moduli(1e3 * np.tensordot(c, allowed, 1))


def row(folder: Path) -> str:
    """Of a table in Markdown."""
    own: tuple[float, dict[str, float]] | None = None
    moduli: dict[str, tuple[float, float]] = {}
    try:
        atoms = wp.atoms.from_phonopy(folder)
        group = name_of(atoms.group())
        allowed = allowed_tensors(group, point_group(group, 3), np.eye(3))
        if any((folder / name).is_file() for name in YAML):
            own = of_phonopy(folder, allowed)
        found = wp.atoms.from_force_constants(atoms)
        moduli = with_errors(found.tensor, errors_of(atoms, None, group))
        bars = {key: f" ± {bar:.2g}" if bar > LEAST else "" for key, (_, bar) in moduli.items()}
        told = ", ".join(f"{key} {value:.1f}{bars[key]}" for key, (value, _) in moduli.items())
    except wp.InputError as error:
        told = str(error).split(";")[0]
    if own is None:
        return f"| {folder.name} | {told} | – | – | – |"
    shown = ", ".join(f"{value:.1f}" for value in own[1].values())
    off = [abs(own[1][key] - value) / bar for key, (value, bar) in moduli.items() if bar > LEAST]
    most = f"{max(off):.1f}" if off else "–"
    return f"| {folder.name} | {told} | {own[0]:.2f} | {shown} | {most} |"


def main(words: list[str] | None = None) -> None:
    """Print the table."""
    parser = Options(__doc__)
    parser.add("folders", nargs="+", type=Path, metavar="FOLDER")
    given = parser.parse_args(words)
    print("| | model [GPa], or why none | lowest [THz] | phonopy's waves [GPa] | errors apart |")
    print("|---|---|---|---|---|")
    for folder in given.folders:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            print(row(folder), flush=True)


if __name__ == "__main__":
    sys.exit(exit_status(main))
