"""Coarse graining from atoms to nodes (theory, equations 1–3), and nodal fields in .mat files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import h5py
import numpy as np
import scipy.io
import scipy.sparse as sp
from numpy import ndarray
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from warp_peri.atoms.dic import ON_LATTICE, spacing_of, surrounded
from warp_peri.errors import Arrays, InputError, StrPath
from warp_peri.files.atomic import check_hdf5, check_regular
from warp_peri.points.arguments import (
    EV_IN_TPA,
    Count,
    Pair,
    Positive,
    Units,
    as_array,
    check_nodes,
    check_units,
    checked,
    is_positive,
    typed,
)
from warp_peri.points.points import LARGEST_TABLE, Points, Samples, grid_places

NUMBERS = {"double", "single"} | {f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)}
"""Classes of MATLAB's arrays of numbers."""
LARGEST_ARRAY = 2**31
"""Bytes."""
FULL = 1 - 1e-6
"""Of a period, beyond which nodes are images of others."""
FAR = 1e9
"""Periods between atoms and nodes, over which positions keep six digits."""


@typed
def smoothing_matrix(
    atoms: ArrayLike,
    nodes: ArrayLike,
    *,
    radius: Positive = 10.0,
    shape: Literal["cone", "paraboloid"] = "cone",
    box: tuple[float, float] | None = None,
    spacing: Positive | None = None,
) -> sp.csr_array:
    """Smoothing functions ω(x_i, X_ε) of every node and atom (You et al. 2021, equation 6.1).

    ω = τ(x_i, X_ε) / Σ_j τ(x_j, X_ε), with τ a cone R − r or a paraboloid R² − r².

    Args:
        atoms: reference positions [Å], shape [A, 2].
        nodes: node positions [Å], shape [N, 2]; they may reach beyond a periodic box.
        radius: coarse-graining radius R [Å].
        shape: of τ.
        box: periods (Lx, Ly) of the atoms [Å], whose images all count; None for a free body.
        spacing: of the infinite square lattice of nodes that the denominator sums over; None sums
            over the given nodes. Nodes beyond a box, images of others, need it.

    Returns sparse ω, shape [N, A], dimensionless. Raises InputError for nodes off the lattice,
    beyond a box without a spacing, or so wide apart that atoms reach none; for atoms more periods
    away than positions have digits for, and more images than fit into memory.
    """
    atoms, nodes = _positions("atoms", atoms), _positions("nodes", nodes)
    if box is not None and not min(checked("box", box, shape=(2,))) > 0:
        raise InputError(f"box: expected two periods > 0, got {box}")
    if spacing is not None:
        if not radius > (least := spacing / np.sqrt(2)):  # that no atom belongs to no node
            raise InputError(f"radius: expected more than spacing/√2 = {least:.4g}, got {radius}")
        place = (nodes - nodes[0]) / spacing
        if np.abs(place - np.rint(place)).max() > 1e-6:
            raise InputError(f"nodes: expected a square lattice of spacing {spacing}")
    elif box is not None and (np.ptp(nodes, axis=0) > np.multiply(box, FULL)).any():
        raise InputError(
            "nodes: some are periodic images of others: expected their spacing, or one period"
        )
    images, owner = _images(atoms, nodes, radius, box)
    if len(images) == 0:
        return sp.csr_array((len(nodes), len(atoms)))
    tau = every = _tau(nodes, images, radius, shape)
    if spacing is not None:  # nodes of the whole lattice that any image can reach
        low = np.floor((images.min(0) - radius - nodes[0]) / spacing)
        sides = np.ceil((images.max(0) + radius - nodes[0]) / spacing) - low + 1
        check_nodes("spacing", sides)
        reached = nodes[0] + spacing * (low + grid_places(sides.astype(int)))
        every = _tau(reached, images, radius, shape)
    total = every.sum(axis=0)
    if spacing is None and box is not None:
        total = np.bincount(owner, total, len(atoms))[owner]
    scale = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    shared = sp.csr_array((scale, (np.arange(len(owner)), owner)), shape=(len(owner), len(atoms)))
    return sp.csr_array(tau @ shared)


@typed
def coarse_grain(
    omega: sp.csr_array,
    *,
    displacement: ArrayLike,
    force: ArrayLike,
    mass: ArrayLike = 1.0,
    node_area: Positive,
    thickness: Positive,
) -> Pair:
    """Smoothed displacement u [Å] and body force density b [TPa/Å], both [S, N, 2].

    Equations 2.2 and 2.3 of You et al. 2021 with smoothing functions `omega` [N, A], of the atoms'
    displacement [Å] and external force [eV/Å], both [S, A, 2], and mass in any unit, [A] or one
    number; `node_area` is what a node stands for [Å²], h² on a lattice; `thickness` of the sheet
    [Å]. Raises InputError for another omega, and where a node has no atom within the radius.
    """
    if not sp.issparse(omega) or omega.ndim != 2:
        raise InputError(f"omega: expected a sparse matrix, got {type(omega).__name__}")
    omega = sp.csr_array(omega)  # matrices multiply otherwise
    omega.data = checked("omega", omega.data)
    atoms = omega.shape[1]
    moved = checked("displacement", displacement, shape=("S", atoms, 2))
    pushed = checked("force", force, shape=(len(moved), atoms, 2))
    weighted = omega @ sp.diags_array(masses_of(mass, atoms))
    density = weighted.sum(axis=1)
    if len(bad := np.flatnonzero(~(density > 0))):
        raise InputError(
            f"{len(bad)} nodes have no atom within the radius, the first is {bad[0]}: expected "
            "nodes inside the body, or its periods (box)"
        )
    u = [weighted @ one for one in moved] / density[:, None]
    return u, np.array([omega @ one for one in pushed]) * (EV_IN_TPA / (node_area * thickness))


def masses_of(mass: ArrayLike, atoms: int) -> ndarray:
    """Check the masses of so many atoms, [A] or one of all; returns [A]."""
    each = checked("mass", mass, shape=(atoms,) if as_array("mass", mass).ndim else ())
    if not np.all(each > 0):
        raise InputError(f"mass: expected values > 0, got {each}")
    return np.full(atoms, each)


def _images(atoms: ndarray, nodes: ndarray, radius: float, box: tuple[float, float] | None) -> Pair:
    """Positions [Å] of the atoms and periodic images within reach of a node, and their atoms."""
    low, high = nodes.min(0) - radius, nodes.max(0) + radius
    images, owner = atoms, np.arange(len(atoms))
    if box is not None:
        counts, first = np.ceil((high - low) / box), np.ceil((low - atoms) / box)
        if np.abs(first).max() > FAR:
            raise InputError(f"atoms, nodes: expected both within {FAR:g} periods of one another")
        check_nodes("radius", (len(atoms), *counts))
        shifts = grid_places(counts.astype(int))
        images = np.concatenate([atoms + (first + shift) * box for shift in shifts])
        owner = np.tile(owner, len(shifts))
    near = ((images >= low) & (images <= high)).all(axis=1)
    return images[near], owner[near]


def _tau(nodes: ndarray, atoms: ndarray, radius: float, shape: str) -> sp.csr_array:
    pairs = cKDTree(nodes).sparse_distance_matrix(cKDTree(atoms), radius, output_type="ndarray")
    r = pairs["v"]
    tau = radius - r if shape == "cone" else radius**2 - r**2
    return sp.csr_array((tau, (pairs["i"], pairs["j"])), shape=(len(nodes), len(atoms)))


def _positions(name: str, value: ArrayLike) -> ndarray:
    value = checked(name, value, shape=("N", 2))
    if not len(value):
        raise InputError(f"{name}: expected shape [N, 2] with N > 0, got [0, 2]")
    return value


@typed
def read_mat(
    path: StrPath,
    *,
    displacement: str = "disps",
    load: str | None = "forces",
    positions: str | float = "coords",
    factor: float = 1.0,
    reach: Count = 3,
    units: Units | str = "reduced",
) -> Samples:
    """Read fields on the nodes of a lattice from a MATLAB .mat file, version 5 or 7.3.

    Args:
        path: of the file.
        displacement: name of its variable, [S, N, 2] or [S, 2, N]; or nodes in rows, [S, 2, n, n].
        load: name of the loads, of the same shapes; None where they are not known.
        positions: name of the positions, shape [N, 2]; or the spacing of a square sheet of nodes,
            whose last index goes along y.
        factor: multiplies loads, as one over a node's volume for forces.
        reach: horizon in spacings; nodes whose surroundings to twice that are there are interior.
        units: of lengths and stresses; the file does not say them.

    Raises InputError for a missing variable, positions off a square lattice, or no interior.
    """
    path = Path(path)
    if load is None and factor != 1:
        raise InputError(f"factor: expected a load that it multiplies, got {factor:g} and no load")
    names = [one for one in (displacement, load, positions) if isinstance(one, str)]
    if not isinstance(positions, str) and not is_positive(positions):
        raise InputError(f"positions: expected a name or a spacing > 0, got {positions!r}")
    held = _variables(path, names)
    if isinstance(positions, str):
        x = checked(positions, held[positions], float, ("N", 2))
        step = spacing_of(x)
    else:
        shape = held[displacement].shape
        step, side = float(positions), round((math.prod(shape[1:]) / 2) ** 0.5)
        rows = [n for n in shape[1:] if n > 2]
        if len(rows) > 1 and rows[-1] != side:
            raise InputError(
                f"{path}: {displacement}: expected a square sheet, or the name of its positions, "
                f"got {shape}"
            )
        x = step * grid_places((side, side))
    u = _components_last(path, held, displacement, len(x))
    b = None if load is None else factor * _components_last(path, held, load, len(x))
    nodes = np.rint(place := (x - x.min(axis=0)) / step).astype(int)
    if np.abs(place - nodes).max() > ON_LATTICE or np.prod(place.max(axis=0) + 1) > LARGEST_TABLE:
        raise InputError(f"{path}: expected positions on a square lattice along x and y")
    grid = np.zeros(nodes.max(axis=0) + 1, bool)
    grid[*nodes.T] = True
    interior = surrounded(grid, reach)[*nodes.T] if 4 * reach < min(grid.shape) else grid[:0]
    if not interior.any():
        raise InputError(
            f"{path}: expected all within {2 * reach} spacings around some, got none of "
            f"{' × '.join(map(str, grid.shape))}"
        )
    points = Points(x.min(axis=0) + step * nodes, interior, step, units=check_units(units))
    return Samples(points, u, b)


def _variables(path: Path, names: Sequence[str]) -> Arrays:
    """Numeric arrays of a .mat file by name; HDF5 (version 7.3) has their axes reversed."""
    held = {}
    check_regular(path)
    try:
        if h5py.is_hdf5(path):
            with h5py.File(path) as file:
                check_hdf5(file)
                there = [*file]
                held = {n: file[n][()].T for n in names if getattr(file.get(n), "shape", ())}
        else:
            arrays = {name: (math.prod(s), kind) for name, s, kind in scipy.io.whosmat(path)}
            there, read = [*arrays], [n for n in names if arrays.get(n, (0, ""))[1] in NUMBERS]
            if any(8 * arrays[name][0] > LARGEST_ARRAY for name in read):
                raise ValueError("expected arrays of at most 2 GiB")
            held = scipy.io.loadmat(path, variable_names=read) if read else {}
    except Exception as error:  # readers of broken files run into anything
        raise InputError(f"{path}: cannot be read as a .mat file ({error})") from None
    for name in names:
        if name not in held or held[name].dtype.kind not in "fiu" or held[name].ndim < 2:
            raise InputError(
                f"{path}: expected {name}, an array of numbers, among "
                f"{', '.join(there) or 'nothing'}"
            )
    return held


def _components_last(path: Path, held: Arrays, name: str, nodes: int) -> ndarray:
    """A field on the nodes with its components last, shape [S, N, 2]."""
    field = held[name].astype(float)
    last = field.shape[-1] == 2
    if last and field.ndim == 2:
        field = field[None]  # one sample
    if not len(field) or field[0].size != 2 * nodes:
        raise InputError(
            f"{path}: {name}: expected two components of {nodes} nodes, got {field.shape}"
        )
    return field.reshape(-1, nodes, 2) if last else field.reshape(-1, 2, nodes).mT
