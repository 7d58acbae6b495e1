"""How a value is shown that a person looks at: names and values, in text and in notebooks."""

from __future__ import annotations

from html import escape


def in_rows(title: str, rows: list[tuple[str, str]]) -> str:
    """Names and values, a line each."""
    width = max(len(name) for name, _ in rows)
    return "\n".join([title, *(f"  {name:{width}}  {value}" for name, value in rows)])


def as_table(rows: list[tuple[str, str]]) -> str:
    """The same for notebooks."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(value)}</td></tr>"
        for name, value in rows
    )
    return f"<table>{cells}</table>"
