"""A crystal's law as what may be learned from fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warp_peri.micromodulus.groups import Symmetry
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.learning import fit
from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples


@dataclass(frozen=True)
class CrystalFit:
    """A learned crystal.

    Attributes:
        material: with its certificate.
        history: loss, symmetry found, cuts and numbers.
    """

    material: Crystal
    history: dict[str, Any]

    @property
    def certificate(self) -> Any:
        """What is proven of the symbol."""
        return self.material.certificate


@dataclass(frozen=True)
class Micromodulus:
    """A tensor C(ξ) for every bond, of any crystal in the plane or in space (theory.md, T).

    Attributes:
        horizon: length of the longest bond.
        symmetry: name of the crystal's point group, rotations, or "auto": the largest group with
            which the fit is as good as without one.
        orientation: the crystal's axes in the coordinates of the points, as columns, or degrees;
            the points' own axis by default.
        moduli: "long waves" holds those that a fit of long waves finds, None holds none, a Voigt
            matrix (crystal's axes) holds its own.
        normalise: weigh each sample by 1/‖b‖.
    """

    horizon: float
    symmetry: Symmetry = "auto"
    orientation: Any = None
    moduli: Any = "long waves"
    normalise: bool = False

    def learn(self, samples: Samples | Dataset) -> CrystalFit:
        """The fit; errors as of learning.fit."""
        sets = samples.obvious("train") if isinstance(samples, Dataset) else samples
        stated = sets.axis if self.orientation is None else self.orientation
        material = fit(sets, **(vars(self) | {"orientation": stated}))
        return CrystalFit(material, dict(material.provenance["fit"]))
