"""What each command does: from files to files, and a result that prints as JSON or as lines.

What needs torch or Warp is reached through the package, which imports it on first use: `--help` and
`info` do without.
"""

from __future__ import annotations

import argparse
import dataclasses
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import warp_peri
from warp_peri.cli.body import run_solve_body
from warp_peri.cli.dic import run_dic as run_dic
from warp_peri.cli.inputs import atom_forces, data_for, node_lattice, shape_of
from warp_peri.cli.learn import run_learn as run_learn
from warp_peri.cli.predict import run_plan as run_plan
from warp_peri.cli.predict import run_predict as run_predict
from warp_peri.cli.settings_file import keep
from warp_peri.errors import InputError
from warp_peri.files.atomic import destination, finite, locked, plain, write_json
from warp_peri.points.dataset import Dataset
from warp_peri.points.dataset_file import load_dataset, save_dataset
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import LENGTHS, shown_moduli, symbols
from warp_peri.sources import dump_files, dumps
from warp_peri.sources.coarse_graining import smoothing_matrix
from warp_peri.storage import load

if TYPE_CHECKING:
    from warp_peri.learning.run import Run

Result = dict[str, Any]

HORIZON, DEGREE = 20.0, 10
"""δ [Å] and M of the Bernstein polynomials that are learned where nothing else was asked for."""

SHEET = {"thickness": 3.35, "density": 2200.0}
"""Thickness [Å] and mass density [kg/m³] where neither the file nor the user says other."""

TYPED_BOX = 1e-3
"""Relative difference of a typed period from that of the dump."""
WIDTH = 100
"""Of a line: words that are longer stand one in a line."""


def check_output(given: argparse.Namespace) -> None:
    """Refuse, before anything is done, to write over what is read or what is no file.

    Raises InputError saying which it is.
    """
    if getattr(given, "out", None) is None:
        return
    out = given.out.resolve()
    for name in ("data", "model", "body", "structure", "reference", "dumps", "force", "unloaded"):
        read = getattr(given, name, None) or []
        for path in read if isinstance(read, list) else [read]:
            if path.resolve() == out:
                raise InputError(f"out: {given.out} is read ({name}); name another file")
    folder = (
        given.command in ("train", "learn", "dic", "sweep")
        or getattr(given, "what", "") == "fields"
    )
    if given.out.exists() and given.out.is_dir() != folder:
        wanted, there = ("folder", "file") if folder else ("file", "folder")
        raise InputError(f"out: expected a {wanted}, {given.out} is a {there}")
    if not folder:
        destination(given.out)


def run_coarse_grain(given: argparse.Namespace) -> Result:
    """Dumps → a set of a data file; sets of other names that the file has stay in it."""
    _take_sheet(given)
    frame = next(dump_files.dump_frames(given.reference))
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
        progress=not given.json,
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
    """Set thickness and density to the data file's, or the defaults; the file, if it is there.

    Raises InputError for a given value that is not the file's.
    """
    before = load_dataset(given.out) if given.out.exists() else None
    for name, unit in (("thickness", "Å"), ("density", "kg/m³")):
        asked = getattr(given, name)
        kept = getattr(before, name) if before else SHEET[name] if asked is None else asked
        if asked is not None and asked != kept:
            raise InputError(f"{name}: {given.out} has {kept:g} {unit}, got {asked:g} {unit}")
        setattr(given, name, kept)
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
    from warp_peri.learning import methods
    from warp_peri.learning.diagnosis import LEAST_SAMPLES, diagnose
    from warp_peri.learning.run import train
    from warp_peri.stability.conditions import Conditions

    data = _dataset(given)
    samples, noise = data[given.set], data[given.noise] if given.noise else None
    kernel: methods.Kernel
    kernel = methods.Bernstein(DEGREE if given.degree is None else given.degree)
    if given.influence:
        if given.degree is not None:
            raise InputError("degree, influence: expected one of the two")
        unit = symbols(data.units)[0]
        kernel = shape_of(given.influence, given.horizon, samples.spacing, unit)
    with locked(given.out):
        run = train(
            samples,
            given.horizon,
            kernel,
            data.sets,
            noise=noise,
            method=methods.named(given.method, seed=given.seed),
            conditions=Conditions(given.conditions, given.zeta),
            loss=given.loss,
            normalise=given.normalise,
            progress=not given.json,
        )
        metrics = training_metrics(run)
        if samples.spacing and len(samples) >= LEAST_SAMPLES:
            diagnosis = diagnose(run.fit.material, samples, noise)
            metrics["residual"] = {"why": diagnosis.sentence, **diagnosis.shares}
            if diagnosis.advice:
                warnings.warn(diagnosis.advice, stacklevel=1)
        provenance = {"data_provenance": data.provenance}
        run.save(given.out, metrics, data=given.data, provenance=provenance)
        keep(given, given.out / f"{given.command}.toml")
    return {**metrics, "model": str(given.out / "model.json")}


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
    if run.sure is not None:
        metrics["deviation"] = {
            "lambda": float(run.sure.deviation(lambda model: model.lam)),
            "mu": float(run.sure.deviation(lambda model: model.mu)),
            "E": float(run.sure.deviation(lambda model: model.E)),
        }
    return metrics


def in_percent(metrics: Result) -> Result:
    """What training prints: errors and shares in %, moduli in GPa; JSON keeps plain numbers."""
    shown: Result = {}
    units = tuple(metrics["units"])
    for key, value in metrics.items():
        if key in ("E_res", "E_u"):
            shown[f"{key} [%]"] = {
                name: "–" if error is None else 100 * error for name, error in value.items()
            }
        elif key == "residual":
            shown["why"] = value["why"]
            shares = {name: 100 * share for name, share in value.items() if name != "why"}
            shown["shares of the squared residual [%]"] = shares
        elif key in ("lambda", "mu", "E"):
            shown[key] = shown_moduli(units, (value,), digits=6)
        elif key in ("moduli", "deviation"):
            shown[key] = {
                name: shown_moduli(units, (size,), digits=6) if name[0] in "lmCE" else size
                for name, size in value.items()
            }
        else:
            shown[key] = value
    return shown


def run_certify(given: argparse.Namespace) -> Result:
    """The certificate of a model on a lattice."""
    material = load(given.model)
    if not hasattr(material, "linear") and hasattr(material, "certified"):
        return proven_on_its_nodes(material, given.spacing)
    model = linear_of(material)
    own = model.trained_on if model.transferred_from is None else model.certified_on
    spacings = given.spacing or list(own)
    if not spacings:
        raise InputError("spacing: the model names no training lattice; give --spacing")
    proven = {}
    for spacing in spacings:
        certificate = warp_peri.certify(model, spacing=spacing)
        name = f"{spacing:g} {symbols(model.units)[0]}"
        proven[name] = {
            "holds": certificate.holds,
            "statement": certificate.statement,
            **certificate.figures(),
        }
        if hasattr(material, "proven_strain"):
            proof = warp_peri.proofs.uniqueness(material, spacing=spacing)
            proven[name]["nonlinear"] = proof.figures()
    return proven


def proven_on_its_nodes(law: Any, spacings: Sequence[float] | None = None) -> Result:
    """The certificate of a law that has one lattice alone, computed where the file has none.

    Raises InputError where another spacing is asked for.
    """
    if spacings:
        raise InputError(f"spacing: this law is for nodes {law.spacing:g} apart alone")
    proof = law.certificate or law.certified().certificate
    figures: Result = {"holds": False, "statement": "nothing is proven"}
    if proof is not None and proof.proven > 0:
        figures = {"holds": True, "statement": proof.statement, **proof.content()}
    return {f"{law.spacing:g} {symbols(law.units)[0]}": figures}


def run_evaluate(given: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Errors of a model on the sets of a file."""
    model = load(given.model)
    data = data_for(given, model)
    given.unit = "{1}/{0}".format(*symbols(model.units))  # of E_res_abs, where it is printed
    tables: dict[str, dict[str, Any]] = {}
    for name in given.sets or data:
        points = data[name]
        try:
            tables[name] = {"samples": len(points)} | warp_peri.evaluate(
                model,
                points,
                transfer=given.transfer,
                allow_uncertified=given.allow_uncertified,
            )
        except InputError as error:
            if given.sets:
                raise InputError(f"set '{name}': {error}") from None
            tables[name] = {"error": str(error)}
    return tables


def run_solve(given: argparse.Namespace) -> Result:
    """Displacement under the loads of a set, or of a body with an outline, in a file."""
    if given.body is not None or given.data is None:
        return run_solve_body(given)
    model = load(given.model)
    data = data_for(given, model)
    points = data[given.set]
    asked = {"allow_uncertified": True} if given.allow_uncertified else {}
    asked |= {} if given.transfer else {"transfer": False}  # laws without these know no default
    problem = warp_peri.Dirichlet(points, points.loads, points.u)
    u = warp_peri.solve(model, problem, solver=_solver(given.method, model), **asked).u
    solved = dataclasses.replace(points, u=u)
    provenance = {"source": "warp-peri solve", "model": given.model.name, "data": given.data.name}
    with locked(given.out):
        save_dataset(
            given.out, Dataset({given.set: solved}, data.thickness, data.density, provenance)
        )
        keep(given, given.out.with_suffix(".solve.toml"))
    size = np.linalg.norm(u[:, points.interior], axis=-1).max(axis=1, initial=0)
    return {"file": str(given.out), "set": given.set, "largest_displacement": size.tolist()}


def linear_of(material: Any) -> Any:
    """The linear solid of a material; InputError for a law that has none."""
    if not hasattr(material, "linear"):
        raise InputError(
            f"model: expected a solid with a linear part, got {type(material).__name__}"
        )
    return material.linear


def _solver(name: str, material: Any) -> Any:
    """Settings of a solver by the name they have on the command line; nonlinear laws have one."""
    from warp_peri.statics.settings import Direct, Krylov  # loads Warp

    if name == "auto" or linear_of(material) is not material:
        return None
    return Direct(name == "gmres") if name in ("lu", "gmres") else Krylov(name)


def run_export(given: argparse.Namespace) -> Result:
    """A model for other tools: fields for ParaView, a table of K, or the matrix of the operator."""
    material, settings = load(given.model), given.out.with_suffix(".export.toml")
    if given.what in ("influence", "kernel"):
        model = linear_of(material)
    if given.what == "influence":
        if given.spacing is None and not model.trained_on:
            raise InputError("spacing: the model names no training lattice; give --spacing")
        spacing = model.trained_on[0] if given.spacing is None else given.spacing
        if given.transfer and not given.allow_uncertified and model.certified_on:
            at_home = model.is_certified_on(spacing)
            model = model if at_home else warp_peri.transfers.on_lattice(model, spacing=spacing)
        paths = [warp_peri.export.write_influence(given.out, model, spacing)]
    elif given.what == "kernel":
        horizon = model.horizon if given.horizon is None else given.horizon
        many = warp_peri.transfers.one_kernel(model, horizon=horizon)
        paths = [warp_peri.export.write_kernel(given.out, many)]
    elif given.data is None:
        raise InputError(f"data: '{given.what}' needs the nodes of a data file, --data DATA.h5")
    else:
        points = data_for(given, material)[given.set]
        solid = warp_peri.export.is_linear_solid(material)  # other laws are of one lattice
        asked = {"transfer": given.transfer, "allow_uncertified": given.allow_uncertified}
        asked = asked if solid else {}
        if given.what == "operator":
            operator = (material.linear if solid else material).on(points, **asked)
            paths = [warp_peri.export.write_operator(given.out, operator.model, points)]
        else:
            settings = given.out / "export.toml"
            operator = material.on(points, **asked)
            solved = warp_peri.solve(operator, warp_peri.Dirichlet(points, points.loads, points.u))
            with locked(given.out):
                paths = warp_peri.export.write_fields(
                    given.out, operator.model, points, solved.u, format=given.format
                )
    keep(given, settings)
    return {"files": [str(path) for path in paths]}


def run_sweep(given: argparse.Namespace) -> Result:
    """Algorithm 2 on a data file: sweep.json and the models, in a folder."""
    data = _dataset(given)
    sweep = warp_peri.methods.sweep(
        data[given.set],
        data[given.val],
        given.out,
        test=data[given.test] if given.test else None,
        noise=data[given.noise] if given.noise else None,
        horizons=given.horizons,
        degrees=given.degrees,
        conditions=given.conditions,
        jobs=given.jobs,
        progress=not given.json,
    )
    result: Result = {
        "fits": len(sweep.trials),
        "smallest_AvgE": dataclasses.asdict(sweep.printed),
        "cheapest": dataclasses.asdict(sweep.cheapest),
    }
    with locked(given.out):
        write_json(given.out / "sweep.json", result)
        keep(given, given.out / f"{given.command}.toml")
    return result


def run_info(given: argparse.Namespace) -> Result:
    """What a model or data file holds."""
    if given.file.suffix == ".json":
        material = load(given.file)
        given.told = repr(material)
        told: Any = getattr(material, "summary", None) or getattr(material, "rows", list)
        return dict(finite(plain(dict(told()))))
    data = load_dataset(given.file)
    return {
        "format": "data set",
        "units": list(data.units),
        "thickness": data.thickness,
        "density": data.density,
        "sets": {name: set_summary(data[name]) for name in data},
        "provenance": data.provenance,
    }


def set_summary(points: Samples) -> Result:
    """How many nodes, unknowns and samples a set has."""
    return {
        "samples": len(points),
        "nodes": len(points.x),
        "interior": int(points.interior.sum()),
        "spacing": points.spacing,
        "arrays": sorted(points.arrays),
    }


def lines_of(result: Result, indent: str = "") -> Sequence[str]:
    """A result as text, one number a line."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            lines += [f"{indent}{key}:", *lines_of(value, indent + "  ")]
        elif isinstance(value, float):
            lines.append(f"{indent}{key}: {value:.6g}")
        elif isinstance(value, list):
            shown = ", ".join(f"{v:.6g}" if isinstance(v, float) else str(v) for v in value)
            long = len(shown) > WIDTH and all(isinstance(v, str) for v in value)
            words = [f"{indent}{key}:", *(f"{indent}  {v}" for v in value)]
            lines += words if long else [f"{indent}{key}: {shown}"]
        else:
            lines.append(f"{indent}{key}: {value}")
    return lines
