"""Approximate inverses of the lattice operator on given nodes, for conjugate gradients.

All work in single precision and hand back double precision: a search direction rounded to single
precision inside CG would leave its recursive residual far from the true one.
"""

from __future__ import annotations

from collections.abc import Callable

import scipy.fft
import torch

from warp_peri.launch import threads
from warp_peri.operator.stencil import long_wave
from warp_peri.statics.domain import Domain
from warp_peri.statics.multigrid import VCycle, coarser, prolong, q1_stencil, restrict

SINE_SHIFT = 0.4
"""Of the short-range filter beside the sine transform, in units of C44."""
SHIFT = 1.0
"""Of the filter beside multigrid at the longest waves, in units of C44."""

Preconditioner = Callable[[torch.Tensor], torch.Tensor]


def sine(domain: Domain, A: torch.Tensor) -> Preconditioner:
    """For rectangles: the symbol's diagonal blocks in the sine basis, its whole at short waves.

    z = H ∗ r + S D_a⁻¹ shift (D_a + shift)⁻¹ S r, S the DST-I, D_a = D11 and D22 at its waves, H
    the filter of `additive`. With D12 = 0 the two add up to the inverse but for the boundary in H.
    """
    reach = A.shape[-1] // 2
    n = torch.arange(-reach, reach + 1, dtype=A.dtype)
    along, across = (
        torch.cos(torch.pi / (size + 1) * torch.outer(torch.arange(1, size + 1), n))
        for size in domain.mask.shape
    )
    D = torch.stack([along @ A[a, a] @ across.T for a in (0, 1)])
    shift = SINE_SHIFT * long_wave(A, 1.0)[1]
    gain = (shift / (D * (D + shift))).to(domain.mask.device, torch.float32)
    filtered = torus_inverse(domain, A, shift=shift)

    def apply(r: torch.Tensor) -> torch.Tensor:
        r = r.float()
        return filtered(r) + dst(dst(r).mul_(gain), inverse=True)

    return apply


def dst(field: torch.Tensor, *, inverse: bool = False) -> torch.Tensor:
    """DST-I over the last two axes."""
    if field.device.type == "cpu":
        transform = scipy.fft.idstn if inverse else scipy.fft.dstn
        result = transform(field.numpy(), type=1, axes=(1, 2), workers=threads())
        return torch.from_numpy(result)
    return odd_dst(field, inverse=inverse)


def odd_dst(field: torch.Tensor, *, inverse: bool) -> torch.Tensor:
    """The same through the Fourier transform of the odd continuation, by torch."""
    for axis in (1, 2):
        size = field.shape[axis]
        zero = torch.zeros_like(field.narrow(axis, 0, 1))
        odd = torch.cat([zero, field, zero, -field.flip(axis)], dim=axis)
        field = -torch.fft.rfft(odd, dim=axis).imag.narrow(axis, 1, size)
        if inverse:
            field = field / (2 * (size + 1))
    return field


def torus_inverse(
    domain: Domain, A: torch.Tensor, *, shift: float | torch.Tensor = 0.0
) -> Preconditioner:
    """(D(k) + shift I)⁻¹ on the torus around the nodes, cut off at them.

    A mean that has no inverse is left as it is.
    """
    torus = domain.torus
    d11, d22, d12 = (part.clone() for part in torus.symbol(A))
    d11 += shift
    d22 += shift
    if not d11[0, 0] > 1e-12 * d11.max():
        d11[0, 0] = d22[0, 0] = 1
    determinant = d11 * d22 - d12**2
    blocks = tuple((part / determinant).float() for part in (d22, d11, -d12))

    def apply(r: torch.Tensor) -> torch.Tensor:
        n, m = r.shape[1:]
        field = torus.product(blocks, r.float())  # type: ignore[arg-type]
        return (field[:, :n, :m] * domain.mask).double()

    return apply


def additive(domain: Domain, A: torch.Tensor) -> Preconditioner:
    """Short waves by a filter on the torus, long ones by multigrid for the local limit, added.

    z = mask (H ∗ r + P V(Pᵗ r)), H(k) = (D(k) + SHIFT C44 p(k) I)⁻¹, V the V-cycle on every second
    node, and p = Π (1 + cos k_a h)/2 what P makes of a wave: where the coarser nodes see nothing H
    is the whole inverse. The inverse symbol alone needs more and more iterations as a domain grows:
    nearly constant modes jump at its boundary.
    """
    C11, C44, mixed = long_wave(A, 1.0)
    along, across = (
        (1 + torch.cos(2 * torch.pi * torch.arange(size, dtype=A.dtype) / size)) / 2
        for size in domain.torus.shape
    )
    seen = torch.outer(along, across[: len(across) // 2 + 1]).to(domain.mask.device)
    filtered = torus_inverse(domain, A, shift=SHIFT * C44 * seen)
    mask = domain.mask
    coarse = coarser(mask)
    if not coarse.any():
        return filtered
    cycle = VCycle(q1_stencil(C11, C44, mixed), coarse)

    def apply(r: torch.Tensor) -> torch.Tensor:
        r = r.float()
        long = prolong(cycle(restrict(r) * coarse), r.shape[1:])
        return filtered(r).add_(long * mask)

    return apply


def nothing(domain: Domain, A: torch.Tensor) -> Preconditioner:
    """No preconditioner: the identity, scaled."""
    middle = A.shape[-1] // 2
    diagonal = float(A[0, 0, middle, middle])
    return lambda r: r / diagonal


__all__ = ["Preconditioner", "additive", "dst", "nothing", "sine", "torus_inverse"]
