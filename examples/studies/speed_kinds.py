"""Error against total time of tissue, flow and cracks, each beside its rivals.

    python examples/studies/speed_kinds.py tissue|flow|cracks [--out runs/speed_kinds] [--again]

Total time is what an answer costs that nobody has prepared: learning or setting up, and solving.
The data and laws are those of examples/hgo_square.py, polymer/channel.py and cracked_graphene.py;
all rows of a chart are of one run, on the machine that its file names. Tissue needs the data of
hgo_square.py, which are made where they are not there; cracks need LAMMPS.
"""

import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

from examples import cracked_graphene, hgo_square
from examples.polymer import FENEP, ChannelFlow, Dumbbells, UpperConvectedMaxwell, channel, learn
from examples.polymer.particles import Particles
from examples.studies.speed_accuracy import machine
from examples.studies.speed_chart import error_chart
from tools.cracked_sheet import critical_strain, ideal_strength
from tools.graphene import bond_length
from tools.make_hgo import make_hgo
from tools.options import Options
from tools.row_separation import whole
from warp_peri import Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json
from warp_peri.tissue import hyperelastic_errors

Row = dict[str, Any]
DISKS = 10
"""Disks that are solved for."""
FIT, UNSEEN = "16 bonds", ("10 bonds", "two of 8 bonds")
"""Crack that all ways are fitted on, and those they predict, in a sheet of 100 Å."""


def row(label: str, kind: str, seconds: float, error: float) -> Row:
    """One point, printed as it comes."""
    print(f"{label:44} {100 * error:8.3f} %  {seconds:8.2f} s", flush=True)
    return {"label": label, "kind": kind, "seconds": seconds, "error": error}


def tissue() -> Iterator[Row]:
    """An HGO sheet learned from 200 squares, on ten disks; errors of displacement."""
    sets = make_hgo(
        ROOT / "data" / "hgo",
        material=hgo_square.Material(),
        element="linear",
        counts=(200, 1, 1, DISKS),
        seed=1000,
        jobs=1,
        progress=False,
    )
    disks = sets["disks"]
    some = Samples(disks.points, disks.u[:DISKS], disks.loads[:DISKS])
    for name, (solid, learned) in hgo_square.learn(sets["train"], hgo_square.STIFFNESS).items():
        began = time.process_time()
        errors = hyperelastic_errors(solid, some)["displacements"]
        seconds = learned + time.process_time() - began
        kind = "rivals" if "rival" in name else "dictionaries"
        yield row(name.removeprefix("rival: "), kind, seconds, float(np.nanmean(errors)))


def flow() -> Iterator[Row]:
    """Start-up of a channel of Hookean dumbbells; errors of velocity against the exact law."""
    problem = ChannelFlow(channel.DE)
    n = Particles(problem).fluid
    exact, _ = channel.channel(UpperConvectedMaxwell(), problem)

    def learned(count: int) -> Any:
        return learn.hookean_law(count, 0).tabulated()

    def run(label: str, kind: str, fluid: Callable[..., Any], *given: Any) -> Row:
        began = time.process_time()
        record, _ = channel.channel(fluid(*given), problem)
        seconds = time.process_time() - began
        return row(label, kind, seconds, learn.relative(record.v, exact.v) / 100)

    for count in (100, 1000, 10_000):
        yield run(f"learned from 22 × {count} dumbbells", "learned", learned, count)
    alongside = partial(Dumbbells, seed=0, common=True)
    for count in (10, 100, 1000):
        yield run(f"{count} dumbbells under every point", "alongside", alongside, n, count)
    yield run("FENE-P, b = 50", "another fluid", FENEP, learn.B)


def cracks() -> Iterator[Row]:
    """Critical strains of two unseen cracks, each way fitted on one; the atoms are the truth."""
    step, half = float(np.sqrt(3) * bond_length()), cracked_graphene.LATER_HALF
    lines = {
        name: [np.array([(a * step, 0.0), (b * step, 0.0)]) for a, b in ends]
        for name, ends in cracked_graphene.LATER.items()
    }
    strain, slowest = {}, 0.0
    for name, ends in lines.items():
        found = critical_strain(ends, 0.03, half=half * step)
        strain[name], slowest = found["strain"], max(slowest, found["seconds"])
    yield row("atoms, pulled to the fold (each crack)", "atoms", slowest, 0.0)

    def off(predicted: dict[str, float]) -> float:
        wrong = [predicted[name] / strain[name] - 1 for name in UNSEEN]
        return float(np.sqrt(np.mean(np.square(wrong))))

    long = {name: sum(b - a for a, b in ends) for name, ends in cracked_graphene.LATER.items()}
    alone = {name: strain[FIT] * np.sqrt(long[FIT] / long[name]) for name in UNSEEN}
    yield row("1/√length, by hand", "rivals", 1e-3, off(alone))
    for linear in (True, False):
        began = time.process_time()
        known = whole(linear=linear)
        factor = known.factor(known.held(lines[FIT], half * step), strain[FIT])
        law = known.law.times(factor)
        predicted = {
            name: known.held(lines[name], half * step).critical_strain(law) for name in UNSEEN
        }
        label = "rows of bonds, " + ("linear sheet" if linear else "third order")
        yield row(label, "rows of bonds", time.process_time() - began, off(predicted))
    began = time.process_time()
    solid = cracked_graphene.Continuum(known.lam, known.mu, step, half)
    release = solid.release(max(b for ((_, b), *_) in cracked_graphene.LATER.values()))
    label, strength = "one G_c, bonds cut", np.inf
    for _ in (0, 1):
        given = known.E, strength, step, cracked_graphene.LATER[FIT][0][1]
        toughness, zone = cracked_graphene.fitted(release, strain[FIT], *given)
        predicted = {
            name: cracked_graphene.critical(
                solid, release, toughness, zone, cracked_graphene.LATER[name]
            )
            for name in UNSEEN
        }
        yield row(label, "bonds cut", time.process_time() - began, off(predicted))
        label, strength = "one G_c and Irwin's zone, bonds cut", ideal_strength()[0]


CHARTS: dict[str, tuple[Callable[[], Iterator[Row]], str]] = {
    "tissue": (tissue, "displacement error on unseen disks [%]"),
    "flow": (flow, "velocity error against the exact model [%]"),
    "cracks": (cracks, "critical strain of unseen cracks, error [%]"),
}


def main() -> None:
    parser = Options(__doc__, "speed_kinds")
    parser.add("what", choices=CHARTS)
    parser.add("--again", action="store_true", help="draw what is there once more")
    given = parser.parse_args()
    table = given.out / f"{given.what}.json"
    measured, error = CHARTS[given.what]
    if not given.again:
        with warnings.catch_warnings(action="ignore"):
            write_json(table, {"rows": list(measured()), "machine": machine()})
    content = json.loads(table.read_text(encoding="utf-8"))
    error_chart(content["rows"], given.out / f"{given.what}_speed.png", error)
    print(json.dumps(content["machine"]))


if __name__ == "__main__":
    sys.exit(exit_status(main))
