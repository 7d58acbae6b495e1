"""A crystal from its atoms' forces: law, proof, dispersion, and loads it never saw.

python examples/crystals.py Cu            a table
python examples/crystals.py Si --json     one object on stdout
python examples/crystals.py W --no-ball   without the free ball of atoms, the longest part
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from tools.crystal_ball import SEEN, ball
from tools.crystals import RECIPES, Waves, force_constants, lattice_parameter, waves
from tools.isotropic_rival import isotropic_lps
from warp_peri.errors import exit_status
from warp_peri.micromodulus.elastic import allowed_tensors, directional, voigt
from warp_peri.micromodulus.elements import q1_tensors
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.micromodulus.groups import point_group
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.learning import from_phonons
from warp_peri.micromodulus.statics import solve
from warp_peri.points.samples import Samples

UNITS = ("angstrom", "TPa")
CELLS = 18
PATHS = {"GX": (1, 0, 0), "GK": (1, 1, 0), "GL": (1, 1, 1)}
SHELLS = {32: 2.0, 56: 5**0.5, 80: 6**0.5, 122: 3.0}
"""Horizons over the spacing, by their number of bonds."""

Symbol = Callable[[np.ndarray], np.ndarray]


def dispersion(atoms: ForceConstants, symbol: Symbol, h: float) -> dict[str, float]:
    """Largest relative error [%] of √eigenvalues along paths, to k h = π/2."""
    found = {}
    for name, path in PATHS.items():
        e = np.array(path) / np.linalg.norm(path)
        k = np.linspace(0.05, 1, 30)[:, None] * (np.pi / 2 / h) * e
        true = np.sqrt(np.linalg.eigvalsh(atoms.effective(k)))
        own = np.sqrt(np.maximum(np.linalg.eigvalsh(symbol(k)), 0))
        found[name] = float(100 * np.abs(own / true - 1).max())
    return found


def ball_errors(law: Crystal, seen: Samples) -> tuple[float, float]:
    """Means of E_res and E_u [%] inside a free ball of atoms, displacement given around."""
    far, h = np.linalg.norm(seen.x, axis=1), seen.spacing
    inside = seen.interior & (far <= SEEN * h - law.horizon + 1e-9)  # a long reach asks more collar
    operator = law.on(dataclasses.replace(seen.points, interior=inside))
    u, _ = solve(operator, seen.loads, seen.u)
    left = operator(seen.u) - seen.loads[:, inside]
    pairs = ((left, seen.loads[:, inside]), ((u - seen.u)[:, inside], seen.u[:, inside]))
    sizes = [[np.linalg.norm(x.reshape(len(x), -1), axis=1) for x in pair] for pair in pairs]
    ratios = [wrong / whole for wrong, whole in sizes]
    return float(100 * ratios[0].mean()), float(100 * ratios[1].mean())


def judged(
    symbol: Symbol,
    law: Crystal | None,
    held_out: dict[str, Waves],
    seen: Samples | None,
) -> dict[str, dict[str, float | None]]:
    """E_u and E_res [%] on every kind of unseen load; None where a rival cannot be put to it."""
    table: dict[str, dict[str, float | None]] = {"E_u": {}, "E_res": {}}
    for name, loads in held_out.items():
        table["E_res"][name], table["E_u"][name] = loads.errors(symbol)
    found = (None, None) if law is None or seen is None else ball_errors(law, seen)
    table["E_res"]["ball"], table["E_u"]["ball"] = found
    # a void cuts bonds, where a law of tensors is not objective (theory.md, T16)
    table["E_res"]["void"] = table["E_u"]["void"] = None
    return table


def cubic(C: np.ndarray) -> dict[str, float]:
    """C11, C12, C44 [GPa] of an elastic tensor [TPa]."""
    V = 1e3 * voigt(C)
    return {"C11": float(V[0, 0]), "C12": float(V[0, 1]), "C44": float(V[3, 3])}


def local(C: np.ndarray) -> Symbol:
    """Γ(k) = C k k: the local solid without any error of a mesh."""
    return lambda k: np.einsum("ijkl,nj,nl->nik", C, k, k, optimize=True)


def study(name: str, bonds: int = 80, with_ball: bool = True) -> dict[str, Any]:
    """All that the example prints of one crystal."""
    start = time.perf_counter()
    a = lattice_parameter(name)
    atoms = force_constants(name, a)
    group = atoms.group()
    C = atoms.elastic(allowed_tensors(group, point_group(group, 3), np.eye(3)))
    law = from_phonons(atoms, a, a * SHELLS[bonds], symmetry=group, units=UNITS)
    proof = law.certificate
    assert proof is not None
    held_out = {
        "waves": waves(atoms, CELLS, longest=CELLS, shortest=4.0, loads=10, seed=2),
        "short": waves(atoms, CELLS, longest=4.0, shortest=2.7, loads=5, seed=3),
    }
    seen = ball(name, atoms) if with_ball else None
    steps, tensors = q1_tensors(C)
    elements = Crystal(a, steps, tensors / a**2, UNITS)
    rival = isotropic_lps(atoms, a, a * 2.0)
    rivals = {
        "Q1": judged(elements.symbol, elements, held_out, seen) | {"moduli": cubic(C)},
        "local": judged(local(C), None, held_out, seen) | {"moduli": cubic(C)},
        "lps": judged(rival.symbol, rival, held_out, seen) | {"moduli": cubic(rival.tensor())},
    }
    return {
        "crystal": name,
        "lattice_parameter": a,
        "moduli": cubic(law.tensor()),
        "moduli_atoms": cubic(C),
        "zener": law.describe()["zener"],
        "universal_anisotropy": law.describe()["universal_anisotropy"],
        **judged(law.symbol, law, held_out, seen),
        "rivals": rivals,
        "dispersion": dispersion(atoms, law.symbol, a),
        "certificate": {
            "proven": 1e3 * proof.proven,
            "sampled": 1e3 * proof.sampled,
            "seconds": proof.seconds,
        },
        "surface_traction": 1e3 * law.surface_traction(),
        "bonds": law.bonds,
        "numbers": law.provenance["fit"]["numbers"],
        "seconds": time.perf_counter() - start,
    }


def told(found: dict[str, Any]) -> str:
    """The same as a page of text."""
    held = ", ".join(f"{key} {value:.1f}" for key, value in found["moduli"].items())
    true = ", ".join(f"{key} {value:.1f}" for key, value in found["moduli_atoms"].items())
    lines = [
        f"{found['crystal']}: {found['bonds']} bonds, {found['numbers']} numbers",
        f"moduli {held} GPa (atoms: {true}), Zener {found['zener']:.2f}",
        "proven D(k) ≥ {proven:.2f} s(k) GPa of {sampled:.2f} sampled, {seconds:.1f} s".format(
            **found["certificate"]
        ),
        "acoustic branches to kh = π/2, largest error: "
        + ", ".join(f"{path} {value:.1f} %" for path, value in found["dispersion"].items()),
        "E_u on loads never seen [%]   waves ≥ 4h   2.7–4h   free ball",
    ]
    rows = {"this law": found, **found["rivals"]}
    names = {"Q1": "Q1, true moduli", "local": "local, no mesh error", "lps": "isotropic LPS"}
    for name, row in rows.items():
        values = [row["E_u"][key] for key in ("waves", "short", "ball")]
        shown = "".join("        –" if v is None else f"{v:9.2f}" for v in values)
        lines.append(f"  {names.get(name, name):28s}{shown}")
    lines.append(
        "bonds may not be cut: a turned face would feel "
        f"{found['surface_traction']:.1f} GPa a radian"
    )
    return "\n".join(lines)


def picture(name: str, path: Path) -> None:
    """Branches of the law and of the atoms, and Young's modulus over direction."""
    import matplotlib.pyplot as plt

    a = lattice_parameter(name)
    atoms = force_constants(name, a)
    law = from_phonons(atoms, a, a * SHELLS[80], symmetry="m-3m", units=UNITS)
    figure = plt.figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.add_subplot(1, 2, 1)
    reach = np.linspace(0.03, 1, 40) * np.pi / 2
    for number, (label, direction) in enumerate(PATHS.items()):
        k = reach[:, None] / a * np.array(direction) / np.linalg.norm(direction)
        true, own = (np.sqrt(1e3 * np.linalg.eigvalsh(D(k))) for D in (atoms.effective, law.symbol))
        axes.plot(reach, own, color=f"C{number}", label=[label, *[None] * 2])
        axes.plot(reach[::3], true[::3], ".", color=f"C{number}")
    axes.set(xlabel="|k| h", ylabel="√Λ(k) [√(GPa/Å²)]")
    axes.legend()
    round_ = figure.add_subplot(1, 2, 2, projection="polar")
    angle = np.linspace(0, 2 * np.pi, 181)
    young = [
        directional(1e3 * law.tensor(), np.array([np.cos(t), np.sin(t), 0]), np.eye(3)[2])[0]
        for t in angle
    ]
    round_.plot(angle, young)
    round_.set_title("E [GPa] in (001)")
    figure.savefig(path, dpi=110)


def main(arguments: list[str] | None = None) -> int:
    """Print one crystal."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("crystal", choices=list(RECIPES))
    parser.add_argument("--bonds", type=int, choices=list(SHELLS), default=80)
    parser.add_argument("--no-ball", action="store_true", help="leave the free ball out")
    parser.add_argument("--json", action="store_true", help="one object on stdout")
    parser.add_argument("--picture", type=Path, help="draw the law there, and nothing else")
    given = parser.parse_args(arguments)

    def work() -> None:
        if given.picture is not None:
            picture(given.crystal, given.picture)
            return
        found = study(given.crystal, given.bonds, not given.no_ball)
        print(json.dumps(found) if given.json else told(found))

    return exit_status(work)


if __name__ == "__main__":
    sys.exit(main())
