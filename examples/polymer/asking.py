"""A polymer flow that asks for its own data: FENE dumbbells go along where the law has none.

The law starts with weak shear and elongation. When a cell of the flow leaves these data, dumbbells
feel what the cell felt, the law is learned again and the flow goes on. Without that the first law
is wrong by tens of per cent, and says so only by a warning.

    python examples/polymer/asking.py --json     # numbers alone; figure in runs/polymer_asking/
"""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import warp_peri as wp
from examples.figures import panels
from examples.polymer import (
    FENEP,
    Dumbbells,
    Ensembles,
    PlaneFlow,
    TwistedSpringLaw,
    elongation,
    held,
    learn_twisted,
    shear,
    simulate,
)
from examples.polymer.active import LearningClosure, replayed
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json

B, CELLS = 50.0, 24
FLOW = PlaneFlow(1.0, 1.0, CELLS, force=lambda t: 12.0)


def learn(records: list[Ensembles]) -> TwistedSpringLaw:
    return learn_twisted(records, b=B, points=150, outside="allow")


def run(fluid: Any) -> wp.Motion:
    return wp.move(fluid, FLOW, until=6.0, dt=0.01, every=10)


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, "polymer_asking", json=True)
    parser.add("--dumbbells", type=int, default=3000, help="in each record")
    parser.add("--reference", type=int, default=3000, help="in each cell")
    parser.add("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    K = held(np.concatenate([shear([0.5, 1.0, 2.0]), elongation([0.25, 0.5])]), 60)
    weak = simulate(Dumbbells(5, options.dumbbells, b=B, seed=options.seed), K, 0.1, steps=5)
    replay = replayed(options.dumbbells, B, options.seed + 1)
    learning = LearningClosure([weak], learn, replay, FLOW.De, CELLS)
    dumbbells = Dumbbells(CELLS, options.reference, b=B, seed=77, common=True, matched=True)
    runs = {
        "coupled dumbbells": run(dumbbells),
        "weak flows alone": run(learn([weak])),
        "learned on the way": run(learning),
        "the same law again": run(learning.law),
        "FENE-P": run(FENEP(B)),
    }
    truth = runs["coupled dumbbells"]
    size = np.linalg.norm(truth["u"])
    errors = {name: 100 * np.linalg.norm(r["u"] - truth["u"]) / size for name, r in runs.items()}
    numbers: dict[str, Any] = {"error %": {name: float(e) for name, e in errors.items() if e}}
    numbers["asked (t, cell, gaps)"] = [list(map(float, row)) for row in learning.asked]
    folder = options.out
    write_json(folder / "numbers.json", numbers)
    figure, axes = panels(6, 3.8)
    for (name, r), style in zip(runs.items(), ("k-", "C3:", "C0--", "C2-.", "C1:")):
        axes.plot(r.time, r["u"][:, CELLS // 2], style, label=name)
    for t, *_ in learning.asked:
        axes.axvline(t * FLOW.De, color="0.7", lw=0.8)
    axes.set(xlabel="t / t0", ylabel="u / U in the middle")
    axes.legend(frameon=False)
    figure.savefig(folder / "velocity.png", dpi=130)
    print(json.dumps(numbers, indent=None if options.json else 2))


if __name__ == "__main__":
    sys.exit(exit_status(main))
