"""Proofs for stencils, in the plane and in space: D(k) ≥ c w(k) for all waves (T11–T13).

The weight w is a stencil too: the Laplacian for static problems, |h_p|² of a gradient for solids of
third order. D − c w is then one stencil. On a cell of waves its symbol is affine but for a known
remainder, and the smallest eigenvalue of an affine matrix function is concave: positive on the cell
if it is at the corners, by more than the remainder.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray
from scipy.linalg import eigh, eigvalsh, null_space

from warp_peri.core.elastic import acoustic, canonical, symmetric_part
from warp_peri.core.record import Stress
from warp_peri.core.stencil import (
    Stencil,
    bend,
    laplacian_stencil,
    smallest_eigenvalue,
    zone_sample,
    zoomed,
)
from warp_peri.errors import InputError, Values, sharing
from warp_peri.files.checkpoint import same
from warp_peri.points.arguments import LINEAR, USUAL, Pair, Positive, Units, offered, symbols, typed
from warp_peri.points.points import PointsLike, grid_points
from warp_peri.runtime import in_blocks

SAMPLE = {2: 240, 3: 24}
"""Intervals of the grid that the smallest ratio is sampled on, before zooming."""
STARTS = 8
"""Lowest waves that are zoomed into."""
SHARES = (0.99, 0.92, 0.75, 0.5, 0.25, 0.05, 0.01)
"""Of the sampled minimum, tried one after another."""
FIRST = 8
"""Cells along an axis of the zone, or of a face of directions."""
DEEPEST = 24
MOST_CELLS = {2: 400_000, 3: 3_000_000}
LONG_SHARE = 0.9995
"""Of the smallest sampled Λmin Q(e)/|e|² that is proven for long waves."""
UPPER_TOLERANCE = 2e-4
"""How far a proven bound of Λmax D may be above a value that D takes, relative."""
ROUNDING = 1e-13
"""Of Σ |C| that may be lost to rounding in a matrix."""

FOUND = 1e-9
"""Relative, by which a wave must be below the smallest ratio to count as a new one."""
NO_WEIGHT = 1e-9
"""Of |k|²: a weight below it is none."""
SAME_SPACING = 1e-6
"""Relative, of spacings that are taken as the same."""
RANK_TOLERANCE = 1e-9
"""Eigenvalues of ΦΓ⁻¹Φᵗ below this fraction of the largest count as zero."""
SCHWARZ_TOLERANCE = 1e-10

Affine = Callable[[ndarray], Pair]
"""Middles of cells [K, n] to a matrix there, [K, c, c], and its slopes, [n, K, c, c]."""


@dataclass(frozen=True)
class StencilCertificate:
    """Proven lower bound of a stencil's symbol, in its stress unit.

    Attributes:
        proven: c with D(k) ≥ c s(k) for every k; 0 where none was found.
        sampled: the smallest Λmin D/s found on a grid.
        long_waves: q with Q(e) ≥ q |e|² for all directions e, proven; 0 where not.
        cells: looked at.
        seconds: that took.
    """

    proven: Stress
    sampled: Stress
    long_waves: Stress
    cells: int
    seconds: float

    @property
    def holds(self) -> bool:
        """Whether every problem with displacement given around the unknowns has one answer."""
        return self.proven > 0

    @property
    def statement(self) -> str:
        """What the certificate proves, in one sentence."""
        if not self.holds:
            return "Nothing is proven."
        return (
            "Every static problem on any finite set of nodes of the model's lattice, with "
            "displacement given on all nodes that their bonds reach, has exactly one solution: "
            f"D(k) ≥ {self.proven:.6g} s(k) for every wave, in the model's unit of stress, "
            f"{self.proven / self.sampled:.0%} of the smallest ratio that was sampled."
        )

    def content(self) -> Values:
        """The certificate as plain values for a file."""
        return asdict(self)

    def check_of(self, stencil: Stencil, group: ndarray) -> None:
        """Raise InputError unless the bound is proven of a stencil: all cells are checked again."""
        stiff, c = _lattice_units(stencil), self.proven
        long, _ = _long_waves(stiff, group)
        most = max(self.sampled, 0.0)  # of an indefinite law nothing is said to be proven
        believed = 0 <= self.long_waves <= long * (1 + FOUND) and 0 <= c <= most
        believed &= self.cells >= 0 and self.seconds >= 0
        if believed and c > 0:  # a part of what was sampled that `prove` tries, which holds again
            tried = np.isclose(c / self.sampled, (1.0, *SHARES), rtol=1e-9).any()
            d = stencil.dimension
            weight = laplacian_stencil(1.0, d, stencil.tensors.shape[1])
            left = stiff.minus(weight, c)
            believed = bool(tried) and long > c and _positive_on_zone(left, group, long - c)[0]
            low = in_blocks(partial(_ratio, stiff, weight), zone_sample(group, d, SAMPLE[d])).min()
            believed &= bool(self.sampled <= low * (1 + FOUND))
        if not believed:
            raise InputError(
                f"certificate: D(k) ≥ {self.proven:.6g} s(k) is not proven of these tensors"
            )


class Figures:
    """Base of what is proven on one lattice, with a statement."""

    def figures(self: Any) -> Values:
        """Figures and statement as plain values, in units that are not among them."""
        figures = asdict(self) | {"statement": self.statement}
        return {k: v for k, v in figures.items() if k not in ("units", "dimension")}


@dataclass(frozen=True)
class Certificate(Figures):
    """Solvability figures of a linear solid on one lattice.

    Attributes:
        spacing: h [Å].
        symbol_min: smallest Λmin D(k)/s(k) found over the zone [TPa].
        symbol_bound: c with a proof that D(k) ≥ c s(k) for every k [TPa]; 0 when there is none.
        gamma_min: Λmin(Γ) [Å⁻²] on the training domain; this and what follows None without one.
        inf_sup_min: smallest nonzero eigenvalue of ΦΓ⁻¹Φᵗ (theorem 4.2 of You et al. 2021).
        inf_sup_rank: number of its eigenvalues that are not zero.
        gamma_minus_2phi_min, gamma_minus_2phi_max: Λmin and Λmax of Γ − 2ΦᵗΦ [Å⁻²].
        units: names of the units of length and stress.
    """

    spacing: float
    symbol_min: float
    symbol_bound: float
    gamma_min: float | None = None
    inf_sup_min: float | None = None
    inf_sup_rank: int | None = None
    gamma_minus_2phi_min: float | None = None
    gamma_minus_2phi_max: float | None = None
    units: Units = USUAL
    dimension: int = 2

    @property
    def holds(self) -> bool:
        """Whether D(k) ≥ c s(k) with c > 0 is proven, as it may be where Γ(k) > 0 is not."""
        return self.symbol_bound > 0

    @property
    def statement(self) -> str:
        """What the certificate proves, in one sentence."""
        return statement_of(self.spacing, self.symbol_bound, self.units, self.dimension)

    @property
    def paper(self) -> bool | None:
        """Whether (i) Γ > 0 and (iii) Γ − 2ΦᵗΦ ≥ 0 of (4.6) of You et al. (2021) hold; or None."""
        least, largest = self.gamma_minus_2phi_min, self.gamma_minus_2phi_max
        if self.gamma_min is None or least is None or largest is None:
            return None
        return self.gamma_min > 0 and least >= -SCHWARZ_TOLERANCE * largest  # to rounding


def stencil_of(law: Any, spacing: float, verb: str) -> tuple[Any, ndarray]:
    """Stencil of a linear solid on a lattice, and the symmetries of nodes that leave it unchanged;
    InputError for another spacing than a one-lattice solid's, and laws without a stencil."""
    found = offered(law, "stencil", verb, LINEAR)
    stencil = found(spacing) if callable(found) else found
    check_spacing(stencil.spacing, spacing, "got")
    return stencil, law.group


def check_spacing(own: float, spacing: float, said: str) -> None:
    """Raise InputError for another spacing than a one-lattice solid's own."""
    if not abs(spacing / own - 1) <= SAME_SPACING:
        raise InputError(
            f"spacing: the model is for {own:g}, {said} {spacing:g}; "
            "transfer_to_lattice(law, spacing) fits another"
        )


@typed
def certify(
    material: Any, *, spacing: Positive | None = None, points: PointsLike | None = None
) -> Certificate:
    """Compute the certificate of a linear solid, or of a material's linear part, on a lattice.

    Args:
        material: a linear solid, a material with a linear part, or the operator of either.
        spacing: h [Å]; by default that of a material for one lattice, or of an operator's points.
        points: training domain for the dense conditions (4.6) of You et al. (2021): Γ on its
            interior nodes, Φ with the dilatation of interior nodes only.

    Raises InputError for a material without a linear part, when the horizon is below one spacing,
    or the points have another spacing or do not carry the horizon.

    >>> wp.certify(model, spacing=5.0).holds
    True
    """
    law = getattr(material, "model", material)
    model = getattr(law, "linear", law)
    offered(model, "stencil", "certify", LINEAR)
    if spacing is None:
        what = "points", "certify", "a spacing, or an operator"
        spacing = getattr(model.stencil, "spacing", None) or offered(material, *what).spacing
    if points is not None and not np.isclose(points.spacing, spacing, rtol=1e-6, atol=0):
        raise InputError(
            f"spacing: expected that of the points, {points.spacing:g} "
            f"{symbols(model.units)[0]}, got {spacing:g}"
        )
    spacing = getattr(model, "certified_spacing_near", float)(spacing)
    proof = prove(*stencil_of(model, spacing, "certify"))
    found = spacing, proof.sampled, proof.proven
    made = partial(Certificate, *found, units=model.units, dimension=model.dimension)
    if points is None:
        return made()
    gamma, phi = offered(model, "interior_matrices", "points", "an LPSMaterial")(points)
    if points.interior.all():  # a period, which feels no translation
        free = null_space(np.tile(np.eye(2), len(points.x)))
        gamma, phi = free.T @ gamma @ free, phi @ free
    gamma_min = float(eigvalsh(gamma, subset_by_index=[0, 0])[0])
    schwarz = eigvalsh(gamma - 2 * phi.T @ phi)
    inf_sup, rank = None, None
    if gamma_min > 0:
        # Eigenvalues of ΦΓ⁻¹Φᵗ are those of the pencil (ΦᵗΦ, Γ), zeros aside.
        values = eigh(phi.T @ phi, gamma, eigvals_only=True)
        values = values[values > RANK_TOLERANCE * values[-1]]
        inf_sup, rank = float(values[0]), len(values)
    return made(gamma_min, inf_sup, rank, float(schwarz[0]), float(schwarz[-1]))


def statement_of(spacing: float, bound: float, units: Units, dimension: int) -> str:
    """Sentence on what a proven bound of D/s says of a lattice."""
    length, stress = symbols(units)
    shape, points = {2: ("square", 5), 3: ("cubic", 7)}[dimension]
    if not bound > 0:
        return f"Nothing is proven on the lattice of spacing {spacing:g} {length}."
    return (
        f"Every static problem on any finite set of nodes of the {shape} lattice of spacing "
        f"{spacing:g} {length}, with displacement given out to twice the horizon around it, has "
        f"exactly one solution, and the operator's smallest eigenvalue is at least {bound:.6g} "
        f"{stress} times that of the {points}-point Laplacian on the same nodes."
    )


def prove(
    stencil: Stencil,
    group: ndarray,
    weight: Stencil | None = None,
    shares: tuple[float, ...] = SHARES,
) -> StencilCertificate:
    """Prove D(k) ≥ c w(k) for the largest share of the sampled minimum that the cells allow.

    Args:
        stencil: of D.
        group: integer matrices under which D and w are invariant, shape [g, d, d]; the identity and
            the inversion alone give the proof of the whole zone.
        weight: of w, which is |k|² at long waves; s(k) by default.
        shares: of the sampled minimum, the largest first.
    """
    start = time.perf_counter()
    if weight is None:
        weight = laplacian_stencil(stencil.spacing, stencil.dimension, stencil.tensors.shape[1])
    stiff, weight = _lattice_units(stencil), _lattice_units(weight)
    ratio, d = partial(_ratio, stiff, weight), stencil.dimension
    grid = zone_sample(group, d, SAMPLE[d])
    value = in_blocks(ratio, grid)
    lowest = grid[np.argsort(value)[:STARTS]]
    sampled = min(float(value.min()), float(zoomed(ratio, lowest, np.pi / SAMPLE[d])[0].min()))
    proven = long = 0.0
    cells, left = 0, list(shares)
    if sampled > 0:
        long, cells = _long_waves(stiff, group)
    while long > 0 and sampled > 0 and left and not proven:
        c = left[0] * sampled
        if c < long:
            holds, seen, against = _positive_on_zone(stiff.minus(weight, c), group, long - c)
            cells += seen
            if holds:
                proven = c
            elif against is not None:
                lower = float(zoomed(ratio, against[None], np.pi / FIRST)[0].min())
                if lower < sampled * (1 - FOUND):  # a dip that the grid has missed
                    sampled = lower
                    continue
        left.pop(0)
    return StencilCertificate(proven, sampled, long, cells, time.perf_counter() - start)


def _lattice_units(stencil: Stencil) -> Stencil:
    """The stencil on nodes 1 apart: tensors in units of stress, those of a weight of none; of ranks
    that share the cells, all have it, or InputError."""
    if comm := sharing():
        same(comm, proof=stencil)
    return Stencil(1.0, stencil.steps, stencil.tensors * stencil.spacing**2)


def _ratio(stencil: Stencil, weight: Stencil, phase: ndarray) -> ndarray:
    """Λmin D/w at k h = `phase`, shape [K]; infinite where w vanishes."""
    w = bend(phase, weight.steps) @ weight.tensors[:, 0, 0]
    low = smallest_eigenvalue(stencil.symbol(phase))
    seen = w > NO_WEIGHT * (phase**2).sum(axis=1)
    return np.where(seen, low / np.where(seen, w, 1.0), np.where(low > 0, np.inf, -np.inf))


def parts(tensors: ndarray) -> Pair:
    """Positive and negative part of symmetric matrices, C = C⁺ − C⁻."""
    value, vector = np.linalg.eigh(tensors)
    above, below = ((vector * np.maximum(sign * value, 0)[:, None]) @ vector.mT for sign in (1, -1))
    return above, below


def _corners(d: int) -> ndarray:
    return grid_points((-1.0, 1.0), d)


def _most(stencil: Stencil, tensors: ndarray) -> float:
    """Maximum of Λmax Σ T (t·ξ)² over corners t of a cube."""
    lengths = (stencil.steps @ _corners(stencil.dimension).T) ** 2
    return float(np.linalg.eigvalsh(np.tensordot(lengths.T, tensors, 1))[:, -1].max())


def _slack(stencil: Stencil, group: ndarray) -> float:
    """How far a symbol, or Q on the faces of a cube, may be off by rounding, and its images under a
    group by what the tensors break it."""
    size = np.abs(np.linalg.eigvalsh(stencil.tensors)).max(axis=1).sum()
    apart = stencil.asymmetry(group) * np.abs(stencil.tensors).max() * (stencil.steps**2).sum()
    return 4 * stencil.dimension * float(ROUNDING * size + apart)


def _positive(
    affine: Affine,
    edge: float,
    dimension: int,
    rest: float,
    slack: float,
    asked: Callable[[ndarray, float], ndarray],
    most: int,
) -> tuple[bool, int, ndarray | None]:
    """Whether a matrix function is proven positive definite on [−edge, edge]^n, the number of cells
    (at `most`), and a middle where it is not. It may be rest · half² below its `affine` part about
    the middle of a cell, and `slack` for rounding; `asked` tells which cells matter."""
    corners, cells, half, seen = _corners(dimension), *_first_cells(edge, dimension), 0

    def states(half: float, some: ndarray) -> ndarray:
        """State of cells: 0 proven positive, 1 a corner failed, 2 negative at the middle."""
        value, slopes = affine(some)
        state = 2 * (smallest_eigenvalue(value) < 0)
        for corner in corners:
            low = smallest_eigenvalue(value + half * np.tensordot(corner, slopes, 1))
            state = np.maximum(state, low <= rest * half**2 + slack)
        return state

    for _ in range(DEEPEST):
        cells = cells[asked(cells, half)]
        seen += len(cells)
        if not len(cells):
            return True, seen, None
        if seen > most:
            break
        state = in_blocks(partial(states, half), cells)
        if state.max() > 1:
            return False, seen, cells[state.argmax()]
        half /= 2
        cells = (cells[state > 0][:, None] + half * corners).reshape(-1, dimension)
    return False, seen, None


def _first_cells(edge: float, dimension: int) -> tuple[ndarray, float]:
    """Middles of the FIRST cells per axis of [−edge, edge]^d, and half a side."""
    half = edge / FIRST
    return grid_points(-edge + half * (2 * np.arange(FIRST) + 1), dimension), half


def _symbol_slopes(stencil: Stencil, phase: ndarray) -> Pair:
    """Symbol D, shape [K, c, c], and its derivatives, [d, K, c, c]."""
    flat = stencil.tensors.reshape(len(stencil.tensors), -1)
    shape = (len(phase), *stencil.tensors.shape[1:])
    sine = 2 * np.sin(phase @ stencil.steps.T)
    slopes = [(sine @ (step[:, None] * flat)).reshape(shape) for step in stencil.steps.T]
    return (bend(phase, stencil.steps) @ flat).reshape(shape), np.array(slopes)


def long_wave_radius(stencil: Stencil, long: float) -> float:
    """Radius |k| h in which D > 0 for k ≠ 0, from Q(e) ≥ long |e|² and 1 − cos x ≥ x²/2 − x⁴/24."""
    lengths = (stencil.steps.astype(float) ** 2).sum(axis=1)
    quartic = np.tensordot(lengths**2, parts(stencil.tensors)[0], 1) / 12
    return float(0.999 * np.sqrt(long / np.linalg.eigvalsh(quartic)[-1]))


def _positive_on_zone(
    stencil: Stencil, group: ndarray, long: float
) -> tuple[bool, int, ndarray | None]:
    """Whether D(k) > 0 is proven for all k ≠ 0, the number of cells, and a wave where it is not;
    outside the ball of long waves D ≥ value and slope at a cell's middle less Σ |C| (η·ξ)²."""
    d, (above, below) = stencil.dimension, parts(stencil.tensors)
    radius = long_wave_radius(stencil, long)

    def asked(k: ndarray, half: float) -> ndarray:
        far: ndarray = ((np.abs(k) + half) ** 2).sum(axis=1) > radius**2
        far[far] = canonical(k[far], group, half)
        return far

    affine, rest = partial(_symbol_slopes, stencil), _most(stencil, above + below)
    return _positive(affine, np.pi, d, rest, _slack(stencil, group), asked, MOST_CELLS[d])


def _long_waves(stencil: Stencil, group: ndarray) -> tuple[float, int]:
    """Proven q > 0 with Q(e) ≥ q |e|² for all e, or 0, and the number of cells (T13). On cells of
    faces e_a = 1 of a cube Q(e) − q |e|² is affine plus at least −Σ C⁻ (t·ξ)² − q |t|²."""
    d, brackets = stencil.dimension, stencil.brackets
    one, both = np.eye(brackets.shape[0]), brackets + brackets.mT
    grid = grid_points(np.linspace(-1, 1, {2: 2001, 3: 121}[d]), d - 1)
    e = np.concatenate([np.insert(grid, a, 1.0, axis=1) for a in range(d)])
    e = e[canonical(e, group)]
    q = LONG_SHARE * float((smallest_eigenvalue(acoustic(brackets, e)) / (e**2).sum(axis=1)).min())
    if not q > 0:
        return 0.0, 0
    rest, slack = _most(stencil, parts(stencil.tensors)[1]) + q * (d - 1), _slack(stencil, group)
    total = 0
    for a in range(d):

        def affine(t: ndarray, a: int = a) -> Pair:
            e = np.insert(t, a, 1.0, axis=1)
            bent = np.einsum("ijkl,nl->knij", both, e) - 2 * q * e.T[:, :, None, None] * one
            slopes = np.delete(symmetric_part(bent), a, axis=0)
            return acoustic(brackets, e) - q * (e**2).sum(axis=1)[:, None, None] * one, slopes

        def asked(t: ndarray, half: float, a: int = a) -> ndarray:
            return canonical(np.insert(t, a, 1.0, axis=1), group, half)

        holds, seen, _ = _positive(affine, 1.0, d - 1, rest, slack, asked, MOST_CELLS[d])
        total += seen
        if not holds:
            return 0.0, total
    return q, total


def largest(stencil: Stencil, group: ndarray, tolerance: float = UPPER_TOLERANCE) -> float:
    """Upper bound of Λmax D(k) over all k [stress/length²], proven cell by cell (theory, T21),
    within the relative `tolerance` of a value that D takes, or as far as MOST_CELLS lead."""
    d, work, taken = _lattice_units(stencil).dimension, 0, 0.0  # of all ranks
    rest = _most(stencil, np.sum(parts(stencil.tensors), axis=0))
    slack, corners = _slack(stencil, group), _corners(d)
    cells, half = _first_cells(np.pi, d)

    def bounds(half: float, some: ndarray) -> ndarray:
        """Λmax at the middles, and its bound over the cells, shape [K, 2]."""
        value, slopes = _symbol_slopes(stencil, some)
        high = [-smallest_eigenvalue(-value - half * np.tensordot(c, slopes, 1)) for c in corners]
        return np.stack([-smallest_eigenvalue(-value), np.max(high, axis=0)], axis=1)

    while True:
        cells = cells[canonical(cells, group, half)]
        found = in_blocks(partial(bounds, half), cells)
        taken = max(taken, float(found[:, 0].max()))
        bound = found[:, 1] + rest * half**2 + slack
        still = bound > (1 + tolerance) * taken
        work += len(cells)
        if not still.any():
            return (1 + tolerance) * taken
        if work > MOST_CELLS[d]:
            return float(bound.max())
        half /= 2
        cells = (cells[still][:, None] + half * corners).reshape(-1, d)
