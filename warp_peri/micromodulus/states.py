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
    """The law of a plane LPS, with one influence function or two, on a square lattice, exactly.

    C(ξ) is minus its stencil at ξ: products of dilatations make bonds of range 2δ. Any points whose
    families are whole give the same force.

    Args:
        model: linear.
        spacing: of the lattice, in the model's units.
    """
    classes = bond_classes(spacing, model.horizon)
    with torch.no_grad():
        A = stencil(classes, model.solid).numpy()
    reach = A.shape[-1] // 2
    line = np.arange(-reach, reach + 1)
    steps = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    tensors = -A.transpose(2, 3, 0, 1).reshape(-1, 2, 2)
    half = (steps[:, 0] > 0) | ((steps[:, 0] == 0) & (steps[:, 1] > 0))
    kept = half & (np.abs(tensors).max(axis=(1, 2)) > NOTHING * np.abs(tensors).max())
    both = (tensors + tensors.transpose(0, 2, 1)) / 2
    law = Crystal(spacing, steps[kept], both[kept], model.units, "4mm",
                       provenance={"fit": {"from": "linear peridynamic solid"}})  # fmt: skip
    return law.certified()
