"""From atoms to unseen cracks: one G_c fitted on one crack of a graphene sheet predicts the others.

Sheets with cracks are pulled to the fold by LAMMPS, athermal. The continuum takes the sheet's own
λ and μ into K = 1/r; its critical strains follow from the release of energy at the tips. Bonds near
a tip carry no more than the whole sheet's strength, so every crack counts as longer by Irwin's
r = E G_c / (2π σ²) at each tip; strength and moduli come from sheets without a crack.

    python examples/cracked_graphene.py --cracks -25 8 5 8  -5 -8 25 -8 --half 60 50

says at what strain any straight cracks in any rectangle open, on no lattice (theory, C20–C24).
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from scipy.interpolate import CubicSpline
from tqdm import tqdm

import warp_peri as wp
from examples.figures import panels
from tools.cracked_sheet import critical_strain, finished, ideal_strength
from tools.elastic import elastic_constants
from tools.graphene import bond_length
from tools.options import Options
from tools.row_separation import whole
from warp_peri import Cracked, InputError
from warp_peri.damage import rectangle
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json

FITTED, DEFAULT, ALL = 24, (12, 16), (8, 12, 16, 32, 36)
"""Cut bonds of the crack that G_c is fitted on, of those predicted, and of all."""
INNER, OUTER = 4, 14
"""Ends of the right one of two collinear cracks, in hexagons from the middle."""
LATER = {"10 bonds": [(-5, 5)], "16 bonds": [(-8, 8)], "two of 8 bonds": [(2, 10), (-10, -2)]}
"""Cracks in a sheet of a quarter of the area, chosen and predicted when all else here stood."""
LATER_HALF, SMALL = 20, ", small sheet"
HALF = 40
"""Half side of the sheet inside its rim, in hexagons."""


class Continuum:
    """The sheet as a solid with K = 1/r at a spacing of one hexagon, pulled by its rim."""

    def __init__(self, lam: float, mu: float, step: float, half: int = HALF) -> None:
        self.step = step
        self.model = wp.Model(lam=lam, mu=mu, alpha=1.0, D=np.ones(1), horizon=3 * step)
        side = 2 * (half + 6) * step
        x = rectangle(side, side, step)
        self.points = wp.Points(x, (np.abs(x) <= half * step).all(axis=1), step)

    def energy(self, cracks: list) -> float:
        """Elastic energy per thickness at unit strain [TPa Å²]."""
        lines = [[(a * self.step, 0), (b * self.step, 0)] for a, b in cracks]
        sheet = Cracked(self.points, u=self.points.x * (0.0, 1.0), cracks=lines)
        return float(wp.solve(self.model, sheet).energy())

    def release(self, longest: int):
        """G at unit strain as a function of a central crack's half length in hexagons [TPa Å]."""
        halves = np.arange(0, longest + 4, 2)
        energies = [self.energy([(-a, a)] if a else []) for a in tqdm(halves, desc="energies")]
        curve = CubicSpline(halves, energies, bc_type=((1, 0.0), "not-a-knot"))
        return lambda half: -float(curve(half, 1)) / (2 * self.step)

    def release_of_two(self, zone: float, first: int, last: int) -> float:
        """The larger G at unit strain of the tips of two collinear cracks [TPa Å].

        zone: hexagons, up to 2, by which each tip is further out than the crack's own;
        first, last: ends of the right one.
        """
        inner, outer = first - np.arange(-1, 4), last + np.arange(-1, 4)
        near, far = first - round(zone), last + round(zone)  # the tip that is not moved
        table = [self.energy([(a, far), (-far, -a)]) for a in inner]
        by_inner = CubicSpline(inner[::-1], table[::-1])(first - zone, 1)
        table = [self.energy([(near, b), (-b, -near)]) for b in outer]
        by_outer = -CubicSpline(outer, table)(last + zone, 1)
        return float(max(by_inner, by_outer) / (2 * self.step))


def fitted(
    release, strain: float, E: float, strength: float, step: float, half: float = FITTED / 2
) -> tuple[float, float]:
    """G_c [TPa Å] of the fitted crack, and Irwin's zone [hexagons], which needs G_c itself."""
    zone = 0.0
    for _ in range(50):
        toughness = release(half + zone) * strain**2
        zone = E * toughness / (2 * np.pi * strength**2) / step
    return toughness, zone


def critical(solid: Continuum, release, toughness: float, zone: float, cracks: list) -> float:
    """Critical strain of one crack in the middle or of two collinear ones."""
    one = len(cracks) == 1
    unit = release(cracks[0][1] + zone) if one else solid.release_of_two(zone, *cracks[0])
    return float(np.sqrt(toughness / unit))


def atoms(names: dict[str, tuple[list, float]], step: float, kept: Path) -> dict[str, float]:
    """Critical strains by LAMMPS; each is written down when it is found, and not found again."""
    measured = finished(kept, "strain")
    for name, (cracks, expected) in tqdm(names.items(), desc="sheets", unit="sheet"):
        half = LATER_HALF if name.endswith(SMALL) else HALF
        if name not in measured:
            lines = [np.array([(a * step, 0), (b * step, 0)]) for a, b in cracks]
            measured[name] = critical_strain(lines, expected, half=half * step)
            write_json(kept, measured)
    return {name: measured[name]["strain"] for name in names}


def later(solid: Continuum, toughness: float, zone: float, kept: Path) -> dict[str, dict]:
    """What the toughness and the zone found on the large sheet predict for a small one."""
    release, predicted = solid.release(max(b for ((_, b), *_) in LATER.values())), {}
    for name, cracks in LATER.items():
        predicted[name + SMALL] = critical(solid, release, toughness, zone, cracks)
    names = {name + SMALL: (LATER[name], 0.95 * predicted[name + SMALL]) for name in LATER}
    measured = atoms(names, solid.step, kept)
    return {
        name: {"atoms": strain, "predicted": predicted[name], "error": predicted[name] / strain - 1}
        for name, strain in measured.items()
    }


def any_cracks(numbers: list[float], half: list[float], kept: Path, *, pull: bool) -> dict:
    """Critical strain of straight cracks in a rectangle.

    It is that of rows of bonds ahead of their tips (C22–C23), as strong as the crack says that G_c
    is fitted on; at an angle to zigzag, rows turn off into it (C24).

    Args:
        numbers: x and y of both ends of each crack [Å].
        half: half sides of the sheet inside its rim [Å].
        kept: sheets that were pulled.
        pull: whether to pull these atoms too.

    Raises InputError for other than four numbers a crack, and for what CrackedRectangle refuses.
    """
    if len(numbers) % 4:
        raise InputError(f"--cracks: expected x and y of both ends, got {len(numbers)} numbers")
    cracks, step = list(np.reshape(numbers, (-1, 2, 2))), float(np.sqrt(3) * bond_length())
    known, name = whole(), f"{FITTED} bonds"
    known.ends(cracks, half)  # refused before an hour of atoms
    base = atoms({name: ([(-FITTED / 2, FITTED / 2)], 0.0315)}, step, kept)[name]
    along = all(crack[0][1] == crack[1][1] for crack in cracks)
    single = [np.array([(-FITTED / 2 * step, 0.0), (FITTED / 2 * step, 0.0)])]
    factor = known.factor(known.held(single, HALF * step, kinks=not along), base)
    held = known.held(cracks, half, kinks=not along)
    predicted = held.critical_strain(known.law.times(factor))
    table = {"by": "rows" if along else "kinks", "predicted": predicted}
    if pull:
        strain = critical_strain(cracks, 0.95 * predicted, half=half)["strain"]
        table |= {"atoms": strain, "error": predicted / strain - 1}
    return table


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "cracked_graphene", json=True)
    parser.add("--all", action="store_true", help="six cracks, and two collinear ones")
    parser.add("--later", action="store_true", help="three, predicted blindly")
    parser.add(
        "--cracks",
        type=float,
        nargs="+",
        metavar="Å",
        help="x y of both ends of each, any straight",
    )
    parser.add("--half", type=float, nargs=2, default=(100.0, 100.0), metavar="Å")
    parser.add("--pull", action="store_true", help="these cracks' atoms too")
    args = parser.parse_args(argv)
    if args.cracks:
        found = any_cracks(args.cracks, args.half, args.out / "atoms.json", pull=args.pull)
        print(json.dumps(found, indent=None if args.json else 1))
        return 0
    bond = bond_length()
    step = float(np.sqrt(3) * bond)
    constants = elastic_constants(bond)
    sheet = Continuum(constants["lambda"], constants["mu"], step)
    lengths = (FITTED, *(ALL if args.all else DEFAULT))
    release = sheet.release(max(lengths) // 2 + 1)
    guess = {n: 0.03 * np.sqrt(release(FITTED / 2) / release(n / 2)) for n in lengths}
    names = {f"{n} bonds": ([(-n / 2, n / 2)], guess[n]) for n in lengths}
    if args.all:
        names["collinear"] = ([(INNER, OUTER), (-OUTER, -INNER)], 0.038)
    measured = atoms(names, step, args.out / "atoms.json")
    strength, _ = ideal_strength()
    base = measured[f"{FITTED} bonds"]
    toughness, zone = fitted(release, base, constants["E"], strength, step)
    table = {}
    for name, strain in measured.items():
        n = 0 if name == "collinear" else lengths[list(names).index(name)]
        unit = release(n / 2 + zone) if n else sheet.release_of_two(zone, INNER, OUTER)
        predicted = float(np.sqrt(toughness / unit))
        table[name] = {"atoms": strain, "predicted": predicted, "error": predicted / strain - 1}
        bare = release(n / 2) if n else sheet.release_of_two(0.0, INNER, OUTER)
        plain = base * float(np.sqrt(release(FITTED / 2) / bare))  # G_c fitted anew
        table[name]["error without zone"] = plain / strain - 1
    numbers = {"G_c": 100 * toughness, "unit": "J/m² of a sheet 3.35 Å thick", "cracks": table}
    numbers |= {"strength": strength, "zone": zone * step}
    numbers |= {"lambda": constants["lambda"], "mu": constants["mu"], "fitted": f"{FITTED} bonds"}
    if args.later:
        small = Continuum(constants["lambda"], constants["mu"], step, LATER_HALF)
        numbers["later"] = later(small, toughness, zone, args.out / "atoms.json")
    figure, ax = panels(5, 3.6)
    halves = np.linspace(min(lengths) / 2, max(lengths) / 2, 60)
    curve = [100 * np.sqrt(toughness / release(half + zone)) for half in halves]
    ax.plot(2 * halves * step, curve, "k", linewidth=0.8, label="one toughness")
    ax.plot([n * step for n in lengths], [100 * measured[f"{n} bonds"] for n in lengths], "o")
    ax.set(xlabel="length of the crack [Å]", ylabel="strain at which it opens [%]")
    ax.set_title("Longer cracks open sooner, as one toughness says")
    ax.legend(frameon=False)
    figure.savefig(args.out / "critical_strain.png", dpi=120)
    print(json.dumps(numbers, ensure_ascii=False, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
