"""From atoms to held-out disks: make graphene data, learn a peridynamic model, certify, predict.

Writes model.json, metrics.json, report.md and figures to the output folder.
"""

import argparse
import shlex
import sys
import time
import warnings
from pathlib import Path
from typing import Any, Literal

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # for tools/, which is not installed

import numpy as np

import warp_peri as wp
from examples import graphene_report as report
from examples.local_elasticity import errors_of_local
from tools.options import Options
from warp_peri import Dataset, InputError, Samples
from warp_peri.cluster import scheduler
from warp_peri.core.elastic import plane_isotropic
from warp_peri.crystals import CrystalMaterial
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.fitting import settings
from warp_peri.fitting.evaluate import train
from warp_peri.fitting.result import Fit
from warp_peri.materials.lps_fit import Learner
from warp_peri.materials.lps_law import LPSFound, optimum
from warp_peri.materials.lps_parameters import LPSParameters
from warp_peri.materials.third_order import CUBIC, ThirdOrderMaterial

DATA = ROOT / "data" / "graphene_0K.h5"
SMOOTHING_RADIUS = 10.0
OUT = ROOT / "runs" / "graphene_0K"
BONDS_20, BONDS_28 = 2.5, 3.0
"""Horizons of 20 and 28 bonds, in spacings."""
ALPHAS = (-3.0, -1.5, 0.0, 1.0, 2.0, 2.9)
"""Exponents that the report holds against one another."""
THIRD_ORDER: dict[Literal["energy", "filtered"], float] = {"energy": 0.2, "filtered": 0.1}
"""Ridge of the smoothing of each form of the third-order model."""
EXAMPLE = "\nExample: python examples/train_graphene.py --horizon 15 --degree 8 --out runs/other"


def run(given: argparse.Namespace) -> dict[str, Any]:
    """The whole main job; returns what metrics.json holds."""
    begin = time.perf_counter()
    given.data = path = data_file(given)
    data = wp.load(path)
    sets = sets_at(data, given.spacing)
    seconds = {"data": time.perf_counter() - begin}
    conditions = wp.methods.StabilityConditions(given.conditions)
    kernel = None if given.degree is None else wp.Bernstein(given.degree)
    trained = train(
        wp.LPS(given.horizon, kernel, settings.named(given.method, seed=given.seed), conditions),
        sets["train"],
        sets,
        noise=noise_at(data, given.spacing),
        allow_uncertified=True,
        progress=True,
    )
    for reason in trained.refused.values():
        raise InputError(reason)
    seconds |= trained.seconds
    given.degree = trained.fit.material.degree
    truth = data.provenance.get("truth") if given.temperature == 0 else None
    local = {} if truth is None else local_rows(sets, trained.fit, truth)
    drawing = time.perf_counter()
    report.draw(given.out, trained, sets, given.spacing, local)
    seconds["figures"] = time.perf_counter() - drawing
    numbers = report.metrics(trained, data.provenance)
    numbers["local"] = {
        name: {role: float(errors.mean()) for role, errors in by_role.items()}
        for name, by_role in local.items()
    }
    if "augmented_lagrangian" in numbers:
        numbers["alphas"] = alphas_as_good(sets["train"], trained.fit.law)
    if noise_at(data, given.spacing) is None and not given.linear:
        numbers["other"] = other_row(sets, given)
        numbers["third_order"], beside = third_order_rows(sets, given)
        numbers["micromodulus"], crystal = crystal_row(sets, given)
    seconds["all"] = time.perf_counter() - begin
    numbers["seconds"] = seconds
    provenance = {
        "data_provenance": data.provenance,
        "seed": given.seed,
        "method": given.method,
        "conditions": given.conditions,
    }
    trained.save(given.out, numbers, data=path, provenance=provenance)
    if "third_order" in numbers:
        for form, model in beside.items():
            model.save(given.out / f"third_order_{form}.json")
        crystal.save(given.out / "micromodulus.json")
    report.write_report(given.out / "report.md", numbers, path, given.command)
    return numbers


def local_rows(
    sets: dict[str, Samples], fit: Fit, truth: dict[str, float]
) -> dict[str, dict[str, np.ndarray]]:
    """E_u of local elasticity by role and sample: with the potential's moduli, with the fit's."""
    learned = fit.moduli[0]
    pairs = {"true": (truth["lambda"], truth["mu"]), "learned": (learned["C12"], learned["C44"])}
    return {
        name: {
            role: errors_of_local(points, plane_isotropic(*pair)) for role, points in sets.items()
        }
        for name, pair in pairs.items()
    }


def alphas_as_good(train: Samples, law: Any) -> list[float]:
    """Exponents α whose best kernel has at most 1.01 times the least loss of all that are tried."""
    data, losses = Learner(law, [train], [], False), {}
    for alpha in ALPHAS:
        start = LPSFound(LPSParameters(0.0, data.stiffness, alpha, np.ones(law.kernel.degree + 1)))
        of = data.blocks, data.lattices, start, data.conditions, law.method
        losses[alpha] = optimum(*of, fixed_alpha=True).loss
    return [alpha for alpha in ALPHAS if losses[alpha] <= 1.01 * min(losses.values())]


def other_row(sets: dict[str, Samples], given: argparse.Namespace) -> dict[str, Any]:
    """Errors and proven bound of the same solid under the other choice of conditions."""
    kind: Any = "direct" if given.conditions == "paper" else "paper"
    law = wp.LPS(
        given.horizon, wp.Bernstein(given.degree), conditions=wp.methods.StabilityConditions(kind)
    )
    found = wp.fit(sets["train"], law, progress=False)
    proof = {key: found.certificate.figures()[key] for key in report.CERTIFICATE}
    return {**errors_of(found.material, sets), "conditions": kind, **proof}


def third_order_rows(
    sets: dict[str, Samples], given: argparse.Namespace
) -> tuple[dict[str, Any], dict[str, ThirdOrderMaterial]]:
    """Errors, constants and seconds of both forms on 28 bonds, and the models, by form."""
    rows: dict[str, Any] = {}
    models: dict[str, ThirdOrderMaterial] = {}
    linear = wp.Crystal(BONDS_28 * given.spacing)
    for form, ridge in THIRD_ORDER.items():
        begin = time.perf_counter()
        smoothing = wp.methods.Smoothing(given.smoothing_radius, ridge)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "strain: solutions are proven unique")  # as reported
            model = wp.fit(sets["train"], wp.ThirdOrder(linear, smoothing, form)).material
            models[form] = model
            learning = time.perf_counter() - begin
            rows[form] = {
                **errors_of(model, sets),
                "bonds": model.linear.bonds,
                "constants": {name: getattr(model, name) for name in CUBIC},
                "proven_strain": model.proven_strain(given.spacing),
                "seconds": {"learning": learning, "all": time.perf_counter() - begin},
            }
    return rows, models


def crystal_row(
    sets: dict[str, Samples], given: argparse.Namespace
) -> tuple[dict[str, Any], CrystalMaterial]:
    """Errors of tensors on 20 bonds, moduli held as long waves show them; the law."""
    begin = time.perf_counter()
    law = wp.Crystal(BONDS_20 * given.spacing)
    crystal = wp.fit(sets["train"], law).material
    row: dict[str, Any] = {
        **errors_of(crystal, sets),
        "bonds": crystal.bonds,
        "moduli": crystal.moduli(),
        "proven": crystal.certificate.proven,
    }
    row["seconds"] = {"all": time.perf_counter() - begin}
    return row, crystal


def errors_of(material: Any, sets: dict[str, Samples]) -> dict[str, dict[str, float]]:
    """E_res and E_u of a material by role."""
    tables = {role: wp.evaluate(material, points) for role, points in sets.items()}
    return {key: {role: tables[role][key] for role in tables} for key in ("E_res", "E_u")}


def data_file(given: argparse.Namespace) -> Path:
    """The data set that was named or, made if it is not there, the one for the temperature."""
    if given.data:
        return Path(given.data)
    if given.temperature == 0:
        return make_data(given.jobs, given.smoothing_radius, given.loads)
    from tools.make_thermal import make_thermal
    from tools.thermal import Bath

    if given.smoothing_radius != SMOOTHING_RADIUS:
        raise InputError("smoothing radius: only data at 0 K are made with another one")
    try:
        bath = Bath(temperature=given.temperature, steps=given.steps)
    except ValueError as error:
        raise InputError(str(error)) from None
    print(f"graphene at {given.temperature:g} K by LAMMPS (finished runs are kept)")
    paths = make_thermal(
        DATA.parent,
        bath=bath,
        factors=[given.factor],
        reductions=[given.reduction],
        jobs=given.jobs,
    )
    return paths[given.reduction, given.factor]


def make_data(jobs: int, smoothing_radius: float, loads: str = "waves") -> Path:
    """The data set in the checkout, made if it is not there."""
    name = DATA.stem + ("" if loads == "waves" else f"_{loads}")
    if smoothing_radius != SMOOTHING_RADIUS:
        name += f"_R{smoothing_radius:g}"
    path = DATA.with_name(f"{name}.h5")
    if not path.exists():
        from tools.make_graphene import LOADS, make_graphene

        said = "making graphene data with LAMMPS (once; finished samples are kept)"
        print(said, file=sys.stderr)
        cache = DATA.with_suffix(".cache")  # atoms depend neither on smoothing nor on other loads
        make_graphene(
            path,
            jobs=jobs,
            cache=cache,
            smoothing_radius=smoothing_radius,
            training=LOADS.get(loads),
        )
    return path


def sets_at(data: Dataset, spacing: float) -> dict[str, Samples]:
    """The training, validation and test sets on nodes of one spacing [Å], by role."""
    sets = {}
    for role in report.ROLES:
        for name in data:
            if name.split("_")[0] == role and abs(data[name].spacing - spacing) < 1e-6 * spacing:
                sets[role] = data[name]
    if "train" not in sets:
        known = ", ".join(f"{name} ({data[name].spacing:g} Å)" for name in data)
        raise InputError(f"no training set on nodes {spacing:g} Å apart; the file has {known}")
    return sets


def noise_at(data: Dataset, spacing: float) -> Samples | None:
    """The fields of noise alone on the training nodes, if the data have any."""
    if "noise" not in data or abs(data["noise"].spacing - spacing) > 1e-6 * spacing:
        return None
    return data["noise"]


def parser() -> Options:
    """Options of the main job."""
    parser = Options(__doc__ + EXAMPLE, defaults=True)
    parser.add("--spacing", type=float, default=5.0, help="distance of the nodes [Å], 5 or 2.5")
    parser.add("--horizon", type=float, default=20.0, help="horizon δ [Å]")
    parser.add(
        "--degree",
        type=int,
        help="degree of the Bernstein polynomials (default: the smallest that foretells loads left "
        "out of the fit within 2 % of the best)",
    )
    parser.add(
        "--method",
        choices=("constrained", "two-stage", "optimum"),
        default="constrained",
        help="way of the fit",
    )
    parser.add(
        "--conditions",
        choices=("paper", "direct"),
        default="paper",
        help="conditions of the fit: all that are printed (4.6), or a positive symbol alone",
    )
    parser.add(
        "--loads",
        choices=("waves", "designed"),
        default="waves",
        help="training loads at 0 K: seventy waves, or two loads of all waves, each both ways",
    )
    parser.add("--linear", action="store_true", help="learn no third-order and no crystal model")
    parser.add(
        "--temperature",
        type=float,
        default=0.0,
        help="temperature [K]; 300 K takes LAMMPS 15 to 30 minutes",
    )
    parser.add(
        "--reduction",
        choices=("shared", "plain", "iota"),
        default="shared",
        help="reduction of thermal runs (see tools/make_thermal.py), above 0 K only",
    )
    parser.add("--factor", type=float, default=1.0, help="factor on the loads, above 0 K only")
    parser.add("--steps", type=int, default=4000, help="steps of each thermal run, above 0 K only")
    parser.add("--seed", type=int, default=0, help="seed of the first influence function")
    parser.add("--jobs", type=int, default=-1, help="processes for LAMMPS; -1 for all cores")
    parser.add("--scheduler", metavar="ADDRESS", help="address of a Dask scheduler")
    parser.add(
        "--smoothing-radius",
        type=float,
        default=SMOOTHING_RADIUS,
        help="radius R of the smoothing of made data [Å]",
    )
    parser.add("--data", type=Path, help="HDF5 file to use instead of making data")
    parser.add(
        "--out",
        type=Path,
        help="folder for the results (default: runs/graphene_0K or what the temperature is)",
    )
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns 0, 1 after a failure, 2 for bad input, 130 on Ctrl-C."""
    given = parser().parse_args(arguments)
    if given.out is None:
        given.out = OUT.with_name(f"graphene_{given.temperature:g}K")
    words = sys.argv[1:] if arguments is None else arguments
    given.command = shlex.join(["python", "examples/train_graphene.py", *words])
    return exit_status(lambda: work(given), "finished samples are kept and the next run goes on")


def work(given: argparse.Namespace) -> None:
    """The main job, and what is printed of it."""
    with locked(given.out), scheduler(given.scheduler):
        numbers = run(given)
    print(f"graphene at {given.temperature:g} K: {report.shown(given.out)}/model.json")
    print("\n".join(report.first_lines(numbers)))
    print(f"figures and details: {report.shown(given.out)}/report.md")
    print(f"next: source .venv/bin/activate; warp-peri info {report.shown(given.data)}")


if __name__ == "__main__":
    sys.exit(main())
