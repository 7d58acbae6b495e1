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


class Series:
    """Writes records of a motion: `record_<step>.vtu`, and `motion.pvd`, which ParaView opens.

    Args:
        folder: for the files; made if it is not there.
        body: the nodes; four neighbours make a quadrilateral.

    Raises InputError without meshio (the extra `export`).
    """

    def __init__(self, folder: str | os.PathLike[str], body: LatticeBody) -> None:
        try:
            import meshio  # noqa: F401
        except ImportError:
            raise InputError("meshio is not installed: pip install 'warp_peri[export]'") from None
        self.folder = Path(folder)
        self._points = np.column_stack([body.x, np.zeros(len(body.x))])
        self._cells = quadrilaterals(body)
        self.times: dict[str, float] = {}

    def write(self, step: int, time: float, fields: dict[str, np.ndarray]) -> Path:
        """Write one record; vectors [N, 2] get a third component."""
        import meshio

        data = {
            name: np.column_stack([values, np.zeros(len(values))]) if values.ndim == 2 else values
            for name, values in fields.items()
        }
        path = self.folder / f"record_{step:08d}.vtu"
        with whole_file(path) as temporary:
            meshio.Mesh(self._points, [("quad", self._cells)], point_data=data).write(temporary)
        self.times[path.name] = time
        root = Element("VTKFile", type="Collection", version="0.1")
        collection = SubElement(root, "Collection")
        for name, moment in self.times.items():
            SubElement(collection, "DataSet", timestep=repr(moment), part="0", file=name)
        write_text(self.folder / COLLECTION, tostring(root, encoding="unicode") + "\n")
        return path


def quadrilaterals(body: LatticeBody) -> np.ndarray:
    """Four nodes around each cell of the lattice whose corners are all there, shape [Q, 4]."""
    place = np.rint((body.x - body.x.min(axis=0)) / body.spacing).astype(int)
    number = np.full(place.max(axis=0) + 1, -1)
    number[tuple(place.T)] = np.arange(len(place))
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    quads = np.stack([corner.ravel() for corner in corners], axis=1)
    whole: np.ndarray = quads[(quads >= 0).all(axis=1)]
    return whole
