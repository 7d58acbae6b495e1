"""Files of long runs: checkpoints (one HDF5 file of arrays on nodes and plain values) and records.
On ranks the first writes them, in the order of the whole body: the same from any number of them."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import os
import re
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_peri import __version__
from warp_peri.errors import ALONE, InputError, StrPath, agreed
from warp_peri.files.atomic import check_hdf5, meshio_of, parsed, whole_file, write_text, write_vtu

PLAIN = (bool, int, float, complex, str, bytes, tuple, list, dict, np.ndarray, np.generic)
"""What a module may hold for a function to read; what lives, as os.environ, is none of it."""
OF_A_FIT = ("sha256", "certificate", "proven", "provenance")
"""Of a material's file, which a second fit of the same numbers has otherwise."""


class AllNodes:
    """All nodes of a body in one process; pieces of them are mpi.NodeHalo.

    Attributes:
        own: which of the nodes here are this process's own.
        number: of the nodes here in the whole body, shape [m]; None where these are all.
        count: nodes of the whole body.
    """

    own: Any = slice(None)
    number: np.ndarray | None = None
    comm: Any = ALONE

    def __init__(self, count: int) -> None:
        self.count = count

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sum of values [n, ...] over all nodes, whoever has them, shape [...]."""
        return np.asarray(values.sum(axis=0))

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Values [n, ...] of the own nodes gathered on all nodes of the body."""
        return values

    def mark(self, *parts: Any) -> str:
        """Fingerprint of arrays on the nodes here, and of other values."""
        return fingerprint(*parts)


def fingerprint(*parts: Any) -> str:
    """SHA-256 of values, by which a file kept beside a run knows what the run depends on.

    Arrays count with kind and shape; data classes (points, samples, settings, problems) with all
    their fields; materials with what their file holds; functions with their code and the values
    that it reads; other objects with their attributes; numbers alike whatever type they are of. The
    version of the library counts, too.
    """
    digest = hashlib.sha256(__version__.encode())
    for text in _spelled(parts):
        digest.update(f"{len(text)}:".encode() + text)
    return digest.hexdigest()


def _spelled(part: Any, above: frozenset[int] = frozenset()) -> Iterator[bytes]:
    """Bytes that tell a value from others; `above` are those that it is a part of."""
    if hasattr(part, "detach"):  # of torch
        part = part.detach().cpu()
    if hasattr(part, "numpy") and not isinstance(part, type):  # and of Warp
        part = part.numpy()
    inside = above | {id(part)}
    if isinstance(part, (int, np.integer, np.bool_)):
        yield repr(int(part)).encode()
    elif isinstance(part, (float, np.floating)):
        number = float(part)
        yield repr(int(number) if number.is_integer() else number).encode()
    elif isinstance(part, complex):
        yield repr(complex(part)).encode()
    elif isinstance(part, np.ndarray) and part.dtype != object:
        yield from (part.dtype.str.encode(), repr(part.shape).encode(), part.tobytes())
    elif id(part) in above:
        yield b"above"
    elif isinstance(part, Mapping):
        named = sorted(((repr(key), key) for key in part), key=lambda pair: pair[0])
        yield from _spelled([(name, part[key]) for name, key in named], inside)
    elif isinstance(part, (set, frozenset)):
        yield b"set"
        yield from _spelled(sorted(map(fingerprint, part)), inside)
    elif isinstance(part, (list, tuple, np.ndarray)):
        yield f"{len(part)} of".encode()
        for one in part:
            yield from _spelled(one, inside)
    elif inspect.iscode(part):
        yield part.co_code
        yield from _spelled([part.co_consts, part.co_names], inside)
    elif inspect.isroutine(part) and hasattr(part, "__code__"):
        given = getattr(part, "__defaults__", None), getattr(part, "__kwdefaults__", None)
        bound = getattr(part, "__self__", None)
        yield from _spelled([part.__code__, given, _read_by(part), bound], inside)
    elif isinstance(part, partial):
        yield from _spelled([part.func, part.args, part.keywords], inside)
    elif isinstance(part, (str, bytes, os.PathLike)):
        yield repr(os.fspath(part)).encode()
    elif isinstance(part, type):
        yield f"{part.__module__}.{part.__qualname__}".encode()
        yield from _spelled(_methods(part), inside)
    elif hasattr(part, "content"):
        yield from _spelled(_lasting(part.content()), inside)
        yield from _spelled(getattr(part, "state_dict", dict)(), inside)  # of networks
        yield from _spelled(getattr(part, "unfiled", {}), inside)
    elif dataclasses.is_dataclass(part):
        yield type(part).__name__.encode()
        fields = (field.name for field in dataclasses.fields(part))
        yield from _spelled([(name, getattr(part, name)) for name in fields], inside)
    else:
        yield re.sub(r" at 0x[0-9a-f]+", "", repr(part)).encode()
        slots = (getattr(kind, "__slots__", ()) for kind in type(part).__mro__)
        names = [name for some in slots for name in ([some] if isinstance(some, str) else some)]
        own = {name: getattr(part, name, None) for name in names if name[:2] != "__"}
        own |= getattr(part, "__dict__", {})
        made = [n for n in own if isinstance(getattr(type(part), n, None), cached_property)]
        yield from _spelled({name: own[name] for name in own if name not in made}, inside)
        yield from _spelled(_methods(type(part)), inside)


def _read_by(function: Any) -> dict[str, Any]:
    """Values that a function encloses, or reads of its module and of those it names, by name."""
    names, code = set[str](), [function.__code__]
    for one in code:  # those of what is defined inside, too
        names |= {*one.co_names}
        code += filter(inspect.iscode, one.co_consts)
    read = {**inspect.getclosurevars(function).nonlocals}
    spaces = [getattr(function, "__globals__", {})]
    spaces += [vars(read.pop(name)) for name in [*read] if inspect.ismodule(read[name])]
    for place, known in enumerate(spaces):
        for name in sorted(names & known.keys()):
            one = known[name]
            if inspect.ismodule(one):
                spaces += [vars(one)] * all(vars(one) is not other for other in spaces)
            elif (
                one is not function and (one.__module__ == function.__module__ or _is_users(one))
                if inspect.isroutine(one) or isinstance(one, type)
                else not place or isinstance(one, PLAIN)
            ):
                read[f"{place} {name}"] = one
    return read


def _methods(kind: type) -> dict[str, Any]:
    """Methods and plain values of a user's own class, by name."""
    if not _is_users(kind):
        return {}
    found: dict[str, Any] = {above.__qualname__: _methods(above) for above in kind.__bases__}
    for name, one in vars(kind).items():
        for inner in ("__func__", "fget", "func"):  # of static and class methods, of properties
            one = getattr(one, inner, one)
        if inspect.isfunction(one) or (isinstance(one, PLAIN) and name[0] + name[-1] != "__"):
            found[name] = one
    return found


@cache
def _installed() -> list[Path]:
    """Folders of Python's own modules, of installed packages, and of this one."""
    paths = sysconfig.get_paths()
    names = ("stdlib", "purelib", "platlib")
    return [*(Path(paths[name]) for name in names), Path(__file__).parents[1]]


def _is_users(one: Any) -> bool:
    """Whether code is of no installed package: a script's, a notebook's, of a module beside it."""
    file = Path(getattr(sys.modules.get(one.__module__ or ""), "__file__", None) or "")
    return not any(map(file.is_relative_to, _installed()))


def _lasting(content: Any) -> Any:
    """Contents of a material's file that determine the material."""
    if not isinstance(content, dict):
        return content
    return {key: _lasting(one) for key, one in content.items() if key not in OF_A_FIT}


def same(comm: Any, **parts: Any) -> None:
    """Raise InputError on all ranks for the first of `parts` that differs, naming a rank."""
    with agreed(comm):
        mine = {name: fingerprint(part) for name, part in parts.items()}
    first, *others = comm.allgather(mine)
    for rank, theirs in enumerate(others, 1):
        for name in [*first, *theirs]:
            if first.get(name) != theirs.get(name):
                raise InputError(f"{name}: expected the same on all ranks, rank {rank} has another")


class RunFile:
    """File of a run, there or not: arrays on the nodes of a body, and plain values, with a hash.
    `kind` is checked on reading; `nodes` are this process's, as AllNodes."""

    def __init__(self, path: StrPath, kind: str, nodes: Any) -> None:
        self.path, self.kind, self.nodes = Path(path), kind, nodes

    def write(self, nodal: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Write arrays [n, ...] on the own nodes, and JSON values; all ranks come here."""
        nodes, comm = self.nodes, self.nodes.comm
        number = None if nodes.number is None else nodes.number[nodes.own]
        text = np.frombuffer(json.dumps(values).encode(), np.uint8)
        whole = gathered(comm, nodal, number, nodes.count)
        head = {"format": self.kind, "mark": self._mark(nodal, text)}
        with agreed(comm):
            if comm.rank == 0:
                write_arrays(self.path, whole | {"values": text}, head)

    def _mark(self, nodal: Mapping[str, np.ndarray], text: np.ndarray) -> str:
        """Fingerprint of arrays on the own nodes, and of the first rank's values."""
        own = getattr(self.nodes, "piece", self.nodes)
        values = self.nodes.comm.bcast(fingerprint(text))
        return str(own.mark(*(nodal[name] for name in sorted(nodal)), values))

    def read(
        self, like: Mapping[str, np.ndarray]
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """Read arrays on all nodes here, of the names, shapes and types of others, and the values;
        None where there is no file yet. InputError for a file of another kind, and one that is not
        read."""
        nodes, comm = self.nodes, self.nodes.comm
        if not comm.bcast(self.path.exists()):
            return None
        rows = dict.fromkeys(like, nodes.number) | {"values": None}
        with agreed(comm):
            found, attributes = read_arrays(self.path, rows)
            try:
                if attributes.get("format") != self.kind:
                    raise ValueError(f"expected one of {self.kind}")
                for name, one in like.items():
                    if (found[name].shape, found[name].dtype) != (one.shape, one.dtype):
                        raise ValueError(f"{name} is of another number of nodes, or another kind")
                text = found.pop("values")
                values = parsed(text.tobytes())
            except ValueError as error:
                raise InputError(f"{self.path}: not a readable checkpoint ({error})") from None
        if str(attributes.get("mark")) != self._mark({n: found[n][nodes.own] for n in found}, text):
            raise InputError(f"{self.path}: the contents are not what was written")
        return found, values


class ArrayFile:
    """Checkpoint of one process: arrays by name, written whole or not at all, or nowhere. `key` is
    what the run depends on, `other` names another key's checkpoint in errors."""

    def __init__(self, path: StrPath | None, key: str, other: str) -> None:
        self.path, self.key, self.other = None if path is None else Path(path), key, other

    def write(self, arrays: Mapping[str, Any]) -> None:
        """Write a checkpoint's arrays, or values that make them."""
        if self.path is not None:
            made = {name: np.asarray(one) for name, one in arrays.items()}
            write_arrays(self.path, made, {"key": self.key, "mark": fingerprint(made)})

    def read(self) -> dict[str, np.ndarray] | None:
        """Arrays of the checkpoint; None where there is no file yet; InputError for a file of
        another run, and one that is not read."""
        if self.path is None or not self.path.exists():
            return None
        arrays, head = read_arrays(self.path)
        if str(head.get("key")) != self.key:
            raise InputError(f"{self.path}: the checkpoint of {self.other}")
        if str(head.get("mark")) != fingerprint(arrays):
            raise InputError(f"{self.path}: not a readable checkpoint, not what was written")
        return arrays


def gathered(comm: Any, arrays: Mapping[str, np.ndarray], own: Any, count: int) -> dict[str, Any]:
    """Whole arrays by name on the first rank, empty on others: from rows [n, ...], their places in
    the whole and how many it has, the places None where they are the whole."""
    whole: dict[str, np.ndarray] = {}
    for name, mine in arrays.items():
        for values, place in comm.gather((mine, own)) or ():
            if place is None:
                whole[name] = values
            else:
                shape = (count, *values.shape[1:])
                whole.setdefault(name, np.empty(shape, values.dtype))[place] = values
    return whole


def write_arrays(
    path: StrPath, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any]
) -> None:
    """Write an HDF5 file of arrays whole or not at all; InputError where it cannot be written."""
    try:
        with whole_file(path) as part, h5py.File(part, "w", locking=False) as file:
            for name, values in arrays.items():
                file[name] = values
            file.attrs.update(attributes)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from None


def read_arrays(
    path: StrPath, place: Mapping[str, np.ndarray | None] | None = None
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read rows at places of arrays by name (None, or no name: all), and the attributes; InputError
    for a file that is none or lacks an array."""
    found = {}
    try:
        with h5py.File(path, locking=False) as file:
            check_hdf5(file, os.path.getsize(path))
            for name, rows in (dict.fromkeys(file) if place is None else place).items():
                one, offset = file[name], file[name].id.get_offset()
                if one.dtype.kind not in "biufc":  # bytes of anything else would be pointers
                    raise ValueError(f"{name} holds no numbers")
                whole = np.memmap(path, one.dtype, "r", offset, one.shape) if one.size else one
                found[name] = np.array(whole[()] if rows is None else whole[rows])
            return found, dict(file.attrs)
    except (OSError, RuntimeError, LookupError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a readable checkpoint ({error})") from None


class TimeSeriesWriter:
    """Writer of a motion's records for ParaView, the same from any number of ranks: a file
    `record_<step>.vtu` of each, and `motion.pvd`, which names them with their times.

    Args:
        folder: for the files; made if it is not there.
        nodes: those of this process, as checkpoint.AllNodes or mpi.Subdomain.
        x: their positions, shape [n, d], where the nodes have none themselves.
    """

    def __init__(self, folder: StrPath, nodes: Any, x: np.ndarray | None = None) -> None:
        meshio_of()
        self.folder, self.nodes = Path(folder), nodes
        self.x = nodes.x if x is None else x
        self.times: dict[str, float] = {}

    def write(self, step: int, time: float, fields: Mapping[str, np.ndarray]) -> None:
        """Write one record of the motion; vectors in the plane get a third component."""
        nodes, name = self.nodes, f"record_{step:08d}.vtu"
        self.times[name] = time
        parts = {"positions": self.x, **fields}
        whole = gathered(nodes.comm, parts, nodes.number, nodes.count)
        with agreed(nodes.comm):
            if nodes.comm.rank == 0:
                x = whole.pop("positions")
                write_vtu(self.folder / name, x, ("vertex", np.arange(len(x))[:, None]), whole)
                lines = [f'<DataSet timestep="{t!r}" file="{n}"/>' for n, t in self.times.items()]
                text = "\n".join(['<VTKFile type="Collection"><Collection>', *lines])
                write_text(self.folder / "motion.pvd", text + "\n</Collection></VTKFile>\n")
