"""The command line: parsers made from commands.txt, settings from and to TOML.

In that file the first line of a command is its sentence, the second an example; then come groups of
options. An option is a line: its name, the names of its values, and its help behind two blanks;
lines indented further go on. `V+` is one value or more, `V?` one or none, `a|b` a choice, `=x` the
default, `!` required, `@dest` the name in the settings. Without a value it is a switch.
"""

from __future__ import annotations

import re
import tomllib
from argparse import SUPPRESS, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import h5py
import tomli_w

import warp_peri
from warp_peri.errors import InputError
from warp_peri.files.atomic import destination, write_text
from warp_peri.files.foreign import content

SETTINGS = """\
Every command takes --config FILE.toml with its settings. Commands that write results leave such a
file with them. --json prints one object for machines."""
COMMANDS: dict[str, str] = {}
for _text in Path(__file__).with_name("commands.txt").read_text("utf-8").split("\n\n"):
    _name, _, COMMANDS[_name.strip("[]")] = _text.partition("\n")
"""The text of each command, by its name."""

PATHS = ("DUMP", "FILE", "FOLDER", "FRAMES", "MESH", "PATH", "STRUCTURE")
WORDS = ("NAME", "STRAIN", "LENGTH", "STRESS")
COUNTS = ("N", "M")
"""Names of values that are paths, as are those with an ending; text; whole numbers; else reals."""
NOT_KEPT = ("command", "config", "json", "progress", "trust", "from_file", "overwrite", "help")


class Parser(ArgumentParser):
    """A parser whose errors are an InputError."""

    def error(self, message: str) -> NoReturn:
        """Raise InputError."""
        raise InputError(f"{message}; {self.prog} --help says what there is")


def parser_of(name: str) -> Parser:
    """The parser of a command, its options in their groups, its example below."""
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
        spec, text = re.split(r" {2,}", line.strip(), maxsplit=1)
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
    """How argparse takes an option, from the marks between its name and its help."""
    how: dict[str, Any] = {"required": True} if "!" in marks else {}
    named: list[str] = []
    default = None
    for mark in marks:
        if mark[0] == "=":
            default = mark[1:]
        elif mark[0] == "@":
            how["dest"] = mark[1:]
        elif "|" in mark:
            how["choices"] = mark.split("|")
        elif mark != "!":
            named.append(mark)
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
    if default is not None and "," in default:  # replaced, not added to, by what is typed
        how |= {"default": [*map(how["type"], default.split(","))], "action": "store"}
    elif default is not None:
        how["default"] = [] if default == "[]" else how.get("type", str)(default)
    return how


def _kind(value: str) -> Any:
    if value in PATHS or "." in value:
        return Path
    return str if value in WORDS or "=" in value else int if value in COUNTS else float


def parse(words: Sequence[str]) -> Namespace:
    """The command and its options, those missing on the line taken from the file of --config.

    The file has one table with the name of the command; its keys are the long options with `_` for
    `-`, and the names of the positional arguments. `from_file` of what is returned names those
    that the file set.

    Raises InputError for a line that makes no sense, a file that is not TOML, has no such table or
    a key that is no option.
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
    ahead = ArgumentParser(add_help=False)
    ahead.add_argument("--config", type=Path)
    path = ahead.parse_known_args(rest)[0].config
    if path is None or {"-h", "--help"} & {*rest}:
        return parser.parse_args(rest, given)
    actions = {one.dest: one for one in parser._actions if one.dest not in ("help", "config")}
    try:
        kept = _values_of(_table(path, given.command), actions)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    usual = {name: action.default for name, action in actions.items()}
    for name, action in actions.items():  # a line without defaults tells what is typed
        action.default = SUPPRESS if action.option_strings else None
        if name in kept:
            action.required = False
            if not action.option_strings:
                action.nargs = "*" if action.nargs == "+" else "?"
    line = vars(parser.parse_args(rest)).items()
    typed = {name: value for name, value in line if value is not None and value != []}
    from_file = kept.keys() - typed.keys()
    return Namespace(**vars(given) | usual | kept | typed, from_file=from_file)


def _table(path: Path, command: str) -> dict[str, Any]:
    try:
        table = tomllib.loads(content(path).decode()).get(command)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"expected a TOML file ({error})") from None
    if not isinstance(table, dict):
        raise InputError(f"expected a table [{command}]")
    return table


def _values_of(table: dict[str, Any], actions: dict[str, Any]) -> dict[str, Any]:
    """Options as a table of settings has them; InputError for keys and values of no option."""
    kept = {}
    for key, value in table.items():
        action = actions.get(key)
        if action is None or key in NOT_KEPT:
            known = ", ".join(sorted({*actions} - {*NOT_KEPT}))
            raise InputError(f"no option {key!r}; there are {known}")
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
    """Refuse, before anything is done, to write over what is read or what is no file.

    Raises InputError saying which it is.
    """
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


def keep(given: Namespace, path: Path) -> None:
    """Write the settings of a command, which `--config` takes again; its own file is left."""
    if given.config is None or not (path.exists() and path.samefile(given.config)):
        write_text(path, _settings(given))


def refuse_used(given: Namespace, result: Path, settings: Path) -> None:
    """InputError where files are there already that other settings gave, without --overwrite."""
    there = [one for one in (result, settings, result.with_name("metrics.json")) if one.exists()]
    if given.overwrite or not there:
        return
    if not settings.exists() or settings.read_text() != _settings(given):
        raise InputError(
            f"{there[0]}: is there already, by other settings; name another folder, or --overwrite"
        )


def _settings(given: Namespace) -> str:
    """The options of a command as TOML."""
    table = {}
    for key, value in vars(given).items():
        if key not in NOT_KEPT and value is not None:
            table[key] = [*map(_plain, value)] if isinstance(value, list) else _plain(value)
    return tomli_w.dumps({given.command: table})


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value
