"""One multigrid V-cycle for the local limit of an operator on any set of lattice nodes.

The operator of a level is the Q1 finite-element stencil of the long-wave moduli, zero outside the
level's nodes. A coarser level has every second node; it is rediscretised, not multiplied out. In
two dimensions the Q1 stencil does not depend on the spacing, so all levels share it.
"""

from __future__ import annotations

import numpy as np
import torch
import warp as wp

from warp_peri.kernels.multigrid import residual
from warp_peri.launch import launch_slices

COARSEST = 400
"""Most nodes of the coarsest level, whose matrix is inverted."""
SMOOTHED = 4.0
"""A smoother covers the eigenvalues from 1/SMOOTHED of the largest up to it."""


def q1_stencil(C11: float, C44: float, mixed: float) -> torch.Tensor:
    """Q1 elements of C11 ∂₁² + C44 ∂₂² and so on, mixed = C12 + C44; shape [2, 2, 3, 3] [TPa]."""
    stiff, mass, slope = np.array([[-1, 2, -1], [1 / 6, 4 / 6, 1 / 6], [-0.5, 0, 0.5]])
    along, across = np.outer(stiff, mass), np.outer(mass, stiff)
    cross = -mixed * np.outer(slope, slope)
    return torch.from_numpy(
        np.array([[C11 * along + C44 * across, cross], [cross, C44 * along + C11 * across]])
    )


def coarser(mask: torch.Tensor) -> torch.Tensor:
    """Nodes of a box that its coarser level keeps: every second, from the second on."""
    return mask[1::2, 1::2]


def restrict(field: torch.Tensor) -> torch.Tensor:
    """Pᵗ: sums of a field [2, n₁, n₂] with weights 1, 1/2, 1/4 around the coarser nodes."""
    for axis in (1, 2):
        n = field.shape[axis] // 2
        even, odd = (_every_second(field, axis, first) for first in (0, 1))
        field = odd + even.narrow(axis, 0, n) / 2
        after = even.shape[axis] - 1  # the last coarser node may have no finer one beyond it
        field.narrow(axis, 0, after).add_(even.narrow(axis, 1, after), alpha=0.5)
    return field


def prolong(field: torch.Tensor, shape: torch.Size) -> torch.Tensor:
    """P: separable linear interpolation of a coarser field to a box of the given shape."""
    for axis in (2, 1):
        size = list(field.shape)
        n, size[axis] = size[axis], shape[axis - 1]
        fine = field.new_zeros(size)
        even, odd = (_every_second(fine, axis, first) for first in (0, 1))
        odd.copy_(field)
        even.narrow(axis, 0, n).add_(field, alpha=0.5)
        after = even.shape[axis] - 1
        even.narrow(axis, 1, after).add_(field.narrow(axis, 0, after), alpha=0.5)
        field = fine
    return field


def _every_second(field: torch.Tensor, axis: int, first: int) -> torch.Tensor:
    return field[(slice(None),) * axis + (slice(first, None, 2),)]


class VCycle:
    """z ≈ A⁻¹ r for the Q1 stencil A on the nodes of a mask; symmetric and positive.

    Args:
        stencil: of q1_stencil.
        mask: the nodes, shape [n₁, n₂] bool.

    Chebyshev polynomials of degree two smooth, the same before and after the coarser level. Single
    precision.
    """

    def __init__(self, stencil: torch.Tensor, mask: torch.Tensor) -> None:
        self.mask = mask.contiguous()
        self.stencil = stencil.to(mask.device, torch.float32)
        largest = float(stencil.abs().sum(dim=(1, 2, 3)).max())  # Gershgorin
        low, high = largest / SMOOTHED, largest
        self.middle, self.half = (high + low) / 2, (high - low) / 2
        self.next: VCycle | None = None
        if min(mask.shape) > 1 and int(mask.sum()) > COARSEST:
            self.next = VCycle(stencil, coarser(mask))
        else:
            self.place = mask.repeat(2, 1, 1).flatten().nonzero()[:, 0]
            self.inverse = torch.linalg.inv(self._dense()).float()

    def _dense(self) -> torch.Tensor:
        zero = torch.zeros(2, *self.mask.shape, device=self.mask.device)
        columns = []
        for place in self.place:
            unit = zero.clone()
            unit.view(-1)[place] = -1
            columns.append(self.residual(zero, unit).flatten()[self.place].double())
        return torch.stack(columns)

    def residual(self, r: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """r − A u on the mask, zero outside it."""
        out = torch.empty_like(r)
        fields = [wp.from_torch(field) for field in (self.stencil, self.mask, r, u, out)]
        launch_slices(residual, self.mask.numel(), fields[:4], fields[4:])
        return out

    def _smooth(self, r: torch.Tensor) -> torch.Tensor:
        """p(A) r, p the Chebyshev iteration of degree two from zero."""
        first = r / self.middle
        rho = 1 / (2 * self.middle / self.half - self.half / self.middle)
        gain = 1 + rho * self.half / self.middle
        return (gain * first).add_(self.residual(r, first), alpha=2 * rho / self.half)

    def __call__(self, r: torch.Tensor) -> torch.Tensor:
        """One cycle from zero, of a right-hand side [2, n₁, n₂] that is zero outside the mask."""
        if self.next is None:
            z = torch.zeros_like(r).flatten()
            z[self.place] = self.inverse @ r.flatten()[self.place]
            return z.reshape(r.shape)
        z = self._smooth(r)
        left = restrict(self.residual(r, z)) * self.next.mask
        z += prolong(self.next(left), r.shape[1:]) * self.mask
        return z.add_(self._smooth(self.residual(r, z)))
