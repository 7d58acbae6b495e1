"""Rows of the known problems, which rows.toml names: how they are measured and told."""

from __future__ import annotations

import csv
import io
import multiprocessing
import re
import time
import tomllib
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from tests.known_problems import cracks, motion, statics
from tests.known_problems.statics import Outcome, UnitScale
from warp_peri.errors import InputError
from warp_peri.runtime import set_num_threads

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
        why = told["besides"] | why | one.pop("without", {})
        pose, how = POSED.get(one.pop("run", ""), Outcome), one.pop("with", {})
        limits = one.pop("misses", {})
        for name in told["materials"]:
            said = {"material": name, "why": "" if name in posed else why[name]}
            said["misses"] = limits.get(name, "")
            rows.append(Row(run=partial(pose, name, **how), **said, **one))
    return rows


ROWS = _read()
"""All rows, in their order."""


def chosen(only: Sequence[str] = ()) -> list[Row]:
    """Rows whose names hold one of some words, or of statics, cracks, motion; all without any."""
    wanted = [word.lower() for word in only]
    for word, lower in zip(only, wanted):
        if not word.strip() or not any(lower in one.words for one in ROWS):
            known = ", ".join(dict.fromkeys(one.problem for one in ROWS))
            raise InputError(f"only: expected a part of a row's name, got {word!r}; {known}")
    return [one for one in ROWS if not only or any(word in one.words for word in wanted)]


def measured(one: Row, *, scaled: bool = False) -> Line:
    """A row's answer, error, order, seconds, and whether it holds; `scaled` in other units too."""
    told = ("name", "problem", "material", "reference", "source", "allowed", "least", "misses")
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
    if not np.isfinite(values).all():
        return line | {"holds": False, "note": found.note or "its answer is no number"}
    error, *elsewhere = (abs(value - one.reference) / size for value in values)
    holds = max(error, *elsewhere, 0.0) <= one.allowed
    holds = holds and (one.least is None or (found.order or 0.0) >= one.least)
    if scaled:
        line["scaled"] = float(max(abs(other - found.value) / size for other in others))
        holds = holds and line["scaled"] <= SAME
    line |= {"answer": float(found.value), "error": float(error), "order": found.order}
    line["seconds"] = round(time.perf_counter() - begin, 2)
    return line | {"holds": bool(holds), "note": found.note if holds else one.misses or found.note}


def _numbered(number: int, scaled: bool) -> Line:
    return measured(ROWS[number], scaled=scaled)


def verified(only: Sequence[str] = (), *, scaled: bool = False, processes: int = 2) -> list[Line]:
    """What is measured of the rows that are `chosen`, in their order, by some processes at once."""
    numbers, spawn = [*map(ROWS.index, chosen(only))], multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, spawn, set_num_threads, (1,)) as pool:
        found = pool.map(partial(_numbered, scaled=scaled), numbers)
        return list(tqdm(found, total=len(numbers), unit="row"))


def numbered(lines: Sequence[Line]) -> dict[str, int]:
    """Sources of rows, each with its number."""
    return {source: n for n, source in enumerate(dict.fromkeys(o["source"] for o in lines), 1)}


def table(lines: Sequence[Line], sources: dict[str, int]) -> str:
    """Rows as Markdown, and why one does not hold beside it; sources by their numbers."""
    names = "problem", "material", "reference", "answer", "error", "allowed", "order", "s", "holds"
    words = [f"| {' | '.join((*names, 'why'))} |", "|" + "---|" * 10]
    for line in (line for line in lines if line["holds"] is not None):
        answer = "–" if line["answer"] is None else f"{line['answer']:.5g}"
        order = "" if line["order"] is None else f"{line['order']:.1f}"
        order += "" if line["least"] is None else f" (≥ {line['least']:g})"
        told = f"{line['reference']:.5g} [{sources[line['source']]}]"
        cells = [line["problem"], line["material"], told, answer]
        cells += [_percent(line, name, " %") for name in ("error", "allowed")]
        holds = ("yes", "") if line["holds"] else ("**does not hold**", line["note"])
        cells += [order, f"{line['seconds']:.1f}", *holds]
        words.append(f"| {' | '.join(cells)} |")
    return "\n".join(words)


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
    """The page of the documentation: words of rows.md around what was measured; `data`: its CSV."""
    posed = [line for line in lines if line["holds"] is not None]
    held = f"{sum(line['holds'] for line in posed)} of {len(posed)} rows hold"
    numbers = numbered(lines)
    missed = table([line for line in posed if not line["holds"]], numbers)
    told = {"held": held, "data": data, "materials": by_material(lines), "rows": missed}
    text = Path(__file__).with_name("rows.md").read_text("utf-8").format(**told)
    return re.sub(r" \[\d+\](?= ?\|)", "", text)  # sources are in the data


def as_csv(lines: Sequence[Line]) -> str:
    """All lines as comma-separated values, numbers in full."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()
