"""Settings of a command in a TOML file: read before the command line, kept beside the results."""

from __future__ import annotations

import argparse
import os
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomli_w

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_text
from warp_peri.files.foreign import content

NOT_KEPT = (
    "command", "config", "json", "progress", "run", "trust", "from_file", "overwrite", "told",
    "first",
)  # fmt: skip


def parse(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """Arguments of a command, those missing on the line taken from the file of --config.

    The file has one table with the name of the command; its keys are the long options with `_` for
    `-`, and the names of the positional arguments. `from_file` of what is returned names those
    that the file set.

    Raises InputError for a file that is not TOML, has no such table or a key that is no option.
    """
    ahead = argparse.ArgumentParser(prog=parser.prog, add_help=False)
    ahead.add_argument("command", nargs="?")
    ahead.add_argument("--config")
    early, _ = ahead.parse_known_args(arguments)
    if early.config is None:
        return parser.parse_args(arguments)
    command = _commands(parser).get(early.command)
    if command is None:
        return parser.parse_args(arguments)
    settings = _table(early.config, early.command)
    actions = {action.dest: action for action in command._actions}
    for key, value in settings.items():
        action = actions.get(key)
        if action is None or key in (*NOT_KEPT, "help"):
            known = ", ".join(sorted(set(actions) - {*NOT_KEPT, "help"}))
            raise InputError(f"{early.config}: no option {key!r}; '{early.command}' has {known}")
        action.required = False
        if isinstance(action, argparse._ExtendAction) and _typed(action, arguments):
            continue  # it would be added to, not replaced
        action.default = _converted(early.config, action, value)
        if not action.option_strings:
            action.nargs = "*" if action.nargs in ("+", "*") else "?"
    given = parser.parse_args(arguments)
    given.from_file = {key for key in settings if getattr(given, key) is actions[key].default}
    return given


def keep(given: argparse.Namespace, path: str | os.PathLike[str]) -> None:
    """Write the settings of a command to a file; `--config` takes it again."""
    write_text(path, _settings(given))


def refuse_used(given: argparse.Namespace, result: Path, settings: Path) -> None:
    """InputError where a result is there already that other settings gave, without --overwrite."""
    if given.overwrite or not result.exists():
        return
    if not settings.exists() or settings.read_text() != _settings(given):
        raise InputError(
            f"{result}: is there already, by other settings; name another folder, or --overwrite"
        )


def _settings(given: argparse.Namespace) -> str:
    table = {}
    for key, value in vars(given).items():
        if key in NOT_KEPT or value is None:
            continue
        table[key] = [_plain(item) for item in value] if isinstance(value, list) else _plain(value)
    return tomli_w.dumps({given.command: table})


def _typed(action: argparse.Action, arguments: Sequence[str] | None) -> bool:
    """Whether an option is on the line."""
    words = sys.argv[1:] if arguments is None else arguments
    return any(word.split("=", 1)[0] in action.option_strings for word in words)


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _table(path: str, command: str) -> dict[str, Any]:
    try:
        table = tomllib.loads(content(path).decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected a TOML file ({error})") from None
    if not isinstance(table.get(command), dict):
        raise InputError(f"{path}: expected a table [{command}]")
    return dict(table[command])


def _converted(path: str, action: argparse.Action, value: Any) -> Any:
    """A value as the option's own type makes it from text."""
    if action.nargs == 0 and isinstance(value, bool):
        return value
    several = isinstance(value, list)
    if action.nargs == 0 or several != (action.nargs not in (None, "?")):
        raise InputError(f"{path}: {action.dest}: {value!r} is not what this option takes")
    kind = action.type if callable(action.type) else str
    try:
        values = [kind(str(item)) for item in (value if several else [value])]
    except (ValueError, argparse.ArgumentTypeError) as error:
        raise InputError(f"{path}: {action.dest}: {error}") from None
    if action.choices is not None and not set(values) <= set(action.choices):
        known = ", ".join(map(str, action.choices))
        raise InputError(f"{path}: {action.dest}: expected of {known}, got {value!r}")
    return values if several else values[0]
