"""A hyperelastic solid: a dictionary of bond and strain energies, linear in its coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from warp_peri.contract import taken
from warp_peri.core.record import Entry, Length, Record
from warp_peri.errors import InputError
from warp_peri.points.unit_names import USUAL, Units, shown_moduli, symbols

if TYPE_CHECKING:  # the operator stands above its numbers
    from warp_peri.points.samples import PointsLike, Samples
    from warp_peri.tissue.energy_fit import EnergyFit
    from warp_peri.tissue.from_displacement import DisplacementFit
    from warp_peri.tissue.placed import PlacedSheet

BONDS = {"square": 0, "cube": 1, "tension": 2, "tension_cube": 3, "log": 4, "compression": 5}
"""Bond energies ψ(s) by number: s²/2, s³/3, ⟨s⟩²/2, ⟨s⟩³/3, s − ½ ln(1 + 2s), ⟨−s⟩²/2."""

QUADRATICS = ("11,11", "22,22", "12,12", "11,22", "11,12", "22,12")
KINDS = {
    **{f"quadratic {pair}": n for n, pair in enumerate(QUADRATICS)},
    "log_area": 6,
    "area": 7,
    "inverse_area": 8,
    "neo_hookean": 9,
    "volumetric": 10,
    "plane_stress": 11,
    "fibre_power": 12,
    "fibre_exponential": 13,
    "trace": 14,
    "shear": 15,
    "along": 16,
    "mooney": 17,
    "yeoh": 18,
}
"""Strain energies Φ(E) by number; docs/theory lists them in (H5)."""
NAMED = {number: kind for kind, number in KINDS.items()}
FIBRES = ("fibre_power", "fibre_exponential")
STEPPING = ("trace", "shear", "along", *FIBRES)
"""Kinds that may act across a bond, (H17): those convex everywhere."""
ACROSS = ((0, 1), (1, 0), (1, -1), (1, 1))
"""Near bonds, in the order of a half family."""
GUARANTEED = {
    "neo_hookean",
    "volumetric",
    "plane_stress",
    "mooney",
    "yeoh",
    *FIBRES,
    "trace",
    "shear",
    "along",
    "quadratic 11,11",
    "quadratic 22,22",
    "quadratic 12,12",
}
"""Kinds that are convex near rest and stress-free there: a positive coefficient is safe."""
MOST_SHOWN = 8
"""Energies that a solid shows of itself."""
POSITIVE_BONDS = {"square", "tension", "tension_cube", "log", "compression"}


@dataclass(frozen=True)
class Term:
    """One strain energy of the dictionary, (H5).

    Attributes:
        kind: a key of KINDS.
        angle: direction n of a fibre [rad], where the kind has one.
        exponent: p of a fibre's power or of Yeoh's, k₂ of a fibre's exponential.
        ripple: acts on the difference of the two nodal strains, (H4), instead of on the strain.
        across: a near bond in lattice steps; the term is then the energy of the step of the short
            strain between its ends, (H17). Convex kinds only.
        corner: acts on the strains of the four corners of lattice cells at a node, (H19).

    Raises InputError for an unknown kind, an exponent that the kind cannot take, or a difference
    that it cannot act on.
    """

    kind: str
    angle: float = 0.0
    exponent: float = 0.0
    ripple: bool = False
    across: tuple[int, int] | None = None
    corner: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")
        if not (np.isfinite(self.angle) and np.isfinite(self.exponent)):
            raise InputError(f"{self.kind}: expected finite angle and exponent")
        for name in ("ripple", "corner"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{name}: expected true or false, got {getattr(self, name)!r}")
        if self.kind in ("fibre_power", "yeoh") and self.exponent < 2:
            raise InputError(f"{self.kind}: expected an exponent ≥ 2, got {self.exponent}")
        if self.kind == "fibre_exponential" and self.exponent < 0:
            raise InputError(f"fibre_exponential: expected k2 ≥ 0, got {self.exponent}")
        if self.corner and (self.ripple or self.across is not None):
            raise InputError(f"corner: expected neither ripple nor across, got {self.label}")
        if self.across is not None:
            object.__setattr__(self, "across", tuple(self.across))
            if self.across not in ACROSS or self.kind not in STEPPING or self.ripple:
                raise InputError(
                    f"across: expected {', '.join(STEPPING)} across one of {ACROSS}, "
                    f"got {self.kind} across {self.across}"
                )

    @property
    def is_fibre(self) -> bool:
        """Whether it is the energy of a family of fibres, and not of their steps or ripples."""
        return self.kind in FIBRES and self.across is None and not self.ripple

    @property
    def label(self) -> str:
        """Its name in tables."""
        words = self.kind + (" of the ripple" if self.ripple else "")
        words += f" across {self.across}" if self.across else ""
        words += " of corners" if self.corner else ""
        if self.kind in (*FIBRES, "along"):
            words += f" at {np.rad2deg(self.angle):.1f}°"
        return words + (f", {self.exponent:g}" if self.kind in (*FIBRES, "yeoh") else "")


@dataclass(frozen=True)
class Dictionary:
    """What energies a material may be made of, (H1); every coefficient has a place in one vector.

    Attributes:
        reach: horizon δ in spacings, at least 2.
        bonds: energies of every bond class, keys of BONDS.
        deviations: bond vectors in lattice steps whose deviation from the nodal strain is
            penalised, (H6).
        terms: strain energies.

    The coefficients stand in this order: bond classes by length with their energies, deviations,
    terms. Raises InputError for an unknown bond energy or a bond that is out of reach.
    """

    reach: float = 3.0
    bonds: tuple[str, ...] = ()
    deviations: tuple[tuple[int, int], ...] = ()
    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        for name in self.bonds:
            if name not in BONDS:
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
        return self.classes * len(self.bonds) + len(self.deviations) + len(self.terms)

    @property
    def classes(self) -> int:
        """Number of bond classes: bonds ξ and −ξ are one."""
        return len(half_family(self.reach))

    @property
    def first_deviation(self) -> int:
        """Place of the first deviation in the vector of coefficients."""
        return self.classes * len(self.bonds)

    @property
    def first_term(self) -> int:
        """Place of the first strain energy in the vector of coefficients."""
        return self.first_deviation + len(self.deviations)

    @property
    def labels(self) -> list[str]:
        """A name for every coefficient."""
        half = half_family(self.reach).tolist()
        names = [f"bond {tuple(step)}, {name}" for step in half for name in self.bonds]
        names += [f"deviation {tuple(step)}" for step in self.deviations]
        return names + [term.label for term in self.terms]

    @property
    def cornered(self) -> bool:
        """Whether a strain energy acts on corners."""
        return any(term.corner for term in self.terms)

    @property
    def guaranteed(self) -> bool:
        """Whether non-negative coefficients make a material that is stable at rest, (H9)."""
        return set(self.bonds) <= POSITIVE_BONDS and all(
            term.kind in GUARANTEED for term in self.terms
        )

    def learn(self, samples: Samples, **options: Any) -> EnergyFit | DisplacementFit:
        """A solid of these energies: from loads by fit_energy, without loads by fit_displacement.

        `options` are those of the two functions, and the errors theirs. Loads need no progress.
        """
        from warp_peri.tissue.energy_fit import fit_energy
        from warp_peri.tissue.from_displacement import fit_displacement

        learned = fit_energy if samples.b is not None else fit_displacement
        if learned is fit_energy:
            options.pop("progress", None)
        (options,) = taken(options, "fit", learned)
        return learned(samples, self, **options)

    def with_terms(self, terms: Sequence[Term]) -> Dictionary:
        """The same bonds with other strain energies."""
        return replace(self, terms=tuple(terms))


@dataclass(frozen=True, eq=False, repr=False)
class HyperelasticSolid(Record, format="warp_peri.hyperelastic"):
    """A dictionary with its coefficients.

    Attributes:
        dictionary: the energies.
        coefficients: one for each [stress], shape [K].
        spacing: of the lattice it was learned on [length]; others take the same coefficients.
        stretch: largest nodal stretch of the data it was learned from, if known.
        provenance: of data and fit; `stresses` says where they are scaled, in no unit.
        units: names of the units of length and stress that it is in, those of its data.

    Raises InputError for coefficients of another number or not finite, and units not known.
    """

    dictionary: Annotated[Dictionary, Entry(flat=True)]
    coefficients: Annotated[np.ndarray, Entry(stress=1)]
    spacing: Length
    stretch: float | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    units: Units = USUAL
    dimension: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.coefficients.shape != (len(self.dictionary),):
            raise InputError(
                f"coefficients: expected {len(self.dictionary)} numbers, "
                f"got shape {list(self.coefficients.shape)}"
            )

    @property
    def sparse(self) -> HyperelasticSolid:
        """The same solid without the strain energies whose coefficient is zero."""
        first = self.dictionary.first_term
        kept = [n for n, c in enumerate(self.coefficients[first:]) if c != 0]
        terms = tuple(self.dictionary.terms[n] for n in kept)
        values = np.concatenate([self.coefficients[:first], self.coefficients[first:][kept]])
        return replace(self, dictionary=self.dictionary.with_terms(terms), coefficients=values)

    def on(self, points: PointsLike, *, thickness: np.ndarray | None = None) -> PlacedSheet:
        """The solid on a lattice, of an even sheet or with a thickness of every node [N] (H18)."""
        from warp_peri.tissue.placed import PlacedSheet

        return PlacedSheet(self, points, thickness=thickness)

    def elsewhere(self, length: float, stress: float) -> dict[str, Any]:
        """The provenance names the units that its records stay in."""
        return {"provenance": {**self.provenance, "units_before": list(self.units)}}

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, energies by the size of their coefficients."""
        length = symbols(self.units)[0]
        stretch = "not known" if self.stretch is None else f"up to {self.stretch:.3g}"
        rows = [("learned on", f"{self.spacing:g} {length}"), ("stretch of the data", stretch)]
        rows.append(("energies", f"{len(self.dictionary)}"))
        order = np.argsort(-np.abs(self.coefficients))[:MOST_SHOWN]
        labels, values = self.dictionary.labels, self.coefficients
        scaled = self.provenance.get("stresses")  # where no force says what they are in
        rows += [("stresses", str(scaled))] if scaled else []
        rows += [
            (labels[n], f"{values[n]:.4g}" if scaled else shown_moduli(self.units, (values[n],)))
            for n in order
            if values[n]
        ]
        return rows

    @property
    def horizon(self) -> float:
        """δ on the lattice it was learned on [length]."""
        return self.dictionary.reach * self.spacing


@cache
def half_family(reach: float) -> np.ndarray:
    """One bond of each pair ±ξ in lattice steps, by length, shape [C, 2]; read only."""
    size = int(np.floor(reach + 1e-9))
    a, b = np.meshgrid(*2 * [np.arange(-size, size + 1)], indexing="ij")
    steps = np.stack([a.ravel(), b.ravel()], axis=1)
    square = (steps**2).sum(axis=1)
    upper = (steps[:, 0] > 0) | ((steps[:, 0] == 0) & (steps[:, 1] > 0))
    kept = steps[upper & (square <= reach**2 + 1e-9)]
    order = np.lexsort((kept[:, 1], kept[:, 0], (kept**2).sum(axis=1)))
    family: np.ndarray = kept[order]
    family.flags.writeable = False
    return family


def strain_weights(reach: float, order: int, *, locality: float = 16.0) -> np.ndarray:
    """Weights w of the nodal Green strain (H3) on a lattice of spacing one, shape [C, 3].

    Least Σ w² |ξ|^(4 + locality) among those exact for the second moments, and with vanishing
    fourth moments for order 4. Columns: E11, E22, 2 E12.

    Raises InputError where the family is too small for the order.
    """
    x, y = half_family(reach).T.astype(float)
    powers = [(2, 0), (0, 2), (1, 1)]
    if order == 4:
        powers += [(n, 4 - n) for n in range(5)]
    moments = np.array([2 * x**a * y**b for a, b in powers])
    target = np.eye(len(powers))[:, :3]
    scale = (x**2 + y**2) ** (-(4 + locality) / 4)
    scaled, *_ = np.linalg.lstsq(moments * scale, target, rcond=1e-10)
    weights: np.ndarray = scale[:, None] * scaled
    if np.abs(moments @ weights - target).max() > 1e-8:
        raise InputError(f"reach: {reach} spacings carry no strain of order {order}")
    return weights
