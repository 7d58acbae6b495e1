"""A crystal from its atoms' forces: law, proof, dispersion, and loads it never saw.

python examples/crystals.py Cu            a table
python examples/crystals.py MoS2 --json   one object on stdout
python examples/crystals.py W --quick     without the free ball and the void of atoms, the longest
python examples/crystals.py W --fields    learned from displacements under loads, beside phonons
python examples/crystals.py Mg --picture runs/Mg.png
"""

import dataclasses
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import warp_peri as wp
from tools.crystal_ball import INNER, SEEN, Ball, ball
from tools.crystal_void import Void, void, void_error
from tools.crystals import RECIPES, force_constants, isotropic_lps, spacing_of
from tools.options import Options
from warp_peri import LPS, Bernstein, Micromodulus, Points, Samples
from warp_peri.atoms.force_constants import ForceConstants
from warp_peri.atoms.phonons import COLLAR, Loads, placed_errors, wave_loads
from warp_peri.core.elastic import allowed_tensors, directional, named_moduli
from warp_peri.core.groups import point_group
from warp_peri.core.stencil import q1_tensors
from warp_peri.errors import exit_status
from warp_peri.methods import Optimum
from warp_peri.micromodulus import Crystal, from_phonons, tensors_of

UNITS = ("angstrom", "TPa")
CUBIC = {"GX": (1, 0, 0), "GK": (1, 1, 0), "GL": (1, 1, 1)}
HEXAGONAL = {"GK": (1, 0, 0), "GM": (0, 1, 0), "GA": (0, 0, 1)}
SHELLS = {2: {12: 2.0, 20: 2.5, 28: 3.0, 48: 4.0}, 3: {32: 2.0, 56: 5**0.5, 80: 6**0.5, 122: 3.0}}
"""Horizons over the spacing, by their number of bonds."""
USUAL_BONDS = {2: 20, 3: 80}
WIDE = 4
"""Spacings of the horizon of an LPS of sheets, as in the first command."""
ON_LOADS = ("waves", "short", "ball", "void", "ball_at_rest")
"""Of the ball: by the law of the crystal as its surface squeezes it, and of the crystal at rest."""

Symbol = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Unseen:
    """What a law is put to: loads of waves, a free ball of atoms, a void; None where there is none.

    A ball of ions would need their field without a period; a sheet is not solid.
    """

    waves: Loads
    short: Loads
    ball: Ball | None
    void: Void | None

    def judge(
        self, symbol: Symbol, law: Crystal | None, squeezed: Crystal | None = None
    ) -> dict[str, dict[str, float | None]]:
        """E_res and E_u [%]; no law if it has no nodes; of the ball by the one for it if given."""
        found: list[tuple[float | None, float | None]] = []
        for loads in (self.waves, self.short):
            found.append(loads.errors(symbol) if law is None else loads.errors_of(law))
        void = None if law is None or self.void is None else void_error(law, self.void)
        balls = [
            (None, None) if one is None or self.ball is None else in_ball(one, self.ball.samples)
            for one in (squeezed or law, law)
        ]
        found += [balls[0], (None, void), balls[1]]  # a void has no load to compare a force with
        E_res, E_u = (dict(zip(ON_LOADS, values)) for values in zip(*found))
        return {"E_u": E_u, "E_res": E_res}


def in_ball(law: Crystal, seen: Samples) -> tuple[float, float]:
    """Means of E_res and E_u [%] inside a free ball of atoms, displacement given around.

    The nodes of a law of another spacing lie where they were before the crystal was squeezed.
    """
    h = law.spacing
    wider = h / seen.spacing
    x = wider * seen.x
    far = np.linalg.norm(x, axis=1)  # a long reach asks more collar
    inside = (far <= INNER * h + 1e-9) & (far <= SEEN * h - law.horizon + 1e-9)
    return placed_errors(law, Samples(Points(x, inside, h), seen.u, seen.loads / wider**3))


def dispersion(paths: dict[str, Any], atoms: Symbol, law: Symbol, h: float) -> dict[str, float]:
    """Largest relative error [%] of √eigenvalues along paths, to k h = π/2."""
    found = {}
    for name, path in paths.items():
        k = np.linspace(0.05, 1, 30)[:, None] * (np.pi / 2 / h) * path
        true, own = (np.sqrt(np.maximum(np.linalg.eigvalsh(D(k)), 0)) for D in (atoms, law))
        found[name] = float(100 * np.abs(own / true - 1).max())
    return found


def local(C: np.ndarray) -> Symbol:
    """Γ(k) = C k k: the local solid without any error of a mesh."""
    return lambda k: np.einsum("ijkl,nj,nl->nik", C, k, k, optimize=True)


def learned(name: str, atoms: ForceConstants, bonds: int | None = None) -> Crystal:
    """The law on usual nodes."""
    recipe = RECIPES[name]
    d, h = atoms.dimension, spacing_of(np.diag(atoms.cell), recipe)
    shells = SHELLS[d]
    reach = shells[bonds if bonds in shells else USUAL_BONDS[d]]
    return from_phonons(atoms, h, h * reach, symmetry=recipe.symmetry, units=UNITS)


def zone_paths(name: str, d: int) -> dict[str, np.ndarray]:
    """Unit vectors by name."""
    named = CUBIC if RECIPES[name].symmetry == "m-3m" else HEXAGONAL
    return {key: np.array(v[:d]) / np.linalg.norm(v) for key, v in named.items() if any(v[:d])}


def elastic(name: str, atoms: ForceConstants) -> np.ndarray:
    """C_ijkl of the atoms."""
    symmetry, one = RECIPES[name].symmetry, np.eye(atoms.dimension)
    return atoms.elastic(allowed_tensors(symmetry, point_group(symmetry, len(one)), one))


def felt(C: np.ndarray, atoms: ForceConstants) -> np.ndarray:
    """What waves feel: the moduli, and beside them the stress of the atoms at rest (T19)."""
    if atoms.stress is None:
        return C
    return np.asarray(C + np.einsum("ik,jl->ijkl", np.eye(len(C)), atoms.stress))


def rivals(
    name: str, atoms: ForceConstants, h: float
) -> dict[str, tuple[Symbol, Crystal | None, np.ndarray]]:
    """Symbol, law if it has nodes, and moduli of what else the crystal may be taken for."""
    C = elastic(name, atoms)
    whole = felt(C, atoms)
    steps, tensors = q1_tensors(whole)
    elements, lps = Crystal(h, steps, tensors / h**2, UNITS), isotropic_lps(atoms, h, 2 * h)
    return {
        "Q1": (elements.symbol, elements, C),
        "local": (local(whole), None, C),
        "lps": (lps.symbol, lps, lps.tensor()),
    }


def study(name: str, bonds: int | None = None, *, quick: bool = False) -> dict[str, Any]:
    """All that the example prints of one crystal."""
    start = time.perf_counter()
    atoms = force_constants(name)
    law, paths = learned(name, atoms, bonds), zone_paths(name, atoms.dimension)
    proof = law.certificate
    assert proof is not None
    h, d, C = law.spacing, law.dimension, elastic(name, atoms)
    bodies = not quick and d == 3 and atoms.polar is None
    unseen = Unseen(
        wave_loads(atoms, h, longest=18.0, shortest=4.0, loads=10, seed=2),
        wave_loads(atoms, h, longest=4.0, shortest=2.7, loads=5, seed=3),
        ball(name, atoms, h) if bodies else None,
        void(name, atoms, h) if bodies else None,
    )
    squeezed: dict[str, Crystal | None] = {}
    if unseen.ball is not None:  # its surface leaves it another crystal than the one at rest
        there, spacing = force_constants(name, unseen.ball.strain), unseen.ball.samples.spacing
        squeezed = {key: one[1] for key, one in rivals(name, there, spacing).items()}
        squeezed["own"] = learned(name, there, bonds)

    def told_of(key: str, symbol: Symbol, own: Crystal | None, C_own: np.ndarray) -> dict[str, Any]:
        return {
            "moduli": named_moduli(1e3 * C_own),
            "moduli_atoms": named_moduli(1e3 * C),
            **unseen.judge(symbol, own, squeezed.get(key)),
            "dispersion": dispersion(paths, atoms.effective, symbol, h),
        }

    return {
        **told_of("own", law.symbol, law, law.tensor()),
        "rivals": {key: told_of(key, *rival) for key, rival in rivals(name, atoms, h).items()},
        "squeezed": None if unseen.ball is None else (100 * unseen.ball.strain).tolist(),
        "certificate": {
            "proven": 1e3 * proof.proven,
            "sampled": 1e3 * proof.sampled,
            "seconds": proof.seconds,
        },
        "bonds": law.bonds,
        "numbers": law.provenance["fit"]["numbers"],
        "seconds": time.perf_counter() - start,
    }


def by_fields(name: str) -> dict[str, dict[str, Any]]:
    """E_u [%] on waves never seen of laws learned from twelve loads of six waves each."""
    atoms, symmetry = force_constants(name), RECIPES[name].symmetry
    law = learned(name, atoms)
    h, seed = law.spacing, iter((5, 6, 2, 3))

    collar = 2 * WIDE if law.dimension == 2 else COLLAR

    def waves(longest: float, shortest: float, loads: int) -> Loads:
        bounds = {"longest": longest, "shortest": shortest}
        return wave_loads(atoms, h, **bounds, loads=loads, seed=next(seed), collar=collar)

    smooth, rough = waves(18.0, 4.0, 6).samples, waves(18.0, 2.7, 6).samples
    u, b = (np.concatenate(both) for both in ((smooth.u, rough.u), (smooth.loads, rough.loads)))
    train, unseen = Samples(smooth.points, u, b), (waves(18.0, 4.0, 10), waves(4.0, 2.7, 5))
    laws = {"phonons": law}
    for key, moduli in (
        ("fields, moduli told", law.elastic_tensor()),
        ("fields", "long waves"),
        ("fields, moduli free", None),
    ):
        crystal = Micromodulus(law.horizon, symmetry, moduli=moduli)
        laws[key] = wp.fit(train, crystal).material
    for key, held in (("isotropic, fields", "isotropic"), ("isotropic, moduli free", None)):
        if symmetry == "m-3m":
            solid = LPS(2 * h, Bernstein(2), method=Optimum(moduli=held))
            laws[key] = tensors_of(wp.fit(train, solid).material, h)
    if law.dimension == 2:
        wide = wp.fit(train, LPS(WIDE * h, Bernstein(10))).material
        laws["isotropic, fields"] = tensors_of(wide, h)
    found = {
        key: {on: loads.errors_of(one)[1] for on, loads in zip(ON_LOADS, unseen)}
        | {"moduli": one.moduli("GPa")} for key, one in laws.items()
    }  # fmt: skip
    tensors = {"true moduli": elastic(name, atoms)} | {
        f"moduli of {key}": one.tensor() for key, one in laws.items() if key.endswith("fields")
    }
    for key, C in tensors.items():
        symbol = local(felt(C, atoms))
        found[f"local, {key}"] = {"moduli": named_moduli(1e3 * C)} | {
            on: loads.errors(symbol)[1] for on, loads in zip(ON_LOADS, unseen)
        }
    return found


def told(name: str, found: dict[str, Any]) -> str:
    """The same as a page of text."""
    held, true = (
        ", ".join(f"{key} {value:.1f}" for key, value in found[which].items())
        for which in ("moduli", "moduli_atoms")
    )
    lines = [
        f"{name}: {found['bonds']} bonds, {found['numbers']} numbers, {found['seconds']:.0f} s",
        f"moduli {held} GPa",
        f" atoms {true} GPa",
        "proven D(k) ≥ {proven:.2f} s(k) GPa of {sampled:.2f} sampled, {seconds:.1f} s".format(
            **found["certificate"]
        ),
        "acoustic branches to kh = π/2, largest error: "
        + ", ".join(f"{path} {value:.1f} %" for path, value in found["dispersion"].items()),
        "E_u on loads never seen [%]   waves ≥ 4h   2.7–4h   free ball   void   ball, unstrained",
    ]
    rows = {"this model": found, **found["rivals"]}
    names = {"Q1": "Q1, true moduli", "local": "local, no mesh error", "lps": "isotropic LPS"}
    for key, row in rows.items():
        values = [row["E_u"][load] for load in ON_LOADS]
        shown = "".join("        –" if v is None else f"{v:9.2f}" for v in values)
        lines.append(f"  {names.get(key, key):28s}{shown}")
    if found["squeezed"] is not None:
        lines.append(
            "the ball's surface strains its inside by "
            + ", ".join(f"{e:.3f}" for e in found["squeezed"])
            + " %: its model is of the crystal so strained; unstrained: of the crystal without"
        )
    return "\n".join(lines)


def picture(name: str, path: Path) -> None:
    """Branches of the law and of the atoms, and E and ν over direction."""
    import matplotlib.pyplot as plt

    atoms = force_constants(name)
    law, paths = learned(name, atoms), zone_paths(name, atoms.dimension)
    figure = plt.figure(figsize=(11, 3.8), layout="constrained")
    axes = figure.add_subplot(1, 3, 1)
    reach = np.linspace(0.03, 1, 40) * np.pi / 2
    for number, direction in enumerate(paths.values()):
        k = reach[:, None] / law.spacing * direction
        true, own = (np.sqrt(1e3 * np.linalg.eigvalsh(D(k))) for D in (atoms.effective, law.symbol))
        said = "".join(f"{c:g}" for c in (direction > 0).astype(int))  # as in [110]
        axes.plot(reach, own, color=f"C{number}", label=[said, *[None] * (law.dimension - 1)])
        axes.plot(reach[::3], true[::3], ".", color=f"C{number}")
    axes.set(xlabel="wave number × spacing", ylabel="root of the wave's stiffness [√GPa / Å]")
    axes.set_title("Waves of the model (lines)\nare those of the atoms (dots)")
    axes.legend(frameon=False, title="direction")
    angle, one = np.linspace(0, 2 * np.pi, 181), np.eye(law.dimension)
    along = np.outer(np.cos(angle), one[0]) + np.outer(np.sin(angle), one[-1])
    across = np.outer(-np.sin(angle), one[0]) + np.outer(np.cos(angle), one[-1])
    values = np.array([directional(1e3 * law.tensor(), *pair) for pair in zip(along, across)])
    polar: Any = figure.add_subplot(1, 3, 2, projection="polar")
    polar.plot(angle, values[:, 0])
    polar.set_rlim(0, 1.1 * values[:, 0].max())
    polar.set_rlabel_position(67.5)
    polar.set_title("Young's modulus [GPa]\nover the direction of the pull")
    ratio = figure.add_subplot(1, 3, 3)
    ratio.axhline(0, color="0.6", lw=0.8)
    ratio.plot(np.rad2deg(angle), values[:, 1])
    ratio.set(xlim=(0, 180), xticks=range(0, 181, 45), ylabel="Poisson's ratio")
    ratio.set_xlabel(f"direction of the pull from axis 1 to {law.dimension} [°]")
    ratio.set_title("Poisson's ratio\nin the same plane")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(arguments: list[str] | None = None) -> None:
    """Print one crystal."""
    parser = Options(__doc__, json=True)
    parser.add("crystal", choices=list(RECIPES))
    parser.add(
        "--bonds", type=int, help="of a node: " + ", ".join(map(str, (*SHELLS[2], *SHELLS[3])))
    )
    parser.add("--quick", action="store_true", help="without the ball and the void")
    parser.add("--fields", action="store_true", help="learn from fields instead")
    parser.add("--picture", type=Path, help="draw the law there, and nothing else")
    given = parser.parse_args(arguments)
    if given.picture is not None:
        picture(given.crystal, given.picture)
        return
    if given.fields:
        for key, row in (rows := by_fields(given.crystal)).items():
            if not given.json:
                print(f"{key:38s} E_u {row['waves']:.2f} {row['short']:.2f}  {row['moduli']}")
        if given.json:
            print(json.dumps(rows))
        return
    found = study(given.crystal, given.bonds, quick=given.quick)
    print(json.dumps(found) if given.json else told(given.crystal, found))


if __name__ == "__main__":
    sys.exit(exit_status(main))
