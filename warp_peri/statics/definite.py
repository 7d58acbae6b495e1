"""Whether the equilibria of an assembled lattice operator are stable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
import torch

from warp_peri.errors import InputError
from warp_peri.operator.stencil import smallest_ratio, stencil
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.stability.solvability import smallest_eigenvalue
from warp_peri.statics.domain import domain


def refuse_indefinite(
    points: Points,
    horizon: float,
    numbers: Sequence[torch.Tensor],
    stiffness: sp.csc_array,
    *,
    degree: int = DEGREE,
) -> None:
    """Raise InputError when L_II is not positive definite, on lattices without broken bonds.

    By the symbol, and where that proves nothing by the smallest eigenvalue. Elsewhere L is not
    symmetric, and nothing is asked.

    Args:
        points: the nodes.
        horizon: δ [Å].
        numbers: λ, μ, α, D and D of the dilatation, if it has its own.
        stiffness: L_II [TPa/Å²].
        degree: of the quadrature.
    """
    if not points.is_plain_lattice:
        return
    lam, mu, alpha = (number.detach().reshape(()) for number in numbers[:3])
    D, own = numbers[3].detach(), numbers[-1].detach()
    cpu, bond_based = torch.device("cpu"), bool(lam == mu)
    nodes = domain(points, horizon, bond_based=bond_based, degree=degree, device=cpu)
    A = stencil(nodes.classes, lam, mu, alpha, D, own)
    if smallest_ratio(nodes.torus.symbol(A), nodes.torus) > 0:
        return
    smallest = smallest_eigenvalue(stiffness)
    if not smallest > 0:
        raise InputError(
            f"the operator on these {np.count_nonzero(points.interior)} nodes is indefinite: its "
            f"smallest eigenvalue is {smallest:.1e} TPa/Å², so that its equilibria are not stable"
        )
