"""What the filtered form's ridge ρ gives and costs, by training loads alone.

Prints for each ρ the residual on fifths of the training loads that a fit did not see (both loads
of a wave vector stay together), the one on all of them, and the proven strain; leaves them as JSON.
"""

import argparse
import dataclasses
import json
import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
from tqdm import tqdm

import warp_peri as wp
from examples.nonlinear import OUT
from examples.train_graphene import make_data
from tools.options import Options
from warp_peri import Bernstein, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json
from warp_peri.learning.nonlinear import NonlinearFit
from warp_peri.methods import Optimum, Smoothing
from warp_peri.third_order.operator import PlacedThirdOrder

RIDGES = (0.05, 0.07, 0.1, 0.14, 0.2)
PARTS = 5


def only(samples: Samples, some: np.ndarray) -> Samples:
    """Some of the samples."""
    arrays = {name: values[some] for name, values in samples.arrays.items()}
    return dataclasses.replace(samples, u=samples.u[some], b=samples.loads[some], arrays=arrays)


def parts_of(samples: Samples, seed: int) -> np.ndarray:
    """Number of the part of each sample, shape [S]; a wave vector is in one part."""
    vectors = np.round(samples.arrays["wave_vector"], 6)
    _, wave = np.unique(vectors, axis=0, return_inverse=True)
    order = np.random.default_rng(seed).permutation(wave.max() + 1)
    part: np.ndarray = order[wave.ravel()] % PARTS
    return part


def learn(samples: Samples, horizon: float, ridge: float) -> NonlinearFit:
    """The filtered form as examples/nonlinear.py learns it."""
    return wp.fit(
        samples,
        wp.ThirdOrder(
            wp.LPS(
                horizon,
                Bernstein(10, two_functions=True),
                method=Optimum(moduli="isotropic"),
                normalise=True,
            ),
            Smoothing(ridge=ridge),
        ),
        progress=False,
    )


def residuals(fit: NonlinearFit, samples: Samples) -> list[float]:
    """Relative residual of each sample."""
    b = samples.loads[:, samples.interior]
    left = PlacedThirdOrder(fit.material, samples)(samples.u) - b
    errors: list[float] = (
        np.linalg.norm(left, axis=(1, 2)) / np.linalg.norm(b, axis=(1, 2))
    ).tolist()
    return errors


def run(given: argparse.Namespace) -> dict[str, dict[str, float]]:
    """By ρ: residual on held-out and on all training loads, and the proven strain."""
    train = wp.load(given.data or make_data(-1, 10.0))["train"]
    part = parts_of(train, given.seed)
    rows = {}
    for ridge in tqdm(RIDGES, disable=given.json or None, leave=False):
        held = []
        for number in range(PARTS):
            fit = learn(only(train, part != number), given.horizon, ridge)
            held += residuals(fit, only(train, part == number))
        fit = learn(train, given.horizon, ridge)
        rows[f"{ridge:g}"] = {
            "held_out": float(np.mean(held)),
            "train": fit.E_res_train,
            "proven_strain": fit.material.proven_strain(train.spacing),
        }
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True, defaults=True)
    parser.add("--horizon", type=float, default=20.0, help="δ [Å]")
    parser.add("--data", type=Path, help="the main job's data (made if not there)")
    parser.add("--seed", type=int, default=0, help="of the parts")
    parser.add("--out", type=Path, default=OUT, help="folder for filter.json")
    given = parser.parse_args(arguments)
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        rows = run(given)
    write_json(given.out / "filter.json", rows)
    if given.json:
        print(json.dumps(rows))
        return 0
    print("ridge   held out  training  proven |H|   [%]")
    for ridge, row in rows.items():
        print(ridge.ljust(6) + "".join(f"{100 * value:10.3f}" for value in row.values()))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
