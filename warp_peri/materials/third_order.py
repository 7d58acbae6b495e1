"""Third-order elasticity of sheets: material, operator, uniqueness and fit (theory, N).

Of sheets whose long waves are isotropic: crystals with three- or sixfold axes, as graphene. The
linear part is a crystal; an LPS goes in by crystal_from_lps(model, spacing). With
stresses of gradients projected to |H| ≤ ε, u ← u + L⁻¹ (b − L u) contracts in the energy norm of
the linear part by C(ε) κ_in κ_out: C bounds Ψ″ on the ball, κ_p² the ratio of |h_p(k)|² to
Λmin D(k) over the zone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.special import j0

from warp_peri.core.elastic import plane_isotropic
from warp_peri.core.pointwise import Pointwise
from warp_peri.core.proof import largest, prove
from warp_peri.core.record import Length, OnLinear, Stress
from warp_peri.core.stencil import Stencil, squared
from warp_peri.errors import InputError, warn
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.crystal_fit import transfer_to_lattice
from warp_peri.points.arguments import NotNegative, Positive, is_number, typed
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.points import PointsLike, axis_of, lattice_steps, nodes_of
from warp_peri.points.unit_names import USUAL, Units, check_same, shown_moduli, symbols
from warp_peri.protocols import SAME_SPACING, offered, stencil_of
from warp_peri.solvers.equilibria import SOLVES, equilibria_of, figures_of
from warp_peri.solvers.linear import Inverse, bonds_within
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
DIRECTIONS = 400
"""Intervals on which homogeneous parts of Ψ are sampled along each of two angles."""
SLACKS = (1.001, 1.002, 1.005, 1.01, 1.02, 1.05, 1.1, 1.25, 1.5, 2.0, 4.0)
"""Multiples of the sampled κ² that are tried, smallest first."""
CONTRACTION = 0.999
"""What C κ_in κ_out must stay below."""
SAME = 1e-5
"""Relative, that a proven strain may be above that of a proof anew."""
MEASURES = torch.tensor([[1, 0, 0, 1], [0.5, 0, 0, -0.5], [0, 0.5, 0.5, 0]], dtype=torch.float64)
"""Of E00, E01, E10 and E11 the trace t and the deviator a, b."""


@typed
@dataclass(frozen=True)
class Smoothing:
    """How the data were smoothed, for the filtered form.

    Attributes:
        radius: R of the cone max(0, R − r) [Å].
        ridge: ρ of the Wiener inverse (1 + ρ) ω̂/(ω̂² + ρ); 0 is the exact inverse 1/ω̂, which
            amplifies short waves. A smaller one is closer to the data and proves less.

    Raises InputError for a radius that is not > 0 or a ridge that is not ≥ 0.
    """

    radius: Length = 10.0
    ridge: NotNegative = 0.1

    def transform(self, k: np.ndarray) -> np.ndarray:
        """ω̂(|k|) of the cone of unit integral, at wave numbers k [1/Å]."""
        node, weight = np.polynomial.legendre.leggauss(200)
        r = (node + 1) * self.radius / 2
        part = weight * (self.radius - r) * r
        return np.asarray(j0(np.multiply.outer(k, r)) @ part / part.sum())

    def inverse(self, k: np.ndarray) -> np.ndarray:
        """The Wiener inverse (1 + ρ) ω̂/(ω̂² + ρ)."""
        smooth = self.transform(k)
        return (1 + self.ridge) * smooth / (smooth**2 + self.ridge)

    def root(self, k: np.ndarray) -> np.ndarray:
        """√((1 + ρ) ω̂²/(ω̂² + ρ)), what the inverse and the transform make together (N23)."""
        square = self.transform(k) ** 2
        return np.asarray(np.sqrt((1 + self.ridge) * square / (square + self.ridge)))

    def weights(
        self, classes: BondClasses, form: str = "filtered"
    ) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/length²], each of shape [C].

        Of the energy form both fit the root (N23). Of the filtered one (N6) Σ n r² p = 1, and
        2 Σ p sin(k·ξ) ξ fits k times the inverse, or the transform, of the smoothing by least
        squares: the Wiener inverse over all waves that the lattice has, |k_a| ≤ π/h, the exact
        inverse and the transform over |k_a| ≤ CORE / R. Errors count as those of the gradient under
        a unit load, which displaces by 1/|k|², and wave numbers alike, which is |k|^(−5/2) in all.
        Of such powers it has the least residual on training loads that were held out.
        """
        zone = np.pi / classes.spacing
        if form == "energy":
            return 2 * (fitted_weights(classes, self.root, zone),)
        core = min(zone, CORE / self.radius)
        inward = fitted_weights(classes, self.inverse, zone if self.ridge > 0 else core)
        return inward, fitted_weights(classes, self.transform, core)


def fitted_weights(
    classes: BondClasses, factor: Callable[[np.ndarray], np.ndarray], reach: float
) -> np.ndarray:
    """Weights p [1/Å²] whose symbol fits k factor(|k|) over the square |k_a| ≤ reach; Σ n r² p = 1.

    Args:
        classes: bond classes of a lattice.
        factor: of wave numbers [1/Å].
        reach: [1/Å].
    """
    sigma = classes.count * classes.r**2
    member = np.eye(len(classes.r))[classes.bond_class]
    line = np.linspace(-reach, reach, GRID)
    k = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    number = np.hypot(*k.T)
    some = number > 1e-6 * reach
    k, number = k[some], number[some]
    slope = 2 * np.sin(k @ classes.xi.T)
    symbol = np.stack([slope @ (x[:, None] * member) for x in classes.xi.T], axis=1)
    weight = number**-2.5  # see weights
    weight /= np.sqrt((weight**2 * number**2).mean())
    rows = [
        (symbol * weight[:, None, None]).reshape(-1, len(sigma)),
        HELD * sigma[None],
        SIZE * 2 * len(k) * np.diag(sigma),
    ]
    right = [(k * (weight * factor(number))[:, None]).ravel(), [HELD], np.zeros(len(sigma))]
    p = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    return np.asarray(p / (sigma @ p))


@dataclass(frozen=True)
class Uniqueness:
    """The guarantee of a nonlinear model on one lattice.

    Attributes:
        spacing: h [Å].
        strain: ε*, largest |H| up to which solutions are proven unique; 0 where nothing is.
        kappa_in, kappa_out: proven bounds of κ [TPa^(−1/2)].
        curvature: the bound C(ε*) of Ψ″ [TPa].
        largest_parts: M_d, bounds of the homogeneous parts of Ψ of degree 3 to 6 at |H| = 1 [TPa].
        units: names of the units of length and stress.
    """

    spacing: float
    strain: float
    kappa_in: float
    kappa_out: float
    curvature: float
    largest_parts: tuple[float, ...]
    units: Units = USUAL

    @property
    def statement(self) -> str:
        """What is proven, in one sentence."""
        length = symbols(self.units)[0]
        if not self.strain > 0:
            return f"Nothing is proven on the lattice of spacing {self.spacing:g} {length}."
        return (
            f"On any finite set of nodes of the square lattice of spacing {self.spacing:g} "
            f"{length}, with displacement given out to twice the horizon around it, for every "
            f"load, at most one solution has |H| ≤ {self.strain:.4f} at every node within the "
            "horizon of an unknown."
        )

    def figures(self) -> dict[str, Any]:
        """The figures as plain values, and the statement."""
        found = vars(self) | {"statement": self.statement}
        return {name: found[name] for name in found if name != "units"}


@typed
def prove_uniqueness(model: Any, *, spacing: Positive) -> Uniqueness:
    """Prove up to which |H| solutions on a lattice are unique: the largest that proven bounds of κ
    [stress^(−1/2)] leave (N15).

    Args:
        model: a solid of third order.
        spacing: h [length].

    Raises InputError when the horizon is below one spacing, and for another material.
    """
    offered(model, "reach", "prove_uniqueness", "a solid of third order")
    stencil, group = stencil_of(model.linear, spacing, "prove_uniqueness")
    classes = bond_classes(spacing, model.reach)
    p_in, p_out = model.weights(classes)
    kappa_out = proven_kappa(stencil, group, classes, p_out)
    kappa_in = kappa_out if p_in is p_out else proven_kappa(stencil, group, classes, p_in)
    parts = largest_parts(model)
    kappas, strain, high = (kappa_in, kappa_out), 0.0, 1.0
    for _ in range(60):
        middle = (strain + high) / 2
        small = curvature_bound(parts, middle) * kappa_in * kappa_out < CONTRACTION
        strain, high = (middle, high) if small else (strain, middle)
    bound = curvature_bound(parts, strain)
    return Uniqueness(stencil.spacing, strain, *kappas, bound, tuple(parts), model.units)


def curvature_bound(parts: Sequence[float], strain: float) -> float:
    """C(ε) = Σ_d d (d − 1) M_d ε^(d−2) [TPa], (N16): no eigenvalue of Ψ″ is larger in |H| ≤ ε."""
    return float(sum(d * (d - 1) * m * strain ** (d - 2) for d, m in enumerate(parts, start=3)))


def largest_parts(model: Any) -> list[float]:
    """M_d ≥ max |Ψ_d| over |H| = 1 of the parts of degree d = 3, 4, 5, 6 of Ψ [TPa], (N17).

    Ψ_d depends on t, |q|, ω and, through q3, on the phase of q, which is put where it is worst. A
    polynomial of degree d on the sphere, sampled at a distance of η at most, is nowhere larger than
    its largest sample over cos dη (M. Riesz).
    """
    a, b = np.meshgrid(np.linspace(0, np.pi, DIRECTIONS + 1), np.linspace(0, np.pi / 2, DIRECTIONS))
    t, side = np.sqrt(2) * np.cos(a), np.sin(a) / np.sqrt(2)
    q, w = side * np.cos(b), side * np.sin(b)
    reach = np.pi / DIRECTIONS / np.sqrt(2)  # of the nearest sample, from any point
    s = np.exp(2j * np.pi * np.arange(8) / 8)[:, None, None]  # sizes of H, whose powers FFTs tell
    m = 1 + s * t + s**2 * (t**2 / 4 + w**2)
    e, shear = m - 1 + s**2 * q**2, s**2 * q**2 * m
    lam, mu, t3, tq2, q3 = model.numbers
    psi = (lam + mu) / 2 * e**2 + 2 * mu * shear + t3 * e**3 + tq2 * e * shear
    smooth, size, parts = np.fft.fft(psi, axis=0).real / 8, np.hypot(t / 2, w), []
    for d, binomial in enumerate((1, 3, 3, 1), start=3):
        worst = np.abs(smooth[d]) + abs(q3) * binomial * q**3 * size ** (d - 3)
        parts.append(float(worst.max() / np.cos(d * reach)))
    return parts


def proven_kappa(stencil: Stencil, group: np.ndarray, classes: BondClasses, p: np.ndarray) -> float:
    """A proven upper bound of κ_p [stress^(−1/2)]; infinite when none was found (N14).

    Args:
        stencil: of the linear solid, certified.
        group: integer matrices under which it is invariant, shape [g, d, d].
        classes: bond classes of the gradient's family.
        p: its weights by class [1/length²], Σ n r² p = 1.
    """
    d = stencil.dimension
    gradient = d * p[classes.bond_class, None] * classes.xi
    weight = squared(stencil.spacing, classes.steps, gradient)
    proven = prove(stencil, group, weight, tuple(1 / slack for slack in SLACKS)).proven
    return float(1 / np.sqrt(proven)) if proven > 0 else float(np.inf)


@lru_cache(maxsize=64)
def _moduli(axis: float) -> torch.Tensor:
    """∂W/∂(t, a, b) as t, a, b times 1, t², a² and b² have it of λ, μ, t3, tq2, q3, [3, 4, 5]."""
    moduli, c, s = torch.zeros(3, 4, 5, dtype=torch.float64), np.cos(6 * axis), np.sin(6 * axis)
    moduli[0, 0, :2], moduli[1:, 0, 1] = 0.5, 2.0
    moduli[0, 1, 2] = moduli[0, 2, 3] = moduli[0, 3, 3] = 1.0
    moduli[1:, 2:, 4] = torch.tensor([[c, -3 * c], [3 * s, -s]])
    return moduli


def energy_density(
    E: torch.Tensor, *, axis: float, lam: Any, mu: Any, t3: Any, tq2: Any, q3: Any
) -> Any:
    """The energy (N3) [stress] of Green strains E [..., 2, 2], of a crystal at `axis` [rad]."""
    given = (torch.as_tensor(n, dtype=torch.float64) for n in (lam, mu, t3, tq2, q3))
    moduli = _moduli(axis) @ torch.stack([*given])
    v = MEASURES @ E.flatten(-2).movedim(-1, 0).reshape(4, -1)
    return (v * (moduli[:, :1] * v + moduli[:, 1:] @ (v * v))).sum(0).reshape(E.shape[:-2])


def gradient_stencil(
    points: PointsLike, reach: float, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps [B, 2] and weights 2 p ξ [1, B, 2] of H (N1), of p by class, in the points' axes."""
    classes, (_, axes) = bond_classes(points.spacing, reach), lattice_steps(nodes_of(points))
    return classes.steps, 2 * p[classes.bond_class, None] * (classes.xi @ axes.T)[None]


@dataclass(frozen=True, eq=False, repr=False)
class ThirdOrderMaterial(OnLinear, format="warp_peri.third_order_crystal"):
    """A law of micromodulus tensors and the energy Ψ of a displacement gradient (N1–N6, N22).

    Attributes:
        linear: the tensors, which are the tangent at zero; the λ and μ of their long waves are
            those of Ψ.
        t3, tq2, q3: third-order elastic constants [stress], q3 in the frame of the crystal, whose
            zigzag direction the points state (Points.axis).
        smoothing: of the data, where the weights of the gradient undo it.
        form: "filtered", or "energy", whose tangent is symmetric.
        reach: horizon of the gradient [length].
        proven: figures of the guarantee of uniqueness on the spacing of the law.
        provenance: of the data and the fit; plain JSON values.

    Raises InputError for numbers that are none, a law in space, and moduli of long waves that are
    not isotropic, which Ψ is not made for.
    """

    linear: CrystalMaterial
    t3: Stress
    tq2: Stress
    q3: Stress
    smoothing: Smoothing
    form: str
    reach: Length
    proven: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form not in FORMS:
            raise InputError(f"form: expected one of {', '.join(FORMS)}, got {self.form!r:.50}")
        if self.linear.dimension != 2:
            raise InputError("linear: third-order constants are for sheets, got a model in space")
        lam, mu = self.lame
        miss = float(np.abs(self.linear.elastic_tensor() - plane_isotropic(lam, mu)).max())
        if miss > ISOTROPIC * abs(mu):
            raise InputError(
                f"linear: third-order constants are for isotropic long waves, got C11, C22, C16 or "
                f"C26 off by {miss / mu:.1e} of the shear modulus; symmetry='isotropic' has them"
            )

    @property
    def spacing(self) -> float:
        """Of the nodes."""
        return self.linear.spacing

    @property
    def horizon(self) -> float:
        """Of the longest bond that tensors or gradient have."""
        return max(self.linear.horizon, self.reach)

    @property
    def lame(self) -> tuple[float, float]:
        """λ and μ of long waves [stress]."""
        C = self.linear.tensor()
        return C[0, 0, 1, 1], C[0, 1, 0, 1]

    @property
    def numbers(self) -> np.ndarray:
        """λ, μ, t3, tq2 and q3 [stress], shape [5]."""
        return np.array([*self.lame, self.t3, self.tq2, self.q3])

    def weights(self, classes: BondClasses) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/length²], each of shape [C]."""
        return self.smoothing.weights(classes, self.form)

    def on(
        self, points: PointsLike, *, transfer: bool = True, allow_uncertified: bool = False
    ) -> PlacedThirdOrder:
        """The law on a lattice, for its spacing: tensors transferred, proven anew.

        Constants, smoothing and reach belong to the material and go along; the weights follow the
        lattice.

        Args:
            points: as of PlacedThirdOrder.
            transfer: False refuses lattices that the material itself is not certified on.
            allow_uncertified: take tensors that hold no certificate, with a warning.

        Raises InputError for other units, scattered points, tensors without a certificate, and as
        PlacedThirdOrder.
        """
        nodes, here = nodes_of(points), self
        check_same(self.units, nodes.units)
        if not nodes.spacing > 0:
            raise InputError("points: a third-order crystal is for lattices, got scattered points")
        if abs(nodes.spacing / self.spacing - 1) > SAME_SPACING:
            if not transfer:
                raise InputError(
                    f"spacing: the model is for {self.spacing:g}, the points have "
                    f"{nodes.spacing:g}, and transfer=False"
                )
            here = _transferred(self, nodes.spacing)
        proof = here.linear.certificate
        if proof is None or not proof.holds:
            said = "the crystal model has no certificate on this lattice"
            if not allow_uncertified:
                raise InputError(f"certificate: {said}; allow_uncertified=True takes them")
            warn(f"certificate: {said}")
        return PlacedThirdOrder(here, nodes)

    def proven_strain(self, spacing: float) -> float:
        """Largest |H| up to which solutions on a lattice are proven unique; 0 where none is."""
        here = abs(spacing / self.spacing - 1) <= SAME_SPACING
        return float(self.proven.get("strain", 0.0)) if here else 0.0

    def certified(self) -> ThirdOrderMaterial:
        """The law with its guarantee of uniqueness, where its tensors are certified (N14)."""
        proof = self.linear.certificate
        if proof is None or not proof.holds:
            return self
        return replace(self, proven=prove_uniqueness(self, spacing=self.spacing).figures())

    def verify_certificates(self) -> None:
        """Raise InputError unless the strain that a file says to be proven is, of these numbers."""
        said = self.proven.get("strain", 0.0)
        proven = prove_uniqueness(self, spacing=self.spacing).strain if said else 0.0
        if not (is_number(said) and 0 <= said <= (1 + SAME) * proven):
            raise InputError(
                f"proven: one solution up to |H| = {said!r:.20} is not proven of these"
            )

    def elsewhere(self, length: float, stress: float) -> dict[str, Any]:
        """Of what is proven the strain, which has no unit, goes along."""
        return {"proven": {k: v for k, v in self.proven.items() if k == "strain"}}

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, those of the tensors last."""
        shown = shown_moduli(self.units, (getattr(self, name) for name in CUBIC))
        rows = [("form", self.form), (", ".join(CUBIC), shown)]
        if self.proven.get("strain"):
            rows.append(("proven", f"one solution up to |H| = {self.proven['strain']:.2%}"))
        return rows + self.linear.rows()


@lru_cache(maxsize=64)
def _transferred(law: ThirdOrderMaterial, spacing: float) -> ThirdOrderMaterial:
    linear = transfer_to_lattice(law.linear, spacing)
    return replace(law, linear=linear, proven={}).certified()


class PlacedThirdOrder(Pointwise):
    """Minus the internal force density of a solid of third order; b in equilibrium.

    Args:
        model: the solid, for the spacing of the points.
        points: a lattice, whose interior has a collar as wide as the linear part needs and twice
            the gradient's horizon; their axis is that of the crystal, x where none is stated, which
            is said once.

    Raises InputError for nodes without the collar.
    """

    def __init__(self, model: ThirdOrderMaterial, points: PointsLike) -> None:
        self.model, nodes = model, nodes_of(points)
        axis = axis_of(nodes) if model.q3 or nodes.axis is not None else 0.0
        p_in, p_out = model.weights(bond_classes(model.spacing, model.reach))
        steps, weights = gradient_stencil(nodes, model.reach, p_in)
        back = None if p_in is p_out else gradient_stencil(nodes, model.reach, p_out)[1]
        lam, mu = model.lame
        density = partial(energy_density, lam=lam, mu=mu, axis=axis)
        numbers = {name: getattr(model, name) for name in CUBIC}
        parts: dict[str, Any] = {"back": back, "stencil": model.linear.stencil, "numbers": numbers}
        super().__init__(nodes, model.horizon, density, steps, weights, **parts)

    @cached_property
    def straight(self) -> Any:
        """The linear part alone, on the same nodes."""
        return self.model.linear.on(self.points)

    def at(self, numbers: Mapping[str, Any]) -> PlacedThirdOrder:
        """The same with other constants, of which nothing is proven."""
        own: dict[str, Any] = {name: float(value) for name, value in numbers.items()}
        return PlacedThirdOrder(replace(self.model, **own, proven={}), self.points)

    def energy(self, u: ArrayLike) -> np.ndarray | None:
        """Of the linear part, and h² Σ Ψ(H) [stress · length²], shape [...], up to what the collar
        alone has: its derivative to the interior displacement is h² L u (N1, N24). None of the
        filtered form."""
        own = super().energy(u)
        return None if own is None else np.asarray(own + self.straight.energy(u))

    def stress(self, u: ArrayLike) -> np.ndarray:
        """σ of the linear part and P of Ψ [stress] at the interior nodes, [..., I, 2, 2] (N2)."""
        return np.asarray(self.straight.stress(u) + super().stress(u))

    def max_symbol_eigenvalue(self) -> float:
        """A bound on the eigenvalues of the tangent [stress / length²] up to the proven strain, for
        time steps: twice that of the linear part (N15).

        Raises InputError for the filtered form, which has no energy that a motion could keep.
        """
        if self.model.form != "energy":
            raise InputError(
                "simulate: expected form='energy', got 'filtered', whose force is no gradient: its "
                "waves would gain or lose energy"
            )
        return 2 * largest(*stencil_of(self.model.linear, self.points.spacing, "simulate"))

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of the linear part, of a load on the interior: factorised, or by iteration."""
        bonds = bonds_within(self.model.horizon, self.points.spacing)
        inverse: Inverse = self.straight.linear.cheapest_inverse(SOLVES * loads, bonds)
        return inverse

    def figures(self, solution: Solution) -> dict[str, Any]:
        """What solves took, and whether their answers are the only ones, for `evaluate`."""
        return figures_of(solution.details)

    def solve(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar.

        Args:
            b: body force density [stress/length], [N, 2] or [S, N, 2]; only interior values count.
            u: displacement [length], same shape; only collar values count.
            solver: Newton(…).

        A UserWarning says where |H| exceeds the proven strain, so that another solution is not
        ruled out. The details of the solution are one NonlinearRecord for each sample.

        Raises InputError for arrays that do not fit, and a sample for which no equilibrium was
        found.
        """
        proven = self.model.proven_strain(self.points.spacing)
        return equilibria_of(self, b, u, solver, proven)
