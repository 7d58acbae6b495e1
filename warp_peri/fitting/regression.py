"""One regression: min ‖R p(θ) − y‖², e(θ) = 0, m(θ) ≥ 0, D(k; p(θ)) ≥ ζ s(k) at every wave (26–28).

Training sets become rows of a basis, ‖R p − y‖² = Σ ‖L u − b‖² in as few rows as that takes.
Each Gauss–Newton step is a least squares under equalities, which are solved for, and inequalities,
by the dual, a problem of non-negative ones (Lawson and Hanson 1974, chapter 23). Waves that an
optimum leaves below the floor become cuts vᵗ D(k; p) v ≥ ζ s(k), linear in p.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import scipy.linalg
from numpy import ndarray
from numpy.linalg import norm, qr, svd
from scipy.optimize import nnls

from warp_peri.core.stencil import (
    Basis,
    Grid,
    bend,
    grid_of,
    laplacian,
    ratios,
    zone_sample,
    zoomed,
)
from warp_peri.errors import InputError
from warp_peri.points.arguments import Options, Pair
from warp_peri.points.points import Samples

STEPS = 500
SETTLED = 1e-12
"""Change of the merit, relative, that counts as none; two in turn end a search."""
NO_LOSS = 1e-20
"""Of data that are in equilibrium to the last digit: nothing is gained below it."""
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-14, 1e8
"""Of the first step, of later ones, and of the last that is tried: of a column of size one."""
FELT = 1e-6
"""Of the largest column: others have this size at least."""
SAID = 1e-9
"""Of an inequality: what the equalities leave of it below this is rounding."""
ELASTIC = 1e3
"""Weight of what a step misses conditions by that none meets, beside the residual."""
ROUNDED = 1e-11
"""Of conditions of size one, that is rounding: no step is judged by it."""
BENDS = 3
"""How often what bends among the conditions is taken off a step that would gain nothing."""
DEPENDENT = 1e-10
"""Relative size of an equality that others say already."""


@dataclass(frozen=True)
class Linearised:
    """Residual r, equalities e and inequalities m at θ [T], about one in size, with slopes."""

    residual: ndarray
    J: ndarray
    equal: ndarray
    A: ndarray
    margins: ndarray
    M: ndarray

    @property
    def loss(self) -> float:
        """Squared residual ‖r‖²."""
        return float(self.residual @ self.residual)

    @property
    def violated(self) -> float:
        """Sum of the violations of all conditions."""
        missed = np.append(np.abs(self.equal), -self.margins)
        return float(missed[missed > ROUNDED].sum())


def settle(state: Callable[[ndarray], Linearised], theta: ndarray) -> tuple[ndarray, Linearised]:
    """Find the optimum reached from θ by Gauss–Newton, and its state with any violation."""
    now, penalty, damping, settled = state(theta), 0.0, DAMPING, False

    def merit(of: Linearised) -> float:
        return of.loss + penalty * of.violated

    for _ in range(STEPS):
        move = _step(now, damping)
        ahead = now.residual + now.J @ move
        if now.violated > 0:  # what a step costs that meets the conditions (Han, 1977)
            costs = (ahead @ ahead - now.loss) / now.violated
            penalty = max(penalty, 2 * costs, now.loss)
        there = state(theta + move)
        for _ in range(BENDS):
            if merit(now) >= merit(there) or there.loss > merit(now):  # not for the conditions
                break
            margins = there.margins - now.M @ move
            bend = _step(replace(now, equal=there.equal - now.A @ move, margins=margins), damping)
            again = state(theta + bend)
            if not again.violated < there.violated / 2:
                break
            move, there = bend, again
        gain = merit(now) - merit(there)
        small = abs(gain) <= SETTLED * merit(now) + NO_LOSS
        if not gain >= 0:  # also of what is no number
            damping = max(10 * damping, LEAST_DAMPING)
            if small or damping > MOST_DAMPING:
                break
            continue
        theta, now = theta + move, there
        if small and settled:
            break
        settled, damping = small, max(damping / 10, LEAST_DAMPING)
    return theta, now


def _step(now: Linearised, damping: float) -> ndarray:
    """min ‖r + J d‖² + damping ‖d / size‖² with e + A d = 0 and m + M d ≥ 0, or near to them."""
    size = 1 / felt(norm(now.J, axis=0))
    J, A, M = now.J * size, now.A * size, now.M * size
    J = np.vstack([J, np.sqrt(damping) * np.eye(J.shape[1])])
    right = np.append(-now.residual, np.zeros(J.shape[1]))
    start, free = particular(A, -now.equal)
    free_M, least = M @ free, -now.margins - M @ start
    turns = norm(free_M, axis=1) > SAID * norm(M, axis=1)
    J, right, M, least = J @ free, right - J @ start, free_M[turns], least[turns]
    try:
        x = least_squares_above(J, right, M, least)
    except InputError:  # no step meets all: one number more, by how much they are missed
        J = np.pad(J, [(0, 1), (0, 1)])
        J[-1, -1] = ELASTIC * max(1.0, float(norm(right)))
        M = np.column_stack([M, np.ones(len(M))])
        x = least_squares_above(J, np.append(right, 0.0), M, least)[:-1]
    return np.asarray((start + free @ x) * size)


def felt(sizes: ndarray) -> ndarray:
    """Sizes of columns or curvatures, the small ones raised to FELT of the largest."""
    return np.asarray(np.maximum(sizes, FELT * sizes.max(initial=1e-300)))


def particular(A: ndarray, a: ndarray) -> Pair:
    """Least x with A x = a where one is, and a basis of the null space of A, as columns."""
    if not len(A):
        return np.zeros(A.shape[1]), np.eye(A.shape[1])
    U, size, V = svd(A)
    rank = (size > DEPENDENT * max(size.max(initial=0.0), 1e-300)).sum()
    return V[:rank].T @ ((U[:, :rank].T @ a) / size[:rank]), V[rank:].T


def least_squares_above(A: ndarray, y: ndarray, G: ndarray, h: ndarray) -> ndarray:
    """Minimise ‖A x − y‖ with G x ≥ h, A [M, K] of full column rank, G [C, K]. Raises InputError
    where no x obeys, or the rank of A is not full."""
    Q, R = qr(A)
    if not R.diagonal().all():
        raise InputError("A: expected full column rank")
    b = Q.T @ y
    if len(h):
        rows = scipy.linalg.solve_triangular(R, G.T, trans="T").T
        size = norms(rows)
        size[size == 0] = 1.0
        rows, gap = rows / size[:, None], (h - rows @ b) / size
        unit = np.abs(gap).max()
        if gap.max() > 0:
            dual = np.concatenate([rows.T, gap[None] / unit])
            wanted = np.eye(len(dual))[-1]
            left = dual @ nnls(dual, wanted, maxiter=100 * len(h))[0] - wanted
            if not np.abs(left[-1]) > 1e-14:
                raise InputError("G: no x has G x ≥ h")
            b = b - unit * left[:-1] / left[-1]
    return np.asarray(scipy.linalg.solve_triangular(R, b))


@dataclass(frozen=True)
class LatticeRows:
    """Least-squares rows of one lattice for the numbers p = C h² [stress] on a basis, and extras.

    Attributes:
        R, y: of the loss ‖R p − y‖², shape [n, P + E] and [n].
        bonds: the basis.
        group: of the nodes, which says how much of the zone is looked at.
    """

    R: ndarray
    y: ndarray
    bonds: Basis
    group: ndarray


@dataclass(frozen=True)
class Form:
    """A stencil on a block that must be positive, D(k; p) ≥ level s(k) [stress]; slopes by θ."""

    block: int
    p: ndarray
    slopes: ndarray
    level: float


@dataclass(frozen=True)
class Numbers:
    """Numbers, conditions and penalties of a law at one θ [T].

    Attributes:
        p, slopes: on each block, shape [P + E], and their derivatives, [P + E, T].
        forms: that must be positive.
        equal, A; margins, M: what must be zero, and not negative, of size one; their derivatives.
        beside, by: more residuals, and their derivatives.
    """

    p: Sequence[ndarray]
    slopes: Sequence[ndarray]
    forms: Sequence[Form]
    equal: ndarray
    A: ndarray
    margins: ndarray
    M: ndarray
    beside: ndarray = field(default_factory=lambda: np.zeros(0))
    by: ndarray | None = None


@dataclass(frozen=True)
class Settled:
    """An optimum of the regression.

    Attributes:
        theta: θ.
        p: on each block.
        loss: ‖R p − y‖ of all blocks, over the size.
        losses: its square after each round of cuts.
        margin: the smallest Λmin D/s less its level that was found over the zones, over the floor.
        missed: the most that an equality or a margin misses.
        cuts: active or not, that were needed.
    """

    theta: ndarray
    p: list[ndarray]
    loss: float
    losses: list[float]
    margin: float
    missed: float
    cuts: int

    @property
    def kept(self) -> bool:
        """Whether all conditions hold at the optimum."""
        return self.margin >= -MET and self.missed <= KEPT


ROUNDS, NEW_CUTS = 60, 12
"""Of cuts, and how many a form is given in each."""
INTERVALS, PATCH = {2: 120, 3: 16}, {2: 11, 3: 7}
"""Of the grid on the zone, and waves along an axis of the patches that are looked at closer."""
ZOOMS, FINER, APART = 3, 5.0, 2.5
"""Patches, each so much smaller than the last; and steps of the grid between their middles."""
MET, KEPT = 1e-7, 1e-6
"""Of the floor: a margin this little below zero is met; of size one: what may be missed."""


def fit(
    blocks: Sequence[LatticeRows],
    law: Callable[[ndarray], Numbers],
    theta: ndarray,
    floor: float,
    *,
    size: float | None = None,
    linear: bool = False,
    rounds: int = ROUNDS,
) -> Settled:
    """Find the optimum reached from θ, its conditions kept over the whole zones.

    Args:
        blocks: of each lattice; the sum of their losses is minimised.
        law: what θ stands for; `linear` where it is.
        floor: ζ [stress], the size of margins of forms.
        size: of the residual; ‖y‖ by default.
        rounds: most rounds of cuts.
    """
    problem = Regression(blocks, law, floor, size)
    losses, margin = [], -np.inf
    for _ in range(rounds):
        if not linear:
            theta = settle(problem.state, theta)[0]
        for _ in range(2 if linear else 0):  # what is linear takes one step, and digits a second
            theta = theta + _step(problem.state(theta), 0.0)
        numbers = law(theta)
        losses.append(float(np.sum(problem.left(numbers) ** 2)))
        margin = problem.look(numbers)
        if margin >= -MET:
            break
    return problem.found(theta, losses, margin)


class Regression:
    """Loss, conditions and cuts of a regression as functions of θ; see fit."""

    def __init__(
        self,
        blocks: Sequence[LatticeRows],
        law: Callable[[ndarray], Numbers],
        floor: float,
        size: float | None,
    ) -> None:
        self.blocks, self.law, self.floor = blocks, law, floor
        self.size = float(size or np.sqrt(sum(block.y @ block.y for block in blocks)) or 1.0)
        self.zones = [Zone(block.bonds, block.group) for block in blocks]
        self.cuts: list[tuple[int, ndarray]] = []

    def state(self, theta: ndarray) -> Linearised:
        """Residual and conditions at θ, waves as far as they are cuts."""
        at = self.law(theta)
        J = [block.R @ slopes / self.size for block, slopes in zip(self.blocks, at.slopes)]
        margins, M = [at.margins], [at.M]
        for number, G in self.cuts:
            form = at.forms[number]
            margins.append((G @ form.p - form.level) / self.floor)
            M.append(G @ form.slopes / self.floor)
        return Linearised(
            np.append(self.left(at), at.beside),
            np.concatenate(J if at.by is None else [*J, at.by]),
            at.equal,
            at.A,
            np.concatenate(margins),
            np.concatenate(M),
        )

    def left(self, at: Numbers) -> ndarray:
        """Residual of all blocks, over the size."""
        left = (block.R @ p - block.y for block, p in zip(self.blocks, at.p))
        return np.concatenate([*left]) / self.size

    def look(self, at: Numbers) -> float:
        """Smallest margin over the zones, over the floor; waves below zero become cuts."""
        smallest = np.inf
        for number, form in enumerate(at.forms):
            zone = self.zones[form.block]
            near = form.level + self.floor
            least, phase, vectors = zone.softest(form.p, form.level - MET * self.floor, near)
            smallest = min(smallest, (least - form.level) / self.floor)
            if len(phase):
                # rows G with G p = vᵗ D(k; p) v / s(k), shape [n, P]
                basis, wave = zone.bonds.basis, bend(phase, zone.bonds.steps)
                work = np.einsum("axij,ki,kj->kax", basis, vectors, vectors, optimize=True)
                G = np.einsum("kax,kx->ka", work, wave) / laplacian(phase)[:, None]
                self.cuts.append((number, G))
        return smallest

    def found(self, theta: ndarray, losses: list[float], margin: float) -> Settled:
        """The Settled result of a search that ended at θ."""
        at = self.law(theta)
        missed = float(np.append(np.abs(at.equal), -at.margins).max(initial=0.0))
        count = sum(len(G) for _, G in self.cuts)
        return Settled(theta, [*at.p], losses[-1] ** 0.5, losses, margin, missed, count)


class Zone:
    """Search for the softest waves of a lattice: a grid on the zone, then zooms into its minima."""

    def __init__(self, bonds: Basis, group: ndarray) -> None:
        d = bonds.dimension
        self.bonds, self.phase = bonds, zone_sample(group, d, INTERVALS[d])
        self.wave, self.step = bend(self.phase, bonds.steps), np.pi / INTERVALS[d]
        self.how: Options = {"side": PATCH[d], "zooms": ZOOMS, "finer": FINER}

    def softest(
        self, p: ndarray, below: float, near: float = np.inf
    ) -> tuple[float, ndarray, ndarray]:
        """Smallest Λmin D/s over the zone, and k h [n, d] and eigenvectors of minima below a level;
        except for the lowest wave of the grid only those below `near` are refined."""
        tensors = np.tensordot(p[: len(self.bonds.basis)], self.bonds.basis, 1)
        at, grid = partial(ratios, self.bonds.steps, tensors), self.phase
        starts = self._apart(value := at(grid, self.wave)[0])
        starts = [n for n in starts if n == starts[0] or value[n] < near]
        found, k = zoomed(lambda phase: at(phase)[0], grid[starts], self.step, **self.how)
        phase = k[found < below]
        return float(found.min()), phase, at(phase)[1]

    def _apart(self, value: ndarray) -> list[int]:
        """Lowest waves of the grid that are no neighbours of one another: narrow dips too."""
        found: list[int] = []
        for n in np.argsort(value):
            away = np.abs(self.phase[found] - self.phase[n]).max(axis=1, initial=0)
            if (away > APART * self.step).all():
                found.append(n)
                if len(found) == NEW_CUTS:
                    break
        return found


def check_alike(sets: Sequence[Samples]) -> None:
    """Raise InputError for sets in several units or dimensions."""
    named = {f"{' and '.join(each.units)} in {each.dimension} dimensions" for each in sets}
    if len(named) > 1:
        raise InputError(f"units: expected the same for all sets, got {', '.join(sorted(named))}")


def sample_weights(sets: Sequence[Samples], *, normalise: bool) -> list[ndarray]:
    """Weights f²/Σ f²‖b‖² of each sample's ‖L u − b‖², [S] of each set; f = 1, or 1/‖b‖ with
    `normalise`. InputError for no samples or loads; normalised, for any zero load."""
    if not sets:
        raise InputError("points: expected at least one training set, got none")
    check_alike(sets)
    factors, total = [], 0.0
    for points in sets:
        if len(points) == 0:
            raise InputError("the training set has no samples")
        load = load_sizes(points)
        if not load.any():
            raise InputError("the training set has no loads on its interior")
        if normalise and not load.all():
            raise InputError(f"sample {load.argmin()} has no load and cannot be normalised")
        factors.append(1 / load if normalise else np.ones(len(points)))
        total += ((factors[-1] * load) ** 2).sum()
    return [factor**2 / total for factor in factors]


BLOCK = 2**22
"""Numbers of a block of rows before it is compressed."""


def rows(
    samples: Samples,
    bonds: Basis,
    *,
    weight: ndarray | None = None,
    extra: ndarray | None = None,
    least: int | None = None,
) -> Pair:
    """Rows R [n, P + E] and y [n] for numbers p = C h² [stress] on a basis, then of extra columns.

    Args:
        samples: displacements and loads on lattice nodes, along whose axes the basis is.
        bonds: the family.
        weight: of each sample, shape [S].
        extra: forces of other numbers that a law is linear in, along the axes, [S, I, d, E].
        least: as of grid_of.

    Raises InputError as grid_of does, and for samples without loads.
    """
    R, y = np.zeros((0, 0)), np.zeros(0)
    for some, F, b in swept(samples, bonds, extra, least):
        if weight is not None:
            F *= weight[some, None, None, None]
            b *= weight[some, None, None]
        flat = F.reshape(-1, F.shape[-1])
        flat = np.concatenate([R, flat]) if len(R) else flat
        R, y = compressed(flat, np.append(y, b.ravel()))
    return R, y


def swept(
    samples: Samples, bonds: Basis, extra: ndarray | None = None, least: int | None = None
) -> Iterator[tuple[slice, ndarray, ndarray]]:
    """Iterate over blocks of samples: the slice, columns at the interior nodes [S, I, d, P + E] and
    loads, along the lattice's axes; arguments and errors as of rows."""
    nodes = grid_of(samples.points, bonds.steps, least=least)
    b = samples.loads[:, samples.interior] @ nodes.axes
    count = len(bonds.basis) + (0 if extra is None else extra.shape[-1])
    step = max(1, BLOCK // (count * b[0].size))
    for some in (slice(first, first + step) for first in range(0, len(b), step)):
        F = forces(samples.u[some], nodes, bonds)
        F /= samples.spacing**2
        yield some, F if extra is None else np.concatenate([F, extra[some]], axis=-1), b[some]


def forces(u: ndarray, nodes: Grid, bonds: Basis) -> ndarray:
    """Forces h² L u of every basis tensor at the interior nodes, along the axes, [S, I, d, P]."""
    planes, d = nodes.scatter(u).swapaxes(0, 1), nodes.dimension
    stride = np.cumprod((1, *nodes.wide[:0:-1]))[::-1]
    place = np.array(np.unravel_index(nodes.interior, nodes.shape)) + nodes.reach * nodes.periodic
    planes = np.ascontiguousarray(planes.reshape(d, len(u), -1).transpose(2, 0, 1))
    at = stride @ place
    F, inner = np.zeros((len(bonds.basis), len(at), d, len(u))), 2 * planes[at]
    for step, tensors in zip(stride @ bonds.steps.T, bonds.basis.swapaxes(0, 1)):
        pulled = inner - planes[at + step] - planes[at - step]
        for a, k, j in np.argwhere(tensors):
            F[a, :, k] += tensors[a, k, j] * pulled[:, j]
    return F.transpose(3, 1, 2, 0)


def over_loads(samples: Samples) -> ndarray:
    """Weights 1/‖b‖ of each sample, shape [S]; one without load is left out."""
    size = load_sizes(samples)
    return np.asarray(np.divide(1, size, out=0 * size, where=size > 0))


def load_sizes(samples: Samples) -> ndarray:
    """Norm ‖b‖ of each sample's interior load, shape [S]."""
    return norms(samples.loads[:, samples.interior])


def norms(fields: ndarray) -> ndarray:
    """Norm of each of S fields, shape [S, ...] to [S]."""
    return np.asarray(norm(fields.reshape(len(fields), -1), axis=1))


def relative(off: ndarray, whole: ndarray) -> float:
    """Norm of all numbers of one array over that of another."""
    return float(norm(off) / norm(whole))


def sizes(fields: ndarray, inside: ndarray) -> ndarray:
    """Norm of each of S fields on interior nodes; where all are, without the mean, for where a
    periodic body as a whole lies is nobody's answer."""
    held = fields[:, inside]
    return norms(held - inside.all() * held.mean(axis=1, keepdims=True))


def compressed(R: ndarray, y: ndarray) -> Pair:
    """Compress rows R, y to as few with the same least squares."""
    if len(R) <= R.shape[1] + 1:
        return R, y
    factor = scipy.linalg.qr(np.column_stack([R, y]), mode="r", overwrite_a=True)[0]
    factor = factor[: R.shape[1] + 1]
    return factor[:, :-1], factor[:, -1]


KNOWN = 0.1
"""Directions of which more than 1 − KNOWN of the data's squares is noise are left out."""


def without_noise(R: ndarray, y: ndarray, noise: ndarray) -> Pair:
    """Rows of ‖R p − y‖² less ‖N p‖², what noise in u adds to it, as a square again (theory,
    36–37).

    Loads carry no noise, so that the difference is a quadratic form of p that has the minimum of
    ‖√(1−ν) Vᵗ R p − (1−ν)^(−½) Uᵗ y‖² and a constant: no squares are subtracted. Directions of
    which less than KNOWN is not noise count nothing.
    """
    left, size, right = svd(R, full_matrices=False)
    kept = size > np.finfo(float).eps * R.shape[1] * size[0]
    left, size, right = left[:, kept], size[kept], right[kept]
    root, axes = svd((noise @ right.T) / size)[1:]
    share = np.pad(root**2, (0, len(axes) - len(root)))
    known = 1 - share > KNOWN
    gain = np.sqrt(1 - share[known])
    form = gain[:, None] * (axes[known] * size) @ right
    along = (axes @ (left.T @ y))[known] / gain
    rest = np.sqrt(max(0.0, y @ y - along @ along))  # a constant: no weight in the minimum
    return np.vstack([form, np.zeros(R.shape[1])]), np.append(along, rest)
