"""The command `warp-peri`, also `python -m warp_peri`.

Parsers are made from commands.txt. A command's first line is its sentence, the second an example;
then come groups of options, a line each: name, names of values, two blanks, help; lines indented
further go on. `V+` is one value or more, `a|b` a choice, `=x` the default (`=` an empty list), `!`
required, `@dest` the name in the code; without a value it is a switch. A line of names alone stands
for the lines that first have them.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import sys
import warnings
from argparse import SUPPRESS, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any, NoReturn

import warp_peri
from warp_peri.errors import InputError, Values, exit_status, printable
from warp_peri.files.atomic import content, destination

LEARNING = "coarse-grain", "fit", "sweep", "fit-crystal", "fit-sheet"
"""Commands that are in `train`, others in `commands`; imported when asked for: it takes time."""


def main(words: Sequence[str] | None = None) -> int:
    """Run a command; its exit status is 0, 1 after a failure, such as a full disk or a row that
    does not hold, 2 for input that cannot be used, or 130 after Ctrl-C."""
    return exit_status(lambda: _run(sys.argv[1:] if words is None else words))


def _run(words: Sequence[str]) -> int:
    with warnings.catch_warnings(action="always"):
        warnings.showwarning = lambda said, *_, **__: print(f"warning: {said}", file=sys.stderr)
        given = parse(words)
        given.progress = sys.stderr.isatty() and not given.json  # no bars in files and pipes
        check_output(given)
        home = "train" if given.command in LEARNING else "commands"
        run = f"run_{given.command.replace('-', '_')}"
        result, lines = getattr(import_module(f"{__package__}.{home}"), run)(given)
    try:
        print(json.dumps(result) if given.json else "\n".join(map(printable, lines)), flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python tries at exit
        if not isinstance(error, BrokenPipeError):  # that is a reader, as `head`, who has enough
            raise
    return 2 * (given.command == "evaluate" and all("error" in one for one in result.values()))


SETTINGS = """\
@FILE stands for the words in a file; commands that write results leave such a file with them, and
options behind it win. --json prints one object for machines."""
OUTPUT = """
output
  --overwrite  replace files that this command with these settings did not write
"""
COMMANDS: dict[str, str] = {}
for _text in Path(__file__).with_name("commands.txt").read_text("utf-8").split("\n\n"):
    _name, _, _text = _text.replace("\noutput\n", OUTPUT).partition("\n")
    COMMANDS[_name.strip("[]")] = _text
"""The text of each command, by its name."""
LINES: dict[str, str] = {}
for _line in "\n".join(COMMANDS.values()).replace("\n    ", " ").splitlines():
    if "  " in _line.strip():
        LINES.setdefault(_line.split()[0], _line)

PATHS = "DUMP", "FILE", "FOLDER", "FRAMES", "STRUCTURE"
WORDS = "NAME", "STRAIN", "LENGTH", "STRESS"
COUNTS = "N", "M"
"""Names of values that are paths, as are those with an ending; text; whole numbers; else reals."""
TYPED = "--json", "--trust", "--overwrite", "--help", "-h"
"""Options that no settings file has."""
MADE, HASH = "# words of warp-peri", "# sha256 "
"""First line of the settings files that commands write; begin of those on what was written."""
BEGUN = {"begun": "-"}
"""In place of hashes of what is written, while it is: a job that is killed is done again."""
WRITTEN = {
    "fit": "model.json metrics.json",
    "fit-crystal": "model.json crystal.json law.png",
    "fit-sheet": "*.json curves.* material.feb",
    "sweep": "sweep.json",
    "export": "sample_*.vtu",
}
"""Names of what commands write to a folder; fits of a sweep know by themselves whose they are."""


class Parser(ArgumentParser):
    """Argument parser whose errors are an InputError."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; {self.prog} --help says what there is")


def parser_of(name: str) -> Parser:
    """Make the parser of a command, its options in their groups, its example below."""
    sentence, example, *lines = COMMANDS[name].replace("\n    ", " ").splitlines()
    parser = Parser(
        prog=f"warp-peri {name}",
        description=sentence,
        epilog=f"Example:\n  warp-peri {name} {example}",
        formatter_class=RawDescriptionHelpFormatter,
        allow_abbrev=False,
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
                text += f" (default: {' '.join(map(str, as_list(how['default'])))})"
            group.add_argument(option, help=text.replace("%", "%%"), **how)
    needed = [one for one in parser._actions if one.required]
    words = [" ".join([*one.option_strings, str(one.metavar)]) for one in needed]
    parser.usage = " ".join([parser.prog, *words, "[options]"]).replace("%", "%%")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _taken(option: str, marks: list[str]) -> Values:
    """Arguments of argparse for an option, from the marks between its name and its help."""
    how, names = Values(), list[str]()
    for mark in marks:
        if mark == "!":
            how["required"] = True
        elif mark[0] == "@":
            how["dest"] = mark[1:]
        elif mark[0] == "=":
            how["default"] = mark[1:]
        elif "|" in mark:
            how["choices"] = mark.split("|")
        else:
            names.append(mark)
    if names:
        first = names[0].rstrip("+")
        how |= {"type": _kind(first), "metavar": first}
        if names[1:]:
            how |= {"nargs": len(names), "metavar": tuple(names)}
        elif names[0] != first:
            how |= {"nargs": "+", "action": "extend"}
    elif "choices" not in how:
        how["action"] = "store_false" if option.startswith("--no-") else "store_true"
    if "default" in how:
        one, text = how.get("type", str), how["default"]
        how["default"] = [one(v) for v in text.split(",") if v] if "nargs" in how else one(text)
    return how


def _kind(value: str) -> Any:
    if value in PATHS or "." in value:
        return Path
    return str if value in WORDS else int if value in COUNTS else float


def parse(words: Sequence[str]) -> Namespace:
    """Parse the command and its options; `@FILE` stands for the words in a file.

    What comes later wins, whole lists too. Of the result, `usual` are the defaults, `options` what
    a settings file keeps, `words` a line that says the same, `files` those that were read,
    `filed` the names whose values are from one, `inputs` is for their hash.
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
    given, line = top.parse_args(words[:1]), words[1:]
    parser, some_of = parser_of(given.command), parser_of(given.command)
    usual = {one.dest: one.default for one in parser._actions if one.dest != "help"}
    for action in some_of._actions:  # each part has some
        action.default = SUPPRESS  # values of a list are not added to the usual ones
        action.required = False
        if not action.option_strings:
            action.nargs, action.default = "*" if action.nargs == "+" else "?", None
    parts = []
    for of_files, some in groupby(line, lambda word: word[:1] == "@"):
        typed = [*some]
        parts += [(one[1:], words_of(one[1:])) for one in typed] if of_files else [("", typed)]
    found, filed = Values(), set[str]()
    for file, part in parts:
        try:
            own = {n: v for n, v in vars(some_of.parse_args(part)).items() if v not in (None, [])}
        except InputError as error:
            raise InputError(f"{file}: {error}" if file else str(error)) from None
        found, filed = found | own, filed | own.keys() if file else filed - own.keys()
    parser.parse_args([word for _, words in parts for word in words])  # all there, and no more
    options = {n: v for n, v in (usual | found).items() if f"--{n}" not in TYPED}
    if os.path.isfile(options.get("potential") or ""):
        options["potential"] = Path(options["potential"])
    return Namespace(
        **vars(given) | usual | found,
        usual=usual,
        options=options,
        words=words_for(parser, {n: v for n, v in found.items() if n in options}),
        files=[Path(word[1:]) for word in line if word[:1] == "@"],
        filed=filed,
        inputs="",
    )


def words_for(parser: Parser, values: Values) -> list[str]:
    """Words of a line that has these values."""
    words: list[str] = []
    for action in parser._actions:
        if action.dest in values:
            words += action.option_strings[:1]
            if action.nargs != 0:
                words += map(str, as_list(values[action.dest]))
    return words


def as_list(value: Any) -> list[Any]:
    """A list as it is, any other value as the only one of a list."""
    return value if isinstance(value, list) else [value]


def words_of(path: str) -> list[str]:
    """Read the words of a settings file, which are quoted as in a shell."""
    text = content(path)
    if b"\0" in text:
        raise InputError(f"{path}: expected words of a command, got what is no text")
    try:
        words = shlex.split(text.decode("utf-8-sig"), comments=True)
    except ValueError as error:
        raise InputError(f"{path}: expected words of a command ({error})") from None
    if typed := [word for word in words if word in TYPED]:
        raise InputError(f"{path}: expected no {typed[0]}, which is typed")
    return words


def check_output(given: Namespace) -> None:
    """Refuse, before anything is done, to overwrite inputs, what is no file, and, but for
    --overwrite, what the command with the same options and inputs did not write so."""
    if not hasattr(given, "out"):
        return
    if given.command not in WRITTEN:
        destination(given.out)
        if given.out.suffix not in (".h5", ".hdf5"):
            raise InputError(f"out: expected a .h5 file, got {given.out.name}")
    elif given.out.exists() and not given.out.is_dir():
        raise InputError(f"out: expected a folder, {given.out} is a file")
    kept, made = results(given)
    taken = {os.path.realpath(given.out), *map(str, map(destination, made))}
    words = re.split(r"[\s;,=()\"']+", given.options.get("calculator") or "")
    read = given.options | {"calculator": [*map(Path, filter(os.path.isfile, words))], "out": None}
    paths = [(n, p) for n, value in read.items() for p in as_list(value) if isinstance(p, Path)]
    for name, path in [*paths, *(("files", file) for file in given.files)]:
        if os.path.realpath(path) in taken:
            raise InputError(f"out: {path} is read ({name}); name another place")
    if not given.inputs:  # as they are before they are read, of a folder all in it
        files = (file for _, path in paths for file in (path, *sorted(path.glob("[!.]*"))))
        marks = "".join(map(hash_of, filter(Path.is_file, files)))
        given.inputs = hashlib.sha256(marks.encode()).hexdigest()
    if given.command != "coarse-grain":  # which adds to a data set
        check_made(given, kept, made)


def results(given: Namespace) -> tuple[Path, dict[str, str]]:
    """Settings file of a command, and paths of what is there that it writes, not yet hashed."""
    if names := WRITTEN.get(given.command):
        kept = given.out / f"{given.command}.txt"
        there = [path for name in names.split() for path in sorted(given.out.glob(name))]
    else:
        kept, there = beside(given.out, "solve"), [given.out] * given.out.exists()
    return kept, dict.fromkeys(map(str, there), "")


def beside(out: Path, end: str) -> Path:
    """Settings file of a data file; those of a .h5 and a .hdf5 file are two."""
    return out.with_suffix(f".{end}{out.suffix.removeprefix('.h5')}.txt")


def hash_of(path: Path) -> str:
    """SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_made(given: Namespace, kept: Path, made: Mapping[str, str]) -> None:
    """Raise InputError, but for --overwrite, unless a settings file says that a command with the
    same options and inputs wrote what has these hashes, or began to, and no other wrote it."""
    if not made or given.overwrite:
        return
    own = {*lines_in(kept)}
    begun, marks = ({*hashes(given, kept, one)} for one in (BEGUN, made))
    theirs = (marks - begun & {*lines_in(file)} for file in kept.parent.glob("*.txt"))
    if not (marks <= own or (begun <= own and not any(theirs))):
        raise InputError(
            f"{next(iter(made))}: is there already, not by these settings and inputs, or changed "
            "since; name another, or --overwrite"
        )


def hashes(given: Namespace, kept: Path, made: Mapping[str, str]) -> list[str]:
    """Lines of a settings file: hashes of the options, their paths as they lie from there, of all
    that was read, and of what was written, where it has none yet."""
    home, options = os.path.realpath(kept.parent), dict(given.options)
    options.pop("jobs", None)  # which change no result
    text = json.dumps(
        options, sort_keys=True, default=lambda path: os.path.relpath(os.path.realpath(path), home)
    )
    own = {"options": hashlib.sha256(text.encode()).hexdigest(), "inputs": given.inputs or "-"}
    every = {**own, **made}.items()
    return [f"{HASH}{m or hash_of(Path(n))}  {os.path.basename(n)}" for n, m in every]


def lines_in(kept: Path) -> list[str]:
    """Lines of a file that holds the words of a command, none of another."""
    text = content(kept) if kept.is_file() else b""
    return text.decode("utf-8", "replace").split("\n") if text.startswith(MADE.encode()) else []
