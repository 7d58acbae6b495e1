"""Copper of twins, and of several grains, against atoms: a law for each grain, and a map.

python examples/grains.py           numbers, and a picture in runs/grains
python examples/grains.py --json    one object on stdout
"""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import warp_peri as wp
from examples.figures import field, headline, panels, save_figure
from tools.grains import Columns, columns, plane_constants
from tools.options import Options
from warp_peri.dressed import DressedSolid, fit_maps, from_phonons
from warp_peri.errors import exit_status
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.structures.phonons import CONE, relative

TILT = float(np.degrees(np.arctan2(1, 2**0.5)))
"""Of either grain of the pair: twins."""
NOTHING = 1e-4
"""Of the period."""
SEVERAL, SEED = 5, 4
LEAST = 0.02
"""Of a map: no node is left without stiffness."""
TRAIN, LOADS = 4, 12
"""Loads that maps are learned from, and loads of each kind."""

Sets = dict[str, wp.Samples]


def pair(at: np.ndarray) -> np.ndarray:
    """Half a period wide each; the layers that both share are the second's."""
    return (np.abs(at[:, 1]) < 0.25 + NOTHING).astype(int)


def nearest(at: np.ndarray) -> np.ndarray:
    """Of SEVERAL middles at random the nearest, over the period."""
    arm = at[:, None] - np.random.default_rng(SEED).uniform(-0.5, 0.5, (SEVERAL, 2))
    return np.asarray(((arm - np.rint(arm)) ** 2).sum(axis=2).argmin(axis=1))


def split_up(found: Columns) -> Sets:
    """Loads to learn from, unseen waves, and local loads."""
    w = found.sets["waves"]
    cuts = {"train": slice(TRAIN), "val": slice(TRAIN, None)}
    waves = {n: wp.Samples(w.points, w.u[cut], w.loads[cut]) for n, cut in cuts.items()}
    return waves | {"patch": found.sets["patch"]}


def displacement_errors(body: Any, sets: Sets) -> dict[str, float]:
    """E_u [%] by set."""
    found = {}
    for name, samples in sets.items():
        u = wp.solve(body, wp.Dirichlet(samples.points, samples.b, 0 * samples.u)).u
        u = u - u.mean(axis=1, keepdims=True)
        found[name] = relative(u, samples.u, np.ones(u.shape[1], bool))
    return found


def laws_of(
    atoms: ForceConstants, spacing: float, degrees: tuple[float, ...], **options: Any
) -> list[DressedSolid]:
    """One crystal on nodes that lie at these angles to it."""
    return [
        from_phonons(atoms, spacing, neighbours=8, symmetry="2mm", orientation=angle, **options)
        for angle in degrees
    ]


def study(found: Columns, degrees: tuple[float, ...], atoms: ForceConstants) -> dict[str, Any]:
    """E_u [%] of one law for all, of plain elements and of dressed ones in each grain, and of the
    latter with maps of what boundaries soften, learned from TRAIN loads."""
    sets = split_up(found)
    points = sets["val"].points
    laws = laws_of(atoms, points.spacing, degrees)
    plain = [dataclasses.replace(law, tensors=0 * law.tensors) for law in laws]
    even = dict.fromkeys(laws[0].parts.names, np.ones(len(points.x)))
    grains = (laws, found.grain)
    told = fit_maps(
        sets["train"], laws[0], grains=grains, parts="one", smoothing=CONE * points.spacing
    )
    maps = {name: np.maximum(values, LEAST) for name, values in told.maps.items()}
    bodies = {
        "one law": laws[0].on(points, maps=even),
        "elements": plain[0].on(points, grains=(plain, found.grain)),
        "dressed": laws[0].on(points, grains=grains),
        "dressed, a map": laws[0].on(points, grains=grains, maps=maps),
    }
    return {
        "atoms": len(found.atoms),
        "stress": found.stress.tolist(),
        "E_u": {name: displacement_errors(body, sets) for name, body in bodies.items()},
        "map": told.maps[laws[0].parts.names[0]],
        "resolution": told.resolution,
        "answer": wp.solve(
            bodies["dressed, a map"], wp.Dirichlet(points, sets["val"].b, 0 * sets["val"].u)
        ).u[0],
    }


def picture(tables: dict[str, Any], data: dict[str, Columns], path: Path) -> None:
    """Grains, the map, and one unseen load's answer and error."""
    figure, axes = panels(12, 5.6, count=4, rows=len(tables))
    for row, (name, table) in zip(axes, tables.items()):
        samples = split_up(data[name])["val"]
        answer = table["answer"] - table["answer"].mean(axis=0)
        true = samples.u[0]
        x, grain = samples.points.x, data[name].grain
        for one in np.unique(grain):
            row[0].scatter(*x[grain == one].T, s=9, marker="s", linewidths=0)
        row[0].set(aspect="equal", title=f"grains ({name}), a colour each", ylabel="y [Å]")
        shown = {
            "learned stiffness": (table["map"], "over the crystal's own"),
            "displacement, atoms": (np.linalg.norm(true, axis=1), "[Å]"),
            "error of the model": (np.linalg.norm(answer - true, axis=1), "[Å]"),
        }
        for ax, (title, (values, unit)) in zip(row[1:], shown.items()):
            field(ax, x, values, unit)
            ax.set_title(title)
    for ax in axes[-1]:
        ax.set_xlabel("x [Å]")
    headline(figure, "Learned from loads alone, the map of stiffness shows where grains meet")
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path, dpi=90)


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, "grains", json=True)
    parser.add("--half", action="store_true", help="periods half as wide, for a look")
    given = parser.parse_args(arguments)
    atoms = plane_constants()
    turns = np.random.default_rng(SEED + 1).uniform(0, 180, SEVERAL)
    cases = {"twins": (pair, (TILT, -TILT)), "several": (nearest, tuple(turns.tolist()))}
    data, tables = {}, {}
    for name, (number, degrees) in cases.items():
        data[name] = columns(number, degrees, loads=LOADS, half=given.half)
        tables[name] = study(data[name], degrees, atoms)
    picture(tables, data, given.out / "grains.png")
    hidden = ("map", "answer")
    numbers = {n: {k: v for k, v in t.items() if k not in hidden} for n, t in tables.items()}
    print(json.dumps(numbers, indent=None if given.json else 1))


if __name__ == "__main__":
    sys.exit(exit_status(main))
