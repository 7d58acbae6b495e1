"""What each command does: from files to files, and a result that prints as JSON or as lines.

What needs torch or Warp is reached through the package, which imports it on first use: `--help` and
`info` do without.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

import warp_peri
from warp_peri.cli.inputs import data_for
from warp_peri.cli.learn import run_dic as run_dic
from warp_peri.cli.learn import run_learn as run_learn
from warp_peri.cli.settings_file import keep
from warp_peri.cli.train import in_percent as in_percent
from warp_peri.cli.train import run_coarse_grain as run_coarse_grain
from warp_peri.cli.train import run_sweep as run_sweep
from warp_peri.cli.train import run_train as run_train
from warp_peri.errors import InputError
from warp_peri.files.atomic import destination, finite, locked, plain
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import Units, symbols
from warp_peri.solvers.solution import Coupling, Direct, Krylov
from warp_peri.storage import load

Result = dict[str, Any]

WIDTH = 100
"""Of a line: words that are longer stand one in a line."""
OF_DATA: dict[str, Any] = {"method": "auto", "axis": None, "set": "test", "transfer": True}
OF_BODY: dict[str, Any] = {"hold": [], "pull": [], "spacing": None, "overlap": None, "units": None}
"""Options of the two kinds of problem that mean nothing to the other, and their defaults."""


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
    folder = given.command in ("train", "learn", "dic", "export", "sweep")
    if given.out.exists() and given.out.is_dir() != folder:
        wanted, there = ("folder", "file") if folder else ("file", "folder")
        raise InputError(f"out: expected a {wanted}, {given.out} is a {there}")
    if not folder:
        destination(given.out)


def run_certify(given: argparse.Namespace) -> Result:
    """The certificate of a model on a lattice."""
    material = load(given.model)
    if hasattr(material, "tq2"):  # of third order, whose module the help does not load
        found = proven_on_its_nodes(material.linear, given.spacing)
        (proof,) = found.values()
        unique = warp_peri.proofs.uniqueness(material, spacing=material.spacing)
        proof["nonlinear"] = unique.figures()
        return found
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
    return proven


def proven_on_its_nodes(law: Any, spacings: Sequence[float] | None = None) -> Result:
    """The certificate of a law that has one lattice alone, computed where the file has none.

    Raises InputError where another spacing is asked for.
    """
    if spacings:
        raise InputError(f"spacing: this model is for nodes {law.spacing:g} apart alone")
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
            found = warp_peri.evaluate(
                model, points, transfer=given.transfer, allow_uncertified=given.allow_uncertified
            )
            each = {f"{key}_samples": one for key, one in found.pop("samples", {}).items()}
            tables[name] = finite(plain({"samples": len(points)} | found | each))
        except InputError as error:
            if given.sets:
                raise InputError(f"set '{name}': {error}") from None
            tables[name] = {"error": str(error)}
    return tables


def run_solve(given: argparse.Namespace) -> Result:
    """Displacement under the loads of a set, or of a body with an outline, in a file."""
    if given.body is not None or given.data is None:
        return run_solve_body(given)
    refuse_options(given, OF_BODY, "--body MESH, not a data file")
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
    result = {"file": str(given.out), "set": given.set, "largest_displacement": size.tolist()}
    return with_units(given, result, data.units)


def run_solve_body(given: argparse.Namespace) -> dict[str, Any]:
    """A body in equilibrium: a VTU file of its mesh.

    Raises InputError for a data file beside the body, or neither, options of a data file, a
    material that bodies are not of, and another ending than .vtu.
    """
    if given.body is None or given.data is not None:
        raise InputError("data, body: expected one of DATA.h5 and --body MESH")
    refuse_options(given, OF_DATA, "loads of a data file, not of a body")
    if given.out.suffix != ".vtu":
        raise InputError(f"out: expected a .vtu file for a body, got {given.out.name}")
    material = load(given.model)
    if given.units is not None:
        material = material.in_units(tuple(given.units))
    problem = warp_peri.Body(
        load(given.body),
        _vectors("hold", given.hold),
        _vectors("pull", given.pull),
        coupling=Coupling(spacing=given.spacing, overlap=given.overlap),
    )
    asked: dict[str, Any] = {"allow_uncertified": True} if given.allow_uncertified else {}
    solution = warp_peri.solve(material, problem, **asked).details
    with locked(given.out):
        largest = warp_peri.export.write_body(given.out, solution)
        keep(given, given.out.with_suffix(".solve.toml"))
    exchange = solution.exchange
    result = {
        "file": str(given.out),
        **largest,
        "units": list(material.units),
        "spacing": solution.spacing,
        "horizon": solution.model.horizon,
        "lattice_nodes": 0 if solution.points is None else int(solution.points.interior.sum()),
        "exchanges": exchange.exchanges,
        "mismatch": exchange.mismatch,
        "rim_residual": exchange.rim_residual,
        "bulk_residual": exchange.bulk_residual,
        "overlap": solution.overlap,
    }
    return with_units(given, result, material.units)


def refuse_options(given: argparse.Namespace, of: dict[str, Any], whose: str) -> None:
    """InputError for options that are set, apart from their defaults, and would do nothing."""
    if idle := [name for name, default in of.items() if getattr(given, name) != default]:
        words = ", ".join("no-transfer" if name == "transfer" else name for name in idle)
        raise InputError(f"{words}: expected with {whose}")


def _vectors(option: str, words: Sequence[str]) -> dict[str, np.ndarray]:
    """PART=a,b or PART=a,b,c as vectors by part; "-" is no number."""
    vectors: dict[str, np.ndarray] = {}
    for word in words:
        name, _, numbers = word.rpartition("=")
        try:
            pair = [np.nan if part == "-" else float(part) for part in numbers.split(",")]
        except ValueError:
            pair = []
        if not name or len(pair) not in (2, 3):
            raise InputError(
                f"{option}: expected PART=number,number (,number in space), got {word!r}"
            )
        if name in vectors:
            raise InputError(f"{option}: expected each part once, got {name!r} twice")
        vectors[name] = np.array(pair)
    return vectors


def run_predict(given: argparse.Namespace) -> dict[str, Any]:
    """Displacement under the loads of a set, each with its likely error."""
    model = load(given.model)
    points = data_for(given, model)[given.set]
    asked = {"transfer": given.transfer, "allow_uncertified": given.allow_uncertified}
    options = {name: value for name, value in asked.items() if value != (name == "transfer")}
    problem = warp_peri.Dirichlet(points, points.loads, points.u)
    answers: Any = warp_peri.predict(model, problem, given.tolerance or None, **options)
    samples = []
    for answer, truth in zip(answers, points.u[:, points.interior]):
        told = {n: getattr(answer, n) for n in ("error", "parts", "kept", "why", "uncovered")}
        told["local_solid"] = answer.local if answer.operator else None
        if size := float(np.linalg.norm(truth)):  # the set holds what was measured or computed
            wrong = answer.u[points.interior] - truth
            told["true"] = float(np.linalg.norm(wrong)) / size
        samples.append(told)
    return {"set": given.set, "tolerance": given.tolerance or None, "samples": samples}


def linear_of(material: Any) -> Any:
    """The linear solid of a material; InputError for a law that has none."""
    if not warp_peri.export.is_linear_solid(material):
        raise InputError(
            "model: expected a solid with a linear part, a Model, got "
            f"{type(getattr(material, 'linear', material)).__name__}"
        )
    return material.linear


def _solver(name: str, material: Any) -> Any:
    """Settings of a solver by the name they have on the command line; nonlinear laws have one."""
    if name == "auto":
        return None
    if not hasattr(material, "linear") or material.linear is not material:
        kind = type(material).__name__
        raise InputError(f"method: expected auto for a {kind}, which has one, got {name!r}")
    return Direct(name == "gmres") if name in ("lu", "gmres") else Krylov(name)


def run_export(given: argparse.Namespace) -> Result:
    """The solved fields of a set for ParaView."""
    material = load(given.model)
    points = data_for(given, material)[given.set]
    asked: dict[str, bool] = {}
    if warp_peri.export.is_linear_solid(material):  # other laws are of one lattice
        asked = {"transfer": given.transfer, "allow_uncertified": given.allow_uncertified}
    operator = material.on(points, **asked)
    solved = warp_peri.solve(operator, warp_peri.Dirichlet(points, points.loads, points.u))
    with locked(given.out):
        paths = warp_peri.export.write_fields(given.out, operator.model, points, solved.u)
    keep(given, given.out / "export.toml")
    return {"files": [str(path) for path in paths]}


def run_info(given: argparse.Namespace) -> Result:
    """What a model, a data file or a mesh holds."""
    if given.file.suffix == ".json":
        material = load(given.file)
        given.told = repr(material)
        told: Any = getattr(material, "summary", None) or getattr(material, "rows", list)
        return dict(finite(plain(dict(told()))))
    if given.file.suffix not in (".h5", ".hdf5"):
        body = load(given.file)
        if not isinstance(body, Dataset):
            low, high = body.x.min(axis=0), body.x.max(axis=0)
            return {
                "format": "mesh",
                "corners": len(body.x),
                "triangles" if len(low) == 2 else "tetrahedra": len(body.cells),
                "box": [[float(a), float(b)] for a, b in zip(low, high)],
                "parts": {name: len(faces) for name, faces in body.parts.items()},
            }
    data = load_dataset(given.file)
    result: Result = {
        "format": "data set",
        "units": list(data.units),
        "thickness": data.thickness,
        "density": data.density,
        "sets": {name: set_summary(data[name]) for name in data},
        "provenance": data.provenance,
    }
    given.told = "\n".join(lines_of(result | dict(data.rows()[:2])))
    return result


def set_summary(points: Samples) -> Result:
    """How many nodes, unknowns and samples a set has."""
    return {
        "samples": len(points),
        "nodes": len(points.x),
        "interior": int(points.interior.sum()),
        "spacing": points.spacing,
        "arrays": sorted(points.arrays),
    }


UNITS = {"largest_principal_stress": 1}
UNITS |= dict.fromkeys(("largest_displacement", "spacing", "horizon", "overlap"), 0)
"""Numbers with a unit: 0 that of length, 1 that of stress."""


def with_units(given: argparse.Namespace, result: Result, units: Units) -> Result:
    """The result, whose numbers are told with their units; JSON names these apart."""
    named = symbols(units)
    shown = {f"{k} [{named[UNITS[k]]}]" if k in UNITS else k: v for k, v in result.items()}
    given.told = "\n".join(lines_of(shown))
    return result


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
