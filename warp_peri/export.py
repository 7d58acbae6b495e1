"""Export of results for ParaView."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray
from numpy.linalg import eigvalsh, norm, trace

from warp_peri.core.elastic import symmetric_part
from warp_peri.core.stencil import numbers_at
from warp_peri.errors import Arrays, InputError, StrPath
from warp_peri.files.atomic import meshio_of, write_vtu
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_operator import LPSOperator, node_fields
from warp_peri.points.arguments import checked, offered, typed
from warp_peri.points.points import PointsLike, Samples
from warp_peri.protocols import MATERIAL, OperatorBase

if TYPE_CHECKING:
    from warp_peri.fe_coupling.body import BodySolution

AROUND = {
    2: ("quad", ((0, 0), (1, 0), (1, 1), (0, 1))),
    3: (
        "hexahedron",
        ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
    ),
}
"""Cells of a lattice and the steps to their corners, in VTK's order."""


@typed
def write_vtk(folder: StrPath, model: Any, points: Samples, u: ndarray) -> list[Path]:
    """Write displacement, errors and nodal stress of samples for ParaView.

    Points are the nodes; four neighbours on a lattice make a quadrilateral, in space eight a
    hexahedron, other points stand alone. On all nodes displacement [Å], its error against the set's
    own u [Å], body_force (a density) [TPa/Å] where it is known, and interior (1 or 0). On interior
    nodes, NaN elsewhere: stress [TPa] and strain in ParaView's order XX, YY, ZZ, XY, YZ, XZ, of a
    plane with zeros out of it, dilatation, energy density [TPa]. Those are of an LPS whose families
    are whole. Of other laws the stress, where there is one, and with a gradient of their own
    (crystals) strain and dilatation. Of cracked bodies and broken bonds there are none of these.

    Args:
        folder: for the files; it is made if it is not there.
        model: a material, or its operator on these points.
        points: the set, with u to compare, and b where it is known.
        u: displacement [Å], shape [S, N, d].

    Returns the files, one for each sample, sample_0000.vtu and so on. Raises InputError without
    meshio (the extra `export`), for a folder where more samples than S lie already, which ParaView
    would show as one group, or another program's, or as node_fields.
    """
    meshio_of()
    u = checked("u", u, float, points.u.shape)
    folder, cells = Path(folder), _cells(points)
    paths = [folder / f"sample_{s:04d}.vtu" for s in range(len(u))]
    there = sorted(folder.glob("sample_*.vtu"))
    if left := [p for p in there if p not in paths or b'Name="interior"' not in p.read_bytes()]:
        raise InputError(
            f"{folder}: expected a folder without samples of another export, "
            f"got {left[0].name}; remove it or name another folder"
        )
    for path, data in zip(paths, _samples(model, points, u)):
        write_vtu(path, points.x, cells, data)
    return paths


@typed
def write_body(path: StrPath, body: BodySolution) -> dict[str, float]:
    """Write displacement [Å] and stress [TPa] of a body on its mesh as one VTU file.

    `elements` is 1 at corners whose values the elements gave, those of the outline among them, and
    0 where the lattice did. Returns the largest displacement of a corner [Å] and the largest
    principal stress at one [TPa]. Raises InputError without meshio (the extra `bodies`).
    """
    corners = offered(body, "on_corners", "write_body", "the details of a Body's Solution")
    mesh, (u, stress) = body.rim.mesh, corners()
    elements = np.zeros(len(mesh.x))
    elements[body.rim.corners] = 1
    data = {"displacement": u, "stress": _tensor(stress), "elements": elements}
    kind = "triangle" if mesh.dimension == 2 else "tetra"
    write_vtu(path, mesh.x, (kind, mesh.cells), data, extra="bodies")
    return {
        "largest_displacement": float(norm(u, axis=1).max()),
        "largest_principal_stress": float(eigvalsh(stress).max()),
    }


def _samples(model: Any, points: Samples, u: ndarray) -> list[Arrays]:
    """Point data of each sample."""
    inside = _inside(model, points, u)
    return [
        {
            "displacement": field,
            "error": field - points.u[s],
            **({} if points.b is None else {"body_force": points.b[s]}),
            **{name: _everywhere(points, values[s]) for name, values in inside.items()},
            "interior": points.interior.astype(float),
        }
        for s, field in enumerate(u)
    ]


def _inside(model: Any, points: Samples, u: ndarray) -> Arrays:
    """Fields at interior nodes, [S, I, …]; all of an LPS, transferred unless certified nowhere."""
    operator, nodes = model, points.points
    linear = None if isinstance(model, OperatorBase) else getattr(model, "linear", None)
    if isinstance(linear, LPSMaterial):
        sure = linear.certified_on and nodes.spacing > 0
        operator = linear.on(nodes) if sure else LPSOperator(linear, nodes)
    elif hasattr(model, "on"):
        operator = offered(model, "on", "write_vtk", MATERIAL)(nodes)
    found, stress_of = Arrays(), offered(operator, "stress", "write_vtk", MATERIAL)
    if isinstance(operator, LPSOperator):
        if nodes.outside is not None:
            return found
        fields = vars(node_fields(operator.model, points, u))
        return fields | {name: _tensor(fields[name]) for name in ("stress", "strain")}
    if (stress := stress_of(u)) is not None:
        found["stress"] = _tensor(stress)
    if hasattr(operator, "gradient"):
        H = operator.gradient(u)
        found["strain"] = _tensor(symmetric_part(H))
        found["dilatation"] = trace(H)
    return found


def _tensor(field: ndarray) -> ndarray:
    """Six components of ParaView's symmetric tensors: XX, YY, ZZ, XY, YZ, XZ."""
    full = np.pad(field, [(0, 0)] * (field.ndim - 2) + [(0, 3 - field.shape[-1])] * 2)
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
    return np.stack([full[..., a, c] for a, c in places], axis=-1)


def _everywhere(points: PointsLike, values: ndarray) -> ndarray:
    out = np.full((len(points.x), *values.shape[1:]), np.nan)
    out[points.interior] = values
    return out


def _cells(points: PointsLike) -> tuple[str, ndarray]:
    """Cells of a lattice along the axes whose corners are all there, else vertices."""
    vertices = "vertex", np.arange(len(points.x))[:, None]
    if points.spacing == 0:
        return vertices
    steps, axes = points.lattice
    if (axes != np.eye(points.dimension)).any():  # a turned lattice
        return vertices
    kind, around = AROUND[points.dimension]
    number = numbers_at(steps.max(axis=0) + 2, (*steps.T,))
    cells = np.stack([number[*(steps + corner).T] for corner in around], axis=1)
    cells = cells[(cells >= 0).all(axis=1)]
    return (kind, cells) if len(cells) else vertices
