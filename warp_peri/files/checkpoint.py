"""Checkpoints of long runs: each one HDF5 file of arrays on nodes and plain values. On ranks the
first writes it, in the order of the whole body: the same from any number of them."""

from __future__ import annotations

import json
import os
import re
import sys
import sysconfig
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import fields, is_dataclass
from dis import get_instructions, hasconst
from functools import cache, cached_property
from hashlib import sha256
from importlib import import_module
from inspect import CO_NESTED, iscode, isfunction, ismodule, isroutine
from pathlib import Path
from types import CellType, FunctionType
from typing import Any, cast

import h5py
import numpy as np
from numpy import ndarray

from warp_peri import __version__
from warp_peri.errors import ALONE, Arrays, InputError, StrPath, Values, agreed, called
from warp_peri.files import atomic
from warp_peri.files.atomic import check_hdf5, locked, parsed, whole_hdf5, written

HELD = "__self__", "__func__", "fget", "code"
"""What methods, properties and what torch compiled hold that is no attribute."""
BY_TEXT = {"attrgetter", "eval", "exec", "getattr", "globals", "hasattr", "vars"}
"""By what code reads a name that it has as text."""
COPIED = "__reduce__", "__reduce_ex__", "__getstate__"
"""By what an object says how it is copied."""
CODE = "names varnames argcount posonlyargcount kwonlyargcount exceptiontable"
"""What code is told by, beside its instructions and the constants they read."""
PLAIN = "builtins collections decimal fractions functools operator pathlib types warp_peri"
"""Packages whose objects count with what they hold in functions that watch a motion, too."""
ASIDE = "__module__", "_abc_impl", "_value2member_map_", "_inverted_"
"""Attributes by which Python keeps where something is from, and how it was used."""
QUIET = "_thread logging threading weakref"
"""Modules of locks, logs and caches, which decide no number."""
UNORDERED = Mapping, set, frozenset
_OWN = f"{sysconfig.get_path('stdlib')}/", f"{Path(__file__).parents[1]}/"
OF_ALL = os.environ, np.random.mtrand._rand
"""What all of a process share, and no function is meant to depend on."""
HOMES = ("/site-packages/", "/dist-packages/", *_OWN)
"""Parts of paths of installed packages, of Python's own modules and of this library's."""
TRUSTED = "h5py matplotlib meshio numpy scipy torch tqdm warp warp_peri"
"""Installed packages of which no other version is looked for: those that the library works with."""
OF_A_FIT = "sha256", "certificate", "proven", "provenance", "versions", "errors"
"""Of a material's file, which a second fit of the same numbers has otherwise."""


def nodal_fingerprint(nodes: Any, *parts: Any) -> str:
    """Fingerprint of what arrays, of rows on these nodes or more, have on the own ones, whoever
    owns them, and of other values as printed."""
    number = np.arange(nodes.count) if nodes.number is None else nodes.number[nodes.own]
    arrays = [part[nodes.own][: len(number)] for part in parts if isinstance(part, ndarray)]
    others = [part for part in parts if not isinstance(part, ndarray)]
    marks = np.zeros((len(arrays), 2), np.uint64)
    with np.errstate(over="ignore"):
        start = _mixed(number.astype(np.uint64))
        for mark, array in zip(marks, arrays):
            flat, mixed = np.ascontiguousarray(array + 0.0, float).reshape(len(number), -1), start
            for column in flat.view(np.uint64).T:
                mixed = _mixed(mixed ^ column)
            mark[:] = mixed.sum(), _mixed(mixed).sum()
        sums = np.sum(nodes.comm.allgather(marks), axis=0)
    return sha256(sums.tobytes()).hexdigest() + repr(others)


class AllNodes:
    """All nodes of a body in one process; pieces of them are mpi.NodeHalo.

    Attributes:
        own: which of the nodes here are this process's own.
        number: of the nodes here in the whole body, shape [m]; None where these are all.
        count: nodes of the whole body.
    """

    own: Any = slice(None)
    number: ndarray | None = None
    comm: Any = ALONE
    mark = nodal_fingerprint

    def __init__(self, count: int) -> None:
        self.count = count

    def sum(self, values: ndarray) -> ndarray:
        """Sum of values [n, ...] over all nodes, whoever has them, shape [...]."""
        return np.asarray(values.sum(axis=0))

    def gather(self, values: ndarray) -> ndarray:
        """Values [n, ...] of the own nodes gathered on all nodes of the body."""
        return values


def _mixed(x: ndarray) -> ndarray:
    """Hash numbers by Splitmix64, a bijection that spreads every bit."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))


def fingerprint(*parts: Any, named: bool = False) -> str:
    """SHA-256 of values, by which a file kept beside a run knows what the run depends on.

    Arrays count with kind and shape; data classes (points, samples, settings, problems) with all
    their fields; materials with what their file holds; functions with their code and the values
    that it reads; other objects with their attributes, or (`named`) those of no class of the user's
    and not PLAIN by their type alone; numbers alike whatever type they are of. The version of the
    library counts, too. What only C knows, as a factorisation, differs.
    """
    leaves, holders, todo = dict[int, bytes](), dict[int, Any](), [parts := (__version__, *parts)]
    for part in todo:  # which keeps each, lest another gets its id
        if id(part) not in leaves:
            said, held = _spelled(part, named)
            leaves[id(part)] = told = sha256(said).digest()
            if held:
                holders[id(part)] = told, held, sorted if isinstance(part, UNORDERED) else list
                todo += held
    count, marks = 0, dict.fromkeys(holders, b"")
    while len(classes := {*marks.values()}) > count:  # by what is one step further within
        count, known, marks = len(classes), leaves | marks, {}
        for n, (told, held, order) in holders.items():
            marks[n] = sha256(told + b"".join(order(known[id(one)] for one in held))).digest()
    return sha256(b"".join([marks[id(parts)], *sorted(classes)])).hexdigest()


def _spelled(whole: Any, named: bool) -> tuple[bytes, list[Any]]:
    """Bytes that tell a value from others, and what it holds."""
    kind, said, data, held = cast(Any, type(whole)), "", b"", list[Any]()
    home, part = kind.__module__, _unwrapped(whole)
    if isinstance(part, (int, np.integer, np.bool_)):
        said = repr(int(part))
    elif isinstance(part, (float, complex, np.inexact)):
        number, real = complex(part), complex(part).real
        least = int(real) if real.is_integer() and str(real) != "-0.0" else real
        said = repr(number if number.imag else least)
    elif isinstance(part, ndarray) and part.dtype != object:
        part = part.astype(part.dtype.newbyteorder("="), copy=False)
        said, data = f"{part.dtype}{part.shape}", part.tobytes()
        held = [getattr(part, "mask", None)]
    elif isinstance(part, Mapping):
        held = [*((key, part[key]) for key in part), getattr(part, "default_factory", None)]
    elif isinstance(part, UNORDERED):
        said, held = "set", [*part]
    elif isinstance(part, (list, tuple, deque, ndarray)):
        said, held = f"{len(part)} of {getattr(part, 'maxlen', None)}", [*part]
    elif iscode(part):
        steps = [(s.opcode in hasconst, s) for s in get_instructions(part)]
        said = repr([(s.opcode, fixed or s.arg) for fixed, s in steps])
        held = [
            [part.co_consts[s.arg or 0] for fixed, s in steps if fixed],
            part.co_flags & ~CO_NESTED,
        ]
        held += [getattr(part, f"co_{name}") for name in CODE.split()]
    elif isfunction(part):
        home = part.__globals__.get("__name__")
        held = [part.__code__, part.__defaults__, part.__kwdefaults__, vars(part), _read_by(part)]
    elif isinstance(part, (str, bytes, os.PathLike)):
        said = repr(os.fspath(part))
    elif ismodule(part) or isinstance(part, type):
        home = getattr(part, "__module__", part.__name__)
        said = f"{home} {part.__name__}"
        if is_users(home):  # of one name as a script and as a module
            said = getattr(part, "__qualname__", "")
            own = vars(part).items()
            told = {n: v for n, v in own if n[:2] != "__" or isroutine(v) or callable(v)}
            held = [{n: told[n] for n in told.keys() - ASIDE}, getattr(part, "__bases__", ())]
    elif named and not (is_users(home) or derived(whole, *PLAIN.split())):
        said = f"{home} {kind.__qualname__} {getattr(part, '__name__', '')}"
    elif derived(whole, "warp_peri") and hasattr(kind, "content"):
        held = [_lasting(part.content()), getattr(part, "unfiled", {})]
    elif is_dataclass(part):
        said = kind.__name__
        held = [(one.name, getattr(part, one.name, None)) for one in fields(part)]
    else:
        said = kind.__name__
        held = [_attributes(part), [getattr(part, n, None) for n in HELD if hasattr(kind, n)]]
        held += _copied(part, named or any(held))
    held += installed(home)
    if derived(whole, "torch") and hasattr(kind, "state_dict"):  # of networks
        held += [part.state_dict()]
    if is_users(kind.__module__):  # it may be a subclass of any of these
        held += [kind, {n: one for n, one in _attributes(whole).items() if n not in OF_A_FIT}]
    return said.encode() + data, held


def _copied(part: Any, told: bool) -> Any:
    """What C keeps of an object: by what it is copied but for its attributes, or else as it prints;
    another each time where that tells nothing, nor do its attributes."""
    copied = [getattr(type(part), n) is getattr(object, n) for n in COPIED]
    try:
        return part.__reduce_ex__(4)[: 2 if all(copied) else None]
    except Exception:  # of what is not copied: a lock, a file
        text = re.sub(r" at 0x[0-9a-fA-F]+", "", repr(part))
        hidden = not told and ("(vectorized)" in text or text != repr(part))
        return [os.urandom(16) if hidden else text]


def _unwrapped(part: Any) -> Any:
    """NumPy's array of a tensor or buffer, words of numbers that Python has none for, or the same
    value."""
    if derived(part, "torch", "warp") and hasattr(part, "numpy"):
        try:
            return part.numpy(force=True) if hasattr(part, "detach") else part.numpy()
        except (TypeError, NotImplementedError):  # bfloat16, sparse ones, those without values
            return str(part.dtype), part.is_meta or part.to_dense().tolist()
    if derived(part, *QUIET.split()) or any(part is one for one in OF_ALL):
        return None
    if isinstance(part, np.vectorize):  # which keeps a ufunc once it is called
        return part.pyfunc, part.signature, part.excluded
    if isinstance(part, (np.timedelta64, np.longdouble)):  # more than numbers are told by
        return repr(part)
    return np.asarray(part) if isinstance(part, memoryview) else part


def _attributes(part: Any) -> Values:
    """Attributes of an object, in slots too, but for those that are worked out and kept."""
    state = object.__getstate__(part)
    own, slots = state if isinstance(state, tuple) else (state, None)
    found, kind = {**(own or {}), **(slots or {})}, type(part)
    worked = {n for n in found if isinstance(getattr(kind, n, 0), cached_property)}
    return {n: found[n] for n in found.keys() - ASIDE - worked}


def _read_by(function: FunctionType) -> Values:
    """Values that a function encloses and, of the user's, reads of its module, and of those of the
    user's that it names or imports, by name."""
    cells = zip(function.__code__.co_freevars, function.__closure__ or ())
    held = {name: cell.cell_contents for name, cell in cells if cell != CellType()}
    names, loaded, texts, code = set[str](), set[str](), set[str](), [function.__code__]
    spaces, read = [(held, {*held})], {}
    if is_users(str(function.__globals__.get("__name__"))):
        spaces += [(function.__globals__, loaded), (imported := {}, names)]
        for inner in code:  # those of what is defined inside, too
            names |= {*inner.co_names}
            texts |= {one for one in inner.co_consts if isinstance(one, str)}
            code += filter(iscode, inner.co_consts)
            for step in get_instructions(inner):
                if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                    loaded.add(step.argval)
                if step.opname == "IMPORT_NAME":
                    with suppress(Exception):
                        imported[step.argval] = import_module(step.argval)
        if loaded & BY_TEXT:
            loaded |= texts
    for place, (space, wanted) in enumerate(spaces):
        for name in sorted(wanted & space.keys()):
            one = space[name]
            if ismodule(one):
                if is_users(one.__name__) and all(vars(one) is not other for other, _ in spaces):
                    spaces += [(vars(one), names | loaded)]
                one = one.__name__, installed(one.__name__)
            read[f"{place} {name}"] = one
    return read


def derived(one: Any, *packages: str) -> bool:
    """Whether an object's class is of one of these packages, or derived from such a one."""
    return any(str(base.__module__).split(".")[0] in packages for base in type(one).__mro__[:-1])


@cache
def is_users(module: Any) -> bool:
    """Whether a module is of no installed package: a script, a notebook, a file beside it."""
    file = getattr(sys.modules.get(module), "__file__", None)
    known = any(home in file for home in HOMES) if file else module in sys.stdlib_module_names
    return isinstance(module, str) and (module == "__main__" or not known)


@cache
def installed(module: Any) -> list[str]:
    """What tells the version of the installed package of a module: a hash of all its Python files;
    nothing of the user's own, of Python's and of those that are TRUSTED."""
    file = str(getattr(sys.modules.get(module), "__file__", None))
    before, found, inside = file.rpartition("-packages/")
    top = Path(before + found, inside.split("/")[0])
    if not found or top.stem in TRUSTED.split():
        return []
    files = sorted(filter(Path.is_file, {*top.rglob("*.py"), Path(file)}))
    return [sha256(b"".join(map(Path.read_bytes, files))).hexdigest()]


def _lasting(content: Any) -> Any:
    """Contents of a material's file that determine the material."""
    if not isinstance(content, dict):
        return content
    return {key: _lasting(one) for key, one in content.items() if key not in OF_A_FIT}


def same(comm: Any, /, **parts: Any) -> None:
    """Raise InputError on all ranks for the first of `parts` that differs, naming a rank."""
    with agreed(comm):
        mine = {name: fingerprint(part) for name, part in parts.items()}
    first, *others = comm.allgather(mine)
    for rank, theirs in enumerate(others, 1):
        for name in [*first, *theirs]:
            if first.get(name) != theirs.get(name):
                raise InputError(f"{name}: expected the same on all ranks, rank {rank} has another")


@contextmanager
def held(comm: Any, *paths: Path) -> Iterator[None]:
    """Hold files against other jobs; InputError, on all ranks, where another holds one."""
    with ExitStack() as locks:
        with agreed(comm):
            for path in paths * (comm.rank == 0):
                locks.enter_context(locked(path))
        yield


class RunFile:
    """File of a run, there or not: arrays on the nodes of a body, and plain values, with a hash.
    `kind` is checked on reading; `nodes` are this process's, as AllNodes."""

    def __init__(self, path: StrPath, kind: str, nodes: Any) -> None:
        self.path, self.kind, self.nodes = Path(path), kind, nodes

    def write(self, nodal: Arrays, values: Values) -> None:
        """Write arrays [n, ...] on the own nodes, and JSON values; all ranks come here."""
        nodes, comm = self.nodes, self.nodes.comm
        number = None if nodes.number is None else nodes.number[nodes.own]
        text = np.frombuffer(json.dumps(values).encode(), np.uint8)
        whole = gathered(comm, nodal, number, nodes.count)
        head = {"format": self.kind, "mark": self._mark(nodal, text)}
        with agreed(comm):
            if comm.rank == 0:
                write_arrays(self.path, whole | {"values": text}, head)

    def _mark(self, nodal: Arrays, text: ndarray) -> str:
        """Fingerprint of arrays on the own nodes, and of the first rank's values."""
        own = getattr(self.nodes, "piece", self.nodes)
        values = self.nodes.comm.bcast(fingerprint(text))
        return str(own.mark(*(nodal[name] for name in sorted(nodal)), values))

    def read(self, like: Arrays) -> tuple[Arrays, Values] | None:
        """Read arrays on all nodes here, which fit others (rows_like), and the values; None where
        there is no file yet. InputError for a file of another kind, and one that is not read."""
        nodes, comm = self.nodes, self.nodes.comm
        if not comm.bcast(self.path.exists()):
            return None
        told = "format", self.kind, f"expected one of {self.kind}"
        with agreed(comm):
            found, mark = read_arrays(self.path, like | {"values": np.zeros(0, "u1")}, told, nodes)
            text = found.pop("values")
            values = called(f"{self.path}: expected values in JSON", parsed, text.tobytes())
        if mark != self._mark({n: found[n][nodes.own] for n in found}, text):
            raise InputError(f"{self.path}: the contents are not what was written")
        return found, values


class ArrayFile:
    """Checkpoint of one process: arrays by name, written whole or not at all, or nowhere. `key` is
    what the run depends on, `other` names another key's checkpoint in errors."""

    def __init__(self, path: StrPath | None, key: str, other: str) -> None:
        self.path, self.key, self.other = None if path is None else Path(path), key, other

    def write(self, arrays: Values) -> None:
        """Write a checkpoint's arrays, or values that make them."""
        if self.path is not None:
            made = {name: np.asarray(one) for name, one in arrays.items()}
            write_arrays(self.path, made, {"key": self.key, "mark": fingerprint(self.key, made)})

    def read(self, like: Values) -> Arrays | None:
        """Arrays of the checkpoint, which fit others (rows_like); None where there is no file yet;
        InputError for a file of another run, and one that is not read."""
        if self.path is None or not self.path.exists():
            return None
        told = f"the checkpoint of {self.other}"
        arrays, mark = read_arrays(self.path, like, ("key", self.key, told))
        if mark != fingerprint(self.key, arrays):
            raise InputError(f"{self.path}: not a readable checkpoint (not what was written)")
        return arrays


def rows_like(name: str, found: Any, like: Any, nodes: Any) -> Any:
    """Rows that `nodes` have here of an array that is not read yet. ValueError unless it is of the
    type and shape of another, and of what is empty there any number of rows, all of which count."""
    like, number = np.asarray(like), getattr(nodes, "number", None)
    first = like.shape[:1] if number is None else (nodes.count,)
    if not like.size:
        first, number = found.shape[:1] or (0,), None
    if (found.shape, found.dtype) != ((*first, *like.shape[1:]), like.dtype):
        raise ValueError(f"{name} is of another number of nodes, or another kind")
    return () if number is None else number


def gathered(comm: Any, arrays: Arrays, own: Any, count: int) -> Values:
    """Whole arrays by name on the first rank, empty on others: from rows [n, ...], their places in
    the whole and how many it has, the places None where they are the whole."""
    whole = {}
    for name, mine in sorted(arrays.items()):  # on all ranks in one order
        for values, place in comm.gather((mine, own)) or ():
            if place is None:
                whole[name] = values
            else:
                shape = (count, *values.shape[1:])
                whole.setdefault(name, np.empty(shape, values.dtype))[place] = values
    return whole


def write_arrays(path: StrPath, arrays: Arrays, attributes: Values) -> None:
    """Write an HDF5 file of arrays whole or not at all; InputError where it cannot be written."""
    with written(path), whole_hdf5(path) as file:
        for name, values in arrays.items():
            file[name] = values
        file.attrs.update(attributes)


def read_arrays(path: StrPath, like: Values, told: Any, nodes: Any = None) -> tuple[Arrays, str]:
    """Read arrays that fit others on `nodes`, looked at (rows_like) before they take memory, and
    the mark; `told` are an attribute, its value, and words for others. InputError for others."""
    found = {}
    atomic.check_regular(path)
    try:
        with h5py.File(path, locking=False) as file:
            check_hdf5(file)
            if "mark" not in file.attrs:
                raise ValueError("expected one of this run, got another HDF5 file")
            if str(file.attrs.get(told[0])) != told[1]:
                raise ValueError(told[2])
            for name, want in like.items():
                one = file[name]
                if one.dtype.kind not in "biufc":  # bytes of anything else would be pointers
                    raise ValueError(f"{name} holds no numbers")
                rows = rows_like(name, one, want, nodes)
                offset = one.id.get_offset()
                plain = one.size and offset is not None  # as written, not packed by another
                whole = np.memmap(path, one.dtype, "r", offset, one.shape) if plain else one[()]
                found[name] = np.array(whole[rows])
                if np.isnan(found[name]).any():
                    raise ValueError(f"{name} is no number somewhere")
            return found, str(file.attrs["mark"])
    except (OSError, RuntimeError, LookupError, AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a readable checkpoint ({error})") from None
