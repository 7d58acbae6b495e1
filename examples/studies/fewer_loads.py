"""How many loads a law needs: designed ones, and waves at random.

    python examples/studies/fewer_loads.py [--seconds] [--json] [--out runs/fewer_loads]

Errors are E_u on the main job's validation loads and disks, which no choice here looks at. Two
laws: the default LPS, which finds its moduli, and tensors on 28 bonds with the potential's moduli
held. Designed loads hold every wave down to 20 Å at once and are strained to 2 % as the waves are,
each and its reverse.
"""

import argparse
import json
import sys
import tempfile
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import torch

import warp_peri as wp
from examples.figures import headline, note, panels, save_figure
from examples.predict import tell
from examples.train_graphene import DATA, make_data
from examples.train_graphene import main as train_main
from tools import make_graphene as making
from tools.loads import DESIGNED as TWO
from tools.loads import TRAINING, both_ways
from tools.options import Options
from tools.samples import _statics, solve_samples
from warp_peri.errors import exit_status
from warp_peri.launch import set_threads
from warp_peri.points.samples import part

OUT = ROOT / "runs" / "fewer_loads"
DESIGNED = {1: (0, 1, 2, 3), 2: (0, 2, 4, 6), 4: (0, 4)}
"""How many designed loads, and the first seed of each set of them."""
RANDOM, DRAWS = (1, 2, 4, 8, 16, 35), 5


def designed(count: int) -> wp.Samples:
    """Two samples of each of so many designed loads, on the nodes of the training set."""
    loads = both_ways(range(count))
    sheet, _ = making.graphene_bodies()
    samples = making.solve_all({sheet: loads}, DATA.with_suffix(".cache"), 1, False)[sheet]
    return making.point_set(sheet, loads, samples, spacing=5.0)


def errors(law: Any, samples: wp.Samples, data: Any) -> dict[str, Any]:
    """E_u in % on validation and disks, and seconds; what a law refuses, in words."""
    start = time.process_time()
    try:
        material = wp.fit(samples, law, progress=False).material
    except wp.InputError as refused:
        return {"refused": str(refused)}
    seconds = time.process_time() - start
    sets = (100 * wp.evaluate(material, data[name])["E_u"] for name in ("val", "test"))
    return {"E_u": [float(value) for value in sets], "seconds": seconds}


def laws(data: Any) -> dict[str, Any]:
    """By name."""
    truth = data.provenance["truth"]
    lam, mu = truth["lambda"], truth["mu"]
    moduli = np.array([[lam + 2 * mu, lam, 0], [lam, lam + 2 * mu, 0], [0, 0, mu]])
    return {
        "LPS": wp.LPS(20.0, wp.Bernstein(10), wp.methods.Optimum(moduli="long waves")),
        "tensors": wp.Micromodulus(15.0, "4mm", moduli=moduli, normalise=True),
    }


def main_job() -> dict[str, dict[str, float]]:
    """Seconds of the main job from nothing, on one process: learned from seventy waves, and from
    two loads both ways. `atoms`: of LAMMPS for the training loads; `data`: of all sets."""
    sheet, _ = making.graphene_bodies()
    found = {}
    for name, training in (("waves", TRAINING), ("designed", TWO)):
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made)
            file, cache, out = folder / "data.h5", folder / "cache", folder / "run"
            cache.mkdir()
            _statics.cache_clear()
            start = time.perf_counter()
            solve_samples(sheet, training, cache)
            atoms = time.perf_counter() - start
            making.make_graphene(
                file, jobs=1, cache=cache, training=making.LOADS.get(name), progress=False
            )
            data = time.perf_counter() - start
            with redirect_stdout(sys.stderr):  # what it says is no part of the JSON
                failed = train_main(["--data", str(file), "--out", str(out)])
            if failed:
                raise OSError(f"{name}: the main job failed")
            numbers = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
        seconds = numbers["seconds"] | {"atoms": atoms, "data": data}
        seconds["all"] += data
        found[name] = seconds | {f"E_u {n}": e for n, e in numbers["E_u"].items()}
    return found


def draw(path: Path, rows: list[dict[str, Any]]) -> None:
    """Median error on the disks against the number of loads, for both laws."""
    figure, axes = panels(8.4, 3.6, count=2, sharey=True, subplot_kw={"ymargin": 0.1})
    kinds = {"random": "at random", "designed": "designed"}
    for ax, (law, title) in zip(axes, {"LPS": "LPS", "tensors": "crystal model"}.items()):
        known = [row for row in rows if row["law"] == law and "E_u" in row]
        for kind, label in kinds.items():
            some = [(row["loads"], row["E_u"][1]) for row in known if row["kind"] == kind]
            counts = sorted({n for n, _ in some})
            middle = [np.median([error for n, error in some if n == count]) for count in counts]
            (line,) = ax.loglog(counts, middle, "o-")
            up = -13 if kind == "designed" else 5
            note(ax, label, (counts[0], middle[0]), (3, up), line.get_color())
        every = next(row for row in known if row["kind"] == "all")
        ax.axhline(every["E_u"][1], color="0.4", ls="--", lw=0.8)
        note(ax, f"all {every['loads']} waves", (35, every["E_u"][1]), (0, -11), ha="right")
        ax.set(xlabel="loads to learn from", title=title)
        ax.set_xticks(RANDOM, [*map(str, RANDOM)])
    axes[0].set_ylabel("error on unseen disks [%]")
    headline(figure, "A few designed loads teach what all waves do")
    save_figure(figure, path, dpi=150, bbox_inches=None)


def run(given: argparse.Namespace) -> dict[str, Any]:
    """Every fit; what metrics.json holds."""
    set_threads(1)
    torch.set_num_threads(1)
    if given.seconds:
        return {"main_job": main_job()}
    data = wp.load(given.data or make_data(-1, 10.0))
    pool, mixed = data["train"], designed(8)
    random, rows = np.random.default_rng(0), []

    def add(name: str, kind: str, samples: wp.Samples, count: int | None = None) -> None:
        row = {"law": name, "kind": kind, "loads": count or len(samples)}
        rows.append(row | errors(known[name], samples, data))
        print(rows[-1], file=sys.stderr, flush=True)

    known = laws(data)
    for name in known:
        add(name, "all", pool)
        for count, firsts in DESIGNED.items():
            for first in firsts:
                some = slice(2 * first, 2 * (first + count))
                add(name, "designed", part(mixed, some), count)
                add(name, "one way", part(mixed, slice(some.start, some.stop, 2)), count)
        for count in RANDOM:
            for _ in range(DRAWS if name == "tensors" else 2):
                add(name, "random", part(pool, random.choice(len(pool), count, replace=False)))
    draw(given.out / "fewer_loads.png", rows)
    return {"ratios": ratios(rows), "main_job": main_job(), "rows": rows}


def ratios(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Errors on validation and disks over those of all loads: mean and worst of the draws."""
    found: dict[str, Any] = {}
    for law in dict.fromkeys(row["law"] for row in rows):
        mine = [row for row in rows if row["law"] == law]
        whole = np.array(next(row["E_u"] for row in mine if row["kind"] == "all"))
        for kind, loads in dict.fromkeys((row["kind"], row["loads"]) for row in mine):
            same = [row for row in mine if (row["kind"], row["loads"]) == (kind, loads)]
            over = np.array([row["E_u"] for row in same if "E_u" in row]) / whole
            if len(over):
                entry = {"median": np.median(over, axis=0), "worst": over.max(axis=0)}
                found[f"{law}, {loads} {kind}"] = {n: v.tolist() for n, v in entry.items()}
    return found


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True)
    parser.add("--data", type=Path, help="the main job's data (made if not there)")
    parser.add("--out", type=Path, default=OUT, help="folder for the results")
    parser.add("--seconds", action="store_true", help="of the main job, and nothing else")
    tell(parser.parse_args(arguments), run)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
