"""Commands that use a model, each with a result for JSON and lines to print; torch, Warp on use."""

from __future__ import annotations

import dataclasses
import os
import shlex
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from numpy.linalg import norm

import warp_peri
from warp_peri.cli import main
from warp_peri.cli.main import BEGUN, HASH, MADE, check_output, hashes, lines_in, parse, results
from warp_peri.errors import InputError, Values, warn
from warp_peri.files.atomic import finite, locked, plain, write_text
from warp_peri.points.arguments import Units, offered, symbols
from warp_peri.points.dataset import Dataset, load_dataset, save_dataset
from warp_peri.verbs import load

Said = tuple[Values, list[str]]
"""What a command answers: plain values, and the lines that people read."""

OF_SOLVES = "transfer", "allow_uncertified"
"""Options of all that solve."""
WIDTH = 100
"""Of a line: words that are longer stand one in a line."""


def run_certify(given: Namespace) -> Said:
    """Certify a material's linear part by lattice, and tell up to which strain."""
    material = load(given.model)
    law = getattr(material, "linear", material)
    spacings = given.spacing or [None]  # one for a lattice of its own knows which
    if hasattr(law, "trained_on") and not given.spacing:
        spacings = law.trained_on if law.transferred_from is None else law.certified_on
    if not spacings:
        raise InputError("spacing: the model names no training lattice; give --spacing")
    proofs = {}
    for spacing in spacings:
        proof = warp_peri.certify(law, spacing=spacing)
        figures = {"holds": proof.holds, **proof.figures()}
        if hasattr(material, "tq2"):
            unique = warp_peri.certificates.prove_uniqueness(material, spacing=proof.spacing)
            figures["nonlinear"] = unique.figures()
        proofs[f"{proof.spacing:g} {symbols(law.units)[0]}"] = figures
    return proofs, lines_of(proofs)


def loaded(given: Namespace) -> tuple[Any, Dataset]:
    """Load a model, and data in its units."""
    model = load(given.model)
    offered(model, "on", given.command, "a material that is placed on nodes")
    return model, load_dataset(given.data, units=model.units)


def run_evaluate(given: Namespace) -> Said:
    """Evaluate a model on the sets of a file."""
    model, data = loaded(given)
    tables = {}
    for name in given.sets or data:
        try:
            found = warp_peri.evaluate(model, data[name], **chosen(given, *OF_SOLVES))
            tables[name] = finite({"samples": len(data[name])} | found)
        except InputError as error:
            if given.sets:
                raise InputError(f"set '{name}': {error}") from None
            tables[name] = {"error": str(error)}
    return tables, error_table(tables, model.units)


def error_table(tables: Mapping[str, Values], units: Units) -> list[str]:
    """Lines of a table of errors, one for each set."""
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
    return lines


def problem_of(given: Namespace) -> tuple[Any, Dataset, Any]:
    """Load a model, the data in its units, and the problem of the set that was named."""
    model, data = loaded(given)
    points = data[given.set]
    if points.interior.all():
        return model, data, warp_peri.Periodic(points.points, points.loads)
    return model, data, warp_peri.Dirichlet(points, points.loads, points.u)


@contextmanager
def writing(given: Namespace) -> Iterator[Callable[[], None]]:
    """Hold what a command writes against other jobs, which may have written it meanwhile; what is
    yielded is called before the first file. What an earlier run left is told, and not vouched for.
    """

    def states() -> Values:
        # a file that is replaced has another number, or time
        return {path: os.stat(path)[1::7] for path in results(given)[1]}

    with locked(given.out):
        check_output(given)
        kept, old = results(given)[0], states()
        said = lines_in(kept)
        try:
            yield lambda: keep(given, kept, BEGUN)
        except BaseException:
            if states() == old and lines_in(kept):  # nothing was written
                write_text(kept, "\n".join(said)) if said else kept.unlink()
            raise
        made = states()
        for path in [path for path in made if old.get(path) == made[path]]:
            warn(f"{path}: is of an earlier run, and stays")
            del made[path]
        keep(given, kept, dict.fromkeys(made, ""))


def run_solve(given: Namespace) -> Said:
    """Solve for the displacement under the loads of a set; writes a data file."""
    model, data, problem = problem_of(given)
    points = data[given.set]
    provenance = {"source": "warp-peri solve", "model": given.model.name, "data": given.data.name}
    u = warp_peri.solve(model, problem, **chosen(given, *OF_SOLVES)).u
    sets = {given.set: dataclasses.replace(points, u=u)}
    with writing(given) as begin:
        begin()
        save_dataset(given.out, Dataset(sets, data.thickness, data.density, provenance))
    size = norm(u[:, points.interior], axis=-1).max(axis=1, initial=0).tolist()
    result, key = {"file": str(given.out), "set": given.set}, "largest_displacement"
    return result | {key: size}, lines_of(result | {f"{key} [{symbols(data.units)[0]}]": size})


def run_predict(given: Namespace) -> Said:
    """Predict displacement under the loads of a set, each with its likely error."""
    model, _, problem = problem_of(given)
    tolerance = given.tolerance or None
    answers: Any = warp_peri.predict(model, problem, tolerance, **chosen(given, *OF_SOLVES))
    points, samples = problem.points, []
    for answer, truth in zip(answers, points.u[:, points.interior]):
        told = chosen(answer, "error", "parts", "kept", "why", "uncovered")
        if size := float(norm(truth)):  # the set holds what was measured or computed
            told["true"] = float(norm(answer.u[points.interior] - truth)) / size
        samples.append(told)
    result = plain({"set": given.set, "tolerance": tolerance, "samples": samples})
    return result, lines_of(result)


def run_export(given: Namespace) -> Said:
    """Write the solved fields of a set for ParaView."""
    model, _, problem = problem_of(given)
    found = warp_peri.solve(model, problem, **chosen(given, *OF_SOLVES))
    with writing(given) as begin:
        begin()
        paths = warp_peri.export.write_vtk(given.out, found.operator, problem.points, found.u)
    result = {"files": [*map(str, paths)]}
    return result, lines_of(result)


def run_info(given: Namespace) -> Said:
    """Describe a model, a data file or a mesh."""
    held = load(given.file)
    told = getattr(held, "summary", None) or held.rows
    return finite(dict(told())), repr(held).split("\n")


def chosen(given: Any, *names: str) -> Values:
    """Pick the named options, or attributes of any object, into a dict."""
    return {name: getattr(given, name) for name in names}


def keep(given: Namespace, path: Path, made: Mapping[str, str]) -> None:
    """Write the words of a command, a line each, which `@FILE` stands for, and hashes of what it
    wrote, or BEGUN; words of the same options, or that no command wrote, are left alone."""
    if path.exists() and not lines_in(path):
        return None if made is BEGUN else warn(f"{path}: is no file of a command, and stays")
    lines, marks = [MADE, *map(shlex.quote, given.words), ""], hashes(given, path, made)
    with suppress(InputError):  # there are none, or they are changed to what is no words
        if marks[0] == hashes(parse([given.command, f"@{path}"]), path, {})[0]:
            lines = [line for line in lines_in(path) if not line.startswith(HASH)]
    write_text(path, "\n".join([lines[0], *marks, *lines[1:]]))


def lines_of(result: Values, indent: str = "") -> list[str]:
    """Lines of a result as text, one number each."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            lines += [f"{indent}{key}:", *lines_of(value, indent + "  ")]
            continue
        every = main.as_list(value)
        shown = ", ".join(f"{v:.6g}" if isinstance(v, float) else str(v) for v in every)
        if len(every) > 1 and len(shown) > WIDTH and all(isinstance(v, str) for v in every):
            lines += [f"{indent}{key}:", *(f"{indent}  {v}" for v in every)]
        else:
            lines.append(f"{indent}{key}: {shown}")
    return lines
