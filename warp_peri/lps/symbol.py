"""The symbol of the LPS operator on the infinite lattice (theory, 18–21).

With stiffnesses v_c = μ w_c [TPa/Å²] and κ = (λ−μ)/μ² [1/TPa] it is
D(k) = Γ(k) + κ φ(k) φ(k)ᵗ, Γ and φ linear in v, and free of the scale of K.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from warp_peri.lps.model import Model, Solid, bernstein_basis, stiffnesses
from warp_peri.points.families import BondClasses


@dataclass(frozen=True)
class Symbol:
    """Tables of the symbol at given wave vectors.

    Attributes:
        gamma: Γ of unit v per class, entries 11, 22, 12, shape [K, 3, C].
        phi: φ of unit v per class, shape [K, 2, C].
        laplacian: s(k) = (4/h²) Σ_a sin²(k_a h/2) [1/Å²], shape [K].
    """

    gamma: np.ndarray
    phi: np.ndarray
    laplacian: np.ndarray

    def entries(self, v: np.ndarray, kappa: float) -> tuple[np.ndarray, ...]:
        """D11, D22, D12 [TPa/Å²], each of shape [K]; κ = 0 gives μΓ alone."""
        g11, g22, g12 = (self.gamma @ v).T
        p1, p2 = (self.phi @ v).T
        return g11 + kappa * p1 * p1, g22 + kappa * p2 * p2, g12 + kappa * p1 * p2

    def ratio(self, v: np.ndarray, kappa: float) -> np.ndarray:
        """Λmin D(k) / s(k) [TPa], shape [K]."""
        d11, d22, d12 = self.entries(v, kappa)
        smallest = (d11 + d22) / 2 - np.hypot((d11 - d22) / 2, d12)
        ratio: np.ndarray = smallest / self.laplacian
        return ratio

    def softest(self, v: np.ndarray, kappa: float) -> np.ndarray:
        """Unit vectors e of Λmin D = e·D e, shape [K, 2]."""
        d11, d22, d12 = self.entries(v, kappa)
        angle = np.arctan2(2 * d12, d11 - d22) / 2  # of the larger eigenvalue's vector
        return np.stack([-np.sin(angle), np.cos(angle)], axis=1)

    def ratio_gradient(self, v: np.ndarray, kappa: float) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of Λmin D / s to v, shape [K, C], and to κ, shape [K]."""
        e = self.softest(v, kappa)
        e_phi = np.einsum("ka,kac->kc", e, self.phi)  # e·φ of unit v
        along = e_phi @ v
        by_v = np.einsum("kg,kgc->kc", quadratic(e), self.gamma)
        by_v += 2 * kappa * along[:, None] * e_phi
        return by_v / self.laplacian[:, None], along**2 / self.laplacian


def quadratic(e: np.ndarray) -> np.ndarray:
    """Weights of the entries 11, 22, 12 in e·D e, shape [K, 3], of vectors [K, 2]."""
    return np.stack([e[:, 0] ** 2, e[:, 1] ** 2, 2 * e[:, 0] * e[:, 1]], axis=1)


def symbol(classes: BondClasses, k: np.ndarray) -> Symbol:
    """Tables at the wave vectors k [1/Å], shape [K, 2], none of them a reciprocal lattice vector.

    Γ(k) = 16 Σ v (1 − cos k·ξ) ξ⊗ξ/r², φ(k) = 2 Σ v sin(k·ξ) ξ, sums over the bonds of a family.
    """
    xi = classes.xi
    r2 = (xi**2).sum(1)
    phase = k @ xi.T
    bend = 32 * np.sin(phase / 2) ** 2  # 16 (1 − cos), without cancellation at small k
    slope = 2 * np.sin(phase)
    member = np.eye(len(classes.r))[classes.bond_class]  # bonds × classes
    products = (xi[:, 0] ** 2 / r2, xi[:, 1] ** 2 / r2, xi[:, 0] * xi[:, 1] / r2)
    gamma = np.stack([bend @ (product[:, None] * member) for product in products], axis=1)
    phi = np.stack([slope @ (xi[:, a, None] * member) for a in (0, 1)], axis=1)
    laplacian = 4 / classes.spacing**2 * (np.sin(k * classes.spacing / 2) ** 2).sum(1)
    return Symbol(gamma, phi, laplacian)


def zone_wedge(spacing: float, intervals: int) -> np.ndarray:
    """Wave vectors [1/Å] on the irreducible wedge 0 ≤ k₂ ≤ k₁ ≤ π/h of the Brillouin zone.

    A grid of π/h / intervals. k = 0 is replaced by a ring of 9 directions at 1e-4 π/h, where
    D/s is its long-wave limit to 1e-7.
    """
    i, j = np.tril_indices(intervals + 1)
    grid = np.stack([i, j], axis=1)[1:] / intervals
    angle = np.linspace(0, np.pi / 4, 9)
    ring = 1e-4 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.pi / spacing * np.concatenate([ring, grid])


def long_wave_moduli(
    classes: BondClasses, v: np.ndarray, kappa: float
) -> tuple[float, float, float]:
    """C11, C12, C44 [TPa] of the symbol at long waves (theory, 22), from fourth moments of v.

    C44 = (c2/2) Σ v ξ₁²ξ₂²/r², C11 = (c2/2) Σ v ξ₁⁴/r² + λ − μ, C12 = C44 + λ − μ, with c2/2 = 8 of
    a sheet and 15 of a solid. The dilatation is exact on affine fields, hence the plain
    λ − μ = κ μ².
    """
    d = classes.xi.shape[1]
    x1, x2 = classes.xi.T[:2]
    each = d * (d + 2) * v[classes.bond_class] / (classes.xi**2).sum(axis=1)
    excess = kappa * (classes.count @ (v * classes.r**2)) ** 2
    C44 = each @ (x1**2 * x2**2)
    return float(each @ x1**4 + excess), float(C44 + excess), float(C44)


def moduli(model: Model, classes: BondClasses) -> dict[str, float]:
    """Long-wave moduli C11, C12, C44 [TPa] of a model's discrete operator (theory, 22)."""
    v, kappa = stiffnesses(model, classes)
    return dict(zip(("C11", "C12", "C44"), long_wave_moduli(classes, v, kappa)))


def stencil(classes: BondClasses, solid: Solid) -> torch.Tensor:
    """A(n) [TPa/Å²] along the lattice's own axes, shape [d, d] and d times 2R + 1, n = 0 central.

    Differentiable in the values of the solid that are float64 tensors. R is the reach of a family
    in steps, or twice it with a dilatation; λ = μ that are not differentiated have none (theory,
    42).
    """
    solid = solid.map(lambda value: torch.as_tensor(value, dtype=torch.float64))
    lam, mu, alpha = (value.reshape(()) for value in (solid.lam, solid.mu, solid.alpha))
    xi, r = torch.from_numpy(classes.xi), torch.from_numpy(classes.r)
    weight, count = torch.from_numpy(classes.weight), torch.from_numpy(classes.count).to(r.dtype)
    reach = int(np.abs(classes.steps).max())
    d, size = classes.steps.shape[1], 2 * reach + 1
    place = torch.from_numpy((classes.steps + reach) @ size ** np.arange(d)[::-1])
    basis = torch.from_numpy(bernstein_basis(classes.r, classes.horizon, len(solid.D) - 1))
    kw = weight * r**-alpha * (basis @ solid.D)
    w = (kw / (count @ (kw * r**2)))[classes.bond_class]
    bonds = -2 * d * (d + 2) * mu * w / (xi**2).sum(dim=1) * torch.einsum("na,nb->abn", xi, xi)
    gamma = torch.zeros(d, d, size**d, dtype=r.dtype).index_add(2, place, bonds)
    middle, box = torch.tensor([size**d // 2]), d * (size,)
    gamma = gamma.index_add(2, middle, -bonds.sum(dim=2, keepdim=True)).reshape(d, d, *box)
    if lam == mu and not (lam.requires_grad or mu.requires_grad):
        return gamma
    phi = torch.zeros(d, size**d, dtype=r.dtype).index_add(1, place, d * w * xi.T)
    phi = phi.reshape(d, 1, *box)
    convolved = {2: torch.nn.functional.conv2d, 3: torch.nn.functional.conv3d}[d]
    bulk = convolved(phi, phi.flip(*range(2, 2 + d)), padding=2 * reach)
    whole: torch.Tensor = torch.nn.functional.pad(gamma, 2 * d * [reach]) - (lam - mu) * bulk
    return whole
