"""Lattice inside a body (theory, B4, B15), and its coupling to the rim (B5–B7, B11)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import matmul
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy import ndarray
from numpy.linalg import norm
from scipy.ndimage import distance_transform_edt
from scipy.sparse.linalg import LinearOperator, aslinearoperator, gmres

from warp_peri.core.stencil import numbers_at
from warp_peri.errors import InputError, Several, warn
from warp_peri.fe_coupling.boundary_elements import BodyLoads, Field, Moduli, Rim, RimProblem
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.materials.transfer import LEAST, TOLERANCE, on_lattice
from warp_peri.points.arguments import Units, symbols
from warp_peri.points.mesh import Mesh
from warp_peri.points.points import Points, grid_places
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
    mesh: Mesh, spacing: float, reach: float, depth: float, *, units: Units
) -> tuple[Points, ndarray] | None:
    """Lattice nodes of a body, multiples of the spacing [Å], and the cell that holds each, [N].

    Unknown are those at least `depth` [Å] inside, the collar reaches `reach` [Å] from them. None
    where no node is so far inside. Raises InputError as check_extent.
    """
    check_extent(mesh, spacing, units)
    low, high = mesh.x.min(axis=0), mesh.x.max(axis=0)
    first = np.floor(low / spacing).astype(int) - 1
    shape = np.ceil(high / spacing).astype(int) + 2 - first
    x = spacing * (first + grid_places(shape))
    held = mesh.holding(x)
    inside = held >= 0
    away = np.zeros(len(x))
    away[inside] = mesh.distance(x[inside], SAMPLED * spacing)
    unknown = away >= depth
    if not unknown.any():
        return None
    from_unknown = spacing * distance_transform_edt(~unknown.reshape(shape)).ravel()
    needed = from_unknown <= reach * (1 + 1e-6)
    return Points(x[needed], unknown[needed], spacing, units=units), held[needed]


def check_extent(mesh: Mesh, spacing: float, units: Units) -> None:
    """Raise InputError for a body of more nodes than LARGEST, or of less than one spacing."""
    sides = np.ptp(mesh.x, axis=0)
    if (sides / spacing + 3).prod() > LARGEST or sides.max() < spacing:
        raise InputError(
            f"mesh: {' by '.join(f'{side:.3g}' for side in sides)}, expected positions of a body "
            f"that a lattice of {spacing:g} {symbols(units)[0]} fills with 1 to {LARGEST:.0e} nodes"
        )


class Bulk(LinearOperator):  # type: ignore[misc]
    """Problem L u = b of a linear material on the unknown nodes.

    A linear map from b and u on the collar, flat [d (I + C)], to u, flat [d I]. `accuracy` is that
    of the next solve. InputError for a singular or indefinite operator.
    """

    accuracy = 0.0

    def __init__(self, model: Any, points: Points) -> None:
        placed = LPSOperator(model, points) if isinstance(model, LPSMaterial) else model.on(points)
        self.points, self.linear, self.stress = points, placed.linear, placed.stress
        self.inside, self.collar = np.flatnonzero(points.interior), np.flatnonzero(~points.interior)
        self._inverse = self.linear.cheapest_inverse(EXCHANGES)
        super().__init__(float, (self.inside.size * points.dimension, points.x.size))

    def joined(self, inner: ndarray, collar: ndarray) -> ndarray:
        """Field of all nodes [N, d], from its values on the unknown ones and on the collar."""
        u = np.empty_like(self.points.x)
        u[self.inside], u[self.collar] = inner.reshape(-1, u.shape[1]), collar
        return u

    def residual(self, b: ndarray, u: ndarray) -> float:
        """Residual ‖L u − b‖ over ‖b − L of the collar‖."""
        held = self.joined(0 * u[self.inside], u[self.collar])
        left, right = (norm(b - self.linear(one[None])[0]) for one in (u, held))
        return float(left / (right or 1.0))

    def _matvec(self, q: ndarray) -> ndarray:
        b, collar = np.split(q.reshape(-1, self.points.dimension), [len(self.inside)])
        return self._solved(b - self.linear(self.joined(0 * b, collar)[None])[0])

    def _rmatvec(self, by: ndarray) -> ndarray:
        w = self._solved(by.reshape(-1, self.points.dimension))
        return np.append(w, -self.linear.push(w.reshape(len(self.inside), -1))[self.collar])

    def _solved(self, right: ndarray) -> ndarray:
        """Solve L_II u = right [I, d], well within the accuracy."""
        return np.ravel(self._inverse(right, min(LOOSEST, SHARE * self.accuracy)))


def cubic(points: Points, x: ndarray) -> sp.csr_array:
    """Matrix [m, I] of cubic Lagrange interpolation from the 4^d nodes around each position (B5).
    Raises InputError where one of them is not unknown."""
    h, d = points.spacing, x.shape[1]
    grid = np.rint(points.x / h).astype(int)
    corner = grid.min(axis=0)
    number = numbers_at(np.ptp(grid, axis=0) + 1, (*(grid[points.interior] - corner).T,))
    place = x / h - corner
    base = np.clip(np.floor(place).astype(int) - 1, -4, number.shape)  # beyond there is nothing
    steps, s = np.arange(4), place - base  # in [1, 2)
    others = [np.delete(steps, k) for k in steps]
    weight = np.stack(
        [np.prod((s[..., None] - j) / (k - j), axis=-1) for k, j in zip(steps, others)], axis=-1
    )
    around = grid_places((4,) * d)
    at = np.moveaxis(base[:, None] + around + 4, -1, 0)
    if (node := np.pad(number, (4, 7), constant_values=-1)[tuple(at)]).min(initial=0) < 0:
        raise InputError(
            "overlap: the rim leaves the unknown nodes; give three spacings, or a wider body"
        )
    value = np.prod([weight[:, a, around[:, a]] for a in range(d)], axis=0)
    entries = value.ravel(), (np.repeat(np.arange(len(x)), len(around)), node.ravel())
    return sp.csr_array(entries, shape=(len(x), points.interior.sum()))


RATIOS = 2.0, 1.5, 1.0, 0.75, 0.5
"""Spacings that are tried, over the coarsest that the model is certified on; coarse ones first."""
WAVE_SHARE = 0.5
"""Of the body's area that lies two horizons inside, at least."""
SAMPLES = 20_000
"""About how many points of the box around a body its depth and its load are looked at."""
OVERLAP, CRYSTAL_OVERLAP = 2.0, 4.0
"""Overlap of rim and bulk where none is given: in horizons, of a crystal in spacings."""


def collar_and_overlap(model: Any, horizon: float, coupling: Coupling) -> tuple[float, float]:
    """Collar width of unknown nodes with this horizon, and depth of the elements' overlap."""
    plane = isinstance(model, LPSMaterial)
    usual = OVERLAP * horizon if plane else CRYSTAL_OVERLAP * model.spacing
    return (2 if plane else 1) * horizon, coupling.overlap or usual


@dataclass(frozen=True)
class Tried:
    """Lattice that was tried for the bulk.

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
    """Transfer the model to the coarsest lattice that resolves loads and body; lists those tried.

    Loads are resolved where waves as long as those of b, by its mean square slope, agree with the
    model at home to the tolerance of a transfer; the body where half of its area lies two horizons
    inside and no hole is smaller than the overlap. Else the finest; a warning tells of loads.
    """
    home, unit = max(model.certified_on), symbols(model.units)[0]
    check_extent(mesh, home, model.units)
    depth, wave_number = _depth_and_wave_number(mesh, b)
    hole, tried = mesh.hole_sizes.min(initial=np.inf), []

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
    """Largest error that the transfer's record has of waves as long, or longer."""
    record = model.provenance["transfer"]
    numbers = 2 * np.pi / np.array(record["wavelength"])
    errors = np.maximum.accumulate(record["error"])
    return float(np.interp(wave_number, numbers, errors, right=np.inf))


def _depth_and_wave_number(mesh: Mesh, b: Field | None) -> tuple[ndarray, float]:
    """Distance of points of a body from its outline [Å], and √(Σ |∇b|² / Σ |b|²) of its load."""
    low, high = mesh.x.min(axis=0), mesh.x.max(axis=0)
    step = np.sqrt(np.prod(high - low) / SAMPLES)
    axes = [np.arange(start + step / 2, end, step) for start, end in zip(low, high)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    x = x[mesh.holding(x) >= 0]
    size, slope = 0.0, 0.0
    if b is not None:
        size = np.square(b(x)).sum()
        ways = step / 2 * np.eye(2)
        slope = sum(np.square((b(x + d) - b(x - d)) / step).sum() for d in ways)
    return mesh.distance(x, step / 10), np.sqrt(slope / size) if size else 0.0


MOST_EXCHANGES = 100
ROUNDS = 3
"""Times that GMRES goes on from where the true mismatch was found too large."""
GOAL = 0.5
"""Share of the tolerance that GMRES aims at."""


@dataclass
class Exchange:
    """Record of the alternating solves of rim and bulk, so many `exchanges`.

    `mismatch`: relative difference of what the bulk hands back to the rim's inner side and was
    given; the residuals are ‖K u − f‖ and ‖L u − b‖ over the right-hand side.
    """

    exchanges: int = 0
    mismatch: float = 0.0
    rim_residual: float = 0.0
    bulk_residual: float = 0.0


def in_elements(
    moduli: Moduli, loads: BodyLoads, rim: Rim, outside: ndarray
) -> tuple[ndarray, LinearOperator]:
    """First guess of the rim's inner side [Å], flat [d G], and (I − M)⁻¹ of its jumps, [d G, d G].

    Both are of the whole body in linear elements: with these as bulk an exchange would be g ↦ M g +
    r, and GMRES is left the difference. `outside` are the corners of the mesh that are less deep
    than unknown nodes of the bulk, shape [P].
    """
    elements = Rim(rim.mesh, np.ones(len(rim.mesh.cells), bool), degree=1)
    K, d = elements.stiffness(moduli), rim.d
    given, fixed = (each.ravel() for each in loads.given(elements))
    whole, x = RimProblem(K, fixed), rim.x[rim.inner]
    trace = vectors(elements.probe(x, rim.mesh.holding(x)), d)
    guess = trace @ (whole @ np.append(loads.on(elements), given))
    corner = np.full(len(rim.x), -1)
    corner[rim.corner_nodes] = elements.corner_nodes[rim.corners]
    corner = corner[rim.inner]
    side = np.flatnonzero(corner >= 0)
    entries = np.ones(len(side)), (corner[side], side)
    jump = vectors(sp.csr_array(entries, shape=(len(elements.x), len(x))), d)
    kinds = np.zeros((2, len(elements.x)), bool)
    kinds[:, elements.corner_nodes[rim.corners]] = ~outside[rim.corners], outside[rim.corners]
    kinds[:, corner[side]] = False
    shared, outer = np.repeat(kinds, d, axis=1)
    # nodes that rim and bulk share follow a jump; the outer ones feel what both pull
    follow, one = RimProblem(K, fixed | ~shared), sp.eye_array(len(fixed))
    as_load, as_given = (sp.vstack([a * one, (1 - a) * one]) for a in (1, 0))
    pull = as_load @ (-sp.diags_array(outer.astype(float)) @ K)
    chain = trace, whole, pull, follow, as_given @ jump
    felt = reduce(matmul, map(aslinearoperator, chain))
    return guess, aslinearoperator(sp.eye_array(x.size)) + felt


class Schwarz:
    """Alternating solves of rim and bulk with their exchange of displacement.

    One exchange is linear in the loads q = (f, given, b) and in the inner side g, which is among
    what is given: u = S (q + P g), and the bulk hands back g = R u. Derivatives are the same
    exchange with Sᵗ, Rᵗ and Pᵗ (B12, B13). `cell` holds each bulk node; `whole` is in_elements'.
    """

    def __init__(
        self, rim: Rim, problem: RimProblem, bulk: Bulk, cell: ndarray, whole: Any
    ) -> None:
        self.rim, self.bulk, self.d, self.inner = problem, bulk, rim.d, rim.inner
        self.guess, self.correct = whole
        self.to_bulk = rim.probe(bulk.points.x[bulk.collar], cell[bulk.collar])
        n, inside = rim.x.size, bulk.shape[0]
        places = (self.d * rim.inner[:, None] + np.arange(self.d)).ravel()
        entries = np.ones(len(places)), (n + places, np.arange(len(places)))
        self.place = sp.csr_array(entries, shape=(2 * n + inside, len(places)))
        from_bulk = vectors(cubic(bulk.points, rim.x[rim.inner]), self.d)
        self.read = sp.csr_array(sp.hstack([sp.csr_array((len(places), n)), from_bulk]))
        shape = n + inside, 2 * n + inside
        self.once = LinearOperator(shape, self._once, self._transposed, dtype=float)

    def _once(self, q: ndarray) -> ndarray:
        f_and_given, b = np.split(q.ravel(), [self.rim.shape[1]])
        of_rim = self.rim @ f_and_given
        collar = self.to_bulk @ of_rim.reshape(-1, self.d)
        return np.append(of_rim, self.bulk @ np.append(b, collar))

    def _transposed(self, by: ndarray) -> ndarray:
        by_rim, by_bulk = np.split(by.ravel(), [self.rim.shape[0]])
        by_b, by_collar = np.split(self.bulk.T @ by_bulk, [len(by_bulk)])
        pushed = self.to_bulk.T @ by_collar.reshape(-1, self.d)
        return np.append(self.rim.T @ (by_rim + pushed.ravel()), by_b)

    def solve(
        self, f: ndarray, given: ndarray, b: ndarray, tolerance: float
    ) -> tuple[ndarray, ndarray, Exchange]:
        """Displacements of rim [n, d] and bulk [N, d] that agree to a tolerance, and the record.

        For the load f [TPa Å] and held displacement on the rim, [n, d], and the body force density
        b [TPa/Å] on the unknown nodes, [I, d]. Raises InputError when they do not agree.
        """
        q = np.concatenate([f.ravel(), given.ravel(), b.ravel()])
        ways = self.once, self.place, self.read, self.correct
        u, record = self._joined(ways, q, self.guess, tolerance)
        if not record.mismatch <= tolerance:
            raise InputError(
                f"tolerance: rim and bulk agree to {record.mismatch:.1e} after "
                f"{record.exchanges} exchanges, expected {tolerance:.1e}"
            )
        of_rim, of_bulk = (part.reshape(-1, self.d) for part in np.split(u, [f.size]))
        side = of_rim.copy()
        side[self.inner] = (self.read @ u).reshape(-1, self.d)
        record.rim_residual = self.rim.residual(f.ravel(), side.ravel())
        u_bulk = self.bulk.joined(of_bulk, self.to_bulk @ of_rim)
        record.bulk_residual = self.bulk.residual(b, u_bulk)
        return of_rim, u_bulk, record

    def transposed(self, by_rim: ndarray, by_bulk: ndarray, tolerance: float) -> Several:
        """Derivatives by f, given and b, of derivatives by u on rim [n, d] and bulk [N, d]."""
        by_rim = by_rim + self.to_bulk.T @ by_bulk[self.bulk.collar]
        by, n = np.append(by_rim, by_bulk[self.bulk.inside]), by_rim.size
        ways = self.once.T, self.read.T, self.place.T, self.correct.T
        found, _ = self._joined(ways, by, np.zeros_like(self.guess), tolerance)
        by_f, by_given, by_b = (part.reshape(-1, self.d) for part in np.split(found, [n, 2 * n]))
        by_given[self.inner] = 0  # not held: the bulk's
        return by_f, by_given, by_b

    def _joined(
        self, ways: tuple[Any, ...], q: ndarray, side: ndarray, tolerance: float
    ) -> tuple[ndarray, Exchange]:
        """Solve u = once (q + place g), g = read u by GMRES, later vectors less accurately (B6).
        The `ways` are once, place, read, and the first guess of the inverse of a jump."""
        (once, place, read, correct), record, bulk = ways, Exchange(), self.bulk

        def exchange(q: ndarray) -> ndarray:
            record.exchanges += 1
            return np.asarray(once @ q)

        def left(v: ndarray) -> ndarray:
            step = correct @ v
            return np.asarray(step - read @ exchange(place @ step))

        for last in [False] * ROUNDS + [True]:
            bulk.accuracy = tolerance
            u = exchange(q + place @ side)
            off = read @ u - side
            size, whole = (float(norm(one)) for one in (off, side + off))
            record.mismatch = size / (whole or 1.0)
            if record.mismatch <= tolerance or last:
                break
            goal = GOAL * tolerance * whole
            bulk.accuracy = goal / size

            def loosen(residual: float, size: float = size, goal: float = goal) -> None:
                bulk.accuracy = min(1.0, goal / (residual * size)) if residual else 1.0

            matrix = LinearOperator(2 * (len(off),), left, dtype=float)
            how = {"restart": MOST_EXCHANGES, "maxiter": 1, "callback": loosen}
            y, _ = gmres(matrix, off, rtol=0.0, atol=goal, callback_type="pr_norm", **how)
            side = side + correct @ y
        return u, record


def vectors(matrix: sp.csr_array, d: int) -> sp.csr_array:
    """Matrix of values applied to each component of vectors, shape [d m, d n]."""
    return sp.csr_array(sp.kron(matrix, np.eye(d)))
