"""An anisotropic hyperelastic sheet learned from fields on a square, and tried on disks.

Finite-element fields of a Holzapfel–Gasser–Ogden sheet are learned three ways: with coefficients of
any sign, with signs that guarantee stability at rest, and as a material in few numbers. The rivals
see the same samples: bonds alone, a sheet without fibres, and the true constants in elements on the
same nodes.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples.figures import field, headline, panels
from tools.make_hgo import ELEMENTS, Material, make_hgo
from tools.options import Options
from warp_peri import Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json
from warp_peri.materials.hyperelastic.energies import QUADRATICS
from warp_peri.materials.hyperelastic.equilibrium import StaticProblem
from warp_peri.tissue import (
    Dictionary,
    HyperelasticSolid,
    Term,
    hyperelastic_errors,
    in_words,
    material_terms,
    read_material,
    rose,
    save_febio,
    shortest_margin,
    with_corners,
    with_directions,
    with_families,
)

NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))
STIFFNESS = 0.35
"""Least coefficient of the deviations where a material is read [stress of the data]."""
STABLE = 0.2
"""Part of its least stiffness at rest, against any wave, that a sheet keeps in all strains of the
data, (H21)."""
RIVAL = 0.2
"""Least coefficient of the deviations of the rival without fibres."""
QUADRATIC = tuple(Term(f"quadratic {pair}") for pair in QUADRATICS)
AREA = (Term("log_area"), Term("area"), Term("inverse_area"))
MATRIX = (Term("neo_hookean"), Term("volumetric"))
CORNERS = tuple(replace(term, corner=True) for term in MATRIX)
"""Energies of the corners of cells, which see the shortest waves."""

FREE = Dictionary(
    3.0, ("square", "cube", "tension", "log"), NEAREST, (*QUADRATIC, *AREA, *rose(8), *CORNERS)
)
SAFE = Dictionary(3.0, ("log",), NEAREST, (*MATRIX, *rose(16), *CORNERS))
BONDS = Dictionary(3.0, ("square", "cube", "tension", "tension_cube", "log", "compression"))
ISOTROPIC = Dictionary(3.0, ("square", "cube"), NEAREST, (*QUADRATIC[:1], *AREA, *MATRIX))


def learn(samples: Samples, stiffness: float) -> dict[str, tuple[HyperelasticSolid, float]]:
    """The three models and two rivals, with the seconds of the processor each took.

    The material is read first: its families of fibres join the dictionaries.
    """
    began = time.process_time()
    read = read_material(samples, stiffness=stiffness)
    stable = STABLE * float(shortest_margin(read, np.eye(2)[None])[0])
    reading = time.process_time() - began
    free, safe = (
        with_families(with_directions(dictionary, read), read) for dictionary in (FREE, SAFE)
    )
    ways = {
        "free signs": lambda: wp.fit(samples, free, stable=stable).material,
        "guaranteed": lambda: wp.fit(samples, safe, positive=True, stable=stable).material.sparse,
        "read out": lambda: (
            (
                wp.fit(samples, with_corners(read.dictionary), positive=True, stable=stable)
            ).material.sparse
        ),
        "rival: bonds only": lambda: wp.fit(samples, BONDS).material,
        "rival: no fibres": lambda: wp.fit(samples, ISOTROPIC, stiffness=RIVAL).material,
    }
    models = {}
    for name, way in ways.items():
        began = time.process_time()
        solid = way()
        models[name] = solid, time.process_time() - began + (0 if "rival" in name else reading)
    return models


def table(
    solid: HyperelasticSolid, sets: dict[str, Samples], solved: int
) -> dict[str, dict[str, Any]]:
    """Errors on every set; E_u of the training set on its first samples only."""
    errors_of = {}
    for name, samples in sets.items():
        few = Samples(samples.points, samples.u[:solved], samples.loads[:solved])
        errors = hyperelastic_errors(solid, samples, solve=False)
        errors |= {k: v for k, v in hyperelastic_errors(solid, few).items() if k != "E_res"}
        numbers = {k: v for k, v in errors.items() if np.ndim(v) == 0}
        errors_of[name] = {k: None if np.isnan(v) else v for k, v in numbers.items()}
        errors_of[name]["E_u_max"] = float(np.nanmax([*errors["displacements"], 0.0]))
    return errors_of


def picture(solid: HyperelasticSolid, disks: Samples, path: Path) -> None:
    """Measured, predicted and difference of the displacement on the first disk."""
    u = wp.solve(solid, wp.Dirichlet(disks, disks.loads[0], disks.u[0])).u
    truth, inner = disks.u[0], disks.interior
    figure, axes = panels(11, 3.4, count=3)
    shown, label = (truth, u, u - truth), "displacement over the side of a square"
    for ax, title, part in zip(axes, ("finite elements", "model", "difference"), shown):
        field(ax, (disks.x + truth)[inner], np.hypot(*part[inner].T), label)
        ax.plot(*(disks.x + truth)[~inner].T, ".", color="0.7", markersize=2)
        ax.set(title=title, xlabel="x over the side of a square", ylabel="y")
    off = np.linalg.norm((u - truth)[inner]) / np.linalg.norm(truth[inner])
    said = f"the learned sheet errs by {100 * off:.2g} % (dots: displacement given)"
    headline(figure, f"On a disk that no fit saw, {said}")
    figure.savefig(path, dpi=100)


def at_rest(solid: HyperelasticSolid, samples: Samples) -> float:
    """Smallest eigenvalue of the tangent at rest on the square, over that of the Laplacian."""
    problem = StaticProblem(solid.on(samples).energies)
    smallest = problem.smallest_eigenvalue(solid.coefficients, np.zeros_like(samples.x))
    return smallest / problem.softest


def study(given: argparse.Namespace, element: str) -> dict[str, Any]:
    """Data, fits and errors for one kind of element."""
    material = Material(given.E, given.nu, given.k1, given.k2, given.angle)
    began = time.perf_counter()
    sets = make_hgo(
        given.data,
        material=material,
        element=element,
        counts=(given.samples, 25, 25, given.disks),
        seed=given.seed,
        jobs=given.jobs,
        progress=not given.json,
    )
    report: dict[str, Any] = {"seconds of data": time.perf_counter() - began}
    models = learn(sets["train"], given.stiffness)
    for name, (solid, seconds) in models.items():
        report[name] = {
            "numbers": int(np.count_nonzero(solid.coefficients)),
            "seconds": seconds,
            "at rest": at_rest(solid, sets["val"]),
            **table(solid, sets, given.solved),
        }
        if name == "read out":
            report[name]["material"] = {t.label: c for t, c in material_terms(solid)}
            report[name]["words"] = in_words(solid)
            wp.save(given.out / f"{element}.json", solid)
            save_febio(solid, given.out / f"{element}.feb")
        if name == "guaranteed":
            picture(solid, sets["disks"], given.out / f"{element}_disk.png")
    return report


def main() -> None:
    parser = Options(__doc__, "hgo_square", json=True)
    parser.add("--element", choices=(*ELEMENTS, "both"), default="both")
    parser.add("--samples", type=int, default=200, help="to learn from")
    parser.add("--disks", type=int, default=10, help="to test on")
    parser.add("--solved", type=int, default=10, help="samples of a set solved for E_u")
    parser.add("--stiffness", type=float, default=STIFFNESS, help="of deviations, to read")
    parser.add("--seed", type=int, default=1000, help="of the first load")
    parser.add("--jobs", type=int, default=-1, help="processes that make data")
    parser.add("--data", type=Path, default=ROOT / "data" / "hgo")
    for name, value in vars(Material()).items():
        parser.add(f"--{name}", type=float, default=value, help="of the sheet")
    given = parser.parse_args()
    chosen = ELEMENTS if given.element == "both" else (given.element,)
    reports = {element: study(given, element) for element in chosen}
    write_json(given.out / "errors.json", reports)
    if given.json:
        print(json.dumps(plain(reports), indent=2))
        return
    for element, models in reports.items():
        for name, model in models.items():
            if name == "seconds of data":
                print(f"{element} elements, errors in %: E_res / E_u (not solved)")
                continue
            parts = [
                f"{key} {100 * model[key]['E_res']:.2f} / {100 * (model[key]['E_u'] or np.nan):.2f}"
                f" ({model[key]['not_solved']})"
                for key in ("train", "val", "test", "disks")
            ]
            print(f"  {name:18} {'  '.join(parts)}  {model['seconds']:.1f} s")
            for line in model.get("words", ()):
                print(f"      {line}")


if __name__ == "__main__":
    sys.exit(exit_status(main))
