"""Tables of scripts, records of what a command found, and what a call says."""

import json
import warnings
from collections.abc import Callable, Iterable, Sequence
from datetime import date
from pathlib import Path
from subprocess import check_output
from typing import Any

from tools.options import Options
from warp_peri.errors import InputError
from warp_peri.files.atomic import finite, write_json

Table = tuple[Sequence[str], Iterable[Sequence[str]]]
"""Heads of columns, and rows of cells."""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, *rows]
    text = ["".join(f"| {cell} " if cell else "| " for cell in cells) + "|" for cells in lines]
    return "\n".join([text[0], "|---" * len(head) + "|", *text[1:]])


def printed(paper: str, name: str) -> list[list[str]]:
    """What a paper prints: rows that a table of docs/record marks so, which no script computes."""
    record = Path(__file__).parent.parent / "docs" / "record" / f"{paper}.json"
    rows = json.loads(record.read_text("utf-8"))["tables"][name]["rows"]
    return [row for row in rows if "*printed*" in row[0] + row[1]]


def print_tables(doc: str | None, tables: Sequence[Callable[..., Table]], *given: object) -> None:
    """What a script of tables does: print those that the command names, all by default."""
    parser, names = Options(doc), {make.__name__: make for make in tables}
    parser.add_argument("table", nargs="*", help="which; default: all")
    asked = parser.parse_args().table
    if unknown := set(asked) - names.keys():
        parser.error(f"table: expected of {', '.join(names)}, got {', '.join(unknown)}")
    for name in asked or names:
        print(f"{names[name].__doc__}\n\n{table(*names[name](*given))}\n")


def made_by(command: str) -> dict[str, Any]:
    """Head of a record: the date, the commit and the command."""
    root = Path(__file__).parent.parent
    commit = check_output(["git", "rev-parse", "--short", "HEAD"], cwd=root, text=True).strip()
    return {"date": f"{date.today()}", "commit": commit, "command": command}


def write_record(path: Path, command: str, **content: Any) -> None:
    """Write what a command found, below its head."""
    write_json(path, finite(made_by(command) | content))


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
