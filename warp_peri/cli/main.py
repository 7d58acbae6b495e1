"""The command `warp-peri`, also `python -m warp_peri`: from dumps to a certified model and on."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from warp_peri.cli.options import check_output, parse
from warp_peri.errors import exit_status

HOMES = {
    "coarse-grain": "train",
    "fit": "train",
    "sweep": "train",
    "fit-crystal": "crystals_sheets",
    "fit-sheet": "crystals_sheets",
}
"""Files of commands that are not in `commands`; imported when asked for, which takes time."""


def main(words: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns the exit status: 0; 1 after a failure, such as a full disk or a row that does not hold;
    2 for input that cannot be used; 130 after Ctrl-C.
    """
    known: dict[str, Any] = {}

    def kept() -> str:
        out = known.get("out")
        there = out is not None and out.exists() and (not out.is_dir() or any(out.iterdir()))
        return "what is finished is kept" if there or not known else "nothing is kept yet"

    return exit_status(lambda: _run(sys.argv[1:] if words is None else words, known), kept)


def _run(words: Sequence[str], known: dict[str, Any]) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = _warn
        given = parse(words)
        given.progress = sys.stderr.isatty() and not given.json  # no bars in files and pipes
        known |= vars(given)
        check_output(given)
        home = import_module(f"{__package__}.{HOMES.get(given.command, 'commands')}")
        result, lines = getattr(home, f"run_{given.command.replace('-', '_')}")(given)
    try:
        print(json.dumps(result) if given.json else "\n".join(map(_printable, lines)), flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python tries at exit
        if not isinstance(error, BrokenPipeError):  # that is a reader, as `head`, who has enough
            raise
    return 2 * (given.command == "evaluate" and all("error" in one for one in result.values()))


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _printable(line: str) -> str:
    """A line without what a file could make a terminal do."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
