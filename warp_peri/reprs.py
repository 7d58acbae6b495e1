"""How a value is shown that a person looks at: names and values, in text and in notebooks."""

from __future__ import annotations

from html import escape
from typing import Any


class Shown:
    """What a person looks at as names and values, its `rows`, in text and in notebooks."""

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        return []

    def __repr__(self) -> str:
        rows = self.rows()
        width = max((len(name) for name, _ in rows), default=0)
        return "\n".join([type(self).__name__, *(f"  {n:{width}}  {value}" for n, value in rows)])

    def _repr_html_(self) -> str:
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th><td>{escape(value)}</td></tr>"
            for name, value in self.rows()
        )
        return f"<table>{cells}</table>"


def error_rows(errors: dict[str, Any]) -> list[tuple[str, str]]:
    """E_res and E_u on data sets, by name."""
    rows = []
    for name, table in errors.items():
        known = table if isinstance(table, dict) else {}
        parts = [
            f"{key} {known[key]:.2%}" for key in ("E_res", "E_u") if known.get(key) is not None
        ]
        if parts:
            rows.append((f"errors on {name}", ", ".join(parts)))
    return rows
