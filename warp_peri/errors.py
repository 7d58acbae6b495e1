"""The exception for bad input, on which processes agree, warnings, values frozen or as tables."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

from numpy import ndarray

StrPath: TypeAlias = str | os.PathLike[str]
"""Path of a file or folder."""
Rows: TypeAlias = list[tuple[str, str]]
"""Name and value of each line of a summary table."""
Values: TypeAlias = dict[str, Any]
"""Values by name."""
Several: TypeAlias = tuple[ndarray, ...]
"""Arrays, which a docstring tells apart."""
Arrays: TypeAlias = dict[str, ndarray]
"""Arrays by name."""
Shape: TypeAlias = tuple[int, ...]
"""Of an array or grid: whole numbers, one for each axis."""
LAST_WORDS: list[Callable[[str, int], None]] = []
"""What ends all processes of a run that has many, given a line to say and the exit status."""
OF_POSITIONS = "expected a function of positions, an array [N, d]"
"""What users' fields are, for errors."""
LONGEST = 2000
"""Characters of a message; what a file holds may be repeated in it, and may be long."""


class InputError(ValueError):
    """Bad input; the message says what was expected and what came, in one printable line.

    Args:
        message: what `str` makes one line of, cut to LONGEST characters.

    >>> wp.Points(x, x, spacing=5.0)
    Traceback (most recent call last):
    InputError: interior: expected bool values, got float64
    """

    motion: Any = None
    """Of a crack run that ends so: the Motion until then."""

    def __init__(self, message: object) -> None:
        shown = printable(" ".join(str(message)[: 4 * LONGEST].split()))
        super().__init__(shown if len(shown) <= LONGEST else shown[:LONGEST] + " …")


def printable(line: str) -> str:
    """Escape the characters of a line that could control a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


_EARS: ContextVar[tuple[tuple[list[str], ...], bool]] = ContextVar("warnings", default=((), True))
"""Lists that hear this thread's warnings, and whether they are said aloud."""
_HOME = str(Path(__file__).parent)


def warn(text: str) -> None:
    """Issue a warning, once inside `heard`, at the line that called the library."""
    lists, aloud = _EARS.get()
    known = any(text in each for each in lists)
    for each in lists:
        each.append(text)
    if aloud and not known:
        frame, level, outer = sys._getframe(), 0, 1
        while (frame := frame.f_back) is not None:  # type: ignore[assignment]
            level += 1
            if frame.f_code.co_filename.startswith(_HOME):
                outer = level
        warnings.warn(text, stacklevel=outer + 2)


@contextmanager
def heard() -> Iterator[list[str]]:
    """Collect the texts of this thread's warnings inside, which are issued all the same."""
    lists, aloud = _EARS.get()
    texts: list[str] = []
    token = _EARS.set(((*lists, texts), aloud))
    try:
        yield texts
    finally:
        _EARS.reset(token)


@contextmanager
def quietly(wanted: bool = True) -> Iterator[None]:
    """Suppress this thread's warnings inside, where that is wanted."""
    token = _EARS.set(((), False) if wanted else _EARS.get())
    try:
        yield
    finally:
        _EARS.reset(token)


class Alone:
    """Communicator of a process that shares its work with none."""

    rank, size = 0, 1

    def bcast(self, value: Any) -> Any:
        """Value that the first process has."""
        return value

    def allgather(self, value: Any) -> list[Any]:
        """Values that all processes have."""
        return [value]

    gather = allgather


ALONE = Alone()


@contextmanager
def agreed(comm: Any) -> Iterator[None]:
    """Raise on all ranks what any meets inside, an InputError on others; no rank may wait there."""
    mine: Exception | None = None
    try:
        yield
    except Exception as error:
        mine = error
    told = [words for words in comm.allgather(mine and (str(mine) or repr(mine))) if words]
    if told:
        raise mine or InputError(told[0])


def called(what: str, given: Any, *of: Any, **named: Any) -> Any:
    """What a user's function gives, or a value that is none; an InputError that begins with `what`
    was expected where it fails."""
    try:
        return given(*of, **named) if callable(given) else given
    except InputError:
        raise
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as e:
        raise InputError(f"{what}, got {e}") from e


_sharing: list[Any] = []
"""The communicator of mpi4py whose ranks share work, in `shared_by`."""


@contextmanager
def shared_by(comm: Any) -> Iterator[None]:
    """Share the work of `in_blocks` inside among ranks, all of which must come here."""
    _sharing.append(comm)
    try:
        yield
    finally:
        _sharing.pop()


def sharing() -> Any:
    """Communicator of the ranks that share work here; None of one process alone."""
    return _sharing[-1] if _sharing else None


def optional(module: str, without: str) -> Any:
    """Import a module of an extra; InputError, which says `without`, where it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        raise InputError(without) from None


def exit_status(
    work: Callable[[], int | None], interrupted: str = "what is finished is kept", *, name: str = ""
) -> int:
    """Run a command's work and return its exit status: its own or 0; 130 after Ctrl-C, which says
    `interrupted`; 2 for bad input; 1 after a failure, such as a full disk. `name` begins the
    message."""
    begin = f"{name}: " if name else ""
    for stream in (sys.stdout, sys.stderr):  # a terminal without λ shows its number
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    try:
        return work() or 0
    except KeyboardInterrupt:
        print(f"interrupted; {interrupted}", file=sys.stderr)
        return 130
    except InputError as error:
        return _ended(f"{begin}error: {error}", 2)
    except (OSError, RuntimeError) as error:  # also of HDF5, which spreads them over lines
        return _ended(f"{begin}error: {' '.join(str(error).split())}", 1)


def _ended(line: str, status: int) -> int:
    for last in LAST_WORDS:
        last(line, status)
    print(line, file=sys.stderr)
    return status


class Shown:
    """Base of values shown as a table of their `rows`, in text and in notebooks."""

    def rows(self) -> Rows:
        """Name and value of each line of the table."""
        return []

    def __repr__(self) -> str:
        rows = self.rows()
        width = max((len(name) for name, _ in rows), default=0)
        return "\n".join([type(self).__name__, *(f"  {n:{width}}  {value}" for n, value in rows)])

    def _repr_html_(self) -> str:
        row = "<tr><th style='text-align:left'>{}</th><td>{}</td></tr>"
        cells = "".join(row.format(escape(name), escape(value)) for name, value in self.rows())
        return f"<table>{cells}</table>"


class InSpace:
    """Base of what has positions x, shape [N, d]."""

    x: ndarray

    @property
    def dimension(self) -> int:
        """Dimension of space: 2 or 3."""
        return int(self.x.shape[1])


def kept(value: Any) -> Any:
    """A read-only copy of an array, or of those in a dict; other values as they are."""
    if isinstance(value, dict):
        return {name: kept(one) for name, one in value.items()}
    if isinstance(value, ndarray):
        value = value.copy()
        value.flags.writeable = False
    return value


def hold(frozen: Any, **fields: Any) -> None:
    """Set fields, of a frozen dataclass too, as `kept`, so that proofs stay true."""
    for name, value in fields.items():
        object.__setattr__(frozen, name, kept(value))


class Held:
    """Base of frozen dataclasses whose fields are set by `hold`, in copies too."""

    def __setstate__(self, state: Values) -> None:
        hold(self, **state)


def error_rows(errors: Values) -> Rows:
    """Table lines of E_res and E_u on data sets, by name."""
    rows = []
    for name, table in errors.items():
        known = table if isinstance(table, dict) else {}
        parts = [f"{e} {known[e]:.2%}" for e in ("E_res", "E_u") if known.get(e) is not None]
        if parts:
            rows.append((f"errors on {name}", ", ".join(parts)))
    return rows
