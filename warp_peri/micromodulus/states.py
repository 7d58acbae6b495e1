"""Linear peridynamic solids as micromodulus tensors of twice their range (theory.md, T17)."""

from __future__ import annotations

import numpy as np
import torch

from warp_peri.micromodulus.law import Crystal
from warp_peri.models.lps import Model
from warp_peri.operator.stencil import stencil
from warp_peri.points.families import bond_classes

NOTHING = 1e-14
"""Relative, of tensors that are rounding."""


def tensors_of(model: Model, spacing: float) -> Crystal:
    """The law of an LPS, with one influence function or two, on a lattice, exactly.

    C(ξ) is minus its stencil at ξ: products of dilatations make bonds of range 2δ. Any points whose
    families are whole give the same force. Of a solid in space it is what is proven,
    and solved where nodes are many.

    Args:
        model: linear.
        spacing: of the lattice, in the model's units.
    """
    d = model.dimension
    classes = bond_classes(spacing, model.horizon, dimension=d)
    with torch.no_grad():
        A = stencil(classes, model.solid).numpy()
    steps = np.indices(A.shape[2:]).reshape(d, -1).T - A.shape[-1] // 2
    tensors = -A.reshape(d, d, -1).transpose(2, 0, 1)
    half = np.arange(len(steps)) > len(steps) // 2
    kept = half & (np.abs(tensors).max(axis=(1, 2)) > NOTHING * np.abs(tensors).max())
    both = (tensors + tensors.transpose(0, 2, 1)) / 2
    law = Crystal(spacing, steps[kept], both[kept], model.units, {2: "4mm", 3: "m-3m"}[d],
                       provenance={"fit": {"from": "linear peridynamic solid"}})  # fmt: skip
    return law.certified()
