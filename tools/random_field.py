"""Smooth random vector fields: Gaussian, with a spectrum that falls like a power."""

import numpy as np


class RandomField:
    """Σ ξ (π²(k² + l²)/L² + τ²)^(−α/2) cos(π k x/L) cos(π l y/L), scaled to a root mean square.

    Args:
        rng: of the normal ξ.
        amplitude: expected root mean square of each component.
        waves: largest k and l.
        side: L of the square.
        first: its lower corner, along both axes.
        vanishing: sines instead of cosines: the field is zero on the edge.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        amplitude: float,
        *,
        waves: int = 12,
        side: float = 1.0,
        first: float = 0.0,
        vanishing: bool = False,
    ) -> None:
        self.k = np.arange(1 if vanishing else 0, waves + 1)
        self.side, self.first, self.vanishing = side, first, vanishing
        k, m = np.meshgrid(self.k, self.k, indexing="ij")
        spectrum = (np.pi**2 * (k**2 + m**2) / side**2 + 25.0) ** -1.25
        mean_square = np.where(k == 0, 1.0, 0.5) * np.where(m == 0, 1.0, 0.5)
        scale = amplitude / np.sqrt((spectrum**2 * mean_square).sum())
        self.numbers = scale * spectrum * rng.standard_normal((2, *spectrum.shape))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The field at points of shape [..., 2]."""
        wave = np.sin if self.vanishing else np.cos
        along, up = (
            wave(np.pi * (x[..., n, None] - self.first) / self.side * self.k) for n in (0, 1)
        )
        return np.einsum("...k,dkl,...l->...d", along, self.numbers, up, optimize=True)
