"""The command `warp-peri`, also `python -m warp_peri`: from dumps to a certified model and on."""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from warp_peri.cli import arguments, commands
from warp_peri.cli.settings_file import parse
from warp_peri.errors import exit_status

SETTINGS = """\
Every command takes --config FILE.toml with its settings. Commands that write results leave such a
file with them. --json prints one object for machines."""

LINE = 72 * "-"


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
        given.progress = sys.stderr.isatty() and not given.json  # no bars in files and pipes
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
    return 0


class _Help(argparse.RawDescriptionHelpFormatter):
    """Help whose first line has what must be given alone, and whose options say their defaults."""

    def add_usage(self, usage: Any, actions: Any, groups: Any, prefix: Any = None) -> None:
        needed = [action for action in actions if action.required or not action.option_strings]
        words = [self._prog]
        for action in sorted(needed, key=lambda action: bool(action.option_strings)):
            default = self._get_default_metavar_for_positional(action)
            words += [*action.option_strings[:1], self._format_args(action, default)]
        super().add_usage(" ".join([*words, "[options]"]).replace("%", "%%"), [], [], prefix)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        default = action.default
        if default in (None, [], argparse.SUPPRESS) or action.nargs == 0:
            return action.help
        shown = " ".join(default) if isinstance(default, list) else default
        return f"{action.help} (default: {shown})"


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    sentence = "Learn nonlocal material models from atoms, crystals or camera frames, and solve."
    example = "Help of a command: warp-peri train --help\n\n" + SETTINGS
    parser = argparse.ArgumentParser(
        prog="warp-peri", description=sentence, epilog=example, formatter_class=_Help
    )
    subparsers = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", prog="warp-peri"
    )
    for name in arguments.COMMANDS:
        sentence, example = arguments.described(name)
        command = subparsers.add_parser(
            name,
            help=sentence,
            description=sentence,
            epilog=f"Example:\n  {example}",
            formatter_class=_Help,
        )
        command.set_defaults(run=getattr(commands, f"run_{name.replace('-', '_')}"))
        arguments.add_options(command, name)
        command.add_argument("--config", metavar="FILE.toml", help="file with settings")
        command.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _print(given: argparse.Namespace, result: dict[str, Any]) -> None:
    if given.json:
        print(json.dumps(result))
        return
    if first := getattr(given, "first", []):  # what there is, how good, what next; then details
        print("\n".join(map(_printable, [*first, LINE])))
    if given.command == "evaluate":
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
