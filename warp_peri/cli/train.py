"""Commands that learn: dumps to data, data to a model, and the choice of horizon and degree.

What needs torch or Warp is imported where a command runs, so that `--help` does without.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np

import warp_peri
from warp_peri.atoms import dumps
from warp_peri.atoms.coarse_graining import smoothing_matrix
from warp_peri.cli.inputs import atom_forces, node_lattice, shape_of
from warp_peri.cli.settings_file import keep, refuse_used
from warp_peri.errors import InputError, warn
from warp_peri.files.atomic import locked, write_json
from warp_peri.fitting import settings
from warp_peri.learning import DEGREES, HORIZONS
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.unit_names import LENGTHS, shown_moduli, symbols

if TYPE_CHECKING:
    from warp_peri.learning.sweep import Run
    from warp_peri.points.samples import Samples

Result = dict[str, Any]

HORIZON, DEGREE = 20.0, 10
"""δ [Å] and M of the Bernstein polynomials that are learned where nothing else was asked for."""

ERRORS = {"E_res": "residual of forces, larger for short waves", "E_u": "error of displacement"}
"""Errors that training prints, and what they are of."""

CUBIC = ("t3", "tq2", "q3")
"""Third-order constants that a law may have."""

OF_LPS = {"influence": None, "noise": None, "method": "optimum", "conditions": "direct",
          "zeta": None, "loss": "auto", "seed": 0, "degree": None}  # fmt: skip
"""Options that mean nothing to other laws, and their defaults."""
KINDS = {
    "lps": "linear peridynamic solid (LPS)",
    "tensors": "crystal model",
    "third-order": "crystal model with third-order constants",
}
HELD_OUT = ("test", "val")
"""Materials by the word of --law; sets that say how good a model is, the first that is there."""

TYPED_BOX = 1e-3
"""Relative difference of a typed period from that of the dump."""


def run_coarse_grain(given: argparse.Namespace) -> Result:
    """Dumps → a set of a data file; sets of other names that the file has stay in it."""
    _take_sheet(given)
    frame = next(dumps.dump_frames(given.reference))
    reference, box = frame.x, None
    if given.box:
        dumps.check_box(given.reference, tuple(given.box), frame.box, TYPED_BOX)
        box = frame.box  # typed lengths are rounded
    limit = min(box) / 2 if box else float(np.ptp(reference, axis=0).max())
    if given.radius > limit:
        what = "half the smallest period" if box else "the extent of the body"
        raise InputError(f"radius: expected at most {limit:g} Å, {what}, got {given.radius:g} Å")
    force = np.stack([atom_forces(path, len(reference)) for path in given.force])
    mass = np.ones(len(reference))
    if given.mass:
        mass = dumps.dump_masses(given.reference, given.mass)
    points = node_lattice(given.spacing, given.reach, given.interior, round_body=box is None)
    points = dataclasses.replace(points, x=points.x + reference.mean(axis=0))
    omega = smoothing_matrix(
        reference, points.x, radius=given.radius, box=box, spacing=given.spacing
    )
    samples = dumps.coarse_grain_dumps(
        given.dumps,
        omega,
        points,
        dumps.Atoms(reference, mass, frame.ids, box),
        force=force,
        unloaded=given.unloaded or [],
        average=dumps.Average(given.skip, given.iota),
        node_area=given.spacing**2,
        thickness=given.thickness,
        progress=given.progress,
    )
    with locked(given.out):
        before = _take_sheet(given)  # another job may have written it meanwhile
        sets = dict(before.sets) if before else {}
        provenance = dict(before.provenance) if before else {"source": "warp-peri coarse-grain"}
        sets[given.set] = samples
        save_dataset(given.out, Dataset(sets, given.thickness, given.density, provenance))
        keep(given, given.out.with_suffix(f".{given.set}.coarse-grain.toml"))
    return {
        "file": str(given.out),
        "set": given.set,
        "samples": len(samples),
        "nodes": len(samples.x),
        "interior": int(samples.interior.sum()),
    }


def _take_sheet(given: argparse.Namespace) -> Dataset | None:
    """Set thickness and density to the data file's; the file, if it is there.

    Raises InputError for a given value that is not the file's, and for none where there is no file.
    """
    before = load_dataset(given.out) if given.out.exists() else None
    for name, unit, why in (
        ("thickness", "Å", "forces become stresses by it: all moduli go as one over it"),
        ("density", "kg/m³", "waves go by it"),
    ):
        asked, kept = getattr(given, name), getattr(before, name, None)
        if asked is None and kept is None:
            raise InputError(f"{name}: expected --{name} of the sheet [{unit}], got none; {why}")
        if before and asked not in (None, kept):
            raise InputError(
                f"{name}: {given.out} has {kept:g} {unit}, got {asked:g} {unit}; in Python "
                f"wp.load(path).of_sheet({name}={asked:g}) is the file corrected"
            )
        setattr(given, name, asked if before is None else kept)
    return before


def _dataset(given: argparse.Namespace) -> Dataset:
    """The data in their own units, or those asked for; the usual horizon in their unit of length.

    Raises InputError where the units are reduced ones, which have no usual horizon.
    """
    data = load_dataset(given.data, units=tuple(given.units) if given.units else None)
    if getattr(given, "horizon", 0.0) is None:
        if data.units[0] not in LENGTHS:
            raise InputError(f"horizon: expected one in {data.units[0]}, the data's unit; got none")
        given.horizon = HORIZON / LENGTHS[data.units[0]]
    return data


def run_train(given: argparse.Namespace) -> Result:
    """Data → model.json, metrics.json and the settings, in a folder."""
    from warp_peri.learning.sweep import train

    refuse_used(given, given.out / "model.json", given.out / f"{given.command}.toml")
    data = _dataset(given)
    samples = data[given.set]
    noise = data[given.noise] if given.noise else None
    law = _law(given, samples, symbols(data.units)[0])
    with locked(given.out):
        options: dict[str, Any] = {"noise": noise} if noise else {}
        run = train(law, samples, data.sets, progress=given.progress, **options)
        metrics = training_metrics(run)
        if given.law == "lps":
            metrics |= _told_by_data(run.fit, samples, given.horizon)
        with contextlib.suppress(InputError):  # scattered points, too few samples, third order
            found = warp_peri.diagnose(run.fit.material, samples, noise)
            metrics["residual"] = {"why": found.sentence, **found.shares}
            if found.advice:
                warn(found.advice)
        metrics |= {"thickness": data.thickness, "density": data.density}
        provenance = {"data_provenance": data.provenance}
        run.save(given.out, metrics, data=given.data, provenance=provenance)
        keep(given, given.out / f"{given.command}.toml")
    given.first = _first(given, metrics, data)
    return {**metrics, "model": str(given.out / "model.json")}


def _law(given: argparse.Namespace, samples: Samples, unit: str) -> Any:
    """What is learned, by the options; InputError for those of an LPS with another law."""
    if given.law == "lps":
        degree = DEGREE if given.degree is None else given.degree
        kernel: settings.Kernel = settings.Bernstein(degree)
        if given.influence:
            if given.degree is not None:
                raise InputError("degree, influence: expected one of the two")
            kernel = shape_of(given.influence, given.horizon, samples.spacing, unit)
        method = settings.named(given.method, seed=given.seed)
        conditions = settings.Conditions(given.conditions, given.zeta)
        return warp_peri.LPS(given.horizon, kernel, method, conditions, given.loss, given.normalise)
    usual = OF_LPS | ({} if given.law == "tensors" else {"normalise": False})
    if own := [f"--{name}" for name, value in usual.items() if getattr(given, name) != value]:
        raise InputError(f"{', '.join(own)}: not of --law {given.law}")
    law = warp_peri.Micromodulus(given.horizon, normalise=given.normalise)
    smoothing = warp_peri.methods.Smoothing(2 * samples.spacing)
    return law if given.law == "tensors" else warp_peri.ThirdOrder(law, smoothing)


def _told_by_data(fit: Any, samples: Samples, horizon: float) -> Result:
    """The moduli of a crystal model of the data, where those of an LPS are off by more than their
    spread, which is warned of."""
    from warp_peri.materials.crystal_fit import long_waves_of_data

    best, warned = long_waves_of_data(fit.moduli[0], samples, horizon)
    if warned:
        warn(warned)
    return {"moduli of a crystal model": best} if best else {}


def _first(given: argparse.Namespace, metrics: Result, data: Dataset) -> list[str]:
    """What was learned, how good it is in one number, and the next command."""
    path, solved, samples = given.out / "model.json", metrics["E_u"], data[given.set]
    kind = f"{KINDS[given.law]}, horizon {given.horizon:g} {symbols(data.units)[0]}"
    others = [
        name
        for name, points in data.sets.items()
        if name != given.set and points.spacing == samples.spacing and solved.get(name) is not None
    ]
    name = next((name for name in (*HELD_OUT, *others) if name in others), given.set)
    seen = "loads that the fit did not see" if name != given.set else "the loads of the fit"
    error = "not known" if solved.get(name) is None else f"{100 * solved[name]:.2g} %"
    proven = metrics["certified"]
    of = "the linear part has " if given.law == "third-order" else ""
    last = ["evaluate", str(path), str(given.data)]
    if name != given.set:
        out = str(given.out / "solved.h5")
        last = ["solve", str(path), str(given.data), "--set", name, "--out", out]
    return [
        f"{path}: {kind}, learned from {len(samples)} loads",
        f"moduli: {sheet_of(data)}",
        f"error of displacement: {error} on set {name!r}, {seen}",
        f"proven: {of}exactly one equilibrium for every load" if proven else "nothing is proven",
        f"next: {shlex.join(['warp-peri', *last])}",
    ]


def sheet_of(data: Dataset) -> str:
    """Words on the numbers of a sheet that stresses depend on."""
    size = f"{data.thickness:g} {symbols(data.units)[0]}"
    return f"of a sheet {size} thick, of {data.density:g} kg/m³, as the data file says"


def training_metrics(run: Run) -> Result:
    """Constants, certificate and errors of a training run."""
    material = run.fit.material
    solid = getattr(material, "linear", material)
    proof = run.fit.certificate
    metrics: Result = {"units": list(material.units), "certified": proof is not None}
    if proof is not None:
        metrics |= {"certified": bool(proof.holds), "statement": proof.statement}
    if hasattr(run.fit, "loss"):
        metrics["loss"] = f"{run.fit.loss.name} ({run.fit.loss.reason})"
    numbers = {name: name for name in ("mu", "E", "nu", *CUBIC)} | {"lambda": "lam"}
    metrics |= {
        key: getattr(material, name) for key, name in numbers.items() if hasattr(material, name)
    }
    metrics["moduli"] = run.fit.moduli[0] if hasattr(run.fit, "moduli") else solid.moduli()
    metrics |= {"E_res": run.mean("E_res"), "E_u": run.mean("E_u")}
    metrics["not_evaluated"] = run.refused
    if getattr(run.fit, "influence", None) is not None:
        metrics |= material.provenance
    return metrics


FAR = 5.0
"""Times that E_res is above E_u where a line says why."""


def in_percent(metrics: Result) -> Result:
    """What training prints: errors and shares in %, moduli in GPa; JSON keeps plain numbers."""
    shown: Result = {}
    units = tuple(metrics["units"])
    for key, value in metrics.items():
        if key == "not_evaluated" and not value:
            continue
        if key in ERRORS:
            shown[f"{ERRORS[key]} [%]"] = {
                name: "–" if error is None else 100 * error for name, error in value.items()
            }
        elif key in ("thickness", "density"):
            unit = symbols(units)[0] if key == "thickness" else "kg/m³"
            shown[key] = f"{value:g} {unit}"
        elif key == "residual":
            shown["why"] = value["why"]
            shares = {name: 100 * share for name, share in value.items() if name != "why"}
            shown["shares of the squared residual [%]"] = shares
        elif key in ("lambda", "mu", "E", *CUBIC):
            shown[key] = shown_moduli(units, (value,), digits=6)
        elif key in ("moduli", "moduli of a crystal model"):
            shown[key] = {
                name: shown_moduli(units, (size,), digits=6) if name[0] in "lmCE" else size
                for name, size in value.items()
            }
        else:
            shown[key] = value
    solved = metrics["E_u"]
    small = [n for n, e in metrics["E_res"].items() if e and solved.get(n) and e > FAR * solved[n]]
    if small:
        shown["note"] = (
            f"the loads of {', '.join(small)} are small for their displacement, and the residual "
            "is relative to them; the error of a solve is that of displacement"
        )
    return shown


def run_sweep(given: argparse.Namespace) -> Result:
    """Algorithm 2 on a data file: sweep.json and the models, in a folder."""
    data = _dataset(given)
    sweep = warp_peri.methods.sweep(
        data[given.set],
        data[given.val],
        given.out,
        test=data[given.test] if given.test else None,
        noise=data[given.noise] if given.noise else None,
        horizons=given.horizons or list(HORIZONS),
        degrees=given.degrees or list(DEGREES),
        conditions=given.conditions,
        jobs=given.jobs,
        progress=given.progress,
    )
    result: Result = {
        "fits": len(sweep.trials),
        "units": list(data.units),
        "smallest_AvgE": dataclasses.asdict(sweep.printed),
        "cheapest": dataclasses.asdict(sweep.cheapest),
        "moduli": sheet_of(data),
    }
    with locked(given.out):
        write_json(given.out / "sweep.json", result)
        keep(given, given.out / f"{given.command}.toml")
    return result
