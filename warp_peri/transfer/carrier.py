"""Points that are no lattice, and the certified lattice that carries them (theory, M6–M7)."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import binary_dilation
from scipy.sparse.linalg import splu
from scipy.spatial import ConvexHull, cKDTree

from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.points.interpolation import (
    FOR_DATA,
    FULL,
    NEIGHBOURS,
    fitting_spacing,
    interpolation,
    mean_spacing,
)
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import check_same, symbols
from warp_peri.transfer.cache import carried

SMALLEST = 1e-6
"""Singular values of T below this count as zero: then two unknowns are one on the lattice."""

FLAT = 1e-9
"""Extent of the points across a line, over that along it, that counts as none."""


class Carrier:
    """T, from displacement at scattered nodes to a lattice of half their spacing (M6).

    The lattice goes on with whole families 2δ beyond the last place that an unknown node touches.

    Args:
        model: certified on some lattice, from where it is transferred; one that is certified
            nowhere is proven on the lattice of a third of its horizon first.
        points: scattered nodes (or any others).
        spacing: of the lattice [Å]; None for half that of the nodes, to two digits.
        neighbours: nearest nodes that a place of the lattice is interpolated from.

    Attributes:
        points: the nodes.
        model: on the lattice.
        x: places of the lattice [Å], shape [Y, 2].
        loaded: those whose load counts, shape [Y] bool.
        T: shape [Y, N].
        unknown: the rows of loaded places and the columns of interior nodes.

    Raises InputError for a collar that is too narrow, saying how wide it must be, and for points
    too sparse or too uneven to interpolate from.
    """

    def __init__(
        self,
        model: Model,
        points: PointsLike,
        *,
        spacing: float | None = None,
        neighbours: int = NEIGHBOURS,
    ) -> None:
        if points.box is not None or points.outside is not None:
            raise InputError(
                "points: scattered points that repeat or have broken bonds do not go through a "
                "lattice; expected box=None and outside=None"
            )
        check_same(model.units, nodes_of(points).units)
        _check_plane(points, neighbours)
        dense = mean_spacing(points)
        if spacing is None:
            spacing = fitting_spacing(dense)
        self.points, self.spacing = points, spacing
        self.model = carried(model, spacing)
        self.x, self.loaded = _places(points, self.model, spacing, dense, neighbours)
        self.T = interpolation(points.x, self.x, neighbours=neighbours)
        self.unknown = sp.csr_array(self.T[self.loaded][:, points.interior])
        self._check_unknowns()

    @property
    def lattice(self) -> Points:
        """The places, of which those with a load are the interior."""
        axis = self.points.axis
        return Points(self.x, self.loaded, self.spacing, units=self.model.units, axis=axis)

    @cached_property
    def _for_loads(self) -> sp.csr_array:
        """As T, from more nodes: what is missing of short waves is missing of the answer."""
        count = min(FOR_DATA, len(self.points.x))
        return interpolation(self.points.x, self.x, neighbours=count)

    def load(self, b: np.ndarray) -> np.ndarray:
        """Tᵗ b on the interior nodes [TPa/Å], shape [S, I, 2].

        Args:
            b: [TPa/Å], at the places of the lattice, shape [S, Y, 2], where those in `loaded`
                count; or at the nodes, shape [S, N, 2], from where it is interpolated first.

        Raises InputError for other shapes.
        """
        b = np.asarray(b, dtype=float)
        if b.shape[1:] == (len(self.points.x), 2) and len(b):
            if not np.isfinite(b).all():  # of the collar, which a problem on a lattice leaves out
                raise InputError(
                    "b: expected finite values on the collar too: on scattered points a load is a "
                    "density between the nodes, which the lattice reads beside the interior as well"
                )
            b = np.stack([self._for_loads @ field for field in b])
        if b.shape[1:] != (len(self.x), 2):
            raise InputError(
                f"b: expected shape [S, {len(self.points.x)}, 2] at the nodes or "
                f"[S, {len(self.x)}, 2] on the lattice, got {list(b.shape)}"
            )
        carried = [self.unknown.T @ field[self.loaded] for field in b]
        return np.array(carried).reshape(len(b), -1, 2)

    def load_transpose(self, w: np.ndarray) -> np.ndarray:
        """`load` of nodes transposed: w on the interior [..., I, 2] to all nodes [..., N, 2]."""
        there = np.zeros((*np.shape(w)[:-2], len(self.x), 2))
        flat = np.reshape(w, (-1, *np.shape(w)[-2:]))
        there[..., self.loaded, :] = np.reshape(
            [self.unknown @ one for one in flat], (*np.shape(w)[:-2], -1, 2)
        )
        back = [self._for_loads.T @ one for one in there.reshape(-1, *there.shape[-2:])]
        return np.reshape(back, (*np.shape(w)[:-2], -1, 2))

    def _check_unknowns(self) -> None:
        """Refuse unknowns that the lattice cannot tell apart; splu finds a pivot of zero."""
        gram = sp.csc_array(self.unknown.T @ self.unknown)
        try:
            smallest = np.abs(splu(gram).U.diagonal()).min()
        except RuntimeError:
            smallest = 0.0
        if not smallest > SMALLEST**2:
            raise InputError(
                "points: the lattice cannot tell their displacements apart; expected interior "
                "nodes no closer than its spacing, or a finer lattice"
            )


def _check_plane(points: PointsLike, neighbours: int) -> None:
    """Refuse points too few to interpolate from, or on a line."""
    if len(points.x) < neighbours:
        raise InputError(
            f"points: expected at least {neighbours} nodes to interpolate from, got {len(points.x)}"
        )
    spread = np.linalg.svd(points.x - points.x.mean(axis=0), compute_uv=False)
    if not spread[1] > FLAT * spread[0]:
        raise InputError("points: expected nodes that fill a part of the plane, they are on a line")


def _places(
    points: PointsLike, model: Model, spacing: float, dense: float, neighbours: int
) -> tuple[np.ndarray, np.ndarray]:
    """Places of the lattice that the problem needs, and those that an unknown node touches.

    Raises InputError where the points do not reach as far.
    """
    tree, free = cKDTree(points.x), points.x[points.interior]
    whole = 2 * model.horizon / spacing * (1 + 1e-9)  # two bonds may end off the axes
    reach = int(whole)
    touch = 2.0 * np.sqrt(neighbours / np.pi) * dense  # farther than any node that is used
    pad = int(np.ceil(touch / spacing)) + reach
    low = np.floor(free.min(axis=0) / spacing) - pad
    size = (np.ceil(free.max(axis=0) / spacing) + pad - low + 1).astype(int)
    steps = np.argwhere(np.ones(size, bool))
    x = spacing * (low + steps)
    near = np.flatnonzero(cKDTree(free).query(x, distance_upper_bound=touch)[0] < np.inf)
    touched = np.zeros(size, bool)
    used = points.interior[tree.query(x[near], neighbours)[1]].any(axis=1)
    touched[tuple(steps[near[used]].T)] = True
    ball = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= whole
    needed = binary_dilation(touched, ball)
    x, loaded = x[needed.ravel()], touched.ravel()[needed.ravel()]
    hull = ConvexHull(points.x).equations
    outside = (x @ hull[:, :2].T + hull[:, 2]).max(axis=1) > dense / 2
    empty = tree.query(x)[0] > FULL * dense
    if (outside | empty).any():
        unit = symbols(model.units)[0]
        wide = float(cKDTree(free).query(x)[0].max())
        have = float(cKDTree(free).query(x[outside | empty])[0].min())
        raise InputError(
            f"collar: expected nodes {wide:.3g} {unit} around the interior, as evenly as there; "
            f"they are missing from {have:.3g} {unit} on (two horizons of {model.horizon:.3g} "
            f"{unit} beyond what interior nodes touch on the lattice)"
        )
    return x, loaded
