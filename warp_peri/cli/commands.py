"""Commands that use a model, each with a result for JSON and lines to print; torch and Warp on
use."""

from __future__ import annotations

import dataclasses
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

import warp_peri
from warp_peri.errors import InputError
from warp_peri.files.atomic import finite, locked, plain, write_text
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.points.points import Samples
from warp_peri.points.unit_names import Units, symbols
from warp_peri.protocols import offered
from warp_peri.solvers.solution import CG, Coupling, Direct
from warp_peri.verbs import load

Result = dict[str, Any]
Said = tuple[Result, list[str]]
"""What a command answers: plain values, and the lines that people read."""

WIDTH = 100
"""Of a line: words that are longer stand one in a line."""
FAR = 5.0
"""Times that E_res is above E_u where a line says why."""
OF_DATA = ("method", "axis", "set", "transfer")
OF_BODY = ("hold", "pull", "spacing", "overlap", "units")
"""Options of the two kinds of problem that mean nothing to the other."""
LENGTHS = ("largest_displacement", "spacing", "horizon", "overlap")
"""Numbers with a unit of length, beside largest_principal_stress."""


def run_certify(given: Namespace) -> Said:
    """Certify a material's linear part by lattice, and tell up to which strain."""
    material = load(given.model)
    law = getattr(material, "linear", material)
    own: Sequence[Any] = [None]  # one for a lattice of its own knows which
    if hasattr(law, "trained_on"):
        own = law.trained_on if law.transferred_from is None else law.certified_on
    if not (given.spacing or own):
        raise InputError("spacing: the model names no training lattice; give --spacing")
    proofs = {}
    for spacing in given.spacing or own:
        proof = warp_peri.certify(law, spacing=spacing)
        figures = {"holds": proof.holds, **proof.figures()}
        if hasattr(material, "tq2"):
            unique = warp_peri.certificates.prove_uniqueness(material, spacing=proof.spacing)
            figures["nonlinear"] = unique.figures()
        proofs[f"{proof.spacing:g} {symbols(law.units)[0]}"] = figures
    return proofs, lines_of(proofs)


def data_for(given: Namespace, model: Any) -> Dataset:
    """Load data in the units of a model, with the axis of its crystal where one was typed."""
    offered(model, "on", given.command, "a material that is placed on nodes")
    data = load_dataset(given.data, units=model.units)
    if given.axis is None:
        return data
    turned = {}
    for name, samples in data.sets.items():
        points = dataclasses.replace(samples.points, axis=given.axis)
        turned[name] = dataclasses.replace(samples, points=points)
    return dataclasses.replace(data, sets=turned)


def run_evaluate(given: Namespace) -> Said:
    """Evaluate a model on the sets of a file."""
    model = load(given.model)
    data = data_for(given, model)
    tables: dict[str, Result] = {}
    for name in given.sets or data:
        try:
            found = warp_peri.evaluate(model, data[name], **options_of(given))
            each = {f"{key}_samples": one for key, one in found.pop("samples", {}).items()}
            tables[name] = finite(plain({"samples": len(data[name])} | found | each))
        except InputError as error:
            if given.sets:
                raise InputError(f"set '{name}': {error}") from None
            tables[name] = {"error": str(error)}
    return tables, error_table(tables, model.units)


def error_table(tables: Mapping[str, Result], units: Units) -> list[str]:
    """Lines of a table of errors, one for each set, and why they differ where they do."""
    absolute = "E_res_abs [{1}/{0}]".format(*symbols(units))
    width = max(map(len, tables))
    lines = [f"{'set':{width}}  samples   E_res [%]  {absolute:>17}   E_u [%]  E_shape [%]"]
    for name, table in tables.items():
        if "error" in table:
            lines.append(f"{name:{width}}  {table['error']}")
            continue
        shown = (table.get(key) for key in ("E_res", "E_u", "E_shape"))
        res, u, shape = ("–" if one is None else f"{100 * one:.3f}" for one in shown)
        left = "–" if table.get("E_res_abs") is None else f"{table['E_res_abs']:.3e}"
        count = f"{name:{width}}  {table['samples']:7d}"
        lines.append(f"{count}  {res:>10}  {left:>17}  {u:>8}  {shape:>11}")
    errors = {name: (one.get("E_res") or 0, one.get("E_u")) for name, one in tables.items()}
    if small := [name for name, (res, u) in errors.items() if u and res > FAR * u]:
        lines.append(
            f"note: the loads of {', '.join(small)} are small for their displacement, and E_res is "
            "relative to them; the error of a solve is E_u"
        )
    return lines


def problem_of(given: Namespace) -> tuple[Any, Dataset, Any]:
    """Load a model, the data in its units, and the problem of the set that was named."""
    model = load(given.model)
    data = data_for(given, model)
    points = data[given.set]
    return model, data, warp_peri.Dirichlet(points, points.loads, points.u)


def options_of(given: Namespace) -> Result:
    """Options of a solve that differ from the usual; materials without them know no default."""
    asked = chosen(given, "transfer", "allow_uncertified")
    return {name: value for name, value in asked.items() if value != (name == "transfer")}


def run_solve(given: Namespace) -> Said:
    """Solve for the displacement under the loads of a set, or of a body; writes a file."""
    if (given.body is None) == (given.data is None):
        raise InputError("data, body: expected one of DATA.h5 and --body MESH")
    if given.body is not None:
        return _solve_body(given)
    refuse_options(given, OF_BODY, "--body MESH, not a data file")
    model, data, problem = problem_of(given)
    points, solver = problem.points, solver_of(given.method, model)
    u = warp_peri.solve(model, problem, solver=solver, **options_of(given)).u
    provenance = {"source": "warp-peri solve", "model": given.model.name, "data": given.data.name}
    sets = {given.set: dataclasses.replace(points, u=u)}
    with locked(given.out):
        save_dataset(given.out, Dataset(sets, data.thickness, data.density, provenance))
        keep(given, given.out.with_suffix(".solve.toml"))
    size = np.linalg.norm(u[:, points.interior], axis=-1).max(axis=1, initial=0)
    result = {"file": str(given.out), "set": given.set, "largest_displacement": size.tolist()}
    return result, _with_units(result, data.units)


def solver_of(name: Any, material: Any) -> Any:
    """Solver settings by their name on the command line; nonlinear materials have one solver."""
    if name == "auto":
        return None
    if getattr(material, "linear", None) is not material:
        kind = type(material).__name__
        raise InputError(f"method: expected auto for a {kind}, which has one, got {name!r}")
    return Direct(name == "gmres") if name in ("lu", "gmres") else CG(name)


def _solve_body(given: Namespace) -> Said:
    """Solve for a body in equilibrium and write a VTU file of its mesh."""
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
        coupling=Coupling(**chosen(given, "spacing", "overlap")),
    )
    solution = warp_peri.solve(material, problem, **options_of(given)).details
    with locked(given.out):
        largest = warp_peri.export.write_body(given.out, solution)
        keep(given, given.out.with_suffix(".solve.toml"))
    result = {
        "file": str(given.out),
        **largest,
        "units": list(material.units),
        "spacing": solution.spacing,
        "horizon": solution.model.horizon,
        "lattice_nodes": 0 if solution.points is None else int(solution.points.interior.sum()),
        **chosen(solution.exchange, "exchanges", "mismatch", "rim_residual", "bulk_residual"),
        "overlap": solution.overlap,
    }
    return result, _with_units(result, material.units)


def refuse_options(given: Namespace, names: Sequence[str], whose: str) -> None:
    """Raise InputError for options that were set apart from their defaults and would do nothing."""
    if idle := [name for name in names if getattr(given, name) != given.usual[name]]:
        words = ", ".join("no-transfer" if name == "transfer" else name for name in idle)
        raise InputError(f"{words}: expected with {whose}")


def _vectors(option: str, words: Sequence[str]) -> dict[str, np.ndarray]:
    """Parse PART=a,b or PART=a,b,c to vectors by part of the outline; "-" is no number."""
    vectors: dict[str, np.ndarray] = {}
    for word in words:
        name, _, numbers = word.rpartition("=")
        try:
            vector = [np.nan if part == "-" else float(part) for part in numbers.split(",")]
        except ValueError:
            vector = []
        if not name or len(vector) not in (2, 3):
            raise InputError(
                f"{option}: expected PART=number,number (,number in space), got {word!r}"
            )
        if name in vectors:
            raise InputError(f"{option}: expected each part once, got {name!r} twice")
        vectors[name] = np.array(vector)
    return vectors


def run_predict(given: Namespace) -> Said:
    """Predict displacement under the loads of a set, each with its likely error."""
    model, _, problem = problem_of(given)
    answers: Any = warp_peri.predict(model, problem, given.tolerance or None, **options_of(given))
    points, samples = problem.points, []
    for answer, truth in zip(answers, points.u[:, points.interior]):
        told = chosen(answer, "error", "parts", "kept", "why", "uncovered")
        if size := float(np.linalg.norm(truth)):  # the set holds what was measured or computed
            told["true"] = float(np.linalg.norm(answer.u[points.interior] - truth)) / size
        samples.append(told)
    result = {"set": given.set, "tolerance": given.tolerance or None, "samples": samples}
    return result, lines_of(result)


def run_export(given: Namespace) -> Said:
    """Write the solved fields of a set for ParaView."""
    model, _, problem = problem_of(given)
    solved = warp_peri.solve(model, problem, **options_of(given))
    with locked(given.out):
        paths = warp_peri.export.write_vtk(given.out, model, problem.points, solved.u)
    keep(given, given.out / "export.toml")
    result = {"files": [str(path) for path in paths]}
    return result, lines_of(result)


def run_info(given: Namespace) -> Said:
    """Describe a model, a data file or a mesh."""
    held: Any = load(given.file)
    if isinstance(held, Dataset):
        sets = {name: set_summary(one) for name, one in held.sets.items()}
        result: Result = {"format": "data set", "units": list(held.units)}
        result |= chosen(held, "thickness", "density") | {"sets": sets}
        result["provenance"] = held.provenance
        return result, lines_of(result | dict(held.rows()[:2]))
    if hasattr(held, "cells"):
        low, high = held.x.min(axis=0), held.x.max(axis=0)
        result = {
            "format": "mesh",
            "corners": len(held.x),
            "triangles" if len(low) == 2 else "tetrahedra": len(held.cells),
            "box": np.stack([low, high], axis=1).tolist(),
            "parts": {name: len(faces) for name, faces in held.parts.items()},
        }
        return result, lines_of(result)
    told: Any = getattr(held, "summary", None) or getattr(held, "rows", list)
    return dict(finite(plain(dict(told())))), repr(held).split("\n")


def set_summary(points: Samples) -> Result:
    """Count the nodes, unknowns and samples of a set."""
    return {
        "samples": len(points),
        "nodes": len(points.x),
        "interior": int(points.interior.sum()),
        "spacing": points.spacing,
        "arrays": sorted(points.arrays),
    }


def chosen(given: Any, *names: str) -> Result:
    """Pick the named options, or attributes of any object, into a dict."""
    return {name: getattr(given, name) for name in names}


def keep(given: Namespace, path: Path) -> None:
    """Write the settings of a command for `--config`; a file of that option is left alone."""
    if given.config is None or not (path.exists() and path.samefile(given.config)):
        write_text(path, settings_of(given))


def settings_of(given: Namespace) -> str:
    """Write the options of a command as TOML."""

    def plainly(value: Any) -> Any:
        if isinstance(value, list):
            return [*map(plainly, value)]
        return str(value) if isinstance(value, Path) else value

    table = chosen(given, *given.options).items()
    return tomli_w.dumps({given.command: {n: plainly(v) for n, v in table if v is not None}})


def _with_units(result: Result, units: Units) -> list[str]:
    """Lines of a result with units; JSON has these apart."""
    length, stress = symbols(units)
    unit = dict.fromkeys(LENGTHS, length) | {"largest_principal_stress": stress}
    return lines_of({f"{k} [{unit[k]}]" if k in unit else k: v for k, v in result.items()})


def lines_of(result: Result, indent: str = "") -> list[str]:
    """Lines of a result as text, one number each."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            lines += [f"{indent}{key}:", *lines_of(value, indent + "  ")]
            continue
        every = value if isinstance(value, list) else [value]
        shown = ", ".join(f"{v:.6g}" if isinstance(v, float) else str(v) for v in every)
        if len(every) > 1 and len(shown) > WIDTH and all(isinstance(v, str) for v in every):
            lines += [f"{indent}{key}:", *(f"{indent}  {v}" for v in every)]
        else:
            lines.append(f"{indent}{key}: {shown}")
    return lines
