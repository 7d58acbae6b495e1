"""A material, not a lattice: one model of graphene on other grids.

The model of the main job, learned on nodes 5 Å apart, is used where it never saw data: on lattices
from 2.5 to 10 Å, turned ones, with fewer bonds at home. Displacement errors are against molecular
statics, smoothed at those nodes.
"""

import functools
import json
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import matplotlib

matplotlib.use("Agg")
import numpy as np

import warp_peri as wp
from examples import prose
from examples.figures import panels, save_figure, ticks
from tools.graphene import THICKNESS
from tools.make_graphene import INTERIOR, REACH, SMOOTHING_RADIUS, read_samples
from tools.options import Options
from warp_peri import Bernstein, Model, Points, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked, write_json, write_text
from warp_peri.transfer import cache as kept
from warp_peri.transfer.lattice import new_lattice
from warp_peri.transfers import on_lattice

LATTICES = ((5.0, 15.0), (4.0, None), (2.5, None), (7.5, 22.5), (10.0, 25.0))
"""Spacing and horizon [Å]; None for the fewest bonds that meet the tolerance."""
TURNS = (15.0, 30.0, 45.0)
"""Of a lattice of 4 Å [degrees]."""
REDUCED = ((5.0, 15.0), (5.0, 20.0), (2.5, 7.5))
SETS = {"disks": "test", "smooth": "val", "short": "train"}


class SmoothedAtoms:
    """The molecular samples, smoothed at any nodes."""

    def __init__(self, cache: Path) -> None:
        self.read = functools.cache(lambda name: read_samples(cache, name))

    def at(self, x: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
        """u [Å] and b [TPa/Å] at nodes, each of shape [S, N, 2]."""
        body, _, samples = self.read(name)
        omega = wp.atoms.smoothing_matrix(
            samples[0].reference, x, radius=SMOOTHING_RADIUS, box=body.box, density=True
        )
        return wp.atoms.coarse_grain(
            omega,
            displacement=np.stack([sample.displacement for sample in samples]),
            force=np.stack([sample.force for sample in samples]),
            node_area=1.0,
            thickness=THICKNESS,
        )

    def on(self, points: Points, name: str) -> Samples:
        """The samples of a set on points; of a disk, those that its atoms cover."""
        if self.read(name)[0].box is None:
            size: np.ndarray = np.linalg.norm(points.x, axis=1)
            kept = size <= REACH
            points = Points(points.x[kept], size[kept] < INTERIOR, points.spacing)
        return Samples(points, *self.at(points.x, name))


def lattice(spacing: float, degrees: float = 0.0) -> Points:
    """Nodes to 100 Å, 2δ of collar around the interior of 50 Å."""
    count = int(1.5 * REACH / spacing)
    line = spacing * np.arange(-count, count + 1)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    angle = np.deg2rad(degrees)
    x = x @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    size: np.ndarray = np.abs(x).max(axis=1)
    kept = size <= REACH * (1 + 1e-9)
    return Points(x[kept], size[kept] <= INTERIOR * (1 + 1e-9), spacing)


def errors(model: Model, atoms: SmoothedAtoms, points: Points) -> dict[str, float]:
    """E_u in % of the sets."""
    return {
        key: 100 * wp.evaluate(model, atoms.on(points, name))["E_u"] for key, name in SETS.items()
    }


def transferred(
    model: Model, atoms: SmoothedAtoms, spacing: float, horizon: float | None
) -> dict[str, Any]:
    """Errors on one lattice, how long the transfer took, and the second time."""
    seconds = []
    for make in (new_lattice, on_lattice, on_lattice):
        kept.forget()  # as another process would ask for it
        begin = time.perf_counter()
        there = make(model, spacing=spacing, horizon=horizon)
        seconds.append(time.perf_counter() - begin)
    record = there.provenance["transfer"]
    return {
        "spacing": spacing,
        "horizon": there.horizon,
        "bonds": record["bonds"],
        "c": record["symbol_bound"],
        "agreement": record["statement"],
        "seconds": seconds[0],
        "seconds_again": seconds[2],
        **errors(there, atoms, lattice(spacing)),
    }


def measure(
    model: Model, data: wp.Dataset, cache: Path, part: Callable[..., Any]
) -> dict[str, Any]:
    """All tables; `part` keeps each as it is finished."""
    atoms = SmoothedAtoms(cache)
    nodes = lattice(5.0)
    rich = functools.cache(lambda: wp.fit(data["train"], wp.LPS(25.0, Bernstein(15))).material)
    return {
        "home": part("home", lambda: {"horizon": model.horizon, **errors(model, atoms, nodes)}),
        "lattices": [
            part(f"lattice_{h:g}_{d or 0:g}", transferred, model, atoms, h, d) for h, d in LATTICES
        ],
        "turned_4": [
            {"degrees": angle}
            | part(f"turned_{angle:g}", errors, model, atoms, lattice(4.0, angle))
            for angle in (0.0, *TURNS)
        ],
        "rich_teacher": part(
            "rich_teacher", lambda: {"horizon": 25.0, **errors(rich(), atoms, nodes)}
        ),
        "reduced": [
            part(f"reduced_{h:g}_{d:g}", lambda h=h, d=d: transferred(rich(), atoms, h, d))
            for h, d in REDUCED
        ],
    }


def kept_part(folder: Path, name: str, make: Callable[..., Any], *given: Any) -> Any:
    """What a part of the measurement found, from its file when it was finished before."""
    file = folder / f"{name.replace(' ', '_')}.json"
    if not file.exists():
        write_json(file, make(*given))
    return json.loads(file.read_text(encoding="utf-8"))


def table(rows: list[dict[str, Any]]) -> str:
    """Rows as Markdown."""
    columns = [key for key in rows[0] if key != "agreement"]
    cells = ([row[key] for key in columns] for row in rows)
    return prose.table(
        columns, ([f"{c:.3g}" if isinstance(c, float) else str(c) for c in row] for row in cells)
    )


def report(tables: dict[str, Any]) -> str:
    """The tables, E_u in %."""
    lines = ["# One model, learned at 5 Å, elsewhere", "", "Displacement errors in %.", ""]
    for name in ("home", "rich_teacher"):
        lines += [f"**{name}**", "", table([tables[name]]), ""]
    for name in ("lattices", "turned_4", "reduced"):
        lines += [f"**{name}**", "", table(tables[name]), ""]
    lines += [f"- {row['agreement']}" for row in tables["lattices"]]
    return "\n".join([*lines, ""])


def figure(model: Model, file: Path) -> None:
    """Error against home by wavelength."""
    drawn, ax = panels(7, 4.5)
    for spacing, horizon in LATTICES:
        there = on_lattice(model, spacing=spacing, horizon=horizon)
        record = there.provenance["transfer"]
        label = f"{spacing:g} Å, δ = {there.horizon:.3g} Å, {record['bonds']} bonds"
        ax.loglog(record["wavelength"], 100 * np.array(record["error"]), label=label)
    ax.set(xlabel="wavelength [Å]", ylabel="displacement against home [%]", ylim=(0.05, 100))
    ticks(ax, (20, 30, 50, 100, 200, 400, 800))
    ax.set_title("A kernel of its own on each lattice, from one learned at 5 Å")
    ax.legend(fontsize=8)
    save_figure(drawn, file, dpi=130, bbox_inches=None)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "any_lattice", json=True)
    parser.add("--model", type=Path, default=ROOT / "runs" / "graphene_0K" / "model.json")
    parser.add("--data", type=Path, default=ROOT / "data" / "graphene_0K.h5")
    given = parser.parse_args(arguments)
    model, data = wp.load(given.model), wp.load(given.data)
    with locked(given.out), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # each transfer would say so
        part = functools.partial(kept_part, given.out / "parts")
        tables = measure(model, data, given.data.with_suffix(".cache"), part)
        write_json(given.out / "any_lattice.json", tables)
        write_text(given.out / "report.md", report(tables))
        figure(model, given.out / "any_lattice.png")
    print(json.dumps(tables) if given.json else report(tables))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
