"""How E_res on validation depends on where the atoms sit relative to the nodes.

Evaluates one model on the validation samples with the node lattice shifted by fractions of the
four-atom cell; the loads stay with the atoms.
"""

import math
import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from tools.make_graphene import point_set, read_samples
from tools.options import Options
from warp_peri import evaluate, load
from warp_peri.errors import exit_status

FRACTIONS = np.arange(8) / 8


def main(arguments: list[str] | None = None) -> int:
    """Command line; prints a table of E_res [%]."""
    root = Path(__file__).resolve().parent.parent
    parser = Options(__doc__)
    parser.add("--model", type=Path, default=root / "runs/graphene_0K/model.json")
    parser.add("--cache", type=Path, default=root / "data/graphene_0K.cache")
    given = parser.parse_args(arguments)
    body, loads, samples = read_samples(given.cache, "val")
    model = load(given.model)
    spacing = model.trained_on[0]
    rows = [0.0, 0.25, 0.5, 0.75]
    print(f"E_res validation [%], nodes {spacing:g} Å; shift along x (across), y (down), in cells")
    print("       " + "".join(f"{x:8.3f}" for x in FRACTIONS))
    for y in rows:
        errors = []
        for x in FRACTIONS:
            shift = (x * math.sqrt(3) * body.bond, y * 3 * body.bond)
            points = point_set(body, loads, samples, spacing=spacing, shift=shift)
            errors.append(100 * evaluate(model, points)["E_res"])
        print(f"{y:7.3f}" + "".join(f"{error:8.2f}" for error in errors))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
