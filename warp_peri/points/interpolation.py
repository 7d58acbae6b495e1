"""Interpolation between points by local radial basis functions (theory, M6)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike, Samples

NEIGHBOURS, DEGREE = 40, 2
"""Nearest nodes that a value is interpolated from, and the degree that is exact."""
FOR_DATA = 80
"""The same where whole fields are carried to a lattice: more nodes see shorter waves."""
EXACT = 1e-6
"""Largest error in the polynomials that are to be exact; larger ones tell of lost digits."""
AT_ONCE = 2**24
"""Entries of the small systems that are solved together."""
SPACING_NEIGHBOURS = 12
FULL = 1.5
"""Distance to the nearest node, in spacings, beyond which a place counts as outside the points."""


def interpolation(x: np.ndarray, y: np.ndarray, *, neighbours: int = NEIGHBOURS) -> sp.csr_array:
    """T with (T f)(y) from values f at x: shape [Y, N], `neighbours` entries a row.

    Quintic polyharmonic splines of the nearest nodes with polynomials of degree 2, as SciPy's
    RBFInterpolator; exact for such polynomials, and a row sums to one.

    Args:
        x: nodes [Å], shape [N, 2].
        y: where values are wanted [Å], shape [Y, 2].
        neighbours: nearest nodes of each, at least 12.

    Raises InputError for fewer nodes than that, or nodes on a line or a conic.
    """
    if not 12 <= neighbours <= len(x):
        raise InputError(
            f"points: expected at least {max(neighbours, 12)} nodes to interpolate from, "
            f"got {len(x)}"
        )
    _, near = cKDTree(x).query(y, neighbours)
    values = np.empty(near.shape)
    block = max(1, AT_ONCE // (neighbours + 6) ** 2)
    for first in range(0, len(y), block):
        some = slice(first, first + block)
        values[some] = _weights(x[near[some]] - y[some, None])
    row = neighbours * np.arange(len(y) + 1)
    return sp.csr_array((values.ravel(), near.ravel(), row), shape=(len(y), len(x)))


def _weights(offset: np.ndarray) -> np.ndarray:
    """Weights of the nodes at offsets from where the value is wanted, shape [Y, K, 2] to [Y, K]."""
    count = offset.shape[1]
    s = offset / np.abs(offset).max(axis=(1, 2), keepdims=True)
    unit = np.ones(s.shape[:2])
    a, b = s[..., 0], s[..., 1]
    powers = np.stack([unit, a, b, a * a, a * b, b * b], axis=2)
    system = np.zeros((len(s), count + 6, count + 6))
    system[:, :count, :count] = _spline(s[:, :, None] - s[:, None])
    system[:, :count, count:] = powers
    system[:, count:, :count] = powers.transpose(0, 2, 1)
    right = np.zeros((len(s), count + 6, 1))
    right[:, :count, 0] = _spline(s)
    right[:, count, 0] = 1.0
    try:
        weights = np.linalg.solve(system, right)[:, :count, 0]
        moments = np.einsum("yk,ykp->yp", weights, powers) - np.eye(6)[0]
    except np.linalg.LinAlgError:
        moments = np.array([np.inf])
    if not np.abs(moments).max() <= EXACT:
        raise InputError(
            "points: nodes to interpolate from lie on a line or a conic, or twice at one place"
        )
    return np.asarray(weights)


def _spline(offset: np.ndarray) -> np.ndarray:
    square = offset[..., 0] ** 2 + offset[..., 1] ** 2
    return np.asarray(-(square**2) * np.sqrt(square))


def mean_spacing(points: PointsLike) -> float:
    """Spacing [Å] of a square lattice as dense as the points are around their interior."""
    count = min(SPACING_NEIGHBOURS, len(points.x) - 1)
    r, _ = cKDTree(points.x).query(points.x[points.interior], count + 1)
    return float(np.median(r[:, -1]) * np.sqrt(np.pi / (count + 0.5)))


def onto_lattice(samples: Samples, *, spacing: float, neighbours: int = FOR_DATA) -> Samples:
    """Fields at scattered nodes carried to a lattice, to learn from (theory, M6).

    Args:
        samples: u and b at scattered nodes.
        spacing: h [Å] of the lattice; places on the rim where nodes are missing are left out.
        neighbours: nearest nodes that a value is interpolated from.

    Returns:
        Samples on the lattice, whose interior is what lies within a spacing of interior nodes.

    Raises InputError for a spacing that is no length, or fewer nodes than neighbours.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise InputError(f"spacing: expected a lattice spacing > 0, got {spacing}")
    tree = cKDTree(samples.x)
    low, high = samples.x.min(axis=0), samples.x.max(axis=0)
    lines = [
        spacing * np.arange(np.ceil(a / spacing - 1e-6), np.floor(b / spacing + 1e-6) + 1)
        for a, b in zip(low, high)
    ]
    y = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    dense = mean_spacing(samples)
    y = y[tree.query(y)[0] <= FULL * dense]
    free = cKDTree(samples.x[samples.interior])
    interior = free.query(y)[0] <= dense
    fields = [samples.u] if samples.b is None else [samples.u, samples.b]
    nodes = len(samples.x)
    values = np.hstack([field.transpose(1, 0, 2).reshape(nodes, -1) for field in fields])
    carried = interpolation(samples.x, y, neighbours=neighbours) @ values
    parts = np.split(carried, len(fields), axis=1)
    u, *b = (part.reshape(len(y), -1, 2).transpose(1, 0, 2) for part in parts)
    return Samples(
        Points(y, interior, spacing, units=samples.points.units, axis=samples.axis),
        u,
        b[0] if b else None,
        samples.arrays,
    )
