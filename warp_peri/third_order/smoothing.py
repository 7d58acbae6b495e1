"""Bond weights that undo, or redo, the smoothing of the data (theory, N6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import j0

from warp_peri.core.record import Length
from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number, is_positive
from warp_peri.points.families import BondClasses

GRID = 41
"""Wave vectors along each axis of the square that weights are fitted on."""
HELD = 1e4
"""Weight of Σ n r² p = 1 beside relative errors of the symbol."""
CORE = 3.3
"""Components of wave vectors times R up to which smoothing leaves enough to fit an exact answer."""
SIZE = 1e-6
"""Weight of the size of p beside relative errors."""


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
    ridge: float = 0.1

    def __post_init__(self) -> None:
        if not is_positive(self.radius):
            raise InputError(f"radius: expected a length > 0, got {self.radius!r}")
        if not (is_number(self.ridge) and 0 <= self.ridge < np.inf):
            raise InputError(f"ridge: expected a number ≥ 0, got {self.ridge!r}")

    def transform(self, k: np.ndarray) -> np.ndarray:
        """ω̂(|k|) of the cone of unit integral, at wave numbers k [1/Å]."""
        node, weight = np.polynomial.legendre.leggauss(200)
        r = (node + 1) * self.radius / 2
        part = weight * (self.radius - r) * r
        transform: np.ndarray = (j0(np.multiply.outer(k, r)) @ part) / part.sum()
        return transform

    def inverse(self, k: np.ndarray) -> np.ndarray:
        """The Wiener inverse (1 + ρ) ω̂/(ω̂² + ρ)."""
        smooth = self.transform(k)
        return (1 + self.ridge) * smooth / (smooth**2 + self.ridge)

    def root(self, k: np.ndarray) -> np.ndarray:
        """√((1 + ρ) ω̂²/(ω̂² + ρ)), what the inverse and the transform make together (N23)."""
        square = self.transform(k) ** 2
        return np.asarray(np.sqrt((1 + self.ridge) * square / (square + self.ridge)))

    def weights(self, classes: BondClasses) -> tuple[np.ndarray, np.ndarray]:
        """p_in and p_out of the bond classes of a lattice [1/Å²], each of shape [C].

        Σ n r² p = 1, and 2 Σ p sin(k·ξ) ξ fits k times the inverse, or the transform, of the
        smoothing by least squares: the Wiener inverse over all waves that the lattice has,
        |k_a| ≤ π/h, the exact inverse and the transform over |k_a| ≤ CORE / R. Errors count as
        those of the gradient under a unit load, which displaces by 1/|k|², and wave numbers alike,
        which is |k|^(−5/2) in all. Of such powers it has the least residual on training loads that
        were held out.
        """
        zone = np.pi / classes.spacing
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
    scaled: np.ndarray = p / (sigma @ p)
    return scaled


def gradient_weights(
    smoothing: Smoothing, form: str, classes: BondClasses
) -> tuple[np.ndarray, np.ndarray]:
    """p_in and p_out by class [1/length²]: of the filtered form (N6), of the energy form (N23)."""
    if form == "filtered":
        return smoothing.weights(classes)
    own = fitted_weights(classes, smoothing.root, np.pi / classes.spacing)
    return own, own
