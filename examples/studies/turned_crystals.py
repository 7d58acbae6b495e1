"""Crystals at an angle to the nodes: is a model as good there? Disks of many loads.

A crystal and its loads are turned together, so that nothing but the nodes differs. Prints mean
errors by angle, and the mean over random loads of turned over straight with its standard error.
Each printed load is solved in several directions to the crystal: round the rim it has the symmetry
of the nodes, so that one direction alone says more about the load than about the solid. Takes the
models that examples/nonlinear.py left.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
from tqdm import tqdm

import warp_peri as wp
from examples.nonlinear import OUT
from examples.studies.nonlinear_checks import rotation, turned_nodes
from examples.train_graphene import DATA
from tools.loads import TEST, RandomRim, RimLoad
from tools.make_graphene import graphene_bodies
from tools.make_strained import solve_strained, strained_file
from tools.options import Options
from tools.samples import Sample, read_sample
from warp_peri import Model
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked, write_json
from warp_peri.third_order.material import NonlinearModel

ANGLES = (0.0, 5.0, 10.0, 17.0, 23.0, 30.0, 45.0)
"""Of the crystal [degrees]. It repeats every 60° and the nodes every 90°, so that all turns
are between 0 and 30°."""
PRINTED = (0.0, 17.0)
"""Of crystals under the printed loads, in all their directions [degrees]."""
DIRECTIONS = 6
"""Of each printed load, along one period of it and the nodes."""
PERIODS = {1: 90.0, 2: 90.0, 3: 360.0, 4: 360.0}
STRAIN = 0.02


@dataclass(frozen=True)
class TurnedRim:
    """A printed load, turned against the crystal."""

    case: int
    degrees: float

    @property
    def load_id(self) -> str:
        return f"table2-{self.case}-by-{self.degrees:g}"

    def shape(self, positions: np.ndarray, box: tuple[float, float] | None = None) -> np.ndarray:
        """At positions [Å] of a disk centred on the origin; shapes [A, 2]."""
        turn = rotation(self.degrees).T
        return RimLoad(self.case).shape(positions @ turn.T) @ turn


def disks(cache: Path, loads: Sequence[Any]) -> list[Sample]:
    """Disks under loads scaled to the same strain; by LAMMPS what the cache lacks."""
    body = graphene_bodies()[1]
    cache.mkdir(parents=True, exist_ok=True)
    files = [strained_file(cache, body, load, STRAIN) for load in loads]
    missing = [load for load, file in zip(loads, files) if read_sample(file) is None]
    for some in tqdm(range(0, len(missing), 8), unit="x8 disks", disable=not missing):
        solve_strained(body, missing[some : some + 8], [STRAIN], cache)
    samples = [sample for sample in map(read_sample, files) if sample is not None]
    if len(samples) < len(loads):
        raise OSError(f"{cache}: samples just made cannot be read back")
    return samples


def errors(
    models: Mapping[str, Model | NonlinearModel], samples: Sequence[Sample], angles: Sequence[float]
) -> dict[str, dict[str, list[float]]]:
    """E_u of each sample by model and angle, crystal and loads turned against the nodes."""
    table: dict[str, dict[str, list[float]]] = {name: {} for name in models}
    u, f = (np.stack([getattr(s, name) for s in samples]) for name in ("displacement", "force"))
    for degrees in angles:
        nodes = turned_nodes(samples[0].reference, u, f, degrees)
        for name, model in models.items():
            table[name][f"{degrees:g}"] = wp.evaluate(model, nodes)["E_u_samples"]
    return table


def summary(table: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """By angle: the mean error, and the mean of its ratio to the straight one with its error."""
    straight = np.array(table["0"])
    rows = {}
    for degrees, values in table.items():
        ratio = np.array(values) / straight
        spread = float(ratio.std(ddof=1) / np.sqrt(len(ratio)))
        rows[degrees] = {"E_u": float(np.mean(values)), "ratio": float(ratio.mean())}
        rows[degrees]["standard_error"] = spread
    return rows


def run(given: argparse.Namespace) -> dict[str, Any]:
    """Random loads, then the printed ones in several directions; what is printed and kept."""
    energy = wp.load(given.models / "energy.json")
    filtered = wp.load(given.models / "filtered.json")
    models: dict[str, Model | NonlinearModel] = {
        "linear": energy.linear,
        "energy": energy,
        "filtered": filtered,
    }
    numbers: dict[str, Any] = {}
    with locked(given.cache), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # beyond the proven strain: as asked
        random = disks(given.cache, [RandomRim(seed) for seed in range(given.loads)])
        table = errors(models, random, ANGLES)
        numbers["random"] = {name: summary(rows) for name, rows in table.items()}
        numbers["random_samples"] = table
        for load in TEST:
            directions = np.arange(DIRECTIONS) * PERIODS[load.case] / DIRECTIONS
            turned = disks(given.cache, [TurnedRim(load.case, float(by)) for by in directions])
            numbers[load.load_id] = errors(models, turned, PRINTED)
    return numbers


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True, defaults=True)
    parser.add("--models", type=Path, default=OUT, help="folder of the models")
    parser.add("--loads", type=int, default=24, help="random loads, at least 2")
    parser.add(
        "--cache", type=Path, default=DATA.with_name("turned_disks.cache"), help="finished disks"
    )
    given = parser.parse_args(arguments)
    if given.loads < 2:
        parser.error(f"--loads: expected a number ≥ 2, got {given.loads}")
    numbers = run(given)
    write_json(given.models / "turned_crystals.json", numbers)
    print(json.dumps(numbers) if given.json else "\n".join(lines(numbers)))
    return 0


def lines(numbers: Mapping[str, Any]) -> list[str]:
    """The tables as text."""
    text = ["random loads: mean E_u [%], turned over straight"]
    for name, rows in numbers["random"].items():
        for degrees, row in rows.items():
            text.append(
                f"{name:>9} {degrees:>3}° {100 * row['E_u']:8.3f}"
                f" {row['ratio']:7.3f} ± {row['standard_error']:.3f}"
            )
    text.append("printed loads, E_u [%]: smallest, mean and largest of their directions")
    for load in TEST:
        for name, table in numbers[load.load_id].items():
            for degrees, values in table.items():
                cells = (100 * value for value in (min(values), np.mean(values), max(values)))
                text.append(
                    f"{load.load_id} {name:>9} {degrees:>3}°" + "".join(f"{x:8.3f}" for x in cells)
                )
    return text


if __name__ == "__main__":
    sys.exit(exit_status(main))
