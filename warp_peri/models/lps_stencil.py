"""The LPS on a lattice as stiffnesses of its bonds, and as a stencil of twice its range."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warp_peri.core.stencil import Stencil
from warp_peri.errors import InputError
from warp_peri.models.influence import CANCELLED
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.quadrature import DEGREE

if TYPE_CHECKING:
    from warp_peri.models.lps import Model

NOTHING = 1e-14
"""Relative, of tensors that are rounding."""


def stiffnesses(model: Model, classes: BondClasses) -> tuple[np.ndarray, np.ndarray, float]:
    """v and z [TPa/Å²] of the bond classes and κ = (λ−μ)/μ² [1/TPa] of a model on a lattice.

    Raises InputError for an influence function whose weighted volume is zero, and a lattice of
    another dimension than the model's.
    """
    if classes.steps.shape[1] != model.dimension:
        raise InputError(
            f"model: expected one of {classes.steps.shape[1]} dimensions, those of the lattice, "
            f"got {model.dimension}; in space micromodulus.tensors_of(model, spacing) is proven"
        )
    tables = []
    r = classes.r * (model.nominal_spacing(classes.spacing) / classes.spacing)
    for K in (model.influence(r), model.influence_dilatation(r)):
        kw = K * classes.weight
        terms = classes.count * kw * classes.r**2
        if not abs(terms.sum()) > CANCELLED * np.abs(terms).sum():
            raise InputError(
                "influence function: its weighted volume m (theory.md, 5) is zero on the lattice "
                f"of spacing {classes.spacing:g}: positive and negative parts cancel"
            )
        tables.append(model.mu * kw / terms.sum())
    return tables[0], tables[1], (model.lam - model.mu) / model.mu**2


def lps_stencil(model: Model, spacing: float, *, degree: int = DEGREE) -> Stencil:
    """The LPS on a lattice as a stencil of twice its range, exactly (theory.md, T17).

    Raises InputError as `stiffnesses` does, and for a spacing without bonds.
    """
    classes = bond_classes(spacing, model.horizon, dimension=model.dimension, degree=degree)
    return stencil_of(classes, *stiffnesses(model, classes))


def stencil_of(classes: BondClasses, v: np.ndarray, z: np.ndarray, kappa: float) -> Stencil:
    """Stiffnesses of bond classes as a stencil: products of dilatations make bonds of range 2δ."""
    d = classes.steps.shape[1]
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
    return Stencil(classes.spacing, steps[kept], both[kept])
