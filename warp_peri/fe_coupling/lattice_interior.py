"""The lattice inside a body: laid into it, and its operator (theory, B4, B15)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import distance_transform_edt
from scipy.sparse.linalg import LinearOperator

from warp_peri.errors import InputError, warn
from warp_peri.fe_coupling.boundary_elements import Field
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.materials.lps_transfer import LEAST, TOLERANCE, on_lattice
from warp_peri.points.mesh import Mesh
from warp_peri.points.points import Points
from warp_peri.points.unit_names import USUAL, Units, symbols
from warp_peri.solvers.solution import Coupling

EXCHANGES = 40
"""Solves that a coupling takes, for which the inverse is set up."""
MARGIN = 0.25
"""Distance of collar nodes from the outline, in spacings: room for what curves between corners."""
SAMPLED = 0.1
"""Points of the outline that distances are measured to, in spacings."""
LARGEST = 20_000_000
"""Most lattice nodes in the box around a body."""
SHARE = 1e-2
"""Tolerance of iterative solves, of the one that is asked for."""
LOOSEST = 1e-3
"""Largest tolerance of an iterative solve."""


def bulk_points(
    mesh: Mesh, spacing: float, reach: float, depth: float, *, units: Units = USUAL
) -> tuple[Points, np.ndarray] | None:
    """Lattice nodes of a body, unknown where they are deep enough off the outline.

    Args:
        mesh: of the body.
        spacing: h [Å]; nodes are multiples of it.
        reach: of the collar [Å]: 2δ of a peridynamic solid, δ of a crystal.
        depth: of unknown nodes [Å]: the collar and a margin at least.

    Returns the nodes with their collar, and the cell that holds each, shape [N]; None where no node
    is so far inside. Raises InputError as check_extent.
    """
    check_extent(mesh, spacing, units)
    low, high = mesh.x.min(axis=0), mesh.x.max(axis=0)
    first = np.floor(low / spacing).astype(int) - 1
    shape = np.ceil(high / spacing).astype(int) + 2 - first
    axes = [spacing * (start + np.arange(n)) for start, n in zip(first, shape)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
    held = mesh.holding(x)
    inside = np.flatnonzero(held >= 0)
    away = np.zeros(len(x))
    away[inside] = mesh.distance(x[inside], SAMPLED * spacing)
    unknown = away >= depth
    if not unknown.any():
        return None
    from_unknown = spacing * distance_transform_edt(~unknown.reshape(shape)).ravel()
    needed = from_unknown <= reach * (1 + 1e-6)
    return Points(x[needed], unknown[needed], spacing, units=units), held[needed]


def check_extent(mesh: Mesh, spacing: float, units: Units = USUAL) -> None:
    """Raise InputError for a body of more nodes than LARGEST, or of less than one spacing."""
    sides = np.ptp(mesh.x, axis=0)
    if (sides / spacing + 3).prod() > LARGEST or sides.max() < spacing:
        size = " by ".join(f"{side:.3g}" for side in sides)
        raise InputError(
            f"mesh: {size}, expected positions of a body that a "
            f"lattice of {spacing:g} {symbols(units)[0]} fills with 1 to {LARGEST:.0e} nodes"
        )


class Bulk(LinearOperator):  # type: ignore[misc]
    """L u = b on the unknown nodes of a linear material: a linear map from b there and u on the
    collar, flat [d (I + C)], to u there, flat [d I].

    Args:
        model: the material, on its own lattice, or a model that is certified or allowed there.
        points: the unknown nodes and their collar.
        stiff: whether λ ≫ μ.

    `accuracy` is that of the next solve.

    Raises InputError for an operator that is singular or indefinite.
    """

    accuracy = 0.0

    def __init__(self, model: Any, points: Points, *, stiff: bool = False) -> None:
        placed: Any = (
            LPSOperator(model, points) if isinstance(model, LPSMaterial) else model.on(points)
        )
        self.points, self.linear, self.stress = points, placed.linear, placed.stress
        self.inside, self.collar = np.flatnonzero(points.interior), np.flatnonzero(~points.interior)
        self._inverse = self.linear.cheapest_inverse(EXCHANGES, stiff=stiff)
        super().__init__(float, (self.inside.size * points.dimension, points.x.size))

    def joined(self, inner: np.ndarray, collar: np.ndarray) -> np.ndarray:
        """A field of all nodes [N, d], of its values on the unknown ones and on the collar."""
        u = np.empty_like(self.points.x)
        u[self.inside], u[self.collar] = inner.reshape(-1, u.shape[1]), collar
        return u

    def residual(self, b: np.ndarray, u: np.ndarray) -> float:
        """‖L u − b‖ over ‖b − L of the collar‖."""
        held = self.joined(0 * u[self.inside], u[self.collar])
        left, right = (np.linalg.norm(b - self.linear(one[None])[0]) for one in (u, held))
        return float(left / (right or 1.0))

    def _matvec(self, q: np.ndarray) -> np.ndarray:
        u = q.reshape(-1, self.points.dimension)
        b, collar = np.split(u, [len(self.inside)])
        return self._solved(b - self.linear(self.joined(0 * b, collar)[None])[0])

    def _rmatvec(self, by: np.ndarray) -> np.ndarray:
        w = self._solved(by.reshape(-1, self.points.dimension))
        return np.append(w, -self.linear.push(w.reshape(len(self.inside), -1))[self.collar])

    def _solved(self, right: np.ndarray) -> np.ndarray:
        """L_II⁻¹ of a right-hand side [I, d], well within the accuracy."""
        return np.ravel(self._inverse(right, min(LOOSEST, SHARE * self.accuracy)))


def cubic(points: Points, x: np.ndarray) -> sp.csr_array:
    """Matrix from values at unknown nodes to values at positions, cubic along each axis (B5).

    Shape [m, I]; Lagrange's polynomials of the 4^d nodes around each position.

    Raises InputError where one of them is not an unknown node.
    """
    h, d = points.spacing, x.shape[1]
    grid = np.rint(points.x / h).astype(int)
    corner = grid.min(axis=0)
    number = np.full(np.ptp(grid, axis=0) + 1, -1)
    number[tuple((grid[points.interior] - corner).T)] = np.arange(points.interior.sum())
    place = x / h - corner
    base = np.clip(np.floor(place).astype(int) - 1, -4, number.shape)  # beyond there is nothing
    steps, s = np.arange(4), place - base  # in [1, 2)
    others = [np.delete(steps, k) for k in steps]
    weight = np.stack(
        [np.prod((s[..., None] - j) / (k - j), axis=-1) for k, j in zip(steps, others)], axis=-1
    )
    around = np.indices((4,) * d).reshape(d, -1).T
    at = np.moveaxis(base[:, None] + around + 4, -1, 0)
    if (node := np.pad(number, (4, 7), constant_values=-1)[tuple(at)]).min(initial=0) < 0:
        raise InputError(
            "overlap: the inner side of the rim leaves the nodes that are solved for; expected an "
            "overlap of three spacings or more, or a wider body"
        )
    value = np.prod([weight[:, a, around[:, a]] for a in range(d)], axis=0)
    row = np.repeat(np.arange(len(x)), len(around))
    shape = (len(x), int(points.interior.sum()))
    entries = (value.ravel(), (row, node.ravel()))
    return sp.csr_array(sp.coo_array(entries, shape=shape))


RATIOS = (2.0, 1.5, 1.0, 0.75, 0.5)
"""Spacings that are tried, over the coarsest that the model is certified on; coarse ones first."""
WAVE_SHARE = 0.5
"""Of the body's area that lies two horizons inside, at least."""
SAMPLES = 20_000
"""About how many points of the box around a body its depth and its load are looked at."""


OVERLAP, CRYSTAL_OVERLAP = 2.0, 4.0
"""Overlap of rim and bulk where none is given: in horizons, of a crystal in spacings."""


def collar_and_overlap(model: Any, horizon: float, coupling: Coupling) -> tuple[float, float]:
    """How far unknown nodes feel with this horizon, and how deep elements and lattice overlap."""
    plane = isinstance(model, LPSMaterial)
    usual = OVERLAP * horizon if plane else CRYSTAL_OVERLAP * model.spacing
    return (2 if plane else 1) * horizon, coupling.overlap or usual


@dataclass(frozen=True)
class Tried:
    """A lattice that was looked at.

    Attributes:
        spacing: h [Å].
        horizon: δ of the model there [Å]; the least there can be where that is too much already.
        share: of the body's area that lies two horizons inside.
        wave_error: relative error, against the model at home, of the displacement by waves of the
            length that the load has; NaN where nothing was transferred.
        verdict: "taken", or why not.
    """

    spacing: float
    horizon: float
    share: float
    wave_error: float
    verdict: str


def bulk_lattice(
    model: LPSMaterial, mesh: Mesh, b: Field | None, coupling: Coupling
) -> tuple[LPSMaterial, tuple[Tried, ...]]:
    """The model on the coarsest lattice that resolves the loads and the body, and the search.

    The loads are resolved where waves as long as those of the body force, by its mean square
    slope, agree with the model at home to the tolerance of a transfer. The body is where half of
    its area lies two horizons inside, and no hole is smaller than the overlap. Where no lattice
    does, the finest is taken, with a warning when it is for the loads.

    Returns the model, certified on some lattice, on the one that was chosen, and what was tried;
    the last is what was taken. b [TPa/Å] is None for no load. Raises InputError as check_extent.
    """
    home, unit = max(model.certified_on), symbols(model.units)[0]
    check_extent(mesh, home, model.units)
    depth, wave_number = _depth_and_wave_number(mesh, b)
    hole, tried = mesh.hole_sizes.min(initial=np.inf), list[Tried]()

    def looked_at(spacing: float, horizon: float, error: float = np.nan, words: str = "") -> str:
        collar, overlap = collar_and_overlap(model, horizon, coupling)
        share = float(np.mean(depth > collar))
        if hole < overlap:
            words = "a hole is smaller than the overlap"
        elif share < WAVE_SHARE:
            words = f"only {share:.0%} of the body is two horizons inside"
        tried.append(Tried(spacing, horizon, share, error, words))
        return words

    for spacing in (home * np.array(RATIOS)).tolist():
        last = spacing == home * RATIOS[-1]
        if looked_at(spacing, LEAST * spacing) and not last:
            continue
        del tried[-1]
        try:
            here, error = on_lattice(model, spacing=spacing), 0.0
        except InputError as refused:
            looked_at(spacing, LEAST * spacing, words=str(refused))
            continue
        if model.is_certified_on(spacing) and here.horizon >= model.horizon * (1 - 1e-9):
            here = model  # fewer bonds do not serve: no copy of what is there
        else:
            error = _wave_error(here, wave_number)
        rough = error > TOLERANCE
        words = "the waves of the load are not resolved" if rough else "taken"
        if looked_at(spacing, here.horizon, error, words) == "taken" or last:
            if wave_number and rough:
                warn(
                    f"b: waves of {2 * np.pi / wave_number:.3g} {unit} are not resolved to "
                    f"{TOLERANCE:.1%} on the lattice of {spacing:g} {unit}, the finest"
                )
            return here, tuple(tried)
    raise InputError(f"model: {tried[-1].verdict}; give a spacing")


def _wave_error(model: LPSMaterial, wave_number: float) -> float:
    """Largest error of waves as long, or longer, that the transfer's record knows."""
    record = model.provenance["transfer"]
    numbers = 2 * np.pi / np.array(record["wavelength"])
    errors = np.maximum.accumulate(record["error"])
    return float(np.interp(wave_number, numbers, errors, right=np.inf))


def _depth_and_wave_number(mesh: Mesh, b: Field | None) -> tuple[np.ndarray, float]:
    """Distance of points of a body from its outline [Å], and √(Σ |∇b|² / Σ |b|²) of its load."""
    low, high = mesh.x.min(axis=0), mesh.x.max(axis=0)
    step = float(np.sqrt(np.prod(high - low) / SAMPLES))
    axes = [np.arange(start + step / 2, end, step) for start, end in zip(low, high)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    x = x[mesh.holding(x) >= 0]
    size, slope = 0.0, 0.0
    if b is not None:
        size = float(np.square(b(x)).sum())
        ways = step / 2 * np.eye(2)
        slope = sum(float(np.square((b(x + d) - b(x - d)) / step).sum()) for d in ways)
    return mesh.distance(x, step / 10), float(np.sqrt(slope / size)) if size else 0.0
