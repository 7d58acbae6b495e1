"""Reports from Markdown files with {names}: the prose in the file, the numbers from a run."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


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
