"""The linear peridynamic solid (LPS) as a value: its numbers, file and stencil on a lattice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike
from scipy.special import comb

import warp_peri.materials as materials
from warp_peri.core.elastic import lattice_group, symmetric_part
from warp_peri.core.proof import StencilCertificate, prove, statement_of
from warp_peri.core.record import FieldUnits, Length, Record, taken
from warp_peri.core.stencil import Stencil, stencil_in_box
from warp_peri.errors import OF_POSITIONS, InputError, Rows, Values, called, error_rows, hold, warn
from warp_peri.materials.lps_force import CANCELLED, assemble, bonds_of
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.points.arguments import (
    USUAL,
    Numbers,
    Pair,
    Positive,
    Units,
    checked,
    factors,
    is_number,
    is_tensor,
    plain,
    shown_moduli,
    symbols,
    typed,
)
from warp_peri.points.families import DEGREE, SINGULARITY, BondClasses, bond_classes
from warp_peri.points.points import Points, PointsLike, check_dimensions, grid_places
from warp_peri.protocols import renumbered

ALPHA_BOUND = 3.0
"""The quadrature is consistent for α below this (You et al. 2021, remark 1)."""
LARGEST_DEGREE = 1000
"""Above 1029 the binomial coefficients are no floating-point numbers."""
SPACING_TOLERANCE = 1e-6
"""A lattice within this of a certified one, relative to its spacing, is taken as that lattice."""
NOTHING = 1e-14
"""Relative, of tensors that are rounding."""
GAMMAS = ("gamma_min", "gamma_max", "gamma_minus_2phi_min", "gamma_minus_2phi_max")
"""Figures of a certificate that are in 1/length²; files of before have the second too."""
INF_SUP = ("inf_sup_min", "inf_sup_rank")
"""Those of no unit."""
AVERAGED = 8
"""Positions along the radius of the ball that moduli as a function are averaged over."""
Modulus = ArrayLike | Callable[[ndarray], ArrayLike]


def bernstein_basis(r: ArrayLike, horizon: float, degree: int) -> ndarray:
    """Bernstein polynomials B_k,M(r/δ) at lengths in [0, δ], to rounding, shape [..., M + 1]."""
    if degree > LARGEST_DEGREE:
        raise InputError(f"degree: expected at most {LARGEST_DEGREE}, got {degree}")
    t = np.minimum(checked("r", r) / horizon, 1.0)[..., None]
    k = np.arange(degree + 1)
    return np.asarray(comb(degree, k) * t**k * (1 - t) ** (degree - k))


def check_influence(alpha: float, D: ndarray) -> None:
    """Raise InputError for an exponent or coefficients that make no influence function."""
    if D.ndim != 1:
        raise InputError(f"D: expected a list of numbers, got lists of shape {list(D.shape)}")
    most = LARGEST_DEGREE + 1
    if not 0 < len(D) <= most:
        raise InputError(f"D: expected at least one coefficient, at most {most}, got {len(D)}")
    if not D.any():
        raise InputError("D: expected a coefficient other than 0")
    if not alpha < ALPHA_BOUND:
        raise InputError(f"alpha: expected less than {ALPHA_BOUND:g}, got {alpha}")


@typed
@dataclass(frozen=True, eq=False)
class LPSParameters:
    """Numbers λ, μ [TPa], α < 3, D [M + 1] of a homogeneous LPS, or tensors with gradients.

    Raises InputError where λ, μ or α is no single real number, D no list of them, and for α ≥ 3.
    """

    lam: Any
    mu: Any
    alpha: Any
    D: Any

    def __post_init__(self) -> None:
        given = {n: v.detach().cpu() if is_tensor(v) else v for n, v in vars(self).items()}
        # those of Warp have a place in memory, and may learn here
        found = {n: checked(n, v.numpy() if hasattr(v, "ptr") else v) for n, v in given.items()}
        for name in ("lam", "mu", "alpha"):
            if found[name].size != 1:
                got = f"one number of a homogeneous solid, got shape {list(found[name].shape)}"
                raise InputError(f"{name}: expected {got}")
        check_influence(found["alpha"].item(), np.atleast_1d(found["D"]))

    def values(self) -> tuple[Any, ...]:
        """Values of λ, μ, α and D as a tuple."""
        return self.lam, self.mu, self.alpha, self.D


@dataclass(frozen=True, eq=False)
class LPSMaterial(Record, format="warp_peri.model"):
    """A linear peridynamic solid with K(r) = r^(−α) Σ_k D_k B_k,M(r/δ) (theory, 4–9, V1–V3).

    Attributes:
        lam: Lamé parameter λ [TPa]; a number, or one of each of the `nodes`, shape [N].
        mu: Lamé parameter μ, the shear modulus [TPa]; likewise.
        alpha: exponent α < 3.
        D: Bernstein coefficients of any sign, shape [M + 1]; their common scale has no effect.
        horizon: δ [Å].
        trained_on: spacings of the training lattices [Å].
        certified_on: spacings of the lattices that solves accept [Å].
        trained_strain: largest strain of neighbouring nodes in the training fields, if known.
        largest_wave_number: largest |k| that the training loads held [1/Å], if known; nothing is
            claimed of the model beyond it.
        certificate, errors: figures by spacing, and on data sets by name.
        provenance, versions: of the data and the fit, and of the packages.
        units: names of the units of length and stress, in the place of Å and TPa here.
        dimension: 2, a sheet, or 3, a solid.
        nodes: of moduli that are fields, which are for these points alone [Å], shape [N, d].

    Raises InputError naming the first number out of its range.

    >>> round(wp.LPSMaterial(0.3, 0.7, 1.0, np.ones(1), horizon=12.5).E, 3)
    1.647
    """

    lam: Annotated[float, FieldUnits(stress=1, key="lambda", spread=True)]
    mu: Annotated[float, FieldUnits(stress=1, spread=True)]
    alpha: float
    D: ndarray
    horizon: Length
    trained_on: Annotated[tuple[float, ...], FieldUnits(length=1)] = ()
    certified_on: Annotated[tuple[float, ...], FieldUnits(length=1, positive=True)] = ()
    trained_strain: Annotated[float | None, FieldUnits(omit=True, positive=True)] = None
    largest_wave_number: Annotated[
        float | None, FieldUnits(length=-1, positive=True, omit=True)
    ] = None
    certificate: Values = field(default_factory=dict)
    errors: Values = field(default_factory=dict)
    provenance: Values = field(default_factory=dict)
    versions: Values = field(default_factory=dict)
    units: Units = USUAL
    dimension: Annotated[int, FieldUnits(omit=True)] = 2
    nodes: Annotated[ndarray | None, FieldUnits(length=1, omit=True)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_dimensions("dimension", self.dimension)
        check_influence(self.alpha, self.D)
        d, N = self.dimension, 0
        if self.nodes is not None:
            N = len(checked("nodes", self.nodes, float, ("N", d)))
            if self.certified_on:
                raise InputError("certified_on: expected nothing, for moduli as fields")
        for name, one in (("lambda", self.lam), ("mu", self.mu)):
            if (shape := plain(name, one).shape) not in ((), (N,) if N else ()):
                what = f"a number, or one of each of {N} nodes"
                raise InputError(f"{name}: expected {what}, got shape {list(shape)}")
        if not np.all((self.mu > 0) & (self.lam + 2 * self.mu / d > 0)):
            bulk = "λ + μ" if d == 2 else "λ + 2μ/3"
            got = "others at some nodes" if N else f"{self.lam}, {self.mu}"
            raise InputError(f"lambda, mu: expected μ > 0 and {bulk} > 0, got {got}")
        told = self.statements  # in its units, whatever a file says
        own = {f"{h:g}": each | {"statement": told.get(h)} for h, each in self.figures.items()}
        hold(self, certificate=own)

    @classmethod
    def isotropic(
        cls,
        E: Positive,
        nu: float,
        horizon: Positive,
        spacing: Positive,
        *,
        dimension: Literal[2, 3] = 2,
        units: Units = USUAL,
    ) -> LPSMaterial:
        """Make the LPS of an isotropic continuum, K = 1/r, proven on a lattice.

        Args:
            E: Young's modulus [stress], of a sheet in plane stress.
            nu: Poisson's ratio above −1 and below 1, in space below ½.
            horizon: δ [length].
            spacing: h of the lattice [length].
            dimension: 2 or 3.
            units: of length and stress.

        Raises InputError for another Poisson's ratio, and a horizon below one spacing.

        >>> wp.LPSMaterial.isotropic(1.0, 0.25, horizon=15.0, spacing=5.0).mu
        0.4
        """
        if not -1 < nu < 1 / (dimension - 1):
            raise InputError(f"nu: expected −1 < ν < {1 / (dimension - 1):g}, got {nu!r}")
        mu = E / (2 * (1 + nu))
        lam = 2 * mu * nu / (1 - (dimension - 1) * nu)
        model = cls(lam, mu, 1.0, np.ones(1), horizon, dimension=dimension, units=units)
        if not prove(model.stencil(spacing), model.group).holds:
            raise InputError(f"nu, horizon: expected a solid that is stable at spacing {spacing:g}")
        return replace(model, certified_on=(spacing,))

    @property
    def degree(self) -> int:
        """Degree M of the Bernstein polynomial."""
        return len(self.D) - 1

    @property
    def learnable(self) -> Values:
        """Numbers λ, μ, α and D by name."""
        return {name: getattr(self, name) for name in ("lam", "mu", "alpha", "D")}

    @property
    def mean(self) -> LPSMaterial:
        """The material with moduli that are fields replaced by their means."""
        if self.nodes is None:
            return self
        return replace(self, lam=float(np.mean(self.lam)), mu=float(np.mean(self.mu)), nodes=None)

    def with_parameters(self, numbers: Numbers, nodes: ndarray | None = None) -> LPSMaterial:
        """The unproven material with other `learnable` numbers, fields for some nodes [N, d]."""
        made = renumbered(self.learnable, numbers)
        fields = any(np.ndim(made[name]) for name in ("lam", "mu"))
        of = (self.nodes if nodes is None else nodes) if fields else None
        return replace(self, **made, nodes=of, certified_on=(), certificate={}, errors={})

    def spread(self, points: PointsLike, lam: Modulus | None, mu: Modulus | None) -> LPSMaterial:
        """The material with moduli that differ from node to node.

        Args:
            points: N nodes x.
            lam, mu: numbers, one value a node, shape [N], or functions of x [N, d], of which λ +
                2μ/d and μ are averaged harmonically over a ball of δ/2 around nodes; None: its own.

        Raises InputError for others, and where μ > 0 and λ + 2μ/d > 0 do not hold everywhere.
        """
        x, d = self.own_nodes(points).x, self.dimension
        given = {"lam": self.lam if lam is None else lam, "mu": self.mu if mu is None else mu}
        if not any(map(callable, given.values())):
            return self.with_parameters(given, x)
        steps = (grid_places((2 * AVERAGED + 1,) * d) - AVERAGED) / AVERAGED
        steps = steps[(steps**2).sum(axis=1) <= 1] * self.horizon / 2
        soft = np.zeros((2, len(x)))
        for step in steps:
            there = {n: called(f"{n}: {OF_POSITIONS}", v, x + step) for n, v in given.items()}
            solid = self.with_parameters(there, x)
            soft[0] += 1 / solid.mu / len(steps)
            soft[1] += 1 / (solid.lam + 2 * solid.mu / d) / len(steps)
        shear, bulk = 1 / soft
        return self.with_parameters({"lam": bulk - 2 * shear / d, "mu": shear}, x)

    @property
    def linear(self) -> LPSMaterial:
        """The linear solid at zero strain, which nonlinear materials have too: itself."""
        return self

    @property
    def group(self) -> ndarray:
        """Symmetries of a lattice of nodes that leave the solid unchanged, shape [g, d, d]."""
        return lattice_group(self.dimension)

    def stencil(self, spacing: float, *, degree: int = DEGREE) -> Stencil:
        """Stencil of the solid on a lattice, of twice its range, exact (theory, T17). Raises
        InputError as `stiffnesses` does, and for a spacing without bonds."""
        classes = bond_classes(spacing, self.horizon, dimension=self.dimension, degree=degree)
        return stencil_of(classes, *stiffnesses(self, classes))

    @property
    def bond_based(self) -> bool:
        """Whether λ = μ: no dilatation enters (theory, 42), and a collar of δ is enough."""
        return self.nodes is None and self.lam == self.mu

    @property
    def E(self) -> float:
        """Young's modulus of the continuum [TPa]; of a sheet in plane stress."""
        return 2 * self.mu * (1 + self.nu)

    @property
    def nu(self) -> float:
        """Poisson's ratio of the continuum; of a sheet in plane stress."""
        return self.lam / ((self.dimension - 1) * self.lam + 2 * self.mu)

    def influence(self, r: ArrayLike) -> ndarray:
        """Influence function K at the distances r [Å] in (0, δ]."""
        r, most = checked("r", r), self.horizon * (1 + 4 * SPACING_TOLERANCE)  # of one near by
        if not ((r > 0) & (r <= most)).all():
            raise InputError(f"r: expected distances above 0, at most {self.horizon:g}")
        return np.asarray(r**-self.alpha * (bernstein_basis(r, self.horizon, self.degree) @ self.D))

    @property
    def figures(self) -> dict[float, Values]:
        """Certificate figures by spacing; InputError where a name is not the figures' spacing."""
        exact, found = {f"{h:g}": h for h in self.certified_on}, {}
        for name, each in self.certificate.items():
            try:
                found[h := float(each.get("spacing", exact.get(name, name)))] = each
                fits = f"{h:g}" == name
            except (AttributeError, TypeError, ValueError, OverflowError):
                fits = False
            if not fits:
                raise InputError(f"certificate: expected spacings, got {name!r:.50}")
        return found

    @property
    def statements(self) -> dict[float, str]:
        """Sentences on what is proven, by the spacing of the lattice."""
        return {
            h: statement_of(h, each["symbol_bound"], self.units, self.dimension)
            for h, each in self.figures.items()
            if is_number(each.get("symbol_bound"))
        }

    def certified_spacing_near(self, spacing: float) -> float:
        """The certified spacing [Å] within SPACING_TOLERANCE of a lattice's, or that spacing
        itself. Between bond lengths K may swing by orders of magnitude, so that what is proven of
        one spacing says nothing of the next millionth."""
        known = min(self.certified_on, key=lambda h: abs(h - spacing), default=np.inf)
        return known if abs(spacing / known - 1) <= SPACING_TOLERANCE else spacing

    def is_certified_on(self, spacing: float) -> bool:
        """Whether the model holds a certificate for a lattice spacing [Å], to SPACING_TOLERANCE,
        which is proven of its numbers."""
        here = spacing > 0 and self.certified_spacing_near(spacing) in self.certified_on
        return here and self.stands

    def check_spacing(self, spacing: float, *, allow_uncertified: bool = False) -> None:
        """Refuse, or warn about, an uncertified lattice spacing [Å]."""
        if self.is_certified_on(spacing):
            return
        unit = symbols(self.units)[0]
        known = ", ".join(f"{value:.10g} {unit}" for value in self.certified_on) or "no spacing"
        here = f"{spacing:.10g} {unit}" if spacing else "scattered points"
        message = (
            f"spacing: the model is certified on {known}, not on {here}, where its static "
            "problems may have no solution or a wrong one"
        )
        if allow_uncertified:
            return warn(message)
        if not spacing:
            message += (
                "; transfers.onto_lattice(samples, spacing=…) carries samples to a lattice, "
                "allow_uncertified=True takes the model's own weights on these points"
            )
        raise InputError(message)

    def certified_nodes(self, points: PointsLike) -> Points:
        """The nodes, scaled to the certified spacing near theirs, so that the operator is the one
        of the proof; other lattices and scattered points as they are. Raises InputError for points
        in other units or dimensions than the model."""
        nodes = self.own_nodes(points)
        spacing = self.certified_spacing_near(nodes.spacing)
        if spacing == nodes.spacing:
            return nodes
        scale = spacing / nodes.spacing
        box = None if nodes.box is None else tuple(scale * side for side in nodes.box)
        return replace(nodes, x=scale * nodes.x, spacing=spacing, box=box)

    def interior_matrices(self, points: PointsLike) -> Pair:
        """Γ [1/length²] and Φ [1/length] between a domain's I interior nodes, [d I, d I] and
        [I, d I]."""
        bonds = bonds_of(self, points)
        law = bonds.law(1.0, 1.0, self.alpha, self.D)
        return assemble(bonds, law.kw, law.m).within(points.interior)

    @property
    def transferred_from(self) -> float | None:
        """Spacing [Å] of the lattice whose dispersion the model was fitted to; None at home.
        InputError where the record is in units that are not known."""
        match self.provenance.get("transfer"):
            case {"from_spacing": float(spacing), **record}:
                units: Any = record.get("units", self.provenance.get("units_before", self.units))
                return spacing * factors(units, self.units)[0]
        return None

    def elsewhere(self, length: float, stress: float) -> Values:
        """Certificate figures in other units; provenance names those of its records."""
        times = {"spacing": length, "symbol_min": stress, "symbol_bound": stress}
        times |= dict.fromkeys(GAMMAS, length**-2)
        figures = {
            f"{h * length:g}": {
                name: value * times[name] if name in times and is_number(value) else value
                for name, value in each.items()
            }
            for h, each in self.figures.items()
        }
        provenance = self.provenance | {"units_before": list(self.units)} | self.provenance
        return {"certificate": figures, "provenance": provenance}

    def derived(self) -> Values:
        """Degree and quadrature, which the material's file states."""
        return {"degree": self.degree, "quadrature": {"degree": DEGREE, "singularity": SINGULARITY}}

    def verify_certificates(self) -> None:
        """Raise InputError unless all spacings in `certified_on` are proven again, and all bounds;
        what is of training nodes, which no file has, is a record."""
        figures = self.figures
        for spacing in dict.fromkeys((*self.certified_on, *figures)):
            each, stencil = figures.get(spacing, {}), self.stencil(spacing)
            for name in each.keys() - {"spacing", "symbol_min", "symbol_bound", "statement"}:
                if name not in (*GAMMAS, *INF_SUP):
                    raise InputError(f"certificate: unknown keys: {name}")
                taken(f"certificate: {name}", float | None, each[name])
            if (bound := each.get("symbol_bound")) is not None:
                numbers = bound, each.get("symbol_min", bound)
                proven, least = (taken("certificate", float, number) for number in numbers)
                StencilCertificate(proven, least, 0.0, 0, 0.0).check_of(stencil, self.group)
            if not bound and spacing in self.certified_on and not prove(stencil, self.group).holds:
                raise InputError(f"certified_on: nothing is proven on {spacing:g}")

    def on(
        self,
        points: PointsLike,
        *,
        transfer: bool = True,
        allow_uncertified: bool = False,
        lam: Modulus | None = None,
        mu: Modulus | None = None,
        quadrature_degree: int = DEGREE,
    ) -> LPSOperator:
        """Build the operator on points: transferred there, certified, its bonds when first needed.

        Args:
            points: a lattice or scattered points.
            transfer: False refuses what the model itself holds no certificate for.
            allow_uncertified: take its own numbers, with a warning.
            lam, mu: moduli that differ from node to node, as of `spread`.
            quadrature_degree: as of LPSOperator.

        Raises InputError for an uncertified spacing without a transfer, scattered points without
        allow_uncertified, and as `spread` and LPSOperator.
        """
        model, how = self, {"allow_uncertified": allow_uncertified}
        if self.nodes is None and not self.is_certified_on(points.spacing):
            model = materials.transfer.model_at(
                self, points.spacing, points, transfer=transfer, **how
            )
        if lam is not None or mu is not None:
            model = model.spread(points, lam, mu)
        return LPSOperator(model, points, quadrature_degree=quadrature_degree, **how)

    def summary(self) -> Values:
        """Constants, lattices and errors of the model as plain values."""
        names = "mu E nu alpha degree horizon errors versions units trained_on certified_on"
        found = {"format": "model", "lambda": self.lam}
        return found | {name: getattr(self, name) for name in names.split()}

    def rows(self) -> Rows:
        """Name and value of each line of the model's summary table."""
        unit, shown = symbols(self.units)[0], partial(shown_moduli, self.units)
        proven, told = (self.certified_on, self.statements) if self.stands else ((), {})
        if self.nodes is None:
            moduli = {
                "λ, μ": shown((self.lam, self.mu)),
                "E, ν": f"{shown((self.E,))}, {self.nu:.3g}",
            }
        else:
            pairs = {"λ": self.lam, "μ": self.mu}.items()
            moduli = {f"{n}, least and largest": shown((np.min(x), np.max(x))) for n, x in pairs}
        return [
            *moduli.items(),
            ("horizon", f"{self.horizon:g} {unit}"),
            ("K", f"degree {self.degree}, α = {self.alpha:.3g}"),
            ("certified on", ", ".join(f"{h:g} {unit}" for h in proven) or "no lattice"),
            *(("proven", each) for each in told.values()),
            *error_rows(self.errors),
        ]


def weighted_volume(classes: BondClasses, kw: ndarray, name: str = "influence function") -> Any:
    """Weighted volume m = Σ n r² K W on a lattice (theory, 5); InputError where it is zero."""
    terms = classes.count * kw * classes.r**2
    if not abs(terms.sum()) > CANCELLED * np.abs(terms).sum():
        raise InputError(
            f"{name}: its weighted volume m (theory, 5) is zero on the lattice of spacing "
            f"{classes.spacing:g}: positive and negative parts cancel"
        )
    return terms.sum()


def stiffnesses(model: LPSMaterial, classes: BondClasses) -> tuple[ndarray, float]:
    """Stiffnesses v [TPa/Å²] of the bond classes and κ = (λ−μ)/μ² [1/TPa] of a model on a lattice.
    Raises InputError for an influence function of zero weighted volume, and another dimension."""
    if model.nodes is not None:
        raise InputError("lambda, mu: expected numbers, got fields, which have no stencil or proof")
    if classes.steps.shape[1] != model.dimension:
        raise InputError(
            f"model: expected one of {classes.steps.shape[1]} dimensions, those of the lattice, "
            f"got {model.dimension}; in space crystal_from_lps(model, spacing) is proven"
        )
    r = classes.r * (model.certified_spacing_near(classes.spacing) / classes.spacing)
    mu, kw = model.mu, model.influence(r) * classes.weight
    return mu * kw / weighted_volume(classes, kw), (model.lam - mu) / mu / mu  # mu² may be 0


def stencil_of(classes: BondClasses, v: ndarray, kappa: float) -> Stencil:
    """Make a stencil of class stiffnesses; products of dilatations make bonds of range 2δ."""
    d = classes.steps.shape[1]
    reach = np.abs(classes.steps).max()
    near, of, xi = tuple((classes.steps + reach).T), classes.bond_class, classes.xi
    C = np.zeros((d * (2 * reach + 1,)) + (d, d))
    each = 2 * d * (d + 2) * v[of] / (xi**2).sum(axis=1)
    C[near] = each[:, None, None] * (xi[:, :, None] * xi[:, None])
    if kappa:  # φ is odd: minus φ φᵗ of the symbol (18) is a convolution of its stencil with itself
        phi = np.zeros((*C.shape[:d], d))
        phi[near] = d * v[of, None] * xi
        C = np.pad(C, d * [(reach, reach)] + 2 * [(0, 0)])
        for step, other in zip(classes.steps + reach, d * kappa * v[of, None] * xi):
            C[tuple(slice(n, n + len(phi)) for n in step)] += other[:, None] * phi[..., None, :]
    return stencil_in_box(classes.spacing, symmetric_part(C), NOTHING)


def moduli(model: LPSMaterial, classes: BondClasses) -> dict[str, float]:
    """Long-wave moduli C11, C12, C44 [TPa] of a model's discrete operator (theory, 22)."""
    C = stencil_of(classes, *stiffnesses(model, classes)).elastic
    return {"C11": C[0, 0, 0, 0], "C12": C[0, 0, 1, 1], "C44": C[0, 1, 0, 1]}
