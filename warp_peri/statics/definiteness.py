"""Whether the equilibria of an assembled lattice operator are stable."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import scipy.fft
import scipy.sparse as sp

from warp_peri.core.stencil import Stencil
from warp_peri.core.sweeps import torus_symbol
from warp_peri.errors import InputError
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.stability.certificate import smallest_eigenvalue
from warp_peri.statics.direct import definite_factors
from warp_peri.statics.linear import smallest_ratio


def refuse_indefinite(
    points: Points,
    stiffness: sp.csc_array,
    stencil: Callable[[], Stencil],
    *,
    allowed: bool = False,
) -> None:
    """Raise InputError when L_II is not positive definite, on lattices and where bonds are broken.

    On plain lattices by the symbol, and where that proves nothing by the smallest eigenvalue. Where
    bonds are broken, its symmetric part decides: a kernel that changes sign seldom bears that
    (theory.md, B9). Elsewhere nothing is asked.

    Args:
        points: the nodes.
        stiffness: L_II [stress/length²].
        stencil: gives that of the operator on a plain lattice.
        allowed: warn, where bonds are broken, instead.
    """
    if points.outside is not None:
        nodes = int(np.count_nonzero(points.interior))
        _judge_cut(sp.csc_array((stiffness + stiffness.T) / 2), nodes, allowed)
        return
    if not points.is_plain_lattice:
        return
    sides = np.ptp(lattice_steps(points)[0], axis=0) + 1
    torus = tuple(scipy.fft.next_fast_len(int(n), real=True) for n in sides)
    whole = stencil()
    if smallest_ratio(torus_symbol(torus, whole.steps, whole.tensors), torus) > 0:
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
