"""The peridynamic neural operator's three experiments: graphene, an anisotropic sheet, a leaflet.

With the widths, horizons and losses of Jafarzadeh et al. 2024. By default: the errors of the
weights that lie beside this file and of other materials learned from the same data, and one minute
of a training from a fresh start. With --epochs a training that can be stopped and goes on. Weights,
picture and errors are written to --out.
"""

import argparse
import copy
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import torch
from tqdm import tqdm

from examples import neural_sets
from examples.figures import name_lines, panels, save_figure
from examples.neural_rivals import rivals_of
from examples.neural_sets import Sets
from examples.prose import table
from examples.studies.paper_jafarzadeh_pictures import omega
from tools.make_hgo import SPACING
from tools.options import Options
from warp_peri import InputError, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import finite, plain, write_json
from warp_peri.launch import set_threads
from warp_peri.neural import NeuralOperator, Training, evaluate, train
from warp_peri.neural.bonds import NetworkBonds
from warp_peri.neural.material import load, save
from warp_peri.neural.training import TrainingHistory
from warp_peri.points.unit_names import Units, symbols

WEIGHTS = ROOT / "examples" / "neural_weights"
MINUTE = 60.0
PRINTED = {
    "graphene": {
        "E_res": {"train": 0.0789, "val": 0.1023},
        "E_res_abs": {"disks": 4.97e-3},
        "E_u": {"train": 0.10, "val": 0.0278, "disks": 0.038},
    },
    "hgo 3": {
        "E_res": {"train": 0.0321, "val": 0.0368, "disks": 0.0351},
        "E_u": {"train": 0.0073, "val": 0.0077, "disks": 0.0072},
    },
    "hgo 4": {
        "E_res": {"train": 0.0393, "val": 0.0445, "disks": 0.0437},
        "E_u": {"train": 0.0090, "val": 0.0090, "disks": 0.0103},
    },
    "hgo 5": {
        "E_res": {"train": 0.0350, "val": 0.0389, "disks": 0.0382},
        "E_u": {"train": 0.0086, "val": 0.0097, "disks": 0.0098},
    },
    "leaflet": {"E_u": {"train": 0.0702, "val": 0.0947, "test": 0.0701}},
}
"""Errors of the source, on its own data."""


class Experiment(NamedTuple):
    """A training as it is printed, but for what is not printed: strain, rate, batch, epochs."""

    operator: dict[str, Any]
    training: Training


WIDE = {"influence": (256, 512), "state": (512, 512)}
SHEET = {**WIDE, "anisotropic": True, "units": ("mm", "MPa")}
TISSUE = {"influence": (32, 64), "state": (64, 64), "anisotropic": True, "proportional": True}


def experiment(name: str, reach: int) -> Experiment:
    """Networks and settings of an experiment."""
    if name == "graphene":
        return Experiment({**WIDE, "horizon": 20.0, "strain": 0.5}, Training(epochs=330, batch=2))
    if name == "hgo":
        horizon = reach * SPACING
        return Experiment(
            {**WIDE, "anisotropic": True, "horizon": horizon, "strain": 2.0},
            Training(epochs=150, batch=10),
        )
    return Experiment(
        {**TISSUE, "horizon": neural_sets.REACH * SPACING, "strain": 2.0},
        Training(epochs=30, rate=2e-3, batch=5),
    )


def sets_of(given: argparse.Namespace) -> Sets:
    """The samples of an experiment."""
    asked = {"jobs": given.jobs, "progress": not given.json}
    if given.experiment == "graphene":
        return neural_sets.graphene(given.data / "graphene_0K.h5")
    if given.experiment == "hgo":
        return neural_sets.hgo(given.data / "hgo", given.reach, mirror=given.mirror, **asked)
    return neural_sets.leaflet(given.data / "leaflet", **asked)


def label(given: argparse.Namespace) -> str:
    """Name of a training."""
    if given.experiment != "hgo":
        return str(given.experiment)
    return f"hgo_{given.reach}{'_mirror' if given.mirror else ''}"


def trained(
    given: argparse.Namespace, sets: Sets, seconds: float
) -> tuple[NeuralOperator, TrainingHistory]:
    """A material from a fresh start, or from the checkpoint of this training."""
    chosen = experiment(given.experiment, given.reach)
    settings = {
        key: getattr(given, key)
        for key in ("epochs", "rate", "batch", "cells", "seed")
        if getattr(given, key) is not None
    }
    training = dataclasses.replace(chosen.training, **settings)
    operator = dict(chosen.operator)
    if given.strain is not None:
        operator["strain"] = given.strain
    units = sets["train"].points.units
    material = (
        NeuralOperator(**operator, units=units, seed=training.seed)
        if given.start is None
        else started(given.start, operator, units)
    )
    before = material.provenance
    path = given.out / f"{label(given)}.ckpt" if given.epochs else None
    quiet = given.json or given.quiet
    history = train(
        material, sets["train"], sets["val"], training,
        checkpoint=path, seconds=seconds, progress=not quiet,
    )  # fmt: skip
    material.provenance = {
        "command": f"python examples/neural_operator.py {' '.join(sys.argv[1:])}",
        "seed": training.seed,
        "epochs": history.epochs,
        "best": history.best,
        "seconds": round(history.seconds),
        "curve": [[n, round(a, 5), round(b, 5)] for n, a, b in history.curve],
    }
    if before:
        material.provenance["start"] = before
    return material, history


def started(path: Path, operator: dict[str, Any], units: Units) -> NeuralOperator:
    """The material of a file as a start, refused where it is no such operator."""
    material = load(path, units=units).float()
    content = material.content()
    for key, value in operator.items():
        theirs = content[key]
        wanted = [*value] if isinstance(value, tuple) else value
        if not (np.isclose(theirs, wanted) if key == "horizon" else theirs == wanted):
            raise InputError(f"{path}: expected {key} {wanted!r}, got {theirs!r}")
    return material


def errors_of(
    material: NeuralOperator, sets: Sets, given: argparse.Namespace, *, solve: bool
) -> Any:
    """Errors by kind and set; of held-out frames of the leaflet also each one's E_u.

    "stretch" is the largest |e|/|ξ| of a set; of each held-out sample with a load "each" has it,
    the root mean square of its load, and its E_res.

    Where strains are large single precision tells them to 1e-5.
    """
    found: dict[str, dict[str, Any]] = {}
    exact = material.float() if material.anisotropic else material.double()
    for name, samples in tqdm(sets.items(), disable=given.json, leave=False):
        errors = evaluate(exact, samples, solve=solve, most=given.solved, progress=not given.json)
        for key in ("E_res", "E_res_abs", "E_u", "converged"):
            if key in errors:
                found.setdefault(key, {})[name] = errors[key]
        if solve and samples.b is None and name == "test":
            found["frames"] = {name: errors["samples"]["E_u"]}
        stretched = stretches(exact, samples)
        found.setdefault("stretch", {})[name] = float(stretched.max())
        if "E_res" in errors and name in ("test", "disks"):
            size = np.sqrt((samples.loads[:, samples.interior] ** 2).mean(axis=(1, 2)))
            alone = {"stretch": stretched, "load": size, "E_res": errors["samples"]["E_res"]}
            found.setdefault("each", {})[name] = alone
    return found


def stretches(material: NeuralOperator, samples: Samples) -> np.ndarray:
    """The largest |e|/|ξ| of the bonds of every sample that pull at its interior, shape [S]."""
    bonds = NetworkBonds(samples.points, material.horizon)
    e = bonds.extension(torch.as_tensor(samples.u))[:, : bonds.acting]
    largest: np.ndarray = (e.abs().numpy() / bonds.lengths[bonds.place[: bonds.acting]]).max(axis=1)
    return largest


def run(given: argparse.Namespace) -> dict[str, Any]:
    """What the command prints."""
    torch.set_num_threads(given.threads)
    set_threads(given.threads)
    sets, name = sets_of(given), label(given)
    report: dict[str, Any] = {"experiment": name}
    if given.epochs:
        material, history = trained(given, sets, 60 * given.minutes)
        save(material, given.out / f"{name}.json", precision="float16")
        report |= {"epochs": history.epochs, "seconds_an_epoch": history.seconds / history.epochs}
    else:
        began = time.perf_counter()
        material, history = trained(given, sets, min(MINUTE, 60 * given.minutes))
        spent = time.perf_counter() - began
        report["fresh"] = {"seconds": spent, "epochs": history.epochs, "curve": history.curve[-3:]}
        report["seconds_an_epoch"] = history.seconds / max(history.epochs, 1)
        shipped = WEIGHTS / f"{name}.json"
        if shipped.exists():
            material = load(shipped)
            made = material.provenance
            report["epochs"] = made["epochs"] + made.get("start", {}).get("epochs", 0)
            report["seconds_an_epoch"] = made["seconds"] / made["epochs"]
    draw(material, given.out / f"{name}.png", float(stretches(material, sets["train"]).max()))
    length, stress = symbols(material.units)
    report |= {"weights": material.numbers(), "load_unit": f"{stress}/{length}"}
    report |= errors_of(material, sets, given, solve=not given.no_solve)
    report["solved"] = given.solved
    report["printed"] = PRINTED.get(name.replace("_mirror", "").replace("_", " "), {})
    if given.rivals or (given.rivals is None and not given.epochs):
        solve = not given.no_solve
        report["rivals"] = rivals_of(given.experiment, sets, given.reach, solve=solve)
    write_json(given.out / f"{name}_errors.json", finite(plain(report)))
    return report


def draw(material: NeuralOperator, path: Path, stretch: float) -> None:
    """ω, of the bond or of its length, and the force state to this stretch, as they were learned.

    The force state takes ω as an input and may read it with either sign, so that it is drawn
    positive where it is largest.
    """
    exact, (length, stress) = copy.deepcopy(material).double(), symbols(material.units)
    r = material.horizon * torch.arange(1, 201, dtype=torch.float64) / 200
    e = torch.linspace(-stretch, stretch, 201, dtype=torch.float64)
    with torch.no_grad():
        values = exact.omega(torch.stack([r, 0 * r], dim=1))
        states = [
            exact.force_state(w.expand(201), 0 * e, e * size, size.expand(201)).numpy()
            for w, size in zip(values[49::50], r[49::50])
        ]
    lengths, learned = r[49::50].numpy(), values.numpy()
    figure, (left, right) = panels(9, 3.6, count=2)
    if material.anisotropic:
        omega(left, copy.deepcopy(material))
    else:
        left.plot(r.numpy(), learned / learned[np.abs(learned).argmax()])
        left.axhline(0, color="0.7", linewidth=0.8)
        sign = "changes" if learned.min() * learned.max() < 0 else "keeps"
        left.set(xlabel=f"bond length [{length}]", ylabel="ω over its largest value")
        left.set_title(f"The influence function {sign} sign")
    for size, state in zip(lengths, states):
        right.plot(100 * e, state - state[100], label=f"bond of {size:.3g} {length}")
    right.set(xlabel="stretch of the bond [%]")
    right.set_ylabel(f"change of the force [{stress}/{length}³]")
    stiffest = lengths[int(np.argmax([np.ptp(state) for state in states]))]
    right.set_title(f"Of these, bonds of {stiffest:.3g} {length} are the stiffest")
    name_lines(right)
    save_figure(figure, path)


def page(report: dict[str, Any]) -> str:
    """Errors of the network beside those of its rivals and the printed ones, as Markdown."""
    columns = {"network": report, **report.get("rivals", {}), "printed": report["printed"]}
    rows = []
    for key in ("E_res", "E_u", "E_res_abs"):
        for name in report.get(key, {}):
            factor, form = (1, "{:.3g}") if key == "E_res_abs" else (100, "{:.2f} %")
            values = (given.get(key, {}).get(name) for given in columns.values())
            cells = ["" if value is None else form.format(factor * value) for value in values]
            rows.append([key, name, *cells])
    text = table(["", "set", *columns], rows) + "\n"
    if "E_res_abs" in report:
        text += f"\nE_res_abs: ‖Lu − b‖ on the interior [{report['load_unit']}]"
        if report["experiment"] == "graphene":
            text += "; inside the disks b is almost zero, so that E_res says little there"
    text += f"\n{report['weights']} numbers"
    if "epochs" in report:
        text += f", {report['epochs']} epochs of {report['seconds_an_epoch']:.1f} s"
    if "fresh" in report:
        fresh = report["fresh"]
        _, learned, unseen = fresh["curve"][-1]
        text += (
            f"\na fresh start, {fresh['seconds']:.0f} s: {fresh['epochs']} epochs, "
            f"{100 * learned:.1f} % in training and {100 * unseen:.1f} % in validation"
        )
    return text


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "neural", json=True)
    parser.add("experiment", choices=("graphene", "hgo", "leaflet"))
    parser.add("--epochs", type=int, help="train so many; goes on from a checkpoint")
    parser.add("--minutes", type=float, default=np.inf, help="after which a training stops")
    parser.add("--reach", type=int, choices=(3, 4, 5), default=3, help="δ of hgo, spacings")
    parser.add("--mirror", action="store_true", help="hgo: squares by the mirror rule")
    for key, kind in (("rate", float), ("batch", int), ("cells", int), ("strain", float)):
        parser.add(f"--{key}", type=kind, help="other than the experiment's")
    parser.add("--seed", type=int)
    parser.add("--start", type=Path, help="a material whose numbers a training begins with")
    parser.add("--threads", type=int, default=1)
    parser.add("--jobs", type=int, default=-1, help="processes that make data")
    parser.add("--no-solve", action="store_true", help="E_res alone")
    parser.add("--solved", type=int, help="E_u over so many samples of a set, not all")
    parser.add(
        "--rivals", action=argparse.BooleanOptionalAction,
        help="fit the other materials too; by default beside the shipped weights",
    )  # fmt: skip
    parser.add("--data", type=Path, default=ROOT / "data")
    parser.add("--quiet", action="store_true", help="no bar of the training")
    given = parser.parse_args(arguments)
    report = finite(plain(run(given)))
    print(json.dumps(report) if given.json else page(report))
    if not given.json:
        print(f"picture and numbers: {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
