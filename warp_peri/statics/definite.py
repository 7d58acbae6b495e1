"""Whether the equilibria of an assembled lattice operator are stable."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import torch

from warp_peri.errors import InputError
from warp_peri.models.solid import Solid
from warp_peri.operator.stencil import smallest_ratio, stencil
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.stability.solvability import smallest_eigenvalue
from warp_peri.statics.domain import domain


def refuse_indefinite(
    points: Points,
    horizon: float,
    solid: Solid,
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
        solid: of the operator.
        stiffness: L_II [TPa/Å²].
        degree: of the quadrature.
    """
    if not points.is_plain_lattice:
        return
    nodes = domain(
        points, horizon, bond_based=solid.bond_based, degree=degree, device=torch.device("cpu")
    )
    with torch.no_grad():
        A = stencil(nodes.classes, solid)
    if smallest_ratio(nodes.torus.symbol(A), nodes.torus) > 0:
        return
    smallest = smallest_eigenvalue(stiffness)
    if not smallest > 0:
        raise InputError(
            f"the operator on these {np.count_nonzero(points.interior)} nodes is indefinite: its "
            f"smallest eigenvalue is {smallest:.1e} TPa/Å², so that its equilibria are not stable"
        )
