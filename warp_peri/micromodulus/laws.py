"""A crystal's law as what may be learned from fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warp_peri.core.groups import Symmetry
from warp_peri.errors import InputError
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

    def learn(self, samples: Samples | Dataset, *, progress: bool | None = None) -> CrystalFit:
        """The fit; errors as of learning.fit. It is one least squares, with no progress to show."""
        sets = one_set(samples)
        stated = sets.axis if self.orientation is None else self.orientation
        material = fit(sets, **(vars(self) | {"orientation": stated}))
        return CrystalFit(material, dict(material.provenance["fit"]))


def one_set(samples: Any) -> Samples:
    """The samples of one set; of a Dataset `train`, or its only set."""
    if isinstance(samples, (list, tuple)) and len(samples) != 1:
        raise InputError(f"samples: expected one set for micromodulus tensors, got {len(samples)}")
    given = samples[0] if isinstance(samples, (list, tuple)) else samples
    if isinstance(given, Dataset):
        return given.obvious("train")
    if not isinstance(given, Samples):
        raise InputError(f"samples: expected Samples, got {type(given).__name__}")
    return given
