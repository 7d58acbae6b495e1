"""Cracks along other directions of graphene: the toughness of zigzag edges predicts them.

A crack grows where the release of energy first pays for new edge. Zigzag edges are the cheapest, so
a crack along another direction kinks towards the nearest zigzag one, an angle θ away, and there the
release is cos⁴(θ/2) of what it is straight ahead (theory.md, C19). No number is fitted here: the
critical strain is that of a zigzag crack of the same length over cos²(θ/2).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from tools.cracked_sheet import cracked_sheet, critical_strain
from tools.graphene import bond_length
from warp_peri.errors import exit_status
from warp_peri.files.whole import write_json

HALF = 40
"""Half side of the sheet inside its rim, in hexagons."""
CASES = ((0.0, 24), (30.0, 24), (19.10660535, 24), (13.89788625, 24), (0.0, 16), (30.0, 16))
"""Degrees from the zigzag direction to the crack, and its length in hexagons."""


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


def main(argv: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=len(CASES), help="how many of them")
    parser.add_argument("--half", type=int, default=HALF, help="half side of the sheet [hexagons]")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "crack_directions")
    parser.add_argument("--json", action="store_true", help="print the numbers as one object")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    kept = args.out / f"atoms_{args.half}.json"
    measured = json.loads(kept.read_text()) if kept.exists() else {}
    step = float(np.sqrt(3) * bond_length())
    table: dict = {}
    for turned, count in tqdm(CASES[: args.cases], desc="sheets", unit="sheet"):
        name = f"{turned:.1f}°, {count * step:.0f} Å"
        if name not in measured:
            ends = [crack(turned, count, step)]
            guess = 0.03 * np.sqrt(24 / count)
            measured[name] = critical_strain(ends, guess, half=args.half * step, turned=turned)
            write_json(kept, measured)
        strain = measured[name]["strain"]
        zigzag = measured.get(f"{0:.1f}°, {count * step:.0f} Å")
        table[name] = {"atoms": strain}
        if turned and zigzag:
            predicted = zigzag["strain"] / np.cos(np.radians(kink(turned)) / 2) ** 2
            table[name] |= {"predicted": predicted, "error": predicted / strain - 1}
    figure = Figure(figsize=(5, 3.6), layout="constrained")
    ax = figure.subplots()
    angles = np.linspace(0, 30, 50)
    for count in sorted({case[1] for case in CASES[: args.cases]}):
        base = measured.get(f"{0:.1f}°, {count * step:.0f} Å")
        if base:
            curve = 100 * base["strain"] / np.cos(np.radians(angles) / 2) ** 2
            ax.plot(angles, curve, label=f"{count * step:.0f} Å")
    points = [(turned, 100 * measured[name]["strain"]) for (turned, _), name in zip(CASES, table)]
    ax.plot(*np.transpose(points), "ko", label="atoms")
    ax.set(xlabel="from the zigzag direction [degrees]", ylabel="critical strain [%]")
    ax.legend(frameon=False)
    figure.savefig(args.out / "directions.png", dpi=120)
    print(json.dumps(table, ensure_ascii=False, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
