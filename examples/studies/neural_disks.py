"""What the printed force error of the network on disks of graphene would need: norms, and training.

Errors of Lu − b in several norms, of the shipped network and of linear solids from the same data;
and of the network when three of the four disks are among its training samples
(docs/archive/neural.md).
"""

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples.prose import table
from tools.options import Options
from warp_peri import Samples
from warp_peri.errors import exit_status
from warp_peri.neural import Training, evaluate, train

WEIGHTS = ROOT / "examples" / "neural_weights" / "graphene.json"
NORMS = ("ℓ2", "its square", "root mean square of a node", "mean of a node", "the same, inner half")


def norms(material: Any, disks: Samples) -> list[float]:
    """Of Lu − b in GPa/Å, means over the disks, in the order of NORMS."""
    operator, inside = material.on(disks.points), disks.interior
    load = operator.load(disks.loads) if hasattr(operator, "load") else disks.loads[:, inside]
    size = 1e3 * np.linalg.norm(np.asarray(operator(disks.u)) - load, axis=2)
    r = np.linalg.norm(disks.x[inside] - disks.x.mean(axis=0), axis=1)
    whole = np.linalg.norm(size, axis=1)
    inner = size[:, r < r.max() / 2].mean()
    return [whole.mean(), (whole**2).mean(), np.sqrt((size**2).mean()), size.mean(), inner]


def trained_on_disks(disks: Samples, waves: Samples) -> dict[str, float]:
    """ℓ2 in GPa/Å on three disks that are learned and on the fourth; E_res of waves in %."""
    network = wp.load(WEIGHTS)
    three, fourth = (Samples(disks.points, disks.u[n], disks.loads[n]) for n in (slice(1, 4), [0]))
    train(network, three, fourth, Training(epochs=120, batch=1, rate=5e-4), progress=False)
    errors = (1e3 * evaluate(network, one, solve=False)["E_res_abs"] for one in (three, fourth))
    residual = 100 * evaluate(network, waves, solve=False)["E_res"]
    return dict(zip(("three disks learned", "the fourth", "waves"), (*errors, residual)))


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__)
    parser.add("--data", type=Path, default=ROOT / "data" / "graphene_0K.h5")
    data, solid = wp.load(parser.parse_args(arguments).data), wp.LPS(20.0, wp.Bernstein(10))
    laws = {"neural operator": wp.load(WEIGHTS)}
    laws |= {f"solid from {name}": wp.fit(data[name], solid).material for name in ("train", "test")}
    rows = [[k, *(f"{v:.2e}" for v in norms(law, data["test"]))] for k, law in laws.items()]
    print(table(["", *NORMS], rows), trained_on_disks(data["test"], data["val"]), sep="\n\n")


if __name__ == "__main__":
    sys.exit(exit_status(main))
