"""Cracks beside and behind each other, near rims: one factor, fitted on one crack, predicts them.

The sheet around is elastic to third order. The rows of bonds ahead of the tips pull by the law of a
row between two halves of a sheet (theory, C20–C23); both come from sheets without a crack. Rows
are as strong as the factor says.
"""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np
from tqdm import tqdm

from examples.figures import panels
from tools.cracked_sheet import critical_strain, finished
from tools.graphene import bond_length
from tools.options import Options
from tools.row_separation import whole
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json

BOND = bond_length()
STEP, ROW = float(np.sqrt(3) * BOND), 1.5 * BOND
"""Between bonds along a zigzag row, and between such rows [Å]."""
FITTED = "61 Å, large sheet"
CASES: dict[str, tuple[tuple[tuple[int, int, int], ...], tuple[float, float], float]] = {
    FITTED: (((-12, 12, 0),), (40 * STEP, 40 * STEP), 0.0316),
    "25 Å": (((-5, 5, 0),), (20 * STEP, 20 * STEP), 0.0465),
    "40 Å": (((-8, 8, 0),), (20 * STEP, 20 * STEP), 0.0422),
    "30 Å, sheet 80 × 120": (((-6, 6, 0),), (40.0, 60.0), 0.043),
    "30 Å, sheet 80 × 80": (((-6, 6, 0),), (40.0, 40.0), 0.043),
    "two in line, 20 Å, 10 apart": (((2, 10, 0), (-10, -2, 0)), (20 * STEP, 20 * STEP), 0.038),
    "two stacked, 30 Å, 17.5 apart": (((-6, 6, 4), (-6, 6, -4)), (60.0, 60.0), 0.045),
    "echelon, 30 Å, 17.5 apart": (((-12, 0, 4), (0, 12, -4)), (60.0, 60.0), 0.040),
    "three stacked, 25 Å, 13 apart": (((-5, 5, 6), (-5, 5, 0), (-5, 5, -6)), (50.0, 60.0), 0.048),
    "echelon over each other, 30 Å, 13 apart": (((-10, 2, 2), (-2, 10, -4)), (60.0, 50.0), 0.039),
    "35 Å off the middle, 120 × 70": (((2, 16, 6),), (60.0, 35.0), 0.045),
    "40 and 20 Å stacked, 22 apart": (((-8, 8, 6), (-4, 4, -4)), (60.0, 60.0), 0.041),
    "echelon, gap 10 Å, 13 apart": (((-14, -2, 4), (2, 14, -2)), (60.0, 50.0), 0.038),
    "two stacked, 40 Å, 110 × 180": (((-8, 8, 4), (-8, 8, -4)), (55.0, 90.0), 0.041),
    "four of 20 Å": (((-14, -6, 8), (4, 12, 6), (-7, 1, -4), (5, 13, -10)), (60.0, 60.0), 0.044),
    "51 Å, sheet 160 × 70": (((-10, 10, 2),), (80.0, 35.0), 0.040),
    "30 and 15 Å in line, 10 apart": (((-9, 3, 0), (7, 13, 0)), (50.0, 50.0), 0.0396),
    "25 Å near two rims": (((8, 18, -8),), (60.0, 40.0), 0.0486),
    "echelon over each other, 40 Å, 17.5 apart": (
        ((-12, 4, 4), (-4, 12, -4)),
        (55.0, 45.0),
        0.0422,
    ),
    "three stacked, 30 Å, 17.5 apart": (
        ((-6, 6, 8), (-6, 6, 0), (-6, 6, -8)),
        (45.0, 60.0),
        0.0561,
    ),
    "four of 20 Å otherwise": (
        ((-13, -5, 2), (-2, 6, 8), (3, 11, -6), (-9, -1, -10)),
        (60.0, 60.0),
        0.042,
    ),
    "three of 15 Å": (((-9, -3, 4), (1, 7, -2), (-4, 2, -8)), (50.0, 45.0), 0.042),
    "five of 20 Å": (
        ((-14, -6, 6), (6, 14, 6), (-4, 4, 0), (-14, -6, -6), (6, 14, -6)),
        (60.0, 50.0),
        0.042,
    ),
}
"""Cracks by their ends and their row, in steps and in rows; half sides of the sheet [Å]; a strain
from which to pull more slowly. Nothing was settled on with the last three in sight."""


def ends(case: str) -> list[np.ndarray]:
    """Ends of a case's cracks [Å], shape [2, 2] each."""
    return [np.array([(a * STEP, k * ROW), (b * STEP, k * ROW)]) for a, b, k in CASES[case][0]]


def atoms(cases: list[str], kept: Path) -> dict[str, float]:
    """Critical strains by LAMMPS; each is written down when it is found, and not found again."""
    measured = finished(kept, "strain")
    for case in tqdm(cases, desc="sheets", unit="sheet"):
        if case not in measured:
            _, half, guess = CASES[case]
            measured[case] = critical_strain(ends(case), guess, half=half)
            write_json(kept, measured)
    return {case: measured[case]["strain"] for case in cases}


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "crack_groups", json=True)
    parser.add("--cases", nargs="+", type=int, help="numbers, from 1; 0 is always there")
    parser.add("--linear", action="store_true", help="the sheet around is linear")
    args = parser.parse_args(argv)
    names, wanted = list(CASES), args.cases or range(1, len(CASES))
    if not all(0 < number < len(names) for number in wanted):
        parser.error(f"--cases: expected numbers from 1 to {len(names) - 1}, got {args.cases}")
    cases = [FITTED, *(names[number] for number in wanted)]
    measured = atoms(cases, args.out / "atoms.json")
    known = whole(linear=args.linear)
    base, single = measured[FITTED], known.held(ends(FITTED), CASES[FITTED][1])
    factor = known.factor(single, base)
    plain = single.critical_strain(known.law)
    table = {FITTED: {"atoms": base, "error without a factor": plain / base - 1}}
    for case in tqdm(cases[1:], desc="continuum"):
        cracks = known.held(ends(case), CASES[case][1])
        strain, predicted = measured[case], cracks.critical_strain(known.law.times(factor))
        error = predicted / strain - 1
        table[case] = {"atoms": strain, "predicted": predicted, "error": error}
    numbers = {"factor": factor, "strength": float(known.law.traction.max()), "cracks": table}
    figure, ax = panels(6, 4.2)
    ax.plot([100 * table[case]["error"] for case in cases[1:]], range(1, len(cases)), "o")
    ax.axvspan(-3, 3, color="0.9")
    ax.set(yticks=range(1, len(cases)), yticklabels=cases[1:])
    ax.set(xlabel="error of the critical strain [%]")
    figure.savefig(args.out / "groups.png", dpi=120)
    print(json.dumps(numbers, ensure_ascii=False, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
