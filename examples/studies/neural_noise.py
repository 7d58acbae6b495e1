"""Noise on the displacements that a network and a dictionary learn from: the anisotropic sheet.

Normal noise, independent at every node of the training squares, of 0, 1, 2 and 5 % of their root
mean square; all other squares are clean. The dictionary has free signs, or signs that guarantee
stability at rest. The network is smaller than printed, (2, 32, 64, 1) and
(4, 64, 64, 1), so that four trainings take minutes. What is done is kept in --out.
"""

import argparse
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import torch

from examples import neural_sets
from examples.hgo_square import SAFE
from examples.neural_rivals import dictionary
from examples.neural_sets import Sets
from examples.prose import table
from examples.studies.papers import keeper
from tools.make_hgo import SPACING
from tools.options import Options
from warp_peri import Samples
from warp_peri.errors import exit_status
from warp_peri.neural import NeuralOperator, Training, evaluate, train
from warp_peri.tissue import hyperelastic_errors
from warp_peri.tissue.energy_fit import fit_energy

REACH = 3
LEVELS = (0.0, 0.01, 0.02, 0.05)
JUDGED = ("val", "test")
KINDS = ("E_res", "E_u", "converged")
"""Errors, and the share of equilibria that are found."""


def noisy(samples: Samples, level: float) -> Samples:
    """The samples with noise of so much of their root mean square."""
    size = level * np.sqrt(np.mean(samples.u**2))
    noise = np.random.default_rng(7).normal(0, size, samples.u.shape) if level else 0.0
    return Samples(samples.points, samples.u + noise, samples.b)


def learned(sets: Sets, level: float, epochs: int) -> NeuralOperator:
    """A network that has learned from so noisy squares."""
    seen = noisy(sets["train"], level)
    material = NeuralOperator(
        REACH * SPACING, (32, 64), (64, 64), anisotropic=True, strain=2.0, units=seen.points.units
    )
    train(material, seen, sets["val"], Training(epochs=epochs, batch=5))
    return material


def network(sets: Sets, level: float, epochs: int) -> dict[str, float | None]:
    """Errors on clean squares of such a network; E_u is over the equilibria that are found."""
    material = learned(sets, level, epochs)
    errors: dict[str, float | None] = {}
    for name in JUDGED:
        found = evaluate(material, sets[name])
        there = np.array(found["samples"]["converged"], bool)
        solved = np.array(found["samples"]["E_u"])[there]
        values = (found["E_res"], float(solved.mean()) if len(solved) else None, there.mean())
        errors |= {f"{key} {name}": value for key, value in zip(KINDS, values, strict=True)}
    return errors


def terms(sets: Sets, level: float, guaranteed: bool) -> dict[str, float | None]:
    """The same of the dictionary; its E_u is over the equilibria that are found."""
    seen, errors = noisy(sets["train"], level), dict[str, float | None]()
    solid = (
        fit_energy(seen, SAFE, positive=True).material if guaranteed else dictionary(seen, REACH)
    )
    for name in JUDGED:
        found = hyperelastic_errors(solid, sets[name])
        share = 1 - found["not_solved"] / len(sets[name])
        values = (found["E_res"], found["E_u"] if share else None, share)
        errors |= {f"{key} {name}": value for key, value in zip(KINDS, values, strict=True)}
    return errors


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "neural_noise")
    parser.add("--epochs", type=int, default=25, help="of each network")
    parser.add("--jobs", type=int, default=-1, help="processes that make data")
    parser.add("--data", type=Path, default=ROOT / "data")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    sets = neural_sets.hgo(given.data / "hgo", REACH, mirror=False, jobs=given.jobs, progress=True)
    kept, rows = keeper(given.out), []
    for name in ("free signs", "guaranteed", "network"):
        for level in LEVELS:
            work = partial(one, sets, name, level, given)
            errors: dict[str, Any] = kept(f"{name}_{level:g}", work)
            cells = ["–" if e is None else f"{100 * e:.2f}" for e in errors.values()]
            rows.append([f"{100 * level:g} %", name, *cells])
    print(table(["noise", "", *errors], rows))
    return 0


def one(
    sets: Sets, name: str, level: float, given: argparse.Namespace
) -> Mapping[str, float | None]:
    """Errors of one of the three at one level."""
    if name == "network":
        return network(sets, level, given.epochs)
    return terms(sets, level, name == "guaranteed")


if __name__ == "__main__":
    sys.exit(exit_status(main))
