"""One entry of the stability atlas: what fails, a number, a figure, and what a user would see."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from examples.prose import fill
from warp_peri import InputError, Points


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
    """An entry in Markdown: title, number to remember and text of the study; heading, row
    (symptom, cause, remedy) and text of the page for readers."""

    title: str
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
    study, brief = fill(template, **numbers).rstrip("\n").split("\n\n---\n\n")
    title, *study_parts = study.split("\n\n", 2)
    heading, *brief_parts = brief.split("\n\n", 2)
    return Words(title.removeprefix("# "), *study_parts, heading.removeprefix("## "), *brief_parts)


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
