"""Displacements and loads on nodes, and what they say: axis, strain, wave numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias
from weakref import WeakValueDictionary

import numpy as np
from scipy.spatial import cKDTree

from warp_peri.errors import InputError, warn
from warp_peri.points.arguments import typed
from warp_peri.points.arrays import as_array, checked, is_name, is_piece
from warp_peri.points.points import Points
from warp_peri.points.unit_names import symbols
from warp_peri.reprs import Shown

SEEN = "seen"
"""Array of frames that were measured: nodes whose displacement was, shape [S, N] bool; that of the
others is filled in."""
PULL = "pull"
"""Array of frames: pull over width and mean thickness on sections across x, and across y, that go
from edge to edge, shape [S, 2] [stress]; NaN where it was not measured."""
FIELDS = ("x", "u", "b", "interior", "outside")
"""Names that no array of samples may bear."""


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Samples(Shown):
    """Samples of one body on one set of points.

    Attributes:
        points: the nodes; x, interior, spacing, box and outside are theirs.
        u: displacements [Å], shape [S, N, d].
        b: body force densities [TPa/Å], shape [S, N, d]; None where the load is not known.
        arrays: optional per-sample arrays by name, each with first dimension S.

    Raises InputError naming the first field of wrong shape or with a value that is not finite.

    >>> samples = wp.Samples(points, u, b)
    >>> len(samples), len(samples[:5]), len(samples[-1])
    (12, 5, 1)
    """

    points: Points
    u: np.ndarray
    b: np.ndarray | None = None
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("u", "b") if self.b is not None else ("u",):
            count: int | str = "S" if name == "u" else len(self.u)
            field = checked(name, getattr(self, name), shape=(count, *self.x.shape))
            object.__setattr__(self, name, field)
        for name, value in self.arrays.items():
            if name in FIELDS or not is_name(name):
                raise InputError(f"arrays: {name!r} cannot be the name of an array")
            found = as_array(name, value)
            if found.ndim == 0 or len(found) != len(self.u) or np.ma.is_masked(found):
                count = f"each of {len(self.u)} samples"
                raise InputError(f"{name}: expected one entry for {count}, and none that is masked")

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.u)

    def __getitem__(self, which: Any) -> Samples:
        """Some of the samples, with what belongs to them: a number, a slice, or an array."""
        try:
            rows = np.atleast_1d(np.arange(len(self))[which])
        except (IndexError, TypeError) as error:
            if isinstance(which, (int, np.integer)):  # where a loop over samples ends
                raise
            raise InputError(f"samples: expected some of {len(self)} ({error})") from None
        arrays = {name: np.asarray(values)[rows] for name, values in self.arrays.items()}
        b = None if self.b is None else self.b[rows]
        return replace(self, u=self.u[rows], b=b, arrays=arrays)

    @property
    def x(self) -> np.ndarray:
        """Positions [Å], shape [N, d]."""
        return self.points.x

    @property
    def interior(self) -> np.ndarray:
        """Nodes where equilibrium is asked, shape [N] bool."""
        return self.points.interior

    @property
    def spacing(self) -> float:
        """Lattice spacing [Å]; 0 for scattered points."""
        return self.points.spacing

    @property
    def box(self) -> tuple[float, ...] | None:
        """Periods [Å] of the points, or None."""
        return self.points.box

    @property
    def outside(self) -> np.ndarray | None:
        """Nodes that are not part of the body, shape [N] bool."""
        return self.points.outside

    @property
    def axis(self) -> Any:
        """Of the material against the points, as Points.axis, or None."""
        return self.points.axis

    @property
    def loads(self) -> np.ndarray:
        """b [TPa/Å]; InputError where it is not known."""
        if self.b is None:
            raise InputError("b: expected loads, got samples whose loads are not known (b=None)")
        return self.b

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value."""
        length, stress = symbols(self.points.units)
        rows = [("samples", str(len(self))), *self.points.rows()]
        rows.append(("u", f"up to {np.abs(self.u).max(initial=0.0):.3g} {length}"))
        known = "not known"
        if self.b is not None:
            largest = np.abs(self.b[:, self.interior]).max(initial=0.0)
            known = f"up to {largest:.3g} {stress}/{length}"
        return [*rows, ("b", known), *((name, "by sample") for name in self.arrays)]


def seen_of(samples: Samples) -> np.ndarray:
    """Nodes whose displacement was seen, shape [S, N] bool: all where nothing says otherwise."""
    return checked(SEEN, samples.arrays.get(SEEN, np.ones(samples.u.shape[:2], bool)), bool)


PointsLike: TypeAlias = Points | Samples
"""What has nodes: functions that look at no field take either."""


def nodes_of(given: PointsLike) -> Points:
    """The points themselves, or a rank's piece of them; InputError for what is none."""
    if not (isinstance(given, (Points, Samples)) or is_piece(given)):
        raise InputError(
            f"points: expected Points(x, interior, spacing), got {type(given).__name__}"
        )
    return given.points if isinstance(given, Samples) else given


_said: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()
"""Positions that a direction was assumed on; gone with the points."""


def unsaid(points: PointsLike) -> bool:
    """Whether nothing was said of the direction on these positions before; now it is."""
    x = points.x
    if _said.get(id(x)) is x:
        return False
    _said[id(x)] = x
    return True


def axis_of(points: PointsLike) -> float:
    """Angle [rad] from the x axis of points to that of the material.

    Where none is stated it is taken as 0, with a warning, once for these points.
    """
    if points.axis is None:
        if unsaid(points):
            warn(
                "axis: the model depends on direction, and the points do not state that of the "
                "material: taken along x; Points(…, axis=degrees) states it"
            )
        return 0.0
    return float(np.deg2rad(points.axis))


def edge_strain(x: np.ndarray, triangles: np.ndarray, u: np.ndarray) -> float:
    """As largest_strain, between the ends of the edges of triangles.

    Args:
        x: corners [Å], shape [P, 2].
        triangles: their corners, shape [T, 3].
        u: displacement of the corners [Å], shape [P, 2].
    """
    after = np.roll(triangles, -1, axis=1)
    xi, relative = x[after] - x[triangles], u[after] - u[triangles]
    along = (xi * relative).sum(axis=-1) / (xi**2).sum(axis=-1)
    return float(np.abs(along).max(initial=0.0))


WAVE_VECTOR = "wave_vector"
"""Per-sample array of a set whose loads are single waves: k [1/Å], shape [S, 2]."""


def largest_wave_number(points: Samples) -> float | None:
    """Largest |k| [1/Å] of the samples' loads; None on scattered points or without loads.

    Of loads at wave vectors their own; of others the root mean square of |k| over the spectrum of
    b, from differences of neighbouring nodes (theory, M1).
    """
    if WAVE_VECTOR in points.arrays:
        k = checked(WAVE_VECTOR, points.arrays[WAVE_VECTOR])
        return float(np.linalg.norm(k, axis=-1).max(initial=0.0)) or None
    h = points.spacing
    if h == 0 or points.b is None:
        return None
    r, near = cKDTree(points.x).query(points.x, k=min(5, len(points.x)))
    whole = points.interior & (r <= 1.1 * h).all(axis=1) & (near.shape[1] == 5)
    near = near[whole, 1:]
    largest = 0.0
    for b in points.b:
        size = (b[whole] ** 2).sum()
        if size > 0:
            s = ((b[near] - b[whole, None]) ** 2).sum() / (2 * h**2 * size)
            # of all directions on average s = |k|² − |k|⁴ h²/16
            largest = max(largest, (1 - np.sqrt(max(1 - s * h**2 / 4, 0.0))) * 8 / h**2)
    return float(np.sqrt(largest)) or None
