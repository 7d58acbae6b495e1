"""A dressed solid as what may be learned from fields."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from warp_peri.core.groups import Symmetry
from warp_peri.dressed.law import DressedSolid
from warp_peri.dressed.learning import REACH, fit
from warp_peri.errors import InputError
from warp_peri.micromodulus.laws import one_set
from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples


@dataclass(frozen=True)
class DressedFit:
    """A learned dressed solid.

    Attributes:
        material: with its certificate.
        history: losses ‖L u − b‖/‖b‖ with G and of the base alone, numbers, steps.
    """

    material: DressedSolid
    history: dict[str, Any]

    @property
    def certificate(self) -> Any:
        """What is proven of the symbol."""
        return self.material.certificate


@dataclass(frozen=True)
class Dressed:
    """L = Gᵗ K G: a positive base, its short waves lifted to the atoms' by G (theory.md, D).

    Attributes:
        base: "elements" (multilinear, any elastic tensor), or "bonds" (isotropic sheets, 1/r on
            eight bonds, which may break).
        neighbours: of G: 4, 8, 12 or 20 in the plane, 6, 18 or 26 in space.
        symmetry: name of the crystal's point group, or rotations.
        orientation: the crystal's axes in the coordinates of the points, as columns, or degrees;
            the points' own axis by default.
        moduli: "long waves" holds those that the longest waves of the fields have, a Voigt matrix
            (crystal's axes) [stress] its own; of isotropic sheets at a percent of strain or more
            the Smoothing of the data finds better ones (D20). They are never learned with G: left
            free they drift.
        split: a G for each part of the base (bulk, shear, …) in place of one.
        two_functions: learn an influence function of the dilatation too, one number more; of a base
            of bonds and one G. It keeps what is proven (D26).
    """

    base: str = "elements"
    neighbours: int = 8
    symmetry: Symmetry = "isotropic"
    orientation: Any = None
    moduli: Any = "long waves"
    split: bool = False
    two_functions: bool = False

    def poorer(self) -> Dressed:
        """The same law with the next smaller G; InputError where there is none."""
        known = next((known for known in REACH.values() if self.neighbours in known), {})
        fewer = [n for n in known if n < self.neighbours]
        if not fewer:
            raise InputError(f"neighbours: expected more than the fewest, got {self.neighbours}")
        return replace(self, neighbours=max(fewer))

    def learn(self, samples: Samples | Dataset, *, progress: bool | None = None) -> DressedFit:
        """The fit; errors as of learning.fit. It takes a few steps, with no progress to show."""
        sets = one_set(samples)
        options = vars(self) | {
            "orientation": sets.axis if self.orientation is None else self.orientation
        }
        material = fit(sets, options.pop("base"), options.pop("neighbours"), **options)
        return DressedFit(material, dict(material.provenance["fit"]))
