"""Fields of the ions of a polar crystal, in every wave (theory, T18)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.points.arguments import typed

COULOMB = 14.399645
"""e²/(4π ε₀) [eV Å]."""
DECAYED, NEGLECTED = 3.5, 36.0
"""x with erfc(x) ≈ 0 at half a supercell, and exponents of Gaussians that are left out."""


@typed
@dataclass(frozen=True, eq=False)
class NonAnalyticCorrection:
    """What waves of ions' displacement do through their electric field (theory, T18).

    Attributes:
        born: effective charges of the atoms of a cell [e], shape [n, 3, 3]. Their mean is taken
            off, since charges of a cell sum to zero.
        dielectric: of clamped ions, shape [3, 3].
        decay: Λ [1/Å] of the Gaussians; from_supercell sets it where it is 0.
    """

    born: np.ndarray
    dielectric: np.ndarray
    decay: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "born", self.born - self.born.mean(axis=0))

    def matrix(
        self, k: np.ndarray, cell: np.ndarray, positions: np.ndarray, *, field: bool = True
    ) -> np.ndarray:
        """Dipoles with dipoles [eV/Å²] but for what is short-ranged, [K, n, 3, n, 3].

        Without `field`, the macroscopic one, it is smooth at k = 0.
        """
        least = np.linalg.eigvalsh(self.dielectric)[0]
        furthest = 2 * self.decay * np.sqrt(NEGLECTED / least) + np.linalg.norm(k, axis=1).max()
        most = np.ceil(furthest * np.linalg.norm(cell, axis=1) / (2 * np.pi)).astype(int)
        counts = np.array(list(itertools.product(*(range(-n, n + 1) for n in most))))
        G = 2 * np.pi * counts @ np.linalg.inv(cell).T
        zero = self._sums(np.zeros(3), G, cell, positions).sum(axis=2)
        around = G if field else G[counts.any(axis=1)]
        D = np.stack([self._sums(one, around, cell, positions) for one in k])
        atoms = np.arange(len(positions))
        # translations cost nothing; a site of low symmetry leaves a part that is not symmetric
        D[:, atoms, :, atoms, :] -= ((zero + zero.conj().swapaxes(1, 2)) / 2)[:, None]
        return D

    def at_long_waves(self, e: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """What the macroscopic field adds to D along unit vectors e [K, 3], [K, n, 3, n, 3]."""
        pull = np.einsum("kb,nba->kna", e, self.born)
        screened = np.einsum("ki,ij,kj->k", e, self.dielectric, e)
        factor = 4 * np.pi * COULOMB / abs(np.linalg.det(cell)) / screened
        return np.asarray(np.einsum("k,kia,kjb->kiajb", factor, pull, pull))

    def _sums(self, k: np.ndarray, G: np.ndarray, cell: np.ndarray, positions: np.ndarray) -> Any:
        """Over the waves k + G, [n, 3, n, 3]."""
        K = k + G
        square = np.einsum("gi,ij,gj->g", K, self.dielectric, K)
        kept = (square > 1e-14) & (square < 4 * self.decay**2 * NEGLECTED)
        K, square = K[kept], square[kept]
        factor = np.exp(-square / (4 * self.decay**2)) / square
        factor *= 4 * np.pi * COULOMB / abs(np.linalg.det(cell))
        phase = np.exp(1j * G[kept] @ positions.T)
        pull = np.einsum("gb,nba->gna", K, self.born) * phase[..., None]
        return np.einsum("g,gia,gjb->iajb", factor, pull, pull.conj(), optimize=True)
