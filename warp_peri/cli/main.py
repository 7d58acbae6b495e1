"""The command `warp-peri`, also `python -m warp_peri`.

Parsers are made from commands.txt. A command's first line is its sentence, the second an example;
then come groups of options, a line each: name, names of values, two blanks, help; lines indented
further go on. `V+` is one value or more, `V?` one or none, `a|b` a choice, `=x` the default, `!`
required, `@dest` the name in the settings; without a value it is a switch. A line of names alone
stands for the lines that first have them.
"""

from __future__ import annotations

import json
import os
import re
import sys
import tomllib
import warnings
from argparse import SUPPRESS, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import h5py

import warp_peri
from warp_peri.errors import InputError, exit_status
from warp_peri.files.atomic import content, destination

LEARNING = ("coarse-grain", "fit", "sweep", "fit-crystal", "fit-sheet")
"""Commands that are in `train`, others in `commands`; imported when asked for: it takes time."""


def main(words: Sequence[str] | None = None) -> int:
    """Run a command; its exit status is 0, 1 after a failure, such as a full disk or a row that
    does not hold, 2 for input that cannot be used, or 130 after Ctrl-C."""
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
        home = "train" if given.command in LEARNING else "commands"
        run = f"run_{given.command.replace('-', '_')}"
        result, lines = getattr(import_module(f"{__package__}.{home}"), run)(given)
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
    """Escape the characters of a line that could control a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


SETTINGS = """\
Every command takes --config FILE.toml with its settings. Commands that write results leave such a
file with them. --json prints one object for machines."""
COMMANDS: dict[str, str] = {}
for _text in Path(__file__).with_name("commands.txt").read_text("utf-8").split("\n\n"):
    _name, _, COMMANDS[_name.strip("[]")] = _text.partition("\n")
"""The text of each command, by its name."""
LINES: dict[str, str] = {}
for _line in "\n".join(COMMANDS.values()).replace("\n    ", " ").splitlines():
    if "  " in _line.strip():
        LINES.setdefault(_line.split()[0], _line)

PATHS = ("DUMP", "FILE", "FOLDER", "FRAMES", "MESH", "PATH", "STRUCTURE")
WORDS = ("NAME", "STRAIN", "LENGTH", "STRESS")
COUNTS = ("N", "M")
"""Names of values that are paths, as are those with an ending; text; whole numbers; else reals."""
NOT_KEPT = ("config", "json", "trust", "overwrite", "help")
"""Options that no file of settings has."""


class Parser(ArgumentParser):
    """Argument parser whose errors are an InputError."""

    def error(self, message: str) -> NoReturn:
        """Raise an InputError in place of the parser's exit."""
        raise InputError(f"{message}; {self.prog} --help says what there is")


def parser_of(name: str) -> Parser:
    """Make the parser of a command, its options in their groups, its example below."""
    sentence, example, *lines = COMMANDS[name].replace("\n    ", " ").splitlines()
    parser = Parser(
        prog=f"warp-peri {name}",
        description=sentence,
        epilog=f"Example:\n  warp-peri {name} {example}",
        formatter_class=RawDescriptionHelpFormatter,
    )
    for line in lines:
        if not line.startswith("  "):
            group = parser.add_argument_group(line)
            continue
        for one in [line] if "  " in line.strip() else map(LINES.__getitem__, line.split()):
            spec, text = re.split(r" {2,}", one.strip(), maxsplit=1)
            option, *marks = spec.split()
            how = _taken(option, marks)
            if how.get("default", []) != []:
                many = how["default"] if "nargs" in how else [how["default"]]
                text += f" (default: {' '.join(map(str, many))})"
            group.add_argument(option, help=text.replace("%", "%%"), **how)
    needed = [one for one in parser._actions if one.required]
    words = [" ".join([*one.option_strings, str(one.metavar)]) for one in needed]
    words.sort(key=lambda word: word.startswith("--"))
    parser.usage = " ".join([parser.prog, *words, "[options]"]).replace("%", "%%")
    parser.add_argument("--config", type=Path, metavar="FILE.toml", help="file with settings")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _taken(option: str, marks: list[str]) -> dict[str, Any]:
    """Arguments of argparse for an option, from the marks between its name and its help."""
    how: dict[str, Any] = {"required": True} if "!" in marks else {}
    for mark in marks:
        if mark[0] == "@":
            how["dest"] = mark[1:]
        if "|" in mark:
            how["choices"] = mark.split("|")
    named = [mark for mark in marks if mark[0] not in "!=@" and "|" not in mark]
    default = next((mark[1:] for mark in marks if mark[0] == "="), None)
    if named:
        first = named[0].rstrip("+?")
        how |= {"type": _kind(first), "metavar": first}
        if len(named) > 1:
            how |= {"nargs": len(named), "metavar": tuple(named)}
        elif named[0] != first:
            how["nargs"] = named[0][-1]
            if named[0][-1] == "+" and option.startswith("--"):
                how["action"] = "extend"
    elif "choices" not in how:
        how["action"] = "store_false" if option.startswith("--no-") else "store_true"
    if default is not None and "," in default:
        how["default"] = [*map(how["type"], default.split(","))]
    elif default is not None:
        how["default"] = [] if default == "[]" else how.get("type", str)(default)
    return how


def _kind(value: str) -> Any:
    if value in PATHS or "." in value:
        return Path
    return str if value in WORDS or "=" in value else int if value in COUNTS else float


def parse(words: Sequence[str]) -> Namespace:
    """Parse the command and its options, those missing on the line from the file of --config.

    The file has one table named as the command, with long options (`_` for `-`) and positional
    arguments as keys. `from_file` of the result are those it set, `options` all, `usual` defaults.
    """
    known = "\n".join(f"  {name:14}{text.splitlines()[0]}" for name, text in COMMANDS.items())
    top = Parser(
        prog="warp-peri",
        usage="warp-peri COMMAND [options]",
        description="Learn nonlocal material models from atoms, crystals or camera frames, and "
        f"solve.\n\n{known}",
        epilog=f"Help of a command: warp-peri fit --help\n\n{SETTINGS}",
        formatter_class=RawDescriptionHelpFormatter,
    )
    top.add_argument("command", metavar="COMMAND", choices=COMMANDS, help="one of these")
    top.add_argument("--version", action="version", version=f"warp_peri {warp_peri.__version__}")
    given = top.parse_args(words[:1])
    parser, rest = parser_of(given.command), words[1:]
    usual = {one.dest: one.default for one in parser._actions if one.dest != "help"}
    options = {one.dest: one for one in parser._actions if one.dest not in NOT_KEPT}
    ahead = ArgumentParser(add_help=False)
    ahead.add_argument("--config", type=Path)
    path, kept = ahead.parse_known_args(rest)[0].config, {}
    if path is not None and not {"-h", "--help"} & {*rest}:
        try:
            kept = _settings_of(path, given.command, options)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    for action in parser._actions:  # a line without defaults tells what is typed
        action.default = SUPPRESS if action.option_strings else None
        if action.dest in kept:
            action.required = False
            if not action.option_strings:
                action.nargs = "*" if action.nargs == "+" else "?"
    line = vars(parser.parse_args(rest)).items()
    typed = {name: value for name, value in line if value is not None and value != []}
    told = {"usual": usual, "options": [*options], "from_file": kept.keys() - typed.keys()}
    return Namespace(**vars(given) | usual | kept | typed | told)


def _settings_of(path: Path, command: str, options: dict[str, Any]) -> dict[str, Any]:
    """Read options from a file of settings; InputError for keys and values of no option."""
    try:
        table = tomllib.loads(content(path).decode()).get(command)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"expected a TOML file ({error})") from None
    if not isinstance(table, dict):
        raise InputError(f"expected a table [{command}]")
    kept = {}
    for key, value in table.items():
        if key not in options:
            raise InputError(f"no option {key!r}; there are {', '.join(sorted(options))}")
        action = options[key]
        values = value if isinstance(value, list) else [value]
        switch, single = action.nargs == 0, action.nargs in (None, "?", 0)
        try:
            found = values if switch else [(action.type or str)(str(one)) for one in values]
        except ValueError:
            found = []
        fits = (
            isinstance(value, list) != single,
            all(isinstance(one, bool) == switch for one in values),
            action.nargs in (None, "?", 0, "+", len(values)),
            len(found) == len(values) and all(one in (action.choices or found) for one in found),
        )
        if not all(fits):
            raise InputError(f"{key}: {value!r} is not what this option takes")
        if values:
            kept[key] = found[0] if single else found
    return kept


def check_output(given: Namespace) -> None:
    """Refuse, before anything is done, to overwrite inputs or what is no file."""
    if getattr(given, "out", None) is None:
        return
    for name, read in vars(given).items():
        for path in read if isinstance(read, list) else [read]:
            if name != "out" and isinstance(path, Path) and path.resolve() == given.out.resolve():
                raise InputError(f"out: {given.out} is read ({name}); name another file")
    folder = given.command not in ("coarse-grain", "solve")
    if given.out.exists() and given.out.is_dir() != folder:
        wanted, there = ("folder", "file") if folder else ("file", "folder")
        raise InputError(f"out: expected a {wanted}, {given.out} is a {there}")
    if not folder:
        destination(given.out)
        if given.command == "coarse-grain" or (given.data and given.body is None):
            if given.out.suffix not in (".h5", ".hdf5"):
                raise InputError(f"out: expected a .h5 file, got {given.out.name}")
            if given.out.exists() and not h5py.is_hdf5(given.out):
                raise InputError(f"out: {given.out} is there already, and no data file")
