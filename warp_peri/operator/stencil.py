"""The operator of a lattice as one stencil, and its products on a torus of nodes by FFT.

With full families everywhere (9) is the convolution (L u)_i = Σ_n A(n) u_{i+n}, A(n) = A(−n). On
any finite set of unknowns the operator is a block of the same convolution on a torus so large that
nothing reaches around it (theory.md, 53–54).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
import torch

from warp_peri.launch import threads
from warp_peri.models.influence import bernstein_basis
from warp_peri.models.solid import Solid
from warp_peri.points.families import BondClasses

TorusSymbol = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""D11, D22 and D12 at the wave vectors of a torus, as its transforms order them."""


def stencil(classes: BondClasses, solid: Solid) -> torch.Tensor:
    """A(n) [TPa/Å²] along the lattice's own axes, shape [d, d] and d times 2R + 1, n = 0 central.

    Differentiable in the values of the solid that are float64 tensors. R is the reach of a family
    in steps, or twice it with a dilatation; λ = μ has none (theory.md, 42).
    """
    solid = solid.map(lambda value: torch.as_tensor(value, dtype=torch.float64))
    lam, mu, alpha = (value.reshape(()) for value in (solid.lam, solid.mu, solid.alpha))
    xi, r = torch.from_numpy(classes.xi), torch.from_numpy(classes.r)
    weight, count = torch.from_numpy(classes.weight), torch.from_numpy(classes.count).to(r.dtype)
    reach = int(np.abs(classes.steps).max())
    d, size = classes.steps.shape[1], 2 * reach + 1
    place = torch.from_numpy((classes.steps + reach) @ size ** np.arange(d)[::-1])
    normalised = []
    for coefficients in (solid.D, solid.dilatation):
        basis = torch.from_numpy(bernstein_basis(classes.r, classes.horizon, len(coefficients) - 1))
        kw = weight * r**-alpha * (basis @ coefficients)
        normalised.append((kw / (count @ (kw * r**2)))[classes.bond_class])
    w, p = normalised
    bonds = -2 * d * (d + 2) * mu * w / (xi**2).sum(dim=1) * torch.einsum("na,nb->abn", xi, xi)
    gamma = torch.zeros(d, d, size**d, dtype=r.dtype).index_add(2, place, bonds)
    middle, box = torch.tensor([size**d // 2]), d * (size,)
    gamma = gamma.index_add(2, middle, -bonds.sum(dim=2, keepdim=True)).reshape(d, d, *box)
    if solid.bond_based:
        return gamma
    phi = torch.zeros(d, size**d, dtype=r.dtype).index_add(1, place, d * p * xi.T)
    phi = phi.reshape(d, 1, *box)
    convolved = {2: torch.nn.functional.conv2d, 3: torch.nn.functional.conv3d}[d]
    bulk = convolved(phi, phi.flip(*range(2, 2 + d)), padding=2 * reach)
    whole: torch.Tensor = torch.nn.functional.pad(gamma, 2 * d * [reach]) - (lam - mu) * bulk
    return whole


def long_wave(A: torch.Tensor, spacing: float) -> tuple[float, float, float]:
    """C11, C44 and C12 + C44 [TPa] of a stencil, from its second moments (theory.md, 22)."""
    reach = A.shape[-1] // 2
    n = spacing * torch.arange(-reach, reach + 1, dtype=A.dtype)
    along, across = (A[0, 0] * n[:, None] ** 2).sum(), (A[0, 0] * n**2).sum()
    return -float(along) / 2, -float(across) / 2, -float((A[0, 1] * n[:, None] * n).sum())


@dataclass(frozen=True)
class Torus:
    """Fields on a torus of nodes, and products with symmetric stencils.

    Attributes:
        shape: nodes along the two axes.
        device: of the fields, as torch names it. On the processor SciPy transforms, on as many
            threads as the sweeps (torch's transforms take twice as long there).
    """

    shape: tuple[int, int]
    device: torch.device

    def forward(self, field: torch.Tensor) -> torch.Tensor:
        """Transform of fields [..., n₁, n₂] that fill a corner of the torus, zero elsewhere."""
        if self.device.type != "cpu":
            wave: torch.Tensor = torch.fft.rfft2(field, s=self.shape)
            return wave
        return torch.from_numpy(scipy.fft.rfft2(field.numpy(), s=self.shape, workers=threads()))

    def backward(self, wave: torch.Tensor) -> torch.Tensor:
        """Fields on the torus of their transforms; what is in `wave` is lost."""
        if self.device.type != "cpu":
            field: torch.Tensor = torch.fft.irfft2(wave, s=self.shape)
            return field
        field = scipy.fft.irfft2(wave.numpy(), s=self.shape, workers=threads(), overwrite_x=True)
        return torch.from_numpy(field)

    def symbol(self, A: torch.Tensor) -> TorusSymbol:
        """The symbol of a stencil."""
        reach = A.shape[-1] // 2
        folded = torch.zeros(3, *self.shape, dtype=A.dtype, device=self.device)
        corner = folded[:, : 2 * reach + 1, : 2 * reach + 1]
        corner[:] = torch.stack([A[0, 0], A[1, 1], A[0, 1]]).to(self.device)
        d11, d22, d12 = self.forward(folded.roll((-reach, -reach), dims=(1, 2))).real.contiguous()
        return d11, d22, d12

    def product(self, D: TorusSymbol, field: torch.Tensor) -> torch.Tensor:
        """Convolution of a field [2, n₁, n₂] with the stencil of a symbol, on the whole torus."""
        d11, d22, d12 = D
        first, second = self.forward(field)
        wave = torch.stack([d11 * first, d22 * second])
        wave[0] += d12 * second
        wave[1] += d12 * first
        return self.backward(wave)

    def correlation(self, a: torch.Tensor, b: torch.Tensor, reach: int) -> torch.Tensor:
        """Σ_i a_i ⊗ b_{i+n} of fields [2, n₁, n₂] for |n₁|, |n₂| ≤ reach, laid out as a stencil."""
        pairs = self.forward(a).conj_physical()[:, None] * self.forward(b)
        stencil = self.backward(pairs).roll((reach, reach), dims=(2, 3))
        return stencil[:, :, : 2 * reach + 1, : 2 * reach + 1].contiguous()


def smallest_ratio(D: TorusSymbol, torus: Torus) -> float:
    """Smallest Λmin D(k) / Σ_a 4 sin²(k_a h/2) over the wave vectors of a torus but k = 0."""
    d11, d22, d12 = D
    along, across = (
        4 * torch.sin(torch.pi * torch.arange(n, device=torus.device, dtype=d11.dtype) / n) ** 2
        for n in torus.shape
    )
    s = along[:, None] + across[: d11.shape[1]]
    smallest = (d11 + d22) / 2 - torch.hypot((d11 - d22) / 2, d12)
    smallest[0, 0] = torch.inf
    return float((smallest / s).min())
