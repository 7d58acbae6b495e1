"""Dumbbells teach laws of polymer stress, which are held to flows that no fit saw.

A rate of stress from mixed flows of Hookean dumbbells goes into law.json; a spring with a second
memory from FENE dumbbells, which have no law in closed form, is held to five other flows.

    python examples/polymer/learn.py --json      # numbers alone; results in runs/polymer_learn/
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples import prose
from examples.polymer import (
    FENEP,
    Dumbbells,
    RateLaw,
    TwistedSpringLaw,
    elongation,
    held,
    homogeneous,
    learn_rate,
    learn_twisted,
    mixed,
    shear,
    simulate,
    start_pairs,
)
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json, write_text

B = 50.0


def relative(value: np.ndarray, truth: np.ndarray) -> float:
    """Relative ℓ2 error in %."""
    return float(100 * np.linalg.norm(value - truth) / np.linalg.norm(truth))


def hookean_law(count: int, seed: int, pairs: int = 1000) -> RateLaw:
    """A rate learned from mixed flows of Hookean dumbbells, what the flow itself does known."""
    K = mixed(22, 200, 0.4, hold=10, seed=seed)
    all_of = start_pairs(simulate(Dumbbells(22, count, seed=seed), K, 0.05), 2)
    chosen = all_of.choose(pairs, np.random.default_rng(seed))
    return learn_rate(chosen, outside="allow")


def fene_law(count: int, seed: int, points: int = 200) -> TwistedSpringLaw:
    """A spring with a second memory, from shear, elongation and rest after them."""
    rates = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
    K = np.concatenate([shear(rates), elongation(np.array([0.25, 0.5, 1.0, 2.0]))])
    K = np.concatenate([held(K, 60), np.zeros((40, len(K), 4))])
    record = simulate(Dumbbells(len(K[0]), count, b=B, seed=seed), K, 0.1, steps=5)
    return learn_twisted(record, b=B, points=points, turns=min(120, points), outside="allow")


def fene_study(count: int, seed: int, points: int = 200) -> dict[str, Any]:
    """Flows no fit saw: relative ℓ2 over time of s_xy and N1, learned spring and FENE-P."""
    t = (np.arange(60) + 0.5) * 0.1
    K = np.zeros((60, 5, 4))
    K[:, 0] = shear(np.where(t < 4, 3.0, 0.0))
    K[:, 1] = shear(5 * np.sin(t))
    K[:, 2] = np.multiply.outer(t < 4, [1.0, 2.0, 0.3, -1.0])
    K[:, 3] = elongation(np.where(t < 4, 1.5, 0.0))
    K[:, 4] = np.where(t[:, None] < 3, shear(6.0), elongation(1.0))
    names = ["shear 3, then rest", "oscillating shear", "mixed, then rest", "elongation 1.5"]
    names.append("shear 6, then elongation 1")
    truth = simulate(Dumbbells(5, 4 * count, b=B, seed=seed + 50), K, 0.1, steps=5).stress
    numbers = {}
    learned = fene_law(count, seed, points)
    for law in (learned.spring_law, learned, FENEP(B)):
        C = homogeneous(law, K, 0.1)
        s = np.asarray(law.stress(C.reshape(-1, C.shape[-1]))).reshape(*C.shape[:2], 4)
        first = s[..., 0] - s[..., 2], truth[..., 0] - truth[..., 2]
        numbers[law.name] = {
            name: {
                "s_xy": relative(s[:, i, 1], truth[:, i, 1]) if i != 3 else None,
                "N1": relative(first[0][:, i], first[1][:, i]),
            }
            for i, name in enumerate(names)
        }
    return numbers


def table(rows: dict[str, dict[str, Any]]) -> str:
    """The numbers of `fene_study` as Markdown."""
    flows = [
        [name, law, "–" if row["s_xy"] is None else f"{row['s_xy']:.1f}", f"{row['N1']:.1f}"]
        for law, flows in rows.items()
        for name, row in flows.items()
    ]
    return prose.table(["FENE, flow no fit saw", "law", "s_xy %", "N1 %"], flows) + "\n"


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, "polymer_learn", json=True)
    parser.add("--dumbbells", type=int, default=10_000, help="in each Hookean run")
    parser.add("--fene", type=int, default=4000, help="in each FENE run")
    parser.add("--pairs", type=int, default=1000, help="increments of stress that a rate learns")
    parser.add("--points", type=int, default=200, help="conformations that a spring learns")
    parser.add("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    start, provenance = time.perf_counter(), {"dumbbells": given.dumbbells, "seed": given.seed}
    law = replace(hookean_law(given.dumbbells, given.seed, given.pairs), provenance=provenance)
    wp.save(given.out / "law.json", law)
    rows = fene_study(given.fene, given.seed, given.points)
    numbers: dict[str, Any] = {"fene": rows, "sizes": {"FENE": 9 * given.fene}}
    numbers["seconds"] = time.perf_counter() - start
    write_json(given.out / "numbers.json", numbers)
    write_text(given.out / "table.md", table(rows))
    print(json.dumps(plain(numbers), indent=2) if given.json else table(rows))


if __name__ == "__main__":
    sys.exit(exit_status(main))
