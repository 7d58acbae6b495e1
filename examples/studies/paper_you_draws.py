"""Algorithm 1 as printed from many seeds: quantiles of its constants and errors.

    python examples/studies/paper_you_draws.py --draws 20

Some four minutes of a core a draw; each is kept in runs/papers/you_2021/, where the page on the
paper finds the first five, and a run that is stopped goes on.
"""

import sys
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples.prose import table
from examples.studies.paper_you_2021 import ALL_ERRORS, CHANGES, DATA, algorithm_1
from examples.studies.papers import keeper
from tools.options import Options
from warp_peri.errors import exit_status

QUANTILES = {
    "least": 0,
    "lower quartile": 0.25,
    "median": 0.5,
    "upper quartile": 0.75,
    "largest": 1,
}
KEYS = ("lam", "mu", "alpha", *ALL_ERRORS)


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__)
    parser.add("--draws", type=int, default=20)
    parser.add("--runs", type=Path, default=ROOT / "runs")
    given = parser.parse_args(arguments)
    data, (bounds, conditions) = wp.load(given.runs.parent / DATA), CHANGES["as printed"]
    kept, file = keeper(given.runs / "papers" / "you_2021"), f"algorithm_1_{bounds}_{conditions}"
    draws = [
        kept(f"{file}_{seed}", partial(algorithm_1, data, bounds, conditions, seed))
        for seed in range(given.draws)
    ]
    rows = []
    for name, q in QUANTILES.items():
        solved = {key: [run[key] for run in draws if run[key] is not None] for key in KEYS}
        some = {key: np.quantile(values, q) for key, values in solved.items()}
        rows.append([name, *(f"{(100 if 'E_' in k else 1) * v:.2f}" for k, v in some.items())])
    print(table([f"{given.draws} draws", *KEYS], rows))


if __name__ == "__main__":
    sys.exit(exit_status(main))
