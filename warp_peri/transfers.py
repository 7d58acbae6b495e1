"""Transfers of materials and samples to lattices: `warp_peri.transfers`."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from warp_peri.errors import InputError
from warp_peri.materials.transfer import on_lattice
from warp_peri.points.arguments import Positive, check_nodes, typed
from warp_peri.points.points import Points, PointsLike, Samples, grid_places

__all__ = ["on_lattice", "onto_lattice"]
NEIGHBOURS = 80
"""Nearest nodes that a value is interpolated from: more of them see shorter waves."""
SPACING_NEIGHBOURS = 12
FULL = 1.5
"""Distance to the nearest node, in spacings, beyond which a place counts as outside the points."""


def mean_spacing(points: PointsLike) -> float:
    """Spacing [Å] of a square lattice as dense as the points are around their interior."""
    count = min(SPACING_NEIGHBOURS, len(points.x) - 1)
    r, _ = cKDTree(points.x).query(points.x[points.interior], count + 1)
    return float(np.median(r[:, -1]) * np.sqrt(np.pi / (count + 0.5)))


@typed
def onto_lattice(samples: Samples, *, spacing: Positive) -> Samples:
    """Interpolate samples at scattered nodes to a lattice, to learn from (theory, M6).

    By quintic splines of the 80 nearest nodes, exact for polynomials of degree 2.

    Args:
        samples: u and b at scattered nodes.
        spacing: h [Å] of the lattice; places on the rim where nodes are missing are left out.

    The new interior is what lies within a spacing of interior nodes; arrays with an entry for each
    node have that of the nearest. Raises InputError for a spacing that is no length, fewer nodes
    than these, and nodes on a line or a conic.
    """
    x, dense = samples.x, mean_spacing(samples)
    if samples.dimension != 2 or not len(samples):
        raise InputError("samples: expected one or more, of nodes in a plane")
    if samples.box is not None or samples.outside is not None:
        raise InputError("points: expected no period and no nodes outside, which would be lost")
    if len(x) < NEIGHBOURS:
        raise InputError(
            f"points: expected at least {NEIGHBOURS} nodes to interpolate from, got {len(x)}"
        )
    low, high = np.ceil(x.min(0) / spacing - 1e-6), np.floor(x.max(0) / spacing + 1e-6)
    check_nodes("spacing", high - low + 1)
    if not (high > low).any():
        raise InputError(f"spacing: expected one of nodes in the body, got {spacing:g}")
    y = spacing * (low + grid_places((high - low + 1).astype(int)))
    r, near = cKDTree(x).query(y)
    y, near = y[r <= FULL * dense], near[r <= FULL * dense]
    interior = cKDTree(x[samples.interior]).query(y)[0] <= dense
    fields = np.concatenate([samples.u] if samples.b is None else [samples.u, samples.b])
    try:
        carry = RBFInterpolator(x, fields.swapaxes(0, 1), neighbors=NEIGHBOURS, kernel="quintic")
        u, *b = np.split(carry(y).swapaxes(0, 1), len(fields) // len(samples))
    except np.linalg.LinAlgError:
        raise InputError("points: nodes to interpolate from lie on a line or a conic") from None
    nodes = Points(y, interior, spacing, units=samples.units, axis=samples.axis)
    arrays = {
        name: np.asarray(one)[:, near] if np.shape(one)[1:2] == (len(x),) else one
        for name, one in samples.arrays.items()
    }
    return Samples(nodes, u, b[0] if b else None, arrays)
