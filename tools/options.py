"""Options of a script: its docstring as help, and a table of names, defaults and words."""

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

from warp_peri.errors import InputError
from warp_peri.files.atomic import written
from warp_peri.points.arguments import LARGEST, Bound

Folder = Annotated[
    Path, Bound("a folder or a new name", lambda path: path.resolve().name and not path.is_file())
]
NewFile = Annotated[
    Path, Bound("a file or a new name", lambda path: path.resolve().name and not path.is_dir())
]
JOBS = -1, "processes; -1 is one for each core", Annotated[
    int, Bound("a number of processes ≥ 1, or -1", lambda value: value >= 1 or value == -1)
]  # fmt: skip
Table = Mapping[str, tuple[Any, ...]]
RUNS = Path(__file__).resolve().parent.parent / "runs"


def at_least(count: int) -> Any:
    """The kind of whole numbers from this one on."""
    return Annotated[int, Bound(f"a whole number ≥ {count}", lambda value: value >= count)]


def one_of(words: Sequence[str]) -> Any:
    """The kind of these words."""
    return Annotated[str, Bound(f"of {', '.join(words)}", words.__contains__)]


def check_new(folder: Path, *names: str) -> None:
    """Raise InputError where a folder has files of such names."""
    for file in (file for name in names for file in folder.glob(name)):
        raise InputError(f"{file}: is there already; name another folder, or move it away")


def fields_of(kind: type, words: str) -> dict[str, tuple[Any, ...]]:
    """Options for the fields of a dataclass: their defaults and, by their hints, their bounds."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: (getattr(kind, name), words, hint) for name, hint in hints.items()}


def reading(kind: Any) -> Callable[[str], Any]:
    """How argparse reads a value of a kind, which may have a Bound; numbers are finite."""
    of, bound = get_args(kind) or (kind, None)

    def read(text: str) -> Any:
        try:
            value = of(text)
        except re.error as error:
            raise argparse.ArgumentTypeError(f"expected a pattern ({error}), got {text}") from None
        finite = of not in (int, float) or abs(value) <= LARGEST
        if not finite or (bound and not bound.holds(value)):
            words = bound.words if bound else "a finite number"
            raise argparse.ArgumentTypeError(f"expected {words}, got {text}")
        return value

    read.__name__ = of.__name__  # of a text that is none
    return read


class Options(argparse.ArgumentParser):
    """A parser whose help is a module's docstring, as it stands.

    Args:
        doc: the docstring.
        out: a folder in runs/, for --out, which is made.
        options: by name, a default and the help, and a kind where one with a Bound is expected.
            The default of a list is a list; a tuple of words is a choice, of which the first is
            taken; False is a flag; a type in place of a default stands for none.
    """

    def __init__(self, doc: str | None, out: str = "", *, options: Table | None = None) -> None:
        formatter = argparse.RawDescriptionHelpFormatter
        super().__init__(description=doc, formatter_class=formatter)
        every, self._lists = dict(options or {}), {}
        if out:
            every["out"] = RUNS / out, "folder for the results", Folder
        self._makes = bool(out)
        for name, (default, words, *bound) in every.items():
            one = default[0] if isinstance(default, list) else default
            kind = bound[0] if bound else one if isinstance(one, type) else type(one)
            how: dict[str, Any] = {"type": reading(kind), "default": default}
            if default is False:
                how = {"action": "store_true"}
            elif isinstance(default, type):
                del how["default"]
            elif isinstance(default, tuple):
                how = {"choices": default, "default": default[0]}
            elif isinstance(default, list):
                how["nargs"] = "+"
            told = f" (default: {how['default']})" if how.get("default") not in (None, "") else ""
            if isinstance(default, list):  # replaced by what is typed, which adds up
                self._lists[name] = default
                how |= {"action": "extend", "default": argparse.SUPPRESS}
            self.add_argument(
                f"--{name.replace('_', '-')}", **how, help=(words + told).replace("%", "%%")
            )

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """What is given; the folder of results is made."""
        given = super().parse_args(args, namespace)
        vars(given).update(self._lists | vars(given))
        if self._makes:
            with written(given.out):
                given.out.mkdir(parents=True, exist_ok=True)
        return given
