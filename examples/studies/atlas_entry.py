"""One entry of the stability atlas: what fails, a number, a figure, and what a user would see."""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from examples.prose import fill
from warp_peri import InputError, Points

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Entry:
    """A provoked failure: its name, the measurements that its words are filled with, errors and
    warnings in their own words, a figure, and what it draws as plain numbers."""

    name: str
    numbers: Mapping[str, Any]
    seen: list[str]
    figure: Figure
    values: dict[str, Any]


@dataclass(frozen=True)
class Words:
    """An entry in Markdown: title, message of the figure, number to remember and text of the
    study; heading, row (symptom, cause, remedy) and text of the page for readers."""

    title: str
    message: str
    number: str
    text: str
    heading: str
    row: str
    brief: str


def entry(
    name: str,
    numbers: Mapping[str, Any],
    seen: Sequence[str | Callable[[], Any]],
    figure: Figure,
    values: dict[str, Any],
) -> Entry:
    """What was measured, and the words that each of `seen` ends in."""
    said = [one if isinstance(one, str) else words(one) for one in seen]
    return Entry(name, numbers, said, figure, values)


def filled(name: str, numbers: Mapping[str, Any]) -> Words:
    """atlas/NAME.md with its measurements: the study, a line ---, what readers need."""
    template = Path(__file__).parent / "atlas" / f"{name}.md"
    study, short = fill(template, **numbers).rstrip("\n").split("\n\n---\n\n")
    title, number, text = study.split("\n\n", 2)
    title, message = title.removeprefix("# ").split(" | ")
    heading, row, brief = as_read(short).split("\n\n", 2)
    heading = heading.removeprefix("## ")
    return Words(title, as_read(message), number, text, heading, row, brief)


def as_read(text: str) -> str:
    """Percent and powers of ten as pages print them: 13 %, 1.9·10⁵."""
    text = re.sub(r"(?<=\d)%", " %", text)
    text = re.sub(
        r"(?<=\d)e([-+])0*(\d+)",
        lambda found: "·10" + f"{found[1].strip('+')}{found[2]}".translate(RAISED),
        text,
    )
    return re.sub(r"(?<![\d.])1·10", "10", text)


def words(run: Callable[[], Any]) -> str:
    """The error or the first warning that `run` ends in; it must end in one."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run()
        except InputError as error:
            return f"InputError: {error}"
    if not caught:
        raise RuntimeError("expected an error or a warning, got neither")
    return f"UserWarning: {caught[0].message}"


def square_lattice(interior: int | tuple[int, int], horizon: float, spacing: float) -> Points:
    """Unknown nodes from the origin, so many a side, and the collar of 2δ they need."""
    sides = np.broadcast_to(interior, 2)
    pad = int(np.ceil(2 * horizon / spacing))
    steps = np.argwhere(np.ones(sides + 2 * pad)) - pad
    inside = np.all((steps >= 0) & (steps < sides), axis=1)
    return Points(spacing * steps, inside, spacing)
