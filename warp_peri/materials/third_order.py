"""Third-order elasticity of sheets: material, operator, uniqueness and fit (theory, N).

For sheets whose long waves are isotropic: crystals with three- or sixfold axes, as graphene. The
linear part is a crystal (or crystal_from_lps(model, spacing)). With stresses of gradients projected
to |H| ≤ ε, u ← u + L⁻¹ (b − L u) contracts in the energy norm of the linear part by C(ε) κ_in
κ_out: C bounds Ψ″ on the ball, κ_p² the ratio of |h_p(k)|² to Λmin D(k).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import lstsq
from numpy.typing import ArrayLike
from scipy.optimize import root
from scipy.special import j0

from warp_peri.core.elastic import plane_isotropic
from warp_peri.core.pointwise import Pointwise
from warp_peri.core.proof import SAME_SPACING, check_spacing, largest, stencil_of
from warp_peri.core.record import Length, OnLinear, Stress, made_once
from warp_peri.core.stencil import Stencil
from warp_peri.errors import InputError, Rows, Values, hold, warn
from warp_peri.fitting.long_waves import long_wave_moduli, long_wave_rows, moduli_of
from warp_peri.fitting.regression import Settled, load_sizes, norms, relative, rows, swept
from warp_peri.fitting.result import Fit
from warp_peri.materials.certificate import Uniqueness, curvature_bound, prove_uniqueness
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.crystal_fit import Crystal, Tensors, one_set, transfer_to_lattice
from warp_peri.points import arguments
from warp_peri.points.arguments import ArrayMap, NotNegative, Numbers, Pair, Positive, typed
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import BondClasses, bond_classes, families_of
from warp_peri.points.points import PointsLike, Samples, axis_of, nodes_of
from warp_peri.protocols import renumbered
from warp_peri.solvers.equilibria import SOLVES, equilibria_of
from warp_peri.solvers.linear import Inverse
from warp_peri.solvers.solution import Solution, Solver

FORMS = ("filtered", "energy")
CUBIC = ("t3", "tq2", "q3")
ISOTROPIC = 1e-6
"""Relative, by which moduli of long waves may miss C11 = C12 + 2 C44."""
GRID = 41
"""Wave vectors along each axis of the square that weights are fitted on."""
HELD = 1e4
"""Weight of Σ n r² p = 1 beside relative errors of the symbol."""
CORE = 3.3
"""Components of wave vectors times R up to which smoothing leaves enough to fit an exact answer."""
SIZE = 1e-6
"""Weight of the size of p beside relative errors."""
SAME = 1e-5
"""Relative, by which figures may state more than a proof anew."""
SETTLED = 1e-9
"""Relative, of moduli that are found."""


@typed
@dataclass(frozen=True)
class Smoothing:
    """Cone filter by which the data were smoothed, and its regularised inverse.

    Attributes:
        radius: R > 0 of the cone max(0, R − r), in the data's unit of length.
        ridge: ρ ≥ 0 of the Wiener inverse (1 + ρ) ω̂/(ω̂² + ρ); 0 is the exact inverse 1/ω̂, which
            amplifies short waves. A smaller one is closer to the data and proves less.
    """

    radius: Length
    ridge: NotNegative = 0.1

    def transform(self, k: ndarray) -> ndarray:
        """Transform ω̂(|k|) of the cone of unit integral, at wave numbers k [1/Å]."""
        node, weight = np.polynomial.legendre.leggauss(200)
        r = (node + 1) * self.radius / 2
        part = weight * (self.radius - r) * r
        return np.asarray(j0(np.multiply.outer(arguments.checked("k", k), r)) @ part / part.sum())

    def inverse(self, k: ndarray) -> ndarray:
        """Wiener inverse (1 + ρ) ω̂/(ω̂² + ρ) at wave numbers k [1/Å]."""
        smooth = self.transform(k)
        return (1 + self.ridge) * smooth / (smooth**2 + self.ridge)

    def root(self, k: ndarray) -> ndarray:
        """√((1 + ρ) ω̂²/(ω̂² + ρ)), the root of inverse times transform (N23)."""
        square = self.transform(k) ** 2
        return np.sqrt((1 + self.ridge) * square / (square + self.ridge))

    def weights(self, classes: BondClasses, form: str = "filtered") -> Pair:
        """Weights p_in and p_out of the bond classes of a lattice [1/length²], each of shape [C].
        Of the energy form both fit the root (N23) over all waves that the lattice has, |k_a| ≤ π/h.
        Of the filtered one (N6) they fit the Wiener inverse there, the exact inverse and the
        transform over |k_a| ≤ CORE / R."""
        zone = np.pi / classes.spacing
        if form == "energy":
            return 2 * (fitted_weights(classes, self.root, zone),)
        core = min(zone, CORE / self.radius)
        inward = fitted_weights(classes, self.inverse, zone if self.ridge > 0 else core)
        return inward, fitted_weights(classes, self.transform, core)


def fitted_weights(classes: BondClasses, factor: ArrayMap, reach: float) -> ndarray:
    """Fit weights p [1/Å²], Σ n r² p = 1, whose symbol 2 Σ p sin(k·ξ) ξ is near k factor(|k|) over
    the square |k_a| ≤ reach [1/Å]. Errors count as those of the gradient under a unit load, which
    displaces by 1/|k|², wave numbers alike: |k|^(−5/2) has the least residual on held-out loads."""
    sigma = classes.count * classes.r**2
    member = np.eye(len(classes.r))[classes.bond_class]
    line = np.linspace(-reach, reach, GRID)
    k = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    number = np.hypot(*k.T)
    some = number > 1e-6 * reach
    k, number = k[some], number[some]
    slope = 2 * np.sin(k @ classes.xi.T)
    symbol = np.stack([slope @ (x[:, None] * member) for x in classes.xi.T], axis=1)
    weight = number**-2.5
    weight /= np.sqrt((weight**2 * number**2).mean())
    rows = [
        (symbol * weight[:, None, None]).reshape(-1, len(sigma)),
        HELD * sigma[None],
        SIZE * 2 * len(k) * np.diag(sigma),
    ]
    right = [(k * (weight * factor(number))[:, None]).ravel(), [HELD], np.zeros(len(sigma))]
    p = lstsq(np.concatenate(rows), np.concatenate(right))[0]
    return np.asarray(p / (sigma @ p))


def energy_density(
    E: torch.Tensor, *, axis: float, lam: Any, mu: Any, t3: Any, tq2: Any, q3: Any
) -> Any:
    """Energy density (N3) [stress] of Green strains E [..., 2, 2], of a crystal at `axis` [rad]."""
    x, y, shear = E[..., 0, 0], E[..., 1, 1], (E[..., 0, 1] + E[..., 1, 0]) / 2
    c, s, t, half = np.cos(2 * axis), np.sin(2 * axis), x + y, (x - y) / 2
    a, b = c * half + s * shear, c * shear - s * half
    A, B = a * a, b * b
    return t * t * ((lam + mu) / 2 + t3 * t) + (A + B) * (2 * mu + tq2 * t) + q3 * a * (A - 3 * B)


def lame_of(C: ndarray) -> ndarray:
    """λ and μ of the long waves of elastic tensors [..., 2, 2, 2, 2], shape [..., 2]."""
    return np.stack([C[..., 0, 0, 1, 1], C[..., 0, 1, 0, 1]], axis=-1)


def gradient_stencil(points: PointsLike, reach: float, p: ndarray) -> Pair:
    """Steps [B, 2] and weights 2 p ξ [1, B, 2] of the gradient H (N1), in the points' axes."""
    classes, axes = bond_classes(points.spacing, reach), points.lattice.axes
    return classes.steps, 2 * p[classes.bond_class, None] * (classes.xi @ axes.T)[None]


@dataclass(frozen=True, eq=False)
class ThirdOrderMaterial(OnLinear, format="warp_peri.third_order_crystal"):
    """A crystal with a third-order energy Ψ of the displacement gradient (N1–N6, N22).

    Attributes:
        linear: the tangent at zero; the λ and μ of its long waves are those of Ψ.
        t3, tq2, q3: third-order elastic constants [stress], q3 in the frame of the crystal, whose
            zigzag direction the points state (Points.axis).
        smoothing: of the data, where the weights of the gradient undo it.
        form: "filtered", or "energy", whose tangent is symmetric.
        reach: horizon of the gradient [length].
        proven: figures of Uniqueness on the spacing of the crystal.
        provenance: of the data and the fit; plain JSON values.

    Raises InputError for a crystal in space, and moduli of long waves that are not isotropic.
    """

    linear: CrystalMaterial
    t3: Stress
    tq2: Stress
    q3: Stress
    smoothing: Smoothing
    form: str
    reach: Length
    proven: Values = field(default_factory=dict)
    provenance: Values = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if "statement" in self.proven:  # of its numbers, whatever a file says
            strain: Any = self.proven.get("strain")
            known = strain if arguments.is_number(strain) else 0.0
            said = Uniqueness(self.spacing, known, 0, 0, 0, (), self.units).statement
            hold(self, proven=self.proven | {"statement": said})
        if self.form not in FORMS:
            raise InputError(f"form: expected one of {', '.join(FORMS)}, got {self.form!r:.50}")
        if self.linear.dimension != 2:
            raise InputError("linear: third-order constants are for sheets, got a model in space")
        lam, mu = self.lame
        miss = np.abs(self.linear.elastic_tensor() - plane_isotropic(lam, mu)).max()
        if miss > ISOTROPIC * abs(mu):
            raise InputError(
                f"linear: third-order constants are for isotropic long waves, got C11, C22, C16 or "
                f"C26 off by {miss / mu:.1e} of the shear modulus; symmetry='isotropic' has them"
            )

    @property
    def spacing(self) -> float:
        """Lattice spacing of the nodes."""
        return self.linear.spacing

    @property
    def horizon(self) -> float:
        """Length of the longest bond of the tensors or the gradient."""
        return max(self.linear.horizon, self.reach)

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé parameters λ and μ of long waves [stress]."""
        lam, mu = lame_of(self.linear.tensor())
        return lam, mu

    @property
    def numbers(self) -> ndarray:
        """Constants λ, μ, t3, tq2 and q3 [stress], shape [5]."""
        return np.array([*self.lame, self.t3, self.tq2, self.q3])

    def weights(self, classes: BondClasses) -> Pair:
        """Gradient weights p_in and p_out of a lattice's bond classes [1/length²], each [C]."""
        return self.smoothing.weights(classes, self.form)

    def on(
        self, points: PointsLike, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> PlacedThirdOrder:
        """Build the operator on a lattice, for its spacing: tensors transferred, proven anew.

        Args:
            points: a lattice with a collar as wide as the linear part needs and twice the
                gradient's horizon; their axis is that of the crystal, x where none is stated.
            transfer: False refuses lattices that the material itself is not certified on.
            allow_uncertified: take tensors that hold no certificate, with a warning.

        Raises InputError for other units or another axis, nodes without the collar, scattered
        points, and tensors without a certificate.
        """
        nodes, here = self.own_nodes(points), self
        if not nodes.spacing > 0:
            raise InputError("points: a third-order crystal is for lattices, got scattered points")
        if not transfer:
            check_spacing(self.spacing, nodes.spacing, "transfer=False, and the points have")
        if abs(nodes.spacing / self.spacing - 1) > SAME_SPACING:
            here = made_once(_transferred, self, nodes.spacing)
        if not here.linear.statement:
            said = "the crystal model has no certificate on this lattice"
            if not allow_uncertified:
                raise InputError(f"certificate: {said}; allow_uncertified=True takes them")
            warn(f"certificate: {said}")
        made = PlacedThirdOrder(here, nodes)
        here.linear.fitting(nodes)  # checks the axis
        return made

    def proven_strain(self, spacing: Positive) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        here = abs(spacing / self.spacing - 1) <= SAME_SPACING
        known = float(self.proven.get("strain", 0.0)) if here else 0.0
        return known if known and self.stands else 0.0

    def certified(self) -> ThirdOrderMaterial:
        """The material with its guarantee of uniqueness, where its tensors are certified (N14)."""
        if not self.linear.statement:
            return self
        return replace(self, proven=prove_uniqueness(self, spacing=self.spacing).figures())

    def verify_certificates(self) -> None:
        """Raise InputError unless the figures that a file states are proven again."""
        known = prove_uniqueness(self, spacing=self.spacing).figures() if self.proven else {}
        if unknown := self.proven.keys() - known.keys():
            raise InputError(f"proven: unknown keys: {', '.join(unknown)}")
        said = {
            name: arguments.checked(f"proven: {name}", value, shape=np.shape(known[name]))
            for name, value in self.proven.items()
            if name != "statement"
        }
        if "strain" in said:  # which may be less than is proven now
            known["curvature"] = curvature_bound(known["largest_parts"], float(said["strain"]))
        for name, value in said.items():
            high = value <= (1 + SAME) * np.array(known[name])
            low = known[name] <= (1 + SAME) * value
            held = high if name == "strain" else low & high if name == "spacing" else low
            if not (held & (value >= 0)).all():
                raise InputError(f"proven: {name} {value!r:.60} is not proven of these")

    def elsewhere(self, length: float, stress: float) -> Values:
        """Proof in other units: the proven strain alone, which has no unit."""
        return {"proven": {k: v for k, v in self.proven.items() if k == "strain"}}

    def rows(self) -> Rows:
        """Name and value of each line of the material's table, those of the crystal last."""
        shown = arguments.shown_moduli(self.units, (getattr(self, name) for name in CUBIC))
        rows = [("form", self.form), (", ".join(CUBIC), shown)]
        if strain := self.proven_strain(self.spacing):
            rows.append(("proven", f"one solution up to |H| = {strain:.2%}"))
        return rows + self.linear.rows()


def _transferred(law: ThirdOrderMaterial, spacing: float) -> ThirdOrderMaterial:
    return replace(law, linear=transfer_to_lattice(law.linear, spacing), proven={}).certified()


class PlacedThirdOrder(Pointwise):
    """Operator of a third-order solid on a lattice of its spacing; see Pointwise."""

    def __init__(self, model: ThirdOrderMaterial, points: PointsLike) -> None:
        self.model, nodes = model, nodes_of(points)
        axis = axis_of(nodes) if model.q3 or nodes.axis is not None else 0.0
        p_in, p_out = model.weights(bond_classes(model.spacing, model.reach))
        steps, weights = gradient_stencil(nodes, model.reach, p_in)
        back = None if p_in is p_out else gradient_stencil(nodes, model.reach, p_out)[1]
        lam, mu = model.lame
        density = partial(energy_density, lam=lam, mu=mu, axis=axis)
        numbers = {name: getattr(model, name) for name in CUBIC}
        parts: Any = {"back": back, "stencil": model.linear.stencil, "numbers": numbers}
        super().__init__(nodes, model.horizon, density, steps, weights, **parts, cubic=True)

    @cached_property
    def straight(self) -> Any:
        """Operator of the linear part alone, on the same nodes."""
        return self.model.linear.on(self.points)

    def at(self, numbers: Numbers) -> PlacedThirdOrder:
        """The operator with other constants, of which nothing is proven."""
        own = renumbered(self.learnable, numbers)
        return PlacedThirdOrder(replace(self.model, **own, proven={}), self.points)

    def energy(self, u: ArrayLike) -> ndarray | None:
        """Energy of the linear part and h² Σ Ψ(H) [stress · length²], shape [...], up to what the
        collar alone has (N1, N24); None for the filtered form."""
        own = super().energy(u)
        return None if own is None else np.asarray(own + self.straight.energy(u))

    def stress(self, u: ArrayLike) -> ndarray:
        """Stress of the linear part plus P of Ψ [stress] at interior nodes, [..., I, 2, 2] (N2)."""
        return np.asarray(self.straight.stress(u) + super().stress(u))

    def max_symbol_eigenvalue(self) -> float:
        """Upper bound of the tangent's eigenvalues [stress / length²] up to the proven strain, for
        time steps: twice the linear part's (N15). InputError for the filtered form."""
        if self.model.form != "energy":
            raise InputError(
                "simulate: expected form='energy', got 'filtered', whose force is no gradient: its "
                "waves would gain or lose energy"
            )
        return 2 * largest(*stencil_of(self.model.linear, self.points.spacing, "simulate"))

    def inverse(self, loads: int) -> Inverse:
        """Inverse of the linear part on interior loads: factorised, or by iteration."""
        return self.straight.linear.cheapest_inverse(SOLVES * loads)  # type: ignore[no-any-return]

    def figures(self, solution: Solution) -> Values:
        """Most linear solves, largest gradient, and whether all answers are proven unique."""
        records = solution.details
        return {
            "linear_solves": max(record.solves for record in records),
            "largest_gradient": max(record.largest_gradient for record in records),
            "unique": all(record.unique for record in records),
        }

    def solve(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b [stress/length] on the interior, u given on the collar, [N, 2] or
        [S, N, 2], by Newton(…); its details are one NonlinearRecord for each sample. Warns where
        |H| exceeds the proven strain, so that another solution is not ruled out. Raises InputError
        for arrays that do not fit, and where no equilibrium is found."""
        proven = self.model.proven_strain(self.points.spacing)
        return equilibria_of(self, b, u, solver, proven=proven)


@typed
@dataclass(frozen=True)
class ThirdOrder:
    """Settings of a fit of a crystal with third-order constants t3, tq2, q3 (N1–N6, N22–N29).

    Attributes:
        linear: Crystal(…), whose tensors are learned with the constants by one least squares; its
            "auto" symmetry is "isotropic" here. "long waves" holds the moduli with which no long
            wave is left of the loads (N29).
        smoothing: of the data, which the weights of the gradient undo.
        form: "filtered", closer to the data, or "energy", whose force has an energy and can move.

    The samples' points state the direction of the crystal (Points.axis). An LPS goes in by
    ThirdOrderMaterial(crystal_from_lps(model, spacing), …). `fit` raises InputError where no moduli
    are held.

    >>> law = wp.ThirdOrder(wp.Crystal(10.0), wp.methods.Smoothing(10.0, 0.2), "energy")
    >>> wp.fit(samples, law).material.proven_strain(5.0) > 0
    True
    """

    linear: Crystal
    smoothing: Smoothing
    form: Literal["filtered", "energy"] = "filtered"

    def check_samples(self, samples: Samples, spacing: float | None = None) -> None:
        """Raise InputError for samples to learn from that `learn` refuses, and for nodes that a
        material learned at a `spacing` refuses."""
        if self.linear.moduli is None:
            raise InputError("moduli: expected some that are held, beside third-order constants")
        if samples.dimension != 2:
            raise InputError("samples: expected a sheet; in space LPS and Crystal are learned")
        if self.linear.orientation is not None and samples.axis is None:
            raise InputError("axis: expected Points(…, axis=degrees) where an orientation is given")
        self.linear.held_moduli(self.linear.turn(samples))
        if spacing is None and not (size := load_sizes(samples)).all():
            raise InputError(f"b: expected loads, got none on sample {size.argmin()}")
        grown = samples.spacing / (spacing or samples.spacing)  # its bonds keep their steps
        bond_classes(samples.spacing, self.linear.horizon)  # its gradient keeps its reach
        families_of(samples.points, self.linear.horizon * max(1.0, grown))

    def learn(
        self, samples: Samples | Dataset | Sequence[Samples], *, progress: bool | None = None
    ) -> Fit:
        """Learn crystal and constants by one least squares (N28–N29); each sample counts by 1/‖b‖.
        The fit's errors have the mean relative training residual, E_res, its history the largest
        |H|, warned of where it is beyond the proven strain. Raises InputError for samples that do
        not carry twice the horizon, do not determine the law, or have no load."""
        begin, (asked, smoothing) = time.perf_counter(), (self.linear, self.smoothing)
        self.check_samples(given := one_set(samples))
        horizon, h = asked.horizon, given.spacing
        turn = asked.turn(given)
        auto = str(asked.symmetry) == "auto"
        tensors = Tensors(h, horizon, "isotropic" if auto else asked.symmetry, turn)
        weights = smoothing.weights(bond_classes(h, horizon), self.form)
        moduli, misfit = asked.held_moduli(turn), None
        learning = Learning(given, tensors, horizon, weights)
        if moduli is None:
            moduli, misfit = learning.found_moduli()
        found, _ = learning.at(moduli)
        linear = tensors.crystal(found, given.units, {})
        t3, tq2, q3 = found.p[0][len(tensors.bonds.basis) :]
        record = {"from": "fields", "loss": found.loss, "long_wave_misfit": misfit}
        record |= {"cuts": found.cuts, "numbers": len(found.p[0])}
        law = ThirdOrderMaterial(
            linear, t3, tq2, q3, smoothing, self.form, float(horizon), provenance={"fit": record}
        ).certified()
        operator = PlacedThirdOrder(law, given.points)
        b = given.loads[:, given.interior]
        left = norms(operator(given.u) - b)
        largest = float(operator.largest_gradient(given.u).max())
        if largest > (proven := law.proven_strain(law.spacing)):
            warn(
                f"strain: solutions are proven unique up to |H| = {proven:.2%}, the training data "
                f"reach {largest:.2%}; a larger ridge of the smoothing than {smoothing.ridge:g} "
                "may prove more"
            )
        history = record | {"largest_gradient": largest, "seconds": time.perf_counter() - begin}
        errors = {"E_res": float((left / learning.size).mean())}
        return Fit(law, linear.certificate, errors, history, left=relative(left, b))


class Learning:
    """Regression of tensors together with forces of t3, tq2, q3, and of λ and μ in Ψ, each at 1;
    gradient weights p_in and p_out by class, [C]."""

    def __init__(self, samples: Samples, tensors: Tensors, horizon: float, weights: Pair) -> None:
        self.samples, self.tensors, self.size = samples, tensors, load_sizes(samples)
        (steps, into), (_, out) = (gradient_stencil(samples, horizon, p) for p in weights)
        energy, none = partial(energy_density, axis=axis_of(samples)), np.zeros((2, 2, 2))
        numbers, columns = dict.fromkeys((*CUBIC, "lam", "mu"), 0.0), []
        operator = Pointwise(
            samples, horizon, energy, steps, into, back=out, numbers=numbers, cubic=True,
            stencil=Stencil(samples.spacing, np.eye(2, dtype=int), none),
        )  # fmt: skip
        for name in numbers:
            operator.take(numbers | {name: 1.0})
            columns.append(operator.force(samples.u) @ samples.lattice.axes)
        self.extra = np.stack(columns, axis=-1)  # along the nodes' axes, [S, I, 2, 5]
        self.R, self.y = rows(samples, tensors.bonds, weight=1 / self.size, extra=self.extra)
        if len(self.R) < self.R.shape[1]:
            raise InputError(
                f"data: expected enough to tell {self.R.shape[1]} numbers apart; give more loads"
            )

    def at(self, tensor: ndarray) -> tuple[Settled, ndarray]:
        """Fit the numbers with some moduli held; also those of all columns."""
        lame = lame_of(tensor)  # Ψ has those of the tensors
        found = self.tensors.fitted(self.R[:, :-2], self.y - self.R[:, -2:] @ lame, tensor)
        return found, np.concatenate([found.p[0], lame])

    def found_moduli(self) -> tuple[ndarray, float]:
        """Moduli that leave no long waves of the loads unexplained (N29), and the residual."""
        allowed, samples = self.tensors.allowed, self.samples
        values, kept, moments = long_wave_rows(samples, allowed, 0)
        place, seen, load = (np.cumsum(samples.interior) - 1)[kept], [], []
        for _, F, b in swept(samples, self.tensors.bonds, self.extra):
            seen.append(np.einsum("vn,snka->svka", values, F[:, place], optimize=True))
            load.append(np.einsum("vn,snk->svk", values, b[:, place], optimize=True))
        weight = 1 / self.size[:, None, None, None]
        long, right = np.concatenate(seen) * weight, np.concatenate(load) * weight[..., 0]
        own = long[..., -2:] @ lame_of(allowed).T
        R = np.concatenate([moments * weight + own, long[..., -5:-2]], axis=-1)

        def left(c: ndarray) -> ndarray:
            return np.asarray(right - long @ self.at(np.tensordot(c, allowed, 1))[1])

        def change(c: ndarray) -> ndarray:
            return moduli_of(R, left(c))[0][: len(c)]

        guess = long_wave_moduli(samples, allowed)[0]
        start = lstsq(allowed.reshape(len(allowed), -1).T, guess.ravel())[0]
        c = root(change, start, tol=SETTLED).x
        return np.tensordot(c, allowed, 1), relative(left(c), right)
