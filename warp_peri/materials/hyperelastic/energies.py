"""Hyperelastic energies: a dictionary of densities of what they see, linear in its coefficients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import lstsq

from warp_peri.core.record import FieldUnits
from warp_peri.core.stencil import half_ball
from warp_peri.errors import InputError, hold
from warp_peri.materials import hyperelastic
from warp_peri.points.arguments import checked, taken, typed

if TYPE_CHECKING:
    from warp_peri.points.points import Samples

half_family = cache(partial(half_ball, dimension=2))
"""One bond of each pair ±ξ in lattice steps, by length, of a reach in spacings, shape [C, 2]."""
NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Bonds of cells, whose deviations see the shortest waves."""


class Strain:
    """Green strains q [3, ...] (E11, E22, 2 E12) and the invariants that energies are made of; of a
    bond s alone, [1, ...]; of a deviation 2 s of a bond and 2 m of its ends, [2, ...]."""

    def __init__(self, q: torch.Tensor) -> None:
        self.parts = (q[0], *q.new_zeros(2)) if len(q) == 1 else q.unbind(0)

    @cached_property
    def area(self) -> torch.Tensor:
        """Squared area ratio D = det C, C = 1 + 2 E."""
        x, y, shear = self.parts
        return (1 + 2 * x) * (1 + 2 * y) - shear**2

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
    large = torch.expm1(k2 * y) / (2 * k2 or 1)
    return large if k2 > LEAST_EXPONENT else y / 2 + k2 * y * y / 4


Density = Callable[..., torch.Tensor]
"""Energy of a Strain, and of a fibre's angle and exponent."""
LEAST_EXPONENT = 1e-8
"""k2 below which the exponential is taken as its limit."""
KINDS: dict[str, Density] = {
    "neo_hookean": lambda E, *_: E.trace - torch.log(E.area),
    "volumetric": lambda E, *_: (E.area - 1 - torch.log(E.area)) / 2,
    "plane_stress": lambda E, *_: E.trace + 1 / E.area - 1,
    "fibre_power": lambda E, angle, p: E.taut(angle, lambda x: x**p / p),
    "fibre_exponential": lambda E, angle, p: E.taut(angle, lambda x: _exponential(x, p)),
    "mooney": lambda E, *_: E.area + (E.trace + 2) / E.area - 3,
    "yeoh": lambda E, _, p: torch.relu(E.trace + 1 / E.area - 1) ** p,
}
"""Strain energies Φ (H5), free of stress at rest and convex near it."""
LEAST = {"fibre_power": 2.0, "yeoh": 2.0, "fibre_exponential": 0.0}
"""Smallest exponents of the kinds that have one."""


def deviation(E: Strain, *_: Any) -> torch.Tensor:
    """Deviation energy ½ d² / (1 + 2 m), (H6)."""
    own, mean = E.parts
    return (torch.log1p(own) - torch.log1p(mean)) ** 2 / (8 * (1 + mean))


class Energy(NamedTuple):
    """One energy of a dictionary: what it `sees`, in equal shares ("deviation", "bond" or "corner"
    and step, or "strain"), and its coefficient's `number`."""

    sees: Sequence[tuple[Any, ...]]
    label: str
    density: Density
    angle: Any = 0.0
    exponent: Any = 0.0
    number: int = 0
    coefficient: Any = 1.0

    def share(self, E: Strain) -> Any:
        """Energy of one of its sites."""
        return self.coefficient * self.density(E, self.angle, self.exponent) / len(self.sees)


@typed
@dataclass(frozen=True)
class EnergyTerm:
    """One strain energy of the dictionary, (H5).

    Attributes:
        kind: a key of KINDS.
        angle: direction n of a fibre [rad], where the kind has one.
        exponent: p of a fibre's power or of Yeoh's, k₂ of a fibre's exponential.
        corner: acts on the strains of the four corners of lattice cells at a node, (H19).
        step: of the bonds that the term acts on, their strain s along an angle of zero, (H2); with
            `corner` the sides of two opposite corners, the only ones. In lattice steps.

    Raises InputError for an unknown kind, an angle or exponent that it cannot take, or a corner
    without two sides.
    """

    kind: str
    angle: float = 0.0
    exponent: float = 0.0
    corner: bool = False
    step: Annotated[tuple[int, ...], FieldUnits(omit=True)] = ()

    def __post_init__(self) -> None:
        hold(self, step=tuple(self.step))
        if self.corner and not all(self.step):
            raise InputError(f"step: expected sides of a corner, none of them 0, got {self.step}")
        if self.kind not in KINDS:
            raise InputError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if self.exponent < (least := LEAST.get(self.kind, -np.inf)):
            raise InputError(f"{self.kind}: expected an exponent ≥ {least:g}, got {self.exponent}")
        if (self.angle and not self.is_fibre) or (self.exponent and self.kind not in LEAST):
            raise InputError(f"{self.kind}: expected no angle or exponent that it has not")

    @property
    def is_fibre(self) -> bool:
        """Whether the term is the energy of a family of fibres."""
        return self.kind.startswith("fibre") and self.sees[0][0] != "bond"

    @property
    def sees(self) -> list[tuple[Any, ...]]:
        """What the term acts on, as of an Energy."""
        if self.corner:
            sides = (self.step,) if self.step else NEAREST[2:]
            return [("corner", sign * p, sign * q) for p, q in sides for sign in (1, -1)]
        return [("bond", *self.step) if self.step else ("strain",)]

    @property
    def label(self) -> str:
        """The term's name in tables."""
        words = self.kind + (" of corners" if self.corner else "")
        words += f" {self.step}" if self.step else ""
        if self.is_fibre:
            words += f" at {np.rad2deg(self.angle):.1f}°"
        return words + (f", {self.exponent:g}" if self.kind in LEAST else "")


@typed
@dataclass(frozen=True)
class Hyperelastic:
    """A dictionary of energies that a hyperelastic material may be made of, (H1).

    Attributes:
        reach: horizon δ in spacings, at least 2.
        deviations: bonds in lattice steps whose deviation from the nodal strain is penalised, (H6).
        terms: strain energies.

    The coefficients are one vector: deviations, terms. With non-negative ones the material is
    stable at rest, (H9). Raises InputError for a step that is out of reach.
    """

    reach: float = 3.0
    deviations: tuple[tuple[int, int], ...] = ()
    terms: tuple[EnergyTerm, ...] = ()

    def __post_init__(self) -> None:
        if not 2 <= self.reach <= 10:
            raise InputError(f"reach: expected 2 to 10 spacings, got {self.reach}")
        known = set(map(tuple, half_family(self.reach).tolist()))
        for step in (*self.deviations, *(term.step for term in self.terms if term.step)):
            if tuple(checked("steps", step, int, (2,))) not in known:
                raise InputError(f"steps: expected bonds of a half family, got {step}")
        if not len(self):
            raise InputError("dictionary: expected at least one energy, got none")

    def __len__(self) -> int:
        """Number of coefficients."""
        return self.first_term + len(self.terms)

    @property
    def first_term(self) -> int:
        """Index of the first strain energy among the coefficients."""
        return len(self.deviations)

    @property
    def energies(self) -> list[Energy]:
        """The dictionary's energies, one for every coefficient."""
        own = [
            Energy([("deviation", *s)], f"deviation {tuple(s)}", deviation) for s in self.deviations
        ]
        return own + [
            Energy(t.sees, t.label, KINDS[t.kind], t.angle, t.exponent) for t in self.terms
        ]

    @property
    def stiffness(self) -> ndarray:
        """Trace of each energy's second derivative by the strain at a small stretch, (H14)."""
        small = torch.from_numpy(np.array([1e-6, 1e-6, 0.0]))
        curves = torch.func.jacrev(torch.func.jacrev(self.uniform))(small)
        return np.asarray(curves.diagonal(dim1=1, dim2=2).sum(1))

    def uniform(self, q: torch.Tensor) -> torch.Tensor:
        """Values of the energies, coefficients one, in uniform strains q [3, ...]; [K, ...]."""
        E = Strain(q)

        def seen(kind: str, x: int = 0, y: int = 0) -> Strain:
            if kind == "bond":
                return Strain(E.along(np.arctan2(y, x))[None] / 2)
            return Strain(0 * q[:2]) if kind == "deviation" else E

        return torch.stack([sum(e.share(seen(*of)) for of in e.sees) for e in self.energies])

    def learn(self, samples: Samples, **options: Any) -> Any:
        """Fit the coefficients; see fit_sheet."""
        (options,) = taken(options, "fit", learned := hyperelastic.sheet_fit.fit_sheet)
        return learned(samples, self, **options)

    def with_terms(self, terms: Sequence[EnergyTerm]) -> Hyperelastic:
        """The dictionary with the same bonds and other strain energies."""
        return replace(self, terms=tuple(terms))


def strain_weights(reach: float, order: int) -> ndarray:
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
    scaled, *_ = lstsq(moments * scale, target, rcond=1e-10)
    weights: ndarray = scale[:, None] * scaled
    if np.abs(moments @ weights - target).max() > 1e-8:
        raise InputError(f"reach: {reach} spacings carry no strain of order {order}")
    return weights
