"""Hyperelastic energies: a dictionary of bond and strain energies, linear in its coefficients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from warp_peri.core.stencil import half_ball
from warp_peri.errors import InputError
from warp_peri.materials import hyperelastic
from warp_peri.points.arguments import typed
from warp_peri.protocols import taken

if TYPE_CHECKING:
    from warp_peri.points.points import Samples

half_family = cache(partial(half_ball, dimension=2))
"""One bond of each pair ±ξ in lattice steps, by length, of a reach in spacings, shape [C, 2]."""


class Strain:
    """Green strains E [3, ...] (E11, E22, 2 E12) and the invariants that energies are made of."""

    def __init__(self, E: torch.Tensor) -> None:
        self.parts = E.unbind(0)

    @cached_property
    def area(self) -> torch.Tensor:
        """Squared area ratio D = det C, C = 1 + 2 E."""
        x, y, shear = self.parts
        return (1 + 2 * x) * (1 + 2 * y) - shear**2

    @property
    def log_area(self) -> torch.Tensor:
        """Logarithm of the squared area ratio, ln D."""
        return torch.log(self.area)

    @property
    def trace(self) -> torch.Tensor:
        """First invariant tr C, less 2."""
        return 2 * (self.parts[0] + self.parts[1])

    def along(self, angle: Any) -> torch.Tensor:
        """Squared stretch of a fibre less one, I4 − 1 = 2 n·E n."""
        c, s = (f(torch.as_tensor(angle, dtype=torch.float64)) for f in (torch.cos, torch.sin))
        x, y, shear = self.parts
        return 2 * c * c * x + 2 * s * s * y + 2 * c * s * shear

    def taut(self, angle: Any, energy: Callable[..., torch.Tensor]) -> torch.Tensor:
        """An energy of I4 − 1 where that is above zero, else zero with all its derivatives."""
        x = self.along(angle)
        return torch.where(x > 0, energy(torch.where(x > 0, x, 1.0)), 0.0)


def _exponential(x: torch.Tensor, k2: Any) -> torch.Tensor:
    """(exp(k2 x²) − 1) / (2 k2), or its limit."""
    y = x * x
    large: torch.Tensor = torch.expm1(k2 * y) / (2 * k2 or 1)
    return large if k2 > LEAST_EXPONENT else y / 2 + k2 * y * y / 4


Density = Callable[..., torch.Tensor]
"""Energy of a strain, or of a bond's, and of a fibre's angle and exponent."""


def _quadratic(pair: str) -> Density:
    a, b = map(["11", "22", "12"].index, pair.split(","))
    return lambda E, *_: E.parts[a] * E.parts[b]


LEAST_EXPONENT = 1e-8
"""k2 below which the exponential is taken as its limit."""
QUADRATICS = ("11,11", "22,22", "12,12", "11,22", "11,12", "22,12")
"""Products of E11, E22 and 2 E12 that are energies."""
BONDS: dict[str, Density] = {
    "square": lambda s, *_: s**2 / 2,
    "cube": lambda s, *_: s**3 / 3,
    "tension": lambda s, *_: torch.relu(s) ** 2 / 2,
    "tension_cube": lambda s, *_: torch.relu(s) ** 3 / 3,
    "log": lambda s, *_: s - torch.log1p(2 * s) / 2,
    "compression": lambda s, *_: torch.relu(-s) ** 2 / 2,
}
"""Bond energies ψ(s), (H2)."""
KINDS: dict[str, Density] = {
    **{f"quadratic {pair}": _quadratic(pair) for pair in QUADRATICS},
    "log_area": lambda E, *_: E.log_area,
    "area": lambda E, *_: E.area,
    "inverse_area": lambda E, *_: 1 / E.area,
    "neo_hookean": lambda E, *_: E.trace - E.log_area,
    "volumetric": lambda E, *_: (E.area - 1 - E.log_area) / 2,
    "plane_stress": lambda E, *_: E.trace + 1 / E.area - 1,
    "fibre_power": lambda E, angle, p: E.taut(angle, lambda x: x**p / p),
    "fibre_exponential": lambda E, angle, p: E.taut(angle, lambda x: _exponential(x, p)),
    "trace": lambda E, *_: E.trace**2 / 8,
    "shear": lambda E, *_: ((E.parts[0] - E.parts[1]) ** 2 + E.parts[2] ** 2) / 2,
    "along": lambda E, angle, _: E.along(angle) ** 2 / 2,
    "mooney": lambda E, *_: E.area + (E.trace + 2) / E.area - 3,
    "yeoh": lambda E, _, p: torch.relu(E.trace + 1 / E.area - 1) ** p,
}
"""Strain energies Φ; docs/theory lists them in (H5)."""


def deviation(ends: tuple[torch.Tensor, torch.Tensor], *_: Any) -> torch.Tensor:
    """Deviation energy ½ d² / (1 + 2 m), (H6), from 2 s of a bond and 2 m."""
    own, mean = ends
    return (torch.log1p(own) - torch.log1p(mean)) ** 2 / (8 * (1 + mean))


def read(q: torch.Tensor) -> Any:
    """The arguments of energies in q [Q, ...]: a bond's strain, that and its mean, or a strain."""
    return Strain(q) if len(q) == 3 else q.unbind(0) if len(q) == 2 else q[0]


FIBRES = ("fibre_power", "fibre_exponential")
UNSAFE = {"log_area", "area", "inverse_area", *(f"quadratic {pair}" for pair in QUADRATICS[3:])}
"""Kinds that are not convex near rest, or not stress-free there."""


class Energy(NamedTuple):
    """One energy of a dictionary: what it `sees` ("bond" and class, "deviation" and step, "strain"
    or "corner"), and its coefficient's `number`."""

    sees: tuple[Any, ...]
    label: str
    density: Density
    angle: Any = 0.0
    exponent: Any = 0.0
    is_fibre: bool = False
    number: int = 0
    coefficient: Any = 1.0


@typed
@dataclass(frozen=True)
class EnergyTerm:
    """One strain energy of the dictionary, (H5).

    Attributes:
        kind: a key of KINDS.
        angle: direction n of a fibre [rad], where the kind has one.
        exponent: p of a fibre's power or of Yeoh's, k₂ of a fibre's exponential.
        corner: acts on the strains of the four corners of lattice cells at a node, (H19).

    Raises InputError for an unknown kind, or an exponent that the kind cannot take.
    """

    kind: str
    angle: float = 0.0
    exponent: float = 0.0
    corner: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if self.kind in ("fibre_power", "yeoh") and self.exponent < 2:
            raise InputError(f"{self.kind}: expected an exponent ≥ 2, got {self.exponent}")
        if self.kind == "fibre_exponential" and self.exponent < 0:
            raise InputError(f"fibre_exponential: expected k2 ≥ 0, got {self.exponent}")

    @property
    def is_fibre(self) -> bool:
        """Whether the term is the energy of a family of fibres."""
        return self.kind in FIBRES

    @property
    def label(self) -> str:
        """The term's name in tables."""
        words = self.kind + (" of corners" if self.corner else "")
        if self.kind in (*FIBRES, "along"):
            words += f" at {np.rad2deg(self.angle):.1f}°"
        return words + (f", {self.exponent:g}" if self.kind in (*FIBRES, "yeoh") else "")


@typed
@dataclass(frozen=True)
class Hyperelastic:
    """A dictionary of energies that a hyperelastic material may be made of, (H1).

    Attributes:
        reach: horizon δ in spacings, at least 2.
        bonds: energies of every bond class, keys of BONDS.
        deviations: bond vectors in lattice steps whose deviation from the nodal strain is
            penalised, (H6).
        terms: strain energies.

    The coefficients are one vector: bond classes by length with their energies, deviations, terms.
    Raises InputError for an unknown bond energy or a bond that is out of reach.
    """

    reach: float = 3.0
    bonds: tuple[str, ...] = ()
    deviations: tuple[tuple[int, int], ...] = ()
    terms: tuple[EnergyTerm, ...] = ()

    def __post_init__(self) -> None:
        for name in self.bonds:
            if name not in [*BONDS]:
                raise InputError(f"bonds: expected some of {', '.join(BONDS)}, got {name!r}")
        if not 2 <= self.reach <= 10:
            raise InputError(f"reach: expected 2 to 10 spacings, got {self.reach}")
        known = set(map(tuple, half_family(self.reach).tolist()))
        for step in self.deviations:
            if tuple(step) not in known or max(map(abs, step)) > 2:
                raise InputError(f"deviations: expected bonds of a half family, got {step}")
        if not len(self):
            raise InputError("dictionary: expected at least one energy, got none")

    def __len__(self) -> int:
        """Number of coefficients."""
        return self.first_term + len(self.terms)

    @property
    def classes(self) -> int:
        """Number of bond classes; bonds ξ and −ξ are one."""
        return len(half_family(self.reach))

    @property
    def first_deviation(self) -> int:
        """Index of the first deviation energy among the coefficients."""
        return self.classes * len(self.bonds)

    @property
    def first_term(self) -> int:
        """Index of the first strain energy among the coefficients."""
        return self.first_deviation + len(self.deviations)

    @property
    def energies(self) -> list[Energy]:
        """The dictionary's energies, one for every coefficient."""
        steps = enumerate(map(tuple, half_family(self.reach).tolist()))
        own = [
            Energy(("bond", k), f"bond {step}, {name}", BONDS[name])
            for k, step in steps
            for name in self.bonds
        ]
        own += [
            Energy(("deviation", *s), f"deviation {tuple(s)}", deviation) for s in self.deviations
        ]
        for t in self.terms:
            sees = ("corner" if t.corner else "strain",)
            own.append(Energy(sees, t.label, KINDS[t.kind], t.angle, t.exponent, t.is_fibre))
        return own

    @property
    def guaranteed(self) -> bool:
        """Whether non-negative coefficients make a material that is stable at rest, (H9)."""
        return "cube" not in self.bonds and not UNSAFE & {term.kind for term in self.terms}

    @property
    def stiffness(self) -> np.ndarray:
        """Trace of each energy's second derivative by the strain at a small stretch, (H14)."""
        small = torch.tensor([1e-6, 1e-6, 0.0], dtype=torch.float64)
        curves = torch.func.jacrev(torch.func.jacrev(self.uniform))(small)
        return np.asarray(curves.diagonal(dim1=1, dim2=2).sum(1))

    def uniform(self, q: torch.Tensor) -> torch.Tensor:
        """Values of the energies, coefficients one, in uniform strains q [3, ...]; [K, ...]."""
        x, y = (half := half_family(self.reach)).T
        units = torch.from_numpy(np.stack([x * x, y * y, x * y]) / (half**2).sum(axis=1)).T
        stretches, none, strain = torch.tensordot(units, q, 1), (0 * q[0], 0 * q[0]), Strain(q)
        seen = {"bond": lambda k: stretches[k], "deviation": lambda *_: none}
        own = ((e, seen.get(e.sees[0], lambda: strain)(*e.sees[1:])) for e in self.energies)
        return torch.stack([e.density(sees, e.angle, e.exponent) for e, sees in own])

    def learn(self, samples: Samples, **options: Any) -> Any:
        """Fit the coefficients by fit_energy where there are loads, else by fit_displacement."""
        if samples.b is None:
            learned: Any = hyperelastic.from_displacement.fit_displacement
        else:
            learned = hyperelastic.energy_fit.fit_energy
            options.pop("progress", None)
        (options,) = taken(options, "fit", learned)
        return learned(samples, self, **options)

    def with_terms(self, terms: Sequence[EnergyTerm]) -> Hyperelastic:
        """The dictionary with the same bonds and other strain energies."""
        return replace(self, terms=tuple(terms))


def strain_weights(reach: float, order: int) -> np.ndarray:
    """Weights w of the nodal strains E11, E22, 2 E12 (H3) on a lattice of spacing one, [C, 3]: of
    least Σ w² |ξ|^20 with exact second and, for order 4, zero fourth moments. Raises InputError
    where the family is too small for the order."""
    x, y = half_family(reach).T.astype(float)
    powers = [(2, 0), (0, 2), (1, 1)]
    if order == 4:
        powers += [(n, 4 - n) for n in range(5)]
    moments = np.array([2 * x**a * y**b for a, b in powers])
    target = np.eye(len(powers))[:, :3]
    scale = (x**2 + y**2) ** -5.0
    scaled, *_ = np.linalg.lstsq(moments * scale, target, rcond=1e-10)
    weights = np.asarray(scale[:, None] * scaled)
    if np.abs(moments @ weights - target).max() > 1e-8:
        raise InputError(f"reach: {reach} spacings carry no strain of order {order}")
    return weights
