"""A row on the data of the neural operator's authors, where you have them: their .mat files.

    python examples/studies/published_fields.py md_cg_*.mat
    python examples/studies/published_fields.py TVAL001_noave_byset.mat --load none \
        --displacement u --positions 0.275 --units mm MPa --frames 20

The first are coarse-grained molecular dynamics (github.com/fishmoon1234/PeridynamicNeuralOperator:
coords, disps and forces of 21 × 21 nodes 5 apart), of which the linear solid and tensors are
learned. The second are frames of a tissue (linked from github.com/fishmoon1234/IFNO-tissue: u of
21 × 21 nodes, components first), of which a sheet is chosen by displacement. Neither is shipped
here: their licences do not say that they may be.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

import warp_peri as wp
from examples.prose import table
from tools.options import Options
from warp_peri import InputError, Samples
from warp_peri.atoms import read_fields
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain

PARTS = {"train": 200, "val": 50, "test": 20}
"""Samples of each set, as the authors take them."""
PRINTED = {"E_res train": 0.0919, "E_res val": 0.0802, "E_res test": 0.0794}
"""Of their network on the low third of the wave numbers, from their repository."""


def joined(read: Sequence[Samples]) -> Samples:
    """Samples of several files. Raises InputError where their nodes differ."""
    first = read[0].points
    for samples in read[1:]:
        if difference := first.differs_from(samples.points):
            raise InputError(f"files: expected the same nodes in all, got {difference}")
    b = None if read[0].b is None else np.concatenate([samples.loads for samples in read])
    return Samples(first, np.concatenate([samples.u for samples in read]), b)


def split(samples: Samples, seed: int) -> dict[str, Samples]:
    """Sets of the sizes of PARTS, or of their shares where there are fewer samples."""
    share = min(1.0, len(samples) / sum(PARTS.values()))
    counts = [max(1, int(share * count)) for count in PARTS.values()]
    if len(samples) < sum(counts):
        raise InputError(f"files: expected at least {sum(counts)} samples, got {len(samples)}")
    order = np.random.default_rng(seed).permutation(len(samples))
    places = np.split(order, np.cumsum(counts))[:-1]
    return {
        name: Samples(samples.points, samples.u[some], samples.loads[some])
        for name, some in zip(PARTS, places)
    }


def of_loads(
    samples: Samples, reach: int, degree: int, symmetry: str, seed: int
) -> dict[str, dict[str, float]]:
    """E_res and E_u of the linear solid and of tensors on each set."""
    horizon, sets = (reach + 0.01) * samples.spacing, split(samples, seed)
    laws = {
        "linear solid": wp.LPS(horizon, wp.Bernstein(degree)),
        "tensors": wp.Micromodulus(horizon, symmetry),
    }
    rows: dict[str, dict[str, float]] = {"their network, printed": PRINTED}
    for name, law in laws.items():
        material = wp.fit(sets["train"], law).material
        for part, some in sets.items():
            try:
                errors = wp.evaluate(material, some)
            except InputError:  # nothing is proven of its solves
                errors = {}
            row = rows.setdefault(name, {})
            row |= {f"{key} {part}": errors.get(key, np.nan) for key in ("E_res", "E_u")}
    return rows


def of_frames(samples: Samples, count: int) -> dict[str, dict[str, float]]:
    """E_u of sheets by displacement, learned from every second of so many frames, on the others."""
    chosen = np.unique(np.linspace(len(samples) // 4, len(samples) - 1, count).astype(int))
    choice = wp.tissue.choose_sheet(Samples(samples.points, samples.u[chosen]), uneven=False)
    return {each.name: {"E_u test": each.held_out} for each in choice.candidates}


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, json=True)
    parser.add("files", nargs="+", type=Path)
    parser.add("--displacement", default="disps", metavar="NAME")
    parser.add("--load", default="forces", metavar="NAME", help="none where there are no loads")
    parser.add("--positions", default="coords", metavar="NAME", help="or the spacing of a square")
    parser.add("--factor", type=float, default=1.0, help="of the loads, −1 where they are inner")
    parser.add("--units", nargs="+", default=["reduced"], help="of lengths and stresses")
    parser.add("--reach", type=int, default=3, help="horizon in spacings")
    parser.add("--degree", type=int, default=4)
    parser.add("--symmetry", default="auto", help="of the tensors")
    parser.add("--frames", type=int, default=20, help="of those without loads")
    parser.add("--seed", type=int, default=100)
    given = parser.parse_args(arguments)
    try:
        positions: str | float = float(given.positions)
    except ValueError:
        positions = given.positions
    samples = joined([
        read_fields(
            path, displacement=given.displacement, positions=positions, factor=given.factor,
            load=None if given.load == "none" else given.load, reach=given.reach,
            units=given.units[0] if len(given.units) == 1 else tuple(given.units),
        )
        for path in given.files
    ])  # fmt: skip
    if samples.b is None:
        rows = of_frames(samples, given.frames)
    else:
        rows = of_loads(samples, given.reach, given.degree, given.symmetry, given.seed)
    heads = list(rows[list(rows)[-1]])
    cells = [
        [name, *(f"{100 * row[k]:.2f}" if k in row else "–" for k in heads)]
        for name, row in rows.items()
    ]
    numbers: Any = {"nodes inside": int(samples.interior.sum()), "samples": len(samples)}
    print(json.dumps(plain(numbers | rows)) if given.json else table(["%", *heads], cells))


if __name__ == "__main__":
    sys.exit(exit_status(main))
