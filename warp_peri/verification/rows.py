"""Rows of the verification: how they are read, measured and told; rows.toml says what they are."""

from __future__ import annotations

import csv
import io
import json
import multiprocessing
import subprocess
import sys
import time
import tomllib
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.launch import set_threads
from warp_peri.verification import cracks, motion, statics
from warp_peri.verification.statics import Outcome, UnitScale

Line = dict[str, Any]
SAME = 1e-6
"""Relative; by how much an answer may change with units and with the size of the moduli."""
SCALES = UnitScale("mm", 1e6), UnitScale("angstrom", 1e-6)
"""That are compared with metres."""

COLUMNS = (
    *("problem", "material", "reference", "source", "answer", "error", "allowed", "order"),
    *("least", "scaled", "seconds", "holds", "note"),
)
"""Of the rows as data."""


@dataclass(frozen=True)
class Row:
    """One problem of one material, as rows.toml says.

    `why` says why it does not apply, `misses` why it does not hold.
    """

    problem: str
    material: str
    source: str
    allowed: float
    run: partial[Outcome]
    reference: float = 0.0
    least: float | None = None
    quick: bool = False
    why: str = ""
    misses: str = ""

    @property
    def name(self) -> str:
        """Of problem and material."""
        return f"{self.problem}: {self.material}"

    @property
    def words(self) -> str:
        """It is chosen by: its name, and statics, cracks or motion."""
        return f"{self.run.func.__module__.split('.')[-1]} {self.name}".lower()


POSED = vars(statics) | vars(cracks) | vars(motion)
"""Functions that pose problems, by name."""


def _read() -> list[Row]:
    """Each problem with each material, posed or with the reason why not."""
    told, rows = tomllib.loads(Path(__file__).with_name("rows.toml").read_text("utf-8")), []
    for one in told["row"]:
        posed, why = one.pop("materials"), told["unposed"][one.pop("kind")]
        if (needed := one.pop("needs", "")) and find_spec(needed) is None:
            posed, why = [], why | dict.fromkeys(posed, f"{needed} is not installed")
        why = told["besides"] | why
        why, pose, how = why | one.pop("without", {}), POSED[one.pop("run")], one.pop("with", {})
        limits = one.pop("misses", {})
        for name in told["materials"]:
            said = {"material": name, "why": "" if name in posed else why[name]}
            said["misses"] = limits.get(name, "")
            rows.append(Row(run=partial(pose, name, **how), **said, **one))
    return rows


ROWS = _read()
"""All rows, in their order."""


def chosen(only: Sequence[str] = ()) -> list[Row]:
    """Rows whose names hold one of some words, or of statics, cracks, motion; all without any.

    Raises InputError for a word that no name holds, or an empty one.
    """
    wanted = [word.lower() for word in only]
    for word, lower in zip(only, wanted):
        if not word.strip() or not any(lower in one.words for one in ROWS):
            known = ", ".join(dict.fromkeys(one.problem for one in ROWS))
            raise InputError(f"only: expected a part of a row's name, got {word!r}; {known}")
    return [one for one in ROWS if not only or any(word in one.words for word in wanted)]


def measured(one: Row, *, scaled: bool = False, out: Path | None = None) -> Line:
    """A row's line: its answer, error and order, seconds, and whether it holds.

    Args:
        one: the row.
        scaled: pose it in other units and with other moduli too.
        out: folder for a picture.
    """
    told = ("name", "problem", "material", "reference", "source", "allowed", "least")
    line: Line = {name: getattr(one, name) for name in told}
    line |= {"answer": None, "error": None, "order": None, "scaled": None, "seconds": 0.0}
    if one.why:
        return line | {"holds": None, "note": f"does not apply, because {one.why}"}
    begin, size = time.perf_counter(), abs(one.reference) or 1.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of thin bodies, whose note says it
            found = one.run(UnitScale())
            others = [one.run(scale).value for scale in SCALES] if scaled else []
    except InputError as refusal:
        return line | {"holds": False, "note": str(refusal)}
    values = found.value, *others
    if not np.isfinite(values).all():  # which JSON has no word for
        return line | {"holds": False, "note": found.note or "its answer is no number"}
    error, *elsewhere = (abs(value - one.reference) / size for value in values)
    holds = max(error, *elsewhere, 0.0) <= one.allowed
    holds = holds and (one.least is None or (found.order or 0.0) >= one.least)
    if scaled:
        line["scaled"] = float(max(abs(other - found.value) / size for other in others))
        holds = holds and line["scaled"] <= SAME
    if out is not None and found.x is not None:
        draw(one, found, out)
    line |= {"answer": float(found.value), "error": float(error), "order": found.order}
    line["seconds"] = round(time.perf_counter() - begin, 2)
    return line | {"holds": bool(holds), "note": found.note if holds else one.misses or found.note}


def _numbered(number: int, scaled: bool, out: Path | None) -> Line:
    return measured(ROWS[number], scaled=scaled, out=out)


def verified(
    only: Sequence[str] = (), *, scaled: bool = False, out: Path | None = None, processes: int = 2
) -> list[Line]:
    """Lines of the rows that are chosen, in their order, by some processes at once.

    Args:
        only: parts of names, as of `chosen`.
        scaled: as of `measured`.
        out: folder for pictures, and for the lines as verification.json.
        processes: that share the rows.

    A row whose process is killed does not hold; others go on, one at a time.

    Raises InputError as `chosen`, and for less than one process.
    """
    rows = chosen(only)
    if processes < 1:
        raise InputError(f"processes: expected at least 1, got {processes}")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Line] = {}
    spawn = multiprocessing.get_context("spawn")
    others = multiprocessing.active_children()
    while left := [one for one in rows if one.name not in found]:
        with ProcessPoolExecutor(processes, spawn, set_threads, (1,)) as pool:
            jobs = [pool.submit(_numbered, ROWS.index(one), scaled, out) for one in left]
            try:
                for done in as_completed(jobs):
                    if isinstance(done.exception(), BrokenProcessPool):
                        continue  # some process was killed, and rows that were done may follow
                    line = done.result()
                    found[line["name"]] = line
                    told = f"{len(found)} of {len(rows)}  {line['name']}"
                    print(f"\r\033[K{told}", end="", file=sys.stderr)
            except BaseException:  # nobody waits for rows that take minutes
                pool.shutdown(wait=False, cancel_futures=True)
                for process in set(multiprocessing.active_children()) - set(others):
                    process.terminate()
                raise
        lost = [one for one in left if one.name not in found]
        if lost and processes == 1:  # the first of them was at work
            note = {"holds": False, "note": "its process was killed before it had an answer"}
            found[lost[0].name] = measured(replace(lost[0], why="unposed")) | note
        processes = 1  # which of several was killed, nobody says
    print("\r\033[K", end="", file=sys.stderr, flush=True)
    lines = [found[one.name] for one in rows]
    if out is not None:
        (out / "verification.json").write_text(json.dumps({"rows": lines}, indent=1))
    return lines


CHECKOUT = Path(__file__).parents[2]
"""Of which tools and examples are a part, where this is one."""
FRESH = {"sheet_2": "sheet of atoms", "disk_2": "disk of atoms", "L_2": "L of a disk of atoms"}
"""Sets of tools/make_scenes.py at bond strains up to 2 %."""


def by_atoms(seed: int, model: Path | None = None) -> list[Line]:
    """Lines of a learned law of graphene on loads that LAMMPS solves now; six a set (E_u).

    Allowed is what local elasticity with the true moduli is off by.

    Args:
        seed: of the loads.
        model: its file; by default what the first command of the checkout learned.

    Raises InputError outside a checkout, without the model, and for what its programs refuse.
    """
    model = model or CHECKOUT / "runs" / "graphene_0K" / "model.json"
    programs = CHECKOUT / "tools" / "make_scenes.py", CHECKOUT / "examples" / "local_elasticity.py"
    for needed in (*programs, model):
        if not needed.is_file():
            raise InputError(
                f"atoms: expected a checkout and a model of its first command, got no {needed}"
            )
    if seed < 0:
        raise InputError(f"seed: expected a number of at least 0, got {seed}")
    with TemporaryDirectory() as folder:
        data = f"{folder}/atoms.h5"
        make = ["--seed", str(seed), "--strains", "0.02", "--quiet", "--out", data]
        told = ["--data", data, "--model", str(model), "--json", "--sets", *FRESH]
        for program, words in zip(programs, (make, told)):
            job = [sys.executable, str(program), *words]
            done = subprocess.run(job, cwd=CHECKOUT, capture_output=True, text=True)
            if done.returncode:
                raise InputError(f"atoms: {program.name}: {done.stderr.strip()[-300:]}")
    law, own, true = json.loads(done.stdout.splitlines()[-1]).values()
    lines = []
    for name, problem in FRESH.items():
        line: Line = dict.fromkeys(COLUMNS) | {"problem": problem, "material": model.stem}
        line |= {"name": f"{problem}: {model.stem}", "reference": 0.0, "seconds": 0.0}
        line |= {"answer": law[name], "error": law[name], "allowed": true[name]}
        line["source"] = f"LAMMPS, loads of seed {seed}; allowed: local elasticity, true moduli"
        note = f"local elasticity with the moduli of the model is off by {100 * own[name]:.2g} %"
        lines.append(line | {"holds": law[name] <= true[name], "note": note})
    return lines


def numbered(lines: Sequence[Line]) -> dict[str, int]:
    """Sources of rows, each with its number."""
    return {source: n for n, source in enumerate(dict.fromkeys(o["source"] for o in lines), 1)}


def table(lines: Sequence[Line], sources: dict[str, int] | None = None) -> str:
    """Rows as Markdown, and why one does not hold beside it; with notes and sources where no
    numbers of sources are given."""
    names = "problem", "material", "reference", "answer", "error", "allowed", "order", "s", "holds"
    words = [f"| {' | '.join((*names, 'why'))} |", "|" + "---|" * 10]
    posed = [line for line in lines if line["holds"] is not None]
    numbers = sources or numbered(posed)
    for line in posed:
        answer = "–" if line["answer"] is None else f"{line['answer']:.5g}"
        order = "" if line["order"] is None else f"{line['order']:.1f}"
        order += "" if line["least"] is None else f" (≥ {line['least']:g})"
        told = f"{line['reference']:.5g} [{numbers[line['source']]}]"
        cells = [line["problem"], line["material"], told, answer]
        cells += [_percent(line, name, " %") for name in ("error", "allowed")]
        holds = ("yes", "") if line["holds"] else ("**does not hold**", line["note"])
        cells += [order, f"{line['seconds']:.1f}", *holds]
        words.append(f"| {' | '.join(cells)} |")
    if sources is not None:
        return "\n".join(words)
    words += ["", "References:", "", listed(numbers)]
    by_note = dict[str, list[str]]()
    for line in (line for line in lines if line["note"] and line["holds"] is not False):
        by_note.setdefault(line["note"], []).append(line["name"])
    notes = [f"- {note}: {'; '.join(names)}." for note, names in by_note.items()]
    return "\n".join(words + (["", "Notes:", "", *notes] if notes else []))


def listed(sources: dict[str, int]) -> str:
    """Sources as a list in Markdown."""
    return "\n".join(f"{n}. {source}." for source, n in sources.items())


def by_material(lines: Sequence[Line]) -> str:
    """Materials × problems as Markdown: error in %, or a dash where it does not apply."""
    names, numbers = list(dict.fromkeys(line["material"] for line in lines)), numbered(lines)
    words = [f"| |{'|'.join(names)}|", "|" + "---|" * (len(names) + 1)]
    for problem in dict.fromkeys(line["problem"] for line in lines):
        cells = dict.fromkeys(names, "")
        for line in (line for line in lines if line["problem"] == problem):
            shown, head = _percent(line, "error"), f"{problem} [{numbers[line['source']]}]"
            cells[line["material"]] = {None: "–", True: shown}.get(line["holds"], f"**{shown}**")
        words.append(f"|{head}|{'|'.join(cells.values())}|")
    return "\n".join(words)


def _percent(line: Line, name: str, unit: str = "") -> str:
    """A relative error in %."""
    return "refused" if line[name] is None else f"{100 * line[name]:.2g}{unit}"


def page(lines: Sequence[Line], data: str = "verification.csv") -> str:
    """The page of the documentation: its words, of rows.md, around what was measured.

    Args:
        lines: of the rows, as `verified` gives them.
        data: name of the file beside the page that holds what `as_csv` gives.
    """
    posed = [line for line in lines if line["holds"] is not None]
    held = f"{sum(line['holds'] for line in posed)} of {len(posed)} rows hold"
    numbers = numbered(lines)
    missed = table([line for line in posed if not line["holds"]], numbers)
    told = {"held": held, "data": data, "materials": by_material(lines), "rows": missed}
    told["references"] = listed(numbers)
    return Path(__file__).with_name("rows.md").read_text("utf-8").format(**told)


def as_csv(lines: Sequence[Line]) -> str:
    """All lines as comma-separated values, numbers in full."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def draw(one: Row, found: Outcome, out: Path) -> None:
    """A picture of an answer: over time, or in the plane, of the nodes nearest to the viewer."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 4), layout="constrained")
    ax, x, shown = figure.add_subplot(), np.asarray(found.x), np.asarray(found.shown)
    most, quantity = np.argmax(shown), found.label.split(" [")[0]
    if x.ndim == 1:
        where = f"{x[most] / x.max():.2g}"
        ax.plot(x / x.max(), shown, lw=1)
        ax.set(xlabel="time over that of the run", ylabel=found.label)
    else:
        low, high = x[:, :2].min(axis=0), x[:, :2].max(axis=0)
        front = x[:, 2] >= np.quantile(x[:, 2], 0.8) if x.shape[1] == 3 else np.ones(len(x), bool)
        axes = [np.linspace(a, b, 400) for a, b in zip(low, high)]
        places = np.stack(np.meshgrid(*axes), axis=-1)
        tree = cKDTree(x[front, :2])
        away, at = tree.query(places)
        apart = tree.query(x[front, :2], 4)[0][:, -1]
        values = np.where(away < apart[at], shown[front][at], np.nan)
        limits = dict(zip(("vmin", "vmax"), np.quantile(shown, (0.002, 0.998))))
        box: Any = (low[0], high[0], low[1], high[1])
        drawn = ax.imshow(values, origin="lower", extent=box, **limits)
        where = f"x = {x[most, 0]:.3g}, y = {x[most, 1]:.3g} m"
        ax.set(xlabel="x [m]", ylabel="y [m]")
        figure.colorbar(drawn, ax=ax, label=found.label)
    ax.set_title(f"{one.name}:\n{quantity} is largest at {where}", fontsize="medium")
    name = "".join(c if c.isalnum() else "_" for c in one.name.lower())
    figure.savefig(out / f"{name}.png", dpi=110)
