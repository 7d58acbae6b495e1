"""Linear peridynamic solids as micromodulus tensors of twice their range (theory.md, T17)."""

from __future__ import annotations

import numpy as np

from warp_peri.errors import InputError
from warp_peri.micromodulus.law import Crystal
from warp_peri.models.lps import Model
from warp_peri.operator.symbol import stiffnesses
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

    Raises InputError for what is no linear peridynamic solid, and a spacing without bonds.
    """
    if not isinstance(model, Model):
        raise InputError(f"model: expected a linear peridynamic solid, got {type(model).__name__}")
    d = model.dimension
    classes = bond_classes(spacing, model.horizon, dimension=d)
    v, z, kappa = stiffnesses(model, classes)
    reach = int(np.abs(classes.steps).max())
    near, of, xi = tuple((classes.steps + reach).T), classes.bond_class, classes.xi
    C = np.zeros((d * (2 * reach + 1,)) + (d, d))
    each = 2 * d * (d + 2) * v[of] / (xi**2).sum(axis=1)
    C[near] = each[:, None, None] * (xi[:, :, None] * xi[:, None])
    if kappa:  # φ is odd: minus φ φᵗ of the symbol (18) is a convolution of its stencil with itself
        phi = np.zeros((*C.shape[:d], d))
        phi[near] = d * z[of, None] * xi
        C = np.pad(C, d * [(reach, reach)] + 2 * [(0, 0)])
        for step, other in zip(classes.steps + reach, d * kappa * z[of, None] * xi):
            C[tuple(slice(n, n + len(phi)) for n in step)] += other[:, None] * phi[..., None, :]
    steps = np.indices(C.shape[:d]).reshape(d, -1).T - C.shape[0] // 2
    tensors = C.reshape(-1, d, d)
    half = np.arange(len(steps)) > len(steps) // 2
    kept = half & (np.abs(tensors).max(axis=(1, 2)) > NOTHING * np.abs(tensors[half]).max())
    both = (tensors + tensors.transpose(0, 2, 1)) / 2
    law = Crystal(spacing, steps[kept], both[kept], model.units, {2: "4mm", 3: "m-3m"}[d],
                       provenance={"fit": {"from": "linear peridynamic solid"}})  # fmt: skip
    return law.certified()
