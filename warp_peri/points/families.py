"""Families of nodes joined by bonds: bond classes, collars, bond strain, and quadrature weights,
exact on a singular reproducing space (theory, 7–8, V4)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import warp as wp
from numpy import ndarray
from numpy.linalg import norm, svd
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt
from scipy.spatial import ConvexHull, QhullError, cKDTree
from scipy.special import beta

from warp_peri.errors import Held, InputError, hold
from warp_peri.kernels import neighbours as kernels
from warp_peri.kernels import quadrature
from warp_peri.points.arguments import check_whole, checked, listed, symbols
from warp_peri.points.points import LATTICE_TOLERANCE, PointsLike, grid_places, nearest
from warp_peri.runtime import floats, ints, launch_slices, zeros

DEGREE = 5
SINGULARITY = 3
RESIDUAL = 1e-10
"""Largest relative residual of the exactness conditions that is accepted."""
DEPENDENT = 1e-12
"""Singular values below this fraction of the largest count as zero."""
INDEPENDENT = 1e-4
"""Pivots of the Gram matrix, by their roots, above this fraction of the largest need no SVD, which
takes a hundred times as long."""
HORIZON_TOLERANCE = 1e-6
"""The ball is closed: a bond belongs to the family when r ≤ δ (1 + this); on a lattice, whose
spacing has a tolerance of its own, 1 + twice this."""
COLLAR = "interior nodes need complete families out to twice the horizon"
ROUNDING = 1e-12
"""Weights below this, relative to the largest, are zero."""
LARGEST_REACH = {2: 100, 3: 20}
"""Largest horizon in spacings, by dimension: a family of 31 000 or 33 000 bonds."""
BOND_COLLAR = "interior nodes need complete families"
AT_EDGES = "Free edges and holes: Body(mesh, …), whose elements take what an edge cuts"


@dataclass(frozen=True)
class BondClasses(Held):
    """Bonds of a full lattice family, sorted into symmetry orbits.

    Attributes:
        spacing: lattice spacing h [Å].
        horizon: δ [Å].
        steps: bond vectors in lattice steps, shape [B, d], B bonds a family.
        bond_class: class of each bond, shape [B].
        r: bond length of each class [Å], shape [C].
        weight: quadrature weight W of each class [Å^d], shape [C].
    """

    spacing: float
    horizon: float
    steps: ndarray
    bond_class: ndarray
    r: ndarray
    weight: ndarray

    def __post_init__(self) -> None:
        hold(self, **vars(self))  # all that ask for them share them

    @property
    def xi(self) -> ndarray:
        """Bond vectors ξ [Å] along the lattice's own axes, shape [B, d]."""
        return self.spacing * self.steps

    @property
    def count(self) -> ndarray:
        """Number of bonds of a family in each class, shape [C]."""
        return np.bincount(self.bond_class)

    @property
    def reverse(self) -> ndarray:
        """Number of the bond with the opposite vector, shape [B]."""
        order = np.lexsort(self.steps.T)
        return order[::-1][np.argsort(order)]


@dataclass(frozen=True)
class Families:
    """Families of the nodes of one point set; see kernels/lps.py for how sweeps read them.

    Attributes:
        row: first bond of each node, shape [N + 1].
        neighbour: node j at the far end of each bond, shape [E]. Broken bonds hold −1 − j; on a
            lattice −1 also stands for a node that is not there.
        reverse: number of the bond from j to i, for each bond of the pattern on a lattice (by
            number in the pattern, shape [B]), for each bond of scattered points (shape [E]).
        r: length of each bond class [Å], shape [C] on a lattice; on scattered points every bond is
            its own class, shape [E].
        weight: quadrature weight W of each bond class [Å^d], same shape; on scattered points zero
            for bonds of nodes that need none.
        rows: interior nodes, where forces are evaluated, shape [I].
        whole: nodes where dilatations are needed and no bond is broken.
        cut: nodes where dilatations are needed and bonds are broken.
        pattern: bond vectors ξ of a lattice family [Å], shape [B, d]; empty for scattered points.
        lattice: bond classes of the lattice; None for scattered points.
    """

    row: ndarray
    neighbour: ndarray
    reverse: ndarray
    r: ndarray
    weight: ndarray
    rows: ndarray
    whole: ndarray
    cut: ndarray
    pattern: ndarray = field(default_factory=lambda: np.empty((0, 2)))
    lattice: BondClasses | None = None

    @property
    def classes(self) -> BondClasses:
        """Bond classes of the lattice; InputError for scattered points, which have none."""
        if self.lattice is None:
            raise InputError("points: expected a lattice (spacing > 0), got scattered points")
        return self.lattice


@lru_cache(maxsize=64)
def bond_classes(
    spacing: float, horizon: float, *, degree: int = DEGREE, dimension: int = 2
) -> BondClasses:
    """Bonds, orbits and weights, of a degree, of the full family on a square or cubic lattice;
    cached. InputError for a horizon below one spacing or too large, and where no weights exist."""
    most = LARGEST_REACH[dimension]
    if not 0 < spacing <= horizon < np.inf:
        raise InputError(f"horizon: expected at least one spacing ({spacing}), got {horizon}")
    if horizon > most * spacing:
        raise InputError(f"horizon: expected at most {most} spacings of {spacing:g}, got {horizon}")
    longest = math.floor((horizon / spacing * (1 + 2 * HORIZON_TOLERANCE)) ** 2)
    reach = math.isqrt(longest)
    steps = grid_places(dimension * (2 * reach + 1,)) - reach
    square = (steps**2).sum(axis=1)
    steps = steps[(square > 0) & (square <= longest)]
    orbit = np.sort(np.abs(steps), axis=1)[:, ::-1]
    order = np.lexsort((*orbit.T[-2::-1], (orbit**2).sum(1)))
    steps, orbit = steps[order], orbit[order]
    new = np.ones(len(orbit), bool)
    new[1:] = (orbit[1:] != orbit[:-1]).any(axis=1)
    bond_class = np.cumsum(new) - 1
    weights = quadrature_weights(spacing * steps, horizon, degree=degree)
    weight = np.bincount(bond_class, weights) / np.bincount(bond_class)
    # At δ = 2h the farthest bonds have none. Rounding gives them a sign that hangs on the machine,
    # and a negative weight is refused where bonds break.
    weight[np.abs(weight) < ROUNDING * np.abs(weight).max()] = 0.0
    r = spacing * np.hypot.reduce(orbit[new].astype(float), axis=1)
    return BondClasses(spacing, horizon, steps, bond_class, r, weight)


def families_of(
    points: PointsLike, horizon: float, *, bond_based: bool = False, degree: int = DEGREE
) -> Families:
    """Build families and quadrature weights of all nodes that a force on the interior needs.

    A `bond_based` force needs no dilatation, so that a collar of δ is enough. Raises
    InputError for points given twice, isolated points, points off their lattice, a horizon
    below the spacing, a family without exact weights, and interior nodes that lack the collar;
    nodes are named by number.
    """
    x, interior, outside = points.x, points.interior, points.outside
    classes: BondClasses | None = None
    if points.spacing > 0:  # one pattern of bonds for all nodes
        classes = bond_classes(points.spacing, horizon, degree=degree, dimension=points.dimension)
        grid, axes = points.lattice
        reach = int(np.abs(classes.steps).max())
        size = None if points.box is None else nodes_in_period(points, 2 * reach)
        table = neighbour_table(grid, classes.steps, size)
        lacking = np.asarray((table < 0).any(axis=1))
        row, neighbour = np.arange(len(x) + 1) * len(classes.steps), table.reshape(-1)
        if row[-1] >= 2**31:
            raise InputError(f"points: {row[-1]} bonds are more than can be numbered (2³¹)")
        row = row.astype(np.int32)
    else:  # bonds, and weights of their own for each family
        row, neighbour, r, reverse = neighbours(x, horizon * (1 + HORIZON_TOLERANCE), points.box)
        lacking = np.zeros(len(x), bool) if points.box else cut_balls(x, horizon, len(neighbour))
    ends, has_broken = neighbour, np.zeros(len(x), bool)
    if outside is not None:
        has_broken = _any_neighbour(row, neighbour, outside) & ~outside
        across = (neighbour >= 0) & (outside[neighbour] != np.repeat(outside, np.diff(row)))
        neighbour = np.where(across, -1 - neighbour, neighbour)
    needed = interior if bond_based else interior | _any_neighbour(row, neighbour, interior)
    if (lacking & needed).any():
        short = lacking if bond_based else lacking | _any_neighbour(row, neighbour, lacking)
        raise InputError(_lacking_collar(points, horizon, short, bond_based))
    whole, cut = np.flatnonzero(needed & ~has_broken), np.flatnonzero(needed & has_broken)
    nodes = np.flatnonzero(interior), whole, cut
    if classes is None:
        weight = weights(x, np.flatnonzero(needed), row, ends, points.box, horizon, degree)
        return Families(row, neighbour, reverse, r, weight, *nodes)
    reverse = classes.reverse.astype(np.int32)
    tables = classes.r, classes.weight, *nodes, classes.xi @ axes.T, classes
    return Families(row, neighbour, reverse, *tables)


def nodes_in_period(points: PointsLike, least: int) -> ndarray:
    """Number of nodes in a period along each axis, [d]; InputError for a turned lattice, and for
    periods that are no whole multiples of the spacing, above `least` of it."""
    h, box = points.spacing, np.array(points.box)
    if not np.array_equal(points.lattice.axes, np.eye(points.dimension)):
        raise InputError("box: expected a lattice along the axes, got a rotated one")
    size: ndarray = np.rint(box / h).astype(np.int32)
    if (np.abs(size * h - box) > LATTICE_TOLERANCE * box).any() or size.min() <= least:
        raise InputError(f"box: expected whole multiples of {h}, above {least} of it, got {box}")
    return size


def _any_neighbour(row: ndarray, neighbour: ndarray, flag: ndarray) -> ndarray:
    """Nodes with an unbroken bond to a flagged node."""
    reached = zeros(len(flag), dtype=wp.int32)
    given = ints(row), ints(neighbour), ints(flag), reached
    launch_slices(kernels.any_neighbour, len(flag), given)
    return np.asarray(reached.numpy() > 0)


def _lacking_collar(points: PointsLike, horizon: float, short: ndarray, bond_based: bool) -> str:
    """What is said of interior nodes that are short of a collar, with a horizon that fits."""
    length, fits = symbols(points.units)[0], ""
    if points.spacing > 0 and not bond_based:
        steps = math.floor(100 * carried_horizon(points) / points.spacing) / 100
        fits = f"; {steps * points.spacing:g} {length} fits"
        if steps < 2:
            fits = f"; no horizon of two spacings or more fits. {AT_EDGES}"
    lacking = np.flatnonzero(short & points.interior)
    return (
        f"{BOND_COLLAR if bond_based else COLLAR}: {len(lacking)} of "
        f"{np.count_nonzero(points.interior)} have not at horizon {horizon:g} {length}{fits} "
        f"(nodes {listed(lacking)})"
    )


def carried_horizon(points: PointsLike) -> float:
    """Horizon [Å] below which every interior node of a lattice has its families out to 2δ. Half the
    distance from the interior to the nearest place of the lattice without a node; on a periodic
    sheet a quarter of the smaller period."""
    if points.box is not None:
        return min(points.box) / 4
    grid = points.lattice.steps
    there = np.zeros(grid.max(axis=0) + 3, bool)
    there[*(grid + 1).T] = True
    clear = distance_transform_edt(there)[*(grid[points.interior] + 1).T]
    return float(clear.min()) * points.spacing / 2 * (1 - 2 * HORIZON_TOLERANCE)


def neighbour_table(grid: ndarray, steps: ndarray, size: ndarray | None = None) -> ndarray:
    """The node at each of steps [B, d] from nodes at lattice steps [N, d], −1 where there is none:
    [N, B] int32. `size` are periods in lattice steps, more than twice the longest step. Raises
    InputError for nodes given twice."""
    reach = int(np.abs(steps).max())
    if size is None:
        grid = grid - grid.min(axis=0) + reach
        size = grid.max(axis=0) + 1 + reach
        wrapped = 0
    else:
        grid, wrapped = grid % size, reach
    number = np.full(size, -1, dtype=np.int32)
    number[*grid.T] = nodes = np.arange(len(grid))
    if len(twice := np.flatnonzero(number[*grid.T] != nodes)):
        raise InputError(f"points: {len(twice)} duplicates: {listed(twice)}")
    number = np.pad(number, wrapped, mode="wrap")
    stride = np.array(number.strides) // number.itemsize
    table = zeros(len(grid), len(steps), dtype=wp.int32)
    lattice = (ints((grid + wrapped) @ stride), ints(steps @ stride), ints(number.ravel()), table)
    launch_slices(kernels.lattice_neighbours, len(grid), lattice)
    return np.asarray(table.numpy())


def neighbours(
    x: ndarray, reach: float, box: tuple[float, ...] | None = None
) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Find the points within reach [Å] of each point, itself excluded; periods exceed twice that.
    Returns row [N + 1], neighbour [E], distance [Å] [E], and the bond back of each bond [E]; those
    of point i are row[i] … row[i + 1]. InputError for a small box, lone points, too many bonds."""
    at = x
    if box is not None:
        if not 2 * reach < min(box):
            raise InputError(f"box: expected periods above {2 * reach:g}, got {box}")
        at = x % box
        at = np.where(at < box, at, 0.0)  # of −1e-17 it is the period itself
    pairs = cKDTree(at, boxsize=box).query_pairs(reach, output_type="ndarray")
    if 2 * len(pairs) >= 2**31:
        raise InputError(f"points: {2 * len(pairs)} bonds are more than can be numbered (2³¹)")
    start, end = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.lexsort((end, start))
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order))
    reverse = np.roll(place, len(pairs))[order]
    count = np.bincount(start, minlength=len(x))
    if not count.all():
        raise InputError(
            "points: isolated, with no other within the horizon: "
            f"{listed(np.flatnonzero(count == 0))}"
        )
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
    start, end = start[order], end[order].astype(np.int32)
    return row, end, norm(nearest(x[end] - x[start], box), axis=1), reverse


def cut_balls(x: ndarray, horizon: float, bonds: int) -> ndarray:
    """Whether each node's ball leaves the convex hull of the points by more than a lattice spacing
    of their density, [N]; holes and bays cannot be told from coarser clouds, and pass."""
    try:
        hull = ConvexHull(x).equations
    except QhullError:  # all points on one line or plane
        return np.ones(len(x), bool)
    d, nodes = x.shape[1], bonds / len(x) + 1
    spacing = horizon * (np.sqrt(np.pi / nodes) if d == 2 else np.cbrt(4 / 3 * np.pi / nodes))
    depth = np.full(len(x), np.inf)
    for normal, offset in zip(hull[:, :d], hull[:, d]):
        depth = np.minimum(depth, -(x @ normal) - offset)
    return np.asarray(depth < horizon - spacing)


def largest_strain(points: PointsLike, u: ArrayLike) -> float:
    """Largest bond strain |ξ·(u_j − u_i)|/r² of nearest neighbours in the body, on a lattice also
    across diagonals, which shear along the axes stretches; u [Å] is [N, d] or [S, N, d]."""
    body = np.ones(len(points.x), bool) if points.outside is None else ~points.outside
    x, d = points.x[body], points.dimension
    if points.spacing > 0 and len(points.x) > 1:
        steps = grid_places((3,) * d) - 1
        steps = steps[np.isin((steps**2).sum(axis=1), (1, 2))]
        table = neighbour_table(points.lattice.steps[body], steps[len(steps) // 2 :])
        near = np.where(table < 0, np.arange(len(x))[:, None], table)  # each bond once
    else:
        count = min(2 * d + 1, len(x))
        near = cKDTree(x).query(x, k=count)[1].reshape(-1, count)[:, 1:]
    xi = x[near] - x[:, None]
    square = (xi**2).sum(axis=-1)
    unit = xi / np.where(square > 0, square, np.inf)[..., None]
    fields = np.asarray(u).reshape(-1, *points.x.shape)[:, body]
    along = (np.abs((unit * (one[near] - one[:, None])).sum(axis=-1)) for one in fields)
    return max((float(one.max(initial=0)) for one in along), default=0.0)


def quadrature_weights(xi: ArrayLike, horizon: float, *, degree: int = DEGREE) -> ndarray:
    """Minimum-norm weights W of a family with Σ_j W_j q(ξ_j) = ∫ q over the ball, [Å^d], [B].

    q = p / r³ with monomials p of 4 − d ≤ degree of p ≤ degree: those whose quotient is integrable
    in d dimensions (Trask et al. 2019; You et al. 2021, section 3.2). Bond vectors xi [Å] are
    [B, d], none of them zero. Raises InputError when no weights meet the conditions (the family is
    too poor), and for a degree below 2.
    """
    xi = checked("xi", xi, float, ("B", "d"))
    weights, residual = family_weights(xi, horizon, degree=degree)
    if residual > RESIDUAL:
        raise InputError(
            f"quadrature: no weights are exact for a family of {len(xi)} bonds (relative residual "
            f"{residual:.1e}, allowed {RESIDUAL:.0e}); a larger horizon has more bonds"
        )
    return weights


def family_weights(xi: ndarray, horizon: float, *, degree: int = DEGREE) -> tuple[ndarray, float]:
    """Weights as of `quadrature_weights`, by the SVD, and the largest relative residual."""
    powers, exact = conditions(degree, xi.shape[1])
    scaled = xi / horizon
    rows = np.array([(scaled**p).prod(axis=1) for p in powers])
    rows /= norm(scaled, axis=1) ** SINGULARITY
    left, size, right = svd(rows, full_matrices=False)
    large = size > DEPENDENT * size[0]
    weights = np.divide(exact @ left, size, out=np.zeros_like(size), where=large) @ right
    residual = np.abs(rows @ weights - exact).max() / np.abs(exact).max()
    return weights * horizon ** xi.shape[1], float(residual)


def conditions(degree: int, dimension: int) -> tuple[list[tuple[int, ...]], ndarray]:
    """Exponents of the Q polynomials in d variables, and their integrals over the unit ball, [Q];
    InputError for a degree that is no whole number ≥ 2."""
    degree = check_whole("quadrature degree", degree, SINGULARITY - 1)
    lowest = SINGULARITY + 1 - dimension
    every = itertools.product(range(degree, -1, -1), repeat=dimension)
    powers = sorted((p for p in every if lowest <= sum(p) <= degree), key=sum)
    return powers, np.array([ball_integral(p, SINGULARITY) for p in powers])


def ball_integral(powers: Sequence[int], exponent: float) -> float:
    """Integral ∫ ξ₁ᵃ ξ₂ᵇ … r^(−exponent) over the unit ball in as many dimensions as powers."""
    if any(n % 2 for n in powers):
        return 0.0
    sphere, half = 2.0, (powers[0] + 1) / 2
    for n in powers[1:]:
        sphere *= beta(half, (n + 1) / 2)
        half += (n + 1) / 2
    return float(sphere / (sum(powers) + len(powers) - exponent))


FAMILY = 50
"""How much more than a node's sweep its weights take a thread."""


def weights(
    x: ndarray,
    nodes: ndarray,
    row: ndarray,
    neighbour: ndarray,
    box: tuple[float, ...] | None,
    horizon: float,
    degree: int,
) -> ndarray:
    """Quadrature weights of the families of `nodes` [Å^d], zero on all other bonds, shape [E];
    InputError naming the nodes whose family is too poor."""
    d = x.shape[1]
    powers, exact = conditions(degree, d)
    vec = wp.types.vector(d, wp.float64)
    links = (floats(x, vec), ints(row), ints(neighbour), vec(*(box or d * (0.0,))))
    found = zeros(len(neighbour)), zeros(len(nodes))
    inputs = (ints(nodes), *links, horizon, INDEPENDENT, floats(exact), *found)
    kernel = quadrature.family_weights(tuple(powers))
    launch_slices(kernel, len(nodes), inputs, weight=FAMILY)
    weight, residual = (array.numpy() for array in found)
    for n in np.flatnonzero(residual < 0):  # normal equations do not do near a line
        bonds = slice(*row[nodes[n] : nodes[n] + 2])
        xi = nearest(x[neighbour[bonds]] - x[nodes[n]], box)
        weight[bonds], residual[n] = family_weights(xi, horizon, degree=degree)
    if len(poor := nodes[~(residual <= RESIDUAL)]):
        raise InputError(
            f"quadrature: no weights are exact for the families of {len(poor)} nodes: "
            f"{listed(np.sort(poor))}; a larger horizon has more bonds"
        )
    return np.asarray(weight)
