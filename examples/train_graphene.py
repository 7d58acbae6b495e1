"""From atoms to held-out disks: make graphene data, learn a peridynamic model, certify, predict.

Writes model.json, metrics.json, report.md and figures to the output folder. Other data are made by
tools/make_graphene.py and, at a temperature, tools/make_thermal.py: name them by --data.

Example: python examples/train_graphene.py --horizon 15 --degree 8 --out runs/other
"""

import argparse
import shlex
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # for tools/, which is not installed

import numpy as np

import warp_peri as wp
from examples import graphene_report as report
from examples.local_elasticity import errors_of_local
from tools.options import JOBS, Folder, Options
from warp_peri import Dataset, InputError, Samples
from warp_peri.cli.commands import writing
from warp_peri.cli.main import WRITTEN, hash_of
from warp_peri.core.elastic import plane_isotropic
from warp_peri.errors import exit_status
from warp_peri.fitting.evaluate import train
from warp_peri.materials import lps_law
from warp_peri.materials.lps import LPSParameters
from warp_peri.materials.lps_fit import Learner
from warp_peri.materials.lps_law import LPSFound, optimum
from warp_peri.points.arguments import USUAL, Natural, NotNegative, Positive, is_number

DATA = ROOT / "data" / "graphene_0K.h5"
BOND, THICKNESS = (1.3, 1.6), 3.35
"""Of graphene [Å]: what any potential gives, and the distance of layers."""
ALPHAS = (-3.0, -1.5, 0.0, 1.0, 2.0, 2.9)
"""Exponents that the report holds against one another."""
WRITTEN["train_graphene"] = "model.json metrics.json report.md micromodulus.json third_*.json *.png"
OPTIONS: dict[str, tuple[Any, ...]] = {
    "spacing": (5.0, "distance of the nodes [Å], 5 or 2.5", Positive),
    "horizon": (20.0, "horizon δ [Å]", Positive),
    "degree": (
        int, "of the Bernstein polynomials; the smallest within 2 % of the best by default", Natural
    ),
    "method": (("constrained", "two-stage", "optimum"), "way of the fit"),
    "conditions": (("paper", "direct"), "of the fit: all of (4.6), or a positive symbol alone"),
    "temperature": (0.0, "of made data [K]; 300 K takes LAMMPS 15 to 30 minutes", NotNegative),
    "jobs": JOBS,
    "linear": (False, "learn no third-order and no crystal model"),
    "data": (Path, "HDF5 file to use instead of making data"),
    "out": (Path, "folder for the results, runs/graphene_0K or what the temperature is", Folder),
    "overwrite": (False, "results, and made data, of other settings, too"),
}  # fmt: skip


def run(given: argparse.Namespace) -> None:
    """The whole main job, whose results replace those of the same settings alone."""
    begin = time.perf_counter()
    if given.data and given.temperature:
        raise InputError("temperature: expected none beside data, which have their own")
    given.options["data"] = path = given.data or made_data(given)
    with writing(given) as start:
        learn(given, path, begin, start)


def learn(given: argparse.Namespace, path: Path, begin: float, start: Callable[[], None]) -> None:
    """Results of data, and what is printed; the time since `begin`; `start` precedes all files."""
    data = wp.load(path, units=USUAL)
    check_graphene(path, data)
    sets = sets_at(data, given.spacing)
    if not ({"noise"} & sets.keys() or given.linear or report.radius_of(data)):
        raise InputError(
            f"{path}: expected a file that names the radius of its smoothing, smoothing.radius in "
            "Å, which other laws than the linear solid need; or --linear"
        )
    noise, seconds = sets.pop("noise", None), {"data": time.perf_counter() - begin}
    conditions = wp.methods.StabilityConditions(given.conditions)
    kernel = None if given.degree is None else wp.Bernstein(given.degree)
    law = wp.LPS(given.horizon, kernel, lps_law.METHODS[given.method](), conditions)
    trained = train(law, sets["train"], sets, noise=noise, allow_uncertified=True, progress=True)
    for reason in trained.refused.values():
        raise InputError(reason)
    seconds |= trained.seconds
    numbers, models = report.metrics(trained, data), {}
    rows = numbers["models"]
    if "augmented_lagrangian" in numbers:
        numbers["alphas"] = alphas_as_good(sets["train"], trained.fit.law)
    if noise is None and not given.linear:
        for name, other in laws(given, numbers["degree"], numbers["radius"]).items():
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "strain: solutions are proven")  # as reported
                found = wp.fit(sets["train"], other)
                tables = {role: wp.evaluate(found.material, one) for role, one in sets.items()}
            rows[name] = {e: {r: one[e] for r, one in tables.items()} for e in report.ERRORS}
            if isinstance(other, wp.LPS):
                rows[name] |= {key: found.certificate.figures()[key] for key in report.CERTIFICATE}
            else:
                models[name] = found.material
    if (truth := numbers["truth"]) and not numbers["temperature"]:
        learned = numbers["moduli"]
        pairs = (truth["lambda"], truth["mu"]), (learned["C12"], learned["C44"])
        for name, pair in zip(report.LOCAL, pairs):
            C = plane_isotropic(*pair)
            errors = {role: errors_of_local(one, C).tolist() for role, one in sets.items()}
            means = {role: float(np.mean(each)) for role, each in errors.items()}
            rows[name] = {"E_u": means, "E_u_samples": errors}
    drawing = time.perf_counter()
    start()
    for name, material in models.items():
        material.save(given.out / f"{report.FILES[name]}.json")
    numbers["figures"] = report.draw(given.out, trained, sets, rows)
    seconds["figures"] = time.perf_counter() - drawing
    numbers |= {"thickness": data.thickness, "density": data.density}
    numbers["seconds"] = seconds | {"all": time.perf_counter() - begin}
    said = {name: getattr(given, name) for name in ("method", "conditions")}
    said |= {"sha256": hash_of(path), "data_provenance": data.provenance}
    trained.save(given.out, numbers, data=path, provenance=said)
    report.write_report(given.out / "report.md", numbers, models, path, given.line)
    print(f"graphene at {numbers['temperature']:g} K: {report.shown(given.out)}/model.json")
    print(*report.first_lines(numbers), sep="\n")
    print(f"figures and details: {report.shown(given.out)}/report.md")
    print(f"next: source .venv/bin/activate; warp-peri info {report.shown(path)}")


def check_graphene(path: Path, data: Dataset) -> None:
    """Raise InputError unless a file says that it is of graphene, and how warm."""
    bond: Any = data.provenance.get("bond_length")
    at = data.provenance.get("temperature")
    sheet = abs(data.thickness / THICKNESS - 1) < 0.01
    if not (is_number(at) and is_number(bond) and BOND[0] <= bond <= BOND[1] and sheet):
        raise InputError(
            f"{path}: expected graphene of tools/make_graphene.py or make_thermal.py, of a bond "
            f"length of {BOND[0]} to {BOND[1]} Å, a thickness of {THICKNESS} Å and a temperature, "
            f"got {bond!r:.20}, {data.thickness:g} and {at!r:.20}"
        )


def laws(given: argparse.Namespace, degree: int, radius: float) -> dict[str, Any]:
    """Beside the solid, by name: it under the other conditions, crystals on 20 and 28 bonds."""
    kind: Any = "direct" if given.conditions == "paper" else "paper"
    conditions = wp.methods.StabilityConditions(kind)
    solid = wp.LPS(given.horizon, wp.Bernstein(degree), conditions=conditions)
    short, long = (wp.Crystal(reach * given.spacing) for reach in (2.5, 3.0))
    energy = wp.ThirdOrder(long, wp.methods.Smoothing(radius, 0.2), "energy")
    filtered = wp.ThirdOrder(long, wp.methods.Smoothing(radius, 0.1), "filtered")
    return {report.CONDITIONS[kind]: solid} | dict(zip(report.FILES, (short, energy, filtered)))


def alphas_as_good(train: Samples, law: Any) -> list[float]:
    """Exponents α whose best kernel has at most 1.01 times the least loss of all that are tried."""
    data, losses = Learner(law, [train], [], False), {}
    for alpha in ALPHAS:
        start = LPSFound(LPSParameters(0.0, data.stiffness, alpha, np.ones(law.kernel.degree + 1)))
        of = data.blocks, data.lattices, start, data.conditions, law.method
        losses[alpha] = optimum(*of, fixed_alpha=True).loss
    return [alpha for alpha in ALPHAS if losses[alpha] <= 1.01 * min(losses.values())]


def made_data(given: argparse.Namespace) -> Path:
    """The data set for the temperature in data/, made if it is not there."""
    if given.temperature:
        from tools.make_thermal import Bath, make_thermal

        print(f"graphene at {given.temperature:g} K by LAMMPS (finished runs are kept)")
        how: dict[str, Any] = {"reductions": ["shared"], "jobs": given.jobs}
        how |= {"bath": Bath(given.temperature), "overwrite": given.overwrite}
        (path,) = make_thermal(DATA.parent, **how).values()
        return path
    from tools.make_graphene import make_graphene

    if not DATA.exists():
        print("making graphene data by LAMMPS once; finished samples are kept", file=sys.stderr)
    return make_graphene(DATA, jobs=given.jobs, overwrite=given.overwrite)


def sets_at(data: Dataset, spacing: float) -> dict[str, Samples]:
    """Training, validation and test sets and fields of noise on nodes of one spacing [Å]."""
    named = {name.removesuffix("_fine"): one for name, one in data.sets.items()
             if abs(one.spacing - spacing) < 1e-6 * spacing}  # fmt: skip
    if "train" not in named:
        known = ", ".join(f"{name} ({data[name].spacing:g} Å)" for name in data)
        raise InputError(f"no training set on nodes {spacing:g} Å apart; the file has {known}")
    return {role: named[role] for role in (*report.ROLES, "noise") if role in named}


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns 0, 1 after a failure, 2 for bad input, 130 on Ctrl-C."""
    given = Options(__doc__, options=OPTIONS).parse_args(arguments)
    given.out = given.out or ROOT / "runs" / f"graphene_{given.temperature:g}K"
    given.command, given.files, given.inputs = "train_graphene", [], ""
    given.options = {n: v for n, v in vars(given).items() if n in OPTIONS and n != "overwrite"}
    given.words = sys.argv[1:] if arguments is None else arguments
    given.line = shlex.join(["python", "examples/train_graphene.py", *given.words])
    return exit_status(partial(run, given), "finished samples are kept and the next run goes on")


if __name__ == "__main__":
    sys.exit(main())
