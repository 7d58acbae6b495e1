"""The sources, table by table and figure by figure: what is printed beside what is measured here.

    python examples/studies/papers.py you_2021

Takes what other commands left in runs/ and names those that are missing. What it computes itself is
kept in runs/papers/, so that a run that is stopped goes on. Writes docs/papers/NAME.md.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

from examples.prose import fill
from examples.studies import (
    paper_jafarzadeh_2024,
    paper_polymer_gp,
    paper_slides,
    paper_you_2021,
)
from warp_peri.errors import InputError, exit_status
from warp_peri.files.atomic import plain, write_json, write_text

SOURCES = {
    "you_2021": paper_you_2021,
    "jafarzadeh_2024": paper_jafarzadeh_2024,
    "polymer_gp": paper_polymer_gp,
    "slides": paper_slides,
}
"""Each has `values(runs, kept, figures)`: what its template, beside it, leaves open."""


def keeper(folder: Path) -> Callable[..., Any]:
    """A function that computes a result once and keeps it as JSON in the folder."""

    def kept(name: str, compute: Callable[[], Any]) -> Any:
        path = folder / f"{name}.json"
        if not path.exists():
            write_json(path, plain(compute()))
        return json.loads(path.read_text(encoding="utf-8"))

    return kept


def where() -> str:
    """Commit and machine, for the foot of a page."""
    asked = ["git", "describe", "--always", "--dirty"]
    commit = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    return f"commit {commit or 'unknown'}, {platform.machine()}, {os.cpu_count()} cores"


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", choices=SOURCES)
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", help="results of the commands")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "papers")
    given = parser.parse_args(arguments)
    source = SOURCES[given.source]
    missing = [
        f"{command} (it writes {path})"
        for path, command in source.NEEDED.items()
        if not (given.runs.parent / path).exists()
    ]
    if missing:
        raise InputError("to be run first: " + "; ".join(missing))
    given.out.mkdir(parents=True, exist_ok=True)
    kept = keeper(given.runs / "papers" / given.source)
    values = source.values(given.runs, kept, given.out)
    page = fill(source.TEMPLATE, where=where(), **values)
    write_text(given.out / f"{given.source}.md", page)
    print(f"{given.out / given.source}.md")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
