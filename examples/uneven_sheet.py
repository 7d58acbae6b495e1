"""Maps of an uneven sheet's moduli from four loads: boron nitride in graphene; and how moduli
follow the density of a sheet with vacancies, learned on one and used on another.

python examples/uneven_sheet.py           numbers, and a picture in runs/uneven_sheet
python examples/uneven_sheet.py --json    one object on stdout
python examples/uneven_sheet.py --all     sheets with vacancies too
"""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import warp_peri as wp
from examples.figures import field, headline, outer, panels, save_figure
from tools.graphene_phonons import force_constants
from tools.make_graphene import SMOOTHING_RADIUS
from tools.options import Options
from tools.uneven_sheets import Sheet, moduli, uneven_sheet
from warp_peri.dressed import DressedSolid, MapFit, fit_density, fit_maps, from_phonons
from warp_peri.errors import exit_status

LOADS_OF_DENSITY = 12
RADIUS, SIDE = 45.0, 197.25
"""Of the disc of boron nitride, and of the sheet [Å]."""
POTENTIAL = "BNC.tersoff"
MOST, MIDDLE, WIDTH = (0.04, 0.05), (0.15, -0.1), 0.14
"""Share of atoms missing at the middle of ramp and blob; where the blob is, over the box."""
INNER = 27.0
"""Radius within which the disc's moduli are read [Å]: no smoothing reaches its edge from there."""


def displacement_errors(body: Any, sheet: Sheet) -> dict[str, float]:
    """E_u [%] by set."""
    found = {}
    for name, samples in sheet.sets.items():
        u = wp.solve(body, wp.Dirichlet(samples.points, samples.b, samples.u)).u
        wrong, whole = (
            np.linalg.norm((v - v.mean(axis=1, keepdims=True)).reshape(len(v), -1), axis=1)
            for v in (u - samples.u, samples.u)
        )
        found[name] = float(100 * (wrong / whole).mean())
    return found


def parts_of(V: np.ndarray) -> dict[str, float]:
    """κ = λ + μ and μ of a Voigt matrix."""
    return {"bulk": float(V[0, 0] + V[0, 1]) / 2, "shear": float(V[2, 2])}


def graphene(potential: str, spacing: float) -> DressedSolid:
    """The even sheet, from its phonons alone."""
    return from_phonons(
        force_constants(potential), spacing, neighbours=8, symmetry="isotropic", split=False
    )


def vacancies(loads: int) -> dict[str, Any]:
    """E_u [%] on a sheet with a blob of vacancies that no fit saw: as if even, with the law of
    density learned on a ramp of vacancies, and with a map of its own."""
    ramp = uneven_sheet(vacant=lambda at: MOST[0] * (1 - np.abs(2 * at[:, 0])), train=loads)
    blob = uneven_sheet(
        vacant=lambda at: MOST[1] * np.exp(-((at - MIDDLE) ** 2).sum(axis=1) / (2 * WIDTH**2)),
        train=loads, seed=1,
    )  # fmt: skip
    points = blob.sets["train"].points
    law = graphene("SiC_1989.tersoff", points.spacing)
    found = fit_density(ramp.sets["train"], law, ramp.density)
    own = fit_maps(blob.sets["train"], law, parts="one", smoothing=SMOOTHING_RADIUS)
    even = dict.fromkeys(law.parts.names, np.ones(len(points.x)))
    maps = {"uniform": even, "density": found.maps(blob.density), "own map": own.maps}
    errors = {name: displacement_errors(law.on(points, maps=m), blob) for name, m in maps.items()}
    over = {key: errors["density"][key] / errors["own map"][key] for key in ("val", "patch")}
    return {
        "coefficients": found.coefficients["shear"].tolist(),
        "spread": found.spread["shear"].tolist(),
        "densities": {"learned": [found.least, found.most],
                      "used": [float(blob.density.min()), float(blob.density.max())]},
        "unseen": errors,
        "correlation of the maps": correlation(own.maps["shear"], maps["density"]["shear"]),
        "over its own map": over,
    }  # fmt: skip


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Pearson's, over the nodes."""
    return float(np.corrcoef(first, second)[0, 1])


def within(found: np.ndarray, true: np.ndarray, spread: np.ndarray) -> float:
    """Share of the nodes where a value is off by less than two standard deviations."""
    return float((np.abs(found - true) < 2 * spread).mean())


def picture(at: np.ndarray, found: MapFit, true: dict[str, np.ndarray], path: Path) -> None:
    """Truth, map and error of each modulus, over graphene's."""
    figure, axes = panels(10, 5.6, count=3, rows=2)
    for row, (part, name) in zip(axes, {"bulk": "bulk modulus", "shear": "shear modulus"}.items()):
        map_, off = found.maps[part], found.maps[part] - true[part]
        both = np.append(true[part], map_)
        for ax, value in zip(row, (true[part], map_)):
            field(ax, at, value, "over graphene's", (both.min(), both.max()))
        most = np.abs(off).max()
        field(row[2], at, off, "over graphene's", (-most, most), cmap="RdBu")
        alike = f"error; correlation {correlation(map_, true[part]):.2f}"
        for ax, title in zip(row, (f"{name}, true", f"{name}, learned", alike)):
            ax.set_title(title)
    outer(axes, "x [Å]", "y [Å]")
    headline(figure, "Loads alone show the disc: in shear, where it is softer, and hardly in bulk")
    save_figure(figure, path, dpi=110)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "uneven_sheet", json=True)
    parser.add("--loads", type=int, default=4, help="to learn from")
    parser.add("--all", action="store_true", help="sheets with vacancies too")
    given = parser.parse_args(arguments)
    sheet = uneven_sheet(lambda at: np.linalg.norm(at, axis=1) * SIDE < RADIUS, train=given.loads)
    points = sheet.sets["train"].points
    law = graphene(POTENTIAL, points.spacing)
    carbon, nitride = (parts_of(moduli(names)) for names in (("C",), ("B", "N")))
    even = dict.fromkeys(law.parts.names, np.ones(len(points.x)))
    numbers: dict[str, Any] = {"uniform": displacement_errors(law.on(points, maps=even), sheet)}
    middle = np.linalg.norm(points.x - points.x.mean(axis=0), axis=1) < INNER
    fits = {
        name: fit_maps(sheet.sets["train"], law, parts=name, smoothing=SMOOTHING_RADIUS)
        for name in ("each", "one")
    }
    for name, fit in fits.items():
        body = law.on(points, maps=fit.maps)
        numbers["maps" if name == "each" else "one factor"] = {
            **displacement_errors(body, sheet), "smoothness": fit.smoothness,
        }  # fmt: skip
    found = fits["each"]
    true = {part: 1 - sheet.inside * (1 - nitride[part] / carbon[part]) for part in even}
    numbers["maps"] |= {
        "resolution": found.resolution,
        "correlation": {p: correlation(found.maps[p], true[p]) for p in true},
        "off": {p: float(np.abs(found.maps[p] - true[p]).mean()) for p in true},
        "within two spreads": {p: within(found.maps[p], true[p], found.spread[p]) for p in true},
    }
    if given.all:
        numbers["density"] = vacancies(LOADS_OF_DENSITY)
    numbers["moduli"] = {
        part: {
            "found": float(found.maps[part][middle].mean()),
            "spread": float(found.spread[part][middle].mean()),
            "true": nitride[part] / carbon[part],
        }
        for part in law.parts.names
    }
    print(json.dumps(numbers, indent=None if given.json else 1))
    picture(points.x - points.x.mean(axis=0), found, true, given.out / "maps.png")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
