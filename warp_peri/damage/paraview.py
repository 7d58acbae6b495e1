"""Fields of a motion for ParaView: one file a record and the collection that names their times."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from warp_peri.damage.lattice_body import LatticeBody
from warp_peri.errors import InputError
from warp_peri.files.atomic import whole_file, write_text

COLLECTION = "motion.pvd"


class DamageSeries:
    """Writes records of a motion: `record_<step>.vtu`, and `motion.pvd`, which ParaView opens.

    Args:
        folder: for the files; made if it is not there.
        body: the nodes; four neighbours make a quadrilateral, eight a hexahedron.

    Raises InputError without meshio (the extra `export`).
    """

    def __init__(self, folder: str | os.PathLike[str], body: LatticeBody) -> None:
        try:
            import meshio  # noqa: F401
        except ImportError:
            raise InputError("meshio is not installed: pip install 'warp_peri[export]'") from None
        self.folder = Path(folder)
        self._points = in_space(body.x)
        self._cells = {2: "quad", 3: "hexahedron"}[body.dimension], cells(body)
        self.times: dict[str, float] = {}

    def write(self, step: int, time: float, fields: dict[str, np.ndarray]) -> Path:
        """Write one record; vectors in the plane get a third component."""
        import meshio

        data = {
            name: in_space(values) if values.ndim == 2 else values
            for name, values in fields.items()
        }
        path = self.folder / f"record_{step:08d}.vtu"
        with whole_file(path) as temporary:
            meshio.Mesh(self._points, [self._cells], point_data=data).write(temporary)
        self.times[path.name] = time
        root = Element("VTKFile", type="Collection", version="0.1")
        collection = SubElement(root, "Collection")
        for name, moment in self.times.items():
            SubElement(collection, "DataSet", timestep=repr(moment), part="0", file=name)
        write_text(self.folder / COLLECTION, tostring(root, encoding="unicode") + "\n")
        return path


def in_space(x: np.ndarray) -> np.ndarray:
    """Vectors [N, d] with three components."""
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def cells(body: LatticeBody) -> np.ndarray:
    """Nodes around each cell of the lattice whose corners are all there, shape [C, 2^d].

    In the order of a quadrilateral, and of a hexahedron.
    """
    place = np.rint((body.x - body.x.min(axis=0)) / body.spacing).astype(int)
    number = np.full(place.max(axis=0) + 1, -1)
    number[tuple(place.T)] = np.arange(len(place))
    around: list[tuple[int, ...]] = [(0, 0), (1, 0), (1, 1), (0, 1)]
    if body.dimension == 3:
        around = [(*corner, up) for up in (0, 1) for corner in around]
    ends = slice(None, -1), slice(1, None)
    corners = [number[tuple(ends[up] for up in corner)] for corner in around]
    found = np.stack([corner.ravel() for corner in corners], axis=1)
    whole: np.ndarray = found[(found >= 0).all(axis=1)]
    return whole
