"""Nodes of a body, interior and collar, with samples of displacement and load on them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, Literal, NamedTuple, TypeAlias
from weakref import WeakValueDictionary

import numpy as np
from numpy import ndarray
from numpy.linalg import norm, qr, svd
from scipy.spatial import cKDTree

from warp_peri.errors import Held, InputError, InSpace, Rows, Shape, Shown, Values, hold, warn
from warp_peri.points.arguments import (
    LARGEST,
    USUAL,
    NotNegative,
    Positive,
    Units,
    as_array,
    check_nodes,
    check_units,
    check_whole,
    checked,
    is_name,
    is_number,
    is_piece,
    listed,
    symbols,
    typed,
)

ROTATION, TWICE = 1e-6, 1e-9
"""That a rotation may be off; distance of nodes at one place, over the mean one of neighbours."""
SHAPES = {2: "square", 3: "cubic"}
SPARSE = "points: expected a {} lattice of spacing {}{}, but no two points are that close"
LATTICE_TOLERANCE = 1e-6
"""Largest distance of a node from its lattice position, in spacings."""
SINGLE, NEAREST, ROUNDINGS = 2.0**-21, 1e-2, 3
"""Some roundings in single precision, of 2⁻²⁴ each, over the largest coordinate; how far, in
spacings, these may take a node from a lattice that is still told; and by how many steps of single
precision coordinates of one row may differ."""
EMPTY_SHARE, SMALL_TABLE = 1000, 10**7
"""The table of lattice places around the nodes may be so much larger than their number, or so
large; beyond that the nodes are too far apart to be one body."""
LARGEST_TABLE = 2**30
"""Places that can be numbered, with room for a margin."""


class Lattice(NamedTuple):
    """Lattice steps of nodes from its corner, [N, d] int32, and its axes as columns."""

    steps: ndarray
    axes: ndarray


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Points(InSpace, Shown, Held):
    """Nodes of one body: positions, interior, spacing, periods.

    Attributes:
        x: positions [Å], shape [N, d], d = 2 or 3; those in single precision on a lattice, to its
            rounding, become the lattice's.
        interior: nodes where equilibrium is asked and displacement unknown in a solve, [N] bool;
            the others are the collar, whose displacement is data.
        spacing: lattice spacing [Å]; 0 for scattered points.
        box: periods (Lx, Ly), or (Lx, Ly, Lz), along the axes [Å], more than twice the horizon and
            on a lattice whole multiples of the spacing; None when the points are not periodic.
        outside: nodes that are not part of the body, shape [N] bool, or None: they complete the
            balls that the quadrature integrates over, and bonds to them are broken (theory, 40–42).
        units: names of the units of length and stress that these nodes and their fields are in.
        axis: angle [degrees] from the x axis of the nodes to the axis of the material, a crystal's
            zigzag direction; in space that about the third axis, or the material's axes, columns of
            a rotation [3, 3]; None where it is not stated. Models that depend on it ask.

    Raises InputError naming the first field of wrong shape or with a value that is not finite.
    Periods are held against a horizon where there is one.

    >>> int(wp.Points(x, np.abs(x).max(axis=1) <= 15, spacing=5.0).interior.sum())
    49
    """

    x: ndarray
    interior: ndarray
    spacing: NotNegative
    box: tuple[float, ...] | None = None
    outside: ndarray | None = None
    units: Units = USUAL
    axis: Any = None

    def rows(self) -> Rows:
        """Name and value of each line of the points' summary table."""
        length = symbols(self.units)[0]
        kind = f"a lattice of {self.spacing:g} {length}" if self.spacing else "scattered"
        rows = [("nodes", f"{len(self.x)}, {self.interior.sum()} of them interior, {kind}")]
        if self.box is not None:
            rows.append(("periods", " × ".join(f"{side:g}" for side in self.box) + f" {length}"))
        if self.axis is not None:
            rows.append(("axis", f"{self.axis:g}°" if self.dimension == 2 else "a rotation"))
        return rows

    def __post_init__(self) -> None:
        hold(self, x=checked_positions(self.x))
        n = len(self.x)
        refuse_twice(self.x)
        hold(self, interior=checked("interior", self.interior, bool, (n,)))
        if not self.interior.any():
            raise InputError("interior: expected at least one interior node, got none")
        hold(self, units=check_units(self.units), axis=checked_axis(self.axis, self.dimension))
        if self.box is not None:
            box = checked("box", self.box, shape=(self.dimension,))
            if not (box > 0).all():
                raise InputError(f"box: expected periods > 0, got {self.box!r:.60}")
            hold(self, box=tuple(box.tolist()))
        if self.outside is not None:
            outside = checked("outside", self.outside, bool, (n,))
            if (outside & self.interior).any():
                raise InputError("outside: expected true for no interior node, got some")
            hold(self, outside=outside)
        if self.spacing > 0 and _allowed(self.x, self.spacing) > LATTICE_TOLERANCE:
            with suppress(InputError):  # which is told where a lattice is asked for
                steps, axes = self.lattice
                hold(self, x=self.x[0] + self.spacing * (steps - steps[0]) @ axes.T)

    @classmethod
    @typed
    def sheet(
        cls, sides: Shape, spacing: Positive, *, units: Units = USUAL, axis: float | None = None
    ) -> Points:
        """Make a periodic lattice along the axes, all of its nodes interior.

        Args:
            sides: nodes along each of d axes; node (i, j) is number i · sides[1] + j.
            spacing: h [length].
            units: of length and stress.
            axis: of the material, as of Points.
        """
        check_dimensions("sides", len(sides))
        check_nodes("sides", sides := whole_numbers("sides", sides))
        x, box = spacing * grid_places(sides), tuple(n * spacing for n in sides)
        return cls(x, np.ones(len(x), bool), spacing, box, None, units, axis)

    @classmethod
    @typed
    def block(
        cls,
        lengths: Sequence[float],
        spacing: Positive,
        horizon: Positive,
        *,
        units: Units = USUAL,
        axis: Any = None,
    ) -> Points:
        """Make a lattice about the origin: a box, its interior, in a collar two horizons wide.

        Args:
            lengths: sides of the box [length], 2 or 3.
            spacing: h [length].
            horizon: δ [length].
            units, axis: as of Points.

        >>> int(wp.Points.block((30.0, 20.0), spacing=5.0, horizon=12.5).interior.sum())
        35
        """
        half = checked("lengths", lengths, float, ("d",)) / 2
        check_dimensions("lengths", len(half))
        if half.min() < 0:
            raise InputError(f"lengths: expected numbers ≥ 0, got {lengths!r:.60}")
        away = lambda x: (np.abs(x) - half).max(axis=1)  # noqa: E731
        return cls._around(away, half, spacing, horizon, units=units, axis=axis)

    @classmethod
    @typed
    def disk(
        cls,
        radius: Positive,
        spacing: Positive,
        horizon: Positive,
        *,
        dimension: Literal[2, 3] = 2,
        units: Units = USUAL,
        axis: Any = None,
    ) -> Points:
        """Make a lattice about the origin: a disk or ball, the interior, in a collar of 2δ.

        Args:
            radius: of the interior [length].
            spacing: h [length].
            horizon: δ [length].
            dimension: 2, or 3 for a ball.
            units, axis: as of Points.

        >>> int(wp.Points.disk(20.0, spacing=5.0, horizon=12.5).interior.sum())
        49
        """
        away = lambda x: norm(x, axis=1) - radius  # noqa: E731
        half = np.full(dimension, radius)
        return cls._around(away, half, spacing, horizon, units=units, axis=axis)

    @classmethod
    def _around(
        cls, beyond: Any, half: ndarray, spacing: float, horizon: float, **more: Any
    ) -> Points:
        """Lattice nodes up to two horizons beyond a body, interior where within it."""
        with np.errstate(over="ignore"):
            most = np.floor((half + 2 * horizon) / spacing * (1 + LATTICE_TOLERANCE))
        check_nodes("spacing", 2 * most + 1)
        count = most.astype(int)
        x = spacing * (grid_places(2 * count + 1) - count)
        x = x[beyond(x) <= 2 * horizon + LATTICE_TOLERANCE * spacing]
        return cls(x, beyond(x) <= LATTICE_TOLERANCE * spacing, spacing, **more)

    def first_difference(self, other: Points) -> str:
        """Name of the first attribute in which two sets of points differ, or ""."""
        for name in ("spacing", "units", "box", "axis", "x", "interior", "outside"):
            mine, theirs = getattr(self, name), getattr(other, name)
            if not np.array_equal(mine, theirs):
                return name
        return ""

    @cached_property
    def lattice(self) -> Lattice:
        """Lattice steps and axes; InputError for scattered points, naming points off it."""
        check_lattice(self)
        return straight_steps(self.x, self.spacing, " " + symbols(self.units)[0])

    @property
    def is_open_lattice(self) -> bool:
        """Whether the points are a lattice without periods and broken bonds."""
        return self.spacing > 0 and self.box is None and self.outside is None


def checked_positions(x: Any) -> ndarray:
    """Check positions, [N, 2] or [N, 3] and one at least; else InputError."""
    found = checked("x", x)
    if found.ndim != 2 or found.shape[1] not in (2, 3) or len(found) == 0:
        raise InputError(f"x: expected shape [N, 2] or [N, 3] with N > 0, got {list(found.shape)}")
    return found


def checked_axis(axis: Any, dimension: int) -> Any:
    """Check an axis as of Points: an angle, a rotation as tuples, or None; else InputError."""
    if axis is None:
        return None
    if dimension == 3 and not is_number(axis):
        turn = checked("axis", axis, shape=(3, 3))
        if np.abs(turn @ turn.T - np.eye(3)).max() > ROTATION:
            raise InputError(f"axis: expected a rotation [3, 3], got {axis!r:.60}")
        return tuple(map(tuple, turn.tolist()))
    if is_number(axis) and abs(float(axis)) <= LARGEST:
        return float(axis)
    raise InputError(f"axis: expected an angle [degrees], got {axis!r:.60}")


def refuse_twice(x: ndarray) -> None:
    """Raise InputError for coincident nodes (to 1e-9 of the mean distance), by one sort of x."""
    n, d = x.shape
    near = TWICE * np.ptp(x, axis=0).max() / n ** (1 / d)
    along = x @ np.array([1.0, 0.6180339887, 0.4142135624])[:d]
    order = np.argsort(along, kind="stable")
    close = np.flatnonzero(np.diff(along[order]) <= 2 * near)
    pairs = np.sort(np.stack([order[close], order[close + 1]], axis=1), axis=1)
    pairs = pairs[np.abs(x[pairs[:, 0]] - x[pairs[:, 1]]).max(axis=1, initial=0.0) <= near]
    if len(pairs):
        pairs = pairs[np.lexsort(pairs.T[::-1])]
        named = ", ".join(f"{a} and {b}" for a, b in pairs[:5])
        raise InputError(f"points: {len(pairs)} duplicates: {named}{' …' * (len(pairs) > 5)}")


def check_lattice(points: Any) -> None:
    """Raise InputError for scattered points, saying what carries samples to a lattice."""
    if points.spacing == 0:
        raise InputError(
            "points: expected a lattice, got scattered points; "
            "transfers.onto_lattice(samples, spacing=…) carries samples to one"
        )


def grid_places(shape: Sequence[int] | ndarray) -> ndarray:
    """All places of a grid, the last index first to change, shape [n, d]."""
    return np.argwhere(np.ones(shape, bool))


def grid_points(line: Iterable[float], dimension: int) -> ndarray:
    """All points whose coordinates are among those of a line, the last changing fastest."""
    return np.array(list(itertools.product(line, repeat=dimension)))


def straight_steps(x: ndarray, h: float, unit: str = "") -> Lattice:
    """Lattice steps and axes of nodes of spacing h, the axes those of x where along them;
    InputError naming points off the lattice, and for nodes too far apart to be one body."""
    near = _allowed(x, h)
    places, d = np.prod(np.ptp(x, axis=0) / h + 1), x.shape[1]
    if places > max(SMALL_TABLE, min(EMPTY_SHARE * len(x), LARGEST_TABLE)):
        raise InputError(
            f"points: {len(x)} nodes spread over {places:.1e} lattice places; expected one body"
        )
    axes = np.eye(d)
    place = (x - x[0]) / h
    off = np.abs(place - np.rint(place)).max(axis=1)
    if np.median(off) > near:  # else it is straight, and few nodes are off it
        axes = _axes(x, h, near, unit)
        place = (x - x[0]) @ axes / h
        off = np.abs(place - np.rint(place)).max(axis=1)
    elif near > LATTICE_TOLERANCE:  # in single precision a row has nearly one coordinate
        gap = np.diff(np.sort(x.T))
        if ((gap > ROUNDINGS * np.spacing(np.float32(np.abs(x).max()))) & (gap < h / 2)).any():
            near = LATTICE_TOLERANCE
    if len(far := np.flatnonzero(off > near)):
        raise InputError(
            f"points: expected a {SHAPES[d]} lattice of spacing {h}{unit}; off it: {listed(far)}, "
            f"by up to {h * off.max():.2g}{unit}, where {near * h:.1g}{unit} "
            f"({near:.1g} spacings) are allowed: are positions rounded?"
        )
    grid = np.rint(place).astype(np.int32)
    if np.gcd.reduce(grid, axis=None) != 1:
        raise InputError(SPARSE.format(SHAPES[d], h, unit))
    return Lattice(grid - grid.min(axis=0), axes)


def _allowed(x: ndarray, h: float) -> float:
    """How far off their lattice, in spacings, nodes may lie: more in single precision."""
    with np.errstate(over="ignore"):
        single = SINGLE * np.abs(x).max() / h * np.array_equal(x, np.float32(x))
    return single if LATTICE_TOLERANCE < single <= NEAREST else LATTICE_TOLERANCE


def _axes(x: ndarray, h: float, near: float, unit: str) -> ndarray:
    """Lattice axes of nearest-neighbour directions, close to the coordinates, that fit best."""
    some, d = x[:: max(1, len(x) // 2000)], x.shape[1]
    pairs = cKDTree(x).query_ball_point(some, h * (1 + 2 * near))
    step = np.concatenate([x[near] - at for near, at in zip(pairs, some)]) / h
    step = step[norm(step, axis=1) > 0.5]
    if not len(step):
        raise InputError(SPARSE.format(SHAPES[d], h, unit))
    across = step[np.abs(step @ step[0]) < 0.1][:1]
    columns = qr(np.concatenate([step[:1], across, np.eye(d)]).T)[0]
    orders, signs = itertools.permutations(range(d)), itertools.product((1, -1), repeat=d)
    turns = [columns[:, order] * sign for order, sign in itertools.product(orders, signs)]
    grid = np.rint((x - x[0]) @ max(turns, key=np.trace) / h)
    U, _, V = svd((x - x.mean(axis=0)).T @ (grid - grid.mean(axis=0)))
    return np.asarray(U @ V)


def unit_vectors(angle: Any) -> ndarray:
    """Unit vectors of the plane at angles [rad] from the first axis, shape [..., 2]."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def whole_numbers(name: str, values: Any) -> Shape:
    """Check and return whole numbers ≥ 1 of a sequence or array; InputError for others."""
    given = values if isinstance(values, Sequence) else np.atleast_1d(as_array(name, values))
    return tuple(check_whole(name, one, 1) for one in given)


def check_dimensions(name: str, count: int) -> None:
    """Raise InputError for another dimension, or number of sides, than 2 or 3."""
    if count not in (2, 3):
        raise InputError(f"{name}: expected 2 or 3, got {count}")


def nearest(xi: ndarray, box: tuple[float, ...] | None) -> ndarray:
    """Bond vectors to the nearest periodic images."""
    return xi if box is None else xi - np.round(xi / box) * box


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
    """Displacements and loads of one body on one set of points, S samples of them.

    Attributes:
        points: the nodes; x, interior, spacing, box, outside, axis, units, dimension and lattice
            are theirs.
        u: displacements [Å], shape [S, N, d].
        b: body force densities [TPa/Å], shape [S, N, d]; None where the load is not known.
        arrays: optional per-sample arrays by name, each with first dimension S.

    Arrays are copied. Raises InputError naming the first field of wrong shape or with a value that
    is not finite.

    >>> samples = wp.Samples(points, u, b)
    >>> len(samples), len(samples[:5]), len(samples[-1])
    (12, 5, 1)
    """

    points: Points
    u: ndarray
    b: ndarray | None = None
    arrays: dict[str, ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if is_piece(self.points):
            raise InputError("points: expected Points, got a rank's piece of some")
        object.__setattr__(self, "u", checked("u", self.u, shape=("S", *self.x.shape)).copy())
        if self.b is not None:
            object.__setattr__(self, "b", checked("b", self.b, shape=self.u.shape).copy())
        own = Values()
        for name, value in self.arrays.items():
            if name in FIELDS or not is_name(name):
                raise InputError(f"arrays: {name!r} cannot be the name of an array")
            found = as_array(name, value)
            if found.ndim == 0 or len(found) != len(self.u) or np.ma.is_masked(found):
                count = f"each of {len(self.u)} samples"
                raise InputError(f"{name}: expected one entry for {count}, and none that is masked")
            if (kind := found.dtype.kind) not in "biufcU" and not all(
                type(one) is str or (kind == "S" and one.isascii()) for one in found.flat
            ):
                raise InputError(f"{name}: expected numbers or text, got {found.dtype}")
            own[name] = np.array(found.data)
        object.__setattr__(self, "arrays", own)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.u)

    def __getitem__(self, which: Any) -> Samples:
        """The samples of a number, a slice, or an index array, with their arrays."""
        try:
            rows = np.atleast_1d(np.arange(len(self))[which])
        except (IndexError, TypeError) as error:
            if isinstance(which, (int, np.integer)):  # where a loop over samples ends
                raise
            raise InputError(f"samples: expected some of {len(self)} ({error})") from None
        arrays = {name: np.asarray(values)[rows] for name, values in self.arrays.items()}
        b = None if self.b is None else self.b[rows]
        return replace(self, u=self.u[rows], b=b, arrays=arrays)

    x, interior, spacing, box, outside, axis, units, dimension, lattice = (
        property(attrgetter(f"points.{name}"), doc=f"`{name}` of the points.")
        for name in ("x", "interior", "spacing", "box", "outside", "axis", "units", "dimension",
                     "lattice")
    )  # fmt: skip

    def summary(self) -> Values:
        """Counts, spacing and arrays of the samples as plain values."""
        counts = {"samples": len(self), "nodes": len(self.x), "interior": int(self.interior.sum())}
        return counts | {"spacing": self.spacing, "arrays": [*self.arrays]}

    @property
    def loads(self) -> ndarray:
        """Loads b [TPa/Å]; InputError where they are not known."""
        if self.b is None:
            raise InputError("b: expected loads, got samples whose loads are not known (b=None)")
        return self.b

    def rows(self) -> Rows:
        """Name and value of each line of the samples' summary table."""
        length, stress = symbols(self.units)
        rows = [("samples", str(len(self))), *self.points.rows()]
        rows.append(("u", f"up to {np.abs(self.u).max(initial=0.0):.3g} {length}"))
        known = "not known"
        if self.b is not None:
            largest = np.abs(self.b[:, self.interior]).max(initial=0.0)
            known = f"up to {largest:.3g} {stress}/{length}"
        return [*rows, ("b", known), *((name, "by sample") for name in self.arrays)]


PointsLike: TypeAlias = Points | Samples
"""What has nodes: functions that look at no field take either."""


def nodes_of(given: PointsLike) -> Points:
    """The Points of points, samples or a rank's piece; InputError for other values."""
    if not (isinstance(given, (Points, Samples)) or is_piece(given)):
        raise InputError(
            f"points: expected Points(x, interior, spacing), got {type(given).__name__}"
        )
    return given.points if isinstance(given, Samples) else given


_said: WeakValueDictionary[int, ndarray] = WeakValueDictionary()
"""Positions that a direction was assumed on; gone with the points."""


def unsaid(points: PointsLike) -> bool:
    """Whether no warning about the axis at these positions was given before; records that it is."""
    x = points.x
    if _said.get(id(x)) is x:
        return False
    _said[id(x)] = x
    return True


def axis_of(points: PointsLike) -> float:
    """Angle [rad] from the x axis of points to the material's; 0, with a warning, if not stated."""
    if points.axis is None:
        if unsaid(points):
            warn(
                "axis: the model depends on direction, and the points do not state that of the "
                "material: taken along x; Points(…, axis=degrees) states it"
            )
        return 0.0
    return float(np.deg2rad(points.axis))


WAVE_VECTOR = "wave_vector"
"""Per-sample array of a set whose loads are single waves: k [1/Å], shape [S, 2]."""
