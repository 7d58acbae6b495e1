"""Commands that learn: dumps to data, data to a model, and the choice of horizon and degree.

What needs torch or Warp is imported where a command runs, so that `--help` does without.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import shlex
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

import warp_peri
from warp_peri.atoms import dumps
from warp_peri.atoms.coarse_graining import smoothing_matrix
from warp_peri.cli.inputs import atom_forces, node_lattice, shape_of
from warp_peri.cli.settings_file import keep, refuse_used
from warp_peri.errors import InputError
from warp_peri.files.atomic import locked, write_json
from warp_peri.fitting import settings
from warp_peri.learning import DEGREES, HORIZONS
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.unit_names import LENGTHS, shown_moduli, symbols

if TYPE_CHECKING:
    from warp_peri.learning.sweep import Run

Result = dict[str, Any]

HORIZON, DEGREE = 20.0, 10
"""δ [Å] and M of the Bernstein polynomials that are learned where nothing else was asked for."""

ERRORS = {"E_res": "residual of forces, larger for short waves", "E_u": "error of displacement"}
"""Errors that training prints, and what they are of."""

CUBIC = ("t3", "tq2", "q3")
"""Third-order constants that a law may have."""

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
    from warp_peri.learning import sweep
    from warp_peri.materials.crystal_fit import long_waves_of_data

    refuse_used(given, given.out / "model.json", given.out / f"{given.command}.toml")
    data = _dataset(given)
    if given.law != "lps":
        return _train_other(given, data)
    samples, noise = data[given.set], data[given.noise] if given.noise else None
    kernel: settings.Kernel
    kernel = settings.Bernstein(DEGREE if given.degree is None else given.degree)
    if given.influence:
        if given.degree is not None:
            raise InputError("degree, influence: expected one of the two")
        unit = symbols(data.units)[0]
        kernel = shape_of(given.influence, given.horizon, samples.spacing, unit)
    with locked(given.out):
        run = sweep.train(
            samples,
            given.horizon,
            kernel,
            data.sets,
            noise=noise,
            method=settings.named(given.method, seed=given.seed),
            conditions=warp_peri.methods.Conditions(given.conditions, given.zeta),
            loss=given.loss,
            normalise=given.normalise,
            progress=given.progress,
        )
        metrics = training_metrics(run)
        best, warned = long_waves_of_data(run.fit.moduli[0], samples, given.horizon)
        if best:
            metrics["moduli of a crystal model"] = best
        if warned:
            warnings.warn(warned, stacklevel=1)
        with contextlib.suppress(InputError):  # scattered points, or too few samples
            found = warp_peri.diagnose(run.fit.material, samples, noise)
            metrics["residual"] = {"why": found.sentence, **found.shares}
            if found.advice:
                warnings.warn(found.advice, stacklevel=1)
        return _kept(given, run, metrics, data)


def _train_other(given: argparse.Namespace, data: Dataset) -> Result:
    """The same for a law other than the LPS; its methods, losses and kernels are the LPS's own."""
    from warp_peri.learning.sweep import Run, evaluated

    usual = {"influence": None, "noise": None, "method": "optimum", "conditions": "direct",
             "zeta": None, "loss": "auto", "seed": 0}  # fmt: skip
    usual |= {"degree": None} | ({} if given.law == "tensors" else {"normalise": False})
    if own := [f"--{name}" for name, value in usual.items() if getattr(given, name) != value]:
        raise InputError(f"{', '.join(own)}: not of --law {given.law}")
    samples, horizon = data[given.set], given.horizon
    law: Any = warp_peri.Micromodulus(horizon, normalise=given.normalise)
    if given.law == "third-order":
        law = warp_peri.ThirdOrder(law, warp_peri.methods.Smoothing(2 * samples.spacing))
    with locked(given.out):
        fit = warp_peri.fit(samples, law, progress=given.progress)
        run = Run(fit, *evaluated(fit.material, data.sets), {})
        material, solid = fit.material, getattr(fit.material, "linear", fit.material)
        proof: Any = getattr(fit, "certificate", None) or solid.certificate
        metrics = {"law": given.law, "units": list(data.units), "moduli": solid.moduli()}
        if hasattr(proof, "statement"):
            metrics["statement"] = proof.statement
        metrics |= {name: getattr(material, name) for name in CUBIC if hasattr(material, name)}
        metrics |= {"E_res": run.mean("E_res"), "E_u": run.mean("E_u")}
        metrics["not_evaluated"] = run.refused
        return _kept(given, run, metrics, data)


def _kept(given: argparse.Namespace, run: Run, metrics: Result, data: Dataset) -> Result:
    """Write what was learned and the settings to the folder; what the command prints."""
    provenance = {"data_provenance": data.provenance}
    metrics |= {"thickness": data.thickness, "density": data.density}
    run.save(given.out, metrics, data=given.data, provenance=provenance)
    keep(given, given.out / f"{given.command}.toml")
    given.first = _first(given, metrics, data)
    return {**metrics, "model": str(given.out / "model.json")}


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
    proven = metrics.get("certified", "statement" in metrics)
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
    model = run.fit.material
    metrics: Result = {
        "units": list(model.units),
        "certified": bool(model.certified_on),
        "statement": run.fit.certificate.statement,
        "loss": f"{run.fit.loss.name} ({run.fit.loss.reason})",
        "lambda": model.lam,
        "mu": model.mu,
        "E": model.E,
        "nu": model.nu,
        "moduli": run.fit.moduli[0],
        "E_res": run.mean("E_res"),
        "E_u": run.mean("E_u"),
        "not_evaluated": run.refused,
    }
    if run.fit.influence is not None:
        metrics |= model.provenance
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
