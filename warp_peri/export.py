"""Results for other tools: fields for ParaView, the influence function as a table, the matrix."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from warp_peri.dataset import PointSet
from warp_peri.errors import InputError
from warp_peri.families import bond_classes
from warp_peri.files import whole_file, write_text
from warp_peri.matrices import matrices
from warp_peri.model import Model
from warp_peri.stress import node_fields


def write_fields(
    folder: str | os.PathLike[str], model: Model, points: PointSet, u: np.ndarray
) -> list[Path]:
    """One VTU file a sample, for ParaView: what a displacement does, and how far off it is.

    Points are the nodes; four neighbours on a lattice make a quadrilateral, other points stand
    alone. Displacement [Å], its error against the set's own u [Å], body force density [TPa/Å], and
    on interior nodes (NaN elsewhere) stress [TPa], strain, dilatation, energy density [TPa].

    Args:
        folder: for sample_0000.vtu and so on; it is made if it is not there.
        model: the model.
        points: the set, with b and, to compare, u.
        u: displacement [Å], shape [S, N, 2].

    Raises InputError without meshio (the extra `export`), or as node_fields does.
    """
    try:
        import meshio
    except ImportError:
        raise InputError("meshio is not installed: pip install 'warp_peri[export]'") from None
    found = node_fields(model, points, u)
    x = np.column_stack([points.x, np.zeros(len(points.x))])
    cells = _cells(points)
    paths = []
    for s, one in enumerate(u):
        data = {
            "displacement": _vector(one),
            "error": _vector(one - points.u[s]),
            "body_force": _vector(points.b[s]),
            "interior": points.interior.astype(float),
        }
        for name in ("stress", "strain"):
            tensor = getattr(found, name)[s]
            for key, i, j in (("xx", 0, 0), ("yy", 1, 1), ("xy", 0, 1)):
                data[f"{name}_{key}"] = _everywhere(points, tensor[:, i, j])
        for name in ("dilatation", "energy"):
            data[name] = _everywhere(points, getattr(found, name)[s])
        paths.append(Path(folder) / f"sample_{s:04d}.vtu")
        with whole_file(paths[-1]) as temporary:
            meshio.Mesh(x, cells, point_data=data).write(temporary)
    return paths


def write_influence(path: str | os.PathLike[str], model: Model, spacing: float) -> Path:
    """The influence function at the bond lengths of a lattice, as text with commas.

    Columns: r [Å], bonds of that length in a family, K, K/m [Å⁻⁴] with m the weighted volume on
    the lattice, K/m of the dilatation, quadrature weight W [Å²].
    """
    classes = bond_classes(spacing, model.horizon)
    columns = [classes.r, classes.count]
    K, Kd = model.influence(classes.r), model.influence_dilatation(classes.r)
    for kernel in (K, Kd):
        m = classes.count @ (kernel * classes.weight * classes.r**2)
        columns.append(kernel / m)
    columns.insert(2, K)
    columns.append(classes.weight)
    lines = [
        f"# influence function, lattice of spacing {spacing:g} angstrom, "
        f"horizon {model.horizon:g} angstrom, lambda = {model.lam:.17g}, mu = {model.mu:.17g} TPa",
        "# m = sum over the family of K r^2 W; only K/m enters the model",
        "r [angstrom],bonds,K,K/m [1/angstrom^4],K/m of the dilatation [1/angstrom^4],"
        "W [angstrom^2]",
    ]
    lines += [",".join(f"{value:.17g}" for value in row) for row in zip(*columns)]
    write_text(path, "\n".join(lines) + "\n")
    return Path(path)


def write_operator(path: str | os.PathLike[str], model: Model, points: PointSet) -> Path:
    """L [TPa/Å²] as a sparse matrix, shape [2 I, 2 N], for scipy.sparse.load_npz.

    Component a of node i is number 2 i + a; rows are interior nodes in their order.
    """
    L = matrices(model, points).operator(model.lam, model.mu)
    with whole_file(path) as temporary, open(temporary, "wb") as file:
        sp.save_npz(file, L)
    return Path(path)


def _vector(field: np.ndarray) -> np.ndarray:
    """ParaView's vectors have three components."""
    return np.column_stack([field, np.zeros(len(field))])


def _everywhere(points: PointSet, values: np.ndarray) -> np.ndarray:
    out = np.full(len(points.x), np.nan)
    out[points.interior] = values
    return out


def _cells(points: PointSet) -> list[tuple[str, np.ndarray]]:
    """Quadrilaterals of a lattice along the axes whose four corners are there, else vertices."""
    vertices = [("vertex", np.arange(len(points.x))[:, None])]
    if points.spacing == 0:
        return vertices
    place = (points.x - points.x.min(axis=0)) / points.spacing
    steps = np.rint(place).astype(int)
    if np.abs(place - steps).max() > 1e-3:  # a turned lattice
        return vertices
    number = -np.ones(steps.max(axis=0) + 1, dtype=int)
    number[tuple(steps.T)] = np.arange(len(steps))
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    quads = np.stack([corner.ravel() for corner in corners], axis=1)
    quads = quads[(quads >= 0).all(axis=1)]
    return [("quad", quads)] if len(quads) else vertices
