"""Cracks along other directions of graphene: the toughness of zigzag edges predicts them.

Zigzag edges are the cheapest, so a crack along another direction kinks towards the nearest zigzag
one, an angle θ away. The bonds that must break there stand across the new edge: its opening pulls
them, sliding does not, and the opening is cos³(θ/2) of what it is straight ahead (theory, C19).
The toughness is fitted on one zigzag crack; the strengths behind Irwin's zones come from sheets
without a crack, pulled along either axis. For comparison, armchair cracks with a toughness of their
own, fitted on one of them.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np
from tqdm import tqdm

from examples.cracked_graphene import Continuum, fitted
from examples.figures import panels
from tools.cracked_sheet import cracked_sheet, critical_strain, finished, ideal_strength, opened
from tools.elastic import elastic_constants
from tools.graphene import bond_length
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json

LARGE, SMALL = 40, 20
"""Half sides of two sheets inside their rims, in hexagons."""
SLANTED = (19.10660535, 13.89788625)
FITTED, OWN = (0.0, 24, LARGE), (30.0, 24, LARGE)
"""The zigzag crack that the toughness is fitted on, and the armchair one of a fit of its own."""
CASES = (
    FITTED,
    OWN,
    *((angle, 24, LARGE) for angle in SLANTED),
    (0.0, 16, LARGE),
    (30.0, 16, LARGE),
    (30.0, 12, LARGE),
    (30.0, 32, LARGE),
    (30.0, 16, SMALL),
    (30.0, 10, SMALL),
    *((angle, 16, SMALL) for angle in SLANTED),
)
"""Degrees from the zigzag direction to the crack, its length in hexagons, and the sheet."""


def kink(turned: float) -> float:
    """Angle θ from a crack to the nearest zigzag direction [degrees], 0 to 30."""
    away = turned % 60
    return min(away, 60 - away)


def crack(turned: float, count: int, step: float) -> np.ndarray:
    """Ends of a crack that runs as far from atoms as it can, near the middle, shape [2, 2]."""
    end = count / 2 * step
    x = cracked_sheet([], half=end + 10, turned=turned).positions
    heights = np.unique(np.round(x[(np.abs(x[:, 0]) < end + 2) & (np.abs(x[:, 1]) < 4), 1], 6))
    gap, middle = np.diff(heights), (heights[1:] + heights[:-1]) / 2
    widest = middle[gap > gap.max() - 1e-3]
    y = widest[np.argmin(np.abs(widest))]
    return np.array([(-end, y), (end, y)])


@dataclass(frozen=True)
class Sheets:
    """What sheets without a crack say: E and strength, and the continuum's release.

    `E`: Young's modulus [TPa]; `strengths`: across zigzag rows and along them [TPa]; `step`: width
    of a hexagon [Å]; `release`: G at unit strain by half length in hexagons [TPa Å], of each sheet.
    """

    E: float
    strengths: tuple[float, float]
    step: float
    release: dict[int, Callable[[float], float]]

    def strength(self, turned: float) -> float:
        """Of a sheet pulled across a direction [TPa]: the lowest harmonic that a hexagon allows."""
        across, along = self.strengths
        return (across + along) / 2 + (across - along) / 2 * float(np.cos(np.radians(6 * turned)))

    def zone(self, needed: float, turned: float) -> float:
        """Irwin's r [hexagons] of a crack that needs this release straight ahead [TPa Å]."""
        return self.E * needed / (2 * np.pi * self.strength(turned) ** 2) / self.step

    def critical(self, needed: float, turned: float, half: float, sheet: int) -> float:
        """The strain at which a crack, its half length in hexagons, has that release."""
        return float(np.sqrt(needed / self.release[sheet](half + self.zone(needed, turned))))

    def needed(self, strain: float, turned: float, half: float) -> float:
        """The release that a crack of the large sheet has at its critical strain [TPa Å]."""
        needed = 0.0
        for _ in range(50):
            needed = self.release[LARGE](half + self.zone(needed, turned)) * strain**2
        return needed


def sheets(step: float) -> Sheets:
    """All that is known without a crack."""
    constants = elastic_constants(step / np.sqrt(3))
    strengths = (ideal_strength()[0], ideal_strength(along_zigzag=True)[0])
    solids = {
        half: Continuum(constants["lambda"], constants["mu"], step, half) for half in (LARGE, SMALL)
    }
    releases = {LARGE: solids[LARGE].release(14), SMALL: solids[SMALL].release(10)}
    return Sheets(constants["E"], strengths, step, releases)


def label(case: tuple[float, int, int], step: float) -> str:
    """Direction and length of a crack, and the sheet if it is the small one."""
    turned, count, half = case
    return f"{turned:.1f}°, {count * step:.0f} Å" + (", small sheet" if half == SMALL else "")


def atoms(cases: tuple, step: float, kept: Path) -> dict[str, dict]:
    """Critical strains by LAMMPS and half lengths [hexagons]; each is written when it is found."""
    measured = finished(kept, "strain", "half_length")
    for case in tqdm(cases, desc="sheets", unit="sheet"):
        turned, count, half = case
        if label(case, step) not in measured:
            ends, guess = crack(turned, count, step), 0.03 * np.sqrt(24 / count)
            result = critical_strain([ends], guess, half=half * step, turned=turned)
            body = cracked_sheet([ends], half=half * step, turned=turned)
            result["half_length"] = opened(body, ends) / 2 / step
            measured[label(case, step)] = result
            write_json(kept, measured)
    return {label(case, step): measured[label(case, step)] for case in cases}


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "crack_directions", json=True)
    parser.add("--cases", type=int, default=len(CASES), help="how many of them")
    args = parser.parse_args(argv)
    step = float(np.sqrt(3) * bond_length())
    if args.cases < 1:
        parser.error(f"--cases: expected a number ≥ 1, got {args.cases}")
    cases = CASES[: args.cases]
    measured = atoms(cases, step, args.out / "atoms.json")
    known = sheets(step)
    base = measured[label(FITTED, step)]["strain"]
    toughness, _ = fitted(known.release[LARGE], base, known.E, known.strengths[0], step)
    own = measured.get(label(OWN, step))
    armchair = known.needed(own["strain"], 30.0, own["half_length"]) if own else None
    table: dict = {}
    for case in cases:
        (turned, _, half), name = case, label(case, step)
        strain, length = measured[name]["strain"], measured[name]["half_length"]
        table[name] = {"length": 2 * length * step, "atoms": strain}
        if case == FITTED:
            continue
        ways = {"error": (6, toughness), "error if sliding counted": (4, toughness)}
        if turned == 30.0 and case != OWN and armchair:
            ways["error with a toughness of its own"] = (0, armchair)
        for word, (power, given) in ways.items():
            needed = given / np.cos(np.radians(kink(turned)) / 2) ** power
            predicted = known.critical(needed, turned, length, half)
            if word == "error":
                table[name]["predicted"] = predicted
            table[name][word] = predicted / strain - 1
    numbers = {"G_c": 100 * toughness, "strengths": known.strengths, "cracks": table}
    if armchair:
        numbers["armchair's own"] = 100 * armchair
    draw(args.out / "directions.png", table)
    print(json.dumps(numbers, ensure_ascii=False, indent=None if args.json else 1))
    return 0


def draw(path: Path, table: dict) -> None:
    """Predicted over atoms' critical strains."""
    figure, ax = panels(5, 3.6)
    names = [name for name in table if "error" in table[name]]
    for word, mark in (("error", "o"), ("error if sliding counted", "x")):
        ax.plot([100 * table[name][word] for name in names], range(len(names)), mark, label=word)
    ax.axvspan(-3, 3, color="0.9")
    ax.set(yticks=range(len(names)), yticklabels=names, xlabel="error of the critical strain [%]")
    ax.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    sys.exit(exit_status(main))
