"""The command `warp-peri`, also `python -m warp_peri`: from dumps to a certified model and on.

Every command takes --config FILE.toml with its settings; those that write results leave such a file
beside them. --json prints one object for machines.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from warp_peri.cli import arguments, commands
from warp_peri.cli.settings_file import parse
from warp_peri.errors import exit_status

COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "coarse-grain": ("LAMMPS dumps to a data file", arguments.coarse_grain),
    "learn": ("a crystal's structure and calculator to its law", arguments.learn),
    "dic": ("frames of image correlation to a sheet's material", arguments.dic),
    "train": ("a data file to a certified model", arguments.train),
    "certify": ("what is proven of a model", arguments.certify),
    "evaluate": ("errors of a model on data sets", arguments.evaluate),
    "solve": ("displacement from loads", arguments.solve),
    "predict": ("displacement with its error", arguments.predict),
    "plan": ("which model and solver a scene needs", arguments.plan),
    "export": ("for ParaView and other codes", arguments.export),
    "sweep": ("choose horizon and degree", arguments.sweep),
    "verify": ("known problems against their references", arguments.verify),
    "info": ("what a model, a data file or a mesh holds", arguments.info),
}
"""What each command is for, and its options; `commands` has a function run_NAME for each."""


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

    return exit_status(lambda: _run(words, known), kept)


def _run(words: Sequence[str] | None, known: dict[str, Any]) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = _warn
        given = parse(_parser(), words)
        known |= vars(given)
        commands.check_output(given)
        result = given.run(given)
    try:
        _print(given, result)
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python tries at exit
        if not isinstance(error, BrokenPipeError):  # that is a reader, as `head`, who has enough
            raise
    if given.command == "evaluate" and all("error" in table for table in result.values()):
        return 2
    if given.command == "verify" and any(line["holds"] is False for line in result["rows"]):
        return 1
    return 0


class _Defaults(argparse.ArgumentDefaultsHelpFormatter):
    """Help with the defaults of those options that have one."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or isinstance(action.const, bool):  # a switch
            return action.help
        return super()._get_help_string(action)


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="warp-peri", description=__doc__)
    subparsers = parser.add_subparsers(dest="command", required=True)
    for name, (words, add_arguments) in COMMANDS.items():
        run = getattr(commands, f"run_{name.replace('-', '_')}")
        command = subparsers.add_parser(
            name, help=words, description=run.__doc__, formatter_class=_Defaults
        )
        command.set_defaults(run=run)
        command.add_argument("--config", metavar="FILE.toml", help="settings of this command")
        command.add_argument("--json", action="store_true", help="one JSON object")
        add_arguments(command)
    return parser


def _print(given: argparse.Namespace, result: dict[str, Any]) -> None:
    if given.json:
        print(json.dumps(result))
    elif given.command == "evaluate":
        _print_table(result, given.unit)
    elif hasattr(given, "told"):
        print("\n".join(map(_printable, given.told.split("\n"))))
    else:
        result = commands.in_percent(result) if given.command == "train" else result
        print("\n".join(map(_printable, commands.lines_of(result))))


def _print_table(tables: dict[str, dict[str, Any]], unit: str) -> None:
    width, absolute = max(map(len, tables)), f"E_res_abs [{unit}]"
    print(f"{'set':{width}}  samples   E_res [%]  {absolute:>17}   E_u [%]  E_shape [%]")
    for name, table in tables.items():
        if "error" in table:
            print(_printable(f"{name:{width}}  {table['error']}"))
            continue
        left = table.get("E_res_abs")
        print(
            f"{_printable(name):{width}}  {table['samples']:7d}  "
            f"{_percent(table.get('E_res')):>10}  "
            f"{'–' if left is None else format(left, '.3e'):>17}  "
            f"{_percent(table.get('E_u')):>8}  {_percent(table.get('E_shape')):>11}"
        )


def _printable(line: str) -> str:
    """A line without what a file could make a terminal do."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


def _percent(error: float | None) -> str:
    """An error in %, or a dash where there is nothing that it could be relative to."""
    return "–" if error is None else f"{100 * error:.3f}"
