"""A crystal's law as what may be learned from fields."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warp_peri.core.groups import Symmetry
from warp_peri.errors import InputError
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.learning import fit
from warp_peri.models.smoothing import Smoothing
from warp_peri.points.dataset import Dataset
from warp_peri.points.samples import Samples

if TYPE_CHECKING:
    from warp_peri.micromodulus.third_order_learning import ThirdOrderFit


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

    def third_order(
        self, samples: Samples | Dataset, smoothing: Smoothing | None, form: str
    ) -> ThirdOrderFit:
        """Tensors and third-order constants at once; errors as of fit_third_order.

        "auto" is "isotropic" here. A UserWarning says where training data reach beyond the proven
        strain.
        """
        from warp_peri.micromodulus.third_order_learning import fit_third_order

        if not isinstance(smoothing, Smoothing):
            raise InputError(
                f"smoothing: expected Smoothing(…) beside such tensors, got {smoothing!r:.60}"
            )
        if self.moduli is None:
            raise InputError("moduli: expected some that are held, beside third-order constants")
        auto = isinstance(self.symmetry, str) and self.symmetry == "auto"
        found = fit_third_order(
            one_set(samples),
            self.horizon,
            smoothing,
            form=form,
            symmetry="isotropic" if auto else self.symmetry,
            orientation=self.orientation,
            moduli=self.moduli,
        )
        proven = found.material.proven_strain(found.material.spacing)
        if found.largest_gradient > proven:
            warnings.warn(
                f"strain: solutions are proven unique up to |H| = {proven:.2%}, the training data "
                f"reach {found.largest_gradient:.2%}; a larger ridge of the smoothing than "
                f"{smoothing.ridge:g} may prove more",
                stacklevel=5,
            )
        return found


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
