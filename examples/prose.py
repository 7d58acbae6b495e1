"""Reports from Markdown files with {names}: the prose in the file, the numbers from a run.

Also the way back: the numbers of a table that stands on a page; and what a call says.
"""

import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from tools.options import Options
from warp_peri.errors import InputError

NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]?\d+)?")
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def fill(template: Path, **numbers: Any) -> str:
    """The text of a template, each {name:format} filled in as str.format does."""
    return template.read_text(encoding="utf-8").format(**numbers)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    return "\n".join([_line(head), "|---" * len(head) + "|", rows_of(rows)])


def rows_of(rows: Iterable[Sequence[str]]) -> str:
    """The rows of a Markdown table, whose head is in a template."""
    return "\n".join(map(_line, rows))


def _line(cells: Sequence[str]) -> str:
    return "".join(f"| {cell} " if cell else "| " for cell in cells) + "|"


def cells_of(page: str, section: str, start: str) -> list[list[str]]:
    """Cells of each row that starts so, behind its start, of the section whose title starts so.

    Raises ValueError where the page has no such section or no such row.
    """
    _, *found = page.split(f"\n## {section}")
    rows = found[0].split("\n## ")[0].splitlines() if found else []
    cells = [row[len(start) :].strip(" |").split(" | ") for row in rows if row.startswith(start)]
    if not cells:
        raise ValueError(f"expected a row {start!r} below a title {section!r}, there is none")
    return cells


def numbers_of(page: str, section: str, start: str) -> list[list[float]]:
    """All numbers of the rows that `cells_of` gives."""
    return [
        [float(number) for cell in row for number in NUMBER.findall(cell)]
        for row in cells_of(page, section, start)
    ]


def readable(number: str) -> str:
    """A number as a page shows it: 9.4e-05 as 9.4·10⁻⁵, 1.2e+02 as 120, a minus as such."""
    digits, _, power = number.partition("e")
    if power and 0 <= int(power) <= 3:
        digits, power = f"{float(number):g}", ""
    raised = f"·10{f'{int(power)}'.translate(RAISED)}" if power else ""
    return digits.replace("-", "−") + raised


def said_by(call: Callable[[], Any]) -> str:
    """The error or the first warning of a call; RuntimeError where there is neither."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            call()
        except InputError as refused:
            return f"InputError: {refused}"
    if not caught:
        raise RuntimeError("expected an error or a warning, got neither")
    return f"UserWarning: {caught[0].message}"


Table = tuple[Sequence[str], Iterable[Sequence[str]]]
"""Heads of columns, and rows of cells."""


def print_tables(doc: str | None, tables: Sequence[Callable[..., Table]], *given: Any) -> None:
    """What a script of tables does: print those that the command names, all by default."""
    parser = Options(doc)
    names = {make.__name__: make for make in tables}
    parser.add("table", nargs="*", choices=[[], *names], help="which; default: all")
    for name in parser.parse_args().table or names:
        print(f"{names[name].__doc__}\n\n{table(*names[name](*given))}\n")
