"""The LPS as a regression sees it: settings, rows of products, and coordinates θ.

With the stiffness v = μ w of each bond class and κ = (λ−μ)/μ², L u is linear in the products v and
κ v v (theory, 14–17, T17). θ = (κ, q) stands for a solid: q are numbers of the influence function,
of which K W of each class is made; α is one only in the plane, where the coefficients do not reach
every bond length already. All is analytic in θ: a step of i·10⁻³⁰ has the derivatives in its
imaginary part (W. Squire and G. Trapp 1998). θ and q may have axes in front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeAlias, cast

import numpy as np
from numpy import ndarray
from numpy.linalg import lstsq, svd

from warp_peri.core.elastic import lattice_group, symmetric_part
from warp_peri.core.stencil import Basis, half_ball, numbers_at
from warp_peri.errors import InputError, StrPath, hold
from warp_peri.fitting.regression import MET, Form, LatticeRows, Numbers, Settled, fit, norms, rows
from warp_peri.materials.influence import InfluenceFunction
from warp_peri.materials.lps import (
    LPSMaterial,
    LPSParameters,
    bernstein_basis,
    stiffnesses,
    weighted_volume,
)
from warp_peri.materials.lps_force import Bonds
from warp_peri.points.arguments import (
    LARGEST,
    Bound,
    Count,
    Natural,
    NotNegative,
    Positive,
    Seed,
    checked,
    typed,
)
from warp_peri.points.families import DEGREE, BondClasses, bond_classes
from warp_peri.points.points import WAVE_VECTOR, Samples

HORIZONS = (10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0)
"""Horizons δ that `sweep` tries [Å] (You et al. 2021, section 6.2)."""
DEGREES = (0, 5, 10, 15, 20)
"""Degrees M that `sweep` tries (You et al. 2021, section 6.2)."""
ISOTROPIC, LONG_WAVES = "isotropic", "long waves"
SMOOTHNESS = 1e-10
"""Weight of the second differences of D beside the relative residual. It costs an ordinary fit
nothing that can be seen, and keeps D from growing until its terms cancel to the last digit."""


@typed
@dataclass(frozen=True)
class Bernstein:
    """Influence function K(r) = r^(−α) Σ_k D_k B_k,M(r/δ) of any sign (theory, 4).

    Attributes:
        degree: M ≥ 0.

    Raises InputError for a degree that is none.

    >>> wp.fit(samples, wp.LPS(12.5, wp.Bernstein(2))).material.D.shape
    (3,)
    """

    degree: Annotated[int, Bound("a whole number from 0 to 1000", range(1001).__contains__)] = 10


Kernel: TypeAlias = "Bernstein | InfluenceFunction | Sequence[InfluenceFunction]"


@typed
@dataclass(frozen=True)
class StabilityConditions:
    """Stability conditions that a fit must keep on every lattice.

    Attributes:
        kind: "direct", D(k) ≥ ζ s(k); "paper" asks for (i) and (iii) of (4.6) besides.
        zeta: ζ [TPa]; None takes 0.0161 of the stiffness that the data of a fit show, which is
            0.0100 TPa on graphene.

    Raises InputError for another kind, or a ζ that is not above zero.
    """

    kind: Literal["direct", "paper"] = "direct"
    zeta: Positive | None = None

    def forms(self, kappa: Any, mu: Any, level: float) -> list[tuple[Any, float]]:
        """Coefficient κ of each stability condition's form Γ + κφφᵗ, and its level."""
        forms = [(kappa, level)]
        if self.kind == "paper":  # Σ w r² = 1
            forms += [(0 * kappa, level), (-2 / mu, 0.0)]
        return forms


@typed
@dataclass(frozen=True)
class GaussNewton:
    """Fit method: the constrained optimum of the loss (theory, 26–28), from plain kernels r^(−α).

    Attributes:
        moduli: (λ, μ) [TPa] to hold at long waves on every lattice (8 Σ w ξ₁²ξ₂²/r² = 1 makes them
            the moduli of the discrete operator); "isotropic" holds that condition and learns λ and
            μ; None learns them freely. "long waves" holds those that the long waves of the samples
            show (theory, 28a), where free ones are two standard errors away.
        rounds: most rounds of cutting planes.
        smoothness: weight η of the second differences of D beside the relative residual (28).

    Raises InputError for moduli that no solid has.
    """

    moduli: tuple[float, float] | str | None = LONG_WAVES
    rounds: Count = 40
    smoothness: NotNegative = SMOOTHNESS

    def __post_init__(self) -> None:
        named = isinstance(self.moduli, str)
        if self.moduli is None or (named and self.moduli in (ISOTROPIC, LONG_WAVES)):
            return
        try:
            lam, mu = checked("moduli", () if named else self.moduli, float, (2,)).tolist()
        except InputError:
            lam = mu = np.nan
        if not (0 < mu <= LARGEST and 0 < lam + mu <= LARGEST):
            raise InputError(
                f"moduli: expected (λ, μ) with μ > 0, λ + μ > 0, up to {LARGEST:g}, {ISOTROPIC!r} "
                f"or {LONG_WAVES!r}, got {self.moduli!r:.60}"
            )
        hold(self, moduli=(lam, mu))  # of a list or an array too

    @property
    def held(self) -> tuple[float, float] | str | None:
        """Moduli that a search holds by itself; those of long waves are found before it."""
        return None if self.moduli == LONG_WAVES else self.moduli


@typed
@dataclass(frozen=True)
class TwoStage:
    """Fit method: Algorithm 1 of You et al. (2021) as printed, Adam on positive kernels, then an
    augmented Lagrangian that holds the eigenvalues (4.6) of the training domain. Noise biases it:
    fields of noise in `fit` say how large their part is, and change nothing.

    Attributes:
        seed: of the initial constants and D.
        checkpoint: file that stage 2 keeps its state in and goes on from.
        epochs: most epochs of stage 1; the paper's loss stagnates between 1000 and 2000.
        inner_epochs: most epochs of each round of stage 2.
        outer_iterations: most rounds of stage 2; the paper has a hundred.

    Raises InputError for a number that is none.
    """

    seed: Seed = 0
    checkpoint: StrPath | None = None
    epochs: Natural = 4000
    inner_epochs: Natural = 500
    outer_iterations: Natural = 20


@typed
@dataclass(frozen=True)
class AugmentedLagrangian:
    """Fit method: Adam and an augmented Lagrangian to the optimum, which GaussNewton then checks.

    Unlike Algorithm 1 in coordinates that suit its steps (theory, 28b), so that it arrives.

    Attributes:
        seed: of the initial D.
        steps: of Adam in a round.
        rounds: most rounds.
        optimum: settings of the check, which goes on from there and from plain kernels.

    Raises InputError for a number that is none.
    """

    seed: Seed = 0
    steps: Count = 100
    rounds: Count = 60
    optimum: GaussNewton = field(default_factory=GaussNewton)


Method: TypeAlias = TwoStage | GaussNewton | AugmentedLagrangian
METHODS = {"optimum": GaussNewton, "two-stage": TwoStage, "constrained": AugmentedLagrangian}
"""Fit methods by their names in a shell."""


def products(model: LPSMaterial, classes: BondClasses) -> ndarray:
    """The products v, and κ v v of the pairs of classes, of a model on a lattice; shape [P]."""
    v, kappa = stiffnesses(model, classes)
    i, j = np.triu_indices(len(v))
    return np.concatenate([v, kappa * v[i] * v[j]])


def product_basis(classes: BondClasses) -> Basis:
    """Basis of the products of bond classes: their C h² on bonds of range 2δ (T17)."""
    d, count, x = classes.steps.shape[1], len(classes.r), classes.steps
    h, of = classes.spacing, classes.bond_class
    steps = half_ball(2 * classes.horizon / h, d)
    far = 2 * np.abs(x).max()
    steps = steps[np.abs(steps).max(axis=1) <= far]
    place = numbers_at((2 * far + 1,) * d, (*(steps + far).T,))
    i, j = np.triu_indices(count)
    column = np.zeros((count, count), int)
    column[i, j] = column[j, i] = count + np.arange(len(i))
    tensors = np.zeros((count + len(i), len(steps), d, d))
    alone = place[*(x + far).T]
    own = alone >= 0
    along = x[:, :, None] * x[:, None] / (x**2).sum(axis=1)[:, None, None]
    tensors[of[own], alone[own]] = 2 * d * (d + 2) * h**2 * along[own]
    first, second = np.indices((len(x), len(x))).reshape(2, -1)
    at = place[*(x[first] + x[second] + far).T]
    first, second, at = first[at >= 0], second[at >= 0], at[at >= 0]
    across = d**2 * h**4 * x[first][:, :, None] * x[second][:, None]
    np.add.at(tensors, (column[of[first], of[second]], at), symmetric_part(across))
    used = tensors.any(axis=(0, 2, 3))
    return Basis(steps[used], tensors[:, used])


def squares(
    blocks: Sequence[LatticeRows], lattices: Sequence[BondClasses], model: LPSMaterial
) -> float:
    """Sum of squares Σ ‖R p − y‖² of all lattices' rows at a model."""
    left = [one.R @ products(model, classes) - one.y for one, classes in zip(blocks, lattices)]
    return float(sum(np.sum(one**2) for one in left))


class Products:
    """Linear operators of the products v and κ v v, applied to samples on a lattice."""

    def __init__(
        self, samples: Samples, horizon: float, *, quadrature_degree: int = DEGREE
    ) -> None:
        d, h = samples.dimension, samples.spacing
        self.samples, self.least = samples, 2 * int(horizon / h + 1e-6)
        self.warp = Bonds(samples, horizon, quadrature_degree=quadrature_degree)
        self.u = samples.u.copy()  # torch takes no array that is read-only
        self.b = samples.loads[:, samples.interior]
        self.classes = bond_classes(h, horizon, dimension=d, degree=quadrature_degree)
        self.bonds = product_basis(self.classes)

    def left(self, *numbers: Any) -> ndarray:
        """Residual ‖L u − b‖ of each sample by Warp's operator at λ, μ, α and D, shape [S]."""
        force = self.warp.law(*numbers).force(self.u.reshape(len(self.b), -1))[0]
        return norms(force - self.b.reshape(force.shape))

    def rows(self, weight: ndarray, samples: Samples | None = None) -> LatticeRows:
        """Rows of Σ_s weight_s ‖L u − b‖², weight [S], for its samples or others on the nodes."""
        given = self.samples if samples is None else samples
        R, y = rows(given, self.bonds, weight=np.sqrt(weight), least=self.least)
        return LatticeRows(R, y, self.bonds, lattice_group(self.bonds.dimension))


@dataclass(frozen=True)
class LPSFound:
    """An LPS during or after a search.

    Attributes:
        solid: λ, μ, α, D.
        shape: the influence function that D stands for, if its parameters are what is learned.
        losses: on the way there, relative to the loads.
        margin: smallest margin of the conditions over the searched zones [stress].
        departure: farthest that a modulus is from what was to be held [stress].
        cuts: number of wave vectors the conditions were kept on.
        converged: whether no violation was left, and the moduli are those to be held.
    """

    solid: LPSParameters
    shape: InfluenceFunction | None = None
    losses: list[float] = field(default_factory=list, repr=False)
    margin: float = np.inf
    departure: float = 0.0
    cuts: int = 0
    converged: bool = True

    @property
    def loss(self) -> float:
        """Final loss of the search relative to the loads."""
        return self.losses[-1]


HEADROOM = 1.01
"""A fit asks for ζ times this, so that ζ itself holds between the points it sampled."""
MODULI_TOLERANCE = 1e-4
"""Distance from moduli to be held, over ζ, that counts as none."""
RANK_TOLERANCE = 1e-11
LARGEST_ALPHA, SMALLEST_ALPHA = 3 - 1e-3, -6.0
ALPHA_IN_SIGHT = (-12.0, 6.0)
STEP = 1e-30
"""Of derivatives; its square is nothing beside one."""


class BernsteinKernel:
    """Kernel r^(−α) Σ D_k B_k,M of any D in coordinates q: of the tables, then α where it is free
    (not `fixed`). The first lattice's bond classes set the scale."""

    def __init__(
        self, lattices: Sequence[BondClasses], alpha: float, degree: int, *, fixed: bool = False
    ) -> None:
        self.alpha = alpha
        scaled = [(classes.r / classes.horizon, classes) for classes in lattices]
        tables = np.concatenate(
            [(c.weight * t**-alpha)[:, None] * bernstein_basis(t, 1.0, degree) for t, c in scaled]
        )
        scale = np.abs(tables).max()
        left, size, right = svd(tables / scale)
        self.rank = rank = int(np.sum(size > RANK_TOLERANCE * size[0]))
        lengths = np.concatenate([classes.r for classes in lattices])
        reached = np.abs(tables).max(axis=1) > RANK_TOLERANCE * scale
        short = rank < len(np.unique((lengths[reached] / lattices[0].horizon).round(9)))
        self.free_alpha = short and lattices[0].steps.shape[1] == 2 and not fixed
        ends = np.cumsum([len(classes.r) for classes in lattices])
        self._basis = np.split(left[:, :rank], ends[:-1])  # tables of unit q
        self._q_of_D = size[:rank, None] * right[:rank] * scale
        self.D_of_q = right[:rank].T / (size[:rank] * scale)
        self._second = np.diff(np.eye(degree + 1), n=2, axis=0)
        free = right[rank:].T  # coefficients that no bond sees: take those that smooth
        if free.size and len(self._second):
            smooth = lstsq(self._second @ free, self._second @ self.D_of_q)
            self.D_of_q = self.D_of_q - free @ smooth[0]
        self._log_r = [np.log(t) for t, _ in scaled]
        first = lattices[0]
        self._plain = first.count * first.r**2 * first.weight

    def start(self, found: LPSFound) -> ndarray:
        """Coordinates q of given coefficients, of any scale."""
        return np.append(self._q_of_D @ found.solid.D, [self.alpha] * self.free_alpha)

    def tables(self, q: ndarray) -> list[ndarray]:
        """K W of the kernel on each lattice, shape [..., C]."""
        alpha = q[..., -1:] if self.free_alpha else self.alpha
        # Constraints bound α; on its way a search may look where r^(−α) overflows.
        alpha = alpha - alpha.real + np.clip(alpha.real, *ALPHA_IN_SIGHT)
        return [
            np.exp((self.alpha - alpha) * log_r) * (q[..., : self.rank] @ basis.T)
            for basis, log_r in zip(self._basis, self._log_r)
        ]

    def limits(self, q: ndarray) -> ndarray:
        """Constraints ≥ 0 that keep α within its bounds."""
        alpha = q[..., len(q.T) - self.free_alpha :]
        return np.concatenate([LARGEST_ALPHA - alpha, alpha - SMALLEST_ALPHA], axis=-1)

    def _volume(self, alpha: float) -> float:
        """Weighted volume Σ n r² K W of K = (r/δ)^(−α) on the first lattice."""
        return float(self._plain @ np.exp(-alpha * self._log_r[0]))

    def rough(self, q: ndarray, mu: ndarray) -> ndarray:
        """Second differences of D, scaled to a kernel of plain volume."""
        bends = q[..., : self.rank] @ (self._second @ self.D_of_q).T
        return np.asarray(self._volume(self.alpha) * bends / mu)

    def coefficients(self, q: ndarray, mu: float) -> tuple[ndarray, float, None]:
        """D, the smoothest with the weighted volume of K = r^(−α), and α."""
        alpha = float(q[-1]) if self.free_alpha else self.alpha
        return self.D_of_q @ q[: self.rank] * (self._volume(alpha) / mu), alpha, None


class ShapeKernel:
    """Kernel given by a function of the bond length, K W a (theory, 59): q = (a, parameters), over
    the sizes at which K feels them at the start, in any units. InputError where its weighted volume
    is zero at the start; a search may pass through."""

    rank = 1
    """How many numbers of q K is linear in."""

    def __init__(self, lattices: Sequence[BondClasses], shape: InfluenceFunction) -> None:
        self.lattices, self.shape = lattices, shape
        r = np.concatenate([each.r for each in lattices])
        felt, size = np.abs(shape.slopes(r)).max(axis=0), np.abs(shape.vector)
        size[size == 0] = 1.0  # of one that is not felt
        self._size = np.divide(np.abs(shape(r)).max(), felt, out=size, where=felt > 0)
        self._ends, self._first = np.array(shape.ends) / self._size, shape.vector / self._size
        width = self._ends[1] - self._ends[0]
        self._room = np.where(np.isfinite(width), width, 1.0)
        for classes in lattices:
            name = f"influence '{shape.name}' with {dict(shape.parameters)}"
            weighted_volume(classes, classes.weight * shape(classes.r), name)
        self._scale = max(np.abs(each.weight * shape(each.r)).max() for each in lattices)

    def start(self, found: LPSFound) -> ndarray:
        """Coordinates q of the shape at the scale of a solid."""
        return np.append(1.0, self._first)

    def _at(self, q: ndarray) -> InfluenceFunction:
        return self.shape.at(self._size * np.clip(q[1:].real, *self._ends))

    def tables(self, q: ndarray) -> list[ndarray]:
        """K W on each lattice, [..., C], for q that differ in their imaginary parts alone."""
        shape, ahead = self._at(q.reshape(-1, q.shape[-1])[0]), (q - q.real)[..., 1:]
        return [
            q[..., :1]
            * (classes.weight / self._scale)
            * (shape(classes.r) + (self._size * ahead) @ shape.slopes(classes.r).T)
            for classes in self.lattices
        ]

    def limits(self, q: ndarray) -> ndarray:
        """Distances of the parameters from their bounds, as shares of the range."""
        apart = np.concatenate([q[..., 1:] - self._ends[0], self._ends[1] - q[..., 1:]], axis=-1)
        bounded = np.isfinite(np.concatenate(self._ends))
        return np.asarray(apart[..., bounded] / np.tile(self._room, 2)[bounded])

    def rough(self, q: ndarray, mu: ndarray) -> ndarray:
        """Distances of the parameters from their start, to hold those that hardly matter."""
        return np.asarray(q[..., 1:] - self._first)

    def coefficients(self, q: ndarray, mu: float) -> tuple[ndarray, float, InfluenceFunction]:
        """D and α of the polynomial that stands for the shape, and the shape."""
        shape, lengths = self._at(q), np.concatenate([classes.r for classes in self.lattices])
        return shape.coefficients(lengths, self.lattices[0].horizon)[0], 0.0, shape


class LPSLaw:
    """Map of θ = (κ, q) to the products on each lattice; arguments as of `optimum`."""

    def __init__(
        self,
        lattices: Sequence[BondClasses],
        start: LPSFound,
        conditions: StabilityConditions,
        method: GaussNewton,
        *,
        fixed_alpha: bool = False,
    ) -> None:
        self.kernel: BernsteinKernel | ShapeKernel
        if start.shape is not None:
            self.kernel = ShapeKernel(lattices, start.shape)
        else:
            solid, fixed = start.solid, fixed_alpha
            self.kernel = BernsteinKernel(lattices, solid.alpha, len(solid.D) - 1, fixed=fixed)
        self.conditions, self.zeta = conditions, HEADROOM * cast(float, conditions.zeta)
        self.unit, self.size = start.solid.mu, start.solid.mu / lattices[0].horizon ** 2
        self.moduli, self.smoothness = method.held, method.smoothness
        self._sigma = [(classes.count * classes.r**2)[:, None] for classes in lattices]
        self._pairs = [np.triu_indices(len(classes.r)) for classes in lattices]
        self._shears = []  # C44 of unit v of each class, (22)
        for each in lattices:
            x, d = each.xi.T, each.xi.shape[1]
            fourth = d * (d + 2) * (x[0] * x[1]) ** 2 / (x**2).sum(axis=0)
            self._shears.append(np.bincount(each.bond_class, fourth)[:, None])

    def start(self, found: LPSFound) -> ndarray:
        """Coordinates θ of a solid, its moduli raised where μ is below the floor ζ."""
        lam, mu, q = found.solid.lam, found.solid.mu, self.kernel.start(found)
        if mu < self.zeta:
            lam, mu = 0.0, 2 * self.zeta
        q[: self.kernel.rank] *= mu / (self.size * self.kernel.tables(q)[0] @ self._sigma[0])
        return np.append(self.unit * (lam - mu) / mu**2, q)

    def stiffnesses(self, theta: ndarray) -> tuple[list[ndarray], ndarray]:
        """v on each lattice, [..., C], and the common μ = Σ n r² v, [..., 1]."""
        sigma, (first, *others) = self._sigma, self.kernel.tables(theta[..., 1:])
        mu = self.size * first @ sigma[0]
        scaled = (v * (mu / (v @ one)) for v, one in zip(others, sigma[1:]))
        return [self.size * first, *scaled], mu

    def values(self, theta: ndarray) -> list[ndarray]:
        """Equalities and inequalities at θ in parts of ζ; penalties; and the products (v, κ v⊗v) of
        each form, L itself first, on each lattice; [..., ·]."""
        (v, mu), kappa, zeta = self.stiffnesses(theta), theta[..., :1] / self.unit, self.zeta
        limits = self.kernel.limits(theta[..., 1:])
        margins = [mu - zeta, 2 * mu + kappa * mu**2 - zeta, limits]  # of μ and λ + μ
        held = [theta[..., :0]]
        if isinstance(self.moduli, tuple):
            lam, shear = self.moduli
            held += [mu - shear, kappa * shear**2 - (lam - shear)]
        if self.moduli is not None:  # C44 = μ on every lattice
            held += [one @ shear - mu for one, shear in zip(v, self._shears)]
        return [
            np.concatenate(held, axis=-1) / zeta,
            np.concatenate(margins, axis=-1) / zeta,
            self.smoothness * self.kernel.rough(theta[..., 1:], mu / self.size),
            *(
                np.concatenate([one, own * one[..., i] * one[..., j]], axis=-1)
                for own, _ in self.conditions.forms(kappa, mu, zeta)
                for one, (i, j) in zip(v, self._pairs)
            ),
        ]

    def __call__(self, theta: ndarray) -> Numbers:
        ahead = self.values(theta + 1j * STEP * np.eye(len(theta)))
        made = [(one[0].real, one.imag.T / STEP) for one in ahead]
        (equal, A), (margins, M), (beside, by), *products = made
        count = len(self._pairs)
        levels = [level for _, level in self.conditions.forms(0.0, 1.0, self.zeta)]
        forms = [Form(n % count, *one, levels[n // count]) for n, one in enumerate(products)]
        p, slopes = zip(*products[:count])
        return Numbers(p, slopes, forms, equal, A, margins, M, beside, by)

    def found(self, of: Settled, met: float = MET) -> LPSFound:
        """Turn a search's result into an LPSFound; a margin may miss by `met` of ζ."""
        mu = float(self.stiffnesses(of.theta)[1][0])
        D, alpha, shape = self.kernel.coefficients(of.theta[1:], mu / self.size)
        departure = float(np.abs(self.values(of.theta)[0]).max(initial=0.0))
        return LPSFound(
            LPSParameters(mu + of.theta[0] / self.unit * mu**2, mu, alpha, D),
            shape,
            of.losses,
            margin=self.zeta * of.margin,
            departure=self.zeta * departure,
            cuts=of.cuts,
            converged=of.margin >= -met and departure <= MODULI_TOLERANCE,
        )


def optimum(
    blocks: Sequence[LatticeRows],
    lattices: Sequence[BondClasses],
    start: LPSFound,
    conditions: StabilityConditions,
    method: GaussNewton = GaussNewton(),
    *,
    fixed_alpha: bool = False,
) -> LPSFound:
    """Minimise the losses from one start under conditions on the whole zones (theory, 26–28)."""
    law = LPSLaw(lattices, start, conditions, method, fixed_alpha=fixed_alpha)
    return law.found(fit(blocks, law, law.start(start), law.zeta, size=1.0, rounds=method.rounds))


def has_answers(sets: Sequence[Samples]) -> bool:
    """Whether each set tells a displacement alone: it has waves, or a collar that holds it."""
    return all(WAVE_VECTOR in one.arrays or not one.interior.all() for one in sets)
