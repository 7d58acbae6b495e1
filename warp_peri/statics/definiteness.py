"""Whether the equilibria of an assembled lattice operator are stable."""

from __future__ import annotations

import warnings

import numpy as np
import scipy.sparse as sp
import torch

from warp_peri.errors import InputError
from warp_peri.models.solid import Solid
from warp_peri.operator.stencil import smallest_ratio, stencil
from warp_peri.points.points import Points
from warp_peri.points.quadrature import DEGREE
from warp_peri.stability.inertia import definite_factors
from warp_peri.stability.solvability import smallest_eigenvalue
from warp_peri.statics.domain import domain


def refuse_indefinite(
    points: Points,
    horizon: float,
    solid: Solid,
    stiffness: sp.csc_array,
    *,
    degree: int = DEGREE,
    allowed: bool = False,
) -> None:
    """Raise InputError when L_II is not positive definite, on lattices and where bonds are broken.

    On plain lattices by the symbol, and where that proves nothing, as in space, by the smallest
    eigenvalue. Where
    bonds are broken, its symmetric part decides: a kernel that changes sign seldom bears that
    (theory.md, B9). Elsewhere nothing is asked.

    Args:
        points: the nodes.
        horizon: δ [Å].
        solid: of the operator.
        stiffness: L_II [TPa/Å²].
        degree: of the quadrature.
        allowed: warn, where bonds are broken, instead.
    """
    if points.outside is not None:
        nodes = int(np.count_nonzero(points.interior))
        _judge_cut(sp.csc_array((stiffness + stiffness.T) / 2), nodes, allowed)
        return
    if not points.is_plain_lattice:
        return
    if points.dimension == 2:
        laid = domain(
            points, horizon, bond_based=solid.bond_based, degree=degree, device=torch.device("cpu")
        )
        with torch.no_grad():
            A = stencil(laid.classes, solid)
        if smallest_ratio(laid.torus.symbol(A), laid.torus) > 0:
            return
    elif definite_factors(stiffness) is not None:
        return
    smallest = smallest_eigenvalue(stiffness)
    if not smallest > 0:
        raise InputError(
            f"the operator on these {np.count_nonzero(points.interior)} nodes is indefinite: its "
            f"smallest eigenvalue is {smallest:.1e}, so that its equilibria are not stable"
        )


def _judge_cut(symmetric: sp.csc_array, nodes: int, allowed: bool) -> None:
    """Refuse, or warn of, a symmetric part that is not positive definite."""
    if definite_factors(symmetric) is not None:
        return
    smallest = smallest_eigenvalue(symmetric)
    if smallest > 0:
        return
    message = (
        f"outside: with these bonds broken the operator on {nodes} nodes is not "
        f"positive definite: the smallest eigenvalue of its symmetric part is "
        f"{smallest:.2g}, and its solutions may be wrong; Body(mesh, …) does without broken bonds"
    )
    if not allowed:
        raise InputError(message)
    warnings.warn(message, stacklevel=4)
