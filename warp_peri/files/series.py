"""Fields on nodes for ParaView: a VTU file, and the records of a motion with their times."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from warp_peri.errors import optional
from warp_peri.files.atomic import whole_file, write_text
from warp_peri.files.checkpoint import write_arrays

INCLUDE = "http://www.w3.org/2001/XInclude"


def meshio_of(extra: str = "export") -> Any:
    """meshio, which writes VTU; InputError names the extra that brings it."""
    return optional("meshio", f"meshio is not installed: pip install 'warp_peri[{extra}]'")


def write_vtu(
    path: str | os.PathLike[str],
    x: np.ndarray,
    cells: tuple[str, np.ndarray],
    data: Mapping[str, np.ndarray],
    extra: str = "export",
) -> Path:
    """Write nodes, cells of one kind and fields on the nodes; vectors in the plane get a third
    component.

    Args:
        path: of the file.
        x: positions, shape [N, d].
        cells: their kind and nodes, shape [C, n].
        data: fields by name, shape [N, ...].
        extra: that brings meshio.
    """
    meshio, data = meshio_of(extra), {name: in_space(field) for name, field in data.items()}
    with whole_file(path) as temporary:
        meshio.Mesh(in_space(x), [cells], point_data=data).write(temporary, "vtu")
    return Path(path)


class TimeSeriesWriter:
    """Records of a motion: one file each, and one that names their times, which ParaView opens.

    `record_<step>.h5`, `nodes.h5` and `motion.xdmf`, the same from any number of ranks.

    Args:
        folder: for the files; made if it is not there.
        nodes: those of this process, as checkpoint.AllNodes or mpi.Subdomain.
        x: their positions, shape [n, d], where the nodes have none themselves.
    """

    def __init__(
        self, folder: str | os.PathLike[str], nodes: Any, x: np.ndarray | None = None
    ) -> None:
        self.folder, self.nodes = Path(folder), nodes
        self.x = in_space(nodes.x if x is None else x)
        self.times: dict[str, float] = {}

    def write(self, step: int, time: float, fields: Mapping[str, np.ndarray]) -> None:
        """Write one record; vectors in the plane get a third component."""
        name, data = f"record_{step:08d}", {key: in_space(value) for key, value in fields.items()}
        self._write(f"{name}.h5", data)
        if not (self.folder / "nodes.h5").exists() or not self.times:
            number = np.arange(len(self.x)) if self.nodes.number is None else self.nodes.number
            self._write("nodes.h5", {"x": self.x, "number": number.astype(np.int32)[:, None]})
        self.times[f"{name}.h5"] = time
        if self.nodes.comm.rank == 0:
            write_text(self.folder / "motion.xdmf", self._header(data))

    def _write(self, name: str, fields: Mapping[str, np.ndarray]) -> None:
        nodes = self.nodes
        placed = {key: (value, nodes.number, nodes.count) for key, value in fields.items()}
        write_arrays(self.folder / name, nodes.comm, placed)

    def _header(self, fields: Mapping[str, np.ndarray]) -> str:
        count = self.nodes.count
        nodes = _item(f"{count} 1", "nodes.h5:/number", "Int", 4)
        lines = [
            '<Xdmf Version="3.0"><Domain>',
            '<Grid Name="nodes" GridType="Uniform">',
            f'<Topology TopologyType="Polyvertex" NumberOfElements="{count}">{nodes}</Topology>',
            f'<Geometry GeometryType="XYZ">{_item(f"{count} 3", "nodes.h5:/x")}</Geometry></Grid>',
            '<Grid GridType="Collection" CollectionType="Temporal">',
        ]
        for name, time in self.times.items():
            lines.append(f'<Grid Name="{name}" GridType="Uniform"><Time Value="{time!r}"/>')
            for part in ("Topology", "Geometry"):
                link = f"xpointer(//Grid[@Name=&quot;nodes&quot;]/{part})"
                lines.append(f'<include xmlns="{INCLUDE}" xpointer="{link}"/>')
            for key, value in fields.items():
                kind = "Vector" if value.ndim == 2 else "Scalar"
                data = _item(" ".join(map(str, (count, *value.shape[1:]))), f"{name}:/{key}")
                what = f'Name="{key}" AttributeType="{kind}" Center="Node"'
                lines.append(f"<Attribute {what}>{data}</Attribute>")
            lines.append("</Grid>")
        return "\n".join([*lines, "</Grid></Domain></Xdmf>", ""])


def _item(shape: str, text: str, kind: str = "Float", size: int = 8) -> str:
    """An array of an HDF5 file in an XDMF one."""
    what = f'DataType="{kind}" Precision="{size}" Format="HDF" Dimensions="{shape}"'
    return f"<DataItem {what}>{text}</DataItem>"


def in_space(values: np.ndarray) -> np.ndarray:
    """Vectors [n, 2] with three components; what else there is as it is."""
    flat = values.ndim == 2 and values.shape[1] == 2
    return np.pad(values, ((0, 0), (0, 1))) if flat else values
