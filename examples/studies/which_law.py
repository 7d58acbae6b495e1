"""Laws of a sheet side by side: numbers, errors, what is proven, a turn, the time of a force.

python examples/studies/which_law.py           a table, and a picture in runs/which_law
python examples/studies/which_law.py --json    one object on stdout
"""

import argparse
import json
import sys
import warnings
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples.figures import headline, name_lines, panels
from examples.train_graphene import DATA, SMOOTHING_RADIUS, make_data
from tools.benchmark_crystals import least
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.methods import Smoothing

STRAINED = DATA.with_name("graphene_0K_strained.h5")
SETS = ("train", "val", "test", "val_4", "test_4", "val_6", "test_6")
SHEET = 200
"""Nodes a side of the periodic sheet that a force is timed on."""
TURN = np.deg2rad(10)
ENERGY = Smoothing(SMOOTHING_RADIUS, 0.2)


def laws(truth: dict[str, float]) -> dict[str, Any]:
    """What is learned, by name; all with the moduli of the atoms held, but the first."""
    lam, mu = truth["lambda"], truth["mu"]
    C = [[lam + 2 * mu, lam, 0.0], [lam, lam + 2 * mu, 0.0], [0.0, 0.0, mu]]
    bonds_28 = wp.Micromodulus(15.0, moduli=C)
    return {
        "LPS": wp.LPS(20.0, wp.Bernstein(10), wp.methods.Optimum(moduli=None)),
        "crystal model, 20 bonds": wp.Micromodulus(12.5, "isotropic", moduli=C),
        "third order, with energy": wp.ThirdOrder(bonds_28, ENERGY, "energy"),
        "third order, deconvolved": wp.ThirdOrder(bonds_28, Smoothing(SMOOTHING_RADIUS)),
    }


def add_files(parser: Options, out: Path) -> None:
    """Options of what is read and written where the sheet is strained."""
    parser.add("--data", type=Path, help="the main job's data (made if not there)")
    parser.add("--strained", type=Path, help="data at larger strain (made if not there)")
    parser.add("--out", type=Path, default=out, help="folder for the results")


def strained_file(given: argparse.Namespace) -> Path:
    """The data at larger strain, made if it is not there."""
    path = Path(given.strained or STRAINED)
    if not path.exists():
        from tools.make_strained import make_strained

        print("making data at larger strain with LAMMPS (once)", file=sys.stderr)
        make_strained(path)
    return path


def errors(material: Any, data: wp.Dataset, larger: wp.Dataset) -> dict[str, float]:
    """E_u of every set there is, by name."""
    found = {}
    for name in SETS:
        source = data if name in data.sets else larger
        if name not in source.sets:
            continue
        try:
            found[name] = wp.evaluate(material, source[name])["E_u"]
        except wp.InputError as error:  # a load that the model does not bear
            print(f"{name}: {error}", file=sys.stderr)
    return found


def turned(material: Any, samples: wp.Samples) -> float:
    """E_res of fields and loads turned by 10° with the body, over that of straight ones."""
    op, (x, u, b) = material.on(samples.points), (samples.x, samples.u, samples.loads)
    R = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])

    def left(u: np.ndarray, b: np.ndarray) -> float:
        load = op.load(b)
        sizes = (np.linalg.norm(v.reshape(len(u), -1), axis=1) for v in (op(u) - load, load))
        return float(np.divide(*sizes).mean())

    return left((x + u) @ R.T - x, b @ R.T) / left(u, b)


def nanoseconds(material: Any, rounds: int = 9) -> float:
    """Of a force a node on one thread, from a field of nodes to a field of nodes."""
    points = wp.Points.sheet((SHEET, SHEET), 5.0)
    op = material.on(wp.Points(points.x, points.interior, 5.0, box=points.box, axis=0.0))
    u = 1e-3 * np.random.default_rng(0).normal(size=points.x.shape)
    return 1e9 * least(lambda: op(u), rounds) / len(points.x)


def proven(material: Any) -> str:
    """In few words."""
    if hasattr(material, "proven_strain"):
        return f"one answer to |H| = {100 * material.proven_strain(5.0):.1f} %"
    proof = material.certificate
    if hasattr(proof, "proven"):
        return f"one answer, D ≥ {proof.proven:.2f} s"
    return "one answer, D ≥ 0.01 s"


def picture(table: dict[str, Any], path: Path) -> None:
    """Errors over strain; the other linear models are as the LPS to the eye."""
    shown = "LPS", "third order, with energy", "third order, deconvolved"
    figure, axes = panels(9.5, 4, count=2, sharey=True)
    for ax, (role, title) in zip(axes, (("val", "loads, periodic sheet"), ("test", "disks"))):
        for name in shown:
            values = [table[name]["E_u"][key] for key in (role, f"{role}_4", f"{role}_6")]
            ax.plot([2, 4, 6], values, "o-", label=name)
        ax.set(xlabel="largest bond strain [%]", title=f"unseen {title}", yscale="log")
    axes[0].set_ylabel("error of displacement [%]")
    name_lines(axes[1])
    headline(figure, "Third-order models err least at every strain")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, json=True)
    add_files(parser, ROOT / "runs" / "which_law")
    given = parser.parse_args(arguments)
    wp.launch.set_threads(1)
    data = wp.load(given.data or make_data(-1, SMOOTHING_RADIUS))
    larger = wp.load(strained_file(given))
    table: dict[str, Any] = {}
    for name, law in laws(larger.provenance["truth"]).items():
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            material = wp.fit(data["train"], law).material
            found = errors(material, data, larger)
            table[name] = {
                "E_u": {key: 100 * value for key, value in found.items()},
                "proven": proven(material),
                "turned": turned(material, data["val"]),
                "nanoseconds": nanoseconds(material),
            }
    if given.json:
        print(json.dumps(table))
    else:
        for name, row in table.items():
            cells = "".join(f"{value:7.2f}" for value in row["E_u"].values())
            print(f"{name:30}{cells}{row['turned']:9.2f}{row['nanoseconds']:7.0f}  "
                  f"{row['proven']}")  # fmt: skip
    picture(table, given.out / "which_law.png")


if __name__ == "__main__":
    sys.exit(exit_status(main))
