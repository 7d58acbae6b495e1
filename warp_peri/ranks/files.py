"""HDF5 files that all ranks write at once, in the order of the whole body.

The wheel of h5py knows no MPI. So one rank lays a file out, with room for every array in one run of
bytes, and all write their nodes there by MPI-IO: the file is the same from any number of ranks, and
is read by any HDF5.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement, tostring

import h5py
import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import PART, destination, write_text
from warp_peri.ranks.processes import Comm, agreed

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece


def write_arrays(
    path: str | os.PathLike[str],
    comm: Comm,
    arrays: Mapping[str, tuple[np.ndarray, np.ndarray, int]],
    attributes: Mapping[str, Any] | None = None,
) -> None:
    """Write arrays whole or not at all.

    Args:
        path: of the file.
        comm: the ranks.
        arrays: by name this rank's rows, their rising places in the whole, and how many it has.
        attributes: of the file, the same on all ranks.
    """
    from mpi4py import MPI

    with agreed(comm):
        path = destination(path)
    part, offsets = path.with_name(f".{path.name}.ranks{PART}"), None
    with agreed(comm):
        if comm.rank == 0:
            offsets = _laid_out(part, arrays, attributes or {})
    offsets = comm.bcast(offsets)
    file = MPI.File.Open(comm, str(part), MPI.MODE_WRONLY)
    for name, (values, place, _) in arrays.items():
        row, values = _row(values), np.ascontiguousarray(values)
        file.Set_view(offsets[name], MPI.BYTE, view := _view(place, row))
        file.Write_all([values, values.nbytes, MPI.BYTE])
        view.Free()
    file.Sync()
    file.Close()
    comm.Barrier()
    if comm.rank == 0:
        os.replace(part, path)
    comm.Barrier()


def _laid_out(
    path: Path, arrays: Mapping[str, tuple[np.ndarray, np.ndarray, int]], attributes: Any
) -> dict[str, int]:
    """Make a file with room for the arrays; where each begins [bytes]."""
    offsets = {}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(path, "w") as file:
            for name, (values, _, count) in arrays.items():
                shape = (count, *np.shape(values)[1:])
                plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
                plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
                plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
                plan.set_obj_track_times(False)  # the same bytes whenever it is written
                kind = h5py.h5t.py_create(np.asarray(values).dtype)
                space = h5py.h5s.create_simple(shape)
                data = h5py.h5d.create(file.id, name.encode(), kind, space, plan)
                offsets[name] = data.get_offset()
            file.attrs.update(attributes)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from None
    return offsets


def as_text(comm: Comm, content: Any) -> tuple[np.ndarray, np.ndarray, int]:
    """Plain values, the same on all ranks, as an array of `write_arrays`, which one rank writes."""
    text = np.frombuffer(json.dumps(content).encode(), np.uint8)
    mine = text if comm.rank == 0 else text[:0]
    return mine, np.arange(len(mine)), len(text)


def read_text(values: np.ndarray) -> Any:
    """What `as_text` laid down."""
    return json.loads(values.tobytes())


def read_arrays(
    path: str | os.PathLike[str], comm: Comm, place: Mapping[str, np.ndarray | None]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Rows at rising places of arrays that `write_arrays` wrote, by name, and the attributes.

    All rows where None is asked.

    Raises InputError for a file that is none or lacks an array.
    """
    from mpi4py import MPI

    laid, attributes = {}, {}
    with agreed(comm):
        if comm.rank == 0:
            try:
                with h5py.File(path) as file:
                    attributes = {name: value for name, value in file.attrs.items()}
                    for name in place:
                        one = file[name]
                        laid[name] = one.id.get_offset(), one.shape, one.dtype
            except (OSError, KeyError) as error:
                raise InputError(f"{path}: not a readable checkpoint ({error})") from None
    laid, attributes = comm.bcast((laid, attributes))
    file, found = MPI.File.Open(comm, str(path), MPI.MODE_RDONLY), {}
    for name, rows in place.items():
        offset, shape, dtype = laid[name]
        rows = np.arange(shape[0]) if rows is None else rows
        values = found[name] = np.empty((len(rows), *shape[1:]), dtype)
        file.Set_view(offset, MPI.BYTE, view := _view(rows, _row(values)))
        file.Read_all([values, values.nbytes, MPI.BYTE])
        view.Free()
    file.Close()
    return found, attributes


def _row(values: np.ndarray) -> int:
    return int(np.prod(values.shape[1:])) * values.itemsize


def _view(place: np.ndarray, row: int) -> Any:
    """Bytes of rows at rising places as a type of MPI, neighbours as one run."""
    from mpi4py import MPI

    ends = np.flatnonzero(np.diff(place) != 1) + 1
    begin = np.concatenate([[0], ends]).astype(np.int64)
    length = np.diff(np.concatenate([begin, [len(place)]]))
    if not len(place):
        begin, length = begin[:0], length[:0]
    starts = (place[begin] * row).tolist()
    return MPI.BYTE.Create_hindexed((length * row).tolist(), starts).Commit()


class Series:
    """Records of a motion for ParaView and meshio: `motion.xdmf`, a file for the nodes, and one
    for each record.

    Args:
        folder: for the files; made if it is not there.
        piece: the nodes of this rank.
    """

    def __init__(self, folder: str | os.PathLike[str], piece: Piece) -> None:
        self.folder, self.piece = Path(folder), piece
        self.times: dict[str, float] = {}
        self._fields: dict[str, tuple[int, ...]] = {}

    def write(self, step: int, time: float, fields: Mapping[str, np.ndarray]) -> None:
        """Write one record; vectors in the plane get a third component."""
        piece = self.piece
        name = f"record_{step:08d}.h5"
        vectors = {key: in_space(value) for key, value in fields.items()}
        self._write(name, vectors)
        if not (self.folder / "nodes.h5").exists() or not self.times:
            number = piece.number.astype(np.int32)[:, None]
            self._write("nodes.h5", {"x": in_space(piece.x), "number": number})
        self.times[name] = time
        self._fields = {key: (piece.count, *value.shape[1:]) for key, value in vectors.items()}
        if piece.comm.rank == 0:
            write_text(self.folder / "motion.xdmf", self._header())

    def _write(self, name: str, fields: Mapping[str, np.ndarray]) -> None:
        piece = self.piece
        placed = {key: (value, piece.number, piece.count) for key, value in fields.items()}
        write_arrays(self.folder / name, piece.comm, placed)

    def _header(self) -> str:
        count = self.piece.count
        root = Element("Xdmf", Version="3.0")
        domain = SubElement(root, "Domain")
        mesh = SubElement(domain, "Grid", Name="nodes", GridType="Uniform")
        topology = SubElement(
            mesh, "Topology", TopologyType="Polyvertex", NumberOfElements=str(count)
        )
        _item(topology, (count, 1), "nodes.h5:/number", "Int", 4)
        _item(SubElement(mesh, "Geometry", GeometryType="XYZ"), (count, 3), "nodes.h5:/x")
        series = SubElement(domain, "Grid", GridType="Collection", CollectionType="Temporal")
        for name, time in self.times.items():
            grid = SubElement(series, "Grid", Name=name, GridType="Uniform")
            SubElement(grid, "Time", Value=repr(time))
            for part in ("Topology", "Geometry"):
                link = SubElement(grid, "{http://www.w3.org/2001/XInclude}include")
                link.set("xpointer", f'xpointer(//Grid[@Name="nodes"]/{part})')
            for key, shape in self._fields.items():
                kind = "Vector" if len(shape) == 2 else "Scalar"
                field = SubElement(grid, "Attribute", Name=key, AttributeType=kind, Center="Node")
                _item(field, shape, f"{name}:/{key}")
        return tostring(root, encoding="unicode") + "\n"


def _item(
    parent: Element, shape: tuple[int, ...], text: str, kind: str = "Float", size: int = 8
) -> None:
    item = SubElement(parent, "DataItem", DataType=kind, Precision=str(size), Format="HDF")
    item.set("Dimensions", " ".join(map(str, shape)))
    item.text = text


def in_space(values: np.ndarray) -> np.ndarray:
    """Vectors [n, d] with three components; numbers as they are."""
    flat = values.ndim == 2 and values.shape[1] == 2
    return np.pad(values, ((0, 0), (0, 1))) if flat else values
